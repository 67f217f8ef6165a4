"""Recordings against the formulas that define them, and the independence of the effects from each other."""

from collections.abc import Callable

import numpy as np
import pytest

from crankorder.engine.forces import DIRECTIONS, crankcase_forces
from crankorder.synth.lines import crank_motion, start_angle_rev
from crankorder.synth.load import load_scene
from crankorder.synth.noise import floor_of
from crankorder.synth.parts import Acquisition, InCycleSpeed, SpeedOrder, SpeedProfile, Wander
from crankorder.synth.recording import sensed
from crankorder.synth.scene import Scene
from crankorder.synth.write import truth_of

SceneWith = Callable[..., Scene]
DRIVEN = ("engine_forces", "gas_torque", "injected_orders")
EFFECTS = (*DRIVEN, "bearing_lines", "bearing_impacts", "tones", "coloured_noise", "broadband", "sensor_noise")
IN_CYCLE = InCycleSpeed(
    by_order=(SpeedOrder(order=0.5, percent=1.0), SpeedOrder(order=2.0, percent=1.5, phase_deg=40.0))
)
FIVE_TO_EIGHT_HUNDRED = SpeedProfile(rpm=(500.0, 800.0, 650.0), time_s=(0.4, 2.0, 2.7))
MOTIONS = {
    "steady": {}, "wander": {"speed_wander": Wander(std_rpm=2.0, corner_hz=1.0)},
    "in cycle": {"in_cycle_speed": IN_CYCLE}, "profile": {"speeds": None, "speed_profile": FIVE_TO_EIGHT_HUNDRED},
    "profile in cycle": {"speeds": None, "speed_profile": FIVE_TO_EIGHT_HUNDRED, "in_cycle_speed": IN_CYCLE},
}  # fmt: skip


def signal_of(scene, run):
    return sensed(scene, run, floor_of(scene, scene.rate_hz(run.speed_rpm)))


