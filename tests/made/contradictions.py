"""Which statements of the findings exclude each other: of their fields, and of the sentences made from them."""

import re
from collections.abc import Iterable, Iterator
from typing import Any

from crankorder.cause import mains_words
from crankorder.findings import Findings
from crankorder.identify.crossings import NUMBERS as CROSSINGS
from crankorder.plot.reading import NAME_CHARACTERS, interval_of, is_number, is_tone, is_undecided, named, order_text
from crankorder.records import Record, known
from crankorder.report.sentences.of_speeds import free_bands, open_bands
from crankorder.report.sentences.story import has_lines, headline, story_of
from crankorder.report.tables import Table, tables_of
from made.typed import findings_of

SAME = 1e-6
"""Numbers within this share of each other are one: what a file rounds is no contradiction."""
SAME_LINE_HZ = 0.01
"""Frequencies that lie as near are those of one line."""
BESIDE = 0.01
"""Share of the fastest speed beyond the tested range that is as good as tested …"""
BESIDE_RPM = 30.0
"""… or so many rpm: crossings count that far beside it."""

APART = {
    "Free of resonances:": ("No speed of the tested range can be called free", "A test at one speed cannot tell"),
    "Nothing that was looked for asks for action": ("steady running near", "strikes of", "is damaged"),
    "No speed to avoid was found": ("steady running near",),
    "No sign of a failing bearing": ("is damaged", "Re-run the same test"),
    "No order stands above the noise": ("is the strongest line in", "found: ", " fits the "),
    "No order could be proven": ("is the strongest line in", " fits the "),
    "o order stands above the noise.": ("lies above the band that was looked at",),
    "No line stands above the false-alarm level": ("is the strongest line in", " fits the ", "lies above the band"),
    "No order and no tone holds energy": ("is the strongest line in", " fits the ", "lies above the band"),
    "No recording was found faulty or suspect": ("those data took no part in the averages",),
    "is in doubt, and with it every order": ("does not follow the shaft", "Free of resonances:", "Balance it:"),
}
"""Words, and those that no page may hold beside them."""
ESTIMATE = re.compile(r"(−?\d[−\d.e]*)(?: [^\s()]+)? \(([−\d.e]+)…([−\d.e]+)\)")
"""An estimate with its 95 % interval, its unit before or behind."""
MAINS = {mains_words(multiple) for multiple in range(1, 1001)}
"""What multiples of the mains are called."""
ESTIMATES = ("order", "amplitude", "speed_exponent", "frequency_hz", "damping_ratio", "rpm", "amplification")
LIMITS = [(key, f"{key}_ci95") for key in ESTIMATES] + [("speed_rpm_at_max", "speed_range_rpm"), ("rpm", "rpm_range")]
"""Estimates, and the interval or range of the same record that each must lie within."""


def contradictions(document: dict[str, Any]) -> list[str]:
    """Every pair of statements of findings (as in ``data_schema/findings.json``) that cannot both be so, in words.

    The fields of each record are held against one another, records against those of other lists, and the sentences of
    the headline and of the page against the fields that they are made from. Empty where nothing contradicts.
    """
    findings = findings_of(document)
    checks = (
        _of_orders, _of_amplitudes, _of_modes, _of_crossings, _of_speeds, _of_bearings, _of_mains, _of_quality,
        _of_sentences,
    )  # fmt: skip
    return [words for check in checks for words in check(findings)]


def _of_orders(findings: Findings) -> Iterator[str]:
    """Verdict on the lock against number, evidence and what would decide it; the law of growth against its exponent."""
    for record in findings.orders:
        name, decided = f"order {order_text(record.order)} in {record.channel}", record.lock in ("slips", "locked")
        yield from _outside(name, record)
        ends, evidence = interval_of(record, "order"), str(record.evidence or "")
        if decided and ends is not None:
            multiple = max(1, round(ends[0] + ends[1])) / 2.0  # of the half revolution, the nearest to the middle
            if _within(multiple, ends) == (record.lock == "slips"):
                yield f"{name}: {record.lock} by its verdict, and not by its interval about {order_text(multiple)}"
        if decided and is_number(record.revs_to_decide):
            yield f"{name}: its lock is decided ({record.lock}), and more revolutions would decide it"
        locked = record.lock == "locked" or "locked to the shaft" in map(str.strip, evidence.split(";"))
        if locked and "not locked to the shaft" in evidence:
            yield f"{name}: it is locked and not locked to the shaft"
        law, exponent = str(record.speed_law or ""), record.speed_exponent
        if is_number(exponent) and exponent * (law.startswith("grows") - law.startswith("falls")) < 0.0:
            yield f"{name}: it {law.split()[0]} with the speed, with an exponent of {exponent:.2g}"


