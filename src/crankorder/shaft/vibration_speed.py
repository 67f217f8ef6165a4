"""Speed from the vibration itself: the run of speeds whose orders the spectra show best, and how sure it is.

Per knot every speed has log odds (``tooth_odds``). Speed changes no faster than a slew limit, so the most likely
run of speeds is found by dynamic programming. Which simple ratio of it explains the lines best is decided along its
angle, by order spectra with frames of the same length, where frames of the search for the speed are longer for lower
speeds and so show more lines of them. Other ratios that do nearly as well are told as ties.

The odds saturate, so the run is right to some parts in a thousand, and may err by that all the time. Along its angle
each order turns slowly: its phase from frame to frame, over its order, is what the angle lacks. There is no phase
reference.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from crankorder.errors import InputError
from crankorder.quantities import Floats, Ints
from crankorder.settings import ShaftSettings
from crankorder.shaft.angle import AngleKnots, time_at
from crankorder.shaft.pulses import Remark
from crankorder.shaft.tooth_harmonics import SpeedEvidence, family_evidence, order_spectra, tooth_odds
from crankorder.shaft.wheel import wrapped


def likeliest_run(log_odds: Floats, jump: int, cost: float) -> Ints:
    """States (knots,) of the likeliest run through a grid (Viterbi 1967).

    ``log_odds`` (knots, states) are natural logarithms, ``jump`` is the most states between two knots; a step of n
    states costs n² times ``cost``.
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


def run_probability(log_odds: Floats, path: Ints, offsets: Ints, jump: int, cost: float, near: int) -> Floats:
    """Probability (knots,) that the state is that of a run, or beside it by an offset (Baum et al. 1970).

    ``log_odds``, ``jump`` and ``cost`` are those of :func:`likeliest_run`, ``path`` (knots,) is the run. ``offsets``
    (offsets,) are distances, in states, from it to others that count as the same, as do states up to ``near`` from each
    of them.
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


# Frames of so many revolutions, and knots so many to a frame.
FRAME_REVS, KNOTS_PER_FRAME = 8.0, 4
# The lines of the run are blurred, those of the first correction hardly.
PASSES = 2
# A structure may turn the phase of an order by so much from knot to knot, rad: no order is trusted to less.
STRUCTURE_RAD = 0.1
# The speed of the run errs by this share.
COARSE_ERROR = 0.02
# Power over noise is a mean of so many frames on either side, noise a median of so many frames; a line of so much is
# faint.
SNR_REACH, NOISE_FRAMES, FAINT = 3, 15, 4.0
# Noise is measured so far beside an order, where no half order lies.
BESIDE_ORDER = 0.25

ORDER_WEIGHTS = {1.0: 0.75, 2.0: 0.7, 3.0: 0.45, 4.0: 0.5, 5.0: 0.3, 6.0: 0.35, 7.0: 0.25, 8.0: 0.3}
"""Orders that any rotating machine may show, and the probability that it does."""

FOUR_STROKE_WEIGHTS = {
    0.5: 0.4, 1.0: 0.6, 1.5: 0.4, 2.0: 0.8, 2.5: 0.35, 3.0: 0.5, 3.5: 0.3, 4.0: 0.6, 4.5: 0.25,
    5.0: 0.3, 5.5: 0.2, 6.0: 0.4, 7.0: 0.2, 8.0: 0.3,
}  # fmt: skip
"""Orders that a four-stroke engine may show, half orders among them."""

TIE_RATIOS = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2.0, 3.0, 4.0)
"""Ratios of speeds whose orders coincide in part."""

# A recording holds so many frames of the lowest speed that is sought, and revolutions; its band so many orders of the
# highest.
FEWEST_FRAMES, FEWEST_REVS, FEWEST_ORDERS = 2.0, 1.5 * FRAME_REVS, 2.0
# Speeds within this share of the found one are the same speed.
SAME_SPEED = 0.02
# Log odds that another fundamental must gain in a row of frames before a run is taken to have slipped to it; how far
# beside it (in the logarithm) the run is sought again, and the log odds of what is farther.
SWITCH, MENDED_REACH, FAR_ODDS = 8.0, 0.15, 50.0
# Sudden changes of slew: the usual slew is this share of the limit.
USUAL_SLEW = 0.3
# Confidence below which a stretch is told, and below which it is a guess: a recording of which most is one is refused.
DOUBTFUL, GUESSED = 0.5, 0.2
SELDOM = 0.01
"""Share of the time up to which a doubtful speed, as at the very ends, is not worth a word."""


class Tie(NamedTuple):
    """Another fundamental, ``ratio`` times the found one, and its odds as a share of the found one's (0…1)."""

    ratio: float
    relative_evidence: float


