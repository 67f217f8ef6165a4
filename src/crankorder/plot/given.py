"""What a picture is given: the right dataset, a channel of it, findings; else a RequestError with what is there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from crankorder.channel_units import by_channel, unit_text
from crankorder.errors import RequestError, SchemaError
from crankorder.findings import Findings
from crankorder.quantities import Floats, check_dataset

_NOUNS = {
    "recording": "a Recording",
    "shaft_angle": "a ShaftAngle, as crankorder.crank_angle makes it",
    "order_map": "an OrderMap, as crankorder.order_map makes it",
    "campbell_map": "a CampbellMap, as crankorder.campbell_map makes it",
    "order_tracks": "OrderTracks, as crankorder.order_tracks makes them",
    "envelope_map": "an EnvelopeMap, as crankorder.envelope makes it",
}
_TREE: Any = getattr(xr, "DataTree", ())  # older xarray has none


def dataset_of(given: object, noun: str, picture: str) -> xr.Dataset:
    """``given`` as a dataset of the ``noun`` that the ``picture`` shows; a branch of a results tree is one.

    Raises RequestError naming what was given and what is wanted.
    """
    dataset = given.to_dataset() if isinstance(given, _TREE) else given
    wanted, place = _NOUNS[noun], f"crankorder.plot.{picture}"
    if isinstance(dataset, xr.Dataset):
        dataset = by_channel(dataset)
    else:
        raise RequestError("this is no dataset", file=place, found=type(given).__name__, allowed=wanted)
    try:
        check_dataset(dataset, noun)
    except SchemaError as error:
        known = next((text for other, text in _NOUNS.items() if other != noun and _is(dataset, other)), "")
        found = known.partition(",")[0] or f"a dataset with {', '.join(map(str, dataset.variables)) or 'nothing in it'}"
        problem = f"not what this picture shows ({error.place}: {error.problem})"
        raise RequestError(problem, file=place, found=found, allowed=wanted) from error
    return dataset


def _is(dataset: xr.Dataset, noun: str) -> bool:
    try:
        check_dataset(dataset, noun)
    except SchemaError:
        return False
    return True


def channel_number(dataset: xr.Dataset, channel: str | None, picture: str) -> int:
    """Place of ``channel`` in ``dataset``, or of the first where it is None; ``picture`` stands in the error.

    Raises RequestError with the channels that are there.
    """
    names = [str(name) for name in dataset["channel"].values]
    if channel is None and names:
        return 0
    if channel is None or str(channel) not in names:
        there = ", ".join(names) or "none"
        raise RequestError("no such channel", file=f"crankorder.plot.{picture}", found=channel or "", allowed=there)
    return names.index(str(channel))


def findings_of(findings: object, picture: str) -> Mapping[str, Any]:
    """``findings`` as crankorder.diagnose returns them, empty for None; ``picture`` stands in the RequestError."""
    if findings is None:
        return {}
    if isinstance(findings, Findings):
        return findings.as_dict()
    if not isinstance(findings, Mapping) or isinstance(findings, xr.Dataset | _TREE):
        wanted = "findings, as crankorder.diagnose returns it, or a dict, as findings.json holds it"
        found = type(findings).__name__
        raise RequestError("these are no findings", file=f"crankorder.plot.{picture}", found=found, allowed=wanted)
    return findings


def number_of(value: object, key: str, picture: str, *, above: float) -> float:
    """``value`` of the argument ``key`` of a ``picture``, a finite number > ``above``; else RequestError."""
    if not isinstance(value, int | float | np.number) or not np.isfinite(value) or not value > above:
        place, allowed = f"crankorder.plot.{picture}", f"a number > {above:g}"
        raise RequestError("not a number that can be", file=place, place=key, found=value, allowed=allowed)
    return float(value)


def values_of(dataset: xr.Dataset, name: str, *dims: str, channel: int) -> Floats:
    """Values of variable ``name`` of ``dataset`` of one ``channel`` (its number), in the order of ``dims``."""
    return np.asarray(dataset[name].isel(channel=channel).transpose(*dims).values, dtype=np.float64)


def unit_of(dataset: xr.Dataset, channel: int) -> str:
    """Typographic unit of a ``channel`` (its number) of ``dataset``: "m/s²" for "m/s2"."""
    return unit_text(str(dataset["unit"].values[channel]))


def quantity_text(dataset: xr.Dataset, channel: int) -> str:
    """What a ``channel`` (its number) of ``dataset``, a map or tracks, shows: "Acceleration (peak)"."""
    quantity = str(dataset["quantity"].values[channel]).replace("_", " ").strip()
    scaling = "RMS" if str(dataset.attrs.get("amplitude_scaling", "peak")).casefold() == "rms" else "peak"
    known = quantity and quantity not in ("1", "unknown", "none")
    return f"{quantity[:1].upper()}{quantity[1:]} ({scaling})" if known else f"Amplitude ({scaling})"
