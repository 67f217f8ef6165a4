"""Every way of balancing as an engine of its own: counterweights, balance shafts, crank webs, and the force they leave.

Forces of one order are split into what turns with the crank and what turns against it: a counterweight or shaft takes
one of these parts.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.balance_data import BalancedEngine, CounterweightPlaces
from crankorder.engine.definition import BalanceShafts, Cylinder, Engine, SingleShaft, Weight
from crankorder.engine.forces import (
    CANCELLED,
    DIRECTIONS,
    Amounts,
    AxisName,
    X,
    Y,
    Z,
    crankcase_forces,
    crankcase_moments,
)
from crankorder.engine.slider_crank import Complex, acceleration_harmonics, plain_piston_acceleration
from crankorder.errors import RequestError

Rotation = Literal["with crank", "against crank", "line", "none"]
Strategy = Literal["a", "b", "c", "d"]
Possibility = Literal["1", "2", "3", "4", "4+2"]
STRATEGIES: tuple[Strategy, ...] = get_args(Strategy)
POSSIBILITIES: tuple[Possibility, ...] = get_args(Possibility)
RECIPROCATING_SHARE: dict[Strategy, float] = {"a": 1.0, "b": 0.0, "c": 0.5}
"""Share of the reciprocating mass that the crank's counterweight stands against, beside the whole rotating mass."""
SHAFTS: dict[Possibility, tuple[Strategy, tuple[int, ...]]] = {
    "1": ("b", (1, -1)),
    "2": ("b", (2, -2)),
    "3": ("b", (1, -1, 2, -2)),
    "4": ("c", (-1,)),
    "4+2": ("c", (-1, 2, -2)),
}
"""Strategy that each possibility of additional shafts builds on, and speeds of its shafts over that of the crank."""
ROUND_OFF = 1e-12
"""Share of what the cylinders make one by one: what is below it of a sum, or of a difference, is round-off."""
ONE_RADIAN_PER_S_RPM = 30 / math.pi

ByAxis = dict[AxisName, Amounts | None]
"""Amounts by axis of the engine's frame; None for an axis that has none."""


@dataclass(frozen=True, kw_only=True)
class OrderForce:
    """Force of one order over ω², split into a part that turns with the crank and one that turns against it (g·mm).

    At crank angle φ it is ``direct`` exp(i order φ) + ``reverse`` exp(−i order φ); the real axis points along the
    cylinder away from the crankshaft, the imaginary axis across it, towards the side that the crank turns to.
    """

    order: int
    direct_g_mm: complex = 0j
    reverse_g_mm: complex = 0j

    @classmethod
    def of_axes(cls, *, order: int, along_g_mm: complex, across_g_mm: complex = 0j) -> OrderForce:
        """The force whose part along the cylinder is Re(along_g_mm exp(i order φ)), and likewise across it.

        ``order``: cycles per crank revolution, > 0. ``along_g_mm``, ``across_g_mm``: complex amplitudes over ω².
        """
        return cls(
            order=order,
            direct_g_mm=(along_g_mm + 1j * across_g_mm) / 2,
            reverse_g_mm=(along_g_mm - 1j * across_g_mm).conjugate() / 2,
        )

    @property
    def along_g_mm(self) -> complex:
        """Complex amplitude along the cylinder."""
        return self.direct_g_mm + self.reverse_g_mm.conjugate()

    @property
    def across_g_mm(self) -> complex:
        """Complex amplitude across the cylinder."""
        return -1j * (self.direct_g_mm - self.reverse_g_mm.conjugate())

    @property
    def largest_g_mm(self) -> float:
        """Largest size of the force during a turn: half the long axis of the ellipse that it draws."""
        return abs(self.direct_g_mm) + abs(self.reverse_g_mm)

    @property
    def rotation(self) -> Rotation:
        """Which way round the force goes; "line" where it only swings to and fro."""
        direct, reverse = abs(self.direct_g_mm), abs(self.reverse_g_mm)
        if direct == reverse == 0:
            return "none"
        if abs(direct - reverse) <= ROUND_OFF * max(direct, reverse):
            return "line"
        return "with crank" if direct > reverse else "against crank"


@dataclass(frozen=True, kw_only=True)
class OrderMotion:
    """Force and couple of one order over ω², each split into what turns with the crank and against it.

    ``force``: g·mm. ``couple``: g·mm², first moments of the force along the crankshaft, counted from position 0: its
    real axis is that of forces along Z, its imaginary one that of forces along X.
    """

    force: OrderForce
    couple: OrderForce


