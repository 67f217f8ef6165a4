"""How sentences, pictures and tables write findings: numbers, intervals, names of orders, kinds of lines, levels."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeGuard, TypeVar

from crankorder.cause import alike_speeds
from crankorder.channel_units import unit_text
from crankorder.errors import printable
from crankorder.findings import Findings, FreeBand, LineFinding, ModeFinding, MotorLine, OpenBand, OrderFinding
from crankorder.records import known
from crankorder.settings import ReportSettings

if TYPE_CHECKING:
    import xarray as xr

_SI_ACCELERATION = {"m/s2": 1.0, "m s-2": 1.0, "m/s^2": 1.0, "mm/s2": 1e-3, "g": 9.80665, "mg": 9.80665e-3}
_SI_PRESSURE = {"Pa": 1.0, "uPa": 1e-6, "mPa": 1e-3, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5}

NAME_CHARACTERS = 60
"""Of a name from a file in a sentence; what is longer is cut."""

SAME_MODE = 1e-3
"""Share of a frequency within which two numbers are those of one natural frequency."""

_REASON_CHARACTERS = 600  # those that this program words are shorter
_SAME_ORDER = 1e-4  # an order this near to one of the findings is that one
_CLOSE_ORDERS = 0.02  # orders this close need more digits to be told apart
_LOCKED_WITHIN = 0.05  # an order further from a half order than this is not called by it
_SAME_HZ = 0.5  # a line this close to a tone is that tone …
_SAME_SHARE = 0.002  # … or this share of its frequency
_JUDGED = ("excited", "not excited", None)

B = TypeVar("B", FreeBand, OpenBand)
R = TypeVar("R", OrderFinding, MotorLine)
K = TypeVar("K", bound=Hashable)


def is_number(value: object) -> TypeGuard[float]:
    """True for a finite number ``value`` (and no bool)."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def interval_of(record: object, key: str) -> tuple[float, float] | None:
    """95 % interval of ``key`` in a ``record`` of the findings (its ``key_ci95``), or None where it has none."""
    return known(getattr(record, f"{key}_ci95", None))


def decimals_of(width: float, value: float) -> int:
    """Decimals that resolve a quarter of an interval of ``width``, and never more than six digits of ``value``.

    Both are in one unit; ``width`` is 0 or more.
    """
    size = math.floor(math.log10(max(abs(value), width, 1e-300)))
    wanted = -math.floor(math.log10(0.26 * width)) if width > 0 else 2 - size
    return min(wanted, 5 - size)


def called_order(order: float, ends: tuple[float, float] | None = None, lock: object = None) -> float:
    """Order that names a line: the half order that it agrees with, else its value to the decimals that are known.

    With the ``ends`` (low, high) of a 95 % interval it agrees with a half order in the interval, or where its ``lock``
    says so, and has as many decimals as the interval resolves; without ``ends`` it agrees with a half order within
    0.005.
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
    """Names of measured ``orders``; their own numbers where two would have the same name."""
    called = [nominal_order(order) for order in orders]
    own = [order if called.count(name) > 1 else name for order, name in zip(orders, called, strict=True)]
    return order_texts(own)


def nominal_order(record: Any) -> float:
    """Order that names the line of a ``record`` of the findings, or a measured order, by :func:`called_order`."""
    order = float(getattr(record, "order", record))
    return called_order(order, interval_of(record, "order"), getattr(record, "lock", None))


def order_name(record: Any, findings: Findings) -> str:
    """Short text of the order of a ``record``, or of an order, that no other of the ``findings`` has: ``"1.005"``."""
    order = float(getattr(record, "order", record))
    same = min(findings.orders, key=lambda other: abs(other.order - order), default=record)
    is_same = abs(getattr(same, "order", order) - order) < _SAME_ORDER and not interval_of(record, "order")
    own = nominal_order(same if is_same else record)
    near = sorted({own, *(nominal_order(other) for other in findings.orders if abs(other.order - own) < _CLOSE_ORDERS)})
    return order_texts(near)[near.index(own)]


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
    """True where the test of the ``findings`` ran at one speed, so that orders and fixed tones look the same."""
    low, high = findings.speed_range_rpm
    return is_number(low) and is_number(high) and alike_speeds((low, high))


def number_text(value: float | None, *, digits: int = 3) -> str:
    """``value``, in any unit, to ``digits`` significant digits; "–" where it is not known.

    It has no exponent from 1e-4 to 1e6.
    """
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
    """``frequency_hz`` [Hz] for a label: three digits below 100 Hz, whole hertz above; no unit."""
    return f"{frequency_hz:.0f}" if abs(frequency_hz) >= 99.95 else f"{frequency_hz:.3g}"


def scaling_text(dataset: xr.Dataset) -> str:
    """``"(peak)"`` or ``"(RMS)"``: scaling of the amplitudes of a map ``dataset``, by its ``amplitude_scaling``."""
    return "(RMS)" if str(dataset.attrs.get("amplitude_scaling", "peak")).casefold() == "rms" else "(peak)"


def level_reference(quantity: str, unit: str, *, settings: ReportSettings) -> tuple[float, str]:
    """Reference of a level in the channel's own unit, and its text for the colour bar.

    ``quantity`` and ``unit`` are those of the channel; ``settings`` hold the references for acceleration [m/s²] and
    sound pressure [Pa]; any other quantity refers to one unit. Source: ISO 1683:2015, table 1.
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


