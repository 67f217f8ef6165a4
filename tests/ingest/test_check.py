"""``check`` lists every fault of a folder at once."""

import h5py
import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.ingest.check import check_folder

MANIFEST = """schema_version = 1
[test]
cycle = "rotor"
[recordings]
files = ["*.h5", "absent.h5", "../out.h5"]
[recordings.speed_rpm]
"good.h6" = 1000
[sampling]
rate_hz = 1000
[[channels]]
name = "Z"
source = "acc"
unit = "m/s2"
"""


def recorded(path, *, rate=1000.0, unit="m/s2", **columns):
    with h5py.File(path, "w") as file:
        file.attrs["rate_hz"] = rate
        for name, values in columns.items():
            file[name] = values
            file[name].attrs["units"] = unit


def test_every_fault_of_a_folder_is_listed_at_once(tmp_path, limits):
    (tmp_path / "run.toml").write_text(MANIFEST)
    recorded(tmp_path / "good.h5", acc=np.arange(10.0))
    recorded(tmp_path / "rate.h5", acc=np.arange(10.0), rate=1024.0)
    recorded(tmp_path / "channel.h5", a1=np.arange(10.0))
    recorded(tmp_path / "unit.h5", acc=np.arange(10.0), unit="Pa")
    (tmp_path / "text.h5").write_text("1,2\n3,4\n")
    before = sorted((path.name, path.stat().st_mtime_ns, path.read_bytes()) for path in tmp_path.iterdir())
    text = "\n".join(str(fault) for fault in check_folder(tmp_path, settings=limits))
    for words in (
        "absent.h5: no such file",
        "outside the run folder",
        "recordings.speed_rpm.good.h6: a speed is stated for no recording. Did you mean 'good.h5'?",
        "rate.h5: the sampling rate is 1024 Hz in the file, 1000 Hz in the manifest",
        "channel.h5: channel acc not in file; has a1",
        "unit.h5: source acc: channel Z: Pa (pressure) cannot become m/s2 (acceleration)",
        "text.h5: is text, though its name ends in .h5",
        "encoder.kind: nothing tells the speed",
    ):
        assert words in text
    assert len(text.split("\n")) == 8
    assert before == sorted((path.name, path.stat().st_mtime_ns, path.read_bytes()) for path in tmp_path.iterdir())


def test_a_right_folder_has_no_faults(tmp_path, limits):
    (tmp_path / "run.toml").write_text(
        MANIFEST.replace(', "absent.h5", "../out.h5"', "").replace("h6", "h5")
        + '[encoder]\nkind = "constant"\nspeed_rpm = 1000\n'
    )
    recorded(tmp_path / "good.h5", acc=np.arange(10.0))
    assert check_folder(tmp_path, settings=limits) == []


def test_a_wrong_manifest_is_all_that_is_checked(tmp_path, limits):
    (tmp_path / "run.toml").write_text(MANIFEST.replace("rate_hz", "rat_hz").replace('"m/s2"', '"G"'))
    faults = [str(fault) for fault in check_folder(tmp_path, settings=limits)]
    assert len(faults) == 2
    assert "Did you mean 'rate_hz'?" in faults[0] + faults[1]
    assert isinstance(check_folder(tmp_path / "absent", settings=limits)[0], RequestError)


@pytest.mark.slow
def test_lengths_that_differ_are_found_without_reading(tmp_path, limits):
    (tmp_path / "run.toml").write_text(
        MANIFEST.replace(', "absent.h5", "../out.h5"', "").replace("h6", "h5")
        + '[encoder]\nkind = "square"\nsource = "enc"\npulses_per_rev = 4\n'
    )
    recorded(tmp_path / "good.h5", acc=np.arange(10.0), enc=np.arange(9.0))
    (fault,) = check_folder(tmp_path, settings=limits)
    assert "lengths differ: Z has 10 samples, the encoder has 9" in str(fault)


@pytest.mark.slow
def test_a_cam_mark_that_is_absent_or_of_another_length_is_found_without_reading(tmp_path, limits):
    rows = [
        ({}, "channel cam not in file"),
        ({"cam": np.arange(9.0)}, "lengths differ: Z has 10 samples, the cam mark has 9"),
    ]
    for columns, words in rows:
        (tmp_path / "run.toml").write_text(
            MANIFEST.replace(', "absent.h5", "../out.h5"', "").replace("h6", "h5").replace("rotor", "four-stroke")
            + '[encoder]\nkind = "square"\nsource = "enc"\npulses_per_rev = 4\ncam = "cam"\n'
        )
        recorded(tmp_path / "good.h5", acc=np.arange(10.0), enc=np.arange(10.0), **columns)
        (fault,) = check_folder(tmp_path, settings=limits)
        assert words in str(fault)
