"""Lines of a test sampled by crank angle that are not where they seem: what folds about half the samples per turn."""

from __future__ import annotations

import numpy as np
import xarray as xr

from crankorder.identify.order_lines import excess_over_noise
from crankorder.quantities import QualityFlag
from crankorder.settings import Settings
from crankorder.shaft.folding import find_folds, folded_lines

MAINS_HARMONICS = 20
ORDER_ERROR_BINS = 0.3
"""How well the order of a single peak is known, in bins of the map."""


def fold_flags(order_map: xr.Dataset, *, settings: Settings) -> list[QualityFlag]:
    """What may fold at the speeds of ``order_map``, and fixed frequencies above half the rate that show as lines in it.

    Nothing where the map is of recordings sampled by time, or of unknown speed. ``settings``: those of identify (mains
    frequencies, highest frequency looked for) and of orders (the floor's width).
    """
    samples_per_rev = float(order_map.attrs.get("samples_per_rev", 0.0))
    speed = order_map["speed"].values
    if not samples_per_rev or not np.isfinite(speed).all():
        return []
    axis = order_map["order"].values
    excess, _, _ = excess_over_noise(order_map, settings=settings.identify, orders=settings.orders)
    at_speed, at_order = np.nonzero((excess > 1.0).any(axis=0))
    highest_hz = settings.identify.fold_search_hz
    multiples = np.multiply.outer(settings.identify.mains_hz, np.arange(1, MAINS_HARMONICS + 1))
    mains = folded_lines(
        samples_per_rev,
        speed,
        frequencies_hz=np.unique(multiples[multiples <= highest_hz]).tolist(),
        shown_to_order=float(axis[-1]),
    )
    folds = find_folds(
        speed[at_speed],
        axis[at_order],
        samples_per_rev=samples_per_rev,
        order_error=ORDER_ERROR_BINS * float(axis[1] - axis[0]),
        shown_to_order=float(axis[-1]),
        highest_hz=highest_hz,
        frequencies_hz=[line.value for line in mains],
    )
    low_hz, high_hz = samples_per_rev / 120 * speed.min(), samples_per_rev / 120 * speed.max()
    could: QualityFlag = {
        "recording": "all",
        "flag": "lines_may_fold",
        "severity": "info",
        "detail": f"sampled {samples_per_rev:g} times a revolution: unless a filter kept it out, what lies above "
        f"{low_hz:.4g} to {high_hz:.4g} Hz (by speed) shows at |order - {samples_per_rev:g} k|"
        + "".join(f"; mains, {line}" for line in mains),
    }
    found: list[QualityFlag] = [
        {"recording": "all", "flag": flag, "severity": severity, "detail": detail}
        for flag, severity, detail in (fold.remark for fold in folds)
    ]
    return [could, *found]
