"""Errors of poles that orders tell, and covariance of those that the floor tells: what rows and channels share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crankorder.identify.modes.order_responses import NUMBERS as ORDER_RESPONSES
from crankorder.identify.modes.order_responses import Block, Projected, jacobian
from crankorder.identify.modes.surface_fit import Poles, Problem, SurfaceFit, inverse_curvature
from crankorder.orders.intervals import Z95, half_widths
from crankorder.quantities import Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "pole_errors")


@dataclass(frozen=True, eq=False)
class Cell:
    """A part of the data that tells poles by itself: its ``hessian`` (P, P) and ``score`` (P,) by ln f_1, ln ζ_1, …"""

    hessian: Floats
    score: Floats


def order_pole_covariance(blocks: Sequence[Block], parts: Sequence[Projected], poles: Poles, *, fixed: int) -> Floats:
    """Covariance of (f_1, ζ_1, f_2, …) of the ``poles`` after the ``fixed`` ones, which ``blocks`` tell.

    Curvature, and scores as they are seen to scatter (White 1982). Channels are correlated, and so are speeds side by
    side where the law of a force is not quite that of the fit: the scores of neighbours count together (Newey and West
    1987). Where a mode beside is missing, or one stands for two, each order and channel asks for a pole of its own, by
    its share in them: the scores of each count together (Liang and Zeger 1986). Each where that makes more of them.
    ``parts`` are the blocks as projected with the poles.
    """
    own = slice(2 * fixed, 2 * len(poles))
    size = own.stop - own.start
    orders: list[Cell] = []
    alone: list[Cell] = []
    inner, beside = np.zeros((size, size)), np.zeros((size, size))
    for block, part in zip(blocks, parts, strict=True):
        if block.scatter > ORDER_RESPONSES.most_scatter or part.degrees_of_freedom < 1:
            continue
        seen = block.rows
        rows = jacobian(block, poles, part)[:, own].reshape(seen.parts, *seen.amplitude.shape, size)
        spare = seen.parts * int(seen.counts.sum()) / part.degrees_of_freedom
        left = np.stack([part.left.real] if seen.power else [part.left.real, part.left.imag])
        norm = np.maximum(np.linalg.norm(part.left, axis=1), 1e-300)
        alike = (part.left @ part.left.conj().T).real / np.outer(norm, norm)
        inner += np.einsum("cd,pcki,pdkj->ij", alike, rows, rows)
        hessian, score = np.einsum("pcki,pckj->cij", rows, rows), np.einsum("pcki,pck->ci", rows, left * np.sqrt(spare))
        alone += map(Cell, hessian, score)
        orders.append(Cell(np.sum(hessian, axis=0), np.sum(score, axis=0)))
        scores = np.einsum("pcki,pck->ki", rows, left)[np.argsort(seen.speed_rpm)]
        beside += spare * _scores_together(scores)
    if not orders:
        return np.zeros((size, size))
    curved = np.sum([cell.hessian for cell in orders], axis=0)
    inverse = np.asarray(np.linalg.pinv(curved, hermitian=True), dtype=np.float64)
    covariance = inverse @ inner @ inverse
    known = np.asarray(np.maximum(np.diag(covariance), 1e-300), dtype=np.float64)
    scale = poles.values.ravel()[own]
    more = np.sqrt(np.maximum(np.diag(inverse @ beside @ inverse) / known, 1.0))
    for cells in (orders, alone):
        more = np.maximum(more, disagreement(cells, inverse, known))
    return np.asarray(covariance * np.outer(scale * more, scale * more))


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
    scattered = np.sum(influence**2, axis=0) * np.minimum(
        1.0 / np.maximum(1.0 - squared, 1e-9), NUMBERS.most_for_few_ratio
    )
    excess = np.maximum(scattered - known, 0.0)
    few = np.maximum(1.0 / squared - 1.0, 1.0)
    degrees_of_freedom = few / np.maximum(excess / (known + excess), 1e-6) ** 2
    return np.asarray(
        np.where(excess > 0.0, np.sqrt((known + excess) / known) * half_widths(degrees_of_freedom) / Z95, 1.0),
        dtype=np.float64,
    )


def _scores_together(scores: Floats) -> Floats:
    """Sum of the products of ``scores`` (K, parameters) with themselves and their neighbours by speed."""
    reach = min(len(scores) - 1, round(len(scores) ** (1.0 / 3.0)))
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
            skirts[:, np.abs(problem.frequency_hz - f) < NUMBERS.tone_bins * problem.seen.bin_hz] = 0.0
            parts[:, number] = [np.interp(nodes, problem.frequency_hz, row) for row in skirts]
            continue
        damped = f * np.sqrt(1.0 - zeta**2)
        near, far = 1.0 / (sigma + 1j * (nodes - damped)), 1.0 / (sigma + 1j * (nodes + damped))
        parts[:, number] = sigma * (np.outer(p, near.real + far.real) + np.outer(q, far.imag - near.imag))
    n_smooth = len(problem.background) - problem.n_lines
    smooth = fit.linear[:, 2 * n_poles : 2 * n_poles + n_smooth] @ np.stack(
        [np.interp(nodes, problem.frequency_hz, row) for row in problem.background[:n_smooth]]
    )
    power = parts.sum(axis=1) + smooth
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


def covariance_of_all(problem: Problem, fit: SurfaceFit, *, scatter: Floats) -> Floats:
    """Covariance as of :func:`pole_covariance`, more where channels and orders disagree about a pole beyond that.

    ``problem``: the floors that were fitted; ``fit`` and ``scatter`` (M,): as there.
    """
    covariance, free = pole_covariance(problem, fit, scatter=scatter), fit.poles.free
    if not len(free):
        return covariance
    cells = [Cell(j[:, free].T @ j[:, free], j[:, free].T @ r) for j, r in zip(fit.jacobian, fit.residual, strict=True)]
    known = np.asarray(np.maximum(np.diag(covariance)[free] / fit.poles.values.ravel()[free] ** 2, 1e-300))
    more = np.ones(len(free))
    more[free] = disagreement(cells, inverse_curvature(fit), known)
    return np.asarray(covariance * np.outer(more, more))


def side_by_side(parts: list[Floats]) -> Floats:
    """Square matrix with ``parts`` on its diagonal: what different bands tell is independent."""
    from scipy.linalg import block_diag

    return np.asarray(block_diag(np.zeros((0, 0)), *parts))
