"""Default runs of many, wide and long recordings: seconds, processor seconds and memory, beside plain scipy.

Usage: python benchmarks/large.py [--recordings N] [--small-recordings N] [--channels N] [--seconds S] [--into FOLDER]
Writes `reports/speed-error/large.{json,md,png}`; `campaign.py --all` does so too. Each is run once. Recordings (4.5 GB
at most at a time) are made in /var/tmp and removed. Plain scipy holds a whole recording and reads one kind of encoder:
it analyses the many and the wide ones.
"""

from __future__ import annotations

import argparse
import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # before numpy loads; as the command line has it

import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from campaign_page import SCIPY, log_axis
from many_recordings import make, make_small, make_wide
from marks import FIXED, LONG, MANY, NARROW, SHORT, SMALL, WIDE, marks_table, of_large
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from published import FOLDER, publish, table
from whole_process import Watched, machine, machine_words, watched

HERE = Path(__file__).parent
DEFAULT, MAPS = "default", "maps"
PROGRAM = [sys.executable, "-m", "crankorder"]
COLOURS = {DEFAULT: "#1f5a8a", MAPS: "#1f5a8a", SCIPY: "#808080"}
TELL_S = 2.0
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
    """A test to be made: its name on the page, what makes it in a folder, and the programs that analyse it."""

    name: str
    make: Callable[[Path], object]
    programs: tuple[str, ...] = (DEFAULT,)


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many of each."""
    group = parser.add_argument_group("many, wide and long recordings")
    group.add_argument("--recordings", type=int, default=350, help="of 15 s, 3 channels at 50 kHz")
    group.add_argument("--small-recordings", type=int, default=10_000, help="of 0.5 s, one channel at 6 kHz")
    group.add_argument("--channels", type=int, default=24, help="of 12 recordings of 6 s")
    group.add_argument("--seconds", type=float, default=600.0, help="length of one run-up of 3 channels at 50 kHz")


def cases_of(options: argparse.Namespace) -> dict[str, Case]:
    """The tests by what they are for, as the ``options`` say."""
    count, small, channels, seconds = (
        options.recordings,
        options.small_recordings,
        options.channels,
        options.seconds,
    )
    return {
        MANY: Case(f"{count} recordings of 15 s", partial(make, count), (DEFAULT, MAPS, SCIPY)),
        WIDE: Case(f"12 recordings of 6 s, {channels} channels", partial(make_wide, channels, 12), (DEFAULT, SCIPY)),
        NARROW: Case("12 recordings of 6 s, 3 channels", partial(make_wide, 3, 12)),
        FIXED: Case("2 recordings of 6 s, 3 channels", partial(make_wide, 3, 2), (MAPS,)),
        LONG: Case(f"run-up of {seconds:g} s", partial(make_run_up, seconds)),
        SHORT: Case(f"run-up of {seconds / 10.0:g} s", partial(make_run_up, seconds / 10.0)),
        SMALL: Case(f"{small} recordings of 0.5 s, one channel at 6 kHz", partial(make_small, small)),
    }


def make_run_up(seconds: float, folder: Path) -> None:
    """The scene of the run-up, its speed rising over all of ``seconds``, synthesised in ``folder``."""
    text = (HERE.parent / "pipeline" / "scenes" / "run-up.toml").read_text(encoding="utf-8")
    scene = folder.with_name("longer.toml")
    for key in ("duration_s = ", "time_s = [0.0, "):
        text = text.replace(f"{key}60.0", f"{key}{seconds}", 1)
    scene.write_text(text, encoding="utf-8")
    subprocess.run([*PROGRAM, "synth", str(scene), "--out", str(folder), "-q"], check=True)


def measure(options: argparse.Namespace, *, into: Path = FOLDER) -> None:
    """Make, run and remove each test in turn, and publish the page."""
    found: dict[str, Any] = {"machine": machine(), "rows": {}}
    for purpose, case in cases_of(options).items():
        with tempfile.TemporaryDirectory(dir="/var/tmp") as place:
            folder = Path(place) / "recordings"
            case.make(folder)
            megabytes = sum(len(path.read_bytes()) for path in folder.glob("*.h5")) / 1e6  # also warms the page cache
            row: dict[str, Any] = {"name": case.name, "megabytes": round(megabytes), "programs": {}}
            for program in case.programs:
                course: list[tuple[float, float]] = []
                command = command_of(program, folder, Path(place))
                row["programs"][program] = row_of(watched(command, tell=partial(follow, course)))
                row["course"] = row.get("course", course)
        found["rows"][purpose] = row
        print(f"{case.name}: {row['programs']}", file=sys.stderr, flush=True)
    publish("large", found, page(found), figure(found["rows"]), into=into)


def command_of(program: str, folder: Path, place: Path) -> list[str]:
    """The command by which ``program`` analyses ``folder``, its results in ``place``."""
    if program == SCIPY:
        return [sys.executable, str(HERE / "plain_scipy.py"), str(folder), f"{place}/plain"]
    recipe = ["--recipe", "maps"] if program == MAPS else []
    return [*PROGRAM, "run", str(folder), "--out", f"{place}/{program}", "-q", *recipe]


def follow(course: list[tuple[float, float]], seconds: float, megabytes: list[float]) -> None:
    """Keep the memory of the largest process, every ``TELL_S``."""
    if not course or seconds - course[-1][0] > TELL_S:
        course.append((round(seconds, 1), round(max(megabytes))))


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
    for row in found["rows"].values():
        for program, numbers in row["programs"].items():
            body.append([row["name"], row["megabytes"], program, *(numbers[key] for key in KEYS)])
    header = ["test", "MB of files", "program", *KEYS.values()]
    return f"""# Many, wide and long recordings

