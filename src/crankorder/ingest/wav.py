"""WAV and RF64 files, with the calibration that an ``LEA`` chunk states.

The chunks are walked here and not by a library: a truncated file must be told from a whole one, the chunk after the
samples holds the calibration, and scipy's reader speaks of it through ``warnings``, which is not safe in threads.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from crankorder.errors import InputError, UnsafeInputError, printable
from crankorder.ingest.rawfile import (
    Contents,
    Described,
    RawFile,
    Source,
    check_budget,
    flag,
    names_of,
    part_of,
    rows_for,
)
from crankorder.quantities import QualityFlag
from crankorder.scratch import blocks
from crankorder.settings import IngestSettings

_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
# below this share of the declared samples a cut recording is refused, above it it is used and flagged
_MIN_PRESENT = 0.9
_COPY, _EXPORT, _LEAVE_OUT = "Copy it again", "Export it again", "Leave it out"
_LEA = b"LEA "
_ONCE = (b"fmt ", b"data", b"ds64", _LEA)
_MOST_OF_CHUNK = 1_000_000
# lengths so near below 2 and 4 GiB stand where a program that streams cannot know them (0x7FFFF000, 0xFFFFFFDB, …)
_NEARLY = 8192
_UNKNOWN_FROM = (1 << 31) - _NEARLY
_IN_DS64 = 0xFFFFFFFF
_SPEAKS_OF_SCALE = re.compile(
    rb"[^<>\n]{0,20}(calib|sensitiv|full.?scale|scale.?factor|mV/|V/(Pa|g|EU|\(?m/s)|kalib|empfindlich)[^<>\n]{0,20}",
    re.I,
)
# so many bytes behind the samples are looked through for a calibration that no chain of chunks leads to
_TAIL_BYTES = 4_000_000


class _Channel(NamedTuple):
    """What a calibration says of a channel: its name, its unit, and the ``scale`` of a full-scale sample in that."""

    name: str
    unit: str = "FS"
    scale: float = 1.0


class _Layout(NamedTuple):
    """How the samples lie, as a ``fmt`` chunk says."""

    n_channels: int
    rate_hz: int
    byte_rate: int
    frame_bytes: int
    n_bits: int
    is_float: bool


class _Header(NamedTuple):
    layout: _Layout
    data_start: int
    n_present: int
    channels: tuple[_Channel, ...]
    flags: list[QualityFlag]


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings, rows: slice | None = None) -> RawFile:
    """Channels that ``sources`` ask for (number from 0, or calibration name) from the WAV file at ``path``.

    Integer samples become fractions of full scale (-1 to 1), times the calibration where the file has one; ``settings``
    give the byte limit; ``rows``: of its samples, None for all. Raises InputError for a truncated or damaged file.
    """
    header = _header_of(path, settings)
    layout, all_names = header.layout, [channel.name for channel in header.channels]
    names = names_of(sources, all_names, path)
    check_budget(header.n_present * layout.n_channels * 8, settings)
    wanted = part_of(header.n_present, rows)
    wide = layout.n_bits == 64 or (layout.n_bits == 32 and not layout.is_float)
    kind = (wanted.stop - wanted.start, np.float64 if wide else np.float32)
    room = rows_for([kind] * len(names), in_memory_bytes=settings.in_memory_bytes)
    full_scale = 1.0 if layout.is_float else 2.0 ** (layout.n_bits - 1)
    with path.open("rb") as stream:
        stream.seek(header.data_start + wanted.start * layout.frame_bytes)
        for part in blocks(kind[0] if names else 0):
            frames = _decoded(stream.read((part.stop - part.start) * layout.frame_bytes), layout)
            for row, number in zip(room, map(all_names.index, names.values()), strict=True):
                row[part] = frames[:, number]
                if layout.n_bits == 8:
                    row[part] -= 128.0
                row[part] *= header.channels[number].scale / full_scale
    stated = {each.name: Described(header.n_present, each.unit, float(layout.rate_hz)) for each in header.channels}
    return Contents.of("WAV", stated).with_columns(names, room, flags=header.flags)


def _header_of(path: Path, settings: IngestSettings) -> _Header:
    size = path.stat().st_size
    layout, found = b"", _Notes()
    start, length, is_open = -1, 0, False
    with path.open("rb") as stream:
        declared = _head(stream, 0)[1] + 8
        for number, (name, begin, n_bytes) in enumerate(_chunks(stream, size, declared)):
            if number > settings.max_objects:
                raise UnsafeInputError(f"holds more than {settings.max_objects} chunks", remedy=_LEAVE_OUT)
            if name in _ONCE and name in found.seen:
                problem, place = f"holds two chunks {name.decode()!r}, of which one is allowed", f"byte {begin - 8}"
                raise InputError(problem, place=place, found=f"{n_bytes} bytes more", remedy=_EXPORT)
            found.seen.add(name)
            if name == b"data":
                start, length = begin, n_bytes
                if is_open := not _is_filled_in(stream, start, length, size):
                    break
            elif begin + n_bytes > size and (start < 0 or name == _LEA):
                raise InputError(f"truncated: {size} of {begin + n_bytes} bytes", remedy=_COPY)
            elif name == b"fmt ":
                layout = stream.read(min(n_bytes, 64))
            else:
                found.look_into(name, stream.read(min(n_bytes, _MOST_OF_CHUNK)))
        if len(layout) < 16 or start < 0 or (length == 0 and not is_open):
            raise InputError(f"truncated: {size} bytes hold no samples", remedy=_COPY)
        stray = None if _LEA in found.seen else _stray_chunk(stream, start if is_open else start + length, size)
    if stray is not None:
        found.look_into(_LEA, stray[1])
    if is_open:
        length = (size if stray is None else stray[0]) - start
    elif start + length <= size < declared - 1 < _UNKNOWN_FROM:  # the last byte may be that which fills up an odd chunk
        raise InputError(f"truncated after the samples: {size} of {declared} bytes", remedy=_COPY)
    return _checked(path, _layout_of(layout), start, (length, min(length, size - start)), found, is_open=is_open)


def _is_filled_in(stream: BinaryIO, start: int, length: int, size: int) -> bool:
    """Whether ``length`` of the samples, which begin at ``start``, is what a writer knew: who streams never does."""
    if length == 0:
        return start >= size or _is_chunk(stream, start, size)
    return start + length <= size or not any(0 < full - length <= _NEARLY for full in (1 << 31, 1 << 32))


def _chunks(stream: BinaryIO, size: int, declared: int) -> Iterator[tuple[bytes, int, int]]:
    """Name, first byte and length of each chunk of a file of ``size`` bytes, the ``stream`` standing at its first byte.

    Some programs leave out the byte that fills up an odd chunk, and write the calibration behind the end of the file
    that they have ``declared``: of what stands there that alone is a chunk. Lengths of 64 bits (RF64) stand in a chunk
    of their own.
    """
    position, is_behind_samples = 12, False
    long: dict[bytes, int] = {}
    while position + 8 <= size:
        name, length = _head(stream, position)
        if position >= declared and name != _LEA and is_behind_samples:
            return
        length = long.get(name, length) if length == _IN_DS64 else length
        stream.seek(position + 8)
        if name == b"ds64":
            long = _long_lengths(stream.read(min(length, _MOST_OF_CHUNK)))
            stream.seek(position + 8)
        yield name, position + 8, length
        is_behind_samples |= name == b"data"
        end = position + 8 + length
        filled = length % 2 and (_is_chunk(stream, end + 1, size) or not _is_chunk(stream, end, size))
        position = end + bool(filled)


def _long_lengths(chunk: bytes) -> dict[bytes, int]:
    """Lengths by name of the chunks of an RF64 file (EBU Tech 3306) whose own fields are too small for them."""
    if len(chunk) < 28:
        return {}
    found = {b"data": struct.unpack_from("<Q", chunk, 8)[0]}
    count = min(struct.unpack_from("<I", chunk, 24)[0], (len(chunk) - 28) // 12)
    return found | dict(struct.iter_unpack("<4sQ", chunk[28 : 28 + 12 * count]))


def _head(stream: BinaryIO, position: int) -> tuple[bytes, int]:
    stream.seek(position)
    name, length = struct.unpack("<4sI", stream.read(8).ljust(8, b"\0"))
    return name, length


def _is_chunk(stream: BinaryIO, position: int, size: int) -> bool:
    """Whether a chunk that the file holds begins at ``position``, as its name and length tell."""
    if position + 8 > size:
        return False
    name, length = _head(stream, position)
    return all(32 <= octet < 127 for octet in name) and name[:1].isalpha() and position + 8 + length <= size + 1


def _stray_chunk(stream: BinaryIO, begin: int, size: int) -> tuple[int, bytes] | None:
    """First byte and content of a chunk of calibrations behind ``begin``, to which no other chunk leads."""
    if begin >= size:
        return None
    begin = max(begin, size - _TAIL_BYTES)
    stream.seek(begin)
    tail = stream.read(_TAIL_BYTES)
    place = tail.find(_LEA)
    if place < 0 or len(tail) < place + 8:
        return None
    end = place + 8 + struct.unpack_from("<I", tail, place + 4)[0]
    return (begin + place, tail[place + 8 : end]) if end <= len(tail) else None


@dataclass(slots=True)
class _Notes:
    """What the chunks beside the samples say of a calibration."""

    channels: tuple[_Channel, ...] = ()
    seen: set[bytes] = field(default_factory=set)
    doubts: list[str] = field(default_factory=list)

    def look_into(self, name: bytes, chunk: bytes) -> None:
        """Take the calibrations of the ``chunk``, or note that it speaks of one that is not understood."""
        shown = printable(name.decode("latin-1").strip(), 8)
        if name == _LEA:
            try:
                self.channels = _calibrations(chunk)
            except ValueError as error:
                self.doubts.append(f"its calibration (chunk {shown}) is not understood: {error}")
        elif (word := _SPEAKS_OF_SCALE.search(chunk.replace(b"\0", b""))) is not None:
            spoken = printable(word[0].decode("latin-1"), 60)
            self.doubts.append(f"its chunk {shown} speaks of a calibration that is not read: {spoken!r}")


def _layout_of(chunk: bytes) -> _Layout:
    """The layout that a ``fmt`` chunk states, of those that are read."""
    code, n_channels, rate_hz, byte_rate, frame_bytes, n_bits = struct.unpack_from("<HHIIHH", chunk)
    if code == _EXTENSIBLE and len(chunk) >= 26:
        code = struct.unpack_from("<H", chunk, 24)[0]
    if n_bits not in {_PCM: (8, 16, 24, 32), _FLOAT: (32, 64)}.get(code, ()):
        allowed, found = "8, 16, 24 or 32-bit integers, 32 or 64-bit floats", f"format code {code} with {n_bits} bits"
        remedy = "Export as 16-bit or float WAV"
        raise InputError("the sample format is not supported", found=found, allowed=allowed, remedy=remedy)
    if not (n_channels and rate_hz and frame_bytes == n_channels * n_bits // 8):
        found = f"{n_channels} channels of {n_bits} bits at {rate_hz} Hz in frames of {frame_bytes} bytes"
        raise InputError("the header contradicts itself", found=found)
    return _Layout(n_channels, rate_hz, byte_rate, frame_bytes, n_bits, code == _FLOAT)


def _checked(
    path: Path, layout: _Layout, data_start: int, n_bytes: tuple[int, int], found: _Notes, *, is_open: bool
) -> _Header:
    """The header of a file of whose samples ``n_bytes`` are declared and present; what is ``is_open`` was streamed."""
    n_channels, frame_bytes, channels, doubts = layout.n_channels, layout.frame_bytes, found.channels, found.doubts
    n_declared, n_present = (count // frame_bytes for count in n_bytes)
    if n_bytes[1] < _MIN_PRESENT * n_bytes[0]:
        raise InputError(f"truncated: {n_present} of {n_declared} samples", remedy=_COPY)
    if channels and len(channels) != n_channels:
        doubts.append(f"its calibration (LEA chunk) is for {len(channels)} channels, the samples have {n_channels}")
        channels = ()
    faults: dict[str, str] = {}
    if n_present < n_declared or is_open:
        lacks = f"its writer did not fill in how many samples there are: {n_present} are there, and more may be lost"
        faults["missing_data"] = lacks if is_open else f"truncated: {n_present} of {n_declared} samples"
    if layout.byte_rate not in (0, layout.rate_hz * frame_bytes):
        other = f"{layout.byte_rate} bytes per second, which are {layout.byte_rate / frame_bytes:.6g} Hz"
        faults["header_rate_disagrees"] = f"the header states {layout.rate_hz} Hz, and {other}; the first is taken"
    if doubts and not channels:
        shown = "; ".join(doubts[:3])
        faults["calibration_unknown"] = f"{shown}: levels are fractions of full scale; state a sensitivity"
    flags = [flag(path, name, "suspect", detail) for name, detail in faults.items()]
    channels = channels or (_Channel(""),) * n_channels
    names = {channel.name for channel in channels}
    if len(names) < n_channels or "" in names:
        channels = tuple(channel._replace(name=str(number)) for number, channel in enumerate(channels))
    return _Header(layout, data_start, n_present, channels, flags)


def _calibrations(chunk: bytes) -> tuple[_Channel, ...]:
    """Calibrations of an ``LEA`` chunk, decoded from recordings of which the physical values are known.

    Per channel: ``le`` and two digits, length, float32 full scale, name and unit (each a length and its characters),
    float32 offset (0 wherever seen), float32 factor. Raises ValueError saying what is not so.
    """
    found: list[_Channel] = []
    position = 0
    try:
        while position + 8 <= len(chunk) and chunk[position : position + 2] == b"le":
            length = struct.unpack_from("<I", chunk, position + 4)[0]
            record = chunk[position + 8 : position + 8 + length]
            full_scale, n_name = struct.unpack_from("<fH", record)
            n_unit = struct.unpack_from("<H", record, 6 + n_name)[0]
            offset, factor = struct.unpack_from("<ff", record, 8 + n_name + n_unit)
            name, unit = record[6 : 6 + n_name], record[8 + n_name : 8 + n_name + n_unit]
            scale = float(np.float64(full_scale) * np.float64(factor))
            if offset != 0.0 or not (np.isfinite(scale) and scale > 0):
                stated = f"full scale {full_scale:g}, offset {offset:g}, factor {factor:g}"
                raise ValueError(f"channel {len(found)} has {stated}")
            found.append(_Channel(name.decode("latin-1"), unit.decode("latin-1"), scale))
            position += 8 + length
    except struct.error:
        raise ValueError(f"the record of channel {len(found)} is cut short") from None
    if not found:
        raise ValueError(f"begins with {printable(chunk[:8].decode('latin-1'), 20)!r}")
    return tuple(found)


def _decoded(data: bytes, layout: _Layout) -> np.ndarray[Any, np.dtype[Any]]:
    """Samples (frame, channel) in the file's own type; 24-bit integers widen to 32."""
    if layout.n_bits == 24:
        wide = np.pad(np.frombuffer(data, np.uint8).reshape(-1, 3), ((0, 0), (1, 0)))
        return (wide.view("<i4") >> 8).reshape(-1, layout.n_channels)
    kind = "f" if layout.is_float else "u" if layout.n_bits == 8 else "i"
    return np.frombuffer(data, f"<{kind}{layout.n_bits // 8}").reshape(-1, layout.n_channels)
