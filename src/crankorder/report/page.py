"""The report page of a test, one file that needs no other and no network, and the index of many tests."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.resources import files
from types import MappingProxyType
from typing import Any, Literal
from urllib.parse import quote

import xarray as xr
from jinja2 import Environment, FunctionLoader, StrictUndefined, Template
from markupsafe import Markup

from crankorder.findings import Findings
from crankorder.report.live import live_data
from crankorder.report.notation import named
from crankorder.report.sentences.story import headline, story_of
from crankorder.report.tables import tables_of
from crankorder.report.tables_of_sources import provenance_table
from crankorder.settings import ReportSettings

_NOTHING: Mapping[str, xr.Dataset] = MappingProxyType({})
_MOST_PICTURES = 1_800_000  # bytes of PNG in a page, 2.4 MB as text; half of what a page may weigh
_SHOWN_SENTENCES = 4  # of a box, so that the four weigh about the same
_NAME_CHARACTERS = 60
_ERROR_CHARACTERS = 400
_ANSWERS: tuple[tuple[Literal["what", "why", "how_sure", "what_to_do"], str], ...] = (
    ("what", "What shakes"),
    ("why", "Why"),
    ("how_sure", "How sure"),
    ("what_to_do", "What to do"),
)
_MARKED = frozenset({"excited", "suspect", "bad"})


@dataclass(frozen=True)
class ShownPicture:
    """A picture of a page: its ``file`` beside the page, its ``caption``, and as ``png`` what the page itself holds."""

    file: str
    caption: str
    png: bytes = b""


def report_page(
    findings: Findings,
    *,
    pictures: Sequence[ShownPicture],
    provenance: dict[str, Any],
    settings: ReportSettings,
    groups: Mapping[str, xr.Dataset] = _NOTHING,
) -> str:
    """HTML page of a test: what shakes, why, how sure and what to do; pictures; tables with intervals; provenance.

    ``findings`` as in ``data_schema/findings.json``; ``pictures`` in the order of the page; ``provenance`` as in
    ``data_schema/run.json``; ``settings`` of the report; ``groups`` datasets of the results by name, which the page's
    own script draws. All text is escaped; the page needs no other file: pictures stand in it as PNG up to 1.8 MB in
    all, those beyond that are links to the files beside it.
    """
    limit = settings.max_name_characters
    lead = headline(findings)[0]
    said = story_of(findings)
    live = live_data(groups, findings, settings=settings) if settings.pictures else ""
    return page_template("report.html").render(
        policy=page_policy(script=bool(live)),
        style=Markup(page_style()),  # our own file, never text from data
        script=Markup(page_script()) if live else "",  # our own file too
        live=Markup(live),  # JSON without <, > and &
        test=named(findings.test, limit=limit),
        lead=lead,
        story=[(title, _first_and_rest([one for one in said[key] if one != lead])) for key, title in _ANSWERS],
        pictures=_embedded(pictures, limit=4 * limit),
        tables=tables_of(findings, limit=limit),
        provenance=provenance_table(provenance),
        marked=_MARKED,
    )


def _first_and_rest(sentences: list[str]) -> tuple[list[str], list[str]]:
    """Sentences that a box shows, and those folded away under them; a single one more is shown too."""
    shown = _SHOWN_SENTENCES if len(sentences) > _SHOWN_SENTENCES + 1 else len(sentences)
    return sentences[:shown], sentences[shown:]


def _embedded(pictures: Sequence[ShownPicture], *, limit: int) -> list[dict[str, Any]]:
    """Pictures for the template: link, caption, whether the script draws the same, the PNG while it fits."""
    shown, room = list[dict[str, Any]](), _MOST_PICTURES
    for one in pictures:
        png = one.png if len(one.png) <= room else b""
        room -= len(png)
        texts = {"file": named(one.file, limit=limit), "caption": named(one.caption, limit=limit)}
        live, data = one.file.startswith(("campbell_", "orders.")), Markup(base64.b64encode(png).decode("ascii"))
        shown.append({"link": _beside(one.file), **texts, "png": data, "live": live})
    return shown


def index_page(tests: list[dict[str, Any]]) -> str:
    """HTML list of all tests of a run, each with its status, headline and link, and the recordings that failed.

    ``tests`` records with ``name``, ``status`` and, where there is one, ``headline`` (sentences), ``link`` (path of the
    report, relative to the index) and ``failed`` (records with ``recording`` and ``error``).
    """
    name, text = partial(named, limit=_NAME_CHARACTERS), partial(named, limit=_ERROR_CHARACTERS)
    shown = []
    for test in tests:
        status, said = str(test.get("status", "")), test.get("headline") or []
        row = {
            "name": name(test.get("name", "")),
            "status": text(status),
            "doubtful": status not in ("done", "ok", "unchanged"),
            "headline": [text(sentence) for sentence in ([said] if isinstance(said, str) else said)],
            "link": _beside(str(test["link"])) if test.get("link") else "",
            "failed": [
                (name(one.get("recording", "")), text(one.get("error", ""))) for one in test.get("failed") or []
            ],
        }
        shown.append(row)
    # the style is our own file, never text from data
    return page_template("index.html").render(policy=page_policy(), style=Markup(page_style()), tests=shown)


def _beside(path: str) -> str:
    """Relative link to a file beside the page: no scheme, host, query or parent can come out of a name."""
    parts = [part for part in path.replace("\\", "/").split("/") if part not in ("", ".", "..")]
    return "./" + "/".join(quote(part.encode("utf-8", "surrogateescape"), safe="") for part in parts)


@cache
def page_template(name: str) -> Template:
    """Template ``name`` of this room, which escapes every text."""
    loader = FunctionLoader(lambda wanted: files("crankorder.report").joinpath(wanted).read_text(encoding="utf-8"))
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template(name)


@cache
def page_style() -> str:
    """Style sheet of the pages: our own file, never text from data."""
    return files("crankorder.report").joinpath("report.css").read_text(encoding="utf-8")


@cache
def page_script() -> str:
    """Script of the report page: our own file, never text from data."""
    return files("crankorder.report").joinpath("page.js").read_text(encoding="utf-8")


@cache
def page_policy(*, script: bool = False) -> str:
    """Content security policy of a page: its pictures, its one style and, where it has one, its ``script`` by hash."""
    pictures = "data:" if script else "data: 'self' file:"
    scripts = f"; script-src {_digest(page_script())}" if script else ""
    return (
        f"default-src 'none'; img-src {pictures}; style-src {_digest(page_style())}{scripts}; base-uri 'none'; "
        "form-action 'none'"
    )


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode('utf-8')).digest()).decode('ascii')}'"
