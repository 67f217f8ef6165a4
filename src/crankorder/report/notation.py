"""How numbers, units and names are written in sentences, pictures and tables: one way everywhere."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Protocol, TypeVar

from crankorder.channel_units import unit_text
from crankorder.errors import printable
from crankorder.findings import Findings, MotorLine, OrderFinding
from crankorder.plot.reading import Numbered as Numbered
from crankorder.plot.reading import at_one_speed as at_one_speed
from crankorder.plot.reading import decimals_of
from crankorder.plot.reading import frequency_text as frequency_text
from crankorder.plot.reading import interval_of as interval_of
from crankorder.plot.reading import is_number as is_number
from crankorder.plot.reading import is_tone as is_tone
from crankorder.plot.reading import is_undecided as is_undecided
from crankorder.plot.reading import is_whirl as is_whirl
from crankorder.plot.reading import level_reference as level_reference
from crankorder.plot.reading import nominal_order as nominal_order
from crankorder.plot.reading import number_text as number_text
from crankorder.plot.reading import order_name as order_name
from crankorder.plot.reading import order_text as order_text
from crankorder.plot.reading import order_texts as order_texts
from crankorder.plot.reading import scaling_text as scaling_text

NAME_CHARACTERS = 60
"""Of a name from a file in a sentence; what is longer is cut."""

_SAME_MODE = 1e-3  # share of a frequency within which a natural frequency is that of a crossing


R = TypeVar("R", OrderFinding, MotorLine)
K = TypeVar("K", bound=Hashable)


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


def short(text: object) -> str:
    """``text`` from a file, such as a name, as a sentence has it: safe to show, at most 60 characters."""
    return printable(text, NAME_CHARACTERS)


def at_speed(rpm: float | None) -> str:
    """``" at 1800 rpm"``; empty where the speed is not known."""
    return f" at {rpm:.0f} rpm" if is_number(rpm) else ""


def order_estimate(record: Numbered, findings: Findings) -> str:
    """Order of a ``record`` with its interval, ``"5.500 (5.497…5.503)"``; without one its name in the ``findings``."""
    return estimate_text(record, "order") if getattr(record, "order_ci95", None) else order_name(record, findings)


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


def estimate_text(record: object, key: str, *, unit: str = "") -> str:
    """Estimate with its 95 % interval: ``"0.83 (0.81…0.85) m/s²"``; ``"–"`` where there is none.

    ``record`` one of the findings; ``key`` the estimate's name; ``unit`` follows where given.
    """
    return with_interval(getattr(record, key), getattr(record, f"{key}_ci95", None), unit=unit)


def level_text(findings: Findings, record: InChannel) -> str:
    """Amplitude of a ``record`` of the ``findings`` in a sentence: ``"0.83 m/s² (0.81…0.85)"``."""
    value, _, interval = estimate_text(record, "amplitude").partition(" ")
    return " ".join(part for part in (value, unit_of(findings, record), interval) if part)


def with_interval(value: object, ends: Sequence[object] | None, *, unit: str = "") -> str:
    """``value`` with the ``ends`` of its 95 % interval, to the digits that this earns, and its ``unit`` where given."""
    if not is_number(value):
        return "–"
    tail = f" {unit}" if unit else ""
    low, high = ends or (None, None)
    if not is_number(low) or not is_number(high):
        return number_text(float(value)) + tail
    decimals = decimals_of(high - low, float(value))
    if not -1 <= decimals <= 6:
        return f"{number_text(float(value))} ({number_text(low)}…{number_text(high)}){tail}"
    texts = [f"{number:.{max(decimals, 0)}f}".replace("-", "−") for number in (float(value), low, high)]
    return f"{texts[0]} ({texts[1]}…{texts[2]}){tail}"


def listed(words: Sequence[str], *, most: int | None = None) -> str:
    """``words`` as in a sentence: ``"X, Y and Z"``; ``" and more"`` behind the first ``most`` where there are more."""
    first = words[:most]
    text = " and ".join(filter(None, (", ".join(first[:-1]), first[-1]))) if first else ""
    return f"{text} and more" if len(first) < len(words) else text


def strongest_by(records: Sequence[R], key: Callable[[R], K]) -> dict[K, R]:
    """The largest of ``records`` by each ``key`` that they have; of equal ones the first."""
    return {key(record): record for record in sorted(records, key=lambda one: -one.amplitude)[::-1]}
