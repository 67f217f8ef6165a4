"""Work beside the analysis: inputs are hashed, and what draws and writes is loaded, while this process loads the rest.

This module imports nothing heavy itself.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crankorder.batch.store import code_sha256, file_sha256, library_versions
from crankorder.batch.workers import Worker, WorkerDiedError

if TYPE_CHECKING:
    import xarray as xr

    from crankorder.batch.plan import TestPlan
    from crankorder.settings import ReportSettings


class Helper:
    """A process beside this one that hashes the inputs of ``plans``, then loads what writes, then writes when asked."""

    def __init__(self, plans: list[TestPlan], *, jobs: int) -> None:
        """Start hashing the recordings of ``plans``, ``jobs`` at a time, and loading what draws and writes."""
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
                files = dict(zip(paths, pool.map(_digest, paths), strict=True))
            return {"code": code_sha256(), "versions": library_versions(), "files": files}
        from crankorder.batch.publish import files_of_test, prepare
        from crankorder.report.page import index_page

        if name == "load":
            return prepare()
        if name == "index":
            return index_page(*given)
        groups, findings, provenance, settings = given
        return files_of_test(groups, findings, provenance, settings=settings, jobs=self._jobs)

    def program(self) -> tuple[str, dict[str, str]]:
        """SHA-256 of the program, and the versions of it and of the libraries that results may depend on."""
        return self._hashed()["code"], self._hashed()["versions"]

    def hashes(self, plan: TestPlan) -> dict[Path, str]:
        """SHA-256 of every recording of ``plan``; of one that cannot be read its fault instead."""
        return {path: self._hashed()["files"][path] for path in plan.recordings}

    def _hashed(self) -> dict[str, Any]:
        if not self._hashes:
            self._hashes = self._answer_to("hash")
        return self._hashes

    def files_of_test(
        self,
        groups: dict[str, xr.Dataset],
        findings: dict[str, Any],
        provenance: dict[str, Any],
        settings: ReportSettings,
    ) -> dict[str, bytes]:
        """All files of a test by name, from its ``groups``, ``findings``, ``provenance`` and ``settings``.

        See :func:`crankorder.batch.publish.files_of_test`.
        """
        self._ask("write", (groups, findings, provenance, settings))
        made: dict[str, bytes] = self._answer_to("write")
        return made

    def index_page(self, tests: list[dict[str, Any]]) -> str:
        """HTML list of the ``tests`` of a run, as :func:`crankorder.report.page.index_page` makes it."""
        self._ask("index", (tests,))
        try:
            page: str = self._answer_to("index")
        except WorkerDiedError:
            page = self._do(("index", (tests,)))
        return page

    def close(self) -> None:
        """End the helper."""
        self._worker.close()


def _digest(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError as error:
        return f"unreadable: {error.strerror}"
