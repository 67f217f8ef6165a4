"""The pictures show what the findings hold, at the right place, legibly, and with the same bytes each time."""

import io
import re
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import matplotlib
import numpy as np
import pytest
import xarray as xr
from PIL import Image

from crankorder.plot.campbell_figure import campbell_figure
from crankorder.plot.drawing import Field, Rings
from crankorder.plot.orders_figure import changing_recordings, orders_figure, speed_figure
from crankorder.plot.painter import picture_bytes
from crankorder.plot.palette import LIGHT, level_colours
from crankorder.plot.spectra_figure import envelope_figure, order_spectra_figure, spectra_figure, spectrum_figure
from crankorder.report.pictures import pictures_of
from crankorder.shaft.speeds import speed_trace, trace_variables
from made.typed import from_dicts
from report.conftest import DRAWN, envelope_map, overlaps, texts

campbell_figure, orders_figure, pictures_of, speed_figure = map(
    from_dicts, (campbell_figure, orders_figure, pictures_of, speed_figure)
)
envelope_figure, order_spectra_figure, spectra_figure, spectrum_figure = map(
    from_dicts, (envelope_figure, order_spectra_figure, spectra_figure, spectrum_figure)
)


def _figures(drawn, settings):
    channel = str(drawn.campbell["channel"].values[-1])
    return [
        campbell_figure(drawn.campbell, channel, drawn.findings, settings=settings),
        orders_figure(drawn.tracks, drawn.findings, settings=settings),
        spectra_figure(drawn.campbell, drawn.findings, settings=settings),
        spectrum_figure(drawn.campbell, channel, drawn.findings, settings=settings),
        order_spectra_figure(drawn.order_map, drawn.findings, settings=settings),
    ]


def _lines(drawing, prefix):
    """Values of the lines by name."""
    found: dict[str, list[Any]] = {}
    for stroke in drawing.strokes(prefix):
        found.setdefault(stroke.name, []).append(stroke.values)
    return found


def _words(drawing):
    return set(texts(drawing))


@pytest.fixture(scope="module")
def diagram(campaign, settings):
    """The Campbell diagram of channel Z."""
    return campbell_figure(campaign.campbell, "Z", campaign.findings, settings=settings)


def test_order_lines_lie_at_order_times_speed_over_sixty_where_the_ticks_say_so(diagram):
    places = {words.text: words for words in diagram.words if words.name == "tick" and words.along != "left"}
    inch_per_hz = (places["400"].x - places["100"].x) / 300
    inch_per_rpm = (places["1500"].y - places["500"].y) / 1000
    lines = diagram.strokes("order-")
    assert {line.name for line in lines} == {f"order-{name}" for name in ("1", "2", "3", "4", "5.5", "8", "10")}
    for line in lines:
        frequency, speed = line.values
        np.testing.assert_allclose(frequency, float(line.name.removeprefix("order-")) * speed / 60)
        np.testing.assert_allclose(line.points[:, 0], places["100"].x + inch_per_hz * (frequency - 100), atol=1e-9)
        np.testing.assert_allclose(line.points[:, 1], places["500"].y + inch_per_rpm * (speed - 500), atol=1e-9)


def test_the_map_shows_every_line_at_its_place_in_the_png(campaign, settings):
    drawn = {**campaign.findings, "orders": [], "modes": [], "crossings": []}  # nothing lies over the map
    figure = campbell_figure(campaign.campbell, "Z", drawn, settings=settings)
    pixels = np.asarray(Image.open(io.BytesIO(picture_bytes(figure, dpi=settings.dpi))))[::-1]  # the slowest row first
    box = next(part for part in figure.parts if isinstance(part, Field)).box
    left, bottom, width, height = (round(settings.dpi * inch) for inch in box)
    shown = pixels[bottom : bottom + height, left + 1 : left + width - 1, :3].astype(int)
    truth = campaign.campbell["amplitude"].sel(channel="Z").values
    rows, columns, _ = shown.shape
    for speed in range(0, truth.shape[0], 3):
        colours = shown[int(50 * speed / 1700 * rows)]
        shade = 4 * np.abs(colours[:, None, :] - level_colours()[::4].astype(int)).sum(axis=2).argmin(axis=1)
        strongest = int(truth[speed].argmax())
        column = min(int(strongest / (truth.shape[1] - 1) * columns), columns - 1)
        assert shade[max(column - 2, 0) : column + 3].max() >= shade.max() - 8


