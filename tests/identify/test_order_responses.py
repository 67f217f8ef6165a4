"""Blocks of orders: what is linear is eliminated, the law of the force and its scatter are told from the data."""

import numpy as np
import pytest

from crankorder.identify.found import ModalFit
from crankorder.identify.modes.order_responses import Block, Rows, project, with_best_law, with_scatter
from crankorder.identify.modes.responses import held_amplitudes, responses_of, with_and_without
from made.found_lines import mode, poles_of

TRUE = poles_of((mode(60.0, 0.02), mode(75.0, 0.01)))
ORDER = 3.0


def _response(speed, residue, rigid):
    """Acceleration of the modes of TRUE, by their transfer functions."""
    s = 2j * np.pi * ORDER * speed / 60.0
    made = np.full(len(speed), rigid, dtype=complex)
    for hz, zeta, part in zip((60.0, 75.0), (0.02, 0.01), residue, strict=True):
        w = 2.0 * np.pi * hz
        made += part * s**2 / (s**2 + 2.0 * zeta * w * s + w**2)
    return made


def _block(seed, *, exponent=2.0, scatter=0.0, error=1e-3):
    """A block whose force is (s / 1800)^exponent, its residues (C, 2) and rigid parts (C,)."""
    random = np.random.default_rng(seed)
    speed = np.linspace(600.0, 1800.0, 60)
    residue = random.normal(size=(3, 2)) + 1j * random.normal(size=(3, 2))
    rigid = random.normal(size=3) + 1j * random.normal(size=3)
    force = (speed / 1800.0) ** exponent
    force = force * (1.0 + scatter * (random.normal(size=60) + 1j * random.normal(size=60)))
    truth = np.stack([force * _response(speed, part, direct) for part, direct in zip(residue, rigid, strict=True)])
    noise = error * (random.normal(size=truth.shape) + 1j * random.normal(size=truth.shape))
    errors = np.full(truth.shape, error)
    block = Block.of(Rows(ORDER, ("a", "b", "c"), ORDER * speed / 60.0, speed, truth + noise, errors))
    return block, residue, rigid


@pytest.mark.parametrize("exponent", [0.0, 1.0, 3.0])
def test_the_power_by_which_the_force_grows_is_told(exponent):
    told = with_best_law(_block(1, exponent=exponent)[0], TRUE)
    assert (told.force.exponent, told.degree, len(told.force.law)) == (exponent, 0, 0)


@pytest.mark.parametrize("scatter", [0.005, 0.1])
def test_the_scatter_of_the_force_is_told_without_bias(scatter):
    found = [with_scatter(_block(seed, scatter=scatter)[0], TRUE)[0].scatter for seed in range(40)]
    assert np.mean(found) == pytest.approx(scatter, rel=0.08)
    # 54 complex numbers tell a standard deviation within a tenth
    assert np.std(found) < 0.2 * scatter


def test_a_channel_that_is_missing_at_some_speeds_takes_part_with_the_others():
    block, residue, _ = _block(4)
    block.rows.error[1, ::3], block.rows.amplitude[1, ::3] = np.inf, 0.0
    part = project(block, TRUE)
    assert np.abs(part.linear[:, 1:] - residue).max() < 0.02
    assert part.degrees_of_freedom == 2 * (3 * 60 - 20 - 9)


def test_the_response_of_a_fit_is_that_of_the_machine_at_any_speed_with_and_without_a_mode():
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
            off = np.abs([two.with_mode[0] - truth, two.without[0] - without])
            assert off.max() < 2e-3 * truth.max()
