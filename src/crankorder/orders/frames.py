"""Order frames: whole engine cycles of a recording, transformed by crank angle."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import InputError
from crankorder.fft.decimation import band_limited, decimation_factor
from crankorder.fft.resampling import cheapest_kernel
from crankorder.fft.transforms import FrameTransform, whole_frames
from crankorder.fft.windows import hann
from crankorder.orders.method import (
    METHOD_SHARE,
    FrameLayout,
    TimeSamples,
    frame_layout,
    is_by_angle,
    rev_frequencies,
    samples_per_rev_for,
    signals_at,
    swept_revs,
    time_samples,
)
from crankorder.orders.true_angle import stated_errors
from crankorder.quantities import (
    Bools,
    Complexes,
    Floats,
    QualityFlag,
    channel_coords,
    described,
    flags_of,
    remark,
    unindexed,
    with_flags,
)
from crankorder.settings import LEAST_TOLERANCE, OrderSettings
from crankorder.shaft.angle import SpeedCourse, knots_of, speed_at_angle, speed_course, time_at

SWEPT_SHARE = 0.1
"""Change of speed within a frame, as a share, from which it is told: a resonance of 5 % damping is as wide."""

LEAST_FACTOR = 4
"""Factor from which on a band is decimated for its orders: a smaller one saves less than the ends that it costs."""

STEADY_SHARE = 0.02
"""Share of the mean speed by which that of frames may wander in steady running."""

CHUNK_SAMPLES = 1 << 19
"""Samples by angle that are held at a time: the memory does not grow with the recording."""

CHUNK_SPEED_RATIO = 1.3
"""Frames whose speeds differ by more are sampled at different angles: the slowest sets the samples per revolution."""

DENSER = 4
"""Factor by which a frame is sampled more densely to judge it, and all frames where that shows an error."""


def band_of_orders(band: xr.Dataset, shaft: xr.Dataset, *, settings: OrderSettings) -> xr.Dataset:
    """BandRecording ``band`` (channel, time) limited to the orders that ``settings`` ask for, where others need more.

    The highest speed of the ShaftAngle ``shaft`` counts. ``band`` is returned as it is where it is by crank angle, was
    decimated before (two filters in a row would err by more than ``settings`` allow) or would hardly get shorter.
    """
    needed_hz = settings.max_order * float(np.nan_to_num(shaft["speed"].values).max()) / 60.0
    taken = is_by_angle(band) or band.attrs.get("decimation_error") or not needed_hz > 0.0
    if taken or decimation_factor(float(band.attrs["rate_hz"]), needed_hz, grid_hz=1.0) < LEAST_FACTOR:
        return band
    return band_limited(band, band_hz=needed_hz, grid_hz=1.0, tolerance=(1.0 - METHOD_SHARE) * settings.tolerance)


def order_frames(band: xr.Dataset, shaft: xr.Dataset, *, settings: OrderSettings) -> xr.Dataset:
    """OrderFrames of one recording: complex spectra (channel, frame, order), phases from top dead centre.

    ``band`` is the BandRecording, by time or by crank angle; ``shaft`` its ShaftAngle. A frame holds
    ``settings.revs_per_frame`` rounded down to whole cycles, fewer (flagged) where the recording is shorter. Orders
    that the sample rate cannot carry at a frame's speed, and frames of a channel that touch one of its gaps, are NaN.
    The method is chosen by ``settings.tolerance``. The error that its filters and kernels predict stands beside it
    (``predicted_error``) and that of the fastest frame beside a far denser sampling of it (``achieved_error``): where
    the angle scatters from tooth to tooth and the latter misses the tolerance, all frames are sampled more densely.
    A recording of a structure that does not turn gives one frame of unknown speed, all NaN. Raises InputError where not
    even one cycle was recorded, RequestError where no kernel meets the tolerance.
    """
    if not shaft.attrs.get("has_shaft", 1):
        return _no_orders(band, shaft, settings)
    course = None if is_by_angle(band) else speed_course(shaft)
    layout = frame_layout(band, shaft, settings=settings, course=course)
    speed = _mean_speed(shaft, layout)
    known = speed[np.isfinite(speed)]
    swept = len(known) > 1 and bool(np.ptp(known) > max(settings.speed_bin_rpm, STEADY_SHARE * float(known.mean())))
    if swept:
        # the mean over the time lags behind the speed in the middle, where the window weighs most
        speed = speed_at_angle(shaft, layout.begin_rev + 0.5 * layout.revs, float(layout.revs))
    if is_by_angle(band):
        usable = band["usable"].values if "usable" in band else None
        per_rev = int(band.attrs["samples_per_rev"])
        spectrum = spectra_by_angle(band["signal"].values, usable, per_rev, layout)
        density, achieved, limit = 1, 0.0, np.full(len(speed), 0.5 * per_rev)
    else:
        samples = time_samples(band, tolerance=METHOD_SHARE * settings.tolerance).continued(layout.beyond)
        for density in (1, DENSER):
            spectrum = spectra(samples, shaft, layout, density=density)
            achieved = achieved_error(samples, shaft, layout, spectrum, speed_rpm=speed, density=density)
            if not achieved > settings.tolerance:
                break
        limit = layout.highest * samples.rate_hz * 60.0 / speed
    if "usable" in band and band["usable"].values.any() and np.isnan(spectrum.real).all():
        raise _no_whole_frame(band, layout, speed)
    order = np.arange(spectrum.shape[2]) / layout.revs
    spectrum[:, order[None, :] > limit[:, None] * (1.0 + 1e-9)] = np.nan
    frames = _dataset(band, shaft, layout, spectrum, speed, density)
    predicted = layout.kernel.predicted_error if layout.kernel else 0.0
    frames.attrs |= {
        "largest_sweep": _largest_sweep(shaft, layout, speed),
        "swept": int(swept),
        "frame_length_by": "sweep" if layout.shortened else "settings",
        "tolerance": settings.tolerance,
        "predicted_error": predicted + float(band.attrs.get("decimation_error", 0.0)),
        "achieved_error": achieved,
        **stated_errors(shaft, revs_per_frame=float(layout.revs)),
    }
    return with_flags(frames, [*flags_of(shaft), *_flags(frames, layout, settings, course)])


def _no_whole_frame(band: xr.Dataset, layout: FrameLayout, speed_rpm: Floats) -> InputError:
    """The error of a recording all of whose frames touch a gap, with the revolutions of its longest stretch."""
    edges = np.flatnonzero(np.diff(band["usable"].values.any(axis=0), prepend=False, append=False))
    attrs = band.attrs
    rate = attrs["samples_per_rev"] if is_by_angle(band) else attrs["rate_hz"] * 60.0 / np.nanmedian(speed_rpm)
    revs = float(np.diff(edges)[::2].max(initial=0) / rate)
    problem = "each frame touches a gap, so that no order is told"
    found = f"frames of {layout.revs} revolutions, up to {revs:.3g} between gaps"
    remedy = f"State [orders] revs_per_frame = {max(2, 2 * int(revs / 4.0))} in a recipe, or close the gaps"
    return InputError(problem, place="orders.revs_per_frame", found=found, remedy=remedy)


def _no_orders(band: xr.Dataset, shaft: xr.Dataset, settings: OrderSettings) -> xr.Dataset:
    """OrderFrames of a recording without a shaft: one frame in which nothing is known."""
    layout = FrameLayout(None, 0.0, settings.max_order, settings.revs_per_frame, 1, np.zeros(1))
    shape = (band.sizes["channel"], 1, layout.n_orders)
    frames = _dataset(band, shaft, layout, np.full(shape, np.nan, dtype=np.complex128), np.full(1, np.nan))
    errors = {"largest_sweep": 0.0, "tolerance": settings.tolerance, "predicted_error": 0.0, "achieved_error": 0.0}
    frames.attrs |= errors
    return with_flags(frames, flags_of(shaft))


def _mean_speed(shaft: xr.Dataset, layout: FrameLayout) -> Floats:
    """Mean speed in rpm of each frame: revolutions over elapsed time."""
    begin = layout.begin_rev
    if shaft.attrs.get("domain", "time") == "crank_angle":
        return np.full(len(begin), float(shaft["speed"].values.mean()))
    knots = knots_of(shaft)
    elapsed = time_at(begin + layout.revs, **knots) - time_at(begin, **knots)
    return np.asarray(60.0 * layout.revs / elapsed)


def _largest_sweep(shaft: xr.Dataset, layout: FrameLayout, speed_rpm: Floats) -> float:
    """Largest change of speed from the first to the last revolution of a frame, as a share of its mean speed."""
    if shaft.attrs.get("domain", "time") == "crank_angle" or layout.revs < 2:
        return 0.0
    knots = knots_of(shaft)
    ends = layout.begin_rev + layout.revs
    first = time_at(layout.begin_rev + 1.0, **knots) - time_at(layout.begin_rev, **knots)
    last = time_at(ends, **knots) - time_at(ends - 1.0, **knots)
    return float((60.0 * np.abs(1.0 / last - 1.0 / first) / speed_rpm).max())


def _dataset(
    band: xr.Dataset, shaft: xr.Dataset, layout: FrameLayout, spectrum: Complexes, speed: Floats, density: int = 1
) -> xr.Dataset:
    """OrderFrames with the attributes that all recordings have; phases and frames are those of ``layout``."""
    kept = {key: band.attrs[key] for key in ("recording", "history", "quality", "samples_per_rev") if key in band.attrs}
    kernel, order = layout.kernel, np.arange(spectrum.shape[2]) / layout.revs
    dense = f", {density} times as dense" if density > 1 else ""
    method = "as sampled" if is_by_angle(band) else "no shaft" if kernel is None else f"resample ({kernel.name}{dense})"
    window = hann(layout.revs * 16)  # a Hann window's noise bandwidth is that of any length
    attrs = {
        "amplitude_scaling": "peak",
        **{key: shaft.attrs[key] for key in ("phase_reference", "cycle_known", "revs_per_cycle")},
        "window": window.name,
        "enbw_bins": window.enbw_bins,
        "revs_per_frame": layout.revs,
        "overlap": 1.0 - layout.hop_rev / layout.revs,
        "method": method,
    }
    dims, text = ("channel", "frame", "order"), "complex peak amplitude by order"
    variables = {"spectrum": described(dims, spectrum, "see unit", text)}
    axes = {"order": ("order", order, {"units": "1", "long_name": "order", "order_reference": "crankshaft"})}
    rows = {"speed": described("frame", speed, "min-1", "mean speed of the frame")}
    rows["crank_angle"] = described("frame", layout.begin_rev, "rev", "crank angle at the start")
    return xr.Dataset(variables, coords=unindexed(**channel_coords(band), **axes, **rows), attrs=kept | attrs)


def _flags(
    frames: xr.Dataset, layout: FrameLayout, settings: OrderSettings, course: SpeedCourse | None
) -> list[QualityFlag]:
    remarks = []
    recording = str(frames.attrs["recording"])
    cycle = int(frames.attrs["revs_per_cycle"])
    wanted = settings.revs_per_frame // cycle * cycle
    if layout.shortened:
        assert course is not None
        wanted = swept_revs(course, settings=settings, revs_per_cycle=cycle)
        rate = float(np.median(course.rate_rpm_per_s[course.runs]))
        detail = f"the speed changes by {rate:.3g} rpm/s: frames of {wanted} instead of {settings.revs_per_frame}"
        remarks.append(("frames_shortened", f"{detail} revolutions"))
    if layout.left_out:
        detail = f"{layout.left_out} of {layout.left_out + len(layout.begin_rev)} frames in which the shaft stands, or"
        remarks.append(("frames_left_out", f"{detail} starts, stops or steps, stand for no speed"))
    if layout.revs < wanted:
        detail = f"frames of {layout.revs} instead of {settings.revs_per_frame} revolutions"
        remarks.append(("short_recording", detail))
    if frames.attrs["achieved_error"] > settings.tolerance:
        achieved = f"{frames.attrs['achieved_error']:.1e}"
        detail = f"{frames.attrs['method']}: {achieved} of amplitude, asked {settings.tolerance:g}"
        remarks.append(("tolerance_missed", detail))
    if frames.attrs["largest_sweep"] > SWEPT_SHARE:
        sweep = f"{frames.attrs['largest_sweep']:.0%}"
        detail = (
            f"within frames of {layout.revs} revolutions the speed changes by up to {sweep}: amplitudes are means over "
            'that; through sharp resonances read tracks, whose orders are followed (track_method = "auto")'
        )
        remarks.append(("frames_swept", detail))
    return [remark(recording, name, detail) for name, detail in remarks]


def spectra(samples: TimeSamples, shaft: xr.Dataset, layout: FrameLayout, *, density: int = 1) -> Complexes:
    """Spectra (channels, frames, orders) of ``samples`` by the kernel and on the frames of ``layout``.

    They are in peak amplitude, with phases from crank angle 0 of the ShaftAngle ``shaft``. Where the angle is smooth,
    nothing folds onto a wanted order; where it scatters from tooth to tooth, ``density`` times as many samples per
    revolution are taken. Frames of a channel that touch one of its gaps are NaN.
    """
    spectrum = np.empty((len(samples.signals), len(layout.begin_rev), layout.n_orders), dtype=np.complex128)
    kernel = layout.kernel
    assert kernel is not None
    for chunk, slowest_hz in _chunks(samples, shaft, layout, CHUNK_SAMPLES // density):
        per_rev = density * samples_per_rev_for(samples, kernel, slowest_hz=slowest_hz, max_order=layout.max_order)
        part = layout._replace(begin_rev=layout.begin_rev[chunk])
        begin = part.begin_rev
        angle = begin[0] + np.arange(round((begin[-1] - begin[0] + layout.revs) * per_rev)) / per_rev
        values, usable = signals_at(samples, shaft, angle, kernel)
        spectrum[:, chunk] = spectra_by_angle(values, usable, per_rev, part)
    return spectrum


def spectra_by_angle(
    signals: NDArray[np.floating], usable: Bools | None, samples_per_rev: int, layout: FrameLayout
) -> Complexes:
    """Spectra (channels, frames, orders) of ``signals`` at even crank angles on the frames of ``layout``.

    ``signals`` (channels, samples) begin with the first frame and have ``samples_per_rev``; ``usable`` (channels,
    samples) is False in gaps, None where there are none.
    """
    starts = np.arange(len(layout.begin_rev), dtype=np.int64) * layout.hop_rev * samples_per_rev
    length = layout.revs * samples_per_rev
    made = FrameTransform(hann(length), n_bins=layout.n_orders).spectra(signals, starts)
    turn = np.exp(-2j * np.pi * (np.outer(layout.begin_rev, np.arange(made.shape[2]) / layout.revs) % 1.0))
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
    density: int = 1,
) -> float:
    """Largest error of the fastest frame of ``spectrum`` (channels, frames, orders), over its largest amplitude.

    The truth is the same frame of the same ``samples`` and ``shaft``, resampled four times as densely as with
    ``density`` and by a kernel without an error of its own where the recording has the neighbours that it takes.
    ``layout`` says where the frames lie, ``speed_rpm`` (frames,) are their speeds; orders beyond the content of the
    samples do not count. NaN where no frame is whole, or where the recording has no neighbours to compare with.
    """
    whole = np.isfinite(spectrum[:, :, 0])
    if not whole.any():
        return math.nan
    frame = int(np.argmax(np.where(whole.any(axis=0), speed_rpm, -np.inf)))
    one = layout._replace(begin_rev=layout.begin_rev[frame : frame + 1])
    ends = np.append(one.begin_rev, one.begin_rev + layout.revs)
    place = (time_at(ends, **knots_of(shaft)) - samples.start_s) * samples.rate_hz
    room = min(place[0], samples.signals.shape[1] - 1 - place[1])
    kernel = cheapest_kernel(LEAST_TOLERANCE, content=samples.content)
    if kernel.margin > room:
        assert layout.kernel is not None
        kernel = layout.kernel
    low = max(0, math.floor(place[0]) - kernel.margin)
    piece = samples.signals[:, low : math.ceil(place[1]) + kernel.margin + 1].astype(np.float64)
    alone = TimeSamples(piece, samples.rate_hz, samples.start_s + low / samples.rate_hz, samples.content)
    dense = spectra(alone, shaft, one._replace(kernel=kernel), density=DENSER * density)
    carried = slice(math.floor(samples.content * samples.rate_hz * 60.0 / float(speed_rpm[frame]) * layout.revs) + 1)
    found, truth = spectrum[whole[:, frame], frame, carried], dense[whole[:, frame], 0, carried]
    largest = np.maximum(np.abs(truth).max(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    return float((np.abs(found - truth) / largest).max())
