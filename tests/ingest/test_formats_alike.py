"""One suite for all readers: one signal is one recording in every format; what is cut, damaged or too large is told."""

import re
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pytest
from scipy.io import savemat, wavfile

from crankorder.errors import CrankorderError, InputError, UnsafeInputError
from crankorder.ingest.draft import draft_manifests
from crankorder.ingest.formats import FORMATS, TEXT, contents_of, read_file
from crankorder.ingest.manifest import load_manifest
from crankorder.scratch import is_on_disk
from made.recordings import write_hdf5, write_table
from made.time_bases import WRITERS as OF_RATES
from made.time_bases import Sampled

RATE_HZ, LENGTH_S, REVS_PER_S, TEETH = 8192.0, 1.2, 20.5, 36

Columns = dict[str, np.ndarray]


def columns(seed):
    """Time, acceleration in g, and the pulses of a wheel of 36-2 teeth."""
    time_s = np.arange(int(RATE_HZ * LENGTH_S)) / RATE_HZ
    turns = REVS_PER_S * time_s
    acc = np.sin(2 * np.pi * 2.0 * turns) + 0.05 * np.random.default_rng(seed).standard_normal(time_s.size)
    tooth = np.floor(turns * TEETH) % TEETH
    pulses = ((turns * TEETH % 1.0 < 0.5) & (tooth < TEETH - 2)).astype(float)
    return {"time": time_s, "acc": acc, "crank": pulses}


def as_csv(folder, made):
    columns = dict(zip(("Time [s]", "acc [g]", "crank"), made.values(), strict=True))
    write_table(folder / "a.csv", columns, separator=";")


def as_xlsx(folder, made):
    openpyxl = pytest.importorskip("openpyxl", reason="the package openpyxl (extra xlsx) is not installed")
    book = openpyxl.Workbook()
    book.active.append(["Test bench 7, exported by hand"])
    book.active.append(["Time [s]", "acc [g]", "crank"])
    for row in np.column_stack(list(made.values())).tolist():
        book.active.append(row)
    book.save(folder / "a.xlsx")


def as_npy(folder, made):
    np.save(folder / "a.npy", np.column_stack([made["acc"], made["crank"]]))


def as_wav(folder, made):
    scaled = np.column_stack([made["acc"] / 4.0, made["crank"] / 2.0]) * 2.0**31
    wavfile.write(folder / "a.wav", int(RATE_HZ), scaled.astype("<i4"))


def as_mat73(folder, made):
    with h5py.File(folder / "a.mat", "w", userblock_size=512) as file:
        for key in ("acc", "crank"):
            file[key] = made[key][:, None].T  # MATLAB's columns lie the other way round
        file["fs"] = np.array([[RATE_HZ]])
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path = folder / "a.mat"
    path.write_bytes(head.ljust(512, b"\0") + path.read_bytes()[512:])


def as_sampled(folder, made, *, write):
    """A file that tells the rate of each column."""
    write(folder / "a", [Sampled("acc", "g", made["acc"], RATE_HZ), Sampled("crank", "V", made["crank"], RATE_HZ)])


WRITERS: dict[str, Callable[[Path, Columns], None]] = {
    "CSV": as_csv, "XLSX": as_xlsx, "NumPy": as_npy, "WAV": as_wav, "MATLAB 7.3": as_mat73,
    **{{"MATLAB": "MATLAB 5"}.get(kind, kind): partial(as_sampled, write=write) for kind, write in OF_RATES.items()},
}  # fmt: skip
PACKAGES = {"XLSX": "openpyxl", "TDMS": "nptdms", "MDF4": "asammdf"}
HERE = [kind for kind in WRITERS if kind not in PACKAGES or find_spec(PACKAGES[kind])]
"""Formats that are written here; a test of each format is skipped where its package is not installed."""


class Sound(NamedTuple):
    """A short file that is as its writer left it: its path, the name of its acceleration, and what is read of that."""

    path: Path
    source: str
    values: np.ndarray


@pytest.fixture(scope="module")
def sound(tmp_path_factory, limits):
    """A short file of every format."""
    made, found = {name: values[:2000] for name, values in columns(1).items()}, {}
    for kind in HERE:
        folder = tmp_path_factory.mktemp("sound")
        WRITERS[kind](folder, made)
        (path,) = folder.iterdir()
        names = contents_of(path, settings=limits).names
        source = next((name for name in names if "acc" in name), names[0])
        found[kind] = Sound(path, source, read_file(path, sources=[source], settings=limits).columns[source])
    return found


