"""95 % intervals of amplitude and phase hold the truth 95 times in 100 over machines that differ in everything.

Frames are drawn as random machines give them; what is asked is what a user reads: the records' intervals.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from crankorder.identify.lines.growth import largest
from made.line_frames import PER_REV, agreed_in, angle_of, frames_of

ORDERS = np.arange(1, 17) / 2.0

Given = tuple[np.ndarray, np.ndarray]
"""Amplitudes (several,) any of which the interval should hold, and phases [rad]."""


def found_in(frames: list, order: float) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Intervals of amplitude and phase [deg] (centre, half width) of the line at ``order``, by channel."""
    found = agreed_in(frames)
    given = []
    for item in found:
        for line in item.lines if abs(item.order - order) < 1e-3 else ():
            best = largest(line)
            phase = float(line.phase_deg[best.at])
            half = np.nan if line.phase_ci95_deg is None else float(line.phase_ci95_deg[best.at])
            given.append(((best.low, best.high), (phase, half)))
    return given


def recording(rng: np.random.Generator, order: float, size: np.ndarray, phase: float, revs: int, noise: float):
    angle = angle_of(revs)
    line = size * np.cos(2.0 * np.pi * order * angle + phase)
    return frames_of([line + noise * rng.standard_normal(len(angle))])


def steady(rng: np.random.Generator) -> tuple[list, float, Given]:
    order, phase, noise = float(rng.choice(ORDERS)), rng.uniform(-3.0, 3.0), float(np.exp(rng.uniform(-4.0, 0.7)))
    revs = int(rng.integers(80, 400))
    return [recording(rng, order, np.ones(1), phase, revs, noise)], order, (np.ones(1), np.array([phase]))


def few_frames(rng: np.random.Generator) -> tuple[list, float, Given]:
    order, phase, noise = float(rng.choice(ORDERS)), rng.uniform(-3.0, 3.0), float(np.exp(rng.uniform(-4.0, -1.0)))
    revs = int(rng.integers(24, 64))
    return [recording(rng, order, np.ones(1), phase, revs, noise)], order, (np.ones(1), np.array([phase]))


def weak(rng: np.random.Generator) -> tuple[list, float, Given]:
    """A line that stands a little above the level that noise alone reaches."""
    order, phase = float(rng.choice(ORDERS)), rng.uniform(-3.0, 3.0)
    revs = int(rng.integers(100, 400))
    beside = np.sqrt(3.0 / (16.0 * PER_REV))  # root of half the noise power of a frame, over that of a sample
    noise = float(1.0 / beside / rng.uniform(2.5, 6.0))
    return [recording(rng, order, np.ones(1), phase, revs, noise)], order, (np.ones(1), np.array([phase]))


def repeated(rng: np.random.Generator) -> tuple[list, float, Given]:
    """Two to five recordings at one speed that differ by a tenth."""
    order, phase, noise = float(rng.choice(ORDERS)), rng.uniform(-3.0, 3.0), float(np.exp(rng.uniform(-4.0, 0.0)))
    scatter = float(rng.uniform(0.02, 0.2))
    made = []
    for _ in range(int(rng.integers(2, 6))):
        one = (1.0 + scatter * (rng.standard_normal() + 1j * rng.standard_normal())) * np.exp(1j * phase)
        made.append(recording(rng, order, np.abs(one) * np.ones(1), float(np.angle(one)), 100, noise))
    return made, order, (np.ones(1), np.array([phase]))


def changing(rng: np.random.Generator) -> tuple[list, float, Given]:
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


def coverage(draw: Callable[[np.random.Generator], tuple[list, float, Given]], name: str, n: int) -> np.ndarray:
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
def test_every_class_of_machines_is_covered(name: str) -> None:
    by_size, by_phase, n = coverage(CLASSES[name], name, 60)
    # 0.95 less four standard errors of so many draws
    least = 0.95 - 4.0 * np.sqrt(0.95 * 0.05 / n)
    assert by_size > least and by_phase > least


@pytest.mark.accuracy
def test_pooled_over_all_classes_95_of_100_intervals_hold_the_truth() -> None:
    shares = {name: coverage(draw, name, 700) for name, draw in CLASSES.items()}
    print({name: share.round(3).tolist() for name, share in shares.items()})
    assert min(share[2] for share in shares.values()) >= 300
    each = np.array([share[:2] for share in shares.values()])
    assert each.min() >= 0.90
    assert abs(each.mean() - 0.95) <= 0.015