class VibrationSpeed(NamedTuple):
    """Crank angle and speed on ``knots``, as the vibration tells them.

    ``confidence`` (knots,), 0 to 1, is the probability, by the model of lines and noise, that the true speed is within
    2 % of the one found; ``ties`` are other fundamentals that explain the lines nearly as well, best first.
    """

    knots: AngleKnots
    confidence: Floats
    ties: list[Tie]
    remarks: list[Remark]


def speed_from_vibration(
    signals: Floats,
    rate_hz: float,
    *,
    settings: ShaftSettings,
    expected_rpm: tuple[float, float] | None = None,
    order_weights: Mapping[float, float] | None = None,
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
    range_hz = _range_hz(expected_rpm or settings.vibration_range_rpm, signals.shape[1], rate_hz, settings)
    evidence = tooth_odds(signals, rate_hz, range_hz=range_hz, order=order, weight=weight, settings=settings)

    def explained(path: Ints) -> _Run:
        """The run of speeds ``path``, and what fundamental explains its lines."""
        start = _angle_of(evidence.time_s, evidence.speed_hz[path], signals.shape[1] / rate_hz)
        knots = phase_corrected(signals, rate_hz, start, order)
        ratio = _possible_ratios(knots.speed_rpm / 60.0, range_hz)
        family = family_evidence(signals, rate_hz, knots, ratio=ratio, order=order, weight=weight)
        return _Run(path, knots, ratio, *family)

    odds, transition = evidence.log_odds * np.float32(evidence.frames_per_knot), _transition(evidence, settings)
    run = explained(likeliest_run(odds, *transition))
    beside = _away_from_wanted(run, evidence)
    if beside is not None:
        near = np.where(beside <= MENDED_REACH, odds, np.float32(-FAR_ODDS * evidence.frames_per_knot))
        run = explained(likeliest_run(near, *transition))
    ratio, chosen = run.ratio, int(np.argmax(run.ratio_odds))
    best = float(run.ratio_odds[chosen])
    share = np.exp(run.ratio_odds - best)
    rivals = (i for i in np.argsort(-share, kind="stable") if i != chosen and share[i] >= settings.vibration_tie)
    ties = [Tie(float(ratio[i] / ratio[chosen]), float(share[i])) for i in rivals]
    # against the other fundamentals, and against no shaft at all
    others = float(share.sum()) + math.exp(-best)
    offsets = np.round(np.log(ratio) / evidence.step).astype(np.int64)
    near_states = math.ceil(math.log1p(SAME_SPEED) / evidence.step)
    confidence = run_probability(odds, run.path, offsets, *transition, near_states) / others
    knots, times = run.knots, float(ratio[chosen])
    if times != 1.0:
        scaled = knots._replace(angle_rev=times * knots.angle_rev, speed_rpm=times * knots.speed_rpm)
        knots = phase_corrected(signals, rate_hz, scaled, order)
    confidence = np.interp(knots.time_s, evidence.time_s, confidence)
    remarks = _doubts(knots.time_s, confidence, ties)
    return VibrationSpeed(knots, confidence, ties, remarks)


def trusted_angle(speed: VibrationSpeed) -> AngleKnots:
    """Crank angle that goes with ``speed``, from the first sample to the last; it has no phase reference.

    Raises InputError where the speed is a guess for more than half of the time.
    """
    guessed = float(np.mean(speed.confidence < GUESSED))
    if guessed > 0.5:
        problem = "the vibration does not tell the speed"
        found = f"less than {GUESSED:.0%} sure for {guessed:.0%} of the time"
        remedy = "Narrow the range of speeds, name the orders that the machine shows, or give a speed or an encoder"
        raise InputError(problem, place="encoder.kind", found=found, remedy=remedy)
    return speed.knots


def _possible_ratios(speed_hz: Floats, range_hz: tuple[float, float]) -> Floats:
    """1 and those of TIE_RATIOS that keep nearly all of the speeds in the range."""
    low, high = np.quantile(speed_hz, [0.05, 0.95])
    slack = 1.0 + SAME_SPEED
    inside = (r for r in TIE_RATIOS if r * low * slack >= range_hz[0] and r * high <= range_hz[1] * slack)
    return np.array([1.0, *inside])


def _checked(signals: Floats) -> Floats:
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
    revs = max(FEWEST_FRAMES * settings.vibration_revs, FEWEST_REVS)
    low = max(stated_rpm[0] / 60.0, revs * rate_hz / n_samples)
    high = min(stated_rpm[1] / 60.0, 0.4 * rate_hz / FEWEST_ORDERS)
    if not 0.0 < low < high:
        found = f"{n_samples / rate_hz:.3g} s at {rate_hz:g} Hz for {stated_rpm[0]:g} to {stated_rpm[1]:g} rpm"
        allowed = f"{revs:g} revolutions, {FEWEST_ORDERS:g} orders in the band"
        raise InputError("the recording cannot tell any speed of the range", found=found, allowed=allowed)
    return low, high


def _transition(evidence: SpeedEvidence, settings: ShaftSettings) -> tuple[int, float]:
    """Most steps of the grid between knots, and the log-probability cost of one step squared."""
    spacing = float(evidence.time_s[1] - evidence.time_s[0]) if evidence.time_s.size > 1 else 1.0
    steps = settings.vibration_slew_per_s * spacing / evidence.step
    return max(1, math.ceil(steps)), 0.5 / max(0.5, (USUAL_SLEW * steps)) ** 2


class _Run(NamedTuple):
    """A run of speeds ``path``, its angle, and how well fundamentals at ``ratio`` to it explain it.

    ``ratio_odds`` (ratios,): their log odds; ``frame_odds`` (frames, ratios): those of single frames at ``frame_s``.
    """

    path: Ints
    knots: AngleKnots
    ratio: Floats
    ratio_odds: Floats
    frame_s: Floats
    frame_odds: Floats


def _away_from_wanted(run: _Run, evidence: SpeedEvidence) -> Floats | None:
    """Distance (knots, speeds), in the logarithm, of speeds from the fundamental that each stretch of ``run`` asks for.

    None where all stretches ask for one.
    """
    log_odds = run.frame_odds
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
    wanted = np.log(np.interp(run.frame_s, run.knots.time_s, run.knots.speed_rpm) / 60.0 * run.ratio[of_frame])
    return np.asarray(np.abs(np.log(evidence.speed_hz) - np.interp(evidence.time_s, run.frame_s, wanted)[:, None]))


def _angle_of(time_s: Floats, speed_hz: Floats, end_s: float) -> AngleKnots:
    """The angle from 0 to ``end_s`` of a speed that is linear between knots and constant beyond them, smoothed.

    A run on a grid of speeds jumps from knot to knot, faster than frames of the phases follow.
    """
    time_s = np.concatenate(([0.0], time_s, [end_s]))
    speed = np.concatenate((speed_hz[:1], speed_hz, speed_hz[-1:]))
    angle = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time_s))))
    even = np.linspace(0.0, angle[-1], math.ceil(angle[-1] * KNOTS_PER_FRAME / FRAME_REVS) + 1)
    passed_s = np.interp(even, angle, time_s)
    passed_s[1:-1] = np.convolve(passed_s, [0.25, 0.5, 0.25], "valid")
    speed_rpm = 60.0 * np.gradient(even, passed_s)
    return AngleKnots(passed_s, even, speed_rpm, np.full(even.size, np.nan), 1.0 / FRAME_REVS, float("nan"))