@pytest.mark.cases(len(WRITERS))
@pytest.mark.parametrize("kind", WRITERS)
def test_one_signal_is_one_recording_in_every_format(tmp_path, read_in, kind):
    made = columns(len(kind))
    WRITERS[kind](tmp_path, made)
    draft = draft_manifests(tmp_path).text
    draft = draft.replace("# rate_hz = ", f"rate_hz = {RATE_HZ} #")  # the one thing that an array alone does not say
    (tmp_path / "run.toml").write_text(draft, encoding="utf-8")
    manifest = load_manifest(tmp_path)
    assert manifest.encoder.kind == "square", draft
    assert (manifest.encoder.pulses_per_rev, manifest.encoder.missing_teeth) == (TEETH, 2), draft
    (channel,) = manifest.channels
    (path,) = (one for one in tmp_path.iterdir() if one.name.startswith("a."))
    recording = read_in(path)
    assert recording.attrs["rate_hz"] == pytest.approx(RATE_HZ, rel=1e-5)
    signal = recording["signal"].values[0]
    scale = {"WAV": 4.0}.get(kind, 1.0)
    np.testing.assert_allclose(signal * scale, made["acc"], atol=2e-6)
    assert recording["pulse_time"].size == pytest.approx(LENGTH_S * REVS_PER_S * (TEETH - 2), abs=2)
    states_unit = kind in ("CSV", "XLSX", "HDF5", "LVM", "TDMS", "MDF4", "UFF")
    assert (channel.unit == "g") == states_unit, draft