def channel_level(dataset: xr.Dataset, channel: int, *, settings: ReportSettings) -> tuple[float, str]:
    """Reference, in its unit, of the level of the channel with index ``channel``, and a text with level and reference.

    ``dataset`` is a map (channel, speed, …), ``settings`` are those of :func:`level_reference`; the text says how the
    amplitudes of ``dataset`` are scaled.
    """
    quantity, unit = (str(dataset[name].values[channel]) for name in ("quantity", "unit"))
    reference, text = level_reference(quantity, unit, settings=settings)
    return reference, text.replace("(peak)", scaling_text(dataset))


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
    inside = (record for record in findings.crossings if record.in_range and is_number(record.rpm))
    return [record.rpm for record in inside if record.verdict not in _JUDGED]


def named(value: object, *, limit: int) -> str:
    """Text from a file, safe to show: control characters as ``\\xNN``, cut with an ellipsis.

    ``value`` is any text, ``limit`` the greatest number of characters.
    """
    return printable(value, limit)


def short(text: object) -> str:
    """``text`` from a file, such as a name, as a sentence has it: safe to show, at most 60 characters."""
    return printable(text, NAME_CHARACTERS)


def reason_text(text: str | None) -> str:
    """``text`` of a reason as the end of a sentence has it: whole, safe to show, no full stop; empty for None."""
    return printable(text or "", _REASON_CHARACTERS).rstrip(".")


def at_speed(rpm: float | None) -> str:
    """``" at 1800 rpm"``; empty where the speed is not known."""
    return f" at {rpm:.0f} rpm" if is_number(rpm) else ""


def speed_text(rpm: float) -> str:
    """``"1800 rpm"``, in words where ``rpm`` is not finite."""
    return f"{rpm:.0f} rpm" if math.isfinite(rpm) else "speed not known"


def order_estimate(record: Any, findings: Findings) -> str:
    """Order of a ``record`` with its interval, ``"5.500 (5.497…5.503)"``; without one its name in the ``findings``."""
    return estimate_text(record, "order") if getattr(record, "order_ci95", None) else order_name(record, findings)


def is_in_doubt(mode_hz: float, findings: Findings) -> bool:
    """True where no mode of ``findings`` at ``mode_hz`` (Hz, above 0) is a natural frequency for certain."""
    nearest = min(findings.modes, key=lambda mode: abs(mode.frequency_hz - mode_hz), default=None)
    return nearest is None or is_undecided(nearest) or abs(nearest.frequency_hz - mode_hz) > SAME_MODE * mode_hz


def unit_of(findings: Findings, record: Any) -> str:
    """Typographic unit of a ``record``: its own, else that of its channel in ``findings``; empty where unknown."""
    own = getattr(record, "unit", None)
    units = {channel.name: channel.unit for channel in findings.channels}
    return unit_text(own or units.get(record.channel or "", ""))


def percent_text(share: float) -> str:
    """``share`` (0…1) as ``"3.1 %"``; ``"< 0.01 %"`` for something, however little; ``"0 %"`` for nothing."""
    percent = 100 * share
    if 0 < percent < 0.01:
        return "< 0.01 %"
    return f"{percent:.0f} %" if percent >= 99.5 or percent == 0 else f"{number_text(percent, digits=2)} %"


def speeds_text(ends: Sequence[float | None]) -> str:
    """Range of speeds as ``"1690–1760"``, from its two ``ends`` in rpm; ``"–"`` for an end that is not known."""
    return "–".join(f"{end:.0f}" if is_number(end) else "–" for end in ends)


def least_of(record: object, key: str) -> float | None:
    """Lower end of the 95 % interval of ``key`` in a ``record`` of the findings where it has no upper end, or None."""
    low, high = getattr(record, f"{key}_ci95", None) or (None, None)
    return low if is_number(low) and not is_number(high) else None


def estimate_text(record: object, key: str, *, unit: str = "", factor: float = 1) -> str:
    """Estimate with its 95 % interval: ``"0.83 (0.81…0.85) m/s²"``; ``"–"`` where there is none.

    ``record`` is one of the findings or of a comparison, ``key`` the name of the estimate; number and interval are
    multiplied by ``factor``; ``unit`` follows where given.
    """
    value, ends = getattr(record, key), (interval_of(record, key) or ())[:: 1 if factor > 0 else -1]
    return with_interval(factor * value if is_number(value) else None, [factor * end for end in ends], unit=unit)


def level_text(findings: Findings, record: Any) -> str:
    """Amplitude of a ``record`` of the ``findings`` in a sentence: ``"0.83 m/s² (0.81…0.85)"``."""
    value, _, interval = estimate_text(record, "amplitude").partition(" ")
    return " ".join(part for part in (value, unit_of(findings, record), interval) if part)


