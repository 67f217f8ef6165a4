"""The page says what shakes first, escapes everything, refers to nothing outside and is whole without its script."""

import base64
import hashlib
import html
import json
import re
from html.parser import HTMLParser
from importlib.resources import files
from typing import Any

import numpy as np
import pytest

from crankorder.quantities import schema_of
from crankorder.report.page import ShownPicture, index_page, report_page
from crankorder.report.sentences.story import headline, story_of
from crankorder.report.tables import tables_of
from made.typed import from_dicts
from report.conftest import drawn_test

report_page, headline, story_of, tables_of = map(from_dicts, (report_page, headline, story_of, tables_of))

PNG = b"\x89PNG picture"
NOTHING: dict[str, Any] = {"test": "t", "orders": [], "modes": [], "crossings": [], "bearings": [], "lines": []}
HOSTILE = (
    "</script><script>alert(1)</script>", '" onload="alert(1)', "javascript:alert(1)", "{{ 7*7 }}", "a\x00\x1b[2J",
)  # fmt: skip


class _Reader(HTMLParser):
    """Tags, attributes, links and text of a page; complains about tags that do not close."""

    void = frozenset({"meta", "img", "br", "link", "input"})

    def __init__(self, page):
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.words: list[str] = []
        self.open: list[str] = []
        self.feed(page)
        assert self.open == [], "tags left open"

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in self.void:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture
def page(campaign, settings):
    provenance = {"schema_version": 1, "inputs": [{"name": "rpm_0300.h5", "sha256": "ab" * 32}]}
    provenance |= {"versions": {"crankorder": "0.1.0", "numpy": "2.4.6"}, "settings": {"report": {"dpi": 130}}}
    pictures = [ShownPicture(f"{name}.png", name, PNG) for name in ("campbell_Z", "orders")]
    return report_page(campaign.findings, pictures=pictures, provenance=provenance, settings=settings)


def test_the_page_says_what_shakes_why_how_sure_and_what_to_do_before_any_picture(page, campaign):
    text = " ".join(_Reader(page).words)
    sentences = (headline(campaign.findings)[0], "What shakes", "Why", "How sure", "What to do")
    places = [text.index(sentence) for sentence in sentences]
    assert places == sorted(places)
    assert page.index("What to do") < page.index("<img")
    for sentences in story_of(campaign.findings).values():
        assert all(sentence in text for sentence in sentences)


def test_every_order_mode_and_bearing_is_in_a_table_with_its_interval(page, campaign):
    text = " ".join(_Reader(page).words)
    wanted = "5.500 (5.497…5.503)", "172.0 (171.7…172.3)", "1.2 (0.9…1.5)", "116 (110…122) g", "encoder_missing_pulse"
    assert [word for word in wanted if word not in text] == []
    # seven lists and the tones, the crossings outside the tested speeds, versions and the folded provenance
    assert page.count("<table>") == 11
    assert "ab" * 32 in text


def test_everything_that_identification_finds_is_in_a_table(full, settings):
    reader = _Reader(report_page(full, pictures=[], provenance={}, settings=settings))
    text = " ".join(" ".join(reader.words).split())
    for word in (
        "Speeds to avoid", "1755–1850", "300–1690", "undecided: 420 revolutions needed, half order", "keeps its size",
        "no order was seen to excite it", "Perhaps natural frequencies: not decided",
        "order 10 lies on it at every speed", "Tones and mains: no natural frequencies", "58.300 (58.290…58.310)",
        "5.00 (4.90…5.10) m/s²", "× 12 (10…14)", "× 42", "envelope, 2000–4000 Hz", "−0.80 (−0.90…−0.70)",
        "116 (110…122) g", "not decided: the horizontal path is not stated", "Where the energy is", "70 %",
    ):  # fmt: skip
        assert word in text, word
    assert {"svg", "rect", "details"} <= set(reader.tags)
    assert "No bearing was named" not in text


RECORDS = ("orders", "modes", "crossings", "speeds_to_avoid", "free_bands", "open_bands", "bearings", "lines")
NUMBERS = ("energy", "balance", "unexplained_energy_fraction")


