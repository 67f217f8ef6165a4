"""Balance of the crankshaft: table 2 of the thesis as printed and recomputed, two planes, fans and slugs."""

import tomllib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from crankorder.engine.balance_data import balanced_engine, load_balanced_engine
from crankorder.engine.balance_sheet import balance_sheet
from crankorder.engine.crankshaft import (
    CrankshaftSection,
    CrankshaftSums,
    FanCounterweight,
    about_datum,
    couple_n_m,
    crankshaft_sums,
    slug_unbalance_kg_mm,
    two_plane_correction,
)
from crankorder.errors import ManyErrors, RequestError
from crankorder.settings import shipped

DATA = load_balanced_engine("msu-shafts").balance.crankshaft
assert DATA is not None

# Ruckle 2014, table 2: Wr X, Wr Y (kg·mm), CX, CY (kg·mm²) as printed
PRINTED = {
    "Balance Hole 1": (0.0, 0.0, 0.0, 0.0),
    "Counterweight 1": (0.0649, -108.5823, 2.4878, -4163.5146),
    "Cheek 1": (-0.0986, 18.9033, -3.8619, 740.0420),
    "Pin 1": (-0.0003, 56.5958, -0.0249, 4506.1057),
    "Est. Bob Weight 1": (0.0, 89.0186, 0.0, 7063.6222),
    "Oil Weight": (0.0258, 0.4140, 1.8308, 29.3638),
    "Counterweight 2": (0.0, -76.2440, -0.0001, -9176.5508),
    "Cheek 2": (0.0, 19.9006, 0.0013, 2354.9466),
    "Balance Hole 2": (0.0, 0.0, 0.0, 0.0),
}


def printed_sums(skip: tuple[str, ...] = ()) -> CrankshaftSums:
    """Sums of the columns as printed, without the named rows."""
    rows = [row for name, row in PRINTED.items() if name not in skip]
    x, y, cx, cy = (sum(column) for column in zip(*rows, strict=True))
    return CrankshaftSums(static_kg_mm=complex(x, y), dynamic_kg_mm2=complex(cx, cy))


def half_steps(section: CrankshaftSection) -> tuple[float, float, float, float]:
    """Most that rounding of the four printed inputs changes the four products of a row."""
    step = 5e-5
    mass, z = section.mass_kg, section.z_mm
    both = [(mass * step + abs(arm) * step + step**2, arm) for arm in (section.x_mm, section.y_mm)]
    static = [change for change, _ in both]
    dynamic = [change * z + abs(mass * arm) * step + change * step for change, arm in both]
    return (static[0], static[1], dynamic[0], dynamic[1])


@pytest.mark.parametrize("section", DATA.sections, ids=lambda section: section.name)
def test_literature_rows_of_table_2_agree_within_the_rounding_of_their_inputs(section: CrankshaftSection) -> None:
    one = crankshaft_sums([section])
    found = (one.static_kg_mm.real, one.static_kg_mm.imag, one.dynamic_kg_mm2.real, one.dynamic_kg_mm2.imag)
    for here, printed, inputs in zip(found, PRINTED[section.name], half_steps(section), strict=True):
        # zeros printed for masses and places are exact, CX of cheek and counterweight 2 come from hidden digits of X
        assert abs(here - printed) <= (inputs if section.mass_kg else 0) + 1.0001e-4


