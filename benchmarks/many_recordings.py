"""Thousands of recordings in one test: memory of every process over time, seconds of planning, kept files.

Usage: python benchmarks/many_recordings.py COUNT [FOLDER] [--small] [options of `crankorder run`]
Makes COUNT recordings in FOLDER (a temporary one without it; what is there is taken as it is), those of the reference
campaign in turn with noise of their own, runs them, and prints a line every five seconds and the largest of all. With
--small each is of 0.5 s, one channel and a wheel of 12 pulses at 6 kHz: ten thousand are done in a lunch break.
Memory is what no file on a disk backs (RssAnon and RssShmem of Linux), and beside it what is mapped from files.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from whole_process import watched

SMALL_SECONDS = 0.5
TELL_S = 5.0
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
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.toml").write_text(SMALL_MANIFEST, encoding="utf-8")
    time_s = np.arange(round(SMALL_SECONDS * SMALL_RATE_HZ)) / SMALL_RATE_HZ
    for number in range(count):
        random = np.random.default_rng(number)
        turns = (2000.0 + 50.0 * (number % 35)) / 60.0 * time_s + random.uniform()
        level = sum(np.cos(2.0 * np.pi * order * turns) / order for order in (1.0, 2.0, 5.5))
        with h5py.File(folder / f"rpm_{number:06d}.h5", "w") as file:
            file.attrs["rate_hz"] = SMALL_RATE_HZ
            file["acc_z"] = (level + 0.1 * random.standard_normal(len(time_s))).astype(np.float32)
            file["encoder"] = ((turns * SMALL_PULSES) % 1.0 < 0.5).astype(np.uint8)


def make(count: int, folder: Path) -> None:
    """Write ``count`` recordings and their manifest into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    with _reference() as whole:
        shutil.copy(whole / "run.toml", folder / "run.toml")
        sources = sorted(whole.glob("*.h5"))
        for number in range(count):
            arrays, attrs, top = _read(sources[number % len(sources)])
            random = np.random.default_rng(number)
            with h5py.File(folder / f"rpm_{number:06d}.h5", "w") as file:
                file.attrs.update(top)
                for name, values in arrays.items():
                    if name.startswith("acc"):
                        values += np.float32(0.01) * random.standard_normal(len(values), dtype=np.float32)
                    file.create_dataset(name, data=values).attrs.update(attrs[name])


def make_wide(channels: int, count: int, folder: Path) -> None:
    """Write ``count`` recordings of the short reference campaign, accelerometers repeated with noise of their own."""
    folder.mkdir(parents=True, exist_ok=True)
    with _reference("--quick") as whole:
        head, _, rest = (whole / "run.toml").read_text(encoding="utf-8").partition("[[channels]]")
        names = [f"acc_{number:02d}" for number in range(channels)]
        channel = '[[channels]]\nname = "{0}"\nsource = "{0}"\nquantity = "acceleration"\nunit = "m/s2"\n'
        bearings = "".join(rest.partition("[[bearings]]")[1:])
        manifest = head + "".join(channel.format(name) for name in names) + bearings
        (folder / "run.toml").write_text(manifest, encoding="utf-8")
        paths = sorted(whole.glob("*.h5"))
        for path in [paths[number] for number in np.linspace(0, len(paths) - 1, count).round().astype(int)]:
            arrays, attrs, top = _read(path)
            given = [name for name in sorted(arrays) if name.startswith("acc")]
            with h5py.File(folder / path.name, "w") as file:
                file.attrs.update(top)
                for name in arrays.keys() - set(given):
                    file.create_dataset(name, data=arrays[name]).attrs.update(attrs[name])
                for number, name in enumerate(names):
                    of = given[number % len(given)]
                    noise = np.random.default_rng(number).standard_normal(len(arrays[of]), dtype=np.float32)
                    file.create_dataset(name, data=arrays[of] + np.float32(0.01) * noise).attrs.update(attrs[of])


@contextmanager
def _reference(*options: str) -> Iterator[Path]:
    """Folder with the reference campaign, there as long as it is looked at."""
    with tempfile.TemporaryDirectory() as place:
        whole = Path(place) / "reference"
        command = [program(), "synth", "thesis-second-motoring", "--out", whole, "-q", *options]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        yield whole


def _read(path: Path):  # type: ignore[no-untyped-def]
    with h5py.File(path) as file:
        arrays = {name: item[:] for name, item in file.items()}
        return arrays, {name: dict(item.attrs) for name, item in file.items()}, dict(file.attrs)


def program() -> Path:
    """The command of this interpreter's environment."""
    return Path(sys.executable).with_name("crankorder")


def watch(command: list[str]) -> None:
    """Run ``command`` and print the memory of its processes, every five seconds and at the most."""
    said = 0.0

    def tell(seconds: float, megabytes: list[float]) -> None:
        nonlocal said
        if seconds - said > TELL_S:
            said = seconds
            largest = max(megabytes[1:], default=0.0)
            print(f"{seconds:7.1f} s: main {megabytes[0]:6.0f} MB, largest other {largest:6.0f} MB")

    seen = watched(command, tell=tell)
    print(f"{seen.seconds:.1f} s; at most: main {seen.first_mb:.0f} MB, any process {seen.largest_mb:.0f} MB, all")
    print(f"together {seen.together_mb:.0f} MB; mapped from files in main: {seen.mapped_mb:.0f} MB")


def main() -> None:
    """Make what is missing, and run it."""
    count, rest = int(sys.argv[1]), [given for given in sys.argv[2:] if given != "--small"]
    folder = Path(rest.pop(0)) if rest and not rest[0].startswith("-") else Path(tempfile.mkdtemp())
    if not (folder / "run.toml").exists():
        (make_small if "--small" in sys.argv else make)(count, folder)
    begun = time.monotonic()
    out = folder.with_name(folder.name + "-results")
    subprocess.run([program(), "run", folder, "--out", out, "--dry-run", *rest], check=True)
    print(f"planned in {time.monotonic() - begun:.1f} s (processes: {os.cpu_count()})")
    watch([str(program()), "run", str(folder), "--out", str(out), "-q", *rest])


if __name__ == "__main__":
    main()
