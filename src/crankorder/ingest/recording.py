"""One file becomes one Recording: signals in their analysed units, pulse times, one time axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr

from crankorder.errors import InputError
from crankorder.fft.transforms import faded_samples, integrated
from crankorder.ingest.channel import STATES_NO_UNIT, Channel, Scaling, check_bands, file_to_analysed
from crankorder.ingest.encoder_table import SOURCELESS_KINDS, TIME_KINDS, TRACE_KINDS
from crankorder.ingest.folder import check_regular
from crankorder.ingest.formats import contents_of, format_of, read_file
from crankorder.ingest.manifest import Manifest
from crankorder.ingest.rawfile import FloatArray, RawFile, Source, flag, looks_counted, named, stacked
from crankorder.ingest.record_faults import MAY_HAVE_LEVELS, Sampled, judged
from crankorder.ingest.roles import read_checked
from crankorder.ingest.sampling import (
    ENCODER,
    TimeColumn,
    agreed_rate,
    bases_of,
    on_one_base,
    read_time_column,
    seconds_of,
)
from crankorder.ingest.shaft_signals import Gathered, ShaftSignals, laid_apart
from crankorder.ingest.signal_faults import mend_signal
from crankorder.quantities import Attribute, QualityFlag, Recording, Severity, with_flags
from crankorder.settings import IngestSettings, ShaftSettings

# A rate in doubt by more than this moves frequencies further than their own errors.
_ROUGH_RATE = 1e-4


def read_recording(path: Path, manifest: Manifest, *, settings: IngestSettings, shaft: ShaftSettings) -> xr.Dataset:
    """The Recording (channel, time or crank_angle) in the file at ``path``, as ``manifest`` describes it.

    Its variables are those of ``data_schema/recording.json``. ``settings`` limit what is read and say what is a fault
    of a signal; ``shaft`` says how a trace becomes pulses. Raises InputError where the file is damaged, lacks a
    channel, contradicts the manifest, or has samples missing; what can be mended is mended and flagged in
    ``attrs["quality"]``.
    """
    pulses = manifest.pulses_of(path)
    if pulses is None:
        raw = read_checked(path, manifest, sources=_wanted(manifest), settings=settings)
        return recording_of(raw, path, manifest, settings=settings, shaft=shaft)
    check_regular(pulses, path.parent)
    listed = read_file(pulses, sources=_wanted(manifest, of_samples=False), settings=settings)
    raw = read_checked(path, manifest, sources=_wanted(manifest, of_shaft=False), settings=settings)
    return recording_of(raw, path, manifest, settings=settings, shaft=shaft, listed=listed)


def read_parts(
    path: Path, manifest: Manifest, *, settings: IngestSettings, shaft: ShaftSettings, most_bytes: int
) -> tuple[list[xr.Dataset], float]:
    """Head, middle and tail of the recording at ``path``, each a Recording, and their share of its samples, 0 to 1.

    The result is one Recording of all samples, and 1, where these take less than ``most_bytes``, or where a part of the
    file cannot be read by itself. ``manifest``, ``settings`` and ``shaft``, and the errors raised, are those of
    :func:`read_recording`.
    """
    n_samples, sources = 0, _wanted(manifest)
    if manifest.encoder.kind not in TIME_KINDS and format_of(path).by_rows:
        contents = contents_of(path, settings=settings)
        names = [named(source, contents.names, path) for source in sources]
        if len({contents.rates_hz.get(name) for name in names}) < 2:  # rows of several rates are of several times
            n_samples = max((contents.samples[name] for name in names), default=0)
    most = max(1, most_bytes // (8 * max(1, len(sources))))
    if n_samples <= most:
        return [read_recording(path, manifest, settings=settings, shaft=shaft)], 1.0
    third = most // 3
    parts: list[xr.Dataset] = []
    for first in (0, (n_samples - third) // 2, n_samples - third):
        raw = read_checked(path, manifest, sources=sources, settings=settings, rows=slice(first, first + third))
        parts.append(recording_of(raw, path, manifest, settings=settings, shaft=shaft))
    return parts, 3 * third / n_samples


def recording_of(
    raw: RawFile,
    path: Path,
    manifest: Manifest,
    *,
    settings: IngestSettings,
    shaft: ShaftSettings,
    listed: RawFile | None = None,
) -> Recording:
    """The Recording of the columns of ``raw``, called ``path``, as :func:`read_recording` makes it of a file.

    ``manifest``, ``settings`` and ``shaft``, and the errors raised, are those of :func:`read_recording`; columns are
    changed in place. ``listed`` holds the columns of the file of the pulses, where they have one of their own.
    """
    flags = [*raw.flags, *(listed.flags if listed is not None else ())]
    of = _File(path, manifest, settings, flags)
    times = of.times(raw)
    raw = raw if times is None else _on_grid(raw, times, manifest)
    samples, n_channels = {source: row.size for source, row in raw.columns.items()}, len(manifest.channels)
    timed = raw if manifest.sampling.domain == "time" else RawFile(raw.columns)
    bases, file_hz = bases_of(manifest.sampled, samples, timed, n_channels, tolerance=settings.rate_tolerance)
    recording = of.axis(raw, file_hz, times)
    rate_hz = recording.number("rate_hz")
    check_bands(manifest.limits, rate_hz, path)
    channels = {channel.name: raw.columns[channel.file_source] for channel in manifest.channels}
    if math.isfinite(rate_hz):
        common_hz = file_hz or 1.0
        agreed = {role: base._replace(rate_hz=rate_hz) for role, base in bases.items() if base.rate_hz == common_hz}
        bases = {**bases, **agreed}
    base, base_flags = on_one_base(channels, bases, path, settings=settings)
    flags += base_flags
    ShaftSignals(listed or raw, manifest, path, shaft, bases, base, times, flags).add_to(recording)
    has_stretches = times is not None and times.offsets.any()
    if channels and manifest.encoder.kind in TRACE_KINDS and bases[ENCODER] == base and not has_stretches:
        laid_apart(recording, channels, path, flags)
    if manifest.of_shaft_alone:
        source = manifest.encoder.source
        # the samples of the encoder's trace; of listed times there are none
        n_samples = raw.columns[source].size if manifest.has_samples and source is not None else 0
        return _with_signals(recording, np.empty((0, n_samples), dtype=np.float32), manifest, flags)
    signals = stacked(list(channels.values()))
    faults, scalings = [], list[Scaling]()
    for channel, row in zip(manifest.channels, signals, strict=True):
        faults.append(mend_signal(row, settings=settings))  # sentinels: in the file's own unit
        if times is not None:
            times.align(row)
        scalings.append(of.to_analysed_unit(row, channel, raw.units.get(channel.file_source, "")))
    flags += judged(signals, faults, _sampled(recording, manifest, scalings), path, settings=settings)
    for number, (row, scaling) in enumerate(zip(signals, scalings, strict=True)):
        of.integrate(row, number, scaling, recording)
    return _with_signals(recording, signals, manifest, flags)


def _on_grid(raw: RawFile, times: TimeColumn, manifest: Manifest) -> RawFile:
    """``raw`` with the columns that its ``times`` are of on their uniform grid, and starts on their clock."""
    source = manifest.sampling.time_source
    assert source is not None  # the column that the times are of
    n_rows, first_s = raw.columns[source].size, raw.starts_s.get(source)
    on_grid = {source: times.on_grid(row) for source, row in raw.columns.items() if row.size == n_rows}
    own = {source: start for source, start in raw.starts_s.items() if first_s is not None or source not in on_grid}
    lag_s = 0.0 if first_s is None else times.start_s - first_s
    starts_s = dict.fromkeys(raw.columns, times.start_s) | {source: at + lag_s for source, at in own.items()}
    return replace(raw, columns={**raw.columns, **on_grid}, starts_s=starts_s)


def _sampled(recording: Gathered, manifest: Manifest, scalings: Sequence[Scaling]) -> Sampled:
    """How the signals of ``recording`` were sampled, and at which speed, for a look at their faults."""
    by_angle = manifest.sampling.domain == "crank_angle"
    scaled = zip(manifest.channels, scalings, strict=True)
    return Sampled(
        names=[channel.name for channel in manifest.channels],
        quantities=[at.unit.quantity if at.integrals else channel.measured_quantity for channel, at in scaled],
        units=[scaling.unit.name for scaling in scalings],
        rate=recording.number("samples_per_rev" if by_angle else "rate_hz"),
        start=recording.number("start_deg") / 360.0 if by_angle else recording.number("start_s", 0.0),
        unit="rev" if by_angle else "s",
        rate_hz=math.nan if by_angle else recording.number("rate_hz"),
        shaft_hz=_mean_speed_hz(recording),
    )


def _mean_speed_hz(recording: Gathered) -> float:
    """Mean speed of the shaft as the pulses or the manifest tell it, 0 without a shaft, NaN where unknown."""
    if not recording.number("has_shaft", 1):
        return 0.0
    if "speed_rpm" in recording.attrs:
        return recording.number("speed_rpm") / 60.0
    if "speed_signal" in recording.variables:
        return float(np.mean(recording.variables["speed_signal"].values)) / 60.0
    times = recording.variables["pulse_time"].values if "pulse_time" in recording.variables else np.empty(0)
    if times.size < 2 or not recording.teeth > 0:
        return math.nan
    return float((times.size - 1) / (times[-1] - times[0]) / recording.teeth / recording.number("ratio", 1.0))


def _wanted(manifest: Manifest, *, of_samples: bool = True, of_shaft: bool = True) -> list[Source]:
    """Sources to read, each once: channels first, so that they are neighbours in memory, and the times last.

    ``of_samples``: those of the channels and of their times; ``of_shaft``: those of the encoder and its marks, and of
    its times where it is a file of its own.
    """
    encoder, sampling = manifest.encoder, manifest.sampling
    sources: list[Source | None] = [channel.file_source for channel in manifest.channels] if of_samples else []
    if of_shaft and encoder.kind not in SOURCELESS_KINDS:
        sources += [encoder.source, encoder.second_track, encoder.index, encoder.cam]
    elif of_shaft and encoder.kind == "constant":
        sources.append(encoder.source)
    if of_shaft and encoder.file is not None:
        sources.append(encoder.time_source)
    if of_samples and sampling.domain == "time":
        sources.append(sampling.time_source)
    return list(dict.fromkeys(source for source in sources if source is not None))


@dataclass(frozen=True, slots=True)
class _File:
    """The file at ``path`` that becomes a Recording by ``manifest`` and ``settings``; ``flags`` take what is seen."""

    path: Path
    manifest: Manifest
    settings: IngestSettings
    flags: list[QualityFlag]

    def flag(self, name: str, severity: Severity, detail: str) -> None:
        self.flags.append(flag(self.path, name, severity, detail))

    def times(self, raw: RawFile) -> TimeColumn | None:
        """What the column of the samples' times says, None where there is none."""
        sampling, encoder = self.manifest.sampling, self.manifest.encoder
        # the times of an edge list are those of its edges, unless it is a file of its own
        of_edges = encoder.kind == "edge_list" and encoder.file is None
        by_angle = sampling.domain == "crank_angle"
        if sampling.time_source is None or by_angle or of_edges or not self.manifest.has_samples:
            return None
        return read_time_column(seconds_of(raw, sampling.time_source), self.path, settings=self.settings)

    def axis(self, raw: RawFile, file_hz: float | None, times: TimeColumn | None) -> Gathered:
        """A recording with the attributes of the sampling alone, ``rate_hz`` among them where it has one.

        Flags say where the file contradicts itself on its rate, or states it to a few decimals and nothing else tells.
        """
        sampling, manifest = self.manifest.sampling, self.manifest
        attrs: dict[str, Attribute] = {"recording": manifest.name_of(self.path), "domain": sampling.domain}
        attrs["revs_per_cycle"] = manifest.revs_per_cycle
        if manifest.test.cycle == "none":
            attrs["has_shaft"] = 0
        if sampling.domain == "crank_angle":
            assert sampling.samples_per_rev is not None  # the manifest states it of this domain
            attrs |= {"samples_per_rev": sampling.samples_per_rev, "start_deg": sampling.start_deg}
        if sampling.domain == "crank_angle" or not manifest.has_samples:
            return Gathered(attrs)
        doubt = raw.rate_uncertainty
        rates = {"manifest": (sampling.rate_hz, 0.0), "file": (file_hz, doubt)}
        if times is not None:
            self.flags.extend(times.flags)
            rates["time column"] = (times.rate_hz, times.rate_uncertainty)
        attrs["rate_hz"] = agreed_rate(rates, self.path, settings=self.settings)
        stated, header_hz = sampling.rate_hz is not None, raw.attrs.get("header_rate_hz")
        if header_hz is not None and file_hz is not None:
            detail = f"the header states {header_hz:.6g} Hz, the times in the file say {file_hz:.6g} Hz, which are used"
            # what the manifest states agrees with the times
            self.flag("header_rate_disagrees", "info" if stated else "suspect", detail)
        if doubt > self.settings.rate_tolerance and not stated and times is None:
            detail = f"the file states its time step to {doubt:.1g} of itself: state rate_hz for right frequencies"
            self.flag("rate_rounded", "suspect" if doubt > _ROUGH_RATE else "info", detail)
        return Gathered(attrs)

    def to_analysed_unit(self, signal: FloatArray, channel: Channel, file_unit: str) -> Scaling:
        """Turn ``signal`` in place from the file's unit into the channel's, or to what it is to be integrated from."""
        scaling = file_to_analysed(channel, file_unit, self.path)
        stated = channel.sensitivity is not None or channel.offset is not None or file_unit not in STATES_NO_UNIT
        if not stated and channel.analysed_unit.quantity not in MAY_HAVE_LEVELS and looks_counted(signal):
            taken = f"channel {channel.name}: whole numbers without unit or scale in the file, taken as {channel.unit}"
            remedy = 'if they are counts of a converter, state unit = "counts" or a sensitivity'
            self.flag("counts_without_unit", "suspect", f"{taken}: {remedy}")
        if scaling.remark:
            self.flag("unit_unknown", "info", scaling.remark)
        if scaling.offset != 0.0:
            signal -= signal.dtype.type(scaling.offset)
        if scaling.factor != 1.0:
            signal *= signal.dtype.type(scaling.factor)
        return scaling

    def integrate(self, signal: FloatArray, number: int, scaling: Scaling, recording: Gathered) -> None:
        """Integrate ``signal`` of channel ``number`` in place from the unit of ``scaling``, where that is asked for."""
        channel, octaves = self.manifest.channels[number], self.settings.integration_edge_octaves
        if not scaling.integrals:
            if channel.highpass_hz is not None:
                detail = "highpass_hz acts where a channel is integrated, which this one is not"
                self.flag("highpass_unused", "suspect", f"channel {channel.name}: {detail}")
            return
        rate_hz = recording.number("rate_hz")
        if recording.attrs["domain"] == "crank_angle":
            rate_hz = recording.number("samples_per_rev") * recording.number("speed_rpm") / 60.0
        if not math.isfinite(rate_hz):
            problem = f"channel {channel.name}: samples by crank angle at an unknown speed cannot be integrated by time"
            remedy = "State the speed in recordings.speed_rpm, or analyse the acceleration"
            raise InputError(problem, file=self.path, place=f"source {channel.file_source}", remedy=remedy)
        highpass_hz = channel.highpass_hz or self.settings.integration_highpass_hz
        most_hz = 0.5 * rate_hz * 2.0**-octaves
        if highpass_hz >= most_hz:
            problem = f"channel {channel.name}: the high-pass leaves nothing of {rate_hz:g} samples per second"
            place, allowed = f"channels.{number}.highpass_hz", f"below {most_hz:.4g}"
            found, remedy = f"{highpass_hz:g}", "Mend highpass_hz in the manifest"
            raise InputError(problem, file=self.path, place=place, found=found, allowed=allowed, remedy=remedy)
        integral = integrated(signal, rate_hz, times=scaling.integrals, highpass_hz=highpass_hz, half_octaves=octaves)
        signal[:] = integral * (scaling.unit.factor / channel.analysed_unit.factor)
        faded_s = faded_samples(len(signal), rate_hz, highpass_hz) / rate_hz
        made = f"{channel.measured_quantity} in {channel.analysed_unit.name} integrated from {scaling.unit.quantity}"
        ends = f"high-pass {highpass_hz:g} Hz; the first and last {faded_s:.2g} s are left out"
        self.flag("integrated", "info", f"channel {channel.name}: {made}, {ends}")