def order_motions(engine: Engine, max_order: int) -> tuple[OrderMotion, ...]:
    """Force and couple of orders 1 … ``max_order`` of the whole ``engine``, its webs and shafts included.

    What cancels to round-off is zero. Source: r × F along the crankshaft; direct and reverse parts after J. P. Den
    Hartog (1956), Mechanical Vibrations, section 5.3.
    """
    force = crankcase_forces(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order) * 1e6
    moment, terms = moments_g_mm2(engine, max_order), _terms_g_mm(engine, max_order)
    reaches = reach_g_mm2(engine, max_order)

    def split(order: int, along: complex, across: complex, size: float) -> OrderForce:
        def clean(amplitude: complex) -> complex:
            return amplitude if abs(amplitude) > ROUND_OFF * size else 0j

        parts = OrderForce.of_axes(order=order, along_g_mm=clean(complex(along)), across_g_mm=clean(complex(across)))
        return OrderForce(order=order, direct_g_mm=clean(parts.direct_g_mm), reverse_g_mm=clean(parts.reverse_g_mm))

    return tuple(
        OrderMotion(
            force=split(k, force[Z, k], force[X, k], terms[k]),
            couple=split(k, moment[X, k], -moment[Z, k], reaches[k]),
        )
        for k in range(1, max_order + 1)
    )


def forces_of(engine: Engine, max_order: int) -> tuple[OrderForce, ...]:
    """Force of the whole ``engine`` over ω² of orders 1 … ``max_order``; those that cancel are zero."""
    return tuple(motion.force for motion in order_motions(engine, max_order))


def _terms_g_mm(engine: Engine, max_order: int) -> NDArray[np.float64]:
    """Size of what is summed at each order 0 … ``max_order``: every piston, throw, web and shaft by itself."""
    terms = np.zeros(max_order + 1)
    for single in engine.each:
        terms += single.sliding_g_mm * np.abs(acceleration_harmonics(single.mechanism, max_order))
        terms[1] += 1e6 * single.rotating_unbalance_kg_m
    for shaft in (SingleShaft.model_construct(speed_ratio=1, weights=engine.webs), *engine.shafts.single):
        if abs(shaft.speed_ratio) <= max_order:
            size = sum(weight.unbalance_g_mm for weight in shaft.weights)
            terms[abs(shaft.speed_ratio)] += shaft.speed_ratio**2 * size
    return terms


def reach_g_mm2(engine: Engine, max_order: int) -> NDArray[np.float64]:
    """Sum of all forces of ``engine`` on the farthest lever at orders 0 … ``max_order`` (orders,): a scale."""
    places = [cylinder.position_m for cylinder in engine.cylinders] + [weight.position_m for weight in engine.webs]
    places += [weight.position_m for shaft in engine.shafts.single for weight in shaft.weights]
    lever_m = max(map(abs, [*places, engine.shafts.position_m])) + engine.rod_length_m
    reach: NDArray[np.float64] = 1e3 * lever_m * _terms_g_mm(engine, max_order)
    reach[1:] = np.maximum(reach[1:], ROUND_OFF * reach[1:].max())
    return reach


def polar_diagram(forces: Iterable[OrderForce], crank_angle_rev: ArrayLike) -> NDArray[np.complex128]:
    """Curve that the sum of the forces draws, over ω² (g·mm): real part along the cylinder, imaginary part across.

    ``forces``: by order. ``crank_angle_rev``: revolutions from top dead centre, any shape. Returns that shape; with
    rising angles the sequence of the points shows the direction of rotation.
    """
    angle = 2 * np.pi * np.asarray(crank_angle_rev, dtype=np.float64)
    curve = np.zeros(angle.shape, dtype=np.complex128)
    for force in forces:
        turn = np.exp(1j * force.order * angle)
        curve += force.direct_g_mm * turn + force.reverse_g_mm * turn.conj()
    return curve


def by_axis(forces: Iterable[OrderForce], number: Callable[[complex], float] = abs) -> ByAxis:
    """Amplitudes (g·mm over ω²) of ``forces`` by axis and order; None for an axis that has none.

    ``number``: what is told of each complex amplitude. With :func:`degrees_of` it is the phase: order k is
    amplitude · cos(k φ + phase), φ the crank angle.
    """
    every = tuple(forces)
    along = {str(force.order): number(force.along_g_mm) for force in every if force.along_g_mm}
    across = {str(force.order): number(force.across_g_mm) for force in every if force.across_g_mm}
    return {"Z": along or None, "X": across or None}


