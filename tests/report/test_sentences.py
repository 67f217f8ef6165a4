"""The sentences say what the findings hold, in one way of writing numbers."""

from __future__ import annotations

import copy
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.report.notation import (
    estimate_text,
    level_reference,
    listed,
    named,
    nominal_order,
    number_text,
    order_text,
)
from crankorder.report.sentences import (
    ALL_CLEAR,
    avoid_sentences,
    bearing_sentences,
    headline,
    story_of,
    strongest_sentence,
)


@pytest.mark.parametrize(
    ("value", "interval", "text"),
    [
        (0.83, [0.81, 0.85], "0.83 (0.81…0.85) m/s²"),
        (1.898, [1.860, 1.937], "1.90 (1.86…1.94) m/s²"),
        (116.0, [110.0, 122.0], "116 (110…122) m/s²"),
        (-42.0, [-44.0, -40.0], "−42 (−44…−40) m/s²"),
        (3.0e-9, [2.0e-9, 4.0e-9], "3.00e-9 (2.00e-9…4.00e-9) m/s²"),
        (5.0, None, "5.00 m/s²"),
        (None, None, "–"),
        (math.nan, None, "–"),
    ],
)
def test_an_estimate_is_written_with_the_digits_that_its_interval_earns(
    value: float | None, interval: list[float] | None, text: str
) -> None:
    assert estimate_text({"x": value, "x_ci95": interval}, "x", unit="m/s²") == text


@given(st.floats(min_value=1e-12, max_value=1e12), st.floats(min_value=1e-3, max_value=0.5))
def test_a_written_interval_is_never_off_by_more_than_a_quarter_of_its_width(value: float, share: float) -> None:
    low, high = value * (1 - share), value * (1 + share)
    text = estimate_text({"x": value, "x_ci95": [low, high]}, "x").replace("−", "-")
    written = [float(part) for part in text.replace("(", " ").replace(")", " ").replace("…", " ").split()]
    tolerance = max(
        0.13 * (high - low), 0.006 * value
    )  # a quarter of the width rounds by an eighth; three digits at least
    assert written == pytest.approx([value, low, high], abs=tolerance)


def test_orders_and_lists_are_written_shortly() -> None:
    assert [order_text(order) for order in (2.0, 5.5, 61.2, 0.333333)] == ["2", "5.5", "61.2", "0.333"]
    assert [listed(words) for words in ([], ["X"], ["X", "Y"], ["X", "Y", "Z"])] == ["", "X", "X and Y", "X, Y and Z"]
    assert number_text(0.0) == "0"


def test_a_measured_order_is_called_by_the_half_order_that_it_agrees_with() -> None:
    assert nominal_order({"order": 1.9987, "order_ci95": [1.99, 2.007]}) == 2.0
    assert nominal_order({"order": 5.48, "order_ci95": [5.479, 5.481]}) == 5.48
    assert nominal_order(61.2) == 61.2


def test_levels_refer_to_iso_1683_in_the_unit_of_the_channel(settings: Any) -> None:
    assert level_reference("acceleration", "m/s2", settings=settings) == (1e-6, "dB re 1e-6 m/s² (peak)")
    reference, text = level_reference("acceleration", "g", settings=settings)
    assert (reference * 9.80665, text) == (pytest.approx(1e-6), "dB re 1e-6 m/s² (peak)")
    for quantity in ("sound_pressure", "sound pressure", "pressure"):
        assert level_reference(quantity, "Pa", settings=settings) == (20e-6, "dB re 20 µPa (peak)")
    assert level_reference("pressure", "bar", settings=settings) == (1.0, "dB re 1 bar (peak)")
    assert level_reference("other", "counts", settings=settings) == (1.0, "dB re 1 counts (peak)")


