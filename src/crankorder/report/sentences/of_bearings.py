"""What is said of bearings: which of their lines are seen, where, with what slip, and what that means."""

from __future__ import annotations

from crankorder.findings import BearingFinding, Findings
from crankorder.records import known
from crankorder.report.notation import (
    NAME_CHARACTERS,
    estimate_text,
    interval_of,
    is_number,
    level_text,
    listed,
    named,
    nominal_order,
    number_text,
    order_name,
)

RE_RUN_RULE = "Re-run the same test: a growing amplitude means a failing bearing."

_LINE_NAMES = {
    "N*fs": "rolling-element count (N·fs)",
    "BPFO": "outer-race (BPFO)",
    "BPFI": "inner-race (BPFI)",
    "BSF": "ball-spin (BSF)",
    "FTF": "cage (FTF)",
}
_LETTERS = 400  # of a verdict


def bearing_sentences(findings: Findings, *, with_rule: bool = True) -> list[str]:
    """One sentence per bearing line of ``findings`` that was seen; ``with_rule`` adds the rule of its verdict."""
    sentences = []
    for name, best in bearing_lines(findings):
        text = f"Order {order_name(best, findings)} fits the {name}: {_seen(findings, best)}."
        sentences.append(text + _verdict(best) + (f" {RE_RUN_RULE}" if with_rule and asks_re_run(best) else ""))
    return sentences


def bearing_lines(findings: Findings) -> list[tuple[str, BearingFinding]]:
    """What each bearing line of ``findings`` that was seen is called, with its largest record.

    Faults go first, those that strike before those that only sound.
    """
    groups: dict[tuple[float, str, str], list[BearingFinding]] = {}
    for record in findings.bearings:
        if is_number(record.amplitude) and is_number(record.order):
            key = nominal_order(record), record.line, str(record.seen_in)
            groups.setdefault(key, []).append(record)
    lines = []
    for (_, line, _), records in sorted(
        groups.items(), key=lambda group: (group[0][1] == "N*fs", group[0][2] != "envelope")
    ):
        names = list(dict.fromkeys(named(record.name, limit=NAME_CHARACTERS) for record in records))
        which = _LINE_NAMES.get(line, named(line, limit=NAME_CHARACTERS))
        best = max(records, key=lambda record: record.size)
        noun = " bearings" if len(names) != 1 else "" if names[0].lower().endswith("bearing") else " bearing"
        lines.append((f"{which} line of the {listed(names)}{noun}", best))
    return lines


def asks_re_run(record: BearingFinding) -> bool:
    """True where the verdict of a bearing ``record`` asks to run the test again, or where none was worked out."""
    return record.lock is None or record.re_run


def _seen(findings: Findings, record: BearingFinding) -> str:
    """Amplitude, where and at which speed it is so large, and slip of a line."""
    text = level_text(findings, record)
    if record.channel:
        text += f" in {named(record.channel, limit=NAME_CHARACTERS)}"
    if record.is_mean:
        text += ", its mean over all speeds"
    elif is_number(record.speed_rpm):
        text += f" at {record.speed_rpm:.0f} rpm"
    if record.seen_in == "envelope":
        band = band_text(record)
        text += f", in the envelope of {band} Hz" if band else ", in the envelope"
    if interval_of(record, "slip_percent") is not None and record.lock != "locked":
        text += f", slip {estimate_text(record, 'slip_percent')} %"
    harmonics = record.harmonics
    if is_number(harmonics) and harmonics > 1:
        text += f", {harmonics:.0f} multiples"
    return text


def band_text(record: BearingFinding) -> str:
    """Band of the envelope of a bearing ``record`` in Hz, such as ``"2000–4000"``; empty where there is none."""
    return "–".join(f"{end:.0f}" if end >= 100 else number_text(end) for end in known(record.band_hz) or ())


def _verdict(record: BearingFinding) -> str:
    """Sentences of the verdict but the rule to re-run, which is said once."""
    parts = [part.strip().rstrip(".") for part in named(record.verdict, limit=_LETTERS).split(". ")]
    return "".join(f" {part[0].upper()}{part[1:]}." for part in parts if part and "re-run" not in part.lower())