def test_the_colour_bar_states_the_reference_and_the_map_is_perceptually_uniform(diagram):
    assert "Level, dB re 1e-6 m/s² (peak)" in _words(diagram)
    np.testing.assert_allclose(level_colours(), 255 * matplotlib.colormaps["inferno"](np.arange(256))[:, :3], atol=0.51)
    assert (np.diff(level_colours() @ [0.2126, 0.7152, 0.0722])[::8] > 0).all()


def test_modes_those_in_doubt_and_tones_are_marked_differently_and_named_in_hertz(campaign, full, settings):
    figure = campbell_figure(campaign.campbell, "Z", full, settings=settings)
    marked = {kind: figure.strokes(kind) for kind in ("mode", "doubt", "tone")}
    places = {kind: sorted(line.values[0][0] for line in lines) for kind, lines in marked.items()}
    assert places == {"mode": [60, 115, 172, 187, 230, 350, 457, 470], "doubt": [265.0], "tone": [58.3, 300.0]}
    assert len({(line.color, line.dashes) for lines in marked.values() for line in lines}) == 3
    assert {*(f"{mode:g} Hz" for mode in places["mode"]), "265? Hz", "58.3 Hz", "not decided", "5.5"} <= _words(figure)


def test_only_excited_crossings_inside_the_range_are_circled(diagram):
    (circles,) = (part for part in diagram.parts if isinstance(part, Rings) and part.name == "crossings")
    wanted = {(115.0, 1725.0), (230.0, 1725.0), (60.0, 1800.0), (172.0, 60 * 172 / 5.5), (187.0, 1122.0)}
    assert set(zip(*circles.values, strict=True)) == wanted


def test_tracks_are_drawn_where_they_stand_clear_and_their_values_are_the_data(campaign, settings):
    figure = orders_figure(campaign.tracks, campaign.findings, settings=settings)
    steady, noisy = _lines(figure, "order-5.5")["order-5.5"], _lines(figure, "order-3")["order-3"]
    for number, channel in enumerate("XYZ"):
        track = campaign.tracks.sel(channel=channel, order=5.5)
        np.testing.assert_array_equal(steady[number][0], track["speed"])
        np.testing.assert_array_equal(steady[number][1], track["amplitude"])
        noise = campaign.tracks.sel(channel=channel, order=3.0)
        hidden = np.isnan(noisy[number][1])
        unsure = (noise["amplitude"] < 3 * noise["standard_error"]) | (noise["amplitude_low"] <= 0)
        np.testing.assert_array_equal(hidden, unsure)
        assert hidden.any()


def test_of_many_orders_the_strongest_six_have_colours_and_the_others_are_light(drawn_of, settings):
    drawn = drawn_of("sixty orders")
    figure = orders_figure(drawn.tracks, drawn.findings, settings=settings)
    peaks = drawn.tracks["amplitude"].sel(channel="Z").max("speed")
    strongest = set(drawn.tracks["order"].values[np.argsort(-peaks.values)[:6]].tolist())
    colours = {float(stroke.name.removeprefix("order-")): stroke.color for stroke in figure.strokes("order-")}
    assert len(colours) == settings.max_labelled_orders
    assert {order for order, color in colours.items() if color != LIGHT} == strongest
    assert len({colours[order] for order in strongest}) == 6


def test_axes_state_quantity_unit_and_peak(campaign, settings):
    orders = _words(orders_figure(campaign.tracks, campaign.findings, settings=settings))
    assert {"Amplitude (peak), m/s²", "Phase from", "top dead centre, °"} <= orders
    spectra = spectra_figure(campaign.campbell, campaign.findings, settings=settings)
    labels = [words.text for words in spectra.words if words.name == "y label"]
    assert sorted(labels) == sorted([*"XXYYZZ", *3 * ["(m/s²)²/Hz"], *3 * ["m/s² (peak)"]])


def test_a_missing_phase_reference_is_said_and_no_phase_is_drawn(campaign, settings):
    tracks = campaign.tracks.assign_attrs(phase_reference="none")
    figure = orders_figure(tracks, campaign.findings, settings=settings)
    assert not figure.strokes("phase")
    assert "no phase reference" in _words(figure)
    assert orders_figure(campaign.tracks, campaign.findings, settings=settings).strokes("phase")


