"""Levels of one recording: by pieces in stated bands and one-third octaves; overall, and what lies above the band.

Sources: ISO 20816-1:2016 (broad-band root mean square velocity from 10 Hz to 1000 Hz); IEC 61260-1:2014 (base-ten
mid-band frequencies of one-third octaves).
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from crankorder.campbell.frames import piece_speeds, sample_rate_hz
from crankorder.fft.plans import Plan, fft_library, forward, inverse
from crankorder.fft.transforms import FrameTransform, band_gain, bridged, counted, derivative_gain, faded
from crankorder.fft.windows import hann
from crankorder.quantities import Floats, Ints, Variables, channel_coords, described
from crankorder.settings import DERIVATIVE, CampbellSettings, MethodNumbers, OrderSettings

Kind = Literal["broad band", "broad band without its ends", "broad band with its ends", "one-third octave"]

UNITS = {"acceleration": ("m/s2", 1.0), "velocity": ("mm/s", 1e-3), "displacement": ("µm", 1e-6)}
"""Unit in which a level of each quantity is told that was made of another, and its size in SI units."""

THIRD_OCTAVES_HZ = tuple(1000.0 * 10.0 ** (number / 10.0) for number in range(-20, 14))
"""Exact mid-band frequencies of the one-third octaves from 10 Hz to 20 kHz (IEC 61260-1, base ten)."""

_NOMINAL = (1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0)

HALF_THIRD_OCTAVE = 10.0**0.05
"""Upper end of a one-third octave over its middle."""

_STRETCH = 1 << 21
"""Samples that are transformed at once."""

_WIDE_HZ = 100.0
"""Width of a one-third octave above which a sample for each bandwidth will do: there are many in every piece."""

_of_thread = threading.local()

WITHOUT_ENDS: Final = "broad band without its ends"
WITH_ENDS: Final = "broad band with its ends"


NUMBERS = MethodNumbers("4-campbell-map.toml", "levels")


@dataclass(frozen=True)
class LevelBand:
    """A band of frequency [Hz] in which a level is told, and its quantity; "as measured" is that of the channel.

    Half of the power passes at either end of a broad band. ``without its ends`` the filter opens inside the band, so
    that nothing outside counts; ``with its ends`` it opens outside, so that all inside counts whole (of a sweep, at the
    louder end of each window).
    """

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

    @property
    def is_broad(self) -> bool:
        """Whether it is no one-third octave."""
        return self.band.kind != "one-third octave"

    @property
    def ends_hz(self) -> tuple[float, float]:
        """Where half of the power passes."""
        moved = 2.0 ** (NUMBERS.edge_octaves * {WITHOUT_ENDS: 1.0, WITH_ENDS: -1.0}.get(self.band.kind, 0.0))
        return self.band.low_hz * moved, self.high_hz / moved


@dataclass(frozen=True)
class _Pieces:
    """Pieces of a recording that are looked at: first samples and length of each, and the rate in Hz."""

    starts: Ints
    length: int
    rate_hz: float


def nominal_hz(middle_hz: float) -> float:
    """Nominal frequency [Hz] of the one-third octave about ``middle_hz``, above 0: 31.5 for 31.62 Hz."""
    tens = math.floor(math.log10(middle_hz) + 1e-6)
    return _NOMINAL[round(10.0 * (math.log10(middle_hz) - tens)) % 10] * 10.0**tens


def third_octaves() -> tuple[LevelBand, ...]:
    """The one-third octaves from 10 Hz to 20 kHz, of the measured quantity."""
    half = HALF_THIRD_OCTAVE
    return tuple(LevelBand("as measured", hz / half, hz * half, "one-third octave") for hz in THIRD_OCTAVES_HZ)


def limit_bands(quantity: str, low_hz: float, high_hz: float) -> tuple[LevelBand, ...]:
    """The three bands in which a limit on ``quantity`` from ``low_hz`` to ``high_hz`` (Hz) is judged.

    They are the band itself, and the band without and with the lines at its ends.
    """
    kinds: tuple[Kind, ...] = ("broad band", WITHOUT_ENDS, WITH_ENDS)
    return tuple(LevelBand(quantity, low_hz, high_hz, kind) for kind in kinds)


def level_frames(recording: xr.Dataset, shaft: xr.Dataset, *, bands: Sequence[LevelBand], frame_s: float) -> xr.Dataset:
    """LevelFrames of one recording: mean square (level, frame) and peak (level, frame) in each of ``bands``.

    Parameters
    ----------
    recording : the full-band Recording (channel, time or crank_angle); by crank angle it is taken as one at constant
        speed, without a speed it gives no frames
    shaft : its ShaftAngle (time)
    bands : bands and quantities; a level is one of them in one channel. One that a channel cannot give (the velocity
        of a pressure) is left out; one that the rate does not reach ends at rate / 2.56 (``reached_hz``)
    frame_s : length of the pieces in s; shorter ones are taken where the recording is short or the speed sweeps

    The signal is filtered in one transform of the whole recording, integrated or differentiated where the quantity
    asks for it, and the mean square of each piece is that of its samples: no window, no leakage. What lies within
    some periods of the band of either end is left out. Pieces that touch an unusable sample are NaN.
    """
    rate = sample_rate_hz(recording)
    levels = _levels(recording, bands, rate)
    n_samples = recording.sizes[recording["signal"].dims[1]]
    pieces = _pieces(n_samples, rate, levels, frame_s)
    rpm = piece_speeds(recording, shaft, pieces.starts, pieces.length, pieces.rate_hz)
    if len(rpm) > 1 and np.ptp(rpm) > NUMBERS.swept_share * rpm.mean():  # NaN is no sweep
        pieces = _pieces(n_samples, rate, levels, 0.0)
        rpm = piece_speeds(recording, shaft, pieces.starts, pieces.length, pieces.rate_hz)
    square, peak = _squares_and_peaks(recording["signal"].values, pieces, levels)
    names = recording["channel"].values.tolist()
    keys: list[LevelKey] = [
        (names[level.channel], level.unit, level.quantity, level.band.kind, level.band.low_hz, level.band.high_hz)
        for level in levels
    ]
    coords = level_coords(keys, [level.high_hz for level in levels], [level.si for level in levels])
    coords["speed"] = described("frame", rpm, "min-1", "mean speed of the piece")
    of_pieces, dims = "of the piece in the band", ("level", "frame")
    variables = {
        "mean_square": described(dims, square, "see unit, squared", f"mean square {of_pieces}"),
        "peak": described(dims, peak, "see unit", f"largest size {of_pieces}"),
    }
    attrs = {key: recording.attrs[key] for key in ("recording", "quality") if key in recording.attrs}
    attrs["frame_s"] = pieces.length / pieces.rate_hz if pieces.length else math.nan
    return xr.Dataset(variables, coords=coords, attrs=attrs)


def _levels(recording: xr.Dataset, bands: Sequence[LevelBand], rate_hz: float) -> list[_Level]:
    """The levels that the channels of ``recording`` can give."""
    levels: dict[tuple[int, LevelBand], _Level] = {}
    known = "si_per_unit" in recording.variables
    sizes = recording["si_per_unit"].values.tolist() if known else [math.nan] * recording.sizes["channel"]
    measured, units = recording["quantity"].values.tolist(), recording["unit"].values.tolist()
    for channel, (own, unit, size) in enumerate(zip(measured, units, sizes, strict=True)):
        for band in bands:
            wanted = own if band.quantity == "as measured" else band.quantity
            reached = min(band.high_hz, rate_hz / NUMBERS.rate_over_band)
            if not reached > band.low_hz or (band.kind == "one-third octave" and reached < band.high_hz):
                continue
            of_level, factor, times, si = unit, 1.0, 0, size
            if wanted != own:
                if wanted not in DERIVATIVE or own not in DERIVATIVE or not math.isfinite(size):
                    continue
                of_level, si = UNITS[wanted]
                factor, times = size / si, DERIVATIVE[wanted] - DERIVATIVE[own]
            level = _Level(channel, band, wanted, of_level, factor, times, reached, si)
            levels.setdefault((channel, replace(band, quantity=wanted)), level)
    return list(levels.values())


def _pieces(n_samples: int, rate_hz: float, levels: list[_Level], frame_s: float) -> _Pieces:
    """Pieces of ``frame_s``, shorter in a short recording, between its ends; none where nothing can be told."""
    broad = [level.band.low_hz for level in levels if level.is_broad]
    none = _Pieces(np.empty(0, dtype=np.int64), 0, rate_hz)
    if not broad or not math.isfinite(rate_hz):
        return none
    span, shortest = n_samples / rate_hz, NUMBERS.shortest_periods / min(broad)
    margin = min(NUMBERS.ring_periods / min(broad), NUMBERS.most_ring_share * span)
    usable = span - 2.0 * margin
    if usable < shortest:
        return none
    length_s = max(shortest, min(frame_s, 0.25 * usable))
    length, first = max(1, math.floor(length_s * rate_hz)), math.ceil(margin * rate_hz)
    count = max(1, math.floor((n_samples - 2 * first) / length))
    return _Pieces(first + length * np.arange(count, dtype=np.int64), min(length, n_samples), rate_hz)


def _squares_and_peaks(signals: NDArray[Any], pieces: _Pieces, levels: list[_Level]) -> tuple[Floats, Floats]:
    """Mean square and peak (levels, frames) of the ``signals`` (channels, samples), stretch by stretch."""
    count = len(pieces.starts)
    square, peak = np.full((2, len(levels), count), np.nan)
    if not count:
        return square, peak
    lowest = min((level.band.low_hz for level in levels), default=math.inf)
    margin = math.ceil(NUMBERS.ring_periods / lowest * pieces.rate_hz)
    together = max(1, (_STRETCH - 2 * margin) // max(pieces.length, 1))
    for begin in range(0, count, together):
        mine = pieces.starts[begin : begin + together]
        first = max(0, int(mine[0]) - margin) if begin else 0
        last = int(mine[-1]) + pieces.length + margin if begin + together < count else signals.shape[1]
        local = _Pieces(mine - first, pieces.length, pieces.rate_hz)
        for channel, part in enumerate(signals[:, first:last]):
            rows = [row for row, level in enumerate(levels) if level.channel == channel]
            if rows:
                values = _of_part(part, local, [levels[row] for row in rows], margin)
                square[rows, begin : begin + len(mine)], peak[rows, begin : begin + len(mine)] = values
    return square, peak


def _of_part(part: Any, pieces: _Pieces, levels: list[_Level], margin: int) -> Floats:
    """Mean square and peak (2, levels, frames) of a stretch of a channel, by one transform."""
    mean, count = float(part.mean()), fft.next_fast_len(len(part) + margin, real=True)
    spectrum = _spectrum(part, mean, pieces, count)
    square, peak = both = np.full((2, len(levels), len(pieces.starts)), np.nan)
    edges = (pieces.starts[:, None] + np.array([0, pieces.length])) / count
    octaves = [row for row, level in enumerate(levels) if not level.is_broad]
    if octaves:
        power = _octave_power(spectrum, count, pieces.rate_hz, [levels[row] for row in octaves])
        square[octaves] = _mean_squares(power, edges * power.shape[1])
    for row, level in enumerate(levels):
        if level.is_broad:
            filtered = _filtered(spectrum, count, pieces.rate_hz, level)
            square[row] = _mean_squares(filtered * filtered, edges * len(filtered))
        if level.band.kind == "broad band":
            ends = np.round(edges * len(filtered)).astype(np.int64)
            peak[row] = np.maximum.reduceat(np.append(np.abs(filtered), 0.0), ends.ravel())[::2]
    width = np.array([level.high_hz - level.band.low_hz for level in levels])
    span_s = len(pieces.starts) * pieces.length / pieces.rate_hz
    square[width * span_s < NUMBERS.fewest_bandwidths] = np.nan
    if not math.isfinite(mean):  # a piece that holds a missing sample tells nothing
        missing = counted(~np.isfinite(part)[None], pieces.starts, pieces.starts + pieces.length)[0]
        both[:, :, missing > 0] = np.nan
    return both


def _spectrum(part: Any, mean: float, pieces: _Pieces, count: int) -> NDArray[np.complexfloating]:
    """Spectrum of ``part`` less its ``mean`` with zeros behind it, ``count`` samples, faded beside the ``pieces``.

    Gaps are bridged. It holds until the next one is made: its plan owns it.
    """
    plan = _plan(forward, (count,), np.float32 if part.dtype == np.float32 else np.float64)
    filled, rest = plan.input_array[: len(part)], plan.input_array[len(part) :]
    if math.isfinite(mean):
        np.subtract(part, mean, out=filled)
    else:
        filled[:] = bridged(part)
    rest[:] = 0.0
    before, behind = int(pieces.starts[0]), max(0, len(part) - int(pieces.starts[-1]) - pieces.length)
    fade = _fade(before + behind, before, behind)
    filled[:before] *= fade[:before]
    filled[len(part) - behind :] *= fade[before:]
    plan.execute()
    return plan.output_array


def _plan(way: Callable[..., Plan], shape: tuple[int, ...], kind: Any) -> Plan:
    """The plan of this thread for transforms that ``way``; it keeps the last one of each."""
    kept: dict[Any, tuple[Any, Plan]] = _of_thread.__dict__
    key = (shape, kind, fft_library())
    if way not in kept or kept[way][0] != key:
        kept[way] = key, way(shape, kind)
    return kept[way][1]


_fade = lru_cache(maxsize=2)(faded)


def _band(whole: int, rate_hz: float, level: _Level, dtype: np.dtype[Any], scale: float) -> tuple[slice, NDArray[Any]]:
    """Bins and their gains, times ``scale``, of the band of ``level`` in a spectrum of ``whole`` samples."""
    half, (low_hz, high_hz) = NUMBERS.edge_octaves, level.ends_hz
    low = max(1, math.floor(low_hz * 2.0**-half / rate_hz * whole))
    last = min(whole // 2, math.ceil(high_hz * 2.0**half / rate_hz * whole)) + 1
    return slice(low, last), _gain(low, last, rate_hz / whole, level.ends_hz, scale * level.factor, level.times, dtype)


@lru_cache(maxsize=128)
def _gain(
    first: int, last: int, step_hz: float, ends_hz: tuple[float, float], factor: float, times: int, dtype: np.dtype[Any]
) -> NDArray[Any]:
    """Gain of a band at the bins from ``first`` to before ``last``, ``step_hz`` apart, times ``factor``.

    It is complex (bins,) where the level is an integral or a derivative, else one for each real and each imaginary part
    (2 bins,); in single precision for spectra of such ``dtype``.
    """
    frequency: Floats = np.arange(first, last, dtype=np.float64) * step_hz
    gain = band_gain(frequency, *ends_hz, half_octaves=NUMBERS.edge_octaves) * factor
    made = gain * derivative_gain(frequency, times) if times else np.repeat(gain, 2)
    return made.astype(dtype if times else dtype.char.lower())


def _filtered(spectrum: NDArray[np.complexfloating], whole: int, rate_hz: float, level: _Level) -> NDArray[Any]:
    """The signal in the broad band of ``level`` at a lower rate, from the ``spectrum`` of its ``whole`` samples."""
    bins, gain = _band(whole, rate_hz, level, spectrum.dtype, 1.0 / whole)
    n_out = fft.next_fast_len(max(2 * bins.stop, math.ceil(NUMBERS.oversampling * (bins.stop - 1))), real=True)
    made = np.zeros(n_out // 2 + 1, dtype=spectrum.dtype)
    np.multiply(spectrum[bins].view(gain.dtype), gain, out=made[bins].view(gain.dtype))
    return np.asarray(fft.irfft(made, n_out, overwrite_x=True, norm="forward"))


def _octave_power(
    spectrum: NDArray[np.complexfloating], whole: int, rate_hz: float, levels: list[_Level]
) -> NDArray[Any]:
    """Power (levels, times) of one-third octaves over time, from the ``spectrum`` of ``whole`` samples.

    It is that of the complex envelope at one rate for all; of a wide octave the sum of bands side by side that fill
    this rate.
    """
    size = 1 << math.ceil(math.log2(2.0 * _WIDE_HZ / rate_hz * whole))
    plan = _plan(inverse, (size,), spectrum.dtype)
    filled, parts = (array.view(spectrum.real.dtype) for array in (plan.input_array, plan.output_array))
    power = np.zeros((len(levels), 2 * size), dtype=parts.dtype)
    for into, level in zip(power, levels, strict=True):
        bins, gain = _band(whole, rate_hz, level, spectrum.dtype, math.sqrt(2.0) / whole)
        for begin in range(0, len(gain), 2 * size):
            inside = gain[begin : begin + 2 * size]
            np.multiply(spectrum[bins].view(gain.dtype)[begin : begin + 2 * size], inside, out=filled[: len(inside)])
            filled[len(inside) :] = 0.0
            plan.execute()
            np.multiply(parts, parts, out=parts)
            into += parts
    return np.asarray(power[:, ::2] + power[:, 1::2])


def _mean_squares(power: NDArray[Any], edges: Floats) -> Floats:
    """Mean (..., frames) of ``power`` (..., times) between the fractional ``edges`` (frames, 2)."""
    at = np.clip(edges, 0.0, power.shape[-1])
    whole = at.astype(np.int64)
    padded = np.concatenate([power, np.zeros((*power.shape[:-1], 1), dtype=power.dtype)], axis=-1)
    sums = np.add.reduceat(padded, whole.ravel(), axis=-1, dtype=np.float64)[..., ::2]
    sums = np.where(whole[:, 1] > whole[:, 0], sums, 0.0)
    parts = (at - whole) * padded[..., whole]
    return np.asarray((sums + parts[..., 1] - parts[..., 0]) / (at[:, 1] - at[:, 0]))


LevelKey = tuple[str, str, str, str, float, float]
"""Channel, unit, quantity, kind and both ends of the band in Hz of a level."""

LEVEL_COLUMNS = {
    "channel": ("1", "name of the channel"),
    "unit": ("1", "unit of the level"),
    "quantity": ("1", "what the level is of"),
    "kind": ("1", "broad band (for a limit also without and with its ends) or one-third octave"),
    "low_frequency": ("Hz", "lower end of the band"),
    "high_frequency": ("Hz", "upper end of the band"),
    "reached_frequency": ("Hz", "where the band ends as the rate allows"),
    "si_per_unit": ("1", "SI units in one unit of the level"),
}


def level_coords(keys: Sequence[LevelKey], reached_hz: ArrayLike, si: ArrayLike) -> Variables:
    """Coordinates (level,) of the levels of these ``keys``.

    ``reached_hz`` (levels,) are the frequencies [Hz] at which their bands end, ``si`` (levels,) the SI units in one
    unit of each.
    """
    columns = [*([key[place] for key in keys] for place in range(6)), reached_hz, si]
    return {
        name: described("level", np.array(column, dtype=np.str_ if place < 4 else np.float64), unit, text)
        for place, (column, (name, (unit, text))) in enumerate(zip(columns, LEVEL_COLUMNS.items(), strict=True))
    }


PIECES, LENGTH = 12, 8192
"""Pieces of a recording that are looked at, and samples of each: a look, not an analysis, so that it costs little."""

LOBE_BINS = 2
"""Bins on each side of a peak that hold a tone's energy with a Hann window."""

