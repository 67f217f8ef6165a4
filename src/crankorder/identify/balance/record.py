"""Residual masses as the findings tell them: split by direction and sense of rotation, each with its 95 % interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from crankorder.engine.definition import Engine
from crankorder.engine.machine_parts import AddedMass
from crankorder.findings import Balance
from crankorder.orders.intervals import half_width
from crankorder.quantities import Complexes, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-balance.toml", "record")

AGREE_CHI_SQUARE = 5.991
"""95 % point of χ² with two degrees of freedom: one complex difference."""
NO_ACROSS = (
    "the path of forces across the cylinder is not identified: no order of known force acts there; state it "
    "([[transfer_paths]], direction X) or run a test with a known added mass"
)

NO_ANGLE = "the unbalance may be none: its angle means nothing"


Place = tuple[int, str]
"""Order and axis of a force."""


@dataclass(frozen=True, eq=False)
class Split:
    """Complex masses (kg at the crank radius) behind orders 1 and 2, with what they multiply.

    ``mass_kg`` (mass,); ``covariance`` (2 mass, 2 mass) of real and imaginary parts in turn, with ``freedom``;
    ``sought``: (order, axis) of each; the force of a mass is mass · ``per_kg`` · r ω².
    """

    mass_kg: Complexes
    covariance: Floats
    freedom: float
    sought: tuple[Place, ...]
    per_kg: Complexes

    def combined(self, shares: Mapping[Place, complex]) -> tuple[complex, Floats]:
        """The complex sum of each mass times the share of its place in ``shares``, and the covariance (2, 2) of it."""
        share = np.array([shares.get(place, 0.0) for place in self.sought], dtype=np.complex128)
        turn = np.array([[[s.real, -s.imag], [s.imag, s.real]] for s in share]).transpose(1, 0, 2).reshape(2, -1)
        return complex(share @ self.mass_kg), turn @ self.covariance @ turn.T

    def per_kg_at(self, place: Place) -> complex:
        """What the mass at ``place`` multiplies."""
        return complex(self.per_kg[self.sought.index(place)])


ALONG, ACROSS, SECOND = (1, "Z"), (1, "X"), (2, "Z")
"""Places of the forces of order 1 along and across the cylinder, and of order 2 along it."""

B = TypeVar("B", bound=Balance)


def with_interval(balance: B, key: str, value: float, half: float) -> B:
    """``balance`` with its field ``key`` at ``value`` ± ``half``."""
    fields: Any = {key: value, f"{key}_ci95": (value - half, value + half)}
    return replace(balance, **fields)


def size_and_angle(
    balance: B, size_key: str, angle_key: str, value: complex, covariance: Floats, *, freedom: float
) -> B:
    """``balance`` with a complex unbalance ``value``, ``covariance`` (2, 2) of its parts, and its ``freedom``.

    ``size_key`` and ``angle_key`` name its fields; without the latter its angle is not kept. The interval of the size
    starts at 0 where the unbalance may be none; the angle (degrees) is then None.
    """
    size, t = abs(value), half_width(freedom)
    inwards = np.array([value.real, value.imag]) / size if size else np.array([1.0, 0.0])
    along = float(np.sqrt(inwards @ covariance @ inwards))
    aside = np.array([-inwards[1], inwards[0]])
    across = float(np.sqrt(aside @ covariance @ aside))
    joint = np.sqrt(AGREE_CHI_SQUARE) * max(along, across)
    half_deg = float(np.degrees(np.arcsin(min(1.0, t * across / size)))) if size else 180.0
    low = size - t * along if size > joint else 0.0
    fields: Any = {size_key: size, f"{size_key}_ci95": (max(0.0, low), size + t * along)}
    if angle_key and size > joint and half_deg < NUMBERS.vague_deg:
        angle = float(np.degrees(np.angle(value)))
        fields |= {angle_key: angle, f"{angle_key}_ci95": (angle - half_deg, angle + half_deg)}
    return replace(balance, **fields)


def split_record(split: Split, *, engine: Engine) -> Balance:
    """Residual masses from a ``split``, for ``engine``; what it does not tell, with reasons.

    ``along_g`` and ``along_quadrature_g``: force of the first order along the cylinder over r ω², in step with the
    piston's own and a quarter turn ahead of it, in grams at the crank radius; likewise ``residual_second_order_g`` over
    the force that a gram on the piston makes at order 2. Below 0 where shafts take away more than there is.
    """
    record = Balance(crank_radius_mm=1e3 * engine.crank_radius_m)
    undecided: dict[str, str] = {}
    if ALONG in split.sought:
        per_kg = abs(split.per_kg_at(ALONG))
        record = _with_grams(record, "along_g", split, {ALONG: per_kg})
        record = _with_grams(record, "along_quadrature_g", split, {ALONG: -1j * per_kg})
    tell = _both_ways if {ALONG, ACROSS} <= set(split.sought) else _one_way
    record = tell(record, split, engine, undecided)
    if SECOND in split.sought:
        record = _with_grams(record, "residual_second_order_g", split, {SECOND: 1.0})
    elif 2 in engine.shafts.every_order:
        undecided["residual_second_order_g"] = "the path at order 2 is not identified"
    else:
        whole = "no shafts take the second order away: the whole reciprocating mass makes it"
        undecided["residual_second_order_g"] = whole
    return replace(record, not_decided=undecided)


def _with_grams(record: Balance, key: str, split: Split, shares: Mapping[Place, complex]) -> Balance:
    """``record`` with its field ``key`` at the real part in grams of what ``split`` holds in these ``shares``."""
    mass_kg, covariance = split.combined(shares)
    half = 1e3 * half_width(split.freedom) * float(np.sqrt(covariance[0, 0]))
    return with_interval(record, key, 1e3 * mass_kg.real, half)


def _one_way(record: Balance, split: Split, engine: Engine, undecided: dict[str, str]) -> Balance:
    """Forces along the cylinder alone: both orders tell the reciprocating mass where they ask for the same one."""
    across = ("across_g", "forward_gmm", "reverse_gmm", "residual_rotating_gmm", "angle_deg")
    undecided |= dict.fromkeys(across, NO_ACROSS)
    alike = "rotating and reciprocating mass act alike along the cylinder at order 1"
    if not {ALONG, SECOND} <= set(split.sought):
        undecided["residual_reciprocating_g"] = f"{alike}, and no residual of the second order tells them apart"
        return record
    if len(engine.cylinders) > 1:
        undecided["residual_reciprocating_g"] = f"{alike}, and of several cylinders none is known to be the one"
        return record
    # the one mass that both tell best (generalised least squares); their difference has two degrees of freedom
    first, second = split.sought.index(ALONG), split.sought.index(SECOND)
    both, picked = split.mass_kg[[first, second]], [2 * first, 2 * first + 1, 2 * second, 2 * second + 1]
    values, design = both.view(np.float64), np.concatenate([np.eye(2), np.eye(2)])
    weight = np.linalg.pinv(split.covariance[np.ix_(picked, picked)])
    covariance = np.linalg.pinv(design.T @ weight @ design)
    common = covariance @ design.T @ weight @ values
    left = values - design @ common
    if left @ weight @ left > AGREE_CHI_SQUARE:
        asked = " and ".join(f"{1e3 * size:.3g}" for size in np.abs(both))
        undecided["residual_reciprocating_g"] = (
            f"orders 1 and 2 ask for different masses, {asked} g: rotating unbalance, or shafts that miss one of the "
            "orders"
        )
        return record
    half = 1e3 * half_width(split.freedom) * float(np.sqrt(covariance[0, 0]))
    return with_interval(record, "residual_reciprocating_g", 1e3 * float(common[0]), half)


def _both_ways(record: Balance, split: Split, engine: Engine, undecided: dict[str, str]) -> Balance:
    """Forces along and across: forward and reverse, and for cylinders along Z rotating and reciprocating."""
    z, x, g_mm = split.per_kg_at(ALONG), split.per_kg_at(ACROSS), 1e6 * engine.crank_radius_m
    record = _with_size(record, "across_g", "", split, {ACROSS: 1e3 * x})
    for name, turn in (("forward", 0.5j), ("reverse", -0.5j)):
        shares = {ALONG: 0.5 * g_mm * z, ACROSS: turn * g_mm * x}
        record = _with_size(record, f"{name}_gmm", f"{name}_angle_deg", split, shares)
    if any(cylinder.bank_deg for cylinder in engine.cylinders):
        for key in ("residual_rotating_gmm", "residual_reciprocating_g", "angle_deg"):
            undecided[key] = "pistons of leaning cylinders act across too: forward and reverse parts tell all there is"
    else:
        record = _with_size(record, "residual_rotating_gmm", "angle_deg", split, {ACROSS: 1j * g_mm * x})
        piston = np.conj(z) / abs(z) ** 2
        shares = {ALONG: piston * z, ACROSS: -1j * piston * x}
        record = _with_grams(record, "residual_reciprocating_g", split, shares)
        value, covariance = split.combined(shares)
        if abs(value.imag) > half_width(split.freedom) * float(np.sqrt(covariance[1, 1])):
            undecided["reverse_angle_deg"] = "part of the reverse force is out of step with the piston: mistimed shafts"
    for part, way in (("residual_rotating", ""), ("forward", "forward_"), ("reverse", "reverse_")):
        if getattr(record, f"{part}_gmm") is not None and getattr(record, f"{way}angle_deg") is None:
            undecided[f"{way}angle_deg"] = NO_ANGLE
    return record


def _with_size(
    record: Balance, size_key: str, angle_key: str, split: Split, shares: Mapping[Place, complex]
) -> Balance:
    """``record`` with the size and the angle of what ``split`` holds in these ``shares``."""
    return size_and_angle(record, size_key, angle_key, *split.combined(shares), freedom=split.freedom)


def added_words(added: Sequence[AddedMass]) -> str:
    """Words that say which ``added`` masses are part of the residual."""
    each = [
        f"{mass.mass_g:g} g on the {mass.on}"
        + (f" at {mass.radius_mm:g} mm, {mass.angle_deg:g}°" if mass.on == "crank" else f" of cylinder {mass.cylinder}")
        for mass in added
    ]
    return f"the residual includes what was added on purpose: {', '.join(each)}"


def rotor_record(split: Split) -> Balance:
    """Residual masses of a rotor from a ``split`` whose masses (kg) stand at 1 mm: unbalance in one plane."""
    record = Balance()
    of_pistons = ("residual_reciprocating_g", "residual_second_order_g", "along_g")
    undecided = dict.fromkeys(of_pistons, "a rotor has no pistons")
    both = {ALONG, ACROSS} <= set(split.sought)
    part = 0.5 if both else 1.0
    shares = {ALONG: 1e3 * part, ACROSS: 1e3j * part}
    record = _with_size(record, "residual_rotating_gmm", "angle_deg", split, shares)
    if both:
        record = _with_size(record, "reverse_gmm", "reverse_angle_deg", split, shares | {ACROSS: -shares[ACROSS]})
    else:
        undecided["reverse_gmm"] = "one direction alone tells no sense of rotation: all is taken to turn with the shaft"
    if record.angle_deg is None:
        undecided["angle_deg"] = NO_ANGLE
    return replace(record, not_decided=undecided)
