"""Samples beyond the memory allowed lie in a file without a name, and are the same samples."""

import errno
import os
from pathlib import Path

import h5py
import numpy as np
import pytest

from crankorder import scratch
from crankorder.errors import EnvironmentFailure
from crankorder.ingest.formats import read_file
from crankorder.ingest.recording import read_recording
from crankorder.ingest.signal_faults import mend_signal, survey
from crankorder.scratch import BLOCK_SAMPLES, empty, empty_like, is_on_disk, scratch_folder

N = 3 * BLOCK_SAMPLES + 17
NOISE = np.random.default_rng(5).standard_normal((3, N))


@pytest.mark.parametrize(
    "stored",
    [
        {"dtype": "<i2"}, {"dtype": "<f4"}, {"dtype": ">f8"}, {"dtype": "<i4", "chunks": (N,)},
        {"dtype": "<f4", "chunks": (10_007,), "compression": "gzip"},
    ],
    ids=str,
)  # fmt: skip
def test_hdf5_columns_are_the_same_on_disk(tmp_path, limits, stored):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, values in zip("abc", NOISE, strict=True):
            made = file.create_dataset(name, data=(1000 * values).astype(stored["dtype"]), **stored)
            made.attrs.update({"scale_factor": 0.5, "_FillValue": made[5], "units": "V", "rate_hz": 1e3})
    on_disk = limits.model_copy(update={"in_memory_bytes": 0})
    whole, blocks = (
        read_file(tmp_path / "a.h5", sources=["c", "a", "b", 0], settings=one) for one in (limits, on_disk)
    )
    for source, column in whole.columns.items():
        assert is_on_disk(blocks.columns[source]) and not is_on_disk(column)
        assert blocks.columns[source].dtype == column.dtype
        np.testing.assert_array_equal(blocks.columns[source], column)
    assert (whole.units, whole.rates_hz, whole.flags) == (blocks.units, blocks.rates_hz, blocks.flags)


def test_a_recording_on_disk_is_the_one_in_memory(tmp_path, manifest_of, settings):
    tables = '[encoder]\nkind = "square"\nsource = "enc"\npulses_per_rev = 4\n' + "".join(
        f'[[channels]]\nname = "{name}"\nsource = "{name}"\nunit = "m/s2"\n' for name in "ab"
    )
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["rate_hz"] = 1000.0
        # of two types, so that they must be laid beside each other
        file["a"], file["b"] = NOISE[0].astype(np.float32), NOISE[1]
        file["a"].attrs["units"] = "g"
        file["a"][70_000:90_000] = np.nan
        file["enc"] = (np.arange(N) % 40 < 20).astype(np.uint8)
    made = [
        read_recording(
            tmp_path / "a.h5", manifest_of(tables),
            settings=settings.ingest.model_copy(update={"in_memory_bytes": n_bytes}), shaft=settings.shaft,
        )
        for n_bytes in (10**9, 0)
    ]  # fmt: skip
    assert [is_on_disk(recording["signal"].values) for recording in made] == [False, True]
    assert made[0].identical(made[1])


def faults_of(signal, limits):
    return [(fault.flag, fault.detail) for fault in mend_signal(signal, settings=limits)]


def test_a_fault_across_the_border_of_two_blocks_is_one_fault(limits):
    for shift in [-150, -3, -1, 0, 1, 2]:
        border = BLOCK_SAMPLES + shift
        signal = NOISE[0].copy()
        signal[border : border + 2000] = 0.125
        told = f"the same value for 2000 samples (1.0%) from sample {border}"
        assert faults_of(signal, limits) == [("dropout", told)]
        signal = NOISE[0].copy()
        signal[border : border + 200] = np.nan
        [(name, detail)] = faults_of(signal, limits)
        assert name == "gap"
        assert f"in 1 gap, the longest of 200 from sample {border};" in detail
        signal = NOISE[0].copy()
        signal[border : border + 3] = -999.0
        assert [name for name, _ in faults_of(signal, limits)] == ["non_finite_interpolated"]
        line = np.linspace(*NOISE[0, [border - 1, border + 3]], 5)
        np.testing.assert_allclose(signal[border - 1 : border + 4], line, rtol=1e-12)


@pytest.mark.parametrize("wild", [1e18, -1.9e19, 1e20, 1e30])
@pytest.mark.parametrize("place", [10, 5_000, 9_999])
def test_a_wild_sample_is_surveyed_in_single_precision_as_in_double(wild, place):
    signal = np.random.default_rng(1).normal(size=10_000).astype(np.float32)
    signal[place] = wild
    single, double = (survey(values, size=64) for values in (signal, signal.astype(np.float64)))
    assert single.means == pytest.approx(double.means, rel=1e-3, abs=1e-2)
    assert single.variances == pytest.approx(double.variances, rel=1e-3)


def test_a_file_of_samples_has_no_name_and_its_whole_size_from_the_start(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    taken, claim = [], scratch._claim

    def claimed(file, n_bytes):
        claim(file, n_bytes)
        taken.append(512 * os.fstat(file.fileno()).st_blocks)

    monkeypatch.setattr(scratch, "_claim", claimed)
    array = empty((2, 4_000_000), np.float32, on_disk=True)
    assert list(tmp_path.iterdir()) == []
    if hasattr(os, "posix_fallocate"):
        assert taken[0] >= array.nbytes
    array[1, ::7] = 3.0
    assert array[:, ::7].sum() == 3.0 * len(range(0, 4_000_000, 7))
    assert is_on_disk(array[1, 5:].reshape(5, -1))
    assert is_on_disk(empty_like(array[0], (3,), np.float64))
    assert not is_on_disk(empty_like(array[0].copy(), (3,), np.float64))


def test_a_full_disk_is_an_error_of_the_surroundings(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr(scratch, "_claim", full)
    with pytest.raises(EnvironmentFailure, match=rf"{tmp_path}: no room .*No space left on device for 800 bytes"):
        empty((100,), np.float64, on_disk=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_without_a_way_to_claim_room_zeros_are_written(monkeypatch):
    monkeypatch.delattr("os.posix_fallocate", raising=False)
    assert not empty((3_000_001,), np.uint8, on_disk=True).any()


@pytest.mark.slow
def test_files_go_where_tmpdir_says_else_where_memory_is_not(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    assert scratch_folder() == tmp_path
    monkeypatch.delenv("TMPDIR")
    if os.access("/var/tmp", os.W_OK):
        assert scratch_folder() == Path("/var/tmp")
    monkeypatch.setattr(scratch, "_LASTING", tmp_path / "absent")
    assert scratch_folder().is_dir()
