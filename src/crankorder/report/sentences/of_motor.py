"""What is said of the motor that a manifest states: how it slips, which lines are its own, and what they speak for."""

from __future__ import annotations

from crankorder.findings import Findings, Motor, MotorLine, MotorSpeed
from crankorder.report.notation import NAME_CHARACTERS, is_number, listed, named, percent_text, strongest_by, unit_of

SHAFT_SIDES = "motor, pole-pass sideband of order 1 of the motor"
FIELD_SIDES = "motor, pole-pass sideband of twice mains"

_SPEAKS_FOR = {
    SHAFT_SIDES: "a broken or cracked rotor bar makes such, and so does a load that pulsates",
    FIELD_SIDES: "an air gap that changes as the rotor turns (an eccentric or bent rotor) makes such, or a broken bar",
}


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
    own = [line for line in _strongest(lines) if line.name not in _SPEAKS_FOR]
    if own:
        listing = [
            f"{_hz(line)} ({' or '.join([_name(line), *(named(other, limit=80) for other in line.others)])}, "
            f"{_level(findings, line)} in {named(line.channel, limit=NAME_CHARACTERS)})"
            for line in own
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
    said = listed([f"{_hz(line)}{_or(line)}" for line in pair])
    share = _share(top, lines, findings, beside)
    verb = "are its" if len(pair) > 1 else "is one of its"
    size = f", up to {_level(findings, top)}{share}"
    return f"Beside {beside}, {said} {verb} pole-pass sidebands{size}: {_SPEAKS_FOR[name]}."


def _share(top: MotorLine, lines: list[MotorLine], findings: Findings, beside: str) -> str:
    """Share of the carrier that a sideband has in its channel; empty where that was not found."""
    if beside == "twice mains":
        sizes = [one.amplitude for one in lines if one.name == beside and one.channel == top.channel]
    else:
        turns = [one for one in findings.orders if one.channel == top.channel]
        sizes = [one.amplitude for one in turns if is_number(one.order) and abs(one.order - 1.0) < 1e-3]
    return f", {percent_text(top.amplitude / float(max(sizes)))} of it" if sizes and max(sizes) > 0 else ""


def _name(line: MotorLine) -> str:
    return named(line.name, limit=NAME_CHARACTERS).removeprefix("motor, ")


def _or(line: MotorLine) -> str:
    others = [named(one, limit=NAME_CHARACTERS) for one in line.others or []]
    return f" (or {' or '.join(others)}, which stands there too)" if others else ""


def _strongest(lines: list[MotorLine]) -> list[MotorLine]:
    """Each line in the channel where it is strongest, lowest first."""
    best = strongest_by(lines, lambda line: (line.name, str(line.side)))
    return sorted(best.values(), key=lambda line: line.frequency_hz)


def _hz(line: MotorLine) -> str:
    return f"{line.frequency_hz:.2f} Hz"


def _level(findings: Findings, line: MotorLine) -> str:
    return f"{line.amplitude:.3g} {unit_of(findings, line)}".strip()
