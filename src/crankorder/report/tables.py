"""The tables of the report page: findings as rows of text, every estimate with its 95 % interval."""

from __future__ import annotations

import re
from typing import cast

from crankorder.channel_units import unit_text
from crankorder.findings import (
    AvoidedSpeed,
    CrossingFinding,
    EnergyShares,
    Findings,
    FreeBand,
    ModeFinding,
    OpenBand,
    OrderFinding,
    Quality,
)
from crankorder.plot.fixed_lines import hertz_of_order
from crankorder.records import Record
from crankorder.report.notation import (
    Numbered,
    estimate_text,
    frequency_text,
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
    speeds_text,
    strongest_by,
    unit_of,
    with_interval,
)
from crankorder.report.rows import Bar, Table, folded, table_of
from crankorder.report.sentences.of_lines import no_order_sentence
from crankorder.report.sentences.of_speeds import all_judged
from crankorder.report.sentences.story import energy_sentence
from crankorder.report.tables_of_sources import (
    balance_table,
    bearing_table,
    level_table,
    limit_table,
    number_of,
    octave_table,
    tone_table,
)

__all__ = ["Table", "table_of", "tables_of"]

NOTHING_RISES = "No order was seen to rise at a natural frequency inside the tested speeds."
NOTHING_TOLD = "None is known. That is no proof that there is none: the bands below are not free, or nobody knows."

FLANK_ALONE = (
    "No order meets a natural frequency inside the tested speeds; the flank of one beyond them reaches in, as the "
    "bands below say."
)


def tables_of(findings: Findings, *, limit: int) -> list[tuple[str, Table]]:
    """Anchor and table of every list in ``findings``; texts from files are cut at ``limit`` characters.

    Of findings that were not asked for only the remarks on the recordings: an empty list of orders would deny them.
    Tables that only some findings have (tones, doubts, speeds to avoid, energy) are left out where they are empty.
    """
    if findings.not_asked_for:
        return [("quality", _quality(findings, limit))]
    made = [
        ("avoid", _avoid(findings, limit)),
        ("orders", _orders(findings, limit)),
        ("modes", _modes(findings, limit)),
        ("undecided", _undecided(findings, limit)),
        ("tones", tone_table(findings, limit)),
        ("crossings", _crossings(findings, limit)),
        ("bearings", bearing_table(findings, limit)),
        ("balance", balance_table(findings, limit)),
        ("limits", limit_table(findings, limit)),
        ("levels", level_table(findings, limit)),
        ("third-octaves", octave_table(findings, limit)),
        ("energy", energy_table(findings, limit)),
        ("lines", _lines(findings, limit)),
        ("quality", _quality(findings, limit)),
    ]
    return [(anchor, one) for anchor, one in made if one["rows"] or one["empty"]]


def _avoid(findings: Findings, limit: int) -> Table:
    """Speeds to avoid, ranked, and under them the other bands; empty where the findings have no such lists."""
    bands: list[tuple[FreeBand | OpenBand, str]] = [(band, "free") for band in findings.free_bands]
    bands += [(band, "not free, or not known") for band in findings.open_bands or []]
    other = []
    for band, verdict in sorted(bands, key=lambda item: item[0].low_rpm):
        ends, remark = (band.low_rpm, band.high_rpm), named(band.remark or "–", limit=8 * limit)
        other.append([speeds_text(ends), number_of(ends[1] - ends[0]), verdict, remark])
    rows = [
        [
            number_of(record.rank),
            number_of(record.rpm),
            speeds_text(record.rpm_range or ()),
            order_estimate(record, findings),
            _hertz(record, "mode_hz"),
            named(record.channel or "", limit=limit),
            _peak_text(record, findings),
            _times(record, "amplification"),
            named(record.reason or "", limit=4 * limit),
        ]
        for record in findings.speeds_to_avoid or []
    ]
    heads = "Rank#|Speed, rpm#|Avoid, rpm#|Order#|Natural frequency, Hz#|Channel|Peak there#|Amplification#|Why"
    beside = table_of("Free and open bands of speed", "Speeds, rpm#|Width, rpm#|Verdict|Remark", other, empty="")
    met = any(record.in_range for record in findings.crossings)
    # a natural frequency that is met beyond the tested speeds alone may amplify an order within
    by_a_flank = not met and any(band.amplified for band in findings.open_bands or [])
    told = FLANK_ALONE if by_a_flank else NOTHING_TOLD
    empty = (NOTHING_RISES if all_judged(findings) else told) if findings.speeds_to_avoid is not None else ""
    note = "Peak and amplification of the first order alone; by fit: what the modal fit says of a held speed."
    note = f"{note} The worst first: by that peak, of several units by its share of the largest order." if rows else ""
    return table_of("Speeds to avoid", heads, rows, note=note, empty=empty, beside=beside if other else None)


