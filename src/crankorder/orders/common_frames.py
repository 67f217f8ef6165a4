"""Frames of a test that can be averaged together: of one length, on one axis of orders."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr

from crankorder.quantities import QualityFlag


def common_frames(frames: Sequence[xr.Dataset]) -> tuple[list[xr.Dataset], list[QualityFlag]]:
    """Those of ``frames`` (OrderFrames) that are as long as most, on the orders that all hold, and what was left out.

    Recordings by crank angle of fewer samples per revolution end at a lower order: the others are cut there, and the
    remark is "info"; those of another length are left out, which is "bad". The longer length where two are as common.
    """
    lengths = [int(item.attrs["revs_per_frame"]) for item in frames]
    common = max(set(lengths), key=lambda length: (lengths.count(length), length))
    used = [item for item, length in zip(frames, lengths, strict=True) if length == common]
    flags = [_length_flag(item, common) for item, length in zip(frames, lengths, strict=True) if length != common]
    fewest = min(item.sizes["order"] for item in used)
    flags += [_cut_flag(item, fewest) for item in used if item.sizes["order"] > fewest]
    return [item if item.sizes["order"] == fewest else item.isel(order=slice(fewest)) for item in used], flags


def _length_flag(item: xr.Dataset, common: int) -> QualityFlag:
    return {
        "recording": item.attrs["recording"],
        "flag": "frame_length_differs",
        "severity": "bad",
        "detail": f"frames of {item.attrs['revs_per_frame']} revolutions where most others have {common}: left out",
    }


def _cut_flag(item: xr.Dataset, fewest: int) -> QualityFlag:
    order = item["order"].values
    return {
        "recording": item.attrs["recording"],
        "flag": "orders_cut",
        "severity": "info",
        "detail": f"orders from {order[fewest]:g} to {order[-1]:g} left out: another recording of the test ends there",
    }
