"""The Campbell diagram of a channel: level over frequency and speed, with orders, natural frequencies and crossings.

A strip beside it shows speeds to avoid and bands that are free, on the scale of its speeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.findings import Findings, ModeFinding, OrderFinding
from crankorder.plot.cells import gaps_between, level_limits, level_of, pooled, speed_cells, with_gaps
from crankorder.plot.drawing import Drawing, Field, Rings, Stroke, Words, pixels_of
from crankorder.plot.labels import EdgeLabel, Key, draw_keys, fitted, head_of_test, label_right, label_top
from crankorder.plot.palette import (
    AVOID,
    DOUBT_DASHES,
    FAINT,
    FREE,
    HALF_ORDER,
    INK,
    MAINS,
    MAINS_ON_MAP,
    MODE,
    MODE_DASHES,
    MODE_ON_MAP,
    NOT_JUDGED,
    NOT_MEASURED,
    SMALL,
    TONE_DASHES,
    drawable,
    level_colours,
    rgb_of,
)
from crankorder.plot.panel import Panel
from crankorder.quantities import Floats
from crankorder.records import known
from crankorder.report.fixed_lines import fixed_frequencies
from crankorder.report.notation import (
    frequency_text,
    is_tone,
    is_undecided,
    is_whirl,
    level_reference,
    order_name,
    scaling_text,
)
from crankorder.report.sentences.of_speeds import free_bands, not_judged_rpm, open_bands
from crankorder.report.sentences.story import strongest_sentence
from crankorder.settings import ReportSettings

_LEFT, _BOTTOM, _RIGHT, _TOP = 0.95, 0.92, 1.75, 1.22  # margins of the diagram in inches
_NOTE = 2.2  # inches at the right of the foot, where a note on quality may stand
_WHITE = "#ffffff"
_MOST_GUIDES = 12


Mark = tuple[float, str, str]
"""Place along the axis, text and colour of what is named above a diagram."""


@dataclass(frozen=True)
class _Map:
    """Amplitudes (speed, frequency) of one channel where its speed is known, slowest first."""

    speed: Floats
    frequency: Floats
    amplitude: Floats
    reference: float
    unit: str

    @property
    def cells(self) -> Floats:
        return speed_cells(self.speed)


def campbell_figure(campbell: xr.Dataset, channel: str, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Campbell diagram of one channel, ready for :func:`crankorder.plot.painter.picture_bytes`.

    Speed [rpm] upwards, frequency [Hz] to the right, level in dB (reference on the colour bar) as colour; steps of
    speed reach half-way to their neighbours. Found orders are thin lines labelled where they leave the diagram,
    natural frequencies dashed lines labelled at the top (with a question mark and wider gaps where they are not
    decided), mains dotted, excited crossings circles; a strip at the right holds speeds to avoid and free ones. Where
    no findings were asked for, some whole orders are drawn for orientation.

    ``campbell`` a CampbellMap; ``channel`` one of its channels; ``findings`` of the same test; ``settings`` of the
    report. Raises KeyError for an unknown channel.
    """
    one = _map_of(campbell, channel, settings)
    drawing = Drawing(settings.width_in, settings.height_in)
    box = (_LEFT, _BOTTOM, settings.width_in - _LEFT - _RIGHT, settings.height_in - _BOTTOM - _TOP)
    ends = float(one.frequency[0]), float(one.frequency[-1])
    panel = Panel(drawing, box, ends, (float(one.cells[0, 0]), float(one.cells[-1, 1])))
    _draw_map(panel, one, settings=settings)
    orders = orders_of(findings, channel, limit=settings.max_labelled_orders)
    modes = fixed_frequencies(findings)
    guides = _guides(panel) if findings.not_asked_for else []
    _draw_orders(panel, guides or orders, findings)
    _draw_modes(panel, modes, channel)
    circles = _draw_crossings(panel, findings, channel)
    _draw_notes(panel, one)
    _label_edges(panel, guides or orders, modes, findings)
    keys = [Key("order, for orientation", FAINT)] if guides else _keys(orders=orders, modes=modes, circles=circles)
    draw_keys(drawing, _LEFT, [*keys, *strip_keys(findings)], room_in=settings.width_in - _LEFT - _NOTE)
    said = strongest_sentence(findings, channel)
    if findings.not_asked_for:
        said = "Level over frequency and speed; findings were not asked for."
    what = f"channel {drawable(channel, settings.max_name_characters)}"
    head_of_test(drawing, _LEFT, findings, what, drawable(said, 300), longest=settings.max_name_characters)
    return drawing


