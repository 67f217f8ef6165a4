"""What differs between two speed-frequency maps, cell by cell: dB with 95 % intervals, claims at a stated rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import fdtr, fdtrc, fdtri

from crankorder.identify.changes.order_changes import like_speeds
from crankorder.identify.false_discovery import claimed
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-changes.toml", table="map_difference"):
    beside_bins: tuple[int, int]
    steadiest_share: float
    still_bins: float
    mean_bins: float


NUMBERS = _Numbers.load()


@dataclass(frozen=True, eq=False)
class MapDifference:
    """Level of the second test less that of the first [dB], (channels, speeds, frequencies), with its 95 % interval.

    ``p_value`` is NaN where nothing was compared; ``changed`` are claims.
    """

    channels: tuple[str, ...]
    base_rpm: NDArray[np.float64]
    new_rpm: NDArray[np.float64]
    frequency_hz: NDArray[np.float64]
    difference_db: NDArray[np.float64]
    low_db: NDArray[np.float64]
    high_db: NDArray[np.float64]
    p_value: NDArray[np.float64]
    changed: NDArray[np.bool_]


def independent_frames(n_frames: NDArray[np.float64], *, overlap: float, window: str) -> NDArray[np.float64]:
    """Independent power spectra that overlapping frames are worth, of the shape of ``n_frames``.

    Parameters
    ----------
    n_frames : frames averaged, ≥ 1
    overlap : share of a frame that the next one repeats, 0 to 1
    window : "hann"; any other is taken for rectangular, which correlates more

    Source: Welch (1967), IEEE Trans. AU-15, 70, eq. 12.
    """
    frames = np.maximum(np.asarray(n_frames, dtype=np.float64), 1.0)
    total = np.ones_like(frames)
    step, lag = 1.0 - overlap, 1
    while lag * step < 1.0 and lag < 1000:
        x = lag * step
        turn = 2.0 * np.pi * x
        hann = ((1.0 - x) * (2.0 + np.cos(turn)) + 1.5 / np.pi * np.sin(turn)) / 3.0
        alike = hann if window == "hann" else 1.0 - x
        total += 2.0 * np.maximum(1.0 - lag / frames, 0.0) * alike**2
        lag += 1
    return np.asarray(frames / total)


def map_difference(
    base: xr.Dataset,
    new: xr.Dataset,
    channels: tuple[str, ...],
    *,
    within_rpm: float,
    overlap: tuple[float, float],
    q: float,
    correlated: bool = False,
    locked_orders: Sequence[float] = (),
) -> MapDifference:
    """Difference of two CampbellMaps at like speeds and at the frequencies that both have.

    A power spectral density of n independent spectra has a gamma distribution with 2 n degrees of freedom: the ratio of
    two is F distributed. Where like speeds differ so much that an order line lies elsewhere in its bin, a cell counts
    as changed only if it differs from all cells that the line may have come from.

    Parameters
    ----------
    base, new : CampbellMaps of the same resolution
    channels : names that both have in the same unit
    within_rpm : largest difference of like speeds, min-1
    overlap : of the frames of the first and the second test, 0 to 1
    q : false-discovery rate of the claims over all cells, 0 to 1
    correlated : True claims less, for cells that depend on one another in any way
    locked_orders : orders that both tests show locked to the shaft: their cells hold a steady line, whose power varies
        by 2 r − 1 over r² of that of noise, r its power over that of the noise beside it
    """
    one, two = like_speeds(base["speed"].values, new["speed"].values, within_rpm=within_rpm)
    n = min(base.sizes["frequency"], new.sizes["frequency"])
    frequency = base["frequency"].values[:n]
    shape = (len(channels), len(one), n)
    levels, freedom = [], []
    for item, at, share in zip((base, new), (one, two), overlap, strict=True):
        names = item["channel"].values.tolist()
        rows = [names.index(channel) for channel in channels]
        psd = item["psd"].transpose("channel", "speed", "frequency").values[rows][:, at, :n]
        levels.append(np.asarray(psd, dtype=np.float64).reshape(shape))
        frames = item["n_frames_used"].values[rows] if "n_frames_used" in item else item["n_frames"].values[None]
        worth = independent_frames(frames[:, at], overlap=share, window=str(item.attrs.get("window")))
        freedom.append(np.broadcast_to(2.0 * worth[..., None], shape))
    base_rpm, new_rpm = base["speed"].values[one], new["speed"].values[two]
    lines = _on_lines(base["speed"].values[one], frequency, locked_orders)
    freedom = [_freedom(level, nu, lines) for level, nu in zip(levels, freedom, strict=True)]
    moved = frequency * np.abs(new_rpm / base_rpm - 1.0)[:, None]
    moved /= float(base.attrs["resolution_hz"])
    return _compared(channels, base_rpm, new_rpm, frequency, levels, freedom, moved, q, correlated)


def _on_lines(
    speed_rpm: NDArray[np.float64], frequency: NDArray[np.float64], orders: Sequence[float]
) -> NDArray[np.bool_]:
    """True (speeds, frequencies) for the cells within one bin of an order."""
    step = float(frequency[1] - frequency[0]) if len(frequency) > 1 else 1.0
    lines = np.zeros((len(speed_rpm), len(frequency)), dtype=np.bool_)
    for order in orders:
        lines |= np.abs(frequency - order * speed_rpm[:, None] / 60.0) <= step
    return lines


def _freedom(psd: NDArray[np.float64], freedom: NDArray[np.float64], lines: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Degrees of freedom of each cell, more where a steady line stands over its noise.

    That is the noise beside it (the larger side), or at the same frequency at the speeds whose lines lie elsewhere,
    whichever is more: where an order meets a natural frequency the noise under it stands above that beside it.
    """
    made = np.array(freedom)
    row, column = np.nonzero(lines)
    n = psd.shape[2]
    sides = [np.clip(column[:, None] + sign * np.arange(*NUMBERS.beside_bins), 0, n - 1) for sign in (-1, 1)]
    noise = np.max([np.nanmedian(np.nan_to_num(psd[:, row[:, None], side]), axis=2) for side in sides], axis=0)
    elsewhere = _median_where(psd, ~lines)
    noise = np.fmax(noise, elsewhere[:, column])
    power = psd[:, row, column]
    with np.errstate(divide="ignore", invalid="ignore"):
        over = np.where(noise > 0, np.maximum(power / noise, 1.0), 1.0)
    made[:, row, column] /= np.maximum((2.0 * over - 1.0) / over**2, NUMBERS.steadiest_share)
    return made


