"""What of a motor is doubtful: a slip by a speed with which no line of its shaft agrees, mains beside another line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import xarray as xr

from crankorder.identify.explain import Causes
from crankorder.identify.explain_families import IF_WRONG
from crankorder.identify.found import AgreedOrder
from crankorder.identify.intervals import Z95
from crankorder.identify.lines.speed_proof import STATED_SPEED_ERROR, speed_source
from crankorder.identify.mains import mains_words
from crankorder.identify.motors import MotorFound
from crankorder.identify.one_mains import OR_ANOTHER

MOST_TURNS = 4
"""Multiples of the shaft's turns up to which a line that may be one speaks for the speed: higher ones are hit often."""


def with_speed_judged(
    found: MotorFound | None, orders: Sequence[AgreedOrder], causes: Causes, order_map: xr.Dataset, doubt: str | None
) -> MotorFound | None:
    """``found`` with the reason why its slip is not known, where its speed is in ``doubt`` or only stated and none of
    the ``orders`` (explained by ``causes``, of the test of ``order_map``) agrees with it.
    """
    if found is None or found.misfit or not found.speeds:
        return found
    if doubt is not None:
        return replace(found, speed_doubt="the speed is in doubt")
    if speed_source([order_map]) != "stated" or any(_agrees(one) for one in orders):
        return found
    said = "the speed was only stated, and no line of the shaft agrees with it"
    bases = {key[1] for key, cause in causes.orders.items() if IF_WRONG in cause.text and cause.text.startswith("a ")}
    slowest = max(found.speeds, key=lambda one: one.slip)
    for base in sorted(bases)[:1]:
        slip = 1.0 - (1.0 - slowest.slip) * base
        said += (
            f"; if the line at {base * slowest.speed_rpm / 60.0:.4g} Hz is its shaft's, it slips by {100.0 * slip:.2g} "
            f"% at {base * slowest.speed_rpm:.4g} rpm"
        )
    return replace(found, speed_doubt=said)


def with_rivals(found: MotorFound | None, causes: Causes) -> MotorFound | None:
    """``found`` with the doubt of those of its mains lines beside which, by ``causes``, a second may be the mains."""
    if found is None:
        return None
    texts = {cause.text for cause in (*causes.orders.values(), *causes.tones)}
    seen = tuple(
        replace(item, also=(*item.also, OR_ANOTHER))
        if item.line.turns == 0.0 and f"{mains_words(item.line.mains)} or {OR_ANOTHER}" in texts
        else item
        for item in found.seen
    )
    return replace(found, seen=seen)


def _agrees(agreed: AgreedOrder) -> bool:
    """Whether an order stands on a turn of the shaft, or may, as well as a speed that was stated can tell."""
    nearest = round(agreed.order)
    if nearest < 1:
        return False
    if agreed.lock == "locked":
        return abs(agreed.order - nearest) < 1e-6
    reach = min(Z95 * agreed.order_error, Z95 * STATED_SPEED_ERROR * nearest)
    return agreed.lock == "undecided" and nearest <= MOST_TURNS and abs(agreed.order - nearest) <= reach
