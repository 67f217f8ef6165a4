"""Natural frequencies that orders tell by amplitude and phase over the speeds, whether or not the floor shows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.modal.order_responses import (
    LEAST_SCATTER,
    MOST_DEGREE,
    MOST_SCATTER,
    Block,
    Blocks,
    Projected,
    missed,
    project,
    with_bent_law,
    with_best_law,
    with_scatter,
)
from crankorder.identify.modal.pole_errors import order_pole_covariance
from crankorder.identify.modal.surface_fit import NO_POLES, Poles

MOST_POLES = 12
"""Poles that are looked for at most."""

TRIED_DAMPING = (0.003, 0.01, 0.03, 0.1)
"""Damping ratios that are tried as a start; frequencies lie as far apart as each is wide."""

NEXT_TO = 0.015
"""Share of a frequency within which a row lies next to it."""

RISES = 2.0
"""Amplitude over that on both sides from which an order rises."""

LIGHT = (0.001, 0.003, 0.01)
"""Damping ratios of a mode that may be taken for a tone."""

TRIED_STARTS = 3
"""Best starts that are followed."""

MOST_BLOCKS = 24
"""Orders, in each recording of a sweep, that are asked for poles: those that stand out most."""

CLEARLY = 3.0
"""Standard errors of a row beyond which what is left of it is no noise."""

MATTERS = 0.03
"""Share of an order's largest amplitude below which no row tells of a pole alone."""

FELT = 0.05
"""Share of an order's amplitude that a pole must account for somewhere: less is what no model is good for."""

AT_ONCE = 2
"""Poles that are asked for together at most."""

TRIALS = 400.0
"""Frequencies and damping ratios that are independent of one another, about."""

PROMISING = 0.2
"""Share of what chance saves at one of all starts by which a start is worth a trial."""

EXPECTED_GAIN = 6.0
"""What noise alone may save at a start in one channel."""

WELL_LAID = 0.01
"""Relative scatter up to which the law of a force needs no new look."""

HOPELESS = 1.0
"""Relative scatter beyond which no small move of the poles helps."""

WITHIN = 4.0
"""Half-power half widths within which a row belongs to a resonance."""

FEWEST_ROWS = 6
"""Rows of an order without which it is asked for nothing new."""

LEAST_DAMPING = 1e-3
"""Smallest damping ratio that is looked for."""

SETTLED = 0.05
"""Square of a standard error that a step must gain to be followed by another."""

MODEL_SHARE = 0.1
"""Share of its width by which the floor may err in a pole beyond its own errors, and of its damping."""

ROWS_OF_SWEEP = 5
"""Rows that a sweep through a whole resonance is worth at least: its filter smooths them into fewer."""

STEPS = 12
"""Steps of a fit at most."""

