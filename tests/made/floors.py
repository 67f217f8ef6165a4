"""Campbell maps of a structure under white forces, made in the time domain: an exactly known truth for modal fits."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.found import ModalFit
from made.order_amplitudes import modal_responses, order_map_of
from made.recordings import named

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Made:
    """A structure of modes that ``n_forces`` independent white forces of one N/√Hz drive, and how it is recorded.

    ``sensor`` (mode, channel) and ``drive`` (mode, force) make the residues; ``tones`` are (frequency, amplitude),
    ``lines`` (order, amplitude) of the shaft, both alike in all channels.
    """

    natural_hz: tuple[float, ...]
    damping: tuple[float, ...]
    sensor: tuple[tuple[float, ...], ...]
    drive: tuple[tuple[float, ...], ...]
    speed_rpm: tuple[float, ...] = tuple(np.arange(300.0, 2001.0, 100.0))
    duration_s: float = 15.0
    rate_hz: float = 1024.0
    resolution_hz: float = 0.5
    noise: float = 0.001
    tones: tuple[tuple[float, float], ...] = ()
    lines: tuple[tuple[float, float], ...] = ()
    gains: tuple[float, ...] = field(default=())

    def response(self, frequency_hz: Array) -> NDArray[np.complex128]:
        """Acceleration per force (channel, force, frequency)."""
        modal = modal_responses(self.natural_hz, self.damping, frequency_hz)
        return 0.002 + np.einsum("mc,mf,mw->cfw", self.sensor, self.drive, modal)


def inside(fit: ModalFit, made: Made) -> bool:
    """Whether all modes of ``made``, and no other, are within three standard errors."""
    return len(fit.modes) == len(made.natural_hz) and all(
        abs(mode.frequency_hz - f) <= 3.0 * mode.frequency_error_hz
        and abs(mode.damping_ratio - zeta) <= 3.0 * mode.damping_error
        for mode, f, zeta in zip(fit.modes, made.natural_hz, made.damping, strict=True)
    )


def campbell_of(made: Made, seed: int) -> xr.Dataset:
    """CampbellMap of ``made``: noise of ``seed`` behind the modes, Hann frames that overlap by half, averaged."""
    random = np.random.default_rng(seed)
    n_samples = round(made.duration_s * made.rate_hz)
    n_padded = 2 * (n_samples * 5 // 8)
    frequency = np.fft.rfftfreq(n_padded, 1.0 / made.rate_hz)
    response = made.response(frequency)
    n_frame = round(made.rate_hz / made.resolution_hz)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(n_frame) / n_frame)
    starts = range(0, n_samples - n_frame + 1, n_frame // 2)
    n_bins = round(0.48 * made.rate_hz / made.resolution_hz)
    psd = np.zeros((len(response), len(made.speed_rpm), n_bins))
    time = np.arange(n_samples) / made.rate_hz
    for k, rpm in enumerate(made.speed_rpm):
        parts = random.standard_normal((2, response.shape[1], len(frequency)))
        force = (parts[0] + 1j * parts[1]) * np.sqrt(made.rate_hz * n_padded) / 2.0
        signal = np.fft.irfft(np.einsum("caf,af->cf", response, force), n_padded)[:, :n_samples]
        if made.gains:
            signal *= made.gains[k]
        signal += made.noise * np.sqrt(made.rate_hz / 2.0) * random.standard_normal(signal.shape)
        for line_hz, amplitude in (*made.tones, *((order * rpm / 60.0, size) for order, size in made.lines)):
            signal += amplitude * np.cos(2.0 * np.pi * (line_hz * time + random.random()))
        for start in starts:
            spectrum = np.fft.rfft(signal[:, start : start + n_frame] * window)[:, :n_bins]
            psd[:, k] += 2.0 * np.abs(spectrum) ** 2 / len(starts) / (made.rate_hz * (window @ window))
    return campbell_map_of(psd, len(starts), made.speed_rpm, made.resolution_hz)


def campbell_map_of(psd: Array, n_frames: int, speed_rpm: Sequence[float], resolution_hz: float) -> xr.Dataset:
    """CampbellMap of ``psd`` (channels, speeds, bins from 0 Hz on), each the mean of ``n_frames`` Hann frames."""
    of_frames = {"window": "hann", "enbw_hz": 1.5 * resolution_hz, "resolution_hz": resolution_hz}
    return xr.Dataset(
        {"psd": (("channel", "speed", "frequency"), psd), "n_frames": ("speed", np.full(len(speed_rpm), n_frames))},
        coords={
            "channel": list("XYZ"[: len(psd)]),
            "speed": np.array(speed_rpm),
            "frequency": np.arange(psd.shape[2]) * resolution_hz,
        },
        attrs={**of_frames, "speed_bin_rpm": 25.0},
    )


def no_orders(campbell: xr.Dataset) -> xr.Dataset:
    """OrderMap without any order, for the speeds and channels of ``campbell``."""
    nothing = np.zeros((campbell.sizes["channel"], campbell.sizes["speed"], 0))
    made = order_map_of(nothing, nothing, nothing, campbell["speed"].values, np.zeros(0))
    return made.assign_coords(named(campbell["channel"].values))


def orders_of(made: Made, forces: tuple[tuple[float, float], ...], *, error: float, seed: int) -> xr.Dataset:
    """OrderMap of the orders in ``forces`` (order, newton at 1000 rpm, growing with speed²) behind the modes.

    Every complex amplitude is off by ``error`` (standard, per part) by the noise of ``seed``.
    """
    random = np.random.default_rng(seed)
    speed = np.array(made.speed_rpm)
    shape = (len(made.sensor[0]), len(speed), len(forces))
    made_of = np.empty(shape, dtype=complex)
    for j, (order, force) in enumerate(forces):
        made_of[:, :, j] = made.response(order * speed / 60.0)[:, 0] * force * (speed / 1000.0) ** 2
    made_of += error * (random.standard_normal(shape) + 1j * random.standard_normal(shape))
    numbers = np.array([order for order, _ in forces])
    return order_map_of(made_of, np.full(shape, error), np.full(shape, 200.0), speed, numbers)
