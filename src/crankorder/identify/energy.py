"""Where the energy of a test lies: in lines whose cause is known, in modes and floor, and in what nothing explains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import gammainccinv

from crankorder.identify.explain import Causes
from crankorder.identify.found import AgreedOrder, ModalFit
from crankorder.settings import IdentifySettings

Floats = NDArray[np.float64]

LINE_BINS = 3.0
"""Bins on each side of a line that are the line's own: the main lobe of its window and a slow change of speed."""

STEADY_BINS = 2.0
"""Noise bandwidths from zero up in which the mean of the signal lies: they count as no vibration."""

SUNK = 0.1
"""Share of the floor below which the side lobes of a line are no more to be seen."""

MOST_HEIGHT = 1e8
"""No line stands higher than this over the floor of a cell."""

SMOOTHED_BINS = 9
"""Bins over whose median the floor under the lines is taken where no surface was fitted."""

CLEAR_SIGMAS = 4.0
"""Standard deviations from which what stands in a line's cells is more than its own amplitude and noise."""

MAP_CHANCE = 0.01
"""Chance that noise alone puts any cell of the whole map over its surface."""

MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class _Lines:
    """Lines as they lie in the map: ``centre`` and ``reach`` (rows, lines) on its axis.

    ``stated`` (channels, rows, lines) is the energy measured, NaN where the line was not seen; ``known`` (channels,
    lines) whether its cause is; ``is_tone`` (lines,) whether it stays at its frequency.
    """

    centre: Floats
    reach: Floats
    stated: Floats
    known: NDArray[np.bool_]
    is_tone: NDArray[np.bool_]


@dataclass(frozen=True)
class _Map:
    """Mean square (channels, rows, cells) in each cell of ``axis`` (cells,), from ``averages`` (rows,) frames."""

    axis: Floats
    energy: Floats
    averages: Floats


def energy_shares(
    campbell: xr.Dataset,
    order_map: xr.Dataset,
    orders: tuple[AgreedOrder, ...],
    modal: ModalFit,
    causes: Causes,
    *,
    settings: IdentifySettings,
) -> dict[str, Any]:
    """Shares of the energy of the whole recorded band, as ``energy`` and ``unexplained_energy_fraction`` of findings.

    Of each channel, as fractions of its mean square (``total``, in ``unit``) over all speeds alike, without the mean:
    ``orders`` and ``tones`` whose cause is known, ``modes_and_floor``, ``unexplained``; they add up to 1.
    ``unexplained`` is ``unexplained_lines`` (orders and tones without a known cause) and ``unexplained_cells`` (what
    cells of the map have above the fitted surface where they stand over it; noise puts any cell of the map there with a
    chance of 1 %, and no single one with more than ``settings.false_alarm_probability``). At each speed a line has
    amplitude² / 2, or all that stands over the surface in its own cells if that is clearly more, and never more than
    these hold; where it was not seen, what stands there on the mean of those speeds.

    ``unexplained_energy_fraction`` is the mean over the channels of unexplained / (orders + tones + unexplained):
    of the energy that is not broadband, the share without a known cause; in a channel without any line, of all its
    energy, for one cell by chance is no headline. 0 means that every line and every cell of the
    map is accounted for. ``cells_judged`` says whether there was a fitted surface to judge the cells by; without
    one all outside the lines counts as floor.

    Parameters
    ----------
    campbell : CampbellMap; where it has no speeds the order map alone is taken
    order_map : OrderMap of the same test
    orders : orders of the test
    modal : tones, and the fitted surface of the broadband floor with the modes
    causes : what explains each line
    settings : those of identify
    """
    by_frequency = bool(campbell.sizes["speed"])
    if by_frequency:
        made, lines = _by_frequency(campbell, orders, modal, causes)
    else:
        made, lines = _by_order(order_map, orders, causes)
    owner = _owners(made.axis, lines)
    surface, judged = _surface(made, owner, modal if by_frequency else None)
    owner = _owners(made.axis, _with_skirts(made, lines, surface))
    unexplained = _over_surface(made, owner, surface, modal, settings) if judged else np.zeros(made.energy.shape)
    names, units = order_map["channel"].values.tolist(), order_map["unit"].values.tolist()
    channels = [
        {"channel": name, "unit": f"({unit})²"} | _channel(number, made, lines, owner, surface, unexplained)
        for number, (name, unit) in enumerate(zip(names, units, strict=True))
    ]
    shares = [_fraction(record) for record in channels]
    decided = [share for share in shares if share is not None]
    return {
        "unexplained_energy_fraction": float(np.mean(decided)) if decided else 0.0,
        "cells_judged": judged,
        "channels": channels,
    }


