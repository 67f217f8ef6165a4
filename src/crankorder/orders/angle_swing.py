"""What an error of the crank angle that swings with the turn does to order spectra, and how it is taken out of them.

An encoder whose disc is set off shows x + e(x) for the true angle x [rev], e(x) = Re sum E_k exp(2 pi i k x): k = 1 for
the eccentricity, k = 2 for ovality. By the shown angle a line at order n is modulated in phase by 2 pi n e: beside it
stand lines at n ± k, pi n |E_k| times as large (Carson 1922), with the same E_k for every order, channel and speed.
Brought back to the true angle they are gone: S[n] = sum over q of Y[n - q] g_q(n - q), g_q(m) being the q-th Fourier
coefficient of exp(2 pi i m e(x)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

HARMONICS = (1, 2, 3, 4, 5, 6)
"""Swings of the angle per turn that are looked for: eccentricity, ovality, and lines that are uneven."""

REACH_95 = 2.45
"""Standard errors of each part within which both together lie with a chance of 95 %."""

TURN_POINTS = 64
"""Points of a turn at which the modulation is sampled."""

LEAST_SHARE = 1e-7
"""Sidebands smaller than this share of their line are left alone."""

Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Swing:
    """Error of the crank angle that goes ``harmonic`` times with the turn: ``size`` E_k [rev] and how well it is known.

    ``error_rev`` is the standard error of each part of ``size``, ``bound_rev`` what |E_k| exceeds with a chance of 5 %;
    ``proved`` says whether several carriers agree on it, ``chance`` that they would by chance, ``carriers`` the orders
    whose sidebands show it, strongest first; ``largest_rev`` is what no encoder errs by.
    """

    harmonic: int
    size: complex
    error_rev: float
    bound_rev: float
    proved: bool
    chance: float
    carriers: tuple[float, ...]
    largest_rev: float

    @property
    def left_rev(self) -> float:
        """What is left of |E_k|, with a chance of 5 % of being more, once ``size`` was taken out where it is proved.

        Where one carrier alone shows it, as a wheel that is set off does, it may be an error of the angle all the same.
        """
        if self.proved:
            return REACH_95 * self.error_rev
        shown = abs(self.size) + REACH_95 * self.error_rev if self.carriers else 0.0
        return max(self.bound_rev, shown) if shown < self.largest_rev else self.bound_rev


def modulation(swings: dict[int, complex], order: Floats) -> tuple[NDArray[np.int64], Complex]:
    """Shifts q [orders] and coefficients g_q (shifts, orders) by which lines at ``order`` (orders,) are brought back.

    ``swings``: E_k [rev] by harmonic k.
    """
    turn = np.arange(TURN_POINTS) / TURN_POINTS
    error = np.zeros(TURN_POINTS)
    for harmonic, size in swings.items():
        error += (size * np.exp(2j * np.pi * harmonic * turn)).real
    spectrum = np.fft.fft(np.exp(2j * np.pi * order[:, None] * error), axis=1) / TURN_POINTS
    shift = np.fft.fftfreq(TURN_POINTS, 1.0 / TURN_POINTS).astype(np.int64)
    matters = np.abs(spectrum).max(axis=0) > LEAST_SHARE
    return shift[matters], spectrum.T[matters]


def in_true_angle(spectrum: Complex, *, bins_per_order: int, swings: dict[int, complex]) -> Complex:
    """``spectrum`` (…, orders) by the shown angle, brought back to the true one.

    The axis begins at order 0 and has ``bins_per_order`` bins per order; what is NaN stays so and gives nothing to its
    neighbours, nor does what lies above the axis. ``swings``: E_k [rev] by harmonic k.
    """
    n = spectrum.shape[-1]
    order = np.arange(n) / bins_per_order
    known = np.isfinite(spectrum.real)
    whole = spectrum if known.all() else np.where(known, spectrum, 0.0)
    made = np.zeros(spectrum.shape, dtype=np.complex128)
    shifts, gains = modulation(swings, order)
    for q, gain in zip(shifts.tolist(), gains, strict=True):
        step = q * bins_per_order
        if abs(step) >= n:
            continue
        if step >= 0:
            made[..., step:] += whole[..., : n - step] * gain[: n - step]
        else:
            made[..., : n + step] += whole[..., -step:] * gain[-step:]
        if step > 0:  # lines below order 0 are those above it, turned the other way
            last = min(step, n - 1)
            mirrored = (whole[..., 1 : last + 1]).conj() * _mirrored(swings, order[1 : last + 1], q)
            made[..., step - last : step] += mirrored[..., ::-1]
    return made if known.all() else np.where(known, made, np.nan)


def _mirrored(swings: dict[int, complex], order: Floats, shift: int) -> Complex:
    """Coefficient g_shift of lines at minus ``order``."""
    shifts, gains = modulation(swings, -order)
    place = np.flatnonzero(shifts == shift)
    return gains[place[0]] if len(place) else np.zeros(len(order), dtype=np.complex128)


def given_by_neighbours(amplitude: Floats, *, bins_per_order: int, left_rev: dict[int, float]) -> Floats:
    """Largest amplitude (…, orders) that swings of the angle of up to ``left_rev`` by harmonic give to each order.

    ``amplitude`` (…, orders) is what the orders have, the axis, with ``bins_per_order``, as of
    :func:`in_true_angle`. The two sides may add up; harmonics, and what the line itself loses, are joined by the root
    of their squares.
    """
    n = amplitude.shape[-1]
    turned = np.nan_to_num(amplitude) * (np.pi * np.arange(n) / bins_per_order)
    total = np.zeros(amplitude.shape)
    for harmonic, size in left_rev.items():
        step = harmonic * bins_per_order
        total += np.square(size * (_moved(turned, step) + _moved(turned, -step)))
        total += np.square(np.square(size * turned) / np.maximum(np.nan_to_num(amplitude), 1e-300))
    return np.asarray(np.sqrt(total))


def _moved(values: Floats, step: int) -> Floats:
    """``values`` (…, orders) of the order ``step`` bins below (above, where it is negative); mirrored below 0."""
    made = np.zeros(values.shape)
    n = values.shape[-1]
    if step >= n or -step >= n:
        return made
    if step >= 0:
        made[..., step:] = values[..., : n - step]
        last = min(step, n - 1)
        made[..., step - last : step] = values[..., last:0:-1]
    else:
        made[..., : n + step] = values[..., -step:]
    return made