def orders_of(findings: Findings, channel: str, *, limit: int) -> list[OrderFinding]:
    """Order records of a ``channel`` in ``findings``, the ``limit`` strongest and as many of its half orders, by order.

    The half orders of a four-stroke cycle are what sets it apart: strong whole ones must not hide them.
    """
    records = [record for record in findings.orders if record.channel == channel]
    records.sort(key=lambda record: -record.amplitude)
    half = [record for record in records[limit:] if is_of_cycle(record)]
    return sorted([*records[:limit], *half[:limit]], key=lambda record: record.order)


def is_of_cycle(record: OrderFinding | Guide) -> bool:
    """Whether an order ``record`` is a half order that combustion or the camshaft of a four-stroke engine makes."""
    if not isinstance(record, OrderFinding) or not record.half_order:
        return False
    return not {"gas cycle", "half order of the four-stroke cycle"}.isdisjoint(record.kinds)


def _map_of(campbell: xr.Dataset, channel: str, settings: ReportSettings) -> _Map:
    names = campbell["channel"].values.tolist()
    if channel not in names:
        raise KeyError(channel)
    number, speed = names.index(channel), campbell["speed"].values
    amplitude = campbell["amplitude"].transpose("channel", "speed", "frequency").values[number]
    kept = np.flatnonzero(np.isfinite(speed) & np.isfinite(amplitude).any(axis=1))
    kept = kept[np.argsort(speed[kept], kind="stable")]
    quantity, unit = str(campbell["quantity"].values[number]), str(campbell["unit"].values[number])
    reference, level = level_reference(quantity, unit, settings=settings)
    level = level.replace("(peak)", scaling_text(campbell))
    return _Map(speed[kept], campbell["frequency"].values, np.nan_to_num(amplitude[kept]), reference, level)


def shades(one: _Map, limits: tuple[float, float], rows: int, columns: int) -> NDArray[np.uint8]:
    """Shade 1…255 of each of ``rows`` by ``columns`` pixels of a map ``one``, the first row the slowest; 0 is unknown.

    ``limits`` of level [dB] are the shades 1 and 255. A pixel shows the largest value under it.
    """
    values, edges = with_gaps(one.amplitude, one.cells, empty=-1.0)
    frequency = one.frequency
    half = (frequency[1] - frequency[0]) / 2 if len(frequency) > 1 else 0.5
    bins = np.concatenate([frequency - half, [frequency[-1] + half]])
    across = pooled(values, bins, np.linspace(float(frequency[0]), float(frequency[-1]), columns + 1), axis=1)
    share = (level_of(across, one.reference) - limits[0]) / (limits[1] - limits[0])
    shade = np.where(across < 0, 0, 1 + np.clip(255 * share, 0, 254)).astype(np.uint8)
    return pooled(shade, edges, np.linspace(float(edges[0]), float(edges[-1]), rows + 1), axis=0)


