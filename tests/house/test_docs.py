"""What the documentation says is true of the program: keys, rooms, numbers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

import pytest
from pydantic import BaseModel, ValidationError

from crankorder.ingest.manifest import Manifest

NEVER_STATED = ("points",)
"""Keys of a manifest's models that the program fills in."""


def _models(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models(inner)


def _keys(model: type[BaseModel]) -> Iterator[tuple[type[BaseModel], str]]:
    """Every key that a file of ``model`` may state but tables of the manifest itself, with the model that has it."""
    for name, field in model.model_fields.items():
        inner = list(_models(field.annotation))
        if name not in NEVER_STATED and not (inner and model is Manifest):
            yield model, name
        for kind in inner:
            yield from _keys(kind)


KEYS = list(_keys(Manifest))


def test_the_keys_of_a_manifest_are_found() -> None:
    assert {model.__name__ for model, _ in KEYS} >= {"Manifest", "Test", "Channel", "Encoder", "Bearing", "PathMode"}


@pytest.mark.parametrize(("model", "name"), KEYS, ids=[f"{model.__name__}.{name}" for model, name in KEYS])
def test_each_key_of_a_manifest_has_a_meaning_and_an_example_that_is_valid(model: type[BaseModel], name: str) -> None:
    field = model.model_fields[name]
    assert (field.description or "").endswith("."), "say what it means: Field(description=…)"
    assert field.examples, "give an example: Field(examples=[…])"
    for example in field.examples:
        try:
            model.model_validate({name: example})
        except ValidationError as error:  # the other keys are missing
            faults = [fault["msg"] for fault in error.errors() if fault["loc"][:1] == (name,)]
            assert not faults, f"the example {example!r}: {faults[0]}"
