"""Order spectra of frames resampled by angle, and what their numerics err by."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.fft.resampling import cheapest_kernel
from crankorder.fft.transforms import FrameTransform, whole_frames
from crankorder.fft.windows import hann
from crankorder.orders.method import (
    FrameLayout,
    OrderMethod,
    TimeSamples,
    rev_frequencies,
    samples_per_rev_for,
    signals_at,
)
from crankorder.quantities import Bools, Complexes, Floats
from crankorder.settings import LEAST_TOLERANCE
from crankorder.shaft.angle import knots_of, time_at

CHUNK_SAMPLES = 1 << 19
"""Samples by angle that are held at a time: the memory does not grow with the recording."""

CHUNK_SPEED_RATIO = 1.3
"""Frames whose speeds differ by more are sampled at different angles: the slowest sets the samples per revolution."""

DENSER = 4
"""Factor by which a frame is sampled more densely to judge it, and all frames where that shows an error."""


def spectra(
    samples: TimeSamples, shaft: xr.Dataset, layout: FrameLayout, *, n_orders: int, max_order: float, density: int = 1
) -> Complexes:
    """Spectra (channels, frames, ``n_orders``) of ``samples`` by the method and on the frames of ``layout``.

    In peak amplitude, phases from crank angle 0 of ``shaft``. Where the angle is smooth, nothing folds onto an order up
    to ``max_order``; where it scatters from tooth to tooth, ``density`` times as many samples per revolution are taken.
    Frames of a channel that touch one of its gaps are NaN.
    """
    spectrum = np.empty((len(samples.signals), len(layout.begin_rev), n_orders), dtype=np.complex128)
    kernel = layout.method.kernel
    assert kernel is not None
    for chunk, slowest_hz in _chunks(samples, shaft, layout, CHUNK_SAMPLES // density):
        per_rev = density * samples_per_rev_for(samples, kernel, slowest_hz=slowest_hz, max_order=max_order)
        begin = layout.begin_rev[chunk]
        angle = begin[0] + np.arange(round((begin[-1] - begin[0] + layout.revs) * per_rev)) / per_rev
        values, usable = signals_at(samples, shaft, angle, kernel)
        spectrum[:, chunk] = spectra_by_angle(values, usable, per_rev, layout.revs, layout.hop_rev, begin, n_orders)
    return spectrum


def spectra_by_angle(
    signals: NDArray[np.floating],
    usable: Bools | None,
    samples_per_rev: int,
    revs: int,
    hop_rev: int,
    begin_rev: Floats,
    n_orders: int,
) -> Complexes:
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
        spectrum[~whole_frames(usable, starts, length)] = np.nan
    return spectrum


def _chunks(
    samples: TimeSamples, shaft: xr.Dataset, layout: FrameLayout, most_samples: int
) -> Iterator[tuple[slice, float]]:
    """Runs of neighbours of like speed, of ``most_samples`` or one frame, each with its lowest rotation [Hz]."""
    n_frames, hop, revs = len(layout.begin_rev), layout.hop_rev, layout.revs
    first = np.round(layout.begin_rev - layout.begin_rev[0]).astype(int)
    edges = layout.begin_rev[0] + np.arange(first[-1] + revs + 1, dtype=np.float64)
    by_rev = rev_frequencies(shaft, edges)
    slowest = np.array([by_rev[k : k + revs].min() for k in first])
    begin = 0
    low = high = slowest[0]
    for frame in range(1, n_frames):
        below, above = min(low, slowest[frame]), max(high, slowest[frame])
        n_samples = ((frame - begin) * hop + revs) * samples.rate_hz / below
        apart = first[frame] - first[frame - 1] > hop
        if apart or above > CHUNK_SPEED_RATIO * below or n_samples > most_samples:
            yield slice(begin, frame), float(low)
            begin, low, high = frame, slowest[frame], slowest[frame]
        else:
            low, high = below, above
    yield slice(begin, n_frames), float(low)


def achieved_error(
    samples: TimeSamples,
    shaft: xr.Dataset,
    layout: FrameLayout,
    spectrum: Complexes,
    *,
    speed_rpm: Floats,
    max_order: float,
    density: int = 1,
) -> float:
    """Largest error of the fastest frame of ``spectrum`` (channels, frames, orders), over its largest amplitude.

    The truth is the same frame of the same ``samples`` and ``shaft``, resampled four times as densely as with
    ``density`` and by a kernel without an error of its own where the recording has the neighbours that it takes.
    ``layout`` says where the frames lie, ``speed_rpm`` (frames,) how fast they are, ``max_order`` the highest order
    wanted; those beyond the content of the samples are not looked at. NaN where no frame is whole, or where the
    recording has no neighbours to compare with.
    """
    whole = np.isfinite(spectrum[:, :, 0])
    if not whole.any():
        return math.nan
    frame = int(np.argmax(np.where(whole.any(axis=0), speed_rpm, -np.inf)))
    begin = layout.begin_rev[frame : frame + 1]
    place = (time_at(np.append(begin, begin + layout.revs), **knots_of(shaft)) - samples.start_s) * samples.rate_hz
    room = min(place[0], samples.signals.shape[1] - 1 - place[1])
    kernel = cheapest_kernel(LEAST_TOLERANCE, content=samples.content)
    if kernel.margin > room:
        assert layout.method.kernel is not None
        kernel = layout.method.kernel
    low = max(0, math.floor(place[0]) - kernel.margin)
    piece = samples.signals[:, low : math.ceil(place[1]) + kernel.margin + 1].astype(np.float64)
    start_s = samples.start_s + low / samples.rate_hz
    fine = OrderMethod("resample", kernel.predicted_error, samples.content, kernel)
    one = FrameLayout(fine, layout.revs, layout.hop_rev, begin)
    carried = min(max_order, samples.content * samples.rate_hz * 60.0 / float(speed_rpm[frame]))
    n_orders = min(spectrum.shape[2], math.floor(carried * layout.revs) + 1)
    alone = TimeSamples(piece, samples.rate_hz, start_s, samples.content)
    dense = spectra(alone, shaft, one, n_orders=n_orders, max_order=max_order, density=DENSER * density)[:, 0]
    found = spectrum[whole[:, frame], frame, :n_orders]
    truth = dense[whole[:, frame]]
    largest = np.maximum(np.abs(truth).max(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    return float((np.abs(found - truth) / largest).max())