def _peak_text(record: AvoidedSpeed, findings: Findings) -> str:
    """Peak at a speed to avoid, with ``≥`` where it may be larger; ``"–"`` where none is known."""
    if not is_number(record.amplitude) or record.amplitude <= 0:
        return "–"
    level = estimate_text(record, "amplitude", unit=unit_of(findings, record))
    return f"{'≥ ' * record.at_least}{level}{' by fit' * record.by_fit}"


def _orders(findings: Findings, limit: int) -> Table:
    records = [record for record in findings.orders if is_number(record.order)]
    loudest = strongest_by(records, lambda one: unit_of(findings, one))
    records.sort(key=lambda one: -one.amplitude / (loudest[unit_of(findings, one)].amplitude or 1.0))
    rows = [_order_row(record, findings, limit) for record in records]
    note = (
        "The strongest first; where all speeds follow one law the amplitude is that of the law. "
        "Speed exponent: 2 grows as the force of an unbalanced mass, 0 keeps its size."
    )
    heads = (
        "Channel|Order#|Explained by|To the shaft|Largest amplitude (peak)#|At, rpm#|Phase there, °#|Speed exponent#|"
        "With speed|Meets, Hz#|Seen, rpm#"
    )
    return folded("Orders", heads, rows, note=note if rows else "", empty=no_order_sentence(findings))


def _order_row(record: OrderFinding, findings: Findings, limit: int) -> list[str]:
    law = str(record.speed_law or "–")
    return [
        named(record.channel, limit=limit),
        order_estimate(record, findings),
        named(record.explained_by or "", limit=2 * limit),
        _lock(record, findings),
        estimate_text(record, "amplitude", unit=unit_of(findings, record)),
        number_of(record.speed_rpm_at_max),
        estimate_text(record, "phase_deg"),
        estimate_text(record, "speed_exponent"),
        named(law.split(" with speed")[0], limit=limit),
        _hertz(record, "meets_hz"),
        speeds_text(record.speed_range_rpm),
    ]


def _lock(record: OrderFinding, findings: Findings) -> str:
    """``"locked"``, ``"slips"``, ``"undecided: 400 revolutions needed"``; half orders say so.

    Of a line of which nothing tells whether it follows the shaft at all it is only said that it is no multiple.
    """
    said = str(record.lock or "")
    if said == "slips" and hertz_of_order(record, findings) is not None:
        said = "no exact multiple"
    if said == "undecided" and is_number(record.revs_to_decide):
        said = f"undecided: {record.revs_to_decide:.0f} revolutions needed"
    half = "half order" if record.half_order is True else ""
    return named(", ".join(part for part in (said, half) if part) or "–", limit=80)


def _modes(findings: Findings, limit: int) -> Table:
    rows = [
        _mode_row(record, _reached(record), limit)
        for record in sorted(findings.modes, key=lambda one: -_shaken(one, findings))
        if not is_tone(record) and not is_undecided(record)
    ]
    note = "Those first at which orders are amplified most." if len(rows) > 1 and findings.crossings else ""
    heads = "Frequency, Hz#|Damping, %#|Channels|Reached by orders|Evidence"
    return table_of("Natural frequencies", heads, rows, note=note, empty="No natural frequency was found.")


def _mode_row(record: ModeFinding, about: str, limit: int) -> list[str]:
    channels = named(", ".join(record.channels or ()), limit=limit)
    evidence = named(record.evidence or "", limit=4 * limit)
    return [estimate_text(record, "frequency_hz"), _in_percent(record), channels, about, evidence]


def _shaken(mode: ModeFinding, findings: Findings) -> float:
    """Largest amplification of an order that excites ``mode`` in the tested range; 0 where none does."""
    own = (one for one in findings.crossings if abs(one.mode_hz - mode.frequency_hz) <= 1e-3 * mode.frequency_hz)
    return max((float(one.amplification or 1.0) for one in own if one.excited and one.in_range), default=0.0)


def _reached(record: ModeFinding) -> str:
    orders = record.reached_by_orders
    if orders is None:
        return "–"
    numbers = sorted(nominal_order(float(order)) for order in orders if is_number(order))
    return ", ".join(order_texts(numbers)) if numbers else "no order was seen to excite it"