PROOF_CHANCE = 1e-4
"""Chance of so large a residue of one order without the mode, below which the order proves it."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Proof:
    """The ``orders`` that by themselves prove a mode, by amplitude and phase.

    ``most_rows`` is the largest number of rows of one of them within some widths of it, ``rows`` that of all of them,
    ``span_hz`` the lowest and highest frequency that they reached.
    """

    orders: tuple[float, ...] = ()
    most_rows: int = 0
    rows: int = 0
    span_hz: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class OrderPole:
    """A pole that orders ask for: ``frequency_hz``, ``damping``, the ``channels`` that show it and its ``proof``."""

    frequency_hz: float
    damping: float
    channels: tuple[str, ...]
    proof: Proof


@dataclass(frozen=True, eq=False)
class Prior:
    """What the floor says of the first poles: ``place`` (P, 2), their ln f and ln ζ, with its ``error`` (P, 2)."""

    place: Array
    error: Array

    @classmethod
    def of(cls, poles: Poles, covariance: Array) -> Prior:
        """Of ``poles`` whose (f_1, ζ_1, f_2, …) have the ``covariance`` (2 P, 2 P)."""
        place = np.log(np.stack([poles.frequency_hz, poles.damping], axis=1))
        spread = np.sqrt(np.maximum(np.diag(covariance).reshape(-1, 2), 0.0)) / np.exp(place)
        # what the floor takes for random may have rung from a start: its widths are not believed further
        least = np.stack([MODEL_SHARE * poles.damping, np.full(len(poles), MODEL_SHARE)], axis=1)
        return cls(place, np.hypot(spread, least))

    def rows(self, poles: Poles) -> tuple[Array, Array]:
        """Jacobian (2 P, 2 M) and residual (2 P,) of ``poles``, of which these are the first."""
        count = len(self.place)
        now = np.log(np.stack([poles.frequency_hz, poles.damping], axis=1))[:count]
        slopes = np.zeros((2 * count, 2 * len(poles)))
        slopes[np.arange(2 * count), np.arange(2 * count)] = 1.0 / self.error.ravel()
        return slopes, ((self.place - now) / self.error).ravel()

    def misfit(self, poles: Poles) -> float:
        """Sum of the squares by which ``poles`` differ from it."""
        return float(np.sum(self.rows(poles)[1] ** 2))


NO_PRIOR = Prior(np.zeros((0, 2)), np.zeros((0, 2)))


def poles_of_orders(
    blocks: Sequence[Block], known: Poles, covariance: Array, *, chance: float, most_damping: float
) -> tuple[tuple[Block, ...], tuple[OrderPole, ...]]:
    """``blocks`` with their laws and scatter, and the poles beyond the ``known`` ones that they ask for.

    One pole after the other is taken where it explains most that is left of all orders and channels, and moved with all
    others to where the likelihood is largest, the known ones within their ``covariance`` (of f_1, ζ_1, f_2, …). Those
    are kept in the end that save more than the false-alarm level ``chance`` would let noise save at any of the
    frequencies tried: while others are missing, what one explains hides in what they leave. ``most_damping`` is the
    largest damping ratio. Each order has the scatter that is left of it, so that a force which only varies from speed
    to speed makes no pole.
    """
    if not blocks:
        return (), ()
    prior = Prior.of(known, covariance)
    blocks = sorted(blocks, key=lambda block: -float(np.max(block.size / block.error)))[:MOST_BLOCKS]
    state = Fitted.of([with_best_law(block, known) for block in blocks], known, prior)
    if len(known):
        state = state.moved()
    tried = Tried.of(blocks)
    while len(state.poles) - len(known) < MOST_POLES:
        more = _more(state, tried, chance=chance, most_damping=most_damping)
        if more is None:
            break
        state = more
    state = _pruned(state, chance=chance)
    named = [_named(state, number) for number in range(len(known), len(state.poles))]
    return state.blocks, tuple(item for item in named if item.proof.rows > 1)


def settled(
    blocks: Sequence[Block], known: Poles, found: Sequence[OrderPole]
) -> tuple[tuple[Block, ...], tuple[Proof, ...], tuple[OrderPole, ...], Array]:
    """``blocks``, proofs of the ``known`` poles, the ``found`` ones moved once more behind them, and their covariance.

    The covariance (2 M, 2 M) is that of (f_1, ζ_1, f_2, …), lowest first. Channels share what an order's force varies
    by: their residuals are as alike as they are seen to be.
    """
    free = NO_POLES
    for item in found:
        free = free.with_pole(item.frequency_hz, item.damping)
    state = Fitted.of(blocks, known.joined(free), NO_PRIOR)
    if len(free):
        state = state.moved(fixed=len(known))
    named = [_named(state, number) for number in range(len(state.poles))]
    proofs = tuple(item.proof for item in named[: len(known)])
    covariance = order_pole_covariance(state.blocks, state.projected, state.poles, fixed=len(known))
    return state.blocks, proofs, tuple(named[len(known) :]), covariance


def _independent_share(part: Projected) -> float:
    """Share of the rows of a sweep that are independent: what is left of them may have a memory, as of its angle."""
    left = part.left
    total = float(np.sum(np.abs(left) ** 2))
    memory = abs(complex(np.sum(left[:, 1:] * left[:, :-1].conj()))) / max(total, 1e-300)
    return float(max((1.0 - memory) / (1.0 + memory), 1.0 / left.shape[1]))


@dataclass(frozen=True, eq=False)
class Fitted:
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
        good = tuple(block for block in self.blocks if block.scatter <= HOPELESS)
        if not good:
            return self
        number = np.arange(len(self.poles))
        still, free = self.poles.chosen(number < fixed), self.poles.chosen(number >= fixed)
        poles = still.joined(_moved(Blocks(good, still), free, NO_PRIOR if fixed else self.prior))
        return Fitted.of([with_bent_law(block, poles) for block in self.blocks], poles, self.prior)

    def with_pole(self, start: tuple[float, float]) -> Fitted:
        """With one pole more, near a ``start`` (Hz, damping ratio), the others staying where they are."""
        more = self.poles.joined(NO_POLES.with_pole(*start))
        return Fitted.of([self._told(block, more) for block in self.blocks], more, self.prior).moved(
            fixed=len(self.poles)
        )

    @staticmethod
    def _told(block: Block, poles: Poles) -> Block:
        """``block`` with its law told anew where the ``poles`` may have hidden it."""
        if block.scatter <= WELL_LAID or block.passage is not None:
            return with_bent_law(block, poles)  # the rows of a sweep are many: a step does
        return with_best_law(block, poles)

    @property
    def misses(self) -> float:
        """Largest share of an order's amplitude that the poles leave of any row, far over its noise."""
        worst = 0.0
        for block, part in zip(self.blocks, self.projected, strict=True):
            left = np.abs(part.left) / np.where(block.weight > 0.0, block.weight, np.inf)
            size = np.sqrt(block.size) if block.power else block.size
            share = np.where(left > CLEARLY * block.noise * block.error, left / np.maximum(block.size, 1e-300), 0.0)
            share *= 0.5 if block.power else 1.0
            worst = max(worst, float(np.max(np.where(size > MATTERS * size.max(), share, 0.0))))
        return worst

    def saves(self, less: Fitted) -> float:
        """What the poles save of twice the negative log likelihood over ``less``, as of the freedom that is left."""
        saved = self.prior.misfit(less.poles) - self.prior.misfit(self.poles)
        pairs = zip(less.blocks, less.projected, self.blocks, self.projected, strict=True)
        for before, few, after, many in pairs:
            if (after.scatter, after.noise) == (before.scatter, before.noise) == (LEAST_SCATTER, 1.0):
                saved += few.chi2 - many.chi2  # nothing but known errors
                continue
            share = max(many.freedom, 0) / (after.parts * int(after.rows.sum()))
            if after.passage is not None:
                share *= _independent_share(many)
            saved += (missed(before, few) - missed(after, many)) * share
        return saved


