"""Response of a mode to a force: the one formula that crossings, paths and fits share."""

from __future__ import annotations

import numpy as np

from crankorder.quantities import Complexes, Floats


def resonance(frequency_hz: Floats, natural_hz: Floats, damping_ratio: Floats) -> Complexes:
    """Acceleration −x² / (1 − x² + 2iζx), x = f / f_j, of modes of unit residue, shape (…, mode).

    ``frequency_hz``: f, any shape (…). ``natural_hz`` and ``damping_ratio``: f_j (Hz) and ζ_j, (mode,).
    """
    x = np.asarray(frequency_hz)[..., None] / natural_hz
    return np.asarray(-(x**2) / (1 - x**2 + 2j * damping_ratio * x), dtype=np.complex128)
