"""Numbered teeth from pulse times: lost and doubled pulses repaired and counted, gaps and index marks checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from crankorder.errors import InputError
from crankorder.settings import ShaftSettings
from crankorder.shaft.pulses import FloatArray, Remark

IntArray = npt.NDArray[np.int64]

# A short interval that completes one tooth with its neighbour, within this share of it, was cut by a false pulse.
SPLIT_SHARE = 0.25
# A tooth beside the gap that sits this share of a tooth off the line of its neighbours says nothing of the angle.
DISPLACED_SHARE = 0.05
# A tooth lost at the same place in this share of the revolutions is damage, not chance.
DAMAGE_SHARE = 0.5


@dataclass(frozen=True)
class NumberedTeeth:
    """Pulses that were kept, each with its tooth number on an endless wheel (lost teeth leave holes in the numbers).

    ``index_tooth`` is the tooth number, possibly between teeth, of a revolution mark: the first tooth behind the gap,
    the index, or the pulse itself; NaN where there is no such mark. ``n_repaired`` counts lost and false pulses.
    """

    time_s: FloatArray
    tooth: IntArray
    index_tooth: float
    n_repaired: int
    flags: list[Remark]


def number_teeth(
    time_s: FloatArray,
    *,
    pulses_per_rev: int,
    settings: ShaftSettings,
    missing_teeth: int = 0,
    index_time_s: FloatArray | None = None,
    ratio: float = 1.0,
    noise_s: float = 0.0,
) -> NumberedTeeth:
    """Tooth number of every true pulse, after repair, with the place of the revolution mark.

    Parameters
    ----------
    time_s : (pulses,), s, not decreasing
    pulses_per_rev : teeth of the full wheel per encoder revolution, 1 or more
    settings : ``double_pulse_ratio`` and ``lost_pulse_ratio`` bound a plausible interval, ``gap_ratio_tolerance`` a
        gap; ``max_repaired_fraction`` is where repair ends and refusal begins
    missing_teeth : teeth left out of the full wheel in one gap, 0 or more
    index_time_s : (marks,), s, times of the once-per-revolution mark, or None
    ratio : encoder revolutions per crank revolution; the index may sit on either shaft
    noise_s : standard deviation of one pulse time, s; at few samples per pulse it widens what is plausible

    Returns
    -------
    NumberedTeeth with remarks on every repair.

    Raises
    ------
    InputError for fewer than 3 pulses, times that go back, no gap, another count between gaps or index marks than
    configured, or more repairs than ``max_repaired_fraction`` of the pulses.
    """
    _check_times(time_s)
    window = max(2, min(8, pulses_per_rev // 8))
    kept, step = _steps(
        time_s,
        np.full(window, np.median(np.diff(time_s[: 4 * window + 8]))),
        missing_teeth + 1,
        settings.gap_ratio_tolerance,
        settings.double_pulse_ratio,
        settings.lost_pulse_ratio,
        noise_s * np.sqrt(12.0),
    )
    kept_time, tooth = time_s[kept], np.cumsum(step)
    flags: list[Remark] = []
    n_false = time_s.size - kept_time.size
    if n_false:
        flags.append(("encoder_double_pulse", "suspect", f"{n_false} false pulses removed"))
    index_tooth = 0.0 if pulses_per_rev == 1 or missing_teeth else np.nan
    if missing_teeth:
        tooth = _at_gaps(tooth, step, pulses_per_rev, missing_teeth, flags)
    if index_time_s is not None and index_time_s.size:
        tooth, index_tooth = _at_index(kept_time, tooth, index_time_s, (pulses_per_rev, pulses_per_rev * ratio), flags)
    lost = _lost_teeth(tooth, pulses_per_rev, missing_teeth)
    _flag_lost(lost, pulses_per_rev, index_tooth, (tooth[-1] - tooth[0]) / pulses_per_rev, flags)
    if n_false + lost.size > settings.max_repaired_fraction * time_s.size:
        raise InputError(
            f"{lost.size} pulses lost and {n_false} false of {time_s.size}: the count is not certain",
            place="encoder",
            allowed=f"{settings.max_repaired_fraction:.0%} repaired",
            remedy="Check pulses_per_rev, missing_teeth and edge in run.toml, and the sensor's gap and cable",
        )
    if missing_teeth:
        true = ~_displaced(kept_time, tooth, pulses_per_rev, pulses_per_rev - missing_teeth, flags)
        kept_time, tooth = kept_time[true], tooth[true]
    return NumberedTeeth(kept_time, tooth, index_tooth, n_false + int(lost.size), flags)


def _check_times(time_s: FloatArray) -> None:
    if time_s.size < 3:
        raise InputError("too few encoder pulses", found=time_s.size, allowed="3 or more", remedy="Record longer")
    bad = np.flatnonzero(~(np.diff(time_s) >= 0.0))
    if bad.size or not np.isfinite(time_s[0]):
        at = int(bad[0]) + 1 if bad.size else 0
        raise InputError(
            "pulse times go back or are not finite",
            place=f"encoder pulse {at}",
            found=f"{time_s[at]!r} s after {time_s[max(at - 1, 0)]!r} s",
            remedy="Mend the counter's roll-over, or leave the recording out",
        )


@njit(cache=True, nogil=True)
def _steps(time_s, recent, gap, gap_tolerance, double_ratio, lost_ratio, slack_s):  # type: ignore[no-untyped-def]
    """Which pulses are true, and by how many teeth each one of them advances.

    The time of one tooth is followed as the mean over ``recent``, the last few intervals.
    """
    n, window = time_s.size, recent.size
    kept, step = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    kept[0], step[0], m, total, slot = 0, 0, 1, recent.sum(), 0
    for i in range(1, n):
        last, tooth_s = time_s[kept[m - 1]], total / window
        interval = time_s[i] - last
        if interval < double_ratio * tooth_s - slack_s or interval <= 0.0:
            if m > 1:
                expected = time_s[kept[m - 2]] + step[m - 1] * tooth_s
                if abs(time_s[i] - expected) < abs(last - expected):
                    kept[m - 1] = i
            continue
        splits = interval < (1.0 - SPLIT_SHARE) * tooth_s - slack_s
        if splits and i + 1 < n and time_s[i + 1] - last < (1.0 + SPLIT_SHARE) * tooth_s:
            continue
        teeth = 1
        if gap > 1 and abs(interval / tooth_s - gap) <= gap_tolerance:
            teeth = gap
        elif interval > lost_ratio * tooth_s + slack_s:
            teeth = max(1, int(interval / tooth_s + 0.5))
        kept[m], step[m] = i, teeth
        m += 1
        total += interval / teeth - recent[slot]
        recent[slot] = interval / teeth
        slot = (slot + 1) % window
    return kept[:m].copy(), step[:m].copy()


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


def _unslipped(tooth: IntArray, mark_pulse: IntArray, slip: FloatArray) -> tuple[IntArray, int, int]:
    """Teeth renumbered where a slip lasts over two marks or more, the count of such slips, and of lone odd marks."""
    shift, n_slips, n_odd = np.zeros(tooth.size, dtype=np.int64), 0, 0
    current = 0
    for k in range(slip.size):
        if slip[k] == current:
            continue
        if k + 1 < slip.size and slip[k + 1] == slip[k]:
            current = int(slip[k])
            shift[mark_pulse[k] :] = -current
            n_slips += 1
        else:
            n_odd += 1
    return tooth + shift, n_slips, n_odd


def _at_gaps(tooth: IntArray, step: IntArray, pulses_per_rev: int, missing_teeth: int, flags: list[Remark]) -> IntArray:
    """Teeth numbered so that the first tooth behind the gap is a multiple of ``pulses_per_rev``."""
    behind = np.flatnonzero(step == missing_teeth + 1)
    wheel = f"{pulses_per_rev}-{missing_teeth}"
    if behind.size == 0:
        raise InputError(
            "no gap found in the pulse train",
            place="encoder",
            allowed=f"a gap of {missing_teeth} teeth per revolution ({wheel} wheel)",
            remedy="Check missing_teeth and edge in run.toml; the other edge may show the gap",
        )
    between = np.diff(tooth[behind])
    if between.size >= 2:
        values, counts = np.unique(between, return_counts=True)
        usual = int(values[np.argmax(counts)])
        if usual % pulses_per_rev and counts.max() > 0.5 * between.size:
            raise InputError(
                f"{usual} teeth per gap measured (the missing counted), {pulses_per_rev} configured",
                place="encoder.pulses_per_rev",
                remedy="Mend pulses_per_rev and missing_teeth in run.toml",
            )
    place = tooth[behind].astype(np.float64)
    anchor, slip = _slips(place, float(pulses_per_rev))
    renumbered, n_slips, _ = _unslipped(tooth - round(anchor), behind, slip)
    if n_slips:
        flags.append(("encoder_slip", "suspect", f"tooth count put right at {n_slips} gaps"))
    return renumbered


def _displaced(
    time_s: FloatArray, tooth: IntArray, pulses_per_rev: int, teeth: int, flags: list[Remark]
) -> npt.NDArray[np.bool_]:
    """Which pulses are of a tooth beside the gap that stands off the line of the next three (a pickup bends there)."""
    displaced = np.zeros(tooth.size, dtype=np.bool_)
    if teeth < 8:
        return displaced
    off = {}
    for place, way in ((0, 1), (teeth - 1, -1)):
        at = np.flatnonzero(tooth % pulses_per_rev == place)
        at = at[(at + 3 * way >= 0) & (at + 3 * way < tooth.size)]
        at = at[tooth[at + 3 * way] == tooth[at] + 3 * way]
        if at.size == 0:
            continue
        near, next_near, far = (time_s[at + k * way] for k in (1, 2, 3))
        off[place] = float(np.median((time_s[at] - 3.0 * near + 3.0 * next_near - far) / np.abs(next_near - near)))
        if abs(off[place]) > DISPLACED_SHARE:
            displaced |= tooth % pulses_per_rev == place
    if displaced.any():
        detail = ", ".join(f"tooth {place + 1} by {share:+.2f} tooth" for place, share in off.items())
        flags.append(("encoder_teeth_displaced", "info", f"edges beside the gap are displaced and left out: {detail}"))
    return displaced


def _at_index(
    time_s: FloatArray, tooth: IntArray, index_time_s: FloatArray, wanted: tuple[float, float], flags: list[Remark]
) -> tuple[IntArray, float]:
    """Teeth renumbered by the index marks, and the tooth number of a mark; ``wanted`` counts per mark are allowed."""
    marks = index_time_s[(index_time_s >= time_s[0]) & (index_time_s <= time_s[-1])]
    if marks.size == 0:
        flags.append(("no_index", "suspect", "no index mark within the pulses: the phase has no reference"))
        return tooth, float("nan")
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
    renumbered, n_slips, n_odd = _unslipped(tooth, np.searchsorted(time_s, marks), slip)
    n_odd += int(np.sum((np.diff(place) < 0.25 * period) & (np.diff(slip) == 0)))
    n_lost = int(np.sum(np.maximum(0, np.round(np.diff(place) / period) - 1)))
    for count, flag, detail in (
        (n_slips, "encoder_slip", f"pulse count put right at {n_slips} index marks"),
        (n_odd, "index_extra", f"{n_odd} index marks out of place, left out"),
        (n_lost, "index_lost", f"{n_lost} index marks missing, filled in"),
    ):
        if count:
            flags.append((flag, "suspect", detail))
    return renumbered, anchor


def _lost_teeth(tooth: IntArray, pulses_per_rev: int, missing_teeth: int) -> IntArray:
    """Numbers of the teeth without a pulse, those of the wheel's own gap left out."""
    holes = np.flatnonzero(np.diff(tooth) > 1)
    if holes.size == 0:
        return np.empty(0, dtype=np.int64)
    lost = np.concatenate([np.arange(tooth[k] + 1, tooth[k + 1]) for k in holes])
    return lost[lost % pulses_per_rev < pulses_per_rev - missing_teeth] if missing_teeth else lost


def _flag_lost(lost: IntArray, pulses_per_rev: int, index_tooth: float, revs: float, flags: list[Remark]) -> None:
    """Remarks on lost teeth: how many, and those that are lost again and again at the same angle."""
    if lost.size == 0:
        return
    flags.append(("encoder_missing_pulse", "suspect", f"{lost.size} lost pulses filled in"))
    places, counts = np.unique(lost % pulses_per_rev, return_counts=True)
    damaged = places[(counts >= 3) & (counts >= DAMAGE_SHARE * revs)]
    if damaged.size and pulses_per_rev > 1:
        known = np.isfinite(index_tooth)
        angle = (damaged - (index_tooth if known else 0.0)) * 360.0 / pulses_per_rev % 360.0
        listed = ", ".join(f"{value:.2f}" for value in angle[:5])
        after = "the index" if known else "the first pulse"
        flags.append(
            (
                "encoder_damaged_line",
                "suspect",
                f"pulse lost in most revolutions at {listed} degrees after {after} (a wheel with missing teeth?)",
            )
        )
