"""Wheels line by line: where each pulse comes against the angle of the motion, and how the decoder numbers it."""

import numpy as np
import pytest

from crankorder.settings import load_settings
from crankorder.shaft.wheel import number_teeth
from crankorder.synth.encoder import Pulses, encoder_turn, passed_pulses, wheel_of
from crankorder.synth.motion import Motion
from crankorder.synth.parts import Encoder

RUN_UP = Motion(start_rev=0.321, corners=((0.5, 600.0), (4.5, 3000.0)), wobbles=((1.3, 40.0, 20.0),))
THERE_AND_BACK = Motion(start_rev=0.321, corners=((0.5, 900.0), (2.5, -600.0), (3.0, -600.0), (4.0, 700.0)))
DURATION_S = 5.0
SHAFT = load_settings().shaft


def pulses_of(encoder: Encoder, motion: Motion, seed: int = 1) -> Pulses:
    return passed_pulses(wheel_of(encoder, seed=seed), motion, encoder, duration_s=DURATION_S)


def turn_at(time_s: np.ndarray, motion: Motion, encoder: Encoder) -> np.ndarray:
    return encoder_turn(motion.at(time_s)[0], encoder)


def test_every_line_comes_when_the_shaft_is_at_its_angle() -> None:
    for ratio in (0.5, 1.0, 2.0):
        encoder = Encoder(pulses_per_rev=60, ratio=ratio, index_to_tdc_deg=37.0)
        pulses = pulses_of(encoder, RUN_UP)
        inside = np.isfinite(pulses.rise_s)
        rise, fall = pulses.rise_s[inside], pulses.fall_s[np.isfinite(pulses.fall_s)]
        np.testing.assert_allclose(turn_at(rise, RUN_UP, encoder) * 60, pulses.number[inside], atol=1e-9)
        np.testing.assert_allclose(turn_at(fall, RUN_UP, encoder) * 60 % 1, 0.5, atol=1e-9)
        first, last = turn_at(np.array([0.0, DURATION_S]), RUN_UP, encoder) * 60
        np.testing.assert_array_equal(pulses.number, np.arange(np.floor(first + 0.5), np.floor(last) + 1))


@pytest.mark.parametrize(("teeth", "missing"), [(60, 2), (36, 1)])
def test_the_decoder_finds_the_first_tooth_behind_the_gap_at_whole_turns(teeth: int, missing: int) -> None:
    encoder = Encoder(pulses_per_rev=teeth, missing_teeth=missing)
    rise_s = pulses_of(encoder, RUN_UP).rise_s
    numbered = number_teeth(rise_s[rise_s > 0], pulses_per_rev=teeth, settings=SHAFT, missing_teeth=missing)
    assert numbered.index_tooth == 0
    assert numbered.n_repaired == 0
    assert numbered.flags == []
    shown = turn_at(numbered.time_s, RUN_UP, encoder) - numbered.tooth / teeth
    np.testing.assert_allclose(shown, round(shown[0]), atol=1e-10)
    assert set(numbered.tooth % teeth) == set(range(teeth - missing))


@pytest.mark.parametrize("amplitude_deg", [0.4, 40.0])
def test_an_eccentric_wheel_shows_its_turn_and_a_sine_of_it(amplitude_deg: float) -> None:
    encoder = Encoder(pulses_per_rev=60, eccentricity_deg=amplitude_deg, eccentricity_phase_deg=30.0)
    pulses = pulses_of(encoder, RUN_UP)
    inside = np.isfinite(pulses.rise_s)
    turn = turn_at(pulses.rise_s[inside], RUN_UP, encoder)
    error = amplitude_deg / 360 * np.sin(2 * np.pi * turn + np.pi / 6)
    np.testing.assert_allclose(turn + error, pulses.number[inside] / 60, atol=1e-11)


@pytest.mark.slow
def test_errors_of_lines_are_those_of_the_wheel_and_have_their_spread() -> None:
    encoder = Encoder(pulses_per_rev=3600, line_error_deg=0.01)
    wheel, again, other = (wheel_of(encoder, seed=seed) for seed in (1, 1, 2))
    error_deg = (wheel.nominal - wheel.rise) * 360
    assert error_deg.std() == pytest.approx(0.01, rel=0.05)
    np.testing.assert_array_equal(wheel.rise, again.rise)
    assert np.abs(np.corrcoef(error_deg, (other.nominal - other.rise) * 360)[0, 1]) < 0.05


def test_a_shaft_that_turns_back_passes_its_lines_in_reverse() -> None:
    encoder = Encoder(pulses_per_rev=60, missing_teeth=2, ratio=2.0, index_to_tdc_deg=10.0)
    pulses = pulses_of(encoder, THERE_AND_BACK)
    inside = np.isfinite(pulses.rise_s)
    rise_s, number = pulses.rise_s[inside], pulses.number[inside]
    assert (np.diff(rise_s) > 0).all()
    backwards = THERE_AND_BACK.at(rise_s)[1] < 0
    assert backwards.sum() > 500
    turns = turn_at(rise_s, THERE_AND_BACK, encoder)
    place = turns * 60 - np.where(backwards, 0.5, 0.0)
    np.testing.assert_allclose(place, np.rint(place), atol=1e-8)
    assert (np.rint(place) % 60 < 58).all()
    assert set(np.diff(number[backwards])) == {-1}


@pytest.mark.slow
def test_a_shaft_at_standstill_gives_no_pulse() -> None:
    still = Motion(start_rev=0.33, corners=((0.0, 0.0),))
    assert pulses_of(Encoder(pulses_per_rev=60), still).rise_s.size == 0
    high = pulses_of(Encoder(pulses_per_rev=1), still)
    assert (high.rise_s, high.fall_s) == ([-np.inf], [np.inf])
