"""What a line of fixed frequency may be beside a mode: reasons for doubt, in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.campbell.map import HANN_CORRELATION
from crankorder.identify.found import ModalFit, Mode, OrderResponse, Whirl
from crankorder.identify.modal.floor import Floor
from crankorder.identify.modal.surface_fit import Problem, SurfaceFit
from crankorder.identify.modal.tones import NUMBERS as TONES
from crankorder.identify.modal.tones import at_one_speed, on_order
from crankorder.settings import IdentifySettings, MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-modal.toml", table="doubts"):
    harmonic_sigmas: float
    wide_sigmas: float
    weak_at_one_db: float
    weak_db: float
    known_shares: tuple[float, float]
    uncertain_share: float
    told_wide_share: float
    well_known_share: float
    clear_db: float
    flank_share: float
    flank_bins: tuple[float, float]
    flank_chance: float
    fewest_on_grid: int
    grid_share: float
    grid_parts: int
    grid_reach: float
    grid_chance: float
    lines_power_ratio: float
    hump_widths: float


NUMBERS = _Numbers.load()

NORMAL_95 = 1.96
"""Standard errors in half a 95 % interval."""

PRESSURES = ("sound pressure", "pressure")
"""Quantities in which a resonance may be the air's."""


def narrower_than_fitted(problem: Problem, fit: SurfaceFit, number: int) -> bool:
    """Whether the flanks of pole ``number`` of ``fit`` lie far below it: a tone with something else beside it.

    ``problem``: the floors that were fitted.
    """
    from scipy.special import chdtr

    f, bin_hz = float(fit.poles.frequency_hz[number]), problem.seen.bin_hz
    if float(fit.poles.damping[number]) * f > NUMBERS.flank_bins[1] * bin_hz:
        return False
    part = fit.part(number)
    channel = int(np.argmax(part.max(axis=1)))
    away = np.abs(problem.frequency_hz - f) / bin_hz
    flank = (away > NUMBERS.flank_bins[0]) & (away < NUMBERS.flank_bins[1]) & (problem.averages[channel] > 0.0)
    flank &= part[channel] > 0.5 * fit.model[channel]
    if not flank.any():
        return False
    share = problem.psd[channel, flank] / fit.model[channel, flank]
    degrees_of_freedom = 2.0 * float(problem.averages[channel, flank].sum()) / HANN_CORRELATION
    low = float(chdtr(degrees_of_freedom, degrees_of_freedom * min(float(share.mean()), 1.0)))
    return float(share.mean()) < NUMBERS.flank_share and low < NUMBERS.flank_chance


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
    for tone in still:
        multiple = round(f / tone)
        near = NUMBERS.harmonic_sigmas * error + 0.1 * floor.seen.bin_hz
        if zeta < NUMBERS.wide_sigmas * zeta_error and multiple >= 2 and abs(f - multiple * tone) <= near:
            return f"{multiple} times the tone at {tone:.4g} Hz and hardly wider than one"
    if zeta < NUMBERS.wide_sigmas * zeta_error and (
        grid := on_grid(f, NUMBERS.harmonic_sigmas * error + zeta * f, still, floor)
    ):
        return grid
    if at_one_speed(floor, settings=settings) and 2.0 * (zeta - 2.0 * zeta_error) < TONES.speed_spread_share:
        return "no wider for sure than an order whose speed wanders by 0.2 %: at one speed a modulated order looks so"
    known = NUMBERS.known_shares[1] if n_shown > 1 else NUMBERS.known_shares[0]
    if zeta_error > known * zeta and (n_shown < 2 or prominence_db < NUMBERS.clear_db):
        return "its damping is not determined: a hump of the floor, a tone or a mode"
    if error > zeta * f:
        return "its frequency is less certain than it is wide"
    if NORMAL_95 * error > NUMBERS.uncertain_share * f:
        return f"its frequency is known to {100.0 * NORMAL_95 * error / f:.1f} % only"
    if prominence_db < NUMBERS.weak_at_one_db and at_one_speed(floor, settings=settings):
        return f"stands only {prominence_db:.1f} dB out of the floor, at one speed: modulated orders look so"
    if n_shown < 2 and zeta_error > NUMBERS.well_known_share * zeta and at_one_speed(floor, settings=settings):
        return "seen in one channel at one speed, its damping not well known: modulated orders look so"
    if prominence_db < NUMBERS.weak_db and zeta_error > NUMBERS.well_known_share * zeta:
        return f"stands only {prominence_db:.1f} dB out of the floor"
    return ""


def said_wide(frequency_hz: float, error_hz: float) -> str:
    """Words of the evidence on a mode whose frequency is not well known; "" where it is.

    ``frequency_hz``: in Hz, with the standard error ``error_hz``.
    """
    half = NORMAL_95 * error_hz / frequency_hz
    return (
        f"; the 95 % interval of its frequency is ± {100.0 * half:.2g} % wide" if half > NUMBERS.told_wide_share else ""
    )


