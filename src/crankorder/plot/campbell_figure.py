"""Maps of a channel, the Campbell diagram and the order map: level over frequency or order and speed.

Orders, natural frequencies and crossings lie over the map; a strip beside it shows speeds to avoid and bands that are
free, on the scale of its speeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.findings import Findings, ModeFinding, OrderFinding
from crankorder.plot import reading
from crankorder.plot.axes import axes_for, channel_of, dress, findings_of, keys_below, painted, positive, scale, y_label
from crankorder.plot.drawing import ORDER, SOLID, Drawing, Field, Panel, Stroke, Words
from crankorder.plot.labels import (
    EdgeLabel,
    Key,
    draw_keys,
    edge_labels,
    fitted,
    head_of_test,
    label_right,
    label_top,
    mode_keys,
    mode_marks,
    mode_style,
)
from crankorder.plot.palette import (
    AVOID,
    FAINT,
    FREE,
    HALF_ORDER,
    INK,
    NOT_JUDGED,
    NOT_MEASURED,
    SMALL,
    WHITE,
    drawable,
    level_colours,
    rgb_of,
)
from crankorder.quantities import Bools, Floats
from crankorder.records import known
from crankorder.settings import ReportSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_REACH_STEPS = 2.0  # speeds more than twice so many typical steps apart leave a gap in the tested range …
_REACH_SHARE = 0.03  # … and more than twice this share of it
_LEAST_RANGE_DB = 20.0  # a colour scale spans at least this, so that noise alone looks like noise


def speed_cells(speeds_rpm: Floats) -> Floats:
    """Lower and upper edge [rpm] (speeds, 2) of the cell of each speed: half-way to its neighbours.

    ``speeds_rpm`` (speeds,) are rising, at least one; a single speed gets a cell of 5 %. The cells of the first and the
    last of several end at these speeds, as nothing was measured beyond. Next to a wide gap of the tested range a cell
    reaches as far as on its other side, as the gap was not measured.
    """
    speeds = np.asarray(speeds_rpm, dtype=float)
    halves = np.diff(speeds) / 2
    if not halves.any():
        half = max(0.025 * abs(float(speeds[0])), 1.0)
        return np.tile([speeds[0] - half, speeds[0] + half], (len(speeds), 1))
    usual, span = float(np.median(halves)), float(speeds[-1] - speeds[0])
    reach = max(2 * _REACH_STEPS * usual, _REACH_SHARE * span)
    halves = np.where(halves > reach, np.nan, halves)  # NaN: a gap
    down, up = np.append(np.nan, halves), np.append(halves, np.nan)
    low = speeds - np.where(np.isnan(down), np.nan_to_num(up, nan=usual), down)
    high = speeds + np.where(np.isnan(up), np.nan_to_num(down, nan=usual), up)
    return np.asarray(np.clip(np.stack([low, high], axis=1), speeds[0], speeds[-1]))


def gaps_before(cells: Floats) -> Bools:
    """True (speeds,) for each of ``cells`` (speeds, 2) [rpm] before which a range lies that no cell covers."""
    apart = cells[1:, 0] - cells[:-1, 1] > 1e-9 * np.maximum(np.abs(cells[1:, 0]), 1.0)
    return np.concatenate([[False], apart])


def gaps_between(cells: Floats) -> list[tuple[float, float]]:
    """Ranges [rpm] between neighbouring ``cells`` (speed, 2) that no cell covers."""
    return [(float(cells[at - 1, 1]), float(cells[at, 0])) for at in np.flatnonzero(gaps_before(cells))]


def with_gaps(values: NDArray[Any], cells: Floats, *, empty: float = np.nan) -> tuple[NDArray[Any], Floats]:
    """Rows (rows, bins) of a map and their edges (rows + 1,) [rpm], with a row of ``empty`` for every gap.

    ``values`` are (speeds, bins), ``cells`` (speeds, 2) [rpm] those of :func:`speed_cells`.
    """
    gap = np.flatnonzero(gaps_before(cells))
    rows = np.insert(values, gap, empty, axis=0)
    return rows, np.concatenate([cells[:1, 0], np.sort(np.concatenate([cells[:, 1], cells[gap, 0]]))])


def bin_edges(centres: Floats) -> Floats:
    """Edges (bins + 1,) of bins around rising ``centres`` (bins,), in their unit; the outermost are symmetric."""
    if len(centres) < 2:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = (centres[1:] + centres[:-1]) / 2
    return np.concatenate([[2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]])


def pooled(values: NDArray[Any], edges: Floats, pixels: Floats, *, axis: int) -> NDArray[Any]:
    """Largest value under each pixel: thin lines survive, pixels narrower than a cell repeat it, outside is -inf.

    A cell belongs to the pixels that begin in it, else to the one that it lies in, so that no line grows wider.

    ``values`` (none of them NaN) of n cells with ascending ``edges`` (n + 1,) along ``axis``; ``pixels`` (m + 1,) are
    the edges of the pixels in the same unit, ascending or descending.
    """
    if pixels[0] > pixels[-1]:
        return np.flip(pooled(values, edges, pixels[::-1], axis=axis), axis)
    n = values.shape[axis]
    first = np.searchsorted(edges, pixels[:-1], side="right") - 1
    stop = np.searchsorted(edges, pixels[1:], side="left")
    begin = np.clip(first, 0, n - 1)
    last = int(np.clip(stop[-1], begin[-1] + 1, n))
    taken = np.maximum.reduceat(np.take(values, np.arange(last), axis=axis), begin, axis=axis)
    outside = (stop <= 0) | (first >= n)
    if not outside.any():
        return np.asarray(taken)
    shape = [-1 if number == axis else 1 for number in range(values.ndim)]
    return np.where(outside.reshape(shape), -np.inf, taken)


def level_of(values: Any, reference: float) -> Any:
    """Level [dB] of amplitudes ``values`` (any shape) over ``reference``, in one unit; 1e-300 to 1e300 are in range."""
    wide = np.asarray(values, dtype=np.float64)  # 1e-300 is zero in 32 bits
    return 20 * (np.log10(np.maximum(wide, 1e-300)) - np.log10(reference))


def level_limits(
    amplitude: NDArray[Any], reference: float, *, range_db: float, narrow: bool = False
) -> tuple[float, float]:
    """Ends (low, high) of a colour scale [dB]: the strongest line above, the quietest twentieth of the map below.

    ``amplitude`` (any shape) is that of a map, ``reference`` that of its level in the same unit; ``range_db`` is the
    greatest range, which may be less than 20 dB where ``narrow``.
    """
    values = amplitude[amplitude > 0]
    if not len(values):
        return 0.0, range_db
    twentieth = np.partition(values, len(values) // 20)[len(values) // 20]
    quiet = 5 * float(np.floor(level_of(twentieth, reference) / 5))
    top = 5 * float(np.ceil(level_of(values.max(), reference) / 5))
    least_db = min(_LEAST_RANGE_DB, range_db) if narrow else _LEAST_RANGE_DB
    return min(max(quiet, top - range_db), top - least_db), top


_LEFT, _BOTTOM, _RIGHT, _TOP = 0.95, 0.92, 1.75, 1.22  # margins of the diagram in inches
_NOTE = 2.2  # inches at the right of the foot, where a note on quality may stand
_MOST_GUIDES = 12
_MOST_ORDERS = 12  # that a notebook's picture names
_STRIP_HIGH_IN, _HIGH_IN = 3.2, 5.6  # a notebook's picture of one speed, and of several
_CURVE_POINTS = 200


@dataclass(frozen=True)
class LevelMap:
    """``amplitude`` (speeds, places) of one channel at ``speed`` (speeds,) [rpm], rising, and ``place`` (places,).

    Places are frequencies [Hz], or orders where ``by_order``. ``label`` is that of the level, which refers to
    ``reference``; ``unknown`` spectra have no speed and are not shown. Where no speed at all is known, spectra are
    stacked by number.
    """

    speed: Floats
    place: Floats
    amplitude: Floats
    reference: float
    label: str
    by_order: bool = False
    unknown: int = 0

    @property
    def timeless(self) -> bool:
        """True where no speed at all is known."""
        return not np.isfinite(self.speed).any()

    @property
    def cells(self) -> Floats:
        """Lower and upper edge of each spectrum, (speed, 2): in rpm, or by number where no speed is known."""
        if self.timeless:
            number = np.arange(max(len(self.speed), 1), dtype=float)
            return np.stack([number, number + 1.0], axis=1)
        return speed_cells(self.speed)

    def rpm(self, height: Floats | float) -> Floats:
        """Speed [rpm] at a ``height`` (any shape) of the map; a strip of one speed has that speed at any height."""
        alone = len(self.speed) == 1 and not self.timeless
        return np.asarray(self.speed[0] + 0.0 * np.asarray(height) if alone else height)

    def of_order(self, order: float, height: Floats | float) -> Floats:
        """Abscissa of an ``order`` at the ordinate ``height`` [rpm]: its frequency [Hz], or itself on an order map.

        ``height`` has any shape, which the result has too.
        """
        rpm = self.rpm(height)
        return order + 0.0 * rpm if self.by_order else order * rpm / 60

    def of_hertz(self, hertz: Floats | float, height: Floats | float) -> Floats:
        """Abscissa of a frequency ``hertz`` [Hz] at the ordinate ``height`` [rpm]: itself, or an order on an order map.

        ``hertz`` and ``height`` have any shapes that broadcast; the result has their joint shape.
        """
        rpm = self.rpm(height)
        return 60 * hertz / rpm if self.by_order else hertz + 0.0 * rpm


def level_map(dataset: xr.Dataset, channel: int, along: str, reference: float, label: str) -> LevelMap:
    """LevelMap of the channel with index ``channel`` of ``dataset`` over ``along``, "frequency" or "order".

    ``dataset`` is a CampbellMap or OrderMap (channel, speed, ``along``); ``reference`` is that of the levels, in the
    channel's unit, and ``label`` states it.
    """
    speed, by_order = np.asarray(dataset["speed"].values, dtype=float), along == "order"
    amplitude = dataset["amplitude"].transpose("channel", "speed", along).values[channel]
    measured = np.isfinite(amplitude).any(axis=1)
    placed = measured & np.isfinite(speed)
    kept = np.flatnonzero(placed if placed.any() else measured)
    kept = kept[np.argsort(speed[kept], kind="stable")]
    shown = np.nan_to_num(amplitude[kept], nan=-1.0 if by_order else 0.0)  # an order that no speed carries is unknown
    unknown = int(np.sum(measured & ~placed)) if placed.any() else 0
    return LevelMap(speed[kept], dataset[along].values, shown, reference, label, by_order, unknown)


def campbell_figure(
    campbell: xr.Dataset, channel: str, findings: Findings, *, settings: ReportSettings, sentence: str = ""
) -> Drawing:
    """Campbell diagram of one channel, ready for :func:`crankorder.plot.painter.picture_bytes`.

    Speed [rpm] upwards, frequency [Hz] to the right, level in dB (reference on the colour bar) as colour; steps of
    speed reach half-way to their neighbours. Found orders are thin lines labelled where they leave the diagram,
    natural frequencies dashed lines labelled at the top (with a question mark and wider gaps where they are not
    decided), mains dotted, excited crossings circles; a strip at the right holds speeds to avoid and free ones. Where
    no findings were asked for, some whole orders are drawn for orientation.

    ``campbell`` is a CampbellMap (channel, speed, frequency), ``channel`` one of its channels, ``findings`` are those
    of the same test, ``settings`` those of the report; ``sentence`` stands below the title. Raises ValueError for an
    unknown channel.
    """
    number = campbell["channel"].values.tolist().index(channel)
    reference, text = reading.channel_level(campbell, number, settings=settings)
    levels = level_map(campbell, number, "frequency", reference, f"Level, {text}")
    drawing = Drawing(settings.width_in, settings.height_in, dpi=settings.dpi)
    box = (_LEFT, _BOTTOM, settings.width_in - _LEFT - _RIGHT, settings.height_in - _BOTTOM - _TOP)
    ends = float(levels.place[0]), float(levels.place[-1])
    panel = Panel(drawing, box, ends, (float(levels.cells[0, 0]), float(levels.cells[-1, 1])))
    draw_levels(panel, levels, level_limits(levels.amplitude, reference, range_db=settings.dynamic_range_db))
    panel.frame(whole=True)
    panel.x_axis("Frequency, Hz", grid=False)
    panel.y_axis("Speed, rpm", grid=False)
    keys = draw_findings(panel, levels, findings, channel, limit=settings.max_labelled_orders)
    draw_keys(drawing, _LEFT, keys, room_in=settings.width_in - _LEFT - _NOTE)
    if findings.not_asked_for:
        sentence = "Level over frequency and speed; findings were not asked for."
    what = f"channel {drawable(channel, settings.max_name_characters)}"
    head_of_test(drawing, _LEFT, findings, what, drawable(sentence, 300), longest=settings.max_name_characters)
    return drawing


def draw_levels(panel: Panel, levels: LevelMap, limits: tuple[float, float]) -> None:
    """Draw ``levels`` as colours over ``panel``, from the first to the second of ``limits`` in dB, and their bar."""
    drawing, (left, bottom, width, height), (quietest, loudest) = panel.drawing, panel.box, limits
    colours = level_colours().copy()
    colours[0] = rgb_of(NOT_MEASURED)
    # shades 1…255 of each pixel, the first row the slowest, 0 where unknown: the largest value under it
    values, edges = with_gaps(levels.amplitude, levels.cells, empty=-1.0)
    x, y = panel.pixel_edges()
    across = pooled(values, bin_edges(levels.place), x, axis=1)
    share = (level_of(across, levels.reference) - quietest) / (loudest - quietest)
    shade = np.where(across < 0, 0, 1 + np.clip(255 * share, 0, 254)).astype(np.uint8)
    shades = np.asarray(np.maximum(pooled(shade, edges, y, axis=0), 0), dtype=np.uint8)
    drawing.add(Field(colours[shades[::-1]], panel.box))
    bar = Panel(drawing, (left + width + 0.62, bottom, 0.17, height), (0.0, 1.0), limits)
    drawing.add(Field(np.repeat(level_colours()[:0:-1, None], 2, axis=1), bar.box))
    bar.frame(whole=True)
    ticks = np.arange(10 * np.ceil(quietest / 10), loudest + 0.1, 10)
    bar.y_axis(levels.label, places=ticks.tolist(), grid=False, right=True)


def draw_findings(panel: Panel, levels: LevelMap, findings: Findings, channel: str, *, limit: int) -> list[Key]:
    """Keys of what is drawn over ``levels`` from the ``findings`` on a ``channel``, with labels around ``panel``.

    At most ``limit`` orders are drawn.
    """
    lines = _order_lines(panel, levels, findings, channel, limit)
    modes = [] if levels.timeless and levels.by_order else reading.fixed_frequencies(findings)
    strip = _strip(findings)
    for line in lines:
        name = f"order-{line.text}"
        parts = [(panel.y, 0.25), (line.seen, 0.5)] if line.seen else [(panel.y, 0.3)]
        for ends, alpha in parts:
            speed = np.clip(np.array(ends), *panel.y)
            panel.curve(levels.of_order(line.order, speed), speed, color=WHITE, width=0.7, alpha=alpha, name=name)
    _draw_modes(panel, levels, modes, channel)
    circles = not levels.timeless and _draw_crossings(panel, levels, findings, channel)
    low, high = panel.y
    for start, end in np.clip(gaps_between(levels.cells), low, high).reshape(-1, 2).tolist():
        if (end - start) * panel.box[3] > 0.3 * (high - low):
            panel.note("not measured", at_in=panel.height_at((start + end) / 2))
    if not len(levels.speed):
        panel.note("nothing was measured")
    elif not np.any(levels.amplitude > 0):
        panel.note("no signal: every value is zero")
    _label_edges(panel, levels, lines, modes, strip)
    if findings.not_asked_for:
        keys = [Key("order, for orientation", FAINT)]
    else:
        keys = [Key("order found (bold: strongest)", INK)] if lines else []
        keys += [Key("half order: combustion or camshaft", HALF_ORDER)] * any(line.color != INK for line in lines)
        keys += mode_keys(modes) + [Key("excited crossing", INK, ring=True)] * circles
    meaning = {AVOID: "speed to avoid", FREE: "free speeds", NOT_JUDGED: "not free, or not known"}
    shown = {color for color, *_ in strip}
    return keys + [Key(text, color, width=_WIDTH_PT) for color, text in meaning.items() if color in shown]


def orders_of(findings: Findings, channel: str, *, limit: int) -> list[OrderFinding]:
    """Order records of a ``channel`` in ``findings``, the ``limit`` strongest and as many of its half orders, by order.

    The half orders of a four-stroke cycle are what sets it apart: strong whole ones must not hide them.
    """
    records = sorted((of for of in findings.orders if of.channel == channel), key=lambda record: -record.amplitude)
    half = [record for record in records[limit:] if _is_of_cycle(record)]
    return sorted([*records[:limit], *half[:limit]], key=lambda record: record.order)


def _is_of_cycle(record: OrderFinding) -> bool:
    """Whether an order ``record`` is a half order that combustion or the camshaft of a four-stroke engine makes."""
    return record.half_order and not {"gas cycle", "half order of the four-stroke cycle"}.isdisjoint(record.kinds)


@dataclass(frozen=True)
class _OrderLine:
    """An order on a map: where it was ``seen`` [rpm], None for one that is drawn for orientation alone."""

    order: float
    text: str
    seen: tuple[float, float] | None = None
    color: str = INK
    bold: bool = False


def _order_lines(panel: Panel, levels: LevelMap, findings: Findings, channel: str, limit: int) -> list[_OrderLine]:
    """Orders found in a ``channel``; where no findings were asked for, whole orders that cross the map, at most 12."""
    if findings.not_asked_for:
        highest = panel.x[1] if levels.by_order else 60 * panel.x[1] / max(panel.y[1], 1.0)  # that leaves at the top
        step = next((step for step in (1, 2, 5, 10, 20, 50, 100) if highest / step <= _MOST_GUIDES), 0)
        orders = {1.0, *(map(float, np.arange(step, highest, step)) if step else ())}
        return [_OrderLine(order, reading.order_text(order)) for order in sorted(orders)]
    records = [] if levels.timeless else orders_of(findings, channel, limit=limit)
    loudest, lines = max((record.amplitude for record in records), default=0.0), []
    for record in records:
        seen, color = known(record.speed_range_rpm) or panel.y, HALF_ORDER if _is_of_cycle(record) else INK
        bold = record.amplitude == loudest > 0
        lines.append(_OrderLine(record.order, reading.order_name(record, findings), seen, color, bold))
    return lines


def _draw_modes(panel: Panel, levels: LevelMap, modes: list[ModeFinding], channel: str) -> None:
    """Lines of natural frequencies and tones, fainter if seen in another channel only; a whirl's line slopes."""
    low, high = panel.y
    speed = np.linspace(max(low, 1e-3 * high), high, _CURVE_POINTS) if levels.by_order else np.array(panel.y)
    for mode in modes:
        name, _, color, dashes = mode_style(mode)
        alpha = 0.75 if channel in (mode.channels or (channel,)) else 0.4
        if whirl := reading.is_whirl(mode):
            name, dashes, alpha = "whirl", SOLID, 0.75
        if whirl or levels.by_order:
            slope = (mode.speed_slope or 0.0) if whirl else 0.0
            moved = slope * (levels.rpm(speed) - (mode.reference_rpm or 0.0)) / 60.0
            x, width = levels.of_hertz(mode.frequency_hz + moved, speed), 1.0 if whirl else 0.8
            panel.curve(x, speed, color=color, width=width, alpha=alpha, dashes=dashes, name=name)
        else:
            panel.upright(mode.frequency_hz, color=color, alpha=alpha, dashes=dashes, name=name)


