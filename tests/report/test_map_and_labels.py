"""Cells reach half-way, thin lines survive the pixels, labels never overlap."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.plot.campbell_figure import gaps_between, speed_cells, with_gaps
from crankorder.plot.drawing import linear_texts, linear_ticks
from crankorder.plot.labels import EdgeLabel, fitted, spread
from crankorder.plot.palette import drawable, text_width_in


def test_stepped_speeds_reach_half_way_to_their_neighbours_and_not_beyond_the_tested_range():
    assert speed_cells(np.array([300.0, 400.0, 600.0])).tolist() == [[300, 350], [350, 500], [500, 600]]


def test_a_wide_gap_of_the_run_up_is_left_open_and_regular_steps_leave_none():
    speeds = np.concatenate([np.arange(900.0, 2600, 10), np.arange(4000.0, 4900, 10)])
    ((low, high),) = gaps_between(speed_cells(speeds))
    assert 2590 < low < 2750 and 3850 < high < 4000
    assert gaps_between(speed_cells(np.arange(300.0, 2001, 50))) == []
    rows, edges = with_gaps(np.ones((len(speeds), 4)), speed_cells(speeds), empty=-1.0)
    assert len(rows) == len(speeds) + 1 == len(edges) - 1
    assert (rows < 0).all(axis=1).sum() == 1


@given(st.lists(st.floats(0, 10), min_size=1, max_size=25), st.floats(0.05, 0.3))
def test_spread_labels_keep_their_order_do_not_overlap_and_stay_inside(targets, width):
    targets = sorted(targets)
    places = spread(targets, [width] * len(targets), low=0.0, high=10.0)
    assert (np.diff(places) >= width - 1e-9).all()
    assert places[0] >= width / 2 - 1e-9
    assert places[-1] <= 10 - width / 2 + 1e-9


def test_labels_without_room_lose_their_unit_first_and_then_the_crowded_ones():
    labels = [EdgeLabel(place, f"{place * 100:.0f} Hz", "k") for place in (1.0, 1.1, 2.0, 3.0)]
    room = sum(text_width_in(label.text.removesuffix(" Hz"), 7.5) + 0.05 for label in labels)
    assert [label.text for label in fitted(labels, 10.0)] == ["100 Hz", "110 Hz", "200 Hz", "300 Hz"]
    assert [label.text for label in fitted(labels, room + 0.01)] == ["100", "110", "200", "300"]
    assert [label.text for label in fitted(labels, room - 0.01)] == ["100", "200", "300"]


def test_text_that_the_font_does_not_know_is_spelled_out_and_never_warns():
    assert drawable("ok µ² $x$", 60) == "ok µ² $x$"
    assert drawable("振動", 60) == "\\u632f\\u52d5"
    assert drawable("a\x00b\udcff", 60) == "a\\x00b\\udcff"
    assert len(drawable("x" * 10_000, 60)) == 60


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.integers(2, 12))
def test_ticks_are_round_lie_inside_and_their_texts_are_their_values(low, span, most):
    places = linear_ticks(low, low + span, most=most)
    assert len(places) <= most + 1
    assert all(low - 1e-6 * span <= place <= low + span + 1e-6 * span for place in places)
    texts = linear_texts(places)
    assert len(set(texts)) == len(texts)
    if len(places) > 1 and np.abs(places).max() < 1e5:
        step = places[1] - places[0]
        assert [float(text.replace("−", "-")) for text in texts] == pytest.approx(places, abs=0.01 * step)
