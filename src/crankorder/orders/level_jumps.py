"""A gain that changed between two recordings: at one speed, one channel's level jumps beside all others that stay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr

from crankorder.orders.averages import cycle_bins, median_beside, median_of_known
from crankorder.quantities import WHICH_IS_RIGHT, Floats, QualityFlag, remark
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

_HALF = 16
"""Bins on each side of an order whose median is its floor."""

_STANDS = 20.0
"""Power of an order over its floor from which it is one whose size can be compared."""


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


@dataclass(frozen=True)
class GainStep:
    """A gain that differs between recording ``after`` - 1 and ``after``, in channel number ``channel``, by ``log``."""

    channel: int
    after: int
    log: float


def gain_steps(speed_rpm: Floats, blocks: Floats, lines: Floats, *, ratio: float) -> list[GainStep]:
    """Gains that the floors and orders of a test prove to have changed by ``ratio`` or more, and nothing else did.

    ``speed_rpm`` (recordings,) grows; ``blocks`` (recordings, channels, blocks) is the floor of each block of the
    spectrum, ``lines`` (recordings, channels, orders) the amplitude of each order, NaN where none stands out. Between
    two recordings next in speed the floor of one channel must move by one factor in nearly all blocks, far beyond how
    floors move elsewhere, while all other channels stay; and its orders, beside the same orders of the other channels,
    must fit that factor ``_ODDS`` times better than none. One channel alone proves nothing.
    """
    if len(blocks) < 3 or blocks.shape[1] < 2 or blocks.shape[2] < _FEWEST_BLOCKS:
        return []
    moves = _moves(speed_rpm, blocks)
    whole = median_of_known(moves, axis=2)
    candidates = [(int(s), int(c)) for s, c in zip(*np.nonzero(np.abs(whole) >= math.log(ratio)), strict=True)]
    rest = np.ones(whole.shape, dtype=bool)
    for step, channel in candidates:
        rest[step, channel] = False
    sigma = max(_LEAST_SIGMA, _MAD_TO_SIGMA * float(np.median(np.abs(whole[rest])))) if rest.any() else np.inf
    moved = {step for step, _ in candidates}
    shown = {at: _shown_by_orders(lines, *at, whole[at], moved) for at in candidates}
    proven = [
        GainStep(channel, step + 1, float(whole[step, channel]))
        for step, channel in candidates
        if abs(whole[step, channel]) > _SIGMAS * sigma
        and _is_common(moves[step, channel], whole[step, channel])
        and _others_stay(whole, step, channel)
        and sum(shown.get(at, 0.0) for at in _there_and_back(whole, step, channel)) > math.log(_ODDS)
    ]
    return [step for step in proven if _stays_elsewhere(whole, step, proven)]


def line_sizes(frames: xr.Dataset | None, names: list[str]) -> dict[str, Floats]:
    """Amplitudes in ``frames`` of the cycle's orders in the channels ``names``, by name; NaN where none stands out."""
    if frames is None or "spectrum" not in frames or frames.sizes["order"] <= 2 * _HALF:
        return {}
    at, sizes = cycle_bins(frames), {}
    for name, spectrum in zip(frames["channel"].values.tolist(), frames["spectrum"].values, strict=True):
        power = np.abs(spectrum) ** 2
        known = np.isfinite(power)
        mean = np.where(known, power, 0.0).sum(axis=0) / np.maximum(1, known.sum(axis=0))
        stands = mean[at] > _STANDS * median_beside(mean, _HALF)[at]
        sizes[name] = np.where(stands, np.sqrt(mean[at]), np.nan)
    return {name: sizes[name] for name in names if name in sizes}


