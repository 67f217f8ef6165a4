"""Modal fit of a test: natural frequencies and damping from floor and orders together, tones told apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.found import AgreedOrder, ModalFit, Mode, Tone
from crankorder.identify.modal.bands import Band, bands_of
from crankorder.identify.modal.covariance import pole_covariance
from crankorder.identify.modal.doubts import doubt_about, narrower_than_fitted, of_lines_within, of_the_air
from crankorder.identify.modal.floor import Floor, quiet_floor, seen_at_single_speeds
from crankorder.identify.modal.order_responses import Block, Blocks, blocks_of, fitting, responses_of
from crankorder.identify.modal.order_search import with_modes_of_first_order
from crankorder.identify.modal.search import dispersion, evidence_of, hidden_poles, least_gain, scatter_at, search
from crankorder.identify.modal.strong_tones import with_strong_tones
from crankorder.identify.modal.surface_fit import NO_POLES, Poles, Problem, SurfaceFit
from crankorder.identify.modal.tones import tone_of, tone_or_mode, with_one_mains, with_tones
from crankorder.settings import IdentifySettings

SHOWN_DB = 1.0
"""Level by which a mode lifts a channel's floor, in dB, from which the channel is said to show it."""

ROUNDS = 2
"""Times that the bands are fitted together with the orders, each with what the others came to."""

Array = NDArray[np.float64]


def modal_fit(
    campbell: xr.Dataset, order_map: xr.Dataset, orders: tuple[AgreedOrder, ...], *, settings: IdentifySettings
) -> ModalFit:
    """Natural frequencies, damping ratios and tones of a test, with their covariance.

    ``campbell`` (CampbellMap) and ``order_map`` (OrderMap) are the maps of the test, ``orders`` what was found in the
    latter; ``settings`` state the false-alarm level and what counts as a mode. The floor that the order lines leave,
    in all channels, and the complex amplitudes of the locked orders over the speeds are fitted by one set of poles,
    band by band where the map is long.
    Nothing is found in a map without speeds or with hardly a bin.
    """
    nothing = ModalFit((), (), np.zeros((0, 0)))
    if not campbell.sizes["speed"] or not campbell.sizes["channel"]:
        return nothing
    single = seen_at_single_speeds(order_map, top_hz=float(campbell["frequency"].values[-1]))
    floor = quiet_floor(campbell, tuple((item.order, item.order_error) for item in orders), single=single)
    if floor is None or not np.isfinite(floor.psd).any():
        return nothing
    floor = with_strong_tones(floor)
    blocks = blocks_of(order_map, orders)
    fitted = []
    for band in bands_of(floor):
        problem, fit = search(band.floor, chance=settings.false_alarm_probability)
        fitted.append(Fitted(band, problem, with_tones(problem, fit, floor, settings=settings)))
    for _ in range(1 if len(fitted) == 1 else ROUNDS):
        fitted = [_with_orders(item, fitted, blocks) for item in fitted]
    found = _found(fitted, floor, blocks, settings)
    return with_modes_of_first_order(found, order_map, orders, settings=settings)


@dataclass(frozen=True, eq=False)
class Fitted:
    """``fit`` of the ``problem`` of a ``band``."""

    band: Band
    problem: Problem
    fit: SurfaceFit

    @property
    def own_modes(self) -> Poles:
        """Poles that belong to the band and are no tones."""
        poles = self.fit.poles
        return poles.chosen(self.band.owns(poles) & ~poles.tone)


def _with_orders(item: Fitted, every: list[Fitted], blocks: tuple[Block, ...]) -> Fitted:
    """The fit of a band together with the orders that sweep through its modes; other bands stay as they are."""
    if not blocks or not len(item.own_modes):
        return item
    fixed = NO_POLES
    for other in every:
        if other is not item:
            fixed = fixed.joined(other.own_modes.chosen(~item.band.holds(other.own_modes)))
    problem, fit = fitting(replace(item.problem, others=None), item.fit, blocks, fixed=fixed)
    return Fitted(item.band, problem, fit)


