"""Orders of a test at one speed where more lines stand within a bin than steadiness and beat part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from crankorder.identify.found import OrderLine
from crankorder.identify.intervals import Z95
from crankorder.identify.lines.known_lines import (
    LOBE_BINS,
    Held,
    Place,
    Sighting,
    bins_of,
    data_of,
    held_recordings,
    noise_beside,
    waves_of,
)
from crankorder.identify.lines.known_lines import NUMBERS as KNOWN_LINES
from crankorder.identify.lines.line_phasors import Recording
from crankorder.identify.lines.mains import NUMBERS as MAINS
from crankorder.identify.lines.order_lines import NUMBERS as ORDER_LINES
from crankorder.identify.lines.order_lines import ONE_SPEED, largest_within
from crankorder.orders.track_rows import hann_lobe
from crankorder.quantities import Bools, Complexes, Floats, Ints
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-lines.toml", "several_orders")

PADDED = 4
"""Trial places per reciprocal length of the recording: a line between two of them loses 10 % at most."""

STEPS = 15
"""Gauss-Newton steps: a start within a quarter of a cycle of the recording needs five."""

SETTLED = 1e-6
"""Cycles over the recording by which a step moves lines that are found."""

LONGEST_STEP = 0.25
"""Cycles over the recording by which a step moves a line at most."""


@dataclass(frozen=True, eq=False)
class _Fit:
    """Lines at ``places`` in data: amplitudes (lines, channels), what is ``left``, and the normal matrix of places."""

    places: tuple[Place, ...]
    amplitude: Complexes
    left: Complexes
    normal: Floats
    waves: Complexes


def several_lines(held: Held, low: float, high: float, *, beyond: float = 0.0) -> list[Sighting]:
    """Lines of ``held`` between the orders ``low`` and ``high``, lowest first; none where they do not leave noise.

    One after the other, the strongest first, each time all of them solved together by least squares over frames and
    bins, until nothing that is left stands over the noise beside it. Where something is left that no farther line is,
    within a beat of one that was found or after as many as there may be, that is no set of steady lines, or the
    recording does not part them: nothing is told. Lines that stand ``beyond`` orders farther off at most take part.
    """
    bins = bins_of(held, np.array([low, high]))
    if not len(bins) or len(held.turn) < 8:
        return []
    data = data_of(held, bins)
    weight = 1.0 / np.maximum(np.square(np.abs(data)).mean(axis=0), 1e-300)
    waves = np.zeros((len(data), 0), dtype=np.complex128)
    fit = _Fit((), np.zeros((0, data.shape[1]), dtype=np.complex128), data, np.zeros((0, 0)), waves)
    while len(fit.places) < NUMBERS.most_lines:
        scored = _scores(held, bins, fit.left, low - beyond, high + beyond)
        if scored is None:
            return []
        joined = _joined(held, bins, data, weight, fit, float(scored[0][int(np.argmax(scored[1]))]))
        lines = _with_errors(held, bins, joined)
        new, size = lines[-1], np.array([float((line.amplitude * np.sqrt(weight)).max()) for line in lines])
        away = np.abs([line.order - new.order for line in lines[:-1]]) * held.span_rev
        beside = size[:-1][away < KNOWN_LINES.apart_cycles].max(initial=0.0)
        least = max(NUMBERS.smallest_share * size.max(), NUMBERS.unsteady_share * beside)
        if new.sigmas <= KNOWN_LINES.seen_sigmas or size[-1] < least:
            rest = NUMBERS.unsteady_share if beside and new.sigmas > KNOWN_LINES.seen_sigmas else 0.0
            lines = _with_errors(held, bins, fit, rest)
            noise = lines and _is_noise(held, bins, fit.left, np.array([line.amplitude for line in lines]))
            return sorted(lines, key=lambda line: line.order) if noise else []
        orders = np.sort([line.order for line in lines])
        if len(orders) > 1 and np.diff(orders).min() * held.span_rev < KNOWN_LINES.apart_cycles:
            return []
        fit = joined
    return []


def leave_noise(held: Held, low: float, high: float, orders: Sequence[float]) -> bool:
    """Whether lines at ``orders`` of ``held`` are all that stands between the orders ``low`` and ``high``."""
    bins = bins_of(held, np.array([low, high]))
    if not len(bins) or not len(orders):
        return False
    data, waves = data_of(held, bins), waves_of(held, bins, [(0.0, order) for order in orders])
    amplitude = np.linalg.lstsq(waves, data, rcond=None)[0]
    return _is_noise(held, bins, data - waves @ amplitude, np.abs(amplitude))


def _is_noise(held: Held, bins: Ints, left: Complexes, amplitude: Floats) -> bool:
    """Whether lines of an ``amplitude`` (lines, channels) have ``left`` no more than stands beyond the ``bins``.

    Of the channels in which one of them stands out; False where none does.
    """
    largest, floor = np.square(amplitude).max(axis=0), _floor(held, bins)
    shown = _shown(held, bins, amplitude)
    over = np.square(np.abs(left)).reshape(len(held.turn), len(bins), -1).mean(axis=0).max(axis=0) / floor
    return bool(shown.any() and (over < NUMBERS.left_ratio + NUMBERS.left_share**2 * largest / floor)[shown].all())


def unparted_reach(held: Held, low: float, high: float, orders: Sequence[float]) -> tuple[float, float] | None:
    """Orders between which lie lines that ``held`` does not part; None where ``orders`` hold most of what is there.

    Lines that beat hardly once within a recording are no set that a fit could tell, nor is what is left beside one of
    them noise: they are somewhere where a line would take a good part of what the best one takes, between ``low`` and
    ``high``.
    """
    bins = bins_of(held, np.array([low, high]))
    if not len(bins) or len(held.turn) < 8:
        return None
    data = data_of(held, bins)
    scored = _scores(held, bins, data, low, high)
    if scored is None:
        return None
    trial, score = scored
    strongest = waves_of(held, bins, [(0.0, float(trial[int(np.argmax(score))]))])
    size = np.abs(np.linalg.lstsq(strongest, data, rcond=None)[0])
    if not _shown(held, bins, size).any():
        return None
    if orders:
        waves = waves_of(held, bins, [(0.0, order) for order in orders])
        left = data - waves @ np.linalg.lstsq(waves, data, rcond=None)[0]
        lost = np.square(np.abs(left)).sum(axis=0) / np.maximum(np.square(np.abs(data)).sum(axis=0), 1e-300)
        if lost.min() < NUMBERS.unparted_share:
            return None
    near = trial[score >= NUMBERS.unparted_share * score.max()]
    return float(near.min()), float(near.max())


def _floor(held: Held, bins: Ints) -> Floats:
    """Median power (channels,) of the bins beside ``bins``."""
    power = np.square(np.abs(held.spectrum)).mean(axis=1)
    first, last = int(bins[0]) - NUMBERS.beside_bins, int(bins[-1]) + NUMBERS.beside_bins
    wide = np.arange(max(first, 1), min(last + 1, power.shape[1]))
    return np.asarray(np.maximum(np.median(power[:, wide[~np.isin(wide, bins)]], axis=1), 1e-300))


def _shown(held: Held, bins: Ints, amplitude: Floats) -> Bools:
    """In which channels one ``amplitude`` of several (lines, channels) stands out of what is beside the ``bins``."""
    return np.asarray(np.square(amplitude).max(axis=0) > NUMBERS.stands_over_ratio * _floor(held, bins))


def _scores(held: Held, bins: Ints, left: Complexes, low: float, high: float) -> tuple[Floats, Floats] | None:
    """Orders (trials,) between ``low`` and ``high``, and the share of what is ``left`` that a line at each takes."""
    hop = float(np.median(np.diff(held.turn)))
    slot = np.rint((held.turn - held.turn[0]) / hop).astype(np.int64)
    n = PADDED * (int(slot[-1]) + 1)
    n += n % 2
    phasors = np.zeros((n, len(bins), left.shape[1]), dtype=np.complex128)
    phasors[slot] = left.reshape(len(held.turn), len(bins), -1)
    spectrum = np.fft.fft(phasors, axis=0)
    trial = np.arange(np.ceil(low * n * hop), np.floor(high * n * hop) + 1.0) / (n * hop)
    if len(trial) < 3:
        return None
    total = np.zeros((len(trial), left.shape[1]), dtype=np.complex128)
    gain = np.zeros(len(trial))
    for number, at in enumerate(held.axis[bins]):
        shape = hann_lobe((trial - at) * held.revs)
        index = np.rint((trial - at) * n * hop).astype(np.int64) % n
        phase = np.exp(-2j * np.pi * (trial - at) * held.turn[0])
        total += (shape * phase)[:, None] * spectrum[index, number]
        gain += shape**2
    power = np.square(np.abs(total)) / np.maximum(gain, 1e-12)[:, None]
    score = (power / np.maximum(np.square(np.abs(left)).sum(axis=0), 1e-300)).sum(axis=1)
    return trial, np.asarray(score)


def _joined(held: Held, bins: Ints, data: Complexes, weight: Floats, fit: _Fit, order: float) -> _Fit:
    """``fit`` with one line more near ``order``, all solved together; as an order or a fixed frequency, what fits."""
    kinds: list[Place] = [(0.0, order)]
    apart = held.time_s * held.rpm / 60.0 - (held.turn - held.turn[0])
    if order * float(np.ptp(apart)) > NUMBERS.wander_cycles:
        kinds.append((order * held.rpm / 60.0, 0.0))
    fits = [_solved(held, bins, data, weight, (*fit.places, kind)) for kind in kinds]
    return min(fits, key=lambda wider: float(np.square(np.abs(wider.left)).sum()))


def _solved(held: Held, bins: Ints, data: Complexes, weight: Floats, places: tuple[Place, ...]) -> _Fit:
    """Least squares of lines near ``places``: amplitudes follow linearly from these (Golub and Pereyra 1973)."""
    span = held.span_rev
    for step in range(STEPS + 1):
        waves = waves_of(held, bins, places)
        inverse = np.linalg.pinv(waves)
        amplitude = inverse @ data
        left = data - waves @ amplitude
        slopes = (waves_of(held, bins, _moved(held, places, np.full(len(places), 1e-3 / span))) - waves) * (1e3 * span)
        change = slopes.T[:, :, None] * amplitude[:, None, :]
        taken = np.einsum("ln,knc->klc", inverse, change)
        change = change - np.einsum("nl,klc->knc", waves, taken)
        scaled = (change * np.sqrt(weight)).reshape(len(places), -1)
        normal = (scaled.conj() @ scaled.T).real
        fit = _Fit(places, amplitude, left, normal, waves)
        if step == STEPS:
            break
        score = (scaled.conj() @ (left * np.sqrt(weight)).ravel()).real
        moves = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(len(places)), score)
        if np.abs(moves).max() * span < SETTLED:
            break
        places = _moved(held, places, np.clip(moves, -LONGEST_STEP / span, LONGEST_STEP / span))
    return fit


def _moved(held: Held, places: tuple[Place, ...], orders: Floats) -> tuple[Place, ...]:
    """``places``, each moved by so many ``orders``."""
    return tuple(
        (hertz + by * held.rpm / 60.0, turns) if hertz else (0.0, turns + by)
        for (hertz, turns), by in zip(places, orders.tolist(), strict=True)
    )


def _with_errors(held: Held, bins: Ints, fit: _Fit, rest: float = 0.0) -> list[Sighting]:
    """The lines of ``fit`` with their errors, by the noise beside each and by what its neighbours take of it.

    ``rest`` is the share of a line that is left beside it.
    """
    if not fit.places:
        return []
    orders = np.array([held.order_of(place) for place in fit.places])
    by_size = np.diag(np.linalg.pinv((fit.waves.conj().T @ fit.waves).real))
    by_size = np.sqrt(np.maximum(by_size * np.square(np.abs(fit.waves)).sum(axis=0), 1.0))
    by_place = np.sqrt(np.maximum(np.diag(np.linalg.pinv(fit.normal)) * np.diag(fit.normal), 1.0))
    lines = []
    for number, place in enumerate(fit.places):
        alone = noise_beside(held, bins, place, fit.left, orders, median=True)
        size = np.abs(fit.amplitude[number])
        sigmas = float(np.max(size / np.maximum(alone, 1e-300)))
        cycles = np.sqrt(6.0) / (np.pi * sigmas) * float(by_place[number])
        error = float(np.hypot(cycles, max(NUMBERS.least_cycles, 0.5 * rest))) / held.span_rev
        lines.append(Sighting(float(orders[number]), size, alone * float(by_size[number]), error))
    return lines


DEGREES_OF_FREEDOM = 40.0
"""Degrees of freedom of an error that some 24 places beside a line tell."""

SOLVED = "lines within a quarter order, solved together"
"""Words, after their number, of lines that were told apart so."""


@dataclass(frozen=True, eq=False)
class CloseLines:
    """Lines ``solved`` between the orders ``low`` and ``high`` of a recording of ``span_rev`` revolutions."""

    low: float
    high: float
    span_rev: float
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
    held = max(held_recordings(recordings, axis, names), key=lambda recording: recording.span_rev, default=None)
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
            close.append(CloseLines(low, high, held.span_rev, tuple(inside)))
    return close


def lines_within(held: Held, low: float, high: float) -> list[Sighting]:
    """Lines of ``held`` from ``low`` to ``high``; those beyond that reach into it take part."""
    beyond = LOBE_BINS / held.revs
    if low - beyond <= 0.0 or high + beyond >= held.axis[-1]:
        return []
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


def lines_at(solved: Sighting, order_map: xr.Dataset) -> list[OrderLine]:
    """The line ``solved`` in each channel of ``order_map`` that shows it."""
    rpm, number = np.asarray(order_map["speed"].values, dtype=np.float64), (solved.order, solved.order_error)
    numbers = order_map["channel"].values, solved.amplitude.tolist(), solved.error.tolist()
    return [
        replace(OrderLine.steady(str(name), number, rows, DEGREES_OF_FREEDOM), doubts=(ONE_SPEED,))
        for name, size, error in zip(*numbers, strict=True)
        if size > Z95 * error
        for rows in [(np.array([0]), rpm, np.array([size]), np.array([error]))]
    ]