def _undecided(findings: Findings, limit: int) -> Table:
    rows = [
        _mode_row(record, named(record.undecided or "", limit=4 * limit), limit)
        for record in findings.modes
        if is_undecided(record)
    ]
    heads = "Frequency, Hz#|Damping, %#|Channels|Why it is not decided|Evidence"
    return table_of("Perhaps natural frequencies: not decided", heads, rows, empty="")


def _in_percent(record: ModeFinding) -> str:
    """Damping ratio in percent, with its interval."""
    value, ends = record.damping_ratio, record.damping_ratio_ci95
    percent = [None if end is None else 100 * end for end in (value, *(ends or (None, None)))]
    return with_interval(percent[0], percent[1:])


def _crossings(findings: Findings, limit: int) -> Table:
    records = sorted(findings.crossings, key=lambda one: (not one.excited, float(one.rpm or 0)))
    inside = [_crossing(record, findings, limit) for record in records if record.in_range]
    outside = [_crossing(record, findings, limit) for record in records if not record.in_range]
    heads = "Order#|Natural frequency, Hz#|Speed, rpm#|Amplification measured#|Predicted#|Response|In channels|Evidence"
    title = f"{len(outside)} crossing{'s' * (len(outside) > 1)} extrapolated beyond the tested speeds"
    more = table_of(title, heads, outside, empty="") if outside else None
    note = "Speeds at which an order meets a natural frequency; excited ones first." if inside else ""
    empty = "No order crosses a natural frequency inside the tested speeds."
    return table_of("Crossings", heads, inside, note=note, empty=empty, more=more)


def _crossing(record: CrossingFinding, findings: Findings, limit: int) -> list[str]:
    response = "excited" if record.excited else "not excited" if record.in_range else "not measured"
    evidence = "; ".join(str(part) for part in (record.evidence, record.remark) if part)
    channels = record.channels or ((record.channel,) if record.channel else ())
    return [
        order_estimate(record, findings),
        estimate_text(record, "mode_hz"),
        estimate_text(record, "rpm") if record.rpm_ci95 is not None else number_of(record.rpm),
        _times(record, "amplification") if record.in_range else "–",
        _times(record, "amplification_predicted"),
        named(record.verdict or response, limit=limit),
        named(", ".join(str(name) for name in channels), limit=limit) or "–",
        named(evidence or "–", limit=4 * limit),
    ]


def _times(record: Record, key: str) -> str:
    """An amplification as ``"× 12 (10…14)"``; ``"–"`` where there is none."""
    factor = getattr(record, key)
    if not is_number(factor) or factor <= 0:
        return "–"
    if (least := least_of(record, key)) is not None:
        return f"≥ × {number_text(least, digits=2)}"
    ends = getattr(record, f"{key}_ci95", None)
    return f"× {estimate_text(record, key) if ends else number_text(factor, digits=2)}"


def _lines(findings: Findings, limit: int) -> Table:
    records = sorted(findings.lines, key=lambda one: -float(one.amplitude or 0))
    rows = []
    for record in records:
        place = f"{estimate_text(record, 'frequency_hz')} Hz"
        if record.order is not None:
            place = f"order {order_estimate(cast('Numbered', record), findings)}"
        level = estimate_text(record, "amplitude", unit=unit_of(findings, record))
        explained = named(record.explained_by or "unexplained", limit=2 * limit)
        rows.append([named(record.channel, limit=limit), place, level, explained])
    note = energy_sentence(findings) if rows else ""
    heads = "Channel|Line|Amplitude (peak)#|Explained by"
    empty = "No line of the vibration itself stands above the false-alarm level in the band that was looked at."
    return folded("All lines", heads, rows, note=note, empty=empty)


def _quality(findings: Findings, limit: int) -> Table:
    """Remarks by kind, the gravest first: of how many recordings, and the worst of them; all of them folded away."""
    rank = {"bad": 0, "suspect": 1}
    records = sorted(findings.quality, key=lambda one: rank.get(one.severity, 2))
    keys = ("recording", "severity", "flag", "detail")
    every = [
        [named(getattr(record, key), limit=4 * limit if key == "detail" else limit) for key in keys]
        for record in records
    ]
    kinds: dict[tuple[str, str], list[Quality]] = {}
    for record in records:
        kinds.setdefault((record.severity, record.flag), []).append(record)
    rows = []
    for (severity, flag), alike in kinds.items():
        worst = _worst(alike)
        count = len({record.recording for record in alike})
        case = f"{named(worst.recording, limit=limit)}: {named(worst.detail, limit=4 * limit)}"
        rows.append([named(severity, limit=limit), named(flag, limit=limit), str(count), str(len(alike)), case])
    everything = table_of(f"All {len(every)} remarks", "Recording|Severity|Flag|Detail", every, empty="")
    more = everything if len(rows) < len(every) else None
    heads = "Severity|Flag|Recordings#|Remarks#|Worst case"
    note = "One row per kind; of several the one whose numbers differ most from good." if more else ""
    return table_of("Quality", heads, rows, note=note, empty="No remark on any recording.", more=more)


