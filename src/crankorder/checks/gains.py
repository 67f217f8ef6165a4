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

_ENDS = ((0, (1, 2)), (-1, (-2, -3)))
"""Places of the slowest and the fastest recording, and of the two next to each."""


def gain_steps(speed_rpm: Floats, blocks: Floats, lines: Floats, *, ratio: float) -> Floats:
    """Logarithms (steps, channels) of gains that changed by ``ratio`` or more and nothing else did; 0 where unproven.

    ``speed_rpm`` (recordings,) grows; ``blocks`` (recordings, channels, blocks) is the floor of each block of the
    spectrum, ``lines`` (recordings, channels, orders) the amplitude of each order, NaN where none stands out. Between
    two recordings next in speed the floor of one channel must move by one factor in nearly all blocks, far beyond how
    floors move elsewhere, while all other channels stay; and its orders, beside the same orders of the other channels,
    must fit that factor ``_ODDS`` times better than none. One channel alone proves nothing.
    """
    proven = np.zeros((len(blocks) - 1, blocks.shape[1]))
    if len(blocks) < 3 or blocks.shape[1] < 2 or blocks.shape[2] < _FEWEST_BLOCKS:
        return proven
    moves = _moves(speed_rpm, blocks)
    whole = median_of_known(moves, axis=2)
    jumps = np.abs(whole) >= math.log(ratio)
    sigma = max(_LEAST_SIGMA, _MAD_TO_SIGMA * float(np.median(np.abs(whole[~jumps])))) if not jumps.all() else np.inf
    moved = np.asarray(jumps.any(axis=1))
    candidates = [(step, channel) for step, channel in np.argwhere(jumps).tolist()]
    shown = {at: _shown_by_orders(lines, *at, whole[at], moved) for at in candidates}
    for step, channel in candidates:
        jump, known = whole[step, channel], moves[step, channel][np.isfinite(moves[step, channel])]
        if (
            abs(jump) > _SIGMAS * sigma
            and len(known) >= _FEWEST_BLOCKS
            and np.mean(np.abs(known - jump) <= _STAYS * abs(jump)) >= _ALIKE
            and _others_stay(whole, step, channel)
            and sum(shown.get(at, 0.0) for at in _there_and_back(whole, step, channel)) > math.log(_ODDS)
        ):
            proven[step, channel] = jump
    # the floor of a channel stays between all other recordings: none creeps
    creep = np.fmax.reduce(np.abs(np.where(proven == 0.0, whole, 0.0)), axis=0)
    return np.where(creep <= _STAYS * np.abs(proven), proven, 0.0)


def left_out(jumps: Floats) -> tuple[dict[int, float], bool]:
    """Recordings in which the gain of a channel is not that of most, with its log, by its ``jumps`` (steps,) between.

    And whether it is open which are right: then all are named. A gain that was switched for good tells nobody which of
    its two was meant, unless one recording alone has the other.
    """
    own = np.flatnonzero(jumps)
    if not own.size:
        return {}, False
    level = np.concatenate([[0.0], np.cumsum(jumps)])
    near = 0.5 * float(np.abs(jumps[own]).min())
    count = [int(np.count_nonzero(np.abs(level - here) < near)) for here in level]
    most = int(np.argmax(count))
    alike = np.abs(level - level[most]) < near
    switched = own.size == 1 and 1 <= own[0] < len(jumps) - 1
    undecided = bool(switched or 2 * count[most] <= len(level))
    middle = float(np.median(level if undecided else level[alike]))
    return {row: float(level[row] - middle) for row in np.flatnonzero(~alike | undecided).tolist()}, undecided


