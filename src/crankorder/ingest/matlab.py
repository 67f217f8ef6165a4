"""MATLAB files of version 5 to 7.2: numbers of variables, struct fields and cells; nothing else is ever interpreted.

Read by this program itself: a crafted file ends the process that opens it with SciPy 1.18 (../shared/faults.md, A14).
Version 7.3 is HDF5. Format: The MathWorks, "MAT-File Format" (R2019b), chapter 1.
"""

from __future__ import annotations

import math
import mmap
import re
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crankorder.errors import InputError, UnsafeInputError, printable
from crankorder.ingest.rawfile import Contents, FloatArray, RawFile, Source, check_budget, flag, names_of, rows_for
from crankorder.scratch import blocks, empty
from crankorder.settings import IngestSettings

Buffer = npt.NDArray[np.uint8]

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT = 1, 2, 3
_KINDS = {1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 16: "function", 17: "opaque object"} | dict(
    enumerate(("double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"), start=6)
)
_COMPLEX = 0x0800
_PIECE = 1 << 18
_MOST_DEFLATED = 1100
"""Deflate makes at most 1032 bytes of one."""

_HEADER_BYTES = 128

_MAX_DEPTH = 32

_HEAD_BYTES = 4096

_MOST_COLUMNS = 1000

_MOST_PARTS = 20_000
"""Elements of one variable: each costs far more memory than its bytes in the file."""

# last part of a name, in small letters and without anything but letters
_RATE_NAMES = frozenset(("sr", "fs", "sampfreq", "samplefreq", "samplerate", "samplingrate", "samplingfrequency"))

_STEP_NAMES = frozenset(("dt", "deltat", "timestep", "xinc", "samplingperiod", "sampleperiod"))

_START_NAMES = frozenset(("t0", "x0", "starts", "starttime", "starttimes", "startoffset", "startoffsets"))

_RATE_ENDINGS = ("samplerate", "samplingrate", "samplingfrequency", "ratehz")


class DamagedFileError(Exception):
    """The bytes are no MATLAB data; ``place`` names the variable, where that is known."""

    def __init__(self, problem: str, *, place: str = "") -> None:
        self.place = place
        super().__init__(problem)


class TooManyPartsError(Exception):
    """A variable holds more arrays than any recording has."""


@dataclass(frozen=True, slots=True)
class Element:
    """One data element: its type, its bytes without the tag, and their order (``"<"`` or ``">"``).

    ``n_bytes`` is how many bytes its tag claims, of which the beginning of one holds fewer.
    """

    code: int
    body: Buffer
    order: str
    n_bytes: int

    @property
    def compressed(self) -> bool:
        """Whether the bytes are another element, deflated."""
        return self.code == _COMPRESSED

    def numbers(self) -> npt.NDArray[Any]:
        """The bytes as numbers of the element's type.

        Raises DamagedFileError where they are none.
        """
        kind = _TYPES.get(self.code)
        if kind is None or len(self.body) % int(kind[1]):
            raise DamagedFileError("numbers of no known type")
        return self.body.view(f"{self.order}{kind}")


