"""Fit of modes to the floors of all channels at once: poles are common, residues and background each channel's."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from crankorder.identify.modes.floor import SpectralWindow, seen_pole
from crankorder.orders.intervals import Z95, half_widths
from crankorder.quantities import Bools, Complexes, Floats, Ints
from crankorder.settings import MethodNumbers

if TYPE_CHECKING:
    from crankorder.identify.found import Mode
    from crankorder.identify.modes.order_responses import Blocks

NUMBERS = MethodNumbers("5-identify-modal.toml", "surface_fit")


LOBE_BINS = 2
"""Bins on each side that the main lobe of a window covers."""


Range = tuple[float, float]


def pole_columns(
    frequency_hz: Floats, natural_hz: Floats, damping: Floats, seen: SpectralWindow
) -> tuple[Floats, Floats, Floats]:
    """Columns (2 modes, frequencies) of the power spectrum of modes, and their derivatives by ln f_j and by ln ζ_j.

    Behind white forces the spectrum of a mode with ``natural_hz`` and ``damping`` (modes,) at ``frequency_hz`` is
    Re [R / (σ + i (f − f_d)) + R* / (σ + i (f + f_d))] with one complex R, so two real columns each (Ewins 2000, §4.3,
    for the power instead of the response). They are scaled by 2πσ, which makes them of order one.
    ``seen``: how the window sees power.
    """
    sigma = (damping * natural_hz)[:, None]
    turned = np.sqrt(1.0 - damping**2)[:, None]
    damped = natural_hz[:, None] * turned
    near, near_slope = seen_pole(sigma + 1j * (frequency_hz - damped), seen)
    far, far_slope = seen_pole(sigma + 1j * (frequency_hz + damped), seen)
    scale = 2.0 * np.pi * sigma
    by_damping = natural_hz[:, None] * (-(damping[:, None] ** 2) / turned)  # of f_d by ln ζ

    def columns(near_part: Complexes, far_part: Complexes) -> Floats:
        both = np.empty((len(natural_hz), 2, len(frequency_hz)))
        both[:, 0] = scale * (near_part.real + far_part.real)
        both[:, 1] = scale * (far_part.imag - near_part.imag)
        return both.reshape(-1, len(frequency_hz))

    by_hz, by_ratio = (
        columns(near_slope * (sigma - 1j * moved) + near, far_slope * (sigma + 1j * moved) + far)
        for moved in (damped, by_damping)
    )
    return columns(near, far), by_hz, by_ratio


TONE_BINS = 1e-3
"""Half width in bins that stands for none: the line of a tone."""

MOST_STEPS = 40
"""Steps of the fit at most."""

LITTLE = 0.01
"""Deviance of a step that tells nothing: by a tenth of a standard error it moves what it moves."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Floors to be fitted: ``frequency_hz`` (F,), ``psd`` and ``averages`` (C, F; none where masked), ``background``.

    ``background`` (B, F) are the columns of what is smooth, the last ``n_lines`` those of strong tones; ``seen`` is
    the spectral window; ``others`` what else the same poles must explain.
    """

    frequency_hz: Floats
    psd: Floats
    averages: Floats
    seen: SpectralWindow
    background: Floats
    others: Blocks | None = None
    n_lines: int = 0


@dataclass(frozen=True, eq=False)
class Poles:
    """Natural frequencies in Hz and damping ratios, each (M,); ``tone`` (M,) marks lines that have no damping."""

    frequency_hz: Floats
    damping: Floats
    tone: Bools

    def __len__(self) -> int:
        return len(self.frequency_hz)

    def without(self, number: int) -> Poles:
        """All but one.

        ``number``: which pole.
        """
        return self.chosen(np.arange(len(self)) != number)

    def with_pole(self, frequency_hz: float, damping: float) -> Poles:
        """One more, lowest first.

        ``frequency_hz``: in Hz; ``damping``: their ratios.
        """
        return self.joined(poles_at([(frequency_hz, damping)])).rising

    @property
    def rising(self) -> Poles:
        """The poles, lowest first."""
        return self.chosen(self.rank)

    @property
    def rank(self) -> Ints:
        """Numbers (M,) of the poles, lowest first."""
        return np.argsort(self.frequency_hz, kind="stable")

    def chosen(self, which: Bools | Ints) -> Poles:
        """Those that ``which`` marks (M,) or numbers."""
        return Poles(self.frequency_hz[which], self.damping[which], self.tone[which])

    def within(self, range_hz: Range) -> Bools:
        """Which (M,) lie in ``range_hz``, its end excluded."""
        return np.asarray((self.frequency_hz >= range_hz[0]) & (self.frequency_hz < range_hz[1]))

    def joined(self, others: Poles) -> Poles:
        """These, then ``others``."""
        frequency = np.append(self.frequency_hz, others.frequency_hz)
        return Poles(frequency, np.append(self.damping, others.damping), np.append(self.tone, others.tone))

    @property
    def values(self) -> Floats:
        """Frequency and damping ratio (M, 2) of each."""
        return np.stack([self.frequency_hz, self.damping], axis=1)

    @property
    def free(self) -> Bools:
        """Which (2 M,) of (ln f_1, ln ζ_1, …) a fit is free to move: not the damping of tones."""
        return np.stack([np.ones(len(self), dtype=bool), ~self.tone], axis=1).ravel()

    def with_width(self, number: int, width_hz: float, *, is_tone: bool = False) -> Poles:
        """With number ``number`` a mode of the half width ``width_hz``, or a tone (``is_tone``)."""
        tone, damping = self.tone.copy(), self.damping.copy()
        tone[number], damping[number] = is_tone, width_hz / self.frequency_hz[number]
        return Poles(self.frequency_hz, damping, tone)


NO_POLES = Poles(np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool))


def poles_at(values: Iterable[tuple[float, float]]) -> Poles:
    """Poles of the ``values``, frequency in Hz and damping ratio of each, in that order."""
    frequency, damping = np.array(list(values), dtype=np.float64).reshape(-1, 2).T
    return Poles(frequency, damping, np.zeros(len(frequency), dtype=bool))


def poles_of_modes(modes: Iterable[Mode]) -> Poles:
    """Poles of ``modes``, in their order."""
    return poles_at((mode.frequency_hz, mode.damping_ratio) for mode in modes)


def parameters_of(numbers: ArrayLike) -> Ints:
    """Numbers (2 N,) among (f_1, ζ_1, f_2, …) of the parameters of the poles ``numbers`` (N,)."""
    return np.asarray(2 * np.asarray(numbers, dtype=np.int64)[:, None] + np.arange(2)).ravel()


def covariance_among(covariance: Floats, numbers: ArrayLike) -> Floats:
    """Part (2 N, 2 N) of the ``covariance`` of (f_1, ζ_1, f_2, …) that is of the poles ``numbers`` (N,)."""
    at = parameters_of(numbers)
    return covariance[np.ix_(at, at)]


@dataclass(frozen=True, eq=False)
class SurfaceFit:
    """``poles``, ``linear`` terms (C, 2M + B) of ``columns`` (2M + B, F), ``model`` (C, F) and its ``deviance``.

    ``slopes`` (2M, F) are the derivatives of the poles' columns by ln f and by ln ζ; ``weight`` (C, F) are those of the
    bins, ``basis`` (C, F, 2M + B) and ``triangle`` (C, 2M + B, 2M + B) Q and R of the weighted columns; ``left`` (C, F)
    is what the fit leaves, in standard deviations of a bin; ``others`` are other data.
    """

    poles: Poles
    linear: Floats
    columns: Floats
    slopes: tuple[Floats, Floats]
    model: Floats
    deviance: float
    weight: Floats
    basis: Floats
    triangle: Floats
    left: Floats
    others: Blocks | None

    @cached_property
    def _further(self) -> tuple[Sequence[Floats], Sequence[Floats]]:
        """Jacobians and residuals of the other data."""
        return self.others.evaluate(self.poles) if self.others is not None and len(self.poles) else ((), ())

    @property
    def residual(self) -> tuple[Floats, ...]:
        """What is left (F,) per channel, then per item of other data, in standard deviations."""
        return (*self.left, *self._further[1])

    @cached_property
    def _bent(self) -> Floats:
        """Derivatives (C, 2M, F) of the floors by (ln f, ln ζ) of all poles, in standard deviations of a bin."""
        terms = self.linear[:, : 2 * len(self.poles), None]
        bent = np.empty((len(terms), len(self.poles), 2, self.weight.shape[1]))
        for number, part in enumerate(self.slopes):
            np.multiply(terms[:, ::2], part[::2], out=bent[:, :, number])
            bent[:, :, number] += terms[:, 1::2] * part[1::2]
        bent *= self.weight[:, None, None]
        return bent.reshape(len(terms), 2 * len(self.poles), -1)

    @cached_property
    def jacobian(self) -> tuple[Floats, ...]:
        """Derivatives (F, 2M) per channel and item by (ln f, ln ζ) of all poles, less what linear terms make up for."""
        left = self._bent - (self._bent @ self.basis) @ self.basis.swapaxes(1, 2)
        return (*left.swapaxes(1, 2), *self._further[0])

    def normal(self) -> tuple[Floats, Floats]:
        """Sums (2M, 2M) and (2M,) over all data of the products of the derivatives with each other and what is left."""
        along = self._bent @ self.basis
        hessian = (self._bent @ self._bent.swapaxes(1, 2)).sum(axis=0) - (along @ along.swapaxes(1, 2)).sum(axis=0)
        slope = (self._bent @ self.left[..., None]).sum(axis=0)[:, 0]
        for j, r in zip(*self._further, strict=True):
            hessian, slope = hessian + j.T @ j, slope + j.T @ r
        return hessian, slope

    def part(self, number: int) -> Floats:
        """Power (C, F) that pole ``number`` adds."""
        at = slice(2 * number, 2 * number + 2)
        return np.asarray(self.linear[:, at] @ self.columns[at])

    def without_lines(self, problem: Problem) -> Floats:
        """Power (C, F) of the whole fit but for the strong tones.

        ``problem``: the floors that were fitted.
        """
        last = len(self.columns) - problem.n_lines
        return np.asarray(self.linear[:, :last] @ self.columns[:last])


def background_columns(n_bins: int, degree: int) -> Floats:
    """Legendre polynomials over the band up to ``degree`` (degree + 1, n_bins)."""
    return np.ascontiguousarray(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n_bins), degree).T)


def gamma_deviance(psd: Floats, averages: Floats, model: Floats) -> Floats:
    """Twice the log likelihood by which the powers ``psd`` miss ``model``, each averaged ``averages`` times.

    All three have one shape, which is kept.
    """
    used = averages > 0.0
    share = np.where(used, psd, 1.0) / np.where(used, model, 1.0)
    return np.asarray(2.0 * np.where(used, averages * (share - 1.0 - np.log(share)), 0.0))


def evaluate(problem: Problem, poles: Poles, weight_by: Floats, same: SurfaceFit | None = None) -> SurfaceFit:
    """Linear terms of ``poles`` for weights by the model ``weight_by`` (C, F), and all that a step needs.

    ``problem``: the floors that were fitted; ``same``: what other weights gave of these very poles, if known.
    """
    if same is not None:
        columns, slopes = same.columns, same.slopes
    else:
        own = pole_columns(problem.frequency_hz, poles.frequency_hz, poles.damping, problem.seen)
        columns, slopes = np.concatenate([own[0], problem.background]), own[1:]
    used = problem.averages > 0.0
    weight = np.where(used, np.sqrt(problem.averages) / weight_by, 0.0)
    measured = weight * np.where(used, problem.psd, 0.0)
    q, triangles = np.linalg.qr((columns * weight[:, None]).swapaxes(1, 2))
    along = q.swapaxes(1, 2) @ measured[..., None]
    linear = _back_solved(triangles, along[..., 0])
    left = measured - (q @ along)[..., 0]
    model = np.maximum(linear @ columns, NUMBERS.smallest_model_share * np.nan_to_num(problem.psd))
    model = np.where(used & (model > 0.0), model, 1.0)
    missed = float(gamma_deviance(problem.psd, problem.averages, model).sum())
    if problem.others is not None and len(poles):
        missed += problem.others.misfit(poles)
    return SurfaceFit(poles, linear, columns, slopes, model, missed, weight, q, triangles, left, problem.others)


def _back_solved(r: Floats, along: Floats) -> Floats:
    """Solutions (C, n) of the triangular systems ``r`` (C, n, n) x = ``along``; columns hardly there get nothing.

    Where there are more columns than bins it is the smallest.
    """
    diagonal = np.abs(np.diagonal(r, axis1=1, axis2=2))
    sound = diagonal.min(axis=1, initial=np.inf) > 1e-9 * diagonal.max(axis=1, initial=0.0)
    sound &= r.shape[1] == r.shape[2]
    solution = np.empty((len(r), r.shape[2]))
    if sound.any():
        solution[sound] = np.linalg.solve(r[sound], along[sound][..., None])[..., 0]
    for channel in np.flatnonzero(~sound):
        solution[channel] = np.linalg.lstsq(r[channel], along[channel], rcond=1e-9)[0]
    return solution


def first_model(problem: Problem) -> Floats:
    """Powers (C, F) of the floors in ``problem``, smoothed over a window's main lobe: a first model."""
    used, edge = problem.averages > 0.0, ((0, 0), (LOBE_BINS, LOBE_BINS))
    both = np.pad([used, np.where(used, problem.psd, 0.0)], ((0, 0), *edge))
    count, power = np.lib.stride_tricks.sliding_window_view(both, 2 * LOBE_BINS + 1, axis=2).sum(axis=3)
    return np.asarray(np.where(used & (power > 0.0), power / np.maximum(count, 1), 1.0))


