"""Gas, turning moment and loads of an engine over its cycle: curves, tables for the balance sheet, and sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from crankorder.engine.balance_data import Amounts, speed_key
from crankorder.engine.definition import Engine
from crankorder.engine.forces import CylinderLoads, cylinder_loads, inertia_torque, main_bearing_loads
from crankorder.engine.gas import firing_angle_deg, firing_intervals_deg, gas_force, gas_torque, gas_torque_by_order
from crankorder.engine.shaft_design import listed
from crankorder.engine.slider_crank import Complex, last_order_above_round_off
from crankorder.engine.torsional_fluctuation import Floats, lag_from_torque, over_a_cycle
from crankorder.errors import RequestError, plain_number
from crankorder.records import Record, said

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
        for single, cylinder in zip(engine.each, engine.cylinders, strict=True):
            gas += gas_torque(single, angles - firing_angle_deg(engine, cylinder) / 360)
    numbers = range(len(engine.cylinders)) if _has_loads(engine) else range(0)
    top = min(max(last_order_above_round_off(single.mechanism) for single in engine.each), MOST_TORQUE_ORDERS)
    of_masses = inertia_torque(engine, top)

    def at(speed_rpm: float) -> CycleCurves:
        loads = tuple(cylinder_loads(engine, angles, speed_rpm, cylinder=number) for number in numbers)
        with_places = bool(loads) and bool(engine.main_bearings_m)
        by_order = of_masses * (speed_rpm * math.pi / 30) ** 2
        return CycleCurves(
            speed_rpm=speed_rpm,
            crank_angle_rev=angles,
            gas_n_m=gas,
            inertia_n_m=np.tile(over_a_cycle(by_order, ANGLES_PER_REV), engine.revs_per_cycle),
            loads=loads,
            bearings_n=main_bearing_loads(engine, angles, speed_rpm, loads) if with_places else None,
        )

    return [at(speed) for speed in speeds]


class Firing(Record):
    """When the cylinders fire, and how evenly."""

    angle_deg: tuple[float, ...] = said("crank angle at which each cylinder fires, degrees")
    interval_deg: tuple[float, ...] = said("from one firing to the next, degrees")
    even: bool = said("whether all intervals are alike")
    spread_deg: float = said("longest less shortest interval, degrees")


class GasForce(Record):
    """Force of the gas on one piston."""

    peak_n: float = said("largest, N")
    peak_deg: float = said("crank angle of the peak, degrees")
    by_order_n: Amounts = said("amplitude by order, N")


class GasTorque(Record):
    """Torque of the gas of all cylinders on the crank."""

    mean_torque_n_m: float = said("mean, N·m")
    torque_n_m: Amounts = said("amplitude by order, N·m")
    torque_phase_deg: Amounts = said("phase by order, degrees")
    force_of_one_cylinder: GasForce | None = said("force on its piston; null where the file states a torque")


class OrderTorque(Record):
    """Torque on the crank of one order, of gas and masses."""

    gas_n_m: float = said("amplitude of the gas, N·m")
    inertia_n_m: float = said("amplitude of the masses, N·m")
    dominates: Literal["gas", "inertia"] = said("the larger")
    alike_at_rpm: float | None = said("crank speed at which both are alike, rpm")

    @property
    def largest_n_m(self) -> float:
        """Amplitude of the larger, N·m."""
        return max(self.gas_n_m, self.inertia_n_m)


class TurningMoment(Record):
    """Torque on the crank of gas and masses together at one speed."""

    mean_n_m: float = said("mean over the cycle, N·m")
    peak_n_m: float = said("largest, N·m")
    peak_deg: float = said("crank angle of the peak, degrees")
    least_n_m: float = said("smallest, N·m")
    power_w: float | None = said("without friction, W; null without gas")
    by_order: dict[str, OrderTorque] = said("by order")
    speed_fluctuation: float | None = said("(highest − lowest) / mean speed within the cycle; null without a flywheel")


class Load(Record):
    """A load over the cycle."""

    peak_n: float = said("largest, N")
    peak_deg: float = said("crank angle of the peak, degrees")
    mean_n: float = said("mean of its size, N")


class CylinderLoad(Record):
    """Loads of one cylinder."""

    cylinder: int = said("number from 0")
    wall: Load = said("piston on its wall")
    piston_pin: Load = said("rod on the piston pin")
    crank_pin: Load = said("rod on the crank pin")


class BearingLoad(Record):
    """Load of one main bearing."""

    position_mm: float = said("place along the crankshaft, mm")
    load: Load = said("size of the load", spread=True)
    mean_along_x_n: float = said("mean along X, N")
    mean_along_z_n: float = said("mean along Z, N")


class Loads(Record):
    """Loads at one speed."""

    cylinders: tuple[CylinderLoad, ...] = said("by cylinder")
    main_bearings: tuple[BearingLoad, ...] | None = said("by bearing; null where their places are unknown")


class CycleBalance(Record):
    """Firing, torques on the crank and loads of an engine over its cycle."""

    firing: Firing | None = said("angles of firing; null where the file does not state them")
    gas: GasTorque | None = said("torque of the gas; null without gas")
    inertia_torque_g_mm2: Amounts = said("torque of the masses by order, g·mm² over ω²")
    turning: dict[str, TurningMoment] = said("torque by speed")
    loads: dict[str, Loads] | None = said("loads by speed; null where the gas is known by its torque only")


def cycle_balance(engine: Engine, *, max_order: int, speeds: Sequence[float]) -> CycleBalance:
    """Firing, gas and inertia torque by order and speed, turning moment, swing of the speed, and loads.

    ``engine``: any; parts that it has no data for are None. ``max_order``: highest order of the torques.
    ``speeds``: rpm, > 0. Raises RequestError for a firing engine of several cylinders without their firing angles.
    """
    gas_orders, gas = np.zeros(0), np.zeros(0, dtype=np.complex128)
    if engine.gas is not None:
        gas_orders, gas = gas_torque_by_order(engine, max_order)
    masses = np.abs(inertia_torque(engine, max_order))
    curves = {speed_key(curve.speed_rpm): curve for curve in cycle_curves(engine, speeds)}
    return CycleBalance(
        firing=_firing(engine),
        gas=None if engine.gas is None else _gas(engine, gas_orders, gas),
        inertia_torque_g_mm2=_kept(1e9 * masses, np.arange(masses.size, dtype=np.float64)),
        turning={key: _turning(engine, curve, gas, masses) for key, curve in curves.items()},
        loads={key: _loads(engine, curve) for key, curve in curves.items()} if curves and _has_loads(engine) else None,
    )


def _has_loads(engine: Engine) -> bool:
    return engine.gas is None or engine.gas.torque_n_m is None


def _firing(engine: Engine) -> Firing | None:
    """When the cylinders fire and how evenly; None where the file does not say."""
    if engine.cycle == "rotor":
        return None
    try:
        intervals = firing_intervals_deg(engine)
    except RequestError:
        return None
    angles = tuple(firing_angle_deg(engine, cylinder) for cylinder in engine.cylinders)
    spread = max(intervals) - min(intervals)
    return Firing(angle_deg=angles, interval_deg=tuple(intervals), even=spread < EVEN_DEG, spread_deg=spread)


def _gas(engine: Engine, orders: Floats, torque: Complex) -> GasTorque:
    force = None
    if _has_loads(engine):
        angles = np.arange(engine.revs_per_cycle * ANGLES_PER_REV) / ANGLES_PER_REV
        curve = gas_force(engine.each[0], angles)
        lines = _kept(2 * np.abs(np.fft.rfft(curve))[: orders.size] / curve.size, orders)
        at = int(np.argmax(curve))
        force = GasForce(peak_n=float(curve[at]), peak_deg=360 * float(angles[at]), by_order_n=lines)
    return GasTorque(
        mean_torque_n_m=float(torque[0].real),
        torque_n_m=_kept(np.abs(torque), orders),
        torque_phase_deg={key: math.degrees(np.angle(torque[n])) for key, n in _lines(np.abs(torque), orders)},
        force_of_one_cylinder=force,
    )


def _lines(sizes: Floats, orders: Floats) -> list[tuple[str, int]]:
    least = SHOWN_SHARE * max(float(sizes[1:].max(initial=0.0)), 0.0)
    return [(f"{order:g}", n) for n, order in enumerate(orders) if n and sizes[n] > least]


def _kept(sizes: Floats, orders: Floats) -> Amounts:
    return {key: float(sizes[n]) for key, n in _lines(sizes, orders)}


def _turning(engine: Engine, curves: CycleCurves, gas: Complex, masses: Floats) -> TurningMoment:
    """Turning moment at one speed: extremes, orders of gas and masses side by side, power and swing of the speed."""
    total, omega = curves.total_n_m, curves.speed_rpm * math.pi / 30
    inertia = masses * omega**2
    by_order: dict[str, OrderTorque] = {}
    cycle = engine.revs_per_cycle if gas.size else 1
    largest = max(float(inertia[1:].max(initial=0.0)), float(np.abs(gas[1:]).max(initial=0.0)))
    for n in range(1, (masses.size - 1) * cycle + 1):
        of_gas = float(abs(gas[n])) if gas.size else 0.0
        of_masses = float(inertia[n // cycle]) if n % cycle == 0 else 0.0
        if max(of_gas, of_masses) > SHOWN_SHARE * largest:
            by_order[f"{n / cycle:g}"] = OrderTorque(
                gas_n_m=of_gas,
                inertia_n_m=of_masses,
                dominates="gas" if of_gas > of_masses else "inertia",
                alike_at_rpm=curves.speed_rpm * math.sqrt(of_gas / of_masses) if of_gas and of_masses else None,
            )
    at, mean = int(np.argmax(total)), float(total.mean())
    return TurningMoment(
        mean_n_m=mean,
        peak_n_m=float(total[at]),
        peak_deg=360 * float(curves.crank_angle_rev[at]),
        least_n_m=float(total.min()),
        power_w=mean * omega if gas.size else None,
        by_order=by_order,
        speed_fluctuation=_fluctuation(engine, curves.speed_rpm),
    )


def _fluctuation(engine: Engine, speed_rpm: float) -> float | None:
    """(Highest − lowest) / mean speed within the cycle; None without a flywheel, or where it would stop."""
    if engine.flywheel_inertia_kg_m2 is None:
        return None
    try:
        inertia, with_gas = engine.flywheel_inertia_kg_m2, engine.gas is not None
        lag = lag_from_torque(engine, flywheel_inertia_kg_m2=inertia, speed_rpm=speed_rpm, with_gas=with_gas)
    except RequestError:
        return None
    return lag.fluctuation(speed_rpm)


def _loads(engine: Engine, curves: CycleCurves) -> Loads:
    """Peak and mean of every load at one speed, by cylinder and by bearing."""

    def size(*parts: Floats) -> Load:
        amount = np.sqrt(sum(part**2 for part in parts))
        at = int(np.argmax(amount))
        peak_deg = float(360 * curves.crank_angle_rev[at])
        return Load(peak_n=float(amount[at]), peak_deg=peak_deg, mean_n=float(amount.mean()))

    cylinders = tuple(
        CylinderLoad(
            cylinder=number,
            wall=size(load.side_thrust_n),
            piston_pin=size(*load.piston_pin_n),
            crank_pin=size(*load.crank_pin_n),
        )
        for number, load in enumerate(curves.loads)
    )
    if curves.bearings_n is None:
        return Loads(cylinders=cylinders, main_bearings=None)
    bearings = tuple(
        BearingLoad(
            position_mm=1e3 * place,
            load=size(along_x, along_z),
            mean_along_x_n=float(along_x.mean()),
            mean_along_z_n=float(along_z.mean()),
        )
        for place, (along_x, _, along_z) in zip(engine.main_bearings_m, curves.bearings_n, strict=True)
    )
    return Loads(cylinders=cylinders, main_bearings=bearings)


def cycle_sentences(cycle: CycleBalance, speed_rpm: float) -> list[str]:
    """What fires when, whether gas or masses turn the crank unevenly, and what the bearings carry.

    ``cycle``: of the engine. ``speed_rpm``: one of its speeds.
    """
    key, sentences = speed_key(speed_rpm), []
    firing, turning = cycle.firing, cycle.turning[key]
    if firing is not None and len(firing.interval_deg) > 1:
        intervals = [f"{plain_number(interval)}°" for interval in firing.interval_deg]
        sentences.append(
            f"It fires evenly, every {intervals[0]}."
            if firing.even
            else f"It fires unevenly, at intervals of {listed(intervals)}."
        )
    if turning.power_w is not None:
        sentences.append(
            f"The gas turns the crank with {plain_number(turning.mean_n_m)} N·m in the mean, "
            f"{plain_number(turning.power_w / 1e3)} kW at {key} rpm without friction."
        )
    if turning.by_order:
        sentences.append(_turns(turning, key))
    if turning.speed_fluctuation is not None:
        sentences.append(f"Its speed swings by {100 * turning.speed_fluctuation:.3g} % within the cycle at {key} rpm.")
    return sentences if cycle.loads is None else [*sentences, _of_loads(cycle.loads[key], key)]


def _turns(turning: TurningMoment, key: str) -> str:
    largest = sorted(turning.by_order.items(), key=lambda entry: -entry[1].largest_n_m)[:2]
    phrases = []
    for order, torque in sorted(largest, key=lambda entry: float(entry[0])):
        of_gas = f"gas {plain_number(torque.gas_n_m)}, " if turning.power_w is not None else ""  # None without gas
        sizes = f"order {order}: {of_gas}masses {plain_number(torque.inertia_n_m)} N·m"
        alike = torque.alike_at_rpm
        phrases.append(sizes if alike is None else f"{sizes} (alike at {plain_number(alike)} rpm)")
    return (
        f"The turning moment swings between {plain_number(turning.least_n_m)} and "
        f"{plain_number(turning.peak_n_m)} N·m at {key} rpm; {'; '.join(phrases)}."
    )


def _of_loads(loads: Loads, key: str) -> str:
    wall = max(cylinder.wall.peak_n for cylinder in loads.cylinders)
    pin = max(cylinder.crank_pin.peak_n for cylinder in loads.cylinders)
    text = (
        f"At {key} rpm a piston presses on its wall with up to {plain_number(wall)} N and a rod on its crank pin with "
        f"{plain_number(pin)} N"
    )
    if loads.main_bearings is None:
        return f"{text}."
    top = max(loads.main_bearings, key=lambda bearing: bearing.load.peak_n)
    peak, angle, mean = map(plain_number, (top.load.peak_n, top.load.peak_deg, top.load.mean_n))
    return (
        f"{text}; the main bearing at {plain_number(top.position_mm)} mm carries the most, up to {peak} N at {angle}° "
        f"and {mean} N in the mean."
    )
