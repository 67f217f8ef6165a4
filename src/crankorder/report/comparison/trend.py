"""Picture of several runs: how large each line was in each run, with intervals and the growth fitted to it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from crankorder.plot.drawing import Drawing, title_lines
from crankorder.plot.labels import EdgeLabel, Key, draw_keys, label_right
from crankorder.plot.palette import FAINT, INK, LIGHT, LINES, SMALL, drawable, shortened
from crankorder.plot.panel import Panel
from crankorder.settings import ReportSettings

_LEFT, _RIGHT, _BOTTOM, _TOP = 0.85, 2.6, 0.78, 0.85
_COLOURED = 6
_LEAST_DB = 3.0


def trend_figure(document: dict[str, Any], *, settings: ReportSettings) -> Drawing:
    """Amplitude of each line over its own in the first run [dB] against the run, and what was fitted.

    Lines whose growth is claimed have a colour, 95 % intervals and their fitted growth; the others are light.

    ``document`` the ``comparison.json`` of three runs or more; ``settings`` of the report.
    """
    drawing = Drawing(settings.width_in, settings.height_in)
    box = (_LEFT, _BOTTOM, settings.width_in - _LEFT - _RIGHT, settings.height_in - _BOTTOM - _TOP)
    claims = _told_apart([one for one in document["trend"] if one["changed"]])[:_COLOURED]
    runs = np.arange(1.0, len(document["runs"]) + 1.0)
    ends = [_over_first(one)[0] for one in document["trend"]]
    low, high = min(0.0, *(one.min() for one in ends)), max(_LEAST_DB, *(one.max() for one in ends))
    room = 0.12 * (high - low)
    panel = Panel(drawing, box, (0.8, runs[-1] + 0.2), (float(low - room), float(high + room)))
    panel.x_axis("Run", most=min(len(runs) + 1, 12), whole=True)
    panel.y_axis("Over the first run, dB")
    panel.curve(np.array(panel.x), np.zeros(2), color=FAINT, width=0.9, name="first run")
    for one in document["trend"]:
        if not one["changed"]:
            panel.curve(runs, _over_first(one)[0], color=LIGHT, width=0.7, name="unchanged")
    labels = [_draw(panel, runs, one, LINES[at], at) for at, one in enumerate(claims)]
    panel.frame()
    label_right(drawing, box, labels)
    if not claims:
        panel.note("no line grew", up=0.94)
    changed = sum(one["changed"] for one in document["trend"])
    said = (
        f"{changed} of {len(document['trend'])} lines grow or shrink by more than chance; their change per run beside."
    )
    title_lines(drawing, _LEFT, f"Trend over {len(runs)} runs", said)
    keys = [Key("fitted growth; bars: 95 % intervals", LINES[0] if claims else INK, width=1.3)]
    draw_keys(drawing, _LEFT, [*keys, Key("line without growth", LIGHT)])
    return drawing


def _told_apart(claims: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The lines with the smallest chance first; of lines at one order, which only their names tell apart, one."""
    kept: dict[tuple[str, str, float], dict[str, Any]] = {}
    for one in sorted(claims, key=lambda one: float(one["p_value"])):
        key = (one["kind"], one["channel"], round(float(one["order"]), 2))
        same = kept.setdefault(key, dict(one))
        if same["line"] != one["line"]:
            same["line"] = f"{same['line']} or {one['line']}"
    return list(kept.values())


def _over_first(one: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Amplitudes (runs,) and their intervals (runs, 2) over the amplitude of the first run, in dB."""
    size = np.array(one["amplitude"], dtype=np.float64)
    ends = np.maximum(np.array(one["amplitude_ci95"], dtype=np.float64), 1e-3 * size[:, None])
    return 20.0 * np.log10(size / size[0]), 20.0 * np.log10(ends / size[0])


def _draw(panel: Panel, runs: NDArray[np.float64], one: dict[str, Any], color: str, number: int) -> EdgeLabel:
    """Draw one line with its intervals and its fitted growth; returns its label at the last run."""
    values, ends = _over_first(one)
    growth = 20.0 * np.log10(1.0 + one["growth_per_run"])
    fitted = float(np.mean(values - growth * runs)) + growth * runs
    panel.curve(runs, fitted, color=color, width=1.3, name=f"growth-{number}")
    for x, (low, high) in zip(runs, np.clip(ends, *panel.y), strict=True):
        panel.curve(np.array([x, x]), np.array([low, high]), color=color, width=2.6, alpha=0.35, name="interval")
    panel.dots(runs, values, color=color, radius=2.2)
    where = f", {one['channel']}" if one["channel"] else ""
    words = f"{100 * one['growth_per_run']:+.0f} % · {drawable(one['line'], 80)}{where}"
    text = shortened(words, SMALL, _RIGHT - 0.35)
    return EdgeLabel(float(panel.at(0.0, float(np.clip(values[-1], *panel.y)))[0, 1]), text, color, number)