def _moves(speed_rpm: Floats, blocks: Floats) -> Floats:
    """Logarithm by which each floor moves from recording to recording, beyond its growth with the speed.

    (steps, channels, blocks); NaN where a floor is not known.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        moves = np.diff(np.log(np.where(blocks > 0.0, blocks, np.nan)), axis=0)
    apart = np.diff(np.log(speed_rpm))
    known = apart > 1e-3
    if not known.any():
        return moves
    slopes = median_of_known(moves[known], axis=2) / apart[known][:, None]
    common = float(np.nanmedian(slopes)) if np.isfinite(slopes).any() else 0.0
    own = np.nan_to_num(median_of_known(slopes.T, axis=1), nan=common) if known.sum() >= _OWN_SLOPE else common
    return np.asarray(moves - (apart[:, None] * own)[..., None])


def _jumps(apart: Floats, ratio: float) -> list[tuple[int, int]]:
    """Recordings and channels ``apart`` (recordings, channels) by ``ratio`` or more where all other channels stay."""
    jumping = np.argwhere(np.abs(apart) > math.log(ratio)).tolist() if apart.shape[1] > 1 else []
    return [(row, column) for row, column in jumping if _others_stay(apart, row, column)]


def _others_stay(whole: Floats, step: int, channel: int) -> bool:
    return bool(np.abs(np.delete(whole[step], channel)).max() <= _STAYS * abs(whole[step, channel]))


def _there_and_back(whole: Floats, step: int, channel: int) -> list[tuple[int, int]]:
    """The ``step``, and that beside in which the floor moves back: where the gain of one recording is another."""
    jump, beside = whole[step, channel], [at for at in (step - 1, step + 1) if 0 <= at < len(whole)]
    back = [(at, channel) for at in beside if abs(whole[at, channel] + jump) <= _STAYS * abs(jump)]
    return [(step, channel), *(back if len(back) == 1 else [])]


def _shown_by_orders(lines: Floats, step: int, channel: int, jump: float, moved: Bools) -> float:
    """Logarithm of how much better the orders of ``channel`` at a ``step`` fit the ``jump`` than none.

    How orders move beside those of other channels is told by the steps without jumps (not ``moved``), and by how these
    differ from one another; heavy tails, as of the Laplace distribution, keep one order from proving much.
    """
    moves = np.diff(np.log(lines), axis=0)
    others = [median_of_known(np.delete(moves, each, axis=1), axis=1) for each in range(moves.shape[1])]
    moves = moves - np.stack(others, axis=1)
    own = moves[step, channel][np.isfinite(moves[step, channel])]
    if not own.size:
        return 0.0
    elsewhere = np.abs(moves[~moved])
    scatter = float(np.median(np.abs(own - np.median(own))))
    scatter = max(scatter, float(np.nanmedian(elsewhere)) if np.isfinite(elsewhere).any() else 0.0)
    return float(np.sum(np.abs(own) - np.abs(own - jump))) / max(_LEAST_SCALE, scatter / math.log(2.0))


_Flags = dict[tuple[str, str], QualityFlag]
"""Flags by recording and channel."""


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
    blocks: dict[str, Floats] = field(default_factory=dict)
    lines: dict[str, Floats] = field(default_factory=dict)

    @property
    def is_steady(self) -> bool:
        """Whether its speed is one."""
        low, high = self.speed_rpm
        return math.isfinite(low) and low > 0.0 and high <= low * (1.0 + _LIKE_SPEED)


def level_jumps(levels: Sequence[RecordedLevel], *, ratio: float, proven_ratio: float) -> list[QualityFlag]:
    """Flags of those ``levels`` where a channel's lies ``ratio`` times or more off that of most recordings at like
    speed, or its floor off those next in speed: that channel of that recording is to be left out. So is one whose
    floors and orders together prove another gain by ``proven_ratio`` or more.

    The other channels (one at least) must stay. Where no majority of the recordings at like speed agrees, nor those
    next in speed, nobody knows which is wrong: all are named.
    """
    steady = sorted((level for level in levels if level.is_steady), key=lambda level: level.speed_rpm)
    channels, least, logs, sigma = _floors_apart(steady)
    by_floor, by_level = _Flags(), _Flags()
    # a resonance raises the floor of a part of the spectrum, a load that of all channels, a gain that of one everywhere
    for row, column in _jumps(least, ratio):
        factor = math.exp(logs[row, column])
        doubt = _unit_doubt(factor, 2.0 * float(sigma[row, column]))
        what = f"its noise floor is {factor:.3g} times that of the recordings next in speed{doubt}"
        by_floor |= _flag(steady[row].recording, channels[column], what)
    for group in _groups(steady):
        names, own = _logarithms(group, "rms")
        # off the lower of two middle ones: between two halves that differ nothing lies
        apart = own - np.sort(own, axis=0)[(len(group) - 1) // 2]
        jumping = _jumps(apart, ratio)
        for column, name in enumerate(names):
            rows = {row: float(apart[row, at]) for row, at in jumping if at == column}
            beside = [row for row, level in enumerate(group) if (level.recording, name) in by_floor]
            for row, jump, undecided in _wrong_of(rows, beside, len(group)):
                what = f"its level is {math.exp(jump):.3g} times that of the other recordings"
                what += f" at {np.mean(group[row].speed_rpm):.4g} rpm{_unit_doubt(math.exp(jump))}"
                by_level |= _flag(group[row].recording, name, what, undecided=undecided)
    proven = _proven(steady, ratio=proven_ratio)
    return [*(proven | by_floor | by_level).values(), *_unit_jumps(steady, least, logs, sigma)]


def _unit_doubt(factor: float, near: float = 0.0) -> str:
    """What the ``factor`` of a level may be, where its logarithm is ``near`` that of two units; else ""."""
    off, what = min((abs(abs(math.log(factor)) - math.log(known)), what) for known, what in _UNIT_FACTORS)
    return f" (unit? {what})" if off < max(near, _UNIT_NEAR) else ""


def _unit_jumps(steady: Sequence[RecordedLevel], least: Floats, logs: Floats, sigma: Floats) -> list[QualityFlag]:
    """Flags of recordings all channels of which lie by one factor, and that of two units, off those next in speed.

    Where channels agree on it the factor is known well; that of a channel alone as well as its floor repeats.
    """
    flags = []
    for each, apart, off, scatter in zip(steady, least, logs, sigma, strict=False):
        jump, near = float(np.mean(off)), 2.0 * float(scatter[0]) if len(scatter) == 1 else 0.0
        doubt = _unit_doubt(math.exp(jump), near)
        stands = np.abs(apart).min() > max(3.0 * near, (1.0 - _STAYS) * abs(jump))
        if doubt and stands and float(np.ptp(off)) < 2.0 * _UNIT_NEAR:
            detail = f"all floors are {math.exp(jump):.3g} times those of the recordings next in speed{doubt}"
            flags.append(remark(each.recording, "unit_doubt", detail, "suspect"))
    return flags


def _proven(steady: Sequence[RecordedLevel], *, ratio: float) -> _Flags:
    """Flags by recording and channel of those of the ``steady`` ones whose floors and orders prove another gain."""
    names = list(steady[0].blocks) if steady else []
    alike = [level for level in steady if list(level.blocks) == list(level.lines) == names]
    sizes = {(len(level.blocks[name]), len(level.lines[name])) for level in alike for name in names}
    if len(names) < 2 or len(sizes) != 1:
        return {}
    speed = np.array([np.mean(level.speed_rpm) for level in alike])
    blocks = np.array([[level.blocks[name] for name in names] for level in alike])
    lines = np.array([[level.lines[name] for name in names] for level in alike])
    flags = _Flags()
    for name, jumps in zip(names, gain_steps(speed, blocks, lines, ratio=ratio).T, strict=True):
        rows, undecided = left_out(jumps)
        for row, log in rows.items():
            what = f"floor and orders are {math.exp(log):.3g} times what most recordings show"
            what = "floor and orders differ by one factor between recordings" if undecided else what
            flags |= _flag(alike[row].recording, name, what, undecided=undecided)
    return flags


def _wrong_of(rows: dict[int, float], beside: list[int], count: int) -> list[tuple[int, float, bool]]:
    """Recordings to be left out of ``count`` at like speed, the logarithms of their factors, and whether that is open.

    ``rows`` are those apart from the middle one with their logarithms, ``beside`` those apart from others in speed.
    """
    if 2 * len(rows) < count:
        return [(row, jump, False) for row, jump in rows.items()]
    back = -float(np.mean(list(rows.values())))
    known = 0 < 2 * len(beside) <= count
    return [(row, rows.get(row, back), not known) for row in (beside if known else range(count))]


def _flag(recording: str, channel: str, what: str, *, undecided: bool = False) -> _Flags:
    but = f", and nothing tells {WHICH_IS_RIGHT}" if undecided else ""
    detail = f"channel {channel}: {what}, while the other channels stay: a gain or a range was changed{but}"
    flag = remark(recording, "level_jump", detail, "suspect")
    flag["channel"], flag["left_out"] = channel, "channel"
    return {(recording, channel): flag}


def _floors_apart(steady: Sequence[RecordedLevel]) -> tuple[list[str], Floats, Floats, Floats]:
    """Channels, and how far the floor (recording, channel) lies off those next in speed: at least, and off their trend.

    Logarithms; 0 where the two next in speed do not agree. Last by how much the other recordings scatter about theirs.
    """
    names, logs = _logarithms(steady, "floor")
    if not names or len(steady) < 3:
        return names, (none := np.empty((0, len(names)))), none, none
    below, above = logs[1:-1] - logs[:-2], logs[1:-1] - logs[2:]
    # at either end two neighbours on one side must agree, and what grows from the one to the other must not explain it
    speed = np.log([np.mean(level.speed_rpm) for level in steady])
    ends = [np.stack([logs[at] - logs[k] for k in near] + [_beyond(logs, speed, at, near)]) for at, near in _ENDS]
    inner = np.stack([below, above, 0.5 * (below + above)])
    parts = np.concatenate([ends[0][:, None], inner, ends[1][:, None]], axis=1)
    agree = (np.sign(parts) == np.sign(parts[0])).all(axis=0)
    for at in (0, -1):
        agree[at] &= np.abs(parts[0, at] - parts[1, at]) < 0.5 * np.abs(parts[:2, at]).max(axis=0)
    least = np.where(agree, np.sign(parts[0]) * np.abs(parts).min(axis=0), 0.0)
    moves = [np.diff(np.delete(logs, row, axis=0), axis=0) for row in range(len(logs))]
    # how far floors of the others move from one to the next beyond their growth; of two nothing parts the two
    beyond = [np.abs(own - (np.median(own, axis=0) if len(own) > 1 else 0.0)) for own in moves]
    rest = np.array([np.median(own, axis=0) for own in beyond])
    return names, least, np.where(agree, parts[2], 0.0), np.maximum(_LEAST_SIGMA, _MAD_TO_SIGMA * rest)


def _logarithms(levels: Sequence[RecordedLevel], what: Literal["rms", "floor"]) -> tuple[list[str], Floats]:
    """Channels that have a level, ``what``, in all recordings, and its logarithms (recording, channel)."""
    by_name = [getattr(level, what) for level in levels]
    names = [name for name in (by_name[0] if levels else ()) if all(each.get(name, 0.0) > 0.0 for each in by_name)]
    return names, np.log([[each[name] for name in names] for each in by_name])


def _beyond(logs: Floats, speed: Floats, at: int, near: tuple[int, int]) -> Floats:
    """How far the floors (recording, channel) at one end lie off the line through the two ``near`` it."""
    first, second = near
    apart = speed[first] - speed[second]
    grows = (logs[first] - logs[second]) / apart if abs(apart) > _LIKE_SPEED else np.zeros(logs.shape[1])
    return np.asarray(logs[at] - logs[first] - grows * (speed[at] - speed[first]))


def _groups(steady: Sequence[RecordedLevel]) -> list[list[RecordedLevel]]:
    groups: list[list[RecordedLevel]] = []
    for level in steady:
        if not groups or level.speed_rpm[1] > groups[-1][0].speed_rpm[0] * (1.0 + _LIKE_SPEED):
            groups.append([])
        groups[-1].append(level)
    return groups
