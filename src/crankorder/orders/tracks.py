"""Order tracks: named orders against speed."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.settings import OrderSettings

MAIN_LOBE_BINS = 4.0
"""Width of the main lobe of a Hann window: what lies within it is the line's."""


def order_tracks(order_map: xr.Dataset, orders: list[float], *, settings: OrderSettings) -> xr.Dataset:
    """OrderTracks of ``orders`` (cycles per crank revolution) from the OrderMap ``order_map``.

    On a bin of the map, amplitude, phase and standard error are those of the coherent average; between bins the
    amplitude is that of the energy in the main lobe and the phase is NaN. ``band_rms`` is the RMS of everything
    within ``settings.band_width_orders`` around the order. Orders above the map give NaN.
    """
    axis = order_map["order"].values
    resolution = float(axis[1] - axis[0])
    nearest = np.clip(np.rint(np.asarray(orders) / resolution).astype(int), 0, len(axis) - 1)
    on_bin = np.abs(axis[nearest] - orders) < 1e-6
    outside = np.asarray(orders) > axis[-1] + 0.5 * resolution
    enbw = float(order_map.attrs["enbw_bins"])
    power = order_map["amplitude"].values ** 2
    lobe = _band_sum(power, np.asarray(orders) / resolution, MAIN_LOBE_BINS) / enbw
    amplitude = np.where(on_bin, order_map["coherent_amplitude"].values[..., nearest], np.sqrt(lobe))
    phase = np.where(on_bin, order_map["phase"].values[..., nearest], np.nan)
    error = order_map["standard_error"].values[..., nearest]
    half = 0.5 * settings.band_width_orders / resolution
    band = np.sqrt(_band_sum(power, np.asarray(orders) / resolution, 2.0 * half) / (2.0 * enbw))
    tracks = xr.Dataset(coords={**{k: v for k, v in order_map.coords.items() if k != "order"}})
    tracks["order"] = ("order", np.asarray(orders, dtype=float), {"units": "1", "long_name": "order"})
    for name, values, units, long_name in (
        ("amplitude", amplitude, "see unit", "peak amplitude"),
        ("phase", phase, "degree", "phase from top dead centre"),
        ("standard_error", error, "see unit", "standard error of amplitude"),
        ("band_rms", band, "see unit", "RMS within the band around the order"),
    ):
        values = np.where(outside, np.nan, values)
        tracks[name] = (
            ("channel", "order", "speed"),
            np.moveaxis(values, 2, 1),
            {"units": units, "long_name": long_name},
        )
    tracks.attrs = {key: order_map.attrs[key] for key in ("amplitude_scaling", "phase_reference", "cycle_known")}
    tracks.attrs["band_width_orders"] = settings.band_width_orders
    return tracks


def followed_orders(order_map: xr.Dataset, findings: dict[str, Any], settings: OrderSettings) -> list[float]:
    """Orders to follow: those that ``findings`` name and those that ``settings`` ask for.

    An order that is locked to the shaft, and any within a quarter of a bin of ``order_map``, is followed on its bin,
    where its phase is known; one that slips is followed where it was found.
    """
    resolution = 1.0 / float(order_map.attrs["revs_per_frame"])
    orders = {float(order) for order in settings.track_orders}
    for record in findings["orders"]:
        on_bin = round(record["order"] / resolution) * resolution
        close = record["locked"] or abs(record["order"] - on_bin) < 0.25 * resolution
        orders.add(round(on_bin if close else record["order"], 6))
    return sorted(orders)


def _band_sum(power: NDArray[np.float64], centre: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """Sum of ``power`` (…, bins) over ``width`` bins around each ``centre`` (in bins); part bins count in part."""
    filled = np.nan_to_num(power)
    cumulative = np.concatenate([np.zeros_like(filled[..., :1]), np.cumsum(filled, axis=-1)], axis=-1)

    def up_to(edge: NDArray[np.float64]) -> NDArray[np.float64]:
        edge = np.clip(edge + 0.5, 0.0, cumulative.shape[-1] - 1.0)
        low = np.minimum(edge.astype(int), cumulative.shape[-1] - 2)
        share = edge - low
        return np.asarray(cumulative[..., low] * (1.0 - share) + cumulative[..., low + 1] * share)

    return up_to(centre + 0.5 * width) - up_to(centre - 0.5 * width)
