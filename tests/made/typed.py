"""Findings and their records from dicts that hold no more than what a test is about."""

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from types import SimpleNamespace
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from crankorder.findings import Findings
from crankorder.records import Record

R = TypeVar("R", bound=Record)

_EMPTY: dict[Any, Any] = {str: "", float: 0.0, int: 0, bool: False}


def record_of(kind: type[R], document: Mapping[str, Any]) -> R:
    """A record of that ``kind`` with what ``document`` holds; the rest is empty, and nothing is refused."""
    hints, given = get_type_hints(kind), {}
    for one in fields(kind):  # type: ignore[arg-type]
        key = one.metadata["key"] or one.name
        if key in document and (document[key] is not None or type(None) in get_args(hints[one.name])):
            given[one.name] = _value(hints[one.name], document[key])
        elif one.default is MISSING:
            given[one.name] = _empty(hints[one.name])
    return kind(**given)


def findings_of(document: Mapping[str, Any]) -> Findings:
    """Findings with what ``document`` holds."""
    return record_of(Findings, document)


def _value(hint: Any, value: Any) -> Any:
    if value is None:
        return None
    for kind in (hint, *get_args(hint)):
        if isinstance(kind, type) and issubclass(kind, Record):
            return record_of(kind, value)
        if get_origin(kind) is tuple and isinstance(value, list | tuple):
            return tuple(_value(get_args(kind)[0], item) for item in value)
    return value


def _empty(hint: Any) -> Any:
    if type(None) in get_args(hint):
        return None
    if get_origin(hint) is tuple:
        return () if get_args(hint)[-1] is ... else (None, None)
    return _EMPTY.get(hint, "")


def from_dicts(function: Callable[..., Any]) -> Callable[..., Any]:
    """``function``, which takes dicts in place of findings and their records."""
    hints = get_type_hints(function)
    signature = inspect.signature(function)

    @functools.wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        bound = signature.bind(*args, **kwargs)
        for name, value in bound.arguments.items():
            if isinstance(value, dict):
                kinds = (hints.get(name), *get_args(hints.get(name)))
                kind = next((one for one in kinds if isinstance(one, type) and issubclass(one, Record)), None)
                if kind is not None:
                    bound.arguments[name] = record_of(kind, value)
                elif get_origin(kinds[0]) not in (dict, Mapping):
                    values = {key: tuple(part) if isinstance(part, list) else part for key, part in value.items()}
                    bound.arguments[name] = SimpleNamespace(**values)
        return function(*bound.args, **bound.kwargs)

    return called


def as_dicts(function: Callable[..., Any]) -> Callable[..., Any]:
    """``function`` whose findings and records come as the dicts that JSON has."""

    @functools.wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        return _dicts(function(*args, **kwargs))

    return called


def _dicts(made: Any) -> Any:
    if isinstance(made, Record):
        return made.as_dict()
    if isinstance(made, tuple | list):
        return [_dicts(one) for one in made]
    return made
