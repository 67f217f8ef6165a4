"""Modal fit of a test: natural frequencies and damping from floor and orders together, tones told apart."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np
import xarray as xr

from crankorder.identify.found import NO_FITS, AgreedOrders, ModalFit, Mode, SweepFits, Unsearched, Whirl
from crankorder.identify.modes.floor import Floor, quiet_floor, seen_at_single_speeds
from crankorder.identify.modes.order_blocks import blocks_of
from crankorder.identify.modes.order_responses import Block, Blocks, with_best_law, with_scatter
from crankorder.identify.modes.order_search import NUMBERS as ORDER_SEARCH
from crankorder.identify.modes.order_search import ORDER_MODES, OrderPole, Proof, Settled, poles_of_orders, settled
from crankorder.identify.modes.responses import floor_bound, least_seen, responses_of
from crankorder.identify.modes.search import (
    JOINT_FIT,
    Band,
    bands_of,
    dispersion,
    evidence_of,
    hidden_poles,
    least_gain,
    scatter_at,
    search,
    with_strong_tones,
)
from crankorder.identify.modes.surface_fit import (
    NO_POLES,
    Poles,
    Problem,
    SurfaceFit,
    covariance_among,
    covariance_of_all,
    fit_surface,
    pole_covariance,
    poles_at,
    poles_of_modes,
    side_by_side,
)
from crankorder.identify.modes.sweep_modes import poles_of, unlike, with_sweep_modes
from crankorder.identify.modes.tones import NUMBERS as TONES
from crankorder.identify.modes.tones import is_shown, tone_of, tone_or_mode, with_one_mains, with_tones
from crankorder.identify.modes.whirl import (
    doubt_about,
    of_lines_within,
    of_the_air,
    said_wide,
    whirls_of,
    without_remains,
)
from crankorder.orders.intervals import Z95
from crankorder.quantities import Bools, Floats
from crankorder.settings import IdentifySettings

ROUNDS = 2
"""Times that the bands are fitted together with the orders, each with what the others came to."""


def modal_fit(
    campbell: xr.Dataset,
    order_map: xr.Dataset,
    orders: AgreedOrders,
    *,
    settings: IdentifySettings,
    followed: Sequence[xr.Dataset] = (),
    swept: SweepFits = NO_FITS,
) -> ModalFit:
    """Natural frequencies, damping ratios and tones of a test, with their covariance.

    ``campbell`` (CampbellMap) and ``order_map`` (OrderMap) are the maps of the test, ``orders`` what was found in the
    latter, ``followed`` (RecordingTracks) how they ran along sweeps, ``swept`` what the signals of these tell;
    ``settings`` state the false-alarm level and what counts as a mode. The floor that the order lines leave, in all
    channels, and amplitude and phase of the orders over speeds that were held are fitted by one set of poles, band by
    band where the map is long; poles that only orders show are looked for in all of them, but where ``swept`` tells
    them. Orders of sweeps tell no poles here, only how they answer the modes.
    """
    asked = blocks_of(order_map, orders, followed)
    held = [block for block in asked if not block.rows.recording]
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
    fixed, spread = poles_of(swept.poles)
    known, covariance = _known(fitted, swept)
    both, most = side_by_side([covariance, spread]), 0 if swept.poles else ORDER_SEARCH.most_poles
    blocks, extra, ended = poles_of_orders(held, known.joined(fixed), both, settings=settings, most_poles=most)
    of_orders = poles_at((pole.frequency_hz, pole.damping) for pole in extra).rising
    for _ in range(1 if len(fitted) == 1 else ROUNDS):
        fitted = [_with_orders(local, fitted, blocks, fixed.joined(of_orders)) for local in fitted]
    known, _ = _known(fitted, swept)
    by_orders = settled(blocks, known.joined(fixed), extra)
    modal = ModalFit((), (), np.zeros((0, 0)))
    if floor is not None:
        proof = dict(zip(known.frequency_hz.tolist(), by_orders.proofs, strict=False))
        modal = _found(fitted, floor, proof, settings)
    modal = with_sweep_modes(modal, swept.poles, settings)
    every = poles_of_modes(modal.modes).joined(poles_at((pole.frequency_hz, pole.damping) for pole in by_orders.found))
    blocks = (*by_orders.blocks, *(with_best_law(block, every) for block in asked if block.rows.recording))
    modal = _with_order_modes(modal, by_orders, every, settings)
    bounds = [floor_bound(local.problem, local.fit.model, poles=local.own_modes, settings=settings) for local in fitted]
    unit = dict(zip(order_map["channel"].values.tolist(), order_map["unit"].values.tolist(), strict=True))
    poles, floors = poles_of_modes(modal.modes), [bound for bound in bounds if bound is not None]
    modal = replace(
        modal,
        modes=of_the_air(modal.modes, campbell),
        responses=tuple(responses_of(blocks, poles)),
        unseen=least_seen(blocks, poles, unit=unit, settings=settings, floors=floors, sweeps=swept.hiding),
        shown_orders=swept.shown_orders,
        left=tuple(_left(fitted, floor, by_orders.blocks if not ended else (), swept)),
    )
    return without_remains(modal, whirls, campbell["speed"].values) if whirls else modal


def _floor(campbell: xr.Dataset, order_map: xr.Dataset, orders: AgreedOrders) -> Floor | None:
    """Floor of the map without the orders; None where it has no speeds or hardly a bin."""
    if not campbell.sizes["speed"] or not campbell.sizes["channel"]:
        return None
    single = seen_at_single_speeds(order_map, top_hz=float(campbell["frequency"].values[-1]))
    floor = quiet_floor(campbell, tuple((agreed.order, agreed.order_error) for agreed in orders), single=single)
    return floor if floor is not None and np.isfinite(floor.psd).any() else None


def _left(
    fitted: list[Fitted], floor: Floor | None, unended: Sequence[Block], swept: SweepFits
) -> Iterator[Unsearched]:
    """Where the searches in bands of the ``floor``, in ``swept`` signals and by ``unended`` blocks stopped."""
    yield from (Unsearched("sweeps", low, high) for low, high in swept.left_hz)
    if floor is not None:
        bands = np.clip([local.band.range_hz for local in fitted if local.stopped], *floor.frequency_hz[[0, -1]])
        yield from (Unsearched("floor", float(low), float(high)) for low, high in bands)
    if unended:
        ends = np.array([block.rows.ends_hz for block in unended])
        yield Unsearched("orders", float(ends.min()), float(ends.max()))


def _known(fitted: list[Fitted], swept: SweepFits) -> tuple[Poles, Floats]:
    """Poles of all bands that are neither tones nor those of ``swept``, and covariance of their (f_1, ζ_1, f_2, …)."""
    covariance = side_by_side([covariance_among(local.covariance, np.flatnonzero(local.own)) for local in fitted])
    own = reduce(Poles.joined, (local.own_modes for local in fitted), NO_POLES)
    kept = np.flatnonzero(unlike(own, covariance, swept.poles))
    return own.chosen(kept), covariance_among(covariance, kept)


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

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (2M, 2M) of (f_1, ζ_1, f_2, …), as far as the residuals around each pole are noise."""
        scatter = [dispersion(self.problem, self.fit, float(f)) for f in self.fit.poles.frequency_hz]
        return pole_covariance(self.problem, self.fit, scatter=np.array(scatter))


