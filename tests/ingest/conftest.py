"""What the ingest tests share: settings, a manifest from its text, and a recording by its manifest."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest
import xarray as xr

from crankorder.errors import CrankorderError
from crankorder.ingest.manifest import Manifest, load_manifest
from crankorder.ingest.recording import read_recording
from crankorder.settings import IngestSettings, Settings, load_settings

HEAD = 'schema_version = 1\n[test]\ncycle = "four-stroke"\n[recordings]\nfiles = ["*"]\n'


@pytest.fixture(scope="session")
def settings() -> Settings:
    return load_settings()


@pytest.fixture(scope="session")
def limits(settings: Settings) -> IngestSettings:
    return settings.ingest


@pytest.fixture
def manifest_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Manifest]:
    """Manifest of the tables in a TOML text, with the head that every manifest needs."""

    def build(tables: str, head: str = HEAD) -> Manifest:
        path = tmp_path_factory.mktemp("manifest") / "run.toml"
        path.write_text(head + tables, encoding="utf-8")
        return load_manifest(path.parent)

    return build


@pytest.fixture(scope="session")
def refused_s() -> Callable[[Callable[[], object]], float]:
    """The least processor seconds of three times that a task is refused: on any machine, to be compared with others."""

    def least(task: Callable[[], object]) -> float:
        seconds = []
        for _ in range(3):
            begun = time.process_time()
            with pytest.raises(CrankorderError):
                task()
            seconds.append(time.process_time() - begun)
        return min(seconds)

    return least


@pytest.fixture(scope="session")
def read_in(settings: Settings) -> Callable[..., xr.Dataset]:
    """Recording of the file at a path by its manifest: the one beside it where no other is given."""

    def read(path: Path, manifest: Manifest | None = None) -> xr.Dataset:
        manifest = manifest or load_manifest(path.parent)
        return read_recording(path, manifest, settings=settings.ingest, shaft=settings.shaft)

    return read
