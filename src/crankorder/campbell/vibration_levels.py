"""Overall levels of a test by speed, from the pieces of its recordings, with the intervals that their scatter leaves.

Sources: H. M. James, N. B. Nichols, R. S. Phillips (1947), p. 269 (a mean of pieces that go with their neighbours);
Student (1908).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy import special

from crankorder.campbell.levels import LEVEL_COLUMNS, WITH_ENDS, LevelKey, level_coords
from crankorder.quantities import Floats, Ints, QualityFlag, Variables, described, flags_of, with_flags
from crankorder.settings import MethodNumbers
from crankorder.shaft.speeds import held_speeds

CONFIDENCE = 0.95


NUMBERS = MethodNumbers("4-campbell-map.toml", "levels_of_test")


class _Group(NamedTuple):
    """Pieces of like speed: their numbers, the passage (recording and visit) that each belongs to, whether swept."""

    pieces: Ints
    passage: Ints
    is_swept: bool


def vibration_levels(items: Sequence[xr.Dataset], *, speed_bin_rpm: float) -> xr.Dataset:
    """VibrationLevels of a test: (level, speed) from the LevelFrames ``items`` of its recordings.

    Speeds that are held within ``speed_bin_rpm`` are told one by one, sweeps in windows of some pieces that follow
    them. ``rms`` is the root of the mean of all mean squares, ``peak`` and ``crest_factor`` are the means of those of
    the pieces, ``largest_peak`` is the largest of all. The intervals come from the scatter of the pieces (that of the
    mean square by Student's t on its logarithm, wider where neighbours go together; in a window of a sweep about a
    straight line in time, with the scatter of the windows beside it); where recordings at like speed differ by more
    than their pieces, from the scatter of the recordings. One piece alone has no interval. Of one-third octaves the
    lower end allows for what the strongest leaks into the others.
    """
    joined = _joined(items)
    groups = _groups(joined.rpm, joined.owner, speed_bin_rpm)
    shape = (len(joined.keys), len(groups))
    made = {name: np.full(shape, np.nan) for name in ("rms", "peak", "crest_factor", "largest_peak", "log_error")}
    made |= {f"{name}_ci95": np.full((*shape, 2), np.nan) for name in ("rms", "peak", "crest_factor")}
    made["degrees_of_freedom"] = np.zeros(shape)
    for column, group in enumerate(groups):
        for rows, pieces, passage in _alike(joined.square, group):
            at = np.ix_(rows, pieces)
            _tell(made, rows, column, joined.square[at], joined.peak[at], passage)
    _tell_sweeps(made, joined, groups)
    _allow_leaks(made, joined.keys)
    coords = level_coords(joined.keys, joined.reached_hz, joined.si)
    rpm = np.array([joined.rpm[group.pieces].mean() for group in groups])
    coords["speed"] = described("speed", rpm, "min-1", "mean speed")
    variables: Variables = {}
    for name, (units, text) in _TOLD.items():
        variables[name] = described(("level", "speed"), made[name], units, text)
        if (interval := f"{name}_ci95") in made:
            text = f"95 % interval of {name}: low, high"
            variables[interval] = described(("level", "speed", "bound"), made[interval], units, text)
    result = xr.Dataset(variables, coords=coords)
    result.attrs = {"frame_s": min(joined.frame_s, default=math.nan), "speed_bin_rpm": speed_bin_rpm}
    return with_flags(result, joined.flags)


class _Joined(NamedTuple):
    """Levels of all recordings: their keys, reached frequencies and SI units (level,), values (level, piece).

    And of each piece its speed and the number of its recording; lengths of pieces and flags of the recordings.
    """

    keys: list[LevelKey]
    reached_hz: Floats
    si: Floats
    square: Floats
    peak: Floats
    rpm: Floats
    owner: Ints
    frame_s: list[float]
    flags: list[QualityFlag]


def _joined(items: Sequence[xr.Dataset]) -> _Joined:
    """All ``items``, each asked for once; a level that a recording does not have is NaN in its pieces.

    Of every channel those in broad bands come first, then its one-third octaves.
    """
    ends, of_items = dict[LevelKey, tuple[float, float]](), list[tuple[Ints, Floats, Floats, Floats]]()
    number, frame_s, flags = dict[LevelKey, int](), list[float](), list[QualityFlag]()
    for item in items:
        *parts, reached, si = (item.variables[name].values.tolist() for name in LEVEL_COLUMNS)
        for key, hertz, size in zip(zip(*parts, strict=True), reached, si, strict=True):
            ends[key] = min(hertz, ends.get(key, (math.inf,))[0]), size
        rows = np.array([number.setdefault(key, len(number)) for key in zip(*parts, strict=True)], dtype=np.int64)
        square, peak, rpm = (item.variables[name].values for name in ("mean_square", "peak", "speed"))
        of_items.append((rows, square, peak, rpm))
        frame_s += [float(item.attrs["frame_s"])] if math.isfinite(float(item.attrs["frame_s"])) else []
        flags += flags_of(item)
    channels = list(dict.fromkeys(key[0] for key in number))
    keys = sorted(number, key=lambda key: (channels.index(key[0]), key[3], key[4] if key[3] != "broad band" else 0.0))
    owner = np.repeat(np.arange(len(of_items), dtype=np.int64), [len(rpm) for *_, rpm in of_items])
    both = np.full((2, len(keys), len(owner)), np.nan)
    for place, (rows, square, peak, _) in enumerate(of_items):
        both[:, rows, slice(*np.searchsorted(owner, [place, place + 1]))] = square, peak
    square, peak = both[:, [number[key] for key in keys]]
    reached_hz, si_per_unit = np.array([ends[key] for key in keys]).reshape(-1, 2).T
    rpm = np.concatenate([rpm for *_, rpm in of_items])
    return _Joined(keys, reached_hz, si_per_unit, square, peak, rpm, owner, frame_s, flags)


def _groups(rpm: Floats, owner: Ints, speed_bin_rpm: float) -> list[_Group]:
    """Pieces of like speed: those held, each speed by itself; those swept, in windows; those of unknown speed."""
    held = held_speeds(rpm, owner, width_rpm=speed_bin_rpm)
    taken = np.concatenate(held) if held else np.empty(0, dtype=np.int64)
    rest = np.setdiff1d(np.arange(len(rpm)), taken)
    swept, unknown = rest[np.isfinite(rpm[rest])], rest[~np.isfinite(rpm[rest])]
    count = min(NUMBERS.sweep_windows, max(1, len(swept) // NUMBERS.window_pieces))
    windows = np.array_split(swept[np.argsort(rpm[swept], kind="stable")], count) if len(swept) else []
    groups = [_Group(group, owner[group], is_swept=False) for group in held]
    groups += [_Group(np.sort(window), _passages(np.sort(window), owner), is_swept=True) for window in windows]
    groups += [_Group(unknown, owner[unknown], is_swept=False)] if len(unknown) else []
    return sorted(groups, key=lambda group: float(np.nan_to_num(rpm[group.pieces].mean(), nan=np.inf)))


def _passages(pieces: Ints, owner: Ints) -> Ints:
    """Number of the passage of each of the rising ``pieces``: neighbours in time of one recording."""
    fresh = (np.diff(pieces) > 1) | (np.diff(owner[pieces]) != 0)
    return np.concatenate([[0], np.cumsum(fresh)]).astype(np.int64)


def _alike(square: Floats, group: _Group) -> Iterator[tuple[Ints, Ints, Ints]]:
    """Rows of ``square`` (level, piece) that are known in the same pieces of ``group``, these, and their passages."""
    patterns, which = np.unique(np.isfinite(square[:, group.pieces]), axis=0, return_inverse=True)
    for number, known in enumerate(patterns):
        if known.any():
            yield np.flatnonzero(which.ravel() == number), group.pieces[known], group.passage[known]


def _tell(made: dict[str, Floats], rows: Ints, column: int, square: Floats, peak: Floats, passage: Ints) -> None:
    """Write what the pieces (level, piece) of some levels and a group say into ``rows`` of ``made``."""
    mean = square.mean(axis=1)
    error, freedom = _error_of_mean(square, passage)
    share = np.divide(error, mean, out=np.zeros(len(mean)), where=mean > 0.0)
    _tell_rms(made, rows, column, np.sqrt(mean), share, freedom)
    known = np.isfinite(peak).all(axis=1)
    rows, square, peak = rows[known], square[known], peak[known]
    made["largest_peak"][rows, column] = peak.max(axis=1)
    crest = np.divide(peak, np.sqrt(square), out=np.full(peak.shape, np.nan), where=square > 0.0)
    for name, values in (("peak", peak), ("crest_factor", crest)):
        middle = made[name][rows, column] = values.mean(axis=1)
        error, freedom = _error_of_mean(values, passage)
        half = _t(freedom) * error
        made[f"{name}_ci95"][rows, column] = np.stack([np.maximum(0.0, middle - half), middle + half], axis=1)


def _tell_rms(made: dict[str, Floats], rows: Ints, column: int, rms: Floats, error: Floats, freedom: Floats) -> None:
    """Write ``rms`` with the ``error`` of the logarithm of its square, (level,) as its ``freedom``, into ``made``."""
    values = {"rms": rms, "log_error": error, "degrees_of_freedom": freedom}
    values["rms_ci95"] = rms_within(rms, error, freedom, chance=1.0 - CONFIDENCE)
    for name, value in values.items():
        made[name][rows, column] = value


def _tell_sweeps(made: dict[str, Floats], joined: _Joined, groups: list[_Group]) -> None:
    """Write the errors of the mean squares of ``joined`` in the swept ones of ``groups`` into ``made``.

    A few pieces tell their scatter badly, so that of the windows beside one counts too; where its own is larger, that.
    Of levels with the ends of their band the one at the louder end of the window is told, by which a limit is kept: the
    end of a straight line has twice the error of its middle.
    """
    columns = [column for column, group in enumerate(groups) if group.is_swept]
    own = np.zeros((3, len(joined.keys), len(columns)))  # squares off lines, products of neighbours, freedom
    for place, column in enumerate(columns):
        for rows, pieces, passage in _alike(joined.square, groups[column]):
            own[:, rows, place] = _off_lines(joined.square[np.ix_(rows, pieces)], passage)
    is_upper, reach = np.array([key[3] == WITH_ENDS for key in joined.keys], dtype=np.bool_), NUMBERS.windows_beside
    for place, column in enumerate(columns):
        pooled = own[:, :, max(0, place - reach) : place + reach + 1].sum(axis=2)
        variance = np.maximum(_variance(*pooled), _variance(*own[:, :, place]))
        able = (pooled[2] > 0.0) & (made["rms"][:, column] > 0.0)
        for alike, pieces, passage in _alike(joined.square, groups[column]):
            rows = alike[able[alike]]
            rms = made["rms"][rows, column]
            values = joined.square[np.ix_(rows, pieces)] / rms[:, None] ** 2
            error, freedom = _between(values, passage, variance[rows], pooled[2, rows])
            rms = np.where(is_upper[rows], rms * np.sqrt(_louder_end(values, passage)), rms)
            error = np.where(is_upper[rows], 2.0 * error, error)
            _tell_rms(made, rows, column, rms, error, freedom)


def _lines(values: Floats, passage: Ints) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Middle and rise to its end (level,) of a straight line through each ``passage``, and ``values`` off it.

    Through three pieces or fewer it is level.
    """
    for own in np.split(values, np.flatnonzero(np.diff(passage)) + 1, axis=1):
        middle, place = own.mean(axis=1), np.linspace(-1.0, 1.0, own.shape[1])
        rise = own @ place / (place @ place) if len(place) > 3 else np.zeros(len(own))
        yield middle, rise, own - middle[:, None] - rise[:, None] * place


