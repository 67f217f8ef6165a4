"""Run-ups, wobbles and cycles against an integration of the same modes that shares nothing with it."""

from bisect import bisect_right
from itertools import pairwise, product

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from crankorder.engine.torsional_fluctuation import Lag
from crankorder.errors import RequestError
from crankorder.synth.driven import (
    STENCILS,
    ForceLines,
    Integration,
    advance,
    driven_signal,
    integration_for,
    interpolation_error,
    step_weights,
)
from crankorder.synth.motion import Motion
from crankorder.synth.poles import Poles, Structure, accelerance, poles_of, steady_state
from made.structures import frequency_response

RATE_HZ = 5000.0
OMEGA, ZETA = 2 * np.pi * np.array([60.0, 115.0, 400.0]), np.array([0.15, 0.1, 0.05])
SENSOR = np.array([[0.006, 0.010], [0.0, -0.008], [0.004, 0.001]]) * np.exp(1j * np.array([[0, 0], [0, 0.6], [2.0, 0]]))
DRIVE = np.array([[0.2, 1.0, -0.3, 4.0, 0.0, -2.0], [0.5, -0.7, 0.3, 0.0, 0.0, 3.0], [0.1, 0.4, 0.9, 0.0, 2.0, 0.0]])
RIGID = np.array([[0.0, 0.0, 0.002, 0.0, 0.1, 0.0], [0.001, 0.0, 0.003, 0.0, 0.0, 0.2]])
STRUCTURE = Structure(
    frequency_hz=OMEGA / (2 * np.pi), damping_ratio=ZETA, sensor_per_kg=SENSOR, drive=DRIVE, rigid_body_per_kg=RIGID
)
POLES = poles_of(STRUCTURE)
TWICE_DAMPING, SQUARED = 2 * ZETA * OMEGA, OMEGA**2

ORDERS = np.array([1.0, 2.0, 4.0, 2.5, 1.37])
PLACES = np.random.default_rng(2).normal(size=(6, 2, 5)) * np.array([1e-3, 4e-4, 2e-5, 0.0, 0.0])
"""Cosine and sine parts of mass times place (kg·m) along each axis: forces are its second derivative in time."""
PUSHES = np.random.default_rng(3).normal(size=(6, 2, 5)) * np.array([0.0, 0.0, 0.0, 5.0, 8.0])
"""Forces that grow as speed to the power of 2 (order 2.5) or not at all (1.37), N at 1000 rpm."""
AT_RPM = 1000.0


def lines(*, gas=False):
    omega = AT_RPM * np.pi / 30
    place, push = (part[:, 0] - 1j * part[:, 1] for part in (PLACES, PUSHES))
    return ForceLines(
        order=ORDERS, amplitude=push - (ORDERS * omega) ** 2 * place, at_speed_rpm=np.full(5, AT_RPM),
        exponent=np.array([2.0, 2.0, 2.0, 2.0, 0.0]), inertia=np.array([True, True, True, False, False]),
        gas=np.array([False, False, False, True, True]) & gas, cause=("mass", "mass", "mass", "push", "push"),
    )  # fmt: skip


def plain_force(phi, omega, alpha, gas_gain=1.0):
    """Forces where the shaft is at ``phi`` (rad) with ``omega`` (rad/s) and ``alpha`` (rad/s²)."""
    cosine, sine = np.cos(ORDERS * phi), np.sin(ORDERS * phi)
    # d²/dt² of cos kφ is −kα sin kφ − (kω)² cos kφ, of sin kφ it is kα cos kφ − (kω)² sin kφ
    along, across = -((ORDERS * omega) ** 2), ORDERS * alpha
    masses = PLACES[:, 0] @ (along * cosine - across * sine) + PLACES[:, 1] @ (along * sine + across * cosine)
    grown = np.where(ORDERS == 2.5, (omega * 30 / np.pi / AT_RPM) ** 2, 1.0) * gas_gain
    return masses + PUSHES[:, 0] @ (grown * cosine) + PUSHES[:, 1] @ (grown * sine)


