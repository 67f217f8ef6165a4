"""A gain that changed between two recordings: at one speed, one channel's level jumps beside all others that stay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.quantities import QualityFlag

_LIKE_SPEED = 0.02
"""Speeds of two recordings are alike within this share, and each is steady within it."""
_OTHERS_STAY = 0.25
"""Share of the jump that the others may move by: a load moves them all."""


@dataclass(frozen=True)
class RecordedLevel:
    """One recording: its name, lowest and highest speed [rpm], and the root mean square by channel name."""

    recording: str
    speed_rpm: tuple[float, float]
    rms: dict[str, float]

    @property
    def is_steady(self) -> bool:
        """Whether its speed is one."""
        low, high = self.speed_rpm
        return math.isfinite(low) and low > 0.0 and high <= low * (1.0 + _LIKE_SPEED)


def level_jumps(levels: Sequence[RecordedLevel], *, ratio: float) -> list[QualityFlag]:
    """Flags of those ``levels`` where a channel's lies ``ratio`` times or more off that of most recordings at like
    speed.

    The other channels (one at least) must stay. Of two recordings alone nobody knows which is wrong: both are named.
    """
    found: dict[tuple[str, str], QualityFlag] = {}
    steady = sorted((one for one in levels if one.is_steady), key=lambda one: one.speed_rpm)
    for group in _groups(steady):
        names = [name for name in group[0].rms if all(one.rms.get(name, 0.0) > 0.0 for one in group)]
        if len(names) < 2 or len(group) < 2:
            continue
        logs = np.log([[one.rms[name] for name in names] for one in group])
        for row, column, factor in _outliers(logs, math.log(ratio)):
            one, name = group[row], names[column]
            detail = (
                f"channel {name}: its level is {factor:.3g} times that of the other recordings at "
                f"{np.mean(one.speed_rpm):.4g} rpm, while the other channels stay: a gain or a range was changed"
            )
            flag = QualityFlag(recording=one.recording, flag="level_jump", severity="suspect", detail=detail)
            flag["channel"] = name
            found[one.recording, name] = flag
    return list(found.values())


def _groups(steady: Sequence[RecordedLevel]) -> list[list[RecordedLevel]]:
    groups: list[list[RecordedLevel]] = []
    for one in steady:
        if groups and one.speed_rpm[1] <= groups[-1][0].speed_rpm[0] * (1.0 + _LIKE_SPEED):
            groups[-1].append(one)
        else:
            groups.append([one])
    return groups


def _outliers(logs: NDArray[np.float64], least: float) -> list[tuple[int, int, float]]:
    """Recording, channel and factor of the ``logs`` (recording, channel) that jump."""
    apart = logs - np.median(logs, axis=0) if len(logs) > 2 else logs - logs[::-1]
    found = []
    for row, column in zip(*np.nonzero(np.abs(apart) > least), strict=True):
        jump = float(apart[row, column])
        others = np.delete(apart[row], column)
        if np.abs(others).max() < _OTHERS_STAY * abs(jump):
            found.append((int(row), int(column), math.exp(jump)))
    return found
