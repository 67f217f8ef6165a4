"""Where results go: each test at its own place, nothing of anybody overwritten, several processes beside each other."""

import json
import os
import shutil
import signal

import pytest

from crankorder.batch import execute
from crankorder.batch.run_log import LOGS
from made.command import crankorder


def run(*arguments):
    return crankorder("run", *arguments, "--recipe", "maps", "-q", "--no-pictures")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "test"
    assert crankorder("synth", "hard-two-revolutions", "--out", folder, "--quick", "-q").exit_code == 0
    return folder


@pytest.fixture
def two(made, tmp_path):
    """Two folders whose manifests give one name to different recordings."""
    folders = [tmp_path / "data" / name for name in ("a", "b")]
    for number, folder in enumerate(folders):
        shutil.copytree(made, folder)
        text = (folder / "run.toml").read_text()
        (folder / "run.toml").write_text(text.replace('name = "two revolutions"', 'name = "same"') + f"# {number}\n")
    return folders


def owners(out):
    return {path.parent.name: json.loads(path.read_bytes())["input"]["folder"] for path in out.glob("*/done.json")}


def everything(out):
    """All files of ``out`` but the logs, by their paths in it."""
    found = [path for path in out.rglob("*") if path.is_file() and LOGS not in path.parts]
    return {path.relative_to(out): path.read_bytes() for path in found}


def test_the_place_of_a_test_depends_on_no_order_of_folders_and_a_second_run_changes_no_byte(two, tmp_path):
    wanted = {"same": "../data/a", "same-2": "../data/b"}
    for name, order in (("one", two), ("other", two[::-1])):
        assert run(*order, "--out", tmp_path / name).exit_code == 0
        assert owners(tmp_path / name) == wanted
    before = everything(tmp_path / "one")
    assert run(two[1], "--out", tmp_path / "one").exit_code == 0  # alone, it finds its own place again
    assert everything(tmp_path / "one") == before
    assert owners(tmp_path / "one") == wanted
    assert [test["folder"] for test in json.loads((tmp_path / "one/batch.json").read_bytes())["tests"]] == [*wanted]


def test_another_test_of_the_same_name_is_refused_until_it_gets_a_name_of_its_own(two, tmp_path):
    out = tmp_path / "out"
    assert run(two[0], "--out", out).exit_code == 0
    before = (out / "same" / "results.nc").read_bytes()
    refused = run(two[1], "--out", out)
    assert refused.exit_code == 2 and "--name" in refused.output and "../data/a" in refused.output
    assert (out / "same" / "results.nc").read_bytes() == before
    assert run(two[1], "--out", out, "--name", "second").exit_code == 0
    assert owners(out) == {"same": "../data/a", "second": "../data/b"}
    assert len(json.loads((out / "batch.json").read_bytes())["tests"]) == 2
    assert run(*two, "--out", out, "--name", "x").exit_code == 2


def test_results_never_land_in_an_input_folder_of_the_call_nor_over_files_of_others(two, tmp_path):
    (two[1] / "run.toml").write_text((two[1] / "run.toml").read_text().replace('name = "same"', 'name = "a"'))
    data = tmp_path / "data"
    held = {path: path.read_bytes() for path in data.rglob("*") if path.is_file()}
    for folders in ((two[1],), two):
        outcome = run(*folders, "--out", data)
        assert outcome.exit_code == 2, outcome.output
    (tmp_path / "link").symlink_to(data)
    assert run(two[1], "--out", tmp_path / "link").exit_code == 2
    assert {path: path.read_bytes() for path in data.rglob("*") if path.is_file()} == held


def test_an_index_of_others_is_not_overwritten(two, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "index.html").write_text("mine")
    refused = run(two[0], "--out", tmp_path / "out")
    assert refused.exit_code == 2 and "index.html" in refused.output
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["index.html"]


def test_a_recording_replaced_while_it_is_analysed_is_refused_and_nothing_of_it_is_kept(two, tmp_path, monkeypatch):
    path = next(two[0].glob("*.h5"))
    right, times = path.read_bytes(), path.stat()
    real = execute.analyse_recording

    def replaced(source, *arguments):
        path.write_bytes(b"another" + right[7:])
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        path.write_bytes(right)
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        return real(source, *arguments)

    with monkeypatch.context() as patched:
        patched.setattr(execute, "analyse_recording", replaced)
        outcome = run(two[0], "--out", tmp_path / "out")
    assert outcome.exit_code in (3, 4) and path.name in outcome.output and "changed while it was read" in outcome.output
    assert not (tmp_path / "out" / "same").exists()
    assert run(two[0], "--out", tmp_path / "out").exit_code == 0


def test_a_reporting_process_that_is_killed_is_replaced(two, tmp_path, monkeypatch):
    from crankorder.batch import publish

    real, marks = publish.files_of_test, tmp_path / "killed once"

    def killed_once(*arguments, **named):
        if not marks.exists():
            marks.write_text("")
            os.kill(os.getpid(), signal.SIGKILL)
        return real(*arguments, **named)

    monkeypatch.setattr(publish, "files_of_test", killed_once)
    assert run(*two, "--out", tmp_path / "out").exit_code == 0
    assert owners(tmp_path / "out") == {"same": "../data/a", "same-2": "../data/b"}


@pytest.mark.slow
def test_a_test_that_kills_the_reporting_process_every_time_takes_no_other_along(two, tmp_path, monkeypatch):
    from crankorder.batch import publish

    real = publish.files_of_test

    def killed(groups, findings, provenance, *arguments, **named):
        if provenance["manifest"]["test"]["name"] == "same" and provenance["inputs"][0]["name"].endswith("x.h5"):
            os.kill(os.getpid(), signal.SIGKILL)
        return real(groups, findings, provenance, *arguments, **named)

    path = next(two[0].glob("*.h5"))
    path.rename(path.with_name("x.h5"))
    manifest = two[0] / "run.toml"
    manifest.write_text(manifest.read_text().replace(path.name, "x.h5").replace("rpm_*.h5", "*.h5"))
    monkeypatch.setattr(publish, "files_of_test", killed)
    outcome = run(*two, "--out", tmp_path / "out")
    assert outcome.exit_code == 5 and "SIGKILL" in outcome.output
    assert owners(tmp_path / "out") == {"same-2": "../data/b"}
    tests = json.loads((tmp_path / "out" / "batch.json").read_bytes())["tests"]
    assert [(test["folder"], test["status"]) for test in tests] == [("same", "failed"), ("same-2", "done")]
