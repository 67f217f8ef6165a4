"""What is kept of a run's results, small enough to commit, and how two such summaries differ."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crankorder.report.netcdf import read_results

SAMPLES = 50
"""Values kept of each variable, drawn by a seed that its name makes."""

SHARE_FLOAT32, SHARE_FLOAT64 = 2e-6, 1e-9
"""Share of a variable's largest value by which one of its numbers may move."""

Summary = dict[str, Any]


def summary_of_results(file: Path) -> Summary:
    """Each variable of each group of the NetCDF ``file``: its type, dims and shape, range, and samples.

    Channels are not parted by quantity, as :func:`crankorder.report.netcdf.read_results` has them.
    """
    made: Summary = {}
    for group, dataset in read_results(file).items():
        for name, variable in sorted(dataset.variables.items()):
            path = f"{group}/{name}"
            column = _column(path, np.asarray(variable.values))
            made[path] = {"dims": list(variable.dims), "shape": list(variable.shape), **column}
    return made


def summary_of_findings(findings: Any) -> Summary:
    """Each field of ``findings`` (as ``findings.json`` holds them): the values of all its records as one column."""
    columns: dict[str, list[Any]] = {}
    for path, value in _leaves(findings, ""):
        columns.setdefault(path, []).append(value)
    made: Summary = {}
    for path, values in columns.items():
        numbers = all(isinstance(value, float | int) and not isinstance(value, bool) for value in values)
        column = np.array(values, dtype=np.float64) if numbers else np.array([json.dumps(value) for value in values])
        made[path] = {"shape": [len(values)], **_column(path, column)}
    return made


def _leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping) and value:
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}".lstrip("."))
    elif isinstance(value, list) and value:
        for item in value:
            yield from _leaves(item, f"{path}[]")
    else:
        yield path, value


def _column(path: str, values: NDArray[Any]) -> Summary:
    """Range and samples of ``values``; text has samples alone."""
    flat = values.ravel()
    at = np.arange(flat.size)
    if flat.size > SAMPLES:
        at = np.sort(np.random.default_rng(zlib.crc32(path.encode())).choice(flat.size, SAMPLES, replace=False))
    if flat.dtype.kind not in "fiub":
        return {"type": "text", "samples": [str(item) for item in flat[at]]}
    numbers = flat.astype(np.float64)
    finite = numbers[np.isfinite(numbers)]
    made: Summary = {"type": str(flat.dtype), "missing": int(numbers.size - finite.size)}
    if finite.size:
        made |= {"min": finite.min(), "max": finite.max(), "rms": float(np.sqrt(np.mean(finite**2)))}
    digits = 9 if flat.dtype == np.float32 else 17
    return {
        key: _rounded(item, digits) if isinstance(item, float) else item
        for key, item in {**made, "samples": [_rounded(item, digits) for item in numbers[at].tolist()]}.items()
    }


def _rounded(value: float, digits: int) -> float | None:
    """``value`` with as many ``digits`` as its type holds; None where it is missing."""
    return float(f"{value:.{digits}g}") if np.isfinite(value) else None


def differences(before: Summary, after: Summary) -> list[str]:
    """What of the summary ``after`` is not as it was ``before``, a line for each variable, text or list."""
    lines = [
        f"{part}: {'gone' if name in before[part] else 'new'}: {name}"
        for part in ("results", "findings")
        for name in sorted(set(before.get(part, {})) ^ set(after.get(part, {})))
    ]
    for part in ("results", "findings"):
        for name in sorted(set(before.get(part, {})) & set(after.get(part, {}))):
            moved = _moved(before[part][name], after[part][name])
            lines += [f"{part}: {name}: {moved}"] if moved else []
    for part in ("stages", "text"):
        if before.get(part) != after.get(part):
            first = [item for item in before.get(part, []) if item not in after.get(part, [])]
            then = [item for item in after.get(part, []) if item not in before.get(part, [])]
            lines.append(f"{part}: was {first}, is {then}")
    return lines


def _moved(before: Summary, after: Summary) -> str:
    """How a variable moved; nothing where it did not."""
    for key in ("type", "dims", "shape", "missing"):
        if before.get(key) != after.get(key):
            return f"{key} {before.get(key)} -> {after.get(key)}"
    if before["type"] == "text":
        changed = [(a, b) for a, b in zip(before["samples"], after["samples"], strict=True) if a != b]
        return f"{len(changed)} of {len(before['samples'])} texts, first {changed[0]}" if changed else ""
    if before["type"].startswith(("int", "uint", "bool")):
        share = 0.0
    else:
        share = SHARE_FLOAT32 if before["type"] == "float32" else SHARE_FLOAT64
    largest = max(abs(before.get("min", 0.0)), abs(before.get("max", 0.0)))
    pairs = [(before.get(key, 0.0), after.get(key, 0.0)) for key in ("min", "max", "rms")]
    pairs += list(zip(before["samples"], after["samples"], strict=True))
    if any((a is None) != (b is None) for a, b in pairs):
        return "other values are missing"
    worst = max((abs(a - b) for a, b in pairs if a is not None), default=0.0)
    return (
        f"by {worst:.3g} of {largest:.3g} ({worst / largest if largest else np.inf:.2g})"
        if worst > share * largest
        else ""
    )
