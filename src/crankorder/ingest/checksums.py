"""Lists of checksums beside recordings: those of BagIt (RFC 8493), and what ``sha256sum`` and its like write."""

from __future__ import annotations

import fnmatch
import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from crankorder.errors import CrankorderError, InputError, printable
from crankorder.ingest.encoder_table import NAMED_PART

_KINDS = r"md5|sha1|sha224|sha256|sha384|sha512"
_LIST = re.compile(rf"(?i)manifest-({_KINDS})\.txt|({_KINDS})sums?(?:\.txt)?|checksums?\.({_KINDS})|.+\.({_KINDS})")
_OF_BAG = re.compile(rf"(?i)tagmanifest-({_KINDS})\.txt|bagit\.txt|bag-info\.txt|fetch\.txt")
_LINE = re.compile(r"\\?([0-9A-Fa-f]{32,128})(?:\s+[*?]?(.+))?")
_TAGGED = re.compile(r"[A-Za-z0-9-]+ \((.+)\) ?= ?([0-9A-Fa-f]{32,128})")
_MOST_BYTES = 16_000_000


@dataclass(frozen=True, slots=True)
class Listed:
    """A file that the list at ``by`` names, with its hexadecimal ``digest`` by an ``algorithm`` of hashlib."""

    path: Path
    algorithm: str
    digest: str
    by: Path


def is_checksum_list(name: str) -> bool:
    """Whether a file ``name`` holds checksums, or tells of a bag of files that has them, and no samples."""
    return bool(_LIST.fullmatch(name) or _OF_BAG.fullmatch(name))


def checksum_faults(
    folder: Path,
    files: Iterable[Path],
    patterns: Sequence[str],
    *,
    sha256_of: Callable[[Path], str | None] | None = None,
) -> list[CrankorderError]:
    """Faults of ``files`` of the test-run folder ``folder`` that lists of checksums beside them tell.

    A file whose checksum differs, and one that is listed, would be a recording by the ``patterns`` and is not there.
    ``sha256_of`` gives a SHA-256 that is known already. A list that cannot be read is a fault of its own.
    """
    faults: list[CrankorderError] = []
    wanted = {file.resolve(): file for file in files}
    told: set[Path] = set()
    for one in _listed(folder, faults):
        path = one.path.resolve()
        if path in told:
            continue
        if path not in wanted:
            if not one.path.exists() and _is_asked_for(one.path, folder, patterns):
                told.add(path)
                problem = f"is listed in {one.by.name} and not there"
                faults.append(InputError(problem, file=one.path, remedy="Copy it again"))
            continue
        known = sha256_of(wanted[path]) if sha256_of is not None and one.algorithm == "sha256" else None
        found = known or _digest(path, one.algorithm)
        if found is not None and found.lower() != one.digest.lower():
            told.add(path)
            problem = f"its {one.algorithm.upper()} differs from {one.by.name}: it was damaged or changed"
            remedy = "Copy it again from where it was recorded; where it was changed on purpose, renew the list"
            digests = {"found": found[:16] + " …", "allowed": one.digest[:16] + " …"}
            faults.append(InputError(problem, file=wanted[path], remedy=remedy, **digests))
    return faults


def _is_asked_for(path: Path, folder: Path, patterns: Sequence[str]) -> bool:
    name = path.relative_to(folder).as_posix()
    patterns = [NAMED_PART.sub("*", pattern) for pattern in patterns]
    deep = [pattern for pattern in patterns if "**" in pattern or pattern.count("/") == name.count("/")]
    return name in patterns or any(fnmatch.fnmatchcase(name, pattern) for pattern in deep)


def _digest(path: Path, algorithm: str) -> str | None:
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, algorithm).hexdigest()
    except OSError:
        return None  # what cannot be read has a fault of its own


def _listed(folder: Path, faults: list[CrankorderError]) -> Iterator[Listed]:
    """Entries of the lists in ``folder``, and of those of the bag whose payload it is; unreadable lines are faults."""
    homes = [folder]
    above = folder.resolve().parent
    if folder.resolve().name == "data" and (above / "bagit.txt").is_file():
        homes.append(above)
    for home in homes:
        for by in sorted(item for item in home.iterdir() if _LIST.fullmatch(item.name) and item.is_file()):
            yield from _entries(by, home, folder, faults)


def _entries(by: Path, home: Path, folder: Path, faults: list[CrankorderError]) -> Iterator[Listed]:
    match = _LIST.fullmatch(by.name)
    algorithm = next(kind for kind in match.groups() if kind).lower() if match else ""
    try:
        with by.open("rb") as stream:
            text = stream.read(_MOST_BYTES + 1).decode("utf-8-sig", "surrogateescape")
    except OSError as error:
        faults.append(InputError("cannot be read", file=by, found=error))
        return
    if len(text) > _MOST_BYTES:
        faults.append(InputError(f"is no list of checksums: more than {_MOST_BYTES} bytes", file=by))
        return
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.startswith(("#", ";")):
            continue
        tagged, plain = _TAGGED.fullmatch(line.strip()), _LINE.fullmatch(line.strip())
        name, digest = (tagged[1], tagged[2]) if tagged else (plain[2] or by.stem, plain[1]) if plain else ("", "")
        if len(digest) != 2 * hashlib.new(algorithm).digest_size:
            problem, remedy = f"is no {algorithm} checksum", "Write the list again, or remove it"
            faults.append(
                InputError(problem, file=by, place=f"line {number}", found=printable(line, 60), remedy=remedy)
            )
            return
        path = _inside(name.strip(), home, folder)
        if path is not None:
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
