"""Swing of the shaft's own speed within its cycle, by order: how unevenly an engine turns."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.settings import ShaftSettings
from crankorder.shaft.pulses import Remark
from crankorder.shaft.tooth_errors import HIGHEST_MOTION, TOOTH_DOUBT, TOOTH_ORDER

Floats = NDArray[np.float64]

HIGHEST = 12.0
"""Order up to which the swing is told: gas and inertia of a few cylinders lie below."""

KNOTS_PER_PERIOD = 2.5
"""An order is told where angle and speed are known so many times a period of it, or more often."""

SURE = 5.0
"""Standard errors of the mean cycle that a swing must exceed: a test has many orders and recordings."""

LEAST_SHARE = 0.0005
"""Of the mean speed: a smaller swing is not worth mention, and within what encoders err."""

BETWEEN = 8
"""Places at which the speed is taken from one knot to the next."""

FEWEST_CYCLES = 2
"""Whole cycles of a recording from which on its swing is told."""


@dataclass(frozen=True)
class SpeedSwing:
    """Peak amplitudes (rpm) of a speed at ``orders``, about its mean ``speed_rpm``, over ``cycles`` whole cycles.

    ``amplitude_rpm`` (orders,) is the root of the mean square over the cycles, what differs from cycle to cycle
    included; ``steady_rpm`` (orders,) is that of the mean cycle; ``doubt_rpm`` (orders,) is what the teeth of the wheel
    may make of it.
    """

    speed_rpm: float
    cycles: int
    orders: Floats
    amplitude_rpm: Floats
    steady_rpm: Floats
    doubt_rpm: Floats

    @property
    def told(self) -> NDArray[np.bool_]:
        """Which ``orders`` swing for certain: far more than the cycles scatter or teeth make, and worth mention."""
        scatter = np.sqrt(np.maximum(self.amplitude_rpm**2 - self.steady_rpm**2, 0.0) / self.cycles)
        sure = (self.steady_rpm > SURE * scatter) & (self.steady_rpm > self.doubt_rpm)
        return sure & (self.steady_rpm > LEAST_SHARE * self.speed_rpm)


WHOLE = 1e-6
"""An order of the encoder this close to a whole number is one."""


def speed_swing(shaft: xr.Dataset) -> SpeedSwing | None:
    """Swing of the speed of ``shaft`` (ShaftAngle) at the multiples of its cycle's order; None where it is not known.

    It is not without pulses, in fewer than FEWEST_CYCLES whole cycles, and where a standstill or a reversal leaves no
    angle that grows. The trend over each cycle is taken out, so that a run-up is no swing. Orders reach to HIGHEST, to
    those that the knots resolve, and to the cut-off of the smoother where it says one.
    """
    knots = np.array([shaft[name].values for name in ("time", "crank_angle", "speed")], dtype=float)
    time, angle, speed = knots[:, np.isfinite(knots).all(axis=0)]
    cycle = int(shaft.attrs.get("revs_per_cycle", 1))
    if float(shaft.attrs.get("n_pulses", 0)) <= 0 or len(angle) < 3 or not (np.diff(angle) > 0.0).all():
        return None
    cycles = int((angle[-1] - angle[0]) / cycle + 1e-9)
    per_rev = (len(angle) - 1) / (angle[-1] - angle[0])
    cut_off = float(shaft.attrs.get("cut_off_order", np.inf))
    highest = min(HIGHEST, per_rev / KNOTS_PER_PERIOD, cut_off if cut_off > 0.0 else np.inf)
    orders = np.arange(1, int(highest * cycle + 1e-9) + 1) / cycle
    if cycles < FEWEST_CYCLES or not orders.size:
        return None
    made = _swing(*_between(time, angle, speed), orders, cycles=cycles, revs=cycle, per_rev=per_rev)
    return replace(made, doubt_rpm=_of_teeth(shaft, orders) * made.speed_rpm)


def swing_remarks(shaft: xr.Dataset, settings: ShaftSettings) -> list[Remark]:
    """Remark where the speed of ``shaft`` swings at high orders by more than ``settings`` say a shaft can."""
    swing = speed_swing(shaft)
    if swing is None:
        return []
    high = swing.told & (swing.orders > HIGHEST_MOTION)
    share = 100.0 * swing.steady_rpm / swing.speed_rpm
    beyond = float(np.sqrt(np.sum(np.square(share[high]))))
    if not beyond > settings.largest_swing_percent:
        return []
    total, low = (float(np.sqrt(np.sum(np.square(share[kept])))) for kept in (swing.told, swing.told & ~high))
    detail = (
        f"the speed within the revolution swings by {total:.2g} %, of that {beyond:.2g} % above order "
        f"{HIGHEST_MOTION:g}: more than a shaft can; teeth of the wheel that sit wrongly? What the shaft swings is "
        f"between 0 and {low:.2g} %; orders beside strong ones may be made by it. Record more revolutions to tell"
    )
    return [("encoder_tooth_errors_likely", "suspect", detail)]


def _of_teeth(shaft: xr.Dataset, orders: Floats) -> Floats:
    """Share of the speed that the teeth of the wheel of ``shaft`` may make swing at each of ``orders``, at most."""
    doubt, every = float(shaft.attrs.get(TOOTH_DOUBT, 0.0)), float(shaft.attrs.get(TOOTH_ORDER, 0.0))
    if not every > 0.0:
        return np.zeros(len(orders))
    of_wheel = np.abs(orders / every - np.round(orders / every)) < WHOLE
    return np.where(of_wheel, 2.0 * np.pi * orders * doubt, 0.0)


def _between(time: Floats, angle: Floats, speed: Floats) -> tuple[Floats, Floats]:
    """Angle (rev) and speed (rpm) also between the knots, by the cubics that the angle follows there."""
    step, turned, hertz = np.diff(time)[:, None], np.diff(angle)[:, None], speed / 60.0
    at, first, last = np.arange(BETWEEN) / BETWEEN, hertz[:-1, None], hertz[1:, None]
    moved = turned * (3 * at**2 - 2 * at**3) + step * (first * at * (1 - at) ** 2 - last * at**2 * (1 - at))
    rate = turned / step * 6 * at * (1 - at) + first * (1 - at) * (1 - 3 * at) - last * at * (2 - 3 * at)
    return np.append((angle[:-1, None] + moved).ravel(), angle[-1]), np.append(60.0 * rate.ravel(), speed[-1])


def _swing(angle: Floats, speed: Floats, orders: Floats, *, cycles: int, revs: int, per_rev: float) -> SpeedSwing:
    steps = int(np.ceil(2.0 * max(per_rev, 2.0 * HIGHEST) * revs))
    place = (np.arange(steps) + 0.5) / steps * revs
    at = angle[0] + revs * np.arange(cycles)[:, None] + place
    value = np.interp(at, angle, speed)
    # from cycle to cycle: a slope fitted within one would take the swing at its own order along
    means = value.mean(axis=1)
    value = value - means[:, None] - np.gradient(means)[:, None] * (place / revs - 0.5)
    lines = 2.0 / steps * value @ np.exp(-2j * np.pi * np.outer(place, orders))
    return SpeedSwing(
        speed_rpm=float(means.mean()),
        cycles=cycles,
        orders=orders,
        amplitude_rpm=np.sqrt((np.abs(lines) ** 2).mean(axis=0)),
        steady_rpm=np.abs(lines.mean(axis=0)),
        doubt_rpm=np.zeros(len(orders)),
    )
