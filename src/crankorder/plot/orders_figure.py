"""Orders against speed, with intervals, one column of panels per channel; and speed against time.

Speed against time shows how the machine was driven, and how unevenly it turned where an encoder shows that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.channel_units import unit_text
from crankorder.errors import RequestError
from crankorder.findings import Findings
from crankorder.plot.axes import axes_for, channel_of, dataset_of, dress, painted, scale, whole_picture, y_label
from crankorder.plot.campbell_figure import gaps_before, speed_cells
from crankorder.plot.drawing import ORDER, Box, Drawing, Panel, Words
from crankorder.plot.labels import EdgeLabel, head_of_test, label_column, label_right
from crankorder.plot.palette import BAND_FACTOR, FAINT, LIGHT, LINES, NORMAL, SMALL, drawable, shortened
from crankorder.plot.reading import names_of_orders, nominal_order, speed_text
from crankorder.plot.spectra_figure import order_spectra_figure
from crankorder.quantities import Bools, Floats, Ints
from crankorder.settings import ReportSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEFT, _BOTTOM, _TOP, _GUTTER = 1.0, 0.7, 0.98, 0.95  # margins in inches; the gutter holds labels and the next axis
_COLUMNS = 4
_COLOURED = 6  # orders that the eye can follow; the others are there for comparison …
_ALL_COLOURED = 8  # … but not for the sake of one or two
_MOST = 12  # orders that a notebook's picture shows where none are asked for
_LOG_RATIO = 15.0  # orders whose largest amplitudes differ by more than this need a logarithmic axis
_CLEAR = 3.0  # standard errors above zero from which a line is drawn; its phase means nothing below
_WITHOUT_MARKERS = 60  # more speeds than this are a curve, not points
_SAME_ORDER = 0.02  # an order asked for is the track this close to it
_JOINED_DEG = 90.0  # phases further apart are points, not a curve: they wrap, or nothing locks them to the shaft
_PHASE_OF = {
    "tdc": "Phase from\ntop dead centre, °",
    "index": "Phase from\nthe index mark, °",
    "pulse": "Phase from\nthe first pulse, °",
    "count": "Phase from\nthe zero of the count, °",
    "mixed": "Phase\n(references differ), °",
}


@dataclass(frozen=True)
class ShownTracks:
    """Tracks of the orders that are shown, at ``speed`` (speeds,) [rpm], rising, for ``orders`` (orders,).

    ``amplitude``, the ends ``low`` and ``high`` of its 95 % interval, ``phase`` [deg] and ``read`` are each (channels,
    orders, speeds), NaN where a line is not clear of the noise. ``read`` is False at speeds at which only other orders
    have a row: those of a sweep have speeds of their own. ``rank`` (orders,) is 0 for the strongest order, ``units``
    are those of the channels, ``reference`` is that of the phases, ``texts`` name the orders.
    """

    speed: Floats
    orders: Floats
    rank: Ints
    amplitude: Floats
    low: Floats
    high: Floats
    read: Bools
    texts: list[str]
    phase: Floats
    units: list[str]
    reference: str

    @property
    def coloured(self) -> Bools:
        """True (orders,) for the orders that are drawn in a colour of their own."""
        return np.asarray(self.rank < (_COLOURED if len(self.orders) > _ALL_COLOURED else _ALL_COLOURED))

    def color(self, number: int) -> str:
        """Colour of the order ``number``, the same in all channels; light where it is only there for comparison."""
        return LINES[int(self.coloured[:number].sum())] if self.coloured[number] else LIGHT


def orders_figure(tracks: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Peak amplitude with its 95 % band, and phase, of the strongest orders against speed, for every channel.

    Of many orders the strongest six are coloured, the others light; each line is labelled with its order at its right
    end. The axis is logarithmic where the orders differ much; channels of one unit share it.

    ``tracks`` are OrderTracks (channel, order, speed), whose ``amplitude_low`` and ``amplitude_high`` are the band
    where they have them, else the standard error; ``findings`` are those of the same test, ``settings`` those of the
    report.
    """
    channels, block = tracks["channel"].values.astype(str), settings.height_in - _BOTTOM - _TOP
    columns = min(len(channels), _COLUMNS)
    rows = -(-len(channels) // columns)
    drawing = Drawing(settings.width_in, _TOP + rows * block + (rows - 1) * (_BOTTOM + 0.3) + _BOTTOM)
    width = (settings.width_in - _LEFT - columns * _GUTTER + 0.25) / columns
    shown = shown_tracks(tracks, limit=settings.max_labelled_orders)
    for number, channel in enumerate(channels):
        left = _LEFT + (number % columns) * (width + _GUTTER)
        bottom = _BOTTOM + (rows - 1 - number // columns) * (block + _BOTTOM + 0.3)
        _draw_channel(drawing, shown, number, (left, bottom, width, block))
        name = shortened(drawable(channel, settings.max_name_characters), NORMAL + 1, width, bold=True)
        drawing.add(Words(left, bottom + block + 0.09, name, NORMAL + 1, bold=True))
    subtitle = _subtitle(tracks.sizes["order"], len(shown.orders), clear=bool(np.isfinite(shown.amplitude).any()))
    head_of_test(drawing, _LEFT, findings, "orders against speed", subtitle, longest=settings.max_name_characters)
    return drawing


def shown_tracks(tracks: xr.Dataset, *, limit: int, among: Sequence[int] | None = None) -> ShownTracks:
    """The ``limit`` orders of OrderTracks ``tracks`` (channel, order, speed) that are largest, ascending.

    The size of an order is relative to the largest one of its channel. ``among`` are the indices of the orders from
    which to take them; None for all.
    """
    at = np.argsort(tracks["speed"].values, kind="stable")
    names = {"amplitude", "phase", "standard_error", "amplitude_low", "amplitude_high"} & {*tracks}
    values = {name: tracks[name].transpose("channel", "order", "speed").values[..., at] for name in names}
    amplitude, error = values["amplitude"], values["standard_error"]
    peak = np.max(np.nan_to_num(amplitude), axis=2, initial=0.0).astype(np.float64)
    share = (peak / np.maximum(peak.max(axis=1, initial=0.0, keepdims=True), 1e-300)).max(axis=0, initial=0.0)
    ranked = np.argsort(-share, kind="stable")
    ranked = (ranked if among is None else ranked[np.isin(ranked, among)])[:limit]
    kept = np.sort(ranked)
    reach = BAND_FACTOR * np.nan_to_num(error)
    low = np.maximum(values.get("amplitude_low", amplitude - reach), 0)
    high = values.get("amplitude_high", amplitude + reach)
    # an unknown error or interval counts as clear; an interval from 0 says that noise alone could be as large
    clear = (amplitude > 0) & ~(amplitude < _CLEAR * error) & ~(low <= 0)
    amplitude, low, high, phase = (
        np.where(clear, part, np.nan)[:, kept] for part in (amplitude, low, high, (values["phase"] + 180) % 360 - 180)
    )
    return ShownTracks(
        tracks["speed"].values[at], tracks["order"].values[kept], np.argsort(np.searchsorted(kept, ranked)),
        amplitude, low, high, np.isfinite(values["amplitude"])[:, kept],
        names_of_orders(tracks["order"].values[kept].tolist()), phase,
        [str(unit) for unit in tracks["unit"].values], str(tracks.attrs.get("phase_reference", "none")),
    )  # fmt: skip


def _subtitle(n_orders: int, shown: int, *, clear: bool) -> str:
    if not clear:
        return "No order stands clear of the noise, or the recordings hold too few revolutions to tell."
    light = f", {_COLOURED} of them in colour," if shown > _ALL_COLOURED else ""
    many = f" of {shown} orders" if light else ""
    many = f" of the {shown} strongest of {n_orders} orders" if shown < n_orders else many
    return f"Peak amplitude with 95 % band{many}{light} where it stands clear of the noise; orders at the right."


def _draw_channel(drawing: Drawing, shown: ShownTracks, channel: int, box: Box) -> None:
    left, bottom, width, height = box
    phase_height, first = 0.3 * height, left == _LEFT
    low, high = float(shown.speed[0]), float(shown.speed[-1])
    margin = 0.03 * (high - low) if high > low else max(0.05 * abs(low), 1.0)
    ends = low - margin, high + (0 if high > low else margin)
    alike = [number for number, unit in enumerate(shown.units) if unit == shown.units[channel]]
    limits, logarithmic = _scale(shown.amplitude[alike])
    upper_box = (left, bottom + phase_height + 0.22, width, height - phase_height - 0.22)
    upper = Panel(drawing, upper_box, ends, limits, logarithmic)
    lower = Panel(drawing, (left, bottom, width, phase_height), ends, (-190.0, 190.0))
    ticks = int(np.clip(1.8 * width, 3, 10))
    upper.x_axis(most=ticks, whole=True, named=False)
    lower.x_axis("Speed, rpm", most=ticks, whole=True)
    named = first or shown.units[channel] != shown.units[0]
    label = f"Amplitude (peak), {drawable(unit_text(shown.units[channel]), 24)}" if named else ""
    empty = not np.isfinite(shown.amplitude[channel]).any() and not logarithmic and limits == (0.0, 1.0)
    upper.y_axis(label, most=7, places=[] if empty else None)
    lower.y_axis(_PHASE_OF.get(shown.reference, "Phase") if first else "", places=[-180, -90, 0, 90, 180])
    upper.frame()
    lower.frame()
    draw_tracks(upper, shown, channel)
    if shown.reference not in _PHASE_OF:
        lower.note("no phase reference")
        return
    for number in np.argsort(-shown.rank).tolist():
        if shown.coloured[number] and shown.read[channel, number].any():
            _draw_phase(lower, shown, channel, number)


def draw_tracks(panel: Panel, shown: ShownTracks, channel: int) -> None:
    """Draw in ``panel`` the amplitudes of ``shown`` tracks in the channel with index ``channel``, bands and names."""
    for number in np.argsort(-shown.rank).tolist():  # the strongest lies on top
        if shown.read[channel, number].any():
            _draw_line(panel, shown, channel, number)
    _label_lines(panel, shown, channel)


def _scale(clear: Floats) -> tuple[tuple[float, float], bool]:
    """Limits of the amplitude axis for values (channels, orders, speeds) of one unit, and whether it is logarithmic."""
    if not np.any(np.isfinite(clear)):
        return (0.0, 1.0), False
    peaks = np.max(np.nan_to_num(clear), axis=2)
    top = float(peaks.max())
    if top < _LOG_RATIO * float(peaks[peaks > 0].min()):
        return (0.0, 1.08 * top), False
    return (max(float(np.nanquantile(clear, 0.005)) / 1.5, 1e-6 * top), min(1.6 * top, 1e307)), True


def _broken(speed: Floats, values: Floats, *, wrap: float = np.inf) -> NDArray[np.intp]:
    """Indices before which a curve breaks: gaps of the tested speed range, and jumps of more than ``wrap``."""
    gap = gaps_before(speed_cells(speed))[1:]
    with np.errstate(invalid="ignore"):
        return np.asarray(np.flatnonzero(gap | (np.abs(np.diff(values)) > wrap)) + 1)


def _draw_line(panel: Panel, shown: ShownTracks, channel: int, number: int) -> None:
    read, coloured, color = shown.read[channel, number], shown.coloured[number], shown.color(number)
    amplitude, low, high = (part[channel, number, read] for part in (shown.amplitude, shown.low, shown.high))
    speed = shown.speed[read]
    if len(speed) == 1:
        panel.curve(np.repeat(speed, 2), np.array([low[0], high[0]]), color=color, width=1.0)
    breaks = _broken(speed, amplitude)
    along, line, low, high = (np.insert(values, breaks, np.nan) for values in (speed, amplitude, low, high))
    if coloured:
        panel.band(along, low, high, color=color, alpha=0.2)
    panel.curve(along, line, color=color, width=1.3 if coloured else 0.9, name=f"order-{shown.texts[number]}")
    if len(speed) <= _WITHOUT_MARKERS:
        panel.rings(speed, amplitude, color=color, radius=1.5 if coloured else 1.0)


def _draw_phase(panel: Panel, shown: ShownTracks, channel: int, number: int) -> None:
    """Phase against speed of one order, where its line is above the noise; jumps are not joined."""
    read, color = shown.read[channel, number], shown.color(number)
    phase, speed = shown.phase[channel, number, read], shown.speed[read]
    locked = 2 * nominal_order(float(shown.orders[number])) % 1 == 0  # the phase of a slipping order just turns
    breaks = _broken(speed, phase, wrap=_JOINED_DEG if locked else 0.0)
    along, line = (np.insert(values, breaks, np.nan) for values in (speed, phase))
    panel.curve(along, line, color=color, width=0.9, name="phase")
    panel.rings(speed, phase, color=color, radius=1.2 if len(speed) <= _WITHOUT_MARKERS else 0.6)


def _label_lines(panel: Panel, shown: ShownTracks, channel: int) -> None:
    (left, bottom, width, height), labels = panel.box, []
    inside = (shown.speed >= panel.x[0]) & (shown.speed <= panel.x[1])
    for number, (text, amplitude) in enumerate(zip(shown.texts, shown.amplitude[channel], strict=True)):
        if len(known := amplitude[np.isfinite(amplitude) & inside]):
            color = shown.color(number) if shown.coloured[number] else FAINT
            labels.append(EdgeLabel(panel.height_at(float(np.clip(known[-1], *panel.y))), text, color, number))
    label_right(panel.drawing, panel.box, labels)
    if labels:
        panel.drawing.add(Words(left + width + 0.1, bottom + height + 0.09, "order", SMALL, FAINT))
    else:
        panel.note("no order stands clear", at_in=bottom + height / 2 + 0.09)
        panel.note("of the noise", at_in=bottom + height / 2 - 0.09)


def order_spectra(order_map: xr.Dataset, findings: Findings | Mapping[str, object] | None = None) -> Figure:
    """Mean level of each order over the speeds above the floor around it, a panel per channel; returns the figure.

    ``order_map`` is an OrderMap of :func:`crankorder.order_map`; orders in ``findings`` of :func:`crankorder.diagnose`
    are ringed and named. Raises RequestError for another dataset or no findings.

    >>> import numpy as np, crankorder as co
    >>> signal = np.cos(2 * np.pi * 75.0 * np.arange(40_000) / 10_000.0)
    >>> figure = co.plot.order_spectra(co.order_map(co.recording(signal, rate_hz=1e4, speed_rpm=1500.0)))
    """
    return whole_picture(order_spectra_figure, order_map, findings, "order_map", "order_spectra")


def orders(
    order_tracks: xr.Dataset,
    *,
    channel: str | None = None,
    orders: Sequence[float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Peak amplitude of orders against speed [rpm], each with its 95 % interval as a pale band; returns the axes.

    Parameters
    ----------
    order_tracks : OrderTracks (channel, order, speed) of :func:`crankorder.order_tracks`
    channel : name of the channel; the first where not given
    orders : those to draw, each as a track within 0.02 of it; the twelve strongest of the channel where not given
    ax : axes to draw on; without them a new figure of pyplot's

    Each line is labelled with its order at its end; the strongest six of many are coloured. Lines are drawn where they
    stand clear of the noise. The axis is logarithmic where the orders differ much. At one speed alone there are points
    with error bars against the order. Raises RequestError for another dataset, channel or order.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> recording = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> axes = co.plot.orders(co.order_tracks(recording, orders=[1.0, 3.0]))
    >>> axes.get_ylabel()
    'Acceleration (peak), m/s²'
    """
    dataset, number = channel_of(order_tracks, "order_tracks", "orders", channel)
    placed = np.flatnonzero(np.isfinite(dataset["speed"].values))
    own = dataset.isel(channel=[number], speed=placed if len(placed) else slice(0, 1))
    among = None if orders is None else _track_numbers(dataset["order"].values, orders)
    shown = shown_tracks(own, limit=_MOST if among is None else len(among), among=among)
    alone = len(shown.speed) <= 1
    axes = axes_for(ax, "orders", height_in=4.6, width_in=8.0)
    remark = _remark(shown, dataset.sizes["order"] if orders is None else 0) if len(shown.orders) else ""
    x, title = ORDER if alone else "Speed, rpm", str(dataset["channel"].values[number])
    dress(axes, x=x, y=y_label(dataset, number), title=title, rows_above=alone, note=remark)
    clear = bool(np.isfinite(shown.amplitude).any())
    limits, logarithmic = _scale(shown.amplitude)
    ends = (0.0, 1.06 * float(shown.orders[-1]) if len(shown.orders) else 1.0)
    if not alone:
        spare = 0.015 * float(shown.speed[-1] - shown.speed[0]) or 1.0
        ends = float(shown.speed[0]) - spare, float(shown.speed[-1]) + spare
    scale(axes, ends, limits if clear else None, log_y=logarithmic)
    return painted(axes, lambda panel: _draw_points(panel, shown) if alone and clear else draw_tracks(panel, shown, 0))


def _track_numbers(every: Floats, asked: Sequence[float]) -> list[int]:
    """Indices of the tracks within 0.02 of each order ``asked`` for, among the orders of ``every`` track."""
    numbers = []
    for order in asked:
        apart = np.abs(every - float(order))
        if not len(every) or not apart.min() <= _SAME_ORDER:
            there = ", ".join(f"{known:.4g}" for known in every) or "none"
            raise RequestError("no such order", file="crankorder.plot.orders", found=order, allowed=there)
        numbers.append(int(apart.argmin()))
    return numbers


def _remark(shown: ShownTracks, there: int) -> str:
    """Text beside the title: a single speed, and how many of the orders ``there`` are drawn; 0 of those asked for."""
    many = [f"{len(shown.orders)} strongest of {there} orders"] if len(shown.orders) < there else []
    at = [speed_text(shown.speed[0])] if len(shown.speed) == 1 else []
    return ", ".join([*at, *many, "with 95 % intervals"])


def _draw_points(panel: Panel, shown: ShownTracks) -> None:
    """Points with their intervals against the order, each named above."""
    sizes = (part[0, :, 0] for part in (shown.amplitude, shown.low, shown.high))
    every = zip(shown.orders.tolist(), shown.texts, *sizes, strict=True)
    points = [point for point in every if np.isfinite(point[2])]
    for order, _, amplitude, low, high in points:
        panel.upright(order, color=LINES[1], width=0.7, alpha=0.3)
        panel.curve(np.full(2, order), np.array([low, high]), color=LINES[1], width=1.2, name="interval")
        panel.rings(np.array([order]), np.array([amplitude]), color=LINES[1], radius=2.0)
    label_column(panel, [(order, text, LINES[1]) for order, text, *_ in points], "order")


_SPEED_TOP, _SPEED_RIGHT, _SPEED_HEIGHT = 0.84, 1.6, 3.8  # inches
_CHANGES = 1.1  # highest over lowest speed of a recording whose speed changes
_SMOOTH = 20  # the ends of a trace are told from the means of so many pieces of it
_PIECES = 800  # of time, where a recording has more than twice as many speeds


def changing_recordings(shaft: xr.Dataset) -> list[int]:
    """Indices of the recordings of the ShaftSummary ``shaft`` (recording, knot) whose speed changes by a tenth or more.

    Motion within an engine cycle does not count. The list is empty where ``shaft`` has no ``speed_trace``.
    """
    if "speed_trace" not in shaft:
        return []
    traces = shaft["speed_trace"].transpose("recording", "knot").values
    return [number for number, trace in enumerate(traces) if _spread(trace) > _CHANGES]


def shown_recordings(shaft: xr.Dataset) -> list[int]:
    """Indices of the recordings of the ShaftSummary ``shaft`` (recording, knot) whose speed is drawn.

    They are those whose speed changes or, where none changes, all that have pulses.
    """
    numbers = changing_recordings(shaft)
    if numbers or "speed_trace" not in shaft or "n_pulses" not in shaft:
        return numbers
    drawn = np.isfinite(shaft["speed_trace"].transpose("recording", "knot").values).any(axis=1)
    return np.flatnonzero((shaft["n_pulses"].values > 0) & drawn).tolist()


def _spread(trace: Floats) -> float:
    known = trace[np.isfinite(trace)]
    pieces = np.array_split(known, min(_SMOOTH, len(known))) if len(known) > 1 else [np.ones(1)]
    means = [float(piece.mean()) for piece in pieces]
    return max(means) / max(min(means), 1e-3)


def speed_figure(shaft: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Speed [rpm] against time [s] of the :func:`shown_recordings`, with its swing as a band.

    ``shaft`` is the group of that name of the results, with ``trace_time`` [s], ``speed_trace`` and where known
    ``speed_trace_low``, ``speed_trace_high`` [rpm] (recording, knot); ``findings`` are those of the same test,
    ``settings`` those of the report.
    """
    numbers, shaft = shown_recordings(shaft), shaft.transpose("recording", "knot", ...)
    time, speed = shaft["trace_time"].values, shaft["speed_trace"].values
    time = time - np.nanmin(time, axis=1, keepdims=True, initial=np.inf)
    low, high = (shaft.get(f"speed_trace_{end}", shaft["speed_trace"]).values for end in ("low", "high"))
    drawing = Drawing(settings.width_in, _SPEED_HEIGHT)
    box = (_LEFT, _BOTTOM, settings.width_in - _LEFT - _SPEED_RIGHT, _SPEED_HEIGHT - _BOTTOM - _SPEED_TOP)
    ends = _ends(low[numbers], high[numbers], from_zero=bool(changing_recordings(shaft)))
    panel = Panel(drawing, box, (0.0, float(np.nanmax(time[numbers], initial=1e-3))), ends)
    panel.x_axis("Time from the first pulse, s", most=10)
    panel.y_axis("Speed, rpm", most=6)
    panel.frame()
    labels, few = [], len(numbers) <= 2 * _COLOURED
    named = np.arange(len(numbers)) if few else np.linspace(0, len(numbers) - 1, _COLOURED).round()
    colors = {int(place): LINES[rank] for rank, place in enumerate(named[:_COLOURED])}
    for place, number in enumerate(numbers):
        swing, color = (low[number], high[number]), colors.get(place, LIGHT)
        draw_speed(panel, time[number], speed[number], swing, color, name=f"speed-{number}")
        if few or place in colors:
            last = float(speed[number][np.isfinite(speed[number])][-1])
            name = drawable(shaft["recording"].values[number], settings.max_name_characters)
            text = shortened(name, SMALL, _SPEED_RIGHT - 0.3)
            labels.append(EdgeLabel(panel.height_at(last), text, colors.get(place, FAINT)))
    label_right(drawing, box, labels)
    subtitle = _speed_subtitle(shaft, numbers)
    head_of_test(drawing, _LEFT, findings, "speed against time", subtitle, longest=settings.max_name_characters)
    return drawing


def draw_speed(
    panel: Panel, time: Floats, speed: Floats, swing: tuple[Floats, Floats], color: str, *, name: str = "speed"
) -> None:
    """Draw ``speed`` [rpm] over ``time`` [s] in ``panel`` as a line in ``color`` called ``name``, its swing as a band.

    ``time``, ``speed`` and both ends of ``swing`` [rpm] are (points,).
    """
    panel.band(time, *swing, color=color, alpha=0.25)
    panel.curve(time, speed, color=color, name=name)


def _ends(low: Floats, high: Floats, *, from_zero: bool) -> tuple[float, float]:
    """Limits of the speed axis: from standstill where the speed changes, else close around the data."""
    top, bottom = float(np.nanmax(high, initial=1.0)), float(np.nanmin(low, initial=np.inf))
    if from_zero or not np.isfinite(bottom):
        return 0.0, 1.05 * top
    spare = max(0.1 * (top - bottom), 0.005 * top)
    return max(0.0, bottom - spare), top + spare


def _speed_subtitle(shaft: xr.Dataset, numbers: list[int]) -> str:
    speed = shaft["speed_trace"].values[numbers]
    rest = shaft.sizes["recording"] - len(numbers)
    kept, none = ("keep their", "have no") if rest > 1 else ("keeps its", "has no")
    what = f"{kept} speed" if changing_recordings(shaft) else f"{none} encoder"
    more = f" {rest} other{'s' * (rest > 1)} {what}." if rest else ""
    return (
        f"{np.nanmin(speed, initial=np.inf):.0f} to {np.nanmax(speed, initial=0.0):.0f} rpm; "
        f"the band: lowest to highest within each piece of time, with the noise of the encoder's edges.{more}"
    )


def speed(crank_angle: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Speed [rpm] against time [s] of one recording; returns the axes.

    Of very many knots the mean is drawn, and lowest to highest speed of each piece of time as a pale band.

    Parameters
    ----------
    crank_angle : ShaftAngle (time) of :func:`crankorder.crank_angle`
    ax : axes to draw on; without them a new figure of pyplot's

    Raises RequestError for another dataset or axes.

    >>> import numpy as np, crankorder as co
    >>> turns = np.arange(0.0, 4.0, 1 / (25.0 * 60))
    >>> recording = co.recording(np.zeros(4000), rate_hz=1000.0, pulse_times_s=turns, pulses_per_rev=60)
    >>> axes = co.plot.speed(co.crank_angle(recording))
    >>> axes.get_xlabel(), axes.get_ylabel()
    ('Time, s', 'Speed, rpm')
    """
    dataset = dataset_of(crank_angle, "shaft_angle", "speed")
    time, values = (np.asarray(dataset[name].values, dtype=float) for name in ("time", "speed"))
    placed = np.isfinite(time) & np.isfinite(values)
    time, values = time[placed], values[placed]
    axes = axes_for(ax, "speed", height_in=3.2)
    many = len(values) > 2 * _PIECES
    when, mean, low, high = _pieces(time, values) if many else (time, values, values, values)
    ends = dict.fromkeys(f"{pick(mean):.0f}" for pick in (np.min, np.max)) if len(mean) else ()
    remark = f"{' to '.join(ends)} rpm{', band: lowest to highest' * many}" if ends else ""
    dress(axes, x="Time, s", y="Speed, rpm", title=str(dataset.attrs["recording"]), note=remark)
    if not len(values):
        scale(axes, (0.0, 1.0), None)
        return painted(axes, lambda panel: panel.note("no speed is known"))
    changes = 0.0 < _CHANGES * float(values.min()) < float(values.max())
    scale(axes, time, _ends(low, high, from_zero=changes), log_y=False)

    def content(panel: Panel) -> None:
        draw_speed(panel, when, mean, (low, high), LINES[0])
        if len(when) == 1:
            panel.rings(when, mean, color=LINES[0], radius=3.0)

    return painted(axes, content)


def _pieces(time: Floats, values: Floats) -> Floats:
    """Middle, mean, lowest and highest value, (4, pieces), of equal pieces of ``time`` that hold any."""
    number = np.minimum(((time - time[0]) / (time[-1] - time[0]) * _PIECES).astype(int), _PIECES - 1)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    count = np.diff(np.append(first, len(values)))
    means = (np.add.reduceat(series, first) / count for series in (time, values))
    return np.stack([*means, np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)])
