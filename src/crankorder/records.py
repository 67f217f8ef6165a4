"""Frozen records that say what each field is: JSON in and out, and the JSON Schema that their types give."""

from __future__ import annotations

import types
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cache
from math import isfinite
from operator import ge, gt, le, lt
from typing import Any, ClassVar, Literal, Self, Union, dataclass_transform, get_args, get_origin, get_type_hints

from crankorder.errors import InputError

Json = str | float | bool | None | Sequence["Json"] | Mapping[str, "Json"]
"""A value of JSON as it is written."""

Document = dict[str, Any]
"""A JSON object, at the edge of the program alone."""

Interval = tuple[float | None, float | None]
"""95 % interval: low and high end; an end that is None is not known or has no bound."""

Ends = tuple[float, float]
"""Low and high end, both known."""


def known(interval: Interval | None) -> Ends | None:
    """``interval`` where both of its ends are known, as finite numbers, else None."""
    low, high = interval or (None, None)
    return None if low is None or high is None or not isfinite(low) or not isfinite(high) else (low, high)


def finite(number: float) -> float | None:
    """``number``, in its unit, where it is finite, else None."""
    return float(number) if isfinite(number) else None


_LIMITS: dict[str, tuple[str, Callable[[Any, Any], bool]]] = {
    "minimum": ("≥", ge), "maximum": ("≤", le), "exclusiveMinimum": (">", gt), "exclusiveMaximum": ("<", lt),
}  # fmt: skip
_PLAIN: dict[object, tuple[str, str]] = {
    float: ("number", "a number"),
    int: ("integer", "a whole number"),
    str: ("string", "a text"),
    bool: ("boolean", "true or false"),
}
"""Type of JSON, and what an error calls it."""


ABSENT: Any = object()
"""Default of a field that is None unless it is given, and that JSON then does not name."""


def said(
    text: str = "",
    *,
    default: Any = MISSING,
    key: str = "",
    least: float | None = None,
    above: float | None = None,
    most: float | None = None,
    below: float | None = None,
) -> Any:
    """A field of a record, with what it is in words: ``text``; empty for a 95 % interval, which its name tells.

    Without ``default`` the field must be given, and its key must stand in JSON; a field whose default is ``ABSENT`` has
    no key where it is None. ``key`` is its name there, where that is another. A number is ``least`` (≥), ``above`` (>),
    ``most`` (≤) or ``below`` (<).
    """
    bounds = {"minimum": least, "maximum": most, "exclusiveMinimum": above, "exclusiveMaximum": below}
    limits = {name: bound for name, bound in bounds.items() if bound is not None}
    metadata = {"text": text, "key": key, "absent": default is ABSENT, "limits": limits}
    return field(default=None if default is ABSENT else default, metadata=metadata)


@dataclass(frozen=True)
class Column:
    """A field of records as a column of a table: its ``key``, what it is in words, and the ``kind`` of its values."""

    key: str
    text: str
    kind: Literal["bool", "number", "interval", "text"]


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(said,))
class Record:
    """Base of the records: frozen dataclasses whose fields are made by :func:`said`, and their way from and to JSON."""

    ALSO: ClassVar[Document] = {}
    """What their schema holds beside the fields."""

    def __init_subclass__(cls) -> None:
        """Make every subclass a frozen dataclass."""
        dataclass(frozen=True, kw_only=True)(cls)

    def omitted(self) -> Collection[str]:
        """Fields whose keys do not stand in JSON, beside those that are left out where they are None."""
        return ()

    @classmethod
    def _said(cls) -> tuple[Field[Any], ...]:
        kind: Any = cls
        return fields(kind)

    @classmethod
    @cache
    def _types(cls) -> dict[str, object]:
        return get_type_hints(cls)

    def as_dict(self) -> Document:
        """The record as JSON has it: a dict of numbers, texts, lists and dicts."""
        omitted = self.omitted()
        document: Document = {}
        for entry in self._said():
            value = getattr(self, entry.name)
            if entry.name not in omitted and not (value is None and entry.metadata["absent"]):
                document[_key(entry)] = _as_json(value)
        return document

    @classmethod
    def from_dict(cls, document: object, *, file: object = "", place: str = "") -> Self:
        """The record that ``document``, a JSON object, holds; keys that it does not know are passed over.

        Raises InputError that names ``file``, the place from ``place`` on, the value found and what is allowed.
        """
        if not isinstance(document, Mapping):
            raise InputError("this is no record", file=file, place=place, found=document, allowed="an object")
        given: dict[str, object] = {}
        for one in cls._said():
            there = f"{place}.{_key(one)}" if place else _key(one)
            if _key(one) in document:
                given[one.name] = _read(cls._types()[one.name], document[_key(one)], one, file=file, place=there)
            elif one.default is MISSING:
                raise InputError("is missing", file=file, place=there, allowed=one.metadata["text"])
        return cls(**given)

    @classmethod
    def tables(cls) -> dict[str, type[Record]]:
        """Fields that hold any number of records, with the type of these."""
        records = {}
        for name, kind in cls._types().items():
            inner, _ = _without_none(kind)
            each = get_args(inner) if get_origin(inner) is tuple else ()
            if each and isinstance(each[0], type) and issubclass(each[0], Record):
                records[name] = each[0]
        return records

    @classmethod
    def columns(cls) -> dict[str, Column]:
        """The fields as columns of a table of such records, by key; lists are text."""
        return {_key(one): Column(_key(one), _text(one), _kind(cls._types()[one.name])) for one in cls._said()}

    @classmethod
    def json_schema(cls) -> Document:
        """The JSON Schema of such a record."""
        named = {_key(entry): _schema(cls._types()[entry.name], entry) for entry in cls._said()}
        required = [_key(entry) for entry in cls._said() if entry.default is MISSING]
        return {"type": "object", "properties": named, "required": required, **cls.ALSO}