def integrated(force_of_time, sample_s, *, borders_s, start):
    """Channels at ``sample_s``: q̈ + 2ζω q̇ + ω² q = drive·f from border to border, DOP853 with 1e-13."""
    found, state = [], start
    for begin, end in pairwise(borders_s):
        first, last = np.nextafter(begin, end), np.nextafter(end, begin)  # which formula holds is never in doubt

        def force(time, first=first, last=last):
            return force_of_time(min(max(time, first), last))

        def motion(time, state, force=force):
            q, speed = state[:3], state[3:]
            return np.concatenate([speed, DRIVE @ force(time) - TWICE_DAMPING * speed - SQUARED * q])

        within = sample_s[(sample_s >= begin) & (sample_s < end)]
        wanted = np.append(within, end)
        solved = solve_ivp(motion, (begin, end), state, method="DOP853", t_eval=wanted, rtol=1e-13, atol=1e-17)
        found += [channels(motion(t, y), y, force(t)) for t, y in zip(within, solved.y.T, strict=False)]
        state = solved.y[:, -1]
    return np.array(found).T


def channels(rates, state, force):
    """Acceleration of the sensors; a complex residue also takes the mode's velocity, twice differentiated."""
    damped = OMEGA * np.sqrt(1 - ZETA**2)
    acceleration, speed = rates[3:], state[3:]
    third = -2 * ZETA * OMEGA * acceleration - OMEGA**2 * speed  # d³q/dt³ without the force's own derivative
    in_phase = acceleration @ SENSOR.real
    turned = (ZETA * OMEGA / damped * acceleration + third / damped) @ SENSOR.imag
    return in_phase + turned + RIGID @ force


def steady_start(rpm, phi):
    """Modes in the steady state of a constant speed, at the angle ``phi`` (rad)."""
    state = np.zeros(6)
    omega = rpm * np.pi / 30
    for k, order in enumerate(ORDERS):
        scale = (rpm / AT_RPM) ** 2 if order == 2.5 else 1.0
        peak = scale * (PUSHES[:, 0, k] - 1j * PUSHES[:, 1, k])
        peak = peak - (order * omega) ** 2 * (PLACES[:, 0, k] - 1j * PLACES[:, 1, k])
        s = 1j * order * omega
        q = (DRIVE @ peak) / (OMEGA**2 + 2 * ZETA * OMEGA * s + s**2) * np.exp(1j * order * phi)
        state += np.concatenate([q.real, (s * q).real])
    return state


def course(motion):
    """Angle (rad), speed (rad/s) and acceleration (rad/s²) of a motion at one time."""

    def at(time):
        rev, rpm, rpm_per_s = (float(part[0]) for part in motion.at(np.array([time])))
        return 2 * np.pi * rev, rpm * np.pi / 30, rpm_per_s * np.pi / 30

    return at


def profile_course(corners, start_rev):
    """As :func:`course`, of a speed that runs straight from corner to corner: plain numbers, for many calls."""
    times, omega = (np.array(part) for part in zip(*corners, strict=True))
    omega = omega * np.pi / 30
    turned = np.append(0.0, np.cumsum(np.diff(times) * (omega[1:] + omega[:-1]) / 2)).tolist()
    slopes = [0.0, *(np.diff(omega) / np.diff(times)).tolist(), 0.0]
    times, omega = times.tolist(), omega.tolist()

    def at(time):
        piece = bisect_right(times, time)
        corner, slope = max(piece - 1, 0), slopes[piece]
        after = time - times[corner]
        angle = turned[corner] + after * (omega[corner] + 0.5 * slope * after)
        return angle + start, omega[corner] + slope * after, slope

    start = 0.0
    start = 2 * np.pi * start_rev - at(0.0)[0]
    return at


