"""Speeds to avoid, worst first; bands that are free because the data exclude an amplification; and those left open."""

from dataclasses import replace

import numpy as np
import pytest

from crankorder.identify.crossings import crossings
from crankorder.identify.found import SpeedVerdicts, UnseenBound
from crankorder.identify.modes.responses import held_amplitudes
from crankorder.identify.speeds_to_avoid import Sizes, as_avoided, lone_peaks, speeds_to_avoid
from made.drawn_orders import drawn_machine, judged
from made.found_lines import SPEEDS_RPM, agreed, fit, line, made_response, mode, resonant
from made.shipped import IDENTIFY

RANGE = (600.0, 2000.0)
UNIT = {"A": "m/s2", "B": "m/s2", "pressure": "bar"}


def seen_everything(*orders):
    """Bounds that exclude any mode nobody saw: what finely stepped speeds would give."""
    return tuple(UnseenBound(order, SPEEDS_RPM, np.ones(len(SPEEDS_RPM))) for order in orders)


def judge(orders, modal, *, speed_rpm=RANGE, stated=()):
    found = crossings(tuple(orders), modal, speed_rpm=speed_rpm, settings=IDENTIFY, stated=stated)
    return speeds_to_avoid(found, tuple(orders), modal, speed_rpm=speed_rpm, unit=UNIT, settings=IDENTIFY)


def ends(bands):
    return [(band.low_rpm, band.high_rpm) for band in bands]


def test_two_orders_that_meet_two_modes_at_one_speed_are_one_speed_to_avoid():
    modes = [mode(115.0, 0.016), mode(230.0, 0.014)]
    orders = [agreed(k, line(k, size * resonant(k, SPEEDS_RPM, modes))) for k, size in ((4.0, 1.0), (8.0, 0.1))]
    verdicts = judge(orders, fit(*modes, unseen=seen_everything(4.0, 8.0)))
    records = [speed.as_dict() for speed in verdicts.avoid]
    at_1725 = [record for record in records if record["rpm_range"][0] < 1725.0 < record["rpm_range"][1]]
    assert len(at_1725) == 1 and at_1725[0]["rank"] == 1
    assert at_1725[0]["orders"] == [4.0, 8.0] and at_1725[0]["order"] == 4.0
    assert "order 4 meets 115 Hz and order 8 meets 230 Hz" in at_1725[0]["reason"]
    assert all(not (low < 1725.0 < high) for low, high in ends(verdicts.free))


def test_the_range_is_the_half_power_width_and_the_interval_and_no_flank_is_free():
    modes = [mode(100.0, 0.02)]
    orders = [agreed(4.0, line(4.0, resonant(4.0, SPEEDS_RPM, modes)))]
    verdicts = judge(orders, fit(*modes, unseen=seen_everything(4.0)))
    (record,) = verdicts.avoid
    interval = 1500.0 * np.hypot(0.02 / 100.0, 1e-4 / 4.0) * 1.96
    assert record.rpm_range == pytest.approx((1500 - 30 - interval, 1500 + 30 + interval), abs=0.01)
    (before, after) = ends(verdicts.free)
    assert before[0] == 600.0 and after[1] == 2000.0
    # an undamped oscillator is amplified three times at these shares of its frequency
    assert before[1] == pytest.approx(1500.0 * np.sqrt(3.0 / 4.0), rel=0.01)
    assert after[0] == pytest.approx(1500.0 * np.sqrt(3.0 / 2.0), rel=0.01)


def test_the_flank_of_a_crossing_outside_the_tested_range_is_not_free():
    """Order 4 meets 138 Hz at 2070 rpm, beyond 2000: amplified three times from 1793 on."""
    modes = [mode(138.0, 0.01)]
    orders = [agreed(4.0, line(4.0, resonant(4.0, SPEEDS_RPM, modes)))]
    verdicts = judge(orders, fit(*modes, unseen=seen_everything(4.0)))
    (band,) = ends(verdicts.free)
    assert band[0] == RANGE[0] and band[1] == pytest.approx(2070.0 * np.sqrt(3.0 / 4.0), rel=0.01)


