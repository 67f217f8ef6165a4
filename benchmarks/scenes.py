"""Cost of a synthetic recording against the effects switched on, and of whole scenes as processes of their own.

Usage: python benchmarks/scenes.py [--repeats N]
Writes `reports/speed-error/scenes.{json,md,png}`. Machines are shared and noisy: read the ratios of one run.
"""

from __future__ import annotations

import argparse
import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # before numpy loads; as the command line has it

import json
import sys
import tempfile
import time
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from published import publish, table
from whole_process import measured as measured_process

from crankorder.engine.definition import load_engine
from crankorder.synth.load import load_scene
from crankorder.synth.noise import floor_of
from crankorder.synth.parts import (
    Acquisition,
    BearingImpacts,
    ColouredNoise,
    GasTorque,
    InCycleSpeed,
    SpeedOrder,
    Tone,
    Wander,
)
from crankorder.synth.recording import synthesise
from crankorder.synth.scene import Scene
from crankorder.synth.write import write_recording

SCENE = "thesis-second-motoring"
LEFT_OUT = ("bearing_lines", "broadband", "encoder")
ORDERS_AND_NOISE = f'schema_version = 1\nbased_on = "{SCENE}"\nwithout = {json.dumps(LEFT_OUT)}\n'
EVERY = ("X", "Y", "Z")


def steps() -> dict[str, Scene]:
    """Scenes of which each has one effect more than the one before."""
    whole = load_scene(SCENE)
    of_scene = {key: getattr(whole, key) for key in Scene.model_fields}
    now = {**of_scene, "bearing_lines": (), "broadband": None, "encoder": None, "sensor_noise": None}
    more: dict[str, dict[str, object]] = {
        "orders of the engine, eight modes": {},
        "+ noise of the sensors": {"sensor_noise": whole.sensor_noise},
        "+ bearing line": {"bearing_lines": whole.bearing_lines},
        "+ broadband forces on the modes": {"broadband": whole.broadband},
        "+ encoder": {"encoder": whole.encoder},
        "+ gas torque, 40 half orders": {
            "engine": load_engine("msu-optical-second-firing"),
            "gas_torque": GasTorque(highest_order=20.0),
        },
        "+ mains": {"tones": (Tone(cause="mains", frequency_hz=60.0, amplitude_m_s2=dict.fromkeys(EVERY, 0.3)),)},
        "+ strikes in a bearing": {
            "bearing_impacts": (
                BearingImpacts(
                    bearing="jack shaft",
                    line="BPFO",
                    peak_m_s2=dict.fromkeys(EVERY, 1.0),
                    resonance_hz=3200.0,
                    damping_ratio=0.04,
                ),
            )
        },
        "+ coloured noise": {
            "coloured_noise": (
                ColouredNoise(channels=EVERY, frequency_hz=(1.0, 100.0), m_s2_per_root_hz=(0.02, 0.0005)),
            )
        },
        "+ filter, sixteen bits": {
            "acquisition": Acquisition(low_pass_hz=20_000.0, full_scale=200.0, bits=16, stored_as="int16")
        },
        "+ speed within the cycle": {
            "in_cycle_speed": InCycleSpeed(by_order=(SpeedOrder(order=0.5, percent=1), SpeedOrder(order=2, percent=1)))
        },
        "+ wandering speed: modes integrated": {"speed_wander": Wander(std_rpm=2.0, corner_hz=0.5)},
    }
    scenes = {}
    for name, effects in more.items():
        now |= effects
        scenes[name] = Scene.model_construct(**now)
    return scenes


def seconds_of(scenes: dict[str, Scene], repeats: int) -> dict[str, float]:
    """Least time of one recording of each scene, its file included; all meet the same neighbours in turn."""
    best = dict.fromkeys(scenes, float("inf"))
    floors = {name: floor_of(scene, scene.rate_hz(2000.0)) for name, scene in scenes.items()}
    for _ in range(repeats):
        for name, scene in scenes.items():
            run = scene.runs[-1]
            start = time.perf_counter()
            with tempfile.TemporaryDirectory() as folder:
                write_recording(Path(folder) / "one.h5", scene, run, synthesise(scene, run, floors[name]))
                best[name] = min(best[name], time.perf_counter() - start)
    return best


