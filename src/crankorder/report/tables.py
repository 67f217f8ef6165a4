"""The tables of the report page: findings as rows of text, every estimate with its 95 % interval."""

from __future__ import annotations

from typing import Any

from crankorder.identify.said import AMPLIFIED
from crankorder.report.energy_shares import energy_table
from crankorder.report.notation import (
    estimate_text,
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
    speeds_text,
    unit_of,
)
from crankorder.report.rows import Table, folded, table_of
from crankorder.report.sentences.of_speeds import all_judged
from crankorder.report.sentences.story import NOT_ASKED_FOR, energy_sentence
from crankorder.report.tables_of_sources import balance_table, bearing_table, tone_table

__all__ = ["Table", "table_of", "tables_of"]

NOTHING_RISES = "No order was seen to rise at a natural frequency inside the tested speeds."
NOTHING_TOLD = "None is known. That is no proof that there is none: the bands below are not free, or nobody knows."

FLANK_ALONE = (
    "No order meets a natural frequency inside the tested speeds; the flank of one beyond them reaches in, as the "
    "bands below say."
)


def tables_of(findings: dict[str, Any], *, limit: int) -> list[tuple[str, Table]]:
    """Anchor and table of every list in ``findings``; texts from files are cut at ``limit`` characters.

    Of findings that were not asked for only the remarks on the recordings: an empty list of orders would deny them.
    Tables that only some findings have (tones, doubts, speeds to avoid, energy) are left out where they are empty.
    """
    if NOT_ASKED_FOR in findings:
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
        ("energy", energy_table(findings, limit)),
        ("lines", _lines(findings, limit)),
        ("quality", _quality(findings, limit)),
    ]
    return [(anchor, one) for anchor, one in made if one["rows"] or one["empty"]]


def _avoid(findings: dict[str, Any], limit: int) -> Table:
    """Speeds to avoid, ranked, and under them the other bands; empty where the findings have no such lists."""
    bands = [(band, "free") for band in findings.get("free_bands") or []]
    bands += [(band, "not free, or not known") for band in findings.get("open_bands") or []]
    other = [
        [
            speeds_text((band.get("low_rpm"), band.get("high_rpm"))),
            _whole(_width(band)),
            verdict,
            named(band.get("remark") or "–", limit=8 * limit),
        ]
        for band, verdict in sorted(bands, key=lambda item: float(item[0].get("low_rpm") or 0.0))
    ]
    rows = [
        [
            _whole(record.get("rank")),
            _whole(record.get("rpm")),
            speeds_text(record.get("rpm_range") or ()),
            order_estimate(record, findings),
            _hertz(record, "mode_hz"),
            named(record.get("channel") or "", limit=limit),
            _peak_text(record, findings),
            _times(record, "amplification"),
            named(record.get("reason") or "", limit=4 * limit),
        ]
        for record in findings.get("speeds_to_avoid") or []
    ]
    heads = "Rank#|Speed, rpm#|Avoid, rpm#|Order#|Natural frequency, Hz#|Channel|Peak there#|Amplification#|Why"
    beside = table_of("Free and open bands of speed", "Speeds, rpm#|Width, rpm#|Verdict|Remark", other, empty="")
    known = findings.get("speeds_to_avoid") is not None
    told = FLANK_ALONE if _by_a_flank(findings) else NOTHING_TOLD
    empty = (NOTHING_RISES if all_judged(findings) else told) if known else ""
    note = "The worst first: by the peak there in any channel, of several units by its share of the largest order."
    note = note if len(rows) > 1 else ""
    return table_of("Speeds to avoid", heads, rows, note=note, empty=empty, beside=beside if other else None)


def _by_a_flank(findings: dict[str, Any]) -> bool:
    """Whether a natural frequency that is met beyond the tested speeds alone is seen to amplify an order within."""
    met = any(record.get("in_range") for record in findings.get("crossings", []))
    return not met and any(AMPLIFIED in str(band.get("remark")) for band in findings.get("open_bands") or [])


def _peak_text(record: dict[str, Any], findings: dict[str, Any]) -> str:
    """Peak at a speed to avoid, with ``≥`` where it may be larger; ``"–"`` where none is known."""
    if not is_number(record.get("amplitude")) or record["amplitude"] <= 0:
        return "–"
    return f"{'≥ ' * bool(record.get('at_least'))}{estimate_text(record, 'amplitude', unit=unit_of(findings, record))}"


