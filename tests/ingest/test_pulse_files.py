"""Recordings and the files of their pulses, paired by a part of their names, as a manifest says or a draft finds."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from tests.made.command import analysed, crankorder

from crankorder.ingest.draft import draft_manifest
from crankorder.ingest.manifest import load_manifest, parts_of

RPM = {f"step_{step:02d}_{rpm:.0f}rpm": rpm for step, rpm in enumerate((900.0, 1010.0, 1150.0, 1310.0), 1)}


def columns_of(rpm: float, seed: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Samples and events on one clock of whole microseconds; order 1 of 0.02 (rpm/1000)² g at -75°."""
    rng, hz = np.random.default_rng(seed), rpm / 60.0
    us = 1_700_000_123 + seed * 31_000_000 + 1000 * np.arange(6000)
    at = 0.013 + np.arange(int(5.9 * hz)) / hz + rng.uniform(-1e-5, 1e-5, int(5.9 * hz))
    y = 0.02 * (rpm / 1000.0) ** 2 * np.cos(2.0 * np.pi * hz * (1e-3 * np.arange(6000) - 0.013) - np.deg2rad(75.0))
    samples = {"timestamp_us": us, "y_g": y + 0.002 * rng.standard_normal(6000)}
    events = {"timestamp_us": us[0] + np.rint(at * 1e6).astype(np.int64), "rotation_num": np.arange(at.size)}
    return samples, events


def write(path: Path, columns: dict[str, np.ndarray]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".h5":
        with h5py.File(path, "w") as file:
            for name, values in columns.items():
                file[name] = values
        return
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    text = [
        ",".join(columns),
        *(",".join(f"{value:.9g}" if value < 1e3 else str(value) for value in row) for row in rows),
    ]
    path.write_text("\n".join(text) + "\n", encoding="utf-8")


def folder_of(folder: Path, samples: str, events: str) -> Path:
    for seed, (run, rpm) in enumerate(RPM.items(), 1):
        for pattern, columns in zip((samples, events), columns_of(rpm, seed), strict=True):
            write(folder / pattern.format(run=run), columns)
    return folder


def manifest(folder: Path, files: str, pulses: str) -> None:
    text = f"""schema_version = 1
test.cycle = "rotor"
recordings.files = ["{files}"]
sampling.time_source = "timestamp_us"
encoder = {{file = "{pulses}", source = "timestamp_us", kind = "pulse_times", pulses_per_rev = 1}}
[[channels]]
name = "y_g"
unit = "g"
"""
    (folder / "run.toml").write_text(text, encoding="utf-8")


def is_right(findings: dict) -> None:
    (order,) = [order for order in findings["orders"] if order["channel"] == "y_g"]
    assert order["amplitude"] == pytest.approx(0.02 * 1.31**2, rel=0.02)
    assert order["phase_deg"] == pytest.approx(-75.0, abs=1.0)
    assert order["speed_exponent"] == pytest.approx(2.0, abs=0.1)


NAMES = [
    ("MSG_ACCEL_SAMPLES_{run}.csv", "MSG_HALL_EVENT_{run}.csv"),
    ("{run}_acc.csv", "{run}_hall.csv"),
    ("{run}.h5", "{run}.hall"),
    ("acc {run} y.csv", "tacho {run} z.csv"),
]


@pytest.mark.parametrize(("samples", "events"), NAMES)
def test_a_draft_pairs_recordings_with_the_files_of_their_pulses(tmp_path, samples, events):
    folder = folder_of(tmp_path / "hall", samples, events)
    text = draft_manifest(folder)
    (folder / "run.toml").write_text(text, encoding="utf-8")
    drafted = load_manifest(folder)
    assert drafted.encoder.kind == "pulse_times" and drafted.encoder.source == "timestamp_us"
    for run in RPM:
        assert drafted.pulses_of(folder / samples.format(run=run)) == folder / events.format(run=run)
    assert "1                # ? 15 pulses/s at the stated speed" in text
    is_right(analysed(folder, tmp_path / "out", "--no-pictures"))


@pytest.mark.parametrize("other", ["temperature", "speed", "later"])
def test_a_draft_takes_no_slow_recording_for_pulses(tmp_path, other):
    folder = folder_of(tmp_path / "hall", "acc_{run}.csv", "slow_{run}.csv")
    for seed, (run, rpm) in enumerate(RPM.items(), 1):
        samples, _ = columns_of(rpm, seed)
        us = samples["timestamp_us"][::100] + (0 if other != "later" else 10**9)
        slow = 85.0 + 0.1 * np.random.default_rng(seed).standard_normal(us.size)
        columns = {"temperature": {"oil": slow}, "speed": {"rpm": rpm + slow}, "later": {"turns": np.arange(us.size)}}
        write(folder / f"slow_{run}.csv", {"timestamp_us": us} | columns[other])
    assert "file = " not in draft_manifest(folder)


def test_parts_of_names_are_any_number_and_may_come_again():
    rows = [
        ("ACC_{a}_{b}.csv", "ACC_1_x2.csv", {"a": "1", "b": "x2"}),
        ("{a}/ACC_{a}.csv", "q/ACC_q.csv", {"a": "q"}),
        ("{a}/ACC_{a}.csv", "q/ACC_r.csv", None),
        ("**/M_{s}[12].csv", "u/v/M_52.csv", {"s": "5"}),
        ("**/M_{s}.csv", "M_5.csv", {"s": "5"}),
        ("*_{a}_*.csv", "x_y_z.csv", {"a": "y"}),
    ]
    for pattern, name, parts in rows:
        assert parts_of(pattern, name) == parts


def test_parts_that_do_not_pair_are_refused(tmp_path):
    folder = folder_of(tmp_path / "hall", "ACC_{run}.csv", "HALL_{run}.csv")
    (folder / "HALL_step_03_5rpm.csv").write_text("left alone\n")
    rows = [
        ("ACC_{run}.csv", "HALL_{run}.csv", ""),
        ("ACC_step_{number}_{rpm}rpm.csv", "HALL_step_{number}_{rpm}rpm.csv", ""),
        ("ACC_{run}.csv", "HALL_{step}.csv", "found {step}; allowed: {run}. Write {step} in each pattern"),
        ("ACC_*.csv", "HALL_{step}.csv", "found {step}; allowed: * alone"),
        (
            "ACC_{run}.csv",
            "HALL_step_01_900rpm.csv",
            "HALL_step_01_900rpm.csv for ACC_step_01_900rpm.csv, ACC_step_02",
        ),
        ("ACC_{run}.csv", "PULSE_{run}.csv", "PULSE_step_01_900rpm.csv: no such file"),
        ("ACCEL_{run}.csv", "HALL_{run}.csv", "no recording found; looked for ACCEL_{run}.csv"),
    ]
    for files, pulses, words in rows:
        manifest(folder, files, pulses)
        checked = crankorder("check", folder)
        assert bool(checked.exit_code) == bool(words), checked.output
        assert words in checked.output
    manifest(folder, "ACC_{run}.csv", "HALL_{run}.csv")
    is_right(analysed(folder, tmp_path / "out", "--no-pictures"))
