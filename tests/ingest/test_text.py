"""Text tables of every common shape are read, and every cell that is no number is named."""

import sys

import numpy as np
import pytest

from crankorder.errors import EnvironmentFailure, InputError
from crankorder.ingest import text as text_tables
from crankorder.ingest.formats import read_file


@pytest.fixture
def read(tmp_path, limits):
    def read_lines(text, *sources, encoding="utf-8"):
        path = tmp_path / "a.csv"
        path.write_bytes(text.encode(encoding))
        return read_file(path, sources=sources, settings=limits)

    return read_lines


VALUES = [[0.0, 1.5, -2.0], [0.1, 2.5e-3, 3.0], [0.2, -1e6, 4.25]]


@pytest.mark.cases(2)
@pytest.mark.parametrize("separator", [",", ";", "\t", " ", "   "])
@pytest.mark.parametrize("head", ["", "a b c\n", "# made by hand\n\na b c\n", "% one\n% two\n"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_every_separator_and_head_gives_the_same_numbers(read, separator, head, end):
    rows = [separator.join(f"{value!r}" for value in row) for row in VALUES]
    names = ["a", "b", "c"] if "a b c" in head else [0, 1, 2]
    text = head.replace("a b c", separator.join("abc")) + "\n".join(rows) + "\n"
    raw = read(text.replace("\n", end), *names)
    np.testing.assert_array_equal(np.array([raw.columns[name] for name in names]).T, VALUES)
    assert not raw.flags


def test_a_decimal_comma_is_understood_and_flagged(read):
    for separator in [";", "\t", " "]:
        rows = [separator.join(f"{value!r}".replace(".", ",") for value in row) for row in VALUES]
        raw = read("\n".join(rows) + "\n", 0, 1, 2)
        np.testing.assert_array_equal(np.array(list(raw.columns.values())).T, VALUES)
        assert [flag["flag"] for flag in raw.flags] == ["decimal_comma"]


def test_units_come_from_a_row_of_units_or_from_brackets(read):
    assert dict(read("t,p\ns,bar\n0,1\n1,2\n", "t", "p").units) == {"t": "s", "p": "bar"}
    assert dict(read("Time [s];p (kPa);x\n0;1;2\n1;2;3\n", "Time [s]", "p (kPa)", "x").units) == {
        "Time [s]": "s",
        "p (kPa)": "kPa",
    }


def test_a_rate_in_the_comments_is_found(read):
    rows = [
        ('# {"puls_freq": 10, "sample_freq": 952} commit 95729455', 952.0), ("# fs = 51.2 kHz", 51_200.0),
        ("% Sample rate: 100", None), ("# sample_rate: 4.0e3", 4000.0), ("# offset = 7", None),
    ]  # fmt: skip
    for comment, rate in rows:
        assert read(f"{comment}\na,b\n1,2\n3,4\n", "a").rates_hz.get("a") == rate


@pytest.mark.parametrize("piece_lines", [1, 1 << 16])
def test_what_is_no_table_of_numbers_is_named_with_line_and_cell(read, monkeypatch, piece_lines):
    monkeypatch.setattr(text_tables, "PIECE_LINES", piece_lines)
    rows = [
        ("a,b\n1,2\n3,OVER\n5,6\n", r"line 3, column 1 \(b\): not a number; found 'OVER'"),
        ("a,b\n1,2\n,4\n5,6\n", r"line 3, column 0 \(a\): an empty cell"),
        ("a,b\n1,2\n3,1.#QNAN\n", "not a number; found '1.#QNAN'"),
        ("a,b\n1,2\n3,4,5\n6,7\n", "line 3: 3 cells where the lines above have 2"),
        ("a,b,c\n1,2,3\n4,5\n6,7,8\n", "line 3: 2 cells where the lines above have 3"),
        ("a;b\n1,5;2,5\n3.5;x\n", "not a number; found 'x'"),
        ("# only\n# comments\n", "no line of numbers in the first 64 kB"),
        ("once upon a time\nthere was a shaft\n", "no line of numbers.*found 'once upon a time'"),
        ("a,b\n1,2\n3,0x10\n", "not a number; found '0x10'"),
    ]
    for text, words in rows:
        with pytest.raises(InputError, match=words):
            read(text, 0, 1)


def test_names_that_repeat_nan_a_last_separator_and_other_encodings_do_no_harm(read):
    rows = [
        ("t,a,a,a\n1,2,3,4\n5,6,7,8\n", {"a": [2.0, 6.0], "a (2)": [3.0, 7.0], "a (3)": [4.0, 8.0]}, "utf-8"),
        ("a,b\n1,2\nnan,4\nNaN,6\n", {"a": [1.0, np.nan, np.nan]}, "utf-8"),
        ("a;b;\n1;2;\n3;4;\n", {"b": [2.0, 4.0]}, "utf-8"),
        ("\ufeffa,b\n1,2\n3,4\n", {"a": [1.0, 3.0]}, "utf-8"),
        ("Größe,b\n1,2\n3,4\n", {"Größe": [1.0, 3.0]}, "latin-1"),
    ]
    for text, columns, encoding in rows:
        for name, values in read(text, *columns, encoding=encoding).columns.items():
            np.testing.assert_array_equal(values, columns[name])


def test_a_cut_inside_a_line_is_refused_and_one_inside_the_last_number_is_flagged(read):
    text = "".join(f"{k * 1e-5:.6E}\t{np.sin(k):.6E}\t{np.cos(k):.6E}\n" for k in range(400))
    with pytest.raises(InputError, match=r"cells where the lines above have 3; the file seems to be truncated"):
        read(text[: text.index("\n", len(text) // 2) + 20], 0)
    for less, severity in ((6, "suspect"), (1, "info")):
        (flag,) = read(text[:-less], 0).flags
        assert (flag["flag"], flag["severity"]) == ("last_line_open", severity)


def test_names_from_a_file_are_data(read):
    with pytest.raises(InputError, match=r"has \\x1b\[31mred, b"):
        read("\x1b[31mred,b\n1,2\n3,4\n", "a")


# XLSX workbooks are read from their first sheet, and odd cells are named.


openpyxl = pytest.importorskip("openpyxl", reason="the extra crankorder[xlsx] is not installed")


@pytest.fixture
def book(tmp_path):
    def build(*rows):
        workbook = openpyxl.Workbook()
        for row in rows:
            workbook.active.append(row)
        workbook.save(tmp_path / "a.xlsx")
        return tmp_path / "a.xlsx"

    return build


def test_a_cell_that_is_no_number_is_named_and_empty_rows_below_are_no_samples(book, limits):
    path = book(("a", "b"), (1, 2), (3, 4), (None, None), (None, None))
    assert read_file(path, sources=["a"], settings=limits).columns["a"].size == 2
    for cell in ["OVER", True, None]:
        path = book(("a", "b"), (1, 2), (3, cell), (5, 6))
        with pytest.raises(InputError, match=r"row 3, column 1 \(b\): (not a number|an empty cell)"):
            read_file(path, sources=["b"], settings=limits)


def test_a_missing_package_names_the_extra(book, limits, monkeypatch):
    path = book(("a",), (1,))
    monkeypatch.setitem(sys.modules, "python_calamine", None)
    with pytest.raises(
        EnvironmentFailure, match=r"needs the package python_calamine\. Install it with: pip install crankorder\[xlsx\]"
    ):
        read_file(path, sources=["a"], settings=limits)
