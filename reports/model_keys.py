"""Pages of the keys that scene and engine files may hold, made from the models that check them."""

from __future__ import annotations

import inspect
import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

Row = tuple[str, str, str]
WORDS = {str: "text", float: "number", int: "whole number", bool: "true or false", type(None): "nothing"}


def tables_of(model: type[BaseModel], skip: tuple[str, ...] = ()) -> Iterator[tuple[str, str, list[Row]]]:
    """Heading, what it is, and rows (key, kind, default) of each table that a file of ``model`` may hold.

    Plain keys come first, without heading; ``skip`` names keys that no file states.
    """
    named = {kind for field in model.model_fields.values() for kind in _models(field.annotation)}
    plain = [
        _row(name, field)
        for name, field in model.model_fields.items()
        if name not in skip and not any(_models(field.annotation))
    ]
    yield "", _about(model), plain
    for name, field in model.model_fields.items():
        if name not in skip:
            yield from _parts(name, field, named)


def _parts(path: str, field: FieldInfo, named: set[type[BaseModel]]) -> Iterator[tuple[str, str, list[Row]]]:
    """Tables of a key, then those inside them that have no place of their own in ``named``."""
    for kind in _models(field.annotation):
        heading = f"[[{path}]]" if _is_list(field.annotation) else f"[{path}]"
        yield heading, _about(kind), [_row(key, inner) for key, inner in kind.model_fields.items()]
        for key, inner in kind.model_fields.items():
            if not named.intersection(_models(inner.annotation)):
                yield from _parts(f"{path}.{key}", inner, named)


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Every model that a value of ``annotation`` may be, or be a list of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation) if get_origin(annotation) is not dict else ():
        yield from _models(inner)


def _is_list(annotation: Any) -> bool:
    return get_origin(annotation) is tuple or any(_is_list(inner) for inner in get_args(annotation))


def _row(name: str, field: FieldInfo) -> Row:
    required = "required" if field.is_required() else ""
    default = field.get_default(call_default_factory=True)
    shown = required or ("" if default in (None, (), {}) or isinstance(default, BaseModel) else f"`{_toml(default)}`")
    return f"`{name}`", _kind(field.annotation) + _bounds(field.metadata), shown


def _kind(annotation: Any) -> str:
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(inner[0]) + _bounds(inner[1:])
    if origin is Literal:
        return ", ".join(f"`{_toml(value)}`" for value in inner)
    if origin in (Union, types.UnionType):
        kinds = [_kind(choice) for choice in inner if choice is not type(None)]
        return " or ".join(dict.fromkeys(kinds))
    if origin is tuple:
        return f"list of {_kind(inner[0])}"
    if origin is dict:
        return f"table of {_kind(inner[0])} = {_kind(inner[1])}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "tables"
    return WORDS.get(annotation, str(annotation))


def _bounds(metadata: Any) -> str:
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤", "min_length": "length ≥", "max_length": "length ≤"}
    flat = [part for item in metadata for part in (getattr(item, "metadata", None) or [item])]
    found = [f"{sign} {getattr(part, key):g}" for part in flat for key, sign in signs.items() if _has(part, key)]
    return f" {', '.join(found)}" if found else ""


def _has(part: Any, key: str) -> bool:
    return isinstance(getattr(part, key, None), int | float)


def _about(model: type[BaseModel]) -> str:
    return " ".join(inspect.cleandoc(model.__doc__ or "").replace("``", "`").split())


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(_toml(item) for item in value)}]"
    return f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else str(value)
