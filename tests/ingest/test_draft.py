"""``init`` drafts a manifest that reads, and asks for what the files do not say."""

from pathlib import Path

import numpy as np
import pytest

from crankorder.errors import NoUsableRecordingError, RequestError
from crankorder.ingest.check import check_folder
from crankorder.ingest.draft import draft_manifests, save_drafts, speed_in_name
from crankorder.ingest.folder import recordings_of
from crankorder.ingest.manifest import load_manifest
from crankorder.settings import load_settings
from made.recordings import write_hdf5, write_table


def test_a_draft_is_valid_whatever_the_names_are(tmp_path):
    odd = [*map(chr, (*range(1, 32), *range(0x7F, 0xA1), 0xAD, *range(0x2028, 0x202F), 0x2066, 0xFEFF, 0xE0001))]
    for number, name in enumerate(['a"b', "a\\b", "ünïcode 😀", "]] = 'q'", "\x1b[31m", *odd]):
        folder = tmp_path / (f"{number}{name}" if "/" not in name else "x")
        folder.mkdir()
        write_hdf5(folder / "a.h5", {f"a{name}": np.arange(10.0)}, rate_hz=1000.0)
        text, manifest = saved_draft(folder)
        assert manifest.channels[0].name == f"a{name}" and manifest.test.name == folder.name
        assert all(line.isprintable() for line in text.split("\n"))


def test_nothing_to_draft_from_says_what_was_found(tmp_path):
    with pytest.raises(NoUsableRecordingError, match=r"no recording found; looked for HDF5.*found an empty folder"):
        draft_manifests(tmp_path)
    (tmp_path / "a.tdms").write_bytes(b"TDSm\0\0")
    with pytest.raises(NoUsableRecordingError, match=r"a\.tdms: "):
        draft_manifests(tmp_path)
    with pytest.raises(RequestError, match="there is no such folder"):
        draft_manifests(tmp_path / "absent")


def drafted(folder, **columns):
    write_hdf5(folder / "a.h5", {"acc": np.zeros(80_000), **columns}, rate_hz=20_000.0)
    text, manifest = saved_draft(folder)
    return text, manifest.encoder


def wheel_trace(angles_deg, *, revs_per_s=15.0, width_deg=3.0):
    angle = 360.0 * (np.arange(80_000) / 20_000.0 * revs_per_s % 1.0)
    return sum(((angle - tooth) % 360.0 < width_deg).astype(float) for tooth in angles_deg)


LINES = wheel_trace([3.0 * tooth for tooth in range(120)], width_deg=1.5)
CAM = (np.arange(80_000) / 20_000.0 * 15.0 % 2.0 < 0.05).astype(float)
WHEELS = [
    ({"encoder": wheel_trace([6.0 * tooth for tooth in range(58)])},
     {"kind": "square", "pulses_per_rev": 60, "missing_teeth": 2}, "60-2 (58 pulses), seen in 100% of"),
    ({"crank": 5.0 * wheel_trace([*range(0, 170, 10), *range(180, 340, 10)]), "cam": CAM},
     {"pattern": "36-2-1", "cam": "cam"}, ""),
    ({"encoder": LINES, "index": wheel_trace([0.0])},
     {"pulses_per_rev": 120, "missing_teeth": 0, "index": "index"}, ""),
    ({"encoder": LINES}, {"pulses_per_rev": None}, "# pulses_per_rev = "),
]  # fmt: skip


@pytest.mark.parametrize(("columns", "wheel", "said"), WHEELS)
def test_a_draft_proposes_the_wheel_that_the_pulses_show(tmp_path, columns, wheel, said):
    text, encoder = drafted(tmp_path, **columns)
    assert {key: getattr(encoder, key) for key in wheel} == wheel and said in text


def test_a_draft_lists_the_angles_of_a_wheel_without_a_name(tmp_path):
    teeth = [0.0, 40.0, 60.0, 130.0, 150.0, 155.0, 210.0]
    _, encoder = drafted(tmp_path, encoder=wheel_trace(teeth))
    spans = np.sort(np.diff([*encoder.tooth_angles_deg, 360.0]))
    np.testing.assert_allclose(spans, np.sort(np.diff([*teeth, 360.0])), atol=0.5)


RATE_HZ, RPM, TEETH = 8000.0, 1500.0, 36
TIME_NAMES = {
    "time_s": 1.0, "Time (ms)": 1e-3, "t [s]": 1.0, "timestamp": 1.0, "Time": 1.0, "t_us": 1e-6, "Zeit [s]": 1.0,
}  # fmt: skip
SIGNAL_NAMES = {"Acc_Mount_Z (g)": "g", "a1 [m/s^2]": "m/s2", "Vib X (mm/s)": "mm/s", "p_cyl_bar": "bar"}


def saved_draft(folder):
    text = draft_manifests(folder).text
    (folder / "run.toml").write_text(text, encoding="utf-8")
    return text, load_manifest(folder)


