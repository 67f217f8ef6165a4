"""What is said of the energy above the band that was looked at: how much, and whether the strongest line lies there."""

from __future__ import annotations

import math

from crankorder.channel_units import unit_text
from crankorder.findings import Findings, Level, LimitVerdict
from crankorder.plot.reading import (
    NAME_CHARACTERS,
    at_speed,
    estimate_text,
    frequency_text,
    is_number,
    listed,
    named,
    number_text,
    percent_text,
    short,
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


def above_sentence(findings: Findings, level: Level) -> str:
    """That the strongest line of a channel lies above the band, by its ``level`` in the ``findings``."""
    order, hertz = level.order_above, level.frequency_hz_above
    places = [f"{frequency_text(hertz)} Hz"] if is_number(hertz) else []
    places += [f"order {number_text(order)}"] if is_number(order) else []
    size = f"{number_text(level.amplitude_above or 0.0)} {unit_of(findings, level)}".strip()
    recipe = GEAR_RECIPE if is_number(order) and order <= GEAR_ORDER else FULL_RECIPE
    return (
        f"The strongest line in {short(level.channel)} lies above the band that was looked at"
        f"{_band(level.band_hz_there)}: about {', '.join(places)}{at_speed(level.speed_rpm_above)}, about {size}. "
        f"The recipe {recipe} looks there."
    )


def look_above(level: Level) -> str:
    """What to do about the strongest line of a channel above the band, by its ``level``; empty without a place."""
    order, hertz = level.order_above, level.frequency_hz_above
    how = "a recipe of your own that states "
    if is_number(order) and order <= GEAR_ORDER - BESIDE:
        how = f"`--recipe {GEAR_RECIPE}`, which finds orders to {GEAR_ORDER:g}"
    elif is_number(order):
        how += f"`max_order = {_beyond(order):.0f}` under `[orders]`"
    elif is_number(hertz):
        how += f"`max_frequency_hz = {_beyond(hertz):.0f}` under `[campbell]`"
    else:
        return ""
    return (
        f"Run it again with {how}: the strongest line in {short(level.channel)} lies above the band that was looked at."
    )


def _beyond(value: float) -> float:
    """A round number above ``value`` with room for sidebands and the floor beside it."""
    step = 10.0 ** math.floor(math.log10(value))
    return math.ceil(1.1 * value / step * 2.0) * step / 2.0


def share_sentences(findings: Findings) -> list[str]:
    """Share of the energy of each channel above the band, by the ``findings``; nothing where none was worked out."""
    shares = [(level.share_above, level) for level in findings.levels if is_number(level.share_above)]
    if not shares:
        return []
    shares.sort(key=lambda pair: -pair[0])
    end = _band(shares[0][1].band_hz)
    texts = [
        f"{percent_text(share)} of that of {short(level.channel)}" for share, level in shares if share >= _WORTH_SAYING
    ]
    if not texts:
        return [f"Less than 0.5 % of the energy of any channel lies above the band looked at{end}."]
    more = ", less in the others" if len(shares) > len(texts[:_MANY]) else ""
    return [f"Energy above the band looked at{end}: {listed(texts[:_MANY])}{more}."]


def _band(hertz: float | None) -> str:
    """``" (to 500 Hz)"``; nothing where the end is not known as a frequency."""
    return f" (to {frequency_text(hertz)} Hz)" if is_number(hertz) else ""


def level_sentences(findings: Findings) -> list[str]:
    """The largest broad-band velocity in ``findings``, in the words of ISO 20816-1; none where none was worked out."""
    levels = [level for level in findings.vibration_levels if level.quantity == "velocity" and level.largest]
    if not levels:
        return []
    worst = max((level for level in levels if level.band_hz == levels[0].band_hz), key=lambda level: level.rms)
    size = estimate_text(worst, "rms", unit=unit_text(worst.unit))
    return [
        f"The largest broad-band velocity (r.m.s., {band_of(worst.band_hz, worst.reached_hz)}) is {size}, in "
        f"{short(worst.channel)}{at_speed(worst.speed_rpm)}."
    ]


def limit_sentences(findings: Findings, *, above: bool = False) -> list[str]:
    """What each limit in ``findings`` comes to, those that are passed most first; with ``above`` these alone."""
    records = [record for record in findings.limits if record.verdict == "above" or not above]
    return [_limit_sentence(record) for record in sorted(records, key=_gravity)]


def _gravity(record: LimitVerdict) -> tuple[int, float]:
    """Sort key of limits: exceeded ones first, then undecided ones, each by the ratio of level to limit."""
    rank = {"above": 0, "not decided": 1}.get(record.verdict, 2)
    return rank, -record.level / record.value if is_number(record.level) else 0.0


def _limit_sentence(record: LimitVerdict) -> str:
    what = f"The {record.quantity}"
    if record.band_hz is not None:
        what = f"The r.m.s. {record.quantity} ({band_of(record.band_hz, None)})"
    what += f" of {short(record.channel)}" if record.channel else ""
    unit = unit_text(record.unit)
    limit = f"{with_interval(record.value, None, unit=unit)} ({named(record.source, limit=2 * NAME_CHARACTERS)})"
    level = estimate_text(record, "level", unit=unit) + at_speed(record.speed_rpm)
    if record.verdict == "not decided":
        size = f": {level}" if is_number(record.level) else ""
        return f"{what} beside the limit of {limit} is not decided{size}; {record.evidence}."
    return f"{what} is {record.verdict} the limit of {limit}: {level}."


def undecided_limits(findings: Findings) -> list[str]:
    """Which limits in ``findings`` are not decided, for which channels and why: a sentence each, of many the first."""
    channels: dict[tuple[str, str], list[str]] = {}
    for record in findings.limits:
        if record.verdict == "not decided":
            limit = with_interval(record.value, None, unit=unit_text(record.unit))
            band = "" if record.band_hz is None else f", {band_of(record.band_hz, None)}"
            what = f"r.m.s. {record.quantity}{band}" if band else record.quantity
            key = (f"{limit} ({what}; {named(record.source, limit=2 * NAME_CHARACTERS)})", record.evidence)
            channels.setdefault(key, []).append(short(record.channel) if record.channel else "")
    sentences = []
    for (limit, why), names in list(channels.items())[:_MANY]:
        first, rest = [name for name in names if name][:_MANY], len(names) - _MANY
        text = f"{', '.join(first)} and {rest} more" if rest > 0 else listed(first)
        where = f" for {text}" if first else ""
        sentences.append(f"The limit of {limit} is not decided{where}, because {why or 'nothing tells the level'}.")
    rest = len(channels) - _MANY
    return sentences + [f"{rest} more limits are not decided: see their table."] * (rest > 0)


def band_of(band_hz: tuple[float | None, float | None], reached_hz: float | None) -> str:
    """``band_hz`` as "10 Hz to 1000 Hz", with its end at ``reached_hz`` where the recorder reaches no further."""
    low, high = band_hz
    if is_number(reached_hz) and is_number(high) and reached_hz < high:
        return f"{low:g} Hz to {reached_hz:.4g} Hz, as far as recorded"
    return f"{low:g} Hz to {high:g} Hz"
