"""Orders of a test at one speed where more lines stand within a bin than steadiness and beat part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from crankorder.identify.found import OrderLine
from crankorder.identify.lines.known_lines import held_recordings
from crankorder.identify.lines.line_phasors import Recording
from crankorder.identify.lines.mains import NUMBERS as MAINS
from crankorder.identify.lines.order_lines import NUMBERS as ORDER_LINES
from crankorder.identify.lines.order_lines import largest_within
from crankorder.orders.intervals import Z95
from crankorder.orders.joint_lines import LOBE_BINS, Band, HeldFrames, JointLines, Place, Sighting, joint_lines
from crankorder.orders.joint_lines import NUMBERS as JOINT_LINES
from crankorder.quantities import Bools, Floats, Ints
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-lines.toml", "several_orders")


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


def leave_noise(held: HeldFrames, low: float, high: float, orders: Sequence[float]) -> bool:
    """Whether lines at ``orders`` of ``held`` are all that stands between the orders ``low`` and ``high``."""
    band = Band.about(held, low, high)
    if band is None or not len(orders):
        return False
    return _is_noise(joint_lines(band, [Place(turns=order) for order in orders]), held.bins_within(low, high))


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


SOLVED = "lines within a quarter order, solved together"
"""Words, after their number, of lines that were told apart so."""


@dataclass(frozen=True, eq=False)
class CloseLines:
    """Lines ``solved`` between the orders ``low`` and ``high`` of a recording ``held``."""

    low: float
    high: float
    held: HeldFrames
    solved: tuple[Sighting, ...]


def close_lines(
    recordings: Sequence[Recording],
    order_map: xr.Dataset,
    orders_between: Callable[[float, float], Sequence[float]],
    doubtful: Callable[[float, float], bool],
    *,
    mains_hz: Sequence[float],
) -> list[CloseLines]:
    """Neighbourhoods in the OrderMap ``order_map`` of one speed that hold more lines than were told there.

    Those of the mains, for where the mains or their double meet an order of a motor, sidebands stand about both; and
    those that are ``doubtful``, where nothing is told or what is told swells and fades, as three lines or more do.
    ``recordings`` are those of the test, of which the longest is looked at; ``orders_between``
    gives those that were told between two; ``mains_hz``: the frequencies of supplies.
    """
    if order_map.sizes["speed"] != 1 or order_map.attrs.get("window", "hann") != "hann":
        return []
    names = [str(name) for name in order_map["channel"].values]
    axis = np.asarray(order_map["order"].values, dtype=np.float64)
    held = max(held_recordings(recordings, names), key=lambda recording: recording.span_rev, default=None)
    if held is None:
        return []
    reach = min(ORDER_LINES.neighbour_orders, ORDER_LINES.neighbour_bins * float(axis[1] - axis[0]))
    close = []
    multiples = range(1, MAINS.alone_multiples + 1)
    of_mains = [60.0 * number * hertz / held.rpm for hertz in mains_hz for number in multiples]
    for peak in _peaks(order_map, reach):
        low, high = float(axis[peak]) - reach, float(axis[peak]) + reach
        if not doubtful(low, high) and not any(low <= order <= high for order in of_mains):
            continue
        orders = orders_between(low, high)
        if leave_noise(held, low, high, orders):
            continue
        inside = lines_within(held, low, high)
        if len(inside) > max(len(orders), 1) and not _is_modulated(inside):
            close.append(CloseLines(low, high, held, tuple(inside)))
    return close


def lines_within(held: HeldFrames, low: float, high: float) -> list[Sighting]:
    """Lines of ``held`` from ``low`` to ``high``; those beyond that reach into it take part."""
    if not held.reaches(low, high):
        return []
    beyond = LOBE_BINS / held.revs
    return [line for line in several_lines(held, low, high, beyond=beyond) if low <= line.order <= high]


def _is_modulated(lines: Sequence[Sighting]) -> bool:
    """Whether ``lines`` are pairs about the strongest, as one line makes them whose size or angle changes."""
    strongest = max(lines, key=lambda line: line.sigmas)
    rest = [line for line in lines if line is not strongest]

    def mirrored(line: Sighting, other: Sighting) -> bool:
        """Whether both stand as far away and are of one size, as far as their errors and a changing speed tell."""
        off = abs(other.order - strongest.order + (line.order - strongest.order))
        room = NUMBERS.same_sigmas * np.hypot(line.error, other.error)
        room = room + NUMBERS.alike_share * np.maximum(line.amplitude, other.amplitude)
        alike = bool((np.abs(line.amplitude - other.amplitude) <= room).all())
        return alike and bool(off < NUMBERS.same_sigmas * np.hypot(line.order_error, other.order_error))

    return all(any(mirrored(line, other) for other in rest) for line in rest)


def _peaks(order_map: xr.Dataset, reach: float) -> list[int]:
    """Bins that stand far over the level about them in a channel and are the largest within ``reach`` orders."""
    power = np.square(np.nan_to_num(order_map["amplitude"].values[:, 0].astype(np.float64)))
    bins = max(1, round(reach / float(order_map["order"].values[1] - order_map["order"].values[0])))
    wide = np.pad(power, ((0, 0), (NUMBERS.level_bins, NUMBERS.level_bins)), mode="reflect")
    level = np.median(np.lib.stride_tricks.sliding_window_view(wide, 2 * NUMBERS.level_bins + 1, axis=1), axis=2)
    over = (power / np.maximum(level, 1e-300)).max(axis=0)
    peaks = (over >= largest_within(over, bins)) & (over > NUMBERS.stands_over_ratio)
    return list(map(int, np.flatnonzero(peaks)))


def lines_of_sightings(
    seen: Sequence[tuple[HeldFrames, Sighting]], number: tuple[float, float], order_map: xr.Dataset
) -> tuple[OrderLine, ...]:
    """Line of a ``number`` (order and its standard error) in each channel that shows it, as recordings hold it.

    ``seen`` are these, each with its sighting; rows and speeds are those of the OrderMap ``order_map``.
    """
    speed = np.asarray(order_map["speed"].values, dtype=np.float64)
    rows = {int(np.nanargmin(np.abs(speed - held.rpm))): sighting for held, sighting in seen}
    freedom, lines = min(sighting.degrees_of_freedom for _, sighting in seen), list[OrderLine]()
    for k, name in enumerate(seen[0][0].channels):
        clear = [row for row, sighting in sorted(rows.items()) if sighting.amplitude[k] > Z95 * sighting.error[k]]
        size, error = (np.array([getattr(rows[row], key)[k] for row in clear]) for key in ("amplitude", "error"))
        if clear:
            lines.append(OrderLine.steady(name, number, (np.array(clear), speed[clear], size, error), freedom))
    return tuple(lines)
