"""Steady orders against the Cramér–Rao bound, and how often the truth lies in the stated intervals."""

import numpy as np
import pytest

from crankorder.orders.map import order_map
from crankorder.settings import load_settings
from made.order_spectra import SAMPLES_PER_REV, angle_frames, coloured, lines, tracked

SETTINGS = load_settings().orders
SHORT, LONG = 500, 2500
NAMES = ("amplitude", "amplitude_low", "amplitude_high", "phase", "phase_ci95")
SIZES = pytest.mark.parametrize("draws", [SHORT, pytest.param(LONG, marks=pytest.mark.accuracy)])


def tracks_of(given, *, revs, colour, draws):
    """Variables (draws, orders) of the tracks of lines ``given`` in noise, by name."""
    tracks = []
    for batch in range(draws // SHORT):
        noise = coloured(np.random.default_rng([revs, batch]), SHORT, revs=revs, colour=colour)
        orders = tuple(order for order, _, _ in given)
        tracks.append(tracked(noise + lines(noise.shape[1], given), orders))
    return {name: np.concatenate([part[name].values for part in tracks]) for name in NAMES}


def share_allowed(hits):
    """Four standard deviations of a share of 95 % among so many."""
    return 4.0 * float(np.sqrt(0.95 * 0.05 / hits))


@SIZES
@pytest.mark.parametrize(
    ("orders", "revs", "colour"),
    [
        ((5.0, 5.5, 6.0), 16, "white"), ((5.5, 5.48), 150, "white"), ((5.0, 5.5), 64, "pink"),
    ],
)  # fmt: skip
def test_the_truth_lies_in_95_of_100_intervals_or_more(orders, revs, colour, draws):
    given = [(order, 3.0 + 2.0 * k, 0.3 + 0.9 * k) for k, order in enumerate(orders)]
    tracks = tracks_of(given, revs=revs, colour=colour, draws=draws)
    _, size, phase = np.array(given).T
    within = (tracks["amplitude_low"] <= size) & (size <= tracks["amplitude_high"])
    off_deg = (tracks["phase"] - np.degrees(phase) + 180.0) % 360.0 - 180.0
    on_bin = np.isfinite(off_deg).all(axis=0)  # between bins there is no phase
    for hits in (*within.T, *(np.abs(off_deg) <= tracks["phase_ci95"])[:, on_bin].T):
        assert hits.mean() > 0.95 - share_allowed(hits.size)


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
