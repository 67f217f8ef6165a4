"""What all tests of a run gave: batch.json and index.html."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from crankorder.batch.execute import Outcome
from crankorder.batch.store import json_bytes, write_atomically
from crankorder.errors import EnvironmentFailure, printable
from crankorder.report.sentences.story import headline


def summary(outcomes: list[Outcome], *, out: Path) -> dict[str, Any]:
    """Name, status, folder, headline and failed recordings of each of ``outcomes``: what ``--json`` says.

    ``out`` is the folder that the tests' folders are named relative to.
    """
    return {"schema_version": 1, "tests": [_record(outcome, out) for outcome in outcomes]}


def _record(outcome: Outcome, out: Path) -> dict[str, Any]:
    plan = outcome.plan
    folder = plan.out.relative_to(out).as_posix()
    failed = [{"recording": Path(fault.file).name, "error": str(fault)} for fault in outcome.faults]
    failed += [
        {"recording": "", "error": f"internal fault: {type(error).__name__}: {printable(error)}"}
        for error in outcome.internal
    ]
    return {
        "name": plan.name,
        "status": outcome.status,
        "folder": folder,
        "link": None if outcome.status == "failed" else f"{folder}/report.html",
        "recordings": len(plan.recordings),
        "headline": [] if outcome.findings is None else headline(outcome.findings),
        "failed": failed,
    }


def publish_index(out: Path, outcomes: list[Outcome], *, page_of: Callable[[list[dict[str, Any]]], str]) -> None:
    """Write ``batch.json`` and ``index.html`` of ``outcomes`` into ``out``; ``page_of`` makes the page of the records.

    Raises EnvironmentFailure where it cannot.
    """
    document = summary(outcomes, out=out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_atomically(out / "batch.json", json_bytes(document))
        write_atomically(out / "index.html", page_of(document["tests"]).encode("utf-8", "backslashreplace"))
    except OSError as error:
        raise EnvironmentFailure(f"cannot write ({error.strerror})", file=error.filename or out) from error
