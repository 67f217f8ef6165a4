"""The recordings of a test-run folder: which files belong to it, and whether lists of checksums know them otherwise."""

from __future__ import annotations

import difflib
import errno
import fnmatch
import glob
import hashlib
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from crankorder.errors import (
    MOST_TOLD,
    CrankorderError,
    EnvironmentFailure,
    InputError,
    NoUsableRecordingError,
    RequestError,
    UnsafeInputError,
    printable,
)
from crankorder.ingest.encoder_table import NAMED_PART
from crankorder.ingest.manifest import MANIFEST_NAME, Manifest, parts_of

_LEFTOVER = re.compile(
    r"\..*|.*~|~\$.*|.*\.(part|partial|tmp|temp|crdownload|filepart|download|swp|bak|lock)|thumbs\.db|desktop\.ini",
    re.IGNORECASE,
)
_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket"}
_KINDS |= {stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}
_COMPANIONS = (MANIFEST_NAME, "truth.json")


class Folder(NamedTuple):
    """Recordings of one folder in natural order, faults of others that were asked for, and what was passed over."""

    paths: list[Path]
    faults: list[CrankorderError]
    ignored: list[str]


def is_leftover(name: str) -> bool:
    """Whether a file ``name`` is what an editor, a copy program or a file manager leaves behind."""
    return _LEFTOVER.fullmatch(name) is not None


def is_companion(name: str) -> bool:
    """Whether a file ``name`` goes with recordings and holds none: a manifest, a truth, a list of checksums."""
    return name in _COMPANIONS or bool(_LIST.fullmatch(name) or _OF_BAG.fullmatch(name))


def natural_key(path: Path) -> list[tuple[int, int, str]]:
    """Sort key of ``path`` that puts ``rpm_300`` before ``rpm_2000``."""
    parts = re.findall(r"[0-9]{1,18}|[^0-9]+|[0-9]+", path.as_posix())
    return [(0, int(part), "") if part.isdecimal() and part.isascii() else (1, 0, part) for part in parts]


def recordings_of(folder: Path, manifest: Manifest) -> Folder:
    """Recordings that ``manifest`` names in ``folder``: each a regular file inside it, in natural order.

    A named file that is missing, unsafe or not a regular file is a fault of its own, so that the others go on.
    Raises NoUsableRecordingError where nothing at all was found.
    """
    chosen: dict[Path, None] = {}
    faults: list[CrankorderError] = []
    ignored, untold = set[str](), 0
    for pattern in manifest.recordings.files:
        if len(faults) >= MOST_TOLD and not glob.has_magic(pattern) and not os.path.lexists(f"{folder}/{pattern}"):
            untold += 1
            continue
        with collected(faults):
            for path in _matches(folder, pattern):
                with collected(faults):
                    if is_leftover(path.name):
                        ignored.add(path.name)
                    elif path not in chosen and (not is_companion(path.name) or pattern == path.name):
                        check_regular(path, folder)
                        chosen[path] = None
    pulses = {path: manifest.pulses_of(path) for path in chosen}
    _refuse_shared(pulses, manifest, folder)
    for path in [path for path in chosen if path in pulses.values() and pulses[path] != path]:
        del chosen[path]  # the pulses of another recording are none of their own
    if untold:
        faults.append(InputError(f"and {untold} more files that are not there", file=folder, remedy="Mend these first"))
    if not chosen and not faults:
        problem = "no recording found; looked for " + ", ".join(manifest.recordings.files)
        remedy = "Mend [recordings] files, or give the right folder"
        raise NoUsableRecordingError(problem, file=folder, found=_listing(folder), remedy=remedy)
    faults += _unused_speeds(manifest, chosen, folder)
    return Folder(sorted(chosen, key=natural_key), faults, sorted(ignored))


@contextmanager
def collected(faults: list[CrankorderError]) -> Iterator[None]:
    """Append a CrankorderError that is raised within to ``faults``, instead of raising it."""
    try:
        yield
    except CrankorderError as error:
        faults.append(error)


def _refuse_shared(pulses: Mapping[Path, Path | None], manifest: Manifest, folder: Path) -> None:
    """Refuse a pattern with named parts by which two recordings have one file of pulses."""
    if not NAMED_PART.search("".join((manifest.encoder.file or "", *manifest.recordings.files))):
        return
    owners: dict[Path, Path] = {}
    for path, file in sorted(pulses.items(), key=lambda pair: natural_key(pair[0])):
        if file is not None and owners.setdefault(file, path) != path:
            found = f"{file.name} for {owners[file].name}, {path.name}"
            remedy = "Write every part in which the names of the recordings differ into encoder.file too"
            problem = "two recordings share one file of pulses"
            raise RequestError(problem, file=folder, place="encoder.file", found=found, remedy=remedy)


