"""Order tracks: named orders against speed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.orders.track_rows import OrderRows, TrackReader
from crankorder.quantities import flags_of, with_flags
from crankorder.settings import OrderSettings

BAND_HELD = 0.5
"""Share of a band, or of a main lobe, that must hold numbers for its sum to say something."""


def order_tracks(
    order_map: xr.Dataset,
    orders: list[float],
    *,
    settings: OrderSettings,
    frames: Sequence[xr.Dataset] = (),
    followed: Sequence[xr.Dataset] = (),
) -> xr.Dataset:
    """OrderTracks of ``orders`` (cycles per crank revolution) from the OrderMap ``order_map``, each where it is.

    On a bin of the map, amplitude, phase and 95 % intervals are those of the coherent average; between bins the
    amplitude is that of the ``frames`` (OrderFrames, or of the map's energy without them) at the exact order, apart
    from lines close by, and the phase is NaN. An order that was ``followed`` through a sweep (RecordingTracks) has the
    rows of that, at speeds of their own. ``band_rms`` is the RMS of everything within ``settings.band_width_orders``
    around the order, NaN where the map holds less than half of that. Orders above the map give NaN. The flags are
    those of the map and of what was followed. Speeds rise.
    """
    reader = TrackReader(order_map, frames=frames, followed=followed)
    axis, asked = order_map["order"].values, np.asarray(orders, dtype=float)
    resolution = float(axis[1] - axis[0])
    outside = asked > axis[-1] + 0.5 * resolution
    at = np.argsort(reader.speed_rpm, kind="stable")
    rows = [reader.rows(order, [other for other in orders if other != order]) for order in orders]
    values = {item.name: [getattr(one, item.name)[:, at] for one in rows] for item in fields(OrderRows)}
    band = _band_rms(order_map, asked, settings.band_width_orders)
    nearest = _nearest_row(reader.map_rpm, reader.speed_rpm)[at]
    values["band_rms"] = [band[:, nearest, number] for number in range(len(orders))]
    used = np.any([np.isfinite(one) for one in values["amplitude"]], axis=(0, 1)) if orders else np.ones(len(at), bool)
    # rows of the map that only sweeps went through hold nothing once all orders are followed
    kept = np.flatnonzero(used | (at < len(reader.map_rpm)) & ~_replaced(reader, at, values["amplitude"]))
    tracks = xr.Dataset(coords={k: v for k, v in order_map.coords.items() if "speed" not in v.dims and k != "order"})
    tracks["order"] = ("order", asked, {"units": "1", "long_name": "order"})
    tracks["speed"] = ("speed", reader.speed_rpm[at][kept], order_map["speed"].attrs)
    for name, units, long_name in _VARIABLES:
        shape = (order_map.sizes["channel"], len(kept))
        given = np.array([one[:, kept] for one in values[name]]).reshape(len(orders), *shape)
        shown = np.where(outside[:, None, None], 0.0 if name == "degrees_of_freedom" else np.nan, given)
        words = {"units": units, "long_name": long_name}
        tracks[name] = (("channel", "order", "speed"), np.moveaxis(shown, 0, 1), words)
    method = np.array(["vold_kalman" if reader.follows(order) else "frames" for order in orders], dtype="<U16")
    tracks.coords["track_method"] = ("order", method, {"units": "1", "long_name": "how the order was followed"})
    tracks.attrs = {key: order_map.attrs[key] for key in ("amplitude_scaling", "phase_reference", "cycle_known")}
    tracks.attrs |= {"band_width_orders": settings.band_width_orders, "speed_bin_rpm": settings.speed_bin_rpm}
    flags = flags_of(order_map)
    return with_flags(tracks, flags + [flag for item in reader.items for flag in flags_of(item) if flag not in flags])


def _replaced(reader: TrackReader, at: NDArray[np.int64], amplitude: list[NDArray[np.float64]]) -> NDArray[np.bool_]:
    """Which rows hold no number of any order although there are sweeps whose rows stand in their place."""
    if not reader.items or not amplitude:
        return np.zeros(len(at), dtype=bool)
    return np.asarray(~np.any(np.isfinite(amplitude), axis=(0, 1)))


def _nearest_row(known_rpm: NDArray[np.float64], speed_rpm: NDArray[np.float64]) -> NDArray[np.int64]:
    """Number of the row of ``known_rpm`` nearest to each of ``speed_rpm``, whose first ones they are themselves."""
    apart = np.abs(speed_rpm[:, None] - known_rpm)
    nearest = np.where(np.isnan(apart), np.inf, apart).argmin(axis=1)
    nearest[: len(known_rpm)] = np.arange(len(known_rpm))
    return np.asarray(nearest)


def _band_rms(order_map: xr.Dataset, orders: NDArray[np.float64], width_orders: float) -> NDArray[np.float64]:
    """RMS (channels, speeds, orders) of everything within ``width_orders`` around each of ``orders``."""
    level = order_map["amplitude"].values
    largest = np.nanmax(level, axis=(1, 2), keepdims=True, initial=0.0)
    unit = np.where(largest > 0.0, np.ldexp(1.0, np.frexp(largest)[1] - 1), 1.0)
    axis = order_map["order"].values
    resolution = float(axis[1] - axis[0])
    band = _band_sum((level / unit) ** 2, orders / resolution, width_orders / resolution, least_share=BAND_HELD)
    return np.asarray(unit * np.sqrt(band / (2.0 * float(order_map.attrs["enbw_bins"]))))


_VARIABLES = (
    ("amplitude", "see unit", "peak amplitude"),
    ("phase", "degree", "phase from top dead centre"),
    ("standard_error", "see unit", "standard error of amplitude"),
    ("degrees_of_freedom", "1", "degrees of freedom of standard_error"),
    ("amplitude_low", "see unit", "lower end of the 95 % interval of amplitude"),
    ("amplitude_high", "see unit", "upper end of the 95 % interval of amplitude"),
    ("phase_ci95", "degree", "half width of the 95 % interval of phase; 180: unknown"),
    ("band_rms", "see unit", "RMS within the band around the order"),
)


def followed_orders(order_map: xr.Dataset, findings: dict[str, Any], settings: OrderSettings) -> list[float]:
    """Orders to follow: those that ``findings`` name and those that ``settings`` ask for.

    Each found one stands where ``track_order`` of the OrderMap ``order_map`` says.
    """
    cycle = int(order_map.attrs["revs_per_cycle"])
    found = (
        track_order(record["order"], record["order_ci95"], record["lock"], revs_per_cycle=cycle)
        for record in findings["orders"]
    )
    return all_tracked(found, settings)


def all_tracked(found: Iterable[float], settings: OrderSettings) -> list[float]:
    """The orders ``found`` and those that ``settings`` ask for, each once, rising."""
    return sorted({round(float(order), 9) for order in settings.track_orders} | set(found))


def track_order(order: float, order_ci95: Sequence[float], lock: str, *, revs_per_cycle: int) -> float:
    """The number at which the track of a found ``order`` stands, with its interval ``order_ci95`` (low, high).

    An order that is locked to the shaft (``lock`` "locked"), or may be ("undecided" with a multiple of the cycle's
    frequency in its interval; ``revs_per_cycle`` 1 or 2), stands on that multiple, where its phase is known; any other
    where it was found. An interval that would hold a multiple wherever it lay says nothing of it.
    """
    multiple = round(order * revs_per_cycle) / revs_per_cycle
    low, high = order_ci95
    may_be = low <= multiple <= high and high - low < 0.5 / revs_per_cycle
    locked = lock == "locked" or (lock == "undecided" and may_be)
    return round(multiple if locked else order, 6)


def _band_sum(
    power: NDArray[np.float64], centre: NDArray[np.float64], width: float, *, least_share: float
) -> NDArray[np.float64]:
    """Sum of ``power`` (…, bins) over ``width`` bins around each ``centre`` (in bins); part bins count in part.

    NaN where less than ``least_share`` of the width holds numbers.
    """
    missing = np.isnan(power)
    held = _sum_around((~missing).astype(np.float64), centre, width) if missing.any() else np.full(1, width)
    return np.where(held < least_share * width, np.nan, _sum_around(power, centre, width))


def _sum_around(power: NDArray[np.float64], centre: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    filled = np.nan_to_num(power)
    cumulative = np.concatenate([np.zeros_like(filled[..., :1]), np.cumsum(filled, axis=-1)], axis=-1)

    def up_to(edge: NDArray[np.float64]) -> NDArray[np.float64]:
        edge = np.clip(edge + 0.5, 0.0, cumulative.shape[-1] - 1.0)
        low = np.minimum(edge.astype(int), cumulative.shape[-1] - 2)
        share = edge - low
        return np.asarray(cumulative[..., low] * (1.0 - share) + cumulative[..., low + 1] * share)

    return up_to(centre + 0.5 * width) - up_to(centre - 0.5 * width)
