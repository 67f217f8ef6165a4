"""What recordings gave is kept by content: exact, damaged by nobody, and reused where nothing that matters changed."""

import os
import shutil
import time

import numpy as np
import pytest
import xarray as xr

from crankorder.batch import execute
from crankorder.batch.frame_store import STORE, FrameStore, PackedResult, prune
from crankorder.batch.plan import plan_tests
from crankorder.batch.run_log import LOGS
from crankorder.checks.doubts import RecordingResult
from crankorder.quantities import OrderFrames, ShaftAngle
from crankorder.stages import analyse_recording
from made.command import crankorder, results_in
from made.recordings import noisy_copy


def run(*arguments):
    return crankorder("run", *arguments, "--no-pictures")


@pytest.fixture
def two(recordings_of, tmp_path):
    """A test of two small recordings, which differ in their noise."""
    folder = shutil.copytree(recordings_of("hard-two-revolutions"), tmp_path / "recordings")
    noisy_copy(folder / "rpm_0300.h5", folder / "rpm_0301.h5", 1)
    return folder


def assert_same(one, other):
    """Equal to the last bit, with the same kinds of attributes in the same order."""
    assert list(one.variables) == list(other.variables) and set(one.coords) == set(other.coords)
    for before, after in ((one, other), *((one[name], other[name]) for name in one.variables)):
        assert list(before.attrs) == list(after.attrs)
        for name, value in before.attrs.items():
            assert type(after.attrs[name]) is type(value)
            np.testing.assert_array_equal(after.attrs[name], value)
    for name in one.variables:
        assert one[name].dims == other[name].dims and one[name].dtype == other[name].dtype
        assert one[name].values.tobytes() == other[name].values.tobytes()


def test_every_frame_of_a_recording_comes_back_to_the_last_bit(two, tmp_path):
    plan = plan_tests([two], tmp_path / "out").tests[0]
    made = analyse_recording(plan.recordings[0], plan.manifest, plan.settings)
    store = FrameStore(tmp_path / "store")
    store.save("a", PackedResult.of(made))
    kept = store.load("a")
    assert list(kept.frames) == list(made.frames)
    kept.shaft.attrs["recording"] = kept.shaft["speed"].attrs["units"] = "another's own"
    assert_same(kept.shaft, made.shaft)
    for noun, frames in made.frames.items():
        assert_same(kept.frames[noun], frames)
        assert all(variable.values.flags.writeable for variable in kept.frames[noun].data_vars.values())


def test_odd_attributes_and_shapes_come_back_too(tmp_path):
    attrs = {"recording": "é", "tuple": (1, "a"), "list": [1.5, None], "scalar": np.float32(0.1), "nan": np.nan}
    variables = {"none": ("x", np.empty(0, complex)), "text": ("y", ["é漢", "b"]), "point": ((), np.int8(3))}
    empty = xr.Dataset(variables, attrs=attrs | {"array": np.arange(3), "yes": True})
    store = FrameStore(tmp_path)
    store.save("a", PackedResult.of(RecordingResult(ShaftAngle(empty), {OrderFrames: empty})))
    assert_same(store.load("a").frames[OrderFrames], empty)


def test_a_damaged_file_is_nothing_kept(tmp_path):
    shaft = ShaftAngle(xr.Dataset({"a": ("x", np.arange(9.0))}, attrs={"recording": "a"}))
    store = FrameStore(tmp_path)
    store.save("a", PackedResult.of(RecordingResult(shaft, {})))
    whole = store.path("a").read_bytes()
    for place in range(0, len(whole), 7):
        store.path("a").write_bytes(whole[:place])
        assert store.load("a") is None
        store.path("a").write_bytes(whole[:place] + bytes([whole[place] ^ 16]) + whole[place + 1 :])
        assert store.load("a") is None
    assert store.load("b") is None


def counted(monkeypatch, tmp_path):
    """A file that gets a line for each recording that is analysed."""
    real, log = execute.analyse_recording, tmp_path / "analysed.txt"
    log.write_text("")

    def told(source, *arguments):
        with log.open("a") as stream:
            stream.write(f"{source.name}\n")
        return real(source, *arguments)

    monkeypatch.setattr(execute, "analyse_recording", told)
    return log


