"""Random parts of a recording, each from a seed stream of its own; white forces and sensor noise make its floor."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from crankorder.quantities import Complexes, Floats
from crankorder.synth.parts import AXES, Axis, ColouredNoise
from crankorder.synth.poles import AnalogueFilter, Structure, accelerance
from crankorder.synth.scene import Run, Scene

MOST_FOLDS = 64
"""Images of the band that are added one by one where a density is not level; those above add in closed form."""

ROUND_OFF = 1e-12
"""Sum of images, relative to the power that a filter lets through at best, that is no more than round-off."""


def seed_stream(seed: int, *names: str) -> np.random.Generator:
    """Random generator that depends on ``seed`` and on all ``names`` (effect, recording, channel …), on nothing else.

    Switching an effect on or leaving a recording out therefore changes no other effect and no other recording.
    """
    keys = [zlib.crc32(name.encode("utf-8")) for name in names]
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=keys)))


def white_spectrum(
    stream: np.random.Generator, density: float, *, rate_hz: float, n_samples: int
) -> NDArray[np.complex64]:
    """Half spectrum (as of ``rfft``) of Gaussian white noise whose inverse has the one-sided density, bin 0 left empty.

    ``stream``: where the randomness comes from. ``density``: unit/√Hz, ≥ 0. ``rate_hz``: samples per second.
    ``n_samples``: length of the inverse transform, even. Returns shape (n_samples // 2 + 1,).
    """
    n_bins = n_samples // 2 + 1
    pairs = stream.standard_normal(2 * n_bins, dtype=np.float32)
    pairs *= np.float32(density * math.sqrt(rate_hz * n_samples) / 2)
    spectrum: NDArray[np.complex64] = pairs.view(np.complex64)
    spectrum[0] = 0
    spectrum[-1] = 0
    return spectrum


def white_noise(stream: np.random.Generator, density: float, *, rate_hz: float, n_samples: int) -> NDArray[np.float32]:
    """Gaussian white noise of the one-sided density ``density`` (unit/√Hz), shape (n_samples,).

    ``stream``: where the randomness comes from. ``rate_hz``: samples per second, up to half of which the noise is
    white. ``n_samples``: ≥ 1.
    """
    noise = stream.standard_normal(n_samples, dtype=np.float32)
    noise *= np.float32(density * math.sqrt(rate_hz / 2))
    return noise


def padded_length(n_samples: int, tail_samples: int) -> int:
    """Even, quickly transformed length of at least ``n_samples + tail_samples``.

    Noise made by an inverse transform repeats with its length; ``n_samples`` cut from a length with a tail as long as
    the modes ring has a beginning that knows nothing of its end. ``tail_samples``: ≥ 0.
    """
    from scipy.fft import next_fast_len

    return 2 * int(next_fast_len((n_samples + tail_samples + 1) // 2, real=True))


def put_coloured_noise(
    noise: NDArray[np.float32], spectra: list[NDArray[np.complex64]], response: Iterable[NDArray[np.complex64]]
) -> None:
    """Put into ``noise``, zeros of shape (channel, sample), what white forces become behind a response.

    ``spectra``: the half spectrum of each force, of an even length of at least as many samples; the list is emptied,
    for they are large. ``response``: shape (channel, force, some bins), one after the other.
    """
    from scipy.fft import irfft

    totals, start = np.zeros((len(noise), spectra[0].size), dtype=np.complex64), 0
    for gain in response:
        some = slice(start, start + gain.shape[2])
        for force, spectrum in enumerate(spectra):
            totals[:, some] += gain[:, force] * spectrum[some]
        start = some.stop
    spectra.clear()
    for row, total in zip(noise, totals, strict=True):
        if total.any():
            row[:] = irfft(total, n=2 * (total.size - 1), overwrite_x=True)[: row.size]


def shaped_noise(
    stream: np.random.Generator, density: Floats, *, rate_hz: float, n_samples: int
) -> NDArray[np.float32]:
    """Gaussian noise of a one-sided density (unit/√Hz) that changes with frequency, shape (n_samples,), without mean.

    ``stream``: where the randomness comes from. ``density``: ≥ 0 at the bins of a real transform of an even length of
    at least ``n_samples`` samples, shape (length // 2 + 1,); take the length from :func:`padded_length`.
    ``rate_hz``: samples per second. ``n_samples``: how many are kept, ≥ 1.
    """
    from scipy.fft import irfft

    n_padded = 2 * (density.size - 1)
    spectrum = white_spectrum(stream, 1.0, rate_hz=rate_hz, n_samples=n_padded)
    spectrum *= density.astype(np.float32)
    noise: NDArray[np.float32] = irfft(spectrum, n=n_padded, overwrite_x=True)[:n_samples]
    return noise


def density_through_points(part: ColouredNoise, frequency_hz: Floats) -> Floats:
    """One-sided density (m/s²/√Hz) straight on log scales from point to point, level outside; ``frequency_hz``'s shape.

    ``part``: the points. ``frequency_hz``: ≥ 0.
    """
    points_hz, levels = np.log(part.frequency_hz), np.log(part.m_s2_per_root_hz)
    log_hz = np.log(np.maximum(frequency_hz, part.frequency_hz[0]))
    return np.exp(np.interp(log_hz, points_hz, levels))


def folded_density(
    density: Callable[[Floats], Floats], filter: AnalogueFilter | None, rate_hz: float, frequency_hz: Floats
) -> Floats:
    """One-sided density of noise behind an analogue filter after sampling, shape of ``frequency_hz``.

    Before a low-pass filter the noise goes on for ever above half the rate; what the filter leaves of it folds back,
    and powers add: Σ over all whole k of (density · |H|)² at |f + k · rate|. Without a low-pass filter that sum would
    be infinite; then ``density`` is by definition what a recording has up to half its rate, and nothing folds (an AC
    coupling still works on it).

    ``density``: unit/√Hz at frequencies ≥ 0, level above some frequency (from 64 rates on it is taken as level).
    ``filter``: None where there is none. ``rate_hz``: true samples per second. ``frequency_hz``: 0 … rate_hz / 2.
    """
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    passed = np.ones_like(frequency) if filter is None else np.abs(filter.response(frequency)) ** 2
    power = density(frequency) ** 2 * passed
    if filter is not None and filter.direct == 0.0:
        folds = 0
        while folds == 0 or (folds < MOST_FOLDS and not _is_level(density, (folds + 0.5) * rate_hz)):
            folds += 1
            for image_hz in (folds * rate_hz - frequency, folds * rate_hz + frequency):
                gain = np.abs(filter.response(image_hz)) ** 2
                power += density(image_hz) ** 2 * gain
                passed += gain
        beyond = filter.folded_power(rate_hz, frequency) - passed
        level = density(np.array([(folds + 0.5) * rate_hz]))
        power += np.where(beyond > ROUND_OFF, level**2 * beyond, 0.0)
    return np.sqrt(power)


def _is_level(density: Callable[[Floats], Floats], from_hz: float) -> bool:
    values = density(np.geomspace(from_hz, 1e4 * from_hz, 257))
    return bool(np.ptp(values) <= 1e-9 * np.max(values))


RINGING_TIMES = 6.0
"""Decay times of the slowest mode after which a noise record no longer remembers its other end (e⁻⁶ = 0.25 %)."""
SHAPED_TAIL = 8
"""Part of a recording by which the transform of its sensors' noise is longer: its end does not meet its start."""
BINS_AT_ONCE = 65536
MOST_HELD_BINS = 16 * BINS_AT_ONCE
"""Bins up to which the response is held for the recordings that share it; that of longer ones is worked out each time.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Floor:
    """What turns white noise into the floor at one rate: recordings of one rate and length share it.

    ``n_padded``: samples of the transform of the forces. ``response``: of the structure to the white forces, for the
    axes of ``broadband``, (channel, axis, some bins) one after the other; ``sensor`` (bin,): what the filter leaves of
    a sensor's white noise of density 1, None where there is no such noise or nothing shapes it; ``coloured``: density
    (bin,) of each coloured noise.
    """

    n_padded: int
    response: Callable[[], Iterable[NDArray[np.complex64]]]
    sensor: Floats | None
    coloured: tuple[Floats, ...]


def floor_of(scene: Scene, rate_hz: float) -> Floor:
    """Floor of the recordings of ``scene`` that are sampled at ``rate_hz``."""
    decay_s = 0.0
    if scene.broadband is not None:
        decay_s = np.max(1 / (2 * np.pi * scene.structure.frequency_hz * scene.structure.damping_ratio), initial=0.0)
    n_padded = padded_length(scene.n_samples, min(int(RINGING_TIMES * decay_s * rate_hz), scene.n_samples))
    n_bins = n_padded // 2 + 1

    def response() -> Iterator[NDArray[np.complex64]]:
        for start in range(0, n_bins, BINS_AT_ONCE):
            some: Floats = np.arange(start, min(start + BINS_AT_ONCE, n_bins), dtype=np.float64) * (rate_hz / n_padded)
            yield _gain(scene, scene.structure, some).astype(np.complex64)

    held = tuple(response()) if scene.broadband is not None and n_bins <= MOST_HELD_BINS else ()
    # the sensors' noise has a length of its own: that of the forces' transform depends on whether there are any
    n_shaped = padded_length(scene.n_samples, scene.n_samples // SHAPED_TAIL)
    frequency: Floats = np.arange(n_shaped // 2 + 1, dtype=np.float64) * (rate_hz / n_shaped)
    shapes_sensors = scene.sensor_noise and scene.filter
    sensor = folded_density(np.ones_like, scene.filter, rate_hz, frequency) if shapes_sensors else None
    coloured = tuple(_coloured_density(scene, k, frequency, rate_hz) for k in range(len(scene.coloured_noise)))
    return Floor(n_padded=n_padded, response=(lambda: held) if held else response, sensor=sensor, coloured=coloured)


def noise_signal(scene: Scene, run: Run, floor: Floor) -> NDArray[np.float32]:
    """All noise of one recording, shape (channel, sample), m/s².

    ``scene``: its noise, each part and channel with a seed stream of its own. ``run``: the recording. ``floor``: of
    :func:`floor_of` at the rate of the run.
    """
    rate_hz, n_samples = scene.rate_hz(run.speed_rpm), scene.n_samples
    noise = np.zeros((len(scene.channels), n_samples), dtype=np.float32)
    forces = scene.broadband.force_n_per_root_hz if scene.broadband is not None else {}
    if any(forces.values()):
        white = []
        for axis in _driven_axes(scene):
            stream, density = seed_stream(scene.seed, "broadband", run.stream, axis), forces[axis]
            white.append(white_spectrum(stream, density, rate_hz=rate_hz, n_samples=floor.n_padded))
        put_coloured_noise(noise, white, floor.response())
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


def floor_density(scene: Scene, frequency_hz: Floats, structure: Structure, rate_hz: float) -> Floats:
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
        shape = folded_density(np.ones_like, scene.filter, rate_hz, frequency_hz)
        power += (level[:, None] * shape) ** 2
    for k, part in enumerate(scene.coloured_noise):
        has = np.array([name in part.channels for name in scene.channel_names])
        power += has[:, None] * _coloured_density(scene, k, frequency_hz, rate_hz) ** 2
    return np.sqrt(power)


def _driven_axes(scene: Scene) -> tuple[Axis, ...]:
    forces = scene.broadband.force_n_per_root_hz if scene.broadband else {}
    return tuple(axis for axis in AXES if forces.get(axis))


def _gain(scene: Scene, structure: Structure, frequency_hz: Floats) -> Complexes:
    """Response (channel, driven axis, frequency) of the recorded channels to the white part of the forces."""
    assert scene.broadband is not None
    rows = [AXES.index(axis) for axis in _driven_axes(scene)]
    roll_off = 1 / np.sqrt(1 + (frequency_hz / scene.broadband.corner_hz) ** 4)
    gain = accelerance(structure, frequency_hz)[:, rows] * roll_off
    return gain if scene.filter is None else gain * scene.filter.response(frequency_hz)


def _coloured_density(scene: Scene, number: int, frequency_hz: Floats, rate_hz: float) -> Floats:
    density = partial(density_through_points, scene.coloured_noise[number])
    return folded_density(density, scene.filter, rate_hz, frequency_hz)
