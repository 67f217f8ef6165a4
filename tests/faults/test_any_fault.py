"""A folder, a fault and settings, drawn at random: a documented exit status, the file named, no input changed."""

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from crankorder.errors import printable
from made.command import crankorder
from made.recordings import noisy_copy

DONE, REQUEST, SOME_LEFT_OUT, NONE_LEFT = 0, 2, 3, 4
OUR_FIXTURES = [HealthCheck.function_scoped_fixture]  # makers alone: nothing is kept between examples
NAMES = st.text(st.characters(blacklist_categories=("Cs", "Cc"), blacklist_characters="/"), min_size=1, max_size=30)


def hashes(folder):
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture
def scene(recordings_of):
    return recordings_of("hard-two-revolutions")


def truncated(path, at):
    """A recording that lacks its end: never as good as whole."""
    data = path.read_bytes()
    path.write_bytes(data[: int(at * (len(data) - 1))])


def overwritten(path, at):
    """A page of zeros over the head of the file."""
    data = path.read_bytes()
    path.write_bytes(bytes(8 + int(at * 500)) + data[8 + int(at * 500) :])


def other_content(path, at):
    contents = [b"<!DOCTYPE html><title>404</title>", b"speed,level\n1,2\n", b"PK\x03\x04", b"\x00" * 4096]
    path.write_bytes(contents[int(at * 3.999)])


def _a_channel(file, at):
    names = sorted(name for name in file if name.startswith("acc"))
    return names[int(at * (len(names) - 1e-9))]


def lost_channel(path, at):
    with h5py.File(path, "r+") as file:
        del file[_a_channel(file, at)]


def short_channel(path, at):
    with h5py.File(path, "r+") as file:
        name = _a_channel(file, at)
        values, attrs = file[name][:], dict(file[name].attrs)
        del file[name]
        file.create_dataset(name, data=values[: len(values) // 2]).attrs.update(attrs)


FAULTS: dict[str, Callable[[Path, float], None]] = {
    one.__name__: one for one in (truncated, overwritten, other_content, lost_channel, short_channel)
}
"""Each spoils one recording for certain."""

SETTINGS = [(), ("--strict",), ("--fresh",), ("--jobs", "2"), ("--log-json",)]


@settings(max_examples=4, phases=[Phase.explicit, Phase.generate], suppress_health_check=OUR_FIXTURES)
@given(
    name=NAMES, fault=st.sampled_from(sorted(FAULTS)), at=st.floats(0.0, 1.0), more=st.sampled_from(SETTINGS),
    whole=st.integers(0, 2),
)  # fmt: skip
def test_whatever_is_wrong_with_one_recording_its_file_is_named_and_nothing_else_suffers(
    scene, tmp_path_factory, name, fault, at, more, whole
):
    """One recording with that ``fault`` and name, beside so many that are ``whole``."""
    place = tmp_path_factory.mktemp("case")
    folder, out = shutil.copytree(scene, place / "data"), place / "out"
    (first,) = folder.glob("*.h5")
    spoilt = folder / f"rpm_0400{name}.h5"
    shutil.copy(first, spoilt)
    FAULTS[fault](spoilt, at)
    for number in range(1, whole):
        noisy_copy(first, folder / f"rpm_{300 + number:04d}.h5", number)
    if not whole:
        first.unlink()
    before = hashes(folder)
    outcome = crankorder("run", folder, "--out", out, "--recipe", "maps", *more)
    assert outcome.exit_code == (SOME_LEFT_OUT if whole else NONE_LEFT), outcome.output
    assert printable(spoilt.name) in outcome.stderr
    assert "Traceback" not in outcome.output
    assert all(char.isprintable() or char == "\n" for char in outcome.stderr)
    assert hashes(folder) == before
    assert len(list(out.glob("*/done.json"))) == (1 if whole else 0)
    assert not list(out.glob("*.part"))


@settings(max_examples=20, suppress_health_check=OUR_FIXTURES)
@given(where=st.floats(0.0, 1.0), junk=st.binary(min_size=1, max_size=8))
def test_a_manifest_with_any_bytes_in_it_is_used_or_refused_with_its_name(scene, tmp_path_factory, where, junk):
    folder = shutil.copytree(scene, tmp_path_factory.mktemp("manifest") / "data")
    text = (folder / "run.toml").read_bytes()
    place = int(where * len(text))
    (folder / "run.toml").write_bytes(text[:place] + junk + text[place:])
    before = hashes(folder)
    outcome = crankorder("check", folder)
    assert outcome.exit_code in (DONE, REQUEST, SOME_LEFT_OUT, NONE_LEFT), outcome.output
    assert outcome.exit_code == DONE or "run.toml" in outcome.stderr or ".h5" in outcome.stderr
    assert "Traceback" not in outcome.output
    assert hashes(folder) == before