def with_interval(value: object, ends: Sequence[object] | None, *, unit: str = "") -> str:
    """``value`` with the ``ends`` of its 95 % interval, to the digits that this earns, and its ``unit`` where given."""
    if not is_number(value):
        return "–"
    tail, (low, high) = f" {unit}" if unit else "", ends or (None, None)
    if not is_number(low) or not is_number(high):
        return number_text(value) + tail
    decimals, texts = decimals_of(high - low, value), [number_text(number) for number in (value, low, high)]
    if -1 <= decimals <= 6:
        texts = [f"{number:.{max(decimals, 0)}f}".replace("-", "−") for number in (value, low, high)]
    return f"{texts[0]} ({texts[1]}…{texts[2]}){tail}"


def listed(words: Sequence[str], *, most: int | None = None) -> str:
    """``words`` as in a sentence: ``"X, Y and Z"``; ``" and more"`` behind the first ``most`` where there are more."""
    first = words[:most]
    text = " and ".join(filter(None, (", ".join(first[:-1]), first[-1]))) if first else ""
    return f"{text} and more" if len(first) < len(words) else text


def strongest_by(records: Sequence[R], key: Callable[[R], K]) -> dict[K, R]:
    """The largest of ``records`` by each ``key`` that they have; of equal ones the first."""
    return {key(record): record for record in sorted(records, key=lambda record: -record.amplitude)[::-1]}


@dataclass(frozen=True)
class FixedTone:
    """A line that stays at its frequency: its record and its line in each channel that shows it."""

    record: ModeFinding
    lines: list[LineFinding] = field(default_factory=list)


def is_fixed_tone(line: LineFinding) -> bool:
    """True for a ``line`` of the findings at a fixed frequency that is no natural frequency."""
    return is_number(line.frequency_hz) and line.kinds[0] not in ("mode", "undecided")


def hertz_of_order(record: OrderFinding, findings: Findings) -> float | None:
    """Frequency [Hz] by which an order ``record`` of the ``findings`` is named first; None where its order says more.

    A frequency names lines of the mains or of a motor's field, and, in a test at one speed, lines at no multiple of the
    half order, as it is not known whether they follow the speed. A line of a bearing is named by its order.
    """
    rpm = record.speed_rpm_at_max
    of_part = record.kinds[0] in ("bearing", "gear mesh")
    loose = at_one_speed(findings) and record.lock == "slips" and not of_part
    return record.order * rpm / 60.0 if is_number(rpm) and (loose or record.electric) else None


def strongest_tone(findings: Findings, channel: str) -> LineFinding | None:
    """Line of the strongest tone in a ``channel`` of the ``findings``, or None."""
    lines = (line for line in findings.lines if line.channel == channel and is_number(line.amplitude))
    return max(filter(is_fixed_tone, lines), key=lambda line: line.size, default=None)


def fixed_tones(findings: Findings) -> list[FixedTone]:
    """All tones of the ``findings``, lowest first, each with its lines in the channels, strongest first."""
    tones = [FixedTone(mode) for mode in findings.modes if is_tone(mode)]
    decided = [mode.frequency_hz for mode in findings.modes if not is_tone(mode)]
    for line in findings.lines:
        hz = line.frequency_hz
        if hz is None or not is_fixed_tone(line):
            continue
        tone = next((tone for tone in tones if _is_at(tone.record, hz)), None)
        if tone is None:
            if any(abs(mode_hz - hz) < 1e-9 * mode_hz for mode_hz in decided):
                continue  # the table of natural frequencies has it
            # as the list of modes would have it
            kind, ends = line.explained_by or "unexplained", line.frequency_hz_ci95
            record = ModeFinding(
                frequency_hz=hz, frequency_hz_ci95=ends, channels=(), evidence="", explained_by=kind, causes=line.causes
            )
            tones.append(tone := FixedTone(record))
        tone.lines.append(line)
    every = [FixedTone(tone.record, sorted(tone.lines, key=lambda line: -line.size)) for tone in tones]
    return sorted(every, key=lambda tone: tone.record.frequency_hz)


def fixed_frequencies(findings: Findings) -> list[ModeFinding]:
    """All lines of fixed frequency in the ``findings``, lowest first: natural frequencies, undecided ones, tones.

    A tone that stands in the list of lines alone is given like a mode, with its kind as ``explained_by``.
    """
    modes = [mode for mode in findings.modes if not is_tone(mode)]
    tones = [
        replace(tone.record, channels=tone.record.channels or tuple(line.channel for line in tone.lines))
        for tone in fixed_tones(findings)
    ]
    return sorted([*modes, *tones], key=lambda mode: mode.frequency_hz)


def _is_at(tone: ModeFinding, hertz: float) -> bool:
    """Whether a line at ``hertz`` lies within the tolerance of a ``tone``."""
    low, high = interval_of(tone, "frequency_hz") or (0.0, 0.0)
    return abs(tone.frequency_hz - hertz) <= max(min(_SAME_HZ, _SAME_SHARE * tone.frequency_hz), high - low)
