"""What is kept of a run, small enough to commit, and how two such summaries differ."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from crankorder.report.netcdf import read_results
from made.command import done

RECORDS, SAMPLES = 40, 20
"""Records kept of each list of the findings, and values of each variable of the results: spread over all of them."""

SHARE_OF_INTERVAL, SHARE_OF_LARGEST = 0.1, 1e-3
"""By which a value may move: of its own 95 % interval, or where it has none of the largest value beside it."""

WORDS = {"channel", "channels", "lock", "explained_by", "line", "seen_in", "predicted_from", "speed_law", "flag"}
WORDS |= {"severity", "left_out", "crossings[].verdict", "limits[].verdict"}
"""Fields whose text is a verdict or a name; all other text is left out."""

Summary = dict[str, list[Any]]
"""Columns by the path of their field: words, numbers, and numbers with their interval as [value, low, high]."""


def summary_of(scene: str, folder: Path) -> Summary:
    """Findings and results of the short version of a shipped scene, run as a user runs it.

    Parameters
    ----------
    scene
        Name of the scene.
    folder
        An empty folder to work in.
    """
    done("synth", scene, "--quick", "--out", folder / scene, "-q")
    tests = sorted((folder / scene).glob("run_*")) or [folder / scene]
    done("run", *tests, "--out", folder / "out")
    last = sorted((folder / "out").glob("*/results.nc"))[-1].parent
    columns: Summary = {}
    _add(columns, json.loads((last / "findings.json").read_bytes()), "")
    for group, dataset in read_results(last / "results.nc").items():
        if not group.startswith("findings"):
            for name, variable in dataset.variables.items():
                if variable.dtype.kind in "fiub":
                    error = dataset.get("standard_error") if name == "amplitude" else None
                    columns[f"{group}/{name} {list(variable.shape)}"] = _samples(variable.values, error)
    return columns


def _add(columns: Summary, value: Any, path: str) -> None:
    """Add what a part of the findings holds to the ``columns``."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            ends = value.get(f"{key}_ci95")
            if isinstance(inner, int | float) and ends is not None:
                columns.setdefault(f"{path}.{key}", []).append([_rounded(inner), *map(_rounded, ends)])
            elif not key.endswith("_ci95"):
                _add(columns, inner, f"{path}.{key}".lstrip("."))
    elif isinstance(value, list):
        for inner in value[:: math.ceil(len(value) / RECORDS) or 1]:
            _add(columns, inner, f"{path}[]")
    elif not isinstance(value, str) or {path, path.removesuffix("[]").rpartition(".")[2]} & WORDS:
        columns.setdefault(path, []).append(_rounded(value))


def _samples(values: np.ndarray, error: Any) -> list[Any]:
    at = np.unique(np.linspace(0, values.size - 1, SAMPLES).astype(int)) if values.size else []
    flat = values.ravel()[at].astype(np.float64)
    if error is None or error.shape != values.shape:
        return [_rounded(value) for value in flat]
    half = 1.96 * error.values.ravel()[at]
    return [[_rounded(value + side * width) for side in (0, -1, 1)] for value, width in zip(flat, half, strict=True)]


def _rounded(value: Any) -> Any:
    """A number to nine digits, None where it is not finite; anything else as it is."""
    if isinstance(value, bool | str) or value is None:
        return value
    return float(f"{value:.9g}") if math.isfinite(value) else None


def differences(before: Summary, after: Summary) -> list[str]:
    """What of ``after`` is not as it was ``before``, a line for each field: its first value that moved.

    Parameters
    ----------
    before, after
        Two summaries of one scene.
    """
    lines = [f"{path}: {'gone' if path in before else 'new'}" for path in sorted(set(before) ^ set(after))]
    for path in sorted(set(before) & set(after)):
        old, new = before[path], after[path]
        numbers = [abs(number) for entry in old for number in _numbers(entry)]
        largest = max(numbers, default=0.0)
        if len(old) != len(new):
            lines.append(f"{path}: {len(new)} values, there were {len(old)}")
        elif moved := [(a, b) for a, b in zip(old, new, strict=True) if not _alike(a, b, largest)]:
            lines.append(f"{path}: {len(moved)} of {len(old)} moved, first {moved[0][0]} -> {moved[0][1]}")
    return lines


def _numbers(entry: Any) -> list[float]:
    parts = entry if isinstance(entry, list) else [entry]
    return [part for part in parts if isinstance(part, float | int) and not isinstance(part, bool)]


def _alike(old: Any, new: Any, largest: float) -> bool:
    """Whether an entry is what it was, within its tolerance."""
    numbers, others = _numbers(old), _numbers(new)
    if type(old) is not type(new) or len(numbers) != len(others) or not numbers:
        return bool(old == new)
    tolerance = SHARE_OF_LARGEST * largest
    if len(numbers) == 3:
        tolerance = max(SHARE_OF_INTERVAL * (numbers[2] - numbers[1]), 1e-8 * largest)
    return max(abs(a - b) for a, b in zip(numbers, others, strict=True)) <= tolerance
