"""MATLAB files of version 5 to 7.2: numbers of variables, struct fields and cells; nothing else is ever interpreted.

Read by this program itself: a crafted file ends the process that opens it with SciPy 1.18 (../shared/faults.md, A14).
Version 7.3 is HDF5. Format: The MathWorks, "MAT-File Format" (R2019b), chapter 1.
"""

from __future__ import annotations

import math
import mmap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crankorder.errors import InputError, UnsafeInputError, printable
from crankorder.ingest.matlab_elements import Buffer, DamagedFileError, Element, Matrix, elements, expanded, matrix_of
from crankorder.ingest.rawfile import Contents, FloatArray, RawFile, Source, check_budget, flag, named, rows_for
from crankorder.quantities import QualityFlag
from crankorder.scratch import blocks
from crankorder.settings import IngestSettings

_HEADER_BYTES = 128
_MAX_DEPTH = 32
_HEAD_BYTES = 4096
_MOST_COLUMNS = 1000
# last part of a name, in small letters and without anything but letters
_RATE_NAMES = frozenset(("sr", "fs", "sampfreq", "samplefreq", "samplerate", "samplingrate", "samplingfrequency"))
_STEP_NAMES = frozenset(("dt", "deltat", "timestep", "xinc", "samplingperiod", "sampleperiod"))
_RATE_ENDINGS = ("samplerate", "samplingrate", "samplingfrequency", "ratehz")


@dataclass(frozen=True, slots=True)
class _Column:
    leaf: Matrix
    index: int | None  # of the shorter axis of a 2-D array
    n_samples: int


