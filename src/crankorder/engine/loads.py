"""What the parts of a running engine carry: side thrust, piston pin, crank pin, torque and main bearings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.definition import Cylinder, Engine
from crankorder.engine.forces import DIRECTIONS, X, Z
from crankorder.engine.gas import firing_angle_deg, gas_force
from crankorder.engine.rod import rod_couple, two_masses
from crankorder.engine.slider_crank import piston_acceleration, rod_direction, sine_cosine
from crankorder.errors import RequestError

Angles = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CylinderLoads:
    """Loads of one cylinder against crank angle, along its axis away from the crankshaft and across in the crank's way.

    ``side_thrust_n`` (…): piston on its wall, across. ``piston_pin_n`` (2, …): rod on piston, along and across.
    ``crank_pin_n`` (2, …): rod on crank pin. ``main_n`` (2, …): throw on its main bearings together.
    ``head_n`` (…): gas on the cylinder head, along. ``torque_n_m`` (…): rod on crank, in the sense of rotation.
    """

    side_thrust_n: Angles
    piston_pin_n: Angles
    crank_pin_n: Angles
    main_n: Angles
    head_n: Angles
    torque_n_m: Angles


def cylinder_loads(engine: Engine, crank_angle_rev: ArrayLike, speed_rpm: float, *, cylinder: int = 0) -> CylinderLoads:
    """Loads of one cylinder of ``engine`` at steady speed, from exact kinematics, gas and the rod's true inertia.

    ``crank_angle_rev``: the engine's, any shape. ``speed_rpm``: ≥ 0. ``cylinder``: its number, from 0. Friction and the
    weights are left out. Without a rod in the data its mass counts as the two ends' and the crank pin's load lacks
    the big end's part. Raises RequestError where the gas is known by its torque only.
    Source: Newton and Euler for piston and rod; the couple of the rod's inertia by truth sheet 2.7.
    """
    where = engine.cylinders[cylinder]
    angles = np.asarray(crank_angle_rev, dtype=np.float64)
    own = angles + (where.crank_deg - where.bank_deg) / 360
    gas = _gas_on_piston(engine, where, angles)
    omega_squared = (speed_rpm * np.pi / 30) ** 2
    sine, cosine = sine_cosine(own)
    rod_sine, rod_cosine = rod_direction(own, engine.mechanism)
    rod = two_masses(engine)
    inertia = omega_squared * piston_acceleration(own, engine.mechanism)  # of one kilogram, away from the crankshaft

    through_rod = gas - engine.reciprocating_mass_kg * inertia
    couple = rod_couple(engine, own, speed_rpm)
    thrust = -(rod_sine * through_rod + couple / engine.rod_length_m) / rod_cosine
    radius = engine.crank_radius_m
    big_end = rod.big_end_kg * radius * omega_squared
    pin_along, pin_across = big_end * cosine - through_rod, big_end * sine - thrust

    rest_angle = own + engine.rotating_unbalance_deg / 360
    rest_sine, rest_cosine = sine_cosine(rest_angle)
    rest = engine.rotating_unbalance_kg_m * omega_squared
    main = [
        pin_along + rest * rest_cosine - big_end * cosine,
        pin_across + rest * rest_sine - big_end * sine,
    ]
    return CylinderLoads(
        side_thrust_n=thrust,
        piston_pin_n=np.stack([through_rod + rod.small_end_kg * inertia, thrust]),
        crank_pin_n=np.stack([pin_along, pin_across]),
        main_n=np.stack(main),
        head_n=gas,
        torque_n_m=radius * (cosine * pin_across - sine * pin_along),
    )


def main_bearing_loads(engine: Engine, crank_angle_rev: ArrayLike, speed_rpm: float) -> Angles:
    """Load (N) of the crankshaft on each main bearing, shape (bearing, 3, …), directions as in ``DIRECTIONS``.

    Each throw is carried by the bearings before and behind it, as a beam on two supports: a statically determinate
    crankshaft. ``engine``: with ``main_bearings_m``. ``crank_angle_rev``: the engine's, any shape. ``speed_rpm``: ≥ 0.
    Raises RequestError without bearing positions.
    """
    places = np.array(engine.main_bearings_m)
    if places.size == 0:
        raise RequestError("where are the main bearings?", place="main_bearings_m", remedy="Give their positions")
    angles = np.asarray(crank_angle_rev, dtype=np.float64)
    loads = np.zeros((places.size, len(DIRECTIONS), *angles.shape))
    for number, cylinder in enumerate(engine.cylinders):
        along, across = cylinder_loads(engine, angles, speed_rpm, cylinder=number).main_n
        lean_sine, lean_cosine = sine_cosine(cylinder.bank_deg / 360)
        behind = min(max(int(np.searchsorted(places, cylinder.position_m)), 1), places.size - 1)
        share = (cylinder.position_m - places[behind - 1]) / (places[behind] - places[behind - 1])
        for bearing, part in ((behind - 1, 1 - share), (behind, share)):
            loads[bearing, X] += part * (along * lean_sine + across * lean_cosine)
            loads[bearing, Z] += part * (along * lean_cosine - across * lean_sine)
    return loads


def _gas_on_piston(engine: Engine, cylinder: Cylinder, angles: Angles) -> Angles:
    if engine.gas is None:
        return np.zeros(angles.shape)
    return gas_force(engine, angles - firing_angle_deg(engine, cylinder) / 360)
