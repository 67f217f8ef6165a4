"""Balance of the crankshaft to itself, direct and reverse cranks, and what errors leave of gears and of a series.

Source of the first: Ruckle 2014, section 3.1.1, table 2 and figure 12.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.balance_data import (
    BalanceTolerances,
    CrankshaftData,
    CrankshaftSection,
    GearTolerances,
    GearTrain,
)
from crankorder.engine.balancing import ONE_RADIAN_PER_S_RPM
from crankorder.engine.definition import BalanceShafts, Engine, SingleShaft, Weight
from crankorder.engine.forces import Z, crankcase_forces, newton
from crankorder.engine.slider_crank import Complex, acceleration_harmonics, even_harmonics
from crankorder.errors import RequestError

Floats = NDArray[np.float64]
Series = Literal["exact", "leading"]


def crankshaft_sums(sections: Sequence[CrankshaftSection]) -> tuple[complex, complex]:
    """Static (kg·mm) and dynamic (kg·mm²) sum of a crankshaft, each as x + iy; the second about the datum.

    ``sections``: its parts, the bob weight on the pin among them. Both sums must vanish for a shaft in balance; the
    dynamic one depends on the datum unless the static one vanishes. Source: Ruckle 2014, equations (5) to (8), table 2.
    """
    arms = [section.mass_kg * complex(section.x_mm, section.y_mm) for section in sections]
    return sum(arms, 0j), sum((arm * section.z_mm for arm, section in zip(arms, sections, strict=True)), 0j)


def two_plane_correction(sums: tuple[complex, complex], planes_mm: tuple[float, float]) -> tuple[complex, complex]:
    """Unbalance (kg·mm, x + iy) to add in each of two planes so that both sums vanish.

    ``sums``: static and dynamic. ``planes_mm``: places of the planes along the axis, from the datum of the sums; not
    the same.
    """
    (static, dynamic), (first, second) = sums, planes_mm
    in_second = (first * static - dynamic) / (second - first)
    return -static - in_second, in_second


def _axes(amount: complex) -> dict[str, float]:
    return {"x": amount.real, "y": amount.imag}


def _sums(sections: Sequence[CrankshaftSection]) -> dict[str, dict[str, float]]:
    static, dynamic = crankshaft_sums(sections)
    return {"static_kg_mm": _axes(static), "dynamic_kg_mm2": _axes(dynamic)}


def crankshaft_balance(
    data: CrankshaftData, speeds: Mapping[str, float], *, big_ends_g: Mapping[str, float]
) -> dict[str, Any]:
    """Balance of the crankshaft ``data`` by itself, as the balance sheet has it.

    ``speeds``: crank speeds (rpm) by the text that names each. ``big_ends_g``: masses of the rod's big end (g) by the
    method that gave each; every one is put in the place of the bob weight, if there is one.
    Source: Ruckle 2014, table 2.
    """
    static, dynamic = sums = crankshaft_sums(data.parts)
    towards, wanted = -static.imag, data.overbalance_kg_mm
    (first, first_mm), *_, (last, last_mm) = data.places.items()
    at_first, at_last = two_plane_correction(sums, (first_mm, last_mm))
    return {
        "sections": [part.model_dump() | _sums([part]) for part in data.parts],
        **_sums(data.parts),
        "couple_Nm_at_rpm": {key: newton(abs(dynamic), speed_rpm) for key, speed_rpm in speeds.items()},
        "planes": [_plane(data, first, at_first), _plane(data, last, at_last)],
        "overbalance_kg_mm": None if wanted is None else list(wanted),
        "overbalanced_by_kg_mm": towards,
        "overbalance_met": None if wanted is None else wanted[0] <= towards <= wanted[1],
        "bob_weights": _bob_weights(data, big_ends_g),
    }


def _plane(data: CrankshaftData, name: str, added: complex) -> dict[str, Any]:
    """The first or the last counterweight: its unbalance, slugs included, and the one that balances the crankshaft."""
    has, _ = crankshaft_sums([part for part in data.parts if part.name in (name, f"Slug in {name}")])
    fan, sizes = data.fans.get(name), None
    if fan is not None:
        slugs = has - crankshaft_sums([fan.section])[0]
        names = ("mass_kg", "centroid_mm", "unbalance_kg_mm", "sensitivity")
        sizes = {key: getattr(fan, key) for key in names} | {"resized": fan.resized(abs(has + added - slugs))}
    amounts = {"has_kg_mm": has, "correction_kg_mm": added, "needs_kg_mm": has + added}
    by_axis = {key: _axes(amount) for key, amount in amounts.items()}
    return {"name": name, "z_mm": data.places[name], **by_axis, "fan": sizes}


def _bob_weights(data: CrankshaftData, big_ends_g: Mapping[str, float]) -> list[dict[str, Any]] | None:
    """Sums of the crankshaft by mass of the rod's big end in the place of its bob weight, the stated one first."""
    if data.bob_weight is None:
        return None
    bob = next(part for part in data.parts if part.name == data.bob_weight)
    others = [part for part in data.parts if part is not bob]
    masses_kg = {"stated": bob.mass_kg, **{method: 1e-3 * grams for method, grams in big_ends_g.items()}}
    return [
        {"method": method, "mass_kg": mass_kg, **_sums([*others, bob.model_copy(update={"mass_kg": mass_kg})])}
        for method, mass_kg in masses_kg.items()
    ]


