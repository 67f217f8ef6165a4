"""Whether the rows of the order tracks stand at the speeds where they belong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from machines.folder import Take
from machines.machine import FloatArray, Machine

OWN_RPM, OWN_SHARE = 3.0, 0.005
"""A row may be this far from the speed whose amplitude it holds: rpm, or share of the speed; the larger counts."""
AWAY_SHARE = 0.15
"""Speeds farther away than this share are no mistake of the speed."""
DECISIVE = 0.1
"""Rows whose interval is wider than this share of the amplitude decide nothing."""
SAME_ORDER = 0.01
WIDER = 2.0
"""A row is at home where its interval, so much wider, holds the truth: one in twenty is outside the interval itself."""


@dataclass(frozen=True)
class Row:
    """One row of a track that could be judged."""

    right: bool
    words: str


def judged_rows(machine: Machine, takes: tuple[Take, ...], tracks: xr.Dataset | None) -> list[Row]:
    """Every decisive row of the ``tracks`` of the orders of ``machine`` in its ``takes``.

    A row is wrong where its interval holds the truth at another speed, and nothing near it that was so at its own.
    Truth is what the recordings held and the steady amplitude, both.
    """
    if tracks is None or "amplitude_low" not in tracks:
        return []
    rows = []
    for place, number in enumerate(tracks["order"].values):
        true = [at for at, order in enumerate(machine.orders) if abs(order.order - number) <= SAME_ORDER]
        if not true:
            continue
        for channel in tracks["channel"].values:
            own = tracks.isel(order=place).sel(channel=channel)
            curve = _truth(machine, takes, true[0], machine.channels.index(str(channel)))
            for speed, low, high in zip(
                own["speed"].values, own["amplitude_low"].values, own["amplitude_high"].values, strict=True
            ):
                row = _row(float(speed), float(low), float(high), curve)
                if row is not None:
                    rows.append(Row(row[0], f"order {number:.5g} {channel}: {row[1]}"))
    return rows


def _truth(machine: Machine, takes: tuple[Take, ...], number: int, channel: int) -> tuple[FloatArray, FloatArray]:
    """Speeds and amplitudes that were so: in the recordings, and steadily."""
    speed, size = [], []
    for take in takes:
        own = np.abs(take.envelopes[number][channel])
        if machine.steady:
            speed.append(np.array([take.speed_rpm.mean()]))
            size.append(np.array([own.mean()]))
        else:
            speed.append(take.speed_rpm)
            size.append(own)
    low, high = machine.tested_rpm[0], machine.tested_rpm[-1]
    grid = np.linspace(max(low, 1.0), high, 1001) if high - low > 1.0 else np.array([low])
    speed.append(grid)
    size.append(np.abs(machine.steady_response(number, grid))[channel])
    return np.concatenate(speed), np.concatenate(size)


def _row(speed: float, low: float, high: float, curve: tuple[FloatArray, FloatArray]) -> tuple[bool, str] | None:
    if not (np.isfinite([speed, low, high]).all() and low > 0.0) or high - low > DECISIVE * high:
        return None
    at, size = curve
    reach = max(OWN_RPM, OWN_SHARE * speed)
    near = np.abs(at - speed) <= reach
    if not near.any():
        return None
    own_low, own_high = size[near].min(), size[near].max()
    more = 0.5 * (WIDER - 1.0) * (high - low)
    if low - more <= own_high and own_low <= high + more:
        return True, ""
    away = ~near & (np.abs(at - speed) <= AWAY_SHARE * speed) & (size >= low) & (size <= high)
    if not away.any():
        return None
    other = at[away][np.argmin(np.abs(at[away] - speed))]
    words = f"{low:.4g}…{high:.4g} at {speed:.1f} rpm, where it is {own_low:.4g}…{own_high:.4g}; so at {other:.1f} rpm"
    return False, words