def _with_orders(local: Fitted, every: list[Fitted], blocks: Sequence[Block], fixed: Poles) -> Fitted:
    """Joint fit of a band with those of ``blocks`` that sweep through its modes and agree with them.

    Each counts by its errors and the scatter that the poles leave, with ``fixed`` ones and other bands' among them.
    """
    if not blocks or not len(local.own_modes):
        return local
    for other in (other for other in every if other is not local):
        fixed = fixed.joined(other.own_modes.chosen(~local.band.holds(other.own_modes)))
    problem, fit = replace(local.problem, others=None), local.fit
    blocks = [block for block in blocks if len(block.reached(fit.poles)) or not len(fixed)]
    for _ in range(2):
        blocks = [with_scatter(block, fit.poles.joined(fixed))[0] for block in blocks]
        good = tuple(block for block in blocks if block.tells)
        if not good:
            return replace(local, problem=replace(problem, others=None), fit=fit)
        problem = replace(problem, others=Blocks(good, fixed))
        fit = fit_surface(problem, fit.poles, start=fit.model, steps=10)
    return replace(local, problem=problem, fit=fit)


def _with_order_modes(fit: ModalFit, by_orders: Settled, every: Poles, settings: IdentifySettings) -> ModalFit:
    """``fit`` with the modes that only orders show (``by_orders``, among ``every`` pole of the test), lowest first."""
    said = [
        mode_of(pole, covariance_among(by_orders.covariance, [k]), every, settings=settings)
        for k, pole in enumerate(by_orders.found)
    ]
    own = [k for k, mode in enumerate(said) if mode is not None]
    more = [mode for mode in said if mode is not None]
    parts = [fit.covariance, covariance_among(by_orders.covariance, own)]
    modes = (*fit.modes, *more)
    rank = poles_of_modes(modes).rank
    tones = tuple(tone for tone in fit.tones if not any(is_shown(tone, mode) for mode in more))
    covariance = covariance_among(side_by_side(parts), rank)
    return replace(fit, modes=tuple(modes[k] for k in rank.tolist()), tones=tones, covariance=covariance)


