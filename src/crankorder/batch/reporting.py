"""The process beside the analysis: it hashes inputs and loads what draws and writes, while this process loads the rest.

This module imports nothing heavy itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crankorder.batch.store import HashedFile, code_sha256, library_versions
from crankorder.batch.workers import Worker, WorkerDiedError
from crankorder.errors import EnvironmentFailure
from crankorder.findings import Findings

if TYPE_CHECKING:
    import xarray as xr

    from crankorder.batch.plan import CampaignPlan
    from crankorder.settings import ReportSettings


class ReportingProcess:
    """A process beside this one that hashes the inputs of ``plans``, then loads what writes, then writes when asked.

    Where it is killed another takes its place and does what was asked once more.
    """

    def __init__(self, plans: list[CampaignPlan], *, jobs: int) -> None:
        """Start hashing the recordings of ``plans``, ``jobs`` at a time, and loading what draws and writes."""
        self._plans, self._jobs = plans, jobs
        self._hashes: dict[Path, HashedFile] = {}
        self._program: tuple[str, dict[str, str]] | None = None
        self._start("hash", "load")

    def _start(self, *requests: str) -> None:
        self._worker = Worker(self._do)
        self._asked: list[str] = []
        for request in requests:
            self._ask(request)

    def _ask(self, request: str, given: tuple[Any, ...] = ()) -> None:
        self._asked.append(request)
        self._worker.ask((request, given))

    def _answer_to(self, request: str, given: tuple[Any, ...] = ()) -> Any:
        """Answer to ``request``, which was asked or is asked now; those that nobody waits for are passed over.

        Raises EnvironmentFailure where the process ended twice over it.
        """
        try:
            return self._next(request, given)
        except WorkerDiedError:
            self._start()
        try:
            return self._next(request, given)
        except WorkerDiedError as error:
            self._start("load")
            problem = "the process that hashes and writes ended twice"
            remedy = "Too little memory is the likely cause: try --jobs 1; the other tests go on"
            raise EnvironmentFailure(problem, file="crankorder", found=error, remedy=remedy) from error

    def _next(self, request: str, given: tuple[Any, ...]) -> Any:
        if request not in self._asked:
            self._ask(request, given)
        while self._asked.pop(0) != request:
            self._worker.answer()
        return self._worker.answer()

    def _do(self, request: tuple[str, tuple[Any, ...]]) -> Any:
        name, given = request
        if name == "hash":
            paths = [path for plan in self._plans for path in plan.files]
            with ThreadPoolExecutor(max_workers=self._jobs) as pool:
                hashed = dict(zip(paths, pool.map(HashedFile.of, paths), strict=True))
            return (code_sha256(), library_versions()), hashed
        from crankorder.batch.publish import files_of_test, prepare
        from crankorder.report.page import index_page

        if name == "load":
            return prepare(draws=any(plan.settings.report.pictures for plan in self._plans))
        if name == "index":
            return index_page(*given)
        return files_of_test(*given[:3], settings=given[3], jobs=self._jobs)

    def program(self) -> tuple[str, dict[str, str]]:
        """SHA-256 of the program, and the versions of it and of the libraries that results may depend on."""
        if self._program is None:
            self._program, self._hashes = self._answer_to("hash")
        return self._program

    def hashes(self, plan: CampaignPlan) -> dict[Path, HashedFile]:
        """Every file of ``plan`` as it was hashed, or why it could not be."""
        self.program()
        return {path: self._hashes[path] for path in plan.files}

    def files_of_test(
        self,
        groups: dict[str, xr.Dataset],
        findings: Findings,
        provenance: Mapping[str, object],
        settings: ReportSettings,
    ) -> dict[str, bytes]:
        """All files of a test by name, from its ``groups``, ``findings``, ``provenance`` and ``settings``.

        See :func:`crankorder.batch.publish.files_of_test`. Raises EnvironmentFailure where the process ends over it.
        """
        made: dict[str, bytes] = self._answer_to("write", (groups, findings, provenance, settings))
        return made

    def index_page(self, tests: Sequence[Mapping[str, object]]) -> str:
        """HTML list of the ``tests`` of a run, as :func:`crankorder.report.page.index_page` makes it."""
        page: str = self._answer_to("index", (tests,))
        return page

    def close(self) -> None:
        """End the process."""
        self._worker.close()
