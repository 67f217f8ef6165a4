"""Spectra of every channel: over all speeds with natural frequencies, at the highest with orders, and by order.

Order spectra of the envelope, too: strikes in bearings, with the lines that each bearing would show.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from crankorder.channel_units import unit_text
from crankorder.findings import Findings, ModeFinding
from crankorder.plot import reading
from crankorder.plot.axes import axes_for, channel_of, dress, keys_below, painted, positive, scale, values_of, y_label
from crankorder.plot.campbell_figure import orders_of
from crankorder.plot.drawing import ORDER, Box, Drawing, Panel, Words, log_limits
from crankorder.plot.labels import (
    EdgeLabel,
    Key,
    Mark,
    draw_keys,
    head_of_test,
    label_column,
    label_width_in,
    mode_keys,
    mode_marks,
    mode_style,
)
from crankorder.plot.palette import (
    FAINT,
    INK,
    LIGHT,
    LINES,
    MAINS,
    MODE,
    MODE_DASHES,
    NORMAL,
    SMALL,
    TONE_DASHES,
    drawable,
    shortened,
)
from crankorder.quantities import Floats
from crankorder.settings import ReportSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LEFT, _BOTTOM, _TOP, _BETWEEN, _RIGHT, _ROW_GAP = 1.0, 0.7, 1.06, 0.95, 0.3, 0.16  # inches
_ONE_AXIS, _ORDER_AXIS, _TWO_TIERS, _CAUSES, _LINE = 0.8, 0.6, 1.22, 2.1, 0.15  # of one spectrum and its list of causes
_LETTERS = 32  # of a line of that list
_MOST_SPEEDS = 6  # spectra that the eye can tell apart
_LEAST_ROW = 1.2  # a row of panels is never lower than this
DECADES = 7.0  # shown below the strongest line, half as many again of a power
_LABEL_AT = 0.6  # of the name of a channel from its panel, in inches


def spectra_figure(campbell: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Per channel the median power spectral density over all speeds, and the peak spectrum at the highest speed.

    Natural frequencies are marked and named over the left column, orders over the right one. ``campbell`` is a
    CampbellMap (channel, speed, frequency), ``findings`` are those of the same test, ``settings`` those of the report.
    """
    speed = campbell["speed"].values
    fastest = int(np.argmax(np.nan_to_num(speed)))
    width = (settings.width_in - _LEFT - _BETWEEN - _RIGHT) / 2
    drawing, places = column_boxes(campbell.sizes["channel"], width, settings, lefts=(_LEFT, _LEFT + width + _BETWEEN))
    peak = campbell["amplitude"].transpose("channel", "speed", "frequency").values[:, fastest]
    scaling = reading.scaling_text(campbell)
    # lines that move with speed vanish from the median over the speeds, what stays put remains
    density = campbell["psd"].transpose("channel", "speed", "frequency").values
    median, frequency = np.asarray(np.median(density, axis=1), dtype=float), campbell["frequency"].values
    left = column_panels(drawing, places[0], campbell, median, "²/Hz", settings=settings)
    right = column_panels(drawing, places[1], campbell, peak, f" {scaling}", settings=settings)
    modes = _mark_modes(left, reading.fixed_frequencies(findings))
    names, limit = campbell["channel"].values.astype(str).tolist(), settings.max_labelled_orders
    orders = _mark_orders(right, names, findings, float(speed[fastest]), limit=limit)
    for panel, values in zip([*left, *right], [*median, *peak], strict=True):
        draw_spectrum(panel, frequency, values)
    label_column(left[0], modes, "")
    label_column(right[0], orders, "order")
    kind = "peak amplitude" if "peak" in scaling else "RMS"
    subtitle = _subtitle(len(speed), float(speed[fastest]), kind, modes=bool(modes), orders=bool(orders))
    head_of_test(drawing, _LEFT, findings, "spectra", subtitle, longest=settings.max_name_characters)
    return drawing


