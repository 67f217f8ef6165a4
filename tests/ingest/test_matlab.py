"""MATLAB files: names and rates of what they hold; nothing that one claims can end the process or fill the memory."""

import struct
import time
import zlib

import numpy as np
import pytest
import scipy.io

from crankorder.errors import InputError, UnsafeInputError
from crankorder.ingest.check import check_folder
from crankorder.ingest.draft import draft_manifests
from crankorder.ingest.formats import contents_of, read_file
from made.recordings import manifest


@pytest.fixture
def saved(tmp_path):
    """A file of variables, written by SciPy."""

    def write(*, name="a.mat", compressed=False, **variables):
        scipy.io.savemat(tmp_path / name, variables, do_compression=compressed)
        return tmp_path / name

    return write


def test_what_lies_in_structs_and_cells_has_a_name_of_its_own(saved, limits):
    for compressed in [False, True]:
        cell = np.empty(2, dtype=object)
        cell[:] = [np.arange(5.0), "text"]
        bearing = {"gs": np.arange(9.0), "sr": 48828, "load": "50", "deep": {"y": np.arange(4.0)}}
        path = saved(bearing=bearing, c=cell, note="words", z=np.arange(3) * 1j, compressed=compressed)
        contents = contents_of(path, settings=limits)
        assert set(contents.names) == {"bearing.gs", "bearing.deep.y", "c{0}", "bearing.sr"}
        assert contents.samples["bearing.sr"] == 1
        assert contents.rates_hz["bearing.gs"] == 48828.0
        columns = read_file(path, sources=["bearing.deep.y", "c{0}", "bearing.sr"], settings=limits).columns
        np.testing.assert_array_equal(columns["bearing.deep.y"], np.arange(4.0))
        np.testing.assert_array_equal(columns["c{0}"], np.arange(5.0))
        assert columns["bearing.sr"].tolist() == [48828.0]


def test_a_number_beside_the_samples_states_the_rate_unless_two_contradict(saved, limits):
    rows = [
        ({"fs": 1000.0}, 1000.0), ({"dt": 0.002}, 500.0), ({"Time_Sample_Rate": 1280.0}, 1280.0),
        ({"fs": 1000.0, "dt": 0.001}, 1000.0), ({"fs": 1000.0, "dt": 0.002}, None),
        ({"head": {"SampFreq": np.float32(25600.0)}}, 25600.0), ({"offset": 3.0}, None), ({"fs": -1.0}, None),
    ]  # fmt: skip
    for beside, rate_hz in rows:
        path = saved(x=np.arange(100.0), **beside)
        assert read_file(path, sources=["x"], settings=limits).rates_hz.get("x") == rate_hz
    path = saved(x=np.arange(9.0), fs=100.0, other={"x": np.arange(9.0), "fs": 200.0})
    assert contents_of(path, settings=limits).rates_hz.items() >= {"x": 100.0, "other.x": 200.0}.items()


@pytest.mark.slow
def test_of_a_variable_written_twice_the_last_is_read_and_a_flag_tells(saved, limits):
    first, second = saved(x=np.zeros(50)).read_bytes(), saved(x=np.arange(50.0)).read_bytes()
    path = saved(x=np.zeros(3))
    path.write_bytes(first + second[128:])
    raw = read_file(path, sources=["x"], settings=limits)
    assert raw.columns["x"][-1] == 49.0
    assert [flag["flag"] for flag in raw.flags] == ["variable_written_twice"]


def test_names_that_are_absent_or_fit_twice_are_refused_with_what_is_there(saved, limits):
    path = saved(X1_DE_time=np.arange(9.0), X1_FE_time=np.arange(9.0), X1RPM=1750)
    assert list(read_file(path, sources=["*_DE_time"], settings=limits).columns) == ["*_DE_time"]
    with pytest.raises(InputError, match=r"channel \*_time not in file; has X1_DE_time, X1_FE_time, X1RPM"):
        read_file(path, sources=["*_time"], settings=limits)


def element(code, body, *, claim=None):
    return struct.pack("<II", code, len(body) if claim is None else claim) + body + b"\0" * (-len(body) % 8)


def array(shape, inner, *, code=6, name=b"x"):
    head = element(6, struct.pack("<II", code, 0)) + element(5, struct.pack(f"<{len(shape)}i", *shape))
    return element(14, head + element(1, name) + inner)


def compressed_array(shape, claim):
    body = array(shape, element(9, b"\0" * 16))[8:]
    return element(15, zlib.compress(struct.pack("<II", 14, claim) + body.ljust(claim if claim > 1000 else 0, b"\0")))


