"""What tells the shaft in a file: pulse traces, lists of edges, positions or a speed, as pulse times of a recording."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from crankorder.errors import InputError, located
from crankorder.ingest.channel import STATES_NO_UNIT
from crankorder.ingest.encoder_table import POSITION_KINDS, SOURCELESS_KINDS, TIME_KINDS, TRACE_KINDS, Encoder
from crankorder.ingest.manifest import Manifest
from crankorder.ingest.rawfile import RawFile, Source, flag
from crankorder.ingest.record_faults import direction_flags
from crankorder.ingest.sampling import TimeColumn, rows_before_zeros, seconds_of, zeros_flag
from crankorder.ingest.time_bases import ENCODER, TimeBase
from crankorder.ingest.units import conversion_factor, known_unit, unit_in_label, unit_of
from crankorder.quantities import Floats, QualityFlag, Severity
from crankorder.settings import ShaftSettings
from crankorder.shaft.position import position_pulses
from crankorder.shaft.pulses import NoPulsesError, Remark, find_pulses

# Pulse times that are told more finely than this are as good as those of a counter.
_FINE_STEP_S = 1e-6


@dataclass(frozen=True, slots=True)
class Gathered:
    """What becomes a Recording: its attributes and its variables by name, made a dataset when all are known."""

    attrs: dict[str, Any]
    variables: dict[str, xr.Variable] = field(default_factory=dict)

    def add(self, name: str, dims: str | tuple[str, ...], values: Any, units: str, long_name: str) -> None:
        """Add the variable ``name``: its ``values`` along ``dims``, their ``units`` and ``long_name``."""
        self.variables[name] = xr.Variable(dims, values, {"units": units, "long_name": long_name})


@dataclass(frozen=True, slots=True)
class ShaftSignals:
    """Columns ``raw`` of the file at ``path`` that tell the shaft as ``manifest`` and ``settings`` say.

    ``bases`` are the time bases by role and ``base`` that of the channels, from whose first sample times count;
    ``times`` is the column of the samples' times, if any. ``flags`` take what was seen.
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
        """Add what tells the angle or the speed of the shaft to ``recording``, and how it was told.

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
            per_rev = len(attrs.get("tooth_angles_deg", [])) or attrs.get("pulses_per_rev", 1)
            self._add_pulses(recording, ENCODER, encoder.source, per_rev)
        if encoder.kind in TRACE_KINDS and encoder.source is not None:
            missing = np.isnan(self.raw.columns[encoder.source])
            if missing.any():
                gap_s = np.flatnonzero(missing[1:] & ~missing[:-1]) / own.rate_hz
                recording.attrs["gap_starts_s"] = (gap_s + (own.start_s - self.base.start_s)).tolist()
        pulse_s = recording.variables["pulse_time"].values
        if encoder.second_track is not None:
            track, levels = self.bases["the second track"], self.raw.columns[encoder.second_track]
            at = (pulse_s + (self.base.start_s - track.start_s)) * track.rate_hz
            self.flags.extend(direction_flags(levels, at, self.path, falling=encoder.edge == "falling"))
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

    def _add_stated_speed(self, recording: Gathered) -> None:
        """Note the speed that the manifest, or a number in the file, states; a shaft of constant speed needs one."""
        encoder, stated_rpm = self.encoder, self.manifest.speed_of(self.path)
        if encoder.kind == "constant" and encoder.source is not None and stated_rpm is None:
            speed = self._speed()
            if speed.size != 1 or not speed[0] > 0.0:
                raise InputError(
                    "a constant speed is one number above 0",
                    file=self.path,
                    place=f"encoder {encoder.source}",
                    found=f"{speed.size} values" if speed.size != 1 else f"{speed[0]:g}",
                    remedy='Mend encoder.source, or state kind = "speed" for a signal',
                )
            stated_rpm = float(speed[0])
        if encoder.kind == "constant" and stated_rpm is None:
            raise InputError(
                "the manifest states no speed for this recording",
                file=self.path,
                place="recordings.speed_rpm",
                allowed=", ".join(self.manifest.recordings.speed_rpm),
                remedy="Add the file and its speed in rpm",
            )
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
        timed = source if encoder.kind != "edge_list" or time_source is None else time_source
        with_levels = timed != source
        stamps = seconds_of(self.raw, timed)
        level = self.raw.columns[source] if with_levels else np.ones(stamps.size)
        n_rows = rows_before_zeros(stamps)
        if n_rows < stamps.size:
            self.flags.append(zeros_flag(stamps.size - n_rows, self.path))
        stamps, level = stamps[:n_rows], level[:n_rows]
        wrong = ~(np.isfinite(stamps) & np.isfinite(level)) | (np.diff(stamps, prepend=stamps[:1]) < 0.0)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                "pulse times must be finite and must not go back",
                file=manifest.pulses_of(self.path) or self.path,
                place=f"encoder {source}, row {row + 1} of {wrong.size}",
                found=f"{stamps[row]:.9g} s, level {level[row]:g}" if with_levels else f"{stamps[row]:.9g} s",
                remedy="Mend the list of times, or take the row out",
            )
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
        how: Severity = "suspect" if step_s > _FINE_STEP_S else "info"
        self._flag("pulse_times_single_precision", how, detail)
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
            raise InputError(
                "the speed signal has no unit of speed",
                file=self.path,
                place=f"encoder {encoder.source}",
                found=repr(text),
                allowed="rpm, 1/min, Hz, rad/s",
                remedy="Mend encoder.source",
            )
        if self.times is not None and self.times.places is not None:  # through gaps of the record it goes on straight
            missing = np.delete(np.arange(speed.size), self.times.places)
            speed[missing] = np.interp(missing, self.times.places, speed[self.times.places])
        if not np.isfinite(speed).all():
            raise InputError(
                "the speed signal has missing samples",
                file=self.path,
                place=f"sample {int(np.argmin(np.isfinite(speed)))}",
                remedy="Leave the recording out",
            )
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
