"""IDE recordings: what idelib, the format's own library, reads; blocks that are missing; files that are none."""

import re

import numpy as np
import pytest

from crankorder.errors import InputError
from crankorder.ingest.draft import draft_manifests
from crankorder.ingest.formats import contents_of, read_file
from crankorder.ingest.manifest import load_manifest
from ingest.test_formats_alike import check_mutations

idelib = pytest.importorskip("idelib", reason="the package idelib (extra ide) is not installed")


@pytest.fixture
def path(shared_data):
    return shared_data / "formats" / "ide" / "SSX66115.IDE"


def test_all_channels_are_those_of_the_formats_own_library(path, limits):
    told = contents_of(path, settings=limits)
    with idelib.importFile(str(path), quiet=True) as file:
        number = 0
        for channel in file.channels.values():
            for part in channel.subchannels:
                times, values = part.getSession().arraySlice()
                name, number = told.names[number], number + 1
                raw = read_file(path, sources=[name], settings=limits)
                np.testing.assert_array_equal(raw.columns[name], values)
                assert told.samples[name] == values.size
                if values.size > 2:
                    rate_hz = 1e6 * (values.size - 1) / (times[-1] - times[0])
                    assert raw.rates_hz[name] == pytest.approx(rate_hz, rel=1e-9)
                    assert raw.starts_s[name] == pytest.approx(1e-6 * times[0])
        assert number == len(told.names) > 10


def test_a_draft_names_one_sensor_and_can_be_run(path, tmp_path, read_in):
    (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "run.toml").write_text(draft_manifests(tmp_path).text, encoding="utf-8")
    manifest = load_manifest(tmp_path)
    assert [(channel.name, channel.unit) for channel in manifest.channels] == [
        (f"Acceleration: {axis}", "g") for axis in "XYZ"
    ]
    assert read_in(tmp_path / path.name).attrs["rate_hz"] == pytest.approx(5000.0, rel=1e-4)


@pytest.mark.slow
def test_a_clock_that_wanders_is_told(path, limits):
    for sensor, severity in (("40g", "suspect"), ("25g", "info")):
        source = f"Acceleration: X ({sensor})"
        (told,) = read_file(path.with_name("XS5E25D40.IDE"), sources=[source], settings=limits).flags
        assert (told["flag"], told["severity"]) == ("time_jitter", severity)


def test_a_lost_block_is_a_gap(path, tmp_path, limits):
    whole, expected = path.read_bytes(), read_file(path, sources=[0], settings=limits).columns[0]
    # a block of channel 8 (ChannelDataBlock 0xA1, its channel 0xB0 81 08) becomes one that nobody reads (Void)
    blocks = [match.start() for match in re.finditer(rb"(?s)\xa1..\xb0\x81\x08", whole)]
    chosen = blocks[len(blocks) // 2]
    (tmp_path / "a.IDE").write_bytes(whole[:chosen] + b"\xec" + whole[chosen + 1 :])
    raw = read_file(tmp_path / "a.IDE", sources=[0], settings=limits)
    lost = np.isnan(raw.columns[0])
    assert 300 < lost.sum() < 2000 and np.ptp(np.flatnonzero(lost)) == lost.sum() - 1
    assert "time_gap" in [one["flag"] for one in raw.flags]
    assert abs(raw.columns[0].size - expected.size) <= 2
    first = int(np.flatnonzero(lost)[0])
    np.testing.assert_allclose(raw.columns[0][:first], expected[:first], atol=0.02)


def test_another_file_of_its_container_is_named(tmp_path, limits):
    (tmp_path / "a.ide").write_bytes(b"\x1aE\xdf\xa3\x9fB\x86\x81\x01B\x82\x84webm" + bytes(100))
    with pytest.raises(InputError, match=r"a\.ide: is an EBML file \(such as a video\)"):
        contents_of(tmp_path / "a.ide", settings=limits)


@pytest.mark.slow
def test_a_mutation_ends_in_data_or_in_an_error_of_ours(path, tmp_path, limits):
    assert check_mutations(path.with_name("XS5E25D40.IDE"), tmp_path / "a.IDE", limits, range(1000), head=20_000) > 100
