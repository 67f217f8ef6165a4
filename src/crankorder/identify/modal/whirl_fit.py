"""Maximum likelihood of a resonance that moves with speed over whatever spectrum stays where it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.modal.resonance import Sight, seen_pole
from crankorder.identify.modal.surface_fit import SMALLEST_MODEL, gamma_deviance

MOST_STEPS = 40
"""Steps of the fit at most."""

ROUNDS = 8
"""Steps to what stays where nothing else is looked for; one is enough where nothing is known to be beside it."""

RIDGE = 1e-7
"""Share of the largest curvature that is added to all: a resonance that does not move is also a part of what stays."""

MOST_DAMPING = 0.5
"""Largest damping ratio that the fit may take."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cells:
    """Powers ``psd`` (C, K, F) of channels at speeds ``revs_per_s`` (K,) off the middle and at ``frequency_hz`` (F,).

    ``averages`` (C, K, F): independent spectra behind each, none where masked; ``seen``: how the window sees power;
    ``beside`` (C, K, F), or 0: what is known to be there too.
    """

    frequency_hz: Array
    revs_per_s: Array
    psd: Array
    averages: Array
    seen: Sight
    beside: Array | float = 0.0


@dataclass(frozen=True, eq=False)
class Line:
    """A resonance at ``frequency_hz`` in the middle of the speeds, moving by ``slope`` Hz per rev/s, of ``damping``."""

    frequency_hz: float
    slope: float
    damping: float

    def at(self, revs_per_s: Array) -> Array:
        """Its frequency (K,) at ``revs_per_s`` (K,) off the middle."""
        return self.frequency_hz + self.slope * revs_per_s


@dataclass(frozen=True, eq=False)
class LineFit:
    """``line`` of ``power`` (C, K) over the ``fixed`` spectrum (C, F) and its ``deviance`` (C, K).

    ``curvature`` (3, 3): half the second derivatives of the deviance by (Hz, slope, ln damping), all else eliminated;
    ``model`` (C, K, F) is the whole, ``part`` (C, K, F) the line; ``scatter`` the mean square of what is left.
    """

    line: Line
    power: Array
    fixed: Array
    deviance: Array
    curvature: Array
    model: Array
    part: Array
    scatter: float


def shape_of(line: Line, cells: Cells) -> tuple[Array, Array, Array]:
    """Spectrum (K, F) of ``line`` of unit power as ``cells`` see it, and its derivatives by its Hz and ln damping."""
    at = line.at(cells.revs_per_s)[:, None]
    sigma = line.damping * at
    value, slope = seen_pole(sigma + 1j * (cells.frequency_hz - at), cells.seen)
    scale = 2.0 * np.pi * sigma
    by_hz = scale * (slope * (line.damping - 1j)).real + scale / at * value.real
    return scale * value.real, by_hz, scale * ((slope * sigma).real + value.real)


def fixed_alone(cells: Cells) -> tuple[Array, Array]:
    """Spectrum (C, F) of ``cells`` that stays at all speeds, and the deviance (C, K) of nothing else being there."""
    fixed = _low(cells)
    for _ in range(ROUNDS):  # multiplicative steps never lose likelihood (Févotte, Bertin and Durrieu 2009)
        model = np.where(cells.averages > 0.0, fixed[:, None] + cells.beside, 1.0)
        pull, against = (cells.averages * cells.psd / model**2).sum(axis=1), (cells.averages / model).sum(axis=1)
        fixed = np.where(against > 0.0, fixed * pull / np.maximum(against, 1e-300), fixed)
    model = np.where(cells.averages > 0.0, fixed[:, None] + cells.beside, 1.0)
    return fixed, gamma_deviance(cells.psd, cells.averages, model).sum(axis=2)


def fit_line(cells: Cells, start: Line, *, moves: bool) -> LineFit:
    """Best line in ``cells`` from ``start`` on; one that stays where it is unless it ``moves``.

    Its power is free at every speed and in every channel, and so is what stays in every bin: these are eliminated
    from every step (Fisher scoring of the gamma likelihood), so that a mode that stays, however its level varies with
    speed, is told as well by a line that does not move.
    """
    free = np.array([True, moves, True])
    fixed = np.asarray(_low(cells))
    current = _evaluated(cells, start, fixed, _first_power(cells, start, fixed))
    factor = 1e-2
    for _ in range(MOST_STEPS):
        step = _step(cells, current, free, factor)
        trial = _evaluated(cells, *step)
        gained = float((current.deviance - trial.deviance).sum())
        if gained >= -1e-6:
            current, factor = trial, max(0.2 * factor, 1e-6)
            if gained < 0.01:
                break
        else:
            factor *= 10.0
            if factor > 1e6:
                break
    return current


def _low(cells: Cells) -> Array:
    """A low quarter (C, F) over the speeds: what is there when nothing passes."""
    known = np.where(cells.averages > 0.0, cells.psd, np.inf)  # masked ones come last
    ordered = np.sort(known, axis=1)
    place = (cells.averages > 0.0).sum(axis=1) // 3
    low = np.take_along_axis(ordered, place[:, None], axis=1)[:, 0]
    return np.asarray(np.where(np.isfinite(low) & (low > 0.0), low, 1.0))


def _first_power(cells: Cells, line: Line, fixed: Array) -> Array:
    """Power (C, K) that a line would need to make up for what stands over ``fixed``."""
    shape = shape_of(line, cells)[0]
    weight = np.where(cells.averages > 0.0, 1.0, 0.0) * shape
    over = (weight * (cells.psd - cells.beside - fixed[:, None])).sum(axis=2)
    least = 1e-3 * np.median(fixed, axis=1)[:, None]
    return np.asarray(np.maximum(over / np.maximum((weight * shape).sum(axis=2), 1e-12), least))


