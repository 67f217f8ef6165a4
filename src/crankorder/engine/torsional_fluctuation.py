"""How unevenly a crank turns within its cycle: its lag, from torques on a flywheel or from its speed by crank angle."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.definition import Engine
from crankorder.engine.forces import gas_torque_by_order, inertia_torque
from crankorder.engine.slider_crank import Complex
from crankorder.errors import RequestError

Floats = NDArray[np.float64]

SHORTEST_STEP = 1e-4
"""Finest step that orders of a lag may share."""
TOP_ORDER = 20
"""Highest order of the torque that moves the flywheel: what is above turns it by less than a millionth of these."""
SLOWEST_SHARE = 0.1
"""Of the mean speed: a shaft that falls below it within the cycle counts as one that stops."""
NOTHING = 1e-15
"""Of the mean speed: lines of the uneven speed below it are left out."""
MOST_ANGLES = 1 << 22


@dataclass(frozen=True, kw_only=True, eq=False)
class Lag:
    """In-cycle motion: how far the crank is behind an even rotation, by order of the crank angle itself.

    mean angle = crank angle + Re Σ (inertia + gas · (reference_rpm / mean speed)²) · exp(2πi order crank_angle). The
    torque of the masses grows with speed squared, as the energy of the flywheel does: their part is the same at every
    speed. ``order``: (k,), ascending, > 0. ``inertia``, ``gas``: complex (k,), rev. ``reference_rpm``: mean speed of
    the gas part, > 0.
    """

    order: Floats
    inertia: Complex
    gas: Complex
    reference_rpm: float = 1.0

    def __post_init__(self) -> None:
        sound = len(self.order) == len(self.inertia) == len(self.gas) and bool(np.all(np.diff(self.order) > 0))
        if not sound or np.any(np.asarray(self.order) <= 0) or not self.reference_rpm > 0:
            raise RequestError("no such lag", place="lag", allowed="ascending orders above 0, two parts of each")

    @property
    def has_gas(self) -> bool:
        """Whether some of the lag depends on the speed."""
        return bool(np.any(self.gas))

    def by_order(self, speed_rpm: float) -> Complex:
        """Complex lag (rev) of each order, shape (k,), at the mean ``speed_rpm`` (rpm, not 0 where there is gas)."""
        return self.inertia + self.gas * (self.reference_rpm / speed_rpm) ** 2 if self.has_gas else self.inertia + 0

    def at(self, crank_angle_rev: ArrayLike, speed_rpm: float) -> Floats:
        """Lag (rev) at ``crank_angle_rev`` (any shape) and the mean ``speed_rpm``: mean less crank angle."""
        turned = np.exp(2j * np.pi * np.asarray(crank_angle_rev, dtype=np.float64)[..., None] * self.order)
        return np.asarray((turned @ self.by_order(speed_rpm)).real)

    @cached_property
    def step(self) -> float:
        """Largest order of which all orders are whole multiples; 0 where there is none (or none above 0.0001)."""
        shared = Fraction(0)
        for order in map(float, self.order):
            near = Fraction(order).limit_denominator(round(1 / SHORTEST_STEP))
            if abs(order - near) > 1e-12 * order:
                return 0.0
            shared = Fraction(
                math.gcd(shared.numerator * near.denominator, near.numerator * shared.denominator),
                shared.denominator * near.denominator,
            )
        return float(shared) if shared >= SHORTEST_STEP else 0.0

    @cached_property
    def slowest_rpm(self) -> float:
        """Mean speed at and below which the shaft would stop within the cycle: 0 without gas, inf where it always does.

        Taken at 64 angles for each period of the highest order.
        """
        inertia, gas = 1 + self._slope(self.inertia), self._slope(self.gas)
        if inertia.min() <= 0:
            return math.inf
        return self.reference_rpm * math.sqrt(max(0.0, float(np.max(-gas / inertia))))

    def _slope(self, part: Complex) -> Floats:
        """Slope of a part of the lag over the crank angle, at 64 angles for each period of the highest order."""
        if not np.any(part):
            return np.zeros(1)
        rise = part * (2j * np.pi * self.order)
        if self.step:
            line = np.rint(self.order / self.step).astype(int)
            lines = np.zeros(line[-1] + 1, dtype=np.complex128)
            lines[line] = rise
            return over_a_cycle(lines, 64 * line[-1])
        angle = np.linspace(0, 64, 1 + math.ceil(64 * 64 * max(1.0, self.order[-1])))
        slope = np.zeros(angle.size)
        for order, size in zip(self.order, rise, strict=True):
            slope += (size * np.exp(2j * np.pi * order * angle)).real
        return slope

    def fluctuation(self, speed_rpm: float) -> float:
        """Highest less lowest speed within the cycle over the mean ``speed_rpm``, at 64 angles of the highest order."""
        change = self._slope(self.by_order(speed_rpm))
        speed = 1 / (1 + change)  # the lag is that of mean speed over speed
        return float(speed.max() - speed.min())

    def check(self, speed_rpm: float) -> None:
        """Raise RequestError where the shaft would stop within the cycle at the mean ``speed_rpm``, either way."""
        if math.isinf(self.slowest_rpm) or abs(speed_rpm) <= self.slowest_rpm > 0:
            raise stops_within_cycle(speed_rpm, self.slowest_rpm)


def lag_from_torque(
    engine: Engine, *, flywheel_inertia_kg_m2: float, speed_rpm: float, with_gas: bool, highest_order: float = TOP_ORDER
) -> Lag:
    """Lag of the crank of ``engine`` whose masses, and gas, work on a flywheel: ½ I ω² = constant + ∫ torque dφ.

    The torque is that at the steady ``speed_rpm``: ω_mean² times the masses' torque over ω² of all cylinders, plus the
    gas torque less its mean, which the load takes. The constant is such that a cycle takes as long as at the mean
    speed: the mean is over time. The lag follows from 1/ω as it is, not from its linear part.

    At ``speed_rpm``, the lag's ``reference_rpm``, inertia and gas parts together are exact. The inertia part is exact
    without gas, so at any speed where ``with_gas`` is false; the gas part is the rest. At another mean speed n the gas
    part goes with (speed_rpm / n)², as its work over ω² does: exact to first order of the irregularity.

    ``engine``: lengths, masses, cylinders and gas. ``flywheel_inertia_kg_m2``: I, of all that turns with the crank,
    > 0. ``speed_rpm``: > 0. ``highest_order``: of the torque, ≥ 1. ``with_gas``: whether the gas works too.
    Raises RequestError where the shaft would stop, that is fall below a tenth of its mean speed, within the cycle,
    and where there is no gas to work.
    Source: energy, T dφ = d(½ I ω²), with the torque of :func:`crankorder.engine.forces.inertia_torque_by_order`.
    """
    if with_gas and engine.gas is None:
        remedy = "Give the engine a [gas] or leave out gas_torque"
        raise RequestError("the engine has no gas", place="gas", remedy=remedy)
    omega = speed_rpm * math.pi / 30
    cycle = engine.revs_per_cycle if with_gas else 1
    masses = np.zeros(math.floor(highest_order * cycle) + 1, dtype=np.complex128)
    of_masses = inertia_torque(engine, max(1, math.floor(highest_order)))
    masses[::cycle] = of_masses[: masses[::cycle].size]
    gas = np.zeros_like(masses)
    if with_gas:
        gas = gas_torque_by_order(engine, math.ceil(highest_order))[1][: masses.size] / omega**2
    orders = np.arange(masses.size) / cycle
    work = [_work(torque, orders) * 2 / flywheel_inertia_kg_m2 for torque in (masses, masses + gas)]
    inertia, both = _resolved(lambda n_angles: [_rise(over_a_cycle(energy, n_angles)) for energy in work], masses.size)
    return _lag(inertia, both - inertia if with_gas else np.zeros_like(both), 1 / cycle, speed_rpm)


def lag_of_speed(speed: Complex, *, step: float) -> Lag:
    """Lag of a shaft whose speed is Ω · (1 + Re Σ speed_k · exp(2πi k step crank_angle)), at any mean speed.

    Ω is the mean of the speed over the crank angle; the mean over time is a little lower, and the mean speed of the
    motion is this one.

    ``speed``: complex (k,), share of the mean speed at 0, 1, 2, … steps. ``step``: order of one step, > 0. Raises
    RequestError where the speed falls below a tenth of its mean.
    """

    def rise(n_angles: int) -> list[Floats]:
        even = over_a_cycle(speed, n_angles)
        if even.min() <= SLOWEST_SHARE - 1:
            raise _too_slow(1 + float(even.min()), "by_order")
        slowness = 1 / (1 + even)
        return [slowness / slowness.mean()]

    (lines,) = _resolved(rise, speed.size)
    return _lag(lines, np.zeros_like(lines), step, 1.0)


def stops_within_cycle(speed_rpm: float, slowest_rpm: float) -> RequestError:
    """Error of a shaft whose lag stops it at the mean ``speed_rpm``, not above the lag's ``slowest_rpm``."""
    allowed = "no speed" if math.isinf(slowest_rpm) else f"steady speeds above {slowest_rpm:.6g} rpm"
    return _stops("in-cycle speed", f"a mean speed of {speed_rpm:g} rpm", allowed)


