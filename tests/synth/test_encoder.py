"""The sampled encoder against the counts that its speed implies."""

import numpy as np
import pytest

from crankorder.synth.encoder import sampled_encoder

RATE_HZ = 50_000.0


def sampled(start_rev: float, speed_rpm: float, pulses: int = 360) -> tuple[np.ndarray, np.ndarray]:
    n_samples = 250_000
    return sampled_encoder(
        start_rev, speed_rpm, pulses_per_rev=pulses, high_v=5.0, rate_hz=RATE_HZ, n_samples=n_samples
    )


@pytest.mark.parametrize("speed_rpm", [300.0, 1234.5, 2000.0])
@pytest.mark.parametrize("start_rev", [0.1003, 1.73181])
def test_every_pulse_rises_at_its_angle_within_one_sample(speed_rpm: float, start_rev: float) -> None:
    encoder, index = sampled(start_rev, speed_rpm)
    rise = np.flatnonzero((encoder[1:] > 2.5) & (encoder[:-1] < 2.5)) + 1
    first = np.ceil(360 * start_rev)
    exact = ((first + np.arange(rise.size)) / 360 - start_rev) * 60 / speed_rpm * RATE_HZ
    assert ((rise - exact > -1e-6) & (rise - exact < 1 + 1e-6)).all()
    assert rise.size == np.floor(360 * (start_rev + speed_rpm / 60 * 249_999 / RATE_HZ)) - first + 1
    mark = np.flatnonzero((index[1:] == 1) & (index[:-1] == 0)) + 1
    assert set(np.diff(np.searchsorted(rise, mark))) == {360}
    assert np.isin(mark, rise).all()
    turns = start_rev + mark / RATE_HZ * speed_rpm / 60
    assert (np.abs(turns - np.rint(turns)) < speed_rpm / 60 / RATE_HZ * (1 + 1e-9)).all()


def test_the_wave_is_high_half_of_the_time_and_has_two_levels() -> None:
    encoder, index = sampled(0.0, 1000.0, 60)
    assert encoder.dtype == np.float32
    assert index.dtype == np.uint8
    assert set(np.unique(encoder)) == {0.0, 5.0}
    assert set(np.unique(index)) == {0, 1}
    assert encoder.mean() == pytest.approx(2.5, abs=0.01)
    assert index.mean() == pytest.approx(1 / 60, abs=1e-3)
    assert encoder[0] == 5
    assert index[0] == 1
