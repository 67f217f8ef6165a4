"""What the signals of sweeps do not show: how much a mode that nobody saw could add to an order, place by place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.modal.exclusion import NUMBERS, Hiding
from crankorder.identify.modal.sweep_fit import LocalFit, OnePoleMore
from crankorder.identify.modal.sweep_window import Solved
from crankorder.identify.resonance import resonance

CELL = 0.005
"""Ratio less one of the frequencies that are asked about next to one another."""

STARTS_APART = 0.5
"""Distance of the poles that are imagined, in half-power widths of a mode or of a bin: hardly any is lower between."""

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]


@dataclass(frozen=True, eq=False)
class HiddenInSweep:
    """What a mode that nobody saw could add to ``order`` in one recording, at ``frequency_hz`` (G,), rising.

    ``smooth`` (C, G) is the amplitude that the order would have there without any mode, ``own`` (M, C, G) what the
    poles ``natural_hz`` (M,) of the fit make of it; ``added`` and ``noise`` (C, G) are those of a Hiding.
    """

    order: float
    channels: tuple[str, ...]
    frequency_hz: Array
    smooth: Complex
    own: Complex
    natural_hz: Array
    damping: Array
    added: Array
    noise: Array

    def beside(self, proven_hz: Sequence[float]) -> Hiding:
        """With those of its poles as known that are modes of ``proven_hz``; any other may be a mode that is to come."""
        proven = np.array(proven_hz)
        known = np.array(
            [
                bool(np.any(np.abs(proven - f) <= zeta * f))
                for f, zeta in zip(self.natural_hz.tolist(), self.damping.tolist(), strict=True)
            ],
            dtype=np.bool_,
        )
        base = np.abs(self.smooth + self.own[known].sum(axis=0))
        added = self.added + np.abs(self.own[~known]).sum(axis=0)
        return Hiding(self.order, self.frequency_hz, self.channels, base, added, self.noise)


def hidden_in(
    fit: LocalFit, low_hz: float, high_hz: float, *, least_damping: float, confidence: float
) -> tuple[HiddenInSweep, ...]:
    """What each order of ``fit`` hides from ``low_hz`` to ``high_hz``, recording by recording.

    Poles of ``least_damping`` and some times that are imagined side by side, with an amplitude behind every order and
    one that rings: what the signals give them, and as much more as they leave open at the ``confidence`` (0 to 1).
    """
    from scipy.special import chdtri

    reach = float(np.sqrt(0.5 * chdtri(2.0, 1.0 - confidence)))
    cells = np.geomspace(low_hz, high_hz, max(3, int(np.ceil(np.log(high_hz / low_hz) / CELL))))
    made: list[HiddenInSweep] = []
    for one in fit.solved:
        spread = float(np.sqrt(max(1.0, one.misfit / max(one.freedom, 1))))
        added = np.zeros((len(one.window.orders), one.left.shape[1], len(cells)))
        for times in NUMBERS.tried_damping_ratios:
            added = np.maximum(added, _added(one, cells, least_damping * times, reach * spread))
        made += [_of_order(one, place, cells, added[place]) for place in range(len(one.window.orders))]
    return tuple(item for item in made if len(item.frequency_hz) > 1)


def _added(one: Solved, cells: Array, damping: float, reach: float) -> Array:
    """Largest amplitude (orders, C, G) that a mode about each of ``cells`` adds at its peak to an order held there.

    Per unit of the order's force. ``reach``: standard errors that count as unseen.
    """
    step = STARTS_APART * max(2.0 * damping, 1.0 / one.window.sweep.length_s / cells[0])
    natural = np.geomspace(cells[0], cells[-1], max(2, int(np.ceil(np.log(cells[-1] / cells[0]) / step))))
    more = OnePoleMore.of(one, natural, np.full(len(natural), damping))
    most = (np.abs(more.residues) + reach * np.sqrt(more.variance)) / (2.0 * damping)
    worst = np.stack([np.interp(cells, natural, values) for values in most.reshape(len(natural), -1).T])
    nearest = np.abs(np.log(natural[:, None] / cells)).argmin(axis=1)
    np.maximum.at(worst.T, nearest, most.reshape(len(natural), -1))
    return np.asarray(worst.reshape(*most.shape[1:], len(cells)))


def _of_order(one: Solved, place: int, cells: Array, added: Array) -> HiddenInSweep:
    """What order number ``place`` of ``one`` window hides at those of ``cells`` (G,) that it passes.

    ``added`` (C, G): the most that a mode adds per unit of its force.
    """
    window, order = one.window, one.window.orders[place]
    hz = order * window.sweep.speed_rpm / 60.0
    at = cells[(cells >= hz.min()) & (cells <= hz.max())]
    kept = np.searchsorted(cells, at)
    force = window.force_at(order, at)
    width = window.order_columns(len(one.natural_hz))
    own = slice(place * width, (place + 1) * width)
    smooth, answers = window.powers_at(at), resonance(at, one.natural_hz, one.damping)
    path = np.concatenate([smooth, answers], axis=1) * force[:, None]
    amplitude, degree = one.amplitude[own], window.degree + 1
    scatter = np.square(window.level) * one.misfit / max(one.freedom, 1)
    error = np.sqrt(np.sum(np.abs(path @ (one.inverse[own] / one.scale[own, None])) ** 2, axis=1) * scatter[:, None])
    return HiddenInSweep(
        order,
        window.sweep.channels,
        at,
        (path[:, :degree] @ amplitude[:degree]).T,
        np.einsum("gm,mc->mcg", path[:, degree:], amplitude[degree:]),
        one.natural_hz,
        one.damping,
        added[:, kept] * np.abs(force),
        NUMBERS.noise_sigmas * error,
    )
