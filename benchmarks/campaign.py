"""The reference campaign as a whole process, from the shell to the results: time and error beside two other programs.

Usage: python benchmarks/campaign.py [--repeats N] [--keep FOLDER] [--rota PYTHON] [--rota-recordings N] [--all]
Writes `reports/speed-error/campaign.{json,md,png}` and prints what each row costs relative to plain scipy, beside the
same of the page before. Machines are shared and noisy: read the ratios, all of one run; the programs take turns.
rota-order gets an environment of its own below the one that runs this, made when it is absent; `--rota` names another.
It analyses `--rota-recordings` of the 35 (0: all) and the time of its analysis is scaled to 35.
`--all` then measures many, wide and long recordings too, see `large.py`, whose options may be given.
`--quick --into FOLDER` tries all of it on the scenes' short versions and publishes into FOLDER.
"""

from __future__ import annotations

import argparse
import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # before numpy loads; as the command line has it

import json
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import large
import numpy as np
from amplitude_error import ROTA_ORDER_STEP, clear_lines, errors, of_map, of_spectra, of_tracks
from campaign_page import (
    FINDINGS,
    FIRST,
    FULL,
    MAPS,
    ON_THE_CAMPAIGN,
    ROTA,
    RUN_UP,
    SCIPY,
    WARM,
    WARM_MAPS,
    costs_beside,
    figure,
    page,
)
from marks import marks_table, of_campaign
from published import FOLDER, publish
from whole_process import machine, measured

import crankorder
from crankorder.batch.execute import engine_of_test, sources_of
from crankorder.batch.plan import plan_tests
from crankorder.campbell.map import campbell_map
from crankorder.identify.findings import Measured, find
from crankorder.orders.envelope import envelope_map
from crankorder.orders.map import order_map
from crankorder.quantities import FrequencyFrames, OrderFrames, RecordingEnvelope
from crankorder.stages import analyse_recording

HERE = Path(__file__).parent
QUIET = 1e-6
"""Of the noise of the reference campaign, where errors of amplitudes are to be those of the program."""
TURNS_OF_OTHERS = 3
"""So many turns take the rows of which fewer are enough."""
RECIPES = ((MAPS, "maps"), (FULL, "maps-full-band"), (FINDINGS, None))
PROGRAM = [sys.executable, "-m", "crankorder"]
ROTA_PACKAGES = ("rota-order==0.3.0", "h5py", "matplotlib")
CHECK_ROTA = "import rota, h5py, matplotlib, importlib.metadata as m; print(m.version('rota-order'))"


def main() -> None:
    options = options_of()
    old = committed_rows()
    found: dict[str, Any] = {"machine": machine()}
    rota, absent = (options.rota, "") if options.rota is not None else rota_environment()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        recordings, run_up = folder / "recordings", folder / "run-up"
        quiet = folder / "quiet"
        scenes = (("thesis-second-motoring", recordings), (str(quiet_scene(Path(scratch))), quiet), ("run-up", run_up))
        for scene, where in scenes:
            if not where.exists():
                measured([*PROGRAM, "synth", scene, "--out", str(where), *(["--quick"] if options.quick else [])])
        size = sum(len(path.read_bytes()) for path in recordings.glob("*.h5"))  # also warms the page cache
        turns = Turns(recordings, run_up, Path(scratch), rota, options.rota_recordings)
        rows = turns.rows(options.repeats)
        found["arrays_s"] = [statistics.median(each) for each in zip(*turns.arrays, strict=True)]
        found["demo_s"] = round(statistics.median(turns.demos), 2)
        errors = Turns(quiet, run_up, Path(scratch), rota, options.rota_recordings).errors()
        found |= {"what": what_is_in(recordings), "cores": os.cpu_count(), "repeats": options.repeats}
        found |= {"rows": rows, "rota_absent": absent, "error_of_amplitudes": errors}
        found["identification_s"] = identification_s(recordings, Path(scratch), repeats=options.repeats)
    found["megabytes"] = round(size / 1e6)
    told = marks_table(of_campaign(found))
    publish("campaign", found, page(found, told), figure(found), into=options.into)
    if not options.quick:  # other recordings
        print(costs_beside(old, rows))
    if options.all:
        large.measure(options, into=options.into)