def _width(band: dict[str, Any]) -> float | None:
    low, high = band.get("low_rpm"), band.get("high_rpm")
    return float(high) - float(low) if is_number(low) and is_number(high) else None


def _orders(findings: dict[str, Any], limit: int) -> Table:
    records = [record for record in findings.get("orders", []) if is_number(record.get("order"))]
    records.sort(key=lambda one: (str(one.get("channel")), float(one["order"])))
    loudest: dict[str, float] = {}
    for record in records:
        channel = str(record.get("channel"))
        loudest[channel] = max(loudest.get(channel, 0.0), float(record.get("amplitude") or 0))
    rows = [_order_row(record, findings, limit) for record in records]
    shares = [float(one.get("amplitude") or 0) / (loudest[str(one.get("channel"))] or 1.0) for one in records]
    note = "Speed exponent: 2 grows as the force of an unbalanced mass, 0 keeps its size." if rows else ""
    heads = (
        "Channel|Order#|Explained by|To the shaft|Largest amplitude (peak)#|At, rpm#|Phase there, °#|Speed exponent#|"
        "With speed|Meets, Hz#|Seen, rpm#"
    )
    return folded("Orders", heads, rows, ranks=shares, note=note, empty="No order stands above the noise.")


def _order_row(record: dict[str, Any], findings: dict[str, Any], limit: int) -> list[str]:
    law = str(record.get("speed_law") or "–")
    return [
        named(record.get("channel", ""), limit=limit),
        order_estimate(record, findings),
        named(record.get("explained_by") or "", limit=2 * limit),
        _lock(record),
        estimate_text(record, "amplitude", unit=unit_of(findings, record)),
        _whole(record.get("speed_rpm_at_max")),
        estimate_text(record, "phase_deg"),
        estimate_text(record, "speed_exponent"),
        named(law.split(" with speed")[0], limit=limit),
        _hertz(record, "meets_hz"),
        speeds_text(record.get("speed_range_rpm") or ()),
    ]


def _lock(record: dict[str, Any]) -> str:
    """``"locked"``, ``"slips"``, ``"undecided: 400 revolutions needed"``; half orders say so."""
    said = str(record.get("lock") or ("locked" if record.get("locked") is True else ""))
    if said == "undecided" and is_number(record.get("revs_to_decide")):
        said = f"undecided: {record['revs_to_decide']:.0f} revolutions needed"
    half = "half order" if record.get("half_order") is True else ""
    return named(", ".join(part for part in (said, half) if part) or "–", limit=80)


def _modes(findings: dict[str, Any], limit: int) -> Table:
    rows = [
        [
            estimate_text(record, "frequency_hz"),
            estimate_text(_in_percent(record), "damping_ratio"),
            named(", ".join(str(name) for name in record.get("channels") or []), limit=limit),
            _reached(record),
            named(record.get("evidence") or "", limit=4 * limit),
        ]
        for record in findings.get("modes", [])
        if not is_tone(record) and not is_undecided(record)
    ]
    heads = "Frequency, Hz#|Damping, %#|Channels|Reached by orders|Evidence"
    return table_of("Natural frequencies", heads, rows, empty="No natural frequency was found.")


def _reached(record: dict[str, Any]) -> str:
    orders = record.get("reached_by_orders")
    if orders is None:
        return "–"
    numbers = sorted(nominal_order(float(order)) for order in orders if is_number(order))
    return ", ".join(order_texts(numbers)) if numbers else "no order was seen to excite it"


def _undecided(findings: dict[str, Any], limit: int) -> Table:
    rows = [
        [
            estimate_text(record, "frequency_hz"),
            estimate_text(_in_percent(record), "damping_ratio"),
            named(", ".join(str(name) for name in record.get("channels") or []), limit=limit),
            named(record.get("undecided") or "", limit=4 * limit),
            named(record.get("evidence") or "", limit=4 * limit),
        ]
        for record in findings.get("modes", [])
        if is_undecided(record)
    ]
    heads = "Frequency, Hz#|Damping, %#|Channels|Why it is not decided|Evidence"
    return table_of("Perhaps natural frequencies: not decided", heads, rows, empty="")


