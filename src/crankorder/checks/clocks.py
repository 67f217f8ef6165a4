"""The clock of the pulses against that of the samples, told by the orders of a recording: all drift in step, or none.

A pulse that is stamped by a clock which runs fast by e makes the shaft look slower by e, so every line that is locked
to the shaft stands at its order times 1 + e, and its phase runs away in proportion to its order.
"""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from crankorder.orders.averages import cycle_bins, median_beside
from crankorder.orders.intervals import NORMAL
from crankorder.quantities import Bools, Complexes, Floats, Ints, QualityFlag, flags_of, remark
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("3-orders-recordings.toml", "clock_drift")

NOT_COMPARED = "clocks_not_compared"
"""Flag of recordings whose pulses were stamped by another device than their samples."""


def clock_drift(frames: xr.Dataset) -> QualityFlag | None:
    """Whether the clocks of pulses and samples of ``frames`` (OrderFrames) agree; None where one clock stamped both.

    So where too few lines stand out, where these differ by more than their noise lets them, and where the speed is not
    held: in a sweep modes turn the phases of lines.
    """
    speed = frames["speed"].values
    if not any(flag["flag"] == NOT_COMPARED for flag in flags_of(frames)):
        return None
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
    if not misfit < NUMBERS.least_sigmas**2:
        return None
    scale = math.sqrt(max(misfit, 1.0))
    ppm, error_ppm = 1e6 * (coarse + rest), 1e6 * scale / math.sqrt(float(np.sum(weight)))
    half = NORMAL * error_ppm
    said = f"{len(order)} lines of the vibration drift by {ppm:.3g} ± {half:.2g} ppm of their order"
    if not abs(ppm) > max(NUMBERS.least_sigmas * error_ppm, NUMBERS.least_ppm):
        detail = f"{said}: the clock of the pulses and that of the samples agree so far"
        return remark(str(frames.attrs["recording"]), "clocks_agree", detail)
    way = "fast" if ppm > 0.0 else "slow"
    detail = (
        f"{said}: the clock of the pulses runs {way} beside that of the samples, or what shakes slips "
        "against the shaft that has the pulses; phases of averages turn by it and high orders fade"
    )
    return remark(str(frames.attrs["recording"]), "clocks_differ", detail, "suspect")


def standing_orders(frames: xr.Dataset) -> tuple[Ints, dict[str, tuple[Floats, Bools]]]:
    """Bins (orders,) of the cycle's orders in OrderFrames ``frames``, and of each channel, by name, their mean power
    (orders,) and which stand out; nothing where the bins are too few to tell.
    """
    half, told = NUMBERS.beside_bins, dict[str, tuple[Floats, Bools]]()
    if "spectrum" not in frames or frames.sizes["order"] <= 2 * half:
        return np.empty(0, dtype=np.int64), told
    at = cycle_bins(frames)
    for name, spectrum in zip(frames["channel"].values.tolist(), frames["spectrum"].values, strict=True):
        power = np.abs(spectrum) ** 2
        known = np.isfinite(power)
        mean = np.where(known, power, 0.0).sum(axis=0) / np.maximum(1, known.sum(axis=0))
        told[name] = mean[at], mean[at] > NUMBERS.stands_out * median_beside(mean, half)[at]
    return at, told


def _lines(frames: xr.Dataset) -> tuple[Floats, Complexes]:
    """Orders (lines,) of the cycle that stand out in a channel, and their amplitudes (lines, frames)."""
    order, spectrum = frames["order"].values, frames["spectrum"].values
    found: list[Floats] = [np.empty(0)]
    rows: list[Complexes] = [np.empty((0, spectrum.shape[1]), dtype=np.complex128)]
    at, told = standing_orders(frames)
    for channel, (_, stands) in zip(spectrum, told.values(), strict=False):
        if np.isfinite(channel.real).all():
            found.append(order[at[stands]])
            rows.append(channel[:, at[stands]].T)
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
