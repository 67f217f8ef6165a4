"""A scene: an engine, speeds, sensors and only the effects that a synthetic test needs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from crankorder.engine.definition import Engine
from crankorder.engine.slider_crank import orders_for
from crankorder.quantities import Floats
from crankorder.synth import parts
from crankorder.synth.poles import AnalogueFilter, Structure, analogue_filter, true_rate_hz

SWEEP = "sweep"
"""Name of the recording of a speed profile."""


@dataclass(frozen=True)
class Run:
    """One recording to be made: its name (file stem), its speed (of a profile: the highest), and which repeat."""

    name: str
    speed_rpm: float
    repeat: int = 0

    @property
    def stream(self) -> str:
        """Name of the recording for seed streams: every repeat draws anew."""
        return self.name if self.repeat == 0 else f"{self.name}#{self.repeat}"


class Scene(parts.Part):
    """A whole scene; an effect that is absent costs nothing."""

    schema_version: Literal[1]
    title: Annotated[str, Field(min_length=1, max_length=200)]
    engine_file: str
    engine: Engine
    seed: Annotated[int, Field(ge=0)]
    sampling: parts.TimeSampling | parts.CrankAngleSampling = Field(discriminator="domain")
    channels: tuple[parts.Channel, ...] = Field(min_length=1, strict=False)
    speeds: parts.Speeds | None = None
    speed_profile: parts.SpeedProfile | None = None
    repeats: Annotated[int, Field(ge=1, le=1000)] = 1
    quick: parts.Quick = parts.Quick()
    modes: tuple[parts.Mode, ...] = Field(default=(), strict=False)
    rigid_body_per_kg: dict[str, parts.ByAxis] = Field(default_factory=dict)
    other_shafts: tuple[parts.OtherShaft, ...] = Field(default=(), strict=False)
    speed_wander: parts.Wander | None = None
    in_cycle_speed: parts.InCycleSpeed | None = None
    engine_forces: parts.EngineForces | None = None
    gas_torque: parts.GasTorque | None = None
    injected_orders: tuple[parts.InjectedOrder, ...] = Field(default=(), strict=False)
    bearing_lines: tuple[parts.BearingLine, ...] = Field(default=(), strict=False)
    bearing_impacts: tuple[parts.BearingImpacts, ...] = Field(default=(), strict=False)
    tones: tuple[parts.Tone, ...] = Field(default=(), strict=False)
    broadband: parts.Broadband | None = None
    sensor_noise: parts.SensorNoise | None = None
    coloured_noise: tuple[parts.ColouredNoise, ...] = Field(default=(), strict=False)
    acquisition: parts.Acquisition = parts.Acquisition()
    encoder: parts.Encoder | None = None
    encoder_faults: tuple[parts.AnyEncoderFault, ...] = Field(default=(), strict=False)
    signal_faults: tuple[parts.AnySignalFault, ...] = Field(default=(), strict=False)
    wrong_labels: parts.WrongLabels | None = None

    @cached_property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the channels in their sequence."""
        return tuple(channel.name for channel in self.channels)

    @cached_property
    def structure(self) -> Structure:
        """Modes and rigid-body part as arrays."""
        turned = [
            self.by_channel(mode.sensor_per_kg) * np.exp(1j * np.radians(self.by_channel(mode.sensor_phase_deg)))
            for mode in self.modes
        ]
        drive = [[mode.drive.get(axis, 0.0) for axis in parts.AXES] for mode in self.modes]
        rigid = [
            [self.rigid_body_per_kg.get(name, {}).get(axis, 0.0) for axis in parts.AXES] for name in self.channel_names
        ]
        return Structure(
            frequency_hz=np.array([mode.frequency_hz for mode in self.modes]),
            damping_ratio=np.array([mode.damping_ratio for mode in self.modes]),
            sensor_per_kg=np.array(turned, dtype=np.complex128).reshape(len(self.modes), len(self.channels)),
            drive=np.array(drive).reshape(-1, len(parts.AXES)),
            rigid_body_per_kg=np.array(rigid),
        )

    @cached_property
    def filter(self) -> AnalogueFilter | None:
        """What stands between a sensor and the converter; None where nothing does."""
        return analogue_filter(self.acquisition)

    @cached_property
    def highest_engine_order(self) -> int:
        """Highest order of the engine's forces that the tolerance needs; 0 where the scene has none."""
        if not self.engine_forces:
            return 0
        lengths = {single.mechanism for single in self.engine.each}
        return max(orders_for(self.engine_forces.tolerance, mechanism) for mechanism in lengths)

    @cached_property
    def speed_range_rpm(self) -> tuple[float, float]:
        """Lowest and highest speed of all recordings, without wander and in-cycle motion."""
        stated = self.speeds or self.speed_profile
        reached = (0.0,) if stated is None else stated.rpm
        return min(reached), max(reached)

    def runs_of(self, repeat: int) -> tuple[Run, ...]:
        """The recordings of one ``repeat`` (from 0), named by speed; a speed that comes again gets a number."""
        if self.speeds is None:
            return (Run(SWEEP, self.speed_range_rpm[1], repeat),)
        seen: dict[str, int] = {}
        runs = []
        for speed in self.speeds.rpm:
            whole, _, rest = f"{speed:.6f}".partition(".")
            stem = f"rpm_{whole:0>4}" + (f".{rest.rstrip('0')}" if rest.strip("0") else "")
            seen[stem] = seen.get(stem, 0) + 1
            runs.append(Run(stem if seen[stem] == 1 else f"{stem}_{seen[stem]}", speed, repeat))
        return tuple(runs)

    @cached_property
    def runs(self) -> tuple[Run, ...]:
        """The recordings of the first repeat."""
        return self.runs_of(0)

    def by_channel(self, values: parts.ByChannel) -> Floats:
        """``values`` in the sequence of the channels, zero where a channel is not named, shape (channel,)."""
        return np.array([values.get(name, 0.0) for name in self.channel_names])

    def rate_hz(self, speed_rpm: float) -> float:
        """Samples per true second at ``speed_rpm``: the clock's error is in it, the label's is not."""
        if isinstance(self.sampling, parts.TimeSampling):
            return true_rate_hz(self.acquisition, self.sampling.rate_hz)
        return self.sampling.samples_per_rev * speed_rpm / 60

    @property
    def n_samples(self) -> int:
        """Samples of a channel of one recording."""
        if isinstance(self.sampling, parts.TimeSampling):
            return max(1, round(self.sampling.rate_hz * self.sampling.duration_s))
        return self.sampling.samples_per_rev * self.sampling.revs

    def first_look(self) -> Scene:
        """The same scene with the differences of its ``quick`` table."""
        length = {"duration_s": self.quick.duration_s, "revs": self.quick.revs}
        update = {key: value for key, value in length.items() if value is not None and hasattr(self.sampling, key)}
        differences = {
            "sampling": self.sampling.model_copy(update=update),
            "speeds": self.quick.speeds or self.speeds,
            "speed_profile": self.quick.speed_profile or self.speed_profile,
            "repeats": self.quick.repeats or self.repeats,
        }
        return Scene.model_construct(**{**{key: getattr(self, key) for key in Scene.model_fields}, **differences})
