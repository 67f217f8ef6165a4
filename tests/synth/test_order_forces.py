"""Forces by order against masses whose motion is differentiated twice in time, and against cosines."""

from collections.abc import Callable

import numpy as np
import pytest

from crankorder.engine.definition import Engine
from crankorder.engine.torsional_fluctuation import Lag
from crankorder.errors import RequestError
from crankorder.synth.lines import crank_forces, crank_motion, driven_lines, lag_by_order, order_lines
from crankorder.synth.load import load_scene
from crankorder.synth.motion import Motion
from crankorder.synth.noise import floor_of
from crankorder.synth.order_forces import ForceLines, force_at, lines_in_angle, lines_in_time
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
from crankorder.synth.truth import truth_of

RNG = np.random.default_rng(3)
ORDERS = (0.5, 1.0, 1.5, 2.0, 4.0, 20.0, 5.37, -1.0, 0.0, 33.5, 2.0)


def some_lines(order: tuple[float, ...] = ORDERS, **changes: object) -> ForceLines:
    n = len(order)
    parts = {
        "order": np.array(order),
        "amplitude": RNG.normal(size=(6, n)) + 1j * RNG.normal(size=(6, n)),
        "at_speed_rpm": np.linspace(800.0, 1200.0, n),
        "exponent": np.linspace(0.0, 3.0, n),
        "inertia": np.zeros(n, dtype=bool),
        "gas": np.arange(n) % 3 == 1,
        "cause": tuple(f"line {k}" for k in range(n)),
    }
    return ForceLines(**(parts | changes))


def second_difference(values: Callable[[np.ndarray], np.ndarray], times: np.ndarray, step: float) -> np.ndarray:
    """Second derivative by the central difference of order 8 in extended precision."""
    weights = np.array([-1 / np.longdouble(560), 8 / np.longdouble(315), -1 / np.longdouble(5), 8 / np.longdouble(5)])
    weights = np.concatenate([weights, [-205 / np.longdouble(72)], weights[::-1]])
    return sum(w * values(times + (k - 4) * step) for k, w in enumerate(weights)) / np.longdouble(step) ** 2


def test_a_mass_that_the_crank_moves_feels_the_second_derivative_of_its_place() -> None:
    """Place X cos(order · φ + ψ), φ(t) any function of time, differentiated by differences."""
    orders, sizes, phases = (1.0, 2.0, 4.5, 5.37), (0.7, -0.2, 0.05, 0.01), (0.3, -1.0, 2.0, 0.0)
    times = np.array([-0.4, 0.0, 0.3, 1.1, 4.0], dtype=np.longdouble)

    def place(t: np.ndarray) -> np.ndarray:
        angle = np.longdouble("31.7") * t + 40 * t**2 - 9 * t**3 + np.sin(13 * t) / 50
        return sum(x * np.cos(k * angle + p) for k, x, p in zip(orders, sizes, phases, strict=True))

    expected = second_difference(place, times, 5e-5).astype(np.float64)
    t = times.astype(np.float64)
    motion = [
        31.7 * t + 40 * t**2 - 9 * t**3 + np.sin(13 * t) / 50,
        31.7 + 80 * t - 27 * t**2 + 13 * np.cos(13 * t) / 50,
        80 - 54 * t - 169 * np.sin(13 * t) / 50,
    ]
    at_rpm = 777.0
    at_speed = -(np.array(orders) ** 2) * np.array(sizes) * np.exp(1j * np.array(phases)) * (at_rpm * np.pi / 30) ** 2
    lines = some_lines(
        orders,
        amplitude=np.outer(np.eye(6)[1], at_speed),
        at_speed_rpm=np.full(4, at_rpm),
        inertia=np.ones(4, dtype=bool),
        gas=np.zeros(4, dtype=bool),
    )
    rev, rad_s, rad_s2 = np.array(motion) / np.array([[2 * np.pi], [1.0], [1.0]])
    force = force_at(lines, rev, rad_s * 30 / np.pi, rad_s2 * 30 / np.pi)
    assert np.abs(force[1] - expected).max() < 1e-12 * np.abs(expected).max()
    assert not force[[0, 2, 3, 4, 5]].any()


