"""What errors of masses, pins and shaft timing leave of a balanced engine."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from crankorder.engine.definition import BalanceShafts, Engine, SingleShaft, Weight
from crankorder.engine.forces import Z, crankcase_forces
from crankorder.engine.machine_parts import EngineData, NonNegative
from crankorder.engine.slider_crank import Complex, acceleration_harmonics
from crankorder.errors import plain_number
from crankorder.records import Record, said

Floats = NDArray[np.float64]
Parts = NDArray[np.complex128]
"""Direct and reverse part by sample and order 1, 2, …: shape (2, sample, order)."""

ONE_RADIAN_PER_S_RPM = 30 / math.pi
QUANTILES = {"2.5 %": 0.025, "median": 0.5, "95 %": 0.95, "97.5 %": 0.975}
NO_FORCE_G_MM, NO_COUPLE_G_MM2 = 1e-6, 1e-3
"""What is smaller is rounding: at 10,000 rpm a millionth of a newton, and of a newton metre."""


class BalanceTolerances(EngineData):
    """Errors of a series of engines, each even between plus and minus what is stated.

    ``reciprocating_g``: of each cylinder. ``rotating_g_mm``: unbalance added to each throw, any direction, up to this.
    ``pin_deg``: of each crank pin. ``shaft_percent``: of each weight of a balance shaft. ``gear_deg``: of each shaft's
    own angle. ``mistiming_deg``: one case beside the series, all shafts late by it.
    """

    reciprocating_g: NonNegative = 0.0
    rotating_g_mm: NonNegative = 0.0
    pin_deg: NonNegative = 0.0
    shaft_percent: NonNegative = 0.0
    gear_deg: NonNegative = 0.0
    mistiming_deg: float | None = None
    samples: Annotated[int, Field(ge=100, le=20_000)] = 2000
    seed: Annotated[int, Field(ge=0)] = 0


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of a series of engines, by sample and cylinder, weight of a shaft or shaft."""

    mass_g: Floats
    throw_g_mm: Complex
    pin_rad: Floats
    weight_share: Floats
    gear_rad: Floats


def with_single_shafts(engine: Engine, max_order: int) -> Engine:
    """The ``engine`` with each of its pairs as two single shafts that make the same force, orders to ``max_order``."""
    shafts = engine.shafts
    bare = engine.model_copy(update={"shafts": BalanceShafts()})
    paired = engine.model_copy(update={"shafts": shafts.model_copy(update={"single": ()})})
    force_g_mm = 1e6 * (
        crankcase_forces(paired, ONE_RADIAN_PER_S_RPM, max_order=max_order)[Z]
        - crankcase_forces(bare, ONE_RADIAN_PER_S_RPM, max_order=max_order)[Z]
    )
    orders = sorted({*shafts.orders, *(pair.order for pair in shafts.pairs)})
    single = [
        SingleShaft(
            speed_ratio=sense * k,
            weights=(
                Weight(
                    unbalance_g_mm=float(abs(force_g_mm[k])) / (2 * k**2),
                    angle_deg=sense * math.degrees(float(np.angle(force_g_mm[k]))),
                    position_m=shafts.position_m,
                ),
            ),
        )
        for k in orders
        for sense in (1, -1)
    ]
    return engine.model_copy(update={"shafts": BalanceShafts(single=(*single, *shafts.single))})


Spread = dict[str, dict[str, float]]
"""Quantiles of a series by order."""


class Mistiming(Record):
    """What remains where all balance shafts are late by one angle."""

    deg: float = said("the angle, degrees")
    orders: tuple[str, ...] = said("orders of the shafts")
    force_g_mm: dict[str, float] = said("force by order, g·mm over ω²")
    couple_g_mm2: dict[str, float] = said("couple by order, g·mm² over ω²")


class SeriesResiduals(Record):
    """Force and couple that a series of engines within tolerances leaves, and what one mistiming leaves."""

    of: str = said("shafts that were studied: own, a design, or none", default="none")
    samples: int = said("engines drawn")
    seed: int = said("of the random numbers")
    force_g_mm: Spread = said("quantiles of the force by order, g·mm over ω²")
    couple_g_mm2: Spread = said("quantiles of the couple by order, g·mm² over ω²")
    mistiming: Mistiming | None = said("of all shafts, where the file states one")


