"""Order spectra of frames, by the method chosen, and what its numerics err by."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.fft.transforms import FrameTransform
from crankorder.fft.windows import hann
from crankorder.orders.by_angle import TimeSamples, rev_frequencies, samples_per_rev_for, signals_at, touches_gap
from crankorder.orders.direct import order_frames_nufft
from crankorder.orders.method import FrameLayout
from crankorder.shaft.angle import angle_at, knots_of, time_at

CHUNK_SAMPLES = 1 << 19
"""Samples by angle that are held at a time: the memory does not grow with the recording."""

CHUNK_SPEED_RATIO = 1.3
"""Frames whose speeds differ by more are sampled at different angles: the slowest sets the samples per revolution."""

PROBE_SPREAD = 64
"""Samples of the test tones beyond the frame on either side, where the recording has them too."""

PROBE_SHARE = 0.98
"""The higher test tone lies so far up in the content of the recording."""


def spectra(
    samples: TimeSamples, shaft: xr.Dataset, layout: FrameLayout, *, n_orders: int, max_order: float
) -> NDArray[np.complex128]:
    """Spectra (channels, frames, ``n_orders``) of ``samples`` by the method and on the frames of ``layout``.

    In peak amplitude, phases from crank angle 0 of ``shaft``; nothing folds onto an order up to ``max_order``. Frames
    of a channel that touch one of its gaps are NaN.
    """
    if layout.method.name == "nufft":
        return order_frames_nufft(
            samples.signals,
            rate_hz=samples.rate_hz,
            start_s=samples.start_s,
            knots=knots_of(shaft),
            begin_rev=layout.begin_rev,
            revs=layout.revs,
            n_orders=n_orders,
            tolerance=layout.method.predicted_error,
            usable=samples.usable,
        )
    spectrum = np.empty((len(samples.signals), len(layout.begin_rev), n_orders), dtype=np.complex128)
    for chunk, slowest_hz in _chunks(samples, shaft, layout):
        spectrum[:, chunk] = _resampled(samples, shaft, layout, chunk, slowest_hz, n_orders, max_order)
    return spectrum


def _resampled(
    samples: TimeSamples,
    shaft: xr.Dataset,
    layout: FrameLayout,
    chunk: slice,
    slowest_hz: float,
    n_orders: int,
    max_order: float,
) -> NDArray[np.complex128]:
    """Spectra of the frames ``chunk``, resampled at angles even enough for the lowest speed among them."""
    kernel = layout.method.kernel
    assert kernel is not None
    per_rev = samples_per_rev_for(samples, kernel, slowest_hz=slowest_hz, max_order=max_order)
    begin = layout.begin_rev[chunk]
    angle = begin[0] + np.arange(round((begin[-1] - begin[0] + layout.revs) * per_rev)) / per_rev
    values, usable = signals_at(samples, shaft, angle, kernel)
    return spectra_by_angle(values, usable, per_rev, layout.revs, layout.hop_rev, begin, n_orders)


def spectra_by_angle(
    signals: NDArray[np.floating],
    usable: NDArray[np.bool_] | None,
    samples_per_rev: int,
    revs: int,
    hop_rev: int,
    begin_rev: NDArray[np.float64],
    n_orders: int,
) -> NDArray[np.complex128]:
    """Spectra (channels, frames, ``n_orders`` or as many as there are) of ``signals`` at even crank angles.

    ``signals`` (channels, samples) begin with the first frame; frames are ``revs`` long, ``hop_rev`` apart and begin at
    the angles ``begin_rev`` (frames,) in rev; ``samples_per_rev`` and ``usable`` are those of the signals.
    """
    starts = np.arange(len(begin_rev), dtype=np.int64) * hop_rev * samples_per_rev
    length = revs * samples_per_rev
    made = FrameTransform(hann(length), n_bins=n_orders).spectra(signals, starts)
    turn = np.exp(-2j * np.pi * (np.outer(begin_rev, np.arange(made.shape[2]) / revs) % 1.0))
    spectrum = np.asarray(made * turn)
    if usable is not None:
        spectrum[touches_gap(usable, starts, starts + length - 1)] = np.nan
    return spectrum


def _chunks(samples: TimeSamples, shaft: xr.Dataset, layout: FrameLayout) -> Iterator[tuple[slice, float]]:
    """Runs of frames of like speed that fit into memory, each with its lowest rotational frequency [Hz]."""
    n_frames, hop, revs = len(layout.begin_rev), layout.hop_rev, layout.revs
    edges = layout.begin_rev[0] + np.arange((n_frames - 1) * hop + revs + 1, dtype=np.float64)
    edges[-1] = min(edges[-1], float(shaft["crank_angle"].values[-1]))
    by_rev = rev_frequencies(shaft, edges)
    slowest = np.array([by_rev[k * hop : k * hop + revs].min() for k in range(n_frames)])
    begin = 0
    low = high = slowest[0]
    for frame in range(1, n_frames):
        below, above = min(low, slowest[frame]), max(high, slowest[frame])
        n_samples = ((frame - begin) * hop + revs) * samples.rate_hz / below
        if above > CHUNK_SPEED_RATIO * below or n_samples > CHUNK_SAMPLES:
            yield slice(begin, frame), float(low)
            begin, low, high = frame, slowest[frame], slowest[frame]
        else:
            low, high = below, above
    yield slice(begin, n_frames), float(low)


def achieved_error(
    samples: TimeSamples,
    shaft: xr.Dataset,
    layout: FrameLayout,
    *,
    speed_rpm: NDArray[np.float64],
    max_order: float,
) -> float:
    """Largest error of two tones of unit amplitude, at a low and at the highest order carried, in the fastest frame.

    The tones are sampled where ``samples`` are, follow the crank angle of ``shaft``, and go through the method of
    ``layout``; ``speed_rpm`` (frames,) are the frames' speeds, ``max_order`` is the highest order wanted.
    """
    fastest = int(np.argmax(speed_rpm))
    begin = layout.begin_rev[fastest]
    knots = knots_of(shaft)
    spread = layout.method.margin + PROBE_SPREAD
    span = (time_at(np.array([begin, begin + layout.revs]), **knots) - samples.start_s) * samples.rate_hz
    low = max(0, math.floor(span[0]) - spread)
    high = min(samples.signals.shape[1], math.ceil(span[1]) + spread + 1)
    start_s = samples.start_s + low / samples.rate_hz
    times = np.clip(start_s + np.arange(high - low) / samples.rate_hz, *knots["knot_time_s"][[0, -1]])
    carried = min(max_order, PROBE_SHARE * samples.content * samples.rate_hz * 60.0 / float(speed_rpm[fastest]))
    bins = np.maximum(4, np.array([layout.revs, math.floor(carried * layout.revs)]))
    tones = np.cos(2.0 * np.pi * (bins[:, None] / layout.revs * angle_at(times, **knots)[None, :] % 1.0))
    probe = TimeSamples(tones.astype(samples.signals.dtype), samples.rate_hz, start_s, samples.content)
    one = FrameLayout(layout.method, layout.revs, layout.hop_rev, layout.begin_rev[fastest : fastest + 1])
    made = spectra(probe, shaft, one, n_orders=int(bins.max()) + 1, max_order=max_order)
    return float(np.abs(made[[0, 1], 0, bins] - 1.0).max())