def spectrum_figure(
    campbell: xr.Dataset, channel: str, findings: Findings, *, settings: ReportSettings, sentence: str = ""
) -> Drawing:
    """Peak spectrum of one channel of a test at one speed, or at none that is known: the one row of its Campbell map.

    The axis is frequency [Hz] and, where the speed is known, order on a second axis below. Found orders and lines that
    stay at their frequency are marked and named above; their causes stand at the right, that of the strongest first.

    ``campbell`` is a CampbellMap (channel, speed, frequency), ``channel`` one of its channels, ``findings`` are those
    of the same test, ``settings`` those of the report; ``sentence`` stands below the title. Raises ValueError for an
    unknown channel.
    """
    fastest = int(np.argmax(np.nan_to_num(campbell["speed"].values)))
    row = campbell.isel(channel=[campbell["channel"].values.tolist().index(channel)], speed=fastest)
    rpm, peak = float(row["speed"]), row["amplitude"].transpose("channel", "frequency").values
    fixed = reading.fixed_frequencies(findings)
    own = replace(findings, orders=tuple(orders_of(findings, channel, limit=settings.max_labelled_orders)))
    causes, low = _causes(own, fixed), _ONE_AXIS + _ORDER_AXIS * (rpm > 0.0)
    drawing, right = Drawing(settings.width_in, settings.height_in), _CAUSES if causes else _RIGHT
    box = (_LEFT, low, settings.width_in - _LEFT - right, settings.height_in - low - _TWO_TIERS)
    panels = column_panels(drawing, [box], row, peak, f" {reading.scaling_text(row)}", settings=settings)
    modes = _mark_modes(panels, fixed)
    orders = _mark_orders(panels, [channel], own, rpm, limit=len(own.orders))
    draw_spectrum(panels[0], row["frequency"].values, peak[0])
    label_column(panels[0], orders, "order", modes)
    if rpm > 0.0:
        ends = (60.0 * panels[0].x[0] / rpm, 60.0 * panels[0].x[1] / rpm)
        below = Panel(drawing, (_LEFT, _ONE_AXIS, box[2], 0.0), ends, (0.0, 1.0))
        below.x_axis(ORDER, most=10, grid=False)
        below.frame()
    for number, (text, color) in enumerate(causes[: int(box[3] / _LINE)], start=1):
        cause, place = shortened(drawable(text, 200), SMALL, right - 0.25), low + box[3] - number * _LINE
        drawing.add(Words(settings.width_in - right + 0.15, place, cause, SMALL, color, name="cause"))
    draw_keys(drawing, _LEFT, [Key("order found", LINES[1])] * bool(orders) + mode_keys(fixed), room_in=box[2])
    subtitle = drawable(sentence, 300) or f"Amplitude {reading.scaling_text(row)} against frequency."
    what = f"channel {drawable(channel, settings.max_name_characters)}"
    at = f" at {rpm:.0f} rpm" if rpm > 0.0 else ", speed unknown"
    head_of_test(drawing, _LEFT, findings, f"{what}{at}", subtitle, longest=settings.max_name_characters)
    return drawing


def _causes(findings: Findings, fixed: list[ModeFinding]) -> list[tuple[str, str]]:
    """Text lines and their colours: each cause, followed by its orders and tones."""
    orders = sorted(findings.orders, key=lambda order: -order.amplitude)
    places = [(order.explained_by, reading.order_name(order, findings), LINES[1]) for order in orders]
    tones = [mode for mode in fixed if reading.is_tone(mode)]
    places += [(tone.explained_by, f"{reading.frequency_text(tone.frequency_hz)} Hz", MAINS) for tone in tones]
    causes: dict[tuple[str, str], list[str]] = {}
    for cause, place, color in places:
        causes.setdefault((cause or "unexplained", color), []).append(place)
    texts = [((cause, INK), (", ".join(at), color)) for (cause, color), at in causes.items()]
    return [(line, color) for pair in texts for text, color in pair for line in wrap(text, _LETTERS)]


