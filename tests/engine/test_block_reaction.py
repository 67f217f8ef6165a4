"""Moment on the block against Newton's law on piston, rod and crank, and one frame of axes in all that is said."""

import json

import numpy as np
import pytest

from crankorder.batch.balance import balance_of, document_text, table_text
from crankorder.engine.balancing import moments_of
from crankorder.engine.cycle_tables import PARTS, crank_torque, roll_moment
from crankorder.engine.definition import Engine
from crankorder.engine.forces import AXES, FRAME, crankcase_forces, firing_angle_deg, gas_force
from crankorder.report.balance_dataset import balance_dataset
from crankorder.synth.write import toml_text

ORDERS, SAMPLES = 6, 1 << 15


def drawn(seed):
    """An engine with offsets, banks and gas; its rods have a mass and an inertia of their own."""
    draw = np.random.default_rng(seed)
    radius, length = draw.uniform(0.03, 0.05), draw.uniform(0.13, 0.18)
    rod = {"mass_kg": draw.uniform(0.3, 0.6), "centre_from_big_end_m": draw.uniform(0.2, 0.4) * length}
    rod["inertia_kg_m2"] = draw.uniform(0.5, 1.2) * rod["mass_kg"] * (length / 3) ** 2
    cylinders = []
    for place in range(draw.integers(1, 7)):
        crank, bank, cycle = 90.0 * draw.integers(4), draw.uniform(-60, 60), 360.0 * draw.integers(2)
        firing = {"crank_deg": crank, "bank_deg": bank, "firing_deg": (bank - crank) % 360 + cycle}
        cylinders.append({**firing, "position_m": 0.1 * place, "offset_m": draw.uniform(-0.01, 0.01)})
    ideal = {"compression_ratio": draw.uniform(8, 12), "intake_pa": 7e4, "heat_j": draw.uniform(200, 900)}
    gas = {"ideal": {**ideal, "burn_start_deg": -15.0, "burn_duration_deg": 60.0}}
    lengths = {"crank_radius_m": radius, "rod_length_m": length, "reciprocating_mass_kg": 0.6, "bore_m": 0.08}
    table = {**lengths, "rotating_unbalance_kg_m": 0.004, "rod": rod, "cylinders": cylinders, "gas": gas}
    return Engine.model_validate(table)


def slope(values):
    """Derivative by crank angle in radians of what repeats every revolution, sampled over a cycle of two."""
    lines = np.fft.rfft(values)
    return np.fft.irfft(lines * 0.5j * np.arange(lines.size), values.size)


def newton(engine, speed_rpm):
    """Force on the block along Z and X (2, angle), moment on it and torque on the crank about Y, body by body."""
    omega, phi = speed_rpm * np.pi / 30, 4 * np.pi * np.arange(SAMPLES) / SAMPLES
    force, roll, torque = np.zeros((2, SAMPLES)), np.zeros(SAMPLES), np.zeros(SAMPLES)
    rod, radius, length = engine.rod, engine.crank_radius_m, engine.rod_length_m
    share = rod.centre_from_big_end_m / length
    piston_kg = engine.reciprocating_mass_kg - rod.mass_kg * share
    throw_kg_m = engine.rotating_unbalance_kg_m - rod.mass_kg * (1 - share) * radius

    def kinetic(mass, place):
        return mass * omega**2 * slope(slope(place))

    for single, cylinder in zip(
        engine.each, engine.cylinders, strict=True
    ):  # along it and across it, from the crankshaft
        bank, own = np.radians(cylinder.bank_deg), phi + np.radians(cylinder.crank_deg - cylinder.bank_deg)
        pin_z, pin_x = radius * np.cos(own), radius * np.sin(own)
        lean = np.arcsin((pin_x - cylinder.offset_m) / length)
        height = pin_z + length * np.cos(lean)
        to_big_z, to_big_x = -share * length * np.cos(lean), share * length * np.sin(lean)  # from the rod's centre
        gas = gas_force(single, phi / (2 * np.pi) - firing_angle_deg(engine, cylinder) / 360)
        rod_z, rod_x = kinetic(rod.mass_kg, pin_z - to_big_z), kinetic(rod.mass_kg, pin_x - to_big_x)
        piston_z = kinetic(piston_kg, height) + gas  # of the rod on the piston; its crosswise part turns the rod
        turned = -kinetic(rod.inertia_kg_m2, lean) - to_big_z * rod_x + to_big_x * (rod_z + piston_z)
        small_x = to_big_x * (1 - 1 / share)
        wall = (turned - small_x * piston_z) / (to_big_z / share)
        pin_n = -(rod_z + piston_z), -(rod_x + wall)  # of the rod on the crank
        along = gas + pin_n[0] + throw_kg_m * omega**2 * np.cos(own)
        across = wall + pin_n[1] + throw_kg_m * omega**2 * np.sin(own)
        force += [np.cos(bank) * along - np.sin(bank) * across, np.sin(bank) * along + np.cos(bank) * across]
        roll += height * wall - cylinder.offset_m * gas
        torque += pin_z * pin_n[1] - pin_x * pin_n[0]
    return force, roll, torque


def orders_of(values):
    """Complex peaks of half orders from 0 of what was sampled over a cycle of two revolutions."""
    lines = 2 * np.fft.rfft(values)[..., : 2 * ORDERS + 1] / SAMPLES
    return lines / np.where(np.arange(2 * ORDERS + 1) == 0, 2, 1)


