"""A recording limited to the band that the wanted results need: most of the cost is saved here."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.fft.decimation import (
    TOLERANCE,
    channel_offsets,
    decimate,
    decimation_error,
    decimation_factor,
    decimation_reach,
    decimation_stages,
)
from crankorder.quantities import Bools, Ints, Variables, channel_coords, unindexed
from crankorder.scratch import blocks, empty_like

Runs = tuple[Ints, Ints]

LARGEST_LOSS = 0.02
"""A recording of which the filters' ends would cost a larger share keeps its rate: short ones are cheap anyway."""


def band_limited(recording: xr.Dataset, *, band_hz: float, grid_hz: float, tolerance: float = TOLERANCE) -> xr.Dataset:
    """BandRecording: the signals of ``recording`` without their mean, low-passed to ``band_hz`` and decimated.

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
    error, reach, factor, start = 0.0, 0, 1, 0.0
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
        attrs |= {"rate_hz": rate, "start_s": float(attrs.get("start_s", 0.0)) + start}
    else:
        signals, *_ = decimate(signals, rate_hz=1.0, band_hz=0.4, factor=1, offset=offset, gaps=gaps)
    # an error of an earlier decimation stays
    attrs |= {"band_hz": band_hz, "decimation_error": error + float(attrs.get("decimation_error", 0.0))}
    words = {"units": "see unit", "long_name": "signal in the analysis band"}
    variables: Variables = {"signal": (("channel", axis), signals, words)}
    if bad is not None:
        usable = empty_like(signals, signals.shape, np.bool_)
        for row, (starts, ends) in zip(usable, bad, strict=True):
            _mark_untouched(row, starts, ends, factor, reach)
        variables["usable"] = (
            ("channel", axis),
            usable,
            {"units": "1", "long_name": "free of gaps and of their filtering"},
        )
    return xr.Dataset(variables, coords=unindexed(**channel_coords(recording)), attrs=attrs)


def sound_samples(band: xr.Dataset) -> Bools:
    """Which samples (channels, samples) of the BandRecording ``band`` are finite and usable."""
    sound = np.isfinite(band["signal"].values)
    return np.asarray(sound & band["usable"].values if "usable" in band else sound)


def _unusable(recording: xr.Dataset, signals: NDArray[np.floating], *, gaps: bool) -> list[Runs] | None:
    """Runs of samples of each channel that are missing or not usable; None where there is none."""
    if "usable" not in recording and not gaps:
        return None
    usable = recording["usable"].values if "usable" in recording else [None] * len(signals)
    return [_bad_runs(row, mask) for row, mask in zip(signals, usable, strict=True)]


def _bad_runs(signal: NDArray[np.floating], usable: Bools | None) -> Runs:
    """First samples, and those after the last, of the runs in which ``signal`` is not finite or not ``usable``."""
    turns, was_bad = [np.empty(0, dtype=np.int64)], False
    for part in blocks(signal.size):
        bad = ~np.isfinite(signal[part])
        if usable is not None:
            bad |= ~usable[part]
        if was_bad or bad.any():
            turns.append(part.start + np.flatnonzero(np.diff(bad, prepend=was_bad)))
            was_bad = bool(bad[-1])
    edges = np.concatenate([*turns, [signal.size] * was_bad])
    return edges[::2].astype(np.int64), edges[1::2].astype(np.int64)


def _mark_untouched(out: Bools, starts: Ints, ends: Ints, factor: int, reach: int) -> None:
    """Set ``out`` where no bad sample, from ``starts`` to before ``ends``, lies within ``reach`` of the output."""
    out[:] = True
    first = -(-reach // factor)
    low = np.maximum(-(-(starts - reach) // factor) - first, 0)
    high = np.maximum((ends - 1 + reach) // factor - first + 1, 0)
    for begin, end in zip(low, high, strict=True):
        out[begin:end] = False
