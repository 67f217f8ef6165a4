"""The lines of a test in plain sentences: orders of the shaft, tones of fixed frequency, and natural frequencies.

Of the motor that a manifest states: how it slips, which lines are its own, and what they speak for.
"""

from __future__ import annotations

from collections.abc import Iterable

from crankorder.findings import Findings, Level, LineFinding, ModeFinding, Motor, MotorLine, MotorSpeed, OrderFinding
from crankorder.plot.fixed_lines import fixed_tones, hertz_of_order, strongest_tone
from crankorder.report.notation import (
    NAME_CHARACTERS,
    at_one_speed,
    frequency_text,
    is_in_doubt,
    is_number,
    is_tone,
    is_undecided,
    is_whirl,
    level_text,
    listed,
    named,
    nominal_order,
    order_name,
    order_texts,
    percent_text,
    strongest_by,
    unit_of,
)
from crankorder.report.sentences.of_bearings import bearing_lines
from crankorder.report.sentences.of_levels import above_sentence, look_above, stronger_above

LIKE_UNBALANCE = "unbalance, bent shaft or misalignment"
"""Cause of an order 1 of which nothing tells what it is."""

_MEETING_SHARE = 0.03  # an order line this close to a natural frequency is said to meet it
_MANY = 3  # channels that a summary names one by one
_SHOWN = 14  # orders or tones that a sentence lists
_MOSTLY = 0.5  # share of the energy from which something is most of it

SHAFT_SIDES = "motor, pole-pass sideband of order 1 of the motor"
FIELD_SIDES = "motor, pole-pass sideband of twice mains"

_SPEAKS_FOR = {
    SHAFT_SIDES: "a broken or cracked rotor bar makes such, and so does a load that pulsates",
    FIELD_SIDES: "an air gap that changes as the rotor turns (an eccentric or bent rotor) makes such, or a broken bar",
}


def line_sentences(findings: Findings) -> list[str]:
    """What shakes: the strongest line of each channel of ``findings``, the strongest first, then what else there is."""
    names = _channels(findings)
    if not names:
        return [*_above(findings), no_order_sentence(findings), *slow_sentences(findings)]
    sentences = [*_above(findings), *(strongest_sentence(findings, name, with_cause=True) for name in names[:_MANY])]
    if len(names) > _MANY:
        sentences.append("The tables hold the other channels.")
    orders = sorted(
        {nominal_order(record) for record in findings.orders if is_number(record.order) and not record.electric}
    )
    if orders:
        texts = order_texts(orders)
        end = " and more." if len(texts) > _SHOWN else "."
        sentences.append(f"{len(orders)} order{'s' * (len(orders) > 1)} found: {', '.join(texts[:_SHOWN])}{end}")
    return [*sentences, *slow_sentences(findings), *_broadband(findings)]


def slow_sentences(findings: Findings) -> list[str]:
    """That something stands below the lowest order that the frames tell, where ``findings`` have it."""
    return [f"{flag.detail[:1].upper()}{flag.detail[1:]}." for flag in findings.quality if flag.flag == "slow_lines"]


def _above(findings: Findings) -> list[str]:
    """That the strongest line of a channel lies above the band, of the channel where it is largest; else nothing."""
    return [above_sentence(findings, one) for one in _strongest_above(findings)]


def above_asks(findings: Findings) -> list[str]:
    """What to do where ``findings`` say that the strongest line of a channel lies above the band; else nothing."""
    return [asked for asked in map(look_above, _strongest_above(findings)) if asked]


def _strongest_above(findings: Findings) -> list[Level]:
    """Levels of the channel with the largest line above the band that is the strongest of its channel; else none."""
    found = []
    for record in findings.levels:
        channel = record.channel
        if (above := stronger_above(findings, channel, _largest(findings, channel))) is not None:
            found.append(above)
    units = list(dict.fromkeys(str(one.unit) for one in found))
    found.sort(key=lambda one: (units.index(str(one.unit)), -(one.amplitude_above or 0.0)))
    return found[:1]


def lies_above(findings: Findings) -> bool:
    """Whether the first of :func:`line_sentences` of ``findings`` says that the strongest line is above the band."""
    return bool(_strongest_above(findings))


