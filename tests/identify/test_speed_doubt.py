"""A speed that the vibration tells only in doubt carries no sentence that is sure of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from click.testing import CliRunner

from crankorder.cli import main
from crankorder.findings import Findings
from crankorder.report.sentences.story import headline, story_of

RATE_HZ = 8192
MANIFEST = """schema_version = 1
[test]
name = "no encoder"
cycle = "rotor"
[recordings]
files = ["*.h5"]
[sampling]
domain = "time"
rate_hz = 8192
[[channels]]
name = "Z"
source = "z"
quantity = "acceleration"
unit = "m/s2"
[encoder]
kind = "vibration"
"""


def analysed(folder: Path, orders: dict[float, float]) -> dict[str, Any]:
    """Findings of one recording at 1500 rpm without an encoder that holds ``orders``, noise and a tone of 73.3 Hz."""
    rng, at = np.random.default_rng(3), np.arange(4 * RATE_HZ) / RATE_HZ
    signal = sum(size * np.cos(2 * np.pi * k * 25.0 * at + k) for k, size in orders.items())
    signal = signal + 3.0 * np.cos(2 * np.pi * 73.3 * at) + 0.5 * rng.standard_normal(at.size)
    (folder / "in").mkdir(parents=True)
    with h5py.File(folder / "in" / "a.h5", "w") as file:
        file["z"] = signal
    (folder / "in" / "run.toml").write_text(MANIFEST, encoding="utf-8")
    done = CliRunner().invoke(main, ["run", str(folder / "in"), "--out", str(folder / "out"), "-q"])
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads(next((folder / "out").glob("*/findings.json")).read_bytes())
    return found


def test_even_orders_alone_leave_the_speed_open_and_the_page_says_so(tmp_path: Path) -> None:
    findings = analysed(tmp_path, {2.0: 1.0, 4.0: 0.6, 6.0: 0.4})
    assert findings["speed_doubt"] and not findings["free_bands"]
    assert {record["lock"] for record in findings["orders"]} <= {"undecided"}
    typed = Findings.from_dict(findings)
    said = [*headline(typed), *(one for part in story_of(typed).values() for one in part)]
    assert "is in doubt" in said[0]
    for sure in ("does not follow the shaft", "Balance it", "Free of resonances", " slips", "Cause: "):
        assert not any(sure in one for one in said), sure
