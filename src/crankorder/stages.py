"""The stages in flow order: the whole program on one screen. What a stage takes and gives is its signature.

``analyse_recording`` runs the stages of one file, ``analyse_test`` those that join a test's files; the plan of each is
worked out from the signatures by sciline. Every stage checks its inputs at the door (schema, metadata only) and signs
what it gives with a line of history.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NewType, TypeVar, get_type_hints

import numpy as np
import sciline
import xarray as xr
from sciline.scheduler import NaiveScheduler

from crankorder.campbell.frames import frequency_frames
from crankorder.campbell.map import campbell_map
from crankorder.fft.band import band_limited
from crankorder.identify.explain import Sources
from crankorder.identify.findings import find
from crankorder.ingest.manifest import Manifest
from crankorder.ingest.recording import read_recording
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.orders.tracks import followed_orders, order_tracks
from crankorder.quantities import (
    BandRecording,
    CampbellMap,
    Findings,
    FrequencyFrames,
    OrderFrames,
    OrderMap,
    OrderTracks,
    Recording,
    ShaftAngle,
    check_dataset,
    with_flags,
)
from crankorder.settings import Settings
from crankorder.shaft.audit import reference_audit
from crankorder.shaft.decode import encoder_pattern, flags_named, shaft_angle
from crankorder.shaft.knowledge import ShaftKnowledge
from crankorder.shaft.line_pattern import LinePattern

RecordingFile = NewType("RecordingFile", Path)
TestName = NewType("TestName", str)
AllOrderFrames = NewType("AllOrderFrames", list[xr.Dataset])
AllFrequencyFrames = NewType("AllFrequencyFrames", list[xr.Dataset])

SCHEMAS: dict[Any, str] = {
    Recording: "recording",
    BandRecording: "recording",
    ShaftAngle: "shaft_angle",
    OrderFrames: "order_frames",
    FrequencyFrames: "frequency_frames",
    OrderMap: "order_map",
    CampbellMap: "campbell_map",
    OrderTracks: "order_tracks",
}

Stage = TypeVar("Stage", bound=Callable[..., Any])


def stage(function: Stage) -> Stage:
    """``function`` with its datasets checked against their schemas at the door and its result signed."""
    hints = get_type_hints(function)
    schemas = {name: SCHEMAS[kind] for name, kind in hints.items() if kind in SCHEMAS}

    names = tuple(inspect.signature(function).parameters)

    @functools.wraps(function)
    def checked(*inputs: Any, **named: Any) -> Any:
        for name, dataset in {**dict(zip(names, inputs, strict=False)), **named}.items():
            if name in schemas:
                check_dataset(dataset, schemas[name])
        result = function(*inputs, **named)
        if "return" in schemas:
            check_dataset(result, schemas["return"])
            said = (function.__doc__ or "").replace("``", "").rstrip(".")
            history = [result.attrs.get("history", ""), f"{function.__name__}: {said}"]
            result.attrs["history"] = "\n".join(line for line in history if line)
        return result

    return checked  # type: ignore[return-value]


@stage
def ingest(file: RecordingFile, manifest: Manifest, settings: Settings) -> Recording:
    """Recording of ``file`` as ``manifest`` describes it, units converted, pulses found (``settings``: limits)."""
    return Recording(read_recording(file, manifest, settings=settings.ingest, shaft=settings.shaft))


@stage
def shaft(recording: Recording, knowledge: ShaftKnowledge, settings: Settings) -> ShaftAngle:
    """Crank angle and speed from the pulses of ``recording`` and ``knowledge`` of its shaft (``settings`` of shaft)."""
    angle = shaft_angle(recording, settings=settings.shaft, knowledge=knowledge)
    if recording.attrs.get("encoder_kind") == "vibration":
        return ShaftAngle(angle)  # no pulses stand behind it; its own error and confidence are all that is known
    asked = np.arange(0.5, settings.orders.max_order + 0.5, 0.5)
    audit = reference_audit(
        angle,
        orders=asked,
        revs_per_frame=settings.orders.revs_per_frame,
        settings=settings.shaft,
        # how well a model fills in what the pulses do not show is told by the angle's own error
        irregularity={} if angle.attrs.get("in_cycle_filled") else None,
    )
    return ShaftAngle(with_flags(angle, flags_named(str(recording.attrs["recording"]), audit.remarks)))


@stage
def pattern(recording: Recording, settings: Settings) -> LinePattern:
    """How the lines of the encoder of ``recording`` come beside an even rotation (``settings`` of shaft)."""
    return encoder_pattern(recording, settings=settings.shaft)


@stage
def band(recording: Recording, shaft: ShaftAngle, settings: Settings) -> BandRecording:
    """``recording`` limited to the band that orders and map need at the speeds of ``shaft`` (``settings`` of both)."""
    fastest_hz = float(np.nan_to_num(shaft["speed"].values).max()) / 60.0
    needed = max(settings.campbell.max_frequency_hz, settings.orders.max_order * fastest_hz)
    return BandRecording(band_limited(recording, band_hz=needed, grid_hz=settings.campbell.resolution_hz))


@stage
def frames_by_order(band: BandRecording, shaft: ShaftAngle, settings: Settings) -> OrderFrames:
    """Spectra of whole cycles of ``band``, resampled by the crank angle of ``shaft`` (``settings`` of orders)."""
    return OrderFrames(order_frames(band, shaft, settings=settings.orders))


@stage
def frames_by_frequency(band: BandRecording, shaft: ShaftAngle, settings: Settings) -> FrequencyFrames:
    """Spectra of pieces of ``band`` by time, with the speeds of ``shaft`` (``settings`` of campbell)."""
    return FrequencyFrames(frequency_frames(band, shaft, settings=settings.campbell))


@stage
def map_by_order(frames: AllOrderFrames, settings: Settings) -> OrderMap:
    """Order ``frames`` of all recordings averaged at like speed (``settings`` of orders)."""
    return OrderMap(order_map(frames, settings=settings.orders))


@stage
def map_by_frequency(frames: AllFrequencyFrames, settings: Settings) -> CampbellMap:
    """Frequency ``frames`` of all recordings averaged at like speed (``settings`` of orders: the width of a group)."""
    return CampbellMap(campbell_map(frames, speed_bin_rpm=settings.orders.speed_bin_rpm))


@stage
def findings(
    order_map: OrderMap, campbell: CampbellMap, test: TestName, sources: Sources, settings: Settings
) -> Findings:
    """What ``order_map`` and ``campbell`` show of ``test`` and what ``sources`` explain (``settings`` of identify)."""
    return Findings(find(order_map, campbell, test=test, sources=sources, settings=settings))


@stage
def tracks(order_map: OrderMap, findings: Findings, settings: Settings) -> OrderTracks:
    """Orders that ``findings`` name or ``settings`` ask for, followed over speed in ``order_map``."""
    return OrderTracks(
        order_tracks(order_map, followed_orders(order_map, findings, settings.orders), settings=settings.orders)
    )


OF_ENCODER = (ingest, pattern)
OF_RECORDING = (ingest, shaft, band, frames_by_order, frames_by_frequency)
OF_TEST = (map_by_order, map_by_frequency, findings, tracks)


@dataclass(frozen=True)
class RecordingResult:
    """What one recording gives to its test."""

    shaft: ShaftAngle
    order_frames: OrderFrames
    frequency_frames: FrequencyFrames


@dataclass(frozen=True)
class TestResult:
    """What a test gives to its report."""

    __test__ = False

    order_map: OrderMap
    campbell_map: CampbellMap
    order_tracks: OrderTracks
    findings: Findings


def analyse_encoder(file: Path, manifest: Manifest, settings: Settings) -> LinePattern:
    """Pattern of the encoder's lines in ``file`` as ``manifest`` describes it, with ``settings``: for its calibration.

    Raises InputError, naming the file, where the recording cannot be used.
    """
    plan = sciline.Pipeline(OF_ENCODER, params={RecordingFile: file, Manifest: manifest, Settings: settings})
    made: LinePattern = plan.compute(LinePattern, scheduler=NaiveScheduler())
    return made


def analyse_recording(
    file: Path, manifest: Manifest, settings: Settings, knowledge: ShaftKnowledge | None = None
) -> RecordingResult:
    """Shaft angle and frames of the recording in ``file`` as ``manifest`` describes it, with ``settings``.

    ``knowledge``: of the shaft's engine and encoder. Raises InputError, naming the file, where the recording cannot be
    used.
    """
    given = {
        RecordingFile: file,
        Manifest: manifest,
        Settings: settings,
        ShaftKnowledge: knowledge or ShaftKnowledge(),
    }
    plan = sciline.Pipeline(OF_RECORDING, params=given)
    made: dict[Any, Any] = plan.compute((ShaftAngle, OrderFrames, FrequencyFrames), scheduler=NaiveScheduler())
    return RecordingResult(made[ShaftAngle], made[OrderFrames], made[FrequencyFrames])


def analyse_test(recordings: list[RecordingResult], *, test: str, sources: Sources, settings: Settings) -> TestResult:
    """Maps, findings and tracks of the test named ``test`` from the results of its ``recordings``.

    ``sources`` says what the machine is made of; ``settings`` are those of all stages.
    """
    given = {
        AllOrderFrames: [item.order_frames for item in recordings],
        AllFrequencyFrames: [item.frequency_frames for item in recordings],
        TestName: test,
        Sources: sources,
        Settings: settings,
    }
    plan = sciline.Pipeline(OF_TEST, params=given)
    made: dict[Any, Any] = plan.compute((OrderMap, CampbellMap, OrderTracks, Findings), scheduler=NaiveScheduler())
    return TestResult(made[OrderMap], made[CampbellMap], made[OrderTracks], made[Findings])
