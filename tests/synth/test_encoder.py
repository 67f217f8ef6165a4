"""The encoder against the counts and angles that its motion implies, and as it is decoded."""

import numpy as np
import pytest

from crankorder.engine.torsional_fluctuation import Lag
from crankorder.quantities import flags_of
from crankorder.shaft.angle import angle_at, knots_of
from crankorder.shaft.decode import shaft_angle
from crankorder.shaft.pulses import find_pulses
from crankorder.synth.encoder import encoder_signals, encoder_turn, passed_pulses, wheel_of
from crankorder.synth.motion import Motion
from crankorder.synth.parts import DamagedLine, DoublePulses, Encoder, LostPulses
from made.recordings import sampled as recording_of
from made.shipped import SHAFT

RATE_HZ = 50_000.0
N_SAMPLES = 250_000
TIME_S = np.arange(N_SAMPLES) / RATE_HZ
RUN_UP = Motion(start_rev=0.321, corners=((0.5, 600.0), (4.5, 2500.0)))
WOBBLING = Motion(start_rev=0.777, corners=((0.0, 1200.0),), wobbles=((1.7, 30.0, 20.0), (0.6, 50.0, 0.0)))
THERE_AND_BACK = Motion(start_rev=0.321, corners=((0.5, 900.0), (2.5, -600.0), (3.0, -600.0), (4.0, 700.0)))
STOP = Motion(start_rev=0.3, corners=((1.0, 600.0), (2.0, 0.0)))
UNEVEN = Motion(
    start_rev=0.3,
    corners=((0.5, 700.0), (4.0, 2200.0)),
    lag=Lag(order=np.array([0.5, 2.0]), inertia=np.array([0, 0.002j]), gas=np.array([0.003, 0.002]), reference_rpm=1e3),
)


def signals(motion, encoder, faults=(), *, recording="made"):
    named = {"recording": recording, "stream": recording}
    return encoder_signals(motion, encoder, faults, seed=3, **named, rate_hz=RATE_HZ, n_samples=N_SAMPLES)


def decoded(made, encoder):
    """ShaftAngle as the pipeline makes it of these signals."""
    keys = ("pulses_per_rev", "missing_teeth", "ratio", "index_to_tdc_deg")
    attrs = {"encoder_kind": "square", "revs_per_cycle": 1, **{key: getattr(encoder, key) for key in keys}}
    recording = recording_of(np.zeros((1, N_SAMPLES)), rate_hz=RATE_HZ, **attrs)
    how = {"rate_hz": RATE_HZ, "kind": "square", "edge": "rising", "settings": SHAFT}
    pulses = find_pulses(made.trace, pulses_per_rev=encoder.pulses_per_rev, **how)
    recording["pulse_time"], recording.attrs["pulse_noise_s"] = ("pulse", pulses.time_s), pulses.noise_s
    if made.index is not None:
        recording["index_time"] = ("revolution", find_pulses(made.index, pulses_per_rev=1, **how).time_s)
    return shaft_angle(recording, settings=SHAFT)


@pytest.mark.parametrize(
    ("motion", "missing"),
    [(THERE_AND_BACK, 2), (UNEVEN, 2), (Motion(start_rev=1.73181, corners=((0.0, 1234.5),)), 0), (STOP, 0)],
    ids=["reversal", "in-cycle", "steady", "standstill"],
)
def test_the_level_is_a_function_of_angle_also_backwards(motion, missing):
    encoder = Encoder(pulses_per_rev=60, missing_teeth=missing, index_to_tdc_deg=10.0, ratio=2.0)
    made = signals(motion, encoder)
    place = encoder_turn(motion.at(TIME_S)[0], encoder) * 60
    np.testing.assert_array_equal(made.trace, 5 * ((np.floor(place) % 60 < 60 - missing) & (place % 1 < 0.5)))
    np.testing.assert_array_equal(made.index, place % 60 < 1)


@pytest.mark.parametrize(
    ("motion", "wheel"),
    [
        (RUN_UP, {"pulses_per_rev": 60, "ratio": 0.5, "index_to_tdc_deg": -37.0}),
        (WOBBLING, {"pulses_per_rev": 36, "missing_teeth": 1, "index": False, "index_to_tdc_deg": 84.0}),
        (UNEVEN, {"pulses_per_rev": 60, "index_to_tdc_deg": 137.0}),
    ],
    ids=["run-up", "wobble", "in-cycle"],
)
def test_the_decoder_finds_the_angle_from_top_dead_centre(motion, wheel):
    """At 2500 rpm one sample is 0.3°: marks that lie between samples are uncertain by half of that."""
    encoder = Encoder.model_validate(wheel)
    shaft = decoded(signals(motion, encoder), encoder)
    assert shaft.attrs["phase_reference"] == "tdc"
    time_s = np.linspace(0.05, 4.95, 20_001)
    error = angle_at(time_s, **knots_of(shaft)) - motion.at(time_s)[0]
    error = (error - np.round(np.median(error))) * 360
    assert np.abs(error).max() < 0.4
    assert np.abs(error.mean()) < 0.15


# Wheels line by line: where each pulse comes against the angle of the motion, and how the decoder numbers it.


TURNING = Motion(start_rev=0.321, corners=((0.5, 600.0), (4.5, 3000.0)), wobbles=((1.3, 40.0, 20.0),))


