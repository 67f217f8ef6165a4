"""Frames of like speed: what lets a stepped test and a run-up meet on one speed axis."""

from __future__ import annotations

import numpy as np

from crankorder.quantities import Floats, Ints

SAME_SPEED = 0.001
"""Speeds that differ by less than this share are one: a quarter of the width of a resonance damped by 0.2 %."""

GAP_RATIO = 8.0
"""A gap between speeds that is so many times the usual one parts two steps of one recording …"""

FEWEST_HELD = 3
"""… where so many frames lie on each side."""

Indices = Ints


def speed_groups(speed_rpm: Floats, *, width_rpm: float, owner: Ints | None = None) -> list[Indices]:
    """Indices of ``speed_rpm`` (frames,) in groups that span at most ``width_rpm``, slowest group first.

    A group begins at the slowest frame that none has taken, so that the steps of a stepped test stay whole wherever
    they lie and a run-up falls into bins of ``width_rpm``. Where ``owner`` (frames,) numbers the recordings, a speed
    that is held falls into one group even where others lie just below. Frames of unknown speed (NaN) form one group,
    the last.
    """
    order = np.argsort(speed_rpm, kind="stable")
    known = order[: np.count_nonzero(~np.isnan(speed_rpm))]
    held = [] if owner is None else held_speeds(speed_rpm, owner, width_rpm=width_rpm)
    swept = np.setdiff1d(known, np.concatenate([*held, np.empty(0, dtype=np.int64)]))
    pieces: list[Indices] = [*held, *(k[None] for k in swept)]
    pieces.sort(key=lambda piece: (float(speed_rpm[piece].min()), int(piece[0])))
    groups: list[list[Indices]] = []
    limit = -np.inf
    for piece in pieces:
        if float(speed_rpm[piece].max()) > limit:
            groups.append([])
            limit = float(speed_rpm[piece].min()) + width_rpm
        groups[-1].append(piece)
    unknown = order[len(known) :]
    return [np.sort(np.concatenate(group)) for group in [*groups, [unknown]] if len(group[0])]


def held_speeds(speed_rpm: Floats, owner: Indices, *, width_rpm: float) -> list[Indices]:
    """Indices of the frames of each speed that recordings hold, slowest first; frames of sweeps are in none.

    Parameters
    ----------
    speed_rpm : (frames,), rpm; NaN is held by none
    owner : (frames,), number of the recording of each
    width_rpm : rpm; what changes by more is no held speed. Speeds within SAME_SPEED, or that overlap, are one.
    """
    steps: list[Indices] = []
    for name in np.unique(owner):
        mine = np.flatnonzero((owner == name) & np.isfinite(speed_rpm))
        steps += [part for part in _steps(speed_rpm, mine) if np.ptp(speed_rpm[part]) <= width_rpm]
    steps.sort(key=lambda part: float(speed_rpm[part].min()))
    held: list[Indices] = []
    for part in steps:
        both = np.concatenate([held[-1], part]) if held else part
        last = float(speed_rpm[held[-1]].max()) if held else -np.inf
        near = float(speed_rpm[part].min()) <= last * (1.0 + SAME_SPEED)
        if held and near and np.ptp(speed_rpm[both]) <= width_rpm:
            held[-1] = np.sort(both)
        else:
            held.append(part)
    return held


def _steps(speed_rpm: Floats, mine: Indices) -> list[Indices]:
    """The frames ``mine`` of one recording, parted where their speeds leave a gap as between two steps."""
    if len(mine) < 2 * FEWEST_HELD:
        return [mine] if len(mine) else []
    ordered = mine[np.argsort(speed_rpm[mine], kind="stable")]
    speed = speed_rpm[ordered]
    gap = np.diff(speed)
    least = np.maximum(GAP_RATIO * float(np.median(gap)), SAME_SPEED * speed[1:])
    cuts = [int(k) + 1 for k in np.flatnonzero(gap > least)]
    inside = [k for k in cuts if FEWEST_HELD <= k <= len(ordered) - FEWEST_HELD]
    return [np.sort(part) for part in np.split(ordered, inside)]
