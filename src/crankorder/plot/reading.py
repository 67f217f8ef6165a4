"""How pictures and sentences read the findings: names of orders and frequencies, their kinds, references of levels."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeGuard, TypeVar

from crankorder.cause import alike_speeds
from crankorder.channel_units import unit_text
from crankorder.findings import Findings, FreeBand, ModeFinding, OpenBand
from crankorder.settings import ReportSettings

if TYPE_CHECKING:
    import xarray as xr

_SI_ACCELERATION = {"m/s2": 1.0, "m s-2": 1.0, "m/s^2": 1.0, "mm/s2": 1e-3, "g": 9.80665, "mg": 9.80665e-3}
_SI_PRESSURE = {"Pa": 1.0, "uPa": 1e-6, "mPa": 1e-3, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5}

_SAME_ORDER = 1e-4  # an order this near to one of the findings is that one
_CLOSE_ORDERS = 0.02  # orders this close need more digits to be told apart
_LOCKED_WITHIN = 0.05  # an order further from a half order than this is not called by it
_JUDGED = ("excited", "not excited", None)

B = TypeVar("B", FreeBand, OpenBand)


class Numbered(Protocol):
    """A record that has an order."""

    @property
    def order(self) -> float:
        """Cycles per crank revolution."""


def is_number(value: object) -> TypeGuard[float]:
    """True for a finite number ``value`` (and no bool)."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def interval_of(record: object, key: str) -> tuple[float, float] | None:
    """95 % interval of ``key`` in a ``record`` of the findings (its ``key_ci95``), or None where it has none."""
    low, high = getattr(record, f"{key}_ci95", None) or (None, None)
    return (low, high) if is_number(low) and is_number(high) else None


def decimals_of(width: float, value: float) -> int:
    """Decimals that resolve a quarter of an interval of ``width``, and never more than six digits of ``value``."""
    size = math.floor(math.log10(max(abs(value), width, 1e-300)))
    wanted = -math.floor(math.log10(0.26 * width)) if width > 0 else 2 - size
    return min(wanted, 5 - size)


def called_order(order: float, ends: tuple[float, float] | None = None, lock: object = None) -> float:
    """Order by which a line is called: the half order that it agrees with, else its value to the decimals it earns.

    With the ``ends`` of a 95 % interval it agrees with the half order inside of it, or as its ``lock`` says, and keeps
    as many decimals as these resolve; without them with a half order within 0.005.
    """
    half, most = max(round(2 * order), 1) / 2, 4 - min(math.floor(math.log10(max(order, 1e-9))), 0)
    low, high = ends or (order - 0.005, order + 0.005)
    if (low <= half <= high or lock == "locked") and abs(order - half) < _LOCKED_WITHIN:
        return half
    return round(order, min(max(decimals_of(high - low, order), 1), most) if ends else most)


def order_text(order: float, decimals: int = 3) -> str:
    """Shortest text of an ``order`` to some ``decimals``, below 1 to as many digits: ``"5.5"``, ``"0.03093"``."""
    below = min(math.floor(math.log10(order)), 0) if order > 0 else 0
    return f"{order:.{decimals - below}f}".rstrip("0").rstrip(".")


def order_texts(orders: Sequence[float]) -> list[str]:
    """Texts of ``orders`` that tell different ones apart: as short as can be, up to nine decimals where close."""
    texts = {order: order_text(order) for order in orders}
    for decimals in range(4, 10):
        times = Counter(texts.values())
        close = [order for order, text in texts.items() if times[text] > 1]
        texts |= {order: order_text(order, decimals) for order in close}
    return [texts[order] for order in orders]


def names_of_orders(orders: Sequence[float]) -> list[str]:
    """Texts of measured ``orders`` by what they are called; by their own numbers where two are called alike."""
    called = [nominal_order(order) for order in orders]
    own = [order if called.count(name) > 1 else name for order, name in zip(orders, called, strict=True)]
    return order_texts(own)


def nominal_order(record: Any) -> float:
    """Order by which the line of a ``record`` of the findings, or a measured order, is called: see called_order."""
    order = float(getattr(record, "order", record))
    return called_order(order, interval_of(record, "order"), getattr(record, "lock", None))


