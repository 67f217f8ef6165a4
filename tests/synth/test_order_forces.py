"""Forces by order against masses whose motion is differentiated twice in time, and against cosines."""

from collections.abc import Callable

import numpy as np
import pytest

from crankorder.engine.definition import Engine
from crankorder.engine.torsional_fluctuation import Lag
from crankorder.errors import RequestError
from crankorder.synth.driven import ForceLines, force_at, lines_in_angle, lines_in_time
from crankorder.synth.lines import crank_forces, crank_motion, lag_by_order, order_lines
from crankorder.synth.load import load_scene
from crankorder.synth.motion import Motion
from crankorder.synth.noise import floor_of
from crankorder.synth.parts import (
    AXES,
    Acquisition,
    EngineForces,
    InCycleSpeed,
    InjectedOrder,
    SpeedOrder,
    SpeedProfile,
)
from crankorder.synth.recording import sensed
from crankorder.synth.scene import Scene
from crankorder.synth.write import truth_of

RNG = np.random.default_rng(3)
OF_LAG = np.array([0.5, 1.0, 2.0, 3.5])
LAG = Lag(
    order=OF_LAG, inertia=6e-3 / OF_LAG * np.exp(3j * OF_LAG), gas=3e-3 / OF_LAG * np.exp(1j * OF_LAG**2),
    reference_rpm=1000.0,
)  # fmt: skip
ORDERS = (0.5, 1.0, 1.5, 2.0, 4.0, 20.0, 5.37, -1.0, 0.0, 33.5, 2.0)


def some_lines(order=ORDERS, **changes):
    n = len(order)
    parts = {
        "order": np.array(order), "amplitude": RNG.normal(size=(6, n)) + 1j * RNG.normal(size=(6, n)),
        "at_speed_rpm": np.linspace(800.0, 1200.0, n), "exponent": np.linspace(0.0, 3.0, n),
        "inertia": np.zeros(n, dtype=bool), "gas": np.arange(n) % 3 == 1, "cause": tuple(f"line {k}" for k in range(n)),
    }  # fmt: skip
    return ForceLines(**(parts | changes))


def plain_forces(lines, rev, rpm, rpm_per_s, gain=1.0):
    """Complex force (line, axis, n) of each line as the definition has it."""
    omega, alpha, forces = rpm * np.pi / 30, rpm_per_s * np.pi / 30, []
    for k, order in enumerate(lines.order):
        at = lines.at_speed_rpm[k] * np.pi / 30
        scale = np.abs(omega / at) ** lines.exponent[k]
        if lines.inertia[k]:
            scale = (omega**2 - 1j * alpha / order) / at**2
        scale = scale * (gain if lines.gas[k] else 1.0)
        forces.append(lines.amplitude[:, [k]] * scale * np.exp(2j * np.pi * (order * rev % 1.0)))
    return np.array(forces)


def test_the_force_is_the_sum_of_cosines():
    lines, gain = some_lines(inertia=np.isin(ORDERS, (1.0, 4.0, 33.5))), 1.3
    motion = [RNG.uniform(-most, most, 1000) for most in (300, 3000, 500)]
    parts = plain_forces(lines, *motion, gain)
    # the angle itself is good to 1e-13 rev only
    assert np.abs(force_at(lines, *motion, gain) - parts.real.sum(axis=0)).max() < 1e-12 * np.abs(parts).max()


def test_a_force_that_falls_with_speed_is_refused_at_standstill():
    lines = some_lines((1.0,), exponent=np.array([-1.0]))
    with pytest.raises(RequestError, match="stands still"):
        force_at(lines, np.zeros(2), np.array([1.0, 0.0]), np.zeros(2))
    with pytest.raises(RequestError, match="stands still"):
        lines.at_speed(0.0)


# Forces of a whole engine against its mechanics, and order lines behind a late channel.


SceneWith = Callable[..., Scene]
IN_CYCLE = InCycleSpeed(by_order=(SpeedOrder(order=0.5, percent=1.0), SpeedOrder(order=2.0, percent=1.5)))


