"""Gas, turning moment and loads of an engine over its cycle: curves, and tables for the balance sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crankorder.engine import forces
from crankorder.engine.definition import Engine
from crankorder.engine.forces import Amounts, CylinderLoads
from crankorder.engine.slider_crank import Complex, last_order_above_round_off
from crankorder.engine.torsional_fluctuation import Floats, lag_from_torque, over_a_cycle
from crankorder.errors import RequestError

ANGLES_PER_REV = 720
"""Of the curves over a cycle: half a degree."""
MOST_TORQUE_ORDERS = 200
"""Of the masses' torque in a curve; a rod that needs more is hardly longer than its crank."""
EVEN_DEG = 1e-6
"""Firing intervals that differ by less are even."""
SHOWN_SHARE = 1e-9
"""An order of torque below this share of the largest is left out."""


@dataclass(frozen=True, kw_only=True)
class CycleCurves:
    """Torques on the crank and loads at one speed over a cycle of crank angle, from crank angle zero.

    ``crank_angle_rev`` (angle,). ``gas_n_m``, ``inertia_n_m`` (angle,): of all cylinders. ``loads``: of each cylinder,
    none where the gas is known by its torque only. ``bearings_n`` (bearing, 3, angle), None without their places.
    """

    speed_rpm: float
    crank_angle_rev: Floats
    gas_n_m: Floats
    inertia_n_m: Floats
    loads: tuple[CylinderLoads, ...]
    bearings_n: Floats | None


def cycle_curves(engine: Engine, speeds: Sequence[float]) -> list[CycleCurves]:
    """Torques and loads of ``engine`` over a cycle at each of the steady ``speeds`` (rpm), half a degree apart.

    Raises RequestError for a firing engine of several cylinders whose firing angles are missing.
    """
    angles = np.arange(ANGLES_PER_REV * engine.revs_per_cycle) / ANGLES_PER_REV
    gas = np.zeros(angles.size)
    if engine.gas is not None:
        for single, cylinder in zip(engine.each, engine.cylinders, strict=True):
            gas += forces.gas_torque(single, angles - forces.firing_angle_deg(engine, cylinder) / 360)
    numbers = range(len(engine.cylinders)) if _has_loads(engine) else range(0)
    top = min(max(last_order_above_round_off(single.mechanism) for single in engine.each), MOST_TORQUE_ORDERS)
    of_masses = forces.inertia_torque(engine, top)

    def at(speed_rpm: float) -> CycleCurves:
        loads = tuple(forces.cylinder_loads(engine, angles, speed_rpm, cylinder=number) for number in numbers)
        with_places = bool(loads) and bool(engine.main_bearings_m)
        by_order = of_masses * (speed_rpm * math.pi / 30) ** 2
        return CycleCurves(
            speed_rpm=speed_rpm,
            crank_angle_rev=angles,
            gas_n_m=gas,
            inertia_n_m=np.tile(over_a_cycle(by_order, ANGLES_PER_REV), engine.revs_per_cycle),
            loads=loads,
            bearings_n=forces.main_bearing_loads(engine, angles, speed_rpm, loads) if with_places else None,
        )

    return [at(speed) for speed in speeds]


def cycle_balance(engine: Engine, *, max_order: int, speeds: Sequence[float]) -> dict[str, Any]:
    """Firing, gas and inertia torque by order and speed, turning moment, swing of the speed, and loads.

    As the balance sheet has it; parts that the ``engine`` has no data for are None. ``max_order``: highest order of the
    torques. ``speeds``: rpm, > 0. Raises RequestError for a firing engine of several cylinders without their firing
    angles.
    """
    gas = np.zeros(0, dtype=np.complex128) if engine.gas is None else forces.gas_torque_by_order(engine, max_order)[1]
    masses = np.abs(forces.inertia_torque(engine, max_order))
    curves = {forces.speed_key(speed): curve for speed, curve in zip(speeds, cycle_curves(engine, speeds), strict=True)}
    return {
        "firing": _firing(engine),
        "gas": None if engine.gas is None else _gas(engine, gas),
        "inertia_torque_g_mm2": _kept(1e9 * masses),
        "turning": {key: _turning(engine, curve, gas, masses) for key, curve in curves.items()},
        "loads": {key: _loads(engine, curve) for key, curve in curves.items()} if _has_loads(engine) else None,
    }


def _has_loads(engine: Engine) -> bool:
    return engine.gas is None or engine.gas.torque_n_m is None


def _firing(engine: Engine) -> dict[str, Any] | None:
    """When the cylinders fire and how evenly; None where the file does not say."""
    if engine.cycle == "rotor":
        return None
    try:
        intervals = forces.firing_intervals_deg(engine)
    except RequestError:
        return None
    angles = [forces.firing_angle_deg(engine, cylinder) for cylinder in engine.cylinders]
    spread = max(intervals) - min(intervals)
    return {"angle_deg": angles, "interval_deg": list(intervals), "even": spread < EVEN_DEG, "spread_deg": spread}


