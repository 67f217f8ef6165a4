"""Maps of whole pixels on axes of matplotlib: nothing thin is blurred or dropped."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.image import AxesImage
from matplotlib.transforms import IdentityTransform
from numpy.typing import NDArray

from crankorder.plot.cells import pooled
from crankorder.plot.palette import NOT_MEASURED, level_colours


class LevelImage(AxesImage):
    """Levels over cells of any width. However far one zooms in or out, no thin line is lost and no cell is blurred."""

    def __init__(
        self,
        axes: Axes,
        level: NDArray[np.float64],
        edges: tuple[NDArray[np.float64], NDArray[np.float64]],
        limits: tuple[float, float],
    ) -> None:
        x, y = edges
        colours = ListedColormap(level_colours() / 255).with_extremes(bad=NOT_MEASURED)
        super().__init__(axes, cmap=colours, norm=Normalize(*limits), extent=(x[0], x[-1], y[0], y[-1]))
        self._level = np.where(np.isnan(level), -np.inf, level)
        self._x, self._y = x, y
        self.set_data(np.ma.masked_invalid(level))
        self.set_clip_path(axes.patch)
        axes.add_image(self)

    def _check_unsampled_image(self) -> bool:
        return False

    def make_image(self, renderer: Any, magnification: float = 1.0, unsampled: bool = False) -> tuple[Any, ...]:
        """Pixels (rows, columns, 4) for ``renderer`` at ``magnification``, their corner, and no transform.

        ``unsampled`` is not for cells of unlike widths.
        """
        corners = np.asarray(self.axes.bbox.extents) * magnification
        left, bottom, right, top = (corners + 0.5).astype(int) / magnification
        columns, rows = round((right - left) * magnification), round((top - bottom) * magnification)
        if columns < 1 or rows < 1:
            return None, left, bottom, IdentityTransform()
        back = self.axes.transData.inverted()
        across = np.linspace(left, right, columns + 1)
        upward = np.linspace(bottom, top, rows + 1)
        x = back.transform(np.column_stack([across, np.full(columns + 1, bottom)]))[:, 0]
        y = back.transform(np.column_stack([np.full(rows + 1, left), upward]))[:, 1]
        shown = pooled(pooled(self._level, self._x, x, axis=1), self._y, y, axis=0)
        return self.to_rgba(np.ma.masked_invalid(shown), bytes=True), left, bottom, IdentityTransform()

    def get_cursor_data(self, event: Any) -> float | None:
        """Level in dB under the mouse at ``event``; None outside."""
        row = int(np.searchsorted(self._y, event.ydata)) - 1
        column = int(np.searchsorted(self._x, event.xdata)) - 1
        inside = 0 <= row < self._level.shape[0] and 0 <= column < self._level.shape[1]
        return float(self._level[row, column]) if inside and np.isfinite(self._level[row, column]) else None
