"""Engines of the textbooks: forces against the truth sheet and sums that share no code, and shafts that cancel them."""

import math

import numpy as np
import pytest

from crankorder.engine.balancing import designs, primary_shares, roll_height_m, throw_counterweights
from crankorder.engine.definition import BalanceShafts, Engine, load_engine
from crankorder.engine.forces import DIRECTIONS, crankcase_forces, crankcase_moments, orders_made

X, Y, Z = (DIRECTIONS.index(name) for name in ("X", "Y", "Z"))
RADIUS_M, ROD_M, MASS_KG = 0.043, 0.141, 0.58
RPM = 30 / math.pi
ORDERS = 8
EXACT = 1e-12
Throw = tuple[float, float, float]  # angle of the pin, angle of the bank, place along the crankshaft


def row(*cranks):
    return [(angle, 0.0, 0.1 * (n - (len(cranks) - 1) / 2)) for n, angle in enumerate(cranks)]


def vee(half_deg, *pins, split_deg=0.0, stagger_m=0.0):
    """Banks at ± ``half_deg``; the pins of a throw ``split_deg`` apart, its rods ``stagger_m`` apart."""
    made = []
    for n, pin in enumerate(pins):
        for side in (-1, 1):
            place = 0.11 * (n - (len(pins) - 1) / 2) + side * stagger_m / 2
            made.append((pin + side * split_deg / 2, side * half_deg, place))
    return made


def boxer(*pins):
    """Opposed pistons on pins half a turn apart, so that both go out together."""
    return [
        (pin if side < 0 else pin + 180, 90.0 * side, 0.12 * (n - (len(pins) - 1) / 2) + 0.02 * side)
        for n, pin in enumerate(pins)
        for side in (-1, 1)
    ]


# free of: primary force, secondary force, primary couple, secondary couple (textbooks)
ENGINES: dict[str, tuple[list[Throw], tuple[bool, ...]]] = {
    "inline-1": (row(0), (False, False, True, True)),
    "inline-2, 180°": (row(0, 180), (True, False, False, True)),
    "inline-2, 360°": (row(0, 0), (False, False, True, True)),
    "inline-2, 270°": (row(0, 270), (False, True, False, False)),
    "inline-3": (row(0, 240, 120), (True, True, False, False)),
    "inline-4, flat": (row(0, 180, 180, 0), (True, False, True, True)),
    "inline-5": (row(0, 216, 144, 72, 288), (True, True, False, False)),
    "inline-6": (row(0, 120, 240, 240, 120, 0), (True, True, True, True)),
    "v-twin, 60°": (vee(30, 0), (False, False, True, True)),
    "v-twin, 90°": (vee(45, 0, stagger_m=0.025), (False, False, False, False)),
    "v6, 60°, pins split by 60°": (vee(30, 0, 240, 120, split_deg=60), (True, True, False, False)),
    "v6, 90°, common pins": (vee(45, 0, 240, 120), (True, True, False, False)),
    "v8, 90°, cross": (vee(45, 0, 90, 270, 180), (True, True, False, True)),
    "v12, 60°": (vee(30, 0, 120, 240, 240, 120, 0), (True, True, True, True)),
    "boxer-4": (boxer(0, 180), (True, True, True, False)),
    "boxer-6": (boxer(0, 120, 240), (True, True, True, True)),
    "w-3": ([(0, bank, 0.0) for bank in (-60.0, 0.0, 60.0)], (False, False, True, True)),
    "radial-5": ([(0, 72.0 * n, 0.0) for n in range(5)], (False, True, True, True)),
}


def engine(throws, **differences):
    cylinders = [
        {"crank_deg": float(crank), "bank_deg": float(bank), "position_m": place} for crank, bank, place in throws
    ]
    lengths = {"crank_radius_m": RADIUS_M, "rod_length_m": ROD_M, "reciprocating_mass_kg": MASS_KG}
    return Engine.model_validate({**lengths, "cylinders": cylinders, **differences})


def turning(angle):
    return np.stack([np.sin(angle), 0 * angle, np.cos(angle)])


def summed(model):
    """Force and first moment along the crankshaft by (direction, order), from positions differentiated by hand."""
    phi = 2 * np.pi * np.arange(512) / 512
    parts = []  # of a force and its place
    for cylinder in model.cylinders:
        own = model.model_dump() | {key: value for key, value in cylinder.model_dump().items() if value is not None}
        pin, bank = math.radians(cylinder.crank_deg), math.radians(cylinder.bank_deg)
        across = model.crank_radius_m * np.sin(phi + pin - bank) - own["offset_m"]
        along = np.sqrt(model.rod_length_m**2 - across**2)
        rate = model.crank_radius_m * np.cos(phi + pin - bank)
        bend = -model.crank_radius_m * np.sin(phi + pin - bank)
        second = -rate - (rate**2 + across * bend) / along - (across * rate) ** 2 / along**3
        rest = phi + pin + math.radians(own["rotating_unbalance_deg"])
        force = -own["reciprocating_mass_kg"] * second * turning(bank)[:, None]
        parts.append((force + own["rotating_unbalance_kg_m"] * turning(rest), cylinder.position_m))
    weights = [(1, web) for web in model.webs]
    weights += [(shaft.speed_ratio, weight) for shaft in model.shafts.single for weight in shaft.weights]
    for ratio, weight in weights:
        force = 1e-6 * ratio**2 * weight.unbalance_g_mm * turning(ratio * phi + math.radians(weight.angle_deg))
        parts.append((force, weight.position_m))
    sums = sum(force for force, _ in parts), sum(place * force for force, place in parts)
    return tuple(2 * np.fft.rfft(one)[:, : ORDERS + 1] / phi.size for one in sums)


