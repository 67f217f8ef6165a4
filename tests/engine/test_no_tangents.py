"""Angles are passed by sine and cosine: nothing in the engine room breaks where a crank or a rod stands level."""

import ast
from pathlib import Path

import pytest

import crankorder.engine

FILES = sorted(Path(crankorder.engine.__file__).parent.glob("*.py"))
ALLOWED = {("crankshaft.py", "half / math.tan(half)")}
"""The fan angle of a counterweight is a length of arc, not an angle of crank or rod."""


def name_of(node: ast.expr) -> str:
    """Last part of the name of a variable, an attribute or a called function."""
    if isinstance(node, ast.Call):
        return name_of(node.func)
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def factors(node: ast.expr) -> list[ast.expr]:
    """Factors of a divisor, powers by their base."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div):
        return factors(node.left) + factors(node.right)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        return factors(node.left)
    return [node]


def tangents(text: str) -> list[str]:
    """Divisions by sine, cosine or tangent of an angle, and tangents; cos ψ of the exact kinematics is a length."""
    nodes = list(ast.walk(ast.parse(text)))
    divisions = [node for node in nodes if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div)]
    by_angle = [
        node
        for node in divisions
        if {name_of(part) for part in factors(node.right)} & {"sin", "cos", "tan", "sine", "cosine"}
    ]
    divided = {id(part) for node in by_angle for part in factors(node.right)}
    alone = [
        node for node in nodes if isinstance(node, ast.Call) and name_of(node) == "tan" and id(node) not in divided
    ]
    return [ast.unparse(node) for node in [*by_angle, *alone]]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_no_tangent_and_no_division_by_sine_or_cosine(path: Path) -> None:
    found = [one for one in tangents(path.read_text(encoding="utf-8")) if (path.name, one) not in ALLOWED]
    assert not found, f"{path.name}: {found}"


@pytest.mark.parametrize(
    "text",
    [
        "y = np.tan(psi)",
        "y = x / np.cos(psi)",
        "y = x / np.sin(phi) ** 2",
        "y = x / (length * math.cos(psi))",
        "y = x / (motion.sine * length)",
        "y = x / length / cosine",
    ],
)
def test_a_tangent_is_found_however_it_is_written(text: str) -> None:
    assert len(tangents(text)) == 1
    assert not tangents("y = ratio * cosine / rod_cosine + arctan2(sine, cosine) / (2 * np.pi)")


def test_the_allowed_tangent_is_still_there() -> None:
    found = {(path.name, one) for path in FILES for one in tangents(path.read_text(encoding="utf-8"))}
    assert found == ALLOWED
