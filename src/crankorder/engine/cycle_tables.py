"""Gas, turning moment and loads of an engine over its cycle: curves, tables for the balance sheet, and sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crankorder.engine.balance_data import speed_key
from crankorder.engine.definition import Engine
from crankorder.engine.engine_tables import listed
from crankorder.engine.forces import (
    CylinderLoads,
    cylinder_loads,
    gas_on_piston,
    inertia_torque,
    main_bearing_loads,
)
from crankorder.engine.gas import firing_angle_deg, firing_intervals_deg, gas_force, gas_torque, gas_torque_by_order
from crankorder.engine.harmonics import last_order_above_round_off
from crankorder.engine.torsional_fluctuation import TORQUE_ORDERS, Complex, Floats, lag_from_torque, over_a_cycle
from crankorder.errors import RequestError, plain_number

ANGLES_PER_REV = 720
"""Of the curves over a cycle: half a degree."""
MOST_TORQUE_ORDERS = 200
"""Of the masses' torque in a curve; a rod that needs more is hardly longer than its crank."""
EVEN_DEG = 1e-6
"""Firing intervals that differ by less are even."""
TOLD_SHARE = 1e-9
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

    @property
    def total_n_m(self) -> Floats:
        """Turning moment of gas and masses together."""
        return self.gas_n_m + self.inertia_n_m


def cycle_curves(engine: Engine, speeds: Sequence[float]) -> list[CycleCurves]:
    """Torques and loads of ``engine`` over a cycle at each of the steady ``speeds`` (rpm), half a degree apart.

    Raises RequestError for a firing engine of several cylinders whose firing angles are missing.
    """
    angles = np.arange(ANGLES_PER_REV * engine.revs_per_cycle) / ANGLES_PER_REV
    gas = np.zeros(angles.size)
    if engine.gas is not None:
        for one, cylinder in zip(engine.each, engine.cylinders, strict=True):
            gas += gas_torque(one, angles - firing_angle_deg(engine, cylinder) / 360)
    numbers = range(len(engine.cylinders)) if _has_loads(engine) else range(0)
    on_pistons = [gas_on_piston(engine, angles, cylinder=number) for number in numbers]  # at any speed

    def at(speed_rpm: float) -> CycleCurves:
        loads = tuple(
            cylinder_loads(engine, angles, speed_rpm, cylinder=number, gas_n=on_pistons[number]) for number in numbers
        )
        with_places = bool(loads) and bool(engine.main_bearings_m)
        return CycleCurves(
            speed_rpm=speed_rpm,
            crank_angle_rev=angles,
            gas_n_m=gas,
            inertia_n_m=_inertia(engine, speed_rpm),
            loads=loads,
            bearings_n=main_bearing_loads(engine, angles, speed_rpm, loads=loads) if with_places else None,
        )

    return [at(speed) for speed in speeds]


def _inertia(engine: Engine, speed_rpm: float) -> Floats:
    top = min(max(last_order_above_round_off(one.mechanism) for one in engine.each), MOST_TORQUE_ORDERS)
    by_order = inertia_torque(engine, top) * (speed_rpm * math.pi / 30) ** 2
    return np.tile(over_a_cycle(by_order, ANGLES_PER_REV), engine.revs_per_cycle)


def cycle_table(engine: Engine, *, max_order: int, speeds: Sequence[float]) -> dict[str, Any]:
    """Firing, gas and inertia torque by order and speed, turning moment, swing of the speed, and loads.

    ``engine``: any; parts that it has no data for are None. ``max_order``: highest order of the torques.
    ``speeds``: rpm, > 0. Raises RequestError for a firing engine of several cylinders without their firing angles.
    """
    gas_orders, gas = np.zeros(0), np.zeros(0, dtype=np.complex128)
    if engine.gas is not None:
        gas_orders, gas = gas_torque_by_order(engine, max_order)
    masses = np.abs(inertia_torque(engine, max_order))
    curves = {speed_key(one.speed_rpm): one for one in cycle_curves(engine, speeds)}
    return {
        "firing": _firing(engine),
        "gas": None if engine.gas is None else _gas(engine, gas_orders, gas),
        "inertia_torque_g_mm2": _kept(1e9 * masses, np.arange(masses.size, dtype=np.float64)),
        "turning": {key: _turning(engine, one, gas, masses) for key, one in curves.items()},
        "loads": {key: _loads(engine, one) for key, one in curves.items()} if curves and _has_loads(engine) else None,
    }


