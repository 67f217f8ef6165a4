"""Runs in an interpreter that has already analysed the reference campaign once, as a notebook has them.

Usage: python benchmarks/warm_run.py RECORDINGS OUT
Does a default run, which loads and compiles, then a second default run and a run for the maps, and prints of these two
the wall seconds and the processor seconds of all processes: "default: 3.21 s, 5.43 s of the processor".
"""

from __future__ import annotations

import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # before numpy loads; as the command line has it

import resource
import sys
import time
from pathlib import Path

import crankorder


def processor_seconds() -> float:
    """Of this process and of those that it started and that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def main() -> None:
    recordings, out = sys.argv[1], Path(sys.argv[2])
    crankorder.run(recordings, out=out / "first")
    for name, recipe in (("default", None), ("maps", "maps")):
        start, before = time.perf_counter(), processor_seconds()
        crankorder.run(recordings, out=out / name, recipe=recipe)
        seconds, processor = time.perf_counter() - start, processor_seconds() - before
        print(f"{name}: {seconds:.3f} s, {processor:.3f} s of the processor")


if __name__ == "__main__":
    main()
