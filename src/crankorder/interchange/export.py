"""Results in the forms of other programs: tables with a unit for every column, and universal files.

Tables hold tracks, modes, crossings, lines and what else was found; a universal file order cuts against speed and
waterfalls of orders and frequencies, with header and units.
Source: Universal File Datasets 58 (function at nodal DOF), 58b (its binary form), 151 (header) and 164 (units), SDRC
I-DEAS test data, as the University of Cincinnati (SDRL) keeps their description.
"""

from __future__ import annotations

import csv
import io
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.ingest.units import base_unit, known_unit
from crankorder.quantities import Floats


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
    flat = {
        str(name): xr.broadcast(dataset[name], like)[0].transpose(*like.dims).values.ravel()
        for name, one in dataset.variables.items()
        if set(one.dims) <= set(like.dims)
    }
    known = np.any([np.isfinite(flat[name]) for name in amplitudes], axis=0)
    about = ("unit", "quantity", "direction", "track_method")
    names = dict.fromkeys([*map(str, like.dims), *about, *amplitudes, *flat])
    return [_column(name, dataset[name].attrs, flat[name][known]) for name in names if name in flat]


def _records(dataset: xr.Dataset) -> Iterator[Column]:
    for key, variable in dataset.variables.items():
        ends = ("",) if variable.dims == ("record",) else ("_low", "_high")
        for end, values in zip(ends, variable.values.reshape(-1, len(ends)).T, strict=True):
            yield _column(f"{key}{end}", variable.attrs, values)


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
        arrays.append(arrow.array(list(map(str, one.values)) if is_text else one.values))
        fields.append(arrow.field(one.name, arrays[-1].type, metadata={"units": one.unit, "long_name": one.text}))
    sink = io.BytesIO()
    parquet.write_table(arrow.table(arrays, schema=arrow.schema(fields)), sink)
    return sink.getvalue()


SPECTRUM, ORDER_CUT = 12, 27
"""Function types of record 6: "Spectrum" and "Order Function"."""

_FREQUENCY, _RPM, _ORDER, _GENERAL = 18, 19, 20, 1
"""Specific data types of axes in records 8 to 11."""

_BY_QUANTITY = {
    "acceleration": (12, (1, 0, 0)),
    "velocity": (11, (1, 0, 0)),
    "displacement": (8, (1, 0, 0)),
    "force": (13, (0, 1, 0)),
    "pressure": (15, (-2, 1, 0)),
    "torque": (_GENERAL, (1, 1, 0)),
}
"""Specific data type of an ordinate by what its unit measures, and the exponents of length, force and temperature."""

_DIRECTIONS = {"+X": 1, "-X": -1, "+Y": 2, "-Y": -2, "+Z": 3, "-Z": -3}
_MARKS = {"tdc": "top dead centre", "index": "the index mark", "pulse": "an encoder pulse"}
_HEADER_LINES = 11
_MOST_DIGITS_LOST = 1e-9
"""Share of its last value by which an axis may differ from one of even steps in the six digits of record 7."""


@dataclass(frozen=True)
class _Axis:
    """Labels of an axis: the specific data type, exponents of its unit, name and unit."""

    kind: int
    exponents: tuple[int, int, int]
    label: str
    unit: str


_SPEED = _Axis(_RPM, (0, 0, 0), "Speed", "rpm")
_NO_AXIS = _Axis(0, (0, 0, 0), "NONE", "NONE")
_ABSCISSAE = {
    "order": _Axis(_ORDER, (0, 0, 0), "Order", "1/rev"),
    "frequency": _Axis(_FREQUENCY, (0, 0, 0), "Frequency", "Hz"),
}


@dataclass(frozen=True)
class _Channel:
    """A channel: its number from 1, how a universal file names it, and the factor to the units of dataset 164."""

    node: int
    name: str
    direction: int
    ordinate: _Axis
    factor: float
    remark: str


@dataclass(frozen=True)
class _Function:
    """A function of a ``channel`` to be written: ``x`` and ``y`` with what records 1 to 11 say of them."""

    kind: int
    ids: tuple[str, ...]
    channel: _Channel
    abscissa: _Axis
    z_axis: _Axis
    z: float
    x: Floats
    y: NDArray[Any]


