"""Data elements of a MATLAB 5 file: tags, arrays, structs and cells as they lie in the bytes, every length checked.

Format: The MathWorks, "MAT-File Format" (R2019b), chapter 1: tables 1-1 to 1-3.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crankorder.ingest.rawfile import check_budget
from crankorder.scratch import empty
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


class DamagedFileError(Exception):
    """The bytes are no MATLAB data; ``place`` names the variable, where that is known."""

    def __init__(self, problem: str, *, place: str = "") -> None:
        self.place = place
        super().__init__(problem)


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


def expanded(element: Element, *, most: int | None, path: Path, settings: IngestSettings) -> Element:
    """The element that the compressed ``element`` holds; only its first ``most`` bytes where that is a number.

    Its size is checked against ``settings`` before room is made; ``path`` names the file in errors.
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
        check_budget(n_bytes, path, max_bytes=settings.max_bytes)
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
    lengths = inner[0].numbers() if inner else np.empty(0)
    if len(inner) < 2 or len(lengths) != 1 or not 0 < int(lengths[0]) <= 1024 or len(inner[1].body) % int(lengths[0]):
        raise DamagedFileError("the names of the fields cannot be told", place=name)
    length, text = int(lengths[0]), inner[1].body.tobytes()
    return [
        text[start : start + length].split(b"\0")[0].decode("utf-8", "replace") for start in range(0, len(text), length)
    ]


def matrix_of(element: Element, *, partial: bool = False) -> Matrix | None:
    """The array that ``element`` holds, or None for an element that is none.

    Where ``partial``, ``element`` is only the beginning of it. Raises DamagedFileError where its head is no head.
    """
    if element.code != _MATRIX:
        return None
    if not len(element.body):
        return Matrix("", 6, (0, 0), False, [], element.order)  # how an empty field is written
    inner = list(elements(element.body, 0, len(element.body), element.order, partial=partial))
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
