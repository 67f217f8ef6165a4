"""All tests of a run, one after the other, and the index of what they gave."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from crankorder.batch.ahead import Helper
from crankorder.batch.execute import Outcome, Progress, run_test
from crankorder.batch.index import publish_index
from crankorder.batch.plan import TestPlan


def run_plans(
    plans: list[TestPlan],
    out: Path,
    *,
    helper: Helper,
    jobs: int,
    fresh: bool = False,
    strict: bool = False,
    watched: Callable[[str], AbstractContextManager[Progress]],
    tell: Callable[[Outcome], None],
) -> list[Outcome]:
    """What became of each of ``plans``, whose results and index are published in ``out``.

    ``helper``, ``jobs``, ``fresh`` and ``strict`` are those of :func:`crankorder.batch.execute.run_test`; ``watched``
    gives, for the name of a test, what is told of its progress while it runs; ``tell`` is called with each outcome.
    """
    outcomes = []
    for plan in plans:
        with watched(plan.name) as progress:
            outcome = run_test(plan, helper=helper, jobs=jobs, fresh=fresh, strict=strict, progress=progress)
        tell(outcome)
        outcomes.append(outcome)
    publish_index(out, outcomes, page_of=helper.index_page)
    return outcomes
