"""The picture of the operating shapes: hands that point where the phases do, numbers that fit, one to many channels."""

from typing import Any

import numpy as np
import pytest
import xarray as xr

from crankorder.orders.shapes import operating_shapes
from crankorder.plot.painter import picture_bytes
from crankorder.report.shapes_figure import shapes_figure
from crankorder.settings import load_settings
from made.recordings import frames_of
from made.texts import overlaps, words
from made.typed import from_dicts

shapes_figure = from_dicts(shapes_figure)

ORDERS = load_settings().orders
ALL = tuple(np.arange(1, 17) / 2)


def shapes_of(channels: int = 3, orders=ALL, speeds=(600.0, 1200.0), sigma: float = 0.02, **attrs: Any) -> xr.Dataset:
    rng = np.random.default_rng(channels)
    frames = []
    for rpm in speeds:
        size = rng.uniform(0.1, 1.0, (channels, 1, 20)) * (rpm / 600.0) ** 2
        steady = size * np.exp(2j * np.pi * rng.uniform(size=(channels, 1, 20)))
        noise = sigma * (rng.standard_normal((channels, 9, 20)) + 1j * rng.standard_normal((channels, 9, 20)))
        frames.append(frames_of(steady + noise, speed_rpm=rpm, **attrs))
    return operating_shapes(frames, orders, settings=ORDERS)


def hands(figure: Any) -> list[Any]:
    return [one for one in figure.axes[0].lines if one.get_gid() == "hand"]


def test_hands_point_where_the_phases_do_and_their_lengths_compare_the_row(settings):
    shapes = shapes_of(orders=(1.0, 2.0))
    figure = shapes_figure(shapes.isel(speed=[1]), {"test": "t"}, settings=settings)
    drawn = hands(figure)
    assert len(drawn) == 6
    one = shapes.isel(speed=1)
    for number, hand in enumerate(drawn):
        order, channel = divmod(number, 3)
        (x0, x1), (y0, y1) = hand.get_xdata(), hand.get_ydata()
        phase = np.degrees(np.arctan2(y1 - y0, x1 - x0))
        assert abs((phase - one["phase"].values[channel, order] + 180) % 360 - 180) < 1e-6
        length = np.hypot(x1 - x0, y1 - y0) / max(
            np.hypot(*np.diff([each.get_xdata(), each.get_ydata()])[:, 0]) for each in drawn[3 * order : 3 * order + 3]
        )
        amplitude = one["amplitude"].values[:, order]
        assert length == pytest.approx(amplitude[channel] / amplitude.max(), rel=1e-9)


def test_numbers_units_orders_and_origins_are_written(settings):
    shapes = shapes_of(orders=(1.0, 1.5), cycle_known=0)
    figure = shapes_figure(shapes.isel(speed=[0]), {"test": "t"}, settings=settings)
    found = words(figure)
    assert {"order 1", "order 1.5", "from TDC", "m/s²", "A", "B", "C"} <= set(found)
    assert f"from {shapes['phase_from'].values[1]}" in found
    assert sum("±" in text for text in found) >= 6
    assert any("600 rpm" in text for text in found)


def test_what_is_not_told_from_zero_has_a_bound_and_no_phase(settings):
    shapes = shapes_of(orders=(1.0,))
    shapes["amplitude_ci95"][0, :, 0, 0] = 0.0
    found = words(shapes_figure(shapes, {"test": "t"}, settings=settings))
    assert sum(text.startswith("< ") for text in found) == 1
    none = shapes.copy(deep=True)
    none["amplitude_ci95"][..., 0] = 0.0
    empty = shapes_figure(none, {"test": "t"}, settings=settings)
    assert "No order stands clear of the noise at this speed." in words(empty)
    assert picture_bytes(empty, dpi=50).startswith(b"\x89PNG")


@pytest.mark.cases(1)
@pytest.mark.parametrize("channels", [1, 2, 3, 6, 12, 14])
def test_no_two_texts_overlap_and_the_bytes_are_the_same_each_time(channels, settings):
    shapes = shapes_of(channels)
    figures = [shapes_figure(shapes, {"test": "t"}, settings=settings) for _ in range(2)]
    assert overlaps(figures[0]) == []
    assert len(hands(figures[0])) == 8 * channels
    assert picture_bytes(figures[0], dpi=50) == picture_bytes(figures[1], dpi=50)


def test_hostile_names_and_single_frames_are_drawn(settings):
    shapes = shapes_of(3).assign_coords(channel=["Ba$$in <script>", "x" * 300, "C"])
    for name in ("amplitude_ci95", "phase_ci95", "coherence"):
        shapes[name][:] = np.nan
    figure = shapes_figure(shapes, {"test": "$\\frac{" + "y" * 5000}, settings=settings)
    assert overlaps(figure) == []
    assert not any(text.get_parse_math() for text in figure.texts)
    assert not any("±" in text for text in words(figure))


@pytest.mark.cases(1)
@pytest.mark.parametrize("size", [1e-30, 1e30])
def test_amplitudes_of_any_size_are_written_so_that_they_fit(size, settings):
    shapes = shapes_of(12)
    for name in ("amplitude", "amplitude_ci95"):
        shapes[name] = shapes[name] * size
    assert overlaps(shapes_figure(shapes, {"test": "t"}, settings=settings)) == []


@pytest.mark.slow
def test_long_names_of_many_channels_stay_told_apart(settings):
    names = [f"main bearing {number}" for number in range(1, 7)]
    names += [f"accelerometer_at_the_gearbox_{number}" for number in range(6)]
    figure = shapes_figure(shapes_of(12).assign_coords(channel=names), {"test": "t"}, settings=settings)
    found = words(figure)
    assert all(any(text.endswith(str(number)) and len(text) < 14 for text in found) for number in range(7))
    assert overlaps(figure) == []


@pytest.mark.slow
def test_a_direction_that_says_nothing_is_not_written(settings):
    shapes = shapes_of(2, orders=(1.0, 2.0))
    shapes["phase_ci95"][0, :, 0] = np.array([-170.0, 190.0])
    found = words(shapes_figure(shapes, {"test": "t"}, settings=settings))
    assert sum(text.startswith("< ") for text in found) == 1
    assert found.count("–") == 1


def test_an_amplitude_whose_interval_has_no_end_is_a_dash_and_not_a_number(settings):
    shapes = shapes_of(3)
    shapes["amplitude_ci95"].values[0, ..., 0], shapes["amplitude_ci95"].values[0, ..., 1] = 0.0, np.inf
    figure = shapes_figure(shapes, {"test": "t"}, settings=settings)
    assert "–" in words(figure)
    assert not any(text.startswith("<") and not text[-1].isdigit() for text in words(figure))