@pytest.mark.parametrize("seed", range(6))
def test_the_moment_on_the_block_is_that_of_newton_body_by_body(seed):
    engine, speed = drawn(seed), 800.0 * (seed + 1)
    force, roll, torque = map(orders_of, newton(engine, speed))
    for moment, known in ((roll_moment(engine, ORDERS), roll), (crank_torque(engine, ORDERS), torque)):
        inertia, gas, both = moment.at(speed)
        assert np.abs(both - known).max() < 1e-8 * np.abs(known).max()
        stated = moment.table(speed)
        found = {order: abs(complex(both[round(2 * float(order))])) for order in stated}
        assert found == pytest.approx({order: row["sum_n_m"] for order, row in stated.items()}, rel=1e-12)
        assert not inertia[1::2].any() and gas[1::2].any()
    known = crankcase_forces(engine, speed, max_order=ORDERS)[[2, 0]]  # gas adds no force
    assert np.abs(force[:, 2::2] - known[:, 1:]).max() < 1e-12 * np.abs(known).max()
    assert np.abs(force[:, 1::2]).max() < 1e-12 * np.abs(known).max()


@pytest.mark.parametrize("seed", range(6))
def test_text_json_and_netcdf_state_one_frame_and_the_same_amounts(seed, tmp_path):
    path = tmp_path / "drawn.toml"
    table = drawn(seed).model_dump(exclude_none=True, exclude_defaults=True, mode="json")
    path.write_text(toml_text(table))
    balance = balance_of(str(path), max_order=ORDERS, speeds_rpm=(3000.0,))
    sheet, stored = (
        json.loads(document_text(balance)),
        balance_dataset(balance.subject, balance.sheet, max_order=ORDERS, speeds_rpm=(3000.0,)),
    )
    words = " ".join(table_text(balance).split())
    for axis in "XYZ":
        assert f"{axis} {sheet['frame'][axis]}" in words
        assert stored.attrs[axis] == sheet["frame"][axis]
    assert sheet["frame"]["rotation"] in words and stored.attrs["rotation"] == sheet["frame"]["rotation"]
    rows = [line.split() for line in table_text(balance, whole=True).splitlines()]
    plain = stored.sel(system="none")
    for axis, amounts in sheet["force_g_mm"].items():
        for order, amount in (amounts or {}).items():
            assert abs(complex(plain["force"].sel(axis=axis, order=float(order)))) == pytest.approx(amount)
    for axis, amounts in sheet["moment_g_mm2"].items() if "moment" in stored else ():
        for order, amount in (amounts or {}).items():
            assert abs(complex(stored["moment"].sel(moment_axis=axis, order=float(order)))) == pytest.approx(amount)
            shown = [row for row in rows if row[:3] == [order, "about", axis]]
            assert not shown or float(shown[0][3]) == pytest.approx(amount, rel=1e-4)
    for order, row in sheet["roll_moment"]["by_speed"]["3000"].items():
        for part in PARTS:
            peak = complex(stored["roll_moment"].sel(part=part, speed=3000.0, gas_order=float(order)))
            turned = row[f"{part}_n_m"] * np.exp(1j * np.radians(row[f"{part}_phase_deg"]))
            assert peak == pytest.approx(turned, rel=1e-9)
        shown = [cells for cells in rows if cells[:2] == ["3000", order]]
        assert not shown or float(shown[0][4]) == pytest.approx(row["sum_n_m"], rel=1e-4)


def test_the_frame_is_right_handed_and_the_crank_turns_from_z_to_x():
    """A web's force turns as the crank does, and moments are r × F in the frame in which Z × X is Y."""
    web = {"unbalance_g_mm": 1e4, "position_m": 0.3}
    lengths = {"crank_radius_m": 0.04, "rod_length_m": 0.14, "reciprocating_mass_kg": 0.0}
    shaft = {"speed_ratio": 1, "x_m": 0.2, "z_m": 0.1, "weights": [web]}
    turning = Engine.model_validate({**lengths, "shafts": {"single": [shaft]}})
    force = crankcase_forces(turning, 3000.0, max_order=1)[:, 1]
    at = {angle: (force * np.exp(1j * np.radians(angle))).real / np.abs(force).max() for angle in (0, 90)}
    np.testing.assert_allclose([at[0], at[90]], [[0, 0, 1], [1, 0, 0]], atol=1e-12)  # Z, then X
    np.testing.assert_allclose(np.cross(at[0], at[90]), [0, 1, 0], atol=1e-12)
    lever = np.array([0.2, 0.3, 0.1])
    known = np.abs(np.cross(lever, 1e4 * np.array([-1j, 0, 1]))) * 1e3
    assert [moments_of(turning, 1)[axis]["1"] for axis in "XYZ"] == pytest.approx(known)
    assert AXES == ("Z", "X") and "from Z to X (positive about Y)" in FRAME.rotation


@pytest.mark.parametrize("name", ["task5", "inline-4-firing", "msu-shafts", "v8-cross"])
def test_the_short_text_is_one_screen_that_tells_the_sum_and_counts_the_rest(name):
    balance = balance_of(name, max_order=8)
    short, whole = table_text(balance), table_text(balance, whole=True)
    assert len(short.splitlines()) <= 40 and max(map(len, short.splitlines())) <= 100
    told = [text for text in balance.sheet["sentences"] if " ".join(text.split()) in " ".join(short.split())]
    assert told == balance.sheet["sentences"][: len(told)] and "oll moment" in " ".join(told)
    left = len(balance.sheet["sentences"]) + len(balance.sheet["notes"]) - short.count("\n  * ")
    assert f"{left} more" in short or not left
    assert set(short.splitlines()[:-2]) < set(whole.splitlines())
