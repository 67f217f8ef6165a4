"""Speed from the vibration itself: the run of speeds whose orders the spectra show best, and how sure it is.

Per knot every speed has log odds (``vibration_angle``). Speed changes no faster than a slew limit, so the most likely
run of speeds is found by dynamic programming. It is refined by the phase of its orders. Which simple ratio of it
explains the lines best is decided along that angle, by the same order spectra and with frames of the same length, where
frames of the search for the speed are longer for lower speeds and so show more lines of them. Other ratios that do
nearly as well are told as ties.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from crankorder.errors import InputError
from crankorder.fft.decimation import decimate, decimation_factor
from crankorder.fft.resampling import PASS_BAND, margin, values_at
from crankorder.fft.windows import hann
from crankorder.settings import ShaftSettings
from crankorder.shaft.angle import AngleKnots, time_at
from crankorder.shaft.pulses import FloatArray, Remark
from crankorder.shaft.repair import IntArray
from crankorder.shaft.vibration_angle import (
    FRAME_REVS,
    ODDS,
    SpeedEvidence,
    TrackedAngle,
    best_combs,
    comb_evidence,
    tracked_angle,
)


def likeliest_run(log_odds: FloatArray, jump: int, cost: float) -> IntArray:
    """States (knots,) of the likeliest run through a grid (Viterbi 1967).

    ``log_odds``: (knots, states). ``jump``: most states between two knots. ``cost``: what a step of n states costs is n
    squared times that.
    """
    n, m = log_odds.shape
    came = np.zeros((n, m), dtype=np.int16)
    steps = np.arange(-jump, jump + 1)
    before = np.full(m + 2 * jump, -np.inf)
    before[jump : jump + m] = log_odds[0]
    from_states = np.lib.stride_tricks.sliding_window_view(before, m)
    price = -cost * steps[:, None] ** 2.0
    for i in range(1, n):
        reached = from_states + price
        best = np.argmax(reached, axis=0)
        came[i] = steps[best]
        before[jump : jump + m] = reached[best, np.arange(m)] + log_odds[i]
    path = np.empty(n, dtype=np.int64)
    path[-1] = np.argmax(before[jump : jump + m])
    for i in range(n - 1, 0, -1):
        path[i - 1] = path[i] + came[i, path[i]]
    return path


def run_probability(
    log_odds: FloatArray, path: IntArray, offsets: IntArray, jump: int, cost: float, near: int
) -> FloatArray:
    """Probability (knots,) that the state is that of a run, or beside it by an offset (Baum et al. 1970).

    ``log_odds``, ``jump``, ``cost``: as for :func:`likeliest_run`. ``path``: (knots,), the run. ``offsets``: states
    from it to others that count as the same. ``near``: states from each of them that do too.
    """
    n, m = log_odds.shape
    step = np.exp(-cost * np.arange(-jump, jump + 1.0) ** 2)
    step /= step.sum()
    ahead = np.empty((n, m), dtype=np.float32)
    now = np.full(m, 1.0 / m)
    for i in range(n):
        now = np.convolve(now, step)[jump : jump + m] * np.exp(log_odds[i] - log_odds[i].max())
        now /= now.sum()
        ahead[i] = now
    result = np.empty(n)
    behind = np.ones(m)
    wanted = (offsets[:, None] + np.arange(-near, near + 1)).ravel()
    for i in range(n - 1, -1, -1):
        both = ahead[i] * behind
        close = np.unique(path[i] + wanted)
        close = close[(close >= 0) & (close < m)]
        result[i] = both[close].sum() / max(float(both.sum()), 1e-300)
        behind = np.convolve(behind * np.exp(log_odds[i] - log_odds[i].max()), step)[jump : jump + m]
        behind /= behind.max()
    return np.minimum(result, 1.0)


# Revolutions of a frame in which harmonic families are compared, while the speed changes and where it is steady within
# this ratio; the most frames, and the highest order looked at.
FAMILY_REVS, STEADY, FAMILY_FRAMES, FAMILY_ORDER = (24.0, 48.0), 1.1, 64, 16.0
# Power over noise that one frame can add there, that a fixed tone which an order passes makes it no line; and to the
# shape of a line.
FAMILY_CAP, FAMILY_SHAPE = 6.0, 1000.0
# Log odds of single frames count as so many of them, beside those of the mean of all; then a third, for all see
# the same lines.
FRAMES_WORTH = 3
# A line of the mean spectrum is so many times the power beside it: natural frequencies are broader, but change of speed
# spreads them out of it anyhow.
PROMINENCE = (1.0, 2.0)


@dataclass(frozen=True)
class FamilyEvidence:
    """Log odds (ratios,) of each fundamental against none, and of single frames (frames, ratios) at ``time_s``."""

    log_odds: FloatArray
    time_s: FloatArray
    of_frames: FloatArray


def family_evidence(
    signals: FloatArray,
    rate_hz: float,
    tracked: TrackedAngle,
    *,
    ratio: FloatArray,
    order: FloatArray,
    weight: FloatArray,
) -> FamilyEvidence:
    """Log odds of the fundamentals at ``ratio`` times the tracked speed, all from the same order spectra.

    Parameters
    ----------
    signals : (channels, samples)
    rate_hz : samples per second
    tracked : the angle that is sure but for its ratio
    ratio : (ratios,)
    order : (orders,), orders of each fundamental
    weight : (orders,), 0…1, probability that the order shows
    """
    from scipy.special import gammaincc

    slow, fast = np.quantile(tracked.speed_hz, [0.1, 0.9])
    steady = bool(fast < STEADY * slow)
    revs = min(FAMILY_REVS[steady], 0.5 * float(tracked.angle_rev[-1]))
    time_s, times = _order_power(signals, rate_hz, tracked, revs)
    seen = np.count_nonzero(np.isfinite(times[0]), axis=0)
    place = ratio[:, None] * order * 2.0 * revs
    of_frames = np.full((times.shape[1], ratio.size), -np.inf)
    for frame, best in zip(np.moveaxis(times, 1, 0), of_frames, strict=True):
        unseen = np.isnan(frame[0]).astype(np.float64)
        power = np.nan_to_num(frame)[:, None, :]
        best_combs(power, np.ones_like(power), 3, unseen, place, weight, ODDS, best[None])
    # as unlikely in a mean of so many frames as this power in one
    over = np.nansum(np.minimum(times, FAMILY_CAP), axis=1)
    single = -np.log(np.maximum(gammaincc(np.maximum(seen, 1.0), over), 1e-300))
    shape = np.nansum(np.minimum(times, FAMILY_SHAPE), axis=1)
    beside = np.maximum(np.roll(shape, 3, axis=1), np.roll(shape, -3, axis=1))
    peaks = np.where(PROMINENCE[steady] * beside > shape, 0.0, single)[:, None, :]
    of_mean = np.full((1, ratio.size), -np.inf)
    best_combs(peaks, np.ones_like(peaks), seen.size, (seen == 0).astype(np.float64), place, weight, ODDS, of_mean)
    total = (1.0 / 3.0) * (of_mean[0] + min(FRAMES_WORTH, times.shape[1]) * np.mean(of_frames, axis=0))
    return FamilyEvidence(total, time_s, of_frames)


def _order_power(
    signals: FloatArray, rate_hz: float, tracked: TrackedAngle, revs: float
) -> tuple[FloatArray, FloatArray]:
    """Times [s] of frames of ``revs`` revolutions, and their power over the noise beside it (channels, frames, bins).

    A bin is half of a line's resolution; the power is NaN outside the band.
    """
    total = float(tracked.angle_rev[-1])
    count = int(min(FAMILY_FRAMES, max(1, (total - revs) / (0.5 * revs))))
    centre = np.linspace(0.5 * revs, total - 0.5 * revs, count + 2)[1:-1] if count > 1 else np.array([0.5 * total])
    band = min(1.5 * FAMILY_ORDER * float(tracked.speed_hz.max()), PASS_BAND * rate_hz)
    reduced, rate, start_s = decimate(signals, rate_hz=rate_hz, band_hz=band, factor=decimation_factor(rate_hz, band))
    padded = np.pad(reduced, ((0, 0), (margin() + 2, margin() + 2)))
    at = (tracked.time_s, tracked.angle_rev, 60.0 * tracked.speed_hz)
    bins = int(FAMILY_ORDER * 2.0 * revs)
    times = np.empty((signals.shape[0], count, bins))
    for i, (middle, speed) in enumerate(
        zip(centre, np.interp(centre, tracked.angle_rev, tracked.speed_hz), strict=True)
    ):
        n = max(2 * bins, math.ceil(1.3 * rate / speed * revs))
        place = (time_at(middle + revs * (np.arange(n) / n - 0.5), *at) - start_s) * rate
        place = np.clip(place, 0.0, reduced.shape[1] - 1.0)
        framed = values_at(padded, place + margin() + 2) * hann(n).values
        power = np.abs(np.fft.rfft(framed, n=2 * n, axis=1)[:, :bins]) ** 2
        inside = np.arange(bins) / (2.0 * revs) * speed <= min(band, PASS_BAND * rate)
        times[:, i] = np.where(inside, power / _median_beside(power, round(2.0 * revs)), np.nan)
    return time_at(centre, *at), times


def _median_beside(power: FloatArray, reach: int) -> FloatArray:
    """Median of ``power`` (channels, bins) within ``reach`` bins of each, as a mean of noise."""
    reach = min(reach, power.shape[1] - 1)
    padded = np.pad(power, ((0, 0), (reach, reach)), mode="reflect")
    median = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=1), axis=-1) / math.log(2.0)
    floor: FloatArray = np.maximum(median, 1e-12 * power.max() + 1e-300)
    return floor


ORDER_WEIGHTS = {1.0: 0.75, 2.0: 0.7, 3.0: 0.45, 4.0: 0.5, 5.0: 0.3, 6.0: 0.35, 7.0: 0.25, 8.0: 0.3}
"""Orders that any rotating machine may show, and the probability that it does."""

FOUR_STROKE_WEIGHTS = {
    0.5: 0.4, 1.0: 0.6, 1.5: 0.4, 2.0: 0.8, 2.5: 0.35, 3.0: 0.5, 3.5: 0.3, 4.0: 0.6, 4.5: 0.25,
    5.0: 0.3, 5.5: 0.2, 6.0: 0.4, 7.0: 0.2, 8.0: 0.3,
}  # fmt: skip
"""Orders that a four-stroke engine may show, half orders among them."""

TIE_RATIOS = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2.0, 3.0, 4.0)
"""Ratios of speeds whose orders coincide in part."""

# A recording holds so many frames of the lowest speed that is sought, and its band so many orders of the highest.
FEWEST_FRAMES, FEWEST_ORDERS = 2.0, 2.0
# Speeds within this share of the found one are the same speed.
SAME_SPEED = 0.02
# The run that moving lines show is a sweep, not noise, where its speeds differ by this much (in the logarithm) and its
# log odds are this share of those of the run that all lines show.
SWEEP_SPREAD, SWEEP_SHARE = 0.15, 0.5
# Log odds that another fundamental must gain in a row of frames before a run is taken to have slipped to it; how far
# beside it (in the logarithm) the run is sought again, and the log odds of what is farther.
SWITCH, MENDED_REACH, FAR_ODDS = 8.0, 0.15, 50.0
# Sudden changes of slew: the usual slew is this share of the limit.
USUAL_SLEW = 0.3
# Confidence below which a stretch is told, and below which it is a guess: a recording of which most is one is refused.
DOUBTFUL, GUESSED = 0.5, 0.2
SELDOM = 0.01
"""Share of the time up to which a doubtful speed, as at the very ends, is not worth a word."""


@dataclass(frozen=True)
class Tie:
    """Another fundamental, ``ratio`` times the found one, and its odds as a share of the found one's (0…1)."""

    ratio: float
    relative_evidence: float


