"""Hann weights at uneven crank angles, and what sampling them in time costs."""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.errors import RequestError
from crankorder.fft.nonuniform import FloatArray, sine_of_quarter

SLOPE_REACH = 4
"""Neighbours on each side from which a missing speed is taken: central differences of eighth order."""

SLOPE_WEIGHTS = (4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0)
"""Fornberg (1988), table 1."""


@nb.njit(cache=True, nogil=True, fastmath={"contract"})
def _hann(turns, turns_per_sample, out):  # type: ignore[no-untyped-def]
    """Hann window over ``turns`` 0…1, 0 outside, over its mean 1/2, times ``turns_per_sample``, twice.

    Twice because half of a tone lies at negative orders.
    """
    for i in range(turns.size):
        half = 0.5 * turns[i]
        sine = sine_of_quarter(0.25 - abs(half - 0.25))
        weight = 4.0 * sine * sine * turns_per_sample[i]
        out[i] = weight if 0.0 <= half <= 0.5 else 0.0


def hann_weights(
    angle_rev: FloatArray, *, begin_rev: float, end_rev: float, rev_per_sample: ArrayLike | None = None
) -> FloatArray:
    """Weights (samples,) whose sum over signal times exp(-2 pi i order angle) is the peak amplitude of a tone.

    They are a Hann window in angle times the step of the angle at each sample, over the window's area: the trapezoidal
    rule in time, for the window is 0 at both ends. It is right to :func:`folding_error`, wherever the ends lie between
    samples. At order 0 the sum is twice the mean, as for a one-sided spectrum.

    Parameters
    ----------
    angle_rev : (samples,), rev, at even steps of time
    begin_rev, end_rev : rev, where the window begins and ends; weights beyond are 0
    rev_per_sample : (samples,) or one for all, rev: slope of the angle, from the ShaftAngle's speed. None: taken from
        the angles by central differences of eighth order, which keeps no more than their own digits.

    Raises RequestError where the window has no length or there are too few angles to take the slope from.
    """
    if not (np.isfinite(begin_rev) and np.isfinite(end_rev) and end_rev > begin_rev):
        raise RequestError("a window must end after it begins", found=f"{begin_rev}…{end_rev} rev")
    angle = np.asarray(angle_rev, dtype=np.float64)
    slope = _slopes(angle) if rev_per_sample is None else rev_per_sample
    slope = np.ascontiguousarray(np.broadcast_to(np.asarray(slope, dtype=np.float64), angle.shape))
    revs = end_rev - begin_rev
    return hann_of_turns((angle - begin_rev) / revs, slope / revs)


def hann_of_turns(turns: FloatArray, turns_per_sample: FloatArray) -> FloatArray:
    """Weights (samples,) of :func:`hann_weights` from ``turns`` (samples,), which go from 0 to 1 over the window.

    ``turns_per_sample`` (samples,) is their slope.
    """
    out = np.empty(turns.size)
    _hann(turns, turns_per_sample, out)
    return out


def hann_of_constant(bins: ArrayLike) -> NDArray[np.complex128]:
    """What the weights make of a constant 1 at ``bins`` (any shape), cycles per window: phases from its beginning.

    2 at 0, -1 at 1 and nothing at whole numbers above.
    """
    at = np.asarray(bins, dtype=np.float64)
    whole = np.rint(at)
    turned = np.exp(-1j * np.pi * (at % 2.0)) * np.sinc(at)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = 2.0 * turned / (1.0 - at * at)
    exact = np.where(whole == 0.0, 2.0, np.where(np.abs(whole) == 1.0, -1.0, 0.0))
    return np.where(at == whole, exact, between)


def _slopes(angle: FloatArray) -> FloatArray:
    if angle.size <= 2 * SLOPE_REACH:
        raise RequestError(
            "too few angles to take their slope from",
            found=angle.size,
            allowed=f"more than {2 * SLOPE_REACH}",
            remedy="Give rev_per_sample, the speed over the sample rate.",
        )
    slope = np.gradient(angle)
    inner = slice(SLOPE_REACH, angle.size - SLOPE_REACH)
    parts = [
        weight * (angle[SLOPE_REACH + k : angle.size - SLOPE_REACH + k] - angle[SLOPE_REACH - k : -SLOPE_REACH - k])
        for k, weight in enumerate(SLOPE_WEIGHTS, start=1)
    ]
    slope[inner] = sum(parts)
    return np.asarray(slope)


def folding_error(bins_away: ArrayLike) -> NDArray[np.float64]:
    """Bound on the Hann window's answer ``bins_away`` (any shape) from a line, over the line's amplitude.

    A sum over samples in time cannot tell a product frequency from one that the sample rate away. Content at frequency
    f is read into an order at frequency g by its image, which lies N (1 - (f + g) / rate) bins away for a frame of N
    samples: the Hann window's transform there, 1 / (pi x (x^2 - 1)) (Harris 1978), is the error. 1e-6 at 68 bins, 1e-9
    at 683.
    """
    away = np.maximum(np.asarray(bins_away, dtype=np.float64), 0.0)
    with np.errstate(divide="ignore"):
        return np.where(away > 1.5, 1.0 / (np.pi * away * np.maximum(away * away - 1.0, 1e-300)), 1.0)
