"""Seed streams and levels of the random parts."""

import numpy as np
import pytest
import xarray as xr
from scipy.signal import welch

from crankorder.batch.accuracy import Twin, _floor
from crankorder.errors import RequestError
from crankorder.synth.lines import modulation, ringing, ringing_s, slipping_line, strike_angles
from crankorder.synth.noise import (
    density_through_points,
    folded_density,
    padded_length,
    put_coloured_noise,
    seed_stream,
    white_noise,
    white_spectrum,
)
from crankorder.synth.parts import ColouredNoise
from crankorder.synth.poles import high_pass, in_series, low_pass

RATE_HZ = 8000.0


def density_of(signal):
    """One-sided amplitude density of frames of 800 samples without overlap: bins of 10 Hz."""
    power = np.abs(np.fft.rfft(signal.reshape(-1, 800))) ** 2
    return np.sqrt(2 * power.mean(axis=0) / (RATE_HZ * 800))


def test_streams_depend_on_every_name_and_on_nothing_else():
    draws = {
        names: seed_stream(3, *names).random() for names in [("a", "r1"), ("a", "r2"), ("b", "r1"), ("a",), ("r1", "a")]
    }
    assert len(set(draws.values())) == len(draws)
    assert seed_stream(3, "a", "r1").random() == draws["a", "r1"]
    assert seed_stream(4, "a", "r1").random() != draws["a", "r1"]


def test_white_noise_has_the_density_that_was_asked_for():
    noise = white_noise(seed_stream(1, "x"), 0.25, rate_hz=RATE_HZ, n_samples=1_600_000)
    assert density_of(noise)[1:-1] == pytest.approx(0.25, rel=0.1)
    assert noise.std() == pytest.approx(0.25 * np.sqrt(RATE_HZ / 2), rel=0.003)