def _found(
    fitted: list[Fitted],
    floor: Floor,
    blocks: tuple[Block, ...],
    settings: IdentifySettings,
) -> ModalFit:
    """The fits of all bands in the words of identification."""
    shape = np.full(floor.psd.shape, np.nan)
    smooth = np.empty(floor.psd.shape)
    still = tuple(f for f, _ in floor.strong)
    for item in fitted:
        own = slice(item.band.first, item.band.last)
        from_here = item.band.first - int(np.searchsorted(floor.frequency_hz, item.problem.frequency_hz[0]))
        here = slice(from_here, from_here + item.band.last - item.band.first)
        shape[:, own] = np.where(item.problem.averages > 0.0, item.fit.model, np.nan)[:, here]
        smooth[:, own] = _without_hidden(item)[:, here]
        poles = item.fit.poles
        tone = poles.tone & item.band.owns(poles) & ~hidden_poles(item.problem, item.fit)
        still += tuple(poles.frequency_hz[tone].tolist())
    tones = [tone_of(f, error, floor, smooth, settings=settings) for f, error in floor.strong]
    modes: list[Mode] = []
    parts: list[Array] = []
    kept = NO_POLES
    for item in fitted:
        said = _of_band(item, floor, smooth, still, settings)
        modes += said[0]
        tones += said[1]
        parts.append(said[2])
        kept = kept.joined(said[3])
    used = tuple(
        block for item in fitted if isinstance(item.problem.others, Blocks) for block in item.problem.others.items
    )
    return ModalFit(
        tuple(modes),
        with_one_mains(sorted((t for t in tones if t.amplitude), key=lambda t: t.frequency_hz), settings=settings),
        _side_by_side(parts),
        responses_of(used, blocks, kept),
        floor.frequency_hz,
        floor.psd,
        shape,
    )


def _of_band(
    item: Fitted, floor: Floor, smooth: Array, still: tuple[float, ...], settings: IdentifySettings
) -> tuple[list[Mode], list[Tone], Array, Poles]:
    """Modes of a band, its tones, the covariance of the modes and their poles."""
    problem, fit = item.problem, item.fit
    scatter = np.array([dispersion(problem, fit, float(f)) for f in fit.poles.frequency_hz])
    covariance = pole_covariance(problem, fit, scatter=scatter)
    strength = (
        evidence_of(fit) / np.array([scatter_at(problem, fit, float(f)) for f in fit.poles.frequency_hz])[:, None]
    )
    modes: list[Mode] = []
    tones: list[Tone] = []
    kept: list[int] = []
    for number in np.flatnonzero(~hidden_poles(problem, fit) & item.band.owns(fit.poles)).tolist():
        f, error = float(fit.poles.frequency_hz[number]), float(np.sqrt(covariance[2 * number, 2 * number]))
        if fit.poles.tone[number]:
            if floor.frequency_hz[0] <= f <= floor.frequency_hz[-1]:
                part = fit.part(number)
                rest = smooth.copy()
                at = np.searchsorted(floor.frequency_hz, problem.frequency_hz[0]) + np.arange(part.shape[1])
                rest[:, at] = np.maximum(smooth[:, at] - part, 0.02 * smooth[:, at])
                tones.append(tone_of(f, error, floor, rest, settings=settings))
            continue
        mode = _mode(number, problem, fit, floor, covariance, strength[number], still, settings)
        if mode is not None:
            modes.append(mode)
            kept.append(number)
    at = np.array([[2 * number, 2 * number + 1] for number in kept], dtype=np.int64).ravel()
    which = np.isin(np.arange(len(fit.poles)), kept)
    return modes, tones, covariance[np.ix_(at, at)], fit.poles.chosen(which)


