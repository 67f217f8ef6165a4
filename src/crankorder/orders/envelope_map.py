"""Envelope map: the envelope spectra of all recordings of a test, averaged at like speed."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import InputError
from crankorder.orders.envelope_looks import joined_looks
from crankorder.quantities import QualityFlag, channel_coords, flags_of, with_flags
from crankorder.shaft.speed_groups import speed_groups

SPECTRA = ("amplitude", "floor")
"""Variables (channel, speed, order) whose fourth powers, the powers of a squared envelope's lines, are averaged."""


def envelope_map(items: list[xr.Dataset], *, speed_bin_rpm: float) -> xr.Dataset:
    """EnvelopeMap (channel, speed, order) of a test from the RecordingEnvelopes ``items`` of its recordings.

    Recordings whose mean speeds differ by less than ``speed_bin_rpm`` are averaged by power, each as often as its
    independent spectra count; ``band_low`` and ``band_high`` are then the lowest and the highest of their bands. Items
    without orders only give their flags; with other channels or orders than the first of the rest they are left out
    and flagged "bad". Raises InputError where ``items`` is empty.
    """
    if not items:
        raise InputError("no envelope to average", allowed="one RecordingEnvelope or more")
    full = [item for item in items if item.sizes["order"]]
    used = [item for item in full if _alike(item, full[0])]
    remarks: list[QualityFlag] = [
        {
            "recording": str(item.attrs["recording"]),
            "flag": "left_out",
            "severity": "bad",
            "detail": "envelope with other channels or orders than the test's first",
        }
        for item in full
        if not _alike(item, full[0])
    ]
    made = _averaged(used, speed_bin_rpm) if used else items[0].copy()
    made.attrs = _attrs(used or items) | {"speed_bin_rpm": speed_bin_rpm}
    return with_flags(made, [flag for item in items for flag in flags_of(item)] + remarks)


def _alike(item: xr.Dataset, other: xr.Dataset) -> bool:
    return all(np.array_equal(item[name].values, other[name].values) for name in ("channel", "unit", "order"))


def _averaged(used: list[xr.Dataset], speed_bin_rpm: float) -> xr.Dataset:
    """Average of ``used`` recordings by group of like speed."""
    speed = np.array([float(item["speed"].values[0]) for item in used])
    groups = [group for group in speed_groups(speed, width_rpm=speed_bin_rpm) if len(group)]
    first = used[0]

    def stacked(name: str, group: NDArray[np.int64]) -> NDArray[np.float64]:
        return np.array([used[k][name].values[:, 0] for k in group])

    columns: dict[str, list[NDArray[np.float64]]] = {name: [] for name in (*SPECTRA, *_OF_CHANNEL)}
    revs = []
    for group in groups:
        count = stacked("n_independent", group)
        total = np.maximum(count.sum(axis=0), 1e-300)
        for name, power in (*((name, 4) for name in SPECTRA), ("level", 2)):
            values = np.nan_to_num(stacked(name, group)) ** power
            weight = count.reshape(count.shape + (1,) * (values.ndim - 2))
            mean = (weight * values).sum(axis=0) / total.reshape(total.shape + (1,) * (values.ndim - 2))
            columns[name].append(np.where(mean > 0.0, mean, np.nan) ** (1.0 / power))
        columns["n_independent"].append(count.sum(axis=0))
        columns["band_low"].append(stacked("band_low", group).min(axis=0))
        columns["band_high"].append(stacked("band_high", group).max(axis=0))
        revs.append(min(int(used[k]["revs_per_frame"].values[0]) for k in group))
    variables: dict[str, Any] = {
        name: (first[name].dims, np.stack(values, axis=1), dict(first[name].attrs)) for name, values in columns.items()
    }
    variables |= joined_looks([[used[k] for k in group] for group in groups])
    variables["revs_per_frame"] = (("speed",), np.array(revs), dict(first["revs_per_frame"].attrs))
    mean_speed = np.array([speed[group].mean() for group in groups])
    coords = {
        **channel_coords(first),
        "speed": ("speed", mean_speed, dict(first["speed"].attrs)),
        "order": first["order"],
    }
    return xr.Dataset(variables, coords=coords)


_OF_CHANNEL = ("level", "n_independent", "band_low", "band_high")


def _attrs(used: list[xr.Dataset]) -> dict[str, Any]:
    """Attributes of the map: those of a recording that hold for all, the widest of what was tried, sums of times."""
    nominal = any(item.attrs["speed_basis"] == "nominal" for item in used)
    return {
        "revs_per_cycle": int(used[0].attrs["revs_per_cycle"]),
        "lowest_order": float(used[0].attrs["lowest_order"]),
        "speed_basis": "nominal" if nominal else "measured",
        "bands_tried": max(int(item.attrs["bands_tried"]) for item in used),
        "analysed_s": float(sum(item.attrs["analysed_s"] for item in used)),
        "recorded_s": float(np.nansum([item.attrs["recorded_s"] for item in used])),
        "history": str(used[0].attrs.get("history", "")),
    }
