"""Recordings that are shorter than all others of their test: files that lost their end may say nothing else of it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from crankorder.quantities import QualityFlag
from crankorder.settings import MethodNumbers
from crankorder.stages import RecordingResult

NUMBERS = MethodNumbers("1-ingest-faults.toml", "short_recordings")


def short_recordings(results: Iterable[RecordingResult]) -> list[QualityFlag]:
    """A remark on each of the ``results`` that is shorter than the others, where nearly all of these last equally long.

    The length is that over which the shaft is known, so recordings whose shaft stood still for a while may be named.
    """
    named = [(one.name, one.shaft["time"].values) for one in results]
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
