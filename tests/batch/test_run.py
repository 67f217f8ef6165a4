"""The command line, end to end, on a small synthetic test: results, reruns, bad input, exit status."""

import json
import shutil
from pathlib import Path

import h5py
import jsonschema
import numpy as np
import pytest
import xarray as xr
from scipy.special import ndtr, stdtrit

from crankorder.quantities import schema_of
from made.command import crankorder, done, findings_in, results_in


def run(*arguments):
    return crankorder("run", *arguments, "--recipe", "maps", "--no-pictures")


@pytest.fixture(scope="module")
def analysed(campaign, tmp_path_factory):
    out = tmp_path_factory.mktemp("analysed")
    done("run", campaign, "--out", out)
    return out


@pytest.fixture
def four_speeds(copied):
    return copied(1500, 1600, 1700, 1800)


def test_amplitude_and_phase_of_order_one_are_those_of_the_truth(analysed, campaign):
    truth = json.loads((campaign / "truth.json").read_bytes())["orders"]
    record = next(item for item in truth if item["channel"] == "Z" and item["order"] == 1.0)
    tracks = xr.load_dataset(next(analysed.glob("*/results.nc")), group="order_tracks", engine="h5netcdf")
    track = tracks.sel(channel="Z", order=1.0)
    expected = np.array(record["amplitude_by_speed"]) * np.exp(1j * np.radians(record["phase_deg_by_speed"]))
    measured = track["amplitude"].values * np.exp(1j * np.radians(track["phase"].values))
    # each of real and imaginary part is within four standard errors at every speed, or what is as unlikely for an
    # error that itself is known from few degrees of freedom
    reach = stdtrit(track["degrees_of_freedom"].values, ndtr(4.0))
    assert np.all(np.abs(measured - expected) < reach * np.sqrt(2) * track["standard_error"].values + 1e-4)


def edited(folder, old, new, count=-1):
    """``folder`` with ``new`` in the place of ``old`` in its manifest."""
    text = (folder / "run.toml").read_text()
    assert old in text
    (folder / "run.toml").write_text(text.replace(old, new, count))
    return folder


def test_every_file_of_the_contract_is_there(analysed):
    (folder,) = [path.parent for path in analysed.glob("*/findings.json")]
    names = {path.name for path in folder.iterdir()}
    pictures = {
        "campbell_X.png", "campbell_Y.png", "campbell_Z.png", "orders.png", "envelope.png", "order_spectra.png",
        "spectra.png", "speed.png",
    }  # fmt: skip
    assert names == pictures | {
        "results.nc", "findings.json", "report.html", "run.json", "timings.json", "done.json",
    }  # fmt: skip
    assert (analysed / "index.html").exists()
    assert f'href="./{folder.name}/report.html"' in (analysed / "index.html").read_text()


def test_json_files_fit_their_schemas(analysed):
    for name in ("findings", "run"):
        document = json.loads(next(analysed.glob(f"*/{name}.json")).read_bytes())
        assert list(jsonschema.Draft202012Validator(schema_of(name)).iter_errors(document)) == []


def test_nothing_of_host_or_time_is_in_run_json(analysed):
    import socket

    text = next(analysed.glob("*/run.json")).read_text()
    assert str(Path.home()) not in text.replace('"', "") or str(Path.home()) == "/"
    assert socket.gethostname() not in text
    assert str(analysed) not in text


def test_the_same_input_gives_the_same_bytes_with_one_worker_and_with_two(copied, tmp_path):
    folder = copied(1500, 1600)
    for jobs in (1, 2):
        assert crankorder("run", folder, "--out", tmp_path / str(jobs), "--jobs", jobs).exit_code == 0
    assert results_in(tmp_path / "1", kept=True) == results_in(tmp_path / "2", kept=True)


def test_report_redraws_the_same_bytes_from_results(four_speeds, tmp_path, recipe):
    crankorder("run", four_speeds, "--out", tmp_path / "out", *recipe)
    folder = next((tmp_path / "out").glob("*/done.json")).parent
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert crankorder("report", folder).exit_code == 0
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "begins"), [("svg", b"<?xml"), ("pdf", b"%PDF"), ("png", b"\x89PNG")])
def test_pictures_come_in_the_format_that_is_asked_for_with_the_same_bytes_again(analysed, tmp_path, kind, begins):
    folder = tmp_path / "test"
    shutil.copytree(next(analysed.glob("*/done.json")).parent, folder)
    names = {path.stem for path in folder.glob("*.png")}
    made = []
    for _ in range(2):
        assert crankorder("report", folder, "--picture-format", kind).exit_code == 0
        made.append({path.name: path.read_bytes() for path in folder.glob(f"*.{kind}")})
    assert {Path(name).stem for name in made[0]} == names
    assert made[0] == made[1]
    assert all(data.startswith(begins) for data in made[0].values())
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert all(f"./{name}" in page for name in made[0])
    assert kind == "png" or not list(folder.glob("*.png"))


@pytest.mark.slow
def test_without_pictures_numbers_and_findings_are_the_same(four_speeds, tmp_path):
    for place, more in (("with", ()), ("without", ("--no-pictures",))):
        assert crankorder("run", four_speeds, "--out", tmp_path / place, "-q", *more).exit_code == 0
    drawn, bare = (next((tmp_path / place).glob("*/done.json")).parent for place in ("with", "without"))
    assert not list(bare.glob("*.png"))
    assert "No pictures were asked for." in (bare / "report.html").read_text(encoding="utf-8")
    for name in ("results.nc", "findings.json"):
        assert (drawn / name).read_bytes() == (bare / name).read_bytes()


