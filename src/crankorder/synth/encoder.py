"""The shaft encoder: its wheel line by line, the pulses of any motion, its faults, and the samples of all that."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from crankorder.quantities import Bools, Floats, Ints
from crankorder.records import Json
from crankorder.synth.motion import Motion
from crankorder.synth.noise import seed_stream
from crankorder.synth.parts import AnyEncoderFault, DamagedLine, DoublePulses, Encoder, LostPulses

FALSE_PULSE = int(np.iinfo(np.int64).min)
"""Number of a pulse that no line gave."""
WIDEST_LINE_ERROR = 0.24
"""Share of a pitch beyond which the error of a line is cut off, for the lines must keep their sequence."""
INVERSION_STEPS = 60
"""Newton steps for where an eccentric wheel shows an angle; a tenth of them is enough up to some degrees."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Wheel:
    """Edges of the lines in turns of the encoder, as a shaft that turns forwards meets them.

    ``rise``, ``fall``: shape (line,), both ascending, each rise before its fall and the next rise; the first rise is
    near 0. ``pitch``: of the full wheel. ``nominal``: where the lines should be.
    """

    rise: Floats
    fall: Floats
    nominal: Floats
    pitch: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Pulses:
    """Pulses in the sequence of time, shape (pulse,): from ``rise_s`` the level is high, from ``fall_s`` low.

    A pulse that was there before the recording rises at −∞, one that outlasts it falls at +∞. ``number``: counts the
    lines over all turns (line 0 of turn 0 is number 0), FALSE_PULSE where no line gave the pulse.
    """

    rise_s: Floats
    fall_s: Floats
    number: Ints

    def where(self, keep: Bools) -> Pulses:
        """The pulses for which ``keep``, shape (pulse,), is true."""
        return Pulses(rise_s=self.rise_s[keep], fall_s=self.fall_s[keep], number=self.number[keep])

    def joined(self, other: Pulses) -> Pulses:
        """These pulses and ``other`` by time; where two overlap the earlier one ends when the later one begins."""
        rise = np.concatenate((self.rise_s, other.rise_s))
        order = np.argsort(rise, kind="stable")
        fall = np.concatenate((self.fall_s, other.fall_s))[order]
        rise = rise[order]
        fall[:-1] = np.minimum(fall[:-1], rise[1:])
        return Pulses(rise_s=rise, fall_s=fall, number=np.concatenate((self.number, other.number))[order])


def wheel_of(encoder: Encoder, *, seed: int) -> Wheel:
    """Wheel with its pattern, its eccentricity and the errors of its lines; all recordings of a scene have the same.

    The angle that the encoder shows, less its true angle, is a·sin(2π·turn + phase) plus the error of the line. Each
    line is high for half a pitch of the full wheel, or half the way to the next line where that is nearer.

    ``encoder``: pattern and errors. ``seed``: of the scene.
    """
    pitch = 1 / encoder.pulses_per_rev
    nominal = np.arange(encoder.pulses_per_rev - encoder.missing_teeth, dtype=np.float64) * pitch
    following: Floats = np.append(nominal[1:], nominal[0] + 1)
    room = np.minimum(pitch, following - nominal)
    error = np.zeros(nominal.size)
    if encoder.line_error_deg:
        stream = seed_stream(seed, "encoder", "lines")
        least = WIDEST_LINE_ERROR * np.minimum(room, np.roll(room, 1))
        error = np.clip(stream.standard_normal(nominal.size) * encoder.line_error_deg / 360, -least, least)
    rise = _true_turn(nominal - error, encoder)
    fall = _true_turn(nominal + room / 2 - error, encoder)
    return Wheel(rise=rise, fall=fall, nominal=nominal, pitch=pitch)


def _true_turn(shown: Floats, encoder: Encoder) -> Floats:
    """Turns at which an eccentric wheel shows the turns ``shown``."""
    amplitude, phase = encoder.eccentricity_deg / 360, np.radians(encoder.eccentricity_phase_deg)
    turn = shown.copy()
    if amplitude:
        for _ in range(INVERSION_STEPS):
            angle = 2 * np.pi * turn + phase
            turn -= (turn + amplitude * np.sin(angle) - shown) / (1 + 2 * np.pi * amplitude * np.cos(angle))
    return turn


def encoder_turn(crank_rev: Floats, encoder: Encoder) -> Floats:
    """Turns of the encoder's shaft, 0 at its first line, at the crank angles ``crank_rev`` (n,).

    ``encoder``: its ratio, and the angle from its index to top dead centre.
    """
    return encoder.ratio * (crank_rev + encoder.index_to_tdc_deg / 360)


