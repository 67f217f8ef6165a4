"""Arrays larger than memory: laid into a file without a name, whose pages the system writes out and reads as needed."""

from __future__ import annotations

import contextlib
import ctypes
import math
import mmap
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import DTypeLike, NDArray

from crankorder.errors import EnvironmentFailure

BLOCK_SAMPLES = 1 << 16
"""Samples that are worked on at a time: few enough for the second-level cache, many enough that calls cost nothing."""

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Names that glibc's malloc.h gives to limits of its memory."""

_MUCH_BYTES = 3 << 27
"""Memory of a process from which on what it no longer uses is worth giving back."""

_LASTING = Path("/var/tmp")


def blocks(n_samples: int, *, size: int = BLOCK_SAMPLES) -> Iterator[slice]:
    """Slices of ``size`` samples, the last one shorter, that together are all ``n_samples``."""
    for first in range(0, n_samples, size):
        yield slice(first, min(first + size, n_samples))


def empty(shape: tuple[int, ...], dtype: DTypeLike, *, on_disk: bool) -> NDArray[Any]:
    """An array of ``shape``, such as (channels, samples), and ``dtype``, to be filled, in memory or ``on_disk``.

    The file of the latter has no name: it is gone when the array is, however the process ends. Its whole size is
    claimed at once, so that a full disk is told here and not when a page is written.
    Raises EnvironmentFailure where the disk has no room for it.
    """
    n_bytes = math.prod(shape) * np.dtype(dtype).itemsize
    if not on_disk or n_bytes == 0:
        return np.empty(shape, dtype)
    folder = scratch_folder()
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            _claim(file, n_bytes)
            pages = mmap.mmap(file.fileno(), n_bytes)
    except OSError as error:
        problem = "no room for a recording larger than memory"
        found = f"{error.strerror or error} for {n_bytes} bytes"
        remedy = "Free space there, set TMPDIR to a folder on a larger disk, or allow more memory (--max-memory)"
        raise EnvironmentFailure(problem, file=folder, found=found, remedy=remedy) from None
    return np.ndarray(shape, dtype, buffer=pages)


def empty_like(other: NDArray[Any], shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array of ``shape`` and ``dtype`` that lies where ``other`` (any shape) lies: in memory or on disk.

    Raises EnvironmentFailure where the disk has no room for it.
    """
    return empty(shape, dtype, on_disk=is_on_disk(other))


def is_on_disk(array: NDArray[Any]) -> bool:
    """Whether ``array`` (any shape) is an array laid on disk, or a view of one."""
    owner: Any = array
    while isinstance(owner, np.ndarray):
        owner = owner.base
    return isinstance(owner, mmap.mmap)


def keep_freed_memory() -> None:
    """Have glibc keep what a task frees for the next one: each page that it takes anew costs a fault."""
    with contextlib.suppress(OSError, AttributeError):
        for limit, size in ((_MMAP_THRESHOLD, 1 << 23), (_TRIM_THRESHOLD, 1 << 26)):
            ctypes.CDLL(None).mallopt(limit, size)


def give_back() -> None:
    """Have glibc give free memory back to the system where this process has much."""
    with contextlib.suppress(OSError, AttributeError, ValueError):
        resident, shared = Path("/proc/self/statm").read_text(encoding="ascii").split()[1:3]
        if (int(resident) - int(shared)) * mmap.PAGESIZE > _MUCH_BYTES:
            ctypes.CDLL(None).malloc_trim(0)


def scratch_folder() -> Path:
    """Folder of the files: what TMPDIR says, else /var/tmp, which is never memory as /tmp may be, else the system's."""
    if "TMPDIR" not in os.environ and os.access(_LASTING, os.W_OK | os.X_OK):
        return _LASTING
    return Path(tempfile.gettempdir())


def _claim(file: BinaryIO, n_bytes: int) -> None:
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, n_bytes)
        return
    zeros = bytes(1 << 20)
    for part in blocks(n_bytes, size=len(zeros)):
        file.write(zeros[: part.stop - part.start])
    file.flush()
