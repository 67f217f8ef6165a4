"""The tests whose results are frozen: every shipped scene in its short version, and the real recordings."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared" / "data"
MANIFESTS = ROOT / "tests" / "real"

DEFAULT = "default"
"""A run without ``--recipe``: what the manifest asks for."""


@dataclass(frozen=True)
class Case:
    """One frozen run: a shipped ``scene`` or a real ``folder`` with its ``manifest``, by a ``recipe``."""

    name: str
    scene: str = ""
    folder: str = ""
    manifest: str = ""
    recipe: str = DEFAULT

    @property
    def is_real(self) -> bool:
        """Whether it reads measured recordings, which may be absent."""
        return bool(self.folder)


@dataclass(frozen=True)
class _Scene:
    name: str
    recipes: tuple[str, ...] = field(default=(DEFAULT,))


SCENES = (
    _Scene("bearing-growth"),
    _Scene("hard-acquisition"),
    _Scene("hard-close-modes"),
    _Scene("hard-close-orders"),
    _Scene("hard-damaged-line"),
    _Scene("hard-eccentric-encoder", (DEFAULT, "calibrated-encoder")),
    _Scene("hard-fast-sweep", (DEFAULT, "maps")),
    _Scene("hard-faulty-signals"),
    _Scene("hard-folding"),
    _Scene("hard-kick-back"),
    _Scene("hard-two-revolutions", (DEFAULT, "cylinder-pressure")),
    _Scene("hard-wrong-labels"),
    _Scene("one-pulse-per-rev"),
    _Scene("run-up", (DEFAULT, "order-levels")),
    _Scene("thesis-first-motoring"),
    _Scene("thesis-literal-fourfold"),
    _Scene("thesis-second-compared"),
    _Scene("thesis-second-firing", (DEFAULT, "waveforms")),
    _Scene("thesis-second-motoring", (DEFAULT, "maps", "maps-full-band", "bearing-envelope", "waveforms")),
    _Scene("two-shafts"),
)

REAL = {
    "ansys_accel": "ansys_accel",
    "auth_360ppr": "auth_360ppr",
    "beam": "beam_dropbear4",
    "cwru": "cwru_12k_de_1750",
    "gear0": "gear0",
    "hammer": "modal_vtb",
    "mfpt": "mfpt_vload",
    "oma_tower": "oma_tower",
    "rotor_groups": "rotorbalancer",
    "rotorbalancer": "rotorbalancer",
    "tue_genset": "tue_genset",
}
"""Folder of the shared recordings that each manifest of ``tests/real`` describes."""

QUICK = ("hard-two-revolutions", "hard-wrong-labels", "hard-fast-sweep.maps")
"""Cases of the default test run; all others are slow."""


def name_of(source: str, recipe: str) -> str:
    """Name of the case that analyses ``source`` by ``recipe``, as its summary's file bears it."""
    return source if recipe == DEFAULT else f"{source}.{recipe}"


def all_cases() -> list[Case]:
    """Every case: scenes first, then real recordings, each by name."""
    made = [Case(name_of(one.name, recipe), scene=one.name, recipe=recipe) for one in SCENES for recipe in one.recipes]
    return made + [Case(f"real-{name}", folder=folder, manifest=f"{name}.toml") for name, folder in REAL.items()]
