"""Strong lines as narrow as the window: tones from the start on, which the fit of the modes sees beside them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.modal.floor import Floor
from crankorder.identify.modal.resonance import pole_columns

Array = NDArray[np.float64]

STRONG = 4.6
"""Logarithm of the power over the floor beside it from which a line without width is a tone for sure: 20 dB."""

WANDER_HZ = 0.04
"""How far a tone wanders within a test, standard deviation: mains do so within minutes."""

SMEAR_LEFT = 0.2
"""Share of what wander makes of a tone that its columns leave."""

RULES = 0.3
"""Share of a bin's power that a strong tone makes from which no peak is looked for there."""

STEADY_WIDTH = 0.02
"""Half width in bins below which a strong line has none."""

SKIRT_BINS = 6
"""Bins on both sides of a narrow peak that its first guess looks at."""

START_WIDTHS = (0.003, 0.01, 0.03, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Half widths in bins that are tried for narrow peaks."""

PEAK_REACH = 3
"""Bins on both sides among which a peak is the largest."""

SHADOW_BINS = 12
"""Bins on both sides of a line that its skirts reach."""


def with_strong_tones(floor: Floor) -> Floor:
    """``floor`` with frequencies, and their errors, of the lines that are far above it and as narrow as the window."""
    tones: list[tuple[float, float]] = []
    for density in floor.psd:
        used = np.isfinite(density) & (density > 0.0)
        if np.count_nonzero(used) < 20:
            continue
        whole = np.interp(np.arange(len(density)), np.flatnonzero(used), np.log(density[used]))
        for peak in local_maxima(whole):
            at = int(peak)
            beside = np.median(whole[max(at - 3 * SHADOW_BINS, 0) : at + 3 * SHADOW_BINS + 1])
            if whole[at] - beside < STRONG or whole[at] < whole[max(at - SHADOW_BINS, 0) : at + SHADOW_BINS + 1].max():
                continue
            _, half = narrow_peak(whole, at, floor)
            if half > STEADY_WIDTH * floor.seen.bin_hz:
                continue
            frequency = float(floor.frequency_hz[at]) + _offset_hz(whole, at, floor)
            error = floor.step_hz * float(np.exp(0.5 * (beside - whole[at])))
            if all(abs(frequency - other) > 2.0 * floor.seen.bin_hz for other, _ in tones):
                tones.append((frequency, max(error, 1e-3 * floor.step_hz)))
    return replace(floor, strong=tuple(sorted(tones)))


def line_columns(floor: Floor) -> Array:
    """Columns (3 lines, F) of the power of the strong tones of ``floor``, each a little off and wandering a little.

    The window's response and its first two derivatives by frequency: what a small error of the frequency and a small
    wander make of it, whatever their size.
    """
    step = 0.02 * floor.seen.bin_hz
    made = np.zeros((3 * len(floor.strong), len(floor.frequency_hz)))
    top = float(floor.seen.kernel(np.zeros(1))[0])
    for number, (tone, _) in enumerate(floor.strong):
        away = floor.frequency_hz - tone + step * np.array([[-1.0], [0.0], [1.0]])
        low, middle, high = floor.seen.kernel(away) / top
        made[3 * number] = middle
        made[3 * number + 1] = (high - low) / 0.04
        made[3 * number + 2] = (high - 2.0 * middle + low) / 0.02**2
    return made


def ruled_by_lines(floor: Floor) -> NDArray[np.bool_]:
    """Which bins (C, F) of ``floor`` hold more of a strong tone than of all else."""
    made = np.zeros(floor.psd.shape, dtype=bool)
    columns = line_columns(floor)[::3]
    for (tone, _), column in zip(floor.strong, columns, strict=True):
        peak = np.abs(floor.frequency_hz - tone) <= floor.seen.bin_hz
        top = np.nan_to_num(floor.psd[:, peak] / column[peak]).mean(axis=1)
        made |= top[:, None] * column > RULES * np.nan_to_num(floor.psd, nan=np.inf)
        made[:, np.abs(floor.frequency_hz - tone) <= floor.seen.bin_hz] = True
    return made


def unsure_power(floor: Floor) -> Array:
    """Power (C, F) by which the strong lines of ``floor`` may miss what is made of them, for tones wander a little.

    A line that wanders is smeared: where its power bends most over the frequency, it is least known.
    """
    made = np.zeros(floor.psd.shape)
    away = np.array([-WANDER_HZ, 0.0, WANDER_HZ])
    for tone, _ in floor.strong:
        near = np.flatnonzero(np.abs(floor.frequency_hz - tone) <= 3 * SHADOW_BINS * floor.seen.bin_hz)
        if not len(near):
            continue
        low, middle, high = floor.seen.kernel(floor.frequency_hz[near] - tone + away[:, None])
        smeared = np.abs(0.5 * (low + high) - middle) / float(floor.seen.kernel(np.zeros(1))[0])
        peak = near[np.abs(floor.frequency_hz[near] - tone) <= floor.seen.bin_hz]
        made[:, near] += SMEAR_LEFT * np.nan_to_num(floor.psd[:, peak]).max(axis=1, initial=0.0)[:, None] * smeared
    return made


def _offset_hz(level: Array, at: int, floor: Floor) -> float:
    """Distance of a tone from the bin ``at`` at which ``level`` (ln of power) peaks.

    From the two strongest bins of a Hann window (Rife and Vincent 1970), or, where the spectrum was padded, from the
    parabola through three.
    """
    left, middle, right = level[at - 1 : at + 2]
    if floor.seen.bin_hz > 1.5 * floor.step_hz:
        bend = left - 2.0 * middle + right
        return float(0.5 * (left - right) / bend) * floor.step_hz if bend < 0.0 else 0.0
    side = 1.0 if right >= left else -1.0
    share = float(np.exp(0.5 * (max(left, right) - middle)))
    return side * max(2.0 * share - 1.0, 0.0) / (share + 1.0) * floor.step_hz


def narrow_peak(level: Array, peak: int, floor: Floor) -> tuple[float, float]:
    """Frequency and half width of the resonance that in dB is most like the narrow ``peak`` of ``level``.

    ``floor``: the floor in all channels.
    """
    near = np.arange(max(peak - SKIRT_BINS, 0), min(peak + SKIRT_BINS + 1, len(level)))
    peak = int(near[np.argmax(np.where(np.abs(near - peak) <= 1, level[near], -np.inf))])
    shift, width = (part.ravel() for part in np.meshgrid(np.linspace(-0.5, 0.5, 11), START_WIDTHS))
    natural = floor.frequency_hz[peak] + shift * floor.step_hz
    half = width * floor.seen.bin_hz
    made = pole_columns(floor.frequency_hz[near], natural, np.minimum(half / natural, 0.3), floor.seen)[0][::2]
    at_peak = made[:, np.searchsorted(near, peak)][:, None]
    under = np.exp(level[near].min())
    model = np.log(np.maximum(made / at_peak, 0.0) * (np.exp(level[peak]) - under) + under)
    best = int(np.argmin(np.square(model - level[near]).sum(axis=1)))
    return float(natural[best]), float(half[best])


def local_maxima(level: Array) -> NDArray[np.int64]:
    """Bins of ``level`` that are the largest within some on both sides, the ends excluded."""
    padded = np.pad(level, PEAK_REACH, constant_values=-np.inf)
    highest = np.lib.stride_tricks.sliding_window_view(padded, 2 * PEAK_REACH + 1).max(axis=-1)
    inner = np.arange(len(level))
    return np.flatnonzero((level >= highest) & (inner > 1) & (inner < len(level) - 2))
