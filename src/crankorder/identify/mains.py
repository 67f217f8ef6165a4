"""Multiples of a mains frequency, how far they wander, and what they are called."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from crankorder.settings import IdentifySettings, MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="mains"):
    alone_multiples: int


NUMBERS = _Numbers.load()

_LOW_WORDS = {1: "mains", 2: "twice mains"}


def nearest_multiple(
    frequency_hz: NDArray[np.float64] | float, mains_hz: float, *, settings: IdentifySettings
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The multiple of ``mains_hz`` next to each ``frequency_hz`` (any shape, Hz), and how far (Hz) it may lie from it.

    ``settings``: how far the mains frequency wanders.
    """
    multiple = np.maximum(1.0, np.rint(np.asarray(frequency_hz, dtype=np.float64) / mains_hz))
    return multiple, settings.mains_tolerance_hz * np.sqrt(multiple)


def mains_words(multiple: int) -> str:
    """What a line at ``multiple`` times the mains frequency is called: "mains", "twice mains", "3 x mains"."""
    return _LOW_WORDS.get(multiple, f"{multiple} x mains")


def multiple_in(text: str) -> int | None:
    """Multiple of the mains that the words ``text`` of a cause name; None where they name anything else as well."""
    if text in _LOW_WORDS.values():
        return next(multiple for multiple, words in _LOW_WORDS.items() if words == text)
    number, _, rest = text.partition(" ")
    return int(number) if number.isdigit() and rest == "x mains" else None


def multiples_near(frequency_hz: float, error_hz: float, *, settings: IdentifySettings) -> list[tuple[int, float]]:
    """Multiple and mains frequency in Hz, of each mains, that a line at ``frequency_hz`` may be.

    ``error_hz``: its standard error; ``settings``: the mains frequencies and how far they wander.
    """
    made = []
    for mains in settings.mains_hz:
        multiple, reach = nearest_multiple(frequency_hz, mains, settings=settings)
        if abs(frequency_hz - float(multiple) * mains) <= float(reach) + 2.0 * error_hz:
            made.append((int(multiple), mains))
    return made


def multiple_on(frequency_hz: float, error_hz: float, *, settings: IdentifySettings) -> tuple[int, float] | None:
    """The first of the ``multiples_near`` so low that a line may be mains by itself; None: none may.

    ``frequency_hz``, ``error_hz`` and ``settings`` as there.
    """
    near = multiples_near(frequency_hz, error_hz, settings=settings)
    return next((one for one in near if one[0] <= NUMBERS.alone_multiples), None)


def supply_told(places_hz: Sequence[tuple[float, float]], *, settings: IdentifySettings) -> float | None:
    """Nominal frequency in Hz of the supply of a test whose mains stand at ``places_hz`` (frequency and error, Hz).

    That of which alone some of them are multiples; of two that of which the first or the second multiple is there. None
    where none or both are told. ``settings``: the mains frequencies and how far they wander.
    """
    told: dict[float, bool] = {}
    for hertz, error in places_hz:
        near = multiples_near(hertz, error, settings=settings)
        if len({mains for _, mains in near}) == 1:
            multiple, mains = near[0]
            told[mains] = told.get(mains, False) or multiple <= NUMBERS.alone_multiples
    low = [mains for mains, is_low in told.items() if is_low]
    chosen = low if len(told) > 1 else list(told)
    return chosen[0] if len(chosen) == 1 else None


_OF_THE_FIELD = ("mains", "twice mains", "motor, pole-pass", "motor, sideband")


def is_electric(text: str) -> bool:
    """Whether the words ``text`` of a cause name the mains or the field of a motor, and no order of the shaft."""
    return (text.startswith(_OF_THE_FIELD) or " x mains" in text) and " or order" not in text
