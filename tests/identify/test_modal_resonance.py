"""What a window makes of a resonance: against numerical convolution and differences."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.fft.windows import window_named
from crankorder.identify.modes.surface_fit import pole_columns, sight

BIN_HZ = 0.5


@pytest.mark.cases(2)
@pytest.mark.parametrize("name", ["hann", "blackman-harris"])
@pytest.mark.parametrize("damping", [0.0005, 0.003, 0.05])
def test_a_resonance_is_seen_through_the_window_as_the_lags_that_the_window_lets_through(
    name: str, damping: float
) -> None:
    """Wiener and Khinchin: the decaying autocorrelation of the mode times that of the window, transformed by sums."""
    window = window_named(name, 32768)
    seen = sight(name, window.enbw_bins * BIN_HZ)
    at = np.array([50.0, 59.5, 60.0, 61.5])
    columns = pole_columns(at, np.array([60.0]), np.array([damping]), seen)[0]
    spectrum = np.fft.rfft(window.values, 65536)
    lagged = np.fft.irfft(np.abs(spectrum) ** 2)[:32768]  # zeros beyond the window's end: nothing wraps around
    lag_s = np.arange(32768) / 32768.0 / BIN_HZ
    sigma, damped = damping * 60.0, 60.0 * np.sqrt(1.0 - damping**2)
    weight = lagged / lagged[0] / 32768.0 / BIN_HZ
    weight[0] *= 0.5  # the trapezoid rule
    decay = 2.0 * np.pi * sigma * weight * np.exp(2j * np.pi * (damped + 1j * sigma) * lag_s)
    near = np.exp(-2j * np.pi * np.outer(at, lag_s)) @ decay
    far = np.exp(-2j * np.pi * np.outer(at, lag_s)) @ decay.conj()
    assert columns[0] == pytest.approx((near + far).real, abs=2e-5)
    assert columns[1] == pytest.approx((far - near).imag, abs=2e-5)


def test_the_derivatives_of_a_resonance_are_its_differences() -> None:
    seen, step = sight("hann", 1.5 * BIN_HZ), 1e-6
    at = np.arange(2.0, 200.0, 0.5)
    f, zeta = np.array([60.0, 115.0]), np.array([0.001, 0.2])
    _, by_f, by_zeta = pole_columns(at, f, zeta, seen)
    for derivative, (df, dz) in ((by_f, (step, 0.0)), (by_zeta, (0.0, step))):
        up = pole_columns(at, f * np.exp(df), zeta * np.exp(dz), seen)[0]
        down = pole_columns(at, f * np.exp(-df), zeta * np.exp(-dz), seen)[0]
        assert derivative == pytest.approx((up - down) / (2 * step), abs=1e-6 * np.abs(derivative).max())


def test_the_kernel_of_a_window_holds_a_tone_s_whole_power() -> None:
    seen = sight("hann", 1.5 * BIN_HZ)
    offsets = np.arange(-200.0, 200.0, 0.01)
    assert np.sum(seen.kernel(offsets)) * 0.01 == pytest.approx(1.0, abs=1e-4)
