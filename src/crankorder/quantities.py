"""The nouns: every dataset that flows, in flow order. ``data_schema/`` states the dims, variables and units of each.

Conventions shared by all of them:

* crank angle in revolutions from top dead centre (0 = TDC; firing TDC where ``cycle_known`` is 1), growing with time;
* a line at an order is ``amplitude * cos(2 pi order crank_angle + phase)``, amplitude is the peak;
* speed in revolutions per minute; the unit attribute is the UDUNITS string ``min-1``;
* quality flags travel in ``attrs["quality"]`` as a JSON list (:func:`flags_of`, :func:`with_flags`);
* what was done travels in ``attrs["history"]``, one line per stage.
"""

from __future__ import annotations

import json
from collections.abc import Hashable, Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, Literal, NewType, NotRequired, TypedDict

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import SchemaError
from crankorder.records import Json

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

Attribute = str | float | Sequence[float] | NDArray[np.generic]
"""Value of an attribute of a dataset, of a variable or of an object of HDF5."""

Variables = dict[str, xr.Variable | tuple[str | tuple[Hashable, ...], NDArray[Any], Mapping[str, Attribute]]]
"""Variables or coordinates of a dataset to be, by name: put in at once, for a dataset aligns at every turn."""

Recording = NewType("Recording", xr.Dataset)
"""One file as measured: signal[channel, time | crank_angle] with encoder and index pulse times."""

ShaftAngle = NewType("ShaftAngle", xr.Dataset)
"""Crank angle, speed and their standard error on time knots."""

ShaftSummary = NewType("ShaftSummary", xr.Dataset)
"""Speed, pulses used and angle error of every recording of a test, and its speed against time in short."""

BandRecording = NewType("BandRecording", xr.Dataset)
"""A recording limited to the band that the wanted results need (low-pass filtered and decimated)."""

OrderFrames = NewType("OrderFrames", xr.Dataset)
"""Complex order spectra of whole-cycle frames of one recording, each frame with its speed."""

OrderMap = NewType("OrderMap", xr.Dataset)
"""Order spectra of a test against speed: energy average, coherent average, standard error."""

FrequencyFrames = NewType("FrequencyFrames", xr.Dataset)
"""Power spectra of the frames of one recording by frequency, each frame with its speed."""

CampbellMap = NewType("CampbellMap", xr.Dataset)
"""The speed-frequency map of a test: peak amplitude of a tone and power spectral density."""

OrderTracks = NewType("OrderTracks", xr.Dataset)
"""Amplitude and phase of the found and the asked-for orders against speed."""

RecordingTracks = NewType("RecordingTracks", xr.Dataset)
"""Complex amplitudes of the orders asked for in frames of one recording, by Vold–Kalman."""

RecordingCycles = NewType("RecordingCycles", xr.Dataset)
"""The CycleAverage of one recording alone."""

CycleAverage = NewType("CycleAverage", xr.Dataset)
"""The average engine cycle of each channel against crank angle, by speed, with its spread over the cycles."""

RecordingEnvelope = NewType("RecordingEnvelope", xr.Dataset)
"""The EnvelopeMap of one recording alone."""

EnvelopeMap = NewType("EnvelopeMap", xr.Dataset)
"""Order spectra of the squared envelope of every channel, in the band that shows most, against speed."""

RecordingLevels = NewType("RecordingLevels", xr.Dataset)
"""Overall level of each channel of one recording, and what of it lies above the band looked at."""

LevelFrames = NewType("LevelFrames", xr.Dataset)
"""Mean square and peak of each channel in each band, by pieces of one recording, each with its speed."""

VibrationLevels = NewType("VibrationLevels", xr.Dataset)
"""Root mean square, peak and crest factor of each channel in stated bands and one-third octaves, by speed."""

OperatingShapes = NewType("OperatingShapes", xr.Dataset)
"""Amplitude and phase of every channel at named orders, by speed: how the measured points move together."""

Truth = NewType("Truth", dict[str, Json])
"""What was put into a synthetic test, in the words of the findings."""

SCHEMAS: dict[Any, str] = {
    Recording: "recording",
    BandRecording: "recording",
    ShaftAngle: "shaft_angle",
    ShaftSummary: "shaft_summary",
    OrderFrames: "order_frames",
    FrequencyFrames: "frequency_frames",
    OrderMap: "order_map",
    CampbellMap: "campbell_map",
    OrderTracks: "order_tracks",
    RecordingEnvelope: "envelope_map",
    EnvelopeMap: "envelope_map",
    RecordingLevels: "recording_levels",
    LevelFrames: "level_frames",
    VibrationLevels: "vibration_levels",
    RecordingCycles: "cycle_average",
    CycleAverage: "cycle_average",
    OperatingShapes: "operating_shapes",
}
"""The schema of each noun that is a dataset."""

Severity = Literal["info", "suspect", "bad"]


