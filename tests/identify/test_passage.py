"""A swept oscillator as a tracking filter sees it, against integration of its equation and against steady running."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import cumulative_simpson, solve_ivp

from crankorder.identify.modes.order_terms import passage_of
from crankorder.orders.vold_kalman.filter import vold_kalman

WIDE_HZ = 400.0
"""Bandwidth of a filter that lets through all that a passage changes."""


def _ramp(
    rate_rpm_s: float, natural_hz: float, order: float, *, beside: float, rows: int = 400
) -> tuple[NDArray, NDArray]:
    """Times and speeds of a linear ramp through the speed at which ``order`` meets ``natural_hz``, ± ``beside``."""
    at = 60.0 * natural_hz / order
    low, high = (1.0 - beside) * at, (1.0 + beside) * at
    time = np.linspace(0.0, (high - low) / abs(rate_rpm_s), rows)
    speed = low + abs(rate_rpm_s) * time
    return time, speed if rate_rpm_s > 0.0 else speed[::-1]


def _angle(time: NDArray, speed: NDArray) -> NDArray:
    """Crank angle [rev] of a ramp."""
    return np.asarray(cumulative_simpson(speed / 60.0, x=time, initial=0.0))


def _integrated(
    order: float, time: NDArray, speed: NDArray, natural_hz: float, damping: float, force: NDArray
) -> NDArray:
    """Envelope of the acceleration of q'' + 2 ζ w q' + w² q = f(t) e^{iφ(t)} relative to φ: with a force of one on a
    unit mass, whose steady value is −ω² / (w² − ω² + 2 i ζ w ω).

    The displacement is written as Q e^{iφ}; its envelope Q is integrated, not what the code under test integrates.
    """  # fmt: skip
    w = 2.0 * np.pi * natural_hz
    slope = (speed[-1] - speed[0]) / (time[-1] - time[0]) * order / 60.0 * 2.0 * np.pi
    first = speed[0] * order / 60.0 * 2.0 * np.pi

    def by_time(t: float, state: NDArray) -> list[complex]:
        q, v = state
        omega = first + slope * t
        push = np.interp(t, time, force)
        turn = (1j * slope - omega**2) * q + 2j * omega * v
        return [v, push - 2.0 * damping * w * (v + 1j * omega * q) - w**2 * q - turn]

    start = force[0] / (w**2 - first**2 + 2j * damping * w * first)
    solved = solve_ivp(
        by_time, (time[0], time[-1]), np.array([start, 0.0], dtype=complex), method="DOP853",
        t_eval=time, rtol=1e-8, atol=1e-12,    )  # fmt: skip
    q, v = solved.y
    omega = first + slope * time
    push = np.interp(time, time, force)
    return np.asarray(push - 2.0 * damping * w * (v + 1j * omega * q) - w**2 * q)


@pytest.mark.parametrize("rate_rpm_s", [1.0, 10.0, 100.0, 1000.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_passage_is_what_integration_of_the_equation_gives(rate_rpm_s: float, seed: int) -> None:
    random = np.random.default_rng((seed, int(rate_rpm_s)))
    natural = float(random.uniform(8.0, 16.0) if rate_rpm_s <= 10.0 else random.uniform(20.0, 120.0))
    damping = float(np.exp(random.uniform(np.log(0.002), np.log(0.1))))
    order = float(random.choice([2.0, 4.0] if rate_rpm_s <= 10.0 else [0.5, 1.0, 2.0, 4.0]))
    rate = rate_rpm_s * (1.0 if seed % 2 else -1.0)
    sweep_hz = np.sqrt(rate_rpm_s * order / 60.0)  # as wide as the sweep makes a resonance
    beside = float(np.clip(3.0 * damping + 4.0 * sweep_hz / natural, 0.05, 0.6))
    time, speed = _ramp(rate, natural, order, beside=beside)
    truth = _integrated(order, time, speed, natural, damping, (speed / speed.max()) ** 2)
    passage = passage_of(order, time, speed, _angle(time, speed), np.full(len(time), WIDE_HZ), poles=2)
    growth = (passage.speed_rpm / passage.speed_rpm.max()) ** 2
    seen = passage.response(growth.astype(complex), natural, damping)[0]
    inside = slice(8, -8)  # the filter's own ends
    case = (rate, order, natural, damping)
    assert np.abs(seen - truth)[inside].max() < 0.02 * np.abs(truth).max(), case
    assert np.abs(seen[inside]).max() == pytest.approx(np.abs(truth[inside]).max(), rel=0.005), case


@pytest.mark.slow
@pytest.mark.parametrize("poles", [1, 2, 3])
def test_the_filter_lets_a_steady_envelope_through_and_halves_the_power_at_its_bandwidth(poles: int) -> None:
    time, speed = np.linspace(0.0, 40.0, 2001), np.linspace(600.0, 1200.0, 2001)
    bandwidth = 2.0
    passage = passage_of(1.0, time, speed, _angle(time, speed), np.full(len(time), bandwidth), poles=poles)
    grid = np.arange(len(passage.speed_rpm)) * passage.step_s
    for offset_hz, gain in ((0.0, 1.0), (0.5 * bandwidth, np.sqrt(0.5))):
        through = passage.smoothed(np.exp(2j * np.pi * offset_hz * grid)[:, None])[:, 0]
        expected = gain * np.exp(2j * np.pi * offset_hz * time)
        assert np.abs(through - expected)[500:-500].max() < 0.003


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_what_a_lower_order_takes_of_a_mode_that_rings_is_what_the_filter_takes(seed: int) -> None:
    """A real signal of one order alone, integrated, is followed jointly with a lower order that is not there."""
    random = np.random.default_rng(seed)
    far = seed >= 4
    natural = float(random.uniform(60.0, 200.0))
    damping = float(np.exp(random.uniform(np.log(0.002), np.log(0.006)))) * (0.2 if far else 1.0)
    upper, apart = float(random.choice([6.0, 8.5])), float(random.choice([1.5, 2.0] if far else [0.5, 1.0]))
    rate = float(random.uniform(400.0, 900.0))
    time, speed = _ramp(rate, natural, upper - 0.5 * apart, beside=0.5, rows=int(12.0 * natural))
    bandwidth_hz = float(0.5 * min(apart, 0.8) * speed[0] / 60.0)
    force = (speed / speed.max()) ** 2
    envelope = _integrated(upper, time, speed, natural, damping, force)
    angle = _angle(time, speed)
    sampled = 2000.0
    at = np.arange(0.0, time[-1], 1.0 / sampled)
    turned = np.interp(at, time, angle)
    whole = np.interp(at, time, envelope.real) + 1j * np.interp(at, time, envelope.imag)
    signal = (whole * np.exp(2j * np.pi * upper * turned)).real[None]
    lower = upper - apart
    tracks = vold_kalman(
        signal, np.outer([lower, upper], turned), rate_hz=sampled, bandwidth_hz=np.full((2, 2), bandwidth_hz),
        poles=2, knots_per_bandwidth=8,    )  # fmt: skip
    taken = np.interp(time, at, tracks.amplitude[0, 0].real) + 1j * np.interp(time, at, tracks.amplitude[0, 0].imag)
    width = np.full(len(time), bandwidth_hz)
    of_lower, of_upper = (passage_of(one, time, speed, angle, width, poles=2) for one in (lower, upper))
    growth = ((of_upper.speed_rpm / speed.max()) ** 2).astype(complex)
    foretold = of_lower.taken_from(of_upper, of_upper.left_over(growth, natural, damping), natural)
    inside = slice(len(time) // 10, -len(time) // 10)
    assert np.abs(taken[inside]).max() > 0.02 * np.abs(envelope).max()  # there is something to foretell
    assert np.abs(foretold - taken)[inside].max() < 0.1 * np.abs(taken[inside]).max()
