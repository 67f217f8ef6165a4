"""Files by crank angle that hold a column of angles: a manifest that contradicts it is refused, whatever the format."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from tests.made.command import crankorder

from crankorder.errors import InputError
from crankorder.ingest.draft import draft_manifest
from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_recording

TURNS = 12


def as_text(folder: Path, angle: np.ndarray, pressure: np.ndarray) -> None:
    table = np.column_stack((angle, pressure))
    np.savetxt(
        folder / "a.txt", table, delimiter="\t", fmt=("%.3f", "%.5f"), header="CA (deg)\tp_cyl (bar)", comments=""
    )


def as_xlsx(folder: Path, angle: np.ndarray, pressure: np.ndarray) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="the package openpyxl (extra xlsx) is not installed")
    book = openpyxl.Workbook()
    for row in [["Crank angle [deg]", "p [bar]"], *np.column_stack((angle, pressure)).tolist()]:
        book.active.append(row)
    book.save(folder / "a.xlsx")


def as_hdf5(folder: Path, angle: np.ndarray, pressure: np.ndarray) -> None:
    with h5py.File(folder / "a.h5", "w") as file:
        file["alpha"], file["p"] = np.deg2rad(angle), pressure.astype(np.float32)
        file["alpha"].attrs["units"], file["p"].attrs["units"] = "rad", "bar"


def as_matlab(folder: Path, angle: np.ndarray, pressure: np.ndarray) -> None:
    scipy.io.savemat(folder / "a.mat", {"crank_angle": angle, "p_cyl": pressure})


def as_numpy(folder: Path, angle: np.ndarray, pressure: np.ndarray) -> None:
    table = np.empty(angle.size, dtype=[("p_cyl", "f4"), ("crank_angle_deg", "f4")])
    table["p_cyl"], table["crank_angle_deg"] = pressure, angle
    np.save(folder / "a.npy", table)


def as_mdf4(folder: Path, angle: np.ndarray, pressure: np.ndarray) -> None:
    asammdf = pytest.importorskip("asammdf", reason="the package asammdf (extra mdf) is not installed")
    growing = np.unwrap(angle, period=720.0)  # a master grows
    signal = asammdf.Signal(pressure, growing, unit="bar", name="p_cyl", master_metadata=("angle", 2))
    with asammdf.MDF(version="4.10") as file:
        file.append([signal])
        file.save(folder / "a.mf4", overwrite=True)


WRITERS = [as_text, as_xlsx, as_hdf5, as_matlab, as_numpy, as_mdf4]


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_manifest_that_contradicts_the_files_angles_is_refused_and_a_right_one_is_not(
    tmp_path, settings, write, seed
):
    rng = np.random.default_rng(seed)
    per_rev = int(rng.choice([180, 360, 1024]))
    start = -360.0 if seed == 1 else float(rng.integers(0, per_rev)) * 360.0 / per_rev
    angle = (start + np.arange(TURNS * per_rev) * 360.0 / per_rev + 360.0) % 720.0 - 360.0
    write(tmp_path, angle, 10.0 + np.cos(np.deg2rad(angle)) + 0.01 * rng.standard_normal(angle.size))
    text = draft_manifest(tmp_path).replace('cycle = "rotor"', 'cycle = "four-stroke"')

    def read(text):
        (tmp_path / "run.toml").write_text(text, encoding="utf-8")
        manifest, path = load_manifest(tmp_path), next(tmp_path.glob("a.*"))
        return read_recording(path, manifest, settings=settings.ingest, shaft=settings.shaft).attrs

    drafted = read(text)
    assert drafted["samples_per_rev"] == per_rev
    assert drafted["start_deg"] == pytest.approx(start, abs=1e-3)
    base = "\n".join(line for line in text.splitlines() if not line.startswith("start_deg"))
    stated = f"samples_per_rev = {per_rev}"
    assert read(base.replace(stated, f"{stated}\nstart_deg = {start + 720.0}"))["start_deg"] == start + 720.0
    for wrong in (2 * per_rev, per_rev + 1):
        with pytest.raises(InputError, match=rf"found {wrong}; allowed: {per_rev}\b"):
            read(text.replace(stated, f"samples_per_rev = {wrong}"))
    for off in (360.0, 7.0, -90.0):
        with pytest.raises(InputError, match=r"sampling.start_deg: the manifest contradicts"):
            read(base.replace(stated, f"{stated}\nstart_deg = {start + off}"))


def test_check_and_run_refuse_it_and_columns_of_other_angles_count_for_nothing(tmp_path):
    angle = np.tile(np.arange(-360.0, 360.0, 0.5), 10)
    rng = np.random.default_rng(3)
    table = np.column_stack((angle, 10.0 + np.cos(np.deg2rad(angle)), rng.normal(20.0, 1.0, angle.size)))
    header = "CA (deg)\tp_cyl (bar)\tthrottle (deg)"
    np.savetxt(tmp_path / "a.txt", table, delimiter="\t", fmt="%.4f", header=header, comments="")
    text = draft_manifest(tmp_path)
    for stated, code in [("720", 0), ("1440", 1)]:
        (tmp_path / "run.toml").write_text(text.replace("samples_per_rev = 720", f"samples_per_rev = {stated}"))
        checked, ran = (
            crankorder("check", tmp_path),
            crankorder("run", tmp_path, "--out", tmp_path.parent / f"{tmp_path.name}-out", "--no-pictures"),
        )
        assert (bool(checked.exit_code), bool(ran.exit_code)) == (bool(code), bool(code)), checked.output + ran.output
        assert ("found 1440; allowed: 720" in checked.output) == bool(code)
