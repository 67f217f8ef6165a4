"""Colours, type sizes and dashes of the pictures: one house, whichever program draws them."""

from __future__ import annotations

INK = "#1f2933"
FAINT = "#7b8794"
GRID = "#e4e7eb"
LIGHT = "#b8c0ca"
"""Lines that are there for comparison, behind those that are named."""
NOT_MEASURED = "#dfe3e8"
MODE = "#00718f"
MODE_ON_MAP = "#7fe3ff"
MAINS = "#a03c78"
MAINS_ON_MAP = "#ff9ad5"
HALF_ORDER = "#9a5b00"
"""Labels of orders that only the cycle of a four-stroke engine makes."""
AVOID = "#c4314b"
FREE = "#8fc79a"
NOT_JUDGED = "#9aa5b1"
LINES = ("#0b63a5", "#d1495b", "#2a9134", "#8f5bb5", "#c77700", "#00857c", "#8a5a44", "#5c6b7a", "#b5338a", "#6b7d00")
SMALL, NORMAL, LARGE = 7.5, 9.0, 12.0
BAND_FACTOR = 1.959964
"""Half a 95 % interval in standard errors of a normal estimate."""

MODE_DASHES = (5.0, 4.0)
DOUBT_DASHES = (2.0, 5.0)
TONE_DASHES = (1.0, 2.0)


def rgb_of(color: str) -> tuple[int, int, int]:
    """Red, green and blue (0…255) of a ``color`` written ``"#rrggbb"``."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
