"""One recording of a scene, sample by sample: the sum of its effects, then what stands between sensor and file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crankorder.engine.machine_parts import bearing_orders
from crankorder.quantities import Complexes, Floats, Severity
from crankorder.records import Json
from crankorder.settings import IngestSettings, load_settings
from crankorder.synth import lines, parts
from crankorder.synth.driven import ForceLines, driven_signal, lines_in_angle
from crankorder.synth.encoder import EncoderSignals, encoder_signals
from crankorder.synth.motion import Motion
from crankorder.synth.noise import Floor, noise_signal, seed_stream
from crankorder.synth.poles import Recorded, poles_of, recorded, tones
from crankorder.synth.scene import Run, Scene

SAMPLES_AT_ONCE = 1 << 16


def order_signal(scene: Scene, run: Run, motion: Motion) -> Floats:
    """Response of the structure to every force that follows a shaft, shape (channel, sample).

    At a steady mean speed the exact sum of the steady states; else an integration of the modes. ``scene``: forces,
    structure and filter. ``run``: the recording. ``motion``: of its crank.
    """
    own = [
        (lines.shaft_forces(scene, shaft), lines.other_motion(scene, run, shaft))
        for shaft in scene.other_shafts
        if shaft.rpm
    ]
    sources = [
        (forces, turning) for forces, turning in ((lines.crank_forces(scene), motion), *own) if forces.order.size
    ]
    scatters = scene.gas_torque is not None and scene.gas_torque.scatter_percent
    if sources and (scatters or any(turning.wobbles or turning.corner_s for _, turning in sources)):
        return _integrated(scene, run, sources)
    signal = np.zeros((len(scene.channels), scene.n_samples))
    for forces, turning in sources:
        speed_rpm = turning.corners[0][1]
        steady = lines.driven_lines(scene, forces, speed_rpm, turning.lag)
        at_start = steady.amplitude * np.exp(2j * np.pi * steady.order * turning.mean_start_rev)
        signal += _steady(scene, run, motion, steady.order * speed_rpm / 60, at_start)
    return signal


def bearing_signal(scene: Scene, run: Run, motion: Motion) -> Floats:
    """Bearing lines, which follow the crank angle and are given as recorded, shape (channel, sample).

    ``scene``: the lines. ``run``: the recording. ``motion``: of its crank.
    """
    fixed, rate_hz = lines.fixed_lines(scene, run), scene.rate_hz(run.speed_rpm)
    delay_s = scene.by_channel(scene.acquisition.delay_s)
    signal = np.empty((len(scene.channels), scene.n_samples))
    for start in range(0, scene.n_samples, SAMPLES_AT_ONCE):
        sample = np.arange(start, min(start + SAMPLES_AT_ONCE, scene.n_samples))
        for delay in set(delay_s.tolist()):
            if isinstance(scene.sampling, parts.TimeSampling):
                turns = motion.at(sample / rate_hz - delay)[0]
            else:
                turns = motion.start_rev + sample / scene.sampling.samples_per_rev - delay * run.speed_rpm / 60
            phase = 2 * np.pi * np.outer(fixed.order, turns)
            late = np.flatnonzero(delay_s == delay)
            of_late = fixed.amplitude[late]
            signal[late, start : start + sample.size] = of_late.real @ np.cos(phase) - of_late.imag @ np.sin(phase)
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
            rings = lines.ringing(
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
    before_s = lines.ringing_s(part.resonance_hz, part.damping_ratio, filter=scene.filter)
    before_s += float(np.abs(scene.by_channel(scene.acquisition.delay_s)).max())
    duration_s = scene.n_samples / scene.rate_hz(run.speed_rpm)
    earlier = motion.begun_earlier(before_s)
    turning = [
        (stretch, earlier.at(np.array(stretch))[0]) for stretch in earlier.stretches(before_s + duration_s + before_s)
    ]
    if not turning:
        return np.empty(0), np.empty(0)
    stream = seed_stream(scene.seed, "bearing_impacts", str(number), run.stream)
    phase_rev = stream.random()
    angles = lines.strike_angles(
        lines.strikes_per_rev(orders, part.line),
        slip_percent=part.slip_percent,
        jitter_percent=part.jitter_percent,
        start_rev=float(min(ends.min() for _, ends in turning)),
        end_rev=float(max(ends.max() for _, ends in turning)),
        stream=stream,
    )
    shaft_ratio = bearing.shaft_ratio
    cage_order = lines.slipping_line(orders.get("FTF", 0.0), slip_percent=part.slip_percent)
    size = lines.modulation(
        part.line, angles, load_zone=part.load_zone, shaft_ratio=shaft_ratio, cage_order=cage_order, phase_rev=phase_rev
    )
    times, sizes = [], []
    for stretch, ends in turning:
        within = (angles >= ends.min()) & (angles <= ends.max())
        times.append(earlier.time_at(angles[within], stretch) - before_s)
        sizes.append(size[within])
    return np.concatenate(times), np.concatenate(sizes)


def _steady(scene: Scene, run: Run, motion: Motion, frequency_hz: Floats, amplitude: Complexes) -> Floats:
    """Steady tones of complex ``amplitude`` (channel, line) at the first sample, with the channels' delays."""
    delay_s = scene.by_channel(scene.acquisition.delay_s)
    late = amplitude * np.exp(-2j * np.pi * np.outer(delay_s, frequency_hz))
    rate_hz, n_samples = scene.rate_hz(run.speed_rpm), scene.n_samples
    if isinstance(scene.sampling, parts.TimeSampling) or motion.lag is None:
        return tones(late, frequency_hz, rate_hz=rate_hz, n_samples=n_samples)
    order = frequency_hz * 60 / run.speed_rpm
    at_zero = late * np.exp(-2j * np.pi * order * motion.mean_start_rev)
    order, by_angle = lines_in_angle(order, at_zero, motion.lag, speed_rpm=run.speed_rpm)
    return tones(by_angle, order, rate_hz=scene.sampling.samples_per_rev, n_samples=n_samples)


