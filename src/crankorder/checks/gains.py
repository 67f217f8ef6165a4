"""A gain that changed between two recordings: at one speed, one channel's level jumps beside all others that stay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from crankorder.orders.averages import median_of_known
from crankorder.quantities import WHICH_IS_RIGHT, Bools, Floats, QualityFlag, remark
from crankorder.settings import STANDARD_GRAVITY_M_S2

_STAYS = 0.25
"""Share of the jump by which what does not jump may move: the other channels, and the same channel elsewhere."""

_ALIKE = 0.75
"""Share of the blocks of the spectrum that must move by the factor, each within the share of it that may stay."""

_FEWEST_BLOCKS = 6
"""Blocks of the spectrum whose floor is known: fewer are no floor that moves everywhere."""

_SIGMAS = 6.0
"""Standard deviations of how floors move elsewhere in the test that a jump must have."""

_LEAST_SIGMA, _LEAST_SCALE = 0.02, 0.05
"""Of the logarithm of a floor and of an order's amplitude: no test repeats better."""

_ODDS = 100.0
"""How much better the orders must fit the jump than none."""

_MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

_OWN_SLOPE = 4
"""Steps between recordings from which a channel's own growth with the speed is told; of fewer, that of all channels."""

_LIKE_SPEED = 0.02
"""Speeds of two recordings are alike within this share, and each is steady within it."""

_UNIT_FACTORS = (
    (STANDARD_GRAVITY_M_S2, "as g beside m/s2, or a sensitivity of 10 beside 100"),
    (25.4, "as inches beside mm"),
    (1000.0, "as V beside mV, or m beside mm"),
)
_UNIT_NEAR = 0.05
"""Share by which a factor may lie off that of two units, and channels off each other."""


def _without_growth(speed_rpm: Floats, logs: Floats, *, fewest_steps: int) -> Floats:
    """The logarithms ``logs`` (recordings, channels, …) of floors without their power of the speed; NaN stays.

    The power is that of the channel, of few recordings that of all channels, and 0 where ``fewest_steps`` between
    other speeds are not there.
    """
    log_speed = np.log(speed_rpm)
    apart = np.diff(log_speed)
    known = apart > _LIKE_SPEED
    if known.sum() < fewest_steps:
        return logs
    moves = np.diff(logs.reshape(*logs.shape[:2], -1), axis=0)[known]
    slopes = median_of_known(moves, axis=2) / apart[known, None]
    common = float(np.nanmedian(slopes)) if np.isfinite(slopes).any() else 0.0
    own = np.nan_to_num(median_of_known(slopes, axis=0), nan=common) if len(slopes) >= _OWN_SLOPE else common
    return np.asarray((logs.T - (log_speed[:, None] * own).T).T)


def _jumps_alone(apart: Floats, ratio: float) -> Bools:
    """Where a channel is ``apart`` (rows, channels) by ``ratio`` or more and all others, one at least, stay."""
    sizes, channels = np.abs(apart), range(apart.shape[1])
    if len(channels) < 2:
        return np.zeros(apart.shape, dtype=bool)
    others = np.stack([np.delete(sizes, channel, axis=1).max(axis=1) for channel in channels], axis=1)
    return np.asarray((sizes >= math.log(ratio)) & (others <= _STAYS * sizes))


