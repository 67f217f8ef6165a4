"""A Dask cluster of a scheduler and two workers, started here: the bytes of a run at home, whoever dies meanwhile."""

import json
import os
import time
from contextlib import ExitStack

import pytest

from crankorder.batch.frame_store import STORE
from crankorder.batch.run_log import LOGS
from made.command import crankorder, done, results_in
from made.processes import PATIENCE_S, started

pytest.importorskip("distributed", reason="the extra dist is not installed")
pytestmark = pytest.mark.slow
KILLER = "rpm_1600.h5"
PRELOAD = f"""
import os, signal
from crankorder.batch import cluster

def analyse(source, *arguments, real=cluster.analyse_recording):
    if source.name == "{KILLER}" and os.path.exists(os.environ["KILLS"]):
        os.kill(os.getpid(), signal.SIGKILL)
    return real(source, *arguments)

def shares(job, real=cluster._shares_store):
    return not os.path.exists(os.environ["FAR"]) and real(job)

if cluster.analyse_recording.__name__ != "analyse":  # a worker may load this twice
    cluster.analyse_recording, cluster._shares_store = analyse, shares
"""


class Cluster:
    """Processes of a cluster in ``folder``: whether recordings kill their workers, and workers see the store."""

    def __init__(self, folder, processes):
        self.kills, self.far, at = folder / "kills", folder / "far", folder / "scheduler.json"
        (folder / "preload.py").write_text(PRELOAD)
        self._folder, self._processes = folder, processes
        self._start("dask_scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", at)
        end = time.monotonic() + PATIENCE_S
        while not at.exists() or not at.read_text().rstrip().endswith("}"):
            assert time.monotonic() < end, (folder / "said.txt").read_text()
            time.sleep(0.1)
        self.address = json.loads(at.read_text())["address"]
        for name in "ab":
            preload = ("--preload", folder / "preload.py", "--local-directory", folder / f"of-{name}")
            self._start("dask_worker", self.address, "--nthreads", "1", "--no-dashboard", "--name", name, *preload)

    def run(self, folder, out):
        """What a run of the maps of ``folder`` on the cluster says."""
        return crankorder("run", folder, "--out", out, "--recipe", "maps", "--scheduler", self.address, "--log-json")

    def _start(self, command, *arguments):
        surroundings = {**os.environ, "KILLS": str(self.kills), "FAR": str(self.far), "OPENBLAS_NUM_THREADS": "1"}
        # whatever stands beside a death is blamed at once: so it must be tried again alone
        surroundings["DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES"] = "0"
        with (self._folder / "said.txt").open("ab") as said:
            line = ("-m", f"distributed.cli.{command}", *arguments)
            self._processes.enter_context(started(*line, stdout=said, stderr=said, env=surroundings))


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    with ExitStack() as processes:
        yield Cluster(tmp_path_factory.mktemp("cluster"), processes)


@pytest.fixture
def four(copied):
    return copied(1500, 1600, 1700, 1800)


def reused(out):
    return sum(path.read_text().count('"recording reused"') for path in (out / LOGS).iterdir())


@pytest.mark.parametrize("far", [False, True])
def test_a_cluster_gives_the_bytes_of_a_run_at_home(cluster, four, tmp_path, far):
    if far:
        cluster.far.touch()
    home, there = tmp_path / "home", tmp_path / "there"
    done("run", four, "--out", home, "--recipe", "maps")
    try:
        outcome = cluster.run(four, there)
    finally:
        cluster.far.unlink(missing_ok=True)
    assert outcome.exit_code == 0, outcome.output
    assert results_in(there) == results_in(home)
    assert reused(there) == 4  # all of it was made by the workers
    assert not list((there / STORE).rglob("*.probe"))


def test_a_recording_that_kills_its_workers_is_blamed_and_the_others_are_finished(cluster, four, tmp_path):
    cluster.kills.touch()
    out = tmp_path / "out"
    try:
        outcome = cluster.run(four, out)
    finally:
        cluster.kills.unlink()
    assert outcome.exit_code == 3, outcome.output
    (test,) = json.loads((out / "batch.json").read_bytes())["tests"]
    assert [one["recording"] for one in test["failed"]] == [KILLER]
    assert "tried alone" in test["failed"][0]["error"]
    assert reused(out) == 3


def test_no_scheduler_is_told(four, tmp_path):
    outcome = crankorder("run", four, "--out", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9")
    assert outcome.exit_code == 5, outcome.output
    assert "no Dask scheduler" in outcome.output and "dask scheduler" in outcome.output


def test_a_cluster_shares_recordings_out_itself(four, tmp_path):
    for other in (("--shard", "1/2"), ("--timeout", "5")):
        outcome = crankorder("run", four, "--out", tmp_path / "out", "--scheduler", "tcp://a:1", *other)
        assert outcome.exit_code == 2
    assert not (tmp_path / "out").exists()
