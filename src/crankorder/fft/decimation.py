"""Decimation in one pass on the absolute grid of the samples, and a recording limited to the band that results need."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numba as nb
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.quantities import Bools, Floats, Ints, Variables, channel_coords, described, unindexed
from crankorder.scratch import blocks, empty_like

TOLERANCE = 1e-6
"""Default of the largest relative error: below the resolution of a 20-bit converter."""

LARGEST_STAGE = 8
"""A stage of more would need a longer filter than two smaller ones together."""

SPARE_BAND = 1.25
"""The rate kept is at least 2 x 1.25 x the band: room for the filter's skirt and for the angle resampling kernel."""

ON_GRID_SHARE = 0.5
"""A factor so much below the largest is taken where it makes the rate a multiple of the frequency resolution: lines
between bins off that grid would be interpolated, and moved. With half, a rate of 2^n finds one always."""

SAMPLE_COST = {2: 12.0, 3: 14.0, 4: 6.0, 5: 8.0, 6: 14.0, 7: 14.0, 8: 14.0}
"""Cost of moving a sample into its phase, in multiplications, by factor (measured: 2…5 G samples/s, 24 G taps/s)."""

ROUNDING = 2e-15
"""Relative rounding error of the taps and sums in float64 (measured below 1e-15): no design reaches further."""

BETWEEN = 1.01
"""Errors between the frequencies looked at may be so many times larger (measured: 1.003)."""

SINGLE_SUMS = 5e-7
"""From this tolerance on float32 signals are summed in float32, which adds at most 2e-7 of the largest sample
(measured; 4e-8 rms); below it they are summed in float64 and only the result is rounded."""

PASS_SAMPLES = 65_536
"""Samples filtered at a time: they and what becomes of them stay in the second-level cache."""


class DecimationStage(NamedTuple):
    """One FIR low-pass of symmetric ``taps`` (taps,), an odd number, that keeps every ``factor``-th sample."""

    factor: int
    taps: Floats

    @property
    def half(self) -> int:
        """Samples that the filter reaches to either side."""
        return len(self.taps) // 2


def decimation_factor(rate_hz: float, band_hz: float, *, grid_hz: float | None = None) -> int:
    """Largest factor, 1 or more, that leaves a rate of 2.5 times ``band_hz`` and splits into stages of at most 8.

    ``rate_hz`` are the samples per second before, ``band_hz`` is the end of the band, above 0. A factor down to half of
    the largest is preferred where the rate left is then a multiple of ``grid_hz``, so that the bins of a transform fall
    on that grid.
    """
    most = max(1, int(rate_hz / (2.0 * SPARE_BAND * band_hz)))
    possible = [factor for factor in range(most, 0, -1) if _splits(factor)]
    if grid_hz is None:
        return possible[0]
    steps = {factor: rate_hz / factor / grid_hz for factor in possible if factor >= ON_GRID_SHARE * most}
    return next((f for f, n in steps.items() if abs(n - round(n)) < 1e-6), possible[0])


def _splits(factor: int) -> bool:
    """Whether 2, 3, 5 and 7 are the only primes of ``factor``, which is below 2^64."""
    return 210**64 % factor == 0


def decimation_stages(
    rate_hz: float, band_hz: float, factor: int, tolerance: float = TOLERANCE
) -> tuple[DecimationStage, ...]:
    """Cheapest stages that keep 0…``band_hz`` within ``tolerance`` while the rate falls from ``rate_hz`` by ``factor``.

    ``tolerance`` is the relative amplitude error. Content that would fold onto the band is attenuated to it; content
    between the band and half of the new rate may fold there. Each filter is the shortest Kaiser-windowed sinc (Kaiser
    1974) whose computed response keeps this.
    """
    band = band_hz / rate_hz * factor
    # to the next hundredth of the new rate: recordings that differ little in band share a design
    return _stages(min(max(band, 0.5 / SPARE_BAND), math.ceil(100.0 * band) / 100.0), factor, tolerance)


