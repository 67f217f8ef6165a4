"""Gas forces and torques: work, orders and superposition."""

import math

import numpy as np
import pytest

from crankorder.engine import forces
from crankorder.engine.balance_data import load_balanced_engine
from crankorder.engine.cycle_tables import crank_torque, cycle_balance, cycle_curves, roll_moment
from crankorder.engine.definition import Engine, load_engine
from crankorder.engine.slider_crank import rod_angle
from crankorder.errors import RequestError

IDEAL = {"compression_ratio": 9.5, "intake_pa": 8e4, "heat_j": 900.0, "exponent": 1.35, "exhaust_pa": 1.1e5}
DATA = {
    "crank_radius_m": 0.043, "rod_length_m": 0.141, "reciprocating_mass_kg": 0.6, "rotating_unbalance_kg_m": 0.006,
    "rotating_unbalance_deg": 20.0, "rod": {"mass_kg": 0.55, "centre_from_big_end_m": 0.04, "inertia_kg_m2": 0.002},
    "bore_m": 0.086, "gas": {"ideal": IDEAL},
}  # fmt: skip


def engine(**differences):
    return Engine.model_validate({**DATA, **differences})


def test_a_torque_curve_is_taken_as_it_is():
    curve = {"crank_angle_deg": [-30.0, 0.0, 90.0, 300.0], "torque_n_m": [1.0, 4.0, -2.0, 0.5]}
    model = engine(gas=curve)
    assert forces.gas_torque(model, np.array([0, 0.25, 2.25, -1 / 12, 45 / 360])) == pytest.approx([4, -2, -2, 1, 1])
    with pytest.raises(RequestError, match="no gas force"):
        forces.gas_force(model, 0.1)
    assert not any(
        force(engine(gas=None), np.linspace(0, 2, 9)).any() for force in (forces.gas_force, forces.gas_torque)
    )


def test_the_orders_of_a_straight_line_curve_are_exact():
    # a triangle over the cycle: height 1 at dead centre, 8/pi^2 / n^2 at odd half orders
    triangle = {"crank_angle_deg": [0.0, 360.0], "torque_n_m": [1.0, -1.0]}
    cylinders = [{"firing_deg": 0.0}, {"crank_deg": 180.0, "firing_deg": 180.0}]
    orders, torque = forces.gas_torque_by_order(engine(gas=triangle, cylinders=cylinders), 5)
    known = np.where(np.arange(11) % 2, 8 / np.pi**2 / np.maximum(np.arange(11), 1) ** 2, 0)
    assert orders[1] == 0.5
    assert np.abs(torque - known * (1 + np.exp(-1j * np.pi * orders))).max() < 1e-8


def test_a_single_cylinder_fires_where_it_stands():
    model = engine(cylinders=[{"crank_deg": 30.0, "bank_deg": 10.0}])
    assert forces.firing_angle_deg(model, model.cylinders[0]) == 340
    two_stroke = engine(cycle="two-stroke", gas=None, cylinders=[{}, {"crank_deg": 180.0}])
    assert forces.firing_angle_deg(two_stroke, two_stroke.cylinders[1]) == 180


def volume(model, turned, ratio):
    """Volume over the piston by hand, from the length of crank and rod in one line."""
    r, rod, e = model.crank_radius_m, model.rod_length_m, model.offset_m
    height = r * np.cos(turned) + np.sqrt(rod**2 - (r * np.sin(turned) - e) ** 2)
    top, bottom = math.sqrt((rod + r) ** 2 - e**2), math.sqrt((rod - r) ** 2 - e**2)
    area = math.pi / 4 * model.bore_m**2 if model.bore_m else math.nan
    return area * ((top - bottom) / (ratio - 1) + top - height)


def pressure(model, degrees):
    return forces.gas_force(model, np.asarray(degrees) / 360) / (math.pi / 4 * model.bore_m**2) + 101325.0


@pytest.mark.parametrize("offset_m", [0.0, 0.008])
def test_an_ideal_cycle_does_the_work_of_the_textbook(offset_m):
    model = engine(offset_m=offset_m)
    ends = volume(model, np.array([math.asin(offset_m / 0.184), math.pi + math.asin(offset_m / 0.098)]), 9.5)
    assert ends[1] / ends[0] == pytest.approx(9.5, rel=1e-9)
    otto = 900.0 * (1 - 9.5 ** (1 - 1.35))
    pumping = (8e4 - 1.1e5) * (ends[1] - ends[0])
    mean = forces.gas_torque_by_order(model, 1)[1][0].real
    assert 4 * math.pi * mean == pytest.approx(otto + pumping, rel=3e-5)


