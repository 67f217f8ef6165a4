"""Which modes there are: peaks of the floor, then what the residual still shows, then what splits in two."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from crankorder.campbell.map import HANN_CORRELATION
from crankorder.identify.modes.floor import NUMBERS as FLOOR
from crankorder.identify.modes.floor import Floor
from crankorder.identify.modes.surface_fit import (
    NO_POLES,
    Poles,
    Problem,
    Range,
    SurfaceFit,
    background_columns,
    fit_surface,
    inverse_curvature,
    pole_columns,
    score_covariance,
)
from crankorder.quantities import Bools, Floats, Ints
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "search")

START_WIDTHS = (0.003, 0.01, 0.03, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Half widths in bins that are tried for narrow peaks."""


def with_strong_tones(floor: Floor, *, least_damping: float) -> Floor:
    """``floor`` with frequencies, and their errors, of the lines that are far above it and as narrow as the window.

    One spectrum alone tells no tone from what rings on for as long as its frame lasts: a line is a tone there only
    where a mode of the damping ratio ``least_damping`` would be wider.
    """
    tones: list[tuple[float, float]] = []
    for density, averages in zip(floor.psd, floor.averages, strict=True):
        used = np.isfinite(density) & (density > 0.0)
        if np.count_nonzero(used) < 20:
            continue
        whole = np.interp(np.arange(len(density)), np.flatnonzero(used), np.log(density[used]))
        for peak in local_maxima(whole):
            at = int(peak)
            beside = np.median(whole[max(at - 3 * NUMBERS.shadow_bins, 0) : at + 3 * NUMBERS.shadow_bins + 1])
            near = slice(max(at - NUMBERS.shadow_bins, 0), at + NUMBERS.shadow_bins + 1)
            if whole[at] - beside < NUMBERS.strong_log_ratio or whole[at] < whole[near].max():
                continue
            _, half = narrow_peak(whole, at, floor)
            least = least_damping * floor.frequency_hz[at] if averages[at] < FLOOR.fewest_averages else np.inf
            if not half <= NUMBERS.steady_width_bins * floor.seen.bin_hz <= least:
                continue
            frequency = float(floor.frequency_hz[at]) + _offset_hz(whole, at, floor)
            error = floor.step_hz * float(np.exp(0.5 * (beside - whole[at])))
            if all(abs(frequency - other) > 2.0 * floor.seen.bin_hz for other, _ in tones):
                tones.append((frequency, max(error, 1e-3 * floor.step_hz)))
    return replace(floor, strong=tuple(sorted(tones)))


def line_columns(floor: Floor) -> Floats:
    """Columns (3 lines, F) of the power of the strong tones of ``floor``, each a little off and wandering a little.

    The window's response and its first two derivatives by frequency: what a small error of the frequency and a small
    wander make of it, whatever their size.
    """
    step = 0.02 * floor.seen.bin_hz
    columns, top = [np.zeros((0, len(floor.frequency_hz)))], float(floor.seen.kernel(np.zeros(1))[0])
    for tone, _ in floor.strong:
        away = floor.frequency_hz - tone + step * np.array([[-1.0], [0.0], [1.0]])
        low, middle, high = floor.seen.kernel(away) / top
        columns.append(np.stack([middle, (high - low) / 0.04, (high - 2.0 * middle + low) / 0.02**2]))
    return np.concatenate(columns)


def ruled_by_lines(floor: Floor) -> Bools:
    """Which bins (C, F) of ``floor`` hold more of a strong tone than of all else."""
    ruled = np.zeros(floor.psd.shape, dtype=bool)
    for (tone, _), column in zip(floor.strong, line_columns(floor)[::3], strict=True):
        peak = np.abs(floor.frequency_hz - tone) <= floor.seen.bin_hz
        top = np.nan_to_num(floor.psd[:, peak] / column[peak]).mean(axis=1)
        ruled |= peak | (top[:, None] * column > NUMBERS.rules_share * np.nan_to_num(floor.psd, nan=np.inf))
    return ruled


