"""What of a motor is doubtful: a slip by a speed with which no line of its shaft agrees, mains beside another line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from crankorder.engine.motor import BAR_PASS
from crankorder.identify.explain import Causes
from crankorder.identify.explain_families import BY_ITSELF
from crankorder.identify.found import AgreedOrder
from crankorder.identify.intervals import Z95
from crankorder.identify.lines.order_lock import NUMBERS as ORDER_LOCK
from crankorder.identify.lines.order_lock import speed_source
from crankorder.identify.mains import mains_words
from crankorder.identify.motor_speed import NUMBERS as MOTOR_SPEED
from crankorder.identify.motor_speed import SpeedRead
from crankorder.identify.motors import MotorFound, MotorSpeed
from crankorder.identify.one_mains import OR_ANOTHER
from crankorder.identify.said import IF_WRONG
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="motor_doubts"):
    most_turns: int
    least_bars: int
    side_reach_orders: float


NUMBERS = _Numbers.load()

THE_FIELDS = "that of the field, behind which the shaft of every motor lags"
"""What is said of a stated speed from which no slip can follow."""


def with_speed_judged(
    found: MotorFound | None,
    orders: Sequence[AgreedOrder],
    causes: Causes,
    order_map: xr.Dataset,
    doubt: str | None,
    read: SpeedRead | None = None,
) -> MotorFound | None:
    """``found`` with its slip by the speed that was ``read`` off its lines, or with the reason why that is not known.

    That is a speed in ``doubt``, or one that was only stated with which none of the ``orders`` (explained by
    ``causes``, of the test of ``order_map``) agrees, or from which no slip can follow as it is that of the field.
    """
    if found is None or not found.speeds:
        return found
    if doubt is not None:
        return found if found.misfit else replace(found, speed_doubt="the speed is in doubt")
    if read is not None:
        return _as_read(found, read)
    if found.misfit or speed_source([order_map]) != "stated":
        return found
    if any(
        abs(one.speed_rpm * found.motor.shaft_ratio / _field_rpm(found) - 1.0) < MOTOR_SPEED.rated_share
        for one in found.speeds
    ):
        return replace(found, speed_doubt=f"the stated speed is {THE_FIELDS}, and no line of the shaft tells its own")
    if any(_agrees(one) for one in orders):
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


def _field_rpm(found: MotorFound) -> float:
    """Speed of the field at the supply that was stated, in rpm."""
    return found.motor.synchronous_rpm(float(found.motor.supply_hz or found.supply_hz or np.nan))


def _as_read(found: MotorFound, read: SpeedRead) -> MotorFound:
    """``found`` at the speed that was ``read``: its slip where the stated one agrees, else what it would be."""
    if read.supply is not None:
        hertz, error = read.supply
        found = replace(found, supply_hz=hertz, supply_half_hz=Z95 * max(error, 1e-6), measured=True)
    supply = float(found.supply_hz or np.nan)
    synchronous = found.motor.synchronous_rpm(supply)
    slip = 1.0 - read.rpm * found.motor.shaft_ratio / synchronous
    half = float(np.hypot(found.supply_half_hz / supply, Z95 * read.error_rpm / read.rpm))
    if read.agrees:
        return replace(found, misfit="", speeds=(MotorSpeed(read.rpm, synchronous, slip, half, 2.0 * slip * supply),))
    of_field = abs(read.stated_rpm * found.motor.shaft_ratio / _field_rpm(found) - 1.0) < MOTOR_SPEED.rated_share
    why = f"the stated speed is {THE_FIELDS}" if of_field else "no line of the shaft agrees with the stated speed"
    said = (
        f"{why}; {read.words}: if the line at {read.hertz:.4g} Hz is its shaft's, it slips by {100.0 * slip:.2g} % at "
        f"{read.rpm:.4g} rpm"
    )
    return replace(found, misfit="", speed_doubt=said)


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


def with_bars_judged(
    found: MotorFound | None, orders: Sequence[AgreedOrder], causes: Causes, order_map: xr.Dataset
) -> MotorFound | None:
    """``found`` with the doubt of its stated ``rotor_bars``, where no bar pass stands there and another count has one.

    Bars that pass stand at a whole order of the rotor, with twice mains on both sides of it: that tells another count.
    A single whole order so high without such sides says only what the count would be if it were that. ``orders``,
    their ``causes`` and the OrderMap ``order_map`` are those of the test.
    """
    if found is None or found.motor.rotor_bars is None or found.misfit or found.speed_doubt:
        return found
    ratio, stated = found.motor.shaft_ratio, found.motor.rotor_bars
    in_band = stated * ratio < float(order_map["order"].values[-1])
    if not in_band or any(item.line.name.endswith(BAR_PASS) for item in found.seen):
        return found
    counts = {
        round(one.order / ratio): one
        for one in orders
        if one.lock == "locked" and _is_bare(one, causes) and abs(one.order / ratio - round(one.order / ratio)) < 1e-6
    }
    high = {count: one for count, one in counts.items() if count >= NUMBERS.least_bars and count != stated}
    paired = [count for count, one in high.items() if _has_sides(one, orders, found.supply_hz)]
    nothing = f"no bar pass stands at order {stated * ratio:.4g}, where {stated} bars as stated would put it"
    if len(paired) == 1:
        at = paired[0] * ratio
        said = f"{nothing}; order {at:.4g} stands with twice mains on both sides, as that of {paired[0]} bars would"
        return replace(found, bars_doubt=said)
    if len(high) == 1 and not paired:
        (count,) = high
        return replace(found, bars_doubt=f"{nothing}; if order {count * ratio:.4g} is the bar pass, there are {count}")
    return found


def _is_bare(agreed: AgreedOrder, causes: Causes) -> bool:
    """Whether nothing but that it is an order of the shaft is known of a line."""
    return all(causes.orders[line.channel, agreed.order].text in BY_ITSELF for line in agreed.lines)


def _has_sides(carrier: AgreedOrder, orders: Sequence[AgreedOrder], supply_hz: float | None) -> bool:
    """Whether lines stand at twice the supply on both sides of ``carrier``, at one speed."""
    sides: dict[int, set[float]] = {-1: set(), 1: set()}
    for one in orders:
        for rpm in {float(rpm) for line in one.lines for rpm in line.speed_rpm} if supply_hz else ():
            for side, speeds in sides.items():
                away = abs(one.order - carrier.order - side * 2.0 * float(supply_hz or 0.0) * 60.0 / rpm)
                if away <= max(NUMBERS.side_reach_orders, Z95 * one.order_error):
                    speeds.add(rpm)
    return bool(sides[-1] & sides[1])


def _agrees(agreed: AgreedOrder) -> bool:
    """Whether an order stands on a turn of the shaft, or may, as well as a speed that was stated can tell."""
    nearest = round(agreed.order)
    if nearest < 1:
        return False
    if agreed.lock == "locked":
        return abs(agreed.order - nearest) < 1e-6
    reach = min(Z95 * agreed.order_error, Z95 * ORDER_LOCK.stated_speed_error * nearest)
    return agreed.lock == "undecided" and nearest <= NUMBERS.most_turns and abs(agreed.order - nearest) <= reach
