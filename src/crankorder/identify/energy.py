"""Where the energy of a test lies: in lines whose cause is known, in modes and floor, and in what nothing explains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from scipy.special import gammainccinv

from crankorder.findings import Energy, EnergyShares
from crankorder.identify.explain import Causes
from crankorder.identify.found import AgreedOrders, ModalFit
from crankorder.identify.lines.line_evidence import NUMBERS as LINE_EVIDENCE
from crankorder.identify.lines.line_evidence import highest_of_three, log_chance_of_kurtosis, noise_level
from crankorder.identify.modes.floor import group_width_rpm
from crankorder.quantities import Bools, Floats, Ints
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-explain.toml", "energy")


MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


def energy_shares(
    campbell: xr.Dataset,
    order_map: xr.Dataset,
    orders: AgreedOrders,
    modal: ModalFit,
    causes: Causes,
    *,
    settings: IdentifySettings,
) -> tuple[Energy, float]:
    """Shares of the energy of the whole recorded band, and the fraction of it that nothing explains.

    Of each channel, as fractions of its mean square (``total``, in ``unit``) over all speeds alike, without the mean:
    ``orders`` and ``tones`` whose cause is known, ``modes_and_floor``, ``unexplained``; they add up to 1.
    The band is that of orders and Campbell map together: what the latter does not reach is read in the order map, up to
    ``band_hz`` at the fastest speed.
    ``unexplained`` is ``unexplained_lines`` (orders and tones without a known cause) and ``unexplained_cells`` (what
    cells of the map have above the fitted surface where they stand over it; noise puts any cell of the map there with a
    chance of 1 %, and no single one with more than ``settings.false_alarm_probability``; where none was fitted, lines
    that nobody named and that are sharper or steadier than ``settings.least_damping_ratio`` allows). A line has
    what stands over the surface in its own cells; where several share cells, as their amplitudes have it.

    The fraction is the mean over the channels of unexplained / (orders + tones + unexplained):
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
    if campbell.sizes["speed"]:
        judged = modal.fitted_psd.size > 0
        parts = _parts(by_frequency(campbell, orders, modal, causes), modal if judged else None, settings)
        above = beyond(campbell, order_map, orders, causes)
        parts += 0.0 if above is None else _parts(above, None, settings)
    else:
        judged, parts = False, _parts(by_order(order_map, orders, causes), None, settings)
    total = parts.pop("total")
    shares = parts.div(total.where(total > 0.0, np.inf), axis=0)
    lines = shares[["orders", "tones", "unexplained_lines"]].sum(axis=1)
    unexplained = shares["unexplained_lines"] + shares["unexplained_cells"]
    floor = (1.0 - shares["orders"] - shares["tones"] - unexplained).clip(lower=0.0).where(total > 0.0, 0.0)
    shares = shares.assign(unexplained=unexplained, modes_and_floor=floor, total=total)
    names, units = order_map["channel"].values.tolist(), order_map["unit"].values.tolist()
    channels = tuple(
        EnergyShares(channel=name, unit=f"({unit})²", **row)
        for name, unit, row in zip(names, units, shares.to_dict("records"), strict=True)
    )
    # of what is not broadband; of all where there is no line, and nothing where nothing is unexplained
    fractions = (unexplained / (lines + shares["unexplained_cells"])).where(lines > 0.0, unexplained)
    fraction = fractions[(lines > 0.0) | (unexplained > 0.0)].mean()
    energy = Energy(cells_judged=judged, band_hz=band_end_hz(campbell, order_map), channels=channels)
    return energy, float(np.nan_to_num(fraction))


def _parts(grid: EnergyMap, modal: ModalFit | None, settings: IdentifySettings) -> pd.DataFrame:
    """Mean square by channel (rows) of each part and in ``total``, over the speeds of ``grid`` that hold data.

    What stands over the fitted surface of ``modal``, without one over that of the map itself, is unexplained.
    """
    surface = _surface(grid, _owners(grid), modal)
    owner = _owners(_with_skirts(grid, surface))
    chance = min(settings.false_alarm_probability, NUMBERS.map_chance / max(1, grid.energy.size))
    unexplained = (
        _lines_alone(grid, owner, surface, settings.least_damping_ratio, chance)
        if modal is None
        else _over_surface(grid, owner, surface, modal, chance)
    )
    held = np.asarray(np.isfinite(grid.energy).all(axis=-1))
    counted = held[..., None] * grid.share
    energy = counted * np.nan_to_num(grid.energy)
    over = energy - counted * surface
    of_line = np.array([_energy_of_lines(grid, owner, *of) for of in zip(grid.stated, over, strict=True)])
    parts = {
        "orders": (of_line * (grid.known & ~grid.is_tone)).sum(axis=1),
        "tones": (of_line * (grid.known & grid.is_tone)).sum(axis=1),
        "unexplained_lines": (of_line * ~grid.known).sum(axis=1),
        "unexplained_cells": (counted * np.nan_to_num(unexplained)).sum(axis=(1, 2)),
        "total": energy.sum(axis=(1, 2)),
    }
    return pd.DataFrame(parts).div(np.maximum(1, held.sum(axis=1)), axis=0)


