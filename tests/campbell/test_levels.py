"""Overall levels and lines above the band, against what was put in."""

import json

import numpy as np
import pytest
from scipy.signal import lfilter

from crankorder.campbell.levels import recording_levels
from crankorder.identify.levels import level_records
from crankorder.quantities import check_dataset
from made.recordings import held, sampled, shaft
from made.shipped import SETTINGS
from made.typed import as_dicts

level_records = as_dicts(level_records)

RATE_HZ = 25_600.0


def recorded(signals):
    return sampled(signals, recording="a.h5", rate_hz=RATE_HZ, encoder_kind="none")


def by_angle(signals, *, samples_per_rev, speed_rpm):
    made = recorded(signals).rename({"time": "crank_angle"})
    del made.attrs["rate_hz"]
    made.attrs |= {"domain": "crank_angle", "samples_per_rev": samples_per_rev, "speed_rpm": speed_rpm}
    return made


def levels(recording, speed_rpm):
    duration = recording["signal"].shape[1] / float(recording.attrs.get("rate_hz", RATE_HZ))
    made = recording_levels(recording, held(speed_rpm, duration), orders=SETTINGS.orders, campbell=SETTINGS.campbell)
    check_dataset(made, "recording_levels")
    return made


@pytest.mark.parametrize("seed", range(2))
def test_a_mesh_above_the_band_is_found_with_its_size_and_order(seed):
    rng = np.random.default_rng(seed)
    rpm, order, size = rng.uniform(900, 3000), rng.uniform(40, 90), 10.0 ** rng.uniform(-1, 2)
    low = size * rng.uniform(0.1, 0.9)
    at = np.arange(int(3 * RATE_HZ)) / RATE_HZ
    tones = low * np.cos(2 * np.pi * 2 * rpm / 60 * at) + size * np.cos(2 * np.pi * order * rpm / 60 * at + 1.0)
    noise = 0.02 * size * rng.standard_normal(at.size)
    made = levels(recorded(np.stack([tones + noise + 40.0 * size])), rpm).isel(channel=0)
    assert float(made["peak_above"]) == pytest.approx(size, rel=0.03)
    assert float(made["peak_order"]) == pytest.approx(order, rel=2e-3)
    assert float(made["peak_speed"]) == pytest.approx(rpm, rel=1e-3)
    assert float(made["rms"]) ** 2 == pytest.approx((size**2 + low**2) / 2 + (0.02 * size) ** 2, rel=0.03)
    assert float(made["share_above"]) == pytest.approx(size**2 / (size**2 + low**2), abs=0.02)


def test_noise_lines_inside_the_band_and_a_light_mode_that_noise_makes_ring_are_no_line_above_it():
    at = np.arange(int(4 * RATE_HZ)) / RATE_HZ
    for seed in range(3):
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal((3, at.size))
        noise[1] = np.cumsum(noise[1]) * 0.05  # red
        hertz, damping = rng.uniform(510, 3000), 10.0 ** rng.uniform(-3, -1.5)
        pole = np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * 2 * np.pi * hertz / RATE_HZ)
        noise[2] = lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], noise[2])
        line = 50.0 * np.cos(2 * np.pi * rng.uniform(20, 480) * at)
        made = levels(recorded(noise + line * np.array([[1.0], [1.0], [0.0]])), 1500.0)
        assert made["peak_above"].values.tolist() == [0.0, 0.0, 0.0]
        assert np.isnan(made["peak_order"].values).all()


def test_in_a_run_up_the_order_is_a_line_and_the_mode_that_noise_rings_is_none():
    rng = np.random.default_rng(3)
    at = np.arange(int(10 * RATE_HZ)) / RATE_HZ
    angle = (900.0 * at + 0.5 * 60.0 * at**2) / 60.0
    signal = 2.0 * np.cos(2 * np.pi * 60 * angle) + 0.05 * rng.standard_normal(at.size)
    knots = np.linspace(0.0, 10.0, 200)
    turned = shaft(knots, (900.0 * knots + 30.0 * knots**2) / 60.0, 900.0 + 60.0 * knots)
    made = recording_levels(recorded(signal[None]), turned, orders=SETTINGS.orders, campbell=SETTINGS.campbell)
    assert float(made["peak_order"][0]) == pytest.approx(60.0, rel=5e-3)
    assert float(made["peak_above"][0]) == pytest.approx(2.0, rel=0.2)


def test_white_noise_lies_above_the_band_by_its_share_of_the_spectrum():
    noise = np.random.default_rng(2).standard_normal((1, int(6 * RATE_HZ)))
    share = float(levels(recorded(noise), 600.0)["share_above"][0])
    assert share == pytest.approx(1.0 - SETTINGS.campbell.max_frequency_hz / (RATE_HZ / 2), abs=0.01)


def test_by_crank_angle_the_order_is_told_with_and_without_a_speed():
    rev = np.arange(200 * 360) / 360
    signal = (np.cos(2 * np.pi * 2 * rev) + 3.0 * np.cos(2 * np.pi * 47.0 * rev))[None]
    unknown = levels(by_angle(signal, samples_per_rev=360, speed_rpm=np.nan), 1500.0).isel(channel=0)
    assert float(unknown["peak_order"]) == pytest.approx(47.0, rel=1e-3) and np.isnan(unknown["peak_frequency"])
    known = levels(by_angle(signal, samples_per_rev=360, speed_rpm=3000.0), 3000.0).isel(channel=0)
    assert float(known["peak_frequency"]) == pytest.approx(47.0 * 50, rel=1e-3)
    assert float(known["peak_above"]) == pytest.approx(3.0, rel=0.03)


def test_gaps_are_left_out_and_what_is_too_short_or_all_missing_is_not_told():
    at = np.arange(int(3 * RATE_HZ)) / RATE_HZ
    signal = np.stack([2.0 * np.cos(2 * np.pi * 3000 * at)] * 2)
    signal[0, 20_000:30_000] = np.nan
    signal[1] = np.nan
    made = levels(recorded(signal), 1500.0)
    assert float(made["rms"][0]) == pytest.approx(np.sqrt(2.0), rel=0.01)
    assert np.isnan(made["rms"][1]) and float(made["peak_above"][1]) == 0.0
    short = levels(recorded(signal[:, :60]), 1500.0)
    assert np.isnan(short["rms"].values).all()


def test_records_take_the_strongest_line_and_all_energy():
    at = np.arange(int(2 * RATE_HZ)) / RATE_HZ
    made = [levels(recorded(size * np.cos(2 * np.pi * 2000 * at)[None]), 1500.0) for size in (1.0, 3.0)]
    quiet = levels(recorded(4.0 * np.cos(2 * np.pi * 100 * at)[None]), 1500.0)
    (record,) = level_records([*made, quiet])
    assert record["amplitude_above"] == pytest.approx(3.0, rel=0.03) and record["order_above"] == pytest.approx(80.0)
    assert record["share_above"] == pytest.approx(10.0 / 26.0, abs=0.02)
    assert record["rms_max"] == pytest.approx(4.0 / np.sqrt(2.0), rel=0.01)
    assert level_records([]) == [] and json.dumps(record)
