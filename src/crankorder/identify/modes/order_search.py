"""Natural frequencies that orders tell by amplitude and phase over the speeds, whether or not the floor shows them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, fdtrc

from crankorder.identify.modes.order_responses import NUMBERS as ORDER_RESPONSES
from crankorder.identify.modes.order_responses import (
    Block,
    Blocks,
    Projected,
    as_real,
    deviance_of,
    jacobian,
    project,
    with_bent_law,
    with_best_law,
    with_scatter,
)
from crankorder.identify.modes.surface_fit import Cell, Poles, disagreement, neighbours_together, poles_at
from crankorder.orders.intervals import Z95
from crankorder.quantities import Complexes, Floats
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "order_search")

TRIED_DAMPING = (0.003, 0.01, 0.03, 0.1)
"""Damping ratios that are tried as a start; frequencies lie as far apart as each is wide."""

TRIED_STARTS = 3
"""Best starts that are followed."""

AT_ONCE = 2
"""Poles that are asked for together at most where the others leave nothing that is felt."""

SETTLED, STEPS = 0.05, 12
"""Square of a standard error that a step must gain to be followed by another; steps of a fit at most."""


class Prior(NamedTuple):
    """What the floor says of the first poles: ``place`` (P, 2), their ln f and ln ζ, with its ``error`` (P, 2)."""

    place: Floats
    error: Floats

    @classmethod
    def of(cls, poles: Poles, covariance: Floats) -> Prior:
        """Of ``poles`` whose (f_1, ζ_1, f_2, …) have the ``covariance`` (2 P, 2 P)."""
        spread = np.sqrt(np.maximum(np.diag(covariance).reshape(-1, 2), 0.0)) / poles.values
        # what the floor takes for random may have rung from a start: its widths are not believed further
        least = NUMBERS.model_error_share * np.stack([poles.damping, np.ones(len(poles))], axis=1)
        return cls(np.log(poles.values), np.hypot(spread, least))

    def left(self, poles: Poles) -> Floats:
        """By how many errors (2 P,) ``poles``, of which these are the first, differ from it."""
        return np.asarray(((self.place - np.log(poles.values)[: len(self.place)]) / self.error).ravel())

    def misfit(self, poles: Poles) -> float:
        """Sum of the squares by which ``poles`` differ from it."""
        return float(np.sum(self.left(poles) ** 2))


NO_PRIOR = Prior(np.zeros((0, 2)), np.zeros((0, 2)))


def poles_of_orders(
    blocks: Sequence[Block],
    known: Poles,
    covariance: Floats,
    *,
    settings: IdentifySettings,
    most_poles: int = NUMBERS.most_poles,
) -> tuple[tuple[Block, ...], tuple[OrderPole, ...], bool]:
    """``blocks`` with their laws and scatter, the poles beyond the ``known`` ones that they ask for; whether these end.

    They do not where as many poles were found or starts followed as are allowed: others may be left.
    One pole after the other is taken where it explains most that is left of all orders and channels, and moved with all
    others to where the likelihood is largest, the known ones within their ``covariance`` (of f_1, ζ_1, f_2, …). Those
    are kept in the end that save more than the false-alarm level of the ``settings`` would let noise save at any of the
    frequencies tried; ``settings`` also state the largest damping ratio, ``most_poles`` how many are looked for. Each
    order has the scatter that is left of it: a force which only varies from speed to speed makes no pole.
    """
    if not blocks:
        return (), (), True
    chance, most_damping = settings.false_alarm_probability, settings.max_damping_ratio
    prior = Prior.of(known, covariance)
    asked = sorted(blocks, key=lambda block: -float(np.max(block.rows.size / block.rows.error)))[: NUMBERS.most_blocks]
    state = Fitted.of([with_best_law(block, known) for block in asked], known, prior)
    if len(known) and most_poles:
        state = state.moved()
    tried = _starts(asked)
    starts, more = NUMBERS.most_starts, state if most_poles else None
    while more is not None and starts > 0 and len(state.poles) - len(known) < most_poles:
        state = more
        more, followed = _more(state, tried, chance=chance, most_damping=most_damping)
        starts -= followed
    state = _pruned(state if more is None else more, chance=chance)
    new = range(len(known), len(state.poles))
    poles = tuple(named(state.blocks, state.projected, state.poles, number) for number in new)
    return state.blocks, poles, more is None


class Settled(NamedTuple):
    """``blocks`` with their laws and scatter; ``proofs`` of the known poles; the poles ``found``, lowest first.

    ``covariance`` (2 M, 2 M) is that of (f_1, ζ_1, f_2, …) of the latter.
    """

    blocks: tuple[Block, ...]
    proofs: tuple[Proof, ...]
    found: tuple[OrderPole, ...]
    covariance: Floats


def settled(blocks: Sequence[Block], known: Poles, candidates: Sequence[OrderPole]) -> Settled:
    """``blocks`` behind the ``known`` poles and the ``candidates`` ones, which are moved once more behind those.

    Channels share what an order's force varies by: their residuals are as alike as they are seen to be.
    """
    free = poles_at((pole.frequency_hz, pole.damping) for pole in candidates).rising
    state = Fitted.of(blocks, known.joined(free), NO_PRIOR)
    if len(free):
        state = state.moved(fixed=len(known))
    every = [named(state.blocks, state.projected, state.poles, number) for number in range(len(state.poles))]
    proofs = tuple(pole.proof for pole in every[: len(known)])
    covariance = order_pole_covariance(state.blocks, state.projected, state.poles, fixed=len(known))
    return Settled(state.blocks, proofs, tuple(every[len(known) :]), covariance)


class Fitted(NamedTuple):
    """``blocks`` with the scatter that ``poles`` leave, each as ``projected`` with them, and the ``prior`` of these."""

    blocks: tuple[Block, ...]
    projected: tuple[Projected, ...]
    poles: Poles
    prior: Prior

    @classmethod
    def of(cls, blocks: Sequence[Block], poles: Poles, prior: Prior) -> Fitted:
        """State of ``blocks`` behind ``poles`` with their ``prior``."""
        pairs = [with_scatter(block, poles) for block in blocks]
        return cls(tuple(block for block, _ in pairs), tuple(part for _, part in pairs), poles, prior)

    def moved(self, *, fixed: int = 0) -> Fitted:
        """With all poles but the first ``fixed`` where the likelihood is largest, and the scatter that is left then."""
        good = tuple(block for block in self.blocks if block.scatter <= NUMBERS.hopeless_scatter)
        if not good:
            return self
        number = np.arange(len(self.poles))
        still, free = self.poles.chosen(number < fixed), self.poles.chosen(number >= fixed)
        poles = still.joined(_moved(Blocks(good, still), free, NO_PRIOR if fixed else self.prior))
        return Fitted.of([with_bent_law(block, poles) for block in self.blocks], poles, self.prior)

    def with_pole(self, start: tuple[float, float]) -> Fitted:
        """With one pole more, near a ``start`` (Hz, damping ratio), the others staying where they are."""
        more = self.poles.joined(poles_at([start]))
        blocks = [_refitted_with(block, more, start[0]) for block in self.blocks]
        return Fitted.of(blocks, more, self.prior).moved(fixed=len(self.poles))

    @property
    def misses(self) -> float:
        """Largest share of an order's amplitude that the poles leave of any row, far over its noise."""
        return max(float(share.max()) for share in self._left_shares())

    def accounts_for(self, less: Fitted) -> float:
        """Largest share of an order's amplitude, at any row, that the poles account for beyond those of ``less``."""
        pairs = zip(less._left_shares(), self._left_shares(clear=False), strict=True)
        return max((float((before - after).max()) for before, after in pairs), default=0.0)

    def _left_shares(self, *, clear: bool = True) -> Iterator[Floats]:
        """What is left of each row (C, K) of each block as a share of the amplitude; 0 where that is small.

        And, of what must be ``clear``, where noise may have made it.
        """
        for block, part in zip(self.blocks, self.projected, strict=True):
            left = np.abs(part.left) / np.where(block.weight > 0.0, block.weight, np.inf)
            rows = block.rows
            share = left / np.maximum(rows.size, 1e-300) * (0.5 if rows.power else 1.0)
            counts = rows.linear_size > NUMBERS.matters_share * rows.linear_size.max()
            if clear:
                counts &= left > NUMBERS.clear_sigmas * block.noise * rows.error
            yield np.where(counts, share, 0.0)

    def saves(self, less: Fitted) -> float:
        """What the poles save of twice the negative log likelihood over ``less``, as of the freedom that is left."""
        saved = self.prior.misfit(less.poles) - self.prior.misfit(self.poles)
        pairs = zip(less.blocks, less.projected, self.blocks, self.projected, strict=True)
        for before, few, after, many in pairs:
            share = max(many.degrees_of_freedom, 0) / after.rows.numbers
            saved += (deviance_of(before, few) - deviance_of(after, many)) * share
        return saved