def test_the_compiled_sum_is_the_sum_of_cosines() -> None:
    inertia = np.array([order in (1.0, 4.0, 33.5) for order in ORDERS])
    lines = some_lines(inertia=inertia)
    n = 1000
    rev = RNG.uniform(-300, 300, n)
    speed, acceleration, gain = RNG.uniform(-3000, 3000, n), RNG.uniform(-500, 500, n), RNG.uniform(0.5, 1.5, n)
    expected, largest = np.zeros((6, n)), 0.0
    for k, order in enumerate(ORDERS):
        ratio, omega, alpha = speed / lines.at_speed_rpm[k], speed * np.pi / 30, acceleration * np.pi / 30
        scale = np.abs(ratio) ** lines.exponent[k] + 0j
        if inertia[k]:
            scale = (omega**2 - 1j * alpha / order) / (lines.at_speed_rpm[k] * np.pi / 30) ** 2
        scale = scale * (gain if lines.gas[k] else 1.0)
        line = lines.amplitude[:, [k]] * scale * np.exp(2j * np.pi * (order * rev % 1.0))
        expected += line.real
        largest = max(largest, float(np.abs(line).max()))
    found = force_at(lines, rev, speed, acceleration, gain)
    assert np.abs(found - expected).max() < 1e-12 * largest  # the angle itself is good to 1e-13 rev only


def test_a_force_that_falls_with_speed_is_refused_at_standstill() -> None:
    lines = some_lines((1.0,), exponent=np.array([-1.0]))
    with pytest.raises(RequestError, match="stands still"):
        force_at(lines, np.zeros(2), np.array([1.0, 0.0]), np.zeros(2))
    with pytest.raises(RequestError, match="stands still"):
        lines.at_speed(0.0)


# Forces of a whole engine against its mechanics, and order lines behind a late channel.


SceneWith = Callable[..., Scene]
IN_CYCLE = InCycleSpeed(by_order=(SpeedOrder(order=0.5, percent=1.0), SpeedOrder(order=2.0, percent=1.5)))


def pushed(engine: Engine, angle: np.ndarray, omega: float, alpha: float) -> tuple[np.ndarray, np.ndarray]:
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


