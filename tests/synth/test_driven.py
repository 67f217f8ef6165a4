"""Run-ups, wobbles and cycles against an integration of the same modes that shares nothing with it."""

from itertools import product

import numpy as np
import pytest
from scipy.optimize import brentq

from crankorder.engine.torsional_fluctuation import Lag
from crankorder.errors import RequestError
from crankorder.synth import driven
from crankorder.synth.motion import Motion
from crankorder.synth.poles import Poles, Structure, accelerance, poles_of, steady_state

RATE_HZ = 5000.0
OMEGA, ZETA = 2 * np.pi * np.array([60.0, 115.0, 400.0]), np.array([0.15, 0.1, 0.05])
SENSOR = np.array([[0.006, 0.010], [0.0, -0.008], [0.004, 0.001]]) * np.exp(1j * np.array([[0, 0], [0, 0.6], [2.0, 0]]))
DRIVE = np.array([[0.2, 1.0, -0.3, 4.0, 0.0, -2.0], [0.5, -0.7, 0.3, 0.0, 0.0, 3.0], [0.1, 0.4, 0.9, 0.0, 2.0, 0.0]])
RIGID = np.array([[0.0, 0.0, 0.002, 0.0, 0.1, 0.0], [0.001, 0.0, 0.003, 0.0, 0.0, 0.2]])
STRUCTURE = Structure(
    frequency_hz=OMEGA / (2 * np.pi), damping_ratio=ZETA, sensor_per_kg=SENSOR, drive=DRIVE, rigid_body_per_kg=RIGID
)
POLES = poles_of(STRUCTURE)

ORDERS = np.array([1.0, 2.0, 4.0, 2.5, 1.37])
PLACES = np.random.default_rng(2).normal(size=(6, 2, 5)) * np.array([1e-3, 4e-4, 2e-5, 0.0, 0.0])
"""Cosine and sine parts of mass times place (kg·m) along each axis: forces are its second derivative in time."""
PUSHES = np.random.default_rng(3).normal(size=(6, 2, 5)) * np.array([0.0, 0.0, 0.0, 5.0, 8.0])
"""Forces that grow as speed to the power of 2 (order 2.5) or not at all (1.37), N at 1000 rpm."""
AT_RPM = 1000.0


def lines(*, gas=False):
    omega = AT_RPM * np.pi / 30
    place, push = (part[:, 0] - 1j * part[:, 1] for part in (PLACES, PUSHES))
    return driven.ForceLines(
        order=ORDERS, amplitude=push - (ORDERS * omega) ** 2 * place, at_speed_rpm=np.full(5, AT_RPM),
        exponent=np.array([2.0, 2.0, 2.0, 2.0, 0.0]), inertia=np.array([True, True, True, False, False]),
        gas=np.array([False, False, False, True, True]) & gas, cause=("mass", "mass", "mass", "push", "push"),
    )  # fmt: skip


def plain_force(phi, omega, alpha, gas_gain=1.0):
    """Forces (axis, time) where the shaft is at ``phi`` (rad) with ``omega`` (rad/s) and ``alpha`` (rad/s²)."""
    order = ORDERS[:, None]
    cosine, sine = np.cos(order * phi), np.sin(order * phi)
    # d²/dt² of cos kφ is −kα sin kφ − (kω)² cos kφ, of sin kφ it is kα cos kφ − (kω)² sin kφ
    along, across = -((order * omega) ** 2), order * alpha
    masses = PLACES[:, 0] @ (along * cosine - across * sine) + PLACES[:, 1] @ (along * sine + across * cosine)
    grown = np.where(order == 2.5, (omega * 30 / np.pi / AT_RPM) ** 2, 1.0) * gas_gain
    return masses + PUSHES[:, 0] @ (grown * cosine) + PUSHES[:, 1] @ (grown * sine)


