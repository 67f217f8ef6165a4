"""The tables of the report page: findings as rows of text, every estimate with its 95 % interval."""

from __future__ import annotations

from typing import Any, TypedDict

from crankorder.report.notation import estimate_text, is_number, named, number_text, order_text, unit_of
from crankorder.report.sentences import NOT_ASKED_FOR

_LINES = 60  # rows of a table that a page shows at once; the files hold all
_PROVENANCE_ROWS = 400
_BALANCE = {
    "residual_reciprocating_g": ("Unbalanced reciprocating mass", "g"),
    "residual_rotating_gmm": ("Rotating unbalance", "g·mm"),
    "angle_deg": ("Angle of the rotating unbalance", "°"),
}


class Column(TypedDict):
    """Head of a column and whether it holds numbers."""

    title: str
    number: bool


class Table(TypedDict):
    """One table of the page; ``more`` is folded away under it."""

    title: str
    note: str
    empty: str
    columns: list[Column]
    rows: list[list[str]]
    more: Table | None


NO_BEARING = (
    "No bearing was named in the manifest, or none of its lines was seen. Strikes that ring above the "
    "frequencies analysed are not looked for."
)


def _table(
    title: str, heads: str, rows: list[list[str]], *, empty: str, note: str = "", more: Table | None = None
) -> Table:
    """Table with ``heads`` separated by ``|``; a head that ends in ``#`` is a column of numbers."""
    columns = [
        Column(title=head.strip().removesuffix("#"), number=head.strip().endswith("#")) for head in heads.split("|")
    ]
    if len(rows) > _LINES:
        note = f"{note} The first {_LINES} of {len(rows)}; findings.json holds all.".strip()
    return Table(title=title, note=note, empty=empty, columns=columns, rows=rows[:_LINES], more=more)


def tables_of(findings: dict[str, Any], *, limit: int) -> list[tuple[str, Table]]:
    """Anchor and table of every list in ``findings``; texts from files are cut at ``limit`` characters.

    Of findings that were not asked for only the remarks on the recordings: an empty list of orders would deny them.
    """
    if NOT_ASKED_FOR in findings:
        return [("quality", _quality(findings, limit))]
    return [
        ("orders", _orders(findings, limit)),
        ("modes", _modes(findings, limit)),
        ("crossings", _crossings(findings)),
        ("bearings", _bearings(findings, limit)),
        ("balance", _balance(findings, limit)),
        ("lines", _lines(findings, limit)),
        ("quality", _quality(findings, limit)),
    ]


def _orders(findings: dict[str, Any], limit: int) -> Table:
    rows = []
    note = (
        "Speed exponent: 2 grows as the force of an unbalanced mass, 0 keeps its size."
        if findings.get("orders")
        else ""
    )
    for record in sorted(findings.get("orders", []), key=lambda one: (str(one.get("channel")), float(one["order"]))):
        span = record.get("speed_range_rpm") or []
        rows.append(
            [
                named(record.get("channel", ""), limit=limit),
                _order(record, "order"),
                estimate_text(record, "amplitude", unit=unit_of(findings, record)),
                _whole(record.get("speed_rpm_at_max")),
                estimate_text(record, "phase_deg"),
                estimate_text(record, "speed_exponent"),
                "–".join(_whole(end) for end in span),
                named(record.get("explained_by") or "", limit=2 * limit),
            ]
        )
    heads = "Channel|Order#|Largest amplitude (peak)#|At, rpm#|Phase there, °#|Speed exponent#|Seen, rpm#|Explained by"
    return _table("Orders", heads, rows, note=note, empty="No order stands above the noise.")


def _modes(findings: dict[str, Any], limit: int) -> Table:
    rows = [
        [
            estimate_text(record, "frequency_hz"),
            estimate_text(_in_percent(record), "damping_ratio"),
            named(", ".join(str(name) for name in record.get("channels") or []), limit=limit),
            named(record.get("explained_by") or "", limit=limit),
            named(record.get("evidence") or "", limit=4 * limit),
        ]
        for record in findings.get("modes", [])
    ]
    heads = "Frequency, Hz#|Damping, %#|Channels|Explained by|Evidence"
    return _table("Natural frequencies", heads, rows, empty="No natural frequency was found.")


def _in_percent(record: dict[str, Any]) -> dict[str, Any]:
    value, interval = record.get("damping_ratio"), record.get("damping_ratio_ci95")
    percent: dict[str, Any] = {"damping_ratio": 100 * float(value) if is_number(value) else None}
    if isinstance(interval, list | tuple):
        percent["damping_ratio_ci95"] = [100 * float(end) if is_number(end) else None for end in interval]
    return percent


def _crossings(findings: dict[str, Any]) -> Table:
    records = sorted(
        findings.get("crossings", []), key=lambda one: (not one.get("excited"), float(one.get("rpm") or 0))
    )
    inside = [record for record in records if record.get("in_range")]
    outside = [record for record in records if not record.get("in_range")]
    heads = "Order#|Natural frequency, Hz#|Speed, rpm#|Amplification#|Response"
    more = None
    if outside:
        title = f"{len(outside)} crossing{'s' * (len(outside) > 1)} outside the tested speeds"
        more = _table(title, heads, [_crossing(record) for record in outside], empty="")
    note = "Speeds at which an order meets a natural frequency; excited ones first." if inside else ""
    empty = "No order crosses a natural frequency inside the tested speeds."
    return _table("Crossings", heads, [_crossing(record) for record in inside], note=note, empty=empty, more=more)