def committed_rows() -> dict[str, Any]:
    """Rows of the page as the last commit has it, for a run overwrites the file; empty where there is none."""
    asked = ["git", "-C", str(HERE.parent), "show", "HEAD:reports/speed-error/campaign.json"]
    done = subprocess.run(asked, capture_output=True, text=True, check=False)
    return dict(json.loads(done.stdout)["rows"]) if done.returncode == 0 else {}


def quiet_scene(folder: Path) -> Path:
    """The scene of the reference campaign with a millionth of its noise, written into ``folder``."""
    scene = Path(crankorder.__file__).parents[2] / "pipeline" / "scenes" / "thesis-second-motoring.toml"
    text = scene.read_text(encoding="utf-8")
    for key in ("force_n_per_root_hz", "m_s2_per_root_hz"):
        line = re.search(rf"^{key} = \{{.*\}}$", text, re.MULTILINE)
        if line is None:
            raise SystemExit(f"{scene.name}: no line {key} = {{…}}")
        quiet = re.sub(r"= ([\d.]+)", lambda number: f"= {QUIET * float(number[1]):g}", line[0])
        text = text.replace(line[0], quiet)
    path = folder / "quiet.toml"
    path.write_text(text, encoding="utf-8")
    return path


def options_of() -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5, help="turns, of which the median counts")
    parser.add_argument("--keep", type=Path, help="folder with (or for) the synthesised recordings")
    parser.add_argument("--rota", type=Path, help="Python of an environment with rota-order, h5py and matplotlib")
    parser.add_argument("--rota-recordings", type=int, default=7, help="which rota-order analyses; 0: all")
    parser.add_argument("--into", type=Path, default=FOLDER, help="folder of the page")
    parser.add_argument("--quick", action="store_true", help="short recordings, to try the benchmark itself")
    parser.add_argument("--all", action="store_true", help="also many, wide and long recordings")
    large.add_options(parser)
    options = parser.parse_args()
    if options.quick and options.into == FOLDER:
        parser.error("--quick measures nothing to be published: give --into too")
    return options


def rota_environment(folder: Path | None = None) -> tuple[Path | None, str]:
    """Python of an environment with rota-order, made where it is absent; without it None and why."""
    folder = folder or Path(sys.prefix) / "peers" / "rota-order"
    python = folder / "bin" / "python"
    if not _has_rota(python):
        shutil.rmtree(folder, ignore_errors=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *ROTA_PACKAGES]
        for command in ([sys.executable, "-m", "venv", str(folder)], pip):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                shutil.rmtree(folder, ignore_errors=True)  # tried again the next time
                said = (done.stderr or done.stdout).strip().splitlines() or ["no reason given"]
                return None, f"{ROTA_PACKAGES[0]} could not be installed: {said[-1]}"
    return python, ""


def _has_rota(python: Path) -> bool:
    if not python.exists():
        return False
    done = subprocess.run([str(python), "-c", CHECK_ROTA], capture_output=True, text=True, check=False)
    return done.returncode == 0 and done.stdout.strip() == ROTA_PACKAGES[0].partition("==")[2]


