"""``check`` lists every fault at once; ``init`` drafts a manifest that reads."""

import h5py
import numpy as np
import pytest

from crankorder.errors import NoUsableRecordingError, RequestError
from crankorder.ingest.check import check_folder
from crankorder.ingest.draft import draft_manifest
from crankorder.ingest.folder import recordings_of
from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_recording

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


def test_lengths_that_differ_are_found_without_reading(tmp_path, limits):
    (tmp_path / "run.toml").write_text(
        MANIFEST.replace(', "absent.h5", "../out.h5"', "").replace("h6", "h5")
        + '[encoder]\nkind = "square"\nsource = "enc"\npulses_per_rev = 4\n'
    )
    recorded(tmp_path / "good.h5", acc=np.arange(10.0), enc=np.arange(9.0))
    (fault,) = check_folder(tmp_path, settings=limits)
    assert "lengths differ: Z has 10 samples, the encoder has 9" in str(fault)


def test_a_draft_of_a_well_described_folder_reads_without_a_change(tmp_path, settings):
    time = np.arange(5000) / 1000.0
    square = ((time * 20) % 1 < 0.5).astype(float)
    for name in ("rpm_300.h5", "rpm_1200.h5"):
        with h5py.File(tmp_path / name, "w") as file:
            file.attrs["rate_hz"] = 1000.0
            for key, values in (("acc_z", time), ("encoder", square), ("index", square)):
                file[key] = values
            file["acc_z"].attrs["units"] = "m/s²"
    (tmp_path / "notes.md").write_text("hello")
    (tmp_path / "run.toml").write_text(draft_manifest(tmp_path), encoding="utf-8")
    manifest = load_manifest(tmp_path)
    assert [channel.name for channel in manifest.channels] == ["acc_z"]
    assert (manifest.encoder.source, manifest.encoder.index, manifest.encoder.kind) == ("encoder", "index", "square")
    assert check_folder(tmp_path, settings=settings.ingest) == []
    paths = recordings_of(tmp_path, manifest).paths
    assert [path.name for path in paths] == ["rpm_300.h5", "rpm_1200.h5"]
    recording = read_recording(paths[0], manifest, settings=settings.ingest, shaft=settings.shaft)
    assert recording.sizes["time"] == 5000


@pytest.mark.parametrize("name", ['a"b', "a\\b", "a\nb", "ünïcode 😀", "x\x7f", "]] = 'q'", "\x1b[31m"])
def test_a_draft_is_valid_whatever_the_names_are(tmp_path, name):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["rate_hz"] = 1000.0
        file[name] = np.arange(10.0)
    (tmp_path / "run.toml").write_text(draft_manifest(tmp_path), encoding="utf-8")
    assert load_manifest(tmp_path).channels[0].name == name


def test_a_draft_marks_what_the_files_do_not_say(tmp_path):
    (tmp_path / "a.csv").write_text("acc,ir\n1,0\n2,1\n3,0\n")
    text = draft_manifest(tmp_path)
    assert "rate_hz = 0.0" in text
    assert text.count("# state:") >= 5


def test_nothing_to_draft_from_says_what_was_found(tmp_path):
    with pytest.raises(NoUsableRecordingError, match=r"no recording found; looked for HDF5.*found an empty folder"):
        draft_manifest(tmp_path)
    (tmp_path / "a.tdms").write_bytes(b"TDSm\0\0")
    with pytest.raises(NoUsableRecordingError, match="is a TDMS file: not supported yet"):
        draft_manifest(tmp_path)
    with pytest.raises(RequestError, match="there is no such folder"):
        draft_manifest(tmp_path / "absent")


def drafted(folder, *, names=("acc", "encoder"), **columns):
    with h5py.File(folder / "a.h5", "w") as file:
        file.attrs["rate_hz"] = 20_000.0
        for name in names:
            file[name] = columns.get(name, np.zeros(80_000))
    text = draft_manifest(folder)
    (folder / "run.toml").write_text(text, encoding="utf-8")
    return text, load_manifest(folder).encoder


def wheel_trace(angles_deg, *, revs_per_s=15.0, width_deg=3.0):
    angle = 360.0 * (np.arange(80_000) / 20_000.0 * revs_per_s % 1.0)
    return sum(((angle - tooth) % 360.0 < width_deg).astype(float) for tooth in angles_deg)


def test_a_draft_proposes_the_wheel_that_the_pulses_show(tmp_path):
    missing = [6.0 * tooth for tooth in range(58)]
    text, encoder = drafted(tmp_path, encoder=wheel_trace(missing))
    assert (encoder.kind, encoder.pulses_per_rev, encoder.missing_teeth) == ("square", 60, 2)
    assert "60-2 (58 pulses), seen in 100% of" in text


def test_a_draft_proposes_a_named_wheel_and_takes_the_cam_along(tmp_path):
    teeth = [*range(0, 170, 10), *range(180, 340, 10)]
    angle = np.arange(80_000) / 20_000.0 * 15.0 % 2.0
    cam = (angle < 0.05).astype(float)
    names = ("acc", "crank", "cam")
    _, encoder = drafted(tmp_path, names=names, crank=5.0 * wheel_trace(teeth), cam=cam)
    assert (encoder.pattern, encoder.cam) == ("36-2-1", "cam")


def test_a_draft_lists_the_angles_of_a_wheel_without_a_name(tmp_path):
    teeth = [0.0, 40.0, 60.0, 130.0, 150.0, 155.0, 210.0]
    _, encoder = drafted(tmp_path, encoder=wheel_trace(teeth))
    assert encoder.tooth_angles_deg is not None
    spans = np.sort(np.diff([*encoder.tooth_angles_deg, 360.0]))
    np.testing.assert_allclose(spans, np.sort(np.diff([*teeth, 360.0])), atol=0.5)


def test_a_draft_counts_even_pulses_by_the_index(tmp_path):
    teeth = [3.0 * tooth for tooth in range(120)]
    names = ("acc", "encoder", "index")
    _, encoder = drafted(tmp_path, names=names, encoder=wheel_trace(teeth, width_deg=1.5), index=wheel_trace([0.0]))
    assert (encoder.pulses_per_rev, encoder.missing_teeth, encoder.index) == (120, 0, "index")


def test_a_draft_leaves_even_pulses_without_an_index_to_be_stated(tmp_path):
    text, encoder = drafted(tmp_path, encoder=wheel_trace([3.0 * tooth for tooth in range(120)], width_deg=1.5))
    assert encoder.pulses_per_rev is None
    assert "# pulses_per_rev = " in text


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({}, "channel cam not in file"),
        ({"cam": np.arange(9.0)}, "lengths differ: Z has 10 samples, the cam mark has 9"),
    ],
)
def test_a_cam_mark_that_is_absent_or_of_another_length_is_found_without_reading(tmp_path, limits, columns, words):
    (tmp_path / "run.toml").write_text(
        MANIFEST.replace(', "absent.h5", "../out.h5"', "").replace("h6", "h5").replace("rotor", "four-stroke")
        + '[encoder]\nkind = "square"\nsource = "enc"\npulses_per_rev = 4\ncam = "cam"\n'
    )
    recorded(tmp_path / "good.h5", acc=np.arange(10.0), enc=np.arange(10.0), **columns)
    (fault,) = check_folder(tmp_path, settings=limits)
    assert words in str(fault)
