"""Faults that a signal shows by itself: samples missing, clipped or constant, an overload, a settling start, drift.

All of it is done block by block, for a signal may be larger than memory. What leaves this module is finite or NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numba as nb
import numpy as np

from crankorder.ingest.rawfile import FloatArray
from crankorder.quantities import Bools, Floats, Ints, Severity
from crankorder.scratch import blocks
from crankorder.settings import IngestSettings

# beyond any physical signal: fill values of NetCDF (9.97e36) and of LabVIEW lie above it
_FILL_ABOVE = 1e30
_SENTINELS = (-999.0, -9999.0, -99999.0, 9999.0, 99999.0)
# a flat top that falls by more than this many rounding steps within its own length was cut off: twice the smooth fall
_STEEP_STEPS = 10.0
# samples between gaps, in the middle of all such stretches, that are worth analysing by themselves
_FEWEST_BETWEEN = 128

_BLOCKS_PER_S = 300.0
_LEAST_BLOCK, _MOST_BLOCK = 4, 128
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

Mask = Callable[[FloatArray], Bools]


def spans_of(*spans: tuple[int, int]) -> Ints:
    """The ``spans`` as an array (spans, 2): the first sample of each and the one after its last."""
    return np.array(spans, dtype=np.int64).reshape(-1, 2)


def lengths_of(spans: Ints) -> Ints:
    """Number of samples (spans,) of each of the ``spans`` (spans, 2)."""
    return spans[:, 1] - spans[:, 0]


def joined(spans: Sequence[Ints], *, within: int = 0, n_samples: int) -> Ints:
    """Union (joined, 2) of ``spans``, each (spans, 2), in order; spans that touch become one.

    Each is widened by ``within`` samples on both sides first, and cut to the ``n_samples`` of the signal.
    """
    wide = np.clip(np.concatenate([spans_of(), *spans]) + np.array([-within, within]), 0, n_samples)
    wide = wide[np.argsort(wide[:, 0], kind="stable")]
    ends = np.maximum.accumulate(wide[:, 1])
    apart = np.flatnonzero(wide[1:, 0] > ends[:-1])
    return np.column_stack([wide[np.append(0, apart + 1), 0], ends[np.append(apart, -1)]]) if len(wide) else wide


@dataclass(frozen=True, slots=True)
class SignalFault:
    """A fault of a signal: ``flag``, ``severity`` and ``detail`` are those of a quality flag.

    ``at`` (spans, 2) are the first sample of each span and the one after its last; empty for the whole signal.
    ``is_lost`` says that these samples tell nothing of the machine and take no part in any average.
    """

    flag: str
    severity: Severity
    detail: str
    at: Ints = field(default_factory=spans_of)
    is_lost: bool = False

    @property
    def loses_all(self) -> bool:
        """Whether nothing of the signal is left."""
        return self.is_lost and not len(self.at)


def mend_signal(signal: FloatArray, *, settings: IngestSettings) -> list[SignalFault]:
    """Faults of ``signal`` (samples,), whose missing samples are bridged in place where they are few in a row.

    Samples of a longer gap become NaN. ``settings`` say how many missing samples are few and what counts as clipping.
    The whole signal is lost where more samples would be bridged than the spectrum bears, or too many are missing.
    """
    low, high, n_still, has_nan = _range_of(signal)
    flags: list[SignalFault] = []
    if has_nan or min(low, -high) <= -_FILL_ABOVE or low in _SENTINELS or high in _SENTINELS:
        missing = _runs(signal, _missing(signal))
        if len(missing):
            flags += _without(signal, missing, settings)
            if any(fault.is_lost for fault in flags):
                return flags
            low, high, n_still, _ = _range_of(signal)
    if low == high:
        return [*flags, SignalFault("constant_signal", "bad", f"all samples equal {low:.6g}", is_lost=True)]
    # each fault needs so many samples that stand still: most signals have too few for any, and are done
    if 2 * n_still > signal.size and (levels := _few_levels(signal, settings)):
        shown = ", ".join(f"{level:.4g}" for level in levels)
        detail = f"takes the values {shown} alone: a switch, or a signal smaller than the steps of its converter"
        return [*flags, SignalFault("few_levels", "bad", detail, is_lost=True)]
    if n_still >= 2 * (settings.clip_run_samples - 1):
        flags += _clipping(signal, low, high, settings)
    if n_still >= settings.dropout_samples - 1:
        flags += _dropout(signal, settings)
    return flags


def _range_of(signal: FloatArray) -> tuple[float, float, int, bool]:
    """Least and greatest number among the samples, how many equal the one before them, and whether any is NaN."""
    lows, highs, n_still, has_nan, last = [], [], 0, False, np.nan
    for part in blocks(signal.size):
        piece = signal[part]
        low = piece.min()
        has_nan |= bool(np.isnan(low))
        lows.append(np.fmin.reduce(piece) if has_nan else low)
        highs.append(np.fmax.reduce(piece) if has_nan else piece.max())
        n_still += int(np.count_nonzero(piece[1:] == piece[:-1])) + int(piece[0] == last)
        last = piece[-1]
    return float(np.fmin.reduce(lows)), float(np.fmax.reduce(highs)), n_still, has_nan


def _runs(signal: FloatArray, mask: Mask, *, least: int = 1) -> Ints:
    """Runs of ``least`` samples or more in a row for which ``mask`` (of a block of samples) is true."""
    parts = [spans_of()]
    begun = -1  # where the run that has not ended yet began
    for part in blocks(signal.size):
        chosen = mask(signal[part])
        if begun < 0 and not chosen.any():
            continue
        turns = part.start + np.flatnonzero(np.diff(chosen, prepend=begun >= 0))
        turns = turns if begun < 0 else np.concatenate(([begun], turns))
        begun = int(turns[-1]) if turns.size % 2 else -1
        turns = turns[: turns.size // 2 * 2].reshape(-1, 2)
        parts.append(turns[lengths_of(turns) >= least])
    if begun >= 0 and signal.size - begun >= least:
        parts.append(spans_of((begun, signal.size)))
    return np.concatenate(parts)


def _dropout(signal: FloatArray, settings: IngestSettings) -> Iterator[SignalFault]:
    """Flag stretches in which the signal stands still, whatever its level, where the longest is too long for chance."""
    last = np.array([np.nan], dtype=signal.dtype)

    def still(piece: FloatArray) -> Bools:
        nonlocal last
        held = np.diff(np.concatenate((last, piece))) == 0.0
        last = piece[-1:]
        return np.asarray(held)

    runs = _runs(signal, still, least=settings.dropout_samples - 1)
    runs[:, 0] = np.maximum(runs[:, 0] - 1, 0)
    if lengths_of(runs).max(initial=0) < settings.dropout_fraction * signal.size:
        return
    is_silent = (signal[runs[:, 0]] == 0.0) & ((runs[:, 0] == 0) | (runs[:, 1] == signal.size))
    silence, held = runs[is_silent], runs[~is_silent]
    if len(silence):
        count = int(lengths_of(silence).sum())
        share = f"{count / signal.size:.1%}"
        detail = f"zeros for {count} samples ({share}) at its start or end: nothing was recorded there"
        yield SignalFault("silence", "suspect", detail, silence, is_lost=True)
    if (length := lengths_of(held).max(initial=0)) >= settings.dropout_fraction * signal.size:
        first = held[np.argmax(lengths_of(held)), 0]
        detail = f"the same value for {length} samples ({length / signal.size:.1%}) from sample {first}"
        yield SignalFault("dropout", "bad", detail, held, is_lost=True)


def _few_levels(signal: FloatArray, settings: IngestSettings) -> list[float]:
    """The values that ``signal`` takes, where they are so few that its converter or a switch makes them; else none."""
    levels: set[float] = set()
    for part in blocks(signal.size):
        piece = signal[part]
        levels.update((np.unique(piece[np.isfinite(piece)]) + 0.0).tolist())
        if len(levels) > settings.dead_steps:
            return []
    return sorted(levels)


def _missing(signal: FloatArray) -> Mask:
    """Which samples are not finite, fill values, or a sentinel such as -999 that lies far outside all other samples."""
    known: list[np.floating] = []

    def missing(piece: FloatArray) -> Bools:
        found = ~(np.abs(piece) < _FILL_ABOVE)
        for sentinel in known:
            found |= piece == sentinel
        return np.asarray(found)

    for number in _SENTINELS:
        sentinel = signal.dtype.type(number)
        n_hits, largest, n_rest = 0, 0.0, 0
        for part in blocks(signal.size):
            hits = signal[part] == sentinel
            rest = np.abs(signal[part][~(missing(signal[part]) | hits)])
            n_hits, n_rest = n_hits + int(np.count_nonzero(hits)), n_rest + rest.size
            largest = max(largest, float(rest.max(initial=0.0)))
        if n_hits and n_rest and largest < 0.1 * abs(number):
            known.append(sentinel)
    return missing


def _without(signal: FloatArray, missing: Ints, settings: IngestSettings) -> Iterator[SignalFault]:
    """Bridge the short of the ``missing`` runs by straight lines, make the others NaN, and flag both."""
    lengths = lengths_of(missing)
    is_short = lengths <= settings.max_gap_samples
    total, bridged = int(lengths.sum()), int(lengths[is_short].sum())
    between = np.diff(missing[:, 0], prepend=0, append=signal.size)
    if bridged > settings.max_gap_fraction * signal.size and np.median(between) >= _FEWEST_BETWEEN:
        is_short[:], bridged = False, 0  # too many to bridge, and far enough apart to leave out what touches them
    short, gaps = missing[is_short], missing[~is_short]
    limits = ((total, settings.max_missing_fraction, "in all"), (bridged, settings.max_gap_fraction, "to bridge"))
    for count, most, how in limits:
        if count > most * signal.size:
            for start, end in missing:
                signal[start:end] = np.nan
            first = missing[np.argmax(lengths), 0]
            lacks = f"{total} samples are missing (not a number, infinite or a fill value), most from sample {first}"
            share = f"{count / signal.size:.3%} {how}, allowed {most:.1%}"
            yield SignalFault("gap", "bad", f"{lacks}: {share}", is_lost=True)
            return
    for start, end in gaps:
        signal[start:end] = np.nan
    if len(gaps):
        lengths = lengths_of(gaps)
        share = f"{lengths.sum()} samples ({lengths.sum() / signal.size:.2%})"
        where = f"{len(gaps)} gap{'s' * (len(gaps) > 1)}, the longest of {lengths.max()}"
        first = f"from sample {gaps[np.argmax(lengths), 0]}; what touches a gap is left out"
        yield SignalFault("gap", "suspect", f"{share} missing in {where} {first}", gaps)
    if len(short):
        for start, end in short:
            beside = [place for place in (start - 1, end) if 0 <= place < signal.size]
            signal[start:end] = np.interp(np.arange(start, end), beside, signal[beside])
        detail = f"{bridged} missing samples bridged, first at sample {short[0, 0]}"
        yield SignalFault("non_finite_interpolated", "suspect", detail, short)


def _clipping(signal: FloatArray, low: float, high: float, settings: IngestSettings) -> list[SignalFault]:
    """Flag runs of equal samples at an extreme, where they are cut off and not the smooth top of a quantised signal."""
    cut_off = [spans_of()]
    step = np.nan
    for extreme in (low, high):
        at_extreme = partial(np.equal, signal.dtype.type(extreme))
        n_flat = sum(int(np.count_nonzero(at_extreme(signal[part]))) for part in blocks(signal.size))
        if n_flat < 2 * settings.clip_run_samples:
            continue
        flat = _runs(signal, at_extreme, least=settings.clip_run_samples)
        if np.isnan(step):  # of the rounding: the least change from one sample to the next
            changes = (np.abs(np.diff(signal[part.start : part.stop + 1])) for part in blocks(signal.size - 1))
            step = min((float(steps.min(where=steps > 0, initial=np.inf)) for steps in changes), default=np.inf)
        # within three steps lie more samples than at the extreme, unless the signal was cut off there
        apart = (np.abs(signal[part] - extreme) for part in blocks(signal.size))
        if len(flat) and n_flat > sum(int(np.count_nonzero((off > 0.0) & (off < 3.5 * step))) for off in apart):
            cut_off.append(flat[_is_cut_off(signal, extreme, flat, step)])
    flat = joined(cut_off, n_samples=signal.size)
    if sum(map(len, cut_off)) < 2:
        return []
    share = int(lengths_of(flat).sum()) / signal.size
    is_bad = share > settings.max_clipped_fraction
    detail = f"{share:.3%} of its samples lie flat at {low:.6g} or {high:.6g}, first at sample {flat[0, 0]}"
    return [SignalFault("clipped", "bad" if is_bad else "suspect", detail, flat, is_lost=is_bad)]


def _is_cut_off(signal: FloatArray, extreme: float, flat: Ints, step: float) -> Bools:
    """Which ``flat`` runs the signal enters or leaves steeply, beside the rounding ``step``.

    The top of a parabola that rounding flattens over L samples has fallen by 4.5 rounding steps L samples further on.
    """
    before, after = (
        np.abs(signal[np.clip(at, 0, signal.size - 1)] - extreme)
        for at in (flat[:, 0] - lengths_of(flat), flat[:, 1] - 1 + lengths_of(flat))
    )
    return np.asarray(np.fmax(before, after) > _STEEP_STEPS * step)


@dataclass(frozen=True, slots=True)
class Survey:
    """Statistics of short blocks of a signal, each array (blocks,), NaN where a sample is missing.

    ``size`` samples lie in each block; the rest at the end takes no part. ``means`` and ``variances`` are those of the
    block. A bend is the distance of a sample from the mean of its two neighbours: ``bend_squares`` and ``bend_fourths``
    are the means of its square and fourth power.
    """

    size: int
    n_samples: int
    means: Floats
    variances: Floats
    bend_squares: Floats
    bend_fourths: Floats


def block_size(rate_hz: float) -> int:
    """Samples per block: a power of two, small enough at ``rate_hz`` for the means to show twice the mains frequency.

    16 where the rate is not known.
    """
    if not (math.isfinite(rate_hz) and rate_hz > 0.0):
        return 16
    return int(2 ** math.floor(math.log2(min(max(rate_hz / _BLOCKS_PER_S, _LEAST_BLOCK), _MOST_BLOCK))))


def survey(signal: FloatArray, *, size: int) -> Survey:
    """Survey of ``signal`` (samples,) in blocks of ``size`` samples, each read once."""
    told = np.empty((4, signal.size // size))
    _look(signal, size, told)
    for number in np.flatnonzero(np.isinf(told[1])).tolist():  # the square of a wild sample is no float32
        before = min(number, 1)
        near = signal[(number - before) * size : (number + 2) * size].astype(np.float64)
        exact = np.empty((4, near.size // size))
        _look(near, size, exact)
        told[:, number] = exact[:, before]
    return Survey(size, signal.size, *told)


def grouped(values: Floats, group: int) -> Floats:
    """Means (values // group,) of ``values`` (values,) over ``group`` neighbours at a time; a rest is left out."""
    whole = len(values) // group * group
    return np.asarray(values[:whole].reshape(-1, group).mean(axis=1))


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "reassoc", "contract"})
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
    """Root mean square of the signal of ``survey``, in its unit; NaN where too much is missing."""
    known = np.isfinite(survey.means)
    if not known.any():
        return math.nan
    return math.sqrt(float(survey.means[known].var()) + float(survey.variances[known].mean()))


