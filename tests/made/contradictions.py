"""Which statements of the findings exclude each other: of their fields, and of the sentences made from them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from crankorder.findings import CrossingFinding, Findings, ModeFinding, OrderFinding
from crankorder.identify.said import MAY_BE_ALL, is_electric, mains_words
from crankorder.identify.said import NUMBERS as SAID
from crankorder.records import Record, known
from crankorder.report.notation import NAME_CHARACTERS, interval_of, is_number, is_tone, is_undecided, named, order_text
from crankorder.report.sentences.of_speeds import free_bands, open_bands
from crankorder.report.sentences.story import has_lines, headline, story_of
from made.typed import findings_of

Ends = tuple[float, float]

SAME = 1e-6
"""Numbers within this share of each other are one: what a file rounds is no contradiction."""
SAME_LINE_HZ = 0.01
"""Frequencies that lie as near are those of one line."""
BESIDE = 0.01
"""Share of the fastest speed beyond the tested range that is as good as tested …"""
BESIDE_RPM = 30.0
"""… or so many rpm: crossings count that far beside it."""

APART = (
    ("Free of resonances:", "No speed of the tested range can be called free"),
    ("A test at one speed cannot tell", "Free of resonances:"),
    ("Avoid steady running", "Nothing that was looked for asks for action"),
    ("Avoid steady running", "No order was seen to excite a natural frequency"),
    ("No order stands above the noise", "is the strongest line in"),
    ("No order stands above the noise", "found: "),
    ("No order could be proven", "is the strongest line in"),
    ("No recording was found faulty or suspect", "those data took no part in the averages"),
    ("is in doubt, and with it every order", "does not follow the shaft"),
    ("is in doubt, and with it every order", "Free of resonances:"),
    ("is in doubt, and with it every order", "Balance it:"),
    ("strikes of", "Nothing that was looked for asks for action"),
)
"""Pairs of words that no page may hold both of."""
MAINS = {mains_words(multiple) for multiple in range(1, 1001)}
"""What multiples of the mains are called."""
INTERVALS = ("order", "amplitude", "speed_exponent", "frequency_hz", "damping_ratio", "rpm", "amplification")
"""Estimates that must lie within their own interval."""


def contradictions(document: dict[str, Any]) -> list[str]:
    """Every pair of statements of findings (as in ``data_schema/findings.json``) that cannot both be so, in words.

    The fields of each record are held against one another, records against those of other lists, and the sentences of
    the headline and of the page against the fields that they are made from. Empty where nothing contradicts.
    """
    findings = findings_of(document)
    checks = (_of_orders, _of_modes, _of_crossings, _of_speeds, _of_bearings, _of_mains, _of_quality, _of_sentences)
    return [words for check in checks for words in check(findings)]


def _of_orders(findings: Findings) -> Iterator[str]:
    for record in findings.orders:
        name = f"order {order_text(record.order)} in {record.channel}"
        yield from (f"{name}: {words}" for words in (*_of_lock(record), *_of_growth(record), *_outside(record)))


def _of_lock(record: OrderFinding) -> Iterator[str]:
    """Verdict on the lock against the number, the words of its evidence and what would decide it."""
    lock, ends, evidence = record.lock, interval_of(record, "order"), str(record.evidence or "")
    if ends is not None and lock in ("slips", "locked"):
        multiple = max(1, round(ends[0] + ends[1])) / 2.0  # of the half revolution, the nearest to the middle
        if lock == "slips" and _within(multiple, ends):
            yield f"it slips, and its interval holds {order_text(multiple)}"
        if lock == "locked" and not _within(multiple, ends):
            yield "it is locked, and its interval holds no multiple of the half revolution"
    said_locked = any(part.strip() == "locked to the shaft" for part in evidence.split(";"))
    if "not locked to the shaft" in evidence and (lock == "locked" or said_locked):
        yield "it is locked and not locked to the shaft"
    if lock in ("slips", "locked") and is_number(record.revs_to_decide):
        yield f"its lock is decided ({lock}), and more revolutions would decide it"


def _of_growth(record: OrderFinding) -> Iterator[str]:
    law, exponent = str(record.speed_law or ""), record.speed_exponent
    if is_number(exponent) and (
        (law.startswith("grows") and exponent < 0.0) or (law.startswith("falls") and exponent > 0.0)
    ):
        yield f"it {law.split()[0]} with the speed, with an exponent of {exponent:.2g}"


def _outside(record: Record) -> Iterator[str]:
    """Values that lie outside their own interval or range."""
    limits = [(key, f"{key}_ci95") for key in INTERVALS]
    for key, limit in (*limits, ("speed_rpm_at_max", "speed_range_rpm"), ("rpm", "rpm_range")):
        ends, value = known(getattr(record, limit, None)), getattr(record, key, None)
        if ends is not None and is_number(value) and not _within(value, ends):
            yield f"{key} {value:.6g} lies outside {limit} ({ends[0]:.6g} to {ends[1]:.6g})"


def _within(value: float, ends: Ends) -> bool:
    spare = SAME * max(abs(value), abs(ends[0]), abs(ends[1]))
    return ends[0] - spare <= value <= ends[1] + spare


def _of_modes(findings: Findings) -> Iterator[str]:
    for record in findings.modes:
        name, is_mode = f"{record.frequency_hz:.5g} Hz", record.explained_by == "mode"
        yield from (f"{name}: {words}" for words in _outside(record))
        if is_mode and record.undecided:
            yield f"{name}: a natural frequency, and not decided"
        if is_mode or _may_be_a_tone(record):
            is_one = "is" if is_mode else "may be"
            yield from (f"{name}: {is_one} a natural frequency, and {tone}" for tone in _tones_at(record, findings))
        if record.reached_by_orders == () and any(
            crossing.excited and crossing.in_range and abs(crossing.mode_hz / record.frequency_hz - 1.0) < SAME
            for crossing in findings.crossings
        ):
            yield f"{name}: no order reaches it, and a crossing there is excited"


def _may_be_a_tone(record: ModeFinding) -> bool:
    """Whether a natural frequency is open, known well enough to stand at one place, and names no line there."""
    ends, doubt = interval_of(record, "frequency_hz"), str(record.undecided or "")
    narrow = ends is not None and ends[1] - ends[0] <= BESIDE * ends[1]
    return bool(doubt) and narrow and not is_tone(record) and MAY_BE_ALL not in doubt


def _tones_at(mode: ModeFinding, findings: Findings) -> Iterator[str]:
    """Tones that the findings name within the interval of a natural frequency."""
    ends = interval_of(mode, "frequency_hz")
    for tone in findings.modes:
        if ends is not None and is_tone(tone) and _within(tone.frequency_hz, ends):
            yield f"{tone.explained_by} at {tone.frequency_hz:.5g} Hz"


def _of_crossings(findings: Findings) -> Iterator[str]:
    speeds = [rpm for rpm in findings.speed_range_rpm or () if is_number(rpm)]
    modes_hz = [mode.frequency_hz for mode in findings.modes if not is_tone(mode)]
    for record in findings.crossings:
        name = f"order {order_text(record.order)} with {record.mode_hz:.5g} Hz"
        if record.in_range is True and speeds:
            low, high = interval_of(record, "rpm") or (record.rpm, record.rpm)
            spare = max(BESIDE * max(speeds), BESIDE_RPM)
            if low > max(speeds) + spare or high < min(speeds) - spare:
                yield f"{name}: in the tested range, and at {record.rpm:.0f} rpm"
        yield from (f"{name}: {words}" for words in _of_meeting(record, findings))
        if record.excited and not any(abs(record.mode_hz / hz - 1.0) < SAME for hz in modes_hz):
            yield f"{name}: excited, and no such natural frequency is listed"


def _of_meeting(record: CrossingFinding, findings: Findings) -> Iterator[str]:
    """A crossing against the speed to avoid that it is, and against what its order is called."""
    times = record.amplification
    for other in findings.speeds_to_avoid or ():
        twice, same = other.amplification, (other.order, other.mode_hz) == (record.order, record.mode_hz)
        if same and is_number(times) and is_number(twice) and abs(times - twice) > SAME * max(times, twice):
            yield f"amplified {times:.3g} times, and {twice:.3g} times where it is to be avoided"
    if any(is_electric(line.explained_by or "") for line in findings.orders if line.order == record.order):
        yield "a line of fixed frequency moves with the speed"


def _is_felt(crossing: CrossingFinding) -> bool:
    """Whether an excited crossing may make an order so much larger that nobody would call its speed free."""
    ends = interval_of(crossing, "amplification")
    return bool(crossing.excited) and (ends is None or ends[1] >= SAID.clearly_excited_ratio)


def _of_speeds(findings: Findings) -> Iterator[str]:
    avoid = [ends for speed in findings.speeds_to_avoid or () if (ends := known(speed.rpm_range)) is not None]
    for low, high in free_bands(findings):
        for words, others in (("to be avoided", avoid), ("not known", open_bands(findings))):
            for other in others:
                if min(high, other[1]) - max(low, other[0]) > SAME * high:
                    yield f"{low:.0f} to {high:.0f} rpm: free, and {other[0]:.0f} to {other[1]:.0f} rpm {words}"
        for record in findings.crossings:
            if _is_felt(record) and is_number(record.rpm) and low < record.rpm < high:
                yield f"{low:.0f} to {high:.0f} rpm: free, and an excited crossing at {record.rpm:.0f} rpm"


def _of_bearings(findings: Findings) -> Iterator[str]:
    damaged = [record for record in findings.bearings if str(record.verdict or "").startswith("Damage")]
    struck = {record.name for record in damaged}
    for record in findings.bearings:
        name = f"{record.line} of {record.name}"
        if record.name in struck and "no bearing alarm" in record.verdict:
            yield f"{name}: no bearing alarm, and another line of it is called damage"
        if record.lock == "locked" and record in damaged and record.seen_in != "envelope":
            yield f"{name}: damage, and locked to the shaft"
        yield from (f"{name}: {words}" for words in _outside(record))


def _of_mains(findings: Findings) -> Iterator[str]:
    """Two lines of one recording that are one multiple of the mains: a supply has one frequency."""
    lines: dict[tuple[str, float | None], list[tuple[float, float, float]]] = {}
    for record in findings.orders:
        rpm, ends, words = record.speed_rpm_at_max, interval_of(record, "order"), record.explained_by or ""
        if words in MAINS and is_number(rpm) and ends is not None:
            middle, low, high = (order * rpm / 60.0 for order in (record.order, *ends))
            lines.setdefault((words, round(rpm, 3)), []).append((middle, low, high))
    for mode in findings.modes:
        words, ends = mode.explained_by, interval_of(mode, "frequency_hz")
        if words in MAINS and ends is not None:
            lines.setdefault((words, None), []).append((mode.frequency_hz, *ends))
    for (words, _), places in lines.items():
        below, above = min(places), max(places)
        if above[0] - below[0] > SAME_LINE_HZ and above[1] > below[2]:
            yield f"{words} at {below[0]:.6g} Hz and at {above[0]:.6g} Hz: a supply has one frequency"


def _of_quality(findings: Findings) -> Iterator[str]:
    """What is flagged as of another gain must not take part in amplitudes, their growth, and modes told by these."""
    for flag in findings.quality:
        if flag.flag == "level_jump" and flag.left_out != "channel":
            yield f"{flag.channel} of {flag.recording}: its gain was changed, and it took part"


def _of_sentences(findings: Findings) -> Iterator[str]:
    """Sentences of the page against each other and against the lists that they are made from."""
    story = story_of(findings)
    said = [*headline(findings), *story["what"], *story["why"], *story["how_sure"], *story["what_to_do"]]
    text = "\n".join(said)
    yield from (f"the page says {one!r} and {other!r}" for one, other in APART if one in text and other in text)
    if "explained by orders and tones" in text and not has_lines(findings):
        yield "all energy is explained by orders and tones, and none was found"
    if "No order stands above the noise" in text and findings.orders:
        yield "no order stands above the noise, and orders are listed"
    for record in findings.levels:
        name = named(record.channel, limit=NAME_CHARACTERS)
        if f"The strongest line in {name} lies above" in text and f"is the strongest line in {name}:" in text:
            yield f"{name}: its strongest line lies above the band, and within"
    decided = [mode for mode in findings.modes if not is_tone(mode) and not is_undecided(mode)]
    if any(words.startswith("Natural frequenc") and "shape" not in words for words in said) and not decided:
        yield "natural frequencies are named, and none is decided"