def _owners(grid: EnergyMap) -> Ints:
    """Line (rows, cells) to which each cell of ``grid`` belongs, the nearest within its reach; -1 for none."""
    axis, centre = grid.axis, grid.centre
    owner, nearest = np.full(grid.share.shape, -1), np.full(grid.share.shape, np.inf)
    first = np.searchsorted(axis, centre - grid.reach)
    last = np.searchsorted(axis, centre + grid.reach, side="right")
    for row, line in np.ndindex(centre.shape):
        own = row, slice(first[row, line], last[row, line])
        away = np.abs(axis[own[1]] - centre[row, line])
        closer = away < nearest[own]
        owner[own][closer], nearest[own][closer] = line, away[closer]
    return owner


def _with_skirts(grid: EnergyMap, surface: Floats) -> EnergyMap:
    """``grid`` whose lines reach to where the side lobes of their window sink into the floor, the ``surface``."""
    if not grid.centre.size:
        return grid
    at = np.clip(np.searchsorted(grid.axis, grid.centre), 0, len(grid.axis) - 1)
    floor = surface[:, np.arange(len(at))[:, None], at]
    with np.errstate(invalid="ignore", divide="ignore"):
        height = np.where(floor > 0.0, np.nan_to_num(grid.stated) / floor, 0.0).max(axis=0)
    skirts = grid.reach.min() / MAP_NUMBERS.line_bins * _skirt_bins(np.minimum(height, NUMBERS.most_height_ratio))
    return replace(grid, reach=np.maximum(grid.reach, skirts))


def _surface(grid: EnergyMap, owner: Ints, modal: ModalFit | None) -> Floats:
    """Energy expected in each cell without lines (channels, rows, cells), from the fit ``modal`` where there is one."""
    free = np.where(owner < 0, grid.energy, np.nan)
    free[..., (grid.energy == 0.0).all(axis=(0, 1))] = np.nan
    if modal is not None:
        shape = np.stack([_filled(grid.axis, modal.frequency_hz, psd) for psd in modal.fitted_psd])
    else:
        half = NUMBERS.smoothed_bins // 2
        padded = [np.pad(_median(rows, axis=0), half, constant_values=np.nan) for rows in free]
        windows = [np.lib.stride_tricks.sliding_window_view(values, NUMBERS.smoothed_bins) for values in padded]
        shape = np.stack([_filled(grid.axis, grid.axis, _median(window, axis=-1)) for window in windows])
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = free / shape[:, None, :]
    # the median of a mean of n energies of noise is below its mean (Wilson and Hilferty 1931)
    gain = _median(ratio, axis=-1) / (1.0 - 1.0 / (9.0 * np.maximum(grid.averages, 1.0))) ** 3
    return np.nan_to_num(gain)[..., None] * shape[:, None, :]


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


