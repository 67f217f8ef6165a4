"""The maps in which the energy of a test is looked for, and where its lines lie in them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.explain import Causes
from crankorder.identify.found import AgreedOrder, ModalFit
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="energy_maps"):
    line_bins: float
    steady_bins: float


NUMBERS = _Numbers.load()

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class EnergyLines:
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
class EnergyMap:
    """Mean square (channels, rows, cells) in each cell of ``axis`` (cells,), from ``averages`` (rows,) frames.

    ``share`` (rows, cells) is what of each cell counts: two maps of one band meet within a cell. ``kurtosis``
    (channels, rows, cells) is the spectral kurtosis, None where it was not worked out.
    """

    axis: Floats
    energy: Floats
    averages: Floats
    share: Floats
    kurtosis: Floats | None = None


def by_frequency(
    campbell: xr.Dataset, orders: tuple[AgreedOrder, ...], modal: ModalFit, causes: Causes
) -> tuple[EnergyMap, EnergyLines]:
    """The ``campbell`` map as energies, and where ``orders`` and tones of ``modal`` lie in it, by their ``causes``."""
    resolution, enbw_hz = float(campbell.attrs["resolution_hz"]), float(campbell.attrs["enbw_hz"])
    frequency, speed = campbell["frequency"].values, campbell["speed"].values
    channels = campbell["channel"].values.tolist()
    energy = campbell["psd"].values.astype(np.float64) * resolution
    energy[..., frequency < NUMBERS.steady_bins * enbw_hz] = 0.0
    own = NUMBERS.line_bins * max(resolution, enbw_hz / 1.5)
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
    whole = np.ones(energy.shape[1:])
    return EnergyMap(frequency, energy, counts, whole), EnergyLines(centre, reach, stated, known, is_tone)


def by_order(order_map: xr.Dataset, orders: tuple[AgreedOrder, ...], causes: Causes) -> tuple[EnergyMap, EnergyLines]:
    """The ``order_map`` as energies, and where the ``orders`` lie in it, by their ``causes``."""
    axis, channels = order_map["order"].values, order_map["channel"].values.tolist()
    half, enbw = _square_of_peak(order_map), float(order_map.attrs.get("enbw_bins", 1.5))
    energy = half * order_map["amplitude"].values.astype(np.float64) ** 2 / enbw
    energy[..., axis < NUMBERS.steady_bins * enbw * (axis[1] - axis[0])] = 0.0
    shape = (order_map.sizes["speed"], len(orders))
    centre = np.broadcast_to(np.array([agreed.order for agreed in orders]), shape)
    reach = np.full(shape, NUMBERS.line_bins * max(1.0, enbw / 1.5) * float(axis[1] - axis[0]))
    stated = np.full((len(channels), *shape), np.nan)
    for at, agreed in enumerate(orders):
        for line in agreed.lines:
            stated[channels.index(line.channel), line.seen, at] = half * line.amplitude**2
    counts = order_map["n_independent"].values.astype(np.float64)
    lines = EnergyLines(
        centre, reach, stated, _known_orders(channels, orders, causes), np.zeros(len(orders), dtype=bool)
    )
    known = order_map["spectral_kurtosis"].values if "spectral_kurtosis" in order_map else None
    return EnergyMap(axis, energy, counts, np.ones(energy.shape[1:]), known), lines


def beyond(
    campbell: xr.Dataset, order_map: xr.Dataset, orders: tuple[AgreedOrder, ...], causes: Causes
) -> tuple[EnergyMap, EnergyLines] | None:
    """What the ``order_map`` holds above the end of the ``campbell`` map, of ``orders`` with their ``causes``.

    None where it ends below at every speed.
    """
    if order_map.sizes.get("order", 0) < 2 or not order_map.sizes["speed"]:
        return None
    made, lines = by_order(order_map, orders, causes)
    ends_hz = float(campbell["frequency"].values[-1]) + 0.5 * float(campbell.attrs["resolution_hz"])
    per_order = np.nan_to_num(order_map["speed"].values)[:, None] / 60.0
    half = 0.5 * float(made.axis[1] - made.axis[0])
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.nan_to_num(np.clip((made.axis + half - ends_hz / per_order) / (2.0 * half), 0.0, 1.0))
    return (replace(made, share=share), lines) if share.any() else None


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
