"""Which of many comparisons may be claimed, so that at most a stated share of the claims is false."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def adjusted(p_values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smallest false-discovery rate at which each comparison would be claimed, of the shape of ``p_values``.

    ``p_values`` lie between 0 and 1; NaN, where nothing was compared, stays NaN and counts as no comparison. It holds
    for independent and positively dependent comparisons (Benjamini, Yekutieli 2001, theorem 1.2).
    Source: Benjamini, Hochberg (1995), J. R. Statist. Soc. B 57, 289, eq. 1.
    """
    flat = np.ravel(np.asarray(p_values, dtype=np.float64))
    made = np.full(flat.shape, np.nan)
    known = np.flatnonzero(np.isfinite(flat))
    n = len(known)
    if n:
        rank = np.argsort(flat[known], kind="stable")
        factor = n / np.arange(1.0, n + 1.0)
        stepped = np.minimum.accumulate((flat[known][rank] * factor)[::-1])[::-1]
        made[known[rank]] = np.minimum(stepped, 1.0)
    return made.reshape(np.shape(p_values))


def claimed(p_values: NDArray[np.float64], *, q: float) -> NDArray[np.bool_]:
    """True for comparisons that may be claimed with a false-discovery rate of at most ``q``.

    Parameters
    ----------
    p_values : any shape, 0 to 1; NaN is never claimed
    q : share of the claims that may be false on average, 0 to 1; where nothing differs at all it is the chance that
        anything is claimed
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(adjusted(p_values) <= q)


def simes(p_values: NDArray[np.float64]) -> float:
    """P-value of "none of these differs", from ``p_values`` of any shape; NaN takes no part, of none it is NaN.

    Source: Simes (1986), Biometrika 73, 751.
    """
    return float(np.nanmin(adjusted(p_values), initial=np.inf)) if np.isfinite(p_values).any() else np.nan
