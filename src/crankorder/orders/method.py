"""How a recording becomes order spectra: its values by crank angle, by the cheapest kernel within the tolerance."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from crankorder.errors import InputError, RequestError
from crankorder.fft.resampling import Kernel, cheapest_kernel, kernel_of, values_at
from crankorder.fft.transforms import counted
from crankorder.quantities import Bools, Floats
from crankorder.scratch import BLOCK_SAMPLES
from crankorder.settings import OrderSettings
from crankorder.shaft.angle import ROUNDING_REV, SpeedCourse, angle_at, knots_of, time_at

MOST_CONTENT = 0.4
"""Share of the sample rate up to which content is resampled; beyond it, kernels become long."""

CONTENT_STEP = 0.02
"""Steps of that share: kernels are designed for a few of them and then known."""

METHOD_SHARE = 0.5
"""Share of the tolerance that is left to the method; the other half is the filter's that comes before it."""

MOST_SWEPT = 0.03
"""Change of speed within a frame, as a share, above which frames are halved: the half-power width of 1.5 % damping."""

WANDERS = 0.1
"""Range of the speed over its mean up to which a recording wanders, which frames need not follow."""

FEWEST_REVS = 4
"""Revolutions of a frame below which half orders fall into one main lobe of a Hann window."""

SWEPT_OVERLAP = 0.75
"""Overlap of shortened frames: a resonance is soon passed."""

SLOWEST_SHARE = 0.25
"""Least speed in a frame over its mean below which the shaft is said to stand in it."""

MOST_CHANGED, UNUSUAL_RATE = 0.3, 3.0
"""Range of the speed in a frame over its mean, where it also changes so many times as fast as in most frames, from
which the frame stands for no speed: a step."""


class TimeSamples(NamedTuple):
    """``signals`` (channels, samples) at ``rate_hz`` from ``start_s`` on; ``content`` is the share of the rate in use.

    ``usable`` (channels, samples) is False within gaps and what filters spread of them; None where there are none.
    """

    signals: NDArray[np.floating]
    rate_hz: float
    start_s: float
    content: float
    usable: Bools | None = None

    def continued(self, count: int) -> TimeSamples:
        """These samples and ``count`` more at both ends, mirrored at the first and the last: bends join smoothly."""
        if not count:
            return self
        ends = ((0, 0), (count, count))
        signals = np.pad(self.signals, ends, mode="reflect", reflect_type="odd")
        usable = None if self.usable is None else np.pad(self.usable, ends, mode="reflect")
        return self._replace(signals=signals, usable=usable, start_s=self.start_s - count / self.rate_hz)


def time_samples(band: xr.Dataset, *, tolerance: float) -> TimeSamples:
    """Samples (channels, samples) of the BandRecording ``band`` by time, in single precision where that is enough.

    ``tolerance`` is the relative amplitude error, above 0, that resampling them may add.
    """
    rate = float(band.attrs["rate_hz"])
    share = min(float(band.attrs.get("band_hz", math.inf)) / rate, MOST_CONTENT)
    content = min(math.ceil(share / CONTENT_STEP - 1e-9) * CONTENT_STEP, MOST_CONTENT)
    signals = band["signal"].values
    if signals.dtype.itemsize == 4 and _single_of(content, tolerance) is None:
        signals = signals.astype(np.float64)
    usable = band["usable"].values if "usable" in band else None
    return TimeSamples(signals, rate, float(band.attrs.get("start_s", 0.0)), content, usable)


class SignalsByAngle(NamedTuple):
    """``signals`` (channels, samples) at even crank angles ``angle_rev`` (samples,), rev.

    ``usable`` (channels, samples) is False where a gap of the recording reaches; None where there is none.
    """

    signals: NDArray[np.floating]
    angle_rev: Floats
    samples_per_rev: int
    usable: Bools | None


def is_by_angle(band: xr.Dataset) -> bool:
    """Whether the BandRecording ``band`` is (channel, crank_angle), not (channel, time)."""
    return bool(band.attrs["domain"] == "crank_angle")


