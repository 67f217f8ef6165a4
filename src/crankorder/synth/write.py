"""A scene on disk: an ordinary test-run folder with its manifest, and the truth beside it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from crankorder.engine.forces import crankcase_forces
from crankorder.engine.machine_parts import bearing_orders
from crankorder.engine.slider_crank import acceleration_harmonics
from crankorder.errors import EnvironmentFailure, RequestError
from crankorder.quantities import Attribute, Truth
from crankorder.records import Json
from crankorder.settings import shipped
from crankorder.synth import parts
from crankorder.synth.lines import crank_forces, fixed_lines, order_lines, slipping_line, strikes_per_rev
from crankorder.synth.load import load_scene
from crankorder.synth.noise import floor_density, floor_of
from crankorder.synth.recording import SyntheticRecording, synthesise
from crankorder.synth.scene import SWEEP, Run, Scene

UNIT = "m/s2"
VISIBLE_DB = 14.0
"""A line is said to show where it stands this far above the floor of a spectrum over the whole recording: noise alone
reaches 11.4 dB with a chance of 1e-6, and a line at 14 dB is above that 95 times in a hundred."""
LEAST_SHARE = 1e-9
"""Of the largest line: what is below is in the recordings but not worth a record."""
SWEEP_PARTS = 40
"""A line of a speed profile is said to show if it would in so large a part of the recording at one speed."""
N_SPEEDS = 241
"""Steady speeds at which the lines of a speed profile are told."""
PROMINENT_DB = 6.0
"""A mode is said to show in a channel where it lifts the floor at its natural frequency by this much."""


def manifest_text(scene: Scene, engine_name: str, repeat: int = 0) -> str:
    """Text of ``run.toml`` for the folder of one ``repeat`` of ``scene``, wrong labels included.

    ``engine_name``: a shipped engine or a file in the folder.
    """
    speeds = {f"{run.name}.h5": run.speed_rpm for run in scene.runs}
    recordings: dict[str, object] = {"files": ["rpm_*.h5"] if scene.speeds is not None else list(speeds)}
    sampling: dict[str, object] = {"domain": scene.sampling.domain}
    if isinstance(scene.sampling, parts.TimeSampling):
        sampling["rate_hz"] = scene.sampling.rate_hz
    else:
        sampling |= {"samples_per_rev": scene.sampling.samples_per_rev, "start_deg": 0.0}
        recordings["speed_rpm"] = speeds
    bearings = [bearing.model_dump(exclude_none=True, exclude_defaults=True) for bearing in scene.engine.bearings]
    table = {
        "schema_version": 1,
        "test": {"name": name_of_test(scene, repeat), "engine": engine_name, "cycle": scene.engine.cycle},
        "recordings": recordings,
        "sampling": sampling,
        "channels": [_channel(scene, channel) for channel in scene.channels],
        "encoder": None
        if scene.encoder is None
        else _encoder(scene.encoder, scene.wrong_labels or parts.WrongLabels()),
        "bearings": bearings,
    }
    return toml_text({key: value for key, value in table.items() if value is not None})


def _channel(scene: Scene, channel: parts.Channel) -> dict[str, str]:
    swapped = (scene.wrong_labels and scene.wrong_labels.swapped) or ()
    labelled = swapped[1 - swapped.index(channel.name)] if channel.name in swapped else channel.name
    source = next(entry.source for entry in scene.channels if entry.name == labelled)
    entry = {"name": channel.name, "source": source, "quantity": "acceleration", "unit": "m/s2"}
    if scene.acquisition.sensitivity_mv_per_g is not None:
        entry["sensitivity"] = f"{scene.acquisition.sensitivity_mv_per_g:.12g} mV/g"
    return entry | {"direction": channel.direction}


def _encoder(encoder: parts.Encoder, labels: parts.WrongLabels) -> dict[str, object]:
    table: dict[str, object] = {
        "source": parts.TRACE,
        "kind": "square",
        "pulses_per_rev": labels.pulses_per_rev or encoder.pulses_per_rev,
        "missing_teeth": encoder.missing_teeth,
        "ratio": encoder.ratio,
    }
    if encoder.index:
        table["index"] = parts.INDEX
    if encoder.index or encoder.missing_teeth or encoder.pulses_per_rev == 1:
        table["index_to_tdc_deg"] = encoder.index_to_tdc_deg
    return table | {"edge": "rising"}


def toml_text(table: Mapping[str, object], prefix: str = "") -> str:
    """TOML text of ``table``: plain values first, then its tables and lists of tables under ``prefix``."""
    plain, tables, lists = "", "", ""
    for key, value in table.items():
        name = key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml_value(key)
        path = f"{prefix}{name}"
        if isinstance(value, Mapping):
            tables += f"\n[{path}]\n{toml_text(value, f'{path}.')}"
        elif isinstance(value, list | tuple) and value and all(isinstance(entry, Mapping) for entry in value):
            lists += "".join(f"\n[[{path}]]\n{toml_text(entry, f'{path}.')}" for entry in value)
        else:
            plain += f"{name} = {_toml_value(value)}\n"
    return plain + tables + lists


def _toml_value(value: object) -> str:
    # the one character where TOML is stricter than JSON
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


MANIFEST, TRUTH, ENGINE = "run.toml", "truth.json", "engine.toml"
RECORDING_NAME = re.compile(rf"(rpm_[0-9.]+(_[0-9]+)?|{SWEEP})\.h5")
REPEAT_NAME = "run_{}"
MAX_WORKERS = 4
"""More threads gain nothing: the time of a recording is memory traffic."""


def write_scene(
    name: str,
    folder: Path,
    *,
    quick: bool = False,
    beside: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Folders written for the scene ``name``: each a test run with ``run.toml``, recordings and ``truth.json``.

    That is ``folder`` itself; a scene of several repeats becomes ``run_1`` and on in it. The truth comes first and
    claims the folder, the manifest last: a folder without it is unfinished and no test run. The same scene gives the
    same bytes on any number of workers.

    ``name``: a shipped scene or the path of a TOML file. ``folder``: new, empty, or of a former scene (replaced).
    ``quick``: with the differences of the scene's ``quick`` table. ``beside``: folder in which paths are tried first.
    ``progress``: called with the number of recordings done and to do.
    Raises ManyErrors for a bad scene, RequestError for a folder with other content, EnvironmentFailure where it cannot
    be written.
    """
    scene = load_scene(name, beside)
    if quick:
        scene = scene.first_look()
    try:
        folders = _claimed(scene, folder)
        truths = [truth_of(scene, repeat) for repeat in range(scene.repeats)]
        for truth, place in zip(truths, folders, strict=True):
            _write_truth(truth, place)
        for repeat, faults in enumerate(_write_recordings(scene, folders, progress)):
            if faults:
                _write_truth(Truth({**truths[repeat], "quality": faults}), folders[repeat])
        ours = scene.engine_file in shipped("engines")
        engine = toml_text(scene.engine.model_dump(exclude_none=True, exclude_defaults=True))
        for repeat, place in enumerate(folders):
            manifest = manifest_text(scene, scene.engine_file if ours else ENGINE, repeat)
            for name, text in (({} if ours else {ENGINE: engine}) | {MANIFEST: manifest}).items():
                _publish(place / name, partial(Path.write_bytes, data=text.encode()))
        return folders
    except OSError as error:
        if isinstance(error, EnvironmentFailure):
            raise
        remedy = "Free space or choose another folder"
        raise EnvironmentFailure(
            "cannot write the scene", file=error.filename or folder, found=error.strerror or error, remedy=remedy
        ) from error


