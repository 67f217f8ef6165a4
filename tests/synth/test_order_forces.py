"""Forces by order against masses whose motion is differentiated twice in time, and against cosines."""

from collections.abc import Callable

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.synth.order_forces import ForceLines, force_at

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


def test_backwards_the_same_mass_makes_the_same_force_at_the_same_angle() -> None:
    lines = some_lines((1.0, 2.0), inertia=np.ones(2, dtype=bool))
    rev, speed = RNG.uniform(size=50), RNG.uniform(100, 900, 50)
    forward, backward = (force_at(lines, rev, way * speed, 3 * speed) for way in (1, -1))
    assert np.array_equal(forward, backward)


def test_at_a_constant_speed_the_peaks_are_those_of_the_force() -> None:
    lines = some_lines((1.0, 2.5), inertia=np.array([True, False]))
    rev = np.linspace(0, 2, 101)
    expected = (lines.at_speed(640.0) @ np.exp(2j * np.pi * np.outer(lines.order, rev))).real
    found = force_at(lines, rev, np.full(101, 640.0), np.zeros(101))
    assert np.abs(found - expected).max() < 1e-14 * np.abs(expected).max()


def test_a_gain_multiplies_the_gas_lines_and_no_others() -> None:
    lines = some_lines()
    moves = RNG.uniform(1, 2, (3, 40))
    apart = [force_at(lines.only(chosen), *moves) for chosen in (lines.gas, ~lines.gas)]
    assert np.allclose(force_at(lines, *moves, 3.0), 3 * apart[0] + apart[1], rtol=1e-13, atol=1e-13)


def test_a_force_that_falls_with_speed_is_refused_at_standstill() -> None:
    lines = some_lines((1.0,), exponent=np.array([-1.0]))
    with pytest.raises(RequestError, match="stands still"):
        force_at(lines, np.zeros(2), np.array([1.0, 0.0]), np.zeros(2))
    with pytest.raises(RequestError, match="stands still"):
        lines.at_speed(0.0)
