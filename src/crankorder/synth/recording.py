"""One recording of a scene, sample by sample: the sum of its effects, then what stands between sensor and file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from crankorder.engine.machine_parts import bearing_orders
from crankorder.quantities import Complexes, Floats
from crankorder.records import Json
from crankorder.synth.driven import driven_signal
from crankorder.synth.encoder import EncoderSignals, encoder_signals
from crankorder.synth.lines import (
    begun_earlier,
    crank_forces,
    crank_motion,
    driven_lines,
    fixed_lines,
    gain_of_cycle,
    modulation,
    other_motion,
    ringing,
    ringing_s,
    shaft_forces,
    slipping_line,
    strike_angles,
    strikes_per_rev,
)
from crankorder.synth.motion import Motion
from crankorder.synth.noise import Floor, noise_signal, seed_stream
from crankorder.synth.order_forces import ForceLines, lines_in_angle
from crankorder.synth.parts import TimeSampling
from crankorder.synth.poles import Recorded, poles_of, recorded, tones
from crankorder.synth.scene import Run, Scene
from crankorder.synth.signal_faults import converter_records, with_signal_faults

SAMPLES_AT_ONCE = 1 << 18


def order_signal(scene: Scene, run: Run, motion: Motion) -> Floats:
    """Response of the structure to every force that follows a shaft, shape (channel, sample).

    At a steady mean speed the exact sum of the steady states; else an integration of the modes. ``scene``: forces,
    structure and filter. ``run``: the recording. ``motion``: of its crank.
    """
    own = [(shaft_forces(scene, shaft), other_motion(scene, run, shaft)) for shaft in scene.other_shafts if shaft.rpm]
    sources = [(forces, turning) for forces, turning in ((crank_forces(scene), motion), *own) if forces.order.size]
    scatters = scene.gas_torque is not None and scene.gas_torque.scatter_percent
    if sources and (scatters or not all(_mean_is_steady(turning) for _, turning in sources)):
        return _integrated(scene, run, sources)
    signal = np.zeros((len(scene.channels), scene.n_samples))
    for forces, turning in sources:
        speed_rpm = turning.corners[0][1]
        lines = driven_lines(scene, forces, speed_rpm, turning.lag)
        at_start = lines.amplitude * np.exp(2j * np.pi * lines.order * turning.mean_rev(0.0))
        signal += _steady(scene, run, motion, lines.order * speed_rpm / 60, at_start)
    return signal


def bearing_signal(scene: Scene, run: Run, motion: Motion) -> Floats:
    """Bearing lines, which follow the crank angle and are given as recorded, shape (channel, sample).

    ``scene``: the lines. ``run``: the recording. ``motion``: of its crank.
    """
    lines = fixed_lines(scene, run)
    delay_s = scene.by_channel(scene.acquisition.delay_s)
    if _mean_is_steady(motion) and (motion.lag is None or not isinstance(scene.sampling, TimeSampling)):
        late_rev = np.outer(delay_s * run.speed_rpm / 60, lines.order)
        at_start = lines.amplitude * np.exp(2j * np.pi * (lines.order * motion.start_rev - late_rev))
        rate = scene.rate_hz(run.speed_rpm)
        return tones(at_start, lines.order * run.speed_rpm / 60, rate_hz=rate, n_samples=scene.n_samples)
    signal, rate_hz = np.empty((len(scene.channels), scene.n_samples)), scene.rate_hz(run.speed_rpm)
    for start in range(0, scene.n_samples, SAMPLES_AT_ONCE):
        time_s = np.arange(start, min(start + SAMPLES_AT_ONCE, scene.n_samples)) / rate_hz
        turns = {delay: motion.at(time_s - delay)[0] for delay in set(delay_s.tolist())}
        for row, delay, amplitude in zip(signal, delay_s.tolist(), lines.amplitude, strict=True):
            phase = 2 * np.pi * np.outer(lines.order, turns[delay])
            row[start : start + time_s.size] = amplitude.real @ np.cos(phase) - amplitude.imag @ np.sin(phase)
    return signal


def tone_signal(scene: Scene, run: Run, motion: Motion) -> Floats:
    """Mains and other tones that follow no shaft, given as recorded, shape (channel, sample).

    ``scene``: the tones. ``run``: the recording. ``motion``: of its crank, for samples by crank angle.
    """
    frequency, amplitude = [], []
    for k, tone in enumerate(scene.tones):
        stream = seed_stream(scene.seed, "tones", str(k), run.stream)
        for number, share in enumerate(tone.harmonics, start=1):
            phase_rev = stream.random()
            frequency.append(number * tone.frequency_hz)
            amplitude.append(share * scene.by_channel(tone.amplitude_m_s2) * np.exp(2j * np.pi * phase_rev))
    return _steady(scene, run, motion, np.array(frequency), np.array(amplitude).T)


def impact_signal(scene: Scene, run: Run, motion: Motion) -> Floats:
    """Strikes of damaged bearings and what they ring, shape (channel, sample).

    ``scene``: the damages. ``run``: the recording. ``motion``: of its crank.
    """
    signal = np.zeros((len(scene.channels), scene.n_samples))
    delay_s = scene.by_channel(scene.acquisition.delay_s)
    for k, part in enumerate(scene.bearing_impacts):
        strike_s, size = _strikes(scene, run, motion, k)
        peak = scene.by_channel(part.peak_m_s2) * part.growth**run.repeat
        for delay in sorted(set(delay_s[peak != 0].tolist())):
            rings = ringing(
                strike_s + delay,
                size,
                resonance_hz=part.resonance_hz,
                damping_ratio=part.damping_ratio,
                rate_hz=scene.rate_hz(run.speed_rpm),
                n_samples=scene.n_samples,
                filter=scene.filter,
            )
            late = np.flatnonzero((delay_s == delay) & (peak != 0))
            signal[late] += peak[late, None] * rings
    return signal


def _strikes(scene: Scene, run: Run, motion: Motion, number: int) -> tuple[Floats, Floats]:
    """Times (s) and relative sizes of the strikes of one damage, those before the recording that still ring too."""
    part = scene.bearing_impacts[number]
    bearing = next(bearing for bearing in scene.engine.bearings if bearing.name == part.bearing)
    orders = bearing_orders(bearing)
    before_s = ringing_s(part.resonance_hz, part.damping_ratio, filter=scene.filter)
    before_s += float(np.abs(scene.by_channel(scene.acquisition.delay_s)).max())
    duration_s = scene.n_samples / scene.rate_hz(run.speed_rpm)
    earlier = begun_earlier(motion, before_s)
    turning = [
        (stretch, earlier.at(np.array(stretch))[0]) for stretch in earlier.stretches(before_s + duration_s + before_s)
    ]
    if not turning:
        return np.empty(0), np.empty(0)
    stream = seed_stream(scene.seed, "bearing_impacts", str(number), run.stream)
    phase_rev = stream.random()
    angles = strike_angles(
        strikes_per_rev(orders, part.line),
        slip_percent=part.slip_percent,
        jitter_percent=part.jitter_percent,
        start_rev=float(min(ends.min() for _, ends in turning)),
        end_rev=float(max(ends.max() for _, ends in turning)),
        stream=stream,
    )
    shaft_ratio = bearing.shaft_ratio
    cage_order = slipping_line(orders.get("FTF", 0.0), slip_percent=part.slip_percent)
    size = modulation(
        part.line, angles, load_zone=part.load_zone, shaft_ratio=shaft_ratio, cage_order=cage_order, phase_rev=phase_rev
    )
    times, sizes = [], []
    for stretch, ends in turning:
        within = (angles >= ends.min()) & (angles <= ends.max())
        times.append(earlier.time_at(angles[within], stretch) - before_s)
        sizes.append(size[within])
    return np.concatenate(times), np.concatenate(sizes)


def _mean_is_steady(motion: Motion) -> bool:
    """Whether ``motion`` has one mean speed for all time; in-cycle motion may come on top."""
    return not motion.wobbles and not motion.corner_s


def _steady(scene: Scene, run: Run, motion: Motion, frequency_hz: Floats, amplitude: Complexes) -> Floats:
    """Steady tones of complex ``amplitude`` (channel, line) at the first sample, with the channels' delays."""
    delay_s = scene.by_channel(scene.acquisition.delay_s)
    late = amplitude * np.exp(-2j * np.pi * np.outer(delay_s, frequency_hz))
    rate_hz, n_samples = scene.rate_hz(run.speed_rpm), scene.n_samples
    if isinstance(scene.sampling, TimeSampling) or motion.lag is None:
        return tones(late, frequency_hz, rate_hz=rate_hz, n_samples=n_samples)
    order = frequency_hz * 60 / run.speed_rpm
    at_zero = late * np.exp(-2j * np.pi * order * motion.mean_rev(0.0))
    order, by_angle = lines_in_angle(order, at_zero, motion.lag, speed_rpm=run.speed_rpm)
    return tones(by_angle, order, rate_hz=scene.sampling.samples_per_rev, n_samples=n_samples)