@pytest.mark.parametrize("offset_m", [0.0, 0.01])
@pytest.mark.parametrize(("omega", "alpha"), [(100.0, 0.0), (100.0, 6000.0), (0.0, 500.0), (-50.0, -900.0)])
def test_a_piston_shakes_and_rolls_the_crankcase_under_any_motion(
    scene_with: SceneWith, offset_m: float, omega: float, alpha: float
) -> None:
    moving = {"engine_forces": EngineForces(tolerance=1e-15, moments=True), "in_cycle_speed": IN_CYCLE}
    scene = scene_with("engine_forces", **moving)
    alone = Engine(**{**scene.engine.model_dump(exclude={"shafts"}), "offset_m": offset_m})
    forces = crank_forces(scene.model_copy(update={"engine": alone}))
    rev = np.linspace(0, 1, 101)
    per_rad_s = np.full(101, 30 / np.pi)
    found = force_at(forces, rev, omega * per_rad_s, alpha * per_rad_s)
    for axis, expected in zip(("Z", "RY"), pushed(alone, 2 * np.pi * rev, omega, alpha), strict=True):
        assert np.abs(found[AXES.index(axis)] - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.slow
def test_the_rolling_moment_in_the_cycle_is_the_same_by_lines_and_by_integration(scene_with: SceneWith) -> None:
    moving = {"engine_forces": EngineForces(tolerance=1e-9, moments=True), "in_cycle_speed": IN_CYCLE}
    steady = scene_with("engine_forces", **moving)
    held = SpeedProfile(rpm=(600.0, 600.0 + 1e-9), time_s=(2.9, 2.99))  # as good as steady, but integrated
    run_up = scene_with("engine_forces", **moving, speeds=None, speed_profile=held)
    by_lines, by_steps = (
        sensed(scene, scene.runs[0], floor_of(scene, 8000.0))[:, :20_000] for scene in (steady, run_up)
    )
    motions = [crank_motion(scene, scene.runs[0]) for scene in (steady, run_up)]
    shift = (motions[1].mean_rev(0.0) - motions[0].mean_rev(0.0)) / 10.0 * 8000  # each recording starts by chance
    lines = driven_lines(steady, crank_forces(steady), 600.0, motions[0].lag)
    time_s = (np.arange(20_000) + shift) / 8000
    late = lines.amplitude * np.exp(2j * np.pi * lines.order * motions[0].mean_rev(0.0))
    expected = (late @ np.exp(2j * np.pi * np.outer(lines.order * 10.0, time_s))).real
    assert np.abs(by_steps - expected).max() < 1e-8 * np.abs(by_lines).max()


@pytest.mark.parametrize("more", [{}, {"in_cycle_speed": IN_CYCLE}])
def test_the_order_lines_of_a_late_channel_are_those_of_its_samples(scene_with: SceneWith, more: dict) -> None:
    late = Acquisition(delay_s={"Z": 7.7e-4})
    effects = ["engine_forces", "injected_orders"] + ([] if more else ["bearing_lines"])
    scene = scene_with(*effects, acquisition=late, **more)
    run = scene.runs[1]
    signal = sensed(scene, run, floor_of(scene, 8000.0))
    rev = crank_motion(scene, run).at(np.arange(scene.n_samples) / 8000.0)[0]
    lines = order_lines(scene, run)
    expected = (lines.amplitude @ np.exp(2j * np.pi * np.outer(lines.order, rev))).real
    assert np.abs(signal - expected).max() < 1e-10 * np.abs(signal).max()


@pytest.mark.slow
def test_a_force_that_turns_the_same_way_backwards_is_told_for_backwards_speeds(scene_with: SceneWith) -> None:
    backwards = SpeedProfile(rpm=(-800.0, -500.0), time_s=(0.5, 2.0))
    more = {"speeds": None, "speed_profile": backwards}
    scene = scene_with("injected_orders", injected_orders=(_force("Z"),), **more)
    record = next(record for record in truth_of(scene)["orders"] if record["channel"] == "Z")
    assert (min(record["speed_rpm"]), max(record["speed_rpm"])) == (-800.0, -500.0)
    held = scene.model_copy(update={"speed_profile": SpeedProfile(rpm=(-500.0, -500.0), time_s=(0.5, 2.0))})
    run = held.runs[0]
    rev = crank_motion(held, run).at(np.arange(held.n_samples) / 8000.0)[0]
    line = record["amplitude_by_speed"][-1] * np.exp(1j * np.radians(record["phase_deg_by_speed"][-1]))
    signal = sensed(held, run, floor_of(held, 8000.0))[1]
    assert np.abs(signal - (line * np.exp(2j * np.pi * 6.5 * rev)).real).max() < 1e-9 * np.abs(signal).max()


def test_a_crossing_is_excited_where_a_force_of_the_order_drives_the_mode(scene_with: SceneWith) -> None:
    scene = scene_with("injected_orders", "bearing_lines", injected_orders=(_force("RY"), _force("Z", order=4.0)))
    line = scene.bearing_lines[0].model_copy(update={"line": "N*fs"})
    force = _force("Z", order=5.5)
    alone = truth_of(scene.model_copy(update={"bearing_lines": (line,)}))
    both = truth_of(
        scene.model_copy(update={"bearing_lines": (line,), "injected_orders": (*scene.injected_orders, force)})
    )
    excited = [{(r["order"], r["mode_hz"]) for r in truth["crossings"] if r["excited"]} for truth in (alone, both)]
    # RY drives the mode at 60 Hz alone
    assert excited[0] == {(6.5, 60.0), (4.0, 60.0), (4.0, 230.0)}
    assert excited[1] - excited[0] == {(5.5, 60.0), (5.5, 230.0)}


def _force(direction: str, *, order: float = 6.5) -> InjectedOrder:
    return InjectedOrder(order=order, direction=direction, force_n=30.0, at_speed_rpm=600.0)


# Lines over one angle are lines over the other, as many samples and a Fourier transform find them.


LINE_ORDERS = np.array([0.0, 0.5, 1.0, 2.0, 2.0, 4.0, 5.3])
RPM = 1300.0


def _lag(size: float = 1.0, orders: tuple[float, ...] = (0.5, 1.0, 2.0, 3.5)) -> Lag:
    order = np.array(orders)
    inertia = size * 6e-3 / order * np.exp(3j * order)
    return Lag(order=order, inertia=inertia, gas=size * 3e-3 / order * np.exp(1j * order**2), reference_rpm=1000.0)


def _forces() -> ForceLines:
    rng = np.random.default_rng(7)
    amplitude = rng.normal(size=(6, LINE_ORDERS.size)) + 1j * rng.normal(size=(6, LINE_ORDERS.size))
    return ForceLines(
        order=LINE_ORDERS,
        amplitude=amplitude,
        at_speed_rpm=np.array([1000.0, 1000.0, 1500.0, 1500.0, 1000.0, 900.0, 1200.0]),
        exponent=np.array([0.0, 0.0, 2.0, 2.0, 1.0, 2.0, 2.5]),
        inertia=np.array([False, False, True, True, False, True, False]),
        gas=np.array([True, True, False, False, False, False, False]),
        cause=("a", "b", "c", "d", "e", "f", "g"),
    )


def _force_at(lines: ForceLines, angle: np.ndarray, rpm: np.ndarray, rpm_per_s: np.ndarray) -> np.ndarray:
    """Force (axis, n) as the definition has it."""
    omega, alpha, total = rpm * np.pi / 30, rpm_per_s * np.pi / 30, np.zeros((6, angle.size))
    for k, order in enumerate(lines.order):
        at = lines.at_speed_rpm[k] * np.pi / 30
        if lines.inertia[k]:
            scale = (omega**2 - 1j * alpha / order) / at**2
        else:
            scale = np.abs(omega / at) ** lines.exponent[k]
        total += (lines.amplitude[:, k, None] * scale * np.exp(2j * np.pi * order * angle)).real
    return total


def _worst(order: np.ndarray, amplitude: np.ndarray, signal: np.ndarray, revs: float) -> float:
    """Largest difference between given lines and those of samples over ``revs`` whole turns, over the largest line."""
    expected = np.fft.rfft(signal, axis=1) * 2 / signal.shape[1]
    expected[:, 0] /= 2
    placed = np.zeros_like(expected)
    places = np.rint(order * revs).astype(int)
    np.testing.assert_allclose(order, places / revs, atol=1e-12)
    assert np.unique(places).size == places.size
    placed[:, places] = amplitude
    return float(np.abs(placed - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("size", [1.0, 5.0])
@pytest.mark.parametrize("rpm", [RPM, -RPM])
def test_forces_of_an_uneven_rotation_are_lines_of_the_mean_rotation(size: float, rpm: float) -> None:
    lines, lag, revs, n = _forces(), _lag(size), 20, 1 << 14
    order, amplitude = lines_in_time(lines, lag, speed_rpm=rpm)
    motion = Motion(start_rev=0.3, corners=((0.0, rpm),), lag=lag)
    mean_rev = np.arange(n) / n * revs
    signal = _force_at(lines, *motion.at((mean_rev - motion.mean_rev(0.0)) * 60 / rpm))
    assert _worst(order, amplitude, signal, revs) < 2e-12


def test_a_perfect_order_analysis_finds_the_lines_in_angle() -> None:
    lag, revs, n = _lag(3.0), 20, 1 << 13
    rng = np.random.default_rng(8)
    of_time = np.array([0.0, 0.5, 2.0, 5.3, 11.5])
    given = rng.normal(size=(2, 5)) + 1j * rng.normal(size=(2, 5))
    order, amplitude = lines_in_angle(of_time, given, lag, speed_rpm=RPM)
    motion = Motion(start_rev=0.0, corners=((0.0, RPM),), lag=lag)
    angle = np.arange(n) / n * revs
    time = motion.time_at(angle, (-1.0, 5.0))
    mean_rev = motion.mean_rev(0.0) + time * RPM / 60
    signal = (given @ np.exp(2j * np.pi * np.outer(of_time, mean_rev))).real
    assert _worst(order, amplitude, signal, revs) < 2e-12


def test_an_even_rotation_changes_nothing_but_the_speed() -> None:
    lines = _forces()
    even = Lag(order=np.array([0.5]), inertia=np.zeros(1, dtype=complex), gas=np.zeros(1, dtype=complex))
    order, amplitude = lines_in_time(lines, even, speed_rpm=RPM)
    np.testing.assert_array_equal(order, np.unique(LINE_ORDERS))
    scale = (RPM / lines.at_speed_rpm) ** np.where(lines.inertia, 2.0, lines.exponent)
    of_second = (lines.amplitude * scale)[:, 3:5].sum(axis=1)
    np.testing.assert_allclose(amplitude[:, order == 2.0][:, 0], of_second, rtol=1e-13)
    np.testing.assert_allclose(amplitude[:, 0], lines.amplitude[:, 0].real, atol=1e-15)
    none = Lag(order=np.zeros(0), inertia=np.zeros(0, dtype=complex), gas=np.zeros(0, dtype=complex))
    np.testing.assert_allclose(lines_in_time(lines, none, speed_rpm=RPM)[1], amplitude, rtol=1e-12, atol=1e-13)


def test_a_lag_without_a_cycle_and_a_shaft_that_stops_are_refused() -> None:
    one = np.ones((1, 1), dtype=complex)
    with pytest.raises(RequestError, match="common cycle"):
        lines_in_angle(np.array([1.0]), one, _lag(orders=(1.0, 2**0.5)), speed_rpm=RPM)
    with pytest.raises(RequestError, match="stop within the cycle"):
        lines_in_angle(np.array([1.0]), one, _lag(), speed_rpm=100.0)
    with pytest.raises(RequestError, match="stop within the cycle"):
        lines_in_time(_forces(), _lag(), speed_rpm=0.0)


# The shaft turns within its cycle as the shares of its speed by order say.


@pytest.mark.parametrize(
    "parts",
    [
        ((2.0, 1.5, 30.0),),
        ((0.5, 3.0, 0.0), (2.0, 10.0, 200.0), (2.0, 4.0, 10.0)),
        ((1.0, 45.0, 0.0), (3.0, 30.0, 90.0)),
        ((1.0, 2.0, 0.0), (5.3, 5.0, 50.0)),
    ],
)
def test_the_speed_has_the_given_orders_by_crank_angle_and_no_others(parts: tuple) -> None:
    lag = lag_by_order(tuple(SpeedOrder(order=o, percent=p, phase_deg=d) for o, p, d in parts))
    angle, speed, _ = Motion(start_rev=0.13, corners=((0.0, 1200.0),), lag=lag).at(np.linspace(0, 0.5, 4001))
    shape = 1 + sum(p / 100 * np.cos(2 * np.pi * o * angle + np.radians(d)) for o, p, d in parts)
    np.testing.assert_allclose(speed / shape, speed[0] / shape[0], rtol=3e-13)
    assert angle[-1] - angle[0] == pytest.approx(10, abs=1e-13)


def _lag_of(scene: Scene, flywheel_inertia_kg_m2: float | None, in_cycle: InCycleSpeed) -> Lag:
    engine = scene.engine.model_copy(update={"flywheel_inertia_kg_m2": flywheel_inertia_kg_m2})
    changed = scene.model_copy(update={"engine": engine, "in_cycle_speed": in_cycle})
    lag = crank_motion(changed, changed.runs[0]).lag
    assert lag is not None
    return lag


@pytest.mark.slow
def test_the_flywheel_is_the_engines_unless_the_scene_has_its_own() -> None:
    scene = load_scene("thesis-second-firing")
    of_engine = _lag_of(scene, 0.4, InCycleSpeed())
    of_scene = _lag_of(scene, 0.9, InCycleSpeed(flywheel_inertia_kg_m2=0.4))
    np.testing.assert_array_equal(of_engine.inertia, of_scene.inertia)
    np.testing.assert_array_equal(of_engine.gas, of_scene.gas)
    assert np.abs(of_engine.inertia[1]) > 2 * np.abs(_lag_of(scene, 0.9, InCycleSpeed()).inertia[1])
    with pytest.raises(RequestError, match="how large the flywheel is"):
        _lag_of(scene, None, InCycleSpeed())