def _draw_map(panel: Panel, one: _Map, *, settings: ReportSettings) -> None:
    drawing, box = panel.drawing, panel.box
    limits = level_limits(one.amplitude, one.reference, range_db=settings.dynamic_range_db)
    colours = level_colours().copy()
    colours[0] = rgb_of(NOT_MEASURED)
    shade = shades(one, limits, *pixels_of(box, settings.dpi))
    drawing.add(Field(colours[shade[::-1]], box))
    panel.frame(whole=True)
    panel.x_axis("Frequency, Hz", grid=False)
    panel.y_axis("Speed, rpm", grid=False)
    bar = Panel(drawing, (box[0] + box[2] + 0.62, box[1], 0.17, box[3]), (0.0, 1.0), limits)
    drawing.add(Field(np.repeat(level_colours()[:0:-1, None], 2, axis=1), bar.box))
    bar.frame(whole=True)
    ticks = np.arange(10 * np.ceil(limits[0] / 10), limits[1] + 0.1, 10)
    bar.y_axis(f"Level, {one.unit}", places=ticks.tolist(), grid=False, right=True)


def _draw_notes(panel: Panel, one: _Map) -> None:
    for start, end in gaps_between(one.cells):
        if (end - start) * panel.box[3] > 0.3 * (panel.y[1] - panel.y[0]):
            panel.note("not measured", up=float(panel.share((start + end) / 2)))
    if not np.any(one.amplitude > 0):
        panel.note("no signal: every value is zero")


def _draw_orders(panel: Panel, orders: Sequence[OrderFinding | Guide], findings: Findings) -> None:
    low, high = panel.y
    everywhere = np.array([low, high])
    for record in orders:
        order = record.order
        of_line = known(record.speed_range_rpm) if isinstance(record, OrderFinding) else None
        seen = np.clip(np.array(of_line or (low, high)), low, high)
        name = f"order-{order_name(record, findings)}"
        parts = [(everywhere, 0.25), (seen, 0.5)] if isinstance(record, OrderFinding) else [(everywhere, 0.3)]
        for speed, alpha in parts:
            panel.curve(order * speed / 60, speed, color=_WHITE, width=0.7, alpha=alpha, name=name)


@dataclass(frozen=True)
class Guide:
    """A whole order that is drawn for orientation."""

    order: float
    amplitude: float = 0.0


def _guides(panel: Panel) -> list[Guide]:
    """Whole orders that run through the map, few enough to be told apart; they claim nothing."""
    highest = 60 * panel.x[1] / max(panel.y[1], 1.0)  # that leaves at the top
    step = next((one for one in (1, 2, 5, 10, 20, 50, 100) if highest / one <= _MOST_GUIDES), 0)
    orders = {1.0, *(float(order) for order in np.arange(step, highest, step))} if step else {1.0}
    return [Guide(order) for order in sorted(orders)]


def _draw_modes(panel: Panel, modes: list[ModeFinding], channel: str) -> None:
    """Natural frequencies and tones, fainter where another channel shows them; a whirl's moves with the speed."""
    for mode in modes:
        if is_whirl(mode):
            speed = np.array(panel.y)
            moved = (mode.speed_slope or 0.0) * (speed - (mode.reference_rpm or 0.0)) / 60.0
            panel.curve(mode.frequency_hz + moved, speed, color=MODE_ON_MAP, width=1.0, alpha=0.75, name="whirl")
            continue
        mains, doubt = is_tone(mode), is_undecided(mode)
        panel.upright(
            mode.frequency_hz, color=MAINS_ON_MAP if mains else MODE_ON_MAP,
            alpha=0.75 if channel in (mode.channels or (channel,)) else 0.4,
            dashes=TONE_DASHES if mains else DOUBT_DASHES if doubt else MODE_DASHES,
            name="tone" if mains else "doubt" if doubt else "mode",
        )  # fmt: skip


def _draw_crossings(panel: Panel, findings: Findings, channel: str) -> bool:
    places = [
        (crossing.mode_hz, crossing.rpm)
        for crossing in findings.crossings
        if crossing.excited and crossing.in_range and channel in (crossing.channels or (channel,))
    ]
    if places:
        x, y = (np.array(values) for values in zip(*places, strict=True))
        points = panel.at(x, y)
        panel.drawing.add(Rings(points, 5.5, "#000000", width=3.0, alpha=0.56))
        panel.drawing.add(Rings(points, 5.5, _WHITE, width=1.5, name="crossings", values=(x, y)))
    return bool(places)


