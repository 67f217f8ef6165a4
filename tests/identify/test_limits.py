"""What limits of the user come to: above, within and not decided, beside a truth that was put in."""

import math

import numpy as np
import pytest

from crankorder.campbell.levels import level_frames, limit_bands
from crankorder.campbell.vibration_levels import vibration_levels
from crankorder.findings import Balance
from crankorder.identify.levels import graded, limit_verdicts, third_octave_records, vibration_records
from crankorder.identify.machine_model import Limit, MachineModel
from made.recordings import accelerometer, held

RATE_HZ = 5120.0
BANDS = (*limit_bands("velocity", 10.0, 1000.0), *limit_bands("as measured", 10.0, 1000.0))


def measured(rms_by_rpm, *, seed, seconds=8.0, rate_hz=RATE_HZ):
    """Levels of recordings of white noise whose acceleration from 10 to 1000 Hz has those root mean squares."""
    rows = []
    for number, (rpm, rms) in enumerate(rms_by_rpm.items()):
        noise = np.random.default_rng([seed, number]).standard_normal(int(seconds * rate_hz))
        rows.append((rpm, noise * rms / math.sqrt(2.0 * 990.0 / rate_hz)))
    return levels_of(rows, rate_hz=rate_hz)


def levels_of(rows, *, bands=BANDS, rate_hz=RATE_HZ):
    """Levels of recordings of an accelerometer, each at a speed."""
    items = []
    for number, (rpm, values) in enumerate(rows):
        one = accelerometer(values, rate_hz, str(number))
        items.append(level_frames(one, held(rpm, len(values) / rate_hz), bands=bands, frame_s=0.5))
    return vibration_levels(items, speed_bin_rpm=25.0)


def told_of(levels, band, value):
    """What is told of a limit of acceleration in a ``band``."""
    limits = (Limit("acceleration", *band, value, "x", ()),)
    (told,) = limit_verdicts(levels, None, MachineModel(1, limits=limits))
    return told


def sources(value, *, quantity="acceleration", channels=()):
    return MachineModel(1, limits=(Limit(quantity, 10.0, 1000.0, value, "contract", channels),), rotor_kg=20.0)


def test_the_speed_that_is_above_is_named_and_what_is_below_is_within():
    made = measured({900.0: 1.0, 1500.0: 3.0, 2100.0: 2.0}, seed=1)
    (above,) = limit_verdicts(made, None, sources(2.5))
    assert (above.verdict, round(above.speed_rpm or 0)) == ("above", 1500)
    assert above.level == pytest.approx(3.0, rel=0.03)
    (within,) = limit_verdicts(made, None, sources(3.5))
    assert within.verdict == "within"
    (velocity,) = limit_verdicts(made, None, sources(1.0, quantity="velocity"))
    assert (velocity.unit, velocity.value, velocity.verdict) == ("mm/s", 1000.0, "within")


def test_a_limit_at_the_level_is_seldom_called_passed_or_kept():
    """At four speeds with the level at the limit either verdict is a chance of some per cent."""
    verdicts = []
    for seed in range(25):
        made = measured(dict.fromkeys((900.0, 1500.0, 2100.0, 2700.0), 2.0), seed=seed, seconds=4.0)
        verdicts.append(limit_verdicts(made, None, sources(2.0))[0].verdict)
    assert verdicts.count("above") <= 3 and verdicts.count("within") <= 1  # 2.5 % of "above" is wanted


def test_what_cannot_be_told_is_not_decided():
    slow = measured({900.0: 1.0}, seed=2, rate_hz=1000.0)
    assert limit_verdicts(slow, None, sources(50.0))[0].verdict == "not decided"
    assert "reaches" in limit_verdicts(slow, None, sources(50.0))[0].evidence
    short = measured({900.0: 1.0}, seed=2, seconds=0.4)
    assert limit_verdicts(short, None, sources(50.0, channels=("a",)))[0].verdict == "not decided"
    assert limit_verdicts(short, None, sources(0.006, quantity="balance grade"))[0].verdict == "not decided"


def test_the_balance_grade_is_unbalance_over_mass_times_speed():
    """By hand: 500 g mm on 20 kg are 25 µm; at 3000 rpm, 314.159 rad/s, G is 7.854 mm/s."""
    balance = Balance(residual_rotating_gmm=500.0, residual_rotating_gmm_ci95=(480.0, 520.0))
    made = graded(balance, sources(1.0), 3000.0)
    assert made.grade_mm_s == pytest.approx(7.853982, rel=1e-6)
    assert made.grade_speed_rpm == 3000.0
    levels = measured({900.0: 1.0}, seed=3)
    above, within = (limit_verdicts(levels, made, sources(g, quantity="balance grade"))[0] for g in (6.3e-3, 16e-3))
    assert (above.verdict, within.verdict) == ("above", "within")
    assert graded(balance, MachineModel(1), 3000.0) is balance


def test_the_largest_level_of_each_band_is_marked_once():
    made = measured({900.0: 1.0, 1500.0: 3.0}, seed=4)
    records = vibration_records(made)
    assert len(records) == 4
    assert [(round(one.speed_rpm or 0), one.quantity) for one in records if one.largest] == [
        (1500, "velocity"), (1500, "acceleration"),
    ]  # fmt: skip
    assert third_octave_records(made) == ()


def with_a_line(seed, hertz, band):
    """Levels of a steady line of 1 m/s2 root mean square in a little noise."""
    rng, seconds = np.random.default_rng(seed), 10.0
    at = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    values = math.sqrt(2.0) * np.cos(2 * np.pi * hertz * at + rng.uniform(0.0, 6.0))
    return levels_of([(1500.0, values + 0.02 * rng.standard_normal(at.size))], bands=limit_bands("acceleration", *band))


def test_a_line_at_an_end_of_the_band_is_never_surely_within_or_above():
    """At an end half of the power passes: the level is 0.71, what is in the band (or just outside) is 1 (or 0)."""
    for seed, band, at in ((0, (37.3, 74.6), 37.3), (1, (150.7, 189.9), 189.9 * (1.0 + 1e-4))):
        made = with_a_line(seed, at, band)
        for value in (0.95, 0.5, 0.2):
            told = told_of(made, band, value)
            assert told.verdict == "not decided", (value, band, at)
            assert "end of the band" in told.evidence
            assert told.level_ci95 is not None and told.level_ci95[0] < 0.1 and told.level_ci95[1] > 0.999
        assert told_of(made, band, 1.1).verdict == "within"


def test_a_line_well_inside_or_outside_the_band_is_decided():
    rows = ((68.0, 0.9, "above"), (68.0, 1.1, "within"), (32.0, 0.5, "within"), (152.0, 0.5, "within"))
    for hertz, value, verdict in rows:
        assert told_of(with_a_line(0, hertz, (40.0, 120.0)), (40.0, 120.0), value).verdict == verdict


def test_a_band_too_narrow_for_so_short_a_recording_is_not_decided():
    rows = [(1500.0, np.random.default_rng(number).standard_normal(int(1.5 * RATE_HZ))) for number in range(3)]
    told = told_of(levels_of(rows, bands=limit_bands("acceleration", 10.0, 12.6)), (10.0, 12.6), 100.0)
    assert told.verdict == "not decided"
    assert "too short for that band" in told.evidence
