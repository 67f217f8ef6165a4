"""NumPy array files (.npy): an array of numbers, its rows or its columns as channels by number; never a pickle."""

from __future__ import annotations

import tokenize
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crankorder.errors import InputError, UnsafeInputError
from crankorder.ingest.rawfile import Contents, RawFile, Source, check_budget, named, rows_for
from crankorder.scratch import blocks
from crankorder.settings import IngestSettings

_MOST_COLUMNS = 1000
# what NumPy raises on a header that is no header
_HEADER_ERRORS = (
    ValueError,
    TypeError,
    SyntaxError,
    KeyError,
    tokenize.TokenError,
    OverflowError,
    RecursionError,
    EOFError,
)


def read_npy(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Channels that ``sources`` ask for, by number from 0, from the array at ``path``; by name where it has fields.

    The longer side of the array is time. ``settings`` give the byte limit. Raises InputError for damage, a missing
    channel or what is no real number, UnsafeInputError for Python objects and impossible sizes.
    """
    table = _table(path, settings)
    names = _names(table)
    wanted = [names.index(named(source, names, path)) for source in sources]
    target = _target(table.dtype)
    kinds = [(len(table), _target(table.dtype[index]) if table.dtype.names else target) for index in wanted]
    rows = rows_for(kinds, in_memory_bytes=settings.in_memory_bytes)
    for part in blocks(len(table)):
        piece = table[part]  # a column of an interleaved table costs as much as all of it: each page is read once
        for index, row in zip(wanted, rows, strict=True):
            row[part] = piece[names[index]] if table.dtype.names else piece[:, index]
    return RawFile(columns=dict(zip(sources, rows, strict=True)))


def contents_of_npy(path: Path, *, settings: IngestSettings) -> Contents:
    """Numbers (or field names) and lengths of the channels of the array at ``path``; reads its header only.

    ``settings`` give the byte limit. Raises what :func:`read_npy` raises.
    """
    table = _table(path, settings)
    return Contents(format="NumPy", names=_names(table), samples=dict.fromkeys(_names(table), len(table)))


def _table(path: Path, settings: IngestSettings) -> npt.NDArray[Any]:
    """The array, mapped, as (sample, channel), or (sample,) with fields; nothing of it is read yet."""
    shape, fortran_order, dtype, start = _header(path)
    kinds = {dtype[index].kind for index in range(len(dtype.names))} if dtype.names else {dtype.kind}
    flat = all(not dtype[index].shape for index in range(len(dtype.names or ())))
    if not kinds <= set("iufb") or not flat or dtype.itemsize == 0:
        raise InputError(
            "holds no real numbers", file=path, found=str(dtype), remedy="Save an array of integers or floats"
        )
    n_values = 1
    for side in shape:
        n_values *= side
    check_budget(n_values * max(4, dtype.itemsize), path, max_bytes=settings.max_bytes)
    present = (path.stat().st_size - start) // dtype.itemsize
    if present < n_values:
        raise InputError(f"truncated: {present} of {n_values} values", file=path, remedy="Copy it again")
    sides = [side for side in shape if side != 1] or [1]
    if n_values == 0 or len(sides) > 2 or (len(sides) == 2 and (min(sides) > _MOST_COLUMNS or dtype.names)):
        allowed = f"(samples,), or two sides of which one has at most {_MOST_COLUMNS} channels"
        raise InputError("is no array of signals", file=path, found=f"shape {shape}", allowed=allowed)
    data = np.memmap(path, dtype, "r", offset=start, shape=tuple(sides), order="F" if fortran_order else "C")
    if dtype.names:
        return data
    table = data[:, None] if data.ndim == 1 else data
    return table.T if table.shape[1] > table.shape[0] else table


def _header(path: Path) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Shape, whether columns follow each other, type, and where the values begin."""
    try:
        with path.open("rb") as stream:
            version = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            if version not in ((1, 0), (2, 0)):
                raise InputError("is of a version that is not read", file=path, found=version, allowed="(1, 0), (2, 0)")
            shape, fortran_order, dtype = read(stream)
            start = stream.tell()
    except InputError:
        raise
    except _HEADER_ERRORS as error:
        raise InputError("has a damaged header", file=path, found=error, remedy="Copy it again") from None
    if dtype.hasobject:
        raise UnsafeInputError(
            "holds Python objects, a pickle that can run code: never opened",
            file=path,
            remedy="Save an array of numbers",
        )
    if any(side < 0 for side in shape):
        raise InputError("has a damaged header", file=path, found=f"shape {shape}", remedy="Copy it again")
    return shape, fortran_order, dtype, start


def _names(table: npt.NDArray[Any]) -> tuple[str, ...]:
    return table.dtype.names or tuple(str(number) for number in range(table.shape[1]))


def _target(dtype: np.dtype[Any]) -> type[np.float32] | type[np.float64]:
    small = dtype.itemsize <= 2 or (dtype.kind == "f" and dtype.itemsize == 4)
    return np.float32 if small else np.float64