def _with_signals(
    recording: Gathered, signals: FloatArray, manifest: Manifest, flags: Sequence[QualityFlag]
) -> Recording:
    """The dataset of ``recording`` with its ``signals`` (channel, sample) and what ``manifest`` says of each.

    The ``flags`` of the file get the name of the recording: files of one name may lie in several folders.
    """
    axis = "time" if manifest.sampling.domain == "time" else "crank_angle"
    size = np.array([channel.analysed_unit.factor for channel in manifest.channels], dtype=np.float64)
    recording.add("signal", ("channel", axis), signals, "see unit", "analysed signals")
    recording.add("si_per_unit", "channel", size, "1", "SI units in one unit of the channel")
    texts = {
        "channel": [channel.name for channel in manifest.channels],
        "unit": [channel.analysed_unit.name for channel in manifest.channels],
        "quantity": [channel.measured_quantity for channel in manifest.channels],
        "direction": [channel.direction for channel in manifest.channels],
    }
    coords = {
        name: xr.Variable("channel", np.array(values, dtype=np.str_), {"units": "1", "long_name": name})
        for name, values in texts.items()
    }
    for remark in flags:
        remark["recording"] = str(recording.attrs["recording"])
    return Recording(with_flags(xr.Dataset(recording.variables, coords, recording.attrs), flags))
