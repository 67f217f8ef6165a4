"""Memory that a worker and the process that forked it share: large arrays are put there, not sent through a pipe."""

from __future__ import annotations

import contextlib
import mmap
import pickle
from typing import Any

MOST_BYTES = 1 << 36
"""Addresses set aside for one direction of one worker; memory is taken only as they are written."""

LEAST_BYTES = 1 << 14
"""A smaller array goes through the pipe: pages of its own would cost more."""

ALIGNED = 64
"""Arrays begin at multiples of this, as the processor's caches and vectors like them."""

NO_RESERVE = 0x4000
"""``MAP_NORESERVE`` of Linux, which the module mmap does not name."""


class SharedPages:
    """What one process says to another, laid one behind the other; what is read there stays valid while it is held."""

    def __init__(self) -> None:
        """Set the addresses aside; where the system refuses, all goes through the pipe."""
        self._used = 0
        self._memory: memoryview | None = None
        with contextlib.suppress(OSError, ValueError, OverflowError):
            flags = mmap.MAP_SHARED | mmap.MAP_ANONYMOUS | NO_RESERVE
            self._memory = memoryview(mmap.mmap(-1, MOST_BYTES, flags=flags))

    def put(self, value: Any) -> tuple[bytes, list[tuple[int, int]]]:
        """Pickle of ``value`` without its large arrays, and the first byte and the byte after the last of each."""
        places: list[tuple[int, int]] = []

        def is_small(buffer: pickle.PickleBuffer) -> bool:
            raw = buffer.raw()
            begin = -(-self._used // ALIGNED) * ALIGNED
            if self._memory is None or raw.nbytes < LEAST_BYTES or begin + raw.nbytes > MOST_BYTES:
                return True
            self._used = begin + raw.nbytes
            self._memory[begin : self._used] = raw
            places.append((begin, self._used))
            return False

        return pickle.dumps(value, protocol=5, buffer_callback=is_small), places

    def get(self, packed: tuple[bytes, list[tuple[int, int]]]) -> Any:
        """The value that was ``packed`` by :meth:`put` in the other process; its arrays lie where they were put."""
        data, places = packed
        if self._memory is None:
            return pickle.loads(data)
        return pickle.loads(data, buffers=[self._memory[begin:end] for begin, end in places])
