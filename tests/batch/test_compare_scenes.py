"""The reference campaign beside one with a heavier spacer."""

import json
from pathlib import Path

import pytest

from made.command import done

PIPELINE = Path(__file__).parents[2] / "pipeline"


def changed(text, *changes):
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    return text


@pytest.mark.slow
def test_a_heavier_spacer_is_weighed(tmp_path):
    engine = (PIPELINE / "engines" / "msu-optical-second.toml").read_text()
    heavier = changed(engine, ("unbalanced_mass_kg = 0.116", "unbalanced_mass_kg = 0.216"))
    (tmp_path / "heavier.toml").write_text(heavier)
    scene = (PIPELINE / "scenes" / "thesis-second-motoring.toml").read_text()
    other = changed(scene, ("seed = 2015", "seed = 55"), ('engine = "msu-optical-second"', 'engine = "heavier.toml"'))
    for name, text in (("base", scene), ("heavier", other)):
        (tmp_path / f"{name}-scene.toml").write_text(text)
        done("synth", tmp_path / f"{name}-scene.toml", "--quick", "-q", "--out", tmp_path / "recordings" / name)
        done("run", tmp_path / "recordings" / name, "--out", tmp_path / name, "--jobs", 1, "-q")
    done("compare", tmp_path / "base", tmp_path / "heavier", "--out", tmp_path / "c", "-q")
    made = json.loads((tmp_path / "c" / "comparison.json").read_bytes())
    assert made["cause"] == {"cause": "moving masses", "orders": [1.0, 2.0]}
    assert not any(one["changed"] for one in made["modes"])
    assert all(one["ratio"] > 1 for one in made["orders"] if one["changed"])
    # 116 g became 216 g: order 1 by their ratio, whatever the path
    (first,) = [one for one in made["unbalance"] if one["channel"] == "Z" and one["order"] == 1.0]
    assert first["factor_ci95"][0] < 216 / 116 < first["factor_ci95"][1]
    (mass,) = [one for one in made["balance"] if one["quantity"] == "residual_reciprocating_g"]
    low, high = mass["change_ci95"]
    assert mass["changed"] and low < 100 < high < 150
    assert "more unbalanced mass" in made["headline"][0]
