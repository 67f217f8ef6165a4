"""Every line has one cause, and only one that the evidence supports."""

import dataclasses

import numpy as np
import pytest

from crankorder.engine.machine_parts import Bearing, bearing_orders
from crankorder.findings import BearingFinding
from crankorder.identify.explain import Beside, Cause, Causes, MachineModel, explained, with_neighbours_named
from crankorder.identify.found import Tone
from crankorder.identify.lines.line_evidence import ShownAlias
from crankorder.identify.lines.line_phasors import NO_PULSES
from crankorder.identify.machine_model import StatedPart
from crankorder.identify.modes.tones import without_doubles
from crankorder.identify.sidebands import race_cause, struck_races
from crankorder.ingest.manifest import Gear
from crankorder.quantities import is_cylinder_pressure
from crankorder.report.sentences.of_lines import LIKE_UNBALANCE
from crankorder.shaft.aliasing import Alias
from made.found_lines import SPEEDS_RPM, agreed, fit, line, mode
from made.shipped import IDENTIFY
from made.typed import record_of

FOUR_STROKE = MachineModel(revs_per_cycle=2)
ROTOR = MachineModel(revs_per_cycle=1)
ENGINE = MachineModel(revs_per_cycle=2, engine_orders=(1.0, 2.0, 4.0))
JACK_SHAFT = Bearing(name="jack shaft", shaft_ratio=0.5, rolling_elements=11, ball_over_pitch=0.2)


def causes(orders, sources, *, modal=None, bearings=(), quantity="acceleration", unit="m/s2", folds=()):
    measured = {"quantity": dict.fromkeys("ABC", quantity)}
    beside = Beside(in_cylinder="ABC" if is_cylinder_pressure(quantity, unit) else "", folds=folds)
    given = {"sources": sources, "settings": IDENTIFY, "beside": beside, **measured}
    return explained(tuple(orders), modal or fit(), list(bearings), **given)


def texts(orders, sources, **given):
    return {order: cause.text for (_, order), cause in causes(orders, sources, **given).orders.items()}


def tone(hertz, kind, size=1.0):
    return Tone(hertz, 0.005, kind, {"A": (size, 0.01)}, "")  # type: ignore[arg-type]


def bearing_record(bearing, name, order, *, half=1e-3, seen_in="vibration"):
    ends = (order - half, order + half)
    told = {"name": bearing.name, "line": name, "order": order, "order_ci95": ends, "seen_in": seen_in}
    return record_of(BearingFinding, told)


def agreed_at(*orders, **options):
    return [agreed(order, **options) for order in orders]


