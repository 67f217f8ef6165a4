"""Bytes on the disk: JSON, keys, and files as they were hashed."""

from __future__ import annotations

import hashlib
import json
import os

from crankorder.batch.store import CHANGED, HashedFile, code_sha256, json_bytes, text_sha256


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
    times = path.stat()
    hashed = HashedFile.of(path)
    assert hashed.sha256 == text_sha256_of(b"one") and hashed.is_still_at(path)
    path.write_bytes(b"two")
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert not hashed.is_still_at(path)
    path.write_bytes(b"one")
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert not hashed.is_still_at(path)  # it was another one in between
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


def text_sha256_of(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
