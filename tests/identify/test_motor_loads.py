"""Loads of a motor under one stated speed: each recording turns as fast as its slip lets it, and is read so."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

from crankorder.cli import main
from crankorder.engine.motor import Motor
from crankorder.shaft.slip_speed import slip_speed

RATE_HZ, LENGTH_S = 4000, 8.0


@dataclass(frozen=True)
class Rig:
    """A motor on a supply, its slips under the loads tried, the speed that is stated, amplitudes and noise."""

    supply_hz: float
    poles: int
    slips: tuple[float, ...]
    stated_rpm: float
    first: float
    second: float
    twice_mains: float
    noise: float

    @property
    def field_hz(self) -> float:
        return 2.0 * self.supply_hz / self.poles


def drawn(seed: int, *, loads_differ: bool = True) -> Rig:
    rng = np.random.default_rng(seed)
    supply_hz, poles = float(rng.choice([50.0, 60.0])), int(rng.choice([2, 4, 6]))
    apart = np.cumsum(rng.uniform(0.006, 0.015, 3)) if loads_differ else np.full(3, rng.uniform(0.01, 0.04))
    field_rpm = 120.0 * supply_hz / poles
    stated = field_rpm * float(rng.choice([1.0, 0.97]))
    sizes = rng.uniform(0.2, 1.0, 3)
    return Rig(
        supply_hz, poles, tuple(apart + 0.002), round(stated), *sizes.tolist(), noise=float(rng.uniform(0.01, 0.05))
    )


def written(rig: Rig, folder: Path, seed: int) -> Path:
    rng = np.random.default_rng(seed + 1000)
    folder.mkdir()
    time_s = np.arange(int(LENGTH_S * RATE_HZ)) / RATE_HZ
    for number, slip in enumerate(rig.slips):
        shaft_hz = rig.field_hz * (1.0 - slip)
        parts = ((shaft_hz, rig.first), (2.0 * shaft_hz, rig.second), (2.0 * rig.supply_hz, rig.twice_mains))
        signal = sum(size * np.cos(2.0 * np.pi * hertz * time_s + rng.uniform(0.0, 6.0)) for hertz, size in parts)
        with h5py.File(folder / f"load{number}.h5", "w") as file:
            file["a"] = signal + rig.noise * rng.standard_normal(time_s.size)
            file["a"].attrs["rate_hz"] = RATE_HZ
    (folder / "run.toml").write_text(
        f"""schema_version = 1
[test]
name = "loads"
cycle = "rotor"
[recordings]
files = ["*.h5"]
[[channels]]
name = "A"
source = "a"
unit = "mm/s"
[encoder]
kind = "constant"
speed_rpm = {rig.stated_rpm}
[motor]
supply_hz = {rig.supply_hz}
poles = {rig.poles}
""",
        encoding="utf-8",
    )
    return folder


def found_of(rig: Rig, place: Path, seed: int) -> dict[str, Any]:
    done = CliRunner().invoke(main, ["run", str(written(rig, place / "in", seed)), "--out", str(place / "out"), "-q"])
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads((place / "out" / "loads" / "findings.json").read_bytes())
    return found


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(5))
def test_each_load_has_its_own_speed_and_order_1_keeps_its_size(tmp_path: Path, seed: int) -> None:
    rig = drawn(seed)
    found = found_of(rig, tmp_path, seed)
    truth = sorted(60.0 * rig.field_hz * (1.0 - slip) for slip in rig.slips)
    assert found["speed_range_rpm"] == pytest.approx([truth[0], truth[-1]], abs=5.0)  # like speeds share a row
    sizes = {round(one["order"], 3): one["amplitude"] for one in found["orders"] if "mains" not in one["explained_by"]}
    assert sizes[1.0] == pytest.approx(rig.first, rel=0.05)
    assert not [order for order in sizes if abs(order - round(order)) > 0.005]
    twice = [one for one in found["motor"]["lines"] if one["name"] == "twice mains"]
    assert twice and twice[0]["amplitude"] == pytest.approx(rig.twice_mains, rel=0.05)
    told = [one for one in found["quality"] if one["flag"] == "speed_read_from_slip"]
    assert [one["recording"] for one in told] == [f"load{number}.h5" for number in range(len(rig.slips))]
    assert {one["severity"] for one in told} == {"suspect"}


def test_loads_that_are_alike_keep_the_stated_speed(tmp_path: Path) -> None:
    rig = drawn(11, loads_differ=False)
    found = found_of(rig, tmp_path, 11)
    assert not [one for one in found["quality"] if one["flag"] == "speed_read_from_slip"]
    assert found["speed_range_rpm"] == [rig.stated_rpm] * 2


@pytest.mark.cases(2)
@pytest.mark.parametrize("seed", range(20))
def test_noise_mains_and_two_lines_alike_tell_no_speed(seed: int) -> None:
    rng, motor = np.random.default_rng(seed), Motor(supply_hz=50.0, poles=4)
    time_s = np.arange(40_000) / 4000.0
    noise = rng.standard_normal((2, time_s.size))
    assert slip_speed(noise, 4000.0, motor) is None
    mains = sum(np.cos(2.0 * np.pi * 50.0 * k * time_s + k) for k in (1, 2, 3))
    assert slip_speed(noise + mains, 4000.0, motor) is None
    low, high = rng.uniform(23.0, 23.6), rng.uniform(24.0, 24.8)
    alike = np.cos(2.0 * np.pi * low * time_s) + rng.uniform(0.5, 1.0) * np.cos(2.0 * np.pi * high * time_s)
    assert slip_speed(0.1 * noise + alike, 4000.0, motor) is None
    assert slip_speed(np.zeros((1, 40_000)), 4000.0, motor) is None
