"""Recordings are called by their paths inside the folder: files of one name in several folders stay apart."""

import json

import numpy as np
import pytest
import xarray as xr

from made.command import crankorder
from made.recordings import write_hdf5, write_manifest

SPEEDS = {"a/x.h5": 1500.0, "b/x.h5": 2100.0, "x.h5": 1800.0}


def run(*arguments):
    return crankorder("run", *arguments, "--recipe", "maps", "--no-pictures")


def campaign(folder, speeds):
    """Three recordings called ``x.h5``, each of order 1 at its own speed; the manifest states ``speeds``."""
    for name, rpm in SPEEDS.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        time_s = np.arange(12_000) / 2000.0
        signal = 2.0 * np.cos(2.0 * np.pi * rpm / 60.0 * time_s)
        noise = 0.05 * np.random.default_rng(3).standard_normal(time_s.size)
        write_hdf5(path, {"a": signal + noise}, rate_hz=2000.0)
    tables = {"recordings": {"files": ["**/*.h5"], "speed_rpm": speeds}, "channels": {"A": {"source": "a"}}}
    return write_manifest(folder, name="names", **tables, encoder={"kind": "constant"})


def test_files_of_one_name_have_their_own_speeds_and_rows_and_faults_tell_which_of_them(tmp_path):
    folder, out = campaign(tmp_path / "in", SPEEDS), tmp_path / "out"
    assert run(folder, "--out", out).exit_code == 0
    with xr.open_datatree(out / "names" / "results.nc", engine="h5netcdf") as tree:
        shaft = tree["shaft"]
        assert dict(zip(shaft["recording"].values, shaft["speed_mean"].values, strict=True)) == SPEEDS
        np.testing.assert_allclose(tree["order_map"]["speed"].values, [1500.0, 1800.0, 2100.0])
    (folder / "b" / "x.h5").write_bytes(b"")
    assert run(folder, "--out", out).exit_code == 3
    (failed,) = json.loads((out / "batch.json").read_bytes())["tests"][0]["failed"]
    assert failed["recording"] == "b/x.h5"
    quality = json.loads((out / "names" / "findings.json").read_bytes())["quality"]
    assert [one["recording"] for one in quality if one["flag"] == "not_used"] == ["b/x.h5"]


@pytest.mark.parametrize(
    ("speeds", "said"),
    [
        ({"a/x.h5": 1500.0, "x.h5": 1800.0}, "b/x.h5: recordings.speed_rpm: the manifest states no speed"),
        ({**SPEEDS, "c/x.h5": 900.0}, "a speed is stated for no recording"),
        ({**SPEEDS, "b\\x.h5": 900.0}, "two speeds are stated for b/x.h5"),
    ],
)
def test_a_speed_is_stated_for_a_whole_path_once(tmp_path, speeds, said):
    told = crankorder("check", campaign(tmp_path / "in", speeds))
    assert told.exit_code != 0 and said in told.output


def test_a_folder_without_a_manifest_stops_no_other(tmp_path):
    sound, other = campaign(tmp_path / "in", SPEEDS), tmp_path / "notes"
    other.mkdir()
    done = run(other, sound, "--out", tmp_path / "out")
    assert done.exit_code == 3
    assert f"not analysed: {other / 'run.toml'}: there is no manifest" in done.output
    assert (tmp_path / "out" / "names" / "findings.json").is_file()
    assert crankorder("run", other, "--out", tmp_path / "out2").exit_code == 2
    assert not (tmp_path / "out2").exists()
