"""Lines of code by room, and the sizes that only fall: ``python tests/house/sizes.py`` writes smaller ones."""

import argparse
import ast
import io
import re
import sys
import tokenize
import tomllib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

SIZES = Path(__file__).with_name("sizes.toml")
PROJECT = Path(__file__).resolve().parents[2]
TREES = {"src": Path("src"), "tests": Path("tests")}
PACKAGE = "crankorder"

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


@dataclass
class Sizes:
    """Lines of code and files of one tree, by room."""

    lines: Counter[str] = field(default_factory=Counter)
    files: Counter[str] = field(default_factory=Counter)

    @property
    def totals(self) -> dict[str, int]:
        """Lines and files of all rooms."""
        return {"lines": self.lines.total(), "files": self.files.total()}


def measured(folder: Path) -> Sizes:
    """Sizes of the rooms of a folder: its own folders, or those of the package; files in none are the room ``root``.

    Parameters
    ----------
    folder
        The folder.
    """
    sizes = Sizes()
    for path in folder.rglob("*.py"):
        parts = path.relative_to(folder).parts
        parts = parts[1:] if parts[0] == PACKAGE else parts
        room = parts[0] if len(parts) > 1 else "root"
        text = path.read_text(encoding="utf-8")
        sizes.lines[room] += len(code_lines(text, ast.parse(text)))
        sizes.files[room] += 1
    return sizes


def growth(name: str, now: Sizes, limits: dict) -> list[str]:
    """What of the tree ``name`` is larger than its committed ``limits`` allow, with the rooms that grew."""
    grown = [
        f"{name}: {count} {kind}, {count - limits[kind]} more than {limits[kind]}"
        for kind, count in now.totals.items()
        if count > limits[kind]
    ]
    before = {room: dict(zip(("lines", "files"), sizes, strict=True)) for room, sizes in limits["rooms"].items()}
    rooms = [
        f"  {room}: {count:+d} {kind}"
        for kind in ("lines", "files")
        for room in sorted(now.lines)
        if (count := getattr(now, kind)[room] - before.get(room, {}).get(kind, 0)) > 0
    ]
    return grown and [*grown, *rooms]


def slack(name: str, now: Sizes, limits: dict) -> list[str]:
    """What of the tree ``name`` is so much smaller than its committed ``limits`` that they no longer hold it."""
    return [
        f"{name}: {count} {kind}, {limits[kind] - count} less than {limits[kind]}: run `python tests/house/sizes.py`"
        for kind, count in now.totals.items()
        if count < limits[kind] - (SLACK_LINES if kind == "lines" else 0)
    ]


def as_text(sizes: dict[str, Sizes], reasons: dict[str, str]) -> str:
    """The text of ``sizes.toml`` for ``sizes``, by tree; ``reasons`` are the comments to keep, by what they follow."""
    parts = [HEAD]
    for name, size in sizes.items():
        rows = [f"{kind} = {count}" for kind, count in size.totals.items()]
        rows = [row + reasons.get(f"{name}.{row.partition(' ')[0]}", "") for row in rows]
        rooms = [f"{room} = [{size.lines[room]}, {size.files[room]}]" for room in sorted(size.lines)]
        parts.append("\n".join([f"[{name}]", *rows, "", f"[{name}.rooms] # lines, files", *rooms, ""]))
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
    grown = [line for name, sizes in now.items() for line in growth(name, sizes, limits[name])]
    if grown:
        print("not written, for sizes only fall:", *grown, sep="\n", file=sys.stderr)
        return 1
    SIZES.write_text(as_text(now, reasons_of(text)), encoding="utf-8")
    print(
        *(f"{name}: {sizes.totals['lines']} lines in {sizes.totals['files']} files" for name, sizes in now.items()),
        sep="\n",
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
