"""The pictures of a balance show the forces of the model, legibly, and with the same bytes each time."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest

from crankorder.engine.balance_data import balanced_engine, load_balanced_engine
from crankorder.engine.balance_sheet import balance_sheet
from crankorder.engine.cycle_tables import PARTS
from crankorder.engine.definition import Weight
from crankorder.engine.elastic_hinge import hinge_sheet
from crankorder.engine.forces import speed_key, unbalance_force_n
from crankorder.engine.hinged_crank import load_hinged_engine
from crankorder.engine.slider_crank import plain_piston_acceleration
from crankorder.plot.drawing import Area
from crankorder.plot.painter import picture_bytes
from crankorder.report import balance_figures as pictures
from crankorder.report.balance_dataset import alike, balance_dataset, called, cycle_dataset
from crankorder.report.balance_figures import guide_figure, hinge_figure, loads_figure
from crankorder.report.balance_sentences import balance_sentences, hinge_sentences
from crankorder.report.balance_text import MISSING, WIDTH, balance_text, hinge_text, shown_orders, text_table
from crankorder.settings import shipped, toml_table
from report.conftest import overlaps

CRANK_ENGINES = sorted(set(shipped("engines")) - {"elastic-hinge"})
PICTURES = [pictures.polar_figure, pictures.force_figure, pictures.order_bars_figure, pictures.harmonics_figure]
SPEED = 3000.0


def _dataset(subject, max_order=8):
    sheet = balance_sheet(subject, max_order=max_order, speeds_rpm=[SPEED])
    return balance_dataset(subject, sheet, max_order=max_order, speeds_rpm=[SPEED])


def _changed(name, **values):
    """A shipped engine without its balance table and with other values."""
    table, _ = toml_table(name, "engines")
    table.pop("balance", None)
    return balanced_engine({**table, **values}, name=name, source=name)


@pytest.fixture(scope="module")
def task5():
    return _dataset(load_balanced_engine("task5"))


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", CRANK_ENGINES)
@pytest.mark.parametrize("draw", PICTURES)
def test_no_text_lies_on_another_and_no_two_systems_have_one_colour_for_any_engine(name, draw, settings):
    made = _dataset(load_balanced_engine(name))
    assert overlaps(draw(made, title=name, settings=settings)) == []
    systems = made["system"].values
    assert len({pictures.system_color(str(system)) for system in systems}) == len(systems)


@pytest.mark.cases(1)
@pytest.mark.parametrize("draw", PICTURES)
def test_the_same_balance_gives_the_same_bytes_and_another_gives_others(draw, settings, task5):
    first, second = (picture_bytes(draw(task5, title="t", settings=settings), dpi=50) for _ in range(2))
    assert first == second
    other = _dataset(load_balanced_engine("msu-standard"))
    assert picture_bytes(draw(other, title="t", settings=settings), dpi=50) != first


@pytest.mark.cases(1)
@pytest.mark.parametrize("draw", PICTURES)
@pytest.mark.parametrize(
    ("hard", "share"),
    [
        ({"rod_length_m": 0.0251}, 1), ({"reciprocating_mass_kg": 1e-9}, 1), ({}, 0),
        ({"title": "$\\frac{x}$ \x1b[31m 漢字 " + "w" * 300}, 1),
    ],
)  # fmt: skip
def test_extreme_and_forceless_engines_and_hostile_titles_are_drawn(draw, hard, share, settings):
    subject = _changed("task5", **hard)
    made = _dataset(subject, max_order=100)
    made = made.assign(force=share * made["force"], curve=share * made["curve"])
    figure = draw(made, title=subject.engine.title, settings=settings)
    assert overlaps(figure) == []
    assert len(picture_bytes(figure, dpi=50)) > 1000
    assert not any("\x1b" in words.text for words in figure.words)


def test_the_polar_curve_of_the_bare_engine_is_the_exact_force(task5):
    engine, angle = load_balanced_engine("task5").engine, task5["crank_angle"].values
    exact = 11250 * np.exp(2j * np.pi * angle) + 320e3 * plain_piston_acceleration(angle, engine.mechanism)
    curve = task5["curve"].sel(system="none")
    assert np.abs(curve.sel(axis="Z") - exact.real).max() < 1e-3  # of 21250 g·mm: orders above 8
    assert np.abs(curve.sel(axis="X") - exact.imag).max() < 1e-9


def _areas(drawing, prefix):
    """Areas whose names begin with ``prefix``."""
    return [part for part in drawing.parts if isinstance(part, Area) and part.name.startswith(prefix)]


@pytest.mark.slow
def test_arrows_go_round_as_the_force_does_and_a_line_has_none(task5, settings):
    figure = pictures.polar_figure(task5, title="t", settings=settings)
    turning: dict[str, list[float]] = {}
    counterweights = ["none", "a", "b", "c", "d"]  # twice: by the first harmonic alone, and by all
    names = [*counterweights, *counterweights, *task5["system"].values[5:]]
    polars = figure.strokes("polar")
    for polar, name in zip(polars, names, strict=True):
        left, bottom, width, height = polar.within
        middle = np.array([left + width / 2, bottom + height / 2])
        for arrow in _areas(figure, "sense"):
            tip, *base = arrow.points - middle
            if arrow.color == polar.color and (np.abs(tip) < width / 2).all():
                start = np.mean(base, axis=0)
                turning.setdefault(str(name), []).append(float(start[0] * tip[1] - start[1] * tip[0]))
    assert set(turning) == {"none", "c"}
    assert all(turn < 0 for turn in turning["none"])  # clockwise, as the crank: up is along the cylinder
    assert all(turn > 0 for turn in turning["c"])


@pytest.mark.slow
def test_the_first_harmonic_of_strategy_c_is_a_circle_and_of_the_bare_engine_an_ellipse(task5, settings):
    curves = [line.values for line in pictures.polar_figure(task5, title="t", settings=settings).strokes("polar")]
    newton = float(unbalance_force_n(1.0, SPEED))
    across, along = curves[3]
    assert np.hypot(across, along) == pytest.approx(160 * 25 * newton, rel=1e-12)  # document 000: 160 g, turning back
    across, along = curves[0]
    assert (along / (770 * 25)) ** 2 + (across / (450 * 25)) ** 2 == pytest.approx(newton**2, rel=1e-12)
    across, along = curves[5]
    assert np.abs((along / (770 * 25)) ** 2 + (across / (450 * 25)) ** 2 - newton**2).max() > 0.1 * newton**2


def test_primary_and_secondary_force_add_up_as_in_figure_7_of_the_thesis(settings):
    ratio = 0.25
    subject = _changed("msu-standard", crank_radius_m=0.04, rod_length_m=0.16, reciprocating_mass_kg=1.0)
    figure = pictures.harmonics_figure(_dataset(subject), title="t", settings=settings)
    lines = {line.name: line.values[1] for line in figure.strokes("") if line.name}
    assert not [name for name in lines if name.endswith("-X")]  # nothing across: one panel
    np.testing.assert_allclose(lines["both-Z"], lines["primary-Z"] + lines["secondary-Z"], rtol=1e-12, atol=1e-9)
    top, bottom = 0, 360
    assert lines["primary-Z"][top] == pytest.approx(40_000 * float(unbalance_force_n(1.0, SPEED)), rel=1e-12)
    # "25 % more at top dead centre, 25 % less at the bottom": λ, where A2 is 1.6 % more than that
    for at, sign in ((top, 1), (bottom, -1)):
        assert sign * lines["secondary-Z"][at] / lines["primary-Z"][at] == pytest.approx(
            0.254025042306975277, rel=1e-12
        )
    assert lines["all-Z"][top] / lines["primary-Z"][top] == pytest.approx(1 + ratio, abs=2e-6)  # exact: 1 + λ


def test_amplitude_and_phase_stand_in_the_dataset_as_in_the_sheet():
    for name in ("msu-optical-second", "msu-optical-second-firing", "v-twin", "inline-3", "inline-4-firing"):
        subject = load_balanced_engine(name)
        sheet = balance_sheet(subject, speeds_rpm=[SPEED])
        dataset, short = _dataset(subject), balance_text({**sheet, "sentences": balance_sentences(sheet)})
        assert {axis: dataset.attrs[axis] for axis in sheet["frame"]} == sheet["frame"]
        assert all(f"{axis} {sheet['frame'][axis]}" in " ".join(short.split()) for axis in "XYZ")
        assert "oll moment" in short
        for order, row in sheet["roll_moment"]["by_speed"][speed_key(SPEED)].items():
            for part in PARTS:
                peak = complex(dataset["roll_moment"].sel(part=part, speed=SPEED, gas_order=float(order)))
                assert peak == pytest.approx(cmath.rect(row[f"{part}_n_m"], math.radians(row[f"{part}_phase_deg"])))
        for axis in "ZX":
            amplitudes, phases = (force[axis] or {} for force in (sheet["force_g_mm"], sheet["force_phase_deg"]))
            assert list(amplitudes) == list(phases)
            found = dataset.sel(system="none", axis=axis)
            for order, amount in amplitudes.items():
                there = complex(found["force"].sel(order=float(order)).values)
                turn = amount * np.exp(1j * np.radians(phases[order]))
                assert turn == pytest.approx(there, rel=1e-9)
                assert np.exp(1j * np.radians(found["phase"].sel(order=float(order)).values)) == pytest.approx(
                    there / abs(there), abs=1e-9
                )
        for about, phases in (sheet["moment_phase_deg"] if "moment" in dataset else {}).items():
            rows = [row.split() for row in _whole(sheet) if f"about {about}" in row]
            for order, phase in (phases or {}).items():
                shown = [row[3] for row in rows if row[0] == order][:1]
                assert not shown or float(shown[0]) == pytest.approx(sheet["moment_g_mm2"][about][order], rel=1e-4)
                found = complex(dataset["moment"].sel(moment_axis=about, order=float(order)).values)
                assert abs(np.exp(1j * np.radians(phase)) - found / abs(found)) < 1e-9


def test_force_curves_are_in_newtons_at_the_highest_speed(task5, settings):
    figure = pictures.force_figure(task5, title="t", settings=settings)
    lines = {line.name: line.values[1] for line in figure.strokes("force-")}
    for axis, column in (("Z", 0), ("X", 1)):
        expected = unbalance_force_n(task5["curve"].values[0, column], SPEED)
        np.testing.assert_allclose(lines[f"force-{axis}-none"], expected, rtol=1e-12, atol=1e-9)
    assert {"force-Z-a", "force-Z-b", "force-Z-c", "force-Z-1", "force-Z-2", "force-Z-3"} <= set(lines)
    assert "force-X-b" not in lines  # nothing is left across the cylinder: said in words


def test_bars_are_the_amplitudes_of_the_sheet(task5, settings):
    figure = pictures.order_bars_figure(task5, title="t", settings=settings)
    grams = [19250.0, 11250.0, 8000.0, 4000.0, 2032.200338455802, 32.78488937623422]
    newtons = np.log([float(unbalance_force_n(value, SPEED)) for value in grams])
    tops: dict[float, set[float]] = {}
    for bar in _areas(figure, "bars-"):
        tops.setdefault(bar.within[1], set()).add(round(float(np.nanmax(bar.points[:, 1])) - bar.within[1], 9))
    across, along = (sorted(tops[foot]) for foot in sorted(tops))
    assert len(along) + len(across) == len(grams) + 2
    slope = (along[-1] - along[0]) / (newtons[0] - newtons[-1])
    expected = along[-1] + slope * (newtons - newtons[0])
    assert all(np.abs(expected - top).min() < 1e-6 for top in (*along, *across))


@pytest.mark.slow
def test_loads_that_coincide_are_one_curve_with_both_names(settings):
    with_rod = load_balanced_engine("inline-4-firing").engine

    def drawn(engine):
        figure = loads_figure(cycle_dataset(engine, [SPEED]), title="", settings=settings)
        highest = max(line.within[1] for line in figure.strokes("") if line.within)
        curves = [line for line in figure.strokes("") if line.within and line.within[1] == highest]
        return sum(len(line.points) > 2 for line in curves), " ".join(words.text for words in figure.words)

    count, words = drawn(with_rod.model_copy(update={"rod": None}))  # what is left of the rod is at the piston
    assert count == 2 and "crank pin and piston pin alike" in words
    count, words = drawn(with_rod)
    assert count == 3 and "alike" not in words


@pytest.mark.slow
def test_systems_that_leave_the_same_are_named_together(task5):
    groups = alike(task5["curve"])
    assert ["1", "4"] in groups
    assert ["3", "4+2"] in groups
    assert called(["4", "1"], task5) == "shafts 1 and 4"
    assert called(["none", "b", "own"], task5) == "no balancing, strategy b, its own shafts"


@pytest.mark.slow
def test_an_engine_whose_file_has_counterweights_is_drawn_as_built():
    subject = load_balanced_engine("v-twin")
    bare = subject.engine.model_copy(update={"rotating_unbalance_kg_m": 0.0})
    web = Weight(unbalance_g_mm=50_000.0, angle_deg=180.0)
    webbed = bare.model_copy(update={"webs": (web,)})
    for engine, name in ((subject.engine, "as built"), (webbed, "as built"), (bare, "no balancing")):
        made = _dataset(replace(subject, engine=engine))
        assert called(["none"], made) == name
        told = balance_sentences(balance_sheet(replace(subject, engine=engine)))[0]
        assert told.startswith("As built" if name == "as built" else "With no balancing")


def test_moments_of_several_cylinders_are_drawn_and_those_of_one_are_not(settings, task5):
    four = _dataset(load_balanced_engine("v-twin"))
    figure = pictures.force_figure(four, title="t", settings=settings)
    drawn = {line.name for line in figure.strokes("moment-")}
    assert {"moment-X", "moment-Y", "moment-Z"} <= drawn
    assert "moment" not in task5


@pytest.mark.cases(1)
@pytest.mark.parametrize("number", range(6))
def test_the_picture_of_each_hinge_mechanism_has_no_text_on_another(number, settings):
    engine = load_hinged_engine("elastic-hinge")
    mechanism = engine.mechanisms[number]
    figure = hinge_figure(engine, mechanism, mechanism.speeds_rpm, settings=settings)
    assert overlaps(figure) == []
    assert len(figure.strokes("pin-")) == len(mechanism.speeds_rpm)
    drawn = {line.name for line in figure.strokes("")}
    assert {"side-force-printed", "m12-full-0", "m12-printed-0", "torque-potential"} <= drawn
    nothing = any(words.text.startswith("nothing: of a spring") for words in figure.words)
    assert ("side-force-potential" in drawn) != nothing


@pytest.mark.slow
def test_the_guides_of_both_hinges_are_drawn_to_scale(settings):
    engine = load_hinged_engine("elastic-hinge")
    mechanism = next(one for one in engine.mechanisms if one.pin_guides is not None)
    figure = guide_figure(engine, mechanism, 2865.0, settings=settings)
    assert overlaps(figure) == []
    guides = figure.strokes("guide")
    assert len(guides) == 4
    for outer, inner in (guides[:2], guides[2:]):
        reach = [np.hypot(*guide.values).min() for guide in (outer, inner)]
        assert reach[0] > mechanism.pin_guides.middle_radius_m > reach[1] > 0


def _whole(sheet):
    return balance_text({**sheet, "sentences": []}, whole=True).splitlines()


# The text of a balance fits a terminal, shows what the document holds and nothing that it does not.


def _sheet(name, **options):
    sheet = balance_sheet(load_balanced_engine(name), **options)
    return {**sheet, "sentences": balance_sentences(sheet)}


def _line(text, start):
    """Words of the first line that starts so."""
    return next(line for line in text.splitlines() if line.strip().startswith(start)).split()


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", [*CRANK_ENGINES, "elastic-hinge"])
@pytest.mark.parametrize("speeds", [None, (500.0, 1000.0, 1500.0, 2000.0, 2500.0, 3000.0, 123456.0)])
def test_no_line_is_wider_than_a_terminal_nothing_is_none_and_all_is_told(name, speeds):
    if name == "elastic-hinge":
        sheet = hinge_sheet(load_hinged_engine(name), max_order=8)
        text = hinge_text({**sheet, "sentences": hinge_sentences(sheet)}, whole=True)
    else:
        sheet = _sheet(name, speeds_rpm=speeds, max_order=12)
        text, short = (balance_text(sheet, whole=whole).splitlines() for whole in (True, False))
        assert len(short) <= 40 and set(short[:-2]) < set(text)
        text = "\n".join(text)
        told = " ".join(text.split())
        assert sheet["sentences"]
        assert all(" ".join(said.split()) in told for said in (*sheet["sentences"], *sheet["notes"]))
    assert max(map(len, text.splitlines())) <= WIDTH
    assert not set(text.split()) & {"None", "nan", "inf", "NaN"}


def test_strategies_stand_side_by_side_with_the_masses_of_the_document():
    text = balance_text(_sheet("task5"), whole=True)
    assert _line(text, "counterweight on the crank, g")[-5:] == [MISSING, "962.5", "562.5", "762.5", "1962.5"]
    assert _line(text, "counterweight on the rod, g")[-1] == "800"
    assert _line(text, "order 1 along, g·mm")[-5:] == ["19250", "none", "8000", "4000", "none"]
    assert _line(text, "order 1 across, g·mm")[-5:] == ["11250", "8000", "none", "4000", "none"]
    assert "against crank" in next(line for line in text.splitlines() if "order 1 turns" in line)


@pytest.mark.slow
def test_the_angle_of_a_counterweight_is_shown_only_where_there_is_one():
    sheet = _sheet("task5")
    assert "opposite to the pin" not in balance_text(sheet, whole=True)
    turned = {**sheet["strategies"], "b": {**sheet["strategies"]["b"], "counterweight_deg": 37.0}}
    sheet = {**sheet, "strategies": turned}
    assert _line(balance_text(sheet, whole=True), "… on from opposite to the pin")[-5:] == [
        MISSING,
        "0",
        "37",
        "0",
        "0",
    ]


def test_an_engine_of_several_cylinders_shows_forces_and_moments_and_no_strategy():
    text = balance_text(_sheet("v-twin"), whole=True)
    assert "Moments of the masses by order" in text
    assert "Strategies" not in text
    assert "Additional shafts" not in text


@pytest.mark.slow
def test_shaft_parts_the_crankshaft_and_both_readings_of_a_printed_pair_are_shown():
    text = balance_text(_sheet("msu-shafts"), whole=True)
    assert "−44974" in text
    sums = [line.split() for line in text.splitlines() if line.split()[:1] == ["sum"]]
    cells = [cell for line in sums for cell in line[1:] if cell != "–"]
    assert cells == ["−0.0083306", "0.0098489", "0.43007", "1354.3"]
    assert _line(text, "Counterweight 1")[2] == "1.865"  # of table 2; the planes come after it


def test_text_from_a_file_cannot_reach_the_terminal_raw():
    sheet = _sheet("msu-shafts")
    evil = "\x1b[31mred\x07" + "w" * 200
    first, second = sheet["crankshaft"]["planes"]
    crankshaft = {**sheet["crankshaft"], "planes": [{**first, "name": evil}, second]}
    text = balance_text(
        {**sheet, "engine": evil, "notes": [evil], "crankshaft": crankshaft, "sentences": [evil]}, whole=True
    )
    assert "\x1b" not in text
    assert "\x07" not in text
    assert max(map(len, text.splitlines())) <= WIDTH


def test_a_wide_table_repeats_the_names_of_its_rows():
    lines = text_table("T", ["name", *(f"column {n}" for n in range(20))], [["row", *map(float, range(20))]])
    assert max(map(len, lines)) <= WIDTH
    assert sum("row" in line for line in lines) > 1
    assert [float(word) for line in lines if "row" in line for word in line.split()[1:]] == list(map(float, range(20)))


def test_orders_that_nobody_can_feel_are_left_out_of_the_text():
    assert shown_orders([{"1": 1.0, "2": 1e-12}, None, {"10": 0.5}]) == ["1", "10"]
    assert len(shown_orders([{str(order): 1.0 for order in range(1, 800)}])) < 50
