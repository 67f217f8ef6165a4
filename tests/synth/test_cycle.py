"""Lines over one angle are lines over the other, as many samples and a Fourier transform find them."""

import numpy as np
import pytest

from crankorder.engine.torsional_fluctuation import Lag
from crankorder.errors import RequestError
from crankorder.synth.crank import crank_motion, lag_by_order
from crankorder.synth.load import load_scene
from crankorder.synth.motion import Motion
from crankorder.synth.order_forces import ForceLines, lines_in_angle, lines_in_time
from crankorder.synth.parts import InCycleSpeed, SpeedOrder
from crankorder.synth.scene import Scene

ORDERS = np.array([0.0, 0.5, 1.0, 2.0, 2.0, 4.0, 5.3])
RPM = 1300.0


def _lag(size: float = 1.0, orders: tuple[float, ...] = (0.5, 1.0, 2.0, 3.5)) -> Lag:
    order = np.array(orders)
    inertia = size * 6e-3 / order * np.exp(3j * order)
    return Lag(order=order, inertia=inertia, gas=size * 3e-3 / order * np.exp(1j * order**2), reference_rpm=1000.0)


def _forces() -> ForceLines:
    rng = np.random.default_rng(7)
    amplitude = rng.normal(size=(6, ORDERS.size)) + 1j * rng.normal(size=(6, ORDERS.size))
    return ForceLines(
        order=ORDERS,
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


def _found(signal: np.ndarray, revs: float) -> tuple[np.ndarray, np.ndarray]:
    """Orders and complex lines of samples over ``revs`` whole turns."""
    lines = np.fft.rfft(signal, axis=1) * 2 / signal.shape[1]
    lines[:, 0] /= 2
    return np.arange(lines.shape[1]) / revs, lines


def _worst(order: np.ndarray, amplitude: np.ndarray, signal: np.ndarray, revs: float) -> float:
    """Largest difference between given lines and those of samples over ``revs`` whole turns, over the largest line."""
    every, expected = _found(signal, revs)
    placed = np.zeros_like(expected)
    places = np.rint(order * revs).astype(int)
    np.testing.assert_allclose(order, every[places], atol=1e-12)
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
    np.testing.assert_array_equal(order, np.unique(ORDERS))
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


def _turning(lag: Lag, rpm: float, revs: int = 2, samples: int = 4001) -> tuple[np.ndarray, ...]:
    return Motion(start_rev=0.13, corners=((0.0, rpm),), lag=lag).at(np.linspace(0, revs * 60 / rpm, samples))


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
    angle, speed, _ = _turning(lag, 1200.0, revs=10)
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