def test_the_headline_names_the_strongest_order_its_interval_and_the_frequency_that_it_meets(campaign: Any) -> None:
    findings = copy.deepcopy(campaign.findings)
    record = next(one for one in findings["orders"] if (one["channel"], one["order"]) == ("Z", 2.0))
    record |= {"amplitude": 2.83, "amplitude_ci95": [2.81, 2.85], "speed_rpm_at_max": 1800.0}
    wanted = (
        "Order 2 is the strongest in Z: 2.83 m/s² (2.81…2.85) at 1800 rpm, where it meets the 60 Hz natural frequency."
    )
    assert strongest_sentence(findings, "Z") == wanted
    assert headline(findings)[0] == wanted


def test_an_order_that_meets_a_mains_tone_is_not_said_to_meet_a_natural_frequency(campaign: Any) -> None:
    findings = copy.deepcopy(campaign.findings)
    findings["modes"] = [{**findings["modes"][0], "explained_by": "mains"}]
    assert "meets" not in strongest_sentence(findings, "Z")
    assert "60 Hz (mains)" in " ".join(story_of(findings)["why"])


def test_a_bearing_line_comes_with_the_rule_to_re_run_the_test(campaign: Any) -> None:
    (sentence,) = bearing_sentences(campaign.findings)
    assert sentence.startswith(
        "Order 5.5 fits the rolling-element count (N·fs) line of the jack shaft bearing: 0.120 m/s²"
    )
    assert sentence.endswith("Re-run the same test: a growing amplitude means a failing bearing.")
    assert "re-run" in " ".join(story_of(campaign.findings)["what_to_do"]).lower()


def test_bearings_on_the_same_line_share_a_sentence_and_a_rule_in_the_verdict_is_not_repeated(campaign: Any) -> None:
    findings = copy.deepcopy(campaign.findings)
    verdict = "watch: re-run the same test; a growing amplitude means a failing bearing. Exactly locked to the shaft"
    first = findings["bearings"][0] | {"verdict": verdict}
    findings["bearings"] = [first, {**first, "name": "distributor"}]
    (sentence,) = bearing_sentences(findings)
    assert "jack shaft and distributor bearings" in sentence
    assert sentence.lower().count("re-run") == 1
    assert "Exactly locked to the shaft." in sentence


def test_crossings_at_one_speed_share_a_sentence_and_those_outside_the_range_are_not_warned_of(campaign: Any) -> None:
    sentences = avoid_sentences(campaign.findings)
    assert sentences[0] == (
        "Avoid steady running near 1725 rpm, where order 4 excites the 115 Hz natural frequency and "
        "order 8 excites the 230 Hz natural frequency."
    )
    outside = [{**record, "in_range": False} for record in campaign.findings["crossings"]]
    assert avoid_sentences({"crossings": outside}) == []


def test_only_an_exponent_near_two_with_a_narrow_interval_is_called_unbalance(campaign: Any) -> None:
    assert any("unbalanced mass" in one and "Orders 1 and 2" in one for one in story_of(campaign.findings)["why"])
    for low, high in ((0.2, 0.9), (0.0, 4.0)):
        records = [{**one, "speed_exponent_ci95": [low, high]} for one in campaign.findings["orders"]]
        why = story_of({**campaign.findings, "orders": records})["why"]
        assert not any("unbalanced mass does" in one for one in why), (low, high)


def test_bad_data_are_told_first_and_ask_for_a_repeat(campaign: Any) -> None:
    flags = [{"recording": "a", "flag": "no_index", "severity": "bad", "detail": ""}]
    story = story_of({**campaign.findings, "quality": flags})
    assert any("took no part" in one for one in story["how_sure"])
    assert "Repeat the recordings that are marked bad." in story["what_to_do"]


def test_nothing_found_is_said_and_never_an_empty_headline() -> None:
    nothing: dict[str, Any] = {"orders": [], "modes": [], "crossings": [], "bearings": [], "quality": []}
    assert headline(nothing) == ["No order stands above the noise."]
    assert story_of(nothing)["what_to_do"] == [ALL_CLEAR]
    assert "not looked for" in ALL_CLEAR  # an all-clear names what it does not cover


def test_names_from_files_are_cut_and_control_characters_shown() -> None:
    assert named("a\x1b[31mb\n", limit=60) == "a\\x1b[31mb\\x0a"
    assert named("x" * 10_000, limit=60) == "x" * 59 + "…"
