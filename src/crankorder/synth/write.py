"""A scene on disk: an ordinary test-run folder, with the truth beside it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import h5py

from crankorder.errors import EnvironmentFailure, RequestError
from crankorder.settings import shipped
from crankorder.synth.effects import TimeSampling
from crankorder.synth.load import load_scene
from crankorder.synth.manifest import manifest_text, toml_text
from crankorder.synth.recording import SyntheticRecording, broadband_response, synthesise
from crankorder.synth.scene import Run, Scene
from crankorder.synth.truth import truth_of

MANIFEST, TRUTH, ENGINE = "run.toml", "truth.json", "engine.toml"
RECORDING_NAME = re.compile(r"rpm_[0-9.]+(_[0-9]+)?\.h5")
MAX_WORKERS = 4
"""More threads gain nothing: the time of a recording is memory traffic."""


def write_scene(
    name: str,
    folder: Path,
    *,
    quick: bool = False,
    beside: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write the scene ``name`` as a test-run folder: ``run.toml``, ``rpm_*.h5`` and ``truth.json``.

    The truth comes first and claims the folder, the manifest last: a folder without it is unfinished and no test run.
    The same scene gives the same bytes on any number of workers.

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
        _claim(folder)
        truth = json.dumps(truth_of(scene), ensure_ascii=False, indent=1, allow_nan=False)
        _publish(folder / TRUTH, f"{truth}\n".encode())
        ours = scene.engine_file in shipped("engines")
        if not ours:
            engine = scene.engine.model_dump(exclude_none=True, exclude_defaults=True)
            _publish(folder / ENGINE, toml_text(engine).encode())
        _write_recordings(scene, folder, progress)
        _publish(folder / MANIFEST, manifest_text(scene, scene.engine_file if ours else ENGINE).encode())
    except OSError as error:
        if isinstance(error, EnvironmentFailure):
            raise
        raise EnvironmentFailure(
            "cannot write the scene",
            file=error.filename or folder,
            found=error.strerror or error,
            remedy="Free space or choose another folder",
        ) from error


def recording_image(scene: Scene, run: Run, recording: SyntheticRecording) -> bytes:
    """Bytes of the HDF5 file of one recording: a contiguous dataset per channel, encoder and index where there are any.

    ``scene``: names, units and sampling. ``run``: name and speed. ``recording``: the samples.
    """
    if isinstance(scene.sampling, TimeSampling):
        axis: dict[str, Any] = {"rate_hz": scene.sampling.rate_hz}
        start: dict[str, Any] = {}
    else:
        axis, start = {"samples_per_rev": scene.sampling.samples_per_rev}, {"start_deg": 0.0}
    with h5py.File(f"{run.name}.h5", "w", driver="core", backing_store=False, libver=("v110", "v110")) as file:
        for channel, signal in zip(scene.channels, recording.signal, strict=True):
            file.create_dataset(channel.source, data=signal).attrs.update({"unit": "m/s2", **axis})
        if recording.encoder is not None:
            file.create_dataset("encoder", data=recording.encoder).attrs.update({"unit": "V", **axis})
        if recording.index is not None:
            file.create_dataset("index", data=recording.index).attrs.update({"unit": "1", **axis})
        file.attrs.update({**axis, **start, "speed_rpm": run.speed_rpm})
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def _write_recordings(scene: Scene, folder: Path, progress: Callable[[int, int], None] | None) -> None:
    responses = {rate: broadband_response(scene, rate) for rate in {scene.rate_hz(run.speed_rpm) for run in scene.runs}}

    def write(run: Run) -> None:
        recording = synthesise(scene, run, responses[scene.rate_hz(run.speed_rpm)])
        _publish(folder / f"{run.name}.h5", recording_image(scene, run, recording))

    with ThreadPoolExecutor(max_workers=min(MAX_WORKERS, os.cpu_count() or 1)) as pool:
        tasks = [pool.submit(write, run) for run in scene.runs]
        try:
            for done, task in enumerate(as_completed(tasks), start=1):
                task.result()
                if progress is not None:
                    progress(done, len(tasks))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


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
        raise RequestError(
            "the folder is not empty and was not written by a scene",
            file=folder,
            found=", ".join(sorted(present)[:5]),
            allowed="a new or empty folder, or one of a former scene",
        )
    for name in (MANIFEST, *sorted(former & present)):
        (folder / name).unlink(missing_ok=True)


def _former_recordings(truth: Path) -> set[str] | None:
    """File names of the recordings that a former scene wrote, None where ``truth`` is not a scene's."""
    try:
        content = json.loads(truth.read_text(encoding="utf-8"))
        names = {str(record["name"]) for record in content["recordings"] if "scene" in content}
    except (OSError, ValueError, LookupError, TypeError):
        return None
    return {name for name in names if RECORDING_NAME.fullmatch(name)} if "scene" in content else None


def _publish(path: Path, content: bytes) -> None:
    """Write beside and rename, so that a file is there whole or not at all."""
    part = path.with_name(f".{path.name}.part")
    part.unlink(missing_ok=True)
    try:
        with part.open("xb") as file:
            file.write(content)
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
