"""Natural frequencies that only orders show: found where speeds reach them, within their errors, and never invented."""

from dataclasses import replace

import numpy as np
import pytest

from crankorder.identify.found import AgreedOrder
from crankorder.identify.modes import order_search
from crankorder.identify.modes.joint_fit import modal_fit, mode_of
from crankorder.identify.modes.order_responses import Block, Rows
from crankorder.identify.modes.order_search import poles_of_orders, settled
from crankorder.identify.modes.surface_fit import NO_POLES
from made.drawn_orders import DrawnMachine, DrawnOrder, blocks_from, drawn_machine
from made.floors import no_orders
from made.shipped import IDENTIFY
from made.structures import RATE_HZ, drawn, recorded

SAME = 0.01
"""Share of a frequency, or the damping ratio where it is larger, within which two poles are one."""


def _modes(blocks):
    laid, poles, _ = poles_of_orders(blocks, NO_POLES, np.zeros((0, 0)), settings=IDENTIFY)
    told = settled(laid, NO_POLES, poles)
    parts = [told.covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(len(told.found))]
    every = NO_POLES
    for pole in told.found:
        every = every.with_pole(pole.frequency_hz, pole.damping)
    found = [mode_of(pole, part, every, settings=IDENTIFY) for pole, part in zip(told.found, parts, strict=True)]
    return [item for item in found if item is not None]


@pytest.mark.parametrize(("seed", "draws", "power"), [(0, {}, False), (1, {"n_modes": (1, 2)}, True)])
def test_modes_that_orders_sweep_through_are_found_within_their_errors_by_phases_and_by_squares(seed, draws, power):
    """Found is each mode of which two rows of one order lie within two half widths."""
    machine = drawn_machine(seed, **draws)
    found = _modes(blocks_from(machine, seed, power=power))
    known = []
    for number, (f, zeta) in enumerate(zip(machine.natural_hz.tolist(), machine.damping.tolist(), strict=True)):
        same = [item for item in found if abs(item.frequency_hz - f) < max(SAME, zeta) * f]
        known += same
        if machine.rows_within(number, 2.0) >= 2:
            best = min(same, key=lambda item: abs(item.frequency_hz - f))
            if not best.undecided:
                assert abs(best.frequency_hz - f) < 5.0 * best.frequency_error_hz
                assert abs(best.damping_ratio - zeta) < 5.0 * best.damping_error
    assert all(item in known or item.undecided for item in found)


def test_smooth_forces_whose_size_scatters_have_no_mode():
    for seed, scatter in enumerate((0.1, 0.02, 0.0)):
        assert _modes(blocks_from(drawn_machine(seed, n_modes=(0, 0), scatter=(scatter,)), seed)) == [], seed


def test_a_force_that_peaks_without_the_phase_of_a_resonance_is_no_decided_mode():
    speed, random = np.linspace(600.0, 3000.0, 61), np.random.default_rng(0)
    for width in (0.01, 0.1):
        at, each = random.uniform(1200.0, 2400.0), random.normal(size=(3, 1)) + 1j * random.normal(size=(3, 1))
        peaked = (speed / 3000.0) ** 2 * (1.0 + 3.0 * np.exp(-0.5 * (np.log(speed / at) / width) ** 2))
        noise = 0.003 * (random.normal(size=(3, 61)) + 1j * random.normal(size=(3, 61)))
        rows = Rows(2.0, ("X", "Y", "Z"), 2.0 * speed / 60.0, speed, each * peaked + noise, np.full((3, 61), 0.003))
        assert not [item for item in _modes([Block.of(rows)]) if not item.undecided], width


@pytest.mark.parametrize(("factor", "seed"), [(1.3, 0), (0.2, 2)])
def test_one_speed_at_which_a_force_differs_makes_no_decided_mode(factor, seed):
    machine = drawn_machine(seed, n_modes=(0, 0), scatter=(0.005,))
    blocks = blocks_from(machine, seed)
    for block in blocks:
        block.rows.amplitude[:, 11] *= factor * np.exp(1j * seed)
    assert not [item for item in _modes(blocks) if not item.undecided]


def _by_order_one(natural_hz, damping):
    rigid, residue = np.full(3, 0.1 + 0j), np.ones((3, len(natural_hz)), dtype=complex)
    order = DrawnOrder(order=1.0, still=0.0, power=2.0, turn=0.0, rigid=rigid, residue=residue)
    return DrawnMachine(
        natural_hz=np.array(natural_hz), damping=np.array(damping), speed_rpm=np.arange(1800.0, 5701.0, 60.0),
        orders=(order,), error=0.003, scatter=0.0,
    )  # fmt: skip


