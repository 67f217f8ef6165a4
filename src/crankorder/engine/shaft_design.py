"""Crank webs and balance shafts for engines of several cylinders, sized for force and couple together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.engine.balancing import OrderForce
from crankorder.engine.definition import BalanceShafts, Engine, SingleShaft, Weight
from crankorder.engine.forces import CANCELLED, X, Z, crankcase_forces, crankcase_moments
from crankorder.engine.harmonics import acceleration_harmonics

ONE_RADIAN_PER_S_RPM = 30 / math.pi
NOTHING = 1e-12
"""Of what the cylinders make one by one: what is left below it of a sum over them is round-off."""


@dataclass(frozen=True, kw_only=True)
class OrderMotion:
    """Force and couple of one order over ω², each split into what turns with the crank and against it.

    ``force``: g·mm. ``couple``: g·mm², first moments of the force along the crankshaft, counted from position 0: its
    real axis is that of forces along Z, its imaginary one that of forces along X.
    """

    force: OrderForce
    couple: OrderForce


@dataclass(frozen=True, kw_only=True)
class Design:
    """Counterweights on the crank webs and balance shafts that cancel some orders of an engine of several cylinders."""

    name: str
    webs: tuple[Weight, ...]
    shafts: tuple[SingleShaft, ...]

    def on(self, engine: Engine) -> Engine:
        """The ``engine`` with this design in place of its own shafts, beside the webs that it has."""
        return engine.model_copy(
            update={"webs": (*engine.webs, *self.webs), "shafts": BalanceShafts(single=self.shafts)}
        )


@dataclass(frozen=True, kw_only=True)
class PrimaryShares:
    """Share of order 1 that counterweights on the crank can take, of its largest force and couple; None without any."""

    force: float | None
    couple: float | None


def order_motions(engine: Engine, max_order: int) -> tuple[OrderMotion, ...]:
    """Force and couple of orders 1 … ``max_order`` of the whole ``engine``, its webs and shafts included.

    What cancels to round-off is zero. Source: r × F along the crankshaft; direct and reverse parts after J. P. Den
    Hartog (1956), Mechanical Vibrations, section 5.3.
    """
    force = crankcase_forces(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order) * 1e6
    moment = crankcase_moments(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order) * 1e9
    terms, reaches = _terms_g_mm(engine, max_order), reach_g_mm2(engine, max_order)
    found = []
    for k in range(1, max_order + 1):
        along, across = (_clean(complex(force[axis, k]), terms[k]) for axis in (Z, X))
        about_x, about_z = (_clean(complex(moment[axis, k]), reaches[k]) for axis in (X, Z))
        force_k, couple_k = _split(k, along, across, terms[k]), _split(k, about_x, -about_z, reaches[k])
        found.append(OrderMotion(force=force_k, couple=couple_k))
    return tuple(found)


def designs(
    engine: Engine, *, orders: Sequence[int], planes_m: tuple[float, float], max_order: int
) -> tuple[Design, ...]:
    """Designs for ``engine`` as it is without its shafts, each one beyond the one before.

    First, "webs": counterweights on the crank in the two planes, for all of order 1 that turns with the crank. Then for
    each of ``orders``, "order k": shafts for the rest of it, one for each way round that there is something to cancel,
    with weights in the two planes for force and couple. A design that has nothing to add is left out.

    ``orders``: ascending, ≥ 1. ``planes_m``: two places along the crankshaft; where they are one, a couple stays.
    ``max_order``: ≥ every order.
    Source: two-plane balancing of each rotating vector: w₁ + w₂ = −F/n², y₁w₁ + y₂w₂ = −C/n².
    """
    motions = order_motions(engine.model_copy(update={"shafts": BalanceShafts()}), max_order)
    webs = _weights(motions[0], 1, planes_m)
    made = [Design(name="webs", webs=webs, shafts=())] if webs else []
    shafts: tuple[SingleShaft, ...] = ()
    for k in orders:
        senses = (-1,) if k == 1 else (1, -1)
        added = [(sense * k, _weights(motions[k - 1], sense, planes_m)) for sense in senses]
        shafts += tuple(SingleShaft(speed_ratio=ratio, weights=weights) for ratio, weights in added if weights)
        if any(weights for _, weights in added):
            made.append(Design(name=f"order {k}", webs=webs, shafts=shafts))
    return tuple(made)


def throw_counterweights(engine: Engine) -> tuple[Weight, ...]:
    """Counterweight of each throw that takes what of order 1 turns with the crank, in its own plane.

    It stands against all that rotates and half of what goes to and fro, whatever the angles of the banks: the 50 %
    that balance a cross-plane V8 wholly. ``engine``: webs are left as they are.
    Source: a force along a line is two that turn, each of half its size (Den Hartog 1956, section 5.3).
    """
    made = []
    for one in engine.each:
        where = one.cylinders[0]
        turn = np.exp(1j * np.radians(where.crank_deg))
        first = complex(acceleration_harmonics(one.mechanism, 1)[1])
        half = 0.5 * one.reciprocating_mass_kg * one.crank_radius_m * first
        rest = one.rotating_unbalance_kg_m * np.exp(1j * np.radians(one.rotating_unbalance_deg))
        left = half + rest
        if abs(left) <= CANCELLED * abs(half):  # its own counterweight takes it already
            left = 0j
        made.append(_weight(complex(-1e6 * turn * left), where.position_m))
    return tuple(made)


def primary_shares(engine: Engine) -> PrimaryShares:
    """Share of the largest primary force and couple of the pistons of ``engine`` that crank webs can take.

    Half in an engine in line, all where order 1 turns with the crank, as in a 90° V-twin or a cross-plane V8.
    """
    first = order_motions(engine.pistons_alone, 1)[0]

    def share(part: OrderForce) -> float | None:
        direct, reverse = abs(part.direct_g_mm), abs(part.reverse_g_mm)
        # what is left after the webs is the part against the crank, of constant size
        return direct / (direct + reverse) if direct + reverse else None

    return PrimaryShares(force=share(first.force), couple=share(first.couple))


def roll_height_m(engine: Engine, order: int) -> float | None:
    """How much higher the shaft that turns with the crank must sit to take the inertia's roll moment of ``order`` too.

    For a pair that cancels the force of ``order`` along Z: its two weights pull apart across the engine, and on a lever
    between them make a moment about the crankshaft. None where that moment and theirs are not in step.
    ``engine``: its shafts are left out. Source: H. Nakamura (1976), SAE 760111.
    """
    bare = engine.model_copy(update={"shafts": BalanceShafts()})
    motion = order_motions(bare, max(order, 1))[order - 1]
    if not motion.force.direct_g_mm or motion.force.rotation != "line":
        return None
    roll = complex(crankcase_moments(bare, ONE_RADIAN_PER_S_RPM, max_order=order)[1, order]) * 1e9
    # the direct shaft pulls −direct·exp(ikφ), whose part across is −(−i·direct); a lever z makes z·across about Y
    across = 1j * motion.force.direct_g_mm
    height = -roll / across
    if abs(height.imag) > NOTHING**0.5 * abs(height):
        return None
    return 1e-3 * height.real


def _weights(motion: OrderMotion, sense: int, planes_m: tuple[float, float]) -> tuple[Weight, ...]:
    """Weights in two planes, of a shaft at the order of ``motion``, against the part of it that turns one way."""
    force, couple = (part.direct_g_mm if sense > 0 else part.reverse_g_mm for part in (motion.force, motion.couple))
    needs = -force / motion.force.order**2, -couple / motion.force.order**2
    if not force and not couple:
        return ()
    first, second = (1e3 * place for place in planes_m)
    if first == second:
        return (_weight(needs[0], planes_m[0]),) if force else ()
    at_second = (needs[1] - first * needs[0]) / (second - first)
    return _weight(needs[0] - at_second, planes_m[0]), _weight(at_second, planes_m[1])


def _weight(unbalance: complex, position_m: float) -> Weight:
    angle = math.degrees(math.atan2(unbalance.imag, unbalance.real))
    angle = 0.0 if abs(angle) < 1e-12 else angle % 360
    return Weight(unbalance_g_mm=abs(unbalance), angle_deg=angle, position_m=position_m)


def _split(order: int, along: complex, across: complex, size: float) -> OrderForce:
    split = OrderForce.of_axes(order=order, x_g_mm=along, y_g_mm=across)
    return OrderForce(
        order=order, direct_g_mm=_clean(split.direct_g_mm, size), reverse_g_mm=_clean(split.reverse_g_mm, size)
    )


def _clean(value: complex, size: float) -> complex:
    return value if abs(value) > NOTHING * size else 0j


def _terms_g_mm(engine: Engine, max_order: int) -> NDArray[np.float64]:
    """Size of what is summed at each order 0 … ``max_order``: every piston, throw, web and shaft by itself."""
    terms = np.zeros(max_order + 1)
    for one in engine.each:
        harmonics = np.abs(acceleration_harmonics(one.mechanism, max_order))
        terms += 1e6 * (one.reciprocating_mass_kg * one.crank_radius_m * harmonics)
        terms[1] += 1e6 * one.rotating_unbalance_kg_m
    terms[1] += sum(weight.unbalance_g_mm for weight in engine.webs)
    for shaft in engine.shafts.single:
        if abs(shaft.speed_ratio) <= max_order:
            size = sum(weight.unbalance_g_mm for weight in shaft.weights)
            terms[abs(shaft.speed_ratio)] += shaft.speed_ratio**2 * size
    return terms


def reach_g_mm2(engine: Engine, max_order: int) -> NDArray[np.float64]:
    """Size of what is summed in the moments of ``engine`` at orders 0 … ``max_order``: forces on the farthest lever."""
    places = [cylinder.position_m for cylinder in engine.cylinders] + [weight.position_m for weight in engine.webs]
    places += [weight.position_m for shaft in engine.shafts.single for weight in shaft.weights]
    lever_m = max(map(abs, [*places, engine.shafts.position_m])) + engine.rod_length_m
    reach: NDArray[np.float64] = 1e3 * lever_m * _terms_g_mm(engine, max_order)
    reach[1:] = np.maximum(reach[1:], NOTHING * reach[1:].max())
    return reach