def left_out(steps: Sequence[GainStep], n_recordings: int, channel: int) -> tuple[dict[int, float], bool]:
    """Of ``n_recordings`` those in which the gain of ``channel`` is not that of most by these ``steps``, with its log.

    And whether it is open which are right: then all are named. A gain that was switched for good tells nobody which of
    its two was meant, unless one recording alone has the other.
    """
    level = np.zeros(n_recordings)
    own = sorted((step for step in steps if step.channel == channel), key=lambda step: step.after)
    if not own:
        return {}, False
    for step in own:
        level[step.after :] += step.log
    near = 0.5 * min(abs(step.log) for step in own)
    count = [int(np.count_nonzero(np.abs(level - here) < near)) for here in level]
    most = int(np.argmax(count))
    alike = np.abs(level - level[most]) < near
    switched = len(own) == 1 and min(own[0].after, n_recordings - own[0].after) > 1
    if switched or 2 * count[most] <= n_recordings:
        return {row: float(level[row] - np.median(level)) for row in range(n_recordings)}, True
    middle = float(np.median(level[alike]))
    return {row: float(level[row] - middle) for row in np.flatnonzero(~alike).tolist()}, False


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


def _is_common(moves: Floats, jump: float) -> bool:
    """Whether nearly all blocks of a channel move by the ``jump``."""
    known = moves[np.isfinite(moves)]
    near = np.abs(known - jump) <= _STAYS * abs(jump)
    return len(known) >= _FEWEST_BLOCKS and float(np.mean(near)) >= _ALIKE


def _others_stay(whole: Floats, step: int, channel: int) -> bool:
    return bool(np.abs(np.delete(whole[step], channel)).max() <= _STAYS * abs(whole[step, channel]))


def _stays_elsewhere(whole: Floats, gain: GainStep, proven: Sequence[GainStep]) -> bool:
    """Whether the channel's floor stays between all other recordings, but for other proven jumps: none creeps."""
    own = {other.after - 1 for other in proven if other.channel == gain.channel}
    rest = [whole[step, gain.channel] for step in range(len(whole)) if step not in own]
    return not rest or bool(np.nanmax(np.abs(rest)) <= _STAYS * abs(gain.log))


def _there_and_back(whole: Floats, step: int, channel: int) -> list[tuple[int, int]]:
    """The ``step``, and that beside in which the floor moves back: where the gain of one recording is another."""
    jump, beside = whole[step, channel], [at for at in (step - 1, step + 1) if 0 <= at < len(whole)]
    back = [(at, channel) for at in beside if abs(whole[at, channel] + jump) <= _STAYS * abs(jump)]
    return [(step, channel), *(back if len(back) == 1 else [])]


