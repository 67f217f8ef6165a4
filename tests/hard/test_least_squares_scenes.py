"""Close orders and two shafts as scenes: recordings with encoder, resonances and noise, compared with their truth."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from crankorder.cli import main
from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_recording
from crankorder.orders.least_squares import joint_orders
from crankorder.orders.least_squares_tracks import tracked_orders
from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_at, knots_of
from crankorder.shaft.decode import shaft_angle
from crankorder.shaft.knowledge import ShaftKnowledge

SETTINGS = load_settings()
PUMP_HZ = 1750.0 / 60.0
"""Speed of the second shaft of `two-shafts`, which its manifest may not say."""


@pytest.fixture
def scene(tmp_path):
    def made(name):
        assert CliRunner().invoke(main, ["synth", name, "--out", str(tmp_path / name)]).exit_code == 0
        folder = tmp_path / name
        (file,) = folder.glob("*.h5")
        recording = read_recording(file, load_manifest(folder), settings=SETTINGS.ingest, shaft=SETTINGS.shaft)
        shaft = shaft_angle(recording, settings=SETTINGS.shaft, knowledge=ShaftKnowledge())
        return recording, shaft, json.loads((folder / "truth.json").read_text())

    return made


@pytest.mark.slow
def test_a_locked_order_and_one_that_slips_by_two_in_a_thousand_are_told_apart(scene):
    recording, shaft, truth = scene("hard-close-orders")
    settings = SETTINGS.orders.model_copy(update={"revs_per_frame": 120})
    made = tracked_orders(recording, shaft, [5.5, 5.489], settings=settings)
    hits = []
    for record in truth["orders"]:
        if record["order"] in (5.5, 5.489):
            line = made.sel(channel=record["channel"], order=record["order"])
            hits += [(line["amplitude_low"] <= record["amplitude"]) & (record["amplitude"] <= line["amplitude_high"])]
            mean = np.abs(line["amplitude"].values).mean()
            assert abs(mean - record["amplitude"]) < 4 * float(line["standard_error"].mean()) / np.sqrt(len(line.frame))
    share = np.mean(hits)
    assert abs(share - 0.95) < 4 * np.sqrt(0.95 * 0.05 / np.size(hits))


@pytest.mark.slow
def test_two_shafts_half_a_per_cent_apart_are_told_apart_in_a_run_up_that_a_third_crosses(scene):
    recording, shaft, truth = scene("two-shafts")
    time_s = (
        float(recording.attrs.get("start_s", 0.0)) + np.arange(recording.sizes["time"]) / recording.attrs["rate_hz"]
    )
    angle = angle_at(time_s, **knots_of(shaft))
    known = np.isfinite(angle)
    phases = np.stack([angle[known], 1.005 * angle[known], 2.0 * PUMP_HZ * time_s[known]])
    made = joint_orders(recording["signal"].values[:, known], phases, degree=5)
    share = np.linspace(0.05, 0.95, 19)
    speed = np.interp(np.interp(share, [0.0, 1.0], time_s[known][[0, -1]]), [0.0, 40.0], [900.0, 2700.0])
    found = np.abs(made.along(share))
    channels = recording["channel"].values.tolist()
    for record in truth["orders"]:
        if record["channel"] == "X":  # a tenth of the others': its resonance is not one polynomial
            continue
        true = np.interp(speed, record["speed_rpm"], record["amplitude_by_speed"])
        error = found[channels.index(record["channel"]), [1.0, 1.005].index(record["order"])] - true
        assert np.abs(error).max() < 0.006 * true.max()