def gear_speed_ratios(train: GearTrain) -> dict[str, float]:
    """Speed of each gear of ``train`` over crank speed, negative where it turns against the crank.

    Source: document 002 (figure 8 by its text): B, D and G are reverse, E and H direct, G and H at twice crank speed.
    """
    ratios: dict[str, Fraction] = {}
    teeth = {gear.name: gear.teeth for gear in train.gears}
    for gear in train.gears:
        if gear.driven_by is not None:
            ratios[gear.name] = -ratios[gear.driven_by] * Fraction(teeth[gear.driven_by], gear.teeth)
        else:
            ratios[gear.name] = Fraction(1) if gear.fixed_to is None else ratios[gear.fixed_to]
    return {name: float(ratio) for name, ratio in ratios.items()}


def weight_moments(engine: Engine, *, second: Series = "exact") -> dict[int, float]:
    """Weight times radius (g·mm) that both wheels of a pair carry together, by order: the conditions of balance.

    W r1 = R r for the first order, W2 r2 = R r A2/4 for the second; each wheel has half.

    ``engine``: of one cylinder; its rotating part is taken as balanced on the crank. ``second``: "exact" with A2,
    "leading" with r/l in its place. Source: document 002, equations (iv) and (vii); (v) must read (W/2) r1 (truth
    sheet 3).
    """
    ratio = engine.mechanism.crank_ratio
    harmonic = float(even_harmonics(1, ratio)[0]) if second == "exact" else ratio
    return {1: engine.sliding_g_mm, 2: engine.sliding_g_mm * harmonic / 4}


def weighted_wheels(train: GearTrain, engine: Engine, *, second: Series = "exact") -> dict[str, SingleShaft]:
    """Wheels with weights, as balance shafts, by name of the gear.

    ``train``: gears; those with a weight radius at crank speed and at twice crank speed share the moment of their
    order. ``engine``, ``second``: as in :func:`weight_moments`. Raises RequestError where the wheels with weights are
    not one direct and one reverse at each of these speeds: the forces across would not cancel.
    """
    ratios = gear_speed_ratios(train)
    carriers = [gear for gear in train.gears if gear.weight_radius_mm is not None]
    turning = sorted(ratios[gear.name] for gear in carriers)
    if turning not in ([-1.0, 1.0], [-2.0, 2.0], [-2.0, -1.0, 1.0, 2.0]):
        found = ", ".join(f"{ratio:g}" for ratio in turning) or "none"
        allowed = "speeds of +1 and −1, +2 and −2 over crank speed, or both"
        raise RequestError("the wheels with weights do not go in pairs", place="gears", found=found, allowed=allowed)
    moments = weight_moments(engine, second=second)
    wheels = {}
    for gear in carriers:
        ratio = round(ratios[gear.name])
        weights = (Weight(unbalance_g_mm=moments[abs(ratio)] / 2, angle_deg=180.0),)
        wheels[gear.name] = SingleShaft(speed_ratio=ratio, weights=weights, z_m=1e-3 * gear.x_mm, x_m=1e-3 * gear.y_mm)
    return wheels


def gear_errors_deg(train: GearTrain, mesh_errors_deg: Mapping[str, float | Floats]) -> dict[str, ArrayLike]:
    """Angle (degrees, in the sense of the crank) by which each gear stands wrong, as errors travel through the train.

    ``train``: gears. ``mesh_errors_deg``: by name of the driven gear, scalars or arrays of one shape; a missing one is
    zero. One tooth off in a mesh is 360° over the teeth of the driven gear.
    """
    teeth = {gear.name: gear.teeth for gear in train.gears}
    errors: dict[str, ArrayLike] = {}
    for gear in train.gears:
        if gear.driven_by is not None:
            passed_on = -np.asarray(errors[gear.driven_by]) * teeth[gear.driven_by] / gear.teeth
            errors[gear.name] = passed_on + mesh_errors_deg.get(gear.name, 0.0)
        else:
            errors[gear.name] = 0.0 if gear.fixed_to is None else errors[gear.fixed_to]
    return errors