def phase_corrected(signals: Floats, rate_hz: float, run: AngleKnots, order: Floats) -> AngleKnots:
    """Angle that keeps the phases of the orders constant.

    Its standard error is that between a knot and the middle of all knots: from noise, from differences between the
    orders, and from motion that a frame averages out.

    Parameters
    ----------
    signals : (channels, samples)
    rate_hz : samples per second
    run : angle, from 0 on, whose speed is right within a per cent
    order : (orders,), orders that may show
    """
    for _ in range(PASSES):
        run = _corrected(signals, rate_hz, run, order)
    return run


def _corrected(signals: Floats, rate_hz: float, run: AngleKnots, order: Floats) -> AngleKnots:
    """One pass of :func:`phase_corrected`."""
    from scipy.ndimage import uniform_filter1d

    total = float(run.angle_rev[-1])
    count = max(3, int((total - FRAME_REVS) * KNOTS_PER_FRAME / FRAME_REVS) + 1)
    centre = np.linspace(0.5 * FRAME_REVS, total - 0.5 * FRAME_REVS, count)
    turn, weight, snr = _turns(signals, rate_hz, run, centre, order)
    gain, hop = 2.0 * np.pi * order, float(centre[1] - centre[0])
    change, vote = _outvoted(turn, weight, gain, hop)
    # what each order alone would add to the angle, about the middle
    moved = np.cumsum(wrapped(turn - change[:, None] * gain, 2.0 * np.pi) / gain, axis=0)
    own = np.vstack((np.zeros(order.size), moved))
    own -= own[centre.size // 2]
    trust = np.vstack((vote[:1], vote)) * gain**2
    share = trust / np.maximum(trust.sum(axis=1, keepdims=True), 1e-300)
    voters = 1.0 / np.maximum(np.sum(share**2, axis=1), 1e-9)
    spread = np.sum(share * own**2, axis=1) / np.maximum(voters - 1.0, 0.5)
    noise = 0.5 / np.maximum(np.sum(snr * gain**2, axis=1), 1e-9)
    # the frames are Hann weighted means of the angle: they lack what it bends by within them
    bend = np.diff(change, prepend=change[:1], append=change[-1:]) / 4.0
    averaged = uniform_filter1d(bend**2, 2 * SNR_REACH + 1, mode="nearest")
    error = np.sqrt(spread + noise + noise[noise.size // 2] + averaged)
    # beyond the frames the run errs as where they end, give or take what it usually does
    ends = KNOTS_PER_FRAME // 2
    before, after = np.linspace(0.0, centre[0], ends + 1)[:-1], np.linspace(centre[-1], total, ends + 1)[1:]
    angle = np.concatenate((before, centre, after))
    rate = np.pad(change / hop, ends, "edge")
    true = angle + np.concatenate(([0.0], np.cumsum(rate * np.diff(angle))))
    usual, beyond = float(np.std(change / hop)), np.abs(angle - np.clip(angle, centre[0], centre[-1]))
    time_s = time_at(angle, run.time_s, run.angle_rev, run.speed_rpm)
    time_s[[0, -1]] = run.time_s[[0, -1]]
    speed_rpm = 60.0 * np.gradient(true, time_s)
    error = np.hypot(np.pad(error, ends, "edge"), usual * beyond)
    return AngleKnots(time_s, true, speed_rpm, error, 1.0 / FRAME_REVS, float("nan"))


def _turns(
    signals: Floats, rate_hz: float, run: AngleKnots, centre: Floats, order: Floats
) -> tuple[Floats, Floats, Floats]:
    """Turn [rad] of the orders between frames (steps, orders), their weight, and power over noise (frames, orders)."""
    from scipy.ndimage import median_filter, uniform_filter1d

    at, beside = np.round(2.0 * FRAME_REVS * order).astype(np.int64), round(2.0 * FRAME_REVS * BESIDE_ORDER)
    bins = np.concatenate((at, at - beside, at + beside))
    spectra, inside = order_spectra(signals, rate_hz, run, centre, revs=FRAME_REVS, bins=bins)
    lines, below, above = np.split(spectra, 3, axis=-1)
    lines = lines * np.exp(-2j * np.pi * (order * (centre[:, None] - 0.5 * FRAME_REVS) % 1.0))
    noise = 0.5 * (np.abs(below) ** 2 + np.abs(above) ** 2)
    # the mean of two exponential powers has its median at 0.84 of its mean
    noise = median_filter(noise, size=(1, NOISE_FRAMES, 1), mode="nearest") / 0.84
    noise = np.maximum(noise, 1e-12 * np.max(np.abs(lines) ** 2, axis=(1, 2), keepdims=True) + 1e-300)
    power = np.where(inside[:, : order.size], np.sum(np.abs(lines) ** 2 / noise - 1.0, axis=0), 0.0)
    snr = np.maximum(uniform_filter1d(power, 2 * SNR_REACH + 1, axis=0, mode="nearest"), 0.0)
    lines /= np.sqrt(noise)
    pair = np.maximum(np.minimum(snr[1:], snr[:-1]), 1e-9)
    # an order near its noise tells next to nothing, however high it is
    weight = (pair / (pair + FAINT)) ** 4 / (STRUCTURE_RAD**2 + 1.0 / pair)
    return np.angle(np.sum(lines[:, 1:] * np.conj(lines[:, :-1]), axis=0)), weight, snr


def _outvoted(turn: Floats, weight: Floats, gain: Floats, hop: float) -> tuple[Floats, Floats]:
    """Change of angle [rev] per step (steps,) that most orders agree on, and the vote of each order (steps, orders).

    ``turn``, ``weight``: (steps, orders); ``gain``: (orders,), turn per change, rad/rev. A resonance turns an order
    too: what is far from the others counts less (Cauchy weights).
    """
    prior = (COARSE_ERROR * hop) ** -2.0
    vote, change = weight, np.zeros(len(turn))
    for _ in range(4):
        rest = wrapped(turn - change[:, None] * gain, 2.0 * np.pi)
        vote = weight / (1.0 + rest**2 * weight / 4.0)
        lack = np.sum(vote * gain * rest, axis=1) - prior * change
        change = change + lack / (np.sum(vote * gain**2, axis=1) + prior)
    return np.clip(change, -0.2 * hop, 0.2 * hop), vote


def _doubts(time_s: Floats, confidence: Floats, ties: list[Tie]) -> list[Remark]:
    """Remarks on what is not certain: ratios that fit nearly as well, and how long the speed is doubtful."""
    remarks: list[Remark] = []
    if ties:
        named = ", ".join(f"{tie.ratio:.3g} x ({tie.relative_evidence:.2f})" for tie in ties)
        detail = f"the vibration fits other speeds nearly as well: {named} of the found"
        remarks.append(("speed_tie", "suspect", detail))
    doubtful = confidence < DOUBTFUL
    if np.mean(doubtful) > SELDOM:
        bad = np.mean(confidence < GUESSED) > 0.5
        detail = (
            f"the speed is less than {DOUBTFUL:.0%} sure for {np.mean(doubtful):.0%} of the time, "
            f"first at {time_s[np.argmax(doubtful)]:.3g} s"
        )
        remarks.append(("speed_doubtful", "bad" if bad else "suspect", detail))
    return remarks
