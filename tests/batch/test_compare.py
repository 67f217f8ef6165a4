"""The command `compare`, end to end: one document, whole folders, clear faults, the same bytes."""

import json
import shutil
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from crankorder.batch.compare import KindOfTest, partners
from crankorder.batch.result_folder import DONE, finished_with, publish
from crankorder.quantities import schema_of
from crankorder.report.netcdf import read_results, results_bytes
from made.command import crankorder, results_in
from made.two_tests import made_test, written

LINES = {1.0: lambda rpm: 0.5 * (rpm / 1000) ** 2, 5.5: lambda rpm: 0.4}


def compare(*arguments):
    return crankorder("compare", *arguments)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Result folders of a base test, one whose order 5.5 grew by half from run to run, and a balanced one."""
    out = tmp_path_factory.mktemp("results")
    made = {
        f"run {k}": made_test({**LINES, 5.5: lambda rpm, k=k: 0.4 * 1.5**k}, name=f"run {k}", seed=k) for k in range(3)
    }
    less = {1.0: lambda rpm: 0.1 * (rpm / 1000) ** 2 * np.exp(0.5j), 5.5: lambda rpm: 0.4}
    added = {"manifest": {**made["run 0"].run["manifest"], "added_masses": [ADDED]}}
    made["balanced"] = made_test(less, name="balanced", seed=7, run=added)
    return {name: written(test, out / name.replace(" ", "-")) for name, test in made.items()}


ADDED = {"mass_g": 2.0, "on": "crank", "radius_mm": 40.0, "angle_deg": 180.0, "cylinder": 0}


def document(out):
    return json.loads((out / "comparison.json").read_bytes())


def test_a_comparison_is_published_whole_and_says_its_headline(results, tmp_path):
    outcome = compare(results["run 0"], results["run 2"], "--out", tmp_path / "c")
    assert outcome.exit_code == 0, outcome.output
    made = document(tmp_path / "c")
    assert outcome.stdout.splitlines() == made["headline"]
    assert "5.5" in outcome.stdout and made["cause"]["orders"] == [5.5]
    names = {path.name for path in (tmp_path / "c").iterdir()}
    assert names == {"comparison.json", "comparison.nc", "comparison.html", DONE, "orders_change.png"}
    assert finished_with(tmp_path / "c", json.loads((tmp_path / "c" / DONE).read_bytes())["key"])
    orders = read_results(tmp_path / "c" / "comparison.nc")["order_change"]
    assert set(orders["order"].values[orders["changed"].values.any(axis=1)]) == {5.5}


def test_a_balance_weight_is_recognised_and_weighed_by_the_same_bytes_each_time(results, tmp_path):
    for name in "cd":
        outcome = compare(results["run 0"], results["balanced"], "--out", tmp_path / name, "--fdr", 0.01, "--json")
    assert results_in(tmp_path / "c") == results_in(tmp_path / "d")
    made = document(tmp_path / "c")
    assert json.loads(outcome.stdout) == made
    jsonschema.Draft202012Validator(schema_of("comparison")).validate(made)
    assert made["cause"] == {"cause": "unbalance", "orders": [1.0], "besides": None}
    (record,) = [one for one in made["unbalance"] if one["explains"]]
    assert record["factor_ci95"][0] < 0.2 < record["factor_ci95"][1]
    before = 2.0 / abs(1 - 0.2 * np.exp(0.5j))
    assert "balance weight" in made["headline"][0]
    trial = made["trial_mass"]
    for key, size in (("residual_rotating_gmm", before), ("residual_after_gmm", 0.2 * before)):
        low, high = (end / 40.0 for end in trial[f"{key}_ci95"])
        assert low < size < high and high - low < 0.1


def test_of_several_runs_the_growing_line_is_named(results, tmp_path):
    outcome = compare(*(results[f"run {k}"] for k in range(3)), "--out", tmp_path / "c")
    made = document(tmp_path / "c")
    grown = [one for one in made["trend"] if one["changed"]]
    assert [one["order"] for one in grown] == [5.5]
    low, high = grown[0]["growth_per_run_ci95"]
    assert low < 0.5 < high and high - low < 0.12
    assert "from run to run" in outcome.stdout
    assert (tmp_path / "c" / "trend.png").stat().st_size > 10_000
    jsonschema.Draft202012Validator(schema_of("comparison")).validate(made)


def test_the_out_of_a_run_of_one_test_stands_for_that_test(results, tmp_path):
    shutil.copytree(results["run 0"], tmp_path / "again" / "run-0")
    outcome = compare(results["run 0"].parent, tmp_path / "again", "--out", tmp_path / "c")
    assert outcome.exit_code == 0 and "No order changed" in outcome.stdout
    (same,) = [one for one in document(tmp_path / "c")["confounds"] if one["what"] == "shared recordings"]
    assert "cannot differ" in same["words"]


def test_tests_of_two_builds_are_paired_and_what_changed_is_said_once(results, tmp_path):
    for build, runs in (("a", ("run 0", "balanced")), ("b", ("run 1", "balanced", "run 2"))):
        for run in runs:
            name = "second" if run == "balanced" else "extra" if run == "run 2" else "first"
            files = {path.name: path.read_bytes() for path in results[run].iterdir() if path.name != DONE}
            stated = json.loads(files["run.json"]) | {"test": name}
            publish(tmp_path / build / name, files | {"run.json": json.dumps(stated).encode()}, key="k")
    outcome = compare(tmp_path / "a", tmp_path / "b", "--out", tmp_path / "c")
    assert outcome.exit_code == 0, outcome.output
    made = json.loads((tmp_path / "c" / "builds.json").read_bytes())
    jsonschema.Draft202012Validator(schema_of("builds")).validate(made)
    assert outcome.stdout.splitlines() == made["headline"] and made["alone"] == ["extra (b)"]
    assert [test["cause"]["orders"] for test in made["tests"]] == [[5.5], []]
    first, *_, last = made["headline"]
    assert "5.5" in first and first.endswith("(seen in first).") and "extra" in last
    page = (tmp_path / "c" / "index.html").read_text()
    assert page.index("5.5") < page.index("first-comparison.html")
    assert (tmp_path / "c" / "second-comparison.html").is_file()


def test_partners_are_found_by_name_or_else_by_speeds_and_number_of_recordings():
    base = [
        KindOfTest("sweep", 17, (400.0, 2000.0)),
        KindOfTest("up", 1, (400.0, 2000.0)),
        KindOfTest("one", 1, (1200.0, 1200.0)),
    ]
    new = [
        KindOfTest("b1", 1, (1200.0, 1200.3)),
        KindOfTest("b2", 1, (410.0, 1990.0)),
        KindOfTest("b3", 16, (400.0, 1900.0)),
    ]
    assert partners(base, new) == [(0, 2), (1, 1), (2, 0)]
    assert partners(base, [KindOfTest("up", 1, (9.0, 9.0)), KindOfTest("x", 1, (50.0, 60.0))]) == [(1, 0)]


def test_a_test_beside_itself_is_refused(results, tmp_path):
    for tests in (("run 0", "run 0"), ("run 0", "run 1", "run 1")):
        outcome = compare(*(results[name] for name in tests), "--out", tmp_path / "c")
        assert outcome.exit_code == 2 and "named twice" in outcome.stderr
    assert not (tmp_path / "c").exists()


def test_structures_are_compared_by_their_modes_and_what_shares_nothing_is_told(results, tmp_path):
    for name, hz in (("a", 90.0), ("b", 88.0), ("c", 140.0)):
        ends = {"frequency_hz_ci95": [hz - 0.1, hz + 0.1], "damping_ratio_ci95": [0.009, 0.011]}
        mode = {"frequency_hz": hz, "damping_ratio": 0.01, "explained_by": "mode", **ends}
        test = made_test({}, name=name, speeds=(900.0,), modes=[mode])
        written(replace(test, maps={"shaft": test.maps["shaft"]}), tmp_path)
    outcome = compare(tmp_path / "a", tmp_path / "b", "--out", tmp_path / "ab")
    assert outcome.exit_code == 0 and outcome.stdout.startswith("The 90 Hz natural frequency moved to 88")
    jsonschema.Draft202012Validator(schema_of("comparison")).validate(document(tmp_path / "ab"))
    outcome = compare(tmp_path / "a", tmp_path / "c", "--out", tmp_path / "ac", "-q")
    assert outcome.exit_code == 4 and "no natural frequency that both show" in outcome.stderr
    outcome = compare(tmp_path / "a", results["run 0"], "--out", tmp_path / "d")
    assert outcome.exit_code == 3 and "modes; run 0: orders" in outcome.stderr


def test_results_of_another_version_or_without_maps_are_named(results, tmp_path):
    stated = json.loads((results["run 1"] / "run.json").read_bytes())
    files = {name: (results["run 1"] / name).read_bytes() for name in ("results.nc", "findings.json", "run.json")}
    publish(tmp_path / "old", files | {"run.json": json.dumps(stated | {"schema_version": 0}).encode()}, key="k")
    shaft = read_results(results["run 1"] / "results.nc")["shaft"]
    publish(tmp_path / "bare", files | {"results.nc": results_bytes({"shaft": shaft}, attrs={})}, key="k")
    for folder, said in (("old", "schema_version 0"), ("bare", "whose [report] results name order_map")):
        outcome = compare(results["run 0"], tmp_path / folder, "--out", tmp_path / "c")
        assert outcome.exit_code == 3 and said in outcome.stderr and folder in outcome.stderr
    assert not (tmp_path / "c").exists()


def test_faults_of_the_request_are_named_and_nothing_is_written(results, tmp_path):
    base, other, out = results["run 0"], results["run 1"], tmp_path / "c"
    (tmp_path / "empty").mkdir()
    for name in ("a", "b"):
        publish(tmp_path / "two" / name, {"results.nc": b""}, key="k")
    (tmp_path / "file").write_text("mine")
    publish(tmp_path / "t", {"results.nc": b"no", "findings.json": b"{}", "run.json": b'{"test": "t"}'}, key="k")
    for test, place, options, status, said in (
        (tmp_path / "none", out, (), 2, "no such folder"),
        (tmp_path / "empty", out, (), 2, "no finished results"),
        (tmp_path / "two", out, (), 2, "a, b"),
        (other, base, (), 2, ""),  # would replace the results
        (other, base / "inside", (), 2, ""),
        (other, tmp_path / "file", (), 2, "is a file"),
        (other, out, ("--fdr", "0"), 2, ""),
        (tmp_path / "t", out, (), 3, str(tmp_path / "t")),  # damaged
    ):
        outcome = compare(base, test, "--out", place, *options)
        assert outcome.exit_code == status and said in outcome.stderr
    assert (tmp_path / "file").read_text() == "mine"
    assert not out.exists() and not (base / "inside").exists()