def _draw_crossings(panel: Panel, levels: LevelMap, findings: Findings, channel: str) -> bool:
    met = [of for of in findings.crossings if of.excited and of.in_range and channel in (of.channels or (channel,))]
    if met:
        hertz, rpm = np.array([(crossing.mode_hz, crossing.rpm) for crossing in met]).T
        for color, width, alpha, name in (("#000000", 3.0, 0.56, ""), (WHITE, 1.5, 1.0, "crossings")):
            panel.rings(levels.of_hertz(hertz, rpm), rpm, color=color, radius=5.5, width=width, alpha=alpha, name=name)
    return bool(met)


def _label_edges(
    panel: Panel, levels: LevelMap, lines: list[_OrderLine], modes: list[ModeFinding], strip: list[_StripBand]
) -> None:
    """Orders where their lines leave the diagram, natural frequencies and tones above; speeds to avoid at the right."""
    drawing, (left, bottom, width, height) = panel.drawing, panel.box
    (f_low, f_high), (low, high) = panel.x, panel.y
    top, side = [], []
    for number, line in enumerate(lines):
        place, rpm = float(levels.of_order(line.order, high)), 60 * f_high / line.order
        if f_low <= place <= f_high:
            top.append(EdgeLabel(float(panel.at(place, high)[0, 0]), line.text, line.color, number, line.bold))
        elif not levels.by_order and low < rpm < high and len(levels.speed) > 1:
            side.append(EdgeLabel(panel.height_at(rpm), line.text, line.color, number, line.bold))
    marks = [(float(levels.of_hertz(hertz, high)), text, color) for hertz, text, color in mode_marks(modes)]
    text_heights = label_top(drawing, panel.box, [fitted(top, width), fitted(edge_labels(panel, marks), width)])
    avoid = [] if levels.timeless else _draw_strip(panel, strip)
    shift = _STRIP_IN if strip else 0.0
    label_right(drawing, (left, bottom, width + shift, height), [*side, *avoid])
    if top:
        drawing.add(Words(left - 0.3, text_heights[0], "order", SMALL, INK, along="right"))
    if side:
        drawing.add(Words(left + width + 0.06 + shift, bottom + height + 0.135, "order", SMALL, INK))