@dataclass(frozen=True, eq=False)
class Tried:
    """Starts for a pole: ``frequency_hz`` and ``damping`` (S,)."""

    frequency_hz: Array
    damping: Array

    @classmethod
    def of(cls, blocks: Sequence[Block]) -> Tried:
        """Starts as far as the rows of any of ``blocks`` reach."""
        low = min(float(block.frequency_hz.min()) for block in blocks)
        high = max(float(block.frequency_hz.max()) for block in blocks)
        counts = [max(2, int(np.ceil(np.log(1.06 * high / low) / zeta))) for zeta in TRIED_DAMPING]
        frequency = [np.geomspace(0.97 * low, 1.03 * high, count) for count in counts]
        return cls(np.concatenate(frequency), np.repeat(TRIED_DAMPING, counts))

    @classmethod
    def near(cls, frequency_hz: float) -> Tried:
        """Light resonances at ``frequency_hz``."""
        return cls(np.full(len(LIGHT), frequency_hz), np.array(LIGHT))


def _more(state: Fitted, tried: Tried, *, chance: float, most_damping: float) -> Fitted | None:
    """``state`` with one or two poles more, or None where none is asked for.

    Where one does not save enough a second one is tried with it: each may hide in what the other leaves.
    """
    more = state
    for number in range(1, AT_ONCE + 1):
        trial = _one_more(more, tried, most_damping=most_damping)
        if trial is None:
            return None
        more = trial
        if more.saves(state) > number * _limit(more.blocks, chance / TRIALS):
            return more
    return None


def _one_more(state: Fitted, tried: Tried, *, most_damping: float) -> Fitted | None:
    """``state`` with the one pole more that saves most; None where no start promises anything."""
    gains = _gains(state, tried)
    best, most = None, 0.0
    promising = PROMISING * _limit(state.blocks, 1.0 / TRIALS)
    for _ in range(TRIED_STARTS):
        at = int(np.argmax(gains))
        if not gains[at] > promising:
            break
        f, zeta = float(tried.frequency_hz[at]), float(tried.damping[at])
        gains[np.abs(np.log(tried.frequency_hz / f)) < 2.0 * zeta] = 0.0
        trial = state.with_pole((f, zeta))
        saved = trial.saves(state)
        if saved > most and not moved_out(
            trial.poles.chosen(np.arange(len(trial.poles)) == len(state.poles)), tried, most_damping
        ):
            best, most = trial, saved
    return None if best is None else best.moved()


