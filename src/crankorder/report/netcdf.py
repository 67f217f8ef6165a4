"""Results as one NetCDF-4 file: the same bytes for the same input, checksummed, a group per noun.

Source: NetCDF-4 file format specification (Unidata), "Creating NetCDF-4 files with HDF5". Calls of the HDF5 library are
made directly: the convenient ones of h5netcdf cost ten times as much for a file of a hundred small variables.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr
from h5py import h5a, h5d, h5ds, h5p, h5s, h5t
from numpy.typing import NDArray

from crankorder.channel_units import PART_OF, by_channel, with_real_units
from crankorder.errors import InputError, UnsafeInputError, printable
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

# level 4: 1.1 % smaller at the same time for a campaign (0.155 s either way), slower on wide bands
COMPRESSION_LEVEL = 1
# axes keep 64 bits; estimates carry less than 24
_DOUBLE = ("speed", "order", "frequency", "time", "crank_angle", "cycle_angle")
_MAX_BYTES = 2_000_000_000  # of all variables of a results file that is read back


def results_bytes(groups: Mapping[str, xr.Dataset], *, attrs: Mapping[str, Any]) -> bytes:
    """Bytes of a NetCDF-4 file with one group per dataset; publish them whole.

    ``groups`` datasets by group name such as ``"order_map"`` or ``"findings/orders"``, stored as
    :func:`crankorder.report.netcdf.published` has them; complex variables become two with ``_real`` and ``_imag``,
    estimates 32-bit floats, everything numeric gzip + shuffle + fletcher32. ``attrs`` of the file: text and numbers
    stay, None is left out, anything else becomes JSON. No time of writing is stored.
    """
    file = netcdf4_file()
    write_attrs(file.id, {"Conventions": CONVENTIONS, **_plain(attrs)})
    number = count()
    for name in sorted(groups):
        _write_group(file.require_group(name), published(groups[name]), number)
    return file_image(file)


def as_stored(groups: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """``groups`` with every value as :func:`results_bytes` keeps it, so that a picture redrawn later is the same."""
    return {name: dataset.map(_as_stored, keep_attrs=True) for name, dataset in groups.items()}


def _as_stored(values: xr.DataArray) -> xr.DataArray:
    if values.dtype.kind != "f":
        return values
    return values.copy(data=_narrow(str(values.name), values.values))


def plain_attrs(dataset: xr.Dataset) -> xr.Dataset:
    """``dataset`` with attributes that any NetCDF writer takes: numbers, arrays of numbers and text."""
    made = dataset.copy(deep=False)
    made.attrs = _plain(dataset.attrs)
    return made


def _write_group(group: h5py.Group, dataset: xr.Dataset, number: Iterator[int]) -> None:
    """Write ``dataset`` into ``group``; ``number`` counts the dimensions of the file."""
    write_attrs(group.id, _plain(dataset.attrs))
    outer = " ".join(sorted(str(coord) for coord in dataset.coords if coord not in dataset.sizes))
    variables: dict[str, Variable] = {}
    for name in sorted(str(name) for name in dataset.variables):
        variable = dataset.variables[name]
        about = _plain(variable.attrs)
        if outer and name in dataset.data_vars:
            about["coordinates"] = outer
        dims = tuple(str(dim) for dim in variable.dims)
        for suffix, values in _stored(name, np.asarray(variable.values)):
            packed = values.ndim > 0 and values.size > 0 and values.dtype.kind in "iuf"
            variables[name + suffix] = Variable(dims, values, about, _chunks(values) if packed else None)
    write_variables(group, {str(name): size for name, size in dataset.sizes.items()}, variables, number)


def _stored(name: str, values: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Name suffix and array of each variable that a variable becomes in the file."""
    if values.dtype.kind == "c":
        yield from (("_real", _narrow(name, values.real)), ("_imag", _narrow(name, values.imag)))
    elif values.dtype.kind == "b":
        yield "", values.astype(np.int8)
    elif values.dtype.kind in "OUS":
        yield "", np.array([printable(text, 10**6) for text in values.ravel()], dtype=object).reshape(values.shape)
    else:
        yield "", _narrow(name, values)


def _narrow(name: str, values: NDArray[Any]) -> NDArray[Any]:
    if values.dtype != np.float64 or name in _DOUBLE or values.ndim < 2 or name.endswith("_ci95"):
        return np.ascontiguousarray(values)
    with np.errstate(over="ignore"):
        narrow = np.ascontiguousarray(values, dtype=np.float32)
    size = np.abs(narrow)
    lost = ((size < np.finfo(np.float32).tiny) & (values != 0)) | (np.isinf(size) & np.isfinite(values))
    return np.ascontiguousarray(values) if lost.any() else narrow  # 1e-300 and 1e300 keep their 64 bits


