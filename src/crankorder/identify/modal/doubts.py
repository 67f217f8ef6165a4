"""What a line of fixed frequency may be beside a mode: reasons for doubt, in words."""

from __future__ import annotations

import numpy as np

from crankorder.identify.modal.floor import Floor
from crankorder.identify.modal.search import HANN_CORRELATION
from crankorder.identify.modal.surface_fit import Problem, SurfaceFit
from crankorder.identify.modal.tones import SPEED_SPREAD, at_one_speed, on_order
from crankorder.settings import IdentifySettings

HARMONIC_SIGMAS = 3.0
"""Standard errors within which a line lies on a multiple of another."""

WIDE_SIGMAS = 4.0
"""Standard errors by which the damping of a line on a multiple of a tone must differ from none."""

WEAK_AT_ONE_DB = 6.0
"""Prominence below which a hump at one speed is no proof: the skirts of orders that are modulated stay beneath it."""

WEAK_DB = 3.0
"""Prominence below which a hump of the floor is no proof of a mode, unless its damping is well known."""

KNOWN = (0.5, 0.75)
"""Standard error of the damping, as a share of it, up to which it is determined: seen in one channel, in several."""

UNCERTAIN = 0.01
"""Half the 95 % interval of the frequency, as a share of it, beyond which a hump is no clear mode."""

TOLD_WIDE = 0.002
"""Half the 95 % interval of the frequency, as a share of it, beyond which the evidence says how wide it is."""

NORMAL_95 = 1.96
"""Standard errors in half a 95 % interval."""

WELL_KNOWN = 0.2
"""Standard error of the damping, as a share of it, up to which it is well known."""

CLEAR_DB = 10.0
"""Prominence in two channels that makes up for a damping that is not well determined."""


NARROWER = 0.4
"""Share of a mode's power that its flanks must show."""

FLANK_BINS = (1.5, 3.5)
"""Distance of the flanks from the top, in bins."""

FLANK_CHANCE = 1e-3
"""Chance of flanks so low above a mode."""

FEWEST_ON_GRID = 6
"""Tones that make a grid at least."""

GRID_SHARE = 0.75
"""Share of all tones that lie on their grid at least."""

GRID_PARTS = 20
"""A grid's step is that part of a tone's frequency at least."""

GRID_REACH = 0.25
"""Share of a grid's step beyond which being on it tells nothing."""

GRID_CHANCE = 0.1
"""Share of the axis that the multiples of a grid's step cover at most."""

LINES_POWER = 0.25
"""Times its own power that lines within a hump hold from which it may be their modulation."""

PRESSURES = ("sound pressure", "pressure")
"""Quantities in which a resonance may be the air's."""


