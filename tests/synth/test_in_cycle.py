"""The shaft turns within its cycle as the shares of its speed by order say."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.engine.torsional_fluctuation import Lag
from crankorder.errors import RequestError
from crankorder.synth.crank import crank_motion, lag_by_order
from crankorder.synth.load import load_scene
from crankorder.synth.motion import Motion
from crankorder.synth.parts import InCycleSpeed, SpeedOrder
from crankorder.synth.scene import Scene


def _turning(lag: Lag, rpm: float, revs: int = 2, samples: int = 4001) -> tuple[np.ndarray, ...]:
    return Motion(start_rev=0.13, corners=((0.0, rpm),), lag=lag).at(np.linspace(0, revs * 60 / rpm, samples))


@pytest.mark.parametrize(
    "parts",
    [
        ((2.0, 1.5, 30.0),),
        ((0.5, 3.0, 0.0), (2.0, 10.0, 200.0), (2.0, 4.0, 10.0)),
        ((1.0, 45.0, 0.0), (3.0, 30.0, 90.0)),
        ((1.0, 2.0, 0.0), (5.3, 5.0, 50.0)),
    ],
)
def test_the_speed_has_the_given_orders_by_crank_angle_and_no_others(parts: tuple) -> None:
    lag = lag_by_order(tuple(SpeedOrder(order=o, percent=p, phase_deg=d) for o, p, d in parts))
    angle, speed, _ = _turning(lag, 1200.0, revs=10)
    shape = 1 + sum(p / 100 * np.cos(2 * np.pi * o * angle + np.radians(d)) for o, p, d in parts)
    np.testing.assert_allclose(speed / shape, speed[0] / shape[0], rtol=3e-13)
    assert angle[-1] - angle[0] == pytest.approx(10, abs=1e-13)


def test_shares_that_add_up_to_a_standstill_are_refused() -> None:
    with pytest.raises(RequestError, match="stop within the cycle"):
        lag_by_order(tuple(SpeedOrder(order=o, percent=46.0, phase_deg=180.0) for o in (1.0, 2.0)))


def _lag_of(scene: Scene, flywheel_inertia_kg_m2: float | None, in_cycle: InCycleSpeed) -> Lag:
    engine = scene.engine.model_copy(update={"flywheel_inertia_kg_m2": flywheel_inertia_kg_m2})
    changed = scene.model_copy(update={"engine": engine, "in_cycle_speed": in_cycle})
    lag = crank_motion(changed, changed.runs[0]).lag
    assert lag is not None
    return lag


@pytest.mark.slow
def test_the_flywheel_is_the_engines_unless_the_scene_has_its_own() -> None:
    scene = load_scene("thesis-second-firing")
    of_engine = _lag_of(scene, 0.4, InCycleSpeed())
    of_scene = _lag_of(scene, 0.9, InCycleSpeed(flywheel_inertia_kg_m2=0.4))
    np.testing.assert_array_equal(of_engine.inertia, of_scene.inertia)
    np.testing.assert_array_equal(of_engine.gas, of_scene.gas)
    assert np.abs(of_engine.inertia[1]) > 2 * np.abs(_lag_of(scene, 0.9, InCycleSpeed()).inertia[1])
    with pytest.raises(RequestError, match="how large the flywheel is"):
        _lag_of(scene, None, InCycleSpeed())
