"""The torque curve of document 003: exact through its nodes, to round-off."""

from fractions import Fraction

import numpy as np
import pytest
from pydantic import ValidationError

from crankorder.engine import hinged_crank

CURVE = hinged_crank.load_hinged_engine("elastic-hinge").curve


def exact_torque(angle_rev):
    """The polynomial through the nodes in exact arithmetic, by Lagrange's formula."""
    angle = Fraction(float(angle_rev)) * 360
    branch = CURVE.branches[0] if angle < 180 else CURVE.branches[1]
    total = Fraction(0)
    for node, torque in zip(branch.angle_deg, branch.torque_nm, strict=True):
        term = Fraction(torque)
        for other in branch.angle_deg:
            if other != node:
                term *= (angle - Fraction(other)) / (Fraction(node) - Fraction(other))
        total += term
    return total


def test_the_torque_is_within_1e_12_of_exact_arithmetic_in_double_precision():
    grid = np.linspace(0, 1, 145)
    pairs = zip(hinged_crank.crank_torque(grid, CURVE), grid, strict=True)
    assert max(abs(float(Fraction(float(torque)) - exact_torque(angle))) for torque, angle in pairs) < 1e-12
    assert hinged_crank.crank_torque([0, 0.5, 1, -3], CURVE).tolist() == [0, 0, 0, 0]


def test_mean_and_work_are_the_exact_ones(shared_truth):
    expected = shared_truth["seed003"]
    assert pytest.approx(float(expected["mean_torque_Nm"]["decimal"]), rel=1e-15) == CURVE.mean_nm
    assert pytest.approx(float(expected["work_per_rev_J"]), rel=1e-14) == CURVE.work_per_rev_j
    total = sum((branch.integral_nm_deg for branch in CURVE.branches), Fraction(0))
    assert total / 360 == Fraction(expected["mean_torque_Nm"]["rational"])
    for branch, name in zip(CURVE.branches, ("integral_0_180_Nm_deg", "integral_180_360_Nm_deg"), strict=True):
        assert pytest.approx(float(expected[name]), rel=1e-15) == float(branch.integral_nm_deg)


def test_harmonics_are_the_true_ones_up_to_order_64(shared_truth):
    listed = shared_truth["seed003"]["Mcr_Fourier_Nm"]
    harmonics = hinged_crank.torque_harmonics([int(order) for order in listed], CURVE)
    np.testing.assert_allclose(harmonics.real, [float(line["cos"]) for line in listed.values()], rtol=1e-12)
    np.testing.assert_allclose(-harmonics.imag, [float(line["sin"]) for line in listed.values()], rtol=1e-12)
    np.testing.assert_allclose(np.abs(harmonics), [float(line["amp"]) for line in listed.values()], rtol=1e-12)


def test_the_potential_torque_does_no_work_in_a_revolution():
    nodes, weights = np.polynomial.legendre.leggauss(16)
    halves = np.concatenate([0.25 + 0.25 * nodes, 0.75 + 0.25 * nodes])
    assert abs(np.tile(weights, 2) @ hinged_crank.potential_torque(halves, CURVE)) < 1e-11


def test_impossible_nodes_are_refused():
    for angles, torques, what in (
        ((0.0, 180.0), (1.0,), "one torque for each"), ((0.0,), (1.0,), "two or more"),
        ((0.0, 200.0, 100.0, 360.0), (0.0, 1.0, 1.0, 0.0), "rising"), ((0.0, 360.0), (0.0, float("nan")), "finite"),
    ):  # fmt: skip
        with pytest.raises(ValidationError, match=what):
            hinged_crank.TorqueBranch(angle_deg=angles, torque_nm=torques)
