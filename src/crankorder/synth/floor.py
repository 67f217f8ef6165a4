"""The random floor of a scene: white forces behind the structure, and noise of the sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.synth.noise import (
    coloured_noise,
    density_through_points,
    folded_density,
    padded_length,
    seed_stream,
    shaped_noise,
    white_noise,
    white_spectrum,
)
from crankorder.synth.parts import AXES, Axis
from crankorder.synth.response import Structure, accelerance
from crankorder.synth.scene import Run, Scene

Density = NDArray[np.float64]
RINGING_TIMES = 6.0
"""Decay times of the slowest mode after which a noise record no longer remembers its other end (e⁻⁶ = 0.25 %)."""
SHAPED_TAIL = 8
"""Part of a recording by which the transform of its sensors' noise is longer: its end does not meet its start."""
BINS_AT_ONCE = 65536


@dataclass(frozen=True, kw_only=True, eq=False)
class Floor:
    """What turns white noise into the floor at one rate: recordings of one rate and length share it.

    ``n_padded``: samples of the transform of the forces. ``response`` (channel, axis, bin): of the structure to the
    white forces, for the axes of ``broadband``; ``sensor`` (bin,): what the filter leaves of a sensor's white noise of
    density 1; ``coloured``: density (bin,) of each coloured noise. None where there is no such noise or nothing shapes
    it.
    """

    n_padded: int
    response: NDArray[np.complex64] | None
    sensor: Density | None
    coloured: tuple[Density, ...]


def floor_of(scene: Scene, rate_hz: float) -> Floor:
    """Floor of the recordings of ``scene`` that are sampled at ``rate_hz``."""
    decay_s = 0.0
    if scene.broadband is not None:
        decay_s = np.max(1 / (2 * np.pi * scene.structure.frequency_hz * scene.structure.damping_ratio), initial=0.0)
    n_padded = padded_length(scene.n_samples, min(int(RINGING_TIMES * decay_s * rate_hz), scene.n_samples))
    n_bins = n_padded // 2 + 1
    response = None
    if scene.broadband is not None:
        response = np.empty((len(scene.channels), len(_driven_axes(scene)), n_bins), dtype=np.complex64)
        for start in range(0, n_bins, BINS_AT_ONCE):
            some: Density = np.arange(start, min(start + BINS_AT_ONCE, n_bins), dtype=np.float64) * (rate_hz / n_padded)
            response[:, :, start : start + some.size] = _gain(scene, scene.structure, some)
    # the sensors' noise has a length of its own: that of the forces' transform depends on whether there are any
    n_shaped = padded_length(scene.n_samples, scene.n_samples // SHAPED_TAIL)
    frequency: Density = np.arange(n_shaped // 2 + 1, dtype=np.float64) * (rate_hz / n_shaped)
    return Floor(
        n_padded=n_padded,
        response=response,
        sensor=_sensor_shape(scene, frequency, rate_hz) if scene.sensor_noise and scene.filter else None,
        coloured=tuple(_coloured_density(scene, k, frequency, rate_hz) for k in range(len(scene.coloured_noise))),
    )


def noise_signal(scene: Scene, run: Run, floor: Floor) -> NDArray[np.float32]:
    """All noise of one recording, shape (channel, sample), m/s².

    ``scene``: its noise, each part and channel with a seed stream of its own. ``run``: the recording. ``floor``: of
    :func:`floor_of` at the rate of the run.
    """
    rate_hz, n_samples = scene.rate_hz(run.speed_rpm), scene.n_samples
    if scene.broadband is not None and floor.response is not None:
        white = [
            white_spectrum(
                seed_stream(scene.seed, "broadband", run.stream, axis),
                scene.broadband.force_n_per_root_hz[axis],
                rate_hz=rate_hz,
                n_samples=floor.n_padded,
            )
            for axis in _driven_axes(scene)
        ]
        noise = coloured_noise(white, floor.response, n_padded=floor.n_padded, n_samples=n_samples)
    else:
        noise = np.zeros((len(scene.channels), n_samples), dtype=np.float32)
    for row, name in zip(noise, scene.channel_names, strict=True):
        level = scene.sensor_noise.m_s2_per_root_hz.get(name, 0.0) if scene.sensor_noise else 0.0
        stream = seed_stream(scene.seed, "sensor_noise", run.stream, name)
        if level and floor.sensor is None:
            row += white_noise(stream, level, rate_hz=rate_hz, n_samples=n_samples)
        elif level and floor.sensor is not None:
            row += shaped_noise(stream, level * floor.sensor, rate_hz=rate_hz, n_samples=n_samples)
        for k, part in enumerate(scene.coloured_noise):
            if name in part.channels:
                stream = seed_stream(scene.seed, "coloured_noise", str(k), run.stream, name)
                row += shaped_noise(stream, floor.coloured[k], rate_hz=rate_hz, n_samples=n_samples)
    return noise


def floor_density(scene: Scene, frequency_hz: Density, structure: Structure, rate_hz: float) -> Density:
    """One-sided amplitude density (m/s²/√Hz) of all noise of ``scene`` after sampling, shape (channel, frequency).

    ``frequency_hz``: shape (frequency,), below half of ``rate_hz``. ``structure``: the scene's own, or one that lacks a
    mode.
    """
    power = np.zeros((len(scene.channels), frequency_hz.size))
    if scene.broadband is not None:
        force = np.array([scene.broadband.force_n_per_root_hz[axis] for axis in _driven_axes(scene)])
        power += np.einsum("caf,a->cf", np.abs(_gain(scene, structure, frequency_hz)) ** 2, force**2)
    if scene.sensor_noise is not None:
        level = scene.by_channel(scene.sensor_noise.m_s2_per_root_hz)
        shape = _sensor_shape(scene, frequency_hz, rate_hz) if scene.filter else np.ones(frequency_hz.size)
        power += (level[:, None] * shape) ** 2
    for k, part in enumerate(scene.coloured_noise):
        has = np.array([name in part.channels for name in scene.channel_names])
        power += has[:, None] * _coloured_density(scene, k, frequency_hz, rate_hz) ** 2
    density: Density = np.sqrt(power)
    return density


def _driven_axes(scene: Scene) -> tuple[Axis, ...]:
    forces = scene.broadband.force_n_per_root_hz if scene.broadband else {}
    return tuple(axis for axis in AXES if forces.get(axis))


def _gain(scene: Scene, structure: Structure, frequency_hz: Density) -> NDArray[np.complex128]:
    """Response (channel, driven axis, frequency) of the recorded channels to the white part of the forces."""
    assert scene.broadband is not None
    rows = [AXES.index(axis) for axis in _driven_axes(scene)]
    roll_off = 1 / np.sqrt(1 + (frequency_hz / scene.broadband.corner_hz) ** 4)
    gain = accelerance(structure, frequency_hz)[:, rows] * roll_off
    return gain if scene.filter is None else gain * scene.filter.response(frequency_hz)


def _sensor_shape(scene: Scene, frequency_hz: Density, rate_hz: float) -> Density:
    assert scene.filter is not None
    return folded_density(np.ones_like, scene.filter, rate_hz, frequency_hz)


def _coloured_density(scene: Scene, number: int, frequency_hz: Density, rate_hz: float) -> Density:
    part = scene.coloured_noise[number]
    if scene.filter is None:
        return density_through_points(part, frequency_hz)
    return folded_density(lambda f: density_through_points(part, f), scene.filter, rate_hz, frequency_hz)
