"""``check`` lists every fault of a folder at once."""

import hashlib

import h5py
import numpy as np
import pytest

from crankorder.errors import InputError, RequestError
from crankorder.ingest.check import check_folder
from crankorder.ingest.draft import draft_manifests
from crankorder.ingest.formats import read_file
from crankorder.ingest.recording import recording_of
from crankorder.quantities import flags_of
from made.command import crankorder, findings_in
from made.recordings import manifest, write_hdf5, write_manifest

MANIFEST = manifest(
    channels={"Z": {"source": "acc"}},
    recordings={"files": ["*.h5", "absent.h5"], "speed_rpm": {"good.h6": 1000}},
    sampling={"rate_hz": 1000},
)


REFUSED = {
    "test.engine: no such engine; found none; allowed: ": MANIFEST.replace("cycle", 'engine = "none"\ncycle'),
    "e.toml: ": MANIFEST.replace("cycle", 'engine = "e.toml"\ncycle'),
    "recordings.files.0: files outside the folder of the test are not read; found '../": MANIFEST.replace(
        "*.h5", "../*"
    ),
}


def test_a_manifest_that_names_what_is_not_there_is_refused_by_check_and_run_before_anything_is_read(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "e.toml").write_text("x = 1\n")
    recorded(folder / "a.h5", acc=np.arange(10.0))
    for said, text in REFUSED.items():
        (folder / "run.toml").write_text(text)
        for command in (["check"], ["run", "--dry-run", "--out", tmp_path / "out"], ["run", "--out", tmp_path / "out"]):
            outcome = crankorder(*command, folder)
            assert outcome.exit_code == 2 and said in outcome.output and not (tmp_path / "out").exists()


def recorded(path, *, rate=1000.0, unit="m/s2", **columns):
    write_hdf5(path, columns, unit=unit, rate_hz=rate)


def test_every_fault_of_a_folder_is_listed_at_once(tmp_path, limits):
    (tmp_path / "run.toml").write_text(MANIFEST)
    recorded(tmp_path / "good.h5", acc=np.arange(10.0))
    recorded(tmp_path / "rate.h5", acc=np.arange(10.0), rate=1024.0)
    recorded(tmp_path / "channel.h5", a1=np.arange(10.0))
    recorded(tmp_path / "unit.h5", acc=np.arange(10.0), unit="Pa")
    (tmp_path / "text.h5").write_text("1,2\n3,4\n")
    (tmp_path / "link.h5").symlink_to("/dev/null")
    before = sorted((path.name, path.stat().st_mtime_ns, path.read_bytes()) for path in tmp_path.iterdir())
    text = "\n".join(str(fault) for fault in check_folder(tmp_path, settings=limits))
    for words in (
        "absent.h5: no such file", "link.h5: outside the run folder",
        "recordings.speed_rpm.good.h6: a speed is stated for no recording. Did you mean 'good.h5'?",
        "rate.h5: the sampling rate is 1024 Hz in the file, 1000 Hz in the manifest",
        "channel.h5: channel acc not in file; has a1",
        "unit.h5: source acc: channel Z: Pa (pressure) cannot become m/s2 (acceleration)",
        "text.h5: is text, though its name ends in .h5", "encoder.kind: nothing tells the speed",
    ):  # fmt: skip
        assert words in text
    assert len(text.split("\n")) == 8
    assert before == sorted((path.name, path.stat().st_mtime_ns, path.read_bytes()) for path in tmp_path.iterdir())


def test_a_wrong_manifest_is_all_that_is_checked(tmp_path, limits):
    (tmp_path / "run.toml").write_text(MANIFEST.replace("rate_hz", "rat_hz").replace('"m/s2"', '"G"'))
    faults = [str(fault) for fault in check_folder(tmp_path, settings=limits)]
    assert len(faults) == 2
    assert "Did you mean 'rate_hz'?" in faults[0] + faults[1]
    assert isinstance(check_folder(tmp_path / "absent", settings=limits)[0], RequestError)


@pytest.mark.slow
def test_a_cam_mark_of_another_length_is_found_without_reading(tmp_path, limits):
    encoder = {"kind": "square", "source": "enc", "pulses_per_rev": 4, "cam": "cam"}
    write_manifest(tmp_path, "*.h5", cycle="four-stroke", channels={"Z": {"source": "acc"}}, encoder=encoder)
    recorded(tmp_path / "good.h5", acc=np.arange(10.0), enc=np.arange(10.0), cam=np.arange(9.0))
    (fault,) = check_folder(tmp_path, settings=limits)
    assert "lengths differ: Z has 10 samples, the cam mark has 9" in str(fault)