@lru_cache(maxsize=256)
def _stages(band: float, factor: int, tolerance: float) -> tuple[DecimationStage, ...]:
    """Stages for a ``band`` that is a share of the last rate."""
    rate = float(factor)
    factors = _cheapest(rate, band, factor, tolerance)[1]
    share = max(tolerance, ROUNDING) / max(1, len(factors))
    stages = []
    for divisor in factors:
        stages.append(_shortest(band / rate, divisor, share))
        rate /= divisor
    return tuple(stages)


@lru_cache(maxsize=256)
def decimation_error(rate_hz: float, band_hz: float, factor: int, tolerance: float = TOLERANCE) -> float:
    """Predicted largest relative error of a tone in the band: its own gain, or what folds onto it; 0 for factor 1.

    ``rate_hz``, ``band_hz``, ``factor`` and ``tolerance`` are those of :func:`decimation_stages`, whose responses are
    computed. Rounding comes on top: 6e-8 of a sample for float32 (see ``decimation.SINGLE_SUMS``).
    """
    stages = decimation_stages(rate_hz, band_hz, factor, tolerance)
    if not stages:
        return 0.0
    frequency = np.linspace(0.0, band_hz, 512)
    gain, worst = np.ones_like(frequency), 0.0
    for stage in stages:
        gain *= _response(stage.taps, frequency / rate_hz)
        image = np.minimum(rate_hz / stage.factor + np.concatenate([-frequency, frequency]), 0.5 * rate_hz)
        worst = max(worst, float(np.abs(_response(stage.taps, image / rate_hz)).max()))
        rate_hz /= stage.factor
    return BETWEEN * max(float(np.abs(gain - 1.0).max()), worst)


