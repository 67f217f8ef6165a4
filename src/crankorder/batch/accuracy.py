"""Accuracy measured here: speed against error of the order transform, and that of a twin of one's own test."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import re
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.ndimage import binary_dilation, label, median_filter

from crankorder.batch.compare import refuse_results
from crankorder.batch.execute import analysed, engine_of
from crankorder.batch.result_folder import publish, read_document, result_folders
from crankorder.batch.store import json_bytes, library_versions, text_sha256
from crankorder.engine.slider_crank import even_harmonics
from crankorder.errors import CrankorderError, RequestError
from crankorder.fft.plans import fft_library
from crankorder.fft.resampling import values_at
from crankorder.fft.transforms import FrameTransform
from crankorder.fft.windows import hann
from crankorder.findings import Findings
from crankorder.ingest.manifest import manifest_head, manifest_of
from crankorder.ingest.rawfile import RawFile
from crankorder.ingest.recording import recording_of
from crankorder.quantities import Floats
from crankorder.report.balance_text import paragraph, text_table
from crankorder.report.netcdf import read_results
from crankorder.settings import Settings, load_settings
from crankorder.synth.noise import shaped_noise

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
RATE_HZ, SECONDS, SPEED_RPM, PULSES = 20_000.0, 20.0, 1500.0, 360
LINES = {0.5: 0.3, 1.0: 1.0, 2.0: 4.0, 5.5: 0.2, 11.0: 0.05}
"""Amplitude, m/s², by order, of the signal whose map is timed."""

_READERS = {"python_calamine": "XLSX", "nptdms": "TDMS", "asammdf": "MDF4", "idelib": "enDAQ IDE"}
"""Packages that read formats which the basic installation does not, by the name that is imported."""

REPEATS = 3
"""Times that a map is made; the fastest counts."""

SAMPLES_PER_HZ = 2.56
"""Sampling rate of a twin over the highest frequency that its test was looked at, the usual one of analysers."""

SURE = 5.0
"""Standard errors from which on the bias of an amplitude is counted: below it noise alone lifts amplitudes."""


@dataclass(frozen=True)
class ChannelAccuracy:
    """How the analysis did on a channel of the twin."""

    channel: str
    unit: str
    bias_percent: float | None
    scatter_percent: float | None
    intervals: int
    coverage_percent: float | None
    orders_put_in: int
    orders_found: int
    least_found: float | None
    """Least amplitude from which on every probe was found; None where some of the largest were not."""

    most_missed: float | None
    """Largest amplitude of a probe that was not found; None where all were."""


@dataclass(frozen=True)
class TwinAccuracy:
    """How the analysis did on the twin of a test: by channel, what it named that was not there, and what it was of."""

    test: str
    draws: int
    rate_hz: float
    channels: tuple[ChannelAccuracy, ...]
    missed_orders: tuple[str, ...]
    false_orders: tuple[str, ...]


def publish_accuracy(out: Path, *, on: Path | None = None, draws: int = 1) -> tuple[list[Path], str]:
    """Paths of ``accuracy.json`` and ``accuracy.txt`` written into ``out``, and the text.

    Without ``on`` they tell the speed against error of the order transform on this machine; with it the accuracy on
    twins of the test whose results are in ``on``, drawn ``draws`` times. Raises RequestError where ``on`` holds no
    results of one test with known speeds, or where ``out`` lies among results.
    """
    refuse_results(out, [] if on is None else result_folders(on))
    measured: dict[str, object]
    if on is None:
        timed = list(speed_against_error())
        measured, text = {"speed_against_error": timed}, _speed_text(timed)
    else:
        twin = accuracy_on(on, draws=draws)
        measured, text = {"twin": asdict(twin)}, _twin_text(twin)
    document = {"schema_version": 1, "crankorder": version("crankorder"), **measured}
    files = {"accuracy.json": json_bytes(document), "accuracy.txt": text.encode()}
    publish(out, files, key=text_sha256(json.dumps(document)))
    return [out / name for name in files], text


def speed_against_error() -> Iterator[dict[str, Any]]:
    """Order maps of one recording at each tolerance: method, error predicted and made, samples per second.

    The amplitudes and phases of the map are compared with the true ones.
    """
    phases = np.random.default_rng(1).uniform(-np.pi, np.pi, (3, len(LINES)))
    seconds = np.arange(round(RATE_HZ * SECONDS)) / RATE_HZ
    amplitudes, angles = np.array(list(LINES.values())), 2 * np.pi * np.outer(list(LINES), _turns(seconds))
    signals = [amplitudes @ np.cos(angles + row[:, None]) for row in phases]
    per_rev = np.arange(round(float(_turns(np.array(SECONDS))) * PULSES)) / PULSES
    made_of = TwinRecording("speed", np.array(signals), _times(per_rev), _times(np.arange(per_rev[-1])), SPEED_RPM)
    nothing, channels = xr.Dataset(), {"channel": list("XYZ"), "unit": ("channel", ["m/s2"] * 3)}
    maps = (xr.Dataset(coords=channels), nothing, nothing, nothing)
    recording = _recording(Twin(*maps, RATE_HZ, PULSES, 0.0, cycle="four-stroke"), made_of)
    wanted = amplitudes * np.exp(1j * phases)
    for tolerance in TOLERANCES:
        settings = load_settings(asked={"report": {"results": ("order_map",)}, "orders": {"tolerance": tolerance}})
        taken = []
        for _ in range(REPEATS):
            start = time.perf_counter()
            order_map = analysed(recording, settings, tables={})[0]["order_map"]
            taken.append(time.perf_counter() - start)
        row = order_map.isel(speed=int(np.argmax(order_map["n_frames"].values))).sel(order=list(LINES))
        got = row["coherent_amplitude"].values * np.exp(1j * np.radians(row["phase"].values))
        error = float(np.max(np.abs(got - wanted) / np.abs(wanted)))
        speed = signals[0].size * len(signals) / min(taken)
        made = {"method": str(order_map.attrs["method"]), "predicted_error": float(order_map.attrs["predicted_error"])}
        yield {"tolerance": tolerance, **made, "error": error, "samples_per_s": speed}


def _turns(seconds: Floats) -> Floats:
    """Revolutions of a shaft whose speed swings by 4 rpm in 5 s about the mean."""
    return SPEED_RPM / 60.0 * seconds + 4.0 / 60.0 * 5.0 / (2 * np.pi) * np.sin(2 * np.pi * seconds / 5.0)


def _times(turns: Floats) -> Floats:
    """Seconds at which the shaft has made ``turns``, by Newton's iteration."""
    seconds = turns / (SPEED_RPM / 60.0)
    for _ in range(6):
        speed = SPEED_RPM / 60.0 + 4.0 / 60.0 * np.cos(2 * np.pi * seconds / 5.0)
        seconds = seconds - (_turns(seconds) - turns) / speed
    return seconds