def _off_lines(values: Floats, passage: Ints) -> Floats:
    """Scatter (3, level) of the ``values`` (level, piece) of a window about a straight line through each ``passage``.

    As shares of its mean square: squares off the lines and products of neighbours, and their freedom.
    """
    mean = values.mean(axis=1)
    made = np.zeros((3, len(values)))
    for _, rise, off in _lines(values[mean > 0.0] / mean[mean > 0.0, None], passage):
        beside = (off[:, 1:] * off[:, :-1]).sum(axis=1)
        freedom = np.full(len(rise), off.shape[1] - (2 if off.shape[1] > 3 else 1))
        made[:, mean > 0.0] += (off**2).sum(axis=1), beside, freedom
    return made


def _louder_end(values: Floats, passage: Ints) -> Floats:
    """Largest of the ``values`` (level, piece) of a window along straight lines through a ``passage``; 1 at least."""
    ends = np.ones(len(values))
    for middle, rise, off in _lines(values, passage):
        if (count := off.shape[1]) > 3:
            ends = np.maximum(ends, middle + np.abs(rise) * count / (count - 1))
    return ends


def _allow_leaks(made: dict[str, Floats], keys: list[LevelKey]) -> None:
    """Lower the lower ends of one-third octaves by what the strongest of their channel may leave in them."""
    of_channels = dict[str, list[int]]()
    for row, key in enumerate(keys):
        if key[3] == "one-third octave":
            of_channels.setdefault(key[0], []).append(row)
    for rows in of_channels.values():
        strongest = np.nanmax(made["rms"][rows], axis=0, initial=0.0)
        low = made["rms_ci95"][rows, :, 0] - NUMBERS.leak_share * strongest
        made["rms_ci95"][rows, :, 0] = np.maximum(low, 0.0)


