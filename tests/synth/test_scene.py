"""Scenes: what is shipped loads, what is wrong is told all at once."""

import json
import tomllib

import h5py
import numpy as np
import pytest

from crankorder.engine.definition import load_engine
from crankorder.errors import EnvironmentFailure, ManyErrors, RequestError
from crankorder.settings import shipped
from crankorder.synth import write
from crankorder.synth.load import load_scene
from crankorder.synth.write import toml_text, write_scene
from synth.conftest import EFFECTS, SMALL


def faults_of(path, text):
    path.write_text(text)
    with pytest.raises(ManyErrors) as caught:
        load_scene(path.name, path.parent)
    return [str(fault) for fault in caught.value.faults]


@pytest.mark.parametrize("name", list(shipped("scenes")))
def test_every_shipped_scene_loads_with_its_first_look(name):
    scene = load_scene(name)
    quick = scene.first_look()
    assert len({run.name for run in scene.runs}) == len(scene.runs)
    assert quick.n_samples * len(quick.runs) < scene.n_samples * len(scene.runs)


def test_all_faults_of_the_tables_are_told_at_once_and_then_all_that_does_not_go_together(small_scene):
    text = small_scene.read_text()
    form = text.replace("damping_ratio = 0.02", "damping_ratio = 1.5").replace("rate_hz = 8000.0", "rate_hz = nan")
    for old, new in (
        ("600.0, 612.5, 600.0", "600.0, 5000.0, 60000.0"), ("Z = 0.012", "Q = 0.012"), ('"BPFO"', '"N*fs"'),
        ("order = 6.5", "order = 650.0"), ("230.0", "4100.0"), ('"jack shaft"', '"moon shaft"'),
    ):  # fmt: skip
        text = text.replace(old, new, 1)
    for spoilt, told in (
        (form + "\n[wobble]\nsize = 1.0\n", (
            "modes.0.damping_ratio: Input should be less than 1; found 1.5", "sampling.time.rate_hz",
            "wobble: unknown effect; allowed: speeds, speed_profile, repeats",
        )),
        (text, (
            "modes.1.sensor_per_kg: no such channel; found Q; allowed: Y, Z",
            "no such bearing; found moon shaft; allowed: jack shaft, distributor shaft",
            "speeds that the rate cannot carry; found 5000, 60000 rpm; allowed: at most 4000 rpm",
            "injected_orders.0.order: order above Nyquist; found 650", "engine_forces: order above Nyquist",
            "modes.1.frequency_hz: natural frequency above Nyquist; found 4100; allowed: below half the rate",
        )),
    ):  # fmt: skip
        faults = faults_of(small_scene, spoilt)
        assert [words for words in told if not any(words in fault for fault in faults)] == []
        assert len(faults) == len(told)


def test_a_scene_that_is_not_there_is_named(tmp_path):
    with pytest.raises(RequestError, match="no such scene; found moon; allowed: bearing-growth"):
        load_scene("moon", tmp_path)


def test_a_scene_based_on_another_has_all_but_what_it_states_and_leaves_out(small_scene):
    derived = small_scene.with_name("derived.toml")
    text = 'schema_version = 1\nbased_on = "small.toml"\nwithout = ["encoder"]\ntitle = "derived"\n'
    derived.write_text(text + "[speeds]\nlist_rpm = [900.0]\n")
    base, scene = (load_scene(path.name, path.parent) for path in (small_scene, derived))
    assert (scene.title, scene.speeds.rpm, scene.encoder) == ("derived", (900.0,), None)
    assert (scene.modes, scene.seed) == (base.modes, base.seed)
    for old, new, words in (
        ('"encoder"', '"encodr"', "nothing to leave out; found encodr"),
        ('"small.toml"', "3", "no scene to be based on"),
        ('"small.toml"', '"derived.toml"', "no scene to be based on"),
        ('based_on = "small.toml"\n', "", "without goes with based_on"),
    ):  # fmt: skip
        derived.write_text(text.replace(old, new))
        with pytest.raises((ManyErrors, RequestError), match=words):
            load_scene(derived.name, derived.parent)