def _found(fitted: list[Fitted], floor: Floor, proofs: dict[float, Proof], settings: IdentifySettings) -> ModalFit:
    """The fits of all bands in the words of identification, with the orders' ``proofs`` by frequency."""
    shape, smooth = np.full(floor.psd.shape, np.nan), np.empty(floor.psd.shape)
    still = tuple(f for f, _ in floor.strong)
    for local in fitted:
        own = slice(local.band.first, local.band.last)
        from_here = local.band.first - int(np.searchsorted(floor.frequency_hz, local.problem.frequency_hz[0]))
        here = slice(from_here, from_here + local.band.last - local.band.first)
        shape[:, own] = np.where(local.problem.averages > 0.0, local.fit.model, np.nan)[:, here]
        smooth[:, own] = _without_hidden(local)[:, here]
        poles = local.fit.poles
        tone = poles.tone & poles.within(local.band.range_hz) & ~hidden_poles(local.problem, local.fit)
        still += tuple(poles.frequency_hz[tone].tolist())
    tones = [tone_of(f, error, floor, smooth, settings=settings) for f, error in floor.strong]
    modes, parts = list[Mode](), list[Floats]()
    for local in fitted:
        problem, fit = local.problem, local.fit
        covariance = covariance_of_all(fit, local.covariance)
        scatter = np.array([scatter_at(problem, fit, float(f)) for f in fit.poles.frequency_hz])
        strength = evidence_of(fit) / scatter[:, None]
        numbers: list[int] = []
        for number in np.flatnonzero(~hidden_poles(problem, fit) & fit.poles.within(local.band.range_hz)).tolist():
            f, error = float(fit.poles.frequency_hz[number]), float(np.sqrt(covariance[2 * number, 2 * number]))
            if not floor.frequency_hz[0] <= f <= floor.frequency_hz[-1]:
                continue
            if fit.poles.tone[number]:
                part, rest = fit.part(number), smooth.copy()
                at = np.searchsorted(floor.frequency_hz, problem.frequency_hz[0]) + np.arange(part.shape[1])
                rest[:, at] = np.maximum(smooth[:, at] - part, 0.02 * smooth[:, at])
                tones.append(tone_of(f, error, floor, rest, settings=settings))
            elif mode := _mode(
                number, local, floor, covariance, strength[number], still, proofs.get(f, Proof()), settings
            ):
                modes.append(mode)
                numbers.append(number)
        parts.append(covariance_among(covariance, numbers))
    tones = sorted((tone for tone in tones if tone.amplitude), key=lambda tone: tone.frequency_hz)
    joined = ModalFit(tuple(modes), with_one_mains(tones, settings=settings), side_by_side(parts))
    return replace(joined, frequency_hz=floor.frequency_hz, floor_psd=floor.psd, fitted_psd=shape)


