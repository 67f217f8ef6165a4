"""Gas of an engine: pressure, force on a piston, torque on the crank by angle and order, and when each cylinder fires.

The one home of gas forces: balance, synthetic recordings and the causes of orders take them from here.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.definition import Cylinder, Engine, IdealCycle
from crankorder.engine.slider_crank import Angles, dead_centres, piston_drop, piston_velocity
from crankorder.errors import RequestError

SAMPLES_PER_REV = 1 << 14
"""Angles per revolution on which a torque is transformed: a straight-line curve's orders alias by order²/this²."""
NODES = 24
"""Gauss points of the integral over the heat that is released."""


def gas_force(engine: Engine, cycle_angle_rev: ArrayLike) -> Angles:
    """Force (N) of the gas on a piston, towards the crankshaft; as much acts on the cylinder head the other way.

    ``engine``: with a pressure curve or an ideal cycle and its bore; without any gas the force is zero.
    ``cycle_angle_rev``: revolutions from the cylinder's firing dead centre, any shape, repeated by cycles. Returns the
    shape of the angles.
    Raises RequestError for a torque curve: at the dead centres any force gives no torque, so a torque tells no force
    (truth sheet 4.2).
    """
    angles = np.asarray(cycle_angle_rev, dtype=np.float64)
    gas = engine.gas
    if gas is None:
        return np.zeros(angles.shape)
    if gas.torque_n_m is not None or engine.bore_m is None:
        problem = "a torque curve tells no gas force: at the dead centres any force makes no torque"
        raise RequestError(problem, place="gas", remedy="Give pressure_pa and bore_m for thrust and bearing loads")
    area = np.pi / 4 * engine.bore_m**2
    if gas.ideal is not None:
        exhaust_pa = gas.surroundings_pa if gas.ideal.exhaust_pa is None else gas.ideal.exhaust_pa
        pressure = _ideal_pressure(engine, gas.ideal, angles, area_m2=area, exhaust_pa=exhaust_pa)
    else:
        assert gas.pressure_pa is not None
        pressure = _interpolated(engine, angles, gas.pressure_pa)
    return (pressure - gas.surroundings_pa) * area


def gas_torque(engine: Engine, cycle_angle_rev: ArrayLike) -> Angles:
    """Torque (N·m) of one cylinder's gas on the crank, in the sense of rotation; finite everywhere.

    ``engine``: with a pressure or a torque curve or an ideal cycle; without any the torque is zero.
    ``cycle_angle_rev``: revolutions from the cylinder's firing dead centre (that of its crank, where there is an
    offset), any shape. Source: work of the gas, T = −F x', truth sheet 4.2: never F divided by anything.
    """
    angles = np.asarray(cycle_angle_rev, dtype=np.float64)
    if engine.gas is not None and engine.gas.torque_n_m is not None:
        return _interpolated(engine, angles, engine.gas.torque_n_m)
    return -gas_force(engine, angles) * piston_velocity(angles, engine.mechanism)


def gas_torque_by_order(engine: Engine, max_order: int) -> tuple[Angles, NDArray[np.complex128]]:
    """Orders and complex peak torque (N·m) of all cylinders' gas on the crank; half orders where a cycle has two turns.

    Each of shape (max_order · revolutions of a cycle + 1,); order 0 is the mean. A line is
    Re(torque · exp(2πi order rev)), rev the engine's crank angle. On the crankcase the gas puts this torque with the
    other sign about Y, and no force.

    ``engine``: with gas and, where it has several cylinders, their ``firing_deg``. ``max_order``: ≥ 1.
    Raises RequestError without firing angles.
    """
    cycle = engine.revs_per_cycle
    lines = np.arange(max_order * cycle + 1)
    total = np.zeros(lines.size, dtype=np.complex128)
    alone: dict[float, NDArray[np.complex128]] = {}
    for single, cylinder in zip(engine.each, engine.cylinders, strict=True):
        if single.offset_m not in alone:
            alone[single.offset_m] = _spectrum(single)[lines]
        fires = firing_angle_deg(engine, cylinder) / 360
        total += alone[single.offset_m] * np.exp(-2j * np.pi * np.mod(fires / cycle * lines, 1))
    return lines / cycle, total