def _has_loads(engine: Engine) -> bool:
    return engine.gas is None or engine.gas.torque_n_m is None


def _firing(engine: Engine) -> dict[str, Any] | None:
    """When the cylinders fire and how evenly; None where the file does not say."""
    if engine.cycle == "rotor":
        return None
    try:
        intervals = firing_intervals_deg(engine)
    except RequestError:
        return None
    spread = max(intervals) - min(intervals)
    return {
        "angle_deg": [firing_angle_deg(engine, cylinder) for cylinder in engine.cylinders],
        "interval_deg": list(intervals),
        "even": spread < EVEN_DEG,
        "spread_deg": spread,
    }


def _gas(engine: Engine, orders: Floats, torque: Complex) -> dict[str, Any]:
    revs = engine.revs_per_cycle
    force = None
    if engine.gas is not None and engine.gas.torque_n_m is None:
        angles = np.arange(revs * ANGLES_PER_REV) / ANGLES_PER_REV
        curve = gas_force(engine.each[0], angles)
        lines = 2 * np.abs(np.fft.rfft(curve))[: orders.size] / curve.size
        at = int(np.argmax(curve))
        force = {"peak_n": float(curve[at]), "peak_deg": 360 * float(angles[at]), "by_order_n": _kept(lines, orders)}
    return {
        "mean_torque_n_m": float(torque[0].real),
        "torque_n_m": _kept(np.abs(torque), orders),
        "torque_phase_deg": {key: math.degrees(np.angle(torque[n])) for key, n in _lines(np.abs(torque), orders)},
        "force_of_one_cylinder": force,
    }


def _lines(sizes: Floats, orders: Floats) -> list[tuple[str, int]]:
    least = TOLD_SHARE * max(float(sizes[1:].max(initial=0.0)), 0.0)
    return [(f"{order:g}", n) for n, order in enumerate(orders) if n and sizes[n] > least]


def _kept(sizes: Floats, orders: Floats) -> dict[str, float]:
    return {key: float(sizes[n]) for key, n in _lines(sizes, orders)}


