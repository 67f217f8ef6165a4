"""Where in a TOML text each key stands: tomllib drops line numbers, and errors need them."""

from __future__ import annotations

import re

_KEY = r"(?:[\w-]+|\"[^\"]*\"|'[^']*')"
_HEADER = re.compile(rf"\s*(\[\[?)\s*({_KEY}(?:\s*\.\s*{_KEY})*)\s*\]\]?\s*(?:#.*)?")
_ASSIGNMENT = re.compile(rf"\s*({_KEY}(?:\s*\.\s*{_KEY})*)\s*=(.*)")
_TOKEN = re.compile(r'"""|' + r"'''|" + r'"(?:\\.|[^"\\])*"|' + r"'[^']*'|#.*|[\[\]{}]")


def key_lines(text: str) -> dict[str, int]:
    """Line of every key and table of a valid TOML ``text``, by dotted key path with list positions from 0."""
    lines: dict[str, int] = {}
    counts: dict[str, int] = {}
    table, inside, depth = "", "", 0
    for number, line in enumerate(text.split("\n"), start=1):
        rest = line
        if not inside and depth == 0:
            header = _HEADER.fullmatch(line)
            if header:
                table = _dotted(header[2])
                lines.setdefault(table, number)
                if header[1] == "[[":
                    counts[table] = counts.get(table, -1) + 1
                    table = f"{table}.{counts[table]}"
                lines[table] = number
                continue
            key = _ASSIGNMENT.fullmatch(line)
            if key is None:
                continue
            lines[f"{table}.{_dotted(key[1])}".lstrip(".")] = number
            rest = key[2]
        inside, depth = _open_at_end(rest, inside, depth)
    return lines


def _open_at_end(line: str, inside: str, depth: int) -> tuple[str, int]:
    """Quotes of the string that is still open, and number of open brackets, after ``line``."""
    position = 0
    while True:
        if inside:
            end = line.find(inside, position)
            if end < 0:
                return inside, depth
            position, inside = end + 3, ""
        token = _TOKEN.search(line, position)
        if token is None:
            return "", depth
        position = token.end()
        if token[0] in ('"""', "'''"):
            inside = token[0]
        elif token[0] in "[{":
            depth += 1
        elif token[0] in "]}":
            depth = max(0, depth - 1)


def _dotted(key: str) -> str:
    return re.sub(r"\s*\.\s*", ".", key).replace('"', "").replace("'", "")
