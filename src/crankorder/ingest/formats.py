"""Which format a file has, told by its content, and the reader for it."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from crankorder.errors import EnvironmentFailure, InputError, UnsafeInputError, located
from crankorder.ingest.folder import check_regular
from crankorder.ingest.rawfile import HDF5_SIGNATURE, Contents, RawFile, Source
from crankorder.settings import IngestSettings

UFF_SIGN = rb"\s{0,8}-1[ \t]*\r?\n\s{0,8}[0-9]{1,4}b?[ \t\r\n]"
"""First two lines of a universal file."""
HDF5_SUFFIXES = (".h5", ".hdf5", ".nc", ".nc4")
_BINARY_SUFFIXES = (*HDF5_SUFFIXES, ".hdf", ".wav", ".xlsx", ".mat", ".mf4", ".mdf", ".tdms", ".ide", ".npy", ".dat")
_HEAD_BYTES = 8192
# what the first bytes say, and what to do with a format that is not read
_EXPORT, _COPY = "Export the recording to HDF5, WAV or text", "Copy it again"
_IN_DEWESOFT = "Export it in DewesoftX as MDF4, TDMS, UFF58 or MATLAB"
_IN_CONCERTO = "Export it in Concerto or IndiCom as MDF4, MATLAB or text"
_IN_ARTEMIS = "Export it in ArtemiS as UFF58, WAV, MATLAB or text"
_HEAD_SIGN = rb"(?s)start of data\s*:.*(channel definition|delta value|n(umber|br) of (scans|channels?))"
# kind of numbers, rows, columns, whether complex, length of the name, name: in either order of bytes
_MATLAB_4 = (
    rb"(?s)\A([\0-\x34]\0{3}.{8}[\0\1]\0{3}[\x02-\xff]\0{3}|\0\0[\3\4].{9}\0{3}[\0\1]\0{3}[\x02-\xff])[A-Za-z]\w*\0"
)
_UNREAD: tuple[tuple[bytes | tuple[bytes, ...], str, str], ...] = (
    (b"UnFinMF ", "an MDF4 file that its writer never finished", f"not supported yet. {_EXPORT}"),
    (b"MDF     3", "an MDF3 file", "not supported. Save it as MDF4"),
    (b"MDF     2", "an MDF2 file", "not supported. Save it as MDF4"),
    ((b"CDF\x01", b"CDF\x02", b"CDF\x05"), "a NetCDF-3 file", "not supported. Convert it with `nccopy -k nc4`"),
    (b"\x0e\x03\x13\x01", "an HDF4 file", "not HDF5, not supported. Convert it with `h4toh5`"),
    (b"RIFX", "a big-endian RIFF file", f"not supported yet. {_EXPORT}"),
    (b"fLaC", "a FLAC file", f"not supported yet. {_EXPORT}"),
    (b"OggS", "an Ogg file", "lossy and not supported. Export the original"),
    (b"MULTI_STREAM_FILE", "a Dewesoft file", f"not supported. {_IN_DEWESOFT}"),
    (b"\x1f\x8b", "a gzip archive", "not a recording. Unpack it"),
    (b"BZh", "a bzip2 archive", "not a recording. Unpack it"),
    (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive", "not a recording. Unpack it"),
    (b"%PDF", "a PDF document", f"not a recording. {_EXPORT}"),
    (b"\xd0\xcf\x11\xe0", "an old Excel or Office document", "not supported. Save it as XLSX or text"),
    (b"\x89PNG", "a PNG picture", "not a recording. Take it out of [recordings]"),
    (b"PAR1", "a Parquet file", f"not supported. {_EXPORT}"),
    (b"Rar!", "a RAR archive", "not a recording. Unpack it"),
    ((b"\xff\xfe", b"\xfe\xff"), "UTF-16 text", "not supported. Save it as UTF-8"),
)
# signs in the head of binary files that have no signature to begin with
_UNREAD_SIGNS: tuple[tuple[bytes, str, str], ...] = (
    (_HEAD_SIGN, "a HEAD acoustics file", f"not HDF5, not supported. {_IN_ARTEMIS}"),
    (_MATLAB_4, "a MATLAB 4 file", "not supported. Load it in MATLAB and save it with `save -v7`"),
    (rb"(?i)dewesoft", "a Dewesoft file", f"not supported. {_IN_DEWESOFT}"),
    (rb"(?i)\bAVL\b|\bI-?FILE\b|IndiCom", "an AVL IFile", f"not supported. {_IN_CONCERTO}"),
)


class Format(NamedTuple):
    """A format that is read: its ``name``, its ``reader`` (``module.function`` of this room) and its recognition.

    ``told_by`` takes the file's path and first bytes. The reader (path, sources, settings → RawFile) is imported when
    it is needed, and its errors need not name the file; asked for no sources it reads no samples and tells what the
    file holds. ``by_rows`` says whether some samples can be read alone, at their cost only.
    """

    name: str
    reader: str
    told_by: Callable[[Path, bytes], bool]
    by_rows: bool = False

    def read(self, path: Path, **asked: Any) -> RawFile:
        """Result of the reader for the file at ``path`` with the arguments ``asked``."""
        module, _, function = self.reader.rpartition(".")
        raw: RawFile = getattr(import_module(f"crankorder.ingest.{module}"), function)(path, **asked)
        return raw


def _begins(signature: bytes) -> Callable[[Path, bytes], bool]:
    return lambda path, head: head.startswith(signature)


def _is_hdf5(path: Path, head: bytes) -> bool:
    return any(head[start : start + 8] == HDF5_SIGNATURE for start in (0, 512, 1024, 2048, 4096))


def _is_wav(path: Path, head: bytes) -> bool:
    return head.startswith((b"RIFF", b"RF64", b"BW64")) and (head[8:12] == b"WAVE" or len(head) < 12)


def _is_xlsx(path: Path, head: bytes) -> bool:
    if not head.startswith(b"PK\x03\x04"):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            is_workbook = "xl/workbook.xml" in archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):  # what zipfile raises on damaged directories
        problem = "truncated or damaged: a zip or XLSX file without its directory"
        raise InputError(problem, file=path, remedy=_COPY) from None
    if not is_workbook:
        _refuse(path, "a zip archive", "not a recording. Unpack it")
    return True


def _is_ide(path: Path, head: bytes) -> bool:
    if not head.startswith(b"\x1aE\xdf\xa3"):
        return False
    if b"mide" not in head[:256]:
        _refuse(path, "an EBML file (such as a video)", f"not supported. {_EXPORT}")
    return True


FORMATS = (
    # before MATLAB, whose version 7.3 is HDF5 behind MATLAB's header
    Format("HDF5", "hdf5.read", _is_hdf5, by_rows=True),
    Format("WAV", "wav.read", _is_wav, by_rows=True),
    Format("MATLAB", "matlab.read", _begins(b"MATLAB 5.0 MAT-file")),
    Format("NumPy", "numpy_file.read", _begins(b"\x93NUMPY"), by_rows=True),
    Format("LVM", "lvm.read", _begins(b"LabVIEW Measurement")),
    Format("XLSX", "text.read_xlsx", _is_xlsx),
    Format("UFF", "uff.read", lambda path, head: re.match(UFF_SIGN, head) is not None),
    Format("TDMS", "loggers.read_tdms", _begins(b"TDSm")),
    Format("MDF4", "loggers.read_mdf", _begins(b"MDF     4")),
    Format("IDE", "loggers.read_ide", _is_ide),
)
"""Formats with a sign of their own, in the order in which they are tried; the rest is text, or refused."""

TEXT = Format("text", "text.read", lambda path, head: True)


def read_file(path: Path, *, sources: Sequence[Source], settings: IngestSettings, rows: slice | None = None) -> RawFile:
    """Columns of the file at ``path`` that ``sources`` ask for, by whatever reader fits its content.

    Columns are (samples,). ``settings`` limit what is read; ``rows`` selects samples, None for all (only of a format
    that can be read by rows). Raises InputError where the file is damaged or lacks a source, UnsafeInputError where
    reading it would exceed limits, EnvironmentFailure where a package or the permission is missing.
    """
    some = {} if rows is None else {"rows": rows}
    known = format_of(path)
    with located(path):
        try:
            return known.read(path, sources=sources, settings=settings, **some)
        except MemoryError:
            remedy = "Split the recording, or run where there is more memory"
            raise UnsafeInputError("does not fit into memory", remedy=remedy) from None


def contents_of(path: Path, *, settings: IngestSettings) -> Contents:
    """Contents of the file at ``path``, read cheaply: names, units and rates, without the samples.

    ``settings`` limit what is read. Raises InputError where the file holds no channel of numbers, and the errors of
    :func:`read_file`.
    """
    contents = read_file(path, sources=(), settings=settings).contents
    if not contents.names:
        raise InputError("holds no channel of numbers", file=path, remedy="Export the recording again")
    return contents


def format_of(path: Path) -> Format:
    """Format of the file at ``path``, told by its content and never by its name.

    Raises InputError, which says what the file really is, where it is none of the formats that are read, is empty or
    cannot be read; UnsafeInputError where opening it could run code; EnvironmentFailure without permission to read it.
    """
    check_regular(path)
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except PermissionError:
        raise EnvironmentFailure("no permission to read", file=path, remedy="Change its permissions") from None
    except OSError as error:
        raise InputError("cannot be read", file=path, found=error) from None
    if size == 0:
        raise InputError("truncated: the file is empty (0 bytes)", file=path, remedy=_COPY)
    for signature, kind, advice in _UNREAD:
        if head.startswith(signature):
            _refuse(path, kind, advice)
    for known in FORMATS:
        if known.told_by(path, head):
            return known
    _refuse_by_suspicion(path, head, size)
    return TEXT


def _refuse(path: Path, kind: str, advice: str) -> NoReturn:
    problem, _, remedy = advice.partition(". ")
    raise InputError(f"is {kind}: {problem}", file=path, remedy=remedy)


def _refuse_by_suspicion(path: Path, head: bytes, size: int) -> None:
    """Refuse what has no signature of its own but is certainly no table of numbers."""
    suffix = path.suffix.lower()
    for sign, kind, advice in _UNREAD_SIGNS:
        if re.search(sign, head) and (b"\0" in head or suffix == ".hdf"):
            _refuse(path, kind, advice)
    if not head.strip(b"\0"):
        raise InputError(f"holds only zeros (in its first {len(head)} bytes)", file=path, remedy=_COPY)
    if size < 12 and (HDF5_SIGNATURE.startswith(head[:8]) or b"RIFF".startswith(head[:4])):
        raise InputError(f"truncated: only {size} bytes are left", file=path, remedy=_COPY)
    if re.match(rb"\x80[\x02-\x05]", head):
        raise UnsafeInputError("is a Python pickle, which can run code: never opened", file=path, remedy=_EXPORT)
    if re.match(rb"(\xef\xbb\xbf)?\s*<(!doctype html|html|\?xml|svg)", head, re.IGNORECASE):
        _refuse(path, "an HTML or XML page", "not a recording. Download the file itself: this may be an error page")
    if suffix == ".hdf":
        _refuse(path, "not HDF5 (HEAD .hdf is a format of its own)", "not supported. Export UFF58, WAV or HDF5")
    if b"\0" in head:
        problem = f"content is not known (not {', '.join(known.name for known in FORMATS)} or text)"
        raise InputError(problem, file=path, found=f"first bytes {head[:8].hex(' ')}", remedy=_EXPORT)
    if suffix in _BINARY_SUFFIXES:
        remedy = "Copy the recording again, or rename it"
        raise InputError(f"is text, though its name ends in {suffix}", file=path, remedy=remedy)