def accuracy_on(result: Path, *, draws: int = 1) -> TwinAccuracy:
    """Accuracy of the analysis on ``draws`` twins of the test whose results are in the folder ``result``.

    Raises RequestError where it holds no results of one test that has orders, a Campbell map and speeds over time.
    """
    folders = result_folders(result)
    if len(folders) > 1:
        found = ", ".join(folder.name for folder in folders)
        raise RequestError("holds several tests", file=result, found=found, remedy="Name the folder of one")
    folder = folders[0]
    run, groups = read_document(folder / "run.json"), read_results(folder / "results.nc")
    missing = [name for name in ("order_tracks", "order_map", "campbell_map", "shaft") if name not in groups]
    if missing or not groups["order_tracks"].sizes["order"]:
        found = f"without {', '.join(missing)}" if missing else "no order was found"
        allowed = "results with orders, an order map and a Campbell map, as `crankorder run` makes them"
        raise RequestError("no twin can be made of this test", file=folder, found=found, allowed=allowed)
    results = ("order_map", "campbell_map", "order_tracks", "findings")
    asked = {**run["settings"], "report": {**run["settings"]["report"], "results": results}}
    settings = load_settings(asked={stage: values for stage, values in asked.items() if isinstance(values, dict)})
    manifest = run["manifest"]
    encoder, test = manifest.get("encoder") or {}, manifest["test"]
    tables = {key: manifest[key] for key in ("bearings", "gears", "motor") if manifest.get(key)}
    stated_hz = float((manifest.get("sampling") or {}).get("rate_hz") or np.inf)
    per_rev = round(float(encoder.get("pulses_per_rev") or 0) * float(encoder.get("ratio") or 1.0))
    campbell, shaft = groups["campbell_map"], groups["shaft"]
    fastest_hz = float(np.nanmax(shaft["speed_max"].values)) / 60.0
    highest_hz = max(float(campbell["frequency"].values[-1]), settings.orders.max_order * fastest_hz)
    rate = min(stated_hz, SAMPLES_PER_HZ * highest_hz)
    pulses = per_rev if np.nan_to_num(shaft["n_pulses"].values).max() > 0 else 0
    step = 1.0 / stated_hz if encoder.get("kind") == "square" else 0.0  # of pulses found in a sampled signal
    maps = (groups["order_tracks"], campbell, groups["order_map"], shaft)
    machine = (str(test.get("cycle") or "rotor"), test.get("engine"), tables)
    twin = Twin(*maps, rate, pulses, step, settings, *machine)
    return _judged(twin, str(run["test"]), [_draw(twin, number) for number in range(draws)])