def passed_pulses(wheel: Wheel, motion: Motion, encoder: Encoder, *, duration_s: float) -> Pulses:
    """Pulses that ``wheel`` gives from 0 to ``duration_s``, to round-off; the level is a function of the angle alone.

    A line that the shaft passes backwards rises where it falls forwards. ``motion``: of the crank. ``encoder``: how its
    shaft follows the crank.
    """
    edge = np.stack((wheel.rise, wheel.fall), axis=1).ravel()
    start_rev = motion.at(np.zeros(1))[0]
    now = _edges_passed(encoder_turn(start_rev, encoder), edge)
    times, numbers = [], []
    if now % 2 == 0:
        times.append(np.array([-np.inf]))
        numbers.append(np.array([now // 2]))
    for stretch in motion.stretches(duration_s):
        end_rev = motion.at(np.array(stretch))[0][1:]
        last = _edges_passed(encoder_turn(end_rev, encoder), edge)
        passed = np.arange(now + 1, last + 1) if last >= now else np.arange(now, last, -1)
        now = last
        if passed.size == 0:
            continue
        turn = edge[passed % edge.size] + passed // edge.size
        time_s = motion.time_at(turn / encoder.ratio - encoder.index_to_tdc_deg / 360, stretch)
        times.append(np.maximum.accumulate(np.clip(time_s, *stretch)))
        numbers.append(passed // 2)
    time_s = np.concatenate([*times, np.array([np.inf])])
    number = np.concatenate([*numbers, np.zeros(1, dtype=np.int64)])
    whole = slice(0, time_s.size // 2 * 2, 2)  # a pulse that outlasts the recording takes the infinity
    return Pulses(rise_s=time_s[whole], fall_s=time_s[1::2], number=number[whole])


def _edges_passed(turn: Floats, edge: Floats) -> int:
    """Number of the last edge at or below ``turn``: even where it is a rise."""
    whole = int(np.floor(turn[0] - edge[0]))
    return whole * edge.size + int(np.searchsorted(edge, turn[0] - whole, side="right")) - 1


SEEN_SAMPLES = 1.01
"""Samples that a level must last so that it is surely seen."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Pulses of the ``lines`` of a ``wheel`` in a recording, and what faults need to know of it.

    ``duration_s``: of the recording. ``shortest_s``: the shortest level that its samples surely show.
    """

    lines: Pulses
    wheel: Wheel
    duration_s: float
    shortest_s: float


def _record(flag: str, detail: str, count: int, **where: Sequence[float]) -> dict[str, Json]:
    return {"flag": flag, "severity": "suspect", "detail": detail, "count": count, **where}


def _inner(track: Track) -> NDArray[np.intp]:
    """True pulses that rise within the recording, without the first and the last, whose loss would leave no trace."""
    lines = track.lines
    inside = (lines.rise_s > 0) & (lines.rise_s < track.duration_s) & (lines.number != FALSE_PULSE)
    return np.flatnonzero(inside)[1:-1]


def _lost_pulses(track: Track, fault: LostPulses, stream: np.random.Generator) -> tuple[Track, dict[str, Json]]:
    inner = _inner(track)
    lost = np.sort(stream.choice(inner, size=min(fault.count, inner.size), replace=False))
    keep = np.ones(track.lines.rise_s.size, dtype=np.bool_)
    keep[lost] = False
    times_s = track.lines.rise_s[lost].tolist()
    lines = (track.lines.number[lost] % track.wheel.rise.size).tolist()
    record = _record("encoder_missing_pulse", f"{lost.size} lost pulses", int(lost.size), times_s=times_s, lines=lines)
    return replace(track, lines=track.lines.where(keep)), record


def _damaged_line(track: Track, fault: DamagedLine, _: np.random.Generator) -> tuple[Track, dict[str, Json]]:
    lines, wheel = track.lines, track.wheel
    damaged = sorted({line for line in fault.lines if line < wheel.rise.size})
    lost = np.isin(lines.number % wheel.rise.size, damaged) & (lines.number != FALSE_PULSE)
    inside = lost & (lines.rise_s >= 0) & (lines.rise_s < track.duration_s)
    angles = (wheel.nominal[damaged] * 360).tolist()
    detail = f"pulse lost at {', '.join(f'{angle:.2f}' for angle in angles)} degrees after the index"
    record = _record("encoder_damaged_line", detail, int(inside.sum()), lines=damaged, angles_deg=angles)
    return replace(track, lines=lines.where(~lost)), record


def _double_pulses(track: Track, fault: DoublePulses, stream: np.random.Generator) -> tuple[Track, dict[str, Json]]:
    """False pulses: a short high where the level is low, or a short low before it where the level is high."""
    lines = track.lines
    time_s = lines.rise_s[_inner(track)] + fault.delay_s
    time_s = time_s[time_s < track.duration_s]
    host = np.searchsorted(lines.rise_s, time_s, side="right") - 1
    within = time_s < lines.fall_s[host]
    width, seen = _room_in_level(track, time_s, host, fault.delay_s)
    chosen = stream.permutation(np.flatnonzero(seen))
    _, first = np.unique(2 * host[chosen] + within[chosen], return_index=True)  # no two in one level
    chosen = np.sort(chosen[np.sort(first)[: fault.count]])
    time_s, width, host, within = time_s[chosen], width[chosen], host[chosen], within[chosen]
    fall_s = lines.fall_s.copy()
    false = Pulses(
        rise_s=time_s, fall_s=np.where(within, fall_s[host], time_s + width), number=np.full(time_s.size, FALSE_PULSE)
    )
    fall_s[host[within]] = time_s[within] - width[within]
    record = _record("encoder_double_pulse", f"{time_s.size} false pulses", int(time_s.size), times_s=time_s.tolist())
    return replace(track, lines=replace(lines, fall_s=fall_s).joined(false)), record


_FAULTS: Mapping[str, Callable[..., tuple[Track, dict[str, Json]]]] = {
    "lost_pulses": _lost_pulses, "damaged_line": _damaged_line, "double_pulses": _double_pulses,
}  # fmt: skip


def _room_in_level(track: Track, time_s: Floats, host: NDArray[np.intp], delay_s: float) -> tuple[Floats, Bools]:
    """How long the level of a square wave differs for false pulses at ``time_s``, and whether all levels are seen."""
    rise_s, fall_s = track.lines.rise_s[host], track.lines.fall_s[host]
    within = time_s < fall_s
    before = time_s - np.where(within, rise_s, fall_s)
    after = np.where(within, fall_s, np.append(track.lines.rise_s[1:], np.inf)[host]) - time_s
    width = np.minimum(delay_s, np.where(within, before, after)) / 2
    shortest = np.minimum(np.minimum(width, before - width * within), after - width * ~within)
    return width, (shortest >= track.shortest_s) & (shortest > 0)


@dataclass(frozen=True, kw_only=True, eq=False)
class EncoderSignals:
    """What an encoder gives to one recording.

    ``trace``: V, shape (sample,), a square wave. ``index``: 0 or 1, shape (sample,), None for an encoder without.
    ``records``: the faults that were put in.
    """

    trace: NDArray[np.float32]
    index: NDArray[np.uint8] | None
    records: list[dict[str, Json]]


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
    """Signals of the encoder under any motion, with a record of every fault.

    A record holds recording, flag (that of the pipeline for such a thing), severity, detail, count, and where: times_s,
    lines and angles_deg. A fault for which there is no room (more pulses lost than came, say) acts as far as it can,
    and its record counts what was done.

    Edges are exact in time; a sample has the level that the last edge before it left. The angle that an encoder shows
    is ratio·(crank angle + index_to_tdc_deg): its first line and its index come at whole turns of it.

    ``motion``: of the crank; the first sample is at its time 0. ``encoder``: what the scene says of it. ``faults``: of
    the scene, for any recordings. ``seed``: of the scene. ``recording``: name without suffix; ``stream``: name for the
    seed streams. ``rate_hz``: samples per second. ``n_samples``: ≥ 1.
    """
    wheel, duration_s = wheel_of(encoder, seed=seed), n_samples / rate_hz
    lines = passed_pulses(wheel, motion, encoder, duration_s=duration_s)
    track = Track(lines=lines, wheel=wheel, duration_s=duration_s, shortest_s=SEEN_SAMPLES / rate_hz)
    records: list[dict[str, Json]] = []
    for number, fault in enumerate(faults):
        if not fault.recordings or recording in fault.recordings:
            chance = seed_stream(seed, "encoder_faults", str(number), stream)
            track, record = _FAULTS[fault.kind](track, fault, chance)
            records += [{"recording": recording, **record}] if record["count"] else []
    trace = sampled_level(track.lines, encoder.high_v, rate_hz=rate_hz, n_samples=n_samples)
    index = None
    if encoder.index:
        # one line that rises with the first one of the wheel and lasts a pitch, half a turn at most
        rise = wheel.rise[:1]
        mark = Wheel(rise=rise, fall=rise + min(wheel.pitch, 0.5), nominal=rise, pitch=1.0)
        marks = passed_pulses(mark, motion, encoder, duration_s=duration_s)
        index = sampled_level(marks, 1.0, rate_hz=rate_hz, n_samples=n_samples).astype(np.uint8)
    return EncoderSignals(trace=trace, index=index, records=records)


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
