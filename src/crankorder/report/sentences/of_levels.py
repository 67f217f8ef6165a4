"""What is said of the energy above the band that was looked at: how much, and whether the strongest line lies there."""

from __future__ import annotations

import math

from crankorder.findings import Findings, Level
from crankorder.report.notation import (
    NAME_CHARACTERS,
    frequency_text,
    is_number,
    listed,
    named,
    number_text,
    percent_text,
    unit_of,
)

GEAR_RECIPE, GEAR_ORDER = "gear-mesh", 60.0
"""The recipe that finds orders above those of the default, and the order to which it looks."""

FULL_RECIPE = "maps-full-band"
"""The recipe that maps all that was recorded."""

BESIDE = 1.0
"""Orders below the end of a recipe's band that a line must lie, so that its sidebands and floor are in it."""

_MANY = 4  # channels that a sentence names one by one
_WORTH_SAYING = 0.005  # share of the energy below which a channel is not named


def stronger_above(findings: Findings, channel: str, amplitude: float) -> Level | None:
    """Levels of ``channel`` in ``findings`` where a line above the band is larger than ``amplitude``, else None."""
    for record in findings.levels:
        above = record.amplitude_above
        if record.channel == channel and is_number(above) and above > amplitude:
            return record
    return None


def above_sentence(findings: Findings, record: Level) -> str:
    """That the strongest line of a channel lies above the band, by its ``record`` in the levels of ``findings``."""
    where, order, hertz = named(record.channel, limit=NAME_CHARACTERS), None, record.frequency_hz_above
    if is_number(record.order_above):
        order = record.order_above
    places = [f"{frequency_text(float(hertz))} Hz"] if is_number(hertz) else []
    places += [f"order {number_text(order)}"] if order is not None else []
    rpm = record.speed_rpm_above
    at = f" at {rpm:.0f} rpm" if is_number(rpm) else ""
    level = f"{number_text(record.amplitude_above or 0.0)} {unit_of(findings, record)}".strip()
    recipe = GEAR_RECIPE if order is not None and order <= GEAR_ORDER else FULL_RECIPE
    end = _band(record.band_hz_there)
    return (
        f"The strongest line in {where} lies above the band that was looked at{end}: about "
        f"{', '.join(places)}{at}, about {level}. The recipe {recipe} looks there."
    )


def look_above(record: Level) -> str:
    """What to do about the strongest line of a channel above the band, by its ``record`` in the levels."""
    where, order = named(record.channel, limit=NAME_CHARACTERS), record.order_above
    if not is_number(order):
        hertz = record.frequency_hz_above
        reach = f"`max_frequency_hz = {_beyond(float(hertz)):.0f}` under `[campbell]`" if is_number(hertz) else ""
        return _run_again(where, f"a recipe of your own that states {reach}") if reach else ""
    if float(order) <= GEAR_ORDER - BESIDE:
        return _run_again(where, f"`--recipe {GEAR_RECIPE}`, which finds orders to {GEAR_ORDER:g}")
    return _run_again(
        where, f"a recipe of your own that states `max_order = {_beyond(float(order)):.0f}` under `[orders]`"
    )


def _run_again(where: str, how: str) -> str:
    return f"Run it again with {how}: the strongest line in {where} lies above the band that was looked at."


def _beyond(value: float) -> float:
    """A round number above ``value`` with room for sidebands and the floor beside it."""
    step = 10.0 ** math.floor(math.log10(value))
    return math.ceil(1.1 * value / step * 2.0) * step / 2.0


def share_sentences(findings: Findings) -> list[str]:
    """Share of the energy of each channel above the band, by the ``findings``; nothing where none was worked out."""
    known = [(one.share_above, one) for one in findings.levels if is_number(one.share_above)]
    if not known:
        return []
    known.sort(key=lambda item: -item[0])
    end = known[0][1].band_hz
    much = [(share, one) for share, one in known if share >= _WORTH_SAYING]
    if not much:
        return [f"Less than 0.5 % of the energy of any channel lies above the band looked at{_band(end)}."]
    said = [f"{percent_text(share)} of that of {_name(one)}" for share, one in much[:_MANY]]
    more = ", less in the others" if len(known) > min(len(much), _MANY) else ""
    return [f"Energy above the band looked at{_band(end)}: {listed(said)}{more}."]


def _name(record: Level) -> str:
    return named(record.channel, limit=NAME_CHARACTERS)


def _band(hertz: object) -> str:
    """``" (to 500 Hz)"``; nothing where the end is not known as a frequency."""
    return f" (to {frequency_text(float(hertz))} Hz)" if is_number(hertz) else ""
