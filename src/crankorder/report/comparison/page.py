"""The page of a comparison: what changed, why, how sure, what to do; tables with intervals; and its pictures."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import xarray as xr

from crankorder.channel_units import unit_text
from crankorder.comparison import Comparison, Trend
from crankorder.plot.drawing import Drawing, Panel, Words, title_lines
from crankorder.plot.labels import EdgeLabel, Key, draw_keys, label_right
from crankorder.plot.palette import FAINT, INK, LIGHT, LINES, NORMAL, SMALL, drawable, shortened
from crankorder.plot.reading import estimate_text, frequency_text, named, number_text, order_text
from crankorder.quantities import Floats, Ints
from crankorder.report.comparison.sentences import alike, comparison_story, scaled_text
from crankorder.report.page import rendered_page
from crankorder.report.sentences.story import Answer
from crankorder.report.tables import Table, table_of
from crankorder.settings import ReportSettings

_ANSWERS: dict[Answer, str] = {"what": "What changed", "why": "Why", "how_sure": "How sure", "what_to_do": "What to do"}
_MARKED = frozenset({"yes", "invalid", "weakens"})
_LEFT, _BOTTOM, _TOP, _GUTTER = 0.85, 0.78, 1.0, 0.75
_COLUMNS = 3
_COLOURED = 6  # orders that the eye can follow
_LEAST_DB, _MOST_DB = 6.0, 60.0
_TREND_RIGHT, _TREND_TOP, _TREND_LEAST_DB = 2.6, 0.85, 3.0


def comparison_page(comparison: Comparison, *, pictures: list[tuple[str, str]], settings: ReportSettings) -> str:
    """HTML page of a ``comparison`` with its sentences, with no script and no network; all text is escaped.

    ``pictures`` pairs of file name (beside the page) and caption; ``settings`` of the report.
    """
    limit = settings.max_name_characters
    story, lead = comparison_story(comparison), comparison.headline[0]
    tables = {name: table(comparison, partial(named, limit=limit)) for name, table in _TABLES.items()}
    return rendered_page(
        "comparison.html",
        base=named(comparison.base, limit=limit),
        new=named(comparison.new, limit=limit),
        lead=lead,
        story=[(title, [sentence for sentence in story[key] if sentence != lead]) for key, title in _ANSWERS.items()],
        pictures=[(f"./{file}", named(caption, limit=4 * limit)) for file, caption in pictures],
        tables=[(name, table) for name, table in tables.items() if table.rows or table.empty],
        marked=_MARKED,
    )


Shorten = Callable[[str], str]


_YES = {True: "yes", False: "no"}
_chance = partial(number_text, digits=2)


def _orders(comparison: Comparison, short: Shorten) -> Table:
    rows = [
        [
            short(r.channel), order_text(r.order), short(r.explained_by or "–"), _YES[r.changed],
            estimate_text(r, "ratio"), estimate_text(r, "ratio_db"), number_text(r.speed_rpm, digits=4),
            number_text(r.base_amplitude), number_text(r.new_amplitude), estimate_text(r, "difference"),
            unit_text(r.unit), f"{r.n_changed} of {r.n_speeds}", _chance(r.p_value),
        ]
        for r in sorted(comparison.orders, key=lambda record: (not record.changed, record.channel, record.order))
    ]  # fmt: skip
    heads = "Channel|Order#|Made by|Changed|Ratio#|Ratio, dB#|Speed of the clearest change, rpm#|First#|Second#"
    heads += "|Difference#|Unit|Speeds changed#|p#"
    note = "Ratio: second test over first, mean of the speeds at which both show the order clearly. p: chance of so "
    note += "large a change where nothing changed."
    return table_of("Orders", heads, rows, empty="No order could be compared.", note=note)


def _modes(comparison: Comparison, _: Shorten) -> Table:
    rows = [
        [
            frequency_text(mode.frequency_hz),
            _YES[mode.changed] if mode.only_in is None else "seen in one test only",
            estimate_text(mode, "shift_hz"), estimate_text(mode, "damping_change"), _chance(mode.p_value),
        ]
        for mode in comparison.modes
    ]  # fmt: skip
    note = "That only one test shows a natural frequency is no claim: the other may have hidden it."
    heads = "Natural frequency, Hz#|Changed|Shift, Hz#|Change of damping ratio#|p#"
    return table_of("Natural frequencies", heads, rows, empty="None could be compared.", note=note if rows else "")


def _unbalance(comparison: Comparison, short: Shorten) -> Table:
    rows = [
        [
            short(r.channel), order_text(r.order), _YES[r.explains], estimate_text(r, "factor"),
            estimate_text(r, "turned_deg"), _chance(r.one_factor_p), estimate_text(r, "square_law_amplitude"),
            unit_text(r.unit), _chance(r.square_law_p),
        ]
        for r in comparison.unbalance
    ]  # fmt: skip
    reference = comparison.unbalance[0].reference_rpm if rows else 0.0
    heads = "Channel|Order#|Explains the change|After over before#|Turned by, °#|Chance of a worse fit: one factor#"
    heads += f"|Change at {reference:.0f} rpm, as speed²#|Unit|Chance of a worse fit: speed²#"
    note = "One factor at all speeds: the same path led from another unbalance to the sensor. A change that grows as "
    return table_of("Change of unbalance", heads, rows, note=note + "speed² besides: that path is stiff.")


def _masses(comparison: Comparison, short: Shorten) -> Table:
    rows = [
        [
            short(of.channel), number_text(of.speed_rpm, digits=4), number_text(of.response_per_unit),
            number_text(of.phase_deg),
        ]
        for of in (comparison.trial_mass.influence if comparison.trial_mass else ())
    ]  # fmt: skip
    note = "Response to one g (on a piston) or g·mm (on the crank) of the mass that the manifests state."
    return table_of("Influence of the added mass", "Channel|Speed, rpm#|Response#|Phase, °#", rows, note=note)


def _balance(comparison: Comparison, _: Shorten) -> Table:
    rows = [
        [
            mass.quantity.replace("_", " "), _YES[mass.changed], number_text(mass.base), number_text(mass.new),
            estimate_text(mass, "change"),
        ]
        for mass in comparison.balance
    ]  # fmt: skip
    return table_of("Balance closed with the engine model", "Quantity|Changed|First#|Second#|Change#", rows)


def _trend(comparison: Comparison, short: Shorten) -> Table:
    rows = [
        [
            short(t.line), t.kind, short(t.channel), _YES[t.changed], scaled_text(t, "growth_per_run", 100),
            ", ".join(number_text(value) for value in t.amplitude), _chance(t.p_value), t.verdict,
        ]
        for t in sorted(comparison.trend, key=lambda trend: (not trend.changed, trend.kind, trend.line))
    ]  # fmt: skip
    heads = "Line|Kind|Channel|Changed|Growth per run, %#|Amplitude by run#|p#|Verdict"
    return table_of("Trend over the runs", heads, rows, note="Runs: " + ", ".join(comparison.runs) + ".")


def _confounds(comparison: Comparison, short: Shorten) -> Table:
    rows = [
        [c.severity, f"{c.what} {short(c.channel)}".strip(), short(c.base), short(c.new), c.words]
        for c in comparison.confounds
    ]
    heads = "Weight|What differs|First|Second|What it does"
    empty = "Both tests were made and analysed alike."
    return table_of("What else differs (confounds)", heads, rows, empty=empty)


_TABLES: dict[str, Callable[[Comparison, Shorten], Table]] = {
    "orders": _orders, "modes": _modes, "unbalance": _unbalance, "masses": _masses, "balance": _balance,
    "trend": _trend, "confounds": _confounds,
}  # fmt: skip
"""Tables of the page by name; one without rows is shown where it has words for that."""


def order_change_figure(changes: xr.Dataset, comparison: Comparison, *, settings: ReportSettings) -> Drawing:
    """Second test over first [dB] with 95 % bands against speed, of the orders that changed; a panel per channel.

    Orders that did not change are light lines; dots are speeds at which a change is claimed.

    ``changes`` the dataset ``order_change`` of a ``comparison`` with its sentences; ``settings`` of the report.
    """
    channels = list(dict.fromkeys(changes["channel"].values.tolist()))
    columns = min(len(channels), _COLUMNS)
    rows = -(-len(channels) // columns)
    block = settings.height_in - _BOTTOM - _TOP if rows == 1 else 0.62 * settings.height_in
    drawing = Drawing(settings.width_in, _TOP + rows * block + (rows - 1) * 0.9 + _BOTTOM)
    changed = sorted((record for record in comparison.orders if record.changed), key=lambda record: record.p_value)
    clearest = list(dict.fromkeys(record.order for record in changed))[:_COLOURED]
    colours = {order: LINES[number] for number, order in enumerate(sorted(clearest))}
    speed = changes["speed"].values
    low, high = (float(np.nanmin(speed)), float(np.nanmax(speed))) if np.isfinite(speed).any() else (0.0, 1.0)
    margin = 0.04 * (high - low) if high > low else max(0.05 * abs(low), 1.0)
    ends, limits = (low - margin, high + margin), _limits_db(changes)
    for number, channel in enumerate(channels):
        width = (settings.width_in - _LEFT - columns * _GUTTER + 0.2) / columns
        left = _LEFT + (number % columns) * (width + _GUTTER)
        box = (left, _BOTTOM + (rows - 1 - number // columns) * (block + 0.9), width, block)
        _draw_channel(Panel(drawing, box, ends, limits), changes, channel, colours, first=number % columns == 0)
        name = shortened(drawable(channel, settings.max_name_characters), NORMAL + 1, width, bold=True)
        drawing.add(Words(left, box[1] + block + 0.09, name, NORMAL + 1, bold=True))
    title = f"Orders that changed · {drawable(comparison.base, 40)} → {drawable(comparison.new, 40)}"
    subtitle = comparison.headline[0] if colours else "No order changed by more than chance alone would change it."
    title_lines(drawing, _LEFT, title, drawable(subtitle, 300))
    claimed = Key("95 % band; dot: change claimed", LINES[0] if colours else INK, width=2.0)
    draw_keys(drawing, _LEFT, [claimed, Key("order that did not change", LIGHT)])
    return drawing


def _limits_db(changes: xr.Dataset) -> tuple[float, float]:
    """Limits [dB] of the axis: significant changes with most of their intervals, zero, and a margin."""
    says = changes["changed"].values.astype(bool)
    values, low, high = (changes[name].values[says] for name in ("ratio_db", "ratio_db_low", "ratio_db_high"))
    known = np.isfinite(values)
    if not known.any():
        return -_LEAST_DB, _LEAST_DB
    values, low, high = values[known], low[known], high[known]
    largest = float(np.abs(values).max())
    bottom = float(np.quantile(np.maximum(low, values - 0.5 * largest), 0.05))
    top = float(np.quantile(np.minimum(high, values + 0.5 * largest), 0.95))
    bottom, top = min(bottom, float(values.min())), max(top, float(values.max()))
    room = 0.08 * max(top - bottom, _LEAST_DB)
    return max(min(bottom, -0.3 * _LEAST_DB) - room, -_MOST_DB), min(max(top, 0.3 * _LEAST_DB) + room, _MOST_DB)


def _draw_channel(panel: Panel, changes: xr.Dataset, channel: str, colours: dict[float, str], *, first: bool) -> None:
    """Panel of one channel: what changed in ``colours``, the other orders light behind it."""
    left, bottom, width, height = panel.box
    panel.x_axis("Speed, rpm", most=int(np.clip(1.8 * width, 3, 10)), whole=True)
    panel.y_axis("Second test over first, dB" if first else "")
    panel.curve(np.array(panel.x), np.zeros(2), color=FAINT, width=0.9, name="no change")
    labels = []
    rows = [n for n, name in enumerate(changes["channel"].values.tolist()) if name == channel]
    rows.sort(key=lambda n: float(changes["order"].values[n]) in colours)  # those that changed lie on top
    by_speed = np.argsort(changes["speed"].values, kind="stable")
    for row in rows:
        order = float(changes["order"].values[row])
        color = colours.get(order) if changes["changed"].values[row].any() else None
        last = _draw_line(panel, changes, row, by_speed, color)
        if color is not None and last is not None:
            place = float(panel.at(0.0, float(np.clip(last, *panel.y)))[0, 1])
            labels.append(EdgeLabel(place, order_text(order), color, row))
    panel.frame()
    label_right(panel.drawing, panel.box, labels)
    if labels:
        panel.drawing.add(Words(left + width + 0.1, bottom + height + 0.09, "order", SMALL, FAINT))
    else:
        panel.note("no order changed", at_in=panel.box[1] + 0.94 * panel.box[3])


def _draw_line(panel: Panel, changes: xr.Dataset, row: int, at: Ints, color: str | None) -> float | None:
    """Last value [dB] of the curve of one order, which is drawn; None where it is nowhere above the noise."""
    speed = changes["speed"].values[at]
    values, low, high = (changes[name].values[row][at] for name in ("ratio_db", "ratio_db_low", "ratio_db_high"))
    claimed = changes["changed"].values[row][at].astype(bool)
    known = np.isfinite(values) & np.isfinite(low) & np.isfinite(high) & (high - low < 2 * _MOST_DB) | claimed
    values = np.where(known, values, np.nan)
    if not np.isfinite(values).any():
        return None
    bottom, top = panel.y
    low, high = (
        np.where(known, np.clip(np.nan_to_num(end, nan=0.0), bottom - 50.0, top + 50.0), np.nan) for end in (low, high)
    )
    if color is None:
        panel.curve(speed, values, color=LIGHT, width=0.7, name="unchanged")
        return None
    if np.count_nonzero(known) <= 3:
        _draw_bars(panel, speed[known], np.stack([low[known], high[known]], axis=1), color)
    else:
        panel.band(speed, low, high, color=color, alpha=0.2)
    name = f"order-{order_text(float(changes['order'].values[row]))}"
    panel.curve(speed, values, color=color, width=1.3, name=name)
    panel.rings(speed[claimed], values[claimed], color=color, radius=2.2)
    return float(values[np.isfinite(values)][-1])


def trend_figure(comparison: Comparison, *, settings: ReportSettings) -> Drawing:
    """Amplitude of each line over its own in the first run [dB] against the run, and what was fitted.

    Lines whose growth is claimed have a colour, 95 % intervals and their fitted growth; the others are light.

    ``comparison`` of two runs or more; ``settings`` of the report.
    """
    drawing = Drawing(settings.width_in, settings.height_in)
    box = (_LEFT, _BOTTOM, settings.width_in - _LEFT - _TREND_RIGHT, settings.height_in - _BOTTOM - _TREND_TOP)
    claimed = sorted((trend for trend in comparison.trend if trend.changed), key=lambda trend: trend.p_value)
    claims = alike(claimed)[:_COLOURED]
    runs = np.arange(1.0, len(comparison.runs) + 1.0)
    levels = np.array([_over_first(trend)[0] for trend in comparison.trend])
    low, high = min(0.0, levels.min()), max(_TREND_LEAST_DB, levels.max())
    room = 0.12 * (high - low)
    panel = Panel(drawing, box, (0.8, runs[-1] + 0.2), (float(low - room), float(high + room)))
    panel.x_axis("Run", most=min(len(runs) + 1, 12), whole=True)
    panel.y_axis("Over the first run, dB")
    panel.curve(np.array(panel.x), np.zeros(2), color=FAINT, width=0.9, name="first run")
    for trend, level in zip(comparison.trend, levels, strict=True):
        if not trend.changed:
            panel.curve(runs, level, color=LIGHT, width=0.7, name="unchanged")
    labels = [_draw_trend(panel, runs, lines, number) for number, lines in enumerate(claims)]
    panel.frame()
    label_right(drawing, box, labels)
    if not claims:
        panel.note("no line grew", at_in=box[1] + 0.94 * box[3])
    of_all = f"{len(claimed)} of {len(comparison.trend)} lines"
    subtitle = f"{of_all} grow or shrink by more than chance; their change per run beside."
    title_lines(drawing, _LEFT, f"Trend over {len(runs)} runs", subtitle)
    keys = [Key("fitted growth; bars: 95 % intervals", LINES[0] if claims else INK, width=1.3)]
    draw_keys(drawing, _LEFT, [*keys, Key("line without growth", LIGHT)])
    return drawing


def _draw_bars(panel: Panel, x: Floats, intervals: Floats, color: str) -> None:
    for at, ends in zip(x, intervals, strict=True):
        panel.curve(np.array([at, at]), ends, color=color, width=2.6, alpha=0.35, name="interval")


def _over_first(trend: Trend) -> tuple[Floats, Floats]:
    """Amplitudes (runs,) and their intervals (runs, 2) over the amplitude of the first run, in dB."""
    size = np.array(trend.amplitude)
    ends = np.maximum(np.array(trend.amplitude_ci95, dtype=np.float64), 1e-3 * size[:, None])
    return 20.0 * np.log10(size / size[0]), 20.0 * np.log10(ends / size[0])


def _draw_trend(panel: Panel, runs: Floats, lines: list[Trend], number: int) -> EdgeLabel:
    """Label at the last run of a line that is drawn with its intervals and its fitted growth.

    ``lines`` are those that only their names tell from it, itself the first.
    """
    trend, color = lines[0], LINES[number]
    values, ends = _over_first(trend)
    growth = 20.0 * np.log10(1.0 + trend.growth_per_run)
    fitted = float(np.mean(values - growth * runs)) + growth * runs
    panel.curve(runs, fitted, color=color, width=1.3, name=f"growth-{number}")
    _draw_bars(panel, runs, np.clip(ends, *panel.y), color)
    panel.rings(runs, values, color=color, radius=2.2)
    where = f", {trend.channel}" if trend.channel else ""
    names = " or ".join(dict.fromkeys(line.line for line in lines))
    text = shortened(f"{100 * trend.growth_per_run:+.0f} % · {drawable(names, 80)}{where}", SMALL, _TREND_RIGHT - 0.35)
    return EdgeLabel(float(panel.at(0.0, float(np.clip(values[-1], *panel.y)))[0, 1]), text, color, number)
