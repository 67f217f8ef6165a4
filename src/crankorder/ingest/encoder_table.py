"""The table ``[encoder]`` of a manifest: how the file tells the angle or the speed of the shaft, and on which wheel.

Imports nothing heavy, as all that a manifest is checked with.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, StringConstraints, WithJsonSchema
from pydantic import field_validator as field_check

from crankorder.engine.machine_parts import stated
from crankorder.errors import RequestError
from crankorder.shaft.pattern import angles_fault, pattern_of

EncoderKind = Literal[
    "square", "analogue", "angle", "count", "pulse_times", "edge_list", "speed", "constant", "vibration", "none"
]  # fmt: skip
SOURCELESS_KINDS = ("constant", "vibration", "none")
"""Kinds that read nothing from the file but the channels, and a constant speed where the file holds one."""
POSITION_KINDS = ("angle", "count")
TRACE_KINDS = ("square", "analogue", *POSITION_KINDS)
TIME_KINDS = ("pulse_times", "edge_list")

Positive = Annotated[float, Field(gt=0)]

Count = Annotated[int, Field(gt=0)]

Teeth = Annotated[int, Field(gt=0, le=1_000_000)]
"""More than any wheel or line encoder has."""

Ratio = Annotated[float, Field(ge=1e-4, le=1e4)]
"""More than any train of gears makes."""

Turn = Annotated[float, Field(ge=-7200.0, le=7200.0)]
"""Some turns of the crank, in degrees."""

Name = Annotated[str, StringConstraints(min_length=1, max_length=1000)]


def _source(value: object) -> str | int:
    if isinstance(value, str) and value:
        return value
    if isinstance(value, int) and not isinstance(value, bool) and value >= 0:
        return value
    raise ValueError("a source is a dataset path, a column name, or a column number from 0")


Source = Annotated[
    str | int,
    PlainValidator(_source),
    WithJsonSchema({"anyOf": [{"type": "string", "minLength": 1}, {"type": "integer", "minimum": 0}]}),
]


NAMED_PART = re.compile(r"\{([A-Za-z_]\w*)\}")
"""A part of the names of files, such as ``{step}``, that a recording and the file of its pulses share."""


class Table(BaseModel):
    """Base of the tables of a manifest: unknown keys and wrong types are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def optional(description: str, *example: object) -> Any:
    """A field with its ``description``, and an ``example`` or none, that is None where it is left out."""
    return stated(description, *example, default=None)


