"""Banded symmetric positive definite systems: factor, solution and the band of the inverse, compiled.

A band is stored by rows, the diagonal last: ``band[i, width - k]`` is the entry (i, i - k).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

CHUNK = 256
"""Samples that are worked on at a time: their buffers stay in the first-level cache."""

LANES = 32
"""Chunks are filled up with zeros to a multiple of this: what vector loops take in one round."""

# Taylor coefficients in odd and even powers: below 1e-17 for angles up to π/4
_SIN = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(9))

_COS = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(9))

_S1, _S2, _S3, _S4, _S5, _S6, _S7, _S8 = _SIN[1:]

_C1, _C2, _C3, _C4, _C5, _C6, _C7, _C8 = _COS[1:]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def factorise(band):  # type: ignore[no-untyped-def]
    """Replace ``band`` (n, width + 1) by its Cholesky factor; the row at which it is not definite, else -1."""
    n, width = band.shape[0], band.shape[1] - 1
    for i in range(n):
        first = max(0, i - width)
        row = band[i]
        for j in range(first, i):
            other = band[j]
            shared = max(first, j - width)
            count = j - shared
            mine, theirs = row[width - i + shared :], other[width - j + shared :]
            total = 0.0
            for k in range(count):
                total += mine[k] * theirs[k]
            row[width - i + j] = (row[width - i + j] - total) / other[width]
        total = 0.0
        for k in range(width - i + first, width):
            total += row[k] * row[k]
        pivot = row[width] - total
        if not pivot > 1e-15 * row[width]:
            return i
        row[width] = np.sqrt(pivot)
    return -1


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def solve(factor, values):  # type: ignore[no-untyped-def]
    """Replace each of ``values`` (right-hand sides, n) by the solution with ``factor`` of ``factorise``."""
    n, width = factor.shape[0], factor.shape[1] - 1
    for c in range(values.shape[0]):
        x = values[c]
        for i in range(n):
            first = max(0, i - width)
            row, known = factor[i, width - i + first :], x[first:]
            total = 0.0
            for k in range(i - first):
                total += row[k] * known[k]
            x[i] = (x[i] - total) / factor[i, width]
        for i in range(n - 1, -1, -1):
            first = max(0, i - width)
            row, above = factor[i, width - i + first :], x[first:]
            x[i] /= factor[i, width]
            for k in range(i - first):
                above[k] -= row[k] * x[i]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def product(band, values, result):  # type: ignore[no-untyped-def]
    """Add to ``result`` (columns, n) the symmetric ``band`` times ``values`` (columns, n)."""
    n, width = band.shape[0], band.shape[1] - 1
    for c in range(values.shape[0]):
        x, out = values[c], result[c]
        for i in range(n):
            first = max(0, i - width)
            row, known, above = band[i, width - i + first :], x[first:], out[first:]
            total, here = band[i, width] * x[i], x[i]
            for k in range(i - first):
                total += row[k] * known[k]
                above[k] += row[k] * here
            out[i] += total


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def inverse_band(factor):  # type: ignore[no-untyped-def]
    """Entries of the inverse within the band, stored as ``factor`` of ``factorise`` is.

    Source: Takahashi, Fagan and Chin 1973; as in Hutchinson and de Hoog 1985 for smoothing splines.
    """
    n, width = factor.shape[0], factor.shape[1] - 1
    inverse = np.zeros_like(factor)
    below, entry = np.empty(width), np.empty(width)
    for i in range(n - 1, -1, -1):
        count = min(width, n - 1 - i)
        for k in range(count):
            below[k] = factor[i + 1 + k, width - 1 - k] / factor[i, width]
            entry[k] = 0.0
        for k in range(count):
            row, mine, total = inverse[i + 1 + k, width - k :], below[k], 0.0
            for m in range(k):
                total += below[m] * row[m]
                entry[m] -= mine * row[m]
            entry[k] -= total + mine * row[k]
        total = 1.0 / (factor[i, width] * factor[i, width])
        for k in range(count):
            inverse[i + 1 + k, width - 1 - k] = entry[k]
            total -= below[k] * entry[k]
        inverse[i, width] = total
    return inverse


@njit(cache=True, nogil=True, fastmath=True)
def _cos_sin(phase_rev, cosine, sine):  # type: ignore[no-untyped-def]
    """Fill ``cosine`` and ``sine`` with those of ``phase_rev``; all of one length."""
    for j in range(phase_rev.shape[0]):
        turns = phase_rev[j]
        quarter = 4.0 * (turns - math.floor(turns + 0.5))
        whole = math.floor(quarter + 0.5)
        x = (quarter - whole) * (0.5 * math.pi)
        q = x * x
        s = _S5 + q * (_S6 + q * (_S7 + q * _S8))
        s = x + x * q * (_S1 + q * (_S2 + q * (_S3 + q * (_S4 + q * s))))
        c = _C5 + q * (_C6 + q * (_C7 + q * _C8))
        c = 1.0 + q * (_C1 + q * (_C2 + q * (_C3 + q * (_C4 + q * c))))
        odd = (whole == 1.0) | (whole == -1.0)
        first = s if odd else c
        second = c if odd else s
        cosine[j] = -first if (whole == 1.0) | (whole >= 2.0) | (whole <= -2.0) else first
        sine[j] = -second if (whole < 0.0) | (whole >= 2.0) else second


@njit(cache=True, nogil=True, fastmath=True)
def _powers(first, step, size, powers):  # type: ignore[no-untyped-def]
    """Rows of ``powers``, up to ``size``: the powers 0, 1, 2 … of first + step j."""
    one, u = powers[0, :size], powers[1, :size]
    for j in range(size):
        one[j] = 1.0
        u[j] = first + step * j
    for m in range(2, powers.shape[0]):
        low, high = powers[m - 1, :size], powers[m, :size]
        for j in range(size):
            high[j] = low[j] * u[j]


@njit(cache=True, nogil=True)
def _padded(n):  # type: ignore[no-untyped-def]
    return (n + LANES - 1) // LANES * LANES


@njit(cache=True, nogil=True)
def _waves(phase_rev, first, mask, turns, weight, waves):  # type: ignore[no-untyped-def]
    """Fill ``waves`` (cosines and sines of all orders, padded), nought where ``mask`` is not set, and ``weight``.

    Rows are sliced one by one here and below: only so are they known to be contiguous, which vector loops need.
    """
    n_orders, n, size = phase_rev.shape[0], mask.shape[0], turns.shape[0]
    for j in range(n):
        weight[j] = 1.0 if mask[j] else 0.0
    weight[n:] = 0.0
    turns[n:] = 0.0
    for k in range(n_orders):
        turns[:n] = phase_rev[k, first : first + n]
        cosine, sine = waves[k, :size], waves[n_orders + k, :size]
        _cos_sin(turns, cosine, sine)
        for j in range(turns.shape[0]):
            cosine[j] *= weight[j]
            sine[j] *= weight[j]


@njit(cache=True, nogil=True, fastmath=True)
def _add_moments(left, right, powers, product, moments):  # type: ignore[no-untyped-def]
    """Add to ``moments`` those of ``left`` times ``right``; ``product`` is room for it."""
    size = product.shape[0]
    for j in range(size):
        product[j] = left[j] * right[j]
    for m in range(moments.shape[0]):
        total = 0.0
        for j in range(size):
            total += product[j] * powers[m, j]
        moments[m] += total


@njit(cache=True, nogil=True)
def add_moments(signals, scale, phase_rev, usable, starts, gram, data, totals):  # type: ignore[no-untyped-def]
    """Add to ``gram`` and ``data`` the moments of the samples.

    ``signals`` (channels, samples) times ``scale`` (channels,), ``phase_rev`` (orders, samples), ``usable`` (samples,)
    bool, ``starts`` (intervals + 1,) first sample of each; ``gram`` (intervals, pairs of cosine and sine rows, powers)
    and ``data`` (intervals, channels + 1, rows, powers), the last for a signal of ones; ``totals`` (channels + 1,) are
    the sums of the signals.
    """
    n_rows, n_channels = 2 * phase_rev.shape[0], signals.shape[0]
    waves, powers, room = np.empty((n_rows, CHUNK)), np.empty((gram.shape[2], CHUNK)), np.empty((3, CHUNK))
    at, end, i = 0, signals.shape[1], 0
    while at < end:
        while at >= starts[i + 1]:
            i += 1
        n = min(CHUNK, end - at, starts[i + 1] - at)
        step, size = 2.0 / (starts[i + 1] - starts[i]), _padded(n)
        mask = usable[at : at + n]
        product, weight, value = room[0, :size], room[1, :size], room[2, :size]
        _powers((at - starts[i] + 0.5) * step - 1.0, step, size, powers)
        _waves(phase_rev, at, mask, value, weight, waves)
        value[n:] = 0.0
        pair = 0
        for row in range(n_rows):
            for other in range(row + 1):
                _add_moments(waves[row, :size], waves[other, :size], powers, product, gram[i, pair])
                pair += 1
            _add_moments(waves[row, :size], weight, powers, product, data[i, n_channels, row])
        totals[n_channels] += weight.sum()
        for channel in range(n_channels):
            given = signals[channel, at : at + n]
            for j in range(n):
                value[j] = scale[channel] * given[j] if mask[j] else 0.0
            totals[channel] += value.sum()
            for row in range(n_rows):
                _add_moments(waves[row, :size], value, powers, product, data[i, channel, row])
        at += n


@njit(cache=True, nogil=True)
def evaluate(  # type: ignore[no-untyped-def]
    signals, scale, offset, phase_rev, usable, starts, pieces, amplitude, residual, data
):
    """Fill ``amplitude`` and ``residual`` at each sample; add to ``data`` the moments of the residual.

    ``signals``, ``scale``, ``phase_rev``, ``usable`` and ``starts`` as in ``add_moments``; ``pieces``
    (intervals, channels, rows, powers) are the envelopes in u, ``offset`` (channels,) is the constant part,
    ``amplitude`` (channels, orders, 2 · samples) holds real and imaginary parts in turn, ``residual`` (channels,
    samples). Amplitudes and residuals are those of the signals as given; ``pieces``, ``offset`` and ``data`` those of
    the scaled ones. Where not usable the residual is NaN.
    """
    n_orders, n_rows = phase_rev.shape[0], 2 * phase_rev.shape[0]
    waves, powers, room = np.empty((n_rows, CHUNK)), np.empty((data.shape[3], CHUNK)), np.empty((5, CHUNK))
    at, end, i = 0, signals.shape[1], 0
    while at < end:
        while at >= starts[i + 1]:
            i += 1
        n = min(CHUNK, end - at, starts[i + 1] - at)
        step, size = 2.0 / (starts[i + 1] - starts[i]), _padded(n)
        mask = usable[at : at + n]
        product, weight, left = room[0, :size], room[1, :size], room[2, :size]
        real, imag = room[3, :size], room[4, :size]
        _powers((at - starts[i] + 0.5) * step - 1.0, step, size, powers)
        _waves(phase_rev, at, mask, left, weight, waves)
        left[n:] = 0.0
        for channel in range(signals.shape[0]):
            unit = 1.0 / scale[channel]
            given, rest = signals[channel, at : at + n], residual[channel, at : at + n]
            for j in range(n):
                left[j] = scale[channel] * given[j] if mask[j] else 0.0
            for k in range(n_orders):
                _horner(pieces[i, channel, k], pieces[i, channel, n_orders + k], powers[1, :size], real, imag)
                out = amplitude[channel, k, 2 * at : 2 * (at + n)]
                for j in range(n):
                    out[2 * j] = real[j] * unit
                    out[2 * j + 1] = -imag[j] * unit
                cosine, sine = waves[k, :size], waves[n_orders + k, :size]
                for j in range(size):
                    left[j] -= real[j] * cosine[j] + imag[j] * sine[j]
            for j in range(n):
                rest[j] = left[j] * unit if mask[j] else np.nan
                left[j] -= offset[channel]
            for row in range(n_rows):
                _add_moments(waves[row, :size], left, powers, product, data[i, channel, row])
        at += n


@njit(cache=True, nogil=True, fastmath=True)
def _horner(cosine_piece, sine_piece, u, real, imag):  # type: ignore[no-untyped-def]
    """Fill ``real`` and ``imag`` with the envelopes of cosine and sine at ``u``; the line is a cos θ + b sin θ."""
    last = cosine_piece.shape[0] - 1
    for j in range(u.shape[0]):
        a, b = cosine_piece[last], sine_piece[last]
        for m in range(last):
            a = a * u[j] + cosine_piece[last - 1 - m]
            b = b * u[j] + sine_piece[last - 1 - m]
        real[j] = a
        imag[j] = b
