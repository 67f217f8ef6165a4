"""95 % intervals of what was found, and which of many comparisons may be claimed.

Student's t holds wherever a standard error has degrees of freedom of its own; of what is claimed of many comparisons
at most a stated share is false.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import ndtri, stdtrit

from crankorder.quantities import Bools, Floats

Z95 = float(ndtri(0.975))
"""Half width of a 95 % interval in standard deviations of a normal distribution."""

ENDLESS_FREEDOM = 1e6
"""Degrees of freedom from which on Student's t is a normal distribution."""


MOST_LOGARITHM = 50.0
"""Logarithm of a factor beyond which nothing is known."""


def known_freedom(freedom: float) -> float:
    """Degrees of ``freedom`` of a standard error as Student's t takes them: from 1 to ENDLESS_FREEDOM; NaN is 1."""
    return ENDLESS_FREEDOM if freedom > ENDLESS_FREEDOM else freedom if freedom > 1.0 else 1.0


def half_width(freedom: float, *, level: float = 0.95) -> float:
    """Half width, in standard errors with ``freedom`` degrees of freedom, of the two-sided interval of a ``level``.

    ``freedom`` may be infinite and counts as 1 at least; ``level`` is 0 to 1.
    """
    return float(stdtrit(known_freedom(freedom), 0.5 + 0.5 * level))


def half_widths(freedom: Floats, *, level: float = 0.95) -> Floats:
    """Half widths as of :func:`half_width`, of the shape of ``freedom``, at one ``level``."""
    held = np.where(freedom > 1.0, np.minimum(freedom, ENDLESS_FREEDOM), 1.0)
    return np.asarray(stdtrit(held, 0.5 + 0.5 * level))


def error_of(value: float, ends: Sequence[float]) -> float:
    """Standard error of a stated ``value`` by the wider side of its 95 % interval, of which ``ends`` are the ends.

    The other side may be cut off at 0, as of sizes and damping ratios.
    """
    return max(float(ends[1]) - value, value - float(ends[0])) / Z95


def interval(value: float, error: float, *, freedom: float = np.inf) -> tuple[float, float]:
    """95 % interval of ``value`` with its standard ``error`` of so many degrees of ``freedom``."""
    half = error * half_width(freedom)
    return value - half, value + half


def positive_interval(value: float, half: float) -> tuple[float, float]:
    """Interval of half width ``half`` about a ``value`` that is positive by nature: its lower end is above 0."""
    return max(value - half, value * float(np.exp(-MOST_LOGARITHM))), value + half


def size_interval(value: complex, half: float) -> tuple[float, float]:
    """Interval of half width ``half`` about the size of a phasor ``value``, from 0 on."""
    return max(abs(value) - half, 0.0), abs(value) + half


def ratio_interval(value: float, error: float, *, most: float = np.inf) -> tuple[float, float]:
    """95 % interval of a positive ``value`` with its standard ``error``, even in the logarithm, up to ``most``.

    What is told by a product, as a damping ratio, errs by a factor: its lower end is above 0.
    """
    half = Z95 * error / value if value > 0.0 else np.inf
    factor = float(np.exp(min(half, MOST_LOGARITHM)))
    return value / factor, max(min(value * factor, most), value)


def adjusted(p_values: Floats) -> Floats:
    """Smallest false-discovery rate at which each comparison would be claimed, of the shape of ``p_values``.

    ``p_values`` lie between 0 and 1; NaN, where nothing was compared, stays NaN and counts as no comparison. It holds
    for independent and positively dependent comparisons (Benjamini, Yekutieli 2001, theorem 1.2).
    Source: Benjamini, Hochberg (1995), J. R. Statist. Soc. B 57, 289, eq. 1.
    """
    flat = np.ravel(np.asarray(p_values, dtype=np.float64))
    rates = np.full(flat.shape, np.nan)
    known = np.flatnonzero(np.isfinite(flat))
    n = len(known)
    if n:
        rank = np.argsort(flat[known], kind="stable")
        factor = n / np.arange(1.0, n + 1.0)
        rates[known[rank]] = np.minimum(np.minimum.accumulate((flat[known][rank] * factor)[::-1])[::-1], 1.0)
    return rates.reshape(np.shape(p_values))


def claimed(p_values: Floats, *, q: float) -> Bools:
    """True for comparisons that may be claimed with a false-discovery rate of at most ``q``.

    Parameters
    ----------
    p_values : any shape, 0 to 1; NaN is never claimed
    q : share of the claims that may be false on average, 0 to 1; where nothing differs at all it is the chance that
        anything is claimed
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(adjusted(p_values) <= q)


def simes(p_values: Floats) -> float:
    """P-value of "none of these differs", from ``p_values`` of any shape; NaN takes no part, of none it is NaN.

    Source: Simes (1986), Biometrika 73, 751.
    """
    return float(np.nanmin(adjusted(p_values), initial=np.inf)) if np.isfinite(p_values).any() else np.nan


def excess_scatter(misfit: Callable[[float], float], freedom: float, *, most: float, within: float) -> float:
    """Scatter beyond the errors, up to ``most``, by which ``misfit`` is as large as its degrees of ``freedom``; else 0.

    ``misfit`` is the sum of the squares of residuals over their variances, with that scatter in them; the result is
    known ``within`` that.
    Source: Paule and Mandel (1982), J. Res. NBS 87, 377.
    """
    if misfit(0.0) <= freedom:
        return 0.0
    return root(lambda scatter: misfit(scatter) - freedom, 0.0, most, within=within)


def root(function: Callable[[float], float], low: float, high: float, *, within: float) -> float:
    """Where ``function``, of unlike signs at ``low`` and ``high``, is zero, ``within`` that or a billionth of it.

    By parabolas where they help, else by halving (Chandrupatla 1997). SciPy's own takes half a second to load.
    """
    a, b, share = high, low, 0.5
    f_a, f_b = function(a), function(b)
    c, f_c = a, f_a
    while f_a != 0.0 and abs(b - a) > 2.0 * (least := within + 1e-9 * min(abs(a), abs(b))):
        edge = least / abs(b - a)
        at = a + min(max(share, edge), 1.0 - edge) * (b - a)
        f_at = function(at)
        if (f_at > 0.0) == (f_a > 0.0):
            c, f_c = a, f_a
        else:
            c, f_c, b, f_b = b, f_b, a, f_a
        a, f_a, share = at, f_at, 0.5
        place, level = (a - b) / (c - b), (f_a - f_b) / (f_c - f_b)
        if level**2 < place and (1.0 - level) ** 2 < 1.0 - place:
            share = f_a / (f_b - f_a) * f_c / (f_b - f_c) + (c - a) / (b - a) * f_a / (f_c - f_a) * f_b / (f_c - f_b)
    return a if abs(f_a) < abs(f_b) else b
