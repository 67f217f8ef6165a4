"""The texts of a matplotlib figure, and those that are not legible."""

from __future__ import annotations

from typing import Any

from matplotlib.text import Text


def words(figure: Any) -> list[str]:
    """Visible texts of a figure."""
    return [text.get_text() for text in figure.findobj(Text) if text.get_visible()]


def overlaps(figure: Any) -> list[tuple[str, str]]:
    """Pairs of texts of the figure itself whose boxes overlap by more than a hair, and texts that leave the sheet."""
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    boxes = [(text.get_text(), text.get_window_extent(renderer).shrunk(0.94, 0.94)) for text in figure.texts]
    beyond = [(text, "edge") for text, box in boxes if not figure.bbox.fully_containsx(box.x1 * 0.9999)]
    pairs = [(a, b) for k, (a, one) in enumerate(boxes) for b, two in boxes[k + 1 :] if one.overlaps(two)]
    return beyond + pairs
