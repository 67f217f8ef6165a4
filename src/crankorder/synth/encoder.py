"""The shaft encoder as a data-acquisition system records it, and its faults, on the pulses of its lines and index."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from crankorder.synth.motion import Motion
from crankorder.synth.noise import seed_stream
from crankorder.synth.parts import (
    AnyEncoderFault,
    DamagedLine,
    DoublePulses,
    Encoder,
    EncoderDropout,
    ExtraIndex,
    IndexSlip,
    LostIndex,
    LostPulses,
)
from crankorder.synth.wheel import (
    FALSE_PULSE,
    FloatArray,
    Pulses,
    Wheel,
    encoder_turn,
    index_wheel,
    jittered,
    passed_pulses,
    wheel_of,
)

Record = dict[str, Any]

MOST_TRIES = 10_000
"""Random times that are tried until one is free of index marks."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracks:
    """Pulses of the lines and of the index (None without one) of a recording, and what faults need to know of it.

    ``ratio``: turns of the encoder per crank revolution. ``duration_s``: of the recording. ``pickup``: whether lines
    give waves instead of levels. ``shortest_s``: the shortest level, or half wave, that the form of delivery surely
    shows. ``index_later``: index pulses as if the index sat so many lines later. ``false_s``: times of false pulses,
    and ``false_width_s`` how long the level differs (or half the wave lasts) for them. ``silent_s``: beginnings and
    ends of dropouts.
    """

    lines: Pulses
    index: Pulses | None
    wheel: Wheel
    ratio: float
    duration_s: float
    pickup: bool
    shortest_s: float
    index_later: Callable[[int], Pulses]
    false_s: FloatArray
    false_width_s: FloatArray
    silent_s: tuple[tuple[float, float], ...]


def with_encoder_faults(
    tracks: Tracks, faults: Sequence[AnyEncoderFault], *, seed: int, recording: str, stream: str
) -> tuple[Tracks, list[Record]]:
    """``tracks`` after the faults of this recording, and a record of each thing put in.

    A record holds recording, flag (that of the pipeline for such a thing), severity, detail, count, and where: times_s,
    lines and angles_deg. A fault for which there is no room (more pulses lost than came, say) acts as far as it can,
    and its record counts what was done.

    ``tracks``: pulses without faults. ``faults``: of the scene, in their sequence. ``seed``: of the scene.
    ``recording``: name of the recording without suffix; ``stream``: its name for the seed streams.
    """
    records: list[Record] = []
    for number, fault in enumerate(faults):
        if fault.recordings and recording not in fault.recordings:
            continue
        chance = seed_stream(seed, "encoder_faults", str(number), stream)
        tracks, found = _acted(tracks, fault, chance)
        records += [{"recording": recording, **record} for record in found if record["count"]]
    return tracks, records


def _acted(tracks: Tracks, fault: AnyEncoderFault, stream: np.random.Generator) -> tuple[Tracks, list[Record]]:
    match fault:
        case LostPulses():
            return _lost_pulses(tracks, fault, stream)
        case DamagedLine():
            return _damaged_line(tracks, fault)
        case DoublePulses():
            return _double_pulses(tracks, fault, stream)
        case EncoderDropout():
            return _dropout(tracks, fault)
    if tracks.index is None:
        return tracks, []
    match fault:
        case LostIndex():
            return _lost_index(tracks, tracks.index, fault, stream)
        case ExtraIndex():
            return _extra_index(tracks, tracks.index, fault, stream)
        case IndexSlip():
            return _index_slip(tracks, tracks.index, fault)


def _record(flag: str, detail: str, count: int, **where: Any) -> Record:
    return {"flag": flag, "severity": "suspect", "detail": detail, "count": count, **where}


def _inner(tracks: Tracks) -> NDArray[np.intp]:
    """True pulses that rise within the recording, without the first and the last, whose loss would leave no trace."""
    lines = tracks.lines
    inside = (lines.rise_s > 0) & (lines.rise_s < tracks.duration_s) & (lines.number != FALSE_PULSE)
    return np.flatnonzero(inside)[1:-1]


