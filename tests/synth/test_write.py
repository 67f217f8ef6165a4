"""The folder on disk: what it holds, that it is the same again, and what it must not overwrite."""

import json
import tomllib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from crankorder.engine.definition import load_engine
from crankorder.errors import EnvironmentFailure, ManyErrors, RequestError
from crankorder.synth import write
from crankorder.synth.load import load_scene
from crankorder.synth.write import toml_text, write_scene


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_a_scene_becomes_an_ordinary_test_run_folder(small_scene: Path, tmp_path: Path) -> None:
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


@pytest.mark.slow
def test_crank_angle_files_need_no_encoder(tmp_path: Path) -> None:
    write_scene("thesis-first-motoring", tmp_path / "run", quick=True)
    manifest = tomllib.loads((tmp_path / "run" / "run.toml").read_text())
    assert manifest["sampling"] == {"domain": "crank_angle", "samples_per_rev": 360, "start_deg": 0.0}
    assert manifest["recordings"]["speed_rpm"] == {f"rpm_{rpm:04}.h5": rpm for rpm in (800, 1000, 1500, 2000)}
    assert "encoder" not in manifest
    with h5py.File(tmp_path / "run" / "rpm_0800.h5") as file:
        assert set(file) == {"acc_x", "acc_y", "acc_z"}
        assert dict(file.attrs) == {"samples_per_rev": 360, "start_deg": 0.0, "speed_rpm": 800.0}


def test_the_truth_tells_what_was_put_in(tmp_path: Path) -> None:
    write_scene("thesis-first-motoring", tmp_path / "run", quick=True)
    truth = json.loads((tmp_path / "run" / "truth.json").read_text())
    with h5py.File(tmp_path / "run" / "rpm_2000.h5") as file:
        turns = np.arange(50 * 360) / 360
        measured = {o: 2 * np.mean(file["acc_z"][()] * np.exp(-2j * np.pi * o * turns)) for o in (1.0, 2.0, 5.5)}
    lines = {record["order"]: record for record in truth["orders"] if record["channel"] == "Z"}
    for order, found in measured.items():
        record, last = lines[order], truth["recordings"].index({"name": "rpm_2000.h5", "speed_rpm": 2000.0})
        noise = 5 * record["floor_density_by_speed"][last] / np.sqrt(50 * 60 / 2000)
        put_in = record["amplitude_by_speed"][last] * np.exp(1j * np.radians(record["phase_deg_by_speed"][last]))
        assert abs(found - put_in) < noise
        assert order != 2 or 5 * noise < abs(put_in)
    assert [mode["frequency_hz"] for mode in truth["modes"]] == [60, 115, 172, 187, 230, 350, 457, 470]
    assert truth["balance"]["residual_reciprocating_g"] == pytest.approx(534)


@pytest.mark.slow
def test_the_reference_truth_has_the_crossings_of_the_truth_sheet(tmp_path: Path) -> None:
    scene = load_scene("thesis-second-motoring")
    crossings = write.truth_of(scene)["crossings"]
    inside = {(record["order"], record["mode_hz"]): record["rpm"] for record in crossings if record["in_range"]}
    assert inside[4.0, 115.0] == inside[8.0, 230.0] == 1725
    per_order = {order: [hz for o, hz in inside if o == order] for order in (1, 2, 3, 4, 5.5, 8, 10)}
    assert per_order == {
        1: [], 2: [60], 3: [60], 4: [60, 115], 5.5: [60, 115, 172],
        8: [60, 115, 172, 187, 230], 10: [60, 115, 172, 187, 230],
    }  # fmt: skip


