"""Bytes on the disk: hashes of what is read, files that appear whole or not at all, one writer at a time at a place."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import json
import math
import os
import re
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from io import FileIO
from pathlib import Path
from typing import Any

from crankorder.errors import EnvironmentFailure, printable
from crankorder.fft.plans import fft_library

PAUSE_S = 0.05
"""Between two looks at a lock that another process holds."""

WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, getattr(errno, "EBADFD", errno.ENOLCK))

_BEYOND_ASCII = re.compile(r"[^\x00-\x7e]")

CHANGED = "changed while it was read"

SETTLED_NS = 2_000_000_000
"""A file changed longer ago than this has another time when it changes again: the coarsest clocks of disks tick so."""

LIBRARIES = ("numpy", "scipy", "xarray", "h5py", "h5netcdf", "matplotlib", "numba", "pyfftw")
"""Libraries on whose versions results may depend."""

DIGITS = 10
"""Significant digits of a number in JSON: beyond any measurement, short of the noise of arithmetic."""


def json_bytes(document: Any) -> bytes:
    """``document`` as UTF-8 JSON with sorted lists kept, ten significant digits, NaN and infinity as null."""
    text = json.dumps(_plain(document), indent=2, ensure_ascii=False, allow_nan=False)
    # characters that nobody sees, such as those that turn the writing round, are escaped
    text = _BEYOND_ASCII.sub(lambda char: char[0] if char[0].isprintable() else json.dumps(char[0])[1:-1], text)
    return f"{text}\n".encode("utf-8", "backslashreplace")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    if hasattr(value, "item"):
        return _plain(value.item())
    return value


def file_sha256(path: Path) -> str:
    """SHA-256 of the file at ``path``, read in pieces; the hash runs without the interpreter's lock."""
    with path.open("rb", buffering=0) as stream:
        return _stream_sha256(stream)


def _stream_sha256(stream: FileIO) -> str:
    return hashlib.file_digest(stream, "sha256").hexdigest()


def _state(stat: os.stat_result) -> tuple[int, ...]:
    """What changes when a file does: its size (bytes), device, number and times of change (ns)."""
    return stat.st_size, stat.st_dev, stat.st_ino, stat.st_mtime_ns, stat.st_ctime_ns


@dataclass(frozen=True)
class HashedFile:
    """A file as it was hashed: SHA-256 and state, or the ``fault`` for which it could not be read.

    A file that was written just before may change again within one tick of the clock of its disk: ``just_written``.
    """

    sha256: str | None
    state: tuple[int, ...] | None
    fault: str = ""
    just_written: bool = False

    @property
    def size(self) -> int | None:
        """Bytes; None where it could not be read."""
        return None if self.state is None else self.state[0]

    @classmethod
    def of(cls, path: Path) -> HashedFile:
        """The file at ``path``, hashed; one that changes meanwhile has that for its fault."""
        try:
            with path.open("rb", buffering=0) as stream:
                before = os.fstat(stream.fileno())
                digest = _stream_sha256(stream)
            if _state(path.stat()) != _state(before):
                return cls(None, None, CHANGED)
        except OSError as error:
            return cls(None, None, str(error.strerror))
        recent = time.time_ns() - before.st_ctime_ns < SETTLED_NS
        return cls(digest, _state(before), just_written=recent)

    def is_still_at(self, path: Path) -> bool:
        """Whether the file at ``path`` is the one that was hashed, untouched since."""
        try:
            same = _state(path.stat()) == self.state
            return same and (not self.just_written or file_sha256(path) == self.sha256)
        except OSError:
            return False


def text_sha256(*parts: str) -> str:
    """SHA-256 of ``parts`` in order, each with its length, so that no two lists of parts share one."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode("utf-8", "surrogatepass")
        digest.update(f"{len(data)}:".encode() + data)
    return digest.hexdigest()


@cache
def code_sha256() -> str:
    """SHA-256 of the program's own source and pipeline files: other code means other results."""
    roots = [Path(str(files(package))) for package in ("crankorder", "crankorder.pipeline", "crankorder.data_schema")]
    kinds = (".py", ".toml", ".json", ".html", ".css")
    found = {path for root in roots for path in root.rglob("*") if path.suffix in kinds}
    sources = sorted(path for path in found if not any(part.startswith(".") for part in path.parts[-3:]))
    return text_sha256(*(f"{path.name}\n{path.read_text(encoding='utf-8')}" for path in sources))


def library_versions() -> dict[str, str]:
    """Versions of the program and of the ``LIBRARIES``, by name; "not used" where scipy transforms instead of FFTW."""
    used = [name for name in LIBRARIES if name != "pyfftw" or fft_library() == "fftw"]
    return {name: version(name) if name in ("crankorder", *used) else "not used" for name in ("crankorder", *LIBRARIES)}


def write_atomically(path: Path, data: bytes) -> None:
    """Put ``data`` at ``path`` in one step: a temporary file beside it, flushed, renamed, the folder flushed."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    temporary.unlink(missing_ok=True)
    try:
        write_flushed(temporary, data)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    flush_folder(path.parent)


def write_flushed(path: Path, data: bytes) -> None:
    """Make a new file at ``path`` that holds ``data``, on the disk when this returns."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666), "wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())


def flush_folder(folder: Path) -> None:
    """Have the names in ``folder`` on the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def locked(place: Path, *, tell: Callable[[str], object] = lambda text: None) -> Iterator[None]:
    """Hold the lock of ``place``, a file or folder that need not exist, which others wait for.

    The lock is a file beside it that says who holds it; the system releases it when its process ends in any way.
    ``tell`` is called once with a sentence where another process is waited for, and where the disk has no locks.
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
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(handle)


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
    """Name, for messages, of the file or folder that the lock at ``path`` belongs to."""
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
