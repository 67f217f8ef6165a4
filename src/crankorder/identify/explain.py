"""What makes a line: engine kinematics, a bearing, the gas cycle, mains, or nothing known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from crankorder.engine.bearings import Bearing, bearing_orders
from crankorder.settings import IdentifySettings

HALF_ORDER_QUANTITIES = ("pressure",)
"""In these quantities every half order is the gas cycle of a four-stroke engine itself."""


SPEED_SPREAD = 0.01
"""Share by which the speed of a steady recording wanders, and with it the frequency of an order."""


@dataclass(frozen=True)
class Sources:
    """What is known of the machine: its cycle, the orders that its kinematics make, its bearings."""

    revs_per_cycle: int
    engine_orders: tuple[float, ...] = ()
    bearings: tuple[Bearing, ...] = ()
    known_bearing_orders: dict[tuple[str, str], float] = field(init=False)

    def __post_init__(self) -> None:
        orders = {(b.name, line): order for b in self.bearings for line, order in bearing_orders(b).items()}
        object.__setattr__(self, "known_bearing_orders", orders)


def explain_order(order: float, error: float, quantity: str, sources: Sources, *, settings: IdentifySettings) -> str:
    """What explains a line at ``order`` (with its standard ``error``) in a channel of ``quantity``: one phrase.

    ``sources`` says what the machine has; a match is closer than ``settings.order_match`` or three standard errors.
    ``"unexplained"`` where nothing known makes it.
    """
    reach = max(settings.order_match, 3.0 * error)
    bearings = [key for key, known in sources.known_bearing_orders.items() if abs(order - known) < reach]
    whole = abs(order - round(order)) < reach
    half = abs(2 * order - round(2 * order)) < 2 * reach
    if any(abs(order - known) < reach for known in sources.engine_orders):
        return "engine kinematics"
    if quantity in HALF_ORDER_QUANTITIES and (whole or half):
        return "gas cycle"
    if bearings:
        return "bearing " + ", ".join(f"{name} {line}" for name, line in bearings)
    if whole and round(order) == 1:
        return "unbalance"
    if whole and not sources.engine_orders:
        return "shaft harmonic"
    if half and not whole and sources.revs_per_cycle == 2 and not sources.engine_orders:
        return "half order of the four-stroke cycle"
    return "unexplained"


def explain_fixed(
    frequency_hz: float,
    width_hz: float,
    *,
    speed_rpm: NDArray[np.float64],
    revs_per_cycle: int,
    settings: IdentifySettings,
) -> str:
    """What a line of fixed frequency is: "mode", "mains", "tone", or "order" where the speeds are too alike to tell.

    ``frequency_hz`` is the line's frequency, ``width_hz`` its half-power width (0 for a tone), ``speed_rpm`` the
    speeds of the map, ``revs_per_cycle`` what half orders are multiples of; ``settings`` name the mains frequencies,
    how far they wander and the spread of speeds that tells an order from a mode.
    """
    if speed_rpm.max() < settings.mode_speed_ratio * speed_rpm.min():
        step = float(np.median(speed_rpm)) / 60.0 / revs_per_cycle
        spread = 0.5 * np.ptp(speed_rpm) / np.median(speed_rpm) * frequency_hz
        if abs(frequency_hz - step * max(1, round(frequency_hz / step))) <= spread + SPEED_SPREAD * frequency_hz:
            return "order"
    if width_hz > 0.0:
        return "mode"
    for mains in settings.mains_hz:
        multiple = max(1, round(frequency_hz / mains))
        if abs(frequency_hz - multiple * mains) <= settings.mains_tolerance_hz * float(np.sqrt(multiple)):
            return "mains"
    return "tone"
