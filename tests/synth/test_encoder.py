"""The encoder against the counts and angles that its motion implies, and as it is decoded."""

import numpy as np
import pytest
import xarray as xr

from crankorder.engine.torsional_fluctuation import Lag
from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_at, knots_of
from crankorder.shaft.decode import shaft_angle
from crankorder.shaft.pulses import find_pulses
from crankorder.synth.encoder import (
    EncoderSignals,
    encoder_signals,
    encoder_turn,
    index_wheel,
    passed_pulses,
    sampled_encoder,
    wheel_of,
)
from crankorder.synth.motion import Motion
from crankorder.synth.parts import Encoder
from made.recordings import sampled as recording_of

RATE_HZ = 50_000.0
N_SAMPLES = 250_000
TIME_S = np.arange(N_SAMPLES) / RATE_HZ
SHAFT = load_settings().shaft
RUN_UP = Motion(start_rev=0.321, corners=((0.5, 600.0), (4.5, 2500.0)))
WOBBLING = Motion(start_rev=0.777, corners=((0.0, 1200.0),), wobbles=((1.7, 30.0, 20.0), (0.6, 50.0, 0.0)))
THERE_AND_BACK = Motion(start_rev=0.321, corners=((0.5, 900.0), (2.5, -600.0), (3.0, -600.0), (4.0, 700.0)))
UNEVEN = Motion(
    start_rev=0.3,
    corners=((0.5, 700.0), (4.0, 2200.0)),
    lag=Lag(order=np.array([0.5, 2.0]), inertia=np.array([0, 0.002j]), gas=np.array([0.003, 0.002]), reference_rpm=1e3),
)


def sampled(start_rev: float, speed_rpm: float, pulses: int = 360) -> tuple[np.ndarray, np.ndarray]:
    return sampled_encoder(
        start_rev, speed_rpm, pulses_per_rev=pulses, high_v=5.0, rate_hz=RATE_HZ, n_samples=N_SAMPLES
    )


def signals(motion: Motion, encoder: Encoder) -> EncoderSignals:
    return encoder_signals(
        motion, encoder, (), seed=1, recording="made", stream="made", rate_hz=RATE_HZ, n_samples=N_SAMPLES
    )


def decoded(made: EncoderSignals, encoder: Encoder) -> xr.Dataset:
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


def angle_error_deg(motion: Motion, encoder: Encoder) -> np.ndarray:
    """Decoded less true crank angle, but for whole revolutions, without 0.05 s at either end."""
    shaft = decoded(signals(motion, encoder), encoder)
    assert shaft.attrs["phase_reference"] == "tdc"
    time_s = np.linspace(0.05, 4.95, 20_001)
    error = angle_at(time_s, **knots_of(shaft)) - motion.at(time_s)[0]
    return (error - np.round(np.median(error))) * 360


@pytest.mark.parametrize("speed_rpm", [300.0, 1234.5, 2000.0])
@pytest.mark.parametrize("start_rev", [0.1003, 1.73181])
def test_every_pulse_rises_at_its_angle_within_one_sample(speed_rpm: float, start_rev: float) -> None:
    encoder, index = sampled(start_rev, speed_rpm)
    rise = np.flatnonzero((encoder[1:] > 2.5) & (encoder[:-1] < 2.5)) + 1
    first = np.ceil(360 * start_rev)
    exact = ((first + np.arange(rise.size)) / 360 - start_rev) * 60 / speed_rpm * RATE_HZ
    assert ((rise - exact > -1e-6) & (rise - exact < 1 + 1e-6)).all()
    assert rise.size == np.floor(360 * (start_rev + speed_rpm / 60 * 249_999 / RATE_HZ)) - first + 1
    mark = np.flatnonzero((index[1:] == 1) & (index[:-1] == 0)) + 1
    assert set(np.diff(np.searchsorted(rise, mark))) == {360}
    assert np.isin(mark, rise).all()
    turns = start_rev + mark / RATE_HZ * speed_rpm / 60
    assert (np.abs(turns - np.rint(turns)) < speed_rpm / 60 / RATE_HZ * (1 + 1e-9)).all()


@pytest.mark.parametrize("motion", [THERE_AND_BACK, UNEVEN], ids=["reversal", "in-cycle"])
def test_the_level_is_a_function_of_angle_also_backwards(motion: Motion) -> None:
    encoder = Encoder(pulses_per_rev=60, missing_teeth=2, index_to_tdc_deg=10.0, ratio=2.0)
    made = signals(motion, encoder)
    place = encoder_turn(motion.at(TIME_S)[0], encoder) * 60
    np.testing.assert_array_equal(made.trace, 5 * ((np.floor(place) % 60 < 58) & (place % 1 < 0.5)))
    np.testing.assert_array_equal(made.index, place % 60 < 1)


@pytest.mark.parametrize("motion", [RUN_UP, WOBBLING, UNEVEN], ids=["run-up", "wobble", "in-cycle"])
@pytest.mark.parametrize(
    "wheel",
    [
        {"pulses_per_rev": 60},
        {"pulses_per_rev": 60, "ratio": 0.5, "index_to_tdc_deg": -37.0},
        {"pulses_per_rev": 60, "ratio": 0.5},
        {"pulses_per_rev": 60, "index_to_tdc_deg": 137.0},
        {"pulses_per_rev": 60, "missing_teeth": 2, "index": False},
        {"pulses_per_rev": 36, "missing_teeth": 1, "index": False, "index_to_tdc_deg": 84.0},
    ],
    ids=str,
)
def test_the_decoder_finds_the_angle_from_top_dead_centre(motion: Motion, wheel: dict[str, float]) -> None:
    """At 2500 rpm one sample is 0.3°: marks that lie between samples are uncertain by half of that."""
    error = angle_error_deg(motion, Encoder.model_validate(wheel))
    assert np.abs(error).max() < 0.4
    assert np.abs(error.mean()) < 0.15


def test_the_index_comes_once_per_turn_of_the_encoder_with_its_first_line() -> None:
    encoder = Encoder(pulses_per_rev=60, ratio=2.0, line_error_deg=0.1)
    wheel = wheel_of(encoder, seed=1)
    pulses, index = (passed_pulses(part, RUN_UP, encoder, duration_s=5.0) for part in (wheel, index_wheel(wheel)))
    pulse_s, index_s = (part.rise_s[np.isfinite(part.rise_s)] for part in (pulses, index))
    assert np.isin(index_s, pulse_s).all()
    assert set(np.diff(np.searchsorted(pulse_s, index_s))) == {60}
    turn = encoder_turn(RUN_UP.at(index_s)[0], encoder)
    np.testing.assert_allclose(turn - np.rint(turn), wheel.rise[0], atol=1e-11)
    np.testing.assert_array_equal(np.rint(turn), np.arange(1, 259))


def test_a_shaft_that_stands_still_keeps_its_level() -> None:
    stop = Motion(start_rev=0.3, corners=((1.0, 600.0), (2.0, 0.0)))
    trace = signals(stop, Encoder(pulses_per_rev=60)).trace
    assert np.ptp(trace[100_001:]) == 0
    assert np.ptp(trace[:90_000]) == 5
