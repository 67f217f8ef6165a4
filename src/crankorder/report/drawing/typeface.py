"""Text as pixels: the house's font, its widths, and what it cannot show."""

from __future__ import annotations

from functools import cache, lru_cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import ImageFont

from crankorder.errors import printable

LAYOUT_DPI = 130
"""Resolution at which widths are measured: hinting makes a text some hundredths narrower or wider at another."""
CAP_HEIGHT = 0.729
"""Height of a capital or a figure of DejaVu Sans, in sizes of the type."""

_MISSING = "\uffff"
_PLAIN = frozenset(map(chr, range(0x20, 0x7F)))


@cache
def _folder() -> Path:
    """Folder of DejaVu Sans, which ships with matplotlib: the same bytes anywhere; matplotlib itself stays asleep."""
    spec = find_spec("matplotlib")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("matplotlib, whose fonts the pictures use, is not installed", name="matplotlib")
    return Path(spec.submodule_search_locations[0]) / "mpl-data" / "fonts" / "ttf"


@cache
def _font(size_px: float, bold: bool) -> ImageFont.FreeTypeFont:
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(_folder() / name), size_px, layout_engine=ImageFont.Layout.BASIC)


@lru_cache(maxsize=4096)
def text_mask(text: str, size_px: float, *, bold: bool, shift_px: float) -> tuple[NDArray[np.uint8], int, int]:
    """Coverage (rows, columns) of ``text`` and where its first column and row lie from the start of its baseline.

    ``size_px`` of the type; ``bold`` or regular; ``shift_px`` of the start to the right, 0…1.
    """
    core, offset = _font(size_px, bold).getmask2(text, mode="L", anchor="ls", start=(shift_px, 0.0))
    columns, rows = core.size
    if not rows * columns:
        return np.zeros((0, 0), np.uint8), 0, 0
    return np.frombuffer(bytes(core), dtype=np.uint8).reshape(rows, columns), int(offset[0]), int(offset[1])


@lru_cache(maxsize=4096)
def text_width_in(text: str, size: float, *, bold: bool = False) -> float:
    """Width in inches of ``text`` in the house's font, ``bold`` or regular, at ``size`` points."""
    return float(_font(size * LAYOUT_DPI / 72, bold).getlength(text)) / LAYOUT_DPI


def shortened(text: str, size: float, width_in: float, *, bold: bool = False) -> str:
    """``text`` cut with an ellipsis where it is wider than ``width_in`` inches at ``size`` points, ``bold`` or not."""
    while len(text) > 1 and text_width_in(text, size, bold=bold) > width_in:
        text = text[: -max(2, len(text) // 12)] + "…"
    return text


@cache
def _known(char: str) -> bool:
    """True where the font has a glyph of its own for ``char``."""
    font = _font(32.0, False)
    return char in _PLAIN or bytes(font.getmask(char)) != bytes(font.getmask(_MISSING))


def drawable(value: object, limit: int) -> str:
    """Text from a file as a picture can show it: ``value`` escaped, cut at ``limit``, unknown glyphs as ``\\uNNNN``."""
    text = "".join(char if _known(char) else f"\\u{ord(char):04x}" for char in printable(value, limit))
    return printable(text, limit)