@dataclass
class Turns:
    """Every program in turn, so that a busy minute strikes all alike; the results of the last turn are kept."""

    recordings: Path
    run_up: Path
    scratch: Path
    rota: Path | None
    rota_recordings: int
    taken: dict[str, list[tuple[float, float, float]]] = field(default_factory=dict)
    stages: dict[str, dict[str, float]] = field(default_factory=dict)
    out: dict[str, Path] = field(default_factory=dict)
    arrays: list[tuple[float, float]] = field(default_factory=list)
    demos: list[float] = field(default_factory=list)

    def rows(self, repeats: int) -> dict[str, dict[str, Any]]:
        """The median of every row, and how many times faster than the other programs the rows of the campaign are."""
        for number in range(repeats + 1):
            for name, recipe in RECIPES:
                self.run(name, self.recordings, recipe)
            if number <= TURNS_OF_OTHERS:
                self.run(RUN_UP, self.run_up, None)
            if number:  # the turn before compiled kernels and modules
                self.plain_scipy()
                if number <= TURNS_OF_OTHERS:
                    self.rota_order()
                    self.warm_runs()
                    self.demo()
            else:
                self.taken.clear()
                self.first_run()
        order = (MAPS, FULL, FINDINGS, SCIPY, ROTA, WARM_MAPS, WARM, FIRST, RUN_UP)
        rows = {name: self.row(name) for name in order if name in self.taken}
        for name in ON_THE_CAMPAIGN:
            for key in ("seconds", "processor_seconds"):
                rows[name][f"{key}_ratio"] = {
                    peer: round(rows[peer][key] / rows[name][key], 1) for peer in (SCIPY, ROTA) if peer in rows
                }
        return rows

    def row(self, name: str) -> dict[str, Any]:
        """Medians of the turns, rounded."""
        seconds, processor, memory = (statistics.median(each) for each in zip(*self.taken[name], strict=True))
        made: dict[str, Any] = {
            "seconds": round(seconds, 2),
            "processor_seconds": round(processor, 2),
            "peak_resident_mb": round(memory),
            "runs": len(self.taken[name]),
        }
        if name == ROTA:
            made["scaled_from_recordings"] = len(np.load(self.out[ROTA] / "orders.npz").files) - 1
        return made | {"stages": self.stages.get(name, {})}

    def run(self, name: str, test: Path, recipe: str | None, **environment: str) -> None:
        """One run of crankorder from the shell."""
        asked = [] if recipe is None else ["--recipe", recipe]
        command = [*PROGRAM, "run", str(test), "--out", str(self.fresh(name)), "-v", *asked]
        *numbers, said = measured(command, **environment)
        self.taken.setdefault(name, []).append(tuple(numbers))
        self.stages[name] = {part: float(value) for part, value in re.findall(r"^  (\w+): ([\d.]+) s$", said, re.M)}

    def first_run(self) -> None:
        """The default run where no kernel has been compiled; modules have, as an installation does it."""
        with tempfile.TemporaryDirectory() as place:
            self.run(FIRST, self.recordings, None, NUMBA_CACHE_DIR=place)

    def plain_scipy(self) -> None:
        """One run of `plain_scipy.py`."""
        command = [sys.executable, str(HERE / "plain_scipy.py"), str(self.recordings), str(self.fresh(SCIPY))]
        self.taken.setdefault(SCIPY, []).append(measured(command, OPENBLAS_NUM_THREADS="1")[:3])

    def rota_order(self) -> None:
        """One run of rota-order on some recordings, its analysis scaled to all of them."""
        if self.rota is None:
            return
        command = [str(self.rota), str(HERE / "rota_campaign.py"), str(self.recordings), str(self.fresh(ROTA))]
        seconds, processor, memory, said = measured([*command, "--only", str(self.rota_recordings)])
        match = re.search(r"analysis ([\d.]+) s of (\d+) recordings", said)
        if match is None:
            raise SystemExit(f"rota_campaign.py did not say how long it took:\n{said}")
        analysis, count, total = float(match[1]), int(match[2]), len(list(self.recordings.glob("*.h5")))
        more = analysis * (total / count - 1.0)  # in one thread, so of the processor too
        numbers = seconds + more, processor + more * min(1.0, processor / seconds), memory
        self.taken.setdefault(ROTA, []).append(numbers)

    def warm_runs(self) -> None:
        """Default run and maps in an interpreter that has done a run before; the memory is of all three runs."""
        *_, memory, said = measured(
            [sys.executable, str(HERE / "warm_run.py"), str(self.recordings), str(self.fresh(WARM))]
        )
        for name, words in ((WARM, "default"), (WARM_MAPS, "maps")):
            match = re.search(rf"^{words}: ([\d.]+) s, ([\d.]+) s of the processor$", said, re.M)
            if match is None:
                raise SystemExit(f"warm_run.py did not say how long it took:\n{said}")
            self.taken.setdefault(name, []).append((float(match[1]), float(match[2]), memory))
        match = re.search(r"^arrays: ([\d.]+) s, scipy ([\d.]+) s", said, re.M)
        if match is None:
            raise SystemExit(f"warm_run.py did not say how long maps of arrays took:\n{said}")
        self.arrays.append((float(match[1]), float(match[2])))

    def demo(self) -> None:
        """Seconds of the demonstration, from the shell to the results."""
        self.demos.append(measured([*PROGRAM, "demo", "--out", str(self.fresh("demo"))])[0])

    def fresh(self, name: str) -> Path:
        """A folder for the results of ``name`` that is not there yet."""
        self.out[name] = self.scratch / f"results-{name.replace(' ', '-').replace(',', '')}"
        shutil.rmtree(self.out[name], ignore_errors=True)
        return self.out[name]

    def errors(self) -> dict[str, Any]:
        """Largest and median error of each program's amplitudes, on all clear lines and on those of rota-order.

        Each program runs once.
        """
        for name, recipe in RECIPES:
            self.run(name, self.recordings, recipe)
        self.plain_scipy()
        self.rota_order()
        lines = clear_lines(self.recordings)
        readers = {MAPS: of_map(self.out[MAPS]), FULL: of_map(self.out[FULL]), FINDINGS: of_tracks(self.out[FINDINGS])}
        readers[SCIPY] = of_spectra(self.out[SCIPY])
        if ROTA in self.out:
            readers[ROTA] = of_spectra(self.out[ROTA], ROTA_ORDER_STEP)
        its_own = [line for line in lines if ROTA in readers and readers[ROTA](line) is not None]
        return {
            "lines": len(lines),
            "orders": sorted({line.order for line in lines}),
            "noise": {
                "largest": float(f"{max(line.noise for line in lines):.4g}"),
                "median": float(f"{np.median([line.noise for line in lines]):.4g}"),
            },
            "programs": {name: errors(reader, lines) for name, reader in readers.items()},
            "programs_on_recordings_of_rota": {name: errors(reader, its_own) for name, reader in readers.items()},
        }


