"""All tests of a run, one after the other, and the index of what they gave."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from crankorder.batch.execute import Progress, run_test
from crankorder.batch.index import publish_index
from crankorder.batch.locks import locked
from crankorder.batch.outcome import Outcome
from crankorder.batch.plan import TestPlan
from crankorder.batch.reporting import ReportingProcess


def run_plans(
    plans: list[TestPlan],
    out: Path,
    *,
    reporting: ReportingProcess,
    jobs: int,
    fresh: bool = False,
    strict: bool = False,
    watched: Callable[[str], AbstractContextManager[Progress]],
    tell: Callable[[Outcome], None],
    wait: Callable[[str], object] = lambda text: None,
) -> list[Outcome]:
    """What became of each of ``plans``, whose results and index are published in ``out``.

    ``reporting``, ``jobs``, ``fresh`` and ``strict`` are those of :func:`crankorder.batch.execute.run_test`;
    ``watched`` gives, for the name of a test, what is told of its progress while it runs; ``tell`` is called with each
    outcome, ``wait`` with a sentence where another process that writes the same results is waited for.
    """
    outcomes = []
    for plan in plans:
        with watched(plan.name) as progress, locked(plan.out, tell=wait):
            outcome = run_test(plan, reporting=reporting, jobs=jobs, fresh=fresh, strict=strict, progress=progress)
        tell(outcome)
        outcomes.append(outcome)
    publish_index(out, outcomes, page_of=reporting.index_page, tell=wait)
    return outcomes
