"""A manifest without an encoder may ask for the speed from the vibration itself."""

from __future__ import annotations

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from crankorder.errors import ManyErrors
from made.command import analysed, done
from made.recordings import HEAD, read_manifest


def test_a_range_of_speeds_is_one_and_belongs_to_the_kind(tmp_path: Path) -> None:
    rows = [
        ('kind = "vibration"\nexpected_rpm = [900.0, 800.0]', "the lowest and the highest speed"),
        ('kind = "constant"\nspeed_rpm = 900.0\nexpected_rpm = [800.0, 900.0]', "goes with kind"),
    ]
    for encoder, words in rows:
        with pytest.raises(ManyErrors, match=words):
            read_manifest(tmp_path, "", encoder=encoder)


def test_a_recording_without_encoder_gives_its_orders(tmp_path: Path) -> None:
    """Speed and amplitudes are those that were put in; the phase has no reference and says so."""
    (tmp_path / "in").mkdir()
    encoder = 'kind = "vibration"\nexpected_rpm = [800.0, 3000.0]'
    (tmp_path / "in" / "run.toml").write_text(HEAD + encoder)
    time_s = np.arange(8 * 4096) / 4096.0
    put_in = {1.0: 1.0, 2.0: 0.7, 3.0: 0.5}
    with h5py.File(tmp_path / "in" / "a.h5", "w") as file:
        file.attrs["rate_hz"] = 4096.0
        turning = sum(size * np.cos(2 * np.pi * order * 25.0 * time_s) for order, size in put_in.items())
        file["Z"] = turning + 0.1 * np.random.default_rng(1).standard_normal(time_s.size)
    findings = analysed(tmp_path / "in", tmp_path / "out", "--no-pictures")
    assert findings["speed_range_rpm"] == pytest.approx([1500.0, 1500.0], rel=1e-3)
    found = {round(record["order"], 1): record for record in findings["orders"]}
    for order, size in put_in.items():
        assert found[order]["amplitude"] == pytest.approx(size, rel=0.02)
        assert found[order]["phase_deg"] is None
    assert "no_index" in {flag["flag"] for flag in findings["quality"]}


@pytest.mark.slow
def test_a_firing_engine_without_encoder_gives_its_orders(tmp_path: Path) -> None:
    """Speed and amplitudes against the truth of the scene; the phase has no reference and says so."""
    folder = tmp_path / "recordings"
    done("synth", "thesis-second-firing", "--out", folder, "--quick", "-q")
    text = (folder / "run.toml").read_text()
    start = text.index("[encoder]")
    end = start + 1 + re.search(r"\n\[", text[start:]).start()
    vibration = '[encoder]\nkind = "vibration"\nexpected_rpm = [800.0, 3000.0]\n\n'
    (folder / "run.toml").write_text(text[:start] + vibration + text[end:])
    findings = analysed(folder, tmp_path / "out", "--no-pictures")
    assert findings["speed_range_rpm"] == pytest.approx([1500.0, 2000.0], rel=1e-3)
    truth = json.loads((folder / "truth.json").read_bytes())["orders"]
    found = {round(record["order"], 1): record for record in findings["orders"] if record["channel"] == "Z"}
    for order in (2.0, 2.5, 3.5):
        put_in = next(r["amplitude"] for r in truth if r["channel"] == "Z" and r["order"] == order)
        assert found[order]["amplitude"] == pytest.approx(put_in, rel=0.05)
        assert found[order]["phase_deg"] is None
    assert "no_index" in {flag["flag"] for flag in findings["quality"]}