def series_residuals(
    engine: Engine, tolerances: BalanceTolerances, *, max_order: int, of: str = "none"
) -> SeriesResiduals:
    """Force and couple that a series of engines leaves by order, and one stated mistiming.

    ``engine``: balanced, by its webs and shafts. ``tolerances``: of the series. ``max_order``: highest order, ≥ 1 and
    not below any shaft's. ``of``: name of the shafts.
    The residual of an order is the most of a turn: the large half axis of its ellipse.
    """
    studied = with_single_shafts(engine, max_order)
    force, couple = _left(studied, _draw(studied, tolerances), max_order)
    late = None
    if tolerances.mistiming_deg is not None and studied.shafts.single:
        exact = _draw(studied, BalanceTolerances(samples=100))
        late_errors = replace(exact, gear_rad=np.full_like(exact.gear_rad, -np.radians(tolerances.mistiming_deg)))
        of_force, of_couple = (
            {str(k): float(size) for k, size in enumerate(_most(parts)[0], start=1)}
            for parts in _left(studied, late_errors, max_order)
        )
        turning = sorted({abs(shaft.speed_ratio) for shaft in studied.shafts.single})
        late = Mistiming(
            deg=tolerances.mistiming_deg, orders=tuple(map(str, turning)), force_g_mm=of_force, couple_g_mm2=of_couple
        )
    sizes = {"force_g_mm": _quantiles(force), "couple_g_mm2": _quantiles(couple)}
    return SeriesResiduals(of=of, samples=tolerances.samples, seed=tolerances.seed, **sizes, mistiming=late)


def _draw(engine: Engine, tolerances: BalanceTolerances) -> Errors:
    draw = np.random.default_rng(tolerances.seed)
    n, cylinders, single = tolerances.samples, len(engine.cylinders), engine.shafts.single
    weights = sum(len(shaft.weights) for shaft in single)
    mass = draw.uniform(-1, 1, (n, cylinders))
    throw = np.sqrt(draw.uniform(0, 1, (n, cylinders))) * np.exp(2j * np.pi * draw.uniform(0, 1, (n, cylinders)))
    return Errors(
        mass_g=tolerances.reciprocating_g * mass,
        throw_g_mm=tolerances.rotating_g_mm * throw,
        pin_rad=np.radians(tolerances.pin_deg) * draw.uniform(-1, 1, (n, cylinders)),
        weight_share=tolerances.shaft_percent / 100 * draw.uniform(-1, 1, (n, weights)),
        gear_rad=np.radians(tolerances.gear_deg) * draw.uniform(-1, 1, (n, len(single))),
    )


def _left(engine: Engine, errors: Errors, max_order: int) -> tuple[Parts, Parts]:
    """Force (g·mm) and couple (g·mm²) over ω² of every sample."""
    parts = np.zeros((2, 2, errors.mass_g.shape[0], max_order), dtype=np.complex128)  # force and couple
    for n, (single, cylinder) in enumerate(zip(engine.each, engine.cylinders, strict=True)):
        bank = math.radians(cylinder.bank_deg)
        turned = np.radians(cylinder.crank_deg) + errors.pin_rad[:, n]
        mass_g = 1e3 * single.reciprocating_mass_kg + errors.mass_g[:, n]
        harmonics = acceleration_harmonics(single.mechanism, max_order)[1:]
        # powers by products: much faster than as many exponentials
        turns = np.broadcast_to(np.exp(1j * (turned - bank))[:, None], (turned.size, max_order))
        line = 0.5e3 * single.crank_radius_m * mass_g[:, None] * harmonics * np.cumprod(turns, axis=1)
        tilt = np.exp(1j * bank)
        _add(parts, line * tilt, line.conj() * tilt, cylinder.position_m, slice(None))
        rest = 1e6 * single.rotating_unbalance_kg_m * np.exp(1j * np.radians(single.rotating_unbalance_deg))
        _add(parts, (rest + errors.throw_g_mm[:, n]) * np.exp(1j * turned), 0.0, cylinder.position_m, 0)
    for web in engine.webs:
        _add(parts, np.asarray(web.unbalance_g_mm * np.exp(1j * np.radians(web.angle_deg))), 0.0, web.position_m, 0)
    counted = 0
    for number, shaft in enumerate(engine.shafts.single):
        ahead, k = math.copysign(1, shaft.speed_ratio), abs(shaft.speed_ratio)
        for weight in shaft.weights:
            amount = k**2 * weight.unbalance_g_mm * (1 + errors.weight_share[:, counted])
            angle = math.radians(weight.angle_deg) + ahead * errors.gear_rad[:, number]
            force = amount * np.exp(1j * angle)
            direct, reverse = (force, 0.0) if ahead > 0 else (0.0, force)
            _add(parts, direct, reverse, weight.position_m, k - 1)
            counted += 1
    return parts[0], parts[1]


