"""A channel whose gain changed in one recording makes no natural frequency: it takes no part in what is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from made.command import analysed
from made.contradictions import contradictions

RATE, SECONDS = 2048.0, 8.0
SPEEDS = np.linspace(800.0, 2600.0, 8)
NATURAL_HZ, DAMPING = 90.0, 0.02
MANIFEST = """schema_version = 1
[test]
name = "gains"
cycle = "rotor"
[recordings]
files = ["rec_*.h5"]
[sampling]
rate_hz = 2048.0
[encoder]
source = "mark"
kind = "pulse_times"
pulses_per_rev = 1
""" + "".join(f'[[channels]]\nname = "{name}"\nsource = "{name}"\nunit = "m/s2"\n' for name in "XYZ")


def findings_of(folder: Path, changed: dict[int, float], seed: int = 5) -> dict[str, Any]:
    """Findings of a rotor that passes its natural frequency; the gain of Y in each recording ``changed`` is another."""
    rng = np.random.default_rng(seed)
    folder.mkdir()
    time_s = np.arange(round(RATE * SECONDS)) / RATE
    for number, rpm in enumerate(SPEEDS):
        rows = 0.05 * rng.standard_normal((3, time_s.size))
        for order, force in ((1, 1.0), (2, 0.6), (3, 0.4)):
            ratio = order * rpm / 60.0 / NATURAL_HZ
            through = ratio**2 / (1.0 - ratio**2 + 2j * DAMPING * ratio)
            wave = force * (rpm / 1500.0) ** 2 * np.exp(2j * np.pi * order * rpm / 60.0 * time_s)
            rows += np.array([[1.0], [0.7], [0.4]]) * np.real((0.5 + through) * wave)
        rows[1] *= changed.get(number, 1.0)
        with h5py.File(folder / f"rec_{number:03d}.h5", "w") as file:
            for name, row in zip("XYZ", rows, strict=True):
                file[name] = row.astype(np.float32)
            file["mark"] = np.arange(1, int(rpm / 60.0 * SECONDS)) * 60.0 / rpm
    (folder / "run.toml").write_text(MANIFEST)
    recipe = folder.parent / "findings-alone.toml"
    recipe.write_text('title = "Findings"\ndescription = "Nothing else."\n[report]\nresults = ["findings"]\n')
    return analysed(folder, folder.parent / "out", "--recipe", recipe)


@pytest.mark.cases(1)
@pytest.mark.parametrize("factor", [2.0, 10.0, 0.1])
def test_a_changed_gain_makes_no_natural_frequency(tmp_path: Path, factor: float) -> None:
    findings = findings_of(tmp_path / "test", {5: factor})
    [flag] = [flag for flag in findings["quality"] if flag["flag"] == "level_jump"]
    assert (flag["recording"], flag["channel"], flag["left_out"]) == ("rec_005.h5", "Y", "channel")
    assert [round(mode["frequency_hz"]) for mode in findings["modes"]] == [NATURAL_HZ]
    met = {round(one["rpm"] * one["order"] / 60.0) for one in findings["crossings"] if one["excited"]}
    assert met == {NATURAL_HZ}
    sizes = {one["channel"]: one["amplitude"] for one in findings["orders"] if round(one["order"], 2) == 1.0}
    assert sizes["Y"] == pytest.approx(0.7 * sizes["X"], rel=0.05)
    assert not contradictions(findings)
