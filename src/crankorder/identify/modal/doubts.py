"""What a line of fixed frequency may be beside a mode: reasons for doubt, in words."""

from __future__ import annotations

import numpy as np

from crankorder.identify.modal.floor import Floor
from crankorder.identify.modal.search import HANN_CORRELATION
from crankorder.identify.modal.surface_fit import Problem, SurfaceFit
from crankorder.identify.modal.tones import on_order
from crankorder.settings import IdentifySettings

HARMONIC_SIGMAS = 3.0
"""Standard errors within which a line lies on a multiple of another."""

WIDE_SIGMAS = 4.0
"""Standard errors by which the damping of a line on a multiple of a tone must differ from none."""

WEAK_DB = 3.0
"""Prominence below which a hump of the floor is no proof of a mode, unless its damping is well known."""

KNOWN = (0.5, 0.75)
"""Standard error of the damping, as a share of it, up to which it is determined: seen in one channel, in several."""

UNCERTAIN = 0.01
"""Standard error of the frequency, as a share of it, beyond which a hump is no clear mode."""

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
    known = KNOWN[1] if n_shown > 1 else KNOWN[0]
    if zeta_error > known * zeta and (n_shown < 2 or prominence_db < CLEAR_DB):
        return "its damping is not determined: a hump of the floor, a tone or a mode"
    if error > zeta * f:
        return "its frequency is less certain than it is wide"
    if error > UNCERTAIN * f:
        return f"its frequency is known to {100.0 * error / f:.1f} % only"
    if prominence_db < WEAK_DB and zeta_error > WELL_KNOWN * zeta:
        return f"stands only {prominence_db:.1f} dB out of the floor"
    return ""
