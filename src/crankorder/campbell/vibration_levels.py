"""Overall levels of a test by speed, from the pieces of its recordings, with the intervals that their scatter leaves.

Sources: H. M. James, N. B. Nichols, R. S. Phillips (1947), p. 269 (a mean of pieces that go with their neighbours);
Student (1908).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy import special

from crankorder.campbell.band_levels import LEVEL_TEXTS, SI, WITH_ENDS
from crankorder.quantities import Bools, Floats, Ints, flags_of, with_flags
from crankorder.settings import MethodNumbers
from crankorder.shaft.speed_groups import held_speeds

CONFIDENCE = 0.95


class _Numbers(MethodNumbers, file="4-campbell-map.toml", table="levels_of_test"):
    sweep_windows: int
    window_pieces: int
    windows_beside: int
    like_pieces_chance: float
    least_shared: float
    most_shared: float
    leak_share: float


NUMBERS = _Numbers.load()


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
    keys = _level_keys(items)
    owner = np.concatenate([np.full(item.sizes["frame"], number) for number, item in enumerate(items)]).astype(np.int64)
    rpm = np.concatenate([item["speed"].values for item in items])
    square, peak = (_joined(items, keys, name) for name in ("mean_square", "peak"))
    groups = _groups(rpm, owner, speed_bin_rpm)
    shape = (len(keys), len(groups))
    made = {name: np.full(shape, np.nan) for name in ("rms", "peak", "crest_factor", "largest_peak", "log_error")}
    made |= {f"{name}_ci95": np.full((*shape, 2), np.nan) for name in ("rms", "peak", "crest_factor")}
    made["degrees_of_freedom"] = np.zeros(shape)
    for column, group in enumerate(groups):
        for row in range(len(keys)):
            at = group.pieces
            _tell(made, row, column, square[row, at], peak[row, at], group.passage if group.is_swept else owner[at])
    _tell_sweeps(made, square, groups, np.array([key[3] == WITH_ENDS for key in keys], dtype=np.bool_))
    for column in range(len(groups)):
        _allow_leaks(made, column, keys)
    mean_rpm = np.array([_mean(rpm[group.pieces]) for group in groups])
    result = _levels_dataset(items, keys, made, mean_rpm)
    frames = [float(item.attrs["frame_s"]) for item in items if math.isfinite(float(item.attrs["frame_s"]))]
    result.attrs = {"frame_s": min(frames, default=math.nan), "speed_bin_rpm": speed_bin_rpm}
    return with_flags(result, [flag for item in items for flag in flags_of(item)])


_Key = tuple[str, str, str, str, float, float]


def _keys(item: xr.Dataset) -> list[_Key]:
    names = ("channel", "unit", "quantity", "kind", "low_frequency", "high_frequency")
    return list(zip(*(item[name].values.tolist() for name in names), strict=True))


def _level_keys(items: Sequence[xr.Dataset]) -> list[_Key]:
    """Levels of all ``items``, each once: of every channel those in broad bands, then its one-third octaves."""
    seen = list(dict.fromkeys(key for item in items for key in _keys(item)))
    names = list(dict.fromkeys(key[0] for key in seen))
    return sorted(seen, key=lambda key: (names.index(key[0]), key[3], key[4] if key[3] != "broad band" else 0.0))


def _joined(items: Sequence[xr.Dataset], keys: list[_Key], name: str) -> Floats:
    """Variable ``name`` (level, frame) of all ``items``; NaN where a recording has no such level."""
    parts = []
    for item in items:
        rows = {key: number for number, key in enumerate(_keys(item))}
        values = item[name].values
        part = np.full((len(keys), item.sizes["frame"]), np.nan)
        for row, key in enumerate(keys):
            if key in rows:
                part[row] = values[rows[key]]
        parts.append(part)
    return np.concatenate(parts, axis=1)


def _mean(rpm: Floats) -> float:
    return float(rpm.mean()) if np.isfinite(rpm).all() else math.nan


def _groups(rpm: Floats, owner: Ints, speed_bin_rpm: float) -> list[_Group]:
    """Pieces of like speed: those held, each speed by itself; those swept, in windows; those of unknown speed."""
    held = held_speeds(rpm, owner, width_rpm=speed_bin_rpm)
    taken = np.concatenate(held) if held else np.empty(0, dtype=np.int64)
    rest = np.setdiff1d(np.arange(len(rpm)), taken)
    swept, unknown = rest[np.isfinite(rpm[rest])], rest[~np.isfinite(rpm[rest])]
    count = min(NUMBERS.sweep_windows, max(1, len(swept) // NUMBERS.window_pieces))
    windows = np.array_split(swept[np.argsort(rpm[swept], kind="stable")], count) if len(swept) else []
    made = [_Group(group, owner[group], is_swept=False) for group in held]
    made += [_Group(np.sort(one), _passages(np.sort(one), owner), is_swept=True) for one in windows]
    made += [_Group(unknown, owner[unknown], is_swept=False)] if len(unknown) else []
    return sorted(made, key=lambda group: float(np.nan_to_num(_mean(rpm[group.pieces]), nan=np.inf)))


def _passages(pieces: Ints, owner: Ints) -> Ints:
    """Number of the passage of each of the rising ``pieces``: neighbours in time of one recording."""
    fresh = (np.diff(pieces) > 1) | (np.diff(owner[pieces]) != 0)
    return np.concatenate([[0], np.cumsum(fresh)]).astype(np.int64)


def _tell(made: dict[str, Floats], row: int, column: int, square: Floats, peak: Floats, owner: Ints) -> None:
    """Write what the pieces of one level and group say into ``made``."""
    known = np.isfinite(square)
    if not known.any():
        return
    square, peak, owner = square[known], peak[known], owner[known]
    mean = float(square.mean())
    made["rms"][row, column] = math.sqrt(mean)
    error, freedom = _error_of_mean(square, owner)
    share = error / mean if mean > 0.0 else 0.0
    made["log_error"][row, column], made["degrees_of_freedom"][row, column] = share, freedom
    if freedom:
        half = 0.5 * _t(freedom) * share
        made["rms_ci95"][row, column] = math.sqrt(mean) * np.exp([-half, half])
    if not np.isfinite(peak).all():
        return
    made["largest_peak"][row, column] = peak.max()
    with np.errstate(invalid="ignore", divide="ignore"):
        crest = np.where(square > 0.0, peak / np.sqrt(square), np.nan)
    for name, values in (("peak", peak), ("crest_factor", crest)):
        made[name][row, column] = values.mean()
        error, freedom = _error_of_mean(values, owner)
        if freedom:
            half = _t(freedom) * error
            made[f"{name}_ci95"][row, column] = [max(0.0, values.mean() - half), values.mean() + half]


class _Scatter(NamedTuple):
    """Sums over the pieces of a window, as shares of its mean square: squares off the lines, products of neighbours."""

    power: float = 0.0
    beside: float = 0.0
    freedom: int = 0

    @property
    def variance(self) -> float:
        """Variance of a piece, larger where neighbours go together; 0 where nothing is known."""
        return self.power / self.freedom * _inflation(self.power, self.beside) if self.freedom else 0.0


def _tell_sweeps(made: dict[str, Floats], square: Floats, groups: list[_Group], is_upper: Bools) -> None:
    """Write the errors of the mean ``square`` (level, piece) in the swept ones of ``groups`` into ``made``.

    A few pieces tell their scatter badly, so that of the windows beside one counts too; where its own is larger, that.
    Of levels that ``is_upper`` (level,) the one at the louder end of the window is told, by which a limit is kept: the
    end of a straight line has twice the error of its middle.
    """
    columns = [column for column, group in enumerate(groups) if group.is_swept]
    reach = NUMBERS.windows_beside
    for row in range(len(square)):
        own = [_off_lines(square[row, groups[column].pieces], groups[column].passage) for column in columns]
        for place, column in enumerate(columns):
            near = [sum(one) for one in zip(*own[max(0, place - reach) : place + reach + 1], strict=True)]
            pooled, rms = _Scatter(near[0], near[1], int(near[2])), made["rms"][row, column]
            if not pooled.freedom or not rms > 0.0:
                continue
            variance = max(pooled.variance, own[place].variance)
            values = square[row, groups[column].pieces] / rms**2
            error, freedom = _error_of_passages(values, groups[column].passage, variance, pooled.freedom)
            if is_upper[row]:
                rms *= math.sqrt(_louder_end(values, groups[column].passage))
                error, made["rms"][row, column] = 2.0 * error, rms
            made["log_error"][row, column], made["degrees_of_freedom"][row, column] = error, freedom
            made["rms_ci95"][row, column] = rms_within(rms, error, freedom, chance=1.0 - CONFIDENCE)


def _off_lines(values: Floats, passage: Ints) -> _Scatter:
    """Scatter of the ``values`` (piece,) of a window about a straight line through each ``passage`` of them."""
    known = np.isfinite(values)
    power, beside, freedom = 0.0, 0.0, 0
    mean = float(values[known].mean()) if known.any() else 0.0
    for number in np.unique(passage[known]) if mean > 0.0 else ():
        own = values[known & (passage == number)] / mean
        terms = 2 if len(own) > 3 else 1
        place = np.vander(np.linspace(-1.0, 1.0, len(own)), terms)
        off = own - place @ np.linalg.lstsq(place, own, rcond=None)[0]
        power, beside = power + float(off @ off), beside + float(off[1:] @ off[:-1])
        freedom += len(own) - terms
    return _Scatter(power, beside, freedom)


def _louder_end(values: Floats, passage: Ints) -> float:
    """Largest of the ``values`` (piece,) of a window along the straight line through a ``passage``; 1 at least."""
    known = np.isfinite(values)
    ends = [1.0]
    for number in np.unique(passage[known]):
        own = values[known & (passage == number)]
        if len(own) > 3:
            slope, middle = np.polyfit(np.linspace(-1.0, 1.0, len(own)), own, 1)
            ends.append(float(middle + abs(slope) * len(own) / (len(own) - 1)))
    return max(ends)


def _error_of_passages(values: Floats, passage: Ints, variance: float, freedom: int) -> tuple[float, int]:
    """Standard error of the mean of ``values`` of that ``variance``, of ``freedom``; larger where passages differ."""
    known = np.isfinite(values)
    which, sizes = np.unique(passage[known], return_inverse=True)[1], np.bincount(passage[known])
    sizes = sizes[sizes > 0]
    means = np.bincount(which, values[known]) / sizes
    return _between(values[known], means, sizes, variance, freedom)


def _allow_leaks(made: dict[str, Floats], column: int, keys: list[_Key]) -> None:
    """Lower the lower ends of one-third octaves by what the strongest of their channel may leave in them."""
    third = np.array([key[3] == "one-third octave" for key in keys])
    for name in {key[0] for key in keys}:
        rows = np.flatnonzero(third & np.array([key[0] == name for key in keys]))
        strongest = float(np.nanmax(made["rms"][rows, column], initial=0.0))
        low = made["rms_ci95"][rows, column, 0]
        made["rms_ci95"][rows, column, 0] = np.maximum(low - NUMBERS.leak_share * strongest, 0.0)


def _error_of_mean(values: Floats, owner: Ints) -> tuple[float, int]:
    """Standard error of the mean of ``values`` (pieces,) and its degrees of freedom; 0 of these where it is unknown.

    ``owner`` numbers the recording of each.
    """
    count = len(values)
    if count < 2 or not np.isfinite(values).all():
        return math.nan, 0
    names, which = np.unique(owner, return_inverse=True)
    sizes = np.bincount(which)
    means = np.bincount(which, values) / sizes
    inside = values - means[which]
    freedom = count - len(names)
    if freedom < 1:
        return float(np.std(values, ddof=1) / math.sqrt(count)), count - 1
    power, neighbours = float(inside @ inside), which[1:] == which[:-1]
    variance = power / freedom * _inflation(power, float(inside[1:][neighbours] @ inside[:-1][neighbours]))
    return _between(values, means, sizes, variance, freedom)


def _between(values: Floats, means: Floats, sizes: Ints, variance: float, freedom: int) -> tuple[float, int]:
    """Standard error and freedom of the mean of ``values`` of that ``variance`` and ``freedom`` inside recordings.

    Where the ``means`` of recordings of those ``sizes`` differ by more, they are those between these.
    """
    if len(means) > 1 and variance > 0.0:
        between = float(np.sum(sizes * (means - values.mean()) ** 2)) / (len(means) - 1)
        if special.fdtrc(len(means) - 1, freedom, between / variance) < NUMBERS.like_pieces_chance:
            return math.sqrt(between / len(values)), len(means) - 1
    return math.sqrt(variance / len(values)), freedom


def _inflation(power: float, beside: float) -> float:
    """By how much the variance of a mean grows because neighbours go together: (1 + r) / (1 - r).

    r is ``beside``, the sum of products of neighbours, over ``power``, the sum of squares.
    """
    if power == 0.0:
        return 1.0
    shared = min(max(beside / power, NUMBERS.least_shared), NUMBERS.most_shared)
    return (1.0 + shared) / (1.0 - shared)


def _t(freedom: float, *, chance: float = 1.0 - CONFIDENCE) -> float:
    """Half width, in standard errors, of an interval that a mean of so many degrees of ``freedom`` leaves by chance."""
    return float(special.stdtrit(freedom, 1.0 - 0.5 * chance))


def rms_within(rms: float, log_error: float, freedom: float, *, chance: float) -> tuple[float, float]:
    """Interval of an ``rms`` that it leaves by ``chance``, from the error of the logarithm of its square.

    ``log_error`` and ``freedom`` are those of VibrationLevels; both ends are NaN where nothing is known of the error.
    """
    if not freedom > 0.0 or not math.isfinite(log_error):
        return math.nan, math.nan
    half = 0.5 * _t(freedom, chance=chance) * log_error
    return rms * math.exp(-half), rms * math.exp(half)


_TOLD = {
    "rms": ("see unit", "root mean square in the band"),
    "peak": ("see unit", "mean of the peaks of pieces of frame_s"),
    "largest_peak": ("see unit", "largest peak"),
    "crest_factor": ("1", "mean crest factor of pieces of frame_s: peak over root mean square"),
    "log_error": ("1", "standard error of the logarithm of the mean square"),
    "degrees_of_freedom": ("1", "degrees of freedom of log_error; 0 where it is not known"),
}


def _levels_dataset(items: Sequence[xr.Dataset], keys: list[_Key], made: dict[str, Floats], rpm: Floats) -> xr.Dataset:
    result = xr.Dataset()
    for place, name in enumerate(("channel", "unit", "quantity", "kind")):
        values = np.array([key[place] for key in keys], dtype=np.str_)
        result.coords[name] = ("level", values, {"units": "1", "long_name": LEVEL_TEXTS[name]})
    reached, size = dict[_Key, float](), dict[_Key, float]()
    for item in items:
        pairs = zip(item["reached_frequency"].values.tolist(), item["si_per_unit"].values.tolist(), strict=True)
        for key, (hertz, si) in zip(_keys(item), pairs, strict=True):
            reached[key], size[key] = min(hertz, reached.get(key, math.inf)), si
    result.coords["si_per_unit"] = ("level", np.array([size[key] for key in keys], dtype=np.float64), SI)
    ends = {
        "low_frequency": ("lower end of the band", [key[4] for key in keys]),
        "high_frequency": ("upper end of the band", [key[5] for key in keys]),
        "reached_frequency": ("where the band ends as the slowest rate allows", [reached[key] for key in keys]),
    }
    for name, (text, hertz_of) in ends.items():
        result.coords[name] = ("level", np.array(hertz_of, dtype=np.float64), {"units": "Hz", "long_name": text})
    result.coords["speed"] = ("speed", rpm, {"units": "min-1", "long_name": "mean speed"})
    for name, (units, text) in _TOLD.items():
        result[name] = (("level", "speed"), made[name], {"units": units, "long_name": text})
        if f"{name}_ci95" in made:
            words = {"units": units, "long_name": f"95 % interval of {name}: low, high"}
            result[f"{name}_ci95"] = (("level", "speed", "bound"), made[f"{name}_ci95"], words)
    return result
