"""One process at a time at a place that several share: the folder of a test's results, or the index of all."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

from crankorder.errors import EnvironmentFailure, printable

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

PAUSE_S = 0.05
"""Between two looks at a lock that another process holds."""

_held: set[int] = set()
"""Locks of this process: a worker that is forked from it closes them, so that they end with this process."""

WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, getattr(errno, "EBADFD", errno.ENOLCK))


@contextlib.contextmanager
def locked(place: Path, *, tell: Callable[[str], object] = lambda text: None) -> Iterator[None]:
    """Hold the lock of ``place``, a file or folder that need not exist, which others wait for.

    The lock is a file beside it that says who holds it; the system lets go of it when its process ends, however that
    comes. ``tell`` is told once where another process is waited for, and where this disk knows no locks.
    Raises EnvironmentFailure where the folder of ``place`` cannot be written.
    """
    path = place.with_name(f".{place.name}.lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = _take(path, tell)
    except OSError as error:
        problem = f"the results cannot be written ({error.strerror or error})"
        remedy = "Choose another --out, or change its rights"
        raise EnvironmentFailure(problem, file=path.parent, remedy=remedy) from error
    _held.add(handle)
    try:
        yield
    finally:
        _held.discard(handle)
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(handle)


def forget_locks() -> None:
    """Leave the locks of the process that this one was forked from to that process alone."""
    while _held:
        os.close(_held.pop())


def _take(path: Path, tell: Callable[[str], object]) -> int:
    told = False
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if _locks(handle, path, tell):
                # whoever held it before may have taken the file away: then this is the lock of nothing
                with contextlib.suppress(FileNotFoundError):
                    if os.path.samestat(os.fstat(handle), path.stat()):
                        _sign(handle)
                        return handle
            elif not told:
                tell(f"{place_of(path)}: waiting for {_holder(path)}")
                told = True
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)
        time.sleep(PAUSE_S)


def _locks(handle: int, path: Path, tell: Callable[[str], object]) -> bool:
    if fcntl is None:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in WITHOUT_LOCKS:
            raise
        tell(f"{place_of(path)}: this disk knows no locks: let no other run write there at the same time")
    return True


def place_of(path: Path) -> str:
    """Name of what the lock at ``path`` belongs to, to be shown."""
    return printable(path.name.removeprefix(".").removesuffix(".lock"))


def _sign(handle: int) -> None:
    with contextlib.suppress(OSError):  # a full disk: who holds it is only told
        os.truncate(handle, 0)
        since = datetime.now(UTC).isoformat("T", "seconds")
        holder = {"pid": os.getpid(), "host": socket.gethostname(), "since": since}
        os.pwrite(handle, json.dumps(holder).encode(), 0)


def _holder(path: Path) -> str:
    try:
        found = json.loads(path.read_bytes())
        text = f"process {int(found['pid'])} on {found['host']}, which writes there since {found['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        text = "another process, which writes there"
    return printable(text)
