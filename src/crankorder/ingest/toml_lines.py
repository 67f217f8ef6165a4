"""Where in a TOML text each key stands: tomllib drops line numbers, and errors need them."""

from __future__ import annotations

import re


def key_lines(text: str) -> dict[str, int]:
    """Line of every key and table of a valid TOML ``text``, by dotted key path with list positions from 0."""
    lines: dict[str, int] = {}
    counts: dict[str, int] = {}
    table, inside, depth = "", "", 0
    for number, line in enumerate(text.split("\n"), start=1):
        if inside:
            inside = "" if inside in line else inside
            continue
        bare = re.sub(r'"""[^"]*"""|' + r"'''[^']*'''|" + r'"(?:\\.|[^"\\])*"(?!")|' + r"'[^']*'(?!')", "0", line)
        opened = re.search(r'"""|' + r"'''", bare)
        inside = opened[0] if opened else ""
        bare = bare.split("#")[0]
        header = re.match(r"\s*\[(\[?)\s*(.*?)\s*\](\]?)\s*(#.*)?$", line) if depth == 0 else None
        if header and header[1] == header[3]:
            table = _dotted(header[2])
            if header[1]:
                counts[table] = counts.get(table, -1) + 1
                lines.setdefault(table, number)
                table = f"{table}.{counts[table]}"
            lines[table] = number
            continue
        key = re.match(r"\s*((?:[\w-]+|\"[^\"]*\"|'[^']*')(?:\s*\.\s*(?:[\w-]+|\"[^\"]*\"|'[^']*'))*)\s*=", line)
        if key and depth == 0:
            lines[f"{table}.{_dotted(key[1])}".lstrip(".")] = number
        depth = max(0, depth + sum(bare.count(mark) for mark in "[{") - sum(bare.count(mark) for mark in "]}"))
    return lines


def _dotted(key: str) -> str:
    return re.sub(r"\s*\.\s*", ".", key).replace('"', "").replace("'", "")
