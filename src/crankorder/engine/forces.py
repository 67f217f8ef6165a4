"""Forces of an engine: of its moving masses and its gas, by order, and what its parts carry of these."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from crankorder.engine.definition import Cylinder, Engine, IdealCycle
from crankorder.engine.slider_crank import (
    Angles,
    Complex,
    acceleration_harmonics,
    dead_centres,
    last_order_above_round_off,
    piston_drop,
    piston_velocity,
    plain_piston_acceleration,
    rod_acceleration_harmonics,
    rod_angle,
    rod_direction,
    sine_cosine,
)
from crankorder.errors import RequestError

AxisName = Literal["X", "Y", "Z"]


@dataclass(frozen=True)
class Frame:
    """Axes in which every force and moment of an engine is stated, in words; fixed to the crankcase."""

    X: str = "across the cylinders"
    Y: str = "along the crankshaft"
    Z: str = "along the cylinder or the middle of the banks, away from the crankshaft"
    rotation: str = "right-handed, the crank turns from Z to X (positive about Y)"
    origin: str = "on the axis of the crankshaft at position 0"


FRAME = Frame()
"""The one frame of text, JSON, NetCDF and pictures; drawn in docs/method/engine.md."""
DIRECTIONS: tuple[AxisName, ...] = get_args(AxisName)
AXES: tuple[AxisName, ...] = ("Z", "X")
"""Axes of forces: along Y there is none."""
X, Y, Z = range(3)
Amounts = dict[str, float]
"""Amplitudes by order, or forces by crank speed (rpm): orders and speeds as texts."""
CANCELLED = 1e-12
"""Of one cylinder's largest force: what is left below it of several that cancel is rounding."""


SAMPLES_PER_REV = 1 << 14
"""Angles per revolution on which a torque is transformed: a straight-line curve's orders alias by order²/this²."""
NODES = 24
"""Gauss points of the integral over the heat that is released."""


def crankcase_forces(engine: Engine, speed_rpm: ArrayLike, *, max_order: int) -> Complex:
    """Complex peak force (N) on the crankcase at orders 0 … ``max_order``, shape (…, 3, max_order + 1).

    The second axis from the right is the direction, in the sequence of ``DIRECTIONS``. A line is
    Re(force · exp(2πi order rev)), rev counted from the engine's crank angle zero: top dead centre of a cylinder whose
    pin and axis stand along Z. The cylinders add up, each with its phase and bank angle.

    ``engine``: lengths, masses, cylinders and shafts. ``speed_rpm``: scalar or any shape (…), ≥ 0. ``max_order``: ≥ 1
    (:func:`crankorder.engine.slider_crank.orders_for` says how many are worth having). Raises RequestError for a
    stated pair of shafts at an order of which the pistons together make no force.
    Source: truth sheet sections 0, 2.5 and 2.6; a mass that slides along the cylinder has no net force across it.
    """
    per_omega_squared = engine.crank_radius_m * _pistons(engine, max_order).sum(axis=0)
    per_omega_squared[Z] += engine.crank_radius_m * _shafts(engine, max_order)
    per_omega_squared[:, 1] += _rotating(engine).sum(axis=0)
    for weight in turning_weights(engine):
        if weight.order <= max_order:
            per_omega_squared[:, weight.order] += weight.force_kg_m
    return _at_speed(speed_rpm, per_omega_squared)


def crankcase_moments(engine: Engine, speed_rpm: ArrayLike, *, max_order: int) -> Complex:
    """Complex peak inertia moment (N·m) on the crankcase at orders 0 … ``max_order``, shape (…, 3, max_order + 1).

    About X and Z the rocking moments of forces that act at different places along the crankshaft, counted from
    position 0; about Y (in the sense of rotation) the rolling moment, the reaction to the masses' torque. A line is
    Re(moment · exp(2πi order rev)). The gas adds −``gas_torque_by_order`` about Y.

    ``engine``: lengths, masses, cylinders with their ``position_m``, and shafts. ``speed_rpm``: scalar or any shape
    (…), ≥ 0, steady. ``max_order``: ≥ 1.
    Source: M = r × F; about Y the balance of angular momentum, with the rod's true inertia (truth sheet 2.7).
    """
    place = np.array([cylinder.position_m for cylinder in engine.cylinders])
    forces = engine.crank_radius_m * _pistons(engine, max_order)
    forces[:, :, 1] += _rotating(engine)
    at_place = np.einsum("n,ndk->dk", place, forces)
    moments = np.zeros_like(at_place)
    moments[X] = at_place[Z] + engine.shafts.position_m * engine.crank_radius_m * _shafts(engine, max_order)
    moments[Z] = -at_place[X]
    moments[Y] = (_phases(engine, max_order) * _for_each(engine, _rolling, max_order)).sum(axis=0)
    for weight in turning_weights(engine):
        if weight.order <= max_order:
            moments[:, weight.order] += np.cross([weight.x_m, weight.position_m, weight.z_m], weight.force_kg_m)
    return _at_speed(speed_rpm, moments)


