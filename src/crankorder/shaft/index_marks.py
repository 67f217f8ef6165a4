"""Index marks against the teeth between them: where the mark is, and which marks are lost, extra or have slipped."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from crankorder.errors import InputError
from crankorder.shaft.pulses import FloatArray, Remark
from crankorder.shaft.repair import IntArray, listed_times


def at_index(
    time_s: FloatArray,
    tooth: IntArray,
    index_time_s: FloatArray,
    wanted: tuple[float, float],
    flags: list[Remark],
    *,
    renumber: bool,
) -> tuple[IntArray, float, float]:
    """Teeth renumbered by the index marks, the tooth number of a mark, and the teeth between marks.

    ``time_s``: (pulses,), s. ``tooth``: (pulses,), their numbers. ``index_time_s``: (marks,), s. ``wanted``: counts of
    teeth per mark that are allowed, of a mark on the encoder and on the crank. ``flags``: takes the remarks.
    ``renumber``: whether a count that slips for good is put right, as it must be where the teeth look all alike.
    Raises InputError where another count is measured than is wanted.
    """
    marks = index_time_s[(index_time_s >= time_s[0]) & (index_time_s <= time_s[-1])]
    if marks.size == 0:
        flags.append(("no_index", "suspect", "no index mark within the pulses: the phase has no reference"))
        return tooth, float("nan"), wanted[0]
    place = np.interp(marks, time_s, tooth)
    between = np.round(np.diff(place))
    period = wanted[0]
    if between.size >= 2:
        values, counts = np.unique(between, return_counts=True)
        usual = float(values[np.argmax(counts)])
        period = min(wanted, key=lambda count: abs(count - usual))
        if usual != round(period) and counts.max() > 0.5 * between.size:
            raise InputError(
                f"{usual:.0f} pulses per index measured, {period:g} configured",
                place="encoder.pulses_per_rev",
                remedy="Mend pulses_per_rev (or ratio) in run.toml",
            )
    anchor, slip = _slips(place, period)
    renumbered, slipped, odd = _unslipped(tooth, np.searchsorted(time_s, marks), slip)
    odd |= np.append((np.diff(place) < 0.25 * period) & (np.diff(slip) == 0), False)
    if 2 * odd.sum() > marks.size > 2:
        detail = f"{odd.sum()} of {marks.size} index marks are out of place: the phase has no reference"
        flags.append(("no_index", "suspect", detail))
        return tooth, float("nan"), period
    lost = np.maximum(0, np.round(np.diff(place) / period) - 1).astype(np.int64)
    if renumber and slipped.any():
        detail = f"pulse count put right at {slipped.sum()} index marks, {listed_times(marks[slipped])}"
        flags.append(("encoder_slip", "suspect", detail))
    elif slipped.any():
        detail = f"{slipped.sum()} times the index moves against the wheel, {listed_times(marks[slipped])}"
        flags.append(("index_slip", "suspect", detail))
    if odd.any():
        detail = f"{odd.sum()} index marks out of place, left out, {listed_times(marks[odd])}"
        flags.append(("index_extra", "suspect", detail))
    if lost.any():
        detail = f"{lost.sum()} index marks missing, filled in, after those {listed_times(marks[:-1][lost > 0])}"
        flags.append(("index_lost", "suspect", detail))
    return renumbered if renumber else tooth, anchor, period


def _wrapped(value: FloatArray, period: float) -> FloatArray:
    """``value`` less whole periods, within half a period of 0."""
    wrapped: FloatArray = value - period * np.round(value / period)
    return wrapped


def _slips(place: FloatArray, period: float) -> tuple[float, FloatArray]:
    """Place of the marks within a period, and by how many whole teeth each mark differs from it."""
    first = place[: max(3, place.size // 10)]
    values, counts = np.unique(np.round(first % period), return_counts=True)
    anchor = float(values[np.argmax(counts)])
    anchor += float(np.median(_wrapped(first - anchor, period)))
    off = _wrapped(place - anchor, period)
    slip = np.round(off)
    rest = off - slip
    near = np.abs(rest - np.median(rest))
    return anchor + float(np.mean(rest[near <= 4.5 * np.median(near)])), slip


def _unslipped(
    tooth: IntArray, mark_pulse: IntArray, slip: FloatArray
) -> tuple[IntArray, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Teeth renumbered where a slip lasts over two marks or more, which marks show such a slip, which are odd ones."""
    shift, current = np.zeros(tooth.size, dtype=np.int64), 0
    slipped, odd = np.zeros(slip.size, dtype=np.bool_), np.zeros(slip.size, dtype=np.bool_)
    for k in range(slip.size):
        if slip[k] == current:
            continue
        if k + 1 < slip.size and slip[k + 1] == slip[k]:
            current = int(slip[k])
            shift[mark_pulse[k] :] = -current
            slipped[k] = True
        else:
            odd[k] = True
    return tooth + shift, slipped, odd
