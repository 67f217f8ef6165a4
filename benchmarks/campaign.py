"""The reference campaign as a whole process, from the shell to the results, beside plain scipy and rota-order.

Usage: python benchmarks/campaign.py [--repeats N] [--keep FOLDER] [--rota PYTHON] [--rota-recordings N]
Writes `reports/speed-error/campaign.{json,md,png}`. Machines are shared and noisy: read the ratios, all of one run.
`--rota` is the Python of an environment with rota-order and h5py; without it its row is left out. It analyses
`--rota-recordings` of the 35 (0: all) and the time of its analysis is scaled to 35.
"""

from __future__ import annotations

import argparse
import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # before numpy loads; as the command line has it

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from published import publish, table

from crankorder.batch.machine import engine_of_test, sources_of
from crankorder.batch.plan import plan_tests
from crankorder.campbell.map import campbell_map
from crankorder.identify.findings import find
from crankorder.orders.envelope import envelope_map
from crankorder.orders.map import order_map
from crankorder.quantities import FrequencyFrames, OrderFrames, RecordingEnvelope
from crankorder.shaft.decode import ShaftKnowledge
from crankorder.stages import analyse_recording

HERE = Path(__file__).parent
MAPS, FULL, FINDINGS = "crankorder, recipe maps", "crankorder, recipe maps-full-band", "crankorder, with findings"
SCIPY, ROTA = "plain scipy", "rota-order 0.3"
WHAT = {
    MAPS: "order map (≤ 20), Campbell map (≤ 1.25 kHz), intervals, flags, SHA-256, NetCDF, pages",
    FULL: "the same to order 100 and 20 kHz",
    FINDINGS: "maps (≤ 500 Hz), orders, modes, crossings, bearings with intervals, NetCDF, pages",
    SCIPY: "order spectra, Welch spectra, one PNG per channel",
    ROTA: "order map (≤ 20), frequency map (≤ 1.25 kHz), one PNG per channel",
}
# seconds on the machine of the marks; the ratios decide
MARKS_S = {MAPS: 1.5, FULL: 2.5, FINDINGS: 4.0}
IDENTIFICATION_MARK_S = 3.0
"""Of one core, for the findings of the whole campaign."""
MARK_RATIO = {SCIPY: 10.0, ROTA: 40.0}