@dataclass(frozen=True)
class TurningWeight:
    """A weight of a crank web or single balance shaft: its order, force over ω² (kg·m) by direction, and place (m)."""

    order: int
    force_kg_m: Complex
    x_m: float
    position_m: float
    z_m: float


def turning_weights(engine: Engine) -> tuple[TurningWeight, ...]:
    """Every weight of the crank webs and of the single balance shafts of ``engine``, as the crankcase feels it.

    A force is a complex peak, shape (3,): Re(force · exp(2πi order rev)). Source: m r Ω², Ω the speed of the shaft.
    """
    turning = [(1, 0.0, 0.0, weight) for weight in engine.webs]
    turning += [
        (shaft.speed_ratio, shaft.x_m, shaft.z_m, weight) for shaft in engine.shafts.single for weight in shaft.weights
    ]
    weights = []
    for ratio, x_m, z_m, weight in turning:
        sine, cosine = (float(part) for part in sine_cosine(weight.angle_deg / 360))
        size = 1e-6 * ratio**2 * weight.unbalance_g_mm
        # against the crank the heavy side stands at angle − |ratio| φ: along Z the conjugate turns with the crank
        along = size * complex(cosine, sine if ratio > 0 else -sine)
        across = -1j * along if ratio > 0 else 1j * along
        force = np.array([across, 0j, along])
        weights.append(TurningWeight(abs(ratio), force, x_m, weight.position_m, z_m))
    return tuple(weights)


def unbalance_force_n(unbalance_g_mm: ArrayLike, speed_rpm: ArrayLike) -> Angles:
    """Force (N) of an unbalance at a speed: 1e-6 · unbalance · ω², with no division by g.

    ``unbalance_g_mm``: mass times radius, or an amplitude over ω². ``speed_rpm``: speed of the shaft that carries it
    (for an amplitude over ω²: of the crank). The shapes must broadcast; the result has the common shape.
    Source: Ruckle 2014, equation (1), whose g belongs to weights only (truth sheet 2.1).
    """
    omega = np.asarray(speed_rpm, dtype=np.float64) * (np.pi / 30)
    return 1e-6 * np.asarray(unbalance_g_mm, dtype=np.float64) * omega**2


def newton(unbalance_g_mm: float, speed_rpm: float) -> float:
    """Force (N) of ``unbalance_g_mm``, an amplitude over ω², at ``speed_rpm`` of the crank."""
    return float(unbalance_force_n(unbalance_g_mm, speed_rpm))


def speed_key(speed_rpm: float) -> str:
    """``speed_rpm`` as tables and sentences name it: every digit that a user can have meant, no zeros at the end."""
    return f"{speed_rpm:.15g}"


def inertia_torque(engine: Engine, max_order: int) -> Complex:
    """Complex peak torque over ω² (kg·m²) that all masses of ``engine`` give to its crank, shape (max_order + 1,).

    A line is Re(torque · exp(2πi order rev)), rev the engine's crank angle. ``max_order``: ≥ 1.
    """
    each = _for_each(engine, inertia_torque_by_order, max_order)
    return np.asarray((_phases(engine, max_order) * each).sum(axis=0))


def _for_each(engine: Engine, by_order: Callable[[Engine, int], Complex], max_order: int) -> Complex:
    """``by_order`` of each cylinder alone, shape (cylinder, max_order + 1); of cylinders that are alike once."""
    alike = {(single.reciprocating_mass_kg, single.offset_m): single for single in engine.each}
    harmonics = {key: by_order(single, max_order) for key, single in alike.items()}
    return np.array([harmonics[single.reciprocating_mass_kg, single.offset_m] for single in engine.each])


