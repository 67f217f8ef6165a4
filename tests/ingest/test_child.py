"""Parsers of others run in a process of their own: bombs and crashes end in an error within the limits."""

import os
import resource
import signal
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest

from crankorder.errors import CrankorderError, InputError, UnsafeInputError
from crankorder.ingest import child
from crankorder.ingest.child import in_child
from crankorder.ingest.formats import read_file
from made.command import crankorder
from made.recordings import manifest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")


@pytest.fixture
def path(tmp_path):
    (tmp_path / "a.xyz").write_bytes(b"x" * 100)
    return tmp_path / "a.xyz"


def test_the_value_and_our_own_errors_come_back(path):
    made = in_child(lambda: {"a": np.arange(1000.0)}, path, n_bytes=8000)
    np.testing.assert_array_equal(made["a"], np.arange(1000.0))

    def refuse():
        raise InputError("no such channel", file=path, place="a", found="b")

    with pytest.raises(InputError, match=r"a\.xyz: a: no such channel; found b"):
        in_child(refuse, path, n_bytes=0)


def test_a_parser_that_raises_dies_or_takes_too_much_ends_alone(path, monkeypatch):
    rows = [
        (lambda: 1 / 0, InputError, r"a\.xyz: damaged: cannot be parsed; found ZeroDivisionError"),
        (lambda: np.ones(10**9), UnsafeInputError, "too much memory"),
        (lambda: os.kill(os.getpid(), signal.SIGKILL), CrankorderError, "its parser died"),
        (lambda: time.sleep(60), UnsafeInputError, "too long"),
    ]
    for task, kind, words in rows:
        if words == "too long":
            monkeypatch.setattr(child, "LEAST_SECONDS", 0.3)
        with pytest.raises(kind, match=words):
            in_child(task, path, n_bytes=0)


SHEET = (
    '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>{}</sheetData></worksheet>'
)


def workbook(path, rows):
    import openpyxl

    book = openpyxl.Workbook()
    book.active.append(["a", "b"])
    book.save(path)
    with zipfile.ZipFile(path) as old:
        parts = {name: old.read(name) for name in old.namelist()}
    parts["xl/worksheets/sheet1.xml"] = SHEET.format(rows).encode()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name, data in parts.items():
            new.writestr(name, data)


@pytest.mark.parametrize("is_told", [True, False])
def test_i11_a_book_of_text_is_refused_in_little_memory_whether_or_not_it_tells_its_size(tmp_path, limits, is_told):
    path, piece = tmp_path / "bomb.xlsx", b"<si><t>" + b"x" * 999_984 + b"</t></si>"
    workbook(path, "")
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as book, book.open("xl/sharedStrings.xml", "w") as part:
        for _ in range(600):
            part.write(piece)
    if not is_told:
        content, size = path.read_bytes(), (600_000_000).to_bytes(4, "little")
        assert content.count(size) == 2
        path.write_bytes(content.replace(size, (1_000_000).to_bytes(4, "little")))
    # by a small process between: at its start the largest size of a process is that of the one that it was split off
    measure = "import resource as r, subprocess, sys; subprocess.run(sys.argv[1:]); print(r.getrusage(-1).ru_maxrss)"
    command = [sys.executable, "-c", measure, sys.executable, "-m", "crankorder", "init", tmp_path]
    done = subprocess.run(command, capture_output=True)
    assert (b"too much text" if is_told else b"Bad CRC-32") in done.stderr
    assert int(done.stdout.split()[-1]) < 500_000  # KiB


def test_i11_a_row_beyond_the_last_of_a_sheet_is_refused_by_the_reader_and_by_every_command(tmp_path, limits):
    (tmp_path / "in").mkdir()
    cell = '<row r="{0}"><c r="A{0}"><v>1</v></c><c r="B{0}"><v>2</v></c></row>'
    workbook(tmp_path / "in" / "bomb.xlsx", cell.format(1) + cell.format(2_000_000_000))
    assert (tmp_path / "in" / "bomb.xlsx").stat().st_size < 10_000
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    with pytest.raises(UnsafeInputError, match=r"bomb\.xlsx"):
        read_file(tmp_path / "in" / "bomb.xlsx", sources=[0], settings=limits)
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss - before < 1_200_000  # KiB, with this process's own
    text = manifest("*.xlsx", cycle="none", channels={"a": {"source": 0, "unit": "1"}}, sampling={"rate_hz": 1000})
    for command, *more in (("init",), ("check",), ("run", "--out", tmp_path / "out")):
        made = crankorder(command, tmp_path / "in", *more)
        (tmp_path / "in" / "run.toml").write_text(text, encoding="utf-8")
        assert made.exit_code in (3, 4) and "bomb.xlsx: its parser died" in made.output
