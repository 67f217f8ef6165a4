"""Lines that other lines explain: meshes with their sidebands, sidebands of any carrier, shafts of their own speed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crankorder.identify.found import AgreedOrder, OrderLine
from crankorder.identify.lines.order_lock import NO_PULSES
from crankorder.identify.said import IF_WRONG
from crankorder.identify.sidebands import NUMBERS as SIDEBANDS
from crankorder.identify.sidebands import meshes, other_shafts, sidebands
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="explain_families"):
    first_reach_orders: float
    near_mode_share: float
    most_sidebands: int


NUMBERS = _Numbers.load()

Key = tuple[str, float]
Words = dict[Key, tuple[str, str]]
"""Cause and evidence by channel and order."""

MESH = "gear mesh or blade passing: integer order with sidebands"

BY_ITSELF = ("unexplained", "shaft harmonic")
"""Words for lines that a mesh beside them explains better."""


def explain_families(
    orders: tuple[AgreedOrder, ...],
    texts: dict[Key, str],
    of_cycle: dict[float, float | None],
    *,
    spacings: dict[str, float],
    modes_hz: Sequence[float],
) -> Words:
    """Causes of the lines that other lines explain, by channel and order; lines that none explains are not in it.

    Parameters
    ----------
    orders : the orders of the test
    texts : what explains each line by itself, "unexplained" and "shaft harmonic" among them
    of_cycle : by order, the multiple of the order of the cycle that it is or may be, or None
    spacings : names and orders of what turns and may modulate a line
    modes_hz : natural frequencies; a harmonic that one of them lifts at every speed is no mesh
    """
    words: Words = {}
    for channel in sorted({line.channel for agreed in orders for line in agreed.lines}):
        lines = [(agreed, line) for agreed in orders for line in agreed.lines if line.channel == channel]
        words |= _meshes(channel, lines, texts, of_cycle, modes_hz)
        words |= _sidebands(channel, lines, texts, of_cycle, spacings)
    return words | _shafts(orders, texts, words, of_cycle)


def _meshes(
    channel: str,
    lines: list[tuple[AgreedOrder, OrderLine]],
    texts: dict[Key, str],
    of_cycle: dict[float, float | None],
    modes_hz: Sequence[float],
) -> Words:
    """Whole orders of one channel that are a mesh by their sidebands, and these; stated meshes have sidebands too."""
    whole: dict[int, tuple[float, OrderLine]] = {}
    for agreed, line in lines:
        multiple = of_cycle[agreed.order]
        if (
            multiple is not None
            and multiple == round(multiple)
            and not texts[channel, agreed.order].startswith("encoder")
        ):
            whole[round(multiple)] = (agreed.order, line)
    words: Words = {}
    known = {number for number, (order, _) in whole.items() if texts[channel, order].startswith("gear mesh")}
    for mesh in sorted({*meshes({number: float(line.amplitude.max()) for number, (_, line) in whole.items()}), *known}):
        order, line = whole[mesh]
        stated = mesh in known
        if not stated and (texts[channel, order] not in BY_ITSELF or _lifted(line, mesh, modes_hz)):
            continue
        sides = list(_sides(mesh, whole, line))
        if not stated:
            about = ", ".join(str(number) for number in sorted(sides))
            words[channel, order] = (MESH, f"order {mesh} stands over its sidebands at orders {about}")
        for number in sides:
            if texts[channel, whole[number][0]] in BY_ITSELF:
                evidence = f"{abs(number - mesh)} shaft orders from order {mesh}, which stands over it; also whole"
                words[channel, whole[number][0]] = (f"sideband of order {mesh} spaced by 1", evidence)
    return words


def _sides(mesh: int, whole: dict[int, tuple[float, OrderLine]], carrier: OrderLine) -> list[int]:
    """Whole orders beside ``mesh``, outwards as long as none is missing or stands over half of its ``carrier``."""
    found = []
    for step in (-1, 1):
        for distance in range(1, NUMBERS.most_sidebands + 1):
            item = whole.get(mesh + step * distance)
            if item is None or SIDEBANDS.mesh_ratio * item[1].amplitude.max() > carrier.amplitude.max():
                break
            found.append(mesh + step * distance)
    return found


def _lifted(line: OrderLine, order: int, modes_hz: Sequence[float]) -> bool:
    """Whether a natural frequency may lift ``line`` at half or more of the speeds at which it is seen."""
    if not len(modes_hz) or not np.isfinite(line.speed_rpm).all():
        return False
    frequency = order * line.speed_rpm / 60.0
    near = np.abs(frequency[:, None] / np.asarray(modes_hz) - 1.0) < NUMBERS.near_mode_share
    return bool(np.mean(near.any(axis=1)) >= 0.5)


def _sidebands(
    channel: str,
    lines: list[tuple[AgreedOrder, OrderLine]],
    texts: dict[Key, str],
    of_cycle: dict[float, float | None],
    spacings: dict[str, float],
) -> Words:
    """Unexplained lines of one channel, off the multiples of the cycle, that stand in pairs about a stronger line."""
    free = [texts[channel, a.order] == "unexplained" and of_cycle[a.order] is None for a, _ in lines]
    places = [agreed.order for agreed, _ in lines]
    found = sidebands(
        places,
        [min(agreed.order_error, line.order_error) for agreed, line in lines],  # a speed's error shifts all alike
        [float(line.amplitude.max()) for _, line in lines],
        spacings=spacings,
        highest=max(places, default=1.0),
        sides=free,
    )
    words: Words = {}
    for band in found:
        named = f" ({band.spacing_name})" if band.spacing_name else ""
        words[channel, places[band.at]] = (
            f"sideband of order {places[band.carrier]:.4g} spaced by {band.spacing:.4g}",
            f"one of a pair about a stronger line{named}; {band.chance:.1g} such pairs by chance",
        )
    return words


def _shafts(
    orders: tuple[AgreedOrder, ...], texts: dict[Key, str], words: Words, of_cycle: dict[float, float | None]
) -> Words:
    """Lines not locked to the shaft, in whole ratios to one another: those of another shaft."""

    def open_lines(agreed: AgreedOrder) -> list[Key]:
        keys = [(line.channel, agreed.order) for line in agreed.lines]
        return [key for key in keys if texts[key] == "unexplained" and key not in words]

    free = [agreed for agreed in orders if of_cycle[agreed.order] is None and open_lines(agreed)]
    found = other_shafts([agreed.order for agreed in free], [agreed.order_error for agreed in free])
    made: Words = {}
    has_first = any(
        abs(agreed.order - 1.0) < NUMBERS.first_reach_orders
        and not any("mains" in texts[line.channel, agreed.order] for line in agreed.lines)
        for agreed in orders
    )
    speed_may_be_wrong = not has_first and all(NO_PULSES in agreed.reservation for agreed in free)
    for at, (first, multiple) in found.items():
        base = free[first].order
        count = sum(1 for other, _ in found.values() if other == first)
        evidence = f"not locked to the shaft; {count} lines are whole multiples of order {base:.5g}"
        if speed_may_be_wrong:
            text = f"a shaft at {base:.4g} times the stated speed, {IF_WRONG}"
            evidence += "; nothing stands at order 1, and no pulses prove the speed"
        else:
            text = f"a second shaft at {base:.4g}"
        for key in open_lines(free[at]):
            made[key] = (text if multiple == 1 else f"harmonic {multiple} of {text}", evidence)
    return made
