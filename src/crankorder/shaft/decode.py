"""ShaftAngle from a Recording, for every kind of encoder; a mark on the camshaft tells which dead centre fires."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import xarray as xr

from crankorder.errors import InputError, located
from crankorder.quantities import (
    Attribute,
    Floats,
    QualityFlag,
    ShaftAngle,
    check_dataset,
    described,
    with_flags,
)
from crankorder.settings import ShaftSettings
from crankorder.shaft.angle import AngleKnots, angle_at, angle_knots, integrated_speed
from crankorder.shaft.pulses import Remark, listed_times
from crankorder.shaft.repair import FEW_PULSES, running_parts
from crankorder.shaft.speeds import swing_remarks
from crankorder.shaft.tooth_errors import stated_teeth, tooth_errors, tooth_remark, without_tooth_errors
from crankorder.shaft.uneven_wheel import Wheel
from crankorder.shaft.wheel import NumberedTeeth, number_teeth, stated_wheel, times_of, undersampled, wrapped

# Marks are the same tooth of the camshaft within this much of a crank revolution: variable timing moves it by 0.14.
SAME_MARK_REV = 0.1
# One tooth per cycle leads all others, if there are any, by this share of the cycles.
LEAD_SHARE = 0.25
# A stated cam_to_tdc_deg that misses every top dead centre by more than this is wrong.
MISSED_TDC_REV = 0.1


def cam_mark(place_rev: Floats, time_s: Floats) -> tuple[float, list[Remark]]:
    """Place [rev] of the cam mark in the cycle of two crank revolutions, by the majority of the cycles, and remarks.

    It is NaN where the marks do not tell it; the remarks say why, and which marks are lost or extra. ``place_rev``
    (marks,) is the crank angle [rev] of the marks, NaN where it is not known, ``time_s`` (marks,) are their times [s]
    for the remarks.
    """
    known = np.isfinite(place_rev)
    place, time_s = place_rev[known], time_s[known]
    if place.size == 0:
        return math.nan, [("no_cam", "suspect", "no cam mark while the crank angle is known")]
    cycles = max(1.0, (place[-1] - place[0]) / 2.0)
    away = np.abs(wrapped(place[:, None] - place[None, :500], 2.0))
    votes = np.sum(away < SAME_MARK_REV, axis=0)
    first = int(np.argmax(votes))
    away_rev = wrapped(place - place[first], 2.0)
    own = np.abs(away_rev) < SAME_MARK_REV
    centre = float(place[first] + np.median(away_rev[own]))
    rest = place[~own]
    rival = int(np.sum(np.abs(wrapped(rest - centre - 1.0, 2.0)) < SAME_MARK_REV))
    if own.sum() - rival < LEAD_SHARE * cycles or own.sum() < 0.5 * cycles:
        detail = (
            f"{own.sum()} cam marks at one place of the cycle, {rival} a crank revolution from it, {rest.size} in all "
            "elsewhere: the cycle phase is not known"
        )
        return math.nan, [("cam_unclear", "suspect", detail)]
    extra = ~own
    extra[np.flatnonzero(own)[1:][np.diff(place[own]) < 1.0]] = True
    missing = np.maximum(0, np.round(np.diff(place[own]) / 2.0) - 1).astype(np.int64)
    told = (
        ("cam_extra", f"{extra.sum()} cam marks out of place or doubled, left out,", time_s[extra]),
        ("cam_lost", f"{missing.sum()} cam marks missing, after those", time_s[own][:-1][missing > 0]),
    )
    return centre % 2.0, [(name, "suspect", f"{what} {listed_times(at_s)}") for name, what, at_s in told if at_s.size]


def firing_tdc(mark_rev: float, tdc_rev: float, cam_to_tdc_deg: float | None) -> tuple[float, list[Remark]]:
    """Crank angle [rev] of the firing top dead centre, and remarks.

    Parameters
    ----------
    mark_rev : rev, place of the cam mark in the cycle
    tdc_rev : rev, place of any top dead centre, NaN where only the cam tells it
    cam_to_tdc_deg : deg, crank angle from the mark to the firing top dead centre; None where it is not stated: then it
        is the next one after the mark, or the mark itself
    """
    not_stated = "cam_to_tdc_deg is not stated: the cycle starts with the next dead centre"
    flags: list[Remark] = [("cycle_from_cam", "info", not_stated)] if cam_to_tdc_deg is None else []
    if not np.isfinite(tdc_rev):
        return mark_rev + (cam_to_tdc_deg or 0.0) / 360.0, flags
    if cam_to_tdc_deg is None:
        return tdc_rev + float(np.ceil(mark_rev - tdc_rev - 0.01)), flags
    wanted = mark_rev + cam_to_tdc_deg / 360.0
    turns = float(np.round(wanted - tdc_rev))
    missed = wanted - tdc_rev - turns
    if abs(missed) <= MISSED_TDC_REV:
        return tdc_rev + turns, []
    detail = f"cam mark and cam_to_tdc_deg point {360.0 * missed:+.0f} degrees beside a top dead centre"
    return tdc_rev + turns, [("cam_off", "suspect", detail)]


# Jitter so many times the noise of sampling is worth a remark.
JITTER_RATIO = 1.5
QUANTISED_SAMPLES = 0.2
"""Pulse noise from which it is that of whole samples (0.29 of one)."""
PULSE_KINDS = ("square", "analogue", "angle", "count", "pulse_times", "edge_list")


def shaft_angle(recording: xr.Dataset, *, settings: ShaftSettings) -> ShaftAngle:
    """Crank angle and speed of one recording on time knots, with the standard error of the angle and quality flags.

    Parameters
    ----------
    recording : Recording (channel, time or crank_angle) of ``data_schema/recording.json``; the knots are on the clock
        of its samples, the first of which is at ``start_s``
    settings : how pulses become angle

    Raises
    ------
    InputError naming the recording where its encoder cannot be decoded or it has none, unless nothing turns at all:
    then the angle stays 0 and the speed is NaN.
    """
    name = str(recording.attrs["recording"])
    with located(name):
        if recording.attrs["domain"] == "crank_angle":
            return _dataset(recording, _sampled_by_angle(recording), "tdc", 0, [])
        kind = str(recording.attrs["encoder_kind"])
        if kind in PULSE_KINDS:
            return _from_pulses(recording, settings)
        if kind == "speed":
            return _from_speed(recording, settings)
        if kind == "constant":
            speed_rpm = float(recording.attrs.get("speed_rpm", np.nan))
            if not speed_rpm > 0.0:
                problem, remedy = "the constant speed is not known", "State speed_rpm in run.toml"
                raise InputError(problem, place="encoder", found=f"{speed_rpm:g} rpm", remedy=remedy)
            return _dataset(recording, _at_constant_speed(recording, speed_rpm), "none", 0, [_NO_PHASE])
        if kind == "vibration":
            return _from_vibration(recording, settings)
        if not recording.attrs.get("has_shaft", 1):
            still = _dataset(recording, _at_constant_speed(recording, np.nan), "none", 0, [])
            still.attrs["has_shaft"] = 0
            return still
    problem, kinds = "no encoder, so no crank angle", ", ".join((*PULSE_KINDS, "speed", "constant", "vibration"))
    remedy = 'Name the encoder, a speed channel or a constant speed_rpm in run.toml; a structure has cycle = "none"'
    raise InputError(problem, file=name, place="encoder.kind", found=kind, allowed=kinds, remedy=remedy)


def flags_named(recording: str, remarks: Iterable[Remark]) -> list[QualityFlag]:
    """Quality flags of the ``recording`` of that name from ``remarks``: (flag, severity, detail)."""
    return [QualityFlag(recording=recording, flag=flag, severity=how, detail=text) for flag, how, text in remarks]


def _from_pulses(recording: xr.Dataset, settings: ShaftSettings) -> ShaftAngle:
    """Angle of all runs between standstills: each is decoded by itself, then they are laid on one angle."""
    wheel, remarks = stated_wheel(recording)
    pulse_s = recording.variables["pulse_time"].values.astype(np.float64, copy=False)
    per_rev = wheel.places.size * float(recording.attrs.get("ratio", 1.0))
    parts, left_out = [slice(None)], list[Remark]()
    if pulse_s.size > 2 and (np.diff(pulse_s) >= 0.0).all():
        parts, left_out = running_parts(pulse_s, pulses_per_rev=per_rev, gap=wheel.widest_gap, joined=True)
    runs: list[_PulseRun] = []
    # at rest a few pulses come further and further apart, which no even smoothing follows
    smooth = len(parts) == 1 or wheel.places.size > FEW_PULSES
    for part in parts:
        try:
            run = _from_run(recording, settings, wheel, part, smooth=smooth)
        except InputError:
            if len(parts) == 1 or part.stop - part.start == max(other.stop - other.start for other in parts):
                raise
            span = f"from {pulse_s[part.start]:.6g} to {pulse_s[part.stop - 1]:.6g} s"
            left_out.append(("encoder_part_unused", "suspect", f"the run {span} cannot be counted: left out"))
            continue
        runs.append(run)
    knots = joined(runs, per_rev)
    if len(runs) > 1 and any(run.reference == "none" for run in runs):
        detail = "no mark tells the angle again after the standstill: between the runs the pulses are counted"
        left_out.append(("standstill_phase", "info", detail))
    return _shaft_of(recording, runs, knots, [*remarks, *left_out], settings)


@dataclass(frozen=True)
class ShaftRun:
    """Knots of one run between standstills, the times of its first and last pulse, and how its angle is known.

    ``first`` and ``last`` number these pulses among all of the recording; ``period_rev`` are the turns after which its
    mark comes again, 0 where it has none.
    """

    knots: AngleKnots
    ends_s: tuple[float, float]
    first: int
    last: int
    period_rev: float


@dataclass(frozen=True)
class _PulseRun(ShaftRun):
    """A run with its teeth, what the angle of its knots from top dead centre rests on, remarks, and errors of teeth."""

    teeth: NumberedTeeth
    cycle_known: bool
    reference: str
    remarks: list[Remark]
    teeth_stated: dict[str, Attribute]


def _from_run(recording: xr.Dataset, settings: ShaftSettings, wheel: Wheel, part: slice, *, smooth: bool) -> _PulseRun:
    attrs, pulse_s = recording.attrs, recording.variables["pulse_time"].values[part].astype(np.float64, copy=False)
    stated, ratio = float(attrs.get("pulse_noise_s", 0.0)), float(attrs.get("ratio", 1.0))
    marks, gaps = times_of(recording, "index_time"), attrs.get("gap_starts_s", ())
    teeth = number_teeth(
        pulse_s, wheel, settings=settings, index_time_s=marks, ratio=ratio, noise_s=stated, gap_starts_s=gaps
    )
    cycle = int(attrs["revs_per_cycle"])
    wrong = tooth_errors(teeth, ratio=ratio, revs_per_cycle=cycle, noise_s=stated, settings=settings)
    if wrong is not None:
        teeth = without_tooth_errors(teeth, wrong)
    teeth_per_rev = teeth.teeth_per_rev * ratio
    noise = stated or None
    knots = angle_knots(
        teeth.time_s, teeth.tooth, teeth_per_rev=teeth_per_rev, noise_s=noise, settings=settings, smooth_times=smooth
    )
    tdc, cycle_known, reference, flags = _tdc(teeth, teeth_per_rev, recording)
    remarks = [*teeth.flags, *flags]
    if wrong is not None:
        left_rev = wrong.standard_error_rev / ratio
        knots = knots._replace(standard_error_rev=np.hypot(knots.standard_error_rev, left_rev))
        remarks.append(tooth_remark(wrong, teeth.teeth_per_rev, ratio))
    if stated > 0.0 and knots.noise_s > JITTER_RATIO * stated:
        share = knots.noise_s / float(np.median(np.diff(teeth.time_s)))
        detail = f"pulses jitter by {share:.2g} of their distance, more than their sampling"
        remarks.append(("encoder_jitter", "info", detail))
    remarks += undersampled(recording, teeth)
    period = int(attrs["revs_per_cycle"]) if cycle_known else 1
    turns = period * np.ceil((teeth.tooth[0] / teeth_per_rev - tdc) / period - 1e-9)
    knots = knots._replace(angle_rev=knots.angle_rev - tdc - turns)
    known = stated_teeth(wrong, ratio=ratio, tdc_rev=tdc)
    ends_s = (float(teeth.time_s[0]), float(teeth.time_s[-1]))
    first, last = ((part.start or 0) + np.searchsorted(pulse_s, ends_s)).tolist()
    returns = 0.0 if reference == "none" else float(period)
    return _PulseRun(knots, ends_s, first, last, returns, teeth, cycle_known, reference, remarks, known)


def _shaft_of(
    recording: xr.Dataset, runs: list[_PulseRun], knots: AngleKnots, remarks: list[Remark], settings: ShaftSettings
) -> ShaftAngle:
    """ShaftAngle on the ``knots`` of all ``runs``, which knows of its phase what each of them knows.

    ``settings``: of what swing of the speed is more than a shaft can.
    """
    attrs = recording.attrs
    teeth, stated = runs[0].teeth, float(attrs.get("pulse_noise_s", 0.0))
    for run in runs:
        remarks += [remark for remark in run.remarks if remark not in remarks]
    reference = "none" if any(run.reference == "none" for run in runs) else runs[0].reference
    n_pulses, cycle_known = sum(run.teeth.time_s.size for run in runs), all(run.cycle_known for run in runs)
    shaft = _dataset(recording, knots, reference, n_pulses, remarks, cycle_known=cycle_known)
    rounded = stated > QUANTISED_SAMPLES / float(attrs.get("encoder_rate_hz", attrs.get("rate_hz", np.inf)))
    shaft.attrs["teeth_per_rev"] = teeth.teeth_per_rev * float(attrs.get("ratio", 1.0))
    shaft.attrs["cut_off_order"] = knots.cut_off_order
    shaft.attrs["edge_step_s"] = math.sqrt(12.0) * stated if rounded else 0.0
    shaft.attrs |= runs[0].teeth_stated
    return ShaftAngle(with_flags(shaft, flags_named(str(attrs["recording"]), swing_remarks(shaft, settings))))


def _tdc(teeth: NumberedTeeth, teeth_per_rev: float, recording: xr.Dataset) -> tuple[float, bool, str, list[Remark]]:
    """Angle [rev] of a top dead centre where that of tooth 0 is 0; whether it fires; what it rests on; remarks."""
    attrs, flags = recording.attrs, list[Remark]()
    turns = 1.0 / float(attrs.get("ratio", 1.0))
    if np.isfinite(teeth.index_tooth) and abs(turns - round(turns)) > 1e-9:
        often = f"the encoder turns {1.0 / turns:g} times per crank revolution"
        flags.append(("index_not_on_crank", "suspect", f"{often}: its mark is at top dead centre only once"))
    tdc = teeth.index_tooth / teeth_per_rev + float(attrs.get("index_to_tdc_deg", 0.0)) / 360.0
    stated = "index_to_tdc_deg" in attrs
    # a mark on the camshaft itself, as of an encoder there
    cycle_known = abs(teeth.index_period / teeth_per_rev - int(attrs["revs_per_cycle"])) < 1e-9
    cycle_known |= int(attrs["revs_per_cycle"]) == 1
    cam_s = times_of(recording, "cam_time")
    if cam_s is not None and not cycle_known:
        place = np.interp(cam_s, teeth.time_s, teeth.tooth / teeth_per_rev, left=np.nan, right=np.nan)
        mark_rev, mark_flags = cam_mark(place, cam_s)
        flags += mark_flags
        if np.isfinite(mark_rev):
            to_tdc = float(attrs["cam_to_tdc_deg"]) if "cam_to_tdc_deg" in attrs else None
            stated |= not np.isfinite(tdc) and to_tdc is not None
            tdc, cam_flags = firing_tdc(mark_rev, tdc, to_tdc)
            flags, cycle_known = flags + cam_flags, True
    if not np.isfinite(tdc):
        if not any(flag == "no_index" for flag, _, _ in teeth.flags):
            detail = "no once-per-revolution mark: orders yes, but their phase has no reference"
            flags.append(("no_index", "suspect", detail))
        return float(teeth.tooth[0]) / teeth_per_rev, cycle_known, "none", flags
    if not cycle_known:
        detail = "which top dead centre fires is not known: half orders may be turned by 180°"
        flags.append(("cycle_phase_unknown", "info", detail))
    single = teeth.teeth_per_rev == 1 and "index_time" not in recording.variables and cam_s is None
    if attrs.get("zero_counted"):
        detail = "no index sets the count to 0: its zero, from which phases count, is another in each recording"
        return tdc, cycle_known, "count", [*flags, ("no_index", "suspect", detail)]
    return tdc, cycle_known, "tdc" if stated else "pulse" if single else "index", flags


def _from_speed(recording: xr.Dataset, settings: ShaftSettings) -> ShaftAngle:
    if "speed_signal" not in recording.variables:
        problem = "the recording holds no speed signal"
        raise InputError(problem, place="encoder", remedy="Check the encoder's source in run.toml")
    rate_hz = float(recording.attrs.get("encoder_rate_hz", recording.attrs["rate_hz"]))
    signal, start_s = recording.variables["speed_signal"].values, float(recording.attrs.get("encoder_start_s", 0.0))
    knots, flags = integrated_speed(signal, rate_hz=rate_hz, settings=settings, start_s=start_s)
    per_rev = 2.0 / settings.speed_lowpass_rev
    parts, stops = running_parts(knots.time_s, pulses_per_rev=per_rev, joined=True, lossless=True)
    runs = []
    for part in parts:
        time_s, angle_rev, error_rev = knots.time_s[part], knots.angle_rev[part], knots.standard_error_rev[part]
        speed_rpm = 60.0 * np.gradient(angle_rev, time_s)
        run = AngleKnots(time_s, angle_rev, speed_rpm, error_rev, knots.cut_off_order, knots.noise_s)
        runs.append(ShaftRun(run, (float(time_s[0]), float(time_s[-1])), part.start, part.stop - 1, 0.0))
    flags += [remark for remark in stops if remark[0] == "standstill"]
    return _dataset(recording, joined(runs, per_rev), "none", 0, [*flags, _NO_PHASE])


def _from_vibration(recording: xr.Dataset, settings: ShaftSettings) -> ShaftAngle:
    """Angle from the orders that the vibration itself shows: for a machine without any other reference."""
    from crankorder.shaft.vibration_speed import FOUR_STROKE_WEIGHTS, speed_from_vibration, trusted_angle

    attrs = recording.attrs
    expected = attrs.get("expected_rpm")
    rpm = None if expected is None else (float(expected[0]), float(expected[1]))
    weights = FOUR_STROKE_WEIGHTS if int(attrs["revs_per_cycle"]) == 2 else None
    signals, rate_hz = recording.variables["signal"].values, float(attrs["rate_hz"])
    vibration = speed_from_vibration(signals, rate_hz, settings=settings, expected_rpm=rpm, order_weights=weights)
    return _dataset(recording, trusted_angle(vibration), "none", 0, [*vibration.remarks, _BY_VIBRATION])


def _at_constant_speed(recording: xr.Dataset, speed_rpm: float) -> AngleKnots:
    """Two knots, at the begin and end of ``recording``; the angle stays 0 where the speed is NaN."""
    time_s = np.array([0.0, recording.variables["signal"].shape[1] / float(recording.attrs["rate_hz"])])
    angle_rev = np.nan_to_num(time_s * speed_rpm / 60.0)
    return AngleKnots(time_s, angle_rev, np.full(2, speed_rpm), np.full(2, np.nan), np.nan, np.nan)


_NO_PHASE: Remark = ("no_index", "suspect", "no encoder pulses: orders yes, but their phase has no reference")
_BY_VIBRATION: Remark = ("no_index", "suspect", f"{_NO_PHASE[2]}, and the speed is taken from the vibration")


def _sampled_by_angle(recording: xr.Dataset) -> AngleKnots:
    attrs = recording.attrs
    revs = (recording.variables["signal"].shape[1] - 1) / float(attrs["samples_per_rev"])
    angle = float(attrs.get("start_deg", 0.0)) / 360.0 + np.array([0.0, revs])
    speed = float(attrs.get("speed_rpm", np.nan))
    return AngleKnots((angle - angle[0]) * 60.0 / speed, angle, np.full(2, speed), np.zeros(2), np.nan, np.nan)


def _dataset(
    recording: xr.Dataset,
    knots: AngleKnots,
    reference: str,
    n_pulses: int,
    remarks: list[Remark],
    *,
    cycle_known: bool = False,
) -> ShaftAngle:
    """The ShaftAngle dataset, signed in its history."""
    name = str(recording.attrs["recording"])
    start_s = float(recording.attrs.get("start_s", 0.0))
    columns = {
        "time": described("knot", knots.time_s + start_s, "s", "time of the knot"),
        "crank_angle": described("knot", knots.angle_rev, "rev", "crank angle from top dead centre"),
        "speed": described("knot", knots.speed_rpm, "min-1", "crank speed"),
        "standard_error": described("knot", knots.standard_error_rev, "rev", "standard error of the crank angle"),
    }
    signed = f"shaft: {knots.time_s.size} knots from {n_pulses} pulses, angle 0 is {reference}"
    attrs = {
        "recording": name,
        "phase_reference": reference,
        "cycle_known": int(cycle_known or int(recording.attrs["revs_per_cycle"]) == 1),
        "revs_per_cycle": int(recording.attrs["revs_per_cycle"]),
        "n_pulses": n_pulses,
        "domain": str(recording.attrs["domain"]),
        "history": f"{recording.attrs.get('history', '')}\n{signed}".lstrip(),
    }
    shaft = with_flags(xr.Dataset(columns, attrs=attrs), flags_named(name, remarks))
    check_dataset(shaft, "shaft_angle")
    return ShaftAngle(shaft)


STEP_SHARE = 1e-3
"""Share of a knot interval over which the speed at a pulse is differenced."""


def joined(runs: Sequence[ShaftRun], teeth_per_rev: float) -> AngleKnots:
    """Knots of all ``runs`` one after the other, on the angle of the first.

    Between two runs the shaft turns by the pulses there, of which ``teeth_per_rev`` make a revolution, to the nearest
    angle that agrees with the mark, where there is one; it is taken to slow down evenly, stand and speed up.
    """
    knots = _within(runs[0].knots, -np.inf, runs[0].ends_s[1]) if len(runs) > 1 else runs[0].knots
    for before, run in pairwise(runs):
        own = _within(run.knots, run.ends_s[0], np.inf if run is runs[-1] else run.ends_s[1])
        turned = (run.first - before.last) / teeth_per_rev
        shift = knots.angle_rev[-1] + turned - own.angle_rev[0]
        if run.period_rev > 0.0:
            shift = run.period_rev * np.round(shift / run.period_rev)
        laid = own._replace(angle_rev=own.angle_rev + float(shift))
        # a tooth too many counted at rest would let the angle go back
        behind = laid.angle_rev > knots.angle_rev[-1]
        knots = _stopped_between(knots, _of(laid, _columns(laid)[:, behind]))
    return knots


def _within(knots: AngleKnots, first_s: float, last_s: float) -> AngleKnots:
    """``knots`` that end at ``first_s`` and ``last_s`` where these lie inside: no tooth is counted on beyond."""
    inside = _columns(knots)[:, (knots.time_s > first_s) & (knots.time_s < last_s)]
    return _of(knots, np.concatenate([_knot_at(knots, first_s), inside, _knot_at(knots, last_s)], axis=1))


def _knot_at(knots: AngleKnots, at_s: float) -> Floats:
    """The knot (4, 1) at ``at_s`` on the cubics between ``knots``; none (4, 0) beyond them."""
    if not knots.time_s[0] <= at_s <= knots.time_s[-1]:
        return np.empty((4, 0))
    known = (knots.time_s, knots.angle_rev, knots.speed_rpm)
    step = STEP_SHARE * float(np.diff(knots.time_s).min())
    near = np.clip([at_s - step, at_s + step], knots.time_s[0], knots.time_s[-1])
    speed_rpm = 60.0 * np.diff(angle_at(near, *known))[0] / np.diff(near)[0]
    error_rev = np.interp(at_s, knots.time_s, knots.standard_error_rev)
    return np.array([[at_s], angle_at([at_s], *known), [speed_rpm], [error_rev]])


def _stopped_between(one: AngleKnots, two: AngleKnots) -> AngleKnots:
    """Knots of both and two in the hole between, where the shaft has slowed down and where it starts."""
    hole_s, turned = two.time_s[0] - one.time_s[-1], two.angle_rev[0] - one.angle_rev[-1]
    fast = np.array([one.speed_rpm[-1], two.speed_rpm[0]]) / 60.0
    slowing = min(hole_s / 3.0, turned / max(float(fast.sum()), 1e-12))
    slow = (turned - 0.5 * slowing * float(fast.sum())) / (hole_s - slowing)
    covered = 0.5 * (fast + slow) * slowing
    error = max(one.standard_error_rev[-1], two.standard_error_rev[0], turned / np.sqrt(12.0))
    time_s = [one.time_s[-1] + slowing, two.time_s[0] - slowing]
    angle_rev = [one.angle_rev[-1] + covered[0], two.angle_rev[0] - covered[1]]
    between = [time_s, angle_rev, [60.0 * slow, 60.0 * slow], [error, error]]
    both = one._replace(cut_off_order=min(one.cut_off_order, two.cut_off_order), noise_s=max(one.noise_s, two.noise_s))
    return _of(both, np.concatenate([_columns(one), between, _columns(two)], axis=1))


def _columns(knots: AngleKnots) -> Floats:
    return np.array([knots.time_s, knots.angle_rev, knots.speed_rpm, knots.standard_error_rev])


def _of(knots: AngleKnots, columns: Floats) -> AngleKnots:
    time_s, angle_rev, speed_rpm, error_rev = columns
    return AngleKnots(time_s, angle_rev, speed_rpm, error_rev, knots.cut_off_order, knots.noise_s)
