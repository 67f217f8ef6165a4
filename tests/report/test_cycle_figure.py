"""The picture of the average cycle: true values, named marks, legible with one channel and with twelve."""

from itertools import product

import numpy as np
import pytest
from scipy.special import stdtrit

from crankorder.orders.cycle_average import cycle_average, cycle_averages
from crankorder.orders.shapes import operating_shapes
from crankorder.plot.cycle_figure import cycle_figure, shapes_figure
from crankorder.plot.drawing import Area
from crankorder.plot.painter import picture_bytes
from made.recordings import frames_of, line, steady, total
from made.shipped import ORDERS
from made.typed import from_dicts
from report.conftest import overlaps, texts

cycle_figure = from_dicts(cycle_figure)

HOSTILE = "Ba$$in <script>alert(1)</script>"


def cycles_of(speeds, channels=3, size=1.0):
    def noise(time_s, _):
        return 0.3 * size * np.random.default_rng(len(time_s)).standard_normal(len(time_s))

    signals = [total(line(2.0, size * (1 + k), 0.3), line(5.5, 0.3 * size), noise) for k in range(channels)]
    recordings = [steady(signals, speed_rpm=rpm, duration_s=4.0, rate_hz=2000.0) for rpm in speeds]
    return cycle_averages([cycle_average(*one, settings=ORDERS) for one in recordings], speed_bin_rpm=25.0)


@pytest.fixture(scope="module")
def cycles():
    return cycles_of([500.0, 800.0, 1100.0, 1400.0, 1700.0])


def areas(figure, name):
    return [part for part in figure.parts if isinstance(part, Area) and part.name.startswith(name)]


def test_the_curves_are_the_data_and_close_the_cycle(cycles, settings):
    figure = cycle_figure(cycles, {"test": "t"}, settings=settings)
    curves = figure.strokes("mean")
    for mean, (column, channel) in zip(curves, np.ndindex(3, 3), strict=True):
        values = cycles["mean"].values[channel, 2 * column]
        np.testing.assert_array_equal(mean.values[1], np.append(values, values[0]))
        assert mean.values[0][-1] == 720.0


def test_dead_centres_speeds_and_units_are_named(cycles, settings):
    figure = cycle_figure(cycles, {"test": "t"}, settings=settings)
    found, count = set(texts(figure)), int(cycles["n_cycles"].values[0, 0])
    named = {"firing TDC", "TDC", "m/s²", "A", f"500 rpm · {count} cycles", "Crank angle from top dead centre, °"}
    assert named <= found
    assert [mark.values[0][0] for mark in figure.strokes("mark")[:3]] == [0, 360, 720]
    unknown = cycle_figure(cycles.assign_attrs(cycle_known=0), {"test": "t"}, settings=settings)
    assert "firing TDC" not in texts(unknown)
    (said,) = (text for text in texts(unknown) if "Which turn fires is not known" in text)
    assert said.endswith("orders up to 20.")  # nothing of it is cut
    nowhere = cycle_figure(cycles.assign_attrs(phase_reference="none"), {"test": "t"}, settings=settings)
    assert "TDC" not in texts(nowhere)


def test_a_spread_that_would_hide_the_mean_is_a_number_and_one_that_fits_is_a_band(settings):
    cycles = cycles_of([1000.0], 1)
    for gain, drawn in ((1.0, True), (100.0, False)):
        wide = cycles.assign(standard_deviation=gain * cycles["standard_deviation"])
        figure = cycle_figure(wide, {"test": "t"}, settings=settings)
        assert bool(areas(figure, "deviation")) == drawn
        assert any(text.startswith("± ") for text in texts(figure))
        (mean,) = figure.strokes("mean")
        assert np.ptp(mean.points[:, 1]) > 0.3 * mean.within[3]