def test_the_flanks_of_a_mode_that_adds_much_to_little_are_not_free():
    """What remains without the mode is as small as the structure makes it: no resonance of its own limits flanks."""
    share, modal = 4.0, fit(mode(100.0, 0.02), unseen=seen_everything(4.0))
    modal = replace(modal, responses=(made_response(4.0, modal, smooth=1.0, residue=[-share]),))
    orders = [agreed(4.0, line(4.0, np.ones(len(SPEEDS_RPM))))]
    rpm = np.linspace(*RANGE, 4001)
    x = 4.0 * rpm / 60.0 / 100.0
    dangerous = rpm[np.abs(1.0 + share * x**2 / (1.0 - x**2 + 0.04j * x)) > 3.0]
    free = ends(judge(orders, modal).free)
    assert free and not any(((dangerous > low * 1.005) & (dangerous < high * 0.995)).any() for low, high in free)


def test_the_highest_peak_in_any_channel_ranks_first():
    modes = [mode(60.0), mode(100.0)]
    orders = [agreed(k, line(k, size * resonant(k, SPEEDS_RPM, modes))) for k, size in ((3.0, 0.1), (4.0, 1.0))]
    orders.append(agreed(1.0, line(1.0, 1000.0 * SPEEDS_RPM / 1000, channel="pressure")))
    records = [speed.as_dict() for speed in judge(orders, fit(*modes)).avoid]
    assert [record["rank"] for record in records] == list(range(1, len(records) + 1))
    assert records[0]["order"] == 4.0 and records[0]["channel"] == "A"
    for key in ("cost", "amplitude"):
        values = [record[key] for record in records]
        assert values == sorted(values, reverse=True)


def test_the_amplification_beside_a_peak_is_that_of_its_channel_and_never_below_what_makes_it_one():
    """Order 4 in two channels by a mode between two tested speeds, whose rows hardly show it."""
    strong, damping = 0.5, 0.008
    between, residue = replace(mode(105.0, damping), damping_error=1e-4), {"A": 0.02, "B": strong}
    alone = fit(between)
    responses = [made_response(4.0, alone, smooth=1.0, residue=(one,), channel=name) for name, one in residue.items()]
    rows = [held_amplitudes(one, SPEEDS_RPM, alone)[0] for one in responses]
    lines = [line(4.0, row, channel=name, error=1e-3) for name, row in zip(residue, rows, strict=True)]
    orders, modal = [agreed(4.0, *lines)], fit(between, responses=tuple(responses))
    found = crossings(tuple(orders), modal, speed_rpm=RANGE, settings=IDENTIFY)
    verdicts = judge(orders, modal)
    (item,) = verdicts.avoid
    truth = np.hypot(1.0, strong / (2.0 * damping))
    assert item.channel == "B" and not item.at_least
    assert item.amplification == pytest.approx(truth, rel=1e-3)
    low, high = item.amplification_ci95
    assert IDENTIFY.free_amplification < low < truth < high
    (met,) = as_avoided(found, verdicts.avoid)
    assert (met.amplification, met.amplification_ci95) == (item.amplification, item.amplification_ci95)
    assert "B" in met.channels and met.evidence.startswith("in B, where it is largest")


def test_a_peak_that_the_fit_does_not_know_is_at_least_what_was_measured():
    modes = [replace(mode(100.0, 1e-5), damping_error=1e-5)]
    seen = line(4.0, resonant(4.0, SPEEDS_RPM, [mode(100.0)]))
    response = made_response(4.0, fit(*modes), smooth=1.0, residue=(1.0,))
    (item,) = judge([agreed(4.0, seen)], fit(*modes, responses=(response,))).avoid
    assert item.at_least and item.amplitude == pytest.approx(seen.amplitude.max())
    known = [replace(mode(100.0), damping_error=1e-4)]
    response = made_response(4.0, fit(*known), smooth=1.0, residue=(1.0,))
    (item,) = judge([agreed(4.0, seen)], fit(*known, responses=(response,))).avoid
    assert not item.at_least
    vague = replace(response, covariance=np.diag([0.0, 1.0]).astype(complex))
    assert all(one.at_least for one in judge([agreed(4.0, seen)], fit(*known, responses=(vague,))).avoid)


