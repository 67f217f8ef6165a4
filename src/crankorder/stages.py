"""The stages in flow order, which `docs/method/stages.md` draws. What a stage takes and gives is its signature.

``analyse_recording`` runs the stages of one file, ``compare_recordings`` doubts what beside the others is odd, and
``analyse_test`` runs those that join a test's files, without what is left out; the plan of each is worked out from the
signatures (``StagePlan``): only what the wanted results need is run. Every stage checks its inputs at the door (schema,
metadata only) and signs what it gives with a line of history.
"""

from __future__ import annotations

import functools
import inspect
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NewType, TypeVar, get_type_hints

import numpy as np
import xarray as xr

from crankorder.campbell.frames import frequency_frames
from crankorder.campbell.levels import LevelBand, level_frames, limit_bands, recording_levels, third_octaves
from crankorder.campbell.map import campbell_map
from crankorder.campbell.vibration_levels import vibration_levels
from crankorder.checks.doubts import Doubts, Gathered, RecordingResult, doubts_of, flags_of_all
from crankorder.engine.definition import Engine
from crankorder.engine.machine_parts import Bearing
from crankorder.fft.decimation import band_limited
from crankorder.findings import Channel, Findings, nothing_sought, quality_of
from crankorder.flow import StagePlan
from crankorder.identify.envelope_lines import bearing_combs
from crankorder.identify.found import SweepFits
from crankorder.identify.machine_model import MachineModel
from crankorder.ingest.manifest import Manifest
from crankorder.ingest.recording import read_recording
from crankorder.orders.cycle_average import cycle_average, cycle_averages
from crankorder.orders.envelope import envelope_map, recording_envelope
from crankorder.orders.fixed_lines import lines_of_findings
from crankorder.orders.frames import band_of_orders, order_frames
from crankorder.orders.map import order_map
from crankorder.orders.method import METHOD_SHARE
from crankorder.orders.shapes import operating_shapes
from crankorder.orders.swept_tracks import followed_tracks
from crankorder.orders.track_rows import followed_orders, order_tracks
from crankorder.orders.true_angle import NAMES, Swings, frames_in_true_angle, swings_of_test, tracks_in_true_angle
from crankorder.quantities import (
    SCHEMAS,
    BandRecording,
    CampbellMap,
    CycleAverage,
    EnvelopeMap,
    FrequencyFrames,
    LevelFrames,
    OperatingShapes,
    OrderFrames,
    OrderMap,
    OrderTracks,
    QualityFlag,
    Recording,
    RecordingCycles,
    RecordingEnvelope,
    RecordingLevels,
    RecordingTracks,
    ShaftAngle,
    ShaftSummary,
    VibrationLevels,
    check_dataset,
    flags_of,
    with_flags,
)
from crankorder.settings import Settings
from crankorder.shaft.audit import reference_audit
from crankorder.shaft.decode import PULSE_KINDS, flags_named, shaft_angle
from crankorder.shaft.repair import NO_PULSES, silent_ends
from crankorder.shaft.speeds import named_speed_remarks, shaft_summary, speed_swings

RecordingFile = NewType("RecordingFile", Path)
TestName = NewType("TestName", str)
TestBearings = NewType("TestBearings", tuple[Bearing, ...])
ShownOrderFrames = NewType("ShownOrderFrames", Sequence[xr.Dataset])
AllOrderFrames = NewType("AllOrderFrames", Sequence[xr.Dataset])
AllFrequencyFrames = NewType("AllFrequencyFrames", Sequence[xr.Dataset])
ShownRecordingTracks = NewType("ShownRecordingTracks", Sequence[xr.Dataset])
AllRecordingTracks = NewType("AllRecordingTracks", Sequence[xr.Dataset])
FilteredTracks = NewType("FilteredTracks", Sequence[xr.Dataset])
SweepModes = NewType("SweepModes", SweepFits)
AllRecordingCycles = NewType("AllRecordingCycles", Sequence[xr.Dataset])
AllRecordingEnvelopes = NewType("AllRecordingEnvelopes", Sequence[xr.Dataset])
AllRecordingLevels = NewType("AllRecordingLevels", Sequence[xr.Dataset])
AllLevelFrames = NewType("AllLevelFrames", Sequence[xr.Dataset])
AllShaftAngles = NewType("AllShaftAngles", Sequence[xr.Dataset])
RecordingFlags = NewType("RecordingFlags", Mapping[str, Sequence[QualityFlag]])
Strict = NewType("Strict", bool)