def scale(model):
    return len(model.cylinders) * MASS_KG * RADIUS_M


def off_by(model):
    """Largest difference from the independent sum, over the size of what is summed."""
    force, moment = summed(model)
    ours = crankcase_forces(model, RPM, max_order=ORDERS)
    about = crankcase_moments(model, RPM, max_order=ORDERS)
    apart = (ours - force, about[X] - moment[Z], about[Z] + moment[X])
    return max(float(np.abs(one[..., 1:]).max()) for one in apart) / scale(model)


SHIPPED = {"inline-2": (0, 180), "inline-3": (0, 120, 240), "inline-4": (0, 180, 180, 0), "v-twin": (0, 0)}


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_example_has_the_pins_of_its_textbook_and_the_forces_of_the_sum(name):
    example = load_engine(name)
    assert tuple(cylinder.crank_deg for cylinder in example.cylinders) == SHIPPED[name]
    assert off_by(example) < EXACT
    if name == "v-twin":  # its counterweight, rounded to 0.1 g·mm, takes the whole first order
        assert np.abs(crankcase_forces(example, RPM, max_order=1)[:, 1]).max() < 1e-7 * scale(example)


def test_what_cancels_to_round_off_is_no_order_that_the_engine_makes():
    in_one_plane = engine([(angle, 0.0, 0.0) for angle in (0.0, 120.0, 240.0)])
    assert orders_made(in_one_plane, share=1e-3, max_order=5) == ()
    assert orders_made(in_one_plane, share=1e-3, max_order=6) == (6.0,)
    assert orders_made(load_engine("inline-3"), share=1e-3, max_order=5) == (1.0, 2.0, 4.0)


OPTICAL = {"crank_radius_m": 0.0449, "rod_length_m": 0.152, "reciprocating_mass_kg": 4.304}


def optical(**differences):
    return Engine.model_validate({**OPTICAL, **differences})


def test_the_spacer_forces_are_those_of_the_truth_sheet_at_all_speeds(shared_truth):
    table = shared_truth["seed001"]["spacer_116g"]["r=44.9,l=152"]
    shafts = {"orders": [1, 2], "unbalanced_mass_kg": 0.116}
    forces = np.abs(crankcase_forces(optical(shafts=shafts), [row["rpm"] for row in table], max_order=4)[:, Z])
    assert len(table) == 35
    assert forces[:, 1] == pytest.approx([row["F1_N"] for row in table], rel=1e-12)
    assert forces[:, 2] == pytest.approx([row["F2_exact_N"] for row in table], rel=1e-12)


def test_shafts_timed_to_the_crank_leave_the_quadrature_of_the_offset(shared_truth):
    known = shared_truth["seed001"]["offset_quadrature_first_order"]["r=44.9,l=152"]["N_2000rpm_of_193249.6"]
    shafts = {"orders": [1, 2], "unbalanced_mass_kg": 0.0, "timed_to": "crank"}
    timed = crankcase_forces(optical(offset_m=0.01, shafts=shafts), 2000, max_order=2)[Z]
    assert abs(timed[1]) == pytest.approx(known, rel=1e-12)
    to_force = crankcase_forces(optical(offset_m=0.01, shafts=shafts | {"timed_to": "force"}), 2000, max_order=2)[Z]
    assert np.abs(to_force[1:]).max() == 0


def test_the_inertia_of_the_rod_makes_a_moment_and_no_force():
    rod = {"mass_kg": 1.6738, "centre_from_big_end_m": 0.03736}
    plain, true = (optical(rod=rod | inertia) for inertia in ({}, {"inertia_kg_m2": 0.0032}))
    assert np.array_equal(crankcase_forces(plain, 2000, max_order=9), crankcase_forces(true, 2000, max_order=9))
    missed = np.abs(crankcase_moments(true, 2000, max_order=9) - crankcase_moments(plain, 2000, max_order=9))
    assert missed[Y, 1] > 10


def test_what_textbooks_call_free_is_free_and_nothing_else():
    otherwise = {}
    for name, (throws, free) in ENGINES.items():
        model = engine(throws)
        forces = np.abs(crankcase_forces(model, RPM, max_order=2)).max(axis=0) / scale(model)
        couples = np.abs(crankcase_moments(model, RPM, max_order=2)[[X, Z]]).max(axis=0) / scale(model)
        found = tuple(bool(size < EXACT) for size in (forces[1], forces[2], couples[1], couples[2]))
        if found != free:
            otherwise[name] = found
    assert not otherwise