def nothing_proven(findings: Findings) -> bool:
    """True where ``findings`` hold no line because too few revolutions were recorded, not because there is none."""
    return _is_short(findings) and not _channels(findings)


def _is_short(findings: Findings) -> bool:
    return any(flag.flag == "short_recording" for flag in findings.quality)


def no_order_sentence(findings: Findings) -> str:
    """What is said where ``findings`` list no order: none stands, or none could be proven, and apart from what."""
    what = "order could be proven" if _is_short(findings) else "order stands above the noise"
    band = " in the band that was looked at" if lies_above(findings) else ""
    why = ": the recordings hold too few revolutions" if _is_short(findings) else ""
    lines = listed([f"the {name}" for name in dict.fromkeys(name for name, _ in bearing_lines(findings))])
    return f"{f'Apart from {lines} no' if lines else 'No'} {what}{band}{why}."


def _channels(findings: Findings) -> list[str]:
    """Channels with a line, the strongest first among those of one unit; units in the order of the channels."""
    top: dict[str, tuple[str, float]] = {}
    seen = [one.channel for one in findings.orders] + [one.channel for one in findings.lines]
    for channel in dict.fromkeys(seen):
        records = [one for one in (_strongest_of(findings.orders, channel), strongest_tone(findings, channel)) if one]
        if records:
            best = max(records, key=lambda one: one.size)
            top[channel] = unit_of(findings, best), best.size
    known = [one.name for one in findings.channels]
    ordered = sorted(top, key=lambda name: known.index(name) if name in known else len(known))
    units = list(dict.fromkeys(top[name][0] for name in ordered))
    return sorted(ordered, key=lambda name: (units.index(top[name][0]), -top[name][1]))


def _largest(findings: Findings, channel: str) -> float:
    """Amplitude of the strongest line in a ``channel``, order or tone; 0 where it has none."""
    lines = (_strongest_of(findings.orders, channel), strongest_tone(findings, channel))
    return max((line.size for line in lines if line is not None), default=0.0)


def _strongest_of(orders: Iterable[OrderFinding], channel: str) -> OrderFinding | None:
    records = [record for record in orders if record.channel == channel and is_number(record.amplitude)]
    record = max(records, key=lambda one: one.amplitude, default=None)
    return record if record is not None and record.amplitude > 0 else None


def strongest_sentence(findings: Findings, channel: str, *, with_cause: bool = False) -> str:
    """``"Order 2 is the strongest line in Z: 0.83 m/s² (0.81…0.85) at 1800 rpm, where it meets the 60 Hz …"``

    ``findings`` of the test; ``channel`` whose strongest line, order or fixed tone, is asked for; ``with_cause`` adds
    what makes it. Empty where it has none.
    """
    order, tone = _strongest_of(findings.orders, channel), strongest_tone(findings, channel)
    above = stronger_above(findings, channel, _largest(findings, channel))
    where = named(channel, limit=NAME_CHARACTERS) + ("" if above is None else " in the band that was looked at")
    if tone is not None and (order is None or tone.size > order.size):
        noun = "line at" if at_one_speed(findings) else "fixed tone of"
        text = f"A {noun} {_tone_hz(tone)} Hz is the strongest line in {where}: {level_text(findings, tone)}"
        if order is not None:
            hertz = hertz_of_order(order, findings)
            name = order_name(order, findings)
            called = f"order is {name}" if hertz is None else f"other line is {_called(hertz, name)}"
            text += f"; the strongest {called}: {level_text(findings, order)}"
            rpm = order.speed_rpm_at_max
            text += f" at {rpm:.0f} rpm" if is_number(rpm) else ""
        return f"{text}.{_cause(tone, findings) if with_cause else ''}"
    if order is None:
        return ""
    if "unresolved" in order.doubts:
        return _unresolved(findings, order, where)
    hertz = hertz_of_order(order, findings)
    name = order_name(order, findings)
    called = f"Order {name}" if hertz is None else f"A line at {_called(hertz, name)}"
    text = f"{called} is the strongest line in {where}: {_at(findings, order)}"
    return f"{text}.{_cause(order, findings) if with_cause else ''}"


