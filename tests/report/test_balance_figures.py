"""The pictures of a balance show the forces of the model, legibly, and with the same bytes each time."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.text import Text

from crankorder.engine.balance_data import balanced_engine, load_balanced_engine
from crankorder.engine.balance_sheet import balance_sheet
from crankorder.engine.definition import Weight
from crankorder.engine.elastic_hinge import hinge_sheet
from crankorder.engine.forces import unbalance_force_n
from crankorder.engine.hinged_crank import load_hinged_engine
from crankorder.engine.slider_crank import plain_piston_acceleration
from crankorder.plot.painter import picture_bytes
from crankorder.report.balance import force_figures as pictures
from crankorder.report.balance.cycle_figures import cycle_dataset, guide_figure, hinge_figure, loads_figure
from crankorder.report.balance.dataset import balance_dataset
from crankorder.report.balance.sentences import balance_sentences, hinge_sentences
from crankorder.report.balance.text import MISSING, WIDTH, balance_text, hinge_text, shown_orders, text_table
from crankorder.settings import shipped, toml_table
from made.texts import overlaps

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


HARD = {
    "as short a rod as can be": ({"rod_length_m": 0.0251}, 1), "no masses": ({"reciprocating_mass_kg": 1e-9}, 1),
    "no forces": ({}, 0), "hostile": ({"title": "$\\frac{x}$ \x1b[31m 漢字 " + "w" * 300}, 1),
}  # fmt: skip
"""What of the engine task5 is another, and by what its forces are multiplied."""


@pytest.mark.cases(2)
@pytest.mark.parametrize("name", [*CRANK_ENGINES, *HARD])
def test_no_text_lies_on_another_no_two_systems_have_one_colour_and_the_bytes_are_the_same_each_time(name, settings):
    changes, share = HARD.get(name, ({}, 1))
    subject = _changed("task5", **changes) if name in HARD else load_balanced_engine(name)
    made = _dataset(subject, max_order=100 if name in HARD else 8)
    made = made.assign(force=share * made["force"], curve=share * made["curve"])
    systems = made["system"].values.tolist()
    assert len({pictures.system_color(system) for system in systems}) == len(systems)
    for draw in PICTURES:
        figure = draw(made, title=subject.engine.title, settings=settings)
        assert overlaps(figure) == []
        assert not any("\x1b" in text.get_text() for text in figure.findobj(Text))
    again = draw(made, title=subject.engine.title, settings=settings)
    assert picture_bytes(figure, dpi=50) == picture_bytes(again, dpi=50)


def test_the_polar_curve_of_the_bare_engine_is_the_exact_force(task5):
    engine, angle = load_balanced_engine("task5").engine, task5["crank_angle"].values
    exact = 11250 * np.exp(2j * np.pi * angle) + 320e3 * plain_piston_acceleration(angle, engine.mechanism)
    curve = task5["curve"].sel(system="none")
    assert np.abs(curve.sel(axis="x") - exact.real).max() < 1e-3  # of 21250 g·mm: orders above 8
    assert np.abs(curve.sel(axis="y") - exact.imag).max() < 1e-9


def test_arrows_go_round_as_the_force_does_and_a_line_has_none(task5, settings):
    figure = pictures.polar_figure(task5, title="t", settings=settings)
    turning: dict[str, list[float]] = {}
    counterweights = ["none", "a", "b", "c", "d"]  # twice: by the first harmonic alone, and by all
    names = [*counterweights, *counterweights, *task5["system"].values[5:]]
    for axes, name in zip(figure.axes, names, strict=True):
        for arrow in axes.texts:
            if arrow.get_text() or getattr(arrow, "arrow_patch", None) is None or not arrow.get_gid():
                continue
            start, end = np.array(arrow.xyann), np.array(arrow.xy)
            turning.setdefault(str(name), []).append(float(start[0] * end[1] - start[1] * end[0]))
    assert set(turning) == {"none", "c"}
    assert all(turn < 0 for turn in turning["none"])  # clockwise, as the crank: up is along the cylinder
    assert all(turn > 0 for turn in turning["c"])


def test_the_first_harmonic_of_strategy_c_is_a_circle_and_of_the_bare_engine_an_ellipse(task5, settings):
    figure = pictures.polar_figure(task5, title="t", settings=settings)
    curves = [next(line for line in axes.lines if line.get_gid() == "polar").get_data() for axes in figure.axes]
    newton = float(unbalance_force_n(1.0, SPEED))
    across, along = curves[3]
    assert np.hypot(across, along) == pytest.approx(160 * 25 * newton, rel=1e-12)  # document 000: 160 g, turning back
    across, along = curves[0]
    assert (along / (770 * 25)) ** 2 + (across / (450 * 25)) ** 2 == pytest.approx(newton**2, rel=1e-12)


def curves_of(figure):
    """The lines that have a name, by it."""
    return {str(line.get_gid()): line for axes in figure.axes for line in axes.lines if line.get_gid()}


def test_primary_and_secondary_force_add_up_as_in_figure_7_of_the_thesis(settings):
    subject = _changed("msu-standard", crank_radius_m=0.04, rod_length_m=0.16, reciprocating_mass_kg=1.0)
    figure = pictures.harmonics_figure(_dataset(subject), title="t", settings=settings)
    assert len(figure.axes) == 1  # nothing across
    primary, secondary, both, every = (
        np.asarray(curves_of(figure)[f"{name}-x"].get_ydata()) for name in ("primary", "secondary", "both", "all")
    )
    np.testing.assert_allclose(both, primary + secondary, rtol=1e-12, atol=1e-9)
    assert primary[0] == pytest.approx(40_000 * float(unbalance_force_n(1.0, SPEED)), rel=1e-12)
    assert every[0] / primary[0] == pytest.approx(1 + 0.25, abs=2e-6)  # exact at top dead centre: 1 + λ


@pytest.mark.parametrize("name", ["msu-optical-second", "v-twin", "inline-3"])
def test_amplitude_and_phase_stand_in_the_dataset_as_in_the_sheet(name):
    subject = load_balanced_engine(name)
    sheet, dataset = balance_sheet(subject, speeds_rpm=[SPEED]), _dataset(subject)
    for axis in "xy":
        found = dataset.sel(system="none", axis=axis)
        phases = sheet["force_phase_deg"][axis] or {}
        for order, amount in (sheet["force_g_mm"][axis] or {}).items():
            there, turn = found.sel(order=float(order)), np.exp(1j * np.radians(phases[order]))
            assert amount * turn == pytest.approx(complex(there["force"]), rel=1e-9)
            assert np.exp(1j * np.radians(float(there["phase"]))) == pytest.approx(turn, abs=1e-9)
    for about, phases in (sheet["moment_phase_deg"] if "moment" in dataset else {}).items():
        for order, phase in (phases or {}).items():
            found = complex(dataset["moment"].sel(moment_axis=about, order=float(order)).values)
            assert np.exp(1j * np.radians(phase)) == pytest.approx(found / abs(found), abs=1e-9)


def test_force_curves_are_in_newtons_at_the_highest_speed(task5, settings):
    lines = curves_of(pictures.force_figure(task5, title="t", settings=settings))
    for axis, column in (("x", 0), ("y", 1)):
        expected = unbalance_force_n(task5["curve"].values[0, column], SPEED)
        np.testing.assert_allclose(lines[f"force-{axis}-none"].get_ydata(), expected, rtol=1e-12, atol=1e-9)
    assert {"force-x-a", "force-x-b", "force-x-c", "force-x-1", "force-x-2", "force-x-3"} <= set(lines)
    assert "force-y-b" not in lines  # nothing is left across the cylinder: said in words


def test_bars_are_the_amplitudes_of_the_sheet(task5, settings):
    figure = pictures.order_bars_figure(task5, title="t", settings=settings)
    heights = sorted({round(bar.get_height(), 6) for axes in figure.axes for bar in axes.patches if bar.get_height()})
    grams = [19250.0, 11250.0, 8000.0, 4000.0, 2032.200338455802, 32.78488937623422]
    assert heights == sorted(round(float(unbalance_force_n(value, SPEED)), 6) for value in grams)


def test_loads_that_coincide_are_one_curve_with_both_names(settings):
    with_rod = load_balanced_engine("inline-4-firing").engine

    def drawn(engine):
        figure = loads_figure(cycle_dataset(engine, [SPEED]), title="", settings=settings)
        curves = [line for line in figure.axes[0].lines if len(line.get_xydata()) > 2]
        return len(curves), " ".join(text.get_text() for text in figure.texts)

    count, words = drawn(with_rod.model_copy(update={"rod": None}))  # what is left of the rod is at the piston
    assert count == 2 and "crank pin and piston pin alike" in words
    count, words = drawn(with_rod)
    assert count == 3 and "alike" not in words


def test_systems_that_leave_the_same_are_named_together(task5):
    groups = pictures.alike(task5["curve"])
    assert ["1", "4"] in groups and ["3", "4+2"] in groups
    assert pictures.called(["4", "1"], task5) == "shafts 1 and 4"
    assert pictures.called(["none", "b", "own"], task5) == "no balancing, strategy b, its own shafts"


def test_an_engine_whose_file_has_counterweights_is_drawn_as_built():
    subject = load_balanced_engine("v-twin")
    bare = subject.engine.model_copy(update={"rotating_unbalance_kg_m": 0.0})
    webbed = bare.model_copy(update={"webs": (Weight(unbalance_g_mm=50_000.0, angle_deg=180.0),)})
    for engine, name in ((subject.engine, "as built"), (webbed, "as built"), (bare, "no balancing")):
        made = _dataset(replace(subject, engine=engine))
        assert pictures.called(["none"], made) == name
        told = balance_sentences(balance_sheet(replace(subject, engine=engine)))[0]
        assert told.startswith("As built" if name == "as built" else "With no balancing")


def test_moments_of_several_cylinders_are_drawn_and_those_of_one_are_not(settings, task5):
    figure = pictures.force_figure(_dataset(load_balanced_engine("v-twin")), title="t", settings=settings)
    assert {"moment-about_x", "moment-about_y", "moment-about_crankshaft"} <= set(curves_of(figure))
    assert "moment" not in task5


@pytest.mark.cases(1)
@pytest.mark.parametrize("number", range(6))
def test_the_picture_of_each_hinge_mechanism_has_no_text_on_another(number, settings):
    engine = load_hinged_engine("elastic-hinge")
    mechanism = engine.mechanisms[number]
    figure = hinge_figure(engine, mechanism, mechanism.speeds_rpm, settings=settings)
    assert overlaps(figure) == []
    drawn = curves_of(figure)
    assert {"side-force-printed", "side-force-potential", "m12-full-0", "m12-printed-0", "torque-potential"} <= set(
        drawn
    )
    assert sum(name.startswith("pin-") for name in drawn) == len(mechanism.speeds_rpm)


def test_the_guides_of_both_hinges_are_drawn_to_scale(settings):
    engine = load_hinged_engine("elastic-hinge")
    mechanism = next(one for one in engine.mechanisms if one.pin_guides is not None)
    figure = guide_figure(engine, mechanism, 2865.0, settings=settings)
    assert overlaps(figure) == [] and len(figure.axes) == 2
    for axes in figure.axes:
        one, other = sorted(np.hypot(*line.get_data()).min() for line in axes.lines if line.get_gid() == "guide")
        assert other > mechanism.pin_guides.middle_radius_m > one > 0  # type: ignore[union-attr]


# The text of a balance fits a terminal, shows what the document holds and nothing that it does not.


def _sheet(name, **options):
    sheet = balance_sheet(load_balanced_engine(name), **options)
    return {**sheet, "sentences": balance_sentences(sheet)}


def _line(text, start):
    """Words of the first line that starts so."""
    return next(line for line in text.splitlines() if line.strip().startswith(start)).split()


@pytest.mark.parametrize("name", [*CRANK_ENGINES, "elastic-hinge"])
def test_no_line_is_wider_than_a_terminal_nothing_is_none_and_all_is_told(name):
    if name == "elastic-hinge":
        sheet = hinge_sheet(load_hinged_engine(name), max_order=8)
        text = hinge_text({**sheet, "sentences": hinge_sentences(sheet)})
    else:
        sheet = _sheet(name, speeds_rpm=(500.0, 1000.0, 1500.0, 2000.0, 2500.0, 3000.0, 123456.0), max_order=12)
        text = balance_text(sheet)
        told = " ".join(text.split())
        assert sheet["sentences"]
        assert all(" ".join(said.split()) in told for said in (*sheet["sentences"], *sheet["notes"]))
    assert max(map(len, text.splitlines())) <= WIDTH
    assert not set(text.split()) & {"None", "nan", "inf", "NaN"}


def test_strategies_stand_side_by_side_with_the_masses_of_the_document():
    text = balance_text(_sheet("task5"))
    assert _line(text, "counterweight on the crank, g")[-5:] == [MISSING, "962.5", "562.5", "762.5", "1962.5"]
    assert _line(text, "counterweight on the rod, g")[-1] == "800"
    assert _line(text, "order 1 along, g·mm")[-5:] == ["19250", "0", "8000", "4000", "0"]
    assert _line(text, "order 1 across, g·mm")[-5:] == ["11250", "8000", "0", "4000", "0"]
    assert "against crank" in next(line for line in text.splitlines() if "order 1 turns" in line)
    assert "opposite to the pin" not in text  # the angle of a counterweight is shown where there is one
    sheet = _sheet("task5")
    sheet["strategies"]["b"]["counterweight_deg"] = 37.0
    assert _line(balance_text(sheet), "… on from opposite to the pin")[-5:] == [MISSING, "0", "37", "0", "0"]


def test_an_engine_of_several_cylinders_shows_forces_and_moments_and_no_strategy():
    text = balance_text(_sheet("v-twin"))
    assert [words in text for words in ("Moments by order", "Strategies", "Additional shafts")] == [True, False, False]


def test_shaft_parts_the_crankshaft_and_both_readings_of_a_printed_pair_are_shown():
    text = balance_text(_sheet("msu-shafts"))
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
    text = balance_text({**sheet, "engine": evil, "notes": [evil], "crankshaft": crankshaft, "sentences": [evil]})
    assert not {"\x1b", "\x07"} & set(text)
    assert max(map(len, text.splitlines())) <= WIDTH


def test_a_wide_table_repeats_the_names_of_its_rows():
    lines = text_table("T", ["name", *(f"column {n}" for n in range(20))], [["row", *map(float, range(20))]])
    assert max(map(len, lines)) <= WIDTH
    assert sum("row" in line for line in lines) > 1
    assert [float(word) for line in lines if "row" in line for word in line.split()[1:]] == list(map(float, range(20)))


def test_orders_that_nobody_can_feel_are_left_out_of_the_text():
    assert shown_orders([{"1": 1.0, "2": 1e-12}, None, {"10": 0.5}]) == ["1", "10"]
    assert len(shown_orders([{str(order): 1.0 for order in range(1, 800)}])) < 50