def test_recomputed_rows_and_sums_are_those_of_the_truth_sheet(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["table2"]
    for section, row in zip(DATA.sections, known["rows"], strict=True):
        one = crankshaft_sums([section])
        assert section.name == row["component"]
        assert one.static_kg_mm == pytest.approx(complex(row["WRX"], row["WRY"]), rel=1e-12)
        assert one.dynamic_kg_mm2 == pytest.approx(complex(row["CX"], row["CY"]), rel=1e-12)
    total, sums = crankshaft_sums(DATA.sections), known["sums_recomputed"]
    # the static sum is 1e-4 of its terms: 1e-12 of these
    assert total.static_kg_mm == pytest.approx(complex(sums["WRX"], sums["WRY"]), abs=1e-12 * 108.6)
    assert total.dynamic_kg_mm2 == pytest.approx(complex(sums["CX"], sums["CY"]), rel=1e-12)


def test_literature_table_2_is_in_static_balance_but_leaves_a_rocking_couple(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["table2"]
    printed = printed_sums()
    assert abs(printed.static_kg_mm) == pytest.approx(known["static_residual_kg_mm"], abs=1e-12 * 108.6)
    assert abs(printed.dynamic_kg_mm2) == pytest.approx(known["dynamic_residual_kg_mm2"], rel=1e-12)
    couple = couple_n_m(printed.dynamic_kg_mm2, 2000)
    assert couple == pytest.approx(known["couple_N_m_at_2000rpm"], rel=1e-12)
    recomputed = crankshaft_sums(DATA.sections)
    assert couple_n_m(recomputed.dynamic_kg_mm2, 2000) == pytest.approx(couple, rel=3e-4)
    assert abs(recomputed.static_kg_mm) < 0.015


def test_counterweights_that_meet_both_sums_are_those_of_the_truth_sheet(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["table2"]
    rest = printed_sums(skip=DATA.planes)
    needed = two_plane_correction(rest, DATA.planes_mm)
    for correction, name in zip(needed, ("CW1", "CW2"), strict=True):
        assert correction.imag == pytest.approx(
            known["counterweight_WRY_needed_for_both_balances_kg_mm"][name], rel=1e-12
        )
    pure = CrankshaftSums(static_kg_mm=0j, dynamic_kg_mm2=printed_sums().dynamic_kg_mm2)
    first, second = two_plane_correction(pure, DATA.planes_mm)
    in_each = known["equivalent_correction_g_mm_in_each_counterweight_plane"]
    assert (abs(first) * 1e3, abs(second) * 1e3) == pytest.approx((in_each, in_each), rel=1e-12)
    assert DATA.overbalance_kg_mm == tuple(known["overbalance_target_kg_mm"])
    assert 8 < abs(first) / DATA.overbalance_kg_mm[1] < abs(first) / DATA.overbalance_kg_mm[0] < 11.1


def test_analytic_a_two_plane_correction_brings_both_sums_to_zero() -> None:
    sums = crankshaft_sums(DATA.sections)
    added = two_plane_correction(sums, DATA.planes_mm)
    weights = [
        CrankshaftSection(name="added", mass_kg=1.0, x_mm=one.real, y_mm=one.imag, z_mm=plane)
        for one, plane in zip(added, DATA.planes_mm, strict=True)
    ]
    after = crankshaft_sums([*DATA.sections, *weights])
    assert abs(after.static_kg_mm) < 1e-12 * 108
    assert abs(after.dynamic_kg_mm2) < 1e-12 * 9176


@given(datum=st.floats(-500, 500))
def test_analytic_the_couple_without_static_unbalance_knows_no_datum(datum: float) -> None:
    sums = CrankshaftSums(static_kg_mm=0j, dynamic_kg_mm2=3 + 4j)
    assert about_datum(sums, datum) == sums
    moved = [section.model_copy(update={"z_mm": section.z_mm - datum}) for section in DATA.sections]
    found = about_datum(crankshaft_sums(DATA.sections), datum).dynamic_kg_mm2
    assert abs(found - crankshaft_sums(moved).dynamic_kg_mm2) < 1e-9


def test_a_correction_in_one_plane_is_refused() -> None:
    with pytest.raises(RequestError, match="two planes"):
        two_plane_correction(CrankshaftSums(static_kg_mm=1j, dynamic_kg_mm2=1j), (10.0, 10.0))


@pytest.mark.parametrize(("inner", "fan"), [(0.0, 359.0), (0.0, 180.0), (20.0, 120.0), (30.0, 200.0), (59.9, 1e-3)])
def test_analytic_mass_and_centroid_of_a_fan_are_those_of_its_integral(inner: float, fan: float) -> None:
    weight = FanCounterweight(
        radius_mm=60.0, thickness_mm=18.0, fan_angle_deg=fan, density_kg_m3=7850.0, inner_radius_mm=inner
    )
    radius, share = np.polynomial.legendre.leggauss(40)
    radius = inner + (60 - inner) * (radius + 1) / 2
    share = share * (60 - inner) / 2
    half = np.radians(fan) / 2
    mass = 7850e-9 * 18 * 2 * half * np.sum(share * radius)
    moment = 7850e-9 * 18 * 2 * np.sin(half) * np.sum(share * radius**2)
    assert weight.mass_kg == pytest.approx(mass, rel=1e-12)
    assert weight.unbalance_kg_mm == pytest.approx(moment, rel=1e-12, abs=1e-15)


def test_analytic_a_half_disc_has_its_centroid_at_4r_over_3_pi() -> None:
    weight = FanCounterweight(radius_mm=60.0, thickness_mm=18.0, fan_angle_deg=180.0, density_kg_m3=7850.0)
    assert weight.centroid_mm == pytest.approx(4 * 60 / (3 * np.pi), rel=1e-15)


def test_literature_radius_then_thickness_then_fan_angle_change_the_balance_most() -> None:
    for fan in (60.0, 120.0, 180.0):
        sizes = {"radius_mm": 60.0, "thickness_mm": 18.0, "fan_angle_deg": fan}
        weight = FanCounterweight(**sizes, density_kg_m3=7850.0, inner_radius_mm=20.0)
        sense = weight.sensitivity
        assert sense["radius"] > sense["thickness"] > sense["fan_angle"] >= 0
        for name, key in (("radius", "radius_mm"), ("thickness", "thickness_mm"), ("fan_angle", "fan_angle_deg")):
            more = FanCounterweight(**(sizes | {key: sizes[key] * 1.0001}), density_kg_m3=7850.0, inner_radius_mm=20.0)
            less = FanCounterweight(**(sizes | {key: sizes[key] * 0.9999}), density_kg_m3=7850.0, inner_radius_mm=20.0)
            slope = (more.unbalance_kg_mm - less.unbalance_kg_mm) / weight.unbalance_kg_mm / 2e-4
            assert slope == pytest.approx(sense[name], abs=1e-6)  # type: ignore[index]


@pytest.mark.parametrize(
    "wrong", [{"radius_mm": 0.0}, {"fan_angle_deg": 360.0}, {"inner_radius_mm": 60.0}, {"density_kg_m3": float("nan")}]
)
def test_a_counterweight_that_cannot_be_is_refused(wrong: dict[str, float]) -> None:
    sizes = {"radius_mm": 60.0, "thickness_mm": 18.0, "fan_angle_deg": 120.0, "density_kg_m3": 7850.0}
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        FanCounterweight(**(sizes | wrong))


def test_analytic_a_slug_counts_by_the_difference_of_the_densities() -> None:
    slug = {"diameter_mm": 20.0, "length_mm": 30.0, "radius_mm": 50.0, "crank_density_kg_m3": 7850.0}
    found = slug_unbalance_kg_mm(**slug, slug_density_kg_m3=17850.0)
    assert found == pytest.approx(np.pi * 100 * 30 * 1e-9 * 10_000 * 50, rel=1e-14)
    assert slug_unbalance_kg_mm(**slug, slug_density_kg_m3=7850.0) == 0


def test_table_2_is_an_output_of_the_engine_file_row_by_row(truth: dict[str, Any]) -> None:
    table = balance_sheet(load_balanced_engine("msu-shafts"))["crankshaft"]
    for row, known in zip(table["sections"], truth["seed001"]["table2"]["rows"], strict=True):
        assert row["name"] == known["component"]
        assert complex(*row["static_kg_mm"].values()) == pytest.approx(complex(known["WRX"], known["WRY"]), rel=1e-12)
        assert complex(*row["dynamic_kg_mm2"].values()) == pytest.approx(complex(known["CX"], known["CY"]), rel=1e-12)
    assert not table["overbalance_met"]


def fan_crankshaft(**changes: Any) -> dict[str, Any]:
    """Content of the shipped file with counterweights by shape; ``changes`` of its crankshaft."""
    content = tomllib.loads(shipped("engines")["msu-crankshaft"])
    content["balance"]["crankshaft"] |= changes
    return content


def test_analytic_each_size_that_a_fan_is_told_to_have_brings_both_sums_to_zero() -> None:
    content = fan_crankshaft()
    planes = balance_sheet(balanced_engine(content, name="fans", source="fans.toml"))["crankshaft"]["planes"]
    assert planes[0]["fan"]["resized"]["fan_angle_deg"] is None  # no fan of half a turn is wide enough
    for size in ("radius_mm", "thickness_mm"):
        fans = [
            {**fan, size: plane["fan"]["resized"][size], "angle_deg": 0.0}
            for fan, plane in zip(content["balance"]["crankshaft"]["counterweights"], planes, strict=True)
        ]
        changed = balanced_engine(fan_crankshaft(counterweights=fans), name="fans", source="fans.toml")
        data = changed.balance.crankshaft
        assert data is not None
        sums = crankshaft_sums(data.parts)
        # what lies across the fans (x) they cannot correct without turning
        assert abs(sums.static_kg_mm.imag) < 1e-4 * 108
        assert abs(sums.dynamic_kg_mm2.imag) < 1e-4 * 9176


@given(
    st.floats(20, 300), st.floats(0, 0.95), st.floats(1, 350), st.floats(0.3, 1.5), st.floats(-40, 40), st.floats(1, 60)
)
def test_analytic_a_resized_fan_has_the_unbalance_asked_for(
    radius: float, inner: float, fan: float, more: float, angle: float, thickness: float
) -> None:
    weight = FanCounterweight(
        radius_mm=radius, inner_radius_mm=inner * radius, thickness_mm=thickness, fan_angle_deg=fan,
        density_kg_m3=7850.0, angle_deg=angle,
    )  # fmt: skip
    wanted = more * weight.unbalance_kg_mm
    for size, value in weight.resized(wanted).items():
        if value is not None:
            changed = weight.model_copy(update={size: value})
            # near a fan of half a turn the sine is flat: half the digits of the angle
            rel = 1e-7 if size == "fan_angle_deg" else 1e-9
            assert changed.unbalance_kg_mm == pytest.approx(wanted, rel=rel)
    at = weight.section
    assert abs(complex(at.x_mm, at.y_mm)) == pytest.approx(weight.centroid_mm, rel=1e-12)


def test_analytic_a_slug_moves_both_sums_by_its_own_product_and_place() -> None:
    with_slug = balanced_engine(fan_crankshaft(), name="fans", source="fans.toml").balance.crankshaft
    without = balanced_engine(fan_crankshaft(slugs=[]), name="fans", source="fans.toml").balance.crankshaft
    assert with_slug is not None
    assert without is not None
    added = np.pi / 4 * 20**2 * 30 * 1e-9 * (17600 - 7850) * 70
    moved = crankshaft_sums(with_slug.parts).static_kg_mm - crankshaft_sums(without.parts).static_kg_mm
    assert moved == pytest.approx(-1j * added, rel=1e-9)
    dynamic = crankshaft_sums(with_slug.parts).dynamic_kg_mm2 - crankshaft_sums(without.parts).dynamic_kg_mm2
    assert dynamic == pytest.approx(-1j * added * 38.3443, rel=1e-9)


def test_the_rod_as_cut_and_as_weighed_takes_the_place_of_the_bob_weight() -> None:
    content = fan_crankshaft()
    content["balance"]["rod_split"]["on_pin"] = {
        "mass_g": 1673.0, "centre_from_big_end_mm": 38.6, "rod_length_mm": 157.0916,
    }  # fmt: skip
    table = balance_sheet(balanced_engine(content, name="fans", source="fans.toml"))["crankshaft"]
    found = {one["method"]: one for one in table["bob_weights"]}
    assert list(found) == ["stated", "cut", "scale", "on pin"]
    assert found["on pin"]["mass_kg"] == pytest.approx(1.673 * (1 - 38.6 / 157.0916), rel=1e-12)
    change = found["scale"]["static_kg_mm"]["y"] - found["cut"]["static_kg_mm"]["y"]
    assert change == pytest.approx((1.2624 - 1.0159) * 47.3, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bob_weight": "Bob"}, "Bob"),
        ({"counterweights": ["Cheek 1"]}, "two counterweights or more"),
        ({"slugs": [{"into": "Cheek 1", "diameter_mm": 1.0, "length_mm": 1.0, "radius_mm": 9.0,
                     "density_kg_m3": 17600.0}]}, "one of the counterweights"),
        ({"slugs": [{"into": "Counterweight 1", "diameter_mm": 1.0, "length_mm": 31.0, "radius_mm": 9.0,
                     "density_kg_m3": 17600.0}]}, "longer than"),
        ({"slugs": [{"into": "Counterweight 1", "diameter_mm": 40.0, "length_mm": 3.0, "radius_mm": 70.0,
                     "density_kg_m3": 17600.0}]}, "stands out"),
        ({"counterweights": [{"shape": "cube"}, "Cheek 2"]}, "shape"),
    ],
)  # fmt: skip
def test_a_crankshaft_that_cannot_be_is_refused_by_name(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ManyErrors, match=message):
        balanced_engine(fan_crankshaft(**change), name="spoilt", source="spoilt.toml")