@dataclass(frozen=True, eq=False)
class _Draw:
    """A twin that was analysed: its tracks and findings, and what probes (orders) it had of what size."""

    tracks: xr.Dataset
    findings: Findings
    probes: Floats
    amplitudes: Floats


def _draw(twin: Twin, number: int) -> _Draw:
    rng = np.random.default_rng([number, 18])
    probes = probe_orders(twin)
    amplitudes = probe_amplitudes(twin, rng, len(probes))
    recordings = [_recording(twin, made) for made in twin_recordings(twin, probes, amplitudes, rng)]
    engine = twin.engine
    try:
        engine_of(engine)
    except CrankorderError:  # one that lay beside the recordings
        engine = None
    groups, findings, _ = analysed(recordings, twin.settings, tables=twin.tables, engine=engine)
    return _Draw(groups["order_tracks"], findings, probes, amplitudes)


def _recording(twin: Twin, made: TwinRecording) -> xr.Dataset:
    """The recording ``made`` of a ``twin``, checked as that of a file is."""
    channels = [{"name": name, "source": place, "unit": unit} for place, (name, unit) in enumerate(twin.channels)]
    columns: dict[str | int, Floats] = dict(enumerate(made.signals))
    encoder: dict[str, object] = {"kind": "constant", "speed_rpm": made.speed_rpm}
    if twin.pulses_per_rev:
        columns |= {len(channels): made.pulse_times_s, len(channels) + 1: made.mark_times_s}
        encoder = {"kind": "pulse_times", "source": len(channels), "index": len(channels) + 1, "index_to_tdc_deg": 0.0}
        encoder |= {"pulses_per_rev": twin.pulses_per_rev}
    head = manifest_head("twin", twin.cycle, channels)
    manifest = manifest_of({**head, "sampling": {"rate_hz": twin.rate_hz}, "encoder": encoder}, Path("twin"))
    raw, settings = RawFile(columns, attrs={"start_s": 0.0}), twin.settings
    return recording_of(raw, Path(made.name), manifest, settings=settings.ingest, shaft=settings.shaft)


def _judged(twin: Twin, test: str, draws: list[_Draw]) -> TwinAccuracy:
    own = twin.tracks["order"].values
    near = 0.5 * float(np.diff(twin.order_map["order"].values[:2])[0])
    missed, false = Counter[str](), Counter[str]()
    for draw in draws:
        found = np.unique([line.order for line in draw.findings.orders])
        missed.update(f"{order:.4g}" for order in own if np.abs(found - order).min(initial=np.inf) > near)
        known = np.concatenate([own, draw.probes])
        false.update(f"{order:.4g}" for order in found if np.abs(known - order).min() > near)
    channels = tuple(_of_channel(twin, draws, number, *channel, near) for number, channel in enumerate(twin.channels))
    of = len(draws)
    counted = (tuple(f"{order} ({n} of {of})" for order, n in counts.items()) for counts in (missed, false))
    return TwinAccuracy(test, of, twin.rate_hz, channels, *counted)


