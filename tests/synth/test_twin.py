"""The synthetic twin of a test: its floor has no line of its own where the test's orders stood."""

import numpy as np
import xarray as xr
from scipy.signal import welch

from crankorder.synth.twin import Twin, _floor


def test_the_floor_under_an_order_is_that_beside_it() -> None:
    rate, rpm, order = 2048.0, 1300.0, 3.57
    frequency = np.arange(0.0, 800.0, 0.5)
    line = order * rpm / 60.0
    density = 1e-4 * (1.0 + 1e4 * np.exp(-0.5 * ((frequency - line) / 0.4) ** 2))  # a line as Hann's window shows it
    campbell = xr.Dataset(
        {"psd": (("channel", "speed", "frequency"), density[None, None])},
        coords={"speed": [rpm], "frequency": frequency},
    )
    tracks = xr.Dataset(coords={"order": [order]})
    twin = Twin(tracks, campbell, xr.Dataset(), xr.Dataset(), rate, 1, 0.0)
    (signal,) = _floor(twin, rpm, int(400 * rate), np.random.default_rng(1))
    at, found = welch(signal, rate, nperseg=4096)
    under = found[np.abs(at - line) < 1.5].mean()
    beside = found[(np.abs(at - line) > 10.0) & (np.abs(at - line) < 60.0)].mean()
    assert 0.9 < under / beside < 1.1  # it was up to four times as much