PROFILES = {
    "run-up": ((0.0, 300.0), (0.25, 5000.0)), "corners": ((0.04, 900.0), (0.1, 2700.0), (0.16, 2700.0), (0.2, 300.0)),
    "corners between samples": ((0.04003, 900.0), (0.10017, 2700.0), (0.1600071, 2700.0), (0.2, 300.0)),
    "reversal": ((0.02, 700.0), (0.2, -1500.0)), "from standstill": ((0.04, 0.0), (0.2, 2000.0)),
}  # fmt: skip


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", PROFILES)
def test_a_run_up_is_what_a_precise_integration_gives(name):
    corners, start_rev, n_samples = PROFILES[name], 0.3, 1300
    motion = Motion(start_rev=start_rev, corners=corners)
    at, times = profile_course(corners, start_rev), np.arange(n_samples) / RATE_HZ
    borders = tuple(sorted({0.0, *(time for time, _ in corners), times[-1] + 0.5 / RATE_HZ}))
    start = steady_start(corners[0][1], 2 * np.pi * start_rev)
    expected = integrated(lambda time: plain_force(*at(time)), times, borders_s=borders, start=start)
    sources = [(lines(), motion)]
    for tolerance, allowed in ((1e-9, 1e-11), (1e-12, 1e-12)):
        found = driven_signal(POLES, sources, rate_hz=RATE_HZ, n_samples=n_samples, tolerance=tolerance)
        error = np.abs(found - expected).max() / np.abs(expected).max()
        assert error < allowed


@pytest.mark.parametrize("rpm", [60.0, 1234.5, -900.0, 9000.0])
def test_at_a_constant_speed_the_response_is_the_accelerance_to_round_off(rpm):
    n_samples, start_rev = 10_000, 0.3
    motion = Motion(start_rev=start_rev, corners=((0.0, rpm),))
    found = driven_signal(POLES, [(lines(), motion)], rate_hz=RATE_HZ, n_samples=n_samples, tolerance=1e-14)
    amplitude = np.einsum("cal,al->cl", accelerance(STRUCTURE, ORDERS * rpm / 60), lines().at_speed(rpm))
    turns = ORDERS[:, None] * (start_rev + rpm / 60 * np.arange(n_samples) / RATE_HZ)
    expected = (amplitude @ np.exp(2j * np.pi * turns)).real
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