def test_hostile_names_are_text_and_missing_channels_say_so(cycles, settings):
    hostile = cycles.assign_coords(channel=[HOSTILE, "B", "x" * 500])
    hostile["mean"][1] = np.nan
    hostile["n_cycles"][1] = 0
    figure = cycle_figure(hostile, {"test": "$\\frac{" + "y" * 5000}, settings=settings)
    picture_bytes(figure, dpi=50)
    assert overlaps(figure) == []
    assert "no whole cycle" in texts(figure)


@pytest.mark.cases(1)
@pytest.mark.parametrize("size", [1e9, 0.0, 1e-9])
def test_signals_of_any_size_and_dead_ones_are_drawn(size, settings):
    figure = cycle_figure(cycles_of([1000.0], 1, size=size), {"test": "t"}, settings=settings)
    assert picture_bytes(figure, dpi=50).startswith(b"\x89PNG")
    assert all(np.isfinite(mean.points).all() for mean in figure.strokes("mean"))


def test_one_cycle_and_unknown_speed_are_drawn_without_a_spread(settings):
    alone = cycles_of([1000.0], 1).assign_coords(speed=[np.nan])
    alone["n_cycles"][:] = 1
    for name in ("standard_deviation", "standard_error"):
        alone[name][:] = np.nan
    figure = cycle_figure(alone, {"test": "t"}, settings=settings)
    assert "unknown speed · 1 cycle" in texts(figure)
    assert not areas(figure, "")


@pytest.mark.cases(1)
@pytest.mark.parametrize("cycles_averaged", [2, 3, 10])
def test_the_band_of_few_cycles_is_as_wide_as_student_says(cycles_averaged, settings):
    cycles = cycles_of([800.0], channels=1)
    cycles["n_cycles"].values[:] = cycles_averaged
    figure = cycle_figure(cycles, {"test": "t"}, settings=settings)
    (band,), (mean,) = areas(figure, "interval"), figure.strokes("mean")
    per_inch = np.ptp(mean.values[1]) / np.ptp(mean.points[:, 1])
    first = band.points[band.points[:, 0] == mean.points[0, 0], 1]
    error = cycles["standard_error"].values[0, 0, 0]
    assert np.ptp(first) * per_inch == pytest.approx(2.0 * stdtrit(cycles_averaged - 1, 0.975) * error, rel=1e-6)


# The picture of the operating shapes: hands that point where the phases do, numbers that fit, one to many channels.


shapes_figure = from_dicts(shapes_figure)

ALL = tuple(np.arange(1, 17) / 2)


def shapes_of(channels=3, orders=ALL, speeds=(600.0, 1200.0), sigma=0.02, **attrs):
    rng = np.random.default_rng(channels)
    frames = []
    for rpm in speeds:
        size = rng.uniform(0.1, 1.0, (channels, 1, 20)) * (rpm / 600.0) ** 2
        steady = size * np.exp(2j * np.pi * rng.uniform(size=(channels, 1, 20)))
        noise = sigma * (rng.standard_normal((channels, 9, 20)) + 1j * rng.standard_normal((channels, 9, 20)))
        frames.append(frames_of(steady + noise, speed_rpm=rpm, **attrs))
    return operating_shapes(frames, orders, settings=ORDERS)


def test_hands_point_where_the_phases_do_and_their_lengths_compare_the_row(settings):
    shapes = shapes_of(orders=(1.0, 2.0))
    figure = shapes_figure(shapes.isel(speed=[1]), {"test": "t"}, settings=settings)
    ends = np.array([np.diff(hand.points, axis=0)[0] for hand in figure.strokes("hand")])
    hands = (ends @ [1.0, 1.0j]).reshape(2, 3)  # order, channel
    phase, amplitude = (shapes[name].isel(speed=1).values.T for name in ("phase", "amplitude"))
    np.testing.assert_allclose(np.angle(hands * np.exp(-1j * np.radians(phase))), 0.0, atol=1e-8)
    for length, size in zip(np.abs(hands), amplitude, strict=True):
        np.testing.assert_allclose(length / length.max(), size / size.max(), rtol=1e-9)


