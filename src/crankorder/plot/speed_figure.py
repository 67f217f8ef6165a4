"""Speed against time: how the machine was driven, and how unevenly it turned where an encoder shows that."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from crankorder.findings import Findings
from crankorder.plot.axes import axes_for, dataset_of, dress, painted, scale
from crankorder.plot.drawing import Drawing, Panel
from crankorder.plot.labels import EdgeLabel, head_of_test, label_right
from crankorder.plot.palette import FAINT, LIGHT, LINES, SMALL, drawable, shortened
from crankorder.quantities import Floats
from crankorder.settings import ReportSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LEFT, _BOTTOM, _TOP, _RIGHT, _HEIGHT = 0.95, 0.7, 0.84, 1.6, 3.8  # inches
_CHANGES = 1.1  # highest over lowest speed of a recording whose speed changes
_SMOOTH = 20  # the ends of a trace are told from the means of so many pieces of it
_COLOURED = 6
_PIECES = 800  # of time, where a recording has more than twice as many speeds


def changing_recordings(shaft: xr.Dataset) -> list[int]:
    """Numbers of the recordings of ``shaft`` (the group of the results) whose speed changes by a tenth and more.

    Motion within an engine cycle does not count. None where the group holds no ``speed_trace``.
    """
    if "speed_trace" not in shaft:
        return []
    traces = shaft["speed_trace"].transpose("recording", "knot").values
    return [number for number, trace in enumerate(traces) if _spread(trace) > _CHANGES]


def shown_recordings(shaft: xr.Dataset) -> list[int]:
    """Numbers of the recordings of ``shaft`` that are drawn: their speed changes, else all with pulses."""
    numbers = changing_recordings(shaft)
    if numbers or "speed_trace" not in shaft or "n_pulses" not in shaft:
        return numbers
    drawn = np.isfinite(shaft["speed_trace"].transpose("recording", "knot").values).any(axis=1)
    return np.flatnonzero((shaft["n_pulses"].values > 0) & drawn).tolist()


def _spread(trace: Floats) -> float:
    known = trace[np.isfinite(trace)]
    if len(known) < 2:
        return 1.0
    means = np.array([piece.mean() for piece in np.array_split(known, min(_SMOOTH, len(known)))])
    return float(means.max() / max(float(means.min()), 1e-3))


def speed_figure(shaft: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Speed [rpm] against time [s] of the :func:`shown_recordings`, with its swing as a band.

    ``shaft`` the group of that name of the results, with ``trace_time``, ``speed_trace`` and where known
    ``speed_trace_low``, ``speed_trace_high`` (recording, knot); ``findings`` of the same test; ``settings`` of the
    report.
    """
    numbers = shown_recordings(shaft)
    time, speed = (shaft[name].transpose("recording", "knot").values for name in ("trace_time", "speed_trace"))
    time = time - np.nanmin(time, axis=1, keepdims=True, initial=np.inf)
    low, high = (
        shaft[name].transpose("recording", "knot").values if name in shaft else speed
        for name in ("speed_trace_low", "speed_trace_high")
    )
    drawing = Drawing(settings.width_in, _HEIGHT)
    box = (_LEFT, _BOTTOM, settings.width_in - _LEFT - _RIGHT, _HEIGHT - _BOTTOM - _TOP)
    ends = _ends(low[numbers], high[numbers], from_zero=bool(changing_recordings(shaft)))
    panel = Panel(drawing, box, (0.0, float(np.nanmax(time[numbers], initial=1e-3))), ends)
    panel.x_axis("Time from the first pulse, s", most=10)
    panel.y_axis("Speed, rpm", most=6)
    panel.frame()
    labels, few = [], len(numbers) <= 2 * _COLOURED
    named = np.arange(len(numbers)) if few else np.linspace(0, len(numbers) - 1, _COLOURED).round()
    colors = {int(place): LINES[rank] for rank, place in enumerate(named[:_COLOURED])}
    for place, number in enumerate(numbers):
        color = colors.get(place, LIGHT)
        draw_speed(panel, time[number], speed[number], (low[number], high[number]), color, name=f"speed-{number}")
        known = speed[number][np.isfinite(speed[number])]
        name = drawable(shaft["recording"].values[number], settings.max_name_characters)
        height = box[1] + box[3] * float(panel.share(float(known[-1])))
        if few or place in colors:
            labels.append(EdgeLabel(height, shortened(name, SMALL, _RIGHT - 0.3), colors.get(place, FAINT)))
    label_right(drawing, box, labels)
    subtitle = _subtitle(shaft, numbers)
    head_of_test(drawing, _LEFT, findings, "speed against time", subtitle, longest=settings.max_name_characters)
    return drawing


def draw_speed(
    panel: Panel, time: Floats, speed: Floats, swing: tuple[Floats, Floats], color: str, *, name: str = "speed"
) -> None:
    """Draw ``speed`` over ``time`` in ``panel`` as a line in ``color`` called ``name``, its ``swing`` as a band."""
    panel.band(time, *swing, color=color, alpha=0.25)
    panel.curve(time, speed, color=color, name=name)


def _ends(low: Floats, high: Floats, *, from_zero: bool) -> tuple[float, float]:
    """Limits of the speed axis: from standstill where the speed changes, else close around the data."""
    top, bottom = float(np.nanmax(high, initial=1.0)), float(np.nanmin(low, initial=np.inf))
    if from_zero or not np.isfinite(bottom):
        return 0.0, 1.05 * top
    spare = max(0.1 * (top - bottom), 0.005 * top)
    return max(0.0, bottom - spare), top + spare


def _subtitle(shaft: xr.Dataset, numbers: list[int]) -> str:
    speed = shaft["speed_trace"].transpose("recording", "knot").values[numbers]
    rest = shaft.sizes["recording"] - len(numbers)
    keep = "keep their speed" if rest > 1 else "keeps its speed"
    lack = "have no encoder" if rest > 1 else "has no encoder"
    more = f" {rest} other{'s' * (rest > 1)} {keep if changing_recordings(shaft) else lack}." if rest else ""
    return (
        f"{np.nanmin(speed, initial=np.inf):.0f} to {np.nanmax(speed, initial=0.0):.0f} rpm; "
        f"the band: lowest to highest within each piece of time, with the noise of the encoder's edges.{more}"
    )


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
    span = f"{' to '.join(ends)} rpm" if ends else ""
    remark = f"{span}, band: lowest to highest" if many else span
    dress(axes, x="Time, s", y="Speed, rpm", title=str(dataset.attrs["recording"]), note=remark)
    if not len(values):
        scale(axes, (0.0, 1.0), None)
        return painted(axes, lambda panel: panel.note("no speed is known"))
    changes = 0.0 < _CHANGES * float(values.min()) < float(values.max())
    scale(axes, time, _ends(low, high, from_zero=changes), log_y=False)

    def content(panel: Panel) -> None:
        draw_speed(panel, when, mean, (low, high), LINES[0])
        if len(when) == 1:
            panel.dots(when, mean, color=LINES[0], radius=3.0)

    return painted(axes, content)


def _pieces(time: Floats, values: Floats) -> Floats:
    """Middle, mean, lowest and highest value, (4, pieces), of equal pieces of ``time`` that hold any."""
    number = np.minimum(((time - time[0]) / (time[-1] - time[0]) * _PIECES).astype(int), _PIECES - 1)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    count = np.diff(np.append(first, len(values)))
    means = (np.add.reduceat(series, first) / count for series in (time, values))
    return np.stack([*means, np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)])
