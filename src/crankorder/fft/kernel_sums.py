"""The compiled loops of resampling: weighted sums about positions, plain and stretched, and spline coefficients."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numba as nb
import numpy as np

from crankorder.fft.kernel_vectors import LANES, load, multiply_add, spread, store, total


def _weighted_sums(flat, row, positions, table, n_pieces, weights, low, high, out):  # type: ignore[no-untyped-def]
    """-1, or the first of ``positions`` outside ``low``…``high``; fills ``out`` (channels, positions).

    ``flat`` holds the channels ``row`` numbers apart, ``table`` the kernel of :func:`table_of`; ``weights`` is scratch
    of as many numbers as the kernel has taps.
    """
    taps = len(weights)
    none = spread(weights, 0.0)
    for i in range(len(positions)):
        position = positions[i]
        if not (low <= position <= high):
            return i
        base = int(position)
        place = (position - base) * n_pieces
        piece = min(int(place), n_pieces - 1)
        share = spread(weights, place - piece)
        at, start = piece * 4 * taps, base - taps // 2 + 1
        summed = none
        for k in range(0, taps, LANES):
            q = at + 4 * k
            weight = multiply_add(load(table, q), share, load(table, q + LANES))
            weight = multiply_add(weight, share, load(table, q + 2 * LANES))
            weight = multiply_add(weight, share, load(table, q + 3 * LANES))
            store(weights, k, weight)
            summed = multiply_add(weight, load(flat, start + k), summed)
        out[0, i] = total(summed)
        for c in range(1, out.shape[0] - 1, 2):
            first = start + c * row
            summed, other = none, none
            for k in range(0, taps, LANES):
                weight = load(weights, k)
                summed = multiply_add(weight, load(flat, first + k), summed)
                other = multiply_add(weight, load(flat, first + row + k), other)
            out[c, i] = total(summed)
            out[c + 1, i] = total(other)
        if out.shape[0] % 2 == 0:
            first = start + (out.shape[0] - 1) * row
            summed = none
            for k in range(0, taps, LANES):
                summed = multiply_add(load(weights, k), load(flat, first + k), summed)
            out[out.shape[0] - 1, i] = total(summed)
    return -1


def _stretched_sums(flat, row, positions, cut_off, shape, half, weights, n_samples, out):  # type: ignore[no-untyped-def]
    """-1, or the first of ``positions`` without its neighbours; fills ``out`` (channels, positions).

    ``shape`` (pieces, 4) are cubics of an even kernel over 0…``half`` steps, stretched to ``half`` / ``cut_off``;
    ``weights`` is scratch for the longest; ``flat`` and ``row`` as above, ``n_samples`` of each channel.
    """
    per_step = shape.shape[0] / half
    for i in range(len(positions)):
        position, scale = positions[i], cut_off[i]
        if not (scale > 0.0 and scale <= 1.0):
            return i
        reach = half / scale
        if not (position - reach > -1.0 and position + reach < n_samples):
            return i
        first = int(np.ceil(position - reach))
        n_taps = int(np.floor(position + reach)) - first + 1
        together = 0.0
        for k in range(n_taps):
            place = abs(first + k - position) * scale * per_step
            piece = min(int(place), shape.shape[0] - 1)
            share = place - piece
            weight = ((shape[piece, 0] * share + shape[piece, 1]) * share + shape[piece, 2]) * share + shape[piece, 3]
            weights[k] = weight
            together += weight
        for c in range(out.shape[0]):
            segment = flat[c * row + first : c * row + first + n_taps]
            summed = 0.0
            for k in range(n_taps):
                summed += weights[k] * segment[k]
            out[c, i] = summed / together
    return -1


def _spline_coefficients(signal, z1, z2, gain, out):  # type: ignore[no-untyped-def]
    """Nothing; fills ``out`` (samples,) with ``signal`` through the all-pole filter z1, z2 (0: none), both ways.

    Beyond its ends the signal is taken to stay as it is there.
    """
    a = signal[0] * gain / (1.0 - z1)
    b = a / (1.0 - z2)
    for i in range(len(signal)):
        a = gain * signal[i] + z1 * a
        b = a + z2 * b
        out[i] = b
    a = out[len(signal) - 1] / (1.0 - z1)
    b = a / (1.0 - z2)
    for i in range(len(signal) - 1, -1, -1):
        a = out[i] + z1 * a
        b = a + z2 * b
        out[i] = b


@lru_cache(maxsize=6)
def compiled(loop: str, double: bool) -> Callable[..., Any]:
    """The loop called ``loop`` ("weighted_sums", "stretched_sums", "spline_coefficients") for one precision.

    ``double`` says that signals and results are float64, else float32. One signature each, whatever array comes: a
    read-only one must not cost another compilation.
    """
    number = nb.float64 if double else nb.float32
    signal = nb.types.Array(number, 1, "C", readonly=True)
    positions = nb.types.Array(nb.float64, 1, "C", readonly=True)
    whole, real, out = nb.intp, nb.float64, nb.types.Array(number, 2, "C")
    scratch = nb.types.Array(number, 1, "C")
    shape = nb.types.Array(nb.float64, 2, "C", readonly=True)
    function, signature = {
        "weighted_sums": (
            _weighted_sums,
            nb.intp(signal, whole, positions, signal, whole, scratch, real, real, out),
        ),
        "stretched_sums": (
            _stretched_sums,
            nb.intp(signal, whole, positions, positions, shape, real, scratch, whole, out),
        ),
        "spline_coefficients": (_spline_coefficients, nb.void(signal, real, real, real, scratch)),
    }[loop]
    # the vectors say themselves what may be fused; a recursion twice as fast for it; a sum may change its order
    freedom: dict[str, Any] = {
        "weighted_sums": False,
        "stretched_sums": {"reassoc", "contract"},
        "spline_coefficients": {"contract"},
    }
    compiler: Any = nb.njit(signature, cache=True, nogil=True, fastmath=freedom[loop])
    compiled_loop: Callable[..., Any] = compiler(function)
    return compiled_loop
