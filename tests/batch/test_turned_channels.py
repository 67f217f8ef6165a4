"""A sensor that was plugged in the other way round in one of four recordings, through a whole run."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

from crankorder.cli import main

RATE_HZ, LINES, LENGTH_S = 6000.0, 12, 4.0
CHANNELS = "".join(f'[[channels]]\nname = "{name}"\nsource = "{name.lower()}"\nunit = "m/s2"\n' for name in "XYZ")
MANIFEST = f"""schema_version = 1
[test]
name = "plugs"
cycle = "rotor"
[recordings]
files = ["*.h5"]
{CHANNELS}[encoder]
kind = "square"
source = "encoder"
index = "index"
pulses_per_rev = {LINES}
"""


def recorded(path: Path, seed: int, *, reversed_channel: str = "") -> None:
    rng = np.random.default_rng(seed)
    turns = 25.0 * (1.0 + 0.001 * rng.standard_normal()) * np.arange(int(LENGTH_S * RATE_HZ)) / RATE_HZ + rng.uniform()
    with h5py.File(path, "w") as file:
        file.attrs["rate_hz"] = RATE_HZ
        for number, name in enumerate("XYZ"):
            signal = sum(
                np.cos(2 * np.pi * (order * turns + 0.13 * number * order)) * (1.0 + number) / order
                for order in (1, 2, 3, 4)
            )
            signal = signal + 0.2 * rng.standard_normal(turns.size)
            file[name.lower()] = -signal if name == reversed_channel else signal
        file["encoder"] = ((turns * LINES) % 1.0 < 0.5).astype(np.float32)
        file["index"] = (turns % 1.0 < 0.5 / LINES).astype(np.float32)


@pytest.mark.parametrize("turned", ["", "Y"])
def test_i16_polarity_reversed_in_one_of_four_recordings_is_flagged_and_left_out(tmp_path: Path, turned: str) -> None:
    folder = tmp_path / "plugs"
    folder.mkdir()
    (folder / "run.toml").write_text(MANIFEST, encoding="utf-8")
    for number in range(4):
        recorded(folder / f"r{number}.h5", number, reversed_channel=turned if number == 2 else "")
    made = CliRunner().invoke(main, ["run", str(folder), "--out", str(tmp_path / "out"), "--jobs", "1"])
    assert made.exit_code == 0, made.output
    found = json.loads((tmp_path / "out" / "plugs" / "findings.json").read_bytes())
    flags = [one for one in found["quality"] if one["flag"] in ("polarity_doubt", "channels_swapped")]
    assert [(one["recording"], one["severity"]) for one in flags] == ([("r2.h5", "suspect")] if turned else [])
    assert all("channel Y" in one["detail"] and "half a turn" in one["detail"] for one in flags)
    first = next(one for one in found["orders"] if one["channel"] == "Y" and one["order"] == 1.0)
    assert first["amplitude"] == pytest.approx(2.0, rel=0.02)