@dataclass(frozen=True)
class VibrationSpeed:
    """Crank speed (knots,) at ``time_s`` [s] with its standard error, as the vibration tells it.

    ``confidence`` (0…1 per knot) is the probability that the speed is within 2 % of ``speed_rpm``, by the model of
    lines and noise; ``ties`` are other fundamentals that explain the lines nearly as well, best first; ``knots`` the
    crank angle, whose slope the speed is.
    """

    time_s: FloatArray
    speed_rpm: FloatArray
    standard_error_rpm: FloatArray
    confidence: FloatArray
    ties: list[Tie]
    remarks: list[Remark]
    knots: AngleKnots


def speed_from_vibration(
    signals: FloatArray,
    rate_hz: float,
    *,
    settings: ShaftSettings,
    expected_rpm: tuple[float, float] | None = None,
    order_weights: Mapping[float, float] | None = None,
    fixed_hz: Sequence[float] = (),
) -> VibrationSpeed:
    """Speed of the shaft whose orders the signals show, to a fraction of a per cent, with confidence and ties.

    Parameters
    ----------
    signals : (channels, samples), any units: each counts over its own noise
    rate_hz : samples per second
    settings : ``vibration_range_rpm`` where expected_rpm is not given, ``vibration_revs``, ``vibration_slew_per_s``,
        ``vibration_tie``
    expected_rpm : lowest and highest speed that is possible, rpm; a narrow range decides ties
    order_weights : orders with the probability (0…1) that the machine shows them; None for what any rotating machine
        shows (ORDER_WEIGHTS). A four-stroke engine needs its half orders (FOUR_STROKE_WEIGHTS), for without them half
        of its speed, that of the camshaft, explains more
    fixed_hz : tones that belong to no order, as mains and its harmonics, Hz

    Returns
    -------
    VibrationSpeed; time counts from the first sample.

    Raises
    ------
    InputError where the recording is too short or too slowly sampled for every speed of the range, holds samples that
    are not finite, or is constant.
    """
    signals = _checked(signals)
    weights = dict(ORDER_WEIGHTS if order_weights is None else order_weights)
    order = np.array(sorted(weights))
    weight = np.clip([weights[each] for each in sorted(weights)], 0.0, 0.95)
    stated = expected_rpm or settings.vibration_range_rpm
    range_hz = _range_hz(stated, signals.shape[1], rate_hz, settings)
    evidence = comb_evidence(
        signals, rate_hz, range_hz=range_hz, order=order, weight=weight, settings=settings, fixed_hz=fixed_hz
    )
    explained = partial(_explained, signals, rate_hz, evidence, range_hz=range_hz, order=order, weight=weight)
    run = explained(*_likely_run(evidence, settings))
    path = _mended_path(run, evidence, settings)
    if path is not None:
        run = explained(run.log_odds, path)
    tracked, ratio, chosen = run.tracked, run.ratio, run.chosen
    if ratio[chosen] != 1.0:
        speed_hz = ratio[chosen] * np.interp(evidence.time_s, tracked.time_s, tracked.speed_hz)
        tracked = tracked_angle(signals, rate_hz, time_s=evidence.time_s, speed_hz=speed_hz, order=order)
    share = np.exp(run.family.log_odds - run.best)
    ties = [
        Tie(float(ratio[i] / ratio[chosen]), float(share[i]))
        for i in np.argsort(-share, kind="stable")
        if i != chosen and share[i] >= settings.vibration_tie
    ]
    # against the other fundamentals, and against no shaft at all
    others = float(share.sum()) + math.exp(-run.best)
    confidence = _confidence(evidence, run.log_odds, run.path, ratio, settings) / others
    return _found(tracked, np.interp(tracked.time_s, evidence.time_s, confidence), ties)


