"""The envelope spectrum by order: its scale, its choice of band, its memory, and where it refuses."""

import numpy as np
import pytest
from scipy.special import fdtrc, gammaincc

from crankorder.orders.envelope import envelope_map, recording_envelope
from crankorder.orders.envelope_combs import MOST_NATS, NEAR_TRIALS, Comb, comb_nats, look_nats, looked_at
from crankorder.quantities import check_dataset, flags_of
from made.recordings import shaft
from made.shipped import ORDERS
from made.strikes import recording, strikes


def ratio_of(made):
    return (made["amplitude"].values[:, 0] / made["floor"].values[:, 0]) ** 4


def strongest(made, channel=0):
    order = made["order"].values
    return float(order[np.argmax(np.where(order > 0.25, ratio_of(made)[channel], 0.0))])


def test_a_modulated_tone_reads_the_root_of_the_line_of_its_squared_envelope():
    # (a (1 + m cos))² = a² (1 + m²/2 + 2 m cos + m²/2 cos 2): the line at 7.25 is 2 m a²
    rate, rpm, a, m = 20_000.0, 1800.0, 0.3, 0.2
    angle = np.arange(200_000) / rate * rpm / 60.0
    tone = np.cos(2.0 * np.pi * 4000.0 * np.arange(200_000) / rate)
    signal = a * (1.0 + m * np.cos(2.0 * np.pi * 7.25 * angle)) * tone
    noise = 1e-3 * np.random.default_rng(1).standard_normal(200_000)
    made = recording_envelope(*recording((signal + noise)[None], rate_hz=rate, speed_rpm=rpm), settings=ORDERS)
    at = np.argmin(np.abs(made["order"].values - 7.25))
    assert made["amplitude"].values[0, 0, at] == pytest.approx(np.sqrt(2.0 * m) * a, rel=1e-3)
    assert made["level"].values[0, 0] == pytest.approx(a / np.sqrt(2.0) * np.sqrt(1.0 + m**2 / 2.0), rel=1e-3)
    assert made["band_low"].values[0, 0] < 4000.0 < made["band_high"].values[0, 0]


def test_the_amplitude_of_strikes_does_not_depend_on_the_noise_and_grows_as_they_do():
    sizes = (6.0, 12.0, 24.0)
    read = []
    for seed, size in enumerate(sizes):
        made = recording_envelope(*strikes(order=3.2, size=size, speed_rpm=1500.0, seed=seed), settings=ORDERS)
        near = np.abs(made["order"].values - 3.2) < 0.05
        read.append(made["amplitude"].values[0, 0, near].max() / size)
    assert read == pytest.approx([read[-1]] * 3, rel=0.02)


def test_the_band_is_chosen_where_the_strikes_ring():
    rate, rpm, n = 50_000.0, 1500.0, 200_000
    chance = np.random.default_rng(2000)
    time = np.arange(n) / rate
    phase = (2.18 * time * rpm / 60.0) % 1.0
    ring = np.exp(-phase / 2.18 * 60.0 / rpm * 500.0) * np.cos(2.0 * np.pi * 2000.0 * time)
    signal = 0.5 * ring + chance.standard_normal(n)
    made = recording_envelope(*recording(signal[None], rate_hz=rate, speed_rpm=rpm), settings=ORDERS)
    assert made["band_low"].values[0, 0] - 200.0 < 2000.0 < made["band_high"].values[0, 0] + 200.0
    assert made["band_high"].values[0, 0] - made["band_low"].values[0, 0] < 8000.0
    times = round(strongest(made) / 2.18)
    assert abs(strongest(made) - times * 2.18) < 1.0 / 64.0


def test_each_channel_chooses_its_own_band_and_one_without_strikes_shows_none():
    made, angle = strikes(order=3.2, size=6.0, speed_rpm=1500.0, seed=3)
    noise = np.random.default_rng(9).standard_normal(made["signal"].shape)
    both = np.concatenate([made["signal"].values, noise])
    two, angle = recording(both, rate_hz=12_800.0, speed_rpm=1500.0)
    ratio = ratio_of(recording_envelope(two, angle, settings=ORDERS))
    assert ratio[0].max() > 100.0
    assert ratio[1].max() < 20.0


def test_order_lines_below_the_band_leave_no_trace():
    rate, rpm, n = 12_800.0, 1500.0, 64_000
    chance = np.random.default_rng(4)
    quiet = chance.standard_normal(n)
    angle = np.arange(n) / rate * rpm / 60.0
    loud = quiet + sum(50.0 * np.cos(2.0 * np.pi * k * angle + k) for k in (1.0, 2.0, 5.456, 10.0))
    without, with_lines = (
        recording_envelope(*recording(x[None], rate_hz=rate, speed_rpm=rpm), settings=ORDERS) for x in (quiet, loud)
    )
    assert ratio_of(with_lines).max() < 20.0
    assert with_lines["level"].values == pytest.approx(without["level"].values, rel=0.01)


