"""What is said of the energy above the band that was looked at: how much, and whether the strongest line lies there."""

from __future__ import annotations

import math

from crankorder.channel_units import unit_text
from crankorder.findings import Findings, Level, LimitVerdict
from crankorder.report.notation import (
    NAME_CHARACTERS,
    estimate_text,
    frequency_text,
    is_number,
    listed,
    named,
    number_text,
    percent_text,
    unit_of,
    with_interval,
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
    said = [
        f"{percent_text(share)} of that of {named(one.channel, limit=NAME_CHARACTERS)}" for share, one in much[:_MANY]
    ]
    more = ", less in the others" if len(known) > min(len(much), _MANY) else ""
    return [f"Energy above the band looked at{_band(end)}: {listed(said)}{more}."]


def _band(hertz: object) -> str:
    """``" (to 500 Hz)"``; nothing where the end is not known as a frequency."""
    return f" (to {frequency_text(float(hertz))} Hz)" if is_number(hertz) else ""


def level_sentences(findings: Findings) -> list[str]:
    """The largest broad-band velocity in ``findings``, in the words of ISO 20816-1; none where none was told."""
    told = [record for record in findings.vibration_levels if record.quantity == "velocity" and record.largest]
    told = [record for record in told if record.band_hz == told[0].band_hz]
    if not told:
        return []
    worst = max(told, key=lambda one: one.rms)
    at = f" at {worst.speed_rpm:.0f} rpm" if is_number(worst.speed_rpm) else ""
    level = estimate_text(worst, "rms", unit=unit_text(worst.unit))
    return [
        f"The largest broad-band velocity (r.m.s., {band_of(worst.band_hz, worst.reached_hz)}) is {level}, in "
        f"{named(worst.channel, limit=NAME_CHARACTERS)}{at}."
    ]


def limit_sentences(findings: Findings, *, above: bool = False) -> list[str]:
    """What each limit in ``findings`` comes to, those that are passed most first; with ``above`` these alone."""
    rank = {"above": 0, "not decided": 1}
    records = [one for one in findings.limits if one.verdict == "above" or not above]
    return [_limit_sentence(one) for one in sorted(records, key=lambda one: (rank.get(one.verdict, 2), -_share(one)))]


def undecided_limits(findings: Findings) -> list[str]:
    """Which limits in ``findings`` are not decided, for which channels and why: a sentence each, of many the first."""
    said: dict[tuple[str, str], list[str]] = {}
    for one in findings.limits:
        if one.verdict == "not decided":
            limit = with_interval(one.value, None, unit=unit_text(one.unit))
            what = one.quantity if one.band_hz is None else f"r.m.s. {one.quantity}, {band_of(one.band_hz, None)}"
            key = (f"{limit} ({what}; {named(one.source, limit=2 * NAME_CHARACTERS)})", one.evidence)
            said.setdefault(key, []).append(named(one.channel, limit=NAME_CHARACTERS) if one.channel else "")
    made = []
    for (limit, why), names in list(said.items())[:_MANY]:
        shown = [name for name in names if name][:_MANY]
        more = f" and {len(names) - _MANY} more" if len(names) > _MANY else ""
        where = f" for {listed(shown) if not more else ', '.join(shown)}{more}" if shown else ""
        made.append(f"The limit of {limit} is not decided{where}, because {why or 'nothing tells the level'}.")
    rest = len(said) - _MANY
    return [*made, f"{rest} more limits are not decided: see their table."] if rest > 0 else made


def _share(record: LimitVerdict) -> float:
    """Level over limit of ``record``; 0 where no level is known."""
    return record.level / record.value if is_number(record.level) else 0.0


def _limit_sentence(record: LimitVerdict) -> str:
    what = f"The {record.quantity}" if record.band_hz is None else f"The r.m.s. {record.quantity}"
    band = f" ({band_of(record.band_hz, record.band_hz[1])})" if record.band_hz is not None else ""
    where = f" of {named(record.channel, limit=NAME_CHARACTERS)}" if record.channel else ""
    unit = unit_text(record.unit)
    limit = f"{with_interval(record.value, None, unit=unit)} ({named(record.source, limit=2 * NAME_CHARACTERS)})"
    at = f" at {record.speed_rpm:.0f} rpm" if is_number(record.speed_rpm) else ""
    level = with_interval(record.level, record.level_ci95, unit=unit)
    if record.verdict == "not decided":
        size = f": {level}{at}" if is_number(record.level) else ""
        return f"{what}{band}{where} beside the limit of {limit} is not decided{size}; {record.evidence}."
    return f"{what}{band}{where} is {record.verdict} the limit of {limit}: {level}{at}."


def band_of(band_hz: tuple[float | None, float | None], reached_hz: float | None) -> str:
    """``band_hz`` as "10 Hz to 1000 Hz", with its end at ``reached_hz`` where the recorder reaches no further."""
    low, high = band_hz
    if is_number(reached_hz) and is_number(high) and reached_hz < high:
        return f"{low:g} Hz to {reached_hz:.4g} Hz, as far as recorded"
    return f"{low:g} Hz to {high:g} Hz"
