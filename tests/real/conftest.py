"""What the tests on real recordings share: one analysis of each, as `crankorder run` makes it."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

from made.command import done
from made.contradictions import contradictions

MANIFESTS = Path(__file__).parent


class Analysed:
    """Results of one real test."""

    def __init__(self, folder):
        self.folder = folder
        self.findings: dict[str, Any] = json.loads((folder / "findings.json").read_bytes())

    def group(self, name):
        """Dataset of that name in the results."""
        return xr.load_dataset(self.folder / "results.nc", group=name, engine="h5netcdf")

    def modes_hz(self):
        """Frequencies of the lines that are said to be modes."""
        return [record["frequency_hz"] for record in self.findings["modes"] if record["explained_by"] == "mode"]


@pytest.fixture(scope="session")
def analysed(shared_data, tmp_path_factory):
    """Results of `crankorder run FOLDER --manifest tests/real/NAME.toml`, of the file ``only`` where one is named."""
    made: dict[tuple[str, str], Analysed] = {}

    def run(name, folder, only=""):
        if (name, only) not in made:
            out = tmp_path_factory.mktemp(name)
            manifest = MANIFESTS / f"{name}.toml"
            if only:
                text = re.sub(r"files = \[[^\]]*\]", f'files = ["{only}"]', manifest.read_text(encoding="utf-8"))
                manifest = tmp_path_factory.mktemp(f"{name}_manifest") / manifest.name
                manifest.write_text(text, encoding="utf-8")
            done("run", shared_data / folder, "--manifest", manifest, "--out", out, "-q")
            made[name, only] = Analysed(next(path.parent for path in out.glob("*/findings.json")))
            assert not contradictions(made[name, only].findings)
        return made[name, only]

    return run
