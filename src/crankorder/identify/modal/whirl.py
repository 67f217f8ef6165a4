"""Whirl modes: resonances of the floor whose natural frequency moves with the speed, forward or backward."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from crankorder.identify.found import ModalFit, Mode, OrderResponse, Whirl
from crankorder.identify.modal.floor import Floor
from crankorder.identify.modal.search import HANN_CORRELATION
from crankorder.identify.modal.whirl_fit import (
    Cells,
    Line,
    LineFit,
    curvature_of,
    fit_line,
    fixed_alone,
    shape_of,
)
from crankorder.settings import IdentifySettings

FEWEST_SPEEDS = 6
"""Speeds that must be there: a level of its own at each leaves a slope to be told."""

MOST_SLOPE = 1.0
"""Steepest slope looked for, in orders: a whirl moves by no more than the shaft turns."""

BOXES = (3, 7, 15, 31)
"""Widths in bins over which what stands over the mean is summed."""

CAP = 5.0
"""Standard deviations by which one cell counts at most."""

MOST_TRIES = 6
"""Lines that are tried at most."""

ROUNDS = 3
"""Times that several whirls are fitted, each with what the others came to."""

MASKED_SHARE = 0.3
"""Share of the rest from which the power of a whirl covers a cell."""

LEAST_WORTH = 10.0
"""Spectra that what stays in a bin must be worth beside a whirl: of fewer, its scatter is not that of a gamma law."""

BROADER = 2.0
"""Half widths of a whirl from which an undecided hump is broader, and of the hump up to which it is on its flank."""

FLANK = 15.0
"""Half widths of a whirl beside what it sweeps that are its flank."""

FLANK_DB = 6.0
"""Level over the floor below which a mode on a whirl's flank may be what the fit of the whirl leaves."""

SURE = 3.5
"""Standard errors that a slope is off zero, and a line off an order, at least."""

SIDEBAND = 0.5
"""Lines without width that move by multiples of so many orders are sidebands."""

Array = NDArray[np.float64]


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
    if len(speed) < FEWEST_SPEEDS or not speed.min() > 0.0 or speed.max() < settings.mode_speed_ratio * speed.min():
        return floor, ()
    whole = cells = _cells(floor)
    excess = _excess(cells)
    found: list[_Told] = []
    for _ in range(MOST_TRIES):
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
        over = np.minimum(np.sqrt(cells.averages) * (known / middle - 1.0), CAP)
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
    n_slopes = max(2, int(np.ceil(MOST_SLOPE * span / cells.seen.bin_hz)))
    slopes = np.linspace(-MOST_SLOPE, MOST_SLOPE, 2 * n_slopes + 1)
    slopes = slopes[np.abs(slopes) * span >= 2.0 * cells.seen.bin_hz]
    shifts = np.rint(slopes[:, None] * cells.revs_per_s / step).astype(np.int64)
    sums, counts = _sheared(excess, shifts)
    tried = len(slopes) * excess.shape[1] * len(BOXES)
    best, found = float(np.sqrt(2.0 * np.log(tried))), None
    for box in BOXES:
        along, worth = _boxed(sums, box), _boxed(counts, box)
        enough = worth >= 0.5 * box * len(excess)
        score = np.where(enough, along / np.sqrt(np.maximum(HANN_CORRELATION * worth, 1.0)), 0.0)
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
    broad = whirl.damping_ratio - SURE * whirl.damping_error > settings.max_damping_ratio
    vague = not whirl.damping_told and width > cells.seen.bin_hz
    steep = abs(whirl.slope) > MOST_SLOPE + SURE * whirl.slope_error
    still = abs(whirl.slope) < SURE * whirl.slope_error
    still |= abs(whirl.slope) * span < max(width, 1.5 * cells.seen.bin_hz)
    order = whirl.line_at(0.0) < SURE * whirl.error_at(0.0) + cells.seen.bin_hz
    nearest = round(whirl.slope / SIDEBAND) * SIDEBAND
    near = abs(whirl.slope - nearest) <= SURE * whirl.slope_error + 0.5 * cells.seen.bin_hz / span
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
    worth = (weight * share**2).sum(axis=1)
    psd[:, told.bins] = np.where(worth >= LEAST_WORTH, fit.fixed, np.nan)
    averages[:, told.bins] = np.where(worth >= LEAST_WORTH, worth, 0.0)
    strong = fit.part > MASKED_SHARE * fit.fixed[:, None]
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
    if not mode.undecided or half < BROADER * whirl.damping_ratio * whirl.frequency_hz:
        return False
    return _within(mode, whirl, speed_rpm, BROADER * half)


def _within(mode: Mode, whirl: Whirl, speed_rpm: Array, beside_hz: float) -> bool:
    """Whether ``mode`` is where ``whirl`` sweeps, or so far beside."""
    ends = sorted(whirl.line_at(float(rpm)) for rpm in (np.nanmin(speed_rpm), np.nanmax(speed_rpm)))
    return ends[0] - beside_hz <= mode.frequency_hz <= ends[1] + beside_hz


def _doubted(mode: Mode, whirls: tuple[Whirl, ...], speed_rpm: Array) -> Mode:
    """``mode``, undecided where it is low, no order shows it, and it is on the flank of one of ``whirls``."""
    if mode.undecided or mode.reached_by or mode.prominence_db >= FLANK_DB:
        return mode
    for whirl in whirls:
        if _within(mode, whirl, speed_rpm, FLANK * whirl.damping_ratio * whirl.frequency_hz):
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
