"""Reading beside the libraries of the formats: seconds of both, taken in turns, and their ratio.

Usage: python benchmarks/reading.py [--seconds S] [--channels N] [--turns N]
Each file holds the same channels at 50 kHz. Beside `read_file`, which gives float columns, stands the shortest code of
the format's own library that gives all channels as arrays. The ratio is the median over turns of library over ours: 0.8
is four fifths of the library's speed. Files are in the page cache. Prints a table.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import scipy.io
from numpy.typing import NDArray
from scipy.io import wavfile

from crankorder.ingest.formats import contents_of, read_file
from crankorder.settings import load_settings

RATE_HZ = 50_000
Columns = dict[str, NDArray[np.float32]]


def write_files(folder: Path, made: Columns) -> dict[str, Callable[[], Any]]:
    """Files of ``made`` in ``folder``, and by name of the file what reads it with the format's own library."""
    import asammdf
    import nptdms

    names, block = list(made), np.column_stack(list(made.values()))
    with h5py.File(folder / "a.h5", "w") as file:
        for name in names:
            file[name] = made[name]
    wavfile.write(folder / "a.wav", RATE_HZ, block)
    np.save(folder / "a.npy", block)
    scipy.io.savemat(folder / "a.mat", made)
    pd.DataFrame(made).to_csv(folder / "a.csv", index=False, float_format="%.7g")
    with nptdms.TdmsWriter(str(folder / "a.tdms")) as file:
        step = {"wf_increment": 1.0 / RATE_HZ}
        file.write_segment([nptdms.ChannelObject("g", name, made[name], properties=step) for name in names])
    with asammdf.MDF(version="4.10") as file:
        stamps = np.arange(len(block)) / RATE_HZ
        file.append([asammdf.Signal(made[name], stamps, name=name) for name in names])
        file.save(folder / "a.mf4")

    def hdf5() -> Any:
        with h5py.File(folder / "a.h5") as file:
            return [file[name][:] for name in names]

    def tdms() -> Any:
        with nptdms.TdmsFile.open(folder / "a.tdms") as file:
            return [channel[:] for channel in file["g"].channels()]

    def mdf() -> Any:
        with asammdf.MDF(folder / "a.mf4") as file:
            return [file.get(name).samples for name in names]

    return {
        "a.h5": hdf5,
        "a.wav": lambda: np.ascontiguousarray(wavfile.read(folder / "a.wav")[1].T),
        "a.npy": lambda: np.ascontiguousarray(np.load(folder / "a.npy").T),
        "a.mat": lambda: scipy.io.loadmat(folder / "a.mat"),
        "a.csv": lambda: pd.read_csv(folder / "a.csv").to_numpy().T.copy(),
        "a.tdms": tdms,
        "a.mf4": mdf,
    }


def seconds(task: Callable[[], Any]) -> float:
    """Seconds of wall that ``task`` takes."""
    begun = time.perf_counter()
    task()
    return time.perf_counter() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--channels", type=int, default=4)
    parser.add_argument("--turns", type=int, default=5)
    asked = parser.parse_args()
    rng, settings = np.random.default_rng(1), load_settings().ingest
    size = round(asked.seconds * RATE_HZ)
    made = {f"c{number}": rng.standard_normal(size).astype(np.float32) for number in range(asked.channels)}
    print(f"{asked.channels} channels of {size} samples, {asked.turns} turns, medians")
    print(f"{'file':8s} {'library s':>10s} {'ours s':>10s} {'ratio':>7s}")
    with tempfile.TemporaryDirectory() as work:
        for name, by_library in write_files(Path(work), made).items():
            path = Path(work) / name
            wanted = [
                column for column in contents_of(path, settings=settings).names if column.startswith(("c", "0", "1"))
            ]
            sources = wanted[: asked.channels] if name not in ("a.wav", "a.npy") else list(range(asked.channels))
            pairs = []
            for _ in range(asked.turns + 1):
                ours = seconds(lambda path=path, sources=sources: read_file(path, sources=sources, settings=settings))
                pairs.append((seconds(by_library), ours))
            library_s, ours_s = (statistics.median(column) for column in zip(*pairs[1:], strict=True))
            ratio = statistics.median(library / ours for library, ours in pairs[1:])
            print(f"{name:8s} {library_s:10.4f} {ours_s:10.4f} {ratio:7.2f}")


if __name__ == "__main__":
    main()
