"""Stated errors of kernels are the errors measured, and the shortest that meets a tolerance is found."""

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.fft.resampling import LENGTHS, Kernel, cheapest_kernel, kernel_named, values_at

CONTENTS = (0.02, 0.05, 0.2, 0.4)
SOME_KERNELS = ("sinc-6", "sinc-8", "sinc-16", "sinc-32", "sinc-48")
POSITION_ROUNDING = 1e-12
"""A position near 500 is rounded to 6e-14, which turns a tone at 0.4 of the rate by 1.5e-13."""


def measured_error(kernel: Kernel, content: float) -> float:
    """Worst error of unit tones up to ``content`` at random places."""
    samples, worst = np.arange(2.0 * kernel.margin + 200.0), 0.0
    generator = np.random.default_rng(11)
    for share in (1.0, 0.995, 0.97, 0.9, 0.75, 0.5, 0.1, 0.0):
        at = generator.uniform(kernel.margin, len(samples) - 1 - kernel.margin, 4000)
        turn, phase = 2.0 * np.pi * share * content, generator.uniform(0.0, 2.0 * np.pi)
        signals = np.stack([np.cos(turn * samples + phase), np.sin(turn * samples + phase)])
        values = values_at(signals.astype("f8" if kernel.double else "f4"), at, kernel=kernel).astype("f8")
        worst = max(worst, float(np.abs(values[0] + 1j * values[1] - np.exp(1j * (turn * at + phase))).max()))
    return worst


@pytest.mark.cases(2)
@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("content", [*CONTENTS, 0.49])
@pytest.mark.parametrize("name", SOME_KERNELS)
def test_the_error_of_every_kernel_is_predicted(name, content, double):
    kernel = kernel_named(name, pass_band=content, double=double)
    measured = measured_error(kernel, content)
    assert measured <= kernel.predicted_error + (POSITION_ROUNDING if double else 0.0)
    assert kernel.predicted_error <= 5.0 * measured


@pytest.mark.cases(2)
@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("content", CONTENTS)
@pytest.mark.parametrize("tolerance", [10.0**-k for k in range(2, 10)])
def test_what_is_asked_for_is_met(tolerance, content, double):
    if not double and tolerance < 1e-6:
        with pytest.raises(RequestError, match="float64"):
            cheapest_kernel(1e-7, content=content, double=double)
        return
    kernel = cheapest_kernel(tolerance, content=content, double=double)
    measured = measured_error(kernel, content)
    assert kernel.pass_band == content and kernel.double == double
    assert measured <= kernel.predicted_error + POSITION_ROUNDING
    assert kernel.predicted_error <= tolerance
    assert kernel.predicted_error <= 20.0 * measured  # the ripple of a window varies with length


@pytest.mark.cases(2)
@pytest.mark.parametrize("content", [0.1, 0.3, 0.4])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_a_kernel_leaves_one_image_of_what_lies_above_its_band(tolerance, content):
    kernel = cheapest_kernel(tolerance, content=content)
    at = np.arange(400.0, 3500.0, 0.6724)
    for share in (0.3, 0.42, 0.45, 0.48, 0.499):
        values = values_at(np.cos(2.0 * np.pi * share * np.arange(4000.0))[None], at, kernel=kernel)[0]
        angle = 2.0 * np.pi * np.outer(at, [share, 1.0 - share])
        known = np.hstack([np.cos(angle), np.sin(angle)])
        rest = values - known @ np.linalg.lstsq(known, values, rcond=None)[0]
        assert np.abs(rest).max() < tolerance


@pytest.mark.cases(1)
@pytest.mark.parametrize("content", [0.05, 0.25, 0.4])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_no_shorter_kernel_meets_the_tolerance(tolerance, content):
    chosen = cheapest_kernel(tolerance, content=content)
    for taps in LENGTHS[: LENGTHS.index(chosen.taps)]:
        assert kernel_named(f"kaiser-{taps}", pass_band=content).predicted_error > tolerance


def test_content_near_half_of_the_rate_is_met_by_a_long_kernel():
    kernel = cheapest_kernel(1e-6, content=0.49)
    assert kernel.taps > 300
    assert measured_error(kernel, 0.49) < 1e-6


def test_what_no_kernel_reaches_is_refused_with_what_is_reached():
    for tolerance, content in ((1e-9, 0.495), (1e-17, 0.05)):
        with pytest.raises(RequestError) as refused:
            cheapest_kernel(tolerance, content=content)
        reached = float(refused.value.allowed.removeprefix("at least "))
        assert cheapest_kernel(1.06 * reached, content=content).predicted_error <= 1.06 * reached


def test_content_that_no_sampling_carries_and_a_tolerance_that_is_no_error_are_refused():
    for content in (0.0, 0.5, 0.6, -0.1, np.nan, np.inf):
        with pytest.raises(RequestError, match="share of the sample rate"):
            cheapest_kernel(1e-3, content=content)
        with pytest.raises(RequestError, match="share of the sample rate"):
            kernel_named("sinc-8", pass_band=content)
    for tolerance in (0.0, -1e-6, np.nan):
        with pytest.raises(RequestError, match="above 0"):
            cheapest_kernel(tolerance, content=0.1)


def test_an_unknown_kernel_is_refused_by_name():
    for name in ("sinc-7", "sinc-2", "sinc-514", "sinc-", "sinc", "lagrange-6", "spline-3", "", "sinc-٨"):
        with pytest.raises(RequestError, match="no such interpolation kernel"):
            kernel_named(name, pass_band=0.1)
