"""Records of 30 s, 5 min and 30 min: memory and processor time of a whole run, streamed from disk and held in memory.

Usage: python benchmarks/long_recordings.py
Writes `reports/speed-error/long-recordings.{png,md,json}`. The records (2.1 GB) are made in the folder for temporary
files and removed. Memory is what no file on a disk backs (RssAnon and RssShmem of Linux), of the process of the run
that has most of it.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from published import publish, table
from whole_process import watched

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from made.long_recordings import NAMES, write_long

SECONDS = (30.0, 300.0, 1800.0)
RATE_HZ = 50_000.0
WAYS = {"streamed": 50, "in memory": 8000}
"""Megabytes that --max-memory allows."""
COLOURS = {"streamed": "#1f77b4", "in memory": "#d95f02"}
MB_PER_S = RATE_HZ * len(NAMES) * 4e-6
TICK_S = 0.01


def measured(folder: Path, out: Path, max_memory_mb: int) -> dict[str, float]:
    """Peak memory [MB] of the largest process and processor time [s] of a run for the maps."""
    command = [sys.executable, "-m", "crankorder", "run", str(folder), "--out", str(out), "--recipe", "maps"]
    command += ["--jobs", "1", "--fresh", "-q", "--max-memory", str(max_memory_mb)]
    seen = watched(command, tick_s=TICK_S, together=False)
    return {"memory_mb": round(seen.largest_mb, 1), "cpu_s": round(seen.processor_seconds, 2)}


def difference(ours: Path, theirs: Path) -> float:
    """Largest difference of two runs' maps over the largest number of the map."""
    largest = 0.0
    for group in ("order_map", "campbell_map"):
        with (
            xr.open_dataset(ours / "long" / "results.nc", group=group, engine="h5netcdf") as one,
            xr.open_dataset(theirs / "long" / "results.nc", group=group, engine="h5netcdf") as other,
        ):
            a, b = one["amplitude"].values, other["amplitude"].values
            largest = max(largest, float(np.abs(a - b).max() / np.abs(b).max()))
    return largest


def slope(rows: list[dict[str, float]], way: str, what: str) -> float:
    """Growth of ``what`` per second of record between the two longest records."""
    return (rows[-1][f"{way}, {what}"] - rows[-2][f"{way}, {what}"]) / (rows[-1]["seconds"] - rows[-2]["seconds"])


def figure_of(rows: list[dict[str, float]]) -> Figure:
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    minutes = [row["seconds"] / 60.0 for row in rows]
    memory, cpu = figure.subplots(1, 2)
    memory.plot(minutes, [row["samples_mb"] for row in rows], ":", color="black", label="samples of the record")
    for way in WAYS:
        memory.plot(minutes, [row[f"{way}, memory_mb"] for row in rows], "o-", color=COLOURS[way], label=way)
        cpu.plot(minutes, [row[f"{way}, cpu_s"] for row in rows], "o-", color=COLOURS[way], label=way)
    memory.set_title("Peak memory of the largest process")
    memory.set_ylabel("MB that no file on a disk backs")
    cpu.set_title("Processor time of the whole run")
    cpu.set_ylabel("s")
    for axes in (memory, cpu):
        axes.set_xlabel("length of the record [min]")
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
        axes.legend(loc="upper left")
    return figure


def main() -> None:
    rows = []
    with tempfile.TemporaryDirectory(dir="/var/tmp") as place:
        for seconds in SECONDS:
            folder = write_long(Path(place) / f"{seconds:g}", seconds, rate_hz=RATE_HZ)
            row: dict[str, float] = {"seconds": seconds, "samples_mb": round(seconds * MB_PER_S)}
            outs = {way: Path(place) / f"{seconds:g} {way}" for way in WAYS}
            for way, max_memory_mb in WAYS.items():
                row |= {f"{way}, {key}": v for key, v in measured(folder, outs[way], max_memory_mb).items()}
            row["difference"] = difference(outs["streamed"], outs["in memory"])
            (folder / "long.h5").unlink()
            rows.append(row)
    growth = {
        f"{way}, {what} per s": round(slope(rows, way, what), 4) for way in WAYS for what in ("memory_mb", "cpu_s")
    }
    publish("long-recordings", {"rows": rows, "growth": growth}, page_of(rows, growth), figure_of(rows))


def page_of(rows: list[dict[str, float]], growth: dict[str, float]) -> str:
    header = ["record [s]", "samples [MB]", "streamed: memory [MB]", "in memory: memory [MB]", "streamed: CPU [s]"]
    header += ["in memory: CPU [s]", "largest difference of the maps"]
    keys = ("seconds", "samples_mb", "streamed, memory_mb", "in memory, memory_mb", "streamed, cpu_s")
    keys += ("in memory, cpu_s", "difference")
    return f"""# Recordings larger than memory

Whole runs (`--recipe maps --jobs 1`) of one record: 3 channels, encoder of 60 pulses and index, 50 kHz, float32;
streamed with `--max-memory 50`. Memory is what no file on a disk backs, of the process that has most of
it. Made by `benchmarks/long_recordings.py`.

{table(header, [[f"{row[key]:g}" for key in keys] for row in rows])}

Between the two longest, memory grows by {growth["streamed, memory_mb per s"]:.2f} MB per second of record when
streamed, by {growth["in memory, memory_mb per s"]:.2f} MB in memory; the samples are {MB_PER_S:.2f} MB. What still
grows are results, no samples: the pulses with what the shaft's angle is worked out from, and the spectra of all frames,
which the worker hands over in shared memory. The processor takes {growth["streamed, cpu_s per s"] * 1e3:.1f} ms per
second of record when streamed, {growth["in memory, cpu_s per s"] * 1e3:.1f} ms in memory.
"""


if __name__ == "__main__":
    main()
