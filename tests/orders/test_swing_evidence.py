"""Sidebands of an angle that swings are taken out exactly, and told from lines of their own."""

import numpy as np
import pytest
import xarray as xr

from crankorder.orders import swing_evidence, true_angle
from crankorder.orders.true_angle import AngleErrors, errors_along, errors_of_rows, stated_errors
from crankorder.settings import load_settings

PER_ORDER = 8
SHARES = {"amplitude": 1.0, "standard_error": 1e-4}
EXPECTED = swing_evidence.Expected(load_settings().orders)
STILL = dict.fromkeys(swing_evidence.HARMONICS, (0j, 1e-7))
"""What pulses show of an encoder without error on a shaft that turns evenly."""


def shown(lines, swings):
    """Order spectrum of ``lines`` by an angle that is off by ``swings`` [rev], by Fourier sums over eight turns."""
    n = 4096
    seen = PER_ORDER * np.arange(n) / n
    true = seen.copy()
    for _ in range(60):  # what is shown is the true angle and the error there
        true = seen - sum((size * np.exp(2j * np.pi * k * true)).real for k, size in swings.items())
    signal = sum((size * np.exp(2j * np.pi * order * true)).real for order, size in lines.items())
    return np.fft.rfft(signal)[: 24 * PER_ORDER] * (2.0 / n)


def test_lines_are_brought_back_to_where_they_belong():
    lines = {0.5: 1.0 + 0.2j, 1.0: 2.0j, 7.0: 3.0 + 0j, 12.5: 1.0 - 1.0j}
    swings = {1: 0.4 / 360.0 * np.exp(0.7j), 2: 0.2 / 360.0 * np.exp(-2.0j)}
    wanted = np.array([lines.get(place / PER_ORDER, 0.0) for place in range(24 * PER_ORDER)])
    seen = shown(lines, swings)
    np.testing.assert_allclose(
        swing_evidence.in_true_angle(seen, bins_per_order=PER_ORDER, swings=swings), wanted, atol=2e-4
    )
    assert np.abs(seen - wanted).max() > 0.02


def test_orders_followed_are_brought_back_without_the_sidebands_that_nobody_follows():
    lines, size = {2.0: 1.0j, 3.0: 0.3 + 0j, 15.5: 3.0 + 0j, 23.5: 1.0 - 1.0j}, 0.4 / 360.0 * np.exp(0.7j)
    followed, angle = np.array([2.0, 3.0, 15.5 - 1e-6, 16.5, 23.5]), np.array([0.0, 300.25])
    signal = shown(lines, {1: size})[np.rint(followed * PER_ORDER).astype(int)]
    signal = signal[:, None] * np.exp(2j * np.pi * (np.rint(2.0 * followed) / 2.0 - followed)[:, None] * angle)
    values = {name: (("channel", "order", "frame"), signal[None] * share) for name, share in SHARES.items()}
    coords = {"order": followed, "crank_angle": ("frame", angle)}
    tracks = xr.Dataset(values, coords, {"recording": "a", "standing_out": [3.0, 15.5, 16.5]})
    own = {"a": (swing_evidence.Swing(1, size, 1e-9, 1e-9, True, 0.0, (2.0, 23.5), 0.01),)}
    (made,) = true_angle.tracks_in_true_angle([tracks], true_angle.Swings(own, False))
    true = [lines.get(round(order, 3), 0.0) for order in followed]
    np.testing.assert_allclose(np.abs(made["amplitude"].values[0]).T, [np.abs(true)] * 2, atol=2e-4)
    back = made["crank_angle"].values
    np.testing.assert_allclose(back + (size * np.exp(2j * np.pi * back)).real, angle, atol=1e-7)
    assert made.attrs["standing_out"] == [3.0, 15.5]


