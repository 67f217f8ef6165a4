"""Order spectra of the envelope of every channel: strikes in bearings, with the lines that each bearing would show."""

from __future__ import annotations

from itertools import takewhile

import numpy as np
import xarray as xr

from crankorder.findings import Findings
from crankorder.plot.drawing import Drawing, Rings, Words
from crankorder.plot.labels import EdgeLabel, Key, draw_keys, head_of_test, label_width_in
from crankorder.plot.palette import FAINT, LINES, MODE, MODE_DASHES, SMALL, TONE_DASHES, drawable, shortened
from crankorder.plot.panel import Panel
from crankorder.quantities import Floats
from crankorder.report.campbell_figure import Mark
from crankorder.report.notation import is_number, order_name, order_text
from crankorder.report.spectra_figure import column_boxes, column_panels, draw_spectra, label_column
from crankorder.settings import ReportSettings

_LEFT, _RIGHT = 1.0, 0.3  # inches
_NAME_LETTERS = (60, 40, 30, 22, 16, 12, 8)  # of a bearing in a label, where there are several: the most that fit
_FLOOR = LINES[4]
_SIDEBANDS = 2  # marked on either side of a line that has some
_MULTIPLES = 12  # of a line that was found, marked at most


def envelope_figure(envelope: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Per channel the envelope's order spectrum, averaged over the speeds, with its floor and the bearings' lines.

    Expected orders are dashed and named above; those that were found are circled, with their multiples as thin lines.
    ``envelope`` an EnvelopeMap; ``findings`` of the same test; ``settings`` of the report.
    """
    drawing, heights = column_boxes(envelope.sizes["channel"], _LEFT, settings)
    width = settings.width_in - _LEFT - _RIGHT
    places = [(_LEFT, bottom, width, height) for bottom, height in heights]
    mean, floor = (_mean_over_speeds(envelope, name) for name in ("amplitude", "floor"))
    panels = column_panels(drawing, places, envelope, "order", mean, " (envelope)", settings=settings)
    records = [record for record in findings.bearings if record.seen_in == "envelope" and is_number(record.order)]
    texts = {record.order: order_name(record, findings) for record in records}
    seen = [(order, text, LINES[1]) for order, text in texts.items()]
    marks, found = _expected(findings, width - _room_of(seen)), False
    for panel in panels:
        for order, _, color in marks:
            panel.upright(order, color=color, width=0.8, alpha=0.7, dashes=MODE_DASHES, name="expected")
    draw_spectra(panels, envelope["order"].values, mean)
    for number, panel in enumerate(panels):
        if np.any(floor[number] > 0):
            level = np.where(floor[number] > 0, floor[number], np.nan)
            panel.curve(envelope["order"].values, level, color=_FLOOR, width=1.4, name="floor")
    for number, (panel, channel) in enumerate(zip(panels, envelope["channel"].values.astype(str), strict=True)):
        found |= _draw_found(panel, envelope["order"].values, mean[number], findings, channel)
        _write_band(panel, envelope, number)
    label_column(panels[0], [*marks, *seen], "")
    draw_keys(drawing, _LEFT, _keys(drawing, expected=bool(marks), found=found))
    said = _subtitle(envelope.sizes["speed"], bool(marks), found)
    head_of_test(drawing, _LEFT, findings, "envelope spectra", said, longest=settings.max_name_characters)
    return drawing


def _keys(drawing: Drawing, *, expected: bool, found: bool) -> list[Key]:
    keys = [Key("floor", _FLOOR)] if drawing.strokes("floor") else []
    if expected:
        keys.append(Key("order expected of a bearing", MODE, MODE_DASHES))
    if found:
        keys += [Key("found", LINES[1], ring=True), Key("its multiples", LINES[1])]
    if drawing.strokes("sideband"):
        keys.append(Key("its sidebands", LINES[3], TONE_DASHES))
    return keys


def _subtitle(n_speeds: int, marks: bool, found: bool) -> str:
    over = f"Mean over {n_speeds} speeds: " if n_speeds > 1 else ""
    said = f"{over}how the ringing above the orders comes and goes, by order of the shaft."
    if not marks:
        return f"{said} No bearing was named, or none of its lines is told."
    return said if found else f"{said} No bearing line stands over the floor."


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
    made: list[Mark] = []
    for letters in _NAME_LETTERS:
        made = _expected_with(findings, letters)
        if _room_of(made) <= width_in:
            break
    return made


def _expected_with(findings: Findings, letters: int) -> list[Mark]:
    """The same with no more than ``letters`` of a name."""
    records = [record for record in findings.bearings if is_number(record.order_expected)]
    names = _short({drawable(record.name, _NAME_LETTERS[0]) for record in records}, letters)
    marks: dict[float, list[str]] = {}
    for record in sorted(records, key=lambda one: one.order_expected):
        text = drawable(str(record.line or "").replace("*", "·"), _NAME_LETTERS[0])
        if len(names) > 1:
            text = f"{text} {names[drawable(record.name, _NAME_LETTERS[0])]}"
        texts = marks.setdefault(record.order_expected, [])
        if text not in texts:
            texts.append(text)
    return [(order, f"{', '.join(texts[:2])} {order_text(order)}", MODE) for order, texts in marks.items()]


def _short(names: set[str], letters: int) -> dict[str, str]:
    """Each of ``names`` in at most ``letters``: what they begin with alike goes first, then the middle of the rest.

    Bearings of one machine mostly differ at the end: "gearbox, drive end" and "gearbox, fan end".
    """
    alike = "".join(each[0] for each in takewhile(lambda letters: len({*letters}) == 1, zip(*names, strict=False)))
    start = max(alike.rfind(" "), alike.rfind("_"), alike.rfind("-")) + 1

    def cut(name: str) -> str:
        if len(name) <= letters:
            return name
        rest = name[start:]
        return rest if len(rest) <= letters else f"{rest[: letters // 2]}…{rest[-(letters - letters // 2 - 1) :]}"

    return {name: cut(name) for name in names}


def _room_of(marks: list[Mark]) -> float:
    """Inches that the texts of ``marks`` take side by side."""
    return sum(label_width_in(EdgeLabel(0.0, text, color)) for _, text, color in marks)


def _draw_found(panel: Panel, orders: Floats, values: Floats, findings: Findings, channel: str) -> bool:
    """Ring the lines that were found in the envelope of a ``channel``; thin lines at their multiples."""
    places = []
    for record in findings.bearings:
        own = record.channel in (None, channel) and record.seen_in == "envelope"
        if not own or not is_number(record.order) or not len(orders):
            continue
        order = record.order
        near = np.abs(orders - order) <= max(2 * float(np.median(np.diff(orders))) if len(orders) > 1 else 0.0, 1e-9)
        height = float(np.max(values, where=near, initial=0.0))
        if height > 0:
            places.append((order, height))
        multiples = record.harmonics
        for number in range(2, min(int(multiples) if is_number(multiples) else 1, _MULTIPLES) + 1):
            if number * order <= panel.x[1]:
                panel.upright(number * order, color=LINES[1], width=0.7, alpha=0.45, name=f"multiple-{number}")
        _draw_sidebands(panel, order, record.sidebands)
    if places:
        x, y = (np.array(one) for one in zip(*places, strict=True))
        panel.drawing.add(Rings(panel.at(x, y), 5.0, LINES[1], width=1.4, name="found", values=(x, y)))
    return bool(places)


def _draw_sidebands(panel: Panel, order: float, apart: object) -> None:
    """Mark what stands so many orders ``apart`` beside a line at ``order``."""
    if not is_number(apart) or apart <= 0:
        return
    for number in (*range(-_SIDEBANDS, 0), *range(1, _SIDEBANDS + 1)):
        place = order + number * float(apart)
        if panel.x[0] < place < panel.x[1]:
            panel.upright(place, color=LINES[3], dashes=TONE_DASHES, alpha=0.9, name="sideband")


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
