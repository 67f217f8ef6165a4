"""Accuracy as a command: what was put in is known, and the numbers that are said follow from it."""

import json

import numpy as np
import pytest

import crankorder as co
from crankorder.batch import accuracy
from crankorder.batch.accuracy import accuracy_on, publish_accuracy
from crankorder.errors import RequestError
from made.command import crankorder


def test_every_map_keeps_the_error_that_it_foretells_and_what_is_written_was_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(accuracy, "TOLERANCES", (1e-2, 1e-6))
    monkeypatch.setattr(accuracy, "REPEATS", 1)
    paths, text = publish_accuracy(tmp_path / "acc")
    rows = json.loads(paths[0].read_bytes())["speed_against_error"]
    for row in rows:
        assert row["error"] < row["tolerance"] and row["samples_per_s"] > 0.0
        assert f"{row['error']:.1e}" in text
    assert rows[1]["error"] < 1e-3 * rows[0]["tolerance"]
    assert paths[1].read_text() == text


@pytest.mark.slow
def test_a_twin_tells_what_could_be_found(tmp_path):
    (folder,) = co.synthesise("hard-two-revolutions", tmp_path / "test", quick=True)
    tree = co.run(folder, out=tmp_path / "out")
    if not tree["order_tracks"].sizes["order"]:
        pytest.skip("no order was found in the scene")
    made = accuracy_on(tmp_path / "out")
    assert [one.channel for one in made.channels] == [str(name) for name in tree["order_map"]["channel"].values]
    for one in made.channels:
        assert 0 <= one.orders_found <= one.orders_put_in
        if one.least_found is not None and one.most_missed is not None:
            assert one.least_found > one.most_missed
        if one.coverage_percent is not None:
            assert 0.0 <= one.coverage_percent <= 100.0
            assert np.isfinite(one.coverage_percent)


def test_without_results_nothing_is_written(tmp_path):
    with pytest.raises(RequestError, match="no finished results"):
        publish_accuracy(tmp_path / "acc", on=tmp_path)
    assert not (tmp_path / "acc").exists()


def test_the_doctor_names_an_answer_that_does_not_hold(monkeypatch):
    sound = crankorder("doctor")
    monkeypatch.setattr(accuracy, "even_harmonics", lambda count, ratio: np.full(count, ratio))
    wrong = crankorder("doctor")
    assert (sound.exit_code, wrong.exit_code) == (0, 5) and "BAD" not in sound.output and wrong.output.count("BAD") == 1
