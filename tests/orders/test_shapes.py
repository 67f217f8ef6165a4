"""Operating shapes: amplitudes and phases of a truth, intervals that cover it, origins that are said."""

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.orders.frames import order_frames
from crankorder.orders.shapes import coherence_level, expected_coherence, operating_shapes
from crankorder.quantities import check_dataset
from made.recordings import frames_of, line, steady
from made.shipped import ORDERS

PHASORS = np.array([2.0 * np.exp(0.4j), 0.5 * np.exp(-2.9j), 1.0 * np.exp(1.7j)])


def circular(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def shapes_of(spectrum, orders=(1.0,), reference=None, **options):
    return operating_shapes([frames_of(spectrum, **options)], orders, settings=ORDERS, reference=reference)


def steady_frames(n_frames=8, n_orders=9):
    return np.tile(PHASORS[:, None, None], (1, n_frames, n_orders))


def degrees_apart(one, other):
    return (np.asarray(one) - other + 180.0) % 360.0 - 180.0


def test_a_steady_line_has_its_amplitude_its_phase_and_no_interval():
    made = shapes_of(steady_frames(), orders=(0.5, 1.0, 3.0))
    check_dataset(made, "operating_shapes")
    np.testing.assert_allclose(made["amplitude"].values[:, 0, 1], np.abs(PHASORS), rtol=1e-14)
    np.testing.assert_allclose(made["phase"].values[:, 0, 1], np.degrees(np.angle(PHASORS)), atol=1e-12)
    np.testing.assert_allclose(np.diff(made["amplitude_ci95"].values), 0.0, atol=1e-13)
    np.testing.assert_allclose(np.diff(made["phase_ci95"].values), 0.0, atol=1e-11)
    np.testing.assert_allclose(made["coherence"].values, 1.0, atol=1e-12)
    assert made["phase_from"].values.tolist() == ["tdc", "tdc", "tdc"]


@pytest.mark.parametrize(
    ("order", "reference", "share", "degrees"),
    [(5.5, None, 2e-6, 4e-4), (5.5, "C", 2e-6, 4e-4), (5.48, "A", 2e-3, 0.05)],  # the last between two bins
)
def test_recordings_of_lines_give_the_shape_that_was_put_in(order, reference, share, degrees):
    signals = [line(order, abs(c), float(np.angle(c))) for c in PHASORS]
    frames = order_frames(*steady(signals, speed_rpm=1200.0, duration_s=20.0, rate_hz=2000.0), settings=ORDERS)
    made = operating_shapes([frames], [order], settings=ORDERS, reference=reference)
    np.testing.assert_allclose(made["amplitude"].values[:, 0, 0], np.abs(PHASORS), rtol=share)
    origin = {None: 1.0, "A": PHASORS[0], "C": PHASORS[2]}[reference]
    off = degrees_apart(made["phase"].values[:, 0, 0], np.degrees(np.angle(PHASORS / origin)))
    assert np.abs(off).max() < degrees


def test_a_reference_takes_the_origin_of_angle_out_and_keeps_the_amplitudes():
    turns = np.exp(2j * np.pi * np.random.default_rng(1).uniform(size=8))
    made = shapes_of(steady_frames() * turns[None, :, None], reference="B")
    np.testing.assert_allclose(made["amplitude"].values[:, 0, 0], np.abs(PHASORS), rtol=1e-12)
    expected = np.degrees(np.angle(PHASORS / PHASORS[1]))
    assert np.abs(degrees_apart(made["phase"].values[:, 0, 0], expected)).max() < 1e-9
    assert made["phase_from"].item() == "B"
    np.testing.assert_allclose(made["coherence"].values, 1.0, atol=1e-9)


def test_where_the_crank_gives_no_phase_the_strongest_channel_does_and_it_is_said():
    for orders, attrs, origin in (
        ((1.0, 1.5), {}, ["tdc", "tdc"]),
        ((1.0, 1.5), {"cycle_known": 0}, ["tdc", "A"]),
        ((1.0, 1.5), {"phase_reference": "none"}, ["A", "A"]),
        ((1.0, 1.2), {}, ["tdc", "A"]),
    ):
        assert shapes_of(steady_frames(), orders=orders, **attrs)["phase_from"].values.tolist() == origin


def test_recordings_with_different_marks_are_compared_by_channel_not_by_crank():
    one, two = frames_of(steady_frames()), frames_of(steady_frames() * np.exp(2.0j), phase_reference="index")
    made = operating_shapes([one, two], [1.0], settings=ORDERS)
    assert made["phase_from"].item() == "A"
    np.testing.assert_allclose(made["amplitude"].values[:, 0, 0], np.abs(PHASORS), rtol=1e-12)


def test_noise_as_strong_as_a_steady_line_does_not_raise_its_amplitude_where_phases_are_from_a_channel():
    """A half order without a known cycle beside a natural frequency: the origin's noise is in no amplitude."""
    for shared in (0.0, 1.0):
        draws, n_frames = 1000, 40
        rng = np.random.default_rng(int(shared))
        own, common = circular(rng, 3, n_frames, draws), circular(rng, 1, n_frames, draws)
        made = shapes_of(
            np.array([1.0, 0.9, 0.8])[:, None, None] + shared * common + (1.0 - shared) * own,
            np.arange(draws) / 2, "A", overlap=0.0,
        )  # fmt: skip
        amplitude, ends = made["amplitude"].values[:, 0], made["amplitude_ci95"].values[:, 0]
        truth = np.array([1.0, 0.9, 0.8])[:, None]
        assert amplitude.mean(axis=1) == pytest.approx(truth[:, 0], rel=0.025)  # a mean is longer by noise / (4 n a)
        inside = (ends[..., 0] <= truth) & (truth <= ends[..., 1])
        assert 0.925 < inside.mean() < 0.975
        phases, half = made["phase"].values[1:, 0], 0.5 * np.diff(made["phase_ci95"].values[1:, 0])[..., 0]
        if not shared:
            assert 0.925 < (np.abs(degrees_apart(phases, 0.0)) <= half).mean() < 0.975
        assert np.abs(made["phase"].values[0, 0]).max() < 1e-9


def test_frames_with_a_gap_take_no_part_in_their_channel():
    spectrum = steady_frames() + 0.1 * circular(np.random.default_rng(3), 3, 8, 9)
    gap = spectrum.copy()
    gap[1, 7] = np.nan
    found = shapes_of(gap, overlap=0.0)
    expected = shapes_of(spectrum[:, :7], overlap=0.0)
    np.testing.assert_allclose(found["amplitude_ci95"].values[1], expected["amplitude_ci95"].values[1], rtol=1e-9)
    np.testing.assert_allclose(found["amplitude"].values[0], shapes_of(spectrum)["amplitude"].values[0])
    # and none in any channel where phases are from that one
    found, expected = (shapes_of(frames, reference="B", overlap=0.0) for frames in (gap, spectrum[:, :7]))
    for name in ("amplitude", "phase", "amplitude_ci95", "phase_ci95", "coherence"):
        np.testing.assert_allclose(found[name].values, expected[name].values, rtol=1e-9, atol=1e-9)


def test_where_there_is_no_line_the_interval_reaches_from_nothing_and_holds_it():
    draws = 8000
    made = shapes_of(circular(np.random.default_rng(3), 1, 3, draws), np.arange(draws) / 2, overlap=0.0)
    low = made["amplitude_ci95"].values[0, 0, :, 0]
    # 8,000 draws know 97.5 % to 0.18 %
    assert np.mean(low <= 0.0) > 0.97


def test_noise_has_no_phase_and_no_coherence():
    noise = shapes_of(circular(np.random.default_rng(4), 1, 400, 9), orders=np.arange(1, 9) / 2)
    assert noise["coherence"].values.mean() < 0.02
    assert np.median(np.diff(noise["phase_ci95"].values)) > 60.0


def test_orders_beyond_the_frames_are_missing_and_an_unknown_reference_is_refused():
    made = shapes_of(steady_frames(), orders=(4.0, 4.6))
    assert np.isfinite(made["amplitude"].values[..., 0]).all()
    assert np.isnan(made["amplitude"].values[..., 1]).all()
    with pytest.raises(RequestError, match="A, B, C"):
        shapes_of(steady_frames(), reference="Q")


def test_the_expected_estimate_is_the_mean_over_many_draws():
    for true in (0.0, 0.3, 0.9):
        rng = np.random.default_rng(1)
        common, own = circular(rng, 3, 40_000), circular(rng, 3, 40_000)
        other = np.sqrt(true) * common + np.sqrt(1 - true) * own
        power = (np.abs(common) ** 2).sum(axis=0) * (np.abs(other) ** 2).sum(axis=0)
        estimate = np.abs((other * common.conj()).sum(axis=0)) ** 2 / power
        assert estimate.mean() == pytest.approx(expected_coherence(np.array(true), n_frames=3).item(), abs=0.005)
        if true == 0.0:
            passing = np.mean(estimate > coherence_level(np.array(3.0)))
            assert passing == pytest.approx(0.05, abs=0.005)  # 40,000 draws know it to 0.1 %
