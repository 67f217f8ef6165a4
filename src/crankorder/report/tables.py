"""The tables of the report page: findings as rows of text, every estimate with its 95 % interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

from crankorder.channel_units import unit_text
from crankorder.findings import AvoidedSpeed, EnergyShares, Findings, FreeBand, ModeFinding, OpenBand, Quality
from crankorder.plot.reading import (
    estimate_text,
    fixed_tones,
    frequency_text,
    hertz_of_order,
    is_number,
    is_tone,
    is_undecided,
    least_of,
    named,
    nominal_order,
    number_text,
    order_estimate,
    order_text,
    order_texts,
    percent_text,
    reason_text,
    speeds_text,
    strongest_by,
    unit_of,
    with_interval,
)
from crankorder.records import Record
from crankorder.report.sentences.of_lines import bearing_sentence, envelope_band, no_mode_sentence, no_order_sentence
from crankorder.report.sentences.of_speeds import all_judged, band_of
from crankorder.report.sentences.story import energy_sentence, source_text, stated_quantities, undecided_quantities

NOTHING_RISES = "No order was seen to rise at a natural frequency inside the tested speeds."
NOTHING_TOLD = "None is known. That is no proof that there is none: the bands below are not free, or nobody knows."
FLANK_ALONE = (
    "No order meets a natural frequency inside the tested speeds; the flank of one beyond them reaches in, as the "
    "bands below say."
)

PARTS = (
    ("orders", "Orders"),
    ("tones", "Tones"),
    ("modes_and_floor", "Natural frequencies and floor"),
    ("unexplained", "Unexplained"),
)
"""Key in the findings and title of each part of the band, in the order of bar and table: together all of it."""

_TOTAL = ("total", "Mean square of the band, all speeds")
_ABOVE = ("above_band", "Above the band, of all recorded")  # no part of the band
_LONG = 30  # rows; a table with more has a filter, and no more of it are printed
_MOST = 400  # rows of a table in a page; the files hold all


@dataclass
class Table:
    """One table of the page; ``more`` is folded away under it, ``beside`` stands open under it, ``bars`` above it.

    Each of ``columns`` has its ``title`` and whether it holds a ``number``. ``bars`` are stacked bars of length 100
    with ``name`` and ``parts``, each with its ``kind``, ``start`` and ``width``.
    """

    title: str
    columns: list[dict[str, object]]
    rows: list[list[str]]
    empty: str = ""
    note: str = ""
    more: Table | None = None
    beside: Table | None = None
    bars: Sequence[dict[str, object]] = ()

    @property
    def is_long(self) -> bool:
        """Whether it has more rows than stand on paper; such a table has a filter."""
        return len(self.rows) > _LONG

    @property
    def parts(self) -> list[Table]:
        """The table itself and those that stand under it."""
        return [self, *filter(None, (self.beside, self.more))]


def table_of(
    title: str, heads: str, rows: list[list[str]], *, empty: str = "", note: str = "", more: Table | None = None
) -> Table:
    """Table ``title`` with ``heads`` separated by ``|``; a head that ends in ``#`` is a column of numbers.

    ``rows`` are of text; a page holds the first 400. ``empty`` stands in their place where there are none, ``note``
    above them; ``more`` is folded away.
    """
    columns = [dict[str, object](title=head.removesuffix("#"), number=head.endswith("#")) for head in heads.split("|")]
    if len(rows) > _MOST:
        note = f"{note} The first {_MOST} of {len(rows)}; findings.json holds all.".strip()
    return Table(title, columns, rows[:_MOST], empty, note, more)


def tables_of(findings: Findings, *, limit: int) -> list[tuple[str, Table]]:
    """Anchor and table of every list in ``findings``; texts from files are cut at ``limit`` characters.

    Findings that were not asked for have only the remarks on the recordings: an empty list of orders would deny any.
    Tables that only some findings have (tones, doubts, speeds to avoid, energy) are left out where they are empty.
    """
    if findings.not_asked_for:
        return [("quality", _quality(findings, limit))]
    tables = {anchor: table(findings, limit) for anchor, table in _TABLES.items()}
    return [(anchor, table) for anchor, table in tables.items() if table.rows or table.empty]


def _avoid(findings: Findings, limit: int) -> Table:
    """Speeds to avoid, ranked, and under them the other bands; empty where the findings have no such lists."""
    bands: list[tuple[FreeBand | OpenBand, str]] = [(band, "free") for band in findings.free_bands]
    bands += [(band, "not free, or not known") for band in findings.open_bands or ()]
    other = [
        [speeds_text((band.low_rpm, band.high_rpm)), _whole(band.high_rpm - band.low_rpm), verdict,
         named(band.remark or "–", limit=8 * limit)]
        for band, verdict in sorted(bands, key=lambda pair: pair[0].low_rpm)
    ]  # fmt: skip
    rows = [
        [str(record.rank), _whole(record.rpm), speeds_text(record.rpm_range or ()),
         order_estimate(record, findings), _hertz(record, "mode_hz"), named(record.channel, limit=limit),
         _peak_text(record, findings), _times(record, "amplification"), named(record.reason, limit=4 * limit)]
        for record in findings.speeds_to_avoid or ()
    ]  # fmt: skip
    heads = "Rank#|Speed, rpm#|Avoid, rpm#|Order#|Natural frequency, Hz#|Channel|Peak there#|Amplification#|Why"
    beside = table_of("Free and open bands of speed", "Speeds, rpm#|Width, rpm#|Verdict|Remark", other)
    met = any(record.in_range for record in findings.crossings)
    # a natural frequency that is met beyond the tested speeds alone may amplify an order within
    by_a_flank = not met and any(band.amplified for band in findings.open_bands or ())
    unknown = FLANK_ALONE if by_a_flank else NOTHING_TOLD
    empty = (NOTHING_RISES if all_judged(findings) else unknown) if findings.speeds_to_avoid is not None else ""
    note = "Peak and amplification of the first order alone; by fit: what the modal fit says of a held speed."
    note = f"{note} The worst first: by that peak, of several units by its share of the largest order." if rows else ""
    table = table_of("Speeds to avoid", heads, rows, note=note, empty=empty)
    table.beside = beside if other else None
    return table


def _peak_text(record: AvoidedSpeed, findings: Findings) -> str:
    """Peak at a speed to avoid, with ``≥`` where it may be larger; ``"–"`` where none is known."""
    if not is_number(record.amplitude) or record.amplitude <= 0:
        return "–"
    level = estimate_text(record, "amplitude", unit=unit_of(findings, record))
    return f"{'≥ ' * record.at_least}{level}{' by fit' * record.by_fit}"


def _orders(findings: Findings, limit: int) -> Table:
    loudest = strongest_by(findings.orders, lambda record: unit_of(findings, record))
    largest = {unit: record.amplitude or 1.0 for unit, record in loudest.items()}
    rows = []
    for record in sorted(findings.orders, key=lambda order: -order.amplitude / largest[unit_of(findings, order)]):
        lock: str | None = record.lock
        if lock == "slips" and hertz_of_order(record, findings):
            lock = "no exact multiple"
        elif lock == "undecided" and is_number(record.revs_to_decide):
            lock = f"undecided: {record.revs_to_decide:.0f} revolutions needed"
        lock = ", ".join(filter(None, (lock, "half order" * record.half_order))) or "–"
        rows.append([
            named(record.channel, limit=limit), order_estimate(record, findings),
            named(record.explained_by or "", limit=2 * limit), named(lock, limit=80),
            estimate_text(record, "amplitude", unit=unit_of(findings, record)), _whole(record.speed_rpm_at_max),
            estimate_text(record, "phase_deg"), estimate_text(record, "speed_exponent"),
            named((record.speed_law or "–").split(" with speed")[0], limit=limit), _hertz(record, "meets_hz"),
            speeds_text(record.speed_range_rpm),
        ])  # fmt: skip
    note = "The strongest first; where all speeds follow one law the amplitude is that of the law. "
    note += "Speed exponent: 2 grows as the force of an unbalanced mass, 0 keeps its size."
    heads = "Channel|Order#|Explained by|To the shaft|Largest amplitude (peak)#|At, rpm#|Phase there, °#"
    heads += "|Speed exponent#|With speed|Meets, Hz#|Seen, rpm#"
    return table_of("Orders", heads, rows, note=note if rows else "", empty=no_order_sentence(findings))


def _modes(findings: Findings, limit: int) -> Table:
    rows = []
    for mode in sorted(findings.modes, key=lambda mode: -_shaken(mode, findings)):
        if not is_tone(mode) and not is_undecided(mode):
            reached = ", ".join(order_texts(sorted(map(nominal_order, mode.reached_by_orders or ()))))
            none = "–" if mode.reached_by_orders is None else "no order was seen to excite it"
            rows.append(_mode_row(mode, reached or none, limit))
    note = "Those first at which orders are amplified most." if len(rows) > 1 and findings.crossings else ""
    heads = "Frequency, Hz#|Damping, %#|Channels|Reached by orders|Evidence"
    return table_of("Natural frequencies", heads, rows, note=note, empty=no_mode_sentence(findings))


def _mode_row(mode: ModeFinding, remark: str, limit: int) -> list[str]:
    channels, evidence = named(", ".join(mode.channels), limit=limit), named(mode.evidence, limit=4 * limit)
    damping = estimate_text(mode, "damping_ratio", factor=100)
    return [estimate_text(mode, "frequency_hz"), damping, channels, remark, evidence]


def _shaken(mode: ModeFinding, findings: Findings) -> float:
    """Largest amplification of an order that excites ``mode`` in the tested range; 0 where none does."""
    own = (met for met in findings.crossings if abs(met.mode_hz - mode.frequency_hz) <= 1e-3 * mode.frequency_hz)
    return max((met.amplification or 1.0 for met in own if met.excited and met.in_range), default=0.0)


def _undecided(findings: Findings, limit: int) -> Table:
    modes = filter(is_undecided, findings.modes)
    rows = [_mode_row(mode, named(mode.undecided or "", limit=4 * limit), limit) for mode in modes]
    heads = "Frequency, Hz#|Damping, %#|Channels|Why it is not decided|Evidence"
    return table_of("Perhaps natural frequencies: not decided", heads, rows)


def _tones(findings: Findings, limit: int) -> Table:
    """Tones and mains, one row per tone and channel."""
    rows = []
    for tone in fixed_tones(findings):
        kind, frequency = named(tone.record.explained_by, limit=limit), estimate_text(tone.record, "frequency_hz")
        evidence = named(tone.record.evidence or "–", limit=4 * limit)
        levels = [(line.channel, estimate_text(line, "amplitude", unit=unit_of(findings, line))) for line in tone.lines]
        for channel, level in levels or [(", ".join(tone.record.channels), "–")]:
            rows.append([frequency, kind, named(channel, limit=limit), level, evidence])
    heads = "Frequency, Hz#|What it is|Channel|Amplitude (peak)#|Evidence"
    return table_of("Tones and mains: no natural frequencies", heads, rows)


def _crossings(findings: Findings, limit: int) -> Table:
    inside, outside = list[list[str]](), list[list[str]]()
    for record in sorted(findings.crossings, key=lambda crossing: (not crossing.excited, crossing.rpm)):
        response = "excited" if record.excited else "not excited" if record.in_range else "not measured"
        channels = record.channels or filter(None, [record.channel])
        (inside if record.in_range else outside).append([
            order_estimate(record, findings), estimate_text(record, "mode_hz"),
            estimate_text(record, "rpm") if record.rpm_ci95 is not None else _whole(record.rpm),
            _times(record, "amplification") if record.in_range else "–", _times(record, "amplification_predicted"),
            named(record.verdict or response, limit=limit), named(", ".join(channels), limit=limit) or "–",
            named("; ".join(filter(None, (record.evidence, record.remark))) or "–", limit=4 * limit),
        ])  # fmt: skip
    heads = "Order#|Natural frequency, Hz#|Speed, rpm#|Amplification measured#|Predicted#|Response|In channels|Evidence"
    title = f"{len(outside)} crossing{'s' * (len(outside) > 1)} extrapolated beyond the tested speeds"
    more = table_of(title, heads, outside) if outside else None
    note = "Speeds at which an order meets a natural frequency; excited ones first." if inside else ""
    empty = "No order crosses a natural frequency inside the tested speeds."
    return table_of("Crossings", heads, inside, note=note, empty=empty, more=more)


def _times(record: Record, key: str) -> str:
    """An amplification as ``"× 12 (10…14)"``; ``"–"`` where there is none."""
    factor = getattr(record, key)
    if not is_number(factor) or factor <= 0:
        return "–"
    if (least := least_of(record, key)) is not None:
        return f"≥ × {number_text(least, digits=2)}"
    ends = getattr(record, f"{key}_ci95", None)
    return f"× {estimate_text(record, key) if ends else number_text(factor, digits=2)}"


def _bearings(findings: Findings, limit: int) -> Table:
    """Bearing lines with what was expected, found and concluded."""
    rows = []
    for record in findings.bearings:
        band, multiples, apart = envelope_band(record), record.harmonics, record.sidebands
        seen = named(record.seen_in or "–", limit=limit)
        level = estimate_text(record, "amplitude", unit=unit_of(findings, record))
        rows.append([
            named(record.name, limit=limit), named(record.line, limit=limit).replace("*", "·"),
            named(record.verdict, limit=4 * limit), f"{seen}, {band} Hz" if band else seen,
            f"{record.order_expected:.4f}".rstrip("0").rstrip("."), order_estimate(record, findings),
            estimate_text(record, "slip_percent") if record.slip_percent_ci95 else "–",
            level + ", mean of all speeds" * record.is_mean, named(record.channel or "–", limit=limit),
            "–" if multiples is None else str(multiples), order_text(apart) if is_number(apart) else "–",
            named(record.lock or "–", limit=limit),
        ])  # fmt: skip
    heads = "Bearing|Line|Verdict|Seen in|Order expected#|Order found#|Slip, %#|Amplitude (peak)#|Channel|Multiples#"
    heads += "|Sidebands, orders apart#|To the shaft"
    return table_of("Bearings", heads, rows, empty=bearing_sentence(findings) or "No line of a bearing was found.")


def _balance(findings: Findings, limit: int) -> Table:
    """Residual unbalance with intervals, then what is not decided and why."""
    balance, rows, note = findings.balance, list[list[str]](), ""
    if balance is not None:
        for key, (title, unit) in stated_quantities(balance).items():
            rows.append([named(title, limit=limit), estimate_text(balance, key, unit=unit)])
        if is_number(balance.grade_mm_s):
            title = f"Balance grade G (ISO 21940-11) at {_whole(balance.grade_speed_rpm)} rpm"
            rows.append([title, estimate_text(balance, "grade_mm_s", unit="mm/s")])
        rows += [[title, f"not decided: {why}"] for title, why in undecided_quantities(balance)]
        note = f"Worked out{source_text(balance)}. " if balance.source else ""
        note = f"{note}{named(balance.evidence, limit=6 * limit)}".strip()
    reason = findings.balance_reason
    why = f" The reason: {reason_text(reason)}." if reason else ""
    return table_of("Balance", "Quantity|Value", rows, note=note, empty=f"No residual unbalance was worked out.{why}")


def _limits(findings: Findings, limit: int) -> Table:
    """What the limits of the manifest come to; empty where there are none."""
    rows = [
        [named(record.channel or "–", limit=limit), named(record.quantity, limit=limit),
         "–" if record.band_hz is None else band_of(record.band_hz, None), record.verdict,
         estimate_text(record, "level", unit=unit_text(record.unit)),
         with_interval(record.value, None, unit=unit_text(record.unit)), _whole(record.speed_rpm),
         named(record.source, limit=2 * limit), named(record.evidence or "–", limit=4 * limit)]
        for record in findings.limits
    ]  # fmt: skip
    heads = "Channel|Quantity|Band|Verdict|Largest level (r.m.s.)#|Limit#|Speed, rpm#|Written in|Why"
    return table_of("Limits", heads, rows)


def _levels(findings: Findings, limit: int) -> Table:
    """Overall levels, the largest over speed; at every speed folded under it."""
    every, largest = list[list[str]](), list[list[str]]()
    for level in findings.vibration_levels:
        unit = unit_text(level.unit)
        every.append([
            named(level.channel, limit=limit), named(level.quantity, limit=limit),
            band_of(level.band_hz, level.reached_hz), _whole(level.speed_rpm),
            *(estimate_text(level, key, unit=unit) for key in ("rms", "peak", "largest_peak")),
            estimate_text(level, "crest_factor"),
        ])  # fmt: skip
        largest += every[-1:] * level.largest
    whole = [
        [named(level.channel, limit=limit), "as recorded", "all", "–",
         with_interval(level.rms_max, None, unit=unit_of(findings, level)), "–", "–", "–"]
        for level in findings.levels
        if is_number(level.rms_max)
    ]  # fmt: skip
    heads = "Channel|Quantity|Band|Speed, rpm#|r.m.s.#|Mean peak#|Largest peak#|Crest factor#"
    more = table_of("Levels at every speed", heads, every) if len(every) > len(largest) else None
    note = "At the speed where each is largest; peaks and crest factors are means over short pieces." if largest else ""
    note = f"{note} As recorded: all of the loudest recording, without the mean.".strip() if whole else note
    return table_of("Overall levels", heads, [*largest, *whole], note=note, more=more)


def _third_octaves(findings: Findings, limit: int) -> Table:
    """One-third octaves: the strongest of each channel."""
    loudest = {octave.channel: octave for octave in sorted(findings.third_octaves, key=lambda octave: octave.rms)}
    rows = [
        [named(channel, limit=limit), _whole(octave.speed_rpm), f"{octave.nominal_hz:g}",
         estimate_text(octave, "rms", unit=unit_text(octave.unit))]
        for channel, octave in sorted(loudest.items())
    ]  # fmt: skip
    note = "The strongest of each channel, where all its octaves together are largest; findings.json holds all "
    note = f"{note}{len(findings.third_octaves)}." if rows else ""
    return table_of("One-third octaves", "Channel|Speed, rpm#|Mid-band, Hz#|r.m.s.#", rows, note=note)


def _energy(findings: Findings, limit: int) -> Table:
    """Share of each part of the energy, one row and one bar per channel; empty where not known."""
    energy = findings.energy
    channels, end = ((), None) if energy is None else (energy.channels, energy.band_hz)
    records = [record for record in channels if any(is_number(getattr(record, key)) for key, _ in PARTS)]
    columns = [*PARTS, _TOTAL, *[_ABOVE] * any(is_number(record.above_band) for record in records)]

    def cell(record: EnergyShares, key: str) -> str:
        if key == "total":
            return with_interval(record.total, None, unit=_square_unit(record.unit or ""))
        return percent_text(share) if is_number(share := getattr(record, key)) else "–"

    rows = [[named(record.channel, limit=limit), *(cell(record, key) for key, _ in columns)] for record in records]
    title = "Where the energy is" + (f", up to {frequency_text(end)} Hz" if is_number(end) else "")
    table = table_of(title, "|".join(["Channel", *(f"{head}#" for _, head in columns)]), rows)
    table.bars = [_bar(record, limit) for record in records]
    return table


def _square_unit(unit: str) -> str:
    """Typographic form of a squared unit: ``"(m/s²)²"`` for ``"(m/s2)²"``, ``"V²"`` for ``"(V)²"``."""
    inner = unit_text(unit[1:-2])
    squared = f"{inner}²" if inner.isalnum() else f"({inner})²"
    return squared if unit.startswith("(") and unit.endswith((")²", ")2")) else unit_text(unit)


def _bar(record: EnergyShares, limit: int) -> dict[str, object]:
    """Parts of a bar of length 100; shares that add up to more than all are scaled down to it."""
    shares = {key: max(getattr(record, key) or 0.0, 0.0) for key, _ in PARTS}
    scale = 100 / max(1.0, sum(shares.values()))
    widths = {key.replace("_", "-"): scale * share for key, share in shares.items()}
    starts = accumulate(widths.values(), initial=0.0)
    spans = [(kind, start, width) for (kind, width), start in zip(widths.items(), starts, strict=False) if width > 0]
    parts = [{"kind": kind, "start": f"{start:.2f}", "width": f"{width:.2f}"} for kind, start, width in spans]
    return {"name": named(record.channel, limit=limit), "parts": parts}


def _lines(findings: Findings, limit: int) -> Table:
    rows = []
    for line in sorted(findings.lines, key=lambda line: -line.size):
        hertz = f"{estimate_text(line, 'frequency_hz')} Hz"
        place = hertz if line.order is None else f"order {order_estimate(line, findings)}"
        level = estimate_text(line, "amplitude", unit=unit_of(findings, line))
        explained = named(line.explained_by or "unexplained", limit=2 * limit)
        rows.append([named(line.channel, limit=limit), place, level, explained])
    note = energy_sentence(findings) if rows else ""
    empty = "No line of the vibration itself stands above the false-alarm level in the band that was looked at."
    return table_of("Lines", "Channel|Line|Amplitude (peak)#|Explained by", rows, note=note, empty=empty)


def _quality(findings: Findings, limit: int) -> Table:
    """Remarks by kind, the gravest first: of how many recordings, and the first of them; all of them folded away."""
    rank = {"bad": 0, "suspect": 1}
    every, kinds = list[list[str]](), dict[tuple[str, str], list[Quality]]()
    for remark in sorted(findings.quality, key=lambda remark: rank.get(remark.severity, 2)):
        texts = [named(text, limit=limit) for text in (remark.recording, remark.severity, remark.flag)]
        every.append([*texts, named(remark.detail, limit=4 * limit)])
        kinds.setdefault((remark.severity, remark.flag), []).append(remark)
    rows = []
    for (severity, flag), alike in kinds.items():
        count, first = len({remark.recording for remark in alike}), alike[0]
        example = f"{named(first.recording, limit=limit)}: {named(first.detail, limit=4 * limit)}"
        rows.append([named(severity, limit=limit), named(flag, limit=limit), str(count), str(len(alike)), example])
    everything = table_of(f"All {len(every)} remarks", "Recording|Severity|Flag|Detail", every)
    more = everything if len(rows) < len(every) else None
    heads = "Severity|Flag|Recordings#|Remarks#|First of them"
    note = "One row per kind; all of them are folded away below." if more else ""
    return table_of("Quality", heads, rows, note=note, empty="No remark on any recording.", more=more)


def _hertz(record: Record, key: str) -> str:
    value = getattr(record, key)
    if not is_number(value):
        return "–"
    return estimate_text(record, key) if getattr(record, f"{key}_ci95", None) else order_text(round(value, 1))


def _whole(value: float | None) -> str:
    """``value`` as a whole number; a dash where it is not known."""
    return f"{value:.0f}" if is_number(value) else "–"


_TABLES = {
    "avoid": _avoid, "orders": _orders, "modes": _modes, "undecided": _undecided, "tones": _tones,
    "crossings": _crossings, "bearings": _bearings, "balance": _balance, "limits": _limits, "levels": _levels,
    "third-octaves": _third_octaves, "energy": _energy, "lines": _lines, "quality": _quality,
}  # fmt: skip
"""Tables of the page by anchor, in its order."""


def provenance_table(provenance: Mapping[str, object]) -> Table:
    """Inputs, versions and settings of ``provenance`` (as in ``data_schema/run.json``), one row per value, folded."""
    rows = [[named(key, limit=120), named(value, limit=200)] for key, value in _flat("", provenance)][:_MOST]
    title, empty = "Inputs with hashes, versions and settings", "Nothing was recorded."
    everything = table_of(title, "Key|Value", rows, empty=empty)
    versions = provenance.get("versions")
    programs = versions.items() if isinstance(versions, Mapping) else ()
    short = [[named(text, limit=60) for text in program] for program in programs]
    return table_of("Provenance", "Program|Version", short, empty="No versions were recorded.", more=everything)


def _flat(prefix: str, value: object) -> list[tuple[str, object]]:
    """``value`` of JSON as pairs of a path that begins with ``prefix`` and a text or number."""
    if isinstance(value, Mapping):
        return [pair for key, part in value.items() for pair in _flat(f"{prefix}.{key}" if prefix else str(key), part)]
    if not isinstance(value, list | tuple):
        return [(prefix, value)]
    if any(isinstance(part, dict | list | tuple) for part in value):
        return [pair for number, part in enumerate(value, start=1) for pair in _flat(f"{prefix} {number}", part)]
    return [(prefix, ", ".join(map(str, value)))]