def _refitted_with(block: Block, poles: Poles, frequency_hz: float) -> Block:
    """``block`` with law and signs told anew where a pole that is new among ``poles``, at ``frequency_hz``, hid them.

    Signs stay as they are, or turn at that frequency: what the poles fit better.
    """
    passed = block.rows.ends_hz[0] < frequency_hz < block.rows.ends_hz[1]
    if passed and block.rows.sign_free:
        sign = np.where(block.rows.frequency_hz > frequency_hz, -1.0, 1.0)  # a resonance there turns the phase
        both = [with_scatter(choice, poles) for choice in (block, block.turned(sign))]
        block = min(both, key=lambda pair: deviance_of(*pair))[0]
    if block.scatter <= NUMBERS.well_laid_scatter or not passed:
        return with_bent_law(block, poles)
    return with_best_law(block, poles)


def _starts(blocks: Sequence[Block]) -> Poles:
    """Poles to start from, as far as the rows of any of ``blocks`` reach."""
    low, high = min(block.rows.ends_hz[0] for block in blocks), max(block.rows.ends_hz[1] for block in blocks)
    counts = [max(2, int(np.ceil(np.log(1.06 * high / low) / zeta))) for zeta in TRIED_DAMPING]
    frequency = np.concatenate([np.geomspace(0.97 * low, 1.03 * high, count) for count in counts])
    return Poles(frequency, np.repeat(TRIED_DAMPING, counts), np.zeros(len(frequency), dtype=bool))