LAG = Lag(order=np.array([2.0]), inertia=np.array([0.01 + 0j]), gas=np.zeros(1, dtype=complex))
UNEVEN = {
    "wobble": Motion(start_rev=0.3, corners=((0.0, 1500.0),), wobbles=((7.0, 60.0, 50.0),)),
    "lag": Motion(start_rev=0.3, corners=((0.0, 1500.0),), lag=LAG),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", UNEVEN)
def test_an_uneven_rotation_has_its_past(name):
    motion, at = UNEVEN[name], course(UNEVEN[name])
    times, past_s = np.arange(300) / RATE_HZ, 0.5
    expected = integrated(
        lambda time: plain_force(*at(time)), times, borders_s=(-past_s, times[-1] + 0.5 / RATE_HZ),
        start=steady_start(1500.0, at(-past_s)[0]),
    )  # fmt: skip
    found = driven_signal(POLES, [(lines(), motion)], rate_hz=RATE_HZ, n_samples=300)
    assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()


def factor(cycle):
    return 1 + 0.3 * np.sin(5.0 * np.asarray(cycle) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("corners", [((0.02, 1500.0), (0.0801, 4000.0)), ((0.01, 1200.0), (0.1, -2400.0))])
def test_gains_step_between_cycles_to_the_very_angle(corners):
    times, past_s, start_rev = np.arange(600) / RATE_HZ, 0.5, 0.3017
    motion, at = Motion(start_rev=start_rev, corners=corners), profile_course(corners, start_rev)
    inner = [-past_s, *(time for time, _ in corners), times[-1] + 0.5 / RATE_HZ]
    fine = np.linspace(-past_s, times[-1] + 0.5 / RATE_HZ, 5001)
    cycle = np.floor([at(time)[0] / (4 * np.pi) for time in fine])
    for k in np.flatnonzero(np.diff(cycle)):
        low, high, target = fine[k], fine[k + 1], 4 * np.pi * max(cycle[k], cycle[k + 1])
        rising = cycle[k + 1] > cycle[k]
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if (at(middle)[0] < target) == rising else (low, middle)
        inner.append(high)

    def force(time):
        phi, omega, alpha = at(time)
        return plain_force(phi, omega, alpha, float(factor(np.floor(phi / (4 * np.pi)))))

    expected = integrated(
        force, times, borders_s=tuple(sorted(set(inner))), start=steady_start(corners[0][1], at(-past_s)[0])
    )
    found = driven_signal(POLES, [(lines(gas=True), motion)], rate_hz=RATE_HZ, n_samples=600, gain_of_cycle=factor)
    assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()


@pytest.mark.cases(1)
@pytest.mark.parametrize("gain", [None, factor], ids=["no gains", "gains"])
def test_blocks_leave_no_seam(gain):
    shafts = [
        (lines(gas=True), Motion(start_rev=0.3, corners=((0.1, 600.0), (0.3, 3000.0)))),
        (lines(), Motion(start_rev=0.0, corners=((0.1003, -700.0), (0.2, -710.0)))),
    ]
    whole, *parts = (
        driven_signal(POLES, shafts, rate_hz=RATE_HZ, n_samples=1600, gain_of_cycle=gain, block_steps=size)
        for size in (1 << 20, 2, 37, 1000)
    )
    for part in parts:
        assert np.abs(part - whole).max() < 1e-13 * np.abs(whole).max()


# The error of a step against its own bound, and the drift of many.


STEP_RATE_HZ = 8192.0


def tone_error(pole_per_step, phase_rad, integration):
    """Relative error of the steady response of a pole to a tone: both are known in closed form."""
    growth, taps = step_weights(np.array([pole_per_step]), 1.0, integration)
    samples = np.exp(1j * phase_rad * (np.arange(taps.shape[1]) - (integration.stencil // 2 - 1)))
    found = (taps[0] * samples).sum() / (np.exp(1j * phase_rad * integration.substeps) - 1 - growth[0])
    return abs(found * (1j * phase_rad - pole_per_step) - 1)


def test_the_chosen_integration_meets_its_tolerance_and_a_cheaper_one_does_not():
    for share, tolerance in product((0.01, 0.2, 0.95, 3.0), (1e-3, 1e-9, 1e-12)):
        frequency = share * STEP_RATE_HZ / 2
        chosen = integration_for(frequency, STEP_RATE_HZ, tolerance)
        phase = 2 * np.pi * frequency / STEP_RATE_HZ
        assert tone_error(-0.001 + 0.03j, phase / chosen.substeps, chosen) < max(tolerance, 1e-13)
        cheaper = [Integration(s, chosen.substeps) for s in STENCILS if s < chosen.stencil]
        cheaper += [Integration(s, chosen.substeps - 1) for s in STENCILS if chosen.substeps > 1]
        assert all(interpolation_error(way.stencil, phase / way.substeps) > tolerance for way in cheaper)


def test_what_no_integration_can_follow_is_refused():
    with pytest.raises(RequestError, match="change too fast"):
        integration_for(2e6, STEP_RATE_HZ, 1e-12)


@pytest.mark.slow
def test_ten_million_steps_do_not_drift():
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
    worst, (growth, taps) = 0.0, step_weights(mode.pole_per_s, 1 / rate, integration)
    for _ in range(2500):
        signal, state = advance(mode, force, growth=growth, taps=taps, integration=integration, state=state)
        worst = max(worst, float(np.abs(signal[0] - expected).max()))
    assert worst < 1e-13 * peak