def write_recording(path: Path, scene: Scene, run: Run, recording: SyntheticRecording) -> None:
    """Make the HDF5 file of one recording: a contiguous dataset per channel, encoder and index where there are any.

    ``path``: of a new file. ``scene``: names, units and sampling, as its labels say. ``run``: name and speed.
    ``recording``: the samples.
    """
    axis: dict[str, Attribute]
    if isinstance(scene.sampling, parts.TimeSampling):
        axis = {"rate_hz": scene.sampling.rate_hz}
        stated = {} if scene.speeds is None else {"speed_rpm": run.speed_rpm}
    else:
        axis = {"samples_per_rev": scene.sampling.samples_per_rev}
        stated = {"start_deg": 0.0, "speed_rpm": run.speed_rpm}
    columns: dict[str, tuple[NDArray[np.generic] | None, dict[str, Attribute]]] = {}
    packing = {} if recording.recorded.scale is None else {"scale_factor": recording.recorded.scale}
    for channel, samples in zip(scene.channels, recording.recorded.samples, strict=True):
        columns[channel.source] = samples, {"unit": recording.recorded.unit, **packing, **axis}
    if recording.encoder is not None:
        columns[parts.TRACE] = recording.encoder.trace, {"unit": "V", **axis}
        columns[parts.INDEX] = recording.encoder.index, {"unit": "1", **axis}
    with h5py.File(path, "x", libver=("v110", "v110")) as file:
        for source, (values, attrs) in columns.items():
            if values is not None:
                file.create_dataset(source, data=values).attrs.update(attrs)
        file.attrs.update({**axis, **stated})


