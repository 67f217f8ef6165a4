"""Squared envelopes of the bands of a tree, by even crank angle: from blocks of a record of any length."""

from __future__ import annotations

import threading
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from crankorder.fft.plans import Plan, forward, inverse
from crankorder.quantities import Floats, Ints

BLOCK_SAMPLES = 65_536
"""Samples transformed at a time: they, their spectrum and the bands of one level stay in the second-level cache."""

GUARD_SAMPLES = 1024
"""Samples at each end of a block that are computed and not used: there the bands' filters see what is not there."""

TREE_LEVELS = (1, 2, 4, 8, 16)
"""Into how many equal bands the usable range is cut, level by level."""

TAPER_SHARE = 0.1
"""Share of a band at each of its ends over which it fades: a sharp edge would ring longer than the guard."""

HIGHEST_SHARE = 0.49
"""Of the sampling rate, up to which bands reach."""

TONE_BINS, TONE_RATIO = 256, 5.0
"""Bins of a block's spectrum whose median is its level there, and the multiple of it above which a line is a tone: of
noise one bin in 1e7 is."""

MOST_PLANS = 24
"""Plans of inverse transforms that a thread keeps: enough for four record layouts."""

_of_thread = threading.local()


class Band(NamedTuple):
    """A band of demodulation in Hz and the level of the tree to which it belongs (bands that the range is cut into)."""

    low_hz: float
    high_hz: float
    level: int


class Envelopes(NamedTuple):
    """Mean squared envelopes (bands, angles) of the bands by crank angle, as multiples of ``unit``, and bad samples.

    ``rate_hz`` (bands,) is how often a second the envelope was known: it holds from each sample to the next. Each row
    of ``bad`` (k, 2) is the first sample and the one after the last that a gap reaches, filters included.
    """

    squared: NDArray[np.float32]
    rate_hz: Floats
    unit: float
    bad: Ints


class Blocks(NamedTuple):
    """Spectra (blocks, bins) of a signal's blocks, of which each gives the samples from its ``firsts`` on.

    ``unit`` is what their squares are multiples of; ``bad`` as in :class:`Envelopes`.
    """

    firsts: range
    spectra: NDArray[np.complex64]
    unit: float
    bad: Ints


def band_tree(low_hz: float, high_hz: float, *, least_width_hz: float) -> tuple[Band, ...]:
    """Bands between ``low_hz`` and ``high_hz``, cut into 1, 2, 4, 8, 16 equal ones as long as they stay wide enough.

    ``least_width_hz``: a narrower band cannot follow the highest order of its envelope. Empty where even the whole
    range is narrower. Source: J. Antoni (2007), Mechanical Systems and Signal Processing 21, p. 108 (binary tree).
    """
    bands = []
    for level in TREE_LEVELS:
        width = (high_hz - low_hz) / level
        if width >= least_width_hz > 0.0:
            bands += [Band(low_hz + k * width, low_hz + (k + 1) * width, level) for k in range(level)]
    return tuple(bands)


def between(bands: tuple[Band, ...]) -> tuple[Band, ...]:
    """Bands that begin half way up each of the neighbouring ``bands``: what rings at a border is in the middle here."""
    middles = [(band.low_hz + band.high_hz) / 2.0 for band in bands]
    return tuple(Band(low, high, bands[0].level) for low, high in pairwise(middles))