def test_a_truncated_file_a_missing_one_and_a_copy_take_no_other_along(four_speeds, tmp_path):
    path = four_speeds / "rpm_1600.h5"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    shutil.copy(four_speeds / "rpm_1500.h5", four_speeds / "rpm_1500_copy.h5")
    outcome = run(edited(four_speeds, '"rpm_*.h5"', '"rpm_*.h5", "lost.h5"'), "--out", tmp_path / "out")
    assert outcome.exit_code == 3
    assert "rpm_1600.h5" in outcome.output and "truncated" in outcome.output and "lost.h5" in outcome.output
    made = xr.load_dataset(next((tmp_path / "out").glob("*/results.nc")), group="order_map", engine="h5netcdf")
    assert [round(speed) for speed in made["speed"].values] == [1500, 1700, 1800]
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
def test_strict_leaves_out_what_is_suspect(four_speeds, tmp_path):
    with h5py.File(four_speeds / "rpm_1500.h5", "r+") as file:
        trace = file["encoder"][:]
        rises = np.flatnonzero(np.diff(trace) > 0)
        for rise in rises[::2000]:
            trace[rise + 1 : rise + 4] = 0.0
        file["encoder"][:] = trace
    assert run(four_speeds, "--out", tmp_path / "plain", "-q").exit_code == 0
    outcome = run(four_speeds, "--out", tmp_path / "strict", "--strict")
    assert outcome.exit_code == 3 and "rpm_1500.h5" in outcome.output


def test_one_bad_test_takes_no_other_along(copied, four_speeds, tmp_path):
    for path in four_speeds.glob("*.h5"):
        path.write_bytes(b"")
    other = copied(1500, 1600, 1700, name="other")
    assert crankorder("check", four_speeds, other).exit_code == 3
    assert crankorder("check", four_speeds).exit_code == 4
    outcome = run(four_speeds, other, "--out", tmp_path / "out", "--json")
    assert outcome.exit_code == 3
    assert [test["status"] for test in json.loads(outcome.stdout)["tests"]] == ["failed", "done"]


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """Recordings and results of the crank-angle test."""
    folder = tmp_path_factory.mktemp("crank-angle")
    assert crankorder("synth", "thesis-first-motoring", "--out", folder / "recordings", "-q").exit_code == 0
    assert crankorder("run", folder / "recordings", "--out", folder / "out", "-q").exit_code == 0
    return folder


def test_a_sentinel_in_the_files_own_unit_is_found_behind_a_sensitivity(four_speeds, tmp_path):
    for path in four_speeds.glob("*.h5"):
        with h5py.File(path, "r+") as file:
            file["acc_z"][1000] = -999.0
            file["acc_z"].attrs["unit"] = "V"
    source = 'source = "acc_z"'
    assert (
        run(edited(four_speeds, source, f'{source}\nsensitivity = "10 mV/(m/s2)"'), "--out", tmp_path / "out").exit_code
        == 0
    )
    assert "non_finite_interpolated" in {flag["flag"] for flag in findings_in(tmp_path / "out")["quality"]}


@pytest.mark.slow
def test_faults_come_in_the_order_of_the_files_whatever_the_workers(four_speeds, tmp_path):
    for name in ("rpm_1500.h5", "rpm_1600.h5"):
        (four_speeds / name).write_bytes(b"")
    for jobs in (1, 2):
        run(four_speeds, "--out", tmp_path / str(jobs), "--jobs", jobs, "-q")
    one, two = (next((tmp_path / str(jobs)).glob("*/findings.json")).read_bytes() for jobs in (1, 2))
    assert one == two
    bad = [flag["recording"] for flag in json.loads(one)["quality"] if flag["severity"] == "bad"]
    assert bad == ["rpm_1500.h5", "rpm_1600.h5"]  # two empty files are two faults, not one and its copy


@pytest.mark.slow
def test_orders_come_straight_from_the_samples_and_natural_frequencies_through_the_stated_speed(result):
    put_in, found = json.loads((result / "recordings" / "truth.json").read_bytes()), findings_in(result / "out")
    orders = {round(record["order"], 2) for record in found["orders"]}
    assert {1.0, 2.0, 5.5} <= orders <= {record["order"] for record in put_in["orders"] if record["speed_range_rpm"]}
    truth = np.array([mode["frequency_hz"] for mode in put_in["modes"]])
    modes = np.array([mode["frequency_hz"] for mode in found["modes"]])
    # four speeds of a few seconds: what is found is true, and at most one of the eight is too vague to be told
    assert all(np.abs(truth / frequency - 1).min() < 0.015 for frequency in modes)
    assert sum(np.abs(modes / frequency - 1).min() < 0.015 for frequency in truth) >= 7


@pytest.mark.slow
def test_without_a_speed_there_are_orders_and_no_map_of_frequencies(result, tmp_path):
    folder = tmp_path / "recordings"
    shutil.copytree(result / "recordings", folder)
    text = (folder / "run.toml").read_text()
    head, rest = text.split("[recordings.speed_rpm]")
    (folder / "run.toml").write_text(head + rest[rest.index("[sampling]") :])
    for path in folder.glob("*.h5"):
        with h5py.File(path, "r+") as file:
            file.attrs.pop("speed_rpm", None)
    done("run", folder, "--out", tmp_path / "out")
    assert {round(record["order"], 1) for record in findings_in(tmp_path / "out")["orders"]} >= {2.0, 5.5}
    assert not list((tmp_path / "out").glob("*/campbell_*.png"))
    assert list((tmp_path / "out").glob("*/order_spectra.png"))
