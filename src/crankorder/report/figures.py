"""The pictures of a test and their bytes; each picture has a module of its own."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING

from crankorder.report.campbell_figure import campbell_figure
from crankorder.report.drawing.drawn import Drawing
from crankorder.report.order_spectra_figure import order_spectra_figure
from crankorder.report.orders_figure import orders_figure
from crankorder.report.spectra_figure import spectra_figure
from crankorder.report.speed_figure import speed_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["campbell_figure", "order_spectra_figure", "orders_figure", "png_bytes", "spectra_figure", "speed_figure"]


def png_bytes(figure: Drawing | Figure, *, dpi: int) -> bytes:
    """PNG of a figure, the same bytes for the same figure (no date, fixed software name).

    ``figure`` from one of the functions here, or of matplotlib; ``dpi`` pixels per inch.
    """
    if isinstance(figure, Drawing):
        return figure.png(dpi=dpi)
    from crankorder.report.style import house_style

    buffer = BytesIO()
    with house_style():
        figure.savefig(
            buffer, format="png", dpi=dpi, metadata={"Software": "crankorder"}, pil_kwargs={"compress_level": 4}
        )
    return buffer.getvalue()
