"""The wheel of an encoder, line by line, and the pulses that it gives under any motion of the shaft."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.synth.motion import Motion
from crankorder.synth.noise import seed_stream
from crankorder.synth.parts import Encoder

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

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

    rise: FloatArray
    fall: FloatArray
    nominal: FloatArray
    pitch: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Pulses:
    """Pulses in the sequence of time, shape (pulse,): from ``rise_s`` the level is high, from ``fall_s`` low.

    A pulse that was there before the recording rises at −∞, one that outlasts it falls at +∞. ``number``: counts the
    lines over all turns (line 0 of turn 0 is number 0), FALSE_PULSE where no line gave the pulse.
    """

    rise_s: FloatArray
    fall_s: FloatArray
    number: IntArray

    def where(self, keep: NDArray[np.bool_]) -> Pulses:
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
    nominal: FloatArray
    if encoder.tooth_angles_deg is not None:
        nominal = np.asarray(encoder.tooth_angles_deg, dtype=np.float64) / 360
    else:
        nominal = np.arange(encoder.pulses_per_rev - encoder.missing_teeth, dtype=np.float64) * pitch
    following: FloatArray = np.append(nominal[1:], nominal[0] + 1)
    room = np.minimum(pitch, following - nominal)
    error = np.zeros(nominal.size)
    if encoder.line_error_deg:
        stream = seed_stream(seed, "encoder", "lines")
        least = WIDEST_LINE_ERROR * np.minimum(room, np.roll(room, 1))
        error = np.clip(stream.standard_normal(nominal.size) * encoder.line_error_deg / 360, -least, least)
    rise = _true_turn(nominal - error, encoder)
    fall = _true_turn(nominal + room / 2 - error, encoder)
    return Wheel(rise=rise, fall=fall, nominal=nominal, pitch=pitch)


def index_wheel(wheel: Wheel, *, lasts_turn: float, lines_later: int = 0) -> Wheel:
    """Wheel of one line that rises with the first line of ``wheel`` and lasts ``lasts_turn`` of a turn, half at most.

    ``lines_later``: pitches by which the index has slipped.
    """
    rise = wheel.rise[:1] + lines_later * wheel.pitch
    return Wheel(rise=rise, fall=rise + min(lasts_turn, 0.5), nominal=rise, pitch=1.0)


def _true_turn(shown: FloatArray, encoder: Encoder) -> FloatArray:
    """Turns at which an eccentric wheel shows the turns ``shown``."""
    amplitude, phase = encoder.eccentricity_deg / 360, np.radians(encoder.eccentricity_phase_deg)
    turn = shown.copy()
    if amplitude:
        for _ in range(INVERSION_STEPS):
            angle = 2 * np.pi * turn + phase
            turn -= (turn + amplitude * np.sin(angle) - shown) / (1 + 2 * np.pi * amplitude * np.cos(angle))
    return turn


def encoder_turn(crank_rev: FloatArray, encoder: Encoder) -> FloatArray:
    """Turns of the encoder's shaft, 0 at its first line, at the crank angles ``crank_rev``.

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


def _edges_passed(turn: FloatArray, edge: FloatArray) -> int:
    """Number of the last edge at or below ``turn``: even where it is a rise."""
    whole = int(np.floor(turn[0] - edge[0]))
    return whole * edge.size + int(np.searchsorted(edge, turn[0] - whole, side="right")) - 1


def jittered(pulses: Pulses, stream: np.random.Generator, jitter_s: float) -> Pulses:
    """``pulses`` whose edges came ``jitter_s`` (standard deviation) early or late, in their sequence all the same.

    ``stream``: where the randomness comes from. ``jitter_s``: s, ≥ 0.
    """
    if not jitter_s:
        return pulses
    edges = np.stack((pulses.rise_s, pulses.fall_s), axis=1).ravel()
    edges += jitter_s * stream.standard_normal(edges.size)
    edges.sort(kind="stable")
    return Pulses(rise_s=edges[0::2], fall_s=edges[1::2], number=pulses.number)