def _more(state: Fitted, tried: Poles, *, chance: float, most_damping: float) -> tuple[Fitted | None, int]:
    """``state`` with one or a few poles more, or None where none is asked for; and how many starts were followed.

    Where one does not save enough others are tried with it: each may hide in what they leave.
    """
    more, followed = state, 0
    for number in range(1, NUMBERS.most_at_once + 1):
        if number > AT_ONCE and more.misses < ORDER_MODES.felt_share:
            break
        trial, starts = _one_more(more, tried, most_damping=most_damping)
        followed += starts
        if trial is None:
            break
        more = trial
        enough = more.saves(state) > _limit(more.blocks, chance, number)
        if enough and more.accounts_for(state) > ORDER_MODES.felt_share:
            return more, followed
    return None, followed


def _one_more(state: Fitted, tried: Poles, *, most_damping: float) -> tuple[Fitted | None, int]:
    """``state`` with the one pole more that saves most, None where no start promises anything; and starts followed."""
    gains = _gains(state, tried)
    best, most, followed = None, 0.0, 0
    promising = NUMBERS.promising_share * _limit(state.blocks, 1.0)
    while followed < TRIED_STARTS:
        at = int(np.argmax(gains))
        if not gains[at] > promising:
            break
        f, zeta = float(tried.frequency_hz[at]), float(tried.damping[at])
        gains[np.abs(np.log(tried.frequency_hz / f)) < 2.0 * zeta] = 0.0
        trial, followed = state.with_pole((f, zeta)), followed + 1
        saved, (new_hz, new_damping) = trial.saves(state), trial.poles.values[len(state.poles)]
        inside = tried.frequency_hz.min() <= new_hz <= tried.frequency_hz.max() and new_damping <= most_damping
        if saved > most and inside:
            best, most = trial, saved
    return None if best is None else best.moved(), followed


