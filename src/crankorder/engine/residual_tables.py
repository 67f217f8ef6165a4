"""Tables of a balance sheet beyond strategies and shafts: crankshaft, rod, added mass, offset, reverse cranks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from crankorder.engine.balance_data import BalancedEngine, reduced_masses
from crankorder.engine.crankshaft import couple_n_m, crankshaft_sums, two_plane_correction
from crankorder.engine.harmonics import acceleration_harmonics
from crankorder.engine.polar import unbalance_force_n
from crankorder.engine.residuals import offset_couple_n_m, offset_effects, unbalance_class
from crankorder.engine.reverse_cranks import (
    GearTrain,
    Series,
    gear_speed_ratios,
    residual_along,
    tolerance_study,
    weight_moments,
    weighted_wheels,
    wheels_couple,
    wheels_force,
)
from crankorder.engine.rod_split import cut_consequences, two_mass_inertia_g_mm2
from crankorder.engine.slider_crank import SliderCrank

FULL_TURN_REV = np.arange(720) / 720
"""Crank angles of a full turn; the quarter turns, where residuals peak, are among them."""


def speed_key(speed_rpm: float) -> str:
    """``speed_rpm`` as tables and sentences name it: every digit that a user can have meant, no zeros at the end."""
    return f"{speed_rpm:.15g}"


def newton(unbalance_g_mm: float, speed_rpm: float) -> float:
    """Force (N) of ``unbalance_g_mm``, an amplitude over ω², at ``speed_rpm`` of the crank."""
    return float(unbalance_force_n(unbalance_g_mm, speed_rpm))


def newton_by_speed(unbalance_g_mm: float, speeds: Sequence[float]) -> dict[str, float]:
    """Force (N) of ``unbalance_g_mm`` at each of the ``speeds`` (rpm)."""
    return {speed_key(speed): newton(unbalance_g_mm, speed) for speed in speeds}


def harmonic_shares(mechanism: SliderCrank, max_order: int) -> dict[str, float]:
    """Amplitudes of orders 2 … ``max_order`` of the piston of ``mechanism`` over crank radius and ω²: A2, A4, …"""
    share = np.abs(acceleration_harmonics(mechanism, max_order))
    return {str(k): float(share[k]) for k in range(2, max_order + 1) if share[k]}


def crankshaft_table(subject: BalancedEngine, speeds: Sequence[float]) -> dict[str, Any] | None:
    """Static and dynamic sums, rocking couple at ``speeds`` (rpm), and what the counterweights of ``subject`` need."""
    data = subject.balance.crankshaft
    if data is None:
        return None
    sums = crankshaft_sums(data.sections)
    correction = two_plane_correction(sums, data.planes_mm)
    by_name = {section.name: section for section in data.sections}
    planes = []
    for name, added in zip(data.counterweights, correction, strict=True):
        section = by_name[name]
        has = section.mass_kg * complex(section.x_mm, section.y_mm)
        needs = has + added
        planes.append(
            {
                "name": name,
                "z_mm": section.z_mm,
                "has_kg_mm": _xy(has),
                "correction_kg_mm": _xy(added),
                "needs_kg_mm": _xy(needs),
            }
        )
    return {
        "static_kg_mm": _xy(sums.static_kg_mm),
        "dynamic_kg_mm2": _xy(sums.dynamic_kg_mm2),
        "couple_Nm_at_rpm": {speed_key(speed): float(couple_n_m(sums.dynamic_kg_mm2, speed)) for speed in speeds},
        "planes": planes,
        "overbalance_kg_mm": None if data.overbalance_kg_mm is None else list(data.overbalance_kg_mm),
    }


def _xy(value: complex) -> dict[str, float]:
    return {"x": value.real, "y": value.imag}


def rod_split_table(subject: BalancedEngine, speeds: Sequence[float]) -> dict[str, Any] | None:
    """What the cut and the scale say of the rod of ``subject``, and the forces (N at ``speeds``, rpm) of the cut."""
    splits = subject.balance.rod_split
    if splits is None:
        return None
    left = cut_consequences(splits, subject.engine.mechanism)
    length_mm = subject.engine.rod_length_m * 1e3
    return {
        "cut_centroid_fraction": splits.cut.centroid_fraction,
        "scale_centroid_fraction": splits.scale.centroid_fraction,
        "centroid_shift_mm": left.centroid_shift_mm,
        "two_mass_inertia_kg_m2": two_mass_inertia_g_mm2(splits.scale, length_mm) * 1e-9,
        "rotating_deficit_g": left.rotating_deficit_g,
        "reciprocating_excess_g": left.reciprocating_excess_g,
        "residual_x_g_mm": {"1": left.x_first_g_mm, "2": left.x_second_g_mm},
        "residual_y_g_mm": {"1": left.y_first_g_mm},
        "residual_x_second_n": newton_by_speed(left.x_second_g_mm, speeds),
        "residual_y_first_n": newton_by_speed(left.y_first_g_mm, speeds),
    }


def added_mass_table(subject: BalancedEngine, max_order: int, speeds: Sequence[float]) -> dict[str, Any] | None:
    """Forces by order 1 … ``max_order`` of the mass added to the piston of ``subject``, at ``speeds`` (rpm)."""
    grams = subject.balance.added_mass_g
    if grams is None:
        return None
    mechanism = subject.engine.mechanism
    share = np.abs(acceleration_harmonics(mechanism, max_order))
    unbalance = {str(k): float(grams * mechanism.crank_radius_m * 1e3 * share[k]) for k in np.flatnonzero(share)}
    return {
        "mass_g": grams,
        "residual_x_g_mm": unbalance,
        "residual_n": {
            speed_key(speed): {order: newton(amount, speed) for order, amount in unbalance.items()} for speed in speeds
        },
        "class": unbalance_class(unbalance["1"], subject.balance.residual_classes),
    }


def offset_table(subject: BalancedEngine, speeds: Sequence[float]) -> dict[str, Any] | None:
    """Effects of the offset that ``subject`` asks to be studied, or else of its own, at ``speeds`` (rpm)."""
    masses = reduced_masses(subject)
    engine = subject.engine
    offset_mm = subject.balance.offset_mm or abs(engine.offset_m) * 1e3
    if not offset_mm:
        return None
    mechanism = SliderCrank(
        crank_radius_m=engine.crank_radius_m, rod_length_m=engine.rod_length_m, offset_m=offset_mm * 1e-3
    )
    effects = offset_effects(mechanism)
    first = masses.crank_radius_mm * masses.reciprocating_g
    quadrature = first * effects.quadrature_share
    straight = SliderCrank(crank_radius_m=engine.crank_radius_m, rod_length_m=engine.rod_length_m)
    lines = {"1": first, "2": float(first * abs(acceleration_harmonics(straight, 2)[2]))}
    return {
        "offset_mm": offset_mm,
        "harmonics": harmonic_shares(mechanism, 8),
        "amplitude_ratio": effects.amplitude_ratio,
        "rephasing_deg": effects.rephasing_deg,
        "third_over_fourth": effects.third_over_fourth,
        "quadrature_x_g_mm": quadrature,
        "quadrature_n": newton_by_speed(quadrature, speeds),
        "couple_Nm_at_rpm": {
            speed_key(speed): {
                order: float(offset_couple_n_m(amount, offset_mm, speed)) for order, amount in lines.items()
            }
            for speed in speeds
        },
    }


def reverse_crank_table(subject: BalancedEngine, speeds: Sequence[float]) -> dict[str, Any] | None:
    """Weights of the direct and reverse cranks of ``subject``, and what they leave at ``speeds`` (rpm)."""
    masses = reduced_masses(subject)
    train = subject.balance.gears
    if train is None:
        return None
    residual, moments = {}, {}
    both_series: tuple[Series, ...] = ("leading", "exact")
    for series in both_series:
        wheels = weighted_wheels(train, masses, second=series)
        residual[series] = float(np.abs(residual_along(masses, wheels, FULL_TURN_REV)).max())
        moments[series] = {f"{k:g}": both for k, both in weight_moments(masses, second=series).items()}
    wheels = weighted_wheels(train, masses)
    radius = {gear.name: gear.weight_radius_mm for gear in train.gears}
    return {
        "speed_ratios": gear_speed_ratios(train),
        "pair_moments_g_mm": moments,
        "weights_g": {name: wheel.unbalance_g_mm / (radius[name] or math.inf) for name, wheel in wheels.items()},
        "couple_g_mm2": float(sum(abs(couple) for couple in wheels_couple(wheels).values())),
        "transverse_g_mm": float(np.abs(wheels_force(wheels, FULL_TURN_REV).imag).max()),
        "residual_x_g_mm": residual,
        "residual_x_n": {series: newton_by_speed(amount, speeds) for series, amount in residual.items()},
        "tolerances": _tolerances(subject, train),
    }


def _tolerances(subject: BalancedEngine, train: GearTrain) -> dict[str, Any] | None:
    if train.tolerances is None:
        return None
    study = tolerance_study(train, reduced_masses(subject), train.tolerances)
    tables = {"along_g_mm": study.along_g_mm, "across_g_mm": study.across_g_mm, "couple_g_mm2": study.couple_g_mm2}
    quantiles = {
        name: {
            f"{order:g}": {"median": float(middle), "95 %": float(high)}
            for order, middle, high in zip(study.orders, *np.quantile(table, [0.5, 0.95], axis=0), strict=True)
        }
        for name, table in tables.items()
    }
    return {"errors": train.tolerances.model_dump(), **quantiles}
