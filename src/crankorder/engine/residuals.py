"""What a balanced engine still shakes with: added masses, an offset cylinder, and classes of residual unbalance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from crankorder.engine.definition import EngineData, Positive
from crankorder.engine.harmonics import acceleration_harmonics
from crankorder.engine.polar import unbalance_force_n
from crankorder.engine.slider_crank import SliderCrank
from crankorder.errors import RequestError


class UnbalanceClass(EngineData):
    """A class of engines by the residual unbalance (g·mm) that they typically have."""

    name: Annotated[str, Field(min_length=1)]
    limit_g_mm: Positive


@dataclass(frozen=True, kw_only=True)
class OffsetEffects:
    """What an offset of the cylinder axis from the shafts' plane does to the first order.

    ``quadrature_share``: of the nominal first order, out of step with the crank: shafts timed to the crank leave it.
    ``rephasing_deg``: how far the shafts must lag behind the crank to cancel it. ``amplitude_ratio``: first order with
    offset over that without. ``third_over_fourth``: the odd orders that the offset makes, against the next even one.
    """

    quadrature_share: float
    rephasing_deg: float
    amplitude_ratio: float
    third_over_fourth: float


def leading_harmonics(count: int, crank_ratio: float) -> NDArray[np.float64]:
    """First terms of the series of A2, A4, …: λ, λ³/4, 9λ⁵/128, 5λ⁷/256, …, shape (count,).

    They are what textbooks and shafts built by them use, 2 % to 15 % below the exact harmonics at λ = 0.3.

    ``count``: how many, ≥ 0. ``crank_ratio``: λ = r/l, 0 < λ < 1. Raises RequestError outside these ranges.
    Source: truth sheet 1 and 2.1 (table 1 of Ruckle 2014 lacks the 9 in its formula, not in its numbers).
    """
    if not 0 < crank_ratio < 1 or count < 0:
        raise RequestError(
            "no such harmonics", found=f"count {count}, crank ratio {crank_ratio}", allowed="count ≥ 0, 0 < λ < 1"
        )
    k = np.arange(1, count + 1, dtype=np.float64)
    binomial = np.cumprod(np.where(k == 1, 0.5, (k - 1.5) / k))
    terms: NDArray[np.float64] = 8 * k**2 / crank_ratio * binomial * (crank_ratio / 2) ** (2 * k)
    return terms


def added_mass_force_n(
    added_mass_g: float, mechanism: SliderCrank, speed_rpm: ArrayLike, *, max_order: int
) -> NDArray[np.float64]:
    """Peak force (N) by order of a mass added to the piston and to no shaft, shape (…, max_order + 1).

    ``added_mass_g``: mass. ``mechanism``: lengths in metres. ``speed_rpm``: scalar or any shape (…).
    ``max_order``: ≥ 1; the first column is order 0.
    """
    share = np.abs(acceleration_harmonics(mechanism, max_order))
    unbalance = added_mass_g * mechanism.crank_radius_m * 1e3 * share
    return unbalance_force_n(unbalance, np.asarray(speed_rpm, dtype=np.float64)[..., None])


def offset_effects(mechanism: SliderCrank) -> OffsetEffects:
    """What the offset of ``mechanism`` does to the first order and to the third. Source: truth sheet 2.6."""
    harmonics = acceleration_harmonics(mechanism, 4)
    first = complex(harmonics[1])
    return OffsetEffects(
        quadrature_share=-first.imag,
        rephasing_deg=math.degrees(math.atan2(-first.imag, first.real)),
        amplitude_ratio=abs(first),
        third_over_fourth=float(abs(harmonics[3]) / abs(harmonics[4])),
    )


def offset_couple_n_m(unbalance_g_mm: ArrayLike, offset_mm: float, speed_rpm: ArrayLike) -> NDArray[np.float64]:
    """Couple (N·m) of a force along the cylinder and the shafts that cancel it, their lines an offset apart.

    ``unbalance_g_mm``: amplitude over ω². ``offset_mm``: distance of the two lines. ``speed_rpm``: crank speed. The
    shapes must broadcast. Source: Ruckle 2014, section 3.1.2 and figure 14; truth sheet 2.6.
    """
    return unbalance_force_n(unbalance_g_mm, speed_rpm) * (1e-3 * offset_mm)


def unbalance_class(residual_g_mm: float, classes: Sequence[UnbalanceClass]) -> str | None:
    """Name of the strictest class whose typical unbalance ``residual_g_mm`` does not exceed; None beyond all.

    ``classes``: in any sequence.
    """
    fitting = [one for one in classes if abs(residual_g_mm) <= one.limit_g_mm]
    return min(fitting, key=lambda one: one.limit_g_mm).name if fitting else None
