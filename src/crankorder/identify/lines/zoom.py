"""The order of a line, or of two in one bin, from the phase by which it runs ahead; in a run-up modes turn it too."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.fft import fft
from scipy.special import gammainccinv

from crankorder.quantities import Complexes, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-lines.toml", "zoom")

GRID_PER_SPAN = 4
"""Trial orders per reciprocal length of the recording: between two of them a line loses at most 5 %."""

MOST_TERMS, LEAST_TERM = 40, 1e-12
"""Terms of the series for frames that lie off even places, and the share of a frame from which one counts."""


@dataclass(frozen=True)
class Zoomed:
    """A line in one recording: ``offset`` from its bin and its ``variance`` [orders], with ``dof`` degrees of freedom.

    ``amplitude`` (channels,) complex at crank angle 0 and its standard ``error``; ``span_rev`` from the first to the
    last frame's centre; ``snr`` the square of the mean's amplitude over its noise along one axis, over so many
    ``frames``; ``wander`` how much more of what is left after the line is slow than fast (NaN where not known);
    ``second`` a line beside it and ``left`` the power (channels,) of a frame that both leave, None without it;
    ``course`` how its phase runs over a run-up, None where the speed is held.
    """

    offset: float
    variance: float
    dof: float
    amplitude: Complexes
    error: Floats
    span_rev: float
    snr: float
    frames: float
    wander: float = np.nan
    second: Zoomed | None = None
    left: Floats | None = None
    course: Course | None = None
    swept: bool = False


@dataclass(frozen=True)
class Frames:
    """Frames of a recording: crank angles [rev] of their middles ``centre_rev`` (frames,), their length ``revs`` and
    ``hop_rev`` from one to the next; whether the speed is ``swept``; ``drift`` is the share by which a speed that is
    held drifts from the first to the last frame."""

    centre_rev: Floats
    revs: float
    hop_rev: float
    swept: bool = False
    drift: float = 0.0

    @property
    def middle(self) -> float:
        """Crank angle [rev] of the middle of the recording."""
        return float(0.5 * (self.centre_rev[0] + self.centre_rev[-1]))

    @cached_property
    def turn(self) -> Floats:
        """Crank angle [rev] (frames,) of each frame from the middle of the recording."""
        return self.centre_rev - self.middle

    def noise_of(self, rows: Floats, offset: float) -> Floats:
        """Noise amplitude of each of ``rows`` (rows, frames) of a line at ``offset`` in white noise of unit power.

        Frames that overlap share noise: slow waves over them hold more of it than fast ones.
        """
        power = np.ones(len(rows))
        for lag in range(1, len(self.turn)):
            apart = (self.turn[lag:] - self.turn[:-lag]) / self.revs
            if apart.min() >= 1.0:
                break
            part = np.minimum(apart, 1.0)
            full = 2.0 * np.pi * part
            alike = ((1.0 - part) * (2.0 + np.cos(full)) + 1.5 / np.pi * np.sin(full)) / 3.0  # of Hann windows
            alike = alike * np.cos(2.0 * np.pi * offset * apart * self.revs)
            power += 2.0 * (rows[:, lag:] * rows[:, :-lag]) @ alike
        return np.asarray(np.sqrt(np.maximum(power, 1e-3)))


def drift_turn_rev(drift: float) -> float:
    """Revolutions by which a speed that drifts by the share ``drift`` unseen may turn the phase."""
    return float(min(NUMBERS.most_drift_turn_rev, NUMBERS.turn_per_drift * drift))


def zoomed(
    phasors: Complexes, frames: Frames, *, noise: Floats | None = None, near: float | None = None, alone: bool = False
) -> Zoomed | None:
    """The line in one bin of the frames of one recording, or None where it is too weak there to follow its phase.

    The frames' phasors turn by the line's distance from the bin; of trial distances the one is taken at which they add
    up to most (the periodogram, which is the maximum-likelihood estimate of a line in white noise: Rife and Boorstyn
    1974), then the slope of the phase that is left. Its error is told by slower and faster waves of the same phasors.

    Parameters
    ----------
    phasors : (channels, frames), complex amplitudes whose phase is that from crank angle 0
    frames : where they stand: distances beyond half the reciprocal of their hop cannot be told from smaller ones
    noise : (channels, frames), noise power of each in a run-up; without it only the phase as a whole is followed
    near : distance from the bin that is expected; None looks everywhere that can be told
    alone : whether no second line is looked for
    """
    span = float(np.ptp(frames.centre_rev)) if len(frames.centre_rev) else 0.0
    if len(frames.centre_rev) < 2 or span <= 0.0:
        return None
    turn, hop_rev, swept, given = frames.turn, frames.hop_rev, frames.swept, phasors
    if swept and len(turn) >= 8:
        rows = _polynomials(turn, 2)  # over the smooth growth of a run-up, of the same mean
        growth = np.exp((np.log(np.maximum(np.abs(phasors), 1e-300)) @ rows.T) @ rows)
        phasors = phasors / growth * growth.mean(axis=1, keepdims=True)
    trial = _trials(span, hop_rev)
    expected = slice(None) if near is None else np.abs(trial - near) <= 0.25 / hop_rev + 1.0 / span
    trial, power = trial[expected], np.square(np.abs(turned_sums(phasors, turn, trial)))[:, expected] / len(turn)
    total = np.maximum(np.square(np.abs(phasors)).sum(axis=1), 1e-300)
    left = np.maximum(total - power.max(axis=1), 1e-9 * total)
    offset = float(trial[int(np.argmax((power / left[:, None]).sum(axis=0)))])
    line = _followed(phasors, frames, offset)
    second = _second(phasors, frames, line) if not alone and line.snr > NUMBERS.beating_squared else None
    if second is not None:
        line = _followed(phasors - _waves(second, turn), frames, line.offset)
        second = _followed(phasors - _waves(line, turn), frames, second.offset)
        if second.snr < NUMBERS.seen_squared:
            second = None
    course = course_of(given, turn, noise) if swept and noise is not None and second is None else None
    if line.snr < NUMBERS.seen_squared and course is None:
        return None
    wander = np.nan if alone or swept or second is not None else _wander(phasors, turn, line)
    if second is not None:
        line = replace(line, second=replace(second, amplitude=_at_zero(second, frames.middle)))
    if course is not None:  # it tells the order between the modes that the run-up crosses
        variance = (course.half / NUMBERS.sure_sigmas) ** 2
        line = replace(line, offset=course.offset, variance=variance, dof=1e6, course=course, swept=True)
    elif swept:
        several = 0.0 if second is not None else (NUMBERS.swept_turns_rev / line.span_rev) ** 2
        line = replace(line, swept=True, variance=line.variance + several)
    return replace(line, amplitude=_at_zero(line, frames.middle), wander=wander)


def left_of_slow_waves(phasors: Complexes, turn: Floats, *, hop_rev: float) -> float:
    """Power of a frame that is left of ``phasors`` (frames,) without the slow waves of a line; NaN for few frames.

    ``turn`` (frames,) is the crank angle of each in rev from the middle, ``hop_rev`` that from frame to frame. Lines so
    close that they beat less than twice in the recording leave the noise, a resonance that noise excites far more.
    """
    if len(turn) < 2 * (NUMBERS.noise_degrees + 1):
        return np.nan
    trial = _trials(float(np.ptp(turn)), hop_rev)
    best = trial[int(np.argmax(np.abs(turned_sums(phasors[None], turn, trial))))]
    slow = _polynomials(turn, NUMBERS.noise_degrees) @ (phasors * np.exp(-2j * np.pi * best * turn))
    left = float(np.square(np.abs(phasors)).sum() - np.square(np.abs(slow)).sum())
    return float(left / (len(turn) - NUMBERS.noise_degrees - 1))


def _at_zero(line: Zoomed, middle: float) -> Complexes:
    """Amplitude (channels,) of ``line`` at crank angle 0, from that at the ``middle`` of the recording, rev."""
    return np.asarray(line.amplitude * np.exp(-2j * np.pi * ((line.offset * middle) % 1.0)))


def _trials(span: float, hop_rev: float) -> Floats:
    """Trial distances from the bin [orders], evenly over all that frames ``hop_rev`` apart can tell."""
    reach = 0.5 / hop_rev
    return np.linspace(-reach, reach, 2 * int(np.ceil(GRID_PER_SPAN * reach * span)) + 1)


def turned_sums(phasors: Complexes, turn: Floats, trial: Floats, *, times: int = 1) -> Complexes:
    """Sums (channels, trials) of ``phasors`` (channels, frames) that turn back by ``times`` each ``trial`` distance.

    ``turn`` (frames,) says where the frames lie, in rev, ``trial`` (trials,) all distances that a hop between them can
    tell, evenly, an odd number. It is a transform of the frames where they lie a hop apart, to begin with; how far each
    lies off there goes into a Taylor series.
    """
    count, hop_rev = len(trial) - 1, 0.5 / trial[-1]
    place = np.round((turn - turn[0]) / hop_rev).astype(np.int64)
    off, wave = turn - turn[0] - hop_rev * place, -2j * np.pi * times * trial
    reached = times * (np.arange(count + 1) - count // 2) % count
    sums, part, factor = np.zeros((len(phasors), len(trial)), dtype=np.complex128), phasors + 0j, np.ones(len(trial))
    for power in range(1, MOST_TERMS):
        grid = np.zeros((count, len(phasors)), dtype=np.complex128)
        np.add.at(grid, place % count, part.T)
        sums += factor * fft(grid, axis=0)[reached].T
        part, factor = part * off, factor * wave / power
        if np.abs(part).max() * np.abs(factor).max() <= LEAST_TERM * np.abs(phasors).max():
            break
    return np.asarray(sums * np.exp(turn[0] * wave))


def _waves(line: Zoomed, turn: Floats) -> Complexes:
    """Phasors (channels, frames) of ``line`` at ``turn`` from the middle of the recording."""
    return np.asarray(line.amplitude[:, None] * np.exp(2j * np.pi * line.offset * turn))


def _followed(phasors: Complexes, frames: Frames, offset: float) -> Zoomed:
    """The line near ``offset``: least squares of the phase along the frames, whose noise is what is left of it.

    All channels are joined into one series, each by its amplitude over its noise, so that noise which they share is
    not taken for that of several.
    """
    turn = frames.turn
    degrees = min(len(turn) - 1, NUMBERS.noise_degrees + min(len(turn) // 16, NUMBERS.noise_degrees))
    rows = _polynomials(turn, degrees)
    slope, steady_from = float(rows[1] @ turn), 2 if frames.swept and degrees > 1 else 1
    level = frames.noise_of(rows, offset)
    for _ in range(3):
        steady = phasors * np.exp(-2j * np.pi * offset * turn)
        amplitude = steady.mean(axis=1)
        size = np.maximum(np.abs(amplitude), 1e-300)
        along = (steady * (amplitude.conj() / size)[:, None]) @ rows.T / level
        held = np.square(along[:, 2:].imag).sum(axis=1) + np.square(along[:, steady_from:].real).sum(axis=1)
        weight = size / np.maximum(held, 1e-18 * size**2)  # over the noise power in the slow waves
        joined = (weight @ along) / float(weight @ size)
        offset += float(joined[1].imag) * level[1] / slope / (2.0 * np.pi)
    kept = np.concatenate([joined[2:].imag, joined[steady_from:].real])
    dof = max(1.0, len(kept) - len(phasors) + 1.0)  # the weights of the channels were fitted to the same waves
    power = float(kept @ kept) / dof
    variance = power * level[1] ** 2 / (2.0 * np.pi * slope) ** 2
    unknown = NUMBERS.swept_turn_rev if frames.swept else drift_turn_rev(frames.drift)
    variance += (unknown / float(np.ptp(turn))) ** 2
    snr = len(turn) / max(power * level[0] ** 2, 1e-24)
    error = level[0] * np.sqrt(held / len(kept) / len(turn))
    return Zoomed(offset, variance, dof, amplitude, error, float(np.ptp(turn)), snr, float(len(turn)))


def _polynomials(turn: Floats, degrees: int) -> Floats:
    """Orthonormal polynomials (0 … ``degrees``, frames) over ``turn``, positive at its end."""
    return _polynomials_of(np.ascontiguousarray(turn, dtype=np.float64).tobytes(), degrees)


@functools.lru_cache(maxsize=256)
def _polynomials_of(turn: bytes, degrees: int) -> Floats:
    values = np.frombuffer(turn)
    basis = np.linalg.qr(np.vander(values / np.abs(values).max(), degrees + 1, increasing=True))[0].T
    rows = np.asarray(basis * np.where(basis[:, -1:] < 0.0, -1.0, 1.0))
    rows.flags.writeable = False
    return rows


def _second(phasors: Complexes, frames: Frames, line: Zoomed) -> Zoomed | None:
    """A second line beside ``line``, where noise, a modulation or the skirts of ``line`` would not look like it."""
    turn, span = frames.turn, float(np.ptp(frames.turn))
    if len(turn) < 8:
        return None
    left = phasors - _waves(line, turn)
    trial = _trials(span, frames.hop_rev)
    apart = np.abs(trial - line.offset) >= NUMBERS.second_cycles / span
    if np.count_nonzero(apart) < 8:
        return None
    trial, power = trial[apart], np.square(np.abs(turned_sums(left, turn, trial)))[:, apart]
    score = (power / np.maximum(np.median(power, axis=1, keepdims=True), 1e-300)).sum(axis=0)
    n = float(len(phasors))
    level = n * gammainccinv(n, NUMBERS.second_chance / len(turn)) / gammainccinv(n, 0.5)
    best = int(np.argmax(score))
    if score[best] < level:
        return None
    held, first = replace(frames, swept=False), line
    second = _followed(left, held, float(trial[best]))
    for _ in range(4):
        first = _followed(phasors - _waves(second, turn), held, first.offset)
        second = _followed(phasors - _waves(first, turn), held, second.offset)
    least = NUMBERS.swept_second_ratio if frames.swept else NUMBERS.second_ratio
    large = np.abs(second.amplitude) > least * np.abs(line.amplitude)
    if not large.any() or abs(second.offset - line.offset) < NUMBERS.second_cycles / span:
        return None
    mirror = np.abs((left * np.exp(-2j * np.pi * (2.0 * line.offset - second.offset) * turn)).mean(axis=1))
    if np.linalg.norm(mirror) > NUMBERS.mirrored_share * np.linalg.norm(second.amplitude):
        return None
    # it has one amplitude and phase in both halves of the recording
    waves = np.exp(2j * np.pi * np.outer(turn, [line.offset, second.offset]))
    halves = [np.linalg.lstsq(waves[part], phasors[:, part].T, rcond=None)[0][1] for part in (turn < 0, turn >= 0)]
    size = np.linalg.norm(halves[0]) + np.linalg.norm(halves[1])
    return second if np.linalg.norm(halves[0] - halves[1]) < NUMBERS.same_halves_share * size else None


def _wander(phasors: Complexes, turn: Floats, line: Zoomed) -> float:
    """Power of slow waves over that of all faster ones, in what is left of the frames without ``line``; by channel.

    The median over channels; NaN for few frames, or where what is left is less than ``wander_share`` of the line.
    """
    if len(turn) < 4 * NUMBERS.wander_degrees:
        return np.nan
    left = (phasors - _waves(line, turn)) * np.exp(-2j * np.pi * line.offset * turn)
    slow = np.square(np.abs(left @ _polynomials(turn, NUMBERS.wander_degrees)[1:].T)).sum(axis=1)
    fast = np.maximum(np.square(np.abs(left)).sum(axis=1) - slow, 1e-30)
    ratio = slow / NUMBERS.wander_degrees / (fast / (len(turn) - NUMBERS.wander_degrees - 1))
    large = slow / len(turn) > (NUMBERS.wander_share * np.abs(line.amplitude)) ** 2
    return float(np.median(np.where(large, ratio, 0.0)))


class Course(NamedTuple):
    """How the phase of a line runs over a recording: at ``offset`` orders from its bin, surely within ``half`` orders.

    ``slopes`` (stretches,) are those of its stretches, each known within ``reach``; they cover ``span_rev``.
    ``alike`` is the length of the mean of the unit phasors of its ``steps`` from frame to frame: 1 where all are alike.
    """

    offset: float
    half: float
    slopes: Floats
    reach: float
    span_rev: float
    alike: float
    steps: int

    def slips_from(self, offset: float) -> bool:
        """Whether the phase runs away from that of a line ``offset`` orders from the bin as modes cannot make it."""
        slope = self.slopes - offset
        mean = self.offset - offset
        if abs(mean) * self.span_rev < NUMBERS.least_turns_rev or self.half > NUMBERS.even_share * abs(mean):
            return False
        return bool(float(np.mean(slope * np.sign(mean) > self.reach)) >= NUMBERS.one_way_share)


def course_of(phasors: Complexes, turn: Floats, noise: Floats) -> Course | None:
    """How the phase of the line in ``phasors`` runs over a run-up; None where too few frames show it.

    Its turn per revolution is that at which most stretches of the run-up agree: a mode adds up to half a turn where it
    is crossed, several add up, but between them a locked line stands still. A slip turns all stretches alike.

    Parameters
    ----------
    phasors : (channels, frames), complex amplitudes in one bin whose phase is that from crank angle 0
    turn : (frames,), rev, crank angle of the middle of each frame
    noise : (channels, frames), noise power of each
    """
    scaled = phasors / np.sqrt(np.maximum(noise, 1e-300))
    product = (scaled[:, 1:] * scaled[:, :-1].conj()).sum(axis=0)
    power = np.square(np.abs(scaled)).sum(axis=0)
    size = np.maximum(np.abs(product), 1e-300)
    scatter = np.sqrt(0.5 * (power[1:] + power[:-1]) + len(phasors)) / size / (2.0 * np.pi)
    step, hop = np.angle(product) / (2.0 * np.pi), np.diff(turn)
    kept = scatter < NUMBERS.largest_scatter_rev
    if np.count_nonzero(kept) < NUMBERS.fewest_steps:
        return None
    step, hop, scatter = step[kept], hop[kept], scatter[kept]
    width = max(1, len(step) // NUMBERS.stretches)
    path = np.concatenate([[0.0], np.cumsum(step)])
    along = np.concatenate([[0.0], np.cumsum(hop)])
    length = along[width:] - along[:-width]
    slopes = (path[width:] - path[:-width]) / length
    noise_of_slope = float(np.sqrt(2.0) * np.median(scatter)) / float(np.median(length))
    ordered, count = np.sort(slopes), max(2, int(np.ceil(NUMBERS.densest_share * len(slopes))))
    spans = ordered[count - 1 :] - ordered[: len(ordered) - count + 1]
    first = int(np.argmin(spans))
    offset = float(np.median(ordered[first : first + count]))
    tails = NUMBERS.mode_tails_rev / float(np.median(length))
    independent = max(1.0, count / width)
    alike = float(np.abs(np.exp(2j * np.pi * step).mean()))
    half = 0.5 * float(spans[first]) + NUMBERS.sure_sigmas * noise_of_slope / float(np.sqrt(independent)) + tails
    reach = NUMBERS.sure_sigmas * noise_of_slope + tails
    return Course(offset, half, slopes, reach, float(along[-1]), alike, len(step))
