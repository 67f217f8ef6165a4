"""Lines of a recording that stand too close for steadiness and beat to part them, solved together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crankorder.orders.joint_lines import LOBE_BINS, Band, HeldFrames, JointLines, Place, Sighting, joint_lines
from crankorder.orders.joint_lines import NUMBERS as JOINT_LINES
from crankorder.quantities import Bools, Floats, Ints
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-lines.toml", "close_lines")


def several_lines(held: HeldFrames, low: float, high: float, *, beyond: float = 0.0) -> list[Sighting]:
    """Lines of ``held`` between the orders ``low`` and ``high``, lowest first; none where they do not leave noise.

    One after the other, the strongest first, each time all of them solved together, until nothing that is left stands
    over the noise beside it. Where something is left that no farther line is, within a beat of one that was found or
    after as many as there may be, that is no set of steady lines, or the recording does not part them: nothing is told.
    Lines that stand ``beyond`` orders farther off at most take part.
    """
    band = Band.about(held, low - beyond, high + beyond)
    if band is None or len(held.turn) < 8:
        return []
    inside = held.bins_within(low, high)
    scale = np.sqrt(1.0 / np.maximum(np.square(np.abs(band.data)).mean(axis=0), 1e-300)) / band.unit
    left, fit = band.data, None
    for _ in range(NUMBERS.most_lines):
        trial, score = band.periodogram(left, low - beyond, high + beyond)
        if len(trial) < 3:
            return []
        joined = _joined(band, fit, float(trial[int(np.argmax(score))]))
        lines = _with_errors(joined)
        new, size = lines[-1], np.array([float((line.amplitude * scale).max()) for line in lines])
        away = np.abs([line.order - new.order for line in lines[:-1]]) * held.span_rev
        beside = size[:-1][away < JOINT_LINES.apart_cycles].max(initial=0.0)
        least = max(NUMBERS.smallest_share * size.max(), NUMBERS.unsteady_share * beside)
        if not new.seen or size[-1] < least:
            if fit is None:
                return []
            rest = NUMBERS.unsteady_share if beside and new.seen else 0.0
            return sorted(_with_errors(fit, rest), key=lambda line: line.order) if _is_noise(fit, inside) else []
        orders = np.sort([line.order for line in lines])
        if len(orders) > 1 and np.diff(orders).min() * held.span_rev < JOINT_LINES.apart_cycles:
            return []
        left, fit = joined.left, joined
    return []


def _is_noise(lines: JointLines, bins: Ints) -> bool:
    """Whether ``lines`` have left no more in the ``bins`` than stands beyond them.

    In the channels in which one of them stands out; False where none does.
    """
    band, size = lines.band, np.abs(lines.phasor) * lines.band.unit
    floor, shown = _floor(band.held, bins), _shown(band.held, bins, size)
    power = np.square(np.abs(band.spectra(lines.left)[:, np.isin(band.bins, bins)])).mean(axis=0)
    left = power.max(axis=0) * np.square(band.unit) / floor
    most = NUMBERS.left_ratio + NUMBERS.left_share**2 * np.square(size).max(axis=0) / floor
    return bool(shown.any() and (left < most)[shown].all())


def unparted_reach(held: HeldFrames, low: float, high: float, orders: Sequence[float]) -> tuple[float, float] | None:
    """Orders between which lie lines that ``held`` does not part; None where ``orders`` hold most of what is there.

    Lines that beat hardly once within a recording are no set that a fit could tell, nor is what is left beside one of
    them noise: they are somewhere where a line would take a good part of what the best one takes, between ``low`` and
    ``high``.
    """
    band = Band.about(held, low, high)
    if band is None or len(held.turn) < 8:
        return None
    trial, score = band.periodogram(band.data, low, high)
    if len(trial) < 3:
        return None
    strongest = joint_lines(band, [Place(turns=float(trial[int(np.argmax(score))]))])
    if not _shown(held, held.bins_within(low, high), np.abs(strongest.phasor) * band.unit).any():
        return None
    if orders:
        left = joint_lines(band, [Place(turns=order) for order in orders]).left
        lost = np.square(np.abs(left)).sum(axis=0) / np.maximum(np.square(np.abs(band.data)).sum(axis=0), 1e-300)
        if lost.min() < NUMBERS.unparted_share:
            return None
    near = trial[score >= NUMBERS.unparted_share * score.max()]
    return float(near.min()), float(near.max())


def _floor(held: HeldFrames, bins: Ints) -> Floats:
    """Median power (channels,) of the bins beside ``bins``."""
    power = np.square(np.abs(held.spectrum)).mean(axis=1)
    first, last = int(bins[0]) - NUMBERS.beside_bins, int(bins[-1]) + NUMBERS.beside_bins
    wide = np.arange(max(first, 1), min(last + 1, power.shape[1]))
    return np.asarray(np.maximum(np.median(power[:, wide[~np.isin(wide, bins)]], axis=1), 1e-300))


def _shown(held: HeldFrames, bins: Ints, amplitude: Floats) -> Bools:
    """In which channels one ``amplitude`` of several (lines, channels) stands out of what is beside the ``bins``."""
    return np.asarray(np.square(amplitude).max(axis=0) > NUMBERS.stands_over_ratio * _floor(held, bins))


def _joined(band: Band, fit: JointLines | None, order: float) -> JointLines:
    """``fit`` with one line more near ``order``, all solved together; as an order or a fixed frequency, what fits."""
    held, kinds = band.held, [Place(turns=order)]
    apart = held.time_s * held.rpm / 60.0 - (held.turn - held.turn[0])
    if order * float(np.ptp(apart)) > NUMBERS.wander_cycles:
        kinds.append(Place(order * held.rpm / 60.0))
    before = () if fit is None else fit.places
    fits = [joint_lines(band, (*before, kind), free=True, crowded=True) for kind in kinds]
    return min(fits, key=lambda wider: float((np.square(np.abs(wider.left)).sum(axis=0)).sum()))


def _with_errors(fit: JointLines, rest: float = 0.0) -> list[Sighting]:
    """The lines of ``fit`` with their errors; ``rest`` is the share of a line that is left beside it."""
    least = max(NUMBERS.least_cycles, 0.5 * rest) / fit.band.held.span_rev
    lines = [fit.sighting(number) for number in range(len(fit.places))]
    return [replace(line, order_error=float(np.hypot(line.order_error, least))) for line in lines]


def lines_within(held: HeldFrames, low: float, high: float) -> list[Sighting]:
    """Lines of ``held`` from ``low`` to ``high``; those beyond that reach into it take part."""
    if not held.reaches(low, high):
        return []
    beyond = LOBE_BINS / held.revs
    return [line for line in several_lines(held, low, high, beyond=beyond) if low <= line.order <= high]
