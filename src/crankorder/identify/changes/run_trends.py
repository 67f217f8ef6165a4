"""Lines that grow from run to run of the same test: the re-run rule for order and bearing lines, as a test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.special import stdtr

from crankorder.errors import RequestError
from crankorder.findings import Findings
from crankorder.identify.bearings.envelope_lines import Spectra, spectra_of
from crankorder.identify.changes.order_changes import like_speeds, line_of
from crankorder.identify.intervals import claimed, error_of, half_width, known_freedom, positive_interval
from crankorder.quantities import Floats, Ints
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
    amplitude: Floats
    error: Floats
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


def _together(maps: Sequence[xr.Dataset], within_rpm: float) -> list[Ints]:
    """Positions, in each run, of the speeds that all runs have."""
    first = maps[0]["speed"].values
    kept = np.arange(len(first))
    matches = []
    for item in maps[1:]:
        one, two = like_speeds(first, item["speed"].values, within_rpm=within_rpm)
        matches.append(dict(zip(one.tolist(), two.tolist(), strict=True)))
        kept = kept[np.isin(kept, one)]
    return [kept, *(np.array([match[k] for k in kept.tolist()], dtype=np.int64) for match in matches)]


def _geometric(amplitude: Floats, error: Floats) -> tuple[float, float]:
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


class _TrendNumbers(MethodNumbers, file="5-identify-bearings.toml", table="trend"):
    least_ratio: float
    band_change_share: float
    no_change_chance: float
    least_growth_share: float


TREND_NUMBERS = _TrendNumbers.load()


@dataclass(frozen=True)
class Trend:
    """How an amplitude changes from run to run: the share by which it grows per run, with its 95 % interval.

    ``p_value`` is the chance of such growth or more where there is none (one-sided). ``verdict``: a sentence that
    begins as ``change`` says.
    """

    growth_per_run: float
    growth_ci95: tuple[float, float]
    p_value: float
    change: Literal["grows", "shrinks", "not decided"]
    verdict: str


class RunAmplitudes(NamedTuple):
    """Amplitudes (runs,) of one line in repeated runs, their standard errors and the degrees of freedom of these."""

    amplitudes: Floats
    errors: Floats
    freedom: float


def trend(
    amplitudes: npt.ArrayLike,
    errors: npt.ArrayLike | None = None,
    *,
    runs: npt.ArrayLike | None = None,
    freedom: float = math.inf,
) -> Trend:
    """Growth of ``amplitudes`` over repeated runs of one test, as a share per run, with interval, p-value and verdict.

    A straight line through the logarithms. With ``errors`` it is weighted by them; from three runs on they are widened
    where the runs scatter more than they say, and the interval is Student's. Without them the growth is tested by the
    ranks alone (Kendall's tau, exact); then the growth is the median of those between any two runs, and its interval
    holds all that these ranks do not exclude (Sen 1968): unbounded for fewer than five runs.

    Parameters
    ----------
    amplitudes : (runs,), > 0, any unit
    errors : (runs,), ≥ 0, standard errors in the same unit, None where unknown
    runs : (runs,), increasing: the number of each run, 0, 1, 2 … where None; with [0, 4] the first and the fifth
    freedom : degrees of freedom of the errors

    Raises RequestError where the arrays do not fit, an amplitude is not positive or runs do not increase.
    Sources: M. G. Kendall (1938), Biometrika 30, p. 81; P. K. Sen (1968), J. Am. Stat. Assoc. 63, p. 1379;
    MSU thesis: re-run the same test, growth means failing.
    """
    size = np.atleast_1d(np.asarray(amplitudes, dtype=np.float64))
    run = np.arange(len(size), dtype=np.float64) if runs is None else np.atleast_1d(np.asarray(runs, dtype=np.float64))
    error = None if errors is None else np.atleast_1d(np.asarray(errors, dtype=np.float64))
    _check(size, run, error)
    if len(size) < 2 or (len(size) == 2 and error is None):
        what = "one run" if len(size) < 2 else "two runs of unknown error"
        return Trend(math.nan, (-1.0, math.inf), 0.5, "not decided", f"not decided: {what}; run it again")
    logs = np.log(size)
    if error is None:
        return _judged(*_by_ranks(run, logs), kendall_p_value(size), kendall_p_value(size[::-1]), len(size))
    slope, spread, dof = _line(run, logs, np.maximum(error / size, 1e-9), freedom)
    half = spread * half_width(dof, level=1.0 - TREND_NUMBERS.no_change_chance)
    p_value = float(stdtr(known_freedom(dof), -slope / spread))
    return _judged(slope, (slope - half, slope + half), p_value, 1.0 - p_value, len(size))


def _check(size: Floats, run: Floats, error: Floats | None) -> None:
    if size.ndim != 1 or run.shape != size.shape or (error is not None and error.shape != size.shape):
        raise RequestError("one amplitude, error and number for each run", found=f"{size.shape} and {run.shape}")
    if not (np.isfinite(size).all() and (size > 0.0).all() and (np.diff(run) > 0.0).all()):
        raise RequestError(
            "no trend of these amplitudes", found=str(size.tolist()), allowed="> 0, in runs whose numbers increase"
        )
    if error is not None and not (error >= 0.0).all():
        raise RequestError("no such standard errors", found=str(error.tolist()), allowed="0 or more")


def _by_ranks(run: Floats, logs: Floats) -> tuple[float, tuple[float, float]]:
    """Median of the slopes between any two runs, and the ends of the interval that Kendall's test leaves of them."""
    one, two = np.triu_indices(len(run), k=1)
    slopes = np.sort((logs[two] - logs[one]) / (run[two] - run[one]))
    chance = np.cumsum(_chance_of_rises(len(run))[::-1])  # of the most rises, of one less or more, …
    # numbers of rises that would exclude a slope, from the top
    excluded = int(np.count_nonzero(chance <= TREND_NUMBERS.no_change_chance / 2.0))
    if excluded == 0:
        return float(np.median(slopes)), (-math.inf, math.inf)
    return float(np.median(slopes)), (float(slopes[excluded - 1]), float(slopes[-excluded]))


def _line(run: Floats, logs: Floats, relative: Floats, freedom: float) -> tuple[float, float, float]:
    """Slope of the straight line through ``logs``, its standard error and the degrees of freedom of that."""
    weight = relative**-2.0
    beside = run - (weight * run).sum() / weight.sum()
    variance = 1.0 / float((weight * beside**2).sum())
    slope = float((weight * beside * logs).sum()) * variance
    left = len(run) - 2
    if left == 0:
        return slope, math.sqrt(variance), freedom
    rest = logs - (weight * logs).sum() / weight.sum() - slope * beside
    spread = float((weight * rest**2).sum()) / left
    if spread <= 1.0:
        return slope, math.sqrt(variance), freedom
    return slope, math.sqrt(variance * spread), float(left)


def _judged(slope: float, ends: tuple[float, float], p_value: float, p_fall: float, n_runs: int) -> Trend:
    """Trend of a ``slope`` of logarithms with its 95 % ``ends``, and with the chances of such growth and such fall."""
    growth, low, high = (math.expm1(value) if value < 700.0 else math.inf for value in (slope, *ends))
    interval = f"{low:+.1%} to {high:+.1%} a run with 95 % certainty, {n_runs} runs"
    if math.isinf(high):
        interval = f"{n_runs} runs are too few for an interval"
    change: Literal["grows", "shrinks", "not decided"] = "not decided"
    verdict = f"not decided: {growth:+.1%} a run ({interval}); run it again"
    if p_value <= TREND_NUMBERS.no_change_chance / 2.0:
        says = (
            "the bearing is failing"
            if low >= TREND_NUMBERS.least_growth_share
            else "too little to tell a damage from load or temperature"
        )
        change, verdict = "grows", f"grows by {growth:.1%} a run ({interval}): {says}"
    elif p_fall <= TREND_NUMBERS.no_change_chance / 2.0:
        change, verdict = "shrinks", f"shrinks by {-growth:.1%} a run ({interval}): no sign of a failing bearing"
    return Trend(growth, (low, high), p_value, change, verdict)


def kendall_p_value(values: Floats) -> float:
    """Chance that independent ``values`` (runs,) rise at least as steadily as these; exact, ties count as no rise."""
    n = len(values)
    rises = sum(float(np.sum(values[k + 1 :] > values[k])) for k in range(n))
    return float(min(1.0, _chance_of_rises(n)[round(rises) :].sum()))


def _chance_of_rises(n: int) -> Floats:
    """Chance (0 … n (n - 1) / 2) of each number of rises among the pairs of ``n`` independent values."""
    ways = np.ones(1)
    for k in range(2, n + 1):
        ways = np.convolve(ways, np.full(k, 1.0 / k))
    return ways


def run_amplitudes(envelopes: Sequence[xr.Dataset], *, order: float) -> RunAmplitudes:
    """Amplitudes of the line at ``order`` in the EnvelopeMaps of repeated runs, as shares of their mean.

    They are taken over all channels and speeds that all ``envelopes`` hold and in which the line stands clear in at
    least one run; none where there is no such. The amplitude of a run without the line is that of half its noise.
    Errors are those of the noise, widened where speeds disagree on how the runs compare, for strikes vary by
    themselves, and where the bands of demodulation differ from run to run.
    """
    none = RunAmplitudes(np.zeros(0), np.zeros(0), math.inf)
    spectra = [spectra_of(one) for one in envelopes if one.sizes["order"] > 1]
    if len(spectra) < len(envelopes) or not spectra or any(s.count.shape != spectra[0].count.shape for s in spectra):
        return none
    ratio, power, count = (np.array(values) for values in zip(*(_at(one, order) for one in spectra), strict=True))
    clear = ratio.max(axis=0) >= TREND_NUMBERS.least_ratio
    if not clear.any():
        return none
    low, high = (np.array([one[end].values for one in envelopes]) for end in ("band_low", "band_high"))
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
