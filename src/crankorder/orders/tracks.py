"""Order tracks: named orders against speed."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.orders.intervals import beside_bins, energy_interval, noise_beside
from crankorder.quantities import flags_of, with_flags
from crankorder.settings import OrderSettings

MAIN_LOBE_BINS = 4.0
"""Width of the main lobe of a Hann window: what lies within it is the line's."""


BAND_HELD = 0.5
"""Share of a band, or of a main lobe, that must hold numbers for its sum to say something."""

LOBE_NOISE, LOBE_SCATTER, LOBE_BEAT = 4.0 / 1.5, 3.0, 1.3
"""What noise adds to the energy of a Hann window's main lobe, the variance that it has there without a line, and the
power with which a line beats with it, in noise powers of a bin (their squares for the variance)."""


def order_tracks(order_map: xr.Dataset, orders: list[float], *, settings: OrderSettings) -> xr.Dataset:
    """OrderTracks of ``orders`` (cycles per crank revolution) from the OrderMap ``order_map``.

    On a bin of the map, amplitude, phase and 95 % intervals are those of the coherent average; between bins the
    amplitude is that of the energy in the main lobe and the phase is NaN. ``band_rms`` is the RMS of everything
    within ``settings.band_width_orders`` around the order, NaN where the map holds less than half of that. Orders
    above the map give NaN. The flags are those of the map.
    """
    axis, asked = order_map["order"].values, np.asarray(orders, dtype=float)
    resolution = float(axis[1] - axis[0])
    nearest = np.clip(np.rint(asked / resolution).astype(int), 0, len(axis) - 1)
    on_bin = np.abs(axis[nearest] - asked) < 1e-6
    outside = asked > axis[-1] + 0.5 * resolution
    enbw = float(order_map.attrs["enbw_bins"])
    level = order_map["amplitude"].values
    largest = np.nanmax(level, axis=(1, 2), keepdims=True, initial=0.0)
    unit = np.where(largest > 0.0, np.ldexp(1.0, np.frexp(largest)[1] - 1), 1.0)
    power = (level / unit) ** 2
    found = _between_bins(order_map, power, asked / resolution, nearest)
    values = {
        name: np.where(on_bin, order_map[source].values[..., nearest], unit * found[name] if scaled else found[name])
        for name, source, scaled in _SOURCES
    }
    half = 0.5 * settings.band_width_orders / resolution
    band = _band_sum(power, asked / resolution, 2.0 * half, least_share=BAND_HELD)
    values["band_rms"] = unit * np.sqrt(band / (2.0 * enbw))
    tracks = xr.Dataset(coords={**{k: v for k, v in order_map.coords.items() if k != "order"}})
    tracks["order"] = ("order", asked, {"units": "1", "long_name": "order"})
    for name, units, long_name in _VARIABLES:
        shown = np.where(outside, 0.0 if name == "degrees_of_freedom" else np.nan, values[name])
        tracks[name] = (
            ("channel", "order", "speed"),
            np.moveaxis(shown, 2, 1),
            {"units": units, "long_name": long_name},
        )
    tracks.attrs = {key: order_map.attrs[key] for key in ("amplitude_scaling", "phase_reference", "cycle_known")}
    tracks.attrs |= {"band_width_orders": settings.band_width_orders, "speed_bin_rpm": settings.speed_bin_rpm}
    return with_flags(tracks, flags_of(order_map))


_SOURCES = (
    ("amplitude", "coherent_amplitude", True),
    ("phase", "phase", False),
    ("standard_error", "standard_error", True),
    ("degrees_of_freedom", "degrees_of_freedom", False),
    ("amplitude_low", "coherent_amplitude_low", True),
    ("amplitude_high", "coherent_amplitude_high", True),
    ("phase_ci95", "phase_ci95", False),
)
"""Variables of a track, where the map holds them on a bin, and whether they scale with the channel."""

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


def _between_bins(
    order_map: xr.Dataset, power: NDArray[np.float64], place: NDArray[np.float64], nearest: NDArray[np.int64]
) -> dict[str, NDArray[np.float64]]:
    """Amplitude, its error and interval (channels, speeds, orders) of lines ``place`` bins up, between two bins.

    ``power`` (channels, speeds, bins) is the energy average, ``nearest`` the nearest bin of each order; the noise is
    that of the bins beside, and what it adds to the energy of the main lobe is taken off.
    """
    bins, worth = beside_bins(order_map["order"].values, line_step=1.0 / int(order_map.attrs["revs_per_cycle"]))
    noise = noise_beside(power, bins[nearest])
    independent = order_map["n_independent"].values[None, :, None]
    lobe = _band_sum(power, place, MAIN_LOBE_BINS, least_share=BAND_HELD) / float(order_map.attrs["enbw_bins"])
    bias, beat = LOBE_NOISE * noise, LOBE_BEAT * noise / independent
    dof = np.where(np.isnan(lobe), 0.0, np.round(2.0 * worth[nearest] * independent))
    scatter = LOBE_SCATTER * noise**2 / independent
    low, high = energy_interval(lobe, noise=beat, bias=bias, noise_variance=scatter, dof=dof)
    line = np.sqrt(np.maximum(lobe - bias, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.sqrt(2.0 * line**2 * beat + scatter) / (2.0 * np.sqrt(lobe))
    # without noise the error is 0; without energy nothing is known of it but the upper end
    error = np.where(np.isnan(lobe) | (noise > 0.0), np.where(lobe > 0.0, error, np.nan), 0.0)
    nothing = np.full(lobe.shape, np.nan)
    ends = {"amplitude_low": low, "amplitude_high": high, "phase_ci95": nothing, "degrees_of_freedom": dof}
    return {"amplitude": line, "phase": nothing, "standard_error": error, **ends}


def followed_orders(order_map: xr.Dataset, findings: dict[str, Any], settings: OrderSettings) -> list[float]:
    """Orders to follow: those that ``findings`` name and those that ``settings`` ask for.

    An order that is locked to the shaft, and any within a quarter of a bin of ``order_map``, is followed on its bin,
    where its phase is known; one that slips is followed where it was found.
    """
    resolution = 1.0 / float(order_map.attrs["revs_per_frame"])
    orders = {round(float(order), 9) for order in settings.track_orders}
    for record in findings["orders"]:
        on_bin = round(record["order"] / resolution) * resolution
        close = record["lock"] == "locked" or abs(record["order"] - on_bin) < 0.25 * resolution
        orders.add(round(on_bin if close else record["order"], 6))
    return sorted(orders)


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
