"""A folder, a fault and settings, drawn at random: a documented exit status, the file named, no input changed."""

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from crankorder.errors import printable
from made.command import crankorder

DONE, REQUEST, SOME_LEFT_OUT, NONE_LEFT = 0, 2, 3, 4
NAMES = st.text(st.characters(blacklist_categories=("Cs", "Cc"), blacklist_characters="/"), min_size=1, max_size=30)


def hashes(folder):
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder: Path = tmp_path_factory.mktemp("scene") / "test"
    assert crankorder("synth", "hard-two-revolutions", "--out", folder, "--quick", "-q").exit_code == 0
    return folder


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


def lost_channel(path, at):
    with h5py.File(path, "r+") as file:
        names = sorted(name for name in file if name.startswith("acc"))
        del file[names[int(at * (len(names) - 1e-9))]]


def short_channel(path, at):
    with h5py.File(path, "r+") as file:
        names = sorted(name for name in file if name.startswith("acc"))
        name = names[int(at * (len(names) - 1e-9))]
        values, attrs = file[name][:], dict(file[name].attrs)
        del file[name]
        file.create_dataset(name, data=values[: len(values) // 2]).attrs.update(attrs)


FAULTS: dict[str, Callable[[Path, float], None]] = {
    one.__name__: one for one in (truncated, overwritten, other_content, lost_channel, short_channel)
}
"""Each spoils one recording for certain."""

SETTINGS = [(), ("--strict",), ("--fresh",), ("--jobs", "2"), ("--log-json",)]


def check_one(scene, place, name, fault, at, more, whole):
    """One recording with that ``fault`` and name, beside so many that are ``whole``."""
    folder, out = place / "data", place / "out"
    shutil.copytree(scene, folder)
    (first,) = folder.glob("*.h5")
    text = (folder / "run.toml").read_text(encoding="utf-8")
    spoilt = folder / f"rpm_0400{name}.h5"
    shutil.copy(first, spoilt)
    FAULTS[fault](spoilt, at)
    for number in range(1, whole):
        other = folder / f"rpm_{300 + number:04d}.h5"
        shutil.copy(first, other)
        with h5py.File(other, "r+") as file:
            for item in (item for key, item in file.items() if key.startswith("acc")):
                item[...] += 0.01 * np.random.default_rng(number).standard_normal(item.shape).astype(item.dtype)
    if not whole:
        first.unlink()
    (folder / "run.toml").write_text(text, encoding="utf-8")
    before = hashes(folder)
    outcome = crankorder("run", folder, "--out", out, "--recipe", "maps", *more)
    said = outcome.stderr
    assert outcome.exit_code == (SOME_LEFT_OUT if whole else NONE_LEFT), outcome.output
    assert printable(spoilt.name) in said, said
    assert "Traceback" not in outcome.output
    assert all(char.isprintable() or char == "\n" for char in said)
    assert hashes(folder) == before
    made = list(out.glob("*/done.json"))
    assert len(made) == (1 if whole else 0)
    assert not list(out.glob("*.part"))


@pytest.mark.parametrize("examples", [4, pytest.param(100, marks=pytest.mark.slow)])
def test_whatever_is_wrong_with_one_recording_its_file_is_named_and_nothing_else_suffers(
    scene, tmp_path_factory, examples
):
    @settings(max_examples=examples, phases=[Phase.explicit, Phase.generate])
    @given(
        name=NAMES, fault=st.sampled_from(sorted(FAULTS)), at=st.floats(0.0, 1.0), more=st.sampled_from(SETTINGS),
        whole=st.integers(0, 2),
    )  # fmt: skip
    def check(**case):
        check_one(scene, tmp_path_factory.mktemp("case"), **case)  # type: ignore[arg-type]

    check()


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(where=st.floats(0.0, 1.0), junk=st.binary(min_size=1, max_size=8))
def test_a_manifest_with_any_bytes_in_it_is_used_or_refused_with_its_name(scene, tmp_path_factory, where, junk):
    folder = tmp_path_factory.mktemp("manifest") / "data"
    shutil.copytree(scene, folder)
    text = (folder / "run.toml").read_bytes()
    place = int(where * len(text))
    (folder / "run.toml").write_bytes(text[:place] + junk + text[place:])
    before = hashes(folder)
    outcome = crankorder("check", folder)
    assert outcome.exit_code in (DONE, REQUEST, SOME_LEFT_OUT, NONE_LEFT), outcome.output
    assert outcome.exit_code == DONE or "run.toml" in outcome.stderr or ".h5" in outcome.stderr
    assert "Traceback" not in outcome.output
    assert hashes(folder) == before