def fit_surface(problem: Problem, poles: Poles, *, start: Floats | None = None, steps: int = MOST_STEPS) -> SurfaceFit:
    """Maximum-likelihood fit of ``problem`` from ``poles`` on; ``start`` (C, F): model to weight by first.

    The power of noise averaged n times scatters by 1/√n of itself, so residuals are weighted by the model, which
    every step renews (quasi-likelihood of the gamma distribution, whose score has no bias); linear terms are
    eliminated at every step (Golub and Pereyra 1973, derivative of Kaufman 1975); poles move by at most ``steps``
    Levenberg-Marquardt steps in ln f and ln ζ.
    """
    smooth = first_model(problem) if start is None else start
    current = evaluate(problem, poles, smooth)
    for _ in range(2):
        again = evaluate(problem, poles, current.model, current)
        if again.deviance >= current.deviance:
            break
        current = again
    if not len(poles):
        return current
    factor, still, taken, free = 1e-3, 0, True, poles.free
    for _ in range(steps):
        hessian, slope = current.normal()
        hessian, slope = hessian[np.ix_(free, free)], slope[free]
        scale = np.maximum(np.diag(hessian), 1e-6 * np.trace(hessian) / len(hessian))
        if not scale.min(initial=np.inf) > 0.0:
            break
        move = np.zeros(2 * len(poles))
        move[free] = np.linalg.solve(hessian + max(factor, 1e-8) * np.diag(scale), slope)
        if float(slope @ move[free]) < LITTLE:
            break
        moved = _moved(poles, move, problem)
        trial = evaluate(problem, moved, current.model)
        if taken and trial.deviance > current.deviance + 1.0:  # weights of a model that is far off may mislead
            trial = min(trial, evaluate(problem, moved, smooth, trial), key=lambda fit: fit.deviance)
        gained = current.deviance - trial.deviance
        taken = gained > -1e-3
        if taken:
            current, poles = trial, trial.poles
            factor = max(0.1 * factor, 1e-8)
            still = still + 1 if gained < LITTLE else 0
            if still > 1:
                break
        else:
            factor = 10.0 * max(factor, 1e-4)
            if factor > 1e5:
                break
    return current


