"""Where results go: each test at its own place, nothing of anybody overwritten, several processes beside each other."""

import json
import os
import shutil
import signal

import pytest

from crankorder.batch import execute, publish
from made.command import crankorder, results_in


def run(*arguments):
    return crankorder("run", *arguments, "--recipe", "maps", "-q", "--no-pictures")


@pytest.fixture
def two(recordings_of, tmp_path):
    """Two folders whose manifests give one name to different recordings."""
    folders = [tmp_path / "data" / name for name in ("a", "b")]
    for number, folder in enumerate(folders):
        shutil.copytree(recordings_of("hard-two-revolutions"), folder)
        text = (folder / "run.toml").read_text()
        (folder / "run.toml").write_text(text.replace('name = "two revolutions"', 'name = "same"') + f"# {number}\n")
    return folders


def owners(out):
    return {path.parent.name: json.loads(path.read_bytes())["input"]["folder"] for path in out.glob("*/done.json")}


def test_the_place_of_a_test_depends_on_no_order_of_folders_and_a_second_run_changes_no_byte(two, tmp_path):
    wanted = {"same": "../data/a", "same-2": "../data/b"}
    for name, order in (("one", two), ("other", two[::-1])):
        assert run(*order, "--out", tmp_path / name).exit_code == 0
        assert owners(tmp_path / name) == wanted
    before = results_in(tmp_path / "one", kept=True)
    assert run(two[1], "--out", tmp_path / "one").exit_code == 0  # alone, it finds its own place again
    assert results_in(tmp_path / "one", kept=True) == before
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
    held = results_in(data, kept=True)
    (tmp_path / "link").symlink_to(data)
    for folders, out in (((two[1],), data), (two, data), ((two[1],), tmp_path / "link")):
        assert run(*folders, "--out", out).exit_code == 2
    assert results_in(data, kept=True) == held


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
        for data in (b"another" + right[7:], right):
            path.write_bytes(data)
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        return real(source, *arguments)

    with monkeypatch.context() as patched:
        patched.setattr(execute, "analyse_recording", replaced)
        outcome = run(two[0], "--out", tmp_path / "out")
    assert outcome.exit_code in (3, 4) and path.name in outcome.output and "changed while it was read" in outcome.output
    assert not (tmp_path / "out" / "same").exists()
    assert run(two[0], "--out", tmp_path / "out").exit_code == 0


@pytest.mark.parametrize(("kills", "status", "left"), [(1, 0, ("same", "same-2")), (2, 5, ("same-2",))])
def test_a_reporting_process_that_is_killed_is_replaced_and_a_test_that_kills_it_twice_takes_no_other_along(
    two, tmp_path, monkeypatch, kills, status, left
):
    real, marks = publish.files_of_test, tmp_path / "kills"
    marks.write_text("")

    def killed(*arguments, **named):
        if len(marks.read_text()) < kills:
            marks.write_text(marks.read_text() + "x")
            os.kill(os.getpid(), signal.SIGKILL)
        return real(*arguments, **named)

    monkeypatch.setattr(publish, "files_of_test", killed)
    outcome = run(*two, "--out", tmp_path / "out")
    assert outcome.exit_code == status and (status == 0 or "SIGKILL" in outcome.output)
    assert set(owners(tmp_path / "out")) == set(left)
    tests = json.loads((tmp_path / "out" / "batch.json").read_bytes())["tests"]
    assert [test["folder"] for test in tests if test["status"] == "done"] == [*left]
    assert [test["folder"] for test in tests] == ["same", "same-2"]
