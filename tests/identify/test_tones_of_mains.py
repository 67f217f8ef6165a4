"""A multiple of the mains is one line: what stands beside it is its skirt or another tone."""

from __future__ import annotations

from crankorder.identify.found import Tone
from crankorder.identify.modal.tones import with_one_mains
from crankorder.settings import load_settings

SETTINGS = load_settings().identify


def mains(frequency_hz: float, error_hz: float) -> Tone:
    return Tone(frequency_hz, error_hz, "mains", {"X": (0.2, 0.01)}, "made so")


def test_a_multiple_is_listed_once_as_the_line_that_is_told_best() -> None:
    lines = [mains(50.01, 0.003), mains(149.52, 0.32), mains(150.01, 0.009)]
    made = with_one_mains(lines, settings=SETTINGS)
    assert [(tone.frequency_hz, tone.kind) for tone in made] == [(50.01, "mains"), (150.01, "mains")]


def test_a_line_that_surely_stands_beside_a_multiple_is_a_tone() -> None:
    made = with_one_mains([mains(149.7, 0.005), mains(150.01, 0.004)], settings=SETTINGS)
    assert [(tone.frequency_hz, tone.kind) for tone in made] == [(149.7, "tone"), (150.01, "mains")]


def test_other_multiples_stay() -> None:
    lines = [mains(50.0, 0.003), mains(100.0, 0.003), mains(150.0, 0.003)]
    assert with_one_mains(lines, settings=SETTINGS) == tuple(lines)
