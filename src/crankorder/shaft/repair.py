"""The part of a pulse train that runs, and the wheel followed through it with the fewest repairs.

A wheel whose teeth are uneven tells its own phase: of all ways to lay its teeth on the pulses, the one is taken whose
speed changes least from tooth to tooth, a lost or false pulse counted as a change of speed by the factor e^REPAIR_COST.
Ways are followed side by side and dropped when they fall behind (a beam search on the tooth phase).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
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
    """Pulses that were kept, the tooth of each, counted on from tooth 0 of the first revolution, and how sure that is.

    ``margin`` is how much more the best way of another phase costs (in changes of the logarithm of the speed);
    ``misfit`` the mean change from tooth to tooth.
    """

    kept: Ints
    count: Ints
    margin: float
    misfit: float


def running_parts(
    time_s: Floats, *, pulses_per_rev: float, gap: float = 1.0, joined: bool = False, lossless: bool = False
) -> tuple[list[slice], list[Remark]]:
    """The runs of pulses without a standstill, in turn, and remarks on what was left out.

    ``time_s``: (pulses,), s, increasing. ``pulses_per_rev``: pulses that come per crank revolution. ``gap``: the
    widest distance of two of them over the usual one. ``joined``: all runs of two revolutions or more, and of pulses
    enough to follow them, where the shaft stands between them; else only the longest. A hole that the speeds on both
    sides fill with the same number of pulses is no standstill, unless they are
    ``lossless``: none can be lost. One track cannot tell the direction: what turns less than a revolution beside a
    standstill may be a kick-back and is flagged ``direction_unknown``.
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
    return used, _left_out(time_s, parts, used, still, [at for at in stops if at not in still], pulses_per_rev)


def running_part(time_s: Floats, *, pulses_per_rev: float, gap: float = 1.0) -> tuple[slice, list[Remark]]:
    """The longest of the :func:`running_parts` of ``time_s``, and remarks; ``pulses_per_rev`` and ``gap`` as there."""
    parts, flags = running_parts(time_s, pulses_per_rev=pulses_per_rev, gap=gap)
    return parts[0], flags


def _left_out(
    time_s: Floats,
    parts: list[slice],
    used: list[slice],
    still: list[int],
    lost: list[int],
    pulses_per_rev: float,
) -> list[Remark]:
    """Remarks on those of the ``parts`` that are not ``used``, and on the holes at which the shaft stands or not."""
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
    return flags


def _turning_points(step: Floats) -> list[int]:
    """Intervals of a few pulses per revolution that are far longer than those beside, into which the shaft slows."""
    longer = [
        at
        for at in range(LEAST_BESIDE, step.size - LEAST_BESIDE)
        if step[at] > TURNING_RATIO * max(step[at - 1], step[at + 1]) and _stops_and_starts(step, at)
    ]
    return [at for at in longer if np.all(np.diff(step[max(0, at - BESIDE) : at]) > 0.0)]


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


def listed_times(time_s: Floats) -> str:
    """Words for the times ``time_s`` [s] of events: the first five, and how many more."""
    listed = ", ".join(f"{value:.6g}" for value in time_s[:5])
    return f"at {listed} s" + (f" and {time_s.size - 5} more" if time_s.size > 5 else "")


