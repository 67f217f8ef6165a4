"""The truth sheet, where it is at hand."""

import json
from pathlib import Path
from typing import Any

import pytest

TRUTH = Path(__file__).parents[2].parent / "shared" / "truth" / "truth.json"


@pytest.fixture(scope="session")
def truth() -> dict[str, Any]:
    """The independently derived numbers, where they are at hand."""
    if not TRUTH.is_file():
        pytest.skip("needs ../shared/truth/truth.json")
    content: dict[str, Any] = json.loads(TRUTH.read_text(encoding="utf-8"))
    return content