_STRIP_IN = 0.13  # room that the strip takes right of the diagram
_WIDTH_PT = 4.0
_AT_IN = 0.07  # middle of the strip from the diagram
_LABELS = 12  # speeds to avoid that are named, the worst
_LEAST_IN = 0.05  # a range is drawn at least this high
_OPEN_SHARE = 0.005  # of the speed, on either side of a crossing that was not judged

_StripBand = tuple[str, str, float, float, float | None]
"""Colour, name, lower and upper end [rpm] of a part of the strip; and the speed by which a range to avoid is named."""


def _strip(findings: Findings) -> list[_StripBand]:
    """Parts of the strip: bands that are not free, free ones, crossings in these not judged, speeds to avoid."""
    free = reading.free_bands(findings)
    unsure = [rpm for rpm in reading.not_judged_rpm(findings) if any(low <= rpm <= high for low, high in free)]
    avoided = [(known(avoid.rpm_range), avoid.rpm) for avoid in findings.speeds_to_avoid or ()]
    return [
        *((NOT_JUDGED, "not-free", *ends, None) for ends in reading.open_bands(findings)),
        *((FREE, "free", *ends, None) for ends in free),
        *((NOT_JUDGED, "open", rpm * (1 - _OPEN_SHARE), rpm * (1 + _OPEN_SHARE), None) for rpm in unsure),
        *((AVOID, "avoid", *ends, rpm) for ends, rpm in avoided if ends),
    ]


