"""What all tests share: where the shared recordings and the truth sheet are, and surroundings that do not vary."""

import functools
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# Before numpy and matplotlib load: the number of BLAS threads changes the last bits of a sum, and without a display
# matplotlib must not look for one.
os.environ["MPLBACKEND"] = "Agg"
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"

# Same examples on every run, and no deadline on a busy machine; ``--hypothesis-profile=default`` looks for new ones.
settings.register_profile("crankorder", derandomize=True, deadline=None)
settings.load_profile("crankorder")

_ROOT = Path(__file__).resolve().parents[1]

CASES = 3
"""Cases of a parametrised test that ``make test`` runs; ``@pytest.mark.cases(n)`` states another number."""


@pytest.hookimpl(tryfirst=True)  # before the marks of the command line choose
def pytest_collection_modifyitems(items):
    """Mark as slow the cases of a test beyond the number that runs by default, which are spread over all of them."""
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        if not any(item.iter_markers("slow")) and not any(item.iter_markers("accuracy")):
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for same in cases.values():
        mark = same[0].get_closest_marker("cases")
        count = mark.args[0] if mark else CASES
        chosen = {round(place * (len(same) - 1) / max(count - 1, 1)) for place in range(count)}
        for number, item in enumerate(same):
            if number not in chosen:
                item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def project_root():
    """The folder of the project."""
    return _ROOT


def _shared(name):
    path = _ROOT.parent / "shared" / name
    if not path.exists():
        pytest.skip(f"../shared/{name} is absent: it lies beside the project, never inside")
    return path


@pytest.fixture(scope="session")
def shared_data():
    """Folder of the measured recordings, read in place; the test is skipped where it is absent."""
    return _shared("data")


@pytest.fixture(scope="session")
def shared_truth():
    """The truth sheet (``truth.json``), derived apart from this program; the test is skipped where it is absent."""
    truth: dict[str, Any] = json.loads((_shared("truth") / "truth.json").read_text(encoding="utf-8"))
    return truth


@pytest.fixture(scope="session")
def recordings_of(tmp_path_factory):
    """Maker of the recordings of a shipped scene in its short version: made once, nothing may be changed in them."""
    from made.command import done  # loads numpy: not before the surroundings above are set

    def made(name):
        folder: Path = tmp_path_factory.mktemp(name) / "test"
        done("synth", name, "--out", folder, "--quick", "-q")
        return folder

    return functools.cache(made)


@pytest.fixture(scope="session")
def campaign_at(recordings_of):
    """Maker of a folder to be spoiled: manifest and recordings of the short reference campaign at the given speeds."""

    def made(folder, *speeds_rpm):
        folder.mkdir()
        for file in ("run.toml", *(f"rpm_{rpm}.h5" for rpm in speeds_rpm)):
            shutil.copy(recordings_of("thesis-second-motoring") / file, folder / file)
        return folder

    return made