# What a file contradicts is told and never resolved in silence: rates, scales, counts, lists of checksums.


N = 5000
TONE = np.round(1000.0 * np.sin(np.arange(N) / 7.0))


def stored(path, values, file_attrs=None, **attrs):
    with h5py.File(path, "w") as file:
        file.attrs.update(file_attrs or {})
        file.create_dataset("a", data=values).attrs.update(attrs)
    return path


def test_rates_of_two_places_that_differ_are_told(tmp_path, limits):
    rows = [
        ({"wf_increment": 1 / 51_200.0}, {"fs": 50_000.0}, 50_000.0, True),
        ({"rate_hz": 50_000.0}, {"dt": 2e-5}, 50_000.0, False), ({"SampleRate": "51.2 kHz"}, {}, 51_200.0, False),
        ({"SampleRate": "51.2 kHz"}, {"fs": 50_000.0}, 50_000.0, True), ({"dt": b"20 us"}, {}, 50_000.0, False),
        ({"rate_hz": "unknown"}, {}, None, False),
    ]  # fmt: skip
    for of_file, of_data, rate_hz, told in rows:
        raw = read_file(stored(tmp_path / "a.h5", TONE, of_file, **of_data), sources=["a"], settings=limits)
        assert raw.rates_hz.get("a") == (None if rate_hz is None else pytest.approx(rate_hz))
        assert [flag["flag"] for flag in raw.flags] == ["header_rate_disagrees"] * told
        if told:
            assert "51200 Hz" in raw.flags[0]["detail"] and "50000 Hz" in raw.flags[0]["detail"]


def test_a_scale_as_text_is_taken_and_told(tmp_path, limits):
    rows = [
        (TONE.astype("i2"), {"scale_factor": "0.5", "add_offset": b"3"}, {"a": 0.5 * TONE + 3.0}, 2),
        (np.column_stack([TONE, TONE]), {"scale_factor": [1.0, 3.0]}, {"a[1]": 3.0 * TONE, "a[0]": TONE}, 1),
    ]
    for values, attrs, columns, n_flags in rows:
        raw = read_file(stored(tmp_path / "a.h5", values, **attrs), sources=list(columns), settings=limits)
        for name, wanted in columns.items():
            np.testing.assert_allclose(raw.columns[name], wanted)
        assert [flag["flag"] for flag in raw.flags] == ["scale_unusual"] * n_flags
        assert n_flags == 1 or "text" in raw.flags[0]["detail"]


def test_a_scale_that_is_no_number_is_refused(tmp_path, limits):
    for scale in ["about 2", [1.0, 2.0], [[1.0], [2.0]], np.nan, "1,5", b"\xff"]:
        path = stored(tmp_path / "a.h5", TONE, scale_factor=scale)
        with pytest.raises(InputError, match=r"a\.h5: /a: its scale_factor is not a number"):
            read_file(path, sources=["a"], settings=limits)


MANIFEST_TOLD = '[sampling]\nrate_hz = 1000.0\n[[channels]]\nname = "a"\nunit = "{unit}"\n{more}'


def test_whole_numbers_without_a_unit_are_asked_about(tmp_path, manifest_of, settings):
    stored(tmp_path / "a.h5", TONE.astype("i2"), fs=1000.0)
    assert 'unit = "counts"                   # ? whole numbers without a unit' in draft_manifests(tmp_path).text
    rows = [
        (TONE.astype("i2"), {}, "m/s2", "", True), (TONE, {}, "g", "", True),
        (TONE.astype("i2"), {}, "counts", "", False), (TONE.astype("i2"), {"units": "m/s2"}, "m/s2", "", False),
        (TONE.astype("i2"), {"scale_factor": 0.01}, "m/s2", "", False),
        (TONE.astype("i2"), {"units": "mV"}, "m/s2", 'sensitivity = "100 mV/g"', False),
        (0.37 * TONE, {}, "m/s2", "", False), (np.sign(TONE), {}, "m/s2", "", False),
    ]  # fmt: skip
    for values, attrs, unit, more, told in rows:
        path = stored(tmp_path / "a.h5", values, **attrs)
        manifest = manifest_of(MANIFEST_TOLD.format(unit=unit, more=more), head=_HEAD)
        raw = read_file(path, sources=["a"], settings=settings.ingest)
        recording = recording_of(raw, path, manifest, settings=settings.ingest, shaft=settings.shaft)
        assert ("counts_without_unit" in [flag["flag"] for flag in flags_of(recording)]) == told


