"""95 % intervals: the truth lies in them 95 times in 100, whatever the noise and however few the frames."""

import numpy as np
import pytest

from crankorder.orders.intervals import (
    amplitude_interval,
    between_recordings,
    energy_interval,
    phase_interval_deg,
    wider_of,
)
from crankorder.orders.map import order_map
from made.order_spectra import angle_frames, coloured, lines
from made.shipped import ORDERS

BINOMIAL_SIGMAS = 4.0
"""A right test of a hundred such fails once in a hundred and fifty runs of other seeds."""


def beyond(hits, *, least=0.95, most=0.95):
    """How far the share of ``hits`` is from the stated chances, in what its number allows: no more than 1."""
    reach = BINOMIAL_SIGMAS * np.sqrt(0.95 * 0.05 / hits.size)
    return float(max(least - hits.mean(), hits.mean() - most) / reach)


def covered(made, order, amplitude, phase_rad):
    line = made.sel(order=order).isel(speed=0)
    size = (line["coherent_amplitude_low"] <= amplitude) & (amplitude <= line["coherent_amplitude_high"])
    off = (line["phase"] - np.degrees(phase_rad) + 180.0) % 360.0 - 180.0
    return size.values, (np.abs(off) <= line["phase_ci95"]).values


@pytest.mark.parametrize(("true", "dof"), [(0.0, 2.0), (1.5, 6.0), (30.0, 400.0)])
def test_the_interval_of_a_line_in_noise_holds_the_truth_at_every_signal_to_noise_ratio(dof, true):
    rng, draws = np.random.default_rng(7), 40_000
    seen = true + (rng.standard_normal(draws) + 1j * rng.standard_normal(draws)) / np.sqrt(2.0)
    noise = rng.chisquare(dof, draws) / dof
    low, high = amplitude_interval(np.abs(seen), noise, np.full(draws, dof))
    half = phase_interval_deg(np.abs(seen), noise, np.full(draws, dof))
    # below the noise the interval reaches down to 0 and errs to the safe side: 97.5 %, and 98.5 % of the phase
    most = 0.95 if true >= 3.0 else 0.975
    assert beyond((low <= true) & (true <= high), least=0.947, most=most) < 1.0
    assert beyond(np.abs(np.degrees(np.angle(seen))) <= half, least=0.947, most=most + (true < 3.0) * 0.01) < 1.0


def test_without_noise_the_interval_is_the_amplitude_itself_and_without_knowledge_it_is_everything():
    low, high = amplitude_interval(np.array([2.0, 2.0]), np.array([0.0, 1.0]), np.array([8.0, 0.0]))
    assert low.tolist() == [2.0, 0.0]
    assert high.tolist() == [2.0, np.inf]
    half = phase_interval_deg(np.array([2.0, 2.0]), np.array([0.0, 1.0]), np.array([8.0, 0.0]))
    assert half.tolist() == [0.0, 180.0]


def test_the_interval_of_an_amplitude_without_phase_holds_the_truth():
    rng, draws, frames = np.random.default_rng(8), 20_000, 8
    noise = (rng.standard_normal((draws, frames)) + 1j * rng.standard_normal((draws, frames))) / np.sqrt(2.0)
    power = np.mean(np.abs(2.0 + noise) ** 2, axis=1)
    dof = np.full(draws, 400.0)
    low, high = energy_interval(
        power, noise=np.array(1 / frames), bias=np.array(1.0), noise_variance=np.array(1 / frames), dof=dof
    )
    assert beyond((low <= 2.0) & (high >= 2.0), least=0.94, most=0.96) < 1.0


@pytest.mark.parametrize(("colour", "frames"), [("white", 1), ("pink", 5), ("resonance", 20)])
def test_the_truth_lies_in_95_of_100_intervals_of_the_map(colour, frames):
    given = [(5.0, 3.0, 0.7), (5.5, 1.0, 2.0), (6.0, 2.0, -1.0)]
    noise = coloured(np.random.default_rng([frames, 0]), 400, revs=8 * (frames + 1), colour=colour)
    made = order_map([angle_frames(noise + lines(noise.shape[1], given))], settings=ORDERS)
    for line in given[:2]:
        for part in covered(made, *line):
            assert beyond(part) < 1.0


def repeats(rng, recordings):
    """Recordings of five frames whose line at order 5 differs by a tenth in amplitude and in phase."""
    made = []
    for number in range(recordings):
        noise = 0.3 * coloured(rng, 600, revs=48, colour="white")
        both = 0.1 * rng.standard_normal((2, 600, 1))
        along, across = (lines(noise.shape[1], [(5.0, 3.0, phase)]) for phase in (0.7, 0.7 + np.pi / 2))
        made.append(angle_frames(noise + (1.0 + both[0]) * along + both[1] * across, name=str(number)))
    return made


def test_the_interval_of_recordings_that_differ_by_a_tenth_holds_the_line_of_them_all():
    given = repeats(np.random.default_rng(2), 2)
    made = order_map(given, settings=ORDERS)
    for part in covered(made, 5.0, 3.0, 0.7):
        assert beyond(part, most=0.975) < 1.0  # where the frames say more than the recordings it is theirs
    freedom = made["degrees_of_freedom"].sel(order=5.0).values
    assert np.median(freedom) == 1


def test_the_scatter_of_unequal_recordings_is_weighed_by_their_frames():
    rng = np.random.default_rng(11)
    owner = np.repeat([0, 1, 2], [2, 6, 4])
    draws, within, apart = 20_000, 0.5, 2.0
    parts = rng.standard_normal((2, draws, 3)) * apart
    spectrum = 40.0 + np.repeat(parts, [2, 6, 4], axis=2) + within * rng.standard_normal((2, draws, 12))
    spectrum = (spectrum[0] + 1j * (spectrum[1] - 40.0)).T[None]
    mean = spectrum.mean(axis=1)
    between = between_recordings(spectrum, owner, mean)
    power, _ = wider_of(np.full(mean.shape, 2 * within**2 / 12), np.full(mean.shape, 2.0), between.along, between)
    assert power.mean() == pytest.approx(np.mean(np.abs(mean - 40.0) ** 2), rel=0.03)
