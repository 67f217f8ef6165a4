"""The masses that two manifests state differently, and what they tell of the unbalance: influence coefficients."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from typing import Any

import xarray as xr
from pydantic import ValidationError

from crankorder.engine.definition import Engine
from crankorder.engine.transfer_paths import AddedMass
from crankorder.findings import TrialBalance
from crankorder.identify.balance.trial_mass import trial_mass


def masses_between(base: Mapping[str, Any], new: Mapping[str, Any]) -> tuple[AddedMass, ...]:
    """Masses put on between two tests, below 0 where taken off, from what ``run.json`` of ``base`` and ``new`` state.

    A mass that both tests have is no difference. Raises pydantic's ValidationError for a mass that no manifest states.
    """
    stated = [Counter(_masses(run)) for run in (base, new)]
    put_on, taken_off = stated[1] - stated[0], stated[0] - stated[1]
    off = [mass.model_copy(update={"mass_g": -mass.mass_g}) for mass in taken_off.elements()]
    return (*put_on.elements(), *off)


def _masses(run: Mapping[str, Any]) -> list[AddedMass]:
    records = (run.get("manifest") or {}).get("added_masses") or []
    return [AddedMass.model_validate_json(json.dumps(record)) for record in records]


def known_mass(
    base: Mapping[str, Any], new: Mapping[str, Any], base_map: xr.Dataset | None, new_map: xr.Dataset | None
) -> tuple[TrialBalance | None, str]:
    """Residual unbalance before and after a known change of mass, or None and why; "" where no mass was changed.

    ``base`` and ``new`` are what ``run.json`` states, ``base_map`` and ``new_map`` the OrderMaps. No engine is needed
    for masses on the shaft. The record is that of :func:`crankorder.identify.balance.trial_mass.trial_mass`.
    """
    try:
        added = masses_between(base, new)
    except ValidationError as error:
        return None, f"the stated masses cannot be read: {error.errors()[0]['msg']}"
    if not added:
        return None, ""
    if base_map is None or new_map is None:
        return None, "one of the tests has no order map"
    return trial_mass(base_map, new_map, added=added, engine=_engine(base))


def _engine(run: Mapping[str, Any]) -> Engine | None:
    try:
        return Engine.model_validate_json(json.dumps(run["engine"])) if run.get("engine") else None
    except ValidationError:
        return None
