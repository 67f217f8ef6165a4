"""Tables of what makes the lines of a test (tones, bearings, unbalance), of levels, and of where results come from."""

from __future__ import annotations

from typing import Any

from crankorder.channel_units import unit_text
from crankorder.findings import BearingFinding, Findings, ThirdOctave, VibrationLevel
from crankorder.plot.fixed_lines import fixed_tones
from crankorder.report.notation import (
    estimate_text,
    is_number,
    named,
    order_estimate,
    order_text,
    unit_of,
    with_interval,
)
from crankorder.report.rows import Table, table_of
from crankorder.report.sentences.of_balance import source_text, told_quantities, undecided_quantities
from crankorder.report.sentences.of_bearings import band_text
from crankorder.report.sentences.of_levels import band_of

_PROVENANCE_ROWS = 400

NO_BEARING = (
    "No bearing was named in the manifest, or none of its lines was seen. Strikes that ring above the "
    "frequencies analysed are not looked for."
)
NO_BEARING_IN_ENVELOPE = "No bearing was named in the manifest, or none of its lines was seen in vibration or envelope."


def tone_table(findings: Findings, limit: int) -> Table:
    """Tones and mains of ``findings``, one row per tone and channel, names cut at ``limit``; empty where none is."""
    rows = []
    for tone in fixed_tones(findings):
        kind, frequency = named(tone.record.explained_by, limit=limit), estimate_text(tone.record, "frequency_hz")
        evidence = named(tone.record.evidence or "–", limit=4 * limit)
        for line in tone.lines:
            level = estimate_text(line, "amplitude", unit=unit_of(findings, line))
            rows.append([frequency, kind, named(line.channel, limit=limit), level, evidence])
        if not tone.lines:
            channels = ", ".join(tone.record.channels)
            rows.append([frequency, kind, named(channels, limit=limit), "–", evidence])
    heads = "Frequency, Hz#|What it is|Channel|Amplitude (peak)#|Evidence"
    return table_of("Tones and mains: no natural frequencies", heads, rows, empty="")


def bearing_table(findings: Findings, limit: int) -> Table:
    """Bearing lines of ``findings`` with what was expected, found and concluded; names cut at ``limit``."""
    rows = [_bearing_row(record, findings, limit) for record in findings.bearings]
    heads = (
        "Bearing|Line|Verdict|Seen in|Order expected#|Order found#|Slip, %#|Amplitude (peak)#|Channel|Multiples#|"
        "Sidebands, orders apart#|To the shaft"
    )
    empty = NO_BEARING_IN_ENVELOPE if "envelope" in (findings.looked_for) else NO_BEARING
    return table_of("Bearings", heads, rows, empty=empty)


def _bearing_row(record: BearingFinding, findings: Findings, limit: int) -> list[str]:
    band, multiples, apart = band_text(record), record.harmonics, record.sidebands
    seen = named(record.seen_in or "–", limit=limit)
    expected = record.order_expected
    return [
        named(record.name or "", limit=limit),
        named(record.line or "", limit=limit).replace("*", "·"),
        named(record.verdict or "", limit=4 * limit),
        f"{seen}, {band} Hz" if band else seen,
        f"{expected:.4f}".rstrip("0").rstrip(".") if is_number(expected) else "–",
        order_estimate(record, findings),
        estimate_text(record, "slip_percent") if record.slip_percent_ci95 else "–",
        estimate_text(record, "amplitude", unit=unit_of(findings, record)) + ", mean of all speeds" * record.is_mean,
        named(record.channel or "–", limit=limit),
        f"{multiples:.0f}" if is_number(multiples) else "–",
        order_text(float(apart)) if is_number(apart) else "–",
        named(record.lock or "–", limit=limit),
    ]


def balance_table(findings: Findings, limit: int) -> Table:
    """Residual unbalance of ``findings`` with intervals, then what is not decided and why; names cut at ``limit``."""
    balance, rows, note = findings.balance, list[list[str]](), ""
    if balance is not None:
        for key, (title, unit) in told_quantities(balance).items():
            rows.append([named(title, limit=limit), estimate_text(balance, key, unit=unit)])
        if is_number(balance.grade_mm_s):
            at = f"Balance grade G (ISO 21940-11) at {number_of(balance.grade_speed_rpm)} rpm"
            rows.append([at, estimate_text(balance, "grade_mm_s", unit="mm/s")])
        rows += [[title, f"not decided: {why}"] for title, why in undecided_quantities(balance)]
        note = f"Worked out{source_text(balance)}." if balance.source else ""
        if balance.evidence:
            note = f"{note} {named(balance.evidence, limit=6 * limit)}".strip()
    reason = findings.balance_reason
    why = f" The reason: {named(reason, limit=4 * limit)}" if reason else ""
    return table_of("Balance", "Quantity|Value", rows, note=note, empty=f"No residual unbalance was worked out.{why}")


