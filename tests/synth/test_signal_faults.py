"""Faults that are put into signals: what the records say, and that the pipeline finds what they say."""

from typing import Any

import numpy as np
import pytest

from crankorder.ingest.signal_faults import mend_signal
from crankorder.settings import load_settings
from crankorder.synth import parts
from crankorder.synth.poles import recorded
from crankorder.synth.recording import impossible_faults, with_signal_faults

Records = list[dict[str, Any]]
RATE_HZ, N = 5000.0, 40_000
NAMES = ("Y", "Z")


TIME = np.arange(N) / RATE_HZ
CLEAN = np.vstack([3 * np.sin(2 * np.pi * 30.3 * TIME), 8 * np.cos(2 * np.pi * 41.7 * TIME)])
CLEAN += 0.2 * np.random.default_rng(3).normal(size=(2, N))
CLEAN.flags.writeable = False
PEAK = np.abs(CLEAN).max(axis=1)


def faulty(*faults, seed=1, recording="rpm_1000"):
    return with_signal_faults(
        CLEAN, faults, names=NAMES, recording=recording, stream=recording, rate_hz=RATE_HZ, seed=seed
    )


def found(samples):
    """Flags and severities that the pipeline gives to a channel."""
    faults = mend_signal(samples.copy(), settings=load_settings().ingest)
    return [(fault.flag, fault.severity) for fault in faults]


def told(records, name):
    return [(record["flag"], record["severity"]) for record in records if record["channel"] == name]


def test_a_clean_signal_has_no_record_no_flag_and_no_copy():
    signal, records = faulty()
    assert signal is CLEAN
    assert records == []
    assert [found(row) for row in CLEAN] == [[], []]


def test_clipping_is_found_as_it_is_told_also_behind_a_converter():
    signal, records = faulty(parts.Clipping(kind="clipping", of_peak=0.6))
    for stored in (signal, recorded(signal, parts.Acquisition(full_scale=20.0, bits=16)).samples):
        for row, name in zip(stored, NAMES, strict=True):
            assert found(row) == told(records, name) == [("clipped", "bad")]
    for clean, row, peak, record in zip(CLEAN, signal, PEAK, records, strict=True):
        beyond = np.abs(clean) > 0.6 * peak
        assert row.max() == -row.min() == record["level_m_s2"] == pytest.approx(0.6 * peak)
        assert record["n_samples"] == np.count_nonzero(beyond)
        assert record["first_sample"] == np.argmax(beyond)
        assert (row[~beyond] == clean[~beyond]).all()


def missing(duration_s):
    return parts.NotANumber(kind="not_a_number", at_s=2.0, duration_s=duration_s, channels=("Z",))


@pytest.mark.cases(5)
@pytest.mark.parametrize(
    ("fault", "first", "count", "flag"),
    [
        (missing(0.0), 10_000, 1, ("non_finite_interpolated", "suspect")),
        (missing(0.0006), 10_000, 3, ("non_finite_interpolated", "suspect")),
        (missing(0.5), 10_000, 2500, ("gap", "suspect")),
        (missing(2.08), 10_000, 10_400, ("gap", "bad")),
        (parts.Dropout(kind="dropout", at_s=4.0, duration_s=0.5, channels=("Z",)), 20_000, 2500, ("dropout", "bad")),
    ],
)
def test_samples_that_are_lost_are_found_as_they_are_told_and_no_others(fault, first, count, flag):
    signal, (record,) = faulty(fault)
    changed = ~(signal == CLEAN)
    assert np.flatnonzero(changed[1]).tolist() == list(range(first, first + count))
    assert (np.nan_to_num(signal[changed]) == 0).all() and not changed[0].any()
    assert (record["first_sample"], record["n_samples"], record["start_s"]) == (first, count, first / RATE_HZ)
    assert found(signal[1]) == told([record], "Z") == [flag]


def test_spikes_are_single_samples_of_the_stated_height_where_the_record_says():
    signal, records = faulty(parts.Spikes(kind="spikes", count=12, times_peak=7.0))
    for clean, row, peak, record in zip(CLEAN, signal, PEAK, records, strict=True):
        changed = np.flatnonzero(row != clean)
        assert record["flag"] == "spikes"
        assert record["samples"] == changed.tolist()
        assert changed.size == record["n_samples"] == 12
        assert np.abs(row[changed]) == pytest.approx(7 * peak)
        assert {-1.0, 1.0} == set(np.sign(row[changed]))
    assert records[0]["samples"] != records[1]["samples"]


def test_an_overload_is_a_step_that_decays_and_drift_an_offset_and_a_straight_rise():
    signal, records = faulty(parts.IepeOverload(kind="iepe_overload", at_s=1.0001, times_peak=25.0, decay_s=0.4))
    assert records[0]["first_sample"] == 5001  # the first sample after the step
    step = np.where(TIME >= 1.0001, 25 * np.exp(-(TIME - 1.0001) / 0.4), 0.0)
    assert np.abs((signal - CLEAN) / PEAK[:, None] - step).max() < 1e-12 * 25
    signal, records = faulty(parts.Drift(kind="drift", offset_m_s2=3.0, drift_m_s2=-20.0))
    assert np.abs((signal - CLEAN)[0] - 3.0 + 20.0 * np.arange(N) / (N - 1)).max() < 1e-12
    assert told(records, "Y") == [("drift", "info")]


def test_dropped_samples_let_what_follows_come_early():
    signal, records = faulty(parts.DroppedSamples(kind="dropped_samples", at_s=2.0, count=100, channels=("Z",)))
    assert (signal[0] == CLEAN[0]).all()
    expected = np.concatenate([CLEAN[1, :10_000], CLEAN[1, 10_100:], np.full(100, CLEAN[1, -1])])
    np.testing.assert_array_equal(signal[1], expected)
    assert (records[0]["first_sample"], records[0]["dropped"]) == (10_000, 100)


def test_only_the_named_recordings_and_channels_have_a_fault():
    fault = parts.Dropout(kind="dropout", at_s=1.0, duration_s=1.0, channels=("Z",), recordings=("rpm_2000",))
    assert faulty(fault)[0] is CLEAN
    signal, records = faulty(fault, recording="rpm_2000")
    assert [(record["recording"], record["channel"]) for record in records] == [("rpm_2000", "Z")]
    assert (signal[0] == CLEAN[0]).all()


def test_what_a_recording_is_too_short_for_is_told_beforehand():
    for fault, place in (
        (parts.Dropout(kind="dropout", at_s=8.0, duration_s=1.0), "at_s"),
        (parts.NotANumber(kind="not_a_number", at_s=100.0), "at_s"),
        (parts.IepeOverload(kind="iepe_overload", at_s=8.5), "at_s"),
        (parts.DroppedSamples(kind="dropped_samples", at_s=7.0, count=6000), "count"),
        (parts.Spikes(kind="spikes", count=N + 1), "count"),
    ):  # fmt: skip
        (told_fault,) = impossible_faults((parts.Drift(kind="drift"), fault), n_samples=N, duration_s=N / RATE_HZ)
        assert told_fault[1] == f"signal_faults.1.{place}"
