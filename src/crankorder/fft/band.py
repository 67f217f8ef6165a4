"""A recording limited to the band that the wanted results need: most of the cost is saved here."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.fft.decimation import (
    TOLERANCE,
    channel_offsets,
    decimate,
    decimation_error,
    decimation_factor,
    decimation_reach,
    decimation_stages,
)
from crankorder.quantities import channel_coords

LARGEST_LOSS = 0.02
"""A recording of which the filters' ends would cost a larger share keeps its rate: short ones are cheap anyway."""


def band_limited(recording: xr.Dataset, *, band_hz: float, grid_hz: float, tolerance: float = TOLERANCE) -> xr.Dataset:
    """BandRecording: the signals of ``recording`` without their mean, low-passed to ``band_hz`` and decimated.

    The new rate is a multiple of ``grid_hz`` where that costs little; within the band the amplitudes are right to
    ``tolerance`` (the attribute ``decimation_error`` says what is predicted). float32 stays float32. A short recording
    keeps its rate, for the filters would take away its ends. A recording by crank angle has no rate to reduce: it only
    loses its mean. Where samples are missing (NaN) or were not usable before, the variable ``usable`` is False as far
    as the filters reach. Encoder data are left out, for the shaft angle has been made from them.
    """
    axis = "time" if recording.attrs["domain"] == "time" else "crank_angle"
    signals = recording["signal"].values
    offset, gaps = channel_offsets(signals)
    bad = _unusable(recording, signals, gaps=gaps)
    attrs: dict[str, Any] = dict(recording.attrs)
    error, reach, factor, start = 0.0, 0, 1, 0.0
    if axis == "time":
        rate = float(attrs["rate_hz"])
        factor = decimation_factor(rate, band_hz, grid_hz=grid_hz)
        reach = decimation_reach(decimation_stages(rate, band_hz, factor, tolerance))
        if 2 * reach > LARGEST_LOSS * signals.shape[1]:
            factor, reach = 1, 0
        error = decimation_error(rate, band_hz, factor, tolerance)
        signals, rate, start = decimate(
            signals, rate_hz=rate, band_hz=band_hz, factor=factor, tolerance=tolerance, offset=offset
        )
        attrs |= {"rate_hz": rate, "start_s": float(attrs.get("start_s", 0.0)) + start}
    else:
        signals, *_ = decimate(signals, rate_hz=1.0, band_hz=0.4, factor=1, offset=offset)
    made = xr.Dataset(
        {"signal": (("channel", axis), signals, {"units": "see unit", "long_name": "signal in the analysis band"})},
        coords=channel_coords(recording),
        # an error of an earlier decimation stays
        attrs=attrs | {"band_hz": band_hz, "decimation_error": error + float(attrs.get("decimation_error", 0.0))},
    )
    if bad is not None:
        usable = np.stack([_untouched(row, signals.shape[1], factor, reach) for row in bad])
        made["usable"] = (("channel", axis), usable, {"units": "1", "long_name": "free of gaps and of their filtering"})
    return made


def _unusable(recording: xr.Dataset, signals: NDArray[np.floating], *, gaps: bool) -> list[NDArray[np.int64]] | None:
    """Numbers of the samples of each channel that are missing or not usable; None where there is none."""
    if "usable" not in recording and not gaps:
        return None
    rows = [np.flatnonzero(~np.isfinite(row)) for row in signals]
    if "usable" in recording:
        rows = [np.union1d(row, np.flatnonzero(~u)) for row, u in zip(rows, recording["usable"].values, strict=True)]
    return rows


def _untouched(bad: NDArray[np.int64], n_out: int, factor: int, reach: int) -> NDArray[np.bool_]:
    """Whether none of the samples ``bad`` lies within ``reach`` of each of ``n_out`` outputs."""
    centre = (-(-reach // factor) + np.arange(n_out)) * factor
    return np.asarray(np.searchsorted(bad, centre - reach) == np.searchsorted(bad, centre + reach, side="right"))