def orders_raised(blocks: Sequence[Block], poles: Poles, frequency_hz: float) -> tuple[float, ...]:
    """Orders of ``blocks`` that rise where they pass ``frequency_hz``.

    More than noise beside the ``poles`` makes them, with a light resonance tried there; or to twice what they are on
    both sides, where rows are too far apart for that.
    """
    from scipy.special import chdtri

    tried = Tried.near(frequency_hz)
    found = []
    for block in blocks:
        gains = _gains(Fitted.of((block,), poles, NO_PRIOR), tried)
        proven = float(gains.max()) > float(chdtri(2.0 + 2.0 * len(block.channels), PROOF_CHANCE))
        if proven or _stands_out(block, frequency_hz):
            found.append(block.order)
    return tuple(dict.fromkeys(found))


def _stands_out(block: Block, frequency_hz: float) -> bool:
    """Whether ``block`` is twice as large next to ``frequency_hz`` as on both sides, in any channel."""
    away = np.abs(block.frequency_hz / frequency_hz - 1.0)
    near = np.flatnonzero(away <= NEXT_TO)
    if not len(near):
        return False
    below = np.flatnonzero(block.frequency_hz < frequency_hz * (1.0 - NEXT_TO))
    above = np.flatnonzero(block.frequency_hz > frequency_hz * (1.0 + NEXT_TO))
    sides = [side[np.argmin(away[side])] for side in (below, above) if len(side)]
    if len(sides) < 2:
        return False
    size = np.sqrt(np.abs(block.amplitude)) if block.power else np.abs(block.amplitude)
    return bool((size[:, near].max(axis=1) > RISES * size[:, sides].max(axis=1)).any())


def moved_out(poles: Poles, tried: Tried, most_damping: float) -> bool:
    """Whether any of ``poles`` left the frequencies ``tried``, or is damped by more than ``most_damping``."""
    low, high = float(tried.frequency_hz.min()), float(tried.frequency_hz.max())
    outside = (poles.frequency_hz < low) | (poles.frequency_hz > high) | (poles.damping > most_damping)
    return bool(outside.any())


def _gains(state: Fitted, tried: Tried) -> Array:
    """What a pole at each start would save, beyond what noise saves, summed over orders and channels.

    The steady response stands for that of a sweep here: it only has to find the start.
    """
    total = np.zeros(len(tried.frequency_hz))
    for block, part in zip(state.blocks, state.projected, strict=True):
        if block.rows.min() < FEWEST_ROWS or part.freedom < 4:
            continue
        low, high = float(block.frequency_hz.min()), float(block.frequency_hz.max())
        near = np.flatnonzero((tried.frequency_hz > 0.97 * low) & (tried.frequency_hz < 1.03 * high))
        if block.scatter > WELL_LAID and block.rows.min() > 4 * FEWEST_ROWS:
            # a peak may have hidden how the force grows
            block = replace(block, degree=MOST_DEGREE)
            part = project(block, state.poles)
        still = replace(block, passage=None)
        columns = still.modal(tried.frequency_hz[near], _widened(block, tried, near))
        freedom = part.freedom / len(block.channels)
        for weight, basis, left in zip(block.weight, part.basis, part.left, strict=True):
            made = columns * weight[:, None]
            made -= basis @ (basis.conj().T @ made)
            along = np.abs(left.conj() @ made) ** 2 / np.maximum(np.sum(np.abs(made) ** 2, axis=0), 1e-300)
            along = along.reshape(len(near), block.columns_per_mode).sum(axis=1)
            share = np.minimum(along / max(float(np.sum(np.abs(left) ** 2)), 1e-300), 1.0 - 1e-9)
            total[near] += np.maximum(-freedom * np.log1p(-share) - EXPECTED_GAIN, 0.0)
    return total


def _widened(block: Block, tried: Tried, near: NDArray[np.int64]) -> Array:
    """Damping ratios of the starts ``near``, as wide as a sweep makes a resonance look."""
    damping = tried.damping[near]
    if block.passage is None:
        return np.asarray(damping)
    rate = float(np.median(np.abs(np.gradient(block.passage.frequency_hz, block.passage.step_s))))
    return np.asarray(np.maximum(damping, 0.5 * np.sqrt(rate) / tried.frequency_hz[near]))


