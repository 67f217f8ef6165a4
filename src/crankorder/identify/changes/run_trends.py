"""Lines that grow from run to run of the same test: the re-run rule for order lines and bearing lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.findings import Findings
from crankorder.identify.bearings.trend import run_amplitudes, trend
from crankorder.identify.changes.order_changes import like_speeds, line_of
from crankorder.identify.false_discovery import claimed
from crankorder.identify.intervals import error_of, half_width, positive_interval
from crankorder.records import known
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-changes.toml", table="run_trends"):
    least_runs: int


NUMBERS = _Numbers.load()


@dataclass(frozen=True, eq=False)
class Series:
    """Amplitudes of one line over the runs, with standard errors of ``freedom``; NaN where a run does not show it."""

    line: str
    kind: str
    channel: str
    order: float
    amplitude: NDArray[np.float64]
    error: NDArray[np.float64]
    freedom: float = np.inf


def run_trends(
    order_maps: Sequence[xr.Dataset],
    findings: Sequence[Findings],
    envelopes: Sequence[xr.Dataset | None],
    orders: Sequence[tuple[float, bool]],
    channels: Sequence[str],
    *,
    within_rpm: float,
    q: float,
) -> list[dict[str, Any]]:
    """Records of how each line grows from run to run; of two runs the bearing lines alone.

    Parameters
    ----------
    order_maps : OrderMaps of the runs, in time order; empty where not all have one
    findings : findings of the runs, whose bearing lines are followed
    envelopes : EnvelopeMaps of the runs, None where one has none
    orders : orders with whether they are locked
    channels : names that all runs have in the same unit
    within_rpm : largest difference of speeds that are compared, min-1
    q : false-discovery rate over all lines, 0 to 1
    """
    series = _bearing_series(findings, envelopes, channels)
    if len(order_maps) >= NUMBERS.least_runs:
        series = [*_order_series(order_maps, orders, channels, within_rpm), *series]
    records = [
        _record(one)
        for one in series
        if len(one.amplitude) == len(findings) and np.all(one.amplitude > 0) and np.all(one.error >= 0)
    ]
    p_values = np.array([record["p_value"] for record in records], dtype=np.float64)
    for record, says in zip(records, claimed(p_values, q=q), strict=True):
        record["changed"] = bool(says)
    return records


def _record(one: Series) -> dict[str, Any]:
    found = trend(one.amplitude, one.error, freedom=one.freedom)
    return {
        "line": one.line,
        "kind": one.kind,
        "channel": one.channel,
        "order": one.order,
        "amplitude": one.amplitude.tolist(),
        "amplitude_ci95": [
            positive_interval(float(a), half_width(one.freedom) * float(e))
            for a, e in zip(one.amplitude, one.error, strict=True)
        ],
        "growth_per_run": float(found.growth_per_run),
        "growth_per_run_ci95": [float(end) for end in found.growth_ci95],
        "p_value": min(1.0, 2.0 * min(found.p_value, 1.0 - found.p_value)),
        "verdict": found.verdict if one.kind != "order" else found.verdict.split(":")[0],
        "changed": False,
    }


def _together(maps: Sequence[xr.Dataset], within_rpm: float) -> list[NDArray[np.int64]]:
    """Positions, in each run, of the speeds that all runs have."""
    first = maps[0]["speed"].values
    kept = np.arange(len(first))
    matches = []
    for item in maps[1:]:
        one, two = like_speeds(first, item["speed"].values, within_rpm=within_rpm)
        matches.append(dict(zip(one.tolist(), two.tolist(), strict=True)))
        kept = kept[np.isin(kept, one)]
    return [kept, *(np.array([match[k] for k in kept.tolist()], dtype=np.int64) for match in matches)]


def _geometric(amplitude: NDArray[np.float64], error: NDArray[np.float64]) -> tuple[float, float]:
    """Geometric mean over speeds and its standard error; NaN where an amplitude is not positive."""
    if not len(amplitude) or not np.all(amplitude > 0):
        return np.nan, np.nan
    mean = float(np.exp(np.mean(np.log(amplitude))))
    return mean, mean * float(np.sqrt(np.sum((error / amplitude) ** 2))) / len(amplitude)


def _order_series(
    maps: Sequence[xr.Dataset], orders: Sequence[tuple[float, bool]], channels: Sequence[str], within_rpm: float
) -> list[Series]:
    at = _together(maps, within_rpm)
    made = []
    for channel in channels if len(at[0]) else ():
        for order, locked in orders:
            lines = [line_of(m, channel, order, k, locked=locked, phases=False) for m, k in zip(maps, at, strict=True)]
            clear = np.all([line.amplitude > 2.0 * line.error for line in lines], axis=0)
            means = [_geometric(line.size[clear], line.error[clear]) for line in lines]
            values, errors = (np.array(column) for column in zip(*means, strict=True))
            freedom = float(np.sum([line.freedom[clear].sum() for line in lines]) / len(lines))
            made.append(Series(f"order {order:g}", "order", channel, order, values, errors, max(freedom, 1.0)))
    return made


def _bearing_series(
    findings: Sequence[Findings],
    envelopes: Sequence[xr.Dataset | None],
    channels: Sequence[str],
) -> list[Series]:
    """Bearing lines that any run names: from the envelope maps where all runs have one, else from the findings."""
    lines: dict[tuple[str, str, str, str], float] = {}
    for found in findings:
        for record in found.bearings:
            if record.channel is not None and record.channel in channels:
                key = record.name, record.line, record.seen_in or "vibration", record.channel
                lines.setdefault(key, record.order)
    maps = [one for one in envelopes if one is not None]
    made, followed = [], set()
    for (name, line, seen_in, channel), order in lines.items():
        if seen_in != "envelope":
            means = [_recorded(found, (name, line, seen_in, channel)) for found in findings]
            values, errors = (np.array(column) for column in zip(*means, strict=True))
            made.append(Series(f"{name} {line}", "bearing", channel, order, values, errors))
        elif len(maps) == len(findings) and (name, line) not in followed:
            followed.add((name, line))
            made.append(Series(f"{name} {line}", "bearing, envelope", "", order, *run_amplitudes(maps, order=order)))
    return made


def _recorded(found: Findings, key: tuple[str, str, str, str]) -> tuple[float, float]:
    for record in found.bearings:
        ends = known(record.amplitude_ci95)
        if (record.name, record.line, record.seen_in or "vibration", record.channel) == key and ends is not None:
            return record.size, error_of(record.size, ends)
    return np.nan, np.nan
