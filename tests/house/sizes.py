"""Lines of code by room, and the sizes that only fall: ``python tests/house/sizes.py`` writes smaller ones."""

import argparse
import ast
import io
import re
import sys
import tokenize
import tomllib
from pathlib import Path

SIZES = Path(__file__).with_name("sizes.toml")
PROJECT = Path(__file__).resolve().parents[2]
TREES = {"src": Path("src"), "tests": Path("tests")}
PACKAGE = "crankorder"
KINDS = ("lines", "files")

SLACK_LINES = 50
"""Lines by which a tree may be smaller than its limit before the limit must be written anew."""

HEAD = """\
# Lines of code (no blank lines, comments or docstrings, after `ruff format`) and files, in all and by room.
# The totals only fall: `python tests/house/sizes.py` writes smaller ones. A room may grow by what others fell.
# Where more is needed a total is raised by hand, with the reason as a comment behind it.
"""

SILENT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING,
    tokenize.ENDMARKER,
}  # fmt: skip


def code_lines(text: str, tree: ast.Module) -> set[int]:
    """Numbers of the lines of a module that hold a token of code.

    Blank lines, comments, docstrings and the strings that stand below a constant to describe it hold none.

    Parameters
    ----------
    text
        Source of the module.
    tree
        Its syntax tree.
    """
    described, quoted = set[int](), set[int]()
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for statement in body if isinstance(body, list) else ():
            value = statement.value if isinstance(statement, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                described.update(_lines_of(statement))
        if isinstance(node, ast.Constant | ast.JoinedStr) and node.end_lineno != node.lineno:
            quoted.update(_lines_of(node))
    stripped = [line.strip() for line in text.splitlines()]
    held = {number for number, line in enumerate(stripped, 1) if line and not line.startswith("#")}
    if quoted - described - held:
        # a line within a text, or between two parts of one: only the tokens tell, at ten times the cost
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        spans = [range(token.start[0], token.end[0] + 1) for token in tokens if token.type not in SILENT]
        held = {number for span in spans for number in span}
    return held - described


def _lines_of(node: ast.stmt | ast.expr) -> range:
    return range(node.lineno, (node.end_lineno or node.lineno) + 1)


def measured(folder: Path) -> dict[str, list[int]]:
    """Lines of code and files by room: the folders of ``folder`` or of its package; ``root`` are files in none."""
    rooms: dict[str, list[int]] = {}
    for path in folder.rglob("*.py"):
        parts = path.relative_to(folder).parts
        parts = parts[1:] if parts[0] == PACKAGE else parts
        text = path.read_text(encoding="utf-8")
        size = rooms.setdefault(parts[0] if len(parts) > 1 else "root", [0, 0])
        size[0] += len(code_lines(text, ast.parse(text)))
        size[1] += 1
    return rooms


def totals(rooms: dict[str, list[int]]) -> dict[str, int]:
    """Lines and files of all ``rooms``."""
    return dict(zip(KINDS, map(sum, zip(*rooms.values(), strict=True)), strict=True))


def growth(name: str, rooms: dict[str, list[int]], limits: dict) -> list[str]:
    """What of the tree ``name`` is larger than its committed ``limits`` allow, with the rooms that grew."""
    told = [
        f"{name}: {count} {kind}, {count - limits[kind]} more than {limits[kind]}"
        for kind, count in totals(rooms).items()
        if count > limits[kind]
    ]
    before = limits["rooms"]
    more = {room: [size[k] - before.get(room, (0, 0))[k] for k in (0, 1)] for room, size in sorted(rooms.items())}
    return told and told + [f"  {room}: {n:+d} lines, {m:+d} files" for room, (n, m) in more.items() if max(n, m) > 0]


def slack(name: str, rooms: dict[str, list[int]], limits: dict) -> list[str]:
    """What of the tree ``name`` is so much smaller than its committed ``limits`` that they no longer hold it."""
    return [
        f"{name}: {count} {kind}, {limits[kind] - count} less than {limits[kind]}: run `python tests/house/sizes.py`"
        for kind, count in totals(rooms).items()
        if count < limits[kind] - (SLACK_LINES if kind == "lines" else 0)
    ]


def as_text(sizes: dict[str, dict[str, list[int]]], reasons: dict[str, str]) -> str:
    """The text of ``sizes.toml`` for ``sizes``, by tree; ``reasons`` are the comments to keep, by what they follow."""
    parts = [HEAD]
    for name, rooms in sizes.items():
        rows = [f"{kind} = {count}" + reasons.get(f"{name}.{kind}", "") for kind, count in totals(rooms).items()]
        listed = [f"{room} = {size}" for room, size in sorted(rooms.items())]
        parts.append("\n".join([f"[{name}]", *rows, "", f"[{name}.rooms] # lines, files", *listed, ""]))
    return "\n".join(parts)


def reasons_of(text: str) -> dict[str, str]:
    """The comments behind the totals of a ``sizes.toml``, by ``tree.kind``."""
    reasons, tree = {}, ""
    for line in text.splitlines():
        if head := re.match(r"\[(\w+)\]", line):
            tree = head[1]
        elif total := re.match(r"(lines|files) = [0-9]+( *#.*)", line):
            reasons[f"{tree}.{total[1]}"] = total[2]
    return reasons


def main() -> int:
    """Write the sizes as they are where none has grown; else say what grew, and return 1."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    text = SIZES.read_text(encoding="utf-8")
    limits, now = tomllib.loads(text), {name: measured(PROJECT / folder) for name, folder in TREES.items()}
    grown = [line for name, rooms in now.items() for line in growth(name, rooms, limits[name])]
    if grown:
        print("not written, for sizes only fall:", *grown, sep="\n", file=sys.stderr)
        return 1
    SIZES.write_text(as_text(now, reasons_of(text)), encoding="utf-8")
    print(*(f"{name}: {totals(rooms)}" for name, rooms in now.items()), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