@lru_cache(maxsize=1024)
def _cheapest(rate_hz: float, band_hz: float, factor: int, tolerance: float) -> tuple[float, tuple[int, ...]]:
    """Cost per sample and factors of the stages, first to last, of the cheapest way to decimate by ``factor``."""
    if factor == 1:
        return 0.0, ()
    best: tuple[float, tuple[int, ...]] = (math.inf, (factor,))
    for divisor in range(2, min(LARGEST_STAGE, factor) + 1):
        if factor % divisor == 0 and _splits(factor // divisor):
            rest, after = _cheapest(rate_hz / divisor, band_hz, factor // divisor, tolerance)
            here = SAMPLE_COST[divisor] + _estimated_taps(rate_hz, band_hz, divisor, tolerance) / divisor
            best = min(best, (here + rest / divisor, (divisor, *after)))
    return best


def _transition(rate_hz: float, band_hz: float, divisor: int) -> float:
    """Width in rad per sample between the band and the first frequency that folds onto it."""
    return 2.0 * np.pi * (rate_hz / divisor - 2.0 * band_hz) / rate_hz


def _estimated_taps(rate_hz: float, band_hz: float, divisor: int, tolerance: float) -> float:
    rejection_db = -20.0 * np.log10(max(tolerance, ROUNDING))
    return max(3.0, float((rejection_db - 7.95) / (2.285 * _transition(rate_hz, band_hz, divisor)) + 1.0))


def _shortest(band: float, divisor: int, tolerance: float) -> DecimationStage:
    """Shortest stage whose computed ripple and alias for a ``band`` (share of its rate) are below ``tolerance``."""
    n_taps = int(_estimated_taps(1.0, band, divisor, tolerance)) | 1
    # closest where both are largest: at the edges of the band and of its first image
    pass_band = band * np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, 24))
    stop_band = np.concatenate([1.0 / divisor - pass_band, 1.0 / divisor + pass_band[::4]])
    both = np.concatenate([pass_band, np.minimum(stop_band, 0.5)])
    while True:
        # the window that fills the whole transition: its attenuation follows from the length
        rejection_db = 7.95 + 2.285 * (n_taps - 1) * _transition(1.0, band, divisor)
        # a sinc that cuts at half of the reduced rate; its sum is 1
        taps = np.sinc((np.arange(n_taps) - n_taps // 2) / divisor)
        taps *= np.kaiser(n_taps, max(0.0, 0.1102 * (rejection_db - 8.7)))
        taps /= taps.sum()
        gain = _response(taps, both)
        gain[: len(pass_band)] -= 1.0
        if float(np.abs(gain).max()) * BETWEEN <= 0.99 * tolerance:
            return DecimationStage(divisor, taps)
        n_taps += 2


def _response(taps: Floats, share_of_rate: Floats) -> Floats:
    """Gain of symmetric ``taps`` at frequencies given as a share of the sample rate."""
    k = np.arange(1, len(taps) // 2 + 1)
    side = taps[len(taps) // 2 + 1 :]
    return np.asarray(taps[len(taps) // 2] + 2.0 * (np.cos(2.0 * np.pi * np.outer(share_of_rate, k)) @ side))


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _filtered(signal, offset, rest, taps, offsets, factor, phases, out):  # type: ignore[no-untyped-def]
    """Add to ``out`` [k] the sum of taps[j] (signal[k factor + j] - offset - rest), eight taps at a time.

    ``phases`` [p row + k] takes signal[k factor + p] - offset - rest, so that tap j finds its samples from
    ``offsets`` [j] on: each sweep is vectorised along the outputs.
    """
    row = phases.size // factor
    for p in range(factor):
        a, read = phases[p * row :], signal[p:]
        for k in range((read.size + factor - 1) // factor):
            a[k] = read[factor * k] - offset - rest
    for j in range(0, taps.size, 8):
        a, b, c, d = phases[offsets[j] :], phases[offsets[j + 1] :], phases[offsets[j + 2] :], phases[offsets[j + 3] :]
        t0, t1, t2, t3, o, t = taps[j], taps[j + 1], taps[j + 2], taps[j + 3], offsets[j + 4 :], taps[j + 4 :]
        e, f, g, h = phases[o[0] :], phases[o[1] :], phases[o[2] :], phases[o[3] :]
        t4, t5, t6, t7 = t[0], t[1], t[2], t[3]
        for k in range(out.size):
            four = (t0 * a[k] + t1 * b[k]) + (t2 * c[k] + t3 * d[k])
            out[k] += four + ((t4 * e[k] + t5 * f[k]) + (t6 * g[k] + t7 * h[k]))


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _mean(signal):  # type: ignore[no-untyped-def]
    """Mean, summed in float64; not finite where a sample is not."""
    mean, share = 0.0, 1.0 / signal.size
    for k in range(signal.size):
        mean += np.float64(signal[k]) * share  # so that sums of 1e300 do not overflow
    return mean


def channel_offsets(signals: NDArray[np.floating]) -> tuple[Floats, bool]:
    """Mean (channels,) of the finite samples of ``signals`` (channels, samples), and whether any is not finite."""
    means = np.zeros(len(signals))
    gaps = False
    for channel, row in enumerate(signals):
        means[channel] = _mean(np.ascontiguousarray(row))
        if not np.isfinite(means[channel]):
            gaps = True
            pieces = [row[first : first + PASS_SAMPLES] for first in range(0, len(row), PASS_SAMPLES)]
            count = sum(int(np.isfinite(piece).sum()) for piece in pieces)
            sums = (float(piece[np.isfinite(piece)].sum(dtype=np.float64) / count) for piece in pieces if count)
            means[channel] = sum(sums)
    return means, gaps


def decimation_reach(stages: tuple[DecimationStage, ...]) -> int:
    """Samples of the undecimated signal that an output of ``stages`` reaches to either side."""
    reach, step = 0, 1
    for stage in stages:
        reach += stage.half * step
        step *= stage.factor
    return reach


def _passed(
    signal: NDArray[np.floating], offset: float, filters: Sequence[tuple[DecimationStage, Any, Ints, Any]], gaps: bool
) -> NDArray[np.floating]:
    """All stages over a piece of one channel that holds what its outputs need and no more.

    ``offset`` is taken away, the channel's mean as a rule, so that a constant of a million times the signal costs no
    digits. ``filters``: each stage, its taps in eights, where the samples of each begin among the phases, and room
    for these. With ``gaps`` samples that are not finite count as ``offset``; without, nobody looks for them.
    """
    signal = np.ascontiguousarray(signal)
    if gaps and not np.isfinite(_mean(signal)):
        signal = np.where(np.isfinite(signal), signal, signal.dtype.type(offset))
    kind = filters[0][1].dtype.type
    # two terms, so that in float32 nothing of a large constant is left over
    high = kind(offset)
    low = kind(offset - float(high))
    for stage, taps, offsets, phases in filters:
        out = np.zeros((len(signal) - len(stage.taps)) // stage.factor + 1, dtype=taps.dtype)
        _filtered(signal, high, low, taps, offsets, stage.factor, phases, out)
        signal, high, low = out, kind(0.0), kind(0.0)
    return signal


def decimate(
    signals: NDArray[np.floating],
    *,
    rate_hz: float,
    band_hz: float,
    factor: int,
    tolerance: float = TOLERANCE,
    offset: Floats | None = None,
    gaps: bool = True,
) -> tuple[NDArray[np.floating], float, float]:
    """Signals without their mean, low-passed to ``band_hz`` and decimated by ``factor``; then rate and start.

    ``signals`` is (channels, samples) at ``rate_hz``, float32 or float64, and so is what comes out: (channels, fewer
    samples), the new rate in Hz and the time in s of its first sample after the first of ``signals``. Only outputs
    whose filter lies wholly inside the record are given; they are right within ``tolerance``
    (:func:`decimation_error`). ``offset`` (channels,) is taken away instead of the mean where given, and ``gaps`` then
    says whether a sample may not be finite. Samples that are not count as the mean of the others.
    """
    signals = signals if signals.dtype in (np.float32, np.float64) else signals.astype(np.float64)
    offset, gaps = channel_offsets(signals) if offset is None else (offset, gaps)
    if factor == 1:
        rested = empty_like(signals, signals.shape, signals.dtype)
        for part in blocks(signals.shape[1], size=PASS_SAMPLES):
            out = rested[:, part]
            np.subtract(signals[:, part], offset[:, None], out=out, dtype=np.float64, casting="same_kind")
            if gaps:
                np.nan_to_num(out, copy=False, posinf=0.0, neginf=0.0)
        return rested, rate_hz, 0.0
    stages = decimation_stages(rate_hz, band_hz, factor, tolerance)
    sums = np.dtype(np.float32 if signals.dtype == np.float32 and tolerance >= SINGLE_SUMS else np.float64)
    # output k lies on sample k * factor and needs the samples within reach of it
    reach, size = decimation_reach(stages), max(1, PASS_SAMPLES // factor)
    filters, most = [], (size - 1) * factor + 2 * reach + 1
    for stage in stages:
        row, spare = most // stage.factor + 1, (0, -len(stage.taps) % 8)
        group, phase = np.divmod(np.arange(len(stage.taps)), stage.factor)
        taps, offsets = np.pad(stage.taps.astype(sums), spare), np.pad(phase * row + group, spare)
        filters.append((stage, taps, offsets, np.zeros(row * stage.factor, dtype=sums)))
        most = (most - len(stage.taps)) // stage.factor + 1
    first = -(-reach // factor)
    stop = (signals.shape[1] - 1 - reach) // factor + 1
    made = empty_like(signals, (len(signals), max(0, stop - first)), signals.dtype)
    for part in blocks(made.shape[1], size=size):
        needed = slice((first + part.start) * factor - reach, (first + part.stop - 1) * factor + reach + 1)
        for row, signal, mean in zip(made, signals, np.asarray(offset, dtype=np.float64), strict=True):
            row[part] = _passed(signal[needed], mean, filters, gaps)
    return made, rate_hz / factor, first * factor / rate_hz


LARGEST_LOSS = 0.02
"""A recording of which the filters' ends would cost a larger share keeps its rate: short ones are cheap anyway."""


def band_limited(recording: xr.Dataset, *, band_hz: float, grid_hz: float, tolerance: float = TOLERANCE) -> xr.Dataset:
    """BandRecording (channel, time): signals of ``recording`` without mean, low-passed to ``band_hz`` and decimated.

    The new rate is a multiple of ``grid_hz`` where that costs little; within the band the amplitudes are right to
    ``tolerance`` (the attribute ``decimation_error`` says what is predicted). float32 stays float32. A short recording
    keeps its rate, for the filters would take away its ends. A recording by crank angle has no rate to reduce: it only
    loses its mean. Where samples are missing (NaN) or were not usable before, the variable ``usable`` is False as far
    as the filters reach. Encoder data are left out, for the shaft angle has been made from them.
    """
    axis = "time" if recording.attrs["domain"] == "time" else "crank_angle"
    signals = recording["signal"].values
    offset, gaps = channel_offsets(signals)
    bad = _unusable(recording, signals, gaps=gaps)
    attrs = dict(recording.attrs)
    rate, error, reach, factor = 1.0, 0.0, 0, 1
    if axis == "time":
        rate = float(attrs["rate_hz"])
        factor = decimation_factor(rate, band_hz, grid_hz=grid_hz)
        reach = decimation_reach(decimation_stages(rate, band_hz, factor, tolerance))
        if 2 * reach > LARGEST_LOSS * signals.shape[1]:
            factor, reach = 1, 0
        error = decimation_error(rate, band_hz, factor, tolerance)
    signals, rate, start = decimate(
        signals, rate_hz=rate, band_hz=band_hz, factor=factor, tolerance=tolerance, offset=offset, gaps=gaps
    )
    if axis == "time":
        attrs |= {"rate_hz": rate, "start_s": float(attrs.get("start_s", 0.0)) + start}
    # an error of an earlier decimation stays
    attrs |= {"band_hz": band_hz, "decimation_error": error + float(attrs.get("decimation_error", 0.0))}
    variables: Variables = {"signal": described(("channel", axis), signals, "see unit", "signal in the analysis band")}
    if bad is not None:
        usable = empty_like(signals, signals.shape, np.bool_)
        for row, (starts, ends) in zip(usable, bad, strict=True):
            # no bad sample lies within reach of the output
            row[:] = True
            first = -(-reach // factor)
            low = np.maximum(-(-(starts - reach) // factor) - first, 0)
            high = np.maximum((ends - 1 + reach) // factor - first + 1, 0)
            for begin, end in zip(low, high, strict=True):
                row[begin:end] = False
        variables["usable"] = described(("channel", axis), usable, "1", "free of gaps and of their filtering")
    return xr.Dataset(variables, coords=unindexed(**channel_coords(recording)), attrs=attrs)


def sound_samples(band: xr.Dataset) -> Bools:
    """Which samples (channels, samples) of the BandRecording ``band`` are finite and usable."""
    sound = np.isfinite(band["signal"].values)
    return np.asarray(sound & band["usable"].values if "usable" in band else sound)


def _unusable(recording: xr.Dataset, signals: NDArray[np.floating], *, gaps: bool) -> list[tuple[Ints, Ints]] | None:
    """First samples, and those after the last, of the runs of each channel that are missing or not usable.

    None where there is none.
    """
    if "usable" not in recording and not gaps:
        return None
    usable = recording["usable"].values if "usable" in recording else [None] * len(signals)
    runs = []
    for signal, mask in zip(signals, usable, strict=True):
        turns, was_bad = [np.empty(0, dtype=np.int64)], False
        for part in blocks(signal.size):
            bad = ~np.isfinite(signal[part]) if mask is None else ~(np.isfinite(signal[part]) & mask[part])
            if was_bad or bad.any():
                turns.append(part.start + np.flatnonzero(np.diff(bad, prepend=was_bad)))
                was_bad = bool(bad[-1])
        edges = np.concatenate([*turns, [signal.size] * was_bad]).astype(np.int64)
        runs.append((edges[::2], edges[1::2]))
    return runs