def test_the_same_scene_gives_the_same_bytes_on_any_number_of_workers(
    small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_scene(small_scene.name, tmp_path / "one", beside=small_scene.parent)
    monkeypatch.setattr(write, "MAX_WORKERS", 1)
    write_scene(small_scene.name, tmp_path / "two", beside=small_scene.parent)
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


def test_a_former_scene_is_replaced_whole(small_scene: Path, tmp_path: Path) -> None:
    write_scene(small_scene.name, tmp_path / "run", beside=small_scene.parent)
    (tmp_path / "run" / "notes.txt").write_text("mine")
    write_scene(small_scene.name, tmp_path / "run", beside=small_scene.parent, quick=True)
    assert set(contents(tmp_path / "run")) == {"run.toml", "truth.json", "rpm_0600.h5", "notes.txt"}


@pytest.mark.cases(2)
@pytest.mark.parametrize("truth", [None, "{}", '{"scene": {}, "recordings": "x"}', "[1]", "not json"])
def test_a_folder_with_other_content_is_left_alone(small_scene: Path, tmp_path: Path, truth: str | None) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "rpm_0600.h5").write_bytes(b"measured")
    if truth is not None:
        (folder / "truth.json").write_text(truth)
    before = contents(folder)
    with pytest.raises(RequestError, match="was not written by a scene"):
        write_scene(small_scene.name, folder, beside=small_scene.parent)
    assert contents(folder) == before


def test_a_forged_truth_deletes_nothing_but_recordings_of_the_folder(small_scene: Path, tmp_path: Path) -> None:
    folder, outside = tmp_path / "run", tmp_path / "rpm_1.h5"
    folder.mkdir()
    outside.write_bytes(b"mine")
    (folder / "precious.h5").write_bytes(b"mine")
    names = [{"name": name} for name in ("../rpm_1.h5", "precious.h5", str(outside))]
    (folder / "truth.json").write_text(json.dumps({"scene": {}, "recordings": names}))
    write_scene(small_scene.name, folder, beside=small_scene.parent, quick=True)
    assert outside.read_bytes() == (folder / "precious.h5").read_bytes() == b"mine"


def test_a_bad_scene_and_a_file_for_a_folder_write_nothing(small_scene: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(RequestError, match="not a folder"):
        write_scene(small_scene.name, tmp_path / "file", beside=small_scene.parent)
    small_scene.write_text(small_scene.read_text() + "[wobble]\n")
    with pytest.raises(ManyErrors, match="unknown effect"):
        write_scene(small_scene.name, tmp_path / "new", beside=small_scene.parent)
    assert not (tmp_path / "new").exists()


def test_a_write_that_is_cut_off_leaves_no_manifest_and_can_be_repeated(
    small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "run"
    write_scene(small_scene.name, folder, beside=small_scene.parent)
    whole = contents(folder)
    publish = write._publish

    def full_disk(path: Path, fill: Any) -> None:
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


@pytest.mark.slow
def test_a_users_engine_travels_with_the_folder(small_scene: Path, tmp_path: Path) -> None:
    (small_scene.parent / "mine.toml").write_text(
        "crank_radius_m = 0.05\nrod_length_m = 0.2\nreciprocating_mass_kg = 1.0\n"
        '[shafts]\norders = [1]\n[[bearings]]\nname = "jack shaft"\nrolling_elements = 9\nball_over_pitch = 0.25\n'
    )
    small_scene.write_text(small_scene.read_text().replace('"msu-optical-second"', '"mine.toml"'))
    write_scene(small_scene.name, tmp_path / "run", beside=small_scene.parent, quick=True)
    manifest = tomllib.loads((tmp_path / "run" / "run.toml").read_text())
    assert load_engine(manifest["test"]["engine"], tmp_path / "run") == load_engine("mine.toml", small_scene.parent)


@pytest.mark.slow
def test_written_toml_reads_back() -> None:
    table = {
        "text": 'a "quoted"\\ line\nwith \x7f, \x00 and µ',
        "odd key.h5": {"in it": {"e": "µ"}},
        "numbers": [1, 2.5, -1e-300, True],
        "inner": {"deep": {"x": 1.0}, "many": [{"y": 1, "z": {"w": "v"}}, {"y": 2}]},
        "list": [{"a": []}],
    }
    assert tomllib.loads(toml_text(table)) == table


@pytest.mark.slow
def test_repeats_that_a_scene_no_longer_has_go_with_the_former_ones(small_scene: Path, tmp_path: Path) -> None:
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
