"""Gas, turning moment and loads of an engine over its cycle: curves, and tables for the balance sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crankorder.engine import forces
from crankorder.engine.balancing import degrees_of, moments_g_mm2
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


PARTS = ("inertia", "gas", "sum")
"""Parts of a moment: of the moving masses, of the gas, and both together."""


@dataclass(frozen=True, kw_only=True)
class MomentByOrder:
    """A moment of masses and gas by order, as complex peaks: Re(moment · exp(2πi order rev)), rev the engine's.

    ``order`` (n,): 0, 1, 2, …, or 0, ½, 1, … where gas has a cycle of two turns. ``inertia_kg_m2`` (n,): of the masses,
    over ω². ``gas_n_m`` (n,): of the gas at any speed, order 0 its mean; None without gas.
    """

    order: Floats
    inertia_kg_m2: Complex
    gas_n_m: Complex | None

    def at(self, speed_rpm: float) -> Complex:
        """The ``PARTS`` of the moment at ``speed_rpm`` (≥ 0), shape (3, n), N·m."""
        inertia = self.inertia_kg_m2 * (speed_rpm * math.pi / 30) ** 2
        gas = np.zeros_like(inertia) if self.gas_n_m is None else self.gas_n_m
        return np.stack([inertia, gas, inertia + gas])

    def table(self, speed_rpm: float) -> dict[str, Any]:
        """Amplitude and phase of every part by order at ``speed_rpm`` (> 0), and which of masses and gas dominates."""
        parts, sizes = self.at(speed_rpm), np.abs(self.at(speed_rpm))
        return {
            order: {
                **{f"{part}_n_m": float(size) for part, size in zip(PARTS, sizes[:, n], strict=True)},
                **{
                    f"{part}_phase_deg": degrees_of(peak)
                    for part, peak in zip(PARTS, parts[:, n].tolist(), strict=True)
                },
                "dominates": "gas" if sizes[1, n] > sizes[0, n] else "inertia",
                "alike_at_rpm": speed_rpm * math.sqrt(sizes[1, n] / sizes[0, n]) if sizes[:2, n].all() else None,
            }
            for n, order in _kept(sizes[:2].max(axis=0), self.order)
        }


def crank_torque(engine: Engine, max_order: int) -> MomentByOrder:
    """Torque of masses and gas on the crank of ``engine``, in the sense of rotation; ``max_order``: ≥ 1."""
    return _with_gas(engine, forces.inertia_torque(engine, max_order), 1)


def roll_moment(engine: Engine, max_order: int) -> MomentByOrder:
    """Moment of masses and gas on the block of ``engine`` about Y, in the sense of rotation, at steady speed.

    Gas pushes piston and head alike and shakes no block: the forces close through rod, main bearings and wall, and what
    is left is the moment of the wall's thrust, the gas torque with the other sign. Its mean is what mounts and
    driveline carry. The masses' part is the reaction to their torque, and the change of the moving masses' own angular
    momentum; shafts that do not turn about the crankshaft's axis add theirs. ``max_order``: ≥ 1.
    Source: balance of angular momentum of all that moves; J. P. Den Hartog (1956), Mechanical Vibrations, chapter 5;
    C. F. Taylor (1985), The Internal-Combustion Engine in Theory and Practice, vol. 2, chapter 8.
    """
    return _with_gas(engine, 1e-9 * moments_g_mm2(engine, max_order)[forces.Y], -1)


def _with_gas(engine: Engine, inertia_kg_m2: Complex, sense: int) -> MomentByOrder:
    """The moment whose gas part is ``sense`` times the gas torque, and whose masses make ``inertia_kg_m2`` by order."""
    top = inertia_kg_m2.size - 1
    if engine.gas is None:
        return MomentByOrder(order=np.arange(top + 1.0), inertia_kg_m2=inertia_kg_m2, gas_n_m=None)
    order, gas = forces.gas_torque_by_order(engine, top)
    inertia = np.zeros_like(gas)
    inertia[:: engine.revs_per_cycle] = inertia_kg_m2
    return MomentByOrder(order=order, inertia_kg_m2=inertia, gas_n_m=sense * gas)


def roll_balance(engine: Engine, *, max_order: int, speeds: Sequence[float]) -> dict[str, Any]:
    """Mean of the roll moment on the block of ``engine``, None without gas, and its parts by speed and order.

    As the balance sheet has it. ``max_order``: ≥ 1. ``speeds``: rpm, > 0.
    """
    roll = roll_moment(engine, max_order)
    mean = None if roll.gas_n_m is None else float(roll.gas_n_m[0].real)
    return {"mean_n_m": mean, "by_speed": {forces.speed_key(speed): roll.table(speed) for speed in speeds}}


def cycle_balance(engine: Engine, *, max_order: int, speeds: Sequence[float]) -> dict[str, Any]:
    """Firing, gas and inertia torque by order and speed, turning moment, swing of the speed, and loads.

    As the balance sheet has it; parts that the ``engine`` has no data for are None. ``max_order``: highest order of the
    torques. ``speeds``: rpm, > 0. Raises RequestError for a firing engine of several cylinders without their firing
    angles.
    """
    torque = crank_torque(engine, max_order)
    curves = {forces.speed_key(speed): curve for speed, curve in zip(speeds, cycle_curves(engine, speeds), strict=True)}
    return {
        "firing": _firing(engine),
        "gas": None if torque.gas_n_m is None else _gas(engine, torque.order, torque.gas_n_m),
        "inertia_torque_g_mm2": _sizes(1e9 * torque.inertia_kg_m2, torque.order),
        "turning": {key: _turning(engine, curve, torque) for key, curve in curves.items()},
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


def _gas(engine: Engine, order: Floats, torque: Complex) -> dict[str, Any]:
    """Torque of the gas on the crank, and its force on one piston; that is None where the file states a torque."""
    force = None
    if _has_loads(engine):
        curve = forces.gas_force(engine.each[0], np.arange(engine.revs_per_cycle * ANGLES_PER_REV) / ANGLES_PER_REV)
        lines = _sizes(2 * np.fft.rfft(curve)[: torque.size] / curve.size, order)
        at = int(np.argmax(curve))
        force = {"peak_n": float(curve[at]), "peak_deg": 360 * at / ANGLES_PER_REV, "by_order_n": lines}
    return {
        "mean_torque_n_m": float(torque[0].real),
        "torque_n_m": _sizes(torque, order),
        "torque_phase_deg": {key: math.degrees(np.angle(torque[n])) for n, key in _kept(np.abs(torque), order)},
        "force_of_one_cylinder": force,
    }


def _kept(sizes: Floats, order: Floats) -> list[tuple[int, str]]:
    """Place and name of the orders above 0 whose amplitude exceeds a share of the largest; ``sizes``: by ``order``."""
    least = SHOWN_SHARE * float(sizes[1:].max(initial=0.0))
    return [(n, f"{order[n]:g}") for n, size in enumerate(sizes) if n and size > least]


def _sizes(peaks: Complex, order: Floats) -> Amounts:
    """Amplitudes of the complex ``peaks`` by ``order``, those above a share of the largest."""
    sizes = np.abs(peaks)
    return {key: float(sizes[n]) for n, key in _kept(sizes, order)}


def _turning(engine: Engine, curves: CycleCurves, torque: MomentByOrder) -> dict[str, Any]:
    """Turning moment at one speed: extremes, orders of gas and masses side by side, power and swing of the speed."""
    total = curves.gas_n_m + curves.inertia_n_m
    at, mean = int(np.argmax(total)), float(total.mean())
    return {
        "mean_n_m": mean,
        "peak_n_m": float(total[at]),
        "peak_deg": 360 * float(curves.crank_angle_rev[at]),
        "least_n_m": float(total.min()),
        "power_w": None if torque.gas_n_m is None else mean * curves.speed_rpm * math.pi / 30,
        "by_order": torque.table(curves.speed_rpm),
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