@pytest.mark.cases(3)
@pytest.mark.parametrize("name", DRAWN)
def test_every_picture_has_the_set_width_no_text_on_another_and_hostile_text_literally_and_cut(
    name, drawn_of, settings
):
    for figure in _figures(drawn_of(name), settings):
        assert overlaps(figure) == []
        assert Image.open(io.BytesIO(picture_bytes(figure, dpi=60))).width == round(60 * settings.width_in)
        assert name != "hostile" or "$\\frac{ </title><script>" in " ".join(_words(figure))
        assert max(len(text) for text in _words(figure)) < 320


def test_pages_drawn_in_threads_have_the_same_bytes_which_carry_no_date(campaign, settings):
    groups = {"campbell_map": campaign.campbell, "order_map": campaign.order_map, "order_tracks": campaign.tracks}
    planned = pictures_of(groups, campaign.findings, settings=settings, name_of=str)
    names = [*(f"campbell_{channel}" for channel in "XYZ"), "orders", "order_spectra", "spectra"]
    assert list(planned) == [f"{name}.png" for name in names]
    alone = [picture.drawn() for picture in planned.values()]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda picture: picture.drawn(), planned.values())) == alone
    assert all(b"Software\x00crankorder" in data and not re.search(b"tIME|Creation", data) for data, _ in alone)


@pytest.mark.parametrize("rpm", [1500.0, np.nan])
def test_one_speed_or_none_has_spectra_in_place_of_campbell_diagrams_and_says_why(drawn_of, settings, rpm):
    drawn = drawn_of("one speed")
    campbell = drawn.campbell.assign_coords(speed=[rpm])
    planned = pictures_of({"campbell_map": campbell}, drawn.findings, settings=settings, name_of=str)
    channels = campbell["channel"].values.tolist()
    assert list(planned) == [*(f"campbell_{name}.png" for name in channels), "spectra.png"]
    why = "the test ran at one speed" if rpm > 0 else "no speed is known"
    assert all(why in planned[f"campbell_{name}.png"].caption for name in channels)
    figure = spectrum_figure(campbell, channels[-1], drawn.findings, settings=settings)
    causes = {one["explained_by"] for one in drawn.findings["orders"] if one["channel"] == channels[-1]}
    assert causes <= {words.text for words in figure.words if words.name == "cause"}
    assert f"channel {channels[-1]}{' at 1500 rpm' if rpm > 0 else ', speed unknown'}" in " ".join(_words(figure))
    assert ("Order (cycles per crank revolution)" in _words(figure)) is bool(rpm > 0)
    marked = {name: values[0][0][0] for name, values in _lines(figure, "order-").items()}
    assert marked == ({name: pytest.approx(float(name[6:]) * 25.0) for name in marked} if rpm > 0 else {})
    assert bool(marked) is bool(rpm > 0) and not overlaps(figure)


def test_without_findings_no_claim_is_drawn_and_it_is_said(campaign, settings):
    empty: dict[str, Any] = {key: [] for key in ("orders", "modes", "crossings", "bearings", "lines", "quality")}
    empty |= {"test": "maps", "not_asked_for": "not asked for: the recipe wants campbell map only"}
    figure = campbell_figure(campaign.campbell, "Z", empty, settings=settings)
    assert not [*figure.strokes("mode"), *figure.strokes("tone")]
    assert {"order, for orientation", "Level over frequency and speed; findings were not asked for."} <= _words(figure)
    assert not any(words.bold and words.name.startswith("label-") for words in figure.words)
    assert overlaps(figure) == []


def test_a_trace_keeps_the_turns_the_swing_and_the_times_of_the_speed():
    time = np.linspace(2.0, 62.0, 50_000)
    speed = 300 + 95 * (time - 2) + 40 * np.sin(2 * np.pi * 3 * time)
    at, mean, low, high = speed_trace(time, speed)
    assert at[0] > 2 and at[-1] < 62
    assert np.sum(mean) * 60 / len(mean) == pytest.approx(np.trapezoid(speed, time), rel=1e-9)
    assert (low.min(), high.max()) == (speed.min(), speed.max())
    assert np.all((low <= mean) & (mean <= high))


