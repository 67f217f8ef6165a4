"""Sidebands, meshes and shafts of their own: lines that other lines explain."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from crankorder.identify.explain import multiple_of_cycle
from crankorder.identify.found import AgreedOrder, OrderLine
from crankorder.identify.lines.agreed_orders import sideband_of, unless_sidebands
from crankorder.identify.sidebands import sidebands, swing_sidebands
from crankorder.orders.true_angle import HALF_ORDERS, SHOWN
from made.found_lines import agreed, line


def test_a_line_alone_lines_stronger_than_their_carrier_and_lopsided_lines_are_no_sidebands():
    three = [2.317, 3.317, 4.317]
    for places, amplitudes in ((three[:2], [0.3, 1.0]), (three, [2.0, 1.0, 2.0]), ([2.3, *three[1:]], [0.3, 1.0, 0.3])):
        assert sidebands(places, [1e-3] * len(places), amplitudes, spacings={"shaft": 1.0}, highest=20.0) == []


def test_lines_that_lie_anywhere_are_seldom_called_sidebands():
    rng = np.random.default_rng(5)
    false = 0
    for _ in range(400):
        places, amplitudes = rng.uniform(0.5, 20.0, 6).tolist(), rng.uniform(0.1, 1.0, 6).tolist()
        false += bool(sidebands(places, [2e-3] * 6, amplitudes, spacings={"shaft": 1.0, "half": 0.5}, highest=20.0))
    assert false <= 24  # 3 % are seen; 6 % would be too many


@pytest.mark.parametrize("seed", range(3))
def test_what_a_swing_of_the_shaft_makes_through_a_mode_is_no_order_of_its_own(seed):
    rng = np.random.default_rng(seed)
    natural_hz, damping = rng.uniform(60.0, 200.0), rng.uniform(0.005, 0.05)
    number, half_orders = float(rng.integers(3, 9)), int(rng.integers(1, 5))
    rpm = np.linspace(600.0, 3000.0, 400) if seed % 2 else np.linspace(600.0, 3000.0, 6)
    swing_rev = rng.uniform(0.005, 0.03) / (np.pi * half_orders) * (600.0 / rpm) ** 2

    def response(order):
        x = order * rpm / 60.0 / natural_hz
        return (rpm / 1000.0) ** 2 / (1.0 - x**2 + 2j * damping * x)

    shown = np.zeros((rpm.size, 1 + HALF_ORDERS), dtype=complex)
    shown[:, 0], shown[:, half_orders] = rpm, swing_rev
    frames = xr.Dataset(coords={"order": [20.0]}, attrs={SHOWN: shown.view(float).ravel()})
    side = number + rng.choice([-0.5, 0.5]) * half_orders
    made = np.pi * number * swing_rev * np.abs(response(side) - response(number))
    strong = agreed(number, line(number, np.abs(response(number)), speed_rpm=rpm, error=0.0))
    told = [
        swing_sidebands([strong, agreed(side, line(side, amplitude, speed_rpm=rpm, error=0.0))], [frames])
        for amplitude in (made, 0.5 * np.abs(response(side)))
    ]
    assert [len(words) for words in told] == [1, 0]


# Lines that the rounded edges of an encoder make beside a strong order.


REVS = 32


def _line(order, amplitude):
    at, one = np.zeros(1, dtype=np.int64), np.ones(1)
    size = np.array([amplitude])
    return OrderLine("X", order, 1e-3, at, 1200.0 * one, size, 0.1 * size, one, one, "steady, not locked", 20.0)


def test_no_sideband_of_rounded_edges_is_a_line_for_sure_and_a_larger_one_is():
    """Order 9 read over edges that are rounded to the samples of the recording: 60 teeth, some 280 samples a turn."""
    random = np.random.default_rng(0)
    samples_per_rev = float(random.uniform(150.0, 600.0))
    teeth, per_rev = 60, 240
    edge = np.arange(teeth * REVS + 1) / teeth
    read = np.round(edge * samples_per_rev + random.random()) / samples_per_rev
    angle = np.arange(per_rev * REVS) / per_rev
    true = np.interp(angle, edge, read)  # where the shaft was when the reader thought it was at `angle`
    window = np.hanning(len(true) + 1)[:-1]
    size = 2.0 * np.abs(np.fft.rfft(np.cos(2.0 * np.pi * 9.0 * true) * window))[: 16 * REVS] / window.sum()
    axis = np.arange(len(size)) / REVS
    error = float(np.std(read - edge))
    order_map = xr.Dataset(
        {"amplitude": (("channel", "speed", "order"), size[None, None])},
        coords={"channel": ["X"], "speed": [1200.0], "order": axis},
        attrs={"speed_bin_rpm": 25.0},
    )
    frames = [xr.Dataset({"speed": ("frame", np.full(4, 1200.0))}, attrs={"angle_error_rev": error})]
    ghosts = np.flatnonzero((size > 1e-4) & (np.abs(axis - 9.0) > 0.2))
    assert len(ghosts) > 5 and size[ghosts].max() > 3e-3
    assert all(sideband_of([_line(axis[k], size[k])], order_map, frames) == 9.0 for k in ghosts.tolist())
    large = 4.0 * 9.0 * error
    assert sideband_of([_line(7.3, large)], order_map, frames) is None
    exact = [frames[0].assign_attrs(angle_error_rev=0.0)]
    assert sideband_of([_line(7.3, 1e-3)], order_map, exact) is None


@pytest.mark.parametrize(("seen", "size", "is_own"), [((3,), 0.01, False), ((3,), 5.0, True), ((0, 1, 3), 0.01, True)])
def test_only_what_is_larger_or_seen_at_most_speeds_keeps_its_lock_and_its_number(seen, size, is_own):
    axis, rpm = np.arange(400) / REVS, 1000.0 + 100.0 * np.arange(4)
    amplitude = np.where(np.abs(axis - 9.0) < 1e-9, 1.0, 0.0)[None, None].repeat(4, axis=1)
    order_map = xr.Dataset(
        {"amplitude": (("channel", "speed", "order"), amplitude)},
        coords={"channel": ["X"], "speed": rpm, "order": axis},
    )
    frames = [xr.Dataset({"speed": ("frame", rpm)}, attrs={"angle_error_rev": 1e-3})]
    at, sizes = np.array(seen), np.full(len(seen), size)
    line = replace(_line(8.5, size), seen=at, speed_rpm=rpm[at], amplitude=sizes, amplitude_error=0.1 * sizes)
    agreed = AgreedOrder(8.5, 1e-4, 30.0, "locked", None, (line,))
    (kept,) = unless_sidebands([agreed], order_map, frames)
    assert (kept.lock, multiple_of_cycle(kept, 2)) == (("locked", 8.5) if is_own else ("undecided", None))