def _error_of_mean(values: Floats, passage: Ints) -> tuple[Floats, Floats]:
    """Standard errors of the means (level,) of ``values`` (level, piece), and their degrees of freedom.

    0 of these where it is unknown. ``passage`` (piece,) numbers what each piece belongs to, such as its recording.
    """
    count, known = values.shape[1], np.isfinite(values).all(axis=1)
    first = _firsts(passage)
    freedom = np.where(known & (count > 1), float(count - len(first) or count - 1), 0.0)
    if count == 1:
        return np.full(len(values), np.nan), freedom
    if count == len(first):
        return np.std(values, ddof=1, axis=1) / math.sqrt(count), freedom
    sizes = np.diff(first, append=count)
    off = values - np.repeat(np.add.reduceat(values, first, axis=1) / sizes, sizes, axis=1)
    beside = off[:, 1:] * off[:, :-1] * (passage[1:] == passage[:-1])
    return _between(values, passage, _variance((off**2).sum(axis=1), beside.sum(axis=1), freedom), freedom)


def _firsts(passage: Ints) -> Ints:
    """First piece of each ``passage`` (piece,), which rises."""
    return np.flatnonzero(np.diff(passage, prepend=passage[0] - 1))


def _between(values: Floats, passage: Ints, variance: Floats, freedom: Floats) -> tuple[Floats, Floats]:
    """Standard error and freedom of the means of ``values`` (level, piece) of that ``variance`` and ``freedom``.

    Where the means of each ``passage`` differ by more, they are those between these.
    """
    count, first = values.shape[1], _firsts(passage)
    error, sizes = np.sqrt(variance / count), np.diff(first, append=count)
    if len(first) == 1:
        return error, freedom
    means = np.add.reduceat(values, first, axis=1) / sizes
    between = (sizes * (means - values.mean(axis=1, keepdims=True)) ** 2).sum(axis=1) / (len(first) - 1)
    ratio = np.divide(between, variance, out=np.zeros(len(variance)), where=variance > 0.0)
    differ = special.fdtrc(len(first) - 1, freedom, ratio) < NUMBERS.like_pieces_chance
    return np.where(differ, np.sqrt(between / count), error), np.where(differ, len(first) - 1.0, freedom)


