"""Faults of the encoder: what was put in is what the decoder of the analysis finds, in number and place."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from crankorder.settings import load_settings
from crankorder.shaft.pulses import find_pulses
from crankorder.shaft.wheel import NumberedTeeth, number_teeth
from crankorder.synth.encoder import EncoderSignals, Record, encoder_signals
from crankorder.synth.motion import Motion
from crankorder.synth.parts import (
    AnyEncoderFault,
    DamagedLine,
    DoublePulses,
    Encoder,
    EncoderDropout,
    ExtraIndex,
    IndexSlip,
    LostIndex,
    LostPulses,
)

RATE_HZ = 50_000.0
SHAFT = load_settings().shaft
RUN_UP = Motion(start_rev=0.321, corners=((0.5, 900.0), (4.5, 1800.0)))
FORMS = ["square", "analogue", "pulse_times"]


def signals(encoder: Encoder, faults: Sequence[AnyEncoderFault], *, recording: str = "made") -> EncoderSignals:
    return encoder_signals(
        RUN_UP, encoder, faults, seed=3, recording=recording, stream=recording, rate_hz=RATE_HZ, n_samples=250_000
    )


def numbered(made: EncoderSignals, encoder: Encoder) -> NumberedTeeth:
    pulse_s, index_s, noise_s = made.pulse_s, made.index_s, 0.0
    if made.trace is not None:
        kind = "square" if encoder.delivered_as == "square" else "analogue"
        how: dict[str, Any] = {"rate_hz": RATE_HZ, "kind": kind, "edge": "rising", "settings": SHAFT}
        pulses = find_pulses(made.trace, pulses_per_rev=encoder.pulses_per_rev, **how)
        pulse_s, noise_s = pulses.time_s, pulses.noise_s
        index_s = None if made.index is None else find_pulses(made.index, pulses_per_rev=1, **how).time_s
    assert pulse_s is not None
    return number_teeth(
        pulse_s,
        pulses_per_rev=encoder.pulses_per_rev,
        missing_teeth=encoder.missing_teeth,
        index_time_s=index_s,
        noise_s=noise_s,
        settings=SHAFT,
    )


def of_form(form: str, **keys: Any) -> Encoder:
    return Encoder.model_validate({"pulses_per_rev": 60, "delivered_as": form, **keys})


def found(made: EncoderSignals, encoder: Encoder) -> dict[str, str]:
    """Flag and detail of everything that the decoder remarks on."""
    return {flag: detail for flag, _, detail in numbered(made, encoder).flags}


def only_record(made: EncoderSignals, flag: str) -> Record:
    (record,) = made.records
    assert (record["recording"], record["flag"], record["severity"]) == ("made", flag, "suspect")
    return record


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("wheel", [{}, {"missing_teeth": 2, "index": False}], ids=["60", "60-2"])
def test_lost_pulses_are_found_by_number_and_tooth(form: str, wheel: dict[str, Any]) -> None:
    encoder = of_form(form, **wheel)
    made = signals(encoder, [LostPulses(kind="lost_pulses", count=7)])
    record = only_record(made, "encoder_missing_pulse")
    assert record["count"] == len(record["times_s"]) == len(record["lines"]) == 7
    teeth = numbered(made, encoder)
    assert [flag for flag, _, _ in teeth.flags] == ["encoder_missing_pulse"]
    assert teeth.flags[0][2].startswith("7 lost pulses")
    assert teeth.n_repaired == 7
    lost = np.setdiff1d(np.arange(teeth.tooth[0], teeth.tooth[-1]), teeth.tooth)
    places = np.rint(lost - teeth.index_tooth).astype(int) % 60
    np.testing.assert_array_equal(places[places < 60 - encoder.missing_teeth], record["lines"])


@pytest.mark.cases(1)
@pytest.mark.parametrize("form", FORMS)
def test_a_damaged_line_is_found_at_its_angle(form: str) -> None:
    encoder = of_form(form)
    made = signals(encoder, [DamagedLine(kind="damaged_line", lines=(13, 70))])
    record = only_record(made, "encoder_damaged_line")
    assert (record["lines"], record["angles_deg"]) == ([13], [78.0])
    remarks = found(made, encoder)
    assert set(remarks) == {"encoder_missing_pulse", "encoder_damaged_line"}
    assert remarks["encoder_missing_pulse"].startswith(f"{record['count']} lost pulses")
    angle_deg = float(remarks["encoder_damaged_line"].split(" at ")[1].split()[0].rstrip(","))
    assert angle_deg == pytest.approx(78.0, abs=0.15)


@pytest.mark.cases(1)
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("delay_s", [2e-4, 3e-4])
def test_double_pulses_are_found_and_removed(form: str, delay_s: float) -> None:
    encoder = of_form(form)
    made = signals(encoder, [DoublePulses(kind="double_pulses", count=12, delay_s=delay_s)])
    record = only_record(made, "encoder_double_pulse")
    assert record["count"] == len(record["times_s"]) == 12
    remarks = found(made, encoder)
    assert set(remarks) == {"encoder_double_pulse"}
    assert remarks["encoder_double_pulse"].startswith("12 false pulses")
    teeth = numbered(made, encoder)
    crank_rev = RUN_UP.at(teeth.time_s)[0] - teeth.tooth / 60
    assert np.ptp(crank_rev) * 360 < 0.25


@pytest.mark.cases(1)
@pytest.mark.parametrize("form", FORMS)
def test_lost_and_false_index_marks_are_counted(form: str) -> None:
    encoder = of_form(form)
    lost = signals(encoder, [LostIndex(kind="lost_index", count=3)])
    assert only_record(lost, "index_lost")["count"] == 3
    remarks = found(lost, encoder)
    assert set(remarks) == {"index_lost"}
    assert remarks["index_lost"].startswith("3 index marks")
    extra = signals(encoder, [ExtraIndex(kind="extra_index", count=4)])
    assert only_record(extra, "index_extra")["count"] == 4
    remarks = found(extra, encoder)
    assert set(remarks) == {"index_extra"}
    assert remarks["index_extra"].startswith("4 index marks")


@pytest.mark.cases(1)
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("pulses", [3, -3])
def test_an_index_that_slips_is_found_from_its_time_on(form: str, pulses: int) -> None:
    made = signals(of_form(form), [IndexSlip(kind="index_slip", at_s=2.0, pulses=pulses)])
    record = only_record(made, "encoder_slip")
    assert 2.0 - 0.01 <= record["times_s"][0] < 2.1
    assert "encoder_slip" in found(made, of_form(form))


@pytest.mark.cases(1)
@pytest.mark.parametrize("form", FORMS)
def test_a_short_dropout_loses_its_pulses_and_no_others(form: str) -> None:
    encoder = of_form(form)
    made = signals(encoder, [EncoderDropout(kind="encoder_dropout", at_s=2.0, duration_s=0.004)])
    record = only_record(made, "encoder_missing_pulse")
    assert record["times_s"] == [2.0, 2.004]
    true_s = signals(of_form("pulse_times"), []).pulse_s
    assert true_s is not None
    assert abs(record["count"] - np.sum((true_s >= 2.0) & (true_s < 2.004))) <= 1
    remarks = found(made, encoder)
    assert set(remarks) == {"encoder_missing_pulse"}
    assert remarks["encoder_missing_pulse"].startswith(f"{record['count']} lost pulses")


@pytest.mark.slow
@pytest.mark.parametrize("at_s", [2.0, 2.0002, 2.0004, 2.0006])
@pytest.mark.parametrize("form", ["square", "analogue"])
def test_in_a_dropout_the_level_stays(form: str, at_s: float) -> None:
    made = signals(of_form(form), [EncoderDropout(kind="encoder_dropout", at_s=at_s, duration_s=0.2)])
    plain = signals(of_form(form), [])
    assert made.trace is not None and made.index is not None and plain.trace is not None
    first, end = int(np.ceil(at_s * RATE_HZ)), int((at_s + 0.2) * RATE_HZ)
    assert np.ptp(made.trace[first - 1 if form == "square" else first : end]) == 0
    assert np.ptp(made.index[first - 1 : end]) == 0
    np.testing.assert_array_equal(made.trace[:first], plain.trace[:first])
    np.testing.assert_array_equal(made.trace[end + 50 :], plain.trace[end + 50 :])
    record = only_record(made, "encoder_gap")
    assert record["count"] == pytest.approx(0.2 * RUN_UP.at(np.array([2.1]))[1][0], abs=2)


def test_faults_act_on_their_recordings_only_and_one_changes_no_other() -> None:
    lost = LostPulses(kind="lost_pulses", count=5, recordings=("a", "b"))
    double = DoublePulses(kind="double_pulses", count=5)
    encoder = of_form("pulse_times")
    in_a, in_b = (signals(encoder, [lost], recording=name).records[0]["times_s"] for name in ("a", "b"))
    assert in_a != in_b
    assert signals(encoder, [lost], recording="c").records == []
    np.testing.assert_array_equal(signals(encoder, [lost], recording="c").pulse_s, signals(encoder, []).pulse_s)
    both = signals(encoder, [lost, double], recording="a").records
    assert [record["flag"] for record in both] == ["encoder_missing_pulse", "encoder_double_pulse"]
    assert both[0]["times_s"] == in_a