def moments_of(engine: Engine, max_order: int, number: Callable[[complex], float] = abs) -> ByAxis:
    """Inertia moments (g·mm² over ω²) of ``engine`` about X, Y and Z by order 1 … ``max_order``.

    None for an axis about which there is none. ``number``: what is stated of each complex amplitude, as for
    :func:`by_axis`.
    """
    moments = zip(DIRECTIONS, moments_g_mm2(engine, max_order), strict=True)
    return {
        axis: {str(k): number(complex(size)) for k, size in enumerate(sizes) if k and size} or None
        for axis, sizes in moments
    }


def moments_g_mm2(engine: Engine, max_order: int) -> Complex:
    """Complex inertia moment over ω² (g·mm²) on the crankcase, shape (3, max_order + 1); what cancels is zero.

    Directions as in ``DIRECTIONS``. ``engine``: with its shafts. ``max_order``: ≥ 1.
    """
    moments = 1e9 * crankcase_moments(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order)
    return np.where(np.abs(moments) > ROUND_OFF * reach_g_mm2(engine, max_order), moments, 0)


def degrees_of(amplitude: complex) -> float:
    """Phase of ``amplitude`` in degrees, above −180 and up to 180."""
    phase_deg = math.degrees(cmath.phase(amplitude))
    return phase_deg + (360.0 if phase_deg < -180 + 1e-9 else 0.0)


def phasor(angle_deg: float) -> complex:
    """Number of size one at ``angle_deg`` (degrees), exact at every quarter turn."""
    quarter = round(angle_deg / 90)
    rest = math.radians(angle_deg - 90 * quarter)
    return (1 + 0j, 1j, -1 + 0j, -1j)[quarter % 4] * cmath.rect(1, rest)


# One cylinder: counterweights on crank and rod, and additional shafts.


@dataclass(frozen=True, kw_only=True)
class Counterweights:
    """Masses (g) that a strategy adds: on the crank, opposite to its pin, and on the rod beyond the crank pin.

    ``crank_g`` below zero is to be taken off. ``crank_deg`` turns its place on, in the sense of the crank; it is zero
    where the mass lies along the crank.
    """

    crank_g: float
    crank_deg: float
    rod_g: float


def counterweights(engine: Engine, strategy: Strategy, places: CounterweightPlaces) -> Counterweights:
    """Counterweights (g) that a strategy asks for, below zero where the crank has too much already.

    ``engine``: of one cylinder, before balancing. ``strategy``: "a" cancels the first order along the cylinder, "b" the
    force across it, "c" leaves equal parts of both, "d" brings every centre of gravity to the crankshaft. ``places``:
    radii; the crank radius stands in for a missing one on the crank. Raises RequestError where "d" has no radius on
    the rod. Source: Task 5, equations (5.7), (5.10), (5.24), (5.31), (5.33).
    """
    sliding_g, radius_mm = 1e3 * engine.reciprocating_mass_kg, 1e3 * engine.crank_radius_m
    on_rod, share = 0.0, RECIPROCATING_SHARE.get(strategy, 1.0)
    if strategy == "d":
        if places.rod_mm is None:
            raise RequestError("strategy d needs a counterweight on the rod", place="rod_mm", remedy="State its radius")
        on_rod = sliding_g * 1e3 * engine.rod_length_m / places.rod_mm
    turning_g = 1e6 * engine.rotating_unbalance_kg_m / radius_mm * phasor(engine.rotating_unbalance_deg)
    against = (turning_g + share * sliding_g + on_rod) * radius_mm / (places.crank_mm or radius_mm)
    if not against.imag:
        return Counterweights(crank_g=against.real, crank_deg=0.0, rod_g=on_rod)
    return Counterweights(crank_g=abs(against), crank_deg=math.degrees(cmath.phase(against)), rod_g=on_rod)


