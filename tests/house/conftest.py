"""The project's own files, as the house tests read them."""

import ast
import gc
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest


@dataclass(frozen=True)
class Source:
    """A Python file: its path from the project's folder, its text, its syntax tree and all nodes of that."""

    path: Path
    text: str
    tree: ast.Module
    nodes: tuple[ast.AST, ...]


@pytest.fixture(scope="session")
def project_files(project_root):
    """Every file that is or would be committed, from the project's folder."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listing = subprocess.run(command, cwd=project_root, capture_output=True, text=True)
    if listing.returncode:
        pytest.skip(f"git does not list the project's files: {listing.stderr.strip()}")
    names = sorted(set(listing.stdout.split("\0")) - {""})
    return [Path(name) for name in names if (project_root / name).is_file()]


@pytest.fixture(scope="session")
def python_files(project_root, project_files):
    """Every Python file of the project."""
    gc.disable()  # there are a million nodes, and all of them stay: to look for garbage takes longer than to parse
    paths = [path for path in project_files if path.suffix == ".py"]
    texts = {path: (project_root / path).read_text(encoding="utf-8") for path in paths}
    trees = {path: ast.parse(text, str(path)) for path, text in texts.items()}
    sources = [Source(path, texts[path], tree, tuple(ast.walk(tree))) for path, tree in trees.items()]
    gc.freeze()
    gc.enable()
    return sources


@pytest.fixture(scope="session")
def package_files(python_files):
    """The Python files of the package."""
    found = [source for source in python_files if source.path.parts[:2] == ("src", "crankorder")]
    assert len(found) > 10, "the package's files were not found"
    return found
