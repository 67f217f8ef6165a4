"""Pulses that begin late or end early: from when to when the shaft is not known, and whether it may have stood."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from crankorder.shaft.pulses import FloatArray, Remark

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


class Silence(NamedTuple):
    """A stretch without pulses, s, the ``speed_rpm`` beside it, and the share of the ``vibration`` that goes on in it.

    ``may_stand`` where the speed beside falls so fast towards it that the shaft may have come to rest within it.
    """

    from_s: float
    to_s: float
    at_end: bool
    speed_rpm: float
    may_stand: bool
    vibration: float


def silent_ends(recording: xr.Dataset, shaft: xr.Dataset) -> list[Remark]:
    """Remarks on the ends of ``recording`` (a Recording by time) that its pulses leave out of ``shaft`` (its angle)."""
    if "pulse_time" not in recording or recording.attrs.get("domain") != "time":
        return []
    remarks: list[Remark] = []
    for at_end in (False, True):
        found = _silence(recording, shaft, at_end=at_end)
        if found is not None:
            remarks.append(_said(found))
    return remarks


def _silence(recording: xr.Dataset, shaft: xr.Dataset, *, at_end: bool) -> Silence | None:
    pulse_s = recording["pulse_time"].values
    rate_hz = float(recording.attrs["rate_hz"])
    length_s = recording["signal"].shape[1] / rate_hz
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
    span = (edge_s, length_s) if at_end else (0.0, edge_s)
    share = _vibration_share(recording["signal"].values, rate_hz, edge_s, gap_s, at_end=at_end)
    return Silence(*span, at_end, speed_rpm, may_stand, share)


def _beside(shaft: xr.Dataset, edge_s: float, reach_s: float, gap_s: float, *, at_end: bool) -> tuple[float, bool]:
    """Speed beside the silence, rpm, and whether its slope brings it to rest within ``gap_s``."""
    time_s, speed = shaft["time"].values, shaft["speed"].values
    close = (np.abs(time_s - edge_s) <= reach_s) & ((time_s <= edge_s) if at_end else (time_s >= edge_s))
    close &= np.isfinite(speed)
    if np.count_nonzero(close) < 2:
        return float(np.nan_to_num(np.abs(speed[-1 if at_end else 0]))), False
    away, beside = np.abs(time_s[close] - edge_s), np.abs(speed[close])
    slope, at_edge = np.polyfit(away, beside, 1)
    speed_rpm = max(float(at_edge), float(beside[np.argmin(away)]), 0.0)
    return speed_rpm, bool(slope * gap_s > max(float(at_edge), 0.0))


def _vibration_share(signal: FloatArray, rate_hz: float, edge_s: float, gap_s: float, *, at_end: bool) -> float:
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


def _said(found: Silence) -> Remark:
    when = f"no pulses from {found.from_s:.3g} s to {'the end at ' if found.at_end else ''}{found.to_s:.3g} s"
    length = f"{found.to_s - found.from_s:.3g} s are left out of all that follows the shaft"
    beside = f"the speed {'before' if found.at_end else 'after'} was {found.speed_rpm:.4g} rpm"
    goes_on = found.vibration >= GOES_ON
    level = f"the vibration goes on at {100.0 * found.vibration:.0f} % of its amplitude" if goes_on else ""
    if found.may_stand and not goes_on:
        return ("no_pulses", "info", f"{when}: standstill or encoder lost; {beside}; {length}")
    told = "encoder lost while the machine ran" if goes_on and not found.may_stand else "encoder lost or standstill"
    reasons = "; ".join(part for part in (beside, level, length) if part)
    return ("no_pulses", "suspect", f"{when}: {told}; {reasons}")
