"""NumPy array files: rows or columns as channels, and never an object."""

import pickle

import numpy as np
import pytest

from crankorder.errors import InputError, UnsafeInputError
from crankorder.ingest.draft import draft_manifests
from crankorder.ingest.formats import contents_of, read_file


@pytest.fixture
def saved(tmp_path):
    def write(values, **how):
        np.save(tmp_path / "a.npy", values, **how)
        return tmp_path / "a.npy"

    return write


def test_fields_are_columns_by_name(saved, limits):
    table = np.zeros(50, dtype=[("t", "f8"), ("acc", "f4")])
    table["acc"] = np.arange(50)
    path = saved(table)
    assert contents_of(path, settings=limits).names == ("t", "acc")
    assert read_file(path, sources=["acc"], settings=limits).columns["acc"][-1] == 49.0


class Canary:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def test_python_objects_are_refused_and_never_made(saved, tmp_path, limits):
    path = saved(np.array([Canary(tmp_path / "canary")], dtype=object), allow_pickle=True)
    with pytest.raises(UnsafeInputError, match="a pickle that can run code: never opened"):
        read_file(path, sources=[0], settings=limits)
    (tmp_path / "b.npy").write_bytes(pickle.dumps(Canary(tmp_path / "canary")))
    with pytest.raises(UnsafeInputError, match="is a Python pickle"):
        read_file(tmp_path / "b.npy", sources=[0], settings=limits)
    assert not (tmp_path / "canary").exists()


def test_what_a_header_claims_is_checked_before_it_is_believed(tmp_path, limits):
    rows = [
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (4611686018427387904, 2)}", "is damaged or truncated"),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (1000,)}", "is damaged or truncated; found mmap length"),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (-4,)}", "is damaged or truncated"),
        ("{'descr': '<c16', 'fortran_order': False, 'shape': (4,)}", "holds no real numbers; found complex128"),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (2, 2, 2)}", r"is no array of signals; found shape"),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (0,)}", "is no array of signals"),
        ("{'descr': '<f8', 'shape': (4,)}", "is damaged or truncated"),
        ("__import__('os').system('touch canary')", "is damaged or truncated"),
        ("(" * 100, "is damaged or truncated"),
    ]
    path = tmp_path / "crafted.npy"
    for header, words in rows:
        text = header.ljust(118).encode() + b"\n"
        path.write_bytes(b"\x93NUMPY\x01\0" + len(text).to_bytes(2, "little") + text + b"\0" * 64)
        with pytest.raises(InputError, match=words):
            read_file(path, sources=[0], settings=limits)


def test_a_draft_takes_the_array_and_not_the_notes_beside_it(saved, tmp_path):
    saved(np.zeros((500, 2)))
    for name in ("grid.txt", "nodes.txt"):
        (tmp_path / name).write_text("node x\n1 2\n3 4\n")
    text = draft_manifests(tmp_path).text
    assert 'files = ["*.npy"]' in text
    assert "# rate_hz = " in text
    assert text.count("[[channels]]") == 2
