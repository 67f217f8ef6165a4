"""The frozen runs, made as a user makes them."""

from __future__ import annotations

import json
from pathlib import Path

from click.testing import CliRunner

from crankorder import stages
from crankorder.cli import main
from golden.cases import DEFAULT, MANIFESTS, SHARED, Case
from golden.summary import Summary, summary_of_findings, summary_of_results


def summary_of(case: Case, folder: Path) -> Summary:
    """What is kept of ``case``, analysed in the empty ``folder``: results, findings, text, and the stages it ran."""
    out = folder / "out"
    arguments = ["--out", str(out), "--jobs", "2"]
    arguments += [] if case.recipe == DEFAULT else ["--recipe", case.recipe]
    if case.is_real:
        data = SHARED / case.folder
        arguments += ["--manifest", str(MANIFESTS / case.manifest)]
    else:
        data = made_scene(case.scene, folder.parent)
    ran: list[str] = []
    outcome = CliRunner().invoke(main, ["run", str(data), *arguments])
    text = outcome.output.replace(str(out), "OUT").replace(str(data), "DATA").replace(str(data.parent), "DATA/..")
    made: Summary = {"exit": outcome.exit_code, "text": text.splitlines(), "stages": ran}
    results = next(iter(sorted(out.glob("*/results.nc"))), None)
    if results is not None:
        made["stages"] = stages_of(results.parent)
        made["results"] = summary_of_results(results)
        findings = results.parent / "findings.json"
        made["findings"] = summary_of_findings(json.loads(findings.read_bytes())) if findings.exists() else {}
    return made


def stages_of(test: Path) -> list[str]:
    """Stages that the run of the results in ``test`` asked for, in their order, by its settings."""
    run = json.loads((test / "run.json").read_bytes())
    return [made.__name__ for made in stages.stages_for(tuple(run["settings"]["report"]["results"]))]


def made_scene(scene: str, folder: Path) -> Path:
    """Folder of the recordings of the short version of ``scene``, written into ``folder`` once."""
    made = folder / f"scene-{scene}"
    if not made.exists():
        outcome = CliRunner().invoke(main, ["synth", scene, "--quick", "--out", str(made), "-q"])
        assert outcome.exit_code == 0, outcome.output
    return made