WHICH_IS_RIGHT = "which is right"
"""Words of flags of recordings that differ, none of which is known to be wrong."""


class QualityFlag(TypedDict):
    """One remark on a recording: which, what, how bad, and where or how much.

    Of a fault of one channel: its name, from when to when (s, or rev by crank angle), and whether that stretch or the
    whole channel was left out of all averages, so that the rest of the recording could stay.
    """

    recording: str
    flag: str
    severity: Severity
    detail: str
    channel: NotRequired[str]
    begin: NotRequired[float]
    end: NotRequired[float]
    left_out: NotRequired[Literal["stretch", "channel"]]


def flags_of(dataset: xr.Dataset) -> list[QualityFlag]:
    """Quality flags that ``dataset`` (any dims) carries, in the order in which they were raised."""
    return list(json.loads(dataset.attrs.get("quality", "[]")))


def with_flags(dataset: xr.Dataset, flags: Iterable[QualityFlag]) -> xr.Dataset:
    """``dataset`` (any dims, changed in place) with ``flags`` added to those that it carries."""
    dataset.attrs["quality"] = json.dumps([*flags_of(dataset), *flags], ensure_ascii=False)
    return dataset


def channel_coords(dataset: xr.Dataset) -> dict[str, xr.Variable]:
    """Coordinates (channel,) of ``dataset`` that say what each channel is: name, unit, quantity, direction if known."""
    names = ("channel", "unit", "quantity", "direction")
    return {name: dataset.variables[name] for name in names if name in dataset.variables}


def described(
    dims: str | tuple[str, ...], values: NDArray[Any], units: str, long_name: str
) -> tuple[str | tuple[Hashable, ...], NDArray[Any], Mapping[str, Attribute]]:
    """Variable of a dataset to be: ``values`` along ``dims`` with their ``units`` and what they are (``long_name``)."""
    return dims, values, {"units": units, "long_name": long_name}


def remark(recording: str, flag: str, detail: str, severity: Severity = "info") -> QualityFlag:
    """QualityFlag on a ``recording`` as a whole: its name ``flag``, ``severity`` and ``detail``."""
    return QualityFlag(recording=recording, flag=flag, severity=severity, detail=detail)


def unindexed(**coords: Any) -> xr.Coordinates:
    """``coords`` of a dataset in which nothing is looked up by label: indexes cost half of the time that it takes."""
    return xr.Coordinates(coords, indexes={})


@cache
def schema_of(noun: str) -> Mapping[str, Any]:
    """JSON Schema of a noun or file of ``data_schema/``, by file stem such as ``"order_map"``."""
    text = files("crankorder.data_schema").joinpath(f"{noun}.json").read_text(encoding="utf-8")
    return dict(json.loads(text))


def check_dataset(dataset: xr.Dataset, noun: str) -> None:
    """Refuse a ``dataset`` that lacks a variable, dimension, unit or attribute of its schema; reads metadata only.

    ``noun`` is the stem of a file of ``data_schema/``, which states the dims. Raises SchemaError, which names the
    variable, what it has and what the schema asks for.
    """
    variables = schema_of(noun)["properties"]["variables"]
    held = dataset.variables  # not dataset[name], which gathers coordinates at fifty times the cost
    for name in variables["required"]:
        if name not in held:
            raise SchemaError(f"variable {name!r} is missing", place=noun, allowed=", ".join(variables["required"]))
    for name in [key for key in variables["properties"] if key in held]:
        rule, variable = variables["properties"][name]["properties"], held[name]
        dims = list(variable.dims)
        if dims not in rule["dims"]["enum"]:
            raise SchemaError("wrong dims", place=f"{noun}.{name}", found=dims, allowed=str(rule["dims"]["enum"]))
        units = variable.attrs.get("units")
        if units is None or ("const" in rule["units"] and units != rule["units"]["const"]):
            allowed = rule["units"].get("const", "any, but stated")
            raise SchemaError("wrong units", place=f"{noun}.{name}", found=units, allowed=allowed)
    for name in schema_of(noun)["properties"]["attrs"]["required"]:
        if name not in dataset.attrs:
            raise SchemaError(f"attribute {name!r} is missing", place=noun)


def is_sound(quantity: str, unit: str) -> bool:
    """Whether a channel of that ``quantity`` and ``unit`` is a microphone: pascals are, unless another one is stated.

    Pressures in cylinders are told in bar, kPa or MPa; in pascals only where ``quantity`` says so.
    """
    named = quantity.casefold().replace("_", " ")
    return named == "sound pressure" or (named == "pressure" and unit == "Pa")


def is_cylinder_pressure(quantity: str, unit: str) -> bool:
    """Whether a channel of that ``quantity`` and ``unit`` is, in a piston engine, the pressure in a cylinder."""
    named = quantity.casefold().replace("_", " ")
    return named == "cylinder pressure" or (named == "pressure" and not is_sound(quantity, unit))