def _too_deep(floor: Floor, frequency_hz: float, channels: Sequence[str]) -> str:
    """Why what ``floor`` shows at ``frequency_hz`` in ``channels`` is too far under their strongest lines; or ""."""
    at = int(np.argmin(np.abs(floor.frequency_hz - frequency_hz)))
    rows = [floor.channels.index(name) for name in channels]
    under = 10.0 * np.log10(np.nanmax(floor.whole[rows], axis=1) / floor.psd[rows, at])
    if not (least := float(np.nanmin(under, initial=np.inf))) > JOINT_FIT.deepest_db:
        return ""
    return f"{least:.0f} dB under the strongest line, of which window and angle leave as much"


def _without_hidden(local: Fitted) -> Floats:
    """Power (C, F) of a band's fit without strong tones and the poles that stand for the skirts of masked lines."""
    problem, smooth = local.problem, local.fit.without_lines(local.problem)
    for number in np.flatnonzero(hidden_poles(problem, local.fit)).tolist():
        smooth = smooth - local.fit.part(number)
    used = (y[n > 0.0] for y, n in zip(problem.psd, problem.averages, strict=True))
    typical = np.array([np.median(power) if power.size else 0.0 for power in used])[:, None]
    return np.asarray(np.maximum(smooth, 0.02 * typical))


def _mode(
    number: int,
    local: Fitted,
    floor: Floor,
    covariance: Floats,
    strength: Floats,
    still: tuple[float, ...],
    proof: Proof,
    settings: IdentifySettings,
) -> Mode | None:
    """Mode of pole ``number``; None where it is but a part of the floor's shape."""
    problem, fit = local.problem, local.fit
    f, zeta = fit.poles.values[number].tolist()
    error, zeta_error = (float(np.sqrt(covariance[2 * number + k, 2 * number + k])) for k in (0, 1))
    if zeta - 3.0 * zeta_error > settings.max_damping_ratio or zeta > 1.5 * settings.max_damping_ratio:
        return None
    at = int(np.argmin(np.abs(problem.frequency_hz - f)))
    whole = np.maximum(fit.without_lines(problem)[:, at], np.finfo(np.float64).tiny)  # orders may mask this bin
    lifted = 10.0 * np.log10(whole / np.maximum(whole - fit.part(number)[:, at], 1e-3 * whole))
    shown = (lifted > JOINT_FIT.shown_db) & (strength > least_gain(1, settings.false_alarm_probability))
    prominence = float(lifted.max())
    if prominence < settings.mode_prominence_db and not proof.orders:
        return None
    shown[int(np.argmax(lifted))] |= not shown.any()
    names = tuple(np.array(floor.channels)[shown].tolist())
    words = f"{prominence:.1f} dB over what the floor is without it, in {len(names)} of {len(floor.channels)} channels"
    if proof.orders:
        words += f"; {proven_by(proof)}"
    words += said_wide(f, error)
    doubt = tone_or_mode(problem, fit, number, settings=settings) or doubt_about(
        (f, error), (zeta, zeta_error), floor, still, prominence_db=prominence, n_shown=len(names), settings=settings
    )
    doubt = doubt or of_lines_within(problem, fit, number, floor, settings=settings) or _too_deep(floor, f, names)
    known = error <= ORDER_MODES.uncertain_share * f and zeta_error <= ORDER_MODES.known_share * zeta
    doubt = "" if is_proven(proof) and known else doubt
    return Mode(f, error, zeta, zeta_error, names, prominence, words, proof.orders, doubt)


