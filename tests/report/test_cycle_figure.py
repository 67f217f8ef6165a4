"""The picture of the average cycle: true values, named marks, legible with one channel and with twelve."""

from typing import Any

import numpy as np
import pytest
import xarray as xr

from crankorder.orders.cycle_average import cycle_average, cycle_averages
from crankorder.plot.painter import picture_bytes
from crankorder.report.cycle_figure import cycle_figure
from crankorder.settings import load_settings
from made.recordings import line, steady, total
from made.texts import overlaps, words
from made.typed import from_dicts

cycle_figure = from_dicts(cycle_figure)

ORDERS = load_settings().orders
HOSTILE = "Ba$$in <script>alert(1)</script>"


def noise(sigma: float):
    return lambda time_s, _: sigma * np.random.default_rng(len(time_s)).standard_normal(len(time_s))


def cycles_of(speeds: list[float], channels: int = 3, sigma: float = 0.3, size: float = 1.0) -> xr.Dataset:
    signals = [
        total(line(2.0, size * (1 + k), 0.3), line(5.5, 0.3 * size), noise(sigma * size)) for k in range(channels)
    ]
    items = [
        cycle_average(*steady(signals, speed_rpm=rpm, duration_s=4.0, rate_hz=2000.0), settings=ORDERS)
        for rpm in speeds
    ]
    return cycle_averages(items, speed_bin_rpm=25.0)


@pytest.fixture(scope="module")
def cycles() -> xr.Dataset:
    return cycles_of([500.0, 800.0, 1100.0, 1400.0, 1700.0])


def lines(axes: Any, gid: str) -> list[Any]:
    return [one for one in axes.lines if one.get_gid() == gid]


def test_the_curves_are_the_data_and_close_the_cycle(cycles, settings):
    figure = cycle_figure(cycles, {"test": "t"}, settings=settings)
    assert len(figure.axes) == 9
    for column, row in enumerate((0, 2, 4)):
        for channel in range(3):
            (mean,) = lines(figure.axes[3 * column + channel], "mean")
            values = cycles["mean"].values[channel, row]
            np.testing.assert_array_equal(mean.get_ydata(), np.append(values, values[0]))
            assert np.asarray(mean.get_xdata())[-1] == 720.0


def test_dead_centres_speeds_and_units_are_named(cycles, settings):
    figure = cycle_figure(cycles, {"test": "t"}, settings=settings)
    found, count = set(words(figure)), int(cycles["n_cycles"].values[0, 0])
    assert {
        "firing TDC",
        "TDC",
        "m/s²",
        "A",
        f"500 rpm · {count} cycles",
        "Crank angle from top dead centre, °",
    } <= found
    assert [mark.get_xdata()[0] for mark in lines(figure.axes[0], "mark")] == [0, 360, 720]
    unknown = cycle_figure(cycles.assign_attrs(cycle_known=0), {"test": "t"}, settings=settings)
    assert "firing TDC" not in words(unknown)
    (said,) = (text for text in words(unknown) if "Which turn fires is not known" in text)
    assert said.endswith("orders up to 20.")  # nothing of it is cut
    nowhere = cycle_figure(cycles.assign_attrs(phase_reference="none"), {"test": "t"}, settings=settings)
    assert "TDC" not in words(nowhere)


@pytest.mark.slow
def test_a_spread_that_would_hide_the_mean_is_a_number_and_one_that_fits_is_a_band(settings):
    cycles = cycles_of([1000.0], 1)
    for gain, drawn in ((1.0, True), (100.0, False)):
        wide = cycles.assign(standard_deviation=gain * cycles["standard_deviation"])
        figure = cycle_figure(wide, {"test": "t"}, settings=settings)
        bands = {band.get_gid() for band in figure.axes[0].collections}
        assert ("deviation" in bands) == drawn
        assert any(text.startswith("± ") for text in words(figure))
        (mean,) = lines(figure.axes[0], "mean")
        low, high = figure.axes[0].get_ylim()
        assert np.ptp(mean.get_ydata()) > 0.3 * (high - low)


@pytest.mark.cases(1)
@pytest.mark.parametrize("channels", [1, 3, 12])
@pytest.mark.parametrize("speeds", [[1000.0], [500.0, 1000.0], [500.0, 700.0, 900.0, 1100.0]])
def test_no_two_texts_overlap_and_the_bytes_are_the_same_each_time(channels, speeds, settings):
    cycles = cycles_of(speeds, channels)
    figures = [cycle_figure(cycles, {"test": "t"}, settings=settings) for _ in range(2)]
    assert overlaps(figures[0]) == []
    assert picture_bytes(figures[0], dpi=50) == picture_bytes(figures[1], dpi=50)


def test_hostile_names_are_text_and_missing_channels_say_so(cycles, settings):
    hostile = cycles.assign_coords(channel=[HOSTILE, "B", "x" * 500])
    hostile["mean"][1] = np.nan
    hostile["n_cycles"][1] = 0
    figure = cycle_figure(hostile, {"test": "$\\frac{" + "y" * 5000}, settings=settings)
    picture_bytes(figure, dpi=50)
    assert overlaps(figure) == []
    assert "no whole cycle" in words(figure)
    assert not any(text.get_parse_math() for text in figure.texts)


@pytest.mark.cases(1)
@pytest.mark.parametrize("size", [1e9, 0.0, 1e-9])
def test_signals_of_any_size_and_dead_ones_are_drawn(size, settings):
    figure = cycle_figure(cycles_of([1000.0], 1, size=size), {"test": "t"}, settings=settings)
    assert picture_bytes(figure, dpi=50).startswith(b"\x89PNG")
    low, high = figure.axes[0].get_ylim()
    assert high > low


@pytest.mark.slow
def test_one_cycle_and_unknown_speed_are_drawn_without_a_spread(settings):
    cycles = cycles_of([1000.0], 1).isel(speed=[0])
    alone = cycles.assign_coords(speed=[np.nan])
    for name in ("standard_deviation", "standard_error"):
        alone[name][:] = np.nan
    alone["n_cycles"][:] = 1
    figure = cycle_figure(alone, {"test": "t"}, settings=settings)
    assert "unknown speed · 1 cycle" in words(figure)
    assert not figure.axes[0].collections


@pytest.mark.cases(1)
@pytest.mark.parametrize("cycles_averaged", [2, 3, 10])
def test_the_band_of_few_cycles_is_as_wide_as_student_says(cycles_averaged, settings):
    from scipy.stats import t

    cycles = cycles_of([800.0], channels=1)
    cycles["n_cycles"].values[:] = cycles_averaged
    figure = cycle_figure(cycles, {"test": "t"}, settings=settings)
    (band,) = [one for one in figure.axes[0].collections if one.get_gid() == "interval"]
    edges = band.get_paths()[0].vertices
    first = edges[np.isclose(edges[:, 0], 0.0), 1]
    error = cycles["standard_error"].values[0, 0, 0]
    assert np.ptp(first) == pytest.approx(2.0 * t.ppf(0.975, cycles_averaged - 1) * error, rel=1e-6)
