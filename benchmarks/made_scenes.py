"""Frames of a scene whose shaft is known exactly: its sensors' signals without files, encoder and decimation."""

from dataclasses import dataclass
from typing import Any

import xarray as xr

from crankorder.campbell.frames import frequency_frames
from crankorder.orders.frames import order_frames
from crankorder.settings import Settings
from crankorder.synth.lines import start_angle_rev
from crankorder.synth.load import load_scene
from crankorder.synth.noise import floor_of
from crankorder.synth.parts import Speeds, TimeSampling
from crankorder.synth.recording import sensed
from crankorder.synth.scene import Scene
from crankorder.synth.write import truth_of
from made.recordings import held, sampled


@dataclass(frozen=True)
class MadeScene:
    """Frames by order and by frequency of all recordings of a scene, and what was put in."""

    by_order: list[xr.Dataset]
    by_frequency: list[xr.Dataset]
    truth: dict[str, Any]


def scene_named(name: str, *, seed: int, speeds_rpm: list[float], duration_s: float, rate_hz: float) -> Scene:
    """The shipped scene ``name`` with another seed, speeds, length and rate, no encoder and no faults."""
    sampling = TimeSampling(domain="time", rate_hz=rate_hz, duration_s=duration_s)
    speeds = Speeds(list_rpm=tuple(speeds_rpm))
    return _differing(load_scene(name), seed=seed, sampling=sampling, speeds=speeds, encoder=None)


def _differing(scene: Scene, **differences: object) -> Scene:
    return Scene.model_construct(**{**{key: getattr(scene, key) for key in Scene.model_fields}, **differences})


def without_orders(scene: Scene) -> Scene:
    """``scene`` with its structure and noise alone: no engine forces, no injected orders, no bearing lines."""
    return _differing(scene, engine_forces=None, injected_orders=(), bearing_lines=())


def made_scene(scene: Scene, settings: Settings) -> MadeScene:
    """Frames of every recording of the steady ``scene``, as ``settings`` of orders and campbell ask."""
    floor = floor_of(scene, scene.rate_hz(scene.runs[0].speed_rpm))
    by_order, by_frequency = [], []
    for run in scene.runs:
        signals = sensed(scene, run, floor)
        recording = sampled(signals, rate_hz=scene.rate_hz(scene.runs[0].speed_rpm))
        recording = recording.assign_coords(channel=list(scene.channel_names))
        seconds = scene.n_samples / scene.rate_hz(run.speed_rpm)
        known = held(run.speed_rpm, seconds, start_rev=start_angle_rev(scene, run))
        by_order.append(order_frames(recording, known, settings=settings.orders))
        by_frequency.append(frequency_frames(recording, known, settings=settings.campbell))
    return MadeScene(by_order, by_frequency, dict(truth_of(scene)))