def _write_truth(truth: Truth, folder: Path) -> None:
    text = f"{json.dumps(truth, ensure_ascii=False, indent=1, allow_nan=False)}\n"
    _publish(folder / TRUTH, partial(Path.write_bytes, data=text.encode()))


def _write_recordings(
    scene: Scene, folders: list[Path], progress: Callable[[int, int], None] | None
) -> list[list[dict[str, Json]]]:
    """Write every recording of every repeat; what was made faulty in each repeat, and where."""
    runs = [run for repeat in range(len(folders)) for run in scene.runs_of(repeat)]
    # one floor for all where the rate is one; by crank angle every speed has its own, and all at once would be too many
    shared = (
        floor_of(scene, scene.rate_hz(runs[0].speed_rpm)) if isinstance(scene.sampling, parts.TimeSampling) else None
    )

    def write(run: Run) -> list[dict[str, Json]]:
        recording = synthesise(scene, run, shared or floor_of(scene, scene.rate_hz(run.speed_rpm)))
        path = folders[run.repeat] / f"{run.name}.h5"
        try:
            _publish(path, lambda part: write_recording(part, scene, run, recording))
        except RuntimeError as error:  # HDF5's, where it cannot finish a file
            raise OSError(str(error)) from error
        return recording.faults

    with ThreadPoolExecutor(max_workers=min(MAX_WORKERS, os.cpu_count() or 1)) as pool:
        tasks = {pool.submit(write, run): run for run in runs}
        try:
            for done, task in enumerate(as_completed(tasks), start=1):
                task.result()
                if progress is not None:
                    progress(done, len(tasks))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return [
        [fault for task, run in tasks.items() if run.repeat == repeat for fault in task.result()]
        for repeat in range(len(folders))
    ]


def _claimed(scene: Scene, folder: Path) -> list[Path]:
    """The folders of all repeats of ``scene``, made ready: ``folder`` itself where there is only one."""
    if scene.repeats == 1:
        _claim(folder)
        return [folder]
    folders = [folder / REPEAT_NAME.format(repeat + 1) for repeat in range(scene.repeats)]
    if folder.is_dir():
        ours = re.compile(REPEAT_NAME.format("[0-9]+"))
        _refuse(folder, {path.name for path in folder.iterdir() if not ours.fullmatch(path.name)})
    folder.mkdir(parents=True, exist_ok=True)
    for place in sorted({*folder.iterdir(), *folders}):
        _claim(place)
        if place not in folders:  # of a former scene with more repeats
            for left in (ENGINE, TRUTH):
                (place / left).unlink(missing_ok=True)
            if not any(place.iterdir()):
                place.rmdir()
    return folders