@dataclass(frozen=True, slots=True)
class _Tree:
    """Columns by name, numbers by name, names that were written twice, and kinds of variables that hold no numbers."""

    columns: dict[str, _Column]
    scalars: dict[str, float]
    twice: tuple[str, ...]
    others: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.columns, *self.scalars)


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Columns that ``sources`` ask for from the MATLAB file at ``path``: ``"x"``, ``"bearing.gs"``, ``"data[0]"``.

    A source is such a name, a pattern that fits one, or a position in the file, single numbers last; ``settings`` give
    the byte and object limits. Raises InputError for damage or a missing name, UnsafeInputError for impossible sizes.
    """
    with _opened(path) as data:
        tree = _tree(data, path, settings)
        names = [_named(source, tree, path) for source in sources]
        wanted = [tree.columns[name] for name in names if name in tree.columns]
        leaves = {id(column.leaf): column.leaf for column in wanted}
        check_budget(sum(leaf.n_values * 8 for leaf in leaves.values()), path, max_bytes=settings.max_bytes)
        kinds = [(column.n_samples, _target(column.leaf)) for column in wanted]
        rows = rows_for(kinds, in_memory_bytes=settings.in_memory_bytes)
        for leaf in leaves.values():
            mine = [(column, row) for column, row in zip(wanted, rows, strict=True) if column.leaf is leaf]
            _fill(mine, leaf, path, settings)
    room = iter(rows)
    columns = {
        source: next(room) if name in tree.columns else np.array([tree.scalars[name]])
        for source, name in zip(sources, names, strict=True)
    }
    rates = {rate for name in names if name in tree.columns and (rate := _rate_hz(tree, name)) is not None}
    return RawFile(columns=columns, rate_hz=rates.pop() if len(rates) == 1 else None, flags=_flags(tree, path))


def contents(path: Path, *, settings: IngestSettings) -> Contents:
    """Names and lengths of the numeric columns of the MATLAB file at ``path``, single numbers last, and their rates.

    ``settings`` give the byte and object limits. Raises what :func:`read` raises.
    """
    with _opened(path) as data:
        tree = _tree(data, path, settings)
    rates = {name: rate for name in tree.columns if (rate := _rate_hz(tree, name)) is not None}
    samples = {name: column.n_samples for name, column in tree.columns.items()}
    return Contents("MATLAB", tree.names, samples | dict.fromkeys(tree.scalars, 1), rates_hz=rates)


@contextmanager
def _opened(path: Path) -> Iterator[Buffer]:
    """Bytes of the file at ``path``, mapped; what its damage raises inside is told as InputError."""
    with path.open("rb") as stream:
        if path.stat().st_size < _HEADER_BYTES + 8:
            raise InputError("truncated: a MATLAB file without any variable", file=path, remedy="Copy it again")
        data = np.frombuffer(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ), np.uint8)
    try:
        yield data  # unmapped when the last view of it is gone
    except DamagedFileError as error:
        raise InputError(
            f"damaged or truncated: {error}", file=path, place=error.place, remedy="Copy the file again"
        ) from None


def _tree(data: Buffer, path: Path, settings: IngestSettings) -> _Tree:
    """All numeric arrays of the file: its variables and what lies in structs and cells, bounded in depth and number."""
    mark = data[126:128].tobytes()
    if mark not in (b"IM", b"MI"):
        raise DamagedFileError("the header does not say in which order bytes stand")
    order, walk = ("<" if mark == b"IM" else ">"), _Walk(path, settings)
    for element in elements(data, _HEADER_BYTES, len(data), order):
        walk.variable(element)
    if not walk.leaves:
        found = ", ".join(sorted(set(walk.others)))
        remedy = "Save numbers as plain arrays: tables, time series and text are not read" if found else "Copy it again"
        raise InputError("holds no array of numbers", file=path, found=found, remedy=remedy)
    columns: dict[str, _Column] = {}
    scalars: dict[str, float] = {}
    for name, leaf in walk.leaves.items():
        if leaf.n_values == 1:
            scalars[name] = float(_values(leaf, path, settings)[0])
        else:
            columns |= _columns(name, leaf)
    return _Tree(columns, scalars, tuple(dict.fromkeys(walk.twice)), tuple(walk.others))


class _Walk:
    """Visits variables and what lies in them, and keeps the arrays of real numbers by name."""

    def __init__(self, path: Path, settings: IngestSettings) -> None:
        self._path, self._settings, self._n = path, settings, 0
        self.leaves: dict[str, Matrix] = {}
        self.twice: list[str] = []
        self.others: list[str] = []

    def variable(self, element: Element) -> None:
        """Visit one variable; a compressed one is opened as far as its header only, where that is enough."""
        self._count("")
        if element.compressed:
            limits: dict[str, Any] = {"path": self._path, "settings": self._settings}
            head = expanded(element, most=_HEAD_BYTES, **limits)
            matrix = matrix_of(head, partial=True)
            if matrix is not None and not matrix.is_number:
                matrix = matrix_of(expanded(element, most=None, **limits))
            elif matrix is not None:
                matrix.packed = element
                if matrix.n_values > head.n_bytes:
                    raise DamagedFileError(f"{head.n_bytes} bytes for {matrix.n_values} values", place=matrix.name)
        else:
            matrix = matrix_of(element)
        if matrix is not None and matrix.name:  # what has no name is MATLAB's own store of objects
            if matrix.name in self.leaves:
                self.twice.append(matrix.name)
            self._visit(matrix, printable(matrix.name, 200), 0)

    def _visit(self, matrix: Matrix, name: str, depth: int) -> None:
        self._count(name)
        if depth > _MAX_DEPTH:
            raise UnsafeInputError(
                f"structs and cells are nested deeper than {_MAX_DEPTH}", file=self._path, place=name
            )
        if matrix.is_number:
            if matrix.packed is None:
                matrix.values()  # says so where they are not as many as the shape promises
            if matrix.n_values:
                self.leaves[name] = matrix
        elif matrix.is_container:
            for part, inner in matrix.parts():
                self._visit(inner, f"{name}{part}", depth + 1)
        else:
            self.others.append(matrix.kind)

    def _count(self, name: str) -> None:
        self._n += 1
        if self._n > self._settings.max_objects:
            limit = f"holds more than {self._settings.max_objects} objects"
            raise UnsafeInputError(limit, file=self._path, place=name)


def _columns(name: str, leaf: Matrix) -> dict[str, _Column]:
    """A vector as one column, a matrix as one for each row or column along its longer side; none of more dimensions."""
    sides = sorted(side for side in leaf.shape if side != 1)
    if len(sides) == 1:
        return {name: _Column(leaf, None, sides[0])}
    if len(sides) != 2 or sides[0] > _MOST_COLUMNS:
        return {}
    return {f"{name}[{index}]": _Column(leaf, index, sides[1]) for index in range(sides[0])}


def _named(source: Source, tree: _Tree, path: Path) -> str:
    return named(source, tree.names, path)


def _target(leaf: Matrix) -> type[np.float32] | type[np.float64]:
    return np.float32 if leaf.kind in ("single", "int8", "uint8", "int16", "uint16") else np.float64


def _values(leaf: Matrix, path: Path, settings: IngestSettings) -> npt.NDArray[Any]:
    """The stored values of ``leaf`` (column by column), of whatever type they are stored in."""
    if leaf.packed is None:
        return leaf.values()
    whole = matrix_of(expanded(leaf.packed, most=None, path=path, settings=settings))
    if whole is None:
        raise DamagedFileError("a compressed variable holds no array", place=leaf.name)
    return whole.values()


def _fill(mine: list[tuple[_Column, FloatArray]], leaf: Matrix, path: Path, settings: IngestSettings) -> None:
    values = _values(leaf, path, settings)
    sides = [side for side in leaf.shape if side != 1]
    for column, row in mine:
        if column.index is None:
            taken = values
        elif sides[0] == column.n_samples:  # samples run down the columns, which follow each other
            taken = values[column.index * column.n_samples : (column.index + 1) * column.n_samples]
        else:
            taken = values[column.index :: sides[0]]
        for part in blocks(row.size):
            row[part] = taken[part]


def _rate_hz(tree: _Tree, name: str) -> float | None:
    """Samples per second that single numbers beside the column ``name`` state: in its own struct, else anywhere.

    None where they contradict each other.
    """
    stated = {key: rate for key, value in tree.scalars.items() if (rate := _stated(key, value)) is not None}
    group = name.rpartition(".")[0]
    for rates in ([rate for key, rate in stated.items() if key.rpartition(".")[0] == group], list(stated.values())):
        if rates:
            return rates[0] if max(rates) - min(rates) <= 1e-6 * rates[0] else None
    return None


def _stated(key: str, value: float) -> float | None:
    """Rate in Hz that the number ``key`` states."""
    if not (value > 0.0 and math.isfinite(value)):
        return None
    word = "".join(letter for letter in key.rpartition(".")[2].casefold() if letter.isalpha())
    if word in _RATE_NAMES or word.endswith(_RATE_ENDINGS):
        return value
    return 1.0 / value if word in _STEP_NAMES else None


def _flags(tree: _Tree, path: Path) -> list[QualityFlag]:
    detail = "written twice, the last is read: " + ", ".join(tree.twice)
    return [flag(path, "variable_written_twice", "info", detail)] if tree.twice else []
