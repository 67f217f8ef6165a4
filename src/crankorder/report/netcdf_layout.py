"""How a NetCDF-4 file lies in HDF5: shared dimensions, variables on them, attributes; written with h5py alone.

Source: NetCDF-4 file format specification (Unidata), "Creating NetCDF-4 files with HDF5". Calls of the HDF5 library are
made directly: the convenient ones of h5netcdf cost ten times as much for a file of a hundred small variables.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5d, h5ds, h5p, h5s, h5t
from numpy.typing import NDArray

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
    level: int


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
            written[name] = h5d.create(
                group.id, name.encode(), h5t.IEEE_F32BE, h5s.create_simple((sizes[name],)), _plain()
            )
            label = f"{BARE_DIMENSION.decode()}{sizes[name]:10d}"
        if name in sizes:
            h5ds.set_scale(written[name], label.encode())
            _attribute(written[name], "_Netcdf4Dimid", np.int32(ids[name]))
    for name, variable in variables.items():
        if name not in sizes:
            for axis, dim in enumerate(variable.dims):
                h5ds.attach_scale(written[name], written[dim], axis)
        if variable.dims:
            _attribute(
                written[name], "_Netcdf4Coordinates", np.array([ids[dim] for dim in variable.dims], dtype=np.int32)
            )
        write_attrs(written[name], variable.attrs)


def _dataset(group: h5py.Group, name: str, variable: Variable) -> Any:
    values = variable.values
    text = values.dtype.kind == "O"
    properties = _plain()
    if variable.chunks:
        properties.set_chunk(variable.chunks)
        properties.set_shuffle()
        properties.set_deflate(variable.level)
        properties.set_fletcher32()
    kind = _text_type() if text else h5t.py_create(values.dtype, logical=True)
    space = h5s.create_simple(values.shape) if values.ndim else h5s.create(h5s.SCALAR)
    made = h5d.create(group.id, name.encode(), kind, space, properties)
    if values.size:
        whole = np.ascontiguousarray(values).reshape(values.shape)
        made.write(h5s.ALL, h5s.ALL, whole, _text_in_memory() if text else None)
    return made


def _plain() -> Any:
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
    made = h5a.create(owner, name.encode("utf-8", "backslashreplace"), kind, space)
    made.write(stored, mtype=memory)


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
