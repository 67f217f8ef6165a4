"""Pictures of the front door: what is drawn is what the data say, every label is legible, and no setting is touched."""

import subprocess
import sys
from itertools import combinations
from types import SimpleNamespace
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import crankorder as co
from crankorder import plot
from crankorder.channel_units import by_channel
from crankorder.errors import RequestError
from crankorder.plot import palette
from crankorder.plot.campbell_figure import pooled
from crankorder.plot.drawing import Field
from crankorder.plot.painter import PaintedPanel
from crankorder.report.netcdf import plain_attrs
from crankorder.report.pictures import pictures_of
from crankorder.settings import load_settings
from made.command import done
from made.typed import findings_of

RATE_HZ = 2048.0
SPEEDS = (900.0, 1000.0, 1100.0, 1200.0, 1900.0)
PICTURES = ("campbell", "order_map", "orders", "spectra")


@pytest.fixture(autouse=True)
def no_window(monkeypatch):
    """Figures of pyplot without a screen, and none left."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


def recorded(speed_rpm, **options):
    """Recording of a block with orders 1, 2 and 4 about a resonance, and of a pressure with order 0.5."""
    time = np.arange(int(4 * RATE_HZ)) / RATE_HZ
    turns = np.cumsum(np.broadcast_to(speed_rpm, time.shape)) / 60.0 / RATE_HZ
    noise = np.random.default_rng(7).standard_normal((2, len(time)))
    block = sum(a * np.cos(2 * np.pi * order * turns) for order, a in ((1.0, 0.5), (2.0, 2.0), (4.0, 0.1)))
    pressure = 0.8 * np.cos(np.pi * turns)
    signals = {"block": block + 0.02 * noise[0], "cylinder": pressure + 0.002 * noise[1]}
    unit = {"block": "mm/s", "cylinder": "bar"}
    return co.recording(signals, rate_hz=RATE_HZ, speed_rpm=speed_rpm, unit=unit, cycle="four-stroke", **options)


def made_of(recordings):
    """Maps and tracks of ``recordings``."""
    return SimpleNamespace(
        campbell=co.campbell_map(recordings, max_frequency_hz=200.0),
        order_map=co.order_map(recordings, max_order=8.0),
        orders=co.order_tracks(recordings, orders=[0.5, 1.0, 2.0, 4.0]),
    )


@pytest.fixture(scope="module")
def steady():
    return made_of([recorded(rpm, name=f"{rpm:.0f}") for rpm in SPEEDS])


@pytest.fixture(scope="module")
def single():
    return made_of(recorded(1470.0))


@pytest.fixture(scope="module")
def swept():
    return made_of(recorded(np.linspace(600.0, 2400.0, int(4 * RATE_HZ))))


FINDINGS = findings_of({
    "schema_version": 1, "orders": [
        {"channel": "block", "order": 1.0001, "order_ci95": [0.9995, 1.0007], "amplitude": 0.5},
        {"channel": "block", "order": 2.0, "order_ci95": [1.999, 2.001], "amplitude": 2.0},
        {"channel": "block", "order": 9.0, "order_ci95": [8.99, 9.01], "amplitude": 0.1},
        {"channel": "cylinder", "order": 0.5, "amplitude": 0.8},
    ],
    "modes": [
        {"frequency_hz": 61.0, "channels": ["block"], "explained_by": "mode"},
        {"frequency_hz": 62.5, "channels": ["block"], "explained_by": "undecided"},
        {"frequency_hz": 150.0, "channels": ["block"], "explained_by": "mains"},
    ],
    "crossings": [
        {"order": 2.0, "mode_hz": 61.0, "rpm": 1830.0, "excited": True, "in_range": True, "channels": ["block"]},
        {"order": 4.0, "mode_hz": 61.0, "rpm": 915.0, "excited": False, "in_range": True, "channels": ["block"]},
    ],
    "speeds_to_avoid": [{"rank": 1, "rpm": 1830.0, "rpm_range": [1800.0, 1860.0], "order": 2.0, "mode_hz": 61.0}],
})  # fmt: skip


KEYS = ("order", "order found (bold: strongest)", "natural frequency", "not decided", "mains", "excited crossing")


def data_of(made, name):
    return getattr(made, "campbell" if name == "spectra" else name)


def new_axes(width_in=9.0, height_in=5.0):
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure.subplots()


def plotted(name, data, axes, findings=FINDINGS):
    """The picture of that name, with findings where it takes them."""
    return getattr(co.plot, name)(data, *([findings] if name in ("campbell", "order_map") else []), ax=axes)


def picture(axes):
    """What lies over ``axes`` when they are drawn."""
    axes.figure.canvas.draw()
    return next(artist for artist in axes.get_children() if isinstance(artist, PaintedPanel)).drawing()


def labels(axes):
    """Labels at the edges of ``axes`` by their text."""
    return {words.text: words for words in picture(axes).words if words.name.startswith("label-")}


def texts_of(axes):
    return {words.text for words in picture(axes).words}


def drawn(axes, name):
    """What lies over ``axes`` by that name."""
    return [part for part in picture(axes).parts if getattr(part, "name", "") == name]


def content(drawing):
    """Looks of all in ``drawing`` that has values, its labels and its keys."""
    parts = [part for part in drawing.parts if getattr(part, "values", None)]
    placed = [(part.name, part.color, part.alpha, part.values) for part in parts]
    said = [words for words in drawing.words if words.name.startswith("label-") or words.text in KEYS]
    return repr([*placed, *((words.text, words.color, words.bold) for words in said)])


def values_of(axes, name):
    """Values of the line or rings of that name, of several the first."""
    return drawn(axes, name)[0].values


def assert_legible(axes):
    """No text meets another, and each is inside the figure."""
    shown, dpi, renderer = picture(axes), axes.figure.dpi, axes.figure.canvas.get_renderer()
    ticks = [
        text
        for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim()))
        for place, text in zip(axis.get_ticklocs(), axis.get_ticklabels(), strict=True)
        if low <= place <= high
    ]
    every = [*ticks, axes.xaxis.label, axes.yaxis.label, axes.title, axes._left_title, axes._right_title]
    boxes = [(text.get_text(), *text.get_window_extent(renderer).extents) for text in every if text.get_text().strip()]
    own = [(words.text, *(dpi * np.array(words.box))) for words in shown.words]
    boxes += [(text, x, y, x + width, y + height) for text, x, y, width, height in own]
    for (one, *box), (two, *other) in combinations(boxes, 2):
        width, height = (min(box[2 + k], other[2 + k]) - max(box[k], other[k]) for k in (0, 1))
        assert width < 1.0 or height < 2.0, f"{one!r} meets {two!r}"
    for text, x, y, width, height in own:
        assert min(x, y, axes.figure.bbox.x1 - x - width, axes.figure.bbox.y1 - y - height) >= -1, text


def loaded_by(code):
    names = ("numpy", "xarray", "matplotlib", "matplotlib.pyplot", "scipy", "pydantic")
    probe = f"import sys; {code}; print(*(n for n in {names!r} if n in sys.modules))"
    result = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    return result.stdout.split()


def test_the_room_is_loaded_when_touched_and_matplotlib_when_drawing():
    assert loaded_by("import crankorder as co; co.plot; dir(co.plot)") == []
    assert "matplotlib" not in loaded_by("import crankorder as co; [getattr(co.plot, n) for n in dir(co.plot)]")
    assert "plot" in dir(co)
    assert dir(plot) == sorted(plot.__all__)
    with pytest.raises(AttributeError, match=r"no attribute 'waterfall'.*campbell"):
        getattr(plot, "waterfall")  # noqa: B009


def test_on_given_axes_pyplot_stays_unloaded(steady, tmp_path):
    plain_attrs(steady.order_map).to_netcdf(tmp_path / "map.nc", engine="h5netcdf")
    loaded = loaded_by(
        "import xarray, crankorder as co; from matplotlib.figure import Figure; ax = Figure().subplots(); "
        f"stored = xarray.load_dataset({str(tmp_path / 'map.nc')!r}, engine='h5netcdf'); "
        "assert co.plot.order_map(stored, ax=ax) is ax; ax.figure.savefig('/dev/null', format='png')"
    )
    assert "matplotlib" in loaded
    assert "matplotlib.pyplot" not in loaded


def test_without_axes_there_is_a_figure_that_a_notebook_shows(steady):
    axes = co.plot.campbell(steady.campbell)
    pyplot = sys.modules["matplotlib.pyplot"]
    assert pyplot.figure(axes.figure.number) is axes.figure


def test_notebooks_draw_what_pages_draw_where_the_axes_have_it(steady):
    maps, settings = {"campbell_map": by_channel(steady.campbell)}, load_settings().report
    page = pictures_of(maps, FINDINGS, settings=settings, name_of=str)["campbell_block.png"].figure()
    axes = co.plot.campbell(steady.campbell, FINDINGS, ax=new_axes())
    assert (axes.get_xlim(), axes.get_ylim()) == (pytest.approx((0.0, 200.0)), pytest.approx((900.0, 1900.0)))
    own = picture(axes)
    assert content(own) == content(page) and all(repr(key) in content(own) for key in KEYS)
    for line in own.strokes("order-"):
        assert line.points * axes.figure.dpi == pytest.approx(axes.transData.transform(np.column_stack(line.values)))


def test_every_picture_of_a_report_is_one_of_a_notebook(steady, tmp_path, recordings_of):
    done("run", recordings_of("hard-two-revolutions"), "--recipe", "waveforms", "--out", tmp_path, "-q")
    tree = co.open(tmp_path / "two-revolutions")
    names = {path.stem.partition("_Z")[0] for path in (tmp_path / "two-revolutions").glob("*.png")}
    assert {name for name in names if not name.endswith(("_X", "_Y"))} <= {*plot.__all__}
    for name, branch in (("cycle", "cycle_average"), ("shapes", "operating_shapes"), ("order_spectra", "order_map")):
        [shown] = getattr(co.plot, name)(tree[branch]).artists
        page = pictures_of(
            {branch: tree[branch].to_dataset()}, findings_of({}), settings=load_settings().report, name_of=str
        )
        assert content(shown.drawing()) == content(page[f"{name}.png"].figure())
        with pytest.raises(RequestError, match="not what this picture shows"):
            getattr(co.plot, name)(steady.campbell)


def test_labels_follow_when_one_zooms(steady):
    axes = co.plot.campbell(steady.campbell, FINDINGS, ax=new_axes())
    axes.set_xlim(0.0, 50.0)
    named = labels(axes)
    assert set(named) == {"1", "2", "1830"}
    assert named["2"].x > axes.bbox.x1 / axes.figure.dpi
    assert_legible(axes)


def test_on_any_scale_a_line_lies_where_the_axes_have_its_values(steady):
    axes = co.plot.spectra(steady.campbell.isel(speed=[0], frequency=slice(1, None)), ax=new_axes())
    axes.set(xscale="log", xlim=(10.0, 200.0))
    (line,) = drawn(axes, "900 rpm")
    assert line.points * axes.figure.dpi == pytest.approx(axes.transData.transform(np.column_stack(line.values)))


def test_order_map_draws_orders_upright_and_modes_as_curves(steady):
    axes = co.plot.order_map(steady.order_map, FINDINGS.as_dict(), ax=new_axes())
    assert values_of(axes, "order-2")[0] == pytest.approx([2.0, 2.0])
    assert np.prod(values_of(axes, "mode"), axis=0) == pytest.approx(60.0 * 61.0)
    assert np.column_stack(values_of(axes, "crossings")).tolist() == [[2.0, 1830.0]]
    assert {"1", "2", "61 Hz"} <= set(labels(axes)) and "9" not in labels(axes)


@pytest.mark.cases(1)
@pytest.mark.parametrize(
    "channel, label", [("block", "Velocity (peak), dB re 1 mm/s"), ("cylinder", "Pressure (peak), dB re 1 bar")]
)
def test_every_channel_has_its_unit(channel, label, steady):
    for name in PICTURES:
        axes = getattr(co.plot, name)(data_of(steady, name), ax=new_axes(), channel=channel)
        if name in ("campbell", "order_map"):
            assert label in texts_of(axes) and axes.get_title(loc="left") == channel
        else:
            assert axes.get_ylabel() == label.replace("dB re 1 ", "")


def ends_of_bar(axes):
    """Levels that are written beside the colour bar."""
    return [float(words.text.replace("−", "-")) for words in picture(axes).words if words.name == "tick"]


def test_the_strongest_line_has_the_brightest_colour_and_gaps_are_blank(steady):
    axes = co.plot.campbell(steady.campbell, ax=new_axes())
    level = 5 * np.ceil(20 * np.log10(steady.campbell["amplitude_velocity"][0].max()) / 5)
    assert ends_of_bar(axes)[-1] == 10 * np.floor(level / 10)
    pixels = np.asarray(axes.figure.canvas.buffer_rgba())[::-1]
    gap, strongest, beside = (
        pixels[int(y), int(x)] for x, y in axes.transData.transform([(120.0, 1300.0), (40.0, 1220.0), (120.0, 1100.0)])
    )
    assert to_hex(gap / 255) == palette.NOT_MEASURED
    assert strongest.sum() > 2 * beside.sum()
    levels = ends_of_bar(co.plot.campbell(steady.campbell, ax=new_axes(), dynamic_range_db=10.0))
    assert levels[-1] - levels[0] <= 10.0


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(6))
def test_labels_never_overlap(seed, steady):
    rng = np.random.default_rng(seed)
    orders = np.sort(rng.uniform(0.5, 12.0, rng.integers(1, 20)))
    modes = np.sort(rng.uniform(5.0, 195.0, rng.integers(1, 14)))
    findings = findings_of({
        "orders": [{"channel": "block", "order": float(one), "amplitude": float(rng.random())} for one in orders],
        "modes": [{"frequency_hz": float(one), "explained_by": rng.choice(["mode", "undecided"])} for one in modes],
    })  # fmt: skip
    size = rng.uniform(6.0, 11.0), rng.uniform(3.5, 6.0)
    for name in PICTURES:
        assert_legible(plotted(name, data_of(steady, name), new_axes(*size), findings))


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", PICTURES)
def test_one_speed_and_a_sweep_are_legible_and_settings_of_matplotlib_stay_as_they_are(name, single, swept):
    before = dict(matplotlib.rcParams)
    for made in (single, swept):
        assert_legible(plotted(name, data_of(made, name), new_axes(9.0, 4.0)))
    assert dict(matplotlib.rcParams) == before


def test_one_speed_is_a_strip_with_its_speed(single):
    axes = co.plot.campbell(single.campbell, FINDINGS, ax=new_axes())
    assert [text.get_text() for text in axes.get_yticklabels()] == ["1470"]
    assert values_of(axes, "order-2")[0] == pytest.approx([49.0, 49.0])
    axes = co.plot.orders(single.orders, ax=new_axes())
    assert axes.get_xlabel().startswith("Order")
    tracks = single.orders.sel(channel="block").squeeze("speed")
    for stroke in drawn(axes, "interval"):
        at = tracks.sel(order=stroke.values[0][0])
        ends = [float(at[f"amplitude_{end}_velocity"]) for end in ("low", "high")]
        assert stroke.values[1] == pytest.approx(ends)
    assert set(labels(axes)) == {"1", "2", "4"}


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", PICTURES)
def test_unknown_speeds_have_no_place(name, steady, single):
    some, none = data_of(steady, name), data_of(single, name)
    known = np.where(some["speed"] == 1100.0, np.nan, some["speed"])
    axes = plotted(name, some.assign_coords(speed=("speed", known, {"units": "min-1"})), new_axes())
    assert_legible(axes)
    assert name in ("orders", "spectra") or axes.get_title(loc="right") == "1 of unknown speed not shown"
    axes = plotted(name, none.assign_coords(speed=("speed", [np.nan], {"units": "min-1"})), new_axes())
    assert_legible(axes)
    assert name in ("orders", "spectra") or axes.get_ylabel() == "Speed not known"


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", PICTURES)
def test_nothing_measured_and_silence_are_said(name, steady):
    data = data_of(steady, name)
    empty, silent = data.isel(speed=slice(0, 0)), data.copy()
    for variable in [name for name in data if str(name).startswith("amplitude")]:
        silent[variable] = data[variable].copy(data=np.zeros(data[variable].shape))
    for given in (empty, silent):
        axes = getattr(co.plot, name)(given, ax=new_axes())
        assert any(text.startswith(("nothing", "no signal", "no order")) for text in texts_of(axes))


def test_orders_are_drawn_with_their_intervals_to_their_ends(steady):
    axes = co.plot.orders(steady.orders, orders=[1.0, 2.0], ax=new_axes())
    x, y = values_of(axes, "order-2")
    known = np.isfinite(y)
    assert x[known] == pytest.approx(SPEEDS)
    assert y[known] == pytest.approx(steady.orders["amplitude_velocity"].sel(channel="block", order=2.0).values)
    assert not known.all() and len(drawn(axes, "band")) == 2  # the line breaks where nothing was measured
    assert axes.get_title(loc="right") == "with 95 % intervals"
    named = labels(axes)
    for text in ("1", "2"):
        x, y = values_of(axes, f"order-{text}")
        height = axes.transData.transform((x[-1], y[-1]))[1] / axes.figure.dpi
        assert named[text].y == pytest.approx(height, abs=0.02)
        assert named[text].x > axes.bbox.x1 / axes.figure.dpi


def test_spectra_are_told_apart_by_speed_up_to_six(steady, swept):
    axes = co.plot.spectra(steady.campbell, ax=new_axes())
    assert [words.text for words in picture(axes).words] == [f"{speed:.0f} rpm" for speed in SPEEDS]
    axes = co.plot.spectra(swept.campbell, ax=new_axes())
    assert texts_of(axes) == {"largest", "median"}
    assert values_of(axes, "largest")[1] == pytest.approx(swept.campbell["amplitude_velocity"][0].max("speed").values)


def test_the_envelope_names_the_order_of_strikes():
    rng, ring = np.random.default_rng(1), np.exp(-np.arange(60) / 15) * np.cos(1.9 * np.arange(60))
    bearings = [{"name": "drive end", "bpfo": 3.58, "bpfi": 5.42}]
    noise = rng.standard_normal(80_000)
    named = []
    for strikes in (1.0, 0.0):
        signal = strikes * np.convolve(np.arange(80_000) % 112 == 0, ring, "same") + 0.1 * noise
        made = co.envelope(co.recording(signal, rate_hz=10_000, speed_rpm=1500.0), bearings=bearings)
        axes = co.plot.envelope(made, ax=new_axes(), speed_rpm=1480.0)
        assert_legible(axes)
        named.append([float(text) for text in labels(axes)])
    assert named[0][0] == pytest.approx(3.571, abs=0.02) and len(named[0]) > 2 and named[1] == []
    none = made.isel(speed=slice(0, 0))
    assert texts_of(co.plot.envelope(none, ax=new_axes())) == {"no signal"}


@pytest.mark.parametrize("per_rev", [1, 60])
def test_speed_against_time(per_rev):
    turned = np.arange(0.0, 285.0, 1.0 / per_rev)
    pulses = -5.0 + np.sqrt(25.0 + turned / 1.5)  # the speed grows from 15 to 45 revolutions per second
    made = co.recording(np.zeros(10_000), rate_hz=1000.0, pulse_times_s=pulses, pulses_per_rev=per_rev)
    shaft = co.crank_angle(made)
    axes = co.plot.speed(shaft, ax=new_axes(9.0, 3.0))
    assert_legible(axes)
    assert axes.get_ylim()[0] == 0.0
    _, speed = values_of(axes, "speed")
    assert len(speed) <= 1600 and np.nanmax(speed) == pytest.approx(float(np.nanmax(shaft["speed"])), rel=0.02)


WRONG: dict[str, Any] = {
    "another dataset": (lambda made: co.plot.campbell(made.orders), "found OrderTracks; allowed: a CampbellMap"),
    "a table": (lambda made: co.plot.orders([1.0, 2.0]), "found list; allowed: OrderTracks"),
    "one value picked": (lambda made: co.plot.campbell(made.campbell.isel(speed=0)), "wrong dims"),
    "no channel": (lambda made: co.plot.spectra(made.campbell, channel="Z"), "found Z; allowed: block, cylinder"),
    "no order": (lambda made: co.plot.orders(made.orders, orders=[7.0]), r"found 7.0; allowed: 0.5, 1, 2, 4"),
    "findings": (lambda made: co.plot.campbell(made.campbell, made.orders), "as crankorder.diagnose returns it"),
    "part of findings": (lambda made: co.plot.campbell(made.campbell, {"orders": []}), "no findings: is missing"),
    "axes": (lambda made: co.plot.campbell(made.campbell, ax=Figure()), "not axes; found Figure"),
    "depth": (lambda made: co.plot.campbell(made.campbell, dynamic_range_db=-3.0), "a number > 0"),
    "speed": (lambda made: co.plot.speed(made.order_map), "found an OrderMap; allowed: a ShaftAngle"),
}  # fmt: skip


def test_a_wrong_request_is_told_with_what_is_there_and_allowed(steady):
    for call, said in WRONG.values():
        with pytest.raises(RequestError, match=said):
            call(steady)


def test_a_branch_of_the_results_is_drawn_as_it_is():
    tree = co.run(recorded(1200.0), recipe="maps")
    assert any(isinstance(part, Field) for part in picture(co.plot.order_map(tree["order_map"], ax=new_axes())).parts)


def test_no_thin_line_is_lost_however_few_the_pixels():
    rng = np.random.default_rng(3)
    for n, width in ((5000, 300), (7, 300), (300, 300)):
        values, edges = np.zeros((1, n)), np.linspace(0.0, 10.0, n + 1)
        place = int(rng.integers(n))
        values[0, place] = 1.0
        pixels = np.linspace(-1.0, 12.0, width + 1)
        shown = pooled(values, edges, pixels, axis=1)[0]
        hit = (pixels[:-1] < edges[place + 1] - 1e-12) & (pixels[1:] > edges[place] + 1e-12)
        assert np.any(shown == 1.0) and not np.any((shown == 1.0) & ~hit)  # seen, and nowhere that it is not
        assert np.all((shown == 1.0) | ~hit | (np.cumsum(hit) == hit.sum()) | (np.cumsum(hit) == 1))  # but for its ends
        assert np.all(np.isneginf(shown[(pixels[1:] <= 0.0) | (pixels[:-1] >= 10.0)]))
        np.testing.assert_array_equal(pooled(values, edges, pixels[::-1], axis=1)[0], shown[::-1])


def test_a_whirl_moves_with_the_speed_and_a_tone_of_the_lines_is_shown(steady):
    findings = findings_of({
        "modes": [{"frequency_hz": 50.0, "explained_by": "whirl", "speed_slope": 0.5, "reference_rpm": 600.0}],
        "lines": [{"frequency_hz": hertz, "explained_by": "unexplained"} for hertz in (120.0, 130.0)],
    })  # fmt: skip
    axes = co.plot.campbell(steady.campbell, findings, ax=new_axes())
    x, y = values_of(axes, "whirl")
    assert x == pytest.approx(50.0 + 0.5 * (y - 600.0) / 60.0)
    assert [stroke.values[0][0] for stroke in drawn(axes, "tone")] == [120.0, 130.0]
