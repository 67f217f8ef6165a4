"""Modal fit of a test: natural frequencies and damping from floor and orders together, tones told apart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise

import numpy as np
import xarray as xr

from crankorder.identify.found import NO_FITS, AgreedOrder, ModalFit, Mode, SweepFits, Tone, Unsearched, Whirl
from crankorder.identify.modes.floor import Floor, quiet_floor, seen_at_single_speeds
from crankorder.identify.modes.order_blocks import blocks_of
from crankorder.identify.modes.order_modes import NUMBERS as ORDER_MODES
from crankorder.identify.modes.order_modes import (
    OrderPole,
    Proof,
    hidden_speeds,
    is_proven,
    is_shown,
    mode_of,
    proven_by,
    tone_as_mode,
)
from crankorder.identify.modes.order_responses import Block, fitting, responses_of
from crankorder.identify.modes.order_search import orders_raised, poles_of_orders, settled
from crankorder.identify.modes.pole_errors import covariance_of_all, pole_covariance, side_by_side
from crankorder.identify.modes.responses import FloorBound, Hiding, floor_bound, least_seen
from crankorder.identify.modes.search import (
    EVERYWHERE,
    dispersion,
    evidence_of,
    hidden_poles,
    least_gain,
    peaks,
    scatter_at,
    search,
    with_strong_tones,
)
from crankorder.identify.modes.surface_fit import NO_POLES, Poles, Problem, SurfaceFit
from crankorder.identify.modes.sweep_modes import modes_unlike, poles_of, poles_unlike, with_sweep_modes
from crankorder.identify.modes.tones import NUMBERS as TONES
from crankorder.identify.modes.tones import tone_of, tone_or_mode, with_one_mains, with_tones
from crankorder.identify.modes.whirl import (
    doubt_about,
    narrower_than_fitted,
    of_lines_within,
    of_the_air,
    said_wide,
    whirls_of,
    without_remains,
)
from crankorder.quantities import Bools, Floats
from crankorder.settings import IdentifySettings, MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-modal.toml", table="joint_fit"):
    longest_bins: int
    band_bins: int
    most_peaks: int
    band_peaks: int
    shared_bins: int
    band_share: float
    shared_share: float
    slack_share: float
    shown_db: float
    deepest_db: float


NUMBERS = _Numbers.load()


@dataclass(frozen=True, eq=False)
class Band:
    """``floor`` of a band with what it shares with the next ones; poles in ``range_hz`` (from, to) belong to it.

    ``first`` and ``last`` are the bins of the whole floor that are its own, the last one excluded.
    """

    floor: Floor
    range_hz: tuple[float, float]
    first: int
    last: int

    def holds(self, poles: Poles) -> Bools:
        """Which of ``poles`` (M,) lie in it or in what it shares."""
        at, step = poles.frequency_hz, self.floor.step_hz
        return np.asarray((at > self.floor.frequency_hz[0] - step) & (at < self.floor.frequency_hz[-1] + step))


def bands_of(floor: Floor) -> tuple[Band, ...]:
    """Bands of ``floor``, cut away from its peaks; one where it is short and has few."""
    n_bins = len(floor.frequency_hz)
    seen = _peaks_by_part(floor)
    if n_bins <= NUMBERS.longest_bins and len(seen) <= NUMBERS.most_peaks:
        return (Band(floor, EVERYWHERE, 0, n_bins),)
    load = 1.0 / np.maximum(NUMBERS.band_bins, NUMBERS.band_share * floor.frequency_hz / floor.step_hz)
    np.add.at(
        load, np.searchsorted(floor.frequency_hz, seen.frequency_hz).clip(0, n_bins - 1), 1.0 / NUMBERS.band_peaks
    )
    load = np.cumsum(load)
    n_bands = max(1, math.ceil(load[-1] - 1e-9))
    cuts = [0, *(_quiet_cut(floor, seen, load, k / n_bands, n_bands) for k in range(1, n_bands)), n_bins]
    cuts = sorted(set(cuts))
    return tuple(_band(floor, first, last) for first, last in pairwise(cuts))


def _band(floor: Floor, first: int, last: int) -> Band:
    n_bins = len(floor.frequency_hz)
    below, above = (
        max(NUMBERS.shared_bins, round(NUMBERS.shared_share * float(floor.frequency_hz[end]) / floor.step_hz))
        for end in (first, last - 1)
    )
    at = slice(max(0, first - below), min(n_bins, last + above))
    part = replace(
        floor,
        frequency_hz=floor.frequency_hz[at],
        psd=floor.psd[:, at],
        averages=floor.averages[:, at],
        cells=floor.cells[:, :, at],
        whole=floor.whole[:, at],
        strong=tuple(t for t in floor.strong if floor.frequency_hz[at][0] <= t[0] <= floor.frequency_hz[at][-1]),
    )
    low = floor.frequency_hz[first] - 0.5 * floor.step_hz if first else -math.inf
    high = floor.frequency_hz[last] - 0.5 * floor.step_hz if last < n_bins else math.inf
    return Band(part, (float(low), float(high)), first, last)


def _peaks_by_part(floor: Floor) -> Poles:
    """Peaks of ``floor``, looked for part by part, which takes a time that grows as the floor does."""
    made = NO_POLES
    for first in range(0, len(floor.frequency_hz), NUMBERS.band_bins):
        part = _band(floor, first, min(first + NUMBERS.band_bins, len(floor.frequency_hz)))
        if len(part.floor.frequency_hz) >= 2 * NUMBERS.shared_bins:
            here = peaks(part.floor)
            made = made.joined(here.chosen(here.within(part.range_hz)))
    return made


def _quiet_cut(floor: Floor, seen: Poles, load: Floats, share: float, n_bands: int) -> int:
    """Bin near that at ``share`` of the ``load`` which lies the most widths away from any peak."""
    low, high = np.searchsorted(load, load[-1] * (share + NUMBERS.slack_share / n_bands * np.array([-1.0, 1.0])))
    bins = np.arange(max(int(low), 1), min(max(int(high), int(low) + 1), len(load) - 1) + 1)
    if not len(seen):
        return int(bins[len(bins) // 2])
    width = seen.damping * seen.frequency_hz + 3.0 * floor.seen.bin_hz
    away = (np.abs(floor.frequency_hz[bins, None] - seen.frequency_hz) / width).min(axis=1)
    return int(bins[np.argmax(np.minimum(away, 10.0) - 1e-3 * np.abs(bins - bins.mean()) / len(bins))])


ROUNDS = 2
"""Times that the bands are fitted together with the orders, each with what the others came to."""


def modal_fit(
    campbell: xr.Dataset,
    order_map: xr.Dataset,
    orders: tuple[AgreedOrder, ...],
    *,
    settings: IdentifySettings,
    followed: Sequence[xr.Dataset] = (),
    swept: SweepFits = NO_FITS,
) -> ModalFit:
    """Natural frequencies, damping ratios and tones of a test, with their covariance.

    ``campbell`` (CampbellMap) and ``order_map`` (OrderMap) are the maps of the test, ``orders`` what was found in the
    latter, ``followed`` (RecordingTracks) how they ran along sweeps, ``swept`` what the signals of these tell;
    ``settings`` state the false-alarm level and what counts as a mode. The floor that the order lines leave, in all
    channels, and amplitude and phase of the orders over the speeds are fitted by one set of poles, band by band where
    the map is long; poles that only orders show are looked for in all of them, but where ``swept`` tells them.
    """
    blocks = blocks_of(order_map, orders, followed)
    floor = _floor(campbell, order_map, orders)
    fitted: list[Fitted] = []
    whirls: tuple[Whirl, ...] = ()
    if floor is not None:
        floor, whirls = whirls_of(floor, settings=settings)
        floor = with_strong_tones(floor, least_damping=TONES.least_damping_ratio)
        for band in bands_of(floor):
            own_hz = band.range_hz
            problem, fit, stopped = search(band.floor, chance=settings.false_alarm_probability, own_hz=own_hz)
            fit = with_tones(problem, fit, floor, own_hz=own_hz, settings=settings)
            fitted.append(Fitted(band, problem, fit, stopped))
    cycle, least = int(order_map.attrs["revs_per_cycle"]), settings.least_damping_ratio
    fixed, spread = poles_of(swept.poles)
    known, covariance = poles_unlike(_own_modes(fitted), _own_covariance(fitted), swept.poles)
    blocks, extra, ended = poles_of_orders(
        blocks,
        known.joined(fixed),
        side_by_side([covariance, spread]),
        chance=settings.false_alarm_probability,
        most_damping=settings.max_damping_ratio,
        most_poles=0 if swept.poles else None,
    )
    for _ in range(1 if len(fitted) == 1 else ROUNDS):
        fitted = [_with_orders(item, fitted, blocks, fixed.joined(_of_orders(extra))) for item in fitted]
    known, _ = poles_unlike(_own_modes(fitted), _own_covariance(fitted), swept.poles)
    told = settled(blocks, known.joined(fixed), extra, chance=settings.false_alarm_probability)
    blocks = told.blocks
    found = ModalFit((), (), np.zeros((0, 0)))
    kept = NO_POLES
    if floor is not None:
        proof = dict(zip(known.frequency_hz.tolist(), told.proofs, strict=False))
        found, kept = _found(fitted, floor, proof, settings)
    found, kept = with_sweep_modes(*modes_unlike(found, kept, swept.poles), swept.poles, settings)
    floors = [bound for item in fitted if (bound := item.excludes(settings)) is not None]
    unit = dict(zip(order_map["channel"].values.tolist(), order_map["unit"].values.tolist(), strict=True))
    made = _with_order_modes(found, kept, blocks, told.found, told.covariance, (floors, swept.hiding), unit, settings)
    hidden = hidden_speeds(blocks, made.modes, revs_per_cycle=cycle, least_damping=least, looked_hz=swept.looked_hz)
    made = replace(
        made,
        modes=of_the_air(made.modes, campbell),
        hidden=hidden,
        swings=told.swings,
        shown_orders=swept.shown_orders,
        left=_left(fitted, floor, blocks if not ended else (), swept),
    )
    return without_remains(made, whirls, campbell["speed"].values) if whirls else made


def _floor(campbell: xr.Dataset, order_map: xr.Dataset, orders: tuple[AgreedOrder, ...]) -> Floor | None:
    """Floor of the map without the orders; None where it has no speeds or hardly a bin."""
    if not campbell.sizes["speed"] or not campbell.sizes["channel"]:
        return None
    single = seen_at_single_speeds(order_map, top_hz=float(campbell["frequency"].values[-1]))
    floor = quiet_floor(campbell, tuple((item.order, item.order_error) for item in orders), single=single)
    return floor if floor is not None and np.isfinite(floor.psd).any() else None


def _left(
    fitted: list[Fitted], floor: Floor | None, unended: Sequence[Block], swept: SweepFits
) -> tuple[Unsearched, ...]:
    """Where the searches in bands of the ``floor``, in ``swept`` signals and by ``unended`` blocks stopped."""
    left = [Unsearched("sweeps", low, high) for low, high in swept.left_hz]
    if floor is not None:
        bands = np.clip([item.band.range_hz for item in fitted if item.stopped], *floor.frequency_hz[[0, -1]])
        left += [Unsearched("floor", float(low), float(high)) for low, high in bands]
    if unended:
        ends = np.array([block.ends_hz for block in unended])
        left.append(Unsearched("orders", float(ends.min()), float(ends.max())))
    return tuple(left)


def _own_modes(fitted: list[Fitted]) -> Poles:
    """Poles of all bands that are no tones."""
    return reduce(Poles.joined, (item.own_modes for item in fitted), NO_POLES)


def _own_covariance(fitted: list[Fitted]) -> Floats:
    """Covariance of (f_1, ζ_1, f_2, …) of the poles of all bands that are no tones."""
    return side_by_side([item.covariance_of(item.own) for item in fitted])


@dataclass(frozen=True, eq=False)
class Fitted:
    """``fit`` of the ``problem`` of a ``band``; ``stopped``: whether the search for its poles did at its bound."""

    band: Band
    problem: Problem
    fit: SurfaceFit
    stopped: bool

    @property
    def own(self) -> Bools:
        """Which poles belong to the band and are no tones."""
        return np.asarray(self.fit.poles.within(self.band.range_hz) & ~self.fit.poles.tone)

    @property
    def own_modes(self) -> Poles:
        """Poles that belong to the band and are no tones."""
        return self.fit.poles.chosen(self.own)

    def excludes(self, settings: IdentifySettings) -> FloorBound | None:
        """What the floor of the band excludes at the damping and the confidence of the ``settings``."""
        return floor_bound(
            self.problem,
            self.fit.model,
            poles=self.own_modes,
            least_damping=settings.least_damping_ratio,
            confidence=settings.free_confidence,
        )

    def covariance_of(self, which: Bools) -> Floats:
        """Covariance of (f_1, ζ_1, f_2, …) of the poles marked by ``which``."""
        scatter = np.array([dispersion(self.problem, self.fit, float(f)) for f in self.fit.poles.frequency_hz])
        at = np.flatnonzero(np.repeat(which, 2))
        return pole_covariance(self.problem, self.fit, scatter=scatter)[np.ix_(at, at)]


def _of_orders(extra: Sequence[OrderPole]) -> Poles:
    """Poles of what only orders show."""
    made = NO_POLES
    for pole in extra:
        made = made.with_pole(pole.frequency_hz, pole.damping)
    return made


def _with_orders(item: Fitted, every: list[Fitted], blocks: tuple[Block, ...], fixed: Poles) -> Fitted:
    """The fit of a band together with the orders that sweep through its modes; other bands stay as they are."""
    if not blocks or not len(item.own_modes):
        return item
    for other in every:
        if other is not item:
            fixed = fixed.joined(other.own_modes.chosen(~item.band.holds(other.own_modes)))
    problem, fit = fitting(replace(item.problem, others=None), item.fit, blocks, fixed=fixed)
    return replace(item, problem=problem, fit=fit)


def _with_order_modes(
    fit: ModalFit,
    kept: Poles,
    blocks: tuple[Block, ...],
    extra: tuple[OrderPole, ...],
    covariance: Floats,
    excluded: tuple[Sequence[FloorBound], Sequence[Hiding]],
    unit: Mapping[str, str],
    settings: IdentifySettings,
) -> ModalFit:
    """``fit``, whose modes are the poles ``kept``, with those that only orders show, lowest first.

    ``excluded``: what floors and sweeps leave open.
    """
    parts = [covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(len(extra))]
    every = kept
    for pole in extra:
        every = every.joined(NO_POLES.with_pole(pole.frequency_hz, pole.damping))
    said = [mode_of(pole, part, every, settings=settings) for pole, part in zip(extra, parts, strict=True)]
    own = [k for k, mode in enumerate(said) if mode is not None]
    more = [mode for mode in said if mode is not None]
    for mode in more:
        kept = kept.joined(NO_POLES.with_pole(mode.frequency_hz, mode.damping_ratio))
    doubted = _raised_tones(fit, more, blocks, kept)
    for tone in doubted:
        mode, part = tone_as_mode(tone, doubted[tone], settings=settings)
        more.append(mode)
        kept = kept.joined(NO_POLES.with_pole(mode.frequency_hz, mode.damping_ratio))
        parts.append(part)
    proven = [mode.frequency_ends for mode in fit.modes if mode.reached_by and not mode.undecided]

    def within(tone: Tone) -> bool:
        return tone.kind == "tone" and any(low <= tone.frequency_hz <= high for low, high in proven)

    modes = (*fit.modes, *more)
    rank = np.argsort(kept.frequency_hz, kind="stable")
    at = np.stack([2 * rank, 2 * rank + 1], axis=1).ravel()
    of_own = np.array([[2 * k, 2 * k + 1] for k in own], dtype=np.int64).ravel()
    whole = [fit.covariance, covariance[np.ix_(of_own, of_own)], *parts[len(extra) :]]
    poles = Poles(kept.frequency_hz[rank], kept.damping[rank], kept.tone[rank])
    return replace(
        fit,
        modes=tuple(modes[k] for k in rank.tolist()),
        tones=tuple(tone for tone in fit.tones if not any(is_shown(tone, mode) for mode in more) and not within(tone)),
        covariance=side_by_side(whole)[np.ix_(at, at)],
        responses=responses_of(blocks, poles),
        unseen=least_seen(
            blocks,
            poles,
            unit=unit,
            least_damping=settings.least_damping_ratio,
            confidence=settings.free_confidence,
            floors=excluded[0],
            sweeps=excluded[1],
        ),
    )


def _raised_tones(
    fit: ModalFit, more: list[Mode], blocks: tuple[Block, ...], poles: Poles
) -> dict[Tone, tuple[float, ...]]:
    """Tones of ``fit`` that are none of the modes ``more``, at which orders rise, and these orders."""
    found = {}
    for tone in fit.tones:
        if tone.kind != "tone" or any(is_shown(tone, mode) for mode in more):
            continue
        orders = orders_raised(blocks, poles, tone.frequency_hz)
        if orders:
            found[tone] = orders
    return found


def _found(
    fitted: list[Fitted],
    floor: Floor,
    proofs: dict[float, Proof],
    settings: IdentifySettings,
) -> tuple[ModalFit, Poles]:
    """The fits of all bands in the words of identification, with the orders' ``proofs`` by frequency; their poles."""
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
        tone = poles.tone & poles.within(item.band.range_hz) & ~hidden_poles(item.problem, item.fit)
        still += tuple(poles.frequency_hz[tone].tolist())
    tones = [tone_of(f, error, floor, smooth, settings=settings) for f, error in floor.strong]
    modes: list[Mode] = []
    parts: list[Floats] = []
    kept = NO_POLES
    for item in fitted:
        said = _of_band(item, floor, smooth, still, proofs, settings)
        modes += said[0]
        tones += said[1]
        parts.append(said[2])
        kept = kept.joined(said[3])
    found = ModalFit(
        tuple(modes),
        with_one_mains(sorted((t for t in tones if t.amplitude), key=lambda t: t.frequency_hz), settings=settings),
        side_by_side(parts),
        frequency_hz=floor.frequency_hz,
        floor_psd=floor.psd,
        fitted_psd=shape,
    )
    return found, kept