def tolerance_study(train: GearTrain, engine: Engine, tolerances: GearTolerances) -> dict[str, dict[str, Floats]]:
    """What misaligned, mis-timed and mis-weighted wheels leave of orders 1 and 2, a value for each sampled train.

    Amplitudes over ω² by what remains and order, each of shape (samples,): ``along_g_mm`` and ``across_g_mm``, force
    along and across the cylinder; ``couple_g_mm2`` about the crankshaft.

    ``train``: gears. ``engine``: of one cylinder. ``tolerances``: standard deviations of normal errors, independent of
    one another; number of samples and seed. The same seed gives the same numbers.
    """
    chance, size = np.random.default_rng(tolerances.seed), tolerances.samples
    driven = [gear.name for gear in train.gears if gear.driven_by is not None]
    errors = gear_errors_deg(train, {name: tolerances.mesh_deg * chance.standard_normal(size) for name in driven})
    wheels = weighted_wheels(train, engine)
    orders = [f"{order}" for order in sorted({abs(wheel.speed_ratio) for wheel in wheels.values()})]
    along, across, couple = ({order: np.zeros(size, dtype=np.complex128) for order in orders} for _ in range(3))
    for name, wheel in wheels.items():
        order, sense = f"{abs(wheel.speed_ratio)}", math.copysign(1, wheel.speed_ratio)
        turned = np.exp(1j * np.radians(np.asarray(errors[name])))
        faulty = turned * (1 + tolerances.weight_fraction * chance.standard_normal(size))
        shift = tolerances.position_mm * (chance.standard_normal(size) + 1j * chance.standard_normal(size))
        arm = 1e3 * complex(wheel.z_m, wheel.x_m) + shift
        force = -(wheel.speed_ratio**2) * wheel.weights[0].unbalance_g_mm
        # complex amplitudes of cos(order φ): what turns against the crank enters by its conjugate
        acting, lever = (faulty, arm.conj()) if sense > 0 else (faulty.conj(), arm)
        along[order] += force * (acting - 1)
        across[order] += sense * force * (acting - 1)
        couple[order] -= 1j * sense * lever * force * acting
    left = {"along_g_mm": along, "across_g_mm": across, "couple_g_mm2": couple}
    return {what: {order: np.abs(size) for order, size in sizes.items()} for what, sizes in left.items()}


QUANTILES = {"2.5 %": 0.025, "median": 0.5, "95 %": 0.95, "97.5 %": 0.975}


def with_single_shafts(engine: Engine, max_order: int) -> Engine:
    """The ``engine`` with each of its pairs as two single shafts that make the same force, orders to ``max_order``."""
    shafts = engine.shafts
    paired = engine.model_copy(update={"shafts": shafts.model_copy(update={"single": ()})})
    with_pairs, without = (
        crankcase_forces(each, ONE_RADIAN_PER_S_RPM, max_order=max_order)[Z] for each in (paired, engine.bare)
    )
    force_g_mm = 1e6 * (with_pairs - without)

    def shaft(ratio: int) -> SingleShaft:
        force, sense = complex(force_g_mm[abs(ratio)]), math.copysign(1, ratio)
        weight = Weight(
            unbalance_g_mm=abs(force) / (2 * ratio**2),
            angle_deg=sense * math.degrees(float(np.angle(force))),
            position_m=shafts.position_m,
        )
        return SingleShaft(speed_ratio=ratio, weights=(weight,))

    orders = sorted({*shafts.orders, *(pair.order for pair in shafts.pairs)})
    single = (shaft(sense * k) for k in orders for sense in (1, -1))
    return engine.model_copy(update={"shafts": BalanceShafts(single=(*single, *shafts.single))})


