"""The compiled integration against plain NumPy, its error against its own bound, and its drift."""

from itertools import product

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.synth import driven
from crankorder.synth.driven import STENCILS, Integration, integration_for, interpolation_error, step_weights
from crankorder.synth.poles import Poles, steady_state
from made.structures import frequency_response

RNG = np.random.default_rng(8)
POLES = Poles(
    pole_per_s=np.array([-3 + 380j, -0.4 + 1500j, -900 + 0j, -4e4 + 5e4j, -2 + 0j]),
    input=RNG.normal(size=(5, 6)),
    output=RNG.normal(size=(2, 5)) + 1j * RNG.normal(size=(2, 5)),
    direct=RNG.normal(size=(2, 6)),
)
RATE_HZ = 8192.0


def advance(poles, force, *, step_s, integration, state):
    """Signal and state of the compiled integration with the weights of its step."""
    growth, taps = step_weights(poles.pole_per_s, step_s, integration)
    return driven.advance(poles, force, growth=growth, taps=taps, integration=integration, state=state)


def plain_advance(force: np.ndarray, integration: Integration, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One step of the grid after the other, each of them the integral of a polynomial through the samples about it."""
    margin, substeps = integration.margin, integration.substeps
    step = 1 / (RATE_HZ * substeps)
    grow, taps = step_weights(POLES.pole_per_s, step, Integration(integration.stencil, 1))
    signal, state = [], state.copy()
    for number in range(force.shape[1] - 2 * margin):
        if number % substeps == 0:
            signal.append((POLES.output @ state).real + POLES.direct @ force[:, margin + number])
        about = force[:, number + 1 : number + 1 + integration.stencil]
        state += grow * state + (taps * (POLES.input @ about)).sum(axis=1)
    return np.array(signal).T, state


@pytest.mark.parametrize("integration", [Integration(2, 1), Integration(8, 1), Integration(12, 3), Integration(4, 2)])
def test_the_compiled_integration_is_the_plain_one(integration: Integration) -> None:
    n_samples = 1100  # three blocks, the last not full
    force = RNG.normal(size=(6, n_samples * integration.substeps + 2 * integration.margin))
    start = RNG.normal(size=5) + 1j * RNG.normal(size=5)
    step = 1 / (RATE_HZ * integration.substeps)
    signal, after = advance(POLES, force, step_s=step, integration=integration, state=start)
    expected, expected_after = plain_advance(force, integration, start)
    assert signal.shape == (2, n_samples)
    assert np.abs(signal - expected).max() < 1e-13 * np.abs(expected).max()
    assert np.abs(after - expected_after).max() < 1e-13 * np.abs(expected_after).max()


def tone_error(pole_per_step: complex, phase_rad: float, integration: Integration) -> float:
    """Relative error of the steady response of a pole to a tone: both are known in closed form."""
    growth, taps = step_weights(np.array([pole_per_step]), 1.0, integration)
    samples = np.exp(1j * phase_rad * (np.arange(taps.shape[1]) - (integration.stencil // 2 - 1)))
    found = (taps[0] * samples).sum() / (np.exp(1j * phase_rad * integration.substeps) - 1 - growth[0])
    return abs(found * (1j * phase_rad - pole_per_step) - 1)


def test_the_error_of_a_tone_is_within_its_bound_and_not_far_below() -> None:
    poles = (-1e-4 + 2e-3j, -0.002 + 0.05j, -0.3 + 0.5j, -2 + 2j)
    for stencil, phase_rad, pole, substeps in product(STENCILS, (0.3, 0.6, 1.0), poles, (1, 3)):
        bound = interpolation_error(stencil, phase_rad)
        error = tone_error(pole, phase_rad, Integration(stencil, substeps))
        assert bound / 3 < error < bound + 1e-13, (stencil, phase_rad, pole, substeps)


def test_the_chosen_integration_meets_its_tolerance_and_a_cheaper_one_does_not() -> None:
    for share, tolerance in product((0.01, 0.2, 0.95, 3.0), (1e-3, 1e-9, 1e-12)):
        frequency = share * RATE_HZ / 2
        chosen = integration_for(frequency, RATE_HZ, tolerance)
        phase = 2 * np.pi * frequency / RATE_HZ
        assert tone_error(-0.001 + 0.03j, phase / chosen.substeps, chosen) < max(tolerance, 1e-13)
        cheaper = [Integration(s, chosen.substeps) for s in STENCILS if s < chosen.stencil]
        cheaper += [Integration(s, chosen.substeps - 1) for s in STENCILS if chosen.substeps > 1]
        assert all(interpolation_error(way.stencil, phase / way.substeps) > tolerance for way in cheaper)


def test_what_no_integration_can_follow_is_refused() -> None:
    with pytest.raises(RequestError, match="change too fast"):
        integration_for(2e6, RATE_HZ, 1e-12)
    with pytest.raises(RequestError, match="tolerance 1e-17"):
        integration_for(10.0, RATE_HZ, 1e-17)


@pytest.mark.slow
def test_ten_million_steps_do_not_drift() -> None:
    """A lightly damped mode at resonance, whose gain is that of 1/(1 − |e^{λh}|) = 10⁵ steps."""
    natural, damping, rate = 2 * np.pi * 60.0, 2e-3, 80_000.0
    pole = natural * (-damping + 1j * np.sqrt(1 - damping**2))
    mode = Poles(pole_per_s=np.array([pole]), input=np.eye(1), output=np.ones((1, 1)) + 0j, direct=np.zeros((1, 1)))
    frequency, integration = np.array([60.0]), Integration(6, 1)
    state = steady_state(mode, np.ones((1, 1)), frequency)
    # 60 Hz repeats after 4000 samples exactly: the forces have no rounding that grows
    turn = np.exp(2j * np.pi * (np.arange(-3, 4003) * 3 % 4000) / 4000)
    expected = (frequency_response(mode, frequency)[0, 0, 0] * turn[3:-3]).real
    force, peak = np.ascontiguousarray(turn.real[None]), np.abs(expected).max()
    worst = 0.0
    for _ in range(2500):
        signal, state = advance(mode, force, step_s=1 / rate, integration=integration, state=state)
        worst = max(worst, float(np.abs(signal[0] - expected).max()))
    assert worst < 1e-13 * peak