@pytest.mark.parametrize("seed", range(3))
def test_engines_drawn_at_random_with_masses_and_offsets_of_their_own(seed):
    draw = np.random.default_rng(seed)

    def drawn(n, **ends):
        return [{key: float(draw.uniform(*between)) for key, between in ends.items()} for _ in range(n)]

    def weights(n):
        return drawn(n, unbalance_g_mm=(0, 3e4), angle_deg=(0, 360), position_m=(-0.3, 0.3))

    cylinders = drawn(
        draw.integers(1, 9), crank_deg=(-360, 360), bank_deg=(-180, 180), position_m=(-0.3, 0.3),
        reciprocating_mass_kg=(0.2, 0.9), rotating_unbalance_kg_m=(0, 0.02), rotating_unbalance_deg=(0, 360),
        offset_m=(-0.02, 0.02),
    )  # fmt: skip
    shafts = {"single": [{"speed_ratio": ratio, "weights": weights(2)} for ratio in (-1, 2, -2, -3)]}
    assert off_by(engine([], cylinders=cylinders, webs=weights(3), shafts=shafts)) < EXACT


@pytest.mark.parametrize("name", ENGINES)
def test_a_design_cancels_force_and_couple_of_orders_1_and_2(name):
    model = engine(ENGINES[name][0], rotating_unbalance_kg_m=0.004, rotating_unbalance_deg=15.0)
    places = [cylinder.position_m for cylinder in model.cylinders]
    planes = (min(places), max(places))
    made = designs(model, orders=(1, 2), planes_m=planes)
    if name in ("inline-6", "v12, 60°", "boxer-6"):
        assert made == {}
        return
    *_, left = made.values()
    forces, moments = summed(left)
    assert off_by(left) < EXACT
    assert np.abs(forces[:, 1:3]).max() < EXACT * scale(model)
    if planes[0] < planes[1] or max(map(abs, places)) == 0:
        assert np.abs(moments[:, 1:3]).max() < EXACT * scale(model)
    assert np.abs(forces[:, 3:] - summed(model)[0][:, 3:]).max() < EXACT * scale(model)


def test_a_design_takes_any_order_asked_for():
    model = engine(ENGINES["v-twin, 60°"][0], offset_m=0.012)
    for order in (1, 3, 6):
        *_, left = designs(model, orders=(order,), planes_m=(-0.05, 0.08)).values()
        assert np.abs(summed(model)[0][:, order]).max() > 1e-6 * scale(model)
        assert max(np.abs(part[:, order]).max() for part in summed(left)) < EXACT * scale(model)


SHARES = {
    "inline-3": (None, 0.5), "inline-5": (None, 0.5), "inline-2, 180°": (None, 0.5), "inline-2, 360°": (0.5, None),
    "v8, 90°, cross": (None, 1.0), "v6, 90°, common pins": (None, 1.0), "v6, 60°, pins split by 60°": (None, 0.5),
    "v-twin, 60°": (2 / 3, None), "v-twin, 90°": (1.0, 0.0), "radial-5": (1.0, None),
}  # fmt: skip
"""Shares of the primary force and couple that turn with the crank (textbooks)."""


def test_crank_webs_take_the_share_that_turns_with_the_crank():
    for name, known in SHARES.items():
        found = primary_shares(engine(ENGINES[name][0]))
        assert (found["force"], found["couple"]) == pytest.approx(known, abs=1e-12)


def test_counterweights_of_half_the_pistons_balance_what_turns_with_the_crank():
    for name in ("v8, 90°, cross", "v-twin, 90°", "radial-5"):
        model = engine(ENGINES[name][0], rotating_unbalance_kg_m=0.003)
        weights, size = throw_counterweights(model), 1e6 * (0.5 * MASS_KG * RADIUS_M + 0.003)
        assert [weight.unbalance_g_mm for weight in weights] == pytest.approx([size] * len(weights), rel=1e-12)
        left = summed(model.model_copy(update={"webs": weights}))
        assert np.abs(left[0][:, 1]).max() < EXACT * scale(model)


@pytest.mark.parametrize("name", ["inline-4, flat", "inline-2, 180°", "inline-1"])
def test_shafts_at_different_heights_take_the_second_order_roll_moment_too(name):
    model = engine(ENGINES[name][0])
    height, placed = roll_height_m(model), []
    for shaft in designs(model, orders=(2,), planes_m=(-0.1, 0.1))["order 2"].shafts.single:
        placed.append(shaft.model_copy(update={"z_m": height / 2 * np.sign(shaft.speed_ratio)}))
    left = model.model_copy(update={"shafts": BalanceShafts(single=tuple(placed))})
    before, after = (np.abs(crankcase_moments(one, RPM, max_order=2)[Y, 2]) for one in (model, left))
    assert after < EXACT * scale(model) < before
