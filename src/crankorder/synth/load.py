"""Scenes from TOML files, with everything that is wrong with one listed at once."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from crankorder.engine.definition import load_engine
from crankorder.errors import CrankorderError, ManyErrors, RequestError
from crankorder.settings import shipped, toml_table, validation_fault
from crankorder.synth.demands import unmet_demands
from crankorder.synth.scene import Scene

OF_QUICK = {"sampling", "speeds", "speed_profile", "repeats"}
"""Keys of a scene of which a table [quick] states less."""
MAX_DEPTH = 4
"""Scenes that may be based on one another in a row."""
LEAST, MOST = 1e-30, 1e12
"""Size of a number other than 0: beyond these nothing is physical, and products leave the range of the numbers."""


def load_scene(name: str, beside: Path | None = None) -> Scene:
    """Scene from a shipped file of ``pipeline/scenes`` or a user's TOML file, its engine loaded and everything checked.

    A scene may name another with ``based_on``: it then has all of that scene's keys but those that it states itself and
    those that it lists as ``without``. Scenes and engines that a file names are tried beside that file first.

    ``name``: a shipped file's stem or the path of a TOML file. ``beside``: folder in which paths are tried first.
    Raises RequestError where there is no such file, ManyErrors with every fault: unknown effects and keys, values out
    of range, names that do not exist, speeds and orders that the sampling cannot carry.
    """
    faults: list[CrankorderError] = []
    table, source = _whole_table(name, beside, faults)
    if extremes := list(_extremes(table, source)):
        raise ManyErrors([*faults, *extremes])
    if "engine_file" in table:
        faults.append(RequestError("unknown key", file=source, place="engine_file", remedy="Name the engine as engine"))
    table["engine_file"] = table.get("engine", "")
    if "engine" not in table:
        known = f"{', '.join(shipped('engines'))}, or a path of a .toml file"
        faults.append(RequestError("the scene names no engine", file=source, place="engine", allowed=known))
    try:
        table["engine"] = "engine" in table and load_engine(str(table["engine_file"]), _folder_of(name, beside))
    except ManyErrors as errors:
        faults += errors.faults
    except RequestError as error:
        faults.append(error)
    kept: dict[str, list[int]] = {}
    scene = _validated(table, source, faults, kept)
    if scene is not None:
        faults += unmet_demands(scene, source, kept)
        told = {(fault.problem, fault.place) for fault in faults}
        quick = unmet_demands(scene.first_look(), source, kept)
        faults += [fault for fault in quick if (fault.problem, fault.place) not in told]
    if faults or scene is None:
        raise ManyErrors(faults)
    return scene


def _folder_of(name: str, beside: Path | None) -> Path | None:
    """Folder of the scene ``name``, in which what it names is tried first; ``beside`` where it is a shipped one."""
    return (beside or Path()).joinpath(name).parent if name.endswith(".toml") else beside


def _whole_table(
    name: str, beside: Path | None, faults: list[CrankorderError], derived: tuple[str, ...] = ()
) -> tuple[dict[str, Any], str]:
    """Table of a scene with what it takes from the scene that it is based on, and the file's name."""
    table, source = toml_table(name, "scenes", beside=beside)
    based_on, without = table.pop("based_on", None), table.pop("without", [])
    if based_on is None:
        if without:
            faults.append(RequestError("without goes with based_on", file=source, place="without", found=without))
        return table, source
    if not isinstance(based_on, str) or based_on in (*derived, name) or len(derived) >= MAX_DEPTH:
        allowed = f"the name of another scene, no circle, at most {MAX_DEPTH} deep"
        raise RequestError("no scene to be based on", file=source, place="based_on", found=based_on, allowed=allowed)
    base, _ = _whole_table(based_on, _folder_of(name, beside), faults, (*derived, name))
    left_out = [str(key) for key in without] if isinstance(without, list) else [str(without)]
    for key in left_out:
        if key not in base:
            known = ", ".join(key for key in base if key in Scene.model_fields)
            faults.append(RequestError("nothing to leave out", file=source, place="without", found=key, allowed=known))
    if table.keys() & OF_QUICK:
        left_out = [*left_out, "quick"]  # its differences are from what this scene no longer has
    return {key: value for key, value in base.items() if key not in left_out} | table, source


def _extremes(value: Any, source: str, place: str = "") -> Iterator[RequestError]:
    """A fault for each number in ``value`` that is too large or too small for any scene."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, inner in items:
            yield from _extremes(inner, source, f"{place}.{key}".lstrip("."))
        return
    number = isinstance(value, int) or (isinstance(value, float) and math.isfinite(value))
    if number and value and not LEAST <= abs(value) <= MOST and place != "seed":
        allowed = f"0, or {LEAST:g} … {MOST:g} either way"
        yield RequestError("out of all proportion", file=source, place=place, found=value, allowed=allowed)


def _validated(
    table: dict[str, Any], source: str, faults: list[CrankorderError], kept: dict[str, list[int]]
) -> Scene | None:
    """Scene of ``table``; what is wrong goes to ``faults`` and is left out, so that the rest can be checked too."""
    effects = ", ".join(key for key, field in Scene.model_fields.items() if not field.is_required())
    for _ in range(2):
        try:
            return Scene.model_validate(table)
        except ValidationError as error:
            found = [fault for fault in error.errors() if fault["loc"][:1] != ("engine",)]
            for fault in found:
                text = validation_fault(fault, source)
                if text.problem == "unknown key" and len(fault["loc"]) == 1:
                    text = RequestError("unknown effect", file=source, place=text.place, allowed=effects)
                faults.append(text)
            if len(found) < error.error_count() or not _without(table, [fault["loc"] for fault in found], kept):
                return None
    return None


def _without(table: dict[str, Any], places: list[tuple[int | str, ...]], kept: dict[str, list[int]]) -> bool:
    """Whether every effect (or item of a list) at ``places`` could be taken out; ``kept`` gets the items that stay."""
    items: dict[str, set[int]] = {}
    for place in places:
        head = str(place[0]) if place else ""
        field = Scene.model_fields.get(head)
        if not place or head in ("speeds", "speed_profile") or (field is not None and field.is_required()):
            return False
        if len(place) > 1 and isinstance(place[1], int):
            items.setdefault(head, set()).add(place[1])
        else:
            table.pop(head, None)
    for head, wrong in items.items():
        kept[head] = [k for k in range(len(table[head])) if k not in wrong]
        table[head] = [table[head][k] for k in kept[head]]
    return True
