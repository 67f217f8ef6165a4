"""Filters before the converter: against scipy's, and joined by residues."""

import numpy as np
import pytest
from scipy import signal as scipy_signal

from crankorder.errors import RequestError
from crankorder.synth.analogue import analogue_filter, high_pass, in_series, low_pass
from crankorder.synth.parts import Acquisition


def test_a_low_pass_is_the_butterworth_filter_of_scipy_in_amplitude_and_phase() -> None:
    frequency = np.geomspace(10.0, 1e5, 500)
    for order in range(1, 13):
        poles = scipy_signal.butter(order, 2 * np.pi * 3000, analog=True, output="zpk")
        _, theirs = scipy_signal.freqs_zpk(*poles, 2 * np.pi * frequency)
        assert low_pass(order, 3000.0).response(frequency) == pytest.approx(theirs, abs=2e-13, rel=0), order


def test_ac_coupling_takes_a_constant_away_and_has_3_db_at_its_corner() -> None:
    at_zero, corner, above = high_pass(0.5).response(np.array([0.0, 0.5, 5000.0]))
    assert at_zero == 0
    assert corner == pytest.approx(0.5 + 0.5j, abs=1e-14)
    assert above == pytest.approx(1 + 1e-4j, abs=1e-7)


def test_filters_in_series_have_the_product_of_their_gains_everywhere() -> None:
    frequency = np.concatenate([[0.0], np.geomspace(1e-3, 1e6, 300)])
    anywhere = np.array([-300.0 + 9000j, 1e5 - 3e4j, 40.0 + 0j])
    for order in (1, 4, 9, 12):
        a, b = low_pass(order, 20e3), high_pass(0.7)
        both = in_series(a, b)
        assert both.response(frequency) == pytest.approx(a.response(frequency) * b.response(frequency), abs=1e-12)
        assert both.at(anywhere) == pytest.approx(a.at(anywhere) * b.at(anywhere), abs=1e-12)


def test_a_step_through_the_poles_is_the_step_response_of_scipy() -> None:
    filter_ = in_series(low_pass(3, 100.0), high_pass(5.0))
    time = np.linspace(0.0, 0.2, 400)
    ours = filter_.at(np.zeros(1, dtype=complex)).real + np.sum(
        filter_.residue / filter_.pole_per_s * np.exp(np.outer(time, filter_.pole_per_s)), axis=1
    )
    zeros, poles, gain = scipy_signal.butter(3, 2 * np.pi * 100, analog=True, output="zpk")
    system = scipy_signal.ZerosPolesGain([*zeros, 0.0], [*poles, -2 * np.pi * 5], gain)
    _, theirs = scipy_signal.step(system.to_ss(), T=time)
    assert ours.real == pytest.approx(theirs, abs=1e-9)
    assert np.abs(ours.imag).max() < 1e-12


def test_white_noise_folds_to_the_sum_of_all_images() -> None:
    rate, filter_ = 1000.0, low_pass(3, 450.0)
    frequency = np.linspace(0, rate / 2, 11)
    images = np.abs(frequency[:, None] + rate * np.arange(-400, 401))
    brute = np.sum(1 / (1 + (images / 450.0) ** 6), axis=1)  # beyond: below 1e-14
    assert filter_.folded_power(rate, frequency) == pytest.approx(brute, rel=1e-12)


def test_a_filter_that_lets_the_highest_frequencies_through_has_no_folded_power() -> None:
    with pytest.raises(ValueError, match="infinite"):
        high_pass(1.0).folded_power(1000.0, np.zeros(1))


@pytest.mark.slow
@pytest.mark.parametrize("coupling_hz", [100.0, 250.0, 100.0 * (1 - 1e-9)])
def test_ac_coupling_at_or_above_the_low_pass_is_refused_in_words(coupling_hz: float) -> None:
    with pytest.raises(RequestError, match=r"ac_coupling_hz.*below low_pass_hz, 100"):
        analogue_filter(Acquisition(low_pass_hz=100.0, low_pass_order=3, ac_coupling_hz=coupling_hz))


@pytest.mark.slow
@pytest.mark.parametrize(("order", "corner_hz"), [(0, 10.0), (13, 10.0), (4, 0.0), (4, float("nan"))])
def test_an_impossible_low_pass_is_refused(order: int, corner_hz: float) -> None:
    with pytest.raises(ValueError, match="order of 1"):
        low_pass(order, corner_hz)
