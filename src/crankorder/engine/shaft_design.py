"""Force and moments of a whole engine by order, and crank webs and balance shafts sized for both together."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.engine.balance_data import Amounts, BalancedEngine, newton, speed_key
from crankorder.engine.balancing import OrderForce
from crankorder.engine.definition import BalanceShafts, Engine, SingleShaft, Weight
from crankorder.engine.forces import CANCELLED, DIRECTIONS, X, Z, crankcase_forces, crankcase_moments
from crankorder.engine.shafts import ONE_RADIAN_PER_S_RPM, SeriesResiduals, series_residuals
from crankorder.engine.slider_crank import acceleration_harmonics
from crankorder.errors import plain_number
from crankorder.records import Record, said

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


class PrimaryShares(Record):
    """Share of order 1 that counterweights on the crank can take."""

    force: float | None = said("of its largest force; null without any")
    couple: float | None = said("of its largest couple; null without any")


def order_motions(engine: Engine, max_order: int) -> tuple[OrderMotion, ...]:
    """Force and couple of orders 1 … ``max_order`` of the whole ``engine``, its webs and shafts included.

    What cancels to round-off is zero. Source: r × F along the crankshaft; direct and reverse parts after J. P. Den
    Hartog (1956), Mechanical Vibrations, section 5.3.
    """
    force = crankcase_forces(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order) * 1e6
    moment = crankcase_moments(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order) * 1e9
    terms, reaches = _terms_g_mm(engine, max_order), reach_g_mm2(engine, max_order)
    return tuple(
        OrderMotion(
            force=_split(k, complex(force[Z, k]), complex(force[X, k]), terms[k]),
            couple=_split(k, complex(moment[X, k]), -complex(moment[Z, k]), reaches[k]),
        )
        for k in range(1, max_order + 1)
    )


def designs(engine: Engine, *, orders: Sequence[int], planes_m: tuple[float, float]) -> tuple[Design, ...]:
    """Designs for ``engine`` as it is without its shafts, each one beyond the one before.

    First, "webs": counterweights on the crank in the two planes, for all of order 1 that turns with the crank. Then for
    each of ``orders``, "order k": shafts for the rest of it, one for each way round that there is something to cancel,
    with weights in the two planes for force and couple. A design that has nothing to add is left out.

    ``orders``: ascending, ≥ 1. ``planes_m``: two places along the crankshaft; where they are one, a couple stays.
    Source: two-plane balancing of each rotating vector: w₁ + w₂ = −F/n², y₁w₁ + y₂w₂ = −C/n².
    """
    motions = order_motions(engine.model_copy(update={"shafts": BalanceShafts()}), max([1, *orders]))
    webs = _weights(motions[0], 1, planes_m)
    chosen = [Design(name="webs", webs=webs, shafts=())] if webs else []
    shafts: tuple[SingleShaft, ...] = ()
    for k in orders:
        senses = (-1,) if k == 1 else (1, -1)
        added = [(sense * k, _weights(motions[k - 1], sense, planes_m)) for sense in senses]
        shafts += tuple(SingleShaft(speed_ratio=ratio, weights=weights) for ratio, weights in added if weights)
        if any(weights for _, weights in added):
            chosen.append(Design(name=f"order {k}", webs=webs, shafts=shafts))
    return tuple(chosen)


def throw_counterweights(engine: Engine) -> tuple[Weight, ...]:
    """Counterweight of each throw that takes what of order 1 turns with the crank, in its own plane.

    It stands against all that rotates and half of what goes to and fro, whatever the angles of the banks: the 50 %
    that balance a cross-plane V8 wholly. ``engine``: webs are left as they are.
    Source: a force along a line is two that turn, each of half its size (Den Hartog 1956, section 5.3).
    """
    counterweights = []
    for single, cylinder in zip(engine.each, engine.cylinders, strict=True):
        turn = np.exp(1j * np.radians(cylinder.crank_deg))
        first = complex(acceleration_harmonics(single.mechanism, 1)[1])
        half = 0.5 * single.reciprocating_mass_kg * single.crank_radius_m * first
        rest = single.rotating_unbalance_kg_m * np.exp(1j * np.radians(single.rotating_unbalance_deg))
        left = half + rest
        if abs(left) <= CANCELLED * abs(half):  # its own counterweight takes it already
            left = 0j
        counterweights.append(_weight(complex(-1e6 * turn * left), cylinder.position_m))
    return tuple(counterweights)


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


def roll_height_m(engine: Engine) -> float | None:
    """How much higher the second-order shaft with the crank must sit to take the masses' second-order roll moment too.

    For a pair that cancels the force of order 2 along Z: its two weights pull apart across the engine, and on a lever
    between them make a moment about the crankshaft. None where that moment and theirs are not in step.
    ``engine``: its shafts are left out. Source: H. Nakamura (1976), SAE 760111.
    """
    bare = engine.model_copy(update={"shafts": BalanceShafts()})
    motion = order_motions(bare, 2)[1]
    if not motion.force.direct_g_mm or motion.force.rotation != "line":
        return None
    roll = complex(crankcase_moments(bare, ONE_RADIAN_PER_S_RPM, max_order=2)[1, 2]) * 1e9
    # the direct shaft pulls −direct·exp(ikφ), whose part across is −(−i·direct); a lever z makes z·across about Y
    across = 1j * motion.force.direct_g_mm
    height = -roll / across
    if abs(height.imag) > NOTHING**0.5 * abs(height):
        return None
    return 1e-3 * height.real


def _weights(motion: OrderMotion, sense: int, planes_m: tuple[float, float]) -> tuple[Weight, ...]:
    """Weights in two planes, of a shaft at the order of ``motion``, against the part of it that turns one way."""
    force, couple = (part.direct_g_mm if sense > 0 else part.reverse_g_mm for part in (motion.force, motion.couple))
    force, couple = -force / motion.force.order**2, -couple / motion.force.order**2
    if not force and not couple:
        return ()
    first_m, second_m = planes_m
    if first_m == second_m:
        return (_weight(force, first_m),) if force else ()
    at_second = (couple - 1e3 * first_m * force) / (1e3 * second_m - 1e3 * first_m)
    return _weight(force - at_second, first_m), _weight(at_second, second_m)


def _weight(unbalance: complex, position_m: float) -> Weight:
    angle = math.degrees(math.atan2(unbalance.imag, unbalance.real))
    angle = 0.0 if abs(angle) < 1e-12 else angle % 360
    return Weight(unbalance_g_mm=abs(unbalance), angle_deg=angle, position_m=position_m)


def _split(order: int, along: complex, across: complex, size: float) -> OrderForce:
    """Parts of one order that turn with the crank and against it, without what is round-off of terms of ``size``."""

    def clean(amplitude: complex) -> complex:
        return amplitude if abs(amplitude) > NOTHING * size else 0j

    split = OrderForce.of_axes(order=order, x_g_mm=clean(along), y_g_mm=clean(across))
    return OrderForce(order=order, direct_g_mm=clean(split.direct_g_mm), reverse_g_mm=clean(split.reverse_g_mm))


def _terms_g_mm(engine: Engine, max_order: int) -> NDArray[np.float64]:
    """Size of what is summed at each order 0 … ``max_order``: every piston, throw, web and shaft by itself."""
    terms = np.zeros(max_order + 1)
    for single in engine.each:
        harmonics = np.abs(acceleration_harmonics(single.mechanism, max_order))
        terms += 1e6 * (single.reciprocating_mass_kg * single.crank_radius_m * harmonics)
        terms[1] += 1e6 * single.rotating_unbalance_kg_m
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


ByAxis = dict[str, Amounts | None]
"""Amounts by axis; None for an axis that has none."""

MOMENT_AXES = {"about_x": "Z", "about_y": "X", "about_crankshaft": "Y"}
"""Axes that moments are named for in a balance sheet, and the engine's direction that each of them is."""
ALIGNED_SHARE = 1e-9
"""A moment below this share of the largest is not told of in a sentence."""


