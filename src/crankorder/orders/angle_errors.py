"""What the error of the crank angle does to a line: its phase turns, its amplitude is smeared, in step with the order.

The orders' own scatter does not show it: what turns all frames alike is no noise of theirs, and what scatters within a
frame leaves a line that is steady and a little too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.orders.intervals import NORMAL
from crankorder.shaft.angle import knots_of
from crankorder.shaft.reference_errors import reference_of
from crankorder.shaft.tooth_errors import TOOTH_KEPT, TOOTH_LEVEL, TOOTH_ORDER, TOOTH_PRINT, same_wheel

ERROR, OF_ONE_REV = "angle_error_rev", "angle_error_of_one_rev_rev"
"""Attributes of frames: standard error [rev] of the crank angle, and of its mean over a revolution."""

LINES = "angle_lines_per_rev"
"""Attribute of frames: lines or samples of the encoder per crank revolution; 0 where the angle rests on none."""

TAKEN = "angle_swing_taken_rev"
"""Attribute of angle, frames and tracks: by harmonic, what was taken out of the swing that the encoder shows."""

MANY_LINES = 360.0
"""Lines per revolution of an encoder by whose pulses samples were taken: so many or more."""

UNKNOWN_DEG = 180.0
"""Half width of the interval of a phase that is not known."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AngleErrors:
    """Errors of the crank angle [rev] by row: ``random`` (rows,) within it, ``mean`` (rows,) that of its mean."""

    random: Array
    mean: Array

    def phase_half_deg(self, half_deg: Array, order: Array) -> Array:
        """``half_deg``, half widths of 95 % intervals of phases, with the error of the angle at each ``order``.

        All have shapes that follow from (rows,) by broadcasting; unknown phases stay so.
        """
        turned = NORMAL * 360.0 * order * self.mean
        return np.asarray(
            np.where(half_deg < UNKNOWN_DEG, np.minimum(np.hypot(half_deg, turned), UNKNOWN_DEG), half_deg)
        )

    def kept(self, order: Array) -> Array:
        """Share of its amplitude, 0 to 1, that a line at each ``order`` keeps; shapes as of :meth:`phase_half_deg`."""
        return np.asarray(np.exp(-0.5 * np.square(2.0 * np.pi * order * self.random)))

    @property
    def by_order(self) -> AngleErrors:
        """These errors (rows, 1), beside which orders have an axis of their own."""
        return AngleErrors(self.random[:, None], self.mean[:, None])


def stated_errors(shaft: xr.Dataset, *, revs_per_frame: float) -> dict[str, Any]:
    """The attributes that frames of ``revs_per_frame`` carry of the error of their ShaftAngle ``shaft``."""
    error, of_one = _errors(shaft, revs_per_frame)
    taken = {TAKEN: shaft.attrs[TAKEN]} if TAKEN in shaft.attrs else {}
    # teeth of an encoder on another shaft swing at orders that no harmonic of the crank has
    own = TOOTH_PRINT in shaft.attrs and float(shaft.attrs[TOOTH_ORDER]) == 1.0
    teeth = {name: shaft.attrs[name] for name in (TOOTH_LEVEL, TOOTH_KEPT, TOOTH_PRINT)} if own else {}
    return {ERROR: error, OF_ONE_REV: of_one, LINES: _lines_per_rev(shaft), **taken, **teeth}


def same_teeth(frames: Sequence[xr.Dataset]) -> bool:
    """Whether the angles of all ``frames`` err alike: by one wheel, whose low harmonics are left in all of them.

    What was taken out of them with the teeth may have been motion, which is another in each recording.
    """
    stated = [item.attrs for item in frames if TOOTH_PRINT in item.attrs]
    return not stated or (all(int(one[TOOTH_KEPT]) for one in stated) and same_wheel(stated))


def _lines_per_rev(shaft: xr.Dataset) -> float:
    """Lines of the encoder per revolution; a recording by crank angle has many, how many is not looked for."""
    if shaft.attrs.get("domain") == "crank_angle":
        return MANY_LINES
    return float(shaft.attrs.get("teeth_per_rev", 0.0)) if int(shaft.attrs.get("n_pulses", 0)) > 0 else 0.0


def errors_of_rows(
    frames: Sequence[xr.Dataset], owner: NDArray[np.int64], rows: Sequence[NDArray[np.int64]]
) -> AngleErrors:
    """Errors of the rows of a map of OrderFrames ``frames``, whose recordings err each on its own.

    ``owner`` (frames of all,) is the number of the recording of each, ``rows`` the frames of each row.
    """
    error, of_one = (np.array([float(item.attrs.get(name, 0.0)) for item in frames]) for name in (ERROR, OF_ONE_REV))
    random, mean = np.zeros(len(rows)), np.zeros(len(rows))
    for place, row in enumerate(rows):
        names, count = np.unique(owner[row], return_counts=True)
        revs = np.array([_revs_of(frames[name], int(n)) for name, n in zip(names, count, strict=True)])
        share = count / count.sum()
        own = np.minimum(error[names], of_one[names] / np.sqrt(revs))
        random[place] = np.sqrt(np.sum(share * np.maximum(error[names] ** 2 - own**2, 0.0)))
        mean[place] = np.sqrt(np.sum(np.square(share * own)))
    return AngleErrors(random, mean)


def errors_along(shaft: xr.Dataset, time_s: Array, revs: Array) -> AngleErrors:
    """Errors of ``shaft`` at the times ``time_s`` (rows,), each over so many ``revs`` (rows,), above 0."""
    overall, of_one = _errors(shaft, float(np.median(revs)) if len(revs) else 1.0)
    if not overall > 0.0:
        return AngleErrors(np.zeros(len(time_s)), np.zeros(len(time_s)))
    here = np.interp(time_s, knots_of(shaft)["knot_time_s"], np.nan_to_num(shaft["standard_error"].values))
    mean = np.minimum(here, here * (of_one / overall) / np.sqrt(revs))
    return AngleErrors(np.sqrt(np.maximum(here**2 - mean**2, 0.0)), mean)


def _revs_of(frames: xr.Dataset, count: int) -> float:
    """Revolutions that ``count`` frames reach over."""
    return float(frames.attrs["revs_per_frame"]) * (
        1.0 + (count - 1.0) * (1.0 - float(frames.attrs.get("overlap", 0.0)))
    )


def _errors(shaft: xr.Dataset, revs_per_frame: float) -> tuple[float, float]:
    """Standard error [rev] of the angle, and of its mean over one revolution; 0 where nothing tells."""
    if "n_pulses" not in shaft.attrs or "standard_error" not in shaft:
        return 0.0, 0.0
    reference = reference_of(shaft, revs_per_frame=revs_per_frame)
    error = reference.error_rev
    if not np.isfinite(error):
        return 0.0, 0.0
    if not reference.teeth_per_rev > 0.0:
        return error, error
    return error, reference.pulse_error_rev / float(np.sqrt(reference.teeth_per_rev))