def unsure_power(floor: Floor) -> Floats:
    """Power (C, F) by which the strong lines of ``floor`` may miss what is made of them, for tones wander a little.

    A line that wanders is smeared: where its power bends most over the frequency, it is least known.
    """
    unsure = np.zeros(floor.psd.shape)
    away = np.array([-NUMBERS.wander_hz, 0.0, NUMBERS.wander_hz])
    for tone, _ in floor.strong:
        near = np.flatnonzero(np.abs(floor.frequency_hz - tone) <= 3 * NUMBERS.shadow_bins * floor.seen.bin_hz)
        if not len(near):
            continue
        low, middle, high = floor.seen.kernel(floor.frequency_hz[near] - tone + away[:, None])
        smeared = np.abs(0.5 * (low + high) - middle) / float(floor.seen.kernel(np.zeros(1))[0])
        peak = near[np.abs(floor.frequency_hz[near] - tone) <= floor.seen.bin_hz]
        top = np.nan_to_num(floor.psd[:, peak]).max(axis=1, initial=0.0)[:, None]
        unsure[:, near] += NUMBERS.smear_left_share * top * smeared
    return unsure


def _offset_hz(level: Floats, at: int, floor: Floor) -> float:
    """Distance of a tone from the bin ``at`` at which ``level`` (ln of power) peaks.

    From the two strongest bins of a Hann window (Rife and Vincent 1970), or, where the spectrum was padded, from the
    parabola through three.
    """
    left, middle, right = level[at - 1 : at + 2]
    if floor.seen.bin_hz > 1.5 * floor.step_hz:
        bend = left - 2.0 * middle + right
        return float(0.5 * (left - right) / bend) * floor.step_hz if bend < 0.0 else 0.0
    side = 1.0 if right >= left else -1.0
    share = float(np.exp(0.5 * (max(left, right) - middle)))
    return side * max(2.0 * share - 1.0, 0.0) / (share + 1.0) * floor.step_hz


def narrow_peak(level: Floats, peak: int, floor: Floor) -> tuple[float, float]:
    """Frequency and half width of the resonance that in dB is most like the narrow ``peak`` of ``level`` (bins,).

    ``floor``: the floor in all channels.
    """
    near = np.arange(max(peak - NUMBERS.skirt_bins, 0), min(peak + NUMBERS.skirt_bins + 1, len(level)))
    peak = int(near[np.argmax(np.where(np.abs(near - peak) <= 1, level[near], -np.inf))])
    shift, width = (part.ravel() for part in np.meshgrid(np.linspace(-0.5, 0.5, 11), START_WIDTHS))
    natural = floor.frequency_hz[peak] + shift * floor.step_hz
    half = width * floor.seen.bin_hz
    shapes = pole_columns(floor.frequency_hz[near], natural, np.minimum(half / natural, 0.3), floor.seen)[0][::2]
    at_peak = shapes[:, np.searchsorted(near, peak)][:, None]
    under = np.exp(level[near].min())
    model = np.log(np.maximum(shapes / at_peak, 0.0) * (np.exp(level[peak]) - under) + under)
    best = int(np.argmin(np.square(model - level[near]).sum(axis=1)))
    return float(natural[best]), float(half[best])


def local_maxima(level: Floats) -> Ints:
    """Bins (n,) of ``level`` (bins,) that are the largest within some on both sides, the ends excluded."""
    padded = np.pad(level, NUMBERS.peak_reach_bins, constant_values=-np.inf)
    highest = np.lib.stride_tricks.sliding_window_view(padded, 2 * NUMBERS.peak_reach_bins + 1).max(axis=-1)
    inner = np.arange(len(level))
    return np.flatnonzero((level >= highest) & (inner > 1) & (inner < len(level) - 2))


