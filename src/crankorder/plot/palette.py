"""Colours, type sizes and dashes of the pictures."""

from __future__ import annotations

INK = "#1f2933"
FAINT = "#7b8794"
GRID = "#e4e7eb"
LIGHT = "#b8c0ca"
"""Lines that are there for comparison, behind those that are named."""
WHITE = "#ffffff"
NOT_MEASURED = "#dfe3e8"
MODE = "#00718f"
MODE_ON_MAP = "#7fe3ff"
MAINS = "#a03c78"
MAINS_ON_MAP = "#ff9ad5"
LINES = ("#0b63a5", "#d1495b", "#2a9134", "#8f5bb5", "#c77700", "#00857c", "#8a5a44", "#5c6b7a", "#b5338a", "#6b7d00")
LEVELS = "inferno"
"""Colour map of levels, by matplotlib's name: dark to bright in even steps of lightness."""
SMALL, NORMAL, LARGE = 8.0, 9.0, 11.0

MODE_DASHES = (0.0, (5.0, 4.0))
DOUBT_DASHES = (0.0, (2.0, 5.0))
TONE_DASHES = (0.0, (1.0, 2.0))
