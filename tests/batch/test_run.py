"""The command line, end to end, on a small synthetic test: results, reruns, bad input, exit status."""

import json
import shutil
import socket
from pathlib import Path

import h5py
import jsonschema
import numpy as np
import pytest
import xarray as xr

from crankorder.batch.frame_store import STORE
from crankorder.quantities import schema_of
from made.command import crankorder, done, findings_in, results_in


def run(*arguments):
    return crankorder("run", *arguments, "--recipe", "maps", "--no-pictures")


@pytest.fixture
def two(copied):
    return copied(1500, 1800)


def folder_of(out):
    """The folder of the only test in ``out``."""
    (marker,) = out.glob("*/done.json")
    return marker.parent


def edited(folder, old, new, count=-1):
    """``folder`` with ``new`` in the place of ``old`` in its manifest."""
    text = (folder / "run.toml").read_text()
    assert old in text
    (folder / "run.toml").write_text(text.replace(old, new, count))
    return folder


def test_every_file_of_the_contract_is_there(analysed):
    folder = folder_of(analysed / "out")
    assert {path.name for path in folder.iterdir()} == {
        "campbell_X.png", "campbell_Y.png", "campbell_Z.png", "orders.png", "envelope.png", "order_spectra.png",
        "spectra.png", "speed.png", "results.nc", "findings.json", "report.html", "run.json", "timings.json",
        "done.json",
    }  # fmt: skip
    assert f'href="./{folder.name}/report.html"' in (analysed / "out" / "index.html").read_text()
    for name in ("findings", "run"):
        document = json.loads((folder / f"{name}.json").read_bytes())
        assert list(jsonschema.Draft202012Validator(schema_of(name)).iter_errors(document)) == []


def test_nothing_of_host_or_time_is_in_run_json(analysed):
    text = (folder_of(analysed / "out") / "run.json").read_text()
    assert str(Path.home()) not in text.replace('"', "") or str(Path.home()) == "/"
    assert socket.gethostname() not in text
    assert str(analysed) not in text


def test_the_same_input_gives_the_same_bytes_with_one_worker_and_with_two(analysed):
    out = analysed / "by one"  # beside the other: where recordings lie from there is a part of the results
    done("run", analysed / "recordings", "--out", out, "--jobs", 1)
    assert results_in(out, kept=True) == results_in(analysed / "out", kept=True)


