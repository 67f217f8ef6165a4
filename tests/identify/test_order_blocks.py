"""What orders give to a modal fit: amplitudes with phases, squares where these say nothing, or nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from crankorder.identify.modal.order_blocks import blocks_of
from made.drawn_orders import CHANNELS, drawn_machine, orders_and_map

MACHINE = drawn_machine(1, n_orders=(3, 3), error=1e-3)


def test_orders_with_phases_of_one_mark_are_complex_amplitudes_with_their_errors() -> None:
    agreed, order_map = orders_and_map(MACHINE, 1)
    blocks = blocks_of(order_map, agreed)
    assert [block.order for block in blocks] == [item.order for item in MACHINE.orders]
    for number, block in enumerate(blocks):
        assert not block.power and block.channels == CHANNELS and block.passage is None
        assert block.frequency_hz == pytest.approx(block.order * MACHINE.speed_rpm / 60.0)
        assert np.abs(block.amplitude - MACHINE.measured(1)[number]).max() < 1e-12
        # Student's t of 400 degrees of freedom has a variance of 400 / 398
        assert block.error == pytest.approx(1e-3 * np.sqrt(400.0 / 398.0))


@pytest.mark.parametrize("attrs", [{"phase_reference": "none"}, {"cycle_known": 0}])
def test_where_phases_do_not_compare_signs_are_free_or_squares_stand_for_them(attrs: dict) -> None:
    agreed, order_map = orders_and_map(MACHINE, 1)
    blocks = blocks_of(order_map.assign_attrs(order_map.attrs | attrs), agreed)
    for number, block in enumerate(blocks):
        half = block.order % 1.0 != 0.0  # whole orders are told by a mark in whichever turn of the cycle
        assert block.power == ("phase_reference" in attrs)
        assert block.sign_free == (half and not block.power)
        if block.sign_free:
            turned = block.amplitude / MACHINE.measured(1)[number]
            assert np.abs(np.abs(turned) - 1.0).max() < 1e-9 and np.abs(turned - turned[:1]).max() < 1e-9
            assert np.abs(turned.imag).max() < 1e-9
        if block.power:
            truth = np.abs(MACHINE.amplitude(number, MACHINE.speed_rpm)) ** 2
            off = (block.amplitude.real - truth) / np.hypot(block.error, 2.0 * MACHINE.scatter * truth)
            assert np.sqrt(np.mean(off**2)) == pytest.approx(1.0, abs=0.25)


def test_a_line_that_slips_gives_its_squares() -> None:
    agreed, order_map = orders_and_map(MACHINE, 1)
    blocks = blocks_of(order_map, tuple(replace(item, lock="slips") for item in agreed))
    assert blocks and all(block.power and len(block.channels) == 1 for block in blocks)
    assert len(blocks) == sum(len(item.lines) for item in agreed)


def test_channels_that_show_nothing_and_orders_at_too_few_speeds_give_nothing() -> None:
    agreed, order_map = orders_and_map(MACHINE, 1)
    order_map["coherent_amplitude"][1] = 1e-4
    assert all(block.channels == ("X", "Z") for block in blocks_of(order_map, agreed))
    few = order_map.isel(speed=slice(0, 3))
    assert blocks_of(few, agreed) == ()


def test_a_speed_that_is_missing_in_one_channel_counts_for_the_others() -> None:
    agreed, order_map = orders_and_map(MACHINE, 1)
    order_map["coherent_amplitude"][0, 4] = np.nan
    for block in blocks_of(order_map, agreed):
        assert np.isinf(block.error[0, 4]) and np.isfinite(block.error[1:, 4]).all()
        assert np.isfinite(block.amplitude).all()
        assert block.rows.tolist() == [len(MACHINE.speed_rpm) - 1, *[len(MACHINE.speed_rpm)] * 2]
