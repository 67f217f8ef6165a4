"""The average cycle of recordings: exact for what is locked, honest about what is not, joined only where it may be."""

import math

import numpy as np
import pytest

from crankorder.errors import InputError
from crankorder.orders.cycle_average import cycle_average, cycle_averages
from crankorder.quantities import check_dataset, flags_of
from made.recordings import line, run_up, sampled, shaft, steady, total
from made.shipped import ORDERS

LINES = ((0.5, 0.2, 0.3), (1.0, 2.0, -1.0), (5.5, 0.7, 2.0), (12.0, 0.3, 0.4))
LOCKED = total(*(line(*each) for each in LINES))


def truth(angle_deg):
    return sum(amplitude * np.cos(2 * np.pi * order * angle_deg / 360 + phase) for order, amplitude, phase in LINES)


def noise(seed, sigma):
    return lambda time_s, _: sigma * np.random.default_rng(seed).standard_normal(len(time_s))


def of(*signals, speed_rpm=1000.0, duration_s=8.0, rate_hz=2000.0, settings=ORDERS, **given):
    return cycle_average(
        *steady(list(signals), speed_rpm=speed_rpm, duration_s=duration_s, rate_hz=rate_hz, **given), settings=settings
    )


@pytest.mark.parametrize(("start_rev", "tolerance"), [(-0.3, 1e-4), (1.2, 1e-6), (5.999, 1e-9)])
def test_the_mean_cycle_of_a_locked_signal_is_the_signal_from_top_dead_centre_wherever_it_begins(start_rev, tolerance):
    settings = ORDERS.model_copy(update={"tolerance": tolerance})
    made = of(LOCKED, start_rev=start_rev, settings=settings)
    check_dataset(made, "cycle_average")
    error = made["mean"].values[0, 0] - truth(made["cycle_angle"].values)
    assert np.abs(error).max() < tolerance * sum(amplitude for _, amplitude, _ in LINES)
    assert made["standard_deviation"].values.max() < 4 * tolerance
    assert made["n_cycles"].values.tolist() == [[int((8.0 * 1000 / 60 - 0.1) // 2)]]
    assert made["highest_order"].item() == 20.0


def test_a_run_up_keeps_the_waveform_and_falls_into_speed_groups():
    made = cycle_average(*run_up([LOCKED], from_rpm=600, to_rpm=1500, duration_s=20.0, rate_hz=5000.0), settings=ORDERS)
    assert made.sizes["speed"] > 20
    assert (np.diff(made["speed"].values) > 10).all()
    np.testing.assert_allclose(
        made["mean"].values[0], np.tile(truth(made["cycle_angle"].values), (made.sizes["speed"], 1)), atol=4e-6
    )


def test_the_loud_end_of_a_run_up_does_not_show_at_its_quiet_begin():
    """A waveform that grows a thousandfold with speed: the ends of the record are not alike."""
    growing = lambda time_s, angle: (1.0 + 50.0 * time_s) * np.cos(2 * np.pi * 2.0 * angle)  # noqa: E731
    made = cycle_average(
        *run_up([growing], from_rpm=600, to_rpm=1500, duration_s=20.0, rate_hz=5000.0), settings=ORDERS
    )
    slowest = made["mean"].values[0, 0]
    # the slowest group ends before 0.6 s, where the waveform is 31 large
    assert np.abs(slowest).max() < 32.0
    # of 350 revolutions the kernel's neighbours at both ends cost a little: 174 cycles, without the outer two
    assert made["n_cycles"].sum().item() == 172


def test_samples_by_crank_angle_give_the_cycle_to_the_last_digits():
    for start_deg in (0.0, 17.25, -180.0, 90.5):
        angle = np.arange(360 * 41) / 360 + start_deg / 360
        band = sampled(truth(360 * angle)[None], domain="crank_angle", samples_per_rev=360)
        ends = np.array([start_deg / 360, start_deg / 360 + 41])
        angles = shaft(np.array([0.0, math.nan]), ends, np.array([math.nan, math.nan]))
        angles.attrs["domain"] = "crank_angle"
        made = cycle_average(band, angles, settings=ORDERS)
        np.testing.assert_allclose(made["mean"].values[0, 0], truth(made["cycle_angle"].values), atol=2e-12)
        assert made["standard_deviation"].values.max() < 4e-12
        assert np.isnan(made["speed"].values).all()


def test_orders_above_the_highest_fade_instead_of_folding():
    settings = ORDERS.model_copy(update={"max_order": 6.0})
    for order, left in ((6.0, 1.0), (9.0, 0.5), (12.0, 0.0), (20.0, 0.0), (37.0, 0.0)):
        made = of(line(order, 1.0, 0.3), settings=settings)
        expected = left * np.cos(2 * np.pi * order * made["cycle_angle"].values / 360 + 0.3)
        np.testing.assert_allclose(made["mean"].values[0, 0], expected, atol=2e-6)


def test_spread_and_error_are_those_of_the_noise_over_many_recordings():
    sigma, draws = 0.5, 25
    made = [of(total(LOCKED, noise(seed, sigma)), duration_s=3.0) for seed in range(draws)]
    error = np.stack([item["mean"].values[0, 0] - truth(item["cycle_angle"].values) for item in made])
    stated = np.sqrt(np.mean(np.stack([item["standard_error"].values[0, 0] for item in made]) ** 2))
    assert stated == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.05)
    # white noise up to 1000 Hz through |H|^2 = 1 up to 20 orders and a raised cosine to 40, 3/8 of that band
    deviation = np.sqrt(np.mean(made[0]["standard_deviation"].values ** 2))
    assert deviation == pytest.approx(sigma * np.sqrt((20 + 0.375 * 20) * 1000 / 60 / 1000), rel=0.05)


def test_half_orders_cancel_in_the_average_over_one_revolution():
    band, angle = steady([LOCKED], speed_rpm=1000.0, duration_s=8.0, rate_hz=2000.0)
    angle.attrs["revs_per_cycle"] = 1
    made = cycle_average(band, angle, settings=ORDERS)
    assert made.sizes["cycle_angle"] == 180
    whole = [each for each in LINES if each[0] == round(each[0])]
    expected = sum(a * np.cos(2 * np.pi * o * made["cycle_angle"].values / 360 + p) for o, a, p in whole)
    np.testing.assert_allclose(made["mean"].values[0, 0], expected, atol=0.02)  # 132 or 133 revolutions: an odd one


def test_cycles_that_a_gap_reaches_are_left_out_of_their_channel_and_counted():
    band, angle = steady([LOCKED, LOCKED], speed_rpm=1000.0, duration_s=8.0, rate_hz=2000.0, start_rev=0.0)
    usable = np.ones(band["signal"].shape, dtype=bool)
    usable[1, 6000:6060] = False
    spoilt = band["signal"].values.copy()
    spoilt[1, 6000:6060] = 5.0
    band["signal"] = (band["signal"].dims, spoilt, {"units": "see unit"})
    band["usable"] = (band["signal"].dims, usable, {"units": "1"})
    made = cycle_average(band, angle, settings=ORDERS)
    check_dataset(made, "cycle_average")
    lost = made["n_excluded"].values[:, 0]
    assert lost[0] == 0
    assert 1 <= lost[1] <= 3
    assert (made["n_cycles"].values[:, 0] + lost == 66).all()
    np.testing.assert_allclose(made["mean"].values[1, 0], truth(made["cycle_angle"].values), atol=1e-3)
    assert [flag["flag"] for flag in flags_of(made)] == ["cycles_excluded"]
    usable[1] = False
    band["usable"] = (band["signal"].dims, usable, {"units": "1"})
    none = cycle_average(band, angle, settings=ORDERS)
    assert np.isnan(none["mean"].values[1]).all()
    assert flags_of(none)[0]["severity"] == "bad"


def test_less_than_one_cycle_is_refused_and_a_single_one_has_no_spread():
    with pytest.raises(InputError, match=r"less than one engine cycle.*at least 2"):
        of(LOCKED, speed_rpm=600.0, duration_s=0.15)
    single = of(LOCKED, speed_rpm=600.0, duration_s=0.3, start_rev=0.0)
    assert single["n_cycles"].item() == 1
    assert np.isnan(single["standard_deviation"].values).all()
    assert np.isnan(single["standard_error"].values).all()
    np.testing.assert_allclose(single["mean"].values[0, 0], truth(single["cycle_angle"].values), atol=4e-6)


def test_pooled_mean_and_deviation_are_those_of_the_cycles_themselves():
    rng = np.random.default_rng(2)
    items, cycles = [], []
    for count, offset in ((3, 0.0), (7, 1.0), (1, -2.0)):
        values = rng.standard_normal((count, 360)) + offset
        cycles.append(values)
        item = of(LOCKED).copy(deep=True)
        item["n_cycles"][:] = count
        item["mean"][0, 0], item["minimum"][0, 0], item["maximum"][0, 0] = (
            values.mean(axis=0), values.min(axis=0), values.max(axis=0),
        )  # fmt: skip
        spread = values.std(axis=0, ddof=1) if count > 1 else np.full(360, np.nan)
        item["standard_deviation"][0, 0] = spread
        item["standard_error"][0, 0] = spread / np.sqrt(count)
        items.append(item)
    made = cycle_averages(items, speed_bin_rpm=25.0)
    everything = np.concatenate(cycles)
    np.testing.assert_allclose(made["mean"].values[0, 0], everything.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(made["standard_deviation"].values[0, 0], everything.std(axis=0, ddof=1), atol=1e-12)
    np.testing.assert_array_equal(made["minimum"].values[0, 0], everything.min(axis=0))
    # the recordings differ by far more than their cycles scatter: the error follows the recordings
    means, counts = np.stack([each.mean(axis=0) for each in cycles]), np.array([[3.0], [7.0], [1.0]])
    between = (counts * (means - everything.mean(axis=0)) ** 2).sum(axis=0) / (2 * 11)
    assert np.mean(made["standard_error"].values ** 2) == pytest.approx(between.mean(), rel=1e-9)
    assert between.mean() > 2 * np.mean(everything.var(axis=0, ddof=1)) / 11


def test_recordings_of_different_marks_or_whose_cycles_may_begin_half_a_cycle_apart_are_not_averaged_together():
    items = [of(LOCKED, duration_s=8.0), of(LOCKED, duration_s=6.0, start_rev=0.4)]
    items[1].attrs["phase_reference"] = "index"
    made = cycle_averages(items, speed_bin_rpm=25.0)
    np.testing.assert_array_equal(made["n_cycles"].values, items[0]["n_cycles"].values)
    assert made.attrs["phase_reference"] == "mixed"
    assert [flag["flag"] for flag in flags_of(made)] == ["cycles_not_joined"]
    turned = total(*(line(order, amplitude, phase + 2 * np.pi * order) for order, amplitude, phase in LINES))
    items = [of(LOCKED, duration_s=8.0), of(turned, duration_s=6.0)]
    for item in items:
        item.attrs["cycle_known"] = 0
    made = cycle_averages(items, speed_bin_rpm=25.0)
    np.testing.assert_allclose(made["mean"].values, items[0]["mean"].values)
    assert [flag["flag"] for flag in flags_of(made)] == ["cycles_not_joined"]
    known = [item.assign_attrs(cycle_known=1) for item in items]
    joined = cycle_averages(known, speed_bin_rpm=25.0)
    assert np.abs(joined["mean"].values - items[0]["mean"].values).max() > 0.1
