"""Orders that go with the speed: a line of fixed frequency, an order at one speed alone, meets no natural frequency."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crankorder.identify.explain import NOT_KNOWN, Causes
from crankorder.identify.found import AgreedOrder
from crankorder.identify.said import NUMBERS as SAID
from crankorder.identify.said import is_electric


def going_with_speed(orders: Sequence[AgreedOrder], causes: Causes) -> tuple[AgreedOrder, ...]:
    """Those of ``orders``, explained by ``causes``, that move with the speed: only these can meet something elsewhere.

    Not those of the mains and of a motor's field; nor, seen at one speed alone, those that no cause and no lock binds
    to the shaft: there nothing tells an order from a line that stays.
    """
    return tuple(one for one in orders if not _stays(one, causes))


def _stays(agreed: AgreedOrder, causes: Causes) -> bool:
    """Whether a line stays where it is when the speed moves, or nothing tells that it would not."""
    texts = [causes.orders[line.channel, agreed.order].text for line in agreed.lines]
    if any(is_electric(text) for text in texts):
        return True
    speeds = np.concatenate([line.speed_rpm for line in agreed.lines])
    at_one = bool(len(speeds)) and bool(speeds.max() <= SAID.alike_speeds_ratio * speeds.min())
    return at_one and agreed.lock != "locked" and all(_says_nothing(text) for text in texts)


def _says_nothing(text: str) -> bool:
    return text in NOT_KNOWN or text.startswith("sideband of") or "mains" in text
