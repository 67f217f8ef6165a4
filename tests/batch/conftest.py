"""Recordings of the reference campaign, and results of two of them, which several files of this room use."""

import pytest

from made.command import done


@pytest.fixture
def copied(campaign_at, tmp_path):
    """Maker of a folder of the test's own, to be spoiled: the manifest and the recordings at the given speeds."""
    return lambda *speeds_rpm, name="recordings": campaign_at(tmp_path / name, *speeds_rpm)


@pytest.fixture(scope="session")
def analysed(campaign_at, tmp_path_factory):
    """Two recordings and their results, whole: findings, pictures and page. Nothing may be changed in them."""
    place = tmp_path_factory.mktemp("analysed")
    done("run", campaign_at(place / "recordings", 1500, 1800), "--out", place / "out", "--jobs", 2)
    return place