def test_an_excited_crossing_at_which_the_order_was_not_measured_is_to_be_avoided_at_an_unknown_size():
    """As in a firing engine's campaign: a mode shown by other orders, an order that does not stand out there."""
    speeds = np.arange(1500.0, 2000.1, 50.0)
    orders, modal = [agreed(4.0, line(4.0, 1.0, speed_rpm=speeds))], fit(mode(60.0))
    (met,) = crossings(tuple(orders), modal, speed_rpm=RANGE, settings=IDENTIFY)
    finding = replace(
        met.finding, verdict="excited", excited=True, amplification_predicted=5.0, amplification_ci95=None
    )
    shown = replace(met, finding=finding, trends=())
    (speed,) = speeds_to_avoid([shown], tuple(orders), modal, speed_rpm=RANGE, unit=UNIT, settings=IDENTIFY).avoid
    assert speed.amplitude is None and speed.amplification is None and not speed.at_least
    assert speed.rpm_range[0] < 900.0 < speed.rpm_range[1]


def test_a_mode_in_doubt_at_which_an_order_peaks_is_to_be_avoided_and_called_what_it_is():
    modes = [mode(100.0, undecided="a tone or a mode")]
    verdicts = judge([agreed(4.0, line(4.0, resonant(4.0, SPEEDS_RPM, modes)))], fit(*modes))
    assert verdicts.avoid[0].rpm == pytest.approx(1500.0)
    assert "may be a natural frequency" in verdicts.avoid[0].reason


@pytest.mark.parametrize("doubt", ["", "a tone or a mode"])
def test_a_crossing_that_nobody_could_judge_is_open_with_its_verdict(doubt):
    orders = [agreed(4.0, line(4.0, (SPEEDS_RPM / 1000) ** 2))]
    narrow = mode(105.0, 0.0005, undecided=doubt)  # at 1575 rpm, 1.6 rpm wide between 1550 and 1600
    verdicts = judge(orders, fit(narrow, unseen=seen_everything(4.0)))
    assert verdicts.avoid == ()
    (band,) = verdicts.open
    assert band.low_rpm < 1575.0 * 0.97 + 1.0 and band.high_rpm > 1575.0 * 1.03 - 1.0
    assert band.remark == f"order 4 with 105 Hz: {'undecided mode' if doubt else 'not measured'}"
    assert ends(verdicts.free) == [(600.0, band.low_rpm), (band.high_rpm, 2000.0)]


def test_nothing_is_free_where_a_mode_that_nobody_saw_could_amplify():
    orders = [agreed(4.0, line(4.0, (SPEEDS_RPM / 1000) ** 2))]
    most = np.where((SPEEDS_RPM > 900.0) & (SPEEDS_RPM < 1200.0), 17.0, 1.0)
    verdicts = judge(orders, fit(unseen=(UnseenBound(4.0, SPEEDS_RPM, most),)))
    assert ends(verdicts.free) == [(600.0, 900.0), (1200.0, 2000.0)]
    (band,) = verdicts.open
    assert ends([band]) == [(900.0, 1200.0)]
    assert band.remark == "not tested between: order 4 could be amplified more than 3 times unseen"
    assert all("(99 %)" in free.remark and "3 times" in free.remark for free in verdicts.free)