def _median_where(psd: NDArray[np.float64], kept: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Median over the ``kept`` (speeds, frequencies) speeds of ``psd``, (channels, frequencies); NaN where none is."""
    if not psd.shape[1]:
        return np.full((psd.shape[0], psd.shape[2]), np.nan)
    values = np.sort(np.where(kept, psd, np.nan), axis=1)  # NaN comes last
    count = np.count_nonzero(np.isfinite(values), axis=1)
    middle = np.maximum(count - 1, 0)[:, None, :] // 2
    return np.asarray(np.take_along_axis(values, middle, axis=1)[:, 0, :])


def _compared(
    channels: tuple[str, ...],
    base_rpm: NDArray[np.float64],
    new_rpm: NDArray[np.float64],
    frequency: NDArray[np.float64],
    levels: list[NDArray[np.float64]],
    freedom: list[NDArray[np.float64]],
    moved: NDArray[np.float64],
    q: float,
    correlated: bool,
) -> MapDifference:
    base, new = levels
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = new / base
        near = _nearest_ratio(base, new, moved)
        below = fdtr(freedom[1], freedom[0], near)
        above = fdtrc(freedom[1], freedom[0], near)
        p_value = np.minimum(2.0 * np.minimum(below, above), 1.0)
        p_value = np.where(np.isfinite(ratio) & (base > 0) & (new > 0), p_value, np.nan)
        p_value = np.where(near == 1.0, np.where(np.isnan(p_value), np.nan, 1.0), p_value)
        low = ratio / fdtri(freedom[1], freedom[0], 0.975)
        high = ratio / fdtri(freedom[1], freedom[0], 0.025)
        db, low_db, high_db = (10.0 * np.log10(values) for values in (ratio, low, high))
    step = float(frequency[1] - frequency[0]) if len(frequency) > 1 else 0.0
    p_value[..., frequency <= NUMBERS.mean_bins * step] = np.nan
    changed = claimed(p_value, q=q, correlated=correlated)
    return MapDifference(channels, base_rpm, new_rpm, frequency, db, low_db, high_db, p_value, changed)


def _nearest_ratio(
    base: NDArray[np.float64], new: NDArray[np.float64], moved: NDArray[np.float64]
) -> NDArray[np.float64]:
    """New level over the nearest to it that the cells within ``moved`` bins (speeds, frequencies) of it had; 1 inside.

    Lines that move between two bins may at most change to what their neighbours were.
    """
    reach = np.where(moved > NUMBERS.still_bins, np.ceil(np.minimum(moved, 8.0)), 0.0).astype(np.int64)
    low, high = base.copy(), base.copy()
    for step in range(1, int(reach.max(initial=0)) + 1):
        used = reach >= step
        for sign in (-1, 1):
            shifted = np.roll(base, sign * step, axis=2)
            low = np.where(used, np.fmin(low, shifted), low)
            high = np.where(used, np.fmax(high, shifted), high)
    return np.asarray(
        np.where(new > high, new / high, np.where(new < low, new / low, np.where(low < high, 1.0, new / base)))
    )


def cell_records(cells: MapDifference) -> list[dict[str, Any]]:
    """For each channel of ``cells`` how many changed, the largest rise and fall, and the bands they are in."""
    records = []
    for number, channel in enumerate(cells.channels):
        says, values = cells.changed[number], cells.difference_db[number]
        record: dict[str, Any] = {
            "channel": channel,
            "compared": int(np.count_nonzero(np.isfinite(cells.p_value[number]))),
            "changed": int(np.count_nonzero(says)),
        }
        for name, sign in (("rise", 1.0), ("fall", -1.0)):
            claims = np.where(_in_company(says) & (sign * values > 0), sign * values, -np.inf)
            at = np.unravel_index(int(np.argmax(claims)), claims.shape)
            record[name] = None if not np.isfinite(claims[at]) else _cell(cells, number, at)
        records.append({**record, "bands": _bands(cells, number)})
    return records


def _in_company(says: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Claimed cells that have a claimed neighbour: of those that stand alone some are chance."""
    wide = np.pad(says, 1)
    return np.asarray(says & (wide[1:-1, :-2] | wide[1:-1, 2:] | wide[:-2, 1:-1] | wide[2:, 1:-1]))


def _cell(cells: MapDifference, channel: int, at: tuple[Any, ...]) -> dict[str, Any]:
    place = (channel, *at)
    return {
        "speed_rpm": float(cells.base_rpm[at[0]]),
        "frequency_hz": float(cells.frequency_hz[at[1]]),
        "difference_db": float(cells.difference_db[place]),
        "difference_db_ci95": [float(cells.low_db[place]), float(cells.high_db[place])],
    }


def _bands(cells: MapDifference, channel: int, *, most: int = 12) -> list[dict[str, Any]]:
    """Bands of neighbouring frequencies with changed cells, those with most cells first."""
    says = cells.changed[channel]
    per = np.count_nonzero(says, axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (per > 0).astype(np.int8), [0]])))
    bands = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        block = says[:, first:end]
        values = cells.difference_db[channel][:, first:end][block]
        bands.append(
            {
                "low_hz": float(cells.frequency_hz[first]),
                "high_hz": float(cells.frequency_hz[end - 1]),
                "cells": int(block.sum()),
                "mean_db": float(np.mean(values)),
            }
        )
    return sorted(bands, key=lambda band: -int(band["cells"]))[:most]
