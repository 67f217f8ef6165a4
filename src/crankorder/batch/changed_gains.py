"""Recordings that differ from the others of their test: channels of another gain are emptied, short ones named."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from crankorder.orders.level_jumps import RecordedLevel, level_jumps, line_sizes
from crankorder.quantities import Floats, OrderFrames, QualityFlag, RecordingLevels, ShaftAngle, with_flags
from crankorder.settings import IngestSettings, MethodNumbers
from crankorder.stages import RecordingResult

_NOTHING_IS_ZERO = ("degrees_of_freedom", "n_independent", "n_cycles", "peak_above")
"""Variables in which a channel without data has 0; in all others NaN."""


def without_changed_gains(
    results: Mapping[Path, RecordingResult], *, settings: IngestSettings
) -> dict[Path, RecordingResult]:
    """``results`` of the recordings by file, in which a channel whose gain is another holds no data.

    ``settings`` say by how much a level must jump for that, and by how much where floors and orders together prove it.
    Such a recording carries the flag that says so. Bad recordings take no part.
    """
    sound = {
        path: result
        for path, result in results.items()
        if not any(flag["severity"] == "bad" and "left_out" not in flag for flag in result.flags)
    }
    ratios = settings.level_jump_ratio, settings.gain_step_ratio
    flags = level_jumps(_levels(sound), ratio=ratios[0], proven_ratio=ratios[1])
    kept = dict(results)
    for path, result in sound.items():
        own = [flag for flag in flags if flag["recording"] == result.name]
        if own:
            kept[path] = _without(kept[path], own)
    return kept


def _without(result: RecordingResult, flags: list[QualityFlag]) -> RecordingResult:
    """``result`` without the channels that ``flags`` leave out, and with these flags."""
    names = [flag["channel"] for flag in flags if flag.get("left_out") == "channel"]
    frames = {noun: _emptied(frame, names) for noun, frame in result.frames.items()}
    return RecordingResult(ShaftAngle(with_flags(result.shaft.copy(), flags)), frames)


def _emptied(frame: xr.Dataset, names: list[str]) -> xr.Dataset:
    """``frame`` in which the channels ``names`` look as if nothing had been recorded of them."""
    if "channel" not in frame.dims:
        return frame
    out = np.isin(frame["channel"].values.astype(str), names)
    changed: dict[str, xr.DataArray] = {}
    for name, variable in frame.data_vars.items():
        if "channel" in variable.dims and variable.dtype.kind in "fc":
            values = variable.values.copy()
            np.moveaxis(values, variable.dims.index("channel"), 0)[out] = 0.0 if name in _NOTHING_IS_ZERO else np.nan
            changed[str(name)] = variable.copy(data=values)
    return frame.assign(changed)


def _levels(results: Mapping[Path, RecordingResult]) -> list[RecordedLevel]:
    """Speed and level of every recording whose level was looked at."""
    made: list[RecordedLevel] = []
    places: Floats | None = None
    for result in results.values():
        levels = result.frames.get(RecordingLevels)
        speed = result.shaft["speed"].values
        if levels is not None and np.isfinite(speed).any():
            names = levels["channel"].values.tolist()
            rms, floor = (dict(zip(names, levels[key].values.tolist(), strict=True)) for key in ("rms", "floor"))
            # of the means of tenths: what a shaft does within a turn, and an encoder's edges, is no other speed
            means = [float(np.nanmean(part)) for part in np.array_split(speed, 10) if np.isfinite(part).any()]
            here = levels["block"].values
            places = here if places is None else places
            # the floors of recordings at another rate are those of other frequencies
            alike = np.array_equal(here, places)
            blocks = dict(zip(names, levels["block_floor"].values, strict=True)) if alike else {}
            lines = line_sizes(result.frames.get(OrderFrames), names)
            made.append(RecordedLevel(result.name, (min(means), max(means)), rms, floor, blocks, lines))
    return made


NUMBERS = MethodNumbers("1-ingest-faults.toml", "short_recordings")


def short_recordings(results: Iterable[RecordingResult]) -> list[QualityFlag]:
    """A remark on each of the ``results`` that is shorter than the others, where nearly all of these last equally long.

    The length is that over which the shaft is known, so recordings whose shaft stood still for a while may be named.
    """
    named = [(result.name, result.shaft["time"].values) for result in results]
    lengths = np.array([float(time_s[-1] - time_s[0]) if len(time_s) else 0.0 for _, time_s in named])
    if len(lengths) < NUMBERS.fewest_recordings:
        return []
    usual = float(np.median(lengths))
    alike = np.abs(lengths - usual) <= NUMBERS.alike_share * usual
    if not usual > 0.0 or np.mean(alike) < NUMBERS.alike_recordings:
        return []
    return [
        QualityFlag(
            recording=name,
            flag="shorter_than_others",
            severity="info",
            detail=f"{length:.3g} s, where the other recordings of the test last {usual:.3g} s: if it was not stopped "
            "early its file has lost its end",
        )
        for (name, _), length in zip(named, lengths.tolist(), strict=True)
        if length < (1.0 - NUMBERS.shorter_share) * usual
    ]
