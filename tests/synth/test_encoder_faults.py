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
from crankorder.synth.parts import AnyEncoderFault, DamagedLine, DoublePulses, Encoder, LostPulses

RATE_HZ = 50_000.0
SHAFT = load_settings().shaft
RUN_UP = Motion(start_rev=0.321, corners=((0.5, 900.0), (4.5, 1800.0)))
ENCODER = Encoder(pulses_per_rev=60)


def signals(encoder: Encoder, faults: Sequence[AnyEncoderFault], *, recording: str = "made") -> EncoderSignals:
    return encoder_signals(
        RUN_UP, encoder, faults, seed=3, recording=recording, stream=recording, rate_hz=RATE_HZ, n_samples=250_000
    )


def numbered(made: EncoderSignals, encoder: Encoder) -> NumberedTeeth:
    how: dict[str, Any] = {"rate_hz": RATE_HZ, "kind": "square", "edge": "rising", "settings": SHAFT}
    pulses = find_pulses(made.trace, pulses_per_rev=encoder.pulses_per_rev, **how)
    index_s = None if made.index is None else find_pulses(made.index, pulses_per_rev=1, **how).time_s
    return number_teeth(
        pulses.time_s,
        pulses_per_rev=encoder.pulses_per_rev,
        missing_teeth=encoder.missing_teeth,
        index_time_s=index_s,
        noise_s=pulses.noise_s,
        settings=SHAFT,
    )


def found(made: EncoderSignals, encoder: Encoder) -> dict[str, str]:
    """Flag and detail of everything that the decoder remarks on."""
    return {flag: detail for flag, _, detail in numbered(made, encoder).flags}


def only_record(made: EncoderSignals, flag: str) -> Record:
    (record,) = made.records
    assert (record["recording"], record["flag"], record["severity"]) == ("made", flag, "suspect")
    return record


@pytest.mark.parametrize("wheel", [{}, {"missing_teeth": 2, "index": False}], ids=["60", "60-2"])
def test_lost_pulses_are_found_by_number_and_tooth(wheel: dict[str, Any]) -> None:
    encoder = ENCODER.model_copy(update=wheel)
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


def test_a_damaged_line_is_found_at_its_angle() -> None:
    made = signals(ENCODER, [DamagedLine(kind="damaged_line", lines=(13, 70))])
    record = only_record(made, "encoder_damaged_line")
    assert (record["lines"], record["angles_deg"]) == ([13], [78.0])
    remarks = found(made, ENCODER)
    assert set(remarks) == {"encoder_missing_pulse", "encoder_damaged_line"}
    assert remarks["encoder_missing_pulse"].startswith(f"{record['count']} lost pulses")
    angle_deg = float(remarks["encoder_damaged_line"].split(" at ")[1].split()[0].rstrip(","))
    assert angle_deg == pytest.approx(78.0, abs=0.15)


@pytest.mark.cases(1)
@pytest.mark.parametrize("delay_s", [2e-4, 3e-4])
def test_double_pulses_are_found_and_removed(delay_s: float) -> None:
    made = signals(ENCODER, [DoublePulses(kind="double_pulses", count=12, delay_s=delay_s)])
    record = only_record(made, "encoder_double_pulse")
    assert record["count"] == len(record["times_s"]) == 12
    remarks = found(made, ENCODER)
    assert set(remarks) == {"encoder_double_pulse"}
    assert remarks["encoder_double_pulse"].startswith("12 false pulses")
    teeth = numbered(made, ENCODER)
    crank_rev = RUN_UP.at(teeth.time_s)[0] - teeth.tooth / 60
    assert np.ptp(crank_rev) * 360 < 0.25


def test_faults_act_on_their_recordings_only_and_one_changes_no_other() -> None:
    lost = LostPulses(kind="lost_pulses", count=5, recordings=("a", "b"))
    double = DoublePulses(kind="double_pulses", count=5)
    in_a, in_b = (signals(ENCODER, [lost], recording=name).records[0]["times_s"] for name in ("a", "b"))
    assert in_a != in_b
    assert signals(ENCODER, [lost], recording="c").records == []
    np.testing.assert_array_equal(signals(ENCODER, [lost], recording="c").trace, signals(ENCODER, []).trace)
    both = signals(ENCODER, [lost, double], recording="a").records
    assert [record["flag"] for record in both] == ["encoder_missing_pulse", "encoder_double_pulse"]
    assert both[0]["times_s"] == in_a
