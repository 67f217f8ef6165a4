"""Colours of the house, and what the pages draw beside those of the notebook: verdicts, type sizes, dashes."""

from __future__ import annotations

from crankorder.plot.palette import FAINT, GRID, INK, LIGHT, LINES, MAINS, MAINS_ON_MAP, MODE, MODE_ON_MAP, NOT_MEASURED

__all__ = [
    "AVOID", "BAND_FACTOR", "DOUBT_DASHES", "FAINT", "FREE", "GRID", "HALF_ORDER", "INK", "LARGE", "LIGHT", "LINES",
    "MAINS", "MAINS_ON_MAP", "MODE", "MODE_DASHES", "MODE_ON_MAP", "NORMAL", "NOT_JUDGED", "NOT_MEASURED", "SMALL",
    "TONE_DASHES", "rgb_of",
]  # fmt: skip

HALF_ORDER = "#9a5b00"
"""Labels of orders that only the cycle of a four-stroke engine makes."""
AVOID = "#c4314b"
FREE = "#8fc79a"
NOT_JUDGED = "#9aa5b1"
SMALL, NORMAL, LARGE = 7.5, 9.0, 12.0
BAND_FACTOR = 1.959964
"""Half a 95 % interval in standard errors of a normal estimate."""

MODE_DASHES = (5.0, 4.0)
DOUBT_DASHES = (2.0, 5.0)
TONE_DASHES = (1.0, 2.0)


def rgb_of(color: str) -> tuple[int, int, int]:
    """Red, green and blue (0…255) of a ``color`` written ``"#rrggbb"``."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
