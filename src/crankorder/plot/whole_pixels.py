"""Images and upright or level lines of whole pixels on a figure of matplotlib: nothing thin is blurred or dropped."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from crankorder.plot.drawing import pixels_of, whole


class PixelImage(Artist):
    """Colours (rows from the top, columns, 3) over a box (left, bottom, width, height) in inches.

    As many pixels as the box has at the resolution that is drawn, else each is repeated or the nearest is taken.
    """

    def __init__(self, rgb: NDArray[np.uint8], box: tuple[float, float, float, float]) -> None:
        super().__init__()
        self._rgb, self._box = rgb, box

    def draw(self, renderer: Any) -> None:
        """Draw it with ``renderer``, of pixels or of vectors."""
        figure: Any = self.get_figure()
        left, bottom, *_ = self._box
        scale = figure.dpi * renderer.get_image_magnification()  # pixels per inch, also of an image in a vector file
        size, corner = pixels_of(self._box, scale), whole(scale * np.array([left, bottom])) / scale
        rows, columns = (np.arange(n) * have // n for n, have in zip(size, self._rgb.shape[:2], strict=True))
        shown = np.full((*size, 4), 255, dtype=np.uint8)
        shown[..., :3] = self._rgb[rows[:, None], columns][::-1]  # renderers count rows upwards
        pen = renderer.new_gc()
        renderer.draw_image(pen, *(corner * figure.dpi), shown)
        pen.restore()


class PixelLine(Line2D):
    """A line that is as many whole pixels wide as its width is nearest to, one at least; vectors keep its width."""

    def draw(self, renderer: Any) -> None:
        """Draw it with ``renderer``, of pixels or of vectors."""
        figure: Any = self.get_figure()
        width, points = self.get_linewidth(), figure.dpi / 72
        if hasattr(renderer, "buffer_rgba"):
            self.set_linewidth(max(1, round(width * points)) / points)
        super().draw(renderer)
        self.set_linewidth(width)