def test_the_engine_alone_gives_the_steady_state_of_every_mode_to_every_order(scene_with):
    scene = scene_with("engine_forces")
    run = scene.runs[1]
    turn = start_angle_rev(scene, run) + run.speed_rpm / 60 * np.arange(scene.n_samples) / 8000.0
    force = crankcase_forces(scene.engine, run.speed_rpm, max_order=scene.highest_engine_order)[DIRECTIONS.index("Z")]
    order = np.arange(force.size)
    response = np.array([0.0 * force, 0.003 * force])
    w = 2 * np.pi * order * run.speed_rpm / 60
    for natural_hz, damping, sensors, drive in ((60, 0.02, (0.006, 0.01), -0.3), (230, 0.01, (0.0, 0.012), 0.2)):
        wn = 2 * np.pi * natural_hz
        response += np.outer(sensors, drive * force * -(w**2) / (wn**2 - w**2 + 2j * damping * wn * w))
    expected = (response[:, 1:] @ np.exp(2j * np.pi * np.outer(order[1:], turn))).real
    assert np.abs(signal_of(scene, run) - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.cases(2)
@pytest.mark.parametrize("motion", MOTIONS)
def test_effects_add_up_and_do_not_know_of_each_other(scene_with, motion):
    late = Acquisition(low_pass_hz=2500.0, ac_coupling_hz=2.0, delay_s={"Z": 2.3e-4})
    more = {**MOTIONS[motion], "acquisition": late if motion != "steady" else Acquisition()}
    together, quiet = scene_with(*EFFECTS, **more), scene_with(*DRIVEN, **more)
    run = together.runs[0]
    parts = [signal_of(scene_with(effect, **more), run) for effect in EFFECTS]
    assert all(part.any() for part in parts)
    whole, driven = signal_of(together, run), sum(parts[: len(DRIVEN)])
    assert np.abs(whole - sum(parts)).max() < 5e-7 * np.abs(whole).max()  # noise is made in single precision
    assert np.abs(signal_of(quiet, run) - driven).max() < 2e-9 * np.abs(driven).max()


def test_a_late_channel_is_the_same_channel_later(scene_with):
    quiet, motion = (
        [effect for effect in EFFECTS if "noise" not in effect and effect != "broadband"],
        MOTIONS["profile"],
    )
    scenes = [
        scene_with(*quiet, **motion, acquisition=Acquisition(delay_s={"Z": late_s})) for late_s in (0.0, 3 / 8000)
    ]
    on_time, late = (signal_of(scene, scene.runs[0]) for scene in scenes)
    assert np.abs(late[1, 3:] - on_time[1, :-3]).max() < 1e-8 * np.abs(on_time).max()
    assert np.abs(late[0] - on_time[0]).max() < 1e-8 * np.abs(on_time).max()


def test_a_recording_does_not_depend_on_the_others_but_differs_from_its_repetition(scene_with):
    scene = scene_with(*EFFECTS)
    first, _, again = scene.runs
    fewer = scene_with(*EFFECTS, speeds=scene.quick.speeds)
    assert np.array_equal(signal_of(scene, first), signal_of(fewer, fewer.runs[0]))
    assert first.speed_rpm == again.speed_rpm
    assert not np.array_equal(signal_of(scene, first), signal_of(scene, again))
    repeat = scene.runs_of(1)[0]
    assert not np.array_equal(signal_of(scene, first), signal_of(scene, repeat))


def test_the_broadband_floor_has_the_density_that_the_truth_states(scene_with):
    scene = scene_with("broadband", "sensor_noise", "injected_orders")
    long = scene.model_copy(update={"sampling": scene.sampling.model_copy(update={"duration_s": 200.0})})
    run = long.runs[0]
    noise = long.model_copy(update={"injected_orders": ()})
    power = np.abs(np.fft.rfft(signal_of(noise, run).reshape(2, -1, 8000) * np.hanning(8001)[:-1])) ** 2
    density = np.sqrt(2 * power.mean(axis=1) / (8000 * 0.375 * 8000))  # 0.375: mean square of a Hann window
    stated = {order["channel"]: order["floor_density_by_speed"][0] for order in truth_of(long)["orders"]}
    at = round(6.5 * 600 / 60)
    for channel, name in enumerate(long.channel_names):
        measured = np.sqrt(np.mean(density[channel, at - 1 : at + 2] ** 2))
        assert measured == pytest.approx(stated[name], rel=0.15)


@pytest.mark.parametrize("motion", ["steady", "in cycle"])
@pytest.mark.parametrize("domain", ["time", "crank_angle"])
def test_the_truth_is_what_a_sum_over_whole_cycles_finds(scene_with, motion, domain):
    more = MOTIONS[motion]
    if domain == "crank_angle":
        by_angle = load_scene("thesis-first-motoring").sampling.model_copy(update={"samples_per_rev": 720, "revs": 20})
        more = {**more, "sampling": by_angle}
    scene = scene_with("engine_forces", "injected_orders", "bearing_lines", **more)
    run = scene.runs[0]
    signal, whole = signal_of(scene, run), 20  # revolutions: cycles of the engine and of order 5.5 and 6.5 alike
    if domain == "time":
        angle_rev, speed_rpm, _ = crank_motion(scene, run).at(np.arange(scene.n_samples) / 8000.0)
        weight = (
            speed_rpm / 60 / 8000.0 * (angle_rev < angle_rev[0] + whole)
        )  # dφ: the mean over the angle, not over time
        assert angle_rev[-1] > angle_rev[0] + whole
    else:
        angle_rev, weight = np.arange(20 * 720) / 720, 1 / 720
    records = [one for one in truth_of(scene)["orders"] if (one["order"] * whole) % 1 == 0 and one["amplitude"] >= 1e-3]
    assert len(records) >= 4
    for record in records:
        channel = scene.channel_names.index(record["channel"])
        found = 2 / whole * np.sum(signal[channel] * weight * np.exp(-2j * np.pi * record["order"] * angle_rev))
        put_in = record["amplitude_by_speed"][0] * np.exp(1j * np.radians(record["phase_deg_by_speed"][0]))
        # by time the sum over angles begins and ends between samples: what it misses is a sample of a thousand
        allowed = 1e-10 if domain == "crank_angle" else 4e-3 * np.abs(signal[channel]).max() / 10
        assert abs(found - put_in) < allowed
