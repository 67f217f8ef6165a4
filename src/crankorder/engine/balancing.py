"""Balance by counterweights on crank and rod: forces in the crank's plane by order, what strategies a to d leave."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.machine_parts import EngineData, NonNegative, Positive
from crankorder.engine.slider_crank import SliderCrank, acceleration_harmonics, plain_piston_acceleration
from crankorder.errors import RequestError

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
            order=order, direct_g_mm=(x_g_mm + 1j * y_g_mm) / 2, reverse_g_mm=(x_g_mm - 1j * y_g_mm).conjugate() / 2
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
    return 1e-6 * np.asarray(unbalance_g_mm, dtype=np.float64) * omega**2


def phasor(angle_deg: float) -> complex:
    """Number of size one at ``angle_deg`` (degrees), exact at every quarter turn."""
    quarter = round(angle_deg / 90)
    rest = math.radians(angle_deg - 90 * quarter)
    return (1 + 0j, 1j, -1 + 0j, -1j)[quarter % 4] * cmath.rect(1, rest)


Strategy = Literal["a", "b", "c", "d"]

RECIPROCATING_SHARE: dict[Strategy, float] = {"a": 1.0, "b": 0.0, "c": 0.5}
"""Share of the reciprocating mass that the crank's counterweight stands against, beside the whole rotating mass."""


class CrankTrain(EngineData):
    """Crank, connecting rod and piston as parts: masses in g, lengths and centres of gravity in mm.

    ``crank_centroid_mm`` is counted from the crankshaft's axis, ``rod_centroid_mm`` from the crank pin. The two masses
    that replace the rod keep its centre of gravity, so forces on the frame are exact whatever its moment of inertia;
    the couple is not. Source: Task 5, equation (5.1).
    """

    crank_mass_g: NonNegative
    crank_centroid_mm: float
    crank_radius_mm: Positive
    rod_mass_g: NonNegative
    rod_centroid_mm: float
    rod_length_mm: Positive
    piston_mass_g: NonNegative

    @property
    def rod_at_piston_pin_g(self) -> float:
        """Part of the rod that goes to and fro with the piston."""
        return self.rod_mass_g * self.rod_centroid_mm / self.rod_length_mm

    @property
    def rod_at_crank_pin_g(self) -> float:
        """Part of the rod that turns with the crank."""
        return self.rod_mass_g - self.rod_at_piston_pin_g

    @property
    def rotating_g(self) -> float:
        """All that rotates, at the crank radius (Q1)."""
        return self.rod_at_crank_pin_g + self.crank_mass_g * self.crank_centroid_mm / self.crank_radius_mm

    @property
    def reciprocating_g(self) -> float:
        """All that goes to and fro (Q3)."""
        return self.rod_at_piston_pin_g + self.piston_mass_g


class CounterweightPlaces(EngineData):
    """Radii (mm) at which masses can be added: on the crank, and on the rod beyond the crank pin."""

    crank_mm: Positive | None = None
    rod_mm: Positive | None = None


@dataclass(frozen=True, kw_only=True)
class ReducedMasses:
    """An engine as its balance sees it: a mass that rotates at the crank radius and one that slides along the cylinder.

    ``rotating_g`` is complex: its angle is that of the unbalance from the crank; a counterweight makes it negative.
    """

    mechanism: SliderCrank
    rotating_g: complex
    reciprocating_g: float

    @property
    def crank_radius_mm(self) -> float:
        """Crank radius (mm)."""
        return self.mechanism.crank_radius_m * 1e3

    @property
    def rod_length_mm(self) -> float:
        """Length of the connecting rod (mm)."""
        return self.mechanism.rod_length_m * 1e3


@dataclass(frozen=True, kw_only=True)
class Counterweights:
    """Masses (g) that a strategy adds: on the crank, opposite to its pin, and on the rod beyond the crank pin.

    ``crank_g`` below zero is to be taken off. ``crank_deg`` turns its place on, in the sense of the crank; it is zero
    where the mass lies along the crank.
    """

    crank_g: float
    crank_deg: float = 0.0
    rod_g: float = 0.0

    @property
    def total_g(self) -> float:
        """Mass added in all; below zero, taken off."""
        return self.crank_g + self.rod_g


