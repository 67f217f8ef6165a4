"""Texts of a matplotlib figure that are not legible."""

from itertools import combinations
from typing import Any

from matplotlib.text import Text


def overlaps(figure: Any) -> list[tuple[str, str]]:
    """Pairs of drawn texts that lie on one another, and texts that leave the canvas."""
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    hidden = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in [*axis.majorTicks, *axis.minorTicks]:
                if not low * (1 - 1e-9) <= tick.get_loc() <= high * (1 + 1e-9):
                    hidden |= {id(tick.label1), id(tick.label2)}
    texts = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    drawn = [text for text in texts if id(text) not in hidden]
    boxes = [(text.get_text(), text.get_window_extent(renderer).shrunk(0.94, 0.94)) for text in drawn]
    right, top = figure.bbox.width + 1, figure.bbox.height + 1
    beyond = [text for text, box in boxes if box.x0 < 0 or box.y0 < 0 or box.x1 > right or box.y1 > top]
    pairs = [(one, two) for (one, first), (two, second) in combinations(boxes, 2) if first.overlaps(second)]
    return [(text, "edge of the canvas") for text in beyond] + pairs
