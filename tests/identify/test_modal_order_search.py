"""Natural frequencies that only orders show: found where speeds reach them, within their errors, and never invented."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from crankorder.identify.found import AgreedOrder
from crankorder.identify.modes import order_search
from crankorder.identify.modes.joint_fit import modal_fit, mode_of
from crankorder.identify.modes.order_responses import Block, Rows, resonance
from crankorder.identify.modes.order_search import poles_of_orders, settled
from crankorder.identify.modes.surface_fit import NO_POLES
from crankorder.settings import load_settings
from made.drawn_orders import DrawnMachine, DrawnOrder, blocks_from, drawn_machine
from made.floors import no_orders
from made.structures import RATE_HZ, drawn, recorded, swept_up, with_pair

Array = NDArray[np.float64]


SETTINGS = load_settings().identify
SAME = 0.01
"""Share of a frequency, or the damping ratio where it is larger, within which two poles are one."""


def _modes(blocks):
    laid, poles, _ = poles_of_orders(blocks, NO_POLES, np.zeros((0, 0)), settings=SETTINGS)
    told = settled(laid, NO_POLES, poles)
    parts = [told.covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(len(told.found))]
    every = NO_POLES
    for pole in told.found:
        every = every.with_pole(pole.frequency_hz, pole.damping)
    found = [mode_of(pole, part, every, settings=SETTINGS) for pole, part in zip(told.found, parts, strict=True)]
    return [item for item in found if item is not None]


@pytest.mark.parametrize(
    ("seed", "draws", "power"),
    [*((seed, {}, False) for seed in range(8)), *((seed, {"n_modes": (1, 2)}, True) for seed in range(4))],
)
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


@pytest.mark.cases(1)
@pytest.mark.parametrize("scatter", [0.1, 0.02, 0.005, 0.0])
def test_smooth_forces_whose_size_scatters_have_no_mode(scatter):
    for seed in range(3):
        assert _modes(blocks_from(drawn_machine(seed, n_modes=(0, 0), scatter=(scatter,)), seed)) == [], seed


def _one_order(seed, shape, speed):
    """Block of order 2 whose complex amplitude in three channels is ``shape`` times a number of each, with noise."""
    random = np.random.default_rng(seed)
    each = random.normal(size=(3, 1)) + 1j * random.normal(size=(3, 1))
    noise = 0.003 * (random.normal(size=(3, len(speed))) + 1j * random.normal(size=(3, len(speed))))
    error = np.full(noise.shape, 0.003)
    return [Block.of(Rows(2.0, ("X", "Y", "Z"), 2.0 * speed / 60.0, speed, each * shape + noise, error))]


@pytest.mark.cases(1)
@pytest.mark.parametrize(("width", "seed"), [(width, seed) for width in (0.01, 0.03, 0.1) for seed in range(4)])
def test_a_force_that_peaks_without_the_phase_of_a_resonance_is_no_decided_mode(width, seed):
    speed = np.linspace(600.0, 3000.0, 61)
    at = np.random.default_rng(seed).uniform(1200.0, 2400.0)
    peaked = (speed / 3000.0) ** 2 * (1.0 + 3.0 * np.exp(-0.5 * (np.log(speed / at) / width) ** 2))
    found = _modes(_one_order(seed, peaked.astype(complex), speed))
    assert not [item for item in found if not item.undecided], found


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "seed"), list(zip((1.3, 3.0, 0.2) * 2, range(6), strict=True)))
def test_one_speed_at_which_a_force_differs_makes_no_decided_mode(factor, seed):
    random = np.random.default_rng(seed)
    machine = drawn_machine(seed, n_modes=(0, 0), scatter=(0.005,))
    blocks = blocks_from(machine, seed)
    row = int(random.integers(2, len(machine.speed_rpm) - 2))
    turned = factor * np.exp(2j * np.pi * random.random())
    for block in blocks:
        block.rows.amplitude[:, row] *= turned
    assert not [item for item in _modes(blocks) if not item.undecided]


def _by_order_one(natural_hz, damping):
    rigid, residue = np.full(3, 0.1 + 0j), np.ones((3, len(natural_hz)), dtype=complex)
    order = DrawnOrder(order=1.0, still=0.0, power=2.0, turn=0.0, rigid=rigid, residue=residue)
    return DrawnMachine(
        natural_hz=np.array(natural_hz), damping=np.array(damping), speed_rpm=np.arange(1800.0, 5701.0, 60.0),
        orders=(order,), error=0.003, scatter=0.0,
    )  # fmt: skip


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(5))
def test_one_order_that_sweeps_through_both_flanks_with_its_phase_tells_a_mode(seed):
    made = _by_order_one((61.0, 91.0), (0.08, 0.025))
    found = _modes(blocks_from(made, seed))
    assert len(found) == 2
    for mode, f, zeta in zip(found, made.natural_hz, made.damping, strict=True):
        assert abs(mode.frequency_hz - f) <= 4.0 * mode.frequency_error_hz
        assert abs(mode.damping_ratio - zeta) <= 4.0 * mode.damping_error
        assert mode.frequency_error_hz < 0.02 * f
        assert "order 1 has amplitude and phase of a resonance" in mode.evidence
    assert "at the end of what was swept" in found[1].undecided
    assert found[0].undecided == ""


def _light_between(seed):
    """Block of one order past one light mode that two to four of its rows lie near, and the mode's frequency."""
    random = np.random.default_rng([seed, 7])
    speed = np.linspace(900.0, 900.0 * random.uniform(1.8, 3.5), int(random.integers(14, 40)))
    speed += 0.1 * (speed[1] - speed[0]) * random.uniform(-1.0, 1.0, len(speed))
    hertz, x = 3.0 * speed / 60.0, speed / speed[-1]
    f = float(hertz[4] * (hertz[-5] / hertz[4]) ** random.random())
    h = resonance(hertz, np.array([f]), np.array([np.exp(random.uniform(np.log(0.002), np.log(0.01)))]))[:, 0]
    shares = random.normal(size=(2, 2, 1)) + 1j * random.normal(size=(2, 2, 1)) * np.array([[[1.0]], [[0.0]]])
    grown = (random.uniform(0.0, 1.0) + x ** random.uniform(1.0, 2.5)) * np.exp(0.3j * random.uniform(-1.0, 1.0) * x)
    amplitude = (shares[0] + shares[1] * h) * grown
    error = 0.005 * float(np.median(np.abs(amplitude)))
    amplitude = amplitude + error * (random.normal(size=amplitude.shape) + 1j * random.normal(size=amplitude.shape))
    return Block.of(Rows(3.0, ("X", "Y"), hertz, speed, amplitude, np.full(amplitude.shape, error))), f


