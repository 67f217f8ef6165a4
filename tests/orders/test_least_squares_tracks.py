"""Orders of a recording tracked jointly, frame by frame."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.errors import InputError, RequestError
from crankorder.orders.least_squares import tracked_orders
from crankorder.quantities import flags_of
from crankorder.settings import load_settings
from made.recordings import line, run_up, steady, total

SETTINGS = load_settings().orders


def made_from(*parts, duration_s=20.0, **given):
    return steady([total(*parts)], speed_rpm=1237.0, duration_s=duration_s, rate_hz=2000.0, **given)


def test_close_orders_of_a_recording_come_out_with_amplitude_and_phase_from_top_dead_centre():
    recording = made_from(line(5.5, 1.0, 0.4), line(5.48, 0.3, -1.0), line(2.0, 5.0))
    made = tracked_orders(*recording, [5.5, 5.48, 2.0], settings=SETTINGS)
    for order, truth in ((5.5, np.exp(0.4j)), (5.48, 0.3 * np.exp(-1j)), (2.0, 5.0)):
        np.testing.assert_allclose(made["amplitude"].sel(order=order).values, truth, atol=1e-8)


def test_orders_that_are_not_named_do_not_leak_into_whole_cycles():
    recording = made_from(line(5.5, 0.01), line(2.0, 5.0), line(6.0, 3.0, 1.0), lambda t, _: 7.0 + 0.0 * t)
    made = tracked_orders(*recording, [5.5], settings=SETTINGS)
    np.testing.assert_allclose(np.abs(made["amplitude"].values), 0.01, rtol=0.02)


def test_frames_are_whole_cycles_and_lose_none():
    made = tracked_orders(*made_from(line(2.0, 1.0)), [2.0], settings=SETTINGS)
    revs = made["revs"].values
    assert (revs % 2 == 0).all()
    assert (revs >= SETTINGS.revs_per_frame).all()
    # from -0.3 revolutions on: from the first to the last whole one, 412 in whole cycles
    assert revs.sum() == np.floor(20.0 * 1237.0 / 60.0 - 0.3) // 2 * 2


def test_a_run_up_keeps_its_amplitude_and_its_speeds():
    recording = run_up([line(3.0, 2.0, 0.5)], from_rpm=500, to_rpm=3000, duration_s=20.0, rate_hz=2000.0)
    made = tracked_orders(*recording, [3.0], settings=SETTINGS)
    np.testing.assert_allclose(made["amplitude"].values.ravel(), 2.0 * np.exp(0.5j), rtol=1e-7)
    assert (np.diff(made["speed"].values) > 0).all()


def test_what_cannot_be_told_apart_or_carried_is_said():
    recording = made_from(line(5.5, 1.0))
    made = tracked_orders(*recording, [5.5, 5.5 + 1e-13, 60.0], settings=SETTINGS)
    np.testing.assert_allclose(made["combined_amplitude"].sel(order=5.5).values[0], 1.0, atol=1e-6)
    assert np.isnan(made["amplitude"].values).all()
    told = " ".join(flag["detail"] for flag in flags_of(made))
    assert "cannot be told apart" in told
    assert "60 is beyond" in told


def test_a_gap_in_one_channel_leaves_the_other_alone():
    band, shaft = steady([line(2.0, 1.0), line(2.0, 3.0)], speed_rpm=1200.0, duration_s=4.0, rate_hz=2000.0)
    band["signal"].values[1, 1000:1400] = np.nan
    made = tracked_orders(band, shaft, [2.0], settings=SETTINGS)
    np.testing.assert_allclose(np.abs(made["amplitude"].values[:, 0]).T, [[1.0, 3.0]] * made.sizes["frame"], atol=1e-8)


def test_requests_that_make_no_sense_are_refused():
    recording = made_from(line(2.0, 1.0))
    for orders in ([], [0.0], [-1.0]):
        with pytest.raises(RequestError, match="above 0"):
            tracked_orders(*recording, orders, settings=SETTINGS)
    with pytest.raises(InputError, match="less than one engine cycle"):
        tracked_orders(*made_from(line(2.0, 1.0), duration_s=0.08), [2.0], settings=SETTINGS)


def test_an_order_that_is_not_carried_leaves_the_rows_of_the_others_alone():
    recording = steady([total(line(2.0, 1.5, 0.4), line(3.0, 0.5))], speed_rpm=6000.0, duration_s=3.0, rate_hz=2000.0)
    made = tracked_orders(*recording, [12.0, 2.0, 3.0, 3.0 + 1e-13], settings=SETTINGS)
    assert np.isnan(made["amplitude"].sel(order=12.0).values).all()
    np.testing.assert_allclose(made["amplitude"].sel(order=2.0).values, 1.5 * np.exp(0.4j), atol=1e-8)
    np.testing.assert_allclose(made["combined_amplitude"].values[0, 2], 0.5, atol=1e-6)
    told = [flag["detail"] for flag in flags_of(made)]
    assert any("orders 3 and 3 cannot be told apart" in one for one in told)
    assert "order 12 is beyond half the sample rate" in told


def test_an_order_beyond_half_the_sample_rate_alone_is_nan_and_said():
    made = tracked_orders(*made_from(line(2.0, 1.0)), [60.0], settings=SETTINGS)
    assert np.isnan(made["amplitude"].values).all()
    assert "60 is beyond" in flags_of(made)[-1]["detail"]


def test_frames_overlap_where_the_speed_changes_and_take_in_all_cycles_still():
    recording = run_up([line(3.0, 2.0)], from_rpm=600, to_rpm=3000, duration_s=20.0, rate_hz=2000.0)
    made = tracked_orders(*recording, [3.0], settings=SETTINGS)
    begin, revs = made["crank_angle"].values, made["revs"].values
    assert (np.diff(begin) < 0.6 * revs[:-1]).all()
    assert (revs >= SETTINGS.revs_per_frame).all()
    assert begin[-1] + revs[-1] - begin[0] == 20.0 * 1800.0 / 60.0 // 2 * 2 - 2  # the last sample is short of the last