def _of_channel(twin: Twin, draws: list[_Draw], number: int, name: str, unit: str, near: float) -> ChannelAccuracy:
    probes: list[tuple[float, bool]] = []
    own, found = twin.tracks["order"].values, 0
    known = [row for draw in draws for row in _beside(twin, draw, number, near)]
    inside = [low <= truth <= high for _, truth, _, low, high in known]
    off = [estimate / truth - 1.0 for estimate, truth, error, *_ in known if truth > SURE * error]
    for draw in draws:
        lines = np.array([line.order for line in draw.findings.orders if line.channel == name])
        for order, amplitude in zip(draw.probes, draw.amplitudes[number], strict=True):
            probes.append((float(amplitude), bool(np.abs(lines - order).min(initial=np.inf) <= near)))
        found += sum(bool(np.abs(lines - order).min(initial=np.inf) <= near) for order in own)
    lost = [size for size, seen in probes if not seen]
    seen = sorted(size for size, seen in probes if seen and size > max(lost, default=0.0))
    errors, bias, scatter = 100.0 * np.array(off), None, None
    if errors.size:
        bias, scatter = float(np.median(errors)), float(np.percentile(np.abs(errors), 68.3))
    coverage = 100.0 * float(np.mean(inside)) if inside else None
    least, most = seen[0] if seen else None, max(lost, default=None)
    return ChannelAccuracy(name, unit, bias, scatter, len(inside), coverage, len(own) * len(draws), found, least, most)


def _beside(twin: Twin, draw: _Draw, channel: int, near: float) -> Iterator[tuple[float, ...]]:
    """Estimate, truth, standard error and interval of each order at each speed where both are known."""
    own = twin.tracks["order"].values
    for order in map(float, draw.tracks["order"].values):
        place, probe = int(np.abs(own - order).argmin()), np.flatnonzero(np.abs(draw.probes - order) <= near)
        track = draw.tracks.isel(channel=channel).sel(order=order)
        if abs(own[place] - order) <= near:
            known = twin.tracks["amplitude"].isel(channel=channel, order=place).values.astype(float)
            truth = np.interp(track["speed"].values, twin.tracks["speed"].values, known)
        elif probe.size:
            truth = np.full(track.sizes["speed"], draw.amplitudes[channel, probe[0]])
        else:
            continue
        bounds = [track[name].values for name in ("standard_error", "amplitude_low", "amplitude_high")]
        columns = (track["amplitude"].values, truth, *bounds)
        yield from (row for row in np.array(columns, dtype=float).T.tolist() if np.isfinite(row).all())


def _speed_text(timed: list[dict[str, Any]]) -> str:
    rows = []
    for row in timed:
        errors = (f"{row['tolerance']:.0e}", f"{row['predicted_error']:.1e}", f"{row['error']:.1e}")
        rows.append((*errors, row["samples_per_s"] / 1e6, row["method"]))
    heads = ("asked for", "predicted", "error", "million samples/s", "method")
    return "\n".join(text_table("Order map of 3 channels, from samples to amplitudes and phases", heads, rows)) + "\n"