def _unused_speeds(manifest: Manifest, paths: Iterable[Path], folder: Path) -> Iterator[RequestError]:
    """Speeds that the manifest states for files that are not there: likely a misspelt name."""
    known = {manifest.name_of(path) for path in paths}
    for name in (name for name in manifest.recordings.speed_rpm if name not in known):
        close = difflib.get_close_matches(name, sorted(known), n=1)
        remedy = f"Did you mean {close[0]!r}?" if close else "Remove it or mend its spelling"
        place = f"recordings.speed_rpm.{name}"
        yield RequestError("a speed is stated for no recording", file=folder, place=place, remedy=remedy)


def check_regular(path: Path, folder: Path | None = None) -> None:
    """Refuse anything but a regular file inside ``folder``, without opening it: a pipe would hang for ever.

    ``path`` may be a symbolic link that stays inside ``folder``; where ``folder`` is None links are not checked.
    Raises InputError or UnsafeInputError saying what ``path`` is.
    """
    try:
        if folder is not None and not path.resolve(strict=True).is_relative_to(folder.resolve(strict=True)):
            remedy = "Copy the file into the folder"
            raise UnsafeInputError("outside the run folder", file=path, found=path.resolve(), remedy=remedy)
        mode = path.stat().st_mode
    except FileNotFoundError:
        problem = "a link to nothing" if path.is_symlink() else "no such file"
        raise InputError(problem, file=path, remedy="Copy the file again, or take it out of [recordings]") from None
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, CrankorderError):
            raise
        if isinstance(error, RuntimeError) or "levels of symbolic links" in str(error):
            raise InputError("a link that leads to itself", file=path) from None
        raise InputError("cannot be reached", file=path, found=error) from None
    if not stat.S_ISREG(mode):
        remedy = "Only regular files are read; take it out of [recordings]"
        raise InputError(f"not a file but {_KINDS.get(stat.S_IFMT(mode), 'something else')}", file=path, remedy=remedy)


def _matches(folder: Path, pattern: str) -> list[Path]:
    try:
        # a name may hold the characters of a pattern, such as "run [2].h5"
        if (folder / pattern).is_symlink() or (folder / pattern).exists():
            return [folder / pattern]
        globbed = NAMED_PART.sub("*", pattern)
        if not re.search(r"[*?\[]", globbed):
            check_regular(folder / pattern)
        paths = folder.glob(globbed)
        return [p for p in paths if globbed == pattern or parts_of(pattern, p.relative_to(folder).as_posix())]
    except PermissionError:
        raise EnvironmentFailure("no permission to read", file=folder, remedy="Change its permissions") from None
    except (OSError, ValueError, NotImplementedError) as error:  # glob: too long, a bad pattern, an absolute one
        if isinstance(error, CrankorderError):
            raise
        if isinstance(error, OSError) and error.errno not in (errno.ENAMETOOLONG, errno.EINVAL):
            problem, remedy = f"the folder cannot be read ({error.strerror or error})", "Check its disk, or copy it"
            raise EnvironmentFailure(problem, file=folder, remedy=remedy) from error
        raise InputError("not a usable name", file=folder, place="recordings.files", found=repr(pattern)) from None


def _listing(folder: Path, limit: int = 8) -> str:
    try:
        names = sorted(item.name for item in folder.iterdir())
    except OSError:
        return "a folder that cannot be listed"
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more if names else "an empty folder"


_SUMS = r"md5|sha1|sha224|sha256|sha384|sha512"
_LIST = re.compile(rf"(?i)manifest-({_SUMS})\.txt|({_SUMS})sums?(?:\.txt)?|checksums?\.({_SUMS})|.+\.({_SUMS})")
_OF_BAG = re.compile(rf"(?i)tagmanifest-({_SUMS})\.txt|bagit\.txt|bag-info\.txt|fetch\.txt")
_LINE = re.compile(r"\\?([0-9A-Fa-f]{32,128})(?:\s+[*?]?(.+))?")
_TAGGED = re.compile(r"[A-Za-z0-9-]+ \((.+)\) ?= ?([0-9A-Fa-f]{32,128})")
_MOST_BYTES = 16_000_000


class Listed(NamedTuple):
    """A file that the list at ``by`` names, with its hexadecimal ``digest`` by an ``algorithm`` of hashlib."""

    path: Path
    algorithm: str
    digest: str
    by: Path