def _in_percent(record: dict[str, Any]) -> dict[str, Any]:
    value, interval = record.get("damping_ratio"), record.get("damping_ratio_ci95")
    percent: dict[str, Any] = {"damping_ratio": 100 * float(value) if is_number(value) else None}
    if isinstance(interval, list | tuple):
        percent["damping_ratio_ci95"] = [100 * float(end) if is_number(end) else None for end in interval]
    return percent


def _crossings(findings: dict[str, Any], limit: int) -> Table:
    records = sorted(
        findings.get("crossings", []), key=lambda one: (not one.get("excited"), float(one.get("rpm") or 0))
    )
    inside = [_crossing(record, findings, limit) for record in records if record.get("in_range")]
    outside = [_crossing(record, findings, limit) for record in records if not record.get("in_range")]
    heads = "Order#|Natural frequency, Hz#|Speed, rpm#|Amplification measured#|Predicted#|Response|In channels|Evidence"
    more = None
    if outside:
        title = f"{len(outside)} crossing{'s' * (len(outside) > 1)} extrapolated beyond the tested speeds"
        more = table_of(title, heads, outside, empty="")
    note = "Speeds at which an order meets a natural frequency; excited ones first." if inside else ""
    empty = "No order crosses a natural frequency inside the tested speeds."
    return table_of("Crossings", heads, inside, note=note, empty=empty, more=more)


def _crossing(record: dict[str, Any], findings: dict[str, Any], limit: int) -> list[str]:
    response = "excited" if record.get("excited") else "not excited" if record.get("in_range") else "not measured"
    evidence = "; ".join(str(part) for part in (record.get("evidence"), record.get("remark")) if part)
    channels = record.get("channels") or ([record["channel"]] if record.get("channel") else [])
    return [
        order_estimate(record, findings),
        estimate_text(record, "mode_hz"),
        estimate_text(record, "rpm") if "rpm_ci95" in record else _whole(record.get("rpm")),
        _times(record, "amplification") if record.get("in_range") else "–",
        _times(record, "amplification_predicted"),
        named(record.get("verdict") or response, limit=limit),
        named(", ".join(str(name) for name in channels), limit=limit) or "–",
        named(evidence or "–", limit=4 * limit),
    ]


def _times(record: dict[str, Any], key: str) -> str:
    """An amplification as ``"× 12 (10…14)"``; ``"–"`` where there is none."""
    factor = record.get(key)
    if not is_number(factor) or factor <= 0:
        return "–"
    if (least := least_of(record, key)) is not None:
        return f"≥ × {number_text(least, digits=2)}"
    return f"× {estimate_text(record, key) if record.get(f'{key}_ci95') else number_text(float(factor), digits=2)}"


def _lines(findings: dict[str, Any], limit: int) -> Table:
    records = sorted(findings.get("lines", []), key=lambda one: -float(one.get("amplitude") or 0))
    rows = []
    for record in records:
        by_order = is_number(record.get("order"))
        place = (
            f"order {order_estimate(record, findings)}" if by_order else f"{estimate_text(record, 'frequency_hz')} Hz"
        )
        level = estimate_text(record, "amplitude", unit=unit_of(findings, record))
        explained = named(record.get("explained_by") or "unexplained", limit=2 * limit)
        rows.append([named(record.get("channel", ""), limit=limit), place, level, explained])
    ranks = [-float(number) for number in range(len(rows))]
    note = energy_sentence(findings) if rows else ""
    heads = "Channel|Line|Amplitude (peak)#|Explained by"
    return folded("All lines", heads, rows, ranks=ranks, note=note, empty="No line stands above the false-alarm level.")


def _quality(findings: dict[str, Any], limit: int) -> Table:
    rank = {"bad": 0, "suspect": 1}
    records = sorted(findings.get("quality", []), key=lambda one: rank.get(str(one.get("severity")), 2))
    keys = ("recording", "severity", "flag", "detail")
    rows = [
        [named(record.get(key, ""), limit=4 * limit if key == "detail" else limit) for key in keys]
        for record in records
    ]
    return table_of("Quality", "Recording|Severity|Flag|Detail", rows, empty="No remark on any recording.")


def _hertz(record: dict[str, Any], key: str) -> str:
    value = record.get(key)
    if not is_number(value):
        return "–"
    return estimate_text(record, key) if record.get(f"{key}_ci95") else order_text(round(float(value), 1))


def _whole(value: object) -> str:
    return f"{value:.0f}" if is_number(value) else "–"