def _integrated(scene: Scene, run: Run, sources: list[tuple[ForceLines, Motion]]) -> Floats:
    """Response of the structure to forces of shafts whose speed changes, by integration of its modes.

    Channels of one delay are integrated together, on a clock that starts so much earlier: exact between samples too.
    """
    delay_s = scene.by_channel(scene.acquisition.delay_s)
    poles, rate_hz = poles_of(scene.structure, scene.filter), scene.rate_hz(run.speed_rpm)
    signal = np.empty((len(scene.channels), scene.n_samples))
    for delay in sorted(set(delay_s.tolist())):
        late = np.flatnonzero(delay_s == delay)
        signal[late] = driven_signal(
            poles.seen_by(late),
            [(forces, motion.begun_earlier(delay)) for forces, motion in sources],
            rate_hz=rate_hz,
            n_samples=scene.n_samples,
            gain_of_cycle=lines.gain_of_cycle(scene, run),
            revs_per_cycle=scene.engine.revs_per_cycle,
        )
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
    motion, noise = lines.crank_motion(scene, run), None
    if scene.broadband or scene.sensor_noise or scene.coloured_noise:
        noise = noise_signal(scene, run, floor)  # first: its transforms take the most memory
    signal = order_signal(scene, run, motion)
    effects = {"bearing_lines": bearing_signal, "tones": tone_signal, "bearing_impacts": impact_signal}
    for asked, effect in effects.items():
        if getattr(scene, asked):
            signal += effect(scene, run, motion)
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
        motion, n_samples = lines.crank_motion(scene, run), scene.n_samples
        encoder = encoder_signals(motion, scene.encoder, scene.encoder_faults, n_samples=n_samples, **of_run)
        faults += encoder.records
    converted = recorded(signal, scene.acquisition)
    faults += converter_records(converted.clipped_share, names=scene.channel_names, recording=run.name)
    named = [{**fault, "recording": f"{run.name}.h5"} for fault in faults]
    return SyntheticRecording(recorded=converted, encoder=encoder, faults=named)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Channel:
    """Samples of one channel (changed in place) and what its faults refer to."""

    samples: Floats
    peak: float
    """Largest absolute value of the finite samples without faults."""
    rate_hz: float
    stream: np.random.Generator
    limits: IngestSettings

    def span(self, at_s: float, duration_s: float) -> NDArray[np.intp]:
        """Numbers of the samples of a span of time, at least one."""
        first = math.ceil(at_s * self.rate_hz - 1e-6)
        stop = math.ceil(min((at_s + duration_s) * self.rate_hz - 1e-6, self.samples.size))
        return np.arange(first, max(first + 1, stop))


@dataclass(kw_only=True, eq=False)
class _Mark:
    """What a fault did: the pipeline's word for it, how bad, and to which samples (ascending)."""

    flag: str
    severity: Severity
    detail: str
    at: NDArray[np.intp]
    more: Mapping[str, float] = field(default_factory=dict)


