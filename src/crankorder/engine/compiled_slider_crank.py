"""Piston acceleration at many angles in one compiled pass; loaded where it is needed, for the compiler takes a while.

Sine and cosine are polynomials on an eighth of a turn either way, so that the compiler can do several angles at once;
the library's own are called angle by angle and cost more than all the rest.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TWO_PI = 2 * math.pi


@njit(nogil=True, error_model="numpy")
def fast_sine_cosine(crank_angle_rev):  # type: ignore[no-untyped-def]
    """Sine and cosine of ``crank_angle_rev`` (revolutions, one number), exact to their own size at quarter turns.

    Source: minimax polynomials on ±45° from fdlibm (Sun Microsystems, 1993); the reduction to ±45° is exact.
    """
    quarter = np.rint(4.0 * crank_angle_rev)
    angle = TWO_PI * (crank_angle_rev - 0.25 * quarter)
    z = angle * angle
    sine_tail = 2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
    sine_tail = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * sine_tail)
    near_sine = angle + angle * z * (-1.66666666666666324348e-01 + z * sine_tail)
    cosine_tail = -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)
    cosine_tail = -1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * cosine_tail)
    half = 0.5 * z
    nearly = 1.0 - half
    near_cosine = nearly + (((1.0 - nearly) - half) + z * z * (4.16666666666666019037e-02 + z * cosine_tail))

    turn = quarter - 4.0 * math.floor(0.25 * quarter)
    swapped = turn - 2.0 * math.floor(0.5 * turn) == 1.0
    sine = near_cosine if swapped else near_sine
    cosine = near_sine if swapped else near_cosine
    return (-sine if turn > 1.5 else sine), (-cosine if abs(turn - 1.5) < 1.0 else cosine)


@njit(cache=True, nogil=True, error_model="numpy")
def fill_acceleration(crank_angle_rev, radius_m, ratio, offset, margin, out):  # type: ignore[no-untyped-def]
    """Piston acceleration towards the crankshaft over squared speed (m/rad²), written into ``out``.

    ``crank_angle_rev``: revolutions, float64 (n,). ``radius_m``: of the crank. ``ratio``: λ. ``offset``: ε. ``margin``:
    1 − λ, from the lengths. ``out``: float64 (n,). The steps are those of ``plain_piston_acceleration``, which is the
    test of this one. Source: truth sheet section 0, with sin ψ = λ sin φ − ε.
    """
    for i in range(crank_angle_rev.size):
        sine, cosine = fast_sine_cosine(crank_angle_rev[i])
        side = -1.0 if sine < 0.0 else 1.0
        rod_sine = ratio * sine - offset
        slope_squared = cosine * cosine
        near = margin + side * offset + ratio * slope_squared / (1.0 + abs(sine))
        rod_cosine_squared = near * (1.0 + side * rod_sine)
        swing = ratio * slope_squared - sine * rod_sine * rod_cosine_squared
        out[i] = radius_m * (cosine + swing / (rod_cosine_squared * math.sqrt(rod_cosine_squared)))