def test_an_order_of_which_nothing_is_known_leaves_all_speeds_open():
    orders = [agreed(4.0), agreed(7.0)]
    verdicts = judge(orders, fit(unseen=seen_everything(4.0)))
    assert verdicts.free == () and ends(verdicts.open) == [RANGE]
    assert verdicts.open[0].remark.startswith("order 7: measured at too few speeds")
    assert judge([], fit()).open[0].remark == "no order stands out"


def test_speeds_beyond_those_of_an_order_are_not_free():
    seen = UnseenBound(4.0, np.linspace(900.0, 1500.0, 30), np.ones(30))
    verdicts = judge([agreed(4.0)], fit(unseen=(seen,)))
    assert all(low >= 900.0 and high <= 1500.0 for low, high in ends(verdicts.free)), ends(verdicts.free)


def test_a_stated_gear_mesh_that_does_not_stand_out_leaves_its_crossing_open():
    verdicts = judge([agreed(1.0)], fit(mode(700.0), unseen=seen_everything(1.0)), stated=[37.0])
    at = 60.0 * 700.0 / 37.0
    assert [band.remark for band in verdicts.open] == ["order 37 with 700 Hz: not measured"]
    assert verdicts.open[0].low_rpm < at < verdicts.open[0].high_rpm


def test_a_test_of_unknown_speed_says_nothing_and_one_at_one_speed_has_no_free_band():
    unknown = speeds_to_avoid([], (), fit(), speed_rpm=(np.nan, np.nan), unit=UNIT, settings=IDENTIFY)
    assert unknown == SpeedVerdicts((), (), ())
    speed = np.array([1500.0])
    one = agreed(4.0, line(4.0, 2.0, speed_rpm=speed))
    assert judge([one], fit(mode(100.0)), speed_rpm=(1500.0, 1500.0)).free == ()
    assert judge([one], fit(), speed_rpm=(1500.0, 1500.0)).free == ()


def test_free_and_open_bands_and_speeds_to_avoid_cover_the_tested_range():
    for seed in range(2):
        machine = drawn_machine(seed, n_modes=(1, 2), n_orders=(2, 3))
        verdicts = judged(machine, seed)[2]
        covered = [*ends(verdicts.free), *ends(verdicts.open), *(item.rpm_range for item in verdicts.avoid)]
        at = np.linspace(machine.speed_rpm.min() + 0.5, machine.speed_rpm.max() - 0.5, 400)
        beside = [(item.rpm * 0.96, item.rpm * 1.04) for item in verdicts.avoid]  # not free, and named by what they are
        assert all(any(low <= rpm <= high for low, high in [*covered, *beside]) for rpm in at)
        assert not any(f[0] < o[1] and o[0] < f[1] for f in ends(verdicts.free) for o in ends(verdicts.open))


# An order that towers over the speeds beside is a speed to avoid, though no natural frequency was found there.


def _peaks(sizes, avoided=(), **channels):
    lines = [line(4.0, share * sizes, channel=name) for name, share in (channels or {"A": 1.0}).items()]
    orders = [agreed(4.0, *lines)]
    return lone_peaks(orders, fit(), avoided, Sizes.of(orders, {"A": "m/s²", "B": "m/s²"}), factor=3.0)


def test_one_speed_that_towers_over_its_neighbours_is_to_be_avoided():
    sizes = np.ones(len(SPEEDS_RPM))
    at, times = len(sizes) // 2, 3.5
    sizes[at] = times
    (found,) = _peaks(sizes, A=1.0, B=2.0)
    assert found.rpm == SPEEDS_RPM[at] and found.channel == "B" and found.amplitude == pytest.approx(2.0 * times)
    assert SPEEDS_RPM[at - 1] < found.rpm_range[0] < found.rpm < found.rpm_range[1] < SPEEDS_RPM[at + 1]
    assert "may be a natural frequency" in found.reason
    assert not _peaks(sizes, (found,))


def test_a_resonance_that_the_speeds_resolve_is_one_peak():
    assert len(_peaks(resonant(4.0, SPEEDS_RPM, [mode(100.0, 0.01)]))) == 1