def measured(command: list[str]) -> tuple[float, float, float, str]:
    """Wall seconds, processor seconds of it and its processes, peak megabytes of the largest, output of ``command``."""
    # as a user's shell has it: compiled modules are kept
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    with tempfile.TemporaryFile("w+") as said:
        start = time.perf_counter()
        process = subprocess.Popen(command, stdout=said, stderr=said, env=environment)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - start
        said.seek(0)
        text = said.read()
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} ended with {process.returncode}:\n{text}")
    return seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--keep", type=Path, help="folder with (or for) the synthesised campaign")
    parser.add_argument("--rota", type=Path, help="Python of an environment with rota-order")
    parser.add_argument("--rota-recordings", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        recordings = options.keep or Path(scratch) / "recordings"
        if not recordings.exists():
            measured([sys.executable, "-m", "crankorder", "synth", "thesis-second-motoring", "--out", str(recordings)])
        size = sum(len(path.read_bytes()) for path in recordings.glob("*.h5"))  # also warms the page cache
        found = all_rows(recordings, Path(scratch), options)
        found["identification_s"] = identification_s(recordings, Path(scratch), repeats=options.repeats)
    found["megabytes"] = round(size / 1e6)
    publish("campaign", found, page(found), figure(found["rows"]))


def all_rows(recordings: Path, scratch: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Best seconds of every row, taken in turns so that a busy minute strikes all alike."""
    no_difference = scratch / "defaults.toml"
    no_difference.write_text('title = "defaults"\n')
    recipes = {MAPS: "maps", FULL: "maps-full-band", FINDINGS: str(no_difference)}
    taken: dict[str, list[tuple[float, float, float]]] = {}
    stages: dict[str, dict[str, float]] = {}
    for number in range(options.repeats + 1):
        for name, recipe in recipes.items():
            out = scratch / f"{number}-{len(taken)}-{recipe.split('/')[-1]}"
            run = [sys.executable, "-m", "crankorder", "run", str(recordings), "--out", str(out), "-v"]
            *numbers, said = measured([*run, "--recipe", recipe])
            if number:  # the first compiles kernels and modules
                taken.setdefault(name, []).append(tuple(numbers))
                stages[name] = {part: float(value) for part, value in re.findall(r"^  (\w+): ([\d.]+) s$", said, re.M)}
        if number:
            plain = [sys.executable, str(HERE / "plain_scipy.py"), str(recordings), str(scratch / f"plain-{number}")]
            taken.setdefault(SCIPY, []).append(measured(plain)[:3])
    rows: dict[str, dict[str, Any]] = {}
    for name, values in taken.items():
        best = [min(each) for each in zip(*values, strict=True)]
        rows[name] = row_of(*best) | {"stages": stages.get(name, {})}
    if options.rota is not None:
        rows[ROTA] = rota_row(recordings, scratch, options)
    for name in MARKS_S:
        for key in ("seconds", "processor_seconds"):
            rows[name][f"{key}_ratio"] = {
                peer: round(rows[peer][key] / rows[name][key], 1) for peer in (SCIPY, ROTA) if peer in rows
            }
    what = "35 recordings x 15 s x (3 channels + encoder + index), float32 HDF5 in page cache, whole process"
    return {"what": what, "cores": os.cpu_count(), "rows": rows}


def identification_s(recordings: Path, scratch: Path, *, repeats: int) -> float:
    """Least processor seconds of one core for the findings of the campaign, from the maps and frames that a run has."""
    (plan,) = plan_tests([recordings], scratch / "identification")
    knowledge = ShaftKnowledge(engine=engine_of_test(plan))
    made = [analyse_recording(path, plan.manifest, plan.settings, knowledge).frames for path in plan.recordings]
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
        find(*maps, test=plan.name, sources=sources, settings=settings)
        taken.append(time.thread_time() - start)
    return round(min(taken), 2)


def row_of(seconds: float, processor: float, memory: float) -> dict[str, Any]:
    """The numbers of one row, rounded."""
    return {
        "seconds": round(seconds, 2),
        "processor_seconds": round(processor, 2),
        "peak_resident_mb": round(memory),
    }


def rota_row(recordings: Path, scratch: Path, options: argparse.Namespace) -> dict[str, Any]:
    """One run of rota-order on some recordings, its analysis scaled to all of them."""
    command = [str(options.rota), str(HERE / "rota_campaign.py"), str(recordings), str(scratch / "rota")]
    seconds, processor, memory, said = measured([*command, "--only", str(options.rota_recordings)])
    match = re.search(r"analysis ([\d.]+) s of (\d+) recordings", said)
    if match is None:
        raise SystemExit(f"rota_campaign.py did not say how long it took:\n{said}")
    analysis, count, total = float(match[1]), int(match[2]), len(list(recordings.glob("*.h5")))
    more = analysis * (total / count - 1.0)  # in one thread, so of the processor too
    return row_of(seconds + more, processor + more * min(1.0, processor / seconds), memory) | {
        "scaled_from_recordings": count
    }


def page(found: dict[str, Any]) -> str:
    """Markdown: ratios first, then seconds and where they go."""
    rows = found["rows"]
    peers = [name for name in (SCIPY, ROTA) if name in rows]
    header = ["times faster than", *(f"{peer} (mark {MARK_RATIO[peer]:g})" for peer in peers)]
    header += [f"{peer}, in processor seconds" for peer in peers]
    ratios = table(
        header,
        [
            [name, *(rows[name][f"{key}_ratio"][peer] for key in ("seconds", "processor_seconds") for peer in peers)]
            for name in MARKS_S
        ],
    )
    seconds = table(
        [
            "",
            "s",
            "mark on the machine of the marks, s",
            "processor s, all processes",
            "peak MB of a process",
            "what it makes",
        ],
        [
            [name, row["seconds"], MARKS_S.get(name, ""), row["processor_seconds"], row["peak_resident_mb"], WHAT[name]]
            for name, row in rows.items()
        ],
    )
    parts = list(rows[MAPS]["stages"])
    stages = table(["s in", *parts], [[name, *(rows[name]["stages"].get(p, "") for p in parts)] for name in MARKS_S])
    told = "rota-order was not there: give its Python by `--rota`."
    if ROTA in rows:
        told = (
            f"rota-order analysed {rows[ROTA]['scaled_from_recordings']} of 35 recordings; the time of its analysis is "
            "scaled to 35, its start and its pages are not."
        )
    return f"""# The reference campaign as a whole process

{found["what"]}; {found["megabytes"]} MB, {found["cores"]} cores, best of the repeats, all in one run on one machine.
Others may use the machine too: processor seconds tell what the work costs, seconds what a user waits. What remains of
the seconds beside the stages is the start: modules and compiled kernels. {told}

{ratios}

{seconds}

{stages}

Identification alone (orders, modes, bearings, crossings, balance, causes, from maps and frames to the findings):
{found["identification_s"]} s of one core (mark {IDENTIFICATION_MARK_S:g} s).
"""


def figure(rows: dict[str, dict[str, Any]]) -> Figure:
    """Seconds on a logarithmic axis, with the ratio to the first beside each."""
    made = Figure(figsize=(9, 0.75 * len(rows) + 1.6), layout="constrained")
    FigureCanvasAgg(made)
    axes = made.add_subplot()
    names = list(rows)[::-1]
    for place, name in enumerate(names):
        seconds = rows[name]["seconds"]
        ours = name in MARKS_S
        axes.plot(seconds, place, "o", color="#1f5a8a" if ours else "#808080", markersize=11)
        ratio = "" if name == MAPS else f"  ({seconds / rows[MAPS]['seconds']:.1f} × maps)"
        axes.text(seconds * 1.12, place, f"{seconds:.1f} s{ratio}", va="center", fontsize=10)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(-0.6, len(names) - 0.4)
    axes.grid(axis="x", color="#dddddd")
    axes.set_xscale("log")
    axes.set_xlim(min(row["seconds"] for row in rows.values()) / 3, max(row["seconds"] for row in rows.values()) * 6)
    axes.set_xlabel("seconds of the whole process, 35 recordings (logarithmic)")
    axes.set_title("From the shell to the results", loc="left")
    axes.spines[["top", "right"]].set_visible(False)
    return made


if __name__ == "__main__":
    main()