def what_is_in(recordings: Path) -> str:
    """How many recordings of which length."""
    paths = sorted(recordings.glob("*.h5"))
    with h5py.File(paths[0]) as file:
        seconds = len(file["encoder"]) / float(file.attrs["rate_hz"])
    return (
        f"{len(paths)} recordings x {seconds:g} s x (3 channels + encoder + index), float32 HDF5 in page cache, whole "
        "process"
    )


def identification_s(recordings: Path, scratch: Path, *, repeats: int) -> float:
    """Least processor seconds of one core for the findings of the campaign, from the maps and frames that a run has."""
    (plan,) = plan_tests([recordings], scratch / "identification").tests
    engine = engine_of_test(plan)
    made = [analyse_recording(path, plan.manifest, plan.settings, engine).frames for path in plan.recordings]
    settings, sources = plan.settings, sources_of(plan.manifest, engine_of_test(plan), plan.settings)
    width_rpm = settings.orders.speed_bin_rpm
    frames = [one[OrderFrames] for one in made]
    maps = (
        order_map(frames, settings=settings.orders),
        campbell_map([one[FrequencyFrames] for one in made], speed_bin_rpm=width_rpm),
        frames,
        envelope_map([one[RecordingEnvelope] for one in made], speed_bin_rpm=width_rpm),
    )
    taken = []
    for _ in range(max(repeats, 2)):  # the first compiles and loads
        start = time.thread_time()
        find(Measured(*maps), test=plan.name, sources=sources, settings=settings)
        taken.append(time.thread_time() - start)
    return round(min(taken), 2)


if __name__ == "__main__":
    main()
