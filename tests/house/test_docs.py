"""What the documentation says is true of the program: keys, rooms, numbers."""

import importlib
import os
import re
import sys
from pathlib import Path
from typing import get_args

import pytest
from pydantic import BaseModel, ValidationError

from crankorder.ingest.manifest import Manifest

NEVER_STATED = ("points",)
"""Keys of a manifest's models that the program fills in."""


def _models(annotation):
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models(inner)


def _keys(model):
    """Every key that a file of ``model`` may state but tables of the manifest itself, with the model that has it."""
    for name, field in model.model_fields.items():
        inner = list(_models(field.annotation))
        if name not in NEVER_STATED and not (inner and model is Manifest):
            yield model, name
        for kind in inner:
            yield from _keys(kind)


def test_each_key_of_a_manifest_has_a_meaning_and_an_example_that_is_valid():
    keys, offenders = list(_keys(Manifest)), []
    assert {model.__name__ for model, _ in keys} >= {"Manifest", "Test", "Channel", "Encoder", "Bearing", "PathMode"}
    for model, name in keys:
        field = model.model_fields[name]
        if not (field.description or "").endswith(".") or not field.examples:
            offenders.append(f"{model.__name__}.{name}: Field(description='….', examples=[…])")
        for example in field.examples or ():
            try:
                model.model_validate({name: example})
            except ValidationError as error:  # the other keys are missing
                faults = [fault["msg"] for fault in error.errors() if fault["loc"][:1] == (name,)]
                offenders += [f"{model.__name__}.{name}: the example {example!r}: {fault}" for fault in faults]
    assert not offenders, "\n".join(offenders)


METHOD_PAGES = {
    "ingest": "ingest", "shaft": "shaft", "fft": "fft", "orders": "orders",
    "campbell": "campbell", "checks": "checks", "identify": "lines", "identify/lines": "lines",
    "identify/modes": "modal", "identify/balance": "balance",
    "engine": "engine", "synth": "synth", "batch": "batch",
}  # fmt: skip
WITHOUT_METHOD = {"report", "plot", "interchange"}
"""Rooms that show or hand on what others have found."""


def test_each_room_has_a_page_of_its_method_that_states_errors_or_sources(project_root):
    package = project_root / "src" / "crankorder"
    rooms = {path.parent.relative_to(package).as_posix() for path in package.glob("*/**/__init__.py")}
    assert {room for room in rooms if room.partition("/")[0] not in WITHOUT_METHOD} == set(METHOD_PAGES)
    for room, name in METHOD_PAGES.items():
        text = (project_root / "docs" / "method" / f"{name}.md").read_text(encoding="utf-8")
        assert f"`{room.replace('/', '.')}`" in text, f"method/{name}.md does not name its room {room}"


def test_the_readme_can_be_read_at_once_and_its_links_lead_somewhere(project_root):
    readme = (project_root / "README.md").read_text(encoding="utf-8")
    assert len(readme.splitlines()) < 150
    ways = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", readme)
    assert len(ways) > 15
    assert not [way for way in ways if not (project_root / way).exists()]


def test_every_page_of_the_documentation_is_in_a_table_of_contents(project_root):
    """A page that is in none has no way to it, and ends the building with a warning."""
    docs = project_root / "docs"
    tables = re.findall(r"```\{toctree\}(.*?)```", (docs / "index.md").read_text(encoding="utf-8"), re.DOTALL)
    named = [line for table in tables for line in table.splitlines() if line and not line.startswith(":")]
    listed = {page for name in named for page in docs.glob(f"{name}.md")}
    pages = {page for page in docs.rglob("*.md") if "_build" not in page.parts} - {docs / "index.md"}
    assert not [page.relative_to(docs).as_posix() for page in sorted(pages - listed)]
    assert all(list(docs.glob(f"{name}.md")) for name in named)


def test_pages_that_are_executed_are_executed_in_short_too(project_root):
    """What only the whole building executes may fail unseen for weeks."""
    makefile = (project_root / "Makefile").read_text(encoding="utf-8")
    short = re.search(r"^docs-short:.*\n\t.*executed\.py (.*)$", makefile, re.MULTILINE)
    run = {page for pattern in short[1].split() for page in project_root.glob(pattern)}
    blocks = re.compile(r"^```\{(run|python)\}", re.MULTILINE)
    pages = {page for page in (project_root / "docs").rglob("*.md") if "_build" not in page.parts}
    assert not [page.name for page in pages - run if blocks.search(page.read_text(encoding="utf-8"))]


@pytest.mark.slow
def test_the_six_tasks_run_in_a_notebook_and_show_pictures_and_pages(project_root, tmp_path, monkeypatch):
    nbformat, nbclient = pytest.importorskip("nbformat.v4"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    monkeypatch.syspath_prepend(str(project_root / "docs"))
    blocks = importlib.import_module("executed").blocks_of((project_root / "docs/notebook.md").read_text("utf-8"))
    monkeypatch.setenv("DOCS", str(project_root / "docs"))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.delenv("MPLBACKEND", raising=False)  # as in a notebook: pictures stand below their cell
    cells = [nbformat.new_code_cell(("%%sh\n" if block.kind == "run" else "") + block.code) for block in blocks]
    notebook = nbformat.new_notebook(cells=cells)
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [kind for cell in cells for output in cell.outputs for kind in output.get("data", {})]
    assert shown.count("image/png") == 3 and shown.count("text/html") >= 3
