"""The plan of a flow: which stages make the wanted nouns, worked out from their signatures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, get_type_hints

from crankorder.errors import SchemaError
from crankorder.scratch import give_back


class StagePlan:
    """The stages, in flow order, that make the wanted nouns; worked out from signatures, run for many recordings.

    ``needs`` are the given nouns that the plan takes: what no wanted noun needs is neither asked for nor run.
    """

    def __init__(self, stages: Iterable[Callable[..., Any]], *, wanted: Iterable[Any], given: Iterable[Any]) -> None:
        """Plan the ``stages`` (their return types are what they make) that lead from ``given`` nouns to ``wanted``.

        Raises SchemaError, naming the way to it, where a noun is neither given nor made by a stage: a fault of the
        program.
        """
        self._makers = {get_type_hints(made)["return"]: made for made in stages}
        self._given = frozenset(given)
        self.wanted = tuple(wanted)
        self.steps: list[tuple[Callable[..., Any], dict[str, object], object]] = []
        self.needs: set[Any] = set()
        for noun in self.wanted:
            self._require(noun, ())
        self._last_use = {noun: number for number, (_, takes, _) in enumerate(self.steps) for noun in takes.values()}

    def _require(self, noun: Any, way: tuple[str, ...]) -> None:
        if noun in self._given:
            self.needs.add(noun)
            return
        if any(made == noun for _, _, made in self.steps):
            return
        if noun not in self._makers or noun.__name__ in way:
            raise SchemaError(f"no stage makes {noun.__name__}", place=" <- ".join(reversed(way)))
        maker = self._makers[noun]
        takes = {name: kind for name, kind in get_type_hints(maker).items() if name != "return"}
        for kind in takes.values():
            self._require(kind, (*way, noun.__name__))
        self.steps.append((maker, takes, noun))

    def run(self, given: Mapping[Any, Any]) -> dict[Any, Any]:
        """The wanted nouns made from the values ``given`` by noun; each other is let go after its last use.

        What a stage raises comes out as it is, with the stage's name as a note.
        """
        held = {noun: given[noun] for noun in self.needs}
        for number, (maker, takes, noun) in enumerate(self.steps):
            try:
                held[noun] = maker(**{name: held[kind] for name, kind in takes.items()})
            except Exception as error:
                error.add_note(f"in the stage {maker.__name__}")
                raise
            for kind in set(takes.values()):
                if self._last_use[kind] == number and kind not in self.wanted:
                    del held[kind]
            give_back()
        return {noun: held[noun] for noun in self.wanted}