def _of_band(
    item: Fitted,
    floor: Floor,
    smooth: Floats,
    still: tuple[float, ...],
    proofs: dict[float, Proof],
    settings: IdentifySettings,
) -> tuple[list[Mode], list[Tone], Floats, Poles]:
    """Modes of a band, its tones, the covariance of the modes and their poles."""
    problem, fit = item.problem, item.fit
    scatter = np.array([dispersion(problem, fit, float(f)) for f in fit.poles.frequency_hz])
    covariance = covariance_of_all(problem, fit, scatter=scatter)
    strength = (
        evidence_of(fit) / np.array([scatter_at(problem, fit, float(f)) for f in fit.poles.frequency_hz])[:, None]
    )
    modes: list[Mode] = []
    tones: list[Tone] = []
    kept: list[int] = []
    for number in np.flatnonzero(~hidden_poles(problem, fit) & fit.poles.within(item.band.range_hz)).tolist():
        f, error = float(fit.poles.frequency_hz[number]), float(np.sqrt(covariance[2 * number, 2 * number]))
        if fit.poles.tone[number]:
            if floor.frequency_hz[0] <= f <= floor.frequency_hz[-1]:
                part = fit.part(number)
                rest = smooth.copy()
                at = np.searchsorted(floor.frequency_hz, problem.frequency_hz[0]) + np.arange(part.shape[1])
                rest[:, at] = np.maximum(smooth[:, at] - part, 0.02 * smooth[:, at])
                tones.append(tone_of(f, error, floor, rest, settings=settings))
            continue
        proof = proofs.get(f, Proof())
        mode = _mode(number, problem, fit, floor, covariance, strength[number], still, proof, settings)
        if mode is not None:
            modes.append(mode)
            kept.append(number)
    at = np.array([[2 * number, 2 * number + 1] for number in kept], dtype=np.int64).ravel()
    which = np.isin(np.arange(len(fit.poles)), kept)
    return modes, tones, covariance[np.ix_(at, at)], fit.poles.chosen(which)


