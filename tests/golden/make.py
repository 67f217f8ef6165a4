"""Freeze what the program gives: ``python tests/golden/make.py [NAME …]`` prints what moved and keeps what is."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from golden.cases import SHARED, all_cases  # noqa: E402
from golden.runs import summary_of  # noqa: E402
from golden.summary import Summary, differences  # noqa: E402

SUMMARIES = Path(__file__).parent / "summaries"


def kept(name: str) -> Summary | None:
    """The committed summary of the case ``name``; None where there is none."""
    file = SUMMARIES / f"{name}.json"
    summary: Summary | None = json.loads(file.read_bytes()) if file.exists() else None
    return summary


def as_text(summary: Summary) -> str:
    """``summary`` as it is committed: a line for each variable."""
    parts = []
    for key, part in summary.items():
        if isinstance(part, dict):
            rows = [f"  {json.dumps(name)}: {json.dumps(row, separators=(',', ':'))}" for name, row in part.items()]
            parts.append(f"{json.dumps(key)}: {{\n" + ",\n".join(rows) + "\n}")
        else:
            parts.append(f"{json.dumps(key)}: {json.dumps(part, indent=1)}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def main() -> None:
    """Make the summaries named on the command line, or all, anew; say of each what moved."""
    reader = argparse.ArgumentParser(description=__doc__)
    reader.add_argument("names", nargs="*", help="cases; all where none is named")
    reader.add_argument("--dry-run", action="store_true", help="say what moved, keep nothing")
    asked = reader.parse_args()
    cases = [case for case in all_cases() if not asked.names or case.name in asked.names]
    with tempfile.TemporaryDirectory() as work:
        for case in cases:
            if case.is_real and not SHARED.exists():
                print(f"{case.name}: left as it is, for the recordings are absent")
                continue
            folder = Path(work) / case.name
            folder.mkdir()
            after, before = summary_of(case, folder), kept(case.name)
            moved = ["new"] if before is None else differences(before, after)
            print(f"{case.name}: {'as it was' if not moved else ''}", *moved, sep="\n  " if moved else "", flush=True)
            if moved and not asked.dry_run:
                (SUMMARIES / f"{case.name}.json").write_text(as_text(after), encoding="utf-8")


if __name__ == "__main__":
    main()