def uff58_bytes(groups: Mapping[str, xr.Dataset], *, test: str, binary: bool = False) -> bytes:
    """A universal file of the results of a ``test``: datasets 151 and 164, then 58, or 58b where ``binary``.

    Of ``groups``, by name: each order of ``order_tracks`` against speed (function type 27; complex where its phase is
    known at every speed), each speed of ``order_map`` and of ``campbell_map`` (function type 12, the speed on the
    Z axis). Amplitudes are as the results scale them, in SI units as dataset 164 states; what was not measured is left
    out. 58 has 12 digits, 58b 32-bit numbers, as the results have; both have six digits of uneven axes.
    """
    made = [_header(test), _UNITS]
    for name, functions in (("order_tracks", _cuts), ("order_map", _waterfall), ("campbell_map", _waterfall)):
        if name in groups:
            made += [_dataset(one, binary) for one in functions(groups[name], test)]
    return b"".join(made)


def _cuts(tracks: xr.Dataset, test: str) -> Iterator[_Function]:
    """Amplitude, and phase where it is known, of each order and channel against speed."""
    speed = tracks["speed"].values
    mark = _MARKS.get(str(tracks.attrs.get("phase_reference")), "")
    for channel in _channels(tracks):
        rows = tracks.isel(channel=channel.node - 1)
        for number, order in enumerate(rows["order"].values):
            one = rows.isel(order=number)
            amplitude = channel.factor * one["amplitude"].values.astype(np.float64)
            phase = np.radians(one["phase"].values.astype(np.float64))
            known = np.isfinite(amplitude) & np.isfinite(speed)
            if not known.any():
                continue
            located = bool(mark) and bool(np.isfinite(phase[known]).all())
            law = f"A cos(2 pi order angle + phase), angle from {mark}" if located else "phase not known at every speed"
            words = f"{channel.name}: order {order:.6g}, {_scaling(tracks)} amplitude"
            ids = (words, test, "NONE", law, channel.remark)
            y = amplitude[known] * np.exp(1j * phase[known]) if located else amplitude[known]
            yield _Function(ORDER_CUT, ids, channel, _SPEED, _ABSCISSAE["order"], float(order), speed[known], y)


def _waterfall(given: xr.Dataset, test: str) -> Iterator[_Function]:
    """Amplitude of each channel and speed against order or frequency."""
    along = "order" if "order" in given.dims else "frequency"
    place = given[along].values
    for channel in _channels(given):
        rows = given["amplitude"].isel(channel=channel.node - 1).transpose("speed", along).values
        for row, speed in zip(channel.factor * rows.astype(np.float64), given["speed"].values, strict=True):
            known = np.isfinite(row)
            if not known.any():
                continue
            at = f"{speed:.8g} rpm" if np.isfinite(speed) else "speed not known"
            words = f"{channel.name}: {along} spectrum, {_scaling(given)} amplitude"
            ids = (words, test, "NONE", at, channel.remark)
            z_axis, z = (_SPEED, float(speed)) if np.isfinite(speed) else (_NO_AXIS, 0.0)
            yield _Function(SPECTRUM, ids, channel, _ABSCISSAE[along], z_axis, z, place[known], row[known])


def _scaling(dataset: xr.Dataset) -> str:
    return "RMS" if str(dataset.attrs.get("amplitude_scaling", "peak")).casefold() == "rms" else "peak"


def _channels(dataset: xr.Dataset) -> Iterator[_Channel]:
    size = dataset.sizes["channel"]
    directions = dataset["direction"].values if "direction" in dataset.variables else [""] * size
    names, units = dataset["channel"].values.astype(str), dataset["unit"].values.astype(str)
    for number, (name, text, direction) in enumerate(zip(names, units, directions, strict=True), start=1):
        unit = known_unit(text)
        kind, exponents = _BY_QUANTITY.get(unit.quantity if unit else "", (_GENERAL, (0, 0, 0)))
        shown, factor = (base_unit(unit).name, unit.factor) if unit and any(exponents) else (text, 1.0)
        remark = f"{factor:.10g} x the values of the results, which are in {text}" if factor != 1.0 else "NONE"
        ordinate = _Axis(kind, exponents, "Amplitude", shown)
        yield _Channel(number, name, _DIRECTIONS.get(str(direction).upper(), 0), ordinate, factor, remark)


