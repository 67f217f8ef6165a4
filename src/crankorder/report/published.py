"""Datasets as they leave the program: real units, intervals linked to what they are of, conventions said in words."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.channel_units import PART_OF, with_real_units
from crankorder.findings import Findings
from crankorder.records import Column, Record

CONVENTIONS = "CF-1.11, ACDD-1.3"

_FILE = "xarray.open_datatree(path, engine='h5netcdf') reads all groups at once"
_KEYWORDS = "order tracking, order analysis, Campbell diagram, rotating machinery, vibration"

_MARKS = {
    "tdc": "top dead centre",
    "index": "the index mark",
    "pulse": "a pulse of the encoder",
    "count": "where the count of the encoder was 0",
    "mixed": "a place that differs between recordings",
}
"""The zero of the crank angle by ``phase_reference``."""

_UNITS_BY_END = {
    "_hz": "Hz", "_rpm": "min-1", "_deg": "degree", "_g": "g", "_gmm": "g mm", "_s": "s", "_mm": "mm",
    "_percent": "percent",
}  # fmt: skip
_UNITS_BY_NAME = {
    "speed_rpm_at_max": "min-1", "speed_rpm_at_held": "min-1", "rpm": "min-1", "rpm_range": "min-1",
    "frequency_hz_above": "Hz", "band_hz_there": "Hz", "speed_rpm_above": "min-1",
    **dict.fromkeys(("amplitude", "amplitude_held"), "see unit"),
    **dict.fromkeys(
        ("order", "order_expected", "damping_ratio", "unexplained_energy_fraction", "speed_exponent", "amplification",
         "amplification_predicted", "half_order", "n_speeds", "chance", "harmonics", "sidebands", "shaft_order", "cost",
         "rank", "speed_slope"),
        "1",
    ),
}  # fmt: skip
_IN_ATTRIBUTES = ("levels", "speed_swing")
"""Tables of the findings that stand as text in the attributes of their group."""


def published(dataset: xr.Dataset) -> xr.Dataset:
    """``dataset`` as it stands in a file or a tree that a user opens.

    Its units are real (:func:`crankorder.channel_units.with_real_units`), each estimate names its intervals and errors
    in ``ancillary_variables``, amplitudes say how they are scaled, phases from where they count. Its quality flags are
    left out: they are the table ``findings/quality``.
    """
    made = with_real_units(dataset)
    made = made.copy(deep=False) if made is dataset else made
    made.attrs = {key: value for key, value in dataset.attrs.items() if key != "quality"}
    for name in map(str, made.data_vars):
        base = str(made[name].attrs.get(PART_OF, name))
        about = {**_linked(made, name, base), **_conventions(base, dataset)}
        if about:
            made[name].attrs = {**made[name].attrs, **about}
    return made


def _linked(made: xr.Dataset, name: str, base: str) -> dict[str, str]:
    """``ancillary_variables`` of the variable ``name``, the whole or a part of ``base``: those that bound its error."""
    end = name.removeprefix(base)
    of_error = next((key for key in ("coherent_amplitude", "amplitude", "mean") if key + end in made), "")
    bounds = [f"{base}_ci95", f"{base}_low", f"{base}_high"]
    bounds += ["standard_error", "degrees_of_freedom"] if base == of_error else []
    there = [key + end if key + end in made else key for key in bounds if key + end in made or key in made]
    return {"ancillary_variables": " ".join(there)} if there else {}


def _conventions(base: str, dataset: xr.Dataset) -> dict[str, str]:
    if base == "phase" and "phase_reference" in dataset.attrs:
        reference = str(dataset.attrs["phase_reference"])
        place = _MARKS.get(reference, "no known place")
        law = "a line is amplitude * cos(2 pi order crank_angle + phase)"
        return {"phase_reference": reference, "phase_convention": f"{law}, crank_angle in revolutions from {place}"}
    if base.removesuffix("_low").removesuffix("_high") in ("amplitude", "coherent_amplitude"):
        return {key: str(dataset.attrs[key]) for key in ("amplitude_scaling", "window") if key in dataset.attrs}
    return {}


def root_attrs(findings: Findings, groups: Mapping[str, xr.Dataset]) -> dict[str, str]:
    """Attributes of a whole file of results, as CF and ACDD name them, for ``findings`` and what is in ``groups``."""
    low, high = findings.speed_range_rpm
    names = ", ".join(f"{one.name} [{one.unit}]" for one in findings.channels)
    at = f" at {low:.6g} to {high:.6g} rpm" if low is not None and high is not None else ""
    program = f"crankorder {version('crankorder')}"
    lines = [line for dataset in groups.values() for line in str(dataset.attrs.get("history", "")).splitlines()]
    return {
        "title": findings.test,
        "summary": f"Test {findings.test!r}{at}; channels {names or 'none'}; "
        f"groups {', '.join(sorted(groups)) or 'none'} and findings. {_FILE}.",
        "source": program,
        "keywords": _KEYWORDS,
        "history": "\n".join(dict.fromkeys([f"results of {program}", *lines])),
    }


def findings_datasets(findings: Findings) -> dict[str, xr.Dataset]:
    """Small tables for the groups ``findings/orders``, ``findings/modes`` … from the records of ``findings``.

    Every key is a column over ``record``; an interval is a column over (record, bound) with the low end first; a
    missing number is NaN. Where records hold amplitudes, ``unit`` and ``quantity`` are columns too. Single numbers and
    texts become attributes of the group ``findings``, the balance ones of ``findings/balance``.
    """
    kinds = {name: kind for name, kind in Findings.tables().items() if name not in _IN_ATTRIBUTES}
    single = {key: value for key, value in findings.as_dict().items() if key not in (*kinds, "balance")}
    tables = {"findings": xr.Dataset(attrs=single)}
    channels = {one.name: (one.unit, one.quantity or "") for one in findings.channels}
    for table, kind in kinds.items():
        records = getattr(findings, table) or ()
        if records:
            tables[f"findings/{table}"] = _table(records, kind, channels)
    if findings.balance is not None:
        tables["findings/balance"] = xr.Dataset(attrs=findings.balance.as_dict())
    return tables


def _table(records: tuple[Record, ...], kind: type[Record], channels: Mapping[str, tuple[str, str]]) -> xr.Dataset:
    rows = [one.as_dict() for one in records]
    keys = dict.fromkeys(key for row in rows for key in row)
    known = kind.columns()
    made = {key: _column(known[key], [row.get(key) for row in rows]) for key in keys}
    if any(about.get("units") == "see unit" for _, _, about in made.values()):
        of_channel = [channels.get(str(row.get("channel")), (row.get("unit") or "", "")) for row in rows]
        for place, (key, text) in enumerate({"unit": "unit of the channel", "quantity": "what it measures"}.items()):
            values = np.array([one[place] for one in of_channel], dtype=object)
            made[key] = (("record",), values, {"long_name": text})
    return xr.Dataset(made)


def _column(column: Column, values: list[Any]) -> tuple[tuple[str, ...], NDArray[Any], dict[str, str]]:
    name = column.key.removesuffix("_ci95")
    units = _UNITS_BY_NAME.get(name) or next((unit for end, unit in _UNITS_BY_END.items() if name.endswith(end)), "")
    about = {"long_name": column.text} | ({"units": units} if units else {})
    if column.kind == "bool":
        return ("record",), np.array([-1 if value is None else int(value) for value in values], dtype=np.int8), about
    if column.kind == "number":
        return ("record",), np.array([np.nan if value is None else value for value in values], dtype=np.float64), about
    if column.kind == "interval":
        pairs = [[np.nan if end is None else end for end in (value or (None, None))] for value in values]
        return ("record", "bound"), np.array(pairs, dtype=np.float64), about
    texts = [
        "" if value is None else value if isinstance(value, str) else ", ".join(map(str, value)) for value in values
    ]
    return ("record",), np.array(texts, dtype=object), {"long_name": column.text}
