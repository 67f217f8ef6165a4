"""A line of a sweep that is too close to a stronger one to stand out by itself: it is what that one leaves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.orders.track_rows import hann_lobe

REACH_BINS = 10
"""Bins on each side of a line in which its company is looked for; farther lines stand out by themselves."""

NEAREST_BINS, STEP_BINS = 0.75, 0.25
"""Distances that are tried: from the first, nearer company is one line that swells, in such steps."""

LEAST_GAIN = 8.0
"""By so much a company lowers what half of the frames leave or more: a resonance does so in a few frames only."""

FEWEST_FRAMES = 8
"""Frames of which so many can be told by their median."""

WIDTH_BINS = 0.01
"""Step by which the shape of a line that swells or bends is differenced."""

Array = NDArray[np.float64]


def company_of(order: float, frames: xr.Dataset, others: Sequence[float] = ()) -> float:
    """Order of a line close to ``order`` in the OrderFrames ``frames`` of a sweep; NaN where there is none.

    Each frame is solved for the line, whose amplitude may run as a parabola, those of ``others`` (orders) in reach, and
    one more at every distance in turn; it is there where it lowers what the median frame leaves of the bins in reach by
    more than :data:`LEAST_GAIN`.
    """
    revs = float(frames.attrs["revs_per_frame"])
    place = order * revs
    used: Array = np.arange(
        max(1, round(place) - REACH_BINS), min(frames.sizes["order"], round(place) + REACH_BINS + 1), dtype=np.float64
    )
    centre = frames["crank_angle"].values + 0.5 * revs
    turned = frames["spectrum"].values[:, :, used.astype(int)] * np.exp(
        2j * np.pi * (np.outer(centre, used) / revs % 1.0)
    )
    seen = turned.reshape(-1, len(used))
    seen = seen[np.isfinite(seen).all(axis=1) & (seen != 0.0).any(axis=1)]
    if len(seen) < FEWEST_FRAMES or len(used) < REACH_BINS:
        return float("nan")
    near = [other * revs for other in others if 0.0 < abs(other * revs - place) < 2.0 * REACH_BINS]
    known = [
        _changing_lobe(used - place),
        *(_changing_lobe(used - other)[:2] for other in near),
    ]
    base = np.linalg.qr(np.concatenate(known).T)[0]
    left = seen - (seen @ base) @ base.T
    energy = np.maximum((np.abs(left) ** 2).sum(axis=1), np.finfo(float).tiny)
    beside: Array = np.arange(NEAREST_BINS, REACH_BINS - 1.0, STEP_BINS)
    apart = np.concatenate([-beside[::-1], beside])
    lobes = hann_lobe(used - place - apart[:, None])
    lobes -= (lobes @ base) @ base.T
    lobes /= np.linalg.norm(lobes, axis=1, keepdims=True)
    share = np.median(1.0 - np.abs(left @ lobes.T) ** 2 / energy[:, None], axis=0)
    best = int(share.argmin())
    return order + float(apart[best]) / revs if share[best] * LEAST_GAIN < 1.0 else float("nan")


def _changing_lobe(off_bins: Array) -> Array:
    """Lobe (3, bins) of a line that is steady, that grows, and that bends."""
    before, here, after = (hann_lobe(off_bins + side * WIDTH_BINS) for side in (-1.0, 0.0, 1.0))
    return np.array([here, after - before, before + after - 2.0 * here])