def inertia_torque_by_order(engine: Engine, max_order: int) -> Complex:
    """Complex peak torque over ω² (kg·m²) that the masses of one cylinder give to the crank, shape (max_order + 1,).

    Counted from the cylinder's own dead centre, in the sense of rotation. ``engine``: lengths, masses and rod, those of
    a cylinder of its own aside; ``max_order``: ≥ 1.
    Without offset and true rod inertia it leads with m r² (λ/4 sin φ − ½ sin 2φ − ¾ λ sin 3φ).
    Source: energy, T = −½ ω² d/dφ (m x'² + (J − m a b) ψ'²).
    """
    every = last_order_above_round_off(engine.mechanism) + max_order
    orders = np.arange(every + 1)
    orders[0] = 1
    missing = two_masses(engine).missing_inertia_kg_m2
    velocity = engine.crank_radius_m * acceleration_harmonics(engine.mechanism, every) / (1j * orders)
    inertia = engine.reciprocating_mass_kg * _squared(velocity)
    if missing:
        inertia += missing * _squared(rod_acceleration_harmonics(engine.mechanism, every) / (1j * orders))
    return (-0.5j * np.arange(every + 1) * inertia)[: max_order + 1]


def orders_made(engine: Engine, *, share: float, max_order: int) -> tuple[float, ...]:
    """Orders up to ``max_order`` at which ``engine`` shakes or rocks its crankcase with ``share`` of the most.

    Of the forces and, where cylinders stand side by side, of the rocking moments: at least ``share`` of the largest
    one. What cancels to round-off counts for nothing. The share does not depend on speed, for every inertia force grows
    with its square.
    """
    size = max(float(np.abs(crankcase_forces(one, 1000.0, max_order=max_order)).max()) for one in engine.each)
    span = max(abs(cylinder.position_m) for cylinder in engine.cylinders)
    forces = np.abs(crankcase_forces(engine, 1000.0, max_order=max_order)).max(axis=0)
    rocking = np.abs(crankcase_moments(engine, 1000.0, max_order=max_order))[[X, Z]].max(axis=0)
    made = np.zeros(max_order + 1, dtype=bool)
    for acts, least in ((forces, CANCELLED * size), (rocking, CANCELLED * size * span)):
        made |= (acts >= share * acts.max()) & (acts > least)
    return tuple(float(order) for order in np.flatnonzero(made) if order > 0)


def _at_speed(speed_rpm: ArrayLike, per_omega_squared: Complex) -> Complex:
    omega = np.asarray(speed_rpm, dtype=np.float64) * (np.pi / 30)
    return (omega**2)[..., None, None] * per_omega_squared


def _phases(engine: Engine, max_order: int) -> Complex:
    """exp(i k angle) of each cylinder's crank from its own axis at crank angle zero, shape (cylinder, max_order + 1).

    Exact at quarter turns: what cancels in a flat or cross crankshaft cancels to nothing.
    """
    lead_rev = np.array([(cylinder.crank_deg - cylinder.bank_deg) / 360 for cylinder in engine.cylinders])
    sine, cosine = sine_cosine(lead_rev[:, None] * np.arange(max_order + 1))
    return cosine + 1j * sine


def _pistons(engine: Engine, max_order: int) -> Complex:
    """Complex mass of each cylinder by direction and order, shape (cylinder, 3, max_order + 1)."""
    shaken = _phases(engine, max_order) * _shaken(engine, max_order)
    across, along = sine_cosine(np.array([cylinder.bank_deg / 360 for cylinder in engine.cylinders]))
    axes = np.stack([across, np.zeros_like(along), along], axis=1)
    return axes[:, :, None] * shaken[:, None, :]


def _shaken(engine: Engine, max_order: int) -> Complex:
    """Mass of each piston times the harmonics of its acceleration, shape (cylinder, max_order + 1)."""
    harmonics = {cylinder.offset_m: acceleration_harmonics(cylinder.mechanism, max_order) for cylinder in engine.each}
    return np.array([cylinder.reciprocating_mass_kg * harmonics[cylinder.offset_m] for cylinder in engine.each])


