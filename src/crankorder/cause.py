"""What makes a line: kinds of causes, the parameters of each, and the words that findings say it by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:  # loads xarray, which sentences need not wait for
    from crankorder.quantities import Floats

CauseKind = Literal[
    "unexplained", "unbalance", "unbalance, bent shaft or misalignment", "gas cycle", "engine kinematics",
    "half order of the four-stroke cycle", "shaft harmonic", "gear mesh", "gear mesh or blade passing", "bearing",
    "part of a shaft", "sideband", "sideband by a swing of the angle", "fold",
    "another shaft", "stated shaft", "mains", "motor", "field of a motor", "order", "tone", "another tone",
    "a line of its own", "a natural frequency", "mode", "whirl", "undecided",
]  # fmt: skip
"""What may make a line: its words, or what these are made from together with its parameters."""

DoubtKind = Literal[
    "unresolved", "swells", "close lines", "one speed", "seldom seen", "followed only", "few speeds", "in a sweep",
    "no pulses", "angle in error", "speed in doubt", "slower than unbalance", "unclear growth",
]  # fmt: skip
"""What speaks against a line, or keeps its cause from being told."""

_WORDS: dict[CauseKind, str] = {
    "gear mesh": "gear mesh {names}",
    "bearing": "bearing {names}",
    "part of a shaft": "{names} part of that shaft",
    "gear mesh or blade passing": "shaft harmonic or gear mesh or blade passing",
    "fold": "fold of {frequency_hz:.6g} Hz",
    "sideband": "sideband of {of}{carrier:.4g}{unit} spaced by {spacing:.4g}{unit}",
    "another shaft": "{harmonic}a second shaft at {ratio:.4g}",
    "stated shaft": "{harmonic}a shaft at {ratio:.4g} times the stated speed, this one if that is wrong",
    "mains": "{name}",
    "field of a motor": "{name}",
    "motor": "{name}",
    "order": "{name}",
}
"""Words of the kinds that have parameters; the others are their own words."""

_UNKNOWN: tuple[str, ...] = ("unexplained", "tone", "undecided", "sideband by a swing of the angle")
ELECTRIC: tuple[str, ...] = ("mains", "field of a motor")


def electric(kinds: Sequence[str]) -> bool:
    """Whether causes of these ``kinds``, the likeliest first, are the mains or the field of a motor, and no order."""
    return kinds[0] in ELECTRIC and "order" not in kinds


class Explained:
    """A record that says what makes its line: ``explained_by`` in words, ``causes`` by their kinds."""

    __slots__ = ()
    explained_by: str | None
    causes: tuple[CauseKind, ...]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of all that may make the line, the likeliest first; of files that have none its words."""
        return self.causes or (self.explained_by or "unexplained",)

    @property
    def electric(self) -> bool:
        """Whether the mains or the field of a motor make the line, and no order of the shaft may."""
        return electric(self.kinds)


@dataclass(frozen=True)
class Cause:
    """What makes a line: its ``kind``, the ``parameters`` of its words, and the ``evidence`` for it.

    ``others`` may make it as well, for all that the data tell; ``doubt`` is what keeps them from telling.
    """

    kind: CauseKind
    evidence: str = ""
    parameters: Mapping[str, float | str] = field(default_factory=dict)
    others: tuple[Cause, ...] = ()
    doubt: DoubtKind | None = None

    def either(self, *others: Cause) -> Cause:
        """This cause, or one of the ``others`` as well."""
        return replace(self, others=(*self.others, *(cause for other in others for cause in (other, *other.others))))

    @property
    def kinds(self) -> tuple[CauseKind, ...]:
        """Kinds of all that may make the line, this one first."""
        return tuple(dict.fromkeys(cause.kind for cause in (self, *self.others)))

    @property
    def text(self) -> str:
        """Words for all that may make the line: ``explained_by`` of the findings."""
        causes = (self, *self.others)
        return " or ".join(_WORDS.get(cause.kind, cause.kind).format(**cause.parameters) for cause in causes)

    @property
    def known(self) -> bool:
        """Whether it names a cause."""
        return self.kind not in _UNKNOWN

    def is_just(self, *kinds: CauseKind) -> bool:
        """Whether one of ``kinds`` makes the line, and nothing else may."""
        return self.kind in kinds and not self.others


BY_A_SWING = Cause("sideband by a swing of the angle").either(Cause("a line of its own"))
"""A line that the swing of the shaft or an error of its encoder may make, which nothing proves."""


def mains_words(multiple: int) -> str:
    """Name of a line at ``multiple`` times the mains frequency: "mains", "twice mains", "3 x mains"."""
    return {1: "mains", 2: "twice mains"}.get(multiple, f"{multiple} x mains")


def of_mains(multiple: int, evidence: str = "") -> Cause:
    """The supply at ``multiple`` times its frequency, with the ``evidence`` for it."""
    return Cause("mains", evidence, {"name": mains_words(multiple)})


def of_order(name: str = "order") -> Cause:
    """An order of the shaft of that ``name``."""
    return Cause("order", parameters={"name": name})


ALIKE_SPEEDS = 1.005
"""Fastest over slowest speed up to which a line of fixed frequency keeps its order."""


def alike_speeds(speed_rpm: Floats | Sequence[float]) -> bool:
    """Whether ``speed_rpm`` (speeds,) are so alike that a line of fixed frequency keeps its order.

    False where any speed is unknown.
    """
    return len(speed_rpm) > 0 and bool(np.max(speed_rpm) <= ALIKE_SPEEDS * np.min(speed_rpm))
