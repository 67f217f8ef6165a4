"""Findings of a test whose recipe asks for none: empty lists that say so, never an all-clear."""

from __future__ import annotations

import numpy as np
import xarray as xr

from crankorder.findings import Channel, Findings, nothing_sought, quality_of
from crankorder.quantities import QualityFlag, flags_of
from crankorder.settings import Settings

NOT_ASKED_FOR = "not asked for: the recipe wants {results} only"


def unsought_findings(datasets: dict[str, xr.Dataset], *, test: str, settings: Settings) -> Findings:
    """Findings with nothing in them and the reason under ``not_asked_for``.

    ``datasets`` are the results of the ``test`` of that name, ``settings`` say which were asked for.
    """
    flags: list[QualityFlag] = []
    for dataset in datasets.values():
        flags += [flag for flag in flags_of(dataset) if flag not in flags]
    first = next(iter(datasets.values()))
    columns = (first[name].values.tolist() for name in ("channel", "unit", "quantity"))
    speeds = np.concatenate([dataset["speed"].values for dataset in datasets.values() if "speed" in dataset.variables])
    known = speeds[np.isfinite(speeds)]
    reason = NOT_ASKED_FOR.format(results=", ".join(name.replace("_", " ") for name in settings.report.results))
    made = tuple(
        Channel(name=name, unit=unit, quantity=quantity) for name, unit, quantity in zip(*columns, strict=True)
    )
    tested = (float(known.min()), float(known.max())) if known.size else (None, None)
    quality = quality_of(flags)
    return nothing_sought(test, reason=reason, channels=made, speed_range_rpm=tested, quality=quality)
