"""Order spectra straight from samples at uneven crank angles: the non-uniform FFT of finufft, nothing resampled."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.errors import RequestError
from crankorder.quantities import Complexes, Floats
from crankorder.settings import LARGEST_TOLERANCE, LEAST_TOLERANCE

REASSOCIATED = {"reassoc", "contract", "nsz", "arcp"}
"""What a sum may do to vectorise; it still meets NaN and infinity, so that they show in the result."""

LARGEST_EXPONENT = 1020
"""Of the powers of two by which channels are scaled, and their inverses: all are normal numbers."""

SMALL_MEAN = 1e-3
"""A mean below this share of the mean magnitude does not change the scale of a channel."""

TOLERANCE_MARGIN = 5.0
"""finufft's own tolerance is so much less than what is asked for: measured, its error is up to 1.8 times its tolerance
of the weighted mean magnitude, which is 4/pi of the amplitude of a tone under a Hann window."""

OVERSAMPLING = 2.0
"""Of finufft's inner grid: what it needs below 1e-9; 1.25 was no faster here."""

DESIGN_MARGIN_DB = 24.0
"""More than is asked for: four stages add up, short ones miss Kaiser's estimate, and passing a constant exactly moves
the whole ripple to one side. Measured: at most 0.9 of the tolerance."""


@nb.njit(inline="always")
def sine_of_quarter(v):  # type: ignore[no-untyped-def]
    """Sine of ``v`` revolutions, -0.25 to 0.25: Chebyshev interpolant of sin(2 pi v)/v in v^2, right to 1e-16."""
    y = v * v
    high = 3.819928071447434 + y * (-0.7177339096880971 + y * 0.1008988524604525)
    middle = -76.70585975282324 + y * (42.05869392532184 + y * (-15.094641673380602 + y * high))
    return v * (6.283185307179586 + y * (-41.341702240399755 + y * (81.60524927607361 + y * middle)))


@nb.njit(cache=True, nogil=True, fastmath=REASSOCIATED)
def _weighted(values, scale, mean, weights, out):  # type: ignore[no-untyped-def]
    """Fills ``out`` with ``scale`` times ``values`` less ``mean``, times ``weights`` (samples,)."""
    for i in range(values.size):
        out[i] = (values[i] * scale - mean) * weights[i]


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


def phase_of_whole_revs(angle_rev: ArrayLike, orders: Floats) -> Complexes:
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


def _upper_half(values: Floats) -> Floats:
    """The upper 26 bits of ``values``."""
    spread = values * 134217729.0
    return np.asarray(spread - (spread - values))


def real_signals(signals: NDArray[np.floating]) -> NDArray[np.floating]:
    """Contiguous ``signals`` (channels, samples), float32 or float64; RequestError for complex ones."""
    values = np.asarray(signals)
    if values.ndim != 2 or np.iscomplexobj(values):
        found = f"{values.dtype} {values.shape}"
        raise RequestError("signals must be real (channels, samples)", found=found, allowed="two dims, real")
    kept = values.dtype in (np.dtype(np.float32), np.dtype(np.float64))
    return np.ascontiguousarray(values if kept else values.astype(np.float64))


