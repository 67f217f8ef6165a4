"""Direct and reverse cranks: geared wheels that cancel orders 1 and 2, and what faults in the gears leave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from crankorder.engine.balancing import ReducedMasses
from crankorder.engine.definition import NOT_EMPTY, EngineData, NonNegative, Positive
from crankorder.engine.harmonics import even_harmonics
from crankorder.engine.polar import polar_diagram
from crankorder.engine.shafts import Shaft
from crankorder.engine.slider_crank import piston_acceleration
from crankorder.errors import RequestError

Series = Literal["exact", "leading"]


class Gear(EngineData):
    """A gear of the train: its teeth, the gear that drives it or shares its shaft, and the place of its axis (mm).

    ``x_mm`` lies along the cylinder, ``y_mm`` across it, both from the crankshaft. ``weight_radius_mm`` is the radius
    of the weight that it carries; a gear without it only transmits.
    """

    name: Annotated[str, Field(min_length=1)]
    teeth: Annotated[int, Field(ge=1)]
    driven_by: str | None = None
    fixed_to: str | None = None
    x_mm: float = 0.0
    y_mm: float = 0.0
    weight_radius_mm: Positive | None = None


class GearTolerances(EngineData):
    """Standard deviations of what may be wrong with the gears, and how many engines to try with which seed.

    ``mesh_deg``: angle of a driven gear in each mesh. ``position_mm``: each coordinate of the axis of a wheel with
    weight. ``weight_fraction``: its unbalance over the right one.
    """

    mesh_deg: NonNegative
    position_mm: NonNegative
    weight_fraction: NonNegative
    samples: Annotated[int, Field(ge=1)]
    seed: Annotated[int, Field(ge=0)]


class GearTrain(EngineData):
    """Gears in the sequence in which motion reaches them; the first sits on the crankshaft."""

    gears: Annotated[tuple[Gear, ...], NOT_EMPTY] = Field(strict=False)
    tolerances: GearTolerances | None = None

    @model_validator(mode="after")
    def _motion_reaches_every_gear(self) -> Self:
        known: set[str] = set()
        for gear in self.gears:
            sources = [name for name in (gear.driven_by, gear.fixed_to) if name is not None]
            if known and (len(sources) != 1 or sources[0] not in known):
                raise ValueError(f"gear {gear.name} needs one of driven_by and fixed_to, naming a gear before it")
            if not known and sources:
                raise ValueError(f"gear {gear.name} comes first: it sits on the crankshaft and nothing drives it")
            if gear.name in known:
                raise ValueError(f"gear {gear.name} is named twice")
            known.add(gear.name)
        return self


@dataclass(frozen=True, kw_only=True)
class ToleranceStudy:
    """Residuals of sampled engines with faulty gears, over ω²; each array has shape (samples, orders).

    ``along_g_mm`` and ``across_g_mm``: amplitudes along and across the cylinder. ``couple_g_mm2``: about the
    crankshaft.
    """

    orders: tuple[float, ...]
    along_g_mm: NDArray[np.float64]
    across_g_mm: NDArray[np.float64]
    couple_g_mm2: NDArray[np.float64]


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


def weight_moments(masses: ReducedMasses, *, second: Series = "exact") -> dict[float, float]:
    """Weight times radius (g·mm) that both wheels of a pair carry together, by order: the conditions of balance.

    W r1 = R r for the first order, W2 r2 = R r A2/4 for the second; each wheel has half.

    ``masses``: engine; its rotating part is taken as balanced on the crank. ``second``: "exact" with A2, "leading" with
    r/l in its place. Source: document 002, equations (iv) and (vii); (v) must read (W/2) r1 (truth sheet 3).
    """
    primary = masses.reciprocating_g * masses.crank_radius_mm
    ratio = masses.mechanism.crank_ratio
    harmonic = float(even_harmonics(1, ratio)[0]) if second == "exact" else ratio
    return {1.0: primary, 2.0: primary * harmonic / 4}


def weighted_wheels(train: GearTrain, masses: ReducedMasses, *, second: Series = "exact") -> dict[str, Shaft]:
    """Wheels with weights, as shafts that turn, by name of the gear.

    ``train``: gears; those with a weight radius at crank speed and at twice crank speed share the moment of their
    order. ``masses``: engine. ``second``: as in :func:`weight_moments`. Raises RequestError where the wheels with
    weights are not one direct and one reverse at each of these speeds: the forces across would not cancel.
    """
    ratios = gear_speed_ratios(train)
    carriers = [gear for gear in train.gears if gear.weight_radius_mm is not None]
    moments = weight_moments(masses, second=second)
    turning = sorted(ratios[gear.name] for gear in carriers)
    if turning not in ([-1.0, 1.0], [-2.0, 2.0], [-2.0, -1.0, 1.0, 2.0]):
        raise RequestError(
            "the wheels with weights do not go in pairs",
            place="gears",
            found=", ".join(f"{ratio:g}" for ratio in turning) or "none",
            allowed="speeds of +1 and −1, +2 and −2 over crank speed, or both",
        )
    wheels = {}
    for gear in carriers:
        order = abs(ratios[gear.name])
        wheels[gear.name] = Shaft(
            speed_ratio=ratios[gear.name],
            unbalance_g_mm=moments[order] / 2,
            x_mm=gear.x_mm,
            y_mm=gear.y_mm,
        )
    return wheels


def wheels_force(wheels: Mapping[str, Shaft], crank_angle_rev: ArrayLike) -> NDArray[np.complex128]:
    """Force over ω² (g·mm) of all ``wheels``: real part along the cylinder, imaginary part across.

    ``crank_angle_rev``: revolutions, any shape; the result has that shape.
    """
    return polar_diagram([wheel.force for wheel in wheels.values()], crank_angle_rev)


def wheels_couple(wheels: Mapping[str, Shaft]) -> dict[float, complex]:
    """Complex amplitude over ω² (g·mm²), by order, of the couple of ``wheels`` about the crankshaft.

    It vanishes where the wheels of each pair straddle the cylinder axis symmetrically.
    """
    couples: dict[float, complex] = {}
    for wheel in wheels.values():
        couples[wheel.force.order] = couples.get(wheel.force.order, 0j) + wheel.couple_g_mm2
    return couples


def residual_along(
    masses: ReducedMasses, wheels: Mapping[str, Shaft], crank_angle_rev: ArrayLike
) -> NDArray[np.float64]:
    """Exact force over ω² (g·mm) along the cylinder that remains with ``wheels``.

    ``masses``: engine, its rotating part balanced on the crank. ``crank_angle_rev``: revolutions, any shape; the result
    has that shape. With wheels for the first and second order it begins with the fourth, and is largest at 90°.
    """
    sliding = masses.reciprocating_g * 1e3 * piston_acceleration(crank_angle_rev, masses.mechanism)
    residual: NDArray[np.float64] = sliding + wheels_force(wheels, crank_angle_rev).real
    return residual


def gear_errors_deg(
    train: GearTrain, mesh_errors_deg: Mapping[str, float | NDArray[np.float64]]
) -> dict[str, ArrayLike]:
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


def mistimed(
    train: GearTrain, wheels: Mapping[str, Shaft], mesh_errors_deg: Mapping[str, float | NDArray[np.float64]]
) -> dict[str, Shaft]:
    """The wheels as they stand with errors in the meshes.

    ``train``: gears. ``wheels``: in their right places. ``mesh_errors_deg``: scalars by name of the driven gear.
    """
    errors = gear_errors_deg(train, mesh_errors_deg)
    return {
        name: replace(wheel, phase_deg=wheel.phase_deg + float(np.asarray(errors[name])))
        for name, wheel in wheels.items()
    }


def tolerance_study(train: GearTrain, masses: ReducedMasses, tolerances: GearTolerances) -> ToleranceStudy:
    """What misaligned, mis-timed and mis-weighted wheels leave of orders 1 and 2, engine by sampled engine.

    ``train``: gears. ``masses``: engine. ``tolerances``: standard deviations of normal errors, independent of one
    another; number of samples and seed. The same seed gives the same numbers.
    """
    chance = np.random.default_rng(tolerances.seed)
    size = tolerances.samples
    meshes = {
        gear.name: tolerances.mesh_deg * chance.standard_normal(size)
        for gear in train.gears
        if gear.driven_by is not None
    }
    errors = gear_errors_deg(train, meshes)
    wheels = weighted_wheels(train, masses)
    orders = tuple(sorted({abs(wheel.speed_ratio) for wheel in wheels.values()}))
    direct, reverse, couple = (np.zeros((size, len(orders)), dtype=np.complex128) for _ in range(3))
    for name, wheel in wheels.items():
        column = orders.index(abs(wheel.speed_ratio))
        turned = np.exp(1j * np.radians(np.asarray(errors[name])))
        faulty = turned * (1 + tolerances.weight_fraction * chance.standard_normal(size))
        shift = tolerances.position_mm * (chance.standard_normal(size) + 1j * chance.standard_normal(size))
        arm = complex(wheel.x_mm, wheel.y_mm) + shift
        right = wheel.force
        direct[:, column] += right.direct_g_mm * (faulty - 1)
        reverse[:, column] += right.reverse_g_mm * (faulty - 1)
        couple[:, column] += -1j * arm.conj() * right.direct_g_mm * faulty
        couple[:, column] += 1j * arm * (right.reverse_g_mm * faulty).conj()
    return ToleranceStudy(
        orders=orders,
        along_g_mm=np.abs(direct + reverse.conj()),
        across_g_mm=np.abs(direct - reverse.conj()),
        couple_g_mm2=np.abs(couple),
    )
