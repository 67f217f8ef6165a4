"""The hinge at the strut: reduced inertia, work, and an independent Newton–Euler solution."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from crankorder.engine.elastic_hinge import (
    PinHinge,
    branch_quadrature,
    hinge_moment,
    reduced_inertia,
    side_force,
    strut_hinge_moment,
    strut_hinge_work,
)
from crankorder.engine.hinged_crank import HingedCrank, load_hinged_engine, potential_torque

ENGINE = load_hinged_engine("elastic-hinge")
CURVE = ENGINE.curve
THIRTIES = np.arange(12) / 12
RPM = 30 / np.pi
HINGES: tuple[PinHinge, ...] = ("full", "potential", "printed")


def newton_euler(angle: float, crank: HingedCrank, omega: float, hinge_nm: float, torque_nm: float) -> tuple:
    """Side force and strut moment from the eight equations of crank, rod and piston as free bodies.

    Everything is written out from the positions: nothing of the package's kinematics is used. ``angle``: rad, no dead
    centre (the gas force itself is formed here). Unknown: forces at O, A and B, side force, strut moment.
    """
    radius, rod, ratio = crank.crank_radius_m, crank.rod_length_m, crank.crank_radius_m / crank.rod_length_m
    g = crank.gravity_m_s2
    c, s = np.cos(angle), np.sin(angle)
    psi = np.arcsin(ratio * s)
    rate = ratio * c / np.cos(psi)
    rate_rate = (np.sin(psi) * rate**2 - ratio * s) / np.cos(psi)

    def on_rod(distance: float) -> tuple[np.ndarray, np.ndarray]:
        """Place from the crank pin and acceleration of a point of the rod's line."""
        place = distance * np.array([np.cos(psi), -np.sin(psi)])
        along = -radius * c - distance * (np.cos(psi) * rate**2 + np.sin(psi) * rate_rate)
        across = -radius * s + distance * (np.sin(psi) * rate**2 - np.cos(psi) * rate_rate)
        return place, omega**2 * np.array([along, across])

    def cross(place: np.ndarray, force: np.ndarray) -> float:
        return float(place[0] * force[1] - place[1] * force[0])

    pin = radius * np.array([c, s])
    piston_place, piston_acceleration = on_rod(rod)
    bodies = [
        (crank.rod_weight_n, *on_rod(crank.pin_to_rod_centre_m)),
        (crank.rod_counterweight_n, *on_rod(-crank.rod_counterweight_radius_m)),
    ]
    crank_bodies = [
        (crank.crank_weight_n, crank.crank_centre_radius_m * np.array([c, s])),
        (crank.crank_counterweight_n, -crank.crank_counterweight_radius_m * np.array([c, s])),
    ]
    # F dx = M dφ, positive towards the crankshaft
    gas = torque_nm / (radius * s * (1 + rate))
    matrix, right = np.zeros((8, 8)), np.zeros(8)
    # crank: O − A + weights = Σ m a; about O: M1 − hinge − pin × A + weights = 0 at constant speed
    matrix[0, [0, 2]] = matrix[1, [1, 3]] = 1, -1
    matrix[2, [2, 3, 7]] = pin[1], -pin[0], 1
    right[2] = hinge_nm
    for weight, place in crank_bodies:
        right[0:2] += weight / g * -(omega**2) * place + np.array([0, weight])
        right[2] += place[0] * weight
    # rod with its counterweight: A + B + weights = Σ m a; about A with the hinge's moment
    matrix[3, [2, 4]] = matrix[4, [3, 5]] = 1, 1
    matrix[5, [4, 5]] = -piston_place[1], piston_place[0]
    right[5] = -crank.rod_inertia_kg_m2 * rate_rate * omega**2 - hinge_nm
    for weight, place, acceleration in bodies:
        right[3:5] += weight / g * acceleration + np.array([0, weight])
        right[5] += cross(place, weight / g * acceleration) + place[0] * weight
    # piston: −B + gas + side force + weight = m a
    matrix[6, 4], matrix[7, [5, 6]] = -1, (-1, 1)
    right[6] = crank.piston_weight_n / g * piston_acceleration[0] + gas
    right[7] = crank.piston_weight_n
    solution = np.linalg.solve(matrix, right)
    return float(solution[6]), float(solution[7])


