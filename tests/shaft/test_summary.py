"""The summary of all shafts of a test: one row each, as the traces of each alone."""

from __future__ import annotations

import numpy as np
import xarray as xr

from crankorder.shaft.summary import speed_trace, trace_variables


def test_traces_of_a_test_are_those_of_each_recording() -> None:
    rng = np.random.default_rng(3)
    shafts = [
        xr.Dataset({"time": ("knot", np.sort(rng.uniform(0, 5, n))), "speed": ("knot", rng.uniform(900, 1100, n))})
        for n in (20, 300, 4)
    ]
    made = trace_variables(shafts, knots=50)
    for row, shaft in enumerate(shafts):
        alone = speed_trace(shaft["time"].values, shaft["speed"].values, knots=50)
        for values, variable in zip(alone, made.values(), strict=True):
            assert variable.dims == ("recording", "knot") and variable.dtype == np.float32
            np.testing.assert_array_equal(variable.values[row], values.astype(np.float32))
    assert all(variable.shape == (0, 50) for variable in trace_variables([], knots=50).values())
