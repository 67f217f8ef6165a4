"""Orders that meet natural frequencies: where, with which interval, and whether they are excited."""

import json

import numpy as np
import pytest

from crankorder.identify.crossings import amplification, crossings
from crankorder.identify.modes.responses import held_amplitudes, shapes
from made.found_lines import SPEEDS_RPM, agreed, fit, fitted_response, line, made_response, mode, resonant
from made.shipped import IDENTIFY

RANGE = (600.0, 2000.0)


def table(orders, modal, *, speed_rpm=RANGE, stated=()):
    found = crossings(tuple(orders), modal, speed_rpm=speed_rpm, settings=IDENTIFY, stated=stated)
    return {(crossing.finding.order, crossing.finding.mode_hz): crossing.finding for crossing in found}


def test_the_table_of_the_thesis_is_that_of_the_truth_sheet():
    frequencies = (60.0, 115.0, 172.0, 187.0, 230.0, 350.0, 457.0, 470.0)
    speeds = np.arange(300.0, 2001.0, 50.0)
    orders = [agreed(k, line(k, speed_rpm=speeds)) for k in (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.5, 8.0, 10.0)]
    found = table(orders, fit(*map(mode, frequencies)), speed_rpm=(300.0, 2000.0))
    assert len(found) == 72
    inside: dict[float, list[float]] = {}
    for (order, _), record in found.items():
        if record.in_range:
            inside.setdefault(order, []).append(round(record.rpm, 2))
    assert inside == {  # truth sheet 2.8
        2.0: [1800.0],
        3.0: [1200.0],
        4.0: [900.0, 1725.0],
        5.5: [654.55, 1254.55, 1876.36],
        8.0: [450.0, 862.5, 1290.0, 1402.5, 1725.0],
        10.0: [360.0, 690.0, 1032.0, 1122.0, 1380.0],
    }


def test_the_speed_has_the_errors_of_the_mode_and_of_the_order():
    record = table([agreed(5.48, error=0.01)], fit(mode(115.0)))[5.48, 115.0]
    rpm = 60 * 115.0 / 5.48
    error = rpm * np.hypot(0.02 / 115.0, 0.01 / 5.48)
    assert record.rpm == pytest.approx(rpm)
    # the order's error has 30 degrees of freedom and makes nearly all of it: 2.042
    assert record.rpm_ci95[1] - rpm == pytest.approx(2.042 * error, rel=0.002)


def test_an_order_through_a_mode_is_excited_and_one_that_grows_evenly_is_not():
    modes = [mode(100.0)]
    orders = [
        agreed(4.0, line(4.0, resonant(4.0, SPEEDS_RPM, modes))),
        agreed(5.0, line(5.0, (SPEEDS_RPM / 1000) ** 2)),
    ]
    found = table(orders, fit(*modes))
    assert found[4.0, 100.0].excited and found[4.0, 100.0].verdict == "excited"
    assert not found[5.0, 100.0].excited and found[5.0, 100.0].verdict == "not excited"
    low, high = found[5.0, 100.0].amplification_ci95
    assert low < 1.0 < high < 1.1


def test_the_interval_of_the_amplification_holds_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(7)
    made, hits = 400, 0
    for _ in range(made):
        true = (SPEEDS_RPM / 1000) ** 2 * np.where(SPEEDS_RPM == 1500.0, 3.0, 1.0)
        shown = true * np.exp(0.2 * rng.standard_normal(SPEEDS_RPM.size))
        shown = np.abs(shown + 0.03 * rng.standard_normal(SPEEDS_RPM.size))
        record = table([agreed(4.0, line(4.0, shown, error=0.03))], fit(mode(100.0)))[4.0, 100.0]
        hits += record.amplification_ci95[0] <= 3.0 <= record.amplification_ci95[1]
    # 95 %, and 4 standard deviations of 400 trials either way; measured 94.8 to 96.8 %
    assert 0.906 < hits / made < 0.99