def limit_table(findings: Findings, limit: int) -> Table:
    """What the limits of the manifest come to in ``findings``, names cut at ``limit``; empty where there are none."""
    rows = []
    for one in findings.limits:
        unit = unit_text(one.unit)
        band = "–" if one.band_hz is None else band_of(one.band_hz, None)
        value = with_interval(one.level, one.level_ci95, unit=unit)
        allowed = with_interval(one.value, None, unit=unit)
        where, speed = named(one.channel or "–", limit=limit), number_of(one.speed_rpm)
        rows.append([where, named(one.quantity, limit=limit), band, one.verdict, value, allowed, speed])
        rows[-1] += [named(one.source, limit=2 * limit), named(one.evidence or "–", limit=4 * limit)]
    heads = "Channel|Quantity|Band|Verdict|Largest level (r.m.s.)#|Limit#|Speed, rpm#|Written in|Why"
    return table_of("Limits", heads, rows, empty="")


def level_table(findings: Findings, limit: int) -> Table:
    """Overall levels in ``findings``, the largest over speed; by speed and in one-third octaves folded under it.

    Names are cut at ``limit``; empty where none was told.
    """
    recorded = [one for one in findings.levels if is_number(one.rms_max)]
    rms = [with_interval(one.rms_max, None, unit=unit_of(findings, one)) for one in recorded]
    names = [named(one.channel, limit=limit) for one in recorded]
    whole = [[name, "as recorded", "all", "–", level, "–", "–", "–"] for name, level in zip(names, rms, strict=True)]
    largest = [_level_row(one, limit) for one in findings.vibration_levels if one.largest]
    every = [_level_row(one, limit) for one in findings.vibration_levels]
    heads = "Channel|Quantity|Band|Speed, rpm#|r.m.s.#|Mean peak#|Largest peak#|Crest factor#"
    more = table_of("Levels at every speed", heads, every, empty="")
    note = "At the speed where each is largest; peaks and crest factors are means over short pieces." if largest else ""
    note = f"{note} As recorded: the loudest recording, without the mean.".strip() if whole else note
    shown = more if len(every) > len(largest) else None
    return table_of("Overall levels", heads, [*largest, *whole], empty="", note=note, more=shown)


def octave_table(findings: Findings, limit: int) -> Table:
    """One-third octaves in ``findings``: the strongest of each channel, and folded all; names cut at ``limit``."""

    def row_of(one: ThirdOctave) -> list[str]:
        level = with_interval(one.rms, one.rms_ci95, unit=unit_text(one.unit))
        return [named(one.channel, limit=limit), number_of(one.speed_rpm), f"{one.nominal_hz:g}", level]

    rows = [row_of(one) for one in sorted(findings.third_octaves, key=lambda one: one.channel)]
    loudest = {one.channel: row_of(one) for one in sorted(findings.third_octaves, key=lambda one: one.rms)}
    heads = "Channel|Speed, rpm#|Mid-band, Hz#|r.m.s.#"
    more = table_of(f"All {len(rows)} one-third octaves", heads, rows, empty="")
    note = "The strongest of each channel, at the speed where the channel is loudest." if rows else ""
    shown = [loudest[name] for name in sorted(loudest)]
    return table_of("One-third octaves", heads, shown, empty="", note=note, more=more if rows else None)


def _level_row(one: VibrationLevel, limit: int) -> list[str]:
    unit = unit_text(one.unit)
    return [
        named(one.channel, limit=limit),
        named(one.quantity, limit=limit),
        band_of(one.band_hz, one.reached_hz),
        number_of(one.speed_rpm),
        estimate_text(one, "rms", unit=unit),
        estimate_text(one, "peak", unit=unit),
        with_interval(one.largest_peak, None, unit=unit),
        estimate_text(one, "crest_factor"),
    ]


def number_of(value: float | None) -> str:
    """The speed ``value`` as a whole number; a dash where it is not known."""
    return f"{value:.0f}" if is_number(value) else "–"


def provenance_table(provenance: dict[str, Any]) -> Table:
    """Inputs, versions and settings of ``provenance`` (as in ``data_schema/run.json``), one row per value, folded."""
    rows = [[named(key, limit=120), named(value, limit=200)] for key, value in _flat("", provenance)][:_PROVENANCE_ROWS]
    title, empty = "Inputs with hashes, versions and settings", "Nothing was recorded."
    everything = table_of(title, "Key|Value", rows, empty=empty)
    versions = provenance.get("versions") if isinstance(provenance.get("versions"), dict) else {}
    short = [[named(key, limit=60), named(value, limit=60)] for key, value in (versions or {}).items()]
    return table_of("Provenance", "Program|Version", short, empty="No versions were recorded.", more=everything)


def _flat(prefix: str, value: object) -> list[tuple[str, object]]:
    if isinstance(value, dict):
        return [pair for key, item in value.items() for pair in _flat(f"{prefix}.{key}" if prefix else str(key), item)]
    if isinstance(value, list | tuple) and any(isinstance(item, dict | list | tuple) for item in value):
        return [pair for number, item in enumerate(value, start=1) for pair in _flat(f"{prefix} {number}", item)]
    return [(prefix, ", ".join(str(item) for item in value) if isinstance(value, list | tuple) else value)]
