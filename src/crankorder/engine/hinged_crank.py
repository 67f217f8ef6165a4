"""A crank mechanism with elastic hinges: its data, its motion, and the torque of its cylinder.

The cylinder axis is x, from the crankshaft to the top dead centre; weights act along −y; the crank turns from x to y.
Rod, piston and the counterweight of the rod lie on one line through the crank pin A.

The torque curve has a few nodes per branch. Each branch is the polynomial through its nodes, in exact fractions,
and evaluated about the middle of its branch, t = (angle − middle) / half width in −1 … 1, as a rise above the straight
line between its ends. In powers of the angle itself it loses eight of sixteen digits (truth sheet 4.1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, ValidationError, ValidationInfo, field_validator

from crankorder.engine.machine_parts import EngineData, NonNegative, Positive
from crankorder.engine.slider_crank import Angles, SliderCrank, sine_cosine
from crankorder.errors import ManyErrors, RequestError
from crankorder.settings import toml_table, validation_fault


class TorqueBranch(EngineData):
    """Nodes of one branch: crank angles (degrees, rising, first and last node bound the branch) and torques (N·m)."""

    angle_deg: tuple[float, ...] = Field(strict=False)
    torque_nm: tuple[float, ...] = Field(strict=False)

    # As in definition.py: one check a field, on what comes before it.

    @field_validator("angle_deg")
    @classmethod
    def _rises(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) < 2 or any(after <= before for before, after in pairwise(value)):
            raise ValueError("a branch of a torque curve needs two or more rising angles")
        return value

    @field_validator("torque_nm")
    @classmethod
    def _as_many_as_angles(cls, value: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        angles = info.data.get("angle_deg")
        if angles is not None and len(value) != len(angles):
            raise ValueError(f"must have one torque for each of the {len(angles)} crank angles")
        return value

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
            problem = "the branches of a torque curve must follow one another without a gap"
            raise RequestError(problem, found=edges, allowed="from 0 to 360 degrees")

    @cached_property
    def mean_nm(self) -> float:
        """Mean torque over a revolution (N·m), rounded once from the exact fraction."""
        return float(sum((branch.integral_nm_deg for branch in self.branches), Fraction(0)) / 360)

    @property
    def work_per_rev_j(self) -> float:
        """Work of the torque over one revolution (J)."""
        return 2 * math.pi * self.mean_nm


def crank_torque(crank_angle_rev: ArrayLike, curve: CrankTorque) -> Angles:
    """Crank torque (N·m) at each angle.

    ``crank_angle_rev``: revolutions from top dead centre, any shape; whole revolutions are taken off. ``curve``: the
    branches. Returns the shape of the angles. For the curve of document 003 the error is below 1e-12 N·m (of 809 N·m
    at the peak); at the ends of a branch there is none.
    Source: Zotov, Sviridov, Tokarev, equation (1), by its nodes (truth sheet 4.1).
    """
    turns = np.asarray(np.mod(np.asarray(crank_angle_rev, dtype=np.float64), 1.0))
    starts = [branch.angle_deg[0] / 360 for branch in curve.branches]
    index = np.searchsorted(starts, turns, side="right") - 1
    torque = np.empty(turns.shape)
    for number, branch in enumerate(curve.branches):
        inside = index == number
        centred = (turns[inside] - branch.middle_rev) / branch.half_width_rev
        torque[inside] = _branch_torque(centred, branch)
    return torque


def potential_torque(crank_angle_rev: ArrayLike, curve: CrankTorque) -> Angles:
    """Crank torque without its mean (N·m): the part whose work over a revolution is zero.

    ``crank_angle_rev``: revolutions, any shape. ``curve``: the branches. Returns the shape of the angles.
    Source: Zotov, Sviridov, Tokarev, below equation (2).
    """
    return crank_torque(crank_angle_rev, curve) - curve.mean_nm


def torque_harmonics(orders: ArrayLike, curve: CrankTorque) -> NDArray[np.complex128]:
    """Complex amplitude (N·m) of the crank torque at each order: torque = mean + Σ Re(amplitude · exp(2πi order rev)).

    The real part goes with the cosine, minus the imaginary part with the sine. Closed form: each branch as a sum of
    Legendre polynomials, whose transforms are spherical Bessel functions; nothing is sampled, so nothing aliases.

    ``orders``: cycles per revolution, whole numbers ≥ 1, any shape. ``curve``: the branches. Returns the shape of the
    orders.
    """
    from scipy.special import spherical_jn

    asked = np.asarray(orders, dtype=np.float64)
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
    angles = np.asarray(turns, dtype=np.float64)
    return angles, crank_torque(angles, curve)


def _branch_torque(centred: Angles, branch: TorqueBranch) -> Angles:
    """Torque at t in −1 … 1, exact at both ends, so that branches meet without a step."""
    rise = np.zeros_like(centred)
    for coefficient in branch.rise[::-1]:
        rise *= centred
        rise += coefficient
    first, last = branch.torque_nm[0], branch.torque_nm[-1]
    to_end, from_start = 1 - centred, 1 + centred
    straight = first / 2 * to_end + last / 2 * from_start
    return straight + to_end * from_start * rise


class HingedCrank(EngineData):
    """Lengths (m), weights (N) and inertias (kg·m²) of document 003, figure 1; its symbols stand behind each field."""

    crank_radius_m: Positive  # r1 + r2
    pin_to_rod_centre_m: NonNegative  # l1, crank pin to the rod's centre of mass
    rod_centre_to_piston_m: NonNegative  # l2
    rod_weight_n: NonNegative  # P2
    piston_weight_n: NonNegative  # P3
    rod_inertia_kg_m2: NonNegative  # I_C2, about the rod's own centre of mass
    rod_counterweight_n: NonNegative = 0.0  # P4
    rod_counterweight_radius_m: NonNegative = 0.0  # l0, from the crank pin away from the piston
    crank_weight_n: NonNegative = 0.0  # P1
    crank_centre_radius_m: NonNegative = 0.0  # r1
    crank_inertia_kg_m2: NonNegative = 0.0  # I_0, of the crank about the crankshaft
    crank_counterweight_n: NonNegative = 0.0  # P5
    crank_counterweight_radius_m: NonNegative = 0.0  # r0, opposite the crank pin
    gravity_m_s2: Positive = 9.81

    @field_validator("rod_centre_to_piston_m")
    @classmethod
    def _rod_reaches(cls, value: float, info: ValidationInfo) -> float:
        radius_m, to_centre_m = info.data.get("crank_radius_m"), info.data.get("pin_to_rod_centre_m")
        if radius_m is not None and to_centre_m is not None:
            SliderCrank(crank_radius_m=radius_m, rod_length_m=to_centre_m + value)
        return value

    @property
    def rod_length_m(self) -> float:
        """Rod length L = l1 + l2 (m)."""
        return self.pin_to_rod_centre_m + self.rod_centre_to_piston_m

    @property
    def mechanism(self) -> SliderCrank:
        """The lengths of the crank mechanism alone."""
        return SliderCrank(crank_radius_m=self.crank_radius_m, rod_length_m=self.rod_length_m)

    @property
    def rod_points(self) -> tuple[tuple[float, float], ...]:
        """Mass (kg) and distance from the crank pin towards the piston (m) of piston, rod and rod counterweight."""
        return (
            (self.piston_weight_n / self.gravity_m_s2, self.rod_length_m),
            (self.rod_weight_n / self.gravity_m_s2, self.pin_to_rod_centre_m),
            (self.rod_counterweight_n / self.gravity_m_s2, -self.rod_counterweight_radius_m),
        )

    @property
    def static_moment_nm(self) -> float:
        """G = P3 L + P2 l1 − P4 l0 (N·m): zero where piston, rod and counterweight balance about the crank pin."""
        piston, rod = self.piston_weight_n * self.rod_length_m, self.rod_weight_n * self.pin_to_rod_centre_m
        return piston + rod - self.rod_counterweight_n * self.rod_counterweight_radius_m


@dataclass(frozen=True, kw_only=True)
class RodMotion:
    """Motion of crank and rod at crank angle φ, each of the shape of the angles; derivatives are by φ in radians."""

    sine: Angles
    """sin φ."""
    cosine: Angles
    """cos φ."""
    rod_cosine: Angles
    """cos ψ."""
    swing: Angles
    """u = dψ/dφ."""
    swing_rate: Angles
    """d²ψ/dφ²."""
    hinge_rate: Angles
    """1 + u = d(φ + ψ)/dφ, without cancellation."""
    bend: Angles
    """D = −(cos ψ)'' / λ²."""


def rod_motion(crank_angle_rev: ArrayLike, crank: HingedCrank) -> RodMotion:
    """Motion of the rod at each crank angle, without cancellation however short the rod is.

    ``crank_angle_rev``: revolutions from top dead centre, any shape. ``crank``: its lengths.
    Source: truth sheet section 0; below equation (4) of document 003.
    """
    ratio = crank.mechanism.crank_ratio
    kappa_squared = crank.mechanism.margin * (1 + ratio)
    sine, cosine = sine_cosine(crank_angle_rev)
    upper = np.abs(cosine)
    rod_cosine = np.hypot(cosine, np.sqrt(kappa_squared) * sine)
    level = np.sqrt(kappa_squared) * sine**2
    folded = kappa_squared / (rod_cosine * (rod_cosine + ratio * upper))
    return RodMotion(
        sine=sine,
        cosine=cosine,
        rod_cosine=rod_cosine,
        swing=ratio * cosine / rod_cosine,
        swing_rate=-ratio * kappa_squared * sine / rod_cosine**3,
        hinge_rate=np.where(cosine < 0, folded, 1 + ratio * upper / rod_cosine),
        bend=(cosine**2 - level) * (cosine**2 + level) / rod_cosine**3,
    )


def point_velocity(distance_m: float, motion: RodMotion, crank: HingedCrank) -> tuple[Angles, Angles]:
    """Velocity (x', y') per unit of crank speed (m/rad) of a point of the rod's line.

    ``distance_m``: from the crank pin towards the piston, negative beyond the pin. ``motion``: of the rod. ``crank``:
    its lengths. Source: truth sheet section 0.
    """
    share = distance_m / crank.rod_length_m
    lever = crank.crank_radius_m * ((1 - share) + share * motion.hinge_rate)
    return -lever * motion.sine, crank.crank_radius_m * (1 - share) * motion.cosine


def point_acceleration(distance_m: float, motion: RodMotion, crank: HingedCrank) -> tuple[Angles, Angles]:
    """Acceleration (x'', y'') per squared crank speed (m/rad²) of a point of the rod's line.

    ``distance_m``: from the crank pin towards the piston, negative beyond the pin. ``motion``: of the rod. ``crank``:
    its lengths. Source: truth sheet section 0; below equation (4) of document 003.
    """
    share = distance_m / crank.rod_length_m
    along = motion.cosine + share * crank.mechanism.crank_ratio * motion.bend
    return -crank.crank_radius_m * along, -crank.crank_radius_m * (1 - share) * motion.sine


PinHinge = Literal["full", "potential", "printed"]
"""What the hinge at the crank pin gives. ``"full"``: all of M12, so that no side force is left; only where G = 0 can a
spring do that. ``"potential"``: M12 less the constant that makes its work over the hinge angle φ + ψ zero.
``"printed"``: equation (6), less the mean over φ; its work over the hinge's own angle is not zero."""