def _twin_text(twin: TwinAccuracy) -> str:
    keys = ("bias_percent", "scatter_percent", "coverage_percent", "intervals", "least_found", "most_missed")
    rows = []
    for row in twin.channels:
        values = [getattr(row, key) for key in keys]
        sizes = [None if value is None else float(f"{value:.3g}") for value in values]
        rows.append((row.channel, f"{row.orders_found} of {row.orders_put_in}", *sizes, row.unit))
    heads = ("channel", "orders found", "bias %", "scatter %", "inside 95 %", "intervals", "found from", "missed up to",
             "unit")  # fmt: skip
    title = f"A synthetic twin of {twin.test}, {twin.draws} times: same speeds, channels, pulses, floor and orders"
    lines = [
        *text_table(title, heads, rows, kept=2),
        "",
        *paragraph(f"Orders that were put in and named in no channel: {', '.join(twin.missed_orders) or 'none'}."),
        *paragraph(f"Orders that were named and not put in: {', '.join(twin.false_orders) or 'none'}."),
        *paragraph(
            "Bias and scatter: of amplitudes over 5 standard errors. Found from, missed up to: amplitude of orders "
            "that were added at every speed; an order smaller than the first may be there although none is shown. "
            "Natural frequencies, bearing strikes, tones and faults of the recordings are not in the twin."
        ),
    ]
    return "\n".join(lines) + "\n"


LINE_RATIO, MEDIAN_BINS = 4.0, 41
"""What stands so many times over the running median of so many bins is a line, and no part of the floor."""
LINE_BINS = 2.0
"""Of the spectrum that an order's line takes on either side, and beyond what stands over the floor beside it."""

PROBES = 8
"""Orders that the test did not have, put in at known amplitudes to see which are found."""

LADDER = 2.0 ** np.arange(-1.0, 7.0)
"""Amplitudes of the probes, in standard errors of the order map."""

CLEARANCE_ORDERS = 0.3
"""Distance of a probe from any order of the test."""


@dataclass(frozen=True)
class Twin:
    """What a twin is made of: results of its test, how this was recorded and analysed, and what its manifest states.

    ``tracks`` (channel, order, speed), ``campbell`` (channel, speed, frequency), ``order_map`` (channel, speed, order)
    and ``shaft`` (recording, knot) are groups of the results. ``pulse_step_s`` is the grid of the pulse times, 0 where
    they are exact; without pulses only the mean speed of the shaft is told.
    """

    tracks: xr.Dataset
    campbell: xr.Dataset
    order_map: xr.Dataset
    shaft: xr.Dataset
    rate_hz: float
    pulses_per_rev: int
    pulse_step_s: float
    settings: Settings = field(default_factory=load_settings)
    cycle: str = "rotor"
    engine: str | None = None
    tables: Mapping[str, object] = field(default_factory=dict)

    @property
    def channels(self) -> list[tuple[str, str]]:
        """Name and unit of each channel."""
        columns = (self.tracks[key].values.astype(str).tolist() for key in ("channel", "unit"))
        return list(zip(*columns, strict=True))


@dataclass(frozen=True)
class TwinRecording:
    """A recording of a twin: ``signals`` (channels, samples) and its mean speed [rpm].

    ``pulse_times_s`` (pulses,) and ``mark_times_s`` (marks,) are in s.
    """

    name: str
    signals: Floats
    pulse_times_s: Floats
    mark_times_s: Floats
    speed_rpm: float


def probe_orders(twin: Twin) -> Floats:
    """Orders (probes,) of the probes for ``twin``: on bins of its order map, clear of the test's and of half orders."""
    axis = twin.order_map["order"].values
    own = twin.tracks["order"].values
    taken = np.append(own, np.arange(0.0, axis[-1] + 1.0, 0.5))
    clear = np.abs(own[:, None] - axis).min(axis=0, initial=np.inf) > CLEARANCE_ORDERS
    clear &= (np.abs(taken[:, None] - axis).min(axis=0) > 0.1) & (axis > 0.7) & (axis < 0.9 * axis[-1])
    free = np.flatnonzero(clear)
    places = np.linspace(0, len(free) - 1, min(PROBES, len(free))).round().astype(int)
    return np.asarray(axis[free[places]], dtype=np.float64)


def probe_amplitudes(twin: Twin, rng: np.random.Generator, n_probes: int) -> Floats:
    """Amplitudes (channels, probes) of ``n_probes`` probes, in the units of the channels.

    They are the steps of ``LADDER``, drawn by ``rng``, times the standard error of the order map of ``twin``.
    """
    error = np.nanmedian(twin.order_map["standard_error"].values, axis=(1, 2))
    rungs: Floats = rng.permutation(LADDER)[:n_probes]
    return np.outer(error, rungs)