def on_grid(frequency_hz: float, reach_hz: float, still: tuple[float, ...], floor: Floor) -> str:
    """Why a line at ``frequency_hz`` may be a product of several tones, on their common divisor; else "".

    ``reach_hz``: how far from a multiple it may lie; ``still``: frequencies of the tones; ``floor``: in all channels.
    """
    step = common_step(still, 0.2 * floor.seen.bin_hz)
    multiple = round(frequency_hz / step) if step else 0
    if not multiple or reach_hz > NUMBERS.grid_reach * step or abs(frequency_hz - multiple * step) > reach_hz:
        return ""
    return (
        f"on the grid of the tones: {multiple} times {step:.4g} Hz, the step of most of them, and hardly wider than one"
    )


def common_step(tones_hz: tuple[float, ...], near_hz: float) -> float:
    """Largest step in Hz on whose multiples most of ``tones_hz`` lie within ``near_hz``; 0 where there is none."""
    tones = np.array(sorted(tones_hz))
    if len(tones) < NUMBERS.fewest_on_grid:
        return 0.0
    steps = (tones[:, None] / np.arange(1, NUMBERS.grid_parts + 1)).ravel()
    steps = steps[steps > 2.0 * near_hz / NUMBERS.grid_chance]
    on = np.abs(tones - np.rint(tones / steps[:, None]) * steps[:, None]) <= near_hz
    enough = np.count_nonzero(on, axis=1) >= max(NUMBERS.fewest_on_grid, NUMBERS.grid_share * len(tones))
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
    if lines <= NUMBERS.lines_power_ratio * own:
        return ""
    return (
        f"lines within its width hold {lines / own:.2g} times its power: at one speed their modulation looks the same"
    )


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


def without_remains(fit: ModalFit, whirls: tuple[Whirl, ...], speed_rpm: NDArray[np.float64]) -> ModalFit:
    """``fit`` with its ``whirls``, without the modes that are only what these make of an order or leave in the floor.

    The former stand where an order that shows them meets a whirl; what that order passes through is then not known: its
    response is said not to fit. The latter are humps on the path of a whirl, broader than it; those that are not
    undecided become so. ``speed_rpm`` (speeds,): of the test.
    """
    remains = [any(_is_meeting(mode, w) or _is_hump(mode, w, speed_rpm) for w in whirls) for mode in fit.modes]
    lost = {order for mode in fit.modes if any(_is_meeting(mode, w) for w in whirls) for order in mode.reached_by}
    at = [k for k, mode in enumerate(fit.modes) if not (remains[k] and (mode.undecided or mode.reached_by))]
    pairs = np.array([[2 * k, 2 * k + 1] for k in at], dtype=np.int64).ravel()
    why = "it is on the path of a whirl and broader, and may be what the whirl leaves"
    return replace(
        fit,
        modes=tuple(replace(fit.modes[k], undecided=why) if remains[k] else fit.modes[k] for k in at),
        covariance=fit.covariance[np.ix_(pairs, pairs)],
        responses=tuple(_of_modes(one, at, fits=one.fits and one.order not in lost) for one in fit.responses),
        whirls=whirls,
    )


def _is_meeting(mode: Mode, whirl: Whirl) -> bool:
    """Whether ``mode`` is where an order that shows it meets ``whirl``."""
    near = max(mode.damping_ratio, whirl.damping_ratio) * mode.frequency_hz
    met = [(order, whirl.meets(order)) for order in mode.reached_by]
    return any(rpm is not None and abs(order * rpm / 60.0 - mode.frequency_hz) <= near for order, rpm in met)


def _is_hump(mode: Mode, whirl: Whirl, speed_rpm: NDArray[np.float64]) -> bool:
    """Whether ``mode``, shown by no order, is on the path of ``whirl`` and broader than it."""
    half = mode.damping_ratio * mode.frequency_hz
    ends = sorted(whirl.line_at(float(rpm)) for rpm in (np.nanmin(speed_rpm), np.nanmax(speed_rpm)))
    near = ends[0] - half <= mode.frequency_hz <= ends[1] + half
    return near and not mode.reached_by and half > NUMBERS.hump_widths * whirl.damping_ratio * whirl.frequency_hz


def _of_modes(response: OrderResponse, kept: Sequence[int], *, fits: bool) -> OrderResponse:
    """``response`` with the residues of the modes numbered ``kept``, in their new numbers."""
    place = {old: new for new, old in enumerate(kept)}
    held = np.array([int(number) in place for number in response.reached], dtype=bool)
    rows = np.concatenate([np.arange(len(response.smooth)), len(response.smooth) + np.flatnonzero(held)])
    return replace(
        response,
        residue=response.residue[list(kept)],
        reached=np.array([place[int(number)] for number in response.reached[held]], dtype=np.int64),
        covariance=response.covariance[np.ix_(rows, rows)],
        fits=fits,
    )
