"""The short version of the reference campaign, which several files of this room take recordings from."""

from pathlib import Path

import pytest

from made.command import done


@pytest.fixture(scope="session")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of the campaign with its truth: nothing may be changed in them."""
    folder: Path = tmp_path_factory.mktemp("campaign") / "recordings"
    done("synth", "thesis-second-motoring", "--out", folder, "--quick", "-q")
    return folder


@pytest.fixture(params=[("--recipe", "maps"), pytest.param((), marks=pytest.mark.slow)], ids=["maps", "default"])
def recipe(request: pytest.FixtureRequest) -> tuple[str, ...]:
    """Options that name a recipe: the maps alone, and (slow) findings and page as well."""
    asked: tuple[str, ...] = request.param
    return asked
