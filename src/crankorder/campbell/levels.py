"""Overall level of a recording, and what of it lies above the band that orders and map look at."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.campbell.frames import frame_speeds
from crankorder.fft.transforms import FrameTransform
from crankorder.fft.windows import window_named
from crankorder.quantities import Floats, Ints, Variables, channel_coords, described
from crankorder.settings import CampbellSettings, OrderSettings

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


class Peak(NamedTuple):
    """The strongest line above the band: peak amplitude, frequency and the band's end there [Hz], order, speed [rpm].

    NaN is what is not known.
    """

    amplitude: float = 0.0
    frequency_hz: float = math.nan
    band_hz: float = math.nan
    order: float = math.nan
    speed_rpm: float = math.nan


def recording_levels(
    recording: xr.Dataset, shaft: xr.Dataset, *, orders: OrderSettings, campbell: CampbellSettings
) -> xr.Dataset:
    """RecordingLevels: root mean square of each channel, and what lies above the band of the orders and the map.

    ``recording`` is the full-band Recording, ``shaft`` its ShaftAngle. The band ends at ``orders.max_order`` times
    the speed or ``campbell.max_frequency_hz``, whichever is higher; by crank angle without a speed at
    ``max_order``. Power spectra of PIECES pieces spread over the recording (Hann window) tell which share of the
    mean square lies above it (``share_above``), and the strongest line there: a sharp peak LINE_RATIO over the
    floor about it that stays from piece to piece with its order, or where no speed is known its frequency. Its
    amplitude is that of a tone, right to some per cent where its frequency does not change. Pieces with missing
    samples count for nothing; where there is none, all is NaN.
    """
    signals = recording["signal"]
    by_angle = recording.attrs["domain"] == "crank_angle"
    n_samples = signals.shape[1]
    length = min(LENGTH, n_samples)
    count = PIECES if length > 2 * BLOCK else 0
    starts = np.unique(np.linspace(0, n_samples - length, count).astype(np.int64))
    rate, rpm = _rate_and_speeds(recording, shaft, starts, length)
    power = _power(signals.values, starts, length)
    bins = np.arange(power.shape[2], dtype=np.float64) * (rate / max(length, 1))
    per_rev = bool(by_angle and not np.isfinite(rpm).any())
    # where the band ends in each piece: in Hz, or in orders where the samples are per revolution
    limit = np.maximum(np.nan_to_num(orders.max_order * rpm / 60.0), campbell.max_frequency_hz)
    if per_rev:
        limit = np.full(len(rpm), orders.max_order)
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


def _rate_and_speeds(recording: xr.Dataset, shaft: xr.Dataset, starts: Ints, length: int) -> tuple[float, Floats]:
    """Samples per second (per revolution by crank angle without a speed) and the speed of each piece, NaN unknown."""
    if recording.attrs["domain"] == "crank_angle":
        per_rev, speed = float(recording.attrs["samples_per_rev"]), float(recording.attrs.get("speed_rpm", math.nan))
        known = math.isfinite(speed) and speed > 0.0
        return per_rev * speed / 60.0 if known else per_rev, np.full(len(starts), speed if known else math.nan)
    rate = float(recording.attrs["rate_hz"])
    if not shaft.attrs.get("has_shaft", 1) or not shaft["time"].size or not len(starts):
        return rate, np.full(len(starts), np.nan)
    rpm = frame_speeds(recording, shaft, starts, length, rate).mean_rpm
    return rate, np.where(rpm > 0.0, rpm, np.nan)


def _power(signals: NDArray[np.floating], starts: Ints, length: int) -> Floats:
    """Mean square (pieces, channels, bins) of the signals in each bin, without the mean of each piece."""
    if not len(starts):
        return np.full((0, len(signals), 1), np.nan)
    transform = FrameTransform(window_named("hann", length))
    pieces = np.stack([signals[:, start : start + length] for start in starts], axis=1)
    with np.errstate(invalid="ignore"):
        pieces = pieces - pieces.mean(axis=2, keepdims=True, dtype=np.float64).astype(pieces.dtype)
        size = np.abs(pieces).max(axis=2, keepdims=True)
        size[size == 0.0] = 1.0
        pieces /= size  # their squares stay in range
    power = transform.power(pieces.reshape(len(signals), -1), length * np.arange(len(starts)))
    made: Floats = power * np.square(size, dtype=np.float64) * (0.5 / transform.window.enbw_bins)
    return made.swapaxes(0, 1)


def _strongest(power: Floats, bins: Floats, limit: Floats, rpm: Floats, *, per_rev: bool) -> Peak:
    """The strongest line of a channel's ``power`` (pieces, bins) above the ``limit`` (pieces,) of each piece."""
    if power.shape[1] < BLOCK or not len(power):
        return Peak()
    at = _sharp(power, bins, limit)
    lobe = _lobe(power, *at.T)
    for piece, place in at[np.argsort(-lobe)][:TRIED].tolist():
        if _stays(power, piece, place, rpm):
            around = slice(place - LOBE_BINS, place + LOBE_BINS + 1)
            value = float(power[piece, around] @ bins[around] / power[piece, around].sum())
            speed = float(rpm[piece])
            hertz, order = (math.nan, value) if per_rev else (value, 60.0 * value / speed)
            band = math.nan if per_rev else float(limit[piece])
            size = math.sqrt(2.0 * float(_lobe(power, np.array(piece), np.array(place))))
            return Peak(size, hertz, band, order, speed)
    return Peak()


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
    sizes = []
    for other in others[(others >= 0) & (others < len(power))].tolist():
        middle = round(place * float(rpm[other] / rpm[piece])) if known else place
        if 0 < middle < power.shape[1] - 1:
            size = float(_lobe(power, np.array(other), np.arange(middle - 1, middle + 2)).max())
            if math.isfinite(size):  # a piece with a gap tells nothing
                sizes.append(size)
    return len(sizes) > 1 and min(sizes) >= STEADY * float(np.mean(sizes))


