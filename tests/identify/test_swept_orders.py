"""Run-ups and run-downs: no locked order is said to slip, no slip to be locked, and the strongest order is found."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from crankorder.identify.lines.line_phasors import sure_half_width
from crankorder.identify.lines.order_lines import swept_orders
from crankorder.orders.frames import order_frames
from crankorder.orders.swept_tracks import followed_tracks
from crankorder.settings import load_settings
from made.command import done, findings_in
from made.line_frames import agreed_in
from made.recordings import manifest
from made.swept_machines import drawn, recorded

SETTINGS = load_settings()
SWEEPS = {
    "up in 8 s": {}, "down in 8 s": {"rpm": (6000.0, 600.0)},
    "down in 5 s past eight modes": {"modes": 8, "rpm": (6000.0, 800.0), "duration_s": 5.0},
    "up in 60 s": {"rpm": (600.0, 4000.0), "duration_s": 60.0}, "up, 0.3 % slip": {"slip": 0.003, "duration_s": 20.0},
    "up past eight modes, 0.3 % slip": {"slip": 0.003, "modes": 8, "duration_s": 20.0}, "up, 1 % slip": {"slip": 0.01},
    "down, 2 % slip": {"slip": 0.02, "rpm": (5000.0, 800.0), "duration_s": 20.0},
}  # fmt: skip


def judged(name, seed):
    """What was said of the orders of one machine, by what they are, and whether its strongest one was found."""
    rng = np.random.default_rng([seed, *name.encode()])
    machine = drawn(rng, **SWEEPS[name])
    frames = order_frames(*recorded(machine, rng), settings=SETTINGS.orders)
    found = agreed_in([frames])
    true = machine.orders * (1.0 - machine.slip)
    said: Counter[tuple[str, str]] = Counter()
    for item in found:
        nearest = int(np.argmin(np.abs(true - item.order)))
        if abs(true[nearest] - item.order) < 0.1:
            said["slips" if machine.slip[nearest] else "locked", item.lock] += 1
        else:
            said["made up", item.lock] += 1
    size = [float(np.abs(frames["spectrum"].sel(order=order, method="nearest")).max()) for order in true]
    strongest = true[int(np.argmax(size))]
    return said, any(abs(item.order - strongest) < 0.05 for item in found)


@pytest.mark.parametrize("name", SWEEPS)
def test_modes_that_are_crossed_turn_no_locked_order_into_a_slip_and_hide_no_slip(name):
    said: Counter[tuple[str, str]] = Counter()
    for seed in range(3):
        of_machine, strongest_found = judged(name, seed)
        said += of_machine
        assert strongest_found
    assert said["locked", "slips"] == 0
    assert said["slips", "locked"] == 0
    assert said["made up", "slips"] + said["made up", "locked"] == 0
    for kind, promised in (("locked", True), ("slips", "slip" in SWEEPS[name])):
        total = sum(count for (what, _), count in said.items() if what == kind)
        assert (total > 0) == promised
        assert said[kind, kind] >= 0.4 * total  # silence is no answer


# Two orders of a sweep in one bin: both are found and named as they are, and none is made up.


def told(machine, rng):
    """What is said of the orders of ``machine`` from its frames and its tracks."""
    band, shaft = recorded(machine, rng)
    frames = order_frames(band, shaft, settings=SETTINGS.orders)
    out = swept_orders(frames, settings=SETTINGS)
    tracks = followed_tracks(band, shaft, settings=SETTINGS.orders, swept=True, standing_out=out)
    return agreed_in([frames], followed=[tracks])


def pair(seed):
    """A machine of one multiple and one order beside it, and both numbers."""
    rng = np.random.default_rng([seed, 77])
    base, slip = float(rng.integers(4, 13)) / 2.0, float(rng.choice([-1.0, 1.0]) * rng.uniform(0.007, 0.015))
    machine = drawn(rng, rpm=(800.0, 4200.0) if seed % 2 else (4200.0, 800.0), duration_s=20.0)
    made = replace(
        machine, orders=np.array([base, base]), size=np.exp(rng.uniform(np.log(0.3), 0.0, 2)),
        slip=np.array([0.0, slip]), noise=0.05,
    )  # fmt: skip
    return made, rng, base, base * (1.0 - slip)


@pytest.mark.slow
def test_two_close_orders_are_both_found_and_neither_is_called_what_it_is_not():
    both = 0
    for seed in range(3):
        machine, rng, base, slipping = pair(seed)
        found = told(machine, rng)
        for item in found:
            true = min((base, slipping), key=lambda number: abs(number - item.order))
            assert item.lock in ("undecided", "locked" if true == base else "slips"), (seed, item.order, item.lock)
            if item.lock == "slips":
                assert abs(item.order - true) <= sure_half_width(item.order_error, item.degrees_of_freedom)
        near = [min(abs(item.order - true) for item in found) < 1e-3 * true for true in (base, slipping)]
        both += len(found) == 2 and all(near)
    assert both >= 2


@pytest.mark.slow
def test_a_mode_that_rings_on_at_its_own_frequency_is_no_second_order():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        machine = replace(
            drawn(rng, rpm=(1057.0, 1336.0), duration_s=5.8, modes=1), orders=np.array([1.5, 5.5]),
            size=np.array([1.0, 0.5]), slip=np.zeros(2), natural_hz=np.array([27.4]), damping=np.array([0.005]),
            shares=np.array([[1.0], [0.7], [-0.5]]),
        )  # fmt: skip
        assert [item.order for item in told(machine, rng) if item.lock == "slips"] == []
        frames = order_frames(*recorded(machine, rng), settings=SETTINGS.orders)
        out = swept_orders(frames, settings=SETTINGS)
        assert np.allclose(out, [1.5, 5.5], atol=0.03), out


# Lines of few periods in a frame: half orders of fast run-ups and slow shafts are named, or it is said why not.


MANIFEST = manifest(
    "*.csv", channels={"Z": {"source": "z"}}, sampling={"time_source": "t"}, encoder={"source": "rpm", "kind": "speed"},
)  # fmt: skip


def folder_of(folder, lines, *, rate_hz, rpm, noise=0.0):
    """Folder of a recording of ``lines`` (amplitude by order) at the speed ``rpm`` (samples,), which is a channel."""
    folder.mkdir()
    time_s = np.arange(len(rpm)) / rate_hz
    turns = np.concatenate([[0.0], np.cumsum(0.5 * (rpm[1:] + rpm[:-1])) / 60.0 / rate_hz])
    signal = noise * np.random.default_rng(1).standard_normal(len(rpm))
    signal = signal + sum(size * np.cos(2 * np.pi * order * turns + order) for order, size in lines.items())
    columns = np.column_stack((time_s, rpm, signal))
    np.savetxt(folder / "a.csv", columns, delimiter=",", fmt="%.9g", header="t,rpm,z", comments="")
    (folder / "run.toml").write_text(MANIFEST, encoding="utf-8")
    return folder


def run(folder, *options):
    """Findings of the test in ``folder`` and what the command says of it."""
    out = folder.with_name(f"{folder.name}-out")
    said = done("run", folder, "--out", out, "--no-pictures", "--jobs", 1, "--fresh", *options).output
    return findings_in(out), said


def sizes_of(findings):
    return {round(one["order"], 2): one["amplitude"] for one in findings["orders"]}


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-4, 1e-3, 0.01])
def test_a_run_up_names_its_half_order_with_and_without_a_floor(tmp_path, noise):
    lines = {0.5: 0.5, 1.0: 1.0, 4.0: 2**0.5, 6.0: 2.0}
    rpm = np.linspace(600.0, 2400.0, 3001)
    findings, _ = run(folder_of(tmp_path / "in", lines, rate_hz=600.0, rpm=rpm, noise=noise))
    assert sizes_of(findings) == pytest.approx(lines, rel=0.02)


@pytest.mark.parametrize("lines", [{0.13: 3.0, 0.2: 2.0}, {0.05: 3.0}, {1.0: 1.0}])
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