def processes() -> dict[str, dict[str, float]]:
    """Seconds and peak memory of whole commands."""
    found = {}
    with tempfile.TemporaryDirectory() as scratch:
        lean = Path(scratch) / "orders-and-noise.toml"
        lean.write_text(ORDERS_AND_NOISE)
        commands = {
            "campaign: 35 x 15 s x 3 channels + encoder": SCENE,
            "the same, orders and sensor noise only": str(lean),
            "run-up: 60 s x 51.2 kHz x 3 channels + encoder": "run-up",
        }
        for number, (name, scene) in enumerate(commands.items()):
            command = [
                sys.executable,
                "-m",
                "crankorder",
                "synth",
                scene,
                "--out",
                str(Path(scratch) / str(number)),
                "-q",
            ]
            seconds, memory = min(measured_process(command)[:2] for _ in range(3))
            found[name] = {"seconds": round(seconds, 2), "peak_memory_mb": round(memory)}
    return found


def drawn(seconds: dict[str, float], campaign: str) -> Figure:
    """One bar for each step; what the step adds is the dark end of it."""
    figure = Figure(figsize=(9.5, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    names, values = list(seconds), [1e3 * value for value in seconds.values()]
    before = [0.0, *values[:-1]]
    for row, (value, former) in enumerate(zip(values, before, strict=True)):
        axes.barh(row, min(value, former), color="0.82")
        axes.barh(row, max(value - former, 0), left=min(value, former), color="C0" if names[row] != campaign else "C3")
        axes.text(value + max(values) / 120, row, f"{value:.0f} ms", va="center", fontsize=9)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set(xlabel="time of one recording, 15 s × 50 kHz × 3 channels, one core [ms]", xlim=(0, 1.12 * max(values)))
    axes.set_title(
        "What a scene does not name costs nothing: time as effects are added one by one", fontsize=11, loc="left"
    )
    row = names.index(campaign)
    note = "up to here: the shipped campaign"
    axes.text(values[row] + max(values) / 9, row, note, va="center", fontsize=9, color="C3")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="x", alpha=0.3)
    axes.set_axisbelow(True)
    return figure


def page(found: dict) -> str:
    """The same numbers as tables."""
    steps_ms, whole = found["milliseconds_per_recording"], found["processes"]
    lines = [
        "# Synthetic recordings: cost against effects",
        "Made by `python benchmarks/scenes.py`; do not edit.",
        "![time against effects](scenes.png)",
        f"Orders and sensor noise take **{found['orders_and_noise_over_campaign']:.2f}** of the time of the shipped "
        f"campaign's recording and **{found['orders_and_noise_over_all']:.2f}** of one with every effect.",
        "\n".join(
            ["| effects | ms per recording |", "| --- | --- |", *(f"| {k} | {v} |" for k, v in steps_ms.items())]
        ),
        "## Whole processes, two cores, files written",
        table(["scene", "seconds", "peak memory, MB"], whole),
    ]
    return "\n\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    commands = processes()  # first: a child's peak memory is at least what its parent has at its birth
    seconds = seconds_of(steps(), options.repeats)
    names = list(seconds)
    found = {
        "what": "one recording of 15 s x 50 kHz x 3 channels, one core; least of several, in turn",
        "milliseconds_per_recording": {name: round(1e3 * value, 1) for name, value in seconds.items()},
        "orders_and_noise_over_campaign": round(seconds[names[1]] / seconds["+ encoder"], 3),
        "orders_and_noise_over_all": round(seconds[names[1]] / seconds[names[-1]], 3),
        "processes": commands,
    }
    publish("scenes", found, page(found), drawn(seconds, "+ encoder"))


if __name__ == "__main__":
    main()