@pytest.mark.cases(2)
@pytest.mark.parametrize("key", [*RECORDS, *NUMBERS])
def test_what_may_be_absent_or_unknown_breaks_neither_page_nor_headline(key, full, settings):
    given = [{**full, key: [] if key in ("orders", "modes", "crossings", "bearings", "lines") else None}]
    if key in RECORDS:
        needed = set(schema_of("findings")["properties"][key]["items"]["required"])
        names = sorted({name for record in full[key] for name in record} - needed)
        # all at once; then another one in each record, until each was absent
        gone = [[names] * len(full[key])]
        for first in range(0, len(names), len(full[key])):
            gone.append([[names[(first + number) % len(names)]] for number in range(len(full[key]))])
        needs = {"order", "frequency_hz"} if key == "lines" else set()
        for absent in gone:
            pairs = list(zip(full[key], absent, strict=True))
            known = [{name: value for name, value in record.items() if name not in own} for record, own in pairs]
            given += [
                {**full, key: known},
                {**full, key: [one | dict.fromkeys(set(own) - needs) for one, own in pairs]},
            ]
    else:
        given.append({name: value for name, value in full.items() if name != key})
    for findings in given:
        assert headline(findings)
        page = report_page(findings, pictures=[], provenance={}, settings=settings)
        assert "None" not in " ".join(_Reader(page).words)


def test_free_and_open_bands_stand_in_one_table_by_speed_each_with_its_reason(full):
    (avoid,) = (one for anchor, one in tables_of(full, limit=60) if anchor == "avoid")
    beside = avoid.beside
    verdicts = [(row[0], row[2]) for row in beside.rows]
    assert verdicts == [("300–1690", "free"), ("1690–1850", "not free, or not known"), ("1850–2000", "free")]
    assert [row[1] for row in beside.rows] == ["1390", "160", "150"]
    assert "more than 3 times (99 %)" in beside.rows[0][3]
    assert "order 2 with 60 Hz: is amplified" in beside.rows[1][3]


def test_the_bars_of_the_energy_are_the_shares_and_never_longer_than_the_whole(full, settings):
    full["energy"]["channels"][0] |= {"orders": 0.9, "tones": 0.9, "modes_and_floor": 0.0, "unexplained": 0.2}
    made = report_page(full, pictures=[], provenance={}, settings=settings)
    bars = re.findall(r"<svg.*?</svg>", made)
    widths = [[float(width) for width in re.findall(r' width="([\d.]+)"', bar)] for bar in bars]
    assert widths[0] == [45.0, 45.0, 10.0]
    assert widths[1] == [22.0, 5.0, 70.0, 3.0]


def test_sixty_orders_in_three_channels_all_stand_in_a_long_table_the_strongest_first(drawn_of, settings):
    findings = drawn_of("sixty orders").findings
    made = report_page(findings, pictures=[], provenance={}, settings=settings)
    part = made[made.index('<div id="orders">') : made.index('<div id="modes">')]
    assert part.count("<tr><td") == len(findings["orders"]) == 180
    assert '<div class="scroll long"' in part and "30 of 180 rows; all are in findings.json." in part
    sizes = [float(row) for row in re.findall(r'<td class="n">([\d.]+) \([^<]*m/s²</td>', part)]
    assert len(sizes) == 180 and sizes == sorted(sizes, reverse=True)


def test_the_page_holds_its_pictures_and_without_maps_its_script_filters_long_tables_alone(page):
    reader = _Reader(page)
    assert not {"link", "iframe", "object", "base", "form"} & set(reader.tags)
    assert reader.tags.count("script") == ('class="scroll long"' in page) and 'id="live' not in page
    links = {value for name, value in reader.attributes if name in ("href", "src") and not str(value).startswith("#")}
    held = "data:image/png;base64," + base64.b64encode(PNG).decode()
    assert links == {"./campbell_Z.png", "./orders.png", held}
    assert not re.search(r"https?:|//[a-z]", page)
    assert not [name for name, _ in reader.attributes if name.startswith("on") or name == "style"]


def _policy(page, kind):
    """Rules of the page's policy and the hash of its one element of that kind."""
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', page)
    (held,) = re.findall(rf"<{kind}>(.*?)</{kind}>", page, re.DOTALL)
    assert "unsafe" not in policy
    return html.unescape(policy), base64.b64encode(hashlib.sha256(held.encode()).digest()).decode()