_NUMBER = re.compile(r"(?<![\w.])[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_TOO_LITTLE = ("only", "fewer", "less than", "at least", "shorter", "below", "too few")


def _worst(alike: list[Quality]) -> Quality:
    """The remark of one kind that says most: the largest number that tells its text from the others.

    Of texts that tell a shortage the smallest. A count out of a whole ("3 of 70") is taken as its share.
    """
    numbers = [_numbers_of(record.detail) for record in alike]
    length = min(len(one) for one in numbers)
    telling = [place for place in range(length) if len({one[place] for one in numbers}) > 1]
    if not telling:
        return alike[0]
    short = any(word in alike[0].detail for word in _TOO_LITTLE)
    chosen = (min if short else max)(range(len(alike)), key=lambda number: numbers[number][telling[-1]])
    return alike[chosen]


def _numbers_of(detail: str) -> list[float]:
    shares = re.sub(
        r"\b(\d+) of (\d+)\b", lambda found: repr(int(found[1]) / int(found[2])) if int(found[2]) else found[1], detail
    )
    return [float(text.replace("−", "-")) for text in _NUMBER.findall(shares)]


def _hertz(record: Record, key: str) -> str:
    value = getattr(record, key)
    if not is_number(value):
        return "–"
    return estimate_text(record, key) if getattr(record, f"{key}_ci95", None) else order_text(round(float(value), 1))


PARTS = (
    ("orders", "Orders"),
    ("tones", "Tones"),
    ("modes_and_floor", "Natural frequencies and floor"),
    ("unexplained", "Unexplained"),
)
"""Key in the findings and title of each part of the band, in the order of bar and table: together all of it."""

ABOVE = ("above_band", "Above the band, of all recorded")
"""Key and title of the share that no part of the band holds."""


def energy_table(findings: Findings, limit: int) -> Table:
    """Share of each part of the energy of ``findings``, one row and one bar per channel; empty where not known.

    Names are cut at ``limit`` characters.
    """
    energy = findings.energy
    channels = () if energy is None else energy.channels
    records = [one for one in channels if any(is_number(getattr(one, key)) for key, _ in PARTS)]
    columns = [*PARTS, *([ABOVE] if any(is_number(one.above_band) for one in records) else [])]
    rows = []
    for record in records:
        total, unit = record.total, _square_unit(record.unit or "")
        mean_square = f"{number_text(float(total))} {unit}".strip() if is_number(total) else "–"
        known = [getattr(record, key) for key, _ in columns]
        shares = [percent_text(share) if is_number(share) else "–" for share in known]
        shares.insert(len(PARTS), mean_square)
        rows.append([named(record.channel, limit=limit), *shares])
    titles = [title for _, title in columns]
    titles.insert(len(PARTS), "Mean square of the band")
    end = None if energy is None else energy.band_hz
    title = "Where the energy is" + (f", up to {frequency_text(float(end))} Hz" if is_number(end) else "")
    heads = "|".join(["Channel", *(f"{title}#" for title in titles)])
    return table_of(title, heads, rows, empty="", bars=[_bar(record, limit) for record in records])


def _square_unit(unit: str) -> str:
    """Typographic form of a squared unit: ``"(m/s²)²"`` for ``"(m/s2)²"``, ``"V²"`` for ``"(V)²"``."""
    if not (unit.startswith("(") and unit.endswith((")²", ")2"))):
        return unit_text(unit)
    inner = unit_text(unit[1:-2])
    return f"({inner})²" if not inner.isalnum() else f"{inner}²"


def _bar(record: EnergyShares, limit: int) -> Bar:
    """Parts of a bar of length 100; shares that add up to more than all are scaled down to it."""
    shares = {key: max(getattr(record, key) or 0.0, 0.0) for key, _ in PARTS}
    scale = 100 / max(1.0, sum(shares.values()))
    parts, start = [], 0.0
    for key, _ in PARTS:
        width = scale * shares[key]
        if width > 0:
            parts.append({"kind": key.replace("_", "-"), "start": f"{start:.2f}", "width": f"{width:.2f}"})
        start += width
    return {"name": named(record.channel, limit=limit), "parts": parts}