def _shaft(*recordings):
    shafts = [xr.Dataset({"time": ("knot", time), "speed": ("knot", speed)}) for time, speed in recordings]
    names = [f"recording_{number}.h5" for number in range(len(shafts))]
    return xr.Dataset(trace_variables(shafts), {"recording": ("recording", names)})


def test_speed_is_drawn_where_it_changes_and_not_for_swing_within_a_turn(campaign, settings):
    time = np.linspace(0, 30, 20_000)
    swing = 900 + 200 * np.sin(2 * np.pi * 15 * time)
    assert changing_recordings(_shaft((time, swing))) == []
    shaft = _shaft((time, swing), (time + 5, 300 + 100 * time), (time[:300], 3000 - 1000 * time[:300]))
    assert changing_recordings(shaft) == [1, 2]
    figure = speed_figure(shaft, campaign.findings, settings=settings)
    first, second = figure.strokes("speed-")
    assert (first.values[0][0], first.values[1][-1]) == (pytest.approx(0, abs=0.1), pytest.approx(3300, abs=10))
    assert np.nanmax(second.values[1]) == pytest.approx(3000, abs=1)
    assert overlaps(figure) == []
    groups = {"shaft": shaft}
    assert list(pictures_of(groups, campaign.findings, settings=settings, name_of=str)) == ["speed.png"]


def test_a_steady_line_below_a_sweeping_natural_frequency_stands_out_of_the_order_spectra(settings):
    rng = np.random.default_rng(5)
    order, speed = np.arange(0.0, 20.01, 0.1), np.linspace(300.0, 2000.0, 35)
    hz = order * speed[:, None] / 60
    floor = 0.05 + 3.0 * np.exp(-(((hz - 150.0) / 20.0) ** 2))  # larger than the line wherever it passes
    amplitude = floor * np.sqrt(rng.chisquare(40, floor.shape) / 40)
    line = int(np.argmin(np.abs(order - 8.0)))
    amplitude[:, line] = np.hypot(amplitude[:, line], 0.3)
    order_map = xr.Dataset(
        {"amplitude": (("channel", "speed", "order"), amplitude[None]), "unit": ("channel", ["m/s2"])},
        coords={"channel": ["Z"], "speed": speed, "order": order},
    )
    figure = order_spectra_figure(order_map, {"test": "t"}, settings=settings)
    (mean,), (around,) = ([one.values[1] for one in figure.strokes(name)] for name in ("spectrum", "floor"))
    assert int(np.nanargmax(mean / around)) == line
    assert int(np.nanargmax(amplitude.max(axis=0))) != line  # the largest over the speeds buries it
    assert mean[line] == pytest.approx(np.exp(np.log(amplitude[:, line]).mean()))  # in the channel's unit


# Beside the Campbell diagram stand the speeds to avoid and the free ones, at their place on its scale.


def test_the_strip_holds_the_ranges_of_the_findings_at_their_speeds(campaign, full, settings):
    figure = campbell_figure(campaign.campbell, "Z", full, settings=settings)
    left, bottom, width, height = next(part for part in figure.parts if isinstance(part, Field)).box
    ranges = {stroke.name: stroke for stroke in figure.strokes("avoid-")}
    assert [tuple(stroke.values[1]) for stroke in ranges.values()] == [(1755.0, 1850.0), (1690.0, 1760.0)]
    assert [tuple(stroke.values[1]) for stroke in figure.strokes("free-")] == [(300.0, 1690.0), (1850.0, 2000.0)]
    for stroke in [*ranges.values(), *figure.strokes("free-")]:
        assert (stroke.points[:, 0] > left + width).all()
        np.testing.assert_allclose(stroke.points[:, 1], bottom + height * (stroke.values[1] - 300) / 1700)
    words = _words(figure)
    assert {"1800", "1725", "speed to avoid", "free speeds"} <= words
    assert overlaps(figure) == []
    without = campbell_figure(campaign.campbell, "Z", campaign.findings, settings=settings)
    assert not [*without.strokes("avoid-"), *without.strokes("free-")]
    assert not {"speed to avoid", "free speeds"} & _words(without)


def test_a_crossing_that_was_not_judged_leaves_its_speed_neither_free_nor_to_avoid(campaign, full, settings):
    full["crossings"] = [{"order": 4.0, "mode_hz": 60.0, "rpm": 900.0, "in_range": True, "excited": False}]
    full["crossings"][0]["verdict"] = "not decided"
    figure = campbell_figure(campaign.campbell, "Z", full, settings=settings)
    (mark,) = figure.strokes("open-")
    assert tuple(mark.values[1]) == pytest.approx((895.5, 904.5))
    assert "not free, or not known" in _words(figure)