def test_noise_behind_a_response_has_its_density():
    n_samples = 1_600_000
    n_padded = padded_length(n_samples, 4000)
    white = [white_spectrum(seed_stream(2, axis), 2.0, rate_hz=RATE_HZ, n_samples=n_padded) for axis in "XY"]
    frequency = np.arange(n_padded // 2 + 1) * RATE_HZ / n_padded
    response = np.zeros((2, 2, frequency.size), dtype=np.complex64)
    response[0, 0], response[0, 1] = 3j, 1 / (1 + 1j * frequency / 500)
    noise = np.zeros((2, n_samples), dtype=np.float32)
    put_coloured_noise(noise, white, [response])
    bins = np.arange(401) * 10.0
    exact = 2 * np.sqrt(9 + 1 / (1 + (bins / 500) ** 2))
    assert density_of(noise[0])[2:-2] == pytest.approx(exact[2:-2], rel=0.1)
    assert not noise[1].any()


def test_a_density_through_points_is_straight_on_log_scales_and_level_outside():
    part = ColouredNoise(channels=("Y",), frequency_hz=(1.0, 100.0, 1000.0), m_s2_per_root_hz=(1.0, 0.1, 0.4))
    frequency = np.array([0.0, 0.3, 1.0, 10.0, 25.0, 100.0, np.sqrt(1e5), 1000.0, 5e4])
    exact = [1.0, 1.0, 1.0, 10**-0.5, 0.2, 0.1, 0.2, 0.4, 0.4]
    assert density_through_points(part, frequency) == pytest.approx(exact, rel=1e-12)


def test_images_of_a_shaped_density_add_by_power_above_and_below_the_points():
    part = ColouredNoise(channels=("Y",), frequency_hz=(50.0, 3e3, 9e4), m_s2_per_root_hz=(2.0, 0.1, 3.0))
    frequency = np.linspace(0.0, RATE_HZ / 2, 17)
    for order in (2, 5):
        folded = folded_density(lambda f: density_through_points(part, f), low_pass(order, 3500.0), RATE_HZ, frequency)
        images = np.abs(frequency[:, None] + RATE_HZ * np.arange(-4000, 4001))
        gain = 1 / (1 + (images / 3500.0) ** (2 * order))
        brute = np.sum(density_through_points(part, images) ** 2 * gain, axis=1)
        assert folded == pytest.approx(np.sqrt(brute), rel=1e-9)


# The synthetic twin of a test: its floor has no line of its own where the test's orders stood.


def test_the_floor_under_an_order_is_that_beside_it():
    rate, rpm, order = 2048.0, 1300.0, 3.57
    frequency = np.arange(0.0, 800.0, 0.5)
    line = order * rpm / 60.0
    density = 1e-4 * (1.0 + 1e4 * np.exp(-0.5 * ((frequency - line) / 0.4) ** 2))  # a line as Hann's window shows it
    campbell = xr.Dataset(
        {"psd": (("channel", "speed", "frequency"), density[None, None])},
        coords={"speed": [rpm], "frequency": frequency},
    )
    tracks = xr.Dataset(coords={"order": [order]})
    twin = Twin(tracks, campbell, xr.Dataset(), xr.Dataset(), rate, 1, 0.0)
    (signal,) = _floor(twin, rpm, int(400 * rate), np.random.default_rng(1))
    at, found = welch(signal, rate, nperseg=4096)
    under = found[np.abs(at - line) < 1.5].mean()
    beside = found[(np.abs(at - line) > 10.0) & (np.abs(at - line) < 60.0)].mean()
    assert 0.9 < under / beside < 1.1  # it was up to four times as much


# Strikes of a damaged bearing: their statistics, their size, and the ringing against sums and equations of motion.


BPFO = 2.2
CAGE, SHAFT = 0.2, 0.5


def strikes(seed=1, **differences):
    asked = {"slip_percent": 1.0, "jitter_percent": 2.0, "start_rev": -3.0, "end_rev": 500.0} | differences
    order = asked.pop("order", BPFO)
    return strike_angles(order, **asked, stream=seed_stream(seed, "impacts"))


def directly(times, struck, size, *, resonance_hz, damping_ratio):
    """One sine after another, each over its peak."""
    decay = damping_ratio * 2 * np.pi * resonance_hz
    damped, at_peak = 2 * np.pi * resonance_hz * np.sqrt(1 - damping_ratio**2), np.arccos(damping_ratio)
    tau = times - np.array(struck)[:, None]
    rings = np.where(tau > 0, np.exp(-decay * tau) * np.sin(damped * tau), 0.0)
    return size @ rings / (np.exp(-decay * at_peak / damped) * np.sin(at_peak))


def test_without_jitter_strikes_come_evenly_at_the_slipping_line():
    found = strikes(jitter_percent=0.0, slip_percent=1.5)
    assert np.diff(found) == pytest.approx(1 / (BPFO * 0.985), rel=1e-12)
    assert -3 <= found[0] < -3 + 1 / (BPFO * 0.985)
    assert 500 - 1 / (BPFO * 0.985) < found[-1] <= 500
    assert slipping_line(BPFO, slip_percent=1.5) == pytest.approx(BPFO * 0.985, rel=1e-15)
    assert slipping_line(BPFO, slip_percent=-2.0) > BPFO


def test_jitter_adds_up_to_a_random_walk():
    stream, asked = seed_stream(7, "walks"), {"slip_percent": 0, "jitter_percent": 2, "start_rev": 0, "end_rev": 700}
    walks = np.array([strike_angles(1.0, **asked, stream=stream)[:641] for _ in range(2000)])
    after = np.array([10, 40, 160, 640])
    gone = walks[:, after] - walks[:, :1]
    assert np.abs(gone.mean(axis=0) - after).max() < 4 * 0.02 * np.sqrt(640 / 2000)
    # variance = strikes · jitter²; its own scatter is √(2/2000) = 3.2 %; of jitter about fixed places it would not grow
    assert gone.var(axis=0) / (after * 0.02**2) == pytest.approx(1, abs=4 * 0.032)


def test_a_longer_record_adds_strikes_and_changes_none():
    short, long = strikes(start_rev=3.0, end_rev=200.0), strikes(start_rev=-900.0, end_rev=2000.0)
    assert np.array_equal(long[(long >= 3) & (long <= 200)], short)
    assert abs(short.size / 197 - long.size / 2900) < 0.01 * BPFO
    assert strikes(start_rev=-900.0, end_rev=-400.0).tolist() == long[long <= -400].tolist()
    assert np.diff(long) == pytest.approx(1 / (BPFO * 0.99), rel=0.1)  # where both ways meet too: 5 σ
    assert strikes(start_rev=5.0, end_rev=4.0).size == 0


@pytest.mark.parametrize(("line", "order"), [("BPFI", SHAFT), ("BSF", CAGE)])
def test_the_load_zone_comes_and_goes_with_what_the_damage_turns_with(line, order):
    zone = {"load_zone": 0.7, "shaft_ratio": SHAFT, "cage_order": CAGE, "phase_rev": 0.1}
    at = strikes(end_rev=20_000.0)
    size = modulation(line, at, **zone)
    assert size == pytest.approx(modulation(line, at + 1 / order, **zone), abs=1e-9)
    assert abs(size.mean() - 1) < 0.01
    assert (size.min(), size.max()) == pytest.approx((0.3, 1.7), abs=1e-3)
    assert modulation(line, np.array([-0.1 / order]), **zone) == pytest.approx(1.7)


def test_the_ringing_is_the_sum_of_its_sines():
    for resonance_hz, damping_ratio in ((3100.0, 0.02), (700.0, 0.3), (14_900.0, 0.004)):
        rate_hz, n = 20_000.0, 3000  # 14.9 kHz folds, as without a filter it does
        chance = np.random.default_rng(5)
        struck = chance.uniform(-0.05, 0.16, 60)  # not in sequence, some before, some after the record
        size = chance.uniform(0.2, 2.0, 60)
        found = ringing(
            struck, size, resonance_hz=resonance_hz, damping_ratio=damping_ratio, rate_hz=rate_hz, n_samples=n
        )
        known = directly(np.arange(n) / rate_hz, struck, size, resonance_hz=resonance_hz, damping_ratio=damping_ratio)
        assert np.abs(found - known).max() < 1e-11 * np.abs(known).max()


@pytest.mark.parametrize("resonance_hz", [3000.0, 16_000.0])
def test_behind_a_filter_the_ringing_is_the_response_of_both_to_one_strike(resonance_hz):
    """A sum over the poles of oscillator, two-pole low-pass and coupling, by hand."""
    rate_hz, struck_s, zeta = 25_600.0, 0.731 / 25_600, 0.03
    shape = {"resonance_hz": resonance_hz, "damping_ratio": zeta, "rate_hz": rate_hz, "n_samples": 160}
    through = in_series(low_pass(2, 6000.0), high_pass(300.0))
    found = ringing(np.array([struck_s]), np.array([1.0]), **shape, filter=through)

    natural, corner, coupling = (2 * np.pi * f for f in (resonance_hz, 6000.0, 300.0))
    ring, butterworth = natural * (-zeta + 1j * np.sqrt(1 - zeta**2)), corner * np.exp(0.75j * np.pi)
    poles = np.array([ring, np.conj(ring), butterworth, np.conj(butterworth), -coupling])
    residues = [corner**2 * pole / np.prod(pole - poles[poles != pole]) for pole in poles]
    after = np.arange(160) / rate_hz - struck_s
    damped, steepness = ring.imag, np.arccos(zeta)
    peak = np.exp(-zeta * natural * steepness / damped) * np.sin(steepness) / damped  # of the oscillator alone
    known = sum(residue * np.exp(pole * after) for residue, pole in zip(residues, poles, strict=True)).real / peak
    assert found[0] == 0
    assert np.abs(found[1:] - known[1:]).max() < 1e-9 * np.abs(known[1:]).max()


def test_a_resonance_that_is_a_pole_of_the_filter_is_refused():
    with pytest.raises(RequestError, match="is a pole of the acquisition's filter"):
        ringing_s(1000.0, float(np.sqrt(0.5)), filter=low_pass(2, 1000.0))
