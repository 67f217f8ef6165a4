"""What strong lines leak: no cell of the floor holds it, at however few speeds."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.modes.floor import quiet_floor
from crankorder.identify.modes.search import search
from made.floors import Made, campbell_of

pytestmark = pytest.mark.slow


def _made(speeds: tuple[float, ...], amplitude: float) -> Made:
    return Made(
        natural_hz=(300.0,),
        damping=(0.02,),
        sensor=((0.0,),),
        drive=((0.0,),),
        speed_rpm=speeds,
        lines=((6.0, amplitude),),
        duration_s=6.0,
        noise=1e-3,
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("speeds", [(1113.5,), (1113.5, 2467.0), (573.0, 1541.0, 2475.0)])
def test_the_skirts_of_a_giant_line_are_no_floor_and_no_mode(speeds: tuple[float, ...], seed: int) -> None:
    """130 dB over the noise of a bin a Hann window leaks over sixty bins."""
    campbell = campbell_of(_made(speeds, 10.0 ** np.random.default_rng(seed).uniform(2.0, 3.3)), seed)
    floor = quiet_floor(campbell, ((6.0, 1e-6),))
    assert floor is not None
    level = np.nanmedian(floor.cells)
    assert np.nanmax(floor.cells) < 12.0 * level  # some noise of some six frames
    assert np.isfinite(floor.psd).mean() > 0.5
    _, fit, _ = search(floor, chance=1e-3)
    assert not len(fit.poles)


def test_a_line_leaks_though_the_frames_that_hold_it_are_taken_for_a_start() -> None:
    campbell = campbell_of(_made((1200.0, 2400.0), 300.0), 5)
    bins = np.flatnonzero(np.abs(campbell["frequency"].values - 120.0) < 4.0)
    none = np.full((1, 2, len(bins)), np.nan)
    moved = campbell.assign(
        settled_psd=(("channel", "speed", "settled_frequency"), none),
        settled_share=(("channel", "speed", "settled_frequency"), np.zeros(none.shape)),
    ).assign_coords(settled_frequency=campbell["frequency"].values[bins])
    floor = quiet_floor(moved, ((6.0, 1e-6),))
    assert floor is not None
    beside = np.abs(floor.frequency_hz - 120.0) < 12.0
    assert not np.isfinite(floor.cells[0, 0, beside]).any()
