"""A look at every recording of a test before it is run: a bounded part of its samples, by the code that `run` uses."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import xarray as xr

from crankorder.batch.plan import settings_for
from crankorder.batch.workers import WorkerDiedError, each
from crankorder.checks.doubts import fault_of
from crankorder.errors import CrankorderError, InputError
from crankorder.ingest.check import check_folder
from crankorder.ingest.folder import recordings_of
from crankorder.ingest.manifest import Manifest, load_manifest
from crankorder.ingest.recording import read_parts
from crankorder.quantities import Floats, flags_of
from crankorder.settings import Settings, load_settings
from crankorder.shaft.angle import speed_course
from crankorder.stages import analyse_shaft

LOOK_BYTES = 64_000_000
"""Of the samples of one recording, as much as is looked at."""


@dataclass(frozen=True)
class Look:
    """Result for one recording: a ``line`` on its length, rate, speed and pulses, and ``remarks`` on doubts.

    ``share``, 0 to 1, of its samples was read.
    """

    line: str
    remarks: tuple[str, ...]
    share: float


@dataclass
class Looked:
    """Result for a folder: ``faults``, each of which excludes one recording or all of them, and ``looks``."""

    faults: list[CrankorderError]
    looks: list[Look] = field(default_factory=list)

    @property
    def share(self) -> float:
        """Smallest share of the samples of a recording that was read."""
        return min((look.share for look in self.looks), default=0.0)


def percent(share: float) -> str:
    """``share``, 0 to 1, as a text: "100 %" only where it is 1."""
    return "100 %" if share == 1.0 else f"{min(100 * share, 99.9):.2g} %"


def look_at(folder: Path, manifest_path: Path | None, *, jobs: int) -> Looked:
    """Check of the test in ``folder`` without a run, ``jobs`` recordings at a time.

    ``manifest_path`` names a manifest that lies elsewhere.
    """
    settings = load_settings()
    looked = Looked(check_folder(folder, manifest_path, settings=settings.ingest))
    try:
        manifest = load_manifest(folder, manifest_path)
        beside = manifest_path.parent if manifest_path is not None else folder
        settings = settings_for(manifest, load_settings(manifest.test.recipe, beside=beside))
        paths = recordings_of(folder, manifest).paths
    except CrankorderError as error:
        looked.faults = looked.faults or [error]
        return looked
    at_fault = {Path(fault.file) for fault in looked.faults if fault.file is not None}
    sound = [path for path in paths if path not in at_fault]
    answers = dict(each(lambda at: look_at_recording(sound[at], manifest, settings), len(sound), jobs=jobs))
    for number, path in enumerate(sound):
        try:
            looked.looks.append(answers[number].result())
        except CrankorderError as error:
            looked.faults.append(error)
        except WorkerDiedError as error:
            looked.faults.append(InputError("the process that read it died", file=path, found=error))
    return looked


def look_at_recording(path: Path, manifest: Manifest, settings: Settings) -> Look:
    """Look at a bounded part of the recording at ``path``, read and decoded by ``manifest`` and ``settings``.

    Raises CrankorderError where it cannot be used.
    """
    parts, share = read_parts(path, manifest, settings=settings.ingest, shaft=settings.shaft, most_bytes=LOOK_BYTES)
    remarks: dict[str, None] = {}
    speeds: list[Floats] = []
    pulses: list[str] = []
    refused: list[CrankorderError] = []
    for part in parts:
        try:
            shaft = analyse_shaft(part, settings)
        except InputError as error:
            refused.append(error)
            continue
        flags = [*flags_of(part), *flags_of(shaft)]
        fault = fault_of(manifest.name_of(path), flags)
        if fault is not None:
            refused.append(fault)
        remarks |= dict.fromkeys(
            f"{flag['severity']}: {flag['flag']}: {flag['detail']}" for flag in flags if flag["severity"] != "info"
        )
        if shaft.attrs.get("has_shaft", 1) and part.attrs["domain"] == "time":
            speeds.append(speed_course(shaft).speed_rpm)
        pulses = pulses or _pulses(part, shaft)
    # what one part of a long recording lacks, such as a shaft that turns yet, the whole of it may have
    if len(refused) == len(parts):
        raise refused[0]
    remarks |= dict.fromkeys(f"in a part of it: {error}" for error in refused)
    words = [_extent(parts, share), _speed(speeds), *pulses]
    if share < 1.0:
        words.append(f"{percent(share)} read")
    return Look(f"{manifest.name_of(path)}: {', '.join(word for word in words if word)}", tuple(remarks), share)


def _extent(parts: list[xr.Dataset], share: float) -> str:
    """Length and rate of a recording, of which ``parts`` are a ``share``."""
    attrs, n_samples = parts[0].attrs, sum(part["signal"].shape[-1] for part in parts) / share
    if attrs["domain"] == "crank_angle":
        return f"{n_samples / attrs['samples_per_rev']:.4g} revolutions, {attrs['samples_per_rev']} samples in each"
    if "rate_hz" not in attrs:
        times = parts[0]["pulse_time"].values
        return f"{float(np.ptp(times)):.4g} s" if times.size else "no pulses"
    return f"{n_samples / attrs['rate_hz']:.4g} s at {attrs['rate_hz']:.6g} Hz"


def _speed(speeds: list[Floats]) -> str:
    """The middle speed where that hardly changes, else from … to."""
    if not speeds:
        return ""
    every = np.concatenate(speeds)
    low, high = float(every.min()), float(every.max())
    return f"{float(np.median(every)):.4g} rpm" if high - low < 2e-3 * high else f"{low:.4g} to {high:.4g} rpm"


def _pulses(part: xr.Dataset, shaft: xr.Dataset) -> list[str]:
    """How many pulses a recording has, and on what wheel."""
    if "pulse_time" not in part or not part["pulse_time"].size:
        return []
    ends_s = part["pulse_time"].values[[0, -1]]
    turns = float(np.ptp(np.interp(ends_s, shaft["time"].values, shaft["crank_angle"].values)))
    count = part["pulse_time"].size
    per_rev = f" ({(count - 1) / turns:.4g} per revolution)" if turns > 0.0 else ""
    return [f"{count} pulses{per_rev}"]
