"""What each recording gave, kept by content: a killed or changed test computes only what is missing."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.quantities import ShaftAngle
from crankorder.settings import Settings
from crankorder.stages import FRAMES_OF, RecordingResult

STORE = ".crankorder-frames"
"""Folder in a folder of results that holds what recordings gave, a folder for each test."""

LEAST_FREE_BYTES = 1 << 30
"""Space that is left on the disk for the results themselves."""

_MAGIC = b"crankorder frames 1\n"
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

    def load(self, key: str) -> RecordingResult | None:
        """What was kept under ``key``; None where nothing is, or where it is damaged."""
        try:
            return _unpacked(self.path(key).read_bytes())
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def save(self, key: str, result: RecordingResult) -> None:
        """Keep ``result`` under ``key``; where the disk is nearly full or it cannot be kept, do without."""
        with contextlib.suppress(OSError, TypeError):
            self.folder.mkdir(parents=True, exist_ok=True)
            if shutil.disk_usage(self.folder).free < LEAST_FREE_BYTES:
                return
            handle, temporary = tempfile.mkstemp(dir=self.folder, suffix=".part")
            try:
                with os.fdopen(handle, "wb") as stream:
                    stream.writelines(_packed(result))
                Path(temporary).replace(self.path(key))
            except BaseException:
                Path(temporary).unlink(missing_ok=True)
                raise

    def keep_only(self, keys: Iterable[str]) -> None:
        """Remove all but the results under ``keys``: what the test no longer asks for."""
        kept = {self.path(key).name for key in keys}
        with contextlib.suppress(OSError):
            for path in self.folder.iterdir():
                if path.name not in kept:
                    path.unlink(missing_ok=True)


def clean(out: Path) -> tuple[int, int]:
    """Number and bytes of the kept files that were removed from the folder of results ``out``."""
    files = [path for path in (out / STORE).rglob("*") if path.is_file()]
    size = sum(path.stat().st_size for path in files)
    if (out / STORE).is_dir():
        shutil.rmtree(out / STORE)
    return len(files), size


def settings_of_recordings(settings: Settings) -> dict[str, Any]:
    """Those of the ``settings`` that what a recording gives depends on: all but how a report looks."""
    return settings.model_dump(mode="json", exclude={"report"})


def _packed(result: RecordingResult) -> list[bytes]:
    """Pieces of a file: magic, digest, length of the header, header, arrays. TypeError where it cannot be kept."""
    arrays: list[NDArray[Any]] = []
    named = {"": result.shaft, **{noun.__name__: frames for noun, frames in result.frames.items()}}
    header = json.dumps({name: _described(dataset, arrays) for name, dataset in named.items()}).encode()
    header += b" " * (-len(header) % _ALIGNED)
    pieces: list[bytes] = [len(header).to_bytes(_LENGTH_BYTES, "little"), header]
    for array in arrays:
        pieces += [array.tobytes(), b"\0" * (-array.nbytes % _ALIGNED)]
    digest = hashlib.sha256()
    for piece in pieces:
        digest.update(piece)
    return [_MAGIC, digest.digest(), *pieces]


def _described(dataset: xr.Dataset, arrays: list[NDArray[Any]]) -> dict[str, Any]:
    """Header of ``dataset``, whose arrays join ``arrays``."""
    variables = [
        [str(name), list(variable.dims), _array(variable.values, arrays), _attrs(variable.attrs, arrays)]
        for name, variable in dataset.variables.items()
    ]
    coords = [str(name) for name in dataset.coords]
    return {"variables": variables, "coords": coords, "attrs": _attrs(dataset.attrs, arrays)}


def _attrs(attrs: dict[Any, Any], arrays: list[NDArray[Any]]) -> list[Any]:
    """``attrs`` in their order, with what JSON has no word for named by its kind."""
    made = []
    for name, value in attrs.items():
        if isinstance(value, np.generic | np.ndarray):
            made.append([str(name), "array" if isinstance(value, np.ndarray) else "scalar", _array(value, arrays)])
        else:
            made.append([str(name), "tuple" if isinstance(value, tuple) else "plain", value])
    return made


def _array(values: Any, arrays: list[NDArray[Any]]) -> list[Any]:
    array = np.asarray(values)
    if array.dtype.hasobject:
        raise TypeError("objects are not kept")
    arrays.append(array)
    return [array.dtype.str, list(array.shape), array.nbytes]


def _unpacked(data: bytes) -> RecordingResult:
    """What :func:`_packed` packed. ValueError where it is not that, to the last byte."""
    begin = len(_MAGIC) + _DIGEST_BYTES
    if data[: len(_MAGIC)] != _MAGIC or hashlib.sha256(memoryview(data)[begin:]).digest() != data[len(_MAGIC) : begin]:
        raise ValueError("damaged")
    place = begin + _LENGTH_BYTES
    length = int.from_bytes(data[begin:place], "little")
    header = json.loads(data[place : place + length])
    arrays = _Arrays(bytearray(memoryview(data)[place + length :]))
    datasets = {name: _dataset(described, arrays) for name, described in header.items()}
    nouns = {noun.__name__: noun for noun in FRAMES_OF.values()}
    return RecordingResult(ShaftAngle(datasets.pop("")), {nouns[name]: dataset for name, dataset in datasets.items()})


class _Arrays:
    """Arrays that lie one behind the other, taken in their order."""

    def __init__(self, memory: bytearray) -> None:
        self._memory, self._place = memory, 0

    def take(self, kind: str, shape: list[int], size: int) -> NDArray[Any]:
        """The next array, of ``size`` bytes."""
        count = int(np.prod(shape, dtype=np.int64))
        array = np.frombuffer(self._memory, dtype=np.dtype(kind), count=count, offset=self._place) if count else None
        self._place += -(-size // _ALIGNED) * _ALIGNED
        return np.empty(shape, np.dtype(kind)) if array is None else array.reshape(shape)


def _dataset(described: dict[str, Any], arrays: _Arrays) -> xr.Dataset:
    variables = {}
    for name, dims, array, attrs in described["variables"]:
        values = arrays.take(*array)
        variables[name] = xr.Variable(dims, values, _attrs_of(attrs, arrays))
    made = xr.Dataset(variables, attrs=_attrs_of(described["attrs"], arrays))
    return made.set_coords(described["coords"])


def _attrs_of(described: list[Any], arrays: _Arrays) -> dict[str, Any]:
    made: dict[str, Any] = {}
    for name, kind, value in described:
        if kind in ("plain", "tuple"):
            made[name] = tuple(value) if kind == "tuple" else value
        else:
            array = arrays.take(*value)
            made[name] = array if kind == "array" else array[()]
    return made
