"""Filters before the converter: against scipy's, against the truth sheet, and joined by residues."""

import numpy as np
import pytest
from scipy import signal as scipy_signal

from crankorder.errors import RequestError
from crankorder.synth.analogue import AnalogueFilter, analogue_filter, high_pass, in_series, low_pass
from crankorder.synth.parts import Acquisition


def decibels(filter_: AnalogueFilter, *frequency_hz: float) -> np.ndarray:
    return 20 * np.log10(np.abs(filter_.response(np.array(frequency_hz))))


@pytest.mark.parametrize("order", range(1, 13))
def test_a_low_pass_is_the_butterworth_filter_of_scipy_in_amplitude_and_phase(order: int) -> None:
    frequency = np.geomspace(10.0, 1e5, 500)
    _, theirs = scipy_signal.freqs_zpk(
        *scipy_signal.butter(order, 2 * np.pi * 3000, analog=True, output="zpk"), 2 * np.pi * frequency
    )
    assert low_pass(order, 3000.0).response(frequency) == pytest.approx(theirs, abs=2e-13, rel=0)


@pytest.mark.parametrize("order", range(1, 13))
def test_a_low_pass_has_3_db_at_its_corner_and_falls_by_6_db_per_octave_and_order(order: int) -> None:
    corner, *octaves = decibels(low_pass(order, 800.0), 800.0, 1600.0, 3200.0, 6400.0)
    assert corner == pytest.approx(-10 * np.log10(2), abs=1e-9)
    exact = [-10 * np.log10(1 + ratio ** (2 * order)) for ratio in (2.0, 4.0, 8.0)]
    assert octaves == pytest.approx(exact, abs=0.03)  # 12th order at 8 times the corner is 1.5e-11: digits run out
    assert octaves[2] - octaves[1] == pytest.approx(-20 * np.log10(2) * order, abs=0.2)


@pytest.mark.parametrize(("order", "aliases_db"), [(4, (-3.7, -7.2, -16.4)), (8, (-4.6, -12.9, -32.7))])
def test_a_cut_off_at_half_the_rate_lets_the_aliases_of_the_truth_sheet_through(
    order: int, aliases_db: tuple[float, ...]
) -> None:
    assert decibels(low_pass(order, 25e3), 26e3, 30e3, 40e3) == pytest.approx(aliases_db, abs=0.06)


def test_the_band_of_the_orders_receives_what_lies_below_the_rate_as_the_truth_sheet_says() -> None:
    assert decibels(low_pass(4, 25e3), 49.5e3)[0] == pytest.approx(-23.8, abs=0.06)
    assert decibels(low_pass(8, 25e3), 49.5e3)[0] == pytest.approx(-47.5, abs=0.06)


def test_ac_coupling_takes_a_constant_away_and_has_3_db_at_its_corner() -> None:
    at_zero, corner, above = high_pass(0.5).response(np.array([0.0, 0.5, 5000.0]))
    assert at_zero == 0
    assert corner == pytest.approx(0.5 + 0.5j, abs=1e-14)
    assert above == pytest.approx(1 + 1e-4j, abs=1e-7)


@pytest.mark.parametrize("order", [1, 4, 9, 12])
def test_filters_in_series_have_the_product_of_their_gains_everywhere(order: int) -> None:
    a, b = low_pass(order, 20e3), high_pass(0.7)
    frequency = np.concatenate([[0.0], np.geomspace(1e-3, 1e6, 300)])
    assert in_series(a, b).response(frequency) == pytest.approx(
        a.response(frequency) * b.response(frequency), abs=1e-12
    )
    anywhere = np.array([-300.0 + 9000j, 1e5 - 3e4j, 40.0 + 0j])
    assert in_series(a, b).at(anywhere) == pytest.approx(a.at(anywhere) * b.at(anywhere), abs=1e-12)


@pytest.mark.parametrize("order", [1, 2, 5, 12])
def test_poles_are_stable_and_come_with_their_conjugates_so_that_signals_are_real(order: int) -> None:
    filter_ = in_series(low_pass(order, 1e4), high_pass(1.0))
    assert (filter_.pole_per_s.real < 0).all()
    by_pole = dict(zip(filter_.pole_per_s.tolist(), filter_.residue.tolist(), strict=True))
    for pole, residue in by_pole.items():
        assert by_pole[pole.conjugate()] == pytest.approx(residue.conjugate(), rel=1e-12)


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


def test_an_acquisition_has_the_filter_that_it_names_or_none() -> None:
    frequency = np.array([0.3, 1000.0, 9000.0])
    low, high = low_pass(6, 5e3), high_pass(0.5)
    assert analogue_filter(Acquisition()) is None
    cases = [
        (Acquisition(low_pass_hz=5e3, low_pass_order=6), low.response(frequency)),
        (Acquisition(ac_coupling_hz=0.5), high.response(frequency)),
        (
            Acquisition(low_pass_hz=5e3, low_pass_order=6, ac_coupling_hz=0.5),
            low.response(frequency) * high.response(frequency),
        ),
    ]
    for acquisition, expected in cases:
        made = analogue_filter(acquisition)
        assert made is not None
        assert made.response(frequency) == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize("coupling_hz", [100.0, 250.0, 100.0 * (1 - 1e-9)])
def test_ac_coupling_at_or_above_the_low_pass_is_refused_in_words(coupling_hz: float) -> None:
    with pytest.raises(RequestError, match=r"ac_coupling_hz.*below low_pass_hz, 100"):
        analogue_filter(Acquisition(low_pass_hz=100.0, low_pass_order=3, ac_coupling_hz=coupling_hz))


def test_filters_that_share_a_pole_have_no_simple_residues_and_are_refused() -> None:
    with pytest.raises(ValueError, match="share a pole"):
        in_series(low_pass(3, 100.0), high_pass(100.0))


@pytest.mark.parametrize(("order", "corner_hz"), [(0, 10.0), (13, 10.0), (4, 0.0), (4, float("nan"))])
def test_an_impossible_low_pass_is_refused(order: int, corner_hz: float) -> None:
    with pytest.raises(ValueError, match="order of 1"):
        low_pass(order, corner_hz)
