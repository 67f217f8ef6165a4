"""Order frames made from given spectra."""

from __future__ import annotations

import numpy as np
import xarray as xr

from crankorder.quantities import check_dataset
from made.recordings import named


def frames_of(
    spectrum: np.ndarray,
    *,
    speed_rpm: float | np.ndarray = 1000.0,
    revs: int = 2,
    overlap: float = 0.5,
    **attrs: object,
) -> xr.Dataset:
    """OrderFrames with the complex ``spectrum`` (channels, frames, orders) on bins from 0, ``revs`` bins an order."""
    n_frames = spectrum.shape[1]
    made = xr.Dataset(
        {"spectrum": (("channel", "frame", "order"), spectrum, {"units": "see unit"})},
        coords={
            **named(len(spectrum)),
            "order": ("order", np.arange(spectrum.shape[2]) / revs, {"units": "1"}),
            "speed": ("frame", np.broadcast_to(speed_rpm, n_frames).astype(float), {"units": "min-1"}),
            "crank_angle": ("frame", np.arange(n_frames) * revs * (1.0 - overlap), {"units": "rev"}),
        },
        attrs={
            "recording": "made",
            "window": "hann",
            "enbw_bins": 1.5,
            "revs_per_frame": revs,
            "overlap": overlap,
            "amplitude_scaling": "peak",
            "phase_reference": "tdc",
            "cycle_known": 1,
            "revs_per_cycle": 2,
            **attrs,
        },
    )
    check_dataset(made, "order_frames")
    return made