def _draw_strip(panel: Panel, strip: list[_StripBand]) -> list[EdgeLabel]:
    """Draw the ``strip`` right of ``panel``; the labels of the speeds to avoid, for its right edge."""
    (low, high), x = panel.y, panel.box[0] + panel.box[2] + _AT_IN
    labels = []
    for number, (color, name, *rpms, named_rpm) in enumerate(strip):
        ends = np.clip(rpms, low, high)
        if ends[1] <= ends[0]:
            continue
        bottom, top = map(panel.height_at, ends)
        spare = max(_LEAST_IN - (top - bottom), 0.0) / 2
        points, values = np.array([[x, bottom - spare], [x, top + spare]]), (np.full(2, np.nan), ends)
        panel.drawing.add(Stroke(points, color, _WIDTH_PT, square=True, name=f"{name}-{number}", values=values))
        if named_rpm is not None:
            at = panel.height_at(float(np.clip(named_rpm, low, high)))
            labels.append(EdgeLabel(at, f"{named_rpm:.0f}", AVOID, 1000 + number))
    return labels[:_LABELS]


def campbell(
    campbell_map: xr.Dataset,
    findings: Findings | Mapping[str, object] | None = None,
    *,
    channel: str | None = None,
    ax: Axes | None = None,
    dynamic_range_db: float = 60.0,
) -> Axes:
    """Campbell diagram: frequency [Hz] to the right, speed [rpm] upwards, level as colour; returns the axes.

    Parameters
    ----------
    campbell_map : CampbellMap of :func:`crankorder.campbell_map`; ``campbell_map.sel(frequency=slice(0, 200))`` is
        a part of it
    findings : what :func:`crankorder.diagnose` returns of the same recordings. Found orders are thin lines labelled
        where they leave the axes, the strongest bold; natural frequencies are dashed and named above, with "?" where
        they are not decided; tones of fixed frequency are dotted; excited crossings are circled; a strip at the right
        holds speeds to avoid and free ones
    channel : name of the channel; the first where not given
    ax : axes to draw on; without them a new figure of pyplot's
    dynamic_range_db : the colours reach at most so many dB below the strongest line; > 0

    The level is in dB re 1 unit of the channel. Cells of speed reach half-way to their neighbours, wider gaps stay
    blank. One speed alone is a strip. Raises RequestError for another dataset, channel or axes.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> recording = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> axes = co.plot.campbell(co.campbell_map(recording, max_frequency_hz=200.0))
    >>> axes.get_xlabel(), axes.get_ylabel()
    ('Frequency, Hz', 'Speed, rpm')
    """
    return _on_axes(campbell_map, "frequency", findings, channel, ax, dynamic_range_db)


