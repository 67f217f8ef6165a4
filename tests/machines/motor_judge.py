"""What the program says of a motor rig, held against what was put in."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crankorder.report.sentences.of_lines import LIKE_UNBALANCE
from machines.lines import PARTS
from machines.motor_rig import Line, MotorRig, write_folder
from made.command import analysed

WORDS_OF = {
    "bar pass": "motor, bar pass",
    "bar pass sideband": "motor, sideband of bar pass at twice mains",
    "pole pass sideband of 1x": "motor, pole-pass sideband of order 1 of the motor",
    "pole pass sideband of 2f": "motor, pole-pass sideband of twice mains",
}

SAME_HZ = 0.06
"""Hz within which a line that was found is one that was put in: two cycles in 30 s."""


@dataclass(frozen=True)
class Verdict:
    """One statement: its ``kind``, whether it is ``good``, and what it is about."""

    kind: str
    good: bool
    words: str


def findings_of(rig: MotorRig, folder: Path) -> dict[str, Any]:
    """Findings of ``rig`` by the command, in the new ``folder``, without pictures."""
    write_folder(rig, folder / "test")
    recipe = 'title = "Findings"\ndescription = "Nothing else."\n[report]\nresults = ["findings"]\n'
    (folder / "findings-alone.toml").write_text(recipe, encoding="utf-8")
    return analysed(folder / "test", folder / "out", "--recipe", folder / "findings-alone.toml", "--jobs", 1)


def words_of(line: Line) -> str:
    """What ``line`` is to be called."""
    if line.cause == "mains":
        return {1: "mains", 2: "twice mains"}.get(line.multiple, f"{line.multiple} x mains")
    return WORDS_OF.get(line.cause, "")


def said_of(findings: dict[str, Any]) -> list[tuple[str, float, float, float | None]]:
    """Every line of ``findings``: its words, its frequency in Hz, how far that may err, and the speed, None for all."""
    said: list[tuple[str, float, float, float | None]] = []
    for one in findings["orders"]:
        hertz = one["order"] * one["speed_rpm_at_max"] / 60.0
        half = 0.5 * (one["order_ci95"][1] - one["order_ci95"][0]) * one["speed_rpm_at_max"] / 60.0
        said.append((str(one["explained_by"]), hertz, half, one["speed_rpm_at_max"]))
    for one in findings["modes"]:
        half = 0.5 * (one["frequency_hz_ci95"][1] - one["frequency_hz_ci95"][0])
        said.append((str(one["explained_by"]), one["frequency_hz"], half, None))
    for one in (findings.get("motor") or {}).get("lines", []):
        text = " or ".join([one["name"], *one["or"]])
        said.append((text, one["frequency_hz"], 0.0, one["speed_rpm"]))
    return said


def judged(rig: MotorRig, findings: dict[str, Any]) -> list[Verdict]:
    """Verdicts on ``findings`` of ``rig``: nothing "made up", every line "named", two at one place "both"."""
    said = said_of(findings)
    verdicts = [_made_up(rig, *one) for one in said if any(part in one[0] for part in PARTS)]
    each = {(line.cause, line.multiple, line.side): line for take in rig.takes for line in take.lines if words_of(line)}
    for line in each.values():
        verdicts.append(_named(rig, line, said))
    return verdicts


def _truths(rig: MotorRig, hertz: float, half: float, rpm: float | None) -> list[Line]:
    """Lines that were put in at ``hertz``, of the recordings at ``rpm`` (None: of all)."""
    found = []
    for take in rig.takes:
        if rpm is None or take.rpm[0] * 0.998 <= rpm <= take.rpm[1] * 1.002:
            found += [line for line in take.lines if abs(line.at(rpm or take.rpm[0]) - hertz) <= SAME_HZ + half]
    return found


def _made_up(rig: MotorRig, text: str, hertz: float, half: float, rpm: float | None) -> Verdict:
    """Whether one of the causes that ``text`` names is there."""
    truths = _truths(rig, hertz, half, rpm)
    names = {words_of(line) for line in truths if words_of(line)}
    named = text.split(" or ")
    shaft = any(line.cause == "shaft" for line in truths)
    good = bool(names & set(named)) or (shaft and any(_is_shaft(part) for part in named))
    return Verdict("nothing made up", good, f"{rig.class_name} {rig.seed}: {text} at {hertz:.3f} Hz")


def _is_shaft(text: str) -> bool:
    parts_of_order_1 = LIKE_UNBALANCE.split(" or ")
    return text in ("unbalance", *parts_of_order_1, "shaft harmonic", "order") or text.startswith("order ")


def _named(rig: MotorRig, line: Line, said: list[tuple[str, float, float, float | None]]) -> Verdict:
    """Whether ``line`` is named in a recording that has it; where an order of the shaft is there too, with that."""
    wanted, found, both = words_of(line), False, True
    for text, hertz, half, rpm in said:
        alike = [one for one in _truths(rig, hertz, half, rpm) if (one.cause, one.side) == (line.cause, line.side)]
        if wanted in text.split(" or ") and alike:
            found = True
            on = [take for take in rig.takes if line.hz and _on_an_order(take.rpm[0], take.duration_s, line)]
            both = both and (len(on) < len(rig.takes) or " or " in text)
    kind = "both said" if rig.class_name == "synchronous" else "named"
    what = f"{rig.class_name} {rig.seed}: {wanted} at {line.at(rig.takes[0].rpm[0]):.3f} Hz, {line.size:.2f}"
    return Verdict(kind, found and both, what)


def _on_an_order(rpm: float, duration_s: float, line: Line) -> bool:
    """Whether ``line`` lies on a whole order for all that a recording of ``duration_s`` can tell."""
    order = line.at(rpm) * 60.0 / rpm
    return abs(order - round(order)) * rpm / 60.0 * duration_s < 0.5