def block_spectra(signal: NDArray[np.floating], *, begin: float, end: float) -> Blocks:
    """Spectra of the overlapping blocks of ``signal`` (samples,) from the sample ``begin`` to the sample ``end``."""
    plan = _forward()
    hop = BLOCK_SAMPLES - 2 * GUARD_SAMPLES
    firsts = range(int(begin) // hop * hop, int(np.ceil(end)) + 1, hop)
    made = np.empty((len(firsts), BLOCK_SAMPLES // 2 + 1), dtype=np.complex64)
    scale, bad = 0.0, []
    for row, first in zip(made, firsts, strict=True):
        block, gap = _block(signal, first - GUARD_SAMPLES)
        if len(gap):
            bad.append(gap)
        scale = scale or _scale_of(block)
        np.multiply(block, block.dtype.type(scale), out=plan.input_array, casting="same_kind")
        plan.execute()
        row[:] = plan.output_array
    gaps = np.concatenate(bad) if bad else np.zeros((0, 2), dtype=np.int64)
    return Blocks(firsts, made, (scale or 1.0) ** -2, gaps)


def without_tones(blocks: Blocks) -> Blocks:
    """``blocks`` with no line higher than ``TONE_RATIO`` times the median of the bins about it.

    Two steady tones in one band, such as those of a mesh and of the mains, beat in its envelope as strikes do; strikes
    whose intervals wander have no such lines. Source: P. Borghesani et al. (2013), Mechanical Systems and Signal
    Processing 36, p. 370 (all magnitudes made equal); here only what stands out is lowered.
    """
    made = blocks.spectra.copy()
    whole = made.shape[1] // TONE_BINS * TONE_BINS
    for row in made:
        size = np.abs(row)
        middle = np.float32(TONE_RATIO) * middles(size[:whole].reshape(-1, TONE_BINS))
        limit = np.append(np.repeat(middle, TONE_BINS), np.full(len(size) - whole, middle[-1]))
        over = size > limit
        row[over] *= limit[over] / size[over]
    return blocks._replace(spectra=made)


def envelopes_of(
    blocks: Blocks, *, rate_hz: float, bands: tuple[Band, ...], edges: Floats, reach_hz: float
) -> Envelopes:
    """Mean of the squared envelope of each of ``bands`` between neighbouring ``edges``, of the signal squared.

    The envelope is that of the analytic signal of the band, as a staircase of ``rate_hz``; its mean over each step is
    exact. A line of it at the frequency f thus loses sinc(f / rate_hz) sinc(order / steps per revolution).

    Parameters
    ----------
    blocks : of the signal, from the first of the edges to the last
    rate_hz : samples per second
    bands : from :func:`band_tree`, level by level
    edges : (angles + 1,), increasing positions in samples (with fractions) where the steps of crank angle end
    reach_hz : highest frequency of the envelope that must be free of what folds
    """
    squared = np.zeros((len(bands), len(edges) - 1), dtype=np.float64)
    hop = BLOCK_SAMPLES - 2 * GUARD_SAMPLES
    levels = _levels(bands, rate_hz, reach_hz=reach_hz)
    for first, spectrum in zip(blocks.firsts, blocks.spectra, strict=True):
        begin, end = np.searchsorted(edges, [first, first + hop])
        steps = slice(max(int(begin) - 1, 0), min(int(end), len(edges) - 1))
        if steps.stop <= steps.start:
            continue
        local = np.clip(edges[steps.start : steps.stop + 1], first, first + hop) - (first - GUARD_SAMPLES)
        for rows, low, taper, n_out in levels:
            plan = _inverse(len(low), n_out)
            slices = plan.input_array
            slices[:, len(taper) :] = 0.0
            for into, at in zip(slices, low, strict=True):
                np.multiply(spectrum[at : at + len(taper)], taper, out=into[: len(taper)])
            plan.execute()
            ratio = n_out / BLOCK_SAMPLES
            # the inverse is a plain sum; the analytic signal is twice the sum over the block's length
            weight = np.float32((2.0 / BLOCK_SAMPLES) ** 2 / ratio)
            places = local * ratio + 0.5
            _gather(plan.output_array.view(np.float32), places, weight, squared, rows.start, steps.start)
    made = (squared / np.diff(edges)).astype(np.float32)
    rates = np.concatenate([np.full(len(low), n_out * rate_hz / BLOCK_SAMPLES) for _, low, _, n_out in levels])
    return Envelopes(made, rates, blocks.unit, blocks.bad)


def _levels(
    bands: tuple[Band, ...], rate_hz: float, *, reach_hz: float
) -> list[tuple[slice, Ints, NDArray[np.float32], int]]:
    """Of each level: its rows among ``bands``, the bands' first bins in a block, their taper, samples of an envelope.

    What folds in a squared envelope sampled at the rate r lies above r less the band's width: r leaves ``reach_hz``.
    """
    made, at = [], 0
    per_hz = BLOCK_SAMPLES / rate_hz
    while at < len(bands):
        count = sum(band.level == bands[at].level for band in bands)
        low = np.array([round(band.low_hz * per_hz) for band in bands[at : at + count]])
        width = int((bands[at].high_hz - bands[at].low_hz) * per_hz)
        width = min(width, BLOCK_SAMPLES // 2 + 1 - int(low[-1]))
        n_out = _size_from(width + int(np.ceil(reach_hz * per_hz)))
        fade = max(int(TAPER_SHARE * width), 1)
        edge = 0.5 - 0.5 * np.cos(np.pi * (np.arange(fade) + 0.5) / fade)
        taper = np.concatenate([edge, np.ones(width - 2 * fade), edge[::-1]]).astype(np.float32)
        made.append((slice(at, at + count), low, taper, n_out))
        at += count
    return made


def _size_from(least: int) -> int:
    """Next power of two, or 9, 10 or 12 eighths of one, from ``least`` on: few sizes, so that plans are used again."""
    power = 1 << max(least - 1, 1).bit_length() >> 1
    return next(size for eighths in (8, 9, 10, 12, 16) if (size := power * eighths // 8) >= least)


def _forward() -> Plan:
    """Plan of this thread for the transform of a block of real samples."""
    if "forward" not in _of_thread.__dict__:
        _of_thread.forward = forward((BLOCK_SAMPLES,), np.float32)
    plan: Plan = _of_thread.forward
    return plan


def _inverse(rows: int, n_out: int) -> Plan:
    """Plan of this thread for the inverse transforms of ``rows`` of ``n_out`` bins."""
    plans: dict[tuple[int, int], Plan] = _of_thread.__dict__.setdefault("plans", {})
    if (rows, n_out) not in plans:
        if len(plans) >= MOST_PLANS:
            plans.clear()
        plans[rows, n_out] = inverse((rows, n_out), np.complex64)
    return plans[rows, n_out]


def _block(signal: NDArray[np.floating], first: int) -> tuple[NDArray[Any], Ints]:
    """Samples of one block from ``first`` on, zero where there are none, and what a gap in it reaches.

    Single precision stays so; double stays until it is scaled, for small numbers would vanish and large ones overflow.
    """
    kind = np.float32 if signal.dtype == np.float32 else np.float64
    block: NDArray[Any] = np.zeros(BLOCK_SAMPLES, dtype=kind)
    none = np.zeros((0, 2), dtype=np.int64)
    begin, end = max(first, 0), min(first + BLOCK_SAMPLES, len(signal))
    if end <= begin:
        return block, none
    piece: NDArray[Any] = np.asarray(signal[begin:end], dtype=kind)
    middle = float(piece.mean(dtype=np.float64))
    if np.isfinite(middle):
        block[begin - first : end - first] = piece - piece.dtype.type(middle)
        return block, none
    good = np.isfinite(piece)
    middle = float(piece[good].mean()) if good.any() else 0.0
    block[begin - first : end - first] = np.where(good, piece - piece.dtype.type(middle), 0.0)
    jumps = np.flatnonzero(np.diff(np.concatenate([[True], good, [True]]).astype(np.int8)))
    return block, jumps.reshape(-1, 2) + begin + np.array([-GUARD_SAMPLES, GUARD_SAMPLES])


def _scale_of(block: NDArray[np.floating]) -> float:
    """Power of two that brings ``block`` to about 1; 0 where it is all zero."""
    size = float(np.abs(block).max())
    return 0.0 if size == 0.0 else float(2.0 ** -np.round(np.log2(size)))


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _gather(waves, edges, weight, out, row, column):  # type: ignore[no-untyped-def]
    """Add to ``out`` from ``row`` and ``column`` on the integrals of |wave|² between ``edges``, times ``weight``.

    ``waves`` (bands, real and imaginary in turn) fill a row each, the spaces of the edges a column each; a sample
    holds from its place to the next. A slice of ``out`` would be compiled twice: contiguous and not.
    """
    for band in range(waves.shape[0]):
        wave = waves[band]
        for step in range(len(edges) - 1):
            low, high = edges[step], edges[step + 1]
            first, last = int(low), int(high)
            inner = np.float32(0.0)
            for k in range(2 * first, 2 * last):
                inner += wave[k] * wave[k]
            left = wave[2 * first] * wave[2 * first] + wave[2 * first + 1] * wave[2 * first + 1]
            right = wave[2 * last] * wave[2 * last] + wave[2 * last + 1] * wave[2 * last + 1]
            total = inner - (low - first) * left + (high - last) * right
            out[row + band, column + step] += weight * total


def middles(pieces: NDArray[np.floating]) -> NDArray[np.floating]:
    """Medians of the last axis of ``pieces``; of such short ones, many at a time, a sort is the fastest way."""
    ordered = np.sort(pieces, axis=-1)
    half = ordered.shape[-1] // 2
    made: NDArray[np.floating] = ordered[..., half]
    return made if ordered.shape[-1] % 2 else (ordered[..., half - 1] + made) / 2
