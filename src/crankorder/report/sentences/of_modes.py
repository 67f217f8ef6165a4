"""What is said of natural frequencies: those that are decided, and those that may be something else."""

from __future__ import annotations

from crankorder.findings import Findings, ModeFinding
from crankorder.identify.said import MAY_BE_ALL
from crankorder.report.notation import (
    NAME_CHARACTERS,
    frequency_text,
    is_number,
    is_tone,
    is_undecided,
    is_whirl,
    listed,
    named,
)

_SHOWN = 16  # natural frequencies that a sentence lists
_DOUBTS = 3  # … and doubts, each with its reason


def mode_sentences(findings: Findings) -> list[str]:
    """Natural frequencies of ``findings``, then those that are not decided, with the reason."""
    modes = [mode for mode in findings.modes if is_number(mode.frequency_hz) and not is_tone(mode)]
    fixed = [mode for mode in modes if not is_undecided(mode) and not is_whirl(mode)]
    own = [f"{frequency_text(mode.frequency_hz)} Hz" for mode in fixed]
    sentences = []
    if own:
        noun = "Natural frequencies" if len(own) > 1 else "Natural frequency"
        sentences.append(f"{noun}: {listed(own[:_SHOWN])}{' and more' if len(own) > _SHOWN else ''}.")
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
    said: dict[str, ModeFinding] = {}
    for number, mode in enumerate(doubts):
        last = str(mode.undecided or "").split("; ")[-1]
        said.setdefault(last if last.endswith(MAY_BE_ALL) else str(number), mode)
    return list(said.values())


def _of_whirl(mode: ModeFinding) -> str:
    """The sentence of a natural frequency that moves with the speed."""
    slope, rpm = mode.speed_slope or 0.0, mode.reference_rpm
    at = f" at {float(rpm):.0f} rpm" if is_number(rpm) else ""
    kind, moves = ("Forward", "rising") if slope > 0.0 else ("Backward", "falling")
    return f"{kind} whirl: {frequency_text(mode.frequency_hz)} Hz{at}, {moves} by {abs(slope):.2f} orders."
