"""What each recording gave, kept by content: a killed or changed test computes only what is missing."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar
from weakref import WeakValueDictionary

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.checks.doubts import RecordingResult
from crankorder.quantities import QualityFlag, ShaftAngle, unindexed
from crankorder.scratch import empty
from crankorder.stages import FRAMES_OF

STORE = ".crankorder-frames"
"""Folder in a folder of results that holds what recordings gave, a folder for each test."""

LEAST_FREE_BYTES = 1 << 30
"""Space that is left on the disk for the results themselves."""

KEEPERS = 400
"""So many recordings keep the datasets that were made of them, some 100 kB each; of others they are made each time."""

IN_MEMORY_BYTES = 1 << 26
"""What is larger is laid on disk: a result into a file without a name, a part of a kept one stays in its file."""

_MAGIC = b"crankorder frames 3\n"
_DIGEST_BYTES = 32
_LENGTH_BYTES = 8
_ALIGNED = 16


@dataclass(frozen=True)
class FrameStore:
    """Files in ``folder``, one for each recording of a test, named by what the recording's result depends on."""

    folder: Path

    @classmethod
    def of(cls, result_folder: Path) -> FrameStore:
        """Store of the test whose results stand in ``result_folder``."""
        return cls(result_folder.parent / STORE / result_folder.name)

    def path(self, key: str) -> Path:
        """File of the result with this ``key``, whether it is there or not."""
        return self.folder / f"{key}.frames"

    def load(self, key: str) -> PackedResult | None:
        """Result that was kept under ``key``; None where there is none, or where it is damaged."""
        try:
            PackedResult.checked(np.fromfile(self.path(key), dtype=np.uint8))
            with contextlib.suppress(OSError):
                os.utime(self.path(key))
            return PackedResult(self.path(key))
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def save(self, key: str, result: PackedResult) -> PackedResult:
        """Keep ``result`` under ``key`` and return the kept one; ``result`` itself where the disk does not allow it."""
        with contextlib.suppress(OSError):
            self.folder.mkdir(parents=True, exist_ok=True)
            if shutil.disk_usage(self.folder).free < LEAST_FREE_BYTES:
                return result
            handle, temporary = tempfile.mkstemp(dir=self.folder, suffix=".part")
            try:
                with os.fdopen(handle, "wb") as stream:
                    stream.write(result.bytes_of(0, None).data)
                Path(temporary).replace(self.path(key))
            except BaseException:
                Path(temporary).unlink(missing_ok=True)
                raise
            return PackedResult(self.path(key))
        return result

    def keep_only(self, keys: Iterable[str]) -> None:
        """Remove all but the results under ``keys``: what the test no longer asks for."""
        kept = {self.path(key).name for key in keys}
        with contextlib.suppress(OSError):
            for path in self.folder.iterdir():
                if path.name not in kept:
                    path.unlink(missing_ok=True)


def prune(stores: Iterable[Path], *, most_bytes: float = 0, unused_s: float = 0) -> tuple[int, int, int]:
    """Remove kept files in the folders ``stores``, those longest unused first, until ``most_bytes`` are left.

    Files that were used within the last ``unused_s`` seconds stay. Returns the number and the bytes of what was
    removed, and the bytes that are left.
    """
    files = list[tuple[float, int, Path]]()
    for path in (path for store in stores for path in store.rglob("*")):
        with contextlib.suppress(OSError):
            state = path.lstat()
            if not stat.S_ISDIR(state.st_mode):
                files.append((state.st_mtime, state.st_size, path))
    left = sum(size for _, size, _ in files)
    count, before = 0, left
    for used, size, path in sorted(files):
        if left <= most_bytes or time.time() - used < unused_s:
            break
        path.unlink(missing_ok=True)
        count, left = count + 1, left - size
    for folder in (folder for store in stores for folder in (*store.glob("*/"), store)):
        with contextlib.suppress(OSError):  # not empty, or already gone
            folder.rmdir()
    return count, before - left, left