def less_than_a_cycle(band: xr.Dataset, revs: float, revs_per_cycle: int) -> InputError:
    """The error of a BandRecording ``band`` (channel, time or crank_angle) of ``revs`` (under ``revs_per_cycle``)."""
    problem, found = "the recording holds less than one engine cycle", f"{revs:.2f} revolutions"
    return InputError(problem, file=band.attrs["recording"], found=found, allowed=f"at least {revs_per_cycle}")


def kernel_for(samples: TimeSamples, tolerance: float) -> Kernel:
    """Cheapest resampling kernel that errs by less than ``tolerance`` up to the highest content of ``samples``.

    It leaves no images of what lies above, and is as long in single as in double precision, so that frames begin at
    the same angle. Raises RequestError where there is none.
    """
    double = samples.signals.dtype.itemsize > 4
    single = None if double else _single_of(samples.content, tolerance)
    return single or cheapest_kernel(tolerance, content=samples.content)


def _single_of(content: float, tolerance: float) -> Kernel | None:
    """The kernel for ``content`` in single precision; None where that is too coarse for ``tolerance``."""
    try:
        double = cheapest_kernel(tolerance, content=content)
    except RequestError:
        return None
    single = kernel_of(double.taps, pass_band=double.pass_band, double=False)
    return single if single.predicted_error <= tolerance else None


def covered_angles(samples: TimeSamples, shaft: xr.Dataset, *, margin: int) -> tuple[float, float]:
    """First and last crank angle [rev] that ``samples`` and the ShaftAngle ``shaft`` (time) both know.

    ``margin`` is how many samples at each end of ``samples`` are left out. Both are 0 where nothing is covered.
    """
    n_samples = samples.signals.shape[1]
    if n_samples <= 2 * margin + 1:
        return 0.0, 0.0
    knots = knots_of(shaft)
    inside = samples.start_s + np.array([margin, n_samples - 1 - margin]) / samples.rate_hz
    first, last = angle_at(np.clip(inside, knots["knot_time_s"][0], knots["knot_time_s"][-1]), **knots)
    # rounding must not lead out of the knots
    return max(float(first), float(knots["knot_angle_rev"][0])), min(float(last), float(knots["knot_angle_rev"][-1]))


