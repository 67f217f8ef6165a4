"""What can go wrong, one line each. Every error says file, place, value found, what is allowed and what to do."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]{6,16}(?=>)")

LONGEST_PROBLEM = 500
"""Characters of a problem or remedy that are shown: they may quote a name from a file."""


class CrankorderError(Exception):
    """Base of every error that crankorder raises on purpose; ``exit_status`` is what the command line returns."""

    exit_status = 1

    def __init__(
        self,
        problem: str,
        *,
        file: object = "",
        place: str = "",
        found: object = "",
        allowed: str = "",
        remedy: str = "",
    ) -> None:
        self.problem = problem
        self.file = str(file)
        self.place = place
        self.found = "" if found == "" else printable(found)
        self.allowed = allowed
        self.remedy = remedy
        super().__init__(str(self))

    def __str__(self) -> str:
        where = ": ".join(printable(part) for part in (self.file, self.place) if part)
        problem = printable(self.problem, LONGEST_PROBLEM)
        text = f"{where}: {problem}" if where else problem
        if self.found:
            text += f"; found {self.found}"
        if self.allowed:
            text += f"; allowed: {printable(self.allowed, 4 * LONGEST_PROBLEM)}"
        return f"{text}. {printable(self.remedy, LONGEST_PROBLEM)}".rstrip() if self.remedy else f"{text}."

    def __reduce__(self) -> tuple[object, ...]:
        keywords = {key: getattr(self, key) for key in ("file", "place", "found", "allowed", "remedy")}
        return (_rebuild, (type(self), self.problem, keywords))


def _rebuild(kind: type[CrankorderError], problem: str, keywords: dict[str, str]) -> CrankorderError:
    return kind(problem, **keywords)


@contextmanager
def located(file: object, place: str = "") -> Iterator[None]:
    """Gives errors raised inside the ``file`` that they are about, and the ``place`` in it, where they state none."""
    try:
        yield
    except CrankorderError as error:
        if error.file or isinstance(error, ManyErrors):  # each of many names its own
            raise
        keywords = {key: getattr(error, key) for key in ("found", "allowed", "remedy")}
        raise type(error)(error.problem, file=file, place=error.place or place, **keywords) from None


def printable(value: object, limit: int = 200) -> str:
    """Text of ``value`` with control characters shown as ``\\xNN`` and cut at ``limit`` characters.

    Where an object lies in memory is left out: the same fault has the same words in every run.
    """
    text = _ADDRESS.sub("", str(value)).encode("utf-8", "backslashreplace").decode("utf-8")
    if not text.isprintable():
        text = "".join(char if char.isprintable() else f"\\x{ord(char):02x}" for char in text)
    return text if len(text) <= limit else text[: limit - 1] + "…"


def plain_number(value: float) -> str:
    """``value``, in any unit, to four significant digits for a sentence: no exponent from 1e-4 to 1e6, a true minus."""
    text = f"{value:.4g}"
    return (f"{float(text):.0f}" if "e+" in text and abs(value) < 1e6 else text).replace("-", "−")


class RequestError(CrankorderError, ValueError):
    """The request or the manifest is wrong: nothing is written (exit status 2)."""

    exit_status = 2


class InputError(CrankorderError, ValueError):
    """A recording cannot be read or used: it is left out, the others go on (exit status 3, or 4 if none is left)."""

    exit_status = 3


class UnsafeInputError(InputError):
    """A recording is refused because reading it could reach outside its folder or exhaust the machine."""


class NoUsableRecordingError(InputError):
    """No recording of the test could be used (exit status 4)."""

    exit_status = 4


class EnvironmentFailure(CrankorderError, OSError):
    """Disk full, no permission, a missing program or package: the surroundings must change (exit status 5)."""

    exit_status = 5


class SchemaError(CrankorderError, TypeError):
    """A dataset does not have the dims, variables or units that its schema names: a fault of the program."""


MOST_TOLD = 200
"""Faults of one request that are told one by one: beyond them they are counted."""


def told(faults: list[CrankorderError], count: int, *, file: object) -> list[CrankorderError]:
    """The first ``MOST_TOLD`` of ``faults``, and how many there are where ``count`` of them were found in ``file``."""
    if count <= MOST_TOLD:
        return faults
    rest = RequestError(f"and {count - MOST_TOLD} more faults", file=file, remedy="Mend these first")
    return [*faults[:MOST_TOLD], rest]


class ManyErrors(RequestError):
    """Several faults of one request, listed together."""

    def __init__(self, faults: list[CrankorderError]) -> None:
        self.faults = faults
        super().__init__("\n".join(str(fault) for fault in faults))

    def __str__(self) -> str:
        return "\n".join(str(fault) for fault in self.faults)

    def __reduce__(self) -> tuple[object, ...]:
        return (ManyErrors, (self.faults,))