def with_signal_faults(
    signal: Floats,
    faults: Sequence[parts.AnySignalFault],
    *,
    names: Sequence[str],
    recording: str,
    stream: str,
    rate_hz: float,
    seed: int,
) -> tuple[Floats, list[dict[str, Json]]]:
    """``signal`` with its ``faults``, one after the other, and a record of each fault of each channel.

    A record has the keys of a quality flag (recording, flag, severity, detail), the channel, ``first_sample`` and
    ``n_samples`` (all that the fault changed: their number, not only their range), ``start_s``, and what the kind adds:
    ``samples`` of spikes, ``level_m_s2`` of clipping. Flags are clipped, dropout,
    non_finite_interpolated (or gap where they are too many to bridge), otherwise the fault's kind; severities
    are those that the shipped settings of the pipeline give. Samples are counted in the final signal: what dropped
    samples move is recorded where it came to lie. Faults never depend on each other's chance.

    ``signal``: m/s², shape (channel, n); not changed. ``names``: of the channels. ``recording``: its name without
    suffix, which faults name and records bear. ``stream``: its name in the seed streams. ``rate_hz``: true samples per
    second. ``seed``: of the scene.
    No fault may begin beyond the end of the recording (:func:`impossible_faults` says it beforehand).
    """
    marks: list[tuple[str, _Mark]] = []
    faulty, limits = signal, None
    for number, fault in enumerate(faults):
        if fault.recordings and recording not in fault.recordings:
            continue
        if limits is None:
            faulty, limits = signal.copy(), load_settings().ingest
        for clean, samples, name in zip(signal, faulty, names, strict=True):
            if fault.channels and name not in fault.channels:
                continue
            if isinstance(fault, parts.DroppedSamples):
                _move(fault, [mark for other, mark in marks if other == name], rate_hz, samples.size)
            chance = seed_stream(seed, "signal_faults", str(number), stream, name)
            peak = float(np.max(np.abs(clean), where=np.isfinite(clean), initial=0.0))
            channel = _Channel(samples=samples, peak=peak, rate_hz=rate_hz, stream=chance, limits=limits)
            marks.append((name, _FAULTS[fault.kind](fault, channel)))
    return faulty, [_record(mark, name, recording, rate_hz) for name, mark in marks]


def converter_records(clipped_share: Floats, *, names: Sequence[str], recording: str) -> list[dict[str, Json]]:
    """Records of the channels that went beyond the range of the converter, as of :func:`with_signal_faults`.

    ``clipped_share``: 0 … 1, shape (channel,). ``names``: of the channels. ``recording``: its name.
    """
    limit = load_settings().ingest.max_clipped_fraction
    return [
        {
            "recording": recording,
            "channel": name,
            "flag": "clipped",
            "severity": "bad" if share > limit else "suspect",
            "detail": f"channel {name}: {share:.3%} of the samples were beyond the range of the converter",
        }
        for name, share in zip(names, clipped_share.tolist(), strict=True)
        if share
    ]


def impossible_faults(
    faults: Sequence[parts.AnySignalFault], *, n_samples: int, duration_s: float
) -> Iterator[tuple[str, str, str, str]]:
    """Problem, place, what was found and what is allowed for each of ``faults`` that a recording is too short for.

    ``n_samples`` and ``duration_s``: of the shortest recording.
    """
    for number, fault in enumerate(faults):
        place, first = f"signal_faults.{number}", 0.0
        if isinstance(fault, parts.IepeOverload | parts.NotANumber | parts.DroppedSamples | parts.Dropout):
            first = fault.at_s * n_samples / duration_s
        if first > n_samples - 1:
            yield "begins after the end", f"{place}.at_s", f"sample {first:.0f}", f"below {n_samples}"
        elif isinstance(fault, parts.DroppedSamples) and first + fault.count > n_samples - 2:
            yield "fewer samples are left to drop", f"{place}.count", str(fault.count), f"{n_samples - 2 - first:.0f}"
        if isinstance(fault, parts.Spikes) and fault.count > n_samples:
            yield "more spikes than samples", f"{place}.count", str(fault.count), f"up to {n_samples}"


def _move(fault: parts.DroppedSamples, marks: list[_Mark], rate_hz: float, n_samples: int) -> None:
    """Let ``marks`` go with the samples that come early, and that of the last sample with those that it fills."""
    first = math.ceil(fault.at_s * rate_hz - 1e-6)
    fill = np.arange(n_samples - fault.count, n_samples)
    for mark in marks:
        later = mark.at[mark.at >= first + fault.count] - fault.count
        filled = fill if mark.at.size and mark.at[-1] == n_samples - 1 else fill[:0]
        mark.at = np.concatenate([mark.at[mark.at < first], later, filled])


