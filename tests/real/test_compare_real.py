"""A real rotor without and with a balance weight: the weight is recognised as the cause, and weighs the unbalance."""

import json
from pathlib import Path

import pytest

from made.command import done

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def comparison(tmp_path_factory):
    folder = HERE.parents[2] / "shared" / "data" / "rotorbalancer"
    if not (folder / "2021-07_groups").is_dir():
        pytest.skip("the recordings are not in ../shared/data on this machine")
    out = tmp_path_factory.mktemp("rotor")
    for state in ("without", "with"):
        manifest = HERE / f"rotor_{state}.toml"
        done("run", folder, "--manifest", manifest, "--out", out / state, "--jobs", 1, "-q")
    done("compare", out / "without", out / "with", "--out", out / "c")
    return json.loads((out / "c" / "comparison.json").read_bytes())


def test_the_balance_weight_is_the_cause(comparison):
    assert comparison["cause"] == {"cause": "unbalance", "orders": [1.0], "besides": None}
    assert "balance weight" in comparison["headline"][0]
    (record,) = [one for one in comparison["unbalance"] if one["order"] == 1.0]
    # 135 to 533 counts without, 14 to 51 with the weight: a tenth, whatever the speed
    low, high = record["factor_ci95"]
    assert record["explains"] and low < 0.1 < high < 0.3


def test_the_unbalance_that_the_weight_took_away_is_its_own_mass(comparison):
    trial = comparison["trial_mass"]
    arm = trial["radius_mm"]
    # a rest of a tenth: the unbalance was within a fifth of the weight's own mass, and is a tenth of it
    assert trial["residual_rotating_gmm"] / arm == pytest.approx(0.060, rel=0.2)
    low, high = trial["residual_after_gmm_ci95"]
    assert low / arm < 0.006 < high / arm < 0.02
    responses = [one["response_per_unit"] * arm for one in trial["influence"]]
    assert min(responses) > 1500 and max(responses) < 12000  # counts per gram, from 49 Hz to the resonance


def test_the_speeds_of_one_state_alone_take_no_part(comparison):
    assert all(2900 < one["base_rpm"] < 3600 and 2900 < one["new_rpm"] < 3600 for one in comparison["speeds"])
    assert any(one["what"] == "speeds" for one in comparison["confounds"])
