"""What the orders do not show: how far a natural frequency that nobody saw could still amplify each of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.found import UnseenBound
from crankorder.identify.modal.order_responses import Block, Projected, with_scatter
from crankorder.identify.modal.surface_fit import Poles

BETWEEN_ROWS = 4
"""Speeds that are asked about between two tested ones."""

ALONG_SWEEP = 160
"""Speeds that are asked about along a sweep."""

WIDER = (1.0, 3.0, 10.0)
"""Multiples of the least damping ratio that a hidden mode is tried with."""

MATTERS = 0.03
"""Share of the largest amplitude of any order below which no amplitude matters."""

NOISE_SHARE = 2.0
"""Standard errors beneath which nothing is seen: amplitudes below it count as so large."""

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]


def least_seen(
    blocks: Sequence[Block],
    poles: Poles,
    *,
    unit: Mapping[str, str],
    least_damping: float,
    confidence: float,
) -> tuple[UnseenBound, ...]:
    """For each of ``blocks``, how much a mode beside the ``poles`` could amplify its order without being seen.

    At speeds between the tested ones a mode is imagined on the order, damped by ``least_damping`` or some times that;
    its residue is what the data give it, and as much more as they leave open at the ``confidence`` (0 to 1). What it
    adds at its peak, over what is there without it, is the amplification, in the channel that has most of each
    ``unit``. Amplitudes below the noise, or below a small share of the largest of any order, count as so large.
    """
    from scipy.special import chdtri

    reach = float(np.sqrt(chdtri(2.0, 1.0 - confidence)))
    largest: dict[str, float] = {}
    for block in blocks:
        size = np.sqrt(block.size) if block.power else block.size
        for name, most in zip(block.channels, size.max(axis=1).tolist(), strict=True):
            largest[unit[name]] = max(most, largest.get(unit[name], 0.0))
    return tuple(_bound(block, poles, least_damping, reach, unit, largest) for block in blocks)


def _bound(
    block: Block,
    poles: Poles,
    least_damping: float,
    reach: float,
    unit: Mapping[str, str],
    largest: Mapping[str, float],
) -> UnseenBound:
    block, part = with_scatter(block, poles)
    speed = _asked(block)
    if part.freedom < len(block.channels) * block.parts:
        return UnseenBound(block.order, speed, np.full(len(speed), np.inf))
    spread = float(np.sqrt(max(1.0, part.chi2 / part.freedom)))
    added = np.zeros((len(block.channels), len(speed)))
    for times in WIDER:
        added = np.maximum(added, _added(block, part, speed, least_damping * times, reach * spread))
    # the noise of the nearest row hides what is smaller
    near = np.abs(np.log(speed[:, None] / block.speed_rpm)).argmin(axis=1)
    noise = NOISE_SHARE * np.where(np.isfinite(block.error), block.error, 0.0)[:, near]
    base = _fitted(block, part, poles, speed)
    if block.power:
        base, added, noise = np.sqrt(np.maximum(base, 0.0)), np.sqrt(added), np.sqrt(noise)
    most = np.zeros(len(speed))
    for name in dict.fromkeys(unit[channel] for channel in block.channels):
        own = np.array([unit[channel] == name for channel in block.channels])
        least = np.maximum(noise[own].max(axis=0), MATTERS * largest[name])
        without = np.maximum(base[own].max(axis=0), least)
        most = np.maximum(most, np.maximum((base + added)[own].max(axis=0), least) / np.maximum(without, 1e-300))
    return UnseenBound(block.order, speed, most)


def _asked(block: Block) -> Array:
    """Speeds (G,) that are asked about."""
    low, high = block.span_rpm
    if block.passage is not None:
        return np.geomspace(low, high, ALONG_SWEEP)
    rows = np.unique(block.speed_rpm)
    share = np.arange(BETWEEN_ROWS + 1) / (BETWEEN_ROWS + 1.0)
    between = rows[:-1, None] + np.diff(rows)[:, None] * share
    return np.append(between.ravel(), rows[-1])


def _fitted(block: Block, part: Projected, poles: Poles, speed: Array) -> Array:
    """Amplitude (C, G) of the fit at ``speed``; of squares their square."""
    held = held_at(block, speed)
    natural, damping = poles.frequency_hz[part.reached], poles.damping[part.reached]
    columns = np.concatenate([held.smooth(), held.modal(natural, damping)], axis=1)
    made = part.linear @ columns.T
    return np.asarray(made.real if block.power else np.abs(made))


def held_at(block: Block, speed_rpm: Array) -> Block:
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


def _added(block: Block, part: Projected, speed: Array, damping: float, reach: float) -> Array:
    """Largest amplitude (C, G) that a mode on the order at ``speed`` adds there unseen; of squares their square."""
    natural = block.order * speed / 60.0
    ratios = np.full(len(speed), damping)
    seen_as = replace(block, passage=None, law_span_rpm=block.span_rpm)
    columns = seen_as.modal(natural, np.maximum(ratios, _blur(block, natural)))
    at_peak = np.abs(held_at(block, speed).growth) / (2.0 * damping)
    made = np.empty((len(block.channels), len(speed)))
    for number, (weight, basis, left) in enumerate(zip(block.weight, part.basis, part.left, strict=True)):
        shown = columns * weight[:, None]
        shown -= basis @ (basis.conj().T @ shown)
        norm = np.maximum(np.sum(np.abs(shown) ** 2, axis=0), 1e-300)
        along = np.abs(left.conj() @ shown) / norm + reach / np.sqrt(norm)
        if block.power:  # the real part is half as high as the imaginary one
            along = along.reshape(-1, 2) @ np.array([0.5, 1.0])
        made[number] = along * at_peak
    return made


def _blur(block: Block, natural: Array) -> Array:
    """Damping ratio that a sweep makes any resonance at ``natural`` (G,) look like at least."""
    if block.passage is None:
        return np.zeros(len(natural))
    rate = float(np.median(np.abs(np.gradient(block.passage.frequency_hz, block.passage.step_s))))
    return np.asarray(0.5 * np.sqrt(rate) / natural)
