"""Colours, dashes and type of the pictures: levels legible without colour vision, widths of texts."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from crankorder.errors import printable

if TYPE_CHECKING:
    from matplotlib.ft2font import FT2Font

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


@cache
def level_colours() -> NDArray[np.uint8]:
    """Red, green and blue of 256 levels, shape (256, 3), the quietest first: matplotlib's "inferno"."""
    from matplotlib import colormaps

    return np.asarray(np.round(255 * colormaps["inferno"](np.arange(256))[:, :3]), dtype=np.uint8)


LAYOUT_DPI = 130
"""Resolution at which widths are measured: hinting makes a text some hundredths narrower or wider at another."""
CAP_HEIGHT = 0.729
"""Height of a capital or a figure of DejaVu Sans, in sizes of the type."""

_PLAIN = frozenset(map(chr, range(0x20, 0x7F)))


def font_file(*, bold: bool) -> str:
    """Path of DejaVu Sans, ``bold`` or regular, which ships with matplotlib: the same bytes anywhere."""
    from matplotlib import get_data_path

    return f"{get_data_path()}/fonts/ttf/{'DejaVuSans-Bold.ttf' if bold else 'DejaVuSans.ttf'}"


def _font(*, bold: bool) -> FT2Font:
    """One for each thread, and anew after a fork: processes that share an open font read it from under each other."""
    from matplotlib.font_manager import get_font

    return get_font(font_file(bold=bold))


def _set(text: str, size: float, dpi: float, *, bold: bool) -> FT2Font:
    from matplotlib.ft2font import LoadFlags

    font = _font(bold=bold)
    font.set_size(size, dpi)
    font.set_text(text, 0.0, flags=LoadFlags.DEFAULT)
    return font


@lru_cache(maxsize=4096)
def text_width_in(text: str, size: float, *, bold: bool = False) -> float:
    """Width in inches of ``text`` in the house's font, ``bold`` or regular, at ``size`` points."""
    return float(_set(text, size, LAYOUT_DPI, bold=bold).get_width_height()[0]) / 64 / LAYOUT_DPI


@lru_cache(maxsize=1024)
def text_ink(text: str, size: float, dpi: float, *, bold: bool) -> tuple[NDArray[np.uint8], float, float]:
    """Ink (rows from the top, columns), 0 to 255, of ``text`` of ``size`` points, ``bold`` or not, and its place.

    It has ``dpi`` pixels per inch. The place is the distance of its left edge to the right of the begin of the text,
    and of its lower edge below the baseline, both in pixels.
    """
    font = _set(text, size, dpi, bold=bold)
    font.draw_glyphs_to_bitmap(antialiased=True)
    return np.array(font.get_image()), font.get_bitmap_offset()[0] / 64, font.get_descent() / 64


def shortened(text: str, size: float, width_in: float, *, bold: bool = False) -> str:
    """``text`` cut with an ellipsis where it is wider than ``width_in`` inches at ``size`` points, ``bold`` or not."""
    while len(text) > 1 and text_width_in(text, size, bold=bold) > width_in:
        text = text[: -max(2, len(text) // 12)] + "…"
    return text


@cache
def _known(char: str) -> bool:
    """True where the font has a glyph of its own for ``char``."""
    return char in _PLAIN or _font(bold=False).get_char_index(ord(char)) != 0


def drawable(value: object, limit: int) -> str:
    """Text from a file as a picture can show it: ``value`` escaped, cut at ``limit``, unknown glyphs as ``\\uNNNN``."""
    text = "".join(char if _known(char) else f"\\u{ord(char):04x}" for char in printable(value, limit))
    return printable(text, limit)