def whole_force(engine: Engine, max_order: int) -> tuple[OrderForce, ...]:
    """Force of the whole ``engine`` over ω² of orders 1 … ``max_order``, without those that cancel."""
    forces = (motion.force for motion in order_motions(engine, max_order))
    return tuple(force for force in forces if force.rotation != "none")


def by_axis(forces: Iterable[OrderForce], number: Callable[[complex], float] = abs) -> ByAxis:
    """Amplitudes (g·mm over ω²) of ``forces`` by axis and order; None for an axis that has none.

    ``number``: what is told of each complex amplitude. With :func:`degrees_of` it is the phase: order k is
    amplitude · cos(k φ + phase), φ the crank angle.
    """
    every = tuple(forces)
    along = {f"{force.order:g}": number(force.x_g_mm) for force in every if force.x_g_mm}
    across = {f"{force.order:g}": number(force.y_g_mm) for force in every if force.y_g_mm}
    return {"x": along or None, "y": across or None}


def whole_moments(
    engine: Engine, max_order: int, number: Callable[[complex], float] = lambda moment: abs(1e9 * moment)
) -> ByAxis:
    """Moments (g·mm² over ω²) of ``engine`` by order 1 … ``max_order`` about Z, X and the crankshaft.

    None for an axis about which there is none. ``number``: what is stated of each complex amplitude (kg·m²), as for
    :func:`by_axis`.
    """
    moments = crankcase_moments(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order)
    least = NOTHING * reach_g_mm2(engine, max_order)
    tables: ByAxis = {}
    for name, axis in MOMENT_AXES.items():
        by_order = [complex(moment) for moment in moments[DIRECTIONS.index(axis)]]
        orders = [k for k in range(1, max_order + 1) if abs(1e9 * by_order[k]) > least[k]]
        tables[name] = {str(k): number(by_order[k]) for k in orders} or None
    return tables


