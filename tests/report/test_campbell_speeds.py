"""Beside the Campbell diagram stand the speeds to avoid and the free ones, at their place on its scale."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from crankorder.plot.drawing import Drawing, Field
from crankorder.report.campbell_figure import campbell_figure
from made.typed import from_dicts

campbell_figure = from_dicts(campbell_figure)


def _box(figure: Drawing) -> tuple[float, float, float, float]:
    return next(part for part in figure.parts if isinstance(part, Field)).box


def test_the_strip_holds_the_ranges_of_the_findings_at_their_speeds(campaign: Any, full: Any, settings: Any) -> None:
    figure = campbell_figure(campaign.campbell, "Z", full, settings=settings)
    left, bottom, width, height = _box(figure)
    ranges = {stroke.name: stroke for stroke in figure.strokes("avoid-")}
    assert [tuple(stroke.values[1]) for stroke in ranges.values()] == [(1755.0, 1850.0), (1690.0, 1760.0)]
    assert [tuple(stroke.values[1]) for stroke in figure.strokes("free-")] == [(300.0, 1690.0), (1850.0, 2000.0)]
    for stroke in [*ranges.values(), *figure.strokes("free-")]:
        assert (stroke.points[:, 0] > left + width).all()
        np.testing.assert_allclose(stroke.points[:, 1], bottom + height * (stroke.values[1] - 300) / 1700)
    words = {words.text for words in figure.words}
    assert {"1800", "1725", "speed to avoid", "free speeds"} <= words


def test_a_crossing_that_was_not_judged_leaves_its_speed_neither_free_nor_to_avoid(
    campaign: Any, full: Any, settings: Any
) -> None:
    full["crossings"] = [{"order": 4.0, "mode_hz": 60.0, "rpm": 900.0, "in_range": True, "excited": False}]
    full["crossings"][0]["verdict"] = "not decided"
    figure = campbell_figure(campaign.campbell, "Z", full, settings=settings)
    (mark,) = figure.strokes("open-")
    assert tuple(mark.values[1]) == pytest.approx((895.5, 904.5))
    assert "not free, or not known" in {words.text for words in figure.words}


@pytest.mark.slow
def test_without_such_lists_there_is_no_strip(campaign: Any, settings: Any) -> None:
    figure = campbell_figure(campaign.campbell, "Z", campaign.findings, settings=settings)
    assert not [*figure.strokes("avoid-"), *figure.strokes("free-")]
    assert not {"speed to avoid", "free speeds"} & {words.text for words in figure.words}


def test_decided_undecided_and_tones_look_different(campaign: Any, full: Any, settings: Any) -> None:
    figure = campbell_figure(campaign.campbell, "Z", full, settings=settings)
    (doubt,) = figure.strokes("doubt")
    assert doubt.values[0][0] == 265.0
    assert sorted(line.values[0][0] for line in figure.strokes("tone")) == [58.3, 300.0]
    looks = {(line.color, line.dashes) for kind in ("mode", "doubt", "tone") for line in figure.strokes(kind)}
    assert len(looks) == 3
    assert {"265? Hz", "58.3 Hz", "not decided"} <= {words.text for words in figure.words}


def test_orders_that_are_close_have_different_labels(campaign: Any, full: Any, settings: Any) -> None:
    for record in full["orders"]:
        if record["order"] == 2.0:
            record |= {"order": 1.005, "order_ci95": [1.0049, 1.0051], "lock": "slips"}
    figure = campbell_figure(campaign.campbell, "Z", full, settings=settings)
    labels = [words.text for words in figure.words if words.name.startswith("label-")]
    assert {"1", "1.005"} <= set(labels)
    assert labels.count("1") == 1


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", ["run-up", "sixty orders"])
def test_keys_and_notes_stay_on_the_sheet_and_apart(name: str, hard: Any, full: Any, settings: Any) -> None:
    drawn = hard[name]
    channel = str(drawn.campbell["channel"].values[-1])
    figure = campbell_figure(drawn.campbell, channel, {**full, "orders": drawn.findings["orders"]}, settings=settings)
    boxes = [words.box for words in figure.words]
    for number, (x, y, width, height) in enumerate(boxes):
        assert x >= 0 and y >= 0 and x + width <= figure.width_in
        for a, b, wide, high in boxes[number + 1 :]:
            apart = x + 0.97 * width < a or a + 0.97 * wide < x or y + 0.97 * height < b or b + 0.97 * high < y
            assert apart, figure.words[number].text
