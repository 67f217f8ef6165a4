"""Columns with rates and starts of their own, in every format that can hold them in one file."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pytest
import scipy.io

START = np.datetime64("2024-03-05T10:00:00", "ns")
LVM_HEAD = ["LabVIEW Measurement\t", "Writer_Version\t2", "Separator\tTab", "Decimal_Separator\t."]


class Sampled(NamedTuple):
    """A column: its name, unit, values, samples per second, and the time of its first sample in s."""

    name: str
    unit: str
    values: np.ndarray
    rate_hz: float
    start_s: float = 0.0


def as_tdms(path: Path, columns: list[Sampled], *, by_date: bool = True, dates: dict | None = None) -> dict[str, str]:
    """A group for each column, its start as date and offset (a quarter), or offset alone; ``dates`` by name."""
    nptdms = pytest.importorskip("nptdms", reason="the package nptdms (extra tdms) is not installed")
    with nptdms.TdmsWriter(str(path.with_suffix(".tdms"))) as writer:
        for column in columns:
            offset = column.start_s / 4.0 if by_date else column.start_s
            late = np.timedelta64(round(1e6 * (column.start_s - offset)), "us")
            date = (dates or {}).get(column.name, START.astype("datetime64[us]") + late)
            properties = {"wf_increment": 1.0 / column.rate_hz, "wf_start_offset": offset, "unit_string": column.unit}
            properties |= {"wf_start_time": date, "wf_samples": column.values.size}
            writer.write_segment([nptdms.ChannelObject(column.name, column.name, column.values, properties)])
    return {column.name: f"{column.name}/{column.name}" for column in columns}


def as_mdf(path: Path, columns: list[Sampled]) -> dict[str, str]:
    asammdf = pytest.importorskip("asammdf", reason="the package asammdf (extra mdf) is not installed")
    with asammdf.MDF(version="4.10") as file:
        for column in columns:
            stamps = column.start_s + np.arange(column.values.size) / column.rate_hz
            file.append(asammdf.Signal(column.values, stamps, unit=column.unit, name=column.name))
        file.save(path.with_suffix(".mf4"), overwrite=True)
    return {column.name: column.name for column in columns}


def as_hdf5(path: Path, columns: list[Sampled], *, key: str = "start_s") -> dict[str, str]:
    with h5py.File(path.with_suffix(".h5"), "w") as file:
        for column in columns:
            file[column.name] = column.values
            file[column.name].attrs.update({"rate_hz": column.rate_hz, "units": column.unit})
            late = np.timedelta64(round(1e9 * column.start_s), "ns")
            file[column.name].attrs[key] = str(START + late) if key == "wf_start_time" else column.start_s
    return {column.name: column.name for column in columns}


def as_matlab(path: Path, columns: list[Sampled]) -> dict[str, str]:
    parts = {column.name: {"y": column.values, "fs": column.rate_hz, "t0": column.start_s} for column in columns}
    scipy.io.savemat(path.with_suffix(".mat"), parts)
    return {column.name: f"{column.name}.y" for column in columns}


def uff_header(
    name: str, n_samples: int, *, form: int = 2, function: int = 1, node: int = 3, direction: int = -2,
    spacing: int = 1, time: str = "s", unit: str = "m/s^2", start_s: float = 0.5, step_s: float = 1.0 / 2560.0,
) -> str:  # fmt: skip
    """Head of a data set 58: ``n_samples`` of a ``function`` at a ``node``, of data type ``form``."""
    axis = 17 if function == 1 or not spacing else 18
    lines = [name, "NONE", "01-Jan-26 00:00:00", "NONE", "NONE"]
    lines += [f"{function:5d}{1:10d}{0:5d}{0:10d} {'NONE':10s}{node:10d}{direction:4d} {'NONE':10s}{0:10d}{0:4d}"]
    lines += [f"{form:10d}{n_samples:10d}{spacing:10d}{start_s:13.5E}{step_s:13.5E}{0.0:13.5E}"]
    none = (0, "NONE", "NONE")
    for kind, words, units in ((axis, "Time", time), (12, "Acceleration", unit), none, none):
        lines += [f"{kind:10d}{0:5d}{0:5d}{0:5d} {words:20s} {units:20s}"]
    return "\n".join([*lines, ""])


def uff_text(head: str, cells: Sequence[str], per_line: int) -> bytes:
    """Data set 58 of the ``cells`` of a text, so many on each line; the last line is padded."""
    rows = ["".join(cells[first : first + per_line]) for first in range(0, len(cells), per_line)]
    body = "\n".join(rows)
    return f"    -1\n    58\n{head}{body.ljust(80)}\n    -1\n".encode()


def uff_binary(head: str, data: bytes, order: int) -> bytes:
    """Data set 58 of binary ``data`` in a byte ``order``."""
    first = f"    58b{order:6d}{2:6d}{11:12d}{len(data):12d}{0:6d}{0:6d}{0:12d}{0:12d}\n"
    return f"    -1\n{first}{head}".encode() + data + b"\n    -1\n"


def as_uff(path: Path, columns: list[Sampled]) -> dict[str, str]:
    sets = []
    for number, (name, unit, values, rate_hz, start_s) in enumerate(columns, start=1):
        place = {"node": number, "direction": 3, "unit": unit, "start_s": start_s, "step_s": 1.0 / rate_hz}
        head = uff_header(name, values.size, form=4, **place)  # type: ignore[arg-type]
        sets.append(uff_text(head, [f"{value:20.12E}" for value in values], 4))
    path.with_suffix(".uff").write_bytes(b"".join(sets))
    return {column.name: f"{number}+Z" for number, column in enumerate(columns, start=1)}


def as_lvm(path: Path, columns: list[Sampled]) -> dict[str, str]:
    """A segment for each column, as of ``Multi_Headings``; its start in ``X0``."""
    text = [*LVM_HEAD, "Multi_Headings\tYes", "X_Columns\tNo", "***End_of_Header***\t", "\t"]
    for column in columns:
        text += [*_lvm_segment([column], "Date\t2024/03/05", "Time\t10:00:00.0"), "\t"]
    path.with_suffix(".lvm").write_text("\n".join(text) + "\n")
    return {column.name: f"{number}/{column.name}" for number, column in enumerate(columns)}


def as_lvm_of_one_segment(path: Path, columns: list[Sampled]) -> dict[str, str]:
    """All columns side by side, of one rate and length; their starts in ``X0``."""
    text = [*LVM_HEAD, "X_Columns\tNo", "***End_of_Header***\t", "\t", *_lvm_segment(columns)]
    path.with_suffix(".lvm").write_text("\n".join(text) + "\n")
    return {column.name: column.name for column in columns}


def _lvm_segment(columns: list[Sampled], *head: str) -> list[str]:
    """Lines of a segment of ``columns`` side by side."""
    rows = [("Channels", [len(columns)]), ("Samples", [column.values.size for column in columns])]
    rows += [("Y_Unit_Label", [column.unit for column in columns]), ("X_Dimension", ["Time"] * len(columns))]
    rows += [("X0", [repr(column.start_s) for column in columns])]
    rows += [("Delta_X", [repr(1.0 / column.rate_hz) for column in columns])]
    text = [*head, *("\t".join(map(str, (key, *cells))) for key, cells in rows), "***End_of_Header***\t"]
    text += ["\t".join(["X_Value", *(column.name for column in columns), "Comment"])]
    samples = zip(*(column.values for column in columns), strict=True)
    return text + ["\t" + "\t".join(f"{value:.9g}" for value in row) for row in samples]


WRITERS: dict[str, Callable[..., dict[str, str]]] = {
    "TDMS": as_tdms, "MDF4": as_mdf, "HDF5": as_hdf5, "MATLAB": as_matlab, "UFF": as_uff, "LVM": as_lvm,
}  # fmt: skip
