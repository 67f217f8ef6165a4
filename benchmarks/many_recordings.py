"""Thousands of recordings in one test: memory of every process over time, seconds of planning, kept files.

Usage: python benchmarks/many_recordings.py COUNT [FOLDER] [--small] [options of `crankorder run`]
Makes COUNT recordings of 1 s in FOLDER (a temporary one without it; what is there is taken as it is), cut from the
reference campaign and each with noise of its own, runs them, and prints a line every five seconds and the largest of
all. With --small each has one channel and a wheel of 12 pulses at 6 kHz: ten thousand are done in a lunch break.
Memory is what no file on a disk backs (RssAnon and RssShmem of Linux), and beside it what is mapped from files.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

SECONDS = 1.0
LEAST_RPM = 1000
TICK_S = 0.2
SMALL_RATE_HZ, SMALL_PULSES = 6000.0, 12
SMALL_MANIFEST = f"""schema_version = 1
[test]
name = "many small ones"
cycle = "rotor"
[recordings]
files = ["rpm_*.h5"]
[[channels]]
name = "Z"
source = "acc_z"
unit = "m/s2"
[encoder]
source = "encoder"
kind = "square"
pulses_per_rev = {SMALL_PULSES}
"""


def make_small(count: int, folder: Path) -> None:
    """Write ``count`` recordings of one channel at 35 speeds, and their manifest, into ``folder``."""
    (folder / "run.toml").write_text(SMALL_MANIFEST, encoding="utf-8")
    time_s = np.arange(round(SECONDS * SMALL_RATE_HZ)) / SMALL_RATE_HZ
    for number in range(count):
        random = np.random.default_rng(number)
        turns = (1000.0 + 50.0 * (number % 35)) / 60.0 * time_s + random.uniform()
        level = sum(np.cos(2.0 * np.pi * order * turns) / order for order in (1.0, 2.0, 5.5))
        with h5py.File(folder / f"rpm_{number:06d}.h5", "w") as file:
            file.attrs["rate_hz"] = SMALL_RATE_HZ
            file["acc_z"] = (level + 0.1 * random.standard_normal(len(time_s))).astype(np.float32)
            file["encoder"] = ((turns * SMALL_PULSES) % 1.0 < 0.5).astype(np.uint8)


def make(count: int, folder: Path) -> None:
    """Write ``count`` recordings and their manifest into ``folder``."""
    with tempfile.TemporaryDirectory() as place:
        whole = Path(place) / "reference"
        subprocess.run([program(), "synth", "thesis-second-motoring", "--out", whole, "-q"], check=True)
        sources = [path for path in sorted(whole.glob("*.h5")) if int(path.stem.split("_")[1]) >= LEAST_RPM]
        shutil.copy(whole / "run.toml", folder / "run.toml")
        bases = [_read(path) for path in sources]
    for number in range(count):
        arrays, attrs, top = bases[number % len(bases)]
        random = np.random.default_rng(number)
        length = round(SECONDS * float(top["rate_hz"]))
        first = int(random.integers(0, len(next(iter(arrays.values()))) - length))
        with h5py.File(folder / f"rpm_{number:06d}.h5", "w") as file:
            file.attrs.update(top)
            for name, values in arrays.items():
                part = values[first : first + length]
                if name.startswith("acc"):
                    part = part + np.float32(0.01) * random.standard_normal(length, dtype=np.float32)
                file.create_dataset(name, data=part).attrs.update(attrs[name])


def _read(path: Path):  # type: ignore[no-untyped-def]
    with h5py.File(path) as file:
        arrays = {name: item[:] for name, item in file.items()}
        return arrays, {name: dict(item.attrs) for name, item in file.items()}, dict(file.attrs)


def program() -> Path:
    """The command of this interpreter's environment."""
    return Path(sys.executable).with_name("crankorder")


def memory_mb(pid: int) -> tuple[float, float]:
    """Memory of a process that no file backs, and what is mapped from files [MB]; zeros where it has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0.0, 0.0
    of = {line.split(":")[0]: int(line.split()[1]) / 1e3 for line in lines if line.startswith("Rss")}
    return of.get("RssAnon", 0.0) + of.get("RssShmem", 0.0), of.get("RssFile", 0.0)


def family(pid: int) -> list[int]:
    """``pid`` and all processes that it started, and they."""
    found, at = [pid], 0
    while at < len(found):
        try:
            text = Path(f"/proc/{found[at]}/task/{found[at]}/children").read_text(encoding="ascii")
            found += [int(child) for child in text.split()]
        except OSError:
            pass
        at += 1
    return found


def watch(command: list[str]) -> None:
    """Run ``command`` and print the memory of its processes, each second and at the most."""
    begun = time.monotonic()
    process = subprocess.Popen(command)
    most, mapped, said = {"main": 0.0, "other": 0.0}, 0.0, 0.0
    while process.poll() is None:
        now = {pid: memory_mb(pid) for pid in family(process.pid)}
        main, others = now.pop(process.pid, (0.0, 0.0)), [mb for mb, _ in now.values()]
        most["main"], most["other"] = max(most["main"], main[0]), max(most["other"], *others, 0.0)
        mapped = max(mapped, main[1])
        if time.monotonic() - said > 5.0:
            said = time.monotonic()
            print(f"{said - begun:7.1f} s: main {main[0]:6.0f} MB, largest other {max(others, default=0.0):6.0f} MB")
        time.sleep(TICK_S)
    print(
        f"{time.monotonic() - begun:.1f} s, status {process.returncode}; at most: main {most['main']:.0f} MB, another "
    )
    print(f"process {most['other']:.0f} MB; mapped from files in main: {mapped:.0f} MB")


def main() -> None:
    """Make what is missing, and run it."""
    count, rest = int(sys.argv[1]), [given for given in sys.argv[2:] if given != "--small"]
    folder = Path(rest.pop(0)) if rest and not rest[0].startswith("-") else Path(tempfile.mkdtemp())
    if not (folder / "run.toml").exists():
        folder.mkdir(parents=True, exist_ok=True)
        (make_small if "--small" in sys.argv else make)(count, folder)
    begun = time.monotonic()
    out = folder.with_name(folder.name + "-results")
    subprocess.run([program(), "run", folder, "--out", out, "--dry-run", *rest], check=True)
    print(f"planned in {time.monotonic() - begun:.1f} s (processes: {os.cpu_count()})")
    watch([str(program()), "run", str(folder), "--out", str(out), "-q", *rest])


if __name__ == "__main__":
    main()
