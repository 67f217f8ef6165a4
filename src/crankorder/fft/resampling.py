"""Values of sampled signals between their samples: kernels chosen by the error that is allowed, and their errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.fft.kernel_errors import cheapest, error_at
from crankorder.fft.kernel_sums import compiled
from crankorder.fft.kernel_tables import (
    FAMILIES,
    MOST_TAPS,
    SPLINE_POLES,
    family_and_number,
    low_pass_shape,
    padded_taps,
    spline_gain,
    table_of,
    taps_of,
)

Signals = NDArray[np.floating]

TAPS = 48
"""Length of the kernel that is used where none is asked for."""

PASS_BAND = 0.4
"""Share of the sample rate up to which that kernel reproduces content: within 6e-8."""

LENGTHS = (8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 128, 160, 192, 256, 384, MOST_TAPS)

KERNEL_NAMES = (
    *(f"{family}-{number}" for family, numbers in FAMILIES.items() for number in numbers),
    *(f"sinc-{taps}" for taps in LENGTHS),
)
"""Kernels that :func:`cheapest_kernel` chooses from; sinc-N exists for every even N from 4 to 512."""

SMOOTH_NAMES = tuple(f"kaiser-{taps}" for taps in LENGTHS)
"""Those it chooses from where content above the pass band must not come back: windowed sincs, for every even N too."""

SPLINE_REACH = {3: 28, 5: 44}
"""Samples after which the filter before a spline has forgotten where it began, to 1e-16 (pole to that power)."""


@dataclass(frozen=True)
class Kernel:
    """An interpolation kernel: what a value between samples is made from.

    ``name`` is one of KERNEL_NAMES, or sinc-N or kaiser-N; ``taps`` the samples that enter a value. Content up to
    ``pass_band`` (share of the sample rate, above 0, below 0.5) comes out with a largest relative amplitude error of
    ``predicted_error``, in double precision if ``double``, else in single.
    """

    name: str
    taps: int
    pass_band: float
    predicted_error: float
    double: bool = True

    @property
    def margin(self) -> int:
        """Samples needed at each end of a signal, beyond the outermost positions."""
        return self.margin_at(1.0)

    def margin_at(self, least_cut_off: float) -> int:
        """Samples needed at each end where ``least_cut_off`` (above 0, up to 1) is the lowest cut-off asked for."""
        family, number = family_and_number(self.name)
        reach = padded_taps(self.taps) // 2 + (SPLINE_REACH[number] if family == "bspline" else 0)
        if least_cut_off < 1.0:
            stretched = math.ceil(low_pass_shape(self.pass_band, self.predicted_error)[0] / least_cut_off)
            reach = max(reach, stretched)
        return reach + 1


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

    ``name`` is one of KERNEL_NAMES, or sinc-N or kaiser-N with an even N from 4 to 512. ``pass_band`` is a share of the
    sample rate (above 0, below 0.5): it shapes these two families, and states how far the error of the others holds.
    ``double`` says in which precision the kernel will run. Raises RequestError for an unknown name or share.
    """
    family, number = family_and_number(name)
    if not family:
        allowed = f"{', '.join(KERNEL_NAMES[:4])}, sinc-N and kaiser-N with an even N from 4 to {MOST_TAPS}"
        raise RequestError("there is no such interpolation kernel", found=name, allowed=allowed)
    share = _checked_share(pass_band, "the pass band of a kernel")
    error = error_at(family, number, share, share, double)
    return Kernel(name, taps_of(family, number), share, error, double)


def predicted_error(kernel: Kernel, content: float) -> float:
    """Largest relative amplitude error of ``kernel`` for content up to ``content`` (share of the sample rate, < 0.5).

    The worst complex error of the value of a tone, over all frequencies up to ``content`` and all places between two
    samples, of the very table that is used, and what rounding adds. Raises RequestError for another share.
    """
    family, number = family_and_number(kernel.name)
    return error_at(family, number, kernel.pass_band, _checked_share(content, "content"), kernel.double)


def cheapest_kernel(tolerance: float, *, content: float, double: bool = True, smooth: bool = False) -> Kernel:
    """The kernel that costs least of those whose predicted error for content up to ``content`` is within ``tolerance``.

    ``tolerance`` is the relative amplitude error allowed (above 0), ``content`` a share of the sample rate (above 0,
    below 0.5), ``double`` the precision in which it will run. ``smooth`` leaves no image of what lies above the content
    but the one next to the Nyquist frequency, for a signal that was not limited to its content before. Raises
    RequestError where none meets the tolerance, saying what the best one reaches.
    """
    if not tolerance > 0.0:
        raise RequestError("a tolerance is a relative error", found=tolerance, allowed="above 0")
    share = _checked_share(content, "content")
    name, least = cheapest(SMOOTH_NAMES if smooth else KERNEL_NAMES, float(tolerance), share, double)
    if name:
        return kernel_named(name, pass_band=share, double=double)
    lower = f"content further below half of the sample rate, now at {share:g} of it"
    remedy = f"Allow {least:.1e}, or {lower}" + ("." if double else ", or give float64 samples.")
    raise RequestError(
        "no interpolation kernel is as accurate as asked", found=f"{tolerance:g}", allowed=f"{least:.1e}", remedy=remedy
    )