@pytest.mark.cases(2)
@pytest.mark.parametrize("seed", range(12))
def test_a_table_with_pulses_of_any_names_and_order_is_read_as_drafted(tmp_path, read_in, seed):
    rng = np.random.default_rng(seed)
    time_s = np.arange(int(3.0 * RATE_HZ)) / RATE_HZ
    turns = RPM / 60.0 * time_s
    tooth = np.floor(turns * TEETH) % TEETH
    pulses = ((turns * TEETH % 1.0 < 0.5) & (tooth < TEETH - 1)).astype(float)  # 36-1
    time_name = str(rng.choice(list(TIME_NAMES)))
    signal_name = str(rng.choice(list(SIGNAL_NAMES)))
    encoder_name, index_name = rng.choice([("Ch7", "Ch8"), ("enc", "idx"), ("D0", "D1"), ("Tacho", "TDC_ref")])
    columns = {
        signal_name: rng.standard_normal(time_s.size),
        encoder_name: pulses,
        index_name: (turns % 1.0 < 0.02).astype(float),
    }
    table = {time_name: time_s / TIME_NAMES[time_name]} | {name: columns[name] for name in rng.permutation([*columns])}
    if seed % 2:  # a last row of zeros hides neither time nor wheel
        table = {name: np.append(column, 0.0) for name, column in table.items()}
    write_table(tmp_path / "run 1.csv", table)
    _, manifest = saved_draft(tmp_path)
    (channel,) = manifest.channels
    assert (channel.unit, channel.file_source) == (SIGNAL_NAMES[signal_name], signal_name)
    assert "(" not in channel.name and "[" not in channel.name
    assert (manifest.encoder.source, manifest.encoder.index) == (encoder_name, index_name)
    assert manifest.sampling.time_source == time_name
    recording = read_in(tmp_path / "run 1.csv")
    assert recording.attrs["rate_hz"] == pytest.approx(RATE_HZ, rel=1e-5)
    assert recording["pulse_time"].size == pytest.approx(RPM / 60.0 * 3.0 * (TEETH - 1), abs=3)


def test_a_speed_is_read_off_a_name_and_no_other_number_is():
    rows = [
        ("800rpm", 800), ("n1500_full load", 1500), ("rpm_300", 300), ("test 3 1250 rpm", 1250),
        ("idle_900U_min", 900), ("run 3", None), ("Fan_12", None), ("2024-11-03", None), ("speed=2400", 2400),
        ("1500.5rpm", 1500.5), ("run 3 450-1150 rpm 2024", None), ("up_600to3000rpm", None),
    ]  # fmt: skip
    for name, rpm in rows:
        assert speed_in_name(name) == rpm


def test_speeds_of_names_are_drafted_where_every_file_has_one(tmp_path):
    time_s = np.arange(2000) / 1000.0
    columns = {"Time (ms)": 1e3 * time_s, "acc (g)": np.sin(99.0 * time_s)}
    for name in ("800rpm.csv", "1200rpm.csv"):
        write_table(tmp_path / name, columns, separator=";")
    text, manifest = saved_draft(tmp_path)
    assert manifest.recordings.speed_rpm == {"800rpm.csv": 800.0, "1200rpm.csv": 1200.0}
    assert manifest.encoder.kind == "constant"
    assert text.count("from the name of the file") == 2
    write_table(tmp_path / "other.csv", columns, separator=";")
    _, manifest = saved_draft(tmp_path)
    assert (manifest.recordings.speed_rpm, manifest.encoder.kind, manifest.test.cycle) == ({}, "none", "none")


def test_two_rates_of_one_file_are_told_and_none_is_taken(tmp_path, settings):
    write_hdf5(tmp_path / "a.h5", {"acc": np.arange(100.0)}, fs=5000.0, dt=1e-3)
    with pytest.raises(NoUsableRecordingError, match=r"two sampling rates are stated; found fs: 5000 Hz, dt: 1000 Hz"):
        draft_manifests(tmp_path)


def test_a_list_of_edges_or_of_times_is_drafted_without_channels(tmp_path):
    write_table(tmp_path / "a.csv", {"crank_edge_time_s": np.cumsum(np.linspace(2.4e-3, 1.1e-3, 2000))})
    text = draft_manifests(tmp_path).text
    assert 'kind = "pulse_times"' in text and "[[channels]]" not in text
    for named in [True, False]:
        teeth_s = np.arange(0, 4, 1 / 720)[np.arange(2880) % 36 < 34]
        rows = [line for at in teeth_s for line in (f"{at:.7f},1", f"{at + 3e-4:.7f},0")]
        (tmp_path / "a.csv").write_text("\n".join((["Time [s],crank"] if named else []) + rows) + "\n")
        _, manifest = saved_draft(tmp_path)
        assert manifest.channels == ()
        assert manifest.encoder.kind == "edge_list"
        assert (manifest.encoder.pulses_per_rev, manifest.encoder.missing_teeth) == (36, 2)
        assert manifest.encoder.source == ("crank" if named else 1)


