"""Order spectra of frames, resampled by angle or straight from the samples in time, and what their numerics err by."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numba as nb
import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from crankorder.errors import RequestError
from crankorder.fft.nonuniform import (
    OrderTransform,
    Upsampling,
    folding_error,
    hann_of_constant,
    hann_of_turns,
    phase_of_whole_revs,
    real_signals,
    upsampled,
    upsampling,
)
from crankorder.fft.resampling import cheapest_kernel
from crankorder.fft.transforms import FrameTransform, whole_frames
from crankorder.fft.windows import hann
from crankorder.orders.method import (
    FrameLayout,
    OrderMethod,
    TimeSamples,
    kernel_for,
    rev_frequencies,
    samples_per_rev_for,
    signals_at,
)
from crankorder.quantities import Bools, Complexes, Floats
from crankorder.settings import LARGEST_TOLERANCE, LEAST_TOLERANCE
from crankorder.shaft.angle import knots_of, time_at

HIGHEST_SHARE = 0.49
"""Share of the sample rate up to which an order is read: 0.98 of the Nyquist frequency; NaN above."""

LARGEST_FACTOR = 16
"""Most that the samples of a frame are made denser."""

FOLDING_SHARE = 0.25
"""Share of the tolerance that folding and the half-band filters may each take."""

PASS_SHARES = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.325, 0.35, 0.375, 0.4, 0.42, 0.44, 0.46, 0.48, HIGHEST_SHARE)
"""Shares of the sample rate up to which the filters that make samples denser may be asked to be right."""

KNOT_SLACK = 1e-6
"""Samples by which one may miss the knots' range by rounding and still belong to it."""

Knots = dict[str, Floats]

CHUNK_SAMPLES = 1 << 19
"""Samples by angle that are held at a time: the memory does not grow with the recording."""

CHUNK_SPEED_RATIO = 1.3
"""Frames whose speeds differ by more are sampled at different angles: the slowest sets the samples per revolution."""

DENSER = 4
"""Factor by which a frame is sampled more densely to judge it, and all frames where that shows an error."""


@dataclass(frozen=True)
class _Frame:
    """The samples of one frame: ``signals`` from ``first`` on, turns 0…1 through the frame, and Hann weights.

    They count for the ``usable`` (channels,) and for orders up to ``highest_order``.
    """

    number: int
    signals: NDArray[np.floating]
    first: int
    turns: Floats
    weights: Floats
    usable: Bools
    highest_order: float


def order_frames_nufft(
    signals: NDArray[np.floating],
    *,
    rate_hz: float,
    start_s: float,
    knots: Knots,
    begin_rev: ArrayLike,
    revs: float,
    n_orders: int,
    tolerance: float,
    usable: Bools | None = None,
) -> Complexes:
    """Complex spectra (channels, frames, n_orders) at orders 0, 1/revs, 2/revs…, peak amplitudes, phases from angle 0.

    Hann frames of ``revs`` from each ``begin_rev`` on, by the non-uniform FFT of the samples themselves. Amplitudes
    err by at most ``tolerance`` of the frame's largest: a frame with too few samples for it (:func:`frame_factor`) is
    first made denser, which takes neighbours. Next to the ends of the record fewer orders have enough of them, next to
    unusable samples none; there the error is that of :func:`crankorder.fft.nonuniform.folding_error`.

    Parameters
    ----------
    signals : (channels, samples), float32 or float64, evenly spaced in time
    rate_hz : Hz; start_s : s, time of the first sample
    knots : arguments of :func:`crankorder.shaft.angle.angle_at`, as of ``knots_of``
    begin_rev : (frames,), rev, within the record with ``revs`` after it
    revs : rev, above 0
    n_orders : 1 or more
    tolerance : 1e-12…0.1, of amplitudes
    usable : (channels, samples) bool; a frame that touches a sample that is not is NaN for that channel

    Orders above 0.98 of the Nyquist frequency at a frame's highest speed are NaN.
    Raises RequestError for a frame outside the record or an argument out of range.
    """
    if not (np.isfinite(rate_hz) and rate_hz > 0.0 and np.isfinite(revs) and revs > 0.0):
        raise RequestError("rate and frame length must be above 0", found=f"{rate_hz} Hz, {revs} rev")
    if not LEAST_TOLERANCE <= tolerance <= LARGEST_TOLERANCE:
        allowed = f"{LEAST_TOLERANCE:g}…{LARGEST_TOLERANCE:g}"
        raise RequestError("the tolerance is out of range", found=tolerance, allowed=allowed)
    signals = real_signals(signals)
    begin = np.atleast_1d(np.asarray(begin_rev, dtype=np.float64))
    order = np.arange(n_orders) / revs
    transform = OrderTransform(n_orders=n_orders, n_channels=len(signals), tolerance=tolerance)
    of_mean = hann_of_constant(np.arange(n_orders))
    spectrum = np.full((len(signals), len(begin), n_orders), np.nan + 0j)
    record = _Record(signals, rate_hz, start_s, knots, usable)
    for frame in record.frames(begin, revs, float(order[-1]), tolerance):
        found = transform.spectra(frame.signals, frame.weights, frame.turns, first=frame.first, mean_spectrum=of_mean)
        counts = frame.usable[:, None] & (order <= frame.highest_order)
        np.copyto(spectrum[:, frame.number], found, where=counts)
    spectrum *= phase_of_whole_revs(begin, order)[None]
    return spectrum