Stage = TypeVar("Stage", bound=Callable[..., Any])
STAGES: list[Callable[..., Any]] = []
"""All stages, in flow order."""


def stage(function: Stage) -> Stage:
    """``function`` as one of the ``STAGES``: datasets checked against their schemas at the door, its result signed."""
    hints = get_type_hints(function)
    schemas = {name: SCHEMAS[kind] for name, kind in hints.items() if kind in SCHEMAS}
    names = tuple(inspect.signature(function).parameters)

    @functools.wraps(function)
    def checked(*inputs: Any, **named: Any) -> Any:
        given = {**dict(zip(names, inputs, strict=False)), **named}
        for name, dataset in given.items():
            if name in schemas:
                check_dataset(dataset, schemas[name])
        result = function(*inputs, **named)
        if "return" in schemas:
            check_dataset(result, schemas["return"])
            told = [*_told(given.values()), *_told([result]), f"{function.__name__}: from {', '.join(names)}"]
            result.attrs["history"] = "\n".join(dict.fromkeys(told))
        return result

    STAGES.append(checked)
    return checked  # type: ignore[return-value]


def _told(inputs: Iterable[Any]) -> Iterator[str]:
    """Lines of the history of every dataset among ``inputs``; of a list those that all of its datasets have."""
    for one in inputs:
        if isinstance(one, xr.Dataset):
            yield from str(one.attrs.get("history", "")).splitlines()
        elif isinstance(one, list | Gathered) and one:
            lines = [text.splitlines() for text in one.histories] if isinstance(one, Gathered) else []
            lines = lines or [list(_told([item])) for item in one]
            yield from (line for line in lines[0] if all(line in others for others in lines))
            yield f"{len(one)} recordings joined"


@stage
def ingest(file: RecordingFile, manifest: Manifest, settings: Settings) -> Recording:
    """Recording of ``file`` as ``manifest`` describes it, units converted, pulses found (``settings``: limits)."""
    return Recording(read_recording(file, manifest, settings=settings.ingest, shaft=settings.shaft))


@stage
def shaft(recording: Recording, settings: Settings) -> ShaftAngle:
    """Crank angle and speed from the pulses of ``recording`` (``settings`` of shaft)."""
    angle = shaft_angle(recording, settings=settings.shaft)
    named = flags_named(str(recording.attrs["recording"]), named_speed_remarks(angle))
    angle = ShaftAngle(with_flags(angle, named))
    if recording.attrs.get("encoder_kind") == "vibration" or not angle.attrs.get("has_shaft", 1):
        return angle  # no pulses stand behind it; its own error and confidence are all that is known
    asked = np.arange(0.5, settings.orders.max_order + 0.5, 0.5)
    audit = reference_audit(angle, orders=asked, revs_per_frame=settings.orders.revs_per_frame, settings=settings.shaft)
    remarks = [*audit.remarks, *silent_ends(recording, angle)]
    of_file = [] if recording.sizes["channel"] else flags_of(recording)  # no band hands them on
    return ShaftAngle(with_flags(angle, [*of_file, *flags_named(str(recording.attrs["recording"]), remarks)]))


@stage
def band(recording: Recording, shaft: ShaftAngle, settings: Settings) -> BandRecording:
    """``recording`` limited to the band that orders and map need at the speeds of ``shaft`` (``settings`` of both)."""
    fastest_hz = float(np.nan_to_num(shaft["speed"].values).max()) / 60.0
    frames = frames_wanted(settings)
    by_order = settings.orders.max_order * fastest_hz if {OrderFrames, RecordingCycles} & set(frames) else 0.0
    by_name = max(settings.orders.track_orders, default=0.0) * fastest_hz if RecordingTracks in frames else 0.0
    by_frequency = settings.campbell.max_frequency_hz if FrequencyFrames in frames else 0.0
    band_hz = max(by_order, by_name, by_frequency) or settings.campbell.max_frequency_hz
    tolerance = (1.0 - METHOD_SHARE) * settings.orders.tolerance
    limited = band_limited(recording, band_hz=band_hz, grid_hz=settings.campbell.resolution_hz, tolerance=tolerance)
    return BandRecording(limited)


@stage
def frames_by_order(band: BandRecording, shaft: ShaftAngle, settings: Settings) -> OrderFrames:
    """Spectra of whole cycles of ``band``, resampled by the crank angle of ``shaft`` (``settings`` of orders)."""
    limited = band_of_orders(band, shaft, settings=settings.orders)
    return OrderFrames(order_frames(limited, shaft, settings=settings.orders))


