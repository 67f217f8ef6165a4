"""How numbers, units and names are written in sentences, pictures and tables: one way everywhere."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, Protocol, TypeGuard

from crankorder.channel_units import unit_text
from crankorder.errors import printable
from crankorder.findings import Findings, ModeFinding
from crankorder.identify.said import NUMBERS as SAID
from crankorder.settings import ReportSettings

_SI_ACCELERATION = {"m/s2": 1.0, "m s-2": 1.0, "m/s^2": 1.0, "mm/s2": 1e-3, "g": 9.80665, "mg": 9.80665e-3}
_SI_PRESSURE = {"Pa": 1.0, "uPa": 1e-6, "mPa": 1e-3, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5}

NAME_CHARACTERS = 60
"""Of a name from a file in a sentence; what is longer is cut."""

_LOCKED_WITHIN = 0.05  # an order further from a half order than this is not called by it
_SAME_MODE = 1e-3  # share of a frequency within which a natural frequency is that of a crossing
_CLOSE_ORDERS = 0.02  # orders this close need more digits to be told apart


class Numbered(Protocol):
    """A record that has an order."""

    @property
    def order(self) -> float:
        """Cycles per crank revolution."""


class InChannel(Protocol):
    """A record that belongs to a channel."""

    @property
    def channel(self) -> str | None:
        """Name of the channel."""


def named(value: object, *, limit: int) -> str:
    """Text from a file, safe to show: control characters as ``\\xNN``, cut with an ellipsis.

    ``value`` any text; ``limit`` the greatest number of characters.
    """
    return printable(value, limit)


def scaling_text(dataset: Any) -> str:
    """``"(peak)"`` or ``"(RMS)"``: what the amplitudes of a map ``dataset`` are, by its ``amplitude_scaling``."""
    return "(RMS)" if str(dataset.attrs.get("amplitude_scaling", "peak")).casefold() == "rms" else "(peak)"


def order_text(order: float) -> str:
    """Shortest text of an ``order`` to three decimals: ``"2"``, ``"5.5"``, ``"61.2"``."""
    return f"{order:.3f}".rstrip("0").rstrip(".")


def nominal_order(record: Numbered | float) -> float:
    """Order by which a line is called: the half order that it agrees with, else its value to the decimals it earns.

    ``record`` of the findings, or a measured order. With a 95 % interval it agrees with the half order inside of it
    (and is not called so where that lies outside), without one with a half order within 0.005. Else it keeps two
    decimals, or as many more, up to four, as its interval resolves.
    """
    order = float(record if isinstance(record, int | float) else record.order)
    half = round(2 * order) / 2
    interval = interval_of(record, "order")
    if getattr(record, "lock", None) == "locked" and abs(order - half) < _LOCKED_WITHIN:
        return half
    if interval is None:
        return half if abs(order - half) < 0.005 else round(order, 2)
    if interval[0] <= half <= interval[1] and abs(order - half) < _LOCKED_WITHIN:
        return half
    return round(order, min(max(_decimals(interval[1] - interval[0], order), 2), 4))


def order_texts(orders: Sequence[float]) -> list[str]:
    """Texts of ``orders`` that tell different ones apart: as short as can be, up to nine decimals where they are close.

    1 and 1.005 become ``"1"`` and ``"1.005"``, never twice ``"1"``.
    """
    texts = {float(order): order_text(nominal_order(float(order))) for order in orders}
    for decimals in range(3, 10):
        times = Counter(texts.values())
        alike = [order for order, text in texts.items() if times[text] > 1]
        if not alike:
            break
        texts |= {order: f"{order:.{decimals}f}".rstrip("0").rstrip(".") for order in alike}
    return [texts[float(order)] for order in orders]


def order_name(record: Numbered, findings: Findings) -> str:
    """Short text of the order of a ``record`` that no other order of the ``findings`` has: ``"2"``, ``"1.005"``."""
    own = nominal_order(record)
    near = {own}
    near |= {nominal_order(other) for other in findings.orders if abs(other.order - own) < _CLOSE_ORDERS}
    ordered = sorted(near)
    return order_texts(ordered)[ordered.index(own)]


def order_estimate(record: Numbered, findings: Findings) -> str:
    """Order of a ``record`` with its interval, ``"5.500 (5.497…5.503)"``; without one its name in the ``findings``."""
    return estimate_text(record, "order") if getattr(record, "order_ci95", None) else order_name(record, findings)


def is_tone(mode: ModeFinding) -> bool:
    """True for a ``mode`` of the findings that is no natural frequency: mains or another fixed tone."""
    return mode.explained_by not in ("mode", "whirl", "undecided")


def is_whirl(mode: ModeFinding) -> bool:
    """True for a ``mode`` of the findings that moves with the speed."""
    return mode.explained_by == "whirl" and is_number(mode.speed_slope)


def is_undecided(mode: ModeFinding) -> bool:
    """True for a ``mode`` of the findings that may be a natural frequency or something else."""
    return not is_tone(mode) and (mode.explained_by == "undecided" or bool(mode.undecided))


def is_in_doubt(mode_hz: float, findings: Findings) -> bool:
    """True where no mode of ``findings`` at ``mode_hz`` is for certain a natural frequency."""
    nearest = min(findings.modes, key=lambda mode: abs(mode.frequency_hz - mode_hz), default=None)
    if nearest is None or is_undecided(nearest):
        return True
    return abs(nearest.frequency_hz - mode_hz) > _SAME_MODE * mode_hz


def unit_of(findings: Findings, record: InChannel) -> str:
    """Typographic unit of a ``record``: its own, else that of its channel in ``findings``; empty where unknown."""
    own = getattr(record, "unit", None)
    units = {channel.name: channel.unit for channel in findings.channels}
    return unit_text(own or units.get(record.channel or "", ""))


def number_text(value: float, *, digits: int = 3) -> str:
    """``value`` to ``digits`` significant digits, without exponent from 1e-4 to 1e6; ``"–"`` for NaN and infinity."""
    if not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if not -4 <= size < 6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{mantissa.replace('-', '−')}e{int(exponent)}"
    return f"{value:.{max(0, digits - 1 - size)}f}".replace("-", "−")


def percent_text(share: float) -> str:
    """``share`` (0…1) as ``"3.1 %"``; ``"< 0.01 %"`` for something, however little; ``"0 %"`` for nothing."""
    percent = 100 * share
    if 0 < percent < 0.01:
        return "< 0.01 %"
    return f"{percent:.0f} %" if percent >= 99.5 or percent == 0 else f"{number_text(percent, digits=2)} %"


def speeds_text(ends: Sequence[float | None]) -> str:
    """Range of speeds as ``"1690–1760"``, from its two ``ends`` in rpm; ``"–"`` for an end that is not known."""
    return "–".join(f"{end:.0f}" if is_number(end) else "–" for end in ends)


def _decimals(width: float, value: float) -> int:
    """Decimals that resolve a quarter of an interval of ``width``, and never more than six digits of ``value``."""
    size = math.floor(math.log10(max(abs(value), width, 1e-300)))
    wanted = -math.floor(math.log10(0.26 * width)) if width > 0 else 2 - size
    return min(wanted, 5 - size)


def interval_of(record: object, key: str) -> tuple[float, float] | None:
    """95 % interval of ``key`` in a ``record`` of the findings (its ``key_ci95``), or None where it has none."""
    low, high = getattr(record, f"{key}_ci95", None) or (None, None)
    return (low, high) if is_number(low) and is_number(high) else None


def least_of(record: object, key: str) -> float | None:
    """Lower end of the 95 % interval of ``key`` in a ``record`` of the findings where it has no upper end, or None."""
    low, high = getattr(record, f"{key}_ci95", None) or (None, None)
    return low if is_number(low) and not is_number(high) else None


def at_one_speed(findings: Findings) -> bool:
    """True where the test of the ``findings`` ran at one speed: nothing tells a line that stays from one that goes."""
    low, high = findings.speed_range_rpm
    return is_number(low) and is_number(high) and high <= SAID.alike_speeds_ratio * low


def is_number(value: object) -> TypeGuard[float]:
    """True for a finite number ``value`` (and no bool)."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def estimate_text(record: object, key: str, *, unit: str = "") -> str:
    """Estimate with its 95 % interval: ``"0.83 (0.81…0.85) m/s²"``; ``"–"`` where there is none.

    ``record`` one of the findings; ``key`` the estimate's name; ``unit`` follows where given.
    """
    return with_interval(getattr(record, key), getattr(record, f"{key}_ci95", None), unit=unit)


