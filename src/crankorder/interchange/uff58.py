"""Results as a universal file: order cuts against speed, waterfalls of orders and frequencies, with header and units.

Source: Universal File Datasets 58 (function at nodal DOF), 58b (its binary form), 151 (header) and 164 (units), SDRC
I-DEAS test data, as the University of Cincinnati (SDRL) keeps their description.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.ingest.units import base_unit, known_unit
from crankorder.quantities import Floats

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
        shown, factor, remark = text, 1.0, "NONE"
        if unit is not None and exponents != (0, 0, 0):
            shown, factor = base_unit(unit).name, unit.factor
            remark = f"{unit.factor:.10g} x the values of the results, which are in {text}" if factor != 1.0 else "NONE"
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
    channel = one.channel
    even, least, step = _even_axis(one.x)
    parts = [one.x] if not even else []
    parts += [one.y.real, one.y.imag] if np.iscomplexobj(one.y) else [one.y]
    values = np.stack(parts, axis=-1).ravel()
    kind = (5 if binary else 6) if np.iscomplexobj(one.y) else (2 if binary else 4)
    records = [_text(text, 80) for text in one.ids]
    records += [
        f"{one.kind:5d}{0:10d}{1:5d}{0:10d} {_text(channel.name, 10)}{channel.node:10d}{channel.direction:4d} "
        f"{'NONE':10}{0:10d}{0:4d}",
        f"{kind:10d}{len(one.x):10d}{int(even):10d}{least:13.5E}{step:13.5E}{one.z:13.5E}",
    ]
    records += [_axis_record(axis) for axis in (one.abscissa, channel.ordinate, _NO_AXIS, one.z_axis)]
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
    of_part = ["{:20.12E}".format] * len(parts)
    if not even:
        of_part[0] = "{:13.5E}".format
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