def inverse_curvature(fit: SurfaceFit) -> Floats:
    """Inverse of the second derivatives of half the deviance of ``fit`` by its free ones of (ln f_1, ln ζ_1, …).

    Linear terms are eliminated.
    """
    free = fit.poles.free
    curved = np.asarray(sum(j.T @ j for j in fit.jacobian))[np.ix_(free, free)]
    return np.asarray(np.linalg.pinv(curved, rcond=1e-13, hermitian=True), dtype=np.float64)


def _moved(poles: Poles, move: Floats, problem: Problem) -> Poles:
    """``poles`` after a step in (ln f, ln ζ), no further than they are wide, inside the band."""
    by = move.reshape(-1, 2)
    reach = np.maximum(poles.damping, problem.seen.bin_hz / poles.frequency_hz)
    shift = np.clip(by[:, 0], -reach, reach)
    low, high = 0.5 * problem.frequency_hz[0], 1.2 * problem.frequency_hz[-1]
    frequency = np.clip(poles.frequency_hz * np.exp(shift), low, high)
    widest = NUMBERS.widest_damping_ratio
    narrowest = np.minimum(TONE_BINS * problem.seen.bin_hz / frequency, widest)  # a bin may be all of a low frequency
    damping = np.clip(poles.damping * np.exp(np.clip(by[:, 1], -1.2, 1.2)), narrowest, widest)
    return Poles(frequency, np.where(poles.tone, narrowest, damping), poles.tone)