def _gains(state: Fitted, tried: Poles) -> Floats:
    """What a pole at each start would save, beyond what noise saves, summed over orders and channels."""
    total = np.zeros(len(tried.frequency_hz))
    for block, part in zip(state.blocks, state.projected, strict=True):
        rows = block.rows
        if rows.fewest < NUMBERS.fewest_rows or part.degrees_of_freedom < 4:
            continue
        low, high = rows.ends_hz
        near = np.flatnonzero((tried.frequency_hz > 0.97 * low) & (tried.frequency_hz < 1.03 * high))
        settled = block.scatter < NUMBERS.felt_error_share
        if settled:
            block = block.varied(scatter=NUMBERS.felt_error_share)
        elif block.scatter > NUMBERS.well_laid_scatter and rows.fewest > 4 * NUMBERS.fewest_rows:
            block = replace(block, degree=ORDER_RESPONSES.most_degree)  # a peak may have hidden how the force grows
        if rows.sign_free and not settled:
            block = block.squared  # signs without the pole may have turned its phase away
        rows, part = block.rows, project(block, state.poles)
        natural = tried.frequency_hz[near]
        # as wide as a sweep makes a resonance look
        columns = block.modal(natural, np.maximum(tried.damping[near], rows.blur_hz / natural))
        degrees_of_freedom = max(part.degrees_of_freedom / len(rows.channels) - 2.0, 0.0)
        explained = _explained(columns, block.weight, part, rows.columns_per_mode)
        left = np.maximum(np.sum(np.abs(part.left) ** 2, axis=1), 1e-300)[:, None]
        gain = explained if settled else -degrees_of_freedom * np.log1p(-np.minimum(explained / left, 1.0 - 1e-9))
        total[near] += np.maximum(gain - NUMBERS.expected_gain, 0.0).sum(axis=0)
    return total


def _explained(columns: Complexes, weight: Floats, part: Projected, per: int) -> Floats:
    """Squares (C, S) of what is left of each channel of a ``part`` that each ``per`` neighbours of ``columns`` explain.

    These (K, S · per), times ``weight`` (C, K), count as far as they are beyond the basis of the part.
    """
    seen = (np.swapaxes(part.basis, 1, 2).conj() * weight[:, None]) @ columns
    whole, along = weight**2 @ np.abs(columns) ** 2, (part.left.conj() * weight) @ columns
    norm = np.maximum(whole - np.sum(np.abs(seen) ** 2, axis=1), 1e-9 * whole + 1e-300)
    explained = np.abs(along[:, ::per]) ** 2 / norm[:, ::per]
    if per == 1:
        return np.asarray(explained)
    both = weight**2 @ (columns[:, ::2].conj() * columns[:, 1::2])
    both -= (seen[..., ::2].conj() * seen[..., 1::2]).sum(axis=1)
    rest = np.maximum(norm[:, 1::2] - np.abs(both) ** 2 / norm[:, ::2], 1e-6 * norm[:, 1::2])
    return np.asarray(explained + np.abs(along[:, 1::2] - along[:, ::2] * both / norm[:, ::2]) ** 2 / rest)