def order_name(record: Numbered, findings: Findings) -> str:
    """Short text of the order of a ``record`` that no other order of the ``findings`` has: ``"2"``, ``"1.005"``."""
    same = min(findings.orders, key=lambda one: abs(one.order - record.order), default=record)
    own = nominal_order(
        same if abs(same.order - record.order) < _SAME_ORDER and not interval_of(record, "order") else record
    )
    near = {own}
    near |= {nominal_order(other) for other in findings.orders if abs(other.order - own) < _CLOSE_ORDERS}
    ordered = sorted(near)
    return order_texts(ordered)[ordered.index(own)]


def is_tone(mode: ModeFinding) -> bool:
    """True for a ``mode`` of the findings that is no natural frequency: mains or another fixed tone."""
    return mode.kinds[0] not in ("mode", "whirl", "undecided")


def is_whirl(mode: ModeFinding) -> bool:
    """True for a ``mode`` of the findings that moves with the speed."""
    return mode.kinds[0] == "whirl" and is_number(mode.speed_slope)


def is_undecided(mode: ModeFinding) -> bool:
    """True for a ``mode`` of the findings that may be a natural frequency or something else."""
    return not is_tone(mode) and (mode.kinds[0] == "undecided" or bool(mode.undecided))


def at_one_speed(findings: Findings) -> bool:
    """True where the test of the ``findings`` ran at one speed: nothing tells a line that stays from one that goes."""
    low, high = findings.speed_range_rpm
    return is_number(low) and is_number(high) and alike_speeds((low, high))


def number_text(value: float | None, *, digits: int = 3) -> str:
    """``value`` to ``digits`` significant digits, without exponent from 1e-4 to 1e6; ``"–"`` where it is not known."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if not -4 <= size < 6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{mantissa.replace('-', '−')}e{int(exponent)}"
    return f"{value:.{max(0, digits - 1 - size)}f}".replace("-", "−")


def frequency_text(frequency_hz: float) -> str:
    """``frequency_hz`` for a label: three digits below 100 Hz, whole hertz above; no unit."""
    return f"{frequency_hz:.0f}" if abs(frequency_hz) >= 99.95 else f"{frequency_hz:.3g}"


def scaling_text(dataset: xr.Dataset) -> str:
    """``"(peak)"`` or ``"(RMS)"``: what the amplitudes of a map ``dataset`` are, by its ``amplitude_scaling``."""
    return "(RMS)" if str(dataset.attrs.get("amplitude_scaling", "peak")).casefold() == "rms" else "(peak)"


def level_reference(quantity: str, unit: str, *, settings: ReportSettings) -> tuple[float, str]:
    """Reference of a level in the channel's own unit, and its text for the colour bar.

    ``quantity`` and ``unit`` of the channel; ``settings`` hold the references for acceleration [m/s²] and sound
    pressure [Pa]. Returns (reference, text); any other quantity refers to one unit. Source: ISO 1683:2015, table 1.
    """
    if quantity == "acceleration" and unit in _SI_ACCELERATION:
        reference = settings.acceleration_reference_m_s2
        mantissa, exponent = map(float, f"{reference:e}".split("e"))
        return reference / _SI_ACCELERATION[unit], f"dB re {mantissa:g}e{exponent:g} m/s² (peak)"
    from crankorder.quantities import is_sound  # loads xarray, which numbers and names of a balance need not wait for

    if unit in _SI_PRESSURE and is_sound(quantity, unit):
        reference = settings.pressure_reference_pa
        return reference / _SI_PRESSURE[unit], f"dB re {number_text(reference * 1e6, digits=2)} µPa (peak)"
    return 1.0, f"dB re 1 {unit_text(unit)} (peak)".replace("1  ", "1 ")


def free_bands(findings: Findings) -> list[tuple[float, float]]:
    """Speed ranges [rpm] of ``findings`` in which no order can be amplified much, slowest first."""
    return sorted((band.low_rpm, band.high_rpm) for band in wide_bands(findings.free_bands))


def open_bands(findings: Findings) -> list[tuple[float, float]]:
    """Speed ranges [rpm] of ``findings`` that are neither free nor to be avoided, slowest first."""
    return sorted((band.low_rpm, band.high_rpm) for band in wide_bands(findings.open_bands or ()))


def wide_bands(bands: Sequence[B]) -> list[B]:
    """Those of ``bands`` that hold more than one speed."""
    return [band for band in bands if band.high_rpm > band.low_rpm]


def not_judged_rpm(findings: Findings) -> list[float]:
    """Speeds [rpm] of the crossings of ``findings`` inside the tested range of which nothing could be decided."""
    return [
        record.rpm
        for record in findings.crossings
        if record.in_range and record.verdict not in _JUDGED and is_number(record.rpm)
    ]