@lru_cache(maxsize=8)
def _spectrum(engine: Engine) -> NDArray[np.complex128]:
    """Gas torque of one cylinder by line of its cycle; the same for every speed, so it is kept."""
    angles = np.arange(engine.revs_per_cycle * SAMPLES_PER_REV) / SAMPLES_PER_REV
    torque: NDArray[np.complex128] = 2 * np.fft.rfft(gas_torque(engine, angles)) / angles.size
    torque[0] /= 2
    torque.flags.writeable = False
    return torque


def firing_angle_deg(engine: Engine, cylinder: Cylinder) -> float:
    """Engine crank angle (degrees within the cycle) of the firing dead centre of ``cylinder`` of ``engine``.

    An engine of one cylinder, and one that fires every revolution, needs no ``firing_deg``: it fires when its pin
    stands along its axis. Raises RequestError where it is needed and missing.
    """
    if cylinder.firing_deg is not None:
        return cylinder.firing_deg
    if len(engine.cylinders) > 1 and engine.revs_per_cycle > 1:
        remedy = "Give firing_deg for every cylinder"
        raise RequestError("which revolution does each cylinder fire in?", place="cylinders", remedy=remedy)
    return (cylinder.bank_deg - cylinder.crank_deg) % 360


def firing_intervals_deg(engine: Engine) -> tuple[float, ...]:
    """Crank angles from one firing of ``engine`` to the next, from the first after crank angle 0; their sum is a cycle.

    Cylinders that fire together have an interval of 0. Raises RequestError where a firing angle is missing.
    """
    cycle = 360.0 * engine.revs_per_cycle
    fires = sorted(firing_angle_deg(engine, cylinder) % cycle for cylinder in engine.cylinders)
    return tuple(after - before for before, after in zip(fires, [*fires[1:], fires[0] + cycle], strict=True))


def _interpolated(engine: Engine, cycle_angle_rev: Angles, values: tuple[float, ...]) -> Angles:
    assert engine.gas is not None and engine.gas.crank_angle_deg is not None  # a curve has its angles
    period_deg = 360.0 * engine.revs_per_cycle
    return np.interp(360 * cycle_angle_rev, engine.gas.crank_angle_deg, values, period=period_deg)


def _ideal_pressure(
    engine: Engine, cycle: IdealCycle, cycle_angle_rev: Angles, *, area_m2: float, exhaust_pa: float
) -> Angles:
    """Absolute pressure (Pa) of an ideal cycle, from the piston's own dead centres.

    In the closed part p Vⁿ = p₀ V₀ⁿ + (n − 1) ∫ Vⁿ⁻¹ dQ. Source: first law for an ideal gas; C. R. Ferguson and A. T.
    Kirkpatrick (2001), Internal Combustion Engines, sections 2.3 (constant volume) and 2.6 (finite heat release).
    """
    centres, revs, exponent = dead_centres(engine.mechanism), engine.revs_per_cycle, cycle.exponent
    clearance = area_m2 * centres.stroke_m / (cycle.compression_ratio - 1)

    def volume(angle_rev: Angles) -> Angles:
        drop: Angles = piston_drop(angle_rev, engine.mechanism) - piston_drop(centres.top_rev, engine.mechanism)
        return clearance + area_m2 * drop

    start, length = centres.top_rev + cycle.burn_start_deg / 360, cycle.burn_duration_deg / 360
    opened = centres.bottom_rev - 1
    angle = opened + np.mod(cycle_angle_rev - opened, revs)  # from the start of compression, one cycle long
    burnt = np.zeros(angle.shape)
    if length == 0:
        burnt[angle >= start] = float(volume(np.array(start))) ** (exponent - 1)
    else:
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        after = angle >= start + length
        during = (angle > start) & ~after
        share = np.append((angle[during] - start) / length, 1.0)  # the last one: all of it
        sums = np.zeros(share.size)
        for node, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
            at = share * node
            rate = share * (np.pi / 2) * np.sin(np.pi * at)
            sums += weight * rate * volume(start + length * at) ** (exponent - 1)
        burnt[during], burnt[after] = sums[:-1], sums[-1]
    compressed = cycle.intake_pa * (clearance + area_m2 * centres.stroke_m) ** exponent
    closed = (compressed + (exponent - 1) * cycle.heat_j * burnt) / volume(angle) ** exponent
    exchange = np.where(angle < centres.top_rev + 1, exhaust_pa, cycle.intake_pa)
    return np.where(angle < centres.bottom_rev, closed, exchange)
