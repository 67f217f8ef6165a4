"""The pictures of a test and their bytes; each picture has a module of its own."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING

from crankorder.plot.drawing import Drawing
from crankorder.report.campbell_figure import campbell_figure
from crankorder.report.order_spectra_figure import order_spectra_figure
from crankorder.report.orders_figure import orders_figure
from crankorder.report.spectra_figure import spectra_figure
from crankorder.report.speed_figure import speed_figure
from crankorder.settings import PictureFormat

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "campbell_figure", "order_spectra_figure", "orders_figure", "picture_bytes", "spectra_figure", "speed_figure",
]  # fmt: skip


def picture_bytes(figure: Drawing | Figure, *, dpi: int, kind: PictureFormat = "png") -> bytes:
    """Bytes of a picture, the same for the same figure (no date, fixed software name).

    ``figure`` from one of the functions here, or of matplotlib; ``dpi`` pixels per inch; ``kind`` of file.
    """
    from crankorder.plot.style import house_style

    buffer = BytesIO()
    with house_style():
        drawn = figure.figure() if isinstance(figure, Drawing) else figure
        if kind == "png":
            drawn.savefig(
                buffer, format="png", dpi=dpi, metadata={"Software": "crankorder"}, pil_kwargs={"compress_level": 4}
            )
        else:
            dated = "Date" if kind == "svg" else "CreationDate"
            drawn.savefig(buffer, format=kind, dpi=dpi, metadata={"Creator": "crankorder", dated: None})
    return buffer.getvalue()