LIFTED = [agreed(float(k), line(float(k), a, speed_rpm=[2000.0])) for k, a in {22: 0.2, 23: 1.0, 24: 0.3}.items()]
FIRING, TWO_STROKE = (dataclasses.replace(of, **{key: True}) for of, key in ((ENGINE, "firing"), (ROTOR, "two_stroke")))
JACK = dataclasses.replace(ENGINE, bearings=(JACK_SHAFT,))
HALF, KINEMATICS, HARMONIC = "half order of the four-stroke cycle", "engine kinematics", "shaft harmonic"
FOLD = ShownAlias(
    Alias(7200.0, np.arange(3), 1e-4, "lines are one of 7200 Hz folded"), SPEEDS_RPM, np.full(SPEEDS_RPM.size, 7.31),
    0.02,
)  # fmt: skip
PRESSURE = {"quantity": "pressure", "unit": "bar"}
TEXTS = [
    # the moving masses, whose orders do not slip
    (agreed_at(1.0, 2.0, 4.0, 8.0), ENGINE, {}, [*3 * [KINEMATICS], "unexplained"]),
    (agreed_at(2.01, lock="slips"), ENGINE, {}, ["unexplained"]),
    (agreed_at(2.004, lock="undecided", error=0.002), ENGINE, {}, [KINEMATICS]),
    (agreed_at(2.004, lock="undecided", error=0.001), ENGINE, {}, ["unexplained"]),
    # an order that is hardly known is no multiple of the cycle for that
    *((agreed_at(7.31, 6.98, lock="undecided", error=error), ROTOR, {}, ["unexplained", is_one])
      for error, is_one in ((0.2, "unexplained"), (0.05, HARMONIC))),
    # the gas cycle: in cylinders, and not in the air nor where there is no piston
    *((agreed_at(0.5, 1.0, 1.5, 2.0), ENGINE, {"quantity": quantity, "unit": unit}, 4 * ["gas cycle"])
      for quantity, unit in (("pressure", "bar"), ("cylinder pressure", "Pa"), ("Cylinder_Pressure", "kPa"))),
    *((agreed_at(1.0, 2.0, 3.0), sources, {"quantity": quantity, "unit": unit}, wanted)
      for quantity, unit in (("sound pressure", "Pa"), ("pressure", "Pa"), ("sound_pressure", "bar"))
      for sources, wanted in ((ENGINE, [KINEMATICS, KINEMATICS, "unexplained"]), (ROTOR, 3 * [HARMONIC]))),
    (agreed_at(1.0), ROTOR, PRESSURE, [HARMONIC]),
    (agreed_at(1.0), TWO_STROKE, PRESSURE, ["gas cycle"]),
    (agreed_at(0.5, 1.0, 1.5, 3.0), FIRING, {},
     ["gas cycle", "gas cycle or engine kinematics", "gas cycle", "gas cycle"]),
    (agreed_at(0.5, 1.0, 1.5, 3.0), ENGINE, {}, [HALF, "gas cycle or engine kinematics", HALF, "unexplained"]),
    # one lone half order of a motored engine proves no cycle
    (agreed_at(5.5, 1.0), ENGINE, {}, ["unexplained", KINEMATICS]),
    *((agreed_at(5.5, 1.0), of, {}, [half, HARMONIC]) for of, half in ((FOUR_STROKE, HALF), (ROTOR, "unexplained"))),
    # a locked line at balls times shaft speed may as well be an eleven-fold part
    (agreed_at(5.5), JACK, {"bearings": [bearing_record(JACK_SHAFT, "N*fs", 5.5)]},
     ["bearing jack shaft N*fs or an 11-fold part of that shaft"]),
    (agreed_at(5.46, lock="slips"), JACK, {"bearings": [bearing_record(JACK_SHAFT, "N*fs", 5.46)]},
     ["bearing jack shaft N*fs"]),
    # a harmonic that a mode lifts is no mesh, a shaft of its own speed is told by its multiples, a fold is a fold
    (LIFTED, ROTOR, {"modal": fit(mode(23 * 2000 / 60))}, 3 * [HARMONIC]),
    (agreed_at(1.005, 2.01, 3.015, lock="slips"), ROTOR, {},
     [begin + "a second shaft at 1.005" for begin in ("", "harmonic 2 of ", "harmonic 3 of ")]),
    (agreed_at(7.31, 9.2, lock="slips"), ROTOR, {"folds": (FOLD,)}, ["fold of 7200 Hz", "unexplained"]),
]  # fmt: skip


@pytest.mark.cases(len(TEXTS))
@pytest.mark.parametrize(("orders", "sources", "given", "wanted"), TEXTS)
def test_an_order_has_the_cause_that_its_evidence_supports(orders, sources, given, wanted):
    assert list(texts(orders, sources, **given).values()) == wanted


GROWN = [
    ("acceleration", 2.0, "unbalance"), ("acceleration", 0.0, HARMONIC), ("velocity", 1.0, "unbalance"),
    ("displacement", 0.0, "unbalance"), ("displacement", -1.5, HARMONIC),
]  # fmt: skip


@pytest.mark.cases(len(GROWN))
@pytest.mark.parametrize(("quantity", "exponent", "text"), GROWN)
def test_order_one_is_unbalance_only_if_it_grows_like_one_in_its_quantity(quantity, exponent, text):
    """A mass on a soft mount, far above its resonance, moves by its own eccentricity whatever the speed."""
    noise = 1 + 0.01 * np.random.default_rng(2).standard_normal(SPEEDS_RPM.size)
    grown = line(1.0, (SPEEDS_RPM / 1000) ** exponent * noise)
    cause = causes([agreed(1.0, grown)], ROTOR, quantity=quantity).orders["A", 1.0]
    assert cause.text == text
    assert float(cause.evidence.split("speed to the ")[1].split(" ")[0]) == pytest.approx(exponent, abs=0.03)


