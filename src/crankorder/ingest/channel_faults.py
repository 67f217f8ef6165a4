"""Channels that say nothing of the machine, told beside the others of the recording: dead, a copy, mains alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from crankorder.fft.windows import hann
from crankorder.ingest.fault import SignalFault
from crankorder.ingest.rawfile import FloatArray
from crankorder.ingest.signal_survey import Floats, Survey
from crankorder.scratch import blocks
from crankorder.settings import IngestSettings

_LOOK = 8192
"""Samples in which the lines of the others are looked for."""
_LINES = 6
_STANDS_OUT = 10.0
"""Power of a line over the median about it."""
_SERIES = 2048
_MULTIPLES = 4
_OFF_MAINS = 0.01
"""Mains and a half order of the shaft closer than this share are not told apart."""


def root_mean_square(survey: Survey) -> float:
    """Root mean square of the signal of ``survey``, NaN where too much is missing."""
    square = float(survey.means.var()) + float(survey.variances.mean())
    if math.isfinite(square):
        return math.sqrt(square)
    known = np.isfinite(survey.means)
    if not known.any():
        return math.nan
    return math.sqrt(float(survey.means[known].var()) + float(survey.variances[known].mean()))


def find_copies(signals: FloatArray, names: Sequence[str]) -> dict[int, SignalFault]:
    """Faults by number of those of ``signals`` (channel, sample) that equal an earlier one; ``names`` are theirs."""
    found: dict[int, SignalFault] = {}
    step = max(signals.shape[1] // 64, 1)
    few = signals[:, ::step]
    for later in range(1, len(signals)):
        for earlier in range(later):
            if not np.array_equal(few[earlier], few[later]) or not np.ptp(few[later]) > 0.0:
                continue
            if all(np.array_equal(signals[earlier, part], signals[later, part]) for part in blocks(signals.shape[1])):
                detail = f"the same samples as channel {names[earlier]}: one of the two was not measured"
                found[later] = SignalFault("copied_channel", "suspect", detail)
                break
    return found


def find_dead(
    signals: FloatArray, surveys: Sequence[Survey], groups: Sequence[str], *, settings: IngestSettings
) -> dict[int, SignalFault]:
    """Faults by number of the ``signals`` (channel, sample) that hold noise alone while others see the machine.

    Only channels of one of ``groups`` (units) are compared, by their ``surveys`` and ``settings``. Dead is one far
    below the middle of the others in which none of the strongest lines of the loudest stands out, whether it toggles
    between a few steps of the converter or not.
    """
    size = np.array([root_mean_square(each) for each in surveys])
    found: dict[int, SignalFault] = {}
    for number, own in enumerate(size):
        others = [k for k, group in enumerate(groups) if group == groups[number] and k != number and size[k] > 0.0]
        if not others or not own > 0.0:
            continue
        typical = float(np.median(size[others]))
        if own > settings.dead_ratio * typical:
            continue
        loudest = max(others, key=lambda k: size[k])
        steps = _steps(signals[number])
        if not _shows_lines(signals[number], signals[loudest]):
            rest = f"within {steps} steps of its converter" if steps <= settings.dead_steps else "noise alone"
            below = f"{typical / own:.3g} times below the others, none of whose lines it shows"
            detail = f"{rest}, {below}: dead or not connected"
            found[number] = SignalFault("dead_sensor", "bad", detail, is_lost=True)
    return found


def _steps(signal: FloatArray) -> int:
    """Rounding steps between the least and the greatest of some samples, so far as they can be counted."""
    piece = signal[signal.size // 2 :][:_LOOK].astype(np.float64)
    step = np.diff(np.unique(piece[np.isfinite(piece)]))
    return int(min(round(float(step.sum() / step.min())), 10**9)) if step.size else 0


def _shows_lines(quiet: FloatArray, loud: FloatArray) -> bool:
    """Whether one of the strongest lines of ``loud`` stands out in ``quiet``, or ``loud`` has none."""
    length = min(_LOOK, quiet.size)
    starts = np.unique(np.linspace(0, quiet.size - length, 4).astype(np.int64))
    window = hann(length).values
    powers = []
    for signal in (quiet, loud):
        pieces = np.stack([signal[start : start + length] for start in starts]).astype(np.float64)
        pieces = pieces[np.isfinite(pieces).all(axis=1)]
        if not len(pieces):
            return True
        pieces -= pieces.mean(axis=1, keepdims=True)
        powers.append(np.square(np.abs(np.fft.rfft(pieces * window, axis=1))).mean(axis=0)[3:])
    places = _line_places(powers[1])
    if not places.size:
        return True
    over = [_over_floor(powers[0], int(place)) for place in places]
    return bool(np.max(over) > _STANDS_OUT / 2.0)


def _line_places(power: Floats) -> np.ndarray:
    """The strongest bins that stand far above the median of the bins about them."""
    order = np.argsort(power)[::-1][: 8 * _LINES]
    return np.array([k for k in order if _over_floor(power, int(k)) > _STANDS_OUT][:_LINES], dtype=np.int64)


def _over_floor(power: Floats, place: int) -> float:
    near = power[max(place - 40, 0) : place + 41]
    return float(power[max(place - 1, 0) : place + 2].max()) / max(float(np.median(near)), 1e-300)


def find_mains_only(
    surveys: Sequence[Survey], rate_hz: float, shaft_hz: float, *, settings: IngestSettings
) -> dict[int, SignalFault]:
    """Faults by number of the channels that hold mains, its multiples and noise, while others hold other lines.

    ``surveys`` of channels sampled at ``rate_hz``, judged by ``settings``. ``shaft_hz``: of the shaft, 0 for none;
    NaN where unknown, and then nothing is told, nor where an order of the shaft lies on mains.
    """
    if not math.isfinite(shaft_hz) or len(surveys) < 2:
        return {}
    series = np.stack([each.means[: 8 * _SERIES] for each in surveys])
    series = np.nan_to_num(series - np.nanmean(series, axis=1, keepdims=True))
    series_hz = rate_hz / surveys[0].size
    if len(series[0]) < _SERIES // 8 or len(series[0]) / series_hz < 1.0:
        return {}
    sizes = np.array([root_mean_square(each) for each in surveys])
    for mains_hz in (50.0, 60.0):
        if shaft_hz > 0.0 and abs((ratio := 2.0 * mains_hz / shaft_hz) - round(ratio)) < _OFF_MAINS * ratio:
            continue
        shares = _mains_power(series[:, :_SERIES], series_hz, mains_hz) / np.square(sizes)
        candidates = np.flatnonzero(shares > settings.mains_share)
        if not candidates.size or candidates.size == len(surveys):
            continue
        lines = [_lines_beside(row, series_hz, mains_hz) for row in series]
        elsewhere = max(lines[k] / sizes[k] ** 2 for k in range(len(surveys)) if k not in candidates)
        told = [k for k in candidates if lines[k] < 0.01 * sizes[k] ** 2 and elsewhere > 0.2]
        detail = f"{mains_hz:g} Hz, its multiples and noise alone, while others show the machine: pick-up, no sensor"
        return {int(k): SignalFault("mains_only", "suspect", detail) for k in told}
    return {}


def _mains_power(series: Floats, series_hz: float, mains_hz: float) -> Floats:
    """Mean square (channel,) of mains and its multiples in ``series`` (channel, sample)."""
    window = hann(series.shape[1]).values
    turn = np.exp(-2j * np.pi * mains_hz / series_hz * np.arange(series.shape[1]))
    power, turns = np.zeros(len(series)), np.ones_like(turn)
    for _ in range(int(min(_MULTIPLES, 0.45 * series_hz / mains_hz))):
        turns = turns * turn
        power += 2.0 * np.square(np.abs((series * window) @ turns) / window.sum())
    return power


def _lines_beside(row: Floats, series_hz: float, mains_hz: float) -> float:
    """Mean square of the lines in ``row`` that lie on no multiple of mains."""
    window = hann(len(row)).values
    power = 2.0 * np.square(np.abs(np.fft.rfft(row * window))) / (len(row) * float(window @ window))
    frequency = np.arange(len(power)) * (series_hz / len(row))
    width = 4.0 * series_hz / len(row)
    off = np.abs(frequency - mains_hz * np.round(frequency / mains_hz)) > width + 2e-3 * frequency
    off &= frequency > width
    floor = float(np.median(power[off])) if off.any() else 0.0
    return float(power[off & (power > 5.0 * _STANDS_OUT * floor)].sum())
