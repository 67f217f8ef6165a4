"""Recordings in memory, analysed together as a run analyses those of a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from crankorder.batch.execute import results_of_test, sources_of
from crankorder.batch.plan import settings_for
from crankorder.checks.doubts import RecordingResult
from crankorder.engine.definition import Engine, load_engine
from crankorder.errors import CrankorderError, InputError, NoUsableRecordingError, RequestError
from crankorder.findings import Findings
from crankorder.ingest.manifest import manifest_head, manifest_of
from crankorder.quantities import check_dataset
from crankorder.settings import Settings
from crankorder.stages import analyse_recording, compare_recordings

Recordings = xr.Dataset | Sequence[xr.Dataset]
"""One Recording, or several of one test."""


def engine_of(name: str | None) -> Engine | None:
    """The shipped engine ``name``, or that of a TOML file of this path; None without a name."""
    if name is not None and not isinstance(name, str):
        raise RequestError("an engine is a shipped name or a path", file="engine", found=repr(name))
    return None if name is None else load_engine(name)


def analysed(
    recordings: Recordings,
    settings: Settings,
    *,
    tables: Mapping[str, Any],
    engine: str | None = None,
    test: str = "test",
    strict: bool = False,
) -> tuple[dict[str, xr.Dataset], Findings, list[CrankorderError | str]]:
    """Groups and findings of ``recordings``, as a run makes them of files, and what was left out and why.

    ``settings`` of all stages; ``tables`` of the manifest that say what the machine is made of; ``engine``: its name or
    path; ``test``: the name of the test; ``strict`` leaves out what is "suspect" too.
    Raises RequestError or ManyErrors where the request is wrong, InputError where no recording can be used.
    """
    given = _each(recordings)
    # manifest of the recordings given with the tables that say what the machine is made of
    first = next(iter(given.values()))
    with_shaft = "four-stroke" if int(first.attrs["revs_per_cycle"]) == 2 else "rotor"
    cycle = with_shaft if first.attrs.get("has_shaft", 1) else "none"
    columns = (first[key].values.tolist() for key in ("channel", "unit"))
    channels = [dict(zip(("name", "unit"), row, strict=True)) for row in zip(*columns, strict=True)]
    stated = {key: dict(table) if isinstance(table, Mapping) else list(table) for key, table in tables.items() if table}
    manifest = manifest_of({**manifest_head(test, cycle, channels), **stated}, Path("machine"))
    settings, known = settings_for(manifest, settings), engine_of(engine)
    faults: list[CrankorderError] = []
    results: list[RecordingResult] = []
    for recording in given.values():
        try:
            results.append(analyse_recording(recording, manifest, settings, known))
        except InputError as error:
            faults.append(error)
    doubts = compare_recordings(results, strict=strict, settings=settings)
    faults += doubts.left_out.values()
    if len(doubts.left_out) == len(results):
        raise faults[0] if len(faults) == 1 else NoUsableRecordingError("no recording could be used", found=faults[0])
    sources = sources_of(manifest, known, settings)
    groups, findings, left_out = results_of_test(
        results, doubts, test=test, sources=sources, settings=settings, faults=faults
    )
    return groups, findings, [*faults, *left_out, *doubts.channels_left_out]


def _each(recordings: Recordings) -> dict[str, xr.Dataset]:
    """Recordings by names of their own: a name that comes again gets a number."""
    given = list(recordings) if isinstance(recordings, list | tuple) else [recordings]
    if not given:
        raise RequestError("no recording is given", file="recordings", allowed="a Recording, or several of one test")
    named: dict[str, xr.Dataset] = {}
    for recording in given:
        if not isinstance(recording, xr.Dataset):
            raise RequestError("not a Recording", file="recordings", found=type(recording).__name__)
        check_dataset(recording, "recording")
        stem = name = str(recording.attrs["recording"])
        number = 2
        while name in named:
            name, number = f"{stem} ({number})", number + 1
        named[name] = recording.assign_attrs(recording=name)
    return _alike(named)


def _alike(named: dict[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """Recordings ``named`` with their channels in one order; those that have not the same ones are refused."""
    first_name, first = next(iter(named.items()))
    wanted = _channels(first)
    for name, recording in named.items():
        found = _channels(recording)
        if found != wanted or recording.attrs["revs_per_cycle"] != first.attrs["revs_per_cycle"]:
            cycles = f"{recording.attrs['revs_per_cycle']} revolutions per cycle"
            raise RequestError(
                "the recordings of one test have the same channels, units and cycle",
                file=name,
                found=f"{', '.join(f'{key} [{unit}]' for key, unit in found.items())}; {cycles}",
                allowed=f"as {first_name}: {', '.join(f'{key} [{unit}]' for key, unit in wanted.items())}",
            )
    order = [str(key) for key in first["channel"].values]
    made = {}
    for name, recording in named.items():
        found_at = {str(key): place for place, key in enumerate(recording["channel"].values)}
        same = list(found_at) == order
        made[name] = recording if same else recording.isel(channel=[found_at[key] for key in order])
    return made


def _channels(recording: xr.Dataset) -> dict[str, str]:
    """Unit of each channel, by name."""
    return dict(sorted(zip(map(str, recording["channel"].values), map(str, recording["unit"].values), strict=True)))