def _stops(place: str, found: str, allowed: str) -> RequestError:
    remedy = "Take a larger flywheel, a higher speed or less in-cycle speed"
    problem = "the shaft would stop within the cycle"
    return RequestError(problem, place=place, found=found, allowed=allowed, remedy=remedy)


def _work(torque: Complex, orders: Floats) -> Complex:
    """∫ torque dφ by order, without its mean."""
    work = np.zeros_like(torque)
    work[1:] = torque[1:] / (1j * orders[1:])
    return work


def _rise(energy: Floats) -> Floats:
    """Mean speed over speed at the angles of a cycle, from the change of ω²/ω_mean² without its mean; its mean is 1."""
    least = float(energy.min())
    level = max(1.0, SLOWEST_SHARE**2 - least)
    lost = level + least <= 0  # what is left of the speed is round-off of so large a swing
    if lost or (np.mean(1 / np.sqrt(level + energy)) < 1 - 1e-9 and level > 1):
        raise _too_slow(SLOWEST_SHARE, "flywheel_inertia_kg_m2")
    for _ in range(100):  # Newton from the left of a falling convex curve: never beyond its zero
        squared = level + energy
        missing = float(np.mean(squared**-0.5)) - 1
        move = 2 * missing / float(np.mean(squared**-1.5))
        level += move
        if abs(move) <= 1e-16 * level:
            break
    return 1 / np.sqrt(level + energy)