def test_the_policy_allows_only_pictures_and_the_one_style_by_its_hash(settings):
    rules, digest = _policy(report_page(NOTHING, pictures=[], provenance={}, settings=settings), "style")
    assert "default-src 'none'" in rules and f"'sha256-{digest}'" in rules
    assert "script-src" not in rules


def test_the_script_stays_small_enough_to_read():
    script = files("crankorder.report").joinpath("page.js").read_bytes()
    assert len(script) <= 15_000 and max(map(len, script.decode().splitlines())) <= 160


def _groups(drawn):
    return {"campbell_map": drawn.campbell, "order_map": drawn.order_map, "order_tracks": drawn.tracks}


def _live(page):
    (found,) = re.findall(r'<script type="application/json" id="live-data">(.*?)</script>', page, re.DOTALL)
    return json.loads(found)


def _amplitudes(shown, channel, speeds):
    """The map of a channel that the script draws."""
    code = np.frombuffer(base64.b64decode(shown["cells"][channel]), "<u2").reshape(speeds, -1).astype(float)
    return shown["largest"][channel] * 10 ** ((code - 60000) * 0.005 / 20)


def test_the_script_is_allowed_by_its_hash_and_draws_the_map_and_without_it_pictures_stand_there(campaign, settings):
    made = report_page(campaign.findings, pictures=[], provenance={}, settings=settings, groups=_groups(campaign))
    rules, digest = _policy(made, "script")
    assert f"script-src 'sha256-{digest}';" in rules and "file:" not in rules
    assert '<section id="live" hidden' in made and '<details id="stills" open>' in made  # the script turns both
    live = _live(made)
    campbell = live["maps"][0]
    for number, channel in enumerate(campaign.campbell.channel.values):
        wanted = campaign.campbell.amplitude.sel(channel=channel)
        np.testing.assert_allclose(_amplitudes(campbell, number, 35), wanted, rtol=3e-4)
    assert [row[0] for row in campbell["rows"]] == campaign.campbell.speed.values.tolist()
    assert {one["slope"] for one in live["orders"]} == set(campaign.tracks.order.values)
    assert any(one["text"].startswith("Order 5.5: bearing jack shaft N*fs, seen at ") for one in live["orders"])


def test_a_page_stays_under_five_megabytes_whatever_its_test_holds(settings):
    drawn = drawn_test(np.linspace(300.0, 6000.0, 120), channels=tuple(f"acc {k}" for k in range(24)))
    pictures = [ShownPicture(f"campbell_{k}.png", "x", bytes(300_000)) for k in range(24)]
    made = report_page(drawn.findings, pictures=pictures, provenance={}, settings=settings, groups=_groups(drawn))
    assert len(made.encode()) < 5_000_000
    assert made.count("data:image/png") == 6
    assert "campbell_23.png</a> beside this page" in made
    campbell = _live(made)["maps"][0]
    pool, columns = campbell["pooled"], campbell["nx"]
    assert pool > 1
    whole = drawn.campbell.amplitude.values[0]
    padded = np.pad(whole, ((0, 0), (0, columns * pool - whole.shape[1]))).reshape(120, columns, pool).max(axis=2)
    np.testing.assert_allclose(_amplitudes(campbell, 0, 120), padded, rtol=3e-4)


def test_quality_has_one_row_per_kind_with_its_count_and_first_case(campaign):
    quality = [
        {"recording": f"{k}.h5", "flag": "lost", "severity": "suspect", "detail": f"{k} of 9 are lost"} for k in (1, 2)
    ]
    quality += [{"recording": "5.h5", "flag": "short", "severity": "bad", "detail": "only 2 revolutions"}]
    table = dict(tables_of({**campaign.findings, "quality": quality}, limit=60))["quality"]
    assert table.rows == [
        ["bad", "short", "1", "1", "5.h5: only 2 revolutions"], ["suspect", "lost", "2", "2", "1.h5: 1 of 9 are lost"],
    ]  # fmt: skip
    assert table.more is not None and len(table.more.rows) == 3