def checksum_faults(
    folder: Path,
    files: Iterable[Path],
    patterns: Sequence[str],
    *,
    sha256_of: Callable[[Path], str | None] | None = None,
) -> list[CrankorderError]:
    """Faults of ``files`` of the test-run folder ``folder`` by lists of checksums beside them.

    A fault is a file whose checksum differs, a listed recording (by ``patterns``) that is missing, and a list that
    cannot be read. ``sha256_of`` gives a SHA-256 that is known already.
    """
    faults: list[CrankorderError] = []
    wanted = {file.resolve(): file for file in files}
    faulty: set[Path] = set()
    for entry in _listed(folder, faults):
        path = entry.path.resolve()
        if path in faulty:
            continue
        if path not in wanted:
            if not entry.path.exists() and _is_asked_for(entry.path, folder, patterns):
                faulty.add(path)
                problem = f"is listed in {entry.by.name} and not there"
                faults.append(InputError(problem, file=entry.path, remedy="Copy it again"))
            continue
        digest = sha256_of(wanted[path]) if sha256_of is not None and entry.algorithm == "sha256" else None
        with suppress(OSError):  # what cannot be read has a fault of its own
            if digest is None:
                with path.open("rb") as stream:
                    digest = hashlib.file_digest(stream, entry.algorithm).hexdigest()
        if digest is not None and digest.lower() != entry.digest.lower():
            faulty.add(path)
            problem = f"its {entry.algorithm.upper()} differs from {entry.by.name}: it was damaged or changed"
            remedy = "Copy it again from where it was recorded; where it was changed on purpose, renew the list"
            digests = {"found": digest[:16] + " …", "allowed": entry.digest[:16] + " …"}
            faults.append(InputError(problem, file=wanted[path], remedy=remedy, **digests))
    return faults


def _is_asked_for(path: Path, folder: Path, patterns: Sequence[str]) -> bool:
    name = path.relative_to(folder).as_posix()
    patterns = [NAMED_PART.sub("*", pattern) for pattern in patterns]
    deep = [pattern for pattern in patterns if "**" in pattern or pattern.count("/") == name.count("/")]
    return name in patterns or any(fnmatch.fnmatchcase(name, pattern) for pattern in deep)


def _listed(folder: Path, faults: list[CrankorderError]) -> Iterator[Listed]:
    """Entries of the lists in ``folder``, and of those of the bag whose payload it is; unreadable lines are faults."""
    above, is_bag = folder.resolve().parent, folder.resolve().name == "data"
    for home in (folder, above) if is_bag and (above / "bagit.txt").is_file() else (folder,):
        for by in sorted(path for path in home.iterdir() if _LIST.fullmatch(path.name) and path.is_file()):
            with collected(faults):
                yield from _entries(by, home, folder)


def _entries(by: Path, home: Path, folder: Path) -> Iterator[Listed]:
    match = _LIST.fullmatch(by.name)
    algorithm = next(kind for kind in match.groups() if kind).lower() if match else ""
    try:
        with by.open("rb") as stream:
            text = stream.read(_MOST_BYTES + 1).decode("utf-8-sig", "surrogateescape")
    except OSError as error:
        raise InputError("cannot be read", file=by, found=error) from None
    if len(text) > _MOST_BYTES:
        raise InputError(f"is no list of checksums: more than {_MOST_BYTES} bytes", file=by)
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.startswith(("#", ";")):
            continue
        tagged, plain = _TAGGED.fullmatch(line.strip()), _LINE.fullmatch(line.strip())
        name, digest = (tagged[1], tagged[2]) if tagged else (plain[2] or by.stem, plain[1]) if plain else ("", "")
        if len(digest) != 2 * hashlib.new(algorithm).digest_size:
            problem, remedy = f"is no {algorithm} checksum", "Write the list again, or remove it"
            raise InputError(problem, file=by, place=f"line {number}", found=printable(line, 60), remedy=remedy)
        if (path := _inside(name.strip(), home, folder)) is not None:
            yield Listed(path, algorithm, digest, by)


def _inside(name: str, home: Path, folder: Path) -> Path | None:
    """Path below ``folder`` of the file that a list in ``home`` calls ``name``; None where it lies elsewhere.

    RFC 8493 writes ends of lines and the percent sign by their codes.
    """
    name = re.sub(r"%(0[AaDd]|25)", lambda code: chr(int(code[1], 16)), name)
    parts = PurePosixPath(name.replace("\\", "/")).parts
    if not parts or name.startswith(("/", "~")) or ".." in parts or "\0" in name:
        return None
    if home == folder:
        return folder.joinpath(*parts)
    return folder.joinpath(*parts[1:]) if parts[0] == folder.resolve().name and len(parts) > 1 else None