def test_one_order_that_sweeps_through_both_flanks_with_its_phase_tells_a_mode():
    made = _by_order_one((61.0, 91.0), (0.08, 0.025))
    found = _modes(blocks_from(made, 0))
    assert len(found) == 2
    for mode, f, zeta in zip(found, made.natural_hz, made.damping, strict=True):
        assert abs(mode.frequency_hz - f) <= 4.0 * mode.frequency_error_hz
        assert abs(mode.damping_ratio - zeta) <= 4.0 * mode.damping_error
        assert mode.frequency_error_hz < 0.02 * f
        assert "order 1 has amplitude and phase of a resonance" in mode.evidence
    assert "at the end of what was swept" in found[1].undecided
    assert found[0].undecided == ""


def test_a_mode_far_above_what_is_swept_and_noise_in_place_of_an_order_invent_none():
    for natural_hz in (110.0, 150.0, 300.0):
        assert _modes(blocks_from(_by_order_one((natural_hz,), (0.02,)), 1)) == []
    (block,) = blocks_from(_by_order_one((61.0,), (0.08,)), 0)
    for seed in range(10):
        random, ones = np.random.default_rng(seed), np.ones(block.rows.amplitude.shape)
        noise = random.normal(size=ones.shape) + 1j * random.normal(size=ones.shape)
        assert _modes([Block.of(replace(block.rows, amplitude=noise, error=ones))]) == []


def test_a_search_that_stops_at_its_bound_says_so(monkeypatch):
    blocks = blocks_from(_by_order_one((61.0,), (0.08,)), 1)
    settings = IDENTIFY.model_copy(update={"max_damping_ratio": 0.2})
    for most, ends in ((0, False), (1, False), (9, True)):
        monkeypatch.setitem(vars(order_search.NUMBERS), "most_starts", most)
        *_, ended = poles_of_orders(blocks, NO_POLES, np.zeros((0, 0)), settings=settings)
        assert ended == ends


# Lightly damped modes and tones: a tone only where the data exclude a width, and both side by side.


def fitted(campbell, made):
    """Modal fit of the floor alone, the orders known."""
    orders = tuple(AgreedOrder(float(order), 1e-5, 30.0, "locked", None, ()) for order in made.order)
    return modal_fit(campbell, no_orders(campbell), orders, settings=IDENTIFY)


def with_light_mode(seed, *, n_speeds, near_hz, damping):
    """Structure of ``seed`` with a light mode, its lowest, somewhere in ``near_hz``."""
    random = np.random.default_rng([seed, 99])
    made = drawn(seed, n_speeds=n_speeds, n_modes=2, damping=(0.01, 0.04), lowest_hz=110.0)
    zeta = np.exp(random.uniform(*np.log(damping)))
    return replace(
        made, natural_hz=np.insert(made.natural_hz, 0, random.uniform(*near_hz)),
        damping=np.insert(made.damping, 0, zeta), shape=np.insert(made.shape, 0, 1.0, axis=0),
        drive=np.insert(made.drive, 0, [0.0, 0.0, random.uniform(1.0, 4.0)], axis=0),
        order_force=np.insert(made.order_force, 1, made.order_force[:, 1], axis=1),
    )  # fmt: skip


def with_tone(made, frequency_hz, over_db):
    """``made`` with a tone that in half a hertz has ``over_db`` more power than noise of 0.3 per sample."""
    size = np.sqrt(2.0 * 2.0 * 0.3**2 / RATE_HZ * 10.0 ** (over_db / 10.0))
    return replace(made, tones=((frequency_hz, float(size)),), wander_hz=0.01)


@pytest.mark.parametrize(("seed", "n_speeds"), [(50, 3), (51, 12)])
def test_a_light_mode_at_a_few_speeds_is_never_a_tone(seed, n_speeds):
    made = with_light_mode(seed, n_speeds=n_speeds, near_hz=(30.0, 90.0), damping=(0.002, 0.01))
    fit = fitted(recorded(made, seed), made)
    near = [mode for mode in fit.modes if abs(mode.frequency_hz - made.natural_hz[0]) < 1.0]
    assert all(mode.undecided == "" or mode.undecided.startswith(("tone or mode", "its damping")) for mode in near)
    assert not [tone for tone in fit.tones if abs(tone.frequency_hz - made.natural_hz[0]) < 2.0]


@pytest.mark.parametrize(("seed", "mains", "away", "over_db"), [(985, 50.0, -0.04, 25.0), (1070, 60.0, 0.03, 40.0)])
def test_a_mode_beside_mains_is_found_with_them(seed, mains, away, over_db):
    frequency = mains * (1.0 + away)
    made = with_light_mode(seed, n_speeds=12, near_hz=(frequency, frequency + 1e-6), damping=(0.006, 0.02))
    fit = fitted(recorded(with_tone(made, mains, over_db), seed), made)
    (tone,) = [tone for tone in fit.tones if abs(tone.frequency_hz - mains) < 0.1]
    assert tone.kind == "mains"
    (mode,) = [mode for mode in fit.modes if abs(mode.frequency_hz - mains) < 5.0]
    assert mode.undecided == ""
    assert abs(mode.frequency_hz - frequency) <= 4.0 * mode.frequency_error_hz
    assert abs(mode.damping_ratio - made.damping[0]) <= 4.0 * mode.damping_error