def rod_counterweight_couple(
    engine: Engine, rod_g: float, rod_mm: float, crank_angle_rev: ArrayLike
) -> NDArray[np.float64]:
    """Couple over ω² on the frame (g·mm²) that a counterweight on the rod leaves where all forces cancel.

    ``engine``: lengths (an offset is not treated). ``rod_g``, ``rod_mm``: mass of the counterweight and its distance
    beyond the crank pin. ``crank_angle_rev``: revolutions, any shape; the result has that shape, positive in the sense
    of the crank. What the rod's true moment of inertia adds is not in it. Source: angular momentum of a point beyond
    the crank pin (truth sheet 0).
    """
    turn = np.exp(2j * np.pi * np.asarray(crank_angle_rev, dtype=np.float64))
    radius, length, ratio = 1e3 * engine.crank_radius_m, 1e3 * engine.rod_length_m, engine.mechanism.crank_ratio
    sine, cosine = turn.imag, turn.real
    rod_cosine = np.hypot(cosine, np.sqrt((1 - ratio) * (1 + ratio)) * sine)
    swing = 1e3 * plain_piston_acceleration(crank_angle_rev, engine.mechanism) - radius * cosine  # length · λ² · D
    place_x, place_y = radius * cosine - rod_mm * rod_cosine, (radius + rod_mm * ratio) * sine
    return np.asarray(rod_g * place_y * (place_x - radius * cosine + rod_mm / length * swing))


def balanced(engine: Engine, strategy: Strategy) -> Engine:
    """The ``engine`` of one cylinder with the counterweights of a ``strategy``, as what rotates and what slides.

    Source: Task 5, equations (5.8), (5.11), (5.25), (5.26).
    """
    if strategy == "d":
        return engine.model_copy(update={"rotating_unbalance_kg_m": 0.0, "reciprocating_mass_kg": 0.0})
    opposite = RECIPROCATING_SHARE[strategy] * 1e-6 * engine.sliding_g_mm
    return engine.model_copy(update={"rotating_unbalance_kg_m": opposite, "rotating_unbalance_deg": 180.0})


def with_shafts(engine: Engine, possibility: Possibility) -> Engine:
    """The ``engine`` of one cylinder with the additional shafts of a ``possibility`` and the counterweights below them.

    An order without force needs no shaft. Source: Task 5, equations (5.27) to (5.29).
    """
    strategy, ratios = SHAFTS[possibility]
    below = balanced(engine, strategy)
    return below.model_copy(update={"shafts": BalanceShafts(single=_shafts_against(below, ratios, (0.0, 0.0)))})


# Several cylinders: weights in two planes, on the crank webs and on shafts.


def designs(engine: Engine, *, orders: Sequence[int], planes_m: tuple[float, float]) -> dict[str, Engine]:
    """Designs of crank webs and shafts for ``engine`` as it is without its shafts, each one beyond the one before.

    First, "webs": counterweights on the crank in the two planes, for all of order 1 that turns with the crank. Then for
    each of ``orders``, "order k": shafts for the rest of it, one for each way round that there is something to cancel,
    with weights in the two planes for force and couple. A design that has nothing to add is left out.

    ``orders``: ascending, ≥ 1. ``planes_m``: two places along the crankshaft; where they are one, a couple stays.
    """
    design = engine.bare
    chosen: dict[str, Engine] = {}
    if webs := _weights(order_motions(design, 1)[0], 1, planes_m):
        chosen["webs"] = design = design.model_copy(update={"webs": (*engine.webs, *webs)})
    for k in orders:
        added = _shafts_against(design, (-1,) if k == 1 else (k, -k), planes_m)
        if added:
            shafts = BalanceShafts(single=(*design.shafts.single, *added))
            chosen[f"order {k}"] = design = design.model_copy(update={"shafts": shafts})
    return chosen


def designs_for(subject: BalancedEngine) -> dict[str, Engine]:
    """Crank webs and shafts for the orders and planes that the engine file of ``subject`` asks for."""
    return designs(subject.engine, orders=sorted(set(subject.balance.design_orders)), planes_m=subject.planes_m)


def systems(subject: BalancedEngine) -> dict[str, Engine]:
    """Every way of balancing the engine of ``subject`` as an engine, by name: "none" is the plain one, without shafts.

    Of one cylinder, which then stands upright: strategies and additional shafts. Of several: designs of webs and
    shafts. "own" is the engine with the shafts of its file, where it has any.
    """
    engine = subject.engine
    if subject.is_single:
        plain = engine.each[0].model_copy(update={"cylinders": (Cylinder(),)})
        names = [name for name in STRATEGIES if name != "d" or subject.balance.places.rod_mm is not None]
        ways = {"none": plain} | {str(name): balanced(plain, name) for name in names}
        ways |= {str(name): with_shafts(plain, name) for name in POSSIBILITIES}
    else:
        ways = {"none": engine.bare, **designs_for(subject)}
    return {**ways, "own": engine} if engine.shafts.every_order else ways