def test_order_one_at_one_or_two_speeds_may_be_unbalance_bent_shaft_or_misalignment():
    for speeds in ([1500.0], np.linspace(1480.0, 1520.0, 12)):
        cause = causes([agreed(1.0, line(1.0, speed_rpm=speeds))], ROTOR).orders["A", 1.0]
        assert cause.text == LIKE_UNBALANCE and "too few speeds" in cause.evidence
        assert "does not grow as unbalance does" not in cause.evidence
    cause = causes([agreed(1.0, line(1.0, speed_rpm=[1000.0, 3000.0]))], ROTOR).orders["A", 1.0]
    assert cause.text == LIKE_UNBALANCE
    assert "from 1000 to 3000 rpm it does not grow as unbalance does, unless a natural frequency" in cause.evidence
    grows = line(1.0, [1.0, 9.0], speed_rpm=[1000.0, 3000.0])
    assert causes([agreed(1.0, grows)], ROTOR).orders["A", 1.0].doubt != "slower than unbalance"


def test_a_mode_below_the_speeds_lowers_the_exponent_of_an_unbalance():
    at = mode(SPEEDS_RPM.min() / 60.0 / 1.1, 0.02)
    ratio = SPEEDS_RPM / 60.0 / at.frequency_hz
    size = ratio**4 / np.abs(1.0 - ratio**2 + 0.04j * ratio)
    one = [agreed(1.0, line(1.0, size, error=0.01 * float(size.min())))]
    assert "shaft harmonic" not in texts(one, ROTOR, modal=fit(at)).values()
    flat = [agreed(1.0, line(1.0))]
    assert texts(flat, ROTOR) == {1.0: "shaft harmonic"}


def test_a_race_is_matched_within_its_interval_and_never_by_a_locked_line():
    sources = dataclasses.replace(ROTOR, bearings=(JACK_SHAFT,))
    outer = bearing_orders(JACK_SHAFT)["BPFO"] * 0.99
    record = bearing_record(JACK_SHAFT, "BPFO", outer)
    orders = [agreed(order, lock="slips") for order in (outer, 2 * outer, outer + 0.015)]
    found = texts(orders, sources, bearings=[record])
    assert found[outer] == "bearing jack shaft BPFO"
    assert found[2 * outer] == "bearing jack shaft BPFO, harmonic 2"
    assert found[outer + 0.015] == "unexplained"
    on_order_two = bearing_record(JACK_SHAFT, "BPFO", 2.0)
    assert texts([agreed(2.0)], sources, bearings=[on_order_two]) == {2.0: "shaft harmonic"}


def test_a_mesh_is_told_by_its_sidebands_and_named_where_it_was_stated():
    orders = [agreed(1.0, line(1.0, speed_rpm=[2000.0])), *LIFTED]
    found = texts(orders, ROTOR)
    assert found[23.0] == "shaft harmonic or gear mesh or blade passing"
    assert found[22.0] == found[24.0] == "sideband of order 23 spaced by 1"
    assert found[1.0] == LIKE_UNBALANCE
    stated = texts(orders, dataclasses.replace(ROTOR, gears=(StatedPart("gear mesh", "pinion", 23.0),)))
    assert stated[23.0] == "gear mesh pinion" and stated[22.0] == "sideband of order 23 spaced by 1"


def test_each_channel_has_its_own_cause():
    order = agreed(1.0, line(1.0, channel="A", speed_rpm=[1500.0]), line(1.0, channel="B", speed_rpm=[1500.0]))
    given = {"quantity": {"A": "acceleration", "B": "pressure"}, "settings": IDENTIFY}
    found = explained((order,), fit(), [], sources=FOUR_STROKE, beside=Beside(in_cylinder=["B"]), **given).orders
    assert {key: cause.text for key, cause in found.items()} == {("A", 1.0): LIKE_UNBALANCE, ("B", 1.0): "gas cycle"}


def test_fixed_lines_are_modes_mains_sidebands_or_tones():
    tones = (tone(50.0, "mains"), tone(137.0, "tone", 2.0), tone(87.0, "tone", 0.3), tone(187.0, "tone", 0.3))
    found = causes([], ROTOR, modal=fit(mode(115.0), mode(60.0, undecided="may be mains"), tones=tones))
    assert [(cause.text, cause.known) for cause in found.modes] == [("mode", True), ("undecided", False)]
    sideband = "sideband of 137 Hz spaced by 50 Hz"
    assert [cause.text for cause in found.tones] == ["mains", "tone", sideband, sideband]
    assert not found.tones[1].known


def test_tones_that_are_all_multiples_of_one_frequency_are_no_sidebands_of_each_other():
    """Three sines at 100, 120 and 150 Hz drive a beam, and their products fill a grid of 10 Hz."""
    places = [50.0, 70.0, 80.0, 100.0, 110.0, 120.0, 150.0, 170.0, 180.0, 200.0]
    sizes = [0.1, 0.1, 0.1, 0.8, 0.1, 0.7, 1.0, 0.1, 0.1, 0.1]
    tones = [tone(hz, "tone", size) for hz, size in zip(places, sizes, strict=True)]
    found = causes([], ROTOR, modal=fit(tones=tones))
    assert {cause.text for cause in found.tones} == {"tone"}