def column_boxes(
    n: int, width: float, settings: ReportSettings, *, lefts: Sequence[float] = (_LEFT,)
) -> tuple[Drawing, list[list[Box]]]:
    """Drawing for columns of ``n`` panels, and the boxes of each column, the highest first.

    ``width`` of a panel and ``lefts``, the left edges of the columns, are in inches; ``settings`` give the size of the
    drawing, which grows with ``n``.
    """
    row = max((settings.height_in - _BOTTOM - _TOP - (n - 1) * _ROW_GAP) / n, _LEAST_ROW)
    drawing = Drawing(settings.width_in, _TOP + _BOTTOM + n * row + (n - 1) * _ROW_GAP)
    bottoms = [_BOTTOM + k * (row + _ROW_GAP) for k in reversed(range(n))]
    return drawing, [[(left, bottom, width, row) for bottom in bottoms] for left in lefts]


def _subtitle(n_speeds: int, rpm: float, kind: str, *, modes: bool, orders: bool) -> str:
    left, which = (f"median over {n_speeds} speeds", "highest") if n_speeds > 1 else ("the one speed", "same")
    at = f"{which} speed, {rpm:.0f} rpm" if np.isfinite(rpm) else "speed unknown"
    left += ", with what stays at its frequency" * modes
    return f"Left: power spectral density, {left}. Right: {kind}, {at}{', with orders' * orders}."


def column_panels(
    drawing: Drawing, boxes: list[Box], dataset: xr.Dataset, values: Floats, unit_tail: str, *, settings: ReportSettings
) -> list[Panel]:
    """Panels over ``boxes`` of ``drawing`` with logarithmic axes for ``values`` (channels, bins); one unit, one scale.

    The bins are the frequencies or the orders of ``dataset``; ``unit_tail`` follows each channel's unit; ``settings``
    cut long names.
    """
    along, title = ("order", ORDER) if "order" in dataset.dims else ("frequency", "Frequency, Hz")
    place, units = dataset[along].values, dataset["unit"].values.astype(str)
    of_power = "²/Hz" in unit_tail
    panels, decades = [], DECADES * (1.5 if of_power else 1.0)
    for number, box in enumerate(boxes):
        limits = log_limits(values[units == units[number]], decades, room=2.5)
        panel = Panel(drawing, box, (float(place[0]), float(place[-1])), limits or (0.0, 1.0), limits is not None)
        last = number == len(boxes) - 1
        panel.x_axis(title if last else "", most=10, named=last)
        name = drawable(dataset["channel"].values[number], settings.max_name_characters)
        unit = drawable(unit_text(units[number]), 24)
        unit = f"({unit})" if of_power and "/" in unit else unit
        label = f"{shortened(name, NORMAL, box[3])}\n{unit}{unit_tail}"
        panel.y_axis(label, most=5, places=None if panel.log_y else [], at_in=_LABEL_AT)
        panel.frame()
        panels.append(panel)
    return panels


def draw_spectrum(panel: Panel, place: Floats, values: Floats, *, color: str = INK, name: str = "spectrum") -> None:
    """Draw ``values`` over ``place``, both (bins,), in the units of ``panel`` as a ``color`` line called ``name``."""
    if np.any(values > 0):
        panel.curve(place, np.where(values > 0, values, np.nan), color=color, width=0.8, name=name)
    else:
        panel.note("no signal")


def _mark_modes(panels: list[Panel], modes: list[ModeFinding]) -> list[Mark]:
    for panel in panels:
        for mode in modes:
            _, color, _, dashes = mode_style(mode)
            panel.upright(mode.frequency_hz, color=color, dashes=dashes, alpha=0.7)
    return mode_marks(modes)