def with_interval(value: object, ends: Sequence[object] | None, *, unit: str = "") -> str:
    """``value`` with the ``ends`` of its 95 % interval, to the digits that this earns, and its ``unit`` where given."""
    if not is_number(value):
        return "–"
    tail = f" {unit}" if unit else ""
    low, high = ends or (None, None)
    if not is_number(low) or not is_number(high):
        return number_text(float(value)) + tail
    decimals = _decimals(high - low, float(value))
    if not -1 <= decimals <= 6:
        return f"{number_text(float(value))} ({number_text(low)}…{number_text(high)}){tail}"
    texts = [f"{number:.{max(decimals, 0)}f}".replace("-", "−") for number in (float(value), low, high)]
    return f"{texts[0]} ({texts[1]}…{texts[2]}){tail}"


def level_reference(quantity: str, unit: str, *, settings: ReportSettings) -> tuple[float, str]:
    """Reference of a level in the channel's own unit, and its text for the colour bar.

    ``quantity`` and ``unit`` of the channel; ``settings`` hold the references for acceleration [m/s²] and sound
    pressure [Pa]. Returns (reference, text); any other quantity refers to one unit. Source: ISO 1683:2015, table 1.
    """
    if quantity == "acceleration" and unit in _SI_ACCELERATION:
        reference = settings.acceleration_reference_m_s2
        return reference / _SI_ACCELERATION[unit], f"dB re {_power(reference)} m/s² (peak)"
    from crankorder.quantities import is_sound  # loads xarray, which numbers and names of a balance need not wait for

    if unit in _SI_PRESSURE and is_sound(quantity, unit):
        reference = settings.pressure_reference_pa
        return reference / _SI_PRESSURE[unit], f"dB re {number_text(reference * 1e6, digits=2)} µPa (peak)"
    return 1.0, f"dB re 1 {unit_text(unit)} (peak)".replace("1  ", "1 ")


def _power(value: float) -> str:
    mantissa, exponent = f"{value:e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def listed(words: Sequence[str]) -> str:
    """``words`` as in a sentence: ``"X, Y and Z"``."""
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1]))) if words else ""


def frequency_text(frequency_hz: float) -> str:
    """``frequency_hz`` for a label: three digits below 100 Hz, whole hertz above; no unit."""
    return f"{frequency_hz:.0f}" if abs(frequency_hz) >= 99.95 else f"{frequency_hz:.3g}"
