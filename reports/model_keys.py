"""Pages of the keys that scene and engine files may hold, made from the models that check them."""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

Row = tuple[str, ...]
Cells = Callable[[str, FieldInfo], Row]
WORDS = {str: "text", float: "number", int: "whole number", bool: "true or false", type(None): "nothing"}


def cells_of(name: str, field: FieldInfo) -> Row:
    """Key, kind of its values, and default of the ``field`` called ``name``."""
    return f"`{name}`", kind_of(field), default_of(field)


def tables_of(
    model: type[BaseModel], skip: tuple[str, ...] = (), cells: Cells = cells_of
) -> Iterator[tuple[str, str, list[Row]]]:
    """Heading, what it is, and rows of ``cells`` of each table that a file of ``model`` may hold.

    Plain keys come first, without heading; ``skip`` names keys that no file states.
    """
    named = {kind for field in model.model_fields.values() for kind in _models(field.annotation)}
    plain = [
        cells(name, field)
        for name, field in model.model_fields.items()
        if name not in skip and not any(_models(field.annotation))
    ]
    yield "", _about(model), plain
    for name, field in model.model_fields.items():
        if name not in skip:
            yield from _parts(name, field, named, skip, cells)


def _parts(
    path: str, field: FieldInfo, named: set[type[BaseModel]], skip: tuple[str, ...], cells: Cells
) -> Iterator[tuple[str, str, list[Row]]]:
    """Tables of a key, then those inside them that have no place of their own in ``named``."""
    for kind in _models(field.annotation):
        heading = f"[[{path}]]" if _is_list(field.annotation) else f"[{path}]"
        yield heading, _about(kind), [cells(key, inner) for key, inner in kind.model_fields.items() if key not in skip]
        for key, inner in kind.model_fields.items():
            if not named.intersection(_models(inner.annotation)):
                yield from _parts(f"{path}.{key}", inner, named, skip, cells)


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Every model that a value of ``annotation`` may be, or be a list of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation) if get_origin(annotation) is not dict else ():
        yield from _models(inner)


def _is_list(annotation: Any) -> bool:
    return get_origin(annotation) is tuple or any(_is_list(inner) for inner in get_args(annotation))


def kind_of(field: FieldInfo) -> str:
    """What values ``field`` takes, and between which bounds."""
    return _kind(field.annotation) + _bounds(field.metadata)


def default_of(field: FieldInfo) -> str:
    """Default of ``field`` as a file would state it, "required" where there is none, "" where it is left out."""
    default = field.get_default(call_default_factory=True)
    if field.is_required():
        return "required"
    return "" if default in (None, (), {}, "") or isinstance(default, BaseModel) else f"`{toml_of(default)}`"


def _kind(annotation: Any) -> str:
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(inner[0]) + _bounds(inner[1:])
    if origin is Literal:
        return ", ".join(f"`{toml_of(value)}`" for value in inner)
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


def toml_of(value: Any) -> str:
    """``value`` as a TOML file states it, in one line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple | list):
        return f"[{', '.join(toml_of(item) for item in value)}]"
    if isinstance(value, dict):
        keys = [key if key.replace("_", "").isalnum() else f'"{key}"' for key in value]
        return f"{{ {', '.join(f'{key} = {toml_of(item)}' for key, item in zip(keys, value.values(), strict=True))} }}"
    return f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else str(value)
