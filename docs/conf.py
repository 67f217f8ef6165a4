"""How Sphinx builds these pages: ``make docs``. Nothing of them needs a network, to be built or to be read."""

from __future__ import annotations

import re
import sys
from importlib.metadata import version as version_of
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS))

project = "crankorder"
author = "the crankorder authors"
project_copyright = author
version = release = version_of("crankorder")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_click",
    "sphinx_copybutton",
    "executed",
]
exclude_patterns = ["_build"]
root_doc = "index"
html_theme = "furo"
html_title = f"crankorder {version}"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_show_copyright = False
html_copy_source = html_show_sourcelink = False
html_math_renderer = "mathml"

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 4
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_type_aliases = {"Signals": "Signals", "Tables": "Tables", "Recordings": "Recordings", "ArrayLike": "ArrayLike"}
copybutton_exclude = ".linenos, .gp, .go"
suppress_warnings = [
    "misc.highlighting_failure",  # listings of other formats, in no language that is known
]


LINK = re.compile(r"(?<!!)\[(?P<text>[^\]\n]*)\]\((?P<way>[^)#:\s]+)(?:#[^)\s]*)?\)")


def _within(text: str, folder: Path) -> str:
    """``text`` of a file in ``folder``, where links that lead out of the documentation are paths: no page is there."""

    def shown(match: re.Match[str]) -> str:
        target = (folder / match["way"]).resolve()
        if target.is_relative_to(DOCS) or not target.exists():
            return match[0]
        return f"{match['text']} (`{target.relative_to(DOCS.parent).as_posix()}`)"

    return LINK.sub(shown, text)


def _read(app: Sphinx, name: str, content: list[str]) -> None:
    content[0] = _within(content[0], Path(app.env.doc2path(name)).parent)


def _included(app: Sphinx, path: Path, parent: str, content: list[str]) -> None:
    content[0] = _within(content[0], (DOCS / path).resolve().parent)


def _formula(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def _display(translator: HTML5Translator, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Formulas as MathML, which browsers show without a script from elsewhere; links that stay within the pages."""
    app.add_html_math_renderer("mathml", (_formula, None), (_display, None))
    app.connect("source-read", _read)
    app.connect("include-read", _included)
