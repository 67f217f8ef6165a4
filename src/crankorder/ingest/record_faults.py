"""Faults of all channels of a recording: what is lost is left out, the rest is flagged with when and how much.

Beside what a signal shows by itself: spikes, clipping that a filter smoothed, and what only a look at the other
channels tells: dead, a copy, mains alone, a step of the level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crankorder.fft.windows import hann
from crankorder.ingest.rawfile import FloatArray, flag
from crankorder.ingest.signal_faults import (
    SignalFault,
    Survey,
    block_size,
    find_slow_faults,
    grouped,
    joined,
    lengths_of,
    root_mean_square,
    sized,
    spans_of,
    survey,
)
from crankorder.quantities import Floats, Ints, QualityFlag
from crankorder.scratch import blocks
from crankorder.settings import IngestSettings

_LOOK = 8192
"""Samples in which the lines of the others are looked for."""
_LINES = 6
_STANDS_OUT = 10.0
"""Power of a line over the median about it."""
_SERIES = 2048
_MULTIPLES = 4
_OFF_MAINS = 0.01
"""Mains and a half order of the shaft closer than this share are not told apart."""
_PIECES = 64
_EDGE = 6
"""Pieces before and behind a step at least."""
_AGREE = 0.2
"""Share of the step that either level may scatter by, and that the others may move."""

_PIECE, _STRONGEST = 2048, 8
"""Samples of a piece, and how many of the strongest pieces are looked at."""
_ABOVE = (0.0005, 0.002, 0.005, 0.01, 0.02, 0.04, 0.08)
"""Shares of the samples above the level that is tried: what a filter rings lies above the plateau."""
_NEAR, _FAR, _WITHIN = 0.03, 0.12, 0.07
"""Depths below the level over which the share is compared, and about the level within which a plateau lies."""
_FEWEST_IN_ROW = 3.0
"""Samples in a row that a plateau has on average: a lone tone at a simple share of the rate hits few levels too."""
_FEWEST = 64
_LEAST_LAG = 3
"""Samples over which a filter spreads a corner: between lags below nothing tells it from a smooth turn."""

_AHEAD, _OUT = 2, 12
"""Samples about the middle that a spike may take, and how far its neighbours reach: in so many a strike still rings."""
_MIDDLE = np.s_[_OUT - _AHEAD : _OUT + _AHEAD + 1]

_DEGREE = 3

_PEAKED = 9.0
"""Fourth power of the bends over their squared mean square from which a block is looked at: 3 is Gaussian noise."""

_BLOCK = 128
"""Samples of a block: in fewer a spike does not stand out, in more it is diluted."""

_OF_STEP = 20.0
"""A spike is so many rounding steps at least."""

_MOST_LOOKED_AT = 20_000

_PULSES = 5
"""So many of one height, or one distance apart, are the pulses of a pickup."""

VIBRATION = frozenset({"acceleration", "velocity", "displacement"})
"""Quantities without a level or plateaus of their own: what shows either is a fault."""

MAY_HAVE_LEVELS = frozenset(
    {"voltage", "current", "counts", "full scale", "ratio", "angle", "rotational speed", "strain", "torque"}
)
"""Quantities of which a signal may stand at a few levels."""


class _Channel(NamedTuple):
    """A channel of a recording: its ``samples`` (sample,) and what short blocks of them hold; ``faults`` take more.

    ``size`` is the root mean square, NaN where too much is missing.
    """

    name: str
    quantity: str
    unit: str
    samples: FloatArray
    survey: Survey
    size: float
    faults: list[SignalFault]

    @property
    def is_left(self) -> bool:
        """Whether anything of the channel is left."""
        return not any(fault.loses_all for fault in self.faults)

    @property
    def is_vibration(self) -> bool:
        """Whether the channel has neither a level nor plateaus of its own: what shows either is a fault."""
        return self.quantity in VIBRATION


def find_copies(channels: Sequence[_Channel]) -> None:
    """Flag each of ``channels`` that equals an earlier one."""
    n_samples = channels[0].samples.size
    few = slice(None, None, max(n_samples // 64, 1))
    parts = (few, *blocks(n_samples))
    for number, later in enumerate(channels):
        for earlier in channels[:number] if np.ptp(later.samples[few]) > 0.0 else ():
            if all(np.array_equal(earlier.samples[part], later.samples[part]) for part in parts):
                detail = f"the same samples as channel {earlier.name}: one of the two was not measured"
                later.faults.append(SignalFault("copied_channel", "suspect", detail))
                break


def find_dead(channels: Sequence[_Channel], *, settings: IngestSettings) -> None:
    """Flag those of ``channels`` that hold only noise while others of their unit see the machine.

    A channel is dead that lies far below the median of the others (``settings``) and shows none of the strongest lines
    of the loudest, whether it toggles between a few steps of the converter or not.
    """
    for own in channels:
        others = [each for each in channels if each.unit == own.unit and each is not own and each.size > 0.0]
        typical = float(np.median([each.size for each in others])) if others else 0.0
        if not 0.0 < own.size <= settings.dead_ratio * typical:
            continue
        if not _shows_lines(own.samples, max(others, key=lambda each: each.size).samples):
            steps = _steps(own.samples)
            rest = f"within {steps} steps of its converter" if steps <= settings.dead_steps else "noise alone"
            below = f"{typical / own.size:.3g} times below the others, none of whose lines it shows: "
            own.faults.append(SignalFault("dead_sensor", "bad", f"{rest}, {below}dead or not connected", is_lost=True))


def _steps(signal: FloatArray) -> int:
    """Rounding steps between the least and the greatest of some samples, so far as they can be counted."""
    piece = signal[signal.size // 2 :][:_LOOK].astype(np.float64)
    step = np.diff(np.unique(piece[np.isfinite(piece)]))
    return int(min(round(float(step.sum() / step.min())), 10**9)) if step.size else 0


def _shows_lines(quiet: FloatArray, loud: FloatArray) -> bool:
    """Whether one of the strongest lines of ``loud`` stands out in ``quiet``, or ``loud`` has none."""
    length = min(_LOOK, quiet.size)
    starts = np.unique(np.linspace(0, quiet.size - length, 4).astype(np.int64))
    window = hann(length).values
    powers = []
    for signal in (quiet, loud):
        pieces = np.stack([signal[start : start + length] for start in starts]).astype(np.float64)
        pieces = pieces[np.isfinite(pieces).all(axis=1)]
        if not len(pieces):
            return True
        pieces -= pieces.mean(axis=1, keepdims=True)
        powers.append(np.square(np.abs(np.fft.rfft(pieces * window, axis=1))).mean(axis=0)[3:])
    order = np.argsort(powers[1])[::-1][: 8 * _LINES]
    places = [int(k) for k in order if _over_floor(powers[1], int(k)) > _STANDS_OUT][:_LINES]
    return not places or max(_over_floor(powers[0], place) for place in places) > _STANDS_OUT / 2.0


def _over_floor(power: Floats, place: int) -> float:
    near = power[max(place - 40, 0) : place + 41]
    return float(power[max(place - 1, 0) : place + 2].max()) / max(float(np.median(near)), 1e-300)


def find_mains_only(channels: Sequence[_Channel], rate_hz: float, shaft_hz: float, *, settings: IngestSettings) -> None:
    """Flag those of ``channels`` that hold mains, its multiples and noise, while others hold other lines.

    They are sampled at ``rate_hz`` and judged by ``settings``. ``shaft_hz`` is the frequency of the shaft, 0 for none;
    nothing is flagged where it is NaN, unknown, or where an order of the shaft lies on mains.
    """
    if not math.isfinite(shaft_hz) or not math.isfinite(rate_hz):
        return
    series = np.stack([each.survey.means[: 8 * _SERIES] for each in channels])
    series = np.nan_to_num(series - np.nanmean(series, axis=1, keepdims=True))
    series_hz = rate_hz / channels[0].survey.size
    if len(series[0]) < _SERIES // 8 or len(series[0]) / series_hz < 1.0:
        return
    squares = np.square([each.size for each in channels])
    for mains_hz in (50.0, 60.0):
        if shaft_hz > 0.0 and abs((ratio := 2.0 * mains_hz / shaft_hz) - round(ratio)) < _OFF_MAINS * ratio:
            continue
        of_mains = _mains_power(series[:, :_SERIES], series_hz, mains_hz) / squares > settings.mains_share
        if not of_mains.any() or of_mains.all():
            continue
        beside = np.array([_lines_beside(row, series_hz, mains_hz) for row in series]) / squares
        detail = f"{mains_hz:g} Hz, its multiples and noise alone, while others show the machine: pick-up, no sensor"
        for number in np.flatnonzero(of_mains & (beside < 0.01) & (beside[~of_mains].max() > 0.2)):
            channels[int(number)].faults.append(SignalFault("mains_only", "suspect", detail))
        return


def _mains_power(series: Floats, series_hz: float, mains_hz: float) -> Floats:
    """Mean square (channel,) of mains and its multiples in ``series`` (channel, sample)."""
    window = hann(series.shape[1]).values
    turn = np.exp(-2j * np.pi * mains_hz / series_hz * np.arange(series.shape[1]))
    power, turns = np.zeros(len(series)), np.ones_like(turn)
    for _ in range(int(min(_MULTIPLES, 0.45 * series_hz / mains_hz))):
        turns = turns * turn
        power += 2.0 * np.square(np.abs((series * window) @ turns) / window.sum())
    return power


def _lines_beside(row: Floats, series_hz: float, mains_hz: float) -> float:
    """Mean square of the lines in ``row`` that lie on no multiple of mains."""
    window = hann(len(row)).values
    power = 2.0 * np.square(np.abs(np.fft.rfft(row * window))) / (len(row) * float(window @ window))
    frequency = np.arange(len(power)) * (series_hz / len(row))
    width = 4.0 * series_hz / len(row)
    off = np.abs(frequency - mains_hz * np.round(frequency / mains_hz)) > width + 2e-3 * frequency
    off &= frequency > width
    floor = float(np.median(power[off])) if off.any() else 0.0
    return float(power[off & (power > 5.0 * _STANDS_OUT * floor)].sum())


def find_level_steps(channels: Sequence[_Channel], *, settings: IngestSettings) -> None:
    """Flag those of ``channels`` whose level steps (``settings``) while that of the others does not."""
    surveys = [channel.survey for channel in channels]
    group = len(surveys[0].means) // _PIECES
    if group < 4:
        return
    squares = np.stack([grouped(own.variances + (own.means - np.nanmean(own.means)) ** 2, group) for own in surveys])
    if not (np.isfinite(squares).all() and (squares > 0.0).all()):
        return
    levels = 0.5 * np.log(squares)
    for number, level in enumerate(levels):
        rest = np.median(np.delete(levels, number, axis=0), axis=0)
        at, step = _largest_step(level)
        if abs(step) < np.log(settings.level_ratio):
            continue
        before, after = level[: at - 1], level[at + 1 :]
        scatter = max(before.std(), after.std())
        moved = abs(float(np.median(rest[at:]) - np.median(rest[:at])))
        abrupt = abs(float(level[at + 1] - level[at - 2]))
        if scatter > _AGREE * abs(step) or moved > _AGREE * abs(step) or abrupt < 0.7 * abs(step):
            continue
        span = spans_of((at * group * surveys[number].size, surveys[number].n_samples))
        change = f"the level changes by a factor of {np.exp(step):.3g} at once"
        detail = f"{change}, that of the others does not: gain or seat"
        channels[number].faults.append(SignalFault("level_step", "suspect", detail, span))


def _largest_step(level: np.ndarray) -> tuple[int, float]:
    """First piece behind the best split of ``level`` (piece,) in two, and the step there."""
    splits = np.arange(_EDGE, len(level) - _EDGE + 1)
    total = np.cumsum(level)
    before = total[splits - 1] / splits
    after = (total[-1] - total[splits - 1]) / (len(level) - splits)
    best = int(np.argmax(np.square(after - before) * splits * (len(level) - splits)))
    return int(splits[best]), float(after[best] - before[best])


def find_smoothed_clipping(channel: _Channel, *, settings: IngestSettings) -> None:
    """Flag clipping of a ``channel`` whose clipped samples differ a little, as after a filter.

    It is only "suspect" where one side alone is clipped. ``settings`` say what a plateau is. The flag is "bad" only
    where the channel measures vibration, and the rest of it is smaller on the plateaus than between them.
    """
    samples = _strongest(channel.samples, channel.survey)
    if samples.size < _PIECE:
        return
    places = (samples.size * (1.0 - np.array(_ABOVE))).astype(np.int64)
    ordered = np.partition(samples, np.concatenate([places, samples.size - 1 - places, [samples.size // 2]]))
    middle = float(ordered[samples.size // 2])
    apart, ordered = samples - middle, ordered - middle
    sides = [_pile_up(sign * apart, sign * ordered[at], settings) for sign, at in ((1, places), (-1, -1 - places))]
    plateaus = [(sign, *side) for sign, side in zip((1.0, -1.0), sides, strict=True) if side is not None]
    if not plateaus or (len(plateaus) < 2 and not channel.is_vibration):
        return
    levels = " and ".join(f"{middle + sign * level:.4g}" for sign, level, _, _ in plateaus)
    share = sum(share for _, _, share, _ in plateaus)
    quiet = all(roughness < settings.quiet_plateau for *_, roughness in plateaus)
    is_sure = channel.is_vibration and len(plateaus) == 2 and quiet
    seen = f"{share:.2%} of the strongest samples lie at {levels} as on a plateau that was smoothed later"
    detail = f"{seen}: cut off before the filter, so odd multiples of its lines may be made up"
    channel.faults.append(SignalFault("clipped", "bad" if is_sure else "suspect", detail, is_lost=is_sure))


def _strongest(signal: FloatArray, survey: Survey) -> FloatArray:
    """Samples of the pieces with the largest mean square."""
    power = grouped(survey.variances + np.square(survey.means - np.nanmean(survey.means)), _PIECE // survey.size)
    power = np.where(np.isfinite(power), power, -1.0)
    chosen = np.sort(np.argsort(power)[-_STRONGEST:])
    chosen = chosen[power[chosen] > 0.0]
    return np.concatenate([np.empty(0, signal.dtype), *(signal[k * _PIECE : (k + 1) * _PIECE] for k in chosen)])


def _pile_up(above: FloatArray, levels: FloatArray, settings: IngestSettings) -> tuple[float, float, float] | None:
    """Level, share of the samples, and roughness over that between the levels, of a plateau on the upper side.

    ``above`` the middle lie the samples (sample,), shares ``_ABOVE`` of them above each of the ``levels``.
    """
    if levels[-1] <= 0.0:
        return None
    exponents = _exponents(above, levels)
    level = float(levels[np.argmin(exponents)])
    if exponents.min() > settings.plateau_exponent:
        return None
    inside = np.abs(above / level - 1.0) < _WITHIN
    share = float(np.mean(inside))
    in_row = np.count_nonzero(inside) / (1 + np.count_nonzero(inside[1:] & ~inside[:-1]))
    if in_row < _FEWEST_IN_ROW or share < settings.max_clipped_fraction:
        return None
    if _turns_smoothly(above, np.flatnonzero(inside[1:] != inside[:-1]), max(int(in_row) // 8, _LEAST_LAG)):
        return None
    bend = np.square(above[1:-1] - 0.5 * (above[2:] + above[:-2]))
    flat = inside[2:] & inside[1:-1] & inside[:-2]
    between = np.abs(above[1:-1]) < 0.7 * level
    is_known = min(np.count_nonzero(flat), np.count_nonzero(between)) >= _FEWEST
    rough = float(bend[flat].mean()) / max(float(bend[between].mean()), 1e-300) if is_known else math.inf
    return level, share, math.sqrt(rough)


def _exponents(above: FloatArray, levels: FloatArray) -> Floats:
    """Powers (level,) of the depth below each of the ``levels`` with which the time within that depth grows.

    The time is that of straight lines between the samples ``above`` (sample,): at a simple share of the rate the
    samples of a tone take few values, and how many of these lie within a depth is chance. 1 where too few lie near.
    """
    high = np.maximum(above[1:], above[:-1])
    chosen = np.flatnonzero(high > (1.0 - _FAR) * levels[-1])
    high = high[chosen]
    span = np.maximum(high - np.minimum(above[chosen], above[chosen + 1]), 1e-9 * levels[0])
    depths = np.outer(levels, 1.0 - np.array([1e-6, _NEAR, _FAR]))
    times = np.clip((high - depths[:, :, None]) / span, 0.0, 1.0).sum(axis=2)
    near, far = (times[:, 1:] - times[:, :1]).T
    return np.where(near >= _FEWEST, np.log(far / np.maximum(near, 1.0)) / math.log(_FAR / _NEAR), 1.0)


def _turns_smoothly(above: FloatArray, edges: Ints, lag: int) -> bool:
    """Whether ``above`` (sample,) bends at the ``edges`` of its plateaus as a smooth signal does.

    A bend over twice the ``lag`` is then four times as large; at a corner, which a filter spreads over less, twice.
    """
    edges = edges[(edges >= 6 * lag) & (edges < above.size - 6 * lag)]
    if not edges.size:
        return False
    places = edges[:, None] + np.arange(-4 * lag, 4 * lag + 1)
    bends = [np.abs(2.0 * above[places] - above[places - k] - above[places + k]).max(axis=1) for k in (lag, 2 * lag)]
    return bool(float(np.median(bends[1])) > 2.0**1.5 * float(np.median(bends[0])))


def find_spikes(channel: _Channel, *, settings: IngestSettings) -> None:
    """Flag the spikes of a ``channel``, and bridge them in place.

    ``settings`` say what stands out. A polynomial through 20 neighbours predicts the middle sample; a spike deviates
    from it ``spike_ratio`` times as much as any neighbour does, and exceeds the root mean square of the signal. A
    strike or a knock rings through the neighbours. In signals other than vibration, spikes that all look alike are the
    signal itself.
    """
    signal, survey = channel.samples, channel.survey
    places = _candidates(signal, survey)
    if not places.size:
        return
    level = math.sqrt(float(np.nanmedian(survey.variances)) + float(np.nanvar(survey.means)))
    places, deviations, predicted = _standing_out(signal, places, level, settings)
    if not places.size or (not channel.is_vibration and _look_like_pulses(places, deviations)):
        return
    offsets = np.arange(-_AHEAD, _AHEAD + 1)
    hit = np.abs(deviations) > 0.25 * np.abs(deviations).max(axis=1, keepdims=True)
    samples, first = np.unique((places[:, None] + offsets)[hit], return_index=True)
    signal[samples] = predicted[hit][first]
    spikes = joined([np.column_stack([samples, samples + 1])], n_samples=signal.size)
    shown = f"{len(spikes)} spike{'s' * (len(spikes) > 1)} of one to three samples"
    detail = f"{shown}, up to {sized(float(np.abs(deviations).max()), level)}, after which nothing rings"
    channel.faults.append(SignalFault("spikes", "suspect", detail, spikes))


def _candidates(signal: FloatArray, survey: Survey) -> Ints:
    """Samples that bend most in blocks with few large bends among small ones, each the largest of its neighbours."""
    group = max(_BLOCK // survey.size, 1)
    squares, fourths = grouped(survey.bend_squares, group), grouped(survey.bend_fourths, group)
    with np.errstate(invalid="ignore", over="ignore"):
        chosen = np.flatnonzero(fourths > _PEAKED * np.square(squares))
    if not chosen.size or signal.size < 2 * _OUT + 1:
        return np.empty(0, dtype=np.int64)
    chosen = np.sort(chosen[np.argsort(squares[chosen])[-_MOST_LOOKED_AT // 4 :]])  # the sharpest
    within = chosen[:, None] * (group * survey.size) + np.arange(group * survey.size)
    within = np.clip(within, _OUT, signal.size - _OUT - 1)
    bend = np.abs(signal[within] - 0.5 * (signal[within - 1] + signal[within + 1]))
    places = np.unique(within[bend > 2.5 * np.sqrt(squares[chosen])[:, None]])
    return places if places.size <= _MOST_LOOKED_AT else places[:0]  # so many are the signal


@cache
def _prediction() -> tuple[Floats, Floats]:
    """Matrices from the neighbours (20) to what they predict for the middle (5), and to what they lie off the fit."""
    powers = np.vander(np.arange(-_OUT, _OUT + 1) / _OUT, _DEGREE + 1)
    beside = np.delete(powers, _MIDDLE, axis=0)
    inverse = np.linalg.pinv(beside)
    return powers[_MIDDLE] @ inverse, np.eye(len(beside)) - beside @ inverse


def _standing_out(
    signal: FloatArray, places: Ints, level: float, settings: IngestSettings
) -> tuple[Ints, Floats, Floats]:
    """Those of ``places`` at which there is a spike: its deviations (place, 5) and what the neighbours predict."""
    to_middle, to_rest = _prediction()
    window = signal[places[:, None] + np.arange(-_OUT, _OUT + 1)].astype(np.float64)
    base = window[:, :1]
    beside = np.delete(window - base, _MIDDLE, axis=1)
    predicted, rest = beside @ to_middle.T, np.abs(beside @ to_rest.T).max(axis=1)
    deviations = (window - base)[:, _MIDDLE] - predicted
    steps = np.abs(np.diff(window, axis=1))
    rounding = np.where(steps > 0.0, steps, np.inf).min(axis=1)
    height = np.abs(deviations).max(axis=1)
    with np.errstate(invalid="ignore"):
        stands_out = (height > settings.spike_ratio * rest) & (height > settings.spike_level * level)
        # a step of the rounding is no spike, but a lone spike among equal samples has no other step than its own
        stands_out &= (height > _OF_STEP * rounding) | (np.count_nonzero(steps > 0.0, axis=1) <= 4) & (rest == 0.0)
    if np.count_nonzero(stands_out) > 1:  # the same spike seen from two of its samples counts once
        stands_out[1:] &= ~(stands_out[:-1] & (np.diff(places) <= _AHEAD))
    return places[stands_out], deviations[stands_out], (predicted + base)[stands_out]


def _look_like_pulses(places: Ints, deviations: Floats) -> bool:
    if places.size < _PULSES:
        return False
    heights = np.take_along_axis(deviations, np.abs(deviations).argmax(axis=1)[:, None], axis=1)
    apart = np.diff(places)
    return bool(np.std(heights) < 0.2 * abs(float(np.mean(heights))) or np.std(apart) < 0.3 * float(np.mean(apart)))


class Sampled(NamedTuple):
    """What the samples of a recording are: names, quantities and units by channel, their axis, and the shaft's speed.

    There are ``rate`` samples per ``unit`` ("s" or "rev"), the first at ``start``; ``rate_hz`` is NaN by crank angle;
    ``shaft_hz`` is 0 where there is no shaft, NaN where its speed is unknown.
    """

    names: Sequence[str]
    quantities: Sequence[str]
    units: Sequence[str]
    rate: float
    start: float
    unit: str
    rate_hz: float
    shaft_hz: float


def judged(
    signals: FloatArray, known: Sequence[list[SignalFault]], sampled: Sampled, path: Path, *, settings: IngestSettings
) -> list[QualityFlag]:
    """Quality flags of the ``signals``; in place, lost samples become NaN and spikes are bridged.

    A channel of which too much is lost is left out alone; where that is so of all channels they stay as they are, for
    the recording is left out as a whole.

    Parameters
    ----------
    signals : (channels, samples), float32 or float64, changed in place
    known : faults found before, by channel
    sampled : how the recording was sampled
    path : file of the recording, named in the flags
    settings : what counts as a fault
    """
    n_samples = signals.shape[1]
    faults = [list(own) for own in known]
    for number, quantity in enumerate(sampled.quantities):
        if quantity in MAY_HAVE_LEVELS:  # what looks clipped for half of the time is one of two levels
            faults[number] = [
                replace(fault, severity="suspect", is_lost=False) if fault.flag == "few_levels" else fault
                for fault in known[number]
                if fault.flag != "clipped" or int(lengths_of(fault.at).sum()) <= 0.5 * n_samples
            ]
    if n_samples >= settings.fewest_samples:
        _judge(signals, faults, sampled, settings)
    whole = spans_of((0, n_samples))
    # samples that take no part in averages, with a margin about each stretch
    margin = max(round(settings.lost_margin_s * sampled.rate_hz), 1) if math.isfinite(sampled.rate_hz) else 1
    spans = ([whole if fault.loses_all else fault.at for fault in own if fault.is_lost] for own in faults)
    lost = [joined(each, within=margin, n_samples=n_samples) for each in spans]
    is_out = [_is_out(runs, n_samples, settings) for runs in lost]
    about = f"with {settings.lost_margin_s:g} s about each" if math.isfinite(sampled.rate_hz) else "in all"
    flags, allowed = list[QualityFlag](), 100.0 * settings.max_lost_fraction
    for number, (name, own) in enumerate(zip(sampled.names, faults, strict=True)):
        if not all(is_out):
            for start, end in whole if is_out[number] else lost[number]:
                signals[number, start:end] = np.nan
        percent = 100.0 * int(lengths_of(lost[number]).sum()) / n_samples
        share = f": {about}, {percent:.2g} % of the channel is lost; allowed: {allowed:g} % between its ends"
        for fault in own:
            ends = (fault.at.min(), fault.at.max()) if len(fault.at) else (0, n_samples)
            begin, end = (sampled.start + int(place) / sampled.rate for place in ends)
            detail = f"channel {name}: {fault.detail} ({begin:.4g} … {end:.4g} {sampled.unit})"
            detail += share if is_out[number] and fault.is_lost and len(fault.at) else ""
            remark = flag(path, fault.flag, fault.severity, detail)
            remark["channel"], remark["begin"], remark["end"] = name, begin, end
            if fault.is_lost and not all(is_out):
                remark["left_out"] = "channel" if is_out[number] else "stretch"
            flags.append(remark)
    return flags


def _judge(
    signals: FloatArray, faults: Sequence[list[SignalFault]], sampled: Sampled, settings: IngestSettings
) -> None:
    """Add to the ``faults`` of each channel what it shows by itself and beside the others; spikes are bridged."""
    surveys = [survey(row, size=block_size(sampled.rate_hz)) for row in signals]
    sizes = map(root_mean_square, surveys)
    told = (sampled.names, sampled.quantities, sampled.units, signals, surveys, sizes, faults)
    channels = list(map(_Channel, *told))
    for channel in (channel for channel in channels if channel.is_left):
        if channel.quantity != "force" and not any(fault.flag == "clipped" for fault in channel.faults):
            find_spikes(channel, settings=settings)
        if channel.is_vibration:
            channel.faults.extend(find_slow_faults(channel.survey, settings=settings))
        told_already = any(fault.flag in ("clipped", "iepe_overload") for fault in channel.faults)
        if not told_already and (channel.is_vibration or channel.quantity == "pressure"):
            find_smoothed_clipping(channel, settings=settings)
    vibrating = [channel for channel in channels if channel.is_vibration and channel.is_left]
    find_copies(channels)
    if len(vibrating) > 1:
        find_dead(vibrating, settings=settings)
        find_level_steps(vibrating, settings=settings)
        find_mains_only(vibrating, sampled.rate_hz, sampled.shaft_hz, settings=settings)


def _is_out(lost: Ints, n_samples: int, settings: IngestSettings) -> bool:
    """Whether so much of ``n_samples`` is ``lost`` that nothing of the channel is kept.

    A stretch at the start or the end makes a recording shorter; what comes and goes inside it leaves the rest in doubt.
    """
    at_end = (lost[:, 0] == 0) | (lost[:, 1] == n_samples)
    kept = n_samples - int(lengths_of(lost[at_end]).sum())
    inside = int(lengths_of(lost[~at_end]).sum())
    return kept < (1.0 - settings.max_lost_at_ends_fraction) * n_samples or inside > settings.max_lost_fraction * kept
