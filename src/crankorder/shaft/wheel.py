"""Numbered teeth from pulse times: the wheel stated or shown, lost and doubled pulses repaired, index marks checked."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr
from numba import njit

from crankorder.errors import InputError
from crankorder.quantities import Bools, Floats, Ints
from crankorder.settings import ShaftSettings
from crankorder.shaft.pulses import FEWEST_SAMPLES_PER_TOOTH, Remark, listed_times
from crankorder.shaft.repair import running_parts
from crankorder.shaft.uneven_wheel import (
    WHOLE_TEETH,
    Wheel,
    displaced_teeth,
    ends_put_right,
    find_pattern,
    followed_from_steady,
    gap_is_absent,
    times_on_grid,
    wheel_of,
)


def at_index(
    time_s: Floats, tooth: Ints, index_time_s: Floats, wheel: Wheel, ratio: float, flags: list[Remark]
) -> tuple[Ints, float, float]:
    """Teeth (pulses,) renumbered by the index marks, the tooth number of a mark, and the teeth between marks.

    A count that slips for good is corrected where all teeth look alike.

    Parameters
    ----------
    time_s : (pulses,), s
    tooth : (pulses,), their numbers on ``wheel``
    index_time_s : (marks,), s, times of a mark on either shaft
    wheel : wheel of the encoder
    ratio : encoder revolutions per crank revolution
    flags : list to which remarks are appended

    Raises InputError where another count of teeth per mark is measured.
    """
    wanted, renumber = (wheel.grid, wheel.grid * ratio), wheel.even
    marks = index_time_s[(index_time_s >= time_s[0]) & (index_time_s <= time_s[-1])]
    if marks.size == 0:
        flags.append(("no_index", "suspect", "no index mark within the pulses: the phase has no reference"))
        return tooth, float("nan"), float(wanted[0])
    place = np.interp(marks, time_s, tooth)
    between = np.round(np.diff(place))
    period = float(wanted[0])
    if between.size >= 2:
        values, counts = np.unique(between, return_counts=True)
        usual = float(values[np.argmax(counts)])
        period = min(wanted, key=lambda count: abs(count - usual))
        if usual != round(period) and counts.max() > 0.5 * between.size:
            problem = f"{usual:.0f} pulses per index measured, {period:g} configured"
            remedy = "Mend pulses_per_rev (or ratio) in run.toml"
            raise InputError(problem, place="encoder.pulses_per_rev", remedy=remedy)
    anchor, slip = _slips(place, period)
    renumbered, slipped, odd = _unslipped(tooth, np.searchsorted(time_s, marks), slip)
    odd |= np.append((np.diff(place) < 0.25 * period) & (np.diff(slip) == 0), False)
    if 2 * odd.sum() > marks.size > 2:
        detail = f"{odd.sum()} of {marks.size} index marks are out of place: the phase has no reference"
        flags.append(("no_index", "suspect", detail))
        return tooth, float("nan"), period
    lost = np.maximum(0, np.round(np.diff(place) / period) - 1).astype(np.int64)
    moved = f"{slipped.sum()} times the index moves against the wheel,"
    moved = f"pulse count put right at {slipped.sum()} index marks," if renumber else moved
    told = (
        ("encoder_slip" if renumber else "index_slip", moved, marks[slipped]),
        ("index_extra", f"{odd.sum()} index marks out of place, left out,", marks[odd]),
        ("index_lost", f"{lost.sum()} index marks missing, filled in, after those", marks[:-1][lost > 0]),
    )
    flags += [(name, "suspect", f"{what} {listed_times(times)}") for name, what, times in told if times.size]
    return renumbered if renumber else tooth, anchor, period


def wrapped(value: Floats, period: float) -> Floats:
    """``value`` (any shape) less whole periods, from -``period`` / 2 to ``period`` / 2; both in one unit."""
    return np.asarray(value - period * np.round(value / period))


def _slips(place: Floats, period: float) -> tuple[float, Floats]:
    """Place of the marks within a period, and by how many whole teeth each mark differs from it."""
    first = place[: max(3, place.size // 10)]
    values, counts = np.unique(np.round(first % period), return_counts=True)
    anchor = float(values[np.argmax(counts)])
    anchor += float(np.median(wrapped(first - anchor, period)))
    off = wrapped(place - anchor, period)
    slip = np.round(off)
    rest = off - slip
    near = np.abs(rest - np.median(rest))
    return anchor + float(np.mean(rest[near <= 4.5 * np.median(near)])), slip


def _unslipped(tooth: Ints, mark_pulse: Ints, slip: Floats) -> tuple[Ints, Bools, Bools]:
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


# A short interval that completes one tooth with its neighbour, within this share of it, was cut by a false pulse.
SPLIT_SHARE = 0.25
# Intervals scatter by chance up to so many standard deviations of their jitter: within them nothing is lost or false.
JITTER_SIGMAS = 6.0
# Median of the absolute value of a normal variable, in standard deviations.
MEDIAN_OF_NORMAL = 0.6745
# A tooth lost at the same place in this share of the revolutions is damage, not chance.
DAMAGE_SHARE = 0.5
# Neighbouring intervals that differ by less than this factor are those of a shaft that runs.
STEADY_RATIO = 1.3
# An interval that would hold more teeth than this at the speed before it is a hole, however fast the shaft slows down.
MOST_COASTED = 6
# So many false pulses between two true ones are a burst of interference, not ringing.
GLITCH_PULSES = 3
# The first tooth is not certain where another choice changes the log of the speed by less than this more in all.
CERTAIN_MARGIN = 1.0
# Speed that changes by more than this from tooth to tooth, in the mean of its logarithm, is none: the wheel is another.
MOST_MISFIT = 0.4


class NumberedTeeth(NamedTuple):
    """Pulses that were kept, each with its tooth number on an endless wheel (lost teeth leave holes in the numbers).

    ``time_s`` (pulses,) are their times [s], ``tooth`` (pulses,) the numbers. ``index_tooth`` is the tooth number,
    possibly between teeth, of a revolution mark: the first tooth behind the gap, the index, or the pulse itself; NaN
    where there is no such mark. ``n_repaired`` counts lost and false pulses. ``teeth_per_rev`` are the even teeth per
    encoder revolution that the numbers count: of the full wheel, or of the grid on which uneven teeth stand;
    ``index_period`` are those from one mark to the next.
    """

    time_s: Floats
    tooth: Ints
    index_tooth: float
    n_repaired: int
    flags: list[Remark]
    teeth_per_rev: int
    index_period: float


def number_teeth(
    time_s: Floats,
    wheel: Wheel,
    *,
    settings: ShaftSettings,
    index_time_s: Floats | None = None,
    ratio: float = 1.0,
    noise_s: float = 0.0,
    gap_starts_s: npt.ArrayLike = (),
) -> NumberedTeeth:
    """Tooth number of every true pulse, after repair, with the place of the revolution mark.

    Parameters
    ----------
    time_s : (pulses,), s, not decreasing
    wheel : wheel of the encoder, as :func:`wheel_of` gives it
    settings : ``double_pulse_ratio`` and ``lost_pulse_ratio`` bound a plausible interval of an even wheel;
        ``max_repaired_fraction`` is where repair ends and refusal begins
    index_time_s : (marks,), s, times of the once-per-revolution mark, or None
    ratio : encoder revolutions per crank revolution; the index may sit on either shaft
    noise_s : standard deviation of one pulse time, s; at few samples per pulse it widens what is plausible
    gap_starts_s : (gaps,), s, where the recording has gaps: what was lost in one counts for no fault of the encoder

    Returns
    -------
    NumberedTeeth with remarks on every repair; the longest run between standstills only.

    Raises
    ------
    InputError for fewer than 3 pulses, times that go back, another wheel or another count between index marks than
    configured, or more repairs than ``max_repaired_fraction`` of the pulses.
    """
    _check_times(time_s)
    (part, *_), flags = running_parts(time_s, pulses_per_rev=wheel.places.size * ratio, gap=wheel.widest_gap)
    time_s = time_s[part]
    _check_times(time_s)
    if wheel.even:
        kept, tooth = _followed_even(time_s, wheel.grid, settings, noise_s)
        certain = wheel.grid == 1
    else:
        followed = followed_from_steady(time_s, wheel)
        if followed.misfit > MOST_MISFIT:
            raise _uncertain(time_s, 0, 0, wheel, settings)
        if gap_is_absent(time_s, followed.kept, followed.count, wheel):
            raise _other_wheel("no gap found in the pulse train", time_s, wheel)
        certain = wheel.repeats == 1 and followed.margin >= CERTAIN_MARGIN
        kept, tooth = ends_put_right(time_s, followed.kept, followed.count, wheel)
    kept_time = time_s[kept] if kept.size < time_s.size else time_s
    n_false = _flag_false(time_s, kept, flags)
    index_tooth, index_period = 0.0 if certain else np.nan, float(wheel.grid)
    if not (certain or wheel.even):
        name, why = "tooth_phase_uncertain", "too few revolutions tell which tooth is the first"
        if wheel.repeats > 1:
            name, why = "no_index", f"the wheel looks the same {wheel.repeats} times per revolution"
        flags.append((name, "suspect", f"{why}: its phase has no reference"))
    if index_time_s is not None:
        tooth, index_tooth, index_period = at_index(kept_time, tooth, index_time_s, wheel, ratio, flags)
        # where a count was put right, the pulses that it counted twice are left out
        new = np.diff(np.maximum.accumulate(tooth), prepend=tooth[0] - 1) > 0
        kept_time, tooth = kept_time[new], tooth[new]
    lost = _lost_teeth(tooth, wheel)
    unsure = n_false + lost.size > 0 and not certain and wheel.repeats == 1
    if not wheel.even and (unsure or _differs_each_turn(np.delete(time_s, kept), kept_time, tooth, lost, wheel)):
        raise _uncertain(time_s, lost.size, n_false, wheel, settings)
    _flag_lost(lost, kept_time, tooth, wheel, index_tooth, flags)
    in_gap = np.isin(np.searchsorted(tooth, lost), np.searchsorted(kept_time, gap_starts_s))
    if n_false + np.count_nonzero(~in_gap) > settings.max_repaired_fraction * time_s.size:
        raise _uncertain(time_s, lost.size, n_false, wheel, settings)
    if not wheel.even:
        true = ~displaced_teeth(kept_time, tooth, wheel, flags)
        tooth = tooth[true]
        kept_time = times_on_grid(kept_time[true], tooth, wheel)
    return NumberedTeeth(kept_time, tooth, index_tooth, n_false + lost.size, flags, wheel.grid, index_period)


def _followed_even(time_s: Floats, teeth: int, settings: ShaftSettings, noise_s: float) -> tuple[Ints, Ints]:
    """Pulses that are true and the number of the tooth of each, on a wheel of even teeth."""
    window = max(2, min(8, teeth // 8))
    slack_s = noise_s * math.sqrt(12.0)
    step = np.diff(time_s)
    near = step[: 4 * window + 8]
    usual = float(np.median(near))
    reach = JITTER_SIGMAS * math.sqrt(2.0) * _jitter(step)
    double, lost = min(settings.double_pulse_ratio, 1.0 - reach), max(settings.lost_pulse_ratio, 1.0 + reach)
    ratios = (double, lost, min(1.0 + SPLIT_SHARE, 2.0 - reach))

    def counted(times: Floats, recent: Floats) -> tuple[Ints, Ints]:
        kept, tooth = np.zeros(times.size, dtype=np.int64), np.zeros(times.size, dtype=np.int64)
        n = _count(times, recent, *ratios, slack_s, kept, tooth)
        return kept[:n], tooth[:n]

    steady = bool(near.max() < STEADY_RATIO * usual)
    start = -1 if steady else _steady_start(step, window)
    if start < 0:
        return counted(time_s, np.full(window, usual))
    # a start from rest looks like lost pulses beside the median of what follows, but not counted back from there
    after, number = counted(time_s[start:], np.full(window, step[start]))
    before, back = counted(-time_s[start::-1], step[start : start + window][::-1].copy())
    kept = np.concatenate([start - before[:0:-1], start + after])
    return kept, np.concatenate([-back[:0:-1], number]) + back[-1]


def _jitter(step: Floats) -> float:
    """Standard deviation of a pulse as a share of the interval ``step`` (intervals,), lost and false ones apart."""
    if step.size < 3:
        return 0.0
    change = np.abs(np.diff(step)) / np.maximum(0.5 * (step[1:] + step[:-1]), np.finfo(np.float64).tiny)
    return float(np.median(change)) / (MEDIAN_OF_NORMAL * math.sqrt(6.0))


def _steady_start(step: Floats, window: int) -> int:
    """First pulse from which a few neighbouring intervals are alike, best the first and the last of them too; else -1.

    Of a start from rest the neighbours are alike early, but their mean is not yet the time of the next tooth.
    """
    log_step, length = np.log(np.maximum(step, 1e-12)), window + 1
    alike = np.abs(np.diff(log_step)) < math.log(STEADY_RATIO)
    if alike.size < length:
        return -1
    runs = np.convolve(alike, np.ones(length), mode="valid") > length - 0.5
    even = runs & (np.abs(log_step[length:] - log_step[:-length]) < math.log(STEADY_RATIO))
    steady = np.flatnonzero(even if even.any() else runs)
    return int(steady[0]) if steady.size else -1


def _uncertain(time_s: Floats, n_lost: int, n_false: int, wheel: Wheel, settings: ShaftSettings) -> InputError:
    seen = f"{n_lost} pulses lost and {n_false} false of {time_s.size}" if n_lost + n_false else "no steady speed"
    problem = f"{seen}: the count is not certain"
    if not wheel.even:
        return _other_wheel(problem, time_s, wheel)
    allowed = f"{settings.max_repaired_fraction:.0%} repaired"
    remedy = "Check pulses_per_rev, missing_teeth and edge in run.toml, and the sensor's gap and cable"
    return InputError(problem, place="encoder", allowed=allowed, remedy=remedy)


def _other_wheel(problem: str, time_s: Floats, wheel: Wheel) -> InputError:
    """The error of pulses that do not fit the ``wheel``; it names the wheel that they do fit, where they tell."""
    pattern = find_pattern(time_s)
    found = "" if pattern is None else f"a wheel {pattern.told}"
    allowed = f"a {wheel.name} wheel of {wheel.places.size} pulses per revolution"
    remedy = "Mend the wheel (pattern, pulses_per_rev, missing_teeth) or the edge in run.toml, or the sensor's gap"
    return InputError(problem, place="encoder", found=found, allowed=allowed, remedy=remedy)


def _check_times(time_s: Floats) -> None:
    if time_s.size < 3:
        raise InputError("too few encoder pulses", found=time_s.size, allowed="3 or more", remedy="Record longer")
    bad = np.flatnonzero(~(time_s[1:] >= time_s[:-1]))
    if bad.size or not np.isfinite(time_s[0]):
        at = int(bad[0]) + 1 if bad.size else 0
        problem, found = "pulse times go back or are not finite", f"{time_s[at]!r} s after {time_s[max(at - 1, 0)]!r} s"
        remedy = "Mend the counter's roll-over, or leave the recording out"
        raise InputError(problem, place=f"encoder pulse {at}", found=found, remedy=remedy)


@njit(cache=True, nogil=True, error_model="numpy")
def _count(time_s, recent, double_ratio, lost_ratio, whole_ratio, slack_s, kept, tooth):  # type: ignore[no-untyped-def]
    """Fill in which pulses are ``kept`` and the number of the ``tooth`` of each one of them; how many they are.

    The time of one tooth is followed as the mean over ``recent``, the last few intervals, the oldest first.
    """
    n, window, m, slot, count, last = time_s.size, recent.size, 1, 0, 0, time_s[0]
    share, total = 1.0 / window, 0.0
    for interval in recent:
        total += interval
    for i in range(1, n):
        tooth_s, interval = total * share, time_s[i] - last
        teeth = 1
        if interval > lost_ratio * tooth_s + slack_s:
            teeth = int(interval / tooth_s + 0.5)
            teeth = teeth if teeth > 1 else 1
            if teeth <= MOST_COASTED and _coasts(recent, slot, interval):
                teeth = 1
            interval /= teeth
        elif interval < (1.0 - SPLIT_SHARE) * tooth_s - slack_s:
            if interval < double_ratio * tooth_s - slack_s or interval <= 0.0:
                if m > 1:
                    expected = time_s[kept[m - 2]] + (count - tooth[m - 2]) * tooth_s
                    if abs(time_s[i] - expected) < abs(last - expected):
                        kept[m - 1], last = i, time_s[i]
                continue
            if i + 1 < n and time_s[i + 1] - last < whole_ratio * tooth_s:
                continue
        elif interval <= 0.0:
            continue
        count += teeth
        kept[m], tooth[m] = i, count
        m += 1
        last = time_s[i]
        total += interval - recent[slot]
        recent[slot] = interval
        slot += 1
        if slot == window:
            slot = 0
    return m


@njit(inline="always")
def _coasts(recent, slot, interval):  # type: ignore[no-untyped-def]
    """Whether a shaft that goes on slowing down as in the ``recent`` intervals turns but one tooth in ``interval``.

    ``slot`` is the oldest of them. The speed goes on falling evenly in time, to zero at the last.
    """
    n = recent.size
    half = n // 2
    older = newer = 0.0
    for k in range(half):
        older += recent[(slot + k) % n]
        newer += recent[(slot + n - half + k) % n]
    middle = 0.0
    for k in range(half, n - half):
        middle += recent[(slot + k) % n]
    slower = (half / older - half / newer) / (0.5 * (older + newer) + middle)
    if not slower > 0.0:
        return False
    speed = half / newer - slower * 0.5 * newer
    if not speed > 0.0:
        return True
    time = min(interval, speed / slower)
    return speed * time - 0.5 * slower * time * time < 1.5


def _flag_false(time_s: Floats, kept: Ints, flags: list[Remark]) -> int:
    """Remarks on false pulses, single and in bursts; their number."""
    if time_s.size == kept.size:
        return 0
    false = np.setdiff1d(np.arange(time_s.size), kept)
    detail = f"{false.size} false pulses removed, {listed_times(time_s[false])}"
    flags.append(("encoder_double_pulse", "suspect", detail))
    runs = np.split(false, np.flatnonzero(np.diff(false) > 1) + 1)
    bursts = np.array([time_s[run[0]] for run in runs if run.size >= GLITCH_PULSES])
    if bursts.size:
        detail = f"{bursts.size} bursts of {GLITCH_PULSES} false pulses or more, {listed_times(bursts)}"
        flags.append(("encoder_glitch", "suspect", detail))
    return false.size


def _lost_teeth(tooth: Ints, wheel: Wheel) -> Ints:
    """Numbers of the teeth without a pulse, those that the wheel does not have left out."""
    silent = np.ones(tooth[-1] - tooth[0] + 1, dtype=np.bool_)
    silent[tooth - tooth[0]] = False
    lost: Ints = tooth[0] + np.flatnonzero(silent)
    return lost[np.isin(lost % wheel.grid, wheel.places)]


def _differs_each_turn(false_s: Floats, time_s: Floats, tooth: Ints, lost: Ints, wheel: Wheel) -> bool:
    """Whether most turns show a tooth more in a gap, or one less beside it: then the pulses are those of another wheel.

    ``false_s``: (false pulses,), s. ``time_s`` and ``tooth``: (pulses,), of the true ones. ``lost``: teeth without any.
    """
    place = np.interp(false_s, time_s, tooth)
    whole = np.round(place).astype(np.int64)
    extra = whole[np.abs(place - whole) < WHOLE_TEETH]
    first, last = (~np.isin((lost + way) % wheel.grid, wheel.places) for way in (-1, 1))
    behind = lost + wheel.spans[np.searchsorted(wheel.places, lost % wheel.grid)]
    shown = np.concatenate([np.unique(extra), lost[first], behind[last]])
    each = [shown[shown % wheel.grid == gap] for gap in np.unique(shown % wheel.grid)]
    most = DAMAGE_SHARE * (tooth[-1] - tooth[0]) / wheel.grid
    return any(own.size >= most and np.unique(own).size > 1 for own in each)


def _flag_lost(lost: Ints, time_s: Floats, tooth: Ints, wheel: Wheel, index_tooth: float, flags: list[Remark]) -> None:
    """Remarks on lost teeth: how many and when, and those that are lost again and again at the same angle."""
    if lost.size == 0:
        return
    when = listed_times(np.interp(lost, tooth, time_s))
    flags.append(("encoder_missing_pulse", "suspect", f"{lost.size} lost pulses filled in, {when}"))
    revs = (tooth[-1] - tooth[0]) / wheel.grid
    places, counts = np.unique(lost % wheel.grid, return_counts=True)
    damaged = places[(counts >= 3) & (counts >= DAMAGE_SHARE * revs)]
    if damaged.size and wheel.grid > 1:
        known = np.isfinite(index_tooth)
        angle = (damaged - (index_tooth if known else 0.0)) * 360.0 / wheel.grid % 360.0
        listed = ", ".join(f"{value:.2f}" for value in angle[:5])
        after = "the index" if known else "the first pulse"
        detail = f"pulse lost in most revolutions at {listed} degrees after {after} (a wheel with missing teeth?)"
        flags.append(("encoder_damaged_line", "suspect", detail))


def stated_wheel(recording: xr.Dataset) -> tuple[Wheel, list[Remark]]:
    """The wheel of the Recording ``recording``, found from the pulses where nothing states it, and remarks on that.

    Its ``pulse_time`` (pulse) [s] is read. Raises InputError where it holds no pulse times, or where nothing states the
    wheel and the pulses do not tell it.
    """
    if "pulse_time" not in recording.variables:
        problem = "the recording holds no pulse times"
        raise InputError(problem, place="encoder", remedy="Check the encoder's source in run.toml")
    attrs, pulse_s = recording.attrs, recording.variables["pulse_time"].values.astype(np.float64)
    if "tooth_angles_deg" in attrs:
        angles = tuple(float(angle) for angle in np.atleast_1d(attrs["tooth_angles_deg"]))
        return wheel_of(len(angles), tooth_angles_deg=angles), []
    if "pulses_per_rev" in attrs:
        return wheel_of(int(attrs["pulses_per_rev"]), int(attrs.get("missing_teeth", 0))), []
    # a gap hides pulses, again and again: between gaps the wheel shows itself
    between = max(np.split(pulse_s, np.searchsorted(pulse_s, attrs.get("gap_starts_s", []))), key=len)
    found = find_pattern(between, index_time_s=times_of(recording, "index_time"))
    if found is None:
        problem = "nothing states the pulses per revolution, and the pulses do not tell: they are even, or too few"
        remedy = "State pulses_per_rev, pattern or tooth_angles_deg in run.toml, or name the index"
        raise InputError(problem, place="encoder.pulses_per_rev", found=f"{between.size} pulses", remedy=remedy)
    remark: Remark = ("encoder_pattern_found", "suspect", f"wheel found from the pulses: {found.told}; state it")
    angles = found.pattern.angles_deg
    return wheel_of(len(angles), tooth_angles_deg=angles), [remark]


def undersampled(recording: xr.Dataset, teeth: NumberedTeeth) -> list[Remark]:
    """Remark where the sampled encoder of the Recording ``recording`` (channel, time) has too few samples per tooth.

    ``teeth`` are its numbered pulses; at most one remark is returned.
    """
    if recording.attrs.get("encoder_kind") not in ("square", "analogue") or "rate_hz" not in recording.attrs:
        return []
    steps = np.diff(teeth.time_s) * float(recording.attrs.get("encoder_rate_hz", recording.attrs["rate_hz"]))
    if steps.min() >= FEWEST_SAMPLES_PER_TOOTH or (fewest := np.quantile(steps, 0.02)) >= FEWEST_SAMPLES_PER_TOOTH:
        return []
    start = float(teeth.time_s[int(np.argmax(steps < FEWEST_SAMPLES_PER_TOOTH))])
    detail = f"only {fewest:.1f} samples per tooth, first at {start:.3g} s: teeth pass unseen; sample faster"
    return [("encoder_undersampled", "bad", detail)]


def times_of(recording: xr.Dataset, name: str) -> Floats | None:
    """Times [s] (events,) that the variable ``name`` of ``recording`` holds; None where there is no such variable."""
    return recording.variables[name].values.astype(np.float64) if name in recording.variables else None