def _fraction(record: dict[str, Any]) -> float | None:
    lines = record["orders"] + record["tones"] + record["unexplained_lines"]
    if lines > 0.0:
        return float(record["unexplained"] / (lines + record["unexplained_cells"]))
    return float(record["unexplained"]) if record["unexplained"] > 0.0 else None


def _by_frequency(
    campbell: xr.Dataset, orders: tuple[AgreedOrder, ...], modal: ModalFit, causes: Causes
) -> tuple[_Map, _Lines]:
    """The Campbell map as energies, and where orders and tones lie in it."""
    resolution, enbw_hz = float(campbell.attrs["resolution_hz"]), float(campbell.attrs["enbw_hz"])
    frequency, speed = campbell["frequency"].values, campbell["speed"].values
    channels = campbell["channel"].values.tolist()
    energy = campbell["psd"].values.astype(np.float64) * resolution
    energy[..., frequency < STEADY_BINS * enbw_hz] = 0.0
    own = LINE_BINS * max(resolution, enbw_hz / 1.5)
    number = np.array([agreed.order for agreed in orders])
    wander = 0.5 * (_group_width_rpm(campbell) / 60.0 + float(campbell.attrs.get("sweep_hz_per_order", 0.0)))
    tones = np.array([tone.frequency_hz for tone in modal.tones])
    centre = np.concatenate([np.outer(speed / 60.0, number), np.broadcast_to(tones, (len(speed), len(tones)))], axis=1)
    reach = np.broadcast_to(np.concatenate([own + wander * number, np.full(len(tones), own)]), centre.shape)
    half = _square_of_peak(campbell)
    stated = np.full((len(channels), len(speed), centre.shape[1]), np.nan)
    near_rpm = max(0.5 * float(campbell.attrs["speed_bin_rpm"]), 1e-3)
    for at, agreed in enumerate(orders):
        for line in agreed.lines:
            _put(stated[channels.index(line.channel), :, at], speed, line.speed_rpm, half * line.amplitude**2, near_rpm)
    for at, tone in enumerate(modal.tones, start=len(orders)):
        for name, (amplitude, _) in tone.amplitude.items():
            stated[channels.index(name), :, at] = half * amplitude**2
    known = np.concatenate(
        [
            _known_orders(channels, orders, causes),
            np.broadcast_to(np.array([cause.known for cause in causes.tones], dtype=bool), (len(channels), len(tones))),
        ],
        axis=1,
    )
    counts = campbell["n_frames"].values.astype(np.float64)
    is_tone = np.arange(centre.shape[1]) >= len(orders)
    return _Map(frequency, energy, counts), _Lines(centre, reach, stated, known, is_tone)