def _add(parts: Complex, direct: Complex | float, reverse: Complex | float, position_m: float, at: int | slice) -> None:
    for row, lever in ((0, 1.0), (1, 1e3 * position_m)):
        parts[row, 0, :, at] += lever * direct
        parts[row, 1, :, at] += lever * reverse


def _most(parts: Parts) -> Floats:
    """Largest of a turn, (sample, order)."""
    return np.asarray(np.abs(parts[0]) + np.abs(parts[1]))


def _quantiles(parts: Parts) -> Spread:
    return {
        str(k): {name: float(np.quantile(sizes, share)) for name, share in QUANTILES.items()}
        for k, sizes in enumerate(_most(parts).T, start=1)
    }


def tolerance_sentences(study: SeriesResiduals, speed_rpm: float) -> list[str]:
    """What a series leaves, and what one mistiming adds.

    ``study``: of the tolerances. ``speed_rpm``: at which couples are named, > 0.
    """
    spread, rocking = study.force_g_mm, study.couple_g_mm2
    largest, worst = (max(left, key=lambda order: left[order]["95 %"]) for left in (spread, rocking))
    widest = max(spread, key=lambda order: spread[order]["97.5 %"] - spread[order]["2.5 %"])
    of_largest = "their largest and the one that errors spread most" if largest == widest else "their largest"
    drawn = f"Of {study.samples} engines drawn within the tolerances"
    if spread[largest]["95 %"] <= NO_FORCE_G_MM:
        sentences = [f"{drawn} 95 % leave no force."]
    else:
        sentences = [f"{drawn} 95 % leave less than {_span(spread[largest])} of order {largest}, {of_largest}."]
    if largest != widest and spread[widest]["95 %"] > NO_FORCE_G_MM:
        sentences.append(f"Errors spread order {widest} most: 95 % leave less than {_span(spread[widest])} of it.")
    newton_metres = 1e-9 * (speed_rpm / ONE_RADIAN_PER_S_RPM) ** 2
    if rocking[worst]["95 %"] > NO_COUPLE_G_MM2:
        couples = f"{plain_number(newton_metres * rocking[worst]['95 %'])} N·m of order {worst} at {speed_rpm:g} rpm"
        sentences.append(f"95 % rock with a couple of less than {couples}, their largest.")
    late = study.mistiming
    if late is None:
        return sentences
    size, order = max((late.force_g_mm[order], order) for order in late.orders)
    couple, rocked = max((late.couple_g_mm2[order], order) for order in late.orders)
    left = [f"{plain_number(size)} g·mm of order {order}"] if size > NO_FORCE_G_MM else []
    if couple > NO_COUPLE_G_MM2:
        left.append(f"a couple of {plain_number(newton_metres * couple)} N·m of order {rocked} at {speed_rpm:g} rpm")
    return [*sentences, f"All shafts late by {late.deg:g}° leave {' and '.join(left) or 'nothing of their orders'}."]


def _span(quantiles: Mapping[str, float]) -> str:
    least, most = plain_number(quantiles["2.5 %"]), plain_number(quantiles["97.5 %"])
    return f"{plain_number(quantiles['95 %'])} g·mm (the middle 95 % between {least} and {most} g·mm)"
