"""Lines of fixed frequency in the findings: tones and mains with what they amount to in every channel."""

from __future__ import annotations

from typing import Any, TypedDict

from crankorder.identify import mains
from crankorder.identify.said import SPEAK_FOR
from crankorder.report.notation import at_one_speed, interval_of, is_number, is_tone

_SAME_HZ = 0.5  # a line this close to a tone is that tone …
_SAME_SHARE = 0.002  # … or this share of its frequency
_DAMPED = ("mode", "undecided", "natural")


class FixedTone(TypedDict):
    """A line that stays at its frequency: its record, what it is, and its line in each channel that shows it."""

    record: dict[str, Any]
    kind: str
    lines: list[dict[str, Any]]


def is_fixed_tone(line: dict[str, Any]) -> bool:
    """True for a ``line`` of the findings at a fixed frequency that is no natural frequency."""
    cause = str(line.get("explained_by") or "").split()
    return is_number(line.get("frequency_hz")) and not (cause and cause[0].strip(",:;") in _DAMPED)


def is_electric(record: dict[str, Any]) -> bool:
    """True for a ``record`` of the findings whose cause is the mains or the field of a motor, and nothing else."""
    return mains.is_electric(str(record.get("explained_by") or ""))


def hertz_of_order(record: dict[str, Any], findings: dict[str, Any]) -> float | None:
    """Frequency [Hz] by which an order ``record`` of the ``findings`` is called first; None where its order says more.

    That of a line of the mains or of a motor's field, and of one that at the only speed of a test is no multiple of the
    half revolution: whether it goes with the speed nobody knows. So is one that speaks for another speed than the one
    that was stated. A bearing's line has its order.
    """
    rpm = record.get("speed_rpm_at_max")
    if not is_number(rpm) or not is_number(record.get("order")):
        return None
    cause = str(record.get("explained_by") or "unexplained")
    loose = at_one_speed(findings) and record.get("lock") == "slips" and not cause.startswith(("bearing", "gear"))
    loose = loose or SPEAK_FOR in str(record.get("evidence") or "")
    return float(record["order"]) * float(rpm) / 60.0 if loose or is_electric(record) else None


def strongest_tone(findings: dict[str, Any], channel: str) -> dict[str, Any] | None:
    """Line of the strongest tone in a ``channel`` of the ``findings``, or None."""
    lines = [
        line
        for line in findings.get("lines", [])
        if line.get("channel") == channel and is_fixed_tone(line) and is_number(line.get("amplitude"))
    ]
    return max(lines, key=lambda line: float(line["amplitude"]), default=None)


def fixed_tones(findings: dict[str, Any]) -> list[FixedTone]:
    """All tones of the ``findings``, lowest first, each with its lines in the channels, strongest first."""
    tones = [
        FixedTone(record=mode, kind=str(mode.get("explained_by")), lines=[])
        for mode in findings.get("modes", [])
        if is_number(mode.get("frequency_hz")) and is_tone(mode)
    ]
    decided = [
        float(mode["frequency_hz"])
        for mode in findings.get("modes", [])
        if is_number(mode.get("frequency_hz")) and not is_tone(mode)
    ]
    for line in findings.get("lines", []):
        if not is_fixed_tone(line):
            continue
        home = next((tone for tone in tones if _same(tone["record"], line)), None)
        if home is None:
            if any(abs(mode_hz - float(line["frequency_hz"])) < 1e-9 * mode_hz for mode_hz in decided):
                continue  # its mode is told where modes are
            home = FixedTone(record=line, kind=str(line.get("explained_by") or "unexplained"), lines=[])
            tones.append(home)
        home["lines"].append(line)
    for tone in tones:
        tone["lines"].sort(key=lambda line: -float(line.get("amplitude") or 0))
    return sorted(tones, key=lambda tone: float(tone["record"]["frequency_hz"]))


def fixed_frequencies(findings: dict[str, Any]) -> list[dict[str, Any]]:
    """Everything in the ``findings`` that stays at its frequency, lowest first: natural frequencies, doubts, tones.

    A tone that stands in the list of lines alone is given like a mode, with its kind as ``explained_by``.
    """
    modes = [mode for mode in findings.get("modes", []) if is_number(mode.get("frequency_hz")) and not is_tone(mode)]
    tones = [
        {
            "frequency_hz": tone["record"]["frequency_hz"],
            "explained_by": tone["kind"],
            "channels": tone["record"].get("channels") or [str(line.get("channel")) for line in tone["lines"]],
        }
        for tone in fixed_tones(findings)
    ]
    return sorted([*modes, *tones], key=lambda one: float(one["frequency_hz"]))


def _same(tone: dict[str, Any], line: dict[str, Any]) -> bool:
    one, two = float(tone["frequency_hz"]), float(line["frequency_hz"])
    ends = interval_of(tone, "frequency_hz")
    reach = max(min(_SAME_HZ, _SAME_SHARE * one), 0.0 if ends is None else ends[1] - ends[0])
    return abs(one - two) <= reach