Made by `make bench-all`; do not edit.

![time and memory](large.png)

Each measured once, whole process, files in page cache; default: with findings and pictures.
{machine_words(found["machine"])}

{marks_table(of_large(found["rows"]))}

{table(header, body)}

Memory is what no file on a disk backs, looked at five times a second: of the process that has most of it, and of all
processes at one time, where what they share counts once. Plain scipy (`benchmarks/plain_scipy.py`) makes order spectra,
Welch spectra and one picture per channel; it holds whole recordings and reads an encoder of 360 pulses, so the small
and the long recordings are not for it.
"""


def figure(rows: dict[str, Any]) -> Figure:
    """Seconds and memory of every test and program; below, the memory of the default runs while they run."""
    bars = [(row["name"], program, one) for row in rows.values() for program, one in row["programs"].items()][::-1]
    made = Figure(figsize=(13, 0.55 * len(bars) + 5.6), layout="constrained")
    FigureCanvasAgg(made)
    above, below = made.subfigures(2, 1, height_ratios=(0.55 * len(bars) + 1.6, 4.0))
    seconds, memory = above.subplots(1, 2, sharey=True)
    draw_courses(below.subplots(), rows)
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


def draw_courses(axes: Axes, rows: dict[str, Any]) -> None:
    """Memory of the largest process of each default run over its time."""
    for purpose in (MANY, LONG, SMALL):
        seconds, megabytes = zip(*rows[purpose]["course"], strict=True)
        axes.plot(np.array(seconds) / max(seconds), megabytes, label=f"{rows[purpose]['name']}: {max(seconds):.0f} s")
    axes.set_xlabel("share of the time of the run")
    axes.set_ylabel("MB of the largest process")
    axes.set_ylim(0.0, None)
    axes.grid(color="#dddddd")
    axes.legend(loc="lower right", fontsize=9)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--into", type=Path, default=FOLDER, help="folder of the page")
    add_options(parser)
    options = parser.parse_args()
    measure(options, into=options.into)


if __name__ == "__main__":
    main()
