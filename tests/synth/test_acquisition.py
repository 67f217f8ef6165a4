"""Clock, converter and number types, and what ingest makes of the files."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from crankorder.ingest import hdf5
from crankorder.ingest.units import parse_sensitivity, unit_of
from crankorder.settings import load_settings
from crankorder.synth.analogue import recorded, true_rate_hz
from crankorder.synth.parts import Acquisition

RNG = np.random.default_rng(5)
PER_SAMPLE = 0.02 * (np.sqrt(5) - 1) / 2
"""Periods of the sine per sample: golden, so that no phase comes again."""


def sine(peak: float, *, n: int = 20_000) -> np.ndarray:
    return peak * np.sin(2 * np.pi * PER_SAMPLE * np.arange(n))[None, :]


def test_a_clock_that_runs_fast_takes_more_samples_per_second_than_its_label_says() -> None:
    assert true_rate_hz(Acquisition(clock_error_ppm=100.0), 50_000.0) == pytest.approx(50_005.0, rel=1e-15)
    assert true_rate_hz(Acquisition(), 51_200.0) == 51_200.0


def test_nothing_between_sensor_and_file_leaves_the_signal_as_float32() -> None:
    signal = RNG.normal(size=(3, 1000))
    made = recorded(signal, Acquisition())
    assert made.samples.dtype == np.float32
    assert (made.samples == signal.astype(np.float32)).all()
    assert (made.scale, made.unit, made.clipped_share.tolist()) == (None, "m/s2", [0.0, 0.0, 0.0])


def test_volts_come_back_as_m_s2_through_the_sensitivity_that_ingest_reads() -> None:
    signal = RNG.normal(size=(1, 100))
    made = recorded(signal, Acquisition(sensitivity_mv_per_g=100.0, stored_as="float64"))
    assert made.unit == "V"
    back = made.samples * parse_sensitivity("100 mV/g").measured_per_output(unit_of("m/s2"))
    assert back == pytest.approx(signal, rel=1e-14)
    assert recorded(np.full((1, 1), 9.80665), Acquisition(sensitivity_mv_per_g=100.0)).samples[0, 0] == np.float32(0.1)


@pytest.mark.parametrize("bits", [8, 12, 16, 24])
def test_rounding_to_steps_is_noise_of_a_step_over_root_12(bits: int) -> None:
    signal = RNG.uniform(-9.9, 9.9, size=(1, 400_000))
    made = recorded(signal, Acquisition(full_scale=10.0, bits=bits, stored_as="float64"))
    error = made.samples - signal
    step = 20.0 / 2**bits
    assert error.std() == pytest.approx(step / np.sqrt(12), rel=0.005)
    assert abs(error.mean()) < 4 * step / np.sqrt(12 * error.size)
    assert np.abs(error).max() <= step / 2 * (1 + 1e-6)


def test_the_converter_is_mid_tread_with_one_code_more_below_than_above() -> None:
    signal = np.array([[0.0, 0.49, 0.51, -0.49, -0.51, 6.6, 7.4, 7.6, 8.0, 99.0, -8.4, -8.6, -99.0]])
    made = recorded(signal, Acquisition(full_scale=8.0, bits=4, stored_as="int16"))
    assert made.samples.tolist() == [[0, 0, 1, 0, -1, 7, 7, 7, 7, 7, -8, -8, -8]]
    assert made.scale == 1.0
    assert made.clipped_share.tolist() == [5 / 13]


def test_24_bits_in_float32_hold_a_tone_120_db_below_full_scale() -> None:
    full_scale = 10.0
    quiet = sine(full_scale * 1e-6, n=200_000)
    made = recorded(quiet, Acquisition(full_scale=full_scale, bits=24))
    phasor = np.exp(-2j * np.pi * PER_SAMPLE * np.arange(quiet.size))
    amplitude = 2 * np.abs(made.samples[0].astype(np.float64) @ phasor) / quiet.size
    assert amplitude == pytest.approx(full_scale * 1e-6, abs=0.1 * 2 * full_scale / 2**24)  # a tenth of a step
    coarse = recorded(quiet, Acquisition(full_scale=full_scale, bits=16))
    assert not coarse.samples.any()


def test_float32_loses_nothing_of_24_bits() -> None:
    signal = RNG.uniform(-10, 10, size=(1, 50_000))
    narrow, wide = (
        recorded(signal, Acquisition(full_scale=10.0, bits=24, stored_as=kind)).samples
        for kind in ("float32", "float64")
    )
    step = 20.0 / 2**24
    assert (np.rint(narrow.astype(np.float64) / step) == np.rint(wide / step)).all()


def test_the_share_beyond_full_scale_is_told_by_channel() -> None:
    signal = np.vstack([sine(1.0), sine(2.0)])
    made = recorded(signal, Acquisition(full_scale=1.0, stored_as="float64"))
    assert np.abs(made.samples).max() == 1.0
    assert made.clipped_share == pytest.approx([0.0, 2 / 3], abs=1e-3)  # |sin| > 1/2 for two thirds of the time


def test_full_scale_is_in_the_unit_of_the_file() -> None:
    made = recorded(sine(200.0), Acquisition(sensitivity_mv_per_g=100.0, full_scale=1.0, stored_as="float64"))
    assert made.samples.max() == 1.0  # 1 V is 98.07 m/s2
    assert made.clipped_share[0] == pytest.approx(1 - 2 / np.pi * np.arcsin(98.0665 / 200), abs=1e-3)


@pytest.mark.parametrize("bits", [None, 12])
def test_int16_codes_come_back_through_the_hdf5_reader(bits: int | None, tmp_path: Path) -> None:
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


def test_a_missing_sample_stays_missing_in_floats_and_is_refused_in_int16() -> None:
    signal = sine(1.0)
    signal[0, 7] = np.nan
    made = recorded(signal, Acquisition(full_scale=2.0, bits=16))
    assert np.flatnonzero(np.isnan(made.samples[0])).tolist() == [7]
    with pytest.raises(ValueError, match="int16 has no code"):
        recorded(signal, Acquisition(full_scale=2.0, stored_as="int16"))


def test_what_a_logger_writes_for_missing_samples_is_beyond_range_and_steps_of_the_converter() -> None:
    signal = sine(1.0)
    signal[0, 5:8] = np.nan
    instead = [(0, slice(4, 8), -999.0)]
    made = recorded(signal, Acquisition(full_scale=2.0, bits=12), stand_ins=instead)
    assert np.flatnonzero(made.samples[0] == -999.0).tolist() == [5, 6, 7]
    assert made.clipped_share[0] == 0.0
    codes = recorded(signal, Acquisition(full_scale=2.0, bits=12, stored_as="int16"), stand_ins=instead)
    assert codes.samples[0, 4:9].tolist()[1:4] == [-32768] * 3


def test_infinity_is_cut_off_where_there_is_a_range() -> None:
    made = recorded(np.array([[np.inf, -np.inf, 0.0]]), Acquisition(full_scale=2.0, bits=16, stored_as="int16"))
    assert made.samples.tolist() == [[32767, -32768, 0]]