@pytest.mark.parametrize("pin_hinge", HINGES)
@pytest.mark.parametrize("name", sorted(ENGINE.cranks))
def test_newtons_laws_give_the_same_side_force_and_strut_moment(name: str, pin_hinge: PinHinge) -> None:
    crank = ENGINE.cranks[name]
    angles = np.array([0.011, 0.07, 0.19, 0.25, 0.31, 0.44, 0.487, 0.52, 0.61, 0.75, 0.83, 0.97])
    for omega in (0.0, 100.0, 300.0):
        options = {"speed_rpm": omega * RPM, "pin_hinge": pin_hinge}
        hinge = hinge_moment(angles, crank, CURVE, **options)
        torque = potential_torque(angles, CURVE)
        solved = [
            newton_euler(2 * np.pi * turn, crank, omega, moment, gas)
            for turn, moment, gas in zip(angles, hinge, torque, strict=True)
        ]
        side, strut = np.array(solved).T
        scale = 1 + np.abs(hinge).max()
        ours = side_force(angles, crank, CURVE, pin_hinge=pin_hinge)
        np.testing.assert_allclose(ours, side, rtol=1e-9, atol=1e-13 * scale / crank.rod_length_m)
        ours = strut_hinge_moment(angles, crank, CURVE, **options)
        np.testing.assert_allclose(ours, strut, rtol=1e-9, atol=1e-13 * scale)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fig5_a", "fig5_bcd"])
def test_the_reduced_inertia_is_the_true_one(shared_truth: dict[str, Any], name: str) -> None:
    numbers = shared_truth["seed003"]["M1"][name]
    crank = ENGINE.cranks[name]
    expected = [float(value) for value in numbers["reference_Igiv_exact"].values()]
    np.testing.assert_allclose(reduced_inertia(THIRTIES, crank), expected, rtol=1e-14)
    grid = reduced_inertia(np.arange(360) / 360, crank)  # the grid of the truth sheet
    assert [grid.min(), grid.max()] == pytest.approx(numbers["Igiv_exact_min_max"], rel=1e-14)
    at_90_deg = numbers["Igiv_at_90deg"]
    without = replace(crank, rod_counterweight_n=0.0)
    share = float(reduced_inertia(0.25, crank) - reduced_inertia(0.25, without))
    assert share == pytest.approx(float(at_90_deg["kinetic share of P4 exact m4R^2"]), rel=1e-14)
    # the printed I_giv gives the counterweight of the rod no energy there
    assert float(reduced_inertia(0.25, crank)) == pytest.approx(float(at_90_deg["exact"]), rel=1e-14)
    assert abs(float(reduced_inertia(0.25, crank)) / float(at_90_deg["printed"]) - 1) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("pin_hinge", HINGES)
@pytest.mark.parametrize("name", sorted(ENGINE.cranks))
def test_the_work_of_the_strut_hinge_is_the_closed_form_at_every_speed(name: str, pin_hinge: PinHinge) -> None:
    crank = ENGINE.cranks[name]
    angle_rev, weight = branch_quadrature(crank, CURVE)
    for omega in (0.0, 500.0):
        moment = strut_hinge_moment(angle_rev, crank, CURVE, speed_rpm=omega * RPM, pin_hinge=pin_hinge)
        work = 2 * np.pi * float(weight @ moment)
        closed = strut_hinge_work(crank, CURVE, pin_hinge=pin_hinge)
        assert work == pytest.approx(closed, abs=1e-13 * np.abs(moment).max() + 1e-11)
