"""Speed and angle from the vibration itself: against shafts whose motion is known."""

from functools import cache

import numpy as np
import pytest

from crankorder.errors import InputError
from crankorder.shaft.vibration_speed import FOUR_STROKE_WEIGHTS, speed_from_vibration, trusted_angle
from made.shipped import SHAFT

RATE_HZ = 4096.0


def vibration(angle_rev, duration_s, *, orders, noise=0.35, tones=None, seed=1):
    """One channel of orders ``{order: amplitude}`` in white noise of the given standard deviation, with tones [Hz]."""
    time_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    signal = noise * np.random.default_rng(seed).standard_normal(time_s.size)
    for order, amplitude in orders.items():
        signal += amplitude * np.cos(2 * np.pi * order * angle_rev(time_s) + order)
    for tone_hz, amplitude in (tones or {}).items():
        signal += amplitude * np.cos(2 * np.pi * tone_hz * time_s)
    return signal[None]


def steady(speed_hz):
    return lambda time_s: speed_hz * time_s


def sweep(first_hz, last_hz, duration_s):
    return lambda time_s: first_hz * time_s + (last_hz - first_hz) / duration_s * time_s**2 / 2


def wobbling(speed_hz, share, wobble_hz):
    turn = share * speed_hz / (2 * np.pi * wobble_hz)
    return lambda time_s: speed_hz * time_s - turn * np.cos(2 * np.pi * wobble_hz * time_s)


def speed_rpm(angle_rev, time_s):
    return 60.0 * (angle_rev(time_s + 1e-4) - angle_rev(time_s - 1e-4)) / 2e-4


SOME = {1.0: 1.0, 2.0: 0.7, 3.0: 0.3, 4.0: 0.4}
EVEN = {2.0: 1.0, 4.0: 0.5, 6.0: 0.3}
MOTIONS = {
    "steady": steady(30.0), "run-up": sweep(5.0, 100.0, 10.0), "coast-down": sweep(100.0, 6.0, 10.0),
    "wobbling": wobbling(30.0, 0.02, 1.3), "hunting": wobbling(30.0, 0.1, 0.7),
}  # fmt: skip


@cache
def followed(name):
    return speed_from_vibration(vibration(MOTIONS[name], 10.0, orders=SOME), RATE_HZ, settings=SHAFT)


@pytest.mark.parametrize("name", MOTIONS)
def test_speed_follows_a_known_motion_and_is_unsure_where_it_does_not(name):
    found = followed(name)
    error = np.abs(found.knots.speed_rpm / speed_rpm(MOTIONS[name], found.knots.time_s) - 1.0)
    assert np.median(error) < 0.002
    assert np.quantile(error, 0.95) < 0.01
    assert not ((error > 0.02) & (found.confidence > 0.8)).any()
    assert np.median(found.confidence) > 0.6


