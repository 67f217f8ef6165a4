"""The house's font: the widths of its texts, and what it cannot show."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import TYPE_CHECKING

from crankorder.errors import printable

if TYPE_CHECKING:
    from matplotlib.ft2font import FT2Font

LAYOUT_DPI = 130
"""Resolution at which widths are measured: hinting makes a text some hundredths narrower or wider at another."""
CAP_HEIGHT = 0.729
"""Height of a capital or a figure of DejaVu Sans, in sizes of the type."""

_PLAIN = frozenset(map(chr, range(0x20, 0x7F)))


def _font(*, bold: bool) -> FT2Font:
    """DejaVu Sans, which ships with matplotlib: the same bytes anywhere.

    One for each thread, and anew after a fork: processes that share an open font read it from under each other.
    """
    from matplotlib import get_data_path
    from matplotlib.font_manager import get_font

    return get_font(f"{get_data_path()}/fonts/ttf/{'DejaVuSans-Bold.ttf' if bold else 'DejaVuSans.ttf'}")


@lru_cache(maxsize=4096)
def text_width_in(text: str, size: float, *, bold: bool = False) -> float:
    """Width in inches of ``text`` in the house's font, ``bold`` or regular, at ``size`` points."""
    font = _font(bold=bold)
    font.set_size(size, LAYOUT_DPI)
    font.set_text(text, 0.0)
    return float(font.get_width_height()[0]) / 64 / LAYOUT_DPI


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
