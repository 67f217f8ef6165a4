"""The torque curve of document 003: exact through its nodes, to round-off in both precisions."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from crankorder.engine.hinged_crank import (
    CrankTorque,
    TorqueBranch,
    crank_torque,
    load_hinged_engine,
    potential_torque,
    torque_extrema,
    torque_harmonics,
)
from crankorder.errors import RequestError

CURVE = load_hinged_engine("elastic-hinge").curve
GRID = np.linspace(0, 1, 3601)

# Equation (1) as printed, in powers of the angle in degrees: the first sum, and the one that Sign[180 − φ] multiplies
PLAIN = [
    "-2.693510959090909e7", "1009131.066530486", "-16831.236170949003", "164.56930773216035", "-1.0445902415421795",
    "0.004497285554988163", "-0.000013297457442994316", "2.665200570792428e-8", "-3.463864860887725e-11",
    "2.636647972125913e-14", "-8.947485203612654e-18",
]  # fmt: skip
SIGNED = [
    "2.693510959090909e7", "-1008993.066791191", "16823.278538256654", "-164.3809582389641", "1.0422601817406472",
    "-0.0044809411801945455", "0.000013232168767022518", "-2.651459239985029e-8", "3.452203947414538e-11",
    "-2.636647972125913e-14", "8.947485203612654e-18",
]  # fmt: skip


def exact_torque(angle_rev: float) -> Fraction:
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


def error_nm(torque: np.ndarray, angle_rev: np.ndarray) -> float:
    """Largest difference from exact arithmetic."""
    pairs = zip(torque, angle_rev, strict=True)
    return max(abs(float(Fraction(float(value)) - exact_torque(angle))) for value, angle in pairs)


def test_the_torque_is_within_1e_12_of_exact_arithmetic_in_double_precision() -> None:
    assert error_nm(crank_torque(GRID, CURVE), GRID) < 1e-12


def test_the_torque_is_within_1e_3_of_exact_arithmetic_in_single_precision() -> None:
    single = GRID.astype(np.float32)
    torque = crank_torque(single, CURVE)
    assert torque.dtype == np.float32
    assert error_nm(torque, single) < 1e-3


def test_the_torque_has_the_true_values_at_every_tenth_degree(truth: dict[str, Any]) -> None:
    reference = {int(angle): float(torque) for angle, torque in truth["seed003"]["Mcr_reference_Nm"].items()}
    torque = crank_torque(np.array(list(reference)) / 360, CURVE)
    np.testing.assert_allclose(torque, list(reference.values()), rtol=0, atol=2e-12)


def test_the_torque_passes_through_every_node_and_is_zero_at_the_dead_centres() -> None:
    for branch in CURVE.branches:
        torque = crank_torque(np.array(branch.angle_deg) / 360, CURVE)
        np.testing.assert_allclose(torque, branch.torque_nm, rtol=0, atol=1e-12)
    assert crank_torque([0, 0.5, 1, -3], CURVE).tolist() == [0, 0, 0, 0]


def test_whole_revolutions_change_nothing_and_shapes_are_kept() -> None:
    angles = np.arange(12).reshape(3, 4) / 16
    np.testing.assert_array_equal(crank_torque(angles + 5, CURVE), crank_torque(angles, CURVE))
    np.testing.assert_array_equal(crank_torque(angles - 5, CURVE), crank_torque(angles, CURVE))
    assert crank_torque(0.25, CURVE).shape == ()
    assert float(crank_torque(0.25, CURVE)) == 280


def test_the_centred_coefficients_are_the_exact_fractions(truth: dict[str, Any]) -> None:
    listed = truth["seed003"]["scaled_coefficients"]
    for branch, name in zip(CURVE.branches, ("p in t=(deg-90)/90", "q in t=(deg-270)/90"), strict=True):
        assert branch.coefficients == tuple(Fraction(value) for value in listed[name])


def test_the_printed_coefficients_are_those_of_the_nodes() -> None:
    plain, signed = ([Fraction(value) for value in printed] for printed in (PLAIN, SIGNED))
    for branch, sign in zip(CURVE.branches, (1, -1), strict=True):
        middle = (Fraction(branch.angle_deg[0]) + Fraction(branch.angle_deg[-1])) / 2
        powers = [Fraction(0)] * 11
        for coefficient in branch.coefficients[::-1]:
            shifted = [Fraction(0), *powers[:-1]]
            powers = [(up - middle * same) / 90 for up, same in zip(shifted, powers, strict=True)]
            powers[0] += coefficient
        for power, (a, b) in enumerate(zip(plain, signed, strict=True)):
            assert abs(a + sign * b - powers[power]) <= Fraction(2, 10**15) * (abs(a) + abs(b))


def test_the_printed_form_loses_the_digits_that_the_centred_form_keeps() -> None:
    degrees = GRID * 360
    plain, signed = (np.array([float(value) for value in printed]) for printed in (PLAIN, SIGNED))

    def printed(kind: type[np.floating]) -> np.ndarray:
        angle, branch = degrees.astype(kind), np.sign(180 - degrees).astype(kind)
        sums = []
        for coefficients in (plain, signed):
            total = np.zeros_like(angle)
            for value in coefficients[::-1]:
                total = total * angle + kind(value)
            sums.append(total)
        return sums[0] + sums[1] * branch

    ours = crank_torque(GRID, CURVE)
    assert 1e-6 < np.abs(printed(np.float64) - ours).max() < 1e-4
    assert np.abs(printed(np.float32) - ours).max() > 1000


def test_the_printed_factor_read_literally_gives_nonsense(truth: dict[str, Any]) -> None:
    listed = truth["seed003"]["readings"]
    for angle_deg in (181, 270):
        turned = angle_deg * np.pi / 180
        powers = [(float(a) - float(b)) * turned**power for power, (a, b) in enumerate(zip(PLAIN, SIGNED, strict=True))]
        literal = listed[str(angle_deg)]["variable=phi_deg*pi/180 (literal)"]
        assert sum(powers) == pytest.approx(literal, rel=1e-12)
        assert literal < -4e7
        ours = float(crank_torque(angle_deg / 360, CURVE))
        assert ours == pytest.approx(listed[str(angle_deg)]["variable=degrees"], abs=2e-5)


def test_mean_and_work_are_the_exact_ones(truth: dict[str, Any]) -> None:
    expected = truth["seed003"]
    assert pytest.approx(float(expected["mean_torque_Nm"]["decimal"]), rel=1e-15) == CURVE.mean_nm
    assert pytest.approx(float(expected["work_per_rev_J"]), rel=1e-14) == CURVE.work_per_rev_j
    total = sum((branch.integral_nm_deg for branch in CURVE.branches), Fraction(0))
    assert total / 360 == Fraction(expected["mean_torque_Nm"]["rational"])
    for branch, name in zip(CURVE.branches, ("integral_0_180_Nm_deg", "integral_180_360_Nm_deg"), strict=True):
        assert pytest.approx(float(expected[name]), rel=1e-15) == float(branch.integral_nm_deg)


def test_slopes_at_the_dead_centres_show_a_kink(truth: dict[str, Any]) -> None:
    slopes = [slope for branch in CURVE.branches for slope in branch.end_slopes_nm_per_deg]
    assert slopes == pytest.approx(list(truth["seed003"]["slopes_Nm_per_deg"].values()), rel=1e-12)


def test_extrema_are_the_true_ones(truth: dict[str, Any]) -> None:
    angle_rev, torque = torque_extrema(CURVE)
    expected = np.array(truth["seed003"]["extrema"])
    np.testing.assert_allclose(angle_rev * 360, expected[:, 0], rtol=1e-12)
    np.testing.assert_allclose(torque, expected[:, 1], rtol=1e-12)


def test_harmonics_are_the_true_ones_up_to_order_64(truth: dict[str, Any]) -> None:
    listed = truth["seed003"]["Mcr_Fourier_Nm"]
    harmonics = torque_harmonics([int(order) for order in listed], CURVE)
    np.testing.assert_allclose(harmonics.real, [float(line["cos"]) for line in listed.values()], rtol=1e-12)
    np.testing.assert_allclose(-harmonics.imag, [float(line["sin"]) for line in listed.values()], rtol=1e-12)
    np.testing.assert_allclose(np.abs(harmonics), [float(line["amp"]) for line in listed.values()], rtol=1e-12)


def test_mean_and_harmonics_add_up_to_the_torque() -> None:
    orders = np.arange(1, 2001)
    angles = np.array([0.05, 0.2, 0.37, 0.62, 0.9])
    waves = np.exp(2j * np.pi * orders * angles[:, None])
    total = CURVE.mean_nm + (torque_harmonics(orders, CURVE) * waves).real.sum(axis=1)
    # orders beyond 2000 fall as 2.1e3/n² and alternate: what is left is about 2.1e3/2000² per radian of phase
    np.testing.assert_allclose(total, crank_torque(angles, CURVE), atol=2e-3)


def test_the_potential_torque_does_no_work_in_a_revolution() -> None:
    nodes, weights = np.polynomial.legendre.leggauss(16)
    halves = np.concatenate([0.25 + 0.25 * nodes, 0.75 + 0.25 * nodes])
    assert abs(np.tile(weights, 2) @ potential_torque(halves, CURVE)) < 1e-11


def test_fractional_orders_are_refused() -> None:
    with pytest.raises(RequestError, match="whole orders"):
        torque_harmonics([1, 1.5], CURVE)


@pytest.mark.parametrize(
    ("angles", "torques", "what"),
    [
        ((0.0, 180.0), (1.0,), "as many torques"),
        ((0.0,), (1.0,), "two or more"),
        ((0.0, 200.0, 100.0, 360.0), (0.0, 1.0, 1.0, 0.0), "rising"),
        ((0.0, 360.0), (0.0, float("nan")), "finite"),
    ],
)
def test_impossible_nodes_are_refused(angles: tuple[float, ...], torques: tuple[float, ...], what: str) -> None:
    with pytest.raises(RequestError, match=what):
        TorqueBranch(angle_deg=angles, torque_nm=torques)


def test_a_gap_between_branches_is_refused() -> None:
    first = TorqueBranch(angle_deg=(0.0, 170.0), torque_nm=(0.0, 1.0))
    second = TorqueBranch(angle_deg=(180.0, 360.0), torque_nm=(1.0, 0.0))
    for branches in ((first, second), (first,), (second,), ()):
        with pytest.raises(RequestError):
            CrankTorque(branches=branches)
