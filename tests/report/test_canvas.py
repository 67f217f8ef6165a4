"""Lines, areas and circles cover what geometry says they cover, as another rasteriser finds too."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as checked
from hypothesis import strategies as st
from PIL import Image

from crankorder.report.drawing.canvas import Canvas

BLACK = (0, 0, 0)


def _ink(canvas: Canvas) -> np.ndarray:
    return 1 - canvas.pixels[..., 0].astype(float) / 255


@given(st.floats(0, 2 * np.pi), st.floats(20, 45), st.floats(0.6, 6))
@checked(deadline=None)
def test_a_line_covers_its_length_times_its_width_and_two_half_circles_within_a_twentieth(
    angle: float, length: float, width: float
) -> None:
    canvas = Canvas(120, 120)
    ends = np.array([[60.3, 59.8], [60.3 + length * np.cos(angle), 59.8 + length * np.sin(angle)]])
    canvas.stroke(ends, width=width, rgb=BLACK)
    assert _ink(canvas).sum() == pytest.approx(length * width + np.pi * width**2 / 4, rel=0.05, abs=0.5)


def test_a_curve_is_what_agg_draws() -> None:
    from matplotlib.backends.backend_agg import RendererAgg
    from matplotlib.path import Path
    from matplotlib.transforms import IdentityTransform

    x = np.linspace(5, 295, 60)
    points = np.stack([x, 100 + 60 * np.sin(x / 9) + 20 * np.cos(x / 3.1)], axis=1)
    canvas = Canvas(300, 200)
    canvas.stroke(points, width=2.0, rgb=BLACK)
    agg = RendererAgg(300, 200, 72)
    pen = agg.new_gc()
    pen.set_linewidth(2.0)
    pen.set_foreground("black")
    pen.set_joinstyle("round")
    pen.set_capstyle("round")
    agg.draw_path(pen, Path(np.stack([points[:, 0], 200 - points[:, 1]], axis=1)), IdentityTransform())
    theirs = np.asarray(agg.buffer_rgba())[..., 3] / 255
    away = np.abs(_ink(canvas) - theirs)
    assert away.mean() < 0.003
    assert np.quantile(away[theirs > 0], 0.95) < 0.2


def test_an_area_covers_what_lies_between_its_curves() -> None:
    canvas = Canvas(200, 100)
    x = np.linspace(10, 190, 181)
    upper, lower = 30 + 10 * np.sin(x / 20), 60.5 + 8 * np.cos(x / 11)
    canvas.area(x, upper, lower, rgb=BLACK, alpha=1.0)
    assert _ink(canvas).sum() == pytest.approx(np.trapezoid(lower - upper, x), rel=0.003)


def test_nothing_is_drawn_at_nan_or_outside_the_clip() -> None:
    canvas = Canvas(60, 40)
    points = np.array([[5.0, 20], [20, 20], [np.nan, 20], [40, 20], [1e7, -1e7]])
    canvas.stroke(points, width=2, rgb=BLACK, clip=(10, 0, 50, 40))
    ink = _ink(canvas)
    assert ink[:, 22:38].sum() == 0
    assert ink[:, :10].sum() == 0
    assert ink[:, 50:].sum() == 0
    assert ink[:, 10:20].sum() == pytest.approx(20, abs=0.5)
    canvas.area(points[:, 0], points[:, 1] * np.nan, points[:, 1], rgb=BLACK, alpha=1)
    np.testing.assert_array_equal(_ink(canvas), ink)


def test_rings_and_discs_have_the_area_of_geometry() -> None:
    disc, ring = Canvas(60, 60), Canvas(60, 60)
    centre = np.array([[30.2, 29.7], [np.nan, 3]])
    disc.rings(centre, radius=12, width=0, rgb=BLACK)
    ring.rings(centre, radius=12, width=3, rgb=BLACK)
    assert _ink(disc).sum() == pytest.approx(np.pi * 144, rel=0.01)
    assert _ink(ring).sum() == pytest.approx(2 * np.pi * 12 * 3, rel=0.01)


def test_opacity_mixes_once_where_a_line_crosses_itself() -> None:
    canvas = Canvas(40, 40)
    canvas.stroke(np.array([[5.0, 5], [35, 35], [35, 5], [5, 35]]), width=3, rgb=BLACK, alpha=0.5)
    assert canvas.pixels.min() >= 127


@pytest.mark.parametrize("place", [(-30.0, 10.0), (55.0, 10.0), (10.0, -3.0), (10.0, 80.0)])
@pytest.mark.parametrize("upward", [False, True])
def test_text_that_leaves_the_sheet_is_cut(place: tuple[float, float], upward: bool) -> None:
    canvas = Canvas(60, 40)
    canvas.text("cut here", *place, size_px=16, rgb=BLACK, upward=upward)
    assert canvas.pixels.shape == (40, 60, 3)


def test_upward_text_is_the_same_text_turned() -> None:
    level, upright = Canvas(100, 100), Canvas(100, 100)
    level.text("Speed, rpm", 10, 60, size_px=16, rgb=BLACK)
    upright.text("Speed, rpm", 60, 90, size_px=16, rgb=BLACK, upward=True)
    np.testing.assert_array_equal(np.rot90(level.pixels), upright.pixels)


def test_another_reader_finds_the_same_pixels_in_the_png() -> None:
    canvas = Canvas(70, 30)
    canvas.image(np.random.default_rng(1).integers(0, 256, (20, 50, 3), dtype=np.uint8), 5, 7)
    canvas.text("x", 10, 20, size_px=16, rgb=(200, 10, 10), bold=True)
    picture = Image.open(io.BytesIO(canvas.png(dpi=130)))
    np.testing.assert_array_equal(np.asarray(picture), canvas.pixels)
    assert picture.info["Software"] == "crankorder"
    assert round(picture.info["dpi"][0]) == 130
