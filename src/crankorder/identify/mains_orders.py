"""Order lines of a test at one speed that are mains: at one speed a fixed frequency looks like an order."""

from __future__ import annotations

import numpy as np

from crankorder.identify.found import AgreedOrder
from crankorder.identify.mains import nearest_multiple
from crankorder.settings import IdentifySettings

ALIKE_SPEEDS = 1.005
"""Fastest over slowest speed up to which a line of fixed frequency keeps its order."""

FEWEST = 3
"""Multiples of one mains frequency that must be there before any is called so …"""

OVER_CHANCE = 3.0
"""… and at least so many times as many as lines anywhere would hit by chance."""

SAME_HZ = 0.1
"""Hz within which they are multiples of one and the same frequency."""

LOWEST = 2
"""Among them one of the first so many multiples."""


def mains_orders(orders: tuple[AgreedOrder, ...], *, settings: IdentifySettings) -> dict[float, tuple[str, str]]:
    """Cause and evidence of those of ``orders`` that are multiples of a mains frequency, by order.

    Only of lines that are not locked and seen at speeds too alike to tell an order from a fixed frequency; and only
    where several multiples of the same mains are there, more than chance would bring. ``settings``: the mains
    frequencies and how far they wander.
    """
    found: dict[float, tuple[str, str]] = {}
    frequencies = {agreed.order: hz for agreed in orders if (hz := _fixed_hz(agreed)) is not None}
    if not frequencies:
        return found
    hertz = np.array(list(frequencies.values()))
    for mains in settings.mains_hz:
        multiple, within = nearest_multiple(hertz, mains, settings=settings)
        hits = np.abs(hertz - multiple * mains) <= within
        if hits.any():  # they all come from one mains, wherever it has wandered
            hits &= np.abs(hertz - multiple * np.median((hertz / multiple)[hits])) <= SAME_HZ
        by_chance = float(np.sum(np.minimum(1.0, 2.0 * within / mains)))
        enough = np.unique(multiple[hits]).size >= max(FEWEST, OVER_CHANCE * by_chance)
        if not enough or multiple[hits].min() > LOWEST:
            continue
        text = f"{np.unique(multiple[hits]).size} multiples of {mains:g} Hz; at one speed mains look like orders"
        for order, number, hit in zip(frequencies, multiple.tolist(), hits.tolist(), strict=True):
            if hit and order not in found:
                found[order] = f"mains, {number:.0f} x {mains:g} Hz", text
    return found


def _fixed_hz(agreed: AgreedOrder) -> float | None:
    """Frequency of a line that may as well be fixed; None where the shaft's phase or several speeds say otherwise."""
    speed = np.concatenate([line.speed_rpm for line in agreed.lines])
    if agreed.lock == "locked" or not np.isfinite(speed).all() or speed.max() > ALIKE_SPEEDS * speed.min():
        return None
    return agreed.order * float(speed.mean()) / 60.0