PAIRS = ((0.5, 0.6), (1.0, 0.4))
"""Distance from a pole and half width, in its half widths, of the two that are tried in its place."""

MOST_OF_SPLIT = 6
"""Fits at most by which a pole is taken apart in two."""

LINE_WIDTH = 0.02
"""Half width in bins of a line that is tried."""

HARDLY = 1e-5
"""Share of a strong tone's power below which its skirts are left out where a pole is looked at closely."""

BOXES = (3, 7, 15, 31, 63, 127, 255, 511)
"""Widths in bins over which the residual is summed."""


class Fits:
    """Fits that a search may still begin: ``left`` falls below none where it asked for more."""

    def __init__(self) -> None:
        self.left = NUMBERS.most_fits

    def begin(self, number: int = 1) -> bool:
        """Whether another may begin, or that ``number``."""
        self.left -= number
        return bool(self.left >= 0)


EVERYWHERE = (-np.inf, np.inf)


def search(floor: Floor, *, chance: float, own_hz: Range = EVERYWHERE) -> tuple[Problem, SurfaceFit, bool]:
    """Problem and fit of ``floor`` with every pole that the data ask for at the false-alarm level ``chance``.

    And whether the search ended at its bound: then poles may be missing, and some were not tested.
    ``own_hz``: from where to where poles are taken apart and tested; beside that they but make room for those within.
    """
    candidates: list[tuple[float, Problem, SurfaceFit]] = []
    start = peaks(floor)
    for line, _ in floor.strong:
        start = start.chosen(np.abs(start.frequency_hz - line) > NUMBERS.own_peak_bins * floor.seen.bin_hz)
    looked, tested = Fits(), Fits()
    for degree in NUMBERS.background_degrees:
        problem = problem_of(floor, degree)
        fit = _pruned(problem, fit_surface(problem, start, steps=15), chance, tested, EVERYWHERE, at_first=True)
        fit = _grown(problem, fit, chance, looked)
        size = fit.linear.size + 2 * len(fit.poles)
        cost = fit.deviance + HANN_CORRELATION * size * np.log(len(floor.frequency_hz))
        candidates.append((cost, problem, fit))
    _, problem, fit = min(candidates, key=lambda candidate: candidate[0])
    split = _split(problem, fit, chance, looked, own_hz)
    fit = fit if split is fit else _grown(problem, split, chance, looked)
    fit = _pruned(problem, fit, chance, tested, own_hz)
    return problem, fit, min(looked.left, tested.left) < 0