# A panel as wide as twice its distance from a singularity converges by (1 + √2)² a point: this many reach 1e-16
_POINTS_BESIDE_SINGULARITY = 22


def gas_moment(crank_angle_rev: ArrayLike, crank: HingedCrank, torque: CrankTorque) -> Angles:
    """Moment T (N·m) of the potential gas force about the crank pin: F R sin φ, finite at every angle.

    F itself, equation (3), has poles at both dead centres and is never formed: T = M_pot / (1 + dψ/dφ).

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths. ``torque``: of the crank.
    Returns the shape of the angles. Source: truth sheet 4.2.
    """
    motion = rod_motion(crank_angle_rev, crank)
    return potential_torque(crank_angle_rev, torque) / motion.hinge_rate


def inertia_moment(motion: RodMotion, crank: HingedCrank) -> Angles:
    """J (kg·m²): moment about the crank pin of all inertia of rod, piston and counterweight, per squared crank speed.

    ``motion``: of the rod. ``crank``: lengths and weights. Odd in the crank angle, so its mean is zero.
    Source: truth sheet 4.3 (the inertia terms of equation (4)).
    """
    total = -crank.rod_inertia_kg_m2 * motion.swing_rate
    rod_sine = crank.mechanism.crank_ratio * motion.sine
    for mass, distance in crank.rod_points:
        along, across = point_acceleration(distance, motion, crank)
        total = total + mass * distance * (rod_sine * along + motion.rod_cosine * across)
    return total