def _moved(joint: Blocks, free: Poles, prior: Prior) -> Poles:
    """``free`` poles where ``joint`` and ``prior`` agree best, by Levenberg–Marquardt steps in ln f and ln ζ."""

    def normal(poles: Poles) -> tuple[Floats, Floats]:
        """Normal matrix (2 M, 2 M) and right side (2 M,)."""
        jacobians, residuals = joint.evaluate(poles)
        by_prior = np.eye(prior.error.size, 2 * len(poles)) / prior.error.reshape(-1, 1)
        slopes, left = np.concatenate([*jacobians, by_prior]), np.concatenate([*residuals, prior.left(poles)])
        return slopes.T @ slopes, slopes.T @ left

    factor, least = 1e-2, np.minimum(NUMBERS.least_damping, free.damping)
    (hessian, slope), cost = normal(free), joint.misfit(free) + prior.misfit(free)
    for _ in range(STEPS):
        scale = np.maximum(np.diag(hessian), 1e-9 * np.trace(hessian) + 1e-300)
        by = np.linalg.solve(hessian + factor * np.diag(scale), slope).reshape(-1, 2)
        shift = np.clip(by[:, 0], -2.0 * free.damping, 2.0 * free.damping)
        damping = np.clip(free.damping * np.exp(np.clip(by[:, 1], -0.7, 0.7)), least, 0.6)
        trial = Poles(free.frequency_hz * np.exp(shift), damping, free.tone)
        gained = cost - joint.misfit(trial) - prior.misfit(trial)
        if gained >= 0.0:
            free, cost, factor = trial, cost - gained, max(0.2 * factor, 1e-6)
            if gained < SETTLED:
                break
            hessian, slope = normal(free)
        else:
            factor *= 8.0
            if factor > 1e4:
                break
    return free


def _limit(blocks: Sequence[Block], chance: float, number: int = 1) -> float:
    """What a ``number`` of poles save by ``chance`` at any of the starts.

    Each has two numbers of its own and two for each order and channel.
    """
    degrees_of_freedom = number * (2.0 + 2.0 * sum(len(block.rows.channels) for block in blocks))
    return float(chdtri(degrees_of_freedom, chance / NUMBERS.independent_trials**number))


def _pruned(state: Fitted, *, chance: float) -> Fitted:
    """Without the poles that the others have made idle; those with a prior stay.

    One within the width of another is idle too if that one and the laws of the forces can make up for it.
    """
    first = number = len(state.prior.place)
    while number < len(state.poles):
        fewer, needed = _without(state, number, chance=chance)
        if needed and _is_beside(state.poles, number):
            blocks = [with_best_law(block, fewer.poles) for block in state.blocks]
            fewer = Fitted.of(blocks, fewer.poles, state.prior).moved()
            needed = state.saves(fewer) > _limit(state.blocks, chance)
        if needed:
            number += 1
        else:
            state, number = fewer, first
    return state


def _without(state: Fitted, number: int, *, chance: float) -> tuple[Fitted, bool]:
    """``state`` without pole ``number``, and whether that fits worse than noise lets it."""
    fewer = Fitted.of(state.blocks, state.poles.without(number), state.prior)
    felt = state.accounts_for(fewer) > ORDER_MODES.felt_share
    return fewer, felt and state.saves(fewer) > _limit(state.blocks, chance)


def _is_beside(poles: Poles, number: int) -> bool:
    """Whether pole ``number`` and another one lie within the widths of both."""
    apart = np.abs(np.log(poles.frequency_hz / poles.frequency_hz[number]))
    apart[number] = np.inf
    return bool((apart < np.minimum(poles.damping, poles.damping[number])).any())


ORDER_MODES = MethodNumbers("5-identify-modal.toml", "order_modes")


class Proof(NamedTuple):
    """The ``orders`` that by themselves prove a mode, by amplitude and phase.

    ``most_rows`` is the largest number of rows of one of them within some widths of it, ``rows`` that of all of them,
    ``span_hz`` the lowest and highest frequency that they reached; ``located`` is how many of them find it at the same
    place, each alone, within a part of its width; ``passed`` are those that sweep through it: what is told from afar
    may be another mode. ``flanked`` are those whose rows on both sides, without the ones at the peak, ask for the mode
    where these show it.
    """

    orders: tuple[float, ...] = ()
    most_rows: int = 0
    rows: int = 0
    span_hz: tuple[float, float] = (0.0, 0.0)
    located: int = 0
    passed: tuple[float, ...] = ()
    flanked: tuple[float, ...] = ()