def _label_edges(
    panel: Panel, orders: Sequence[OrderFinding | Guide], modes: list[ModeFinding], findings: Findings
) -> None:
    """Orders where their lines leave the diagram, natural frequencies and tones above; speeds to avoid at the right."""
    drawing, box = panel.drawing, panel.box
    left, bottom, width, height = box
    top, side = _order_labels(panel, orders, findings)
    lines = label_top(drawing, box, [fitted(top, width), fitted(edge_labels(panel, mode_marks(modes)), width)])
    avoid = draw_strip(panel, findings)
    shift = STRIP_IN if has_strip(findings) else 0.0
    label_right(drawing, (left, bottom, width + shift, height), [*side, *avoid])
    if top:
        drawing.add(Words(left - 0.3, lines[0], "order", SMALL, INK, along="right"))
    if side:
        drawing.add(Words(left + width + 0.06 + shift, bottom + height + 0.135, "order", SMALL, INK))


def mode_marks(modes: list[ModeFinding]) -> list[Mark]:
    """What ``modes`` are named above a diagram."""
    texts = [f"{frequency_text(mode.frequency_hz)}{'?' if is_undecided(mode) else ''} Hz" for mode in modes]
    return [
        (mode.frequency_hz, text, MAINS if is_tone(mode) else MODE) for mode, text in zip(modes, texts, strict=True)
    ]


def edge_labels(panel: Panel, marks: Sequence[Mark]) -> list[EdgeLabel]:
    """Labels of those of ``marks`` that lie within ``panel``."""
    return [
        EdgeLabel(float(panel.at(place, panel.y[0])[0, 0]), text, color, number)
        for number, (place, text, color) in enumerate(marks)
        if panel.x[0] <= place <= panel.x[1]
    ]


def _order_labels(
    panel: Panel, orders: Sequence[OrderFinding | Guide], findings: Findings
) -> tuple[list[EdgeLabel], list[EdgeLabel]]:
    """Labels of the order lines that leave at the top, and of those that leave at the right; the strongest is bold."""
    (f_low, f_high), (low, high) = panel.x, panel.y
    loudest = max((record.amplitude for record in orders), default=0.0)
    top, side = [], []
    for number, record in enumerate(orders):
        order, text = record.order, order_name(record, findings)
        bold = loudest > 0 and record.amplitude == loudest
        colour = HALF_ORDER if is_of_cycle(record) else INK
        if f_low <= order * high / 60 <= f_high:
            top.append(EdgeLabel(float(panel.at(order * high / 60, high)[0, 0]), text, colour, number, bold))
        elif low < 60 * f_high / order < high:
            side.append(EdgeLabel(float(panel.at(f_high, 60 * f_high / order)[0, 1]), text, colour, number, bold))
    return top, side


def _keys(*, orders: Sequence[OrderFinding | Guide], modes: list[ModeFinding], circles: bool) -> list[Key]:
    keys = [Key("order found (bold: strongest)", INK)] if orders else []
    if any(is_of_cycle(record) for record in orders):
        keys.append(Key("half order: combustion or camshaft", HALF_ORDER))
    return [*keys, *mode_keys(modes), *([Key("excited crossing", INK, ring=True)] if circles else [])]


def mode_keys(modes: list[ModeFinding]) -> list[Key]:
    """What the dashed and dotted lines of ``modes`` mean: natural frequencies, doubts, tones."""
    keys = []
    if any(not is_tone(mode) and not is_undecided(mode) for mode in modes):
        keys.append(Key("natural frequency", MODE, MODE_DASHES))
    if any(is_undecided(mode) for mode in modes):
        keys.append(Key("not decided", MODE, DOUBT_DASHES))
    of_mains = {mode.kinds == ("mains",) for mode in modes if is_tone(mode)}
    if of_mains:
        label = "mains or fixed tone" if len(of_mains) > 1 else "mains" if True in of_mains else "fixed tone"
        keys.append(Key(label, MAINS, TONE_DASHES))
    return keys