def _claim(folder: Path) -> None:
    """Make ``folder`` ready: create it, or take away what a former scene wrote; refuse a folder with anything else."""
    if folder.exists() and not folder.is_dir():
        raise RequestError("not a folder", file=folder, remedy="Name a new folder")
    folder.mkdir(parents=True, exist_ok=True)
    present = {path.name for path in folder.iterdir() if path.suffix != ".part"}  # left by a write that was cut off
    try:
        truth = json.loads((folder / TRUTH).read_text(encoding="utf-8"))
        former = {str(record["name"]) for record in truth["recordings"] if truth["scene"] is not None}
    except (OSError, ValueError, LookupError, TypeError):
        _refuse(folder, present)
        return
    for name in (MANIFEST, *sorted(former & present)):
        if name == MANIFEST or RECORDING_NAME.fullmatch(name):
            (folder / name).unlink(missing_ok=True)


def _refuse(folder: Path, strange: set[str]) -> None:
    """Raise RequestError where ``folder`` holds ``strange`` files."""
    if strange:
        problem = "the folder is not empty and was not written by a scene"
        allowed = "a new or empty folder, or one of a former scene"
        raise RequestError(problem, file=folder, found=", ".join(sorted(strange)[:5]), allowed=allowed)


def _publish(path: Path, fill: Callable[[Path], object]) -> None:
    """Have ``fill`` make a file beside ``path`` and rename it, so that a file is there whole or not at all."""
    part = path.with_name(f".{path.name}.part")
    part.unlink(missing_ok=True)
    try:
        fill(part)
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def truth_of(scene: Scene, repeat: int = 0) -> Truth:
    """Everything that ``scene`` puts into its recordings: order lines, modes, crossings, bearings, balance.

    Amplitudes are peaks, phases count from top dead centre (``phase_ambiguity_deg`` tells by how much a half order's
    phase shifts when the other of the two dead centres is taken). ``floor_density`` is the one-sided amplitude density
    of the noise at the line, unit/√Hz; ``speed_range_rpm`` the speeds at which the line shows (``VISIBLE_DB``). For a
    speed profile the lines are those of steady speeds between its lowest and highest. ``repeat``: which one, from 0.
    What was made faulty is not here yet: ``quality`` is known when the recordings are made.
    """
    runs = scene.runs_of(repeat)
    as_set = {key: getattr(scene, key) for key in ("acquisition", "encoder", "wrong_labels")}
    return Truth(
        {
            "schema_version": 1,
            "test": name_of_test(scene, repeat),
            "scene": {"engine": scene.engine_file, "seed": scene.seed},
            "recordings": [_recording(scene, run) for run in runs],
            "channels": [{"name": name, "unit": UNIT} for name in scene.channel_names],
            "orders": _orders(scene, runs),
            "modes": _modes(scene),
            "crossings": _crossings(scene, runs[0]),
            "bearings": _bearings(scene, repeat),
            "lines": _lines(scene),
            "balance": _balance(scene),
            **{key: part and part.model_dump(exclude_defaults=True) for key, part in as_set.items()},
            "quality": [],
        }
    )


def name_of_test(scene: Scene, repeat: int) -> str:
    """Name of the test of one ``repeat`` of ``scene``."""
    return scene.title if scene.repeats == 1 else f"{scene.title}, run {repeat + 1}"


def _recording(scene: Scene, run: Run) -> dict[str, Json]:
    """Name and speed of a recording; of a profile its corners too."""
    name, profile = f"{run.name}.h5", scene.speed_profile
    if profile is None:
        return {"name": name, "speed_rpm": run.speed_rpm}
    return {"name": name, "time_s": list(profile.time_s), "speed_rpm": list(profile.rpm)}


def _steady_speeds(scene: Scene, runs: tuple[Run, ...]) -> list[tuple[Run, float]]:
    """Every recording with its speed; for a speed profile ``N_SPEEDS`` from its lowest to its highest.

    Of a shaft that turns both ways they are the speeds from 0 up, as if it turned forwards.
    """
    if scene.speed_profile is None:
        return [(run, run.speed_rpm) for run in runs]
    low, high = scene.speed_range_rpm
    if low < 0 < high:
        low, high = 0.0, max(-low, high)
    return [(runs[0], float(speed)) for speed in np.linspace(low, high, N_SPEEDS) if speed != 0]


