"""Poles of a structure and a filter against the structure's own steady state, formula by formula."""

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.synth.poles import Structure, accelerance, high_pass, in_series, low_pass, poles_of, tones

RNG = np.random.default_rng(4)
STRUCTURE = Structure(
    frequency_hz=np.array([60.0, 115.0, 1900.0]), damping_ratio=np.array([0.05, 0.003, 0.3]),
    sensor_per_kg=RNG.normal(size=(3, 2)) + 1j * RNG.normal(size=(3, 2)), drive=RNG.normal(size=(3, 6)),
    rigid_body_per_kg=RNG.normal(size=(2, 6)),
)  # fmt: skip
FREQUENCY = np.r_[-500.0, -60.0, 0.0, np.geomspace(1, 2e4, 60), 115.0]


def frequency_response(poles):
    """Complex acceleration per force of ``poles`` in the steady state, shape (channel, axis, frequency)."""
    s, p = 2j * np.pi * FREQUENCY, poles.pole_per_s[:, None]
    near, far = (
        np.einsum("cp,pa,pf->caf", output, poles.input, 0.5 / (s - pole))
        for output, pole in ((poles.output, p), (poles.output.conj(), p.conj()))
    )
    return near + far + poles.direct[:, :, None]


def test_a_filter_in_series_multiplies_the_response():
    for filter in (low_pass(8, 4000.0), low_pass(3, 90.0), in_series(low_pass(7, 900.0), high_pass(2.0))):
        expected = accelerance(STRUCTURE, FREQUENCY) * filter.response(FREQUENCY)
        error = np.abs(frequency_response(poles_of(STRUCTURE, filter)) - expected)
        assert error.max() < 1e-13 * np.abs(accelerance(STRUCTURE, FREQUENCY)).max()


def test_a_mode_on_a_pole_of_the_filter_is_refused():
    filter = low_pass(2, 60.0)
    mode = Structure(
        frequency_hz=np.array([60.0]), damping_ratio=np.array([np.sqrt(0.5)]), sensor_per_kg=np.ones((1, 1)),
        drive=np.ones((1, 6)), rigid_body_per_kg=np.zeros((1, 6)),
    )  # fmt: skip
    with pytest.raises(RequestError, match="same pole; found 60 Hz"):
        poles_of(mode, filter)


# A complex mode against its formula, and the sum of tones against cosines.


def test_a_complex_mode_is_the_pair_of_its_poles_and_residues():
    omega = 2 * np.pi * FREQUENCY
    expected = np.zeros((2, 6, omega.size), dtype=complex) + STRUCTURE.rigid_body_per_kg[:, :, None]
    for j, natural in enumerate(2 * np.pi * STRUCTURE.frequency_hz):
        damping, damped = STRUCTURE.damping_ratio[j] * natural, natural * np.sqrt(1 - STRUCTURE.damping_ratio[j] ** 2)
        pole = -damping + 1j * damped
        for channel in range(2):
            turn = STRUCTURE.sensor_per_kg[j, channel]
            pair = turn * pole**2 / (1j * omega - pole) - (turn * pole**2).conj() / (1j * omega - pole.conj())
            shape = pair / (2j * damped) + turn.real - damping / damped * turn.imag
            expected[channel] += np.outer(STRUCTURE.drive[j], shape)
    found = accelerance(STRUCTURE, FREQUENCY)
    assert np.abs(found - expected).max() < 1e-13 * np.abs(expected).max()


def test_tones_are_the_sum_of_cosines_to_the_last_sample():
    rate_hz, n_samples = 50_000.0, 100_003
    frequency = np.array([5.0, 183.333333333, 24_000.0])
    amplitude = np.array([[1 + 2j, 0.5, -1j], [0.0, 3j, 1e-3]])
    summed = tones(amplitude, frequency, rate_hz=rate_hz, n_samples=n_samples)
    some = np.r_[0:3, 1022:1027, 50_000:50_010, n_samples - 3 : n_samples]
    turns = np.array([[np.longdouble(f) * int(k) / np.longdouble(rate_hz) % 1 for k in some] for f in frequency])
    phasors = np.exp(2j * np.pi * turns.astype(np.float64))
    assert summed.shape == (2, n_samples)
    round_off = 2 * np.pi * np.finfo(float).eps * 48_000  # of the phase after so many periods
    assert np.abs(summed[:, some] - (amplitude @ phasors).real).max() < round_off