@nb.njit(cache=True, nogil=True)
def _paired(signals, first, scale, mean, weights, out):  # type: ignore[no-untyped-def]
    """Weighted channels, two by two the real and imaginary parts of ``out`` (pairs, 2 x samples, real view)."""
    for c in range(signals.shape[0]):
        _weighted(signals[c, first : first + weights.size], scale[c], mean[c], weights, out[c // 2, c % 2 :: 2])
    if signals.shape[0] % 2:
        out[-1, 1::2] = 0.0


class OrderTransform:
    """Plan for spectra of ``n_orders`` orders 0, 1, 2… (cycles per turn) of ``n_channels`` signals, to ``tolerance``.

    Two real channels go as one complex through a type 1 transform (Barnett, Magland and af Klinteberg 2019); one plan
    serves frames of any number of samples. It belongs to one thread.
    """

    def __init__(self, *, n_orders: int, n_channels: int, tolerance: float) -> None:
        """Plan once; each call of :meth:`spectra` sets its own samples. Raises RequestError for what cannot be."""
        import finufft

        if not LEAST_TOLERANCE <= tolerance <= LARGEST_TOLERANCE:
            allowed = f"{LEAST_TOLERANCE:g}…{LARGEST_TOLERANCE:g}"
            raise RequestError("the tolerance of a transform is out of range", found=tolerance, allowed=allowed)
        if n_orders < 1 or n_channels < 1:
            raise RequestError("nothing to transform", found=f"{n_orders} orders, {n_channels} channels")
        self.n_orders, self.n_channels, self.tolerance = n_orders, n_channels, tolerance
        self._n_pairs = (n_channels + 1) // 2
        options = {"isign": -1, "nthreads": 1, "upsampfac": OVERSAMPLING, "dtype": "complex128"}
        modes, eps = (2 * n_orders - 1,), tolerance / TOLERANCE_MARGIN
        self._plan = finufft.Plan(1, modes, n_trans=self._n_pairs, eps=eps, **options)
        # turns are counted from the middle of -pi…pi
        self._signs = np.where(np.arange(n_orders) % 2, -1.0, 1.0)

    def spectra(
        self,
        signals: NDArray[np.floating],
        weights: Floats,
        turns: Floats,
        *,
        first: int = 0,
        mean_spectrum: Complexes | None = None,
    ) -> Complexes:
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
        for c in np.flatnonzero(~finite):
            pairs.view(np.float64)[c // 2, c % 2 :: 2] = 0.0
        self._plan.setpts(2.0 * np.pi * (turns - 0.5))
        # spectra of the real channels from those of their pairs, orders -n…n
        both = self._plan.execute(pairs if len(pairs) > 1 else pairs[0]).reshape(len(pairs), -1)
        positive, negative = both[:, self.n_orders - 1 :], both[:, self.n_orders - 1 :: -1].conj()
        out[0::2] = 0.5 * (positive + negative)
        out[1::2] = (-0.5j * (positive - negative))[: n_channels // 2]
        out *= self._signs
        if mean_spectrum is not None:
            out += mean[:, None] * mean_spectrum
        out *= (2.0 ** exponent.astype(np.float64))[:, None]
        out[~finite] = np.nan
        return out


@nb.njit(cache=True, nogil=True, fastmath={"contract"})
def _hann(turns, turns_per_sample, out):  # type: ignore[no-untyped-def]
    """Hann window over ``turns`` 0…1, 0 outside, over its mean 1/2, times ``turns_per_sample``, twice.

    Twice because half of a tone lies at negative orders.
    """
    for i in range(turns.size):
        half = 0.5 * turns[i]
        sine = sine_of_quarter(0.25 - abs(half - 0.25))
        out[i] = 4.0 * sine * sine * turns_per_sample[i] if 0.0 <= half <= 0.5 else 0.0


def hann_of_turns(turns: Floats, turns_per_sample: Floats) -> Floats:
    """Weights (samples,) whose sum over signal times exp(-2 pi i order turn) is the peak amplitude of a tone.

    A Hann window over ``turns`` (samples,), which go from 0 to 1 through it, times their slope ``turns_per_sample``
    (samples,), over the window's area: the trapezoidal rule in time, for the window is 0 at both ends. It is right to
    :func:`folding_error`, wherever the ends lie between samples. At order 0 the sum is twice the mean.
    """
    out = np.empty(turns.size)
    _hann(turns, turns_per_sample, out)
    return out


def hann_of_constant(bins: ArrayLike) -> Complexes:
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


def folding_error(bins_away: ArrayLike) -> Floats:
    """Bound on the Hann window's answer ``bins_away`` (any shape) from a line, over the line's amplitude.

    A sum over samples in time cannot tell a product frequency from one that the sample rate away. Content at frequency
    f is read into an order at frequency g by its image, which lies N (1 - (f + g) / rate) bins away for a frame of N
    samples: the Hann window's transform there, 1 / (pi x (x^2 - 1)) (Harris 1978), is the error. 1e-6 at 68 bins, 1e-9
    at 683.
    """
    away = np.maximum(np.asarray(bins_away, dtype=np.float64), 0.0)
    with np.errstate(divide="ignore"):
        return np.where(away > 1.5, 1.0 / (np.pi * away * np.maximum(away * away - 1.0, 1e-300)), 1.0)


@dataclass(frozen=True)
class Upsampling:
    """Half-band stages that multiply the rate by ``factor``; ``taps`` (stages) give the value halfway between samples.

    ``reach`` is the number of samples that are used up at each end; content up to ``pass_share`` of the rate is right.
    """

    factor: int
    pass_share: float
    taps: tuple[Floats, ...]
    reach: int


@lru_cache(maxsize=128)
def upsampling(factor: int, *, pass_share: float, tolerance: float) -> Upsampling:
    """Stages by which content below ``pass_share`` (0 to 0.5) of the sample rate keeps its amplitude to ``tolerance``.

    ``factor`` is a power of two. Each stage is a Kaiser-windowed sinc (Kaiser 1974) of its transition band.
    """
    taps: list[Floats] = []
    reach, at_factor, share = 0.0, 1, pass_share
    attenuation = max(60.0, -20.0 * np.log10(tolerance)) + DESIGN_MARGIN_DB
    beta = 0.1102 * (attenuation - 8.7)
    while at_factor < factor:
        half = int(np.ceil((attenuation - 7.95) / (2.285 * 2.0 * np.pi * (1.0 - 2.0 * share)) / 2.0)) + 1
        offset = np.arange(2 * half) - half + 0.5
        kernel = np.sinc(offset) * np.i0(beta * np.sqrt(1.0 - (offset / half) ** 2)) / np.i0(beta)
        taps.append(kernel / kernel.sum())
        reach += (half - 1) / at_factor
        at_factor *= 2
        share /= 2.0
    return Upsampling(factor, pass_share, tuple(taps), int(np.ceil(reach)))


@nb.njit(cache=True, nogil=True, fastmath=REASSOCIATED)
def _dot(segment, taps):  # type: ignore[no-untyped-def]
    total = 0.0
    for j in range(taps.size):
        total += segment[j] * taps[j]
    return total


@nb.njit(cache=True, nogil=True)
def _doubled(signals, taps, out):  # type: ignore[no-untyped-def]
    half = taps.size // 2
    between = out.shape[1] // 2
    for c in range(signals.shape[0]):
        for i in range(between):
            out[c, 2 * i] = signals[c, half - 1 + i]
            out[c, 2 * i + 1] = _dot(signals[c, i : i + 2 * half], taps)
        out[c, 2 * between] = signals[c, half - 1 + between]


def upsampled(signals: NDArray[np.floating], plan: Upsampling, *, first: int, last: int) -> tuple[Floats, int]:
    """Values (channels, many) ``plan.factor`` times as dense from sample ``first`` to ``last``, and where these begin.

    ``signals`` (channels, samples) hold ``plan.reach`` samples more at each end; the second result is the index of
    sample ``first`` among the values. The first result is float64.
    """
    current = signals[:, first - plan.reach : last + 1 + plan.reach].astype(np.float64)
    begin = plan.reach
    for taps in plan.taps:
        half = len(taps) // 2
        out = np.empty((len(current), 2 * (current.shape[1] - 2 * half + 1) + 1))
        _doubled(current, taps, out)
        current, begin = out, 2 * (begin - half + 1)
    return current, begin
