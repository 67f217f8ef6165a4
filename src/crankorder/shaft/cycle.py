"""Which top dead centre fires, from a mark on the camshaft that comes once per two crank revolutions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crankorder.shaft.pulses import FloatArray, Remark
from crankorder.shaft.repair import listed_times

# Marks are the same tooth of the camshaft within this much of a crank revolution: variable timing moves it by 0.14.
SAME_MARK_REV = 0.1
# One tooth per cycle leads all others, if there are any, by this share of the cycles.
LEAD_SHARE = 0.25
# A stated cam_to_tdc_deg that misses every top dead centre by more than this is wrong.
MISSED_TDC_REV = 0.1


@dataclass(frozen=True)
class CamMark:
    """Place [rev] of the cam mark in the cycle of two crank revolutions, on the scale of the places that were given.

    NaN where the marks do not tell it; ``flags`` say why, and which marks are lost or extra.
    """

    place_rev: float
    flags: list[Remark]


def cam_mark(place_rev: FloatArray, time_s: FloatArray) -> CamMark:
    """The place of the one mark per cycle of a camshaft, by the majority of the cycles.

    ``place_rev``: (marks,), crank angle of the marks in revolutions, NaN where it is not known. ``time_s``: (marks,),
    s, their times, for the remarks.
    """
    known = np.isfinite(place_rev)
    place, time_s = place_rev[known], time_s[known]
    if place.size == 0:
        return CamMark(float("nan"), [("no_cam", "suspect", "no cam mark while the crank angle is known")])
    cycles = max(1.0, (place[-1] - place[0]) / 2.0)
    away = np.abs(_wrapped(place[:, None] - place[None, :500]))
    votes = np.sum(away < SAME_MARK_REV, axis=0)
    first = int(np.argmax(votes))
    own = np.abs(_wrapped(place - place[first])) < SAME_MARK_REV
    centre = float(place[first] + np.median(_wrapped(place[own] - place[first])))
    rest = place[~own]
    rival = int(np.sum(np.abs(_wrapped(rest - centre - 1.0)) < SAME_MARK_REV))
    if own.sum() - rival < LEAD_SHARE * cycles or own.sum() < 0.5 * cycles:
        detail = (
            f"{own.sum()} cam marks at one place of the cycle, {rival} a crank revolution from it, {rest.size} in all"
        )
        return CamMark(float("nan"), [("cam_unclear", "suspect", f"{detail} elsewhere: the cycle phase is not known")])
    flags: list[Remark] = []
    extra = ~own
    extra[np.flatnonzero(own)[1:][np.diff(place[own]) < 1.0]] = True
    if extra.any():
        detail = f"{extra.sum()} cam marks out of place or doubled, left out, {listed_times(time_s[extra])}"
        flags.append(("cam_extra", "suspect", detail))
    missing = np.maximum(0, np.round(np.diff(place[own]) / 2.0) - 1).astype(np.int64)
    if missing.any():
        detail = f"{missing.sum()} cam marks missing, after those {listed_times(time_s[own][:-1][missing > 0])}"
        flags.append(("cam_lost", "suspect", detail))
    return CamMark(centre % 2.0, flags)


def firing_tdc(mark_rev: float, tdc_rev: float, cam_to_tdc_deg: float | None) -> tuple[float, list[Remark]]:
    """The top dead centre [rev] that fires, of those that come once per revolution.

    ``mark_rev``: place of the cam mark in the cycle. ``tdc_rev``: place of any top dead centre, NaN where only the cam
    tells it. ``cam_to_tdc_deg``: crank angle from the mark to the firing one; None where it is not stated: then it is
    the next one after the mark, or the mark itself.
    """
    told: Remark = (
        "cycle_from_cam",
        "info",
        "cam_to_tdc_deg is not stated: the cycle starts with the next dead centre",
    )
    if not np.isfinite(tdc_rev):
        return mark_rev + (cam_to_tdc_deg or 0.0) / 360.0, [told] if cam_to_tdc_deg is None else []
    if cam_to_tdc_deg is None:
        return tdc_rev + float(np.ceil(mark_rev - tdc_rev - 0.01)), [told]
    wanted = mark_rev + cam_to_tdc_deg / 360.0
    turns = float(np.round(wanted - tdc_rev))
    missed = wanted - tdc_rev - turns
    if abs(missed) <= MISSED_TDC_REV:
        return tdc_rev + turns, []
    detail = f"cam mark and cam_to_tdc_deg point {360.0 * missed:+.0f} degrees beside a top dead centre"
    return tdc_rev + turns, [("cam_off", "suspect", detail)]


def _wrapped(place_rev: FloatArray) -> FloatArray:
    """``place_rev`` within one revolution of 0, on the cycle of two."""
    wrapped: FloatArray = place_rev - 2.0 * np.round(place_rev / 2.0)
    return wrapped
