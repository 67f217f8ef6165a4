"""Strip beside a Campbell diagram: speeds to avoid and bands that are free, on the scale of its speeds."""

from __future__ import annotations

import numpy as np

from crankorder.findings import Findings
from crankorder.plot.drawing import Stroke
from crankorder.plot.labels import EdgeLabel, Key
from crankorder.plot.palette import AVOID, FREE, NOT_JUDGED
from crankorder.plot.panel import Panel
from crankorder.records import known
from crankorder.report.sentences.of_speeds import free_bands, not_judged_rpm, open_bands, speeds_together

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
    groups = speeds_together(findings) if findings.speeds_to_avoid else []
    return [
        (min(low for low, _ in ends), max(high for _, high in ends), sum(one.rpm for one in group) / len(group))
        for group in groups
        if len(ends := [both for one in group if (both := known(one.rpm_range)) is not None]) == len(group)
    ]


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
