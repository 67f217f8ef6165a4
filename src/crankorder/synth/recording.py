"""One recording of a scene, sample by sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.engine.forces import DIRECTIONS
from crankorder.synth.effects import TimeSampling
from crankorder.synth.encoder import sampled_encoder
from crankorder.synth.lines import order_lines
from crankorder.synth.noise import coloured_noise, padded_length, seed_stream, white_noise, white_spectrum
from crankorder.synth.response import accelerance, tones
from crankorder.synth.scene import Run, Scene

RINGING_TIMES = 6.0
"""Decay times of the slowest mode after which a noise record no longer remembers its other end (e⁻⁶ = 0.25 %)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SyntheticRecording:
    """What one file holds: ``signal`` (channel, sample) in m/s², and ``encoder`` (V) and ``index`` (0, 1) or None."""

    signal: NDArray[np.float32]
    encoder: NDArray[np.float32] | None
    index: NDArray[np.uint8] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class BroadbandResponse:
    """Response of the channels to the white forces on the bins of a transform of ``n_padded`` samples."""

    n_padded: int
    response: NDArray[np.complex64]


def broadband_response(scene: Scene, rate_hz: float) -> BroadbandResponse | None:
    """Response that turns white forces into the broadband floor, or None where the scene has none.

    ``scene``: structure and broadband forces. ``rate_hz``: samples per second. Recordings of one rate and length
    share it.
    """
    if scene.broadband is None:
        return None
    structure = scene.structure
    decay_s = np.max(1 / (2 * np.pi * structure.frequency_hz * structure.damping_ratio), initial=0.0)
    tail = min(int(RINGING_TIMES * decay_s * rate_hz), scene.n_samples)
    n_padded = padded_length(scene.n_samples, tail)
    frequency: NDArray[np.float64] = np.arange(n_padded // 2 + 1, dtype=np.float64) * (rate_hz / n_padded)
    response = np.empty((len(scene.channels), 3, frequency.size), dtype=np.complex64)
    for part in np.array_split(np.arange(frequency.size), max(1, frequency.size // 65536)):
        gain = broadband_roll_off(scene, frequency[part])
        response[:, :, part[0] : part[-1] + 1] = accelerance(structure, frequency[part]) * gain
    return BroadbandResponse(n_padded=n_padded, response=response)


def broadband_roll_off(scene: Scene, frequency_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Amplitude of the broadband forces relative to their white part, shape of ``frequency_hz``; 1/√2 at the corner.

    ``scene``: its broadband forces give the corner; without any the result is 0.
    """
    if scene.broadband is None:
        return np.zeros_like(frequency_hz)
    return 1 / np.sqrt(1 + (frequency_hz / scene.broadband.corner_hz) ** 4)


def start_angle_rev(scene: Scene, run: Run) -> float:
    """Crank angle of the first sample from firing top dead centre, 0 … 2 revolutions: by chance when sampled in time.

    ``scene``: its seed and sampling. ``run``: the recording. Sampled by crank angle a recording starts at 0.
    """
    if isinstance(scene.sampling, TimeSampling):
        return 2 * float(seed_stream(scene.seed, "start_angle", run.name).random())
    return 0.0


def synthesise(scene: Scene, run: Run, broadband: BroadbandResponse | None) -> SyntheticRecording:
    """Signals of one recording as the sum of its effects.

    ``scene``: what to make. ``run``: which recording. ``broadband``: of :func:`broadband_response` at the rate of the
    run.
    """
    rate_hz, n_samples = scene.rate_hz(run.speed_rpm), scene.n_samples
    start_rev = start_angle_rev(scene, run)
    signal = np.zeros((len(scene.channels), n_samples))
    lines = order_lines(scene, run)
    if lines.order.size:
        at_start = lines.amplitude * np.exp(2j * np.pi * lines.order * start_rev)
        signal = tones(at_start, lines.order * run.speed_rpm / 60, rate_hz=rate_hz, n_samples=n_samples)
    if scene.broadband is not None and broadband is not None:
        signal += _broadband(scene, run, broadband, rate_hz)
    if scene.sensor_noise is not None:
        for row, name in zip(signal, scene.channel_names, strict=True):
            density = scene.sensor_noise.m_s2_per_root_hz.get(name, 0.0)
            if density:
                stream = seed_stream(scene.seed, "sensor_noise", run.name, name)
                row += white_noise(stream, density, rate_hz=rate_hz, n_samples=n_samples)
    encoder = index = None
    if scene.encoder is not None:
        encoder, index = sampled_encoder(
            start_rev,
            run.speed_rpm,
            pulses_per_rev=scene.encoder.pulses_per_rev,
            high_v=scene.encoder.high_v,
            rate_hz=rate_hz,
            n_samples=n_samples,
        )
    return SyntheticRecording(signal=signal.astype(np.float32), encoder=encoder, index=index)


def _broadband(scene: Scene, run: Run, broadband: BroadbandResponse, rate_hz: float) -> NDArray[np.float32]:
    spectra: list[NDArray[np.complex64] | None] = []
    for axis in DIRECTIONS:
        density = scene.broadband.force_n_per_root_hz.get(axis, 0.0) if scene.broadband else 0.0
        stream = seed_stream(scene.seed, "broadband", run.name, axis)
        white = white_spectrum(stream, density, rate_hz=rate_hz, n_samples=broadband.n_padded) if density else None
        spectra.append(white)
    return coloured_noise(spectra, broadband.response, n_padded=broadband.n_padded, n_samples=scene.n_samples)
