"""Locked, slipping or undecided, and how long one must measure to tell."""

import numpy as np
import pytest
import xarray as xr

from crankorder.identify.found import AgreedOrder, ModalFit, Mode, OrderResponse
from crankorder.identify.lines.line_phasors import lock_of, proves_speed, revs_to_decide
from crankorder.identify.modes.order_blocks import blocks_of, with_locks_through_modes


def lock(order, error, **given):
    return lock_of(order, error, 30.0, **({"revs_per_cycle": 2, "by_phase": True} | given))


def test_a_number_is_locked_slips_or_is_undecided_by_its_interval_its_phase_and_the_cycle():
    wanted = [
        (5.5002, 2e-4, {}, "locked"),
        (5.489, 2e-4, {}, "slips"),
        (4.75, 2e-4, {}, "slips"),
        (5.498, 3e-3, {}, "undecided"),
        (5.5, 1e-5, {"by_phase": False}, "undecided"),
        (5.5, 1e-4, {"revs_per_cycle": 1}, "undecided"),  # exact, as of what rubs or is loose, but no multiple
        (5.489, 1e-4, {"revs_per_cycle": 1}, "slips"),
    ]
    assert [row for row in wanted if lock(row[0], row[1], **row[2]) != row[3]] == []


@pytest.mark.parametrize(("relative", "span"), [(0.1, 16.0), (0.01, 16.0), (0.05, 100.0)])
def test_after_the_revolutions_needed_the_interval_is_narrow_enough(relative, span):
    needed = revs_to_decide(5.5, relative_error=relative, span_rev=span, revs_per_frame=16)
    then = relative * np.sqrt(span / needed) * np.sqrt(12.0) / (2 * np.pi * needed)  # noise averages with the length
    assert lock(5.5, then * 0.99) == "locked" or needed == 32.0


# A speed that no pulses tell, proven by orders that stand on multiples; never by orders of another shaft.


ERROR = 3e-6


def _numbers(orders, share, rng):
    return [(order * (1.0 + share + ERROR * rng.standard_normal()), order * ERROR, 50.0) for order in orders]


def test_orders_on_multiples_alone_prove_the_speed_and_one_that_slips_does_not_disturb():
    rng = np.random.default_rng(0)
    judged = [
        (_numbers((0.5, 4.5, 11.0), 0.0, rng), True),
        ([*_numbers((2.0, 3.5), 0.0, rng), (5.4356, 1e-5, 50.0)], True),
        *((_numbers((2.0, 3.5, 6.0), share, rng), False) for share in (3e-4, -1e-3, 4e-3)),  # off, or it slips
        ([(4.0, 4 * ERROR, 50.0)], False),
        ([(4.0, 1e-3, 50.0), (6.5, 1e-3, 50.0)], False),
    ]
    assert [row for row in judged if proves_speed(row[0], revs_per_cycle=2) != row[1]] == []


@pytest.mark.slow
def test_shafts_that_slip_behind_a_speed_that_errs_hardly_ever_prove_it():
    rng, proven = np.random.default_rng(2), 0
    for _ in range(3000):
        slip = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.001), np.log(0.05)))
        share = (1.0 + slip) * (1.0 + 0.002 * rng.standard_normal()) - 1.0
        proven += proves_speed(_numbers((2.0, 4.0), share, rng), revs_per_cycle=2)
    assert proven <= 6  # of these a tenth of all tests at most


# Locks that a sweep through modes proves: never of an order that slips, whatever modes and forces turn.


ORDER_MAP = xr.Dataset(attrs={"revs_per_cycle": 2})
BANDWIDTH_HZ, NOISE = 5.0, 0.02


def _followed(order, revs, bandwidth_hz):
    """An order of amplitude 1 followed from 900 to 3000 rpm in so many ``revs``."""
    duration_s = 60.0 * revs / 1950.0
    time = np.arange(0.2, duration_s - 0.2, 0.5 / bandwidth_hz)
    speed = 900.0 + 2100.0 * time / duration_s
    angle = (900.0 * time + 1050.0 * time**2 / duration_s) / 60.0
    rows, one = ("channel", "order", "frame"), np.ones((1, 1, len(time)))
    frames = {name: ("frame", of) for name, of in (("time", time), ("speed", speed), ("crank_angle", angle))}
    return xr.Dataset(
        {"held_amplitude": (rows, one.astype(complex)), "standard_error": (rows, NOISE * one)},
        {"channel": ["X"], "order": [order], **frames, "bandwidth_hz": (rows[1:], bandwidth_hz * one[0])},
        {"recording": "r1", "swept": 1, "phase_reference": "index"},
    )


def _scene(rng, slip, *, revs=800.0, bandwidth_hz=BANDWIDTH_HZ):
    """An order through two modes that slips by the share ``slip``, with the fit of what modes and force do to it."""
    order = float(rng.choice([1.5, 2.0, 3.0, 5.5]))
    agreed = AgreedOrder(order, 0.01, 1e6, "undecided", 30.0, ())
    item = _followed(order, revs, bandwidth_hz)
    (block,) = blocks_of(ORDER_MAP, (agreed,), [item])
    rows = np.flatnonzero(np.isin(item["speed"].values, block.rows.speed_rpm))
    hz = order * np.array([rng.uniform(1000, 1600), rng.uniform(1800, 2800)]) / 60.0
    damping = np.exp(rng.uniform(np.log(0.005), np.log(0.05), 2))
    smooth, residue = np.array([1.0 + 0.0j]), 0.3 * (rng.normal(size=2) + 1j * rng.normal(size=2))
    value = block.smooth() @ smooth + block.modal(hz, damping) @ residue
    turned = np.exp(1j * rng.normal() * 0.1 * np.linspace(-1.0, 1.0, len(value)))
    run_away = np.exp(2j * np.pi * slip * order * item["crank_angle"].values[rows])
    noise = NOISE * (rng.standard_normal(len(value)) + 1j * rng.standard_normal(len(value)))
    item["held_amplitude"].values[0, 0, rows] = value * turned * run_away + noise
    modes = tuple(
        Mode(float(f), 1e-4 * float(f), float(z), 0.01 * float(z), ("X",), 20.0, "")
        for f, z in zip(hz, damping, strict=True)
    )
    covariance = 1e-4 * np.eye(3, dtype=complex)
    response = OrderResponse(
        order, "X", block.force, smooth, residue, np.arange(2),
        covariance, 100, NOISE, True, "r1",
    )  # fmt: skip
    return agreed, ModalFit(modes, (), np.zeros((4, 4)), (response,)), item


@pytest.mark.slow
@pytest.mark.parametrize("slip", [0.0, 0.0015, 0.003, -0.003, 0.01])
def test_an_order_is_proven_locked_with_its_records_where_it_does_not_slip(slip):
    for seed in range(6):
        agreed, modal, item = _scene(np.random.default_rng(seed), slip)
        (told,), fit = with_locks_through_modes((agreed,), modal, [item], ORDER_MAP)
        assert told.lock == ("undecided" if slip else "locked")
        assert told.order == agreed.order == fit.responses[0].order


@pytest.mark.slow
def test_a_sweep_of_few_turns_and_one_without_a_fit_tell_nothing():
    # a bandwidth as a sweep so fast asks for: rows enough to be looked at
    agreed, modal, item = _scene(np.random.default_rng(3), 0.0, revs=40.0, bandwidth_hz=40.0)
    for fit in (modal, ModalFit(modal.modes, (), modal.covariance)):
        (told,), _ = with_locks_through_modes((agreed,), fit, [item], ORDER_MAP)
        assert told is agreed
