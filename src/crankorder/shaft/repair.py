"""The part of a pulse train that runs, and the wheel followed through it with the fewest repairs.

A wheel whose teeth are uneven tells its own phase: of all ways to lay its teeth on the pulses, the one is taken whose
speed changes least from tooth to tooth, a lost or false pulse counted as a change of speed by the factor e^REPAIR_COST.
Ways are followed side by side and dropped when they fall behind (a beam search on the tooth phase).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import xarray as xr
from numba import njit

from crankorder.quantities import Floats, Ints
from crankorder.shaft.pulses import Remark

# A crank slower than this stands still for our purpose; of a slow machine, one a tenth as fast as it is mostly.
STANDSTILL_RPM, STANDSTILL_SHARE = 30.0, 0.1
# Pulses were lost, and the shaft ran on, where the speeds on both sides of a hole agree on the count this well.
SAME_COUNT_TEETH = 0.5
# … and that is no more than this share of all pulses: steady speeds agree on any count.
FILLED_SHARE = 0.05
# The speed beside a hole is the median over this many intervals.
BESIDE = 4
# Runs on both sides of a standstill are joined from so many pulses and revolutions on.
FEWEST_PULSES, FEWEST_REVS = 6, 2.0
# Of so few pulses per revolution one interval may hide a standstill: it is longer than both beside it by this factor.
FEW_PULSES, TURNING_RATIO = 8, 1.5
# By this factor these intervals grow into a stop and shrink out of it, over so many at least.
SLOWED = 1.2
LEAST_BESIDE = 2

# A repair costs as much as a change of the logarithm of the speed by this; each further tooth lost in a row the second.
REPAIR_COST, NEXT_LOST_COST = 0.9, 0.15
# A change of the logarithm of the speed below this raises no question, or below this share of what tells a tooth from
# the next one, if that is less.
CLEAN_CHANGE, CLEAN_SHARE = 0.25, 0.5
# A way this far behind the best is dropped; teeth lost in a row that are thought of.
DROP_COST, MOST_LOST = 6.0, 12
# The speed that is followed takes up this share of each change, itself limited to one.
FOLLOWED_SHARE = 0.6


@dataclass(frozen=True)
class FollowedWheel:
    """Pulses that were kept, and the tooth of each.

    ``kept`` (kept,) are the indices of the pulses, ``count`` (kept,) their teeth, counted on from tooth 0 of the first
    revolution. ``margin`` is how much more the best assignment of another phase costs (in changes of the logarithm of
    the speed), ``misfit`` the mean change from tooth to tooth.
    """

    kept: Ints
    count: Ints
    margin: float
    misfit: float


def running_parts(
    time_s: Floats, *, pulses_per_rev: float, gap: float = 1.0, joined: bool = False, lossless: bool = False
) -> tuple[list[slice], list[Remark]]:
    """The runs of pulses without a standstill, in the order of time, and remarks on what was left out.

    A hole that the speeds on both sides fill with the same number of pulses is no standstill, unless the pulses are
    ``lossless``. One track cannot tell the direction: a turn of less than a revolution beside a standstill may be a
    kick-back and is flagged ``direction_unknown``.

    Parameters
    ----------
    time_s : (pulses,), s, increasing
    pulses_per_rev : pulses per crank revolution
    gap : widest distance of two teeth over the usual one, 1 or more
    joined : True for all runs of two revolutions or more, with pulses enough to follow them, where the shaft stands
        between them; else only the longest
    lossless : whether no pulse can be lost
    """
    step = np.diff(time_s)
    limit = gap * 60.0 / (STANDSTILL_RPM * pulses_per_rev)
    turned = _turning_points(step) if gap == 1.0 and pulses_per_rev <= FEW_PULSES else []
    if step.max() <= limit and not turned:
        return [slice(0, time_s.size)], []
    limit = max(limit, gap * float(np.median(step)) / STANDSTILL_SHARE)
    holes = [int(at) for at in np.flatnonzero(step > limit)]
    stops = sorted({at for at in holes if lossless or not _same_count(step, at, limit)} | set(turned))
    if not stops:
        return [slice(0, time_s.size)], []
    parts = [slice(first, end) for first, end in pairwise([0, *(at + 1 for at in stops), time_s.size])]
    longest = max(parts, key=lambda part: part.stop - part.start)
    # it slows before or starts after the hole, rather than runs as usual on both sides
    slow_s = min(limit / 5.0, 3.0 * float(np.median(step)))
    still = [at for at in stops if lossless or at in turned or max(_beside(step, at)) > slow_s]
    used = [longest]
    if joined and len(still) == len(stops):
        fewest = max(FEWEST_PULSES, FEWEST_REVS * pulses_per_rev)
        used = [part for part in parts if part == longest or part.stop - part.start > fewest]
    lost = [at for at in stops if at not in still]
    stray = [part for part in parts if part.stop - part.start < max(2.0, pulses_per_rev) and part not in used]
    flags: list[Remark] = []
    if still:
        what = "no orders there" if len(used) > 1 else "left out"
        flags.append(("standstill", "info", f"the shaft stands still {_spans(time_s, still, stray)}: {what}"))
    if lost:
        detail = f"no pulses {_spans(time_s, lost, stray)}: encoder lost or standstill, no count there"
        flags.append(("encoder_gap", "suspect", detail))
    if stray:
        n = sum(part.stop - part.start for part in stray)
        detail = f"{n} pulses of less than a revolution beside a standstill, {_times(time_s, stray)}: left out"
        flags.append(("direction_unknown", "suspect", detail))
    runs = [part for part in parts if part not in stray and part not in used]
    if runs:
        flags.append(("encoder_part_unused", "suspect", f"shorter runs of the shaft left out, {_times(time_s, runs)}"))
    return used, flags


def _turning_points(step: Floats) -> list[int]:
    """Intervals of a few pulses per revolution that are far longer than those beside, into which the shaft slows."""
    inner = range(LEAST_BESIDE, step.size - LEAST_BESIDE)
    longer = (at for at in inner if step[at] > TURNING_RATIO * max(step[at - 1], step[at + 1]))
    turning = (at for at in longer if _stops_and_starts(step, at))
    return [at for at in turning if np.all(np.diff(step[max(0, at - BESIDE) : at]) > 0.0)]


def _beside(step: Floats, at: int) -> tuple[float, float]:
    """Pulse intervals before and after the hole ``at``; infinite where there is none."""
    before, after = step[max(0, at - BESIDE) : at], step[at + 1 : at + 1 + BESIDE]
    return float(np.median(before)) if before.size else np.inf, float(np.median(after)) if after.size else np.inf


def _same_count(step: Floats, at: int, limit: float) -> bool:
    before, after = _beside(step, at)
    if _stops_and_starts(step, at) or step[at] > FILLED_SHARE * step.size * before:
        return False
    return max(before, after) < limit and abs(step[at] / before - step[at] / after) < SAME_COUNT_TEETH


def _stops_and_starts(step: Floats, at: int) -> bool:
    """Whether the shaft slows down into the hole ``at`` and speeds up out of it: symmetric, but no steady running."""
    before, after = step[max(0, at - BESIDE) : at], step[at + 1 : at + 1 + BESIDE]
    if min(before.size, after.size) < LEAST_BESIDE:
        return False
    return bool(before[-1] > SLOWED * before[0] and after[0] > SLOWED * after[-1])


def _spans(time_s: Floats, holes: list[int], stray: list[slice]) -> str:
    """Words for the times of ``holes``; those with nothing but a ``stray`` part between them are one."""
    spans = [[holes[0], holes[0]]]
    for at in holes[1:]:
        if any(part.start == spans[-1][1] + 1 and part.stop == at + 1 for part in stray):
            spans[-1][1] = at
        else:
            spans.append([at, at])
    words = [f"from {time_s[first]:.6g} to {time_s[last + 1]:.6g} s" for first, last in spans]
    return ", ".join(words[:4]) + (f" and {len(words) - 4} times more" if len(words) > 4 else "")


def _times(time_s: Floats, parts: list[slice]) -> str:
    if len(parts) > 4:
        return f"in {len(parts)} parts from {time_s[parts[0].start]:.6g} to {time_s[parts[-1].stop - 1]:.6g} s"
    return ", ".join(f"{time_s[part.start]:.6g} to {time_s[part.stop - 1]:.6g} s" for part in parts)


LEAST_REVS = 2.0
"""Turns, at the speed beside it, that a stretch without pulses must last to be worth a remark …"""

LEAST_INTERVALS = 4.0
"""… and so many times as long as the intervals between the pulses beside."""

BESIDE_SHARE = 0.1
"""Share of the time with pulses in which the speed beside the silence, and its change, are looked at."""

GOES_ON = 0.5
"""Vibration that keeps this share of its amplitude when the pulses stop is that of a machine that runs on."""

LOOK_S = 1.0
"""Length of the silence, from where the pulses are, whose vibration is looked at."""

NO_PULSES = "no_pulses"
"""Flag of a stretch without pulses."""


def silent_ends(recording: xr.Dataset, shaft: xr.Dataset) -> list[Remark]:
    """Remarks on the ends of a recording that its pulses do not reach.

    ``recording`` is a Recording (channel, time), ``shaft`` its ShaftAngle (time).
    """
    if "pulse_time" not in recording or "rate_hz" not in recording.attrs:
        return []
    pulse_s, signal = (recording.variables[name].values for name in ("pulse_time", "signal"))
    rate_hz = float(recording.attrs["rate_hz"])
    length_s = signal.shape[1] / rate_hz
    if pulse_s.size < 4 or not 0.0 <= pulse_s[0] < pulse_s[-1] <= length_s + 1.0 / rate_hz:
        return []
    time_s, speed_rpm = (shaft.variables[name].values for name in ("time", "speed"))
    end = _silence(pulse_s, time_s, speed_rpm, signal, rate_hz, at_end=True)
    # the start is the end of the recording played backwards
    backwards = (length_s - pulse_s[::-1], length_s - time_s[::-1], speed_rpm[::-1], signal[:, ::-1])
    remarks = (_silence(*backwards, rate_hz, at_end=False), end)
    return [remark for remark in remarks if remark is not None]


def _silence(
    pulse_s: Floats, time_s: Floats, speed_rpm: Floats, signal: Floats, rate_hz: float, *, at_end: bool
) -> Remark | None:
    """Remark on a stretch without pulses at the end of ``signal`` (channels, samples); None where none is long.

    It tells a standstill, where the speed beside falls so fast that the shaft may have come to rest, from an encoder
    that was lost, where the vibration goes on. Unless ``at_end``, all is given as played backwards.
    """
    length_s, edge_s = signal.shape[1] / rate_hz, float(pulse_s[-1])
    gap_s = length_s - edge_s
    if gap_s <= LEAST_INTERVALS * float(np.median(np.diff(pulse_s[-4:]))):
        return None
    reach_s = edge_s - float(pulse_s[-max(3, round(BESIDE_SHARE * pulse_s.size))])
    rpm, may_stand = _speed_at_end(time_s - edge_s, speed_rpm, reach_s, gap_s)
    if not gap_s * rpm / 60.0 > LEAST_REVS:
        return None
    vibration = _vibration_share(signal, round(edge_s * rate_hz), int(min(LOOK_S, gap_s) * rate_hz))
    span = f"{edge_s:.3g} s to the end at {length_s:.3g} s" if at_end else f"0 s to {gap_s:.3g} s"
    speed = f"the speed {'before' if at_end else 'after'} was {rpm:.4g} rpm"
    length = f"{gap_s:.3g} s are left out of all that follows the shaft"
    goes_on = vibration >= GOES_ON
    if may_stand and not goes_on:
        return (NO_PULSES, "info", f"no pulses from {span}: standstill or encoder lost; {speed}; {length}")
    cause = "encoder lost while the machine ran" if goes_on and not may_stand else "encoder lost or standstill"
    level = f"; the vibration goes on at {100.0 * vibration:.0f} % of its amplitude" if goes_on else ""
    return (NO_PULSES, "suspect", f"no pulses from {span}: {cause}; {speed}{level}; {length}")


def _speed_at_end(time_s: Floats, speed_rpm: Floats, reach_s: float, gap_s: float) -> tuple[float, bool]:
    """Speed [rpm] at time 0, from those up to ``reach_s`` before, and whether its slope brings it to rest in time."""
    close = (time_s >= -reach_s) & (time_s <= 0.0) & np.isfinite(speed_rpm)
    if np.count_nonzero(close) < 2:
        return float(np.nan_to_num(np.abs(speed_rpm[-1]))), False
    away, beside = -time_s[close], np.abs(speed_rpm[close])
    slope, at_edge = np.polyfit(away, beside, 1)
    return max(float(at_edge), float(beside[-1]), 0.0), bool(slope * gap_s > max(float(at_edge), 0.0))


def _vibration_share(signal: Floats, edge: int, count: int) -> float:
    """Amplitude of ``count`` samples from ``edge`` on over that of all before, where a channel falls least.

    Over all before: of a shaft that comes to rest the last turns are as quiet as a sensor's noise.
    """
    inside, running = signal[:, edge : edge + count], signal[:, :edge]
    if min(inside.shape[1], running.shape[1]) < 2:
        return float("nan")
    known = np.isfinite(inside).any(axis=1) & np.isfinite(running).any(axis=1)
    quiet, loud = (np.nanstd(part[known].astype(np.float64), axis=1) for part in (inside, running))
    moves = loud > 0.0
    return float((quiet[moves] / loud[moves]).max()) if moves.any() else float("nan")


def followed_wheel(time_s: Floats, places: Floats, *, repeats: int) -> FollowedWheel:
    """Assignment of the teeth of an uneven wheel to a pulse train, whatever tooth comes first.

    Parameters
    ----------
    time_s : (pulses,), s, not decreasing, 2 or more
    places : (teeth,), rev, places of the teeth from 0 to below 1, rising
    repeats : how often per revolution the wheel looks the same; the phase is known within this part of a revolution

    Returns
    -------
    FollowedWheel; ``count`` grows by the number of teeth of the wheel with each revolution.
    """
    span = np.diff(places, append=places[0] + 1.0)
    n, most = span.size, min(MOST_LOST + 1, span.size)
    log_span = np.log(np.array([np.cumsum(np.roll(span, -tooth))[:most] for tooth in range(n)]))
    ways, phases = np.zeros((2, 10 * n + 64), dtype=WAY), np.arange(n // repeats)
    ways["node_0"] = -1
    begins = ways[0, : phases.size]
    begins["tooth"], begins["node"], begins["slow"] = phases, phases, np.nan
    nodes = np.zeros((3, 4 * (time_s.size + ways.shape[1])), dtype=np.int64)
    nodes[PARENT, phases], nodes[MOVED, phases] = -1, phases
    clean = CLEAN_CHANGE if most < 2 else min(CLEAN_CHANGE, CLEAN_SHARE * float(np.diff(log_span[:, :2]).min()))
    nodes, n_ways = _follow(time_s, log_span, clean, ways[0], ways[1], nodes, phases.size)
    kept, moved, margin, cost = _best_way(ways[0, :n_ways], nodes, ways.shape[1] // 10)
    return FollowedWheel(kept, np.cumsum(moved), float(margin), float(cost) / kept.size)


WAY = np.dtype(
    [(name, np.int64) for name in ("tooth", "last", "node", "moved", "tooth_0", "last_0", "node_0")]
    + [(name, np.float64) for name in ("slow", "cost", "slow_0", "cost_0")]
)
"""A way to lay the wheel: its tooth, its last pulse and their node, the teeth moved last, the log of the seconds per
revolution, the cost; ``_0``: one pulse earlier, no node (-1) where the way begins."""

PARENT, PULSE, MOVED = 0, 1, 2
"""Rows of nodes: the node before, the pulse, the teeth moved to it. One without a parent moves from tooth 0."""

ON_BEST = 1 << 32
"""Teeth by which nodes of the best way are marked in the end."""


@njit(cache=True, nogil=True)
def _follow(time_s, log_span, clean, ways, after, nodes, n_ways):  # type: ignore[no-untyped-def]
    """Follow all ``ways``, of which ``after`` takes those over one pulse more; nodes, and how many ways are left."""
    n_nodes, slot = n_ways, np.empty(log_span.shape[0], dtype=np.int64)
    for i in range(1, time_s.size):
        if n_nodes + 2 * ways.size + time_s.size - i > nodes.shape[1]:
            nodes = np.concatenate((nodes, nodes), axis=1)  # as much room again
        slot[:] = -1
        k = 0
        for way in range(n_ways):
            k, n_nodes = _continued(time_s, log_span, clean, i, ways[way], after, k, slot, nodes, n_nodes)
        n_ways, n_nodes = _prune(ways, after, k, i, nodes, n_nodes)
    return nodes, n_ways


@njit(cache=True, nogil=True)
def _prune(ways, after, k, i, nodes, n_nodes):  # type: ignore[no-untyped-def]
    """Take over those of the ``k`` next ways that are not far behind the best, each with its node; how many of both."""
    best, m = np.inf, 0
    for way in range(k):
        best = min(best, after[way].cost)
    for way in range(k):
        if after[way].cost <= best + DROP_COST and 2 * m < ways.size:
            ways[m] = after[way]
            if ways[m].node < 0:
                nodes[PARENT, n_nodes], nodes[PULSE, n_nodes], nodes[MOVED, n_nodes] = ways[m].node_0, i, ways[m].moved
                ways[m].node = n_nodes
                n_nodes += 1
            m += 1
    return m, n_nodes


@njit(cache=True, nogil=True)
def _continued(time_s, log_span, clean, i, way, after, k, slot, nodes, n_nodes):  # type: ignore[no-untyped-def]
    """Add all that pulse ``i`` may be after one way to the next ways; how many there are now, and how many nodes."""
    log_s = np.log(max(time_s[i] - time_s[way.last], 1e-12))
    log_now = log_s - log_span[way.tooth, 0]
    change, price = abs(log_now - way.slow), way.cost
    for teeth in range(1, log_span.shape[1] + 1):
        log_slow = log_s - log_span[way.tooth, teeth - 1]
        if teeth == 1 or abs(log_slow - way.slow) < change:
            k = _added(after, slot, k, i, way.tooth, way.last, way.node, way.slow, way.cost, teeth, log_slow, price)
        if not change >= clean:
            return k, n_nodes
        price += REPAIR_COST if teeth == 1 else NEXT_LOST_COST
    if k < after.size:  # this pulse is false
        after[k] = way
        after[k].cost = way.cost + REPAIR_COST
        k += 1
    if way.node_0 < 0:
        return k, n_nodes
    # the last pulse of this way was false, with all between it and this one
    log_slow = np.log(time_s[i] - time_s[way.last_0] + 1e-12) - log_span[way.tooth_0, 0]
    price = way.cost_0 + (i - way.last_0 - 1) * REPAIR_COST
    k = _added(after, slot, k, i, way.tooth_0, way.last_0, way.node_0, way.slow_0, way.cost_0, 1, log_slow, price)
    if nodes[PARENT, way.node_0] < 0:
        # or the one before it was, and the train begins with it
        nodes[PARENT, n_nodes], nodes[PULSE, n_nodes], nodes[MOVED, n_nodes] = -1, way.last, way.tooth
        price = way.cost_0 + (i - way.last) * REPAIR_COST
        k = _added(after, slot, k, i, way.tooth, way.last, n_nodes, np.nan, price, 1, log_now, price)
        n_nodes += 1
    return k, n_nodes


@njit(cache=True, nogil=True)
def _added(after, slot, k, i, tooth, last, node, slow, cost, teeth, log_slow, price):  # type: ignore[no-untyped-def]
    """Add the way over ``teeth`` to pulse ``i`` at its price, unless one at its tooth is cheaper; how many now."""
    change = 0.0 if np.isnan(slow) else log_slow - slow
    price_now, tooth_now = price + abs(change), (tooth + teeth) % slot.size
    at = slot[tooth_now]
    if at < 0:
        at = slot[tooth_now] = k
        k += 1
    elif after[at].cost <= price_now:
        return k
    way = after[at]
    way.tooth, way.last, way.node, way.moved, way.cost = tooth_now, i, -1, teeth, price_now
    way.tooth_0, way.last_0, way.node_0, way.slow_0, way.cost_0 = tooth, last, node, slow, cost
    way.slow = log_slow if np.isnan(slow) else slow + FOLLOWED_SHARE * min(max(change, -1.0), 1.0)
    return k


@njit(cache=True, nogil=True)
def _best_way(ways, nodes, early):  # type: ignore[no-untyped-def]
    """Kept pulses and teeth moved to each along the cheapest way, how much more another phase costs, its cost.

    Another phase is that of a way that parts from the cheapest one before pulse ``early``.
    """
    best, margin, length = 0, np.inf, 0
    for way in range(ways.size):
        best = way if ways[way].cost < ways[best].cost else best
    node = ways[best].node
    while node >= 0:
        nodes[MOVED, node] += ON_BEST
        length, node = length + 1, nodes[PARENT, node]
    for way in range(ways.size):
        node = ways[way].node
        while node >= 0 and nodes[MOVED, node] < ON_BEST:
            node = nodes[PARENT, node]
        if way != best and (node < 0 or nodes[PULSE, node] < early):
            margin = min(margin, ways[way].cost - ways[best].cost)
    kept, moved = np.empty(length, dtype=np.int64), np.empty(length, dtype=np.int64)
    node = ways[best].node
    for at in range(length - 1, -1, -1):
        kept[at], moved[at] = nodes[PULSE, node], nodes[MOVED, node] - ON_BEST
        node = nodes[PARENT, node]
    return kept, moved, margin, ways[best].cost
