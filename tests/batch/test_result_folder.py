"""Result folders: whole or not at all, of one input, never over files of others."""

import contextlib
import errno
import hashlib
import json
import os
from pathlib import Path

import pytest

from crankorder.batch import result_folder
from crankorder.batch.plan import publish_index
from crankorder.batch.result_folder import DONE, Owner, finished_with, publish, refuse_foreign, refuse_others, settle
from crankorder.batch.store import CHANGED, HashedFile, code_sha256, json_bytes, text_sha256
from crankorder.errors import EnvironmentFailure, RequestError

BATCH, INDEX = result_folder.BATCH, result_folder.INDEX
OLD = {"a.json": b"old {}\n", "b.png": b"old \x89PNG" * 50, "gone.png": b"old"}
NEW = {"a.json": b"{}\n", "b.png": b"\x89PNG" * 50}


def held(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != DONE}


class Killed(BaseException):
    """The process ends here: whatever it would still call does nothing."""


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "disk")
CALLS = ("fsync", "rename", "replace", "open", "mkdir", "unlink")
MOST_CALLS = 90


@contextlib.contextmanager
def failing(monkeypatch, calls, number, fault=FULL):
    """While this lasts, the ``number``-th of these ``calls`` of the system fails; gives how many more would go well."""
    left = [number]

    def counted(real):
        def call(*arguments, **named):
            left[0] -= 1
            if left[0] == -1 or (left[0] < 0 and isinstance(fault, Killed)):
                raise fault
            return real(*arguments, **named)

        return call

    with monkeypatch.context() as patched:
        for name in calls:
            patched.setattr(os, name, counted(getattr(os, name)))
        yield left


def test_published_results_are_finished_with_their_key_and_no_other(tmp_path):
    publish(tmp_path / "out", NEW, key="one")
    assert finished_with(tmp_path / "out", "one")
    assert not finished_with(tmp_path / "out", "two")
    assert {path.name for path in tmp_path.rglob("*")} == {"out", *NEW, DONE}


def test_results_that_were_touched_are_not_finished(tmp_path):
    for name in (*NEW, DONE):
        for number, harm in enumerate((Path.unlink, lambda path: path.write_bytes(b"[]"))):
            out = tmp_path / f"{name} {number}"
            publish(out, NEW, key="one")
            assert finished_with(out, "one")
            harm(out / name)
            assert not finished_with(out, "one"), name


@pytest.mark.cases(6)
@pytest.mark.parametrize("others", [{}, {"notes.txt": b"mine"}], ids=["renamed", "among files of others"])
@pytest.mark.parametrize(
    ("calls", "fault"), [*(((call,), FULL) for call in CALLS), ((*CALLS, "rmdir"), Killed())], ids=[*CALLS, "killed"]
)
def test_whichever_call_fails_or_is_the_last_the_old_results_are_whole_or_the_new_ones(
    tmp_path, monkeypatch, calls, fault, others
):
    """Each time one more call goes well, until all do."""
    for number in range(MOST_CALLS):
        out, failed = tmp_path / str(number) / "out", False
        out.mkdir(parents=True)
        for name, data in others.items():
            (out / name).write_bytes(data)
        publish(out, OLD, key="old")
        with failing(monkeypatch, calls, number, fault) as left:
            try:
                publish(out, NEW, key="new")
            except EnvironmentFailure as error:
                failed = error.exit_status == 5 and os.strerror(errno.ENOSPC) in str(error)
            except Killed:
                failed = True
        before = held(out) if fault is FULL and (out / DONE).exists() else None
        settle(out)  # as every command does first
        assert before in (None, held(out))
        assert finished_with(out, "new") or (failed and finished_with(out, "old"))
        assert held(out) == {**others, **(OLD if finished_with(out, "old") else NEW)}
        assert [path.name for path in out.parent.iterdir()] == ["out"]
        if left[0] >= 0:
            assert not failed
            return
    raise AssertionError("more calls than were tried")


@pytest.mark.cases(2)
@pytest.mark.parametrize("call", CALLS)
def test_whichever_call_fails_each_file_of_the_index_is_the_old_one_or_the_new_one(tmp_path, monkeypatch, call):
    def indexed():
        publish_index(out, [], page_of=lambda tests: f"{len(tests)} test")

    def both():
        return {path.name: path.read_bytes() for path in (out / BATCH, out / INDEX)}

    for number in range(MOST_CALLS):
        out = tmp_path / str(number)
        publish(out / "a", OLD, key="a", record={"name": "a", "status": "done", "folder": "a"})
        indexed()
        old = both()
        publish(out / "b", NEW, key="b", record={"name": "b", "status": "done", "folder": "b"})
        failed = False
        with failing(monkeypatch, (call,), number) as left:
            try:
                indexed()
            except EnvironmentFailure as error:
                failed = True
                assert error.exit_status == 5
        now = both()
        indexed()
        new = both()
        assert [one["name"] for one in json.loads(new[BATCH])["tests"]] == ["a", "b"]
        assert all(now[name] in (old[name], new[name]) for name in now)
        assert failed or now == new
        assert {path.name for path in out.iterdir()} <= {"a", "b", BATCH, INDEX, f".{BATCH}.lock"}
        if left[0] >= 0:
            return
    raise AssertionError("more calls than were tried")


