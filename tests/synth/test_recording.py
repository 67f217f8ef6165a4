"""Recordings against the formulas that define them, and the independence of the effects from each other."""

from collections.abc import Callable

import numpy as np
import pytest

from crankorder.engine.forces import DIRECTIONS, crankcase_forces
from crankorder.synth.lines import order_lines
from crankorder.synth.load import load_scene
from crankorder.synth.recording import broadband_response, start_angle_rev, synthesise
from crankorder.synth.scene import Run, Scene
from crankorder.synth.truth import truth_of

SceneWith = Callable[..., Scene]
SIGNAL_EFFECTS = ("engine_forces", "injected_orders", "bearing_lines", "broadband", "sensor_noise")


def signal_of(scene: Scene, run: Run) -> np.ndarray:
    return synthesise(scene, run, broadband_response(scene, scene.rate_hz(run.speed_rpm))).signal


def test_the_engine_alone_gives_the_steady_state_of_every_mode_to_every_order(scene_with: SceneWith) -> None:
    scene = scene_with("engine_forces")
    run = scene.runs[1]
    n_samples, omega = scene.n_samples, run.speed_rpm * np.pi / 30
    turn = start_angle_rev(scene, run) + run.speed_rpm / 60 * np.arange(n_samples) / 8000.0
    force = crankcase_forces(scene.engine, run.speed_rpm, max_order=scene.highest_engine_order)[DIRECTIONS.index("Z")]
    expected = np.zeros((2, n_samples))
    for order in range(1, force.size):
        w = order * omega
        z = 0.003 * force[order]
        y = 0.0
        for natural_hz, damping, to_y, to_z, drive in ((60, 0.02, 0.006, 0.01, -0.3), (230, 0.01, 0.0, 0.012, 0.2)):
            wn = 2 * np.pi * natural_hz
            answer = drive * force[order] * -(w**2) / (wn**2 - w**2 + 2j * damping * wn * w)
            y, z = y + to_y * answer, z + to_z * answer
        expected += (np.array([[y], [z]]) * np.exp(2j * np.pi * order * turn)).real
    peak = np.abs(expected).max()
    assert np.abs(signal_of(scene, run) - expected).max() < 6e-8 * peak  # float32 of the file


def test_effects_add_up_and_do_not_know_of_each_other(scene_with: SceneWith) -> None:
    together = scene_with(*SIGNAL_EFFECTS)
    alone = [scene_with(effect) for effect in SIGNAL_EFFECTS]
    for run in together.runs:
        parts = [signal_of(scene, run).astype(np.float64) for scene in alone]
        assert all(part.any() for part in parts)
        whole = signal_of(together, run)
        assert np.abs(whole - sum(parts)).max() < 5e-7 * np.abs(whole).max()


def test_a_recording_does_not_depend_on_the_others_but_differs_from_its_repetition(scene_with: SceneWith) -> None:
    scene = scene_with(*SIGNAL_EFFECTS)
    first, _, again = scene.runs
    fewer = scene.model_copy(update={"speeds": scene.quick.speeds})
    assert np.array_equal(signal_of(scene, first), signal_of(fewer, fewer.runs[0]))
    assert first.speed_rpm == again.speed_rpm
    assert not np.array_equal(signal_of(scene, first), signal_of(scene, again))


def test_another_seed_changes_only_what_is_random(scene_with: SceneWith) -> None:
    scene = scene_with("engine_forces")
    other = scene.model_copy(update={"seed": 8})
    run = scene.runs[0]
    one, two = (order_lines(part, run) for part in (scene, other))
    assert np.array_equal(one.amplitude, two.amplitude)
    assert start_angle_rev(scene, run) != start_angle_rev(other, run)


def test_the_broadband_floor_has_the_density_that_the_truth_states(scene_with: SceneWith) -> None:
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


def test_samples_by_crank_angle_are_the_lines_at_their_angles() -> None:
    scene = load_scene("thesis-first-motoring").first_look()
    quiet = scene.model_copy(update={"broadband": None, "sensor_noise": None})
    run = quiet.runs[2]
    lines = order_lines(quiet, run)
    turn = np.arange(quiet.n_samples) / 360
    expected = (lines.amplitude @ np.exp(2j * np.pi * lines.order[:, None] * turn)).real
    recording = synthesise(quiet, run, None)
    assert np.abs(recording.signal - expected).max() < 6e-8 * np.abs(expected).max()
    assert recording.encoder is recording.index is None