def test_noise_alone_has_the_floor_it_says():
    # the mean of (amplitude / floor)^4 over noise is 1, whichever band was chosen
    ratios = [
        np.mean(
            ratio_of(recording_envelope(*strikes(order=1.0, size=0.0, speed_rpm=1500.0, seed=seed), settings=ORDERS))[
                0, 64:
            ]
        )
        for seed in range(12)
    ]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.03)


def test_strikes_of_a_run_up_stay_at_their_order():
    rate, n = 12_800.0, 128_000
    time = np.arange(n) / rate
    angle = (600.0 * time + 0.5 * 1200.0 * time**2 / 10.0) / 60.0
    phase = (3.2 * angle) % 1.0
    signal = 4.0 * np.exp(-12.0 * phase) * np.cos(2.0 * np.pi * 3000.0 * time)
    signal += np.random.default_rng(2).standard_normal(n)
    made, _ = recording(signal[None], rate_hz=rate, speed_rpm=1.0)
    knots = np.linspace(0.0, time[-1], 200)
    turned = (600.0 * knots + 60.0 * knots**2) / 60.0
    found = recording_envelope(made, shaft(knots, turned, 600.0 + 120.0 * knots), settings=ORDERS)
    assert abs(strongest(found) - 3.2) <= 1.0 / 64.0
    assert ratio_of(found).max() > 100.0


def test_a_gap_costs_the_frames_that_it_touches_and_nothing_else():
    made, angle = strikes(order=3.2, size=6.0, speed_rpm=3000.0, seed=5, duration_s=12.0)
    whole = recording_envelope(made, angle, settings=ORDERS)
    signal = made["signal"].values.copy()
    signal[0, 20_000:20_400] = np.nan
    made["signal"] = (("channel", "time"), signal, {"units": "see unit"})
    holed = recording_envelope(made, angle, settings=ORDERS)
    assert 0.0 < holed["n_independent"].values[0, 0] < whole["n_independent"].values[0, 0]
    assert strongest(holed) == strongest(whole)
    signal[:] = np.nan
    lost = recording_envelope(made.assign(signal=made["signal"].copy(data=signal)), angle, settings=ORDERS)
    assert lost["n_independent"].values[0, 0] == 0.0


def test_of_a_long_recording_a_stated_share_is_analysed():
    made, angle = strikes(order=3.2, size=6.0, speed_rpm=3000.0, seed=8, duration_s=40.0)
    short = ORDERS.model_copy(update={"envelope_longest_s": 16.0})
    found = recording_envelope(made, angle, settings=short)
    assert found.attrs["analysed_s"] == pytest.approx(16.0, abs=0.1)
    assert found.attrs["recorded_s"] == pytest.approx(40.0)
    assert abs(strongest(found) - 3.2) <= 1.0 / 64.0


def test_where_there_can_be_no_envelope_it_is_empty_and_says_why():
    for change, reason in (
        ({"rate_hz": 1000.0}, "no band above order 20"),
        ({"speed_rpm": np.nan}, "the speed is not known"),
        ({"duration_s": 0.2}, "fewer than 8 revolutions"),
        ({"domain": "crank_angle"}, "by crank angle"),
    ):
        asked = {"rate_hz": 12_800.0, "speed_rpm": 1500.0, "duration_s": 5.0} | change
        n = round(asked["duration_s"] * asked["rate_hz"])
        made, angle = recording(np.zeros((2, n)), rate_hz=asked["rate_hz"], speed_rpm=asked["speed_rpm"])
        if "domain" in asked:
            made = made.rename({"time": "crank_angle"}).assign_attrs(domain="crank_angle", samples_per_rev=360)
        found = recording_envelope(made, angle, settings=ORDERS)
        check_dataset(found, "envelope_map")
        assert found.sizes["order"] == 0
        assert [flag["flag"] for flag in flags_of(found)] == ["no_envelope_band"]
        assert reason in flags_of(found)[0]["detail"]


def test_a_silent_channel_is_no_fault():
    made = recording_envelope(*recording(np.zeros((1, 64_000)), rate_hz=12_800.0, speed_rpm=1500.0), settings=ORDERS)
    assert not np.nan_to_num(made["amplitude"].values).any()


