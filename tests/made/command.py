"""The command line as a user calls it, and the findings that it leaves."""

import json
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

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
