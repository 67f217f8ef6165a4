"""The pictures show what the findings hold, at the right place, legibly, and with the same bytes each time."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from crankorder.report.figures import campbell_figure, orders_figure, png_bytes, spectra_figure

HARD = [
    "one speed", "two speeds", "run-up", "hostile", "all zero", "thirty orders", "eight channels", "counts",
]  # fmt: skip


def _texts(figure: Figure) -> list[Text]:
    figure.draw_without_rendering()
    return [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]


def _overlaps(figure: Figure) -> list[tuple[str, str]]:
    """Pairs of drawn texts whose boxes overlap by more than a hair, and texts that leave the canvas."""
    renderer = figure.canvas.get_renderer()
    texts = _texts(figure)
    unseen = _unseen_ticks(figure)
    boxes = [
        (text.get_text(), text.get_window_extent(renderer).shrunk(0.94, 0.94))
        for text in texts
        if id(text) not in unseen
    ]
    beyond = [(text, "edge of the canvas") for text, box in boxes if not figure.bbox.fully_containsx(box.x1 * 0.9999)]
    if beyond:
        return beyond
    return [
        (one, two)
        for number, (one, first) in enumerate(boxes)
        for two, second in boxes[number + 1 :]
        if first.overlaps(second)
    ]


def _unseen_ticks(figure: Figure) -> set[int]:
    """Labels of ticks outside the limits of their axis: matplotlib keeps them but does not draw them."""
    unseen = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in [*axis.majorTicks, *axis.minorTicks]:
                if not low - 1e-9 * abs(low) <= tick.get_loc() <= high + 1e-9 * abs(high):
                    unseen |= {id(tick.label1), id(tick.label2)}
    return unseen


def _figures(drawn: Any, settings: Any) -> list[Figure]:
    channel = str(drawn.campbell["channel"].values[-1])
    return [
        campbell_figure(drawn.campbell, channel, drawn.findings, settings=settings),
        orders_figure(drawn.tracks, drawn.findings, settings=settings),
        spectra_figure(drawn.campbell, drawn.findings, settings=settings),
    ]


def _lines(figure: Figure, prefix: str) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    for axes in figure.axes:
        for line in axes.lines:
            gid = str(line.get_gid() or "")
            if gid.startswith(prefix):
                found.setdefault(gid, []).append(line)
    return found


def test_order_lines_lie_at_order_times_speed_over_sixty(campaign: Any, settings: Any) -> None:
    figure = campbell_figure(campaign.campbell, "Z", campaign.findings, settings=settings)
    found = _lines(figure, "order-")
    assert sorted(found) == sorted(f"order-{name}" for name in ("1", "2", "3", "4", "5.5", "8", "10"))
    for name, lines in found.items():
        for line in lines:
            order = float(name.removeprefix("order-"))
            np.testing.assert_allclose(line.get_xdata(), order * np.asarray(line.get_ydata()) / 60)


def test_the_map_spans_its_cells_and_shows_its_strongest_value_at_its_place(campaign: Any, settings: Any) -> None:
    figure = campbell_figure(campaign.campbell, "Z", campaign.findings, settings=settings)
    (image,) = figure.axes[0].images
    assert image.get_extent() == [0.0, 500.0, 275.0, 2025.0]
    shown = np.asarray(image.get_array())
    truth = campaign.campbell["amplitude"].sel(channel="Z").values
    assert shown.max() == pytest.approx(20 * np.log10(truth.max() / 1e-6), abs=1e-4)
    row, column = np.unravel_index(shown.argmax(), shown.shape)
    speed, frequency = np.unravel_index(truth.argmax(), truth.shape)
    assert 275 + 1750 * row / shown.shape[0] == pytest.approx(campaign.campbell["speed"].values[speed], abs=26)
    assert 500 * column / shown.shape[1] == pytest.approx(campaign.campbell["frequency"].values[frequency], abs=0.8)


def test_the_colour_bar_states_the_reference_and_the_map_is_perceptually_uniform(campaign: Any, settings: Any) -> None:
    figure = campbell_figure(campaign.campbell, "Z", campaign.findings, settings=settings)
    assert figure.axes[1].get_ylabel() == "Level, dB re 1e-6 m/s² (peak)"
    lightness = matplotlib.colormaps[figure.axes[0].images[0].get_cmap().name](np.linspace(0, 1, 64))[:, :3] @ [
        0.2126,
        0.7152,
        0.0722,
    ]
    assert (np.diff(lightness) > 0).all()


def test_natural_frequencies_and_mains_are_marked_differently_and_named_in_hertz(campaign: Any, settings: Any) -> None:
    figure = campbell_figure(campaign.campbell, "Z", campaign.findings, settings=settings)
    modes, tones = _lines(figure, "mode")["mode"], _lines(figure, "tone")["tone"]
    assert sorted(line.get_xdata()[0] for line in modes) == [60, 115, 172, 187, 230, 350, 457, 470]
    assert [line.get_xdata()[0] for line in tones] == [300]
    assert {line.get_color() for line in modes}.isdisjoint({line.get_color() for line in tones})
    words = {text.get_text() for text in _texts(figure)}
    assert {f"{mode} Hz" for mode in (60, 115, 172, 187, 230, 350, 457, 470)} <= words
    assert {"1", "2", "3", "4", "5.5", "8", "10"} <= words


def test_only_excited_crossings_inside_the_range_are_circled(campaign: Any, settings: Any) -> None:
    figure = campbell_figure(campaign.campbell, "Z", campaign.findings, settings=settings)
    ((circles,),) = _lines(figure, "crossings").values()
    wanted = {(115.0, 1725.0), (230.0, 1725.0), (60.0, 1800.0), (172.0, 60 * 172 / 5.5), (187.0, 1122.0)}
    assert set(zip(circles.get_xdata(), circles.get_ydata(), strict=True)) == wanted


def test_high_orders_that_leave_at_the_right_are_labelled_there(hard: Any, settings: Any) -> None:
    figure = campbell_figure(hard["run-up"].campbell, "mic", hard["run-up"].findings, settings=settings)
    right = figure.axes[0].get_position().x1
    places = {text.get_text(): text.get_position() for text in figure.texts}
    low, high = figure.axes[0].get_ylim()
    box = figure.axes[0].get_position()
    for order in (10, 15):
        x, y = places[str(order)]
        assert x > right
        assert y == pytest.approx(box.y0 + box.height * (60 * 500 / order - low) / (high - low), abs=0.01)


def test_at_most_the_set_number_of_orders_is_drawn_the_strongest_first(hard: Any, settings: Any) -> None:
    few = settings.model_copy(update={"max_labelled_orders": 3})
    drawn = hard["thirty orders"]
    strongest = sorted(
        (one for one in drawn.findings["orders"] if one["channel"] == "Z"), key=lambda one: -one["amplitude"]
    )
    figure = campbell_figure(drawn.campbell, "Z", drawn.findings, settings=few)
    assert set(_lines(figure, "order-")) == {f"order-{one['order']:g}" for one in strongest[:3]}


def test_tracks_are_drawn_where_they_stand_clear_and_their_values_are_the_data(campaign: Any, settings: Any) -> None:
    figure = orders_figure(campaign.tracks, campaign.findings, settings=settings)
    for axes, channel in zip(figure.axes[::2], "XYZ", strict=True):
        line = next(one for one in axes.lines if one.get_gid() == "order-5.5")
        track = campaign.tracks.sel(channel=channel, order=5.5)
        np.testing.assert_array_equal(line.get_xdata(), track["speed"])
        np.testing.assert_array_equal(line.get_ydata(), track["amplitude"])
        third = next(one for one in axes.lines if one.get_gid() == "order-3")
        noise = campaign.tracks.sel(channel=channel, order=3.0)
        hidden = np.isnan(third.get_ydata())
        np.testing.assert_array_equal(hidden, noise["amplitude"] < 3 * noise["standard_error"])
        assert hidden.any()


def test_axes_state_quantity_unit_and_peak(campaign: Any, settings: Any) -> None:
    orders = orders_figure(campaign.tracks, campaign.findings, settings=settings)
    assert orders.axes[0].get_ylabel() == "Amplitude (peak), m/s²"
    assert "top dead centre" in orders.axes[1].get_ylabel()
    spectra = spectra_figure(campaign.campbell, campaign.findings, settings=settings)
    labels = [axes.get_ylabel() for axes in spectra.axes]
    assert labels == [f"{name}\n(m/s²)²/Hz" for name in "XYZ"] + [f"{name}\nm/s² (peak)" for name in "XYZ"]


def test_a_missing_phase_reference_is_said_and_no_phase_is_drawn(campaign: Any, settings: Any) -> None:
    tracks = campaign.tracks.assign_attrs(phase_reference="none")
    figure = orders_figure(tracks, campaign.findings, settings=settings)
    assert all(not axes.lines for axes in figure.axes[1::2])
    assert "no phase reference" in {text.get_text() for text in _texts(figure)}


def test_the_median_spectrum_drops_what_moves_with_speed(campaign: Any, settings: Any) -> None:
    figure = spectra_figure(campaign.campbell, campaign.findings, settings=settings)
    line = next(one for one in figure.axes[2].lines if one.get_gid() == "spectrum")
    frequency, values = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    np.testing.assert_allclose(values, np.median(campaign.campbell["psd"].sel(channel="Z"), axis=0))
    near = (frequency > 250) & (frequency < 280)  # order 8 passes here, no mode stands here
    assert values[near].max() / np.median(values[near]) < 3


@pytest.mark.parametrize("name", ["campaign", *HARD])
def test_no_two_texts_of_any_picture_overlap(name: str, campaign: Any, hard: Any, settings: Any) -> None:
    for figure in _figures(campaign if name == "campaign" else hard[name], settings):
        assert _overlaps(figure) == []


@pytest.mark.parametrize("name", HARD)
def test_every_awkward_test_becomes_pictures_of_the_set_width(name: str, hard: Any, settings: Any) -> None:
    for figure in _figures(hard[name], settings):
        data = png_bytes(figure, dpi=60)
        assert data.startswith(b"\x89PNG\r\n\x1a\n")
        assert struct.unpack(">I", data[16:20])[0] == round(60 * settings.width_in)


def test_hostile_text_is_shown_literally_and_cut(hard: Any, settings: Any) -> None:
    drawn = hard["hostile"]
    for figure in _figures(drawn, settings):
        words = " ".join(text.get_text() for text in _texts(figure))
        assert "$\\frac{ </title><script>" in words
        assert max(len(text.get_text()) for text in _texts(figure)) < 320
        assert not any(text.get_parse_math() for text in figure.texts)


def test_the_bytes_are_the_same_each_time_and_carry_no_date(campaign: Any, settings: Any) -> None:
    first, again = ([png_bytes(figure, dpi=60) for figure in _figures(campaign, settings)] for _ in range(2))
    assert first == again
    for data in first:
        assert b"Software\x00crankorder" in data
        assert b"tIME" not in data
        assert b"Creation" not in data


def test_the_users_own_matplotlib_settings_change_nothing_and_are_left_alone(campaign: Any, settings: Any) -> None:
    def draw() -> bytes:
        return png_bytes(campbell_figure(campaign.campbell, "X", campaign.findings, settings=settings), dpi=60)

    plain = draw()
    with matplotlib.rc_context(
        {"font.size": 20.0, "axes.facecolor": "red", "lines.linewidth": 9.0, "savefig.bbox": "tight"}
    ):
        assert draw() == plain
        assert matplotlib.rcParams["font.size"] == 20.0


def test_pyplot_is_never_imported() -> None:
    import subprocess
    import sys

    program = "import sys, crankorder.report.figures; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_an_unknown_channel_is_refused(campaign: Any, settings: Any) -> None:
    with pytest.raises(KeyError):
        campbell_figure(campaign.campbell, "Q", campaign.findings, settings=settings)


def test_speeds_in_any_order_give_the_same_picture(make_test: Callable[..., Any], settings: Any) -> None:
    drawn = make_test(np.arange(600.0, 1001.0, 100.0), channels=("Z",), gains=(1.0,))
    shuffled = drawn.campbell.isel(speed=[3, 0, 4, 2, 1])
    one, two = (campbell_figure(which, "Z", drawn.findings, settings=settings) for which in (drawn.campbell, shuffled))
    assert png_bytes(one, dpi=50) == png_bytes(two, dpi=50)
