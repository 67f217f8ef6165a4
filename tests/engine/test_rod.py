"""The rod in two masses, and what two masses miss, against the truth sheet."""

from typing import Any

import numpy as np
import pytest

from crankorder.engine.definition import Engine
from crankorder.engine.rod import rod_couple, rod_couple_by_order, two_masses

LENGTH_M, MASS_KG = 0.152, 1.6738
SCALE_CENTRE_M = 0.4114 / MASS_KG * LENGTH_M


def engine(**rod: float) -> Engine:
    data = {"crank_radius_m": 0.0449, "rod_length_m": LENGTH_M, "reciprocating_mass_kg": 4.304}
    return Engine.model_validate({**data, "rod": {"mass_kg": MASS_KG, "centre_from_big_end_m": SCALE_CENTRE_M, **rod}})


def test_the_weighed_rod_splits_as_weighed() -> None:
    masses = two_masses(engine())
    assert masses.big_end_kg == pytest.approx(1.2624, rel=1e-14)
    assert masses.small_end_kg == pytest.approx(0.4114, rel=1e-14)
    assert masses.missing_inertia_kg_m2 == 0


def test_two_masses_have_the_inertia_of_the_truth_sheet(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["rod_inertia"]
    of_two = known["two_mass_J_about_cg_kg_m2 (m a b, scale split, l=152)"]
    assert 1 - two_masses(engine(inertia_kg_m2=1.0)).missing_inertia_kg_m2 == pytest.approx(of_two, rel=1e-12)
    uniform = known["uniform_rod_m_l2/12"]
    assert uniform == pytest.approx(MASS_KG * LENGTH_M**2 / 12, rel=1e-14)
    missing = two_masses(engine(inertia_kg_m2=uniform)).missing_inertia_kg_m2
    assert missing == pytest.approx(uniform - of_two, rel=1e-12)


def test_the_couple_has_the_sine_harmonics_of_the_truth_sheet(truth: dict[str, Any]) -> None:
    model = engine(inertia_kg_m2=0.0032226229333333334)
    missing = two_masses(model).missing_inertia_kg_m2
    omega_squared = (2000 * np.pi / 30) ** 2
    couple = rod_couple_by_order(model, 2000.0, max_order=8)
    for order, known in truth["seed001"]["rod_inertia"]["sine_harmonics_at_44.9/152"].items():
        assert couple[int(order)] == pytest.approx(-1j * missing * omega_squared * float(known), rel=1e-12)
    angles = np.arange(64) / 64
    every = rod_couple_by_order(model, 2000.0, max_order=40)
    summed = (every[:, None] * np.exp(2j * np.pi * np.arange(41)[:, None] * angles)).real.sum(axis=0)
    assert np.abs(summed - rod_couple(model, angles, 2000.0)).max() < 1e-13 * np.abs(summed).max()


def test_a_rod_of_two_masses_misses_nothing() -> None:
    assert not rod_couple(engine(), np.linspace(0, 1, 7), 3000.0).any()
    bare = Engine(crank_radius_m=0.0449, rod_length_m=LENGTH_M, reciprocating_mass_kg=1.0)
    assert two_masses(bare).big_end_kg == two_masses(bare).small_end_kg == 0
