"""95 % intervals: the truth lies in them 95 times in 100, whatever the noise and however few the frames."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.orders.intervals import (
    amplitude_interval,
    contrasts,
    energy_interval,
    frame_correlation,
    noise_of_mean,
    phase_interval_deg,
)
from crankorder.orders.map import order_map
from crankorder.settings import load_settings
from made.order_spectra import angle_frames, coloured, lines

SETTINGS = load_settings().orders
BINOMIAL_SIGMAS = 4.0
"""A right test of a hundred such fails once in a hundred and fifty runs of other seeds."""


def beyond(hits: np.ndarray, *, least: float = 0.95, most: float = 0.95) -> float:
    """How far the share of ``hits`` is from the stated chances, in what its number allows: no more than 1."""
    reach = BINOMIAL_SIGMAS * np.sqrt(0.95 * 0.05 / hits.size)
    return float(max(least - hits.mean(), hits.mean() - most) / reach)


def covered(made, order, amplitude, phase_rad) -> tuple[np.ndarray, np.ndarray]:
    line = made.sel(order=order).isel(speed=0)
    size = (line["coherent_amplitude_low"] <= amplitude) & (amplitude <= line["coherent_amplitude_high"])
    off = (line["phase"] - np.degrees(phase_rad) + 180.0) % 360.0 - 180.0
    return size.values, (np.abs(off) <= line["phase_ci95"]).values


@pytest.mark.parametrize("dof", [2.0, 6.0, 16.0, 400.0])
@pytest.mark.parametrize("true", [0.0, 0.5, 1.5, 3.0, 30.0])
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


@pytest.mark.parametrize("true", [0.0, 2.0, 10.0])
def test_the_interval_of_an_amplitude_without_phase_holds_the_truth(true):
    rng, draws, frames = np.random.default_rng(8), 20_000, 8
    noise = (rng.standard_normal((draws, frames)) + 1j * rng.standard_normal((draws, frames))) / np.sqrt(2.0)
    power = np.mean(np.abs(true + noise) ** 2, axis=1)
    dof = np.full(draws, 400.0)
    low, high = energy_interval(
        power, noise=np.array(1 / frames), bias=np.array(1.0), noise_variance=np.array(1 / frames), dof=dof
    )
    assert beyond((low <= true) & (true <= high), least=0.94, most=1.0 if true == 0.0 else 0.96) < 1.0


@pytest.mark.parametrize("frames", [2, 3, 5, 12, 40])
def test_contrasts_are_blind_to_a_steady_line_and_know_the_noise_of_the_mean(frames):
    begin = 8.0 * np.arange(frames)
    correlation = frame_correlation(begin, np.zeros(frames, dtype=int), revs_per_frame=16.0, window="hann")
    assert correlation[0, 1] == pytest.approx(1.0 / 6.0)
    shape = contrasts(correlation)
    np.testing.assert_allclose(shape.rows.sum(axis=1), 0.0, atol=1e-12)
    drawn = np.random.default_rng(3).multivariate_normal(np.zeros(frames), correlation / 2.0, size=(2, 20_000))
    spectrum = (drawn[0] + 1j * drawn[1]).T[None]
    expected = np.mean(np.abs(spectrum.mean(axis=1)) ** 2)
    assert np.mean(noise_of_mean(spectrum, shape)) == pytest.approx(expected, rel=0.05)


def test_a_trend_with_speed_is_no_noise():
    speed = np.linspace(1000.0, 1024.0, 6)
    shape = contrasts(np.eye(6), speed)
    np.testing.assert_allclose(shape.rows @ speed, 0.0, atol=1e-9)


SHORT, LONG = 400, 2000
CASES = [
    ("white", 1),
    ("white", 2),
    ("white", 3),
    ("white", 5),
    ("white", 36),
    ("pink", 2),
    ("pink", 5),
    ("pink", 36),
    ("resonance", 20),
    ("resonance", 36),
]


@pytest.mark.parametrize("draws", [SHORT, pytest.param(LONG, marks=pytest.mark.accuracy)])
@pytest.mark.parametrize(("colour", "frames"), CASES)
def test_the_truth_lies_in_95_of_100_intervals_of_the_map(colour, frames, draws):
    given = [(5.0, 3.0, 0.7), (5.5, 1.0, 2.0), (6.0, 2.0, -1.0)]
    hits: dict[float, list[np.ndarray]] = {5.0: [], 5.5: []}
    for batch in range(draws // SHORT):
        noise = coloured(np.random.default_rng([frames, batch]), SHORT, revs=8 * (frames + 1), colour=colour)
        made = order_map([angle_frames(noise + lines(noise.shape[1], given))], settings=SETTINGS)
        for order, amplitude, phase in given[:2]:
            hits[order].append(np.stack(covered(made, order, amplitude, phase)))
    for found in hits.values():
        for part in np.concatenate(found, axis=1):
            assert beyond(part) < 1.0


def test_the_interval_of_a_run_up_does_not_take_the_growth_of_the_line_for_noise():
    frames, draws = 5, 1000
    revs = 8 * (frames + 1)
    noise = coloured(np.random.default_rng(4), draws, revs=revs, colour="white")
    angle = np.linspace(0.0, 1.0, noise.shape[1])
    grown = (1.0 + 0.3 * (angle - 0.5)) * lines(noise.shape[1], [(5.0, 3.0, 0.7)])
    made = order_map([angle_frames(noise + grown, speed=np.linspace(1190.0, 1210.0, frames))], settings=SETTINGS)
    for part in covered(made, 5.0, 3.0, 0.7):
        assert beyond(part) < 1.0
