"""Overall levels: root mean square, peak and crest factor of each channel in stated bands, and one-third octaves.

Sources: ISO 20816-1:2016 (broad-band root mean square velocity from 10 Hz to 1000 Hz); IEC 61260-1:2014 (base-ten
mid-band frequencies of one-third octaves); H. M. James, N. B. Nichols, R. S. Phillips (1947), p. 269 (a mean of
pieces that go with their neighbours).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, special

from crankorder.campbell.frames import frame_speeds
from crankorder.fft.integration import band_gain, bridged, derivative_gain, mirrored
from crankorder.quantities import Bools, Floats, Ints, flags_of, with_flags
from crankorder.settings import DERIVATIVE, MethodNumbers
from crankorder.shaft.speed_groups import held_speeds, speed_groups

Kind = Literal["broad band", "one-third octave"]

UNITS = {"acceleration": ("m/s2", 1.0), "velocity": ("mm/s", 1e-3), "displacement": ("µm", 1e-6)}
"""Unit in which a level of each quantity is told that was made of another, and its size in SI units."""

THIRD_OCTAVES_HZ = tuple(1000.0 * 10.0 ** (number / 10.0) for number in range(-20, 14))
"""Exact mid-band frequencies of the one-third octaves from 10 Hz to 20 kHz (IEC 61260-1, base ten)."""

_NOMINAL = (1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0)

HALF_THIRD_OCTAVE = 10.0**0.05
"""Upper end of a one-third octave over its middle."""

_BLOCK = 1 << 21
"""Samples that are transformed at once."""

_WIDE_HZ = 100.0
"""Width of a one-third octave above which a sample for each bandwidth will do: there are many in every piece."""

CONFIDENCE = 0.95


class _Numbers(MethodNumbers, file="4-campbell-map.toml", table="levels"):
    edge_octaves: float
    ring_periods: float
    most_ring_share: float
    shortest_periods: float
    fewest_bandwidths: float
    rate_over_band: float
    oversampling: float
    sweep_steps: int
    sweep_pieces: int
    like_pieces_chance: float
    least_shared: float
    most_shared: float
    leak_share: float


NUMBERS = _Numbers.load()


@dataclass(frozen=True)
class LevelBand:
    """A band of frequency in which a level is told, and of which quantity; ``as measured``: that of the channel."""

    quantity: str
    low_hz: float
    high_hz: float
    kind: Kind = "broad band"


@dataclass(frozen=True)
class _Level:
    """A band in one channel: quantity, unit (of ``si`` SI units), the factor to it after ``times`` derivatives, end."""

    channel: int
    band: LevelBand
    quantity: str
    unit: str
    factor: float
    times: int
    high_hz: float
    si: float


@dataclass(frozen=True)
class _Pieces:
    """Pieces of a recording that are looked at: first samples and length of each, and the rate in Hz."""

    starts: Ints
    length: int
    rate_hz: float


def nominal_hz(middle_hz: float) -> float:
    """Frequency by which a one-third octave about ``middle_hz`` is called: 31.5 for 31.62 Hz."""
    tens = math.floor(math.log10(middle_hz) + 1e-6)
    return _NOMINAL[round(10.0 * (math.log10(middle_hz) - tens)) % 10] * 10.0**tens


def third_octaves() -> tuple[LevelBand, ...]:
    """The one-third octaves from 10 Hz to 20 kHz, of what was measured."""
    half = HALF_THIRD_OCTAVE
    return tuple(LevelBand("as measured", hz / half, hz * half, "one-third octave") for hz in THIRD_OCTAVES_HZ)


def level_frames(recording: xr.Dataset, shaft: xr.Dataset, *, bands: Sequence[LevelBand], frame_s: float) -> xr.Dataset:
    """LevelFrames of one recording: mean square (level, frame) and peak (level, frame) in each of ``bands``.

    Parameters
    ----------
    recording : the full-band Recording; by crank angle it is taken as one at constant speed, without a speed it gives
        no frames
    shaft : its ShaftAngle
    bands : bands and quantities; a level is one of them in one channel. One that a channel cannot give (the velocity
        of a pressure) is left out; one that the rate does not reach ends at rate / 2.56 (``reached_hz``)
    frame_s : length of the pieces in s; shorter ones are taken where the recording is short

    The signal is filtered in one transform of the whole recording, integrated or differentiated where the quantity
    asks for it, and the mean square of each piece is that of its samples: no window, no leakage. What lies within
    some periods of the band of either end is left out. Pieces that touch an unusable sample are NaN.
    """
    rate = _rate_hz(recording)
    levels = _levels(recording, bands, rate)
    pieces = _pieces(recording.sizes[recording["signal"].dims[1]], rate, levels, frame_s)
    square = np.full((len(levels), len(pieces.starts)), np.nan)
    peak = np.full_like(square, np.nan)
    for channel in range(recording.sizes["channel"]):
        mine = [number for number, level in enumerate(levels) if level.channel == channel]
        if mine and len(pieces.starts):
            found = _of_channel(recording["signal"].values[channel], pieces, [levels[number] for number in mine])
            square[mine], peak[mine] = found
    rpm = np.full(len(pieces.starts), np.nan)
    if len(pieces.starts) and shaft.attrs.get("has_shaft", 1) and (shaft["time"].size or "speed_rpm" in shaft.attrs):
        rpm = frame_speeds(recording, shaft, pieces.starts, pieces.length, rate).mean_rpm
    return _frames_dataset(recording, levels, square, peak, np.where(rpm > 0.0, rpm, np.nan), pieces)


def _rate_hz(recording: xr.Dataset) -> float:
    """Samples per second; NaN by crank angle without a speed."""
    if recording.attrs["domain"] == "crank_angle":
        return float(recording.attrs["samples_per_rev"]) * float(recording.attrs.get("speed_rpm", math.nan)) / 60.0
    return float(recording.attrs.get("rate_hz", math.nan))


def _levels(recording: xr.Dataset, bands: Sequence[LevelBand], rate_hz: float) -> list[_Level]:
    """The levels that the channels of ``recording`` can give."""
    made: list[_Level] = []
    known = "si_per_unit" in recording.variables
    size = recording["si_per_unit"].values if known else np.full(recording.sizes["channel"], np.nan)
    measured, units = recording["quantity"].values.tolist(), recording["unit"].values.tolist()
    for channel, (own, unit) in enumerate(zip(measured, units, strict=True)):
        seen: set[tuple[str, float, float, str]] = set()
        for band in bands:
            wanted = own if band.quantity == "as measured" else band.quantity
            reached = min(band.high_hz, rate_hz / NUMBERS.rate_over_band)
            key = (wanted, band.low_hz, band.high_hz, band.kind)
            if key in seen or not reached > band.low_hz or (band.kind != "broad band" and reached < band.high_hz):
                continue
            converted = wanted in DERIVATIVE and own in DERIVATIVE and math.isfinite(float(size[channel]))
            if wanted != own and not converted:
                continue
            seen.add(key)
            told, factor, times, si = unit, 1.0, 0, float(size[channel])
            if wanted != own:
                told, si = UNITS[wanted]
                factor, times = float(size[channel]) / si, DERIVATIVE[wanted] - DERIVATIVE[own]
            made.append(_Level(channel, band, wanted, told, factor, times, reached, si))
    return made


def _pieces(n_samples: int, rate_hz: float, levels: list[_Level], frame_s: float) -> _Pieces:
    """Pieces of ``frame_s``, shorter in a short recording, between its ends; none where nothing can be told."""
    broad = [level.band.low_hz for level in levels if level.band.kind == "broad band"]
    if not broad or not math.isfinite(rate_hz):
        return _Pieces(np.empty(0, dtype=np.int64), 0, rate_hz)
    span = n_samples / rate_hz
    margin = min(NUMBERS.ring_periods / min(broad), NUMBERS.most_ring_share * span)
    usable = span - 2.0 * margin
    shortest = NUMBERS.shortest_periods / min(broad)
    if usable < shortest:
        return _Pieces(np.empty(0, dtype=np.int64), 0, rate_hz)
    length_s = max(shortest, min(frame_s, 0.25 * usable))
    length, first = max(1, math.floor(length_s * rate_hz)), math.ceil(margin * rate_hz)
    count = max(1, math.floor((n_samples - 2 * first) / length))
    return _Pieces(first + length * np.arange(count, dtype=np.int64), min(length, n_samples), rate_hz)


def _of_channel(signal: Any, pieces: _Pieces, levels: list[_Level]) -> tuple[Floats, Floats]:
    """Mean square and peak (levels, frames) of one channel."""
    count = len(pieces.starts)
    square, peak = np.full((len(levels), count), np.nan), np.full((len(levels), count), np.nan)
    lowest = min(level.band.low_hz for level in levels)
    margin = math.ceil(NUMBERS.ring_periods / lowest * pieces.rate_hz)
    together = max(1, (_BLOCK - 2 * margin) // pieces.length)
    for begin in range(0, count, together):
        mine = pieces.starts[begin : begin + together]
        first = max(0, int(mine[0]) - margin) if begin else 0
        last = min(len(signal), int(mine[-1]) + pieces.length + margin)
        last = last if begin + together < count else len(signal)
        part = signal[first:last]
        local = _Pieces(mine - first, pieces.length, pieces.rate_hz)
        into = slice(begin, begin + len(mine))
        square[:, into], peak[:, into] = _of_part(part, local, levels, margin)
        touched = _touched(np.isfinite(part), local)
        square[:, into][:, touched] = np.nan
        peak[:, into][:, touched] = np.nan
    return square, peak


def _touched(usable: Bools, pieces: _Pieces) -> Bools:
    """Which of ``pieces`` hold a sample that is not ``usable``."""
    if usable.all():
        return np.zeros(len(pieces.starts), dtype=bool)
    lost = np.concatenate([[0], np.cumsum(~usable)])
    return np.asarray(lost[pieces.starts + pieces.length] > lost[pieces.starts])


def _of_part(part: Any, pieces: _Pieces, levels: list[_Level], margin: int) -> tuple[Floats, Floats]:
    """Mean square and peak (levels, frames) of one stretch of a channel, by one transform of it."""
    filled = bridged(part)
    count = fft.next_fast_len(len(filled) + 2 * min(margin, len(filled)), real=True)
    before = min(margin, len(filled))
    padded = mirrored(filled, before, min(count - before - len(filled), len(filled)))
    spectrum = fft.rfft(padded.astype(part.dtype if part.dtype == np.float32 else np.float64), count)
    step = pieces.rate_hz / count
    square, peak = [], []
    for level in levels:
        made = _filtered(spectrum, count, step, level)
        edges = (pieces.starts[:, None] + np.array([0, pieces.length]) + before) * (len(made) / count)
        square.append(_mean_squares(made, edges))
        broad = level.band.kind == "broad band"
        peak.append(_peaks(made, edges) if broad else np.full(len(pieces.starts), np.nan))
    too_narrow = _too_narrow(levels, len(pieces.starts) * pieces.length / pieces.rate_hz)
    values = np.array(square)
    values[too_narrow] = np.nan
    return values, np.array(peak)


def _too_narrow(levels: list[_Level], span_s: float) -> Bools:
    """Which one-third octaves are too narrow for a record of ``span_s``."""
    width = np.array([level.high_hz - level.band.low_hz for level in levels])
    third = np.array([level.band.kind != "broad band" for level in levels])
    return np.asarray(third & (width * span_s < NUMBERS.fewest_bandwidths))


@lru_cache(maxsize=256)
def _gain(first: int, last: int, step_hz: float, level: _Level, single: bool) -> NDArray[Any]:
    """Gain (bins,) of the band of ``level`` at the bins ``first`` to ``last``, ``step_hz`` apart.

    It is complex where the level is an integral or a derivative, in ``single`` precision for such spectra.
    """
    frequency: Floats = np.arange(first, last + 1, dtype=np.float64) * step_hz
    gain = band_gain(frequency, level.band.low_hz, level.high_hz, half_octaves=NUMBERS.edge_octaves) * level.factor
    if level.times:
        turned = gain * derivative_gain(frequency, level.times)
        return turned.astype(np.complex64) if single else turned
    return gain.astype(np.float32) if single else gain


def _filtered(spectrum: NDArray[np.complexfloating], whole: int, step_hz: float, level: _Level) -> NDArray[Any]:
    """The signal in the band of ``level`` at a lower rate, from the ``spectrum`` of its ``whole`` samples.

    In a broad band it is real; of a one-third octave it is the complex envelope over the root of two.
    """
    half = NUMBERS.edge_octaves
    low = max(1, math.floor(level.band.low_hz * 2.0**-half / step_hz))
    high = min(len(spectrum) - 1, math.ceil(level.high_hz * 2.0**half / step_hz))
    alike = replace(level, channel=0)
    inside = spectrum[low : high + 1] * _gain(low, high, step_hz, alike, spectrum.dtype == np.complex64)
    if level.band.kind == "broad band":
        n_out = fft.next_fast_len(max(2 * (high + 1), math.ceil(NUMBERS.oversampling * high)), real=True)
        made = np.zeros(n_out // 2 + 1, dtype=inside.dtype)
        made[low : high + 1] = inside
        return np.asarray(fft.irfft(made, n_out, overwrite_x=True) * (n_out / whole))
    wide = level.high_hz - level.band.low_hz > _WIDE_HZ
    n_out = fft.next_fast_len((1 if wide else 2) * (high - low + 1))
    return np.asarray(fft.ifft(inside, n_out, overwrite_x=True) * (math.sqrt(2.0) * n_out / whole))


def _mean_squares(made: NDArray[Any], edges: Floats) -> Floats:
    """Mean square of ``made`` between the fractional ``edges`` (frames, 2)."""
    power = np.zeros(len(made) + 2, dtype=made.real.dtype)
    np.multiply(made.real, made.real, out=power[: len(made)])
    if np.iscomplexobj(made):
        power[: len(made)] += made.imag * made.imag
    at = np.clip(edges, 0.0, len(made))
    whole = at.astype(np.int64)
    sums = np.add.reduceat(power, whole.ravel(), dtype=np.float64)[::2]
    sums = np.where(whole[:, 1] > whole[:, 0], sums, 0.0)
    parts = (at - whole) * power[whole]
    return np.asarray((sums + parts[:, 1] - parts[:, 0]) / (at[:, 1] - at[:, 0]))


def _peaks(made: Any, edges: Floats) -> Floats:
    """Largest size of ``made`` between the ``edges`` (frames, 2)."""
    size = np.abs(made)
    ends = np.round(edges).astype(np.int64)
    return np.array([size[begin : max(begin + 1, end)].max() for begin, end in ends.tolist()])


_LEVEL_TEXTS = {
    "channel": "name of the channel",
    "unit": "unit of the level",
    "quantity": "what the level is of",
    "kind": "broad band or one-third octave",
}


_SI = {"units": "1", "long_name": "SI units in one unit of the level"}


def _frames_dataset(
    recording: xr.Dataset, levels: list[_Level], square: Floats, peak: Floats, rpm: Floats, pieces: _Pieces
) -> xr.Dataset:
    names = recording["channel"].values.tolist()
    texts = {
        "channel": [names[level.channel] for level in levels],
        "unit": [level.unit for level in levels],
        "quantity": [level.quantity for level in levels],
        "kind": [level.band.kind for level in levels],
    }
    hertz = {
        "low": ("lower end of the band", [level.band.low_hz for level in levels]),
        "high": ("upper end of the band", [level.band.high_hz for level in levels]),
        "reached": ("where the band ends as the rate allows", [level.high_hz for level in levels]),
    }
    words = {"mean_square": "mean square of the piece in the band", "peak": "largest size of the piece in the band"}
    units = {"mean_square": "see unit, squared", "peak": "see unit"}
    made = xr.Dataset(
        {
            name: (("level", "frame"), values, {"units": units[name], "long_name": words[name]})
            for name, values in (("mean_square", square), ("peak", peak))
        }
    )
    made.coords.update(
        {
            name: ("level", np.array(values, dtype=np.str_), {"units": "1", "long_name": _LEVEL_TEXTS[name]})
            for name, values in texts.items()
        }
    )
    made.coords.update(
        {
            f"{name}_frequency": ("level", np.array(values, dtype=np.float64), {"units": "Hz", "long_name": text})
            for name, (text, values) in hertz.items()
        }
    )
    size = np.array([level.si for level in levels], dtype=np.float64)
    made.coords["si_per_unit"] = ("level", size, _SI)
    made.coords["speed"] = ("frame", rpm, {"units": "min-1", "long_name": "mean speed of the piece"})
    made.attrs = {key: recording.attrs[key] for key in ("recording", "quality") if key in recording.attrs}
    made.attrs["frame_s"] = pieces.length / pieces.rate_hz if pieces.length else math.nan
    return made


def vibration_levels(items: Sequence[xr.Dataset], *, speed_bin_rpm: float) -> xr.Dataset:
    """VibrationLevels of a test: (level, speed) from the LevelFrames ``items`` of its recordings.

    Speeds that are held within ``speed_bin_rpm`` are told one by one, sweeps in some steps of speed. ``rms`` is the
    root of the mean of all mean squares, ``peak`` and ``crest_factor`` are the means of those of the pieces,
    ``largest_peak`` is the largest of all. The intervals come from the scatter of the pieces (that of the mean square
    by Student's t on its logarithm, wider where neighbours go together); where recordings at like speed differ by
    more than their pieces, from the scatter of the recordings. One piece alone has no interval. Of one-third octaves
    the lower end allows for what the strongest leaks into the others.
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
            _tell(made, row, column, square[row, group], peak[row, group], owner[group])
        _allow_leaks(made, column, keys)
    mean_rpm = np.array([rpm[group].mean() if np.isfinite(rpm[group]).all() else np.nan for group in groups])
    result = _levels_dataset(items, keys, made, mean_rpm)
    frames = [float(item.attrs["frame_s"]) for item in items if math.isfinite(float(item.attrs["frame_s"]))]
    result.attrs = {"frame_s": min(frames, default=math.nan), "speed_bin_rpm": speed_bin_rpm}
    return with_flags(result, [flag for item in items for flag in flags_of(item)])


_Key = tuple[str, str, str, str, float, float]


def _keys(item: xr.Dataset) -> list[_Key]:
    columns = [item[name].values.tolist() for name in ("channel", "unit", "quantity", "kind")]
    columns += [item[name].values.tolist() for name in ("low_frequency", "high_frequency")]
    return list(zip(*columns, strict=True))


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


def _groups(rpm: Floats, owner: Ints, speed_bin_rpm: float) -> list[Ints]:
    """Pieces of like speed: those held, each speed by itself; those swept, in steps; those of unknown speed."""
    held = held_speeds(rpm, owner, width_rpm=speed_bin_rpm)
    taken = np.concatenate(held) if held else np.empty(0, dtype=np.int64)
    rest = np.setdiff1d(np.arange(len(rpm)), taken)
    swept = rest[np.isfinite(rpm[rest])]
    span = float(np.ptp(rpm[swept])) if len(swept) else 0.0
    most = min(NUMBERS.sweep_steps, max(1, len(swept) // NUMBERS.sweep_pieces))
    width = max(speed_bin_rpm, span / most)
    steps = [rest[group] for group in speed_groups(rpm[rest], width_rpm=width)] if len(rest) else []
    return sorted([*held, *steps], key=lambda group: float(np.nan_to_num(rpm[group].mean(), nan=np.inf)))


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


def _allow_leaks(made: dict[str, Floats], column: int, keys: list[_Key]) -> None:
    """Lower the lower ends of one-third octaves by what the strongest of their channel may leave in them."""
    third = np.array([key[3] != "broad band" for key in keys])
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
    variance = float(inside @ inside) / freedom * _inflation(inside, which)
    error = math.sqrt(variance / count)
    if len(names) > 1 and variance > 0.0:
        between = float(np.sum(sizes * (means - values.mean()) ** 2)) / (len(names) - 1)
        if special.fdtrc(len(names) - 1, freedom, between / variance) < NUMBERS.like_pieces_chance:
            return math.sqrt(between / count), len(names) - 1
    return error, freedom


def _inflation(inside: Floats, which: Ints) -> float:
    """By how much the variance of a mean grows because neighbouring pieces go together: (1 + r) / (1 - r)."""
    power = float(inside @ inside)
    if power == 0.0 or len(inside) < 3:
        return 1.0
    beside = which[1:] == which[:-1]
    shared = float(inside[1:][beside] @ inside[:-1][beside]) / power
    shared = min(max(shared, NUMBERS.least_shared), NUMBERS.most_shared)
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
        result.coords[name] = ("level", values, {"units": "1", "long_name": _LEVEL_TEXTS[name]})
    reached, size = dict[_Key, float](), dict[_Key, float]()
    for item in items:
        pairs = zip(item["reached_frequency"].values.tolist(), item["si_per_unit"].values.tolist(), strict=True)
        for key, (hertz, si) in zip(_keys(item), pairs, strict=True):
            reached[key], size[key] = min(hertz, reached.get(key, math.inf)), si
    result.coords["si_per_unit"] = ("level", np.array([size[key] for key in keys], dtype=np.float64), _SI)
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