def _variance(power: Floats, beside: Floats, freedom: Floats) -> Floats:
    """Variance (level,) of a piece, from sums of squares and of products of neighbours; 0 where nothing is known.

    It grows where neighbours go together, by (1 + r) / (1 - r), r the one sum over the other.
    """
    shared = np.divide(beside, power, out=np.zeros(len(power)), where=power > 0.0)
    shared = np.where(power > 0.0, np.clip(shared, NUMBERS.least_shared, NUMBERS.most_shared), 0.0)
    inflated = power * (1.0 + shared) / (1.0 - shared)
    return np.divide(inflated, freedom, out=np.zeros(len(power)), where=freedom > 0)


def _t(freedom: Floats, *, chance: float = 1.0 - CONFIDENCE) -> Floats:
    """Half width, in standard errors, of an interval that a mean of so many degrees of ``freedom`` leaves by chance.

    NaN where there are none.
    """
    return np.asarray(special.stdtrit(freedom, 1.0 - 0.5 * chance))


def rms_within(rms: Floats, log_error: Floats, freedom: Floats, *, chance: float) -> Floats:
    """Interval (level, 2) of each ``rms`` that it leaves by ``chance``, from the error of the logarithm of its square.

    ``rms`` is (level,), ``log_error`` and ``freedom`` (level,) are those of VibrationLevels, ``chance`` is 0 to 1; both
    ends are NaN where nothing is known of the error.
    """
    half = 0.5 * _t(freedom, chance=chance) * log_error
    return rms[:, None] * np.exp(np.stack([-half, half], axis=1))


_TOLD = {
    "rms": ("see unit", "root mean square in the band"),
    "peak": ("see unit", "mean of the peaks of pieces of frame_s"),
    "largest_peak": ("see unit", "largest peak"),
    "crest_factor": ("1", "mean crest factor of pieces of frame_s: peak over root mean square"),
    "log_error": ("1", "standard error of the logarithm of the mean square"),
    "degrees_of_freedom": ("1", "degrees of freedom of log_error; 0 where it is not known"),
}
