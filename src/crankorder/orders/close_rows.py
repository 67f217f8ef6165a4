"""Rows of a line so close to another one that no frame parts them: both solved over whole recordings, as they beat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from crankorder.orders.averages import neighbour_correlation, whitening
from crankorder.orders.intervals import amplitude_interval, phase_interval_deg, t_quantile
from crankorder.orders.true_angle import UNKNOWN_DEG, errors_of_rows
from crankorder.quantities import Complexes, Floats

PARTED_BEATS = 1.5
"""Lines that beat less often between the first frame and the last are not parted: each may hold all of it, or none."""

ALIKE_BEATS = 0.25
"""Lines that beat less often in the longest recording are one by two names: nothing could have told them apart."""

SLOW_WAVES = 4
"""Waves on each side of a line, in cycles over the recording, whose power is that of the noise at it."""

LEFT_RATIO = 4.0
"""Power left over that is so many times the noise beside is of a line whose phase wanders or whose number is wrong."""

DOUBT = 2.0
"""Standard errors by which the number of a line may be off."""


@dataclass(frozen=True)
class Stretch:
    """Frames of one recording in one row: ``phasor`` (channels, frames), which holds each line by its ``share``.

    ``begin_rev`` (frames,) where each frame begins, ``revs`` its length, ``row`` its row; ``share`` (lines,) of its
    amplitude that is left of each line; ``beside`` (channels,) noise power of a phasor by the bins beside.
    """

    item: xr.Dataset
    row: int
    phasor: Complexes
    begin_rev: Floats
    revs: float
    share: Floats
    beside: Floats

    @property
    def turn(self) -> Floats:
        """Crank angle (frames,) of the middle of each frame [rev]."""
        return np.asarray(self.begin_rev + 0.5 * self.revs)


@dataclass(frozen=True)
class CloseRow:
    """The first line of a stretch: (channels,) complex amplitude about angle 0, its errors and its ends.

    ``error`` is the standard error along one axis, ``phase_half`` the half width of the phase's interval [degree].
    """

    row: int
    parted: bool
    weight: float
    value: Complexes
    error: Floats
    freedom: Floats
    low: Floats
    high: Floats
    phase_half: Floats


@dataclass(frozen=True)
class _Fit:
    """Lines of a stretch: ``amplitude`` (lines, channels) in white noise of ``power`` (channels,) of a phasor.

    ``at_line`` (channels,) is the noise power at the first line, ``own`` the variance of its amplitude in noise of
    power 1, ``follows`` (lines, channels) how it changes with the numbers of all lines; ``normal`` and ``score`` tell
    by how much these are off. ``left`` (channels,) is the amplitude of what no line and no noise explains.
    """

    amplitude: Complexes
    at_line: Floats
    freedom: float
    own: float
    follows: Complexes
    normal: Floats
    score: Floats
    left: Floats


def close_rows(stretches: Sequence[Stretch], orders: Floats, *, wanders: bool = False) -> list[CloseRow]:
    """What the ``stretches`` of a test hold of the first of ``orders`` (lines,), the others of which are close to it.

    Amplitudes follow by least squares from the numbers of the lines over all frames of a stretch, whose overlap is
    allowed for. By how much the numbers may be off is told by all stretches together, and by each where it surely
    says otherwise: what the line may take of its neighbours by that is part of its interval. ``wanders``: the first
    line alone may be no exact multiple, so that power which none explains is its own.
    """
    fits = [_fit(one, orders) if len(one.turn) > len(orders) else None for one in stretches]
    normal = sum((fit.normal for fit in fits if fit is not None), np.zeros((len(orders), len(orders))))
    score = sum((fit.score for fit in fits if fit is not None), np.zeros(len(orders)))
    off, error = _off(normal, score)
    doubt = np.abs(off) + DOUBT * error
    return [_row(one, orders, fit, doubt, wanders) for one, fit in zip(stretches, fits, strict=True)]


def _fit(one: Stretch, orders: Floats) -> _Fit:
    n, count = len(one.turn), len(orders)
    white = whitening(one.begin_rev, revs_per_frame=one.revs)
    middle = one.turn - one.turn.mean()
    waves = one.share * np.exp(2j * np.pi * np.outer(one.turn, orders))
    basis, slopes = white @ waves, white @ (2j * np.pi * middle[:, None] * waves)
    inverse = np.linalg.pinv(basis, rcond=1e-9)
    data = white @ one.phasor.T
    amplitude = inverse @ data
    left = data - basis @ amplitude
    freedom = float(n - count)
    power = np.maximum(np.square(np.abs(left)).sum(axis=0) / freedom, 1e-24 * np.square(np.abs(data)).mean(axis=0))
    rest = one.phasor.T - waves @ amplitude
    at_line, worth = _noise_at(one, rest, orders, power)
    unexplained = np.maximum(np.square(np.abs(rest)).mean(axis=0) - LEFT_RATIO * one.beside, 0.0)
    unexplained[np.square(np.abs(rest)).mean(axis=0) < 1e-12 * np.square(np.abs(one.phasor)).mean()] = 0.0
    # how moving each line changes what is seen, beyond its amplitude; channels by their noise
    change = slopes[:, :, None] * amplitude
    moved = change - np.einsum("fb,blc->flc", basis, np.einsum("bf,flc->blc", inverse, change))
    weight = 2.0 / np.maximum(at_line, 1e-300)
    normal = np.einsum("flc,fmc,c->lm", moved.conj(), moved, weight).real
    score = np.einsum("flc,fc,c->l", moved.conj(), left, weight).real
    follows = -np.einsum("f,flc->lc", inverse[0], change)
    own = float(np.square(np.abs(inverse[0])).sum())
    beyond = np.sqrt(unexplained) / float(one.share[0])
    return _Fit(amplitude, at_line, min(2.0 * freedom, worth), own, follows, normal, score, beyond)


def _noise_at(one: Stretch, left: Complexes, orders: Floats, power: Floats) -> tuple[Floats, float]:
    """Noise power (channels,) of a phasor right beside the lines, and the degrees of freedom behind it.

    ``left`` (frames, channels) of the phasors by the fit, whose white ``power`` (channels,) it is at least.
    """
    n, span = len(left), float(np.ptp(one.turn))
    if n < 4 * SLOW_WAVES:
        return np.maximum(power, one.beside), np.inf
    steps = np.array([k for k in range(-SLOW_WAVES, SLOW_WAVES + 1) if k])
    near = (orders[:, None] + steps / span).ravel()
    owner = np.zeros(n, dtype=np.int64)
    shared = neighbour_correlation(one.begin_rev, owner, revs_per_frame=one.revs, window="hann")
    slow = np.square(np.abs(np.exp(-2j * np.pi * np.outer(near, one.turn)) @ left)).mean(axis=0)
    return np.maximum(power, slow / (2.0 * float(shared.sum()) - n)), 2.0 * len(steps)


def _off(normal: Floats, score: Floats) -> tuple[Floats, Floats]:
    """By how much numbers (lines,) are off, and the standard error of that; directions that nothing tells are left."""
    inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
    return np.asarray(inverse @ score), np.sqrt(np.maximum(np.diag(inverse), 0.0))


def _row(one: Stretch, orders: Floats, fit: _Fit | None, doubt: Floats, wanders: bool) -> CloseRow:
    span = float(np.ptp(one.turn))
    parted = fit is not None and float(np.abs(orders[1:] - orders[0]).min()) * span >= PARTED_BEATS
    size = np.abs(one.phasor)
    both = size.max(axis=1) / float(one.share[0]) + t_quantile(np.array(np.inf)) * np.sqrt(one.beside)
    if fit is None:
        value = np.sqrt(np.square(size).mean(axis=1)) / float(one.share[0]) + 0j
        error, freedom, low, high = 0.5 * both, np.ones(len(both)), np.zeros(len(both)), both
        phase_half = np.full(len(both), UNKNOWN_DEG)
    else:
        value, freedom = fit.amplitude[0], np.full(len(both), fit.freedom)
        off, told = _off(fit.normal, fit.score)
        doubt = np.maximum(doubt, np.abs(off) - (1.0 + DOUBT) * told)
        if span > 0.0:
            doubt = np.minimum(doubt, 0.5 / span)
        unit = (value / np.maximum(np.abs(value), 1e-300)).conj()
        taken = fit.follows * unit * doubt[:, None]
        along, across = (np.sqrt(np.square(part).sum(axis=0)) for part in (taken.real, taken.imag))
        power = fit.own * fit.at_line
        error = np.sqrt(0.5 * power + np.square(along / DOUBT))
        own_low, own_high = amplitude_interval(np.abs(value), power, freedom)
        low, high = np.maximum(own_low - along, 0.0), own_high + along + fit.left
        error = np.hypot(error, fit.left / DOUBT)
        phase_half = phase_interval_deg(np.abs(value), power + 2.0 * np.square(across / DOUBT), freedom)
        if wanders:
            value = np.hypot(np.abs(value), fit.left) * unit.conj()
        if not parted:
            low, high = np.zeros(len(both)), np.maximum(high, both)
            value = value * np.minimum(1.0, both / np.maximum(np.abs(value), 1e-300))
            error, phase_half = np.maximum(error, 0.25 * both), np.full(len(both), UNKNOWN_DEG)
    n = len(one.turn)
    angle = errors_of_rows([one.item], np.zeros(n, dtype=np.int64), [np.arange(n)])
    order = orders[:1]
    high = high / angle.kept(order)
    phase_half = angle.phase_half_deg(phase_half, order)
    return CloseRow(one.row, parted, float(n), value, error, freedom, low, high, phase_half)


def joined_row(parts: Sequence[CloseRow]) -> CloseRow:
    """The ``parts`` of one row, of several recordings, as one: those that part the lines where some do."""
    used = [one for one in parts if one.parted] or list(parts)
    if len(used) == 1:
        return used[0]
    weight = np.array([one.weight for one in used])
    share = weight / weight.sum()
    value = np.array([one.value for one in used])
    size = share @ np.abs(value)
    direction = share @ value
    direction = direction / np.maximum(np.abs(direction), 1e-300)
    scatter = share @ np.square(np.abs(value) - size) / max(len(used) - 1, 1)
    error = np.sqrt(np.square(share) @ np.square([one.error for one in used]) + scatter)
    freedom, low = (np.min([getattr(one, name) for one in used], axis=0) for name in ("freedom", "low"))
    high, half = (np.max([getattr(one, name) for one in used], axis=0) for name in ("high", "phase_half"))
    weighs, value = float(weight.sum()), size * direction
    return CloseRow(used[0].row, used[0].parted, weighs, value, error, freedom, low, high, half)