@stage
def frames_by_frequency(band: BandRecording, shaft: ShaftAngle, settings: Settings) -> FrequencyFrames:
    """Spectra of pieces of ``band`` by time, with the speeds of ``shaft`` (``settings`` of campbell)."""
    return FrequencyFrames(frequency_frames(band, shaft, settings=settings.campbell))


@stage
def tracks_of_recording(
    band: BandRecording, shaft: ShaftAngle, frames: OrderFrames, settings: Settings
) -> RecordingTracks:
    """Orders followed through ``band`` by ``shaft``: those asked for and, in sweeps, those of ``frames``.

    The ``settings`` of orders count, and those of identify for what stands out.
    """
    from crankorder.identify.lines.order_lines import swept_orders  # with much that maps alone need not wait for

    swept = settings.orders.track_method == "auto" and bool(frames.attrs.get("swept", 0))
    found = swept_orders(frames, settings=settings) if swept else []
    tracks = functools.partial(followed_tracks, band, shaft, settings=settings.orders)
    return RecordingTracks(tracks(swept=swept, standing_out=found, mains_hz=settings.identify.mains_hz))


@stage
def cycles_of_recording(band: BandRecording, shaft: ShaftAngle, settings: Settings) -> RecordingCycles:
    """Mean engine cycle of ``band`` by ``shaft``, with its spread (``settings`` of orders)."""
    return RecordingCycles(cycle_average(band, shaft, settings=settings.orders))


@stage
def envelope_of_recording(
    recording: Recording, shaft: ShaftAngle, bearings: TestBearings, settings: Settings
) -> RecordingEnvelope:
    """Order spectrum of the envelope of ``recording`` by ``shaft`` (``settings`` of orders), if it has bearings.

    Without any ``bearings`` there is nothing to look for.
    ``settings`` of identify say by how much they may slip.
    """
    looked_at = recording if bearings else recording.isel({recording["signal"].dims[1]: slice(0, 0)})
    combs = bearing_combs(bearings, slip_percent=settings.identify.bearing_slip_percent)
    return RecordingEnvelope(recording_envelope(looked_at, shaft, settings=settings.orders, combs=combs))


@stage
def levels_of_recording(recording: Recording, shaft: ShaftAngle, settings: Settings) -> RecordingLevels:
    """Overall level of ``recording``, and its part above the band that its orders by ``shaft`` and its map show.

    The ``settings`` of orders and campbell say where that band ends.
    """
    return RecordingLevels(recording_levels(recording, shaft, orders=settings.orders, campbell=settings.campbell))


@stage
def band_levels_of_recording(
    recording: Recording, shaft: ShaftAngle, manifest: Manifest, settings: Settings
) -> LevelFrames:
    """Mean squares and peaks of ``recording`` by pieces with the speeds of ``shaft``, in the bands of ``settings``.

    ``settings`` of campbell; the bands that the limits of ``manifest`` are for are looked at too.
    """
    asked = settings.campbell
    bands = [LevelBand(quantity, *ends) for ends in asked.level_bands_hz for quantity in asked.level_quantities]
    bands += [band for one in manifest.limits if one.of_vibration for band in limit_bands(one.quantity, *one.band_hz)]
    frames = level_frames(recording, shaft, bands=[*bands, *third_octaves()], frame_s=asked.level_frame_s)
    return LevelFrames(frames)


@stage
def doubts(
    shafts: AllShaftAngles,
    levels: AllRecordingLevels,
    shown: ShownOrderFrames,
    told: RecordingFlags,
    strict: Strict,
    settings: Settings,
) -> Doubts:
    """Doubts from comparing recordings by ``shafts``, ``levels`` and frames as ``shown``.

    ``told`` has the flags of each recording by name; ``strict`` leaves out "suspect" ones too; ``settings`` of ingest
    count. The stages below gather recordings without what is left out.
    """
    return doubts_of(shafts, levels, shown, told, strict=strict, settings=settings.ingest)


@stage
def levels_of_test(items: AllLevelFrames, settings: Settings) -> VibrationLevels:
    """Overall levels of the ``items`` of all recordings, by speed (``settings`` of orders: the width of a group)."""
    return VibrationLevels(vibration_levels(items, speed_bin_rpm=settings.orders.speed_bin_rpm))


@stage
def map_of_envelopes(items: AllRecordingEnvelopes, settings: Settings) -> EnvelopeMap:
    """Envelope spectra ``items`` of all recordings averaged at like speed (``settings`` of orders)."""
    return EnvelopeMap(envelope_map(list(items), speed_bin_rpm=settings.orders.speed_bin_rpm))


