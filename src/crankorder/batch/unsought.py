"""Findings of a test whose recipe asks for none: empty lists that say so, never an all-clear."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from crankorder.identify.said import SCHEMA_VERSION
from crankorder.quantities import QualityFlag, flags_of
from crankorder.settings import Settings

NOT_ASKED_FOR = "not asked for: the recipe wants {results} only"


def unsought_findings(datasets: dict[str, xr.Dataset], *, test: str, settings: Settings) -> dict[str, Any]:
    """Findings (``data_schema/findings.json``) with nothing in them and the reason under ``not_asked_for``.

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
    return {
        "schema_version": SCHEMA_VERSION,
        "test": test,
        "not_asked_for": reason,
        "channels": [dict(zip(("name", "unit", "quantity"), row, strict=True)) for row in zip(*columns, strict=True)],
        "speed_range_rpm": [float(known.min()), float(known.max())] if known.size else [None, None],
        **{table: [] for table in ("orders", "modes", "crossings", "bearings", "lines")},
        "unexplained_energy_fraction": None,
        "balance": None,
        "balance_reason": reason,
        "quality": flags,
    }