def followed_wheel(time_s: Floats, places: Floats, *, repeats: int) -> FollowedWheel:
    """The teeth of an uneven wheel laid on a pulse train, whatever tooth comes first.

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
    room = 10 * n + 64
    ways, reals = np.full((2, 7, room), -1), np.zeros((2, 4, room))
    phases = np.arange(n // repeats)
    ways[0, 0, phases], ways[0, 1, phases], ways[0, 2, phases], reals[0, 0, phases] = phases, 0, phases, np.nan
    nodes = np.zeros((3, 4 * time_s.size + 4 * room), dtype=np.int64)
    nodes[0, phases], nodes[2, phases] = -1, phases
    slot, ends = np.empty(n, dtype=np.int64), np.array([phases.size, phases.size, 0])
    clean = CLEAN_CHANGE if most < 2 else min(CLEAN_CHANGE, CLEAN_SHARE * float(np.diff(log_span[:, :2]).min()))
    nodes = _follow(time_s, log_span, clean, ways, reals, nodes, slot, ends)
    kept, moved, margin, cost = _best_way(ways[0], reals[0], ends[0], nodes)
    return FollowedWheel(kept, np.cumsum(moved), float(margin), float(cost) / kept.size)


# A way is a column of whole numbers (tooth, last pulse, node, and the same three one pulse earlier, and the teeth moved
# last) and one of floats (log of the seconds per revolution, cost, and the same two one pulse earlier). A node is
# (parent, pulse, teeth moved); a node without a parent moves from tooth 0 to the first tooth. Nodes of the best way are
# marked, in the end, by ON_BEST more teeth.
ON_BEST = 1 << 32


@njit(cache=True, nogil=True)
def _follow(time_s, log_span, clean, ways, reals, nodes, slot, ends):  # type: ignore[no-untyped-def]
    """Nodes of all ways; ``ends`` holds how many ways there are, how many nodes, and the last pulse looked at."""
    size, room = time_s.size, ways.shape[2]
    while True:
        if ends[0] == 1 and ends[2] > 0 and ways[0, 1, 0] == ends[2]:
            _run_on(time_s, log_span, clean, ways, reals, nodes, ends)
        ends[2] += 1
        if ends[2] >= size:
            return nodes
        if ends[1] + 2 * room + size - ends[2] > nodes.shape[1]:
            nodes = np.concatenate((nodes, nodes), axis=1)  # as much room again
        slot[:] = -1
        k = ends[0] * 0
        for way in range(ends[0]):
            k = _continued(time_s, log_span, clean, way, ways, reals, k, slot, nodes, ends)
        _prune(ways, reals, k, nodes, ends)


@njit(cache=True, nogil=True)
def _run_on(time_s, log_span, clean, ways, reals, nodes, ends):  # type: ignore[no-untyped-def]
    """Take the only way as far as nothing is in question."""
    i, n_nodes = ends[2], ends[1]
    tooth, node, slow, cost = ways[0, 0, 0], ways[0, 2, 0], reals[0, 0, 0], reals[0, 1, 0]
    while i + 1 < time_s.size:
        step = time_s[i + 1] - time_s[i]
        if not step > 0.0:
            break
        change = np.log(step) - log_span[tooth, 0] - slow
        if not abs(change) < clean:
            break
        ways[0, 3, 0], ways[0, 4, 0], ways[0, 5, 0], ways[0, 6, 0] = tooth, i, node, 1
        reals[0, 2, 0], reals[0, 3, 0] = slow, cost
        i += 1
        nodes[0, n_nodes], nodes[1, n_nodes], nodes[2, n_nodes] = node, i, 1
        node, n_nodes = n_nodes, n_nodes + 1
        tooth += 1
        if tooth == log_span.shape[0]:
            tooth = 0
        slow, cost = slow + FOLLOWED_SHARE * change, cost + abs(change)
    ways[0, 0, 0], ways[0, 1, 0], ways[0, 2, 0], reals[0, 0, 0], reals[0, 1, 0] = tooth, i, node, slow, cost
    ends[1], ends[2] = n_nodes, i


@njit(cache=True, nogil=True)
def _prune(ways, reals, k, nodes, ends):  # type: ignore[no-untyped-def]
    """Take over those of the ``k`` next ways that are not far behind the best, each with its node."""
    best, m, n_nodes = np.inf, k * 0, ends[1]
    for way in range(k):
        if reals[1, 1, way] < best:
            best = reals[1, 1, way]
    for way in range(k):
        if reals[1, 1, way] <= best + DROP_COST and 2 * m < ways.shape[2]:
            for row in range(7):
                ways[0, row, m] = ways[1, row, way]
            for row in range(4):
                reals[0, row, m] = reals[1, row, way]
            if ways[0, 2, m] < 0:
                nodes[0, n_nodes], nodes[1, n_nodes], nodes[2, n_nodes] = ways[0, 5, m], ends[2], ways[0, 6, m]
                ways[0, 2, m] = n_nodes
                n_nodes += 1
            m += 1
    ends[0], ends[1] = m, n_nodes


@njit(cache=True, nogil=True)
def _continued(time_s, log_span, clean, way, ways, reals, k, slot, nodes, ends):  # type: ignore[no-untyped-def]
    """Add all that the next pulse may be after one way to the next ways; how many there are now."""
    i, tooth, last, node = ends[2], ways[0, 0, way], ways[0, 1, way], ways[0, 2, way]
    slow, cost = reals[0, 0, way], reals[0, 1, way]
    step = time_s[i] - time_s[last]
    log_s = np.log(step if step > 1e-12 else 1e-12)
    log_now = log_s - log_span[tooth, 0]
    change, price = abs(log_now - slow), cost
    for teeth in range(1, log_span.shape[1] + 1):
        log_slow = log_s - log_span[tooth, teeth - 1]
        if teeth == 1 or abs(log_slow - slow) < change:
            k = _added(ways, reals, slot, k, i, tooth, last, node, slow, cost, teeth, log_slow, price)
        if not change >= clean:
            return k
        price += REPAIR_COST if teeth == 1 else NEXT_LOST_COST
    if k < ways.shape[2]:  # this pulse is false
        for row in range(7):
            ways[1, row, k] = ways[0, row, way]
        for row in range(4):
            reals[1, row, k] = reals[0, row, way]
        reals[1, 1, k] = cost + REPAIR_COST
        k += 1
    node_0 = ways[0, 5, way]
    if node_0 < 0:
        return k
    first = nodes[0, node_0] < 0
    for begins in range(2 if first else 1):
        if begins == 0:
            # the last pulse of this way was false, with all between it and this one
            tooth_0, last_0, slow, cost = ways[0, 3, way], ways[0, 4, way], reals[0, 2, way], reals[0, 3, way]
            log_slow = np.log(time_s[i] - time_s[last_0] + 1e-12) - log_span[tooth_0, 0]
            price = cost + (i - last_0 - 1) * REPAIR_COST
        else:
            # or the one before it was, and the train begins with it
            nodes[0, ends[1]], nodes[1, ends[1]], nodes[2, ends[1]] = -1, last, tooth
            tooth_0, last_0, node_0, slow, log_slow = tooth, last, ends[1], np.nan, log_now
            cost += (i - last) * REPAIR_COST
            price = cost
            ends[1] += 1
        k = _added(ways, reals, slot, k, i, tooth_0, last_0, node_0, slow, cost, begins * 0 + 1, log_slow, price)
    return k


@njit(cache=True, nogil=True)
def _added(ways, reals, slot, k, i, tooth, last, node, slow, cost, teeth, log_slow, price):  # type: ignore[no-untyped-def]
    """Add the way over ``teeth`` to pulse ``i`` at its price, unless one at its tooth is cheaper; how many now."""
    change = 0.0 if slow != slow else log_slow - slow
    price_now, tooth_now = price + abs(change), (tooth + teeth) % slot.size
    at = slot[tooth_now]
    if at < 0:
        at, k = k, k + 1
        slot[tooth_now] = at
    elif reals[1, 1, at] <= price_now:
        return k
    ways[1, 0, at], ways[1, 1, at], ways[1, 2, at], ways[1, 3, at] = tooth_now, i, -1, tooth
    ways[1, 4, at], ways[1, 5, at], ways[1, 6, at] = last, node, teeth
    reals[1, 0, at] = log_slow if slow != slow else slow + FOLLOWED_SHARE * min(max(change, -1.0), 1.0)
    reals[1, 1, at], reals[1, 2, at], reals[1, 3, at] = price_now, slow, cost
    return k


@njit(cache=True, nogil=True)
def _best_way(ways, reals, m, nodes):  # type: ignore[no-untyped-def]
    """Kept pulses and teeth moved to each along the cheapest way, how much more another phase costs, its cost."""
    best, margin, length, early = 0, np.inf, 0, ways.shape[1] // 10
    for way in range(m):
        best = way if reals[1, way] < reals[1, best] else best
    node = ways[2, best]
    while node >= 0:
        nodes[2, node] += ON_BEST
        length, node = length + 1, nodes[0, node]
    for way in range(m):
        # a way that parts from the best one only late says nothing of the phase before
        node = ways[2, way]
        while node >= 0 and nodes[2, node] < ON_BEST:
            node = nodes[0, node]
        if node < 0 or nodes[1, node] < early:
            margin = min(margin, reals[1, way] - reals[1, best]) if way != best else margin
    kept, moved = np.empty(length, dtype=np.int64), np.empty(length, dtype=np.int64)
    node = ways[2, best]
    for at in range(length - 1, -1, -1):
        kept[at], moved[at] = nodes[1, node], nodes[2, node] - ON_BEST
        node = nodes[0, node]
    return kept, moved, margin, reals[1, best]
