"""Rows of a line so close to another one that no frame parts them: both solved over whole recordings, as they beat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from crankorder.orders.intervals import amplitude_interval, phase_interval_deg, t_quantile
from crankorder.orders.joint_lines import Band, HeldFrames, JointLines, Place, hann_lobe, joint_lines
from crankorder.orders.true_angle import UNKNOWN_DEG, errors_of_rows
from crankorder.quantities import Complexes, Floats

ALIKE_BEATS = 0.25
"""Lines that beat less often in the longest recording are one by two names: nothing could have told them apart."""

LEFT_RATIO = 4.0
"""Power left over that is so many times the noise beside is of a line whose phase wanders or whose number is wrong."""

DOUBT = 2.0
"""Standard errors by which the number of a line may be off."""


@dataclass(frozen=True)
class Stretch:
    """Frames of one recording (OrderFrames ``item``) in one ``row`` of the map.

    Spectra are in the ``unit`` (channels,); ``beside`` (channels,) is the noise power of a phasor by the bins beside.
    """

    item: xr.Dataset
    row: int
    held: HeldFrames
    beside: Floats
    unit: Floats


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


def close_rows(
    stretches: Sequence[Stretch], orders: Floats, apart: Sequence[float] = (), *, wanders: bool = False
) -> list[CloseRow]:
    """What the ``stretches`` of a test hold of the first of ``orders`` (lines,), the others of which are close to it.

    Lines so far ``apart`` that a frame parts them are solved with them. By how much the numbers may be off is told by
    all stretches together, and by each where it surely says otherwise: what the line may take of its neighbours by that
    is part of its interval. ``wanders``: the first line alone may be no exact multiple, so that power which none
    explains is its own.
    """
    count = len(orders)
    places = [Place(turns=float(order)) for order in (*orders, *apart)]
    free = [number < count for number in range(len(places))]
    fits: list[JointLines | None] = []
    for stretch in stretches:
        band = Band.about(stretch.held, float(orders.min()), float(orders.max()))
        enough = band is not None and len(band.data) > 2 * len(places)
        fits.append(joint_lines(band, places, free=free, settled=False) if enough and band is not None else None)
    scores = [fit.information for fit in fits if fit is not None]
    normal = sum((normal for normal, _ in scores), np.zeros((count, count)))
    off, error = _off(normal, sum((score for _, score in scores), np.zeros(count)))
    doubt = np.abs(off) + DOUBT * error
    return [_row(stretch, orders, fit, doubt, wanders) for stretch, fit in zip(stretches, fits, strict=True)]


def _off(normal: Floats, score: Floats) -> tuple[Floats, Floats]:
    """By how much numbers (lines,) are off, and the standard error of that; directions that nothing tells are left."""
    inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
    return np.asarray(inverse @ score), np.sqrt(np.maximum(np.diag(inverse), 0.0))


def _row(stretch: Stretch, orders: Floats, fit: JointLines | None, doubt: Floats, wanders: bool) -> CloseRow:
    held = stretch.held
    parted = fit is not None and all(held.parts(float(orders[0]), float(other)) for other in orders[1:])
    at = min(round(float(orders[0]) * held.revs), held.spectrum.shape[2] - 1)
    share = float(hann_lobe(np.array(float(orders[0]) * held.revs - at)))
    if fit is None:
        size = np.abs(held.spectrum[:, :, at]) / share
        value = np.sqrt(np.square(size).mean(axis=1)) + 0j
        both = size.max(axis=1) + t_quantile(np.array(np.inf)) * np.sqrt(stretch.beside)
        error, freedom, low, high = 0.5 * both, np.ones(len(both)), np.zeros(len(both)), both
        phase_half = np.full(len(both), UNKNOWN_DEG)
    else:
        line, unit, bin_at = fit.sighting(0), fit.band.unit, int(np.flatnonzero(fit.band.bins == at)[0])
        close = fit.left + fit.band.waves(fit.places[: len(orders)]) @ fit.phasor[: len(orders)]
        size = np.abs(fit.band.spectra(close)[:, bin_at]) * unit / share
        both = size.max(axis=0) + t_quantile(np.array(np.inf)) * np.sqrt(stretch.beside)
        value, freedom = line.phasor, np.full(len(both), line.degrees_of_freedom)
        unexplained = np.square(np.abs(fit.band.spectra(fit.left)[:, bin_at])).mean(axis=0) * np.square(unit)
        unexplained = np.maximum(unexplained - LEFT_RATIO * stretch.beside, 0.0)
        unexplained[unexplained < 1e-12 * np.square(both)] = 0.0
        beyond = np.sqrt(unexplained) / share
        off, known = _off(*fit.information)
        doubt = np.maximum(doubt, np.abs(off) - (1.0 + DOUBT) * known)
        doubt = np.minimum(doubt, 0.5 / held.span_rev)
        along, across = (np.sqrt(part) * unit for part in fit.doubt(0, np.diag(np.square(doubt))))
        power = fit.own[0] * fit.noise(0)[0] * np.square(unit)
        error = np.sqrt(0.5 * power + np.square(along / DOUBT))
        own_low, own_high = amplitude_interval(np.abs(value), power, freedom)
        low, high = np.maximum(own_low - along, 0.0), own_high + along + beyond
        error = np.hypot(error, beyond / DOUBT)
        phase_half = phase_interval_deg(np.abs(value), power + 2.0 * np.square(across / DOUBT), freedom)
        if wanders:
            direction = value / np.maximum(np.abs(value), 1e-300)
            value = np.hypot(np.abs(value), beyond) * direction
        if not parted:
            low, high = np.zeros(len(both)), np.maximum(high, both)
            value = value * np.minimum(1.0, both / np.maximum(np.abs(value), 1e-300))
            error, phase_half = np.maximum(error, 0.25 * both), np.full(len(both), UNKNOWN_DEG)
    n = len(held.turn)
    angle = errors_of_rows([stretch.item], np.zeros(n, dtype=np.int64), [np.arange(n)])
    order = orders[:1]
    high = high / angle.kept(order)
    phase_half = angle.phase_half_deg(phase_half, order)
    return CloseRow(stretch.row, parted, float(n), value, error, freedom, low, high, phase_half)


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
