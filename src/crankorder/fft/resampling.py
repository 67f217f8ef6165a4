"""Values of sampled signals between their samples, by the shortest kernel that errs no more than is allowed.

A kernel is a sinc of N samples under a Kaiser window; its weights are tables of cubics in the fraction of a sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.quantities import Floats, Ints
from crankorder.scratch import blocks, empty_like

ROUNDING_FLOOR = 1e-13
"""Error below which a finer table gains nothing: positions are rounded more coarsely than that."""

_NODES = 0.5 + 0.5 * np.array([-1.0, 1.0 - np.sqrt(2.0), np.sqrt(2.0) - 1.0, 1.0])
"""Where a cubic meets the weights inside its piece: the ends, so that pieces join, and two that level its error."""

CUBIC_ERROR = (3.0 - 2.0 * np.sqrt(2.0)) / 384.0
"""Largest error of such a cubic over fourth derivative times piece width to the fourth."""

ROUNDING = {True: 4e-16, False: 2.4e-7}
"""Largest error by rounding over the largest sample, of a kernel of few taps (double or not). Measured."""

ROUNDING_PER_ROOT_TAP = {True: 1e-16, False: 3e-8}
"""What it grows by with the square root of the number of taps."""

BETWEEN = 1.02
"""What the worst error may be larger than that at the places and frequencies where it is looked for."""


def kaiser_error(taps: int, pass_band: float) -> float:
    """Relative error that Kaiser (1974) expects of a windowed sinc of ``taps`` for content within ``pass_band``.

    ``pass_band`` is a share of the sample rate, 0 to 0.5.
    """
    return float(10.0 ** (-0.05 * (4.57 * np.pi * (1.0 - 2.0 * pass_band) * (taps - 1) + 7.95)))


def _windowed_weights(taps: int, pass_band: float, fraction: Floats) -> Floats:
    """Weights (fractions, ``taps``) of a sinc under a Kaiser window, which passes up to ``pass_band`` of the rate.

    Weights fitted to the band at each ``fraction`` (0…1) of a step alone would err a little less there, but these are
    smooth: of what lies above the band they leave one image, next to the Nyquist frequency, and no others.
    """
    decibel = max(-20.0 * np.log10(kaiser_error(taps, pass_band)), 22.0)
    beta = 0.1102 * (decibel - 8.7) if decibel > 50.0 else 0.5842 * (decibel - 21.0) ** 0.4 + 0.07886 * (decibel - 21.0)
    distance = _sample_offsets(taps) - fraction[:, None]
    bell = np.i0(beta * np.sqrt(np.clip(1.0 - (2.0 * distance / taps) ** 2, 0.0, None)))
    weights = np.where(distance == np.round(distance), distance == 0.0, np.sinc(distance) * bell)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _sample_offsets(taps: int) -> Ints:
    """Places (``taps``,) of the samples relative to the one at or before the position."""
    return np.arange(taps) - (taps // 2 - 1)


@lru_cache(maxsize=32)
def _pieces_of(taps: int, pass_band: float) -> Floats:
    """Cubics (pieces, 4, taps) of the kernel of so many ``taps`` for content up to ``pass_band`` of the rate.

    There are as many pieces as keep the error between their nodes below a quarter of the kernel's own.
    """
    allowed = max(4.0 * ROUNDING_FLOOR, kaiser_error(taps, pass_band)) / 4.0
    least = np.pi * (CUBIC_ERROR / allowed) ** 0.25
    n_pieces = max(8, 2 * int(np.ceil(0.5 * least)))
    fraction = ((np.arange(n_pieces // 2)[:, None] + _NODES) / n_pieces).ravel()
    half = _windowed_weights(taps, pass_band, fraction).reshape(n_pieces // 2, 4, -1)
    weights = np.concatenate([half, half[::-1, ::-1, ::-1]])
    coefficients = np.einsum("dn,pnt->pdt", np.linalg.inv(np.vander(_NODES, 4)), weights)
    # the cubic begins exactly on its first row: what is exact there stays so
    coefficients[:, 3] = weights[:, 0]
    return np.asarray(coefficients)


@lru_cache(maxsize=32)
def table_of(taps: int, pass_band: float, double: bool) -> NDArray[np.floating]:
    """Cubics (pieces, 4, taps), highest power first, of the weights over the fraction of a sample, piece by piece.

    ``taps`` and ``pass_band`` (share of the sample rate) name the kernel; ``double`` asks for float64 numbers, else
    float32. They sum exactly to 1 and 0, 0, 0, so that a constant stays the same.
    """
    dtype = np.float64 if double else np.float32
    pieces = _pieces_of(taps, pass_band)
    rounded = pieces.astype(dtype).astype(np.longdouble)
    lost = np.array([0.0, 0.0, 0.0, 1.0])[:, None] - rounded.sum(axis=2, keepdims=True)
    middle = pieces.shape[2] // 2
    near = slice(max(0, middle - 4), middle + 4)
    # into a small number near the middle, which is fine enough to take it up
    place = near.start + np.abs(rounded[:, :, near]).argmin(axis=2)[:, :, None]
    np.put_along_axis(rounded, place, np.take_along_axis(rounded, place, axis=2) + lost, axis=2)
    return np.ascontiguousarray(rounded.astype(dtype))


def rounding(taps: int, double: bool) -> float:
    """Error by rounding of a sum of ``taps`` samples, ``double`` or single, over the largest of them."""
    return ROUNDING[double] + ROUNDING_PER_ROOT_TAP[double] * float(taps**0.5)


@lru_cache(maxsize=256)
def error_of(taps: int, pass_band: float, double: bool) -> float:
    """Largest relative error of the kernel of so many ``taps`` for tones up to its ``pass_band``.

    It is the worst complex error over frequencies and places, of the table as it is read, and the rounding of sums in
    double precision if ``double``, else in single. ``pass_band`` is a share of the sample rate.
    """
    pieces = _pieces_of(taps, pass_band)
    n_pieces = len(pieces)
    # half a sample tells all; a long kernel affords fewer pieces; in each, the places where a cubic errs most
    chosen = np.unique(np.linspace(0, (n_pieces - 1) // 2, max(8, 1024 // taps)).astype(int))
    inside = np.array([0.0, 0.117, 0.5, 0.883])
    weights = np.einsum("up,cpt->cut", np.vander(inside, 4), pieces[chosen]).reshape(-1, taps)
    fraction = ((chosen[:, None] + inside) / n_pieces).ravel()
    frequency = pass_band * np.cos(np.linspace(0.0, 0.5 * np.pi, max(24, min(taps, 160)), endpoint=False))
    turn = 2j * np.pi * frequency[:, None]
    response = np.exp(turn * _sample_offsets(taps)) @ weights.T
    return BETWEEN * float(np.abs(response * np.exp(-turn * fraction) - 1.0).max()) + rounding(taps, double)


Signals = NDArray[np.floating]

TAPS = 48
"""Length of the kernel that is used where none is asked for."""

PASS_BAND = 0.4
"""Share of the sample rate up to which that kernel reproduces content: within 2e-7."""

LENGTHS = (8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 128, 160, 192, 256, 384, 512)
"""Lengths that :func:`cheapest_kernel` chooses from; the longest passes content up to 0.98 of the Nyquist frequency
within 1e-7. Every even one from 4 to 512 exists."""

FEWEST_SHARE = 0.5
"""A kernel needs more than this share of the length that Kaiser (1974) gives for a windowed sinc."""


class Kernel(NamedTuple):
    """An interpolation kernel for values between samples.

    ``taps`` is the number of samples that enter a value. Content up to ``pass_band`` (share of the sample rate, above
    0, below 0.5) comes out with a largest relative amplitude error of ``predicted_error``, in double precision if
    ``double``, else in single.
    """

    taps: int
    pass_band: float
    predicted_error: float
    double: bool = True

    @property
    def name(self) -> str:
        """Its window and length."""
        return f"kaiser-{self.taps}"

    @property
    def margin(self) -> int:
        """Samples needed at each end of a signal, beyond the outermost positions."""
        return self.taps // 2 + 1


@lru_cache(maxsize=64)
def kernel_of(taps: int, *, pass_band: float, double: bool = True) -> Kernel:
    """The kernel of so many ``taps`` (even, 4 to 512), made for content up to ``pass_band``, with its predicted error.

    ``pass_band`` is a share of the sample rate (above 0, below 0.5, else RequestError); ``double`` says in which
    precision the kernel will run.
    """
    if not 0.0 < pass_band < 0.5:
        problem = "the band of a kernel is a share of the sample rate, below its Nyquist frequency"
        raise RequestError(problem, found=pass_band, allowed="above 0, below 0.5")
    return Kernel(taps, float(pass_band), error_of(taps, float(pass_band), double), double)


def cheapest_kernel(tolerance: float, *, content: float, double: bool = True) -> Kernel:
    """The shortest kernel whose predicted error for content up to ``content`` is within ``tolerance``.

    ``tolerance`` is the relative amplitude error allowed (above 0), ``content`` a share of the sample rate (above 0,
    below 0.5), ``double`` the precision in which it will run. It is a windowed sinc, which leaves no image of what lies
    above the content but the one next to the Nyquist frequency. Raises RequestError where none meets the tolerance,
    saying what the best one reaches.
    """
    if not tolerance > 0.0:
        raise RequestError("a tolerance is a relative error", found=tolerance, allowed="above 0")
    share = kernel_of(LENGTHS[0], pass_band=content, double=double).pass_band
    taps, least = _shortest(float(tolerance), share, double)
    if taps:
        return kernel_of(taps, pass_band=share, double=double)
    lower = f"content further below half of the sample rate, now at {share:g} of it"
    remedy = f"Allow {least:.1e}, or {lower}" + ("." if double else ", or give float64 samples.")
    problem = "no interpolation kernel is as accurate as asked"
    raise RequestError(problem, found=f"{tolerance:g}", allowed=f"{least:.1e}", remedy=remedy)


@lru_cache(maxsize=256)
def _shortest(tolerance: float, content: float, double: bool) -> tuple[int, float]:
    """Length of the shortest kernel within ``tolerance`` and its error; 0 and the least error of all where none is."""
    finest = rounding(LENGTHS[0], double)
    if tolerance <= finest:
        return 0, _shortest(2.0 * finest, content, double)[1]
    best, least = LENGTHS[0], np.inf
    needed = (-20.0 * np.log10(tolerance) - 7.95) / (4.57 * np.pi * (1.0 - 2.0 * content))
    for taps in LENGTHS:
        if taps < FEWEST_SHARE * needed and taps != LENGTHS[-1]:
            continue
        # what has not been tabled is quick to judge
        hoped = 0.5 * kaiser_error(taps, content) + rounding(taps, double)
        if hoped < least:
            best, least = taps, hoped
        if hoped <= tolerance and (error := error_of(taps, content, double)) <= tolerance:
            return taps, error
    return 0, error_of(best, content, double)


def values_at(signals: Signals, positions: Floats, *, kernel: Kernel | None = None) -> Signals:
    """Values (channels, positions) of ``signals`` (channels, samples), float32 or float64, in their dtype.

    ``positions`` (positions,) are in samples from the first, in any sequence, at least ``kernel``.margin from both
    ends. ``kernel`` None is that of 48 taps for content up to 0.4 of the sample rate. Positions are float64: one near p
    is exact to p · 1e-16, so give long records in blocks where 1e-9 matters.

    Raises RequestError where a position is not finite or lacks its neighbours, or where shapes do not fit.
    """
    samples = _samples(signals)
    places = np.ascontiguousarray(positions, dtype=np.float64)
    if places.ndim != 1:
        raise RequestError("positions are one row of numbers", found=f"{places.ndim} dimensions", allowed="1")
    double = bool(samples.dtype == np.float64)
    kernel = kernel or kernel_of(TAPS, pass_band=PASS_BAND, double=double)
    out = np.empty((len(samples), len(places)), dtype=samples.dtype)
    if not out.size:
        return out
    low, high = kernel.margin - 2, samples.shape[1] - kernel.margin
    if high < low:
        _refuse(places, 0, low, high)
    table = table_of(kernel.taps, kernel.pass_band, double)
    # all channels as one row of memory, and the numbers from one to the next: a cut-out is not copied
    n_channels, n_samples = samples.shape
    row = samples.strides[0] // samples.itemsize if n_channels > 1 else n_samples
    length = ((n_channels - 1) * row + n_samples,)
    flat = np.lib.stride_tricks.as_strided(samples, length, (samples.itemsize,), writeable=False)
    bad = _weighted_sums(double)(flat, row, places, table, np.empty(kernel.taps, samples.dtype), low, high, out)
    if bad >= 0:
        _refuse(places, bad, low, high)
    return out


def shifted(signal: NDArray[Any], samples: float) -> Signals:
    """``signal`` (samples,) delayed by ``samples``, whole or not: its value k is ``signal`` at k - ``samples``.

    Content up to 0.4 of the sample rate is exact to 2e-7. NaN where the signal, or a neighbour that the kernel needs
    (24 samples to either side, none for a whole shift), is missing or lies beyond its ends. float32 stays float32.
    """
    row = signal if signal.dtype in (np.float32, np.float64) else signal.astype(np.float64)
    whole = math.ceil(samples)
    fraction = whole - samples
    half = TAPS // 2 if fraction else 0
    out = np.full_like(row, np.nan)
    weights = _windowed_weights(TAPS, PASS_BAND, np.array([fraction]))[0].astype(row.dtype) if half else np.ones(1)
    if row.size < weights.size:
        return out
    made = np.convolve(row, weights[::-1].astype(row.dtype), mode="valid")
    first = whole + max(half - 1, 0)
    begin, end = max(first, 0), min(first + made.size, row.size)
    if end > begin:
        out[begin:end] = made[begin - first : end - first]
    return out


def margin() -> int:
    """Samples at each end of a signal that serve only as neighbours of others, for the default kernel."""
    return TAPS // 2 + 1


def _samples(signals: Signals) -> Signals:
    """The signals as (channels, samples) of native float32 or float64, each channel contiguous."""
    samples = np.asarray(signals)
    if samples.ndim != 2:
        raise RequestError("signals are (channels, samples)", found=f"{samples.ndim} dimensions", allowed="2")
    samples = samples.astype(np.float32 if samples.dtype.str[1:] == "f4" else np.float64, copy=False)
    even = samples.shape[0] < 2 or (samples.strides[0] > 0 and samples.strides[0] % samples.itemsize == 0)
    whole = even and samples.strides[1] == samples.itemsize and samples.flags.aligned
    return samples if whole else np.ascontiguousarray(samples)


def _refuse(places: Floats, bad: int, low: float, high: float) -> None:
    """Raises RequestError: the position numbered ``bad`` lies outside ``low``…``high``."""
    problem = f"positions must lie in {low:g}…{high:g}, for a value needs its neighbours"
    remedy = "Leave the kernel's margin at both ends, or use a shorter kernel."
    if high < low:
        problem = "positions must lie in the record, with neighbours at both ends, and it is too short for any"
        remedy = "Use a shorter kernel, or a longer record."
    raise RequestError(problem, found=f"{places[bad]:.6g} at number {bad}", remedy=remedy)


@lru_cache(maxsize=2)
def _weighted_sums(double: bool) -> Callable[..., int]:
    """The compiled loop over positions for signals in float64 if ``double``, else float32.

    One signature each, whatever array comes: a read-only one must not cost another compilation.
    """
    number = nb.float64 if double else nb.float32
    signal, table = (nb.types.Array(number, n_dims, "C", readonly=True) for n_dims in (1, 3))
    positions = nb.types.Array(nb.float64, 1, "C", readonly=True)
    weights, out = (nb.types.Array(number, n_dims, "C") for n_dims in (1, 2))
    signature = nb.intp(signal, nb.intp, positions, table, weights, nb.float64, nb.float64, out)
    compiler: Any = nb.njit(signature, cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
    compiled: Callable[..., int] = compiler(_sums_at)
    return compiled


def _sums_at(flat, row, positions, table, weights, low, high, out):  # type: ignore[no-untyped-def]
    """-1, or the first of ``positions`` outside ``low``…``high``; fills ``out`` (channels, positions).

    ``flat`` holds the channels ``row`` numbers apart, ``table`` (pieces, 4, taps) the kernel; ``weights`` (taps,) is
    scratch.
    """
    n_pieces, _, taps = table.shape
    for i in range(len(positions)):
        position = positions[i]
        if not (low <= position <= high):
            return i
        base = int(position)
        place = (position - base) * n_pieces
        piece = min(int(place), n_pieces - 1)
        share = weights.dtype.type(place - piece)
        cubic = table[piece]
        for k in range(taps):
            weights[k] = ((cubic[0, k] * share + cubic[1, k]) * share + cubic[2, k]) * share + cubic[3, k]
        first = base - taps // 2 + 1
        for c in range(out.shape[0]):
            segment = flat[first + c * row : first + c * row + taps]
            total = weights[0] * segment[0]
            for k in range(1, taps):
                total += weights[k] * segment[k]
            out[c, i] = total
    return -1


PASS, STOP, REJECTION_DB = 0.46, 0.54, 100.0
"""Band of a signal that comes to a lower rate, where nothing is left (what folds stays above the band), as shares
of that rate, and how far."""


@lru_cache(maxsize=1)
def _kernel() -> Kernel:
    return cheapest_kernel(1e-6, content=0.45)


@lru_cache(maxsize=8)
def _low_pass(step: float) -> tuple[Floats, int]:
    """Taps of the low-pass before a rate ``step`` times lower, 1 or more, and of how many of its values one is made."""
    from scipy.signal import firwin, kaiserord

    if step == 1.0:
        return np.ones(1), 1
    count, beta = kaiserord(REJECTION_DB, 2.0 * (STOP - PASS) / step)
    return firwin(count | 1, (PASS + STOP) / step, window=("kaiser", beta)), max(1, int(step / 2.0))


def reach_of(step: float) -> int:
    """Samples to either side from which :func:`resampled` makes a value at a rate ``step`` (1 or more) times lower."""
    taps, down = _low_pass(step)
    return taps.size // 2 + (_kernel().margin + 1) * down


def resampled(row: NDArray[Any], begin: float, step: float, n_samples: int) -> NDArray[Any]:
    """``n_samples`` values of ``row`` (samples,), float32 or float64, one every ``step`` samples from ``begin`` on.

    ``step`` is 1 or more, ``begin`` a sample number with fractions. It needs :func:`reach_of` samples at either end; a
    value is NaN where a sample that it needs is missing.
    """
    from scipy.signal import upfirdn

    taps, down = _low_pass(step)
    out = empty_like(row, (n_samples,), row.dtype)
    for part in blocks(n_samples):
        places = begin + step * np.arange(part.start, part.stop)
        low = max(0, math.floor(places[0]) - reach_of(step))
        piece = row[low : math.ceil(places[-1]) + reach_of(step) + 1].astype(np.float64)
        filtered, at = upfirdn(taps, piece, down=down), (places - low + taps.size // 2) / down
        out[part] = values_at(filtered[None], at, kernel=_kernel())[0]
    return out
