"""Lines that errors of the crank angle may make beside stronger orders, as rounded edges of an encoder do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.found import OrderLine
from crankorder.orders.true_angle import ERROR

OF_ROUNDING = float(np.sqrt(12.0))
"""Sideband over carrier, per order and standard error [rev] of the angle: the first harmonic of a rounding error."""

Array = NDArray[np.float64]


def sideband_of(lines: Sequence[OrderLine], order_map: xr.Dataset, frames: Sequence[xr.Dataset]) -> float | None:
    """Order whose sidebands all ``lines`` (one order, by channel) may be, at every speed at which they are seen.

    An edge that is rounded to the samples of a recording errs by up to half of one, in a pattern that beats with the
    samples: it turns the phase of order n by n times the error of the angle, and leaves lines at orders that are none.
    ``order_map`` (OrderMap) says how large the others are, ``frames`` (OrderFrames) how well the angle is known. None
    where one of the lines is larger than that.
    """
    error = _errors(order_map["speed"].values, float(order_map.attrs.get("speed_bin_rpm", 25.0)), frames)
    axis, names = order_map["order"].values, order_map["channel"].values.tolist()
    carrier = 0.0
    for line in lines:
        size = np.nan_to_num(order_map["amplitude"].values[names.index(line.channel)])
        turned = size[line.seen] * axis
        if not (line.amplitude <= OF_ROUNDING * error[line.seen] * turned.max(axis=1)).all():
            return None
        carrier = float(axis[int(turned[line.strongest].argmax())])
    return carrier if lines else None


def _errors(speed_rpm: Array, width_rpm: float, frames: Sequence[xr.Dataset]) -> Array:
    """Standard error [rev] of the crank angle (speeds,) in the recordings that ran at each speed; the largest."""
    made = np.zeros(len(speed_rpm))
    for item in frames:
        speed = item["speed"].values
        if not len(speed) or not np.isfinite(speed).any():
            continue
        ran = (speed_rpm >= np.nanmin(speed) - width_rpm) & (speed_rpm <= np.nanmax(speed) + width_rpm)
        made = np.where(ran | ~np.isfinite(speed_rpm), np.maximum(made, float(item.attrs.get(ERROR, 0.0))), made)
    return made
