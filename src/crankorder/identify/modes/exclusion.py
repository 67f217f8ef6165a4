"""What the orders do not show: how far a natural frequency that nobody saw could still amplify each of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from crankorder.identify.found import UnseenBound
from crankorder.identify.modes.order_responses import NUMBERS as ORDER_RESPONSES
from crankorder.identify.modes.order_responses import Block, Projected, bent, with_scatter
from crankorder.identify.modes.surface_fit import Poles, Problem
from crankorder.quantities import Floats
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-modal.toml", table="exclusion"):
    tried_damping_ratios: tuple[float, ...]
    matters_share: float
    selective_ratio: float
    shaken_ratio: float
    noise_sigmas: float


NUMBERS = _Numbers.load()

BETWEEN_ROWS = 4
"""Speeds that are asked about between two tested ones."""

ALONG_SWEEP = 160
"""Speeds that are asked about along a sweep."""

SAME_ORDER = 1e-3
"""Share of an order within which another number stands for it."""


def least_seen(
    blocks: Sequence[Block],
    poles: Poles,
    *,
    unit: Mapping[str, str],
    least_damping: float,
    confidence: float,
    floors: Sequence[FloorBound] = (),
    sweeps: Sequence[Hiding] = (),
) -> tuple[UnseenBound, ...]:
    """For each of ``blocks``, how much a mode beside the ``poles`` could amplify its order without being seen.

    At speeds between the tested ones a mode is imagined on the order, damped by ``least_damping`` or some times that;
    its residue is what the data give it, and as much more as they leave open at the ``confidence`` (0 to 1). What it
    adds at its peak, over what is there without it, is the amplification, in the channel that has most of each
    ``unit``. Amplitudes below the noise, or below a small share of the largest of any order, count as so large. An
    order of which the poles leave too much excludes nothing.

    A mode is the structure's: other orders pass it at their own speeds, and what excites the floor does too. It is
    reckoned with that it amplifies one order ``selective_ratio`` times as much as another, or as the ``floors``,
    and no more: what one of them excludes by far is excluded for all. What the signals of ``sweeps`` leave open counts
    where it is less, and of orders that they alone show.
    """
    from scipy.special import chdtri

    reach = float(np.sqrt(chdtri(2.0, 1.0 - confidence)))
    largest = dict.fromkeys(unit.values(), 0.0)
    for block in blocks:
        size = np.sqrt(block.size) if block.power else block.size
        for name, most in zip(block.channels, size.max(axis=1).tolist(), strict=True):
            largest[unit[name]] = max(NUMBERS.matters_share * most, largest.get(unit[name], 0.0))
    along = [(item.order, FloorBound(item.frequency_hz, item.amplification(unit, largest))) for item in sweeps]
    alone = [_less(_bound(block, poles, least_damping, reach, unit, largest), along) for block in blocks]
    have = {block.order for block in blocks}
    more = {order for order, _ in along if all(abs(order - one) >= SAME_ORDER * one for one in have)}
    alone += [_less(UnseenBound(order, np.empty(0), np.empty(0)), along) for order in sorted(more)]
    known = [FloorBound(item.order * item.speed_rpm / 60.0, item.amplification) for item in alone]
    made = []
    for number, item in enumerate(alone):
        others = [bound for k, bound in enumerate(known) if k != number and alone[k].order != item.order]
        hz = item.order * item.speed_rpm / 60.0
        shared = np.min([bound.at(hz) for bound in (*others, *floors)], axis=0, initial=np.inf)
        allowed = 1.0 + NUMBERS.selective_ratio * (shared - 1.0)
        made.append(replace(item, amplification=np.minimum(item.amplification, allowed)))
    return tuple(made)


@dataclass(frozen=True, eq=False)
class Hiding:
    """What a mode that nobody saw could add to ``order`` in its ``channels``, at ``frequency_hz`` (G,), rising.

    ``base`` (C, G) is the amplitude there without it, ``added`` (C, G) the most that it adds unseen, ``noise`` (C, G)
    what is too small to be seen.
    """

    order: float
    frequency_hz: Floats
    channels: tuple[str, ...]
    base: Floats
    added: Floats
    noise: Floats

    def amplification(self, unit: Mapping[str, str], matters: Mapping[str, float]) -> Floats:
        """Largest amplification (G,), in the channel that has most of each ``unit``.

        ``matters``: amplitude, by unit, below which none counts; any does of a unit without one.
        """
        most = np.zeros(self.base.shape[1])
        for name in dict.fromkeys(unit[channel] for channel in self.channels):
            own = np.array([unit[channel] == name for channel in self.channels])
            least = np.maximum(self.noise[own].max(axis=0), matters.get(name, 0.0))
            without = np.maximum(self.base[own].max(axis=0), least)
            most = np.maximum(
                most, np.maximum((self.base + self.added)[own].max(axis=0), least) / np.maximum(without, 1e-300)
            )
        return most


@dataclass(frozen=True, eq=False)
class FloorBound:
    """Largest ``amplification`` (F,) that a mode at ``frequency_hz`` (F,), rising, could have without being seen."""

    frequency_hz: Floats
    amplification: Floats

    def at(self, hz: Floats) -> Floats:
        """That at ``hz`` (G,); infinite where nothing is known."""
        return np.asarray(np.interp(hz, self.frequency_hz, self.amplification, left=np.inf, right=np.inf))

    def worst_about(self, hz: Floats) -> Floats:
        """The largest nearer to each of ``hz`` (G,), rising, than to its neighbours."""
        worst = self.at(hz)
        inside = (self.frequency_hz >= hz[0]) & (self.frequency_hz <= hz[-1])
        nearest = np.searchsorted(0.5 * (hz[1:] + hz[:-1]), self.frequency_hz[inside])
        np.maximum.at(worst, nearest, self.amplification[inside])
        return worst


def floor_bound(
    problem: Problem, model: Floats, *, poles: Poles, least_damping: float, confidence: float
) -> FloorBound | None:
    """What the floor of a band (``problem``, as fitted by ``model`` (C, F)) excludes; None where nothing shakes it.

    Only where a mode among the ``poles`` stands clear of it does what is broadband excite the structure, and would show
    others. A resonance of the damping ``least_damping`` fills a share of a bin; what stands over the model, and as much
    more as its scatter hides at ``confidence``, is its power.
    """
    from scipy.special import ndtri

    clear = [
        float((model[:, at] / np.median(model, axis=1)).max())
        for f in poles.frequency_hz
        if 0 <= (at := int(np.argmin(np.abs(problem.frequency_hz - f)))) < len(problem.frequency_hz)
    ]
    if max(clear, default=0.0) < NUMBERS.shaken_ratio:
        return None
    used = problem.averages > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        over = np.where(used, np.nan_to_num(problem.psd) / model - 1.0, np.inf)
        hidden = np.where(used, float(ndtri(confidence)) / np.sqrt(problem.averages), np.inf)
    best = np.min(np.maximum(over, 0.0) + hidden, axis=0)
    filled = np.minimum(np.pi * least_damping * problem.frequency_hz / problem.seen.bin_hz, 1.0)
    return FloorBound(problem.frequency_hz, np.sqrt(1.0 + best / filled))


def _less(item: UnseenBound, along: Sequence[tuple[float, FloorBound]]) -> UnseenBound:
    """``item``, or what sweeps leave open of its order where that is less: ``along`` holds (order, bound) of each.

    Sweeps tell of speeds too that no row of the order reaches.
    """
    own = [bound for order, bound in along if abs(order - item.order) < SAME_ORDER * item.order]
    speed = item.speed_rpm
    more = np.unique(np.concatenate([60.0 / item.order * bound.frequency_hz for bound in own] or [np.empty(0)]))
    below, above = (more[more < speed[0]], more[more > speed[-1]]) if len(speed) else (more, more[:0])
    speed = np.concatenate([below, speed, above])
    least = np.pad(item.amplification, (len(below), len(above)), constant_values=np.inf)
    for bound in own:
        least = np.minimum(least, bound.worst_about(item.order * speed / 60.0))
    return replace(item, speed_rpm=speed, amplification=least)


def _bound(
    block: Block,
    poles: Poles,
    least_damping: float,
    reach: float,
    unit: Mapping[str, str],
    matters: Mapping[str, float],
) -> UnseenBound:
    block, part = with_scatter(block, poles)
    speed = _asked(block)
    if part.degrees_of_freedom < len(block.channels) * block.parts or block.scatter > ORDER_RESPONSES.most_scatter:
        return UnseenBound(block.order, speed, np.full(len(speed), np.inf))
    spread = float(np.sqrt(max(1.0, part.chi2 / part.degrees_of_freedom)))
    added = np.zeros((len(block.channels), len(speed)))
    for times in NUMBERS.tried_damping_ratios:
        added = np.maximum(added, _added(block, part, speed, least_damping * times, reach * spread))
    # the noise of the nearest row hides what is smaller
    near = np.abs(np.log(speed[:, None] / block.speed_rpm)).argmin(axis=1)
    noise = NUMBERS.noise_sigmas * block.noise * np.where(np.isfinite(block.error), block.error, 0.0)[:, near]
    base = _fitted(block, part, poles, speed)
    if block.power:
        base, added, noise = np.sqrt(np.maximum(base, 0.0)), np.sqrt(added), np.sqrt(noise)
    hiding = Hiding(block.order, block.order * speed / 60.0, block.channels, base, added, noise)
    return UnseenBound(block.order, speed, hiding.amplification(unit, matters))


def _asked(block: Block) -> Floats:
    """Speeds (G,) that are asked about."""
    low, high = block.span_rpm
    if block.passage is not None:
        return np.geomspace(low, high, ALONG_SWEEP)
    rows = np.unique(block.speed_rpm)
    share = np.arange(BETWEEN_ROWS + 1) / (BETWEEN_ROWS + 1.0)
    between = rows[:-1, None] + np.diff(rows)[:, None] * share
    return np.append(between.ravel(), rows[-1])


def _fitted(block: Block, part: Projected, poles: Poles, speed: Floats) -> Floats:
    """Amplitude (C, G) of the fit at ``speed``; of squares their square."""
    held = held_at(block, speed)
    natural, damping = poles.frequency_hz[part.reached], poles.damping[part.reached]
    columns = np.concatenate([held.smooth(), held.modal(natural, damping)], axis=1)
    made = part.linear @ columns.T
    return np.asarray(made.real if block.power else np.abs(made))


def held_at(block: Block, speed_rpm: Floats) -> Block:
    """``block`` as if its order were held at ``speed_rpm`` (G,); it holds no amplitudes."""
    nothing = np.zeros((len(block.channels), len(speed_rpm)))
    return replace(
        block,
        speed_rpm=speed_rpm,
        frequency_hz=block.order * speed_rpm / 60.0,
        amplitude=nothing.astype(np.complex128),
        error=nothing + np.inf,
        passage=None,
        law_span_rpm=block.span_rpm,
    )


def _added(block: Block, part: Projected, speed: Floats, damping: float, reach: float) -> Floats:
    """Largest amplitude (C, G) that a mode on the order at ``speed`` adds there unseen; of squares their square."""
    natural = block.order * speed / 60.0
    ratios = np.full(len(speed), damping)
    seen_as = replace(block, passage=None, law_span_rpm=block.span_rpm)
    columns = seen_as.modal(natural, np.maximum(ratios, _blur(block, natural)))
    at_peak = np.abs(held_at(block, speed).growth) / (2.0 * damping)
    made = np.empty((len(block.channels), len(speed)))
    # any law may have taken it in
    bends = bent(block, part, max(1, min(ORDER_RESPONSES.most_degree, block.fewest_rows // 4 - 1)))
    for number, (weight, basis, left) in enumerate(zip(block.weight, part.basis, part.left, strict=True)):
        shown = columns * weight[:, None]
        shown -= basis @ (basis.conj().T @ shown)
        taken = np.linalg.qr(bends[number])[0]
        shown -= taken @ (taken.conj().T @ shown)
        norm = np.maximum(np.sum(np.abs(shown) ** 2, axis=0), 1e-300)
        along = np.abs(left.conj() @ shown) / norm + reach / np.sqrt(norm)
        if block.power:  # the real part is half as high as the imaginary one
            along = along.reshape(-1, 2) @ np.array([0.5, 1.0])
        made[number] = along * at_peak
    return made


def _blur(block: Block, natural: Floats) -> Floats:
    """Damping ratio that a sweep makes any resonance at ``natural`` (G,) look like at least."""
    if block.passage is None:
        return np.zeros(len(natural))
    rate = float(np.median(np.abs(np.gradient(block.passage.frequency_hz, block.passage.step_s))))
    return np.asarray(0.5 * np.sqrt(rate) / natural)