def problem_of(floor: Floor, degree: int) -> Problem:
    """Problem of all of ``floor`` with a background of ``degree``.

    Bins in the skirts of a line that is far stronger count less, for the skirts of a line that is not quite steady are
    not the window's; so do those where a tone that wanders a little changes most.
    """
    known = np.isfinite(floor.psd) & (floor.psd > 0.0)
    level = np.where(known, floor.psd, 0.0)
    unsure = unsure_power(floor)
    beside = np.pad(level, ((0, 0), (NUMBERS.shadow_bins, NUMBERS.shadow_bins)))
    highest = np.lib.stride_tricks.sliding_window_view(beside, 2 * NUMBERS.shadow_bins + 1, axis=1).max(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        averages = 1.0 / (1.0 / floor.averages + (NUMBERS.shadow_share * highest / level) ** 2 + (unsure / level) ** 2)
    averages = np.where(known, averages, 0.0)
    lines = line_columns(floor)
    background = np.ascontiguousarray(np.concatenate([background_columns(len(floor.frequency_hz), degree), lines]))
    return Problem(floor.frequency_hz, floor.psd, averages, floor.seen, background, n_lines=len(lines))


def least_gain(n_channels: int, chance: float) -> float:
    """Deviance that one more pole saves by ``chance``: two parameters of its own and two for each channel.

    ``n_channels``: how many channels there are.
    """
    return float(chdtri(2.0 + 2.0 * n_channels, chance))


def saves_enough(problem: Problem, less: SurfaceFit, more: SurfaceFit, *, at_hz: float, chance: float) -> bool:
    """Whether ``more`` poles near ``at_hz`` save more deviance than ``chance`` would, over ``less`` of them.

    Bins that overlap, narrow modes and channels with common noise count the same scatter several times: the deviance
    is that many times too large as the sandwich covariance of the poles there exceeds the naive one (Rotnitzky and
    Jewell 1990; Satorra and Bentler 1994). One spectrum alone holds a single draw of what a narrow pole scatters by:
    whether it is there is asked against the floor without it, whose scatter bins count as often as they overlap.
    ``problem``: the floors that were fitted.
    """
    saved = (less.deviance - more.deviance) / scatter_at(problem, more, at_hz)
    limit = least_gain(len(problem.psd), chance)
    if saved < HANN_CORRELATION * limit:
        return False
    if problem.averages.max(initial=0.0) < FLOOR.fewest_averages:
        return saved > HANN_CORRELATION * max(1.0, problem.seen.bin_hz / _step_hz(problem)) * limit
    # the factor by which the likelihood overstates what the data tell of the two poles nearest
    free, inverse = more.poles.free, inverse_curvature(more)
    near = np.argsort(np.abs(more.poles.frequency_hz - at_hz))[:2]
    own = np.flatnonzero(np.isin(np.repeat(np.arange(len(more.poles)), 2)[free], near))
    sandwich = score_covariance(problem, more, np.eye(len(free))[:, free] @ inverse[:, own])
    overstated = float(np.trace(np.linalg.pinv(inverse[np.ix_(own, own)], rcond=1e-12) @ sandwich)) / len(own)
    return saved > max(HANN_CORRELATION, overstated) * limit


def _step_hz(problem: Problem) -> float:
    """Distance of neighbouring bins."""
    return float(problem.frequency_hz[1] - problem.frequency_hz[0])


def peaks(floor: Floor) -> Poles:
    """Peaks of all channels of ``floor`` clear of the scatter, joined where they are nearer than they are wide."""
    seen: list[tuple[float, float, float]] = []
    step = floor.step_hz
    ruled = ruled_by_lines(floor)
    for density, averages, by_line in zip(floor.psd, floor.averages, ruled, strict=True):
        used = np.flatnonzero(np.isfinite(density) & (density > 0.0) & ~by_line)
        if len(used) < 20:
            continue
        whole = np.interp(np.arange(len(density)), used, np.log(density[used]))
        level = whole.copy()
        level[1:-1] = np.log((np.exp(whole[:-2]) + np.exp(whole[1:-1]) + np.exp(whole[2:])) / 3.0)
        scatter = 1.0 / np.sqrt(1.5 * np.median(averages[used]))
        for peak in local_maxima(level):
            height, width = _prominence(level, int(peak))
            if height > NUMBERS.peak_sigmas * scatter and height > 0.1:
                wide = float(floor.frequency_hz[peak]), (0.5 * width - 0.7) * step
                seen.append((height, *(wide if width > NUMBERS.narrow_bins else narrow_peak(whole, int(peak), floor))))
    poles = NO_POLES
    taken: list[tuple[float, float]] = []
    for _, frequency, width in sorted(seen, key=lambda peak: -peak[0]):
        if all(abs(frequency - other) > max(2.5 * step, 0.7 * min(width, wide)) for other, wide in taken):
            taken.append((frequency, width))
            poles = poles.with_pole(frequency, min(width / frequency, 0.3))
    return poles


def _prominence(level: Floats, peak: int) -> tuple[float, float]:
    """Height over the higher of the two valleys that part a peak from higher ground; width at half power, in bins."""

    def beside(marked: Bools) -> tuple[int, int]:
        """The nearest ``marked`` bins below and above the peak; the ends where there are none."""
        at = np.concatenate([[0], np.flatnonzero(marked), [len(level) - 1]])
        above = int(np.searchsorted(at[1:-1], peak)) + 1
        return int(at[above - 1]), int(at[above])

    left, right = beside(level > level[peak])
    height = float(level[peak] - max(level[left : peak + 1].min(), level[peak : right + 1].min()))
    low, high = beside(level < level[peak] - min(np.log(2.0), 0.5 * height))
    return height, float(2 * min(high - peak, peak - low))


def hidden_poles(problem: Problem, fit: SurfaceFit) -> Bools:
    """Which poles of ``fit`` (M,) lie where no channel has a bin: they stand for the skirts of what is masked there.

    ``problem``: the floors that were fitted.
    """
    used = problem.frequency_hz[(problem.averages > 0.0).any(axis=0)]
    nearest = np.abs(fit.poles.frequency_hz[:, None] - used).min(axis=1, initial=np.inf)
    inside = (fit.poles.frequency_hz > problem.frequency_hz[0]) & (fit.poles.frequency_hz < problem.frequency_hz[-1])
    return np.asarray(inside & (nearest > problem.seen.bin_hz + fit.poles.damping * fit.poles.frequency_hz))


def evidence_of(fit: SurfaceFit) -> Floats:
    """Wald statistic (M, C) of the two linear terms of each pole, in units of the bins' own scatter.

    ``fit``: the fit so far.
    """
    inverse = np.linalg.pinv(fit.triangle, rcond=1e-9)
    inverse = inverse[:, : 2 * len(fit.poles)].reshape(len(inverse), len(fit.poles), 2, inverse.shape[2])
    x = fit.linear[:, : 2 * len(fit.poles)].reshape(*inverse.shape[:2], 2, 1)
    return np.asarray((x.swapaxes(2, 3) @ np.linalg.pinv(inverse @ inverse.swapaxes(2, 3)) @ x)[..., 0, 0].T)


def dispersion(problem: Problem, fit: SurfaceFit, at_hz: float | None = None) -> float:
    """Mean square residual in standard deviations: one where the model holds, never taken for less.

    Of all bins, or of those around ``at_hz`` alone, so that a misfit elsewhere does not drown what is there.
    ``problem``: the floors that were fitted; ``fit``: the fit so far.
    """
    return max(1.0, _mean_square(problem, fit, at_hz))


def scatter_at(problem: Problem, fit: SurfaceFit, at_hz: float) -> float:
    """Mean square residual around ``at_hz``, less than one only where the bins surely scatter less than noise does.

    The skirts of what is strong elsewhere are smooth, whatever the number of averages.
    ``problem``: the floors that were fitted; ``fit``: the fit so far.
    """
    square = _mean_square(problem, fit, at_hz)
    if square > NUMBERS.smooth_residual:
        return max(1.0, square)
    return float(max(square / NUMBERS.smooth_residual, NUMBERS.smoothest_residual))


def _mean_square(problem: Problem, fit: SurfaceFit, at_hz: float | None) -> float:
    residual, used = fit.left, problem.averages > 0.0
    free = 1.0 - (fit.linear.size + 2.0 * len(fit.poles)) / max(1.0, float(np.count_nonzero(used)))
    if at_hz is not None:
        near = np.argsort(np.abs(problem.frequency_hz - at_hz), kind="stable")[: NUMBERS.local_bins]
        residual, used = residual[:, near], used[:, near]
    spare = max(1.0, float(np.count_nonzero(used)) * max(free, 0.2))
    return float(np.sum(residual**2)) / spare


def _pruned(
    problem: Problem, fit: SurfaceFit, chance: float, fits: Fits, own_hz: Range, *, at_first: bool = False
) -> SurfaceFit:
    """Without the poles in ``own_hz`` that add no more than chance would, the weakest first.

    Those whose linear terms are less than some times the limit are left out on trial; ``at_first`` only those whose
    linear terms say nothing even if the model held everywhere.
    """
    limit = HANN_CORRELATION * least_gain(len(problem.psd), chance)
    most, steps = (limit, 5) if at_first else (NUMBERS.doubtful_ratio * limit, 12)
    kept: list[float] = []
    while len(fit.poles):
        frequency = fit.poles.frequency_hz
        local = 1.0 if at_first else np.array([scatter_at(problem, fit, float(f)) for f in frequency])
        evidence = evidence_of(fit).sum(axis=1) / local
        evidence[np.isin(frequency, kept) | ~fit.poles.within(own_hz)] = np.inf
        weakest = int(np.argmin(evidence))
        if evidence[weakest] > most or not fits.begin():
            break
        at_hz = float(frequency[weakest])
        less = fit_surface(problem, fit.poles.without(weakest), start=fit.model, steps=steps)
        surely = less.deviance - fit.deviance > NUMBERS.surely_ratio * limit
        idle = evidence[weakest] <= limit and not surely
        if idle or not (at_first or saves_enough(problem, less, fit, at_hz=at_hz, chance=chance)):
            fit, kept = less, []
        else:
            kept.append(at_hz)
    return fit


def _grown(problem: Problem, fit: SurfaceFit, chance: float, fits: Fits) -> SurfaceFit:
    """With poles added where the residual of ``fit`` stands out, as long as each saves enough deviance.

    Each takes two linear terms of every channel: no more than there are bins for.
    """
    tried: list[float] = []
    while fit.linear.shape[1] + 2 <= len(problem.frequency_hz):
        hump = _standing_out(problem, fit, tried, chance)
        if hump is None or not fits.begin():
            break
        frequency, width = hump
        poles = fit.poles.with_pole(frequency, min(0.3, width / frequency))
        more = fit_surface(problem, poles, start=fit.model, steps=20)
        if saves_enough(problem, fit, more, at_hz=frequency, chance=chance):
            fit = more
        else:
            tried.append(frequency)
    return fit


def _standing_out(problem: Problem, fit: SurfaceFit, tried: list[float], chance: float) -> tuple[float, float] | None:
    """Frequency and half width of the most significant hump of the residual, away from those ``tried``.

    None where noise would make as much in as many channels by ``chance``.
    """
    over = np.sqrt(problem.averages) * (np.nan_to_num(problem.psd) / fit.model - 1.0)
    z, n_bins, best = np.where(problem.averages > 0.0, over, 0.0), len(problem.frequency_hz), 0.0
    hump: tuple[float, float] | None = None
    for bins in (n for n in BOXES if n < min(n_bins, max(64, n_bins // 4))):
        box = np.ones(bins) / np.sqrt(bins * min(HANN_CORRELATION, 0.5 + 0.5 * bins))
        score = np.square(np.maximum([np.convolve(row, box, mode="same") for row in z], 0.0)).sum(axis=0)
        for frequency in tried:
            score[np.abs(problem.frequency_hz - frequency) < 2.0 * bins * _step_hz(problem)] = 0.0
        at = int(np.argmax(score))
        if score[at] > best:
            best, hump = float(score[at]), (float(problem.frequency_hz[at]), 0.25 * bins * problem.seen.bin_hz)
    return hump if best > chdtri(len(z), chance) * dispersion(problem, fit, hump[0] if hump else None) else None


def _split(problem: Problem, fit: SurfaceFit, chance: float, fits: Fits, own_hz: Range) -> SurfaceFit:
    """With poles taken apart in two where that saves enough deviance: looked at in the bins around each."""
    limit = least_gain(len(problem.psd), chance)
    number = 0
    while number < len(fit.poles) and fit.linear.shape[1] + 2 <= len(problem.frequency_hz):
        f, zeta = float(fit.poles.frequency_hz[number]), float(fit.poles.damping[number])
        width = max(zeta * f, 0.3 * problem.seen.bin_hz)
        local, start = _around(problem, fit, number, width)
        few = len(local.frequency_hz) < NUMBERS.fewest_bins
        if few or zeta > NUMBERS.wide_damping_ratio or not fit.poles.within(own_hz)[number]:
            number += 1
            continue
        if not fits.begin(MOST_OF_SPLIT):
            break
        single = fit_surface(local, start, steps=8)
        alone = start.without(int(np.argmin(np.abs(start.frequency_hz - f))))
        starts = PAIRS if dispersion(local, single) > NUMBERS.suspect_residual else PAIRS[:1]
        trials = [fit_surface(local, _pair(alone, f, width, *shape), steps=20) for shape in starts]
        two = min(trials, key=lambda trial: trial.deviance)
        if dispersion(local, single) > NUMBERS.misfit_residual:
            beside = [fit_surface(local, poles, steps=20) for poles in _line_and_mode(local, alone, f)]
            two = min([two, *beside], key=lambda trial: trial.deviance)
        if single.deviance - two.deviance > NUMBERS.gate_share * HANN_CORRELATION * limit * dispersion(local, two):
            poles = fit.poles.without(number)
            for k in np.argsort(np.abs(two.poles.frequency_hz - f))[:2]:
                poles = poles.with_pole(float(two.poles.frequency_hz[k]), float(two.poles.damping[k]))
            more = fit_surface(problem, poles, start=fit.model, steps=20)
            if saves_enough(problem, fit, more, at_hz=f, chance=chance):
                fit = more
                continue
        number += 1
    return fit


def _pair(poles: Poles, at_hz: float, width_hz: float, apart: float, wide: float) -> Poles:
    """``poles`` with two more, each ``apart`` times ``width_hz`` from ``at_hz`` and ``wide`` times as wide."""
    for sign in (-apart, apart):
        poles = poles.with_pole(at_hz + sign * width_hz, wide * width_hz / at_hz)
    return poles


def _line_and_mode(local: Problem, poles: Poles, at_hz: float) -> list[Poles]:
    """``poles`` with a narrow line on the highest bin near ``at_hz`` and a mode on either side of it, to start from.

    ``local``: the bins around.
    """
    bin_hz = local.seen.bin_hz
    level = np.nan_to_num(local.psd[int(np.argmax(np.nan_to_num(local.psd).max(axis=1)))])
    level = np.where(np.abs(local.frequency_hz - at_hz) < NUMBERS.beside_bins * bin_hz, level, 0.0)
    line = float(local.frequency_hz[int(np.argmax(level))])
    both = poles.with_pole(line, LINE_WIDTH * bin_hz / line)
    beside = (line - NUMBERS.beside_bins * bin_hz, line + NUMBERS.beside_bins * bin_hz)
    return [both.with_pole(f, bin_hz / f) for f in beside if f > bin_hz]


def _around(problem: Problem, fit: SurfaceFit, number: int, width_hz: float) -> tuple[Problem, Poles]:
    """The bins within some widths of pole ``number``; what the others make of them is part of the background."""
    f = fit.poles.frequency_hz[number]
    reach = max(6.0 * width_hz, 8.0 * problem.seen.bin_hz)
    near = np.abs(problem.frequency_hz - f) <= reach
    poles = np.abs(fit.poles.frequency_hz - f) <= reach
    lines = problem.background[len(problem.background) - problem.n_lines :, near]
    lines = lines[(np.abs(lines) > HARDLY).any(axis=1)]
    own = {name: getattr(problem, name)[..., near] for name in ("frequency_hz", "psd", "averages")}
    background = np.concatenate([background_columns(int(near.sum()), 2), lines])
    return replace(problem, **own, background=background, n_lines=len(lines)), fit.poles.chosen(poles)


JOINT_FIT = MethodNumbers("5-identify-modal.toml", "joint_fit")


class Band(NamedTuple):
    """``floor`` of a band with what it shares with the next ones; poles in ``range_hz`` (from, to) belong to it.

    ``first`` and ``last`` are the bins of the whole floor that are its own, the last one excluded.
    """

    floor: Floor
    range_hz: tuple[float, float]
    first: int
    last: int

    def holds(self, poles: Poles) -> Bools:
        """Which of ``poles`` (M,) lie in it or in what it shares."""
        at, step = poles.frequency_hz, self.floor.step_hz
        return np.asarray((at > self.floor.frequency_hz[0] - step) & (at < self.floor.frequency_hz[-1] + step))


def bands_of(floor: Floor) -> tuple[Band, ...]:
    """Bands of ``floor``, cut away from its peaks; one where it is short and has few."""
    n_bins = len(floor.frequency_hz)
    seen = _peaks_by_part(floor)
    if n_bins <= JOINT_FIT.longest_bins and len(seen) <= JOINT_FIT.most_peaks:
        return (Band(floor, EVERYWHERE, 0, n_bins),)
    load = 1.0 / np.maximum(JOINT_FIT.band_bins, JOINT_FIT.band_share * floor.frequency_hz / floor.step_hz)
    np.add.at(
        load, np.searchsorted(floor.frequency_hz, seen.frequency_hz).clip(0, n_bins - 1), 1.0 / JOINT_FIT.band_peaks
    )
    load = np.cumsum(load)
    n_bands = max(1, math.ceil(load[-1] - 1e-9))
    cuts = [0, *(_quiet_cut(floor, seen, load, k / n_bands, n_bands) for k in range(1, n_bands)), n_bins]
    cuts = sorted(set(cuts))
    return tuple(_band(floor, first, last) for first, last in pairwise(cuts))


def _band(floor: Floor, first: int, last: int) -> Band:
    n_bins = len(floor.frequency_hz)
    below, above = (
        max(JOINT_FIT.shared_bins, round(JOINT_FIT.shared_share * float(floor.frequency_hz[end]) / floor.step_hz))
        for end in (first, last - 1)
    )
    at = slice(max(0, first - below), min(n_bins, last + above))
    own = {name: getattr(floor, name)[..., at] for name in ("frequency_hz", "psd", "averages", "cells", "whole")}
    strong = tuple(t for t in floor.strong if floor.frequency_hz[at][0] <= t[0] <= floor.frequency_hz[at][-1])
    part = replace(floor, **own, strong=strong)
    low = floor.frequency_hz[first] - 0.5 * floor.step_hz if first else -math.inf
    high = floor.frequency_hz[last] - 0.5 * floor.step_hz if last < n_bins else math.inf
    return Band(part, (float(low), float(high)), first, last)


def _peaks_by_part(floor: Floor) -> Poles:
    """Peaks of ``floor``, looked for part by part, which takes a time that grows as the floor does."""
    poles = NO_POLES
    for first in range(0, len(floor.frequency_hz), JOINT_FIT.band_bins):
        part = _band(floor, first, min(first + JOINT_FIT.band_bins, len(floor.frequency_hz)))
        if len(part.floor.frequency_hz) >= 2 * JOINT_FIT.shared_bins:
            here = peaks(part.floor)
            poles = poles.joined(here.chosen(here.within(part.range_hz)))
    return poles


def _quiet_cut(floor: Floor, seen: Poles, load: Floats, share: float, n_bands: int) -> int:
    """Bin near that at ``share`` of the ``load`` which lies the most widths away from any peak."""
    low, high = np.searchsorted(load, load[-1] * (share + JOINT_FIT.slack_share / n_bands * np.array([-1.0, 1.0])))
    bins = np.arange(max(int(low), 1), min(max(int(high), int(low) + 1), len(load) - 1) + 1)
    width = seen.damping * seen.frequency_hz + 3.0 * floor.seen.bin_hz
    away = (np.abs(floor.frequency_hz[bins, None] - seen.frequency_hz) / width).min(axis=1, initial=10.0)
    return int(bins[np.argmax(away - 1e-3 * np.abs(bins - bins.mean()) / len(bins))])
