"""What a benchmark leaves in `reports/speed-error`: numbers, a page of tables, and a figure."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from matplotlib.figure import Figure

FOLDER = Path(__file__).parents[1] / "reports" / "speed-error"


def publish(name: str, found: dict, page: str, figure: Figure, *, into: Path = FOLDER) -> None:
    """Write ``name``.json, .md and .png and print the page."""
    into.mkdir(parents=True, exist_ok=True)
    (into / f"{name}.json").write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    (into / f"{name}.md").write_text(page, encoding="utf-8")
    figure.savefig(into / f"{name}.png", dpi=110, metadata={"Software": None})
    print(page)


def table(header: list[str], rows: Iterable[Iterable[object]] | dict[str, dict]) -> str:
    """A Markdown table; of a dictionary of dictionaries the names come first."""
    cells = [[name, *row.values()] for name, row in rows.items()] if isinstance(rows, dict) else rows
    body = [f"| {' | '.join(str(value) for value in row)} |" for row in cells]
    return "\n".join([f"| {' | '.join(header)} |", f"|{' --- |' * len(header)}", *body])