def _found(tracked: TrackedAngle, confidence: FloatArray, ties: list[Tie]) -> VibrationSpeed:
    """What is told of the tracked angle."""
    time_s, speed_rpm = tracked.time_s, 60.0 * tracked.speed_hz
    knots = AngleKnots(time_s, tracked.angle_rev, speed_rpm, tracked.angle_error_rev, 1.0 / FRAME_REVS, float("nan"))
    error_rpm = 60.0 * tracked.speed_error_hz
    return VibrationSpeed(time_s, speed_rpm, error_rpm, confidence, ties, _told(time_s, confidence, ties), knots)


def trusted_angle(found: VibrationSpeed) -> AngleKnots:
    """Crank angle that goes with the speed ``found``, from the first sample to the last; it has no phase reference.

    Raises InputError where the speed is a guess for more than half of the time.
    """
    guessed = float(np.mean(found.confidence < GUESSED))
    if guessed > 0.5:
        raise InputError(
            "the vibration does not tell the speed",
            place="encoder.kind",
            found=f"less than {GUESSED:.0%} sure for {guessed:.0%} of the time",
            remedy="Narrow the range of speeds, name the orders that the machine shows, or give a speed or an encoder",
        )
    return found.knots


def _possible_ratios(speed_hz: FloatArray, range_hz: tuple[float, float]) -> FloatArray:
    """1 and those of TIE_RATIOS that keep nearly all of the speeds in the range."""
    low, high = np.quantile(speed_hz, [0.05, 0.95])
    slack = 1.0 + SAME_SPEED
    return np.array(
        [1.0, *(r for r in TIE_RATIOS if r * low * slack >= range_hz[0] and r * high <= range_hz[1] * slack)]
    )


