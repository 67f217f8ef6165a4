"""The clock of the pulses against that of the samples, told by the orders of a recording: all drift in step, or none.

A pulse that is stamped by a clock which runs fast by e makes the shaft look slower by e, so every line that is locked
to the shaft stands at its order times 1 + e, and its phase runs away in proportion to its order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr

from crankorder.orders.averages import cycle_bins, median_beside
from crankorder.orders.intervals import NORMAL
from crankorder.quantities import Complexes, Floats, QualityFlag, flags_of, with_flags
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("3-orders-recordings.toml", "clock_drift")

NOT_COMPARED = "clocks_not_compared"
"""Flag of recordings whose pulses were stamped by another device than their samples."""


@dataclass(frozen=True)
class Drift:
    """How fast the clock of the pulses runs beside that of the samples [ppm], its standard error, and lines it is of.

    ``agree``: whether the lines differ by no more than their noise lets them.
    """

    ppm: float
    error_ppm: float
    lines: int
    agree: bool


def with_clock_drift(frames: xr.Dataset, *, recorded: xr.Dataset) -> xr.Dataset:
    """OrderFrames ``frames`` with a flag that tells the drift, where pulses of ``recorded`` have a clock of their own.

    ``recorded`` is the Recording that the frames are of.
    """
    if not any(one["flag"] == NOT_COMPARED for one in flags_of(recorded)):
        return frames
    drift = clock_drift(frames)
    if drift is None or not drift.agree:
        return frames
    return with_flags(frames, [_flag(str(frames.attrs["recording"]), drift)])


def _flag(recording: str, drift: Drift) -> QualityFlag:
    half = NORMAL * drift.error_ppm
    said = f"{drift.lines} lines of the vibration drift by {drift.ppm:.3g} ± {half:.2g} ppm of their order"
    sure = abs(drift.ppm) > max(NUMBERS.least_sigmas * drift.error_ppm, NUMBERS.least_ppm)
    if not sure:
        detail = f"{said}: the clock of the pulses and that of the samples agree so far"
        return QualityFlag(recording=recording, flag="clocks_agree", severity="info", detail=detail)
    way = "fast" if drift.ppm > 0.0 else "slow"
    detail = (
        f"{said}: the clock of the pulses runs {way} beside that of the samples, or what shakes slips "
        "against the shaft that has the pulses; phases of averages turn by it and high orders fade"
    )
    return QualityFlag(recording=recording, flag="clocks_differ", severity="suspect", detail=detail)


def clock_drift(frames: xr.Dataset) -> Drift | None:
    """Drift of the clock of the pulses by the lines of ``frames`` (OrderFrames); None where too few stand out.

    Of recordings at one speed alone: in a sweep modes turn the phases of lines.
    """
    speed = frames["speed"].values
    if np.isfinite(speed).sum() < NUMBERS.fewest_frames or bool(frames.attrs.get("swept", 0)):
        return None
    if np.nanmax(speed) > np.nanmin(speed) * (1.0 + NUMBERS.held_share):
        return None
    order, lines = _lines(frames)
    if len(order) < NUMBERS.fewest_lines or len(np.unique(order)) < 2:
        return None
    begin = frames["crank_angle"].values.astype(np.float64)
    begin = begin - begin.mean()
    coarse = _coarse(order, lines, begin)
    slope, error = _slopes(lines * np.exp(-2j * np.pi * coarse * np.outer(order, begin)), begin)
    weight = np.square(order / error)
    apart = slope / order
    rest = float(np.sum(weight * apart) / np.sum(weight))
    misfit = float(np.sum(weight * np.square(apart - rest))) / (len(order) - 1)
    scale = math.sqrt(max(misfit, 1.0))
    spread = 1e6 * scale / math.sqrt(float(np.sum(weight)))
    return Drift(1e6 * (coarse + rest), spread, len(order), agree=misfit < NUMBERS.least_sigmas**2)


def _lines(frames: xr.Dataset) -> tuple[Floats, Complexes]:
    """Orders (lines,) of the cycle that stand out in a channel, and their amplitudes (lines, frames)."""
    order, spectrum = frames["order"].values, frames["spectrum"].values
    half = NUMBERS.beside_bins
    found: list[Floats] = [np.empty(0)]
    rows: list[Complexes] = [np.empty((0, spectrum.shape[1]), dtype=np.complex128)]
    if len(order) <= 2 * half or not (at := cycle_bins(frames)).size:
        return found[0], rows[0]
    for channel in spectrum:
        if not np.isfinite(channel.real).all():
            continue
        power = np.square(np.abs(channel)).mean(axis=0)
        chosen = at[power[at] > NUMBERS.stands_out * median_beside(power, half)[at]]
        found.append(order[chosen])
        rows.append(channel[:, chosen].T)
    return np.concatenate(found), np.concatenate(rows)


def _coarse(order: Floats, lines: Complexes, begin: Floats) -> float:
    """Drift [1] at which all lines together keep their phase best: the highest point of their joint periodogram."""
    reach = 1e-6 * NUMBERS.largest_ppm
    step = 0.25 / max(float(order.max()) * float(np.ptp(begin)), 1.0)
    grid = np.arange(-math.ceil(reach / step), math.ceil(reach / step) + 1) * step
    power = np.square(np.abs(lines)).sum(axis=1)
    total = np.zeros(len(grid))
    for own, row, size in zip(order, lines, power, strict=True):
        total += np.square(np.abs(np.exp(-2j * np.pi * own * np.outer(grid, begin)) @ row)) / max(size, 1e-300)
    return float(grid[int(np.argmax(total))])


def _slopes(lines: Complexes, begin: Floats) -> tuple[Floats, Floats]:
    """Slope (lines,) of the phase of each of ``lines`` (lines, frames) [rev per rev], and its standard error."""
    mean = lines.mean(axis=1, keepdims=True)
    turned = lines / np.where(np.abs(mean) > 0.0, mean, 1.0)
    phase = turned.imag / (2.0 * np.pi)  # of small angles, which noise does not wrap
    square = float(np.sum(np.square(begin)))
    slope = phase @ begin / square
    left = phase - np.outer(slope, begin) - phase.mean(axis=1, keepdims=True)
    # frames overlap by half: each second one is new
    freedom = max(len(begin) / 2.0 - 2.0, 1.0)
    error = np.sqrt(np.square(left).sum(axis=1) / freedom / (square / 2.0) / 2.0)
    return slope, np.maximum(error, 1e-12)