def sized(size: float, level: float) -> str:
    """``size`` and how many times the root mean square ``level``, both in the unit of the signal, that is."""
    return f"{size:.4g} ({abs(size) / max(level, 1e-300):.3g} times the root mean square)"


def find_slow_faults(survey: Survey, *, settings: IngestSettings) -> list[SignalFault]:
    """Faults of the signal of ``survey``: overloads, a settling start and drift, each with its samples.

    ``settings`` say what counts as one.
    """
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
        free[event.at[0, 0] // step : -(-event.at[0, 1] // step)] = False
    if not faults and (start := _settling(means, vibration, step, settings)) is not None:
        faults.append(start)
        free[: -(-int(start.at[0, 1]) // step)] = False
    return faults + _drift(means, free, vibration, settings)


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
    apart = np.where(free, means - np.median(means[free]), 0.0)
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
    rest = float(np.median(apart[:jump][free[:jump]][-16:]))
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
    span = spans_of(((jump - 1) * step, n_samples if last >= len(means) else last * step))
    detail = f"overload of the sensor's supply: a jump of {sized(size, level)} that decays"
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
    offsets = means - np.median(means[2 * len(means) // 3 :])
    noise = 1.5 * float(np.median(np.abs(offsets[2 * len(means) // 3 :])))
    size, constant, told = _decay(offsets)
    is_settling = told > settings.decay_share and constant < 0.2 * len(means) and abs(size) > 6.0 * noise
    if not is_settling or abs(size) < settings.drift_ratio * vibration:
        return None
    end = min(math.ceil(_ends_after(size, constant, vibration)) + 1, len(means) // 2)
    detail = f"the signal settles from {sized(size, vibration)}"
    return SignalFault("start_transient", "suspect", detail, spans_of((0, end * step)), is_lost=True)


def _drift(means: Floats, free: np.ndarray, vibration: float, settings: IngestSettings) -> list[SignalFault]:
    """A slow trend larger than the vibration, in most of what is ``free``."""
    if np.count_nonzero(free) < _FEWEST // 2:
        return []
    place, values = np.linspace(-1.0, 1.0, len(means))[free], means[free]
    trend = np.polynomial.Polynomial.fit(place, values, 3)(place)
    told = 1.0 - float(np.var(values - trend)) / max(float(np.var(values)), 1e-300)
    size = float(np.ptp(trend))
    if told < settings.drift_share or size < settings.drift_ratio * vibration:
        return []
    detail = f"the mean wanders by {sized(size, vibration)}: lines below a few hertz are in doubt"
    return [SignalFault("drift", "suspect", detail)]
