"""What the error of the crank angle adds to the intervals of a line."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from crankorder.orders.true_angle import (
    AngleErrors,
    errors_along,
    errors_of_rows,
    stated_errors,
)


def _shaft(error_rev: float, revs: int = 20) -> xr.Dataset:
    """One pulse per revolution at 600 rpm, each knot with the same error, nothing smoothed."""
    knots = np.arange(revs + 2.0)
    return xr.Dataset(
        {
            "time": ("knot", 0.1 * knots),
            "crank_angle": ("knot", knots),
            "speed": ("knot", np.full(knots.size, 600.0)),
            "standard_error": ("knot", np.full(knots.size, error_rev)),
        },
        attrs={"n_pulses": revs, "teeth_per_rev": 1.0, "cut_off_order": np.inf, "revs_per_cycle": 2},
    )


def test_a_phase_errs_by_the_order_times_the_mean_error_of_the_angle() -> None:
    half = AngleErrors(np.zeros(1), np.array([1e-3])).phase_half_deg(np.zeros(2), np.array([1.0, 10.0]))
    np.testing.assert_allclose(half, 1.96 * 0.36 * np.array([1.0, 10.0]), rtol=1e-4)


def test_an_unknown_phase_stays_unknown() -> None:
    half = AngleErrors(np.zeros(2), np.full(2, 1e-3)).phase_half_deg(np.array([180.0, np.nan]), np.array(5.0))
    assert half[0] == 180.0
    assert np.isnan(half[1])


def test_random_error_takes_of_the_amplitude_what_it_takes_of_a_phasors_mean() -> None:
    scatter = np.random.default_rng(1).normal(0.0, 2e-3, 200_000)
    kept = AngleErrors(np.array([2e-3]), np.zeros(1)).kept(np.array([12.0]))
    assert kept[0] == pytest.approx(abs(np.exp(2j * np.pi * 12.0 * scatter).mean()), rel=1e-3)


def test_the_mean_over_a_row_errs_by_the_root_of_its_revolutions_less() -> None:
    shaft = _shaft(1e-3)
    errors = errors_along(shaft, np.array([0.5, 1.0]), np.array([1.0, 16.0]))
    np.testing.assert_allclose(errors.mean, [1e-3, 0.25e-3], rtol=1e-6)


def test_recordings_that_share_a_row_err_each_on_its_own() -> None:
    attrs = {"revs_per_frame": 4, "overlap": 0.0, **stated_errors(_shaft(1e-3), revs_per_frame=4.0)}
    frames = [xr.Dataset(attrs=attrs) for _ in range(2)]
    owner = np.array([0, 1])
    alone = errors_of_rows(frames, owner, [np.array([0])]).mean[0]
    both = errors_of_rows(frames, owner, [np.array([0, 1])]).mean[0]
    assert both == pytest.approx(alone / np.sqrt(2.0))
