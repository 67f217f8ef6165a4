"""Runs that are killed at random moments, and runs that share a folder: nothing lost, nothing mixed."""

import json
import shutil
import subprocess
import time
from contextlib import ExitStack

import pytest

from crankorder.batch.frame_store import STORE
from crankorder.batch.run_log import LOGS
from made.command import done, results_in
from made.processes import started
from made.recordings import noisy_copy

RECORDINGS = 4


def arguments(*folders, out, jobs):
    return ("run", *folders, "--recipe", "maps", "-q", "--log-json", "--jobs", jobs, "--out", out)


def events(out):
    """Events in whole lines of the log of the last run."""
    lines = sorted((out / LOGS).iterdir())[-1].read_bytes().splitlines(keepends=True)
    return [json.loads(line)["event"] for line in lines if line.endswith(b"\n")]


@pytest.fixture(scope="module")
def folder(recordings_of, tmp_path_factory):
    """A test of a few recordings of two revolutions, which differ in their noise."""
    place = shutil.copytree(recordings_of("hard-two-revolutions"), tmp_path_factory.mktemp("scene") / "test")
    for number in range(1, RECORDINGS):
        noisy_copy(place / "rpm_0300.h5", place / f"rpm_{300 + number:04d}.h5", number)
    return place


@pytest.fixture(scope="module")
def undisturbed(folder, tmp_path_factory):
    """Results of a run that nobody disturbed, and the seconds that one took."""
    out, begun = tmp_path_factory.mktemp("undisturbed") / "whole", time.monotonic()
    with started("-m", "crankorder", *arguments(folder, out=out, jobs=2)) as process:
        assert process.wait() == 0
    return out, time.monotonic() - begun


@pytest.mark.slow
@pytest.mark.parametrize("number", range(8))
def test_f1_i6_after_a_run_that_was_killed_at_any_moment_the_next_ends_with_the_same_bytes(
    folder, undisturbed, tmp_path, number
):
    (whole, seconds), out = undisturbed, tmp_path / "out"
    with started("-m", "crankorder", *arguments(folder, out=out, jobs=2), stderr=subprocess.PIPE) as process:
        time.sleep((0.1 + 0.1 * number) * seconds)
        process.kill()
        assert b"Traceback" not in process.communicate()[1]
    test = out / "two-revolutions"
    assert not test.exists() or (test / "done.json").exists()
    kept = {path.name for path in (out / STORE).rglob("*.frames")}
    told = events(out).count("recording computed") if (out / LOGS).exists() else 0
    assert told <= len(kept)
    done(*arguments(folder, out=out, jobs=2))
    assert events(out).count("recording computed") <= RECORDINGS - len(kept)
    assert results_in(out, kept=True) == results_in(whole, kept=True)


def test_i5_processes_that_share_a_folder_of_results_lose_nothing(folder, tmp_path):
    """Each analyses two tests, in an order of its own: no false failure, every index entry, the bytes of one alone."""
    two, out = [tmp_path / "data" / name for name in ("a", "b")], tmp_path / "out"
    for place in two:
        place.mkdir(parents=True)
        shutil.copy(folder / "rpm_0300.h5", place)
        text = (folder / "run.toml").read_text(encoding="utf-8").replace('"two revolutions"', f'"{place.name}"')
        (place / "run.toml").write_text(text, encoding="utf-8")
    with ExitStack() as those:
        lines = [("-m", "crankorder", *arguments(*order, out=out, jobs=1)) for order in (two, two[::-1])]
        for process in [those.enter_context(started(*line, stderr=subprocess.PIPE)) for line in lines]:
            said = process.communicate()[1]
            assert process.returncode == 0, said
    done(*arguments(*two, out=tmp_path / "alone", jobs=1))
    assert results_in(out, kept=True) == results_in(tmp_path / "alone", kept=True)
    assert [test["name"] for test in json.loads((out / "batch.json").read_bytes())["tests"]] == ["a", "b"]
