"""Bearing orders against the truth sheet."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from crankorder.engine.bearings import Bearing, bearing_catalogue, bearing_orders


def test_the_eleven_ball_bearing_has_the_orders_of_the_truth_sheet(shared_truth: dict[str, Any]) -> None:
    for ratio, known in shared_truth["seed001"]["bearing_11_balls_half_speed_orders"].items():
        orders = bearing_orders(
            Bearing(name="jack", shaft_ratio=0.5, rolling_elements=11, ball_over_pitch=float(ratio))
        )
        assert list(orders) == ["N*fs", "BPFO", "BPFI", "BSF", "FTF"]
        assert {line: orders[line] for line in ("FTF", "BSF", "BPFO", "BPFI")} == pytest.approx(
            {line: known[line] for line in ("FTF", "BSF", "BPFO", "BPFI")}, rel=1e-14
        )
        assert orders["N*fs"] == 5.5 == pytest.approx(known["BPFO+BPFI"], rel=1e-14)
        assert {f"2{line}": 2 * orders[line] for line in ("BSF", "BPFO", "BPFI")} == pytest.approx(
            {line: known[line] for line in ("2BSF", "2BPFO", "2BPFI")}, rel=1e-14
        )


@given(st.integers(3, 40), st.floats(0.05, 0.6), st.floats(0, 60), st.floats(0.1, 4))
def test_inner_and_outer_race_lines_add_up_to_elements_times_shaft_speed(
    elements: int, ball: float, contact_deg: float, ratio: float
) -> None:
    bearing = Bearing(
        name="any", shaft_ratio=ratio, rolling_elements=elements, ball_over_pitch=ball, contact_angle_deg=contact_deg
    )
    orders = bearing_orders(bearing)
    assert orders["BPFO"] + orders["BPFI"] == pytest.approx(orders["N*fs"], rel=1e-13)
    assert orders["BPFO"] == pytest.approx(elements * orders["FTF"], rel=1e-13)
    assert 0 < orders["BPFO"] < orders["BPFI"]


def test_published_orders_win_over_geometry_and_turn_with_the_shaft() -> None:
    # 6205-2RS as the CWRU bearing data centre publishes it, in multiples of shaft speed
    published = {"bpfo": 3.5848, "bpfi": 5.4152, "bsf": 4.7135 / 2, "ftf": 0.39828}
    bearing = Bearing(name="6205-2RS", shaft_ratio=2.0, rolling_elements=9, ball_over_pitch=0.2, **published)
    orders = bearing_orders(bearing)
    assert orders == {"N*fs": 18.0, "BPFO": 7.1696, "BPFI": 10.8304, "BSF": 4.7135, "FTF": 0.79656}
    geometry = bearing_orders(Bearing(name="6205-2RS", rolling_elements=9, ball_over_pitch=0.3126 / 1.537))
    assert {line: geometry[line] for line in ("BPFO", "BPFI", "BSF", "FTF")} == pytest.approx(
        {"BPFO": 3.5848, "BPFI": 5.4152, "BSF": 4.7135 / 2, "FTF": 0.39828}, rel=2e-4
    )


def test_published_orders_and_geometry_of_every_listed_bearing_agree() -> None:
    for designation, listed in bearing_catalogue().items():
        assert listed.source
        published = bearing_orders(Bearing(name="b", designation=designation))
        geometry = {"rolling_elements": listed.rolling_elements, "ball_over_pitch": listed.ball_over_pitch}
        contact = {} if listed.contact_angle_deg is None else {"contact_angle_deg": listed.contact_angle_deg}
        rolling = bearing_orders(Bearing(name="b", **geometry, **contact))
        assert list(published) == list(rolling) == ["N*fs", "BPFO", "BPFI", "BSF", "FTF"]
        assert published == pytest.approx(rolling, rel=2e-4), designation


def test_what_is_stated_wins_over_the_catalogue() -> None:
    stated = bearing_orders(Bearing(name="b", designation="6205-2RS", bpfo=3.6))
    assert (stated["BPFO"], stated["BPFI"]) == (3.6, 5.4152)
    # another geometry is another bearing: none of the published orders is kept
    assert bearing_orders(Bearing(name="b", designation="6205-2RS", rolling_elements=10))["BPFI"] == pytest.approx(
        5 * (1 + 0.2033832), rel=1e-12
    )


def test_an_unknown_designation_is_told_what_there_is() -> None:
    with pytest.raises(ValidationError, match=r"no such bearing in the catalogue, which has 6205-2RS, "):
        Bearing(name="b", designation="6205")


def test_orders_that_no_bearing_has_are_refused() -> None:
    wrong: tuple[tuple[dict[str, Any], str], ...] = (
        ({"bpfo": 5.4, "bpfi": 3.6}, "must exceed bpfo"),
        ({"rolling_elements": 8, "bpfo": 3.58, "bpfi": 5.42}, "must add up to the 8 rolling elements"),
        ({"ftf": 1.2}, "less than 1"),
    )
    for data, fault in wrong:
        with pytest.raises(ValidationError, match=fault):
            Bearing(name="b", **data)