def test_a_temperature_is_left_out_and_an_unknown_unit_is_asked_for(tmp_path):
    time_s = np.arange(2000) / 1000.0
    columns = {"Time [s]": time_s, "acc [furlong]": np.sin(9 * time_s), "T_oil [°C]": time_s, "Force [N]": time_s}
    write_table(tmp_path / "a.csv", columns)
    text, manifest = saved_draft(tmp_path)
    assert [(one.name, one.unit) for one in manifest.channels] == [("acc", "1"), ("Force", "N")]
    assert "the file states the unit 'furlong', which is not known" in text
    assert '# column "T_oil [°C]" is left out' in text


def test_drafts_are_saved_into_each_folder_of_recordings_and_over_none(tmp_path):
    time_s = np.arange(2000) / 1000.0
    for name in ("build A", "build B"):
        (tmp_path / name).mkdir()
        write_table(tmp_path / name / "a.csv", {"Time [s]": time_s, "acc [g]": np.sin(time_s)})
    (tmp_path / "notes").mkdir()
    with pytest.raises(RequestError, match=r"in 2 folders of this one: build A, build B.*--save"):
        draft_manifests(tmp_path)
    written = [draft.path for draft in save_drafts(tmp_path).all]
    assert [path.parent.name for path in written] == ["build A", "build B"]
    written[0].write_text("mine")
    written[1].unlink()
    assert [draft.path for draft in save_drafts(tmp_path).all] == [written[1]]
    assert written[0].read_text() == "mine"
    with pytest.raises(RequestError, match="there is a manifest already"):
        save_drafts(tmp_path)


@pytest.mark.slow
def test_recordings_in_a_folder_beside_others_are_asked_about(tmp_path):
    for name in ("x.csv", "b/x.csv", "notes/read.me", "done/y.csv", "done/run.toml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write_table(tmp_path / name, {"time_s": 1e-3 * np.arange(64), "acc_g": np.sin(0.3 * np.arange(64))})
    [line] = [line for line in draft_manifests(tmp_path).text.splitlines() if line.startswith("files")]
    assert line.split("#")[0].strip() == 'files = ["*.csv"]'
    assert '# ? there are more in b: "*/*.csv" beside it takes them too' in line


@pytest.mark.cases(2)
@pytest.mark.parametrize("seed", range(8))
def test_recordings_that_differ_in_format_columns_units_or_wheel_have_drafts_of_their_own(tmp_path, seed):
    rng, groups = np.random.default_rng(seed), {}
    time_s = np.arange(24_000) / 8000.0
    for number, kind in enumerate(rng.permutation(["plain", "unit", "name", "wheel", "format"])[: 2 + seed % 4]):
        teeth = 24 if kind == "wheel" else 36
        pulses = (time_s * 20.0 * teeth % 1.0 < 0.5) & (np.floor(time_s * 20.0 * teeth) % teeth < teeth - 2)
        signal = "other [g]" if kind == "name" else f"acc [{'m/s2' if kind == 'unit' else 'g'}]"
        for run in range(int(rng.integers(1, 4))):
            path = tmp_path / "_".join(f"{number} {run}".split()[:: 1 - 2 * (seed % 2)])
            columns = {signal: rng.standard_normal(time_s.size), "crank": pulses.astype(float)}
            if kind == "format":
                path = write_hdf5(path.with_suffix(".h5"), columns, rate_hz=8000.0)
            else:
                path = write_table(path.with_suffix(".csv"), {"time [s]": time_s} | columns)
            groups.setdefault((kind, signal, teeth), []).append(path)
    (tmp_path / "broken.pdf").write_bytes(b"%PDF")
    write_table(tmp_path / "notes.txt", {"run": np.arange(3.0), "load": np.arange(3.0)})
    drafts = save_drafts(tmp_path)
    assert [Path(reason.split(": ")[0]).name for reason in drafts.passed] == ["broken.pdf", "notes.txt"]
    manifests = [load_manifest(tmp_path, draft.path) for draft in drafts.all]
    found = [recordings_of(tmp_path, manifest).paths for manifest in manifests]
    assert sorted(map(sorted, found)) == sorted(map(sorted, groups.values()))
    stated = {(manifest.channels[0].file_source, manifest.encoder.pulses_per_rev) for manifest in manifests}
    assert stated == {(signal, teeth) for _, signal, teeth in groups}
    for draft in drafts.all:
        assert check_folder(tmp_path, draft.path, settings=load_settings().ingest) == []
    assert len({manifest.test.name for manifest in manifests}) == len(groups)


def test_a_column_that_is_bound_to_its_place_is_asked_about_with_what_files_call_it(tmp_path):
    for name in "12":
        columns = {"time [s]": np.arange(900) / 1000.0, f"acc{name}": np.random.default_rng(0).standard_normal(900)}
        write_table(tmp_path / f"{name}.csv", columns)
    text, manifest = saved_draft(tmp_path)
    assert manifest.channels[0].source == 1
    assert '# ? column 1: "acc1" in 1.csv, "acc2" in 2.csv' in text
