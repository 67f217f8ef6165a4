"""The short version of the reference campaign, which several files of this room take recordings from."""

import shutil
from pathlib import Path

import pytest

from made.command import done


@pytest.fixture(scope="session")
def campaign(tmp_path_factory):
    """Recordings of the campaign with its truth: nothing may be changed in them."""
    folder: Path = tmp_path_factory.mktemp("campaign") / "recordings"
    done("synth", "thesis-second-motoring", "--out", folder, "--quick", "-q")
    return folder


@pytest.fixture
def copied(campaign, tmp_path):
    """Maker of a folder of the test's own, to be spoiled: the manifest and the recordings at the given speeds."""

    def copy(*speeds_rpm, name="recordings"):
        (tmp_path / name).mkdir()
        for file in ("run.toml", *(f"rpm_{rpm}.h5" for rpm in speeds_rpm)):
            shutil.copy(campaign / file, tmp_path / name / file)
        return tmp_path / name

    return copy


@pytest.fixture(params=[("--recipe", "maps"), pytest.param((), marks=pytest.mark.slow)], ids=["maps", "default"])
def recipe(request):
    """Options that name a recipe: the maps alone, and (slow) findings and page as well."""
    asked: tuple[str, ...] = request.param
    return asked
