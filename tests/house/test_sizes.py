"""Files and functions stay short enough to be read at once."""

from __future__ import annotations

import ast
import io
import tokenize

MAX_FILE_LINES = 600
MAX_BODY_LINES = 40

SILENT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


def _code_lines(text: str) -> set[int]:
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return {line for token in tokens if token.type not in SILENT for line in range(token.start[0], token.end[0] + 1)}


def _body_lines(function: ast.FunctionDef | ast.AsyncFunctionDef, code_lines: set[int]) -> int:
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    if not body:
        return 0
    return len(code_lines.intersection(range(body[0].lineno, (function.end_lineno or 0) + 1)))


def test_no_file_is_longer_than_600_lines(package_files: list) -> None:
    lengths = {str(source.path): len(source.text.splitlines()) for source in package_files}
    offenders = [f"{path}: {length} lines" for path, length in lengths.items() if length > MAX_FILE_LINES]
    assert not offenders, "\n".join(offenders)


def test_no_function_body_is_longer_than_40_lines(package_files: list) -> None:
    offenders = []
    for source in package_files:
        code_lines = _code_lines(source.text)
        for node in ast.walk(source.tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                length = _body_lines(node, code_lines)
                if length > MAX_BODY_LINES:
                    offenders.append(f"{source.path}:{node.lineno}: {node.name}: {length} lines of code")
    assert not offenders, "\n".join(offenders)