def rows(spectra, noise, rng):
    grid = np.stack([one[:: PER_ORDER // 2] for one in spectra])
    scatter = np.sqrt(0.5) * noise * (rng.standard_normal(grid.shape) + 1j * rng.standard_normal(grid.shape))
    return swing_evidence.Rows(grid + scatter, np.full(grid.shape, noise**2))


def test_frames_that_end_below_the_highest_order_count_as_far_as_they_go():
    rng = np.random.default_rng(4)
    spectrum = rng.standard_normal((2, 6, 320)) + 1j * rng.standard_normal((2, 6, 320))
    spectrum[:, 3:, 200:] = spectrum[1, :, 240:] = np.nan
    variables = {"spectrum": (("channel", "frame", "order"), spectrum)}
    for swept, noise in ((0, 2.0 / 3.0), (1, 2.0)):
        found = swing_evidence.rows_of([xr.Dataset(variables, attrs={"revs_per_frame": 16, "swept": swept})])
        assert found is not None and found.value.shape[1] == 40
        assert np.median(found.noise[:, 4:20]) == pytest.approx(noise, rel=0.3)
        assert all(np.isfinite(swing.bound_rev) for swing in swing_evidence.swings_of(found, EXPECTED, {}))


def phases(rng, orders):
    return {order: complex(rng.lognormal() * np.exp(2j * np.pi * rng.random())) for order in orders}


def test_an_eccentric_encoder_is_told_with_its_interval():
    rng = np.random.default_rng(50)
    inside = 0
    for _ in range(6):
        size = 0.05 / 360.0 * np.exp(2j * np.pi * rng.random())
        spectra = [shown(phases(rng, [2.0, 5.5, 9.0, 16.0]), {1: size}) for _ in range(4)]
        found = swing_evidence.swings_of(rows(spectra, 5e-4, rng), EXPECTED, {1: (size, 1e-6)})[0]
        assert found.proved
        inside += abs(found.size - size) < found.left_rev
        assert abs(found.size - size) < 0.1 * abs(size)
    assert inside >= 5


def test_a_good_encoder_is_cleared():
    rng = np.random.default_rng(5)
    for orders in ([1.0, 2.0, 3.0, 4.0, 6.0], [float(n) for n in range(1, 13)], [2.0, 5.5, 9.0]):
        for _ in range(6):
            same = phases(rng, orders)  # alike at all speeds, as beside no mode
            found = swing_evidence.swings_of(rows([shown(same, {}) for _ in range(4)], 1e-3, rng), EXPECTED, STILL)
            assert not any(swing.proved and abs(swing.size) > 1e-2 / 360.0 for swing in found)
    at_one_speed = [shown(phases(rng, [2.0, 5.5, 9.0, 16.0]), {1: 0.2 / 360.0})] * 4
    assert not any(swing.proved for swing in swing_evidence.swings_of(rows(at_one_speed, 5e-4, rng), EXPECTED, {}))


def test_a_wheel_that_is_set_off_modulates_its_own_mesh_and_is_no_encoder():
    rng = np.random.default_rng(6)
    for _ in range(8):
        turned = 0.3 * np.exp(2j * np.pi * rng.random())
        lines = {1.0: 0.5 + 0j, 2.0: 0.3j}
        for multiple in (1, 2):  # the harmonics of a mesh are turned in proportion, as by an encoder
            size = complex(np.exp(2j * np.pi * rng.random()) / multiple)
            lines[9.0 * multiple] = size
            lines[9.0 * multiple + 1] = 0.5j * multiple * turned * size
            lines[9.0 * multiple - 1] = 0.5j * multiple * np.conj(turned) * size
        assert not swing_evidence.swings_of(rows([shown(lines, {}) for _ in range(4)], 1e-3, rng), EXPECTED, STILL)[
            0
        ].proved


def test_pulses_part_an_error_of_the_encoder_from_a_swing_that_falls_with_speed():
    rng = np.random.default_rng(3)
    rpm = np.array([700.0, 900.0, 1300.0, 2000.0])
    error, swing = 0.3 / 360.0 * np.exp(1j), 2.0 / 360.0 * np.exp(-2j)
    pulses = np.zeros((4, 1 + len(swing_evidence.HARMONICS)), dtype=complex)
    pulses[:, 0], pulses[:, 1] = rpm, error + swing * (700.0 / rpm) ** 2
    alike = swing_evidence.alike_at_all_speeds(pulses, slack=0.03)
    assert abs(alike[1][0] - error) < 3.0 * alike[1][1] < 0.06 / 360.0
    assert not any(1 in swing_evidence.alike_at_all_speeds(pulses[[0] * n], slack=0.03) for n in (0, 1, 2))
    # a mode lifts all carriers, not their sidebands: in the true angle these look as an error by the swing would
    spectra = [shown(phases(rng, [2.0, 5.5, 9.0, 16.0]), {1: error + swing * (700.0 / n) ** 2}) for n in rpm[2:]]
    assert not swing_evidence.swings_of(rows(spectra, 5e-4, rng), EXPECTED, alike)[0].proved


def test_lines_that_lack_their_sidebands_in_other_recordings_clear_the_encoder():
    rng = np.random.default_rng(5)
    size, of = 0.2 / 360.0 * np.exp(1j), {}
    for name, spared in (("a", {}), ("b", {5.5: 1.0, 9.0: 1.0j, 12.0: 0.5})):
        still = shown(spared, {1: 0j}) if spared else 0.0
        spectra = [shown(phases(rng, [2.0, 7.0, 16.0]), {1: size}) + still for _ in range(4)]
        of[name] = swing_evidence.swings_of(rows(spectra, 5e-4, rng), EXPECTED, {1: (size, 1e-6)})
    assert of["a"][0].proved
    assert swing_evidence.unless_lines_lack({"a": of["a"]})["a"][0].proved
    assert of["b"][0].lacking[0] > 0.3 * of["b"][0].lacking[1]
    assert not any(own[0].proved for own in swing_evidence.unless_lines_lack(of).values())


# What the error of the crank angle adds to the intervals of a line.


def _shaft(error_rev, revs=20):
    """One pulse per revolution at 600 rpm, each knot with the same error, nothing smoothed."""
    knots, one = np.arange(revs + 2.0), np.ones(revs + 2)
    given = {"time": 0.1 * knots, "crank_angle": knots, "speed": 600.0 * one, "standard_error": error_rev * one}
    attrs = {"n_pulses": revs, "teeth_per_rev": 1.0, "cut_off_order": np.inf, "revs_per_cycle": 2}
    return xr.Dataset({name: ("knot", values) for name, values in given.items()}, attrs=attrs)


def test_a_phase_errs_by_the_order_times_the_mean_error_of_the_angle():
    half = AngleErrors(np.zeros(4), np.full(4, 1e-3))
    half = half.phase_half_deg(np.array([0.0, 0.0, 180.0, np.nan]), np.array([1.0, 10.0, 5.0, 5.0]))
    np.testing.assert_allclose(half, [1.96 * 0.36, 1.96 * 3.6, 180.0, np.nan], rtol=1e-4)


def test_random_error_takes_of_the_amplitude_what_it_takes_of_a_phasors_mean():
    scatter = np.random.default_rng(1).normal(0.0, 2e-3, 200_000)
    kept = AngleErrors(np.array([2e-3]), np.zeros(1)).kept(np.array([12.0]))
    assert kept[0] == pytest.approx(abs(np.exp(2j * np.pi * 12.0 * scatter).mean()), rel=1e-3)


def test_the_mean_over_a_row_errs_by_the_root_of_its_revolutions_less():
    errors = errors_along(_shaft(1e-3), np.array([0.5, 1.0]), np.array([1.0, 16.0]))
    np.testing.assert_allclose(errors.mean, [1e-3, 0.25e-3], rtol=1e-6)


def test_recordings_that_share_a_row_err_each_on_its_own():
    attrs = {"revs_per_frame": 4, "overlap": 0.0, **stated_errors(_shaft(1e-3), revs_per_frame=4.0)}
    frames, owner = [xr.Dataset(attrs=attrs)] * 2, np.arange(2)
    alone, both = (errors_of_rows(frames, owner, [np.arange(n)]).mean[0] for n in (1, 2))
    assert both == pytest.approx(alone / np.sqrt(2.0))
