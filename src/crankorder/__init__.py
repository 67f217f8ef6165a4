"""Order tracking and vibration analysis for reciprocating engines and other rotating machines.

``import crankorder as co`` is the front door of notebooks: recordings from arrays (``co.recording``) or files
(``co.read``), maps, tracks and findings of them, pictures (``co.plot``), and whole tests (``co.run``, ``co.open``,
``co.compare``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from crankorder import plot as plot
    from crankorder.front_door import (
        balance,
        campbell_map,
        compare,
        crank_angle,
        diagnose,
        envelope,
        export,
        open,
        order_map,
        order_tracks,
        read,
        recording,
        run,
        synthesise,
    )

    __version__: str

__all__ = [
    "balance",
    "campbell_map",
    "compare",
    "crank_angle",
    "diagnose",
    "envelope",
    "export",
    "open",
    "order_map",
    "order_tracks",
    "read",
    "recording",
    "run",
    "synthesise",
]
"""Loaded with what they need when one of them is touched: the import itself costs next to nothing."""


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("crankorder")
    if name == "plot":
        from importlib import import_module

        return import_module("crankorder.plot")
    if name not in __all__:
        raise AttributeError(f"module 'crankorder' has no attribute {name!r}; it has {', '.join([*__all__, 'plot'])}")
    from crankorder import front_door

    return getattr(front_door, name)


def __dir__() -> list[str]:
    return [*__all__, "__version__", "plot"]