def order_map(
    order_map: xr.Dataset,
    findings: Findings | Mapping[str, object] | None = None,
    *,
    channel: str | None = None,
    ax: Axes | None = None,
    dynamic_range_db: float = 60.0,
) -> Axes:
    """Order map: order to the right, speed [rpm] upwards, level as colour; returns the axes.

    Parameters
    ----------
    order_map : OrderMap of :func:`crankorder.order_map`; ``order_map.sel(order=slice(0, 10))`` is a part of it
    findings : what :func:`crankorder.diagnose` returns of the same recordings. Found orders are thin lines labelled
        above, the strongest bold; natural frequencies are dashed curves, with "?" where they are not decided; tones of
        fixed frequency are dotted; excited crossings are circled; a strip at the right holds speeds to avoid and free
        ones
    channel : name of the channel; the first where not given
    ax : axes to draw on; without them a new figure of pyplot's
    dynamic_range_db : the colours reach at most so many dB below the strongest line; > 0

    The level is in dB re 1 unit of the channel. Cells of speed reach half-way to their neighbours, wider gaps stay
    blank. One speed alone, known or not, is a strip. Raises RequestError for another dataset, channel or axes.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> recording = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> axes = co.plot.order_map(co.order_map(recording))
    >>> axes.get_xlabel()
    'Order (cycles per crank revolution)'
    """
    return _on_axes(order_map, "order", findings, channel, ax, dynamic_range_db)