def _gain_steps(speed_rpm: Floats, blocks: Floats, lines: Floats, *, ratio: float) -> Floats:
    """Logarithms (steps, channels) of gains that changed by ``ratio`` or more and nothing else did; 0 where unproven.

    ``speed_rpm`` (recordings,) grows; ``blocks`` (recordings, channels, blocks) is the floor of each block of the
    spectrum, ``lines`` (recordings, channels, orders) the amplitude of each order, NaN where none stands out. Between
    two recordings next in speed the floor of one channel must move by one factor in nearly all blocks, far beyond how
    floors move elsewhere, while all other channels stay; and its orders, beside the same orders of the other channels,
    must fit that factor ``_ODDS`` times better than none. One channel alone proves nothing.
    """
    moves = np.diff(_without_growth(speed_rpm, np.log(np.where(blocks > 0.0, blocks, np.nan)), fewest_steps=1), axis=0)
    whole, known = median_of_known(moves, axis=2), np.isfinite(moves).sum(axis=2)
    sizes = np.abs(whole)
    jumps = sizes >= math.log(ratio)
    sigma = max(_LEAST_SIGMA, _MAD_TO_SIGMA * float(np.median(sizes[~jumps]))) if not jumps.all() else np.inf
    alike = np.sum(np.abs(moves - whole[..., None]) <= _STAYS * sizes[..., None], axis=2) >= _ALIKE * known
    stands = _jumps_alone(whole, ratio) & alike & (known >= _FEWEST_BLOCKS) & (sizes > _SIGMAS * sigma)
    shown = _shown_by_orders(lines, whole, jumps)
    for step, channel in np.argwhere(stands).tolist():
        # where the floor moves back at one step beside, the orders tell of one recording at both
        beside = [at for at in (step - 1, step + 1) if 0 <= at < len(whole)]
        back = [at for at in beside if abs(whole[at, channel] + whole[step, channel]) <= _STAYS * sizes[step, channel]]
        both = [step, *(back if len(back) == 1 else [])]
        stands[step, channel] = shown[both, channel].sum() > math.log(_ODDS)
    # the floor of a channel stays between all other recordings: none creeps
    creep = np.fmax.reduce(np.where(stands, 0.0, sizes), axis=0)
    return np.where(stands & (creep <= _STAYS * sizes), whole, 0.0)


def _shown_by_orders(lines: Floats, whole: Floats, jumps: Bools) -> Floats:
    """Logarithm of how much better the orders fit the move of the floor, ``whole``, than none; 0 where none ``jumps``.

    All (steps, channels). How orders move beside those of other channels is told by the steps without jumps, and by
    how these differ from one another; heavy tails, as of the Laplace distribution, keep one order from proving much.
    """
    moves = np.diff(np.log(lines), axis=0)
    others = [median_of_known(np.delete(moves, each, axis=1), axis=1) for each in range(moves.shape[1])]
    moves = moves - np.stack(others, axis=1)
    elsewhere = np.abs(moves[~jumps.any(axis=1)])
    usual = float(np.nanmedian(elsewhere)) if np.isfinite(elsewhere).any() else 0.0
    scatter = median_of_known(np.abs(moves - median_of_known(moves, axis=2)[..., None]), axis=2)
    better = np.nansum(np.abs(moves) - np.abs(moves - whole[..., None]), axis=2)
    return np.where(jumps, better / np.maximum(_LEAST_SCALE, np.fmax(scatter, usual) / math.log(2.0)), 0.0)


def _off_most(level: Floats, near: float, *, switched: bool = False) -> tuple[dict[int, float], bool]:
    """Recordings whose ``level`` (recordings,), a logarithm, is not ``near`` that of most, and by how much it is off.

    And whether it is open which are right: then all are named, each beside those that differ from it. So where no
    majority agrees, and where a gain was ``switched`` for good, of which nobody knows which of its two was meant.
    """
    alike = np.abs(level[:, None] - level) < near
    most = alike[np.argmax(alike.sum(axis=1))]
    if most.all():
        return {}, False
    undecided = switched or 2 * int(most.sum()) <= len(level)
    others = [level[~own] if undecided else level[most] for own in alike]
    rows = np.flatnonzero(~most | undecided).tolist()
    return {row: float(level[row] - np.median(others[row])) for row in rows}, undecided


_Flags = dict[tuple[str, str], QualityFlag]
"""Flags by recording and channel."""


@dataclass(frozen=True)
class RecordedLevel:
    """One recording: its name, lowest and highest speed [rpm], and by channel name root mean square and ``floor``.

    The floor is the root of the median bin of the power spectrum, which neither lines nor modes raise. ``blocks``
    (blocks,) holds that of each block of the spectrum, ``lines`` (orders,) the amplitude of each order, NaN where none
    stands out. All are in the units of the channels.
    """

    recording: str
    speed_rpm: tuple[float, float]
    rms: dict[str, float]
    floor: dict[str, float] = field(default_factory=dict)
    blocks: dict[str, Floats] = field(default_factory=dict)
    lines: dict[str, Floats] = field(default_factory=dict)

    @property
    def is_steady(self) -> bool:
        """Whether its speed is constant and known."""
        low, high = self.speed_rpm
        return math.isfinite(low) and low > 0.0 and high <= low * (1.0 + _LIKE_SPEED)


