"""NumPy array files (.npy): an array of numbers, its rows or its columns as channels by number; never a pickle."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crankorder.errors import InputError, UnsafeInputError
from crankorder.ingest.rawfile import (
    Contents,
    RawFile,
    Source,
    check_budget,
    float_type_for,
    names_of,
    part_of,
    rows_for,
)
from crankorder.scratch import blocks
from crankorder.settings import IngestSettings

_MOST_COLUMNS = 1000


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings, rows: slice | None = None) -> RawFile:
    """Channels that ``sources`` ask for, by number from 0, from the array at ``path``; by name where it has fields.

    The longer side of the array is time. ``settings`` give the byte limit; ``rows``: of its samples, None for all.
    Raises InputError for damage, a missing channel or what is no real number, UnsafeInputError for Python objects and
    impossible sizes.
    """
    whole = _table(path, settings)
    names = whole.dtype.names or tuple(str(number) for number in range(whole.shape[1]))
    table = whole[part_of(len(whole), rows)]
    chosen = names_of(sources, names, path)
    wanted = [names.index(name) for name in chosen.values()]
    types = [table.dtype[index] if table.dtype.names else table.dtype for index in wanted]
    kinds = [(len(table), float_type_for(dtype)) for dtype in types]
    room = rows_for(kinds, in_memory_bytes=settings.in_memory_bytes)
    for part in blocks(len(table) if wanted else 0):
        piece = table[part]  # a column of an interleaved table costs as much as all of it: each page is read once
        for index, row in zip(wanted, room, strict=True):
            row[part] = piece[names[index]] if table.dtype.names else piece[:, index]
    stated = Contents("NumPy", names, samples=dict.fromkeys(names, len(whole)))
    return stated.with_columns(chosen, room)


def _table(path: Path, settings: IngestSettings) -> npt.NDArray[Any]:
    """The array, mapped, as (sample, channel), or (sample,) with fields; nothing of it is read yet."""
    try:
        with np.errstate(over="raise"):
            data = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # a header is read as Python's literals: whatever its parser raises, it is damaged
        if "Python objects" in str(error) or "pickle" in str(error):
            problem = "holds Python objects, a pickle that can run code: never opened"
            raise UnsafeInputError(problem, remedy="Save an array of numbers") from None
        raise InputError("is damaged or truncated", found=error, remedy="Copy it again") from None
    if not isinstance(data, np.memmap):
        raise InputError("is no array of signals", found=type(data).__name__, allowed="one array")
    dtype = data.dtype
    fields = [dtype[name] for name in dtype.names] if dtype.names else [dtype]
    if any(field.kind not in "iufb" or field.shape for field in fields):
        raise InputError("holds no real numbers", found=str(dtype), remedy="Save an array of integers or floats")
    check_budget(data.size * max(4, dtype.itemsize), settings)
    sides = [side for side in data.shape if side != 1] or [1]
    if data.size == 0 or len(sides) > 2 or (len(sides) == 2 and (min(sides) > _MOST_COLUMNS or dtype.names)):
        allowed = f"(samples,), or two sides of which one has at most {_MOST_COLUMNS} channels"
        raise InputError("is no array of signals", found=f"shape {data.shape}", allowed=allowed)
    table = data.squeeze()
    if dtype.names:
        return table.reshape(-1)
    table = table.reshape(-1, 1) if table.ndim < 2 else table
    return table.T if table.shape[1] > table.shape[0] else table
