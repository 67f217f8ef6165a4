"""The connecting rod as two masses, and the couple of its true inertia that two masses miss."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.definition import Engine
from crankorder.engine.harmonics import rod_acceleration_harmonics
from crankorder.engine.slider_crank import rod_angle


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


def rod_couple(engine: Engine, crank_angle_rev: ArrayLike, speed_rpm: float) -> NDArray[np.float64]:
    """Couple (N·m) on a rod, in the crank's sense, that its true inertia needs beyond that of its two masses.

    ``engine``: with ``rod``. ``crank_angle_rev``: of its own crank, any shape. ``speed_rpm``: steady. Returns the shape
    of the angles. Source: truth sheet 2.7, (J − m a b) times the rod's angular acceleration −ψ'' ω².
    """
    omega = speed_rpm * np.pi / 30
    _, _, second = rod_angle(crank_angle_rev, engine.mechanism)
    couple: NDArray[np.float64] = -two_masses(engine).missing_inertia_kg_m2 * omega**2 * second
    return couple


def rod_couple_by_order(engine: Engine, speed_rpm: float, *, max_order: int) -> NDArray[np.complex128]:
    """The same by order 0 … ``max_order``, complex peak (N·m), shape (max_order + 1,).

    A line is Re(couple · exp(2πi order rev)). ``engine``: with ``rod``. ``speed_rpm``: steady.
    """
    omega = speed_rpm * np.pi / 30
    missing = two_masses(engine).missing_inertia_kg_m2
    return missing * omega**2 * rod_acceleration_harmonics(engine.mechanism, max_order)
