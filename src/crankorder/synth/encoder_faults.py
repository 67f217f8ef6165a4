"""Faults of an encoder, each on the pulses of its lines and of its index."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crankorder.synth.faults import (
    AnyEncoderFault,
    DamagedLine,
    DoublePulses,
    EncoderDropout,
    ExtraIndex,
    IndexSlip,
    LostIndex,
    LostPulses,
)
from crankorder.synth.noise import seed_stream
from crankorder.synth.wheel import FALSE_PULSE, FloatArray, Pulses, Wheel

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
