"""Only the results that a recipe asks for are made, and what is missing breaks nothing."""

import json
import os
import signal

import h5netcdf
import jsonschema
import pytest

import crankorder.batch.execute as execute
from crankorder.errors import SchemaError
from crankorder.flow import StagePlan
from crankorder.quantities import (
    FrequencyFrames,
    LevelFrames,
    OrderFrames,
    RecordingEnvelope,
    RecordingLevels,
    RecordingTracks,
    schema_of,
)
from crankorder.settings import load_settings
from crankorder.stages import STAGES, frames_wanted
from made.command import crankorder, done


@pytest.fixture
def two_speeds(copied):
    return copied(1500, 1800)


def recipe(folder, *results):
    path = folder / "wanted.toml"
    path.write_text(f"[report]\nresults = {json.dumps(results)}\n")
    return path


def groups_in(out):
    with h5netcdf.File(next(out.glob("*/results.nc")), "r") as file:
        return set(file.groups)


def test_maps_alone_make_page_and_index_and_say_that_findings_were_not_asked_for(two_speeds, tmp_path):
    out = tmp_path / "out"
    outcome = done("run", two_speeds, "--out", out, "--recipe", "maps")
    assert "not asked for: the recipe wants order map, campbell map only" in outcome.output
    assert "above the noise" not in outcome.output
    assert groups_in(out) == {"order_map", "campbell_map", "shaft", "findings"}
    findings = json.loads(next(out.glob("*/findings.json")).read_bytes())
    assert list(jsonschema.Draft202012Validator(schema_of("findings")).iter_errors(findings)) == []
    assert findings["orders"] == []
    assert [channel["name"] for channel in findings["channels"]] == ["X", "Y", "Z"]
    assert "not asked for" in json.loads((out / "batch.json").read_bytes())["tests"][0]["headline"][0]
    assert next(out.glob("*/report.html")).stat().st_size > 0


@pytest.mark.slow
def test_tracks_without_findings_follow_the_orders_that_were_named(two_speeds, tmp_path):
    path = tmp_path / "tracks.toml"
    path.write_text('[report]\nresults = ["order_tracks"]\n[orders]\ntrack_orders = [1.0, 2.0]\n')
    out = tmp_path / "out"
    done("run", two_speeds, "--out", out, "--recipe", path, "-q")
    with h5netcdf.File(next(out.glob("*/results.nc")), "r") as file:
        assert file["order_tracks"]["order"][:].tolist() == [1.0, 2.0]


@pytest.mark.slow
def test_results_that_are_made_are_the_same_whatever_else_is_made(two_speeds, tmp_path):
    values = []
    for name, results in (("all", ("order_map", "campbell_map", "findings")), ("two", ("order_map", "campbell_map"))):
        chosen = recipe(tmp_path, *results)
        done("run", two_speeds, "--out", tmp_path / name, "--recipe", chosen, "-q")
        with h5netcdf.File(next((tmp_path / name).glob("*/results.nc")), "r") as file:
            values.append((file["order_map"]["amplitude"][:], file["campbell_map"]["psd"][:]))
    assert (values[0][0] == values[1][0]).all()
    assert (values[0][1] == values[1][1]).all()


def test_a_result_that_does_not_exist_is_refused_before_work(two_speeds, tmp_path):
    path = tmp_path / "wrong.toml"
    for results in ('["waterfall"]', "[]", '"order_map"'):
        path.write_text(f"[report]\nresults = {results}\n")
        outcome = crankorder("run", two_speeds, "--out", tmp_path / "out", "--recipe", path)
        assert outcome.exit_code == 2 and "report.results" in outcome.output, results
        assert not (tmp_path / "out").exists()


def test_a_recording_gives_only_the_frames_that_are_needed():
    settings = load_settings()

    def wanted(*results):
        report = settings.report.model_copy(update={"results": results})
        return set(frames_wanted(settings.model_copy(update={"report": report})))

    assert wanted("order_map") == {OrderFrames}
    assert wanted("campbell_map") == {FrequencyFrames}
    # findings are handed what was followed through sweeps, and the levels that limits are held against
    followed = {LevelFrames, RecordingEnvelope, RecordingLevels, RecordingTracks}
    assert wanted("findings") == {OrderFrames, FrequencyFrames} | followed


def test_a_noun_that_no_stage_makes_is_named_with_the_way_to_it():
    with pytest.raises(SchemaError, match=r"RecordingFile") as caught:
        StagePlan(STAGES, wanted=(OrderFrames,), given=())
    assert "Recording" in caught.value.place


def test_a_crash_inside_one_recording_is_the_fault_of_that_recording_alone(two_speeds, tmp_path, monkeypatch):
    sound = execute.analyse_recording

    def crashing(path, *given):
        if path.name == "rpm_1500.h5":
            os.kill(os.getpid(), signal.SIGKILL)
        return sound(path, *given)

    monkeypatch.setattr(execute, "analyse_recording", crashing)
    outcome = crankorder("run", two_speeds, "--out", tmp_path / "out", "--recipe", "maps", "--no-pictures")
    assert outcome.exit_code == 3, outcome.output
    assert "rpm_1500.h5: could not be analysed; found its worker was ended by SIGKILL" in outcome.output
    assert next((tmp_path / "out").glob("*/results.nc")).exists()