def test_heat_over_some_angle_follows_the_first_law():
    """p V^γ rises by (γ − 1) ∫ V^(γ − 1) dQ; before, it is that of the intake, and afterwards it stays."""
    model, nodes = engine(gas={"ideal": IDEAL | {"burn_start_deg": -20.0, "burn_duration_deg": 60.0}}), 40
    place, weight = np.polynomial.legendre.leggauss(nodes)
    intake = 8e4 * volume(model, np.pi, 9.5) ** 1.35
    for degrees in (-100.0, -20.0, -11.0, 3.0, 17.0, 39.0, 40.0, 100.0):
        burnt = np.radians(np.clip(degrees + 20.0, 0.0, 60.0))
        turned = burnt * (1.0 + place) / 2.0
        heat = 900.0 * 0.5 * np.pi / np.radians(60.0) * np.sin(3.0 * turned)
        given = 0.35 * burnt / 2.0 * (weight @ (heat * volume(model, turned - np.radians(20.0), 9.5) ** 0.35))
        known = (intake + given) / volume(model, np.radians(degrees), 9.5) ** 1.35
        assert pressure(model, degrees) == pytest.approx(known, rel=1e-7)
    assert pressure(model, [250.0, 500.0]) == pytest.approx([1.1e5, 8e4], rel=1e-8)


def test_a_two_stroke_cycle_is_closed_all_the_way_round():
    ideal = {key: value for key, value in IDEAL.items() if key != "exhaust_pa"}
    model = engine(cycle="two-stroke", gas={"ideal": ideal})
    mean = forces.gas_torque_by_order(model, 1)[1][0].real
    assert 2 * math.pi * mean == pytest.approx(900.0 * (1 - 9.5 ** (1 - 1.35)), rel=3e-5)
    with pytest.raises(ValueError, match="exhaust"):
        engine(cycle="two-stroke")


def newton_euler(model, turned, omega, gas_n):
    """Forces (along and across, angles) of one upright cylinder from piston, rod and crank as free bodies."""
    r, rod, e, m = model.crank_radius_m, model.rod_length_m, model.offset_m, model.rod
    a = m.centre_from_big_end_m
    pin = r * np.array([np.cos(turned), np.sin(turned)])
    sine = (r * np.sin(turned) - e) / rod
    psi = np.arcsin(sine)
    rate = r * np.cos(turned) / (rod * np.cos(psi)) * omega
    bend = (-r * np.sin(turned) * omega**2 / rod + sine * rate**2) / np.cos(psi)
    along, side = np.array([np.cos(psi), -np.sin(psi)]), np.array([-np.sin(psi), -np.cos(psi)])
    at_centre, at_piston = (-(omega**2) * pin + reach * (side * bend - along * rate**2) for reach in (a, rod))
    piston_kg = model.reciprocating_mass_kg - m.mass_kg * a / rod
    # the piston gives what its pin carries along; across, the rod's moment about its crank pin, which turns by −ψ
    of_piston = -piston_kg * at_piston[0] - gas_n
    pull = m.mass_kg * at_centre
    moment = -m.inertia_kg_m2 * bend + a * (along[0] * pull[1] - along[1] * pull[0])
    on_rod = np.array([of_piston, (moment + rod * along[1] * of_piston) / (rod * along[0])])
    crank_pin = on_rod - pull
    # what rotates beside the rod's big end: the given unbalance less the share of the rod that it includes
    rest = turned + math.radians(model.rotating_unbalance_deg)
    rotating = model.rotating_unbalance_kg_m * np.array([np.cos(rest), np.sin(rest)])
    main = crank_pin + omega**2 * (rotating - m.mass_kg * (1 - a / rod) * pin)
    thrust = -(piston_kg * at_piston[1] + on_rod[1])
    return {"crank_pin_n": crank_pin, "piston_pin_n": -on_rod, "side_thrust_n": thrust, "main_n": main}


@pytest.mark.parametrize("seed", range(3))
def test_loads_are_those_of_an_independent_newton_euler_solution(seed):
    draw = np.random.default_rng(seed)
    rod = {"mass_kg": 0.55, "centre_from_big_end_m": float(draw.uniform(0, 0.12)), "inertia_kg_m2": 0.003}
    model = engine(offset_m=float(draw.uniform(-0.02, 0.02)), rod=rod)
    speed, angles = float(draw.uniform(0, 9000)), draw.uniform(0, 2, 40)
    loads, gas = forces.cylinder_loads(model, angles, speed), forces.gas_force(model, angles)
    scale = max(float(np.abs(loads.crank_pin_n).max()), float(np.abs(gas).max()))
    for name, value in newton_euler(model, 2 * math.pi * angles, speed * math.pi / 30, gas).items():
        assert np.abs(getattr(loads, name) - value).max() < 1e-9 * scale, name


