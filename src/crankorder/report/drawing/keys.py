"""What the lines of a picture mean: samples and their meanings in a row at its foot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crankorder.report.drawing.drawn import Drawing, Rings, Stroke, Words
from crankorder.report.drawing.palette import INK, SMALL
from crankorder.report.drawing.typeface import CAP_HEIGHT, text_width_in

_SIZE = SMALL + 0.5
_SAMPLE_IN, _GAP_IN, _BETWEEN_IN, _BASE_IN = 0.3, 0.08, 0.24, 0.16
_UP_IN, _DOWN_IN = 0.15, 0.06  # of the first and the second of two rows


@dataclass(frozen=True)
class Key:
    """A meaning and the line (or ``ring``) that has it."""

    text: str
    color: str
    dashes: tuple[float, float] = (0.0, 0.0)
    ring: bool = False
    width: float = 1.2


def draw_keys(drawing: Drawing, left_in: float, keys: Sequence[Key], *, room_in: float = np.inf) -> None:
    """Draw ``keys`` side by side at the foot of ``drawing``, from ``left_in`` inches; in two rows if need be.

    ``room_in``: width in inches that a row may take.
    """
    widths = [_SAMPLE_IN + _GAP_IN + text_width_in(key.text, _SIZE) + _BETWEEN_IN for key in keys]
    ends = np.cumsum(widths) - _BETWEEN_IN
    first = len(keys) if not len(ends) or ends[-1] <= room_in else max(int(np.sum(ends <= room_in)), 1)
    if first == len(keys):
        _row(drawing, left_in, keys, _BASE_IN)
    else:
        _row(drawing, left_in, keys[:first], _BASE_IN + _UP_IN)
        _row(drawing, left_in, keys[first:], _BASE_IN - _DOWN_IN)


def _row(drawing: Drawing, left_in: float, keys: Sequence[Key], base_in: float) -> None:
    x, middle = left_in, base_in + CAP_HEIGHT / 2 * _SIZE / 72
    for key in keys:
        if key.ring:
            place = np.array([[x + _SAMPLE_IN / 2, middle]])
            drawing.add(Rings(place, 4.0, key.color, width=1.4))
        else:
            ends = np.array([[x, middle], [x + _SAMPLE_IN, middle]])
            drawing.add(Stroke(ends, key.color, key.width, key.dashes, square=True))
        x += _SAMPLE_IN + _GAP_IN
        drawing.add(Words(x, base_in, key.text, _SIZE, INK))
        x += text_width_in(key.text, _SIZE) + _BETWEEN_IN