def test_report_redraws_the_same_bytes_from_results(analysed, tmp_path):
    folder = shutil.copytree(folder_of(analysed / "out"), tmp_path / "test")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    done("report", folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "begins"), [("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_pictures_come_in_the_format_that_is_asked_for(analysed, tmp_path, kind, begins):
    folder = shutil.copytree(folder_of(analysed / "out"), tmp_path / "test")
    names = {path.stem for path in folder.glob("*.png")}
    done("report", folder, "--picture-format", kind)
    pictures = list(folder.glob(f"*.{kind}"))
    assert {path.stem for path in pictures} == names and not list(folder.glob("*.png"))
    assert all(path.read_bytes().startswith(begins) for path in pictures)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert all(f"./{path.name}" in page for path in pictures)


def test_without_pictures_numbers_and_findings_are_the_same(analysed, tmp_path):
    shutil.copytree(analysed / "out" / STORE, tmp_path / "out" / STORE)  # what is kept of the recordings
    done("run", analysed / "recordings", "--out", tmp_path / "out", "-q", "--no-pictures")
    drawn, bare = folder_of(analysed / "out"), folder_of(tmp_path / "out")
    assert not list(bare.glob("*.png"))
    assert "No pictures were asked for." in (bare / "report.html").read_text(encoding="utf-8")
    for name in ("results.nc", "findings.json"):
        assert (drawn / name).read_bytes() == (bare / name).read_bytes()


def test_a_truncated_file_a_missing_one_and_a_copy_take_no_other_along(copied, tmp_path):
    folder = copied(1500, 1600, 1700)
    path = folder / "rpm_1600.h5"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    shutil.copy(folder / "rpm_1500.h5", folder / "rpm_1500_copy.h5")
    outcome = run(edited(folder, '"rpm_*.h5"', '"rpm_*.h5", "lost.h5"'), "--out", tmp_path / "out")
    assert outcome.exit_code == 3
    assert "rpm_1600.h5" in outcome.output and "truncated" in outcome.output and "lost.h5" in outcome.output
    made = xr.load_dataset(next((tmp_path / "out").glob("*/results.nc")), group="order_map", engine="h5netcdf")
    assert [round(speed) for speed in made["speed"].values] == [1500, 1700]
    flags = findings_in(tmp_path / "out")["quality"]
    assert {flag["recording"] for flag in flags if flag["severity"] == "bad"} == {"rpm_1600.h5", "lost.h5"}
    assert [flag["recording"] for flag in flags if flag["flag"] == "duplicate_of"] == ["rpm_1500_copy.h5"]


@pytest.mark.parametrize(
    ("old", "new", "status", "words"),
    [
        ('"acc_z"', '"acc_w"', 4, ("acc_w", "acc_x")),  # the channels that the file has
        ('unit = "m/s2"', 'unit = "metres"', 2, ("metres", "m/s2", "run.toml:")),
        ('"rpm_*.h5"', '"none_*.h5"', 4, ("none_*.h5",)),
    ],
)
def test_what_is_wrong_in_the_manifest_is_told_with_what_is_allowed(copied, tmp_path, old, new, status, words):
    outcome = run(edited(copied(1500), old, new, 1), "--out", tmp_path / "out")
    assert outcome.exit_code == status
    assert all(word in outcome.output for word in words)
    assert not list(tmp_path.glob("out/*/done.json"))


def test_a_missing_folder_and_an_empty_one(tmp_path):
    assert run(tmp_path / "nowhere", "--out", tmp_path / "out").exit_code == 2
    (tmp_path / "empty").mkdir()
    outcome = run(tmp_path / "empty", "--out", tmp_path / "out")
    assert outcome.exit_code == 2 and "crankorder init" in outcome.output
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_strict_leaves_out_what_is_suspect(two, tmp_path):
    with h5py.File(two / "rpm_1500.h5", "r+") as file:
        trace = file["encoder"][:]
        rises = np.flatnonzero(np.diff(trace) > 0)
        for rise in rises[::2000]:
            trace[rise + 1 : rise + 4] = 0.0
        file["encoder"][:] = trace
    assert run(two, "--out", tmp_path / "plain", "-q").exit_code == 0
    outcome = run(two, "--out", tmp_path / "strict", "--strict")
    assert outcome.exit_code == 3 and "rpm_1500.h5" in outcome.output


def test_one_bad_test_takes_no_other_along_and_its_faults_come_in_the_order_of_the_files(copied, two, tmp_path):
    for path in two.glob("*.h5"):
        path.write_bytes(b"")
    other = copied(1500, 1600, name="other")
    assert crankorder("check", two, other).exit_code == 3
    assert crankorder("check", two).exit_code == 4
    outcome = run(two, other, "--out", tmp_path / "out", "--json")
    assert outcome.exit_code == 3
    bad, good = json.loads(outcome.stdout)["tests"]
    assert (bad["status"], good["status"]) == ("failed", "done")
    # two empty files are two faults, not one and its copy
    assert [one["recording"] for one in bad["failed"][:2]] == ["rpm_1500.h5", "rpm_1800.h5"]


def test_a_sentinel_in_the_files_own_unit_is_found_behind_a_sensitivity(two, tmp_path):
    for path in two.glob("*.h5"):
        with h5py.File(path, "r+") as file:
            file["acc_z"][1000] = -999.0
            file["acc_z"].attrs["unit"] = "V"
    stated = edited(two, 'source = "acc_z"', 'source = "acc_z"\nsensitivity = "10 mV/(m/s2)"')
    assert run(stated, "--out", tmp_path / "out").exit_code == 0
    assert "non_finite_interpolated" in {flag["flag"] for flag in findings_in(tmp_path / "out")["quality"]}


@pytest.mark.slow
def test_without_a_speed_there_are_orders_and_no_map_of_frequencies(recordings_of, tmp_path):
    folder = shutil.copytree(recordings_of("thesis-first-motoring"), tmp_path / "recordings")  # by crank angle
    head, rest = (folder / "run.toml").read_text().split("[recordings.speed_rpm]")
    (folder / "run.toml").write_text(head + rest[rest.index("[sampling]") :])
    for path in folder.glob("*.h5"):
        with h5py.File(path, "r+") as file:
            file.attrs.pop("speed_rpm", None)
    done("run", folder, "--out", tmp_path / "out")
    assert {round(record["order"], 1) for record in findings_in(tmp_path / "out")["orders"]} >= {2.0, 5.5}
    assert not list((tmp_path / "out").glob("*/campbell_*.png"))
    assert list((tmp_path / "out").glob("*/order_spectra.png"))