@pytest.mark.slow
def test_one_order_proves_a_light_mode_between_coarse_speeds_by_its_flanks():
    decided = 0
    for seed in range(8):
        block, f = _light_between(seed)
        found = _modes([block])
        assert all(abs(item.frequency_hz / f - 1.0) < SAME for item in found if not item.undecided), seed
        decided += any(not item.undecided for item in found)
    assert decided >= 6


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 2])
def test_a_peak_of_a_row_or_two_is_no_proof_without_its_flanks(rows):
    """A mode whose peak alone is left over smooth flanks, as a force that differs there makes it, is not decided."""
    for seed in range(6):
        block, f = _light_between(seed)
        seen = block.rows
        random = np.random.default_rng([seed, 11])
        at = np.argsort(np.abs(seen.frequency_hz - f))[:rows]
        smooth = 0.5 + np.linspace(0.0, 1.0, seen.amplitude.shape[1]) ** 2 + 0.0j
        made = np.median(np.abs(seen.amplitude), axis=1, keepdims=True) * smooth
        made[:, at] *= seen.amplitude[:, at] / np.median(np.abs(seen.amplitude), axis=1, keepdims=True)
        made += seen.error * (random.normal(size=made.shape) + 1j * random.normal(size=made.shape))
        found = _modes([Block.of(replace(seen, amplitude=made))])
        assert not [item for item in found if not item.undecided], seed


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
    settings = SETTINGS.model_copy(update={"max_damping_ratio": 0.2})
    for most, ends in ((0, False), (1, False), (9, True)):
        monkeypatch.setitem(vars(order_search.NUMBERS), "most_starts", most)
        *_, ended = poles_of_orders(blocks, NO_POLES, np.zeros((0, 0)), settings=settings)
        assert ended == ends


@pytest.mark.slow
def test_a_mode_that_is_known_is_not_found_again():
    blocks = blocks_from(_by_order_one((61.0,), (0.08,)), 1)
    known = NO_POLES.with_pole(61.0, 0.08)
    laid, poles, _ = poles_of_orders(blocks, known, np.diag([1e-4, 1e-6] * len(known)), settings=SETTINGS)
    assert poles == ()
    proofs = settled(laid, known, poles).proofs
    assert proofs[0].orders == (1.0,) and proofs[0].most_rows > 5


# Lightly damped modes and tones: a tone only where the data exclude a width, and both side by side.