def _floors(mean: Floats, blocks: int) -> Floats:
    """Root (channel, block) of the middling bin of each of ``blocks`` of the ``mean`` power (channel, bin).

    Neither lines nor modes raise it. NaN where they are too short.
    """
    size = mean.shape[1] // blocks
    if blocks > 1 and size < BLOCK // 4:
        return np.full((len(mean), blocks), math.nan)
    return np.sqrt(np.median(mean[:, : blocks * size].reshape(len(mean), blocks, size), axis=2))


def _dataset(
    recording: xr.Dataset, mean: Floats, share: Floats, peaks: list[Peak], rate: float, band_hz: float
) -> xr.Dataset:
    lines = np.array(peaks, dtype=np.float64).reshape(len(mean), len(Peak._fields))
    floor = _floors(mean, 1)[:, 0]
    of_channels = (
        ("rms", np.sqrt(mean.sum(axis=1)), "see unit", "root mean square without the mean"),
        ("floor", floor, "see unit", "root of the middling bin of the power spectrum, which lines do not raise"),
        ("share_above", share, "1", "share of the mean square above the band looked at"),
        ("peak_above", lines[:, 0], "see unit", "peak amplitude of the strongest line above the band; 0 for none"),
        ("peak_frequency", lines[:, 1], "Hz", "its frequency"),
        ("peak_band", lines[:, 2], "Hz", "where the band ended at that speed"),
        ("peak_order", lines[:, 3], "1", "its order"),
        ("peak_speed", lines[:, 4], "min-1", "the speed there"),
    )
    variables: Variables = {
        name: described("channel", values, units, text) for name, values, units, text in of_channels
    }
    words = "root of the middling bin of each block of the power spectrum"
    variables["block_floor"] = described(("channel", "block"), _floors(mean, FLOOR_BLOCKS), "see unit", words)
    middle = 0.5 * rate * (np.arange(FLOOR_BLOCKS) + 0.5) / FLOOR_BLOCKS
    block = described("block", middle, "Hz", "middle of a block of the spectrum; per revolution by crank angle")
    attrs = {"recording": str(recording.attrs["recording"]), "band_hz": band_hz}
    return xr.Dataset(variables, coords={**channel_coords(recording), "block": block}, attrs=attrs)