def elements(data: Buffer, start: int, end: int, order: str, *, partial: bool = False) -> Iterator[Element]:
    """The data elements of ``data`` from byte ``start`` to before ``end``, one after the other, bytes in ``order``.

    The last may be cut short where ``partial``. Raises DamagedFileError where one reaches beyond the end.
    """
    while end - start >= 8:
        first, n_bytes = (int(word) for word in data[start : start + 8].view(f"{order}u4"))
        if first >> 16:  # small: type and length share a word, four bytes of data follow
            code, n_bytes, begin, step = first & 0xFFFF, first >> 16, start + 4, 8
            if n_bytes > 4:
                raise DamagedFileError("a small element claims more than four bytes")
        else:
            code, begin = first, start + 8
            step = 8 + (n_bytes if code == _COMPRESSED else -(-n_bytes // 8) * 8)
        if begin + n_bytes > end and not partial:
            raise DamagedFileError(f"{end - begin} of {n_bytes} bytes are left of an element")
        yield Element(code, data[begin : min(begin + n_bytes, end)], order, n_bytes)
        start += step
    if start < end and not partial and data[start:end].any():
        raise DamagedFileError(f"{end - start} bytes are left of an element")


def expanded(element: Element, *, most: int | None, settings: IngestSettings) -> Element:
    """The element that the compressed ``element`` holds; only its first ``most`` bytes where that is a number.

    Its size is checked against ``settings`` before room is made.
    Raises DamagedFileError where the data do not inflate to what they claim, UnsafeInputError for too large a claim.
    """
    inflate = zlib.decompressobj()
    packed, position = element.body, 0

    def more(limit: int) -> bytes:
        nonlocal position
        made = b""
        while not made and not inflate.eof:
            piece = inflate.unconsumed_tail
            if not piece:
                piece = packed[position : position + _PIECE].tobytes()
                position += len(piece)
                if not piece:
                    break
            made = inflate.decompress(piece, limit)
        return made

    try:
        tag = b""
        while len(tag) < 8 and (made := more(8 - len(tag))):
            tag += made
        if len(tag) < 8:
            raise DamagedFileError("a compressed variable is cut short")
        code, n_bytes = (int(word) for word in np.frombuffer(tag, f"{element.order}u4"))
        check_budget(n_bytes, settings)
        if n_bytes > _MOST_DEFLATED * len(packed):
            raise DamagedFileError(f"a compressed variable of {len(packed)} bytes cannot hold the {n_bytes} it claims")
        wanted = n_bytes if most is None else min(n_bytes, most)
        body = empty((wanted,), np.uint8, on_disk=wanted > settings.in_memory_bytes)
        filled = 0
        while filled < wanted and (made := more(min(_PIECE, wanted - filled))):
            body[filled : filled + len(made)] = np.frombuffer(made, np.uint8)
            filled += len(made)
        if filled < wanted or (most is None and (more(1) or not inflate.eof)):
            raise DamagedFileError(f"a compressed variable does not hold the {n_bytes} bytes that it claims")
    except zlib.error:
        raise DamagedFileError("the checksum or the compression of a variable is wrong") from None
    return Element(code, body, element.order, n_bytes)


@dataclass(slots=True)
class Matrix:
    """One array of the file: its name, MATLAB class, shape, and the elements that hold what is in it.

    ``packed`` is the compressed element that has its values, where ``element`` is only the beginning of it.
    """

    name: str
    code: int
    shape: tuple[int, ...]
    is_complex: bool
    inner: list[Element]
    order: str
    packed: Element | None = None

    @property
    def kind(self) -> str:
        """MATLAB's name of the class."""
        return ("complex " if self.is_complex else "") + _KINDS.get(self.code, f"class {self.code}")

    @property
    def is_number(self) -> bool:
        """Whether it holds real numbers, in full."""
        return 6 <= self.code <= 15 and not self.is_complex

    @property
    def is_container(self) -> bool:
        """Whether it holds other arrays."""
        return self.code in (_CELL, _STRUCT, _OBJECT)

    @property
    def n_values(self) -> int:
        """How many values the shape promises."""
        return math.prod(self.shape)

    def values(self) -> npt.NDArray[Any]:
        """The values in the order of the file, in the type in which they are stored.

        Raises DamagedFileError where they are not as many as the shape promises.
        """
        numbers = self.inner[0].numbers() if self.inner else np.empty(0)
        if len(numbers) != self.n_values:
            raise DamagedFileError(f"{len(numbers)} of {self.n_values} values are there", place=self.name)
        return numbers

    def parts(self) -> Iterator[tuple[str, Matrix]]:
        """What a struct or cell holds: the end of its name, such as ``".gs"`` or ``"{0}"``, and the array.

        Raises DamagedFileError where the fields cannot be told.
        """
        inner = self.inner
        fields = [""]
        if self.code != _CELL:
            inner = inner[1:] if self.code == _OBJECT else inner  # an object's class name stands first
            fields, inner = _field_names(inner, self.name), inner[2:]
        if len(inner) != self.n_values * len(fields):
            raise DamagedFileError(f"{len(inner)} of {self.n_values * len(fields)} arrays are there", place=self.name)
        for number, element in enumerate(inner):
            which, field = divmod(number, len(fields))
            matrix = matrix_of(element)
            if matrix is None:
                raise DamagedFileError("an array is expected here", place=self.name)
            one = self.n_values == 1 and self.code != _CELL
            yield ("" if one else f"{{{which}}}") + (f".{fields[field]}" if fields[field] else ""), matrix


def _field_names(inner: list[Element], name: str) -> list[str]:
    """Names of the fields of the struct ``name``, which stand in rows of one length."""
    lengths = inner[0].numbers() if inner else np.empty(0)
    if len(inner) < 2 or len(lengths) != 1 or not 0 < int(lengths[0]) <= 1024 or len(inner[1].body) % int(lengths[0]):
        raise DamagedFileError("the names of the fields cannot be told", place=name)
    length, text = int(lengths[0]), inner[1].body.tobytes()
    rows = [text[start : start + length] for start in range(0, len(text), length)]
    return [row.split(b"\0")[0].decode("utf-8", "replace") for row in rows]


def matrix_of(element: Element, *, partial: bool = False) -> Matrix | None:
    """The array that ``element`` holds, or None for an element that is none.

    Where ``partial``, ``element`` is only the beginning of it. Raises DamagedFileError where its head is no head.
    """
    if element.code != _MATRIX:
        return None
    if not len(element.body):
        return Matrix("", 6, (0, 0), False, [], element.order)  # how an empty field is written
    inner = list(islice(elements(element.body, 0, len(element.body), element.order, partial=partial), _MOST_PARTS + 1))
    if len(inner) > _MOST_PARTS:
        raise TooManyPartsError(f"a variable holds more than {_MOST_PARTS} arrays")
    if len(inner) < 3 or len(inner[0].body) != 8 or inner[0].code != 6:
        raise DamagedFileError("a variable without a head")
    flags = int(inner[0].numbers()[0])
    code = flags & 0xFF
    if code == 17:  # an opaque object has names where others have a shape
        return Matrix(inner[1].body.tobytes().decode("utf-8", "replace"), code, (), False, [], element.order)
    shape = tuple(int(side) for side in inner[1].numbers())
    if not 2 <= len(shape) <= 32 or min(shape) < 0:
        raise DamagedFileError("a variable without a shape")
    name = inner[2].body.tobytes().decode("utf-8", "replace")
    return Matrix(name, code, shape, bool(flags & _COMPLEX), inner[3:], element.order)


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
        tree = _tree(data, settings)
        names = names_of(sources, tree.names, path)
        wanted = [tree.columns[name] for name in names.values() if name in tree.columns]
        leaves = {id(column.leaf): column.leaf for column in wanted}
        check_budget(sum(leaf.n_values * 8 for leaf in leaves.values()), settings)
        single = ("single", "int8", "uint8", "int16", "uint16")
        kinds = [(column.n_samples, np.float32 if column.leaf.kind in single else np.float64) for column in wanted]
        rows = rows_for(kinds, in_memory_bytes=settings.in_memory_bytes)
        for leaf in leaves.values():
            mine = [(column, row) for column, row in zip(wanted, rows, strict=True) if column.leaf is leaf]
            _fill(mine, leaf, settings)
    room = iter(rows)
    columns = [next(room) if name in tree.columns else np.array([tree.scalars[name]]) for name in names.values()]
    detail = "written twice, the last is read: " + ", ".join(tree.twice)
    flags = [flag(path, "variable_written_twice", "info", detail)] if tree.twice else []
    return _contents(tree).with_columns(names, columns, flags=flags)


def contents(path: Path, *, settings: IngestSettings) -> Contents:
    """Names and lengths of the numeric columns of the MATLAB file at ``path``, single numbers last, and their rates.

    ``settings`` give the byte and object limits. Raises what :func:`read` raises.
    """
    with _opened(path) as data:
        return _contents(_tree(data, settings))


def _contents(tree: _Tree) -> Contents:
    samples = {name: column.n_samples for name, column in tree.columns.items()} | dict.fromkeys(tree.scalars, 1)
    rates = {name: rate for name in tree.columns if (rate := _rate_hz(tree, name)) is not None}
    return Contents("MATLAB", tree.names, samples, rates_hz=rates, starts_s=_starts(tree))


@contextmanager
def _opened(path: Path) -> Iterator[Buffer]:
    """Bytes of the file at ``path``, mapped; what its damage raises inside is told as InputError."""
    with path.open("rb") as stream:
        if path.stat().st_size < _HEADER_BYTES + 8:
            raise InputError("truncated: a MATLAB file without any variable", remedy="Copy it again")
        data = np.frombuffer(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ), np.uint8)
    try:
        yield data  # unmapped when the last view of it is gone
    except TooManyPartsError as error:
        raise UnsafeInputError(str(error), remedy="Save the signals as variables of their own") from None
    except DamagedFileError as error:
        raise InputError(f"damaged or truncated: {error}", place=error.place, remedy="Copy the file again") from None


def _tree(data: Buffer, settings: IngestSettings) -> _Tree:
    """All numeric arrays of the file: its variables and what lies in structs and cells, bounded in depth and number."""
    mark = data[126:128].tobytes()
    if mark not in (b"IM", b"MI"):
        raise DamagedFileError("the header does not say in which order bytes stand")
    order, walk = ("<" if mark == b"IM" else ">"), _Walk(settings)
    for element in elements(data, _HEADER_BYTES, len(data), order):
        walk.variable(element)
    if not walk.leaves:
        found = ", ".join(sorted(set(walk.others)))
        remedy = "Save numbers as plain arrays: tables, time series and text are not read" if found else "Copy it again"
        raise InputError("holds no array of numbers", found=found, remedy=remedy)
    columns: dict[str, _Column] = {}
    scalars: dict[str, float] = {}
    for name, leaf in walk.leaves.items():
        if leaf.n_values == 1:
            scalars[name] = float(_values(leaf, settings)[0])
        else:
            columns |= _columns(name, leaf)
    return _Tree(columns, scalars, tuple(dict.fromkeys(walk.twice)), tuple(walk.others))


class _Walk:
    """Visits variables and what lies in them, and keeps the arrays of real numbers by name."""

    def __init__(self, settings: IngestSettings) -> None:
        self._settings, self._n = settings, 0
        self.leaves: dict[str, Matrix] = {}
        self.twice: list[str] = []
        self.others: list[str] = []

    def variable(self, element: Element) -> None:
        """Visit one variable; a compressed one is opened as far as its header only, where that is enough."""
        self._count("")
        if element.compressed:
            head = expanded(element, most=_HEAD_BYTES, settings=self._settings)
            matrix = matrix_of(head, partial=True)
            if matrix is not None and not matrix.is_number:
                matrix = matrix_of(expanded(element, most=None, settings=self._settings))
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
            raise UnsafeInputError(f"structs and cells are nested deeper than {_MAX_DEPTH}", place=name)
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
            raise UnsafeInputError(f"holds more than {self._settings.max_objects} objects", place=name)


def _columns(name: str, leaf: Matrix) -> dict[str, _Column]:
    """A vector as one column, a matrix as one for each row or column along its longer side; none of more dimensions."""
    sides = sorted(side for side in leaf.shape if side != 1)
    if len(sides) == 1:
        return {name: _Column(leaf, None, sides[0])}
    if len(sides) != 2 or sides[0] > _MOST_COLUMNS:
        return {}
    return {f"{name}[{index}]": _Column(leaf, index, sides[1]) for index in range(sides[0])}


def _values(leaf: Matrix, settings: IngestSettings) -> npt.NDArray[Any]:
    """The stored values of ``leaf`` (column by column), of whatever type they are stored in."""
    if leaf.packed is None:
        return leaf.values()
    whole = matrix_of(expanded(leaf.packed, most=None, settings=settings))
    if whole is None:
        raise DamagedFileError("a compressed variable holds no array", place=leaf.name)
    return whole.values()


def _fill(mine: list[tuple[_Column, FloatArray]], leaf: Matrix, settings: IngestSettings) -> None:
    values = _values(leaf, settings)
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


def _starts(tree: _Tree) -> dict[str, float]:
    """Time in s of the first sample of columns that have one beside them in their own struct, by name."""
    stated = {
        key.rpartition(".")[0]: value
        for key, value in tree.scalars.items()
        if "." in key and _word(key) in _START_NAMES and math.isfinite(value)
    }
    return {name: stated[group] for name in tree.columns if (group := name.rpartition(".")[0]) in stated}


def _word(key: str) -> str:
    """The last part of ``key`` in small letters, without what joins words."""
    return re.sub(r"[\W_]+", "", key.rpartition(".")[2].casefold())


def _rate_hz(tree: _Tree, name: str) -> float | None:
    """Samples per second that single numbers beside the column ``name`` state: in its own struct, else anywhere.

    None where they contradict each other.
    """
    stated = {key: rate for key, value in tree.scalars.items() if (rate := _stated(key, value)) is not None}
    group = name.rpartition(".")[0]
    beside = [rate for key, rate in stated.items() if key.rpartition(".")[0] == group]
    rates = beside or list(stated.values())
    return rates[0] if rates and max(rates) - min(rates) <= 1e-6 * rates[0] else None


def _stated(key: str, value: float) -> float | None:
    """Rate in Hz that the number ``key`` states."""
    if not (value > 0.0 and math.isfinite(value)):
        return None
    word = _word(key)
    if word in _RATE_NAMES or word.endswith(_RATE_ENDINGS):
        return value
    return 1.0 / value if word in _STEP_NAMES else None
