"""The report page in a real browser: it hovers, zooms, listens to keys, and fetches nothing."""

from itertools import combinations, product

import numpy as np
import pytest

from crankorder.report.page import ShownPicture, report_page
from made import chromium
from made.typed import from_dicts
from report.conftest import drawn_test

report_page = from_dicts(report_page)

pytestmark = pytest.mark.skipif(chromium.PROGRAM is None, reason="no Chromium here: apt-get install chromium")

_PNG = bytes.fromhex(  # one white pixel
    "89504e470d0a1a0a0000000d49484452000000010000000108000000003a7e9b550000000a49444154789c63f80f000101010018"
    "dd8db00000000049454e44ae426082"
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium.Chromium(tmp_path_factory.mktemp("profile")) as made:
        yield made


def _page(drawn, settings, path):
    groups = {"campbell_map": drawn.campbell, "order_map": drawn.order_map, "order_tracks": drawn.tracks}
    pictures = [ShownPicture("campbell_Z.png", "Campbell diagram, Z", _PNG), ShownPicture("speed.png", "Speed", _PNG)]
    findings = drawn.findings
    text = report_page(findings, pictures=pictures, provenance={}, settings=settings, groups=groups)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def opened(browser, campaign, settings, tmp_path):
    browser.complaints.clear()
    browser.fetched.clear()
    browser.open(_page(campaign, settings, tmp_path / "report.html"))
    browser.value("document.getElementById('live-map').scrollIntoView({block: 'start'})")
    browser.settle()
    return browser


def _choose(browser, what, value):
    element = f"document.getElementById('{what}')"
    browser.value(f"{element}.value = '{value}'; {element}.dispatchEvent(new Event('change')); 1")
    browser.settle()


def _view(browser):
    return browser.value("axes.flatMap((axis) => axis.range)")


def _said(browser):
    return str(browser.value("document.getElementById('live-said').textContent"))


def _box(browser):
    return browser.value(
        "(() => { const b = document.getElementById('live-map').getBoundingClientRect();"
        " return [b.left, b.top, b.width, b.height] })()"
    )


def _place(browser, x, y):
    """Pixel of the window at which the diagram has ``x`` and ``y``, by its margins of 66, 70, 28 and 40 pixels."""
    box = _box(browser)
    x0, x1, y0, y1 = _view(browser)
    across, up = (x - x0) / (x1 - x0), (y - y0) / (y1 - y0)
    return box[0] + 66 + across * (box[2] - 136), box[1] + box[3] - 40 - up * (box[3] - 68)


def test_a_page_opens_from_disk_complains_of_nothing_and_fetches_nothing(opened):
    assert opened.value("document.getElementById('live').hidden") is False
    assert opened.complaints == []
    assert [one[:5] for one in opened.fetched if not one.startswith("data:")] == ["file:"]


def test_pointing_at_a_cell_tells_where_it_is_how_large_and_what_the_findings_say(opened, campaign):
    _choose(opened, "live-channel", "2")
    opened.mouse("mouseMoved", *_place(opened, 60.0, 1800.0))
    said = _said(opened)
    there = campaign.campbell.amplitude.sel(channel="Z", speed=1800.0).sel(frequency=60.0, method="nearest")
    assert said.startswith("1800 rpm · 60 Hz · order 2 · ")
    assert float(said.split(" · ")[3].split()[0]) == pytest.approx(float(there), rel=5e-3)
    assert "Order 2: engine order, seen at " in said
    assert "Natural frequency 60.0 (59.7…60.3) Hz, damping 1.2 %, in X, Y, Z." in said
    assert "Crossing: order 2 meets 60 Hz near 1800 rpm, excited." in said
    opened.mouse("mouseMoved", *_place(opened, 400.0, 500.0))
    assert "No line is named here." in _said(opened)


def test_wheel_drag_and_keys_zoom_and_double_click_shows_all(opened):
    def click(x, y, count=1, to=None):
        opened.mouse("mousePressed", x, y, button="left", clickCount=count)
        if to is not None:
            opened.mouse("mouseMoved", *to, button="left", buttons=1)
        opened.mouse("mouseReleased", *(to or (x, y)), button="left", clickCount=count)

    whole, at = _view(opened), _place(opened, 115.0, 1500.0)
    opened.mouse("mouseWheel", *at, deltaX=0, deltaY=-240)
    near = _view(opened)
    assert near[1] - near[0] < 0.6 * (whole[1] - whole[0]) and near[0] < 115.0 < near[1]
    assert opened.value("window.scrollY") > 0
    click(*at)
    click(*at, count=2)
    assert _view(opened) == whole
    click(*_place(opened, 100.0, 900.0), to=_place(opened, 300.0, 1900.0))
    np.testing.assert_allclose(_view(opened), [100, 300, 900, 1900], rtol=0.02)
    opened.value("document.getElementById('live-map').focus()")
    opened.key("0")
    assert _view(opened) == whole
    opened.key("+")
    assert _view(opened)[1] - _view(opened)[0] < 0.8 * (whole[1] - whole[0])
    opened.key("-")
    opened.key("-")
    assert _view(opened) == whole


def test_arrow_keys_go_from_cell_to_cell_and_are_read_aloud(opened):
    opened.value("document.getElementById('live-map').focus()")
    opened.key("ArrowRight")
    first = _said(opened)
    opened.key("ArrowRight")
    opened.key("ArrowUp")
    second = _said(opened)
    (rpm, hertz), (next_rpm, next_hertz) = (
        [float(part.split()[0]) for part in text.split(" · ")[:2]] for text in (first, second)
    )
    assert (next_rpm - rpm, next_hertz - hertz) == (50, pytest.approx(0.5))
    assert opened.value("document.getElementById('live-said').ariaLive") == "polite"


def test_names_that_want_to_be_markup_or_formulas_are_text(browser, settings, tmp_path):
    browser.complaints.clear()
    names = ("Ba$$in <script>alert(1)</script>", "加速度計 前", '"><img src=x onerror=alert(1)>')
    drawn = drawn_test(np.arange(300.0, 2001.0, 50.0), channels=names, name="<b>x</b>" + "y" * 10_000)
    browser.open(_page(drawn, settings, tmp_path / "hostile.html"))
    shown = browser.value("[...document.getElementById('live-channel').options].map((one) => one.textContent)")
    assert shown == list(names)
    assert browser.value("document.querySelectorAll('img[src=x], h1 b').length") == 0
    assert browser.value("document.querySelectorAll('script:not([type])').length") == 1
    assert browser.complaints == []


_LISTEN = """(() => {
  window.written = [];
  const kind = CanvasRenderingContext2D.prototype, plain = kind.fillText;
  kind.fillText = function (text, x, y) {
    const m = this.measureText(text), t = this.getTransform(), s = window.devicePixelRatio || 1;
    const low = [x - m.actualBoundingBoxLeft, y - m.actualBoundingBoxAscent];
    const high = [x + m.actualBoundingBoxRight, y + m.actualBoundingBoxDescent];
    const [p, q] = [low, high].map(([a, b]) => [(t.a * a + t.c * b + t.e) / s, (t.b * a + t.d * b + t.f) / s]);
    const [left, right] = [Math.min(p[0], q[0]), Math.max(p[0], q[0])];
    const [top, bottom] = [Math.min(p[1], q[1]), Math.max(p[1], q[1])];
    const c = this.canvas;
    window.written.push([c.id, String(text), left, top, right, bottom, c.clientWidth, c.clientHeight]);
    return plain.call(this, text, x, y);
  };
  return 1;
})()"""
"""Keeps every text that a canvas is given: canvas, text, its box in pixels, size of the canvas."""


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])
def test_no_text_of_the_live_diagrams_is_cut_and_none_lies_on_another(opened, width):
    opened.ask("Emulation.setDeviceMetricsOverride", width=width, height=1400, deviceScaleFactor=1, mobile=width < 500)
    opened.settle()
    opened.value(_LISTEN)
    try:
        for view, scale in product("10", ("linear", "db")):
            _choose(opened, "live-scale", scale)
            _choose(opened, "live-view", view)
            left, top, width_px, height_px = _box(opened)
            opened.value("window.written = []; 1")
            opened.mouse("mouseMoved", left + width_px / 2, top + height_px / 2 + "10".index(view))
            written = opened.value("window.written")
            assert {one[0] for one in written} == {"live-map", "live-cuts"} and opened.complaints == []
            cut = [one[1] for one in written if min(one[2:4]) < -1 or one[4] > one[6] + 1 or one[5] > one[7] + 1]
            assert not cut, (view, scale, cut)
            on_it = [
                (one[1], other[1])
                for one, other in combinations(written, 2)
                if one[0] == other[0] and all(one[2 + k] < other[4 + k] and other[2 + k] < one[4 + k] for k in (0, 1))
            ]
            assert not on_it, (view, scale, on_it)
    finally:
        opened.ask("Emulation.clearDeviceMetricsOverride")


def test_a_long_table_shows_the_rows_that_hold_every_word_typed(browser, drawn_of, settings, tmp_path):
    browser.open(_page(drawn_of("sixty orders"), settings, tmp_path / "long.html"))
    typed = "const field = document.querySelector('#orders input'); field.value = '%s'; field.oninput(); 1"
    browser.value("{" + typed % "x 12.0" + "}")
    rows = (
        "[...document.querySelectorAll('#orders tbody tr')].filter((row) => !row.hidden).map((row) => row.textContent)"
    )
    shown = browser.value(rows)
    assert shown and all("x" in text.lower() and "12.0" in text for text in shown)
    assert browser.value("document.querySelector('#orders output').value") == f"{len(shown)} of 180 rows"
    browser.value("{" + typed % "" + "}")
    assert len(browser.value(rows)) == 180