@stage
def swings(shown: ShownOrderFrames, settings: Settings) -> Swings:
    """Swing of the angle that the encoder shows about the true one, from frames ``shown`` (``settings`` of orders)."""
    return swings_of_test(shown, settings=settings.orders)


@stage
def frames_of_test(shown: ShownOrderFrames, swings: Swings) -> AllOrderFrames:
    """Order frames of all recordings, as ``shown`` by the encoder, brought to the true angle by ``swings``."""
    return AllOrderFrames(frames_in_true_angle(shown, swings))


@stage
def tracks_by_filter(shown: ShownRecordingTracks, swings: Swings) -> FilteredTracks:
    """Tracks of all recordings, as ``shown`` by the encoder, brought to the true angle by ``swings``."""
    return FilteredTracks(tracks_in_true_angle(shown, swings))


@stage
def modes_of_sweeps(filtered: FilteredTracks, settings: Settings) -> SweepModes:
    """Modes that the signals of sweeps tell behind the orders of ``filtered`` (``settings`` of identify)."""
    if not any("waveform" in item for item in filtered):
        return SweepModes(SweepFits())
    from crankorder.identify.modes.sweep_modes import fits_of_sweeps

    return SweepModes(fits_of_sweeps(filtered, settings=settings.identify))


@stage
def tracks_of_test(filtered: FilteredTracks, modes: SweepModes) -> AllRecordingTracks:
    """Tracks of all recordings: ``filtered``, and beside the ``modes`` of sweeps as their signals tell them."""
    if not any("waveform" in item for item in filtered):
        return AllRecordingTracks(filtered)
    from crankorder.identify.modes.sweep_modes import with_rows_of_fits

    return AllRecordingTracks(with_rows_of_fits(filtered, modes))


@stage
def map_by_order(frames: AllOrderFrames, settings: Settings) -> OrderMap:
    """Order ``frames`` of all recordings averaged at like speed (``settings`` of orders)."""
    return OrderMap(order_map(list(frames), settings=settings.orders))


@stage
def map_by_frequency(frames: AllFrequencyFrames, settings: Settings) -> CampbellMap:
    """Frequency ``frames`` of all recordings averaged at like speed (``settings`` of orders: the width of a group)."""
    return CampbellMap(campbell_map(list(frames), speed_bin_rpm=settings.orders.speed_bin_rpm))


@stage
def findings(
    order_map: OrderMap,
    campbell: CampbellMap,
    frames: AllOrderFrames,
    envelope: EnvelopeMap,
    followed: AllRecordingTracks,
    levels: AllRecordingLevels,
    vibration: VibrationLevels,
    modes: SweepModes,
    test: TestName,
    sources: MachineModel,
    settings: Settings,
) -> Findings:
    """What ``order_map``, ``campbell``, ``frames``, ``envelope`` show of ``test``, explained by ``sources``.

    ``followed``: orders through each sweep; ``modes``: what the signals of sweeps tell; ``levels``: of each recording,
    with what lies above the band; ``vibration``: levels in bands.
    ``settings``: of identify, and of orders for the floor.
    """
    from crankorder.identify.findings import (  # half of the program: where no findings are wanted it is not loaded
        Measured,
        find,
    )

    measured = Measured(order_map, campbell, frames, envelope, followed, modes, levels, vibration)
    return find(measured, test=test, sources=sources, settings=settings)


@stage
def tracks(
    order_map: OrderMap, findings: Findings, frames: AllOrderFrames, followed: AllRecordingTracks, settings: Settings
) -> OrderTracks:
    """Orders of ``findings`` and ``settings`` over speed, read in ``order_map`` and ``frames`` or as ``followed``."""
    orders = followed_orders(findings, settings.orders)
    fixed = lines_of_findings(findings)
    return OrderTracks(
        order_tracks(order_map, orders, settings=settings.orders, frames=frames, followed=followed, fixed=fixed)
    )


@stage
def cycles(items: AllRecordingCycles, settings: Settings) -> CycleAverage:
    """Mean engine cycles ``items`` of all recordings joined at like speed (``settings`` of orders)."""
    return CycleAverage(cycle_averages(list(items), speed_bin_rpm=settings.orders.speed_bin_rpm))


@stage
def shapes(frames: AllOrderFrames, findings: Findings, settings: Settings) -> OperatingShapes:
    """Amplitude and phase over channels, of ``frames``, at the orders of ``findings`` and ``settings``."""
    orders = followed_orders(findings, settings.orders)
    return OperatingShapes(operating_shapes(list(frames), orders, settings=settings.orders))