def frame_factor(*, samples_per_frame: float, highest_share: float, tolerance: float) -> int:
    """Factor 1, 2, 4, 8 or 16 by which a frame's samples must be denser for folding to stay within ``tolerance``.

    ``samples_per_frame`` is counted at the frame's highest speed, ``highest_share`` is the frequency of the highest
    order read over the sample rate, 0…0.49. Content may lie anywhere below the Nyquist frequency. Where 16 do not
    reach it, 16 is given.
    """
    factor = 1
    while factor < LARGEST_FACTOR:
        away = (0.5 - highest_share) if factor == 1 else factor - 1.0
        if folding_error(samples_per_frame * away) <= FOLDING_SHARE * tolerance:
            break
        factor *= 2
    return factor


class _Record:
    """Signals in time with the crank angle between knots, of which frames are taken."""

    def __init__(
        self, signals: NDArray[np.floating], rate_hz: float, start_s: float, knots: Knots, usable: Bools | None
    ) -> None:
        self.signals, self.rate_hz, self.start_s, self.usable = signals, rate_hz, start_s, usable
        self.time_s = np.ascontiguousarray(knots["knot_time_s"], dtype=np.float64)
        self.angle_rev = np.ascontiguousarray(knots["knot_angle_rev"], dtype=np.float64)
        self.rev_per_s = np.asarray(knots["knot_speed_rpm"], dtype=np.float64) / 60.0
        self.knots = knots

    def frames(self, begin: Floats, revs: float, highest_order: float, tolerance: float) -> Iterator[_Frame]:
        """Each frame once; as recorded and then denser, where only some channels or orders have the neighbours."""
        low, high = self._bounds(begin, revs)
        for number in range(len(begin)):
            whole = self._all_usable(low[number], high[number])
            if not whole.any():
                continue
            turns, slope = self._turns(low[number], high[number], 1, begin[number], revs)
            fastest = float(slope.max()) * revs
            share = min(highest_order * fastest, HIGHEST_SHARE)
            factor = frame_factor(samples_per_frame=revs / fastest, highest_share=share, tolerance=tolerance)
            dense = None
            if factor > 1:
                # the frame's ends lie up to one sample beyond the samples within it
                first, last = low[number] - 1, high[number] + 1
                room = min(first, self.signals.shape[1] - 1 - last)
                plan = _fitting(factor, share, FOLDING_SHARE * tolerance, room)
                dense = None if plan is None else self._denser(number, first, last, begin[number], revs, plan, fastest)
            if dense is None or (whole & ~dense.usable).any() or share / fastest > dense.highest_order:
                weights = hann_of_turns(turns, slope)
                yield _Frame(number, self.signals, low[number], turns, weights, whole, HIGHEST_SHARE / fastest)
            if dense is not None:
                yield dense

    def _bounds(self, begin: Floats, revs: float) -> tuple[list[int], list[int]]:
        """First and last sample within each frame."""
        edges = np.stack([time_at(begin, **self.knots), time_at(begin + revs, **self.knots)])
        place = (edges - self.start_s) * self.rate_hz
        n_samples = self.signals.shape[1]
        if not (np.isfinite(place).all() and (place[0] > -1.0).all() and (place[1] < n_samples).all()):
            bad = int(np.argmin(np.isfinite(place).all(axis=0) & (place[0] > -1.0) & (place[1] < n_samples)))
            raise RequestError(
                "a frame lies outside the record or the known crank angle",
                found=f"{begin[bad]:g}…{begin[bad] + revs:g} rev",
            )
        low = np.maximum(np.ceil(place[0]), 0.0).astype(int).tolist()
        high = np.minimum(np.floor(place[1]), n_samples - 1.0).astype(int).tolist()
        for number, (first, last) in enumerate(zip(low, high, strict=True)):
            if last <= first:
                found = f"{begin[number]:g}…{begin[number] + revs:g} rev"
                raise RequestError("a frame holds no samples", found=found)
        return low, high

    def _all_usable(self, first: int, last: int) -> Bools:
        """Whether each channel is usable from sample ``first`` to ``last``."""
        if self.usable is None:
            return np.ones(len(self.signals), dtype=np.bool_)
        return np.asarray(self.usable[:, max(first, 0) : last + 1].all(axis=1))

    def _turns(self, first: int, last: int, factor: int, begin: float, revs: float) -> tuple[Floats, Floats]:
        """Share of the frame passed, and its change per sample, at samples ``factor`` times as dense."""
        n = (last - first) * factor + 1
        turns, slope = np.empty(n), np.empty(n)
        period = 1.0 / (self.rate_hz * factor)
        part = slice(
            max(int(np.searchsorted(self.time_s, self.start_s + first / self.rate_hz)) - 1, 0),
            int(np.searchsorted(self.time_s, self.start_s + last / self.rate_hz)) + 1,
        )
        time, angle, rate = self.time_s[part], (self.angle_rev[part] - begin) / revs, self.rev_per_s[part] / revs
        _angle_and_slope(self.start_s + first / self.rate_hz, period, time, angle, rate, turns, slope)
        return turns, slope

    def _denser(
        self, number: int, first: int, last: int, begin: float, revs: float, plan: Upsampling, fastest: float
    ) -> _Frame | None:
        """The frame with samples as dense as ``plan`` makes them; None where no channel has usable neighbours."""
        usable = self._all_usable(first - plan.reach, last + plan.reach)
        if not usable.any():
            return None
        turns, slope = self._turns(first, last, plan.factor, begin, revs)
        if np.isnan(turns[[0, -1]]).any():
            # beyond the knots, hence beyond the frame, where the weights are 0
            turns, slope = np.nan_to_num(turns, nan=-1.0), np.nan_to_num(slope)
        values, start = upsampled(self.signals, plan, first=first, last=last)
        weights = hann_of_turns(turns, slope)
        return _Frame(number, values, start, turns, weights, usable, plan.pass_share / fastest)