def narrower_than_fitted(problem: Problem, fit: SurfaceFit, number: int) -> bool:
    """Whether the flanks of pole ``number`` of ``fit`` lie far below it: a tone with something else beside it.

    ``problem``: the floors that were fitted.
    """
    from scipy.special import chdtr

    f, bin_hz = float(fit.poles.frequency_hz[number]), problem.seen.bin_hz
    if float(fit.poles.damping[number]) * f > FLANK_BINS[1] * bin_hz:
        return False
    part = fit.part(number)
    channel = int(np.argmax(part.max(axis=1)))
    away = np.abs(problem.frequency_hz - f) / bin_hz
    flank = (away > FLANK_BINS[0]) & (away < FLANK_BINS[1]) & (problem.averages[channel] > 0.0)
    flank &= part[channel] > 0.5 * fit.model[channel]
    if not flank.any():
        return False
    share = problem.psd[channel, flank] / fit.model[channel, flank]
    freedom = 2.0 * float(problem.averages[channel, flank].sum()) / HANN_CORRELATION
    low = float(chdtr(freedom, freedom * min(float(share.mean()), 1.0)))
    return float(share.mean()) < NARROWER and low < FLANK_CHANCE


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
        near = HARMONIC_SIGMAS * error + 0.1 * floor.seen.bin_hz
        if zeta < WIDE_SIGMAS * zeta_error and multiple >= 2 and abs(f - multiple * tone) <= near:
            return f"{multiple} times the tone at {tone:.4g} Hz and hardly wider than one"
    if zeta < WIDE_SIGMAS * zeta_error and (grid := on_grid(f, HARMONIC_SIGMAS * error + zeta * f, still, floor)):
        return grid
    if at_one_speed(floor, settings=settings) and 2.0 * (zeta - 2.0 * zeta_error) < SPEED_SPREAD:
        return "no wider for sure than an order whose speed wanders by 0.2 %: at one speed a modulated order looks so"
    known = KNOWN[1] if n_shown > 1 else KNOWN[0]
    if zeta_error > known * zeta and (n_shown < 2 or prominence_db < CLEAR_DB):
        return "its damping is not determined: a hump of the floor, a tone or a mode"
    if error > zeta * f:
        return "its frequency is less certain than it is wide"
    if NORMAL_95 * error > UNCERTAIN * f:
        return f"its frequency is known to {100.0 * NORMAL_95 * error / f:.1f} % only"
    if prominence_db < WEAK_AT_ONE_DB and at_one_speed(floor, settings=settings):
        return f"stands only {prominence_db:.1f} dB out of the floor, at one speed: modulated orders look so"
    if n_shown < 2 and zeta_error > WELL_KNOWN * zeta and at_one_speed(floor, settings=settings):
        return "seen in one channel at one speed, its damping not well known: modulated orders look so"
    if prominence_db < WEAK_DB and zeta_error > WELL_KNOWN * zeta:
        return f"stands only {prominence_db:.1f} dB out of the floor"
    return ""


def said_wide(frequency_hz: float, error_hz: float) -> str:
    """Words of the evidence on a mode whose frequency is not well known; "" where it is.

    ``frequency_hz``: in Hz, with the standard error ``error_hz``.
    """
    half = NORMAL_95 * error_hz / frequency_hz
    return f"; the 95 % interval of its frequency is ± {100.0 * half:.2g} % wide" if half > TOLD_WIDE else ""


def on_grid(frequency_hz: float, reach_hz: float, still: tuple[float, ...], floor: Floor) -> str:
    """Why a line at ``frequency_hz`` may be a product of several tones, on their common divisor; else "".

    ``reach_hz``: how far from a multiple it may lie; ``still``: frequencies of the tones; ``floor``: in all channels.
    """
    step = common_step(still, 0.2 * floor.seen.bin_hz)
    multiple = round(frequency_hz / step) if step else 0
    if not multiple or reach_hz > GRID_REACH * step or abs(frequency_hz - multiple * step) > reach_hz:
        return ""
    return (
        f"on the grid of the tones: {multiple} times {step:.4g} Hz, the step of most of them, and hardly wider than one"
    )


def common_step(tones_hz: tuple[float, ...], near_hz: float) -> float:
    """Largest step in Hz on whose multiples most of ``tones_hz`` lie within ``near_hz``; 0 where there is none."""
    tones = np.array(sorted(tones_hz))
    if len(tones) < FEWEST_ON_GRID:
        return 0.0
    steps = (tones[:, None] / np.arange(1, GRID_PARTS + 1)).ravel()
    steps = steps[steps > 2.0 * near_hz / GRID_CHANCE]
    on = np.abs(tones - np.rint(tones / steps[:, None]) * steps[:, None]) <= near_hz
    enough = np.count_nonzero(on, axis=1) >= max(FEWEST_ON_GRID, GRID_SHARE * len(tones))
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
    if lines <= LINES_POWER * own:
        return ""
    return (
        f"lines within its width hold {lines / own:.2g} times its power: at one speed their modulation looks the same"
    )


def of_the_air(shown: tuple[str, ...], floor: Floor) -> str:
    """Why a hump in the channels ``shown`` may be one of the air or of the source; "" where one is no pressure.

    ``floor``: in all channels.
    """
    quantity = dict(zip(floor.channels, floor.quantity, strict=True))
    if not all(any(word in quantity[name].lower() for word in PRESSURES) for name in shown):
        return ""
    return "seen in pressure alone: a room, a duct or the spectrum of the source would look the same"