def _confidence(
    evidence: SpeedEvidence, log_odds: FloatArray, path: IntArray, ratio: FloatArray, settings: ShaftSettings
) -> FloatArray:
    """Probability (knots,) that the speed is one of those at ``ratio`` times that of ``path``."""
    jump, cost = _transition(evidence, settings)
    step = _step(evidence)
    offsets = np.round(np.log(ratio) / step).astype(np.int64)
    near = math.ceil(math.log1p(SAME_SPEED) / step)
    result: FloatArray = run_probability(
        log_odds * np.float32(evidence.frames_per_knot), path, offsets, jump, cost, near
    )
    return result


def _checked(signals: FloatArray) -> FloatArray:
    """``signals`` as float64 rows, those that are constant or lack samples left out."""
    signals = np.atleast_2d(np.asarray(signals, dtype=np.float64))
    signals = signals[np.isfinite(signals).all(axis=1)]
    if not signals.size:
        raise InputError("the vibration holds samples that are not finite, so it tells no speed")
    signals = signals[np.ptp(signals, axis=1) > 0.0]
    if not signals.size:
        raise InputError("the vibration is constant, so it tells no speed")
    return signals


def _range_hz(
    stated_rpm: tuple[float, float], n_samples: int, rate_hz: float, settings: ShaftSettings
) -> tuple[float, float]:
    """Speeds [Hz] of the stated range that the recording is long enough and sampled fast enough for."""
    low = max(stated_rpm[0] / 60.0, FEWEST_FRAMES * settings.vibration_revs * rate_hz / n_samples)
    high = min(stated_rpm[1] / 60.0, 0.4 * rate_hz / FEWEST_ORDERS)
    if not 0.0 < low < high:
        raise InputError(
            "the recording cannot tell any speed of the range",
            found=f"{n_samples / rate_hz:.3g} s at {rate_hz:g} Hz for {stated_rpm[0]:g} to {stated_rpm[1]:g} rpm",
            allowed=f"{FEWEST_FRAMES * settings.vibration_revs:g} revolutions, {FEWEST_ORDERS:g} orders in the band",
        )
    return low, high


