"""Rows of a sweep as if their speeds were held, and as they were, against integration of the oscillator's equation."""

import numpy as np
import pytest

from crankorder.identify.modes.order_blocks import swept_rows
from crankorder.identify.modes.sweep_modes import fits_of_sweeps, with_rows_of_fits
from crankorder.orders.swept_tracks import swept_tracks
from crankorder.settings import load_settings
from made.swept_machines import RATE_HZ, SweptMachine, acceleration, recorded

SETTINGS = load_settings().identify
SHARES = np.array([[1.0], [0.7], [-0.5]])


def _machine(orders, size, mode, rpm, rate):
    """Two ``orders`` of forces ``size`` that pass one ``mode`` (Hz, damping ratio) at a ``rate`` (rpm/s)."""
    seconds = abs(rpm[1] - rpm[0]) / rate
    natural, damping = np.array(mode[:1]), np.array(mode[1:])
    return SweptMachine(np.array(orders), np.array(size), np.zeros(2), natural, damping, SHARES, rpm, seconds, 0.001)


def _phases_and_direct(seed):
    """Phases of both orders and the direct part (3,) of the responses, as :func:`recorded` draws them."""
    rng = np.random.default_rng(seed)
    phases = np.array([rng.uniform(0, 2 * np.pi) for _ in range(2)])
    return phases, 0.3 * rng.normal(size=(3, 1))[:, 0]


def _told(machine, seed):
    """Tracks of ``machine`` as the filter tells them, and with the rows of the windows' fit."""
    filtered = swept_tracks(*recorded(machine, np.random.default_rng(seed)), machine.orders.tolist())
    (told,) = with_rows_of_fits([filtered], fits_of_sweeps([filtered], settings=SETTINGS))
    return filtered, told


def _growth(machine, place, speed):
    return np.asarray(machine.size[place] * ((speed / max(machine.rpm)) ** 2 if machine.orders[place] < 4 else 1.0))


@pytest.mark.cases(2)
@pytest.mark.parametrize("rate", [60.0, 150.0, 600.0])
@pytest.mark.parametrize("falls", [False, True])
def test_an_order_has_the_steady_answer_of_the_mode_that_it_swept_through(rate, falls):
    rpm, (natural, zeta) = (900.0, 3000.0), (81.3, 0.008)
    machine = _machine((2.0, 3.5), (1.0, 0.6), (natural, zeta), rpm[::-1] if falls else rpm, rate)
    _, told = _told(machine, 3)
    phases, direct = _phases_and_direct(3)
    for place, order in enumerate(machine.orders.tolist()):
        rows = swept_rows(order, told)
        assert rows is not None
        f = order * rows["speed"].values / 60.0
        force = _growth(machine, place, rows["speed"].values) * np.exp(1j * phases[place])
        answer = -(f**2) / (natural**2 - f**2 + 2j * zeta * natural * f)
        truth = force * (direct[:, None] + SHARES * answer)
        near = np.abs(f / natural - 1.0) < 4.0 * zeta
        assert near.any()
        off = np.abs(rows["held_amplitude"].values - truth)[:, near]
        assert off.max() < 0.03 * np.abs(truth).max(), (order, off.max() / np.abs(truth).max())
        if rate > 500.0:  # so fast that the mode answers by far less, and later
            assert np.abs(rows["amplitude"].values[:, near]).max() < 0.8 * np.abs(truth).max()


@pytest.mark.parametrize("seed", range(2))
def test_a_lower_order_is_what_it_is_while_a_mode_rings_from_a_higher_one(seed):
    rng = np.random.default_rng([seed, 5])
    natural, zeta = float(rng.uniform(180.0, 260.0)), float(rng.uniform(0.002, 0.005))
    machine = _machine((8.0, 8.5), (0.03, 1.0), (natural, zeta), (900.0, 3300.0), 600.0)
    filtered, told = _told(machine, seed)
    phases, direct = _phases_and_direct(seed)
    time = np.arange(round(machine.duration_s * RATE_HZ)) / RATE_HZ
    turn = 0.37 + (900.0 * time + 300.0 * time**2) / 60.0
    force = 0.03 * np.exp(1j * (2.0 * np.pi * 8.0 * turn + phases[0]))
    rung = acceleration(force.real, natural, zeta) + 1j * acceleration(force.imag, natural, zeta)
    own = (direct[:, None] * force + SHARES * rung) * np.exp(-2j * np.pi * 8.0 * turn)

    def off(tracks):
        at = tracks["time"].values
        true = np.array([np.interp(at, time, row.real) + 1j * np.interp(at, time, row.imag) for row in own])
        near = np.abs(8.0 * tracks["speed"].values / 60.0 / natural - 1.0) < 0.03
        return float(np.nanmax(np.abs(tracks["amplitude"].values[:, 0] - true)[:, near]) / np.abs(true).max())

    assert off(filtered) > 0.5
    assert off(told) < 0.1 * off(filtered)
