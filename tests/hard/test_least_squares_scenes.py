"""Close orders and two shafts as scenes: recordings with encoder, resonances and noise, compared with their truth."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from crankorder.cli import main
from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_recording
from crankorder.orders.least_squares import tracked_orders
from crankorder.settings import load_settings
from crankorder.shaft.decode import ShaftKnowledge, shaft_angle

SETTINGS = load_settings()
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
