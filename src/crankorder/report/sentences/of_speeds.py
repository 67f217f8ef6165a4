"""What is said of speeds: which to avoid, and which bands are free of excited crossings."""

from __future__ import annotations

from typing import Any

from crankorder.report.notation import (
    NAME_CHARACTERS,
    frequency_text,
    is_number,
    listed,
    named,
    nominal_order,
    number_text,
    order_name,
    unit_of,
)

_TOGETHER_RPM = 30.0  # crossings closer than this share one sentence
_JUDGED = ("excited", "not excited", None)
_PAIRS = 4  # crossings that a sentence names
_SHOWN = 3  # free bands that a sentence names, the widest


def avoid_sentences(findings: dict[str, Any]) -> list[str]:
    """Speeds to avoid: one sentence per group of excited crossings of ``findings`` inside the tested range.

    In the order of their rank where the findings rank them (``speeds_to_avoid``), else those with most crossings first.
    """
    sentences = []
    for group in speeds_together(findings):
        rpm = sum(float(record["rpm"]) for record in group) / len(group)
        ranges = [record["rpm_range"] for record in group if is_range(record.get("rpm_range"))]
        span = f" ({min(low for low, _ in ranges):.0f} to {max(high for _, high in ranges):.0f} rpm)" if ranges else ""
        pairs = [
            f"order {order_name({'order': order}, findings)} excites the {frequency_text(mode_hz)} Hz natural frequency"
            for order, mode_hz in dict.fromkeys(pair for record in group for pair in meetings(record))
        ]
        said = listed(pairs[:_PAIRS]) + (f", and {len(pairs) - _PAIRS} more meet" if len(pairs) > _PAIRS else "")
        text = f"Avoid steady running near {rpm:.0f} rpm{span}, where {said}"
        sentences.append(f"{text}{_peak(findings, group[0])}.")
    return sentences


def meetings(record: dict[str, Any]) -> list[tuple[float, float]]:
    """Nominal order and natural frequency [Hz] of every crossing that a ``record`` of a speed to avoid stands for."""
    orders, modes = record.get("orders"), record.get("modes_hz")
    if not isinstance(orders, list | tuple) or not isinstance(modes, list | tuple) or len(orders) != len(modes):
        return [(nominal_order(record), float(record["mode_hz"]))]
    return [
        (nominal_order(float(order)), float(mode_hz))
        for order, mode_hz in zip(orders, modes, strict=True)
        if is_number(order) and is_number(mode_hz)
    ]


def speeds_together(findings: dict[str, Any]) -> list[list[dict[str, Any]]]:
    """Records of the speeds to avoid of ``findings``, those next to one another in one group, the worst first."""
    ranked = findings.get("speeds_to_avoid")
    wanted = [
        record
        for record in (findings.get("crossings", []) if ranked is None else ranked)
        if is_number(record.get("rpm")) and is_number(record.get("order")) and is_number(record.get("mode_hz"))
    ]
    if ranked is None:
        wanted = [record for record in wanted if record.get("excited") and record.get("in_range")]
        wanted.sort(key=lambda record: float(record["rpm"]))
    groups: list[list[dict[str, Any]]] = []
    for record in wanted:
        home = next((group for group in groups if abs(record["rpm"] - group[0]["rpm"]) <= _TOGETHER_RPM), None)
        if home is None:
            groups.append([record])
        else:
            home.append(record)
    return groups if ranked is not None else sorted(groups, key=lambda group: (-len(group), float(group[0]["rpm"])))


def is_range(value: object) -> bool:
    """True where ``value`` is a pair of numbers: low and high end."""
    return isinstance(value, list | tuple) and len(value) == 2 and all(is_number(end) for end in value)


def _peak(findings: dict[str, Any], record: dict[str, Any]) -> str:
    """How bad it is there, in the findings' own numbers."""
    said = []
    if is_number(record.get("amplitude")):
        where = f" in {named(record['channel'], limit=NAME_CHARACTERS)}" if record.get("channel") else ""
        level = f"{number_text(float(record['amplitude']))} {unit_of(findings, record)}".strip()
        said.append(f"peak {level}{where}")
    if is_number(record.get("amplification")) and record["amplification"] > 0 and "amplitude" in record:
        said.append(f"amplified {number_text(float(record['amplification']), digits=2)} times")
    return f" ({', '.join(said)})" if said else ""


def free_bands(findings: dict[str, Any]) -> list[tuple[float, float]]:
    """Speed ranges [rpm] of ``findings`` that no excited crossing touches, slowest first."""
    bands = [
        (float(band["low_rpm"]), float(band["high_rpm"]))
        for band in findings.get("free_bands") or []
        if is_number(band.get("low_rpm")) and is_number(band.get("high_rpm")) and band["high_rpm"] > band["low_rpm"]
    ]
    return sorted(bands)


def _open(findings: dict[str, Any]) -> bool:
    """True where a free band holds crossings that were not judged, or with what may be no natural frequency."""
    if any(band.get("remark") for band in findings.get("free_bands") or []):
        return True
    return any(low <= rpm <= high for low, high in free_bands(findings) for rpm in not_judged_rpm(findings))


def not_judged_rpm(findings: dict[str, Any]) -> list[float]:
    """Speeds [rpm] of the crossings of ``findings`` inside the tested range of which nothing could be decided."""
    return [
        float(record["rpm"])
        for record in findings.get("crossings", [])
        if record.get("in_range") and record.get("verdict", "excited") not in _JUDGED and is_number(record.get("rpm"))
    ]


def free_sentences(findings: dict[str, Any]) -> list[str]:
    """Where ``findings`` allow steady running, the widest bands; that all of the range is free, where it is."""
    bands = free_bands(findings)
    if not bands:
        return []
    if not findings.get("speeds_to_avoid") and len(bands) == 1:
        low, high = bands[0]
        but = "; some crossings could not be judged, see the table of crossings" if _open(findings) else ""
        return [f"No order was seen to excite a natural frequency between {low:.0f} and {high:.0f} rpm{but}."]
    widest = sorted(sorted(bands, key=lambda band: band[0] - band[1])[:_SHOWN])
    more = " and narrower bands" if len(bands) > _SHOWN else ""
    if _open(findings):
        more += "; some crossings there could not be judged, see the table of crossings"
    return [f"Free of excited crossings: {listed([f'{low:.0f} to {high:.0f}' for low, high in widest])} rpm{more}."]
