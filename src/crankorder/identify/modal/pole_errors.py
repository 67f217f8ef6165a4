"""Errors of poles that orders tell: what channels share, what speeds side by side share, what orders disagree by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.intervals import Z95, half_widths
from crankorder.identify.modal.order_responses import MOST_SCATTER, Block, Projected, jacobian
from crankorder.identify.modal.surface_fit import Poles

MOST_FOR_FEW = 2.0
"""Factor by which the scatter of few cells is taken for larger at most: that of two which weigh the same."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cell:
    """A part of the data that tells poles by itself: its ``hessian`` (P, P) and ``score`` (P,) by ln f_1, ln ζ_1, …"""

    hessian: Array
    score: Array


def order_pole_covariance(blocks: Sequence[Block], parts: Sequence[Projected], poles: Poles, *, fixed: int) -> Array:
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
        if block.scatter > MOST_SCATTER or part.freedom < 1:
            continue
        rows = jacobian(block, poles, part)[:, own].reshape(block.parts, *block.amplitude.shape, size)
        spare = block.parts * int(block.rows.sum()) / part.freedom
        left = np.stack([part.left.real] if block.power else [part.left.real, part.left.imag])
        norm = np.maximum(np.linalg.norm(part.left, axis=1), 1e-300)
        alike = (part.left @ part.left.conj().T).real / np.outer(norm, norm)
        inner += np.einsum("cd,pcki,pdkj->ij", alike, rows, rows)
        single = _by_channel(rows, left * np.sqrt(spare))
        alone += single
        orders.append(Cell(_summed([cell.hessian for cell in single]), _summed([cell.score for cell in single])))
        scores = np.einsum("pcki,pck->ki", rows, left)[np.argsort(block.speed_rpm)]
        beside += spare * _scores_together(scores)
    if not orders:
        return np.zeros((size, size))
    curved = _summed([cell.hessian for cell in orders])
    inverse = np.asarray(np.linalg.pinv(curved, hermitian=True), dtype=np.float64)
    made = inverse @ inner @ inverse
    known = np.asarray(np.maximum(np.diag(made), 1e-300), dtype=np.float64)
    scale = np.stack([poles.frequency_hz, poles.damping], axis=1).ravel()[own]
    more = np.sqrt(np.maximum(np.diag(inverse @ beside @ inverse) / known, 1.0))
    for cells in (orders, alone):
        more = np.maximum(more, disagreement(cells, inverse, known))
    return np.asarray(made * np.outer(scale * more, scale * more))


def disagreement(cells: Sequence[Cell], inverse: Array, known: Array) -> Array:
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
    scattered = np.sum(influence**2, axis=0) * np.minimum(1.0 / np.maximum(1.0 - squared, 1e-9), MOST_FOR_FEW)
    excess = np.maximum(scattered - known, 0.0)
    few = np.maximum(1.0 / squared - 1.0, 1.0)
    freedom = few / np.maximum(excess / (known + excess), 1e-6) ** 2
    return np.asarray(
        np.where(excess > 0.0, np.sqrt((known + excess) / known) * half_widths(freedom) / Z95, 1.0), dtype=np.float64
    )


def _by_channel(rows: Array, left: Array) -> list[Cell]:
    """Cell of each channel of the derivatives ``rows`` (parts, C, K, P) and residuals ``left`` (parts, C, K)."""
    hessian, score = np.einsum("pcki,pckj->cij", rows, rows), np.einsum("pcki,pck->ci", rows, left)
    return [Cell(own, one) for own, one in zip(hessian, score, strict=True)]


def _summed(parts: Sequence[Array]) -> Array:
    return np.asarray(np.sum(parts, axis=0))


def _scores_together(scores: Array) -> Array:
    """Sum of the products of ``scores`` (K, parameters) with themselves and their neighbours by speed."""
    reach = min(len(scores) - 1, round(len(scores) ** (1.0 / 3.0)))
    total = scores.T @ scores
    for lag in range(1, reach + 1):
        product = scores[lag:].T @ scores[:-lag]
        total += (1.0 - lag / (reach + 1.0)) * (product + product.T)
    return np.asarray(total)
