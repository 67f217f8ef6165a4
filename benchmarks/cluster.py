"""What a Dask cluster costs: processor time per task in scheduler and client, bytes moved, one worker against two.

Usage: python benchmarks/cluster.py FOLDER (a test of some hundred recordings, as benchmarks/many_recordings.py makes)
Prints what docs/cluster.md quotes. The cluster runs on this machine; every worker has one thread.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from distributed import Client

from crankorder.batch.cluster import ClusterJob, ClusterTask
from crankorder.batch.frame_store import FrameStore
from crankorder.batch.plan import plan_tests
from crankorder.batch.store import code_sha256, library_versions

EMPTY_TASKS = 2000


def started(folder: Path, workers: int) -> tuple[str, list[subprocess.Popen[bytes]]]:
    """Address and processes of a cluster of so many ``workers``, whose files go into ``folder``."""
    at = folder / f"scheduler-{workers}.json"
    surroundings = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}

    def start(command: str, *arguments: object) -> subprocess.Popen[bytes]:
        line = [sys.executable, "-m", f"distributed.cli.{command}", *map(str, arguments), "--no-dashboard"]
        return subprocess.Popen(line, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=surroundings)

    made = [start("dask_scheduler", "--port", "0", "--scheduler-file", at)]
    while not at.exists() or not at.read_text().rstrip().endswith("}"):
        time.sleep(0.1)
    address = json.loads(at.read_text())["address"]
    for number in range(workers):
        made.append(start("dask_worker", address, "--nthreads", "1", "--local-directory", folder / f"of-{number}"))
    return address, made


def processor_s(pid: int) -> float:
    """Processor seconds of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def nothing(job: bytes, number: int) -> None:
    """A task that does nothing with what it was sent."""


def overhead(address: str, scheduler: int, job: bytes) -> None:
    """Print what a task costs that does nothing."""
    with Client(address) as client:
        client.wait_for_workers(1)
        client.submit(nothing, job, -1).result()
        begun, before, there = time.monotonic(), time.process_time(), processor_s(scheduler)
        for first in range(0, EMPTY_TASKS, 64):
            client.gather([client.submit(nothing, job, first + k, pure=False) for k in range(64)])
        wall, here, there = time.monotonic() - begun, time.process_time() - before, processor_s(scheduler) - there
    each = 1e3 / EMPTY_TASKS
    print(
        f"an empty task: {wall * each:.2f} ms; processor: client {here * each:.2f} ms, scheduler {there * each:.2f} ms"
    )


def main() -> None:
    """Print all of it."""
    folder = Path(sys.argv[1])
    with tempfile.TemporaryDirectory() as place:
        out = Path(place)
        plan = plan_tests([folder], out / "planned", recipe="maps").tests[0]
        made_by = (code_sha256(), library_versions())
        store = FrameStore.of(plan.out)
        job = pickle.dumps(ClusterJob(plan.manifest, plan.settings, None, made_by, store, (out / "a", bytes(32))))
        task = ClusterTask(plan.recordings[0].resolve(), "a", "0" * 64, {plan.recordings[0].resolve(): "0" * 64})
        print(f"{len(plan.recordings)} recordings; to a worker: {len(job) + len(pickle.dumps(task))} bytes a task")
        for workers in (1, 2):
            address, processes = started(out, workers)
            try:
                if workers == 1:
                    overhead(address, processes[0].pid, job)
                results = out / f"results-{workers}"
                command = [Path(sys.executable).with_name("crankorder"), "run", folder, "--recipe", "maps", "-q"]
                begun = time.monotonic()
                command += ["--out", results, "--scheduler", address, "--log-json"]
                subprocess.run(list(map(str, command)), check=True)
                log = next((results / ".crankorder-logs").iterdir()).read_text().splitlines()
                spent = next(event["seconds"] for event in map(json.loads, log) if event["event"] == "cluster")
                print(
                    f"{workers} workers: {spent:.1f} s on the cluster, {time.monotonic() - begun:.1f} s in all; load "
                    f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
                )
                size = [path.stat().st_size for path in results.rglob("*.frames")]
            finally:
                for process in processes[::-1]:
                    process.terminate()
                    process.wait()
        print(f"from a worker without the store: {sum(size) / len(size):.0f} bytes a recording; with it: none")


if __name__ == "__main__":
    main()