def test_of_crossings_without_any_mode_at_work_few_are_called_excited():
    rng = np.random.default_rng(8)
    modal = fit(mode(60.0), mode(100.0), mode(120.0))
    false = 0
    for _ in range(60):
        noise = 1 + 0.05 * rng.standard_normal((3, SPEEDS_RPM.size))
        lines = [line(4.0, (SPEEDS_RPM / 1000) ** 2 * row, channel=c) for c, row in zip("ABC", noise, strict=True)]
        false += any(record.excited for record in table([agreed(4.0, *lines)], modal).values())
    assert false <= 9  # 3 expected at a false discovery rate of 5 %; more than 9 has a chance of 1e-3


def test_a_resonance_between_two_tested_speeds_is_not_measured_rather_than_not_excited():
    narrow = mode(105.0, 0.0005)  # at 1575 rpm; half-power width 1.6 rpm, tested speeds 1550 and 1600
    record = table([agreed(4.0, line(4.0, (SPEEDS_RPM / 1000) ** 2))], fit(narrow))[4.0, 105.0]
    assert record.verdict == "not measured" and not record.excited
    coarse = np.arange(650.0, 2001.0, 200.0)
    record = table([agreed(4.0, line(4.0, (coarse / 1000) ** 2, speed_rpm=coarse))], fit(narrow))[4.0, 105.0]
    assert record.amplification is None and record.amplification_ci95 is None
    assert record.evidence == "no speed near enough was tested"


def test_an_order_that_hides_in_the_floor_at_the_crossing_decides_nothing():
    away = SPEEDS_RPM[np.abs(SPEEDS_RPM - 1500.0) > 60.0]
    orders = [agreed(4.0, line(4.0, speed_rpm=away)), agreed(1.0)]
    record = table(orders, fit(mode(100.0)))[4.0, 100.0]
    assert record.verdict == "not decided" and "does not stand over the floor at 1500 rpm" in record.evidence


def test_an_order_that_only_a_resonance_lifts_over_the_floor_has_no_trend_to_acquit_another():
    lifted = SPEEDS_RPM[SPEEDS_RPM >= 1300.0]  # falling off from a peak at 1300 rpm and hidden below 1300 rpm
    hidden = line(4.0, (1300.0 / lifted) ** 4, speed_rpm=lifted)
    record = table([agreed(4.0, hidden), agreed(1.0)], fit(mode(100.0)))[4.0, 100.0]
    assert record.amplification == pytest.approx(1.0) and record.verdict == "not decided"


def test_a_crossing_outside_the_tested_range_is_only_listed():
    record = table([agreed(2.0)], fit(mode(100.0)))[2.0, 100.0]
    assert not record.in_range and not record.excited
    assert record.verdict == "outside the tested range" and record.amplification is None
    assert record.evidence.startswith("extrapolated")
    assert record.amplification_predicted == pytest.approx(1 / 0.03)


def test_an_order_may_be_excited_by_a_line_that_may_be_no_mode_and_the_remark_stays():
    modes = [mode(100.0, undecided="may be the fifth harmonic of 20 Hz")]
    record = table([agreed(4.0, line(4.0, resonant(4.0, SPEEDS_RPM, modes)))], fit(*modes))[4.0, 100.0]
    assert record.excited and record.remark.startswith("may be")
    record = table([agreed(4.0, line(4.0, (SPEEDS_RPM / 1000) ** 2))], fit(*modes))[4.0, 100.0]
    assert not record.excited and record.verdict == "undecided mode" and record.remark.startswith("may be")


def test_a_stated_gear_mesh_above_order_twenty_is_crossed_whether_or_not_it_was_seen():
    modal = fit(mode(700.0), mode(3000.0))
    unseen = table([agreed(1.0)], modal, stated=[37.0])
    assert unseen[37.0, 700.0].rpm == pytest.approx(60.0 * 700.0 / 37.0)
    assert unseen[37.0, 700.0].verdict == "not measured" and unseen[37.0, 700.0].in_range
    assert "does not stand out" in unseen[37.0, 700.0].evidence
    assert unseen[37.0, 3000.0].verdict == "outside the tested range"
    found = table([agreed(37.0001, line(37.0001, resonant(37.0, SPEEDS_RPM, modal.modes)))], modal, stated=[37.0])
    assert [key for key in found if key[1] == 700.0] == [(37.0001, 700.0)]  # the line that was found is the stated one
    assert found[37.0001, 700.0].excited


