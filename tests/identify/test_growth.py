"""Exponent, law, largest and mean amplitude: intervals hold the truth as often as they say."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from crankorder.identify.found import OrderLine
from crankorder.identify.lines.growth import growth, largest, mean_level, visible_range_rpm
from made.line_frames import PER_REV, agreed_in, angle_of, frames_of

SPEEDS = np.linspace(300.0, 2000.0, 35)


def line_of(rng, true, *, speed=SPEEDS, relative=0.03, freedom=24.0):
    """A line of ``true`` amplitudes at ``speed``, measured with errors that are themselves measured."""
    error = relative * true * rng.uniform(0.5, 2.0, len(true))
    seen = np.abs(true + error * (rng.standard_normal(len(true)) + 1j * rng.standard_normal(len(true))))
    stated = error * np.sqrt(rng.chisquare(freedom, len(true)) / freedom)
    at, known, none = np.arange(len(true)), np.full(len(true), freedom), np.zeros(len(true))
    return OrderLine("A", 5.5, 1e-4, at, speed, seen, stated, known, none, "locked to the shaft", 20.0)


def coverage(inside, n):
    rng = np.random.default_rng(12)
    return sum(inside(rng) for _ in range(n)) / n


@pytest.mark.cases(2)
@pytest.mark.parametrize(("exponent", "count"), [(0.0, 35), (2.0, 35), (2.0, 8), (1.0, 4)])
def test_the_interval_of_the_exponent_holds_it_as_often_as_it_says(exponent, count):
    speed = np.linspace(400.0, 2000.0, count)

    def inside(rng):
        low, high = growth(line_of(rng, (speed / 1000.0) ** exponent, speed=speed)).ci95
        return low <= exponent <= high

    assert 0.93 <= coverage(inside, 400) <= 0.985


@pytest.mark.slow
def test_the_interval_of_the_mean_level_holds_it():
    def inside(rng):
        found = mean_level(line_of(rng, np.ones(35)))
        return found.low <= 1.0 <= found.high

    assert 0.93 <= coverage(inside, 400) <= 0.985


def test_laws_are_named_but_of_three_speeds_or_of_speeds_within_a_tenth():
    rng = np.random.default_rng(1)
    assert growth(line_of(rng, np.ones(35))).law == "keeps its size"
    assert growth(line_of(rng, (SPEEDS / 1000.0) ** 2)).law == "grows with speed^n"
    for exponent, speed in ((0.0, SPEEDS[:3]), (0.0, np.full(5, 900.0)), (2.0, np.linspace(2800.0, 3050.0, 12))):
        assert growth(line_of(rng, (speed / 2800.0) ** exponent, speed=speed, relative=0.002)) is None


@pytest.mark.slow
def test_scatter_beyond_the_errors_is_not_called_steady():
    rng = np.random.default_rng(2)
    made = [growth(line_of(rng, np.exp(0.4 * rng.standard_normal(35)), relative=0.02)) for _ in range(40)]
    assert "keeps its size" not in {found.law for found in made}
    assert np.median([found.scatter for found in made]) == pytest.approx(0.4, abs=0.1)


def test_a_narrow_resonance_does_not_make_the_law_and_is_told():
    rng = np.random.default_rng(3)
    true = (SPEEDS / 1000.0) ** 2 * (1.0 + 6.0 * np.exp(-(((SPEEDS - 1300.0) / 60.0) ** 2)))
    found = growth(line_of(rng, true))
    assert found.law == "grows with speed^n"
    assert found.exponent == pytest.approx(2.0, abs=0.05)
    assert 1300.0 in found.deviating_rpm and set(found.deviating_rpm) <= set(SPEEDS[(SPEEDS > 1100) & (SPEEDS < 1500)])


def test_one_speed_has_students_interval_and_its_range():
    line = line_of(np.random.default_rng(5), np.ones(1), speed=np.array([900.0]))
    found = largest(line)
    assert found.high - found.low == pytest.approx(2 * 2.063899 * float(line.amplitude_error[0]), rel=1e-4)
    assert visible_range_rpm(line) == (900.0, 900.0)


@pytest.mark.slow
def test_an_exact_amplitude_has_no_width_and_an_unknown_one_no_end():
    line = line_of(np.random.default_rng(6), np.ones(2), speed=np.array([900.0, 950.0]), relative=0.0)
    assert largest(line).low == largest(line).high == 1.0
    unknown = largest(replace(line, amplitude_error=np.full(2, np.inf)))
    assert (unknown.low, unknown.high) == (0.0, np.inf)


# 95 % intervals of amplitude and phase hold the truth 95 times in 100 over machines that differ in everything.


ORDERS = np.arange(1, 17) / 2.0

Scene = tuple[list, float, tuple[np.ndarray, np.ndarray]]
"""Frames and order of a line, amplitudes (several,) any of which the interval should hold, and phases [rad]."""


def found_in(frames, order):
    """Intervals of amplitude and phase [deg] (centre, half width) of the line at ``order``, by channel."""
    given = []
    for item in agreed_in(frames):
        for line in item.lines if abs(item.order - order) < 1e-3 else ():
            best = largest(line)
            phase = float(line.phase_deg[best.at])
            half = np.nan if line.phase_ci95_deg is None else float(line.phase_ci95_deg[best.at])
            given.append(((best.low, best.high), (phase, half)))
    return given


def recording(rng, order, size, phase, revs, noise):
    angle = angle_of(revs)
    line = size * np.cos(2.0 * np.pi * order * angle + phase)
    return frames_of([line + noise * rng.standard_normal(len(angle))])


def steady(rng, *, most=0.7, revs=(80, 400)):
    order, phase, noise = float(rng.choice(ORDERS)), rng.uniform(-3.0, 3.0), float(np.exp(rng.uniform(-4.0, most)))
    frames = [recording(rng, order, np.ones(1), phase, int(rng.integers(*revs)), noise)]
    return frames, order, (np.ones(1), np.array([phase]))


def few_frames(rng):
    return steady(rng, most=-1.0, revs=(24, 64))


def weak(rng):
    """A line that stands a little above the level that noise alone reaches."""
    order, phase = float(rng.choice(ORDERS)), rng.uniform(-3.0, 3.0)
    revs = int(rng.integers(100, 400))
    beside = np.sqrt(3.0 / (16.0 * PER_REV))  # root of half the noise power of a frame, over that of a sample
    noise = float(1.0 / beside / rng.uniform(2.5, 6.0))
    return [recording(rng, order, np.ones(1), phase, revs, noise)], order, (np.ones(1), np.array([phase]))


def repeated(rng):
    """Two to five recordings at one speed that differ by a tenth."""
    order, phase, noise = float(rng.choice(ORDERS)), rng.uniform(-3.0, 3.0), float(np.exp(rng.uniform(-4.0, 0.0)))
    scatter = float(rng.uniform(0.02, 0.2))
    made = []
    for _ in range(int(rng.integers(2, 6))):
        one = (1.0 + scatter * (rng.standard_normal() + 1j * rng.standard_normal())) * np.exp(1j * phase)
        made.append(recording(rng, order, np.abs(one) * np.ones(1), float(np.angle(one)), 100, noise))
    return made, order, (np.ones(1), np.array([phase]))


def changing(rng):
    """An amplitude that drifts, doubles or swells within the recording; what any frame held is asked for."""
    order, phase, noise = float(rng.choice(ORDERS)), rng.uniform(-3.0, 3.0), float(np.exp(rng.uniform(-4.0, -1.0)))
    revs = int(rng.integers(120, 400))
    share, change = np.linspace(0.0, 1.0, revs * PER_REV), float(rng.uniform(0.3, 1.0))
    courses: list[Callable[[], np.ndarray]] = [
        lambda: 1.0 + change * share,
        lambda: 1.0 + change * (share > rng.uniform(0.3, 0.7)),
        lambda: 1.0 + change * np.sin(np.pi * share * rng.uniform(1.0, 4.0)) ** 2,
    ]
    size = courses[int(rng.integers(3))]()
    window = np.hanning(16 * PER_REV)
    begins = np.arange(0, len(size) - len(window) + 1, 8 * PER_REV)
    held = np.array([np.average(size[k : k + len(window)], weights=window) for k in begins])
    return [recording(rng, order, size, phase, revs, noise)], order, (held, np.array([phase]))


CLASSES = {"steady": steady, "few frames": few_frames, "weak": weak, "repeated": repeated, "changing": changing}


def coverage_pooled(draw, name, n):
    """Shares (amplitudes, phases) of truths that lie in the intervals, and how many lines were found."""
    size, phase = [], []
    for seed in range(n):
        frames, order, (amplitudes, phases) = draw(np.random.default_rng([seed, *name.encode()]))
        for (low, high), (centre, half) in found_in(frames, order):
            size.append(float(np.mean((low <= amplitudes) & (amplitudes <= high))))
            if np.isfinite(half):
                off = (centre - np.degrees(phases) + 180.0) % 360.0 - 180.0
                phase.append(float(np.mean(np.abs(off) <= half)))
            assert low > 0.0  # a line that is reported as found is not nothing
    return np.array([np.mean(size), np.mean(phase), len(size)])


@pytest.mark.parametrize("name", CLASSES)
def test_every_class_of_machines_is_covered(name):
    by_size, by_phase, n = coverage_pooled(CLASSES[name], name, 60)
    # 0.95 less four standard errors of so many draws
    least = 0.95 - 4.0 * np.sqrt(0.95 * 0.05 / n)
    assert by_size > least and by_phase > least