def values_at(
    signals: Signals,
    positions: NDArray[np.float64],
    *,
    kernel: Kernel | None = None,
    cut_off: NDArray[np.float64] | None = None,
) -> Signals:
    """Values (channels, n) of ``signals`` (channels, samples), float32 or float64, at ``positions``, in their dtype.

    ``positions`` (n,) are in samples from the first, any order, as far from both ends as ``kernel``.margin. ``kernel``
    None is the least-squares kernel of 48 taps for content up to 0.4 of the sample rate. Positions are float64: one
    near p is exact to p · 1e-16, so give long records in blocks where 1e-9 matters.

    ``cut_off`` (n,), 0…1, is where a low-pass sits at each position, as share of the Nyquist frequency of the samples:
    against folding where the positions lie further apart than the samples. Content up to 2 · kernel.pass_band · cut_off
    of that frequency passes, beyond (2 - 2 · kernel.pass_band) · cut_off it is stopped, both within the kernel's error.

    Raises RequestError where a position is not finite or lacks its neighbours, or where shapes do not fit.
    """
    samples = _samples(signals)
    places = _numbers(positions, "positions")
    double = samples.dtype == np.float64
    kernel = kernel or kernel_named(f"sinc-{TAPS}", pass_band=PASS_BAND, double=bool(double))
    out = np.empty((len(samples), len(places)), dtype=samples.dtype)
    if cut_off is None:
        _interpolate(samples, places, kernel, out)
        return out
    limits = _numbers(cut_off, "cut_off")
    if limits.shape != places.shape:
        raise RequestError("every position has its cut-off", found=limits.shape, allowed=str(places.shape))
    slow = ~(limits >= 1.0)
    for chosen, fill in ((slow, _stretch), (~slow, _interpolate)):
        if chosen.any():
            part = np.empty((len(samples), int(chosen.sum())), dtype=samples.dtype)
            fill(samples, places[chosen], kernel, part, *([limits[chosen]] if fill is _stretch else []))
            out[:, chosen] = part
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


def _numbers(values: NDArray[np.float64], what: str) -> NDArray[np.float64]:
    numbers = np.ascontiguousarray(values, dtype=np.float64)
    if numbers.ndim != 1:
        raise RequestError(f"{what} are one row of numbers", found=f"{numbers.ndim} dimensions", allowed="1")
    return numbers


def _flat(samples: Signals) -> tuple[Signals, int]:
    """All channels as one row of memory, and the numbers from one to the next: a cut-out is not copied."""
    n_channels, n_samples = samples.shape
    row = samples.strides[0] // samples.itemsize if n_channels > 1 else n_samples
    length = (n_channels - 1) * row + n_samples
    return np.lib.stride_tricks.as_strided(samples, (length,), (samples.itemsize,), writeable=False), row


def _interpolate(samples: Signals, places: NDArray[np.float64], kernel: Kernel, out: Signals) -> None:
    if not out.size:
        return
    family, number = family_and_number(kernel.name)
    width, double = padded_taps(kernel.taps), samples.dtype == np.float64
    low, high = kernel.margin - 2, samples.shape[1] - kernel.margin
    if high < low:
        _refuse(places, 0, low, high)
    if family == "bspline":
        samples = _coefficients(samples, number)
    table = table_of(family, number, kernel.pass_band, double)
    weights = np.empty(width, dtype=samples.dtype)
    sums = compiled("weighted_sums", double)
    bad = sums(*_flat(samples), places, table, len(table) // (4 * width), weights, low, high, out)
    if bad >= 0:
        _refuse(places, bad, low, high)


def _coefficients(samples: Signals, degree: int) -> Signals:
    """Coefficients (channels, samples) of the splines of ``degree`` through the samples."""
    poles = SPLINE_POLES[degree]
    z1, z2 = (*poles, 0.0)[:2]
    coefficients = np.empty(samples.shape, dtype=samples.dtype)
    for signal, out in zip(samples, coefficients, strict=True):
        compiled("spline_coefficients", samples.dtype == np.float64)(signal, z1, z2, spline_gain(poles), out)
    return coefficients


def _stretch(
    samples: Signals, places: NDArray[np.float64], kernel: Kernel, out: Signals, cut_off: NDArray[np.float64]
) -> None:
    if not np.all(cut_off > 0.0):
        raise RequestError("a cut-off is a share of the Nyquist frequency", found=min(cut_off), allowed="above 0, to 1")
    reach, shape = low_pass_shape(kernel.pass_band, kernel.predicted_error)
    weights = np.empty(2 * math.ceil(reach / float(cut_off.min())) + 2, dtype=samples.dtype)
    sums = compiled("stretched_sums", samples.dtype == np.float64)
    bad = sums(*_flat(samples), places, cut_off, shape, reach, weights, samples.shape[1], out)
    if bad >= 0:
        needed = reach / cut_off[bad]
        _refuse(places, bad, math.floor(needed), samples.shape[1] - 1 - math.floor(needed))


def _refuse(places: NDArray[np.float64], bad: int, low: float, high: float) -> None:
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
