"""A resonance as a windowed spectrum shows it: exact for any damping and any window, with its derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.fft.windows import WIDEST_LOBE_BINS, window_named

SMALLEST_TERM = 1e-7
"""Power response of the window below which a term of its autocorrelation is left out."""

FAR = 60.0
"""Size of 2πTz from which the series in 1/z is good to 1e-6."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sight:
    """How a window sees power: its autocorrelation over the lag t (1 at its length ``length_s``) is Σ b_k cos(πkt).

    ``order`` (terms,) holds the k, ``weight`` (terms,) the b_k; ``bin_hz`` is the distance of independent bins.
    """

    order: Array
    weight: Array
    length_s: float

    @property
    def bin_hz(self) -> float:
        """Width in Hz of a bin of an unpadded transform."""
        return 1.0 / self.length_s

    def kernel(self, offset_hz: Array) -> Array:
        """Power response per Hz, its integral over all offsets being one, at ``offset_hz`` from a tone."""
        real: Array = 2.0 * _near(1e-4j + 2j * np.pi * self.length_s * np.abs(offset_hz), self)[0].real
        return real


def sight(window: str, enbw_hz: float) -> Sight:
    """Sight of the window ``window`` whose noise bandwidth is ``enbw_hz``.

    A sum of cosines of half a period is complete, for the autocorrelation vanishes at its end: its coefficients are
    the window's power response at every half bin.
    """
    shape = window_named(window, 512)
    order = np.arange(2 * WIDEST_LOBE_BINS + 1, dtype=np.float64)
    power = shape.response(0.5 * order) ** 2
    power[0] = 0.5
    kept = power > SMALLEST_TERM
    return Sight(order[kept], power[kept] / power[kept].sum(), shape.enbw_bins / enbw_hz)


def _near(a: NDArray[np.complex128], seen: Sight) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """∫ c(t) exp(−a t) dt over a window's length, times that length, and its derivative by a."""
    decay = np.exp(-a)[..., None]
    sign = 1.0 - 2.0 * (seen.order % 2)
    over = 1.0 / (a[..., None] ** 2 + (np.pi * seen.order) ** 2)
    top = 1.0 - sign * decay
    a_top = a[..., None] * top
    value = (a_top * over) @ seen.weight
    slope = ((top + a[..., None] * sign * decay) * over - 2.0 * a[..., None] * a_top * over**2) @ seen.weight
    return seen.length_s * value, seen.length_s * slope


def seen_pole(z_hz: NDArray[np.complex128], seen: Sight) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """What the window makes of 1 / (2π z): value and derivative by z at ``z_hz`` = σ + i (f − f_d), σ > 0.

    The autocorrelation exp(2π (i f_d − σ) τ) of a resonance is cut by the window's own, whatever its decay, so that
    both the spectrum of a tone (σ → 0) and a broad resonance come out exactly.
    ``seen``: how the window sees power.
    """
    scale = 2.0 * np.pi * seen.length_s
    a = scale * z_hz
    curve = np.pi**2 * float(seen.weight @ seen.order**2)
    fourth = np.pi**4 * float(seen.weight @ seen.order**4)
    inverse = 1.0 / a
    square = inverse * inverse
    value = seen.length_s * inverse * (1.0 - square * (curve - fourth * square))
    slope = -seen.length_s * square * (1.0 - square * (3.0 * curve - 5.0 * fourth * square))
    close = np.abs(a) < FAR
    value[close], slope[close] = _near(a[close], seen)
    return value, scale * slope


def pole_columns(frequency_hz: Array, natural_hz: Array, damping: Array, seen: Sight) -> tuple[Array, Array, Array]:
    """Columns (2 modes, frequencies) of the power spectrum of modes, and their derivatives by ln f_j and by ln ζ_j.

    Behind white forces the spectrum of a mode with ``natural_hz`` and ``damping`` (modes,) at ``frequency_hz`` is
    Re [R / (σ + i (f − f_d)) + R* / (σ + i (f + f_d))] with one complex R, so two real columns each (Ewins 2000, §4.3,
    for the power instead of the response). They are scaled by 2πσ, which makes them of order one.
    ``seen``: how the window sees power.
    """
    sigma = (damping * natural_hz)[:, None]
    turned = np.sqrt(1.0 - damping**2)[:, None]
    damped = natural_hz[:, None] * turned
    near, near_slope = seen_pole(sigma + 1j * (frequency_hz - damped), seen)
    far, far_slope = seen_pole(sigma + 1j * (frequency_hz + damped), seen)
    scale = 2.0 * np.pi * sigma
    by_damping = natural_hz[:, None] * (-(damping[:, None] ** 2) / turned)  # of f_d by ln ζ
    made = []
    for near_part, far_part in (
        (near, far),
        (near_slope * (sigma - 1j * damped) + near, far_slope * (sigma + 1j * damped) + far),
        (near_slope * (sigma - 1j * by_damping) + near, far_slope * (sigma + 1j * by_damping) + far),
    ):
        columns = np.empty((len(natural_hz), 2, len(frequency_hz)))
        columns[:, 0] = scale * (near_part.real + far_part.real)
        columns[:, 1] = scale * (far_part.imag - near_part.imag)
        made.append(columns.reshape(-1, len(frequency_hz)))
    return made[0], made[1], made[2]
