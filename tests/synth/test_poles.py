"""Poles of a structure and a filter against the structure's own steady state, formula by formula."""

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.synth.analogue import high_pass, in_series, low_pass
from crankorder.synth.poles import Structure, accelerance, poles_of, steady_state
from made.structures import frequency_response

RNG = np.random.default_rng(4)
STRUCTURE = Structure(
    frequency_hz=np.array([60.0, 115.0, 1900.0]),
    damping_ratio=np.array([0.05, 0.003, 0.3]),
    sensor_per_kg=RNG.normal(size=(3, 2)) + 1j * RNG.normal(size=(3, 2)),
    drive=RNG.normal(size=(3, 6)),
    rigid_body_per_kg=RNG.normal(size=(2, 6)),
)
FREQUENCY = np.r_[-500.0, -60.0, 0.0, np.geomspace(1, 2e4, 60), 115.0]


def test_poles_answer_as_the_modes_do() -> None:
    error = np.abs(frequency_response(poles_of(STRUCTURE), FREQUENCY) - accelerance(STRUCTURE, FREQUENCY))
    assert error.max() < 1e-13 * np.abs(accelerance(STRUCTURE, FREQUENCY)).max()


def test_a_filter_in_series_multiplies_the_response() -> None:
    for filter in (low_pass(8, 4000.0), low_pass(3, 90.0), in_series(low_pass(7, 900.0), high_pass(2.0))):
        expected = accelerance(STRUCTURE, FREQUENCY) * filter.response(FREQUENCY)
        error = np.abs(frequency_response(poles_of(STRUCTURE, filter), FREQUENCY) - expected)
        assert error.max() < 1e-13 * np.abs(accelerance(STRUCTURE, FREQUENCY)).max()


def test_the_steady_state_solves_the_equation_of_each_pole() -> None:
    poles = poles_of(STRUCTURE, low_pass(4, 500.0))
    frequency = np.array([0.0, 59.0, 300.0, -20.0])
    force = RNG.normal(size=(6, 4)) + 1j * RNG.normal(size=(6, 4))

    def at(time_s: float) -> tuple[np.ndarray, np.ndarray]:
        turned = force * np.exp(2j * np.pi * frequency * time_s)
        return steady_state(poles, turned, frequency), turned.real.sum(axis=1)

    state, acting = at(0.0)
    step = 1e-3  # derivative of a sum of few tones: as good as exact from their spectrum
    rate = steady_state(poles, 2j * np.pi * frequency * force, frequency)
    assert np.abs(rate - poles.pole_per_s * state - poles.input @ acting).max() < 1e-12 * np.abs(rate).max()
    later, acting = at(step)
    expected = (np.einsum("caf,af->cf", frequency_response(poles, frequency), force)) * np.exp(
        2j * np.pi * frequency * step
    )
    signal = (poles.output @ later).real + poles.direct @ acting
    assert np.abs(signal - expected.real.sum(axis=1)).max() < 1e-12 * np.abs(expected).max()


def test_a_mode_on_a_pole_of_the_filter_is_refused() -> None:
    filter = low_pass(2, 60.0)
    mode = Structure(
        frequency_hz=np.array([60.0]),
        damping_ratio=np.array([np.sqrt(0.5)]),
        sensor_per_kg=np.ones((1, 1)),
        drive=np.ones((1, 6)),
        rigid_body_per_kg=np.zeros((1, 6)),
    )
    with pytest.raises(RequestError, match="same pole; found 60 Hz"):
        poles_of(mode, filter)


@pytest.mark.slow
def test_the_slowest_pole_says_how_long_the_past_is_remembered() -> None:
    assert poles_of(STRUCTURE).decay_s == pytest.approx(1 / (2 * np.pi * 115 * 0.003))
    assert poles_of(STRUCTURE, high_pass(0.05)).decay_s == pytest.approx(1 / (2 * np.pi * 0.05))