def _integrated(scene: Scene, run: Run, sources: list[tuple[ForceLines, Motion]]) -> Floats:
    """Response of the structure to forces of shafts whose speed changes, by integration of its modes.

    Channels of one delay are integrated together, on a clock that starts so much earlier: exact between samples too.
    """
    delay_s = scene.by_channel(scene.acquisition.delay_s)
    poles, rate_hz = poles_of(scene.structure, scene.filter), scene.rate_hz(run.speed_rpm)

    def late_by(delay: float) -> Floats:
        return driven_signal(
            poles.seen_by(np.flatnonzero(delay_s == delay)),
            [(forces, begun_earlier(motion, delay)) for forces, motion in sources],
            rate_hz=rate_hz,
            n_samples=scene.n_samples,
            gain_of_cycle=gain_of_cycle(scene, run),
            revs_per_cycle=scene.engine.revs_per_cycle,
        )

    delays = sorted(set(delay_s.tolist()))
    if len(delays) == 1:
        return late_by(delays[0])
    signal = np.empty((len(scene.channels), scene.n_samples))
    for delay in delays:
        signal[delay_s == delay] = late_by(delay)
    return signal


@dataclass(frozen=True, kw_only=True, eq=False)
class SyntheticRecording:
    """What one file holds: the recorded channels, the encoder or None, and what was made faulty where."""

    recorded: Recorded
    encoder: EncoderSignals | None
    faults: list[dict[str, Json]]