def proven_by(proof: Proof) -> str:
    """What says that a mode is there, in words; empty where no order does.

    ``proof``: the orders that show it.
    """
    if not proof.orders:
        return ""
    if not proof.passed:
        return f"no order passes it; it shapes orders {_listed(proof.orders)} from afar"
    names = _listed(proof.passed)
    if len(proof.passed) > 1:
        words = f"orders {names} peak there, each at its own speed, with the phase of a resonance"
    else:
        near = f"at {proof.most_rows} speeds around it" if proof.most_rows else "seen on its flanks"
        words = f"order {names} has amplitude and phase of a resonance there, {near}"
    if proof.flanked and proof.most_rows < ORDER_MODES.rows_of_turn and not _peaks_prove(proof):
        words += f"; the flanks of order {_listed(proof.flanked)}, without the rows at its peak, place it there"
    return words


def is_proven(proof: Proof) -> bool:
    """Whether two orders sweep through the mode, at several speeds, or each alone at one place: one is evidence.

    One is proof too where it shows the mode at its peak and by its flanks alone.
    ``proof``: the orders that show it.
    """
    return bool(proof.flanked) or _peaks_prove(proof)


def _peaks_prove(proof: Proof) -> bool:
    return len(proof.passed) > 1 and (proof.rows >= ORDER_MODES.rows_of_two or proof.located > 1)


def mode_of(pole: OrderPole, covariance: Floats, every: Poles, *, settings: IdentifySettings) -> Mode | None:
    """Mode of a ``pole`` that only orders show, with its ``covariance`` (2, 2); None where it is a part of the shape.

    So is one of unknown damping that lies no further from another pole than it is known: both are one.
    ``every``: all poles of the test, this one among them; ``settings``: the largest damping that a mode may have.
    """
    error, zeta_error = (float(np.sqrt(max(covariance[k, k], 0.0))) for k in (0, 1))
    f, zeta, proof = pole.frequency_hz, pole.damping, pole.proof
    others = every.frequency_hz[every.frequency_hz != f]
    is_another = zeta_error > ORDER_MODES.known_share * zeta and bool((np.abs(others - f) <= Z95 * error).any())
    if not proof.orders or zeta > settings.max_damping_ratio or is_another:
        return None
    doubt = "; ".join(_doubts(pole, error, zeta_error, every))
    return Mode(f, error, zeta, zeta_error, pole.channels, 0.0, proven_by(proof), proof.orders, doubt)


def _listed(orders: Sequence[float]) -> str:
    return ", ".join(f"{order:g}" for order in orders)


def _doubts(pole: OrderPole, error: float, zeta_error: float, every: Poles) -> Iterator[str]:
    """Why a pole that only orders show may be none."""
    f, zeta, proof = pole.frequency_hz, pole.damping, pole.proof
    low, high = proof.span_hz
    if not proof.passed:
        yield "no order passes it: something else beyond what was swept may look the same"
    elif (
        len(proof.passed) == 1
        and not proof.flanked
        and (proof.most_rows < ORDER_MODES.rows_of_turn or zeta_error > ORDER_MODES.known_alone_share * zeta)
    ):
        yield f"passed by order {proof.passed[0]:g} alone, at {proof.most_rows} speeds: its force may peak there"
    elif len(proof.passed) > 1 and not is_proven(proof):
        yield "too few speeds lie near it: a force that differs at one of them looks the same"
    if error > ORDER_MODES.uncertain_share * f:
        yield "its frequency is uncertain"
    if zeta_error > ORDER_MODES.known_share * zeta:
        yield "its damping is not determined"
    if f + 2.0 * zeta * f > high or f - 2.0 * zeta * f < low:
        yield f"lies at the end of what was swept, {low:.1f} to {high:.1f} Hz"
    apart = np.abs(every.frequency_hz / f - 1.0)
    within = (apart > 0.0) & (apart < every.damping)
    wider = every.frequency_hz[
        within & ((every.damping > ORDER_MODES.wider_ratio * zeta) | (apart < every.damping / ORDER_MODES.wider_ratio))
    ]
    if len(wider):
        yield f"within the width of {wider[0]:.1f} Hz: what that one's model leaves may look the same"
