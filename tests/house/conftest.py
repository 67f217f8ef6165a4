"""The project's own files, as the house tests read them."""

import ast
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest


@dataclass(frozen=True)
class Source:
    """A Python file: its path from the project's folder, its text and its syntax tree."""

    path: Path
    text: str
    tree: ast.Module


@pytest.fixture(scope="session")
def project_files(project_root):
    """Every file that is or would be committed, from the project's folder."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    try:
        listing = subprocess.run(command, cwd=project_root, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        reason = getattr(error, "stderr", "").strip() or error
        pytest.skip(f"git does not list the project's files: {reason}")
    names = sorted(set(listing.stdout.split("\0")) - {""})
    return [Path(name) for name in names if (project_root / name).is_file()]


@pytest.fixture(scope="session")
def python_files(project_root, project_files):
    """Every Python file of the project."""
    sources = []
    for path in project_files:
        if path.suffix == ".py":
            text = (project_root / path).read_text(encoding="utf-8")
            sources.append(Source(path, text, ast.parse(text, str(path))))
    return sources


@pytest.fixture(scope="session")
def package_files(python_files):
    """The Python files of the package."""
    found = [source for source in python_files if source.path.parts[:2] == ("src", "crankorder")]
    assert len(found) > 10, "the package's files were not found"
    return found