def sensed(scene: Scene, run: Run, floor: Floor) -> Floats:
    """What the sensors of ``scene`` give in ``run``, filtered, neither faulty nor converted: (channel, sample), m/s².

    ``floor``: of :func:`crankorder.synth.noise.floor_of` at the rate of the run. An effect that is not named is not
    looked at; the effects add up.
    """
    motion, noise = crank_motion(scene, run), None
    if scene.broadband or scene.sensor_noise or scene.coloured_noise:
        noise = noise_signal(scene, run, floor)  # first: its transforms take the most memory
    signal = order_signal(scene, run, motion)
    if scene.bearing_lines:
        signal += bearing_signal(scene, run, motion)
    if scene.tones:
        signal += tone_signal(scene, run, motion)
    if scene.bearing_impacts:
        signal += impact_signal(scene, run, motion)
    if noise is not None:
        signal += noise
    return signal


def synthesise(scene: Scene, run: Run, floor: Floor) -> SyntheticRecording:
    """One recording as a file holds it.

    ``scene``: what to make. ``run``: which recording. ``floor``: of :func:`crankorder.synth.noise.floor_of` at the rate
    of the run.
    """
    signal, rate_hz = sensed(scene, run, floor), scene.rate_hz(run.speed_rpm)
    of_run: dict[str, Any] = {"recording": run.name, "stream": run.stream, "rate_hz": rate_hz, "seed": scene.seed}
    faults: list[dict[str, Json]] = []
    if scene.signal_faults:
        signal, faults = with_signal_faults(signal, scene.signal_faults, names=scene.channel_names, **of_run)
    encoder = None
    if scene.encoder is not None:
        motion, n_samples = crank_motion(scene, run), scene.n_samples
        encoder = encoder_signals(motion, scene.encoder, scene.encoder_faults, n_samples=n_samples, **of_run)
        faults += encoder.records
    converted = recorded(signal, scene.acquisition)
    faults += converter_records(converted.clipped_share, names=scene.channel_names, recording=run.name)
    named = [{**fault, "recording": f"{run.name}.h5"} for fault in faults]
    return SyntheticRecording(recorded=converted, encoder=encoder, faults=named)
