"""Results as one NetCDF-4 file: the same bytes for the same input, checksummed, a group per noun.

Source: NetCDF-4 file format specification (Unidata), "Creating NetCDF-4 files with HDF5". Calls of the HDF5 library are
made directly: the convenient ones of h5netcdf cost ten times as much for a file of a hundred small variables.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
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

    ``groups`` are datasets of any dims by group name such as ``"order_map"`` or ``"findings/orders"``, stored as
    :func:`crankorder.report.netcdf.published` has them; complex variables become two with ``_real`` and ``_imag``,
    estimates 32-bit floats, everything numeric gzip + shuffle + fletcher32. ``attrs`` are the attributes of the file:
    text and numbers stay, None is left out, anything else becomes JSON. No time of writing is stored.
    """
    # in memory, readable by every HDF5 since 1.10, metadata with checksums
    file = h5py.File("results", "w", driver="core", backing_store=False, block_size=1 << 20, libver=("v110", "v110"))
    properties = f"version=2,h5py={h5py.__version__},hdf5={h5py.version.hdf5_version}"
    _attribute(file.id, "_NCProperties", np.bytes_(properties.encode()))
    _write_attrs(file.id, {"Conventions": CONVENTIONS, **attrs})
    number = count()
    for name in sorted(groups):
        _write_group(file.require_group(name), published(groups[name]), number)
    file.flush()
    image = bytes(file.id.get_file_image())
    file.close()
    return image


