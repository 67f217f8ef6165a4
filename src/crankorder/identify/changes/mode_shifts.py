"""Natural frequencies and damping of two tests: which moved, and by how much."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ndtr

from crankorder.findings import Findings, ModeFinding
from crankorder.identify.changes.order_changes import like_speeds
from crankorder.identify.false_discovery import claimed
from crankorder.identify.intervals import error_of, interval
from crankorder.records import known
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-changes.toml", table="mode_shifts"):
    mode_reach: float
    least_reach: float


NUMBERS = _Numbers.load()


def mode_shifts(base: Findings, new: Findings, *, q: float) -> list[dict[str, Any]]:
    """Records of the natural frequencies of both tests with their shifts, by frequency; those of one test without.

    ``base`` and ``new`` are findings; modes are matched with the nearest within three damping bandwidths or 5 %. Shifts
    are claimed at a false-discovery rate of ``q``. A mode that one test alone shows is no claim: it may be hidden.
    """
    lists = [[m for m in f.modes if m.explained_by == "mode"] for f in (base, new)]
    hz = [np.array([m.frequency_hz for m in modes]) for modes in lists]
    widths = [np.array([_reach(m) for m in modes]) for modes in lists]
    pairs = []
    for one, two in zip(*like_speeds(hz[0], hz[1], within_rpm=np.inf), strict=True):
        if abs(hz[1][two] - hz[0][one]) <= max(widths[0][one], widths[1][two]):
            pairs.append((int(one), int(two)))
    records = [_mode_record(lists[0][one], lists[1][two]) for one, two in pairs]
    for side, modes in zip(("base", "new"), lists, strict=True):
        seen = {pair[0 if side == "base" else 1] for pair in pairs}
        records += [
            {"only_in": side, "frequency_hz": m.frequency_hz, "changed": False, "p_value": None}
            for n, m in enumerate(modes) if n not in seen
        ]  # fmt: skip
    p_values = np.array([np.nan if r["p_value"] is None else r["p_value"] for r in records], dtype=np.float64)
    for record, says in zip(records, claimed(p_values, q=q), strict=True):
        record["changed"] = bool(says)
    return sorted(records, key=lambda record: float(record["frequency_hz"]))


def _error_of(mode: ModeFinding, key: str) -> float:
    """Standard error of the estimate ``key`` of a ``mode``; infinite where its interval is not known."""
    ends = known(getattr(mode, f"{key}_ci95"))
    return np.inf if ends is None else error_of(getattr(mode, key) or 0.0, ends)


def _reach(mode: ModeFinding) -> float:
    frequency, damping = mode.frequency_hz, mode.damping_ratio or 0.0
    error = _error_of(mode, "frequency_hz")
    reach = NUMBERS.mode_reach
    return max(reach * error, reach * frequency * damping, NUMBERS.least_reach * frequency)


def _mode_record(one: ModeFinding, two: ModeFinding) -> dict[str, Any]:
    record: dict[str, Any] = {"only_in": None, "frequency_hz": one.frequency_hz}
    chances = []
    for key, name in (("frequency_hz", "shift_hz"), ("damping_ratio", "damping_change")):
        errors = [_error_of(mode, key) for mode in (one, two)]
        error = float(np.hypot(errors[0], errors[1]))
        shift = float(getattr(two, key) or 0.0) - float(getattr(one, key) or 0.0)
        record |= {name: shift, f"{name}_ci95": interval(shift, error)}
        chances.append(1.0 if shift == 0 else 2 * float(ndtr(-abs(shift) / error)) if error > 0 else 0.0)
    record["new_frequency_hz"] = two.frequency_hz
    return {**record, "p_value": min(1.0, 2 * min(chances)), "changed": False}
