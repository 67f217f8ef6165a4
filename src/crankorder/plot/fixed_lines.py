"""Lines of fixed frequency in the findings: tones and mains with what they amount to in every channel."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from crankorder.findings import Findings, LineFinding, ModeFinding, OrderFinding
from crankorder.plot.drawing import Dashes
from crankorder.plot.labels import Key
from crankorder.plot.palette import DOUBT_DASHES, MAINS, MAINS_ON_MAP, MODE, MODE_DASHES, MODE_ON_MAP, TONE_DASHES
from crankorder.plot.reading import at_one_speed, frequency_text, interval_of, is_number, is_tone, is_undecided

_SAME_HZ = 0.5  # a line this close to a tone is that tone …
_SAME_SHARE = 0.002  # … or this share of its frequency


@dataclass(frozen=True)
class FixedTone:
    """A line that stays at its frequency: its record and its line in each channel that shows it."""

    record: ModeFinding
    lines: list[LineFinding] = field(default_factory=list)


def is_fixed_tone(line: LineFinding) -> bool:
    """True for a ``line`` of the findings at a fixed frequency that is no natural frequency."""
    return is_number(line.frequency_hz) and line.kinds[0] not in ("mode", "undecided")


def hertz_of_order(record: OrderFinding, findings: Findings) -> float | None:
    """Frequency [Hz] by which an order ``record`` of the ``findings`` is called first; None where its order says more.

    That of a line of the mains or of a motor's field, and of one that at the only speed of a test is no multiple of the
    half revolution: whether it goes with the speed nobody knows. A bearing's line has its order.
    """
    rpm = record.speed_rpm_at_max
    of_part = record.kinds[0] in ("bearing", "gear mesh")
    loose = at_one_speed(findings) and record.lock == "slips" and not of_part
    return record.order * rpm / 60.0 if is_number(rpm) and (loose or record.electric) else None


def strongest_tone(findings: Findings, channel: str) -> LineFinding | None:
    """Line of the strongest tone in a ``channel`` of the ``findings``, or None."""
    lines = (line for line in findings.lines if line.channel == channel and is_number(line.amplitude))
    return max(filter(is_fixed_tone, lines), key=lambda line: line.size, default=None)


def fixed_tones(findings: Findings) -> list[FixedTone]:
    """All tones of the ``findings``, lowest first, each with its lines in the channels, strongest first."""
    tones = [FixedTone(mode) for mode in findings.modes if is_tone(mode)]
    decided = [mode.frequency_hz for mode in findings.modes if not is_tone(mode)]
    for line in findings.lines:
        hz = line.frequency_hz
        if hz is None or not is_fixed_tone(line):
            continue
        tone = next((tone for tone in tones if _is_at(tone.record, hz)), None)
        if tone is None:
            if any(abs(mode_hz - hz) < 1e-9 * mode_hz for mode_hz in decided):
                continue  # the table of natural frequencies has it
            # as the list of modes would have it
            kind, ends = line.explained_by or "unexplained", line.frequency_hz_ci95
            record = ModeFinding(
                frequency_hz=hz,
                frequency_hz_ci95=ends,
                channels=(),
                evidence="",
                explained_by=kind,
                causes=line.causes,
            )
            tones.append(tone := FixedTone(record))
        tone.lines.append(line)
    for tone in tones:
        tone.lines.sort(key=lambda line: -line.size)
    return sorted(tones, key=lambda tone: tone.record.frequency_hz)


def fixed_frequencies(findings: Findings) -> list[ModeFinding]:
    """All lines of fixed frequency in the ``findings``, lowest first: natural frequencies, undecided ones, tones.

    A tone that stands in the list of lines alone is given like a mode, with its kind as ``explained_by``.
    """
    modes = [mode for mode in findings.modes if not is_tone(mode)]
    tones = [
        replace(tone.record, channels=tone.record.channels or tuple(line.channel for line in tone.lines))
        for tone in fixed_tones(findings)
    ]
    return sorted([*modes, *tones], key=lambda mode: mode.frequency_hz)


def _is_at(tone: ModeFinding, hertz: float) -> bool:
    """Whether a line at ``hertz`` lies within the tolerance of a ``tone``."""
    low, high = interval_of(tone, "frequency_hz") or (0.0, 0.0)
    return abs(tone.frequency_hz - hertz) <= max(min(_SAME_HZ, _SAME_SHARE * tone.frequency_hz), high - low)


Mark = tuple[float, str, str]
"""Place along the axis, text and colour of what is named above a diagram."""


def mode_style(mode: ModeFinding) -> tuple[str, str, str, Dashes]:
    """Kind, colour, colour over a map and dashes of the line of a ``mode``: tone, doubt or natural frequency."""
    if is_tone(mode):
        return "tone", MAINS, MAINS_ON_MAP, TONE_DASHES
    kind, dashes = ("doubt", DOUBT_DASHES) if is_undecided(mode) else ("mode", MODE_DASHES)
    return kind, MODE, MODE_ON_MAP, dashes


def mode_text(mode: ModeFinding) -> str:
    """Label of a ``mode``: its frequency, with a question mark where it is not decided."""
    return f"{frequency_text(mode.frequency_hz)}{'?' * is_undecided(mode)} Hz"


def mode_marks(modes: list[ModeFinding]) -> list[Mark]:
    """Frequency, label and colour of each of ``modes``, for the edge of a diagram."""
    return [(mode.frequency_hz, mode_text(mode), mode_style(mode)[1]) for mode in modes]


def mode_keys(modes: list[ModeFinding]) -> list[Key]:
    """Legend of the dashed and dotted lines of ``modes``: natural frequencies, doubts, tones."""
    kinds = {mode_style(mode)[0] for mode in modes}
    keys = [Key("natural frequency", MODE, MODE_DASHES)] if "mode" in kinds else []
    keys += [Key("not decided", MODE, DOUBT_DASHES)] if "doubt" in kinds else []
    of_mains = {mode.kinds == ("mains",) for mode in modes if is_tone(mode)}
    if of_mains:
        label = "mains or fixed tone" if len(of_mains) > 1 else "mains" if True in of_mains else "fixed tone"
        keys.append(Key(label, MAINS, TONE_DASHES))
    return keys
