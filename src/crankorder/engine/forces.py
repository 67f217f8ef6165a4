"""Forces that an engine's moving masses put on its crankcase, order by order."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.definition import Engine
from crankorder.engine.harmonics import acceleration_harmonics

DIRECTIONS: tuple[Literal["X", "Y", "Z"], ...] = ("X", "Y", "Z")
"""X across, Y along the crankshaft, Z along the cylinder away from the crankshaft; the crank turns from Z to X."""


def reciprocating_mass_by_order(engine: Engine, max_order: int) -> NDArray[np.complex128]:
    """Complex mass (kg) that still shakes the crankcase at each order times its harmonic, shape (max_order + 1,).

    Times crank radius times ω² it is the force along the cylinder. Orders that ``engine`` cancels by shafts keep only
    the mass that the shafts leave (and, where they are timed to the crank, the quadrature part that an offset makes).
    ``max_order``: ≥ 1.
    """
    harmonics = acceleration_harmonics(engine.mechanism, max_order)
    shaken = engine.reciprocating_mass_kg * harmonics
    for order in engine.shafts.orders:
        if order <= max_order:
            cancelled = harmonics[order] if engine.shafts.timed_to == "force" else harmonics[order].real
            shaken[order] -= (engine.reciprocating_mass_kg - engine.shafts.unbalanced_mass_kg) * cancelled
    return shaken


def crankcase_forces(engine: Engine, speed_rpm: ArrayLike, *, max_order: int) -> NDArray[np.complex128]:
    """Complex peak force (N) on the crankcase at orders 0 … ``max_order``, shape (…, 3, max_order + 1).

    The second axis from the right is the direction, in the sequence of ``DIRECTIONS``. A line is
    Re(force · exp(2πi order rev)), rev counted from top dead centre.

    ``engine``: lengths, masses and shafts. ``speed_rpm``: scalar or any shape (…), ≥ 0. ``max_order``: ≥ 1; see
    :func:`crankorder.engine.harmonics.orders_for` for how many are worth having.
    Source: truth sheet sections 0, 2.5 and 2.6; a mass that slides along the cylinder has no net force across it.
    """
    omega_squared = (np.asarray(speed_rpm, dtype=np.float64) * (np.pi / 30)) ** 2
    per_omega_squared = np.zeros((3, max_order + 1), dtype=np.complex128)
    per_omega_squared[2] = engine.crank_radius_m * reciprocating_mass_by_order(engine, max_order)
    rotating = engine.rotating_unbalance_kg_m * np.exp(1j * np.radians(engine.rotating_unbalance_deg))
    per_omega_squared[2, 1] += rotating
    per_omega_squared[0, 1] += -1j * rotating
    forces: NDArray[np.complex128] = omega_squared[..., None, None] * per_omega_squared
    return forces


def orders_made(engine: Engine, *, share: float, max_order: int) -> tuple[float, ...]:
    """Orders up to ``max_order`` at which ``engine`` shakes its crankcase with at least ``share`` of the largest force.

    The share does not depend on speed, for every inertia force grows with its square.
    """
    forces = np.abs(crankcase_forces(engine, 1000.0, max_order=max_order)).max(axis=0)
    return tuple(float(order) for order in np.flatnonzero(forces >= share * forces.max()) if order > 0)
