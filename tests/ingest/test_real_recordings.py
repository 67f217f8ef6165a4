"""The manifests of tests/real read the real recordings, and the facts known of them come out."""

from pathlib import Path

import numpy as np
import pytest

from crankorder.ingest.check import check_folder
from crankorder.ingest.folder import recordings_of
from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_recording
from crankorder.quantities import check_dataset, flags_of

MANIFESTS = Path(__file__).parents[1] / "real"
FOLDERS = {
    "ansys_accel": "ansys_accel", "rotorbalancer": "rotorbalancer", "rotor_groups": "rotorbalancer",
    "tue_genset": "tue_genset", "tue_training": "tue_genset", "auth_360ppr": "auth_360ppr",
}  # fmt: skip


@pytest.fixture
def recordings(real_data, settings):
    def read(name):
        folder = real_data / FOLDERS[name]
        manifest = load_manifest(folder, MANIFESTS / f"{name}.toml")
        found = recordings_of(folder, manifest)
        assert not found.faults
        out = [read_recording(path, manifest, settings=settings.ingest, shaft=settings.shaft) for path in found.paths]
        for recording in out:
            check_dataset(recording, "recording")
            assert all(flag["severity"] == "info" for flag in flags_of(recording)), flags_of(recording)
        return out

    return read


def test_check_finds_no_fault_in_the_real_folders(real_data, settings):
    for name in FOLDERS:
        assert check_folder(real_data / FOLDERS[name], MANIFESTS / f"{name}.toml", settings=settings.ingest) == []


def test_the_run_up_has_the_speeds_of_its_reference(recordings, real_data):
    (recording,) = recordings("ansys_accel")
    table = real_data / "ansys_accel" / "reference_order_levels_dBSPL_2_4_10_15_30_61.2.txt"
    speeds = [
        float(line.split("\t")[0])
        for line in table.read_text("latin-1").splitlines()
        if line[:1].isdigit() and "\t" in line
    ]
    speed = recording["speed_signal"].values
    assert speed[0] == pytest.approx(speeds[0], rel=1e-6)
    assert (round(speed.min()), round(speed.max())) == (969, 4821)
    assert recording.attrs["rate_hz"] == 44_100.0
    assert str(recording["unit"].values[0]) == "Pa"
    # full scale is 1 Pa x 0.99655
    assert np.abs(recording["signal"]).max() < 0.99655
