"""Order spectra of the envelope of every channel: strikes in bearings, with the lines that each bearing would show."""

from __future__ import annotations

from itertools import takewhile
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from crankorder.findings import Findings
from crankorder.plot.axes import axes_for, channel_of, dress, keys_below, painted, positive, scale, values_of, y_label
from crankorder.plot.drawing import ORDER, Drawing, Panel, Words, log_limits
from crankorder.plot.labels import EdgeLabel, Key, Mark, draw_keys, head_of_test, label_width_in
from crankorder.plot.palette import FAINT, LINES, MODE, MODE_DASHES, SMALL, TONE_DASHES, drawable, shortened
from crankorder.plot.reading import is_number, nominal_order, order_name, order_text, order_texts
from crankorder.plot.spectra_figure import DECADES, column_boxes, column_panels, draw_spectrum, label_column, ring_lines
from crankorder.quantities import Floats
from crankorder.settings import ReportSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LEFT, _RIGHT = 1.0, 0.3  # inches
_NAME_LETTERS = (60, 40, 30, 22, 16, 12, 8)  # of a bearing in a label, where there are several: the most that fit
_FLOOR = LINES[4]
_SIDEBANDS = 2  # marked on either side of a line that has some
_MULTIPLES = 12  # of a line that was found, marked at most
_MOST_NAMED = 6  # lines that a notebook's picture names
_CHANCE = 1e-3  # that noise alone is named there


def envelope_figure(envelope: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Per channel the envelope's order spectrum, averaged over the speeds, with its floor and the bearings' lines.

    Expected orders are dashed and named above; those that were found are circled, with their multiples as thin lines.
    ``envelope`` an EnvelopeMap; ``findings`` of the same test; ``settings`` of the report.
    """
    width = settings.width_in - _LEFT - _RIGHT
    drawing, (boxes,) = column_boxes(envelope.sizes["channel"], width, settings)
    mean, floor = (_mean_over_speeds(envelope, name) for name in ("amplitude", "floor"))
    panels = column_panels(drawing, boxes, envelope, mean, " (envelope)", settings=settings)
    records = [record for record in findings.bearings if record.seen_in == "envelope" and is_number(record.order)]
    texts = {record.order: order_name(record, findings) for record in records}
    seen = [(order, text, LINES[1]) for order, text in texts.items()]
    marks, is_line_seen = _expected(findings, width - _labels_width_in(seen)), False
    for number, (panel, channel) in enumerate(zip(panels, envelope["channel"].values.astype(str), strict=True)):
        for order, _, color in marks:
            panel.upright(order, color=color, width=0.8, alpha=0.7, dashes=MODE_DASHES, name="expected")
        draw_envelope(panel, envelope["order"].values, mean[number], floor[number])
        is_line_seen |= _draw_bearing_lines(panel, envelope["order"].values, mean[number], findings, channel)
        _write_band(panel, envelope, number)
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
    keys = [Key("floor", _FLOOR)] if drawing.strokes("floor") else []
    if expected:
        keys.append(Key("order expected of a bearing", MODE, MODE_DASHES))
    if found:
        keys += [Key("found", LINES[1], ring=True), Key("its multiples", LINES[1])]
    if drawing.strokes("sideband"):
        keys.append(Key("its sidebands", LINES[3], TONE_DASHES))
    return keys


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
    records = [record for record in findings.bearings if is_number(record.order_expected)]
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
        choices.append([(order, f"{', '.join([*of][:2])} {order_text(order)}", MODE) for order, of in texts.items()])
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
        own = record.channel in (None, channel) and record.seen_in == "envelope"
        if not own or not is_number(record.order) or not len(orders):
            continue
        order, multiples, apart = record.order, record.harmonics, record.sidebands
        places.append(order)
        for number in range(2, min(int(multiples) if is_number(multiples) else 1, _MULTIPLES) + 1):
            if number * order <= panel.x[1]:
                panel.upright(number * order, color=LINES[1], width=0.7, alpha=0.45, name=f"multiple-{number}")
        for number in range(-_SIDEBANDS, _SIDEBANDS + 1) if is_number(apart) and apart > 0 else ():
            place = order + number * float(apart or 0.0)
            if number and panel.x[0] < place < panel.x[1]:
                panel.upright(place, color=LINES[3], dashes=TONE_DASHES, alpha=0.9, name="sideband")
    return ring_lines(panel, orders, values, places)


def _write_band(panel: Panel, envelope: xr.Dataset, number: int) -> None:
    """Band of which the envelope was taken, at the right end of ``panel``; its span where speeds differ."""
    if "band_low" not in envelope or "band_high" not in envelope:
        return
    ends = []
    for name, worst in (("band_low", np.min), ("band_high", np.max)):
        values = np.atleast_1d(envelope[name].isel(channel=number).values)
        known = values[np.isfinite(values)]
        if not len(known):
            return
        ends.append(f"{float(worst(known)):.0f}")
    left, bottom, width, height = panel.box
    text = shortened(f"band {'–'.join(ends)} Hz", SMALL, width)
    panel.drawing.add(Words(left + width, bottom + height - 0.13, text, SMALL, FAINT, along="right", name="band"))


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
    texts = order_texts([nominal_order(place) for place in lines])
    marks = [(place, text, LINES[1]) for place, text in zip(lines, texts, strict=True)]
    quantity, _, scaling_and_unit = y_label(dataset, number).partition(" (")
    label = f"Envelope of {quantity.lower()}{scaling_and_unit.partition(')')[2]}"
    title, where = str(dataset["channel"].values[number]), _speed_and_band(dataset, number, at)
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
    speed = np.asarray(dataset["speed"].values, dtype=float)
    if asked is not None and len(speed):
        wanted = positive(asked, "speed_rpm", "envelope")
        return int(np.argmin(np.where(np.isfinite(speed), np.abs(speed - wanted), np.inf)))
    with np.errstate(divide="ignore", invalid="ignore"):
        over = np.where((floor > 0) & (order > 0), amplitude / floor, 0.0)
    over = over if np.any(over > 0) else np.where(order > 0, amplitude, 0.0)
    return int(np.argmax(np.max(np.nan_to_num(over), axis=1, initial=0.0)))


def _speed_and_band(dataset: xr.Dataset, channel: int, at: int) -> str:
    """Speed [rpm] and frequency band [Hz] of the spectrum drawn, as text."""
    if not dataset.sizes["speed"]:
        return ""
    speed = float(dataset["speed"].values[at])
    text = f"{speed:.0f} rpm" if np.isfinite(speed) else "speed not known"
    low, high = (float(values_of(dataset, name, "speed", channel=channel)[at]) for name in ("band_low", "band_high"))
    return f"{text}, band {low:.0f}–{high:.0f} Hz" if np.isfinite(low) and np.isfinite(high) else text


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