@pytest.mark.parametrize(("name", "within_deg"), [("run-up", 3.0), ("steady", 0.8), ("wobbling", 1.5)])
def test_the_angle_is_told_within_a_few_degrees_and_its_standard_error_is_honest(name, within_deg):
    knots = followed(name).knots
    away = knots.angle_rev - MOTIONS[name](knots.time_s)
    middle = away.size // 2
    inside = slice(away.size // 10, -away.size // 10)
    assert 360.0 * np.std(away[inside]) < within_deg
    assert (np.diff(knots.time_s) > 0).all() and (np.diff(knots.angle_rev) > 0).all()
    assert knots.time_s[0] == 0.0 and knots.time_s[-1] == pytest.approx(10.0)
    missed = np.abs(away[inside] - away[middle]) / knots.standard_error_rev[inside]
    assert np.mean(missed < 2.0) > 0.85 and np.mean(missed < 3.0) > 0.9


def test_tones_that_hold_still_do_not_attract_a_sweep():
    signal = vibration(MOTIONS["run-up"], 10.0, orders=SOME, tones={50.0: 1.0, 150.0: 0.5, 236.0: 1.0})
    found = speed_from_vibration(signal, RATE_HZ, settings=SHAFT)
    error = np.abs(found.knots.speed_rpm / speed_rpm(MOTIONS["run-up"], found.knots.time_s) - 1.0)
    assert np.median(error) < 0.005
    assert not ((error > 0.02) & (found.confidence > 0.8)).any()


def test_even_orders_alone_are_a_tie_that_half_the_found_speed_explains_too():
    found = speed_from_vibration(vibration(steady(30.0), 5.0, orders=EVEN), RATE_HZ, settings=SHAFT)
    assert np.median(found.knots.speed_rpm) == pytest.approx(3600.0, rel=1e-3)
    assert [tie.ratio for tie in found.ties][:1] == [0.5]
    assert 0.1 < found.ties[0].relative_evidence < 1.0
    assert "speed_tie" in {flag for flag, _, _ in found.remarks}
    assert found.confidence.max() < 0.85


def test_what_is_known_of_the_machine_decides_the_tie():
    rows = [
        {"order_weights": {1.0: 0.1, 2.0: 0.9, 3.0: 0.1, 4.0: 0.9, 6.0: 0.8, 8.0: 0.5}},
        {"expected_rpm": (1000.0, 2500.0)},
    ]
    for known in rows:
        signal = vibration(steady(30.0), 5.0, orders=EVEN)
        found = speed_from_vibration(signal, RATE_HZ, settings=SHAFT, **known)  # type: ignore[arg-type]
        assert np.median(found.knots.speed_rpm) == pytest.approx(1800.0, rel=1e-3)
        assert 2.0 not in {tie.ratio for tie in found.ties}


def test_noise_alone_tells_no_speed():
    seed = 1
    signal = vibration(steady(30.0), 4.0, orders={}, seed=seed)
    found = speed_from_vibration(signal, RATE_HZ, settings=SHAFT)
    assert np.mean(found.confidence < 0.5) > 0.9
    assert ("speed_doubtful", "bad") in {(flag, severity) for flag, severity, _ in found.remarks}


def test_an_angle_is_refused_where_the_speed_is_a_guess_and_given_where_it_is_not():
    ends = []
    for seed in range(4):
        signal = vibration(steady(30.0), 3.0, orders=SOME, seed=seed)
        ends.append(trusted_angle(speed_from_vibration(signal, RATE_HZ, settings=SHAFT)).angle_rev[-1])
    # 0.043 rev, measured: the first and the last tenth of a second have neighbours on one side only
    assert np.sqrt(np.mean((np.array(ends) - 90.0) ** 2)) < 0.05
    signal = vibration(steady(30.0), 3.0, orders={})
    guess = speed_from_vibration(signal, RATE_HZ, settings=SHAFT)
    with pytest.raises(InputError, match="does not tell the speed"):
        trusted_angle(guess)


def test_units_do_not_matter_and_the_same_input_gives_the_same_bytes():
    signal = np.concatenate([vibration(steady(30.0), 3.0, orders=SOME, seed=seed) for seed in (1, 2)])
    first = speed_from_vibration(signal, RATE_HZ, settings=SHAFT)
    again = speed_from_vibration(signal, RATE_HZ, settings=SHAFT)
    assert first.knots.speed_rpm.tobytes() == again.knots.speed_rpm.tobytes()
    assert first.knots.angle_rev.tobytes() == again.knots.angle_rev.tobytes()
    scaled = speed_from_vibration(signal * np.array([[1024.0], [1 / 64]]), RATE_HZ, settings=SHAFT)
    np.testing.assert_allclose(scaled.knots.speed_rpm, first.knots.speed_rpm, rtol=1e-6)


def test_a_dead_channel_changes_nothing():
    signal = vibration(steady(30.0), 3.0, orders=SOME)
    alone = speed_from_vibration(signal, RATE_HZ, settings=SHAFT)
    beside = speed_from_vibration(np.vstack([signal, np.full_like(signal, 3.0)]), RATE_HZ, settings=SHAFT)
    np.testing.assert_array_equal(beside.knots.speed_rpm, alone.knots.speed_rpm)


def test_a_signal_that_cannot_tell_a_speed_is_refused():
    rows = [
        (np.zeros((2, 8192)), "constant"),
        (np.full((1, 8192), np.nan), "not finite"),
        (np.random.default_rng(0).standard_normal((1, 40)), "cannot tell any speed"),
    ]
    for signal, says in rows:
        with pytest.raises(InputError, match=says):
            speed_from_vibration(signal, RATE_HZ, settings=SHAFT)


def test_half_orders_are_those_of_a_four_stroke_engine_and_else_whole_ones_of_half_the_speed():
    sizes = (0.8, 1.0, 0.8, 0.9, 0.6, 0.5, *[0.4] * 6)
    signal = vibration(steady(25.0), 4.0, orders={0.5 * k: size for k, size in enumerate(sizes, 1)})
    for weights, rpm in ((FOUR_STROKE_WEIGHTS, 1500.0), (None, 750.0)):
        found = speed_from_vibration(signal, RATE_HZ, settings=SHAFT, order_weights=weights)
        assert np.median(np.abs(found.knots.speed_rpm / rpm - 1.0)) < 1e-3
        assert np.median(found.confidence) > 0.9