def integrated(force_at, sample_s, borders_s):
    """Channels at ``sample_s``: ∫ e^{p(t − s)} drive·f(s) ds of each mode, from rest at the first of ``borders_s``.

    Gauss-Legendre between samples and borders, where the forces are smooth. A complex residue also takes the mode's
    velocity, twice differentiated.
    """
    nodes, weights = np.polynomial.legendre.leggauss(12)
    damped = OMEGA * np.sqrt(1 - ZETA**2)
    pole, knots = -ZETA * OMEGA + 1j * damped, np.union1d(sample_s, borders_s)
    steps = np.diff(knots)
    inside = knots[:-1, None] + 0.5 * steps[:, None] * (1 + nodes)
    pushed = (DRIVE @ force_at(inside.ravel())).reshape(3, *inside.shape)
    parts = np.exp(pole[:, None, None] * (knots[1:, None] - inside)) * pushed @ weights * steps / 2
    state = np.zeros((3, len(knots)), dtype=complex)
    for k, step in enumerate(steps):
        state[:, k + 1] = np.exp(pole * step) * state[:, k] + parts[:, k]
    at_samples = state[:, np.searchsorted(knots, sample_s)]
    force = force_at(sample_s)
    place, speed = (np.imag(factors[:, None] * at_samples) / damped[:, None] for factors in (np.ones(3), pole))
    acceleration = DRIVE @ force - (2 * ZETA * OMEGA)[:, None] * speed - (OMEGA**2)[:, None] * place
    third = -(2 * ZETA * OMEGA)[:, None] * acceleration - (OMEGA**2)[:, None] * speed  # without the force's derivative
    turned = ((ZETA * OMEGA)[:, None] * acceleration + third) / damped[:, None]
    return SENSOR.real.T @ acceleration + SENSOR.imag.T @ turned + RIGID @ force


def factor(cycle):
    return 1 + 0.3 * np.sin(5.0 * np.asarray(cycle) ** 2)


LAG = Lag(order=np.array([2.0]), inertia=np.array([0.01 + 0j]), gas=np.zeros(1, dtype=complex))
CORNERS = ((0.02003, 900.0), (0.05017, 2700.0), (0.0800071, 2700.0), (0.12001, 300.0))
MOTIONS = {
    "run-up": ({"corners": ((0.0003, 300.0), (0.2503, 5000.0))}, None), "corners": ({"corners": CORNERS}, None),
    "from standstill": ({"corners": ((0.0403, 0.0), (0.2003, 2000.0))}, None),
    "wobble": ({"corners": ((0.0, 1500.0),), "wobbles": ((7.0, 60.0, 50.0),)}, None),
    "lag": ({"corners": ((0.0, 1500.0),), "lag": LAG}, None),
    "reversal with a gain of each cycle": ({"corners": ((0.0103, 1200.0), (0.1003, -2400.0))}, factor),
}  # fmt: skip
"""Motions, and the gain of their gas in each cycle."""


@pytest.mark.cases(len(MOTIONS))
@pytest.mark.parametrize("name", MOTIONS)
def test_the_response_to_any_motion_is_what_a_precise_integration_gives(name):
    """With gains that step at the very angle of a new cycle."""
    (parts, gain), times = MOTIONS[name], np.arange(1300) / RATE_HZ
    motion, past_s = Motion(start_rev=0.3017, **parts), np.arange(-4000, len(times)) / RATE_HZ
    borders = [*past_s, *(time for time, _ in motion.corners)]
    cycle = motion.at(past_s)[0] / 2
    for k in np.flatnonzero(np.diff(np.floor(cycle))) if gain else ():
        border = np.ceil(min(cycle[k], cycle[k + 1]))
        off = lambda time, border=border: motion.at(np.array([time]))[0][0] / 2 - border  # noqa: E731
        borders.append(brentq(off, past_s[k], past_s[k + 1], xtol=1e-15))

    def force(time_s):
        rev, rpm, rpm_per_s = motion.at(time_s)
        return plain_force(
            2 * np.pi * rev, rpm * np.pi / 30, rpm_per_s * np.pi / 30, gain(np.floor(rev / 2)) if gain else 1.0
        )

    expected, sources = integrated(force, times, borders), [(lines(gas=gain is not None), motion)]
    for tolerance, allowed in ((1e-9, 1e-11), (1e-12, 1e-11 if name in ("wobble", "lag") else 1e-12)):
        found = driven.driven_signal(
            POLES, sources, rate_hz=RATE_HZ, n_samples=len(times), tolerance=tolerance, gain_of_cycle=gain
        )
        assert np.abs(found - expected).max() < allowed * np.abs(expected).max()


