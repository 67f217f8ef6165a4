"""Order frames straight from the samples, against analytic signals and the resampled frames."""

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.fft.nonuniform import folding_error
from crankorder.orders.spectra import frame_factor, order_frames_nufft
from crankorder.shaft.angle import knots_of
from made.recordings import line, shaft, steady, total


def request(band, angle, *, begin_rev, revs, **given):
    record = {"rate_hz": band.attrs["rate_hz"], "start_s": 0.0, "knots": knots_of(angle)}
    return record | {"begin_rev": begin_rev, "revs": revs} | given


def errors(band, angle, truth, *, begin_rev, revs, tolerance):
    """Largest error of the orders of ``truth`` {order: complex}, over the frames."""
    orders, exact = np.array(list(truth)), np.array(list(truth.values()))
    asked = request(band, angle, begin_rev=begin_rev, revs=revs, tolerance=tolerance)
    signals = band["signal"].values
    bins = np.rint(orders * revs).astype(int)
    frames = order_frames_nufft(signals, n_orders=bins.max() + 1, **asked)[:, :, bins]
    return np.abs(frames - exact).max()


def parts(truth):
    return total(*(line(order, abs(value), np.angle(value)) for order, value in truth.items()))


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize(
    ("speed_rpm", "rate_hz", "orders"),
    [
        (300.0, 1785.0, (0.5, 5.5, 10.0, 174.5)),  # 174.5 x 5 Hz: 0.978 of the Nyquist frequency
        (2000.0, 1785.0, (0.5, 2.5, 13.0, 26.0)),  # 107 samples in a frame; 0.971 of the Nyquist frequency
        (2000.0, 20000.0, (0.5, 10.0, 100.0, 293.0)),
    ],
)
def test_two_revolutions_give_amplitude_and_phase_to_the_tolerance_up_to_the_nyquist_frequency(
    speed_rpm, rate_hz, orders, tolerance
):
    truth = {order: np.exp(1j * order) for order in orders}
    band, angle = steady([parts(truth)], speed_rpm=speed_rpm, duration_s=3.0, rate_hz=rate_hz)
    clear = np.ceil(400.0 / rate_hz * speed_rpm / 60.0)
    last = angle["crank_angle"].values[-1] - clear - 2.0
    begin = np.linspace(clear, last, 9)
    assert errors(band, angle, truth, begin_rev=begin, revs=2.0, tolerance=tolerance) < tolerance


@pytest.mark.cases(1)
@pytest.mark.parametrize("speed_rpm", [300.0, 2000.0])
def test_without_neighbours_the_error_is_that_of_folding(speed_rpm):
    order = np.floor(2 * 0.487 * 1785.0 * 60.0 / speed_rpm) / 2
    truth = {2.0: 1.0 + 0j, order: 1j}
    band, angle = steady([parts(truth)], speed_rpm=speed_rpm, duration_s=2.05 * 60 / speed_rpm, rate_hz=1785.0)
    begin = angle["crank_angle"].values[0] + np.array([1e-9, 0.03])
    samples = 2.0 * 60.0 / speed_rpm * 1785.0
    worst = errors(band, angle, truth, begin_rev=begin, revs=2.0, tolerance=1e-9)
    assert worst < folding_error(samples * (1.0 - 2 * 0.487))
    assert frame_factor(samples_per_frame=samples, highest_share=0.487, tolerance=1e-9) > 1


@pytest.mark.slow
def test_ramps_of_10_krpm_per_second_over_a_minute():
    """60 s between 1500 and 6500 rpm, up and down, order 4 of 2 m/s2 and smaller ones beside it."""
    rate, middle_hz, swing_hz = 20_000.0, 4000.0 / 60.0, 2500.0 / 60.0
    turning = 10_000.0 / 60.0 / swing_hz  # rad/s
    knots = np.arange(0.0, 60.0, 0.001)

    def revs(t):
        return middle_hz * t - swing_hz / turning * np.cos(turning * t)

    time_s = np.arange(round(59.9 * rate)) / rate
    truth = {0.5: 0.1j, 4.0: 2.0 + 0j, 5.5: 0.3 * np.exp(1j), 40.0: 0.01j}
    signal = parts(truth)(time_s, revs(time_s))[None]
    angle = shaft(knots, revs(knots), 60.0 * (middle_hz + swing_hz * np.sin(turning * knots)))
    begin = np.arange(20.0, revs(59.8) - 24.0, 97.0)
    asked = {"rate_hz": rate, "start_s": 0.0, "knots": knots_of(angle), "begin_rev": begin, "revs": 4.0}
    found = order_frames_nufft(signal, n_orders=161, tolerance=1e-9, **asked)
    exact = np.tile(list(truth.values()), (len(begin), 1))
    np.testing.assert_allclose(found[0][:, [2, 16, 22, 160]], exact, atol=1e-9)


def test_a_mean_a_million_times_the_signal_does_not_leak():
    truth = {2.0: 1.0 + 0j, 5.5: 0.5j}
    quiet, angle = steady([parts(truth)], speed_rpm=1500.0, duration_s=3.0, rate_hz=5000.0)
    band = quiet.copy(deep=True)
    band["signal"].values[:] += 1e6
    begin = np.array([5.0, 5.4, 40.0])
    assert errors(band, angle, truth, begin_rev=begin, revs=4.0, tolerance=1e-6) < 1e-6
    asked = request(band, angle, begin_rev=begin, revs=4.0, tolerance=1e-6)
    mean = order_frames_nufft(band["signal"].values, n_orders=2, **asked)
    np.testing.assert_allclose(np.abs(mean[0]), np.tile([2e6, 1e6], (3, 1)), rtol=1e-6)


def test_bins_at_the_edges_of_the_grid_are_as_right_as_others():
    n_orders = 41
    for revs in (1.0, 2.0, 3.5, 16.0):
        for edge in (1, 2, n_orders - 2, n_orders - 1):
            truth = {edge / revs: np.exp(0.5j)}
            # order 1 / revs of a tone lies beside its own mirror image: with the same bins apart the answer is exact
            band, angle = steady([parts(truth)], speed_rpm=600.0, duration_s=4.0, rate_hz=5000.0)
            asked = request(band, angle, begin_rev=[6.3, 7.0], revs=revs, tolerance=1e-9)
            found = order_frames_nufft(band["signal"].values, n_orders=n_orders, **asked)
            np.testing.assert_allclose(found[0, :, edge], np.exp(0.5j), atol=1e-9)


def test_frames_outside_the_record_are_refused():
    band, angle = steady([line(2.0, 1.0)], speed_rpm=2000.0, duration_s=2.0, rate_hz=1785.0)
    for begin in (-2.0, 64.0, np.nan):
        with pytest.raises(RequestError, match="outside"):
            order_frames_nufft(
                band["signal"].values,
                n_orders=3,
                **request(band, angle, begin_rev=[10.0, begin], revs=4.0, tolerance=1e-6),
            )


def test_what_cannot_be_is_refused():
    band, angle = steady([line(2.0, 1.0)], speed_rpm=2000.0, duration_s=2.0, rate_hz=1785.0)
    for given in ({"tolerance": 1e-13}, {"tolerance": 0.5}, {"revs": 0.0}, {"rate_hz": np.nan}, {"n_orders": 0}):
        with pytest.raises(RequestError):
            asked = {"tolerance": 1e-9, "n_orders": 9} | given
            order_frames_nufft(band["signal"].values, **request(band, angle, begin_rev=[10.0], revs=4.0) | asked)