def _step(evidence: SpeedEvidence) -> float:
    """Step of the grid of speeds in the logarithm."""
    return float(np.log(evidence.speed_hz[1] / evidence.speed_hz[0]))


def _transition(evidence: SpeedEvidence, settings: ShaftSettings) -> tuple[int, float]:
    """Most steps of the grid between knots, and the log-probability cost of one step squared."""
    spacing = float(evidence.time_s[1] - evidence.time_s[0]) if evidence.time_s.size > 1 else 1.0
    steps = settings.vibration_slew_per_s * spacing / _step(evidence)
    return max(1, math.ceil(steps)), 0.5 / max(0.5, (USUAL_SLEW * steps)) ** 2


@dataclass(frozen=True)
class _Run:
    """A run of speeds ``path``, its tracked angle, and how well fundamentals at ``ratio`` to it explain it."""

    log_odds: FloatArray
    path: IntArray
    tracked: TrackedAngle
    ratio: FloatArray
    family: FamilyEvidence

    @property
    def chosen(self) -> int:
        """Which ratio is the likeliest."""
        return int(np.argmax(self.family.log_odds))

    @property
    def best(self) -> float:
        """The log odds of that."""
        return float(self.family.log_odds[self.chosen])


def _likely_run(evidence: SpeedEvidence, settings: ShaftSettings) -> tuple[FloatArray, IntArray]:
    """Log odds that decide, of all lines or of moving ones only, and the likeliest run of speeds by them."""
    jump, cost = _transition(evidence, settings)
    worth = np.float32(evidence.frames_per_knot)
    knots = np.arange(evidence.time_s.size)
    found, score = [], []
    for log_odds in (evidence.every, evidence.moving):
        path = likeliest_run(log_odds * worth, jump, cost)
        found.append(path)
        score.append(float(np.mean(log_odds[knots, path] - np.median(log_odds, axis=1))))
    low, high = np.quantile(np.log(evidence.speed_hz[found[1]]), [0.05, 0.95])
    if high - low > SWEEP_SPREAD and score[1] > SWEEP_SHARE * score[0]:
        return evidence.moving, found[1]
    return evidence.every, found[0]