def _lost_pulses(tracks: Tracks, fault: LostPulses, stream: np.random.Generator) -> tuple[Tracks, list[Record]]:
    inner = _inner(tracks)
    lost = np.sort(stream.choice(inner, size=min(fault.count, inner.size), replace=False))
    keep = np.ones(tracks.lines.rise_s.size, dtype=np.bool_)
    keep[lost] = False
    record = _record(
        "encoder_missing_pulse",
        f"{lost.size} lost pulses",
        int(lost.size),
        times_s=tracks.lines.rise_s[lost].tolist(),
        lines=(tracks.lines.number[lost] % tracks.wheel.rise.size).tolist(),
    )
    return replace(tracks, lines=tracks.lines.where(keep)), [record]


def _damaged_line(tracks: Tracks, fault: DamagedLine) -> tuple[Tracks, list[Record]]:
    lines, wheel = tracks.lines, tracks.wheel
    damaged = sorted({line for line in fault.lines if line < wheel.rise.size})
    lost = np.isin(lines.number % wheel.rise.size, damaged) & (lines.number != FALSE_PULSE)
    inside = lost & (lines.rise_s >= 0) & (lines.rise_s < tracks.duration_s)
    angles = (wheel.nominal[damaged] * 360).tolist()
    record = _record(
        "encoder_damaged_line",
        f"pulse lost at {', '.join(f'{angle:.2f}' for angle in angles)} degrees after the index",
        int(inside.sum()),
        lines=damaged,
        angles_deg=angles,
    )
    return replace(tracks, lines=lines.where(~lost)), [record]


def _double_pulses(tracks: Tracks, fault: DoublePulses, stream: np.random.Generator) -> tuple[Tracks, list[Record]]:
    """False pulses: a short high where the level is low, or a short low before it where the level is high."""
    lines = tracks.lines
    time_s = lines.rise_s[_inner(tracks)] + fault.delay_s
    time_s = time_s[time_s < tracks.duration_s]
    host = np.searchsorted(lines.rise_s, time_s, side="right") - 1
    within = time_s < lines.fall_s[host]
    if tracks.pickup:
        width, seen = _room_in_wave(tracks, time_s, host, fault.delay_s)
    else:
        width, seen = _room_in_level(tracks, time_s, host, fault.delay_s)
    chosen = stream.permutation(np.flatnonzero(seen))
    _, first = np.unique(2 * host[chosen] + within[chosen], return_index=True)  # no two in one level
    chosen = np.sort(chosen[np.sort(first)[: fault.count]])
    time_s, width, host, within = time_s[chosen], width[chosen], host[chosen], within[chosen]
    fall_s = lines.fall_s.copy()
    false = Pulses(
        rise_s=time_s,
        fall_s=np.where(within, fall_s[host], time_s + width),
        number=np.full(time_s.size, FALSE_PULSE),
    )
    fall_s[host[within]] = time_s[within] - width[within]
    record = _record("encoder_double_pulse", f"{time_s.size} false pulses", int(time_s.size), times_s=time_s.tolist())
    return replace(
        tracks,
        lines=replace(lines, fall_s=fall_s).joined(false),
        false_s=np.append(tracks.false_s, time_s),
        false_width_s=np.append(tracks.false_width_s, width),
    ), [record]