# The envelope's order spectra show the lines that bearings would make and ring those that were found.


def test_expected_lines_are_marked_in_every_channel_and_the_found_one_is_ringed_at_its_peak(full, settings):
    envelope = envelope_map(("X", "Y", "Z"))
    figure = envelope_figure(envelope, full, settings=settings)
    assert sorted(stroke.values[0][0] for stroke in figure.strokes("expected")) == 3 * [3.585] + 3 * [5.5]
    (ring,) = (part for part in figure.parts if isinstance(part, Rings) and part.name == "found")
    mean = (envelope["amplitude"].sel(channel="Z") ** 4).mean("speed") ** 0.25
    near = mean.sel(order=slice(3.4, 3.7))
    assert (ring.values[0][0], ring.values[1][0]) == (3.556, pytest.approx(float(near.max())))
    multiples = [stroke.values[0][0] for stroke in figure.strokes("multiple-")]
    assert multiples == pytest.approx([2 * 3.556, 3 * 3.556, 4 * 3.556])
    sidebands = [stroke.values[0][0] for stroke in figure.strokes("sideband")]
    assert sidebands == pytest.approx([1.556, 2.556, 4.556, 5.556])
    words = _words(figure)
    assert {"BPFO 3.585", "3.556", "its sidebands", "N·fs 5.5", "band 2000–4000 Hz", "found"} <= words


def test_the_mean_is_by_power_of_the_squared_envelope_and_unknown_speeds_take_no_part(full, settings):
    envelope = envelope_map(("Z",), speeds=2)
    for second, mean in ((4.0, ((3**4 + 4**4) / 2) ** 0.25), (np.nan, 3.0)):
        envelope["amplitude"][0, 0], envelope["amplitude"][0, 1] = 3.0, second
        (line,) = envelope_figure(envelope, full, settings=settings).strokes("spectrum")
        np.testing.assert_allclose(line.values[1], mean)


def test_nothing_found_is_said(full, settings):
    envelope = envelope_map(("Z",), speeds=1)
    full["bearings"] = [record for record in full["bearings"] if record["seen_in"] == "vibration"]
    figure = envelope_figure(envelope, full, settings=settings)
    assert not [part for part in figure.parts if isinstance(part, Rings)]
    assert "speeds" not in str(figure.words) and "No bearing line stands over the floor." in str(figure.words)
    none = envelope_figure(envelope, full | {"bearings": []}, settings=settings)
    assert "No bearing was named, or none" in str(none.words)


@pytest.mark.parametrize("factor", [1e290, 0.0, 1e-290])
def test_an_envelope_of_any_size_becomes_a_picture_and_none_becomes_none(factor, full, settings):
    envelope = envelope_map(("X",))
    for name in ("amplitude", "floor"):
        envelope[name] = envelope[name] * factor
    (name, picture), *_ = pictures_of({"envelope_map": envelope}, full, settings=settings, name_of=str).items()
    assert name == "envelope.png" and picture.drawn()[0].startswith(b"\x89PNG")
    assert not pictures_of({"envelope_map": envelope.isel(speed=slice(0))}, full, settings=settings, name_of=str)


def test_names_of_bearings_are_whole_where_there_is_room_and_else_told_apart(full, settings):
    record = next(one for one in full["bearings"] if one["seen_in"] == "envelope")

    def labels(names, lines):
        full["bearings"] = [
            {**record, "name": name, "seen_in": "vibration", "order": None, "order_expected": 2.0 + 3 * k + 0.4 * n}
            for n, name in enumerate(names)
            for k in range(lines)
        ]
        figure = envelope_figure(envelope_map(("Z",), speeds=1), full, settings=settings)
        return [words.text for words in figure.words if words.text.startswith(record["line"])]

    names = ["gearbox, intermediate shaft, drive end", "gearbox, intermediate shaft, fan end"]
    assert [any(name in text for text in labels(names, 1)) for name in names] == [True, True]
    crowded = labels(names, 4)
    assert len(crowded) == 8
    assert len({text.rpartition(" ")[0] for text in crowded}) == 2
