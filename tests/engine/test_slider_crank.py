"""The kinematics against 60-digit arithmetic and the derivatives of its own motion."""

from decimal import Decimal, getcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.engine.slider_crank import (
    SliderCrank,
    dead_centres,
    piston_acceleration,
    piston_drop,
    piston_velocity,
    plain_piston_acceleration,
    rod_angle,
)
from crankorder.errors import RequestError

getcontext().prec = 60
PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459")
THESIS = SliderCrank(crank_radius_m=0.0449, rod_length_m=0.152, offset_m=0.010)
SHAPES = st.builds(
    lambda ratio, share: SliderCrank(crank_radius_m=ratio, rod_length_m=1.0, offset_m=share * (1 - ratio)),
    st.floats(0.01, 0.9),
    st.floats(-0.8, 0.8),
)


def decimal_sine_cosine(angle: Decimal) -> tuple[Decimal, Decimal]:
    sums, term = [Decimal(0), Decimal(0)], Decimal(1)
    for k in range(1, 120):
        sums[(k - 1) % 2] += term * (-1) ** ((k - 1) // 2)
        term *= angle / k
    return sums[1], sums[0]


def decimal_acceleration(revolutions: float, mechanism: SliderCrank) -> Decimal:
    sine, cosine = decimal_sine_cosine(2 * PI * Decimal(revolutions))
    radius, rod, offset = (Decimal(x) for x in (mechanism.crank_radius_m, mechanism.rod_length_m, mechanism.offset_m))
    across, slope = radius * sine - offset, radius * cosine
    along = (rod * rod - across * across).sqrt()
    return radius * cosine + (slope**2 - across * radius * sine) / along + across**2 * slope**2 / along**3


@pytest.mark.parametrize("slack", [0.7, 1e-2, 1e-6, 1e-9, 1e-12])
def test_the_acceleration_keeps_its_digits_however_short_the_rod(slack: float) -> None:
    mechanism = SliderCrank(crank_radius_m=1 - slack, rod_length_m=1.0)
    kappa = np.sqrt(slack * (2 - slack))
    angles = np.concatenate([np.linspace(0, 1, 41), 0.25 + kappa * np.linspace(-1, 1, 21), [0.75 + 3 * kappa / 7]])
    exact = np.array([float(decimal_acceleration(float(angle), mechanism)) for angle in angles])
    peak = max(2 - slack, (1 - slack) / kappa)
    assert np.abs(piston_acceleration(angles, mechanism) - exact).max() <= 1e-15 * peak


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.01, -0.03])
def test_the_acceleration_with_offset_agrees_with_sixty_digits(offset: float) -> None:
    mechanism = SliderCrank(crank_radius_m=0.0449, rod_length_m=0.152, offset_m=offset)
    angles = np.linspace(-1, 2, 61)
    exact = np.array([float(decimal_acceleration(float(angle), mechanism)) for angle in angles])
    assert np.abs(piston_acceleration(angles, mechanism) - exact).max() <= 1e-15 * np.abs(exact).max()


def decimal_motion(revolutions: float, mechanism: SliderCrank) -> dict[str, Decimal]:
    """Drop, velocity, sine of the rod angle and its derivatives, straight from the definitions."""
    sine, cosine = decimal_sine_cosine(2 * PI * Decimal(revolutions))
    radius, rod, offset = (Decimal(x) for x in (mechanism.crank_radius_m, mechanism.rod_length_m, mechanism.offset_m))
    across, slope = radius * sine - offset, radius * cosine
    along, top = (rod * rod - across * across).sqrt(), (rod * rod - offset * offset).sqrt()
    return {
        "drop": radius + top - radius * cosine - along,
        "velocity": -radius * sine - across * slope / along,
        "rod_sine": across / rod,
        "rod_first": slope / along,
        "rod_second": -radius * sine / along + across * slope**2 / along**3,
    }


@pytest.mark.parametrize("slack", [0.7, 1e-2, 1e-6, 1e-12])
@pytest.mark.parametrize("share", [0.0, 0.5, -0.5])
def test_position_velocity_and_rod_angle_keep_their_own_digits_however_short_the_rod(
    slack: float, share: float
) -> None:
    mechanism = SliderCrank(crank_radius_m=1 - slack, rod_length_m=1.0, offset_m=share * slack)
    angles = np.concatenate([np.arange(1, 8) / 8, np.linspace(0, 1, 38)[1:-1], 0.25 + 1e-3 * np.linspace(-1, 1, 9)])
    exact = [decimal_motion(float(angle), mechanism) for angle in angles]
    psi, first, second = rod_angle(angles, mechanism)
    computed = {
        "drop": piston_drop(angles, mechanism),
        "velocity": piston_velocity(angles, mechanism),
        "rod_sine": np.sin(psi),
        "rod_first": first,
        "rod_second": second,
    }
    for name, values in computed.items():
        known = np.array([float(row[name]) for row in exact])
        sizes = np.where(np.abs(known) < 1e-40, 1.0, np.abs(known))  # an exact zero has no relative error
        assert np.abs((values - known) / sizes).max() < (2e-15 if share == 0 else 5e-15), name


