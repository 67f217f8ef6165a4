"""Steady orders against the Cramér–Rao bound, and how often the truth lies in the stated intervals."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.orders.least_squares import joint_orders
from crankorder.orders.map import order_map
from crankorder.settings import load_settings
from made.order_spectra import SAMPLES_PER_REV, angle_frames, coloured, lines

SETTINGS = load_settings().orders
SHORT, LONG = 500, 2500
SIZES = pytest.mark.parametrize("draws", [SHORT, pytest.param(LONG, marks=pytest.mark.accuracy)])


def fits_of(given, *, revs, colour, draws):
    for batch in range(draws // SHORT):
        noise = coloured(np.random.default_rng([revs, batch]), SHORT, revs=revs, colour=colour)
        angle = np.arange(noise.shape[1]) / SAMPLES_PER_REV
        phases = np.outer([order for order, _, _ in given], angle)
        yield joint_orders(noise + lines(noise.shape[1], given), phases)


def share_allowed(hits: int) -> float:
    """Four standard deviations of a share of 95 % among so many."""
    return 4.0 * float(np.sqrt(0.95 * 0.05 / hits))


@SIZES
@pytest.mark.parametrize(
    ("orders", "revs", "colour"),
    [
        ((5.0,), 4, "white"),
        ((5.0, 5.5, 6.0), 16, "white"),
        ((5.5, 5.48), 16, "white"),
        ((5.5, 5.48), 100, "white"),
        ((5.0, 5.5), 60, "pink"),
        ((5.0, 5.5), 60, "resonance"),
    ],
)
def test_the_truth_lies_in_95_of_100_intervals_of_joint_least_squares(orders, revs, colour, draws):
    given = [(order, 3.0 + 2.0 * k, 0.3 + 0.9 * k) for k, order in enumerate(orders)]
    true = np.array([a * np.exp(1j * phase) for _, a, phase in given])
    size, phase = [], []
    for made in fits_of(given, revs=revs, colour=colour, draws=draws):
        low, high, half = made.intervals()
        size.append((low <= np.abs(true)) & (np.abs(true) <= high))
        phase.append(np.abs(np.degrees(np.angle(made.amplitude / true))) <= half)
    for hits in (*np.concatenate(size).T, *np.concatenate(phase).T):
        assert abs(hits.mean() - 0.95) < share_allowed(hits.size)


@SIZES
@pytest.mark.parametrize("revs", [4, 24, 120])
def test_joint_least_squares_reaches_the_cramer_rao_bound(revs, draws):
    given = [(5.0, 3.0, 0.7), (5.5, 1.0, 2.0)]
    true = np.array([a * np.exp(1j * phase) for _, a, phase in given])
    found = np.concatenate([made.amplitude for made in fits_of(given, revs=revs, colour="white", draws=draws)])
    bound = np.sqrt(2.0 / (revs * SAMPLES_PER_REV))
    rms = np.sqrt(np.mean(np.square(np.abs(found) - np.abs(true)), axis=0))
    # a root mean square of n numbers is known to 1/sqrt(2 n): four of these
    assert (rms < bound * (1.0 + 4.0 / np.sqrt(2.0 * draws))).all()


@SIZES
@pytest.mark.parametrize("frames", [6, 36])
def test_the_map_stays_within_a_tenth_of_the_cramer_rao_bound(frames, draws):
    revs, found = 8 * (frames + 1), []
    for batch in range(draws // SHORT):
        noise = coloured(np.random.default_rng([frames, batch]), SHORT, revs=revs, colour="white")
        made = order_map([angle_frames(noise + lines(noise.shape[1], [(5.5, 4.0, 0.7)]))], settings=SETTINGS)
        found.append(made["coherent_amplitude"].sel(order=5.5).values.ravel())
    rms = float(np.sqrt(np.mean((np.concatenate(found) - 4.0) ** 2)))
    assert rms < 1.1 * np.sqrt(2.0 / (revs * SAMPLES_PER_REV)) * (1.0 + 4.0 / np.sqrt(2.0 * draws))