def counterweights(masses: ReducedMasses, strategy: Strategy, places: CounterweightPlaces) -> Counterweights:
    """Counterweights (g) that a strategy asks for, below zero where the crank has too much already.

    ``masses``: engine before balancing. ``strategy``: "a" cancels the first order along the cylinder, "b" the force
    across it, "c" leaves equal parts of both, "d" brings every centre of gravity to the crankshaft. ``places``: radii;
    the crank radius stands in for a missing one on the crank. Raises RequestError where "d" has no radius on the rod.
    Source: Task 5, equations (5.7), (5.10), (5.24), (5.31), (5.33).
    """
    leverage = masses.crank_radius_mm / (places.crank_mm or masses.crank_radius_mm)
    if strategy != "d":
        return _on_crank(leverage, masses.rotating_g + RECIPROCATING_SHARE[strategy] * masses.reciprocating_g)
    if places.rod_mm is None:
        raise RequestError("strategy d needs a counterweight on the rod", place="rod_mm", remedy="State its radius")
    on_rod = masses.reciprocating_g * masses.rod_length_mm / places.rod_mm
    return replace(_on_crank(leverage, masses.rotating_g + masses.reciprocating_g + on_rod), rod_g=on_rod)


def _on_crank(leverage: float, against_g: complex) -> Counterweights:
    """The mass on the crank against a rotating one, signed along the crank and else with its angle."""
    against = complex(against_g)
    if not against.imag:
        return Counterweights(crank_g=leverage * against.real)
    return Counterweights(crank_g=leverage * abs(against), crank_deg=math.degrees(cmath.phase(against)))


def balanced(masses: ReducedMasses, strategy: Strategy) -> ReducedMasses:
    """What rotates and what slides under a strategy, in closed form, so that what cancels is exactly zero.

    ``masses``: engine before balancing. ``strategy``: "a", "b", "c" or "d".
    Source: Task 5, equations (5.8), (5.11), (5.25), (5.26).
    """
    if strategy == "d":
        return replace(masses, rotating_g=0.0, reciprocating_g=0.0)
    return replace(masses, rotating_g=-RECIPROCATING_SHARE[strategy] * masses.reciprocating_g)


def force_by_order(masses: ReducedMasses, *, max_order: int) -> tuple[OrderForce, ...]:
    """Force on the frame over ω² by order 1 … ``max_order`` (g·mm).

    ``masses``: what rotates and what slides. ``max_order``: ≥ 1. Orders that the engine does not make are left out,
    except the first.
    Source: Task 5, equations (5.2), (5.3), with harmonics of any order (truth sheet 1) and with offset (2.6).
    """
    harmonics = acceleration_harmonics(masses.mechanism, max_order)
    sliding = masses.crank_radius_mm * masses.reciprocating_g * harmonics
    rotating = masses.crank_radius_mm * masses.rotating_g
    first = OrderForce.of_axes(order=1, x_g_mm=complex(sliding[1]))
    return (
        OrderForce(order=1, direct_g_mm=rotating + first.direct_g_mm, reverse_g_mm=first.reverse_g_mm),
        *(OrderForce.of_axes(order=k, x_g_mm=complex(sliding[k])) for k in range(2, max_order + 1) if sliding[k]),
    )


def rod_counterweight_couple(
    masses: ReducedMasses, added: Counterweights, places: CounterweightPlaces, crank_angle_rev: ArrayLike
) -> NDArray[np.float64]:
    """Couple over ω² on the frame (g·mm²) that a counterweight on the rod leaves where all forces cancel.

    ``masses``: lengths (an offset is not treated). ``added``, ``places``: counterweights and radii.
    ``crank_angle_rev``: revolutions, any shape; the result has that shape, positive in the sense of the crank. What
    the rod's true moment of inertia adds is not in it. Source: angular momentum of a point beyond the crank pin
    (truth sheet 0).
    """
    angle = 2 * np.pi * np.asarray(crank_angle_rev, dtype=np.float64)
    radius, length, ratio = masses.crank_radius_mm, masses.rod_length_mm, masses.mechanism.crank_ratio
    beyond = places.rod_mm or 0.0
    sine, cosine = np.sin(angle), np.cos(angle)
    rod_cosine = np.hypot(cosine, np.sqrt((1 - ratio) * (1 + ratio)) * sine)
    swing = 1e3 * plain_piston_acceleration(crank_angle_rev, masses.mechanism) - radius * cosine  # length · λ² · D
    place_x, place_y = radius * cosine - beyond * rod_cosine, (radius + beyond * ratio) * sine
    second_x = -radius * cosine + beyond / length * swing
    second_y = -place_y
    couple: NDArray[np.float64] = -added.rod_g * (place_x * second_y - place_y * second_x)
    return couple