def _record(mark: _Mark, name: str, recording: str, rate_hz: float) -> dict[str, Json]:
    record: dict[str, Json] = {
        "recording": recording,
        "channel": name,
        "flag": mark.flag,
        "severity": mark.severity if mark.at.size else "info",
        "detail": f"channel {name}: {mark.detail}",
        "n_samples": int(mark.at.size),
    }
    if mark.at.size:
        record |= {"first_sample": int(mark.at[0]), "start_s": float(mark.at[0]) / rate_hz}
    if mark.flag == "spikes":
        record["samples"] = mark.at.tolist()
    return {**record, **mark.more}


def _clip(fault: parts.Clipping, channel: _Channel) -> _Mark:
    level = fault.of_peak * channel.peak
    beyond = np.abs(channel.samples) > level
    np.clip(channel.samples, -level, level, out=channel.samples)
    share = float(np.mean(beyond))
    return _Mark(
        flag="clipped",
        severity="bad" if share > channel.limits.max_clipped_fraction else "suspect",
        detail=f"{share:.3%} of the samples cut off beyond ±{level:.6g} m/s2",
        at=np.flatnonzero(beyond),
        more={"level_m_s2": level},
    )


def _overload(fault: parts.IepeOverload, channel: _Channel) -> _Mark:
    at = channel.span(fault.at_s, math.inf)
    step = fault.times_peak * channel.peak
    channel.samples[at[0] :] += step * np.exp((fault.at_s - at / channel.rate_hz) / fault.decay_s)
    detail = f"step of {step:.6g} m/s2 at {fault.at_s:g} s that decays with {fault.decay_s:g} s"
    more = {"step_m_s2": step, "decay_s": fault.decay_s}
    return _Mark(flag=fault.kind, severity="bad", detail=detail, at=at, more=more)


def _lose(fault: parts.NotANumber, channel: _Channel) -> _Mark:
    at = channel.span(fault.at_s, fault.duration_s)
    channel.samples[at] = np.nan
    few = at.size <= channel.limits.max_gap_samples
    few &= at.size <= channel.limits.max_gap_fraction * channel.samples.size
    most = channel.limits.max_missing_fraction * channel.samples.size
    flag, detail = "non_finite_interpolated" if few else "gap", f"{at.size} samples missing from {fault.at_s:g} s"
    return _Mark(flag=flag, severity="suspect" if at.size <= most else "bad", detail=detail, at=at)


def _spike(fault: parts.Spikes, channel: _Channel) -> _Mark:
    at = np.sort(channel.stream.choice(channel.samples.size, size=fault.count, replace=False))
    value = fault.times_peak * channel.peak
    channel.samples[at] = value * channel.stream.choice([-1.0, 1.0], size=fault.count)
    detail = f"{fault.count} single samples of ±{value:.6g} m/s2"
    return _Mark(flag=fault.kind, severity="suspect", detail=detail, at=at, more={"value_m_s2": value})


def _drift(fault: parts.Drift, channel: _Channel) -> _Mark:
    n = channel.samples.size
    channel.samples[:] += np.linspace(fault.offset_m_s2, fault.offset_m_s2 + fault.drift_m_s2, n)
    detail = f"offset {fault.offset_m_s2:g} m/s2, rising by {fault.drift_m_s2:g} m/s2 over the recording"
    more = {"offset_m_s2": fault.offset_m_s2, "drift_m_s2": fault.drift_m_s2}
    return _Mark(flag=fault.kind, severity="info", detail=detail, at=np.arange(n), more=more)


def _drop(fault: parts.DroppedSamples, channel: _Channel) -> _Mark:
    samples, first = channel.samples, int(channel.span(fault.at_s, 0.0)[0])
    last = samples[-1]
    samples[first : -fault.count] = samples[first + fault.count :].copy()
    samples[-fault.count :] = last
    detail = f"{fault.count} samples dropped at {fault.at_s:g} s; what follows comes early"
    at = np.arange(first, samples.size)
    return _Mark(flag=fault.kind, severity="bad", detail=detail, at=at, more={"dropped": fault.count})


def _zero(fault: parts.Dropout, channel: _Channel) -> _Mark:
    at = channel.span(fault.at_s, fault.duration_s)
    channel.samples[at] = 0.0
    found = at.size >= channel.limits.dropout_samples
    found &= at.size >= channel.limits.dropout_fraction * channel.samples.size
    detail = f"zero for {at.size} samples from {fault.at_s:g} s"
    return _Mark(flag=fault.kind, severity="bad" if found else "suspect", detail=detail, at=at)


_FAULTS: Mapping[str, Callable[..., _Mark]] = {
    "clipping": _clip, "iepe_overload": _overload, "not_a_number": _lose, "spikes": _spike, "drift": _drift,
    "dropped_samples": _drop, "dropout": _zero,
}  # fmt: skip