def _orders(scene: Scene, runs: tuple[Run, ...]) -> list[dict[str, Json]]:
    steady = _steady_speeds(scene, runs)
    if not steady:
        return []
    forces = crank_forces(scene)
    lines = [order_lines(scene, run, speed_rpm, forces=forces) for run, speed_rpm in steady]
    speed = np.array([speed_rpm for _, speed_rpm in steady])
    rate_hz = np.array([scene.rate_hz(rpm) for rpm in speed])
    duration_s = scene.n_samples / rate_hz / (1 if scene.speed_profile is None else SWEEP_PARTS)
    records: list[dict[str, Json]] = []
    least = LEAST_SHARE * max(np.abs(part.amplitude).max(initial=0.0) for part in lines)
    orders = np.unique(np.concatenate([part.order for part in lines]))
    amplitudes = np.zeros((len(lines), orders.size, len(scene.channels)), dtype=np.complex128)
    for at_speed, part in zip(amplitudes, lines, strict=True):
        np.add.at(at_speed, np.searchsorted(orders, part.order), part.amplitude.T)
    at = zip(np.abs(speed) / 60, rate_hz, strict=True)
    floors = np.array([floor_density(scene, orders * turns_hz, scene.structure, rate) for turns_hz, rate in at])
    for order, amplitude, floor in zip(orders, amplitudes.transpose(1, 2, 0), floors.transpose(2, 1, 0), strict=True):
        with np.errstate(divide="ignore", invalid="ignore"):
            above_floor_db = 10 * np.log10(np.abs(amplitude) ** 2 * duration_s / (2 * floor**2))
        for channel, name in enumerate(scene.channel_names):
            size = np.abs(amplitude[channel])
            if order == 0 or size.max() <= least:
                continue
            peak, shows = int(size.argmax()), above_floor_db[channel] >= VISIBLE_DB
            alike = np.flatnonzero(lines[peak].order == order)
            cause = lines[peak].cause[alike[np.abs(lines[peak].amplitude[channel, alike]).argmax()]]
            records.append(
                {
                    "channel": name,
                    "order": float(order),
                    "amplitude": float(size[peak]),
                    "phase_deg": float(np.degrees(np.angle(amplitude[channel, peak]))),
                    "phase_ambiguity_deg": float(360 * order % 360),
                    "unit": UNIT,
                    "speed_rpm_at_max": float(speed[peak]),
                    "speed_range_rpm": [float(speed[shows].min()), float(speed[shows].max())] if shows.any() else None,
                    "explained_by": cause,
                    "speed_rpm": speed.tolist(),
                    "amplitude_by_speed": size.tolist(),
                    "phase_deg_by_speed": np.degrees(np.angle(amplitude[channel])).tolist(),
                    "floor_density_by_speed": floor[channel].tolist(),
                }
            )
    return records