def _too_deep(floor: Floor, frequency_hz: float, channels: Sequence[str]) -> str:
    """Why what ``floor`` shows at ``frequency_hz`` in ``channels`` is too far under their strongest lines; or ""."""
    at = int(np.argmin(np.abs(floor.frequency_hz - frequency_hz)))
    rows = [floor.channels.index(name) for name in channels]
    under = 10.0 * np.log10(np.nanmax(floor.whole[rows], axis=1) / floor.psd[rows, at])
    if not (least := float(np.nanmin(under, initial=np.inf))) > NUMBERS.deepest_db:
        return ""
    return f"{least:.0f} dB under the strongest line, of which window and angle leave as much"


def _without_hidden(item: Fitted) -> Floats:
    """Power (C, F) of a band's fit without strong tones and the poles that stand for the skirts of masked lines."""
    smooth = item.fit.without_lines(item.problem)
    for number in np.flatnonzero(hidden_poles(item.problem, item.fit)).tolist():
        smooth = smooth - item.fit.part(number)
    return np.asarray(np.maximum(smooth, 0.02 * _typical(item.problem)))


def _typical(problem: Problem) -> Floats:
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
    covariance: Floats,
    strength: Floats,
    still: tuple[float, ...],
    proof: Proof,
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
    shown = (lifted > NUMBERS.shown_db) & (strength > least_gain(1, settings.false_alarm_probability))
    prominence = float(lifted.max())
    if prominence < settings.mode_prominence_db and not proof.orders:
        return None
    names = tuple(name for name, is_shown in zip(floor.channels, shown, strict=True) if is_shown)
    if not names:
        names = (floor.channels[int(np.argmax(lifted))],)
    words = f"{prominence:.1f} dB over what the floor is without it, in {len(names)} of {len(floor.channels)} channels"
    if proof.orders:
        words += f"; {proven_by(proof)}"
    words += said_wide(f, error)
    doubt = tone_or_mode(problem, fit, number, settings=settings) or doubt_about(
        (f, error), (zeta, zeta_error), floor, still, prominence_db=prominence, n_shown=len(names), settings=settings
    )
    if not doubt and narrower_than_fitted(problem, fit, number):
        doubt = "its flanks are lower than a mode's of this damping: a tone with something beside it, or a mode"
    doubt = doubt or of_lines_within(problem, fit, number, floor, settings=settings) or _too_deep(floor, f, names)
    if (
        doubt
        and is_proven(proof)
        and error <= ORDER_MODES.uncertain_share * f
        and zeta_error <= ORDER_MODES.known_share * zeta
    ):
        doubt = ""
    return Mode(f, error, zeta, zeta_error, names, prominence, words, proof.orders, doubt)
