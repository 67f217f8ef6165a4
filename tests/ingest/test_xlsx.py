"""XLSX workbooks are read from their first sheet, and odd cells are named."""

import sys

import numpy as np
import pytest

from crankorder.errors import EnvironmentFailure, InputError
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


@pytest.mark.slow
def test_empty_rows_below_the_data_are_no_samples(book, limits):
    path = book(("a", "b"), (1, 2), (None, None), (3, 4))
    with pytest.raises(InputError, match=r"row 3, column 0 \(a\): an empty cell"):
        read_file(path, sources=["a"], settings=limits)
    path = book(("a", "b"), (1, 2), (3, 4), (None, None), (None, None))
    assert read_file(path, sources=["a"], settings=limits).columns["a"].size == 2


def test_a_cell_that_is_no_number_is_named(book, limits):
    for cell in ["OVER", True, None]:
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
