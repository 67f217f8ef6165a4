"""Squared envelopes of the bands of a tree, by even crank angle: from blocks of a record of any length."""

from __future__ import annotations

import threading
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from crankorder.fft.plans import Plan, forward, inverse
from crankorder.quantities import Floats, Ints

BLOCK_SAMPLES = 51_200
"""Samples transformed at a time: they and their spectrum stay in the second-level cache. Made of 2, 3 and 5: of such a
length a planned transform takes two thirds of the time per sample of one of a power of two."""

GUARD_SAMPLES = 1024
"""Samples at each end of a block that are computed and not used: there the bands' filters see what is not there."""

TREE_LEVELS = (1, 2, 4, 8, 16)
"""Into how many equal bands the usable range is cut, level by level."""

TAPER_SHARE = 0.1
"""Share of a band at each of its ends over which it fades: a sharp edge would ring longer than the guard."""

HIGHEST_SHARE = 0.49
"""Of the sampling rate, up to which bands reach."""

TONE_BINS, TONE_EVERY, TONE_RATIO = 256, 4, 5.0
"""Bins of a block's spectrum of which the median of each fourth is its level there, and the multiple of it above which
a line is a tone: of noise one bin in 1e5 is."""

ROWS = 16
"""Bands of a level that are transformed at a time: they and their envelopes stay in the second-level cache."""

MOST_PLANS = 24
"""Plans of inverse transforms that a thread keeps: enough for four record layouts."""

_of_thread = threading.local()


class Band(NamedTuple):
    """A band of demodulation in Hz and the level of the tree to which it belongs (bands that the range is cut into)."""

    low_hz: float
    high_hz: float
    level: int


Bands = tuple[Band, ...]


class Envelopes(NamedTuple):
    """Mean squared envelopes of the bands by crank angle: ``squared`` (bands, angles), in multiples of ``unit``.

    ``rate_hz`` is the sample rate of the envelope, which holds from each sample to the next. Each row of ``bad``
    (gaps, 2) is the first sample and the one after the last that a gap reaches, filters included.
    """

    squared: NDArray[np.float32]
    rate_hz: float
    unit: float
    bad: Ints


class Blocks(NamedTuple):
    """``spectra`` (blocks, bins) of the blocks of a signal; each block gives the samples from its ``firsts`` on.

    The squares of ``spectra`` are multiples of ``unit``; ``bad`` (gaps, 2) is that of :class:`Envelopes`.
    """

    firsts: range
    spectra: NDArray[np.complex64]
    unit: float
    bad: Ints


def band_tree(low_hz: float, high_hz: float, *, least_width_hz: float) -> tuple[Band, ...]:
    """Bands between ``low_hz`` and ``high_hz``, cut into 1, 2, 4, 8, 16 equal ones as long as they stay wide enough.

    A band narrower than ``least_width_hz`` cannot follow the highest order of its envelope; the result is empty where
    even the whole range is narrower. Among the narrowest bands one more begins in the middle of each, so that a
    resonance at a border lies in the middle of a band.
    Source: J. Antoni (2007), Mechanical Systems and Signal Processing 21, p. 108 (binary tree).
    """
    levels = [level for level in TREE_LEVELS if high_hz - low_hz >= level * least_width_hz > 0.0]
    bands = []
    for level in levels:
        width, parts = (high_hz - low_hz) / level, 2 if level == levels[-1] else 1
        begins = [low_hz + k / parts * width for k in range(parts * (level - 1) + 1)]
        bands += [Band(begin, begin + width, level) for begin in begins]
    return tuple(bands)