@pytest.mark.parametrize("segments", [1, 20])
def test_a2_a_cut_tdms_is_refused_or_flagged_with_counts_but_between_segments(tmp_path, limits, capfd, segments):
    nptdms = pytest.importorskip("nptdms", reason="the package nptdms (extra tdms) is not installed")
    path, n, ends = tmp_path / "a.tdms", 400 // segments, []
    values = {name: np.random.default_rng(5).standard_normal(400) for name in ("acc", "crank")}
    with path.open("wb", buffering=0) as stream, nptdms.TdmsWriter(stream) as file:
        for first in range(0, 400, n):
            rows = [nptdms.ChannelObject("g", name, row[first : first + n]) for name, row in values.items()]
            file.write_segment(rows)
            ends.append(path.stat().st_size)
    whole = path.read_bytes()
    for size in (*range(len(whole) * 19 // 20, len(whole), 17), *ends[-2:-1], len(whole) // 2, len(whole) // 10):
        path.write_bytes(whole[:size])
        try:
            raw = read_file(path, sources=["acc", "crank"], settings=limits)
        except InputError as error:
            assert segments == 1 and re.search(rf"a\.tdms: .*truncated: .* of {len(whole)} bytes", str(error))
            continue
        (length,) = {column.size for column in raw.columns.values()}
        for name, column in raw.columns.items():
            np.testing.assert_array_equal(column, values[name][:length])
        if size in ends:  # those behind the cut leave no trace
            assert raw.flags == [] and length == n * (1 + ends.index(size))
            continue
        (told,) = raw.flags
        assert (told["flag"], told["severity"]) == ("missing_data", "suspect")
        assert f"{length} samples are there" in told["detail"]
        assert re.search(rf"{size} of .*nptdms|last segment was not written to its end", told["detail"])
    assert capfd.readouterr().err == ""


def test_a_cut_file_is_refused_or_told_and_never_silently_short(tmp_path, limits, sound):
    for kind, one in sound.items():
        whole, path, refused = one.path.read_bytes(), tmp_path / one.path.name, 0
        for size in (8, *(round(share * len(whole)) for share in (0.05, 0.5, 0.8, 0.97)), len(whole) - 3):
            size -= whole[size - 1 : size] == b"\n"  # nothing tells where a text ends with a whole line
            path.write_bytes(whole[:size])
            try:
                raw = read_file(path, sources=[one.source], settings=limits)
            except InputError as error:
                assert path.name in str(error)
                refused += 1
                continue
            values, told = raw.columns[one.source], {flag["flag"] for flag in raw.flags}
            sure = values.size - ("last_line_open" in told)  # a number that is cut may be read as another
            np.testing.assert_array_equal(values[:sure], one.values[:sure])
            assert values.size == one.values.size or told & {"missing_data", "last_line_open"}, (kind, size)
        assert refused, kind


@pytest.mark.parametrize(("first", "last"), [(0, 10), pytest.param(10, 110, marks=pytest.mark.slow)])
def test_a_mutation_ends_in_data_or_in_an_error_of_ours(tmp_path, limits, sound, first, last):
    for kind, one in sound.items():
        # three are read in processes of their own
        most = 3 if first == 0 and kind in ("TDMS", "MDF4", "MATLAB 5") else last
        check_mutations(one.path, tmp_path / one.path.name, limits, range(first, most))


def check_mutations(whole, path, limits, seeds, *, head=4000):
    """Read copies of a file with bytes changed at random, every other in its ``head``, of which some are cut too.

    Returns how many were read; the others must be refused by the name of the file.
    """
    limits, content, n_read = limits.model_copy(update={"max_bytes": 100_000_000}), whole.read_bytes(), 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        data = bytearray(content[: rng.integers(8, len(content) + 1)] if seed % 3 == 0 else content)
        for place in rng.integers(0, min(len(data), head) if seed % 2 else len(data), size=rng.integers(1, 9)):
            data[place] = rng.integers(256)
        path.write_bytes(data)
        try:
            names = contents_of(path, settings=limits).names
            raw = read_file(path, sources=list(names), settings=limits)
        except CrankorderError as error:
            assert path.name in str(error)
        else:
            assert all(column.ndim == 1 and column.dtype.kind == "f" for column in raw.columns.values())
            if path.suffix == ".xlsx":  # every part has a checksum
                right = read_file(whole, sources=list(names), settings=limits).columns
                np.testing.assert_array_equal(list(raw.columns.values()), list(right.values()))
            n_read += 1
    return n_read


def test_a_channel_that_is_absent_is_named_with_those_that_are_there(limits, sound):
    for one in sound.values():
        there = contents_of(one.path, settings=limits).names
        with pytest.raises(InputError) as error:
            read_file(one.path, sources=["nobody"], settings=limits)
        assert f"{one.path.name}: channel nobody not in file; has {there[0]}" in str(error.value)


def test_what_a_file_claims_beyond_the_budget_is_refused(limits, sound):
    for one in sound.values():
        with pytest.raises(UnsafeInputError, match=rf"{one.path.name}: .*allowed: 1000 bytes"):
            read_file(one.path, sources=[one.source], settings=limits.model_copy(update={"max_bytes": 1000}))


def test_samples_on_disk_are_those_in_memory(limits, sound):
    on_disk = limits.model_copy(update={"in_memory_bytes": 0})
    for kind, one in sound.items():
        column = read_file(one.path, sources=[one.source], settings=on_disk).columns[one.source]
        np.testing.assert_array_equal(column, one.values)
        assert column.dtype == one.values.dtype
        at_once = kind in ("XLSX", "TDMS", "MDF4", "UFF", "MATLAB 5")
        assert is_on_disk(column) != at_once, kind


def test_contents_are_those_of_what_is_read_and_reading_changes_nothing(limits, sound):
    for kind, one in sound.items():
        before = (one.path.read_bytes(), one.path.stat().st_mtime_ns, sorted(one.path.parent.iterdir()))
        told = contents_of(one.path, settings=limits)
        raw = read_file(one.path, sources=[one.source], settings=limits)
        assert told.samples.get(one.source, 2000) == raw.columns[one.source].size == 2000, kind
        assert told.units.get(one.source) == raw.units.get(one.source), kind
        assert before == (one.path.read_bytes(), one.path.stat().st_mtime_ns, sorted(one.path.parent.iterdir())), kind


ARRAYS = {
    "a.npy": np.save, "a.h5": lambda path, values: write_hdf5(path, {"x": values}),
    "a.mat": lambda path, values: savemat(path, {"x": values}, do_compression=values.ndim > 1),
}  # fmt: skip


@pytest.mark.parametrize("name", ARRAYS)
def test_numbers_of_every_type_are_those_that_were_saved(tmp_path, limits, name):
    for kind in ("<f8", ">f4", "i1", "u1", ">i2", "u2", "<i4", ">u4", "i8", "u8", "?"):
        values = (np.arange(700) % 120).astype(kind)
        ARRAYS[name](tmp_path / name, values)
        column = read_file(tmp_path / name, sources=[0], settings=limits).columns[0]
        np.testing.assert_array_equal(column, values.astype(column.dtype))
        assert column.dtype == (np.float32 if kind[-2:] in ("f4", "i1", "u1", "i2", "u2", "?") else np.float64)


@pytest.mark.parametrize("name", ARRAYS)
def test_the_longer_side_of_a_table_is_time_whichever_way_it_lies(tmp_path, limits, name):
    table = np.random.default_rng(1).normal(size=(400, 3))
    for values in (table, table.T, np.asfortranarray(table), np.asfortranarray(table.T)):
        ARRAYS[name](tmp_path / name, values)
        assert list(contents_of(tmp_path / name, settings=limits).samples.values()) == [400] * 3
        columns = read_file(tmp_path / name, sources=[2, 0], settings=limits).columns
        np.testing.assert_array_equal(np.stack([columns[0], columns[2]], axis=1), table[:, [0, 2]])


def test_every_format_that_is_read_is_held_to_these_laws():
    assert {format_of_kind.name for format_of_kind in (*FORMATS, TEXT)} == {
        {"CSV": "text", "MATLAB 5": "MATLAB", "MATLAB 7.3": "HDF5"}.get(kind, kind) for kind in WRITERS
    } | {"IDE"}  # which nothing writes: its real files are read in test_ide.py
