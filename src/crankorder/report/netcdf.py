"""Results as one NetCDF-4 file: the same bytes for the same input, checksummed, a group per noun."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.channel_units import by_channel
from crankorder.errors import InputError, UnsafeInputError, printable
from crankorder.report.netcdf_layout import (
    BARE_DIMENSION,
    Variable,
    dims_of,
    file_image,
    netcdf4_file,
    read_attrs,
    write_attrs,
    write_variables,
)
from crankorder.report.published import CONVENTIONS, published

COMPRESSION_LEVEL = (
    1  # level 4: 1.1 % smaller at the same time for a campaign (0.155 s either way), slower on wide bands
)
_DOUBLE = (
    "speed",
    "order",
    "frequency",
    "time",
    "crank_angle",
    "cycle_angle",
)  # axes keep 64 bits; estimates carry less than 24
_MAX_BYTES = 2_000_000_000  # of all variables of a results file that is read back


def results_bytes(groups: Mapping[str, xr.Dataset], *, attrs: Mapping[str, Any]) -> bytes:
    """Bytes of a NetCDF-4 file with one group per dataset; publish them whole.

    ``groups`` datasets by group name such as ``"order_map"`` or ``"findings/orders"``, stored as
    :func:`crankorder.report.published.published` has them; complex variables become two with ``_real`` and ``_imag``,
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
            chunks = _chunks(values) if packed else None
            variables[name + suffix] = Variable(dims, values, about, chunks, COMPRESSION_LEVEL)
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
            raise InputError(
                "not a results file of crankorder", file=path, place="attribute Conventions", found=conventions
            )
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
    for name in [
        name.removesuffix("_real") for name in variables if name.endswith("_real") and f"{name[:-5]}_imag" in variables
    ]:
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