def _mark_orders(panels: list[Panel], names: list[str], findings: Findings, rpm: float, *, limit: int) -> list[Mark]:
    if not np.isfinite(rpm):
        return []
    in_channel = {(record.channel, reading.nominal_order(record)) for record in findings.orders}
    strongest = reading.strongest_by(findings.orders, reading.nominal_order)
    kept = sorted(sorted(strongest, key=lambda order: -strongest[order].amplitude)[:limit])
    marks = [(order * rpm / 60, text, LINES[1]) for order, text in zip(kept, reading.order_texts(kept), strict=True)]
    for panel, channel in zip(panels, names, strict=True):
        for order, (hertz, text, color) in zip(kept, marks, strict=True):
            alpha = 0.6 if (channel, order) in in_channel else 0.25
            panel.upright(hertz, color=color, width=0.7, alpha=alpha, name=f"order-{text}")
    return marks


_AROUND = 0.5  # orders to each side: further than a line leaks, nearer than the next whole order


def order_spectra_figure(order_map: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Per channel the mean level of each order over the speeds, above the floor around it; found ones ringed and named.

    The largest amplitude over the speeds would bury a steady order under the natural frequencies that sweep past it.

    ``order_map`` is an OrderMap (channel, speed, order), whose speeds may be unknown; ``findings`` are those of the
    same test, ``settings`` those of the report.
    """
    drawing, (boxes,) = column_boxes(order_map.sizes["channel"], settings.width_in - _LEFT - _RIGHT, settings)
    order, (mean, floor) = order_map["order"].values, _mean_levels(order_map)
    panels = column_panels(drawing, boxes, order_map, mean, f" {reading.scaling_text(order_map)}", settings=settings)
    orders = sorted({reading.nominal_order(record) for record in findings.orders})
    for number, (panel, channel) in enumerate(zip(panels, order_map["channel"].values.tolist(), strict=True)):
        for place in orders:
            panel.upright(place, color=LINES[1], width=0.7, alpha=0.25)
        if np.any(floor[number] > 0):
            panel.curve(order, floor[number], color=LIGHT, width=1.4, name="floor")
        draw_spectrum(panel, order, mean[number])
        own = sorted({reading.nominal_order(record) for record in findings.orders if record.channel == channel})
        ring_lines(panel, order, mean[number], own)
    marks = [(order, text, LINES[1]) for order, text in zip(orders, reading.order_texts(orders), strict=True)]
    label_column(panels[0], marks, "order")
    keys = [Key("floor: median of the orders around", LIGHT)] if drawing.strokes("floor") else []
    draw_keys(drawing, _LEFT, keys + [Key("order found in the channel", LINES[1], ring=True)] * bool(orders))
    speeds = order_map.sizes["speed"]
    subtitle = f"Amplitude against order{f', its mean level over {speeds} speeds' if speeds > 1 else ''}."
    head_of_test(drawing, _LEFT, findings, "order spectra", subtitle, longest=settings.max_name_characters)
    return drawing


def ring_lines(panel: Panel, order: Floats, values: Floats, places: Sequence[float]) -> bool:
    """Ring the lines at ``places`` of a spectrum in ``panel``; returns whether there are any within it.

    The spectrum has ``values`` (bins,) over ``order`` (bins,); ``places`` are orders. A ring is as high as the highest
    bin within two of its place.
    """
    reach = max(2 * float(np.median(np.diff(order))) if len(order) > 1 else 0.0, 1e-9)
    known = np.nan_to_num(values)
    heights = [float(np.max(known, where=np.abs(order - place) <= reach, initial=0.0)) for place in places]
    if standing := [ends for ends in zip(places, heights, strict=True) if ends[1] > 0]:
        x, y = (np.array(ends) for ends in zip(*standing, strict=True))
        panel.rings(x, y, color=LINES[1], radius=5.0, width=1.4, name="found")
    return bool(standing)


def _mean_levels(order_map: xr.Dataset) -> tuple[Floats, Floats]:
    """Amplitude and floor, each (channels, orders): means over the speeds of the levels of each order and around it.

    The floor is the median of the orders around. NaN where the rate carried the order at no speed, or nothing lies
    around it. The mean tells a small line that stands at every speed from noise, which the largest over many speeds
    does not.
    """
    amplitude = order_map["amplitude"].transpose("channel", "speed", "order").values.astype(np.float64)
    order = order_map["order"].values
    reach = max(round(_AROUND / float(order[1] - order[0])), 1) if len(order) > 1 else 1
    beside = np.pad(amplitude, ((0, 0), (0, 0), (reach, reach)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(beside, 2 * reach + 1, axis=-1)
    with warnings.catch_warnings(), np.errstate(divide="ignore", invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # orders that no speed carries have no median
        levels = np.log(np.stack([amplitude, np.nanmedian(windows, axis=-1)]))
        mean, floor = np.exp(np.nanmean(np.where(np.isfinite(levels).all(axis=0), levels, np.nan), axis=2))
    return mean, floor


def spectra(campbell_map: xr.Dataset, *, channel: str | None = None, ax: Axes | None = None) -> Axes:
    """Peak amplitude against frequency [Hz], one line per speed; returns the axes.

    Of more than six speeds the largest amplitude at any of them and the median over them are drawn: what moves with
    the speed stands out of the median, what stays at its frequency stands in both.

    Parameters
    ----------
    campbell_map : CampbellMap (channel, speed, frequency) of :func:`crankorder.campbell_map`
    channel : name of the channel; the first where not given
    ax : axes to draw on; without them a new figure of pyplot's

    Raises RequestError for another dataset, channel or axes.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> recording = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> axes = co.plot.spectra(co.campbell_map(recording, max_frequency_hz=200.0))
    >>> axes.get_yscale(), axes.get_title(loc="right")
    ('log', '1500 rpm')
    """
    dataset, number = channel_of(campbell_map, "campbell_map", "spectra", channel)
    frequency, lines = np.asarray(dataset["frequency"].values, dtype=float), _by_speed(dataset, number)
    axes = axes_for(ax, "spectra", height_in=4.4)
    several, title = len(lines) > 1, str(dataset["channel"].values[number])
    speeds = f"{dataset.sizes['speed']} speeds" if several else next(iter(lines), "")
    dress(axes, x="Frequency, Hz", y=y_label(dataset, number), title=title, note=speeds)
    scale(axes, frequency, log_limits(np.array(list(lines.values())), DECADES, room=2.5))

    def content(panel: Panel) -> None:
        for (text, values), color in zip(lines.items(), LINES if several else (INK,), strict=False):
            draw_spectrum(panel, frequency, values, color=color, name=text)
        if not lines:
            panel.note("no signal")
        keys_below(panel, [Key(text, color) for text, color in zip(lines, LINES, strict=False)] if several else [])

    return painted(axes, content)


def _by_speed(dataset: xr.Dataset, channel: int) -> dict[str, Floats]:
    """Spectra to draw by their legend text: one per speed, or maximum and median over many speeds."""
    amplitude = values_of(dataset, "amplitude", "speed", "frequency", channel=channel)
    speed = np.asarray(dataset["speed"].values, dtype=float)
    measured = np.flatnonzero(np.isfinite(amplitude).any(axis=1))
    measured = measured[np.argsort(speed[measured], kind="stable")]
    if len(measured) > _MOST_SPEEDS:
        known = np.nan_to_num(amplitude[measured])
        return {"largest": known.max(axis=0), "median": np.median(known, axis=0)}
    lines: dict[str, Floats] = {}
    for number in measured:
        text = reading.speed_text(speed[number])
        lines[text if text not in lines else f"{text} ({number + 1})"] = amplitude[number]
    return lines


_NAME_LETTERS = (60, 40, 30, 22, 16, 12, 8)  # of a bearing in a label, where there are several: the most that fit
_FLOOR = LINES[4]
_SIDEBANDS = np.array([-2, -1, 1, 2])  # that are marked beside a line that has some
_MULTIPLES = 12  # of a line that was found, marked at most
_MOST_NAMED = 6  # lines that a notebook's picture names
_CHANCE = 1e-3  # that noise alone is named there


def envelope_figure(envelope: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Per channel the envelope's order spectrum, averaged over the speeds, with its floor and the bearings' lines.

    Expected orders are dashed and named above; those that were found are circled, with their multiples as thin lines.
    ``envelope`` is an EnvelopeMap (channel, speed, order), ``findings`` are those of the same test, ``settings`` those
    of the report.
    """
    width = settings.width_in - _LEFT - _RIGHT
    drawing, (boxes,) = column_boxes(envelope.sizes["channel"], width, settings)
    mean, floor = (_mean_over_speeds(envelope, name) for name in ("amplitude", "floor"))
    panels = column_panels(drawing, boxes, envelope, mean, " (envelope)", settings=settings)
    heard = [record for record in findings.bearings if record.seen_in == "envelope"]
    texts = {of.order: reading.order_name(of, findings) for of in heard if reading.is_number(of.order)}
    seen = [(order, text, LINES[1]) for order, text in texts.items()]
    marks, is_line_seen = _expected(findings, width - _labels_width_in(seen)), False
    for number, (panel, channel) in enumerate(zip(panels, envelope["channel"].values.astype(str), strict=True)):
        for order, _, color in marks:
            panel.upright(order, color=color, width=0.8, alpha=0.7, dashes=MODE_DASHES, name="expected")
        draw_envelope(panel, envelope["order"].values, mean[number], floor[number])
        is_line_seen |= _draw_bearing_lines(panel, envelope["order"].values, mean[number], findings, channel)
        left, bottom, wide, high = panel.box
        band = shortened(_band(envelope, number), SMALL, wide)
        drawing.add(Words(left + wide, bottom + high - 0.13, band, SMALL, FAINT, along="right", name="band"))
    label_column(panels[0], [*marks, *seen], "")
    draw_keys(drawing, _LEFT, _keys(drawing, expected=bool(marks), found=is_line_seen))
    over = f"Mean over {envelope.sizes['speed']} speeds: " if envelope.sizes["speed"] > 1 else ""
    subtitle = f"{over}how the ringing above the orders comes and goes, by order of the shaft."
    if not marks:
        subtitle += " No bearing was named, or none of its lines is told."
    elif not is_line_seen:
        subtitle += " No bearing line stands over the floor."
    head_of_test(drawing, _LEFT, findings, "envelope spectra", subtitle, longest=settings.max_name_characters)
    return drawing


def draw_envelope(panel: Panel, order: Floats, amplitude: Floats, floor: Floats) -> None:
    """Draw ``amplitude`` and ``floor`` of the spectrum of an envelope over ``order``, all (bins,), in ``panel``."""
    draw_spectrum(panel, order, amplitude)
    if np.any(floor > 0):
        panel.curve(order, np.where(floor > 0, floor, np.nan), color=_FLOOR, width=1.4, name="floor")


def _keys(drawing: Drawing, *, expected: bool, found: bool) -> list[Key]:
    keys = [Key("floor", _FLOOR)] * bool(drawing.strokes("floor"))
    keys += [Key("order expected of a bearing", MODE, MODE_DASHES)] * expected
    keys += [Key("found", LINES[1], ring=True), Key("its multiples", LINES[1])] * found
    return keys + [Key("its sidebands", LINES[3], TONE_DASHES)] * bool(drawing.strokes("sideband"))


def _mean_over_speeds(envelope: xr.Dataset, name: str) -> Floats:
    """Mean over the speeds (channels, orders) of variable ``name`` by power of the squared envelope; 0 if unknown.

    The amplitude is the root of the squared envelope's line: its fourth power is the power that the floor refers to.
    """
    if name not in envelope:
        return np.zeros((envelope.sizes["channel"], envelope.sizes["order"]))
    values = envelope[name].broadcast_like(envelope["amplitude"]).transpose("channel", "speed", "order").values
    known = np.isfinite(values)
    scale = float(np.max(np.abs(values), where=known, initial=0.0)) or 1.0  # 1e300 squared is no number
    total = np.sum(np.where(known, values / scale, 0.0) ** 4, axis=1)
    return np.asarray(scale * (total / np.maximum(known.sum(axis=1), 1)) ** 0.25, dtype=np.float64)


def _expected(findings: Findings, width_in: float) -> list[Mark]:
    """Order, text and colour of every line that the bearings of ``findings`` are expected to show.

    Names of bearings are as long as all texts together fit into ``width_in`` inches.
    """
    records = [record for record in findings.bearings if reading.is_number(record.order_expected)]
    records.sort(key=lambda record: record.order_expected)
    choices = []
    for letters in _NAME_LETTERS:
        names = _short({drawable(record.name, _NAME_LETTERS[0]) for record in records}, letters)
        texts: dict[float, dict[str, None]] = {}
        for record in records:
            text = drawable(str(record.line or "").replace("*", "·"), _NAME_LETTERS[0])
            if len(names) > 1:
                text = f"{text} {names[drawable(record.name, _NAME_LETTERS[0])]}"
            texts.setdefault(record.order_expected, {})[text] = None
        called = {order: f"{', '.join([*of][:2])} {reading.order_text(order)}" for order, of in texts.items()}
        choices.append([(order, text, MODE) for order, text in called.items()])
    return next((marks for marks in choices if _labels_width_in(marks) <= width_in), choices[-1])


def _short(names: set[str], letters: int) -> dict[str, str]:
    """Short form of each of ``names``: their common beginning goes first, then the middle of the rest.

    Bearings of one machine mostly differ at the end: "gearbox, drive end" and "gearbox, fan end".
    """
    alike = "".join(each[0] for each in takewhile(lambda letters: len({*letters}) == 1, zip(*names, strict=False)))
    start = max(alike.rfind(" "), alike.rfind("_"), alike.rfind("-")) + 1

    def cut(name: str) -> str:
        rest = name if len(name) <= letters else name[start:]
        return rest if len(rest) <= letters else f"{rest[: letters // 2]}…{rest[-(letters - letters // 2 - 1) :]}"

    return {name: cut(name) for name in names}


def _labels_width_in(marks: list[Mark]) -> float:
    """Width in inches of the labels of ``marks`` side by side."""
    return sum(label_width_in(EdgeLabel(0.0, text, color)) for _, text, color in marks)


def _draw_bearing_lines(panel: Panel, orders: Floats, values: Floats, findings: Findings, channel: str) -> bool:
    """Whether a bearing line of a ``channel`` is ringed in ``panel``; thin lines mark its multiples and sidebands."""
    places = []
    for record in findings.bearings:
        order, apart = record.order, record.sidebands or 0.0
        own = record.channel in (None, channel) and record.seen_in == "envelope"
        if not own or not reading.is_number(order) or not len(orders):
            continue
        places.append(order)
        for number in range(2, min(int(record.harmonics or 1), _MULTIPLES) + 1):
            if number * order <= panel.x[1]:
                panel.upright(number * order, color=LINES[1], width=0.7, alpha=0.45, name=f"multiple-{number}")
        for place in order + apart * _SIDEBANDS if apart > 0.0 else ():
            if panel.x[0] < place < panel.x[1]:
                panel.upright(place, color=LINES[3], dashes=TONE_DASHES, alpha=0.9, name="sideband")
    return ring_lines(panel, orders, values, places)


def envelope(
    envelope_map: xr.Dataset, *, channel: str | None = None, speed_rpm: float | None = None, ax: Axes | None = None
) -> Axes:
    """Order spectrum of the envelope at one speed, with its floor: strikes in bearings show here; returns the axes.

    Parameters
    ----------
    envelope_map : EnvelopeMap (channel, speed, order) of :func:`crankorder.envelope`
    channel : name of the channel; the first where not given
    speed_rpm : the nearest speed to this is drawn, rpm; without it that at which a line stands highest over the floor
    ax : axes to draw on; without them a new figure of pyplot's

    The highest lines are named above, where noise alone would not reach so high in one of a thousand pictures.
    Raises RequestError for another dataset, channel or axes.

    >>> import numpy as np, crankorder as co
    >>> rng, ring = np.random.default_rng(1), np.exp(-np.arange(60) / 15) * np.cos(1.9 * np.arange(60))
    >>> signal = np.convolve(np.arange(80_000) % 112 == 0, ring, "same") + 0.1 * rng.standard_normal(80_000)
    >>> recording = co.recording(signal, rate_hz=10_000, speed_rpm=1500.0)  # a strike every 112 samples: order 3.57
    >>> axes = co.plot.envelope(co.envelope(recording, bearings=[{"name": "drive end", "bpfo": 3.58, "bpfi": 5.42}]))
    >>> axes.get_title(loc="right").partition(",")[0]
    '1500 rpm'
    """
    dataset, number = channel_of(envelope_map, "envelope_map", "envelope", channel)
    order = np.asarray(dataset["order"].values, dtype=float)
    amplitude, floor = (values_of(dataset, name, "speed", "order", channel=number) for name in ("amplitude", "floor"))
    if not amplitude.size:
        amplitude = floor = np.zeros((1, len(order)))
    at = _speed_at(dataset, order, amplitude, floor, speed_rpm)
    axes = axes_for(ax, "envelope", height_in=4.2)
    lines = _significant_orders(order, amplitude[at], floor[at])
    texts = reading.order_texts([reading.nominal_order(place) for place in lines])
    marks = [(place, text, LINES[1]) for place, text in zip(lines, texts, strict=True)]
    quantity, _, scaling_and_unit = y_label(dataset, number).partition(" (")
    label = f"Envelope of {quantity.lower()}{scaling_and_unit.partition(')')[2]}"
    title, drawn = str(dataset["channel"].values[number]), dataset.isel(speed=slice(at, at + 1))
    where = ", ".join(filter(None, [*map(reading.speed_text, drawn["speed"].values), _band(drawn, number)]))
    dress(axes, x=ORDER, y=label, title=title, rows_above=bool(lines), note=where)
    scale(axes, order, log_limits(amplitude[at], DECADES, room=2.5))

    def content(panel: Panel) -> None:
        draw_envelope(panel, order, amplitude[at], floor[at])
        is_ringed = ring_lines(panel, order, amplitude[at], lines)
        label_column(panel, marks, "order")
        keys = [Key("stands out of the floor", LINES[1], ring=True)] if is_ringed else []
        keys_below(panel, [*_keys(panel.drawing, expected=False, found=False), *keys])

    return painted(axes, content)


def _speed_at(dataset: xr.Dataset, order: Floats, amplitude: Floats, floor: Floats, asked: float | None) -> int:
    """Index of the speed to draw: the nearest to ``asked``, else that of the highest line over the floor."""
    if asked is not None and dataset.sizes["speed"]:
        apart = np.abs(dataset["speed"].values - positive(asked, "speed_rpm", "envelope"))
        return int(np.argmin(np.nan_to_num(apart, nan=np.inf)))
    with np.errstate(divide="ignore", invalid="ignore"):
        over = np.where((floor > 0) & (order > 0), amplitude / floor, 0.0)
    over = over if np.any(over > 0) else np.where(order > 0, amplitude, 0.0)
    return int(np.argmax(np.max(np.nan_to_num(over), axis=1, initial=0.0)))


def _band(dataset: xr.Dataset, channel: int) -> str:
    """Frequency band [Hz] of which the envelope was taken, as text: its span over the speeds; empty where unknown."""
    low, high = (values_of(dataset, name, "speed", channel=channel) for name in ("band_low", "band_high"))
    return f"band {np.nanmin(low):.0f}–{np.nanmax(high):.0f} Hz" if np.isfinite(low).any() else ""


def _significant_orders(order: Floats, amplitude: Floats, floor: Floats) -> list[float]:
    """Orders of the strongest lines above the noise threshold, for noise of exponentially distributed power.

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
    return [float(order[place]) for place in np.sort(strongest)]