def as_stored(groups: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """``groups`` (datasets of any dims) with values as :func:`results_bytes` keeps them: pictures redrawn are the same.

    Dims and shapes stay.
    """

    def stored(values: xr.DataArray) -> xr.DataArray:
        is_float = values.dtype.kind == "f"
        return values.copy(data=_narrow(str(values.name), values.values)) if is_float else values

    return {name: dataset.map(stored, keep_attrs=True) for name, dataset in groups.items()}


def plain_attrs(dataset: xr.Dataset) -> xr.Dataset:
    """``dataset`` (any dims) with attributes that any NetCDF writer takes: numbers, arrays of numbers and text."""
    plain = dataset.copy(deep=False)
    plain.attrs = _plain(dataset.attrs)
    return plain


def _write_group(group: h5py.Group, dataset: xr.Dataset, number: Iterator[int]) -> None:
    """Write ``dataset`` into ``group``; ``number`` counts the dimensions of the file."""
    _write_attrs(group.id, dataset.attrs)
    sizes = {str(dim): size for dim, size in dataset.sizes.items()}
    ids = {dim: np.int32(next(number)) for dim in sorted(sizes)}
    outer = " ".join(sorted(str(coord) for coord in dataset.coords if coord not in sizes))
    stored = {
        f"{name}{suffix}": (variable, values)
        for name, variable in sorted(dataset.variables.items(), key=lambda pair: str(pair[0]))
        for suffix, values in _stored(str(name), np.asarray(variable.values))
    }
    written = {}
    for name in sorted({*stored, *sizes}):
        if name in stored:
            written[name] = _write_values(group, name, stored[name][1])
        else:  # no values are stored
            space = h5s.create_simple((sizes[name],))
            written[name] = h5d.create(group.id, name.encode(), h5t.IEEE_F32BE, space, _creation())
        if name in sizes:
            label = name if name in stored else f"{BARE_DIMENSION.decode()}{sizes[name]:10d}"
            h5ds.set_scale(written[name], label.encode())
            _attribute(written[name], "_Netcdf4Dimid", ids[name])
    for name, (variable, _) in stored.items():
        dims = tuple(map(str, variable.dims))
        if name not in sizes:
            for axis, dim in enumerate(dims):
                h5ds.attach_scale(written[name], written[dim], axis)
        if dims:
            _attribute(written[name], "_Netcdf4Coordinates", np.array([ids[dim] for dim in dims]))
        is_value = bool(outer) and any(variable is dataset.variables[value] for value in dataset.data_vars)
        _write_attrs(written[name], {**variable.attrs, **({"coordinates": outer} if is_value else {})})


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


def _plain(attrs: Mapping[Any, Any]) -> dict[str, str | int | float | NDArray[Any]]:
    """Attributes as numbers, arrays of numbers and text, whatever they were; None is left out."""
    plain: dict[str, str | int | float | NDArray[Any]] = {}
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

    ``path`` is that of a file that :func:`results_bytes` made; dims are those of ``data_schema/``. Raises InputError
    where it cannot be read or is no results file, UnsafeInputError where it reaches outside itself or claims more than
    2 GB.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise UnsafeInputError("is too large for a results file", file=path, found=f"{path.stat().st_size} bytes")
        image = BytesIO(path.read_bytes())  # what is checked is what is read
        with h5py.File(image, "r") as file:
            names, conventions = _safe_groups(file, path), str(file.attrs.get("Conventions", ""))
            if not conventions.startswith("CF-"):
                place = "attribute Conventions"
                raise InputError("not a results file of crankorder", file=path, place=place, found=conventions)
            return {name: _read_group(file[name]) for name in names}
    except InputError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        remedy = "Run the analysis again, or give the results.nc that it wrote"
        raise InputError("cannot be read as NetCDF-4", file=path, found=error, remedy=remedy) from None


def _read_group(group: h5py.Group) -> xr.Dataset:
    variables, coords = {}, set[str]()
    for name, dataset in group.items():
        if not isinstance(dataset, h5py.Dataset):
            continue
        coords |= {name} if dataset.is_scale else set()
        if dataset.is_scale and bytes(dataset.attrs.get("NAME", b"")).startswith(BARE_DIMENSION):
            continue
        values, attrs = np.asarray(dataset[...]), _read_attrs(dataset)
        coords |= set(str(attrs.pop("coordinates", "")).split())
        if values.dtype.kind == "O":  # text or UTF-8 bytes
            texts = [text.decode("utf-8") if isinstance(text, bytes) else str(text) for text in values.ravel()]
            values = np.array(texts, dtype=str).reshape(values.shape)
        # the dimension of a scale is its own name
        scales = [dataset] if dataset.is_scale else [dim[0] for dim in dataset.dims]
        variables[name] = (tuple(str(scale.name).rsplit("/", 1)[-1] for scale in scales), values, attrs)
    pairs = [name[:-5] for name in variables if name.endswith("_real") and f"{name[:-5]}_imag" in variables]
    for name in pairs:
        (dims, real, attrs), (_, imaginary, _) = variables.pop(f"{name}_real"), variables.pop(f"{name}_imag")
        variables[name] = (dims, real + 1j * imaginary, attrs)
    return by_channel(xr.Dataset(variables, attrs=_read_attrs(group)).set_coords(sorted(coords & set(variables))))


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
            name = f"{at}/{key}".lstrip("/")
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                raise UnsafeInputError("holds a link", file=path, place=f"{at}/{key}", remedy="Results hold data only")
            member = group[key]
            if isinstance(member, h5py.Group):
                names.append(name)
                waiting.append(name)
            elif isinstance(member, h5py.Dataset):
                total += int(member.nbytes)
                if member.external or member.is_virtual or total > _MAX_BYTES:
                    problem = "stores data elsewhere or claims too much"
                    raise UnsafeInputError(problem, file=path, place=name, found=total)
    return sorted(names)


BARE_DIMENSION = b"This is a netCDF dimension but not a netCDF variable."
"""Begins the name of a dimension that has no values."""

_OF_THE_LAYOUT = {"CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST"}
_OF_THE_LAYOUT |= {"_Netcdf4Dimid", "_Netcdf4Coordinates", "_NCProperties"}


def _write_attrs(owner: Any, attrs: Mapping[Any, Any]) -> None:
    """Write ``attrs`` to ``owner``, the identifier of a file, group or dataset."""
    for name, value in sorted(_plain(attrs).items()):
        _attribute(owner, name, value if isinstance(value, str) else np.atleast_1d(np.asarray(value)))


def _write_values(group: h5py.Group, name: str, values: NDArray[Any]) -> Any:
    """Write ``values``, numbers packed and checksummed; returns the identifier of their dataset."""
    kind, memory = _text_types() if values.dtype.kind == "O" else (h5t.py_create(values.dtype, logical=True), None)
    properties = _creation()
    if values.ndim and values.size and values.dtype.kind in "iuf":
        properties.set_chunk(_chunks(values))
        properties.set_shuffle()
        properties.set_deflate(COMPRESSION_LEVEL)
        properties.set_fletcher32()
    space = h5s.create_simple(values.shape) if values.ndim else h5s.create(h5s.SCALAR)
    dataset = h5d.create(group.id, name.encode(), kind, space, properties)
    if values.size:
        whole = np.ascontiguousarray(values).reshape(values.shape)
        dataset.write(h5s.ALL, h5s.ALL, whole, memory)
    return dataset


def _creation() -> Any:
    """Creation properties of an HDF5 dataset without time stamps."""
    properties = h5p.create(h5p.DATASET_CREATE)
    properties.set_obj_track_times(False)
    return properties


@cache
def _text_types() -> tuple[Any, Any]:
    """Type of text of any length in a file, and in memory."""
    return h5t.py_create(h5py.string_dtype(), logical=True), h5t.py_create(h5py.string_dtype())


def _attribute(owner: Any, name: str, value: Any) -> None:
    """Create attribute ``name`` of ``owner``: text of any length, one number or byte string, or an array of numbers."""
    if isinstance(value, str):
        stored, (kind, memory) = np.array(value, dtype=object), _text_types()
    else:
        stored = np.asarray(value)
        kind = memory = h5t.py_create(stored.dtype, logical=True)
    space = h5s.create_simple(stored.shape) if stored.ndim else h5s.create(h5s.SCALAR)
    h5a.create(owner, name.encode("utf-8", "backslashreplace"), kind, space).write(stored, mtype=memory)


def _read_attrs(owner: h5py.Group | h5py.Dataset) -> dict[str, object]:
    """Attributes of ``owner`` without those that make the layout; single numbers as such."""
    told = ((name, owner.attrs[name]) for name in owner.attrs if name not in _OF_THE_LAYOUT)
    return {name: value.flat[0] if isinstance(value, np.ndarray) and value.size == 1 else value for name, value in told}


def published(dataset: xr.Dataset) -> xr.Dataset:
    """``dataset`` (any dims, which stay) as it stands in a file or a tree that a user opens.

    Its units are real (:func:`crankorder.channel_units.with_real_units`), each estimate names its intervals and errors
    in ``ancillary_variables``, amplitudes say how they are scaled, phases from where they count. Its quality flags are
    left out: they are the table ``findings/quality``.
    """
    real = with_real_units(dataset).copy(deep=False)
    real.attrs = {key: value for key, value in dataset.attrs.items() if key != "quality"}
    for name in map(str, real.data_vars):
        base = str(real[name].attrs.get(PART_OF, name))
        if about := {**_linked(real, name, base), **_conventions(base, dataset)}:
            real[name].attrs = {**real[name].attrs, **about}
    return real


def _linked(dataset: xr.Dataset, name: str, base: str) -> dict[str, str]:
    """``ancillary_variables`` of the variable ``name``, the whole or a part of ``base``: those that bound its error."""
    end = name.removeprefix(base)
    of_error = next((key for key in ("coherent_amplitude", "amplitude", "mean") if key + end in dataset), "")
    bounds = [f"{base}_ci95", f"{base}_low", f"{base}_high"]
    bounds += ["standard_error", "degrees_of_freedom"] if base == of_error else []
    linked = [key for key in (key + end if key + end in dataset else key for key in bounds) if key in dataset]
    return {"ancillary_variables": " ".join(linked)} if linked else {}


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
    """Attributes of a whole file of results, as CF and ACDD name them.

    They tell of ``findings`` and of the datasets ``groups`` (any dims) by group name.
    """
    low, high = findings.speed_range_rpm
    names = ", ".join(f"{channel.name} [{channel.unit}]" for channel in findings.channels)
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
    channels = {channel.name: (channel.unit, channel.quantity or "") for channel in findings.channels}
    for table, kind in kinds.items():
        if records := getattr(findings, table):
            tables[f"findings/{table}"] = _table(records, kind, channels)
    if findings.balance is not None:
        tables["findings/balance"] = xr.Dataset(attrs=findings.balance.as_dict())
    return tables


def _table(records: tuple[Record, ...], kind: type[Record], channels: Mapping[str, tuple[str, str]]) -> xr.Dataset:
    rows, columns = [record.as_dict() for record in records], kind.columns()
    keys = dict.fromkeys(key for row in rows for key in row)
    variables = {key: _column(columns[key], [row.get(key) for row in rows]) for key in keys}
    if any(about.get("units") == "see unit" for _, _, about in variables.values()):
        of_channel = [channels.get(str(row.get("channel")), (row.get("unit") or "", "")) for row in rows]
        units, quantities = np.array(of_channel, dtype=object).T
        variables["unit"] = ("record",), units, {"long_name": "unit of the channel"}
        variables["quantity"] = ("record",), quantities, {"long_name": "what it measures"}
    return xr.Dataset(variables)


def _column(column: Column, values: list[Any]) -> tuple[tuple[str, ...], NDArray[Any], dict[str, str]]:
    name = column.key.removesuffix("_ci95")
    units = _UNITS_BY_NAME.get(name) or next((unit for end, unit in _UNITS_BY_END.items() if name.endswith(end)), "")
    about = {"long_name": column.text} | ({"units": units} if units else {})
    if column.kind == "bool":
        return ("record",), np.array([-1 if value is None else int(value) for value in values], dtype=np.int8), about
    if column.kind in ("number", "interval"):
        dims, none = (("record",), None) if column.kind == "number" else (("record", "bound"), (None, None))
        return dims, np.array([none if value is None else value for value in values], dtype=np.float64), about
    parts = ([value] if isinstance(value, str) else value or () for value in values)
    texts = [", ".join(map(str, part)) for part in parts]
    return ("record",), np.array(texts, dtype=object), {"long_name": column.text}
