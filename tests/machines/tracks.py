"""Whether the rows of the order tracks stand at the speeds where they belong."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from machines.folder import Take
from machines.machine import ComplexArray, FloatArray, Machine

OWN_RPM, OWN_SHARE = 3.0, 0.005
"""A row may be this far from the speed whose amplitude it holds: rpm, or share of the speed; the larger counts."""
AWAY_SHARE = 0.15
"""Speeds farther away than this share are no mistake of the speed."""
DECISIVE = 0.1
"""Rows whose interval is wider than this share of the amplitude decide nothing."""
SAME_ORDER = 0.01
WIDER = 2.0
"""A row is at home where its interval, so much wider, holds the truth: one in twenty is outside the interval itself."""
SAME_PHASE_DEG = 10.0
"""A row belongs to another speed where its phase, if it has one, is as near to that of the truth there."""


@dataclass(frozen=True)
class Row:
    """One row of a track that could be judged."""

    right: bool
    words: str


@dataclass(frozen=True)
class _Said:
    """One row as it was said: speed, rpm; interval of amplitude; phase, degrees, NaN where it has none."""

    speed: float
    low: float
    high: float
    phase_deg: float

    @property
    def decisive(self) -> bool:
        known = bool(np.isfinite([self.speed, self.low, self.high]).all()) and self.low > 0.0
        return known and self.high - self.low <= DECISIVE * self.high


@dataclass(frozen=True)
class _Curve:
    """What was so: complex amplitudes at speeds; which of them a misplaced row may hold; ambiguity of the phase."""

    speed: FloatArray
    value: ComplexArray
    may_be_held: FloatArray
    turn_deg: float


def judged_rows(machine: Machine, takes: tuple[Take, ...], tracks: xr.Dataset | None) -> list[Row]:
    """Every decisive row of the ``tracks`` of the orders of ``machine`` in its ``takes``.

    A row is wrong where its interval (and its phase, if it has one) holds the truth at another speed, and nothing near
    it that was so at its own. Truth is what the recordings held and the steady amplitude, both; a misplaced row of a
    steady recording can only hold what another recording held.
    """
    if tracks is None or "amplitude_low" not in tracks:
        return []
    rows = []
    for place, number in enumerate(tracks["order"].values):
        true = [at for at, order in enumerate(machine.orders) if abs(order.order - number) <= SAME_ORDER]
        if not true:
            continue
        nearest = min(true, key=lambda at: abs(machine.orders[at].order - number))
        for channel in tracks["channel"].values:
            curve = _truth(machine, takes, nearest, machine.channels.index(str(channel)))
            for said in _said(tracks.isel(order=place).sel(channel=channel)):
                row = _row(said, curve) if said.decisive else None
                if row is not None:
                    rows.append(Row(row.right, f"order {number:.5g} {channel}: {row.words}"))
    return rows


def _said(own: xr.Dataset) -> list[_Said]:
    phase = own["phase"].values if "phase" in own else np.full(own.sizes["speed"], np.nan)
    columns = (own["speed"].values, own["amplitude_low"].values, own["amplitude_high"].values, phase)
    return [_Said(*(float(value) for value in row)) for row in zip(*columns, strict=True)]


def _truth(machine: Machine, takes: tuple[Take, ...], number: int, channel: int) -> _Curve:
    speed, value = [], []
    for take in takes:
        own = take.envelopes[number][channel]
        speed.append(np.array([take.speed_rpm.mean()]) if machine.steady else take.speed_rpm)
        value.append(np.array([own.mean()]) if machine.steady else own)
    held = sum(part.size for part in speed)
    low, high = machine.tested_rpm[0], machine.tested_rpm[-1]
    grid = np.linspace(max(low, 1.0), high, 1001) if high - low > 1.0 else np.array([low])
    speed.append(grid)
    value.append(machine.steady_response(number, grid)[channel])
    may_be_held = np.ones(held + grid.size)
    may_be_held[held:] = 0.0 if machine.steady else 1.0
    order = machine.orders[number]
    turn = np.nan if not machine.is_locked(order) else 360.0 if order.order.is_integer() else 180.0
    return _Curve(np.concatenate(speed), np.concatenate(value), may_be_held, turn)


def _row(said: _Said, curve: _Curve) -> Row | None:
    size = np.abs(curve.value)
    near = np.abs(curve.speed - said.speed) <= max(OWN_RPM, OWN_SHARE * said.speed)
    if not near.any():
        return None
    own_low, own_high = size[near].min(), size[near].max()
    more = 0.5 * (WIDER - 1.0) * (said.high - said.low)
    if said.low - more <= own_high and own_low <= said.high + more:
        return Row(True, "")
    away = ~near & (np.abs(curve.speed - said.speed) <= AWAY_SHARE * said.speed) & (curve.may_be_held > 0.0)
    away &= (size >= said.low) & (size <= said.high)
    if np.isfinite(said.phase_deg + curve.turn_deg):
        turned = np.degrees(np.angle(curve.value)) - said.phase_deg
        off = np.abs(np.mod(turned + 0.5 * curve.turn_deg, curve.turn_deg) - 0.5 * curve.turn_deg)
        away &= off <= SAME_PHASE_DEG
    if not away.any():
        return None
    other = curve.speed[away][np.argmin(np.abs(curve.speed[away] - said.speed))]
    words = (
        f"{said.low:.4g}…{said.high:.4g} at {said.speed:.1f} rpm, where it is {own_low:.4g}…{own_high:.4g}; "
        f"so at {other:.1f} rpm"
    )
    return Row(False, words)
