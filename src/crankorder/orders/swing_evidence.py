"""Error of the crank angle told from the sidebands of all strong orders together: one ratio for all, or none.

Each order m that lies k from strong ones either is a line of its own, with any amplitude and phase, or it is what the
angle's error makes of its neighbours: then its ratio z to that is 1, in every channel and at every speed. The two are
weighed for every E_k at once. Two things look alike: a shaft that really swings, whose lines a mode lifts and their
sidebands not, and a wheel of teeth that is set off. So the pulses themselves have to show the same error, of one size
and phase at all speeds, and more than one carrier has to agree with them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from crankorder.orders.averages import median_of_known
from crankorder.quantities import Complexes, Floats, Ints
from crankorder.settings import OrderSettings

HARMONICS = (1, 2, 3, 4, 5, 6)
"""Swings of the angle per turn that are looked for: eccentricity, ovality, and lines that are uneven."""

REACH_95 = 2.45
"""Standard errors of each part within which both together lie with a chance of 95 %."""

TURN = np.arange(64) / 64
"""Points of a turn at which the modulation is sampled."""

STEPS = 4
"""Steps by which the true angle is found from the one shown: each leaves less than a tenth."""

LEAST_SHARE = 1e-7
"""Sidebands smaller than this share of their line are left alone."""


LEAST_REVS = 8
"""Revolutions of a frame below which the noise between half orders is not told."""

ROUNDS = 3
"""Times that E_k is told from what the last one left."""

LIKELY = 3.0
"""Standard errors from which an E_k is taken out on trial, and within which two of them are one."""

LEAST_ERROR_REV = 1e-7
"""Of a swing that pulses show: their times are no finer."""

WORST_CONDITION = 1e9
"""Of the normal equations of what is the same at all speeds and what falls: beyond, the speeds are one."""

TEETH_LARGEST = 3.0
"""Times the root of its mean square that a harmonic of teeth which sit wrongly may have: by chance one in 8000 more."""

RADII, PHASES = np.geomspace(2e-4, 1.0, 72), np.exp(2j * np.pi * np.arange(40) / 40)
"""Grid of E_k, over the largest, over which the odds are summed …"""

GRID_SLACK = 0.1
"""… and the share of E_k by which its points are apart, about."""

CLEAR_SIDEBAND, MOST_LACKING = 64.0, 0.1
"""Power over the noise of a sideband that must be there, and the share of these that lines of their own may cancel."""

SLACKS = (0.15, 0.1, 0.06)
"""Shares of a sideband by which it may be off, step by step, while E_k is refined …"""

LAST_STEPS = 9
"""… and steps with the share that is allowed in the end."""


class Swing(NamedTuple):
    """Error of the crank angle that repeats ``harmonic`` times per revolution: ``size`` E_k [rev] and its certainty.

    ``error_rev`` is the standard error of each part of ``size``, ``bound_rev`` the value that |E_k| exceeds with a
    chance of 5 %. ``proved`` says whether several carriers agree on it, ``chance`` is the probability that they would
    by chance, ``carriers`` are the orders whose sidebands show it, strongest first; ``largest_rev`` is an error that no
    encoder reaches. ``lacking`` holds how many of the sidebands that it would raise out of the noise are missing, and
    of how many.
    """

    harmonic: int
    size: complex
    error_rev: float
    bound_rev: float
    proved: bool
    chance: float
    carriers: tuple[float, ...]
    largest_rev: float
    lacking: tuple[int, int] = (0, 0)

    @property
    def left_rev(self) -> float:
        """Value [rev] that the remaining |E_k| exceeds with a chance of 5 %, after ``size`` was removed where proved.

        Where a single carrier shows it, as on an eccentric wheel, it may still be an error of the angle.
        """
        if self.proved:
            return REACH_95 * self.error_rev
        shown = abs(self.size) + REACH_95 * self.error_rev if self.carriers else 0.0
        return max(self.bound_rev, shown) if shown < self.largest_rev else self.bound_rev


def true_angle(shown: Floats, swings: dict[int, complex]) -> Floats:
    """True angle [rev] (angles,) at the angle ``shown`` [rev] (angles,) by an encoder of the ``swings``.

    ``swings`` are E_k [rev] by harmonic k: the encoder shows Re Σ E_k exp(2πi k angle) too much.
    """
    true = shown
    for _ in range(STEPS if swings else 0):
        true = shown - _error(true, swings)
    return np.asarray(true)


def _error(angle: Floats, swings: dict[int, complex]) -> Floats:
    """Angle shown less the true one [rev] at the true ``angle`` [rev]."""
    size, harmonic = np.array(list(swings.values())), np.array(list(swings))
    return np.asarray((size * np.exp(2j * np.pi * harmonic * angle[:, None])).real.sum(axis=1))


def modulation(error: Floats, order: Floats) -> tuple[Ints, Complexes]:
    """Shifts q (shifts,), in orders, and coefficients g_q (shifts, orders) of lines seen in an angle with an error.

    ``error`` (points,) [rev] is that of the lines' own angle at even points of a revolution of the other one,
    ``order`` (orders,) the order of each line.
    """
    n = len(error)
    spectrum = np.fft.fft(np.exp(2j * np.pi * order[:, None] * error), axis=1) / n
    shift = np.fft.fftfreq(n, 1.0 / n).astype(np.int64)
    matters = np.abs(spectrum).max(axis=0) > LEAST_SHARE
    return shift[matters], spectrum.T[matters]


def in_true_angle(spectrum: Complexes, *, bins_per_order: int, swings: dict[int, complex]) -> Complexes:
    """``spectrum`` (…, orders) in the shown angle, transformed to the true angle, of the same shape.

    The axis begins at order 0 and has ``bins_per_order`` bins per order. NaN stays NaN and adds nothing to its
    neighbours, nor do orders above the axis. ``swings`` are E_k [rev] by harmonic k.
    """
    n = spectrum.shape[-1]
    known = np.isfinite(spectrum.real)
    whole = np.where(known, spectrum, 0.0)
    # lines below order 0 are those above it, turned the other way
    below = min(len(TURN) // 2 * bins_per_order, n - 1)
    both = np.concatenate([whole[..., below:0:-1].conj(), whole], axis=-1)
    made = np.zeros(spectrum.shape, dtype=np.complex128)
    for q, gain in zip(*modulation(_error(TURN, swings), np.arange(-below, n) / bins_per_order), strict=True):
        first = below - int(q) * bins_per_order
        if first >= 0:
            moved = both[..., first : first + n] * gain[first : first + n]
            made[..., : moved.shape[-1]] += moved
    return np.where(known, made, np.nan)


def given_by_neighbours(amplitude: Floats, *, bins_per_order: int, left_rev: dict[int, float]) -> Floats:
    """Largest amplitude (…, orders) that swings of the angle add to each order from the orders beside it.

    ``amplitude`` (…, orders) is that of the orders, on an axis with ``bins_per_order`` as in :func:`in_true_angle`;
    ``left_rev`` is the largest amplitude [rev] of the swing by harmonic. The two sides may add up; harmonics, and the
    loss of the line itself, are added by their squares.
    """
    n = amplitude.shape[-1]
    turned = np.nan_to_num(amplitude) * (np.pi * np.arange(n) / bins_per_order)
    total = np.zeros(amplitude.shape)
    for harmonic, size in left_rev.items():
        step = harmonic * bins_per_order
        total += np.square(size * (_moved(turned, step) + _moved(turned, -step)))
        total += np.square(np.square(size * turned) / np.maximum(np.nan_to_num(amplitude), 1e-300))
    return np.asarray(np.sqrt(total))


def _moved(values: Floats, step: int) -> Floats:
    """``values`` (…, orders) of the order ``step`` bins below (above, where it is negative); mirrored below 0."""
    n = values.shape[-1]
    source = np.abs(np.arange(n) - step)
    return np.where(source < n, values[..., np.minimum(source, n - 1)], 0.0)


class Rows(NamedTuple):
    """Complex amplitudes ``value`` (rows, half orders) and their ``noise`` power, of the same shape.

    A row is a channel in a recording, or in a frame of a sweep.
    """

    value: Complexes
    noise: Floats


class Expected(NamedTuple):
    """What is assumed of an encoder before its frames are looked at: ``settings`` of orders, and errors of its teeth.

    ``tooth_level_rev`` is the root of the mean square amplitude [rev] that misplaced teeth give to each harmonic.
    """

    settings: OrderSettings
    tooth_level_rev: float = 0.0

    def usual_rev(self, harmonic: int) -> float:
        """Standard deviation [rev] of each part of E_k at a ``harmonic``."""
        mounted = self.settings.usual_eccentricity_deg / 360.0 / harmonic**2
        return max(mounted, self.tooth_level_rev / math.sqrt(2.0))

    def largest_rev(self, harmonic: int) -> float:
        """Largest error [rev] at a ``harmonic``: that of mounting falls with its square, that of teeth does not."""
        mounted = self.settings.largest_eccentricity_deg / 360.0 / harmonic**2
        return max(mounted, TEETH_LARGEST * self.tooth_level_rev)


@dataclass(frozen=True)
class _Sums:
    """Of each target (targets,), sums over the rows, over the noise: of squares and products of target and sides.

    ``below``, ``above``: |u|², |v|² of what E_k and its conjugate multiply; ``both``: u conj(v); ``low``, ``high``:
    conj(u) y, conj(v) y; ``own``: |y|²; ``count``: rows; ``carrier``: the order that gives most.
    """

    below: Floats
    above: Floats
    both: Complexes
    low: Complexes
    high: Complexes
    own: Floats
    count: Floats
    carrier: Floats


def rows_of(frames: Sequence[xr.Dataset]) -> Rows | None:
    """Rows (rows, half orders) of OrderFrames ``frames`` with one mark of the crank; None where all are too short."""
    values, noises = [], []
    for item in frames:
        revs = int(item.attrs["revs_per_frame"])
        spectrum = item["spectrum"].values
        if revs % 2 or revs < LEAST_REVS or not spectrum.shape[1]:
            continue
        half = revs // 2
        # bins between the half orders, group by group, above each half order
        first = max(2, half // 4) if half > 4 else half // 2
        groups = np.arange(0, spectrum.shape[2], half)[:, None] + first + np.arange(_per_half(half))
        between = spectrum[..., groups[groups.max(axis=1) < spectrum.shape[2]].ravel()]
        grid = np.asarray(spectrum[..., ::half], dtype=np.complex128)
        power = np.square(np.abs(between.reshape(*between.shape[:2], -1, _per_half(half))))
        if not power.size:
            continue
        noise = median_of_known(power, axis=-1) / np.log(2.0)  # mean of exponential powers
        n = min(grid.shape[2], noise.shape[2])
        grid, noise = grid[..., :n], noise[..., :n]
        if not item.attrs.get("swept", 0):
            grid, noise = _mean_of_frames(grid, noise)
        values.append(grid.reshape(-1, n))
        noises.append(noise.reshape(-1, n))
    if not values:
        return None
    n = min(value.shape[1] for value in values)
    return Rows(np.concatenate([v[:, :n] for v in values]), np.concatenate([v[:, :n] for v in noises]))


def _mean_of_frames(grid: Complexes, noise: Floats) -> tuple[Complexes, Floats]:
    """Means over the frames (channels, 1, half orders) and the noise in them; frames overlap by half."""
    kept = np.isfinite(grid.real) & np.isfinite(noise)
    count = kept.sum(axis=1, keepdims=True)
    many = np.maximum(count, 1)
    mean = np.where(count > 0, np.where(kept, grid, 0.0).sum(axis=1, keepdims=True) / many, np.nan)
    power = np.where(kept, noise, 0.0).sum(axis=1, keepdims=True) / many * np.minimum(2.0 / many, 1.0)
    return mean, np.where(count > 0, power, np.inf)


def _per_half(half: int) -> int:
    """Bins between two half orders, ``half`` bins apart, that lines on both leave alone."""
    return max(1, half - 2 * max(2, half // 4) + 1)


def swings_of(rows: Rows, expected: Expected, by_pulses: Mapping[int, tuple[complex, float]]) -> tuple[Swing, ...]:
    """Errors of the angle by harmonic, from the ``rows`` of a test and what is ``expected`` of its encoder.

    ``by_pulses`` are the errors [rev] that the pulses show by harmonic, from :func:`alike_at_all_speeds`. Other
    harmonics have only a bound: modes make similar sidebands where the shaft really swings.
    """
    taken: dict[int, complex] = {}
    swings: dict[int, Swing] = {}
    for _ in range(ROUNDS):
        for harmonic in HARMONICS:
            size, error = by_pulses.get(harmonic, (0j, np.inf))
            swing = _swing(rows, harmonic, taken, expected, shown=size)
            reach = LIKELY * math.hypot(error, swing.error_rev, expected.settings.sideband_slack * abs(size))
            alike = abs(size) > LIKELY * error and abs(size - swing.size) < reach
            lacking = _lacking(rows, harmonic, taken, expected, size) if abs(size) > LIKELY * error else (0, 0)
            swings[harmonic] = swing._replace(proved=swing.proved and alike, lacking=lacking)
            taken.pop(harmonic, None)
            # what is likely but not proved is taken out on trial: sidebands of sidebands hide others' proof
            if abs(swing.size) > LIKELY * swing.error_rev and abs(swing.size) <= expected.largest_rev(harmonic):
                taken[harmonic] = swing.size
        if not taken:
            break
    return tuple(swings[k] for k in HARMONICS)


def alike_at_all_speeds(shown: Complexes, *, slack: float) -> dict[int, tuple[complex, float]]:
    """Part [rev], by harmonic, of the swing of the angle that is the same at all speeds, and the error of its parts.

    An encoder errs by the same angle at every speed; the rest, such as the swing from gas torque, falls with the square
    of the speed. ``shown`` (speeds, 1 + harmonics) holds the speed [rpm] and the swing [rev] that the pulses show
    there, exact to the share ``slack``. The result is empty where too few speeds tell the two apart.
    """
    parts: dict[int, tuple[complex, float]] = {}
    speed, *sizes = shown.T
    design = np.column_stack([np.ones(len(speed)), (speed.real.min(initial=np.inf) / speed.real) ** 2])
    for harmonic, size in zip(HARMONICS, sizes, strict=True):
        weight = 1.0 / (np.square(slack * np.abs(size)) + LEAST_ERROR_REV**2)
        normal = (design.T * weight) @ design
        if len(speed) > 1 and np.linalg.cond(normal) < WORST_CONDITION:
            inverse = np.linalg.inv(normal)
            fitted = inverse @ (design.T @ (weight * size))
            off = float(weight @ np.square(np.abs(size - design @ fitted))) / max(2.0 * len(speed) - 4.0, 1.0)
            parts[harmonic] = complex(fitted[0]), math.sqrt(inverse[0, 0] * max(1.0, off))
    return parts


def _swing(rows: Rows, harmonic: int, taken: dict[int, complex], expected: Expected, *, shown: complex) -> Swing:
    """E_k of one ``harmonic``, told from what is left where all that is ``taken``, by harmonic, is taken out.

    It is proved by those sidebands that agree with what the pulses have ``shown`` [rev].
    """
    value = in_true_angle(rows.value, bins_per_order=2, swings=taken) if taken else rows.value
    known = taken.get(harmonic, 0j)
    sums = _put_back(_sums(value, rows.noise, harmonic, expected), known)
    radius = RADII * expected.largest_rev(harmonic)
    grid = (radius[:, None] * PHASES).ravel()
    settings = expected.settings
    gain = _gains(sums, grid, settings, slack=GRID_SLACK)
    total = gain.sum(axis=1) - 0.5 * np.square(np.abs(grid) / expected.usual_rev(harmonic))
    best = int(np.argmax(total))
    size, error, weights = _refined(sums, complex(grid[best]), settings)
    gain_here = _gains(sums, np.array([shown or size]), settings, slack=settings.sideband_slack)[0]
    of_carrier = [float(gain_here[sums.carrier == number].sum()) for number in set(sums.carrier.tolist())]
    proof = sum(of_carrier) - max(of_carrier, default=0.0)
    chance = float(np.exp(-min(max(proof, 0.0), 700.0)))
    # cells of a polar grid, even in the logarithm of the radius
    posterior = np.exp(total - total.max()).reshape(len(RADII), -1).sum(axis=1) * np.square(radius)
    reach = np.cumsum(posterior / posterior.sum())
    bound = float(radius[min(int(np.searchsorted(reach, 0.95)), len(RADII) - 1)])
    agreed = [float(c) for c, w, g in zip(sums.carrier, weights, gain_here, strict=True) if w > 0.5 and g > 1.0]
    carriers = tuple(sorted(set(agreed), key=lambda c: -float(gain_here[sums.carrier == c].sum())))
    largest = expected.largest_rev(harmonic)
    proved = proof > settings.encoder_proof and len(carriers) > 1 and 3.0 * error < abs(size) < largest
    return Swing(harmonic, size, error, bound, bool(proved), chance, carriers, largest)


def _sides(
    value: Complexes, noise: Floats, harmonic: int, expected: Expected
) -> tuple[Complexes, Complexes, Complexes, Floats]:
    """Lines of ``value`` (rows, half orders), what E_k of the ``harmonic`` multiplies, its conjugate, and weights.

    All (rows, half orders); weights are 1 over the ``noise``, 0 where a neighbour as ``expected`` is not known.
    """
    n = value.shape[1]
    step = 2 * harmonic
    room = max(n - step, 0)  # a map of few orders has no neighbour for a high harmonic
    order = np.arange(n) / 2.0
    seen = np.where(np.isfinite(value.real), value, 0.0)
    # noise is no line: it lies in the angle shown as it does in the true one, and has no sidebands
    known = np.isfinite(value.real) & np.isfinite(noise)
    power, least = (np.where(known, size, 0.0).sum(axis=0) for size in (np.square(np.abs(value)), noise))
    line = np.where(power > expected.settings.carrier_over_noise * least, seen, 0.0)
    u, v = np.zeros_like(seen), np.zeros_like(seen)
    u[:, step:] = line[:, :room] * order[:room]
    # order m - k below 0 is the line above it, turned the other way
    for place in range(1, min(step, n)):
        u[:, place] = -order[step - place] * line[:, step - place].conj() if step - place < n else 0.0
    v[:, :room] = line[:, step:] * order[step:]
    weight = np.where(np.isfinite(value.real) & (noise > 0.0), 1.0 / np.where(noise > 0.0, noise, 1.0), 0.0)
    weight[:, room:] = weight[:, :1] = 0.0  # what lies above is not known
    return seen, -1j * np.pi * u, -1j * np.pi * v, weight


def _sums(value: Complexes, noise: Floats, harmonic: int, expected: Expected) -> _Sums:
    """Sums over the rows for every target that ``value`` (rows, half orders) has a neighbour for, as ``expected``."""
    seen, u, v, weight = _sides(value, noise, harmonic, expected)
    order = np.arange(value.shape[1]) / 2.0
    below, above, own = (np.asarray((weight * np.abs(part) ** 2).sum(axis=0)) for part in (u, v, seen))
    kept = (below + above) * expected.largest_rev(harmonic) ** 2 > 10.0
    carrier = np.where(below > above, np.abs(order - harmonic), order + harmonic)
    products = (u * v.conj(), u.conj() * seen, v.conj() * seen)
    both, low, high = ((weight * part).sum(axis=0)[kept] for part in products)
    count = (weight > 0.0).sum(axis=0).astype(np.float64)
    return _Sums(below[kept], above[kept], both, low, high, own[kept], count[kept], carrier[kept])


def _lacking(
    rows: Rows, harmonic: int, taken: dict[int, complex], expected: Expected, size: complex
) -> tuple[int, int]:
    """Of the sidebands that E_k of ``size`` makes clear of the noise, how many lack by half; and with those alike.

    Row by row. Other swings that are ``taken`` are out.
    """
    others = {k: other for k, other in taken.items() if k != harmonic}
    value = in_true_angle(rows.value, bins_per_order=2, swings=others) if others else rows.value
    seen, u, v, weight = _sides(value, rows.noise, harmonic, expected)
    sideband = size * u + np.conj(size) * v
    clear = np.square(np.abs(sideband)) * weight > CLEAR_SIDEBAND
    alike = clear & (np.abs(seen - sideband) < 0.5 * np.abs(sideband))
    lacking = clear & (np.abs(seen) < 0.5 * np.abs(sideband))
    return int(lacking.sum()), int((alike | lacking).sum())


def unless_lines_lack(of: Mapping[str, tuple[Swing, ...]]) -> dict[str, tuple[Swing, ...]]:
    """Swings ``of`` the recordings of one encoder, unproved where too many of all lines lack their sidebands.

    An error of the encoder gives sidebands to every line; those of a real swing of the shaft pass through the modes.
    """
    counts = np.array([[swing.lacking for swing in own] for own in of.values()]).reshape(len(of), -1, 2).sum(axis=0)
    spares = counts[:, 0] > MOST_LACKING * counts[:, 1]
    return {
        name: tuple(s._replace(proved=s.proved and not no) for s, no in zip(own, spares.tolist(), strict=True))
        for name, own in of.items()
    }


def _put_back(sums: _Sums, known: complex) -> _Sums:
    """``sums`` with sidebands as measured: targets have those of ``known``, taken out before, again to first order."""
    low = sums.low + known * sums.below + np.conj(known) * np.conj(sums.both)
    high = sums.high + known * sums.both + np.conj(known) * sums.above
    own = sums.own + _power(sums, known) + 2.0 * _product(sums, known).real
    return replace(sums, low=low, high=high, own=own)


def _power(sums: _Sums, size: complex | Complexes) -> Floats:
    """Sum of |p|² over the noise, p = size u + conj(size) v; (…, targets) for ``size`` (…, 1)."""
    return np.asarray(np.abs(size) ** 2 * (sums.below + sums.above) + 2.0 * (np.square(size) * sums.both).real)


def _product(sums: _Sums, size: complex | Complexes) -> Complexes:
    """Sum of conj(p) y over the noise."""
    return np.asarray(np.conj(size) * sums.low + size * sums.high)


def _seen_of(sums: _Sums, size: complex | Complexes) -> tuple[Floats, Complexes, Floats]:
    """Power of what E_k of ``size`` makes of each target, how much of that is seen, and the spread about it."""
    power = np.maximum(_power(sums, size), 1e-300)
    ratio = _product(sums, size) / power
    rest = np.maximum(sums.own - np.abs(ratio) ** 2 * power, 0.0)
    return power, ratio, np.maximum(rest / np.maximum(sums.count - 1.0, 1.0), 1.0)


def _gains(sums: _Sums, grid: Complexes, settings: OrderSettings, *, slack: float) -> Floats:
    """Logarithm of the odds (grid, targets) of each E_k, right to the share ``slack``, against none."""
    power, ratio, spread = _seen_of(sums, grid[:, None])
    # beside the rows' own noise, what is of second order and how coarse the grid is
    variance = spread / power + slack**2

    sideband, nothing = (_densities(np.abs(off) ** 2, variance, settings) for off in (ratio - 1.0, ratio))
    return np.asarray(np.log(0.5 * sideband[0] + 0.5 * sideband[1]) - np.log(0.5 * nothing[0] + 0.5 * nothing[1]))


def _densities(square: Floats, variance: Floats, settings: OrderSettings) -> tuple[Floats, Floats]:
    """Densities of a ratio whose ``square`` is off what is looked for: of that alone, and of a line of its own."""
    alone = np.exp(-np.minimum(square / variance, 700.0)) / (np.pi * variance)
    return alone, 1.0 / (2.0 * np.pi * (square + variance) * settings.own_line_range)


def _refined(sums: _Sums, start: complex, settings: OrderSettings) -> tuple[complex, float, Floats]:
    """E_k by least squares over the targets that are sidebands, from ``start``; its standard error; their weights."""
    size, error = start, np.inf
    weights, sides, straight = np.zeros(len(sums.own)), sums.below + sums.above, sums.low + sums.high.conj()
    for slack in (*SLACKS, *(settings.sideband_slack,) * LAST_STEPS):
        power, ratio, spread = _seen_of(sums, size)
        square = np.abs(ratio - 1.0) ** 2
        alone, other = _densities(square, spread / power + slack**2, settings)
        weights = alone / (alone + other)
        share = weights / (spread + slack**2 * power)
        a, b, c = float(share @ sides), complex(share @ sums.both), complex(share @ straight)
        # normal equation of |y - E u - conj(E) v|²: a E + 2 conj(b E) = c
        determinant = a * a - 4.0 * (b * b.conjugate()).real
        if not determinant > 1e-12 * a * a:
            return size, np.inf, weights
        size = (a * c - 2.0 * (b * c).conjugate()) / determinant
        off = float((share * square) @ power) / max(2.0 * float(weights.sum()) - 2.0, 1.0)
        error = math.sqrt(a / determinant * max(0.5, off))
    return size, error, weights
