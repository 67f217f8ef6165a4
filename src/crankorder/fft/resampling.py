"""Values of sampled signals between their samples, by the shortest kernel that errs no more than is allowed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.fft.kernels import MOST_TAPS, error_of, family_and_taps, kaiser_error, rounding, table_of
from crankorder.quantities import Floats

Signals = NDArray[np.floating]

TAPS = 48
"""Length of the kernel that is used where none is asked for."""

PASS_BAND = 0.4
"""Share of the sample rate up to which that kernel reproduces content: within 6e-8."""

LENGTHS = (8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 128, 160, 192, 256, 384, MOST_TAPS)
"""Lengths that :func:`cheapest_kernel` chooses from; every even one from 4 to 512 exists."""

FEWEST_SHARE = 0.5
"""A kernel needs more than this share of the length that Kaiser (1974) gives for a windowed sinc."""


@dataclass(frozen=True)
class Kernel:
    """An interpolation kernel: what a value between samples is made from.

    ``name`` is kaiser-N or sinc-N; ``taps`` the samples that enter a value. Content up to ``pass_band`` (share of the
    sample rate, above 0, below 0.5) comes out with a largest relative amplitude error of ``predicted_error``, in double
    precision if ``double``, else in single.
    """

    name: str
    taps: int
    pass_band: float
    predicted_error: float
    double: bool = True

    @property
    def margin(self) -> int:
        """Samples needed at each end of a signal, beyond the outermost positions."""
        return self.taps // 2 + 1


def _checked_share(share: float, what: str) -> float:
    if not 0.0 < share < 0.5:
        raise RequestError(
            f"{what} is a share of the sample rate, below its Nyquist frequency",
            found=share,
            allowed="above 0, below 0.5",
        )
    return float(share)


@lru_cache(maxsize=64)
def kernel_named(name: str, *, pass_band: float, double: bool = True) -> Kernel:
    """The kernel called ``name``, made for content up to ``pass_band``, with its predicted error.

    ``name`` is kaiser-N or sinc-N with an even N from 4 to 512 samples, ``pass_band`` a share of the sample rate (above
    0, below 0.5); ``double`` says in which precision the kernel will run. Raises RequestError for an unknown name or
    share.
    """
    family, taps = family_and_taps(name)
    if not family:
        allowed = f"kaiser-N and sinc-N with an even N from 4 to {MOST_TAPS}"
        raise RequestError("there is no such interpolation kernel", found=name, allowed=allowed)
    share = _checked_share(pass_band, "the pass band of a kernel")
    return Kernel(name, taps, share, error_of(family, taps, share, double), double)


def cheapest_kernel(tolerance: float, *, content: float, double: bool = True) -> Kernel:
    """The shortest kernel whose predicted error for content up to ``content`` is within ``tolerance``.

    ``tolerance`` is the relative amplitude error allowed (above 0), ``content`` a share of the sample rate (above 0,
    below 0.5), ``double`` the precision in which it will run. It is a windowed sinc, which leaves no image of what lies
    above the content but the one next to the Nyquist frequency. Raises RequestError where none meets the tolerance,
    saying what the best one reaches.
    """
    if not tolerance > 0.0:
        raise RequestError("a tolerance is a relative error", found=tolerance, allowed="above 0")
    share = _checked_share(content, "content")
    taps, least = _shortest(float(tolerance), share, double)
    if taps:
        return kernel_named(f"kaiser-{taps}", pass_band=share, double=double)
    lower = f"content further below half of the sample rate, now at {share:g} of it"
    remedy = f"Allow {least:.1e}, or {lower}" + ("." if double else ", or give float64 samples.")
    raise RequestError(
        "no interpolation kernel is as accurate as asked", found=f"{tolerance:g}", allowed=f"{least:.1e}", remedy=remedy
    )


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
        if hoped <= tolerance and (error := error_of("kaiser", taps, content, double)) <= tolerance:
            return taps, error
    return 0, error_of("kaiser", best, content, double)


def values_at(signals: Signals, positions: Floats, *, kernel: Kernel | None = None) -> Signals:
    """Values (channels, n) of ``signals`` (channels, samples), float32 or float64, at ``positions``, in their dtype.

    ``positions`` (n,) are in samples from the first, any order, as far from both ends as ``kernel``.margin. ``kernel``
    None is the least-squares kernel of 48 taps for content up to 0.4 of the sample rate. Positions are float64: one
    near p is exact to p · 1e-16, so give long records in blocks where 1e-9 matters.

    Raises RequestError where a position is not finite or lacks its neighbours, or where shapes do not fit.
    """
    samples = _samples(signals)
    places = np.ascontiguousarray(positions, dtype=np.float64)
    if places.ndim != 1:
        raise RequestError("positions are one row of numbers", found=f"{places.ndim} dimensions", allowed="1")
    double = bool(samples.dtype == np.float64)
    kernel = kernel or kernel_named(f"sinc-{TAPS}", pass_band=PASS_BAND, double=double)
    out = np.empty((len(samples), len(places)), dtype=samples.dtype)
    if not out.size:
        return out
    low, high = kernel.margin - 2, samples.shape[1] - kernel.margin
    if high < low:
        _refuse(places, 0, low, high)
    table = table_of(*family_and_taps(kernel.name), kernel.pass_band, double)
    bad = _weighted_sums(double)(*_flat(samples), places, table, np.empty(kernel.taps, samples.dtype), low, high, out)
    if bad >= 0:
        _refuse(places, bad, low, high)
    return out


def margin() -> int:
    """Samples at each end of a signal that serve only as neighbours of others, where no kernel is named."""
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


def _flat(samples: Signals) -> tuple[Signals, int]:
    """All channels as one row of memory, and the numbers from one to the next: a cut-out is not copied."""
    n_channels, n_samples = samples.shape
    row = samples.strides[0] // samples.itemsize if n_channels > 1 else n_samples
    length = (n_channels - 1) * row + n_samples
    return np.lib.stride_tricks.as_strided(samples, (length,), (samples.itemsize,), writeable=False), row


def _refuse(places: Floats, bad: int, low: float, high: float) -> None:
    """Raises RequestError: the position numbered ``bad`` lies outside ``low``…``high``."""
    found = f"{places[bad]:.6g} at number {bad}"
    if high < low:
        raise RequestError(
            "positions must lie in the record, with neighbours at both ends, and it is too short for any",
            found=found,
            remedy="Use a shorter kernel, or a longer record.",
        )
    raise RequestError(
        f"positions must lie in {low:g}…{high:g}, for a value needs its neighbours",
        found=found,
        remedy="Leave the kernel's margin at both ends, or use a shorter kernel.",
    )


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
    compiler: Any = nb.njit(signature, cache=True, nogil=True, fastmath={"contract"})
    compiled: Callable[..., int] = compiler(_sums_at)
    return compiled


def _sums_at(flat, row, positions, table, weights, low, high, out):  # type: ignore[no-untyped-def]
    """-1, or the first of ``positions`` outside ``low``…``high``; fills ``out`` (channels, positions).

    ``flat`` holds the channels ``row`` numbers apart, ``table`` (pieces, 4, taps) the kernel; ``weights`` (taps,) is
    scratch. Products are summed in eight rows side by side, which are added by halves.
    """
    n_pieces, _, taps = table.shape
    rows = np.empty(8, weights.dtype)
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
            rows[:] = 0.0
            for k in range(0, taps - 7, 8):
                for j in range(8):
                    rows[j] += weights[k + j] * segment[k + j]
            for k in range(taps // 8 * 8, taps):
                rows[k % 8] += weights[k] * segment[k]
            out[c, i] = ((rows[0] + rows[4]) + (rows[2] + rows[6])) + ((rows[1] + rows[5]) + (rows[3] + rows[7]))
    return -1
