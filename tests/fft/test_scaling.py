"""Powers of two that bring channels to the size of one without rounding."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.fft.windows import power_of_two


@pytest.mark.parametrize("size", [1e-300, 1.0, 3.0, 1e300])
@pytest.mark.parametrize("kind", [float, complex])
def test_each_channel_comes_to_between_a_half_and_one_and_back_to_the_bit(size, kind):
    values = size * np.array([[0.1, -0.9, np.nan], [0.3, 0.2, 0.7]]).astype(kind)
    scale = power_of_two(values)
    assert scale.shape == (2, 1)
    largest = np.nanmax(np.abs(values / scale), axis=1)
    assert ((largest >= 0.5) & (largest < 1.0)).all()
    np.testing.assert_array_equal(values / scale * scale, values)


def test_a_channel_of_nothing_is_left_as_it_is_in_size():
    np.testing.assert_array_equal(power_of_two(np.array([[0.0, 0.0], [np.nan, np.nan]])), [[2.0], [2.0]])