def _of_amplitudes(findings: Findings) -> Iterator[str]:
    """The amplitude of one order in one channel by every list that tells it: means and fits of a held speed apart."""
    orders = {(one.channel, one.order): one for one in findings.orders}
    alike: list[tuple[Record, str]] = [(one, "lines") for one in findings.lines]
    alike += [(one, "bearings") for one in findings.bearings if one.seen_in == "vibration" and not one.is_mean]
    for avoided in findings.speeds_to_avoid or ():
        own, ends = orders.get((avoided.channel, avoided.order)), known(avoided.rpm_range)
        if own is None or ends is None or not is_number(own.speed_rpm_at_max) or avoided.by_fit:
            continue
        if len(avoided.orders) == 1 and _within(own.speed_rpm_at_max, ends):
            alike.append((avoided, "speeds to avoid"))
        elif (avoided.amplitude or 0.0) > (1.0 + SAME) * own.amplitude:
            yield f"order {order_text(own.order)} in {own.channel}: recorded larger than its largest, to be avoided"
    for record, where in alike:
        own = orders.get((getattr(record, "channel", None), getattr(record, "order", None)))
        told = getattr(record, "amplitude", None), getattr(record, "amplitude_ci95", None)
        if own is not None and told[0] is not None and told != (own.amplitude, told[1] and own.amplitude_ci95):
            yield f"order {order_text(own.order)} in {own.channel}: {own.amplitude:.6g}, and {told[0]:.6g} by {where}"


def _outside(name: str, record: Record) -> Iterator[str]:
    """Values that lie outside their own interval or range."""
    for key, limit in LIMITS:
        ends, value = known(getattr(record, limit, None)), getattr(record, key, None)
        if ends is not None and is_number(value) and not _within(value, ends):
            yield f"{name}: {key} {value:.6g} lies outside {limit} ({ends[0]:.6g} to {ends[1]:.6g})"


def _within(value: float, ends: tuple[float, float]) -> bool:
    spare = SAME * max(abs(value), abs(ends[0]), abs(ends[1]))
    return ends[0] - spare <= value <= ends[1] + spare


def _alike(value: float, other: float) -> bool:
    return abs(value / other - 1.0) < SAME


def _of_modes(findings: Findings) -> Iterator[str]:
    """Natural frequencies against their doubt, the tones within their interval and the crossings that are theirs."""
    met_hz = [crossing.mode_hz for crossing in findings.crossings if crossing.excited and crossing.in_range]
    for record in findings.modes:
        name, ends = f"{record.frequency_hz:.5g} Hz", interval_of(record, "frequency_hz")
        is_mode, doubt = record.explained_by == "mode", str(record.undecided or "")
        yield from _outside(name, record)
        if is_mode and doubt:
            yield f"{name}: a natural frequency, and not decided"
        if record.reached_by_orders == () and any(_alike(hz, record.frequency_hz) for hz in met_hz):
            yield f"{name}: no order reaches it, and a crossing there is excited"
        if ends is None:
            continue
        # open, known well enough to stand at one place, and names no line there
        may_be = bool(doubt) and not is_tone(record) and not record.lines_there_hz
        if is_mode or (may_be and ends[1] - ends[0] <= BESIDE * ends[1]):
            for tone in findings.modes:
                if is_tone(tone) and _within(tone.frequency_hz, ends):
                    said = "is" if is_mode else "may be"
                    yield f"{name}: {said} a natural frequency, and {tone.explained_by} at {tone.frequency_hz:.5g} Hz"


def _of_crossings(findings: Findings) -> Iterator[str]:
    """Crossings against the tested range, the speeds to avoid, what their orders are called, and the modes."""
    speeds = [rpm for rpm in findings.speed_range_rpm or () if is_number(rpm)]
    modes_hz = [mode.frequency_hz for mode in findings.modes if not is_tone(mode)]
    electric = {line.order for line in findings.orders if line.electric}
    for record in findings.crossings:
        name, times = f"order {order_text(record.order)} with {record.mode_hz:.5g} Hz", record.amplification
        if record.in_range is True and speeds:
            low, high = interval_of(record, "rpm") or (record.rpm, record.rpm)
            spare = max(BESIDE * max(speeds), BESIDE_RPM)
            if low > max(speeds) + spare or high < min(speeds) - spare:
                yield f"{name}: in the tested range, and at {record.rpm:.0f} rpm"
        for other in findings.speeds_to_avoid or ():
            twice, same = other.amplification, (other.order, other.mode_hz) == (record.order, record.mode_hz)
            if same and is_number(times) and is_number(twice) and abs(times - twice) > SAME * max(times, twice):
                yield f"{name}: amplified {times:.3g} times, and {twice:.3g} times where it is to be avoided"
        if record.order in electric:
            yield f"{name}: a line of fixed frequency moves with the speed"
        if record.excited and not any(_alike(record.mode_hz, hz) for hz in modes_hz):
            yield f"{name}: excited, and no such natural frequency is listed"


