"""Runs in an interpreter that has already analysed the reference campaign once, as a notebook has them.

Usage: python benchmarks/warm_run.py RECORDINGS OUT
Does a default run, which loads and compiles, then a second default run and a run for the maps, and prints of these two
the wall seconds and the processor seconds of all processes: "default: 3.21 s, 5.43 s of the processor". Last the
processor seconds of `order_map` and `campbell_map` on the arrays of a recording beside those of plain scipy's spectra,
medians of turns: "arrays: 0.025 s, scipy 0.110 s of the processor".
"""

from __future__ import annotations

import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # before numpy loads; as the command line has it

import resource
import statistics
import sys
import time
from pathlib import Path

import h5py
from plain_scipy import PULSES_PER_REV, channels_of, spectra

import crankorder

TURNS = 9


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
    ours, theirs = on_arrays(Path(recordings))
    print(f"arrays: {ours:.4f} s, scipy {theirs:.4f} s of the processor")


def on_arrays(recordings: Path) -> tuple[float, float]:
    """Processor seconds of both maps of a recording of the middle of ``recordings``, by crankorder and by scipy."""
    paths = sorted(recordings.glob("*.h5"))
    path = paths[len(paths) // 2]
    names = channels_of(path)
    with h5py.File(path) as file:
        rate = float(file.attrs["rate_hz"])
        signals, encoder = {name: file[name][:] for name in names}, file["encoder"][:]

    def ours() -> None:
        made = crankorder.recording(
            signals, rate_hz=rate, encoder=encoder, pulses_per_rev=PULSES_PER_REV, cycle="four-stroke"
        )
        crankorder.order_map(made)
        crankorder.campbell_map(made)

    def theirs() -> None:
        spectra(list(signals.values()), encoder, rate)

    taken: tuple[list[float], list[float]] = [], []
    for _ in range(TURNS + 1):
        for call, seconds in zip((ours, theirs), taken, strict=True):
            start = time.process_time()
            call()
            seconds.append(time.process_time() - start)
    return statistics.median(taken[0][1:]), statistics.median(taken[1][1:])


if __name__ == "__main__":
    main()
