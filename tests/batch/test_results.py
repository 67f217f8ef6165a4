"""Only the results that a recipe asks for are made, and what is missing breaks nothing."""

import json
import os
import signal
import time

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


def test_maps_alone_make_page_and_index_and_say_that_findings_were_not_asked_for(two_speeds, tmp_path):
    out = tmp_path / "out"
    outcome = done("run", two_speeds, "--out", out, "--recipe", "maps")
    assert "not asked for: the recipe wants order map, campbell map only" in outcome.output
    assert "above the noise" not in outcome.output
    with h5netcdf.File(next(out.glob("*/results.nc")), "r") as file:
        assert set(file.groups) == {"order_map", "campbell_map", "shaft", "findings"}
    findings = json.loads(next(out.glob("*/findings.json")).read_bytes())
    assert list(jsonschema.Draft202012Validator(schema_of("findings")).iter_errors(findings)) == []
    assert findings["orders"] == []
    assert [channel["name"] for channel in findings["channels"]] == ["X", "Y", "Z"]
    assert "not asked for" in json.loads((out / "batch.json").read_bytes())["tests"][0]["headline"][0]
    assert next(out.glob("*/report.html")).stat().st_size > 0


def test_results_are_the_same_whatever_else_is_made_and_tracks_without_findings_follow_the_orders_named(
    analysed, tmp_path
):
    path = tmp_path / "tracks.toml"
    path.write_text('[report]\nresults = ["order_map", "order_tracks"]\n[orders]\ntrack_orders = [1.0, 2.0]\n')
    done("run", analysed / "recordings", "--out", tmp_path / "out", "--recipe", path, "-q")
    some, every = (next(out.glob("*/results.nc")) for out in (tmp_path / "out", analysed / "out"))
    with h5netcdf.File(some, "r") as tracks, h5netcdf.File(every, "r") as whole:
        assert tracks["order_tracks"]["order"][:].tolist() == [1.0, 2.0]
        assert (tracks["order_map"]["amplitude"][:] == whole["order_map"]["amplitude"][:]).all()


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


@pytest.mark.parametrize(
    ("fault", "options", "told"),
    [
        (lambda: os.kill(os.getpid(), signal.SIGKILL), (), "its worker was ended by SIGKILL"),
        pytest.param(lambda: time.sleep(600.0), ("--timeout", "5"), "it took longer than 5 s", marks=pytest.mark.slow),
    ],
    ids=["crash", "too long"],
)
def test_a_crash_or_a_recording_that_takes_too_long_is_left_out_alone(
    two_speeds, tmp_path, monkeypatch, fault, options, told
):
    sound = execute.analyse_recording

    def faulty(path, *given):
        if path.name == "rpm_1500.h5":
            fault()
        return sound(path, *given)

    monkeypatch.setattr(execute, "analyse_recording", faulty)
    outcome = crankorder("run", two_speeds, "--out", tmp_path / "out", "--recipe", "maps", "--no-pictures", *options)
    assert outcome.exit_code == 3, outcome.output
    assert f"rpm_1500.h5: could not be analysed; found {told}" in outcome.output
    assert all(option in outcome.output for option in options[:1])
    assert json.loads((tmp_path / "out" / "batch.json").read_bytes())["tests"][0]["status"] == "partial"
    assert next((tmp_path / "out").glob("*/results.nc")).exists()
