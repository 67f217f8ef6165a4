"""A gain that changed between two recordings: at one speed, one channel's level jumps beside all others that stay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from crankorder.orders.gain_steps import gain_steps, left_out
from crankorder.quantities import WHICH_IS_RIGHT, QualityFlag

_LIKE_SPEED = 0.02
"""Speeds of two recordings are alike within this share, and each is steady within it."""
_OTHERS_STAY = 0.25
"""Share of the jump that the others may move by: a load moves them all."""


_EVIDENCE = ("blocks", "lines")
_ENDS = ((0, (1, 2)), (-1, (-2, -3)))
"""Places of the slowest and the fastest recording, and of the two next to each."""


@dataclass(frozen=True)
class RecordedLevel:
    """One recording: its name, lowest and highest speed [rpm], and by channel name root mean square and ``floor``.

    The floor is the root of the middling bin of the power spectrum, which neither lines nor modes raise. ``blocks``
    holds that of each block of the spectrum, ``lines`` the amplitude of each order, NaN where none stands out.
    """

    recording: str
    speed_rpm: tuple[float, float]
    rms: dict[str, float]
    floor: dict[str, float] = field(default_factory=dict)
    blocks: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    lines: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    @property
    def is_steady(self) -> bool:
        """Whether its speed is one."""
        low, high = self.speed_rpm
        return math.isfinite(low) and low > 0.0 and high <= low * (1.0 + _LIKE_SPEED)


def level_jumps(
    levels: Sequence[RecordedLevel], *, ratio: float, proven_ratio: float | None = None
) -> list[QualityFlag]:
    """Flags of those ``levels`` where a channel's lies ``ratio`` times or more off that of most recordings at like
    speed, or its floor off those next in speed: that channel of that recording is to be left out. So is one whose
    floors and orders together prove another gain by ``proven_ratio`` or more (None: that is not asked for).

    The other channels (one at least) must stay. Where no majority of the recordings at like speed agrees, nor those
    next in speed, nobody knows which is wrong: all are named.
    """
    found: dict[tuple[str, str], QualityFlag] = {}
    steady = sorted((one for one in levels if one.is_steady), key=lambda one: one.speed_rpm)
    by_floor = {(flag["recording"], flag["channel"]): flag for flag in _floor_jumps(steady, ratio=ratio)}
    for group in _groups(steady):
        names = [name for name in group[0].rms if all(one.rms.get(name, 0.0) > 0.0 for one in group)]
        if len(names) < 2 or len(group) < 2:
            continue
        logs = np.log([[one.rms[name] for name in names] for one in group])
        for column, name in enumerate(names):
            rows = {row: jump for row, at, jump in _outliers(logs, math.log(ratio)) if at == column}
            beside = [row for row, one in enumerate(group) if (one.recording, name) in by_floor]
            for row, jump, undecided in _wrong_of(rows, beside, len(group)):
                one = group[row]
                what = f"its level is {math.exp(jump):.3g} times that of the other recordings"
                what += f" at {np.mean(one.speed_rpm):.4g} rpm"
                found[one.recording, name] = _flag(one.recording, name, what, undecided=undecided)
    proven = {} if proven_ratio is None else _proven(steady, ratio=proven_ratio)
    return list((proven | by_floor | found).values())


def _proven(steady: Sequence[RecordedLevel], *, ratio: float) -> dict[tuple[str, str], QualityFlag]:
    """Flags by recording and channel of those of the ``steady`` ones whose floors and orders prove another gain."""
    names = list(steady[0].blocks) if steady else []
    alike = [one for one in steady if list(one.blocks) == names and list(one.lines) == names]
    sizes = {(len(one.blocks[name]), len(one.lines[name])) for one in alike for name in names}
    if len(names) < 2 or len(sizes) != 1:
        return {}
    speed = np.array([np.mean(one.speed_rpm) for one in alike])
    blocks, lines = (np.array([[getattr(one, key)[name] for name in names] for one in alike]) for key in _EVIDENCE)
    steps = gain_steps(speed, blocks, lines, ratio=ratio)
    flags = {}
    for column, name in enumerate(names):
        rows, undecided = left_out(steps, len(alike), column)
        for row, log in rows.items():
            what = f"floor and orders are {math.exp(log):.3g} times what most recordings show"
            what = "floor and orders differ by one factor between recordings" if undecided else what
            flags[alike[row].recording, name] = _flag(alike[row].recording, name, what, undecided=undecided)
    return flags


def _wrong_of(rows: dict[int, float], beside: list[int], count: int) -> list[tuple[int, float, bool]]:
    """Recordings to be left out of ``count`` at like speed, the logarithms of their factors, and whether that is open.

    ``rows`` are those apart from the middle one with their logarithms, ``beside`` those apart from others in speed.
    """
    if 2 * len(rows) < count:
        return [(row, jump, False) for row, jump in rows.items()]
    back = -float(np.mean(list(rows.values())))
    told = 0 < 2 * len(beside) <= count
    return [(row, rows.get(row, back), not told) for row in (beside if told else range(count))]


def _flag(recording: str, channel: str, what: str, *, undecided: bool = False) -> QualityFlag:
    but = f", and nothing tells {WHICH_IS_RIGHT}" if undecided else ""
    detail = f"channel {channel}: {what}, while the other channels stay: a gain or a range was changed{but}"
    flag = QualityFlag(recording=recording, flag="level_jump", severity="suspect", detail=detail)
    flag["channel"], flag["left_out"] = channel, "channel"
    return flag


def _floor_jumps(steady: Sequence[RecordedLevel], *, ratio: float) -> list[QualityFlag]:
    """Flags of recordings whose floor lies ``ratio`` times or more off both that are next in speed, in one channel.

    A resonance raises the floor of a part of the spectrum, a load that of all channels: a gain that of one, everywhere.
    """
    names = [
        name for name in (steady[0].floor if steady else ()) if all(one.floor.get(name, 0.0) > 0.0 for one in steady)
    ]
    if len(names) < 2 or len(steady) < 3:
        return []
    logs = np.log([[one.floor[name] for name in names] for one in steady])
    below, above = logs[1:-1] - logs[:-2], logs[1:-1] - logs[2:]
    # at either end two neighbours on one side must agree, and what grows from the one to the other must not explain it
    speed = np.log([np.mean(one.speed_rpm) for one in steady])
    ends = [np.stack([logs[at] - logs[k] for k in near] + [_beyond(logs, speed, at, near)]) for at, near in _ENDS]
    inner = np.stack([below, above, below])
    parts = np.concatenate([ends[0][:, None], inner, ends[1][:, None]], axis=1)
    agree = (np.sign(parts) == np.sign(parts[0])).all(axis=0)
    apart = np.where(agree, np.sign(parts[0]) * np.abs(parts).min(axis=0), 0.0)
    flags = []
    for row, column in zip(*np.nonzero(np.abs(apart) > math.log(ratio)), strict=True):
        if np.abs(np.delete(apart[row], column)).max() >= _OTHERS_STAY * abs(apart[row, column]):
            continue
        what = f"its noise floor is {math.exp(apart[row, column]):.3g} times that of the recordings next in speed"
        flags.append(_flag(steady[row].recording, names[column], what))
    return flags


def _beyond(
    logs: NDArray[np.float64], speed: NDArray[np.float64], at: int, near: tuple[int, int]
) -> NDArray[np.float64]:
    """How far the floors (recording, channel) at one end lie off the line through the two ``near`` it."""
    first, second = near
    apart = speed[first] - speed[second]
    grows = (logs[first] - logs[second]) / apart if abs(apart) > _LIKE_SPEED else np.zeros(logs.shape[1])
    return np.asarray(logs[at] - logs[first] - grows * (speed[at] - speed[first]))


def _groups(steady: Sequence[RecordedLevel]) -> list[list[RecordedLevel]]:
    groups: list[list[RecordedLevel]] = []
    for one in steady:
        if groups and one.speed_rpm[1] <= groups[-1][0].speed_rpm[0] * (1.0 + _LIKE_SPEED):
            groups[-1].append(one)
        else:
            groups.append([one])
    return groups


def _outliers(logs: NDArray[np.float64], least: float) -> list[tuple[int, int, float]]:
    """Recording, channel and logarithm of the factor of the ``logs`` (recording, channel) that jump."""
    # the lower of two middle ones: between two halves that differ nothing lies
    apart = logs - np.sort(logs, axis=0)[(len(logs) - 1) // 2]
    found = []
    for row, column in zip(*np.nonzero(np.abs(apart) > least), strict=True):
        jump = float(apart[row, column])
        others = np.delete(apart[row], column)
        if np.abs(others).max() < _OTHERS_STAY * abs(jump):
            found.append((int(row), int(column), jump))
    return found