def _moved(joint: Blocks, free: Poles, prior: Prior) -> Poles:
    """``free`` poles where ``joint`` and ``prior`` agree best, by Levenberg–Marquardt steps in ln f and ln ζ."""
    factor = 1e-2
    least = np.minimum(LEAST_DAMPING, free.damping)
    jacobians, residuals, cost = _evaluated(joint, free, prior)
    for _ in range(STEPS):
        hessian = sum((j.T @ j for j in jacobians), np.zeros((2 * len(free),) * 2))
        slope = sum((j.T @ r for j, r in zip(jacobians, residuals, strict=True)), np.zeros(2 * len(free)))
        scale = np.maximum(np.diag(hessian), 1e-9 * np.trace(hessian) + 1e-300)
        by = np.linalg.solve(hessian + factor * np.diag(scale), slope).reshape(-1, 2)
        shift = np.clip(by[:, 0], -2.0 * free.damping, 2.0 * free.damping)
        damping = np.clip(free.damping * np.exp(np.clip(by[:, 1], -0.7, 0.7)), least, 0.6)
        trial = Poles(free.frequency_hz * np.exp(shift), damping, free.tone)
        gained = cost - joint.misfit(trial) - prior.misfit(trial)
        if gained >= 0.0:
            free = trial
            factor = max(0.2 * factor, 1e-6)
            if gained < SETTLED:
                break
            jacobians, residuals, cost = _evaluated(joint, free, prior)
        else:
            factor *= 8.0
            if factor > 1e4:
                break
    return free


def _evaluated(joint: Blocks, poles: Poles, prior: Prior) -> tuple[list[Array], list[Array], float]:
    jacobians, residuals, cost = joint.evaluate(poles)
    slopes, left = prior.rows(poles)
    return [*jacobians, slopes], [*residuals, left], cost + float(np.sum(left**2))


def _limit(blocks: Sequence[Block], chance: float) -> float:
    """What a pole saves by ``chance``: two numbers of its own and two for each order and channel."""
    from scipy.special import chdtri

    return float(chdtri(2.0 + 2.0 * sum(len(block.channels) for block in blocks), chance))


def _pruned(state: Fitted, *, chance: float) -> Fitted:
    """Without the poles that the others have made idle; those with a prior stay."""
    number = len(state.prior.place)
    while number < len(state.poles):
        fewer = Fitted.of(state.blocks, state.poles.without(number), state.prior)
        if state.saves(fewer) > _limit(state.blocks, chance / TRIALS) and fewer.misses > FELT:
            number += 1
        else:
            state, number = fewer, len(state.prior.place)
    return state


def _named(state: Fitted, number: int) -> OrderPole:
    """Pole ``number`` with the orders that prove it."""
    poles = state.poles
    f, zeta = float(poles.frequency_hz[number]), float(poles.damping[number])
    rows: dict[float, int] = {}
    ends: list[float] = []
    shown: list[str] = []
    for block, part in zip(state.blocks, state.projected, strict=True):
        chances = residue_chances(block, part, number)
        if block.scatter > MOST_SCATTER or chances.min() > PROOF_CHANCE:
            continue
        shown += [name for name, chance in zip(block.channels, chances, strict=True) if chance <= PROOF_CHANCE]
        within = _rows_within(block, f, zeta)
        rows[block.order] = max(within, rows.get(block.order, 0))
        ends += [float(block.frequency_hz.min()), float(block.frequency_hz.max())]
    if not rows:
        return OrderPole(f, zeta, (), Proof())
    proof = Proof(tuple(sorted(rows)), max(rows.values()), sum(rows.values()), (min(ends), max(ends)))
    return OrderPole(f, zeta, tuple(dict.fromkeys(shown)), proof)


def _rows_within(block: Block, f: float, zeta: float) -> int:
    """How many rows of ``block`` lie within some widths of a pole; a sweep through both its flanks has enough."""
    rows = int(np.count_nonzero(np.abs(block.frequency_hz / f - 1.0) <= WITHIN * zeta))
    low, high = block.frequency_hz.min(), block.frequency_hz.max()
    whole = block.passage is not None and low < f * (1.0 - WITHIN * zeta) and high > f * (1.0 + WITHIN * zeta)
    return max(rows, ROWS_OF_SWEEP) if whole else rows


def residue_chances(block: Block, part: Projected, number: int) -> Array:
    """Chances (C,) that the residue of pole ``number`` in ``block`` is so large without the mode (F test).

    ``part``: the block as projected.
    """
    from scipy.special import fdtrc

    place = np.flatnonzero(part.reached == number)
    if not len(place) or part.freedom < len(block.channels):
        return np.ones(len(block.channels))
    at = block.degree + 1 + block.columns_per_mode * int(place[0]) + np.arange(block.columns_per_mode)
    value, spread = part.linear[:, at], part.covariance[:, at[:, None], at]
    squared = np.einsum("ci,cij,cj->c", value.conj(), np.linalg.pinv(spread, hermitian=True), value).real
    scale = max(part.chi2 / part.freedom, 1.0)
    return np.asarray(fdtrc(2.0, part.freedom / len(block.channels), squared / 2.0 / scale))
