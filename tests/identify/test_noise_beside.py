"""Noise that channels share: its shape is found whatever its size, and combinations without it are used."""

from __future__ import annotations

import numpy as np

from crankorder.identify.balance.noise_beside import noise_shape, whitening

SPEED_RPM = np.linspace(300.0, 2000.0, 35)
BINS = np.arange(4, 200) / 16.0
FREQUENCY_HZ = SPEED_RPM[:, None] / 60.0 * BINS


def shared_noise(seed, *, size_by_speed=1.0, quiet=0.01):
    """Noise of two sources in three channels, with a little of their own: samples and its true covariance."""
    rng = np.random.default_rng(seed)
    mixed = rng.normal(size=(3, 2)) + 1j * rng.normal(size=(3, 2))
    shape = (2, *FREQUENCY_HZ.shape)
    drawn = np.tensordot(mixed, rng.normal(size=shape) + 1j * rng.normal(size=shape), axes=1)
    own = quiet * (rng.normal(size=(3, *shape[1:])) + 1j * rng.normal(size=(3, *shape[1:])))
    covariance = mixed @ mixed.conj().T + quiet**2 * np.eye(3)
    size = np.broadcast_to(np.asarray(size_by_speed, dtype=float), SPEED_RPM.shape)
    return (drawn + own) * size[:, None], covariance / (np.trace(covariance).real / 3)


def shape_at(noise, hertz, usable=None):
    everywhere = np.ones(FREQUENCY_HZ.shape, dtype=bool) if usable is None else usable
    return noise_shape(noise, frequency_hz=FREQUENCY_HZ, usable=everywhere, at_hz=np.array([hertz]))


def loss(found, true):
    """How much noisier the quietest combination is that was found than the quietest there is."""
    weakest = np.linalg.eigh(found)[1][:, 0]
    return (weakest.conj() @ true @ weakest).real / np.linalg.eigvalsh(true)[0]


def test_the_combination_almost_without_noise_is_found():
    for seed in range(10):
        noise, true = shared_noise(seed)
        shape, bins = shape_at(noise, 60.0)
        assert bins[0] >= 24
        assert loss(shape[0], true) < 1.5


def test_speeds_of_more_noise_do_not_count_for_more():
    sizes = 10.0 ** np.random.default_rng(1).uniform(-2, 2, SPEED_RPM.size)
    even, _ = shape_at(shared_noise(3)[0], 60.0)
    uneven, _ = shape_at(shared_noise(3, size_by_speed=sizes)[0], 60.0)
    alike = [part[0] / np.sqrt(np.outer(np.diag(part[0]).real, np.diag(part[0]).real)) for part in (even, uneven)]
    np.testing.assert_allclose(alike[0], alike[1], atol=0.02)


def test_a_line_that_hides_in_two_bins_is_outvoted():
    noise, true = shared_noise(4)
    near = np.argsort(np.abs(FREQUENCY_HZ - 60.0).ravel())[:2]
    noise.reshape(3, -1)[:, near] = 1000.0 * np.array([1.0, -0.4j, 0.8])[:, None]
    assert loss(shape_at(noise, 60.0)[0][0], true) < 3.0


def test_too_few_bins_tell_no_shape():
    usable = np.zeros(FREQUENCY_HZ.shape, dtype=bool)
    usable[:3] = True
    shape, bins = shape_at(shared_noise(5)[0], 95.0, usable)
    assert np.isnan(shape).all() and bins[0] == 0


def test_whitened_errors_are_one_and_apart():
    _, true = shared_noise(6)
    white = whitening(2.0 * true[None], error=np.ones((3, 1)))[0]
    np.testing.assert_allclose(white @ true @ white.conj().T, np.eye(3), atol=1e-6)


def test_a_channel_that_measured_nothing_takes_no_part():
    _, true = shared_noise(7)
    white = whitening(2.0 * true[None], error=np.array([[1.0], [np.inf], [1.0]]))[0]
    assert not white[1].any() and not white[:, 1].any()
    left = white[np.ix_([0, 2], [0, 2])]
    np.testing.assert_allclose(left @ true[np.ix_([0, 2], [0, 2])] @ left.conj().T, np.eye(2), atol=1e-6)
