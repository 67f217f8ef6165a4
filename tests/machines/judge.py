"""What the program said of one drawn machine, statement by statement, held against what is so."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.optimize import linear_sum_assignment

from machines.bound import KNOWN_FREQUENCY, Bound, free_for_the_oracle, lock_told, told_from_a_tone
from machines.folder import Take
from machines.lines import TrueLine, causes, is_resolved, line_of
from machines.machine import FloatArray, Machine
from machines.tracks import judged_rows
from machines.truth import dangerous_speeds, recorded_maximum, steady_maximum
from made.contradictions import contradictions

NEAR_MODE = 0.01
"""A record within this share of a true frequency, or within its own interval, is of that mode."""
END_REACH = 0.06
"""Share of the speed that a frame at the end of a sweep stays away from it."""
SAME_SIZE = 0.97
"""A line with this share of the strongest is as strong as that."""


@dataclass(frozen=True)
class Judgement:
    """One statement: ``kind`` (a column of the table), how much of it is ``good``, ``of`` how much, and the words."""

    kind: str
    good: float
    of: float = 1.0
    words: str = ""


@dataclass(frozen=True)
class Said:
    """What the program wrote: the findings, and the order tracks where there are any."""

    findings: dict[str, Any]
    tracks: xr.Dataset | None

    @classmethod
    def read(cls, out: Path) -> Said:
        """The results of the only test in the folder ``out``."""
        folder = next(path.parent for path in out.glob("*/findings.json"))
        findings = json.loads((folder / "findings.json").read_text(encoding="utf-8"))
        try:
            with xr.open_dataset(folder / "results.nc", group="order_tracks", engine="h5netcdf") as tracks:
                return cls(findings, tracks.load())
        except (OSError, KeyError):
            return cls(findings, None)


def judged(machine: Machine, takes: tuple[Take, ...], bound: Bound, said: Said) -> tuple[Judgement, ...]:
    """All judgements on what was ``said`` of ``machine``; ``takes``: what was recorded; ``bound``: what could be."""
    return (
        *_speeds(machine, bound, said.findings),
        *_orders(machine, takes, bound, said.findings),
        *_modes(machine, bound, said.findings),
        *(Judgement("part real", float(good), 1.0, words) for good, words in causes(machine, takes, said.findings)),
        *_contradictions(said.findings),
        *(Judgement("rows", float(row.right), 1.0, row.words) for row in judged_rows(machine, takes, said.tracks)),
    )


def _contradictions(findings: dict[str, Any]) -> list[Judgement]:
    """A wrong statement for each pair of sentences or fields that exclude each other; else one right one."""
    words = contradictions(findings)
    return [Judgement("consistent", 0.0, 1.0, one) for one in words] or [Judgement("consistent", 1.0)]


def _speeds(machine: Machine, bound: Bound, findings: dict[str, Any]) -> list[Judgement]:
    """Dangerous speeds called free; what of the others is called free, beside the estimator that knows."""
    bands = [(band["low_rpm"], band["high_rpm"]) for band in findings["free_bands"]]
    numbers = {order.order: place for place, order in enumerate(machine.orders)}
    every = dangerous_speeds(machine)
    dangerous = [item for item in every if bound.seen[numbers[item.order]]]
    avoid = [item["rpm_range"] for item in findings["speeds_to_avoid"]]
    made = []
    for item in dangerous:
        words = (
            f"order {item.order:g} meets {item.mode_hz:.4g} Hz at {item.worst_rpm:.0f} rpm ({item.factor:.0f} times)"
        )
        called = [band for band in bands if band[0] <= item.worst_rpm <= band[1]]
        free = f"; called free {called[0][0]:.0f} to {called[0][1]:.0f} rpm" if called else ""
        made.append(Judgement("dangerous not free", float(not called), 1.0, words + free))
        named = any(low <= item.high_rpm and item.low_rpm <= high for low, high in avoid)
        made.append(Judgement("dangerous named", float(named), 1.0, words))
    low, high = machine.tested_rpm[0], machine.tested_rpm[-1]
    if high - low < 1.0:
        return made
    rpm = np.linspace(low, high, 4001)
    safe, in_band = np.ones(rpm.size, dtype=bool), np.zeros(rpm.size, dtype=bool)
    for item in every:
        safe &= ~((rpm >= item.low_rpm) & (rpm <= item.high_rpm))
    for begin, end in bands:
        in_band |= (rpm >= begin) & (rpm <= end)
    if (~safe).any():
        made.append(Judgement("dangerous range not free", float((~safe & ~in_band).mean()), float((~safe).mean())))
    oracle = free_for_the_oracle(machine, bound, rpm, every)
    made.append(Judgement("decided: free", float((oracle * in_band).mean()), float(oracle.mean())))
    return made


def _orders(machine: Machine, takes: tuple[Take, ...], bound: Bound, findings: dict[str, Any]) -> list[Judgement]:
    made: list[Judgement] = []
    lines = [(record, line_of(machine, takes, record)) for record in findings["orders"]]
    records = [(record, None if line is None else line.place) for record, line in lines]
    largest = np.stack([recorded_maximum(machine, takes, place) for place in range(len(machine.orders))])
    steady = np.stack([steady_maximum(machine, place) for place in range(len(machine.orders))])
    made.append(_strongest(machine, records, largest, steady))
    told = lock_told(machine, bound)
    for place, order in enumerate(machine.orders):
        own = [record for record, true in records if true == place]
        truth = "locked" if machine.is_locked(order) else "slips"
        locks = {record["lock"] for record in own}
        wrong = locks & {"locked", "slips"} - {truth}
        for record in own[:1]:
            words = (
                f"order {order.order:g} ({truth}) read as {record['order']:.6g} ({'/'.join(map(str, sorted(locks)))})"
            )
            made.append(Judgement("lock", float(not wrong), 1.0, words))
        if bound.seen[place]:
            made.append(Judgement("order found", float(bool(own)), 1.0, f"order {order.order:g}"))
            if told[place]:
                made.append(Judgement("decided: lock", float(truth in locks and not wrong), 1.0, f"{order.order:g}"))
    for record, line in lines:
        true = None if line is None else line.place
        if true is None:
            made += _no_order(machine, record, line)
            continue
        made.append(Judgement("order real", 1.0))
        made += _amplitude(machine, takes, record, true, largest, steady)
        made += _phase(machine, takes, record, true)
    return made


def _no_order(machine: Machine, record: dict[str, Any], line: TrueLine | None) -> list[Judgement]:
    """On a ``record`` that is no order of the machine: whether a ``line`` stands there all the same, and its lock."""
    if line is None:
        words = f"order {record['order']:.5g} of {record['amplitude']:.3g} m/s² is nothing"
        return [Judgement("order real", 0.0, 1.0, words)]
    judgements = [Judgement("order real", 1.0)]
    if not line.is_tone or is_resolved(machine, line, record["speed_rpm_at_max"]):
        words = f"{'the mains' if line.is_tone else 'a line of the swing'} read as order {record['order']:.5g}"
        judgements.append(Judgement("lock", float(record["lock"] not in {"locked", "slips"} - {line.lock}), 1.0, words))
    return judgements


def _strongest(
    machine: Machine, records: list[tuple[dict[str, Any], int | None]], largest: FloatArray, steady: FloatArray
) -> Judgement:
    size = np.maximum(largest, steady if not machine.steady else 0.0).max(axis=1)
    best = int(np.argmax(largest.max(axis=1)))
    truth = f"order {machine.orders[best].order:g}"
    if not records:
        return Judgement("strongest", 0.0, 1.0, f"no order found; {truth} is the strongest")
    record, true = max(records, key=lambda pair: float(pair[0]["amplitude"]))
    good = true is not None and size[true] >= SAME_SIZE * largest.max()
    return Judgement(
        "strongest", float(good), 1.0, f"order {record['order']:.5g} said to be the strongest, it is {truth}"
    )


def _holds(interval: list[float] | None, value: float) -> bool:
    # what the file rounds to ten digits is not a miss
    return interval is not None and interval[0] - 1e-9 * abs(value) <= value <= interval[1] + 1e-9 * abs(value)


def _width(value: float, interval: list[float]) -> Judgement:
    """Logarithm of half the width of ``interval`` over ``value``: an interval that always holds the truth is easy."""
    return Judgement("log width", float(np.log(max(0.5 * (interval[1] - interval[0]), 1e-12 * value) / value)))


def _amplitude(
    machine: Machine, takes: tuple[Take, ...], record: dict[str, Any], true: int, largest: FloatArray,
    steady: FloatArray,
) -> list[Judgement]:  # fmt: skip
    channel = machine.channels.index(record["channel"])
    interval, at = record["amplitude_ci95"], record["speed_rpm_at_max"]
    was, would = float(largest[true, channel]), float(steady[true, channel])
    near = [
        float(size.max() if not machine.steady else size.mean())
        for take in takes
        if (size := np.abs(take.envelopes[true][channel])[np.abs(take.speed_rpm / at - 1.0) <= 0.03]).size
    ]
    if _at_an_end(machine, takes, true, channel, at):
        near += [float(own) for take in takes for own in _at_speed(take, true, channel, at)]
    transient = _holds(interval, was) or any(_holds(interval, value) for value in near)
    words = (
        f"order {record['order']:.5g} {record['channel']}: {record['amplitude']:.4g} "
        f"({interval[0]:.4g}…{interval[1]:.4g}) at {at:.0f} rpm, is {was:.4g} (steady {would:.4g})"
    )
    return [
        _width(record["amplitude"], interval),
        Judgement("amplitude", float(transient or _holds(interval, would)), 1.0, words),
        Judgement("amplitude, transient", float(transient), 1.0, words),
        Judgement("amplitude, steady", float(_holds(interval, would)), 1.0, words),
    ]


def _at_an_end(machine: Machine, takes: tuple[Take, ...], true: int, channel: int, at: float) -> bool:
    """Whether an order is largest at an end of a sweep, which no frame reaches, and ``at`` is beside it."""
    if machine.steady:
        return False
    take = max(takes, key=lambda item: float(np.abs(item.envelopes[true][channel]).max()))
    size = np.abs(take.envelopes[true][channel])
    where = float(take.speed_rpm[np.argmax(size)])
    ends = machine.tested_rpm
    return any(abs(where - end) <= 0.01 * end and abs(at - end) <= END_REACH * end for end in ends)


def _at_speed(take: Take, true: int, channel: int, at: float) -> FloatArray:
    """Smallest and largest of what a recording held near the speed ``at``, and what it held there, if it ever had it.

    A row of a line that rises steeply is right where it holds what was at its own speed.
    """
    off = np.abs(take.speed_rpm - at)
    near = off <= max(3.0, 0.005 * at)
    size = np.abs(take.envelopes[true][channel])
    return np.array([size[near].min(), size[np.argmin(off)], size[near].max()]) if near.any() else size[near]


def _phase(machine: Machine, takes: tuple[Take, ...], record: dict[str, Any], true: int) -> list[Judgement]:
    order, interval = machine.orders[true], record.get("phase_deg_ci95")
    if record["phase_deg"] is None or interval is None or not machine.is_locked(order):
        return []
    channel, at = machine.channels.index(record["channel"]), float(record["speed_rpm_at_max"])
    values = [complex(machine.steady_response(true, at)[channel, 0])]
    for take in takes:
        # a sweep through zero, or with a step, passes a speed more than once
        off = np.abs(take.speed_rpm - at)
        beside = np.concatenate([[np.inf], off, [np.inf]])
        passed = (off <= beside[:-2]) & (off < beside[2:]) & (off <= max(3.0, 0.005 * at))
        own, apart = take.envelopes[true][channel], take.speed_rpm - at
        values += own[passed].tolist()
        # the rows of a take are so far apart that a phase turns by degrees from one to the next
        before = np.flatnonzero(apart[:-1] * apart[1:] < 0.0)
        share = apart[before] / (apart[before] - apart[before + 1])
        values += ((1.0 - share) * own[before] + share * own[before + 1]).tolist()
    # which of the two revolutions of a cycle comes first, no index tells
    turn = 360.0 if order.order.is_integer() else 180.0
    middle, half = 0.5 * (interval[0] + interval[1]), 0.5 * (interval[1] - interval[0])
    off = [abs((np.degrees(np.angle(value)) - middle + 0.5 * turn) % turn - 0.5 * turn) for value in values]
    words = f"order {record['order']:.5g} {record['channel']}: {min(off):.3g}° off, said ± {half:.3g}°"
    return [Judgement("phase", float(min(off) <= half), 1.0, words)]


def _modes(machine: Machine, bound: Bound, findings: dict[str, Any]) -> list[Judgement]:
    """Modes found, invented and undecided; coverage of frequency and damping."""
    damped = [record for record in findings["modes"] if record["damping_ratio"] is not None]
    pairs = _paired(machine, damped, wide=False)
    made, decidable = [], told_from_a_tone(machine, bound)
    for place, mode in enumerate(machine.modes):
        record = pairs.get(place)
        relative = float(bound.frequency_hz[place] / mode.frequency_hz)
        words = f"{mode.frequency_hz:.2f} Hz, {100 * mode.damping_ratio:.2g} % (bound {100 * relative:.2g} %)"
        if relative < KNOWN_FREQUENCY:
            made.append(Judgement("mode found", float(record is not None), 1.0, words))
        if decidable[place]:
            decided = record is not None and record["explained_by"] == "mode"
            made.append(Judgement("decided: mode", float(decided), 1.0, words))
    for record in damped:
        if record["explained_by"] == "mode":
            hz, interval = record["frequency_hz"], record["frequency_hz_ci95"]
            off = min(abs(mode.frequency_hz - hz) for mode in machine.modes)
            good = off <= max(interval[1] - hz, NEAR_MODE * hz)
            words = f"{hz:.2f} Hz, {100 * record['damping_ratio']:.2g} %: no such mode within {off:.2g} Hz"
            made.append(Judgement("mode real", float(good), 1.0, words))
    for place, record in _paired(machine, damped, wide=True).items():
        made += _pole(machine, place, record)
    return made


def _paired(machine: Machine, records: list[dict[str, Any]], *, wide: bool) -> dict[int, dict[str, Any]]:
    """One record per true mode at most, the nearest; ``wide``: within three intervals, so that misses are counted."""
    if not records:
        return {}
    true = np.array([mode.frequency_hz for mode in machine.modes])
    said = np.array([record["frequency_hz"] for record in records])
    half = np.array([record["frequency_hz_ci95"][1] - record["frequency_hz"] for record in records])
    reach = np.maximum(3.0 * half if wide else half, (2.0 if wide else 1.0) * NEAR_MODE * said)
    cost = np.minimum(np.abs(true[:, None] - said) / reach, 1e3)
    cost[cost > 1.0] = 1e3
    rows, columns = linear_sum_assignment(cost)
    return {int(r): records[c] for r, c in zip(rows, columns, strict=True) if cost[r, c] <= 1.0}


def _pole(machine: Machine, place: int, record: dict[str, Any]) -> list[Judgement]:
    mode = machine.modes[place]
    made = []
    for kind, key, truth in (
        ("frequency", "frequency_hz", mode.frequency_hz),
        ("damping", "damping_ratio", mode.damping_ratio),
    ):
        interval = record[f"{key}_ci95"]
        if interval is not None:
            made.append(_width(record[key], interval))
            words = f"{record[key]:.5g} ({interval[0]:.5g}…{interval[1]:.5g}), is {truth:.5g}"
            made.append(
                Judgement(kind, float(_holds(interval, truth)), 1.0, f"mode {mode.frequency_hz:.2f} Hz: {words}")
            )
    return made
