"""Close lines of a sweep: the weaker is found where there is one, and none is made up where a mode is crossed."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.lines.swept_orders import company_of
from crankorder.orders.frames import order_frames
from crankorder.orders.like_speed import reframed
from crankorder.settings import load_settings
from made.swept_machines import drawn, recorded

SETTINGS = load_settings()


@pytest.mark.parametrize("seed", range(3))
def test_a_mode_that_is_crossed_is_no_second_line(seed):
    rng = np.random.default_rng(seed)
    machine = drawn(rng, rpm=(600.0, 4000.0), duration_s=60.0)
    frames = order_frames(*recorded(machine, rng), settings=SETTINGS.orders)
    for revs in (32, 64, 128):
        item = reframed(frames, revs)
        assert item is not None
        others = [float(order) for order in machine.orders]
        found = [company_of(order, item, others) for order in others]
        assert np.isnan(found).all(), (revs, others, found)
