"""Results appear whole or not at all: bytes are written beside, flushed and renamed; a done marker comes last."""

from __future__ import annotations

import hashlib
import json
import math
import os
import tempfile
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

from crankorder.errors import EnvironmentFailure

DONE = "done.json"
CHUNK = 1 << 18

LIBRARIES = ("numpy", "scipy", "xarray", "h5py", "h5netcdf", "matplotlib", "numba", "pyfftw")
"""Libraries on whose versions results may depend."""

DIGITS = 10
"""Significant digits of a number in JSON: beyond any measurement, short of the noise of arithmetic."""


def json_bytes(document: Any) -> bytes:
    """``document`` as UTF-8 JSON with sorted lists kept, ten significant digits, NaN and infinity as null."""
    text = json.dumps(_plain(document), indent=2, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode("utf-8", "backslashreplace")


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
    digest = hashlib.sha256()
    with path.open("rb", buffering=0) as stream:
        buffer = bytearray(CHUNK)
        view = memoryview(buffer)
        while count := stream.readinto(buffer):
            digest.update(view[:count])
    return digest.hexdigest()


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
    """Versions of the program and of the ``LIBRARIES``, by name."""
    return {name: version(name) for name in ("crankorder", *LIBRARIES)}


def publish(folder: Path, contents: Mapping[str, bytes], *, key: str) -> None:
    """Write ``contents`` (name → bytes) into ``folder`` and then the done marker with their hashes and ``key``.

    The old marker goes first, so that a reader never takes a half-replaced folder for a finished one.
    Raises EnvironmentFailure where the disk is full or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stale = _outputs_of(folder) - set(contents)
        (folder / DONE).unlink(missing_ok=True)
        for name, data in contents.items():
            write_atomically(folder / name, data)
        hashes = {name: hashlib.sha256(data).hexdigest() for name, data in sorted(contents.items())}
        for name in stale:
            (folder / name).unlink(missing_ok=True)
        for leftover in folder.glob(".*.part"):
            leftover.unlink(missing_ok=True)
        write_atomically(folder / DONE, json_bytes({"key": key, "outputs_sha256": hashes}))
    except OSError as error:
        raise EnvironmentFailure(
            f"the results cannot be written ({error.strerror or error})",
            file=error.filename or folder,
            remedy="Free space on the disk or choose another --out; what was there before is kept or gone, never half",
        ) from error


def _outputs_of(folder: Path) -> set[str]:
    """Names of the files that an earlier run finished in ``folder``."""
    try:
        names = json.loads((folder / DONE).read_bytes())["outputs_sha256"]
        return {name for name in names if Path(name).name == name}
    except (OSError, ValueError, KeyError, TypeError):
        return set()


def write_atomically(path: Path, data: bytes) -> None:
    """Put ``data`` at ``path`` in one step: a temporary file beside it, flushed, renamed, the folder flushed."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        Path(temporary).chmod(0o666 & ~_umask())
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    descriptor = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@cache
def _umask() -> int:
    current = os.umask(0o022)
    os.umask(current)
    return current


def finished_with(folder: Path, key: str) -> bool:
    """Whether ``folder`` holds results that were finished with ``key`` and whose files are still those written."""
    try:
        marker = json.loads((folder / DONE).read_bytes())
        return bool(marker["key"] == key) and all(
            file_sha256(folder / name) == digest for name, digest in marker["outputs_sha256"].items()
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return False
