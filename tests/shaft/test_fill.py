"""With few pulses per revolution the motion between them comes from the engine model, and orders are right."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from crankorder.engine.definition import Engine, load_engine
from crankorder.engine.in_cycle import Lag, lag_from_torque
from crankorder.errors import RequestError
from crankorder.settings import load_settings
from crankorder.shaft.angle import AngleKnots, angle_at, angle_knots, time_at
from crankorder.shaft.pulses import find_pulses
from crankorder.shaft.torsion import (
    InCycleModel,
    filled,
    in_cycle_model,
    knots_with_model,
    lag_parts,
    mean_pulse_times,
    mean_rate,
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


def square_wave(motion: Motion, *, per_rev: int = 1) -> Seen:
    time_s = np.arange(15 * 50_000) / 50_000
    place = (motion.at(time_s)[0] - PULSE_REV) * per_rev
    pulses = find_pulses(
        (place % 1.0 < 0.3).astype(np.float32),
        rate_hz=50_000.0,
        kind="square",
        edge="rising",
        pulses_per_rev=per_rev,
        settings=SETTINGS,
    )
    first = math.ceil(place[0]) / per_rev + PULSE_REV
    return Seen(motion, pulses.time_s, first, per_rev, pulses.noise_s)


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
@pytest.mark.parametrize("rpm", [1000.0, 1500.0, 2000.0])
def test_orders_of_one_counted_pulse_per_revolution_are_those_of_the_crank(rpm: float, fires: bool) -> None:
    seen = pulse_times(turning(rpm, fires=fires))
    knots, model = seen.with_model(engine())
    assert worst_order(seen, seen.plain()) > 0.05
    assert worst_order(seen, knots) < 1e-3
    assert model.flags[-1][0] == "in_cycle_from_model"


@pytest.mark.parametrize("fires", [False, True])
@pytest.mark.parametrize("rpm", [1003.7, 1503.7, 2003.1])
def test_orders_of_one_sampled_pulse_per_revolution_are_within_one_percent(rpm: float, fires: bool) -> None:
    seen = square_wave(turning(rpm, fires=fires))
    assert worst_order(seen, seen.plain()) > 0.05
    assert worst_order(seen, seen.with_model(engine())[0]) < 0.01


@pytest.mark.parametrize("per_rev", [2, 3, 4, 6])
@pytest.mark.parametrize("fires", [False, True])
def test_a_few_pulses_per_revolution_gain_too(per_rev: int, fires: bool) -> None:
    seen = pulse_times(turning(1003.7, fires=fires), per_rev=per_rev)
    after = worst_order(seen, seen.with_model(engine())[0])
    assert after < 1e-3
    assert after < 0.5 * worst_order(seen, seen.plain())


@pytest.mark.parametrize("fires", [False, True])
def test_a_run_up_is_filled_in_at_every_speed(fires: bool) -> None:
    seen = pulse_times(turning(1500.0, fires=fires, to_rpm=2100.0))
    assert worst_order(seen, seen.plain()) > 0.05
    assert worst_order(seen, seen.with_model(engine())[0]) < 0.005


@pytest.mark.parametrize("start_rev", [0.37, 1.37, -0.2, 0.09])
def test_the_pulses_tell_which_dead_centre_fires(start_rev: float) -> None:
    seen = pulse_times(turning(1000.0, fires=True, start_rev=start_rev))
    model = seen.model(engine())
    assert model.cycle_known
    fires_at = seen.first_rev + seen.tdc_rev + model.turns
    assert fires_at % 2.0 == pytest.approx(0.0, abs=1e-9)
    assert [flag for flag, _, _ in model.flags] == ["cycle_phase_from_model", "in_cycle_from_model"]


def test_a_motored_engine_is_filled_in_without_its_gas() -> None:
    model = pulse_times(turning(1000.0, fires=False)).model(engine())
    assert model.lag is not None
    assert not model.lag.has_gas
    assert not model.cycle_known
    assert "masses alone" in model.flags[-1][2]


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


def test_a_flywheel_that_could_not_turn_is_told() -> None:
    model = pulse_times(turning(1000.0, fires=False)).model(engine(flywheel_inertia_kg_m2=1e-3))
    assert model.lag is None
    assert "stop within the cycle" in model.flags[0][2]


@pytest.mark.parametrize("per_rev", [60, 360])
def test_wheels_that_carry_the_motion_are_left_alone(per_rev: int) -> None:
    seen = pulse_times(turning(1000.0, fires=True), per_rev=per_rev)
    assert seen.model(engine()) == InCycleModel(None, 0, False, [])


def test_half_orders_are_left_out_where_the_stated_cycle_contradicts_the_pulses() -> None:
    seen = pulse_times(turning(1000.0, fires=True))
    turns = seen.model(engine()).turns
    right = seen.model(engine(), cycle_known=True, tdc_rev=seen.tdc_rev + turns)
    wrong = seen.model(engine(), cycle_known=True, tdc_rev=seen.tdc_rev + 1 - turns)
    assert right.lag is not None and np.any(right.lag.order % 1 == 0.5)
    assert [flag for flag, _, _ in right.flags] == ["in_cycle_from_model"]
    assert wrong.lag is not None and not np.any(wrong.lag.order % 1)
    assert wrong.flags[0][:2] == ("in_cycle_half_orders", "suspect")


def test_a_recording_too_short_to_tell_the_revolutions_apart_keeps_to_whole_orders() -> None:
    seen = pulse_times(turning(1000.0, fires=True), duration_s=0.9)
    model = seen.model(engine())
    assert model.lag is not None and not np.any(model.lag.order % 1)
    assert not model.cycle_known
    assert "do not show which" in model.flags[0][2]
    known = seen.model(engine(), cycle_known=True)
    assert known.lag is not None and np.any(known.lag.order % 1 == 0.5)


def test_ten_percent_of_inertia_are_one_standard_error() -> None:
    seen = pulse_times(turning(1000.0, fires=False, inertia=FLYWHEEL))
    knots, _ = seen.with_model(engine(flywheel_inertia_kg_m2=1.1 * FLYWHEEL))
    time_s = np.linspace(1.0, 14.0, 20_001)
    angle = angle_at(time_s, knots.time_s, knots.angle_rev, knots.speed_rpm) + seen.first_rev
    error = angle - seen.motion.at(time_s)[0]
    told = np.interp(time_s, knots.time_s, knots.standard_error_rev)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(np.sqrt(np.mean(told**2)), rel=0.02)


def test_at_a_pulse_the_model_adds_nothing_to_the_error() -> None:
    seen = square_wave(turning(1003.7, fires=False))
    knots, _ = seen.with_model(engine())
    told = np.interp(np.arange(50.0, 150.0), knots.angle_rev, knots.standard_error_rev)
    between = np.interp(np.arange(50.0, 150.0) + 0.25, knots.angle_rev, knots.standard_error_rev)
    assert told.max() < 1.05 * seen.plain().standard_error_rev[5:-5].min()
    assert between.min() > 1.2 * told.max()


def test_filled_knots_give_the_mean_angle_back() -> None:
    order = np.array([0.5, 1.0, 2.3])
    lag = Lag(order=order, inertia=np.array([0, 4e-3j, 1e-3]), gas=np.array([5e-3, 0, 1e-3j]), reference_rpm=900.0)
    time_s = np.linspace(0.0, 6.0, 100)
    mean = AngleKnots(time_s, 20 * time_s + time_s**2, 1200.0 + 120.0 * time_s, np.full(100, 1e-7), np.inf, 0.0)
    knots = filled(mean, lag, teeth_per_rev=1.0, tdc_rev=0.3)
    at = np.linspace(0.5, 5.5, 999)
    crank = angle_at(at, knots.time_s, knots.angle_rev, knots.speed_rpm)
    rpm = 1200.0 + 120.0 * at
    behind = np.array([float(lag.at(angle - 0.3, speed)) for angle, speed in zip(crank, rpm, strict=True)])
    np.testing.assert_allclose(crank + behind, 20 * at + at**2, atol=2e-7)


@pytest.mark.parametrize("per_rev", [1.0, 3.0, 7.5, 16.0])
@pytest.mark.parametrize("orders", [(0.5, 1.0, 20.5), (0.5, 2.3)])
def test_parts_of_the_lag_are_its_sum_and_slope(per_rev: float, orders: tuple[float, ...]) -> None:
    order = np.array(orders)
    lag = Lag(order=order, inertia=1e-3j / order, gas=2e-3 * np.exp(1j * order), reference_rpm=900.0)
    step = np.arange(-7, 40)
    angle = step / per_rev - 0.21
    inertia, gas, slope, gas_slope = lag_parts(lag, step, per_rev=per_rev, zero_rev=0.21)
    np.testing.assert_allclose(inertia + 4.0 * gas, lag.at(angle, 450.0), atol=1e-14)
    rise = (lag.at(angle + 1e-6, 450.0) - lag.at(angle - 1e-6, 450.0)) / 2e-6
    np.testing.assert_allclose(slope + 4.0 * gas_slope, rise, atol=1e-8)


def test_the_mean_rate_of_an_even_run_up_is_its_speed() -> None:
    time_s = np.linspace(0.0, 10.0, 2001)
    tooth = np.arange(180)
    pulse_s = np.interp(tooth, 10 * time_s + time_s**2 / 1.1, time_s)
    rate = mean_rate(pulse_s, tooth, teeth_per_rev=1.0)
    np.testing.assert_allclose(rate, 10 + 2 * pulse_s / 1.1, rtol=3e-3)


def test_without_a_lag_pulse_times_stay() -> None:
    none = Lag(order=np.array([1.0]), inertia=np.zeros(1, dtype=complex), gas=np.zeros(1, dtype=complex))
    time_s = np.cumsum(np.linspace(0.05, 0.06, 50))
    got = mean_pulse_times(time_s, np.arange(50), none, teeth_per_rev=1.0, tdc_rev=0.2)
    np.testing.assert_array_equal(got, time_s)


def test_knots_below_the_slowest_speed_of_the_lag_are_refused() -> None:
    lag = Lag(order=np.array([1.0]), inertia=np.zeros(1, dtype=complex), gas=np.array([0.1 + 0j]), reference_rpm=900.0)
    time_s = np.linspace(0.0, 2.0, 20)
    knots = AngleKnots(time_s, 10 * time_s, np.full(20, 600.0), np.full(20, 1e-6), np.inf, 0.0)
    with pytest.raises(RequestError, match="stop within the cycle"):
        filled(knots, lag, teeth_per_rev=1.0, tdc_rev=0.0)