class Encoder(Table):
    """``[encoder]``: how the file tells the angle or the speed of the shaft."""

    kind: EncoderKind = stated(
        "What tells the shaft: a sampled trace of two levels (square) or of any shape (analogue), times of "
        "pulses (pulse_times), a list of changes of a level (edge_list), the angle (angle), a count of it (count) or "
        "the speed (speed) sample by sample, one speed (constant), the signals themselves (vibration) or nothing "
        "(none).",
        "square",
        default="none",
    )
    source: Source | None = optional("Dataset or column that holds it.", "encoder")
    file: Name | None = optional(
        "File of pulse times beside each recording; * stands for the recording's name, {step} for the part "
        "of it that has this name in recordings.files.",
        "*.edges.csv",
    )
    time_source: Source | None = optional("Column of times in that file.", "time_s")
    offset_s: float = stated(
        "Added to the times of that file: what its clock lags behind the recording's.", 0.25, default=0.0
    )
    pulses_per_rev: Teeth | None = optional(
        "Pulses per revolution of the full wheel, missing teeth counted: 60 of a 60-2 wheel; of kind count "
        "the counts: 4096 of 1024 lines counted fourfold.",
        60,
    )
    missing_teeth: Annotated[int, Field(ge=0, le=1_000_000)] = stated(
        "Teeth that the wheel lacks in its one gap: 2 of a 60-2 wheel.", 2, default=0
    )
    pattern: Name | None = optional("A wheel of the trade by name, or even teeth and gap such as 60-2.", "36-2")
    tooth_angles_deg: Annotated[tuple[float, ...], Field(strict=False)] | None = optional(
        "Angles of the pulses of one turn of the wheel from the first at 0, ascending, below 360.", [0.0, 30.0, 180.0]
    )
    index: Source | None = optional("Dataset or column of a mark once per revolution of the encoder.", "index")
    cam: Source | None = optional(
        "Dataset or column of a mark once per cycle of a four-stroke engine: which dead centre fires.", "cam"
    )
    second_track: Source | None = optional(
        "Dataset or column of a second track a quarter of a pulse behind the first (B of A and B): it "
        "tells whether the shaft turns backwards.",
        "encoder_b",
    )
    edge: Literal["rising", "falling"] = stated("Edge of the trace that counts.", "falling", default="rising")
    ratio: Ratio = stated("Revolutions of the encoder per crank revolution.", 0.5, default=1.0)
    index_to_tdc_deg: Turn = stated(
        "Crank angle from the index mark, or without one from the first tooth behind the gap or the zero "
        "of an angle or count, to top dead centre, from which phases count.",
        84.0,
        default=0.0,
    )
    cam_to_tdc_deg: Turn | None = optional("Crank angle from the cam mark to the firing top dead centre.", 120.0)
    speed_rpm: Positive | None = optional(
        "Speed of the crank in every recording that has none of its own; of kind constant.", 1500.0
    )
    expected_rpm: Annotated[tuple[Positive, Positive], Field(strict=False)] | None = optional(
        "Lowest and highest speed that is looked for; of kind vibration alone.", [600.0, 3000.0]
    )

    @field_check("expected_rpm")
    @classmethod
    def _range_is_one(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and value[0] >= value[1]:
            raise ValueError("expected_rpm must be the lowest and the highest speed")
        return value

    @field_check("pattern")
    @classmethod
    def _pattern_is_known(cls, name: str | None) -> str | None:
        return name if name is None else pattern_of(name).name

    @field_check("tooth_angles_deg")
    @classmethod
    def _angles_are_a_wheel(cls, angles: tuple[float, ...] | None) -> tuple[float, ...] | None:
        fault = "" if angles is None else angles_fault(angles)
        if fault:
            raise ValueError(fault)
        return angles

    @field_check("file")
    @classmethod
    def _file_lies_beside(cls, name: str | None) -> str | None:
        if name is not None and (re.search(r"[/\\\0]", name) or name in (".", "..")):
            raise ValueError("file must be the name of a file beside the recording; * stands for the recording's own")
        return name

    @property
    def wheel(self) -> Mapping[str, int | list[float]]:
        """Attributes of a recording that state its wheel; empty where the pulses themselves must show it."""
        if self.tooth_angles_deg is not None:
            return {"tooth_angles_deg": list(self.tooth_angles_deg)}
        if self.pattern is not None:
            even, angles = pattern_of(self.pattern).even, pattern_of(self.pattern).angles_deg
            if even is None:
                return {"tooth_angles_deg": list(angles)}
            return {"pulses_per_rev": even[0], "missing_teeth": even[1]}
        if self.pulses_per_rev is None:
            return {}
        return {"pulses_per_rev": self.pulses_per_rev, "missing_teeth": self.missing_teeth}


def encoder_faults(encoder: Encoder, *, cycle: str, domain: str, speeds_stated: bool) -> Iterator[RequestError]:
    """Faults of ``encoder`` that show only when several keys are seen together, yielded as RequestErrors.

    ``cycle`` is that of the test, ``domain`` that of the samples; ``speeds_stated`` says whether recordings have speeds
    of their own.
    """
    kind, keys = encoder.kind, encoder.model_fields_set
    needs = {
        "source": kind in (*TRACE_KINDS, *TIME_KINDS, "speed"),
        "pulses_per_rev": kind == "count",
        "speed_rpm": kind == "constant" and not speeds_stated and encoder.source is None,
    }
    for key in (key for key, is_needed in needs.items() if is_needed and getattr(encoder, key) is None):
        yield _fault(key, f"an encoder of kind {kind!r} needs {key}", remedy="Add it")
    if kind in POSITION_KINDS:
        useless = {"missing_teeth", "pattern", "tooth_angles_deg", "second_track"}
        useless |= {"pulses_per_rev"} if kind == "angle" else set()
        useless |= {"edge"} if encoder.index is None and encoder.cam is None else set()
        for key in sorted(useless & keys):
            yield _fault(key, f"{key} says nothing of kind {kind!r}", remedy=f"Remove {key}")
    if encoder.file is None:
        for key in sorted({"time_source", "offset_s"} & keys):
            yield _fault(key, f"{key} is that of the file of pulses", remedy="Add file")
    elif kind not in TIME_KINDS:
        problem = "a file of its own holds times of pulses: samples lie in the recording"
        yield _fault("file", problem, allowed=f"beside kind = {' or '.join(TIME_KINDS)}")
    if encoder.expected_rpm is not None and kind != "vibration":
        yield _fault("expected_rpm", 'expected_rpm goes with kind = "vibration"')
    if encoder.second_track is not None and kind not in TRACE_KINDS:
        allowed = f"beside kind = {' or '.join(TRACE_KINDS)}"
        yield _fault("second_track", "a second track is a sampled trace", allowed=allowed)
    if cycle == "none" and (kind != "none" or domain == "crank_angle"):
        problem = "a structure without a shaft has neither an encoder nor samples by crank angle"
        place, found = ("encoder.kind", kind) if kind != "none" else ("sampling.domain", domain)
        remedy = "Remove it, or state the cycle of the machine (rotor)"
        yield RequestError(problem, place=place, found=found, remedy=remedy)
    if domain == "crank_angle" and kind not in ("none", "constant"):
        problem, allowed = "samples by crank angle have no use for an encoder", "none, constant"
        remedy = 'Remove [encoder], or state domain = "time"'
        yield _fault("kind", problem, found=kind, allowed=allowed, remedy=remedy)
    if encoder.cam is not None and cycle != "four-stroke":
        problem, remedy = "a cam mark tells the phase of a four-stroke cycle only", "Remove cam, or mend test.cycle"
        yield _fault("cam", problem, found=f"cycle = {cycle!r}", remedy=remedy)
    if encoder.cam_to_tdc_deg is not None and encoder.cam is None:
        yield _fault("cam_to_tdc_deg", "cam_to_tdc_deg needs cam, its source", remedy="Add cam")
    wheels = [key for key in ("pattern", "tooth_angles_deg", "pulses_per_rev") if getattr(encoder, key) is not None]
    if len(wheels) > 1:
        problem, remedy = f"the wheel is stated by {' and by '.join(wheels)}", f"Remove {' and '.join(wheels[1:])}"
        yield _fault(wheels[0], problem, allowed="one of them", remedy=remedy)
    if encoder.missing_teeth and encoder.missing_teeth >= (encoder.pulses_per_rev or encoder.missing_teeth):
        allowed = "below pulses_per_rev, which counts the full wheel"
        allowed += f" = {encoder.pulses_per_rev}" if encoder.pulses_per_rev else ""
        problem = "more teeth are missing than the wheel has"
        yield _fault("missing_teeth", problem, found=encoder.missing_teeth, allowed=allowed)


def _fault(key: str, problem: str, **further: Any) -> RequestError:
    return RequestError(problem, place=f"encoder.{key}", **further)
