"""What is said of speeds: which to avoid, which are free, and of which nothing can be said."""

from __future__ import annotations

import math

from crankorder.channel_units import unit_text
from crankorder.findings import AvoidedSpeed, Findings, Level, LimitVerdict, SpeedSwing
from crankorder.plot.reading import (
    NAME_CHARACTERS,
    SAME_MODE,
    at_one_speed,
    at_speed,
    estimate_text,
    free_bands,
    frequency_text,
    interval_of,
    is_in_doubt,
    is_number,
    least_of,
    level_text,
    listed,
    named,
    nominal_order,
    number_text,
    open_bands,
    order_name,
    order_texts,
    percent_text,
    reason_text,
    short,
    unit_of,
    wide_bands,
    with_interval,
)
from crankorder.records import known

_PAIRS = 4  # crossings that a sentence names
_OF_ENCODER = {1.0: "an eccentric", 2.0: "an oval"}  # orders that an encoder off its centre makes
_ONE_SHARE = 0.85  # shares of the speed whose least is so much of the largest are one
_SIDES = 8  # orders that a sentence names as likely sidebands
_NO_SOURCES = "Sidebands that a swing of the shaft makes of stronger orders may be all there is of"
_SHOWN = 3  # free bands that a sentence names, the widest
_GRAVEST = "above", "not decided", "within"  # verdicts on limits


def speed_sentence(findings: Findings) -> str:
    """The worst speed to avoid of ``findings`` and how many more there are; else which are free, or why none is.

    Empty where nothing is known of speeds.
    """
    if avoided := findings.speeds_to_avoid:
        others = f"; the worst of {len(avoided)} speeds to avoid" * (len(avoided) > 1)
        return f"{_avoided(findings, avoided[0], most=1)[0]}{others}."
    sentences = free_sentences(findings)
    if not free_bands(findings):
        return " ".join(sentences)
    rest = " The rest is not free, or not known." * (len(sentences) > 1)
    return f"No speed to avoid was found. {sentences[0]}{rest}"


def avoid_sentences(findings: Findings) -> list[str]:
    """One sentence for each of the speeds to avoid of ``findings``, the worst first."""
    sentences = []
    for record in findings.speeds_to_avoid or ():
        text, pairs = _avoided(findings, record, most=_PAIRS)
        text += f", and {pairs - _PAIRS} more meet" if pairs > _PAIRS else ""
        if peak := _peak(findings, record):
            text += f"; order {order_name(record, findings)}{' alone' if pairs > 1 else ''}: {peak}"
        sentences.append(f"{text}.")
    return sentences


def _avoided(findings: Findings, record: AvoidedSpeed, *, most: int) -> tuple[str, int]:
    """Speed to avoid with ``most`` of the orders that meet natural frequencies there, and how many these are."""
    ends = known(record.rpm_range)
    span = f" ({ends[0]:.0f} to {ends[1]:.0f} rpm)" if ends is not None else ""
    meetings = dict.fromkeys(zip(map(nominal_order, record.orders), record.modes_hz, strict=False))
    pairs = [_excites(order, mode_hz, findings) for order, mode_hz in meetings]
    avoid = "If the speed is right, avoid" if findings.speed_doubt else "Avoid"
    return f"{avoid} steady running near {record.rpm:.0f} rpm{span}, where {listed(pairs[:most])}", len(pairs)


def _excites(order: float, mode_hz: float, findings: Findings) -> str:
    """That an order excites a natural frequency, or peaks where one may be."""
    name, hertz = order_name(order, findings), frequency_text(mode_hz)
    if is_in_doubt(mode_hz, findings):
        return f"order {name} peaks at {hertz} Hz, which may be a natural frequency"
    of_order = [crossing for crossing in findings.crossings if nominal_order(crossing) == order]
    excited = [crossing.excited for crossing in of_order if abs(crossing.mode_hz - mode_hz) < SAME_MODE * mode_hz]
    verb = "excites" if any(excited) or not excited else "peaks near"
    return f"order {name} {verb} the {hertz} Hz natural frequency"


def _peak(findings: Findings, record: AvoidedSpeed) -> str:
    """Peak amplitude and amplification of the order at a speed to avoid, as text; empty where unknown."""
    parts = []
    if is_number(record.amplitude) and record.amplitude > 0:
        where = f" in {short(record.channel)}" if record.channel else ""
        held = "calculated by the modal fit for a held speed" if record.by_fit else "as recorded"
        parts.append(f"peak {'at least ' * record.at_least}{level_text(findings, record)}{where}, {held}")
    if is_number(record.amplification) and record.amplification > 0:
        parts.append(f"amplified {_amplified(record)} times")
    return ", ".join(parts)


def _amplified(record: AvoidedSpeed) -> str:
    """Amplification of a ``record``: its interval, its lower end alone where it has no upper one, else the number."""
    least = least_of(record, "amplification")
    ends = interval_of(record, "amplification") or (record.amplification if least is None else least,)
    text = " to ".join(dict.fromkeys(number_text(end, digits=2) for end in ends))
    return text if least is None else f"at least {text}"