def twin_recordings(
    twin: Twin, probes: Floats, amplitudes: Floats, rng: np.random.Generator
) -> Iterator[TwinRecording]:
    """The recordings of a ``twin``, with ``probes`` (probes,), orders, of constant ``amplitudes`` (channels, probes).

    Noise and unknown phases come from ``rng``. Raises RequestError where the speeds of the test are not known.
    """
    for number, name in enumerate(twin.shaft["recording"].values.astype(str)):
        row = twin.shaft.isel(recording=number)
        known = np.isfinite(row["trace_time"].values) & np.isfinite(row["speed_trace"].values)
        if known.sum() < 2:
            raise RequestError("the speed against time is not known", file="twin", found=name)
        at, rpm = row["trace_time"].values[known].astype(float), row["speed_trace"].values[known].astype(float)
        step = float(np.median(np.diff(at)))
        time = np.arange(round((at[-1] - at[0] + step) * twin.rate_hz)) / twin.rate_hz
        speed = np.interp(time, at - at[0] + 0.5 * step, rpm)
        turns = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) / 60.0 / twin.rate_hz)])
        signals = _orders_of(twin, speed, turns, rng) + _floor(twin, float(speed.mean()), len(time), rng)
        for place, order in enumerate(probes):
            line = np.cos(2.0 * np.pi * (order * turns + rng.uniform()))
            signals += amplitudes[:, place, None] * line
        pulses, marks = _pulse_times(twin, time, turns)
        yield TwinRecording(name, signals, pulses, marks, float(speed.mean()))


def _orders_of(twin: Twin, speed: Floats, turns: Floats, rng: np.random.Generator) -> Floats:
    """The orders of the test as its tracks have them, at each moment by its speed; an unknown phase is drawn."""
    tracks = twin.tracks
    signals = np.zeros((tracks.sizes["channel"], len(speed)))
    rows = tracks["speed"].values
    for channel, number in np.ndindex(tracks.sizes["channel"], tracks.sizes["order"]):
        track = tracks.isel(channel=channel, order=number)
        amplitude, phase = track["amplitude"].values.astype(float), np.radians(track["phase"].values.astype(float))
        known = np.isfinite(amplitude) & np.isfinite(rows)
        if not known.any():
            continue
        located = bool(np.isfinite(phase[known]).all())
        phasor = amplitude[known] * (np.exp(1j * phase[known]) if located else np.exp(2j * np.pi * rng.uniform()))
        at = np.interp(speed, rows[known], phasor.real) + 1j * np.interp(speed, rows[known], phasor.imag)
        signals[channel] += (at * np.exp(2j * np.pi * float(track["order"]) * turns)).real
    return signals


def _floor(twin: Twin, speed_rpm: float, n_samples: int, rng: np.random.Generator) -> Floats:
    """Noise of every channel with the density of the test's row nearest to ``speed_rpm``, its lines cut off.

    Under the orders of the test it is that beside them: what a cut line leaves would be noise on the order alone.
    """
    rows = twin.campbell["speed"].values
    row = int(np.nanargmin(np.abs(rows - speed_rpm)))
    frequency = twin.campbell["frequency"].values
    hertz = np.append(twin.tracks["order"].values, np.nan) * float(rows[row]) / 60.0
    width = LINE_BINS * float(frequency[1] - frequency[0]) if len(frequency) > 1 else 0.0
    near = (np.abs(frequency[:, None] - hertz) <= width).any(axis=1)
    noise = []
    for density in np.nan_to_num(twin.campbell["psd"].values[:, row].astype(float)):
        smooth = median_filter(density, size=min(MEDIAN_BINS, len(density)), mode="nearest")
        floor = np.minimum(density, LINE_RATIO * smooth)
        pieces, _ = label(near | (density > LINE_RATIO * smooth))
        clear = ~binary_dilation(np.isin(pieces, np.unique(pieces[near])) & (pieces > 0), iterations=round(LINE_BINS))
        if clear.any():
            floor = np.interp(frequency, frequency[clear], floor[clear])
        n_even = n_samples + n_samples % 2
        bins = np.fft.rfftfreq(n_even, 1.0 / twin.rate_hz)
        shape = np.sqrt(np.interp(bins, frequency, floor))
        noise.append(shaped_noise(rng, shape, rate_hz=twin.rate_hz, n_samples=n_samples))
    return np.array(noise, dtype=np.float64)


