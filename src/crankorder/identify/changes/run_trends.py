"""Lines that grow from run to run of the same test: the re-run rule for order and bearing lines, as a test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import stdtr

from crankorder.comparison import LineKind, Trend
from crankorder.identify.bearings.envelope_lines import Spectra, spectra_of
from crankorder.identify.changes.order_changes import Tested, like_speeds, line_of, order_maps
from crankorder.identify.intervals import error_of, half_width, known_freedom, positive_interval
from crankorder.quantities import Floats, Ints
from crankorder.records import Ends, known
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-changes.toml", "run_trends")
TREND_NUMBERS = MethodNumbers("5-identify-bearings.toml", "trend")


class RunAmplitudes(NamedTuple):
    """Amplitudes (runs,) of one line in repeated runs, their standard errors and the degrees of freedom of these.

    They are NaN where a run does not show the line.
    """

    amplitudes: Floats
    errors: Floats
    freedom: float = math.inf


class Growth(NamedTuple):
    """Share by which an amplitude grows per run, its 95 % interval, and the chance of such growth where there is none.

    The chance is one-sided: near 1 for an amplitude that falls.
    """

    per_run: float
    ci95: Ends
    p_value: float


def run_trends(
    tests: Sequence[Tested], orders: Sequence[tuple[float, bool]], channels: Sequence[str], *, within_rpm: float
) -> list[Trend]:
    """How each line grows from run to run, no claim made yet; of two runs the bearing lines alone.

    Parameters
    ----------
    tests : the runs, in time order; orders are followed where all have an OrderMap
    orders : orders with whether they are locked
    channels : names that all runs have in the same unit
    within_rpm : largest difference of speeds that are compared, min-1
    """
    maps = order_maps(tests) if len(tests) >= NUMBERS.least_runs else []
    trends = [*(_order_trends(maps, orders, channels, within_rpm) if maps else ()), *_bearing_trends(tests, channels)]
    return [trend for trend in trends if trend]


def _trend(line: str, kind: LineKind, channel: str, order: float, runs: RunAmplitudes) -> Trend | None:
    """Trend of a line over the ``runs``; None where one of them does not show it."""
    sizes, errors, freedom = runs
    if not (len(sizes) and np.all(sizes > 0) and np.all(errors >= 0)):
        return None
    growth, half = growth_over(runs), half_width(freedom)
    return Trend(
        line=line, kind=kind, channel=channel, order=order, amplitude=tuple(sizes.tolist()),
        amplitude_ci95=tuple(positive_interval(float(a), half * float(e)) for a, e in zip(sizes, errors, strict=True)),
        growth_per_run=growth.per_run, growth_per_run_ci95=growth.ci95,
        p_value=min(1.0, 2.0 * min(growth.p_value, 1.0 - growth.p_value)),
    )  # fmt: skip


def _together(maps: Sequence[xr.Dataset], within_rpm: float) -> list[Ints]:
    """Positions, in each run, of the speeds that all runs have."""
    first = maps[0]["speed"].values
    kept = np.arange(len(first))
    matches = []
    for order_map in maps[1:]:
        at, to = like_speeds(first, order_map["speed"].values, within_rpm=within_rpm)
        matches.append(dict(zip(at.tolist(), to.tolist(), strict=True)))
        kept = kept[np.isin(kept, at)]
    return [kept, *(np.array([match[k] for k in kept.tolist()], dtype=np.int64) for match in matches)]


def _geometric(amplitude: Floats, error: Floats) -> tuple[float, float]:
    """Geometric mean over speeds and its standard error; NaN where an amplitude is not positive."""
    if not len(amplitude) or not np.all(amplitude > 0):
        return np.nan, np.nan
    mean = float(np.exp(np.mean(np.log(amplitude))))
    return mean, mean * float(np.sqrt(np.sum((error / amplitude) ** 2))) / len(amplitude)


def _order_trends(
    maps: Sequence[xr.Dataset], orders: Sequence[tuple[float, bool]], channels: Sequence[str], within_rpm: float
) -> list[Trend | None]:
    at = _together(maps, within_rpm)
    trends = []
    for channel in channels if len(at[0]) else ():
        for order, locked in orders:
            lines = [line_of(m, channel, order, k, locked=locked, phases=False) for m, k in zip(maps, at, strict=True)]
            clear = np.all([line.amplitude > 2.0 * line.error for line in lines], axis=0)
            means = np.array([_geometric(line.size[clear], line.error[clear]) for line in lines]).T
            freedom = float(np.sum([line.freedom[clear].sum() for line in lines]) / len(lines))
            runs = RunAmplitudes(means[0], means[1], max(freedom, 1.0))
            trends.append(_trend(f"order {order:g}", "order", channel, order, runs))
    return trends


_LineKey = tuple[str, str, str, str]
"""Name of the bearing, line, where it is seen, channel."""


def _bearing_trends(tests: Sequence[Tested], channels: Sequence[str]) -> list[Trend | None]:
    """Bearing lines that any run names: from the envelope maps where all runs have one, else from the findings."""
    lines: dict[_LineKey, float] = {}
    recorded: list[dict[_LineKey, tuple[float, float]]] = []
    for test in tests:
        recorded.append({})
        for record in test.findings.bearings:
            if record.channel is not None and record.channel in channels:
                key: _LineKey = record.name, record.line, record.seen_in or "vibration", record.channel
                lines.setdefault(key, record.order)
                if ends := known(record.amplitude_ci95):
                    recorded[-1].setdefault(key, (record.size, error_of(record.size, ends)))
    maps = [test.maps["envelope_map"] for test in tests if "envelope_map" in test.maps]
    trends, followed = [], set()
    for key, order in lines.items():
        name, line, seen_in, channel = key
        if seen_in != "envelope":
            columns = np.array([sizes.get(key, (np.nan, np.nan)) for sizes in recorded]).T
            trends.append(_trend(f"{name} {line}", "bearing", channel, order, RunAmplitudes(columns[0], columns[1])))
        elif len(maps) == len(tests) and (name, line) not in followed:
            followed.add((name, line))
            runs = run_amplitudes(maps, order=order)
            trends.append(_trend(f"{name} {line}", "bearing, envelope", "", order, runs))
    return trends


def growth_over(runs: RunAmplitudes) -> Growth:
    """Growth of the amplitudes over the ``runs`` of one test, two or more, by their errors; amplitudes are above 0.

    A straight line through the logarithms, weighted by their errors; from three runs on these are widened where the
    runs scatter more than they say, and the interval is Student's.
    Source: MSU thesis: re-run the same test, growth means failing.
    """
    sizes, errors = (np.asarray(values, dtype=np.float64) for values in (runs.amplitudes, runs.errors))
    logs, run = np.log(sizes), np.arange(len(sizes), dtype=np.float64)
    weight = np.maximum(errors / sizes, 1e-9) ** -2.0
    beside = run - (weight * run).sum() / weight.sum()
    variance = 1.0 / float((weight * beside**2).sum())
    slope, freedom = float((weight * beside * logs).sum()) * variance, runs.freedom
    if len(run) > 2:
        rest = logs - (weight * logs).sum() / weight.sum() - slope * beside
        scatter = float((weight * rest**2).sum()) / (len(run) - 2)
        if scatter > 1.0:
            variance, freedom = variance * scatter, len(run) - 2.0
    error = math.sqrt(variance)
    half = error * half_width(freedom, level=1.0 - TREND_NUMBERS.no_change_chance)
    growth, low, high = (math.expm1(min(value, 700.0)) for value in (slope, slope - half, slope + half))
    return Growth(growth, (low, high), float(stdtr(known_freedom(freedom), -slope / error)))


def run_amplitudes(envelopes: Sequence[xr.Dataset], *, order: float) -> RunAmplitudes:
    """Amplitudes of the line at ``order`` in the EnvelopeMaps of repeated runs, as shares of their mean.

    They are taken over all channels and speeds that all ``envelopes`` hold and in which the line stands clear in at
    least one run; none where there is no such. The amplitude of a run without the line is that of half its noise.
    Errors are those of the noise, widened where speeds disagree on how the runs compare, for strikes vary by
    themselves, and where the bands of demodulation differ from run to run.
    """
    none = RunAmplitudes(np.zeros(0), np.zeros(0))
    spectra = [spectra_of(envelope) for envelope in envelopes if envelope.sizes["order"] > 1]
    if len(spectra) < len(envelopes) or not spectra or any(s.count.shape != spectra[0].count.shape for s in spectra):
        return none
    ratio, power, count = (np.array(values) for values in zip(*(_at(of_run, order) for of_run in spectra), strict=True))
    clear = ratio.max(axis=0) >= TREND_NUMBERS.least_ratio
    if not clear.any():
        return none
    low, high = (np.array([envelope[end].values for envelope in envelopes]) for end in ("band_low", "band_high"))
    other = (np.abs(low - low[0]) > 0.02 * high) | (np.abs(high - high[0]) > 0.02 * high)
    own = np.maximum(ratio - 1.0, 0.5)
    logs = 0.25 * np.log(power / ratio * own)
    variance = (2.0 * ratio + 1.0) / (np.maximum(count, 1.0) * (4.0 * own) ** 2)
    variance += TREND_NUMBERS.band_change_share**2 * other
    # cells differ in level: each is taken beside its own mean over the runs
    beside = logs - logs.mean(axis=0)
    weight = np.where(clear, 1.0 / variance.mean(axis=0), 0.0)
    mean = (beside * weight).sum(axis=(1, 2)) / weight.sum()
    error = np.sqrt((variance * weight**2).sum(axis=(1, 2))) / weight.sum()
    spread, freedom = _disagreement(beside, weight, mean)
    widened = error * math.sqrt(max(spread, 1.0))
    return RunAmplitudes(np.exp(mean), np.exp(mean) * widened, freedom if spread > 1.0 else math.inf)


def _disagreement(beside: Floats, weight: Floats, mean: Floats) -> tuple[float, float]:
    """By how much more than their noise the speeds disagree on the runs (ratio of variances), and degrees of freedom.

    ``beside`` (run, channel, speed) are logarithms beside their means over the runs, ``mean`` (runs,) those over the
    rest; channels of one speed see the same strikes and count as one.
    """
    of_speed = weight.sum(axis=0)
    seen = of_speed > 0.0
    freedom = (int(seen.sum()) - 1) * (len(mean) - 1)
    if freedom < 1:
        return 1.0, math.inf
    by_speed = (beside * weight).sum(axis=1)[:, seen] / of_speed[seen]
    return float((of_speed[seen] * (by_speed - mean[:, None]) ** 2).sum()) / freedom, float(freedom)


def _at(spectra: Spectra, order: float) -> tuple[Floats, Floats, Floats]:
    """Power ratio, power of the line near ``order`` and independent spectra, each (channel, speed)."""
    near = spectra.near(order)
    at = spectra.ratio[:, :, near].argmax(axis=2)[:, :, None]
    ratio = np.take_along_axis(spectra.ratio[:, :, near], at, axis=2)[:, :, 0]
    power = np.take_along_axis(spectra.amplitude[:, :, near], at, axis=2)[:, :, 0] ** 4
    return np.maximum(ratio, 1e-9), np.maximum(np.nan_to_num(power), 1e-300), spectra.count