_HEAD = 'schema_version = 1\n[test]\ncycle = "none"\n[recordings]\nfiles = ["*"]\n'


@pytest.fixture
def campaign(tmp_path):
    folder = tmp_path / "bag" / "data"
    folder.mkdir(parents=True)
    for number, name in enumerate(("a.h5", "b.h5", "c d.h5")):
        stored(folder / name, np.random.default_rng(number).standard_normal(N), fs=1000.0)
    tables = MANIFEST_TOLD.format(unit="m/s2", more="").replace("rate_hz = 1000.0", "")
    (folder / "run.toml").write_text(_HEAD.replace('"*"', '"*.h5"') + tables, encoding="utf-8")
    return folder


def listed(folder, style, kind="sha256"):
    """A list of the recordings of ``folder`` as programs write it; all but "each" name files that are none, too."""
    digests = {path.name: hashlib.new(kind, path.read_bytes()).hexdigest() for path in sorted(folder.glob("*.h5"))}
    if style == "each":
        for name, digest in digests.items():
            (folder / f"{name}.{kind}").write_text(digest + "\n")
        return
    digests |= dict.fromkeys(("../secret.h5", "/etc/passwd", "notes.pdf", "x/y.h5"), len(digests["a.h5"]) * "0")
    place, line = {
        "bag": (folder.parent / f"manifest-{kind}.txt", "{digest}  data/{name}\n"),
        "sums": (folder / f"{kind.upper()}SUMS", "{digest} *{name}\r\n"),
        "tagged": (folder / f"manifest-{kind}.txt", kind.upper() + " ({name}) = {digest}\n"),
    }[style]
    if style == "bag":
        (folder.parent / "bagit.txt").write_text("BagIt-Version: 1.0\nTag-File-Character-Encoding: UTF-8\n")
    lines = [line.format(name=name, digest=digest) for name, digest in digests.items()]
    place.write_text("# made by hand\n" * (style == "tagged") + "".join(lines))


@pytest.mark.parametrize("style", ["bag", "sums", "tagged", "each"])
@pytest.mark.parametrize("kind", ["sha256", "md5", "sha512"])
def test_a_list_of_checksums_tells_what_is_altered_and_what_is_missing(campaign, settings, style, kind):
    listed(campaign, style, kind)
    assert check_folder(campaign, settings=settings.ingest) == []
    data = bytearray((campaign / "b.h5").read_bytes())
    data[-9] ^= 1
    (campaign / "b.h5").write_bytes(data)
    (campaign / "c d.h5").unlink()
    altered, missing = check_folder(campaign, settings=settings.ingest)
    assert altered.file == str(campaign / "b.h5") and f"its {kind.upper()} differs from" in str(altered)
    assert missing.file == str(campaign / "c d.h5") and "is listed in" in str(missing)


def test_a_list_that_holds_no_checksums_is_a_fault_of_its_own(campaign, settings):
    for text in [b"hello", b"12345  a.h5", 70 * b"0" + b"  a.h5", b"\0\0", b"\xff\xfe"]:
        (campaign / "SHA256SUMS").write_bytes(text)
        (fault,) = check_folder(campaign, settings=settings.ingest)
        assert "SHA256SUMS: line 1: is no sha256 checksum" in str(fault)


@pytest.mark.slow
def test_a_run_leaves_out_what_a_list_says_is_altered(campaign, tmp_path):
    listed(campaign, "sums")
    stored(campaign / "b.h5", np.random.default_rng(9).standard_normal(N), fs=1000.0)
    outcome = crankorder("run", campaign, "--out", tmp_path / "out", "-q", "--no-pictures")
    assert outcome.exit_code == 3 and "b.h5: its SHA256 differs from SHA256SUMS" in outcome.stderr
    quality = findings_in(tmp_path / "out")["quality"]
    assert [one["recording"] for one in quality if "SHA256 differs" in one["detail"]] == ["b.h5"]
    checked = crankorder("check", campaign)
    assert checked.exit_code == 3 and "b.h5: its SHA256 differs" in checked.stderr