def all_judged(findings: Findings) -> bool:
    """Whether ``findings`` leave no tested speed open; also True where they do not state open bands."""
    return findings.open_bands is None or bool(free_bands(findings) and not open_bands(findings))


def doubt_sentences(findings: Findings) -> list[str]:
    """Sentences that the speed of the ``findings`` is in doubt, and why; empty where it is not."""
    reason = reason_text(findings.speed_doubt)
    return [f"The speed is in doubt, and with it every order, cause and crossing: {reason}."] * bool(reason)


def shaft_sentences(findings: Findings) -> list[str]:
    """Sentences on the speeds of a shaft alone and how unevenly it turned; empty for other ``findings``."""
    low, high = (findings.speed_range_rpm if not findings.channels else None) or (None, None)
    if low is None or high is None:
        return []
    speeds = f"{low:.0f} rpm" if round(low) == round(high) else f"{low:.0f} to {high:.0f} rpm"
    return [f"The shaft turned at {speeds}.", *swing_sentences(findings)]


def swing_sentences(findings: Findings) -> list[str]:
    """How unevenly the shaft of the ``findings`` turns: the orders of the recording whose speed swings most, if any."""
    swings = [swing for swing in findings.speed_swing if swing.speed_rpm > 0.0]
    by_swing = (record for record in findings.orders if "sideband by a swing of the angle" in record.kinds)
    sides = sorted(set(map(nominal_order, by_swing)))
    more = [f"{len(sides) - _SIDES} more"] if len(sides) > _SIDES else []
    orders = listed([*order_texts(sides)[:_SIDES], *more])
    unsourced = [f"{_NO_SOURCES} order{'s' * (len(sides) > 1)} {orders}."] if sides else []
    if not swings:
        return unsourced
    worst = max(swings, key=lambda swing: swing.amplitude_rpm / swing.speed_rpm)
    own = [swing for swing in swings if swing.recording == worst.recording][:_SHOWN]
    texts = [
        f"order {number_text(swing.order)} by ± {number_text(swing.amplitude_rpm)} rpm "
        f"({percent_text(swing.amplitude_rpm / worst.speed_rpm)})"
        for swing in own
    ]
    where = f"{worst.speed_rpm:.0f} rpm ({short(worst.recording)})"
    doubt = _of_an_encoder(swings, [swing.order for swing in own])
    return [f"The speed itself swings, as the encoder shows it, most at {where}: {listed(texts)}.{doubt}", *unsourced]


def _of_an_encoder(swings: list[SpeedSwing], orders: list[float]) -> str:
    """That an encoder off its centre would show the same of the first of ``orders`` that it can make.

    Its error is one angle at all speeds, and so is the share of the speed that it shows; a shaft's changes with load
    and speed.
    """
    for order, name in _OF_ENCODER.items():
        own = [swing for swing in swings if swing.order == order and swing.may_be_encoder]
        shares = {round(swing.speed_rpm): swing.amplitude_rpm / swing.speed_rpm for swing in own}
        if order in orders and shares and min(shares.values()) >= _ONE_SHARE * max(shares.values()):
            at_one = "at the one speed at which it is told"
            alike = "by one share of the speed at all speeds" if len(shares) > 1 else at_one
            return f" Order {order:g} swings {alike}: {name} encoder would show the same."
    return ""


def free_sentences(findings: Findings) -> list[str]:
    """Where ``findings`` allow steady running, the widest bands; and where they cannot tell, with the first reason."""
    free, unknown = free_bands(findings), wide_bands(findings.open_bands or ())
    sentences = []
    if free:
        widest = sorted(sorted(free, key=lambda band: band[0] - band[1])[:_SHOWN])
        more = " and narrower bands" if len(free) > _SHOWN else ""
        ends = listed([f"{low:.0f} to {high:.0f}" for low, high in widest])
        remark = reason_text(wide_bands(findings.free_bands)[0].remark)
        free_of = "If the speed is right, free of resonances" if findings.speed_doubt else "Free of resonances"
        sentences.append(f"{free_of}: {ends} rpm{more}{f'; {remark}' if remark else ''}.")
    elif at_one_speed(findings):
        return ["A test at one speed cannot tell which speeds are free of resonances."]
    elif findings.open_bands is not None and not findings.speeds_to_avoid:
        sentences.append("No speed of the tested range can be called free of resonances.")
    if unknown:
        widest_open = max(unknown, key=lambda band: band.high_rpm - band.low_rpm)
        reason = reason_text(widest_open.remark.split("; ")[0])
        others = f" (and {len(unknown) - 1} more {'bands' if len(unknown) > 2 else 'band'})" if len(unknown) > 1 else ""
        ends = f"{widest_open.low_rpm:.0f} to {widest_open.high_rpm:.0f}"
        sentences.append(f"Not free, or not known: {ends} rpm{others}: {reason}.")
    return sentences


GEAR_RECIPE, GEAR_ORDER = "gear-mesh", 60.0
"""The recipe that finds orders above those of the default, and the order to which it looks."""

FULL_RECIPE = "maps-full-band"
"""The recipe that maps all that was recorded."""

BESIDE = 1.0
"""Orders below the end of a recipe's band that a line must lie, so that its sidebands and floor are in it."""

