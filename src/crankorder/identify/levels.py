"""Overall level of each channel over a test, and what lies above the band that was looked at."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr

from crankorder.findings import Level


def level_records(levels: Sequence[xr.Dataset]) -> tuple[Level, ...]:
    """Records of all channels from the RecordingLevels ``levels`` of the recordings of a test; none without any.

    ``rms_max`` is that of the loudest recording; ``share_above`` that of all energy of the recordings alike; of the
    lines above the band the strongest is told.
    """
    if not levels:
        return ()
    names = levels[0]["channel"].values.tolist()
    return tuple(
        _record(name, [one.sel(channel=name) for one in levels if name in one["channel"].values]) for name in names
    )


def _record(name: str, levels: list[xr.Dataset]) -> Level:
    rms = np.array([float(one["rms"]) for one in levels])
    share = np.array([float(one["share_above"]) for one in levels])
    known = np.isfinite(rms) & np.isfinite(share)
    energy = rms[known] ** 2
    ends = [one.attrs["band_hz"] for one in levels if math.isfinite(one.attrs["band_hz"])]
    strongest = max(levels, key=lambda one: float(one["peak_above"]))
    amplitude = float(strongest["peak_above"])
    return Level(
        channel=name,
        unit=str(levels[0]["unit"].item()),
        rms_max=float(rms[known].max()) if known.any() else None,
        band_hz=max(ends) if ends else None,
        share_above=float(energy @ share[known] / energy.sum()) if energy.sum() > 0.0 else None,
        amplitude_above=amplitude if amplitude > 0.0 else None,
        frequency_hz_above=_told(strongest["peak_frequency"]),
        band_hz_there=_told(strongest["peak_band"]),
        order_above=_told(strongest["peak_order"]),
        speed_rpm_above=_told(strongest["peak_speed"]),
    )


def _told(value: xr.DataArray) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None
