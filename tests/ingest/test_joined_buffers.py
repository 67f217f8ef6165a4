"""Recordings in pieces: a logger that stops for a while and says so, and buffers joined with turns lost between."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_recording
from crankorder.quantities import flags_of
from made.command import analysed, crankorder, done

HEAD = """schema_version = 1
[test]
name = "pieces"
cycle = "rotor"
[recordings]
files = ["a.*"]
"""
CHANNEL = '[[channels]]\nname = "k"\nsource = "k"\nunit = "m/s2"\n'
ENCODER = '[encoder]\nkind = "square"\nsource = "tacho"\npulses_per_rev = 1\n'


def written(folder: Path, suffix: str, **columns: np.ndarray) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / f"a.{suffix}"
    if suffix == "mat":
        savemat(path, columns)
    elif suffix == "h5":
        with h5py.File(path, "w") as file:
            for name, column in columns.items():
                file[name] = column
    else:
        np.savetxt(
            path, np.stack(list(columns.values()), axis=1), delimiter=",", header=",".join(columns), comments="",
            fmt="%.6f",
        )  # fmt: skip
    return folder


def turning(turns: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A signal of orders 1, 2 and 2.5 (1.0, 0.5 and 0.4) and a mark once a turn."""
    noise = 0.02 * np.random.default_rng(seed).standard_normal(turns.size)
    signal = np.cos(2 * np.pi * turns) + 0.5 * np.cos(4 * np.pi * turns + 1.0) + 0.4 * np.cos(5 * np.pi * turns)
    return signal + noise, np.where(turns % 1.0 < 0.2, 3.3, 0.0)


def seen(findings: dict) -> dict[int, float]:
    return {round(order["order"], 1): order["amplitude"] for order in findings["orders"]}


def flagged(findings: dict) -> dict[str, str]:
    return {one["flag"]: one["detail"] for one in findings["quality"]}


def polled(seed: int) -> tuple[np.ndarray, float]:
    """Times of a logger at 615 Hz that stops by some samples and a part of one, another part each time; the speed."""
    rng = np.random.default_rng(seed)
    steps = np.full(9000, 1.0)
    steps[1500::1500] = rng.uniform(1.2, 14.0, 5)
    return np.cumsum(steps) / 615.0, float(rng.uniform(1200.0, 1600.0))


def test_stretches_shorter_than_a_frame_are_refused_with_the_frames_that_would_do(tmp_path):
    times = np.arange(20_000)[np.arange(20_000) % 600 < 540] / 1000.0
    signal, tacho = turning(25.0 * times, 1)
    folder = written(tmp_path / "in", "csv", time_s=times, k=signal, tacho=tacho)
    (folder / "run.toml").write_text(f'{HEAD}[sampling]\ntime_source = "time_s"\n{CHANNEL}{ENCODER}')
    refused = crankorder("run", folder, "--out", tmp_path / "out")
    assert refused.exit_code == 4, refused.output
    assert "revs_per_frame = 6" in refused.output and "13.5 between gaps" in refused.output


def test_a_speed_goes_on_through_gaps(tmp_path):
    times, rpm = polled(4)
    signal, _ = turning(rpm / 60.0 * times, 4)
    folder = written(tmp_path / "in", "csv", time_s=times, k=signal, tacho=np.full(times.size, rpm))
    (folder / "run.toml").write_text(
        f'{HEAD}[sampling]\ntime_source = "time_s"\n{CHANNEL}[encoder]\nkind = "speed"\nsource = "tacho"\n'
    )
    assert seen(analysed(folder, tmp_path / "out", "--no-pictures"))[1.0] == pytest.approx(1.0, rel=0.015)


@pytest.mark.parametrize("suffix", ["csv", "mat", "h5"])
def test_stretches_between_gaps_of_parts_of_a_sample_come_at_their_true_times(tmp_path, suffix):
    times, rpm = polled(3)
    signal, tacho = turning(rpm / 60.0 * times, 3)
    folder = written(tmp_path / "in", suffix, time_s=times, k=signal, tacho=tacho)
    (folder / "run.toml").write_text(f'{HEAD}[sampling]\ntime_source = "time_s"\n{CHANNEL}{ENCODER}')
    found = analysed(folder, tmp_path / "out", "--no-pictures")
    assert seen(found) == pytest.approx({1: 1.0, 2: 0.5, 2.5: 0.4}, rel=0.015)
    assert found["orders"][0]["speed_rpm_at_max"] == pytest.approx(rpm, rel=1e-3)
    assert "in 5 gaps" in flagged(found)["time_gap"] and "after 1499" in flagged(found)["time_gap"]