def degrees_of(amplitude: complex) -> float:
    """Phase of ``amplitude`` in degrees, above −180 and up to 180."""
    phase_deg = math.degrees(cmath.phase(amplitude))
    return 180.0 if phase_deg == -180.0 else phase_deg + 0.0


class Residual(Record):
    """Force and moment that remain, by axis and order."""

    force_g_mm: ByAxis = said("amplitude of the force, g·mm over ω²", key="residual_g_mm")
    phase_deg: ByAxis | None = said(
        "phase of the force, degrees", key="residual_phase_deg", left_out=True, default=None
    )
    moment_g_mm2: ByAxis | None = said(
        "amplitude of the moment, g·mm² over ω²", key="residual_moment_g_mm2", left_out=True, default=None
    )


class PlacedWeight(Record):
    """A weight of a crank web or a balance shaft."""

    unbalance_g_mm: float = said("mass times radius, g·mm")
    angle_deg: float = said("its heavy side at crank angle 0, degrees from Z towards X")
    position_mm: float = said("place along the crankshaft, mm")


class DesignedShaft(Record):
    """A balance shaft of a design."""

    speed_ratio: int = said("speed over crank speed, below zero against the crank")
    weights: tuple[PlacedWeight, ...] = said("its weights")


class DesignLayout(Record):
    """Crank webs and balance shafts of a design, and what they leave."""

    webs: tuple[PlacedWeight, ...] = said("counterweights on the crank webs")
    shafts: tuple[DesignedShaft, ...] = said("balance shafts")
    left: Residual = said("what remains", spread=True)


class DesignBalance(Record):
    """Designs of crank webs and balance shafts for an engine of several cylinders."""

    planes_mm: tuple[float, ...] = said("planes of the weights along the crankshaft, mm")
    primary_share: PrimaryShares = said("share of order 1 of the pistons that crank webs can take")
    throw_counterweights: tuple[PlacedWeight, ...] = said("counterweight of each throw in its own plane")
    roll_height_mm: float | None = said("how much higher the second-order shaft with the crank must sit, mm")
    layouts: dict[str, DesignLayout] = said("designs by name, each one beyond the one before")


def design_balance(subject: BalancedEngine, max_order: int) -> DesignBalance:
    """Crank webs and shafts for the engine of ``subject`` without its own shafts, and what each design leaves.

    ``max_order``: highest order of what is left.
    """
    engine, height = subject.engine, roll_height_m(subject.engine)

    def layout(design: Design) -> DesignLayout:
        left = design.on(engine)
        force, moment = by_axis(whole_force(left, max_order)), whole_moments(left, max_order)
        shafts = (
            DesignedShaft(speed_ratio=shaft.speed_ratio, weights=_placed(shaft.weights)) for shaft in design.shafts
        )
        residual = Residual(force_g_mm=force, moment_g_mm2=moment)
        return DesignLayout(webs=_placed(design.webs), shafts=tuple(shafts), left=residual)

    return DesignBalance(
        planes_mm=tuple(1e3 * place for place in _planes_m(subject)),
        primary_share=primary_shares(engine),
        throw_counterweights=_placed(throw_counterweights(engine)),
        roll_height_mm=None if height is None else 1e3 * height,
        layouts={design.name: layout(design) for design in designs_for(subject)},
    )


def designs_for(subject: BalancedEngine) -> tuple[Design, ...]:
    """Crank webs and shafts for the orders and planes that the engine file of ``subject`` asks for."""
    return designs(subject.engine, orders=sorted(set(subject.balance.design_orders)), planes_m=_planes_m(subject))


def tolerance_of(subject: BalancedEngine, max_order: int) -> SeriesResiduals | None:
    """Study of the tolerances that the file of ``subject`` states: of its own shafts, else of the last design.

    None where it states none. ``max_order``: of the tables.
    """
    tolerances, engine = subject.balance.tolerances, subject.engine
    if tolerances is None:
        return None
    designed = () if engine.shafts.every_order or len(engine.cylinders) == 1 else designs_for(subject)
    studied = designed[-1].on(engine) if designed else engine
    of = designed[-1].name if designed else "own" if engine.shafts.every_order else "none"
    return series_residuals(studied, tolerances, max_order=max([max_order, *studied.shafts.every_order]), of=of)


