"""Residual masses as the findings tell them: split by direction and sense of rotation, each with its 95 % interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from crankorder.engine.definition import Engine
from crankorder.engine.machine_parts import AddedMass
from crankorder.findings import Balance
from crankorder.identify.intervals import half_width
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


@dataclass(frozen=True, eq=False)
class Split:
    """Complex masses (kg at the crank radius) behind orders 1 and 2, with what they multiply.

    ``mass_kg`` (mass,); ``covariance`` (2 mass, 2 mass) of real and imaginary parts in turn, with ``freedom``;
    ``sought``: (order, axis) of each; the force of a mass is mass · ``per_kg`` · r ω².
    """

    mass_kg: Complexes
    covariance: Floats
    freedom: float
    sought: tuple[tuple[int, str], ...]
    per_kg: Complexes

    def combined(self, shares: Complexes) -> tuple[complex, Floats]:
        """The complex sum Σ ``shares`` (mass,) · mass and the covariance (2, 2) of its parts."""
        turn = np.array([[[s.real, -s.imag], [s.imag, s.real]] for s in shares]).transpose(1, 0, 2).reshape(2, -1)
        return complex(shares @ self.mass_kg), turn @ self.covariance @ turn.T


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
    at = {place: number for number, place in enumerate(split.sought)}
    record = _along(record, split, at)
    if (1, "X") in at and (1, "Z") in at:
        record = _both_ways(record, split, at, engine, undecided)
    else:
        record = _one_way(record, split, at, engine, undecided)
    if (2, "Z") in at:
        record = _with_grams(record, "residual_second_order_g", split, *_in_kg(split, at[(2, "Z")], 1.0))
    else:
        undecided["residual_second_order_g"] = "the path at order 2 is not identified"
        if 2 not in engine.shafts.every_order:
            whole = "no shafts take the second order away: the whole reciprocating mass makes it"
            undecided["residual_second_order_g"] = whole
    return replace(record, not_decided=undecided)


def _with_grams(record: Balance, key: str, split: Split, mass_kg: complex, covariance: Floats) -> Balance:
    """``record`` with its field ``key`` at the real part of ``mass_kg`` in grams, by the ``covariance`` (2, 2)."""
    half = 1e3 * half_width(split.freedom) * float(np.sqrt(covariance[0, 0]))
    return with_interval(record, key, 1e3 * mass_kg.real, half)


def _in_kg(split: Split, number: int, share: complex) -> tuple[complex, Floats]:
    shares = np.zeros(len(split.mass_kg), dtype=np.complex128)
    shares[number] = share
    return split.combined(shares)


def _along(record: Balance, split: Split, at: dict[tuple[int, str], int]) -> Balance:
    if (1, "Z") not in at:
        return record
    number = at[(1, "Z")]
    value, covariance = _in_kg(split, number, abs(split.per_kg[number]))
    record = _with_grams(record, "along_g", split, value, covariance)
    half = 1e3 * half_width(split.freedom) * float(np.sqrt(covariance[1, 1]))
    return with_interval(record, "along_quadrature_g", 1e3 * value.imag, half)


def _one_way(
    record: Balance, split: Split, at: dict[tuple[int, str], int], engine: Engine, undecided: dict[str, str]
) -> Balance:
    """Forces along the cylinder alone: both orders tell the reciprocating mass where they ask for the same one."""
    across = ("across_g", "forward_gmm", "reverse_gmm", "residual_rotating_gmm", "angle_deg")
    undecided |= dict.fromkeys(across, NO_ACROSS)
    first, second = at.get((1, "Z")), at.get((2, "Z"))
    alike = "rotating and reciprocating mass act alike along the cylinder at order 1"
    if first is None or second is None:
        undecided["residual_reciprocating_g"] = f"{alike}, and no residual of the second order tells them apart"
        return record
    if len(engine.cylinders) > 1:
        undecided["residual_reciprocating_g"] = f"{alike}, and of several cylinders none is known to be the one"
        return record
    value, covariance, apart = _common(split, first, second)
    if apart > AGREE_CHI_SQUARE:
        undecided["residual_reciprocating_g"] = (
            f"orders 1 and 2 ask for different masses, {1e3 * abs(split.mass_kg[first]):.3g} and "
            f"{1e3 * abs(split.mass_kg[second]):.3g} g: rotating unbalance, or shafts that miss one of the orders"
        )
        return record
    return _with_grams(record, "residual_reciprocating_g", split, value, covariance)


def _common(split: Split, first: int, second: int) -> tuple[complex, Floats, float]:
    """The one mass that two masses tell best (generalised least squares), its covariance, and χ² of their difference.

    χ² has two degrees of freedom.
    """
    picked = [2 * first, 2 * first + 1, 2 * second, 2 * second + 1]
    both = split.mass_kg[[first, second]]
    values = np.stack([both.real, both.imag], axis=1).ravel()
    weight = np.linalg.pinv(split.covariance[np.ix_(picked, picked)])
    design = np.concatenate([np.eye(2), np.eye(2)])
    covariance = np.linalg.pinv(design.T @ weight @ design)
    common = covariance @ design.T @ weight @ values
    left = values - design @ common
    return complex(common[0], common[1]), covariance, float(left @ weight @ left)


def _both_ways(
    record: Balance, split: Split, at: dict[tuple[int, str], int], engine: Engine, undecided: dict[str, str]
) -> Balance:
    """Forces along and across: forward and reverse, and for cylinders along Z rotating and reciprocating."""
    z, x = at[(1, "Z")], at[(1, "X")]
    g_mm = 1e6 * engine.crank_radius_m
    shares = np.zeros(len(split.mass_kg), dtype=np.complex128)

    def sum_of(along: complex, across: complex) -> tuple[complex, Floats]:
        shares[z], shares[x] = along * split.per_kg[z], across * split.per_kg[x]
        return split.combined(shares)

    freedom = split.freedom
    across, covariance = sum_of(0, 1)
    record = size_and_angle(record, "across_g", "", 1e3 * across, 1e6 * covariance, freedom=freedom)
    for name, sign in (("forward", 1), ("reverse", -1)):
        value, covariance = sum_of(0.5 * g_mm, 0.5j * sign * g_mm)
        record = size_and_angle(record, f"{name}_gmm", f"{name}_angle_deg", value, covariance, freedom=freedom)
    if any(cylinder.bank_deg for cylinder in engine.cylinders):
        for key in ("residual_rotating_gmm", "residual_reciprocating_g", "angle_deg"):
            undecided[key] = "pistons of leaning cylinders act across too: forward and reverse parts tell all there is"
    else:
        value, covariance = sum_of(0, 1j * g_mm)
        record = size_and_angle(record, "residual_rotating_gmm", "angle_deg", value, covariance, freedom=freedom)
        piston = np.conj(split.per_kg[z]) / abs(split.per_kg[z]) ** 2
        value, covariance = sum_of(piston, -1j * piston)
        record = _with_grams(record, "residual_reciprocating_g", split, value, covariance)
        if abs(value.imag) > half_width(freedom) * float(np.sqrt(covariance[1, 1])):
            undecided["reverse_angle_deg"] = "part of the reverse force is out of step with the piston: mistimed shafts"
    for part, way in (("residual_rotating", ""), ("forward", "forward_"), ("reverse", "reverse_")):
        if getattr(record, f"{part}_gmm") is not None and getattr(record, f"{way}angle_deg") is None:
            undecided[f"{way}angle_deg"] = NO_ANGLE
    return record


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
    at = {place: number for number, place in enumerate(split.sought)}
    shares = np.zeros(len(split.mass_kg), dtype=np.complex128)
    both = (1, "X") in at and (1, "Z") in at
    for axis, turn in (("Z", 1.0), ("X", 1.0j)):
        if (1, axis) in at:
            shares[at[(1, axis)]] = 1e3 * turn * (0.5 if both else 1.0)
    value, covariance = split.combined(shares)
    record = size_and_angle(record, "residual_rotating_gmm", "angle_deg", value, covariance, freedom=split.freedom)
    if both:
        shares[at[(1, "X")]] *= -1
        value, covariance = split.combined(shares)
        record = size_and_angle(record, "reverse_gmm", "reverse_angle_deg", value, covariance, freedom=split.freedom)
    else:
        undecided["reverse_gmm"] = "one direction alone tells no sense of rotation: all is taken to turn with the shaft"
    if record.angle_deg is None:
        undecided["angle_deg"] = NO_ANGLE
    return replace(record, not_decided=undecided)
