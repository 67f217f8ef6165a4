"""Publication: whole or not at all."""

from __future__ import annotations

import errno
import json
import os

import pytest

from crankorder.batch.result_folder import DONE, finished_with, publish
from crankorder.batch.store import json_bytes, text_sha256
from crankorder.errors import EnvironmentFailure

CONTENTS = {"a.json": b"{}\n", "b.png": b"\x89PNG" * 50}


def test_published_results_are_finished_with_their_key_and_no_other(tmp_path):
    publish(tmp_path / "out", CONTENTS, key="one")
    assert finished_with(tmp_path / "out", "one")
    assert not finished_with(tmp_path / "out", "two")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*CONTENTS, DONE}


@pytest.mark.parametrize("name", [*CONTENTS, DONE])
@pytest.mark.parametrize("harm", ["removed", "changed"])
def test_results_that_were_touched_are_not_finished(tmp_path, name, harm):
    publish(tmp_path, CONTENTS, key="one")
    if harm == "removed":
        (tmp_path / name).unlink()
    else:
        (tmp_path / name).write_bytes(b"[]")
    assert not finished_with(tmp_path, "one")


@pytest.mark.parametrize("call", ["fsync", "replace", "open"])
@pytest.mark.parametrize("number", range(6))
def test_whichever_call_fails_no_half_file_stands_under_its_name(tmp_path, monkeypatch, call, number):
    """Fail the n-th call, for all n: every file is the old one or the new one, and the marker never lies."""
    publish(tmp_path, {name: b"old " + data for name, data in CONTENTS.items()}, key="old")
    real, count = {"fsync": os.fsync, "replace": os.replace, "open": os.open}[call], [0]

    def failing(*arguments, **named):
        count[0] += 1
        if count[0] == number + 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "disk")
        return real(*arguments, **named)

    with monkeypatch.context() as patched:
        patched.setattr(os, call, failing)
        try:
            publish(tmp_path, CONTENTS, key="new")
            failed = False
        except EnvironmentFailure as error:
            failed = True
            assert error.exit_status == 5 and "No space left" in str(error)
    if failed:
        assert not list(tmp_path.glob(".*"))
    else:
        assert finished_with(tmp_path, "new")
    old = [(tmp_path / name).read_bytes() == b"old " + data for name, data in CONTENTS.items()]
    new = [(tmp_path / name).read_bytes() == data for name, data in CONTENTS.items()]
    assert all(one or other for one, other in zip(old, new, strict=True))
    assert all(old) or not finished_with(tmp_path, "old")
    assert all(new) or not finished_with(tmp_path, "new")


def test_json_has_no_nan_ten_digits_and_ends_with_a_newline():
    text = json_bytes({"a": float("nan"), "b": 1999.9999999994077, "c": [float("inf"), 1], "d": "Ba$$in\x00"})
    assert json.loads(text) == {"a": None, "b": 2000.0, "c": [None, 1], "d": "Ba$$in\x00"}
    assert text.endswith(b"\n")


def test_the_parts_of_a_key_cannot_be_shifted_into_each_other():
    assert text_sha256("ab", "c") != text_sha256("a", "bc")