def _fitting(factor: int, share: float, tolerance: float, room: int) -> Upsampling | None:
    """Filters that pass ``share`` of the rate and need no more than ``room`` samples at each end, or pass less."""
    wanted = next((pass_share for pass_share in PASS_SHARES if pass_share >= share), PASS_SHARES[-1])
    for pass_share in reversed(PASS_SHARES):
        if pass_share <= wanted:
            plan = upsampling(factor, pass_share=pass_share, tolerance=tolerance)
            if plan.reach <= room:
                return plan
    return None


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _angle_and_slope(start, period, time, angle, rate, out, slope):  # type: ignore[no-untyped-def]
    """Fill in the angle at ``start`` and every ``period`` after it, and its change per period; NaN outside the knots.

    Between knots they are the cubic of :func:`crankorder.shaft.angle.angle_at` and its derivative.
    """
    n, done = out.size, 0
    while done < n and start + done * period < time[0] - KNOT_SLACK * period:
        out[done], slope[done] = np.nan, np.nan
        done += 1
    for k in range(time.size - 1):
        first = done
        low, high = time[k], time[k + 1]
        done = min(n, max(first, int(np.floor((high - start) / period + KNOT_SLACK)) + 1))
        share, rise = 1.0 / (high - low), angle[k + 1] - angle[k]
        c1, c4 = rate[k] * (high - low) / rise, rate[k + 1] * (high - low) / rise
        c2, c3 = 3.0 - 2.0 * c1 - c4, c1 + c4 - 2.0
        step = rise * share * period
        offset = (start - low) * share
        for i in range(first, done):
            x = offset + i * period * share
            out[i] = angle[k] + rise * (x * (c1 + x * (c2 + x * c3)))
            slope[i] = step * (c1 + x * (2.0 * c2 + 3.0 * x * c3))
    for i in range(done, n):
        out[i], slope[i] = np.nan, np.nan


def spectra(
    samples: TimeSamples, shaft: xr.Dataset, layout: FrameLayout, *, n_orders: int, max_order: float, density: int = 1
) -> Complexes:
    """Spectra (channels, frames, ``n_orders``) of ``samples`` by the method and on the frames of ``layout``.

    In peak amplitude, phases from crank angle 0 of ``shaft``. Where the angle is smooth, nothing folds onto an order up
    to ``max_order``; where it scatters from tooth to tooth, ``density`` times as many samples per revolution are taken.
    Frames of a channel that touch one of its gaps are NaN.
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
        kernel = kernel_for(samples, LARGEST_TOLERANCE) if layout.method.kernel is None else layout.method.kernel
        if kernel.margin > room:
            return math.nan
    low = max(0, math.floor(place[0]) - kernel.margin)
    piece = samples.signals[:, low : math.ceil(place[1]) + kernel.margin + 1].astype(np.float64)
    start_s = samples.start_s + low / samples.rate_hz
    fine = OrderMethod("resample", kernel.predicted_error, kernel.margin, samples.content, kernel)
    one = FrameLayout(fine, layout.revs, layout.hop_rev, begin)
    carried = min(max_order, samples.content * samples.rate_hz * 60.0 / float(speed_rpm[frame]))
    n_orders = min(spectrum.shape[2], math.floor(carried * layout.revs) + 1)
    alone = TimeSamples(piece, samples.rate_hz, start_s, samples.content)
    dense = spectra(alone, shaft, one, n_orders=n_orders, max_order=max_order, density=DENSER * density)[:, 0]
    found = spectrum[whole[:, frame], frame, :n_orders]
    truth = dense[whole[:, frame]]
    largest = np.maximum(np.abs(truth).max(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    return float((np.abs(found - truth) / largest).max())