def _room_in_level(
    tracks: Tracks, time_s: FloatArray, host: NDArray[np.intp], delay_s: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """How long the level of a square wave differs for false pulses at ``time_s``, and whether all levels are seen."""
    rise_s, fall_s = tracks.lines.rise_s[host], tracks.lines.fall_s[host]
    within = time_s < fall_s
    before = time_s - np.where(within, rise_s, fall_s)
    after = np.where(within, fall_s, np.append(tracks.lines.rise_s[1:], np.inf)[host]) - time_s
    width = np.minimum(delay_s, np.where(within, before, after)) / 2
    shortest = np.minimum(np.minimum(width, before - width * within), after - width * ~within)
    return width, (shortest >= tracks.shortest_s) & (shortest > 0)


def _room_in_wave(
    tracks: Tracks, time_s: FloatArray, host: NDArray[np.intp], delay_s: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Half length of the waves of false pulses, and whether the lines beside them still show."""
    rise_s = tracks.lines.rise_s
    before, after = time_s - rise_s[host], np.append(rise_s[1:], np.inf)[host] - time_s
    width = np.full(time_s.size, max(delay_s / 4, tracks.shortest_s))
    sample_s = tracks.shortest_s / 3
    return width, np.minimum(before, after) - width >= (before + after) / 12 + sample_s


def _lost_index(
    tracks: Tracks, index: Pulses, fault: LostIndex, stream: np.random.Generator
) -> tuple[Tracks, list[Record]]:
    inside = np.flatnonzero((index.rise_s > 0) & (index.rise_s < tracks.duration_s))
    if fault.count is None:
        record = _record("no_index", "no index mark", int(inside.size))
        return replace(tracks, index=index.where(np.zeros(index.rise_s.size, dtype=np.bool_))), [record]
    inner = inside[1:-1]
    lost = np.sort(stream.choice(inner, size=min(fault.count, inner.size), replace=False))
    keep = np.ones(index.rise_s.size, dtype=np.bool_)
    keep[lost] = False
    times = index.rise_s[lost].tolist()
    record = _record("index_lost", f"{lost.size} index marks lost", int(lost.size), times_s=times)
    return replace(tracks, index=index.where(keep)), [record]


def _extra_index(
    tracks: Tracks, index: Pulses, fault: ExtraIndex, stream: np.random.Generator
) -> tuple[Tracks, list[Record]]:
    """False marks a fourth as long as true ones, at least their own length away from any other mark."""
    whole = np.isfinite(index.rise_s) & np.isfinite(index.fall_s)
    lasts = index.fall_s[whole] - index.rise_s[whole]
    width = max(float(np.median(lasts)) / 4 if lasts.size else 0.0, tracks.shortest_s)
    times: list[float] = []
    for _ in range(MOST_TRIES):
        if len(times) == fault.count:
            break
        at = float(stream.random()) * tracks.duration_s
        near = (index.rise_s < at + 2 * width) & (index.fall_s > at - width)
        if not near.any() and width < at < tracks.duration_s - width and all(abs(at - t) > 2 * width for t in times):
            times.append(at)
    rise_s = np.sort(np.array(times))
    false = Pulses(rise_s=rise_s, fall_s=rise_s + width, number=np.full(rise_s.size, FALSE_PULSE))
    record = _record("index_extra", f"{rise_s.size} false index marks", int(rise_s.size), times_s=rise_s.tolist())
    return replace(tracks, index=index.joined(false)), [record]


def _index_slip(tracks: Tracks, index: Pulses, fault: IndexSlip) -> tuple[Tracks, list[Record]]:
    """Marks from the fault on at their later place; those that an earlier fault took away stay away."""
    later = tracks.index_later(fault.pulses)
    true = index.number != FALSE_PULSE
    stays = index.where((index.rise_s < fault.at_s) | ~true)
    before = index.where(true & (index.rise_s < fault.at_s))
    number = index.number[true]
    known = np.isin(later.number, number)
    if number.size:
        known |= (later.number < number.min()) | (later.number > number.max())
    if before.rise_s.size:
        known &= (later.rise_s > before.fall_s[-1]) & (later.number != before.number[-1])
    slipped = later.where(known)
    inside = (slipped.rise_s >= 0) & (slipped.rise_s < tracks.duration_s)
    even = np.allclose(tracks.wheel.nominal, np.arange(tracks.wheel.nominal.size) * tracks.wheel.pitch)
    whole = tracks.wheel.nominal.size * tracks.wheel.pitch > 1 - 1e-9
    record = _record(
        "encoder_slip" if even and whole else "index_slip",  # only an uneven wheel tells that it was not the count
        f"index slipped by {fault.pulses} pulses",
        1 if fault.pulses and inside.any() else 0,
        times_s=slipped.rise_s[inside][:1].tolist(),
        pulses=fault.pulses,
    )
    return replace(tracks, index=stays.joined(slipped)), [record]


def _dropout(tracks: Tracks, fault: EncoderDropout) -> tuple[Tracks, list[Record]]:
    start_s, end_s = fault.at_s, fault.at_s + fault.duration_s
    if tracks.pickup:
        silenced = tracks.lines.where((tracks.lines.rise_s < start_s) | (tracks.lines.rise_s >= end_s))
    else:
        silenced = _held(tracks.lines, start_s, end_s)
    where = {"times_s": [start_s, min(end_s, tracks.duration_s)]}
    lost = _rises(tracks.lines, tracks) - _rises(silenced, tracks)
    # a standstill to the decoder, which knows the shaft again behind it, where it lasts as long as a pitch at 30 rpm
    gap = fault.duration_s > 2 * tracks.wheel.pitch / tracks.ratio
    flag = "encoder_gap" if gap else "encoder_missing_pulse"
    records = [_record(flag, f"{lost} lost pulses in a dropout", lost, **where)]
    index = tracks.index
    if index is not None:
        held = _held(index, start_s, end_s)
        lost = _rises(index, tracks) - _rises(held, tracks)
        if not gap:
            records.append(_record("index_lost", f"{lost} index marks lost in a dropout", lost, **where))
        index = held
    stays = (tracks.false_s < start_s) | (tracks.false_s >= end_s)
    return replace(
        tracks,
        lines=silenced,
        index=index,
        false_s=tracks.false_s[stays],
        false_width_s=tracks.false_width_s[stays],
        silent_s=(*tracks.silent_s, (start_s, end_s)),
    ), records


def _rises(pulses: Pulses, tracks: Tracks) -> int:
    return int(np.sum((pulses.rise_s >= 0) & (pulses.rise_s < tracks.duration_s)))


def _held(pulses: Pulses, start_s: float, end_s: float) -> Pulses:
    """``pulses`` without the edges from ``start_s`` to ``end_s``, the level staying as it was before."""
    keep = (pulses.rise_s < start_s) | (pulses.rise_s >= end_s)
    high = np.flatnonzero((pulses.rise_s < start_s) & (pulses.fall_s >= start_s) & (pulses.fall_s < end_s))
    if not high.size:
        return pulses.where(keep)
    # high until the first fall after the end, so that the rise before that fall makes no edge
    until = int(np.searchsorted(pulses.fall_s, end_s))
    fall_s = pulses.fall_s.copy()
    fall_s[high[0]] = fall_s[until] if until < fall_s.size else np.inf
    keep[high[0] + 1 : until + 1] = False
    return replace(pulses, fall_s=fall_s).where(keep)


SQUARE_SAMPLES, PICKUP_SAMPLES = 1.01, 3.0
"""Samples that a level, or half a wave of a pickup, must last so that it is surely seen."""
WIDEST_WAVE = 4.0
"""Pitches that the wave of a pickup spans at most; the gap of a 36-2 or 60-2 wheel has 3."""
PICKUP_INDEX_TURN = 0.1
"""Shortest mark beside a pickup: read like one, a mark that is high more rarely would not show its height."""
BLOCK_SAMPLES = 1 << 18
"""Samples whose angles are held at one time."""


def sampled_encoder(
    start_rev: float, speed_rpm: float, *, pulses_per_rev: int, high_v: float, rate_hz: float, n_samples: int
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Square wave of the encoder (V) and index mark (0 or 1) at constant speed, each of shape (n_samples,).

    A pulse rises at every whole 1/pulses_per_rev of a revolution and is high for the first half of it; the index is
    high for the first pulse period of each revolution, or for half of the revolution where that is less.

    ``start_rev``: angle of the encoder at the first sample, ≥ 0. ``speed_rpm``: of the encoder, > 0.
    ``pulses_per_rev``: ≥ 1. ``high_v``: volts of the high level. ``rate_hz``: samples per second; each half pulse needs
    at least one sample. ``n_samples``: ≥ 1.
    """
    half_pulses_per_rev = 2 * pulses_per_rev
    per_sample = half_pulses_per_rev * speed_rpm / (60 * rate_hz)
    position = np.arange(n_samples, dtype=np.float64)
    position *= per_sample
    position += half_pulses_per_rev * start_rev
    half_pulse = position.astype(np.int32)
    encoder = np.float32(high_v) * (half_pulse & 1 == 0)
    index = (half_pulse % half_pulses_per_rev < min(2, pulses_per_rev)).view(np.uint8)
    return encoder.astype(np.float32, copy=False), index


@dataclass(frozen=True, kw_only=True, eq=False)
class EncoderSignals:
    """What an encoder gives to one recording; None where its form of delivery or the encoder has no such thing.

    ``trace``: V, shape (sample,), square or analogue. ``index``: 0 or 1, shape (sample,). ``pulse_s``, ``index_s``:
    times of rising edges from the first sample, shape (pulse,). ``records``: the faults that were put in.
    """

    trace: NDArray[np.float32] | None
    index: NDArray[np.uint8] | None
    pulse_s: NDArray[np.float64] | None
    index_s: NDArray[np.float64] | None
    records: list[Record]


def encoder_signals(
    motion: Motion,
    encoder: Encoder,
    faults: Sequence[AnyEncoderFault],
    *,
    seed: int,
    recording: str,
    stream: str,
    rate_hz: float,
    n_samples: int,
) -> EncoderSignals:
    """Signals of the encoder under any motion, as it delivers them, with a record of every fault.

    Edges are exact in time; a sample has the level that the last edge before it left. The angle that an encoder shows
    is ratio·(crank angle + index_to_tdc_deg): its first line and its index come at whole turns of it. Times that a
    counter takes are rounded to its clock.

    ``motion``: of the crank; the first sample is at its time 0. ``encoder``: what the scene says of it. ``faults``: of
    the scene, for any recordings. ``seed``: of the scene. ``recording``: name without suffix; ``stream``: name for the
    seed streams. ``rate_hz``: samples per second. ``n_samples``: ≥ 1.
    """
    faulty = any(not fault.recordings or recording in fault.recordings for fault in faults)
    if not faulty and _is_plain(motion, encoder):
        return _plain_signals(motion, encoder, rate_hz=rate_hz, n_samples=n_samples)
    tracks = _perfect_tracks(motion, encoder, seed=seed, stream=stream, rate_hz=rate_hz, n_samples=n_samples)
    came = tracks.lines
    tracks, records = with_encoder_faults(tracks, faults, seed=seed, recording=recording, stream=stream)
    if encoder.delivered_as == "pulse_times":
        pulse_s = _counted(tracks.lines, encoder, tracks.duration_s)
        index_s = None if tracks.index is None else _counted(tracks.index, encoder, tracks.duration_s)
        return EncoderSignals(trace=None, index=None, pulse_s=pulse_s, index_s=index_s, records=records)
    if encoder.delivered_as == "square":
        trace = sampled_level(tracks.lines, encoder.high_v, rate_hz=rate_hz, n_samples=n_samples)
    else:
        trace = _pickup(tracks, came, motion, encoder, rate_hz=rate_hz, n_samples=n_samples)
        if encoder.noise_v:
            noise = seed_stream(seed, "encoder", "noise", stream)
            trace += np.float32(encoder.noise_v) * noise.standard_normal(n_samples, dtype=np.float32)
    index = None
    if tracks.index is not None:
        index = sampled_level(tracks.index, 1.0, rate_hz=rate_hz, n_samples=n_samples).astype(np.uint8)
    return EncoderSignals(trace=trace, index=index, pulse_s=None, index_s=None, records=records)


def _perfect_tracks(
    motion: Motion, encoder: Encoder, *, seed: int, stream: str, rate_hz: float, n_samples: int
) -> Tracks:
    """Pulses of lines and index before any fault; jitter is no fault."""
    duration_s = n_samples / rate_hz
    wheel = wheel_of(encoder, seed=seed)
    lasts_turn = max(PICKUP_INDEX_TURN, wheel.pitch) if encoder.delivered_as == "analogue" else wheel.pitch

    def index_later(lines: int) -> Pulses:
        mark = index_wheel(wheel, lasts_turn=lasts_turn, lines_later=lines)
        pulses = passed_pulses(mark, motion, encoder, duration_s=duration_s)
        return jittered(pulses, seed_stream(seed, "encoder", "index_jitter", stream), encoder.jitter_s)

    exact = passed_pulses(wheel, motion, encoder, duration_s=duration_s)
    return Tracks(
        lines=jittered(exact, seed_stream(seed, "encoder", "jitter", stream), encoder.jitter_s),
        index=index_later(0) if encoder.index else None,
        wheel=wheel,
        ratio=encoder.ratio,
        duration_s=duration_s,
        pickup=encoder.delivered_as == "analogue",
        shortest_s=_shortest_s(encoder, rate_hz),
        index_later=index_later,
        false_s=np.empty(0),
        false_width_s=np.empty(0),
        silent_s=(),
    )


def _is_plain(motion: Motion, encoder: Encoder) -> bool:
    """Whether the encoder is a perfect one, sampled as a square wave, on a shaft of constant speed forwards."""
    flaws = encoder.missing_teeth or encoder.eccentricity_deg or encoder.line_error_deg or encoder.jitter_s
    perfect = not flaws and encoder.tooth_angles_deg is None and encoder.delivered_as == "square"
    return perfect and motion.is_steady and motion.corners[0][1] > 0


def _plain_signals(motion: Motion, encoder: Encoder, *, rate_hz: float, n_samples: int) -> EncoderSignals:
    start_turn = float(encoder_turn(np.array([motion.start_rev]), encoder)[0])
    if not 0 <= start_turn < 1e3:  # whole turns would only cost digits, or not fit the counter
        start_turn -= math.floor(start_turn)
    trace, index = sampled_encoder(
        start_turn,
        encoder.ratio * motion.corners[0][1],
        pulses_per_rev=encoder.pulses_per_rev,
        high_v=encoder.high_v,
        rate_hz=rate_hz,
        n_samples=n_samples,
    )
    return EncoderSignals(trace=trace, index=index if encoder.index else None, pulse_s=None, index_s=None, records=[])


def _shortest_s(encoder: Encoder, rate_hz: float) -> float:
    if encoder.delivered_as == "pulse_times":
        return 1 / encoder.counter_hz if encoder.counter_hz else 0.0
    return (SQUARE_SAMPLES if encoder.delivered_as == "square" else PICKUP_SAMPLES) / rate_hz


def _counted(pulses: Pulses, encoder: Encoder, duration_s: float) -> NDArray[np.float64]:
    """Times (s) of the rises within the recording, rounded to the clock of the counter."""
    rise_s = pulses.rise_s[(pulses.rise_s >= 0) & (pulses.rise_s < duration_s)]
    return np.rint(rise_s * encoder.counter_hz) / encoder.counter_hz if encoder.counter_hz else rise_s


def sampled_level(pulses: Pulses, high: float, *, rate_hz: float, n_samples: int) -> NDArray[np.float32]:
    """``high`` at the samples within a pulse, else 0, shape (n_samples,).

    ``pulses``: in the sequence of time. ``high``: level. ``rate_hz``: samples per second, the first at time 0.
    ``n_samples``: ≥ 1.
    """
    edge = np.stack((pulses.rise_s, pulses.fall_s), axis=1).ravel()
    first = np.ceil(np.clip(edge * rate_hz, 0, n_samples)).astype(np.int64)
    lasts = np.diff(first, prepend=0, append=n_samples)
    level = np.zeros(lasts.size, dtype=np.float32)
    level[1::2] = high
    return np.repeat(level, lasts)


def _pickup(
    tracks: Tracks, came: Pulses, motion: Motion, encoder: Encoder, *, rate_hz: float, n_samples: int
) -> NDArray[np.float32]:
    """Voltage of a magnetic pickup: speed times a full wave from line to line, rising through zero at each.

    Across a gap one wave reaches from the last line to the next, the higher the wider it is (the flux swings further,
    as measured wheels show), up to WIDEST_WAVE pitches. ``came``: pulses before any faults. A false pulse is a wave of
    its own in place of what was there; a dropout lasts until the wave is below zero.
    """
    place = _line_places(tracks, came, motion, encoder)
    widest, gain = WIDEST_WAVE * tracks.wheel.pitch, encoder.high_v / encoder.pickup_rpm
    trace = np.empty(n_samples, dtype=np.float32)
    for start in range(0, n_samples, BLOCK_SAMPLES):
        block = slice(start, min(start + BLOCK_SAMPLES, n_samples))
        crank_rev, speed_rpm, _ = motion.at(np.arange(block.start, block.stop) / rate_hz)
        _waves(encoder_turn(crank_rev, encoder), speed_rpm, place, widest, gain / tracks.wheel.pitch, trace[block])
    for at_s, width_s in zip(tracks.false_s, tracks.false_width_s, strict=True):
        first, end = math.ceil((at_s - width_s) * rate_hz), math.floor((at_s + width_s) * rate_hz) + 1
        samples = np.arange(max(first, 0), min(end, n_samples))
        height = gain * abs(float(motion.at(np.array([at_s]))[1][0]))
        trace[samples] = height * np.sin(np.pi * (samples / rate_hz - at_s) / width_s)
    for silent in tracks.silent_s:
        first, end = (min(math.ceil(at_s * rate_hz), n_samples) for at_s in silent)
        below = np.flatnonzero(trace[end:] <= 0)
        trace[first : end + int(below[0]) if below.size else n_samples] = 0
    return trace


def _line_places(tracks: Tracks, came: Pulses, motion: Motion, encoder: Encoder) -> NDArray[np.float64]:
    """Turns of the encoder at which lines gave pulses, ascending, one turn beyond the recording at either end."""
    rise = tracks.wheel.rise
    ends = np.array([0.0, tracks.duration_s, *(at for pair in motion.stretches(tracks.duration_s) for at in pair)])
    turn = encoder_turn(motion.at(ends)[0], encoder)
    number = np.arange((math.floor(turn.min()) - 2) * rise.size, (math.floor(turn.max()) + 3) * rise.size)
    place: NDArray[np.float64] = rise[number % rise.size] + number // rise.size
    if encoder.jitter_s:
        lines = tracks.lines.where(tracks.lines.number != FALSE_PULSE)
        probe = np.where(np.isfinite(lines.rise_s), lines.rise_s, 0.0)
        at_s = np.where(motion.at(probe)[1] >= 0, lines.rise_s, lines.fall_s)
        known = np.isfinite(at_s)
        place[lines.number[known] - number[0]] = encoder_turn(motion.at(at_s[known])[0], encoder)
        place = np.maximum.accumulate(place)
    if tracks.lines is came:
        return place
    absent = np.setdiff1d(came.number, tracks.lines.number)
    for start_s, end_s in tracks.silent_s:
        absent = np.setdiff1d(absent, came.number[(came.rise_s >= start_s) & (came.rise_s < end_s)])
    return place[~np.isin(number, absent)]


@njit(cache=True, nogil=True)
def _waves(turn, speed_rpm, place, widest, gain, out):  # type: ignore[no-untyped-def]
    """Write into ``out`` the wave of each sample between the neighbouring lines of ``place``."""
    k = 0
    while k + 2 < place.size and place[k + 1] <= turn[0]:
        k += 1
    for i in range(turn.size):
        while k + 2 < place.size and place[k + 1] <= turn[i]:
            k += 1
        while k > 0 and place[k] > turn[i]:
            k -= 1
        apart = place[k + 1] - place[k]
        wave = min(apart, widest)
        behind, ahead = turn[i] - place[k], place[k + 1] - turn[i]
        if behind < 0.5 * wave:
            out[i] = gain * speed_rpm[i] * wave * np.sin(2.0 * np.pi * behind / wave)
        elif ahead < 0.5 * wave:
            out[i] = -gain * speed_rpm[i] * wave * np.sin(2.0 * np.pi * ahead / wave)
        else:
            out[i] = 0.0