class OrderPole(NamedTuple):
    """A pole that orders ask for: ``frequency_hz``, ``damping``, the ``channels`` that show it and its ``proof``."""

    frequency_hz: float
    damping: float
    channels: tuple[str, ...]
    proof: Proof


def named(blocks: Sequence[Block], projected: Sequence[Projected], poles: Poles, number: int) -> OrderPole:
    """Pole ``number`` of ``poles`` with the orders that prove it; ``blocks`` as ``projected`` with all poles."""
    f, zeta = poles.values[number].tolist()
    reach = ORDER_MODES.within_widths * zeta
    rows: dict[float, int] = {}
    ends: list[float] = []
    shown: list[str] = []
    located, passed, flanked = set[float](), set[float](), set[float]()
    for block, part in zip(blocks, projected, strict=True):
        seen, shows = block.rows, residue_chances(block, part, number) <= ORDER_MODES.proof_chance
        if not block.tells or not shows.any():
            continue
        shown += np.array(seen.channels)[shows].tolist()
        within = int(np.count_nonzero(np.abs(seen.frequency_hz / f - 1.0) <= reach))
        rows[seen.order] = max(within, rows.get(seen.order, 0))
        ends += seen.ends_hz
        if (1.0 - reach) * seen.ends_hz[0] <= f <= (1.0 + reach) * seen.ends_hz[1]:
            passed.add(seen.order)
            # the block alone finds the pole where it is: one step from there is small, and its error too
            step, error = _step(block, part, poles, number)
            if error <= ORDER_MODES.located_widths * zeta and abs(step) <= ORDER_MODES.agrees_sigmas * error:
                located.add(seen.order)
            if flanks_show(block, poles, number):
                flanked.add(seen.order)
    if not rows:
        return OrderPole(f, zeta, (), Proof())
    orders, passing, by_flanks = (tuple(sorted(some)) for some in (rows, passed, flanked))
    span = min(ends), max(ends)
    proof = Proof(orders, max(rows.values()), sum(rows.values()), span, len(located), passing, by_flanks)
    return OrderPole(f, zeta, tuple(dict.fromkeys(shown)), proof)


def _step(block: Block, part: Projected, poles: Poles, number: int) -> tuple[float, float]:
    """Step in ln f by which ``block`` alone would move pole ``number``, and its error; infinite where it cannot say."""
    if part.degrees_of_freedom < 2 or number not in part.reached:
        return np.inf, np.inf
    slopes = jacobian(block, poles, part)[:, 2 * number : 2 * number + 2]
    information = slopes.T @ slopes
    if np.linalg.cond(information) > 1e12:
        return np.inf, np.inf
    inverse = np.linalg.inv(information)
    step = float((inverse @ slopes.T @ as_real(part.left, block))[0])
    return step, float(np.sqrt(inverse[0, 0] * part.beyond_errors))


def flanks_show(block: Block, poles: Poles, number: int) -> bool:
    """Whether at held speeds the flanks of pole ``number`` of ``poles`` in ``block`` prove it without its peak.

    A force that differs at one speed or two makes a peak, but no flanks: a resonance adds 1 / (f² − ν²) to an order on
    both sides, far beyond its width, with the other sign above it (Ewins 2000, §2.4). Rows within some widths, and the
    nearest ones, are left out; what is left must ask for the mode, and place it among those. Squares have
    no sign and prove nothing so.
    """
    if block.rows.power:
        return False
    apart = block.rows.frequency_hz / float(poles.frequency_hz[number]) - 1.0
    away = np.abs(apart)
    nearest = float(np.sort(away)[ORDER_MODES.peak_rows - 1 : ORDER_MODES.peak_rows].sum())
    reach = max(ORDER_MODES.within_widths * float(poles.damping[number]), nearest)
    at_peak = away <= reach
    if min(np.count_nonzero(~at_peak & side) for side in (apart < 0.0, apart > 0.0)) < ORDER_MODES.fewest_flank:
        return False
    flanks = replace(block, rows=replace(block.rows, error=np.where(at_peak, np.inf, block.rows.error)))
    part = project(flanks, poles)
    if not (residue_chances(flanks, part, number) <= ORDER_MODES.proof_chance).any():
        return False
    step, error = _step(flanks, part, poles, number)
    return bool(Z95 * error <= reach and abs(step) <= ORDER_MODES.agrees_sigmas * error)