def _pulse_times(twin: Twin, time: Floats, turns: Floats) -> tuple[Floats, Floats]:
    """Times of the encoder's pulses and of the marks at top dead centre, on the grid of the test."""
    if not twin.pulses_per_rev:
        return np.array([]), np.array([])
    rates, step = (twin.pulses_per_rev, 1), twin.pulse_step_s
    pulses, marks = (np.interp(np.arange(np.ceil(turns[-1] * n)) / n, turns, time) for n in rates)
    return (np.ceil(pulses / step) * step, np.ceil(marks / step) * step) if step else (pulses, marks)


class KnownAnswer(NamedTuple):
    """A calculation whose answer is known: its ``error`` relative to the answer, and the largest that is sound."""

    question: str
    error: float
    allowed: float

    @property
    def holds(self) -> bool:
        """Whether the error is one of rounding, or of the method as it is stated."""
        return self.error <= self.allowed  # not so where it is not a number


def known_answers() -> list[KnownAnswer]:
    """Errors of the transform, of the resampling kernel and of an engine's second order, in less than two seconds.

    The answers: exp(1j), the line of cos(2π·5t + 1); a cosine between its samples; the second order of the piston at
    λ = 0.3, 4/λ times the Fourier coefficient of √(1 − λ² sin²φ), by a sum over 256 crank angles.
    """
    cosine = np.cos(2 * np.pi * 5 * np.arange(64) / 64 + 1)[None]
    line = FrameTransform(hann(64)).spectra(cosine, np.array([0]))[0, 0, 5]
    times = np.linspace(100, 900, 1001)
    between = values_at(np.cos(0.2 * np.pi * np.arange(1000.0))[None], times)[0] - np.cos(0.2 * np.pi * times)
    ratio, angle = 0.3, 2 * np.pi * np.arange(256) / 256
    fourier = 8 / ratio * np.mean(np.sqrt(1 - (ratio * np.sin(angle)) ** 2) * np.cos(2 * angle))
    second = even_harmonics(1, ratio)[0] / fourier - 1
    return [
        KnownAnswer(f"spectrum of a cosine, by {fft_library()}", float(abs(line - np.exp(1j))), 1e-12),
        KnownAnswer("cosine between its samples, by compiled kernels", float(np.abs(between).max()), 1e-7),
        KnownAnswer("second order of a crank, against its Fourier integral", float(abs(second)), 1e-12),
    ]


def surroundings(out: Path) -> list[str]:
    """Lines on this machine: versions, processor and threads, formats that can be read, and space for ``out``.

    Raises OSError where nothing can be written there.
    """
    versions = library_versions()
    program = f"crankorder {versions.pop('crankorder')}, Python {platform.python_version()}, {platform.platform()}"
    libraries = ", ".join(f"{name} {number}" for name, number in versions.items())
    processor = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):  # Linux alone
        named = re.search(r"^model name\s*: (.+)$", Path("/proc/cpuinfo").read_text("utf-8"), re.MULTILINE)
        processor = named[1] if named else processor
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    there = f"processor: {processor}, {usable} cores; a thread for each recording, {fft_library()} transforms"
    missing = "pip install 'crankorder[formats]' reads them"
    formats = [f"{what}: {f'by {name}' if find_spec(name) else missing}" for name, what in _READERS.items()]
    existing = next(folder for folder in (out.resolve(), *out.resolve().parents) if folder.exists())
    tempfile.TemporaryFile(dir=existing).close()  # an OSError where no results can be written
    free = f"free space for results: {shutil.disk_usage(existing).free / 1e9:.1f} GB"
    return [program, libraries, there, *formats, free]
