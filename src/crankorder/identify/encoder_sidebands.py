"""Lines that an encoder's error may make beside strong orders: no part of the machine is named for them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.found import AgreedOrder, OrderLine
from crankorder.orders.swing_evidence import HARMONICS
from crankorder.orders.true_angle import TAKEN, given_to
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="encoder_sidebands"):
    alike_share: float
    scatter_sigmas: float


NUMBERS = _Numbers.load()

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
    scatter = np.nan_to_num(line.amplitude_error) * NUMBERS.scatter_sigmas
    overall = float(np.mean(line.amplitude**2)) <= (1.0 + NUMBERS.alike_share) ** 2 * float(np.mean(given[rows] ** 2))
    return overall and bool((line.amplitude <= (1.0 + NUMBERS.alike_share) * given[rows] + scatter).all())


def _carrier(line: OrderLine, amplitude: NDArray[np.float64], axis: NDArray[np.float64], order: float) -> float:
    """Order of ``axis``, one or two turns from ``order``, that gives most; ``amplitude`` is (speeds, orders)."""
    row = amplitude[int(line.seen[line.strongest])]
    turned = row * axis
    beside = [int(np.argmin(np.abs(axis - (order + sign * k)))) for k in HARMONICS for sign in (-1.0, 1.0)]
    return float(axis[max(beside, key=lambda place: float(turned[place]))])
