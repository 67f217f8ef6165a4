"""With few pulses per revolution the motion between them comes from the engine model, and orders are right."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from crankorder.engine.definition import Engine, load_engine
from crankorder.engine.in_cycle import lag_from_torque
from crankorder.settings import load_settings
from crankorder.shaft.angle import AngleKnots, angle_knots, time_at
from crankorder.shaft.torsion import (
    InCycleModel,
    in_cycle_model,
    knots_with_model,
)
from crankorder.synth.motion import Motion

SETTINGS = load_settings().shaft
FLYWHEEL = 0.6
PULSE_REV = 0.1  # crank angle of a pulse from top dead centre
ORDERS = np.arange(0.5, 6.0, 0.5)
# Strong first and second orders, whose sidebands fall on the weak ones.
LINES = np.where(np.isin(ORDERS, (1.0, 2.0)), 30.0, 1.0) * np.exp(1j * ORDERS**2)


def engine(**keys: object) -> Engine:
    return load_engine("msu-optical-second-firing").model_copy(update={"flywheel_inertia_kg_m2": FLYWHEEL} | keys)


@dataclass(frozen=True)
class Seen:
    """Pulses of a known shaft: times, tooth numbers from 0, crank angle of tooth 0 in the cycle, noise."""

    motion: Motion
    time_s: np.ndarray
    first_rev: float
    per_rev: int
    noise_s: float | None = None

    @property
    def tooth(self) -> np.ndarray:
        return np.arange(self.time_s.size)

    @property
    def tdc_rev(self) -> float:
        """A top dead centre on the scale of the teeth; which of both fires is not in it."""
        return -self.first_rev % 1.0

    def model(self, machine: Engine, *, cycle_known: bool = False, **tdc: float) -> InCycleModel:
        place = {"teeth_per_rev": self.per_rev, "tdc_rev": self.tdc_rev} | tdc
        return in_cycle_model(machine, self.time_s, self.tooth, cycle_known=cycle_known, **place)

    def plain(self) -> AngleKnots:
        return angle_knots(self.time_s, self.tooth, teeth_per_rev=self.per_rev, noise_s=self.noise_s, settings=SETTINGS)

    def with_model(self, machine: Engine, *, cycle_known: bool = False) -> tuple[AngleKnots, InCycleModel]:
        return knots_with_model(
            machine,
            self.time_s,
            self.tooth,
            teeth_per_rev=self.per_rev,
            tdc_rev=self.tdc_rev,
            cycle_known=cycle_known,
            noise_s=self.noise_s,
            settings=SETTINGS,
        )


def turning(
    rpm: float, *, fires: bool, start_rev: float = 0.37, inertia: float = FLYWHEEL, to_rpm: float | None = None
) -> Motion:
    lag = lag_from_torque(engine(), flywheel_inertia_kg_m2=inertia, speed_rpm=rpm, highest_order=20, with_gas=fires)
    corners = ((0.0, rpm),) if to_rpm is None else ((0.0, rpm), (15.0, to_rpm))
    return Motion(start_rev=start_rev, corners=corners, lag=lag)


def pulse_times(motion: Motion, *, per_rev: int = 1, duration_s: float = 15.0) -> Seen:
    first, last = motion.at(np.array([0.0, duration_s]))[0]
    number = np.arange(math.ceil((first - PULSE_REV) * per_rev), math.floor((last - PULSE_REV) * per_rev) + 1)
    angle = number / per_rev + PULSE_REV
    return Seen(motion, motion.time_at(angle, (0.0, duration_s)), float(angle[0]), per_rev)


def worst_order(seen: Seen, knots: AngleKnots) -> float:
    """Largest error of the orders' complex amplitudes, each relative to its own, of a signal that follows the crank."""
    angle = knots.angle_rev + seen.first_rev
    cycles = math.floor((angle[-1] - angle[0]) / 2) - 1
    grid = math.ceil(angle[0]) + np.arange(64 * 2 * cycles) / 64
    true = seen.motion.at(time_at(grid, knots.time_s, angle, knots.speed_rpm))[0]
    signal = (LINES * np.exp(2j * np.pi * np.outer(true, ORDERS))).real.sum(axis=1)
    read = 2 * (signal @ np.exp(-2j * np.pi * np.outer(grid, ORDERS))) / grid.size
    return float(np.abs(read / LINES - 1).max())


@pytest.mark.parametrize("fires", [False, True])
def test_orders_of_one_counted_pulse_per_revolution_are_those_of_the_crank(fires: bool) -> None:
    for rpm in [1000.0, 1500.0, 2000.0]:
        seen = pulse_times(turning(rpm, fires=fires))
        knots, model = seen.with_model(engine())
        assert worst_order(seen, seen.plain()) > 0.05
        assert worst_order(seen, knots) < 1e-3
        assert model.flags[-1][0] == "in_cycle_from_model"


@pytest.mark.slow
@pytest.mark.parametrize("fires", [False, True])
def test_a_run_up_is_filled_in_at_every_speed(fires: bool) -> None:
    seen = pulse_times(turning(1500.0, fires=fires, to_rpm=2100.0))
    assert worst_order(seen, seen.plain()) > 0.05
    assert worst_order(seen, seen.with_model(engine())[0]) < 0.005


def test_the_pulses_tell_which_dead_centre_fires() -> None:
    start_rev = 1.37
    seen = pulse_times(turning(1000.0, fires=True, start_rev=start_rev))
    model = seen.model(engine())
    assert model.cycle_known
    fires_at = seen.first_rev + seen.tdc_rev + model.turns
    assert fires_at % 2.0 == pytest.approx(0.0, abs=1e-9)
    assert [flag for flag, _, _ in model.flags] == ["cycle_phase_from_model", "in_cycle_from_model"]


def test_a_firing_engine_without_a_gas_curve_is_not_filled_in() -> None:
    seen = pulse_times(turning(1000.0, fires=True))
    knots, model = seen.with_model(engine(gas=None))
    assert model.lag is None
    assert [(flag, how) for flag, how, _ in model.flags] == [("in_cycle_not_filled", "suspect")]
    assert "as gas makes them" in model.flags[0][2]
    np.testing.assert_array_equal(knots.time_s, seen.plain().time_s)


def test_no_flywheel_no_filling() -> None:
    seen = pulse_times(turning(1000.0, fires=False))
    model = seen.model(engine(flywheel_inertia_kg_m2=None))
    assert model.lag is None
    assert [(flag, how) for flag, how, _ in model.flags] == [("in_cycle_not_filled", "info")]
    assert pulse_times(turning(1000.0, fires=False), per_rev=60).model(engine(flywheel_inertia_kg_m2=None)).flags == []


def test_wheels_that_carry_the_motion_are_left_alone() -> None:
    per_rev = 60
    seen = pulse_times(turning(1000.0, fires=True), per_rev=per_rev)
    assert seen.model(engine()) == InCycleModel(None, 0, False, [])
