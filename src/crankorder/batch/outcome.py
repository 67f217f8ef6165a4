"""What became of one test of a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from crankorder.batch.plan import CampaignPlan
from crankorder.errors import CrankorderError, printable
from crankorder.findings import Findings
from crankorder.quantities import QualityFlag
from crankorder.report.sentences.story import headline


@dataclass
class Outcome:
    """What became of one test."""

    plan: CampaignPlan
    status: str = "failed"
    faults: list[CrankorderError] = field(default_factory=list)
    internal: list[BaseException] = field(default_factory=list)
    flags: list[QualityFlag] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What was left out of recordings that are used for the rest."""
    findings: Findings | None = None
    accuracy: str = ""
    seconds: dict[str, float] = field(default_factory=dict)
    reused: int = 0
    """Recordings whose results an earlier run had kept."""
    kept: bool = False
    """Whether what an earlier run finished was kept, for nothing had changed."""

    @property
    def exit_status(self) -> int:
        """Exit status of this test alone, as the command line defines it."""
        if self.internal:
            return 1
        if self.status == "failed":
            return next((f.exit_status for f in self.faults if f.exit_status in (2, 4, 5)), 4)
        return 3 if self.faults else 0

    @property
    def record(self) -> dict[str, Any]:
        """What an index says of it: name, status, folder, headline and failed recordings."""
        folder = self.plan.out.name
        failed = [{"recording": self.plan.name_of(Path(fault.file)), "error": str(fault)} for fault in self.faults]
        failed += [
            {"recording": "", "error": f"internal fault: {type(error).__name__}: {printable(error)}"}
            for error in self.internal
        ]
        return {
            "name": self.plan.name,
            "status": self.status,
            "folder": folder,
            "link": None if self.status == "failed" else f"{folder}/report.html",
            "recordings": len(self.plan.recordings),
            "headline": [] if self.findings is None else headline(self.findings),
            "failed": failed,
        }
