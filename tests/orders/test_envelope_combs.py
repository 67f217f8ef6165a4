"""Combs of lines: their chances are those of noise, and each is judged in the band that serves it."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.special import fdtrc, gammaincc

from crankorder.orders.envelope import envelope_map, recording_envelope
from crankorder.orders.envelope_combs import (
    MOST_NATS,
    NEAR_TRIALS,
    Comb,
    comb_nats,
    look_nats,
    looked_at,
    served,
)
from crankorder.quantities import check_dataset
from crankorder.settings import load_settings
from made.strikes import recording

ORDERS = load_settings().orders
STEP = 1.0 / 64.0
ALL = np.ones(1921, dtype=np.bool_)


@pytest.mark.cases(1)
@pytest.mark.parametrize("count", [1.0, 4.7, 300.0])
def test_the_table_holds_the_chances_of_the_f_distribution(count):
    ratio = np.geomspace(0.2, 30.0, 400)
    bins = 3 * np.arange(400)  # no neighbours
    exact = -np.log(np.maximum(fdtrc(2.0 * count, 2.0 * 25.6 * count, ratio), 1e-300)) - np.log(NEAR_TRIALS)
    made = look_nats(ratio[None], bins, count=count, floor_worth=25.6, free=ALL[:400])[0]
    wanted = np.clip(exact, 0.0, MOST_NATS)
    above = ratio > 1.0
    assert made[above] == pytest.approx(wanted[above], abs=0.01)


def test_bins_that_are_not_free_count_neither_themselves_nor_as_neighbours():
    ratio, free = np.ones((1, 9)), np.ones(9, dtype=np.bool_)
    ratio[0, 4], free[4] = 1e4, False
    made = look_nats(ratio, np.arange(9), count=4.0, floor_worth=25.6, free=free)
    assert made.max() < 1.0


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


def test_sidebands_are_evidence_only_of_what_comes_and_goes():
    plain, swelling = Comb(5.4, 5.4), Comb(5.4, 5.4, 1.0)
    bins = looked_at((plain, swelling), step=STEP, n_orders=1921)
    nats = np.zeros((1, len(bins)))
    for order in (5.4, 4.4, 6.4, 10.8, 9.8, 11.8):
        nats[0, np.searchsorted(bins, round(order / STEP))] = 6.0
    one, both = (comb_nats(nats, bins, comb, step=STEP, free=ALL[: len(bins)]).max() for comb in (plain, swelling))
    assert both > one + 5.0


def test_channels_tried_together_show_what_each_shows_alone():
    rng = np.random.default_rng(8)
    combs = (Comb(3.2, 3.4), Comb(5.1, 5.3, 1.0), Comb(0.38, 0.42))
    bins = looked_at(combs, step=STEP, n_orders=1921)
    ratio, count = rng.gamma(2.0, 1.0, (3, 4, bins.size)), rng.uniform(2.0, 30.0, 3)
    free = rng.random(1921) < 0.9
    together = served(ratio, combs, bins, step=STEP, count=count, worth=20.0, free=free)
    for row, own, shown in zip(ratio, count, together.swapaxes(0, 1), strict=True):
        nats = look_nats(row, bins, count=float(own), floor_worth=20.0, free=free[bins])
        alone = [comb_nats(nats, bins, comb, step=STEP, free=free[bins]).max(axis=1, initial=0.0) for comb in combs]
        np.testing.assert_array_equal(shown, alone)


def rung(orders_at_hz: list[tuple[float, float]], *, size: float, seed: int, speed_rpm: float) -> xr.Dataset:
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


def test_a_map_of_recordings_without_combs_holds_none():
    plain = recording_envelope(
        *recording(np.random.default_rng(1).standard_normal((1, 64_000)), rate_hz=12_800.0, speed_rpm=1500.0),
        settings=ORDERS,
    )
    assert "comb_ratio" not in envelope_map([plain], speed_bin_rpm=25.0)
