"""A Dask cluster of a scheduler and two workers, started here: the bytes of a run at home, whoever dies meanwhile."""

import json
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from click.testing import CliRunner

from crankorder.batch.frame_store import STORE
from crankorder.batch.run_log import LOGS
from crankorder.cli import main
from made.processes import PATIENCE_S, started

pytest.importorskip("distributed", reason="the extra dist is not installed")
pytestmark = pytest.mark.slow
NAMES = ("run.toml", "rpm_1500.h5", "rpm_1600.h5", "rpm_1700.h5", "rpm_1800.h5")
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

    def __init__(self, folder: Path, processes: ExitStack) -> None:
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

    def _start(self, command: str, *arguments: object) -> None:
        surroundings = {**os.environ, "KILLS": str(self.kills), "FAR": str(self.far), "OPENBLAS_NUM_THREADS": "1"}
        # whatever stands beside a death is blamed at once: so it must be tried again alone
        surroundings["DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES"] = "0"
        with (self._folder / "said.txt").open("ab") as said:
            line = ("-m", f"distributed.cli.{command}", *arguments)
            self._processes.enter_context(started(*line, stdout=said, stderr=said, env=surroundings))


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with ExitStack() as processes:
        yield Cluster(tmp_path_factory.mktemp("cluster"), processes)


@pytest.fixture(scope="module")
def four(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    for name in NAMES:
        shutil.copy(campaign / name, folder / name)
    return folder


def crankorder(*arguments: object) -> tuple[int, str]:
    made = CliRunner().invoke(main, [str(argument) for argument in arguments])
    return made.exit_code, made.output


def results_in(out: Path) -> dict[str, bytes]:
    files = [path for path in out.rglob("*") if path.is_file() and not path.relative_to(out).parts[0].startswith(".")]
    return {str(path.relative_to(out)): path.read_bytes() for path in files if path.name != "timings.json"}


def reused(out: Path) -> int:
    events = [json.loads(line) for path in (out / LOGS).iterdir() for line in path.read_text().splitlines()]
    return sum(event["event"] == "recording reused" for event in events)


@pytest.mark.parametrize("far", [False, True])
def test_a_cluster_gives_the_bytes_of_a_run_at_home(cluster: Cluster, four: Path, tmp_path: Path, far: bool) -> None:
    if far:
        cluster.far.touch()
    try:
        home, there = tmp_path / "home", tmp_path / "there"
        assert crankorder("run", four, "--out", home, "--recipe", "maps")[0] == 0
        status, said = crankorder(
            "run", four, "--out", there, "--recipe", "maps", "--scheduler", cluster.address, "--log-json"
        )
    finally:
        cluster.far.unlink(missing_ok=True)
    assert status == 0, said
    assert results_in(there) == results_in(home)
    assert reused(there) == 4  # all of it was made by the workers
    assert not list((there / STORE).rglob("*.probe"))


def test_a_recording_that_kills_its_workers_is_blamed_and_the_others_are_finished(
    cluster: Cluster, four: Path, tmp_path: Path
) -> None:
    cluster.kills.touch()
    out = tmp_path / "out"
    try:
        status, said = crankorder(
            "run", four, "--out", out, "--recipe", "maps", "--scheduler", cluster.address, "--log-json"
        )
    finally:
        cluster.kills.unlink()
    assert status == 3, said
    (test,) = json.loads((out / "batch.json").read_bytes())["tests"]
    assert [one["recording"] for one in test["failed"]] == [KILLER]
    assert "tried alone" in test["failed"][0]["error"]
    assert reused(out) == 3


def test_no_scheduler_is_told(four: Path, tmp_path: Path) -> None:
    status, said = crankorder("run", four, "--out", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9")
    assert status == 5, said
    assert "no Dask scheduler" in said and "dask scheduler" in said


def test_a_cluster_shares_recordings_out_itself(four: Path, tmp_path: Path) -> None:
    for other in (("--shard", "1/2"), ("--timeout", "5")):
        assert crankorder("run", four, "--out", tmp_path / "out", "--scheduler", "tcp://a:1", *other)[0] == 2
    assert not (tmp_path / "out").exists()
