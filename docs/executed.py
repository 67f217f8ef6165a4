"""The blocks of the pages that are executed: ``{run}`` of a shell, ``{python}`` of Python.

``python docs/executed.py [PAGE…]`` runs the blocks of the pages (all, if none is named) without Sphinx and says where
one fails; as an extension of Sphinx it also shows what came out. The blocks of a page run one after the other in an
empty folder of their own. Options of a block: ``:status: 2`` is the exit status it must end with (else 0), ``:hidden:``
runs it unseen, ``:quiet:`` shows no output, ``:picture: PATH`` shows that picture, which the block has made.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
FENCE = re.compile(r"^```\{(?P<kind>run|python)\}[ ]*\n(?P<body>.*?)^```[ ]*$", re.MULTILINE | re.DOTALL)
OPTION = re.compile(r":(?P<name>[a-z]+):[ ]*(?P<value>.*)")


@dataclass
class Block:
    """A block of a page: its ``kind``, its code with options, the line it begins at, and what came out."""

    kind: str
    code: str
    options: dict[str, str]
    line: int
    text: str = ""
    html: str = ""
    pictures: list[str] = field(default_factory=list)
    fault: str = ""


def blocks_of(text: str) -> list[Block]:
    """The blocks of a page of that ``text``, in their order."""
    made = []
    for match in FENCE.finditer(text):
        lines = match["body"].splitlines()
        options = {}
        while lines and (option := OPTION.fullmatch(lines[0])):
            options[option["name"]] = option["value"]
            lines.pop(0)
        made.append(Block(match["kind"], "\n".join(lines).strip("\n"), options, text.count("\n", 0, match.start()) + 1))
    return made


def execute(page: Path, pictures: Path) -> list[Block]:
    """The blocks of ``page`` with what came out, run here and now in the working folder; ends with the first fault.

    Pictures are written into the folder ``pictures``.
    """
    made, names = blocks_of(page.read_text(encoding="utf-8")), {"__name__": "__main__"}
    for number, block in enumerate(made):
        kept = [pictures / f"{page.stem}-{number}-{place}.png" for place in range(9)]
        try:
            (_python if block.kind == "python" else _run)(block, names, kept)
            if "picture" in block.options:
                shutil.copyfile(block.options["picture"], kept[-1])
                block.pictures.append(kept[-1].name)
        except Exception:  # whatever it is, the page is wrong
            block.fault = traceback.format_exc(limit=-2)
        if block.fault:
            break
    return made


def _run(block: Block, names: dict[str, Any], kept: list[Path]) -> None:
    done = subprocess.run(
        ["sh", "-euc", block.code], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, encoding="utf-8", check=False
    )
    block.text = done.stdout
    if done.returncode != int(block.options.get("status", 0)):
        block.fault = f"exit status {done.returncode}\n{done.stdout}"


def _python(block: Block, names: dict[str, Any], kept: list[Path]) -> None:
    tree, value = ast.parse(block.code), None
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    written = io.StringIO()
    with contextlib.redirect_stdout(written), contextlib.redirect_stderr(written):
        exec(compile(tree, "page", "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), "page", "eval"), names)
    pyplot = sys.modules.get("matplotlib.pyplot")
    for number, path in zip(pyplot.get_fignums() if pyplot else [], kept, strict=False):
        figure = pyplot.figure(number)
        figure.savefig(path, dpi=110)
        pyplot.close(figure)
        block.pictures.append(path.name)
    block.text = written.getvalue()
    if value is not None and not block.pictures:
        block.html = value._repr_html_() if hasattr(value, "_repr_html_") else ""
        block.text += "" if block.html else repr(value)


def run_page(page: Path, pictures: Path) -> list[Block]:
    """The blocks of ``page`` with what came out, run in a process and a folder of their own."""
    pictures.mkdir(parents=True, exist_ok=True)
    beside = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with tempfile.TemporaryDirectory() as work:
        files = {"PATH": beside, "MPLBACKEND": "agg", "COLUMNS": "100", "DOCS": str(DOCS)}
        command = [sys.executable, __file__, "--execute", str(page), str(pictures)]
        done = subprocess.run(command, cwd=work, env=os.environ | files, capture_output=True, encoding="utf-8")
    if done.returncode:
        return [Block("", "", {}, 1, fault=f"exit status {done.returncode}\n{done.stderr}")]
    return [Block(**block) for block in json.loads(done.stdout)]


def run_pages(pages: list[Path], pictures: Path) -> Iterator[tuple[Path, list[Block]]]:
    """Each of ``pages`` with its blocks and what came out, two pages at a time."""
    with ThreadPoolExecutor(2) as pool:
        yield from zip(pages, pool.map(lambda page: run_page(page, pictures), pages), strict=True)


def executed_pages() -> list[Path]:
    """Pages that have blocks."""
    pages = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)
    return [page for page in pages if blocks_of(page.read_text(encoding="utf-8"))]


def faults_of(page: Path, made: list[Block]) -> list[str]:
    """What failed of the blocks of ``page``: file, line, what was said."""
    return [f"{page.relative_to(DOCS)}:{block.line}: {block.fault}" for block in made if block.fault]


def setup(app: Any) -> dict[str, Any]:
    """Register the blocks with the Sphinx application ``app``: its pages are run before they are read."""
    from docutils import nodes
    from docutils.parsers.rst import directives
    from sphinx.errors import ExtensionError
    from sphinx.util.docutils import SphinxDirective

    pictures, results = DOCS / "_build" / "executed", {}

    def run_all(app: Any) -> None:
        for page, made in run_pages(executed_pages(), pictures):
            if faults := faults_of(page, made):
                raise ExtensionError("\n".join(faults))
            results[page.relative_to(DOCS).with_suffix("").as_posix()] = made

    class Shown(SphinxDirective):
        has_content = True
        option_spec = {  # noqa: RUF012
            "status": directives.nonnegative_int,
            "hidden": directives.flag,
            "quiet": directives.flag,
            "picture": directives.unchanged,
        }

        def run(self) -> list[nodes.Node]:
            place = self.env.current_document.get("executed", 0)
            self.env.current_document["executed"] = place + 1
            block = results[self.env.docname][place]
            if "hidden" in block.options:
                return []
            made: list[nodes.Node] = [nodes.literal_block(block.code, block.code, language=LEXERS[block.kind])]
            if block.text.strip() and "quiet" not in block.options:
                made.append(nodes.literal_block(block.text, block.text.rstrip(), language="text", classes=["output"]))
            if block.html:
                made.append(nodes.raw("", f'<div class="output">{block.html}</div>', format="html"))
            for name in block.pictures:
                way = "/" + (pictures / name).relative_to(DOCS).as_posix()
                alt = f"Picture that the block above has made: {Path(block.options.get('picture', name)).stem}"
                made.append(nodes.image(uri=way, alt=alt))
            return made

    app.connect("builder-inited", run_all)
    for kind in LEXERS:
        app.add_directive(kind, Shown)
    return {"parallel_read_safe": False}


LEXERS = {"run": "sh", "python": "python"}


def main(arguments: list[str]) -> int:
    """Run the pages that ``arguments`` name, all if none; returns the exit status."""
    if arguments[:1] == ["--execute"]:
        made = execute(Path(arguments[1]), Path(arguments[2]))
        print(json.dumps([asdict(block) for block in made]))
        return 0
    pages = [Path(name).resolve() for name in arguments] or executed_pages()
    with tempfile.TemporaryDirectory() as pictures:
        faults = []
        for page, made in run_pages(pages, Path(pictures)):
            faults += faults_of(page, made)
            print(f"{page.relative_to(DOCS)}: {len(made)} blocks", flush=True)
    print("\n".join(faults), file=sys.stderr, end="")
    return 1 if faults or not pages else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