def pushed(engine, angle, omega, alpha):
    """Force along Z and moment about Y on the crankcase: piston and wall of one cylinder, rod without mass of its own.

    The rod pulls along itself; its part across is what the wall takes, at the height of the piston pin. The forces in
    the main bearing pass through the axis of the crank and make no moment about it.
    """
    across = engine.crank_radius_m * np.sin(angle) - engine.offset_m
    rise = np.sqrt(engine.rod_length_m**2 - across**2)
    slope = engine.crank_radius_m * np.cos(angle)
    bend = -engine.crank_radius_m * np.sin(angle)
    rise_slope = -across * slope / rise
    rise_bend = -(slope**2 + across * bend + rise_slope**2) / rise
    acceleration = (rise_bend - slope) * omega**2 + (rise_slope + bend) * alpha
    height = engine.crank_radius_m * np.cos(angle) + rise
    force = engine.reciprocating_mass_kg * acceleration
    return -force, -force * height * across / rise


@pytest.mark.parametrize(
    ("offset_m", "omega", "alpha"), [(0.0, 100.0, 6000.0), (0.01, 0.0, 500.0), (0.01, -50.0, -900.0)]
)
def test_a_piston_shakes_and_rolls_the_crankcase_under_any_motion(scene_with, offset_m, omega, alpha):
    moving = {"engine_forces": EngineForces(tolerance=1e-15, moments=True), "in_cycle_speed": IN_CYCLE}
    scene = scene_with("engine_forces", **moving)
    alone = Engine(**{**scene.engine.model_dump(exclude={"shafts"}), "offset_m": offset_m})
    forces, rev = crank_forces(scene.model_copy(update={"engine": alone})), np.linspace(0, 1, 101)
    found = force_at(forces, rev, *(np.full(101, rate * 30 / np.pi) for rate in (omega, alpha)))
    for axis, expected in zip(("Z", "RY"), pushed(alone, 2 * np.pi * rev, omega, alpha), strict=True):
        assert np.abs(found[AXES.index(axis)] - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("more", [{}, {"in_cycle_speed": IN_CYCLE}])
def test_the_order_lines_of_a_late_channel_are_those_of_its_samples(scene_with, more):
    effects = ["engine_forces", "injected_orders"] + ([] if more else ["bearing_lines"])
    scene = scene_with(*effects, acquisition=Acquisition(delay_s={"Z": 7.7e-4}), **more)
    signal, lines = sensed(scene, scene.runs[1], floor_of(scene, 8000.0)), order_lines(scene, scene.runs[1])
    rev = crank_motion(scene, scene.runs[1]).at(np.arange(scene.n_samples) / 8000.0)[0]
    expected = (lines.amplitude @ np.exp(2j * np.pi * np.outer(lines.order, rev))).real
    assert np.abs(signal - expected).max() < 1e-10 * np.abs(signal).max()


def test_a_force_that_turns_the_same_way_backwards_is_told_for_backwards_speeds(scene_with):
    backwards = SpeedProfile(rpm=(-800.0, -500.0), time_s=(0.5, 2.0))
    scene = scene_with("injected_orders", injected_orders=(_force("Z"),), speeds=None, speed_profile=backwards)
    record = next(record for record in truth_of(scene)["orders"] if record["channel"] == "Z")
    assert (min(record["speed_rpm"]), max(record["speed_rpm"])) == (-800.0, -500.0)
    held = scene.model_copy(update={"speed_profile": SpeedProfile(rpm=(-500.0, -500.0), time_s=(0.5, 2.0))})
    rev = crank_motion(held, held.runs[0]).at(np.arange(held.n_samples) / 8000.0)[0]
    line = record["amplitude_by_speed"][-1] * np.exp(1j * np.radians(record["phase_deg_by_speed"][-1]))
    signal = sensed(held, held.runs[0], floor_of(held, 8000.0))[1]
    assert np.abs(signal - (line * np.exp(2j * np.pi * 6.5 * rev)).real).max() < 1e-9 * np.abs(signal).max()


def test_a_crossing_is_excited_where_a_force_of_the_order_drives_the_mode(scene_with):
    forces = (_force("RY"), _force("Z", order=4.0))
    scene = scene_with("injected_orders", "bearing_lines", injected_orders=forces)
    line, excited = scene.bearing_lines[0].model_copy(update={"line": "N*fs"}), []
    for injected in (forces, (*forces, _force("Z", order=5.5))):
        truth = truth_of(scene.model_copy(update={"bearing_lines": (line,), "injected_orders": injected}))
        excited.append({(r["order"], r["mode_hz"]) for r in truth["crossings"] if r["excited"]})
    # RY drives the mode at 60 Hz alone
    assert excited[0] == {(6.5, 60.0), (4.0, 60.0), (4.0, 230.0)}
    assert excited[1] - excited[0] == {(5.5, 60.0), (5.5, 230.0)}


def _force(direction, *, order=6.5):
    return InjectedOrder(order=order, direction=direction, force_n=30.0, at_speed_rpm=600.0)


@pytest.mark.parametrize("rpm", [1300.0, -1300.0])
def test_forces_of_an_uneven_rotation_are_lines_of_the_mean_rotation(rpm):
    """As many samples of the mean rotation and a Fourier transform find them."""
    orders, revs, n = (0.0, 0.5, 1.0, 2.0, 2.0, 4.0, 5.3), 20, 1 << 14
    lines = some_lines(orders, inertia=np.isin(orders, (1.0, 4.0)))
    order, amplitude = lines_in_time(lines, LAG, speed_rpm=rpm)
    motion, mean_rev = Motion(start_rev=0.3, corners=((0.0, rpm),), lag=LAG), np.arange(n) / n * revs
    forces = plain_forces(lines, *motion.at((mean_rev - motion.mean_start_rev) * 60 / rpm)).real.sum(axis=0)
    expected = np.fft.rfft(forces, axis=1) * 2 / n
    expected[:, 0] /= 2
    found = np.zeros_like(expected)
    found[:, np.rint(order * revs).astype(int)] = amplitude
    assert np.abs(found - expected).max() < 2e-12 * np.abs(expected).max()


def test_a_shaft_that_stops_is_refused():
    with pytest.raises(RequestError, match="stop within the cycle"):
        lines_in_angle(np.array([1.0]), np.ones((1, 1), dtype=complex), LAG, speed_rpm=100.0)
    with pytest.raises(RequestError, match="stop within the cycle"):
        lines_in_time(some_lines(), LAG, speed_rpm=0.0)


# The shaft turns within its cycle as the shares of its speed by order say.


@pytest.mark.parametrize(
    "parts",
    [
        ((2.0, 1.5, 30.0),), ((0.5, 3.0, 0.0), (2.0, 10.0, 200.0), (2.0, 4.0, 10.0)),
        ((1.0, 45.0, 0.0), (3.0, 30.0, 90.0)), ((1.0, 2.0, 0.0), (5.3, 5.0, 50.0)),
    ],
)  # fmt: skip
def test_the_speed_has_the_given_orders_by_crank_angle_and_no_others(parts):
    lag = lag_by_order(tuple(SpeedOrder(order=o, percent=p, phase_deg=d) for o, p, d in parts))
    angle, speed, _ = Motion(start_rev=0.13, corners=((0.0, 1200.0),), lag=lag).at(np.linspace(0, 0.5, 4001))
    shape = 1 + sum(p / 100 * np.cos(2 * np.pi * o * angle + np.radians(d)) for o, p, d in parts)
    np.testing.assert_allclose(speed / shape, speed[0] / shape[0], rtol=3e-13)
    assert angle[-1] - angle[0] == pytest.approx(10, abs=1e-13)


def test_the_flywheel_is_the_engines_unless_the_scene_has_its_own():
    scene = load_scene("thesis-second-firing")

    def lag(engines_kg_m2, scenes_kg_m2=None):
        engine = scene.engine.model_copy(update={"flywheel_inertia_kg_m2": engines_kg_m2})
        in_cycle = InCycleSpeed(flywheel_inertia_kg_m2=scenes_kg_m2)
        changed = scene.model_copy(update={"engine": engine, "in_cycle_speed": in_cycle})
        return crank_motion(changed, changed.runs[0]).lag

    of_engine, of_scene = lag(0.4), lag(0.9, 0.4)
    np.testing.assert_array_equal(of_engine.inertia, of_scene.inertia)
    np.testing.assert_array_equal(of_engine.gas, of_scene.gas)
    assert np.abs(of_engine.inertia[1]) > 2 * np.abs(lag(0.9).inertia[1])
    with pytest.raises(RequestError, match="how large the flywheel is"):
        lag(None)
