"""Balance of the crankshaft: table 2 of the thesis recomputed, two planes, fans and slugs."""

import tomllib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crankorder.engine.balance_data import CrankshaftSection, FanCounterweight, balanced_engine, load_balanced_engine
from crankorder.engine.balance_sheet import balance_sheet
from crankorder.engine.shafts import crankshaft_sums, two_plane_correction
from crankorder.errors import ManyErrors
from crankorder.settings import shipped

DATA = load_balanced_engine("msu-shafts").balance.crankshaft
assert DATA is not None


def test_analytic_a_two_plane_correction_brings_both_sums_to_zero():
    sums = crankshaft_sums(DATA.sections)
    first_mm, *_, last_mm = DATA.places.values()
    added = two_plane_correction(sums, (first_mm, last_mm))
    weights = [
        CrankshaftSection(name="added", mass_kg=1.0, x_mm=one.real, y_mm=one.imag, z_mm=plane)
        for one, plane in zip(added, (first_mm, last_mm), strict=True)
    ]
    after = crankshaft_sums([*DATA.sections, *weights])
    assert abs(after[0]) < 1e-12 * 108
    assert abs(after[1]) < 1e-12 * 9176


@given(datum=st.floats(-500, 500))
def test_analytic_another_datum_moves_the_couple_by_the_static_unbalance(datum):
    sums = crankshaft_sums(DATA.sections)
    moved = crankshaft_sums([one.model_copy(update={"z_mm": one.z_mm - datum}) for one in DATA.sections])
    assert moved[0] == sums[0]
    assert abs(sums[1] - datum * sums[0] - moved[1]) < 1e-9


def test_analytic_mass_and_centroid_of_a_fan_are_those_of_its_integral():
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for inner, fan in ((0.0, 359.0), (0.0, 180.0), (20.0, 120.0), (30.0, 200.0), (59.9, 1e-3)):
        weight = FanCounterweight(
            radius_mm=60.0, thickness_mm=18.0, fan_angle_deg=fan, density_kg_m3=7850.0, inner_radius_mm=inner
        )
        radius, share = inner + (60 - inner) * (nodes + 1) / 2, weights * (60 - inner) / 2
        half = np.radians(fan) / 2
        mass = 7850e-9 * 18 * 2 * half * np.sum(share * radius)
        moment = 7850e-9 * 18 * 2 * np.sin(half) * np.sum(share * radius**2)
        assert weight.mass_kg == pytest.approx(mass, rel=1e-12)
        assert weight.unbalance_kg_mm == pytest.approx(moment, rel=1e-12, abs=1e-15)


def test_literature_radius_then_thickness_then_fan_angle_change_the_balance_most():
    for fan in (60.0, 120.0, 180.0):
        sizes = {"radius_mm": 60.0, "thickness_mm": 18.0, "fan_angle_deg": fan}

        def unbalance(sizes=sizes, **changes):
            return FanCounterweight(**(sizes | changes), density_kg_m3=7850.0, inner_radius_mm=20.0).unbalance_kg_mm

        sense = FanCounterweight(**sizes, density_kg_m3=7850.0, inner_radius_mm=20.0).sensitivity
        assert sense["radius"] > sense["thickness"] > sense["fan_angle"] >= 0
        for key, size in sizes.items():
            slope = (unbalance(**{key: size * 1.0001}) - unbalance(**{key: size * 0.9999})) / unbalance() / 2e-4
            assert slope == pytest.approx(sense[key.rpartition("_")[0]], abs=1e-6)


@given(st.floats(0, 0.95), st.floats(1, 350), st.floats(0.3, 1.5), st.floats(-40, 40), st.floats(1, 60))
@settings(max_examples=30)
def test_analytic_a_resized_fan_has_the_unbalance_asked_for(inner, fan, more, angle, thickness):
    weight = FanCounterweight(
        radius_mm=100.0, inner_radius_mm=inner * 100.0, thickness_mm=thickness, fan_angle_deg=fan,
        density_kg_m3=7850.0, angle_deg=angle,
    )  # fmt: skip
    wanted = more * weight.unbalance_kg_mm
    for size, value in weight.resized(wanted).items():
        if value is not None:
            # near a fan of half a turn the sine is flat: half the digits of the angle
            rel = 1e-7 if size == "fan_angle_deg" else 1e-9
            assert weight.model_copy(update={size: value}).unbalance_kg_mm == pytest.approx(wanted, rel=rel)
    assert abs(complex(weight.section.x_mm, weight.section.y_mm)) == pytest.approx(weight.centroid_mm, rel=1e-12)


def test_the_rod_as_cut_and_as_weighed_takes_the_place_of_the_bob_weight():
    content = tomllib.loads(shipped("engines")["msu-crankshaft"])
    content["balance"]["rod_split"]["on_pin"] = {
        "mass_g": 1673.0, "centre_from_big_end_mm": 38.6, "rod_length_mm": 157.0916,
    }  # fmt: skip
    table = balance_sheet(balanced_engine(content, name="fans", source="fans.toml"))["crankshaft"]
    found = {one["method"]: one for one in table["bob_weights"]}
    assert list(found) == ["stated", "cut", "scale", "on pin"]
    assert found["on pin"]["mass_kg"] == pytest.approx(1.673 * (1 - 38.6 / 157.0916), rel=1e-12)
    change = found["scale"]["static_kg_mm"]["y"] - found["cut"]["static_kg_mm"]["y"]
    assert change == pytest.approx((1.2624 - 1.0159) * 47.3, rel=1e-9)


SLUG = {"into": "Counterweight 1", "diameter_mm": 1.0, "length_mm": 3.0, "radius_mm": 9.0, "density_kg_m3": 17600.0}


def test_a_crankshaft_that_cannot_be_is_refused_by_name():
    for name, change, message in (
        ("msu-crankshaft", {"bob_weight": "Bob"}, "Bob"),
        ("msu-crankshaft", {"counterweights": ["Cheek 1"]}, "two counterweights or more"),
        ("msu-crankshaft", {"slugs": [SLUG | {"into": "Cheek 1"}]}, "one of the counterweights"),
        ("msu-crankshaft", {"slugs": [SLUG | {"length_mm": 31.0}]}, "longer than"),
        ("msu-crankshaft", {"slugs": [SLUG | {"diameter_mm": 40.0, "radius_mm": 70.0}]}, "stands out"),
        ("msu-crankshaft", {"counterweights": [{"shape": "cube"}, "Cheek 2"]}, "shape"),
        ("msu-shafts", {"counterweights": ["Counterweight 1", "Counterweight 3"]}, "Counterweight 3"),
        ("msu-shafts", {"counterweights": ["Counterweight 1", "Balance Hole 1"]}, "one plane"),
        ("msu-shafts", {"sections": []}, "crankshaft.sections"),
    ):
        content = tomllib.loads(shipped("engines")[name])
        content["balance"]["crankshaft"] |= change
        with pytest.raises(ManyErrors, match=message):
            balanced_engine(content, name="spoilt", source="spoilt.toml")
