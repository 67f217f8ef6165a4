"""What tells the shaft in a file: pulse traces, lists of edges, positions or a speed, as pulse times of a recording."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.lib.stride_tricks import sliding_window_view

from crankorder.errors import InputError, located
from crankorder.ingest.channel import STATES_NO_UNIT
from crankorder.ingest.encoder_table import POSITION_KINDS, SOURCELESS_KINDS, TIME_KINDS, TRACE_KINDS, Encoder
from crankorder.ingest.manifest import Manifest
from crankorder.ingest.rawfile import FloatArray, RawFile, Source, flag, listed
from crankorder.ingest.sampling import ENCODER, TimeBase, TimeColumn, rows_before_zeros, seconds_of, zeros_flags
from crankorder.ingest.units import conversion_factor, known_unit, unit_in_label, unit_of
from crankorder.quantities import Attribute, Floats, QualityFlag, Severity
from crankorder.settings import MethodNumbers, ShaftSettings
from crankorder.shaft.pulses import NoPulsesError, Remark, find_pulses, position_pulses

NUMBERS = MethodNumbers("1-ingest-faults.toml", "direction")
# Pulse times that are told more finely than this are as good as those of a counter.
_FINE_STEP_S = 1e-6


@dataclass(frozen=True, slots=True)
class Gathered:
    """Attributes and variables by name of a Recording, which becomes a dataset when all are known."""

    attrs: dict[str, Attribute]
    variables: dict[str, xr.Variable] = field(default_factory=dict)

    def number(self, name: str, default: float = math.nan) -> float:
        """The attribute ``name`` as a number in its own unit; ``default`` where there is none."""
        return float(np.asarray(self.attrs.get(name, default)))

    @property
    def teeth(self) -> int:
        """Teeth of the wheel as stated, without those that are missing; 0 where nothing states them."""
        angles = np.size(self.attrs.get("tooth_angles_deg", ()))
        return angles or int(self.number("pulses_per_rev", 0) - self.number("missing_teeth", 0))

    def add(self, name: str, dims: str | tuple[str, ...], values: Any, units: str, long_name: str) -> None:
        """Add the variable ``name``: its ``values`` along ``dims``, their ``units`` and ``long_name``."""
        self.variables[name] = xr.Variable(dims, values, {"units": units, "long_name": long_name})


@dataclass(frozen=True, slots=True)
class ShaftSignals:
    """Columns ``raw`` of the file at ``path`` that tell the angle or speed of the shaft, by ``manifest``.

    ``settings`` are those of the shaft; ``bases`` are the time bases by role and ``base`` that of the channels, from
    whose first sample times count; ``times`` is the column of the samples' times, if any. Quality flags are appended to
    ``flags``.
    """

    raw: RawFile
    manifest: Manifest
    path: Path
    settings: ShaftSettings
    bases: Mapping[str, TimeBase]
    base: TimeBase
    times: TimeColumn | None
    flags: list[QualityFlag]

    @property
    def encoder(self) -> Encoder:
        """The table of the manifest that describes them."""
        return self.manifest.encoder

    def add_to(self, recording: Gathered) -> None:
        """Add the variables of the angle or speed of the shaft to ``recording``, and attributes on their kind.

        Raises InputError where a column cannot be what the manifest calls it, or no speed is known.
        """
        encoder, attrs = self.encoder, recording.attrs
        attrs["encoder_kind"] = encoder.kind
        self._add_stated_speed(recording)
        if encoder.expected_rpm is not None:
            attrs["expected_rpm"] = list(encoder.expected_rpm)
        if encoder.kind in SOURCELESS_KINDS:
            return
        attrs["ratio"] = encoder.ratio
        own = self.bases.get(ENCODER, self.base)
        if own != self.base:
            attrs["encoder_rate_hz"] = own.rate_hz
        if encoder.kind == "speed":
            axis, speed = "time", self._speed()
            if own != self.base:  # it holds for one of its steps beyond its ends
                axis, speed = "speed_sample", np.pad(speed, 1, mode="edge")
                attrs["encoder_start_s"] = own.start_s - 1.0 / own.rate_hz - self.base.start_s
            recording.add("speed_signal", axis, speed, "min-1", "speed")
            return
        attrs |= encoder.wheel
        if encoder.cam_to_tdc_deg is not None:
            attrs["cam_to_tdc_deg"] = encoder.cam_to_tdc_deg
        if "index_to_tdc_deg" in encoder.model_fields_set:  # unstated, the phase refers to the mark and says so
            attrs["index_to_tdc_deg"] = encoder.index_to_tdc_deg
        if encoder.kind in POSITION_KINDS:
            self._add_position(recording)
        else:
            per_rev = np.size(attrs.get("tooth_angles_deg", ())) or int(recording.number("pulses_per_rev", 1))
            self._add_pulses(recording, ENCODER, encoder.source, per_rev)
        if encoder.kind in TRACE_KINDS and encoder.source is not None:
            missing = np.isnan(self.raw.columns[encoder.source])
            if missing.any():
                gap_s = np.flatnonzero(missing[1:] & ~missing[:-1]) / own.rate_hz
                attrs["gap_starts_s"] = (gap_s + (own.start_s - self.base.start_s)).tolist()
        pulse_s = recording.variables["pulse_time"].values
        if encoder.second_track is not None:
            self._tell_direction(self.raw.columns[encoder.second_track], pulse_s)
        if encoder.file is not None and self.manifest.channels and pulse_s.size > 1:
            detail = (
                "times of pulses come from a file of their own, and no signal that both recorded compares its clock "
                "with that of the samples: each 10 ppm between them move the angle by what the shaft turns in "
                f"{1e-2 * float(pulse_s[-1] - pulse_s[0]):.2g} ms, by the end"
            )
            self._flag("clocks_not_compared", "info", detail)
        for role, source, silent in (("the index", encoder.index, "no_index"), ("the cam mark", encoder.cam, "no_cam")):
            if source is not None:
                try:
                    self._add_pulses(recording, role, source, 1)
                except NoPulsesError as error:
                    self._flag(silent, "suspect", f"{source}: {role} has no mark: {error.found}")
                    _add_times(recording, role, np.empty(0))

    def _flag(self, name: str, severity: Severity, detail: str) -> None:
        self.flags.append(flag(self.path, name, severity, detail))

    def _tell_direction(self, levels: FloatArray, pulse_s: Floats) -> None:
        """Flag what the second track says of the direction; nothing where the shaft turns forwards.

        Forwards the first track leads by a quarter of a pulse: the second, ``levels`` (sample,), is still low where the
        first rises, at ``pulse_s`` (pulse,), and still high where it falls.
        """
        track = self.bases["the second track"]
        low, high = float(np.nanmin(levels)), float(np.nanmax(levels))
        at = np.floor((pulse_s + (self.base.start_s - track.start_s)) * track.rate_hz).astype(np.int64)
        at = at[(at >= 0) & (at < levels.size)]
        if at.size < NUMBERS.fewest_pulses or not high > low:
            why = "it is constant" if at.size else "no pulses"
            self._flag("direction_unknown", "info", f"the second track says nothing of the direction: {why}")
            return
        backwards = (levels[at] > 0.5 * (low + high)) != (self.encoder.edge == "falling")
        share = float(np.mean(backwards))
        leads = f"the second track leads at {share:.1%} of the pulses"
        if share >= NUMBERS.sure_share:
            why = "the shaft turns backwards, or the two tracks are swapped; the angle is counted up all the same, so"
            self._flag("turns_backwards", "suspect", f"{leads}: {why} phases are those of the other direction")
        elif share > 1.0 - NUMBERS.sure_share:
            first = int(np.flatnonzero(np.diff(backwards))[0]) + 1
            why = "the shaft changes its direction, or too few samples lie between the pulses to tell"
            self._flag("direction_changes", "suspect", f"{leads}, first another way at pulse {first}: {why}")

    def _add_stated_speed(self, recording: Gathered) -> None:
        """Note the speed that the manifest, or a number in the file, states; a shaft of constant speed needs one."""
        encoder, stated_rpm = self.encoder, self.manifest.speed_of(self.path)
        if encoder.kind == "constant" and encoder.source is not None and stated_rpm is None:
            speed = self._speed()
            if speed.size != 1 or not speed[0] > 0.0:
                problem, place = "a constant speed is one number above 0", f"encoder {encoder.source}"
                found = f"{speed.size} values" if speed.size != 1 else f"{speed[0]:g}"
                remedy = 'Mend encoder.source, or state kind = "speed" for a signal'
                raise InputError(problem, file=self.path, place=place, found=found, remedy=remedy)
            stated_rpm = float(speed[0])
        if encoder.kind == "constant" and stated_rpm is None:
            problem, place = "the manifest states no speed for this recording", "recordings.speed_rpm"
            allowed, remedy = ", ".join(self.manifest.recordings.speed_rpm), "Add the file and its speed in rpm"
            raise InputError(problem, file=self.path, place=place, allowed=allowed, remedy=remedy)
        if stated_rpm is not None or encoder.kind in SOURCELESS_KINDS:
            recording.attrs["speed_rpm"] = math.nan if stated_rpm is None else stated_rpm

    def _add_position(self, recording: Gathered) -> None:
        """Add pulses and whole turns of an angle or a count, and how many pulses a turn has."""
        encoder, own = self.encoder, self.bases[ENCODER]
        assert encoder.source is not None  # the manifest was checked for it
        unit = known_unit(self.raw.units.get(encoder.source) or unit_in_label(str(encoder.source)))
        stated = [math.tau / unit.factor] if unit is not None and unit.quantity == "angle" else [360.0, math.tau, 1.0]
        per_rev = stated if encoder.pulses_per_rev is None else [float(encoder.pulses_per_rev)]
        with located(self.path, f"encoder {encoder.source}"):
            column, counted = self.raw.columns[encoder.source], encoder.kind == "count"
            position = position_pulses(column, rate_hz=own.rate_hz, units_per_rev=per_rev, counted=counted)
        self._flag_remarks(encoder.source, position.pulses.flags)
        attrs = recording.attrs
        attrs["pulses_per_rev"], attrs["pulse_noise_s"] = position.pulses_per_rev, position.pulses.noise_s
        if encoder.index is None:
            attrs["zero_counted"] = int(not (position.is_mark or "index_to_tdc_deg" in attrs))
            _add_times(recording, "the index", self._in_time(position.turn_s, own))
        if encoder.cam is None and position.cycle_s is not None and attrs["revs_per_cycle"] == 2:
            _add_times(recording, "the cam mark", self._in_time(position.cycle_s, own))
        _add_times(recording, ENCODER, self._in_time(position.pulses.time_s, own))

    def _add_pulses(self, recording: Gathered, role: str, source: Source | None, per_rev: int) -> None:
        """Add the pulses of the column ``source``, which are ``per_rev`` to the turn of the wheel."""
        assert source is not None  # the manifest was checked for it
        if self.encoder.kind in TIME_KINDS:
            pulse_s, noise_s = self._listed_pulses(source)
        else:
            with located(self.path, f"encoder {source}"):
                pulses = find_pulses(
                    self.raw.columns[source],
                    rate_hz=self.bases[role].rate_hz,
                    kind="square" if self.encoder.kind == "square" else "analogue",
                    edge=self.encoder.edge,
                    pulses_per_rev=per_rev,
                    settings=self.settings,
                )
            self._flag_remarks(source, pulses.flags)
            pulse_s, noise_s = self._in_time(pulses.time_s, self.bases[role]), pulses.noise_s
        _add_times(recording, role, pulse_s)
        if role == ENCODER:
            recording.attrs["pulse_noise_s"] = noise_s

    def _flag_remarks(self, source: Source, remarks: Sequence[Remark]) -> None:
        for name, severity, detail in remarks:
            self._flag(name, severity, f"{source}: {detail}")

    def _in_time(self, pulse_s: Floats, trace: TimeBase) -> Floats:
        """Pulse times [s] from the first sample of the channels, of those from the first of their ``trace``."""
        if self.times is not None:
            pulse_s = self.times.places_in_time(pulse_s * trace.rate_hz) / trace.rate_hz
        return pulse_s + (trace.start_s - self.base.start_s)

    def _listed_pulses(self, source: Source) -> tuple[Floats, float]:
        """Pulse times [s] that the file lists, and their noise; of levels only the edges of the wanted direction."""
        encoder, manifest = self.encoder, self.manifest
        time_source = manifest.sampling.time_source if encoder.file is None else encoder.time_source
        timed = time_source if encoder.kind == "edge_list" and time_source is not None else source
        with_levels = timed != source
        stamps = seconds_of(self.raw, timed)
        level = self.raw.columns[source] if with_levels else np.ones(stamps.size)
        n_rows = rows_before_zeros(stamps)
        self.flags.extend(zeros_flags(stamps, n_rows, self.path))
        stamps, level = stamps[:n_rows], level[:n_rows]
        wrong = ~(np.isfinite(stamps) & np.isfinite(level)) | (np.diff(stamps, prepend=stamps[:1]) < 0.0)
        if wrong.any():
            row = int(np.argmax(wrong))
            file, place = manifest.pulses_of(self.path) or self.path, f"encoder {source}, row {row + 1} of {wrong.size}"
            found = f"{stamps[row]:.9g} s" + (f", level {level[row]:g}" if with_levels else "")
            problem = "pulse times must be finite and must not go back"
            remedy = "Mend the list of times, or take the row out"
            raise InputError(problem, file=file, place=place, found=found, remedy=remedy)
        if with_levels:
            high = level > 0.5 * (float(level.min()) + float(level.max()))
            turned = high[1:] & ~high[:-1] if encoder.edge == "rising" else ~high[1:] & high[:-1]
            stamps = stamps[1:][turned]
        times = stamps.astype(np.float64) + encoder.offset_s
        if times.size < 2:
            self._flag("few_pulses", "bad", f"{source}: {times.size} pulses")
        if stamps.dtype != np.float32 or times.size == 0:
            return times - self.base.start_s, 0.0
        step_s = float(np.spacing(np.float32(np.abs(times).max())))
        detail = f"{source}: times in float32 tell no more than {step_s:.2g} s: keep them in float64"
        self._flag("pulse_times_single_precision", "suspect" if step_s > _FINE_STEP_S else "info", detail)
        return times - self.base.start_s, step_s / math.sqrt(12.0)

    def _speed(self) -> Floats:
        """Speed in rpm, from the unit that the file states, else taken as rpm."""
        encoder = self.encoder
        assert encoder.source is not None  # the manifest was checked for it
        speed = self.raw.columns[encoder.source].astype(np.float64)
        text = self.raw.units.get(encoder.source, "")
        unit = known_unit(text)
        if unit is not None and unit.quantity == "rotational speed":
            speed *= conversion_factor(unit, unit_of("rpm"))
        elif text not in STATES_NO_UNIT:
            problem, place = "the speed signal has no unit of speed", f"encoder {encoder.source}"
            allowed, remedy = "rpm, 1/min, Hz, rad/s", "Mend encoder.source"
            raise InputError(problem, file=self.path, place=place, found=repr(text), allowed=allowed, remedy=remedy)
        if self.times is not None and self.times.places is not None:  # through gaps of the record it goes on straight
            missing = np.delete(np.arange(speed.size), self.times.places)
            speed[missing] = np.interp(missing, self.times.places, speed[self.times.places])
        if not np.isfinite(speed).all():
            problem, place = "the speed signal has missing samples", f"sample {int(np.argmin(np.isfinite(speed)))}"
            raise InputError(problem, file=self.path, place=place, remedy="Leave the recording out")
        return speed


def _add_times(recording: Gathered, role: str, time_s: Floats) -> None:
    """Add times [s] at which pulses, the index or the cam mark pass, as ``role`` says."""
    name, axis, long_name = _TIMES[role]
    recording.add(name, axis, time_s, "s", f"time of {long_name}")


_TIMES = {
    ENCODER: ("pulse_time", "pulse", "encoder pulse"),
    "the index": ("index_time", "revolution", "index"),
    "the cam mark": ("cam_time", "cycle", "cam mark"),
}


# Buffers of an analyser that were written one behind the other, turns between them lost, are found and laid apart. The
# shaft and the channels must both tell it: one turn is too short or too long among others that are alike, by no whole
# turn as a lost or false pulse would have it, and at one sample of it the channels change from what they did a turn
# before to what they do a turn later.

BESIDE = 4
"""Turns on either side that tell how long one should be."""

ODD_SIGMAS, ODD_SAMPLES = 8.0, 2.5
"""A turn is odd beyond so many standard deviations of its neighbours, and so many samples: edges are rounded to one."""

MOST_ODD = 2
"""Odd turns in a row: the level may jump at a break too, and look like a pulse."""

LEAST_GAIN, MOST_LEFT, NOISE_LEFT = 2.0, 0.05, 0.1
"""A break explains, in half of the channels, so many times what differs between other turns; it leaves no more than
this share of that, and what chance does. A shaft that speeds up or slows down leaves a fifth."""

EDGE_SAMPLES = 1.5
"""A pulse so near to a break is none of the wheel's."""