def _crossing(record: dict[str, Any]) -> list[str]:
    response = "excited" if record.get("excited") else "not excited" if record.get("in_range") else "not measured"
    speed = estimate_text(record, "rpm") if "rpm_ci95" in record else _whole(record.get("rpm"))
    factor = record.get("amplification")
    measured = record.get("in_range") and is_number(factor) and float(factor or 0.0) > 0.0
    times = f"× {number_text(float(factor or 0.0), digits=2)}" if measured else "–"
    return [_order(record, "order"), estimate_text(record, "mode_hz"), speed, times, response]


def _bearings(findings: dict[str, Any], limit: int) -> Table:
    rows = [
        [
            named(record.get("name") or "", limit=limit),
            named(record.get("line") or "", limit=limit),
            _order(record, "order"),
            _order(record, "order_expected"),
            estimate_text(record, "amplitude", unit=unit_of(findings, record)),
            named(record.get("verdict") or "", limit=4 * limit),
        ]
        for record in findings.get("bearings", [])
    ]
    heads = "Bearing|Line|Order found#|Order expected#|Amplitude (peak)#|Verdict"
    return _table("Bearings", heads, rows, empty=NO_BEARING)


def _balance(findings: dict[str, Any], limit: int) -> Table:
    balance = findings.get("balance")
    rows = []
    reason = findings.get("balance_reason")
    if isinstance(balance, dict):
        reason = reason or balance.get("reason")
        for key, value in balance.items():
            if key.endswith("_ci95") or not is_number(value):
                continue
            title, unit = _BALANCE.get(key, (key.replace("_", " "), ""))
            rows.append([named(title, limit=limit), estimate_text(balance, key, unit=unit)])
    why = f" The reason: {named(reason, limit=4 * limit)}" if reason else ""
    return _table("Balance", "Quantity|Value#", rows, empty=f"No residual unbalance was worked out.{why}")


def _lines(findings: dict[str, Any], limit: int) -> Table:
    records = sorted(findings.get("lines", []), key=lambda one: -float(one.get("amplitude") or 0))
    rows = []
    for record in records:
        by_order = is_number(record.get("order"))
        place = f"order {_order(record, 'order')}" if by_order else f"{estimate_text(record, 'frequency_hz')} Hz"
        level = estimate_text(record, "amplitude", unit=unit_of(findings, record))
        explained = named(record.get("explained_by") or "unexplained", limit=2 * limit)
        rows.append([named(record.get("channel", ""), limit=limit), place, level, explained])
    fraction = findings.get("unexplained_energy_fraction")
    note = ""
    if is_number(fraction):
        note = (
            f"Share of the energy of the lines that nothing explains: {number_text(100 * float(fraction), digits=2)} %."
        )
    heads = "Channel|Line|Amplitude (peak)#|Explained by"
    return _table("All lines", heads, rows, note=note, empty="No line stands above the false-alarm level.")


def _quality(findings: dict[str, Any], limit: int) -> Table:
    rank = {"bad": 0, "suspect": 1}
    records = sorted(findings.get("quality", []), key=lambda one: rank.get(str(one.get("severity")), 2))
    keys = ("recording", "severity", "flag", "detail")
    rows = [
        [named(record.get(key, ""), limit=4 * limit if key == "detail" else limit) for key in keys]
        for record in records
    ]
    return _table("Quality", "Recording|Severity|Flag|Detail", rows, empty="No remark on any recording.")


def provenance_table(provenance: dict[str, Any]) -> Table:
    """Inputs, versions and settings of ``provenance`` (as in ``data_schema/run.json``), one row per value, folded."""
    rows = [[named(key, limit=120), named(value, limit=200)] for key, value in _flat("", provenance)][:_PROVENANCE_ROWS]
    everything = Table(
        title="Inputs with hashes, versions and settings",
        note="",
        empty="Nothing was recorded.",
        columns=[Column(title="Key", number=False), Column(title="Value", number=False)],
        rows=rows,
        more=None,
    )
    versions = provenance.get("versions") if isinstance(provenance.get("versions"), dict) else {}
    short = [[named(key, limit=60), named(value, limit=60)] for key, value in (versions or {}).items()]
    return _table("Provenance", "Program|Version", short, empty="No versions were recorded.", more=everything)


def _flat(prefix: str, value: object) -> list[tuple[str, object]]:
    if isinstance(value, dict):
        return [pair for key, item in value.items() for pair in _flat(f"{prefix}.{key}" if prefix else str(key), item)]
    if isinstance(value, list | tuple) and any(isinstance(item, dict | list | tuple) for item in value):
        return [pair for number, item in enumerate(value, start=1) for pair in _flat(f"{prefix} {number}", item)]
    return [(prefix, ", ".join(str(item) for item in value) if isinstance(value, list | tuple) else value)]


def _order(record: dict[str, Any], key: str) -> str:
    value = record.get(key)
    if not is_number(value):
        return "–"
    return estimate_text(record, key) if f"{key}_ci95" in record else order_text(float(value))


def _whole(value: object) -> str:
    return f"{value:.0f}" if is_number(value) else "–"
