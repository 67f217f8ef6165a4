"""Lines that belong to other lines: sidebands of a carrier, meshes of teeth, harmonics of a shaft of its own speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.found import AgreedOrder, OrderLine
from crankorder.orders.swing_evidence import HARMONICS
from crankorder.orders.true_angle import TAKEN, given_to
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="sidebands"):
    carrier_spacings: float
    family_chance: float
    same_sigmas: float
    least_teeth: int
    most_firings: int
    mesh_ratio: float


NUMBERS = _Numbers.load()

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sideband:
    """Line ``at`` is one of ``carrier`` (positions in the lists given), ``multiple`` times ``spacing`` from it."""

    at: int
    carrier: int
    spacing: float
    multiple: int
    spacing_name: str
    chance: float


def sidebands(
    places: Sequence[float],
    errors: Sequence[float],
    amplitudes: Sequence[float],
    *,
    spacings: dict[str, float],
    highest: float,
    sides: Sequence[bool] | None = None,
) -> list[Sideband]:
    """Which lines are sidebands of stronger ones: pairs on both sides, alike far from their carrier.

    A modulation makes both sides at once, so a carrier has to be the strongest of the three. The spacing is one of the
    known ``spacings``, or any other that a chance of less than 5 % would not put there, counted over all pairs of
    lines. A line is given to its strongest carrier.

    Parameters
    ----------
    places : orders of the shaft, or frequencies in Hz, of the lines of one channel
    errors : their standard errors
    amplitudes : their peak amplitudes
    spacings : names and values, in the unit of the places, of what turns or alternates: "shaft", "cage", a tone
    highest : the range in which lines were sought begins at 0 and ends here, for the chance
    sides : which lines may be sidebands; all where it is None. Lines on one grid, as the multiples of a shaft's order,
        lie alike far from many others by nature and prove nothing
    """
    order = np.argsort(-np.asarray(amplitudes))
    found: dict[int, Sideband] = {}
    for carrier in order.tolist():
        if carrier in found:
            continue
        may = [(sides is None or sides[k]) and amplitudes[k] < amplitudes[carrier] for k in range(len(places))]
        for pair in _pairs(carrier, places, errors, may, spacings, highest):
            for item in pair:
                found.setdefault(item.at, item)
    return [found[at] for at in sorted(found)]


def _pairs(
    carrier: int,
    places: Sequence[float],
    errors: Sequence[float],
    may: Sequence[bool],
    spacings: dict[str, float],
    highest: float,
) -> list[tuple[Sideband, Sideband]]:
    """Pairs of lines alike far below and above ``carrier``, of those that ``may`` be its sidebands."""
    below = [k for k in range(len(places)) if may[k] and places[k] < places[carrier]]
    above = [k for k in range(len(places)) if may[k] and places[k] > places[carrier]]
    pairs = []
    for low in below:
        for high in above:
            spacing = 0.5 * (places[high] - places[low])
            error = float(np.sqrt(0.25 * (errors[high] ** 2 + errors[low] ** 2) + errors[carrier] ** 2))
            lopsided = abs(places[carrier] - 0.5 * (places[high] + places[low]))
            if lopsided > NUMBERS.same_sigmas * error or places[carrier] < NUMBERS.carrier_spacings * spacing:
                continue
            name, multiple = _known(spacing, 0.5 * float(np.hypot(errors[high], errors[low])), spacings)
            # so many pairs as there are, each with its middle anywhere, would sit so often on this carrier
            chance = len(below) * len(above) * min(1.0, 2.0 * NUMBERS.same_sigmas * error / highest)
            if name or chance < NUMBERS.family_chance:
                unit = spacing / multiple
                pairs.append(
                    (
                        Sideband(low, carrier, unit, -multiple, name, chance),
                        Sideband(high, carrier, unit, multiple, name, chance),
                    )
                )
    return sorted(pairs, key=lambda pair: (not pair[0].spacing_name, pair[1].multiple, pair[0].spacing))


def _known(spacing: float, error: float, spacings: dict[str, float]) -> tuple[str, int]:
    """Name of the known spacing of which ``spacing`` is the single, double or threefold; ("", 1) where none is."""
    for multiple in (1, 2, 3):
        for name, value in spacings.items():
            if abs(spacing - multiple * value) <= NUMBERS.same_sigmas * error + 1e-9:
                return name, multiple
    return "", 1


def meshes(amplitude_of: dict[int, float]) -> list[int]:
    """Whole orders that are a mesh of teeth or a passing of blades, by their sidebands.

    ``amplitude_of`` gives the peak amplitudes of the whole orders of one channel. Six teeth or more, a line one shaft
    order below and above, at half of it or less, and nothing within five orders that is as large: harmonics of a shaft
    fall off from the first and have no such summit, or a mode makes one. Where no order is missing from the first up to
    the line, what stands beside it may be harmonics of the shaft as well: then it has to be twice as large as all of
    these, and above the orders at which engines fire, of which any may be the largest.
    """
    found = []
    for order, amplitude in amplitude_of.items():
        sides = [amplitude_of.get(order - 1), amplitude_of.get(order + 1)]
        if order < NUMBERS.least_teeth or None in sides:
            continue
        beside = [amplitude_of.get(order + step, 0.0) for step in range(-5, 6) if step]
        whole = all(below in amplitude_of for below in range(1, order))
        if whole and (order <= NUMBERS.most_firings or amplitude < NUMBERS.mesh_ratio * max(beside)):
            continue
        largest_side = max(side for side in sides if side is not None)
        if amplitude >= NUMBERS.mesh_ratio * largest_side and amplitude > max(beside):
            found.append(order)
    return sorted(found)


def other_shafts(places: Sequence[float], errors: Sequence[float]) -> dict[int, tuple[int, int]]:
    """Lines that are harmonics of a shaft of its own speed: {line: (line of its first order, multiple)}.

    ``places`` (orders of the crank) and their standard ``errors`` are those of lines that are not locked to it. A shaft
    has its first order and its second at least; the slowest that explains most lines is taken, where lines that lie
    anywhere would make less than 5 % of such a family.
    """
    order = np.argsort(places).tolist()
    found: dict[int, tuple[int, int]] = {}
    for first in order:
        if first in found:
            continue
        family, chance = {first: 1}, 1.0
        for other in order:
            multiple = round(places[other] / places[first])
            error = float(np.hypot(multiple * errors[first], errors[other]))
            if (
                other in found
                or multiple < 2
                or abs(places[other] - multiple * places[first]) > NUMBERS.same_sigmas * error
            ):
                continue
            family[other] = multiple
            chance *= min(1.0, 2.0 * NUMBERS.same_sigmas * error / places[first])
        # any of the others could have been the one that fits
        if 2 in family.values() and chance * len(places) < NUMBERS.family_chance:
            found |= {line: (first, multiple) for line, multiple in family.items()}
    return found


class _EncoderNumbers(MethodNumbers, file="5-identify-explain.toml", table="encoder_sidebands"):
    alike_share: float
    scatter_sigmas: float


ENCODER_NUMBERS = _EncoderNumbers.load()

OF_ENCODER = "encoder eccentricity: sideband of order"
"""Begin of the words for what is left of sidebands whose cause is proved."""

OR_OWN = "encoder eccentricity or a line of its own"
"""Words for a line that an eccentricity would make which the data do not exclude, nor prove."""

Words = dict[tuple[str, float], tuple[str, str]]
"""Cause and evidence by channel and order."""


def encoder_sidebands(orders: Sequence[AgreedOrder], order_map: xr.Dataset, frames: Sequence[xr.Dataset]) -> Words:
    """Cause and evidence of the lines of ``orders`` that are no larger than what the swing of the angle may give them.

    ``order_map`` (OrderMap) says what their neighbours have, ``frames`` (OrderFrames) what of the swing was taken out
    and what may be left. A line counts where that is so at every speed at which it is seen.
    """
    amplitude = np.nan_to_num(order_map["amplitude"].values)
    given = given_to(amplitude, frames)
    axis, names = order_map["order"].values, order_map["channel"].values.tolist()
    proved = any(float(np.max(item.attrs.get(TAKEN, [0.0]))) > 0.0 for item in frames)
    words: Words = {}
    for agreed in orders:
        at = int(np.argmin(np.abs(axis - agreed.order)))
        for line in agreed.lines:
            channel = names.index(line.channel)
            if not _within(line, given[channel, :, at]):
                continue
            carrier = _carrier(line, amplitude[channel], axis, agreed.order)
            if proved:
                evidence = "as large as what is left of the encoder's error gives it; taken out as far as it is known"
                words[line.channel, agreed.order] = (f"{OF_ENCODER} {carrier:g}", evidence)
            else:
                evidence = (
                    f"beside order {carrier:g}, which an eccentricity that the data do not exclude would put there"
                )
                words[line.channel, agreed.order] = (OR_OWN, evidence)
    return words


def _within(line: OrderLine, given: NDArray[np.float64]) -> bool:
    """Whether ``line`` is no larger than what is ``given`` (speeds of the map,) to it: overall, and at any speed.

    At one speed its own scatter may lift it.
    """
    rows = line.seen[line.seen < len(given)]
    if not len(rows) == len(line.amplitude) > 0:
        return False
    scatter = np.nan_to_num(line.amplitude_error) * ENCODER_NUMBERS.scatter_sigmas
    overall = float(np.mean(line.amplitude**2)) <= (1.0 + ENCODER_NUMBERS.alike_share) ** 2 * float(
        np.mean(given[rows] ** 2)
    )
    return overall and bool((line.amplitude <= (1.0 + ENCODER_NUMBERS.alike_share) * given[rows] + scatter).all())


def _carrier(line: OrderLine, amplitude: NDArray[np.float64], axis: NDArray[np.float64], order: float) -> float:
    """Order of ``axis``, one or two turns from ``order``, that gives most; ``amplitude`` is (speeds, orders)."""
    row = amplitude[int(line.seen[line.strongest])]
    turned = row * axis
    beside = [int(np.argmin(np.abs(axis - (order + sign * k)))) for k in HARMONICS for sign in (-1.0, 1.0)]
    return float(axis[max(beside, key=lambda place: float(turned[place]))])
