"""The report page of a test, one file that needs no other and no network, what its script draws; the index of tests."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.resources import files
from types import MappingProxyType
from typing import Any
from urllib.parse import quote

import numpy as np
import xarray as xr
from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray

from crankorder.channel_units import unit_text
from crankorder.findings import CrossingFinding, Findings, ModeFinding, OrderFinding
from crankorder.plot import reading
from crankorder.plot.campbell_figure import level_limits, speed_cells
from crankorder.plot.labels import mode_style, mode_text
from crankorder.plot.palette import level_colours
from crankorder.quantities import Floats
from crankorder.records import known
from crankorder.report.sentences.story import Answer, lead_of, story_of
from crankorder.report.tables import provenance_table, tables_of
from crankorder.settings import ReportSettings

_NOTHING: Mapping[str, xr.Dataset] = MappingProxyType({})
_MOST_PICTURES = 1_800_000  # bytes of PNG in a page, 2.4 MB as text; half of what a page may weigh
_SHOWN_SENTENCES = 4  # of a box, so that the four weigh about the same
_ERROR_CHARACTERS = 400
_ANSWERS: dict[Answer, str] = {"what": "What shakes", "why": "Why", "how_sure": "How sure", "what_to_do": "What to do"}
_SOUND = ("done", "ok", "unchanged", "no change")  # status of a test of an index
_BEARING, _AVOID = "Failing bearing", "Avoid"  # facts of an index that are trouble
_MARKED = frozenset({"excited", "suspect", "bad"})

_STEP_DB = 0.005
_TOP = 60_000  # code of the largest cell of a channel; 300 dB below it nothing is left
_MAP_CELLS = {"campbell_map": 525_000, "order_map": 75_000}  # 2.7 bytes each: 1.6 MB of a page of 5 MB
_FEWEST_COLUMNS = 400  # of a map that is pooled to fit; less shows no lines
_MOST_CHANNELS = 64
_MOST_LINES = 400
_GUIDES = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0)

_TITLES = {"campbell_map": ("campbell", "Campbell diagram", "Frequency, Hz", "frequency"),
           "order_map": ("order", "Order map", "Order (cycles per crank revolution)", "order")}  # fmt: skip
HINT = "Point at a cell, or use the arrow keys: what is there, and what the findings say of it."


@dataclass(frozen=True)
class ShownPicture:
    """A picture of a page: its ``file`` beside the page, its ``caption``, and the ``png`` inside the page itself."""

    file: str
    caption: str
    png: bytes = b""


def report_page(
    findings: Findings,
    *,
    pictures: Sequence[ShownPicture],
    provenance: Mapping[str, object],
    settings: ReportSettings,
    groups: Mapping[str, xr.Dataset] = _NOTHING,
) -> str:
    """HTML page of a test: what shakes, why, how sure and what to do; pictures; tables with intervals; provenance.

    ``findings`` are those of ``data_schema/findings.json``, ``pictures`` stand in the order of the page, ``provenance``
    is that of ``data_schema/run.json``, ``settings`` are those of the report; ``groups`` are the datasets of the
    results by name, with the dims of ``data_schema/``, which the script of the page draws. All text is escaped. The
    page needs no other file: pictures stand in it as PNG up to 1.8 MB in all, further ones are links to files beside
    it.
    """
    limit = settings.max_name_characters
    lead, story = lead_of(findings), story_of(findings)
    told = [(title, [text for text in story[key] if text not in lead]) for key, title in _ANSWERS.items()]
    tables = [*tables_of(findings, limit=limit), ("provenance", provenance_table(provenance))]
    live = live_data(groups, findings, settings=settings) if settings.pictures else ""
    return rendered_page(
        "report.html",
        has_script=bool(live) or any(part.is_long for _, table in tables for part in table.parts),
        live=Markup(live),  # JSON without <, > and &
        test=reading.named(findings.test, limit=limit),
        lead=lead,
        story=[(title, _first_and_rest(sentences)) for title, sentences in told],
        pictures=_embedded(pictures, limit=4 * limit),
        tables=tables,
        marked=_MARKED,
    )


def _first_and_rest(sentences: list[str]) -> tuple[list[str], list[str]]:
    """Sentences that a box shows, and those folded away under them; a single one more is shown too."""
    shown = _SHOWN_SENTENCES if len(sentences) > _SHOWN_SENTENCES + 1 else len(sentences)
    return sentences[:shown], sentences[shown:]


def _embedded(pictures: Sequence[ShownPicture], *, limit: int) -> list[dict[str, object]]:
    """Pictures for the template: link, caption, whether the script draws the same, the PNG while it fits."""
    embedded, room = list[dict[str, object]](), _MOST_PICTURES
    for picture in pictures:
        png = picture.png if len(picture.png) <= room else b""
        room -= len(png)
        embedded.append({
            "link": _beside(picture.file), "file": reading.named(picture.file, limit=limit),
            "caption": reading.named(picture.caption, limit=limit), "png": Markup(_base64(png)),
            "live": picture.file.startswith("campbell_"),
        })  # fmt: skip
    return embedded


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def index_page(tests: Sequence[Mapping[str, Any]], *, title: str = "", lead: Sequence[str] = ()) -> str:
    """HTML list of all tests of a run, those in trouble first, each with status, headline, picture, link and failures.

    Each of ``tests`` has ``name``, ``status``, ``headline`` (sentences), ``link`` to its report and ``picture``, both
    relative to the index, ``facts`` (text by name, of :func:`index_facts`), and ``failed`` (``recording`` and ``error``
    of each); missing keys are left out. ``title`` heads the page, else the number of tests; ``lead`` are sentences on
    all tests.
    """
    text = partial(reading.named, limit=_ERROR_CHARACTERS)
    rows = list[dict[str, Any]]()
    for test in tests:
        status, sentences = str(test.get("status", "")), test.get("headline") or []
        facts = {str(name): text(fact) for name, fact in (test.get("facts") or {}).items() if fact}
        rows.append({
            "name": reading.short(test.get("name", "")), "status": text(status), "doubtful": status not in _SOUND,
            "headline": [text(sentence) for sentence in ([sentences] if isinstance(sentences, str) else sentences)],
            "link": _beside(link) if (link := test.get("link")) else "",
            "picture": _beside(picture) if (picture := test.get("picture")) else "", "facts": facts,
            "failed": [(reading.short(of["recording"]), text(of["error"])) for of in test.get("failed") or []],
            "trouble": (status != "failed", status in _SOUND, _BEARING not in facts, _AVOID not in facts),
        })  # fmt: skip
    rows.sort(key=lambda row: row["trouble"])
    counts = {
        "failed": sum(row["status"] == "failed" for row in rows),
        "with recordings that failed": sum(bool(row["failed"]) for row in rows if row["status"] != "failed"),
        "with a failing bearing": sum(_BEARING in row["facts"] for row in rows),
        "with a speed to avoid": sum(_AVOID in row["facts"] for row in rows),
    }
    summary = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
    shown = 1 if not title else 4  # sentences of a test: of two builds all that changed
    return rendered_page(
        "index.html", tests=rows, shown=shown, title=text(title), lead=[*map(text, lead)], summary=summary
    )


def index_facts(findings: Findings) -> dict[str, str]:
    """What an index says of a test by its ``findings``, as text by name; what it has not is left out."""
    first = {channel.unit for channel in findings.channels[:1]}  # amplitudes in other units are not larger or smaller
    orders = [record for record in findings.orders if record.unit in first]
    best = max(orders, key=lambda record: record.amplitude, default=None)
    damaged = dict.fromkeys(f"{reading.short(of.name)} {of.line}" for of in findings.bearings if of.damage)
    avoided = list(findings.speeds_to_avoid or ())[:1]
    ends = known(findings.speed_range_rpm)
    return {
        name: fact
        for name, fact in {
            _BEARING: reading.listed(list(damaged), most=3),
            _AVOID: "".join(f"{one.rpm:.0f} rpm (order {reading.order_text(one.order)})" for one in avoided),
            "Strongest order": f"{reading.order_text(best.order)} in {reading.short(best.channel)}, "
            f"{reading.level_text(findings, best)}{reading.at_speed(best.speed_rpm_at_max)}" if best else "",
            "Speeds": f"{'–'.join(dict.fromkeys(f'{end:.0f}' for end in ends))} rpm" if ends else "",
        }.items() if fact
    }  # fmt: skip


def _beside(path: str) -> str:
    """Relative link to a file beside the page: no scheme, host, query or parent can come out of a name."""
    parts = [part for part in path.replace("\\", "/").split("/") if part not in ("", ".", "..")]
    return "./" + "/".join(quote(part.encode("utf-8", "surrogateescape"), safe="") for part in parts)


def rendered_page(template: str, *, has_script: bool = False, **values: object) -> str:
    """Page made from a ``template`` of this room and its ``values``: all text is escaped, no network is used.

    The content security policy allows its pictures, its one style and, where it ``has_script``, its script by hash.
    Style and script are our own files, never text from data.
    """
    style, script = _own_file("report.css"), _own_file("page.js") if has_script else ""
    pictures = "data:" if script else "data: 'self' file:"
    scripts = f"; script-src {_digest(script)}" if script else ""
    policy = f"default-src 'none'; img-src {pictures}; style-src {_digest(style)}{scripts}"
    policy += "; base-uri 'none'; form-action 'none'"
    page = TEMPLATES.get_template(template)
    return page.render(policy=policy, style=Markup(style), script=Markup(script), **values)


@cache
def _own_file(name: str) -> str:
    return files("crankorder.report").joinpath(name).read_text(encoding="utf-8")


TEMPLATES = Environment(
    loader=FunctionLoader(_own_file), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
)
"""Templates of this room, which escape every text."""


def _digest(text: str) -> str:
    return f"'sha256-{_base64(hashlib.sha256(text.encode('utf-8')).digest())}'"


Record = dict[str, object]
"""A map, or a thing that the findings name, as the script of the page reads it."""


def live_data(groups: Mapping[str, xr.Dataset], findings: Findings, *, settings: ReportSettings) -> str:
    """JSON for the script of the page, safe inside a script element; empty where there is no map.

    ``groups`` are the datasets of the results by name: maps (channel, speed, order or frequency); ``findings`` are
    those of the test, ``settings`` those of the report. In maps with many cells neighbouring columns are pooled by
    their maximum, and the last channels are left out, so that a page stays below 5 MB whatever its test holds.
    """
    first = next((groups[name] for name in _TITLES if name in groups), None)
    if first is None:
        return ""
    names, units = (first[key].values[:_MOST_CHANNELS].astype(str).tolist() for key in ("channel", "unit"))
    names = [reading.named(name, limit=settings.max_name_characters) for name in names]
    references = [reading.channel_level(first, number, settings=settings)[0] for number in range(len(names))]
    maps = [*filter(None, (_map(name, groups[name], references, settings) for name in _TITLES if name in groups))]
    if not maps:
        return ""
    sources = first["channel"].values[: len(names)].astype(str).tolist()
    strongest = reading.strongest_by(findings.orders, lambda record: record.channel)
    tops = [strongest.get(source) for source in sources]
    sizes = [top.amplitude if top and unit == units[0] else 0.0 for top, unit in zip(tops, units, strict=True)]
    fastest = float(np.nan_to_num(first["speed"].values, posinf=0.0, neginf=0.0).max(initial=0.0))
    document = {
        "hint": HINT, "first": sizes.index(max(sizes)),
        "colours": _base64(np.insert(level_colours(), 3, 255, axis=1).tobytes()),
        "channels": _shortened([
            {"name": name, "unit": unit_text(unit), "reference": reference, "order": top.order if top else 1.0,
             "rpm": (top and top.speed_rpm_at_max) or fastest}
            for name, unit, reference, top in zip(names, units, references, tops, strict=True)
        ]),
        "maps": maps, **_statements(findings, sources, settings),
    }  # fmt: skip
    text = json.dumps(document, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _map(name: str, dataset: xr.Dataset, references: list[float], settings: ReportSettings) -> Record | None:
    """A map: ``rows`` of speed [rpm], slowest first, with the ends of their cells; ``nx`` columns.

    The columns begin at ``x0`` and are ``dx`` apart; each is the largest of ``pooled``. ``cells`` per channel: base64
    of codes (rows, columns), 16 bits each; ``largest`` its largest amplitude, which has the code 60000, each 0.005 dB
    below one less; ``limits`` of the colours [dB] over the ``references``.
    """
    kind, title, label, axis = _TITLES[name]
    x = np.asarray(dataset[axis].values, dtype=float)
    speed = np.asarray(dataset["speed"].values, dtype=float)
    amplitude = dataset["amplitude"].transpose("channel", "speed", axis).values[: len(references)]
    kept = np.flatnonzero(np.isfinite(speed) & np.isfinite(amplitude).any(axis=(0, 2)))
    kept = kept[np.argsort(speed[kept], kind="stable")]
    even = len(x) > 1 and np.allclose(np.diff(x), x[1] - x[0], rtol=1e-6)
    if len(kept) < 2 or not even:
        return None
    # columns pooled into one, and channels shown, so that the page holds no more cells than it may
    cells, most = len(kept) * len(x), _MAP_CELLS[name]
    pool = min(max(1, math.ceil(len(references) * cells / most)), max(1, len(x) // _FEWEST_COLUMNS))
    shown = min(len(references), int(most / (cells / pool)))
    if not shown:
        return None
    columns = -(-len(x) // pool)
    largest, limits, codes = [], [], []
    for values, reference in zip(amplitude[:shown, kept], references, strict=False):
        values = np.nan_to_num(values.astype(np.float64), posinf=0.0)
        if pool > 1:
            padded = np.pad(values, ((0, 0), (0, columns * pool - len(x))))
            values = padded.reshape(len(kept), columns, pool).max(axis=2)
        top = float(values.max())
        largest.append(top)
        limits.append(level_limits(values, reference, range_db=settings.dynamic_range_db))
        codes.append(_base64(_codes(values, top).tobytes()))
    step = float(x[-1] - x[0]) / (len(x) - 1)
    rows = _shortened(np.column_stack([speed[kept], speed_cells(speed[kept])]).tolist())
    return {
        "kind": kind, "name": title, "label": label, "x0": float(x[0]) + (pool - 1) / 2 * step, "dx": pool * step,
        "nx": columns, "pooled": pool, "rows": rows, "largest": largest, "limits": limits, "cells": codes,
    }  # fmt: skip


def _shortened(value: object) -> object:
    """``value`` with every number to eight digits: findings read back from their file have no more than ten."""
    if isinstance(value, float):
        return float(f"{value:.8g}")
    if isinstance(value, dict):
        return {key: _shortened(part) for key, part in value.items()}
    return [_shortened(part) for part in value] if isinstance(value, list | tuple) else value


def _codes(values: Floats, top: float) -> NDArray[np.uint16]:
    """Codes of the script: 0 for nothing, 60000 for ``top``, one less for every 0.005 dB below."""
    with np.errstate(divide="ignore", invalid="ignore"):  # 0 / 0 where there is no signal
        share = np.divide(values, top)
        code = np.rint(_TOP + 20 / _STEP_DB * np.log10(share))
    return np.asarray(np.where(share > 0, np.clip(code, 1, _TOP), 0).astype("<u2"))


def _statements(findings: Findings, names: list[str], settings: ReportSettings) -> Record:
    """Findings as records for the script of the page; channels by their index in ``names``."""
    limit, modes = settings.max_name_characters, reading.fixed_frequencies(findings)
    number = {name: place for place, name in enumerate(names)}
    loudest = sorted(findings.orders, key=lambda record: -record.amplitude)
    orders = [_order(record, findings, number, limit) for record in loudest if record.channel in number]
    if findings.not_asked_for:
        texts = zip(_GUIDES, map(reading.order_text, _GUIDES), strict=True)
        orders = [_order_line(order, text, f"Order {text}", names, number) for order, text in texts]
    avoid = filter(None, (known(speed.rpm_range) for speed in findings.speeds_to_avoid or ()))
    free = filter(None, (known((band.low_rpm, band.high_rpm)) for band in findings.free_bands))
    bands = [{"range": ends, "text": f"Avoid {reading.speeds_text(ends)} rpm"} for ends in avoid]
    statements = {
        "orders": orders,
        "fixed": [_fixed(mode, number, limit) for mode in modes],
        "crossings": [
            _crossing(record, findings, modes, number, limit) for record in findings.crossings if record.in_range
        ],
        "lines": _lines(findings, number, limit),
        "bands": [*bands, *({"range": ends, "text": "Free of resonances at this speed"} for ends in free)],
    }
    return {key: _shortened(value) for key, value in statements.items()}


def _record(text: str, channels: Iterable[str], number: dict[str, int], **more: object) -> Record:
    """Record for the script: a ``text`` on ``channels``, true near ``hz`` + ``slope`` · (rpm − ``from_rpm``) / 60."""
    places = [number[channel] for channel in channels if channel in number]
    return {"text": text, "channels": places, "hz": 0.0, "slope": 0.0, "from_rpm": 0.0, "half": 0.0, **more}


def _order_line(order: float, label: str, text: str, channels: Iterable[str], number: dict[str, int]) -> Record:
    style = {"label": label, "colour": "#ffffff", "alpha": 0.45, "dashes": (), "ink": ""}
    return _record(text, channels, number, slope=order, **style)


def _order(record: OrderFinding, findings: Findings, number: dict[str, int], limit: int) -> Record:
    """Record of an order for the script: label, cause and the speeds at which it was seen."""
    name, seen = reading.order_name(record, findings), known(record.speed_range_rpm)
    text = f"Order {name}: {reading.named(record.explained_by or 'unexplained', limit=2 * limit)}"
    text += f", seen at {reading.speeds_text(seen)} rpm" if seen else ""
    return _order_line(record.order, name, text, [record.channel], number)


def _half_width(mode: ModeFinding) -> float:
    """Half the half-power bandwidth [Hz] of a mode, at least half its confidence interval."""
    low, high = reading.interval_of(mode, "frequency_hz") or (0.0, 0.0)
    return max(mode.frequency_hz * (mode.damping_ratio or 0.0), (high - low) / 2)


def _fixed(mode: ModeFinding, number: dict[str, int], limit: int) -> Record:
    """Record of a fixed frequency, or of a whirl with its ``slope``; ``half``: half bandwidth in Hz."""
    estimate = f"{reading.estimate_text(mode, 'frequency_hz')} Hz"
    (kind, _, colour, dashes), text = mode_style(mode), f"Natural frequency {estimate}"
    if kind == "tone":
        text = f"{reading.named(mode.explained_by, limit=limit).capitalize()} {estimate}"
    elif kind == "doubt":
        text = f"Perhaps a natural frequency, not decided: {estimate}"
    elif reading.is_number(mode.damping_ratio):
        text += f", damping {reading.number_text(100 * mode.damping_ratio, digits=2)} %"
    slope, rpm = (mode.speed_slope or 0.0, mode.reference_rpm or 0.0) if reading.is_whirl(mode) else (0.0, 0.0)
    return _record(
        f"{text}{_in(mode.channels, limit)}", mode.channels, number, hz=mode.frequency_hz, slope=slope, from_rpm=rpm,
        half=_half_width(mode), label=mode_text(mode), colour=colour, alpha=0.8, dashes=dashes,
        ink="warn" if kind == "tone" else "accent",
    )  # fmt: skip


def _in(channels: Sequence[str | None], limit: int) -> str:
    names = ", ".join(filter(None, channels))
    return f", in {reading.named(names, limit=limit)}" if names else ""


def _crossing(
    crossing: CrossingFinding, findings: Findings, modes: list[ModeFinding], number: dict[str, int], limit: int
) -> Record:
    """Record of the crossing of an order and a natural frequency, on the channels in which it is excited."""
    nearest = min(modes, key=lambda mode: abs(mode.frequency_hz - crossing.mode_hz), default=None)
    channels, spread = crossing.channels or (crossing.channel,), max(0.02 * crossing.rpm, 1.0)
    factor = crossing.amplification or 0.0
    times = f", × {reading.number_text(factor, digits=2)}" if crossing.excited and factor > 0 else ""
    verdict = crossing.verdict or ("excited" if crossing.excited else "not excited")
    where = f"order {reading.order_name(crossing, findings)} meets {reading.frequency_text(crossing.mode_hz)} Hz"
    text = f"Crossing: {where} near {crossing.rpm:.0f} rpm, {verdict}{times}{_in(channels, limit)}"
    half, near = 0.0 if nearest is None else _half_width(nearest), (crossing.rpm - spread, crossing.rpm + spread)
    shaken = ([*filter(None, channels)] or [*number]) if crossing.excited else []
    return _record(text, shaken, number, hz=crossing.mode_hz, half=half, rpm=crossing.rpm, range=near)


def _lines(findings: Findings, number: dict[str, int], limit: int) -> list[Record]:
    """Records of the strongest spectral lines with their causes; the last, at no frequency, is said where none is."""
    shown = list[Record]()
    own = (line for line in findings.lines if line.channel in number)
    for line in sorted(own, key=lambda line: -line.size)[:_MOST_LINES]:
        order = "" if line.order is None else f"order {reading.order_text(reading.nominal_order(line))}"
        cause = reading.named(line.explained_by or "unexplained", limit=2 * limit)
        text = f"Line at {order or f'{line.frequency_hz:.4g} Hz'}: {cause}"
        at = {"hz": line.frequency_hz} if line.order is None else {"slope": line.order}
        shown.append(_record(text, [line.channel], number, **at))
    nothing = "Findings were not asked for" if findings.not_asked_for else "No line is named here"
    return [*shown, {"text": nothing, "channels": [*number.values()]}]
