"""Findings of a test whose recipe asks for none: empty lists that say so, never an all-clear."""

from __future__ import annotations

import numpy as np
import xarray as xr

from crankorder.findings import Channel, Findings, nothing_sought, quality_of
from crankorder.quantities import QualityFlag, flags_of
from crankorder.settings import Settings

NOT_ASKED_FOR = "not asked for: the recipe wants {results} only"
OF_SHAFT_ALONE = "not sought: no vibration was recorded, the shaft alone"


def unsought_findings(datasets: dict[str, xr.Dataset], *, test: str, settings: Settings) -> Findings:
    """Findings with nothing in them and the reason under ``not_asked_for``.

    ``datasets`` are the results of the ``test`` of that name, ``settings`` say which were asked for.
    """
    flags: list[QualityFlag] = []
    for dataset in datasets.values():
        flags += [flag for flag in flags_of(dataset) if flag not in flags]
    maps = [dataset for dataset in datasets.values() if "channel" in dataset.variables]
    columns = (maps[0][name].values.tolist() if maps else [] for name in ("channel", "unit", "quantity"))
    of_shaft = [datasets["shaft"][name].values for name in ("speed_min", "speed_max")]
    of_maps = [dataset["speed"].values for dataset in maps if "speed" in dataset.variables]
    speeds = np.concatenate(of_maps if maps else of_shaft)
    known = speeds[np.isfinite(speeds)]
    wanted = ", ".join(name.replace("_", " ") for name in settings.report.results)
    reason = NOT_ASKED_FOR.format(results=wanted) if wanted else OF_SHAFT_ALONE
    made = tuple(
        Channel(name=name, unit=unit, quantity=quantity) for name, unit, quantity in zip(*columns, strict=True)
    )
    tested = (float(known.min()), float(known.max())) if known.size else (None, None)
    quality = quality_of(flags)
    return nothing_sought(test, reason=reason, channels=made, speed_range_rpm=tested, quality=quality)