POLE_ERRORS = MethodNumbers("5-identify-modal.toml", "pole_errors")


class Cell(NamedTuple):
    """A part of the data that tells poles by itself: its ``hessian`` (P, P) and ``score`` (P,) by ln f_1, ln ζ_1, …"""

    hessian: Floats
    score: Floats


def disagreement(cells: Sequence[Cell], inverse: Floats, known: Floats) -> Floats:
    """Factor (P,), 1 or more, by which poles err more than is ``known``, as their ``cells`` disagree about them.

    ``known`` (P,) is the variance of the parameters without that, ``inverse`` (P, P) that of the whole curvature. What
    one cell asks for beside the others is its influence; the sum of the squares of all is a variance of its own. What
    it is over the known one has as few degrees of freedom as cells count: Student's t (Satterthwaite 1946), so that
    the factor is that of a 95 % interval.
    """
    influence = np.array([inverse @ cell.score for cell in cells])
    share = np.array([np.diag(inverse @ cell.hessian @ inverse) for cell in cells])
    share = np.maximum(share, 0.0) / np.maximum(share.sum(axis=0), 1e-300)
    influence -= share * influence.sum(axis=0)
    squared = np.where(share.sum(axis=0) > 0.0, np.sum(share**2, axis=0), 1.0)
    for_few = np.minimum(1.0 / np.maximum(1.0 - squared, 1e-9), POLE_ERRORS.most_for_few_ratio)
    excess = np.maximum(np.sum(influence**2, axis=0) * for_few - known, 0.0)
    few = np.maximum(1.0 / squared - 1.0, 1.0)
    degrees_of_freedom = few / np.maximum(excess / (known + excess), 1e-6) ** 2
    return np.where(excess > 0.0, np.sqrt((known + excess) / known) * half_widths(degrees_of_freedom) / Z95, 1.0)