@pytest.mark.parametrize("text", HOSTILE)
def test_text_from_files_is_text_wherever_it_stands(text, full, settings):
    def poisoned(value):
        if isinstance(value, dict):
            return {key: poisoned(item) for key, item in value.items()}
        if isinstance(value, list):
            return [poisoned(item) for item in value]
        return text if isinstance(value, str) else value

    findings = poisoned(full)
    shown = [ShownPicture(text, text, PNG)]
    made = report_page(findings, pictures=shown, provenance={text: {text: [text]}}, settings=settings)
    reader = _Reader(made)
    assert reader.tags.count("script") == ('class="scroll long"' in made)
    assert not [name for name, _ in reader.attributes if name.startswith("on")]
    links = [value or "" for name, value in reader.attributes if name in ("href", "src")]
    assert all(link.startswith(("#", "./", "data:image/png;base64,")) for link in links)
    if "7*7" in text:
        assert text in "".join(reader.words)
    assert not {"\x1b", "\x00"} & set(made)
    test = dict.fromkeys(("name", "status", "link"), text) | {"failed": [{"recording": text, "error": text}]}
    assert "script" not in _Reader(index_page([test | {"headline": [text]}])).tags


def test_a_link_cannot_leave_the_folder_of_the_page(campaign, settings):
    for name in ("../../etc/passwd", "//evil.example/x", "file:///etc/passwd", "a?b#c d.png", "\udcff.png"):
        made = report_page(campaign.findings, pictures=[ShownPicture(name, "x", PNG)], provenance={}, settings=settings)
        links = {value or "" for key, value in _Reader(made).attributes if key == "href"}
        (link,) = (value for value in links if not value.startswith("#"))
        assert re.fullmatch(r"\./[\w.~%/-]+", link) and ".." not in link.split("/"), link


def test_a_name_of_ten_thousand_characters_is_cut(campaign, settings):
    made = report_page({**campaign.findings, "test": "x" * 10_000}, pictures=[], provenance={}, settings=settings)
    assert "x" * 59 + "…" in made
    assert "x" * 61 not in made


def test_a_test_with_nothing_found_has_a_page_that_says_so(settings):
    nothing = NOTHING | {"quality": [], "balance": None, "balance_reason": "the transfer path is not known"}
    text = " ".join(_Reader(report_page(nothing, pictures=[], provenance={}, settings=settings)).words)
    for word in ("No order stands above the noise", "No natural frequency was found", "the transfer path is not known"):
        assert word in text


def test_findings_that_were_not_asked_for_are_neither_denied_nor_cleared(settings):
    clipped = {"recording": "a.h5", "flag": "clipped", "severity": "bad", "detail": "x"}
    unsought = NOTHING | {"not_asked_for": "not asked for: the recipe wants campbell map only"}
    unsought |= {"balance": None, "quality": [clipped]}
    text = " ".join(_Reader(report_page(unsought, pictures=[], provenance={}, settings=settings)).words)
    assert "Findings were not asked for: the recipe wants campbell map only." in text
    for falsehood in ("No order", "No natural", "No line", "Nothing that was looked for", "No bearing", "What shakes"):
        assert falsehood not in text
    assert "Repeat the recordings that are marked bad." in text and "a.h5" in text


def test_the_index_lists_every_test_its_headline_and_the_recordings_that_failed():
    first = {"name": "first", "status": "done", "headline": ["Order 2 is the strongest."], "link": "first/report.html"}
    second = {"name": "second", "status": "failed", "failed": [{"recording": "a.h5", "error": "truncated"}]}
    reader = _Reader(index_page([first, second]))
    text = " ".join(reader.words)
    for word in ("2 tests", "first", "Order 2 is the strongest.", "second", "1 recording failed", "a.h5", "truncated"):
        assert word in text
    assert ("href", "./first/report.html") in reader.attributes
    assert "No test was analysed" in index_page([])


@pytest.mark.parametrize("n_tests", [1, 300])
def test_the_index_has_trouble_first_and_every_test_once(n_tests):
    rng = np.random.default_rng(n_tests)
    kinds = [
        ("failed", {}),
        ("partial", {}),
        ("done", {"Failing bearing": "b"}),
        ("done", {"Avoid": "9 rpm"}),
        ("done", {}),
    ]
    drawn = rng.integers(len(kinds), size=n_tests)
    tests = [
        {"name": f"t{n}", "status": kinds[k][0], "facts": kinds[k][1], "picture": "a/b.png"}
        for n, k in enumerate(drawn)
    ]
    words = [word.strip() for word in _Reader(index_page(tests)).words]
    assert [int(word[1:]) for word in words if re.fullmatch(r"t\d+", word)] == np.argsort(drawn, kind="stable").tolist()
