"""The steady state against an integration that shares nothing with it, and the sum of tones against cosines."""

import numpy as np
import pytest

from crankorder.synth.poles import Structure, accelerance, tones

STRUCTURE = Structure(
    frequency_hz=np.array([60.0, 115.0]),
    damping_ratio=np.array([0.05, 0.03]),
    sensor_per_kg=np.array([[0.006, 0.010], [0.0, -0.008]]),
    drive=np.array([[0.2, 1.0, -0.3, 4.0, 0.0, -2.0], [0.5, -0.7, 0.3, 0.0, 0.0, 3.0]]),
    rigid_body_per_kg=np.array([[0.0, 0.0, 0.002, 0.0, 0.1, 0.0], [0.0, 0.0, 0.003, 0.0, 0.0, 0.2]]),
)
PHASE = np.radians([[30.0, -100.0], [0.0, 170.0]])
COMPLEX = Structure(
    frequency_hz=STRUCTURE.frequency_hz,
    damping_ratio=STRUCTURE.damping_ratio,
    sensor_per_kg=STRUCTURE.sensor_per_kg * np.exp(1j * PHASE),
    drive=STRUCTURE.drive,
    rigid_body_per_kg=STRUCTURE.rigid_body_per_kg,
)


@pytest.mark.cases(1)
@pytest.mark.parametrize("frequency_hz", [20.0, 59.0, 115.0, 180.0])
def test_the_steady_state_is_what_an_integration_settles_to(frequency_hz: float) -> None:
    from scipy.integrate import solve_ivp

    omega = 2 * np.pi * STRUCTURE.frequency_hz
    force = np.array([3.0, -2.0 + 1j, 5j, 0.2, 0.1j, -0.3])
    period, settled = 1 / frequency_hz, 1.5

    def motion(time: float, state: np.ndarray) -> np.ndarray:
        modal = STRUCTURE.drive @ (force * np.exp(2j * np.pi * frequency_hz * time)).real
        speed = state[2:]
        return np.concatenate([speed, modal - 2 * STRUCTURE.damping_ratio * omega * speed - omega**2 * state[:2]])

    times = settled + np.arange(24) / 24 * period
    span = (0.0, times[-1])
    # rest is no steady state: 1.5 s are e^-28 of the slower mode's decay
    solved = solve_ivp(motion, span, np.zeros(4), method="DOP853", t_eval=times, rtol=1e-11, atol=1e-15)
    at_times = (force[:, None] * np.exp(2j * np.pi * frequency_hz * times)).real
    modal_acceleration = np.array([motion(t, s)[2:] for t, s in zip(times, solved.y.T, strict=True)])
    integrated = modal_acceleration @ STRUCTURE.sensor_per_kg + (STRUCTURE.rigid_body_per_kg @ at_times).T
    amplitude = accelerance(STRUCTURE, frequency_hz)[:, :, 0] @ force
    steady = (amplitude[:, None] * np.exp(2j * np.pi * frequency_hz * times)).real
    assert np.abs(steady - integrated.T).max() < 1e-8 * np.abs(steady).max()


def test_at_rest_only_the_rigid_body_answers_and_far_above_all_residues_add() -> None:
    static, high = np.moveaxis(accelerance(STRUCTURE, [0.0, 1e7]), -1, 0)
    assert np.array_equal(static, STRUCTURE.rigid_body_per_kg)
    residues = np.einsum("jc,ja->ca", STRUCTURE.sensor_per_kg, STRUCTURE.drive)
    assert np.abs(high - STRUCTURE.rigid_body_per_kg - residues).max() < 1e-6 * np.abs(residues).max()


def test_a_complex_mode_is_the_pair_of_its_poles_and_residues() -> None:
    omega = 2 * np.pi * np.array([0.0, 3.0, 59.0, 115.0, 400.0, -70.0])
    expected = np.zeros((2, 6, omega.size), dtype=complex) + COMPLEX.rigid_body_per_kg[:, :, None]
    for j, natural in enumerate(2 * np.pi * COMPLEX.frequency_hz):
        damping, damped = COMPLEX.damping_ratio[j] * natural, natural * np.sqrt(1 - COMPLEX.damping_ratio[j] ** 2)
        pole = -damping + 1j * damped
        for channel in range(2):
            turn, size = np.exp(1j * PHASE[j, channel]), STRUCTURE.sensor_per_kg[j, channel]
            pair = turn * pole**2 / (1j * omega - pole) - (turn * pole**2).conj() / (1j * omega - pole.conj())
            shape = size * (pair / (2j * damped) + turn.real - damping / damped * turn.imag)
            expected[channel] += np.outer(COMPLEX.drive[j], shape)
    found = accelerance(COMPLEX, omega / (2 * np.pi))
    assert np.abs(found - expected).max() < 1e-13 * np.abs(expected).max()


def test_tones_are_the_sum_of_cosines_to_the_last_sample() -> None:
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


def test_the_power_of_tones_is_that_of_their_lines() -> None:
    """Parseval: over whole periods of all lines the mean square is half the sum of their squared peaks."""
    frequency = np.array([5.0, 183.0, 2400.0])
    amplitude = np.array([[1 + 2j, 0.5, -1j], [0.0, 3j, 1e-3]])
    summed = tones(amplitude, frequency, rate_hz=50_000.0, n_samples=50_000)
    power = 0.5 * (np.abs(amplitude) ** 2).sum(axis=1)
    assert np.abs((summed**2).mean(axis=1) / power - 1).max() < 1e-12