def neighbours_together(scores: Floats, reach: int) -> Floats:
    """Sum (P, P) of the products of ``scores`` (N, P) with themselves and their neighbours (Newey and West 1987).

    ``reach``: how many neighbours on each side count.
    """
    total = scores.T @ scores
    for lag in range(1, reach + 1):
        product = scores[lag:].T @ scores[:-lag]
        total += (1.0 - lag / (reach + 1.0)) * (product + product.T)
    return np.asarray(total)


POINTS_PER_BIN = 4
"""Points of the integral over frequency per bin of the window."""


POINTS_PER_MODE = 49
"""Points of the integral over each mode that is narrower than a few bins."""


NEAR_BINS = 3
"""Bins on each side that a point of the integral is seen in."""


NODES_AT_ONCE = 64
"""Points of the integral at which derivatives are joined over channels at a time."""


def score_covariance(problem: Problem, fit: SurfaceFit, along: Floats) -> Floats:
    """Covariance (P, P) ``along`` (2M, P) of the score Σ Jᵀ r of ``fit``: of its log likelihood's slopes by the poles.

    The score is a weighted sum of periodogram ordinates with weights φ(ν), so its covariance is ∫ φφᵀ S² dν / T, T the
    time recorded (Brillinger 1981, theorem 5.10.1): overlapping bins and frames and the memory of narrow modes are in
    it. Two channels share noise where the same modes make their power: |S_cd|² = S_c S_d (Σ_j √(s_cj s_dj))², with s_cj
    the share of mode j in channel c; its largest value, for the signs are not known.
    ``problem``: the floors that were fitted.
    """
    nodes, weights = _nodes(problem, fit)
    power, shares = _resolved(problem, fit, nodes)
    seen = problem.seen
    bin_hz = float(problem.frequency_hz[1] - problem.frequency_hz[0])
    reach = max(1, round(seen.bin_hz / bin_hz))
    offsets = np.arange(-NEAR_BINS * reach, NEAR_BINS * reach + 1)
    at = np.rint((nodes - problem.frequency_hz[0]) / bin_hz).astype(np.int64)[:, None] + offsets
    inside = (at >= 0) & (at < len(problem.frequency_hz))
    kernel = seen.kernel(problem.frequency_hz[0] + bin_hz * at - nodes[:, None])
    # ∫ kernel² is what one average makes of white noise: it turns averages into time
    lags = np.linspace(-4.0, 4.0, 801) * seen.bin_hz
    squared = float(np.sum(seen.kernel(lags) ** 2) * (lags[1] - lags[0]))
    n, n_channels = problem.averages, len(problem.psd)
    by_bin = along.T @ np.stack([j.T for j in fit.jacobian[:n_channels]])
    by_bin *= np.where(n > 0.0, np.sqrt(n) / fit.model, 0.0)[:, None]
    by_bin = np.ascontiguousarray(by_bin.transpose(2, 0, 1)).reshape(len(problem.frequency_hz), -1)
    times = np.full((n_channels, len(nodes)), np.inf)
    for row, some in zip(times, n, strict=True):
        if (some > 0.0).any():  # what a masked frequency leaks into kept bins was recorded as long as those
            row[:] = np.interp(nodes, problem.frequency_hz[some > 0.0], some[some > 0.0]) * squared
    scale = (power * np.sqrt(weights / times)).T[..., None]
    roots = np.sqrt(shares).transpose(2, 0, 1)
    total = np.zeros((along.shape[1],) * 2)
    for some in np.array_split(np.arange(len(nodes)), max(1, len(nodes) // NODES_AT_ONCE)):
        first, last = at[some].clip(0, len(by_bin) - 1)[[0, -1], [0, -1]]
        node, tap = np.nonzero(inside[some])
        spread = np.zeros((len(some), last + 1 - first))
        spread[node, at[some][node, tap] - first] = kernel[some][node, tap]
        phi = (spread @ by_bin[first : last + 1]).reshape(len(some), n_channels, -1) * scale[some]
        common = np.minimum((roots[some] @ roots[some].transpose(0, 2, 1)) ** 2, 1.0)
        common[:, np.arange(n_channels), np.arange(n_channels)] = 1.0
        total += phi.reshape(-1, len(total)).T @ (common @ phi).reshape(-1, len(total))
    return total


def _nodes(problem: Problem, fit: SurfaceFit) -> tuple[Floats, Floats]:
    """Points in Hz and weights of the integral: denser where modes are narrow."""
    frequency, bin_hz = problem.frequency_hz, problem.seen.bin_hz
    step = bin_hz / POINTS_PER_BIN
    nodes = [np.arange(frequency[0] - bin_hz, frequency[-1] + bin_hz, step)]
    turned = np.tan(np.linspace(-1.5, 1.5, POINTS_PER_MODE))
    for f, zeta, tone in zip(fit.poles.frequency_hz, fit.poles.damping, fit.poles.tone, strict=True):
        if zeta * f < 2.0 * bin_hz and not tone:
            nodes.append(f + zeta * f * turned)
    every = np.unique(np.concatenate(nodes))
    every = every[(every > frequency[0] - bin_hz) & (every < frequency[-1] + bin_hz)]
    return every, np.gradient(every)


def _resolved(problem: Problem, fit: SurfaceFit, nodes: Floats) -> tuple[Floats, Floats]:
    """Power (C, V) at ``nodes`` as no window blurs it, and the modes' shares (C, M, V) in it."""
    n_poles, n_channels = len(fit.poles), len(fit.linear)
    parts = np.zeros((n_channels, n_poles, len(nodes)))
    for number in range(n_poles):
        f, zeta = fit.poles.frequency_hz[number], fit.poles.damping[number]
        sigma = zeta * f
        p, q = fit.linear[:, 2 * number], fit.linear[:, 2 * number + 1]
        if fit.poles.tone[number]:  # a tone has no scatter of its own, but noise beats with its skirts
            skirts = fit.part(number)
            skirts[:, np.abs(problem.frequency_hz - f) < POLE_ERRORS.tone_bins * problem.seen.bin_hz] = 0.0
            parts[:, number] = [np.interp(nodes, problem.frequency_hz, row) for row in skirts]
            continue
        damped = f * np.sqrt(1.0 - zeta**2)
        near, far = 1.0 / (sigma + 1j * (nodes - damped)), 1.0 / (sigma + 1j * (nodes + damped))
        parts[:, number] = sigma * (np.outer(p, near.real + far.real) + np.outer(q, far.imag - near.imag))
    n_smooth = len(problem.background) - problem.n_lines
    smooth = np.stack([np.interp(nodes, problem.frequency_hz, row) for row in problem.background[:n_smooth]])
    power = parts.sum(axis=1) + fit.linear[:, 2 * n_poles : 2 * n_poles + n_smooth] @ smooth
    for row, model, n in zip(power, fit.model, problem.averages, strict=True):
        used = n > 0.0  # the model of masked bins is none
        if used.any():
            np.maximum(row, 0.02 * np.interp(nodes, problem.frequency_hz[used], model[used]), out=row)
    power = np.maximum(power, np.finfo(np.float64).tiny)
    return power, np.clip(parts / power[:, None], 0.0, 1.0)


def pole_covariance(problem: Problem, fit: SurfaceFit, *, scatter: Floats) -> Floats:
    """Covariance (2M, 2M) of (f_1, ζ_1, f_2, …), inflated by the mean square residual ``scatter`` (M,) around each.

    The sandwich of the fit's own curvature and the covariance of its score (White 1982).
    ``problem``: the floors that were fitted.
    """
    free = fit.poles.free
    if not len(free):
        return np.zeros((0, 0))
    inverse = inverse_curvature(fit)
    inner = score_covariance(problem, fit, np.eye(len(free))[:, free])
    for j in fit.jacobian[len(problem.psd) :]:
        # channels may share the noise of an order's amplitude: as if all did
        inner = inner + len(problem.psd) * j[:, free].T @ j[:, free]
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(free, free)] = inverse @ inner @ inverse
    scale = fit.poles.values.ravel() * np.sqrt(np.repeat(scatter, 2))
    return np.asarray(covariance * np.outer(scale, scale))


def covariance_of_all(fit: SurfaceFit, covariance: Floats) -> Floats:
    """``covariance`` (2M, 2M) of ``fit``, more where channels and orders disagree about a pole beyond that."""
    free = fit.poles.free
    if not len(free):
        return covariance
    cells = [Cell(j[:, free].T @ j[:, free], j[:, free].T @ r) for j, r in zip(fit.jacobian, fit.residual, strict=True)]
    known = np.asarray(np.maximum(np.diag(covariance)[free] / fit.poles.values.ravel()[free] ** 2, 1e-300))
    more = np.ones(len(free))
    more[free] = disagreement(cells, inverse_curvature(fit), known)
    return np.asarray(covariance * np.outer(more, more))


def side_by_side(parts: list[Floats]) -> Floats:
    """Square matrix (n, n) with the square ``parts`` on its diagonal: what different bands tell is independent."""
    from scipy.linalg import block_diag

    return np.asarray(block_diag(np.zeros((0, 0)), *parts))
