"""What is said of the motor that a manifest states: how it slips, which lines are its own, and what they speak for."""

from __future__ import annotations

from typing import Any

from crankorder.report.notation import NAME_CHARACTERS, is_number, listed, named, percent_text, unit_of

SHAFT_SIDES = "motor, pole-pass sideband of order 1 of the motor"
FIELD_SIDES = "motor, pole-pass sideband of twice mains"
BAR_PASS, BAR_SIDES = "motor, bar pass", "motor, sideband of bar pass at twice mains"
_CARRIERS = {FIELD_SIDES: "twice mains", BAR_SIDES: BAR_PASS}

_SPEAKS_FOR = {
    SHAFT_SIDES: "a broken or cracked rotor bar makes such, and so does a load that pulsates",
    FIELD_SIDES: "an air gap that changes as the rotor turns (an eccentric or bent rotor) makes such, or a broken bar",
}


def motor_sentences(findings: dict[str, Any]) -> list[str]:
    """How the motor of ``findings`` slips and which of its lines were found; empty where none is stated."""
    motor = findings.get("motor")
    if not isinstance(motor, dict):
        return []
    if motor.get("misfit"):
        return [f"No line of the motor is named: {named(motor['misfit'], limit=400)}."]
    sentences = _slip(motor)
    if motor.get("bars_doubt"):
        sentences.append(f"The stated count of rotor bars may be wrong: {named(motor['bars_doubt'], limit=400)}.")
    lines = [line for line in motor.get("lines") or [] if is_number(line.get("frequency_hz"))]
    sentences += [text for name in (SHAFT_SIDES, FIELD_SIDES) if (text := _sides(name, lines, motor, findings))]
    own = [line for line in _strongest(lines) if line["name"] not in _SPEAKS_FOR]
    if own:
        said = [
            f"{_hz(line)} ({' or '.join([_name(line), *(named(one, limit=80) for one in line.get('or') or [])])}, "
            f"{_level(findings, line)} in {named(line.get('channel', ''), limit=NAME_CHARACTERS)})"
            for line in own
        ]
        sentences.append(f"Of the motor and its supply: {listed(said)}.")
    elif not sentences:
        sentences.append("No line of the motor stands above the noise.")
    return sentences


def _slip(motor: dict[str, Any]) -> list[str]:
    if motor.get("speed_doubt"):
        return [f"The slip of the motor is not known: {named(motor['speed_doubt'], limit=400)}."]
    speeds = [one for one in motor.get("speeds") or [] if one.get("fits")]
    if not speeds:
        return []
    by = "as its own lines measure" if motor.get("supply_measured") else "as stated: no line of the mains measures it"
    slow, fast = (pick(speeds, key=lambda one: float(one["slip"])) for pick in (max, min))
    text = f"The motor ({motor['poles']} poles at {float(motor['supply_hz']):.5g} Hz, {by}) slips by {_slip_text(fast)}"
    if slow is not fast:
        text += f" to {_slip_text(slow)}"
    if motor.get("supply_measured"):
        ends = dict.fromkeys(f"{float(one['pole_pass_hz']):.3g}" for one in (fast, slow))
        text += f"; its pole-pass frequency is {' to '.join(ends)} Hz"
    left_out = len(motor.get("speeds") or []) - len(speeds)
    more = [f"At {left_out} of {left_out + len(speeds)} speeds its poles and supply do not fit, and no line is named."]
    return [f"{text}.", *(more if left_out else [])]


def _slip_text(one: dict[str, Any]) -> str:
    low, high = (100.0 * float(end) for end in one["slip_ci95"])
    wide = f" ({max(low, 0.0):.2g}…{high:.2g})" if high - low > 0.1 else ""
    return f"{100.0 * float(one['slip']):.3g} %{wide} at {float(one['speed_rpm']):.4g} rpm"


def _sides(name: str, lines: list[dict[str, Any]], motor: dict[str, Any], findings: dict[str, Any]) -> str:
    """Sentence on one pair of pole-pass sidebands, found or looked for in vain."""
    beside = name.removeprefix("motor, pole-pass sideband of ")
    own = [line for line in lines if line["name"] == name]
    if own:
        alone = [line for line in own if not line.get("or")] or own
        top = max(alone, key=lambda line: float(line["amplitude"]))
        pair = sorted(
            (line for line in own if line["channel"] == top["channel"]), key=lambda line: float(line["frequency_hz"])
        )
        said = listed([f"{_hz(line)}{_or(line)}" for line in pair])
        share = _share(top, lines, findings, beside)
        verb = "are its" if len(pair) > 1 else "is one of its"
        size = f", up to {_level(findings, top)}{share}"
        return f"Beside {beside}, {said} {verb} pole-pass sidebands{size}: {_SPEAKS_FOR[name]}."
    limits = [one for one in motor.get("not_seen") or [] if one["name"] == name]
    if not limits:
        return ""
    worst = max(limits, key=lambda one: float(one["from_amplitude"]))
    size = f"{float(worst['from_amplitude']):.2g} {unit_of(findings, worst)}".strip()
    return f"No pole-pass sidebands stand beside {beside}: they would have been seen from {size}."


def _share(top: dict[str, Any], lines: list[dict[str, Any]], findings: dict[str, Any], beside: str) -> str:
    """Share of the carrier that a sideband has in its channel; empty where that was not found."""
    if beside == "twice mains":
        sizes = [one["amplitude"] for one in lines if one["name"] == beside and one["channel"] == top["channel"]]
    else:
        turns = [one for one in findings.get("orders", []) if one.get("channel") == top["channel"]]
        sizes = [one["amplitude"] for one in turns if is_number(one.get("order")) and abs(one["order"] - 1.0) < 1e-3]
    return f", {percent_text(float(top['amplitude']) / float(max(sizes)))} of it" if sizes and max(sizes) > 0 else ""


def _name(line: dict[str, Any]) -> str:
    return named(line["name"], limit=NAME_CHARACTERS).removeprefix("motor, ")


def _or(line: dict[str, Any]) -> str:
    others = [named(one, limit=NAME_CHARACTERS) for one in line.get("or") or []]
    return f" (or {' or '.join(others)}, which stands there too)" if others else ""


def _strongest(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each line in the channel where it is strongest, lowest first."""
    best: dict[tuple[str, str], dict[str, Any]] = {}
    for line in lines:
        key = str(line["name"]), str(line.get("side", ""))
        if key not in best or float(line["amplitude"]) > float(best[key]["amplitude"]):
            best[key] = line
    return sorted(best.values(), key=lambda line: float(line["frequency_hz"]))


def _hz(line: dict[str, Any]) -> str:
    return f"{float(line['frequency_hz']):.2f} Hz"


def _level(findings: dict[str, Any], line: dict[str, Any]) -> str:
    return f"{float(line['amplitude']):.3g} {unit_of(findings, line)}".strip()
