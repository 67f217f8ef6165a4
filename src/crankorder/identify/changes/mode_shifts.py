"""Natural frequencies and damping of two tests: which moved, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import ndtr

from crankorder.identify.changes.order_changes import like_speeds
from crankorder.identify.false_discovery import claimed
from crankorder.identify.intervals import error_of, interval
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-changes.toml", table="mode_shifts"):
    mode_reach: float
    least_reach: float


NUMBERS = _Numbers.load()


def mode_shifts(base: Mapping[str, Any], new: Mapping[str, Any], *, q: float) -> list[dict[str, Any]]:
    """Records of the natural frequencies of both tests with their shifts, by frequency; those of one test without.

    ``base`` and ``new`` are findings; modes are matched with the nearest within three damping bandwidths or 5 %. Shifts
    are claimed at a false-discovery rate of ``q``. A mode that one test alone shows is no claim: it may be hidden.
    """
    lists = [[m for m in f["modes"] if m.get("explained_by", "mode") == "mode"] for f in (base, new)]
    hz = [np.array([float(m["frequency_hz"]) for m in modes]) for modes in lists]
    widths = [np.array([_reach(m) for m in modes]) for modes in lists]
    pairs = []
    for one, two in zip(*like_speeds(hz[0], hz[1], within_rpm=np.inf), strict=True):
        if abs(hz[1][two] - hz[0][one]) <= max(widths[0][one], widths[1][two]):
            pairs.append((int(one), int(two)))
    records = [_mode_record(lists[0][one], lists[1][two]) for one, two in pairs]
    for side, modes in zip(("base", "new"), lists, strict=True):
        seen = {pair[0 if side == "base" else 1] for pair in pairs}
        records += [
            {"only_in": side, "frequency_hz": float(m["frequency_hz"]), "changed": False, "p_value": None}
            for n, m in enumerate(modes) if n not in seen
        ]  # fmt: skip
    p_values = np.array([np.nan if r["p_value"] is None else r["p_value"] for r in records], dtype=np.float64)
    for record, says in zip(records, claimed(p_values, q=q), strict=True):
        record["changed"] = bool(says)
    return sorted(records, key=lambda record: float(record["frequency_hz"]))


def _reach(mode: Mapping[str, Any]) -> float:
    frequency, ends = float(mode["frequency_hz"]), mode["frequency_hz_ci95"]
    error = error_of(frequency, ends)
    return max(
        NUMBERS.mode_reach * error,
        NUMBERS.mode_reach * frequency * float(mode["damping_ratio"]),
        NUMBERS.least_reach * frequency,
    )


def _mode_record(one: Mapping[str, Any], two: Mapping[str, Any]) -> dict[str, Any]:
    record: dict[str, Any] = {"only_in": None, "frequency_hz": float(one["frequency_hz"])}
    chances = []
    for key, name in (("frequency_hz", "shift_hz"), ("damping_ratio", "damping_change")):
        errors = [error_of(float(mode[key]), mode[f"{key}_ci95"]) for mode in (one, two)]
        error = float(np.hypot(errors[0], errors[1]))
        shift = float(two[key]) - float(one[key])
        record |= {name: shift, f"{name}_ci95": interval(shift, error)}
        chances.append(1.0 if shift == 0 else 2 * float(ndtr(-abs(shift) / error)) if error > 0 else 0.0)
    record["new_frequency_hz"] = float(two["frequency_hz"])
    return {**record, "p_value": min(1.0, 2 * min(chances)), "changed": False}