@pytest.mark.parametrize("seed", range(6))
def test_block_and_crank_feel_the_sum_of_gas_and_masses_that_newton_gives_body_by_body(seed):
    draw, top, samples = np.random.default_rng(seed), 6, 1 << 15
    cylinders = [
        {"crank_deg": crank, "bank_deg": bank, "firing_deg": (bank - crank) % 360 + 360.0 * draw.integers(2), **own}
        for _ in range(draw.integers(1, 7))
        for crank, bank in [(90.0 * draw.integers(4), draw.uniform(-60, 60))]
        for own in [{"offset_m": draw.uniform(-0.01, 0.01), "position_m": draw.uniform(-0.2, 0.2)}]
    ]
    ideal = {**IDEAL, "heat_j": draw.uniform(200, 900), "burn_start_deg": -15.0, "burn_duration_deg": 60.0}
    model, speed = engine(cylinders=cylinders, gas={"ideal": ideal}), draw.uniform(800, 6000)
    angles, felt = 4 * np.pi * np.arange(samples) / samples, np.zeros((4, samples))
    for single, cylinder in zip(model.each, model.cylinders, strict=True):
        bank, turned = math.radians(cylinder.bank_deg), angles + math.radians(cylinder.crank_deg - cylinder.bank_deg)
        gas = forces.gas_force(single, angles / (2 * np.pi) - forces.firing_angle_deg(model, cylinder) / 360)
        loads = newton_euler(single, turned, speed * math.pi / 30, gas)
        along, across = loads["main_n"] + np.stack([gas, loads["side_thrust_n"]])
        pin = model.crank_radius_m * np.stack([np.cos(turned), np.sin(turned)])
        height = pin[0] + np.sqrt(model.rod_length_m**2 - (pin[1] - single.offset_m) ** 2)
        felt[:2] += along * np.cos(bank) - across * np.sin(bank), along * np.sin(bank) + across * np.cos(bank)
        felt[2] += height * loads["side_thrust_n"] - single.offset_m * gas
        felt[3] += pin[0] * loads["crank_pin_n"][1] - pin[1] * loads["crank_pin_n"][0]
    lines = 2 * np.fft.rfft(felt)[:, : 2 * top + 1] / samples
    lines[:, 0] /= 2
    for moment, known in ((roll_moment(model, top), lines[2]), (crank_torque(model, top), lines[3])):
        assert np.abs(moment.at(speed)[2] - known).max() < 1e-8 * np.abs(known).max()
        sums = {f"{order:g}": size for order, size in zip(moment.order, np.abs(known), strict=True) if order}
        assert {k: row["sum_n_m"] for k, row in moment.table(speed).items()} == pytest.approx(sums, rel=1e-5)
    masses = np.zeros((2, 2 * top + 1), dtype=complex)
    masses[:, ::2] = forces.crankcase_forces(model, speed, max_order=top)[[Z, X]]
    assert np.abs(lines[:2] - masses)[:, 1:].max() < 1e-12 * np.abs(masses).max()  # gas adds no force


def test_gas_and_masses_are_side_by_side_and_alike_where_it_says():
    model = load_engine("inline-4-firing")
    turning = cycle_balance(model, max_order=8, speeds=[1000.0, 6000.0])["turning"]
    slow, fast = (turning[key]["by_order"]["2"] for key in ("1000", "6000"))
    assert (slow["dominates"], fast["dominates"]) == ("gas", "inertia")
    assert slow["alike_at_rpm"] == pytest.approx(fast["alike_at_rpm"], rel=1e-12)
    (alike,) = cycle_balance(model, max_order=8, speeds=[slow["alike_at_rpm"]])["turning"].values()
    assert alike["by_order"]["2"]["gas_n_m"] == pytest.approx(alike["by_order"]["2"]["inertia_n_m"], rel=1e-12)
    assert "0.5" not in turning["1000"]["by_order"]  # four alike cylinders at even intervals


