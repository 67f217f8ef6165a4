"""A scene: an engine, speeds, sensors and only the effects that a synthetic test needs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from crankorder.engine.definition import Engine, load_engine
from crankorder.engine.forces import DIRECTIONS
from crankorder.engine.harmonics import orders_for
from crankorder.errors import CrankorderError, ManyErrors, RequestError
from crankorder.settings import toml_table, validation_fault
from crankorder.synth.demands import unmet_demands
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


def load_scene(name: str, beside: Path | None = None) -> Scene:
    """Scene from a shipped file of ``pipeline/scenes`` or a user's TOML file, its engine loaded and everything checked.

    ``name``: a shipped file's stem or the path of a TOML file. ``beside``: folder in which paths are tried first.
    Raises RequestError where there is no such file, ManyErrors with every fault: unknown effects and keys, values out
    of range, names that do not exist, speeds and orders that the sampling cannot carry.
    """
    table, source = toml_table(name, "scenes", beside=beside)
    faults: list[CrankorderError] = []
    if "engine_file" in table:
        faults.append(RequestError("unknown key", file=source, place="engine_file", remedy="Name the engine as engine"))
    folder = beside if beside is not None else Path(name).parent if name.endswith(".toml") else None
    table["engine_file"] = table.get("engine", "")
    try:
        table["engine"] = load_engine(str(table["engine_file"]), folder)
    except ManyErrors as errors:
        faults += errors.faults
    except RequestError as error:
        faults.append(error)
    kept: dict[str, list[int]] = {}
    scene = _validated(table, source, faults, kept)
    if scene is not None:
        faults += unmet_demands(scene, source, kept)
        told = {(fault.problem, fault.place) for fault in faults}
        quick = unmet_demands(scene.first_look(), source, kept)
        faults += [fault for fault in quick if (fault.problem, fault.place) not in told]
    if faults or scene is None:
        raise ManyErrors(faults)
    return scene


def _validated(
    table: dict[str, Any], source: str, faults: list[CrankorderError], kept: dict[str, list[int]]
) -> Scene | None:
    """Scene of ``table``; what is wrong goes to ``faults`` and is left out, so that the rest can be checked too."""
    effects = ", ".join(key for key, field in Scene.model_fields.items() if not field.is_required())
    for _ in range(2):
        try:
            return Scene.model_validate(table)
        except ValidationError as error:
            found = [fault for fault in error.errors() if fault["loc"][:1] != ("engine",)]
            for fault in found:
                text = validation_fault(fault, source)
                if text.problem == "unknown key" and len(fault["loc"]) == 1:
                    text = RequestError("unknown effect", file=source, place=text.place, allowed=effects)
                faults.append(text)
            if len(found) < error.error_count() or not _without(table, [fault["loc"] for fault in found], kept):
                return None
    return None


def _without(table: dict[str, Any], places: list[tuple[int | str, ...]], kept: dict[str, list[int]]) -> bool:
    """Whether every effect (or item of a list) at ``places`` could be taken out; ``kept`` gets the items that stay."""
    items: dict[str, set[int]] = {}
    for place in places:
        head = str(place[0]) if place else ""
        field = Scene.model_fields.get(head)
        if not place or (field is not None and field.is_required()):
            return False
        if len(place) > 1 and isinstance(place[1], int):
            items.setdefault(head, set()).add(place[1])
        else:
            table.pop(head, None)
    for head, wrong in items.items():
        kept[head] = [k for k in range(len(table[head])) if k not in wrong]
        table[head] = [table[head][k] for k in kept[head]]
    return True