def _planes_m(subject: BalancedEngine) -> tuple[float, float]:
    places = [cylinder.position_m for cylinder in subject.engine.cylinders]
    return subject.balance.design_planes_m or (min(places), max(places))


def _placed(weights: Iterable[Weight]) -> tuple[PlacedWeight, ...]:
    return tuple(
        PlacedWeight(
            unbalance_g_mm=weight.unbalance_g_mm, angle_deg=weight.angle_deg, position_mm=1e3 * weight.position_m
        )
        for weight in weights
    )


def moment_sentences(moments: ByAxis, speed_rpm: float, *, state: str = "") -> list[str]:
    """What couples and roll moment are left, by order, with their size at ``speed_rpm``.

    ``moments``: by axis and order, as :func:`whole_moments` gives them. ``state``: words that come first.
    """
    largest = max((size for orders in moments.values() for size in (orders or {}).values()), default=0.0)
    sentences = []
    for name, what in (
        ("about_y", "a rocking couple about X"),
        ("about_x", "a rocking couple about Z"),
        ("about_crankshaft", "a roll moment of the masses about the crankshaft"),
    ):
        shown = [(order, size) for order, size in (moments.get(name) or {}).items() if size > ALIGNED_SHARE * largest]
        top = sorted(sorted(shown, key=lambda line: -line[1])[:3], key=lambda line: float(line[0]))
        if top:
            couples = [(order, plain_number(1e-3 * newton(size, speed_rpm))) for order, size in top]
            sizes = listed([f"{couple} N·m of order {order}" for order, couple in couples])
            text = f"{state + ' ' if state else ''}{what} remains: {sizes} at {speed_key(speed_rpm)} rpm."
            sentences.append(text[0].upper() + text[1:])
    return sentences


def design_sentences(design: DesignBalance, speed_rpm: float) -> list[str]:
    """What crank webs can take of an engine of several cylinders, what shafts it needs, and what these leave.

    ``design``: of the engine. ``speed_rpm``: at which sizes are named.
    """
    shares = {"force": design.primary_share.force, "couple": design.primary_share.couple}
    sentences = [
        f"Crank webs can take {plain_number(100 * share)} % of the primary {kind} of the pistons."
        for kind, share in shares.items()
        if share is not None
    ]
    for name, layout in design.layouts.items():
        left = _left(layout.left, speed_rpm)
        if name == "webs":
            sentences.append(f"Counterweights on the crank webs alone leave {left}.")
            continue
        ratios = [f"{shaft.speed_ratio:+d}".replace("-", "−") for shaft in layout.shafts]
        shafts = listed([f"at {ratio} times crank speed" for ratio in ratios])
        webs = "with those counterweights " if layout.webs else ""
        number, leave = ("one shaft", "leaves") if len(layout.shafts) == 1 else ("shafts", "leave")
        text = f"{webs}{number} {shafts} {leave} {left}."
        sentences.append(text[0].upper() + text[1:])
    height = design.roll_height_mm
    if height is not None and abs(height) > 1e-9:
        where = "above" if height > 0 else "below"
        sentences.append(
            f"Where the second-order shaft that turns with the crank sits {plain_number(abs(height))} mm {where} the "
            "other, the pair takes the second-order roll moment of the masses too."
        )
    return sentences


def _left(residual: Residual, speed_rpm: float) -> str:
    """The largest force and the largest couple that a design leaves, in words."""
    parts, at = [], f"at {speed_key(speed_rpm)} rpm"
    for axes, scale, unit, names, nothing in (
        (residual.force_g_mm, 1.0, "N", {"x": "along Z", "y": "along X"}, "no force"),
        (residual.moment_g_mm2 or {}, 1e-3, "N·m", {"about_y": "about X", "about_x": "about Z"}, "no rocking couple"),
    ):
        every = [(size, order, text) for axis, text in names.items() for order, size in (axes.get(axis) or {}).items()]
        if every:
            size, order, text = max(every)
            amount = plain_number(scale * newton(size, speed_rpm))
            parts.append(f"at most {amount} {unit} of order {order} {text} {at}")
        else:
            parts.append(nothing)
    if parts == ["no force", "no rocking couple"]:
        return "neither force nor rocking couple"
    return " and ".join([parts[0].removesuffix(f" {at}") if parts[1].endswith(at) else parts[0], parts[1]])


def listed(words: Sequence[str]) -> str:
    """``words`` as one phrase: "a, b and c"."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)