def _evaluated(cells: Cells, line: Line, fixed: Array, power: Array) -> LineFit:
    part = power[:, :, None] * shape_of(line, cells)[0]
    used = cells.averages > 0.0
    model = np.where(used, np.maximum(fixed[:, None] + part + cells.beside, SMALLEST_MODEL * cells.psd), 1.0)
    deviance = gamma_deviance(cells.psd, cells.averages, model).sum(axis=2)
    left = np.where(used, cells.averages * (cells.psd / model - 1.0) ** 2, 0.0)
    freedom = int(np.count_nonzero(used)) - power.size - fixed.size - 3
    scatter = float(left.sum()) / float(max(freedom, 1))
    return LineFit(line, power, fixed, deviance, np.zeros((3, 3)), model, part, scatter)


def _step(cells: Cells, fit: LineFit, free: NDArray[np.bool_], factor: float) -> tuple[Line, Array, Array]:
    """Where one damped step leads: line, what stays, and power."""
    weight = cells.averages / fit.model**2
    shape, slopes = _slopes(cells, fit)
    pull = np.where(cells.averages > 0.0, cells.psd, 0.0) - np.where(cells.averages > 0.0, fit.model, 0.0)
    parts = _normal(weight, shape, slopes, pull)
    across, inner, outer, pull_power, pull_line = parts
    eased = inner + factor * np.einsum("ckl,kl->ckl", inner, np.eye(inner.shape[1]))
    solved = np.linalg.solve(eased, np.concatenate([across, pull_power[:, :, None]], axis=2))
    hessian = (outer - np.einsum("ckj,cki->cji", across, solved[:, :, :3])).sum(axis=0)
    gradient = (pull_line - np.einsum("ckj,ck->cj", across, solved[:, :, 3])).sum(axis=0)
    move = np.zeros(3)
    chosen = hessian[np.ix_(free, free)]
    damped = chosen + np.diag(factor * np.abs(np.diag(chosen)) + 1e-12)
    move[free] = np.linalg.solve(damped, gradient[free])
    line = _moved(fit.line, move, cells)
    by_power = solved[:, :, 3] - solved[:, :, :3] @ move
    left = pull - by_power[:, :, None] * shape - np.einsum("jckf,j->ckf", slopes, move)
    total = weight.sum(axis=1)
    by_fixed = np.where(total > 0.0, (weight * left).sum(axis=1) / np.maximum(total, 1e-300), 0.0)
    fixed = np.maximum(fit.fixed + by_fixed, 0.1 * fit.fixed)
    return line, fixed, np.maximum(fit.power + by_power, 0.0)


def _slopes(cells: Cells, fit: LineFit) -> tuple[Array, Array]:
    """Shape (K, F) of the line, and derivatives (3, C, K, F) of the model by its Hz, slope and ln damping."""
    shape, by_hz, by_damping = shape_of(fit.line, cells)
    by = np.stack([by_hz, by_hz * cells.revs_per_s[:, None], by_damping])
    return shape, fit.power[None, :, :, None] * by[:, None]


def _normal(weight: Array, shape: Array, slopes: Array, pull: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Normal equations with what stays eliminated: power by line, power, line, and the pulls on power and line."""
    over = 1.0 / np.maximum(weight.sum(axis=1), 1e-300)  # (C, F)
    seen = weight * shape  # (C, K, F)
    inner = -(seen * over[:, None]) @ seen.swapaxes(1, 2)
    diagonal = (seen * shape).sum(axis=2)
    at = np.arange(inner.shape[1])
    inner[:, at, at] += diagonal + RIDGE * diagonal.max(axis=1, initial=1e-300)[:, None]
    weighted = weight * slopes  # (3, C, K, F)
    mean = weighted.sum(axis=2)  # (3, C, F)
    across = np.einsum("ckf,jckf->ckj", seen, slopes) - np.einsum("ckf,cf,jcf->ckj", seen, over, mean)
    outer = np.einsum("ickf,jckf->cij", weighted, slopes) - np.einsum("icf,cf,jcf->cij", mean, over, mean)
    drawn = (weight * pull).sum(axis=1)
    pull_power = (seen * pull).sum(axis=2) - np.einsum("ckf,cf,cf->ck", seen, over, drawn)
    pull_line = np.einsum("jckf,ckf->cj", weighted, pull) - np.einsum("jcf,cf,cf->cj", mean, over, drawn)
    return across, inner, outer, pull_power, pull_line


def _moved(line: Line, move: Array, cells: Cells) -> Line:
    """``line`` after a step, no further than it is wide."""
    reach = max(line.damping * line.frequency_hz, cells.seen.bin_hz)
    span = float(np.abs(cells.revs_per_s).max())
    hz, slope = float(np.clip(move[0], -reach, reach)), float(np.clip(move[1], -reach / span, reach / span))
    narrowest = 0.02 * cells.seen.bin_hz / line.frequency_hz
    damping = float(np.clip(line.damping * np.exp(np.clip(move[2], -1.0, 1.0)), narrowest, MOST_DAMPING))
    lowest = float(cells.frequency_hz[0])
    return Line(max(line.frequency_hz + hz, lowest), line.slope + slope, damping)


def curvature_of(cells: Cells, fit: LineFit) -> Array:
    """Half the second derivatives (3, 3) of the deviance of ``fit`` by (Hz, slope, ln damping), all else eliminated.

    ``cells``: what was fitted.
    """
    weight = cells.averages / fit.model**2
    shape, slopes = _slopes(cells, fit)
    across, inner, outer, _, _ = _normal(weight, shape, slopes, np.zeros_like(fit.model))
    made: Array = (outer - np.einsum("ckj,cki->cji", across, np.linalg.solve(inner, across))).sum(axis=0)
    return made