@stage
def shaft_of_test(shafts: AllShaftAngles) -> ShaftSummary:
    """Speed, pulses used, angle error and speed against time of each of ``shafts``: one row each."""
    return ShaftSummary(shaft_summary(list(shafts)))


RESULTS: dict[str, object] = {
    "order_map": OrderMap,
    "campbell_map": CampbellMap,
    "order_tracks": OrderTracks,
    "findings": Findings,
    "cycle_average": CycleAverage,
    "operating_shapes": OperatingShapes,
    "envelope_map": EnvelopeMap,
    "vibration_levels": VibrationLevels,
}
"""Noun of each result that ``results`` of the report's settings may name."""

FRAMES_OF: dict[Any, Any] = {
    ShownOrderFrames: OrderFrames,
    AllFrequencyFrames: FrequencyFrames,
    ShownRecordingTracks: RecordingTracks,
    AllRecordingCycles: RecordingCycles,
    AllRecordingEnvelopes: RecordingEnvelope,
    AllRecordingLevels: RecordingLevels,
    AllLevelFrames: LevelFrames,
    AllShaftAngles: ShaftAngle,
}
"""Noun of one recording that each gathered noun of a test is made of."""


@dataclass(frozen=True)
class CampaignResult:
    """What a test gives to its report: datasets by result name, ``shaft`` among them, and findings.

    Dims are those of ``data_schema/``; findings are empty where none are asked for.
    """

    datasets: dict[str, xr.Dataset]
    findings: Findings


def frames_wanted(settings: Settings) -> tuple[Any, ...]:
    """Nouns of one recording that the results named in ``settings`` of the report need."""
    needs = _plan_of_test(settings.report.results).needs
    return tuple(noun for gathered, noun in FRAMES_OF.items() if gathered in needs and noun is not ShaftAngle)


@functools.cache
def _plan_of_test(results: tuple[str, ...]) -> StagePlan:
    """Plan of the results of that name; tracks follow only orders asked for by name where findings are not wanted."""
    given = [*FRAMES_OF, TestName, MachineModel, Settings]
    given += [] if "findings" in results else [Findings]
    return StagePlan(STAGES, wanted=[*(RESULTS[name] for name in results), ShaftSummary], given=given)


@functools.cache
def _plan_of_recording(wanted: tuple[Any, ...], given: tuple[Any, ...]) -> StagePlan:
    return StagePlan(STAGES, wanted=wanted, given=given)


OF_SHAFT_ALONE = "not sought: no vibration was recorded, the shaft alone"

_shafts: dict[int, tuple[Any, ShaftAngle]] = {}
"""What the pulses of each Recording in memory told last, by the array of their times, and from what."""


def analyse_shaft(recording: xr.Dataset, settings: Settings) -> ShaftAngle:
    """Crank angle [rev] and speed [rpm], each (time,), of the Recording ``recording``: computed once for all its maps.

    ``settings`` are those of all stages. Raises InputError where the encoder cannot be decoded.
    """
    attrs, held, orders = recording.attrs, recording.variables, settings.orders
    told = [held[name].values.tobytes() for name in held if name != "signal"]
    key = (repr(attrs), held["signal"].shape, told, settings.shaft, orders.max_order, orders.revs_per_frame)
    pulses, by_pulses = held.get("pulse_time", held["signal"]).values, attrs.get("encoder_kind") in PULSE_KINDS
    known, made = _shafts.get(id(pulses), (None, None))
    if made is None or known != key:
        given = {Recording: recording, Settings: settings}
        made = _plan_of_recording((ShaftAngle,), tuple(given)).run(given)[ShaftAngle]
        # where pulses are lacking, and where there are none, the signals are looked at, which may have changed
        if by_pulses and pulses.ndim == 1 and not any(flag["flag"] == NO_PULSES for flag in flags_of(made)):
            if known is None:
                weakref.finalize(pulses, _shafts.pop, id(pulses), None)
            _shafts[id(pulses)] = key, ShaftAngle(made)
    return ShaftAngle(made.copy(deep=True))