def hinge_moment(
    crank_angle_rev: ArrayLike,
    crank: HingedCrank,
    torque: CrankTorque,
    *,
    speed_rpm: float,
    pin_hinge: PinHinge = "full",
) -> Angles:
    """Moment (N·m) of the hinge at the crank pin upon the rod; "full" is M12, which leaves no side force at all.

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths and weights. ``torque``: of the crank.
    ``speed_rpm``: constant crank speed. ``pin_hinge``: see :data:`PinHinge`. Returns the shape of the angles.
    Source: document 003, equations (4) and (6); truth sheet 4.3 and 4.4.
    """
    motion = rod_motion(crank_angle_rev, crank)
    omega_squared = (speed_rpm * np.pi / 30) ** 2
    moment = crank.static_moment_nm * motion.rod_cosine + gas_moment(crank_angle_rev, crank, torque)
    moment += omega_squared * inertia_moment(motion, crank)
    moment -= withheld_moment(crank, torque, pin_hinge=pin_hinge)
    return moment


def withheld_moment(crank: HingedCrank, torque: CrankTorque, *, pin_hinge: PinHinge) -> float:
    """Constant (N·m) that the hinge at the crank pin leaves out of M12; no crank speed changes it.

    ``crank``: lengths and weights. ``torque``: of the crank. ``pin_hinge``: 0 for "full", G⟨cos ψ⟩ for "potential",
    G⟨cos ψ⟩ + ⟨T⟩ for "printed". Source: truth sheet 4.3 and 4.4.
    """
    if pin_hinge == "full":
        return 0.0
    static = crank.static_moment_nm * mean_rod_cosine(crank)
    return static if pin_hinge == "potential" else static + mean_gas_moment(crank, torque)