def series_residuals(engine: Engine, tolerances: BalanceTolerances, *, max_order: int) -> dict[str, Any]:
    """Force and couple that a series of engines leaves by order, and one stated mistiming, as the balance sheet has it.

    ``engine``: balanced, by its webs and shafts. ``tolerances``: of the series. ``max_order``: highest order, ≥ 1 and
    not below any shaft's.
    The residual of an order is the most of a turn: the large half axis of its ellipse.
    """

    def by_order(values: Iterable[Any]) -> dict[str, Any]:
        return {str(k): value for k, value in enumerate(values, start=1)}

    studied = with_single_shafts(engine, max_order)
    late_deg, keys, late = tolerances.mistiming_deg, ("force_g_mm", "couple_g_mm2"), None
    if late_deg is not None and studied.shafts.single:
        sizes = _series_left(studied, BalanceTolerances(samples=100), max_order, late_deg)[:, 0].tolist()
        orders = [str(k) for k in sorted({abs(shaft.speed_ratio) for shaft in studied.shafts.single})]
        left = {key: by_order(of_key) for key, of_key in zip(keys, sizes, strict=True)}
        late = {"deg": late_deg, "orders": orders, **left}
    shares = np.quantile(_series_left(studied, tolerances, max_order), list(QUANTILES.values()), axis=1)
    by_key = zip(keys, shares.transpose(1, 2, 0).tolist(), strict=True)
    spreads = {key: by_order(dict(zip(QUANTILES, one, strict=True)) for one in of_key) for key, of_key in by_key}
    return {"samples": tolerances.samples, "seed": tolerances.seed, **spreads, "mistiming": late}


def _series_left(engine: Engine, tolerances: BalanceTolerances, max_order: int, late_deg: float = 0.0) -> Floats:
    """Force (g·mm) and couple (g·mm²) over ω², the most of a turn, by sample and order: (2, sample, order)."""
    draw, n, count = np.random.default_rng(tolerances.seed), tolerances.samples, len(engine.cylinders)
    weights = sum(len(shaft.weights) for shaft in engine.shafts.single)
    mass_g = tolerances.reciprocating_g * draw.uniform(-1, 1, (n, count))
    size = tolerances.rotating_g_mm * np.sqrt(draw.uniform(0, 1, (n, count)))
    throw_g_mm = size * np.exp(2j * np.pi * draw.uniform(0, 1, (n, count)))
    pin_rad = np.radians(tolerances.pin_deg) * draw.uniform(-1, 1, (n, count))
    weight_share = iter(1 + tolerances.shaft_percent / 100 * draw.uniform(-1, 1, (n, weights)).T)
    gear_rad = np.radians(tolerances.gear_deg * draw.uniform(-1, 1, (n, len(engine.shafts.single))) - late_deg)
    parts = np.zeros((2, 2, n, max_order), dtype=np.complex128)  # force and couple, direct and reverse

    def add(direct: Complex, reverse: Complex, position_m: float, at: int | slice) -> None:
        for row, lever in ((0, 1.0), (1, 1e3 * position_m)):
            parts[row, 0, :, at] += lever * direct
            parts[row, 1, :, at] += lever * reverse

    nothing = np.zeros(1, dtype=np.complex128)
    for number, (single, cylinder) in enumerate(zip(engine.each, engine.cylinders, strict=True)):
        bank = math.radians(cylinder.bank_deg)
        turned = np.radians(cylinder.crank_deg) + pin_rad[:, number]
        harmonics = acceleration_harmonics(single.mechanism, max_order)[1:]
        # powers by products: much faster than as many exponentials
        turns = np.broadcast_to(np.exp(1j * (turned - bank))[:, None], (n, max_order))
        mass = 1e3 * single.reciprocating_mass_kg + mass_g[:, [number]]
        line = 0.5e3 * single.crank_radius_m * mass * harmonics * np.cumprod(turns, axis=1)
        tilt = np.exp(1j * bank)
        add(line * tilt, line.conj() * tilt, cylinder.position_m, slice(None))
        rest = 1e6 * single.rotating_unbalance_kg_m * np.exp(1j * np.radians(single.rotating_unbalance_deg))
        add((rest + throw_g_mm[:, number]) * np.exp(1j * turned), nothing, cylinder.position_m, 0)
    for web in engine.webs:
        add(np.asarray(web.unbalance_g_mm * np.exp(1j * np.radians(web.angle_deg))), nothing, web.position_m, 0)
    for shaft, wrong_rad in zip(engine.shafts.single, gear_rad.T, strict=True):
        ahead, k = math.copysign(1, shaft.speed_ratio), abs(shaft.speed_ratio)
        for weight in shaft.weights:
            angle = math.radians(weight.angle_deg) + ahead * wrong_rad
            force = k**2 * weight.unbalance_g_mm * next(weight_share) * np.exp(1j * angle)
            direct, reverse = (force, nothing) if ahead > 0 else (nothing, force)
            add(direct, reverse, weight.position_m, k - 1)
    return np.asarray(np.abs(parts[:, 0]) + np.abs(parts[:, 1]))