def analyse_recording(
    source: Path | xr.Dataset, manifest: Manifest, settings: Settings, engine: Engine | None = None
) -> RecordingResult:
    """Shaft angle and frames of the recording in ``source``, a file or a Recording, with ``settings``.

    Their dims are those of ``data_schema/``. ``manifest`` describes the recording; ``engine`` is that of the test,
    whose bearings are looked for where the manifest names none. Raises InputError, which names the file, where the
    recording cannot be used.
    """
    frames = frames_wanted(settings)
    bearings = manifest.bearings or (engine.bearings if engine is not None else ())
    known: dict[Any, Any] = {RecordingFile: source}
    if not isinstance(source, Path):
        known = {Recording: source, ShaftAngle: analyse_shaft(source, settings)}
    given = {**known, Manifest: manifest, Settings: settings, TestBearings: bearings}
    made = _plan_of_recording((ShaftAngle, *frames), tuple(given)).run(given)
    return RecordingResult(made[ShaftAngle], {noun: made[noun] for noun in frames})


def compare_recordings(recordings: list[RecordingResult], *, strict: bool, settings: Settings) -> Doubts:
    """Doubts about the ``recordings`` of a test from comparing them; ``strict`` leaves out "suspect" ones too.

    ``settings`` are those of all stages.
    """
    flags = {recording.name: recording.flags for recording in recordings}
    given = {**_gathered(recordings), RecordingFlags: flags, Strict: strict, Settings: settings}
    doubts: Doubts = _plan_of_recording((Doubts,), tuple(given)).run(given)[Doubts]
    return doubts


def analyse_test(
    recordings: list[RecordingResult], doubts: Doubts, *, test: str, sources: MachineModel, settings: Settings
) -> CampaignResult:
    """The results of the test named ``test`` that its ``settings`` ask for, from those of its ``recordings``.

    Recordings and channels that ``doubts`` leave out take no part. ``sources`` says what the machine is made of;
    ``settings`` are those of all stages.
    """
    kept = [recording.doubted(doubts) for recording in recordings if recording.name not in doubts.left_out]
    results = settings.report.results
    given = {TestName: test, MachineModel: sources, Settings: settings, Findings: nothing_sought(test, reason="")}
    made = _plan_of_test(results).run({**given, **_gathered(kept)})
    # what every band shows of every train of strikes is for the findings alone: it would double the results
    datasets = {
        str(name): made[RESULTS[name]].drop_dims("look", errors="ignore") for name in results if name != "findings"
    }
    datasets["shaft"] = made[ShaftSummary]
    found = made.get(Findings) or _unsought_findings(datasets, test=test, settings=settings)
    of_recordings = quality_of(flag for recording in kept for flag in recording.flags)
    quality = (*found.quality, *(flag for flag in of_recordings if flag not in found.quality))
    of_encoder = {order for order, name in NAMES.items() if any(f"encoder_{name}" == flag.flag for flag in quality)}
    encoder_deg = {float(order): settings.orders.largest_eccentricity_deg / order**2 for order in NAMES}
    swings = speed_swings(
        Gathered(kept, ShaftAngle), of_encoder=of_encoder, encoder_deg=encoder_deg, settings=settings.shaft
    )
    return CampaignResult(datasets, replace(found, quality=quality, speed_swing=swings))


def _gathered(recordings: list[RecordingResult]) -> dict[Any, Any]:
    """What all ``recordings`` gave, by the nouns of a test."""
    return {gathered: Gathered(recordings, noun) for gathered, noun in FRAMES_OF.items()}


def _unsought_findings(datasets: dict[str, xr.Dataset], *, test: str, settings: Settings) -> Findings:
    """Findings with nothing in them and the reason under ``not_asked_for``.

    ``datasets`` are the results of the ``test`` of that name, ``settings`` say which were asked for.
    """
    maps = [dataset for dataset in datasets.values() if "channel" in dataset.variables]
    columns = (maps[0][name].values.tolist() if maps else [] for name in ("channel", "unit", "quantity"))
    speeds = [dataset["speed"].values for dataset in maps if "speed" in dataset.variables]
    known = np.concatenate(speeds if maps else [datasets["shaft"][name].values for name in ("speed_min", "speed_max")])
    known = known[np.isfinite(known)]
    wanted = ", ".join(name.replace("_", " ") for name in settings.report.results)
    reason = f"not asked for: the recipe wants {wanted} only" if wanted else OF_SHAFT_ALONE
    made = tuple(Channel(name=name, unit=unit, quantity=kind) for name, unit, kind in zip(*columns, strict=True))
    tested = (float(known.min()), float(known.max())) if known.size else (None, None)
    quality = quality_of(flags_of_all(datasets.values()))
    return nothing_sought(test, reason=reason, channels=made, speed_range_rpm=tested, quality=quality)