def _unresolved(findings: Findings, order: OrderFinding, where: str) -> str:
    """What is said where something stronger than all orders that are told was not resolved."""
    near, rpm = order_name(order, findings), order.speed_rpm_at_max
    text = f"What is strongest in {where} was not resolved: near order {near}, {level_text(findings, order)}"
    text += f" at {rpm:.0f} rpm" if is_number(rpm) else ""
    told = _strongest_of([one for one in findings.orders if "unresolved" not in one.doubts], order.channel)
    if told is not None:
        text += (
            f"; of the orders that are told {order_name(told, findings)} is the strongest: {level_text(findings, told)}"
        )
    return f"{text}."


def _called(hertz: float, order: str) -> str:
    """``"48.35 Hz (order 5.492)"``: a line whose frequency says more than its order."""
    return f"{hertz:.2f} Hz (order {order})"


def _tone_hz(tone: ModeFinding | LineFinding) -> str:
    """Frequency of a tone to a tenth of a hertz: tones are sharp."""
    return f"{tone.frequency_hz:.1f}".removesuffix(".0")


def _at(findings: Findings, record: OrderFinding) -> str:
    text, rpm = level_text(findings, record), record.speed_rpm_at_max
    if not is_number(rpm):
        return text
    text += f" at {rpm:.0f} rpm"
    mode_hz = met_mode_hz(record)
    if mode_hz is None:
        return text
    hertz = f"{frequency_text(mode_hz)} Hz"
    met = (
        f"{hertz}, which may be a natural frequency"
        if is_in_doubt(mode_hz, findings)
        else f"the {hertz} natural frequency"
    )
    return f"{text}, where it meets {met}"


def met_mode_hz(record: OrderFinding) -> float | None:
    """Natural frequency [Hz] that an order ``record`` meets where it is largest, or None."""
    rpm = record.speed_rpm_at_max
    if not is_number(rpm):
        return None
    line_hz = record.order * float(rpm) / 60
    mode_hz = record.meets_hz
    return mode_hz if is_number(mode_hz) and abs(mode_hz - line_hz) <= _MEETING_SHARE * mode_hz else None


def _cause(record: OrderFinding | LineFinding, findings: Findings) -> str:
    cause, in_doubt = str(record.explained_by or "unexplained"), bool(findings.speed_doubt)
    if record.kinds == ("unexplained",):
        return " Its cause is not known."
    if record.kinds == ("tone",):
        if in_doubt:
            return " Whether it follows the shaft is not decided, for the speed is in doubt."
        if at_one_speed(findings):
            return " At one speed nothing tells whether it follows the shaft."
        return " The tone does not follow the shaft: it has a source of its own."
    if in_doubt:
        return f" Cause, if the speed is right: {named(cause, limit=2 * NAME_CHARACTERS)}."
    return f" Cause: {named(cause, limit=2 * NAME_CHARACTERS)}{_untold(record, findings)}."


def _untold(record: OrderFinding | LineFinding, findings: Findings) -> str:
    """Why nothing tells which of the causes of an order ``record`` it is, where these are those of order 1."""
    if not isinstance(record, OrderFinding) or record.kinds != (LIKE_UNBALANCE,):
        return ""
    if "few speeds" not in record.doubts:
        return "; how it grows does not tell which"
    return "; one speed cannot tell which" if at_one_speed(findings) else "; so few speeds cannot tell which"


def tone_sentences(findings: Findings) -> list[str]:
    """Tones and mains of the ``findings`` with their amplitudes: they are no natural frequencies."""
    texts = []
    for tone in fixed_tones(findings)[:_SHOWN]:
        kind = named(tone.record.explained_by, limit=NAME_CHARACTERS)
        text = f"{_tone_hz(tone.record)} Hz ({kind}"
        if tone.lines and is_number(tone.lines[0].amplitude):
            line = tone.lines[0]
            text += f", {level_text(findings, line)} in {named(line.channel, limit=NAME_CHARACTERS)}"
        texts.append(f"{text}{_or_mode(tone.record, findings)})")
    texts += _mains_among_orders(findings)
    if not texts:
        return []
    if len(texts) == 1:
        return [f"A tone, no natural frequency: {texts[0]}."]
    return [f"Tones, no natural frequencies: {listed(texts)}."]


def _or_mode(tone: ModeFinding, findings: Findings) -> str:
    """That a natural frequency may stand at a ``tone`` too, where the ``findings`` do not decide it."""
    beside = any(tone.frequency_hz in mode.lines_there_hz for mode in findings.modes)
    return "; a natural frequency may be there too" if beside else ""