def test_numbers_units_orders_and_origins_are_written(settings):
    shapes = shapes_of(orders=(1.0, 1.5), cycle_known=0)
    figure = shapes_figure(shapes.isel(speed=[0]), {"test": "t"}, settings=settings)
    found = texts(figure)
    assert {"order 1", "order 1.5", "from TDC", "m/s²", "A", "B", "C"} <= set(found)
    assert f"from {shapes['phase_from'].values[1]}" in found
    assert sum("±" in text for text in found) >= 6
    assert any("600 rpm" in text for text in found)


def test_what_is_not_told_from_zero_has_a_bound_and_no_phase(settings):
    shapes = shapes_of(orders=(1.0,))
    unclear = shapes.copy(deep=True)
    shapes["amplitude_ci95"][0, :, 0, 0] = 0.0
    unclear["phase_ci95"][0, :, 0] = np.array([-170.0, 190.0])  # any direction
    for given in (shapes, unclear):
        found = texts(shapes_figure(given, {"test": "t"}, settings=settings))
        assert sum(text.startswith("< ") for text in found) == found.count("–") == 1
    endless = shapes_of()
    endless["amplitude_ci95"][0, ..., 0], endless["amplitude_ci95"][0, ..., 1] = 0.0, np.inf
    found = texts(shapes_figure(endless, {"test": "t"}, settings=settings))
    assert "–" in found and all(text[-1].isdigit() for text in found if text.startswith("<"))
    none = shapes.copy(deep=True)
    none["amplitude_ci95"][..., 0] = 0.0
    empty = shapes_figure(none, {"test": "t"}, settings=settings)
    assert "No order stands clear of the noise at this speed." in texts(empty)
    assert picture_bytes(empty, dpi=50).startswith(b"\x89PNG")


def test_long_names_of_many_channels_stay_told_apart(settings):
    names = [f"main bearing {number}" for number in range(1, 7)]
    names += [f"accelerometer_at_the_gearbox_{number}" for number in range(6)]
    figure = shapes_figure(shapes_of(12).assign_coords(channel=names), {"test": "t"}, settings=settings)
    found = texts(figure)
    assert all(any(text.endswith(str(number)) and len(text) < 14 for text in found) for number in range(7))
    assert overlaps(figure) == []


SPEEDS = ([1000.0], [500.0, 1000.0], [500.0, 700.0, 900.0, 1100.0])


@pytest.mark.cases(2)
@pytest.mark.parametrize(("speeds", "channels"), [*product(SPEEDS, (1, 3, 12)), *product([None], (1, 2, 3, 6, 12, 14))])
def test_no_two_texts_overlap_and_the_bytes_are_the_same_each_time(speeds, channels, settings):
    data, draw = (cycles_of(speeds, channels), cycle_figure) if speeds else (shapes_of(channels), shapes_figure)
    figures = [draw(data, {"test": "t"}, settings=settings) for _ in range(2)]
    assert overlaps(figures[0]) == []
    assert speeds or len(figures[0].strokes("hand")) == 8 * channels
    assert picture_bytes(figures[0], dpi=50) == picture_bytes(figures[1], dpi=50)


@pytest.mark.cases(1)
@pytest.mark.parametrize(("size", "channels"), [(1.0, 3), (1e-30, 12), (1e30, 12)])
def test_hostile_names_single_frames_and_amplitudes_of_any_size_are_drawn(size, channels, settings):
    names = ["Ba$$in <script>", "x" * 300, *map(str, range(2, channels))]
    shapes = shapes_of(channels).assign_coords(channel=names)
    for name in ("amplitude", "amplitude_ci95"):
        shapes[name] = shapes[name] * size
    for name in ("amplitude_ci95", "phase_ci95", "coherence") if size == 1.0 else ():
        shapes[name][:] = np.nan
    figure = shapes_figure(shapes, {"test": "$\\frac{" + "y" * 5000}, settings=settings)
    assert overlaps(figure) == []
    assert size != 1.0 or not any("±" in text for text in texts(figure))
