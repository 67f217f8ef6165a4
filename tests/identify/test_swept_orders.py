"""Lines of few periods in a frame: half orders of fast run-ups and slow shafts are named, or it is said why not."""

import numpy as np
import pytest

from made.command import done, findings_in
from made.recordings import write_manifest, write_table


def folder_of(folder, lines, *, rate_hz, rpm, noise=0.0):
    """Folder of a recording of ``lines`` (amplitude by order) at the speed ``rpm`` (samples,), which is a channel."""
    tables = {"sampling": {"time_source": "t"}, "encoder": {"source": "rpm", "kind": "speed"}}
    write_manifest(folder, "*.csv", channels={"Z": {"source": "z"}}, **tables)
    time_s = np.arange(len(rpm)) / rate_hz
    turns = np.concatenate([[0.0], np.cumsum(0.5 * (rpm[1:] + rpm[:-1])) / 60.0 / rate_hz])
    signal = noise * np.random.default_rng(1).standard_normal(len(rpm))
    signal = signal + sum(size * np.cos(2 * np.pi * order * turns + order) for order, size in lines.items())
    write_table(folder / "a.csv", {"t": time_s, "rpm": rpm, "z": signal})
    return folder


def run(folder, *options):
    """Findings of the test in ``folder`` and what the command says of it."""
    out = folder.with_name(f"{folder.name}-out")
    said = done("run", folder, "--out", out, "--no-pictures", "--jobs", 1, "--fresh", *options).output
    return findings_in(out), said


def sizes_of(findings):
    return {round(one["order"], 2): one["amplitude"] for one in findings["orders"]}


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_run_up_names_its_half_order_with_and_without_a_floor(tmp_path, noise):
    lines = {0.5: 0.5, 1.0: 1.0, 4.0: 2**0.5, 6.0: 2.0}
    rpm = np.linspace(600.0, 2400.0, 3001)
    findings, _ = run(folder_of(tmp_path / "in", lines, rate_hz=600.0, rpm=rpm, noise=noise))
    assert sizes_of(findings) == pytest.approx(lines, rel=0.02)


@pytest.mark.parametrize("lines", [{0.13: 3.0, 0.2: 2.0}, {0.05: 3.0}])
def test_slow_lines_of_a_sweep_are_told_as_they_were_followed(tmp_path, lines):
    rpm = np.interp(np.arange(12_000), [0, 1000, 5500, 6500, 11_000, 12_000], [600, 600, 3000, 3000, 600, 600])
    findings, said = run(folder_of(tmp_path / "in", lines, rate_hz=200.0, rpm=rpm, noise=0.02))
    assert sizes_of(findings) == pytest.approx(lines, rel=0.03)
    assert "No order stands above the noise" not in said and "tell no order" not in said


def test_below_the_lowest_order_of_its_frames_it_is_said_which_frames_tell(tmp_path):
    folder = folder_of(tmp_path / "in", {0.05: 3.0}, rate_hz=200.0, rpm=np.full(8000, 1500.0), noise=0.05)
    findings, said = run(folder)
    assert not findings["orders"]
    assert "Below order 0.16 stands a slow line" in said and "revs_per_frame = 128 in a recipe" in said
    recipe = tmp_path / "long.toml"
    recipe.write_text("[orders]\nrevs_per_frame = 128\n", encoding="utf-8")
    findings, said = run(folder, "--recipe", recipe)
    assert sizes_of(findings) == pytest.approx({0.05: 3.0}, rel=0.02)
    assert "tell no order" not in said
    higher = folder_of(tmp_path / "higher", {0.3: 3.0}, rate_hz=200.0, rpm=np.full(8000, 1500.0), noise=0.05)
    findings, said = run(higher, "-q")  # its skirt reaches order 0
    assert [one["flag"] for one in findings["quality"] if one["flag"] == "slow_lines"] == []