def _shafts(engine: Engine, max_order: int) -> Complex:
    """Complex mass along Z that the pairs of balance shafts set against the pistons, shape (max_order + 1,).

    Raises RequestError for a pair at an order of which the pistons together make no force along Z.
    """
    against = np.zeros(max_order + 1, dtype=np.complex128)
    shafts = engine.shafts
    orders = [order for order in shafts.orders if order <= max_order]
    pairs = [pair for pair in shafts.pairs if pair.order <= max_order]
    if not orders and not pairs:
        return against
    shaken = _shaken(engine, max_order)
    _, along = sine_cosine(np.array([cylinder.bank_deg / 360 for cylinder in engine.cylinders]))
    phases = along[:, None] * _phases(engine, max_order)
    opposed = (phases * (shaken if shafts.timed_to == "force" else shaken.real)).sum(axis=0)
    terms = np.abs(shaken).sum(axis=0)
    for key, order in [("orders", order) for order in orders] + [("pairs", pair.order) for pair in pairs]:
        if abs(opposed[order]) <= CANCELLED * terms[order] and engine.largest_piston_kg:
            problem = "the pistons make no force along Z that this pair of shafts could stand against"
            remedy = "Leave it out, or state what acts in another direction as [[shafts.single]]"
            raise RequestError(problem, place=f"shafts.{key}", found=f"order {order}", remedy=remedy)
    if orders:
        unit = np.array([acceleration_harmonics(one.mechanism, max_order) for one in engine.each])
        left = (phases * (unit if shafts.timed_to == "force" else unit.real)).sum(axis=0)
        against[orders] = shafts.unbalanced_mass_kg * left[orders] - opposed[orders]
    for pair in pairs:
        size = 1e-6 * pair.order**2 * pair.unbalance_g_mm / engine.crank_radius_m
        against[pair.order] = -size * opposed[pair.order] / abs(opposed[pair.order])
    return against


def _rotating(engine: Engine) -> Complex:
    """First-order force over ω² of each throw's unbalance, shape (cylinder, 3)."""
    angle_rev = [(throw.cylinders[0].crank_deg + throw.rotating_unbalance_deg) / 360 for throw in engine.each]
    sine, cosine = sine_cosine(np.array(angle_rev))
    unbalance = np.array([throw.rotating_unbalance_kg_m for throw in engine.each]) * (cosine + 1j * sine)
    return np.stack([-1j * unbalance, np.zeros_like(unbalance), unbalance], axis=1)


def _rolling(engine: Engine, max_order: int) -> Complex:
    """Moment about Y over ω² of one cylinder, by order, counted from its own dead centre."""
    missing = two_masses(engine).missing_inertia_kg_m2
    moment = -inertia_torque_by_order(engine, max_order)
    if engine.offset_m:
        lever = engine.reciprocating_mass_kg * engine.offset_m * engine.crank_radius_m
        moment -= lever * acceleration_harmonics(engine.mechanism, max_order)
    if missing:
        moment -= missing * rod_acceleration_harmonics(engine.mechanism, max_order)
    return moment


def _squared(series: Complex) -> Complex:
    """Harmonics of the square of Re Σ series_k exp(ikφ); the mean is not needed and left at zero."""
    n = series.size
    sums = np.convolve(series, series)[:n]
    differences = np.correlate(series, series, mode="full")[n - 1 :]
    squared: Complex = 0.5 * sums + differences
    squared[0] = 0
    return squared


@dataclass(frozen=True, kw_only=True)
class TwoMasses:
    """A rod as a mass at the big end, one at the small end, and the moment of inertia that these two miss.

    ``missing_inertia_kg_m2`` is J − m a b, a and b the distances of the centre of gravity from the ends: negative for
    most rods, whose mass lies between their ends.
    """

    big_end_kg: float
    small_end_kg: float
    missing_inertia_kg_m2: float