def fitted(campbell, made):
    """Modal fit of the floor alone, the orders known."""
    orders = tuple(AgreedOrder(float(order), 1e-5, 30.0, "locked", None, ()) for order in made.order)
    return modal_fit(campbell, no_orders(campbell), orders, settings=SETTINGS)


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


@pytest.mark.parametrize(
    ("seed", "n_speeds", "seconds"),
    [
        *((seed + 50, n_speeds, 0.0) for n_speeds in (3, 12) for seed in range(5)),
        *(pytest.param(seed, 2, seconds, marks=pytest.mark.slow) for seconds in (30.0, 60.0) for seed in range(3)),
    ],
)
def test_a_light_mode_at_a_few_speeds_or_in_a_run_up_is_never_a_tone(seed, n_speeds, seconds):
    made = with_light_mode(seed, n_speeds=n_speeds, near_hz=(30.0, 90.0), damping=(0.002, 0.01))
    fit = fitted(swept_up(made, seed, seconds=seconds) if seconds else recorded(made, seed), made)
    near = [mode for mode in fit.modes if abs(mode.frequency_hz - made.natural_hz[0]) < 1.0]
    assert all(mode.undecided == "" or mode.undecided.startswith(("tone or mode", "its damping")) for mode in near)
    assert not seconds or len(near) == 1
    assert not [tone for tone in fit.tones if abs(tone.frequency_hz - made.natural_hz[0]) < 2.0]


@pytest.mark.cases(1)
@pytest.mark.parametrize("over_db", [15.0, 25.0, 40.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_steady_tone_at_twelve_speeds_is_a_tone_and_no_mode(seed, over_db):
    made = drawn(seed + 30, n_speeds=12, n_modes=2, damping=(0.01, 0.04), lowest_hz=110.0)
    frequency = float(np.random.default_rng([seed, 97]).uniform(30.0, 90.0))
    fit = fitted(recorded(with_tone(made, frequency, over_db), seed), made)
    assert len([tone for tone in fit.tones if abs(tone.frequency_hz - frequency) < 0.2]) == 1
    assert not [mode for mode in fit.modes if abs(mode.frequency_hz - frequency) < 3.0]


@pytest.mark.cases(1)
@pytest.mark.parametrize("over_db", [25.0, 32.0, 40.0])
@pytest.mark.parametrize("away", [-0.04, -0.03, 0.03, 0.04])
def test_a_mode_beside_mains_is_found_with_them(away, over_db):
    seed = round(1000.0 + 1000.0 * away + over_db)
    mains = 50.0 if seed % 2 else 60.0
    frequency = mains * (1.0 + away)
    made = with_light_mode(seed, n_speeds=12, near_hz=(frequency, frequency + 1e-6), damping=(0.006, 0.02))
    fit = fitted(recorded(with_tone(made, mains, over_db), seed), made)
    (tone,) = [tone for tone in fit.tones if abs(tone.frequency_hz - mains) < 0.1]
    assert tone.kind == "mains"
    (mode,) = [mode for mode in fit.modes if abs(mode.frequency_hz - mains) < 5.0]
    assert mode.undecided == ""
    assert abs(mode.frequency_hz - frequency) <= 4.0 * mode.frequency_error_hz
    assert abs(mode.damping_ratio - made.damping[0]) <= 4.0 * mode.damping_error


@pytest.mark.slow
def test_a_line_too_weak_to_show_its_width_is_tone_or_mode():
    """At three speeds neither its width nor its scatter tells: it says so, and the largest damping that it may have."""
    said = []
    for seed in range(6):
        made = drawn(seed + 80, n_speeds=3, n_modes=2, damping=(0.01, 0.04), lowest_hz=110.0)
        fit = fitted(recorded(with_tone(made, 57.3, 12.0), seed), made)
        said += [mode.undecided for mode in fit.modes if abs(mode.frequency_hz - 57.3) < 0.5]
        assert not [mode for mode in fit.modes if abs(mode.frequency_hz - 57.3) < 3.0 and not mode.undecided]
    assert said and all(words.startswith("tone or mode") for words in said)


@pytest.mark.accuracy
def test_two_modes_three_half_widths_apart_are_two():
    told = []
    for seed in range(9):
        one = drawn(seed + 900, n_speeds=12, n_modes=1, damping=(0.004, 0.01), lowest_hz=60.0, highest_hz=200.0)
        made = with_pair(one, 3.0)
        modes = fitted(recorded(made, seed), made).modes
        told.append(sum(abs(mode.frequency_hz - made.natural_hz[0]) < 6.0 for mode in modes) == 2)
    assert np.mean(told) >= 0.85