def test_only_what_changed_is_analysed_again_and_the_bytes_are_those_of_a_fresh_run(two, tmp_path, monkeypatch):
    log, out, alone = counted(monkeypatch, tmp_path), tmp_path / "out", tmp_path / "alone.toml"
    alone.write_text('[report]\nresults = ["order_map"]\n')

    def run_again(*arguments, recipe="maps"):
        log.write_text("")
        assert run(two, "--out", out, "--recipe", recipe, *arguments).exit_code == 0
        return sorted(log.read_text().split())

    assert len(run_again()) == 2
    shutil.rmtree(out / "two-revolutions")
    assert run_again() == []
    with (two / "rpm_0301.h5").open("ab") as stream:
        stream.write(b"\0")
    assert run_again() == ["rpm_0301.h5"]
    assert len(run_again(recipe=alone)) == 2
    assert len(list((out / STORE).rglob("*.frames"))) == 2
    assert len(run_again("--tol", "1e-2")) == 2  # another accuracy is another analysis
    assert len(run_again("--fresh")) == 2
    run(two, "--out", tmp_path / "fresh", "--recipe", "maps")
    assert results_in(tmp_path / "fresh").keys() <= results_in(out).keys()
    for name, data in results_in(tmp_path / "fresh").items():
        assert name.endswith("done.json") or results_in(out)[name] == data


def test_clean_removes_what_is_kept_and_nothing_else(two, tmp_path):
    said = run(two, "--out", tmp_path / "out", "--recipe", "maps").output
    size = sum(path.stat().st_size for path in (tmp_path / "out" / STORE).rglob("*.frames"))
    assert f"{size / 1e6:.3g} MB" in said
    outcome = crankorder("clean", tmp_path / "out")
    assert outcome.exit_code == 0 and "2 files" in outcome.output
    left = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert left[:3] == [LOGS, "batch.json", "index.html"]
    assert "unchanged" in run(two, "--out", tmp_path / "out", "--recipe", "maps").output


def test_what_is_kept_stays_within_the_size_asked_for_and_the_longest_unused_goes_first(tmp_path):
    for seed in range(20):
        rng, store = np.random.default_rng(seed), tmp_path / str(seed)
        sizes, most, ages = rng.integers(1, 1000, 12), int(rng.integers(0, 7000)), rng.permutation(12) * 100.0 + 50
        store.mkdir()
        for number, (size, age) in enumerate(zip(sizes, ages, strict=True)):
            (store / f"{number}.frames").write_bytes(bytes(size))
            os.utime(store / f"{number}.frames", (time.time() - age,) * 2)
        unused = float(rng.choice([0, 400]))
        removed, size, left = prune([store], most_bytes=most, unused_s=unused)
        stays = {int(path.stem) for path in store.glob("*")}
        assert len(stays) == 12 - removed and size == sum(sizes) - left and left == sum(sizes[sorted(stays)])
        oldest = max([*ages[sorted(stays)], 0])
        assert left <= most or oldest < unused
        gone = [number for number in range(12) if number not in stays]
        assert all(ages[number] > oldest for number in gone)
        # no more than was needed: with the youngest of them it would have been too much
        assert not gone or left + sizes[min(gone, key=ages.__getitem__)] > most


def test_shards_and_their_reduction_give_the_bytes_of_one_run(two, tmp_path, monkeypatch):
    run(two, "--recipe", "maps", "--out", tmp_path / "whole", "-q")
    for k in (2, 1):
        outcome = run(two, "--recipe", "maps", "--out", tmp_path / "out", "--shard", f"{k}/2")
        assert outcome.exit_code == 0 and "kept for --reduce" in outcome.output
        assert results_in(tmp_path / "out") == {}
    log = counted(monkeypatch, tmp_path)
    assert run(two, "--recipe", "maps", "--out", tmp_path / "out", "-q", "--reduce").exit_code == 0
    assert log.read_text() == ""
    assert results_in(tmp_path / "out") == results_in(tmp_path / "whole")


def test_a_shard_that_is_none_is_refused(two, tmp_path):
    for text in ("0/2", "3/2", "1", "a/b", "1/0", "-1/2", "1/2/3", ""):
        outcome = run(two, "--out", tmp_path / "out", "--shard", text)
        assert outcome.exit_code == 2 and "k/n" in outcome.output and not (tmp_path / "out").exists(), text