def _over_surface(grid: EnergyMap, owner: Ints, surface: Floats, modal: ModalFit, chance: float) -> Floats:
    """Energy (channels, rows, cells) outside the lines that stands over the ``surface`` as noise does not."""
    free = (owner < 0) & (surface > 0.0) & (grid.energy > 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(free, grid.energy / surface, np.nan)
        level = _level(ratio, grid.averages[None, :], chance)
        over = np.where(ratio > level[..., None], grid.energy - surface, 0.0)
        # what no single speed shows, all together may: the mean floor over its fit
        left = np.stack([_filled(grid.axis, modal.frequency_hz, psd) for psd in modal.floor_psd])
        fitted = np.stack([_filled(grid.axis, modal.frequency_hz, psd) for psd in modal.fitted_psd])
        mean_ratio = np.where(fitted > 0.0, left / fitted, np.nan)
    mean_level = _level(mean_ratio, np.full(len(mean_ratio), grid.averages.sum()), chance)
    standing = np.where(mean_ratio > mean_level[:, None], mean_ratio - 1.0, 0.0)
    everywhere = np.where(free & (over == 0.0), np.minimum(grid.energy, standing[:, None, :] * surface), 0.0)
    return np.asarray(np.nan_to_num(over) + np.nan_to_num(everywhere))


def _lines_alone(grid: EnergyMap, owner: Ints, surface: Floats, least_damping_ratio: float, chance: float) -> Floats:
    """Energy (channels, rows, cells) over the ``surface`` in lines that nobody named, where no surface was fitted.

    Such a line is sharper, or steadier from frame to frame, than the least damped natural frequency that noise rings.
    """
    unexplained = np.zeros(grid.energy.shape)
    if grid.kurtosis is None:
        return unexplained
    step = float(grid.axis[1] - grid.axis[0])
    least = least_damping_ratio * np.maximum(grid.axis, step) / step
    level = np.array([noise_level(max(1.0, float(n)), len(NUMBERS.skirt_bins), chance) for n in grid.averages])[:, None]
    skirts = 1.0 / np.mean([1.0 / (1.0 + (away / least) ** 2) for away in NUMBERS.skirt_bins], axis=0)
    with np.errstate(invalid="ignore"):
        sharp = (grid.energy > level * skirts * _beside(grid.energy)) & (grid.kurtosis < LINE_EVIDENCE.steady_kurtosis)
        stands = (grid.energy > level * surface) & (sharp | _steady(grid, least, chance)) & (owner < 0)
    stands &= highest_of_three(grid.energy) & (surface > 0.0) & (grid.averages >= 2.0)[:, None]
    cells = np.arange(len(grid.axis))
    for channel, row, at in zip(*np.nonzero(stands), strict=True):
        height = min(float(grid.energy[channel, row, at] / surface[channel, row, at]), NUMBERS.most_height_ratio)
        own = (np.abs(cells - at) <= max(MAP_NUMBERS.line_bins, _skirt_bins(height))) & (owner[row] < 0)
        over = grid.energy[channel, row] - surface[channel, row]
        unexplained[channel, row] = np.where(own, np.maximum(over, 0.0), unexplained[channel, row])
    return unexplained


def _steady(grid: EnergyMap, least: Floats, chance: float) -> Bools:
    """Where noise that rings over 2 ``least`` cells (cells,) is so steady with less than ``chance``.

    Independent spectra begin half a frame apart; what rings on from one to the next makes them fewer.
    """
    assert grid.kurtosis is not None
    frames = np.maximum(grid.averages[:, None] * -np.expm1(-2.0 * np.pi * least), 2.0)
    is_seldom = log_chance_of_kurtosis(np.nan_to_num(grid.kurtosis, nan=1.0), frames) < np.log(chance)
    return np.asarray(is_seldom & (grid.kurtosis < LINE_EVIDENCE.steady_kurtosis))


def _beside(energy: Floats) -> Floats:
    """Mean ``energy`` (…, cells) of the cells ``skirt_bins`` away, on the side where it is less: there may be a line.

    What rings leaves its skirts on both sides.
    """
    reach, n = max(NUMBERS.skirt_bins), energy.shape[-1]
    padded = np.pad(energy, ((0, 0), (0, 0), (reach, reach)), constant_values=np.inf)
    below, above = ([padded[..., reach + k * sign :][..., :n] for k in NUMBERS.skirt_bins] for sign in (-1, 1))
    return np.asarray(np.minimum(np.mean(below, axis=0), np.mean(above, axis=0)))


def _skirt_bins(height: Any) -> Any:
    """Bins up to which the side lobes of a line that stands ``height`` times over its floor are seen over it.

    A Hann window shows a line x bins away with 1 / (π x³)² of its power at most.
    """
    return (height / NUMBERS.sunk_share) ** (1 / 6) / np.pi ** (1 / 3)


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


def _energy_of_lines(grid: EnergyMap, owner: Ints, stated: Floats, over: Floats) -> Floats:
    """Energy of each line in one channel, summed over the rows: what its cells have ``over`` (rows, cells) the surface.

    Lines whose main lobes meet share that as their ``stated`` (rows, lines) energies have it: no cell tells which of
    them made it.
    """
    shape = grid.centre.shape
    if not shape[1]:
        return np.zeros(0)
    place = (np.arange(shape[0])[:, None] * shape[1] + owner)[owner >= 0]
    group = _groups(grid.centre, MAP_NUMBERS.line_bins * float(grid.axis[1] - grid.axis[0]))

    def together(values: Floats) -> Floats:
        return np.asarray(_sums(group.ravel(), values.ravel(), shape).ravel()[group])

    weight = np.nan_to_num(stated) + 1e-150  # alike where none of a group was seen
    part = weight / together(weight)
    return np.asarray(np.maximum(0.0, (part * together(_sums(place, over[owner >= 0], shape))).sum(axis=0)))


def _groups(centre: Floats, near: float) -> Ints:
    """Place of the group of each line (rows, lines) in an array of that shape; chains of lines ``near`` each other."""
    rank, group = np.argsort(centre, axis=1), np.empty(centre.shape, dtype=np.int64)
    apart = np.diff(np.take_along_axis(centre, rank, axis=1), axis=1, prepend=-np.inf) > near
    np.put_along_axis(group, rank, np.cumsum(apart, axis=1) - 1, axis=1)
    return np.asarray(group + np.arange(len(centre))[:, None] * centre.shape[1])


def _sums(place: Ints, values: Floats, shape: tuple[int, ...]) -> Floats:
    """Sums of the ``values`` (n,) at each ``place`` (n,) of an array of the ``shape``."""
    return np.asarray(np.bincount(place, values, int(np.prod(shape))).reshape(shape), dtype=np.float64)


MAP_NUMBERS = MethodNumbers("5-identify-explain.toml", "energy_maps")


@dataclass(frozen=True)
class EnergyMap:
    """Mean square (channels, rows, cells) in each cell of ``axis`` (cells,) of ``averages`` (rows,) frames, and lines.

    ``centre`` and ``reach`` (rows, lines) are the places of the lines on the axis, ``stated`` (channels, rows, lines)
    the energy measured, NaN where a line was not seen; ``known`` (channels, lines) whether its cause is, ``is_tone``
    (lines,) whether it stays at its frequency. ``share`` (rows, cells) is what of each cell counts: two maps of one
    band meet within a cell. ``kurtosis`` (channels, rows, cells) is the spectral kurtosis, None where it was not
    worked out.
    """

    axis: Floats
    energy: Floats
    averages: Floats
    share: Floats
    centre: Floats
    reach: Floats
    stated: Floats
    known: Bools
    is_tone: Bools
    kurtosis: Floats | None = None


def by_frequency(campbell: xr.Dataset, orders: AgreedOrders, modal: ModalFit, causes: Causes) -> EnergyMap:
    """The ``campbell`` map as energies, and where ``orders`` and tones of ``modal`` lie in it, by their ``causes``."""
    resolution, enbw_hz = float(campbell.attrs["resolution_hz"]), float(campbell.attrs["enbw_hz"])
    frequency, speed = campbell["frequency"].values, campbell["speed"].values
    channels = campbell["channel"].values.tolist()
    energy = campbell["psd"].values.astype(np.float64) * resolution
    energy[..., frequency < MAP_NUMBERS.steady_bins * enbw_hz] = 0.0
    own = MAP_NUMBERS.line_bins * max(resolution, enbw_hz / 1.5)
    number = np.array([agreed.order for agreed in orders])
    wander = 0.5 * (group_width_rpm(campbell) / 60.0 + float(campbell.attrs.get("sweep_hz_per_order", 0.0)))
    tones = np.array([tone.frequency_hz for tone in modal.tones])
    centre = np.concatenate([np.outer(speed / 60.0, number), np.broadcast_to(tones, (len(speed), len(tones)))], axis=1)
    reach = np.broadcast_to(np.concatenate([own + wander * number, np.full(len(tones), own)]), centre.shape)
    half = _square_of_peak(campbell)
    stated = np.full((len(channels), len(speed), centre.shape[1]), np.nan)
    near_rpm = max(0.5 * float(campbell.attrs["speed_bin_rpm"]), 1e-3)
    for at, agreed in enumerate(orders):
        for line in agreed.lines:
            away = np.abs(speed - line.speed_rpm[:, None])
            row, near = away.argmin(axis=1), away.min(axis=1) <= near_rpm
            np.fmax.at(stated[channels.index(line.channel), :, at], row[near], half * line.amplitude[near] ** 2)
    for at, tone in enumerate(modal.tones, start=len(orders)):
        for name, (amplitude, _) in tone.amplitude.items():
            stated[channels.index(name), :, at] = half * amplitude**2
    known_tones = np.tile(np.array([cause.known for cause in causes.tones], dtype=bool), (len(channels), 1))
    known = np.concatenate([_known_orders(channels, orders, causes), known_tones], axis=1)
    counts = campbell["n_frames"].values.astype(np.float64)
    is_tone = np.arange(centre.shape[1]) >= len(orders)
    return EnergyMap(frequency, energy, counts, np.ones(energy.shape[1:]), centre, reach, stated, known, is_tone)


def by_order(order_map: xr.Dataset, orders: AgreedOrders, causes: Causes) -> EnergyMap:
    """The ``order_map`` as energies, and where the ``orders`` lie in it, by their ``causes``."""
    axis, channels = order_map["order"].values, order_map["channel"].values.tolist()
    half, enbw = _square_of_peak(order_map), float(order_map.attrs.get("enbw_bins", 1.5))
    energy = half * order_map["amplitude"].values.astype(np.float64) ** 2 / enbw
    energy[..., axis < MAP_NUMBERS.steady_bins * enbw * (axis[1] - axis[0])] = 0.0
    shape = (order_map.sizes["speed"], len(orders))
    centre = np.broadcast_to(np.array([agreed.order for agreed in orders]), shape)
    reach = np.full(shape, MAP_NUMBERS.line_bins * max(1.0, enbw / 1.5) * float(axis[1] - axis[0]))
    stated = np.full((len(channels), *shape), np.nan)
    for at, agreed in enumerate(orders):
        for line in agreed.lines:
            stated[channels.index(line.channel), line.seen, at] = half * line.amplitude**2
    counts = order_map["n_independent"].values.astype(np.float64)
    known, is_tone = _known_orders(channels, orders, causes), np.zeros(len(orders), dtype=bool)
    kurtosis = order_map["spectral_kurtosis"].values if "spectral_kurtosis" in order_map else None
    whole = np.ones(energy.shape[1:])
    return EnergyMap(axis, energy, counts, whole, centre, reach, stated, known, is_tone, kurtosis)


def beyond(campbell: xr.Dataset, order_map: xr.Dataset, orders: AgreedOrders, causes: Causes) -> EnergyMap | None:
    """What the ``order_map`` holds above the end of the ``campbell`` map, of ``orders`` with their ``causes``.

    None where it ends below at every speed.
    """
    if order_map.sizes.get("order", 0) < 2 or not order_map.sizes["speed"]:
        return None
    grid = by_order(order_map, orders, causes)
    ends_hz = float(campbell["frequency"].values[-1]) + 0.5 * float(campbell.attrs["resolution_hz"])
    per_order = np.nan_to_num(order_map["speed"].values)[:, None] / 60.0
    half = 0.5 * float(grid.axis[1] - grid.axis[0])
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.nan_to_num(np.clip((grid.axis + half - ends_hz / per_order) / (2.0 * half), 0.0, 1.0))
    return replace(grid, share=share) if share.any() else None


def band_end_hz(campbell: xr.Dataset, order_map: xr.Dataset) -> float | None:
    """Highest frequency that ``campbell`` and ``order_map`` hold at any speed; None where it is not known.

    An order beyond half the sampling rate has no amplitude there.
    """
    ends = [float(campbell["frequency"].values[-1])] if campbell.sizes["speed"] else []
    if ends and order_map.sizes.get("order", 0) > 1:
        seen = np.isfinite(order_map["amplitude"].values).any(axis=0)
        hertz = order_map["order"].values * order_map["speed"].values[:, None] / 60.0
        ends.append(float(np.max(hertz, where=seen & np.isfinite(hertz), initial=0.0)))
    return max(ends, default=None)


def _square_of_peak(dataset: xr.Dataset) -> float:
    """Mean square of a line over its squared amplitude."""
    return 1.0 if dataset.attrs.get("amplitude_scaling") == "rms" else 0.5


def _known_orders(channels: list[str], orders: AgreedOrders, causes: Causes) -> Bools:
    """Whether the cause of each order is known (channels, orders); where it is no line of a channel, by the others."""
    known = np.zeros((len(channels), len(orders)), dtype=bool)
    for at, agreed in enumerate(orders):
        own = {line.channel: causes.orders[line.channel, agreed.order].known for line in agreed.lines}
        known[:, at] = [own.get(channel, all(own.values())) for channel in channels]
    return known
