"""Whirl modes, whose natural frequency moves with the speed, and what else makes a mode of the floor doubtful."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import chdtri

from crankorder.campbell.map import HANN_CORRELATION
from crankorder.identify.found import ModalFit, Mode, OrderResponse, Whirl
from crankorder.identify.modes.floor import Floor, SpectralWindow, seen_pole
from crankorder.identify.modes.surface_fit import (
    Problem,
    SurfaceFit,
    covariance_among,
    gamma_deviance,
)
from crankorder.identify.modes.tones import NUMBERS as TONES
from crankorder.identify.modes.tones import at_one_speed, on_order
from crankorder.orders.averages import median_of_known
from crankorder.quantities import Bools, Floats
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "whirl")

STEPS = 40
"""Steps of a fit at most."""

ROUNDS = 2
"""Times that several whirls are fitted, each with what the others came to."""

BOXES = (3, 7, 15, 31)
"""Widths in bins over which the sums along a line are smoothed."""


@dataclass(frozen=True, eq=False)
class _Cells:
    """Power densities ``psd`` (C, K, F) at ``revs_per_s`` (K,) from the middle of the speeds and ``frequency_hz`` (F,).

    ``averages`` (C, K, F): independent spectra behind each, none where masked; ``beside`` (C, K, F): power of whirls
    that are known; ``seen``: how the window sees power.
    """

    frequency_hz: Floats
    revs_per_s: Floats
    psd: Floats
    averages: Floats
    beside: Floats
    seen: SpectralWindow

    def around(self, line: Floats) -> _Cells:
        """Those that ``line`` sweeps over, and what is beside."""
        at = line[0] + line[1] * self.revs_per_s
        reach = max(10.0 * self.seen.bin_hz, 5.0 * line[2] * line[0])
        bins = slice(*np.searchsorted(self.frequency_hz, [at.min() - reach, at.max() + reach]).tolist())
        parts = {name: getattr(self, name)[:, :, bins] for name in ("psd", "averages", "beside")}
        return replace(self, frequency_hz=self.frequency_hz[bins], **parts)


class _Fit(NamedTuple):
    """A ``line`` (Hz in the middle of the speeds, slope in orders, damping ratio) fitted to ``cells``.

    ``power`` (C, K) of the line, ``fixed`` (C, F) the spectrum that stays; ``covariance`` (3, 3) of (Hz, slope, ln
    damping). ``shown`` (C,): whether a channel shows the line;
    ``deviance`` (K,) of independent bins.
    """

    line: Floats
    cells: _Cells
    power: Floats
    fixed: Floats
    covariance: Floats
    shown: Bools
    deviance: Floats


def whirls_of(floor: Floor, *, settings: IdentifySettings) -> tuple[Floor, tuple[Whirl, ...]]:
    """``floor`` without what moves with the speed, and the whirls, lowest first.

    Cells that stand over the same bins at the other speeds are summed along lines of all slopes. The best line starts
    a fit by the gamma likelihood, with a level of its own at every speed and a spectrum that stays. It is a whirl
    where a channel shows it and it explains more than a line that stays, the strongest speed left out, both at
    ``settings.false_alarm_probability`` over all lines tried; and where it is no order and no sideband of one.
    """
    low, high = floor.speed_rpm.min(), floor.speed_rpm.max()
    if len(floor.speed_rpm) < NUMBERS.fewest_speeds or not low > 0.0 or high < settings.mode_speed_ratio * low:
        return floor, ()
    averages = np.where(floor.moving > 0.0, floor.cell_averages[:, :, None], 0.0)
    psd = np.where(averages > 0.0, floor.moving, 0.0)
    middle = 0.5 * float(low + high)
    cells = _Cells(floor.frequency_hz, (floor.speed_rpm - middle) / 60.0, psd, averages, np.zeros_like(psd), floor.seen)
    excess = _excess(cells)
    fits: list[_Fit] = []
    for _ in range(NUMBERS.most_tries):
        line, n_tried = _best_line(excess, cells)
        if line is None:
            break
        chance = settings.false_alarm_probability / n_tried
        fit = _fitted(line, cells.around(line), chance)
        again = any(abs(fit.line[0] - other.line[0]) < fit.line[0] * (fit.line[2] + other.line[2]) for other in fits)
        if fit.shown.any() and not again and _outdoes_staying(fit, chance):
            line = fit.line
            fits.append(fit)
            cells = replace(cells, beside=_parts(fits, cells))
        near = np.abs(cells.frequency_hz - (line[0] + line[1] * cells.revs_per_s)[:, None])
        excess = np.where(near <= 3.0 * max(line[2] * line[0], floor.step_hz), np.nan, excess)
    for number in [*range(len(fits))] * (ROUNDS if len(fits) > 1 else 0):
        line, beside = fits[number].line, _parts(fits[:number] + fits[number + 1 :], cells)
        fits[number] = _fitted(line, replace(cells, beside=beside).around(line), chance)
    kept = [fit for fit in fits if fit.shown.any() and _moves(_whirl(fit, floor.channels, middle), cells, settings)]
    if kept:
        floor = _without(floor, replace(cells, beside=_parts(kept, cells)))
    return floor, tuple(_whirl(fit, floor.channels, middle) for fit in sorted(kept, key=lambda fit: float(fit.line[0])))


def _shape(line: Floats, cells: _Cells) -> tuple[Floats, Floats]:
    """Spectrum (K, F) of a ``line`` of unit power, and its derivatives (3, K, F) by Hz, slope and ln damping."""
    at = np.maximum(line[0] + line[1] * cells.revs_per_s, cells.frequency_hz[0])[:, None]
    sigma = line[2] * at
    value, slope = seen_pole(sigma + 1j * (cells.frequency_hz - at), cells.seen)
    scale = 2.0 * np.pi * sigma
    by_hz = scale * (slope * (line[2] - 1j)).real + scale / at * value.real
    by_damping = scale * ((slope * sigma).real + value.real)
    return scale * value.real, np.stack([by_hz, by_hz * cells.revs_per_s[:, None], by_damping])


def _parts(fits: list[_Fit], cells: _Cells) -> Floats:
    """Power densities (C, K, F) of the lines of ``fits``."""
    return np.asarray(sum(fit.power[:, :, None] * _shape(fit.line, cells)[0] for fit in fits))


def _excess(cells: _Cells) -> Floats:
    """What each cell (K, F) stands over its bin's median over the speeds, all channels, in standard deviations."""
    known = np.where(cells.averages > 0.0, cells.psd, np.nan)
    over = np.sqrt(cells.averages) * (known / median_of_known(known, axis=1)[:, None] - 1.0)
    over = np.minimum(over, NUMBERS.cap_sigmas)
    count = np.isfinite(over).sum(axis=0)
    return np.asarray(np.where(count > 0, np.nansum(over, axis=0) / np.sqrt(np.maximum(count, 1)), np.nan))


