"""The log of a run: what was computed, reused and left out, and why; it is no result and harms none."""

import errno
import json
import logging

from crankorder.batch.run_log import KEPT_LOGS, LOGGER, LOGS, logged, tell


def test_a_line_for_each_event_as_text_or_as_json(tmp_path):
    with logged(tmp_path, as_json=True) as path:
        tell("left out", level=logging.WARNING, recording="a\x1b\nb\u202e", why=ValueError("no"))
        tell("test ended", seconds={"hash": 0.5})
    assert path is not None and path.parent == tmp_path / LOGS
    first, second = (json.loads(line) for line in path.read_bytes().splitlines())
    told = {"level": "WARNING", "event": "left out", "recording": "a\x1b\nb\u202e", "why": "no"}
    assert first.items() >= told.items()
    assert second["seconds"] == {"hash": 0.5} and second["time"].endswith("Z")
    assert b"\xe2" not in path.read_bytes() and b"\x1b" not in path.read_bytes()
    with logged(tmp_path, as_json=False) as path:
        tell("left out", recording="a\x1b\nb\u202e")
    (line,) = path.read_text().splitlines()
    assert "INFO left out: recording a\\x1b\\x0ab" in line and "\u202e" not in line


def test_outside_of_a_run_nothing_is_said(tmp_path, capsys):
    tell("left out", level=logging.WARNING, why="a")
    with logged(tmp_path, as_json=False) as path:
        pass
    tell("left out", level=logging.WARNING, why="a")
    assert path.read_text() == "" and capsys.readouterr() == ("", "")
    assert [type(one) for one in LOGGER.handlers] == [logging.NullHandler]


def test_a_full_disk_ends_the_log_alone(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("")
    with logged(tmp_path / "file", as_json=False) as path:
        tell("left out")
    assert path is None
    with logged(tmp_path, as_json=False):

        def full(*unused):
            raise OSError(errno.ENOSPC, "No space left on device")

        (handler,) = [one for one in LOGGER.handlers if isinstance(one, logging.FileHandler)]
        monkeypatch.setattr(handler, "flush", full)
        tell("left out")
        monkeypatch.undo()
    assert capsys.readouterr().err == ""


def test_only_the_newest_logs_stay(tmp_path):
    (tmp_path / LOGS).mkdir()
    for number in range(KEPT_LOGS + 5):
        (tmp_path / LOGS / f"2000{number:04d}.log").write_text("")
    with logged(tmp_path, as_json=False) as path:
        pass
    left = sorted(one.name for one in (tmp_path / LOGS).iterdir())
    assert len(left) == KEPT_LOGS and left[-1] == path.name and left[0] == "20000006.log"
