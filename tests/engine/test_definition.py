"""Engine files: what is wrong is told all at once."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from crankorder.engine.balance_data import load_balanced_engine
from crankorder.engine.definition import load_engine
from crankorder.engine.machine_parts import Bearing, bearing_catalogue, bearing_orders
from crankorder.errors import ManyErrors, RequestError

GOOD = "crank_radius_m = 0.05\nrod_length_m = 0.15\nreciprocating_mass_kg = 1.0\n"


def test_a_users_engine_is_found_beside_the_manifest(tmp_path):
    (tmp_path / "mine.toml").write_text(GOOD)
    assert load_engine("mine.toml", tmp_path) == load_engine("mine", tmp_path)
    with pytest.raises(RequestError, match="no such engine"):
        load_engine("mine.toml")


def test_another_kind_of_engine_is_refused_by_name(tmp_path):
    (tmp_path / "other.toml").write_text("kind = 'elastic-hinge'\n")
    for load in (load_engine, load_balanced_engine):
        with pytest.raises(RequestError, match=r"other.toml: kind: not an engine of cranks.*found elastic-hinge"):
            load("other.toml", beside=tmp_path)
        with pytest.raises(RequestError, match="nowhere"):
            load("nowhere", beside=tmp_path)


def test_faults_of_lengths_masses_keys_and_parts_are_all_told_at_once(tmp_path):
    (tmp_path / "bad.toml").write_text(
        """
        crank_radius_m = 0.15
        rod_length_m = 0.15
        reciprocating_mass_kg = -1.0
        stroke = 3
        main_bearings_m = [0.1, 0.0]
        [[cylinders]]
        crank_deg = 0.0
        firing_deg = 90.0
        [gas]
        crank_angle_deg = [0.0, 90.0, 30.0]
        [[bearings]]
        name = "b"
        designation = "none such"
        """
    )
    with pytest.raises(ManyErrors) as caught:
        load_engine("bad.toml", tmp_path)
    told = {(fault.place, fault.problem.split(",")[0]) for fault in caught.value.faults}
    assert {place for place, _ in told} == {
        "rod_length_m", "reciprocating_mass_kg", "stroke", "main_bearings_m", "cylinders", "gas.crank_angle_deg",
        "gas.ideal", "bearings.0.designation",
    }  # fmt: skip


MISFITS = {
    "[rod]\nmass_kg = 1.0\ncentre_from_big_end_m = 0.2\n": "between the ends of the rod",
    "[rod]\nmass_kg = 4.0\ncentre_from_big_end_m = 0.1\n": "exceeds reciprocating_mass_kg",
    "main_bearings_m = [0.1, 0.2]\n": "between the first and the last main bearing",
    "[gas]\ncrank_angle_deg = [0.0, 720.0]\ntorque_n_m = [0.0, 1.0]\n": "less than one cycle, 720",
    "[gas]\ncrank_angle_deg = [0.0, 90.0]\npressure_pa = [1e5, 2e5]\n": "needs bore_m",
    "[gas]\ncrank_angle_deg = [0.0, 90.0]\ntorque_n_m = [1.0]\n": "one value for each of the 2",
    "[gas]\ncrank_angle_deg = [0.0, 90.0]\n": "either pressure_pa or torque_n_m",
    "cylinders = []\n": "at least 1",
    "offset_m = 0.101\n": "could not turn",
    "[shafts]\norders = [1, 2]\npairs = [{ order = 2, unbalance_g_mm = 1.0 }]\n": "more than one pair for order 2",
    "[shafts]\npairs = [{ order = 1 }]\n": "required",
}
"""Parts that do not fit an engine, and what is told of them."""


def test_parts_that_do_not_fit_are_refused(tmp_path):
    for text, fault in MISFITS.items():
        (tmp_path / "bad.toml").write_text(GOOD + text)
        with pytest.raises(ManyErrors, match=fault) as caught:
            load_engine("bad.toml", tmp_path)
        assert len(caught.value.faults) == 1


# Bearing orders against the truth sheet.


def test_the_eleven_ball_bearing_has_the_orders_of_the_truth_sheet(shared_truth):
    for ratio, known in shared_truth["seed001"]["bearing_11_balls_half_speed_orders"].items():
        bearing = Bearing(name="jack", shaft_ratio=0.5, rolling_elements=11, ball_over_pitch=float(ratio))
        expected = {line: known[line] for line in ("BPFO", "BPFI", "BSF", "FTF")}
        assert bearing_orders(bearing) == pytest.approx({"N*fs": known["BPFO+BPFI"], **expected}, rel=1e-14)


@given(st.integers(3, 40), st.floats(0.05, 0.6), st.floats(0, 60), st.floats(0.1, 4))
def test_inner_and_outer_race_lines_add_up_to_elements_times_shaft_speed(elements, ball, contact_deg, ratio):
    bearing = Bearing(
        name="any", shaft_ratio=ratio, rolling_elements=elements, ball_over_pitch=ball, contact_angle_deg=contact_deg
    )
    orders = bearing_orders(bearing)
    assert orders["BPFO"] + orders["BPFI"] == pytest.approx(orders["N*fs"], rel=1e-13)
    assert orders["BPFO"] == pytest.approx(elements * orders["FTF"], rel=1e-13)
    assert 0 < orders["BPFO"] < orders["BPFI"]


def test_published_orders_win_over_geometry_and_turn_with_the_shaft():
    # 6205-2RS as the CWRU bearing data centre publishes it, in multiples of shaft speed
    published = {"bpfo": 3.5848, "bpfi": 5.4152, "bsf": 4.7135 / 2, "ftf": 0.39828}
    bearing = Bearing(name="6205-2RS", shaft_ratio=2.0, rolling_elements=9, ball_over_pitch=0.2, **published)
    orders = bearing_orders(bearing)
    assert orders == {"N*fs": 18.0, "BPFO": 7.1696, "BPFI": 10.8304, "BSF": 4.7135, "FTF": 0.79656}


def test_published_orders_and_geometry_of_every_listed_bearing_agree():
    for designation, listed in bearing_catalogue().items():
        assert listed.source
        keys = ("rolling_elements", "ball_over_pitch", "contact_angle_deg")
        geometry = {key: value for key in keys if (value := getattr(listed, key)) is not None}
        published = bearing_orders(Bearing(name="b", designation=designation))
        assert published == pytest.approx(bearing_orders(Bearing(name="b", **geometry)), rel=2e-4), designation


def test_what_is_stated_wins_over_the_catalogue():
    stated = bearing_orders(Bearing(name="b", designation="6205-2RS", bpfo=3.6))
    assert (stated["BPFO"], stated["BPFI"]) == (3.6, 5.4152)
    # another geometry is another bearing: none of the published orders is kept
    assert bearing_orders(Bearing(name="b", designation="6205-2RS", rolling_elements=10))["BPFI"] == pytest.approx(
        5 * (1 + 0.2033832), rel=1e-12
    )


def test_a_designation_that_is_unknown_and_orders_that_no_bearing_has_are_refused():
    for data, fault in (
        ({"designation": "6205"}, r"no such bearing in the catalogue, which has 6205-2RS, "),
        ({"bpfo": 5.4, "bpfi": 3.6}, "must exceed bpfo"), ({"ftf": 1.2}, "less than 1"),
        ({"rolling_elements": 8, "bpfo": 3.58, "bpfi": 5.42}, "must add up to the 8 rolling elements"),
    ):  # fmt: skip
        with pytest.raises(ValidationError, match=fault):
            Bearing(name="b", **data)
