"""A synthetic twin of an analysed test: its speeds, channels, pulses and floor, and the orders that were found.

What is put in is known, so that the same analysis can be held against it. Natural frequencies stand in the floor as far
as they are broad; bearing strikes, tones and faults of the recordings are not in the twin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.ndimage import binary_dilation, label, median_filter

from crankorder.errors import RequestError
from crankorder.quantities import Floats
from crankorder.synth.noise import shaped_noise

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
    """What a twin is made of: results by group, the sampling rate, pulses per revolution, fineness of their times.

    ``pulse_step_s`` is the grid that the pulse times lie on, 0 where they are exact; without pulses the mean speed is
    all that is told of the shaft.
    """

    tracks: xr.Dataset
    campbell: xr.Dataset
    order_map: xr.Dataset
    shaft: xr.Dataset
    rate_hz: float
    pulses_per_rev: int
    pulse_step_s: float


@dataclass(frozen=True)
class TwinRecording:
    """A recording of a twin: samples (channels, samples), pulse and mark times in s, its mean speed."""

    name: str
    signals: Floats
    pulse_times_s: Floats
    mark_times_s: Floats
    speed_rpm: float


def probe_orders(twin: Twin) -> Floats:
    """Orders of the probes for ``twin``: on bins of its order map, clear of the test's and of half orders."""
    axis = twin.order_map["order"].values
    taken = np.unique(np.append(twin.tracks["order"].values, np.arange(0.0, axis[-1] + 1.0, 0.5)))
    own = twin.tracks["order"].values
    free = [
        order
        for order in axis[(axis > 0.7) & (axis < 0.9 * axis[-1])]
        if np.abs(taken - order).min() > 0.1 and np.abs(own - order).min(initial=np.inf) > CLEARANCE_ORDERS
    ]
    places = np.linspace(0, len(free) - 1, min(PROBES, len(free))).round().astype(int)
    return np.array([free[place] for place in places], dtype=np.float64)


def probe_amplitudes(twin: Twin, rng: np.random.Generator, n_probes: int) -> Floats:
    """Amplitudes (channels, ``n_probes``): ``LADDER`` dealt by ``rng``, times the standard error of ``twin``."""
    error = np.nanmedian(twin.order_map["standard_error"].values, axis=(1, 2))
    rungs: Floats = rng.permutation(LADDER)[:n_probes]
    return np.outer(error, rungs)


def twin_recordings(
    twin: Twin, probes: Floats, amplitudes: Floats, rng: np.random.Generator
) -> Iterator[TwinRecording]:
    """The recordings of a ``twin``, with ``probes`` (orders) of constant ``amplitudes`` (channels, probes).

    Noise and phases that are not known come from ``rng``.

    Raises RequestError where the speeds of the test are not known.
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
    made = np.zeros((tracks.sizes["channel"], len(speed)))
    rows = tracks["speed"].values
    for channel, number in np.ndindex(tracks.sizes["channel"], tracks.sizes["order"]):
        one = tracks.isel(channel=channel, order=number)
        amplitude, phase = one["amplitude"].values.astype(float), np.radians(one["phase"].values.astype(float))
        known = np.isfinite(amplitude) & np.isfinite(rows)
        if not known.any():
            continue
        located = bool(np.isfinite(phase[known]).all())
        phasor = amplitude[known] * (np.exp(1j * phase[known]) if located else np.exp(2j * np.pi * rng.uniform()))
        at = np.interp(speed, rows[known], phasor.real) + 1j * np.interp(speed, rows[known], phasor.imag)
        made[channel] += (at * np.exp(2j * np.pi * float(one["order"]) * turns)).real
    return made


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
    made = []
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
        made.append(shaped_noise(rng, shape, rate_hz=twin.rate_hz, n_samples=n_samples))
    return np.array(made, dtype=np.float64)


def _pulse_times(twin: Twin, time: Floats, turns: Floats) -> tuple[Floats, Floats]:
    """Times of the encoder's pulses and of the marks at top dead centre, on the grid of the test."""
    if not twin.pulses_per_rev:
        return np.array([]), np.array([])
    made = []
    for per_rev in (twin.pulses_per_rev, 1):
        at = np.interp(np.arange(np.ceil(turns[-1] * per_rev)) / per_rev, turns, time)
        made.append(np.ceil(at / twin.pulse_step_s) * twin.pulse_step_s if twin.pulse_step_s else at)
    return made[0], made[1]
