"""Speeds at which a test should not dwell, worst first, and the bands of speed between them that are free."""

from __future__ import annotations

from typing import Any

import numpy as np

from crankorder.identify.crossings import amplitude_at, width_rpm
from crankorder.identify.found import AgreedOrder, ModalFit, Mode
from crankorder.settings import IdentifySettings

NOT_JUDGED = ("not measured", "not decided", "undecided mode")
"""Verdicts on a crossing that leave open whether its order is excited there."""


def speeds_to_avoid(
    records: list[dict[str, Any]],
    orders: tuple[AgreedOrder, ...],
    modal: ModalFit,
    *,
    speed_rpm: tuple[float, float],
    settings: IdentifySettings,
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Speeds to avoid, worst first, and the free bands of the tested range, as records of ``findings.json``.

    What a crossing costs is its peak amplitude there (by the fit of the modes where it holds the order, else the
    largest that was measured near), in each channel as a share of the largest amplitude that any order has in that
    channel, root mean square over the channels. It takes its half-power width, ± ζ of the speed, and the interval of
    its speed; crossings whose ranges overlap are one speed to avoid, named after the costliest, their costs added by
    energy. A free band is at least ``crossing_band_rpm`` wide; crossings in it of which it is open whether they are
    excited are named in its ``remark``.

    Parameters
    ----------
    records : those of :func:`crankorder.identify.crossings.crossings`; only excited ones inside the tested range are to
        be avoided
    orders : the orders of the test
    modal : the modes and the responses of the orders
    speed_rpm : slowest and fastest speed of the test, rpm
    settings : ``crossing_band_rpm`` says how near to a tested speed a crossing counts as tested
    """
    largest = _largest(orders)
    met = [_cost(record, orders, modal, largest, settings) for record in records if _counts(record)]
    groups = _overlapping(met)
    avoid = sorted((_joined(group) for group in groups), key=lambda item: (-item["cost"], item["rpm"]))
    ranked = [{"rank": rank} | item for rank, item in enumerate(avoid, start=1)]
    return ranked, _free(ranked, records, speed_rpm, settings)


def _counts(record: dict[str, Any]) -> bool:
    return bool(record["excited"] and record["in_range"])


def _largest(orders: tuple[AgreedOrder, ...]) -> dict[str, float]:
    """Largest amplitude of any order by channel."""
    largest: dict[str, float] = {}
    for agreed in orders:
        for line in agreed.lines:
            largest[line.channel] = max(largest.get(line.channel, 0.0), float(line.amplitude.max()))
    return largest


def _cost(
    record: dict[str, Any],
    orders: tuple[AgreedOrder, ...],
    modal: ModalFit,
    largest: dict[str, float],
    settings: IdentifySettings,
) -> dict[str, Any]:
    """Range, amplitude and cost of one excited crossing."""
    mode = min(modal.modes, key=lambda item: abs(item.frequency_hz - record["mode_hz"]))
    agreed = min(orders, key=lambda item: abs(item.order - record["order"]))
    peaks = _peaks(record, agreed, modal, mode, settings)
    shares = {channel: peak / largest[channel] for channel, peak in peaks.items() if largest[channel] > 0.0}
    channel = max(shares, key=lambda name: shares[name], default=agreed.lines[0].channel)
    half = mode.damping_ratio * record["rpm"]
    factor = record["amplification"]
    return {
        "rpm": record["rpm"],
        "rpm_range": [record["rpm_ci95"][0] - half, record["rpm_ci95"][1] + half],
        "order": record["order"],
        "mode_hz": record["mode_hz"],
        "channel": channel,
        "amplitude": peaks.get(channel, 0.0),
        "amplification": record["amplification_predicted"] if factor is None else factor,
        "cost": float(np.sqrt(sum(share**2 for share in shares.values()) / max(1, len(largest)))),
    }


def _peaks(
    record: dict[str, Any], agreed: AgreedOrder, modal: ModalFit, mode: Mode, settings: IdentifySettings
) -> dict[str, float]:
    """Peak amplitude by channel at the crossing ``record``."""
    fitted = {
        item.channel: amplitude_at(item, record["rpm"], modal)
        for item in modal.responses
        if item.fits and abs(item.order - agreed.order) < 1e-3
    }
    near = width_rpm(record, mode, settings)
    peaks = {}
    for line in agreed.lines:
        here = np.abs(line.speed_rpm - record["rpm"]) <= near
        if line.channel in fitted:
            peaks[line.channel] = fitted[line.channel]
        elif here.any():
            peaks[line.channel] = float(line.amplitude[here].max())
    return peaks


def _overlapping(met: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Crossings in groups whose speed ranges overlap, by speed."""
    groups: list[list[dict[str, Any]]] = []
    for item in sorted(met, key=lambda item: item["rpm_range"][0]):
        if groups and item["rpm_range"][0] <= max(other["rpm_range"][1] for other in groups[-1]):
            groups[-1].append(item)
        else:
            groups.append([item])
    return groups


def _joined(group: list[dict[str, Any]]) -> dict[str, Any]:
    """One speed to avoid from crossings whose ranges overlap, named after the costliest."""
    by_cost = sorted(group, key=lambda item: -item["cost"])
    pairs = [f"order {item['order']:.4g} meets {item['mode_hz']:.4g} Hz" for item in by_cost]
    return by_cost[0] | {
        "rpm_range": [min(item["rpm_range"][0] for item in group), max(item["rpm_range"][1] for item in group)],
        "cost": float(np.sqrt(sum(item["cost"] ** 2 for item in group))),
        "orders": [item["order"] for item in by_cost],
        "modes_hz": [item["mode_hz"] for item in by_cost],
        "reason": " and ".join(pairs),
    }


def _free(
    avoid: list[dict[str, Any]],
    records: list[dict[str, Any]],
    speed_rpm: tuple[float, float],
    settings: IdentifySettings,
) -> list[dict[str, Any]]:
    """Bands of the tested range that no speed to avoid touches, by speed."""
    low, high = speed_rpm
    if not (np.isfinite(low) and np.isfinite(high)):
        return []
    bands, start = [], low
    for begin, end in [*sorted(item["rpm_range"] for item in avoid), [high, high]]:
        if min(begin, high) - start >= settings.crossing_band_rpm:
            bands.append((start, min(begin, high)))
        start = max(start, end)
    return [{"low_rpm": a, "high_rpm": b, "remark": _remark(a, b, records)} for a, b in bands]


def _remark(low: float, high: float, records: list[dict[str, Any]]) -> str:
    """Which crossings between ``low`` and ``high`` rpm nobody has judged; "" where all have been."""
    unknown = [
        f"order {item['order']:.4g} with {item['mode_hz']:.4g} Hz at {item['rpm']:.4g} rpm"
        for item in records
        if item["in_range"] and low <= item["rpm"] <= high and item["verdict"] in NOT_JUDGED
    ]
    return f"not judged: {'; '.join(unknown)}" if unknown else ""
