"""Faults of a record: none made up in sound ones of many kinds, and each found from a stated size on."""

import math
import secrets
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from crankorder.ingest.record_faults import Sampled, judged
from crankorder.ingest.signal_faults import mend_signal
from machines.faulty_records import FAULTS, Drawn, healthy
from made.shipped import SETTINGS

LARGE = {
    "clipped": 0.2, "spikes": 30.0, "iepe_overload": 10.0, "start_transient": 5.0, "drift": 3.0, "dead_sensor": 1000.0,
    "copied_channel": 0.5, "mains_only": 5.0, "level_step": 2.5,
}  # fmt: skip
"""Size from which on a fault is asked for."""
FOUND = {"clipped": 0.6, "spikes": 0.95, "mains_only": 0.7, "level_step": 0.6, "iepe_overload": 0.9}
"""Share of the large faults that must be found; of those not named here 0.95."""


def flags_of(drawn):
    """What the program says of ``drawn``, that is stored as float32 as a logger does."""
    signals = drawn.signals.astype(np.float32)
    names = [f"c{number}" for number in range(len(signals))]
    known = [mend_signal(row, settings=SETTINGS.ingest) for row in signals]
    sampled = Sampled(names, drawn.quantities, drawn.quantities, drawn.rate_hz, 0.0, "s", drawn.rate_hz, drawn.shaft_hz)
    return judged(signals, known, sampled, Path("a.h5"), settings=SETTINGS.ingest)


def draws(n, seed):
    return [np.random.default_rng([seed, k]) for k in range(n)]


@pytest.mark.parametrize(("n", "seed"), [(11, 2026), pytest.param(300, None, marks=pytest.mark.accuracy)])
def test_nothing_is_made_up_in_sound_records(n, seed):
    seed = seed or secrets.randbits(31)
    print(f"\nsound records: seed {seed}")
    told = [(drawn.kind, flag) for rng in draws(n, seed) for drawn in (healthy(rng),) for flag in flags_of(drawn)]
    doubts = [(kind, flag["flag"], flag["detail"]) for kind, flag in told if flag["severity"] != "info"]
    assert doubts == []


@pytest.mark.accuracy
@pytest.mark.parametrize("kind", FAULTS)
def test_faults_are_found_by_size(kind):
    n, seed = 200, secrets.randbits(31)
    sizes, hits = [], []
    for rng in draws(n, seed):
        drawn = FAULTS[kind](rng)
        flags = flags_of(drawn)
        own = {flag["flag"] for flag in flags if flag["channel"] == ("c1" if kind == "copied_channel" else "c0")}
        sizes.append(drawn.size)
        hits.append(kind in own)
    sizes, hits = np.array(sizes), np.array(hits)
    parts = np.array_split(np.argsort(sizes), 5)
    rates = ", ".join(f"{sizes[part].min():.3g}…{sizes[part].max():.3g}: {hits[part].mean():.0%}" for part in parts)
    print(f"\n{kind} (seed {seed}, {n}): {rates}")
    large = sizes >= LARGE[kind]
    assert np.mean(hits[large]) >= FOUND.get(kind, 0.95)


@pytest.mark.parametrize("kind", FAULTS)
def test_a_few_large_faults_are_found(kind):
    for number, rng in enumerate(draws(40, 7)):
        drawn = FAULTS[kind](rng)
        if drawn.size >= LARGE[kind] and kind in {flag["flag"] for flag in flags_of(drawn)}:
            return
        assert number < 39


def test_low_orders_of_a_slow_shaft_are_no_overload():
    """Orders of 8 to 50 turns a second swing the means of short pieces themselves: 6 in 100 were called overloads."""
    for k, rng in enumerate(draws(100, 17)):
        turns = rng.uniform(8.0, 50.0) * np.arange(6000 * (1 + 2 * (k % 2))) / 6000.0 + rng.uniform()
        row = sum(np.cos(2 * np.pi * (order * turns + rng.uniform())) / order for order in (1.0, 2.0, 5.5))
        row = row + 0.1 * rng.standard_normal(row.size)
        assert flags_of(Drawn(row[None], ("acceleration",), 6000.0, np.nan, "slow shaft")) == []


@pytest.mark.parametrize("per_turn", [25, 30, 32, 36, 40, 64])
def test_a_tone_at_a_simple_share_of_the_rate_has_no_plateau(per_turn):
    """A crest hit by the same few samples in each turn is no pile-up; cut off at 80 % it is one."""
    for rng, limit in product(draws(4, per_turn), (np.inf, 0.8)):
        turns = np.arange(20_000) / per_turn + rng.uniform()
        row = np.clip(np.cos(2.0 * np.pi * turns), -limit, limit) + 3e-4 * rng.standard_normal(turns.size)
        flags = flags_of(Drawn(row[None], ("acceleration",), 10_000.0, np.nan, "tone"))
        assert [flag["flag"] for flag in flags] == ["clipped"] * math.isfinite(limit)