def _by_order(order_map: xr.Dataset, orders: tuple[AgreedOrder, ...], causes: Causes) -> tuple[_Map, _Lines]:
    """The order map as energies, and where the orders lie in it."""
    axis, channels = order_map["order"].values, order_map["channel"].values.tolist()
    half, enbw = _square_of_peak(order_map), float(order_map.attrs.get("enbw_bins", 1.5))
    energy = half * order_map["amplitude"].values.astype(np.float64) ** 2 / enbw
    energy[..., axis < STEADY_BINS * enbw * (axis[1] - axis[0])] = 0.0
    shape = (order_map.sizes["speed"], len(orders))
    centre = np.broadcast_to(np.array([agreed.order for agreed in orders]), shape)
    reach = np.full(shape, LINE_BINS * max(1.0, enbw / 1.5) * float(axis[1] - axis[0]))
    stated = np.full((len(channels), *shape), np.nan)
    for at, agreed in enumerate(orders):
        for line in agreed.lines:
            stated[channels.index(line.channel), line.seen, at] = half * line.amplitude**2
    counts = order_map["n_independent"].values.astype(np.float64)
    lines = _Lines(centre, reach, stated, _known_orders(channels, orders, causes), np.zeros(len(orders), dtype=bool))
    return _Map(axis, energy, counts), lines


def _square_of_peak(made: xr.Dataset) -> float:
    """Mean square of a line over its squared amplitude."""
    return 1.0 if made.attrs.get("amplitude_scaling") == "rms" else 0.5


def _group_width_rpm(campbell: xr.Dataset) -> float:
    """Width in rpm of a speed group of a run-up, whose groups touch; a stepped test's groups are narrow."""
    speed, width = np.sort(campbell["speed"].values), float(campbell.attrs["speed_bin_rpm"])
    return width if len(speed) > 2 and float(np.median(np.diff(speed))) < 1.5 * width else 0.0


def _put(into: Floats, speed: Floats, of_line: Floats, energy: Floats, near_rpm: float) -> None:
    """Put the ``energy`` of a line at its speeds ``of_line`` into the rows of ``speed`` nearest to them."""
    for rpm, value in zip(of_line, energy, strict=True):
        row = int(np.argmin(np.abs(speed - rpm)))
        if abs(speed[row] - rpm) <= near_rpm:
            into[row] = value if np.isnan(into[row]) else max(value, into[row])


def _known_orders(channels: list[str], orders: tuple[AgreedOrder, ...], causes: Causes) -> NDArray[np.bool_]:
    """Whether the cause of each order is known (channels, orders); where it is no line of a channel, by the others."""
    known = np.zeros((len(channels), len(orders)), dtype=bool)
    for at, agreed in enumerate(orders):
        known[:, at] = all(causes.orders[line.channel, agreed.order].known for line in agreed.lines)
        for line in agreed.lines:
            known[channels.index(line.channel), at] = causes.orders[line.channel, agreed.order].known
    return known


def _owners(axis: Floats, lines: _Lines) -> NDArray[np.int64]:
    """Line (rows, cells) to which each cell of ``axis`` belongs, the nearest within its reach; -1 for none."""
    owner = np.full((len(lines.centre), len(axis)), -1)
    for row, (centres, reaches) in enumerate(zip(lines.centre, lines.reach, strict=True)):
        nearest = np.full(len(axis), np.inf)
        first = np.searchsorted(axis, centres - reaches)
        last = np.searchsorted(axis, centres + reaches, side="right")
        for line, (a, b) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
            away = np.abs(axis[a:b] - centres[line])
            closer = away < nearest[a:b]
            owner[row, a:b][closer] = line
            nearest[a:b][closer] = away[closer]
    return owner


def _with_skirts(made: _Map, lines: _Lines, surface: Floats) -> _Lines:
    """The ``lines`` with a reach up to where the side lobes of their window sink into the floor.

    A Hann window shows a line x bins away with 1 / (π x³)² of its power at most.
    """
    if not lines.centre.size:
        return lines
    own = lines.reach.min() / LINE_BINS
    at = np.clip(np.searchsorted(made.axis, lines.centre), 0, len(made.axis) - 1)
    floor = surface[:, np.arange(len(at))[:, None], at]
    with np.errstate(invalid="ignore", divide="ignore"):
        height = np.where(floor > 0.0, np.nan_to_num(lines.stated) / floor, 0.0).max(axis=0)
    bins = (np.minimum(height, MOST_HEIGHT) / SUNK) ** (1 / 6) / np.pi ** (1 / 3)
    return replace(lines, reach=np.maximum(lines.reach, own * bins))


