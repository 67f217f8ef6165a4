"""The reference campaign as a whole process, against plain scipy, in one run on this machine.

Usage: python benchmarks/campaign.py [--repeats N] [--keep FOLDER]
Writes `reports/speed-error/campaign.json` and prints a table. Machines are shared and noisy: read the ratios.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]


def measured(command: list[str]) -> tuple[float, float, str]:
    """Wall seconds, peak resident megabytes and stderr of ``command`` as a process of its own."""
    with tempfile.TemporaryFile("w+") as errors:
        start = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - start
        errors.seek(0)
        text = errors.read()
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} ended with {process.returncode}:\n{text}")
    return seconds, usage.ru_maxrss / 1024, text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--keep", type=Path, help="folder with (or for) the synthesised campaign")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        recordings = options.keep or Path(scratch) / "recordings"
        crankorder = [sys.executable, "-m", "crankorder"]
        synthesis = None
        if not recordings.exists():
            synthesis = measured([*crankorder, "synth", "thesis-second-motoring", "--out", str(recordings)])[:2]
        size = sum(len(path.read_bytes()) for path in recordings.glob("*.h5"))  # also warms the page cache
        rows: dict[str, list[tuple[float, float]]] = {"crankorder run": [], "plain scipy": []}
        stages: dict[str, float] = {}
        for number in range(options.repeats):
            out = Path(scratch) / f"out-{number}"
            seconds, memory, said = measured([*crankorder, "run", str(recordings), "--out", str(out), "-v"])
            rows["crankorder run"].append((seconds, memory))
            stages = {name: float(value) for name, value in re.findall(r"^  (\w+): ([\d.]+) s$", said, re.M)}
            plain = [sys.executable, str(ROOT / "benchmarks" / "plain_scipy.py"), str(recordings), str(out) + "-plain"]
            rows["plain scipy"].append(measured(plain)[:2])
    best = {name: min(values) for name, values in rows.items()}
    document = {
        "what": "35 recordings x 15 s x (3 channels + encoder + index), HDF5 in page cache, whole process",
        "megabytes": round(size / 1e6),
        "cores": os.cpu_count(),
        "seconds": {name: round(value[0], 2) for name, value in best.items()},
        "peak_resident_mb": {name: round(value[1]) for name, value in best.items()},
        "plain_scipy_over_crankorder": round(best["plain scipy"][0] / best["crankorder run"][0], 2),
        "stages_seconds": stages,
        "synthesis_seconds_and_mb": None if synthesis is None else [round(value, 1) for value in synthesis],
    }
    target = ROOT / "reports" / "speed-error" / "campaign.json"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(document, indent=2) + "\n")
    print(json.dumps(document, indent=2))


if __name__ == "__main__":
    main()