def test_harmonics_of_a_struck_race_and_their_sidebands_are_told_from_other_lines():
    sources = dataclasses.replace(ROTOR, bearings=(JACK_SHAFT.model_copy(update={"shaft_ratio": 1.0}),))
    for race in (3.117, 5.43, 8.71):
        wanted = [n * race + k for n in range(1, 5) for k in range(-2, 3) if n * race + k > 1.5]
        (found,) = struck_races([bearing_record(JACK_SHAFT, "BPFI", race)], sources, [(at, 2e-4) for at in wanted])
        assert all(found.nearest(at + 1e-4, 2e-4) is not None for at in wanted)
        others = [at for at in np.linspace(1.5, 30.0, 50) if np.abs(np.subtract(wanted, at)).min() > 0.02]
        assert np.mean([found.nearest(float(at), 2e-4) is not None for at in others]) < 0.05
    (found,) = struck_races([bearing_record(JACK_SHAFT, "BPFI", 5.4)], sources, [])
    assert race_cause([found], 2 * 5.4 - 1.0, 1e-4).text == "bearing jack shaft BPFI, harmonic 2 - 1 x shaft"
    assert race_cause([found], 4.93, 1e-4) is None


@pytest.mark.parametrize(("times", "words"), [(3.0, "bearing jack shaft BPFO, harmonic 3"), (3.3, "undecided")])
def test_at_one_speed_what_may_be_a_mode_on_a_harmonic_of_a_struck_race_is_that(times, words):
    """Strikes that wander make their third harmonic as wide as a natural frequency of little damping."""
    rpm, bearing = 1772.0, JACK_SHAFT.model_copy(update={"shaft_ratio": 1.0})
    shaft = agreed(1.0, line(1.0, speed_rpm=[rpm]))
    doubtful = mode(times * 3.572 * rpm / 60.0, 1e-3, undecided="no wider for sure than an order")
    doubtful = dataclasses.replace(doubtful, frequency_error_hz=0.05)
    struck = [bearing_record(bearing, "BPFO", 3.572, half=5e-4)]
    found = causes([shaft], dataclasses.replace(ROTOR, bearings=(bearing,)), modal=fit(doubtful), bearings=struck)
    assert found.modes[0].text == words


@pytest.mark.parametrize("has_first", [False, True])
def test_a_comb_beside_a_speed_that_was_only_stated_is_the_shaft_itself_perhaps(has_first):
    """A shaft at 1480 rpm of which 1400 was stated: 1.057 and its multiples, and nothing at order 1."""
    found = [dataclasses.replace(agreed(k * 1.0571, lock="slips"), doubts=(NO_PULSES,)) for k in (1, 2, 7)]
    found += [dataclasses.replace(agreed(1.0), doubts=(NO_PULSES,))] if has_first else []
    this_one = "a shaft at 1.057 times the stated speed, this one if that is wrong"
    assert texts(found, ROTOR)[1.0571] == ("a second shaft at 1.057" if has_first else this_one)


WIND = StatedPart("gear mesh", "blades", 3 / 97, 1e-8, 1 / 97)


def named(order, *gears):
    """What a line at ``order`` that slips is called beside the ``gears``."""
    return texts([agreed(order, lock="slips", error=1e-7)], dataclasses.replace(ROTOR, gears=gears))[order]


def test_a_line_between_the_multiples_of_blades_behind_a_gear_is_none_of_theirs():
    assert named(0.262, WIND) == named(0.745, WIND) == "unexplained"
    assert [named(k * 3 / 97, WIND) for k in (1, 5)] == ["gear mesh blades", "gear mesh blades, harmonic 5"]


@pytest.mark.parametrize(("digits", "teeth", "turns"), [(3, 7, 0.0123456789), (5, 23, 2.3456789)])
def test_a_ratio_allows_for_the_digits_that_it_is_stated_with(digits, teeth, turns):
    gear = Gear(name="g", teeth=teeth, ratio=float(f"{turns:.{digits - 1}e}"))
    stated = StatedPart("gear mesh", "g", gear.mesh_order, gear.ratio_share * gear.mesh_order, gear.ratio)
    for harmonic in range(1, 6):
        text = "gear mesh g" + (f", harmonic {harmonic}" if harmonic > 1 else "")
        assert named(harmonic * teeth * turns, stated) == text
        assert named((harmonic + 0.1) * teeth * turns, stated) == "unexplained"