@pytest.mark.parametrize("rpm", [60.0, 1234.5, -900.0, 9000.0])
def test_at_a_constant_speed_the_response_is_the_accelerance_to_round_off(rpm):
    n_samples, start_rev = 10_000, 0.3
    motion = Motion(start_rev=start_rev, corners=((0.0, rpm),))
    found = driven.driven_signal(POLES, [(lines(), motion)], rate_hz=RATE_HZ, n_samples=n_samples, tolerance=1e-14)
    amplitude = np.einsum("cal,al->cl", accelerance(STRUCTURE, ORDERS * rpm / 60), lines().at_speed(rpm))
    turns = ORDERS[:, None] * (start_rev + rpm / 60 * np.arange(n_samples) / RATE_HZ)
    expected = (amplitude @ np.exp(2j * np.pi * turns)).real
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


def test_blocks_leave_no_seam():
    shafts = [
        (lines(gas=True), Motion(start_rev=0.3, corners=((0.1, 600.0), (0.3, 3000.0)))),
        (lines(), Motion(start_rev=0.0, corners=((0.1003, -700.0), (0.2, -710.0)))),
    ]
    whole, *parts = (
        driven.driven_signal(POLES, shafts, rate_hz=RATE_HZ, n_samples=1600, gain_of_cycle=factor, block_steps=size)
        for size in (1 << 20, 37, 1000)
    )
    for part in parts:
        assert np.abs(part - whole).max() < 1e-13 * np.abs(whole).max()


# The error of a step against its own bound, and the drift of many.


STEP_RATE_HZ = 8192.0


def tone_error(pole_per_step, phase_rad, integration):
    """Relative error of the steady response of a pole to a tone: both are known in closed form."""
    growth, taps = driven.step_weights(np.array([pole_per_step]), 1.0, integration)
    samples = np.exp(1j * phase_rad * (np.arange(taps.shape[1]) - (integration.stencil // 2 - 1)))
    found = (taps[0] * samples).sum() / (np.exp(1j * phase_rad * integration.substeps) - 1 - growth[0])
    return abs(found * (1j * phase_rad - pole_per_step) - 1)


def test_the_chosen_integration_meets_its_tolerance_and_a_cheaper_one_does_not():
    for share, tolerance in product((0.01, 0.2, 0.95, 3.0), (1e-3, 1e-9, 1e-12)):
        frequency = share * STEP_RATE_HZ / 2
        chosen = driven.integration_for(frequency, STEP_RATE_HZ, tolerance)
        phase = 2 * np.pi * frequency / STEP_RATE_HZ
        assert tone_error(-0.001 + 0.03j, phase / chosen.substeps, chosen) < max(tolerance, 1e-13)
        cheaper = [driven.Integration(s, chosen.substeps) for s in driven.STENCILS if s < chosen.stencil]
        cheaper += [driven.Integration(s, chosen.substeps - 1) for s in driven.STENCILS if chosen.substeps > 1]
        assert all(driven.interpolation_error(way.stencil, phase / way.substeps) > tolerance for way in cheaper)


def test_what_no_integration_can_follow_is_refused():
    with pytest.raises(RequestError, match="change too fast"):
        driven.integration_for(2e6, STEP_RATE_HZ, 1e-12)


def test_half_a_million_steps_do_not_drift():
    """A lightly damped mode at resonance, whose gain is that of 1/(1 − |e^{λh}|) = 10⁵ steps."""
    natural, damping, rate = 2 * np.pi * 60.0, 2e-3, 80_000.0
    pole = natural * (-damping + 1j * np.sqrt(1 - damping**2))
    mode = Poles(pole_per_s=np.array([pole]), input=np.eye(1), output=np.ones((1, 1)) + 0j, direct=np.zeros((1, 1)))
    integration, state = driven.Integration(6, 1), steady_state(mode, np.ones((1, 1)), np.array([60.0]))
    # 60 Hz repeats after 4000 samples exactly: the forces have no rounding that grows
    turn = np.exp(2j * np.pi * (np.arange(-3, 4003) * 3 % 4000) / 4000)
    response = sum(0.5 / (2j * np.pi * 60.0 - one) for one in (pole, pole.conjugate()))
    expected, force = (response * turn[3:-3]).real, np.ascontiguousarray(turn.real[None])
    worst, (growth, taps) = 0.0, driven.step_weights(mode.pole_per_s, 1 / rate, integration)
    for _ in range(125):
        signal, state = driven.advance(mode, force, growth=growth, taps=taps, integration=integration, state=state)
        worst = max(worst, float(np.abs(signal[0] - expected).max()))
    assert worst < 1e-13 * np.abs(expected).max()
