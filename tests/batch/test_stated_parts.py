"""A line is a stated part's only where the data and the statement put it: from files to the report's first sentence."""

import numpy as np
import pytest
from scipy.io import savemat

from made.command import analysed
from made.recordings import manifest

RATE_HZ, SHAFT_HZ, TURNS = 200.0, 25.0, 1 / 97

MANIFEST = manifest(
    "steady.*", channels={"acc": {"source": "acc"}}, sampling={"rate_hz": RATE_HZ},
    encoder={"source": "tacho", "kind": "square", "pulses_per_rev": 1},
    gears=[{"name": "other", "teeth": 2, "ratio": 0.0171}, {"name": "blades", "teeth": 3, "ratio": 0.0103}],
)  # fmt: skip

LONG = 'title = "Long"\ndescription = "Long frames."\n[orders]\nmax_order = 8.0\nrevs_per_frame = 400\noverlap = 0.5\n'


def written(folder, form, lines):
    folder.mkdir()
    rng = np.random.default_rng(3)
    time = np.arange(int(180 * RATE_HZ)) / RATE_HZ
    acc = 0.02 * rng.standard_normal(len(time))
    for order, size in lines.items():
        acc += size * np.cos(2 * np.pi * order * SHAFT_HZ * time + rng.uniform(0.0, 6.0))
    tacho = np.where(SHAFT_HZ * time % 1.0 < 0.3, 5.0, 0.0)
    if form == "csv":
        columns = np.column_stack([acc, tacho])
        np.savetxt(folder / "steady.csv", columns, delimiter=",", fmt="%.5f", header="acc,tacho", comments="")
    else:
        savemat(folder / "steady.mat", {"acc": acc, "tacho": tacho})
    (folder / "run.toml").write_text(MANIFEST)
    (folder.parent / "long.toml").write_text(LONG)
    return folder


@pytest.mark.parametrize("form", ["csv", "mat"])
def test_blades_name_their_own_lines_alone_in_every_format(form, tmp_path):
    lines = {3 * TURNS: 0.2, 9 * TURNS: 0.3, 0.262: 0.5, 0.7449: 0.1}
    folder = written(tmp_path / "in", form, lines)
    findings = analysed(folder, tmp_path / "out", "--recipe", tmp_path / "long.toml")
    causes = [record["explained_by"] for record in sorted(findings["orders"], key=lambda one: one["order"])]
    assert causes == ["gear mesh blades", "gear mesh blades, harmonic 3", "unexplained", "unexplained"]
    assert findings["energy"]["band_hz"] == findings["levels"][0]["band_hz"] == RATE_HZ / 2
    page = next((tmp_path / "out").glob("*/report.html")).read_text()
    assert "(order 0.262)" in page and "order 0.26 " not in page
