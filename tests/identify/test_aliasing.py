"""Fixed frequencies that fold into a test sampled by crank angle are told; a test sampled by time has none."""

import numpy as np
import xarray as xr

from crankorder.identify.lines.line_evidence import alias_flags as flags_of_aliases
from crankorder.identify.lines.line_evidence import shown_aliases
from crankorder.shaft.aliasing import aliased_order
from made.found_lines import line
from made.shipped import SETTINGS

SPEEDS = np.arange(1150.0, 1260.0, 10.0)


def alias_flags(order_map, settings):
    return flags_of_aliases(order_map, settings=settings, folds=shown_aliases(order_map, settings=settings))


def map_with(frequency_hz, *, samples_per_rev=360.0, amplitude=1.0):
    """OrderMap of noise and of one line of fixed frequency, placed by the sampling theorem."""
    axis = np.arange(0.0, 20.0, 1 / 16)
    noise = np.random.default_rng(1).gamma(40.0, 1 / 40.0, size=(1, SPEEDS.size, axis.size))
    energy = 1e-6 * noise
    shown = aliased_order(60 * frequency_hz / SPEEDS, 360.0)
    for at, order in enumerate(shown):
        nearest = round(order * 16)
        if nearest < axis.size:
            energy[0, at, nearest] += amplitude**2
    attrs = {"revs_per_cycle": 2} | ({} if samples_per_rev is None else {"samples_per_rev": samples_per_rev})
    return xr.Dataset(
        {
            "amplitude": (("channel", "speed", "order"), np.sqrt(energy)),
            "n_independent": ("speed", np.full(SPEEDS.size, 40.0)),
        },
        coords={"order": axis, "speed": SPEEDS, "channel": ["Z"]},
        attrs=attrs,
    )


def test_a_harmonic_of_mains_that_folds_is_named():
    asked = SETTINGS.identify.model_copy(update={"mains_hz": (3600.0,), "fold_search_hz": 8000.0})
    settings = SETTINGS.model_copy(update={"identify": asked})
    flags = {flag["flag"]: flag for flag in alias_flags(map_with(7200.0), settings)}
    assert "7200" in flags["folded_frequency"]["detail"]
    assert flags["folded_frequency"]["severity"] == "suspect"


def test_what_may_fold_is_told_of_every_test_by_crank_angle_and_of_no_other():
    quiet = map_with(7200.0, amplitude=0.0)
    assert [flag["flag"] for flag in alias_flags(quiet, SETTINGS)] == ["lines_may_fold"]
    assert "3450 to 3750 Hz" in alias_flags(quiet, SETTINGS)[0]["detail"]
    coarse = alias_flags(map_with(7200.0, amplitude=0.0, samples_per_rev=36.0), SETTINGS)[0]["detail"]
    assert "; mains, 400 Hz shows at order 15.13 (1150 rpm)" in coarse  # 36 - 60 x 400 / 1150
    assert alias_flags(map_with(7200.0, samples_per_rev=None), SETTINGS) == []
    unknown = map_with(7200.0).assign_coords(speed=np.full(SPEEDS.size, np.nan))
    assert alias_flags(unknown, SETTINGS) == []


def test_a_fold_is_the_cause_of_a_line_that_lies_on_it_and_of_no_other():
    made = map_with(7200.0).isel(speed=[5])  # 1200 rpm: order 360, where it shows at order 0: no line
    assert shown_aliases(made, settings=SETTINGS) == ()
    whole = map_with(7200.0)
    (shown,) = shown_aliases(whole, settings=SETTINGS)
    at = int(np.argmax(shown.order))
    near = line(float(shown.order[at]), speed_rpm=[float(shown.speed_rpm[at])])
    assert shown.is_line(near)
    assert not shown.is_line(line(19.3, speed_rpm=[float(shown.speed_rpm[at])]))
    assert not shown.is_line(line(near.order, speed_rpm=SPEEDS))  # a line of the shaft stays at all speeds
