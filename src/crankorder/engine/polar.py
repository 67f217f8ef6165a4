"""Forces in the plane that the crank turns in, order by order: how large, which way round, and what they draw."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Rotation = Literal["with crank", "against crank", "line", "none"]

ROUND_OFF = 1e-12
"""Two rotating parts that differ by less than this share of their size are taken as equal."""

CANCELLED = 1e-14
"""A sum below this share of its terms is round-off of what cancels, and set to zero."""


@dataclass(frozen=True, kw_only=True)
class OrderForce:
    """Force of one order over ω², split into a part that turns with the crank and one that turns against it (g·mm).

    At crank angle φ it is ``direct`` exp(i order φ) + ``reverse`` exp(−i order φ); the real axis points along the
    cylinder away from the crankshaft, the imaginary axis across it, towards the side that the crank turns to.
    """

    order: float
    direct_g_mm: complex = 0j
    reverse_g_mm: complex = 0j

    @classmethod
    def of_axes(cls, *, order: float, x_g_mm: complex, y_g_mm: complex = 0j) -> OrderForce:
        """The force whose part along the cylinder is Re(x_g_mm exp(i order φ)), and across it likewise with y_g_mm.

        ``order``: cycles per crank revolution, > 0. ``x_g_mm``, ``y_g_mm``: complex amplitudes over ω².
        """
        return cls(
            order=order,
            direct_g_mm=(x_g_mm + 1j * y_g_mm) / 2,
            reverse_g_mm=(x_g_mm - 1j * y_g_mm).conjugate() / 2,
        )

    @property
    def x_g_mm(self) -> complex:
        """Complex amplitude along the cylinder."""
        return self.direct_g_mm + self.reverse_g_mm.conjugate()

    @property
    def y_g_mm(self) -> complex:
        """Complex amplitude across the cylinder."""
        return -1j * (self.direct_g_mm - self.reverse_g_mm.conjugate())

    @property
    def semi_axes_g_mm(self) -> tuple[float, float]:
        """Largest and smallest size of the force during a turn: the half axes of the ellipse that it draws."""
        direct, reverse = abs(self.direct_g_mm), abs(self.reverse_g_mm)
        return direct + reverse, abs(direct - reverse)

    @property
    def rotation(self) -> Rotation:
        """Which way round the force goes; "line" where it only swings to and fro."""
        direct, reverse = abs(self.direct_g_mm), abs(self.reverse_g_mm)
        if direct == reverse == 0:
            return "none"
        if abs(direct - reverse) <= ROUND_OFF * max(direct, reverse):
            return "line"
        return "with crank" if direct > reverse else "against crank"


def sum_by_order(forces: Iterable[OrderForce]) -> tuple[OrderForce, ...]:
    """Sum of forces, one per order, in rising order; what cancels to round-off is zero.

    ``forces``: any number, orders may repeat.
    """
    terms: dict[float, list[OrderForce]] = {}
    for force in forces:
        terms.setdefault(force.order, []).append(force)
    return tuple(
        OrderForce(
            order=order,
            direct_g_mm=_sum([force.direct_g_mm for force in terms[order]]),
            reverse_g_mm=_sum([force.reverse_g_mm for force in terms[order]]),
        )
        for order in sorted(terms)
    )


def _sum(parts: list[complex]) -> complex:
    total = sum(parts, 0j)
    return total if abs(total) > CANCELLED * max(abs(part) for part in parts) else 0j


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


def unbalance_force_n(unbalance_g_mm: ArrayLike, speed_rpm: ArrayLike) -> NDArray[np.float64]:
    """Force (N) of an unbalance at a speed: 1e-6 · unbalance · ω², with no division by g.

    ``unbalance_g_mm``: mass times radius, or an amplitude over ω². ``speed_rpm``: speed of the shaft that carries it
    (for an amplitude over ω²: of the crank). The shapes must broadcast; the result has the common shape.
    Source: Ruckle 2014, equation (1), whose g belongs to weights only (truth sheet 2.1).
    """
    omega = np.asarray(speed_rpm, dtype=np.float64) * (np.pi / 30)
    force: NDArray[np.float64] = 1e-6 * np.asarray(unbalance_g_mm, dtype=np.float64) * omega**2
    return force


def phasor(angle_deg: float) -> complex:
    """Number of size one at ``angle_deg`` (degrees), exact at every quarter turn."""
    quarter = round(angle_deg / 90)
    rest = math.radians(angle_deg - 90 * quarter)
    return (1 + 0j, 1j, -1 + 0j, -1j)[quarter % 4] * cmath.rect(1, rest)