def side_force_without_hinge(
    crank_angle_rev: ArrayLike, crank: HingedCrank, torque: CrankTorque, *, speed_rpm: float
) -> Angles:
    """Side force R430 (N) of the cylinder upon the piston where the crank pin has no hinge: M12 / (L cos ψ).

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths and weights. ``torque``: of the crank.
    ``speed_rpm``: constant crank speed. Returns the shape of the angles. Source: document 003, equation (5).
    """
    moment = hinge_moment(crank_angle_rev, crank, torque, speed_rpm=speed_rpm)
    return moment / (crank.rod_length_m * rod_motion(crank_angle_rev, crank).rod_cosine)


def side_force(crank_angle_rev: ArrayLike, crank: HingedCrank, torque: CrankTorque, *, pin_hinge: PinHinge) -> Angles:
    """Side force R43 (N) of the cylinder upon the piston that a hinge at the crank pin leaves, at any crank speed.

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths and weights. ``torque``: of the crank.
    ``pin_hinge``: see :data:`PinHinge`. Returns the shape of the angles.
    Source: document 003, equation (7); truth sheet 4.4.
    """
    withheld = withheld_moment(crank, torque, pin_hinge=pin_hinge)
    return withheld / (crank.rod_length_m * rod_motion(crank_angle_rev, crank).rod_cosine)


def mean_rod_cosine(crank: HingedCrank, *, truncated: bool = False) -> float:
    """Mean of cos ψ over the crank angle: 2E(λ²)/π, or 1 − λ²/4 where ``truncated`` as document 003 has it.

    ``crank``: lengths. Source: truth sheet 4.3.
    """
    from scipy.special import ellipe

    squared = crank.mechanism.crank_ratio**2
    return 1 - squared / 4 if truncated else float(2 / np.pi * ellipe(squared))


def mean_gas_moment(crank: HingedCrank, torque: CrankTorque) -> float:
    """Mean ⟨T⟩ (N·m) of the moment of the potential gas force about the crank pin over the crank angle.

    ``crank``: lengths, of which λ alone matters. ``torque``: of the crank. Source: truth sheet 4.3.
    """
    crank_angle_rev, weight_rev = branch_quadrature(crank, torque)
    return float(weight_rev @ gas_moment(crank_angle_rev, crank, torque))


def branch_quadrature(crank: HingedCrank, torque: CrankTorque) -> tuple[Angles, Angles]:
    """Crank angles and weights (both in revolutions) whose sum is a mean over the revolution, to round-off.

    Gauss–Legendre points between the kinks of the torque. The rod makes the integrand singular at complex angles beside
    90° and 270°, the nearer the shorter it is: towards these the panels shrink in steps, so that their number grows but
    slowly and each needs the same few points. ``crank``: lengths. ``torque``: of the crank.
    """
    shortness = crank.mechanism.margin / crank.mechanism.crank_ratio
    reach_rev = math.log1p(shortness + math.sqrt(shortness * (shortness + 2))) / (2 * np.pi)
    steps = reach_rev * 3.0 ** np.arange(math.ceil(max(0.0, math.log(0.5 / reach_rev, 3))))
    graded = np.concatenate([flat + sign * steps for flat in (0.25, 0.75) for sign in (-1, 1)])
    angles, weights = [], []
    for branch in torque.branches:
        first, last = branch.middle_rev - branch.half_width_rev, branch.middle_rev + branch.half_width_rev
        edges = np.unique([first, *graded[(graded > first) & (graded < last)], last])
        nodes, shares = np.polynomial.legendre.leggauss(_POINTS_BESIDE_SINGULARITY + 2 * len(branch.angle_deg))
        half = np.diff(edges)[:, None] / 2
        angles.append((edges[:-1, None] + half * (1 + nodes)).ravel())
        weights.append((half * shares).ravel())
    return np.concatenate(angles), np.concatenate(weights)