def two_masses(engine: Engine) -> TwoMasses:
    """The rod of ``engine`` in two masses with the same centre of gravity: exact for forces, whatever its inertia.

    Without a rod in the data all is zero (its shares are then only in the engine's sums); without its inertia nothing
    is missing. Source: truth sheet sections 1 and 2.7.
    """
    rod = engine.rod
    if rod is None:
        return TwoMasses(big_end_kg=0.0, small_end_kg=0.0, missing_inertia_kg_m2=0.0)
    small = rod.mass_kg * rod.centre_from_big_end_m / engine.rod_length_m
    of_two = small * engine.rod_length_m * (engine.rod_length_m - rod.centre_from_big_end_m)
    missing = 0.0 if rod.inertia_kg_m2 is None else rod.inertia_kg_m2 - of_two
    return TwoMasses(big_end_kg=rod.mass_kg - small, small_end_kg=small, missing_inertia_kg_m2=missing)


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
    Source: Newton and Euler for piston and rod; the couple of the rod's inertia, (J − m a b) times its angular
    acceleration −ψ'' ω², by truth sheet 2.7.
    """
    stated = engine.cylinders[cylinder]
    angles = np.asarray(crank_angle_rev, dtype=np.float64)
    fires_rev = 0.0 if engine.gas is None else firing_angle_deg(engine, stated) / 360
    engine = engine.each[cylinder]
    gas = gas_force(engine, angles - fires_rev)
    own = angles + (stated.crank_deg - stated.bank_deg) / 360
    omega_squared = (speed_rpm * np.pi / 30) ** 2
    sine, cosine = sine_cosine(own)
    rod_sine, rod_cosine = rod_direction(sine, cosine, engine.mechanism)
    _, _, rod_acceleration = rod_angle(own, engine.mechanism)
    rod = two_masses(engine)
    # of one kilogram, away from the crankshaft
    inertia = omega_squared * plain_piston_acceleration(own, engine.mechanism)

    through_rod = gas - engine.reciprocating_mass_kg * inertia
    couple = -rod.missing_inertia_kg_m2 * omega_squared * rod_acceleration
    thrust = -(rod_sine * through_rod + couple / engine.rod_length_m) / rod_cosine
    radius = engine.crank_radius_m
    big_end = rod.big_end_kg * radius * omega_squared
    pin_along, pin_across = big_end * cosine - through_rod, big_end * sine - thrust

    rest_sine, rest_cosine = sine_cosine(own + engine.rotating_unbalance_deg / 360)
    rest = engine.rotating_unbalance_kg_m * omega_squared
    main_along = pin_along + rest * rest_cosine - big_end * cosine
    main_across = pin_across + rest * rest_sine - big_end * sine
    return CylinderLoads(
        side_thrust_n=thrust,
        piston_pin_n=np.stack([through_rod + rod.small_end_kg * inertia, thrust]),
        crank_pin_n=np.stack([pin_along, pin_across]),
        main_n=np.stack([main_along, main_across]),
        head_n=gas,
        torque_n_m=radius * (cosine * pin_across - sine * pin_along),
    )


def main_bearing_loads(
    engine: Engine, crank_angle_rev: ArrayLike, speed_rpm: float, loads: Sequence[CylinderLoads]
) -> Angles:
    """Load (N) of the crankshaft on each main bearing, shape (bearing, 3, …), directions as in ``DIRECTIONS``.

    Each throw is carried by the bearings before and behind it, as a beam on two supports: a statically determinate
    crankshaft. ``engine``: with ``main_bearings_m``. ``crank_angle_rev``: the engine's, any shape. ``speed_rpm``: ≥ 0.
    ``loads``: of each cylinder at these angles and this speed.
    """
    places, angles = np.array(engine.main_bearings_m), np.asarray(crank_angle_rev, dtype=np.float64)
    carried = np.zeros((places.size, len(DIRECTIONS), *angles.shape))
    for load, cylinder in zip(loads, engine.cylinders, strict=True):
        along, across = load.main_n
        lean_sine, lean_cosine = sine_cosine(cylinder.bank_deg / 360)
        for bearing, part in _carried(places, cylinder.position_m):
            carried[bearing, X] += part * (along * lean_sine + across * lean_cosine)
            carried[bearing, Z] += part * (along * lean_cosine - across * lean_sine)
    sine, cosine = sine_cosine(angles)
    for weight in turning_weights(engine.bare):
        force = (speed_rpm * np.pi / 30) ** 2 * weight.force_kg_m
        turning = np.multiply.outer(force.real, cosine) - np.multiply.outer(force.imag, sine)
        for bearing, part in _carried(places, weight.position_m):
            carried[bearing] += part * turning
    return carried


def _carried(places: Angles, position_m: float) -> tuple[tuple[int, float], tuple[int, float]]:
    """The two bearings that carry what acts at a position, and their shares; beyond the last ones it overhangs."""
    behind = min(max(int(np.searchsorted(places, position_m)), 1), places.size - 1)
    share = float((position_m - places[behind - 1]) / (places[behind] - places[behind - 1]))
    return (behind - 1, 1 - share), (behind, share)


# Gas: pressure, force on a piston, torque on the crank, and when each cylinder fires.


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


def gas_torque_by_order(engine: Engine, max_order: int) -> tuple[Angles, Complex]:
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
    alone: dict[float, Complex] = {}
    for single, cylinder in zip(engine.each, engine.cylinders, strict=True):
        if single.offset_m not in alone:
            alone[single.offset_m] = _spectrum(single)[lines]
        fires = firing_angle_deg(engine, cylinder) / 360
        total += alone[single.offset_m] * np.exp(-2j * np.pi * np.mod(fires / cycle * lines, 1))
    return lines / cycle, total


@lru_cache(maxsize=8)
def _spectrum(engine: Engine) -> Complex:
    """Gas torque of one cylinder by line of its cycle; the same for every speed, so it is kept."""
    angles = np.arange(engine.revs_per_cycle * SAMPLES_PER_REV) / SAMPLES_PER_REV
    torque: Complex = 2 * np.fft.rfft(gas_torque(engine, angles)) / angles.size
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
