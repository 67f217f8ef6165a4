"""MATLAB files of version 5 to 7.2, read by SciPy in a process of its own: numbers of variables, struct fields, cells.

A crafted file can end the process that opens it (../shared/faults.md, A14). Version 7.3 is HDF5.
"""

from __future__ import annotations

import math
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.io import loadmat, whosmat
from scipy.io.matlab import MatlabFunction, MatlabOpaque

from crankorder.errors import InputError, UnsafeInputError, printable
from crankorder.ingest.child import in_child
from crankorder.ingest.rawfile import (
    Contents,
    FloatArray,
    RawFile,
    Source,
    check_budget,
    flag,
    float_type_for,
    names_of,
)
from crankorder.settings import IngestSettings

Array = npt.NDArray[Any]

_CONTAINERS = ("cell", "struct", "object")
_MAX_DEPTH = 32
_MOST_COLUMNS = 1000
_MOST_PARTS = 20_000
"""Arrays in one cell or struct: each costs far more memory than its bytes in the file."""
_MOST_PER_BYTE = 10
"""Bytes of samples that a byte of the file may become: of recorded signals no more is saved by compression."""

# last part of a name, in small letters and without anything but letters
_RATE_NAMES = frozenset(("sr", "fs", "sampfreq", "samplefreq", "samplerate", "samplingrate", "samplingfrequency"))
_STEP_NAMES = frozenset(("dt", "deltat", "timestep", "xinc", "samplingperiod", "sampleperiod"))
_START_NAMES = frozenset(("t0", "x0", "starts", "starttime", "starttimes", "startoffset", "startoffsets"))
_RATE_ENDINGS = ("samplerate", "samplingrate", "samplingfrequency", "ratehz")


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Columns that ``sources`` ask for from the MATLAB file at ``path``: ``"x"``, ``"bearing.gs"``, ``"data[0]"``.

    A source is such a name, a pattern that fits one, or a position in the file, single numbers last; ``settings`` give
    the byte and object limits. Raises InputError for damage or a missing name, UnsafeInputError for impossible sizes.
    """

    def parse() -> tuple[Contents, dict[str, FloatArray], list[str]]:
        variables, twice = _variables(path, settings)
        arrays, others = _numeric(variables, settings)
        if not arrays:
            found = ", ".join(sorted(others))
            remedy = "Save numbers as plain arrays: tables, time series and text are not read"
            raise InputError("holds no array of numbers", found=found, remedy=remedy if found else "Copy it again")
        columns = dict(chain.from_iterable(_columns(name, values).items() for name, values in arrays.items()))
        scalars = {name: float(values.item()) for name, values in arrays.items() if values.size == 1}
        names = names_of(sources, (*columns, *scalars), path).values()
        wanted = {name: columns[name] if name in columns else np.array([scalars[name]]) for name in names}
        floats = {name: values.astype(float_type_for(values.dtype)) for name, values in wanted.items()}
        return _contents(columns, scalars), floats, twice

    n_bytes = min(settings.max_bytes, _MOST_PER_BYTE * path.stat().st_size)
    contents, columns, twice = in_child(parse, path, n_bytes=n_bytes)
    names = names_of(sources, contents.names, path)
    detail = "written twice, the last is read: " + ", ".join(twice)
    flags = [flag(path, "variable_written_twice", "info", detail)] if twice else []
    return contents.with_columns(names, [columns[name] for name in names.values()], flags=flags)


def _variables(path: Path, settings: IngestSettings) -> tuple[dict[str, Any], list[str]]:
    """Variables of the file by name, as SciPy reads them, and the names of those that it holds twice.

    The sizes that the file claims are checked before anything is read.
    """
    check_budget(path.stat().st_size, settings)
    warnings.simplefilter("ignore")  # of a process that ends with this file; a variable written twice is told by a flag
    listed = whosmat(path, appendmat=False)
    if len(listed) > settings.max_objects:
        raise UnsafeInputError(f"holds more than {settings.max_objects} objects")
    for name, shape, kind in listed:
        if min(shape, default=0) < 0:
            raise InputError("damaged: a variable without a shape", place=printable(name, 200))
        if kind in _CONTAINERS and math.prod(shape) > _MOST_PARTS:
            problem = f"a variable holds more than {_MOST_PARTS} arrays"
            raise UnsafeInputError(problem, remedy="Save the signals as variables of their own")
    check_budget(sum(8 * math.prod(shape) for _, shape, kind in listed if kind not in _CONTAINERS), settings)
    variables = loadmat(path, appendmat=False, chars_as_strings=False)
    twice = [name for name, count in Counter(name for name, _, _ in listed).items() if count > 1]
    return {name: value for name, value in variables.items() if not name.startswith("__")}, twice


def _numeric(variables: Mapping[str, Any], settings: IngestSettings) -> tuple[dict[str, Array], set[str]]:
    """Arrays of real numbers in ``variables`` and what lies in them, by name, and the kinds of all others."""
    arrays: dict[str, Array] = {}
    others: set[str] = set()
    pending = [(printable(name, 200), value, 0) for name, value in reversed(list(variables.items()))]
    n_objects = 0
    while pending:
        name, value, depth = pending.pop()
        n_objects += 1
        if n_objects > settings.max_objects:
            raise UnsafeInputError(f"holds more than {settings.max_objects} objects", place=name)
        if depth > _MAX_DEPTH:
            raise UnsafeInputError(f"structs and cells are nested deeper than {_MAX_DEPTH}", place=name)
        kind = _kind(value)
        if kind == "numbers" and value.size:
            arrays[name] = value
        elif kind == "parts":
            pending += reversed([(f"{name}{part}", inner, depth + 1) for part, inner in _parts(value)])
        elif kind != "numbers":
            others.add(kind)
    return arrays, others


def _kind(value: Any) -> str:
    """What ``value`` of SciPy's is: "numbers", "parts" of a struct or cell, or MATLAB's word for what is not read."""
    if not isinstance(value, np.ndarray):
        return "sparse"
    if isinstance(value, (MatlabFunction, MatlabOpaque)):
        return "function" if isinstance(value, MatlabFunction) else "opaque object"
    if value.dtype.names or value.dtype.kind == "O":
        return "parts"
    return {"U": "char", "c": "complex numbers"}.get(value.dtype.kind, "numbers")


def _parts(value: Array) -> Iterator[tuple[str, Any]]:
    """What a struct or cell holds: the end of its name, such as ``".gs"`` or ``"{0}"``, and the array."""
    for which, part in enumerate(value.ravel(order="F")):
        if not value.dtype.names:
            yield f"{{{which}}}", part
        for field in value.dtype.names or ():
            yield ("" if value.size == 1 else f"{{{which}}}") + f".{field}", part[field]


def _columns(name: str, values: Array) -> dict[str, Array]:
    """A vector as one column, a matrix as one for each row or column along its longer side; none of more dimensions."""
    table = values.squeeze()
    if table.ndim == 1:
        return {name: table}
    if table.ndim != 2 or min(table.shape) > _MOST_COLUMNS:
        return {}
    rows = table if table.shape[0] <= table.shape[1] else table.T
    return {f"{name}[{index}]": row for index, row in enumerate(rows)}


def _contents(columns: Mapping[str, Array], scalars: Mapping[str, float]) -> Contents:
    samples = {name: values.size for name, values in columns.items()} | dict.fromkeys(scalars, 1)
    rates = {name: rate for name in columns if (rate := _rate_hz(scalars, name)) is not None}
    starts = {
        key.rpartition(".")[0]: value
        for key, value in scalars.items()
        if "." in key and _word(key) in _START_NAMES and math.isfinite(value)
    }
    starts_s = {name: starts[group] for name in columns if (group := name.rpartition(".")[0]) in starts}
    return Contents("MATLAB", (*columns, *scalars), samples, rates_hz=rates, starts_s=starts_s)


def _word(key: str) -> str:
    """The last part of ``key`` in small letters, without what joins words."""
    return re.sub(r"[\W_]+", "", key.rpartition(".")[2].casefold())


def _rate_hz(scalars: Mapping[str, float], name: str) -> float | None:
    """Samples per second that single numbers beside the column ``name`` state: in its own struct, else anywhere.

    None where they contradict each other.
    """
    stated = {key: rate for key, value in scalars.items() if (rate := _stated_hz(key, value)) is not None}
    group = name.rpartition(".")[0]
    rates = [rate for key, rate in stated.items() if key.rpartition(".")[0] == group] or list(stated.values())
    return rates[0] if rates and max(rates) - min(rates) <= 1e-6 * rates[0] else None


def _stated_hz(key: str, value: float) -> float | None:
    """Rate in Hz that the number ``key`` states, None where it is something else."""
    if not (value > 0.0 and math.isfinite(value)):
        return None
    word = _word(key)
    if word in _RATE_NAMES or word.endswith(_RATE_ENDINGS):
        return value
    return 1.0 / value if word in _STEP_NAMES else None