SPEEDS = "[speeds]\nlist_rpm = [600.0, 612.5, 600.0]\n"
BPFI = '[[bearing_impacts]]\nbearing = "jack shaft"\nline = "BPFI"\npeak_m_s2 = {{ Y = 1.0 }}\n{}\n'
DROPOUT = '[[signal_faults]]\nkind = "dropout"\nduration_s = 0.1\n{}\n'
PUMP = '[[other_shafts]]\nname = "pump"\nratio = 2.0\n'
TONE = '[[tones]]\ncause = "mains"\nfrequency_hz = 3000.0\namplitude_m_s2 = { Z = 0.2 }\nharmonics = [1.0, 1.0]\n'
PROFILE = "[speed_profile]\nrpm = [{}]\ntime_s = [{}]\n"
FALLS = EFFECTS["injected_orders"] + "speed_exponent = -1.0\n"
GROWS = "resonance_hz = 900.0\ndamping_ratio = 0.1\ngrowth = 10.0"
FIRING = '"msu-optical-second-firing"'
IMPOSSIBLE = [
    # what is written in place of what, and what is told of it
    ({"rate_hz = 8000.0": "rate_hz = nan"}, "sampling.time.rate_hz"),
    ({'"msu-optical-second"': '"no-such"'}, "no such engine"), ({"duration_s = 3.0": "duration_s = 1e9"}, "too long"),
    ({'"acc_z"': '"acc_y"'}, "same source"), ({'"acc_z"': '"encoder"'}, "the encoder's dataset"),
    ({'"acc_z"': '"../z"'}, "channels.1.source"), ({'domain = "time"': 'domain = "order"'}, "sampling"),
    ({"drive = { Y = 0.9, Z = 0.2 }": "drive = { W = 0.9 }"}, "modes.1.drive"),
    ({'title = "small"': 'title = "small"\nengine_file = "x"'}, "engine_file: unknown key"),
    ({SPEEDS: "[speeds]\nfirst_rpm = 300.0\n"}, "give either list_rpm"),
    ({SPEEDS: "[speeds]\nlist_rpm = []\n"}, "1 to 10 000 speeds"),
    ({SPEEDS: "[speeds]\nfirst_rpm = 1e-9\nlast_rpm = 600.0\nstep_rpm = 1e-29\n"}, "1 to 10 000 speeds"),
    ({SPEEDS: "[speeds]\nlist_rpm = [1e300]\n"}, "speeds.list_rpm.0: out of all proportion"),
    ({SPEEDS: PROFILE.format("600.0, 700.0, 800.0", "0.0, 1.0, 1.000001")}, "no such speed profile"),
    # beside what stands there
    ("[gas_torque]\nhighest_order = 8.0\n", "gas_torque: the engine has no gas"),
    (EFFECTS["bearing_lines"].replace("BPFO", "cage"), "bearing_lines.0.line"),
    (BPFI.format("resonance_hz = 9000.0\ndamping_ratio = 0.1"), "resonance above Nyquist; found 9000"),
    (BPFI.format("resonance_hz = 1500.0\ndamping_ratio = 1e-9"), "it rings on too long"),
    (BPFI.format("resonance_hz = 900.0\ndamping_ratio = 0.1").replace("Y", "Q"), "no such channel; found Q"),
    (TONE, "tones.0: tone above Nyquist; found 6000 Hz"),
    ('[encoder]\npulses_per_rev = 60\n[[encoder_faults]]\nkind = "damaged_line"\nlines = [60]\n', "allowed: 0 to 59"),
    ("[encoder]\npulses_per_rev = 60\nratio = 7.0\n", "speeds that the rate cannot carry"),
    (DROPOUT.format('at_s = 0.1\nchannels = ["W"]'), "signal_faults.0.channels: no such channel; found W"),
    (DROPOUT.format('at_s = 0.1\nrecordings = ["rpm_9"]'), "recordings: no such recording; found rpm_9"),
    (DROPOUT.format("at_s = 5.0"), "signal_faults.0.at_s: begins after the end"),
    ("[acquisition]\nlow_pass_hz = 10.0\nac_coupling_hz = 20.0\n", "acquisition.ac_coupling_hz"),
    ("[acquisition]\nfull_scale = 1e-320\n", "acquisition.full_scale: out of all proportion"),
    ("[acquisition]\ndelay_s = { Y = 1e9 }\n", "acquisition.delay_s: a channel is later than the recording is long"),
    (f'{EFFECTS["injected_orders"]}shaft = "fan"\n{PUMP}', "injected_orders.0.shaft: no such shaft; found fan"),
    (PUMP + PUMP, "other_shafts: two shafts have the same name; found pump"),
    ('[wrong_labels]\nswapped = ["Y", "V"]\n', "wrong_labels.swapped: no such channel; found V"),
    ('[wrong_labels]\nswapped = ["Y", "Y"]\n', "swapped with itself"),
    ("[wrong_labels]\npulses_per_rev = 7\n", "there is no encoder to be labelled"),
    ("[speed_wander]\ncorner_hz = 5000.0\nstd_rpm = 0.2\n", "changes above Nyquist"),
    (
        {"600.0, 612.5, 600.0": "600.0", "[[channels]]": (
            "[in_cycle_speed]\nby_order = [{ order = 0.333, percent = 1 }, { order = 0.5, percent = 1 }]\n[[channels]]"
        )}, "in_cycle_speed: orders of the in-cycle speed have no common cycle",
    ),
    (
        {SPEEDS: PROFILE.format("600.0, -900.0", "0.0, 1.0"), "[[channels]]": FALLS + "[[channels]]"},
        "injected_orders.0.speed_exponent: a force that falls",
    ),
    (
        {"seed = 7": "seed = 7\nrepeats = 100", "[[channels]]": BPFI.format(GROWS) + "[[channels]]"},
        "out of all proportion",
    ),
    (
        {SPEEDS: "[speeds]\nlist_rpm = [2000.0, 60.0]\n", '"msu-optical-second"': FIRING, "[[channels]]": (
            "[gas_torque]\nhighest_order = 8.0\n[in_cycle_speed]\nflywheel_inertia_kg_m2 = 0.3\n[[channels]]"
        )}, "in_cycle_speed: the shaft would stop",
    ),
]  # fmt: skip