def _gas(engine: Engine, torque: Complex) -> dict[str, Any]:
    """Torque of the gas on the crank, and its force on one piston; that is None where the file states a torque."""
    force, cycle = None, engine.revs_per_cycle
    if _has_loads(engine):
        curve = forces.gas_force(engine.each[0], np.arange(cycle * ANGLES_PER_REV) / ANGLES_PER_REV)
        lines = _kept(2 * np.abs(np.fft.rfft(curve))[: torque.size] / curve.size, cycle)
        at = int(np.argmax(curve))
        force = {"peak_n": float(curve[at]), "peak_deg": 360 * at / ANGLES_PER_REV, "by_order_n": lines}
    sizes = _kept(np.abs(torque), cycle)
    return {
        "mean_torque_n_m": float(torque[0].real),
        "torque_n_m": sizes,
        "torque_phase_deg": {key: math.degrees(np.angle(torque[round(float(key) * cycle)])) for key in sizes},
        "force_of_one_cylinder": force,
    }


def _kept(sizes: Floats, cycle: int = 1) -> Amounts:
    """Amplitudes above a share of the largest, by order; ``sizes``: at 0, 1, 2, … periods of ``cycle`` revolutions."""
    least = SHOWN_SHARE * float(sizes[1:].max(initial=0.0))
    return {f"{n / cycle:g}": float(size) for n, size in enumerate(sizes) if n and size > least}


def _turning(engine: Engine, curves: CycleCurves, gas: Complex, masses: Floats) -> dict[str, Any]:
    """Turning moment at one speed: extremes, orders of gas and masses side by side, power and swing of the speed."""
    total, omega = curves.gas_n_m + curves.inertia_n_m, curves.speed_rpm * math.pi / 30
    cycle = engine.revs_per_cycle if gas.size else 1
    of_masses = np.zeros((masses.size - 1) * cycle + 1)
    of_masses[::cycle] = masses * omega**2
    of_gas = np.abs(gas) if gas.size else np.zeros_like(of_masses)
    at, mean = int(np.argmax(total)), float(total.mean())
    return {
        "mean_n_m": mean,
        "peak_n_m": float(total[at]),
        "peak_deg": 360 * float(curves.crank_angle_rev[at]),
        "least_n_m": float(total.min()),
        "power_w": mean * omega if gas.size else None,
        "by_order": {
            order: {
                "gas_n_m": float(by_gas),
                "inertia_n_m": float(by_masses),
                "dominates": "gas" if by_gas > by_masses else "inertia",
                "alike_at_rpm": curves.speed_rpm * math.sqrt(by_gas / by_masses) if by_gas and by_masses else None,
            }
            for order in _kept(np.maximum(of_gas, of_masses), cycle)
            for n in (round(float(order) * cycle),)
            for by_gas, by_masses in ((of_gas[n], of_masses[n]),)
        },
        "speed_fluctuation": _fluctuation(engine, curves.speed_rpm),
    }


def _fluctuation(engine: Engine, speed_rpm: float) -> float | None:
    """(Highest − lowest) / mean speed within the cycle; None without a flywheel, or where it would stop."""
    inertia = engine.flywheel_inertia_kg_m2
    if inertia is None:
        return None
    try:
        return lag_from_torque(
            engine, flywheel_inertia_kg_m2=inertia, speed_rpm=speed_rpm, with_gas=engine.gas is not None
        ).fluctuation(speed_rpm)
    except RequestError:
        return None


def _loads(engine: Engine, curves: CycleCurves) -> dict[str, Any]:
    """Peak and mean of every load at one speed, by cylinder and by bearing."""

    def size(*parts: Floats) -> dict[str, float]:
        amount = np.sqrt(sum(part**2 for part in parts))
        at = int(np.argmax(amount))
        peak_deg = float(360 * curves.crank_angle_rev[at])
        return {"peak_n": float(amount[at]), "peak_deg": peak_deg, "mean_n": float(amount.mean())}

    bearings = None
    if curves.bearings_n is not None:
        bearings = [
            {
                "position_mm": 1e3 * place,
                **size(along_x, along_z),
                "mean_along_x_n": float(along_x.mean()),
                "mean_along_z_n": float(along_z.mean()),
            }
            for place, (along_x, _, along_z) in zip(engine.main_bearings_m, curves.bearings_n, strict=True)
        ]
    cylinders = [
        {
            "cylinder": number,
            "wall": size(load.side_thrust_n),
            "piston_pin": size(*load.piston_pin_n),
            "crank_pin": size(*load.crank_pin_n),
        }
        for number, load in enumerate(curves.loads)
    ]
    return {"cylinders": cylinders, "main_bearings": bearings}
