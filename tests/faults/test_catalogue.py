"""The list of faults beside this file is whole, and every test that it names is there."""

import re
from pathlib import Path

import pytest

HERE = Path(__file__).parent
LINE = re.compile(r"\| ([A-I][0-9]+) \| (.*) \|")
LISTED = {found[1]: found[2] for found in map(LINE.fullmatch, (HERE / "README.md").read_text().splitlines()) if found}


def test_every_test_that_stands_for_a_fault_is_there():
    texts = {path: path.read_text(encoding="utf-8") for path in HERE.parent.rglob("*.py")}
    missing = []
    for entry, cell in LISTED.items():
        named = re.findall(r"`([\w/]+\.py)::(test_\w+)`", cell)
        missing += [entry] if not named and cell != "none yet" else []
        for file, test in named:
            if not re.search(rf"^\s*def {test}\(", texts.get(HERE.parent / file, ""), re.MULTILINE):
                missing.append(f"{entry}: {file}::{test}")
    assert LISTED and missing == []


def test_no_entry_of_the_catalogue_is_left_out(project_root):
    catalogue = project_root.parent / "shared" / "faults.md"
    if not catalogue.exists():
        pytest.skip("../shared/faults.md is absent: it lies beside the project, never inside")
    entries = re.findall(r"^\| ([A-I][0-9]+) \|", catalogue.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(entries) > 70
    assert set(entries) == set(LISTED)
