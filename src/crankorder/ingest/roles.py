"""What the columns of a recording are for: times, angle, encoder, marks, speed or signals, as names and values tell.

For a draft also which files list the pulses of which recordings; for reading whether a column of angles and the
manifest agree.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from crankorder.errors import CrankorderError, InputError, UnsafeInputError, printable
from crankorder.ingest.channel import STATES_NO_UNIT
from crankorder.ingest.encoder_table import TIME_KINDS
from crankorder.ingest.formats import contents_of, read_file
from crankorder.ingest.manifest import Manifest
from crankorder.ingest.rawfile import Contents, RawFile, Source, looks_counted, named
from crankorder.ingest.sampling import read_time_column, rows_before_zeros
from crankorder.ingest.units import Unit, known_unit, unit_in_label, unit_in_suffix, unit_of
from crankorder.quantities import Floats
from crankorder.settings import IngestSettings, load_settings
from crankorder.shaft.pulses import wrap_seen

Role = Literal["time", "angle", "encoder", "index", "cam", "speed", "constant", "channel", "unused"]
Kind = Literal["", "square", "analogue", "angle", "count", "pulse_times", "edge_list"]

MOST_SAMPLES = 4_000_000
"""Samples of a column that are enough to see a wheel."""
# A file larger than this is judged by its names, and by the columns whose names promise something.
_MOST_BYTES = 200_000_000
# A trace is a square wave where this share of the samples on either side of its middle lies within LEVEL_WIDTH of the
# height of their level; of a sine 0.45 do, of struck vibration less.
SQUARE_SHARE, LEVEL_WIDTH = 0.7, 0.2
# Of a step, as far as a grid of times or angles that was rounded in writing may wander.
_UNEVEN = 0.5
# Of the rows of a list of edges, those at which a level changes.
_EDGE_SHARE = 0.5
# Of the time of the longest column that another of its own rate must span to belong to the recording …
_SPAN = 0.75
# … and of the rate of the fastest channel: beside a slower one more than a quarter of its band would be lost.
_SLOWEST = 0.75
# Of a column that holds pulses.
_FEWEST_EDGES = 4
# Share of the samples from which a trace is mostly high.
_MOSTLY_HIGH = 0.8
# Share of the edges of another column from which on both are the same wheel.
_SAME_EDGES = 0.8

_TIME = re.compile(r"(rel(ative)?|abs(olute)?|elapsed)?[ _.-]*(time|zeit|temps|tiempo|tempo|t)([ _.-]*stamp)?", re.I)
_ANGLE = re.compile(r"crank[ _.-]*angle|kurbelwinkel|\bangle|winkel|\btheta\b|(^|[^a-z])(deg)?cad?([^a-z]|$)", re.I)
_INDEX = re.compile(
    r"(^|[^a-z])(index|idx|tdc|ot|trig(ger)?|z.?pulse|once.?per.?rev|1.?per.?rev|key.?phas\w*|ref)([^a-z]|$)", re.I
)
_ENCODER = re.compile(
    r"enc|tach|pulse|crank|tooth|teeth|(^|[^a-z])(ir|ckp|kw|rev(s|ol\w*)?)([^a-z]|$)|kurbel|drehgeber", re.I
)
_POSITION = re.compile(r"posit|(^|[^a-z])(pos|counts|enc(oder)?|lage|drehgeber)([^a-z]|$)", re.I)
_CAM = re.compile(r"(^|[^a-z])(cam(shaft)?|cmp)([^a-z]|$)|nockenwelle", re.I)
SPEED_NAME = re.compile(r"rpm|speed|drehzahl|(^|[^a-z])u.?min([^a-z]|$)", re.I)
_SIGNAL = re.compile(r"acc|vib|press|mic|force|sound|strain|torque|schwing|druck|kraft", re.I)
_SIGNS: tuple[tuple[re.Pattern[str], Role], ...] = ((_INDEX, "index"), (_CAM, "cam"), (_ENCODER, "encoder"))
_SLOW_UNITS = ("°C", "degC", "deg C", "C", "°F", "degF", "F", "K", "%", "%RH")


@dataclass(frozen=True, slots=True)
class Column:
    """One column: its ``name`` and ``source``, its ``role``, the unit that the file or its name states, and doubts.

    ``label`` is the name without its unit; ``doubt`` says what a person should decide about it, empty where nothing,
    and ``elsewhere`` what other files call the column, where its source is a number because of that.
    ``values`` (samples,) are empty where they were not read; angles are in degrees. ``kind`` is the kind of an encoder,
    and ``wrap`` the value after which an angle or a count starts anew, in its unit, 0 for never.
    """

    name: str
    source: Source
    role: Role
    label: str
    unit: Unit | None = None
    doubt: str = ""
    values: Floats = field(default_factory=lambda: np.empty(0))
    kind: Kind = ""
    wrap: float = 0.0
    elsewhere: str = ""

    @property
    def quantity(self) -> str:
        """What the unit measures, "" without a unit."""
        return "" if self.unit is None else self.unit.quantity

    @property
    def is_angular(self) -> bool:
        """Whether the unit, or without one the name, is that of an angle."""
        return self.quantity == "angle" or (not self.quantity and _ANGLE.search(self.label) is not None)

    @property
    def seconds(self) -> Floats:
        """Values (samples,) as times in s; a column without a stated unit of time is taken to be in s."""
        return self.values * (self.unit.factor if self.unit is not None and self.quantity == "time" else 1.0)

    @property
    def grows(self) -> bool:
        """Whether the values were read, and each is larger than the one before."""
        return self.values.size > 0 and bool((np.diff(self.values) > 0.0).all())

    @property
    def is_binary(self) -> bool:
        """Whether the values are all one of two levels, such as 0 and 1, or one level."""
        values = self.values
        return values.size > 1 and bool(((values == values.min()) | (values == values.max())).all())

    @property
    def middle(self) -> float:
        """Halfway between the least and the greatest of the values, NaN where they were not read."""
        return 0.5 * float(self.values.min() + self.values.max()) if self.values.size else np.nan

    @property
    def n_edges(self) -> int:
        """Rising edges of the values; 0 where they were not read."""
        high = self.values > self.middle
        return int(np.count_nonzero(high[1:] & ~high[:-1]))

    @property
    def is_mostly_high(self) -> bool:
        """Whether nearly all of the values lie above their middle."""
        return self.values.size > 0 and float(np.mean(self.values > self.middle)) > _MOSTLY_HIGH

    def used_as(self, role: Role, doubt: str = "") -> Column:
        """This column with another ``role``, and a ``doubt`` where there is one."""
        return replace(self, role=role, doubt=doubt or self.doubt)


@dataclass(frozen=True, slots=True)
class Columns:
    """The columns of a file; ``four_stroke`` says whether its angle spans 720°."""

    all: tuple[Column, ...]
    four_stroke: bool = False

    def of(self, role: Role) -> Column | None:
        """First column with ``role``, None where none has it."""
        return next((column for column in self.all if column.role == role), None)

    def channels(self) -> list[Column]:
        """Columns of signals to analyse."""
        return [column for column in self.all if column.role == "channel"]


def is_square(values: Floats) -> bool:
    """Whether ``values`` (samples,) are at two levels nearly all of the time, however seldom at one of them."""
    finite = values[np.isfinite(values)]
    low, high = (float(level(finite)) for level in (np.min, np.max))
    for _ in range(2):
        above = finite > 0.5 * (low + high)
        if not 0 < np.count_nonzero(above) < above.size:
            return False
        low, high = float(np.mean(finite[~above])), float(np.mean(finite[above]))
    near = np.abs(finite - np.where(above, high, low)) < LEVEL_WIDTH * (high - low)
    return bool(min(np.mean(near[above]), np.mean(near[~above])) >= SQUARE_SHARE)


def _lists_edges(time: Column, others: Sequence[Column]) -> bool:
    """Whether the rows at ``time`` are edges, of one of the levels in ``others`` each, and not samples."""
    step = np.diff(time.values)
    alike = [column for column in others if column.values.size == time.values.size and column.is_binary]
    levels = [np.diff(column.values) != 0.0 for column in alike]
    uneven = step.size > 1 and bool(np.ptp(step) >= _UNEVEN * np.median(step))
    return uneven and bool(levels) and float(np.mean(np.any(levels, axis=0))) > _EDGE_SHARE


def angle_columns(contents: Contents) -> dict[str, float]:
    """Degrees per unit of the columns among ``contents`` whose unit or name is that of an angle, by name."""
    units = {name: _unit_and_label(name, contents) for name in contents.names}
    return {
        name: 1.0 if unit is None else unit.factor / unit_of("deg").factor
        for name, (unit, label) in units.items()
        if (unit.quantity == "angle" if unit is not None else _ANGLE.search(label))
    }


def columns_of(path: Path, contents: Contents, *, settings: IngestSettings) -> Columns:
    """Columns of the file at ``path`` with their roles, from its ``contents`` and a bounded part of the samples.

    ``settings`` limit what is read.
    """
    # a MATLAB file may hold much besides, as single numbers and spectra
    matlab, degrees = contents.format == "MATLAB", angle_columns(contents)
    names = [name for name in contents.names if (_spans(name, contents) if matlab else contents.samples.get(name) != 1)]
    values = _values_of(path, names, settings)
    found = [_judged(name, contents, values.get(name, np.empty(0)) * degrees.get(name, 1.0)) for name in names]
    if any(column.role == "time" and _is_straight(column.values) for column in found):
        # at a held speed an angle grows as evenly as the time, which is what tells the speed
        found = [column.used_as("encoder") if column.role == "angle" else column for column in found]
    found = _first_of_edges(list(_used_together(found, contents.rates_hz)))
    time = next((column for column in found if column.role == "time"), None)
    of_edges = time is not None and _lists_edges(time, [column for column in found if column is not time])
    if time is not None and len(found) == 1:
        found = [time.used_as("encoder", "times alone: taken for those of pulses")]
    elif of_edges:
        found = [_of_edge_list(column) for column in found]
    found = [_with_kind(column, of_edges=of_edges) for column in _marks_by_count(found)]
    if not any(column.role in ("channel", "encoder", "index") for column in found):
        # a manifest needs a signal
        last = ([column for column in found if column.role in ("unused", "speed", "cam", "time")] or found)[-1]
        found = [column.used_as("channel") if column is last else column for column in found]
    angle = next((column.values for column in found if column.role == "angle"), np.zeros(1))
    four_stroke = bool((np.diff(angle) < 0).any()) and float(np.ptp(angle)) > 360.0 + 1.5 * (angle_step(angle) or 0.0)
    speeds = [name for name in contents.names if contents.samples.get(name) == 1 and SPEED_NAME.search(name)]
    constants = [Column(name, _source(name, contents), "constant", name) for name in speeds[:1]]
    return Columns((*found, *constants), four_stroke)


def _spans(name: str, contents: Contents) -> bool:
    """Whether the column ``name`` may have been recorded beside the longest: as many samples, or a base of its own."""
    samples, rates, starts = contents.samples, contents.rates_hz, contents.starts_s
    if name not in samples or samples[name] == max(samples.values()):
        return True
    if name not in rates:
        return False
    longest = max((other for other in rates if other in samples), key=lambda other: samples[other])
    same = rates[name] == rates[longest] and starts.get(name, 0.0) == starts.get(longest, 0.0)
    return not same and samples[name] / rates[name] >= _SPAN * samples[longest] / rates[longest]


def _source(name: str, contents: Contents) -> Source:
    """What a manifest calls the column ``name``: its number, where the file gives it no name."""
    unnamed = name.isdigit() and int(name) < len(contents.names) and contents.names[int(name)] == name
    return int(name) if unnamed and contents.format in ("text", "XLSX") else name


def _values_of(path: Path, names: Sequence[str], settings: IngestSettings) -> dict[str, Floats]:
    """Samples of the columns ``names`` by name, of promising ones alone where the file is large; empty on a fault."""
    if path.stat().st_size > _MOST_BYTES:
        names = [name for name in names if any(sign.search(name) for sign in (_ENCODER, _INDEX, _CAM, _ANGLE))]
    try:
        raw = read_file(path, sources=list(names), settings=settings)
    except UnsafeInputError:  # a bomb is no recording to draft from
        raise
    except (CrankorderError, OSError, ValueError):
        return {}
    values = {str(name): column[:MOST_SAMPLES].astype(np.float64) for name, column in raw.columns.items()}
    ends = [(column, rows_before_zeros(column)) for column in values.values()]
    of_times = [rows for column, rows in ends if rows < column.size and (np.diff(column[:rows]) > 0.0).all()]
    rows = min(of_times, default=MOST_SAMPLES)
    values = {name: column[:rows] for name, column in values.items()}
    return {name: column for name, column in values.items() if column.size > 2 and np.isfinite(column).any()}


def _judged(name: str, contents: Contents, values: Floats) -> Column:
    """What the column ``name`` is for by itself; ``values`` are empty where they were not read."""
    stated, told = contents.units.get(name, ""), unit_in_suffix(name)
    unit, label = _unit_and_label(name, contents)
    column = Column(name, _source(name, contents), "channel", label, unit, values=values)
    role = _role(column, is_timed=bool(contents.rates_hz))
    n_samples, longest = contents.samples.get(name), max(contents.samples.values(), default=0)
    if role != "encoder" and not _spans(name, contents):
        return replace(column, role="unused", doubt=f"{n_samples} samples of {longest}", values=np.empty(0))
    doubt = "the first column grows in even steps: taken for seconds" if role == "time" and label.isdigit() else ""
    if stated in STATES_NO_UNIT and unit is not None:
        doubt = f"unit {told} as the name of the column says"
    elif stated not in STATES_NO_UNIT and unit is None:
        doubt = f"the file states the unit {stated!r}, which is not known"
        role = "unused" if stated.strip() in _SLOW_UNITS else role
    elif unit is None and role == "channel" and values.size and looks_counted(values):
        unit, doubt = unit_of("counts"), "whole numbers without a unit: counts of a converter, or m/s2, g, Pa, …"
    seen = None
    if role in ("encoder", "angle") and values.size:
        seen = wrap_seen(values) if column.is_angular else _whole_numbers(values)
    kind: Kind = "" if seen is None else "angle" if column.is_angular else "count"
    return replace(column, role=role, unit=unit, doubt=doubt, kind=kind, wrap=seen[0] if seen else 0.0)


def _unit_and_label(name: str, contents: Contents) -> tuple[Unit | None, str]:
    """Unit of the column ``name`` as the file or the name states it, and the name without it."""
    stated = contents.units.get(name, "")
    unit = known_unit(stated if stated not in STATES_NO_UNIT else unit_in_suffix(name))
    return unit, _bare(name.rpartition("/")[2] if contents.format == "HDF5" else name)


def _role(column: Column, *, is_timed: bool) -> Role:
    """What a ``column`` is for by its label, quantity and values; ``is_timed``: the file states rates."""
    label, quantity, values, was_read = column.label, column.quantity, column.values, column.values.size > 0
    if column.is_angular:
        if not was_read or wrap_seen(values) is None:
            return "unused"
        return "encoder" if angle_step(values) is None else "angle"
    grows = bool((np.diff(values) > 0.0).all())
    if _is_time(column.unit, label) and grows:
        return "time"
    if quantity == "rotational speed" or (not quantity and SPEED_NAME.search(label) and not column.is_binary):
        return "speed"
    if quantity not in ("", "voltage", "counts", "full scale", "ratio") or _SIGNAL.search(label):
        return "channel"
    if was_read and not label.isdigit() and (whole := _whole_numbers(values)) is not None:
        wrap, even = whole
        is_position = quantity == "counts" or _POSITION.search(label)
        return "encoder" if is_position and (wrap or not even) else "unused"
    for sign, role in _SIGNS:
        if sign.search(label) and (not was_read or np.ptp(values[np.isfinite(values)]) > 0.0):
            return role
    if not was_read:
        return "channel"
    if (column.is_binary and np.ptp(values) > 0.0) or (quantity in ("", "voltage") and is_square(values)):
        return "encoder" if column.n_edges >= _FEWEST_EDGES else "unused"
    if label.isdigit() and grows and _is_straight(values):
        counted = np.ptp(np.diff(values)) == 0.0 and values[1] - values[0] == 1.0
        return "unused" if counted or is_timed else "time"
    return "channel"


def _is_time(unit: Unit | None, label: str) -> bool:
    """Whether the ``unit``, or without one the ``label``, is that of a time."""
    return unit.quantity == "time" if unit is not None else _TIME.fullmatch(label) is not None


def _bare(name: str) -> str:
    """``name`` without the unit in brackets behind it."""
    bare, suffix = name, unit_in_suffix(name)
    if unit_in_label(name):
        bare = re.sub(r"\s*[\[(][^\[\]()]*[\])]\s*$", "", name)
    elif suffix and _TIME.fullmatch(name[: -len(suffix) - 1]):
        bare = name[: -len(suffix) - 1]
    return bare.strip(" _.-") or name


def _is_straight(times: Floats) -> bool:
    """Whether ``times`` (sample,) lie within a step of a straight line."""
    if not times.size:
        return False
    off = times - np.linspace(times[0], times[-1], times.size)
    return float(np.abs(off).max()) * (times.size - 1) < float(times[-1] - times[0])


def _whole_numbers(values: Floats) -> tuple[float, bool] | None:
    """What :func:`wrap_seen` tells of ``values``, where they are whole numbers of many sizes; else None."""
    finite = values[np.isfinite(values)]
    many = finite.size > 2 and np.ptp(finite) > 2.0 and bool((finite == np.rint(finite)).all())
    return wrap_seen(values) if many else None


def angle_step(values: Floats) -> float | None:
    """Step [deg] of evenly rising ``values`` (samples,), over whole turns or without end; None for others."""
    steps = np.diff(values)
    usual = float(np.median(steps)) if steps.size else 0.0
    off = (steps - usual + 180.0) % 360.0 - 180.0
    if not 0.0 < usual < 90.0 or not (np.abs(off) < 0.1 * usual).all():
        return None
    step = usual + float(off.mean())  # steps that were rounded add up to the true one
    per_rev = 360.0 / step
    return step if abs(per_rev - round(per_rev)) < 1e-3 * per_rev else None


def _used_together(found: list[Column], rates_hz: Mapping[str, float]) -> Iterator[Column]:
    """``found`` without what cannot be used beside the others.

    A second time, angle, speed or mark; a time beside an angle; a time of columns that differ in rate, whose times it
    does not tell, and among these slow channels, which would slow all down.
    """
    several = len({rates_hz.get(column.name) for column in found if column.role != "time"} - {None}) > 1
    fastest_hz = max((rates_hz.get(column.name, 0.0) for column in found if column.role == "channel"), default=0.0)
    seen: set[Role] = {"time"} if any(column.role == "angle" for column in found) else set()
    for column in found:
        role, rate_hz = column.role, rates_hz.get(column.name, fastest_hz)
        if role == "time" and several:
            column = column.used_as("unused", "each channel has times of its own")
        elif role == "channel" and rate_hz < _SLOWEST * fastest_hz:
            doubt = f"{rate_hz:.6g} Hz beside channels of {fastest_hz:.6g} Hz: all would come to it"
            column = column.used_as("unused", doubt)
        elif role in seen and role not in ("channel", "encoder"):
            column = column.used_as("unused")
        seen.add(role)
        yield column


def _first_of_edges(found: list[Column]) -> list[Column]:
    """``found`` with its first column as the times of edges, where nothing names it and all others are levels."""
    first, others = found[0], found[1:]
    if others and all(column.is_binary for column in others) and first.label.isdigit() and first.grows:
        return [replace(first, role="time", doubt="the first column grows: taken for seconds"), *others]
    return found


def _of_edge_list(column: Column) -> Column:
    """``column`` of a file whose lines are changes of levels: what changes is a pulse, what does not has no use."""
    is_pulse = column.is_binary and column.n_edges >= _FEWEST_EDGES
    if column.role == "time" or (is_pulse and column.role in ("index", "cam", "encoder")):
        return column
    return column.used_as("encoder" if is_pulse else "unused")


def _marks_by_count(found: list[Column]) -> list[Column]:
    """``found`` with one encoder, the column of the most edges, and of the others an index and a cam mark by theirs.

    Columns alike in number of edges are one wheel read twice.
    """
    pulses = sorted((column for column in found if column.role == "encoder"), key=lambda column: -column.n_edges)
    roles: dict[str, Role] = {}
    free: list[Role] = ["encoder", *(role for role in ("index", "cam") if all(each.role != role for each in found))]
    most = np.inf
    for column in pulses:
        roles[column.name] = free.pop(0) if free and column.n_edges <= most else "unused"
        most = _SAME_EDGES * column.n_edges
    doubt = "by the number of its edges" if len(pulses) > 1 else ""
    chosen = [(column, roles.get(column.name, column.role)) for column in found]
    return [column.used_as(role, doubt if column.name in roles and role != "unused" else "") for column, role in chosen]


def _with_kind(column: Column, *, of_edges: bool) -> Column:
    """``column`` with how its values tell the shaft, where it is an encoder or a mark; ``of_edges``: rows are edges."""
    values = column.values
    if column.role not in ("encoder", "index") or column.kind or not values.size:
        return column
    if np.isfinite(values).all() and (np.diff(values) >= 0.0).all() and np.ptp(values) > 0.0:
        return replace(column, kind="pulse_times")
    return replace(column, kind="edge_list" if of_edges else "square" if is_square(values) else "analogue")


def read_checked(
    path: Path, manifest: Manifest, *, sources: Sequence[Source], settings: IngestSettings, rows: slice | None = None
) -> RawFile:
    """Columns of the file at ``path`` that ``sources`` ask for, as ``formats.read_file`` reads them.

    For recordings by crank angle, the columns of angle in the file are compared with ``manifest``; where that states a
    rate and the file none, even times in a column of it, which nothing asks for, are taken for the file's own rate.
    ``settings`` and ``rows`` are those of that function. Raises its errors, and InputError where an angle contradicts.
    """
    sampling, contents = manifest.sampling, contents_of(path, settings=settings)
    if sampling.domain == "time":
        times = [name for name in contents.names if _is_time(*_unit_and_label(name, contents))]
        of_pulses = manifest.encoder.kind in TIME_KINDS and manifest.encoder.file is None
        if not times or contents.rates_hz or not sampling.rate_hz or sampling.time_source is not None or of_pulses:
            return read_file(path, sources=sources, settings=settings, rows=rows)
        raw = read_file(path, sources=[*sources, *times[:1]], settings=settings, rows=rows)
        return _with_rate(raw, times[0], path, sampling.rate_hz, sources=sources, settings=settings)
    asked = [named(source, contents.names, path) for source in sources]
    sampled = {name: (contents.samples.get(name), contents.rates_hz.get(name)) for name in contents.names}
    alike = {sampled[name] for name in asked}
    told = angle_columns(contents).items()
    degrees = {name: factor for name, factor in told if name not in asked and sampled[name] in alike}
    raw = read_file(path, sources=[*sources, *degrees], settings=settings, rows=rows)
    for name, factor in degrees.items():
        angle_deg = raw.columns[name][:MOST_SAMPLES] * np.float64(factor)
        _refuse_contradiction(name, angle_deg, manifest, path, is_start=not (rows and rows.start))
    return raw


def _with_rate(
    raw: RawFile, name: str, path: Path, stated_hz: float, *, sources: Sequence[Source], settings: IngestSettings
) -> RawFile:
    """The columns ``sources`` of ``raw``, at the rate that its times in the column ``name`` tell, where these are even.

    Times without a unit are in that of s, ms, µs and ns which comes nearest to the rate that the manifest stated.
    """
    columns, times = {source: raw.columns[source] for source in sources}, raw.columns[name]
    with suppress(InputError):  # uneven times are those of a reader: the manifest says so, for it does not ask for them
        unit, told = _unit_and_label(name, raw.contents)[0], read_time_column(times, path, settings=settings)
        steps = (1.0, 1e-3, 1e-6, 1e-9) if unit is None else (unit.factor,)
        rate_hz = min((told.rate_hz / step for step in steps), key=lambda hz: abs(np.log(hz / stated_hz)))
        rates = {source: rate_hz for source, column in columns.items() if column.size == times.size}
        return replace(raw, columns=columns, rates_hz=rates, rate_uncertainty=told.rate_uncertainty)
    return replace(raw, columns=columns)


def _refuse_contradiction(name: str, angle_deg: Floats, manifest: Manifest, path: Path, *, is_start: bool) -> None:
    """Refuse a manifest with another step or start than the column ``angle_deg`` (sample,), if it is one of angles."""
    step_deg = angle_step(angle_deg)
    if step_deg is None:
        return
    sampling, steps = manifest.sampling, angle_deg.size - 1
    wide = np.ptp(angle_deg) > 360.0 + 1.5 * step_deg  # else the column does not tell one turn of a cycle from another
    period_deg = 360.0 * (manifest.revs_per_cycle if wide else 1)
    first_deg, per_rev = float(angle_deg[0]), sampling.samples_per_rev or 0
    off_deg = (first_deg - sampling.start_deg + period_deg / 2.0) % period_deg - period_deg / 2.0
    if abs(per_rev * step_deg / 360.0 - 1.0) * steps > 0.5:  # half a sample by the end of the record
        key, stated, told = "samples_per_rev", float(per_rev), 360.0 / step_deg
    elif is_start and abs(off_deg) > 0.5 * step_deg:
        key, stated, told = "start_deg", sampling.start_deg, first_deg
    else:
        return
    problem = f"the manifest contradicts the file's column of crank angles {printable(name, 60)}"
    place, found, allowed = f"sampling.{key}", f"{stated:.9g}", f"{told:.6g}, as the column says"
    remedy = f"Find out which is right: mend {key}, or export the column with angles from top dead centre"
    raise InputError(problem, file=path, place=place, found=found, allowed=allowed, remedy=remedy)


class PulseFiles(NamedTuple):
    """Patterns of the recordings and of their pulse files, the recordings, and the column that holds the pulses."""

    recordings: str
    pulses: str
    group: list[tuple[Contents, Path]]
    source: str | int
    pulses_hz: float


def pulse_files(files: Sequence[tuple[Contents, Path]]) -> PulseFiles | None:
    """The recordings and pulse files that ``files`` (contents, path) are in pairs, None where they are not.

    Files of each kind have the same columns, and names that differ from the other kind's by a constant piece.
    """
    kinds: dict[tuple[str, ...], list[tuple[Contents, Path]]] = {}
    for contents, path in files:
        kinds.setdefault((contents.format, *contents.names), []).append((contents, path))
    for samples, events in itertools.permutations(kinds.values(), 2):
        patterns = _patterns([path.name for _, path in samples], [path.name for _, path in events])
        if patterns is None or (len(files) > 2 and "{run}" not in patterns[0]):
            continue
        column = _pulse_column(samples[0], events[0])
        if column is not None:
            return PulseFiles(*patterns, samples, *column)
    return None


def _patterns(*kinds: list[str]) -> tuple[str, str] | None:
    """Pattern of the names of each of two ``kinds`` of files, with the part that both share as ``{run}``."""
    ends, cores = [], []
    for names in kinds:
        stems = [Path(name).stem for name in names]
        head = _common_head(stems)
        tail = _common_head([stem[len(head) :][::-1] for stem in stems])[::-1]
        ends.append((head, tail))
        cores.append(sorted(stem[len(head) : len(stem) - len(tail)] for stem in stems))
    if cores[0] != cores[1]:
        return None
    # what stands the same in both beside the part that changes belongs to it
    left = _common_head([head[::-1] for head, _ in ends])[::-1].lstrip("_-. ")
    right = _common_head([tail for _, tail in ends]).rstrip("_-. ")
    part = "{run}" if left or right or cores[0] != [""] else ""
    first, second = (
        f"{head[: len(head) - len(left)]}{part}{tail[len(right) :]}{Path(names[0]).suffix}"
        for (head, tail), names in zip(ends, kinds, strict=True)
    )
    return first, second


def _common_head(names: list[str]) -> str:
    return os.path.commonprefix(names)  # noqa: RUF071 - of names, not of paths


def _pulse_column(samples: tuple[Contents, Path], events: tuple[Contents, Path]) -> tuple[str | int, float] | None:
    """Source of the times of pulses in the file of ``events``, and pulses per second; None where it holds no pulses."""
    settings = load_settings().ingest
    recorded, listed = (columns_of(path, contents, settings=settings) for contents, path in (samples, events))
    time = listed.of("time") or (listed.of("encoder") if len(listed.all) == 1 else None)
    clock, signals = recorded.of("time"), recorded.channels()
    if time is None or not signals or (clock is None and not samples[0].rates_hz):
        return None
    n_samples = max(signals[0].values.size, samples[0].samples.get(signals[0].name, 0))
    times, stamps = time.seconds, np.array([-np.inf, np.inf]) if clock is None else clock.seconds
    if not time.grows or not 2 < times.size < n_samples or times[-1] < stamps[0] or times[0] > stamps[-1]:
        return None
    if not all(_tells_pulses(column, times) for column in listed.all if column is not time):
        return None
    return time.source, float((times.size - 1) / np.ptp(times))


def _tells_pulses(column: Column, times: Floats) -> bool:
    """Whether a ``column`` beside ``times`` in s only counts pulses, or tells their period or speed."""
    step, values = np.diff(times), column.values
    if not values.size or ((values == np.rint(values)).all() and (np.diff(values) >= 0.0).all()):
        return values.size > 0
    if SPEED_NAME.search(column.label):
        rev_per_s = values[1:] * (column.unit or unit_of("rpm")).factor
        per_rev = max(1.0, float(np.rint(np.median(1.0 / np.maximum(rev_per_s * step, 1e-9)))))
        return bool(np.allclose(rev_per_s * step * per_rev, 1.0, rtol=0.1))
    return bool(np.allclose(column.seconds[1:], step, rtol=0.1))
