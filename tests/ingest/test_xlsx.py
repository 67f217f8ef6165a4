"""XLSX workbooks are read from their first sheet, and odd cells are named."""

import sys

import numpy as np
import pytest

from crankorder.errors import EnvironmentFailure, InputError, UnsafeInputError
from crankorder.ingest.formats import contents_of, read_file

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


def test_columns_are_read_with_units_from_their_labels(book, limits):
    path = book(("Time [s]", "TDC"), (0, 1.5), (1e-3, 2), (2e-3, -3.25))
    raw = read_file(path, sources=["Time [s]", 1], settings=limits)
    np.testing.assert_array_equal(raw.columns["Time [s]"], [0, 1e-3, 2e-3])
    np.testing.assert_array_equal(raw.columns[1], [1.5, 2, -3.25])
    assert dict(raw.units) == {"Time [s]": "s"}
    assert contents_of(path, settings=limits).names == ("Time [s]", "TDC")


def test_empty_rows_below_the_data_are_no_samples(book, limits):
    path = book(("a", "b"), (1, 2), (None, None), (3, 4))
    with pytest.raises(InputError, match=r"row 3, column 0 \(a\): an empty cell"):
        read_file(path, sources=["a"], settings=limits)
    path = book(("a", "b"), (1, 2), (3, 4), (None, None), (None, None))
    assert read_file(path, sources=["a"], settings=limits).columns["a"].size == 2


@pytest.mark.parametrize("cell", ["OVER", True, None])
def test_a_cell_that_is_no_number_is_named(book, limits, cell):
    path = book(("a", "b"), (1, 2), (3, cell), (5, 6))
    with pytest.raises(InputError, match=r"row 3, column 1 \(b\): (not a number|an empty cell)"):
        read_file(path, sources=["b"], settings=limits)


def test_a_missing_package_names_the_extra(book, limits, monkeypatch):
    path = book(("a",), (1,))
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(
        EnvironmentFailure, match=r"needs the package openpyxl\. Install it with: pip install crankorder\[xlsx\]"
    ):
        read_file(path, sources=["a"], settings=limits)


def test_a_damaged_workbook_is_an_input_error(book, limits):
    path = book(("a",), *((float(k),) for k in range(500)))
    content = path.read_bytes()
    for length in (len(content) // 2, len(content) - 1):
        path.write_bytes(content[:length])
        with pytest.raises(InputError, match=r"a\.xlsx: (truncated or damaged|is a damaged XLSX)"):
            read_file(path, sources=["a"], settings=limits)
    random = np.random.default_rng(4)
    refused = 0
    for _ in range(40):
        damaged = bytearray(content)
        damaged[int(random.integers(len(content)))] ^= 255
        path.write_bytes(damaged)
        try:
            values = read_file(path, sources=["a"], settings=limits).columns["a"]
        except InputError:
            refused += 1
        else:
            np.testing.assert_array_equal(values, np.arange(500.0))
    assert refused > 10


def test_an_unpacked_size_beyond_the_budget_is_refused_before_unpacking(book, limits):
    path = book(("a",), *((1,) for _ in range(1000)))
    with pytest.raises(UnsafeInputError, match="bytes of samples; allowed: 1000 bytes"):
        read_file(path, sources=["a"], settings=limits.model_copy(update={"max_bytes": 1000}))


def test_an_absent_column_is_named(book, limits):
    with pytest.raises(InputError, match="channel TDC not in file; has a, b"):
        read_file(book(("a", "b"), (1, 2)), sources=["TDC"], settings=limits)