def _explained(
    signals: FloatArray,
    rate_hz: float,
    evidence: SpeedEvidence,
    log_odds: FloatArray,
    path: IntArray,
    *,
    range_hz: tuple[float, float],
    order: FloatArray,
    weight: FloatArray,
) -> _Run:
    """The run ``path`` followed by the phases of its orders, and what fundamental explains its lines."""
    speed_hz = evidence.speed_hz[path] * np.exp(_step(evidence) * _parabolic(log_odds, path))
    tracked = tracked_angle(signals, rate_hz, time_s=evidence.time_s, speed_hz=speed_hz, order=order)
    ratio = _possible_ratios(tracked.speed_hz, range_hz)
    family = family_evidence(signals, rate_hz, tracked, ratio=ratio, order=order, weight=weight)
    return _Run(log_odds, path, tracked, ratio, family)


def _mended_path(run: _Run, evidence: SpeedEvidence, settings: ShaftSettings) -> IntArray | None:
    """The likeliest run beside the fundamental that each stretch of ``run`` asks for; None where they ask for one."""
    log_odds = run.family.of_frames
    came = np.zeros(log_odds.shape, dtype=np.int64)
    total, stay = log_odds[0], np.arange(run.ratio.size)
    for i in range(1, len(log_odds)):
        switched = total.max() - SWITCH
        came[i] = np.where(total >= switched, stay, int(np.argmax(total)))
        total = np.maximum(total, switched) + log_odds[i]
    of_frame = np.full(len(log_odds), int(np.argmax(total)))
    for i in range(len(log_odds) - 1, 0, -1):
        of_frame[i - 1] = came[i, of_frame[i]]
    if np.ptp(of_frame) == 0:
        return None
    at_s = run.family.time_s
    wanted = np.log(np.interp(at_s, run.tracked.time_s, run.tracked.speed_hz) * run.ratio[of_frame])
    beside = np.log(evidence.speed_hz) - np.interp(evidence.time_s, at_s, wanted)[:, None]
    near = np.where(np.abs(beside) <= MENDED_REACH, run.log_odds, np.float32(-FAR_ODDS))
    return likeliest_run(near * np.float32(evidence.frames_per_knot), *_transition(evidence, settings))


def _parabolic(log_odds: FloatArray, path: IntArray) -> FloatArray:
    """Place of the maximum beside ``path``, in steps -0.5…0.5, of the parabola through three log odds."""
    knots = np.arange(path.size)
    at = np.clip(path, 1, log_odds.shape[1] - 2)
    low, mid, high = (log_odds[knots, at + s].astype(np.float64) for s in (-1, 0, 1))
    bend = low - 2.0 * mid + high
    offset = np.where(bend < 0.0, 0.5 * (low - high) / np.where(bend < 0.0, bend, -1.0), 0.0)
    result: FloatArray = np.where(at == path, np.clip(offset, -0.5, 0.5), 0.0)
    return result


def _told(time_s: FloatArray, confidence: FloatArray, ties: list[Tie]) -> list[Remark]:
    """Remarks on what is not certain."""
    remarks: list[Remark] = []
    if ties:
        named = ", ".join(f"{tie.ratio:.3g} x ({tie.relative_evidence:.2f})" for tie in ties)
        remarks.append(
            ("speed_tie", "suspect", f"the vibration fits other speeds nearly as well: {named} of the found")
        )
    doubtful = confidence < DOUBTFUL
    if np.mean(doubtful) > SELDOM:
        bad = np.mean(confidence < GUESSED) > 0.5
        detail = (
            f"the speed is less than {DOUBTFUL:.0%} sure for {np.mean(doubtful):.0%} of the time, "
            f"first at {time_s[np.argmax(doubtful)]:.3g} s"
        )
        remarks.append(("speed_doubtful", "bad" if bad else "suspect", detail))
    return remarks
