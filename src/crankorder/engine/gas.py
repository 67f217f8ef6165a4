"""Gas force and gas torque from a pressure trace or a torque curve."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.definition import Cylinder, Engine
from crankorder.engine.slider_crank import piston_velocity
from crankorder.errors import RequestError

Angles = NDArray[np.float64]

SAMPLES_PER_REV = 1 << 14
"""Angles per revolution on which a torque is transformed: a straight-line curve's orders alias by order²/this²."""


def gas_force(engine: Engine, cycle_angle_rev: ArrayLike) -> Angles:
    """Force (N) of the gas on a piston, towards the crankshaft; as much acts on the cylinder head the other way.

    ``engine``: with a pressure curve and its bore; without any gas the force is zero. ``cycle_angle_rev``: revolutions
    from the cylinder's firing dead centre, any shape, repeated by cycles. Returns the shape of the angles.
    Raises RequestError for a torque curve: at the dead centres any force gives no torque, so a torque tells no force
    (truth sheet 4.2).
    """
    angles = np.asarray(cycle_angle_rev, dtype=np.float64)
    if engine.gas is None:
        return np.zeros(angles.shape)
    if engine.gas.pressure_pa is None or engine.bore_m is None:
        raise RequestError(
            "a torque curve tells no gas force: at the dead centres any force makes no torque",
            place="gas",
            remedy="Give pressure_pa and bore_m for thrust and bearing loads",
        )
    pressure = _interpolated(engine, angles, engine.gas.pressure_pa)
    force: Angles = (pressure - engine.gas.surroundings_pa) * (np.pi / 4 * engine.bore_m**2)
    return force


def gas_torque(engine: Engine, cycle_angle_rev: ArrayLike) -> Angles:
    """Torque (N·m) of one cylinder's gas on the crank, in the sense of rotation; finite everywhere.

    ``engine``: with a pressure or a torque curve; without any the torque is zero. ``cycle_angle_rev``: revolutions from
    the cylinder's firing dead centre (that of its crank, where there is an offset), any shape.
    Source: work of the gas, T = −F x', truth sheet 4.2: never F divided by anything.
    """
    angles = np.asarray(cycle_angle_rev, dtype=np.float64)
    if engine.gas is not None and engine.gas.torque_n_m is not None:
        return _interpolated(engine, angles, engine.gas.torque_n_m)
    torque: Angles = -gas_force(engine, angles) * piston_velocity(angles, engine.mechanism)
    return torque


def gas_torque_by_order(engine: Engine, max_order: int) -> tuple[Angles, NDArray[np.complex128]]:
    """Orders and complex peak torque (N·m) of all cylinders' gas on the crank; half orders where a cycle has two turns.

    Each of shape (max_order · revolutions of a cycle + 1,); order 0 is the mean. A line is
    Re(torque · exp(2πi order rev)), rev the engine's crank angle. On the crankcase the gas puts this torque with the
    other sign about Y, and no force.

    ``engine``: with gas and, where it has several cylinders, their ``firing_deg``. ``max_order``: ≥ 1.
    Raises RequestError without firing angles.
    """
    cycle = engine.revs_per_cycle
    angles = np.arange(cycle * SAMPLES_PER_REV) / SAMPLES_PER_REV
    lines = np.arange(max_order * cycle + 1)
    torque = 2 * np.fft.rfft(gas_torque(engine, angles))[lines] / angles.size
    torque[0] /= 2
    firing_rev = np.array([firing_angle_deg(engine, cylinder) / 360 for cylinder in engine.cylinders])
    phases = np.exp(-2j * np.pi * np.mod(np.outer(firing_rev / cycle, lines), 1))
    return lines / cycle, torque * phases.sum(axis=0)


def firing_angle_deg(engine: Engine, cylinder: Cylinder) -> float:
    """Engine crank angle (degrees within the cycle) of the firing dead centre of ``cylinder`` of ``engine``.

    An engine of one cylinder, and one that fires every revolution, needs no ``firing_deg``: it fires when its pin
    stands along its axis. Raises RequestError where it is needed and missing.
    """
    if cylinder.firing_deg is not None:
        return cylinder.firing_deg
    if len(engine.cylinders) > 1 and engine.revs_per_cycle > 1:
        raise RequestError(
            "which revolution does each cylinder fire in?",
            place="cylinders",
            remedy="Give firing_deg for every cylinder",
        )
    return (cylinder.bank_deg - cylinder.crank_deg) % 360


def _interpolated(engine: Engine, cycle_angle_rev: Angles, values: tuple[float, ...]) -> Angles:
    assert engine.gas is not None
    period_deg = 360.0 * engine.revs_per_cycle
    found: Angles = np.interp(360 * cycle_angle_rev, engine.gas.crank_angle_deg, values, period=period_deg)
    return found
