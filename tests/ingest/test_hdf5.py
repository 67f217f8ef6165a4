"""HDF5 files are read fast, read-only, and never lead anywhere else."""

from functools import partial

import h5py
import numpy as np
import pytest

from crankorder.errors import InputError, UnsafeInputError
from crankorder.ingest.formats import contents_of, read_file
from made.recordings import write_hdf5

RNG = np.random.default_rng(20)


def test_float32_columns_lie_side_by_side(tmp_path, limits):
    path = write_hdf5(tmp_path / "a.h5", {name: RNG.random(4000, np.float32) for name in ("a", "raw/b")})
    first, second = read_file(path, sources=["/raw/b", "a"], settings=limits).columns.values()
    assert second.ctypes.data - first.ctypes.data == first.nbytes


def test_netcdf_packing_and_fill_values_are_undone(tmp_path, limits):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"] = np.array([1, 2, -32768, 4], dtype=np.int16)
        file["a"].attrs.update(scale_factor=0.5, add_offset=10.0, _FillValue=np.int16(-32768))
    values = read_file(tmp_path / "a.h5", sources=["a"], settings=limits).columns["a"]
    np.testing.assert_array_equal(values, [10.5, 11.0, np.nan, 12.0])


def test_a_file_that_its_writer_never_closed_is_named_and_left_alone(tmp_path, limits):
    path, written = tmp_path / "open.h5", tmp_path / "written.h5"
    with h5py.File(written, "w", libver="latest") as file:
        file["a"] = np.zeros(10)
        file.flush()
        content = written.read_bytes()
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"was not closed by its writer.*h5clear --status"):
        read_file(path, sources=["a"], settings=limits)
    assert path.read_bytes() == content


def test_external_storage_and_links_are_refused_and_their_content_never_shows(tmp_path, limits):
    secret = tmp_path / "secret.txt"
    secret.write_text("canary" * 100)
    with h5py.File(tmp_path / "storage.h5", "w") as file:
        file.create_dataset("a", (100,), "u1", external=[(str(secret), 0, 100)])
    write_hdf5(tmp_path / "other.h5", {"b": np.zeros(100)})
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file["fine"] = np.zeros(10)
        file["a"] = h5py.ExternalLink("other.h5", "/b")
    layout = h5py.VirtualLayout(shape=(100,), dtype="f8")
    layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "b", shape=(100,))
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        file.create_virtual_dataset("a", layout)
    for name, words in (
        ("storage", "keeps its samples in another file"),
        ("link", "links to another file, which is never followed"),
        ("virtual", "is put together from other files"),
    ):
        for attempt in (partial(read_file, sources=["a"]), contents_of):
            with pytest.raises(UnsafeInputError, match=words) as caught:
                attempt(tmp_path / f"{name}.h5", settings=limits)
            assert "canary" not in str(caught.value)


def test_an_impossible_size_a_bomb_and_missing_blocks_are_refused_before_allocation(tmp_path, limits):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", (10**12,), "f8", chunks=(10**6,))
        file.create_dataset("b", (2**60,), "f8", chunks=(10**6,))
        file.create_dataset("c", (4000,), "f4", chunks=(1000,))[:2000] = 1.0  # what was not written is no zeros
        file.create_dataset("d", data=np.zeros(10**6), compression="gzip")
    assert (tmp_path / "a.h5").stat().st_size < 50_000
    for name, kind, words, most_bytes in (
        ("a", InputError, "missing data: 0 of 1000000 blocks were written", limits.max_bytes),
        ("b", UnsafeInputError, "claims 9223372036854775808 bytes of samples; allowed: 8000000000", limits.max_bytes),
        ("c", InputError, "missing data: 2 of 4 blocks were written", limits.max_bytes),
        ("d", UnsafeInputError, "claims 8000000 bytes of samples; allowed: 1000000 bytes", 10**6),
    ):
        with pytest.raises(kind, match=words):
            read_file(tmp_path / "a.h5", sources=[name], settings=limits.model_copy(update={"max_bytes": most_bytes}))


def test_a_flipped_bit_is_caught_where_the_file_has_a_checksum(tmp_path, limits):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        dataset = file.create_dataset("a", data=RNG.standard_normal(4000), chunks=(4000,), fletcher32=True)
        offset = dataset.id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[offset + 1000] ^= 4
    path.write_bytes(content)
    with pytest.raises(InputError, match="damaged: the checksum or the compression of the samples is wrong"):
        read_file(path, sources=["a"], settings=limits)


def test_a_filter_that_would_load_a_plugin_is_refused(tmp_path, limits):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        create = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        create.set_chunk((100,))
        create.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, ())
        space = h5py.h5s.create_simple((100,))
        h5py.h5d.create(file.id, b"a", h5py.h5t.IEEE_F32LE, space, create)
    with pytest.raises(InputError, match="needs filter 32015, which is not built in; allowed: gzip"):
        read_file(path, sources=["a"], settings=limits)


def test_deep_and_wide_trees_are_refused(tmp_path, limits):
    write_hdf5(tmp_path / "deep.h5", {"/".join("g" * 100) + "/a": np.zeros(3)})
    with pytest.raises(UnsafeInputError, match="groups are nested deeper than 32"):
        read_file(tmp_path / "deep.h5", sources=["a"], settings=limits)
    with h5py.File(tmp_path / "wide.h5", "w") as file:
        for number in range(60):
            file.create_group(f"g{number}")
    with pytest.raises(UnsafeInputError, match="holds more than 50 objects"):
        read_file(tmp_path / "wide.h5", sources=["a"], settings=limits.model_copy(update={"max_objects": 50}))


def test_text_objects_compounds_and_links_are_no_channels_and_a_group_that_holds_itself_ends(tmp_path, limits):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["text"] = "hello"
        file["texts"] = ["a", "b"]
        file.create_dataset("vlen", (2,), dtype=h5py.vlen_dtype(np.float64))
        file["pair"] = np.zeros(3, dtype=[("a", "f4"), ("b", "f4")])
        file["scalar"] = 1.0
        file["real"] = np.zeros(3)
        file["soft"] = h5py.SoftLink("/real")
        file["g/loop"] = file["/"]
    assert contents_of(tmp_path / "a.h5", settings=limits).names == ("real",)


def test_a_rate_that_lies_beside_the_samples_as_a_number_of_its_own_is_read(tmp_path, limits):
    """As MATLAB 7.3 and scripts write it; an attribute goes before it, and what must be followed is not read."""
    rates = {"fs": [[6000.0]], "rpm": [[1500.0]], "run/Sample Rate": 500.0}
    path = write_hdf5(tmp_path / "a.mat", {"acc": np.arange(100.0)[None], "run/b": np.arange(50.0), **rates})
    stated = contents_of(path, settings=limits)
    assert stated.rates_hz["acc"] == 6000.0 and stated.rates_hz["run/b"] == 500.0 and stated.speed_rpm == 1500.0
    assert read_file(path, sources=["acc"], settings=limits).rates_hz == {"acc": 6000.0}
    with h5py.File(path, "r+") as file:
        file["acc"].attrs["fs"] = 8000.0
    assert read_file(path, sources=["acc"], settings=limits).rates_hz == {"acc": 8000.0}
    with h5py.File(path, "r+") as file:
        del file["run/Sample Rate"]
        del file["fs"]
        file["run/fs"] = h5py.SoftLink("/acc")
    assert "run/b" not in contents_of(path, settings=limits).rates_hz