def _of_speeds(findings: Findings) -> Iterator[str]:
    """Free speeds against those to avoid, those not known, and excited crossings that may be clearly amplified."""
    avoid = [ends for speed in findings.speeds_to_avoid or () if (ends := known(speed.rpm_range)) is not None]
    others = [("to be avoided", ends) for ends in avoid] + [("not known", ends) for ends in open_bands(findings)]
    for low, high in free_bands(findings):
        name = f"{low:.0f} to {high:.0f} rpm: free"
        for words, (begin, end) in others:
            if min(high, end) - max(low, begin) > SAME * high:
                yield f"{name}, and {begin:.0f} to {end:.0f} rpm {words}"
        for record in findings.crossings:
            times = interval_of(record, "amplification")
            felt = bool(record.excited) and (times is None or times[1] >= CROSSINGS.clearly_excited_ratio)
            if felt and is_number(record.rpm) and low < record.rpm < high:
                yield f"{name}, and an excited crossing at {record.rpm:.0f} rpm"


def _of_bearings(findings: Findings) -> Iterator[str]:
    damaged = {record.name for record in findings.bearings if str(record.verdict or "").startswith("Damage")}
    for record in findings.bearings:
        name, verdict = f"{record.line} of {record.name}", str(record.verdict or "")
        yield from _outside(name, record)
        if record.name in damaged and "no bearing alarm" in verdict:
            yield f"{name}: no bearing alarm, and another line of it is called damage"
        if record.lock == "locked" and verdict.startswith("Damage") and record.seen_in != "envelope":
            yield f"{name}: damage, and locked to the shaft"


def _of_mains(findings: Findings) -> Iterator[str]:
    """Two lines of one recording that are one multiple of the mains: a supply has one frequency."""
    lines: dict[tuple[str, float | None], list[tuple[float, ...]]] = {}
    for record in findings.orders:
        rpm, ends, words = record.speed_rpm_at_max, interval_of(record, "order"), record.explained_by or ""
        if words in MAINS and is_number(rpm) and ends is not None:
            place = tuple(order * rpm / 60.0 for order in (record.order, *ends))
            lines.setdefault((words, round(rpm, 3)), []).append(place)
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
    tables = [table for _, table in tables_of(findings, limit=NAME_CHARACTERS)]
    text = "\n".join([*said, *(table.empty for table in tables if not table.rows)])
    for value, low, high in sorted(_estimates(said) - _estimates(_cells(tables))):
        yield f"a sentence says {value} ({low}…{high}), and no table does"
    for words, others in APART.items():
        yield from (f"the page says {words!r} and {other!r}" for other in others if words in text and other in text)
    if "explained by orders and tones" in text and not has_lines(findings):
        yield "all energy is explained by orders and tones, and none was found"
    if "o order stands above the noise" in text and findings.orders:
        yield "no order stands above the noise, and orders are listed"
    for record in findings.levels:
        name = named(record.channel, limit=NAME_CHARACTERS)
        if f"The strongest line in {name} lies above" in text and f"is the strongest line in {name}:" in text:
            yield f"{name}: its strongest line lies above the band, and within"
    decided = [mode for mode in findings.modes if not is_tone(mode) and not is_undecided(mode)]
    if any(words.startswith("Natural frequenc") and "shape" not in words for words in said) and not decided:
        yield "natural frequencies are named, and none is decided"


def _estimates(texts: Iterable[str]) -> set[tuple[str, ...]]:
    return {found for text in texts for found in ESTIMATE.findall(text)}


def _cells(tables: Iterable[Table | None]) -> Iterator[str]:
    """Text of every cell of ``tables`` and of those that are folded away under them or stand beside them."""
    for table in tables:
        if table is not None:
            yield from (cell for row in table.rows for cell in row)
            yield from _cells((table.more, table.beside))
