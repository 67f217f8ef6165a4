"""The frozen runs, made as a user makes them."""

from __future__ import annotations

import json
from pathlib import Path

from click.testing import CliRunner

from crankorder import stages
from crankorder.cli import main
from crankorder.findings import Findings
from golden.cases import DEFAULT, MANIFESTS, SHARED, Case
from golden.summary import Summary, summary_of_findings, summary_of_results


def summary_of(case: Case, folder: Path) -> Summary:
    """What is kept of ``case``, analysed in the empty ``folder``: results, findings, text, and the stages it ran."""
    out = folder / "out"
    arguments = ["--out", str(out), "--jobs", "2"]
    arguments += [] if case.recipe == DEFAULT else ["--recipe", case.recipe]
    if case.is_real:
        data = [SHARED / case.folder]
        arguments += ["--manifest", str(MANIFESTS / case.manifest)]
    else:
        data = made_scene(case.scene, folder.parent)
    outcome = CliRunner().invoke(main, ["run", *map(str, data), *arguments])
    text = outcome.output.replace(str(out), "OUT")
    for place in (*data, data[0].parent):
        text = text.replace(str(place), "DATA")
    made: Summary = {"exit": outcome.exit_code, "text": text.splitlines(), "stages": []}
    results = next(iter(sorted(out.glob("*/results.nc"), reverse=True)), None)  # of several repeats the last
    if results is not None:
        made["stages"] = stages_of(results.parent)
        made["results"] = summary_of_results(results)
        findings = results.parent / "findings.json"
        document = json.loads(findings.read_bytes()) if findings.exists() else {}
        assert not document or Findings.from_dict(document).as_dict() == document
        made["findings"] = summary_of_findings(document)
    return made


def stages_of(test: Path) -> list[str]:
    """Stages that the run of the results in ``test`` asked for, in their order, by its settings."""
    run = json.loads((test / "run.json").read_bytes())
    return [made.__name__ for made in stages.stages_for(tuple(run["settings"]["report"]["results"]))]


def made_scene(scene: str, folder: Path) -> list[Path]:
    """Folders of the recordings of the short version of ``scene``, written into ``folder`` once."""
    made = folder / f"scene-{scene}"
    if not made.exists():
        outcome = CliRunner().invoke(main, ["synth", scene, "--quick", "--out", str(made), "-q"])
        assert outcome.exit_code == 0, outcome.output
    return sorted(made.glob("run_*")) or [made]
