"""What all tests in a folder of results gave: batch.json and index.html, as each test's own folder tells it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from crankorder.batch.locks import locked
from crankorder.batch.plan import Outcome
from crankorder.batch.result_folder import BATCH, BATCH_VERSION, INDEX, finished_tests, records_in
from crankorder.batch.store import json_bytes, write_atomically
from crankorder.errors import EnvironmentFailure
from crankorder.ingest.folder import natural_key


def summary(outcomes: list[Outcome]) -> dict[str, Any]:
    """Name, status, folder, headline and failed recordings of each of ``outcomes``: what ``--json`` says."""
    return _document([outcome.record for outcome in outcomes])


def _document(records: list[dict[str, Any]]) -> dict[str, Any]:
    return {"schema_version": BATCH_VERSION, "tests": records}


def publish_index(
    out: Path,
    outcomes: list[Outcome],
    *,
    page_of: Callable[[list[dict[str, Any]]], str],
    tell: Callable[[str], object] = lambda text: None,
) -> None:
    """Write ``batch.json`` and ``index.html`` of all tests in ``out``: those of ``outcomes`` and those of other runs.

    What is finished is told by the tests' own folders; a test that failed stays named until it is done. ``page_of``
    makes the page of the records; ``tell`` is told where another process is waited for.
    Raises EnvironmentFailure where it cannot be written.
    """
    with locked(out / BATCH, tell=tell):
        try:
            now = {outcome.plan.out.name: outcome.record for outcome in outcomes if outcome.status == "failed"}
            done = {outcome.plan.out.name for outcome in outcomes} - set(now)
            known = {record["folder"]: record for record in records_in(out) or [] if record["status"] == "failed"}
            records = {folder.name: marker["record"] for folder, marker in finished_tests(out) if "record" in marker}
            records |= {name: record for name, record in known.items() if name not in done} | now
            document = _document([records[name] for name in sorted(records, key=lambda name: natural_key(Path(name)))])
            write_atomically(out / BATCH, json_bytes(document))
            write_atomically(out / INDEX, page_of(document["tests"]).encode("utf-8", "backslashreplace"))
        except OSError as error:
            if isinstance(error, EnvironmentFailure):
                raise
            raise EnvironmentFailure(f"cannot write ({error.strerror})", file=error.filename or out) from error
