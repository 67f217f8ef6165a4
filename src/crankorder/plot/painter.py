"""How a drawing is painted with a renderer of matplotlib: no axes, figure or artist, nothing measured anew."""

from __future__ import annotations

import struct
import threading
import zlib
from collections.abc import Callable, Mapping
from functools import cache
from io import BytesIO
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.transforms import Affine2D, Bbox
from numpy.typing import NDArray

from crankorder.plot.drawing import Area, Box, Drawing, Field, Panel, Rings, Stroke, Words, pixels_of, whole
from crankorder.plot.palette import font_file, rgb_of, text_ink
from crankorder.settings import PictureFormat

_LOCK = threading.RLock()  # rc settings are global to matplotlib, and tests are analysed in threads
_NOT_LOOK = ("backend", "interactive", "toolbar", "timezone", "tk.", "webagg.", "keymap.", "docstring.", "_internal")


@cache
def _look() -> Mapping[str, object]:
    """Every rc setting that shapes a picture: matplotlib's defaults, not the user's file, and a fixed salt for SVG."""
    defaults = {str(key): value for key, value in matplotlib.rcParamsDefault.items() if not key.startswith(_NOT_LOOK)}
    return {**defaults, "svg.hashsalt": "crankorder"}


class Painter:
    """Draws parts that are placed in inches with ``renderer``, for pixels or vectors, at ``dpi`` dots per inch."""

    def __init__(self, renderer: Any, dpi: float) -> None:
        self._to, self._dpi = renderer, dpi
        self._inches = Affine2D().scale(dpi)
        self._has_pixels = hasattr(renderer, "buffer_rgba")

    def paint(self, drawing: Drawing) -> None:
        """Draw all parts of ``drawing``, the later ones on top."""
        for part in drawing.parts:
            getattr(self, type(part).__name__.lower())(part)  # the method that has the name of its kind

    def _pen(self, color: str, alpha: float, width: float, within: Box | None = None) -> Any:
        pen = self._to.new_gc()
        pen.set_foreground(to_rgba(color, alpha), isRGBA=True)
        pen.set_linewidth(width)
        if within is not None:
            pen.set_clip_rectangle(Bbox.from_bounds(*(self._dpi * edge for edge in within)))
        return pen

    def stroke(self, part: Stroke) -> None:
        """Draw the line ``part``; a square one (upright or level) lies on whole pixels, where there are any."""
        points, width = self._dpi / 72, part.width
        if part.square and self._has_pixels:
            width = max(1, round(width * points)) / points
        pen = self._pen(part.color, part.alpha, width, part.within)
        pen.set_snap(part.square)
        if part.dashes[0]:
            pen.set_dashes(0.0, [width * length for length in part.dashes])
        elif not part.square:
            pen.set_capstyle("round")
        self._to.draw_path(pen, Path(part.points), self._inches)
        pen.restore()

    def area(self, part: Area) -> None:
        """Fill the outlines of ``part``."""
        pen = self._pen(part.color, part.alpha, 0.0, part.within)
        self._to.draw_path(pen, Path(part.points), self._inches, to_rgba(part.color, part.alpha))
        pen.restore()

    def rings(self, part: Rings) -> None:
        """Draw the circles of ``part``, or discs where its line has no width."""
        pen = self._pen(part.color, part.alpha, part.width)
        pen.set_snap(False)
        disc = None if part.width else to_rgba(part.color, part.alpha)
        size = Affine2D().scale(self._to.points_to_pixels(part.radius))
        self._to.draw_markers(pen, Path.unit_circle(), size, Path(part.points), self._inches, disc)
        pen.restore()

    def words(self, part: Words) -> None:
        """Draw the text of ``part`` by its baseline; where there are pixels, from a whole one on."""
        x, y = (self._dpi * place for place in part.start)
        pen = self._pen(part.color, 1.0, 1.0)
        if self._has_pixels:
            ink, right, down = text_ink(part.text, part.size, self._dpi, bold=part.bold)
            shown = np.full((*ink.shape, 4), (*rgb_of(part.color), 0), dtype=np.uint8)
            shown[..., 3] = ink[::-1]  # renderers count rows upwards
            corner = np.array([x + down, y + right] if part.upward else [x + right, y - down])
            if part.upward:
                shown = np.ascontiguousarray(np.rot90(shown, -1))
                corner[0] -= shown.shape[1]
            self._to.draw_image(pen, *whole(corner), shown)
        else:
            height = self._to.get_canvas_width_height()[1]
            font = FontProperties(fname=font_file(bold=part.bold), size=part.size)
            at = height - y if self._to.flipy() else y
            self._to.draw_text(pen, x, at, part.text, font, 90.0 if part.upward else 0.0)
        pen.restore()

    def field(self, part: Field) -> None:
        """Draw the colours of ``part`` from whole pixel to whole pixel, each repeated, or the nearest taken.

        An image in a vector file has pixels of its own.
        """
        scale = self._dpi * self._to.get_image_magnification()  # pixels per inch
        size, corner = pixels_of(part.box, scale), whole(scale * np.array(part.box[:2])) / scale
        rows, columns = (np.arange(n) * have // n for n, have in zip(size, part.rgb.shape[:2], strict=True))
        shown = np.full((*size, 4), 255, dtype=np.uint8)
        shown[..., :3] = part.rgb[rows[:, None], columns][::-1]  # renderers count rows upwards
        pen = self._to.new_gc()
        self._to.draw_image(pen, *(corner * self._dpi), shown)
        pen.restore()


class Painted(Artist):
    """A ``drawing`` on a figure of matplotlib."""

    def __init__(self, drawing: Drawing | None = None) -> None:
        super().__init__()
        self._drawing = drawing

    def drawing(self, magnification: float = 1.0) -> Drawing:
        """What is drawn; the ``magnification``, a factor on the pixels of maps, is not used."""
        assert self._drawing is not None
        return self._drawing

    def draw(self, renderer: Any) -> None:
        """Draw it with ``renderer``."""
        if self.get_visible():
            figure: Any = self.get_figure()
            Painter(renderer, figure.dpi).paint(self.drawing(renderer.get_image_magnification()))
        self.stale = False


class PaintedPanel(Painted):
    """The drawing of ``content`` on ``axes`` as a panel, laid out anew each time it is drawn, as a user may zoom."""

    def __init__(self, axes: Axes, content: Callable[[Panel], object]) -> None:
        super().__init__()
        self._content = content
        self.set_zorder(2)
        axes.add_artist(self)
        self.set_clip_on(False)

    def drawing(self, magnification: float = 1.0) -> Drawing:
        """What is drawn for the present limits and size of the axes; ``magnification`` is a factor on maps' pixels."""
        axes: Any = self.axes
        dpi, log_y = axes.get_figure().dpi, axes.get_yscale() == "log"
        left, bottom, width, height = (float(edge) / dpi for edge in axes.bbox.bounds)
        drawing = Drawing(left + width, bottom + height, dpi=dpi * magnification)
        (x0, x1), (y0, y1) = (sorted(map(float, ends)) for ends in (axes.get_xlim(), axes.get_ylim()))
        inches = axes.transData + Affine2D().scale(1 / dpi)
        self._content(Panel(drawing, (left, bottom, width, height), (x0, x1), (y0, y1), log_y, inches))
        return drawing

    def get_window_extent(self, renderer: Any = None) -> Bbox:
        """Box of the axes and all texts in pixels, for layouts that make room; ``renderer`` is not needed."""
        axes: Any = self.axes
        dpi = axes.get_figure().dpi
        texts = [Bbox.from_bounds(*(dpi * edge for edge in words.box)) for words in self.drawing().words]
        return Bbox.union([axes.bbox, *texts])


def picture_bytes(drawing: Drawing, *, dpi: int, kind: PictureFormat = "png") -> bytes:
    """Bytes of a picture file, the same for the same ``drawing`` (no date, fixed software name).

    It has ``dpi`` pixels per inch; ``kind`` is the format of the file.
    """
    with _LOCK, matplotlib.rc_context(_look()):  # type: ignore[arg-type]  # its keys are a Literal of every setting
        if kind == "png":
            renderer: Any = RendererAgg(int(drawing.width_in * dpi), int(drawing.height_in * dpi), dpi)  # type: ignore[no-untyped-call]
            shown = np.asarray(renderer.buffer_rgba())
            shown[:] = 255
            Painter(renderer, dpi).paint(drawing)
            return png_bytes(shown, dpi)
        figure, buffer = Figure(figsize=(drawing.width_in, drawing.height_in)), BytesIO()
        figure.add_artist(Painted(drawing))
        dated = "Date" if kind == "svg" else "CreationDate"
        figure.savefig(buffer, format=kind, dpi=dpi, metadata={"Creator": "crankorder", dated: None})
        return buffer.getvalue()


def png_bytes(shown: NDArray[np.uint8], dpi: int) -> bytes:
    """PNG file of the colours ``shown`` (rows from the top, columns, 3 or more), 0 to 255, at ``dpi`` pixels per inch.

    Rows are not filtered: pictures of lines, type and repeated colours are as small without, in a fifth of the time.
    """
    height, width = shown.shape[:2]
    rows = np.pad(shown[..., :3].reshape(height, -1), ((0, 0), (1, 0)))
    per_metre = round(dpi / 0.0254)
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"tEXt", b"Software\0crankorder"),
        (b"pHYs", struct.pack(">IIB", per_metre, per_metre, 1)),
        (b"IDAT", zlib.compress(rows.data, 3)),
        (b"IEND", b""),
    )
    parts = (
        struct.pack(">I4s", len(data), name) + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)