def test_of_gears_with_near_multiples_the_one_that_fits_is_named_and_both_where_both_do():
    first, second = StatedPart("gear mesh", "first", 0.31, 1e-5), StatedPart("gear mesh", "second", 0.312, 1e-5)
    assert named(0.624, first, second) == "gear mesh second, harmonic 2"
    vague = dataclasses.replace(first, order_half=2e-3)
    assert named(0.3115, vague, dataclasses.replace(second, order_half=2e-3)) == "gear mesh second or first"


def test_multiples_that_nothing_tells_apart_name_no_line():
    cause = causes([agreed(0.31, lock="undecided", error=0.01)], dataclasses.replace(ROTOR, gears=(WIND,)))
    assert cause.orders["A", 0.31].text == "unexplained"
    assert "multiples of blades lie closer together" in cause.orders["A", 0.31].evidence


@pytest.mark.parametrize("order", [45.99, 46.0, 69.03])
def test_at_one_speed_a_tone_on_a_multiple_of_a_stated_mesh_is_the_mesh(order):
    gears = StatedPart("gear mesh", "pump", 23.0), StatedPart("gear mesh", "fan", 31.37)
    sources, pump = dataclasses.replace(ROTOR, gears=gears), f"gear mesh pump, harmonic {round(order / 23.0)}"
    places = {order: ("order", pump), 62.74: ("tone", "gear mesh fan, harmonic 2")}
    places |= {47.0: ("order", "order"), 45.4: ("tone", "tone")}
    tones = tuple(tone(at * 25.0, kind) for at, (kind, _) in places.items())
    found = causes([agreed(1.0, line(1.0, speed_rpm=[1500.0]))], sources, modal=fit(tones=tones))
    assert [cause.text for cause in found.tones] == [words for _, words in places.values()]
    several = causes([agreed(1.0)], sources, modal=fit(tones=tones))
    assert not any("gear" in cause.text for cause in several.tones)


def test_sidebands_of_blades_are_told_by_the_turns_of_their_rotor():
    orders = [(2 / 97, 0.3), (3 / 97, 1.0), (4 / 97, 0.3)]
    lines = [agreed(order, line(order, size), lock="slips", error=1e-7) for order, size in orders]
    found = texts(lines, dataclasses.replace(ROTOR, gears=(WIND,)))
    sideband = "sideband of order 0.03093 spaced by 0.01031"
    assert list(found.values()) == [sideband, "gear mesh blades", sideband]


def test_a_struck_race_of_a_slow_shaft_is_as_near_in_its_own_turns():
    slow = dataclasses.replace(ROTOR, bearings=(Bearing(name="rotor", shaft_ratio=0.01, bpfo=3.58, bpfi=5.42),))
    record = bearing_record(slow.bearings[0], "BPFO", 0.0358, half=1e-7, seen_in="envelope")
    (race,) = struck_races([record], slow, [])
    assert race_cause([race], 2 * 0.0358, 1e-7).text == "bearing rotor BPFO, harmonic 2"
    assert race_cause([race], 2.04 * 0.0358, 1e-7) is None


# What is found twice at one place is told once, or each with the other.


def test_a_tone_on_the_flank_of_a_stronger_one_is_not_told():
    hertz, away = 100.0, 0.6
    strong, flank, apart = tone(hertz, "mains"), tone(hertz + away, "order", 0.7), tone(hertz + 3.0, "order", 0.7)
    other = tone(hertz - away, "tone", 0.7)
    found = without_doubles(fit(tones=(strong, flank, apart, other), frequency_hz=np.arange(0.0, 200.0, 0.5)))
    assert found.tones == (strong, apart, other)


def test_at_one_speed_it_names_the_order_that_stands_there():
    rpm = 1713.0
    one = agreed(3.0, line(3.0, speed_rpm=[rpm]))
    beside = fit(mode(3.0 * rpm / 60.0 + 0.01, undecided="at one speed its modulation looks the same"))
    causes = Causes({("A", 3.0): Cause("bearing pump BPFO", "")}, (), ())
    named, swept = (with_neighbours_named(beside, (order,), causes).modes[0] for order in (one, agreed(3.0)))
    assert "bearing pump BPFO at 85.65 Hz stands there" in named.undecided
    assert swept.lines_there_hz == ()
