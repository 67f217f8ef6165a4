"""Every picture of a test by file name: which ones there are, and how each is drawn on its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from crankorder.findings import Findings
from crankorder.plot.campbell_figure import campbell_figure
from crankorder.plot.drawing import Drawing, Words
from crankorder.plot.orders_figure import orders_figure, shown_recordings, speed_figure
from crankorder.plot.spectra_figure import envelope_figure, order_spectra_figure, spectra_figure, spectrum_figure
from crankorder.report.sentences.of_lines import strongest_sentence
from crankorder.settings import ReportSettings

_ONE_ROW = (
    "Spectrum, {}: no speed is known, and a Campbell diagram needs several",
    "Spectrum by frequency and order, {}: the test ran at one speed, and a Campbell diagram needs several",
)
"""What stands in the place of a Campbell diagram, and why, by the number of speeds that are known."""

_SHAPES = "Operating shapes: amplitude and phase over the channels"
_ENVELOPE = "Envelope spectra: strikes in bearings, order by order"


@dataclass(frozen=True)
class Picture:
    """One picture to be drawn: its ``caption`` for the page, and ``figure``, which makes it."""

    caption: str
    figure: Callable[[], Any]
    settings: ReportSettings

    def drawn(self) -> tuple[bytes, bytes]:
        """The picture in its format, and as PNG for the page; any thread or process makes the same bytes."""
        from crankorder.plot.painter import picture_bytes

        figure, kind = self.figure(), self.settings.picture_format
        png = picture_bytes(figure, dpi=self.settings.dpi)
        return png if kind == "png" else picture_bytes(figure, dpi=self.settings.dpi, kind=kind), png


def prepare() -> None:
    """Load the drawing libraries and their fonts ahead of time."""
    from crankorder.plot.painter import picture_bytes

    picture_bytes(Drawing(1.0, 1.0, [Words(0.0, 0.0, "1"), Words(0.0, 0.0, "1", bold=True)]), dpi=50)


def pictures_of(
    groups: Mapping[str, xr.Dataset], findings: Findings, *, settings: ReportSettings, name_of: Callable[[str], str]
) -> dict[str, Picture]:
    """Pictures of a test by file name, in the order of the page, none of them drawn yet.

    ``groups`` are the datasets of the results by name, of which any may be missing, with the dims of ``data_schema/``;
    ``findings`` are those of the test, ``settings`` those of the report. ``name_of`` gives the part of a file name that
    stands for a channel, never the same for two.
    """
    pictures: dict[str, Picture] = {}
    if not settings.pictures:
        return pictures

    def plan(name: str, caption: str, figure: Callable[..., Any], *data: Any, **subtitle: str) -> None:
        picture = Picture(caption, partial(figure, *data, findings, settings=settings, **subtitle), settings)
        pictures[f"{name}.{settings.picture_format}"] = picture

    campbell, tracks = groups.get("campbell_map"), groups.get("order_tracks")
    speeds = 0 if campbell is None else int(np.isfinite(campbell["speed"].values).sum())
    what, figure = ("Campbell diagram, {}", campbell_figure) if speeds > 1 else (_ONE_ROW[speeds], spectrum_figure)
    for channel in campbell["channel"].values.tolist() if campbell is not None and campbell.sizes["speed"] else ():
        sentence = strongest_sentence(findings, channel)
        plan(f"campbell_{name_of(channel)}", what.format(channel), figure, campbell, channel, sentence=sentence)
    if "shaft" in groups and shown_recordings(groups["shaft"]):
        plan("speed", "Speed against time: how the machine was driven", speed_figure, groups["shaft"])
    if tracks is not None and tracks.sizes["order"] and np.isfinite(tracks["speed"].values).all():
        plan("orders", "Orders against speed: amplitude and phase", orders_figure, tracks)
    if "order_map" in groups:
        caption = "Order spectra: what shakes, order by order"
        plan("order_spectra", caption, order_spectra_figure, groups["order_map"])
    from crankorder.plot.cycle_figure import cycle_figure, shapes_figure

    for group, name, caption, drawn, dims in (
        ("cycle_average", "cycle", "Mean engine cycle and its spread", cycle_figure, ("speed",)),
        ("operating_shapes", "shapes", _SHAPES, shapes_figure, ("order", "speed")),
        ("envelope_map", "envelope", _ENVELOPE, envelope_figure, ("order", "speed")),
    ):
        if group in groups and all(groups[group].sizes[dim] for dim in dims):
            plan(name, caption, drawn, groups[group])
    if campbell is not None and campbell.sizes["speed"]:
        caption = f"Spectra: {'what stays and what moves with speed' if speeds > 1 else 'power density and amplitude'}"
        plan("spectra", caption, spectra_figure, campbell)
    return pictures
