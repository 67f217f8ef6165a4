"""All orders on a grid at once from samples at uneven crank angles, by the non-uniform FFT of finufft."""

from __future__ import annotations

from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.fft.nonuniform import (
    ComplexArray,
    FloatArray,
    channel_scales,
    checked_samples,
    phase_of_whole_revs,
    weighted,
)
from crankorder.settings import LARGEST_TOLERANCE, LEAST_TOLERANCE

TOLERANCE_MARGIN = 5.0
"""finufft's own tolerance is so much less than what is asked for: measured, its error is up to 1.8 times its tolerance
of the weighted mean magnitude, which is 4/pi of the amplitude of a tone under a Hann window."""

OVERSAMPLING = 2.0
"""Of finufft's inner grid: what it needs below 1e-9; 1.25 was no faster here."""


@nb.njit(cache=True, nogil=True)
def _paired(signals, first, scale, mean, weights, out):  # type: ignore[no-untyped-def]
    """Weighted channels, two by two the real and imaginary parts of ``out`` (pairs, 2 x samples, real view)."""
    for c in range(signals.shape[0]):
        values = signals[c, first : first + weights.size]
        weighted(values, scale[c], mean[c], weights, out[c // 2, c % 2 :: 2])
    if signals.shape[0] % 2:
        out[-1, 1::2] = 0.0


class OrderTransform:
    """Plan for spectra of ``n_orders`` orders 0, 1, 2… (cycles per turn) of ``n_channels`` signals, to ``tolerance``.

    Two real channels go as one complex through a type 1 transform (Barnett, Magland and af Klinteberg 2019); one plan
    serves frames of any number of samples. It belongs to one thread.
    """

    def __init__(self, *, n_orders: int, n_channels: int, tolerance: float) -> None:
        """Plan once; each call of :meth:`spectra` sets its own samples. Raises RequestError for what cannot be."""
        if not LEAST_TOLERANCE <= tolerance <= LARGEST_TOLERANCE:
            allowed = f"{LEAST_TOLERANCE:g}…{LARGEST_TOLERANCE:g}"
            raise RequestError("the tolerance of a transform is out of range", found=tolerance, allowed=allowed)
        if n_orders < 1 or n_channels < 1:
            raise RequestError("nothing to transform", found=f"{n_orders} orders, {n_channels} channels")
        self.n_orders, self.n_channels, self.tolerance = n_orders, n_channels, tolerance
        self._n_pairs = (n_channels + 1) // 2
        self._plan = _planned(2 * n_orders - 1, self._n_pairs, tolerance / TOLERANCE_MARGIN)
        # turns are counted from the middle of -pi…pi
        self._signs = np.where(np.arange(n_orders) % 2, -1.0, 1.0)

    def spectra(
        self,
        signals: NDArray[np.floating],
        weights: FloatArray,
        turns: FloatArray,
        *,
        first: int = 0,
        mean_spectrum: ComplexArray | None = None,
    ) -> ComplexArray:
        """Sums (channels, n_orders) of signal times weight times exp(-2 pi i order turn) over one frame.

        The error is at most the tolerance times the sum of |weight x signal|; with ``mean_spectrum`` of |weight x
        (signal - mean)|.

        Parameters
        ----------
        signals : (channels, samples), C-contiguous, float32 or float64
        weights, turns : (frame samples,), float64; a turn is one cycle of order 1. Fastest where turns grow from 0 to 1
        first : the frame's first sample among ``signals``
        mean_spectrum : (n_orders,), sums of the weights themselves times exp(…), where they are known exactly: the mean
            of each channel is then taken away first and put back after. None: nothing is.

        Returns NaN for a channel with a sample that is not finite.
        """
        n_channels, n_samples = len(signals), weights.size
        out = np.zeros((n_channels, self.n_orders), dtype=np.complex128)
        if n_samples == 0:
            return out
        exponent, mean = np.empty(n_channels, dtype=np.int64), np.empty(n_channels)
        channel_scales(signals, first, weights, mean_spectrum is not None, exponent, mean)
        finite = ~np.isnan(mean)
        pairs = np.empty((self._n_pairs, n_samples), dtype=np.complex128)
        scale = np.where(finite, 2.0 ** -exponent.astype(np.float64), 0.0)
        _paired(signals, first, scale, mean, weights, pairs.view(np.float64))
        if not finite.all():
            for c in np.flatnonzero(~finite):
                pairs.view(np.float64)[c // 2, c % 2 :: 2] = 0.0
        self._plan.setpts(2.0 * np.pi * (turns - 0.5))
        _separated(self._plan.execute(pairs if len(pairs) > 1 else pairs[0]).reshape(len(pairs), -1), out)
        out *= self._signs
        if mean_spectrum is not None:
            out += mean[:, None] * mean_spectrum
        out *= (2.0 ** exponent.astype(np.float64))[:, None]
        out[~finite] = np.nan
        return out


def _planned(n_modes: int, n_pairs: int, tolerance: float) -> Any:
    import finufft

    options = {"isign": -1, "nthreads": 1, "upsampfac": OVERSAMPLING, "dtype": "complex128"}
    return finufft.Plan(1, (n_modes,), n_trans=n_pairs, eps=tolerance, **options)


def _separated(both: ComplexArray, out: ComplexArray) -> None:
    """Spectra of the real channels from those of their pairs, orders -n…n."""
    n_orders, n_channels = out.shape[1], out.shape[0]
    positive, negative = both[:, n_orders - 1 :], both[:, n_orders - 1 :: -1].conj()
    out[0::2] = 0.5 * (positive + negative)
    if n_channels > 1:
        out[1::2] = (-0.5j * (positive - negative))[: n_channels // 2]


def order_spectrum_nufft(
    signals: NDArray[np.floating],
    weighted_window: FloatArray,
    angle_rev: FloatArray,
    *,
    orders_step: float,
    n_orders: int,
    tolerance: float,
) -> ComplexArray:
    """Complex amplitudes (channels, n_orders) at orders 0, orders_step, 2 orders_step…, phases from angle 0.

    The same sums as :func:`crankorder.fft.nonuniform.order_amplitudes_direct`, by the non-uniform FFT: within
    ``tolerance`` of the sum of |weight x signal|. A large mean counts there: take it away first.

    Parameters
    ----------
    signals : (channels, samples), float32 or float64
    weighted_window : (samples,), window times quadrature weight, as of ``hann_weights``
    angle_rev : (samples,), rev, float64
    orders_step : order, above 0: spacing of the orders
    n_orders : 1 or more
    tolerance : 1e-12…0.1

    Raises RequestError for shapes that do not match, an angle in single precision, or an argument out of range.
    """
    values, weights, angle = checked_samples(signals, weighted_window, angle_rev)
    if not (np.isfinite(orders_step) and orders_step > 0.0):
        raise RequestError("orders need a spacing above 0", found=orders_step)
    transform = OrderTransform(n_orders=n_orders, n_channels=len(values), tolerance=tolerance)
    if angle.size == 0:
        return np.zeros((len(values), n_orders), dtype=np.complex128)
    reference = np.rint(angle[angle.size // 2])
    turns = (angle - reference) * orders_step
    turns -= np.floor(turns)
    spectrum = transform.spectra(values, weights, turns)
    order = np.arange(n_orders, dtype=np.float64) * orders_step
    spectrum *= phase_of_whole_revs([reference], order)
    return spectrum