def _resolved(rises: Callable[[int], list[Floats]], n_lines: int) -> list[Complex]:
    """Lines of the curves that ``rises`` gives over a cycle of so many angles, doubled until the upper half is nothing.

    ``n_lines``: of the torque or speed that makes them.
    """
    n_angles = 1 << max(10, math.ceil(math.log2(16 * n_lines)))
    while True:
        every = [np.fft.rfft(values) * (2 / n_angles) for values in rises(n_angles)]
        for lines in every:
            lines[0] /= 2
        if n_angles >= MOST_ANGLES or all(np.abs(lines[lines.size // 2 :]).max() <= NOTHING for lines in every):
            return every
        n_angles *= 2


def over_a_cycle(lines: Complex, n_angles: int) -> Floats:
    """Re Σ lines_k · exp(2πi k j / n) for j = 0 … n − 1, n = ``n_angles``, shape (n,); ``lines``: at most n/2 + 1."""
    padded = np.zeros(n_angles // 2 + 1, dtype=np.complex128)
    padded[: lines.size] = lines
    padded[1:] /= 2
    return np.fft.irfft(padded, n_angles) * n_angles


def _lag(inertia: Complex, gas: Complex, step: float, reference_rpm: float) -> Lag:
    """Lag from the lines of mean speed over speed: their integral over the crank angle."""
    kept = np.flatnonzero(np.maximum(np.abs(inertia), np.abs(gas)) > NOTHING)
    kept = kept[kept > 0]
    order = kept.astype(np.float64) * step
    turned = 2j * np.pi * order
    return Lag(order=order, inertia=inertia[kept] / turned, gas=gas[kept] / turned, reference_rpm=reference_rpm)


def _too_slow(share: float, place: str) -> RequestError:
    found = f"a slowest speed at or below {100 * share:.3g} % of the mean"
    return _stops(place, found, f"above {100 * SLOWEST_SHARE:g} %")
