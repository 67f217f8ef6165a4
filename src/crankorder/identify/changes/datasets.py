"""Datasets of a comparison: the change of every order and of every map cell, with intervals and claims."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.changes.compared import Compared
from crankorder.identify.changes.map_difference import MapDifference
from crankorder.identify.changes.order_changes import OrderChange


def change_datasets(made: Compared) -> dict[str, xr.Dataset]:
    """Datasets of a comparison ``made``, by group: ``order_change`` and ``map_change``, as far as there are any."""
    groups: dict[str, xr.Dataset] = {}
    if made.orders:
        groups["order_change"] = _order_dataset(made.orders)
    if made.cells is not None:
        groups["map_change"] = _map_dataset(made.cells)
    return groups


def _order_dataset(changes: Sequence[OrderChange]) -> xr.Dataset:
    """Change of each order, rows (line, speed): a line is an order in a channel."""
    dims = ("line", "speed")

    def rows(of: Any, units: str, text: str) -> tuple[Any, ...]:
        values: NDArray[Any] = np.stack([np.asarray(of(one)) for one in changes])
        return dims, values, {"units": units, "long_name": text}

    def column(of: Any, text: str) -> tuple[Any, ...]:
        return "line", np.array([of(one) for one in changes]), {"units": "1", "long_name": text}

    return xr.Dataset(
        {
            "base_amplitude": rows(lambda one: one.base.amplitude, "see unit", "peak amplitude in the first test"),
            "new_amplitude": rows(lambda one: one.new.amplitude, "see unit", "peak amplitude in the second test"),
            "difference": rows(lambda one: one.difference, "see unit", "second less first"),
            "difference_low": rows(lambda one: one.difference_ci95[:, 0], "see unit", "lower end of its 95 % interval"),
            "difference_high": rows(lambda one: one.difference_ci95[:, 1], "see unit", "upper end"),
            "ratio_db": rows(lambda one: one.ratio_db, "dB", "second over first"),
            "ratio_db_low": rows(lambda one: one.ratio_db_ci95[:, 0], "dB", "lower end of its 95 % interval"),
            "ratio_db_high": rows(lambda one: one.ratio_db_ci95[:, 1], "dB", "upper end"),
            "vector_change": rows(lambda one: one.vector_change, "see unit", "phasor, second less first"),
            "p_value": rows(lambda one: one.p_value, "1", "chance of so large a difference where nothing changed"),
            "changed": rows(lambda one: one.changed_at, "1", "1 where a change is claimed"),
            "order": column(lambda one: one.order, "cycles per crank revolution"),
            "channel": column(lambda one: one.channel, "name of the channel"),
            "unit": column(lambda one: one.unit, "unit of the channel"),
            "new_speed": ("speed", changes[0].new_rpm, {"units": "min-1", "long_name": "speed in the second test"}),
        },
        coords={"speed": ("speed", changes[0].base_rpm, {"units": "min-1", "long_name": "speed in the first test"})},
    )


def _map_dataset(cells: MapDifference) -> xr.Dataset:
    dims = ("channel", "speed", "frequency")
    decibels = {"units": "dB"}
    return xr.Dataset(
        {
            "difference_db": (dims, cells.difference_db, {**decibels, "long_name": "level, second less first"}),
            "difference_db_low": (dims, cells.low_db, {**decibels, "long_name": "lower end of its 95 % interval"}),
            "difference_db_high": (dims, cells.high_db, {**decibels, "long_name": "upper end"}),
            "p_value": (dims, cells.p_value, {"units": "1", "long_name": "chance where nothing changed"}),
            "changed": (dims, cells.changed, {"units": "1", "long_name": "1 where a change is claimed"}),
            "new_speed": ("speed", cells.new_rpm, {"units": "min-1", "long_name": "speed in the second test"}),
        },
        coords={
            "channel": ("channel", list(cells.channels), {"units": "1", "long_name": "name of the channel"}),
            "speed": ("speed", cells.base_rpm, {"units": "min-1", "long_name": "speed in the first test"}),
            "frequency": ("frequency", cells.frequency_hz, {"units": "Hz", "long_name": "frequency"}),
        },
    )
