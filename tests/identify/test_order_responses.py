"""Blocks of orders: what is linear is eliminated, the law of the force and its scatter are told from the data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from crankorder.identify.found import ModalFit
from crankorder.identify.modal import order_responses
from crankorder.identify.modal.order_responses import (
    Block,
    Blocks,
    Projected,
    as_real,
    jacobian,
    project,
    responses_of,
    with_best_law,
    with_scatter,
)
from crankorder.identify.modal.order_terms import NUMBERS as ORDER_TERMS
from crankorder.identify.modal.order_terms import orthonormal, scatter_of
from crankorder.identify.modal.surface_fit import NO_POLES, Poles
from crankorder.identify.responses import held_amplitudes, with_and_without
from made.found_lines import mode, poles_of

TRUE = poles_of((mode(60.0, 0.02), mode(75.0, 0.01)))
ORDER = 3.0


def _response(speed: NDArray, residue: NDArray, rigid: complex) -> NDArray:
    """Acceleration of the modes of TRUE, by their transfer functions."""
    s = 2j * np.pi * ORDER * speed / 60.0
    made = np.full(len(speed), rigid, dtype=complex)
    for hz, zeta, part in zip((60.0, 75.0), (0.02, 0.01), residue, strict=True):
        w = 2.0 * np.pi * hz
        made += part * s**2 / (s**2 + 2.0 * zeta * w * s + w**2)
    return made


def _block(
    seed: int, *, speeds: int = 60, exponent: float = 2.0, bend: complex = 0.0, scatter: float = 0.0,
    error: float = 1e-3, power: bool = False,
) -> tuple[Block, NDArray, NDArray]:  # fmt: skip
    """A block whose force is (s / 1800)^exponent e^(bend ln²(s / 1800)), its residues (C, 2) and rigid parts (C,)."""
    random = np.random.default_rng(seed)
    speed = np.linspace(600.0, 1800.0, speeds)
    residue = random.normal(size=(3, 2)) + 1j * random.normal(size=(3, 2))
    rigid = random.normal(size=3) + 1j * random.normal(size=3)
    force = (speed / 1800.0) ** exponent * np.exp(bend * np.log(speed / 1800.0) ** 2)
    force = force * (1.0 + scatter * (random.normal(size=speeds) + 1j * random.normal(size=speeds)))
    truth = np.stack([force * _response(speed, part, direct) for part, direct in zip(residue, rigid, strict=True)])
    noise = error * (random.normal(size=truth.shape) + 1j * random.normal(size=truth.shape))
    errors = np.full(truth.shape, error)
    seen = truth + noise
    if power:
        errors = 2.0 * error * np.maximum(np.abs(seen), error)
        seen = np.abs(seen) ** 2 - 2.0 * error**2 + 0j
    block = Block(ORDER, ("a", "b", "c"), ORDER * speed / 60.0, speed, seen, errors, 1800.0, power=power)
    return block, residue, rigid


def test_linear_terms_are_recovered_within_their_errors() -> None:
    chi2 = []
    for seed in range(40):
        block, residue, rigid = _block(seed, error=0.1)  # beside it the scatter that is always granted is nothing
        part = project(block, TRUE)
        wanted = np.concatenate([rigid[:, None], residue], axis=1)
        off = part.linear - wanted
        for channel in range(3):
            inverse = np.linalg.inv(part.covariance[channel])
            chi2.append(float((off[channel].conj() @ inverse @ off[channel]).real))
        assert part.chi2 == pytest.approx(part.degrees_of_freedom, abs=5.0 * np.sqrt(2.0 * part.degrees_of_freedom))
    # 3 complex terms: 6 squares of standard normals, whose variance is 12
    assert np.mean(chi2) == pytest.approx(6.0, abs=4.0 * np.sqrt(12.0 / len(chi2)))


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0, 3.0])
def test_the_power_by_which_the_force_grows_is_told(exponent: float) -> None:
    for seed in range(4):
        block, _, _ = _block(seed, exponent=exponent)
        told = with_best_law(block, TRUE)
        assert told.exponent == exponent, seed
        assert (told.degree, len(told.law)) == (0, 0), seed


@pytest.mark.parametrize("bend", [0.6, -0.5 + 0.4j, 0.8j])
def test_a_force_that_follows_no_power_is_followed_within_the_noise(bend: complex) -> None:
    for seed in range(4):
        block, _, _ = _block(seed, bend=bend)
        told, part = with_scatter(with_best_law(block, TRUE), TRUE)
        assert told.scatter < 5e-3, seed
        fitted = np.where(told.weight > 0.0, told.amplitude, 0.0) - part.left / told.weight
        assert np.abs(fitted - block.amplitude).max() < 0.02 * np.abs(block.amplitude).max()


@pytest.mark.parametrize("scatter", [0.005, 0.02, 0.1])
def test_the_scatter_of_the_force_is_told_without_bias(scatter: float) -> None:
    found = []
    for seed in range(40):
        block, _, _ = _block(seed, scatter=scatter)
        found.append(with_scatter(block, TRUE)[0].scatter)
    assert np.mean(found) == pytest.approx(scatter, rel=0.08)
    # 54 complex numbers tell a standard deviation within a tenth
    assert np.std(found) < 0.2 * scatter


def test_noise_alone_is_no_scatter() -> None:
    found = [with_scatter(_block(seed, error=0.02)[0], TRUE)[0].scatter for seed in range(40)]
    assert np.median(found) < 0.01


@pytest.mark.parametrize("power", [False, True])
def test_the_slopes_of_the_residuals_are_those_of_differences(power: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    # the law of the force stays as it is
    monkeypatch.setitem(ORDER_TERMS.__dict__, "enough_degrees_of_freedom", 10**9)
    block, _, _ = _block(3, error=0.05, power=power)
    poles = Poles(np.array([60.4, 74.5]), np.array([0.025, 0.012]), np.zeros(2, dtype=bool))
    (slopes,), (left,), cost = Blocks((block,)).evaluate(poles)
    assert cost == pytest.approx(float(left @ left))
    step = 1e-6
    for number in range(2):
        for column, field in ((2 * number, "frequency_hz"), (2 * number + 1, "damping")):
            moved = [getattr(poles, field) * np.exp(sign * step * (np.arange(2) == number)) for sign in (1.0, -1.0)]
            costs = [Blocks((block,)).misfit(replace(poles, **{field: value})) for value in moved]
            change = (costs[0] - costs[1]) / (2.0 * step)
            # variable projection after Kaufman: the slope of the squares is exact at any point
            assert -2.0 * float(slopes[:, column] @ left) == pytest.approx(change, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("power", [False, True])
def test_what_the_law_of_the_force_can_make_up_for_is_no_slope_of_a_pole(power: bool) -> None:
    block, _, _ = _block(3, error=0.05, power=power)
    (slopes,), (left,), _ = Blocks((block,)).evaluate(TRUE)
    step = 1e-5
    (bent,) = Blocks((replace(block, law=(step,)),)).evaluate(TRUE)[1]
    bend = (bent - left) / step
    assert np.linalg.norm(slopes.T @ bend) < 1e-3 * np.linalg.norm(slopes) * np.linalg.norm(bend)


def test_squares_of_modes_with_real_residues_lie_in_the_span_of_their_columns() -> None:
    """The square is even in the frequency, with two simple poles for each mode: a constant and two columns each."""
    random = np.random.default_rng(5)
    speed = np.linspace(600.0, 1800.0, 80)
    for _ in range(10):
        rigid, one, other = random.normal(size=3).tolist()
        square = (speed / 1800.0) ** 4 * np.abs(_response(speed, np.array([one, other]), rigid)) ** 2
        block = Block(
            ORDER, ("a",), ORDER * speed / 60.0, speed, square[None].astype(complex), np.full((1, 80), 1e-3), 1800.0,
            power=True,
        )  # fmt: skip
        part = project(block, TRUE)
        assert np.abs(part.left / block.weight).max() < 1e-9 * square.max()


def test_squares_without_a_phase_tell_the_same_poles() -> None:
    block, _, _ = _block(2, power=True)
    right = project(block, TRUE).chi2
    for poles in (NO_POLES, poles_of((mode(61.0, 0.02), mode(75.0, 0.01))), poles_of((mode(60.0, 0.03), mode(75.0)))):
        assert project(block, poles).chi2 > 10.0 * right


def test_a_channel_that_is_missing_at_some_speeds_takes_part_with_the_others() -> None:
    block, residue, _ = _block(4)
    error = block.error.copy()
    error[1, ::3] = np.inf
    amplitude = block.amplitude.copy()
    amplitude[1, ::3] = 0.0
    part = project(replace(block, error=error, amplitude=amplitude), TRUE)
    assert np.abs(part.linear[:, 1:] - residue).max() < 0.02
    assert part.degrees_of_freedom == 2 * (3 * 60 - 20 - 9)


def test_the_response_of_a_fit_is_that_of_the_machine_at_any_speed_with_and_without_a_mode() -> None:
    block, residue, rigid = _block(6, error=1e-4)
    modes = (mode(60.0, 0.02), mode(75.0, 0.01))
    responses = responses_of([block], TRUE)
    modal = ModalFit(modes, (), np.zeros((4, 4)), responses=responses)
    at = np.linspace(650.0, 1790.0, 37)
    for row, response in enumerate(responses):
        assert response.channel == "abc"[row] and response.fits
        truth = (at / 1800.0) ** 2 * np.abs(_response(at, residue[row], rigid[row]))
        seen = held_amplitudes(response, at, modal)[0]
        assert np.abs(seen - truth).max() < 2e-3 * truth.max()
        for number in range(2):
            two = with_and_without(response, number, at, modal)
            others = np.where(np.arange(2) == number, 0.0, residue[row])
            without = (at / 1800.0) ** 2 * np.abs(_response(at, others, rigid[row]))
            assert np.abs(two.with_mode[0] - truth).max() < 2e-3 * truth.max()
            assert np.abs(two.without[0] - without).max() < 2e-3 * truth.max()


@pytest.mark.parametrize(("rows", "terms"), [(40, 1), (40, 6), (6, 6), (4, 6)])
def test_orthonormal_bases_are_those_of_numpy(rows: int, terms: int) -> None:
    random = np.random.default_rng(rows + terms)
    columns = random.normal(size=(3, rows, terms)) + 1j * random.normal(size=(3, rows, terms))
    basis, triangle = orthonormal(columns)
    expected = np.linalg.qr(columns)
    np.testing.assert_allclose(basis, expected[0], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(np.triu(triangle), expected[1], rtol=0.0, atol=1e-12)


def _halved_plainly(squared: NDArray, error: NDArray, size: NDArray, freedom: int) -> tuple[float, float]:
    """Scatter and noise by twenty halvings one after the other."""

    def too_little(scatter: float, noise: float) -> bool:
        return bool(np.sum(squared / (noise**2 * error + scatter**2 * size)) > freedom)

    by_scatter = too_little(ORDER_TERMS.least_scatter, 1.0)
    if not by_scatter and freedom < ORDER_TERMS.enough_degrees_of_freedom:
        return ORDER_TERMS.least_scatter, 1.0
    first, last = (
        (np.log(ORDER_TERMS.least_scatter), np.log(1e3)) if by_scatter else (np.log(ORDER_TERMS.least_noise_share), 0.0)
    )
    for _ in range(20):
        middle = 0.5 * (first + last)
        at = float(np.exp(middle))
        below = too_little(at, 1.0) if by_scatter else too_little(ORDER_TERMS.least_scatter, at)
        first, last = (middle, last) if below else (first, middle)
    told = float(np.exp(0.5 * (first + last)))
    return (told, 1.0) if by_scatter else (ORDER_TERMS.least_scatter, told)


@pytest.mark.parametrize("seed", range(12))
def test_scatter_is_that_of_plain_halving(seed: int) -> None:
    random = np.random.default_rng(seed)
    error, size = random.uniform(0.5, 2.0, 120) ** 2, random.uniform(1.0, 50.0, 120) ** 2
    scatter, noise = ((0.2, 1.0), (1e-4, 0.3), (30.0, 1.0), (0.0, 1e-3))[seed % 4]
    squared = (noise**2 * error + scatter**2 * size) * random.chisquare(2, 120)
    for freedom in (20, 120, 200):
        assert scatter_of(squared, error, size, freedom) == pytest.approx(
            _halved_plainly(squared, error, size, freedom), rel=1e-12
        )


def _plain_jacobian(block: Block, poles: Poles, part: Projected) -> NDArray:
    """Derivatives as real rows, the law taken out as real columns, nothing kept from before."""
    degree = max(len(block.law), 1)
    linear = part.linear[:, block.degree + 1 :]
    made = np.zeros((*block.amplitude.shape, 2 * len(poles)), dtype=complex)
    for offset, slope in enumerate(block.modal_slopes(poles.frequency_hz[part.reached], poles.damping[part.reached])):
        turned = (slope[None] * linear[:, None]).reshape(*block.amplitude.shape, len(part.reached), -1).sum(axis=3)
        made[..., 2 * part.reached + offset] = turned * block.weight[..., None]
    shapes = order_responses.smooth_shapes(block.speed_rpm, block.span_rpm, degree)[:, 1:]
    fitted = block.amplitude * block.weight - part.left
    bent = fitted[..., None] * shapes
    made, bent = (x - part.basis @ (np.swapaxes(part.basis, 1, 2).conj() @ x) for x in (made, bent))
    columns = as_real(bent if block.power else np.concatenate([bent, 1j * bent], axis=2), block)
    rows = as_real(made, block)
    return np.asarray(rows - columns @ np.linalg.lstsq(columns, rows, rcond=None)[0])


@pytest.mark.parametrize("power", [False, True])
@pytest.mark.parametrize("law", [(), (0.2 + 0.1j, -0.1j)])
def test_the_slopes_are_those_of_the_plain_formula(power: bool, law: tuple[complex, ...]) -> None:
    law = tuple(item.real for item in law) if power else law
    block = replace(_block(5, bend=0.1, power=power)[0], law=law, degree=1)
    poles = Poles(np.array([59.0, 76.0, 500.0]), np.array([0.03, 0.02, 0.01]), np.zeros(3, dtype=bool))
    part = project(block, poles)
    expected = _plain_jacobian(block, poles, part)
    np.testing.assert_allclose(jacobian(block, poles, part), expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def _fresh(block: Block) -> Block:
    """``block`` with nothing kept from before."""
    return Block(**{item.name: getattr(block, item.name) for item in fields(Block)})


@pytest.mark.parametrize("power", [False, True])
def test_what_a_block_keeps_is_what_it_would_work_out_anew(power: bool) -> None:
    block = _block(6, scatter=0.02, power=power)[0]
    changes: list[Callable[[Block], Block]] = [
        lambda now: now.varied(scatter=0.05),
        lambda now: now.varied(noise=0.5),
        lambda now: now.varied(exponent=1.0),
        lambda now: now.varied(degree=2),
        lambda now: now.varied(law=(0.1, -0.05)),
        lambda now: now.varied(degree=0),
    ]
    for number, change in enumerate(changes * 2):
        block = change(block)
        for hz in (58.0, 59.0, 900.0 + number):
            poles = Poles(np.array([hz, 75.0, 800.0 + number]), np.array([0.02, 0.01, 0.01]), np.zeros(3, dtype=bool))
            kept, anew = project(block, poles), project(_fresh(block), poles)
            assert kept.reached.tolist() == anew.reached.tolist()
            assert kept.chi2 == pytest.approx(anew.chi2, rel=1e-12)
            np.testing.assert_allclose(kept.linear, anew.linear, rtol=1e-9)
            np.testing.assert_array_equal(block.weight, _fresh(block).weight)
