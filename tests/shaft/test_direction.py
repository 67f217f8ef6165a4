"""A shaft that turns backwards is told by the second track of its encoder, and by nothing else."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_recording
from crankorder.quantities import flags_of
from crankorder.settings import load_settings

SETTINGS = load_settings()
RATE_HZ, LINES = 20_000.0, 60
MANIFEST = """schema_version = 1
[test]
name = "two tracks"
cycle = "rotor"
[recordings]
files = ["*.h5"]
[[channels]]
name = "Z"
source = "z"
unit = "m/s2"
[encoder]
kind = "square"
source = "a"
second_track = "b"
pulses_per_rev = 60
edge = "{edge}"
"""


def flags(folder: Path, turns: np.ndarray, *, edge: str = "rising", second: np.ndarray | None = None) -> dict[str, str]:
    """Flags on the direction of a shaft at ``turns`` (sample,), A leading B by a quarter of a line forwards."""
    folder.mkdir(exist_ok=True)
    (folder / "run.toml").write_text(MANIFEST.format(edge=edge), encoding="utf-8")
    with h5py.File(folder / "a.h5", "w") as file:
        file.attrs["rate_hz"] = RATE_HZ
        file["z"] = np.random.default_rng(1).standard_normal(turns.size)
        file["a"] = ((turns * LINES) % 1.0 < 0.5).astype(np.float32)
        file["b"] = ((turns * LINES - 0.25) % 1.0 < 0.5).astype(np.float32) if second is None else second
    manifest = load_manifest(folder)
    read = read_recording(folder / "a.h5", manifest, settings=SETTINGS.ingest, shaft=SETTINGS.shaft)
    return {one["flag"]: one["detail"] for one in flags_of(read) if "direction" in one["flag"] or "back" in one["flag"]}


TIME_S = np.arange(int(2.0 * RATE_HZ)) / RATE_HZ


@pytest.mark.parametrize("edge", ["rising", "falling"])
def test_d8_a_shaft_that_turns_backwards_is_told_and_one_that_turns_forwards_is_not(tmp_path: Path, edge: str) -> None:
    assert flags(tmp_path / "forwards", 20.0 * TIME_S + 0.003, edge=edge) == {}
    told = flags(tmp_path / "backwards", -20.0 * TIME_S + 0.003, edge=edge)
    assert list(told) == ["turns_backwards"] and "100.0%" in told["turns_backwards"]


def test_d8_a_shaft_that_turns_round_is_told_with_its_place(tmp_path: Path) -> None:
    there_and_back = np.where(TIME_S < 1.5, 20.0 * TIME_S, 60.0 - 20.0 * TIME_S) + 0.003
    told = flags(tmp_path / "round", there_and_back)
    assert list(told) == ["direction_changes"]
    assert "25.0%" in told["direction_changes"] and "at pulse 1800" in told["direction_changes"]


def test_d8_a_dead_second_track_says_nothing(tmp_path: Path) -> None:
    assert list(flags(tmp_path / "dead", 20.0 * TIME_S + 0.003, second=np.ones(TIME_S.size))) == ["direction_unknown"]


def test_a_second_track_goes_with_a_sampled_one(tmp_path: Path) -> None:
    text = MANIFEST.format(edge="rising").replace('"square"', '"pulse_times"')
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    with pytest.raises(Exception, match="a second track is a sampled trace"):
        load_manifest(tmp_path)