class PackedResult(RecordingResult):
    """A recording's result as bytes (bytes,) in memory or in a file; its shaft and frames are made on demand.

    Thousands of these whose bytes stand in files cost little memory.
    """

    _keepers: ClassVar[WeakValueDictionary[int, PackedResult]] = WeakValueDictionary()

    def __init__(self, source: NDArray[np.uint8] | Path) -> None:
        """Result of the bytes in ``source``, (bytes,) or a file, as :meth:`of` packed it; else ValueError, KeyError."""
        self.__dict__.update(_source=source, _made={})
        begin = len(_MAGIC) + _DIGEST_BYTES
        length = int.from_bytes(self.bytes_of(begin, _LENGTH_BYTES).tobytes(), "little")
        index = json.loads(self.bytes_of(begin + _LENGTH_BYTES, length).tobytes())
        self.__dict__.update(_index=index["parts"], _about=index["about"], _first=begin + _LENGTH_BYTES + length)

    _source: NDArray[np.uint8] | Path
    _index: dict[str, list[int]]
    _about: dict[str, Any]
    _first: int
    _made: dict[str, xr.Dataset]

    @classmethod
    def of(cls, result: RecordingResult) -> PackedResult:
        """``result``, packed: magic, digest, index, then header and arrays of each dataset.

        The digest is that of all bytes behind it. Raises TypeError where an array cannot be packed.
        """
        parts, index = list[bytes | memoryview](), dict[str, list[int]]()
        size = 0
        named = {"": result.shaft, **{noun.__name__: frames for noun, frames in result.frames.items()}}
        for name, dataset in named.items():
            made = _packed(dataset)
            index[name] = [size, len(made[0]), sum(map(len, made))]
            parts += made
            size += index[name][2]
        histories = {name: str(dataset.attrs.get("history", "")) for name, dataset in named.items()}
        about = {"name": result.name, "flags": result.flags, "histories": histories}
        header = json.dumps({"parts": index, "about": about}).encode()
        header += b" " * (-(len(header) + len(_MAGIC) + _DIGEST_BYTES + _LENGTH_BYTES) % _ALIGNED)
        parts = [len(header).to_bytes(_LENGTH_BYTES, "little"), header, *parts]
        digest = hashlib.sha256()
        for part in parts:
            digest.update(part)
        parts = [_MAGIC, digest.digest(), *parts]
        ends = np.cumsum([len(part) for part in parts])
        data = empty((int(ends[-1]),), np.uint8, on_disk=int(ends[-1]) > IN_MEMORY_BYTES)
        for part, end in zip(parts, ends.tolist(), strict=True):
            data[end - len(part) : end] = np.frombuffer(part, dtype=np.uint8)
        return cls(data)

    @classmethod
    def checked(cls, data: NDArray[np.uint8]) -> PackedResult:
        """Result that ``data`` (bytes,) holds; raises ValueError where a single byte differs from what was packed."""
        begin = len(_MAGIC) + _DIGEST_BYTES
        digest = hashlib.sha256(data[begin:].data).digest()
        if data[: len(_MAGIC)].tobytes() != _MAGIC or digest != data[len(_MAGIC) : begin].tobytes():
            raise ValueError("damaged")
        return cls(data)

    def __reduce__(self) -> tuple[type[PackedResult], tuple[NDArray[np.uint8] | Path]]:
        """Travel as the one array, or as the place of the file."""
        return PackedResult, (self._source,)

    def bytes_of(self, begin: int, size: int | None) -> NDArray[np.uint8]:
        """Bytes (size,) from ``begin`` on, to the end where ``size`` is None; those of a file are the caller's own."""
        if not isinstance(self._source, Path):
            return self._source[begin : None if size is None else begin + size]
        if size is not None and size > IN_MEMORY_BYTES:
            return np.memmap(self._source, np.uint8, "c", begin, (size,))
        return np.fromfile(self._source, np.uint8, -1 if size is None else size, offset=begin)

    @property
    def shaft(self) -> ShaftAngle:
        """The ShaftAngle; a copy of the caller's own, whose values must not be changed."""
        return ShaftAngle(self._part(""))

    @cached_property
    def frames(self) -> Mapping[Any, xr.Dataset]:
        """The frames (dims of ``data_schema/``) by noun, each a copy of the caller's own, whose values must stay."""
        return _PackedFrames(self)

    @property
    def name(self) -> str:
        """Name of the recording: its path inside the folder of the test."""
        return str(self._about["name"])

    @property
    def flags(self) -> list[QualityFlag]:
        """Quality flags of shaft and frames, as of RecordingResult."""
        return list(self._about["flags"])

    def history_of(self, noun: Any) -> str:
        """History of the frames of this ``noun``, or of the shaft."""
        return str(self._about["histories"]["" if noun is ShaftAngle else noun.__name__])

    def _part(self, name: str) -> xr.Dataset:
        if name in self._made:
            return self._made[name].copy(deep=False)
        begin, header, size = self._index[name]
        part = self.bytes_of(self._first + begin, size)
        described, arrays = json.loads(part[:header].tobytes()), _Arrays(part[header:])
        variables = {
            name: xr.Variable(dims, arrays.take(*array), {key: arrays.take(*one) for key, one in attrs.items()})
            for name, dims, array, attrs in described["variables"]
        }
        attrs = {key: arrays.take(*one) for key, one in described["attrs"].items()}
        dataset = xr.Dataset(coords=unindexed(**variables), attrs=attrs)
        dataset = dataset.reset_coords([name for name in variables if name not in described["coords"]])
        if id(self) in self._keepers or len(self._keepers) < KEEPERS:
            self._keepers[id(self)] = self
            self._made[name] = dataset.copy(deep=False)
        return dataset


