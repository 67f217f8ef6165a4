"""Faults that channels show beside the others of a recording: dead, a copy, mains alone, steps, slow drift."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numba as nb
import numpy as np

from crankorder.fft.windows import hann
from crankorder.ingest.rawfile import FloatArray
from crankorder.quantities import Bools, Floats, Ints, Severity
from crankorder.scratch import blocks
from crankorder.settings import IngestSettings

_BLOCKS_PER_S = 300.0

_LEAST_BLOCK, _MOST_BLOCK = 4, 128

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

_GROUPS = 512
"""Pieces of a signal whose means are followed, at most …"""

_FEWEST = 48
"""… and at least: fewer show no decay."""

_DECAYS = 24
"""Time constants that are tried, evenly by ratio."""

_RISE = 3
"""Pieces within which an overload jumps to its peak."""

_LEFT = 0.1
"""What is left of a decay, over the vibration, from where on it takes no part."""

_MOST_EVENTS = 5

_NORMAL = 1.4826
"""Standard deviation of normal values over the median of their size."""


@dataclass(frozen=True, slots=True)
class Runs:
    """Samples ``starts`` (runs,) to before ``ends`` (runs,), in order."""

    starts: Ints
    ends: Ints

    @property
    def lengths(self) -> Ints:
        """Samples of each run."""
        return self.ends - self.starts

    def where(self, chosen: Bools) -> Runs:
        """The ``chosen`` (runs,) alone."""
        return Runs(self.starts[chosen], self.ends[chosen])

    def merged(self, *, within: int, n_samples: int) -> Runs:
        """Runs that reach ``within`` samples further to both sides, those joined that then touch, of ``n_samples``."""
        starts, ends = np.maximum(self.starts - within, 0), np.minimum(self.ends + within, n_samples)
        order = np.argsort(starts, kind="stable")
        starts, ends = starts[order], np.maximum.accumulate(ends[order]) if len(ends) else ends
        first = np.ones(len(starts), dtype=np.bool_)
        first[1:] = starts[1:] > ends[:-1]
        last = np.append(first[1:], True)[: len(starts)]
        return Runs(starts[first], ends[last])


def joined(parts: Sequence[Runs]) -> Runs:
    """The runs of all ``parts``, one part behind the other."""
    starts, ends = ([getattr(runs, name) for runs in parts] for name in ("starts", "ends"))
    none = np.empty(0, dtype=np.int64)
    return Runs(np.concatenate([none, *starts]), np.concatenate([none, *ends]))


def runs_of(*spans: tuple[int, int]) -> Runs:
    """Runs of ``spans``, the first sample of each and the one after its last."""
    pairs = np.array(spans, dtype=np.int64).reshape(-1, 2)
    return Runs(pairs[:, 0], pairs[:, 1])


@dataclass(frozen=True, slots=True)
class SignalFault:
    """``flag``, ``severity`` and ``detail`` as a quality flag has them; ``at`` the samples concerned, none: all.

    ``is_lost``: these samples say nothing of the machine and take no part in any average.
    """

    flag: str
    severity: Severity
    detail: str
    at: Runs = field(default_factory=runs_of)
    is_lost: bool = False


@dataclass(frozen=True, slots=True)
class Survey:
    """What short blocks of a signal hold: arrays (block,), NaN where a sample is missing.

    ``size`` samples lie in each block; what is left over at the end takes no part. ``variances`` are about the mean of
    the block. A bend is how far a sample lies from the mean of its two neighbours: its mean square and fourth power.
    """

    size: int
    n_samples: int
    means: Floats
    variances: Floats
    bend_squares: Floats
    bend_fourths: Floats


def block_size(rate_hz: float) -> int:
    """Samples per block: a power of two, so few at ``rate_hz`` that the means show twice mains."""
    if not (math.isfinite(rate_hz) and rate_hz > 0.0):
        return 16
    wanted = 1 << math.floor(math.log2(max(rate_hz / _BLOCKS_PER_S, 1.0)))
    return min(max(wanted, _LEAST_BLOCK), _MOST_BLOCK)


def survey(signal: FloatArray, *, size: int) -> Survey:
    """Survey of ``signal`` (sample,) in blocks of ``size`` samples, each read once."""
    told = np.empty((4, signal.size // size))
    _look(signal, size, told)
    return Survey(size, signal.size, *told)


def grouped(values: Floats, group: int) -> Floats:
    """Means of ``group`` neighbours of ``values`` at a time; what is left over at the end takes no part."""
    whole = len(values) // group * group
    means: Floats = values[:whole].reshape(-1, group).mean(axis=1)
    return means


@nb.njit(cache=True, nogil=True, fastmath={"nsz", "reassoc", "contract"})
def _look(signal, size, told):  # type: ignore[no-untyped-def]
    half, n = signal.dtype.type(0.5), signal.shape[0]
    for number in range(told.shape[1]):
        start = number * size
        piece, first, total, square = signal[start : start + size], signal[start], signal[start] * 0, signal[start] * 0
        for k in range(size):
            apart = piece[k] - first
            total += apart
            square += apart * apart
        mean = np.float64(total) / size
        told[0, number] = np.float64(signal[start]) + mean
        variance = np.float64(square) / size - mean * mean
        told[1, number] = variance if not variance < 0.0 else 0.0
        scale = 1.0 / np.sqrt(variance) if variance > 0.0 else 1.0
        # in units in which no fourth power overflows
        piece, least = signal[max(start - 1, 0) : min(start + size + 1, n)], signal.dtype.type(scale)
        square = fourth = first * 0
        for k in range(1, piece.shape[0] - 1):
            bend = (piece[k] - half * (piece[k - 1] + piece[k + 1])) * least
            square += bend * bend
            fourth += (bend * bend) * (bend * bend)
        told[2, number] = np.float64(square) / size / scale**2
        told[3, number] = np.float64(fourth) / size / scale**4


def root_mean_square(survey: Survey) -> float:
    """Root mean square of the signal of ``survey``, NaN where too much is missing."""
    square = float(survey.means.var()) + float(survey.variances.mean())
    if math.isfinite(square):
        return math.sqrt(square)
    known = np.isfinite(survey.means)
    if not known.any():
        return math.nan
    return math.sqrt(float(survey.means[known].var()) + float(survey.variances[known].mean()))


def find_copies(signals: FloatArray, names: Sequence[str]) -> dict[int, SignalFault]:
    """Faults by number of those of ``signals`` (channel, sample) that equal an earlier one; ``names`` are theirs."""
    found: dict[int, SignalFault] = {}
    step = max(signals.shape[1] // 64, 1)
    few = signals[:, ::step]
    for later in range(1, len(signals)):
        for earlier in range(later):
            if not np.array_equal(few[earlier], few[later]) or not np.ptp(few[later]) > 0.0:
                continue
            if all(np.array_equal(signals[earlier, part], signals[later, part]) for part in blocks(signals.shape[1])):
                detail = f"the same samples as channel {names[earlier]}: one of the two was not measured"
                found[later] = SignalFault("copied_channel", "suspect", detail)
                break
    return found


def find_dead(
    signals: FloatArray, surveys: Sequence[Survey], groups: Sequence[str], *, settings: IngestSettings
) -> dict[int, SignalFault]:
    """Faults by number of the ``signals`` (channel, sample) that hold noise alone while others see the machine.

    Only channels of one of ``groups`` (units) are compared, by their ``surveys`` and ``settings``. Dead is one far
    below the middle of the others in which none of the strongest lines of the loudest stands out, whether it toggles
    between a few steps of the converter or not.
    """
    size = np.array([root_mean_square(each) for each in surveys])
    found: dict[int, SignalFault] = {}
    for number, own in enumerate(size):
        others = [k for k, group in enumerate(groups) if group == groups[number] and k != number and size[k] > 0.0]
        if not others or not own > 0.0:
            continue
        typical = float(np.median(size[others]))
        if own > settings.dead_ratio * typical:
            continue
        loudest = max(others, key=lambda k: size[k])
        steps = _steps(signals[number])
        if not _shows_lines(signals[number], signals[loudest]):
            rest = f"within {steps} steps of its converter" if steps <= settings.dead_steps else "noise alone"
            below = f"{typical / own:.3g} times below the others, none of whose lines it shows"
            detail = f"{rest}, {below}: dead or not connected"
            found[number] = SignalFault("dead_sensor", "bad", detail, is_lost=True)
    return found


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


def find_mains_only(
    surveys: Sequence[Survey], rate_hz: float, shaft_hz: float, *, settings: IngestSettings
) -> dict[int, SignalFault]:
    """Faults by number of the channels that hold mains, its multiples and noise, while others hold other lines.

    ``surveys`` of channels sampled at ``rate_hz``, judged by ``settings``. ``shaft_hz``: of the shaft, 0 for none;
    NaN where unknown, and then nothing is told, nor where an order of the shaft lies on mains.
    """
    if not math.isfinite(shaft_hz) or len(surveys) < 2:
        return {}
    series = np.stack([each.means[: 8 * _SERIES] for each in surveys])
    series = np.nan_to_num(series - np.nanmean(series, axis=1, keepdims=True))
    series_hz = rate_hz / surveys[0].size
    if len(series[0]) < _SERIES // 8 or len(series[0]) / series_hz < 1.0:
        return {}
    sizes = np.array([root_mean_square(each) for each in surveys])
    for mains_hz in (50.0, 60.0):
        if shaft_hz > 0.0 and abs((ratio := 2.0 * mains_hz / shaft_hz) - round(ratio)) < _OFF_MAINS * ratio:
            continue
        shares = _mains_power(series[:, :_SERIES], series_hz, mains_hz) / np.square(sizes)
        candidates = np.flatnonzero(shares > settings.mains_share)
        if not candidates.size or candidates.size == len(surveys):
            continue
        lines = [_lines_beside(row, series_hz, mains_hz) for row in series]
        elsewhere = max(lines[k] / sizes[k] ** 2 for k in range(len(surveys)) if k not in candidates)
        told = [k for k in candidates if lines[k] < 0.01 * sizes[k] ** 2 and elsewhere > 0.2]
        detail = f"{mains_hz:g} Hz, its multiples and noise alone, while others show the machine: pick-up, no sensor"
        return {int(k): SignalFault("mains_only", "suspect", detail) for k in told}
    return {}


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


def find_level_steps(surveys: Sequence[Survey], *, settings: IngestSettings) -> dict[int, SignalFault]:
    """Faults by number of the channels of ``surveys`` whose level steps (``settings``) beside all others."""
    if len(surveys) < 2:
        return {}
    group = len(surveys[0].means) // _PIECES
    if group < 4:
        return {}
    squares = np.stack([grouped(one.variances + (one.means - np.nanmean(one.means)) ** 2, group) for one in surveys])
    if not (np.isfinite(squares).all() and (squares > 0.0).all()):
        return {}
    levels = 0.5 * np.log(squares)
    found: dict[int, SignalFault] = {}
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
        samples = at * group * surveys[number].size
        factor, span = f"a factor of {np.exp(step):.3g}", runs_of((samples, surveys[number].n_samples))
        detail = f"the level changes by {factor} at once, that of the others does not: gain or seat"
        found[number] = SignalFault("level_step", "suspect", detail, span)
    return found


def _largest_step(level: np.ndarray) -> tuple[int, float]:
    """First piece behind the best split of ``level`` (piece,) in two, and the step there."""
    splits = np.arange(_EDGE, len(level) - _EDGE + 1)
    total = np.cumsum(level)
    before = total[splits - 1] / splits
    after = (total[-1] - total[splits - 1]) / (len(level) - splits)
    gain = np.square(after - before) * splits * (len(level) - splits)
    best = int(np.argmax(gain))
    return int(splits[best]), float(after[best] - before[best])


def find_slow_faults(survey: Survey, *, settings: IngestSettings) -> list[SignalFault]:
    """Overloads, a settling start and drift of the signal of ``survey`` by ``settings``, each with its samples."""
    group = max(len(survey.means) // _GROUPS, 1)
    means, step = grouped(survey.means, group), group * survey.size
    if len(means) < _FEWEST or not np.isfinite(means).all():
        return []
    spread = grouped(survey.means**2, group) - means**2 + grouped(survey.variances, group)
    vibration = math.sqrt(max(float(np.median(spread)), 0.0))
    if float(np.ptp(means)) <= settings.drift_ratio * vibration:
        return []
    faults: list[SignalFault] = []
    free = np.ones(len(means), dtype=np.bool_)
    for _ in range(_MOST_EVENTS):
        event = _overload(means, free, vibration, step, survey.n_samples, settings)
        if event is None:
            break
        faults.append(event)
        free[event.at.starts[0] // step : -(-event.at.ends[0] // step)] = False
    if not faults and (start := _settling(means, vibration, step, settings)) is not None:
        faults.append(start)
        free[: -(-int(start.at.ends[0]) // step)] = False
    drift = _drift(means, free, vibration, settings)
    return faults if drift is None else [*faults, drift]


def _decay(offsets: Floats) -> tuple[float, float, float]:
    """Size, time constant (pieces) and share of the variance that is told, of an exponential decay to nothing."""
    n = np.arange(len(offsets), dtype=np.float64)
    constants = np.geomspace(1.0, 2.0 * len(offsets), _DECAYS)
    shapes = np.exp(-n / constants[:, None])
    sizes = shapes @ offsets / np.square(shapes).sum(axis=1)
    left = np.square(offsets - sizes[:, None] * shapes).sum(axis=1)
    best = int(np.argmin(left))
    told = 1.0 - float(left[best]) / max(float(np.square(offsets).sum()), 1e-300)
    return float(sizes[best]), float(constants[best]), told


def _ends_after(size: float, constant: float, vibration: float) -> float:
    """Pieces after which a decay from ``size`` is small beside the ``vibration``."""
    return constant * math.log(max(abs(size) / max(_LEFT * vibration, 1e-6 * abs(size)), 1.0))


def _overload(
    means: Floats, free: np.ndarray, vibration: float, step: int, n_samples: int, settings: IngestSettings
) -> SignalFault | None:
    """The largest jump to a rail that decays to where it came from, if there is one where ``free``."""
    before = float(np.median(means[free]))
    apart = np.where(free, means - before, 0.0)
    top = int(np.argmax(np.abs(apart)))
    size = float(apart[top])
    if abs(size) < settings.overload_ratio * vibration:
        return None
    inside = np.abs(apart) > 0.5 * abs(size)
    jump = top
    while jump > 0 and inside[jump - 1] and apart[jump - 1] * size > 0.0:
        jump -= 1
    if jump < _RISE:
        return None
    ahead = apart[:jump][free[:jump]][-16:]
    rest = float(np.median(ahead))
    if abs(apart[max(jump - _RISE, 0)] - rest) > 0.2 * abs(size) or abs(rest) > 0.3 * abs(size):
        return None
    apart = apart - rest
    size = float(apart[top])
    at_rail = np.flatnonzero(np.abs(apart[top:]) > 0.9 * abs(size))
    gap = np.flatnonzero(np.diff(at_rail) > 1)
    begin = top + int(at_rail[gap[0]] if gap.size else at_rail[-1])
    following = np.flatnonzero(~free[begin:])
    end = begin + int(following[0]) if following.size else len(means)
    again = np.flatnonzero(np.diff(np.abs(apart[begin:end])) > 0.5 * abs(size))  # the next overload
    end = begin + int(again[0]) if again.size else end
    if end - begin < 4:
        return None
    height, constant, told = _decay(apart[begin:end])
    if told < settings.decay_share or constant < 1.5:
        return None
    last = min(end, begin + math.ceil(_ends_after(height, constant, vibration)) + 1)
    level = _level_outside(apart, free, (jump - 1, last), size, vibration)
    if abs(size) < settings.overload_ratio * level:
        return None
    span = runs_of(((jump - 1) * step, n_samples if last >= len(means) else last * step))
    detail = (
        f"overload of the sensor's supply: a jump of {size:.4g} ({abs(size) / max(level, 1e-300):.3g} times the "
        "root mean square) that decays"
    )
    return SignalFault("iepe_overload", "bad", detail, span, is_lost=True)


def _level_outside(apart: Floats, free: Bools, event: tuple[int, int], size: float, vibration: float) -> float:
    """Root mean square of the vibration, whose lines slower than a piece swing the means ``apart`` themselves.

    Told by those that are ``free`` and outside of the ``event``: by their median, for other overloads do not count;
    and infinite where they swing by half of ``size`` more often than overloads come.
    """
    outside = free.copy()
    outside[slice(*event)] = False
    if not outside.any():
        return vibration
    beyond = outside & (np.abs(apart) > 0.5 * abs(size))
    if np.count_nonzero(np.diff(beyond, prepend=False) & beyond) >= _MOST_EVENTS:
        return math.inf
    return math.hypot(vibration, _NORMAL * float(np.median(np.abs(apart[outside]))))


def _settling(means: Floats, vibration: float, step: int, settings: IngestSettings) -> SignalFault | None:
    """A decay from the first sample on to where the signal then stays."""
    later = means[2 * len(means) // 3 :]
    rest = float(np.median(later))
    noise = 1.5 * float(np.median(np.abs(later - rest)))
    offsets = means - rest
    size, constant, told = _decay(offsets)
    is_settling = told > settings.decay_share and constant < 0.2 * len(means) and abs(size) > 6.0 * noise
    if not is_settling or abs(size) < settings.drift_ratio * vibration:
        return None
    end = min(math.ceil(_ends_after(size, constant, vibration)) + 1, len(means) // 2)
    detail = f"the signal settles from {size:.4g} ({abs(size) / max(vibration, 1e-300):.3g} times the root mean square)"
    return SignalFault("start_transient", "suspect", detail, runs_of((0, end * step)), is_lost=True)


def _drift(means: Floats, free: np.ndarray, vibration: float, settings: IngestSettings) -> SignalFault | None:
    """A slow trend larger than the vibration, in most of what is ``free``."""
    if np.count_nonzero(free) < _FEWEST // 2:
        return None
    place = np.linspace(-1.0, 1.0, len(means))[free]
    values = means[free]
    trend = np.polynomial.Polynomial.fit(place, values, 3)(place)
    told = 1.0 - float(np.var(values - trend)) / max(float(np.var(values)), 1e-300)
    size = float(np.ptp(trend))
    if told < settings.drift_share or size < settings.drift_ratio * vibration:
        return None
    detail = (
        f"the mean wanders by {size:.4g} ({size / max(vibration, 1e-300):.3g} times the root mean square): "
        "lines below a few hertz are in doubt"
    )
    return SignalFault("drift", "suspect", detail)
