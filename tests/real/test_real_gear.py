"""A gearbox with 23 teeth at 2000 rpm: facts of one long spectrum by hand (Hann window over all 11 s)."""

import numpy as np
import pytest

pytestmark = pytest.mark.slow

MESH = 22.9986  # 766.62 Hz over 2000 rpm, good to 0.001


@pytest.fixture(scope="module")
def gear(analysed):
    return analysed("gear0", "gear0")


def near(records, order, within=0.01):
    return [record for record in records if abs(record["order"] - order) <= within]


def test_the_mesh_is_the_strongest_order_and_is_called_one_with_its_second_multiple(gear):
    orders = gear.findings["orders"]
    (mesh,) = near(orders, MESH)
    assert mesh["amplitude"] == max(record["amplitude"] for record in orders)
    assert "gear mesh" in mesh["explained_by"]
    assert mesh["order"] == pytest.approx(MESH, abs=0.003)
    (second,) = near(orders, 2 * MESH)
    assert "gear mesh" in second["explained_by"]
    (side,) = near(orders, 2 * MESH - 1.0, within=0.02)
    assert side["explained_by"] == "sideband of order 46 spaced by 1"


def test_lines_beside_the_mesh_are_its_sidebands_and_no_line_is_surely_a_mode(gear):
    """One order beside it stand 22 and 24, 16 to 18 dB below the mesh.

    A second shaft turns here too (171.6 Hz and multiples): at one speed nothing tells its lines from modes.
    """
    sides = [MESH - 1.0, MESH + 1.0]
    for order in sides:
        (side,) = near(gear.findings["orders"], order, within=0.02)
        assert "sideband" in side["explained_by"] or "gear mesh" in side["explained_by"]
    turning = np.concatenate([np.array([*sides, MESH, 2 * MESH]) * 2000 / 60, 171.6 * np.arange(1, 12)])
    assert not [hz for hz in gear.modes_hz() if np.min(np.abs(hz / turning - 1.0)) <= 0.002]


def test_every_line_that_one_speed_cannot_prove_says_so(gear):
    """Its speed is nominal: what is not proven to be locked could be of fixed frequency, and the evidence says it."""
    for record in gear.findings["orders"]:
        if record["evidence"].startswith("steady"):
            assert "at one speed a line of fixed frequency would look the same" in record["evidence"]
            assert record["lock"] != "locked"


def test_lines_beside_the_mesh_tell_which_wheel_modulates_it(gear):
    """By hand 21.81 and 24.19 stand 1.188 beside the mesh, and 28.15 stands 5.148 beside it: lines of their own too."""
    for order, spacing in ((21.810, 1.188), (24.186, 1.188), (28.146, 5.148)):
        (side,) = near(gear.findings["orders"], order, within=0.01)
        assert side["explained_by"] == f"sideband of order 23 spaced by {spacing:.4g}"
        assert near(gear.findings["orders"], spacing, within=0.003)