class _PackedFrames(Mapping[Any, xr.Dataset]):
    """Frames by noun of one packed result."""

    def __init__(self, result: PackedResult) -> None:
        self._result = result

    def __getitem__(self, noun: Any) -> xr.Dataset:
        return self._result._part(noun.__name__)

    def __contains__(self, noun: object) -> bool:
        return getattr(noun, "__name__", "") in self._result._index

    def __iter__(self) -> Iterator[Any]:
        return (noun for noun in FRAMES_OF.values() if noun.__name__ in self._result._index)

    def __len__(self) -> int:
        return len(self._result._index) - 1


def _packed(dataset: xr.Dataset) -> list[bytes | memoryview]:
    """Pieces of ``dataset``: header, arrays; each a multiple of the alignment. TypeError where it cannot be kept."""
    arrays: list[NDArray[Any]] = []

    def attrs(of: xr.Dataset | xr.Variable) -> dict[str, list[Any]]:
        return {str(key): _described(value, arrays) for key, value in of.attrs.items()}

    variables = [
        [str(name), list(variable.dims), _described(variable.values, arrays), attrs(variable)]
        for name, variable in dataset.variables.items()
    ]
    described = {"variables": variables, "coords": [str(name) for name in dataset.coords], "attrs": attrs(dataset)}
    header = json.dumps(described).encode()
    pieces: list[bytes | memoryview] = [header + b" " * (-len(header) % _ALIGNED)]
    for array in filter(np.size, arrays):  # looked at where they lie, in bytes
        pieces += [np.ascontiguousarray(array).reshape(-1).view(np.uint8).data, b"\0" * (-array.nbytes % _ALIGNED)]
    return pieces


def _described(value: Any, arrays: list[NDArray[Any]]) -> list[Any]:
    """``value`` as JSON has it behind its kind, for which JSON has no word; an array joins ``arrays``."""
    if not isinstance(value, np.generic | np.ndarray):
        return ["tuple" if isinstance(value, tuple) else "plain", value]
    array = np.asarray(value)
    if array.dtype.hasobject:
        raise TypeError("objects are not kept")
    arrays.append(array)
    return ["array" if isinstance(value, np.ndarray) else "scalar", [array.dtype.str, list(array.shape), array.nbytes]]


class _Arrays:
    """Arrays that lie one behind the other, taken in the order in which their values were described."""

    def __init__(self, memory: NDArray[np.uint8]) -> None:
        self._memory, self._place = memory, 0

    def take(self, kind: str, value: Any) -> Any:
        """The next value as it was before it was described."""
        if kind in ("plain", "tuple"):
            return tuple(value) if kind == "tuple" else value
        dtype, shape, size = np.dtype(value[0]), value[1], value[2]
        count = int(np.prod(shape, dtype=np.int64))
        array = np.frombuffer(self._memory, dtype, count, self._place) if count else np.empty(shape, dtype)
        self._place += -(-size // _ALIGNED) * _ALIGNED
        return array.reshape(shape) if kind == "array" else array.reshape(shape)[()]
