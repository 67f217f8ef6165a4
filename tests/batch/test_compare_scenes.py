"""The reference campaign beside its repeat, a heavier spacer and a doubled line; a bearing that fails over runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from made.command import done

PIPELINE = Path(__file__).parents[2] / "pipeline"
pytestmark = pytest.mark.slow
CHANGES = {
    "base": (),
    "repeat": (("seed = 2015", "seed = 77"),),
    "doubled": (("seed = 2015", "seed = 99"), ("X = 1.2, Y = 1.2, Z = 1.2", "X = 2.4, Y = 2.4, Z = 2.4")),
    "heavier": (("seed = 2015", "seed = 55"), ('engine = "msu-optical-second"', 'engine = "heavier.toml"')),
}


def changed(text: str, changes: tuple[tuple[str, str], ...]) -> str:
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    return text


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of the four campaigns, by name."""
    out = tmp_path_factory.mktemp("campaigns")
    engine = (PIPELINE / "engines" / "msu-optical-second.toml").read_text()
    heavier = changed(engine, (("unbalanced_mass_kg = 0.116", "unbalanced_mass_kg = 0.216"),))
    (out / "heavier.toml").write_text(heavier)
    scene = (PIPELINE / "scenes" / "thesis-second-motoring.toml").read_text()
    for name, changes in CHANGES.items():
        (out / f"{name}-scene.toml").write_text(changed(scene, changes))
        done("synth", out / f"{name}-scene.toml", "--quick", "-q", "--out", out / "recordings" / name)
        done("run", out / "recordings" / name, "--out", out / name, "--jobs", 1, "-q")
    return out


def compared(folder: Path, *names: str, out: Path) -> dict[str, Any]:
    done("compare", *(folder / name for name in names), "--out", out, "-q")
    return json.loads((out / "comparison.json").read_bytes())


def test_a_repeat_is_no_change(results: Path, tmp_path: Path) -> None:
    made = compared(results, "base", "repeat", out=tmp_path / "c")
    assert made["cause"] == {"cause": "nothing changed", "orders": []}
    assert len(made["modes"]) == 8 and not any(one["changed"] for one in made["modes"])


def test_a_heavier_spacer_is_weighed(results: Path, tmp_path: Path) -> None:
    made = compared(results, "base", "heavier", out=tmp_path / "c")
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


def test_a_doubled_bearing_line_is_told_and_nothing_else(results: Path, tmp_path: Path) -> None:
    made = compared(results, "base", "doubled", out=tmp_path / "c")
    assert made["cause"] == {"cause": "orders", "orders": [5.5]}
    ratios = [one["ratio_ci95"] for one in made["orders"] if one["changed"]]
    assert len(ratios) == 3 and all(1.96 < low < high < 2.04 for low, high in ratios)
    assert not any(one["changed"] for one in made["modes"])
    assert "5.5 rose" in made["headline"][0]


def test_a_bearing_that_fails_over_the_runs_is_named(tmp_path: Path) -> None:
    scene = changed((PIPELINE / "scenes" / "bearing-growth.toml").read_text(), (("repeats = 2", "repeats = 5"),))
    (tmp_path / "growth.toml").write_text(scene)
    done("synth", tmp_path / "growth.toml", "--quick", "-q", "--out", tmp_path / "recordings")
    names = [f"run_{k}" for k in range(1, 6)]
    for name in names:
        done("run", tmp_path / "recordings" / name, "--out", tmp_path / name, "--jobs", 1, "-q")
    made = compared(tmp_path, *names, out=tmp_path / "c")
    grown = [one for one in made["trend"] if one["changed"]]
    assert grown and all("BPFO" in one["line"] and "failing" in one["verdict"] for one in grown)
    low, high = grown[0]["growth_per_run_ci95"]
    assert low < 0.5 < high  # the scene's own growth
    assert "A growing amplitude of a bearing line means a failing bearing." in made["headline"][0]
