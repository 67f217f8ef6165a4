"""Runs that are killed at random moments, and runs that share a folder: nothing lost, nothing mixed."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import h5py
import numpy as np
import pytest

from crankorder.batch.frame_store import STORE
from crankorder.batch.run_log import LOGS
from made.command import results_in
from made.processes import children_of, started

JOBS = 2
RECORDINGS = 4
KILLS = 17


def arguments(*folders, out, jobs=JOBS):
    program = ["-m", "crankorder", "run", *map(str, folders)]
    return [*program, "--recipe", "maps", "-q", "--log-json", "--jobs", str(jobs), "--out", str(out)]


def run(*folders, out, jobs=JOBS):
    subprocess.run([sys.executable, *arguments(*folders, out=out, jobs=jobs)], check=True)


def events(out):
    """Whole lines of the log of the last run."""
    lines = sorted((out / LOGS).iterdir())[-1].read_bytes().splitlines(keepends=True)
    return [json.loads(line) for line in lines if line.endswith(b"\n")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A test of a few recordings of two revolutions, which differ in their noise."""
    place: Path = tmp_path_factory.mktemp("scene") / "test"
    made = [sys.executable, "-m", "crankorder", "synth", "hard-two-revolutions", "--quick", "-q", "--out", str(place)]
    subprocess.run(made, check=True)
    (first,) = place.glob("*.h5")
    for number in range(1, RECORDINGS):
        other = place / f"rpm_{300 + number:04d}.h5"
        shutil.copy(first, other)
        with h5py.File(other, "r+") as file:
            for name, item in file.items():
                if name.startswith("acc"):
                    item[...] += 0.01 * np.random.default_rng(number).standard_normal(item.shape).astype(item.dtype)
    return place


@pytest.fixture(scope="module")
def undisturbed(folder, tmp_path_factory):
    """Results of a run that nobody disturbed, and the seconds that one took."""
    out = tmp_path_factory.mktemp("undisturbed")
    run(folder, out=out / "warm")
    begun = time.monotonic()
    run(folder, out=out / "whole")
    return out / "whole", time.monotonic() - begun


def kill(process, which, at_s):
    """Kill one process of the run at that moment, or as soon as there is one; False where the run ended before."""
    time.sleep(at_s)
    while process.poll() is None:
        of_run = children_of(process.pid)
        victims = {"main": [process.pid], "reporting": of_run[:1], "recording": of_run[1:]}[which]
        if victims:
            os.kill(victims[-1], signal.SIGKILL)
            return True
        time.sleep(0.002)
    return False


@pytest.mark.slow
@pytest.mark.parametrize("which", ["main", "reporting", "recording"])
@pytest.mark.parametrize("number", range(KILLS))
def test_f1_i6_whichever_process_is_killed_the_next_run_ends_with_the_same_bytes(
    folder, undisturbed, tmp_path, which, number
):
    whole, seconds = undisturbed
    random = np.random.default_rng([number, len(which)])
    out = tmp_path / "out"
    with started(*arguments(folder, out=out), stderr=subprocess.PIPE) as process:
        struck = kill(process, which, float(random.uniform(0.1, 0.9)) * seconds)
        said = process.communicate()[1].decode()
    assert process.returncode in ((-signal.SIGKILL, 0) if which == "main" else (0, 3)), said
    assert "Traceback" not in said
    test = out / "two-revolutions"
    if test.exists():
        assert (test / "done.json").exists()
    kept = {path.name for path in (out / STORE).rglob("*.frames")}
    told = sum(event["event"] == "recording computed" for event in events(out)) if (out / LOGS).exists() else 0
    assert told <= len(kept)
    run(folder, out=out)
    again = sum(event["event"] == "recording computed" for event in events(out))
    assert again <= RECORDINGS - len(kept)
    assert again <= RECORDINGS - told
    assert results_in(out, kept=True) == results_in(whole, kept=True)
    print(f"{which} {number}: struck {struck}, status {process.returncode}, kept {len(kept)}, computed again {again}")


@pytest.mark.parametrize(
    ("processes", "rounds"), [(2, 1), *(pytest.param(n, 50, marks=pytest.mark.slow) for n in (2, 4))]
)
def test_i5_processes_that_share_a_folder_of_results_lose_nothing(folder, tmp_path, processes, rounds):
    """Each analyses two tests, in an order of its own: no false failure, every index entry, the bytes of one alone."""
    two = [tmp_path / "data" / name for name in ("a", "b")]
    for place in two:
        place.mkdir(parents=True)
        shutil.copy(folder / "rpm_0300.h5", place)
        text = (folder / "run.toml").read_text(encoding="utf-8").replace('"two revolutions"', f'"{place.name}"')
        (place / "run.toml").write_text(text, encoding="utf-8")
    run(*two, out=tmp_path / "alone", jobs=1)
    alone = results_in(tmp_path / "alone", kept=True)
    for number in range(rounds):
        out = tmp_path / f"out-{number}"
        with ExitStack() as those:
            lines = [arguments(*two[:: (-1) ** turn], out=out, jobs=1) for turn in range(processes)]
            running = [those.enter_context(started(*line, stderr=subprocess.PIPE)) for line in lines]
            for process in running:
                said = process.communicate()[1]
                assert process.returncode == 0, said
        assert results_in(out, kept=True) == alone, number
        assert [test["name"] for test in json.loads((out / "batch.json").read_bytes())["tests"]] == ["a", "b"]
        shutil.rmtree(out)