@pytest.mark.cases(len(IMPOSSIBLE))
@pytest.mark.parametrize(("change", "words"), IMPOSSIBLE)
def test_what_cannot_be_made_gets_one_clear_error_before_anything_is_written(tmp_path, change, words):
    text = SMALL.replace("[quick]\nspeeds = { list_rpm = [600.0] }\nduration_s = 0.5\n", "")
    if isinstance(change, str):
        text += change
    else:
        for old, new in change.items():
            assert old in text
            text = text.replace(old, new, 1)
    (fault,) = faults_of(tmp_path / "scene.toml", text)
    assert words in fault
    assert "scene.toml" in fault or "no-such" in fault


# The folder on disk: what it holds, that it is the same again, and what it must not overwrite.


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_a_scene_becomes_an_ordinary_test_run_folder(small_scene, tmp_path):
    seen: list[tuple[int, int]] = []
    write_scene(small_scene.name, tmp_path / "run", beside=small_scene.parent, progress=lambda *done: seen.append(done))
    assert set(contents(tmp_path / "run")) == {
        "run.toml", "truth.json", "rpm_0600.h5", "rpm_0600_2.h5", "rpm_0612.5.h5"
    }  # fmt: skip
    assert seen == [(1, 3), (2, 3), (3, 3)]
    with h5py.File(tmp_path / "run" / "rpm_0612.5.h5") as file:
        assert {name: data.dtype.str for name, data in file.items()} == {
            "acc_y": "<f4", "acc_z": "<f4", "encoder": "<f4", "index": "|u1"
        }  # fmt: skip
        assert all(data.shape == (24_000,) and data.chunks is None for data in file.values())
        assert dict(file.attrs) == {"rate_hz": 8000.0, "speed_rpm": 612.5}
        assert dict(file["acc_z"].attrs) == {"rate_hz": 8000.0, "unit": "m/s2"}
        assert np.isfinite(file["acc_z"][()]).all()
    scene = load_scene(small_scene.name, small_scene.parent)
    assert json.loads((tmp_path / "run" / "truth.json").read_text()) == json.loads(json.dumps(write.truth_of(scene)))