def test_the_speed_swings_by_the_energy_that_the_flywheel_takes():
    model = load_engine("inline-4-firing")
    speed, inertia = 2500.0, 50.0
    stiff = model.model_copy(update={"flywheel_inertia_kg_m2": inertia})
    found = cycle_balance(stiff, max_order=8, speeds=[speed])["turning"]["2500"]["speed_fluctuation"]
    (curves,) = cycle_curves(stiff, [speed])
    total = curves.gas_n_m + curves.inertia_n_m
    energy = np.cumsum(total - total.mean()) * 2 * np.pi / 720
    assert found == pytest.approx(np.ptp(energy) / (inertia * (speed * np.pi / 30) ** 2), rel=5e-3)
    without = cycle_balance(load_engine("inline-4"), max_order=4, speeds=[1000.0])["turning"]["1000"]
    assert without["speed_fluctuation"] is None


def test_firing_intervals_are_told_with_their_evenness():
    for firing, intervals in (
        ((0.0, 180.0, 360.0, 540.0), [180.0] * 4), ((0.0, 360.0, 180.0, 180.0), [180.0, 0.0, 180.0, 360.0])
    ):  # fmt: skip
        model = engine(cylinders=[{"crank_deg": -angle % 360, "firing_deg": angle} for angle in firing])
        assert list(forces.firing_intervals_deg(model)) == intervals
        assert cycle_balance(model, max_order=4, speeds=[1000.0])["firing"]["even"] == (len(set(intervals)) == 1)


def test_a_gas_file_beside_the_engine_is_its_curve_and_its_faults_are_named(tmp_path):
    text = "crank_radius_m = 0.043\nrod_length_m = 0.141\nreciprocating_mass_kg = 0.6\nbore_m = 0.086\n"
    (tmp_path / "it.toml").write_text(text + '[gas]\nfile = "p.csv"\n')
    rows = "crank_angle_deg,pressure_pa\n-360,1e5\n0,3e6\n30,4e6\n180,2e5\n"
    (tmp_path / "p.csv").write_text(rows)
    for model in (load_engine("it.toml", beside=tmp_path), load_balanced_engine(str(tmp_path / "it.toml")).engine):
        assert model.gas.pressure_pa == (1e5, 3e6, 4e6, 2e5)
    for wrong, says in (
        (rows.replace("3e6", "high"), "high"), (rows.replace("pressure_pa", "bar"), "bar"), ("", "no rows"),
    ):  # fmt: skip
        (tmp_path / "p.csv").write_text(wrong)
        with pytest.raises(RequestError, match=says):
            load_engine("it.toml", beside=tmp_path)
    (tmp_path / "p.csv").unlink()
    with pytest.raises(RequestError, match="no such gas file"):
        load_engine("it.toml", beside=tmp_path)


# Loads inside the engine against the laws that they must obey: action and reaction, work, angular momentum.


X, Y, Z = (forces.DIRECTIONS.index(name) for name in ("X", "Y", "Z"))
SPEED_RPM = 1500.0
OMEGA = SPEED_RPM * np.pi / 30
ANGLES = np.linspace(0, 2, 361)
PRESSURE = {"crank_angle_deg": [0.0, 20.0, 90.0, 360.0, 600.0], "pressure_pa": [3e6, 5e6, 4e5, 1e5, 1.5e5]}


def loaded_engine(**differences):
    return engine(**{"gas": PRESSURE, **differences})


def summed(by_order, angles=ANGLES):
    phasors = np.exp(2j * np.pi * np.arange(by_order.shape[-1])[:, None] * angles)
    return (by_order[..., None] * phasors).real.sum(axis=-2)


@pytest.mark.parametrize("offset_m", [0.0, 0.01, -0.02])
def test_loads_add_up_to_the_inertia_force_the_rolling_moment_and_the_torque(offset_m):
    model = loaded_engine(offset_m=offset_m)
    loads = forces.cylinder_loads(model, ANGLES, SPEED_RPM)
    inertia_n = summed(forces.crankcase_forces(model, SPEED_RPM, max_order=70))
    scale = np.abs(loads.main_n).max()
    assert np.abs(loads.main_n[0] + loads.head_n - inertia_n[Z]).max() < 1e-13 * scale
    assert np.abs(loads.main_n[1] + loads.side_thrust_n - inertia_n[X]).max() < 1e-13 * scale
    # side thrust on its lever and gas on its offset
    psi, _, _ = rod_angle(ANGLES, model.mechanism)
    height = model.crank_radius_m * np.cos(2 * np.pi * ANGLES) + model.rod_length_m * np.cos(psi)
    moment = height * loads.side_thrust_n - offset_m * loads.head_n
    gas = forces.gas_torque(model, ANGLES)
    rolling = summed(forces.crankcase_moments(model, SPEED_RPM, max_order=70))[Y] - gas
    assert np.abs(moment - rolling).max() < 1e-12 * np.abs(moment).max()
    inertia = summed(forces.inertia_torque_by_order(model, 70) * OMEGA**2)
    assert np.abs(loads.torque_n_m - gas - inertia).max() < 1e-12 * np.abs(loads.torque_n_m).max()


