"""Rows of a sweep as if their speeds were held, and as they were, against integration of the oscillator's equation."""

import numpy as np
import pytest

from crankorder.identify.modes.order_blocks import swept_rows
from crankorder.identify.modes.sweep_modes import fits_of_sweeps, with_rows_of_fits
from crankorder.orders.swept_tracks import swept_tracks
from made.shipped import IDENTIFY
from made.swept_machines import SweptMachine, recorded

SHARES = np.array([[1.0], [0.7], [-0.5]])
ORDERS, SIZES = np.array([2.0, 3.5]), np.array([1.0, 0.6])
NATURAL_HZ, DAMPING = 81.3, 0.008


@pytest.mark.parametrize(("rate", "falls"), [(60.0, False), (600.0, True)])
def test_an_order_has_the_steady_answer_of_the_mode_that_it_swept_through(rate, falls):
    rpm = (3000.0, 900.0) if falls else (900.0, 3000.0)
    modes = np.array([NATURAL_HZ]), np.array([DAMPING])
    machine = SweptMachine(ORDERS, SIZES, np.zeros(2), *modes, SHARES, rpm, 2100.0 / rate, 0.001)
    filtered = swept_tracks(*recorded(machine, np.random.default_rng(3)), ORDERS.tolist())
    (told,) = with_rows_of_fits([filtered], fits_of_sweeps([filtered], settings=IDENTIFY))
    rng = np.random.default_rng(3)  # phases and direct parts as `recorded` draws them
    phases, direct = rng.uniform(0, 2 * np.pi, 2), 0.3 * rng.normal(size=(3, 1))
    for order, size, phase in zip(ORDERS.tolist(), SIZES, phases, strict=True):
        rows = swept_rows(order, told)
        f = order * rows["speed"].values / 60.0
        force = size * (rows["speed"].values / 3000.0) ** 2 * np.exp(1j * phase)
        answer = -(f**2) / (NATURAL_HZ**2 - f**2 + 2j * DAMPING * NATURAL_HZ * f)
        truth = force * (direct + SHARES * answer)
        near = np.abs(f / NATURAL_HZ - 1.0) < 4.0 * DAMPING
        assert near.any()
        off = np.abs(rows["held_amplitude"].values - truth)[:, near]
        assert off.max() < 0.03 * np.abs(truth).max(), (order, off.max() / np.abs(truth).max())
        if rate > 500.0:  # so fast that the mode answers by far less, and later
            assert np.abs(rows["amplitude"].values[:, near]).max() < 0.8 * np.abs(truth).max()