def _modes(scene: Scene) -> list[dict[str, Json]]:
    structure = scene.structure
    records: list[dict[str, Json]] = []
    for j, mode in enumerate(scene.modes):
        rest = np.arange(len(scene.modes)) != j
        by_mode = ("frequency_hz", "damping_ratio", "sensor_per_kg", "drive")
        without = replace(structure, **{name: getattr(structure, name)[rest] for name in by_mode})
        at = np.array([mode.frequency_hz])
        rate_hz = scene.rate_hz(scene.speed_range_rpm[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            alone = floor_density(scene, at, without, rate_hz)
            lift_db = 20 * np.log10(floor_density(scene, at, structure, rate_hz) / alone)[:, 0]
        shows = [name for name, lift in zip(scene.channel_names, lift_db, strict=True) if lift >= PROMINENT_DB]
        about = {"frequency_hz": mode.frequency_hz, "damping_ratio": mode.damping_ratio}
        records.append({**about, "channels": shows, "explained_by": "mode"})
    return records


def _crossings(scene: Scene, run: Run) -> list[dict[str, Json]]:
    """Every meeting of an order with a mode; excited where a force of that order drives the mode."""
    slowest, fastest = scene.speed_range_rpm
    forces, bearing_lines = crank_forces(scene), fixed_lines(scene, run)
    acting = forces.at_speed(max(abs(fastest), 1.0))
    drives = np.abs(scene.structure.drive @ acting)
    driven = drives > LEAST_SHARE * drives.max(initial=0.0)
    orders = {*forces.order[acting.any(axis=0)].tolist(), *bearing_lines.order.tolist()}
    return [
        {
            "order": order,
            "mode_hz": mode.frequency_hz,
            "rpm": 60 * mode.frequency_hz / order,
            "in_range": slowest <= 60 * mode.frequency_hz / order <= fastest,
            "excited": bool(driven[number, forces.order == order].any()),
        }
        for order, (number, mode) in product(sorted(orders), enumerate(scene.modes))
    ]


def _bearings(scene: Scene, repeat: int) -> list[dict[str, Json]]:
    orders = {bearing.name: bearing_orders(bearing) for bearing in scene.engine.bearings}
    records: list[dict[str, Json]] = []
    both: tuple[parts.BearingLine | parts.BearingImpacts, ...] = (*scene.bearing_lines, *scene.bearing_impacts)
    for line in both:
        strikes = isinstance(line, parts.BearingImpacts)
        known = orders[line.bearing]
        expected = strikes_per_rev(known, line.line) if strikes else known[line.line]
        by_channel = line.peak_m_s2 if isinstance(line, parts.BearingImpacts) else line.amplitude_m_s2
        grown = {name: value * line.growth**repeat for name, value in by_channel.items()}
        records.append(
            {
                "name": line.bearing,
                "line": line.line,
                "order": slipping_line(expected, slip_percent=line.slip_percent),
                "order_expected": expected,
                "amplitude": max(grown.values(), default=0.0),
                "amplitude_by_channel": grown,
                "unit": UNIT,
                "verdict": "strikes" if strikes else "slips" if line.slip_percent else "locked",
                "resonance_hz": line.resonance_hz if isinstance(line, parts.BearingImpacts) else None,
            }
        )
    return records


def _lines(scene: Scene) -> list[dict[str, Json]]:
    """Lines that follow no crank: tones, and orders of shafts with a speed of their own."""
    records: list[dict[str, Json]] = [
        {
            "channel": name,
            "frequency_hz": number * tone.frequency_hz,
            "explained_by": tone.cause,
            "amplitude": share * amplitude,
        }
        for tone in scene.tones
        for number, share in enumerate(tone.harmonics, start=1)
        for name, amplitude in tone.amplitude_m_s2.items()
        if share * amplitude
    ]
    for shaft, injected in product(scene.other_shafts, scene.injected_orders):
        if shaft.rpm is not None and injected.shaft == shaft.name:
            hertz = [injected.order * rpm / 60 for rpm in shaft.rpm]
            records.append({"shaft": shaft.name, "order_of_shaft": injected.order, "frequency_hz": hertz})
    return records


def _balance(scene: Scene) -> dict[str, Json] | None:
    """What shakes at the first order; None where the scene has no engine forces."""
    if scene.engine_forces is None:
        return None
    engine = scene.engine
    omega_squared = (1000 * np.pi / 30) ** 2
    first = crankcase_forces(engine, 1000.0, max_order=1)[:, 1] / omega_squared
    per_kg = engine.crank_radius_m * np.abs(acceleration_harmonics(engine.mechanism, 1)[1])
    rotating = 1j * first[0]  # what turns with the crank makes as much across as along, a quarter turn apart
    reciprocating = first[2] - rotating
    return {
        "residual_reciprocating_g": 1e3 * float(np.abs(reciprocating) / per_kg),
        "residual_rotating_gmm": 1e6 * float(np.abs(rotating)),
        "angle_deg": float(np.degrees(np.angle(rotating))) if rotating else 0.0,
        "crank_radius_m": engine.crank_radius_m,
    }
