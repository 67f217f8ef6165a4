"""A line that changes while it is measured: its interval reaches over the values that it held."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.orders.intervals import amplitude_interval, is_seen
from crankorder.orders.map import order_map
from crankorder.settings import load_settings
from made.order_spectra import REVS, SAMPLES_PER_REV, angle_frames, coloured, lines

SETTINGS = load_settings().orders
COURSES = {
    "doubles halfway": lambda share: np.where(share < 0.5, 1.0, 2.0),
    "drifts": lambda share: 1.0 + share,
    "swells": lambda share: 1.5 + 0.5 * np.sin(2 * np.pi * share),
    "drifts down": lambda share: 2.0 - share,
}


def mapped(course, *, frames: int, sigma: float, draws: int = 100, seed: int = 0, phase=lambda share: 0.3):
    noise = sigma * coloured(np.random.default_rng([frames, seed]), draws, revs=8 * (frames + 1), colour="white")
    share = np.linspace(0.0, 1.0, noise.shape[1])
    angle = np.arange(noise.shape[1]) / SAMPLES_PER_REV
    signal = noise + course(share) * np.cos(2 * np.pi * 2.0 * angle + phase(share))
    return order_map([angle_frames(signal)], settings=SETTINGS).sel(order=2.0).isel(speed=0)


@pytest.mark.parametrize("frames", [8, 20, 60])
@pytest.mark.parametrize("name", COURSES)
def test_the_interval_covers_what_the_frames_held_and_the_mean_is_that_of_the_recording(name, frames):
    course = COURSES[name]
    line = mapped(course, frames=frames, sigma=0.05)
    window = np.hanning(REVS * SAMPLES_PER_REV)
    share = np.linspace(0.0, 1.0, 8 * (frames + 1) * SAMPLES_PER_REV)
    begin = np.arange(frames) * 8 * SAMPLES_PER_REV
    held = np.array([np.average(course(share[k : k + len(window)]), weights=window) for k in begin])
    low, high = line["coherent_amplitude_low"].values, line["coherent_amplitude_high"].values
    inside = (low[:, None] <= held) & (held <= high[:, None])
    assert inside.mean() > 0.93
    assert abs(line["coherent_amplitude"].values.mean() - held.mean()) < 0.01
    # and not more than that: at most a third beyond
    assert np.median(high - low) < 1.4 * np.ptp(held) + 0.1
    # the standard error stays that of the mean
    assert np.median(line["standard_error"].values) < 0.05
    # its phase was steady all the while
    assert np.median(line["phase_ci95"].values) < 3.0


def test_a_phase_that_turns_widens_the_interval_of_the_phase_and_not_of_the_amplitude():
    line = mapped(lambda share: 2.0, frames=20, sigma=0.05, phase=lambda share: 0.6 * (share - 0.5))
    assert np.median(line["phase_ci95"].values) > 0.8 * np.degrees(0.3)
    # the mean of phasors that turn to 0.3 rad on both sides loses no more than its cosine
    lost = 2.0 * (1.0 - np.cos(0.3))
    assert np.median(line["coherent_amplitude_high"] - line["coherent_amplitude_low"]) < lost


def test_a_steady_line_is_seldom_taken_for_one_that_changes():
    line = mapped(lambda share: 2.0, frames=20, sigma=1.0, draws=2000)
    wide = line["coherent_amplitude_high"] - line["coherent_amplitude_low"]
    reach = 2.0 * 2.306 * line["standard_error"]  # Student's t of 8 degrees of freedom
    assert float((wide > 1.2 * reach).mean()) < 0.01


@pytest.mark.parametrize("recordings", [2, 3])
def test_a_line_that_is_seen_has_a_lower_end_above_zero_however_recordings_differ(recordings):
    rng = np.random.default_rng(recordings)
    given = []
    for number in range(recordings):
        noise = 0.1 * coloured(rng, 300, revs=48, colour="white")
        size = np.exp(0.3 * rng.standard_normal((300, 1)))
        given.append(angle_frames(noise + size * lines(noise.shape[1], [(2.0, 1.0, 0.3)]), name=str(number)))
    line = order_map(given, settings=SETTINGS).sel(order=2.0).isel(speed=0)
    low, high = line["coherent_amplitude_low"].values, line["coherent_amplitude_high"].values
    assert (low > 0.0).all()
    true = np.exp(0.5 * 0.3**2)
    assert np.mean((low <= true) & (true <= high)) > 0.93


def test_the_lower_end_leaves_zero_where_the_line_is_seen_and_grows_without_a_step():
    amplitude = np.linspace(0.0, 12.0, 5001)
    for dof in (2.0, 4.0, 8.0, 30.0, 400.0):
        low, high = amplitude_interval(amplitude, np.ones(5001), np.full(5001, dof))
        seen = is_seen(amplitude, np.ones(5001), np.full(5001, dof))
        assert ((low > 0.0) == seen)[1:].mean() > 0.999
        assert np.diff(low).min() >= -1e-9
        assert np.diff(low).max() < 0.3  # a root in the amplitude, no jump
        assert (high > low).all()