def _mains_among_orders(findings: Findings) -> list[str]:
    """Lines of the mains among the orders of ``findings``, each in the channel where it is strongest."""
    lines = [
        record
        for record in findings.orders
        # a motor has sentences of its own
        if "mains" in record.kinds and not findings.motor and hertz_of_order(record, findings)
    ]
    return [
        f"{one.order * (one.speed_rpm_at_max or 0.0) / 60.0:.2f} Hz "
        f"({named(one.explained_by, limit=NAME_CHARACTERS)}, {level_text(findings, one)} in "
        f"{named(one.channel, limit=NAME_CHARACTERS)})"
        for _, one in sorted(strongest_by(lines, lambda one: one.order).items())
    ][:_SHOWN]


def _broadband(findings: Findings) -> list[str]:
    """Where most of the energy lies between the lines: a page that names lines alone would mislead."""
    channels = findings.energy.channels if findings.energy is not None else ()
    loud = [
        (named(one.channel, limit=NAME_CHARACTERS), one.modes_and_floor)
        for one in channels
        if is_number(one.modes_and_floor) and one.modes_and_floor > _MOSTLY
    ]
    if not loud:
        return []
    said = [f"{name} {percent_text(share)}" for name, share in loud[:_MANY]]
    more = ", …" if len(loud) > _MANY else ""
    return [f"Most of the energy is broadband, at natural frequencies and in the noise floor: {', '.join(said)}{more}."]


_MOST_MODES = 16  # natural frequencies that a sentence lists
_DOUBTS = 3  # … and doubts, each with its reason


def mode_sentences(findings: Findings) -> list[str]:
    """Natural frequencies of ``findings``, then those that are not decided, with the reason."""
    modes = [mode for mode in findings.modes if is_number(mode.frequency_hz) and not is_tone(mode)]
    fixed = [mode for mode in modes if not is_undecided(mode) and not is_whirl(mode)]
    own = [f"{frequency_text(mode.frequency_hz)} Hz" for mode in fixed]
    sentences = []
    if own:
        noun = "Natural frequencies" if len(own) > 1 else "Natural frequency"
        sentences.append(f"{noun}: {listed(own[:_MOST_MODES])}{' and more' if len(own) > _MOST_MODES else ''}.")
    sentences += [_of_whirl(mode) for mode in modes if is_whirl(mode)]
    doubts = [mode for mode in modes if is_undecided(mode)]
    for mode in _once_each(doubts)[:_DOUBTS]:
        reason = named(mode.undecided or "", limit=4 * NAME_CHARACTERS).rstrip(".")
        text = f"{frequency_text(mode.frequency_hz)} Hz may be a natural frequency: not decided"
        sentences.append(f"{text}; {reason}." if reason else f"{text}.")
    if (rest := len(doubts) - min(len(_once_each(doubts)), _DOUBTS)) > 0:
        noun = "lines are" if rest > 1 else "line is"
        sentences.append(f"{rest} more {noun} not decided: see their table.")
    return sentences


def _once_each(doubts: list[ModeFinding]) -> list[ModeFinding]:
    """``doubts`` of which those beside one and the same named line are one."""
    beside: dict[tuple[float, ...], ModeFinding] = {}
    for number, mode in enumerate(doubts):
        beside.setdefault(mode.lines_there_hz or (-1.0 - number,), mode)
    return list(beside.values())


def _of_whirl(mode: ModeFinding) -> str:
    """The sentence of a natural frequency that moves with the speed."""
    slope, rpm = mode.speed_slope or 0.0, mode.reference_rpm
    at = f" at {float(rpm):.0f} rpm" if is_number(rpm) else ""
    kind, moves = ("Forward", "rising") if slope > 0.0 else ("Backward", "falling")
    return f"{kind} whirl: {frequency_text(mode.frequency_hz)} Hz{at}, {moves} by {abs(slope):.2f} orders."


