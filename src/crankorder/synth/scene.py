"""A scene: an engine, speeds, sensors and only the effects that a synthetic test needs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from crankorder.engine.definition import Engine
from crankorder.engine.forces import DIRECTIONS
from crankorder.engine.harmonics import orders_for
from crankorder.synth.effects import (
    BearingLine,
    Broadband,
    ByChannel,
    ByDirection,
    Channel,
    CrankAngleSampling,
    Encoder,
    EngineForces,
    InjectedOrder,
    Mode,
    Part,
    Quick,
    SensorNoise,
    Speeds,
    TimeSampling,
)
from crankorder.synth.response import Structure


@dataclass(frozen=True)
class Run:
    """One recording to be made: its name (file stem) and speed."""

    name: str
    speed_rpm: float


class Scene(Part):
    """A whole scene; an effect that is absent costs nothing."""

    schema_version: Literal[1]
    title: Annotated[str, Field(min_length=1, max_length=200)]
    engine_file: str
    engine: Engine
    seed: Annotated[int, Field(ge=0)]
    sampling: TimeSampling | CrankAngleSampling = Field(discriminator="domain")
    speeds: Speeds
    quick: Quick = Quick()
    channels: tuple[Channel, ...] = Field(min_length=1, strict=False)
    modes: tuple[Mode, ...] = Field(default=(), strict=False)
    rigid_body_per_kg: dict[str, ByDirection] = Field(default_factory=dict)
    engine_forces: EngineForces | None = None
    injected_orders: tuple[InjectedOrder, ...] = Field(default=(), strict=False)
    bearing_lines: tuple[BearingLine, ...] = Field(default=(), strict=False)
    broadband: Broadband | None = None
    sensor_noise: SensorNoise | None = None
    encoder: Encoder | None = None

    @cached_property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the channels in their sequence."""
        return tuple(channel.name for channel in self.channels)

    @cached_property
    def structure(self) -> Structure:
        """Modes and rigid-body part as arrays."""
        return Structure(
            frequency_hz=np.array([mode.frequency_hz for mode in self.modes]),
            damping_ratio=np.array([mode.damping_ratio for mode in self.modes]),
            sensor_per_kg=np.array([self.by_channel(mode.sensor_per_kg) for mode in self.modes]),
            drive=np.array([[mode.drive.get(axis, 0.0) for axis in DIRECTIONS] for mode in self.modes]),
            rigid_body_per_kg=np.array(
                [
                    [self.rigid_body_per_kg.get(name, {}).get(axis, 0.0) for axis in DIRECTIONS]
                    for name in self.channel_names
                ]
            ),
        )

    @cached_property
    def highest_engine_order(self) -> int:
        """Highest order of the engine's forces that the tolerance needs; 0 where the scene has none."""
        return orders_for(self.engine_forces.tolerance, self.engine.mechanism) if self.engine_forces else 0

    @cached_property
    def runs(self) -> tuple[Run, ...]:
        """The recordings, named by speed; a speed that comes again gets a number."""
        seen: dict[str, int] = {}
        runs = []
        for speed in self.speeds.rpm:
            whole, _, rest = f"{speed:.6f}".partition(".")
            stem = f"rpm_{whole:0>4}" + (f".{rest.rstrip('0')}" if rest.strip("0") else "")
            seen[stem] = seen.get(stem, 0) + 1
            runs.append(Run(stem if seen[stem] == 1 else f"{stem}_{seen[stem]}", speed))
        return tuple(runs)

    def by_channel(self, values: ByChannel) -> NDArray[np.float64]:
        """``values`` in the sequence of the channels, zero where a channel is not named, shape (channel,)."""
        return np.array([values.get(name, 0.0) for name in self.channel_names])

    def rate_hz(self, speed_rpm: float) -> float:
        """Samples per second at ``speed_rpm``."""
        if isinstance(self.sampling, TimeSampling):
            return self.sampling.rate_hz
        return self.sampling.samples_per_rev * speed_rpm / 60

    @property
    def n_samples(self) -> int:
        """Samples of a channel of one recording."""
        if isinstance(self.sampling, TimeSampling):
            return max(1, round(self.sampling.rate_hz * self.sampling.duration_s))
        return self.sampling.samples_per_rev * self.sampling.revs

    def first_look(self) -> Scene:
        """The same scene with the differences of its ``quick`` table."""
        length = {"duration_s": self.quick.duration_s, "revs": self.quick.revs}
        update = {key: value for key, value in length.items() if value is not None and hasattr(self.sampling, key)}
        differences = {"sampling": self.sampling.model_copy(update=update), "speeds": self.quick.speeds or self.speeds}
        return Scene.model_construct(**{**{key: getattr(self, key) for key in Scene.model_fields}, **differences})
