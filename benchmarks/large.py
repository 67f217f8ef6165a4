"""Default runs of many, wide and long recordings: seconds, processor seconds and memory, beside plain scipy.

Usage: python benchmarks/large.py [--recordings N] [--small-recordings N] [--channels N] [--seconds S] [--into FOLDER]
Writes `reports/speed-error/large.{json,md,png}`; `campaign.py --all` does so too. Each is run once. Recordings (2 GB at
most at a time) are made in /var/tmp and removed. Plain scipy holds a whole recording and reads one kind of encoder: it
analyses the many and the wide ones.
"""

from __future__ import annotations

import argparse
import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # before numpy loads; as the command line has it

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from campaign_page import log_axis
from many_recordings import make, make_small, make_wide
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from published import FOLDER, publish, table
from whole_process import Watched, machine, machine_words, watched

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from made.long_recordings import write_long

HERE = Path(__file__).parent
OURS, SCIPY = "crankorder", "plain scipy"
COLOURS = {OURS: "#1f5a8a", SCIPY: "#808080"}
KEYS = {
    "seconds": "s",
    "processor_seconds": "processor s, all processes",
    "largest_mb": "most memory of a process, MB",
    "together_mb": "of all processes together, MB",
}
LEAST_SHOWN = 0.1
"""Of seconds and megabytes, in the picture."""


@dataclass(frozen=True)
class Case:
    """A test to be made, and whether plain scipy can analyse it."""

    name: str
    make: Callable[[Path], object]
    by_scipy: bool


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many of each."""
    group = parser.add_argument_group("many, wide and long recordings")
    group.add_argument("--recordings", type=int, default=350, help="of 1 s, 3 channels at 50 kHz")
    group.add_argument("--small-recordings", type=int, default=10_000, help="of 1 s, one channel at 6 kHz")
    group.add_argument("--channels", type=int, default=24, help="of 18 recordings of 6 s")
    group.add_argument("--seconds", type=float, default=600.0, help="length of one recording of 3 channels at 50 kHz")


def cases_of(options: argparse.Namespace) -> list[Case]:
    """The tests, as the options say."""
    count, small, channels, seconds = (
        options.recordings,
        options.small_recordings,
        options.channels,
        options.seconds,
    )
    return [
        Case(f"{count} recordings of 1 s", lambda folder: make(count, folder), True),
        Case(f"{small} recordings of 1 s, one channel at 6 kHz", lambda folder: make_small(small, folder), False),
        Case(f"18 recordings of 6 s, {channels} channels", lambda folder: make_wide(channels, folder), True),
        Case(f"one recording of {seconds:g} s", lambda folder: write_long(folder, seconds), False),
    ]


def measure(options: argparse.Namespace, *, into: Path = FOLDER) -> None:
    """Make, run and remove each test in turn, and publish the page."""
    found: dict[str, Any] = {"machine": machine(), "rows": {}}
    for case in cases_of(options):
        with tempfile.TemporaryDirectory(dir="/var/tmp") as place:
            folder = Path(place) / "recordings"
            case.make(folder)
            megabytes = sum(len(path.read_bytes()) for path in folder.glob("*.h5")) / 1e6  # also warms the page cache
            run = [sys.executable, "-m", "crankorder", "run", str(folder), "--out", f"{place}/results", "-q"]
            programs = {OURS: row_of(watched(run))}
            if case.by_scipy:
                plain = [sys.executable, str(HERE / "plain_scipy.py"), str(folder), f"{place}/plain"]
                programs[SCIPY] = row_of(watched(plain))
        found["rows"][case.name] = {"megabytes": round(megabytes), "programs": programs}
        print(f"{case.name}: {programs[OURS]['seconds']:g} s", file=sys.stderr, flush=True)
    publish("large", found, page(found), figure(found["rows"]), into=into)


def row_of(seen: Watched) -> dict[str, float]:
    """The numbers of one row, rounded."""
    return {
        "seconds": round(seen.seconds, 1),
        "processor_seconds": round(seen.processor_seconds, 1),
        "largest_mb": round(seen.largest_mb),
        "together_mb": round(seen.together_mb),
    }


def page(found: dict[str, Any]) -> str:
    """Markdown: one row per test and program, with the ratio to plain scipy where it has one."""
    body = []
    for name, row in found["rows"].items():
        for program, numbers in row["programs"].items():
            ratio = ""
            if program == OURS and SCIPY in row["programs"]:
                plain = row["programs"][SCIPY]["processor_seconds"]
                ratio = f"{numbers['processor_seconds'] / plain:.2f}" if plain else ""
            body.append([name, row["megabytes"], program, *(numbers[key] for key in KEYS), ratio])
    header = ["test", "MB of files", "program", *KEYS.values(), "processor s over plain scipy's"]
    return f"""# Many, wide and long recordings

Made by `make bench-all`; do not edit.

![time and memory](large.png)

Default runs (findings and pictures), each measured once, whole process, files in page cache.
{machine_words(found["machine"])}

{table(header, body)}

Memory is what no file on a disk backs, looked at five times a second: of the process that has most of it, and of all
processes at one time, where what they share counts once. Plain scipy (`benchmarks/plain_scipy.py`) makes order spectra,
Welch spectra and one picture per channel; it holds whole recordings and reads an encoder of 360 pulses, so the small
and the long recordings are not for it.
"""


def figure(rows: dict[str, Any]) -> Figure:
    """Seconds and memory of every test and program."""
    bars = [(name, program, one) for name, row in rows.items() for program, one in row["programs"].items()][::-1]
    made = Figure(figsize=(13, 0.55 * len(bars) + 1.6), layout="constrained")
    FigureCanvasAgg(made)
    seconds, memory = made.subplots(1, 2, sharey=True)
    panels = (
        (seconds, {"seconds": "o", "processor_seconds": "|"}, "seconds", "Seconds (●) and processor seconds (|)"),
        (
            memory,
            {"largest_mb": "o", "together_mb": "|"},
            "megabytes",
            "Memory of the largest process (●) and of all (|)",
        ),
    )
    for axes, marks, unit, title in panels:
        for place, (_, program, one) in enumerate(bars):
            for key, mark in marks.items():
                axes.plot(one[key], place, mark, color=COLOURS[program], markersize=9 if mark == "o" else 14)
            most = max(one[key] for key in marks)
            axes.text(most * 1.2, place, " / ".join(f"{one[key]:g}" for key in marks), va="center", fontsize=9)
        shown = [max(one[key], LEAST_SHOWN) for _, _, one in bars for key in marks]
        log_axis(axes, min(shown) / 2, max(shown) * 8, unit)
        axes.set_title(title, loc="left", fontsize=11)
    seconds.set_yticks(range(len(bars)), [f"{name}: {program}" for name, program, _ in bars], fontsize=9)
    seconds.set_ylim(-0.6, len(bars) - 0.4)
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--into", type=Path, default=FOLDER, help="folder of the page")
    add_options(parser)
    options = parser.parse_args()
    measure(options, into=options.into)


if __name__ == "__main__":
    main()
