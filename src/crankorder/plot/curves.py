"""Spectra by frequency, spectra of the envelope by order, and speed against time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from crankorder.plot.axes import axes_for, dress, log_scale, note
from crankorder.plot.given import channel_number, dataset_of, number_of, quantity_text, unit_of, values_of
from crankorder.plot.palette import FAINT, INK, LINES, SMALL
from crankorder.plot.records import called_order, order_texts
from crankorder.quantities import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_SPEEDS = 6  # spectra that the eye can tell apart
_MOST_NAMED = 6
_CHANCE = 1e-3  # that noise alone is named in a picture
_PIECES = 800  # of time, where a speed has more than twice as many knots
_CHANGES = 1.1  # highest over lowest speed from which the axis begins at standstill


def spectra(campbell_map: xr.Dataset, *, channel: str | None = None, ax: Axes | None = None) -> Axes:
    """Peak amplitude against frequency [Hz], one line per speed; returns the axes.

    Of more than six speeds the largest amplitude at any of them and the median over them are drawn: what moves with
    the speed stands out of the median, what stays at its frequency stands in both.

    Parameters
    ----------
    campbell_map : CampbellMap of :func:`crankorder.campbell_map`
    channel : name of the channel; the first where not given
    ax : axes to draw on; without them a new figure of pyplot's

    Raises RequestError for another dataset, channel or axes.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> axes = co.plot.spectra(co.campbell_map(made, max_frequency_hz=200.0))
    >>> axes.get_yscale(), axes.get_title(loc="right")
    ('log', '1500 rpm')
    """
    dataset = dataset_of(campbell_map, "campbell_map", "spectra")
    number = channel_number(dataset, channel, "spectra")
    frequency = np.asarray(dataset["frequency"].values, dtype=float)
    lines = _spectra(dataset, number)
    axes = axes_for(ax, "spectra", height_in=4.4)
    label = f"{quantity_text(dataset, number)}, {unit_of(dataset, number)}".removesuffix(", ")
    several = len(lines) > 1
    said = f"{dataset.sizes['speed']} speeds" if several else next(iter(lines), "")
    dress(axes, x="Frequency, Hz", y=label, title=str(dataset["channel"].values[number]), said=said)
    if not log_scale(axes, np.array(list(lines.values()))):
        note(axes, "no signal")
        return axes
    if len(frequency) > 1:
        axes.set_xlim(frequency[0], frequency[-1])
    colors = LINES if several else (INK,)
    for (text, values), color in zip(lines.items(), colors, strict=False):
        positive = np.where(values > 0, values, np.nan)
        axes.plot(frequency, positive, color=color, linewidth=0.9, gid=text, label=text)
    if several and len(lines) < dataset.sizes["speed"]:
        from crankorder.plot.artists import label_ends

        named = zip(lines.items(), LINES, strict=False)
        label_ends(axes, [(frequency, values, text, color, 0.0) for (text, values), color in named])
    elif several:
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=SMALL, labelcolor="linecolor",
                    borderaxespad=0.0, handlelength=1.2)  # fmt: skip
    return axes


def _spectra(dataset: xr.Dataset, channel: int) -> dict[str, Floats]:
    """Spectra to draw, by what they are called."""
    amplitude = values_of(dataset, "amplitude", "speed", "frequency", channel=channel)
    speed = np.asarray(dataset["speed"].values, dtype=float)
    measured = np.flatnonzero(np.isfinite(amplitude).any(axis=1))
    measured = measured[np.argsort(speed[measured], kind="stable")]
    if len(measured) > _MOST_SPEEDS:
        known = np.nan_to_num(amplitude[measured])
        return {"largest": known.max(axis=0), "median": np.median(known, axis=0)}
    lines: dict[str, Floats] = {}
    for number in measured:
        text = f"{speed[number]:.0f} rpm" if np.isfinite(speed[number]) else "speed not known"
        lines[text if text not in lines else f"{text} ({number + 1})"] = amplitude[number]
    return lines


def envelope(
    envelope_map: xr.Dataset, *, channel: str | None = None, speed_rpm: float | None = None, ax: Axes | None = None
) -> Axes:
    """Order spectrum of the envelope at one speed, with its floor: strikes in bearings show here; returns the axes.

    Parameters
    ----------
    envelope_map : EnvelopeMap of :func:`crankorder.envelope`
    channel : name of the channel; the first where not given
    speed_rpm : the nearest speed to this is drawn, rpm; without it that at which a line stands highest over the floor
    ax : axes to draw on; without them a new figure of pyplot's

    The highest lines are named above, where noise alone would not reach so high in one of a thousand pictures.
    Raises RequestError for another dataset, channel or axes.

    >>> import numpy as np, crankorder as co
    >>> rng, ring = np.random.default_rng(1), np.exp(-np.arange(60) / 15) * np.cos(1.9 * np.arange(60))
    >>> signal = np.convolve(np.arange(80_000) % 112 == 0, ring, "same") + 0.1 * rng.standard_normal(80_000)
    >>> made = co.recording(signal, rate_hz=10_000, speed_rpm=1500.0)  # a strike every 112 samples: order 3.57
    >>> axes = co.plot.envelope(co.envelope(made, bearings=[{"name": "drive end", "bpfo": 3.58, "bpfi": 5.42}]))
    >>> axes.get_title(loc="right").partition(",")[0]
    '1500 rpm'
    """
    dataset = dataset_of(envelope_map, "envelope_map", "envelope")
    number = channel_number(dataset, channel, "envelope")
    order = np.asarray(dataset["order"].values, dtype=float)
    amplitude = values_of(dataset, "amplitude", "speed", "order", channel=number)
    floor = values_of(dataset, "floor", "speed", "order", channel=number)
    if not amplitude.size:
        amplitude, floor = np.zeros((1, len(order))), np.zeros((1, len(order)))
    at = _speed_at(dataset, order, amplitude, floor, speed_rpm)
    axes = axes_for(ax, "envelope", height_in=4.2)
    unit = unit_of(dataset, number)
    named = _standing_out(order, amplitude[at], floor[at])
    label = f"Envelope of {quantity_text(dataset, number).partition(' (')[0].lower()}, {unit}".removesuffix(", ")
    said = _where(dataset, number, at)
    dress(axes, x="Order (cycles per crank revolution)", y=label, title=str(dataset["channel"].values[number]),
          rows_above=bool(named), said=said)  # fmt: skip
    if not log_scale(axes, amplitude[at]):
        axes.set_xticks([])
        note(axes, "no signal" if dataset.sizes["speed"] else "nothing was measured")
        return axes
    if len(order) > 1:
        axes.set_xlim(order[0], order[-1])
    axes.plot(order, np.where(amplitude[at] > 0, amplitude[at], np.nan), color=INK, linewidth=0.8, gid="envelope")
    if np.any(floor[at] > 0):
        axes.plot(order, np.where(floor[at] > 0, floor[at], np.nan), color=LINES[4], linewidth=1.4, gid="floor")
        axes.plot([], [], color=LINES[4], linewidth=1.4, label="floor")
        axes.legend(loc="upper right", frameon=False, fontsize=SMALL, labelcolor=FAINT)
    for place, _ in named:
        axes.axvline(place, color=LINES[1], linewidth=0.7, alpha=0.35, zorder=1)
    if named:
        from crankorder.plot.artists import label_orders

        texts = order_texts([called_order(place) for place, _ in named])
        label_orders(axes, [(place, text, power) for (place, power), text in zip(named, texts, strict=True)], LINES[1])
    return axes


def _speed_at(
    dataset: xr.Dataset,
    order: Floats,
    amplitude: Floats,
    floor: Floats,
    asked: float | None,
) -> int:
    """Place of the speed to draw: nearest to that ``asked`` for, else where a line stands highest over the floor."""
    speed = np.asarray(dataset["speed"].values, dtype=float)
    if asked is not None and len(speed):
        wanted = number_of(asked, "speed_rpm", "envelope", above=0.0)
        return int(np.argmin(np.where(np.isfinite(speed), np.abs(speed - wanted), np.inf)))
    with np.errstate(divide="ignore", invalid="ignore"):
        over = np.where((floor > 0) & (order > 0), amplitude / floor, 0.0)
    over = over if np.any(over > 0) else np.where(order > 0, amplitude, 0.0)
    return int(np.argmax(np.max(np.nan_to_num(over), axis=1, initial=0.0)))


def _where(dataset: xr.Dataset, channel: int, at: int) -> str:
    """Speed and band of the spectrum that is drawn."""
    if not dataset.sizes["speed"]:
        return ""
    speed = float(dataset["speed"].values[at])
    said = f"{speed:.0f} rpm" if np.isfinite(speed) else "speed not known"
    low, high = (float(values_of(dataset, name, "speed", channel=channel)[at]) for name in ("band_low", "band_high"))
    return f"{said}, band {low:.0f}–{high:.0f} Hz" if np.isfinite(low) and np.isfinite(high) else said


def _standing_out(order: Floats, amplitude: Floats, floor: Floats) -> list[tuple[float, float]]:
    """Order and amplitude of the highest lines that noise would not make: its power is at worst exponential.

    The amplitude is the root of the squared envelope's line: its fourth power is the power that the floor refers to.
    """
    if len(order) < 3:
        return []
    with np.errstate(divide="ignore", invalid="ignore"):
        power = np.nan_to_num(np.where(floor > 0, amplitude / floor, 0.0)) ** 4
    inner = power[1:-1]
    top = (inner >= power[:-2]) & (inner > power[2:]) & (inner > np.log(len(order) / _CHANCE)) & (order[1:-1] > 0)
    places = np.flatnonzero(top) + 1
    strongest = places[np.argsort(-power[places], kind="stable")][:_MOST_NAMED]
    return [(float(order[one]), float(power[one])) for one in np.sort(strongest)]


def speed(crank_angle: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Speed [rpm] against time [s] of one recording; returns the axes.

    Of very many knots the mean is drawn, and lowest to highest speed of each piece of time as a pale band.

    Parameters
    ----------
    crank_angle : ShaftAngle of :func:`crankorder.crank_angle`
    ax : axes to draw on; without them a new figure of pyplot's

    Raises RequestError for another dataset or axes.

    >>> import numpy as np, crankorder as co
    >>> turns = np.arange(0.0, 4.0, 1 / (25.0 * 60))
    >>> made = co.recording(np.zeros(4000), rate_hz=1000.0, pulse_times_s=turns, pulses_per_rev=60)
    >>> axes = co.plot.speed(co.crank_angle(made))
    >>> axes.get_xlabel(), axes.get_ylabel()
    ('Time, s', 'Speed, rpm')
    """
    dataset = dataset_of(crank_angle, "shaft_angle", "speed")
    time, values = (np.asarray(dataset[name].values, dtype=float) for name in ("time", "speed"))
    known = np.isfinite(time) & np.isfinite(values)
    time, values = time[known], values[known]
    axes = axes_for(ax, "speed", height_in=3.2)
    many = len(values) > 2 * _PIECES
    pieces = _pieces(time, values) if many else np.stack([time, values, values, values])
    said = _range_text(pieces[1]) + (", band: lowest to highest" if many else "")
    dress(axes, x="Time, s", y="Speed, rpm", title=str(dataset.attrs["recording"]), said=said)
    if not len(values):
        axes.set(ylim=(0.0, 1.0), yticks=[], xticks=[])
        note(axes, "no speed is known")
        return axes
    if many:
        axes.fill_between(*pieces[[0, 2, 3]], color=LINES[0], alpha=0.25, linewidth=0, gid="lowest to highest")
        axes.plot(pieces[0], pieces[1], color=LINES[0], linewidth=1.3, gid="speed")
    else:
        axes.plot(time, values, color=LINES[0], linewidth=1.3, gid="speed", marker="o" if len(values) == 1 else "none")
    if time[-1] > time[0]:
        axes.set_xlim(time[0], time[-1])
    low, high = float(values.min()), float(values.max())
    spare = max(0.1 * (high - low), 0.005 * abs(high), 1e-3)
    from_standstill = low >= 0 and high > _CHANGES * low
    axes.set_ylim(*((0.0, 1.05 * high) if from_standstill else (low - spare, high + spare)))
    axes.ticklabel_format(useOffset=False, style="plain")
    return axes


def _range_text(values: Floats) -> str:
    if not len(values):
        return ""
    low, high = f"{values.min():.0f}", f"{values.max():.0f}"
    return f"{low} rpm" if low == high else f"{low} to {high} rpm"


def _pieces(time: Floats, values: Floats) -> Floats:
    """Middle, mean, lowest and highest value, (4, pieces), of equal pieces of ``time`` that hold any."""
    number = np.minimum(((time - time[0]) / (time[-1] - time[0]) * _PIECES).astype(int), _PIECES - 1)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    count = np.diff(np.append(first, len(values)))
    means = (np.add.reduceat(series, first) / count for series in (time, values))
    return np.stack([*means, np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)])