def test_crank_angle_files_need_no_encoder(tmp_path):
    write_scene("thesis-first-motoring", tmp_path / "run", quick=True)
    manifest = tomllib.loads((tmp_path / "run" / "run.toml").read_text())
    assert manifest["sampling"] == {"domain": "crank_angle", "samples_per_rev": 360, "start_deg": 0.0}
    assert manifest["recordings"]["speed_rpm"] == {f"rpm_{rpm:04}.h5": rpm for rpm in (800, 1000, 1500, 2000)}
    assert "encoder" not in manifest
    with h5py.File(tmp_path / "run" / "rpm_0800.h5") as file:
        assert set(file) == {"acc_x", "acc_y", "acc_z"}
        assert dict(file.attrs) == {"samples_per_rev": 360, "start_deg": 0.0, "speed_rpm": 800.0}


def test_the_reference_truth_has_the_crossings_of_the_truth_sheet():
    crossings = write.truth_of(load_scene("thesis-second-motoring"))["crossings"]
    inside = {(record["order"], record["mode_hz"]): record["rpm"] for record in crossings if record["in_range"]}
    assert inside[4.0, 115.0] == inside[8.0, 230.0] == 1725
    all_hz = [60, 115, 172, 187, 230]
    for order, met_hz in {1: [], 2: [60], 3: [60], 4: all_hz[:2], 5.5: all_hz[:3], 8: all_hz, 10: all_hz}.items():
        assert [hz for by, hz in inside if by == order] == met_hz


def test_the_same_scene_gives_the_same_bytes_on_any_number_of_workers_and_is_replaced_whole(
    small_scene, tmp_path, monkeypatch
):
    write_scene(small_scene.name, tmp_path / "one", beside=small_scene.parent)
    monkeypatch.setattr(write, "MAX_WORKERS", 1)
    write_scene(small_scene.name, tmp_path / "two", beside=small_scene.parent)
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    (tmp_path / "two" / "notes.txt").write_text("mine")
    write_scene(small_scene.name, tmp_path / "two", beside=small_scene.parent, quick=True)
    assert set(contents(tmp_path / "two")) == {"run.toml", "truth.json", "rpm_0600.h5", "notes.txt"}


def test_a_folder_with_other_content_is_left_alone(small_scene, tmp_path):
    (tmp_path / "rpm_0600.h5").write_bytes(b"measured")
    for truth in ("", "{}", '{"scene": {}, "recordings": "x"}', "[1]", "not json"):
        if truth:
            (tmp_path / "truth.json").write_text(truth)
        before = contents(tmp_path)
        with pytest.raises(RequestError, match="was not written by a scene"):
            write_scene(small_scene.name, tmp_path, beside=small_scene.parent)
        assert contents(tmp_path) == before


