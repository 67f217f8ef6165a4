"""Several cylinders: what textbooks say cancels does, and what remains has its textbook size."""

from typing import Any

import numpy as np
import pytest

from crankorder.engine.definition import Engine, load_engine
from crankorder.engine.forces import DIRECTIONS, crankcase_forces, crankcase_moments, orders_made
from crankorder.engine.harmonics import even_harmonics, orders_for
from crankorder.engine.slider_crank import piston_acceleration

X, Y, Z = (DIRECTIONS.index(name) for name in ("X", "Y", "Z"))
SPEED_RPM = 3000.0
RADIUS_M, ROD_M, MASS_KG, PITCH_M = 0.0449, 0.152, 1.216, 0.1
FIRST_N = MASS_KG * RADIUS_M * (SPEED_RPM * np.pi / 30) ** 2
A2, A4, A6 = even_harmonics(3, RADIUS_M / ROD_M)


def sizes(engine: Engine) -> tuple[np.ndarray, np.ndarray]:
    forces = np.abs(crankcase_forces(engine, SPEED_RPM, max_order=8)) / FIRST_N
    moments = np.abs(crankcase_moments(engine, SPEED_RPM, max_order=8)) / (FIRST_N * PITCH_M)
    return forces, moments


def row(crank_deg: list[float], **differences: Any) -> Engine:
    """Cylinders side by side, 100 mm apart, about the middle of the engine."""
    places = PITCH_M * (np.arange(len(crank_deg)) - (len(crank_deg) - 1) / 2)
    cylinders = [
        {"crank_deg": angle, "position_m": float(place)} for angle, place in zip(crank_deg, places, strict=True)
    ]
    lengths = {"crank_radius_m": RADIUS_M, "rod_length_m": ROD_M, "reciprocating_mass_kg": MASS_KG}
    return Engine.model_validate({**lengths, "cylinders": cylinders, **differences})


@pytest.mark.slow
def test_the_shipped_examples_are_the_textbook_arrangements() -> None:
    for name, cranks in {"inline-2": [0, 180], "inline-3": [0, 120, 240], "inline-4": [0, 180, 180, 0]}.items():
        textbook, example = row([float(crank) for crank in cranks]), load_engine(name)
        shipped = crankcase_moments(example, SPEED_RPM, max_order=8)
        assert np.abs(shipped - crankcase_moments(textbook, SPEED_RPM, max_order=8)).max() < 1e-10 * FIRST_N
        assert [cylinder.crank_deg for cylinder in example.cylinders] == cranks


def test_an_inline_four_leaves_nothing_but_its_even_orders_fourfold() -> None:
    forces, moments = sizes(load_engine("inline-4"))
    assert not forces[:, 1::2].any()
    assert forces[Z, 2:8:2] == pytest.approx(4 * np.array([A2, A4, A6]), rel=1e-12)
    assert moments[[X, Z]].max() < 1e-15
    assert orders_made(load_engine("inline-4"), share=1e-3, max_order=8) == (2.0, 4.0)


def test_a_counterweight_takes_the_whole_first_order_of_a_90_degree_v_twin() -> None:
    forces, _ = sizes(load_engine("v-twin"))
    assert forces[:, 1].max() < 1e-7  # the shipped counterweight is rounded to 0.1 g·mm
    without = load_engine("v-twin").model_copy(update={"rotating_unbalance_kg_m": 0.0})
    first = crankcase_forces(without, SPEED_RPM, max_order=8)[:, 1] / FIRST_N
    assert first[Z] == pytest.approx(1.0, rel=1e-12)
    assert first[X] == pytest.approx(-1j, rel=1e-12)  # constant size, turning with the crank
    assert forces[X, 2] == pytest.approx(np.sqrt(2) * A2, rel=1e-12)
    assert forces[Z, 2] < 1e-15
    assert forces[Z, 4] == pytest.approx(np.sqrt(2) * A4, rel=1e-12)


def test_the_sum_over_the_cylinders_is_the_sum_of_their_exact_forces() -> None:
    cylinders = [
        {"crank_deg": 20.0, "bank_deg": -30.0, "position_m": -0.1},
        {"crank_deg": 160.0, "bank_deg": 25.0, "position_m": 0.07},
    ]
    lengths = {"crank_radius_m": RADIUS_M, "rod_length_m": ROD_M, "reciprocating_mass_kg": MASS_KG, "offset_m": 0.008}
    engine = Engine.model_validate({**lengths, "cylinders": cylinders})
    max_order = orders_for(1e-15, engine.mechanism)
    angles = np.arange(90) / 90
    phasors = np.exp(2j * np.pi * np.arange(max_order + 1)[:, None] * angles)
    forces = (crankcase_forces(engine, SPEED_RPM, max_order=max_order)[..., None] * phasors).real.sum(axis=1)
    moments = (crankcase_moments(engine, SPEED_RPM, max_order=max_order)[..., None] * phasors).real.sum(axis=1)
    expected, rocking = np.zeros((3, 90)), np.zeros((3, 90))
    for cylinder in engine.cylinders:
        own = angles + (cylinder.crank_deg - cylinder.bank_deg) / 360
        size = FIRST_N / RADIUS_M * piston_acceleration(own, engine.mechanism)
        lean = np.radians(cylinder.bank_deg)
        force = np.stack([size * np.sin(lean), 0 * size, size * np.cos(lean)])
        expected += force
        rocking[X] += cylinder.position_m * force[Z]
        rocking[Z] -= cylinder.position_m * force[X]
    assert np.abs(forces - expected).max() < 1e-12 * FIRST_N
    assert np.abs(moments[[X, Z]] - rocking[[X, Z]]).max() < 1e-13 * FIRST_N


def test_shafts_take_the_second_order_of_an_inline_four() -> None:
    shafts = {"orders": [2], "unbalanced_mass_kg": 0.1}
    with_shafts, without = row([0.0, 180.0, 180.0, 0.0], shafts=shafts), row([0.0, 180.0, 180.0, 0.0])
    left = crankcase_forces(with_shafts, SPEED_RPM, max_order=6)[Z]
    whole = crankcase_forces(without, SPEED_RPM, max_order=6)[Z]
    assert left[2] == pytest.approx(whole[2] * 0.1 / MASS_KG, rel=1e-12)
    assert left[4] == whole[4]


def test_what_cancels_to_round_off_is_no_order_that_the_engine_makes() -> None:
    in_one_plane = [{"crank_deg": angle} for angle in (0.0, 120.0, 240.0)]
    engine = row([0.0]).model_copy(update={"cylinders": row([0.0] * 3, cylinders=in_one_plane).cylinders})
    assert orders_made(engine, share=1e-3, max_order=5) == ()
    assert orders_made(engine, share=1e-3, max_order=6) == (6.0,)
    assert orders_made(load_engine("inline-3"), share=1e-3, max_order=5) == (1.0, 2.0, 4.0)
