"""The whole reference campaign (35 speeds x 15 s) against the truth that travels with it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from crankorder.cli import main

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Truth and findings of `crankorder demo`."""
    out = tmp_path_factory.mktemp("demo")
    outcome = CliRunner().invoke(main, ["demo", "--out", str(out), "-q"])
    assert outcome.exit_code == 0, outcome.output
    pictures = [Path(line) for line in outcome.stdout.splitlines()]
    assert all(picture.stat().st_size > 10_000 for picture in pictures) and len(pictures) == 6
    truth = json.loads((out / "recordings" / "truth.json").read_bytes())
    return truth, json.loads(next(out.glob("results/*/findings.json")).read_bytes())


def test_all_orders_of_the_thesis_are_found_and_none_else(campaign):
    _, findings = campaign
    assert {round(record["order"], 1) for record in findings["orders"]} == {1.0, 2.0, 3.0, 4.0, 5.5, 8.0, 10.0}


def test_orders_1_and_2_and_5_5_are_seen_over_the_whole_range(campaign):
    _, findings = campaign
    reach = {}
    for record in findings["orders"]:
        low, high = reach.get(round(record["order"], 1), (np.inf, 0.0))
        seen = record["speed_range_rpm"]
        reach[round(record["order"], 1)] = (min(low, seen[0]), max(high, seen[1]))
    for order in (1.0, 2.0, 5.5):
        assert reach[order][0] <= 301 and reach[order][1] >= 1999


def test_all_eight_natural_frequencies_are_found_within_one_percent_and_none_else(campaign):
    truth, findings = campaign
    found = [record["frequency_hz"] for record in findings["modes"]]
    np.testing.assert_allclose(found, [mode["frequency_hz"] for mode in truth["modes"]], rtol=0.01)
    assert {record["explained_by"] for record in findings["modes"]} == {"mode"}


def test_first_order_grows_with_the_square_of_speed_and_5_5_not_at_all(campaign):
    _, findings = campaign
    exponents = {(r["channel"], round(r["order"], 1)): r["speed_exponent"] for r in findings["orders"]}
    assert exponents["Z", 1.0] == pytest.approx(2.0, abs=0.2)
    assert all(exponents[channel, 5.5] == pytest.approx(0.0, abs=0.1) for channel in "XYZ")


def test_orders_4_and_8_excite_115_and_230_hz_at_1725_rpm(campaign):
    _, findings = campaign
    excited = {(round(r["order"]), round(r["mode_hz"])): r["rpm"] for r in findings["crossings"] if r["excited"]}
    assert excited[4, 115] == pytest.approx(1725, rel=0.01)
    assert excited[8, 230] == pytest.approx(1725, rel=0.01)


def test_orders_that_kinematics_cannot_make_stay_unexplained(campaign):
    _, findings = campaign
    explained = {round(record["order"], 1): record["explained_by"] for record in findings["orders"]}
    assert explained[8.0] == explained[10.0] == "unexplained"
    assert explained[1.0] == explained[4.0] == "engine kinematics"
    assert explained[5.5].startswith("bearing")


def test_no_first_order_is_seen_across_the_engine(campaign):
    _, findings = campaign
    assert ("X", 1.0) not in {(record["channel"], round(record["order"], 1)) for record in findings["orders"]}
