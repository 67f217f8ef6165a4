"""Files and functions stay short enough to be read at once, and the house does not grow."""

import ast
import subprocess
import sys
import tomllib

import pytest

from house.sizes import SIZES, TREES, as_text, code_lines, growth, measured, reasons_of, slack

MAX_FILE_LINES = 600
MAX_BODY_LINES = 60


def test_no_file_is_longer_than_600_lines(package_files):
    lengths = {str(source.path): len(source.text.splitlines()) for source in package_files}
    assert {path: length for path, length in lengths.items() if length > MAX_FILE_LINES} == {}


def test_no_function_body_is_longer_than_60_lines(package_files):
    offenders = {}
    for source in package_files:
        functions = [node for node in source.nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
        bodies = {function: range(function.body[0].lineno, function.end_lineno + 1) for function in functions}
        if max(map(len, bodies.values()), default=0) > MAX_BODY_LINES:  # only then lines of code must be told
            lines = code_lines(source.text, source.tree)
            lengths = {f"{source.path}: {one.name}": len(lines.intersection(body)) for one, body in bodies.items()}
            offenders |= {name: length for name, length in lengths.items() if length > MAX_BODY_LINES}
    assert offenders == {}


@pytest.mark.parametrize("name", TREES)
def test_lines_and_files_only_fall(name, project_root):
    limits = tomllib.loads(SIZES.read_text(encoding="utf-8"))[name]
    now = measured(project_root / TREES[name])
    off = growth(name, now, limits) + slack(name, now, limits)
    assert not off, "\n".join(off)


def test_no_code_lies_where_data_are_shipped(python_files):
    shipped = [source for source in python_files if source.path.parts[0] in ("pipeline", "data_schema")]
    assert not [str(source.path) for source in shipped if code_lines(source.text, source.tree)]


def test_lines_are_counted_after_formatting(project_root):
    command = [sys.executable, "-m", "ruff", "format", "--check", "--no-cache", "."]
    answer = subprocess.run(command, cwd=project_root, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stdout + answer.stderr


def test_a_line_of_code_is_no_comment_docstring_or_blank_line():
    text = '"""Doc."""\n\nX = 1  # a comment\n"""Of X."""\n\n\ndef f():\n    """Doc,\n    long."""\n'
    text += '    return """a\nb"""\n'
    assert code_lines(text, ast.parse(text)) == {3, 7, 10, 11}


def test_a_room_may_grow_by_what_others_fell_and_a_limit_far_above_is_to_be_lowered_with_its_reason_kept():
    limits = {"lines": 100, "files": 2, "rooms": {"a": [40, 1], "b": [60, 1]}}
    assert growth("src", {"a": [50, 1], "b": [50, 1]}, limits) == []
    grown = growth("src", {"a": [50, 1], "b": [51, 1]}, limits)
    assert grown == ["src: 101 lines, 1 more than 100", "  a: +10 lines, +0 files"]
    assert slack("src", {"a": [50, 2]}, limits) == []
    (line,) = slack("src", {"a": [49, 2]}, limits)
    assert line.startswith("src: 49 lines, 51 less than 100: run")
    assert len(slack("src", {"a": [100, 1]}, limits)) == 1
    reasons = {"src.lines": "  # a reader for another format"}
    text = as_text({"src": {"a": [3, 1]}}, reasons)
    assert reasons_of(text) == reasons
    assert tomllib.loads(text) == {"src": {"lines": 3, "files": 1, "rooms": {"a": [3, 1]}}}