def _text(words: str, width: int) -> str:
    """``words`` as a field of ``width``: ASCII, for universal files know no other."""
    named = words.replace("µ", "u").replace("·", ".").replace("–", "-")
    plain = unicodedata.normalize("NFKD", named).encode("ascii", "ignore").decode()
    printed = "".join(sign if sign.isprintable() else " " for sign in plain).strip() or "NONE"
    return printed[:width].ljust(width)


def _header(test: str) -> bytes:
    """Dataset 151: what the file is of and who wrote it; no dates, for the same results make the same bytes."""
    program = _text(f"crankorder {version('crankorder')}", 80)
    lines = [_text(test, 80), _text("orders and spectra against speed", 80), program, f"{'':20}{0:10d}{0:10d}{0:10d}"]
    return _block(f"{151:6d}".ljust(80), [*lines, " " * 20, program, " " * 20])


def _block(first: str, lines: list[str]) -> bytes:
    return "".join(f"{line}\n" for line in (f"{-1:6d}", first, *lines, f"{-1:6d}")).encode("ascii")


def _fortran(value: float) -> str:
    return f"{value:25.16E}".replace("E", "D")


_UNITS = _block(
    f"{164:6d}".ljust(80),
    [f"{1:10d}{'SI: metre (newton)':20}{2:10d}", _fortran(1) + _fortran(1) + _fortran(1), _fortran(273.15)],
)
"""Dataset 164: SI, metre and newton; temperatures as differences."""


def _dataset(one: _Function, binary: bool) -> bytes:
    channel, (even, least, step) = one.channel, _even_axis(one.x)
    is_complex = np.iscomplexobj(one.y)
    kind = (5 if binary else 6) if is_complex else (2 if binary else 4)
    parts = [*([] if even else [one.x]), *([one.y.real, one.y.imag] if is_complex else [one.y])]
    values = np.stack(parts, axis=-1).ravel()
    records = [
        *(_text(text, 80) for text in one.ids),
        f"{one.kind:5d}{0:10d}{1:5d}{0:10d} {_text(channel.name, 10)}{channel.node:10d}{channel.direction:4d} "
        f"{'NONE':10}{0:10d}{0:4d}",
        f"{kind:10d}{len(one.x):10d}{int(even):10d}{least:13.5E}{step:13.5E}{one.z:13.5E}",
        *map(_axis_record, (one.abscissa, channel.ordinate, _NO_AXIS, one.z_axis)),
    ]
    if not binary:
        return _block(f"{58:6d}".ljust(80), [*records, *_numbers(values, parts, even)])
    data = values.astype("<f4").tobytes()
    first = f"{58:6d}b{1:6d}{2:6d}{_HEADER_LINES:12d}{len(data):12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    head = "".join(f"{line}\n" for line in (f"{-1:6d}", first, *records))
    return head.encode("ascii") + data + f"{-1:6d}\n".encode("ascii")


def _axis_record(axis: _Axis) -> str:
    length, force, temperature = axis.exponents
    return f"{axis.kind:10d}{length:5d}{force:5d}{temperature:5d} {_text(axis.label, 20)} {_text(axis.unit, 20)}"


def _numbers(values: Floats, parts: list[NDArray[Any]], even: bool) -> Iterator[str]:
    """Lines of ``values`` in the columns of record 12: E13.5 for an uneven abscissa, E20.12 for the rest."""
    in_line = 4 if even or len(parts) == 2 else 3
    of_part = ["{:13.5E}".format] * (not even) + ["{:20.12E}".format] * (len(parts) - (not even))
    for first in range(0, len(values), in_line):
        line = values[first : first + in_line]
        yield "".join(of_part[(first + place) % len(parts)](value) for place, value in enumerate(line))


def _even_axis(x: Floats) -> tuple[bool, float, float]:
    """Whether ``x`` has even steps that six digits tell, with its first value and step."""
    if len(x) < 2:
        return False, 0.0, 0.0
    least, step = (float(f"{value:.5E}") for value in (x[0], (x[-1] - x[0]) / (len(x) - 1)))
    off = np.abs(least + step * np.arange(len(x)) - x).max()
    even = bool(step > 0.0 and off <= _MOST_DIGITS_LOST * np.abs(x).max())
    return (True, least, step) if even else (False, 0.0, 0.0)