def _on_axes(
    given: xr.Dataset, along: str, findings: object, channel: str | None, ax: Axes | None, dynamic_range_db: float
) -> Axes:
    picture, x = ("campbell", "Frequency, Hz") if along == "frequency" else ("order_map", ORDER)
    dataset, number = channel_of(given, picture.replace("campbell", "campbell_map"), picture, channel)
    shown = findings_of(findings, picture)
    depth = positive(dynamic_range_db, "dynamic_range_db", picture)
    label, name = y_label(dataset, number, reference="dB re 1 "), str(dataset["channel"].values[number])
    levels = level_map(dataset, number, along, 1.0, label)
    limits = level_limits(levels.amplitude, 1.0, range_db=depth, narrow=True)
    axes = axes_for(ax, picture, height_in=_HIGH_IN if len(levels.speed) > 1 else _STRIP_HIGH_IN)
    rows = bool(orders_of(shown, name, limit=1)) + bool(reading.fixed_frequencies(shown))
    remark = f"{levels.unknown} of unknown speed not shown" if levels.unknown else ""
    y = "Speed not known" if levels.timeless else "Speed, rpm"
    dress(axes, x=x, y=y, title=name, whole=True, rows_above=rows, note=remark)
    ends = levels.place if len(levels.place) > 1 else bin_edges(levels.place)
    scale(axes, ends, (levels.cells[0, 0], levels.cells[-1, 1]), log_y=False)
    if levels.timeless:
        axes.set_yticks([])
    elif len(levels.speed) == 1:
        axes.set_yticks(levels.speed, [f"{levels.speed[0]:.0f}"])

    def content(panel: Panel) -> None:
        if len(levels.speed):
            draw_levels(panel, levels, limits)
        keys_below(panel, draw_findings(panel, levels, shown, name, limit=_MOST_ORDERS))

    return painted(axes, content)
