"""What the lines of a picture mean: samples and their meanings in a row at its foot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crankorder.report.drawing import Drawing, Rings, Stroke, Words
from crankorder.report.palette import INK, SMALL
from crankorder.report.typeface import CAP_HEIGHT, text_width_in

_SIZE = SMALL + 0.5
_SAMPLE_IN, _GAP_IN, _BETWEEN_IN, _BASE_IN = 0.3, 0.08, 0.24, 0.16


@dataclass(frozen=True)
class Key:
    """A meaning and the line (or ``ring``) that has it."""

    text: str
    color: str
    dashes: tuple[float, float] = (0.0, 0.0)
    ring: bool = False
    width: float = 1.2


def draw_keys(drawing: Drawing, left_in: float, keys: Sequence[Key]) -> None:
    """Draw ``keys`` side by side at the foot of ``drawing``, from ``left_in`` inches."""
    x, middle = left_in, _BASE_IN + CAP_HEIGHT / 2 * _SIZE / 72
    for key in keys:
        if key.ring:
            place = np.array([[x + _SAMPLE_IN / 2, middle]])
            drawing.add(Rings(place, 4.0, key.color, width=1.4))
        else:
            ends = np.array([[x, middle], [x + _SAMPLE_IN, middle]])
            drawing.add(Stroke(ends, key.color, key.width, key.dashes, square=True))
        x += _SAMPLE_IN + _GAP_IN
        drawing.add(Words(x, _BASE_IN, key.text, _SIZE, INK))
        x += text_width_in(key.text, _SIZE) + _BETWEEN_IN