def _surface(made: _Map, owner: NDArray[np.int64], modal: ModalFit | None) -> tuple[Floats, bool]:
    """Energy expected in each cell without lines (channels, rows, cells); whether it comes from the fit ``modal``."""
    free = np.where(owner < 0, made.energy, np.nan)
    free[..., (made.energy == 0.0).all(axis=(0, 1))] = np.nan
    judged = modal is not None and modal.fitted_psd.size > 0
    if modal is not None and judged:
        shape = np.stack([_filled(made.axis, modal.frequency_hz, psd) for psd in modal.fitted_psd])
    else:
        shape = np.stack([_filled(made.axis, made.axis, _smoothed(_median(rows, axis=0))) for rows in free])
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = free / shape[:, None, :]
    # the median of a mean of n energies of noise is below its mean (Wilson and Hilferty 1931)
    gain = _median(ratio, axis=-1) / (1.0 - 1.0 / (9.0 * np.maximum(made.averages, 1.0))) ** 3
    return np.nan_to_num(gain)[..., None] * shape[:, None, :], judged


def _median(values: Floats, *, axis: int) -> Floats:
    """Median along ``axis`` without NaN; NaN where all are."""
    ordered = np.sort(values, axis=axis)
    count = np.count_nonzero(~np.isnan(ordered), axis=axis)
    middle = np.expand_dims(np.maximum(count - 1, 0) // 2, axis)
    return np.asarray(np.take_along_axis(ordered, middle, axis=axis).squeeze(axis))


def _filled(axis: Floats, at: Floats, values: Floats) -> Floats:
    """``values`` at ``at`` on ``axis``, by logarithms straight over what is not known; 0 where nothing is."""
    known = np.isfinite(values) & (values > 0.0)
    if not known.any():
        return np.zeros(len(axis))
    return np.asarray(np.exp(np.interp(axis, at[known], np.log(values[known]))))


def _smoothed(values: Floats) -> Floats:
    half = SMOOTHED_BINS // 2
    padded = np.pad(values, half, constant_values=np.nan)
    return _median(np.lib.stride_tricks.sliding_window_view(padded, SMOOTHED_BINS), axis=-1)


def _over_surface(
    made: _Map, owner: NDArray[np.int64], surface: Floats, modal: ModalFit, settings: IdentifySettings
) -> Floats:
    """Energy (channels, rows, cells) outside the lines that stands over the ``surface`` as noise does not."""
    free = (owner >= 0)[None] == np.zeros(made.energy.shape, dtype=bool)
    free &= (surface > 0.0) & (made.energy > 0.0)
    chance = min(settings.false_alarm_probability, MAP_CHANCE / max(1, made.energy.size))
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(free, made.energy / surface, np.nan)
        level = _level(ratio, made.averages[None, :], chance)
        over = np.where(ratio > level[..., None], made.energy - surface, 0.0)
        # what no single speed shows, all together may: the mean floor over its fit
        left = np.stack([_filled(made.axis, modal.frequency_hz, psd) for psd in modal.floor_psd])
        fitted = np.stack([_filled(made.axis, modal.frequency_hz, psd) for psd in modal.fitted_psd])
        mean_ratio = np.where(fitted > 0.0, left / fitted, np.nan)
    total = np.full(len(mean_ratio), made.averages.sum())
    mean_level = _level(mean_ratio, total, chance)
    standing = np.where(mean_ratio > mean_level[:, None], mean_ratio - 1.0, 0.0)
    everywhere = np.where(free & (over == 0.0), np.minimum(made.energy, standing[:, None, :] * surface), 0.0)
    return np.asarray(np.nan_to_num(over) + np.nan_to_num(everywhere))


def _level(ratio: Floats, averages: Floats, false_alarm_probability: float) -> Floats:
    """Level that the ``ratio`` (…, cells) of noise to its mean passes with the chance given: (…).

    A mean of n powers is gamma distributed; n is ``averages``, or what the scatter of the ratio itself tells if less:
    frames overlap, and a fitted surface is never exact.
    """
    logarithm = np.log(np.where(ratio > 0.0, ratio, np.nan))
    middle = _median(logarithm, axis=-1)[..., None]
    sigma = MAD_TO_SIGMA * _median(np.abs(logarithm - middle), axis=-1)
    n = np.maximum(0.5, np.minimum(averages, 1.0 / np.maximum(np.nan_to_num(sigma, nan=1.0), 1e-6) ** 2))
    return np.asarray(gammainccinv(n, false_alarm_probability) / n)


def _channel(
    number: int, made: _Map, lines: _Lines, owner: NDArray[np.int64], surface: Floats, unexplained: Floats
) -> dict[str, Any]:
    """Shares of one channel, and its mean square; rows without data take no part."""
    rows = np.flatnonzero(np.isfinite(made.energy[number]).all(axis=-1))
    energy, expected, owner = made.energy[number, rows], surface[number, rows], owner[rows]
    total, n_lines = float(energy.sum()), lines.centre.shape[1]
    of_line = np.zeros(n_lines)
    stated = lines.stated[number, rows]
    if n_lines:
        place = (np.arange(len(rows))[:, None] * n_lines + owner)[owner >= 0]
        there: Floats = _sums(place, energy[owner >= 0], stated.shape)
        floor: Floats = _sums(place, expected[owner >= 0], stated.shape)
        seen = np.isfinite(stated)
        cells = np.maximum(1.0, _sums(place, np.ones(len(place)), stated.shape))
        more = _more_than_noise(there, floor, np.nan_to_num(stated), cells, made.averages[rows])
        of_line += np.where(seen, np.clip(np.where(more, there - floor, stated), 0.0, there), 0.0).sum(axis=0)
        of_line += np.maximum(0.0, np.where(seen, 0.0, there - floor).sum(axis=0))
    known, tone = lines.known[number], lines.is_tone
    parts = {
        "orders": float(of_line[known & ~tone].sum()),
        "tones": float(of_line[known & tone].sum()),
        "unexplained_lines": float(of_line[~known].sum()),
        "unexplained_cells": float(np.nan_to_num(unexplained[number, rows]).sum()),
    }
    shares = {name: part / total if total > 0.0 else 0.0 for name, part in parts.items()}
    shares["unexplained"] = shares["unexplained_lines"] + shares["unexplained_cells"]
    rest = max(0.0, 1.0 - shares["orders"] - shares["tones"] - shares["unexplained"])
    return shares | {"modes_and_floor": rest if total > 0.0 else 0.0, "total": total / max(1, len(rows))}


def _sums(place: NDArray[np.int64], values: Floats, shape: tuple[int, ...]) -> Floats:
    """Sums of the ``values`` (n,) at each ``place`` (n,) of an array of the ``shape``."""
    return np.asarray(np.bincount(place, values, int(np.prod(shape))).reshape(shape), dtype=np.float64)


def _more_than_noise(
    there: Floats, floor: Floats, stated: Floats, cells: Floats, averages: Floats
) -> NDArray[np.bool_]:
    """Whether a line's ``cells`` hold more than its ``stated`` energy and the ``floor``: (rows, lines).

    The sum of so many powers of noise, and of what it makes of a line, scatters by this share of them.
    """
    each = floor / cells
    scatter = (np.sqrt(cells) * each + np.sqrt(2.0 * stated * each)) / np.sqrt(np.maximum(averages, 1.0))[:, None]
    return np.asarray(there - floor - stated > CLEAR_SIGMAS * scatter)