def _chunks(values: NDArray[Any]) -> tuple[int, ...]:
    """One chunk per channel (first of three dims), else the whole variable, split where it passes 4 MB."""
    shape = list(values.shape)
    if values.ndim >= 3:
        shape[0] = 1
    for dim in range(len(shape)):
        rest = int(np.prod(shape[dim + 1 :])) * values.itemsize
        shape[dim] = max(1, min(shape[dim], 4_000_000 // max(rest, 1)))
    return tuple(shape)


def _plain(attrs: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes as numbers, arrays of numbers and text, whatever they were; None is left out."""
    plain: dict[str, Any] = {}
    for name, value in attrs.items():
        if value is None:
            continue
        if isinstance(value, bool | np.bool_):
            value = int(value)
        elif isinstance(value, np.ndarray | list | tuple) and len(value) and np.asarray(value).dtype.kind in "if":
            value = np.asarray(value)
        elif isinstance(value, str):
            value = "\n".join(printable(line, 10**6) for line in value.split("\n"))
        elif not isinstance(value, int | float | np.integer | np.floating):
            value = json.dumps(value, ensure_ascii=False, sort_keys=True, default=str)
        plain[printable(name).replace("/", "_")] = value
    return plain


def read_results(path: Path) -> dict[str, xr.Dataset]:
    """Datasets of a results file by group name, loaded, with one variable for all channels, as the program has them.

    ``_real``/``_imag`` pairs are complex again, and parts by quantity one variable
    (:func:`crankorder.channel_units.by_channel`).

    ``path`` of a file that :func:`results_bytes` made. Raises InputError where it cannot be read or is no results file,
    UnsafeInputError where it reaches outside itself or claims more than 2 GB.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise UnsafeInputError("is too large for a results file", file=path, found=f"{path.stat().st_size} bytes")
        image = BytesIO(path.read_bytes())  # what is checked is what is read
        with h5py.File(image, "r") as file:
            conventions = str(file.attrs.get("Conventions", ""))
            names = _safe_groups(file, path)
            groups = {name: _read_group(file[name]) for name in names} if conventions.startswith("CF-") else {}
        if not conventions.startswith("CF-"):
            place = "attribute Conventions"
            raise InputError("not a results file of crankorder", file=path, place=place, found=conventions)
        return groups
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        remedy = "Run the analysis again, or give the results.nc that it wrote"
        raise InputError("cannot be read as NetCDF-4", file=path, found=error, remedy=remedy) from None


def _read_group(group: h5py.Group) -> xr.Dataset:
    stored = {name: item for name, item in group.items() if isinstance(item, h5py.Dataset)}
    coords = {name for name, item in stored.items() if item.is_scale}
    variables = {}
    for name, item in stored.items():
        if item.is_scale and bytes(item.attrs.get("NAME", b"")).startswith(BARE_DIMENSION):
            continue
        values, attrs = np.asarray(item[...]), read_attrs(item)
        coords |= set(str(attrs.pop("coordinates", "")).split())
        values = _text(values) if values.dtype.kind == "O" else values
        variables[name] = (dims_of(item), values, attrs)
    pairs = [name[:-5] for name in variables if name.endswith("_real") and f"{name[:-5]}_imag" in variables]
    for name in pairs:
        (dims, real, attrs), (_, imaginary, _) = variables.pop(f"{name}_real"), variables.pop(f"{name}_imag")
        variables[name] = (dims, real + 1j * imaginary, attrs)
    return by_channel(xr.Dataset(variables, attrs=read_attrs(group)).set_coords(sorted(coords & set(variables))))


def _text(values: NDArray[Any]) -> NDArray[Any]:
    """Array of text from one of text or UTF-8 bytes."""
    decoded = [item.decode("utf-8") if isinstance(item, bytes) else str(item) for item in values.ravel()]
    return np.array(decoded, dtype=str).reshape(values.shape)


def _safe_groups(file: h5py.File, path: Path) -> list[str]:
    """Names of all groups but the root, after a look at every object for links out of the file and false sizes."""
    names: list[str] = []
    waiting, total = [""], 0
    while waiting:
        at = waiting.pop()
        if at.count("/") > 3 or len(names) > 1000:
            raise UnsafeInputError("more groups than a results file has", file=path, place=at)
        group = file[at or "/"]
        for key in group:
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                raise UnsafeInputError("holds a link", file=path, place=f"{at}/{key}", remedy="Results hold data only")
            item = group[key]
            name = f"{at}/{key}".lstrip("/")
            if isinstance(item, h5py.Group):
                names.append(name)
                waiting.append(name)
                continue
            total += int(item.nbytes) if isinstance(item, h5py.Dataset) else 0
            if isinstance(item, h5py.Dataset) and (item.external or item.is_virtual or total > _MAX_BYTES):
                raise UnsafeInputError("stores data elsewhere or claims too much", file=path, place=name, found=total)
    return sorted(names)


BARE_DIMENSION = b"This is a netCDF dimension but not a netCDF variable."
"""Begins the name of a dimension that has no values."""

_OF_THE_LAYOUT = frozenset(
    {"CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "_Netcdf4Dimid", "_Netcdf4Coordinates", "_NCProperties"}
)


@dataclass(frozen=True)
class Variable:
    """A variable to be written: numbers or text ``values`` on ``dims``, with ``attrs``; gzip by ``chunks`` if any."""

    dims: tuple[str, ...]
    values: NDArray[Any]
    attrs: Mapping[str, Any]
    chunks: tuple[int, ...] | None


def netcdf4_file() -> h5py.File:
    """New file in memory, readable by every HDF5 since 1.10, whose metadata carry checksums."""
    file = h5py.File(
        "results",
        "w",
        driver="core",
        backing_store=False,
        block_size=1 << 20,
        track_order=False,
        libver=("v110", "v110"),
    )
    properties = f"version=2,h5py={h5py.__version__},hdf5={h5py.version.hdf5_version}"
    _attribute(file.id, "_NCProperties", np.bytes_(properties.encode()))
    return file


def file_image(file: h5py.File) -> bytes:
    """Bytes of ``file``, which is closed."""
    file.flush()
    image = bytes(file.id.get_file_image())
    file.close()
    return image


def write_attrs(owner: Any, attrs: Mapping[str, Any]) -> None:
    """Write ``attrs`` (text, numbers, arrays of numbers) to ``owner``, the identifier of a file, group or dataset."""
    for name in sorted(attrs):
        value = attrs[name]
        _attribute(owner, name, value if isinstance(value, str) else np.atleast_1d(np.asarray(value)))


def write_variables(
    group: h5py.Group, sizes: Mapping[str, int], variables: Mapping[str, Variable], number: Iterator[int]
) -> None:
    """Write ``variables`` by name into ``group`` on the dimensions of ``sizes``; ``number`` counts all of them."""
    ids = {name: next(number) for name in sorted(sizes)}
    written = {}
    for name in sorted({*variables, *sizes}):
        if name in variables:
            written[name] = _dataset(group, name, variables[name])
            label = name
        else:  # no values are stored
            space = h5s.create_simple((sizes[name],))
            written[name] = h5d.create(group.id, name.encode(), h5t.IEEE_F32BE, space, _creation())
            label = f"{BARE_DIMENSION.decode()}{sizes[name]:10d}"
        if name in sizes:
            h5ds.set_scale(written[name], label.encode())
            _attribute(written[name], "_Netcdf4Dimid", np.int32(ids[name]))
    for name, variable in variables.items():
        if name not in sizes:
            for axis, dim in enumerate(variable.dims):
                h5ds.attach_scale(written[name], written[dim], axis)
        if variable.dims:
            dims = np.array([ids[dim] for dim in variable.dims], dtype=np.int32)
            _attribute(written[name], "_Netcdf4Coordinates", dims)
        write_attrs(written[name], variable.attrs)


def _dataset(group: h5py.Group, name: str, variable: Variable) -> Any:
    values = variable.values
    text = values.dtype.kind == "O"
    properties = _creation()
    if variable.chunks:
        properties.set_chunk(variable.chunks)
        properties.set_shuffle()
        properties.set_deflate(COMPRESSION_LEVEL)
        properties.set_fletcher32()
    kind = _text_type() if text else h5t.py_create(values.dtype, logical=True)
    space = h5s.create_simple(values.shape) if values.ndim else h5s.create(h5s.SCALAR)
    made = h5d.create(group.id, name.encode(), kind, space, properties)
    if values.size:
        whole = np.ascontiguousarray(values).reshape(values.shape)
        made.write(h5s.ALL, h5s.ALL, whole, _text_in_memory() if text else None)
    return made


def _creation() -> Any:
    """Properties of a dataset that keeps no time."""
    properties = h5p.create(h5p.DATASET_CREATE)
    properties.set_obj_track_times(False)
    return properties


@cache
def _text_type() -> Any:
    return h5t.py_create(h5py.string_dtype(), logical=True)


@cache
def _text_in_memory() -> Any:
    return h5t.py_create(h5py.string_dtype())


def _attribute(owner: Any, name: str, value: Any) -> None:
    """Create attribute ``name`` of ``owner``: text of any length, one number or byte string, or an array of numbers."""
    if isinstance(value, str):
        stored, kind, memory = np.array(value, dtype=object), _text_type(), _text_in_memory()
    else:
        stored = np.asarray(value)
        kind = memory = h5t.py_create(stored.dtype, logical=True)
    space = h5s.create_simple(stored.shape) if stored.ndim else h5s.create(h5s.SCALAR)
    h5a.create(owner, name.encode("utf-8", "backslashreplace"), kind, space).write(stored, mtype=memory)


def dims_of(dataset: h5py.Dataset) -> tuple[str, ...]:
    """Names of the dimensions of a ``dataset``; those of a dimension's own values are its name."""
    if dataset.is_scale:
        return (str(dataset.name).rsplit("/", 1)[-1],)
    return tuple(str(dim[0].name).rsplit("/", 1)[-1] for dim in dataset.dims)


def read_attrs(owner: h5py.Group | h5py.Dataset) -> dict[str, Any]:
    """Attributes of ``owner`` without those that make the layout; single numbers as such."""
    attrs = {}
    for name in owner.attrs:
        if name not in _OF_THE_LAYOUT:
            value = owner.attrs[name]
            attrs[name] = value.reshape(-1)[0] if isinstance(value, np.ndarray) and value.size == 1 else value
    return attrs


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