def crafted(tmp_path, body):
    path = tmp_path / "crafted.mat"
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM" + body)
    return path


def nested(depth):
    inner = array((1, 2), element(9, b"\0" * 16), name=b"")
    for _ in range(depth):
        inner = array((1, 1), inner, code=1, name=b"")
    return array((1, 1), inner, code=1)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (array((2**30, 2**30), element(9, b"\0" * 16)), "claims 9223372036854775808 bytes of samples"),
        (array((1, 2**20), element(9, b"\0" * 16)), "damaged: .*cannot reshape array of size 2"),
        (compressed_array((1, 2**20), 2000), "damaged: .*could not read bytes"),
        (array((1, 2), element(9, b"\0" * 16, claim=2**31)), "its parser died|too much memory|damaged"),
        *((array((1, 2), element(code, b"\0" * 16)), r"its parser died \(SIG|damaged: ") for code in (8, 19, 20, 200)),
        (array((1, -2), element(9, b"\0" * 16)), "a variable without a shape"),
        (array((1, 2), b""), "damaged"),
        (array((1, 1), element(5, struct.pack("<i", 0)) + element(1, b""), code=2), "damaged"),
        (array((1, 1000), b"", code=1), "damaged"),
        (element(15, zlib.compress(struct.pack("<II", 14, 2**32 - 1) + b"\0" * 64)), "damaged"),
        (element(15, b"no deflate stream at all"), "damaged: .*while decompressing"),
        (element(15, zlib.compress(b"\0" * 4)), "damaged"),
        (nested(200), "nested deeper than 32"),
    ],
)
@pytest.mark.cases(20)
def test_what_a_crafted_file_claims_is_checked_before_it_is_believed(tmp_path, limits, body, words):
    with pytest.raises(InputError, match=words):
        read_file(crafted(tmp_path, body), sources=[0], settings=limits)


def test_more_objects_than_a_recording_has_are_refused(tmp_path, limits):
    few = limits.model_copy(update={"max_objects": 50})
    body = b"".join(array((1, 2), element(9, b"\0" * 16), name=b"x%d" % k) for k in range(60))
    with pytest.raises(UnsafeInputError, match="holds more than 50 objects"):
        contents_of(crafted(tmp_path, body), settings=few)


@pytest.mark.cases(2)
@pytest.mark.parametrize("code", [1, 2])
@pytest.mark.parametrize("packed", [False, True])
def test_a_matlab_variable_of_four_million_empty_arrays_is_refused_at_once(tmp_path, limits, code, packed):
    fields = struct.pack("<Ii", 4 << 16 | 5, 4) + element(1, b"a\0\0\0") if code == 2 else b""
    body = array((1, 4_000_000), fields + element(14, b"") * 4_000_000, code=code)
    deflated = zlib.compress(body, 1)
    path = crafted(tmp_path, struct.pack("<II", 15, len(deflated)) + deflated if packed else body)
    begun = time.monotonic()
    with pytest.raises(UnsafeInputError, match=r"crafted\.mat: a variable holds more than 20000 arrays"):
        contents_of(path, settings=limits)
    assert time.monotonic() - begun < 10.0


MANIFEST = manifest(
    "*.mat", channels={"DE": {"source": "*_DE_time"}}, sampling={"rate_hz": 12000},
    encoder={"kind": "constant", "source": "*RPM"},
)  # fmt: skip


def test_a_constant_speed_is_that_which_the_file_states(saved, tmp_path, settings, read_in):
    (tmp_path / "run.toml").write_text(MANIFEST)
    path = saved(X107_DE_time=np.arange(100.0), X107RPM=np.uint16(1748))
    assert check_folder(tmp_path, settings=settings.ingest) == []
    assert read_in(path).attrs["speed_rpm"] == 1748.0
    path = saved(X107_DE_time=np.arange(100.0), X107RPM=np.arange(100.0))
    with pytest.raises(InputError, match=r"a constant speed is one number above 0.*found 100 values"):
        read_in(path)


def test_a_draft_names_what_each_file_calls_otherwise_by_what_they_share(saved, tmp_path, settings):
    saved(name="a.mat", X1_DE_time=np.arange(50.0), X1RPM=1750)
    saved(name="b.mat", X2_DE_time=np.arange(60.0), X2RPM=1751)
    text = draft_manifests(tmp_path).text
    assert 'source = "*_DE_time"' in text
    assert 'kind = "constant"\nsource = "*RPM"' in text
    assert "# Single numbers in the file, such as a speed: X1RPM" in text
    (tmp_path / "run.toml").write_text(text.replace("# rate_hz = ", "rate_hz = 1000"))
    assert check_folder(tmp_path, settings=settings.ingest) == []