_LOBE = range(LOBE_BINS, -LOBE_BINS - 1, -1)

BLOCK = 64
"""Bins over whose median the floor about a line is taken."""

FLOOR_BLOCKS = 16
"""Blocks of the spectrum whose floors are told one by one: a resonance raises few of them, a gain all."""

LINE_RATIO = 100.0
"""Energy of a line over that of as many bins of the floor about it: in so few pieces noise does not reach it."""

RING_BINS = 8
"""Bins beside a line where it is gone, and a mode that noise makes ring is not."""

RING_PLACES = (RING_BINS, 13, 18)
"""Bins beside a line at one of which no sideband stands on either side: a mode's skirts fall there with the square."""

STEADY = 0.4
"""Of the mean power of a line over the pieces: in none it has less. Of noise in twelve, once in a hundred."""

HELD, FEWEST_ALIKE = 0.02, 4
"""Speeds within that share are alike; with fewer pieces of like speed the neighbours in time are asked."""

TRIED = 20
"""Highest peaks that are looked at."""


NO_LINE = (0.0, math.nan, math.nan, math.nan, math.nan)
"""No line above the band; else its peak amplitude, frequency and end of the band there [Hz], order, speed [rpm]."""


def recording_levels(
    recording: xr.Dataset, shaft: xr.Dataset, *, orders: OrderSettings, campbell: CampbellSettings
) -> xr.Dataset:
    """RecordingLevels (channel): root mean square, and its part above the band of the orders and of the Campbell map.

    ``recording`` is the full-band Recording, ``shaft`` its ShaftAngle. The band ends at ``orders.max_order`` times
    the speed or ``campbell.max_frequency_hz``, whichever is higher; by crank angle without a speed at
    ``max_order``. Power spectra of PIECES pieces spread over the recording (Hann window) tell which share of the
    mean square lies above it (``share_above``), and the strongest line there: a sharp peak LINE_RATIO over the
    floor about it that stays from piece to piece with its order, or where no speed is known its frequency. Its
    amplitude is that of a tone, right to some per cent where its frequency does not change. Pieces with missing
    samples count for nothing; where there is none, all is NaN.
    """
    signals = recording["signal"]
    n_samples = signals.shape[1]
    length = min(LENGTH, n_samples)
    count = PIECES if length > 2 * BLOCK else 0
    starts = np.unique(np.linspace(0, n_samples - length, count).astype(np.int64))
    rate = sample_rate_hz(recording)
    rpm = piece_speeds(recording, shaft, starts, length, rate)
    per_rev = not rate > 0.0  # by crank angle without a speed
    rate = float(recording.attrs["samples_per_rev"]) if per_rev else rate
    power = _power(signals.values, starts, length)
    bins = np.arange(power.shape[2], dtype=np.float64) * (rate / max(length, 1))
    # where the band ends in each piece: in Hz, or in orders where the samples are per revolution
    in_hz = np.maximum(np.nan_to_num(orders.max_order * rpm / 60.0), campbell.max_frequency_hz)
    limit = np.full(len(rpm), orders.max_order) if per_rev else in_hz
    above = bins >= limit[:, None]
    usable = np.isfinite(power).all(axis=2, keepdims=True)
    known = np.where(usable, power, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = known.sum(axis=0) / usable.sum(axis=0)
        share = (known @ above[:, :, None].astype(np.float64)).sum(axis=(0, 2)) / known.sum(axis=(0, 2))
    peaks = [_strongest(power[:, channel], bins, limit, rpm, per_rev=per_rev) for channel in range(len(mean))]
    ends = limit[np.isfinite(limit)]
    end = np.nan if per_rev or not ends.size else min(float(ends.max()), 0.5 * rate)
    return _dataset(recording, mean, share, peaks, rate, end)


def _power(signals: NDArray[np.floating], starts: Ints, length: int) -> Floats:
    """Mean square (pieces, channels, bins) of the signals in each bin, without the mean of each piece."""
    if not len(starts):
        return np.full((0, len(signals), 1), np.nan)
    transform = FrameTransform(hann(length))
    pieces = np.stack([signals[:, start : start + length] for start in starts], axis=1)
    with np.errstate(invalid="ignore"):
        pieces = pieces - pieces.mean(axis=2, keepdims=True, dtype=np.float64).astype(pieces.dtype)
        size = np.abs(pieces).max(axis=2, keepdims=True)
        size[size == 0.0] = 1.0
        pieces /= size  # their squares stay in range
    power = transform.power(pieces.reshape(len(signals), -1), length * np.arange(len(starts)))
    made: Floats = power * np.square(size, dtype=np.float64) * (0.5 / transform.window.enbw_bins)
    return made.swapaxes(0, 1)


def _strongest(power: Floats, bins: Floats, limit: Floats, rpm: Floats, *, per_rev: bool) -> tuple[float, ...]:
    """The strongest line of a channel's ``power`` (pieces, bins) above the ``limit`` (pieces,) of each piece."""
    if power.shape[1] < BLOCK or not len(power):
        return NO_LINE
    at = _sharp(power, bins, limit)
    lobe = _lobe(power, *at.T)
    for piece, place in at[np.argsort(-lobe)][:TRIED].tolist():
        if _stays(power, piece, place, rpm):
            around, speed = slice(place - LOBE_BINS, place + LOBE_BINS + 1), float(rpm[piece])
            value = float(power[piece, around] @ bins[around] / power[piece, around].sum())
            size = math.sqrt(2.0 * float(_lobe(power, np.array(piece), np.array(place))))
            if per_rev:
                return size, math.nan, math.nan, value, speed
            return size, value, float(limit[piece]), 60.0 * value / speed, speed
    return NO_LINE


def _sharp(power: Floats, bins: Floats, limit: Floats) -> Ints:
    """Pieces and bins (peaks, 2) of ``power`` above the ``limit`` of each piece that tower over floor and ring."""
    first = int(np.searchsorted(bins, limit.min())) // BLOCK
    last = power.shape[1] // BLOCK - 1
    blocks = power[:, first * BLOCK : (last + 1) * BLOCK].reshape(len(power), -1, BLOCK)
    if not blocks.size:
        return np.empty((0, 2), dtype=np.int64)
    top = blocks.max(axis=2)
    top[:, -1] = power[:, last * BLOCK :].max(axis=1)  # the rest at the end has the floor of the last block
    # a median costs most, and where fewer than half of a block lie that far below its peak, there is no line in it
    below = blocks <= (top * ((1.0 + 1e-9) * math.log(2.0) / LINE_RATIO))[:, :, None]
    piece, block = np.nonzero(np.count_nonzero(below, axis=2) >= BLOCK // 2)
    floor = np.median(blocks[piece, block], axis=1) / math.log(2.0)
    place = np.minimum((block[:, None] + first) * BLOCK + np.arange(2 * BLOCK), power.shape[1] - 1)
    ends = np.where(block + first == last, power.shape[1] - RING_BINS - LOBE_BINS, (block + first + 1) * BLOCK)
    pieces, floor = np.broadcast_to(piece[:, None], place.shape), np.broadcast_to(floor[:, None], place.shape)
    found = (place < ends[:, None]) & (power[pieces, place] * (1.0 + 1e-9) > LINE_RATIO * floor)
    pieces, place, floor = pieces[found], place[found], floor[found]
    lobe = _lobe(power, pieces, place)
    ring = _ring(power, pieces, place)
    clear = lobe > LINE_RATIO * np.maximum((2 * LOBE_BINS + 1) * floor, ring)
    clear &= bins[place] > limit[pieces] + bins[LOBE_BINS]
    clear &= bins[place] < bins[-RING_BINS - LOBE_BINS]
    beside = [power[pieces, (place + shift) % power.shape[1]] for shift in _LOBE]
    clear &= power[pieces, place] >= np.max(beside, axis=0)
    return np.stack([pieces[clear], place[clear]], axis=1)


def _ring(power: Floats, piece: Ints, place: Ints) -> Floats:
    """Energy that a mode at bin ``place`` of each ``piece`` of ``power`` would leave RING_BINS beside it, at most."""
    beside = [
        np.maximum(_lobe(power, piece, place - away), _lobe(power, piece, place + away)) * (away / RING_BINS) ** 2
        for away in RING_PLACES
    ]
    return np.asarray(np.min(beside, axis=0))


def _lobe(power: Floats, piece: Ints, place: Ints) -> Floats:
    """Energy of the lobe about bin ``place`` of each ``piece`` of ``power``; the axis of bins is a ring."""
    n = power.shape[1]
    return np.asarray(sum(power[piece, (place + shift) % n] for shift in _LOBE))


def _stays(power: Floats, piece: int, place: int, rpm: Floats) -> bool:
    """Whether a line at bin ``place`` of a ``piece`` is there in the others too, where its order or frequency puts it.

    Noise that makes a mode ring comes and goes from piece to piece, and stays at its frequency where the speed sweeps.
    """
    known = np.isfinite(rpm).all()
    alike = np.abs(rpm / rpm[piece] - 1.0) <= HELD if known else np.ones(len(power), dtype=bool)
    others = np.flatnonzero(alike)
    others = others if len(others) >= FEWEST_ALIKE else np.array([piece - 1, piece, piece + 1])
    others = others[(others >= 0) & (others < len(power))]
    middle = np.rint(place * (rpm[others] / rpm[piece])).astype(np.int64) if known else np.full(len(others), place)
    inside = (middle > 0) & (middle < power.shape[1] - 1)
    sizes = _lobe(power, others[inside, None], middle[inside, None] + np.arange(-1, 2)).max(axis=1)
    sizes = sizes[np.isfinite(sizes)]  # a piece with a gap tells nothing
    return len(sizes) > 1 and bool(sizes.min() >= STEADY * sizes.mean())


def _floors(mean: Floats, blocks: int) -> Floats:
    """Root (channel, block) of the middling bin of each of ``blocks`` of the ``mean`` power (channel, bin).

    Neither lines nor modes raise it. NaN where they are too short.
    """
    size = mean.shape[1] // blocks
    if blocks > 1 and size < BLOCK // 4:
        return np.full((len(mean), blocks), math.nan)
    return np.sqrt(np.median(mean[:, : blocks * size].reshape(len(mean), blocks, size), axis=2))


def _dataset(
    recording: xr.Dataset, mean: Floats, share: Floats, peaks: list[tuple[float, ...]], rate: float, band_hz: float
) -> xr.Dataset:
    size, hertz, band, order, speed = np.array(peaks, dtype=np.float64).reshape(len(mean), len(NO_LINE)).T
    middling = "root of the middling bin of the power spectrum, which lines do not raise"
    strongest = "peak amplitude of the strongest line above the band; 0 for none"
    variables: Variables = {
        "rms": described("channel", np.sqrt(mean.sum(axis=1)), "see unit", "root mean square without the mean"),
        "floor": described("channel", _floors(mean, 1)[:, 0], "see unit", middling),
        "share_above": described("channel", share, "1", "share of the mean square above the band looked at"),
        "peak_above": described("channel", size, "see unit", strongest),
        "peak_frequency": described("channel", hertz, "Hz", "its frequency"),
        "peak_band": described("channel", band, "Hz", "where the band ended at that speed"),
        "peak_order": described("channel", order, "1", "its order"),
        "peak_speed": described("channel", speed, "min-1", "the speed there"),
    }
    words = "root of the middling bin of each block of the power spectrum"
    variables["block_floor"] = described(("channel", "block"), _floors(mean, FLOOR_BLOCKS), "see unit", words)
    middle = 0.5 * rate * (np.arange(FLOOR_BLOCKS) + 0.5) / FLOOR_BLOCKS
    block = described("block", middle, "Hz", "middle of a block of the spectrum; per revolution by crank angle")
    attrs = {"recording": str(recording.attrs["recording"]), "band_hz": band_hz}
    return xr.Dataset(variables, coords={**channel_coords(recording), "block": block}, attrs=attrs)
