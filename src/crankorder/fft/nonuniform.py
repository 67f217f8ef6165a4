"""Order amplitudes straight from samples at uneven crank angles: phasors of a few orders, no resampled signal."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.errors import RequestError

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

BLOCK_SAMPLES = 512
"""Samples whose phasors are held at a time: they stay in the first cache."""

REASSOCIATED = {"reassoc", "contract", "nsz", "arcp"}
"""What a sum may do to vectorise; it still meets NaN and infinity, so that they show in the result."""

ROUND = 6755399441055744.0
"""1.5 x 2^52: added and taken away again it rounds to the nearest whole number."""

LARGEST_EXPONENT = 1020
"""Of the powers of two by which channels are scaled, and their inverses: all are normal numbers."""

SMALL_MEAN = 1e-3
"""A mean below this share of the mean magnitude does not change the scale of a channel."""

LARGEST_ANGLE_REV = 2.0**50
"""Angles beyond it have no quarter revolutions left in float64."""


@nb.njit(inline="always")
def sine_of_quarter(v):  # type: ignore[no-untyped-def]
    """Sine of ``v`` revolutions, -0.25 to 0.25: Chebyshev interpolant of sin(2 pi v)/v in v^2, right to 1e-16."""
    y = v * v
    high = 3.819928071447434 + y * (-0.7177339096880971 + y * 0.1008988524604525)
    middle = -76.70585975282324 + y * (42.05869392532184 + y * (-15.094641673380602 + y * high))
    return v * (6.283185307179586 + y * (-41.341702240399755 + y * (81.60524927607361 + y * middle)))


@nb.njit(cache=True, nogil=True, fastmath={"contract"})
def _phasors(turns, order, cosine, sine):  # type: ignore[no-untyped-def]
    """Cosine and sine of ``order`` times ``turns``, both folded exactly onto the sine of a quarter turn.

    The whole turns come from a product of their own, so that the one that counts becomes a fused multiply-add: exact.
    """
    nearly = order * (1.0 + 2.0**-40)
    for i in range(turns.size):
        whole = (turns[i] * nearly + ROUND) - ROUND
        u = turns[i] * order - whole
        away = abs(u)
        cosine[i] = sine_of_quarter(0.25 - away)
        sine[i] = np.copysign(sine_of_quarter(0.25 - abs(away - 0.25)), u)


@nb.njit(cache=True, nogil=True, fastmath=REASSOCIATED)
def _sums(values, cosine, sine):  # type: ignore[no-untyped-def]
    real, imaginary = 0.0, 0.0
    for i in range(values.size):
        real += values[i] * cosine[i]
        imaginary += values[i] * sine[i]
    return real, imaginary


@nb.njit(cache=True, nogil=True, fastmath=REASSOCIATED)
def weighted(values, scale, mean, weights, out):  # type: ignore[no-untyped-def]
    """Fills ``out`` with ``scale`` times ``values`` less ``mean``, times ``weights`` (samples,)."""
    for i in range(values.size):
        out[i] = (values[i] * scale - mean) * weights[i]


@nb.njit(cache=True, nogil=True, fastmath={"contract"})
def _less(values, reference, out):  # type: ignore[no-untyped-def]
    for i in range(values.size):
        out[i] = values[i] - reference


@nb.njit(cache=True, nogil=True)
def direct_sums(signals, first, scale, mean, weights, angle_rev, orders, turned, out):  # type: ignore[no-untyped-def]
    """Adds to ``out`` (channels, orders) the sums over ``weights`` (samples,) from sample ``first`` of ``signals``.

    Values enter as ``scale`` times them less ``mean`` (channels,). Each block counts its angle, of ``angle_rev``, from
    a whole revolution, which the phasors ``turned`` (blocks, orders) put back for each of the ``orders``.
    """
    n_channels, n_samples = signals.shape[0], weights.size
    values = np.empty((n_channels, BLOCK_SAMPLES))
    turns, cosine, sine = np.empty(BLOCK_SAMPLES), np.empty(BLOCK_SAMPLES), np.empty(BLOCK_SAMPLES)
    for block in range(turned.shape[0]):
        low = block * BLOCK_SAMPLES
        high = min(low + BLOCK_SAMPLES, n_samples)
        n = high - low
        _less(angle_rev[low:high], np.rint(angle_rev[low]), turns[:n])
        for c in range(n_channels):
            segment = signals[c, first + low : first + high]
            weighted(segment, scale[c], mean[c], weights[low:high], values[c, :n])
        for k in range(orders.size):
            _phasors(turns[:n], orders[k], cosine[:n], sine[:n])
            for c in range(n_channels):
                real, imaginary = _sums(values[c, :n], cosine[:n], sine[:n])
                out[c, k] += complex(real, -imaginary) * turned[block, k]


@nb.njit(cache=True, nogil=True, fastmath=REASSOCIATED)
def _magnitude(values, scale, mean, weights):  # type: ignore[no-untyped-def]
    """Sums of the weighted values, less ``mean`` after scaling, and of their magnitudes."""
    total, magnitude = 0.0, 0.0
    for i in range(values.size):
        value = (values[i] * scale - mean) * weights[i]
        total += value
        magnitude += abs(value)
    return total, magnitude


@nb.njit(cache=True, nogil=True)
def _exponent(magnitude):  # type: ignore[no-untyped-def]
    return min(max(math.frexp(magnitude)[1], -LARGEST_EXPONENT), LARGEST_EXPONENT)


@nb.njit(cache=True, nogil=True)
def channel_scales(signals, first, weights, remove_mean, exponent, mean):  # type: ignore[no-untyped-def]
    """Fills in each channel's ``exponent`` of two, which brings it near 1, and its ``mean`` once it is scaled so.

    They are those of the samples of ``signals`` from ``first`` on under ``weights`` (samples,). Means are 0 unless
    ``remove_mean``; then the scale is that of the signal without its mean, however much larger that is. A channel with
    a value that is not finite gets the mean NaN.
    """
    all_weights = np.abs(weights).sum()
    for c in range(signals.shape[0]):
        values = signals[c, first : first + weights.size]
        exponent[c], mean[c] = 0, 0.0
        total, magnitude = _magnitude(values, 1.0, 0.0, weights)
        if not np.isfinite(magnitude):
            mean[c] = np.nan
        if magnitude == 0.0 or not np.isfinite(magnitude):
            continue
        power = _exponent(magnitude / all_weights)
        scale = 2.0 ** float(-power)
        if abs(power) > LARGEST_EXPONENT // 2:
            # weighted values may have lost digits below the normal numbers
            total, magnitude = _magnitude(values, scale, 0.0, weights)
        else:
            total, magnitude = total * scale, magnitude * scale
        exponent[c] = power
        if not remove_mean:
            continue
        mean[c] = total / all_weights
        if abs(total) > SMALL_MEAN * magnitude:
            _, left = _magnitude(values, scale, mean[c], weights)
            finer = power if left == 0.0 else max(power + _exponent(left / all_weights), -LARGEST_EXPONENT)
            exponent[c], mean[c] = finer, mean[c] * 2.0 ** float(power - finer)


def order_amplitudes_direct(
    signals: NDArray[np.floating], weighted_window: FloatArray, angle_rev: FloatArray, *, orders: ArrayLike
) -> ComplexArray:
    """Complex amplitudes (channels, orders): the sum of signal times weight times exp(-2 pi i order angle).

    With the weights of :func:`hann_weights` their magnitude is a tone's peak and their phase counts from angle 0.
    Right to round-off at any angle: 1e-15 of the mean weighted magnitude, and what the angle's own digits allow.

    Parameters
    ----------
    signals : (channels, samples), float32 or float64; sums run in float64
    weighted_window : (samples,), window times quadrature weight
    angle_rev : (samples,), rev, float64: in single precision an angle of 1e4 rev is 1e-3 rev off
    orders : (orders,), cycles per revolution, any

    Raises RequestError for shapes that do not match, an angle in single precision or one beyond 2^50 rev. A sample that
    is not finite makes its channel NaN.
    """
    values, weights, angle = checked_samples(signals, weighted_window, angle_rev)
    wanted = np.atleast_1d(np.asarray(orders, dtype=np.float64))
    exponent, mean = np.empty(len(values), dtype=np.int64), np.empty(len(values))
    channel_scales(values, 0, weights, False, exponent, mean)
    return scaled_sums(values, 0, weights, angle, wanted, exponent, mean)


def scaled_sums(
    signals: NDArray[np.floating],
    first: int,
    weights: FloatArray,
    angle_rev: FloatArray,
    orders: FloatArray,
    exponent: NDArray[np.int64],
    mean: FloatArray,
) -> ComplexArray:
    """Sums (channels, orders) of :func:`order_amplitudes_direct` over a part of ``signals`` that is checked.

    The part begins at sample ``first`` and is as long as ``weights`` and ``angle_rev`` (samples,); ``orders`` are
    (orders,), ``exponent`` and ``mean`` (channels,) those of :func:`channel_scales`: the mean is left out.
    """
    out = np.zeros((len(signals), len(orders)), dtype=np.complex128)
    turned = phase_of_whole_revs(np.rint(angle_rev[::BLOCK_SAMPLES]), orders)
    scale = 2.0 ** -exponent.astype(np.float64)
    direct_sums(signals, first, scale, mean, weights, angle_rev, orders, turned, out)
    return np.asarray(out * (2.0 ** exponent.astype(np.float64))[:, None])


def phase_of_whole_revs(angle_rev: ArrayLike, orders: FloatArray) -> ComplexArray:
    """exp(-2 pi i order angle) (angles, orders) for ``angle_rev`` (angles,) and ``orders`` (orders,), however large.

    The product is taken with the digits that rounding cuts off (Dekker 1971), so that only its fraction counts.
    """
    angle, order = np.asarray(angle_rev, dtype=np.float64)[:, None], orders[None, :]
    product = angle * order
    angle_high, order_high = _upper_half(angle), _upper_half(order)
    angle_low, order_low = angle - angle_high, order - order_high
    cut_off = ((angle_high * order_high - product) + angle_high * order_low + angle_low * order_high) + (
        angle_low * order_low
    )
    return np.asarray(np.exp(-2j * np.pi * ((product - np.rint(product)) + cut_off)))


def _upper_half(values: FloatArray) -> FloatArray:
    """The upper 26 bits of ``values``."""
    spread = values * 134217729.0
    return np.asarray(spread - (spread - values))


def checked_samples(
    signals: NDArray[np.floating], weights: FloatArray, angle_rev: FloatArray
) -> tuple[NDArray[np.floating], FloatArray, FloatArray]:
    """Contiguous ``signals`` (channels, samples), ``weights`` and ``angle_rev`` (samples,); RequestError if unfit."""
    values = real_signals(signals)
    angle = np.asarray(angle_rev)
    if angle.dtype != np.float64:
        raise RequestError(
            "crank angles must be float64: fewer digits move the samples",
            found=angle.dtype,
            allowed="float64",
            remedy="Keep the angle in double precision; the signals may be float32.",
        )
    if angle.shape != values.shape[1:] or np.shape(weights) != angle.shape:
        raise RequestError(
            "signals, weights and angles do not have the same samples",
            found=f"{values.shape}, {np.shape(weights)}, {angle.shape}",
            allowed="(channels, samples), (samples,), (samples,)",
        )
    if angle.size and not (np.abs(angle[[0, -1]]) < LARGEST_ANGLE_REV).all():
        raise RequestError(
            "a crank angle is unknown or too large", found=f"{angle[0]}…{angle[-1]} rev", allowed="< 2^50"
        )
    return values, np.ascontiguousarray(weights, dtype=np.float64), np.ascontiguousarray(angle)


def real_signals(signals: NDArray[np.floating]) -> NDArray[np.floating]:
    """Contiguous ``signals`` (channels, samples), float32 or float64; RequestError for complex ones."""
    values = np.asarray(signals)
    if values.ndim != 2 or np.iscomplexobj(values):
        found = f"{values.dtype} {values.shape}"
        raise RequestError("signals must be real (channels, samples)", found=found, allowed="two dims, real")
    kept = values.dtype in (np.dtype(np.float32), np.dtype(np.float64))
    return np.ascontiguousarray(values if kept else values.astype(np.float64))
