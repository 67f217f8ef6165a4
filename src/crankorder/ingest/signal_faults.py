"""What is wrong with the samples of a signal: missing, clipped, constant. What leaves this module is finite or NaN.

All of it is done block by block, for a signal may be larger than memory.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from crankorder.ingest.channel_faults import Runs, SignalFault, joined
from crankorder.ingest.rawfile import FloatArray
from crankorder.quantities import Bools
from crankorder.scratch import blocks
from crankorder.settings import IngestSettings

# beyond any physical signal: fill values of NetCDF (9.97e36) and of LabVIEW lie above it
_FILL_ABOVE = 1e30
_SENTINELS = (-999.0, -9999.0, -99999.0, 9999.0, 99999.0)
# a flat top that falls by more than this many rounding steps within its own length was cut off: twice the smooth fall
_STEEP_STEPS = 10.0


# samples between gaps, in the middle of all such stretches, that are worth analysing by themselves
_FEWEST_BETWEEN = 128

Mask = Callable[[FloatArray], Bools]


@dataclass(frozen=True, slots=True)
class _Survey:
    """Least and greatest number among the samples, how many equal the one before them, and whether any is NaN."""

    low: float
    high: float
    n_still: int
    has_nan: bool


def mend_signal(signal: FloatArray, *, settings: IngestSettings) -> list[SignalFault]:
    """Faults of ``signal``, shape (sample,), whose missing samples are bridged in place where they are few in a row.

    Samples of a longer gap become NaN, whatever stood there. ``settings`` say how many missing samples are few and what
    counts as clipping. Where more would be bridged
    than the spectrum bears, or more are missing than leave a channel to speak of, all of it is lost.
    """
    survey = _survey(signal)
    flags: list[SignalFault] = []
    finite = not survey.has_nan and survey.low > -_FILL_ABOVE and survey.high < _FILL_ABOVE
    if not finite or survey.low in _SENTINELS or survey.high in _SENTINELS:
        missing = _runs(signal, _missing(signal))
        if missing.starts.size:
            flags += _without(signal, missing, settings)
            if any(fault.is_lost for fault in flags):
                return flags
            survey = _survey(signal)
    if survey.low == survey.high:
        return [*flags, SignalFault("constant_signal", "bad", f"all samples equal {survey.low:.6g}", is_lost=True)]
    # each fault needs so many samples that stand still: most signals have too few for any, and are done
    if 2 * survey.n_still > signal.size and (levels := _few_levels(signal, settings)):
        shown = ", ".join(f"{level:.4g}" for level in levels)
        detail = f"takes the values {shown} alone: a switch, or a signal smaller than the steps of its converter"
        return [*flags, SignalFault("few_levels", "bad", detail, is_lost=True)]
    if survey.n_still >= 2 * (settings.clip_run_samples - 1):
        flags += _clipping(signal, survey.low, survey.high, settings)
    if survey.n_still >= settings.dropout_samples - 1:
        flags += _dropout(signal, settings)
    return flags


def _survey(signal: FloatArray) -> _Survey:
    lows, highs, n_still, has_nan, last = [], [], 0, False, np.nan
    for part in blocks(signal.size):
        piece = signal[part]
        low = piece.min()
        if low != low:
            has_nan = True
            low = np.fmin.reduce(piece)
        lows.append(low)
        highs.append(np.fmax.reduce(piece) if has_nan else piece.max())
        n_still += int(np.count_nonzero(piece[1:] == piece[:-1])) + int(piece[0] == last)
        last = piece[-1]
    return _Survey(float(np.fmin.reduce(lows)), float(np.fmax.reduce(highs)), n_still, has_nan)


def _runs(signal: FloatArray, mask: Mask, *, least: int = 1) -> Runs:
    """Runs of ``least`` samples or more in a row for which ``mask`` (of a block of samples) is true."""
    parts: list[Runs] = []
    begun = -1  # where the run that has not ended yet began
    for part in blocks(signal.size):
        chosen = mask(signal[part])
        if begun < 0 and not chosen.any():
            continue
        turns = part.start + np.flatnonzero(np.diff(chosen, prepend=begun >= 0))
        turns = turns if begun < 0 else np.concatenate(([begun], turns))
        begun = int(turns[-1]) if turns.size % 2 else -1
        turns = turns[: turns.size // 2 * 2].reshape(-1, 2)
        turns = turns[turns[:, 1] - turns[:, 0] >= least]
        parts.append(Runs(turns[:, 0], turns[:, 1]))
    if begun >= 0 and signal.size - begun >= least:
        parts.append(Runs(np.array([begun]), np.array([signal.size])))
    return joined(parts)


def _dropout(signal: FloatArray, settings: IngestSettings) -> list[SignalFault]:
    """Flag stretches in which the signal stands still, whatever its level, where the longest is too long for chance."""
    last = np.array([np.nan], dtype=signal.dtype)

    def still(piece: FloatArray) -> Bools:
        nonlocal last
        held = np.diff(np.concatenate((last, piece))) == 0.0
        last = piece[-1:]
        return np.asarray(held)

    runs = _runs(signal, still, least=settings.dropout_samples - 1)
    runs = Runs(np.maximum(runs.starts - 1, 0), runs.ends)
    if not runs.starts.size or runs.lengths.max() < settings.dropout_fraction * signal.size:
        return []
    is_silent = (signal[runs.starts] == 0.0) & ((runs.starts == 0) | (runs.ends == signal.size))
    silence, held = runs.where(is_silent), runs.where(~is_silent)
    faults: list[SignalFault] = []
    if silence.starts.size:
        count = int(silence.lengths.sum())
        share = f"{count / signal.size:.1%}"
        detail = f"zeros for {count} samples ({share}) at its start or end: nothing was recorded there"
        faults.append(SignalFault("silence", "suspect", detail, silence, is_lost=True))
    if held.starts.size and held.lengths.max() >= settings.dropout_fraction * signal.size:
        longest = int(np.argmax(held.lengths))
        length = int(held.lengths[longest])
        detail = f"the same value for {length} samples ({length / signal.size:.1%}) from sample {held.starts[longest]}"
        faults.append(SignalFault("dropout", "bad", detail, held, is_lost=True))
    return faults


def _few_levels(signal: FloatArray, settings: IngestSettings) -> list[float]:
    """The values that ``signal`` takes, where they are so few that its converter or a switch makes them; else none."""
    levels: set[float] = set()
    for part in blocks(signal.size):
        piece = signal[part]
        levels.update((np.unique(piece[np.isfinite(piece)]) + 0.0).tolist())
        if len(levels) > settings.dead_steps:
            return []
    return sorted(levels)


def _missing(signal: FloatArray) -> Mask:
    """Which samples are not finite, fill values, or a sentinel such as -999 that lies far outside all other samples."""
    known: list[np.floating] = []

    def missing(piece: FloatArray) -> Bools:
        found = ~(np.abs(piece) < _FILL_ABOVE)
        for sentinel in known:
            found |= piece == sentinel
        return np.asarray(found)

    for number in _SENTINELS:
        sentinel = signal.dtype.type(number)
        n_hits, largest, n_rest = 0, 0.0, 0
        for part in blocks(signal.size):
            hits = signal[part] == sentinel
            rest = np.abs(signal[part][~(missing(signal[part]) | hits)])
            n_hits, n_rest = n_hits + int(np.count_nonzero(hits)), n_rest + rest.size
            largest = max(largest, float(rest.max(initial=0.0)))
        if n_hits and n_rest and largest < 0.1 * abs(number):
            known.append(sentinel)
    return missing


def _without(signal: FloatArray, missing: Runs, settings: IngestSettings) -> list[SignalFault]:
    """Bridge the short of the ``missing`` runs by straight lines, make the others NaN, and flag both."""
    is_short = missing.lengths <= settings.max_gap_samples
    total, bridged = int(missing.lengths.sum()), int(missing.lengths[is_short].sum())
    between = np.diff(missing.starts, prepend=0, append=signal.size)
    if bridged > settings.max_gap_fraction * signal.size and np.median(between) >= _FEWEST_BETWEEN:
        is_short[:], bridged = False, 0  # too many to bridge, and far enough apart to leave out what touches them
    short, gaps = missing.where(is_short), missing.where(~is_short)
    limits = ((total, settings.max_missing_fraction, "in all"), (bridged, settings.max_gap_fraction, "to bridge"))
    for count, most, how in limits:
        if count > most * signal.size:
            for start, end in zip(missing.starts, missing.ends, strict=True):
                signal[start:end] = np.nan
            first = missing.starts[int(np.argmax(missing.lengths))]
            detail = (
                f"{total} samples are missing (not a number, infinite or a fill value), most from sample {first}: "
                f"{count / signal.size:.3%} {how}, allowed {most:.1%}"
            )
            return [SignalFault("gap", "bad", detail, is_lost=True)]
    flags = []
    for start, end in zip(gaps.starts, gaps.ends, strict=True):
        signal[start:end] = np.nan
    if gaps.starts.size:
        longest, count = int(np.argmax(gaps.lengths)), int(gaps.lengths.sum())
        detail = (
            f"{count} samples ({count / signal.size:.2%}) missing in {gaps.starts.size} "
            f"gap{'s' * (gaps.starts.size > 1)}, the longest of {gaps.lengths[longest]} from sample "
            f"{gaps.starts[longest]}; what touches a gap is left out"
        )
        flags.append(SignalFault("gap", "suspect", detail, gaps))
    if short.starts.size:
        for start, end in zip(short.starts, short.ends, strict=True):
            beside = [place for place in (start - 1, end) if 0 <= place < signal.size]
            signal[start:end] = np.interp(np.arange(start, end), beside, signal[beside])
        detail = f"{bridged} missing samples bridged, first at sample {short.starts[0]}"
        flags.append(SignalFault("non_finite_interpolated", "suspect", detail, short))
    return flags


def _clipping(signal: FloatArray, low: float, high: float, settings: IngestSettings) -> list[SignalFault]:
    """Flag runs of equal samples at an extreme, where they are cut off and not the smooth top of a quantised signal."""
    cut_off: list[Runs] = []
    step = np.nan
    for extreme in (low, high):
        at_extreme = partial(np.equal, signal.dtype.type(extreme))
        n_flat = sum(int(np.count_nonzero(at_extreme(signal[part]))) for part in blocks(signal.size))
        if n_flat < 2 * settings.clip_run_samples:
            continue
        flat = _runs(signal, at_extreme, least=settings.clip_run_samples)
        step = _rounding_step(signal) if np.isnan(step) else step
        if flat.starts.size and n_flat > _just_inside(signal, extreme, step):
            cut_off.append(flat.where(_is_cut_off(signal, extreme, flat, step)))
    runs = joined(cut_off)
    if runs.starts.size < 2:
        return []
    share = int(runs.lengths.sum()) / signal.size
    is_bad = share > settings.max_clipped_fraction
    flat = runs.merged(within=0, n_samples=signal.size)
    detail = f"{share:.3%} of its samples lie flat at {low:.6g} or {high:.6g}, first at sample {runs.starts.min()}"
    return [SignalFault("clipped", "bad" if is_bad else "suspect", detail, flat, is_lost=is_bad)]


def _rounding_step(signal: FloatArray) -> float:
    """Least change from one sample to the next."""
    step = np.inf
    for part in blocks(signal.size - 1):
        steps = np.abs(np.diff(signal[part.start : part.stop + 1]))
        step = min(step, float(steps.min(where=steps > 0, initial=np.inf)))
    return step


def _just_inside(signal: FloatArray, extreme: float, step: float) -> int:
    """Samples within three rounding steps of the extreme: more than at it, unless the signal was cut off there."""
    count = 0
    for part in blocks(signal.size):
        apart = np.abs(signal[part] - extreme)
        count += int(np.count_nonzero((apart > 0.0) & (apart < 3.5 * step)))
    return count


def _is_cut_off(signal: FloatArray, extreme: float, flat: Runs, step: float) -> Bools:
    """Which ``flat`` runs the signal enters or leaves steeply, beside the rounding ``step``.

    The top of a parabola that rounding flattens over L samples has fallen by 4.5 rounding steps L samples further on.
    """
    before = np.abs(signal[np.maximum(flat.starts - flat.lengths, 0)] - extreme)
    after = np.abs(signal[np.minimum(flat.ends - 1 + flat.lengths, signal.size - 1)] - extreme)
    steep: Bools = np.fmax(before, after) > _STEEP_STEPS * step
    return steep