def throw_counterweights(engine: Engine) -> tuple[Weight, ...]:
    """Counterweight of each throw that takes what of order 1 turns with the crank, in its own plane.

    It stands against all that rotates and half of what goes to and fro, whatever the angles of the banks: the 50 %
    that balance a cross-plane V8 wholly. ``engine``: webs are left as they are.
    Source: a force along a line is two that turn, each of half its size (Den Hartog 1956, section 5.3).
    """
    counterweights = []
    for single, cylinder in zip(engine.each, engine.cylinders, strict=True):
        half = 0.5e-6 * single.sliding_g_mm * complex(acceleration_harmonics(single.mechanism, 1)[1])
        left = half + single.rotating_unbalance_kg_m * cmath.exp(1j * math.radians(single.rotating_unbalance_deg))
        if abs(left) <= CANCELLED * abs(half):  # its own counterweight takes it already
            left = 0j
        turn = cmath.exp(1j * math.radians(cylinder.crank_deg))
        counterweights.append(_weight(-1e6 * turn * left, cylinder.position_m))
    return tuple(counterweights)


def primary_shares(engine: Engine) -> dict[str, float | None]:
    """Share of the largest primary ``force`` and ``couple`` of the pistons of ``engine`` that crank webs can take.

    Half in an engine in line, all where order 1 turns with the crank, as in a 90° V-twin or a cross-plane V8; None
    where there is none.
    """
    first = order_motions(engine.pistons_alone, 1)[0]
    # what is left after the webs is the part against the crank, of constant size
    return {
        kind: abs(part.direct_g_mm) / part.largest_g_mm if part.largest_g_mm else None
        for kind, part in (("force", first.force), ("couple", first.couple))
    }


def roll_height_m(engine: Engine) -> float | None:
    """How much higher the second-order shaft with the crank must sit to take the masses' second-order roll moment too.

    For a pair that cancels the force of order 2 along Z: its two weights pull apart across the engine, and on a lever
    between them make a moment about the crankshaft. None where that moment and theirs are not in step.
    ``engine``: its shafts are left out. Source: H. Nakamura (1976), SAE 760111.
    """
    force = order_motions(engine.bare, 2)[1].force
    if not force.direct_g_mm or force.rotation != "line":
        return None
    roll = complex(moments_g_mm2(engine.bare, 2)[Y, 2])
    # the direct shaft pulls −direct·exp(ikφ), whose part across is −(−i·direct); a lever z makes z·across about Y
    height = -roll / (1j * force.direct_g_mm)
    return None if abs(height.imag) > ROUND_OFF**0.5 * abs(height) else 1e-3 * height.real


def _shafts_against(
    engine: Engine, speed_ratios: Sequence[int], planes_m: tuple[float, float]
) -> tuple[SingleShaft, ...]:
    """Shafts at ``speed_ratios`` times crank speed, each against the part of its order that turns as it does."""
    motions = order_motions(engine, max(map(abs, speed_ratios)))
    against = [(ratio, _weights(motions[abs(ratio) - 1], ratio, planes_m)) for ratio in speed_ratios]
    return tuple(SingleShaft(speed_ratio=ratio, weights=weights) for ratio, weights in against if weights)


def _weights(motion: OrderMotion, sense: int, planes_m: tuple[float, float]) -> tuple[Weight, ...]:
    """Weights in two planes, of a shaft at the order of ``motion``, against the part of it that turns one way.

    Source: two-plane balancing of each rotating vector: w₁ + w₂ = −F/n², y₁w₁ + y₂w₂ = −C/n².
    """
    force, couple = (part.direct_g_mm if sense > 0 else part.reverse_g_mm for part in (motion.force, motion.couple))
    force, couple = -force / motion.force.order**2, -couple / motion.force.order**2
    first_m, second_m = planes_m
    if first_m == second_m:
        return (_weight(force, first_m),) if force else ()
    if not force and not couple:
        return ()
    at_second = (couple - 1e3 * first_m * force) / (1e3 * second_m - 1e3 * first_m)
    return _weight(force - at_second, first_m), _weight(at_second, second_m)


def _weight(unbalance: complex, position_m: float) -> Weight:
    angle = math.degrees(cmath.phase(unbalance))
    angle = 0.0 if abs(angle) < 1e-12 else angle % 360
    return Weight(unbalance_g_mm=abs(unbalance), angle_deg=angle, position_m=position_m)
