"""Clock, converter and number types, and what ingest makes of the files."""

import h5py
import numpy as np
import pytest
from scipy import signal as scipy_signal

from crankorder.ingest import hdf5
from crankorder.ingest.units import parse_sensitivity, unit_of
from crankorder.settings import load_settings
from crankorder.synth.parts import Acquisition
from crankorder.synth.poles import high_pass, low_pass, recorded, true_rate_hz

RNG = np.random.default_rng(5)
PER_SAMPLE = 0.02 * (np.sqrt(5) - 1) / 2
"""Periods of the sine per sample: golden, so that no phase comes again."""


def sine(peak, *, n=20_000):
    return peak * np.sin(2 * np.pi * PER_SAMPLE * np.arange(n))[None, :]


def test_a_clock_that_runs_fast_takes_more_samples_per_second_than_its_label_says():
    assert true_rate_hz(Acquisition(clock_error_ppm=100.0), 50_000.0) == pytest.approx(50_005.0, rel=1e-15)
    assert true_rate_hz(Acquisition(), 51_200.0) == 51_200.0


def test_volts_come_back_as_m_s2_through_the_sensitivity_that_ingest_reads():
    signal = RNG.normal(size=(1, 100))
    made = recorded(signal, Acquisition(sensitivity_mv_per_g=100.0, stored_as="float64"))
    assert made.unit == "V"
    back = made.samples * parse_sensitivity("100 mV/g").measured_per_output(unit_of("m/s2"))
    assert back == pytest.approx(signal, rel=1e-14)
    assert recorded(np.full((1, 1), 9.80665), Acquisition(sensitivity_mv_per_g=100.0)).samples[0, 0] == np.float32(0.1)


def test_the_converter_is_mid_tread_with_one_code_more_below_than_above():
    signal = np.array([[0.0, 0.49, 0.51, -0.49, -0.51, 6.6, 7.4, 7.6, 8.0, 99.0, -8.4, -8.6, -99.0]])
    made = recorded(signal, Acquisition(full_scale=8.0, bits=4, stored_as="int16"))
    assert made.samples.tolist() == [[0, 0, 1, 0, -1, 7, 7, 7, 7, 7, -8, -8, -8]]
    assert made.scale == 1.0
    assert made.clipped_share.tolist() == [5 / 13]


def test_int16_codes_come_back_through_the_hdf5_reader(tmp_path):
    for bits in (None, 12):
        signal = sine(4.2)
        acquisition = Acquisition(sensitivity_mv_per_g=500.0, full_scale=2.5, bits=bits, stored_as="int16")
        made = recorded(signal, acquisition)
        assert made.samples.dtype == np.int16
        with h5py.File(tmp_path / "r.h5", "w") as file:
            dataset = file.create_dataset("acc", data=made.samples[0])
            dataset.attrs.update({"unit": made.unit, "scale_factor": made.scale, "rate_hz": 1000.0})
        raw = hdf5.read(tmp_path / "r.h5", sources=["acc"], settings=load_settings().ingest)
        volts = signal[0] * 0.5 / 9.80665
        step = 5.0 / 2 ** (bits or 16)
        assert np.abs(raw.columns["acc"] - volts).max() <= step / 2 * (1 + 1e-3)
        assert raw.units["acc"] == "V"


def test_a_missing_sample_stays_missing():
    signal = sine(1.0)
    signal[0, 7] = np.nan
    made = recorded(signal, Acquisition(full_scale=2.0, bits=16))
    assert np.flatnonzero(np.isnan(made.samples[0])).tolist() == [7]


# Filters before the converter: against scipy's, and joined by residues.


def test_a_low_pass_is_the_butterworth_filter_of_scipy_in_amplitude_and_phase():
    frequency = np.geomspace(10.0, 1e5, 500)
    for order in range(1, 13):
        poles = scipy_signal.butter(order, 2 * np.pi * 3000, analog=True, output="zpk")
        _, theirs = scipy_signal.freqs_zpk(*poles, 2 * np.pi * frequency)
        assert low_pass(order, 3000.0).response(frequency) == pytest.approx(theirs, abs=2e-13, rel=0), order


def test_ac_coupling_takes_a_constant_away_and_has_3_db_at_its_corner():
    at_zero, corner, above = high_pass(0.5).response(np.array([0.0, 0.5, 5000.0]))
    assert at_zero == 0
    assert corner == pytest.approx(0.5 + 0.5j, abs=1e-14)
    assert above == pytest.approx(1 + 1e-4j, abs=1e-7)