def block_spectra(signal: NDArray[np.floating], *, begin: float, end: float) -> Blocks:
    """Spectra of the overlapping blocks of ``signal`` (samples,) from the sample ``begin`` to the sample ``end``.

    ``begin`` and ``end`` are sample numbers, with fractions.
    """
    # plan of this thread for the transform of a block of real samples
    if "forward" not in _of_thread.__dict__:
        _of_thread.forward = forward((BLOCK_SAMPLES,), np.float32)
    plan: Plan = _of_thread.forward
    hop = BLOCK_SAMPLES - 2 * GUARD_SAMPLES
    firsts = range(int(begin) // hop * hop, int(np.ceil(end)) + 1, hop)
    made = np.empty((len(firsts), BLOCK_SAMPLES // 2 + 1), dtype=np.complex64)
    scale, bad = 0.0, []
    for row, first in zip(made, firsts, strict=True):
        at = max(first - GUARD_SAMPLES, 0)
        piece, gaps = _centred(signal[at : first - GUARD_SAMPLES + BLOCK_SAMPLES])
        if len(gaps):
            bad.append(gaps + at)
        if not scale and (size := float(np.abs(piece).max(initial=0.0))):
            scale = float(2.0 ** -np.round(np.log2(size)))  # a power of two that brings it to about 1
        begins = at - (first - GUARD_SAMPLES)
        plan.input_array[:begins] = plan.input_array[begins + len(piece) :] = 0.0
        np.multiply(piece, scale, out=plan.input_array[begins : begins + len(piece)], casting="same_kind")
        plan.execute()
        row[:] = plan.output_array
    gaps = np.concatenate(bad) if bad else np.zeros((0, 2), dtype=np.int64)
    return Blocks(firsts, made, (scale or 1.0) ** -2, gaps)


def without_tones(spectrum: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """``spectrum`` (bins,) of a block with no line higher than ``TONE_RATIO`` times the median of the bins about it.

    Two steady tones in one band, such as those of a mesh and of the mains, beat in its envelope as strikes do; strikes
    whose intervals wander have no such lines. Source: P. Borghesani et al. (2013), Mechanical Systems and Signal
    Processing 36, p. 370 (all magnitudes made equal); here only what stands out is lowered.
    """
    size = np.abs(spectrum)
    pieces = size[: len(size) // TONE_BINS * TONE_BINS].reshape(-1, TONE_BINS)
    limit = np.maximum(TONE_RATIO * middles(pieces[:, ::TONE_EVERY]), np.finfo(np.float32).tiny)
    made, held = spectrum.copy(), np.flatnonzero(pieces.max(axis=1) > limit)
    made[: pieces.size].reshape(pieces.shape)[held] *= limit[held, None] / np.maximum(pieces[held], limit[held, None])
    return made


def envelopes_of(
    blocks: Blocks, *, rate_hz: float, bands: tuple[Band, ...], edges: Floats, reach_hz: float, toneless: bool = False
) -> Envelopes:
    """Mean squared envelopes (bands, angles) of ``bands`` between neighbouring ``edges``.

    The envelope is that of the analytic signal of the band, as a staircase of ``rate_hz``; its mean over each step is
    exact. A line of it at the frequency f thus loses sinc(f / rate_hz) sinc(order / steps per revolution).

    Parameters
    ----------
    blocks : blocks of the signal, from the first of the edges to the last
    rate_hz : samples per second
    bands : bands of one level of :func:`band_tree`: equally wide and equally spaced
    edges : (angles + 1,), increasing positions in samples (with fractions) where the steps of crank angle end
    reach_hz : highest frequency of the envelope that must be free of aliases
    toneless : whether tones are removed first by :func:`without_tones`
    """
    squared = np.zeros((len(bands), len(edges) - 1), dtype=np.float32)
    hop = BLOCK_SAMPLES - 2 * GUARD_SAMPLES
    low, apart, taper, n_out = _slices(bands, rate_hz, reach_hz=reach_hz)
    plans: dict[tuple[int, int], Plan] = _of_thread.__dict__.setdefault("plans", {})
    shape = min(len(bands), ROWS), n_out
    if shape not in plans:
        if len(plans) >= MOST_PLANS:
            plans.clear()
        plans[shape] = inverse(shape, np.complex64)
    plan, ratio = plans[shape], n_out / BLOCK_SAMPLES
    slices, waves = plan.input_array.view(np.float32), plan.output_array.view(np.float32)
    # the inverse is a plain sum; the analytic signal is twice the sum over the block's length
    weight = np.float32((2.0 / BLOCK_SAMPLES) ** 2 / ratio)
    for first, spectrum in zip(blocks.firsts, blocks.spectra, strict=True):
        begin, end = edges.searchsorted((first, first + hop)).tolist()
        steps = slice(max(begin - 1, 0), min(end, len(edges) - 1))
        if steps.stop <= steps.start:
            continue
        local = edges[steps.start : steps.stop + 1] - (first - GUARD_SAMPLES)
        local[0], local[-1] = max(local[0], GUARD_SAMPLES), min(local[-1], GUARD_SAMPLES + hop)
        places = local * ratio + 0.5
        if toneless:
            spectrum = without_tones(spectrum)
        for row in range(0, len(bands), ROWS):
            count, width, at = min(ROWS, len(bands) - row), len(taper), low + row * apart
            parts = np.ndarray((count, width), np.float32, buffer=spectrum, offset=8 * at, strides=(8 * apart, 4))
            np.multiply(parts, taper, out=slices[:count, :width])
            slices[:, width:] = 0.0
            plan.execute()
            _gather(waves[:count], places, weight, squared, row, steps.start)
    squared /= np.diff(edges).astype(np.float32)
    return Envelopes(squared, n_out * rate_hz / BLOCK_SAMPLES, blocks.unit, blocks.bad)


@lru_cache(maxsize=16)
def _slices(bands: tuple[Band, ...], rate_hz: float, *, reach_hz: float) -> tuple[int, int, NDArray[np.float32], int]:
    """First bin of the first of ``bands`` in a block, how many bins they are apart, what their bins are taken times.

    That twice each, for real and imaginary parts. Then the samples of an envelope: what folds in a squared envelope
    sampled at the rate r lies above r less the band's width: r leaves ``reach_hz``.
    """
    per_hz = BLOCK_SAMPLES / rate_hz
    low, spaces = round(bands[0].low_hz * per_hz), len(bands) - 1
    apart = int((bands[-1].low_hz - bands[0].low_hz) * per_hz / max(spaces, 1))
    width = int((bands[0].high_hz - bands[0].low_hz) * per_hz)
    width = min(width, BLOCK_SAMPLES // 2 + 1 - low - spaces * apart)
    fade = max(int(TAPER_SHARE * width), 1)
    edge = 0.5 - 0.5 * np.cos(np.pi * (np.arange(fade) + 0.5) / fade)
    taper = np.concatenate([edge, np.ones(width - 2 * fade), edge[::-1]]).astype(np.float32)
    return low, apart, np.repeat(taper, 2), _size_from(width + int(np.ceil(reach_hz * per_hz)))


def _size_from(least: int) -> int:
    """Next power of two, or 10 or 12 eighths of one, from ``least`` on: few fast sizes, so that plans serve again."""
    power = 1 << max(least - 1, 1).bit_length() >> 1
    return next(size for eighths in (8, 10, 12, 16) if (size := power * eighths // 8) >= least)


def _centred(piece: NDArray[np.floating]) -> tuple[NDArray[np.floating], Ints]:
    """``piece`` without its mean, zero where it has no number, and the first and last sample that each gap reaches.

    Single precision stays so; double stays until it is scaled, for small numbers would vanish and large ones overflow.
    """
    piece = np.asarray(piece, dtype=np.float32 if piece.dtype == np.float32 else np.float64)
    middle = float(piece.mean()) if len(piece) else 0.0
    if np.isfinite(middle):
        return piece - piece.dtype.type(middle), np.zeros((0, 2), dtype=np.int64)
    good = np.isfinite(piece)
    middle = float(piece[good].mean()) if good.any() else 0.0
    jumps = np.flatnonzero(np.diff(np.concatenate([[True], good, [True]]).astype(np.int8)))
    reach = jumps.reshape(-1, 2) + np.array([-GUARD_SAMPLES, GUARD_SAMPLES])
    return np.where(good, piece - piece.dtype.type(middle), piece.dtype.type(0.0)), reach


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _gather(waves, edges, weight, out, row, column):  # type: ignore[no-untyped-def]
    """Add to ``out`` from ``row`` and ``column`` on the integrals of |wave|² between ``edges``, times ``weight``.

    ``waves`` (bands, real and imaginary in turn) fill a row each, the spaces of the edges a column each; a sample
    holds from its place to the next. Two bands go side by side: neither waits for the other's sum. A slice of ``out``
    would be compiled twice: contiguous and not.
    """
    for band in range(0, waves.shape[0], 2):
        one, two = waves[band], waves[min(band + 1, waves.shape[0] - 1)]
        k = int(edges[0])
        here = one[2 * k] * one[2 * k] + one[2 * k + 1] * one[2 * k + 1]
        there = two[2 * k] * two[2 * k] + two[2 * k + 1] * two[2 * k + 1]
        total, other = np.float32(k - edges[0]) * here, np.float32(k - edges[0]) * there
        for step in range(len(edges) - 1):
            last = int(edges[step + 1])
            while k < last:
                total += here
                other += there
                k += 1
                here = one[2 * k] * one[2 * k] + one[2 * k + 1] * one[2 * k + 1]
                there = two[2 * k] * two[2 * k] + two[2 * k + 1] * two[2 * k + 1]
            rest = np.float32(edges[step + 1] - last)
            out[row + band, column + step] += weight * (total + rest * here)
            if band + 1 < waves.shape[0]:
                out[row + band + 1, column + step] += weight * (other + rest * there)
            total, other = -rest * here, -rest * there


def middles(pieces: NDArray[np.floating]) -> NDArray[np.floating]:
    """Medians (…,) of ``pieces`` (…, several) along the last axis; of many short ones a sort is the fastest way."""
    ordered = np.sort(pieces, axis=-1)
    half = ordered.shape[-1] // 2
    made: NDArray[np.floating] = ordered[..., half]
    return made if ordered.shape[-1] % 2 else (ordered[..., half - 1] + made) / 2