_MANY_CHANNELS = 4  # channels that a sentence names one by one
_WORTH_SAYING = 0.005  # share of the energy below which a channel is not named


def above_sentence(findings: Findings, level: Level) -> str:
    """Sentence that the strongest line of a channel lies above the band, by its ``level`` in the ``findings``."""
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
    if is_number(order) and order <= GEAR_ORDER - BESIDE:
        how = f"`--recipe {GEAR_RECIPE}`, which finds orders to {GEAR_ORDER:g}"
    elif is_number(order):
        how = f"a recipe of your own that states `max_order = {_beyond(order):.0f}` under `[orders]`"
    elif is_number(hertz):
        how = f"a recipe of your own that states `max_frequency_hz = {_beyond(hertz):.0f}` under `[campbell]`"
    else:
        return ""
    where = f"the strongest line in {short(level.channel)} lies above the band that was looked at"
    return f"Run it again with {how}: {where}."


def _beyond(value: float) -> float:
    """A round number above ``value`` with room for sidebands and the floor beside it."""
    step = 10.0 ** math.floor(math.log10(value))
    return math.ceil(1.1 * value / step * 2.0) * step / 2.0


def share_sentences(findings: Findings) -> list[str]:
    """Share of the energy of each channel above the band, by the ``findings``; nothing where none was worked out."""
    levels = [(level.share_above, level) for level in findings.levels if is_number(level.share_above)]
    if not levels:
        return []
    levels.sort(key=lambda pair: -pair[0])
    end, above = _band(levels[0][1].band_hz), [pair for pair in levels[:_MANY_CHANNELS] if pair[0] >= _WORTH_SAYING]
    if not above:
        return [f"Less than 0.5 % of the energy of any channel lies above the band looked at{end}."]
    texts = [f"{percent_text(share)} of that of {short(level.channel)}" for share, level in above]
    more = ", less in the others" * (len(levels) > len(texts))
    return [f"Energy above the band looked at{end}: {listed(texts)}{more}."]


def _band(hertz: float | None) -> str:
    """``" (to 500 Hz)"``; nothing where the end is not known as a frequency."""
    return f" (to {frequency_text(hertz)} Hz)" if is_number(hertz) else ""


def level_sentences(findings: Findings) -> list[str]:
    """The largest broad-band velocity in ``findings``, in the words of ISO 20816-1; none where none was worked out."""
    levels = [level for level in findings.vibration_levels if level.quantity == "velocity" and level.largest]
    if not levels:
        return []
    worst = max((level for level in levels if level.band_hz == levels[0].band_hz), key=lambda level: level.rms)
    size = f"{estimate_text(worst, 'rms', unit=unit_text(worst.unit))}, in {short(worst.channel)}"
    what = f"The largest broad-band velocity (r.m.s., {band_of(worst.band_hz, worst.reached_hz)})"
    return [f"{what} is {size}{at_speed(worst.speed_rpm)}."]


def limits_sentence(findings: Findings) -> str:
    """Whether the limits of ``findings`` are kept: the gravest that is not, and how many more; empty without limits."""
    others = sum(record.verdict != "within" for record in findings.limits) - 1
    if others < 0:
        return "All limits that were stated are kept." if findings.limits else ""
    more = f" {others} more {'are' if others > 1 else 'is'} exceeded or not decided: see the table of limits."
    return f"{limit_sentences(findings)[0]}{more * (others > 0)}"


def limit_sentences(findings: Findings) -> list[str]:
    """Sentences on each limit in ``findings``, the most exceeded first."""
    by_excess = sorted(findings.limits, key=lambda limit: -(limit.level or 0.0) / limit.value)
    return [_limit_sentence(record) for verdict in _GRAVEST for record in by_excess if record.verdict == verdict]


def _limit_sentence(record: LimitVerdict) -> str:
    unit, band = unit_text(record.unit), record.band_hz
    what = f"The {record.quantity}" if band is None else f"The r.m.s. {record.quantity} ({band_of(band, None)})"
    what += f" of {short(record.channel)}" if record.channel else ""
    limit = f"{with_interval(record.value, None, unit=unit)} ({named(record.source, limit=2 * NAME_CHARACTERS)})"
    level = estimate_text(record, "level", unit=unit) + at_speed(record.speed_rpm)
    if record.verdict == "not decided":
        size = f": {level}" if is_number(record.level) else ""
        why = reason_text(record.evidence) or "nothing tells the level"
        return f"Whether {what[0].lower()}{what[1:]} is above the limit of {limit} is not decided{size}; {why}."
    return f"{what} is {record.verdict} the limit of {limit}: {level}."


def band_of(band_hz: tuple[float | None, float | None], reached_hz: float | None) -> str:
    """``band_hz`` as "10 Hz to 1000 Hz", with its end at ``reached_hz`` where the recorder reaches no further."""
    low, high = band_hz
    is_cut = is_number(reached_hz) and is_number(high) and reached_hz < high
    return f"{low:g} Hz to " + (f"{reached_hz:.4g} Hz, as far as recorded" if is_cut else f"{high:g} Hz")
