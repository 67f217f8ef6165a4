"""A recording limited to the band that the wanted results need: most of the cost is saved here."""

from __future__ import annotations

import numpy as np
import xarray as xr

from crankorder.fft.decimation import decimate, decimation_factor
from crankorder.quantities import channel_coords


def band_limited(recording: xr.Dataset, *, band_hz: float, grid_hz: float) -> xr.Dataset:
    """BandRecording: the signals of ``recording`` without their mean, low-passed to ``band_hz`` and decimated.

    The new rate is a multiple of ``grid_hz`` where that costs little. A recording by crank angle has no rate to
    reduce: it only loses its mean. Encoder data are left out, for the shaft angle has been made from them.
    """
    by_time = recording.attrs["domain"] == "time"
    signals = recording["signal"].values
    attrs = dict(recording.attrs)
    if by_time:
        rate = float(attrs["rate_hz"])
        factor = decimation_factor(rate, band_hz, grid_hz=grid_hz)
        signals, rate, start = decimate(signals, rate_hz=rate, band_hz=band_hz, factor=factor)
        attrs |= {"rate_hz": rate, "start_s": float(attrs.get("start_s", 0.0)) + start}
    else:
        signals = signals.astype(np.float64)
        signals = signals - signals.mean(axis=1, keepdims=True)
    axis = "time" if by_time else "crank_angle"
    return xr.Dataset(
        {"signal": (("channel", axis), signals, {"units": "see unit", "long_name": "signal in the analysis band"})},
        coords=channel_coords(recording),
        attrs=attrs | {"band_hz": band_hz},
    )