def test_the_folder_that_somebody_stands_in_stays_the_same_folder(tmp_path, monkeypatch):
    publish(tmp_path, OLD, key="old")
    number = tmp_path.stat().st_ino
    monkeypatch.chdir(tmp_path)
    publish(tmp_path, NEW, key="new")
    assert tmp_path.stat().st_ino == number and held(tmp_path) == NEW


def test_a_file_of_others_with_the_name_of_a_result_is_not_overwritten(tmp_path):
    (tmp_path / "a.json").write_text("mine")
    with pytest.raises(RequestError, match=r"a\.json"):
        publish(tmp_path, NEW, key="new")
    assert held(tmp_path) == {"a.json": b"mine"}


def test_a_folder_with_files_of_others_is_refused_and_leftovers_are_not(tmp_path):
    publish(tmp_path / "out", {**NEW, "run.json": b"{}"}, key="one")
    (tmp_path / "out" / ".DS_Store").write_bytes(b"")
    refuse_foreign(tmp_path / "out")
    refuse_foreign(tmp_path / "missing")
    (tmp_path / "out" / "results of mine.xlsx").write_bytes(b"")
    with pytest.raises(RequestError, match=r"results of mine\.xlsx"):
        refuse_foreign(tmp_path / "out")


def test_a_marker_that_is_no_marker_makes_nothing_ours(tmp_path):
    outside = '{"key": "a", "outputs_sha256": {"../x": ""}}'
    for number, text in enumerate(("", "[]", "{}", '{"key": 1}', outside, "[" * 9999)):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / DONE).write_text(text)
        with pytest.raises(RequestError, match="done"):
            refuse_foreign(folder)


OWNERS = (
    (Owner("../a", "1"), Owner("../a", "1"), True),
    (Owner("../a", "1"), Owner("../a", "2"), True),  # its manifest was edited
    (Owner("../a", "1"), Owner("../b", "1"), False),  # a copy of the manifest beside other data
    (Owner("../gone", "1"), Owner("../b", "1"), True),  # the data moved
    (Owner("../gone", "1"), Owner("../b", "2"), False),
    (None, Owner("../b", "2"), True),
)


def test_results_belong_to_one_input(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    for number, (recorded, asking, mine) in enumerate(OWNERS):
        publish(tmp_path / "out" / str(number), NEW, key="one", owner=recorded)
        with contextlib.nullcontext() if mine else pytest.raises(RequestError, match="another test of this name"):
            refuse_others(tmp_path / "out" / str(number), asking)


# Bytes on the disk: JSON, keys, and files as they were hashed.


def test_json_has_no_nan_ten_digits_and_ends_with_a_newline():
    text = json_bytes({"a": float("nan"), "b": 1999.9999999994077, "c": [float("inf"), 1], "d": "Ba$$in\x00"})
    assert json.loads(text) == {"a": None, "b": 2000.0, "c": [None, 1], "d": "Ba$$in\x00"}
    assert text.endswith(b"\n")


def test_the_parts_of_a_key_cannot_be_shifted_into_each_other():
    assert text_sha256("ab", "c") != text_sha256("a", "bc")


def test_other_code_and_other_settings_are_another_program(tmp_path, monkeypatch):
    monkeypatch.setattr("crankorder.batch.store.files", lambda package: tmp_path)
    (tmp_path / "orders").mkdir()
    hashes = set()
    for name, text in (("orders/map.py", "a = 1"), ("orders/map.py", "a = 2"), ("3-orders.toml", "tol = 1")):
        (tmp_path / name).write_text(text, encoding="utf-8")
        hashes.add(code_sha256.__wrapped__())
    assert len(hashes) == 3


def test_characters_that_nobody_sees_are_escaped_in_json():
    made = json_bytes({"name": "a\u202eb\x1b[31m\u200b\U000e0041é漢"})
    assert json.loads(made) == {"name": "a\u202eb\x1b[31m\u200b\U000e0041é漢"}
    assert all(char.isprintable() or char == "\n" for char in made.decode()) and "é漢" in made.decode()


def test_a_file_that_changes_after_it_was_hashed_is_told_whatever_its_times_say(tmp_path):
    path = tmp_path / "a.h5"
    path.write_bytes(b"one")
    times, hashed = path.stat(), HashedFile.of(path)
    assert hashed.sha256 == hashlib.sha256(b"one").hexdigest() and hashed.is_still_at(path)
    for data in (b"two", b"one"):  # the second time it was another one in between
        path.write_bytes(data)
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        assert not hashed.is_still_at(path)
    path.unlink()
    assert not hashed.is_still_at(path)


def test_a_file_that_grows_while_it_is_hashed_says_so(tmp_path, monkeypatch):
    path = tmp_path / "a.h5"
    path.write_bytes(b"one")

    def grown(stream):
        with path.open("ab") as more:
            more.write(b"more")
        return "0" * 64

    monkeypatch.setattr("crankorder.batch.store._stream_sha256", grown)
    assert HashedFile.of(path).fault == CHANGED
    assert "No such file" in HashedFile.of(tmp_path / "missing").fault