LISTED = 5
"""Breaks that are named one by one."""


class Break(NamedTuple):
    """Break of a recording: ``sample`` is the first one behind it.

    ``turn`` and ``usual`` are the samples of the turn across it, which may be two, and of a usual turn.
    """

    sample: int
    turn: float
    usual: float

    @property
    def missing(self) -> int:
        """Number of samples that are missing in the turn across the break."""
        return round(-self.turn % self.usual)


def find_breaks(turns: Floats, channels: Sequence[FloatArray]) -> list[Break]:
    """Breaks of a recording, in order.

    Parameters
    ----------
    turns : (marks,), samples, rising places at which a mark of the shaft passes once per revolution
    channels : signals, each (samples,), in any unit; missing samples are NaN
    """
    step = np.diff(turns)
    if step.size <= 2 * BESIDE:
        return []
    usual = np.median(sliding_window_view(np.pad(step, BESIDE, mode="symmetric"), 2 * BESIDE + 1), axis=1)
    off = np.abs(step - usual)
    slack = max(ODD_SAMPLES, ODD_SIGMAS * 1.4826 * float(np.median(off)))
    odd = np.flatnonzero(off > slack)
    breaks: list[Break] = []
    for group in np.split(odd, np.flatnonzero(np.diff(odd) > 1) + 1) if odd.size else []:
        first, last = int(group[0]), int(group[-1]) + 1
        if not 1 < first < last < step.size - 1:
            continue
        # two turns: half orders repeat after no less
        before, after = float(turns[first] - turns[first - 2]), float(turns[last + 2] - turns[last])
        length, turn = float(turns[last] - turns[first]), 0.25 * (before + after)
        rest = length % turn
        # two turns and more are no break of a shaft that runs on: it stood still
        if group.size > MOST_ODD or length >= 2.0 * turn or min(rest, turn - rest) <= slack:
            continue
        sample = _jump(channels, round(turns[first]), round(turns[last]), round(before), round(after))
        if sample:
            breaks.append(Break(sample, length, turn))
    return breaks


