"""Where the shaft may have stood: pulses that begin late or end early, and runs with a standstill between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import xarray as xr

from crankorder.quantities import Floats
from crankorder.shaft.angle import AngleKnots, angle_at
from crankorder.shaft.pulses import Remark

LEAST_REVS = 2.0
"""Turns, at the speed beside it, that a stretch without pulses must last to be worth a remark …"""

LEAST_INTERVALS = 4.0
"""… and so many times as long as the intervals between the pulses beside."""

BESIDE_SHARE = 0.1
"""Share of the time with pulses in which the speed beside the silence, and its change, are looked at."""

GOES_ON = 0.5
"""Vibration that keeps this share of its amplitude when the pulses stop is that of a machine that runs on."""

LOOK_S = 1.0
"""Length of the silence, from where the pulses are, whose vibration is looked at."""


NO_PULSES = "no_pulses"
"""Flag of a stretch without pulses."""


def silent_ends(recording: xr.Dataset, shaft: xr.Dataset) -> list[Remark]:
    """Remarks on the ends of ``recording`` (a Recording by time) that its pulses leave out of ``shaft`` (its angle)."""
    if "pulse_time" not in recording or "rate_hz" not in recording.attrs:
        return []
    remarks = (_silence(recording, shaft, at_end=at_end) for at_end in (False, True))
    return [remark for remark in remarks if remark is not None]


def _silence(recording: xr.Dataset, shaft: xr.Dataset, *, at_end: bool) -> Remark | None:
    """Remark on a stretch without pulses at one end; None where there is none that is long.

    It tells a standstill, where the speed beside falls so fast that the shaft may have come to rest, from an encoder
    that was lost, where the vibration goes on.
    """
    pulse_s = recording.variables["pulse_time"].values
    rate_hz = float(recording.attrs["rate_hz"])
    length_s = recording.variables["signal"].shape[1] / rate_hz
    if pulse_s.size < 4 or not 0.0 <= pulse_s[0] < pulse_s[-1] <= length_s + 1.0 / rate_hz:
        return None
    edge_s = float(pulse_s[-1] if at_end else pulse_s[0])
    gap_s = length_s - edge_s if at_end else edge_s
    near = max(3, round(BESIDE_SHARE * pulse_s.size))
    interval_s = float(np.median(np.diff(pulse_s[-4:] if at_end else pulse_s[:4])))
    if gap_s <= LEAST_INTERVALS * interval_s:
        return None
    reach_s = abs(edge_s - float(pulse_s[-near] if at_end else pulse_s[near - 1]))
    speed_rpm, may_stand = _beside(shaft, edge_s, reach_s, gap_s, at_end=at_end)
    if not gap_s * speed_rpm / 60.0 > LEAST_REVS:
        return None
    vibration = _vibration_share(recording.variables["signal"].values, rate_hz, edge_s, gap_s, at_end=at_end)
    from_s, to_s = (edge_s, length_s) if at_end else (0.0, edge_s)
    when = f"no pulses from {from_s:.3g} s to {'the end at ' if at_end else ''}{to_s:.3g} s"
    length = f"{to_s - from_s:.3g} s are left out of all that follows the shaft"
    beside = f"the speed {'before' if at_end else 'after'} was {speed_rpm:.4g} rpm"
    goes_on = vibration >= GOES_ON
    if may_stand and not goes_on:
        return (NO_PULSES, "info", f"{when}: standstill or encoder lost; {beside}; {length}")
    cause = "encoder lost while the machine ran" if goes_on and not may_stand else "encoder lost or standstill"
    level = f"; the vibration goes on at {100.0 * vibration:.0f} % of its amplitude" if goes_on else ""
    return (NO_PULSES, "suspect", f"{when}: {cause}; {beside}{level}; {length}")


def _beside(shaft: xr.Dataset, edge_s: float, reach_s: float, gap_s: float, *, at_end: bool) -> tuple[float, bool]:
    """Speed beside the silence, rpm, and whether its slope brings it to rest within ``gap_s``."""
    time_s, speed = shaft.variables["time"].values, shaft.variables["speed"].values
    close = (np.abs(time_s - edge_s) <= reach_s) & ((time_s <= edge_s) if at_end else (time_s >= edge_s))
    close &= np.isfinite(speed)
    if np.count_nonzero(close) < 2:
        return float(np.nan_to_num(np.abs(speed[-1 if at_end else 0]))), False
    away, beside = np.abs(time_s[close] - edge_s), np.abs(speed[close])
    slope, at_edge = np.polyfit(away, beside, 1)
    speed_rpm = max(float(at_edge), float(beside[np.argmin(away)]), 0.0)
    return speed_rpm, bool(slope * gap_s > max(float(at_edge), 0.0))


def _vibration_share(signal: Floats, rate_hz: float, edge_s: float, gap_s: float, *, at_end: bool) -> float:
    """Amplitude beside the pulses' end within the silence over that of all before, where a channel falls least.

    Over all before: of a shaft that comes to rest the last turns are as quiet as a sensor's noise.
    """
    count, edge = int(min(LOOK_S, gap_s) * rate_hz), round(edge_s * rate_hz)
    inside = signal[:, edge : edge + count] if at_end else signal[:, max(0, edge - count) : edge]
    running = signal[:, :edge] if at_end else signal[:, edge:]
    if min(inside.shape[1], running.shape[1]) < 2:
        return float("nan")
    known = np.isfinite(inside).any(axis=1) & np.isfinite(running).any(axis=1)
    spread = [np.nanstd(part[known].astype(np.float64), axis=1) for part in (inside, running)]
    moves = spread[1] > 0.0
    return float((spread[0][moves] / spread[1][moves]).max()) if moves.any() else float("nan")


STEP_SHARE = 1e-3
"""Share of a knot interval over which the speed at a pulse is differenced."""


@dataclass(frozen=True)
class ShaftRun:
    """Knots of one run between standstills, the times of its first and last pulse, and how its angle is known.

    ``first`` and ``last`` number these pulses among all of the recording; ``period_rev`` are the turns after which its
    mark comes again, 0 where it has none.
    """

    knots: AngleKnots
    ends_s: tuple[float, float]
    first: int
    last: int
    period_rev: float


def joined(runs: list[ShaftRun], teeth_per_rev: float) -> AngleKnots:
    """Knots of all ``runs`` in turn, on the angle of the first.

    Between two of them the shaft turns by the pulses between, of which ``teeth_per_rev`` make a revolution, to the
    nearest angle at which the mark, where there is one, stands right; it slows down evenly, stands and speeds up.
    """
    knots = _within(runs[0].knots, -np.inf, runs[0].ends_s[1]) if len(runs) > 1 else runs[0].knots
    for before, run in pairwise(runs):
        own = _within(run.knots, run.ends_s[0], np.inf if run is runs[-1] else run.ends_s[1])
        turned = (run.first - before.last) / teeth_per_rev
        shift = knots.angle_rev[-1] + turned - own.angle_rev[0]
        if run.period_rev > 0.0:
            shift = run.period_rev * np.round(shift / run.period_rev)
        laid = replace(own, angle_rev=own.angle_rev + float(shift))
        # a tooth too many counted at rest would let the angle go back
        behind = laid.angle_rev > knots.angle_rev[-1]
        knots = _stopped_between(knots, _of(laid, [column[behind] for column in _columns(laid)]))
    return knots


def _within(knots: AngleKnots, first_s: float, last_s: float) -> AngleKnots:
    """``knots`` that end at ``first_s`` and ``last_s`` where these lie inside: no tooth is counted on beyond."""
    inside = (knots.time_s > first_s) & (knots.time_s < last_s)
    kept = [column[inside] for column in _columns(knots)]
    for at_s, front in ((first_s, True), (last_s, False)):
        if not knots.time_s[0] <= at_s <= knots.time_s[-1]:
            continue
        known = (knots.time_s, knots.angle_rev, knots.speed_rpm)
        step = STEP_SHARE * float(np.diff(knots.time_s).min())
        near = np.clip([at_s - step, at_s + step], knots.time_s[0], knots.time_s[-1])
        turned = angle_at(near, *known)
        here = [at_s, angle_at([at_s], *known)[0], 60.0 * np.diff(turned)[0] / np.diff(near)[0]]
        here.append(np.interp(at_s, knots.time_s, knots.standard_error_rev))
        kept = [np.insert(column, 0 if front else len(column), value) for column, value in zip(kept, here, strict=True)]
    return _of(knots, kept)


def _stopped_between(one: AngleKnots, two: AngleKnots) -> AngleKnots:
    """Knots of both and two in the hole between, where the shaft has slowed down and where it starts."""
    hole_s, turned = two.time_s[0] - one.time_s[-1], two.angle_rev[0] - one.angle_rev[-1]
    fast = np.array([one.speed_rpm[-1], two.speed_rpm[0]]) / 60.0
    slowing = min(hole_s / 3.0, turned / max(float(fast.sum()), 1e-12))
    slow = (turned - 0.5 * slowing * float(fast.sum())) / (hole_s - slowing)
    covered = 0.5 * (fast + slow) * slowing
    error = np.full(2, max(one.standard_error_rev[-1], two.standard_error_rev[0], turned / np.sqrt(12.0)))
    between = [
        np.array([one.time_s[-1] + slowing, two.time_s[0] - slowing]),
        np.array([one.angle_rev[-1] + covered[0], two.angle_rev[0] - covered[1]]),
        np.full(2, 60.0 * slow),
        error,
    ]
    columns = [np.concatenate(parts) for parts in zip(_columns(one), between, _columns(two), strict=True)]
    both = replace(one, cut_off_order=min(one.cut_off_order, two.cut_off_order), noise_s=max(one.noise_s, two.noise_s))
    return _of(both, columns)


def _columns(knots: AngleKnots) -> list[Floats]:
    return [knots.time_s, knots.angle_rev, knots.speed_rpm, knots.standard_error_rev]


def _of(knots: AngleKnots, columns: list[Floats]) -> AngleKnots:
    time_s, angle_rev, speed_rpm, error_rev = columns
    return replace(knots, time_s=time_s, angle_rev=angle_rev, speed_rpm=speed_rpm, standard_error_rev=error_rev)
