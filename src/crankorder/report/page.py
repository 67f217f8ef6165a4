"""The report page of a test and the index of many: HTML with no script and no network."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib.resources import files
from typing import Any, Literal
from urllib.parse import quote

from jinja2 import Environment, FunctionLoader, StrictUndefined, Template
from markupsafe import Markup

from crankorder.findings import Findings
from crankorder.report.notation import named
from crankorder.report.sentences.story import headline, story_of
from crankorder.report.tables import tables_of
from crankorder.report.tables_of_sources import provenance_table
from crankorder.settings import ReportSettings

_NAME_CHARACTERS = 60
_ERROR_CHARACTERS = 400
_ANSWERS: tuple[tuple[Literal["what", "why", "how_sure", "what_to_do"], str], ...] = (
    ("what", "What shakes"),
    ("why", "Why"),
    ("how_sure", "How sure"),
    ("what_to_do", "What to do"),
)
_MARKED = frozenset({"excited", "suspect", "bad"})


def report_page(
    findings: Findings, *, pictures: list[tuple[str, str]], provenance: dict[str, Any], settings: ReportSettings
) -> str:
    """HTML page of a test: what shakes, why, how sure and what to do; pictures; tables with intervals; provenance.

    ``findings`` as in ``data_schema/findings.json``; ``pictures`` pairs of file name (beside the page) and caption;
    ``provenance`` as in ``data_schema/run.json``; ``settings`` of the report. All text is escaped; the page refers to
    nothing but its pictures.
    """
    limit = settings.max_name_characters
    lead = headline(findings)[0]
    said = story_of(findings)
    return page_template("report.html").render(
        policy=page_policy(),
        style=Markup(page_style()),  # our own file, never text from data
        test=named(findings.test, limit=limit),
        lead=lead,
        story=[(title, [one for one in said[key] if one != lead]) for key, title in _ANSWERS],
        pictures=[(_beside(file), named(caption, limit=4 * limit)) for file, caption in pictures],
        tables=tables_of(findings, limit=limit),
        provenance=provenance_table(provenance),
        marked=_MARKED,
    )


def index_page(tests: list[dict[str, Any]]) -> str:
    """HTML list of all tests of a run, each with its status, headline and link, and the recordings that failed.

    ``tests`` records with ``name``, ``status`` and, where there is one, ``headline`` (sentences), ``link`` (path of the
    report, relative to the index) and ``failed`` (records with ``recording`` and ``error``).
    """
    shown = []
    for test in tests:
        status, said = str(test.get("status", "")), test.get("headline") or []
        sentences = [said] if isinstance(said, str) else list(said)
        failed = [
            (
                named(record.get("recording", ""), limit=_NAME_CHARACTERS),
                named(record.get("error", ""), limit=_ERROR_CHARACTERS),
            )
            for record in test.get("failed") or []
        ]
        shown.append(
            {
                "name": named(test.get("name", ""), limit=_NAME_CHARACTERS),
                "status": named(status, limit=_ERROR_CHARACTERS),
                "doubtful": status not in ("done", "ok", "unchanged"),
                "headline": [named(sentence, limit=_ERROR_CHARACTERS) for sentence in sentences],
                "link": _beside(str(test["link"])) if test.get("link") else "",
                "failed": failed,
            }
        )
    style = Markup(page_style())  # our own file, never text from data
    return page_template("index.html").render(policy=page_policy(), style=style, tests=shown)


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
def page_policy() -> str:
    """Content security policy of a page: its pictures, its one style by hash, no script."""
    digest = base64.b64encode(hashlib.sha256(page_style().encode("utf-8")).digest()).decode("ascii")
    return f"default-src 'none'; img-src 'self' file:; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
