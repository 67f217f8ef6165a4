"""Records of ``findings.json`` that speak of speeds: crossings, speeds to avoid, free and open bands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

from crankorder.identify.found import Crossing, SpeedBand, SpeedVerdicts


def crossing_records(found: Sequence[Crossing]) -> list[dict[str, Any]]:
    """Records of the crossings ``found``."""
    records = [_listed(asdict(replace(item, whirl=None))) | {"excited": item.excited} for item in found]
    return [{key: value for key, value in record.items() if key != "whirl"} for record in records]


def avoided_records(verdicts: SpeedVerdicts) -> list[dict[str, Any]]:
    """Records of the speeds of ``verdicts`` that are to be avoided, the worst first."""
    return [
        {"rank": rank} | _listed(asdict(item)) | {"order": item.orders[0], "mode_hz": item.modes_hz[0]}
        for rank, item in enumerate(verdicts.avoid, start=1)
    ]


def band_records(bands: Sequence[SpeedBand]) -> list[dict[str, Any]]:
    """Records of ``bands`` of speed."""
    return [asdict(item) for item in bands]


def _listed(record: dict[str, Any]) -> dict[str, Any]:
    """``record`` with lists in place of tuples, as JSON has them."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in record.items()}