def residue_chances(block: Block, part: Projected, number: int) -> Floats:
    """Chances (C,) that the residue of pole ``number`` in ``block`` is so large without the mode (F test).

    ``part``: the block as projected.
    """
    place = np.flatnonzero(part.reached == number)
    size, per = len(block.rows.channels), block.rows.columns_per_mode
    if not len(place) or part.degrees_of_freedom < size:
        return np.ones(size)
    at = block.degree + 1 + per * int(place[0]) + np.arange(per)
    value, spread = part.linear[:, at], part.covariance[:, at[:, None], at]
    squared = np.einsum("ci,cij,cj->c", value.conj(), np.linalg.pinv(spread, hermitian=True), value).real
    return np.asarray(fdtrc(2.0, part.degrees_of_freedom / size, squared / 2.0 / part.beyond_errors))


def order_pole_covariance(blocks: Sequence[Block], parts: Sequence[Projected], poles: Poles, *, fixed: int) -> Floats:
    """Covariance of (f_1, ζ_1, f_2, …) of the ``poles`` after the ``fixed`` ones, which ``blocks`` tell.

    Curvature, and scores as they are seen to scatter (White 1982). Channels are correlated, and so are speeds side by
    side where the law of a force is not quite that of the fit: the scores of neighbours count together (Newey and West
    1987). Where a mode beside is missing, or one stands for two, each order and channel asks for a pole of its own, by
    its share in them: the scores of each count together (Liang and Zeger 1986). Each where that makes more of them.
    ``parts`` are the blocks as projected with the poles.
    """
    own = slice(2 * fixed, 2 * len(poles))
    size = own.stop - own.start
    orders: list[Cell] = []
    alone: list[Cell] = []
    inner, beside = np.zeros((size, size)), np.zeros((size, size))
    for block, part in zip(blocks, parts, strict=True):
        if not block.tells or part.degrees_of_freedom < 1:
            continue
        seen = block.rows
        rows = jacobian(block, poles, part)[:, own].reshape(seen.parts, *seen.amplitude.shape, size)
        spare = seen.parts * int(seen.counts.sum()) / part.degrees_of_freedom
        left = np.stack([part.left.real] if seen.power else [part.left.real, part.left.imag])
        norm = np.maximum(np.linalg.norm(part.left, axis=1), 1e-300)
        alike = (part.left @ part.left.conj().T).real / np.outer(norm, norm)
        inner += np.einsum("cd,pcki,pdkj->ij", alike, rows, rows)
        hessian, score = np.einsum("pcki,pckj->cij", rows, rows), np.einsum("pcki,pck->ci", rows, left * np.sqrt(spare))
        alone += map(Cell, hessian, score)
        orders.append(Cell(np.sum(hessian, axis=0), np.sum(score, axis=0)))
        scores = np.einsum("pcki,pck->ki", rows, left)[np.argsort(seen.speed_rpm)]
        reach = min(len(scores) - 1, round(len(scores) ** (1.0 / 3.0)))
        beside += spare * neighbours_together(scores, reach)
    if not orders:
        return np.zeros((size, size))
    curved = np.sum([cell.hessian for cell in orders], axis=0)
    inverse = np.asarray(np.linalg.pinv(curved, hermitian=True), dtype=np.float64)
    covariance = inverse @ inner @ inverse
    known = np.asarray(np.maximum(np.diag(covariance), 1e-300), dtype=np.float64)
    scale = poles.values.ravel()[own]
    more = np.sqrt(np.maximum(np.diag(inverse @ beside @ inverse) / known, 1.0))
    for cells in (orders, alone):
        more = np.maximum(more, disagreement(cells, inverse, known))
    return np.asarray(covariance * np.outer(scale * more, scale * more))