@pytest.mark.parametrize(("ratio", "off_deg"), [(0.5, 0.0), (2.0, 0.4), (1.0, 40.0)])
def test_every_line_of_a_wheel_comes_when_the_shaft_is_at_its_angle_also_of_an_eccentric_one(ratio, off_deg):
    encoder = Encoder(
        pulses_per_rev=60, ratio=ratio, index_to_tdc_deg=37.0, eccentricity_deg=off_deg, eccentricity_phase_deg=30.0
    )
    pulses = passed_pulses(wheel_of(encoder, seed=1), TURNING, encoder, duration_s=5.0)

    def place(time_s):
        turn = encoder_turn(TURNING.at(time_s)[0], encoder)
        return 60 * (turn + off_deg / 360 * np.sin(2 * np.pi * turn + np.pi / 6))

    inside = np.isfinite(pulses.rise_s)
    np.testing.assert_allclose(place(pulses.rise_s[inside]), pulses.number[inside], atol=1e-9)
    np.testing.assert_allclose(place(pulses.fall_s[np.isfinite(pulses.fall_s)]) % 1, 0.5, atol=1e-9)
    first, last = place(np.array([0.0, 5.0]))
    np.testing.assert_array_equal(pulses.number, np.arange(np.floor(first + 0.5), np.floor(last) + 1))


def test_errors_of_lines_are_those_of_the_wheel_and_have_their_spread():
    encoder = Encoder(pulses_per_rev=3600, line_error_deg=0.01)
    wheel, again, other = (wheel_of(encoder, seed=seed) for seed in (1, 1, 2))
    error_deg = (wheel.nominal - wheel.rise) * 360
    assert error_deg.std() == pytest.approx(0.01, rel=0.05)
    np.testing.assert_array_equal(wheel.rise, again.rise)
    assert np.abs(np.corrcoef(error_deg, (other.nominal - other.rise) * 360)[0, 1]) < 0.05


# Faults of the encoder: what was put in is what the decoder of the analysis finds, in number and place.


LONG_RUN = Motion(start_rev=0.321, corners=((0.5, 900.0), (4.5, 1800.0)))
ENCODER = Encoder(pulses_per_rev=60)


def faulty(encoder, faults, *, recording="made"):
    return signals(LONG_RUN, encoder, faults, recording=recording)


def remarks_on(made, encoder=ENCODER):
    """Flag and detail of everything that the decoder remarks on."""
    return {flag["flag"]: flag["detail"] for flag in flags_of(decoded(made, encoder))}


def only_record(made, flag):
    (record,) = made.records
    assert (record["recording"], record["flag"], record["severity"]) == ("made", flag, "suspect")
    return record


@pytest.mark.parametrize("wheel", [{}, {"missing_teeth": 2, "index": False}], ids=["60", "60-2"])
def test_lost_pulses_are_found_by_number_and_are_those_of_the_record(wheel):
    encoder = ENCODER.model_copy(update=wheel)
    made = faulty(encoder, [LostPulses(kind="lost_pulses", count=7)])
    record = only_record(made, "encoder_missing_pulse")
    assert record["count"] == len(record["times_s"]) == len(record["lines"]) == 7
    remarks = remarks_on(made, encoder)
    assert list(remarks) == ["encoder_missing_pulse"]
    assert remarks["encoder_missing_pulse"].startswith("7 lost pulses")
    place = encoder_turn(LONG_RUN.at(np.array(record["times_s"]))[0], encoder) * 60
    np.testing.assert_array_equal(np.rint(place) % 60, record["lines"])


def test_a_damaged_line_is_found_at_its_angle():
    made = faulty(ENCODER, [DamagedLine(kind="damaged_line", lines=(13, 70))])
    record = only_record(made, "encoder_damaged_line")
    assert (record["lines"], record["angles_deg"]) == ([13], [78.0])
    remarks = remarks_on(made)
    assert set(remarks) == {"encoder_missing_pulse", "encoder_damaged_line"}
    assert remarks["encoder_missing_pulse"].startswith(f"{record['count']} lost pulses")
    angle_deg = float(remarks["encoder_damaged_line"].split(" at ")[1].split()[0].rstrip(","))
    assert angle_deg == pytest.approx(78.0, abs=0.15)


def test_double_pulses_are_found_and_removed():
    made = faulty(ENCODER, [DoublePulses(kind="double_pulses", count=12, delay_s=2e-4)])
    record = only_record(made, "encoder_double_pulse")
    assert record["count"] == len(record["times_s"]) == 12
    remarks = remarks_on(made)
    assert set(remarks) == {"encoder_double_pulse"}
    assert remarks["encoder_double_pulse"].startswith("12 false pulses")


def test_faults_act_on_their_recordings_only_and_one_changes_no_other():
    lost = LostPulses(kind="lost_pulses", count=5, recordings=("a", "b"))
    double = DoublePulses(kind="double_pulses", count=5)
    in_a, in_b = (faulty(ENCODER, [lost], recording=name).records[0]["times_s"] for name in ("a", "b"))
    assert in_a != in_b
    assert faulty(ENCODER, [lost], recording="c").records == []
    np.testing.assert_array_equal(faulty(ENCODER, [lost], recording="c").trace, faulty(ENCODER, []).trace)
    both = faulty(ENCODER, [lost, double], recording="a").records
    assert [record["flag"] for record in both] == ["encoder_missing_pulse", "encoder_double_pulse"]
    assert both[0]["times_s"] == in_a
