"""The command line as a user calls it, and the findings that it leaves."""

import json
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from crankorder.batch.frame_store import STORE
from crankorder.batch.run_log import LOGS
from crankorder.cli import main


def crankorder(*arguments: object) -> Result:
    """What the command with ``arguments`` says, and its exit status."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def done(*arguments: object) -> Result:
    """As :func:`crankorder`, of a command that must succeed."""
    outcome = crankorder(*arguments)
    assert outcome.exit_code == 0, outcome.output
    return outcome


def findings_in(out: Path) -> dict[str, Any]:
    """Findings of the only test in the results folder ``out``."""
    findings: dict[str, Any] = json.loads(next(out.glob("*/findings.json")).read_bytes())
    return findings


def analysed(folder: Path, out: Path, *options: object) -> dict[str, Any]:
    """Findings of the test in ``folder``, its results written to ``out``."""
    done("run", folder, "--out", out, "-q", *options)
    return findings_in(out)


def results_in(out: Path, *, kept: bool = False) -> dict[str, bytes]:
    """Bytes of the files below ``out`` that two runs must give alike; ``kept``: also what is kept of recordings."""
    others = {LOGS} if kept else {LOGS, STORE}
    files = {path.relative_to(out).as_posix(): path for path in sorted(out.rglob("*")) if path.is_file()}
    return {
        name: path.read_bytes()
        for name, path in files.items()
        if path.name != "timings.json" and path.suffix not in (".lock", ".part") and not others & set(path.parts)
    }
