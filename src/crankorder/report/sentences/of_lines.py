"""The lines of a test in plain sentences: orders of the shaft, tones of fixed frequency, and natural frequencies.

Of bearings: which of their lines are seen, where, with what slip, and what that means. Of the motor that a manifest
states: how it slips, which lines are its own, and what they speak for.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from crankorder.findings import BearingFinding, Findings, Level, LineFinding, ModeFinding, Motor, OrderFinding
from crankorder.plot.reading import (
    NAME_CHARACTERS,
    at_one_speed,
    at_speed,
    estimate_text,
    fixed_tones,
    frequency_text,
    hertz_of_order,
    interval_of,
    is_in_doubt,
    is_number,
    is_tone,
    is_undecided,
    is_whirl,
    level_text,
    listed,
    named,
    nominal_order,
    number_text,
    order_name,
    order_texts,
    percent_text,
    reason_text,
    short,
    strongest_by,
    strongest_tone,
    unit_of,
)
from crankorder.records import known
from crankorder.report.sentences.of_speeds import above_sentence, look_above

LIKE_UNBALANCE = "unbalance, bent shaft or misalignment"
"""Cause of an order 1 of which nothing tells what it is."""

RE_RUN_RULE = "Re-run the same test: an amplitude that grows speaks for a failing bearing."

SHAFT_SIDES = "motor, pole-pass sideband of order 1 of the motor"
FIELD_SIDES = "motor, pole-pass sideband of twice mains"

_SPEAKS_FOR = {
    SHAFT_SIDES: "a broken or cracked rotor bar makes such, and so does a load that pulsates",
    FIELD_SIDES: "an air gap that changes as the rotor turns (an eccentric or bent rotor) makes such, or a broken bar",
}
_BEARING_LINES = {
    "N*fs": "rolling-element count (N·fs)",
    "BPFO": "outer-race (BPFO)",
    "BPFI": "inner-race (BPFI)",
    "BSF": "ball-spin (BSF)",
    "FTF": "cage (FTF)",
}
_MEETING_SHARE = 0.03  # an order line this close to a natural frequency is said to meet it
_MANY = 3  # channels that a summary names one by one
_SHOWN = 14  # orders or tones that a sentence lists
_MOSTLY = 0.5  # share of the energy from which something is most of it
_MOST_MODES = 16  # natural frequencies that a sentence lists
_DOUBTS = 3  # … and doubts, each with its reason


def line_sentences(findings: Findings) -> list[str]:
    """What shakes: the strongest line of each channel of ``findings``, the strongest first, then other lines."""
    names = _channels(findings)
    sentences = [above_sentence(findings, level) for level in _stronger_above(findings)[:1]]
    if not names:
        return [*sentences, no_order_sentence(findings), *slow_sentences(findings)]
    sentences += [strongest_sentence(findings, name, with_cause=True) for name in names[:_MANY]]
    if len(names) > _MANY:
        sentences.append("The tables hold the other channels.")
    orders = order_texts(sorted({nominal_order(record) for record in findings.orders if not record.electric}))
    if orders:
        end = " and more." if len(orders) > _SHOWN else "."
        sentences.append(f"{len(orders)} order{'s' * (len(orders) > 1)} found: {', '.join(orders[:_SHOWN])}{end}")
    return [*sentences, *slow_sentences(findings), *_broadband(findings)]


def slow_sentences(findings: Findings) -> list[str]:
    """Sentences on lines below the lowest order that the frames resolve, where ``findings`` have any."""
    return [f"{flag.detail[:1].upper()}{flag.detail[1:]}." for flag in findings.quality if flag.flag == "slow_lines"]


def line_asks(findings: Findings) -> list[str]:
    """What to do about bearings in ``findings``, and where the strongest line of a channel lies above the band."""
    asks = [RE_RUN_RULE] * any(_asks_re_run(record) for _, record in bearing_lines(findings))
    return asks + [ask for level in _stronger_above(findings)[:1] if (ask := look_above(level))]


def lies_above(findings: Findings) -> bool:
    """Whether the first of :func:`line_sentences` of ``findings`` says that the strongest line is above the band."""
    return bool(_stronger_above(findings))


def _stronger_above(findings: Findings) -> list[Level]:
    """Levels of the channels whose strongest line lies above the band, by unit, the largest such line first."""
    levels = []
    for level in findings.levels:
        strongest = _strongest_line(findings, level.channel)
        if is_number(level.amplitude_above) and level.amplitude_above > (strongest.size if strongest else 0.0):
            levels.append(level)
    units = list(dict.fromkeys(level.unit for level in levels))
    return sorted(levels, key=lambda level: (units.index(level.unit), -(level.amplitude_above or 0.0)))


def nothing_proven(findings: Findings) -> bool:
    """True where ``findings`` hold no line because too few revolutions were recorded, not because there is none."""
    return _is_short(findings) and not _channels(findings)


def _is_short(findings: Findings) -> bool:
    return any(flag.flag == "short_recording" for flag in findings.quality)


def no_order_sentence(findings: Findings) -> str:
    """Sentence for ``findings`` without orders: none stands out, or none could be proven, and which lines do stand."""
    what = "order could be proven" if _is_short(findings) else "order stands above the noise"
    band = " in the band that was looked at" if lies_above(findings) else ""
    why = ": the recordings hold too few revolutions" if _is_short(findings) else ""
    lines = listed([f"the {name}" for name in dict.fromkeys(name for name, _ in bearing_lines(findings))])
    return f"{f'Apart from {lines} no' if lines else 'No'} {what}{band}{why}."


def _channels(findings: Findings) -> list[str]:
    """Channels with a line, the strongest first among those of one unit; units in the order of the channels."""
    names = [channel.name for channel in findings.channels]
    # those that were not analysed go last
    names += [line.channel for lines in (findings.orders, findings.lines) for line in lines]
    strongest = {name: line for name in names if (line := _strongest_line(findings, name))}
    units = list(dict.fromkeys(unit_of(findings, line) for line in strongest.values()))
    return sorted(strongest, key=lambda name: (units.index(unit_of(findings, strongest[name])), -strongest[name].size))


def _strongest_line(findings: Findings, channel: str) -> OrderFinding | LineFinding | None:
    """Strongest line in a ``channel``, order or tone."""
    order, tone = _strongest_order(findings.orders, channel), strongest_tone(findings, channel)
    lines: list[OrderFinding | LineFinding] = [line for line in (order, tone) if line is not None]
    return max(lines, key=lambda line: line.size, default=None)


def _strongest_order(orders: Iterable[OrderFinding], channel: str) -> OrderFinding | None:
    records = (record for record in orders if record.channel == channel and record.amplitude > 0)
    return max(records, key=lambda record: record.amplitude, default=None)


def strongest_sentence(findings: Findings, channel: str, *, with_cause: bool = False) -> str:
    """``"Order 2 is the strongest line in Z: 0.83 m/s² (0.81…0.85) at 1800 rpm, where it meets the 60 Hz …"``

    ``findings`` of the test; ``channel`` whose strongest line, order or fixed tone, is asked for; ``with_cause`` adds
    what makes it. Empty where it has none.
    """
    order, line = _strongest_order(findings.orders, channel), _strongest_line(findings, channel)
    is_above = any(level.channel == channel for level in _stronger_above(findings))
    where = short(channel) + " in the band that was looked at" * is_above
    if order is not None:
        hertz, name = hertz_of_order(order, findings), order_name(order, findings)
        # the frequency of such a line says more than its order
        called = "" if hertz is None else f"{hertz:.2f} Hz (order {name})"
    if isinstance(line, LineFinding):
        noun = "line at" if at_one_speed(findings) else "fixed tone of"
        text = f"A {noun} {_tone_hz(line)} Hz is the strongest line in {where}: {level_text(findings, line)}"
        if order is not None:
            other = f"other line is {called}" if called else f"order is {name}"
            text += f"; the strongest {other}: {level_text(findings, order)}{at_speed(order.speed_rpm_at_max)}"
    elif order is None:
        return ""
    elif "unresolved" in order.doubts:
        text = f"What is strongest in {where} was not resolved: near order {name}, {level_text(findings, order)}"
        text += at_speed(order.speed_rpm_at_max)
        others = [record for record in findings.orders if "unresolved" not in record.doubts]
        if (resolved := _strongest_order(others, channel)) is not None:
            text += f"; of the orders that are told {order_name(resolved, findings)} is the strongest: "
            text += level_text(findings, resolved)
        return f"{text}."
    else:
        subject = f"A line at {called}" if called else f"Order {name}"
        text = f"{subject} is the strongest line in {where}: {level_text(findings, order)}{_at(findings, order)}"
    return f"{text}.{_cause(line, findings) if line and with_cause else ''}"


def _tone_hz(tone: ModeFinding | LineFinding) -> str:
    """Frequency of a tone to a tenth of a hertz: tones are sharp."""
    return f"{tone.frequency_hz:.1f}".removesuffix(".0")


def _at(findings: Findings, record: OrderFinding) -> str:
    """Speed at which an order is largest, and the natural frequency that it meets there."""
    rpm, mode_hz = record.speed_rpm_at_max, record.meets_hz
    at = at_speed(rpm)
    if rpm is None or mode_hz is None or not abs(mode_hz - record.order * rpm / 60) <= _MEETING_SHARE * mode_hz:
        return at
    hertz = f"{frequency_text(mode_hz)} Hz"
    doubt, none = f"{hertz}, which may be a natural frequency", f"the {hertz} natural frequency"
    return f"{at}, where it meets {doubt if is_in_doubt(mode_hz, findings) else none}"


def _cause(record: OrderFinding | LineFinding, findings: Findings) -> str:
    cause, in_doubt = named(record.explained_by or "unexplained", limit=2 * NAME_CHARACTERS), bool(findings.speed_doubt)
    alone = at_one_speed(findings)
    if record.kinds == ("unexplained",):
        return " Its cause is not known."
    if record.kinds in (("tone",), ("order",)):
        if in_doubt:
            return " Whether it follows the shaft is not decided, for the speed is in doubt."
        if alone or record.kinds == ("order",):
            return f" At {'one speed' if alone else 'speeds so alike'} nothing tells whether it follows the shaft."
        return " The tone does not follow the shaft: it has a source of its own."
    if in_doubt:
        return f" Cause, if the speed is right: {cause}."
    if not isinstance(record, OrderFinding) or record.kinds != (LIKE_UNBALANCE,):
        return f" Cause: {cause}."
    few = f"{'one speed' if alone else 'so few speeds'} cannot tell which"
    return f" Cause: {cause}; {few if 'few speeds' in record.doubts else 'how it grows does not tell which'}."


def tone_sentences(findings: Findings) -> list[str]:
    """Tones and mains of the ``findings`` with their amplitudes: they are no natural frequencies."""
    texts = []
    for tone in fixed_tones(findings)[:_SHOWN]:
        text = f"{_tone_hz(tone.record)} Hz ({short(tone.record.explained_by)}"
        if tone.lines and is_number(tone.lines[0].amplitude):
            text += f", {level_text(findings, tone.lines[0])} in {short(tone.lines[0].channel)}"
        beside = any(tone.record.frequency_hz in mode.lines_there_hz for mode in findings.modes)
        texts.append(f"{text}{'; a natural frequency may be there too' * beside})")
    # a motor has sentences of its own
    mains = [record for record in findings.orders if "mains" in record.kinds and not findings.motor]
    mains = [record for record in mains if hertz_of_order(record, findings)]
    texts += [
        f"{hertz_of_order(record, findings):.2f} Hz ({short(record.explained_by)}, "
        f"{level_text(findings, record)} in {short(record.channel)})"
        for _, record in sorted(strongest_by(mains, lambda record: record.order).items())[:_SHOWN]
    ]
    if not texts:
        return []
    subject = "Tones, no natural frequencies" if len(texts) > 1 else "A tone, no natural frequency"
    return [f"{subject}: {listed(texts)}."]


def _broadband(findings: Findings) -> list[str]:
    """Where most of the energy lies between the lines: a page that names lines alone would mislead."""
    loud = [
        f"{short(record.channel)} {percent_text(record.modes_and_floor)}"
        for record in (findings.energy.channels if findings.energy else ())
        if is_number(record.modes_and_floor) and record.modes_and_floor > _MOSTLY
    ]
    shares = ", ".join(loud[:_MANY]) + ", …" * (len(loud) > _MANY)
    return [f"Most of the energy is broadband, at natural frequencies and in the noise floor: {shares}."] * bool(loud)


def mode_sentences(findings: Findings) -> list[str]:
    """Natural frequencies of ``findings``, then those that are not decided, with the reason."""
    modes = [mode for mode in findings.modes if not is_tone(mode)]
    fixed = [mode for mode in modes if not is_undecided(mode) and not is_whirl(mode)]
    sentences = []
    if fixed:
        noun = "Natural frequencies" if len(fixed) > 1 else "Natural frequency"
        hertz = [f"{frequency_text(mode.frequency_hz)} Hz" for mode in fixed]
        sentences.append(f"{noun}: {listed(hertz, most=_MOST_MODES)}.")
    for mode in filter(is_whirl, modes):
        slope = mode.speed_slope or 0.0
        kind, moves = ("Forward", "rising") if slope > 0.0 else ("Backward", "falling")
        place = f"{frequency_text(mode.frequency_hz)} Hz{at_speed(mode.reference_rpm)}"
        sentences.append(f"{kind} whirl: {place}, {moves} by {abs(slope):.2f} orders.")
    sentences += [no_mode_sentence(findings)] * (not sentences and any(map(is_undecided, modes)))
    doubts = [mode for mode in modes if is_undecided(mode)]
    beside: dict[tuple[float, ...], ModeFinding] = {}  # those beside one and the same named line are one
    for number, mode in enumerate(doubts):
        beside.setdefault(mode.lines_there_hz or (-1.0 - number,), mode)
    first = list(beside.values())[:_DOUBTS]
    for mode in first:
        reason = reason_text(mode.undecided)
        text = f"{frequency_text(mode.frequency_hz)} Hz may be a natural frequency: not decided"
        sentences.append(f"{text}; {reason}." if reason else f"{text}.")
    if (rest := len(doubts) - len(first)) > 0:
        sentences.append(f"{rest} more {'lines are' if rest > 1 else 'line is'} not decided: see their table.")
    return sentences


def no_mode_sentence(findings: Findings) -> str:
    """That no natural frequency stands, for ``findings`` without one, and where some may lie that are not decided."""
    hertz = [frequency_text(mode.frequency_hz) for mode in findings.modes if is_undecided(mode)]
    if not hertz:
        return "No natural frequency was found."
    return f"No natural frequency is proven; one may lie near {' Hz, near '.join(hertz[:_MOST_MODES])} Hz."


def bearing_sentence(findings: Findings) -> str:
    """Whether a bearing is failing by ``findings``: yes, no, not decided, or not looked for.

    Empty where they do not state what was looked for.
    """
    lines, looked_for, doubt = bearing_lines(findings), findings.looked_for, findings.speed_doubt
    unheard = "" if "envelope" in looked_for else "; strikes above the band looked at were not looked for"
    if not lines and not {"bearings", "envelope"}.intersection(looked_for):
        none = "no bearing" if findings.limits else "no bearing and no limit"
        return f"Whether anything is failing was not looked for: the manifest names {none}." * bool(looked_for)
    verdict = "Whether a bearing is failing is not decided"
    if not lines and (doubt or nothing_proven(findings)):
        return f"{verdict}: {'the speed is in doubt' if doubt else 'the recordings hold too few revolutions'}."
    if not lines:
        return f"No sign of a failing bearing: no line of those that are named stands out{unheard}."
    name, record = max(lines, key=lambda line: (line[1].damage, _asks_re_run(line[1]), line[1].lock != "locked"))
    order = f"order {order_name(record, findings)}"
    if record.lock == "locked" and not _asks_re_run(record):
        return f"No sign of a failing bearing: {order} lies at the {name} but is exactly locked to the shaft{unheard}."
    where = ", in the envelope" * (record.seen_in == "envelope")
    if where:
        struck = "bearing is damaged" if record.damage else "bearing strikes, and which part is damaged is not decided"
        verdict = f"If the speed is right, a {struck}" if doubt else f"A {struck}"
    return f"{verdict}: {order}, the {name}, has {_level(findings, record)}{where}."


def bearing_sentences(findings: Findings) -> Iterator[str]:
    """One sentence per bearing line of ``findings`` that was seen, with its verdict but for the rule to run again."""
    for name, record in bearing_lines(findings):
        order = "If the speed is right, order" if findings.speed_doubt else "Order"
        text = f"{order} {order_name(record, findings)} fits the {name}: {_seen(findings, record)}."
        parts = [part.strip().rstrip(".") for part in reason_text(record.verdict).split(". ")]
        verdict = [f"{part[0].upper()}{part[1:]}." for part in parts if part and "re-run" not in part.lower()]
        yield " ".join([text, *verdict])


def bearing_lines(findings: Findings) -> list[tuple[str, BearingFinding]]:
    """Name of each bearing line of ``findings`` that was seen, with its largest record.

    Lines of faults come first, "N*fs" (rolling elements times shaft speed) last; of each, those in the envelope first.
    """
    groups: dict[tuple[float, str, str | None], list[BearingFinding]] = {}
    for record in sorted(findings.bearings, key=lambda record: (record.line == "N*fs", record.seen_in != "envelope")):
        if is_number(record.amplitude):
            groups.setdefault((nominal_order(record), record.line, record.seen_in), []).append(record)
    lines = []
    for (_, line, _), records in groups.items():
        names = list(dict.fromkeys(short(record.name) for record in records))
        noun = " bearings" if len(names) != 1 else "" if names[0].lower().endswith("bearing") else " bearing"
        name = f"{_BEARING_LINES.get(line, short(line))} line of the {listed(names)}{noun}"
        lines.append((name, max(records, key=lambda record: (record.damage, record.size))))
    return lines


def _asks_re_run(record: BearingFinding) -> bool:
    """True where the verdict of a bearing ``record`` asks to run the test again, or where none was worked out."""
    return record.lock is None or record.re_run


def _seen(findings: Findings, record: BearingFinding) -> str:
    """Amplitude, where and at which speed it is so large, and slip of a line."""
    text = _level(findings, record)
    if record.seen_in == "envelope":
        band = envelope_band(record)
        text += f", in the envelope of {band} Hz" if band else ", in the envelope"
    if interval_of(record, "slip_percent") is not None and record.lock != "locked":
        text += f", slip {estimate_text(record, 'slip_percent')} %"
    return text + (f", {record.harmonics} multiples" if (record.harmonics or 0) > 1 else "")


def _level(findings: Findings, record: BearingFinding) -> str:
    text = level_text(findings, record) + (f" in {short(record.channel)}" if record.channel else "")
    return text + (", its mean over all speeds" if record.is_mean else at_speed(record.speed_rpm))


def envelope_band(record: BearingFinding) -> str:
    """Band of the envelope of a bearing ``record`` in Hz, such as ``"2000–4000"``; empty where there is none."""
    return "–".join(f"{end:.0f}" if end >= 100 else number_text(end) for end in known(record.band_hz) or ())


def motor_sentences(findings: Findings) -> list[str]:
    """How the motor of ``findings`` slips and which of its lines stand; empty where none is stated."""
    motor = findings.motor
    if motor is None:
        return []
    if motor.misfit:
        return [f"No line of the motor is named: {reason_text(motor.misfit)}."]
    sentences = _slip(motor) + [text for name in _SPEAKS_FOR if (text := _sides(name, motor, findings))]
    strongest = strongest_by(motor.lines, lambda line: (line.name, line.side)).values()
    texts = []
    for line in sorted(strongest, key=lambda line: line.frequency_hz):
        if line.name not in _SPEAKS_FOR:
            names = [short(line.name).removeprefix("motor, "), *(named(other, limit=80) for other in line.others)]
            level = f"{_motor_level(findings, line)} in {short(line.channel)}"
            texts.append(f"{line.frequency_hz:.2f} Hz ({' or '.join(names)}, {level})")
    if texts:
        sentences.append(f"Of the motor and its supply: {listed(texts)}.")
    return sentences or ["No line of the motor stands above the noise."]


def _slip(motor: Motor) -> list[str]:
    speeds = [speed for speed in motor.speeds if speed.fits]
    if not speeds:
        return []
    by = "as its own lines measure" if motor.supply_measured else "as stated: no line of the mains measures it"
    slow, fast = (pick(speeds, key=lambda speed: speed.slip) for pick in (max, min))
    slips = []
    for speed in [fast] if slow is fast else [fast, slow]:
        low, high = (100.0 * end for end in speed.slip_ci95)
        wide = f" ({max(low, 0.0):.2g}…{high:.2g})" if high - low > 0.1 else ""
        slips.append(f"{100.0 * speed.slip:.3g} %{wide} at {speed.speed_rpm:.4g} rpm")
    text = f"The motor ({motor.poles} poles at {motor.supply_hz:.5g} Hz, {by}) slips by {' to '.join(slips)}"
    if motor.supply_measured:
        ends = dict.fromkeys(f"{speed.pole_pass_hz:.3g}" for speed in (fast, slow))
        text += f"; its pole-pass frequency is {' to '.join(ends)} Hz"
    left_out = len(motor.speeds) - len(speeds)
    more = f"At {left_out} of {len(motor.speeds)} speeds its poles and supply do not fit, and no line is named."
    return [f"{text}.", *[more] * (left_out > 0)]


def _sides(name: str, motor: Motor, findings: Findings) -> str:
    """Sentence on one pair of pole-pass sidebands, with their share of the carrier; empty where none stands."""
    carrier = name.removeprefix("motor, pole-pass sideband of ")
    own = sorted((line for line in motor.lines if line.name == name), key=lambda line: line.frequency_hz)
    if not own:
        return ""
    top = max(own, key=lambda line: (not line.others, line.amplitude))
    texts = []
    for line in own:
        if line.channel == top.channel:
            others = f" (or {' or '.join(map(short, line.others))}, which stands there too)" if line.others else ""
            texts.append(f"{line.frequency_hz:.2f} Hz{others}")
    sizes = [(line.channel, line.amplitude) for line in motor.lines if line.name == carrier]
    if carrier != "twice mains":
        sizes = [(record.channel, record.amplitude) for record in findings.orders if abs(record.order - 1.0) < 1e-3]
    largest = max((amplitude for channel, amplitude in sizes if channel == top.channel), default=0.0)
    share = f", {percent_text(top.amplitude / largest)} of it" if largest > 0 else ""
    verb = "are its" if len(texts) > 1 else "is one of its"
    size = f", up to {_motor_level(findings, top)}{share}"
    return f"Beside {carrier}, {listed(texts)} {verb} pole-pass sidebands{size}: {_SPEAKS_FOR[name]}."


def _motor_level(findings: Findings, line: Any) -> str:
    return f"{line.amplitude:.3g} {unit_of(findings, line)}".strip()