def _shown_by_orders(lines: Floats, step: int, channel: int, jump: float, moved: set[int]) -> float:
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
    elsewhere = np.abs([row for number, row in enumerate(moves) if number not in moved])
    scatter = float(np.median(np.abs(own - np.median(own))))
    scatter = max(scatter, float(np.nanmedian(elsewhere)) if np.isfinite(elsewhere).any() else 0.0)
    return float(np.sum(np.abs(own) - np.abs(own - jump))) / max(_LEAST_SCALE, scatter / math.log(2.0))


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
    flags: dict[tuple[str, str], QualityFlag] = {}
    steady = sorted((level for level in levels if level.is_steady), key=lambda level: level.speed_rpm)
    by_floor = {(flag["recording"], flag["channel"]): flag for flag in _floor_jumps(steady, ratio=ratio)}
    for group in _groups(steady):
        names = [name for name in group[0].rms if all(level.rms.get(name, 0.0) > 0.0 for level in group)]
        if len(names) < 2 or len(group) < 2:
            continue
        logs = np.log([[level.rms[name] for name in names] for level in group])
        # off the lower of two middle ones: between two halves that differ nothing lies
        apart = logs - np.sort(logs, axis=0)[(len(logs) - 1) // 2]
        jumping = [
            (row, at) for row, at in np.argwhere(np.abs(apart) > math.log(ratio)) if _others_stay(apart, row, at)
        ]
        for column, name in enumerate(names):
            rows = {int(row): float(apart[row, at]) for row, at in jumping if at == column}
            beside = [row for row, level in enumerate(group) if (level.recording, name) in by_floor]
            for row, jump, undecided in _wrong_of(rows, beside, len(group)):
                what = f"its level is {math.exp(jump):.3g} times that of the other recordings"
                what += f" at {np.mean(group[row].speed_rpm):.4g} rpm{_unit_doubt(math.exp(jump))}"
                recording = group[row].recording
                flags[recording, name] = _flag(recording, name, what, undecided=undecided)
    proven = _proven(steady, ratio=proven_ratio)
    return [*(proven | by_floor | flags).values(), *_unit_jumps(steady)]


def _unit_doubt(factor: float, near: float = 0.0) -> str:
    """What the ``factor`` of a level may be, where its logarithm is ``near`` that of two units; else ""."""
    off, what = min((abs(abs(math.log(factor)) - math.log(known)), what) for known, what in _UNIT_FACTORS)
    return f" (unit? {what})" if off < max(near, _UNIT_NEAR) else ""


def _unit_jumps(steady: Sequence[RecordedLevel]) -> list[QualityFlag]:
    """Flags of recordings all channels of which lie by one factor, and that of two units, off those next in speed.

    Where channels agree on it the factor is known well; that of a channel alone as well as its floor repeats.
    """
    flags = []
    names, *parts = _floors_apart(steady)
    for each, least, logs, sigma in zip(steady, *parts, strict=False):
        jump, near = float(np.mean(logs)), 2.0 * float(sigma[0]) if len(names) == 1 else 0.0
        doubt = _unit_doubt(math.exp(jump), near)
        stands = np.abs(least).min() > max(3.0 * near, (1.0 - _STAYS) * abs(jump))
        if doubt and stands and float(np.ptp(logs)) < 2.0 * _UNIT_NEAR:
            detail = f"all floors are {math.exp(jump):.3g} times those of the recordings next in speed{doubt}"
            flags.append(remark(each.recording, "unit_doubt", detail, "suspect"))
    return flags


def _proven(steady: Sequence[RecordedLevel], *, ratio: float) -> dict[tuple[str, str], QualityFlag]:
    """Flags by recording and channel of those of the ``steady`` ones whose floors and orders prove another gain."""
    names = list(steady[0].blocks) if steady else []
    alike = [level for level in steady if list(level.blocks) == list(level.lines) == names]
    sizes = {(len(level.blocks[name]), len(level.lines[name])) for level in alike for name in names}
    if len(names) < 2 or len(sizes) != 1:
        return {}
    speed = np.array([np.mean(level.speed_rpm) for level in alike])
    blocks = np.array([[level.blocks[name] for name in names] for level in alike])
    lines = np.array([[level.lines[name] for name in names] for level in alike])
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
    known = 0 < 2 * len(beside) <= count
    return [(row, rows.get(row, back), not known) for row in (beside if known else range(count))]


def _flag(recording: str, channel: str, what: str, *, undecided: bool = False) -> QualityFlag:
    but = f", and nothing tells {WHICH_IS_RIGHT}" if undecided else ""
    detail = f"channel {channel}: {what}, while the other channels stay: a gain or a range was changed{but}"
    flag = remark(recording, "level_jump", detail, "suspect")
    flag["channel"], flag["left_out"] = channel, "channel"
    return flag


def _floor_jumps(steady: Sequence[RecordedLevel], *, ratio: float) -> list[QualityFlag]:
    """Flags of recordings whose floor lies ``ratio`` times or more off both that are next in speed, in one channel.

    A resonance raises the floor of a part of the spectrum, a load that of all channels: a gain that of one, everywhere.
    """
    names, apart, logs, sigma = _floors_apart(steady)
    if len(names) < 2:
        return []
    flags = []
    for row, column in zip(*np.nonzero(np.abs(apart) > math.log(ratio)), strict=True):
        if _others_stay(apart, row, column):
            factor = math.exp(logs[row, column])
            doubt = _unit_doubt(factor, 2.0 * float(sigma[row, column]))
            what = f"its noise floor is {factor:.3g} times that of the recordings next in speed{doubt}"
            flags.append(_flag(steady[row].recording, names[column], what))
    return flags


def _floors_apart(steady: Sequence[RecordedLevel]) -> tuple[list[str], Floats, Floats, Floats]:
    """Channels, and how far the floor (recording, channel) lies off those next in speed: at least, and off their trend.

    Logarithms; 0 where the two next in speed do not agree. Last by how much the other recordings scatter about theirs.
    """
    first = steady[0].floor if steady else {}
    names = [name for name in first if all(level.floor.get(name, 0.0) > 0.0 for level in steady)]
    if not names or len(steady) < 3:
        return names, (none := np.empty((0, len(names)))), none, none
    logs = np.log([[level.floor[name] for name in names] for level in steady])
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