STRIP_IN = 0.13
"""Room in inches that the strip takes right of the diagram."""

_WIDTH_PT = 4.0
_AT_IN = 0.07  # middle of the strip from the diagram
_LABELS = 12  # speeds to avoid that are named, the worst
_LEAST_IN = 0.05  # a range is drawn at least this high
_OPEN_SHARE = 0.005  # of the speed, on either side of a crossing that was not judged


def has_strip(findings: Findings) -> bool:
    """True where the ``findings`` name ranges of speed to avoid, free ones or open ones."""
    return bool(_ranges(findings)) or bool(free_bands(findings)) or bool(open_bands(findings))


def _ranges(findings: Findings) -> list[tuple[float, float, float]]:
    """Low end, high end and middle of each range to stay out of."""
    every = findings.speeds_to_avoid or ()
    return [(*ends, one.rpm) for one in every if (ends := known(one.rpm_range)) is not None]


def draw_strip(panel: Panel, findings: Findings) -> list[EdgeLabel]:
    """Draw the strip of the ``findings`` right of ``panel``; the labels of the speeds to avoid, for its right edge."""
    low, high = panel.y
    for number, band in enumerate(open_bands(findings)):
        _mark(panel, (max(band[0], low), min(band[1], high)), NOT_JUDGED, f"not-free-{number}")
    for number, band in enumerate(free_bands(findings)):
        _mark(panel, (max(band[0], low), min(band[1], high)), FREE, f"free-{number}")
    for number, rpm in enumerate(_open_rpm(findings)):
        if low <= rpm <= high:
            _mark(panel, (rpm * (1 - _OPEN_SHARE), rpm * (1 + _OPEN_SHARE)), NOT_JUDGED, f"open-{number}")
    labels = []
    for number, (start, end, rpm) in enumerate(_ranges(findings)):
        if end <= low or start >= high:
            continue
        _mark(panel, (max(start, low), min(end, high)), AVOID, f"avoid-{number}")
        at = float(panel.at(panel.x[1], min(max(rpm, low), high))[0, 1])
        labels.append(EdgeLabel(at, f"{rpm:.0f}", AVOID, 1000 + number))
    return labels[:_LABELS]


def _open_rpm(findings: Findings) -> list[float]:
    """Speeds in free bands at which a crossing could not be judged."""
    return [rpm for rpm in not_judged_rpm(findings) if any(low <= rpm <= high for low, high in free_bands(findings))]


def _mark(panel: Panel, speeds: tuple[float, float], color: str, name: str) -> None:
    if speeds[1] <= speeds[0]:
        return
    x = panel.box[0] + panel.box[2] + _AT_IN
    bottom, top = (float(panel.at(panel.x[1], speed)[0, 1]) for speed in speeds)
    short = max(_LEAST_IN - (top - bottom), 0.0) / 2
    ends = np.array([[x, bottom - short], [x, top + short]])
    values = (np.array([np.nan, np.nan]), np.array(speeds))
    panel.drawing.add(Stroke(ends, color, _WIDTH_PT, square=True, name=name, values=values))


def strip_keys(findings: Findings) -> list[Key]:
    """What the colours of the strip of the ``findings`` mean."""
    keys = [Key("speed to avoid", AVOID, width=_WIDTH_PT)] if _ranges(findings) else []
    keys += [Key("free speeds", FREE, width=_WIDTH_PT)] if free_bands(findings) else []
    unknown = bool(open_bands(findings)) or bool(_open_rpm(findings))
    return [*keys, Key("not free, or not known", NOT_JUDGED, width=_WIDTH_PT)] if unknown else keys
