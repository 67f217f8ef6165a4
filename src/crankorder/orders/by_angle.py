"""A recording by crank angle: what angles it covers, and its values at even ones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.fft.resampling import Kernel, cheapest_kernel, kernel_named, values_at
from crankorder.shaft.angle import angle_at, knots_of, time_at

MOST_CONTENT = 0.4
"""Share of the sample rate up to which content is resampled; beyond it, kernels become long."""

CONTENT_STEP = 0.02
"""Steps of that share: kernels are designed for a few of them and then known."""


@dataclass(frozen=True)
class TimeSamples:
    """Signals (channels, samples) at ``rate_hz`` from ``start_s`` on, with content up to ``content`` of the rate.

    ``usable`` (channels, samples) is False within gaps and what filters spread of them; None where there are none.
    """

    signals: NDArray[np.floating]
    rate_hz: float
    start_s: float
    content: float
    usable: NDArray[np.bool_] | None = None

    @property
    def double(self) -> bool:
        """Whether the samples are held in double precision."""
        return self.signals.dtype.itemsize > 4


def time_samples(band: xr.Dataset, *, tolerance: float) -> TimeSamples:
    """Samples of the BandRecording ``band``, which is by time, in a precision that allows for ``tolerance``."""
    rate = float(band.attrs["rate_hz"])
    share = min(float(band.attrs.get("band_hz", math.inf)) / rate, MOST_CONTENT)
    content = min(math.ceil(share / CONTENT_STEP - 1e-9) * CONTENT_STEP, MOST_CONTENT)
    signals = band["signal"].values
    if signals.dtype.itemsize == 4 and _single_of(content, tolerance) is None:
        signals = signals.astype(np.float64)
    usable = band["usable"].values if "usable" in band else None
    return TimeSamples(signals, rate, float(band.attrs.get("start_s", 0.0)), content, usable)


class SignalsByAngle(NamedTuple):
    """Signals (channels, samples) at even crank angles (samples,) in rev, and what the resampling may err by.

    ``usable`` (channels, samples) is False where a gap of the recording reaches; None where there is none.
    """

    signals: NDArray[np.floating]
    angle_rev: NDArray[np.float64]
    samples_per_rev: int
    usable: NDArray[np.bool_] | None
    predicted_error: float


def is_by_angle(band: xr.Dataset) -> bool:
    """Whether ``band`` was sampled by crank angle already."""
    return bool(band.attrs["domain"] == "crank_angle")


def kernel_for(samples: TimeSamples, tolerance: float) -> Kernel:
    """Cheapest resampling kernel that errs by less than ``tolerance`` up to the highest content of ``samples``.

    It leaves no images of what lies above, and is as long in single as in double precision, so that frames begin at
    the same angle. Raises RequestError where there is none.
    """
    single = None if samples.double else _single_of(samples.content, tolerance)
    return single or cheapest_kernel(tolerance, content=samples.content)


def _single_of(content: float, tolerance: float) -> Kernel | None:
    """The kernel for ``content`` in single precision; None where that is too coarse for ``tolerance``."""
    try:
        double = cheapest_kernel(tolerance, content=content)
    except RequestError:
        return None
    single = kernel_named(double.name, pass_band=double.pass_band, double=False)
    return single if single.predicted_error <= tolerance else None


def covered_angles(samples: TimeSamples, shaft: xr.Dataset, *, margin: int) -> tuple[float, float]:
    """First and last crank angle [rev] that ``samples`` and ``shaft`` both know, ``margin`` samples from the ends.

    Both are 0 where nothing is covered.
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
    samples: TimeSamples, shaft: xr.Dataset, angle_rev: NDArray[np.float64], kernel: Kernel
) -> tuple[NDArray[np.floating], NDArray[np.bool_] | None]:
    """Values (channels, angles) of ``samples`` at ``angle_rev`` (angles,) of ``shaft`` by ``kernel``; which are usable.

    The second is None where ``samples`` have no gap.
    """
    positions = (time_at(angle_rev, **knots_of(shaft)) - samples.start_s) * samples.rate_hz
    values = values_at(samples.signals, positions, kernel=kernel)
    if samples.usable is None:
        return values, None
    return values, ~touches_gap(samples.usable, positions - kernel.margin, positions + kernel.margin)


def touches_gap(usable: NDArray[np.bool_], begin: NDArray[Any], end: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether (channels, spans) a sample from ``begin`` to ``end`` (spans,) is not ``usable`` (channels, samples)."""
    before = np.zeros((len(usable), usable.shape[1] + 1), dtype=np.int64)
    np.cumsum(~usable, axis=1, out=before[:, 1:])
    low = np.clip(np.floor(begin).astype(np.int64), 0, usable.shape[1])
    high = np.clip(np.ceil(end).astype(np.int64) + 1, 0, usable.shape[1])
    return np.asarray(before[:, high] > before[:, low])


def samples_per_rev_for(samples: TimeSamples, kernel: Kernel, *, slowest_hz: float, max_order: float) -> int:
    """Samples per revolution such that nothing in ``samples`` folds onto an order up to ``max_order``.

    A ``kernel`` lets pass what lies below its pass band (a share of the rate) and has faded out the image of that by
    1 - the pass band; ``slowest_hz`` is the lowest rotational frequency. The number is fast to transform.
    """
    images_from = (1.0 - min(kernel.pass_band, 0.5)) * samples.rate_hz / slowest_hz
    least = math.ceil(max(images_from + max_order, 2.0 * max_order)) + 2
    while not _is_smooth(least):
        least += 1
    return least


def _is_smooth(number: int) -> bool:
    for prime in (2, 3, 5):
        while number % prime == 0:
            number //= prime
    return number == 1


def rev_frequencies(shaft: xr.Dataset, edges_rev: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean rotational frequencies [Hz] of ``shaft`` between the crank angles ``edges_rev``: one fewer than these."""
    elapsed = np.diff(time_at(edges_rev, **knots_of(shaft)))
    return np.asarray(np.diff(edges_rev) / np.maximum(elapsed, 1e-12))


def signals_by_angle(band: xr.Dataset, shaft: xr.Dataset, *, max_order: float, tolerance: float) -> SignalsByAngle:
    """The whole of ``band`` at even crank angles of ``shaft``, whose whole revolutions are samples.

    ``max_order`` is the highest order onto which nothing may fold, ``tolerance`` the relative amplitude error that
    resampling may add. A recording by crank angle is given as it is.
    """
    if is_by_angle(band):
        samples_per_rev = int(band.attrs["samples_per_rev"])
        angle = float(shaft["crank_angle"].values[0]) + np.arange(band["signal"].shape[1]) / samples_per_rev
        usable = band["usable"].values if "usable" in band else None
        return SignalsByAngle(band["signal"].values, angle, samples_per_rev, usable, 0.0)
    samples = time_samples(band, tolerance=tolerance)
    kernel = kernel_for(samples, tolerance)
    first, last = covered_angles(samples, shaft, margin=kernel.margin)
    if last <= first:
        return SignalsByAngle(samples.signals[:, :0], np.empty(0), 1, None, kernel.predicted_error)
    slowest_hz = float(rev_frequencies(shaft, np.append(np.arange(first, last), last)).min())
    samples_per_rev = samples_per_rev_for(samples, kernel, slowest_hz=slowest_hz, max_order=max_order)
    angle = np.arange(math.ceil(first * samples_per_rev), math.floor(last * samples_per_rev) + 1) / samples_per_rev
    values, usable = signals_at(samples, shaft, angle, kernel)
    return SignalsByAngle(values, angle, samples_per_rev, usable, kernel.predicted_error)