def test_a_map_averages_recordings_of_like_speed_and_keeps_its_schema():
    settings = ORDERS
    items = [
        recording_envelope(*strikes(order=3.2, size=5.0, speed_rpm=rpm, seed=k), settings=settings)
        for k, rpm in enumerate((1500.0, 1505.0, 2000.0))
    ]
    made = envelope_map(items, speed_bin_rpm=25.0)
    check_dataset(made, "envelope_map")
    assert made["speed"].values == pytest.approx([1502.5, 2000.0], abs=0.5)
    assert made["n_independent"].values[0, 0] == pytest.approx(
        sum(float(item["n_independent"].values[0, 0]) for item in items[:2])
    )
    powers = [item["amplitude"].values[0, 0] ** 4 for item in items[:2]]
    assert (made["amplitude"].values[0, 0] ** 4 <= np.maximum(*powers) * (1.0 + 1e-12)).all()
    assert made["band_low"].values[0, 0] == min(item["band_low"].values[0, 0] for item in items[:2])


def test_a_map_of_recordings_without_envelope_is_empty_and_one_with_other_channels_is_left_out():
    empty = recording_envelope(*recording(np.zeros((1, 400)), rate_hz=1000.0, speed_rpm=1500.0), settings=ORDERS)
    assert envelope_map([empty, empty], speed_bin_rpm=25.0).sizes["order"] == 0
    one, two = (
        recording_envelope(*strikes(order=3.2, size=5.0, speed_rpm=1500.0, seed=1, n_channels=n), settings=ORDERS)
        for n in (1, 2)
    )
    made = envelope_map([empty, one, two], speed_bin_rpm=25.0)
    assert made.sizes["channel"] == 1
    assert [flag["flag"] for flag in flags_of(made)] == ["no_envelope_band", "left_out"]


# Combs of lines: their chances are those of noise, and each is judged in the band that serves it.


STEP = 1.0 / 64.0
ALL = np.ones(1921, dtype=np.bool_)


def test_the_table_holds_the_chances_of_the_f_distribution():
    ratio = np.geomspace(1.01, 30.0, 400)
    bins = 3 * np.arange(400)  # no neighbours
    for count in (1.0, 4.7, 300.0):
        exact = -np.log(np.maximum(fdtrc(2.0 * count, 2.0 * 25.6 * count, ratio), 1e-300)) - np.log(NEAR_TRIALS)
        made = look_nats(ratio[None], bins, count=count, floor_worth=25.6, free=ALL[:400])[0]
        assert made == pytest.approx(np.clip(exact, 0.0, MOST_NATS), abs=0.01)


def test_two_harmonics_are_as_unlikely_as_fishers_method_says():
    comb = Comb(3.2, 3.2)
    bins = looked_at((comb,), step=STEP, n_orders=1921)
    nats = np.zeros((1, len(bins)))
    for harmonic in (1, 2):
        nats[0, np.searchsorted(bins, round(harmonic * 3.2 / STEP))] = 9.0
    # of the sets tried, two and three harmonics, the two are the less likely
    wanted = -np.log(gammaincc(2, 18.0)) - np.log(2.0)
    made = comb_nats(nats, bins, comb, step=STEP, free=ALL[: len(bins)])
    assert made.max() == pytest.approx(wanted, rel=1e-6)


def rung(orders_at_hz, *, size, seed, speed_rpm):
    """RecordingEnvelope of strikes at each order, about a percent unsteady, that ring at its own frequency."""
    rate, n = 25_600.0, 128_000
    time = np.arange(n) / rate
    chance = np.random.default_rng(seed)
    signal = chance.standard_normal(n)
    for order, hertz in orders_at_hz:
        wander = 5e-4 * np.cumsum(chance.standard_normal(n))
        turns = (order * time * speed_rpm / 60.0 + chance.random() + wander) % 1.0
        since = turns / order * 60.0 / speed_rpm
        signal += size * np.exp(-800.0 * since) * np.cos(2.0 * np.pi * hertz * since)
    combs = (Comb(3.15, 3.25), Comb(5.35, 5.45))
    made, angle = recording(signal[None], rate_hz=rate, speed_rpm=speed_rpm)
    return recording_envelope(made, angle, settings=ORDERS, combs=combs)


def test_two_trains_of_strikes_are_each_seen_in_their_own_band():
    both = [(3.2, 3000.0), (5.4, 10_000.0)]
    items = [rung(both, size=0.8, seed=k, speed_rpm=rpm) for k, rpm in enumerate((1200.0, 1500.0, 1800.0))]
    made = envelope_map(items, speed_bin_rpm=25.0)
    check_dataset(items[0], "envelope_map")
    check_dataset(made, "envelope_map")
    for comb, (order, hertz) in enumerate(both):
        low, high = made["comb_band_low"].values[comb], made["comb_band_high"].values[comb]
        assert (low < hertz).all()
        assert (high > hertz).all()
        assert (high - low < 7000.0).all()
        near = np.argmin(np.abs(made["look"].values - order))
        assert made["comb_ratio"].values[comb, 0, :, near - 1 : near + 2].max() > 5.0