def test_the_main_bearings_together_carry_throws_of_their_own_masses_and_webs_in_force_and_moment():
    cylinders = [
        {"crank_deg": 0.0, "bank_deg": -30.0, "position_m": -0.09, "firing_deg": 330.0, "reciprocating_mass_kg": 0.9},
        {"crank_deg": 90.0, "bank_deg": 45.0, "position_m": 0.02, "firing_deg": 315.0, "rotating_unbalance_kg_m": 0.02},
        {"crank_deg": 180.0, "bank_deg": 0.0, "position_m": 0.1, "firing_deg": 540.0, "offset_m": 0.01},
    ]
    places = [-0.1, 0.0, 0.1]
    webs = [{"unbalance_g_mm": 2e4, "angle_deg": 70.0, "position_m": 0.12}]
    model = loaded_engine(cylinders=cylinders, webs=webs, main_bearings_m=places)
    loads = [forces.cylinder_loads(model, ANGLES, SPEED_RPM, cylinder=number) for number in range(len(cylinders))]
    bearings = forces.main_bearing_loads(model, ANGLES, SPEED_RPM, loads)
    assert bearings.shape == (3, 3, ANGLES.size)
    turned = 2 * np.pi * ANGLES + np.radians(70.0)
    force = 2e4 * 1e-6 * OMEGA**2 * np.stack([np.sin(turned), 0 * turned, np.cos(turned)])
    moment = 0.12 * force
    for cylinder_load, cylinder in zip(loads, model.cylinders, strict=True):
        along, across = cylinder_load.main_n
        lean = np.radians(cylinder.bank_deg)
        load = np.stack(
            [along * np.sin(lean) + across * np.cos(lean), 0 * along, along * np.cos(lean) - across * np.sin(lean)]
        )
        force += load
        moment += cylinder.position_m * load
    scale = np.abs(bearings).max()
    assert np.abs(bearings.sum(axis=0) - force).max() < 1e-13 * scale
    assert np.abs(np.einsum("b,bdt->dt", places, bearings) - moment).max() < 1e-13 * scale


def test_cylinders_of_one_engine_carry_the_same_loads_at_other_angles():
    cylinders = [{"firing_deg": 0.0}, {"crank_deg": 180.0, "bank_deg": 45.0, "firing_deg": 585.0}]
    model = loaded_engine(cylinders=cylinders)
    one = forces.cylinder_loads(model, ANGLES, SPEED_RPM)
    other = forces.cylinder_loads(model, ANGLES + 585 / 360, SPEED_RPM, cylinder=1)
    for name in ("side_thrust_n", "piston_pin_n", "crank_pin_n", "main_n", "head_n", "torque_n_m"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-9, abs=1e-7), name


def test_what_is_missing_for_loads_is_named():
    torque_only = {"crank_angle_deg": [0.0, 90.0], "torque_n_m": [0.0, 10.0]}
    for model, fault in (
        (loaded_engine(gas=torque_only, main_bearings_m=[-0.1, 0.1]), "at the dead centres any force makes no torque"),
        (loaded_engine(cylinders=[{}, {"crank_deg": 180.0}], main_bearings_m=[-0.1, 0.1]), "which revolution"),
    ):
        with pytest.raises(RequestError, match=fault):
            forces.cylinder_loads(model, ANGLES, SPEED_RPM)


def test_a_rod_that_almost_lies_flat_keeps_the_digits_of_its_loads():
    # at 90° cos ψ = √((1 − λ + ε)(1 + λ − ε)): thrust and torque follow from the lengths alone
    radius, rod = 0.045 * (1 - 1e-9), 0.045
    for offset_m in (0.0, 1e-11, -1e-11):
        model = loaded_engine(rod=None, crank_radius_m=radius, rod_length_m=rod, offset_m=offset_m)
        loads = forces.cylinder_loads(model, np.array([0.25]), 0.0)
        gas, across, short = float(loads.head_n[0]), radius - offset_m, rod - radius + offset_m
        assert loads.side_thrust_n[0] == pytest.approx(-gas * across / np.sqrt(short * (rod + across)), rel=1e-13)
        assert loads.torque_n_m[0] == pytest.approx(gas * radius, rel=1e-14)