def level_jumps(levels: Sequence[RecordedLevel], *, ratio: float, proven_ratio: float) -> list[QualityFlag]:
    """Flags on channels of recordings whose level jumps, which are to be left out.

    The level of such a channel differs by a factor of ``ratio`` or more from that of most recordings at like speed, or
    its floor from those next in speed; or its floors and orders together prove another gain by a factor of
    ``proven_ratio`` or more. The other channels of the recording, at least one, must not jump. Where neither a majority
    of the recordings at like speed nor those next in speed agree, it is not known which is wrong, and all are named.
    ``levels`` are those of the recordings.
    """
    steady = sorted((level for level in levels if level.is_steady), key=lambda level: level.speed_rpm)
    channels, least, middle, scatter = _floors_apart(steady)
    by_floor, by_level = _Flags(), _Flags()
    # a resonance raises the floor of a part of the spectrum, a load that of all channels, a gain that of one everywhere
    for row, column in np.argwhere(_jumps_alone(least, ratio)).tolist():
        factor = math.exp(middle[row, column])
        doubt = _unit_doubt(factor, 2.0 * float(scatter[row, column]))
        what = f"its noise floor is {factor:.3g} times that of the recordings next in speed{doubt}"
        by_floor |= _flag(steady[row].recording, channels[column], what)
    for group in _groups(steady):
        names, own = _logarithms(group, "rms")
        # off the lower of two middle ones: between two halves that differ nothing lies
        apart = own - np.sort(own, axis=0)[(len(group) - 1) // 2]
        levels_off = np.where(_jumps_alone(apart, ratio), apart, 0.0)
        for name, off in zip(names, levels_off.T, strict=True):
            rows, undecided = _off_most(off, 0.5 * math.log(ratio))
            beside = [row for row, level in enumerate(group) if (level.recording, name) in by_floor]
            if undecided and 0 < 2 * len(beside) <= len(group):
                rows, undecided = {row: rows[row] for row in beside}, False
            for row, jump in rows.items():
                what = f"its level is {math.exp(jump):.3g} times that of the other recordings"
                what += f" at {np.mean(group[row].speed_rpm):.4g} rpm{_unit_doubt(math.exp(jump))}"
                by_level |= _flag(group[row].recording, name, what, undecided=undecided)
    proven = _proven(steady, ratio=proven_ratio)
    return [*(proven | by_floor | by_level).values(), *_unit_jumps(steady, least, middle, scatter)]


def _unit_doubt(factor: float, near: float = 0.0) -> str:
    """What the ``factor`` of a level may be, where its logarithm is ``near`` that of two units; else ""."""
    off, what = min((abs(abs(math.log(factor)) - math.log(known)), what) for known, what in _UNIT_FACTORS)
    return f" (unit? {what})" if off < max(near, _UNIT_NEAR) else ""


def _unit_jumps(steady: Sequence[RecordedLevel], least: Floats, middle: Floats, scatter: Floats) -> list[QualityFlag]:
    """Flags of recordings all channels of which lie by one factor, and that of two units, off those next in speed.

    Where channels agree on it the factor is known well; that of a channel alone as well as its floor repeats.
    """
    flags = []
    for level, apart, logs, repeats in zip(steady, least, middle, scatter, strict=False):
        jump, near = float(np.mean(logs)), 2.0 * float(repeats[0]) if len(repeats) == 1 else 0.0
        doubt = _unit_doubt(math.exp(jump), near)
        stands = np.abs(apart).min() > max(3.0 * near, (1.0 - _STAYS) * abs(jump))
        if doubt and stands and float(np.ptp(logs)) < 2.0 * _UNIT_NEAR:
            detail = f"all floors are {math.exp(jump):.3g} times those of the recordings next in speed{doubt}"
            flags.append(remark(level.recording, "unit_doubt", detail, "suspect"))
    return flags


def _proven(steady: Sequence[RecordedLevel], *, ratio: float) -> _Flags:
    """Flags by recording and channel of those of the ``steady`` ones whose floors and orders prove another gain."""
    names, flags = list(steady[0].blocks) if steady else [], _Flags()
    alike = [level for level in steady if list(level.blocks) == list(level.lines) == names]
    sizes = {(len(level.blocks[name]), len(level.lines[name])) for level in alike for name in names}
    if len(names) < 2 or len(alike) < 3 or len(sizes) != 1:
        return flags
    blocks = np.array([[level.blocks[name] for name in names] for level in alike])
    lines = np.array([[level.lines[name] for name in names] for level in alike])
    speed = np.array([np.mean(level.speed_rpm) for level in alike])
    for name, jumps in zip(names, _gain_steps(speed, blocks, lines, ratio=ratio).T, strict=True):
        # one step is a recording at either end, elsewhere a gain that was switched for good
        steps = np.flatnonzero(jumps)
        switched = len(steps) == 1 and 0 < steps[0] < len(jumps) - 1
        near = 0.5 * float(np.abs(jumps[steps]).min(initial=np.inf))
        rows, undecided = _off_most(np.append(0.0, np.cumsum(jumps)), near, switched=bool(switched))
        for row, log in rows.items():
            what = f"floor and orders are {math.exp(log):.3g} times what most recordings show"
            what = "floor and orders differ by one factor between recordings" if undecided else what
            flags |= _flag(alike[row].recording, name, what, undecided=undecided)
    return flags


def _flag(recording: str, channel: str, what: str, *, undecided: bool = False) -> _Flags:
    but = f", and nothing tells {WHICH_IS_RIGHT}" if undecided else ""
    detail = f"channel {channel}: {what}, while the other channels stay: a gain or a range was changed{but}"
    flag = remark(recording, "level_jump", detail, "suspect")
    flag["channel"], flag["left_out"] = channel, "channel"
    return {(recording, channel): flag}


def _floors_apart(steady: Sequence[RecordedLevel]) -> tuple[list[str], Floats, Floats, Floats]:
    """Channels, and the logarithms by which a floor (recordings, channels) lies off those of the two next in speed.

    The least of both, their mean, 0 where the two do not agree; and the scatter of the floors of other recordings.
    """
    names, logs = _logarithms(steady, "floor")
    count = len(steady)
    if not names or count < 3:
        return names, (none := np.empty((0, len(names)))), none, none
    speed_rpm = np.array([np.mean(level.speed_rpm) for level in steady])
    # of fewer steps a changed gain, which moves the floor at two, would look like growth
    logs = _without_growth(speed_rpm, logs, fewest_steps=3)
    # the two at either end are next to those on one side
    off = logs - logs[[[1, *range(count - 2), -2], [2, *range(2, count), -3]]]
    agree = (off[0] * off[1] > 0.0) & (np.abs(off[0] - off[1]) < 0.5 * np.abs(off).max(axis=0))
    least = np.where(agree, np.sign(off[0]) * np.abs(off).min(axis=0), 0.0)
    moves = [np.abs(np.diff(np.delete(logs, row, axis=0), axis=0)) for row in range(count)]
    scatter = np.maximum(_LEAST_SIGMA, _MAD_TO_SIGMA * np.array([np.median(own, axis=0) for own in moves]))
    return names, least, np.where(agree, off.mean(axis=0), 0.0), scatter


def _logarithms(levels: Sequence[RecordedLevel], what: Literal["rms", "floor"]) -> tuple[list[str], Floats]:
    """Channels that have a level, ``what``, in all recordings, and its logarithms (recording, channel)."""
    by_name = [getattr(level, what) for level in levels]
    names = [name for name in (by_name[0] if levels else ()) if all(each.get(name, 0.0) > 0.0 for each in by_name)]
    return names, np.log([[each[name] for name in names] for each in by_name])


def _groups(steady: Sequence[RecordedLevel]) -> list[list[RecordedLevel]]:
    groups: list[list[RecordedLevel]] = []
    for level in steady:
        if not groups or level.speed_rpm[1] > groups[-1][0].speed_rpm[0] * (1.0 + _LIKE_SPEED):
            groups.append([])
        groups[-1].append(level)
    return groups
