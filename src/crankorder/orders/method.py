"""How a recording becomes order spectra: the cheapest method that meets the tolerance asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import InputError, RequestError
from crankorder.fft.resampling import Kernel
from crankorder.orders.by_angle import TimeSamples, covered_angles, is_by_angle, kernel_for, time_samples
from crankorder.settings import LEAST_TOLERANCE, OrderSettings

MOST_CARRIED = 0.49
"""Share of the sample rate up to which a transform straight from the samples is trusted."""

METHOD_SHARE = 0.5
"""Share of the tolerance that is left to the method; the other half is the filter's that comes before it."""

ROUNDING_REV = 1e-9
"""By so much less than a whole frame may be covered: the last digits of an angle."""


@dataclass(frozen=True)
class OrderMethod:
    """A way from samples to order spectra and what it costs in accuracy.

    ``margin`` is the number of samples at each end that only serve their neighbours, ``highest`` the share of the
    sample rate up to which orders are carried, ``kernel`` that of "resample".
    """

    name: Literal["resample", "nufft", "as sampled", "no shaft"]
    predicted_error: float
    margin: int
    highest: float
    kernel: Kernel | None = None


@dataclass(frozen=True)
class FrameLayout:
    """Where the frames of a recording lie: each ``revs`` long, beginning at ``begin_rev`` (frames,), in rev."""

    method: OrderMethod
    revs: int
    hop_rev: int
    begin_rev: NDArray[np.float64]


def frame_layout(band: xr.Dataset, shaft: xr.Dataset, *, settings: OrderSettings) -> FrameLayout:
    """Frames of whole cycles that ``band`` and ``shaft`` hold, by the method that ``settings`` ask for.

    Left to itself ("auto") the choice falls on resampling, the cheapest, unless its kernel misses the tolerance,
    takes away the ends of a recording that has too few revolutions anyway, or does not carry the orders wanted.
    Raises InputError where not even one cycle was recorded.
    """
    cycle = int(shaft.attrs["revs_per_cycle"])
    if is_by_angle(band):
        first = float(shaft["crank_angle"].values[0])
        held = band["signal"].shape[1] / int(band.attrs["samples_per_rev"])
        candidates = [(OrderMethod("as sampled", 0.0, 0, 0.5), first, first + held)]
    else:
        samples = time_samples(band, tolerance=METHOD_SHARE * settings.tolerance)
        methods = order_methods(samples, settings=settings)
        candidates = [(method, *covered_angles(samples, shaft, margin=method.margin)) for method in methods]
    wanted = max(1, settings.revs_per_frame // cycle) * cycle
    revs = [min(wanted, math.floor(last - first + ROUNDING_REV) // cycle * cycle) for _, first, last in candidates]
    if max(revs) == 0:
        held = max(last - first for _, first, last in candidates)
        raise InputError(
            "the recording holds less than one engine cycle",
            file=band.attrs["recording"],
            found=f"{held:.2f} revolutions",
            allowed=f"at least {cycle}",
        )
    chosen = _first_that_serves(candidates, revs, band, shaft, settings)
    method, first, last = candidates[chosen]
    hop = max(1, round(revs[chosen] * (1.0 - settings.overlap)))
    count = math.floor((last - first - revs[chosen] + ROUNDING_REV) / hop) + 1
    return FrameLayout(method, revs[chosen], hop, first + hop * np.arange(count, dtype=np.float64))


def order_methods(samples: TimeSamples, *, settings: OrderSettings) -> list[OrderMethod]:
    """Methods that meet the tolerance of ``settings`` for ``samples``, the cheapest first; those asked for by name.

    Raises RequestError where the one asked for cannot meet it.
    """
    tolerance = METHOD_SHARE * settings.tolerance
    methods = []
    if settings.method != "nufft":
        try:
            kernel = kernel_for(samples, tolerance)
            methods = [OrderMethod("resample", kernel.predicted_error, kernel.margin, samples.content, kernel)]
        except RequestError:
            if settings.method == "resample":
                raise
    if settings.method != "resample":
        methods.append(OrderMethod("nufft", max(tolerance, LEAST_TOLERANCE), 0, MOST_CARRIED))
    return methods


def _first_that_serves(
    candidates: list[tuple[OrderMethod, float, float]],
    revs: list[int],
    band: xr.Dataset,
    shaft: xr.Dataset,
    settings: OrderSettings,
) -> int:
    """Position of the first of ``candidates`` that gives frames as long, and orders as high, as any other."""
    if is_by_angle(band):
        return 0
    fastest_hz = float(np.nanmax(shaft["speed"].values)) / 60.0
    top = settings.max_order * fastest_hz / float(band.attrs["rate_hz"])
    carried = [min(method.highest, top) for method, _, _ in candidates]
    best = (max(revs), max(carried))
    return next((k for k in range(len(candidates)) if (revs[k], carried[k]) >= best), int(np.argmax(revs)))