class GuideData(EngineData):
    """Spring, guides and rollers of a hinge (m), document 003, figure 7.

    A straight compression spring lies along a radius between two guides, a roller at each end. ``free_length_m``: of
    the spring; ``least_compression_m`` and ``most_compression_m``: where it stores least and most; its stiffness
    follows from these. ``middle_radius_m``: of the spring's middle about the hinge's axis. ``roller_radius_m``: of the
    rollers.
    """

    free_length_m: Positive
    least_compression_m: Positive
    most_compression_m: Positive
    middle_radius_m: Positive
    roller_radius_m: NonNegative = 0.0

    @field_validator("most_compression_m")
    @classmethod
    def _leaves_a_spring(cls, value: float, info: ValidationInfo) -> float:
        least, free = info.data.get("least_compression_m"), info.data.get("free_length_m")
        if (least is not None and value <= least) or (free is not None and value >= free):
            raise ValueError("most_compression_m must lie between least_compression_m and free_length_m")
        return value

    @field_validator("middle_radius_m")
    @classmethod
    def _clears_the_axis(cls, value: float, info: ValidationInfo) -> float:
        least, free = info.data.get("least_compression_m"), info.data.get("free_length_m")
        if least is not None and free is not None and value <= (free - least) / 2:
            raise ValueError("middle_radius_m must exceed half the spring's length, or its inner end passes the axis")
        return value


class HingedCrankData(HingedCrank):
    """One mechanism of a file: a crank with its name, speeds and guides.

    Where ``rod_inertia_kg_m2`` is left out the rod is taken as uniform and slender. ``speeds_rad_s``: crank speeds that
    it is meant to run at. ``pin_guides``, ``strut_guides``: springs and guides to be cut for the hinges.
    """

    name: Annotated[str, Field(min_length=1)]
    rod_inertia_kg_m2: NonNegative | None = None  # type: ignore[assignment]
    speeds_rad_s: tuple[Positive, ...] = Field(default=(), strict=False)
    pin_guides: GuideData | None = None
    strut_guides: GuideData | None = None

    @cached_property
    def crank(self) -> HingedCrank:
        """The mechanism alone, with the inertia of its rod."""
        values = self.model_dump(include=set(HingedCrank.model_fields))
        if self.rod_inertia_kg_m2 is None:
            # of a uniform slender rod about its middle, m L² / 12: document 003 prints none, the truth sheet takes this
            values["rod_inertia_kg_m2"] = self.rod_weight_n / self.gravity_m_s2 * self.rod_length_m**2 / 12
        return HingedCrank(**values)

    @property
    def speeds_rpm(self) -> tuple[float, ...]:
        """Crank speeds in revolutions per minute."""
        return tuple(speed * 30 / math.pi for speed in self.speeds_rad_s)


class HingedEngine(EngineData):
    """A torque curve and the mechanisms that it drives."""

    kind: Literal["elastic-hinge"]
    title: str = ""
    torque: tuple[TorqueBranch, ...] = Field(strict=False)
    mechanisms: tuple[HingedCrankData, ...] = Field(strict=False)

    @field_validator("torque")
    @classmethod
    def _closes(cls, value: tuple[TorqueBranch, ...]) -> tuple[TorqueBranch, ...]:
        CrankTorque(branches=value)
        return value

    @field_validator("mechanisms")
    @classmethod
    def _names_differ(cls, value: tuple[HingedCrankData, ...]) -> tuple[HingedCrankData, ...]:
        names = [mechanism.name for mechanism in value]
        if not names:
            raise ValueError("an engine with elastic hinges needs at least one [[mechanisms]]")
        if len(set(names)) < len(names):
            raise ValueError(f"two mechanisms bear one name: {', '.join(names)}")
        return value

    @cached_property
    def curve(self) -> CrankTorque:
        """Torque over the whole revolution."""
        return CrankTorque(branches=self.torque)


def load_hinged_engine(name: str, beside: Path | None = None) -> HingedEngine:
    """Torque curve and mechanisms from a shipped file of ``pipeline/engines`` or a user's TOML file.

    ``name``: a shipped file's stem or the path of a TOML file. ``beside``: folder in which that path is tried first.
    Raises RequestError where there is no such file, ManyErrors with every fault of its content.
    """
    table, source = toml_table(name, "engines", beside=beside)
    try:
        return HingedEngine.model_validate(table)
    except ValidationError as error:
        raise ManyErrors([validation_fault(fault, source) for fault in error.errors()]) from None
