"""Order lines of a test at one speed that are mains: at one speed a fixed frequency looks like an order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.found import AgreedOrder
from crankorder.identify.lines.line_evidence import UNPROVEN
from crankorder.identify.mains import NUMBERS as MAINS
from crankorder.identify.mains import mains_words, nearest_multiple
from crankorder.identify.said import NUMBERS as SAID
from crankorder.settings import IdentifySettings, MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="mains_orders"):
    fewest_multiples: int
    over_chance_ratio: float
    same_hz: float
    same_sigmas: float


NUMBERS = _Numbers.load()

NOT_BOTH = "mains or another tone"
"""What lines are called that only two mains frequencies at one place would explain together."""

OR_RESONANCE = "or a natural frequency"
"""What is added where the recordings are too short to tell a line from a resonance that noise excites."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class _Fixed:
    """Lines of one speed: frequencies and errors in Hz, and whether each may be an ``exact`` order of the shaft."""

    hertz: Floats
    error_hz: Floats
    exact: NDArray[np.bool_]


def mains_orders(
    orders: tuple[AgreedOrder, ...],
    *,
    tones_hz: Sequence[float] = (),
    exact: Sequence[float] = (),
    settings: IdentifySettings,
) -> dict[float, tuple[str, str]]:
    """Words and evidence of those of ``orders`` that are or may be multiples of a mains frequency, by order.

    Only of lines seen at speeds too alike to tell an order from a fixed frequency. The mains frequency and its double
    stand alone; further multiples only beside one of these, on the same grid, or where more of them are there than
    chance would bring. Where one line is surely mains, those that may be orders of the shaft must lie on its grid.

    Parameters
    ----------
    tones_hz : mains that were found as tones
    exact : orders that are multiples of the cycle's for all that is known: they may be mains as well
    settings : the mains frequencies and how far they wander
    """
    places = {one.order: place for one in orders if (place := _fixed_hz(one)) is not None}
    if not places:
        return {}
    names = list(places)
    lines = _Fixed(
        np.array([places[order][0] for order in names]),
        np.array([places[order][1] for order in names]),
        np.array([order in exact for order in names]),
    )
    hits = {mains: found for mains in settings.mains_hz if (found := _hits(lines, mains, tones_hz, settings)).any()}
    sure = [mains for mains, found in hits.items() if (found & ~lines.exact).any()]
    unproven = {one.order for one in orders if all(line.evidence == UNPROVEN for line in one.lines)}
    made: dict[float, tuple[str, str]] = {}
    for mains, found in hits.items():
        multiple, _ = nearest_multiple(lines.hertz, mains, settings=settings)
        for at in np.flatnonzero(found).tolist():
            number = int(multiple[at])
            words = NOT_BOTH if len(sure) > 1 else mains_words(number)
            words = f"{words} {OR_RESONANCE}" if names[at] in unproven else words
            text = f"{lines.hertz[at]:.6g} Hz, {number} x {mains:g} Hz within what mains wander by"
            made.setdefault(names[at], (words, f"{text}; at one speed mains look like orders"))
    return made


def _hits(lines: _Fixed, mains: float, tones_hz: Sequence[float], settings: IdentifySettings) -> NDArray[np.bool_]:
    """Which ``lines`` are or may be multiples of ``mains``."""
    multiple, reach = nearest_multiple(lines.hertz, mains, settings=settings)
    within = reach + 2.0 * lines.error_hz
    hits = np.asarray(np.abs(lines.hertz - multiple * mains) <= within)
    low = hits & (multiple <= MAINS.alone_multiples)
    told = lines.hertz / multiple
    others, room = nearest_multiple(np.asarray(tones_hz, dtype=np.float64), mains, settings=settings)
    beside = (np.asarray(tones_hz) / others)[np.abs(np.asarray(tones_hz) - others * mains) <= room]
    free = low & ~lines.exact
    if free.any() or len(beside):
        base = float(np.median(np.concatenate([told[free], beside])))
        return hits & (
            np.abs(lines.hertz - multiple * base) <= np.maximum(NUMBERS.same_hz, NUMBERS.same_sigmas * lines.error_hz)
        )
    several = hits & ~lines.exact
    if several.any():
        base = float(np.median(told[several]))
        several &= np.abs(lines.hertz - multiple * base) <= NUMBERS.same_hz
        by_chance = float(np.sum(np.minimum(1.0, 2.0 * reach / mains)[~lines.exact]))
        if np.unique(multiple[several]).size >= max(NUMBERS.fewest_multiples, NUMBERS.over_chance_ratio * by_chance):
            return several | low
    return low


def _fixed_hz(agreed: AgreedOrder) -> tuple[float, float] | None:
    """Frequency and error of a line that may as well be fixed; None where several speeds say otherwise."""
    speed = np.concatenate([line.speed_rpm for line in agreed.lines])
    if not np.isfinite(speed).all() or speed.max() > SAID.alike_speeds_ratio * speed.min():
        return None
    rpm = float(speed.mean())
    return agreed.order * rpm / 60.0, float(
        np.hypot(agreed.line_error * rpm, agreed.order * np.ptp(speed) / 4.0)
    ) / 60.0