def test_a_forged_truth_deletes_nothing_but_recordings_of_the_folder(small_scene, tmp_path):
    folder, outside = tmp_path / "run", tmp_path / "rpm_1.h5"
    folder.mkdir()
    outside.write_bytes(b"mine")
    (folder / "precious.h5").write_bytes(b"mine")
    names = [{"name": name} for name in ("../rpm_1.h5", "precious.h5", str(outside))]
    (folder / "truth.json").write_text(json.dumps({"scene": {}, "recordings": names}))
    write_scene(small_scene.name, folder, beside=small_scene.parent, quick=True)
    assert outside.read_bytes() == (folder / "precious.h5").read_bytes() == b"mine"


def test_a_bad_scene_and_a_file_for_a_folder_write_nothing(small_scene, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(RequestError, match="not a folder"):
        write_scene(small_scene.name, tmp_path / "file", beside=small_scene.parent)
    small_scene.write_text(small_scene.read_text() + "[wobble]\n")
    with pytest.raises(ManyErrors, match="unknown effect"):
        write_scene(small_scene.name, tmp_path / "new", beside=small_scene.parent)
    assert not (tmp_path / "new").exists()


def test_a_write_that_is_cut_off_leaves_no_manifest_and_can_be_repeated(small_scene, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    write_scene(small_scene.name, folder, beside=small_scene.parent)
    whole = contents(folder)
    publish = write._publish

    def full_disk(path, fill):
        if path.name == "rpm_0612.5.h5":
            raise OSError(28, "No space left on device", str(path))
        publish(path, fill)

    monkeypatch.setattr(write, "_publish", full_disk)
    with pytest.raises(EnvironmentFailure, match="No space left") as caught:
        write_scene(small_scene.name, folder, beside=small_scene.parent)
    assert caught.value.exit_status == 5
    assert "run.toml" not in contents(folder)
    monkeypatch.setattr(write, "_publish", publish)
    write_scene(small_scene.name, folder, beside=small_scene.parent)
    assert contents(folder) == whole


def test_a_users_engine_travels_with_the_folder(small_scene, tmp_path):
    (small_scene.parent / "mine.toml").write_text(
        "crank_radius_m = 0.05\nrod_length_m = 0.2\nreciprocating_mass_kg = 1.0\n"
        '[shafts]\norders = [1]\n[[bearings]]\nname = "jack shaft"\nrolling_elements = 9\nball_over_pitch = 0.25\n'
    )
    small_scene.write_text(small_scene.read_text().replace('"msu-optical-second"', '"mine.toml"'))
    write_scene(small_scene.name, tmp_path / "run", beside=small_scene.parent, quick=True)
    manifest = tomllib.loads((tmp_path / "run" / "run.toml").read_text())
    assert load_engine(manifest["test"]["engine"], tmp_path / "run") == load_engine("mine.toml", small_scene.parent)


def test_written_toml_reads_back():
    table = {
        "text": 'a "quoted"\\ line\nwith \x7f, \x00 and µ', "odd key.h5": {"in it": {"e": "µ"}},
        "numbers": [1, 2.5, -1e-300, True],
        "inner": {"deep": {"x": 1.0}, "many": [{"y": 1, "z": {"w": "v"}}, {"y": 2}]}, "list": [{"a": []}],
    }  # fmt: skip
    assert tomllib.loads(toml_text(table)) == table


def test_repeats_that_a_scene_no_longer_has_go_with_the_former_ones(small_scene, tmp_path):
    text = small_scene.read_text()
    for repeats in (3, 2):
        small_scene.write_text(text.replace("seed = 7\n", f"seed = 7\nrepeats = {repeats}\n"))
        written = write_scene(small_scene.name, tmp_path / "runs", quick=True, beside=small_scene.parent)
        assert [path.name for path in written] == [f"run_{k + 1}" for k in range(repeats)]
        assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == [path.name for path in written]
    (tmp_path / "runs" / "run_1" / "notes.txt").write_text("mine")
    (tmp_path / "runs" / "mine.txt").write_text("mine")
    with pytest.raises(RequestError, match=r"found mine\.txt"):
        write_scene(small_scene.name, tmp_path / "runs", quick=True, beside=small_scene.parent)
