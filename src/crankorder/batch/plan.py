"""What a run will do: tests, their recordings, settings and output folders; every fault found before work starts."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from crankorder.errors import CrankorderError, ManyErrors, RequestError, printable
from crankorder.ingest.folder import recordings_of
from crankorder.ingest.manifest import Manifest, load_manifest
from crankorder.settings import Settings, load_settings

LONGEST_NAME = 80

BESIDE_MESH = 1.5
"""Orders above a stated mesh of teeth that are looked at with it: its first sidebands."""

HIGHEST_STATED = 200.0
"""A stated mesh above this order is looked at only where a recipe asks for orders so high."""


@dataclass(frozen=True)
class TestPlan:
    """One test: its folder, manifest, settings, recordings and where its results go."""

    __test__ = False

    name: str
    folder: Path
    manifest: Manifest
    settings: Settings
    recordings: list[Path]
    out: Path
    faults: list[CrankorderError] = field(default_factory=list)


def plan_tests(
    folders: list[Path],
    out: Path,
    *,
    manifest: Path | None = None,
    recipe: str | None = None,
    tolerance: float | None = None,
    max_memory_mb: int | None = None,
) -> list[TestPlan]:
    """Plans of the tests in ``folders``, whose results go below ``out``.

    ``manifest`` is a manifest that lives elsewhere than the data; ``recipe`` (name or path) goes before the recipe that
    the manifest names; ``tolerance`` (relative amplitude error) and ``max_memory_mb`` (megabytes of samples of one
    recording in memory) go before those of the recipe. Raises ManyErrors with the faults of all folders; nothing has
    been written then.
    """
    asked: dict[str, dict[str, Any]] = {
        "orders": {} if tolerance is None else {"tolerance": tolerance},
        "ingest": {} if max_memory_mb is None else {"in_memory_bytes": max_memory_mb * 1_000_000},
    }
    plans: list[TestPlan] = []
    faults: list[CrankorderError] = []
    taken = {"batch.json", "index.html"}
    for folder in folders:
        try:
            plans.append(_plan(folder, out, manifest, recipe, asked, taken))
        except ManyErrors as error:
            faults += error.faults
        except CrankorderError as error:
            faults.append(error)
    if len(faults) == 1:
        raise faults[0]
    if faults:
        raise ManyErrors(faults)
    return plans


def _plan(
    folder: Path,
    out: Path,
    manifest: Path | None,
    recipe: str | None,
    asked: dict[str, dict[str, Any]],
    taken: set[str],
) -> TestPlan:
    if not folder.is_dir():
        raise RequestError(
            "no such folder", file=folder, remedy="Give the folder that holds run.toml and the recordings"
        )
    stated = load_manifest(folder, manifest)
    chosen = recipe if recipe is not None else stated.test.recipe
    beside = manifest.parent if manifest is not None else folder
    settings = up_to_stated(load_settings(chosen, beside=beside if recipe is None else None, asked=asked), stated)
    found = recordings_of(folder, stated)
    name = folder_name(stated.test.name or folder.resolve().name, taken)
    _refuse_inside(folder, out / name)
    return TestPlan(
        name=stated.test.name or folder.resolve().name,
        folder=folder,
        manifest=stated,
        settings=settings,
        recordings=list(found.paths),
        out=out / name,
        faults=list(found.faults),
    )


def up_to_stated(settings: Settings, stated: Manifest) -> Settings:
    """``settings`` whose highest order holds the gears and the motor that ``stated`` names: what they excite is to be
    judged."""
    meshes = [gear.mesh_order for gear in stated.gears]
    if stated.motor is not None:
        meshes.append(stated.motor.highest_order)
    top = max((mesh + BESIDE_MESH for mesh in meshes if mesh <= HIGHEST_STATED), default=0.0)
    if top <= settings.orders.max_order:
        return settings
    return settings.model_copy(update={"orders": settings.orders.model_copy(update={"max_order": top})})


def _refuse_inside(folder: Path, out: Path) -> None:
    """Refuse results in the input folder, inside it or around it: inputs are never touched."""
    inside, outside = folder.resolve(), out.resolve()
    if outside == inside or inside in outside.parents or outside in inside.parents:
        raise RequestError(
            "the results would lie in the folder of the recordings, or around it",
            file=out,
            allowed="any folder outside the recordings",
            remedy="Choose another --out: recordings are never touched",
        )


def folder_name(name: str, taken: set[str]) -> str:
    """File name made of the letters, digits, ``-``, ``_``, ``.`` of ``name``, not yet in ``taken`` (which it joins)."""
    plain = unicodedata.normalize("NFKD", printable(name)).encode("ascii", "ignore").decode()
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", plain).strip("-.")[:LONGEST_NAME] or "test"
    unique, number = plain, 2
    while unique.lower() in taken:
        unique, number = f"{plain}-{number}", number + 1
    taken.add(unique.lower())
    return unique
