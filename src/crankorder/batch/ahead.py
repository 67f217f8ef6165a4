"""Work beside the analysis: inputs are hashed while modules load, pictures drawn while data are written.

This module imports nothing heavy itself.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crankorder.batch.store import code_sha256, file_sha256
from crankorder.batch.workers import Worker

if TYPE_CHECKING:
    from crankorder.batch.plan import TestPlan


class Helper:
    """A process beside this one that hashes the inputs of ``plans``, then loads what draws, then draws when asked."""

    def __init__(self, plans: list[TestPlan], *, jobs: int) -> None:
        """Start hashing the recordings of ``plans``, ``jobs`` at a time, and loading what draws."""
        self._plans, self._jobs = plans, jobs
        self._worker = Worker(self._do)
        self._asked: list[str] = []
        self._hashes: dict[str, Any] = {}
        for request in ("hash", "load"):
            self._ask(request)

    def _ask(self, request: str, given: tuple[Any, ...] = ()) -> None:
        self._asked.append(request)
        self._worker.ask((request, given))

    def _answer_to(self, request: str) -> Any:
        """Answer to ``request``; those to earlier ones, which nobody waits for, are passed over."""
        while self._asked.pop(0) != request:
            self._worker.answer()
        return self._worker.answer()

    def _do(self, request: tuple[str, tuple[Any, ...]]) -> Any:
        name, given = request
        if name == "hash":
            paths = [path for plan in self._plans for path in plan.recordings]
            with ThreadPoolExecutor(max_workers=self._jobs) as pool:
                return {"code": code_sha256(), "files": dict(zip(paths, pool.map(_digest, paths), strict=True))}
        from crankorder.batch import publish
        from crankorder.report.pictures import prepare

        return publish.pictures(*given, jobs=self._jobs) if name == "draw" else prepare()

    def hashes(self, plan: TestPlan) -> tuple[str, dict[Path, str]]:
        """SHA-256 of the program, and of every recording of ``plan``; of one that cannot be read its fault instead."""
        if not self._hashes:
            self._hashes = self._answer_to("hash")
        return self._hashes["code"], {path: self._hashes["files"][path] for path in plan.recordings}

    def start_drawing(self, *given: Any) -> None:
        """Have the pictures of a test drawn from what is ``given``: the arguments of ``publish.pictures``."""
        self._ask("draw", given)

    def drawn(self) -> dict[str, tuple[bytes, str]]:
        """PNG and caption by file name of the pictures whose drawing was started."""
        made: dict[str, tuple[bytes, str]] = self._answer_to("draw")
        return made

    def close(self) -> None:
        """End the helper."""
        self._worker.close()


def _digest(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError as error:
        return f"unreadable: {error.strerror}"
