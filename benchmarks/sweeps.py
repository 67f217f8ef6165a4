"""Sweeps past a resonance: rates x damping against the bias of natural frequency, damping and maximum, and the time.

Usage: python benchmarks/sweeps.py [--seeds N] [--run-up-ratio [--keep FOLDER] [--repeats N]]
Writes `reports/speed-error/sweeps.{json,md,png}`. One mode of 60 to 120 Hz, passed by two or three orders; the signals
come from `tests/machines`, whose physics shares nothing with the program. crankorder's default run stands beside its
plain map, plain scipy and rota-order (where installed), on the same recordings and in turns: read times as ratios.
`--run-up-ratio` also times a run-up of 60 s x 3 channels against `plain_scipy.py`'s campaign, as whole processes.
"""

from __future__ import annotations

import argparse
import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}  # before numpy loads

import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from published import publish
from sweep_page import figure, page
from sweep_peers import OURS, SCIPY, Cell, Said, SweepTest, Value, drawn_test, methods
from whole_process import measured

RATES, DAMPINGS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0), (0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
DOWN = (-3.0, -30.0, -300.0)
MARK_RUN_UP = 0.3
QUANTITIES = ("frequency", "damping", "maximum", "track maximum", "maximum held")


@dataclass(frozen=True)
class Judged:
    """Error of one estimate, share of the truth; whether its interval holds the truth (None: it has none); words."""

    quantity: str
    error: float
    covers: bool | None
    words: str


def judged(test: SweepTest, said: Said) -> list[Judged]:
    """Every estimate that ``said`` holds of ``test``, beside the truth."""
    mode, (was, steady) = test.machine.modes[0], test.truth()
    place = f"{test.cell.row}, {100 * mode.damping_ratio:g} %, seed {test.seed}"
    made = []

    def add(quantity: str, value: Value | None, truth: float, what: str, decimals: str) -> None:
        if value is None:
            return
        ends = "" if value.ci95 is None else f" ({value.ci95[0]:{decimals}} … {value.ci95[1]:{decimals}})"
        words = f"{place}: {what} {value.value:{decimals}}{ends}, is {truth:{decimals}}"
        made.append(Judged(quantity, value.value / truth - 1.0, value.covers(truth), words))

    add("frequency", said.frequency_hz, mode.frequency_hz, "Hz", ".6g")
    add("damping", said.damping_ratio, mode.damping_ratio, "damping", ".4g")
    largest = (("maximum", said.maxima, was), ("track maximum", said.tracks, was), ("maximum held", said.held, steady))
    for quantity, values, truth in largest:
        for (number, channel), value in values.items():
            what = f"{quantity} of order {test.machine.orders[number].order:g} {test.machine.channels[channel]}"
            add(quantity, value, float(truth[number, channel]), what, ".4g")
    return made


def every_cell() -> list[Cell]:
    """Cells up, then down."""
    return [Cell(rate, damping) for rate in (*RATES, *DOWN) for damping in DAMPINGS]


def measured_cells(seeds: int) -> dict:
    """Errors and times of every method in every cell; the methods take turns on each test."""
    found = {name: {} for name in methods()}
    misses: list[str] = []
    others: list[str] = []
    for cell in (Cell(30.0, 0.01), Cell(1000.0, 0.01)):  # compiles and loads
        _each_method(cell, 0)
    for cell in every_cell():
        done = [_each_method(cell, seed) for seed in range(1, seeds + 1)]
        for name in found:
            found[name][f"{cell.row}, {100 * cell.damping_ratio:g} %"] = _summary([one[name] for one in done])
        misses += [one.words for each in done for one in each[OURS].judged if one.covers is False]
        others += [words for each in done for words in each[OURS].others]
        print(f"{cell.row}, {100 * cell.damping_ratio:g} %", file=sys.stderr, flush=True)
    return {"cells": found, "misses": misses, "others": others}


@dataclass(frozen=True)
class Done:
    """What one method made of one test: seconds, of plain scipy's, its estimates, and how many there could be."""

    seconds: float
    ratio: float
    judged: list[Judged]
    could: dict[str, int]
    others: tuple[str, ...]
    failed: str


def _each_method(cell: Cell, seed: int) -> dict[str, Done]:
    with tempfile.TemporaryDirectory() as scratch:
        test = drawn_test(cell, seed, Path(scratch) / "test")
        lines = len(test.machine.orders) * len(test.machine.channels)
        could = {name: 1 if name in ("frequency", "damping") else lines for name in QUANTITIES}
        said, seconds, failed = {}, {}, {}
        for name, method in methods().items():
            start = time.process_time()
            try:
                said[name], failed[name] = method(test), ""
            except (ValueError, MemoryError) as error:  # a peer that refuses has its row all the same
                if name == OURS:
                    raise
                said[name], failed[name] = Said(), f"{type(error).__name__}: {error}"
            seconds[name] = time.process_time() - start
        place = f"{test.cell.row}, {100 * cell.damping_ratio:g} %, seed {seed}"
        true = test.machine.modes[0].frequency_hz
        return {
            name: Done(
                seconds[name],
                seconds[name] / seconds[SCIPY],
                judged(test, one),
                could,
                tuple(f"{place}: a mode of {hz:.6g} Hz, the only one is {true:.6g} Hz" for hz in one.others),
                failed[name],
            )
            for name, one in said.items()
        }


def _summary(done: list[Done]) -> dict:
    """Errors of all seeds of one cell by quantity, how many intervals cover, and the time as ratio to plain scipy."""
    made: dict[str, object] = {}
    for quantity in QUANTITIES:
        own = [one for each in done for one in each.judged if one.quantity == quantity]
        told = [one.covers for one in own if one.covers is not None]
        made[quantity] = {
            "errors": " ".join(f"{one.error:.4g}" for one in own),  # on one line of the file
            "could": sum(each.could[quantity] for each in done),
            "covered": sum(told),
            "intervals": len(told),
        }
    made["seconds"] = [float(f"{each.seconds:.3g}") for each in done]
    made["ratios"] = [float(f"{each.ratio:.3g}") for each in done]
    made["others"] = sum(len(each.others) for each in done)
    made["failed"] = [each.failed for each in done if each.failed]
    return made


def run_up_ratio(keep: Path | None, repeats: int) -> dict:
    """A run-up of 60 s x 3 channels, and plain scipy on the campaign, as whole processes in turns: least of each."""
    program = [sys.executable, "-m", "crankorder"]
    with tempfile.TemporaryDirectory() as place:
        scratch = Path(place)
        folder = keep or scratch
        tests = {scene: folder / scene for scene in ("run-up", "thesis-second-motoring")}
        for scene, where in tests.items():
            if not where.exists():
                measured([*program, "synth", scene, "--out", str(where)])
        taken: dict[str, list[tuple[float, float]]] = {OURS: [], SCIPY: []}
        for number in range(repeats + 1):
            out = str(scratch / f"out-{number}")
            commands = {
                OURS: [*program, "run", str(tests["run-up"]), "--out", out],
                SCIPY: [
                    sys.executable,
                    str(Path(__file__).parent / "plain_scipy.py"),
                    str(tests["thesis-second-motoring"]),
                    f"{out}-plain",
                ],
            }
            for name, command in commands.items():
                seconds, processor, *_ = measured(command)
                if number:  # the first compiles kernels and fills the page cache
                    taken[name].append((seconds, processor))
    best = {name: [round(min(each), 2) for each in zip(*values, strict=True)] for name, values in taken.items()}
    return {
        "mark": MARK_RUN_UP,
        "seconds": {name: values[0] for name, values in best.items()},
        "processor_seconds": {name: values[1] for name, values in best.items()},
        "ratio": round(best[OURS][0] / best[SCIPY][0], 2),
        "processor_ratio": round(best[OURS][1] / best[SCIPY][1], 2),
    }


def main() -> None:
    """Measure, then write tables and figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3, help="tests in each cell")
    parser.add_argument("--run-up-ratio", action="store_true", help="also time a run-up of 60 s against the campaign")
    parser.add_argument("--keep", type=Path, help="folder with (or for) the scenes of --run-up-ratio")
    parser.add_argument("--repeats", type=int, default=3, help="rounds of --run-up-ratio, of which the best counts")
    options = parser.parse_args()
    found = {
        "what": "one mode of 60 to 120 Hz passed by two or three orders (5 to 8), 1 to 3 channels, sensor noise of 1 % "
        "of what the weakest order reaches, 60 pulses per revolution with a clock of 10 MHz",
        "seeds": options.seeds,
        "run_up": run_up_ratio(options.keep, options.repeats) if options.run_up_ratio else None,
        **measured_cells(options.seeds),
    }
    publish("sweeps", found, page(found), figure(found))


if __name__ == "__main__":
    main()