def _side_by_side(parts: list[Array]) -> Array:
    """Square matrix with ``parts`` on its diagonal: what different bands tell is independent."""
    whole = np.zeros((sum(len(part) for part in parts),) * 2)
    first = 0
    for part in parts:
        whole[first : first + len(part), first : first + len(part)] = part
        first += len(part)
    return whole


def _without_hidden(item: Fitted) -> Array:
    """Power (C, F) of a band's fit without strong tones and the poles that only stand for the skirts of masked lines."""
    smooth = item.fit.without_lines(item.problem)
    for number in np.flatnonzero(hidden_poles(item.problem, item.fit)).tolist():
        smooth = smooth - item.fit.part(number)
    return np.asarray(np.maximum(smooth, 0.02 * _typical(item.problem)))


def _typical(problem: Problem) -> Array:
    """A middling power (C, 1) of each channel."""
    used = [
        np.median(y[n > 0.0]) if (n > 0.0).any() else 0.0 for y, n in zip(problem.psd, problem.averages, strict=True)
    ]
    return np.array(used)[:, None]


def _mode(
    number: int,
    problem: Problem,
    fit: SurfaceFit,
    floor: Floor,
    covariance: Array,
    strength: Array,
    still: tuple[float, ...],
    settings: IdentifySettings,
) -> Mode | None:
    """Mode of pole ``number``; None where it is but a part of the floor's shape."""
    f, zeta = float(fit.poles.frequency_hz[number]), float(fit.poles.damping[number])
    error, zeta_error = (float(np.sqrt(covariance[2 * number + k, 2 * number + k])) for k in (0, 1))
    outside = not floor.frequency_hz[0] <= f <= floor.frequency_hz[-1]
    if outside or zeta - 3.0 * zeta_error > settings.max_damping_ratio or zeta > 1.5 * settings.max_damping_ratio:
        return None
    at = int(np.argmin(np.abs(problem.frequency_hz - f)))
    whole = np.maximum(fit.without_lines(problem)[:, at], np.finfo(np.float64).tiny)  # orders may mask this bin
    lifted = 10.0 * np.log10(whole / np.maximum(whole - fit.part(number)[:, at], 1e-3 * whole))
    shown = (lifted > SHOWN_DB) & (strength > least_gain(1, settings.false_alarm_probability))
    prominence = float(lifted.max())
    by = _reached_by(problem, fit, f)
    if prominence < settings.mode_prominence_db and not by:
        return None
    names = tuple(name for name, is_shown in zip(floor.channels, shown, strict=True) if is_shown)
    if not names:
        names = (floor.channels[int(np.argmax(lifted))],)
    words = f"{prominence:.1f} dB over what the floor is without it, in {len(names)} of {len(floor.channels)} channels"
    if by:
        words += f"; orders {', '.join(f'{order:g}' for order in by)} sweep through it and agree"
    doubt = tone_or_mode(problem, fit, number, settings=settings) or doubt_about(
        (f, error), (zeta, zeta_error), floor, still, prominence_db=prominence, n_shown=len(names), settings=settings
    )
    if not doubt and narrower_than_fitted(problem, fit, number):
        doubt = "its flanks are lower than a mode's of this damping: a tone with something beside it, or a mode"
    doubt = doubt or of_lines_within(problem, fit, number, floor, settings=settings) or of_the_air(names, floor)
    return Mode(f, error, zeta, zeta_error, names, prominence, words, by, doubt)


def _reached_by(problem: Problem, fit: SurfaceFit, frequency_hz: float) -> tuple[float, ...]:
    """Orders of the joint fit that pass through the mode at ``frequency_hz`` within the tested speeds."""
    if not isinstance(problem.others, Blocks):
        return ()
    spans = {item.order: (item.frequency_hz.min(), item.frequency_hz.max()) for item in problem.others.items}
    return tuple(sorted(order for order, (low, high) in spans.items() if low <= frequency_hz <= high))