def _key(one: Field[Any]) -> str:
    return one.metadata["key"] or one.name


def _as_json(value: object) -> Any:
    if isinstance(value, Record):
        return value.as_dict()
    if isinstance(value, tuple):
        return [_as_json(part) for part in value]
    return dict(value) if isinstance(value, Mapping) else value


def _text(one: Field[Any]) -> str:
    return one.metadata["text"] or f"95 % interval of {one.name.removesuffix('_ci95')}: low, high"


def _kind(kind: Any) -> Literal["bool", "number", "interval", "text"]:
    inner, _ = _without_none(kind)
    if inner is bool:
        return "bool"
    if inner in (int, float):
        return "number"
    return "interval" if inner in (Interval, Ends) else "text"


def _without_none(kind: Any) -> tuple[Any, bool]:
    """``kind`` without None, and whether it may be None."""
    if get_origin(kind) not in (Union, types.UnionType):
        return kind, False
    kinds = [one for one in get_args(kind) if one is not type(None)]
    return kinds[0], len(kinds) < len(get_args(kind))


def _read(kind: Any, value: object, one: Field[Any], *, file: object, place: str) -> object:
    """``value`` of JSON as the type ``kind`` of the field ``one`` has it."""
    inner, optional = _without_none(kind)
    if value is None and optional:
        return None
    if isinstance(inner, type) and issubclass(inner, Record):
        return inner.from_dict(value, file=file, place=place)
    if get_origin(inner) is tuple and isinstance(value, list | tuple):
        each = get_args(inner)
        each = each[:1] * len(value) if each[-1] is ... else each
        if len(each) == len(value):
            parts = enumerate(zip(each, value, strict=True))
            return tuple(_read(part, item, one, file=file, place=f"{place}[{at}]") for at, (part, item) in parts)
    if get_origin(inner) is dict and isinstance(value, Mapping) and all(isinstance(v, str) for v in value.values()):
        return dict(value)
    if get_origin(inner) is Literal and value in get_args(inner):
        return value
    limits = one.metadata["limits"].items()
    if inner in _PLAIN and _is_plain(inner, value) and all(_LIMITS[name][1](value, bound) for name, bound in limits):
        return inner(value)
    allowed = _allowed(inner, one) + " or null" * optional
    problem = f"is not {one.metadata['text']}" if one.metadata["text"] else "is no interval"
    raise InputError(problem, file=file, place=place, found=value, allowed=allowed)


def _is_plain(kind: type, value: object) -> bool:
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if kind is int and isinstance(value, float):
        return value.is_integer()
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))


def _allowed(kind: Any, one: Field[Any]) -> str:
    """What a field ``one`` of the type ``kind`` allows, in words."""
    if get_origin(kind) is Literal:
        return ", ".join(str(value) for value in get_args(kind))
    if get_origin(kind) is tuple:
        each = get_args(kind)
        return "a list" if each[-1] is ... else f"a list of {len(each)}"
    if kind not in _PLAIN:
        return "an object of texts"
    limits = [f"{_LIMITS[name][0]} {bound:g}" for name, bound in one.metadata["limits"].items()]
    return " ".join([_PLAIN[kind][1], *limits])


def _schema(kind: Any, one: Field[Any]) -> Document:
    """Schema of the field ``one`` of the type ``kind``."""
    inner, optional = _without_none(kind)
    made = _schema_of_type(inner) | one.metadata["limits"]
    if optional and not one.metadata["absent"]:
        made |= {"enum": [*made["enum"], None]} if "enum" in made else {"type": [made["type"], "null"]}
    return {"description": _text(one), **made}


def _schema_of_type(kind: Any) -> Document:
    inner, optional = _without_none(kind)
    if optional:
        made = _schema_of_type(inner)
        return made | {"type": [made["type"], "null"]}
    if kind in _PLAIN:
        return {"type": _PLAIN[kind][0]}
    if get_origin(kind) is Literal:
        return {"enum": list(get_args(kind))}
    if get_origin(kind) is tuple:
        each = get_args(kind)
        ends = {} if each[-1] is ... else {"minItems": len(each), "maxItems": len(each)}
        return {"type": "array", "items": _schema_of_type(each[0]), **ends}
    if get_origin(kind) is dict:
        return {"type": "object", "additionalProperties": {"type": "string"}}
    return dict(kind.json_schema())
