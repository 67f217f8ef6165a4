"""Lines whose amplitude changes while it is measured are seen by the phase that they keep; noise is not."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.lines.line_evidence import keeps_its_phase
from made.line_frames import HOP, agreed_in, angle_of, frames_of, wave

ONE, SEVERAL = (1500.0,), (1500.0, 1530.0, 1560.0)


def swelling(angle: np.ndarray, how: str, factor: float) -> np.ndarray:
    share = (angle - angle[0]) / (angle[-1] - angle[0])
    if how == "step":
        return np.where(share > 0.5, factor, 1.0)
    if how == "early step":
        return np.where(share > 0.3, factor, 1.0)
    return 1.0 + (factor - 1.0) * share


def found(order: float, how: str, factor: float, speeds: tuple[float, ...], *, amplitude: float = 3.0):
    rng, angle, frames = np.random.default_rng(int(100 * factor)), angle_of(250), []
    size = amplitude * swelling(angle, how, factor)
    for rpm in speeds:
        signals = [size * wave(angle, order, 1.0, rng.uniform(0, 6)) + rng.standard_normal(len(angle))]
        frames.append(frames_of(signals, speed_rpm=rpm))
    return agreed_in(frames)


@pytest.mark.parametrize("speeds", [ONE, SEVERAL])
@pytest.mark.parametrize(("how", "factor"), [("step", 1.2), ("step", 2.0), ("step", 10.0), ("early step", 3.0)])
@pytest.mark.parametrize("order", [1.0, 5.5, 5.467])
def test_an_order_whose_amplitude_changes_is_found(order: float, how: str, factor: float, speeds) -> None:
    (agreed,) = found(order, how, factor, speeds)
    assert agreed.order == pytest.approx(order, abs=0.02)
    assert agreed.lock == "slips" if order == 5.467 else agreed.lock != "slips"


@pytest.mark.cases(1)
@pytest.mark.parametrize("speeds", [ONE, SEVERAL])
@pytest.mark.parametrize("order", [1.0, 5.5])
@pytest.mark.parametrize("factor", [2.0, 5.0])
def test_its_interval_reaches_over_the_amplitudes_that_it_held(order: float, factor: float, speeds) -> None:
    (agreed,) = found(order, "step", factor, speeds)
    (line,) = agreed.lines
    assert line.ends is not None
    assert (line.ends[:, 0] < 1.03 * 3.0).all() and (line.ends[:, 1] > 0.97 * 3.0 * factor).all()


def test_a_resonance_that_noise_excites_keeps_no_phase() -> None:
    """A thousand recordings of thirty frames each, of a mode at order 5.5 that is damped by one percent."""
    rng, hits, kept = np.random.default_rng(3), 0, np.exp(-2 * np.pi * 0.01 * 5.5 * HOP)
    centre = HOP * np.arange(30.0)
    for _ in range(1000):
        phasor = rng.standard_normal(30) + 1j * rng.standard_normal(30)
        for k in range(1, 30):
            phasor[k] = kept * phasor[k - 1] + np.sqrt(1.0 - kept**2) * phasor[k]
        hits += keeps_its_phase(
            [(phasor, centre, float(HOP))], order=5.5, independent_share=0.95, slips=False, false_alarm_probability=1e-2
        )
    assert hits <= 25
