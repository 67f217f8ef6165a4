"""Steady orders against the Cramér–Rao bound."""

import numpy as np
import pytest

from crankorder.orders.map import order_map
from crankorder.settings import load_settings
from made.order_spectra import SAMPLES_PER_REV, angle_frames, coloured, lines

DRAWS = 500


@pytest.mark.parametrize("frames", [6, 36])
def test_the_map_stays_within_a_tenth_of_the_cramer_rao_bound(frames):
    revs = 8 * (frames + 1)
    noise = coloured(np.random.default_rng([frames, 0]), DRAWS, revs=revs, colour="white")
    made = order_map([angle_frames(noise + lines(noise.shape[1], [(5.5, 4.0, 0.7)]))], settings=load_settings().orders)
    rms = float(np.sqrt(np.mean((made["coherent_amplitude"].sel(order=5.5).values - 4.0) ** 2)))
    assert rms < 1.1 * np.sqrt(2.0 / (revs * SAMPLES_PER_REV)) * (1.0 + 4.0 / np.sqrt(2.0 * DRAWS))
