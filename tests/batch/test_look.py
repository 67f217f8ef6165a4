"""`check` finds what `run` would find: it reads a bounded part of the samples, and decodes them by the same code."""

import numpy as np
import pytest

from crankorder.batch import look
from crankorder.ingest.manifest import load_manifest
from crankorder.settings import load_settings
from made.command import crankorder, done
from made.recordings import manifest, write_hdf5, write_table

RATE_HZ, RPM, TEETH, LENGTH_S = 10_000.0, 1500.0, 24, 4.0

MANIFEST = manifest("*.h5", channels={"acc": {}}, encoder={"source": "encoder", "kind": "square", "pulses_per_rev": 24})


def columns(seed, *, length_s=LENGTH_S, rpm=RPM):
    """Signal of order 2 with noise, and the trace of a wheel."""
    rng = np.random.default_rng(seed)
    turns = rpm / 60.0 * np.arange(int(length_s * RATE_HZ)) / RATE_HZ
    acc = np.cos(4.0 * np.pi * turns) + 0.1 * rng.standard_normal(turns.size)
    return {"acc": acc, "encoder": ((turns + rng.random()) * TEETH % 1.0 < 0.5).astype(float)}


def write(folder, made, name="a.h5"):
    write_hdf5(folder / name, made, rate_hz=RATE_HZ)


def as_csv(folder, made):
    write_table(folder / "a.csv", {"t": np.round(np.arange(40_000) / RATE_HZ, 3), **made}, fmt="%.6f")


ROUNDED = MANIFEST.replace("*.h5", "*.csv").replace("[encoder]", '[sampling]\ntime_source = "t"\n[encoder]')
REFUSED = {
    "pulses per revolution not stated": (MANIFEST.replace("pulses_per_rev = 24\n", ""), {}),
    "noise for an encoder": (MANIFEST, {"encoder": np.random.default_rng(2).standard_normal(40_000)}),
    "a silent encoder": (MANIFEST, {"encoder": np.full(40_000, 2.5)}),
    "a flat channel": (MANIFEST, {"acc": np.full(40_000, 0.01)}),
    "rounded times": (ROUNDED, {}),
}
"""What run refuses: the manifest, and the columns that are others."""


@pytest.mark.parametrize("fault", REFUSED)
def test_what_run_would_refuse_is_a_fault_of_check(tmp_path, fault):
    folder, (text, others) = tmp_path / "data", REFUSED[fault]
    folder.mkdir()
    (folder / "run.toml").write_text(text)
    (as_csv if text == ROUNDED else write)(folder, columns(1) | others)
    ran, checked = crankorder("run", folder, "--out", tmp_path / "out", "-q"), crankorder("check", folder)
    assert ran.exit_code != 0
    assert checked.exit_code == ran.exit_code  # 2 where the manifest is wrong, 4 where no recording is left
    assert "no fault found" not in checked.output


def test_a_folder_is_told_line_by_line_and_lost_recordings_are_named_beside_the_others(tmp_path):
    (tmp_path / "run.toml").write_text(MANIFEST)
    for number, rpm in enumerate((900.0, 1500.0)):
        write(tmp_path, columns(number, rpm=rpm), f"rpm {rpm:.0f}.h5")
    text = done("check", tmp_path).output
    for rpm, pulses in ((900, 1440), (1500, 2400)):
        assert f"\nrpm {rpm}.h5: 4 s at 10000 Hz, {rpm} rpm, {pulses} pulses (24 per revolution)" in f"\n{text}"
    assert "no fault found in the 100 % that was read" in text
    write(tmp_path, columns(2) | {"encoder": np.zeros(40_000)}, "b.h5")
    write(tmp_path, columns(3) | {"acc": np.clip(columns(3)["acc"], -0.6, 0.6)}, "c.h5")
    outcome = crankorder("check", tmp_path)
    assert outcome.exit_code == 3
    assert "b.h5: " in outcome.output and "rpm 900.h5: 4 s at 10000 Hz" in outcome.output
    assert "c.h5: left out of all averages; found clipped" in outcome.output
    assert "is lost; allowed: 5 % between its ends" in outcome.output  # flat in every period, not in one stretch


def test_of_a_long_recording_head_middle_and_tail_are_read(tmp_path, monkeypatch):
    (tmp_path / "run.toml").write_text(MANIFEST)
    made = columns(4, length_s=60.0)
    made["acc"][-50_000:] = 0.0  # a cable that came off
    write(tmp_path, made)
    monkeypatch.setattr(look, "LOOK_BYTES", 2 * 8 * 240_000)
    found = look.look_at_recording(tmp_path / "a.h5", load_manifest(tmp_path), load_settings())
    assert found.share == pytest.approx(0.4)
    assert "60 s at 10000 Hz, 1500 rpm" in found.line and "40 % read" in found.line
    assert any("acc" in remark for remark in found.remarks)