def _jump(channels: Sequence[FloatArray], first: int, last: int, ahead: int, behind: int) -> int:
    """The sample, after ``first`` up to ``last``, at which all ``channels`` jump in phase; 0 where they do not.

    Two turns before and after it are ``ahead`` and ``behind`` samples long.
    """
    low, high, turn = first - ahead, last + behind, 0.5 * (ahead + behind)
    if low < ahead or high + behind > channels[0].size:
        return 0
    costs, jumps = [], np.zeros(high - low)
    for channel in channels:
        here, *others = (channel[low + lag : high + lag].astype(np.float64) for lag in (0, -ahead, behind))
        before, after = (np.nan_to_num(here - other) ** 2 for other in others)
        noise = 0.5 * float(before[:ahead].mean() + after[-behind:].mean())
        if noise > 0.0:
            # by the place of a break: what is before it repeats the turns before, what is behind those after
            cost = np.append(0.0, np.cumsum(before)) + after.sum() - np.append(0.0, np.cumsum(after))
            costs.append(cost / noise)
            jumps[1:] += np.nan_to_num(np.diff(here)) ** 2 / noise
    if not costs:
        return 0
    total = np.sum(costs, axis=0)[ahead:-behind]
    likely = np.flatnonzero(total < total.min() + jumps.max())
    best = ahead + int(likely[np.argmax(jumps[ahead + likely])])
    gain = np.array([min(cost[0], cost[-1]) - cost[best] for cost in costs]) / turn
    left = np.array([cost[best] - (high - low) for cost in costs]) / turn
    if np.sort(gain)[(gain.size - 1) // 2] < LEAST_GAIN or left.sum() > MOST_LEFT * gain.sum() + NOISE_LEFT:
        return 0
    return low + best


def laid_apart(recording: Gathered, channels: dict[str, FloatArray], path: Path, flags: list[QualityFlag]) -> None:
    """Insert the gaps between buffers that were written without them, in ``channels`` and the pulses of ``recording``.

    Where the pulses do not tell a revolution the angle is lost across a break: only the longest stretch is kept.
    ``channels``, (samples,) by name, are those of the file at ``path`` and are changed in place; quality flags are
    appended to ``flags``.
    """
    rate_hz, teeth = recording.number("rate_hz"), recording.teeth
    variables = recording.variables
    marked = "index_time" in variables and variables["index_time"].size > 1
    turns = variables["index_time"].values if marked else variables["pulse_time"].values[:: teeth or None]
    breaks = find_breaks(turns * rate_hz, list(channels.values())) if marked or teeth else []
    if not breaks:
        return
    n_samples, at = next(iter(channels.values())).size, np.array([gap.sample for gap in breaks])
    lost = np.zeros(n_samples, dtype=np.int64)
    lost[at] = [gap.missing for gap in breaks]
    places = np.arange(n_samples) + np.cumsum(lost)
    total = int(places[-1]) + 1
    first, end = 0, total
    words = [
        f"sample {gap.sample} ({gap.sample / rate_hz:.6g} s: {gap.turn:.0f} samples where a turn has {gap.usual:.0f})"
        for gap in breaks
    ]
    shown = listed(words, LISTED, counted=True)
    detail = f"samples are missing before {shown}: the channels jump there too, as between two buffers"
    if marked or teeth == 1:
        detail += f"; {total - n_samples} samples are put in to make these turns whole; what touches them is left out"
    else:
        longest = max(pairwise([0, *at.tolist(), n_samples]), key=lambda ends: ends[1] - ends[0])
        (first, end), places = longest, np.arange(n_samples)
        detail += f"; the pulses do not tell the angle across: samples {first} to {end - 1} are used alone"
    flags.append(flag(path, "buffers_joined", "suspect", detail))
    for name, column in channels.items():
        gridded = np.full(max(total, end), np.nan, dtype=column.dtype)
        gridded[places] = column
        channels[name] = gridded[first:end]
    moved = places - np.arange(n_samples) - first
    for name in ("pulse_time", "index_time", "cam_time"):
        if name in variables:
            place = variables[name].values * rate_hz
            place = place[(np.abs(place[:, None] - at) > EDGE_SAMPLES).all(axis=1)]
            place = place + moved[np.clip(np.ceil(place).astype(int), 0, n_samples - 1)]
            inside = (place >= 0) & (place <= end - first - 1)
            variables[name] = xr.Variable(variables[name].dims, place[inside] / rate_hz, variables[name].attrs)
    gaps = np.append(np.round(np.asarray(recording.attrs.get("gap_starts_s", ())) * rate_hz).astype(int), at - 1)
    recording.attrs["gap_starts_s"] = sorted(((gaps + moved[gaps]) / rate_hz).tolist())
