"""Whirl modes: resonances of the floor whose natural frequency moves with the speed, forward or backward."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from crankorder.campbell.map import HANN_CORRELATION
from crankorder.identify.found import ModalFit, Mode, OrderResponse, Whirl
from crankorder.identify.modal.floor import Floor
from crankorder.identify.modal.surface_fit import NUMBERS as SURFACE_FIT
from crankorder.identify.modal.surface_fit import Sight, gamma_deviance, seen_pole
from crankorder.settings import IdentifySettings, MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-modal.toml", table="whirl"):
    most_damping_ratio: float
    fewest_speeds: int
    most_slope_orders: float
    cap_sigmas: float
    most_tries: int
    masked_share: float
    least_averages: float
    broader_widths: float
    flank_widths: float
    flank_db: float
    sure_sigmas: float
    sideband_orders: float


NUMBERS = _Numbers.load()

MOST_STEPS = 40
"""Steps of the fit at most."""

STAYING_STEPS = 8
"""Steps to what stays where nothing else is looked for; one is enough where nothing is known to be beside it."""

RIDGE = 1e-7
"""Share of the largest curvature that is added to all: a resonance that does not move is also a part of what stays."""

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
    for _ in range(STAYING_STEPS):  # multiplicative steps never lose likelihood (Févotte, Bertin and Durrieu 2009)
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
    model = np.where(
        used, np.maximum(fixed[:, None] + part + cells.beside, SURFACE_FIT.smallest_model_share * cells.psd), 1.0
    )
    deviance = gamma_deviance(cells.psd, cells.averages, model).sum(axis=2)
    left = np.where(used, cells.averages * (cells.psd / model - 1.0) ** 2, 0.0)
    degrees_of_freedom = int(np.count_nonzero(used)) - power.size - fixed.size - 3
    scatter = float(left.sum()) / float(max(degrees_of_freedom, 1))
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
    damping = float(np.clip(line.damping * np.exp(np.clip(move[2], -1.0, 1.0)), narrowest, NUMBERS.most_damping_ratio))
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


BOXES = (3, 7, 15, 31)
"""Widths in bins over which what stands over the mean is summed."""

ROUNDS = 3
"""Times that several whirls are fitted, each with what the others came to."""


@dataclass(frozen=True)
class _Candidate:
    """A line, its half width ``width_hz``, that the sums along slopes show."""

    frequency_hz: float
    slope: float
    width_hz: float

    @property
    def line(self) -> Line:
        """The line as a fit starts from it."""
        return Line(self.frequency_hz, self.slope, self.width_hz / self.frequency_hz)


@dataclass(frozen=True, eq=False)
class _Told:
    """``fit`` of the ``cells`` from bin ``first`` on: channels ``seen`` (C,), its ``gain`` over a line that stays."""

    cells: Cells
    first: int
    fit: LineFit
    seen: NDArray[np.bool_]
    gain: float

    @property
    def bins(self) -> slice:
        """The bins that were fitted."""
        return slice(self.first, self.first + len(self.cells.frequency_hz))

    @property
    def per(self) -> float:
        """Deviance that stands for one of independent bins."""
        return HANN_CORRELATION * max(1.0, self.fit.scatter)


def whirls_of(floor: Floor, *, settings: IdentifySettings) -> tuple[Floor, tuple[Whirl, ...]]:
    """``floor`` without what moves with the speed, and the whirls, lowest first.

    Cells at each speed are compared with the same bins at the other speeds; what stands out is summed along lines
    f0 + k s of all slopes k. A candidate is a whirl where the likelihood of a resonance that moves is better than that
    of one that stays, at ``settings.false_alarm_probability`` over all lines tried, and no single speed decides so;
    where its slope is not 0; and where it does not start at 0 Hz, as an order does.
    """
    speed = floor.speed_rpm
    if (
        len(speed) < NUMBERS.fewest_speeds
        or not speed.min() > 0.0
        or speed.max() < settings.mode_speed_ratio * speed.min()
    ):
        return floor, ()
    whole = cells = _cells(floor)
    excess = _excess(cells)
    found: list[_Told] = []
    for _ in range(NUMBERS.most_tries):
        candidate, tried = _best_line(excess, cells)
        if candidate is None:
            break
        told = _told(candidate, cells, tried, settings)
        line = candidate.line if told is None else told.fit.line
        if told is not None:
            found.append(told)
            cells = _known(whole, found)
        near = np.abs(cells.frequency_hz - line.at(cells.revs_per_s)[:, None])
        excess = np.where(near <= max(3.0 * line.damping * line.frequency_hz, 3.0 * floor.step_hz), np.nan, excess)
    for _ in range(ROUNDS if len(found) > 1 else 0):
        for number, told in enumerate(found):
            found[number] = _beside_others(told, found[:number] + found[number + 1 :], whole)
    said = [(whirl, told) for told in found if (whirl := _whirl(told, floor, settings)) is not None]
    for _, told in said:
        floor = _without(told, floor)
    return floor, tuple(sorted((whirl for whirl, _ in said), key=lambda item: item.frequency_hz))


def _cells(floor: Floor) -> Cells:
    """Cells of the floor before those that stand out were left out."""
    known = np.isfinite(floor.moving) & (floor.moving > 0.0)
    averages = np.where(known, floor.cell_averages[:, :, None], 0.0)
    psd = np.where(averages > 0.0, floor.moving, 0.0)
    middle = 0.5 * (floor.speed_rpm.min() + floor.speed_rpm.max())
    return Cells(floor.frequency_hz, (floor.speed_rpm - middle) / 60.0, psd, averages, floor.seen)


def _excess(cells: Cells) -> Array:
    """What each cell (K, F) stands over its bin's median over the speeds, all channels, in standard deviations."""
    known = np.where(cells.averages > 0.0, cells.psd, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        ordered = np.sort(known, axis=1)
        count = np.count_nonzero(np.isfinite(known), axis=1)
        middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[:, None] // 2, axis=1)
        over = np.minimum(np.sqrt(cells.averages) * (known / middle - 1.0), NUMBERS.cap_sigmas)
        held = np.isfinite(over).any(axis=2)  # a channel may be missing at some speeds
        over[held] -= np.nanmedian(over[held], axis=1, keepdims=True)
        total = np.nansum(over, axis=0) / np.sqrt(np.maximum(np.isfinite(over).sum(axis=0), 1))
    total[~np.isfinite(over).any(axis=0)] = np.nan
    scatter = 1.4826 * float(np.nanmedian(np.abs(total)))
    return np.asarray(total / max(scatter, 1e-12))


def _best_line(excess: Array, cells: Cells) -> tuple[_Candidate | None, int]:
    """The line along which ``excess`` sums up to most, None where noise alone does so; how many were tried."""
    step = float(cells.frequency_hz[1] - cells.frequency_hz[0])
    span = float(np.ptp(cells.revs_per_s))
    n_slopes = max(2, int(np.ceil(NUMBERS.most_slope_orders * span / cells.seen.bin_hz)))
    slopes = np.linspace(-NUMBERS.most_slope_orders, NUMBERS.most_slope_orders, 2 * n_slopes + 1)
    slopes = slopes[np.abs(slopes) * span >= 2.0 * cells.seen.bin_hz]
    if not len(slopes):
        return None, 0
    shifts = np.rint(slopes[:, None] * cells.revs_per_s / step).astype(np.int64)
    sums, counts = _sheared(excess, shifts)
    tried = len(slopes) * excess.shape[1] * len(BOXES)
    best, found = float(np.sqrt(2.0 * np.log(tried))), None
    for box in BOXES:
        along, independent = _boxed(sums, box), _boxed(counts, box)
        enough = independent >= 0.5 * box * len(excess)
        score = np.where(enough, along / np.sqrt(np.maximum(HANN_CORRELATION * independent, 1.0)), 0.0)
        score /= max(1.0, 1.4826 * float(np.median(np.abs(score[enough]))) if enough.any() else 1.0)
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        if score[row, column] > best:
            best = float(score[row, column])
            found = _Candidate(float(cells.frequency_hz[column]), float(slopes[row]), 0.25 * box * step)
    return found, tried


def _sheared(excess: Array, shifts: NDArray[np.int64]) -> tuple[Array, Array]:
    """Sums and counts (slopes, F) of ``excess`` (K, F) along lines shifted by ``shifts`` (slopes, K) bins."""
    n_bins = excess.shape[1]
    reach = int(np.abs(shifts).max())
    sums, counts = np.zeros((len(shifts), n_bins)), np.zeros((len(shifts), n_bins))
    for k, row in enumerate(excess):
        padded = np.pad(row, reach, constant_values=np.nan)
        known = np.isfinite(padded)
        for made, values in ((sums, np.where(known, padded, 0.0)), (counts, known.astype(np.float64))):
            windows = np.lib.stride_tricks.sliding_window_view(values, n_bins)
            made += windows[reach + shifts[:, k]]
    return sums, counts


def _boxed(values: Array, box: int) -> Array:
    """Sums of ``values`` (…, F) over ``box`` bins around each."""
    whole = np.cumsum(np.pad(values, ((0, 0), (box // 2 + 1, box // 2))), axis=1)
    return np.asarray(whole[:, box:] - whole[:, :-box])


def _told(candidate: _Candidate, cells: Cells, tried: int, settings: IdentifySettings) -> _Told | None:
    """The fit of ``candidate``; None where it does not stand out, or a line that stays says as much."""
    line = candidate.line
    here, first = _around(line, candidate.width_hz, cells)
    if line.at(cells.revs_per_s).min() <= cells.frequency_hz[0]:
        return None
    none = fixed_alone(here)[1]
    narrow = replace(line, damping=0.3 * line.damping)
    fit = min((fit_line(here, start, moves=True) for start in (line, narrow)), key=lambda one: one.deviance.sum())
    chance = settings.false_alarm_probability / tried
    per = HANN_CORRELATION * max(1.0, fit.scatter)
    seen = (none - fit.deviance).sum(axis=1) / per > float(chdtri(fit.power.shape[1] + 3, chance))
    if not seen.any() or fit.line.at(cells.revs_per_s).min() <= cells.frequency_hz[0]:
        return None
    still = _best_still(here, fit)
    gain = (still.deviance - fit.deviance).sum(axis=0) / per
    if gain.sum() - max(0.0, float(gain.max())) < float(chdtri(2, chance)):
        return None
    return _Told(here, first, fit, seen, float(gain.sum()))


def _beside_others(told: _Told, others: list[_Told], whole: Cells) -> _Told:
    """``told`` fitted anew where the ``others`` are known to be there too, in cells of which none was masked."""
    line = told.fit.line
    here, first = _around(line, line.damping * line.frequency_hz, whole)
    beside = np.zeros_like(here.psd)
    for other in others:
        beside += other.fit.power[:, :, None] * shape_of(other.fit.line, here)[0]
    here = replace(here, beside=beside)
    return replace(told, cells=here, first=first, fit=fit_line(here, line, moves=True))


def _around(line: Line, width_hz: float, cells: Cells) -> tuple[Cells, int]:
    """Cells that ``line`` of ``width_hz`` sweeps over, and what is beside; the first bin's number."""
    at = line.at(cells.revs_per_s)
    reach = max(15.0 * cells.seen.bin_hz, 8.0 * width_hz)
    first, last = np.searchsorted(cells.frequency_hz, [at.min() - reach, at.max() + reach])
    part = slice(int(first), int(last))
    beside = cells.beside if isinstance(cells.beside, float) else cells.beside[:, :, part]
    return replace(
        cells,
        frequency_hz=cells.frequency_hz[part],
        psd=cells.psd[:, :, part],
        averages=cells.averages[:, :, part],
        beside=beside,
    ), int(first)


def _best_still(cells: Cells, fit: LineFit) -> LineFit:
    """The best line that does not move, from several places and widths within what ``fit`` sweeps over."""
    at = fit.line.at(cells.revs_per_s)
    half = 0.5 * float(np.ptp(at))
    starts = [(f, w) for f in np.linspace(at.min(), at.max(), 3) for w in (half, fit.line.damping * f)]
    made = [fit_line(cells, Line(float(f), 0.0, float(min(w / f, 0.3))), moves=False) for f, w in starts]
    return min(made, key=lambda one: one.deviance.sum())


def _whirl(told: _Told, floor: Floor, settings: IdentifySettings) -> Whirl | None:
    """``told`` in the words of identification; None where its numbers have no errors, or it is something else."""
    fit, line = told.fit, told.fit.line
    try:
        covariance = told.per * np.linalg.inv(curvature_of(told.cells, fit))
    except np.linalg.LinAlgError:
        return None
    if not (np.diag(covariance) > 0.0).all():
        return None
    lifted = float(10.0 * np.log10(1.0 + (fit.part / np.maximum(fit.fixed[:, None], 1e-300))[told.seen].max()))
    names = tuple(name for name, one in zip(floor.channels, told.seen.tolist(), strict=True) if one)
    error = np.sqrt(np.diag(covariance))
    whirl = Whirl(
        reference_rpm=0.5 * float(floor.speed_rpm.min() + floor.speed_rpm.max()),
        frequency_hz=line.frequency_hz,
        frequency_error_hz=float(error[0]),
        slope=line.slope,
        slope_error=float(error[1]),
        together=float(covariance[0, 1]),
        damping_ratio=line.damping,
        damping_error=float(error[2]) * line.damping,
        channels=names,
        prominence_db=lifted,
        evidence=(
            f"moves by {line.slope:.3g} orders: twice the log likelihood is {told.gain:.3g} more than that of a line "
            f"that stays; up to {lifted:.1f} dB over what stays, in {len(names)} of {len(floor.channels)} channels"
        ),
    )
    return whirl if _moves(whirl, told.cells, settings) else None


def _moves(whirl: Whirl, cells: Cells, settings: IdentifySettings) -> bool:
    """Whether ``whirl`` is neither a mode that stays, nor an order, nor a sideband of one."""
    span = float(np.ptp(cells.revs_per_s))
    width = whirl.damping_ratio * whirl.frequency_hz
    broad = whirl.damping_ratio - NUMBERS.sure_sigmas * whirl.damping_error > settings.max_damping_ratio
    vague = not whirl.damping_told and width > cells.seen.bin_hz
    steep = abs(whirl.slope) > NUMBERS.most_slope_orders + NUMBERS.sure_sigmas * whirl.slope_error
    still = abs(whirl.slope) < NUMBERS.sure_sigmas * whirl.slope_error
    still |= abs(whirl.slope) * span < max(width, 1.5 * cells.seen.bin_hz)
    order = whirl.line_at(0.0) < NUMBERS.sure_sigmas * whirl.error_at(0.0) + cells.seen.bin_hz
    nearest = round(whirl.slope / NUMBERS.sideband_orders) * NUMBERS.sideband_orders
    near = abs(whirl.slope - nearest) <= NUMBERS.sure_sigmas * whirl.slope_error + 0.5 * cells.seen.bin_hz / span
    sideband = near and nearest != 0.0 and width < 0.5 * cells.seen.bin_hz
    return not (broad or vague or steep or still or order or sideband)


def _known(whole: Cells, found: list[_Told]) -> Cells:
    """``whole`` with the lines ``found`` beside what is looked for, masked where they are stronger than what stays."""
    beside, averages = np.zeros_like(whole.psd), whole.averages.copy()
    for told in found:
        part = told.fit.power[:, :, None] * shape_of(told.fit.line, whole)[0]
        beside += part
        averages[:, :, told.bins][told.fit.part > told.fit.fixed[:, None]] = 0.0
    return replace(whole, averages=averages, psd=np.where(averages > 0.0, whole.psd, 0.0), beside=beside)


def _without(told: _Told, floor: Floor) -> Floor:
    """``floor`` without the line: in its place, what stays by the fit, with the weight that it has beside the line."""
    fit, weight = told.fit, told.cells.averages
    share = np.where(weight > 0.0, np.minimum(fit.fixed[:, None] / np.maximum(fit.model, 1e-300), 1.0), 0.0)
    psd, averages, cells = floor.psd.copy(), floor.averages.copy(), floor.cells.copy()
    independent = (weight * share**2).sum(axis=1)
    psd[:, told.bins] = np.where(independent >= NUMBERS.least_averages, fit.fixed, np.nan)
    averages[:, told.bins] = np.where(independent >= NUMBERS.least_averages, independent, 0.0)
    strong = fit.part > NUMBERS.masked_share * fit.fixed[:, None]
    cells[:, :, told.bins] *= np.where(strong, np.nan, 1.0 - fit.part / np.maximum(fit.model, 1e-300))
    return replace(floor, cells=cells, psd=psd, averages=averages)


def with_whirls(fit: ModalFit, whirls: tuple[Whirl, ...], speed_rpm: Array) -> ModalFit:
    """``fit`` with its ``whirls``, without the modes that are only what they make of an order, or leave in the floor.

    The former stand where an order that shows them meets a whirl; what these orders pass through is then not known:
    their responses are said not to fit. The latter are undecided humps, broader than a whirl, on its flanks.
    ``speed_rpm`` (n,): the speeds of the test.
    """
    if not whirls:
        return fit
    kept = [
        not any(_is_crossing(one, whirl) or _is_flank(one, whirl, speed_rpm) for whirl in whirls) for one in fit.modes
    ]
    lost = {order for mode, own in zip(fit.modes, kept, strict=True) if not own for order in mode.reached_by}
    at = np.flatnonzero(kept)
    place = {int(old): new for new, old in enumerate(at)}
    responses = tuple(_without_modes(one, place, fits=one.fits and one.order not in lost) for one in fit.responses)
    pairs = np.stack([2 * at, 2 * at + 1], axis=1).ravel()
    return replace(
        fit,
        modes=tuple(_doubted(fit.modes[k], whirls, speed_rpm) for k in at.tolist()),
        covariance=fit.covariance[np.ix_(pairs, pairs)],
        responses=responses,
        whirls=whirls,
    )


def _is_crossing(mode: Mode, whirl: Whirl) -> bool:
    """Whether ``mode`` is where an order that shows it meets ``whirl``."""
    near = max(mode.damping_ratio, whirl.damping_ratio)
    for order in mode.reached_by:
        rpm = whirl.meets(order)
        if rpm is not None and abs(order * rpm / 60.0 - mode.frequency_hz) <= near * mode.frequency_hz:
            return True
    return False


def _is_flank(mode: Mode, whirl: Whirl, speed_rpm: Array) -> bool:
    """Whether an undecided ``mode`` is what the fit leaves of the flanks of ``whirl``."""
    half = mode.damping_ratio * mode.frequency_hz
    if not mode.undecided or half < NUMBERS.broader_widths * whirl.damping_ratio * whirl.frequency_hz:
        return False
    return _within(mode, whirl, speed_rpm, NUMBERS.broader_widths * half)


def _within(mode: Mode, whirl: Whirl, speed_rpm: Array, beside_hz: float) -> bool:
    """Whether ``mode`` is where ``whirl`` sweeps, or so far beside."""
    ends = sorted(whirl.line_at(float(rpm)) for rpm in (np.nanmin(speed_rpm), np.nanmax(speed_rpm)))
    return ends[0] - beside_hz <= mode.frequency_hz <= ends[1] + beside_hz


def _doubted(mode: Mode, whirls: tuple[Whirl, ...], speed_rpm: Array) -> Mode:
    """``mode``, undecided where it is low, no order shows it, and it is on the flank of one of ``whirls``."""
    if mode.undecided or mode.reached_by or mode.prominence_db >= NUMBERS.flank_db:
        return mode
    for whirl in whirls:
        if _within(mode, whirl, speed_rpm, NUMBERS.flank_widths * whirl.damping_ratio * whirl.frequency_hz):
            return replace(mode, undecided="it is low, on the flank of a whirl, of which it may be what is left")
    return mode


def _without_modes(response: OrderResponse, place: dict[int, int], *, fits: bool) -> OrderResponse:
    """``response`` with the residues of the modes of ``place`` (old number: new) alone."""
    held = np.array([int(number) in place for number in response.reached], dtype=bool)
    rows = np.concatenate([np.arange(len(response.smooth)), len(response.smooth) + np.flatnonzero(held)])
    return replace(
        response,
        residue=response.residue[list(place)],
        reached=np.array([place[int(number)] for number in response.reached[held]], dtype=np.int64),
        covariance=response.covariance[np.ix_(rows, rows)],
        fits=fits,
    )