@given(SHAPES, st.floats(-1e4, 1e4))
def test_the_compiled_acceleration_is_that_of_plain_numpy(mechanism: SliderCrank, start: float) -> None:
    angles = start + np.linspace(0, 1.5, 997)
    plain = plain_piston_acceleration(angles, mechanism)
    assert np.abs(piston_acceleration(angles, mechanism) - plain).max() <= 2e-15 * np.abs(plain).max()


@pytest.mark.slow
def test_every_form_of_call_gives_the_same_acceleration() -> None:
    angles = np.linspace(0, 3, 240)
    known = piston_acceleration(angles, THESIS)
    frozen = angles.copy()
    frozen.flags.writeable = False
    assert np.array_equal(piston_acceleration(angles.reshape(4, 60).T, THESIS), known.reshape(4, 60).T)
    assert np.array_equal(piston_acceleration(frozen, THESIS), known)
    assert np.array_equal(piston_acceleration(list(angles), THESIS), known)
    assert piston_acceleration(angles[7], THESIS) == known[7]
    assert np.array_equal(
        piston_acceleration(np.float32([0.125, 0.5]), THESIS), piston_acceleration([0.125, 0.5], THESIS)
    )


@given(SHAPES)
def test_the_piston_turns_at_its_dead_centres_a_stroke_apart(mechanism: SliderCrank) -> None:
    turns = dead_centres(mechanism)
    there = np.array([turns.top_rev, turns.bottom_rev])
    assert np.abs(piston_velocity(there, mechanism)).max() < 1e-14 / mechanism.slack
    drop = piston_drop(there, mechanism)
    assert drop[1] - drop[0] == pytest.approx(turns.stroke_m, rel=1e-13)
    every = piston_drop(np.linspace(0, 1, 3601), mechanism)
    assert drop[0] <= every.min() + 1e-15
    assert every.max() <= drop[1] + 1e-15
    assert turns.stroke_m >= 2 * mechanism.crank_radius_m * (1 - 1e-15)


@given(SHAPES)
def test_velocity_and_acceleration_are_the_derivatives_of_the_drop(mechanism: SliderCrank) -> None:
    n = 8192  # spectral differentiation of one turn: exact for a smooth periodic function
    angles = np.arange(n) / n
    factor = 1j * np.arange(n // 2 + 1)
    drop = np.fft.rfft(piston_drop(angles, mechanism))
    velocity = piston_velocity(angles, mechanism)
    scale = np.abs(piston_acceleration(angles, mechanism)).max()
    assert np.abs(np.fft.irfft(factor * drop, n) + velocity).max() < 1e-8 * scale
    slope = np.fft.irfft(factor * np.fft.rfft(velocity), n)
    assert np.abs(slope + piston_acceleration(angles, mechanism)).max() < 1e-8 * scale


@given(SHAPES)
def test_rod_angle_and_its_derivatives_belong_together(mechanism: SliderCrank) -> None:
    n = 8192
    angles = np.arange(n) / n
    psi, first, second = rod_angle(angles, mechanism)
    closing = mechanism.crank_radius_m * np.sin(2 * np.pi * angles) - mechanism.offset_m
    factor = 1j * np.arange(n // 2 + 1)
    scale = np.abs(second).max() + 1
    assert np.abs(mechanism.rod_length_m * np.sin(psi) - closing).max() < 1e-15
    assert np.abs(np.fft.irfft(factor * np.fft.rfft(psi), n) - first).max() < 1e-8 * scale
    assert np.abs(np.fft.irfft(factor * np.fft.rfft(first), n) - second).max() < 1e-8 * scale


def test_a_whole_turn_changes_nothing() -> None:
    angles = np.arange(256) / 256
    assert np.array_equal(piston_acceleration(angles + 1000, THESIS), piston_acceleration(angles, THESIS))


def test_a_crank_that_cannot_turn_is_refused() -> None:
    impossible = [(0.1, 0.1, 0.0), (0.1, 0.15, 0.06), (-0.1, 0.3, 0.0), (float("nan"), 0.3, 0.0), (0.0, 0.3, 0.0)]
    for radius, rod, offset in impossible:
        with pytest.raises(RequestError, match="rod longer than radius and offset"):
            SliderCrank(crank_radius_m=radius, rod_length_m=rod, offset_m=offset)
