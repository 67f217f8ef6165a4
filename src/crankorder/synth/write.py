"""A scene on disk: an ordinary test-run folder with its manifest, and the truth beside it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import TypeGuard

import h5py
import numpy as np
from numpy.typing import NDArray

from crankorder.errors import EnvironmentFailure, RequestError
from crankorder.quantities import Attribute, Truth
from crankorder.records import Json
from crankorder.settings import shipped
from crankorder.synth.load import load_scene
from crankorder.synth.noise import floor_of
from crankorder.synth.parts import INDEX, TRACE, Channel, Encoder, TimeSampling, WrongLabels
from crankorder.synth.recording import SyntheticRecording, synthesise
from crankorder.synth.scene import SWEEP, Run, Scene
from crankorder.synth.truth import name_of_test, truth_of


def manifest_text(scene: Scene, engine_name: str, repeat: int = 0) -> str:
    """Text of ``run.toml`` for the folder of one ``repeat`` of ``scene``, wrong labels included.

    ``engine_name``: a shipped engine or a file in the folder.
    """
    recordings: dict[str, object] = {
        "files": ["rpm_*.h5"] if scene.speeds is not None else [f"{run.name}.h5" for run in scene.runs]
    }
    labels = scene.wrong_labels or WrongLabels()
    table: dict[str, object] = {
        "schema_version": 1,
        "test": {"name": name_of_test(scene, repeat), "engine": engine_name, "cycle": scene.engine.cycle},
    }
    table["recordings"] = recordings
    if isinstance(scene.sampling, TimeSampling):
        table["sampling"] = {"domain": "time", "rate_hz": scene.sampling.rate_hz}
    else:
        samples_per_rev = scene.sampling.samples_per_rev
        table["sampling"] = {"domain": "crank_angle", "samples_per_rev": samples_per_rev, "start_deg": 0.0}
        recordings["speed_rpm"] = {f"{run.name}.h5": run.speed_rpm for run in scene.runs}
    table["channels"] = [_channel(scene, channel) for channel in scene.channels]
    if scene.encoder is not None:
        table["encoder"] = _encoder(scene.encoder, labels)
    table["bearings"] = [
        bearing.model_dump(exclude_none=True, exclude_defaults=True) for bearing in scene.engine.bearings
    ]
    return toml_text(table)


def _channel(scene: Scene, channel: Channel) -> dict[str, str]:
    swapped = scene.wrong_labels.swapped if scene.wrong_labels else None
    source = channel.source
    if swapped is not None and channel.name in swapped:
        other = swapped[1 - swapped.index(channel.name)]
        source = next(entry.source for entry in scene.channels if entry.name == other)
    entry = {"name": channel.name, "source": source, "quantity": "acceleration", "unit": "m/s2"}
    if scene.acquisition.sensitivity_mv_per_g is not None:
        entry["sensitivity"] = f"{scene.acquisition.sensitivity_mv_per_g:.12g} mV/g"
    return entry | {"direction": channel.direction}


def _encoder(encoder: Encoder, labels: WrongLabels) -> dict[str, object]:
    table: dict[str, object] = {
        "source": TRACE,
        "kind": "square",
        "pulses_per_rev": labels.pulses_per_rev or encoder.pulses_per_rev,
        "missing_teeth": encoder.missing_teeth,
        "ratio": encoder.ratio,
    }
    if encoder.index:
        table["index"] = INDEX
    if encoder.index or encoder.missing_teeth or encoder.pulses_per_rev == 1:
        table["index_to_tdc_deg"] = encoder.index_to_tdc_deg
    return table | {"edge": "rising"}


def toml_text(table: Mapping[str, object], prefix: str = "") -> str:
    """TOML text of ``table``: plain values first, then its tables and lists of tables under ``prefix``."""
    tables = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    lists = {key: value for key, value in table.items() if _is_list_of_tables(value)}
    lines = [f"{_key(key)} = {_value(value)}" for key, value in table.items() if key not in tables and key not in lists]
    text = "".join(f"{line}\n" for line in lines)
    for key, inner in tables.items():
        path = f"{prefix}{_key(key)}"
        text += f"\n[{path}]\n{toml_text(inner, f'{path}.')}"
    for key, items in lists.items():
        path = f"{prefix}{_key(key)}"
        text += "".join(f"\n[[{path}]]\n{toml_text(item, f'{path}.')}" for item in items)
    return text


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _value(key)


def _is_list_of_tables(value: object) -> TypeGuard[Sequence[Mapping[str, object]]]:
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(item, Mapping) for item in value)


def _value(value: object) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(item) for item in value)}]"
    if isinstance(value, str):
        # the one character where TOML is stricter
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value)


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
        for repeat, place in enumerate(folders):
            ours = scene.engine_file in shipped("engines")
            if not ours:
                engine = scene.engine.model_dump(exclude_none=True, exclude_defaults=True)
                _publish_text(place / ENGINE, toml_text(engine))
            _publish_text(place / MANIFEST, manifest_text(scene, scene.engine_file if ours else ENGINE, repeat))
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
    if isinstance(scene.sampling, TimeSampling):
        axis = {"rate_hz": scene.sampling.rate_hz}
        stated = {} if scene.speeds is None else {"speed_rpm": run.speed_rpm}
    else:
        axis = {"samples_per_rev": scene.sampling.samples_per_rev}
        stated = {"start_deg": 0.0, "speed_rpm": run.speed_rpm}
    columns: dict[str, tuple[NDArray[np.generic] | None, dict[str, Attribute]]] = {}
    unit = "m/s2" if scene.acquisition.sensitivity_mv_per_g is None else "V"
    packing = {} if recording.recorded.scale is None else {"scale_factor": recording.recorded.scale}
    for channel, samples in zip(scene.channels, recording.recorded.samples, strict=True):
        columns[channel.source] = samples, {"unit": unit, **packing, **axis}
    if recording.encoder is not None:
        columns[TRACE] = recording.encoder.trace, {"unit": "V", **axis}
        columns[INDEX] = recording.encoder.index, {"unit": "1", **axis}
    with h5py.File(path, "x", libver=("v110", "v110")) as file:
        for source, (values, attrs) in columns.items():
            if values is not None:
                file.create_dataset(source, data=values).attrs.update(attrs)
        file.attrs.update({**axis, **stated})


def _write_truth(truth: Truth, folder: Path) -> None:
    _publish_text(folder / TRUTH, f"{json.dumps(truth, ensure_ascii=False, indent=1, allow_nan=False)}\n")


def _write_recordings(
    scene: Scene, folders: list[Path], progress: Callable[[int, int], None] | None
) -> list[list[dict[str, Json]]]:
    """Write every recording of every repeat; what was made faulty in each repeat, and where."""
    runs = [run for repeat in range(len(folders)) for run in scene.runs_of(repeat)]
    # one floor for all where the rate is one; by crank angle every speed has its own, and all at once would be too many
    shared = floor_of(scene, scene.rate_hz(runs[0].speed_rpm)) if isinstance(scene.sampling, TimeSampling) else None

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
        _refuse(folder, [path.name for path in folder.iterdir() if not ours.fullmatch(path.name)])
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
    if not present:
        return
    former = _former_recordings(folder / TRUTH)
    if former is None:
        _refuse(folder, list(present))
        return
    for name in (MANIFEST, *sorted(former & present)):
        (folder / name).unlink(missing_ok=True)


def _refuse(folder: Path, strange: list[str]) -> None:
    if strange:
        problem = "the folder is not empty and was not written by a scene"
        allowed = "a new or empty folder, or one of a former scene"
        raise RequestError(problem, file=folder, found=", ".join(sorted(strange)[:5]), allowed=allowed)


def _former_recordings(truth: Path) -> set[str] | None:
    """File names of the recordings that a former scene wrote, None where ``truth`` is not a scene's."""
    try:
        content = json.loads(truth.read_text(encoding="utf-8"))
        names = {str(record["name"]) for record in content["recordings"] if "scene" in content}
    except (OSError, ValueError, LookupError, TypeError):
        return None
    return {name for name in names if RECORDING_NAME.fullmatch(name)} if "scene" in content else None


def _publish_text(path: Path, text: str) -> None:
    _publish(path, lambda part: part.write_bytes(text.encode()))


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
