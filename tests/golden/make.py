"""Keep what the program gives: ``python tests/golden/make.py [NAME …]`` says what moved and writes it."""

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from golden.summary import Summary, differences, summary_of  # noqa: E402

SUMMARIES = Path(__file__).parent / "summaries"

SCENES = {
    "thesis-second-motoring": "held speeds", "run-up": "a sweep", "bearing-growth": "a bearing",
    "thesis-second-firing": "firing", "hard-damaged-line": "a damaged encoder", "two-shafts": "a second shaft",
}  # fmt: skip
"""Scenes that are kept, with what each stands for; all of them give the same with AVX2 and AVX-512 kernels."""


def kept(scene: str) -> Summary:
    """The committed summary of ``scene``; empty where there is none."""
    file = SUMMARIES / f"{scene}.json"
    return dict(json.loads(file.read_bytes())) if file.exists() else {}


def main() -> None:
    """Make the summaries named on the command line, or all, anew; say of each what moved."""
    reader = argparse.ArgumentParser(description=__doc__)
    reader.add_argument("names", nargs="*", choices=[*SCENES, []], help="scenes; all where none is named")
    reader.add_argument("--dry-run", action="store_true", help="say what moved, write nothing")
    asked = reader.parse_args()
    for scene in asked.names or SCENES:
        with tempfile.TemporaryDirectory() as work:
            after = summary_of(scene, Path(work))
        moved = differences(kept(scene), after)
        print(f"{scene}: {'' if moved else 'as it was'}", *moved, sep="\n  " if moved else "", flush=True)
        if not asked.dry_run:
            rows = [f"{json.dumps(path)}: {json.dumps(column)}" for path, column in after.items()]
            (SUMMARIES / f"{scene}.json").write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
