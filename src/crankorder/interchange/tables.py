"""Results as tables with a unit for every column: tracks, modes, crossings, lines and what else was found."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import RequestError

_ENDS = ("low", "high")


@dataclass(frozen=True)
class Column:
    """A column of a table: name, unit ("" for text), what it is in words, and its values (rows,)."""

    name: str
    unit: str
    text: str
    values: NDArray[Any]


def tables_of(groups: Mapping[str, xr.Dataset], *, maps: bool = False) -> dict[str, list[Column]]:
    """Columns by table: ``tracks`` from ``order_tracks``, and each table of the findings by its name.

    ``groups``: results by group as they are published, with real units. A row of a track is an order of a channel at a
    speed where it was measured; with ``maps`` the order map and the Campbell map are tables of that kind too.
    """
    named = {"order_tracks": "tracks"} | ({"order_map": "order_map", "campbell_map": "campbell_map"} if maps else {})
    made = {name: _long(groups[group]) for group, name in named.items() if group in groups}
    for group, dataset in groups.items():
        if group.startswith("findings/") and "record" in dataset.dims:
            made[group.removeprefix("findings/")] = list(_records(dataset))
    return made


def _long(dataset: xr.Dataset) -> list[Column]:
    """Every value of the variables over the dims of the largest, a row for each cell where an amplitude is known."""
    amplitudes = [name for name in map(str, dataset.data_vars) if name.split("_")[0] == "amplitude"]
    like = dataset[amplitudes[0]]
    dims = like.dims
    flat = {
        str(name): xr.broadcast(dataset[name], like)[0].transpose(*dims).values.ravel()
        for name, one in dataset.variables.items()
        if set(one.dims) <= set(dims)
    }
    known = np.any([np.isfinite(flat[name]) for name in amplitudes], axis=0)
    first = [*map(str, dims), *(name for name in ("unit", "quantity", "direction", "track_method") if name in flat)]
    names = [*first, *amplitudes, *(name for name in flat if name not in (*first, *amplitudes))]
    return [_column(name, dataset[name].attrs, flat[name][known]) for name in dict.fromkeys(names)]


def _records(dataset: xr.Dataset) -> Iterator[Column]:
    for key, variable in dataset.variables.items():
        if variable.dims == ("record",):
            yield _column(str(key), variable.attrs, variable.values)
        else:
            for place, end in enumerate(_ENDS):
                yield _column(f"{key}_{end}", variable.attrs, variable.values[:, place])


def _column(name: str, attrs: Mapping[Any, Any], values: NDArray[Any]) -> Column:
    is_text = values.dtype.kind in "OUS"
    return Column(name, "" if is_text else str(attrs.get("units", "")), str(attrs.get("long_name", "")), values)


def csv_bytes(columns: list[Column]) -> bytes:
    """The table of ``columns`` as CSV: a row of names, a row of units, the values; UTF-8, full precision.

    A missing number is an empty cell. A text that a spreadsheet would take for a formula begins with an apostrophe.
    """
    lines = io.StringIO()
    writer = csv.writer(lines, lineterminator="\n")
    writer.writerow([one.name for one in columns])
    writer.writerow([one.unit for one in columns])
    writer.writerows(zip(*([_cell(value) for value in one.values] for one in columns), strict=True))
    return lines.getvalue().encode("utf-8", "backslashreplace")


def _cell(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else str(value)
    text = str(value)
    formula = text[:1] in ("=", "@") or (text[:1] in ("+", "-") and any(sign in text for sign in "(|!"))
    return f"'{text}" if formula and isinstance(value, str) else text


def parquet_bytes(columns: list[Column]) -> bytes:
    """The table of ``columns`` as Parquet; unit and words of each stand in the metadata of its field.

    Raises RequestError where pyarrow is not installed.
    """
    try:
        import pyarrow as arrow
        from pyarrow import parquet
    except ImportError as error:
        remedy = "pip install 'crankorder[parquet]', or --to csv"
        raise RequestError("Parquet is written by pyarrow, which is not installed", remedy=remedy) from error
    fields, arrays = [], []
    for one in columns:
        is_text = one.values.dtype.kind in "OUS"
        array = arrow.array([str(value) for value in one.values] if is_text else one.values)
        arrays.append(array)
        fields.append(arrow.field(one.name, array.type, metadata={"units": one.unit, "long_name": one.text}))
    sink = io.BytesIO()
    parquet.write_table(arrow.table(arrays, schema=arrow.schema(fields)), sink)
    return sink.getvalue()