def test_a_draft_takes_times_with_gaps_for_times_and_no_wheel_from_them(tmp_path):
    times, rpm = polled(5)
    signal, tacho = turning(rpm / 60.0 * times, 5)
    folder = written(tmp_path / "in", "csv", **{"time_s": times, "acc (m/s2)": signal, "tacho (V)": tacho})
    done("init", folder, "--save")
    draft = (folder / "run.toml").read_text()
    assert 'time_source = "time_s"' in draft and 'source = "acc (m/s2)"' in draft and 'kind = "square"' in draft
    assert not any(line.startswith(("pulses_per_rev", "pattern", "tooth_angles")) for line in draft.splitlines())


def joined(seed: int, blocks: int) -> np.ndarray:
    """Turns at the samples (2560 Hz) of buffers of 1.6 s, parts of a turn lost between them."""
    rng = np.random.default_rng(seed)
    lost = np.cumsum(np.append(0.0, rng.uniform(3.2, 3.8, blocks - 1)))
    samples = np.arange(4096 * blocks)
    return 1160.0 / 60.0 * samples / 2560.0 + lost[samples // 4096]


@pytest.mark.parametrize(("suffix", "blocks"), [("mat", 2), ("csv", 3), ("h5", 6)])
def test_buffers_that_were_joined_are_told_by_shaft_and_channel_and_made_whole(tmp_path, settings, suffix, blocks):
    signal, tacho = turning(joined(2, blocks), 2)
    folder = written(tmp_path / "in", suffix, k=signal, tacho=tacho)
    (folder / "run.toml").write_text(f"{HEAD}[sampling]\nrate_hz = 2560.0\n{CHANNEL}{ENCODER}")
    found = analysed(folder, tmp_path / "out", "--no-pictures")
    amplitudes = seen(found)
    # which of two turns goes on behind a break is not known
    assert amplitudes.pop(2.5) == pytest.approx(0.4, rel=0.05)
    assert amplitudes == pytest.approx({1: 1.0, 2: 0.5}, rel=0.01)
    assert found["orders"][0]["speed_range_rpm"] == pytest.approx([1160.0, 1160.0], rel=2e-3)
    assert "sample 4096 " in flagged(found)["buffers_joined"]
    path = next(folder.glob(f"*.{suffix}"))
    recording = read_recording(path, load_manifest(folder), settings=settings.ingest, shaft=settings.shaft)
    assert len(recording.attrs["gap_starts_s"]) == blocks - 1


@pytest.mark.parametrize("fault", ["lost pulse", "false pulse", "moved pulse and knock", "tacho alone", "misfire"])
def test_what_shaft_or_channel_shows_alone_is_no_break(tmp_path, settings, fault):
    rng = np.random.default_rng(7)
    speed = np.full(20_000, 20.0 / 2560.0)
    if fault == "misfire":
        speed[9000:] *= 1.0 - 0.1 * np.exp(-np.arange(11_000) / 200.0)
    turns = np.cumsum(speed)
    signal, tacho = turning(turns, 7)
    at = int(np.flatnonzero((tacho[1:] > 1) & (tacho[:-1] < 1))[40])
    if fault == "lost pulse":
        tacho[at : at + 40] = 0.0
    if fault == "false pulse":
        tacho[at + 60 : at + 70] = 3.3
    if fault == "moved pulse and knock":
        tacho[at - 20 : at + 40] = np.roll(tacho[at - 20 : at + 40], -18)
        signal[at : at + 200] += 4.0 * np.exp(-np.arange(200) / 30.0) * rng.standard_normal(200)
    if fault == "tacho alone":
        tacho = np.append(tacho[: at + 60], tacho[at + 20 : -40])
    folder = written(tmp_path, "h5", k=signal, tacho=tacho)
    (folder / "run.toml").write_text(f"{HEAD}[sampling]\nrate_hz = 2560.0\n{CHANNEL}{ENCODER}")
    recording = read_recording(folder / "a.h5", load_manifest(folder), settings=settings.ingest, shaft=settings.shaft)
    assert "buffers_joined" not in {one["flag"] for one in flags_of(recording)}
