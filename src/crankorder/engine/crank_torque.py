"""Crank torque of a cylinder from a few nodes per branch: exact polynomials, kept in a form that loses no digits.

Each branch of the curve is the polynomial through its nodes. It is computed in exact fractions and evaluated about the
middle of its branch, t = (angle − middle) / half width in −1 … 1, as a rise above the straight line between its ends.
Written in powers of the angle itself the same polynomial loses eight of sixteen digits, and all of them in single
precision (truth sheet 4.1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.errors import RequestError

Angles = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class TorqueBranch:
    """Nodes of one branch: crank angles (degrees, rising, first and last node bound the branch) and torques (N·m)."""

    angle_deg: tuple[float, ...]
    torque_nm: tuple[float, ...]

    def __post_init__(self) -> None:
        nodes = (*self.angle_deg, *self.torque_nm)
        rising = all(first < second for first, second in pairwise(self.angle_deg))
        if len(self.angle_deg) != len(self.torque_nm) or len(self.angle_deg) < 2 or not rising:
            raise RequestError(
                "a branch of a torque curve needs as many torques as angles, two or more, with rising angles",
                found=f"{len(self.angle_deg)} angles {self.angle_deg}, {len(self.torque_nm)} torques",
            )
        if not all(math.isfinite(value) for value in nodes):
            raise RequestError("nodes of a torque curve must be finite numbers", found=nodes)

    @cached_property
    def coefficients(self) -> tuple[Fraction, ...]:
        """Exact coefficients (N·m) of t⁰, t¹, …, with t = (angle − middle) / half width."""
        angles = [Fraction(angle) for angle in self.angle_deg]
        middle, half = (angles[0] + angles[-1]) / 2, (angles[-1] - angles[0]) / 2
        nodes = [(angle - middle) / half for angle in angles]
        differences = [Fraction(torque) for torque in self.torque_nm]
        for step in range(1, len(nodes)):
            for index in range(len(nodes) - 1, step - 1, -1):
                rise = differences[index] - differences[index - 1]
                differences[index] = rise / (nodes[index] - nodes[index - step])
        powers = [differences[-1]]
        for node, difference in zip(nodes[-2::-1], differences[-2::-1], strict=True):
            shifted = [Fraction(0), *powers]
            powers = [high - node * low for high, low in zip(shifted, [*powers, Fraction(0)], strict=True)]
            powers[0] += difference
        return tuple(powers)

    @cached_property
    def rise(self) -> tuple[float, ...]:
        """Coefficients (N·m) of b(t), with torque = straight line between the end nodes + (1 − t)(1 + t) b(t)."""
        straight = [Fraction(self.torque_nm[-1]) + sign * Fraction(self.torque_nm[0]) for sign in (1, -1)]
        quotient = [value - line / 2 for value, line in zip(self.coefficients, straight, strict=False)]
        quotient += self.coefficients[2:]
        for power in range(2, len(quotient)):
            quotient[power] += quotient[power - 2]
        return tuple(float(value) for value in quotient[:-2])

    @property
    def middle_rev(self) -> float:
        """Middle of the branch (revolutions)."""
        return float((Fraction(self.angle_deg[0]) + Fraction(self.angle_deg[-1])) / 720)

    @property
    def half_width_rev(self) -> float:
        """Half the width of the branch (revolutions)."""
        return float((Fraction(self.angle_deg[-1]) - Fraction(self.angle_deg[0])) / 720)

    @property
    def integral_nm_deg(self) -> Fraction:
        """Exact integral of the torque over the branch (N·m·degree)."""
        even = sum(2 * value / (power + 1) for power, value in enumerate(self.coefficients) if power % 2 == 0)
        return Fraction(even) * (Fraction(self.angle_deg[-1]) - Fraction(self.angle_deg[0])) / 2

    @property
    def end_slopes_nm_per_deg(self) -> tuple[float, float]:
        """Slopes (N·m per degree) at the first and the last node."""
        half = (Fraction(self.angle_deg[-1]) - Fraction(self.angle_deg[0])) / 2
        terms = [power * value / half for power, value in enumerate(self.coefficients)]
        first = sum(term if power % 2 else -term for power, term in enumerate(terms))
        return float(first), float(sum(terms))


@dataclass(frozen=True, kw_only=True)
class CrankTorque:
    """Crank torque over one revolution from top dead centre: branches that follow one another from 0 to 360 degrees."""

    branches: tuple[TorqueBranch, ...]

    def __post_init__(self) -> None:
        if not self.branches:
            raise RequestError("a torque curve needs at least one branch")
        edges = [(branch.angle_deg[0], branch.angle_deg[-1]) for branch in self.branches]
        joined = all(before[1] == after[0] for before, after in pairwise(edges))
        if edges[0][0] != 0 or edges[-1][1] != 360 or not joined:
            raise RequestError(
                "the branches of a torque curve must follow one another without a gap",
                found=edges,
                allowed="from 0 to 360 degrees",
            )

    @cached_property
    def mean_nm(self) -> float:
        """Mean torque over a revolution (N·m), rounded once from the exact fraction."""
        return float(sum((branch.integral_nm_deg for branch in self.branches), Fraction(0)) / 360)

    @property
    def work_per_rev_j(self) -> float:
        """Work of the torque over one revolution (J)."""
        return 2 * math.pi * self.mean_nm


def crank_torque(crank_angle_rev: ArrayLike, curve: CrankTorque) -> NDArray[np.floating[Any]]:
    """Crank torque (N·m) at each angle.

    ``crank_angle_rev``: revolutions from top dead centre, any shape; whole revolutions are taken off. Single precision
    in gives single precision out. ``curve``: the branches. Returns the shape of the angles.
    For the curve of document 003 the error is below 1e-12 N·m in double and 1e-3 N·m in single precision (of 809 N·m at
    the peak); at the ends of a branch there is none.
    Source: Zotov, Sviridov, Tokarev, equation (1), by its nodes (truth sheet 4.1).
    """
    angles = np.asarray(crank_angle_rev)
    kind = np.dtype(np.float32 if angles.dtype == np.float32 else np.float64)
    turns = np.asarray(np.mod(angles.astype(kind), kind.type(1)))
    starts = [branch.angle_deg[0] / 360 for branch in curve.branches]
    index = np.searchsorted(np.asarray(starts, dtype=kind), turns, side="right") - 1
    torque = np.empty(turns.shape, dtype=kind)
    for number, branch in enumerate(curve.branches):
        inside = index == number
        centred = (turns[inside] - kind.type(branch.middle_rev)) / kind.type(branch.half_width_rev)
        torque[inside] = _branch_torque(centred, branch)
    return torque


def potential_torque(crank_angle_rev: ArrayLike, curve: CrankTorque) -> Angles:
    """Crank torque without its mean (N·m): the part whose work over a revolution is zero.

    ``crank_angle_rev``: revolutions, any shape. ``curve``: the branches. Returns the shape of the angles.
    Source: Zotov, Sviridov, Tokarev, below equation (2).
    """
    torque = crank_torque(np.asarray(crank_angle_rev, dtype=np.float64), curve)
    return np.asarray(torque - curve.mean_nm, dtype=np.float64)


def torque_harmonics(orders: ArrayLike, curve: CrankTorque) -> NDArray[np.complex128]:
    """Complex amplitude (N·m) of the crank torque at each order: torque = mean + Σ Re(amplitude · exp(2πi order rev)).

    The real part goes with the cosine, minus the imaginary part with the sine. Closed form: each branch as a sum of
    Legendre polynomials, whose transforms are spherical Bessel functions; nothing is sampled, so nothing aliases.

    ``orders``: cycles per revolution, whole numbers ≥ 1, any shape. ``curve``: the branches. Returns the shape of the
    orders. Raises RequestError for other orders.
    """
    from scipy.special import spherical_jn

    asked = np.asarray(orders, dtype=np.float64)
    if not (np.isfinite(asked).all() and (asked >= 1).all() and (asked == np.rint(asked)).all()):
        raise RequestError(
            "a torque that repeats each revolution has whole orders only", found=orders, allowed="1, 2 …"
        )
    total = np.zeros(asked.shape, dtype=np.complex128)
    for branch in curve.branches:
        legendre = np.polynomial.legendre.poly2leg(np.array(branch.coefficients, dtype=object))
        width = 2 * np.pi * branch.half_width_rev
        inside = np.zeros(asked.shape, dtype=np.complex128)
        for degree, value in enumerate(legendre):
            inside += float(value) * 2 * (-1j) ** degree * spherical_jn(degree, asked * width)
        turn = np.exp(-2j * np.pi * np.mod(asked * branch.middle_rev, 1.0))
        total += width / np.pi * turn * inside
    return total


def torque_extrema(curve: CrankTorque) -> tuple[Angles, Angles]:
    """Crank angles (revolutions, rising) at which the torque of a branch is stationary, and the torques there (N·m).

    ``curve``: the branches; the joints between them are not looked at.
    """
    turns: list[float] = []
    for branch in curve.branches:
        slope = np.polynomial.Polynomial([float(value) for value in branch.coefficients]).deriv()
        roots = slope.roots()
        # a double root may come out as a pair beside the real axis: half the digits is what such a root has
        real = np.sort(roots.real[np.abs(roots.imag) < 1e-8])
        bend = slope.deriv()
        for root in real[(real > -1) & (real < 1)]:
            curvature = bend(root)
            centred = root - slope(root) / curvature if curvature else root
            turns.append(float(branch.middle_rev + branch.half_width_rev * centred))
    found = np.asarray(turns, dtype=np.float64)
    return found, crank_torque(found, curve).astype(np.float64)


def _branch_torque(centred: NDArray[np.floating[Any]], branch: TorqueBranch) -> NDArray[np.floating[Any]]:
    """Torque at t in −1 … 1, exact at both ends, so that branches meet without a step."""
    number = centred.dtype.type
    rise = np.zeros_like(centred)
    for value in branch.rise[::-1]:
        rise *= centred
        rise += number(value)
    first, last = branch.torque_nm[0], branch.torque_nm[-1]
    to_end, from_start = 1 - centred, 1 + centred
    straight = number(first / 2) * to_end + number(last / 2) * from_start
    torque: NDArray[np.floating[Any]] = straight + to_end * from_start * rise
    return torque
