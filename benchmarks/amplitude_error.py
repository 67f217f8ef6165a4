"""Order amplitudes of each program against those that the synthesiser put into the reference campaign.

All programs are asked for the same amplitudes: those of (channel, order, speed) that stand clear of the noise, see
:func:`clear_lines`. All amplitudes are peaks.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import xarray as xr

CLEAR = 1000.0
"""Times the standard error that noise leaves: larger errors than a thousandth are of the program."""
STRONG = 0.01
"""Share of the strongest order of the same channel and recording from which an order counts: 40 dB below it."""
RULE = (
    "The errors are those on the same campaign with a millionth of its noise, analysed once: they show the program. A "
    f"line (channel, order, speed) counts where its true amplitude is at least {100 * STRONG:g} % of the strongest "
    f"order of its channel and recording, and at least {CLEAR:g} times √(S/T), the standard error of a peak amplitude "
    "that is fitted to a whole recording of T seconds in noise of the one-sided density S at the line's frequency."
)
MAX_ORDER, ROTA_ORDER_STEP = 20, 1 / 16
"""Of the spectra that `plain_scipy.py` and `rota_campaign.py` save."""


@dataclass(frozen=True)
class Line:
    """The true amplitude of an order in a channel at a speed, and the noise's standard error as a share of it."""

    recording: str
    channel: str
    order: float
    speed_rpm: float
    amplitude: float
    noise: float

    @property
    def words(self) -> str:
        return f"order {self.order:g} in {self.channel} at {self.speed_rpm:g} rpm"


Reader = Callable[[Line], float | None]
"""The amplitude that a program tells of a line; None where it did not analyse the recording."""


def clear_lines(recordings: Path) -> list[Line]:
    """Lines of the synthesised test in ``recordings`` that are strong and stand clear of the noise: ``RULE``."""
    truth = json.loads((recordings / "truth.json").read_text(encoding="utf-8"))
    names = {one["speed_rpm"]: Path(one["name"]).stem for one in truth["recordings"]}
    with h5py.File(recordings / truth["recordings"][0]["name"]) as file:
        duration_s = len(file["encoder"]) / float(file.attrs["rate_hz"])
    strongest: dict[tuple[str, float], float] = {}
    for one in truth["orders"]:
        for speed, amplitude in zip(one["speed_rpm"], one["amplitude_by_speed"], strict=True):
            at = (one["channel"], speed)
            strongest[at] = max(strongest.get(at, 0.0), amplitude)
    lines = []
    for one in truth["orders"]:
        by_speed = (one["speed_rpm"], one["amplitude_by_speed"], one["floor_density_by_speed"])
        for speed, amplitude, density in zip(*by_speed, strict=True):
            noise = density / np.sqrt(duration_s) / max(amplitude, 1e-300)
            if noise <= 1.0 / CLEAR and amplitude >= STRONG * strongest[one["channel"], speed]:
                lines.append(Line(names[speed], one["channel"], one["order"], speed, amplitude, noise))
    return lines


def of_map(out: Path) -> Reader:
    """Amplitudes of the order map in the results below ``out``."""
    (path,) = out.glob("*/results.nc")
    return _of_group(path, "order_map")


def of_tracks(out: Path) -> Reader:
    """Amplitudes of the order tracks in the results below ``out``, of the order map where an order has no track."""
    (path,) = out.glob("*/results.nc")
    tracks, orders = _of_group(path, "order_tracks"), _of_group(path, "order_map")

    def amplitude(line: Line) -> float | None:
        tracked = tracks(line)
        return orders(line) if tracked is None else tracked

    return amplitude


def _of_group(path: Path, group: str) -> Reader:
    with xr.open_dataset(path, group=group, engine="h5netcdf") as opened:
        amplitudes = opened["amplitude"].load()

    def amplitude(line: Line) -> float | None:
        of_channel = amplitudes.sel(channel=line.channel)
        near = of_channel.sel(order=line.order, speed=line.speed_rpm, method="nearest")
        if abs(float(near["order"]) - line.order) > 1e-6 or not np.isfinite(near):
            return None
        return float(near)

    return amplitude


def of_spectra(out: Path, order_step: float | None = None) -> Reader:
    """Amplitudes of saved order spectra, nearest bin; without ``order_step`` they reach evenly to ``MAX_ORDER``."""
    with np.load(out / "orders.npz") as file:
        saved = dict(file)

    def amplitude(line: Line) -> float | None:
        if line.recording not in saved:
            return None
        spectrum = saved[line.recording][list(saved["channels"]).index(f"acc_{line.channel.lower()}")]
        step = order_step or MAX_ORDER / (len(spectrum) - 1)
        return float(spectrum[round(line.order / step)])

    return amplitude


def errors(reader: Reader, lines: Iterable[Line]) -> dict[str, object] | None:
    """Largest and median relative error of the ``lines`` that a program told, how many, and which was the worst."""
    told = [(abs(value / line.amplitude - 1.0), line) for line in lines if (value := reader(line)) is not None]
    if not told:
        return None
    largest, worst = max(told, key=lambda one: one[0])
    return {
        "largest": float(f"{largest:.4g}"),
        "median": float(f"{np.median([error for error, _ in told]):.4g}"),
        "lines": len(told),
        "worst": worst.words,
    }
