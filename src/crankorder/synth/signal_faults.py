"""Faults of the signals, put in on purpose, with a record of each in the words of the pipeline's quality flags."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray

from crankorder.quantities import Floats, Severity
from crankorder.records import Json
from crankorder.settings import IngestSettings, load_settings
from crankorder.synth import parts
from crankorder.synth.noise import seed_stream


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
        if first >= self.samples.size:
            raise ValueError(f"a fault begins at {at_s} s, after the end of the recording")
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
    Raises ValueError for a fault beyond the end of the recording (:func:`impossible_faults` says it beforehand).
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
            marks.append((name, _apply(fault, channel)))
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


@singledispatch
def _apply(fault: parts.SignalFault, channel: _Channel) -> _Mark:
    raise TypeError(f"no such fault: {type(fault).__name__}")


@_apply.register
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


@_apply.register
def _overload(fault: parts.IepeOverload, channel: _Channel) -> _Mark:
    at = channel.span(fault.at_s, math.inf)
    step = fault.times_peak * channel.peak
    channel.samples[at[0] :] += step * np.exp((fault.at_s - at / channel.rate_hz) / fault.decay_s)
    detail = f"step of {step:.6g} m/s2 at {fault.at_s:g} s that decays with {fault.decay_s:g} s"
    more = {"step_m_s2": step, "decay_s": fault.decay_s}
    return _Mark(flag=fault.kind, severity="bad", detail=detail, at=at, more=more)


@_apply.register
def _lose(fault: parts.NotANumber, channel: _Channel) -> _Mark:
    at = channel.span(fault.at_s, fault.duration_s)
    channel.samples[at] = np.nan
    few = at.size <= channel.limits.max_gap_samples
    few &= at.size <= channel.limits.max_gap_fraction * channel.samples.size
    most = channel.limits.max_missing_fraction * channel.samples.size
    flag, detail = "non_finite_interpolated" if few else "gap", f"{at.size} samples missing from {fault.at_s:g} s"
    return _Mark(flag=flag, severity="suspect" if at.size <= most else "bad", detail=detail, at=at)


@_apply.register
def _spike(fault: parts.Spikes, channel: _Channel) -> _Mark:
    at = np.sort(channel.stream.choice(channel.samples.size, size=fault.count, replace=False))
    value = fault.times_peak * channel.peak
    channel.samples[at] = value * channel.stream.choice([-1.0, 1.0], size=fault.count)
    detail = f"{fault.count} single samples of ±{value:.6g} m/s2"
    return _Mark(flag=fault.kind, severity="suspect", detail=detail, at=at, more={"value_m_s2": value})


@_apply.register
def _drift(fault: parts.Drift, channel: _Channel) -> _Mark:
    n = channel.samples.size
    channel.samples[:] += np.linspace(fault.offset_m_s2, fault.offset_m_s2 + fault.drift_m_s2, n)
    detail = f"offset {fault.offset_m_s2:g} m/s2, rising by {fault.drift_m_s2:g} m/s2 over the recording"
    more = {"offset_m_s2": fault.offset_m_s2, "drift_m_s2": fault.drift_m_s2}
    return _Mark(flag=fault.kind, severity="info", detail=detail, at=np.arange(n), more=more)


@_apply.register
def _drop(fault: parts.DroppedSamples, channel: _Channel) -> _Mark:
    samples, first = channel.samples, int(channel.span(fault.at_s, 0.0)[0])
    if first + fault.count >= samples.size:
        raise ValueError(f"{fault.count} samples cannot be dropped at {fault.at_s} s: fewer are left")
    last = samples[-1]
    samples[first : -fault.count] = samples[first + fault.count :].copy()
    samples[-fault.count :] = last
    detail = f"{fault.count} samples dropped at {fault.at_s:g} s; what follows comes early"
    at = np.arange(first, samples.size)
    return _Mark(flag=fault.kind, severity="bad", detail=detail, at=at, more={"dropped": fault.count})


@_apply.register
def _zero(fault: parts.Dropout, channel: _Channel) -> _Mark:
    at = channel.span(fault.at_s, fault.duration_s)
    channel.samples[at] = 0.0
    found = at.size >= channel.limits.dropout_samples
    found &= at.size >= channel.limits.dropout_fraction * channel.samples.size
    detail = f"zero for {at.size} samples from {fault.at_s:g} s"
    return _Mark(flag=fault.kind, severity="bad" if found else "suspect", detail=detail, at=at)
