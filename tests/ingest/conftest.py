"""What the ingest tests share: settings, a manifest from its text, and a recording by its manifest."""

import time

import pytest

from crankorder.errors import CrankorderError
from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_recording
from crankorder.settings import load_settings

HEAD = 'schema_version = 1\n[test]\ncycle = "four-stroke"\n[recordings]\nfiles = ["*"]\n'


@pytest.fixture(scope="session")
def settings():
    return load_settings()


@pytest.fixture(scope="session")
def limits(settings):
    return settings.ingest


@pytest.fixture
def manifest_of(tmp_path_factory):
    """Manifest of the tables in a TOML text, with the head that every manifest needs."""

    def build(tables, head=HEAD):
        path = tmp_path_factory.mktemp("manifest") / "run.toml"
        path.write_text(head + tables, encoding="utf-8")
        return load_manifest(path.parent)

    return build


@pytest.fixture(scope="session")
def refused_s():
    """The least processor seconds of three times that a task is refused: on any machine, to be compared with others."""

    def least(task):
        seconds = []
        for _ in range(3):
            begun = time.process_time()
            with pytest.raises(CrankorderError):
                task()
            seconds.append(time.process_time() - begun)
        return min(seconds)

    return least


@pytest.fixture(scope="session")
def read_in(settings):
    """Recording of the file at a path by its manifest: the one beside it where no other is given."""

    def read(path, manifest=None):
        manifest = manifest or load_manifest(path.parent)
        return read_recording(path, manifest, settings=settings.ingest, shaft=settings.shaft)

    return read