def _turning(engine: Engine, curves: CycleCurves, gas: Complex, masses: Floats) -> dict[str, Any]:
    """Turning moment at one speed: extremes, orders of gas and masses side by side, power and swing of the speed."""
    total, omega = curves.total_n_m, curves.speed_rpm * math.pi / 30
    inertia = masses * omega**2
    by_order: dict[str, Any] = {}
    cycle = engine.revs_per_cycle if gas.size else 1
    largest = max(float(inertia[1:].max(initial=0.0)), float(np.abs(gas[1:]).max(initial=0.0)))
    for n in range(1, (masses.size - 1) * cycle + 1):
        of_gas = float(abs(gas[n])) if gas.size else 0.0
        of_masses = float(inertia[n // cycle]) if n % cycle == 0 else 0.0
        if max(of_gas, of_masses) > TOLD_SHARE * largest:
            by_order[f"{n / cycle:g}"] = {
                "gas_n_m": of_gas,
                "inertia_n_m": of_masses,
                "dominates": "gas" if of_gas > of_masses else "inertia",
                "alike_at_rpm": curves.speed_rpm * math.sqrt(of_gas / of_masses) if of_gas and of_masses else None,
            }
    at, mean = int(np.argmax(total)), float(total.mean())
    return {
        "mean_n_m": mean,
        "peak_n_m": float(total[at]),
        "peak_deg": 360 * float(curves.crank_angle_rev[at]),
        "least_n_m": float(total.min()),
        "power_w": mean * omega if gas.size else None,
        "by_order": by_order,
        "speed_fluctuation": _fluctuation(engine, curves.speed_rpm),
    }


def _fluctuation(engine: Engine, speed_rpm: float) -> float | None:
    """(Highest − lowest) / mean speed within the cycle; None without a flywheel, or where it would stop."""
    if engine.flywheel_inertia_kg_m2 is None:
        return None
    try:
        lag = lag_from_torque(
            engine,
            flywheel_inertia_kg_m2=engine.flywheel_inertia_kg_m2,
            speed_rpm=speed_rpm,
            highest_order=TORQUE_ORDERS,
            with_gas=engine.gas is not None,
        )
    except RequestError:
        return None
    return lag.fluctuation(speed_rpm)


def _loads(engine: Engine, curves: CycleCurves) -> dict[str, Any]:
    """Peak and mean of every load at one speed, by cylinder and by bearing."""
    degrees = 360 * curves.crank_angle_rev

    def size(*parts: Floats) -> dict[str, float]:
        amount = np.sqrt(sum(part**2 for part in parts))
        at = int(np.argmax(amount))
        return {"peak_n": float(amount[at]), "peak_deg": float(degrees[at]), "mean_n": float(amount.mean())}

    by_cylinder = [
        {
            "cylinder": number,
            "wall": size(load.side_thrust_n),
            "piston_pin": size(*load.piston_pin_n),
            "crank_pin": size(*load.crank_pin_n),
        }
        for number, load in enumerate(curves.loads)
    ]
    bearings = None
    if curves.bearings_n is not None:
        bearings = [
            {
                "position_mm": 1e3 * place,
                **size(load[0], load[2]),
                "mean_along_x_n": float(load[0].mean()),
                "mean_along_z_n": float(load[2].mean()),
            }
            for place, load in zip(engine.main_bearings_m, curves.bearings_n, strict=True)
        ]
    return {"cylinders": by_cylinder, "main_bearings": bearings}


def cycle_sentences(cycle: Mapping[str, Any], speed_rpm: float) -> list[str]:
    """What fires when, whether gas or masses turn the crank unevenly, and what the bearings carry.

    ``cycle``: as :func:`cycle_table` makes it. ``speed_rpm``: one of its speeds.
    """
    key, said = speed_key(speed_rpm), []
    firing, turning = cycle["firing"], cycle["turning"][key]
    if firing is not None and len(firing["interval_deg"]) > 1:
        intervals = [f"{plain_number(interval)}°" for interval in firing["interval_deg"]]
        said.append(
            f"It fires evenly, every {intervals[0]}."
            if firing["even"]
            else f"It fires unevenly, at intervals of {listed(intervals)}."
        )
    if cycle["gas"] is not None:
        said.append(
            f"The gas turns the crank with {plain_number(turning['mean_n_m'])} N·m in the mean, "
            f"{plain_number(turning['power_w'] / 1e3)} kW at {key} rpm without friction."
        )
    if turning["by_order"]:
        said.append(_turns(turning, key))
    if turning["speed_fluctuation"] is not None:
        said.append(f"Its speed swings by {100 * turning['speed_fluctuation']:.3g} % within the cycle at {key} rpm.")
    return said if cycle["loads"] is None else said + _of_loads(cycle["loads"][key], key)


def _turns(turning: Mapping[str, Any], key: str) -> str:
    most = sorted(turning["by_order"].items(), key=lambda one: -max(one[1]["gas_n_m"], one[1]["inertia_n_m"]))[:2]
    told = []
    for order, one in sorted(most, key=lambda entry: float(entry[0])):
        of_gas = f"gas {plain_number(one['gas_n_m'])}, " if turning["power_w"] is not None else ""  # None without gas
        sizes = f"order {order}: {of_gas}masses {plain_number(one['inertia_n_m'])} N·m"
        alike = one["alike_at_rpm"]
        told.append(sizes if alike is None else f"{sizes} (alike at {plain_number(alike)} rpm)")
    return (
        f"The turning moment swings between {plain_number(turning['least_n_m'])} and "
        f"{plain_number(turning['peak_n_m'])} N·m at {key} rpm; {'; '.join(told)}."
    )


def _of_loads(loads: Mapping[str, Any], key: str) -> list[str]:
    wall, pin = (max(one[name]["peak_n"] for one in loads["cylinders"]) for name in ("wall", "crank_pin"))
    text = (
        f"At {key} rpm a piston presses on its wall with up to {plain_number(wall)} N and a rod on its crank pin with "
        f"{plain_number(pin)} N"
    )
    if loads["main_bearings"] is None:
        return [f"{text}."]
    top = max(loads["main_bearings"], key=lambda one: one["peak_n"])
    return [
        f"{text}; the main bearing at {plain_number(top['position_mm'])} mm carries the most, up to "
        f"{plain_number(top['peak_n'])} N at {plain_number(top['peak_deg'])}° and {plain_number(top['mean_n'])} N "
        "in the mean."
    ]