def fitted(amplitude, modal):
    """OrderResponse by the fit of a block of the complex ``amplitude``, and the line that it was fitted to."""
    return fitted_response(4.0, SPEEDS_RPM, amplitude, modal, error=0.02), line(4.0, np.abs(amplitude), error=0.02)


def noise(rng, size):
    return size * (rng.standard_normal(SPEEDS_RPM.size) + 1j * rng.standard_normal(SPEEDS_RPM.size))


def test_the_residue_of_a_fit_proves_a_mode_that_too_few_speeds_beside_it_could_not():
    modal = fit(mode(100.0, 0.05))
    truth = made_response(4.0, modal, smooth=0.3, residue=(0.2,))
    scale = (SPEEDS_RPM / 1000.0) ** 2
    clean = scale * (0.3 + 0.2 * shapes(4.0 * SPEEDS_RPM / 60, modal)[:, 0])
    response, seen = fitted(clean + noise(np.random.default_rng(1), 0.02), modal)
    record = table([agreed(4.0, seen)], fit(mode(100.0, 0.05), responses=(response,)))[4.0, 100.0]
    # at its natural frequency the mode alone makes 0.2 / (2 · 0.05) = 2, in quadrature to 0.3
    assert amplification(truth, 0, modal) == pytest.approx(np.hypot(0.3, 2.0) / 0.3)
    assert held_amplitudes(truth, np.array([1500.0]), modal)[0][0] == pytest.approx(1.5**2 * np.hypot(0.3, 2.0))
    assert record.excited and record.predicted_from == "fit"
    assert record.amplification_predicted == pytest.approx(np.hypot(0.3, 2.0) / 0.3, rel=0.05)


def test_a_residue_fitted_to_noise_proves_no_mode():
    rng, modal, false = np.random.default_rng(3), fit(mode(100.0)), 0
    for _ in range(60):
        response, seen = fitted((SPEEDS_RPM / 1000.0) ** 2 + noise(rng, 0.02), modal)
        false += table([agreed(4.0, seen)], fit(mode(100.0), responses=(response,)))[4.0, 100.0].excited
    assert false <= 9  # 3 expected; more than 9 has a chance of 1e-3


def test_without_a_known_speed_nothing_meets():
    assert crossings((agreed(4.0),), fit(mode(100.0)), speed_rpm=(np.nan, np.nan), settings=IDENTIFY) == ()


def test_amplitudes_of_nothing_and_without_an_error_take_no_part():
    size = (SPEEDS_RPM / 1000) ** 2
    holed = line(4.0, np.where(SPEEDS_RPM == 1200.0, 0.0, size))
    holed.amplitude_error[3] = np.nan
    record = table([agreed(4.0, holed)], fit(mode(100.0)))[4.0, 100.0]
    assert record.amplification == pytest.approx(1.0)
    silent = table([agreed(4.0, line(4.0, 0.0 * size))], fit(mode(100.0)))[4.0, 100.0]
    assert silent.amplification is None and not silent.excited


def test_every_number_of_a_record_can_be_written():
    rng = np.random.default_rng(6)
    modal = fit(mode(100.0), mode(40.0))
    for n in (1, 2, 3, 4, 6):
        speeds = np.sort(rng.uniform(600.0, 2000.0, n))
        lines = [line(4.0, rng.uniform(0.1, 10.0, n), speed_rpm=speeds, error=1.0)]
        records = [record.as_dict() for record in table([agreed(4.0, *lines)], modal, stated=[37.0]).values()]
        assert len(records) == 4
        assert json.loads(json.dumps(records, allow_nan=False))