def motor_sentences(findings: Findings) -> list[str]:
    """How the motor of ``findings`` slips and which of its lines stand; empty where none is stated."""
    motor = findings.motor
    if motor is None:
        return []
    if motor.misfit:
        return [f"No line of the motor is named: {named(motor.misfit, limit=400)}."]
    sentences = _slip(motor)
    lines = [line for line in motor.lines if is_number(line.frequency_hz)]
    sentences += [text for name in _SPEAKS_FOR if (text := _sides(name, lines, findings))]
    strongest = strongest_by(lines, lambda line: (line.name, str(line.side))).values()
    own = [line for line in strongest if line.name not in _SPEAKS_FOR]
    if own:
        listing = [
            f"{line.frequency_hz:.2f} Hz ({' or '.join([name, *(named(other, limit=80) for other in line.others)])}, "
            f"{_motor_level(findings, line)} in {named(line.channel, limit=NAME_CHARACTERS)})"
            for line in sorted(own, key=lambda line: line.frequency_hz)
            for name in [named(line.name, limit=NAME_CHARACTERS).removeprefix("motor, ")]
        ]
        sentences.append(f"Of the motor and its supply: {listed(listing)}.")
    return sentences or ["No line of the motor stands above the noise."]


def _slip(motor: Motor) -> list[str]:
    speeds = [one for one in motor.speeds if one.fits]
    if not speeds:
        return []
    by = "as its own lines measure" if motor.supply_measured else "as stated: no line of the mains measures it"
    slow, fast = (pick(speeds, key=lambda one: one.slip) for pick in (max, min))
    text = f"The motor ({motor.poles} poles at {motor.supply_hz:.5g} Hz, {by}) slips by {_slip_text(fast)}"
    if slow is not fast:
        text += f" to {_slip_text(slow)}"
    if motor.supply_measured:
        ends = dict.fromkeys(f"{one.pole_pass_hz:.3g}" for one in (fast, slow))
        text += f"; its pole-pass frequency is {' to '.join(ends)} Hz"
    left_out = sum(not one.fits for one in motor.speeds)
    more = [f"At {left_out} of {left_out + len(speeds)} speeds its poles and supply do not fit, and no line is named."]
    return [f"{text}.", *(more if left_out else [])]


def _slip_text(one: MotorSpeed) -> str:
    low, high = (100.0 * end for end in one.slip_ci95)
    wide = f" ({max(low, 0.0):.2g}…{high:.2g})" if high - low > 0.1 else ""
    return f"{100.0 * one.slip:.3g} %{wide} at {one.speed_rpm:.4g} rpm"


def _sides(name: str, lines: list[MotorLine], findings: Findings) -> str:
    """Sentence on one pair of pole-pass sidebands; empty where none stands."""
    beside = name.removeprefix("motor, pole-pass sideband of ")
    own = [line for line in lines if line.name == name]
    if not own:
        return ""
    alone = [line for line in own if not line.others] or own
    top = max(alone, key=lambda line: line.amplitude)
    pair = sorted((line for line in own if line.channel == top.channel), key=lambda line: line.frequency_hz)
    said = listed([f"{line.frequency_hz:.2f} Hz{_or_others(line)}" for line in pair])
    share = _carrier_share(top, lines, findings, beside)
    verb = "are its" if len(pair) > 1 else "is one of its"
    size = f", up to {_motor_level(findings, top)}{share}"
    return f"Beside {beside}, {said} {verb} pole-pass sidebands{size}: {_SPEAKS_FOR[name]}."


def _carrier_share(top: MotorLine, lines: list[MotorLine], findings: Findings, beside: str) -> str:
    """Share of the carrier that a sideband has in its channel; empty where that was not found."""
    if beside == "twice mains":
        sizes = [one.amplitude for one in lines if one.name == beside and one.channel == top.channel]
    else:
        turns = [one for one in findings.orders if one.channel == top.channel]
        sizes = [one.amplitude for one in turns if is_number(one.order) and abs(one.order - 1.0) < 1e-3]
    return f", {percent_text(top.amplitude / float(max(sizes)))} of it" if sizes and max(sizes) > 0 else ""


def _or_others(line: MotorLine) -> str:
    others = [named(one, limit=NAME_CHARACTERS) for one in line.others or []]
    return f" (or {' or '.join(others)}, which stands there too)" if others else ""


def _motor_level(findings: Findings, line: MotorLine) -> str:
    return f"{line.amplitude:.3g} {unit_of(findings, line)}".strip()