def _best_line(excess: Floats, cells: _Cells) -> tuple[Floats | None, int]:
    """The line along which ``excess`` sums up to most, None where noise alone does so; how many were tried."""
    step = float(cells.frequency_hz[1] - cells.frequency_hz[0])
    span = float(np.ptp(cells.revs_per_s))
    n_slopes = max(2, int(np.ceil(NUMBERS.most_slope_orders * span / cells.seen.bin_hz)))
    slopes = np.linspace(-NUMBERS.most_slope_orders, NUMBERS.most_slope_orders, 2 * n_slopes + 1)
    slopes = slopes[np.abs(slopes) * span >= 2.0 * cells.seen.bin_hz]
    shifts = np.rint(slopes[:, None] * cells.revs_per_s / step).astype(np.int64)
    reach, n_bins = int(np.abs(shifts).max(initial=0)), excess.shape[1]
    padded = np.pad(excess, ((0, 0), (reach, reach)), constant_values=np.nan)
    sums, counts = np.zeros((2, len(slopes), n_bins))
    for row, shift in zip(padded, shifts.T, strict=True):
        windows = np.lib.stride_tricks.sliding_window_view(row, n_bins)[reach + shift]
        sums += np.nan_to_num(windows)
        counts += np.isfinite(windows)
    n_tried = sums.size * len(BOXES)
    best, line = float(np.sqrt(2.0 * np.log(max(n_tried, 2)))), None
    for box in BOXES if len(slopes) else ():
        # sums over so many places about each; nothing is beyond the ends
        beside = np.pad([sums, counts], ((0, 0), (0, 0), (box // 2 + 1, box - box // 2 - 1))).cumsum(axis=-1)
        along, independent = beside[..., box:] - beside[..., :-box]
        score = along / np.sqrt(HANN_CORRELATION * np.maximum(independent, 0.5 * box * len(excess)))
        score /= max(1.0, 1.4826 * float(np.median(np.abs(score))))
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        if score[row, column] > best:
            best, hz = float(score[row, column]), float(cells.frequency_hz[column])
            line = np.array([hz, slopes[row], 0.25 * box * step / hz])
    return line, n_tried


def _fitted(start: Floats, cells: _Cells, chance: float, *, moves: bool = True) -> _Fit:
    """Best line from ``start`` on, of that slope unless it ``moves``; ``chance`` that noise shows it in a channel.

    Fisher scoring of the gamma likelihood in turn by the spectrum that stays, by the power at every speed, and by
    frequency, slope and damping, the power eliminated. Their covariance is scaled by the scatter of the rows' pulls.
    """
    line, (shape, slopes), fixed = start, _shape(start, cells), cells.psd.mean(axis=1)
    power = (shape * cells.psd).sum(axis=-1) / (shape**2).sum(axis=-1)
    reach = max(start[2] * start[0], cells.seen.bin_hz)
    most = np.array([0.5 * reach, reach / np.ptp(cells.revs_per_s), 0.5])
    for _ in range(STEPS):
        fixed = _stays(cells, fixed, power[:, :, None] * shape)
        weight, left = _weighed(cells, fixed, power[:, :, None] * shape)
        inner = np.maximum((weight * shape**2).sum(axis=2), 1e-300)
        power = np.maximum(power + (weight * shape * left).sum(axis=2) / inner, 0.3 * power)
        weight, left = _weighed(cells, fixed, power[:, :, None] * shape)
        by = power[:, :, None] * slopes[:, None] * np.array([1.0, moves, 1.0])[:, None, None, None]
        by -= ((weight * shape * by).sum(axis=3) / inner)[..., None] * shape
        covariance = np.linalg.pinv(np.einsum("ickf,jckf->ij", weight * by, by), hermitian=True)
        pulls = np.einsum("ickf,ckf->ik", weight * by, left)
        move = np.clip(covariance @ pulls.sum(axis=1), -most, most)
        if np.all(np.abs(move) < 1e-3 * most):
            break
        damping = np.clip(line[2] * np.exp(move[2]), 0.02 * cells.seen.bin_hz / line[0], 1.0)
        line = np.array([max(line[0] + move[0], cells.frequency_hz[0]), line[1] + move[1], damping])
        shape, slopes = _shape(line, cells)
    n_speeds, n_free = len(cells.revs_per_s), len(line)
    by_rows = float(np.einsum("ik,ij,jk->", pulls, covariance, pulls)) / n_free * n_speeds / (n_speeds - n_free)
    scatter = max(HANN_CORRELATION, by_rows)
    shown = (power**2 * inner).sum(axis=1) / scatter > chdtri(n_speeds + n_free, chance)
    deviance = gamma_deviance(cells.psd, cells.averages, np.maximum(cells.psd - left, 1e-150)) / HANN_CORRELATION
    return _Fit(line, cells, power, fixed, scatter * covariance, shown, deviance.sum(axis=(0, 2)))


def _outdoes_staying(fit: _Fit, chance: float) -> bool:
    """Whether the line of ``fit`` explains more than one that stays, at ``chance``, the strongest speed left out."""
    at = fit.line[0] + fit.line[1] * fit.cells.revs_per_s
    width = 0.5 * np.ptp(at) + fit.line[2] * fit.line[0]
    stay_hz = np.maximum([at.min(), at.mean(), at.max()], fit.cells.frequency_hz[0])  # a whirl may fall to 0 Hz
    starts = [np.array([hz, 0.0, width / hz]) for hz in stay_hz]
    stays = [_fitted(start, fit.cells, chance, moves=False).deviance for start in starts]
    gain = min(stays, key=np.sum) - fit.deviance
    return bool(gain.sum() - max(gain.max(), 0.0) > chdtri(2, chance))


def _weighed(cells: _Cells, fixed: Floats, part: Floats | float) -> tuple[Floats, Floats]:
    """Weights (C, K, F) by the variance of ``fixed`` + ``part`` + what is beside, and what is left over that."""
    model = np.maximum(fixed[:, None] + cells.beside + part, 1e-150)
    return cells.averages / model**2, np.where(cells.averages > 0.0, cells.psd - model, 0.0)


def _stays(cells: _Cells, fixed: Floats, part: Floats | float) -> Floats:
    """``fixed`` (C, F) after a step of Fisher scoring with ``part`` (C, K, F) held."""
    weight, left = _weighed(cells, fixed, part)
    step = (weight * left).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300)
    return np.asarray(np.maximum(fixed + step, 0.3 * fixed))


def _whirl(fit: _Fit, channels: tuple[str, ...], middle_rpm: float) -> Whirl:
    """``fit`` in the words of identification."""
    hz, slope, damping = fit.line.tolist()
    hz_error, slope_error, log_error = np.sqrt(np.diag(fit.covariance)).tolist()
    share = (_parts([fit], fit.cells) / np.maximum(fit.fixed[:, None], 1e-300))[fit.shown].max()
    lifted, names = 10.0 * float(np.log10(1.0 + share)), tuple(np.array(channels)[fit.shown].tolist())
    return Whirl(
        reference_rpm=middle_rpm,
        frequency_hz=hz,
        frequency_error_hz=hz_error,
        slope=slope,
        slope_error=slope_error,
        together=float(fit.covariance[0, 1]),
        damping_ratio=damping,
        damping_error=log_error * damping,
        channels=names,
        prominence_db=lifted,
        evidence=f"moves by {slope:.3g} orders, up to {lifted:.1f} dB over what stays",
    )


def _moves(whirl: Whirl, cells: _Cells, settings: IdentifySettings) -> bool:
    """Whether ``whirl`` is neither a mode that stays, nor an order or a sideband of one; what is broad is not told."""
    span, bin_hz = float(np.ptp(cells.revs_per_s)), cells.seen.bin_hz
    slope, width, sure = abs(whirl.slope), whirl.damping_ratio * whirl.frequency_hz, NUMBERS.sure_sigmas
    still = slope < sure * whirl.slope_error or slope * span < max(width, 1.5 * bin_hz)
    order = whirl.line_at(0.0) < sure * whirl.error_at(0.0) + bin_hz
    broad = whirl.damping_ratio - sure * whirl.damping_error > settings.max_damping_ratio
    vague = not whirl.damping_told and width > bin_hz
    away = abs(slope - max(round(2.0 * slope), 1) / 2.0)  # of the nearest multiple of a half order
    sideband = width < 0.5 * bin_hz and away <= sure * whirl.slope_error + 0.5 * bin_hz / span
    return not (still or order or broad or vague or sideband)


def _without(floor: Floor, cells: _Cells) -> Floor:
    """``floor`` without what whirls bring beside in ``cells``: what stays, with the weight that it has beside them."""
    fixed = cells.psd.mean(axis=1)
    for _ in range(STEPS):
        fixed = _stays(cells, fixed, 0.0)
    rest = fixed[:, None] / np.maximum(fixed[:, None] + cells.beside, 1e-300)
    independent = (cells.averages * rest**2).sum(axis=1)
    masked, enough = rest < 1.0 - NUMBERS.masked_share, independent >= NUMBERS.least_averages
    psd = np.where(masked.any(axis=1), np.where(enough, fixed, np.nan), floor.psd)
    averages = np.where(masked.any(axis=1), np.where(enough, independent, 0.0), floor.averages)
    return replace(floor, cells=floor.cells * np.where(masked, np.nan, rest), psd=psd, averages=averages)


DOUBT_NUMBERS = MethodNumbers("5-identify-modal.toml", "doubts")

NORMAL_95 = 1.96
"""Standard errors in half a 95 % interval."""

PRESSURES = ("sound pressure", "pressure")
"""Quantities in which a resonance may be the air's."""


def doubt_about(
    frequency: tuple[float, float],
    damping: tuple[float, float],
    floor: Floor,
    still: tuple[float, ...],
    *,
    prominence_db: float,
    n_shown: int,
    settings: IdentifySettings,
) -> str:
    """Why a line may be something else than a mode; empty where nothing speaks for that.

    ``frequency`` (Hz) and ``damping`` (ratio) come with their standard errors; ``prominence_db`` is how far it stands
    out of ``floor``, in ``n_shown`` channels; ``still`` are the frequencies of the tones; ``settings`` say how wide a
    mode must be.
    """
    (f, error), (zeta, zeta_error) = frequency, damping
    narrow = 2.0 * zeta * f < settings.mode_min_width_bins * floor.seen.bin_hz
    if narrow and (order := on_order(f, error + zeta * f, floor, settings=settings)):
        return order
    reach, one_speed = DOUBT_NUMBERS.harmonic_sigmas * error, at_one_speed(floor, settings=settings)
    hardly_wide = zeta < DOUBT_NUMBERS.wide_sigmas * zeta_error
    for tone in still if hardly_wide else ():
        multiple = round(f / tone)
        if multiple >= 2 and abs(f - multiple * tone) <= reach + 0.1 * floor.seen.bin_hz:
            return f"{multiple} times the tone at {tone:.4g} Hz and hardly wider than one"
    if hardly_wide and (grid := on_grid(f, reach + zeta * f, still, floor)):
        return grid
    if one_speed and 2.0 * (zeta - 2.0 * zeta_error) < TONES.speed_spread_share:
        return "no wider for sure than an order whose speed wanders by 0.2 %: at one speed a modulated order looks so"
    known = DOUBT_NUMBERS.known_shares[n_shown > 1]
    if zeta_error > known * zeta and (n_shown < 2 or prominence_db < DOUBT_NUMBERS.clear_db):
        return "its damping is not determined: a hump of the floor, a tone or a mode"
    if error > zeta * f:
        return "its frequency is less certain than it is wide"
    if NORMAL_95 * error > DOUBT_NUMBERS.uncertain_share * f:
        return f"its frequency is known to {100.0 * NORMAL_95 * error / f:.1f} % only"
    if one_speed and prominence_db < DOUBT_NUMBERS.weak_at_one_db:
        return f"stands only {prominence_db:.1f} dB out of the floor, at one speed: modulated orders look so"
    if one_speed and n_shown < 2 and zeta_error > DOUBT_NUMBERS.well_known_share * zeta:
        return "seen in one channel at one speed, its damping not well known: modulated orders look so"
    if prominence_db < DOUBT_NUMBERS.weak_db and zeta_error > DOUBT_NUMBERS.well_known_share * zeta:
        return f"stands only {prominence_db:.1f} dB out of the floor"
    return ""


def said_wide(frequency_hz: float, error_hz: float) -> str:
    """Words of the evidence on a mode whose frequency is not well known; "" where it is.

    ``frequency_hz``: in Hz, with the standard error ``error_hz``.
    """
    half = NORMAL_95 * error_hz / frequency_hz
    is_wide = half > DOUBT_NUMBERS.told_wide_share
    return f"; the 95 % interval of its frequency is ± {100.0 * half:.2g} % wide" if is_wide else ""


def on_grid(frequency_hz: float, reach_hz: float, still: tuple[float, ...], floor: Floor) -> str:
    """Why a line at ``frequency_hz`` may be a product of several tones, on their common divisor; else "".

    ``reach_hz``: how far from a multiple it may lie; ``still``: frequencies of the tones; ``floor``: in all channels.
    """
    step = common_step(still, 0.2 * floor.seen.bin_hz)
    multiple = round(frequency_hz / step) if step else 0
    if not multiple or reach_hz > DOUBT_NUMBERS.grid_reach * step or abs(frequency_hz - multiple * step) > reach_hz:
        return ""
    times = f"{multiple} times {step:.4g} Hz"
    return f"on the grid of the tones: {times}, the step of most of them, and hardly wider than one"


def common_step(tones_hz: tuple[float, ...], near_hz: float) -> float:
    """Largest step in Hz on whose multiples most of ``tones_hz`` lie within ``near_hz``; 0 where there is none."""
    tones = np.array(sorted(tones_hz))
    if len(tones) < DOUBT_NUMBERS.fewest_on_grid:
        return 0.0
    steps = (tones[:, None] / np.arange(1, DOUBT_NUMBERS.grid_parts + 1)).ravel()
    steps = steps[steps > 2.0 * near_hz / DOUBT_NUMBERS.grid_chance]
    on = np.abs(tones - np.rint(tones / steps[:, None]) * steps[:, None]) <= near_hz
    enough = np.count_nonzero(on, axis=1) >= max(DOUBT_NUMBERS.fewest_on_grid, DOUBT_NUMBERS.grid_share * len(tones))
    if not enough.any():
        return 0.0
    best = int(np.argmax(np.where(enough, steps, 0.0)))
    multiple = np.rint(tones[on[best]] / steps[best])
    return float(multiple @ tones[on[best]] / (multiple @ multiple))


def of_lines_within(problem: Problem, fit: SurfaceFit, number: int, floor: Floor, *, settings: IdentifySettings) -> str:
    """Why pole ``number`` of ``fit`` may be the modulation of the lines within its half-power width; else "".

    Only at one speed, or without any, where lines that move with it stay beneath the same hump.
    ``problem``: the floors that were fitted; ``floor``: in all channels; ``settings``: those in use.
    """
    if np.isfinite(floor.speed_rpm).any() and not at_one_speed(floor, settings=settings):
        return ""
    f = float(fit.poles.frequency_hz[number])
    within = np.abs(problem.frequency_hz - f) <= max(float(fit.poles.damping[number]) * f, 2.0 * problem.seen.bin_hz)
    own_part = fit.part(number)
    channel = int(np.argmax(own_part[:, within].sum(axis=1)))
    tones = (fit.linear @ fit.columns - fit.without_lines(problem))[channel]
    for other in np.flatnonzero(fit.poles.tone).tolist():
        tones = tones + fit.part(other)[channel]
    model = fit.linear[channel] @ fit.columns
    on_line = within & ((problem.averages[channel] <= 0.0) | (tones > 0.5 * model))
    at = int(np.searchsorted(floor.frequency_hz, problem.frequency_hz[0]))
    over = floor.whole[channel, at : at + len(model)] - (model - tones)
    own, lines = float(own_part[channel, within].sum()), float(np.nansum(np.maximum(over[on_line], 0.0)))
    if lines <= DOUBT_NUMBERS.lines_power_ratio * own:
        return ""
    times = f"{lines / own:.2g} times its power"
    return f"lines within its width hold {times}: at one speed their modulation looks the same"


def of_the_air(modes: tuple[Mode, ...], campbell: xr.Dataset) -> tuple[Mode, ...]:
    """``modes``, in doubt where they are seen in pressure alone: they may be of the air or of the source.

    ``campbell`` (CampbellMap) tells what each channel measures.
    """
    if "quantity" not in campbell.coords:
        return modes
    quantity = zip(campbell["channel"].values.tolist(), campbell["quantity"].values.tolist(), strict=True)
    heard = {name for name, what in quantity if any(word in what.lower() for word in PRESSURES)}
    doubt = "seen in pressure alone: a room, a duct or the spectrum of the source would look the same"
    return tuple(
        replace(mode, undecided=doubt) if not mode.undecided and heard.issuperset(mode.channels) else mode
        for mode in modes
    )


def without_remains(fit: ModalFit, whirls: tuple[Whirl, ...], speed_rpm: Floats) -> ModalFit:
    """``fit`` with its ``whirls``, without the modes that are only what these make of an order or leave in the floor.

    The former stand where an order that shows them meets a whirl; what that order passes through is then not known: its
    response is said not to fit. The latter are humps on the path of a whirl, broader than it; those that are not
    undecided become so. ``speed_rpm`` (speeds,): of the test.
    """
    remains = [any(_is_meeting(mode, w) or _is_hump(mode, w, speed_rpm) for w in whirls) for mode in fit.modes]
    lost = {order for mode in fit.modes if any(_is_meeting(mode, w) for w in whirls) for order in mode.reached_by}
    at = [k for k, mode in enumerate(fit.modes) if not (remains[k] and (mode.undecided or mode.reached_by))]
    why = "it is on the path of a whirl and broader, and may be what the whirl leaves"
    modes = tuple(replace(fit.modes[k], undecided=why) if remains[k] else fit.modes[k] for k in at)
    covariance = covariance_among(fit.covariance, at)
    responses = tuple(_of_modes(each, at, fits=each.fits and each.order not in lost) for each in fit.responses)
    return replace(fit, modes=modes, covariance=covariance, responses=responses, whirls=whirls)


def _is_meeting(mode: Mode, whirl: Whirl) -> bool:
    """Whether ``mode`` is where an order that shows it meets ``whirl``."""
    near = max(mode.damping_ratio, whirl.damping_ratio) * mode.frequency_hz
    met = [order * rpm / 60.0 for order in mode.reached_by if (rpm := whirl.meets(order)) is not None]
    return any(abs(hertz - mode.frequency_hz) <= near for hertz in met)


def _is_hump(mode: Mode, whirl: Whirl, speed_rpm: Floats) -> bool:
    """Whether ``mode``, shown by no order, is on the path of ``whirl`` and broader than it."""
    half = mode.damping_ratio * mode.frequency_hz
    ends = sorted(whirl.line_at(float(rpm)) for rpm in (np.nanmin(speed_rpm), np.nanmax(speed_rpm)))
    near = ends[0] - half <= mode.frequency_hz <= ends[1] + half
    return near and not mode.reached_by and half > DOUBT_NUMBERS.hump_widths * whirl.damping_ratio * whirl.frequency_hz


def _of_modes(response: OrderResponse, kept: Sequence[int], *, fits: bool) -> OrderResponse:
    """``response`` with the residues of the modes numbered ``kept``, in their new numbers."""
    place = {old: new for new, old in enumerate(kept)}
    held = np.array([int(number) in place for number in response.reached], dtype=bool)
    rows = np.concatenate([np.arange(len(response.smooth)), len(response.smooth) + np.flatnonzero(held)])
    reached = np.array([place[int(number)] for number in response.reached[held]], dtype=np.int64)
    residue, covariance = response.residue[list(kept)], response.covariance[np.ix_(rows, rows)]
    return replace(response, residue=residue, reached=reached, covariance=covariance, fits=fits)