def signals_at(
    samples: TimeSamples, shaft: xr.Dataset, angle_rev: Floats, kernel: Kernel
) -> tuple[NDArray[np.floating], Bools | None]:
    """Values (channels, angles) of ``samples`` at the crank angles ``angle_rev`` (angles,), and which are usable.

    ``shaft`` is the ShaftAngle, ``kernel`` resamples. The second result (channels, angles) is False where a gap
    reaches; it is None where ``samples`` have no gap.
    """
    parts = np.array_split(angle_rev, 1 + len(angle_rev) // BLOCK_SAMPLES)
    positions = np.concatenate([time_at(part, **knots_of(shaft)) for part in parts])
    positions = (positions - samples.start_s) * samples.rate_hz
    values = values_at(samples.signals, positions, kernel=kernel)
    if samples.usable is None:
        return values, None
    first, last = np.floor(positions - kernel.margin), np.ceil(positions + kernel.margin)
    return values, counted(~samples.usable, first, last + 1) == 0


def samples_per_rev_for(samples: TimeSamples, kernel: Kernel, *, slowest_hz: float, max_order: float) -> int:
    """Samples per revolution such that nothing in ``samples`` folds onto an order up to ``max_order``.

    A ``kernel`` lets pass what lies below its pass band (a share of the rate) and has faded out the image of that by
    1 - the pass band; ``slowest_hz`` is the lowest rotational frequency. The number is fast to transform.
    """
    images_from = (1.0 - min(kernel.pass_band, 0.5)) * samples.rate_hz / slowest_hz
    return int(next_fast_len(math.ceil(max(images_from + max_order, 2.0 * max_order)) + 2, real=True))


def rev_frequencies(shaft: xr.Dataset, edges_rev: Floats) -> Floats:
    """Mean rotational frequencies [Hz] (edges - 1,) of the ShaftAngle ``shaft`` between neighbouring ``edges_rev``.

    ``edges_rev`` (edges,) are rising crank angles, rev.
    """
    elapsed = np.diff(time_at(edges_rev, **knots_of(shaft)))
    return np.asarray(np.diff(edges_rev) / np.maximum(elapsed, 1e-12))


def signals_by_angle(band: xr.Dataset, shaft: xr.Dataset, *, max_order: float, tolerance: float) -> SignalsByAngle:
    """The whole of ``band`` (channels, samples) at even crank angles; each whole revolution begins at a sample.

    ``band`` is the BandRecording, ``shaft`` its ShaftAngle, ``max_order`` the highest order onto which nothing may
    fold, ``tolerance`` the relative amplitude error that resampling may add. A recording by crank angle is returned as
    it is. Raises RequestError where no kernel meets ``tolerance`` (:func:`kernel_for`).
    """
    if is_by_angle(band):
        samples_per_rev = int(band.attrs["samples_per_rev"])
        angle = float(shaft["crank_angle"].values[0]) + np.arange(band["signal"].shape[1]) / samples_per_rev
        usable = band["usable"].values if "usable" in band else None
        return SignalsByAngle(band["signal"].values, angle, samples_per_rev, usable)
    samples = time_samples(band, tolerance=tolerance)
    kernel = kernel_for(samples, tolerance)
    first, last = covered_angles(samples, shaft, margin=kernel.margin)
    if last <= first:
        return SignalsByAngle(samples.signals[:, :0], np.empty(0), 1, None)
    slowest_hz = float(rev_frequencies(shaft, np.append(np.arange(first, last), last)).min())
    samples_per_rev = samples_per_rev_for(samples, kernel, slowest_hz=slowest_hz, max_order=max_order)
    angle = np.arange(math.ceil(first * samples_per_rev), math.floor(last * samples_per_rev) + 1) / samples_per_rev
    values, usable = signals_at(samples, shaft, angle, kernel)
    return SignalsByAngle(values, angle, samples_per_rev, usable)


class FrameLayout(NamedTuple):
    """Where the frames of a recording lie: each ``revs`` long, beginning at ``begin_rev`` (frames,), in rev.

    ``kernel`` resamples them, None where they are taken as sampled; ``highest`` is the share of the sample rate up to
    which orders are carried, ``max_order`` the highest that is wanted. Frames are ``hop_rev`` apart, or further where
    some were left out that stand for no speed (``left_out``, how many); ``shortened`` says whether the sweep asked for
    less than the settings, ``beyond`` by how many samples a recording must be continued at both ends to hold them.
    """

    kernel: Kernel | None
    highest: float
    max_order: float
    revs: int
    hop_rev: int
    begin_rev: Floats
    shortened: bool = False
    left_out: int = 0
    beyond: int = 0

    @property
    def n_orders(self) -> int:
        """Bins of a spectrum from order 0 to the highest that is wanted."""
        return math.floor(self.max_order * self.revs) + 1


def swept_revs(course: SpeedCourse, *, settings: OrderSettings, revs_per_cycle: int) -> int:
    """Length in revolutions of the frames of a recording with the SpeedCourse ``course``.

    It is that of ``settings``, in whole cycles of ``revs_per_cycle``, halved until the relative change of the speed
    within a frame is at most :data:`MOST_SWEPT` half of the time, but never too short to separate half orders.
    """
    revs = max(1, settings.revs_per_frame // revs_per_cycle) * revs_per_cycle
    speed, rate = course.speed_rpm[course.runs], course.rate_rpm_per_s[course.runs]
    if not len(speed) or np.ptp(speed) < WANDERS * float(speed.mean()):
        return revs
    per_rev = float(np.median(60.0 * rate / speed**2))
    while revs * per_rev > MOST_SWEPT and revs % (2 * revs_per_cycle) == 0 and revs // 2 >= FEWEST_REVS:
        revs //= 2
    return revs


def frame_layout(
    band: xr.Dataset, shaft: xr.Dataset, *, settings: OrderSettings, course: SpeedCourse | None = None
) -> FrameLayout:
    """Frames (frames,) of whole cycles that ``band`` and ``shaft`` hold, and the kernel within ``settings.tolerance``.

    ``band`` is the BandRecording, ``shaft`` its ShaftAngle. Where a ``course`` of the speed is given, frames are as
    short as its sweep asks for (:func:`swept_revs`) and, if that is shorter than the settings ask for, a quarter of
    their length apart; frames that stand for no speed are left out. Where the margin of the kernel would cost a
    recording of few revolutions a cycle, it is continued beyond its ends, on which a Hann window puts next to no
    weight.

    Raises InputError where not even one cycle was recorded, RequestError where no kernel meets the tolerance.
    """
    cycle = int(shaft.attrs["revs_per_cycle"])
    asked = max(1, settings.revs_per_frame // cycle) * cycle
    wanted = asked if course is None else swept_revs(course, settings=settings, revs_per_cycle=cycle)

    kernel: Kernel | None
    if is_by_angle(band):
        kernel, highest, first = None, 0.5, float(shaft["crank_angle"].values[0])
        ends = inner = first, first + band["signal"].shape[1] / int(band.attrs["samples_per_rev"])
    else:
        samples = time_samples(band, tolerance=METHOD_SHARE * settings.tolerance)
        kernel = kernel_for(samples, METHOD_SHARE * settings.tolerance)
        highest = samples.content
        ends, inner = (covered_angles(samples, shaft, margin=margin) for margin in (0, kernel.margin))
    held = [math.floor(last - first + ROUNDING_REV) // cycle * cycle for first, last in (ends, inner)]
    revs, beyond = min(wanted, held[0]), 0
    first, last = inner
    if revs > held[1]:
        assert kernel is not None
        (first, last), beyond = ends, kernel.margin
    if revs == 0:
        raise less_than_a_cycle(band, ends[1] - ends[0], cycle)
    overlap = settings.overlap if wanted == asked else max(settings.overlap, SWEPT_OVERLAP)
    hop = max(1, round(revs * (1.0 - overlap)))
    count = math.floor((last - first - revs + ROUNDING_REV) / hop) + 1
    begin = first + hop * np.arange(count, dtype=np.float64)
    turning = np.ones(count, dtype=bool) if course is None else _turning(begin, revs, shaft, course)
    left_out = int(count - turning.sum())
    parts = (settings.max_order, revs, hop, begin[turning], wanted < asked, left_out, beyond)
    return FrameLayout(kernel, highest, *parts)


def _turning(begin_rev: Floats, revs: int, shaft: xr.Dataset, course: SpeedCourse) -> Bools:
    """Whether the shaft turns throughout each frame, and its speed changes little or as fast as mostly; or all."""
    knots = knots_of(shaft)
    times = np.array([time_at(begin_rev, **knots), time_at(begin_rev + revs, **knots)])
    mean = 60.0 * revs / np.diff(times, axis=0)[0]
    first, last = np.searchsorted(course.time_s, times)
    ends_rpm = np.interp(times, course.time_s, course.speed_rpm).T
    within = [np.append(course.speed_rpm[a:b], rpm) for a, b, rpm in zip(first, last, ends_rpm, strict=True)]
    slowest, fastest = (np.array([end(part) for part in within], dtype=np.float64) for end in (np.min, np.max))
    rate = (fastest - slowest) / np.diff(times, axis=0)[0]
    steps = (fastest - slowest > MOST_CHANGED * mean) & (rate > UNUSUAL_RATE * float(np.median(rate)))
    turning = (slowest >= SLOWEST_SHARE * mean) & ~steps
    return turning if turning.any() else np.ones(len(begin_rev), dtype=bool)
