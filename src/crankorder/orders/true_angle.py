"""Frames and tracks of a test brought from the angle that its encoder shows to the true one, where both are told apart.

What is not told apart, or left of it, travels with them (``angle_swing_left_rev``) and widens intervals of amplitudes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from crankorder.orders.intervals import Z95, one_phase_reference
from crankorder.orders.swing_evidence import (
    HARMONICS,
    TURN,
    Expected,
    Swing,
    alike_at_all_speeds,
    given_by_neighbours,
    in_true_angle,
    modulation,
    rows_of,
    swings_of,
    true_angle,
    unless_lines_lack,
)
from crankorder.quantities import Attribute, Complexes, Floats, Ints, QualityFlag, remark, with_flags
from crankorder.settings import OrderSettings
from crankorder.shaft.angle import knots_of
from crankorder.shaft.audit import reference_of
from crankorder.shaft.speeds import swing_of_cycles
from crankorder.shaft.tooth_errors import TOOTH_KEPT, TOOTH_LEVEL, TOOTH_ORDER, TOOTH_PRINT, same_wheel

ERROR, OF_ONE_REV = "angle_error_rev", "angle_error_of_one_rev_rev"
"""Attributes of frames: standard error [rev] of the crank angle, and of its mean over a revolution."""

LINES = "angle_lines_per_rev"
"""Attribute of frames: lines or samples of the encoder per crank revolution; 0 where the angle rests on none."""

TAKEN = "angle_swing_taken_rev"
"""Attribute of frames and tracks: by harmonic, what was taken out of the swing that the encoder shows."""

MANY_LINES = 360.0
"""Lines per revolution of an encoder by whose pulses samples were taken: so many or more."""

UNKNOWN_DEG = 180.0
"""Half width of the interval of a phase that is not known."""


LEFT = "angle_swing_left_rev"
"""Attribute of frames and tracks: by harmonic, what of the angle's swing may be left."""

ANGLES = ("crank_angle", "waveform_angle")
"""Variables of tracks that hold angles of the shaft."""

GIVEN = "given_by_swing"
"""Variable of tracks: the largest amplitude that the rest of the swing gives to each."""

LINES_PER_HARMONIC = 8.0
"""Fewer lines per turn and harmonic show no swing: it would be motion between them, another at every speed."""

SHOWN = "angle_swing_shown_rev"
"""Attribute of frames: what the pulses themselves show of the angle's swing, by speed; absent where nothing."""

HALF_ORDERS = 12
"""Half orders, from 0.5 on, up to which that is stated: gas and inertia of a few cylinders lie below."""

SPEED_STEP = 0.1
"""Of the logarithm of the speed, within which cycles are of about one speed."""

ALIKE = 1e-3
"""Orders so close are one to a filter that follows them."""

NAMES = {1: "eccentricity", 2: "ovality"}
"""What makes a swing so often per turn; the others are of uneven lines."""


class AngleErrors(NamedTuple):
    """Standard errors of the crank angle [rev] by row: ``random`` (rows,) within it, ``mean`` (rows,) of its mean."""

    random: Floats
    mean: Floats

    def phase_half_deg(self, half_deg: Floats, order: Floats) -> Floats:
        """``half_deg``, half widths of 95 % intervals of phases, with the error of the angle at each ``order``.

        All have shapes that follow from (rows,) by broadcasting; unknown phases stay so.
        """
        turned = Z95 * 360.0 * order * self.mean
        wider = np.minimum(np.hypot(half_deg, turned), UNKNOWN_DEG)
        return np.asarray(np.where(half_deg < UNKNOWN_DEG, wider, half_deg))

    def kept(self, order: Floats) -> Floats:
        """Share of its amplitude, 0 to 1, that a line at each ``order`` keeps; it broadcasts with (rows,)."""
        return np.asarray(np.exp(-0.5 * np.square(2.0 * np.pi * order * self.random)))

    @property
    def by_order(self) -> AngleErrors:
        """These errors (rows, 1), beside which orders have an axis of their own."""
        return AngleErrors(self.random[:, None], self.mean[:, None])


def stated_errors(shaft: xr.Dataset, *, revs_per_frame: float) -> dict[str, Attribute]:
    """The attributes that frames carry of the error of their ShaftAngle ``shaft`` (time).

    ``revs_per_frame`` is the length of a frame, rev.
    """
    error, of_one = _errors(shaft, revs_per_frame)
    # teeth of an encoder on another shaft swing at orders that no harmonic of the crank has
    own = TOOTH_PRINT in shaft.attrs and float(shaft.attrs[TOOTH_ORDER]) == 1.0
    teeth = {name: shaft.attrs[name] for name in (TOOTH_LEVEL, TOOTH_KEPT, TOOTH_PRINT)} if own else {}
    shown = {SHOWN: rows} if (rows := _swing_by_speed(shaft)) else {}
    # a recording by crank angle has many lines, how many is not looked for
    pulses = int(shaft.attrs.get("n_pulses", 0))
    lines = float(shaft.attrs.get("teeth_per_rev", 0.0)) if pulses > 0 else 0.0
    lines = MANY_LINES if shaft.attrs.get("domain") == "crank_angle" else lines
    return {ERROR: error, OF_ONE_REV: of_one, LINES: lines, **shown, **teeth}


def _swing_by_speed(shaft: xr.Dataset) -> list[float]:
    """Speeds [rpm] and the swing [rev] that the angle of ``shaft`` shows there, by half order; complex, in a row.

    Cycles of about one speed are taken together.
    """
    known = swing_of_cycles(shaft)
    if known is None:
        return []
    orders, rpm, lines = known
    shown = orders <= HALF_ORDERS / 2.0  # of other ones the angle shows nothing
    size = np.zeros((len(rpm), 1 + HALF_ORDERS), dtype=np.complex128)
    size[:, 0] = rpm
    size[:, np.round(2.0 * orders[shown]).astype(int)] = (lines / (2j * np.pi * orders * rpm[:, None]))[:, shown]
    step = np.floor(np.log(rpm / rpm.min()) / SPEED_STEP)
    rows = np.array([size[step == own].mean(axis=0) for own in np.unique(step)])
    return [float(value) for value in rows.view(np.float64).ravel()]


def swing_shown(frames: Sequence[xr.Dataset]) -> Complexes:
    """Speed [rpm] and swing [rev] by half order that pulses of ``frames`` show: (speeds, 1 + HALF_ORDERS).

    ``frames`` are OrderFrames (channel, frame, order); the result has no rows where none of them states it.
    """
    rows = np.concatenate([np.zeros(0), *(np.atleast_1d(item.attrs.get(SHOWN, ())) for item in frames)])
    return np.asarray(rows.astype(np.float64).view(np.complex128).reshape(-1, 1 + HALF_ORDERS))


def same_teeth(frames: Sequence[xr.Dataset]) -> bool:
    """Whether the angles of all OrderFrames ``frames`` (channel, frame, order) err alike.

    They do where one wheel made them and its low harmonics are left in all of them: harmonics that were taken out with
    the teeth may have been motion, which differs between recordings.
    """
    stated = [item.attrs for item in frames if TOOTH_PRINT in item.attrs]
    return not stated or (all(int(attrs[TOOTH_KEPT]) for attrs in stated) and same_wheel(stated))


def errors_of_rows(frames: Sequence[xr.Dataset], owner: Ints, rows: Sequence[Ints]) -> AngleErrors:
    """Errors of the rows of a map of OrderFrames ``frames``, whose recordings err each on its own.

    ``owner`` (frames,) is the number of the recording of each frame of all recordings, ``rows`` are the indices (frames
    of the row,) of the frames of each row.
    """
    error, of_one = (np.array([float(item.attrs.get(name, 0.0)) for item in frames]) for name in (ERROR, OF_ONE_REV))
    length = np.array([float(item.attrs["revs_per_frame"]) for item in frames])
    overlap = np.array([float(item.attrs.get("overlap", 0.0)) for item in frames])
    random, mean = np.zeros(len(rows)), np.zeros(len(rows))
    for place, row in enumerate(rows):
        names, count = np.unique(owner[row], return_counts=True)
        revs = length[names] * (1.0 + (count - 1.0) * (1.0 - overlap[names]))  # that the frames reach over
        share = count / count.sum()
        own = np.minimum(error[names], of_one[names] / np.sqrt(revs))
        random[place] = np.sqrt(np.sum(share * np.maximum(error[names] ** 2 - own**2, 0.0)))
        mean[place] = np.sqrt(np.sum(np.square(share * own)))
    return AngleErrors(random, mean)


def errors_along(shaft: xr.Dataset, time_s: Floats, revs: Floats) -> AngleErrors:
    """Errors (rows,) of the ShaftAngle ``shaft`` at ``time_s`` (rows,) [s], each over ``revs`` (rows,) revolutions.

    ``revs`` are above 0.
    """
    overall, of_one = _errors(shaft, float(np.median(revs)) if len(revs) else 1.0)
    if not overall > 0.0:
        return AngleErrors(np.zeros(len(time_s)), np.zeros(len(time_s)))
    here = np.interp(time_s, knots_of(shaft)["knot_time_s"], np.nan_to_num(shaft["standard_error"].values))
    mean = np.minimum(here, here * (of_one / overall) / np.sqrt(revs))
    return AngleErrors(np.sqrt(np.maximum(here**2 - mean**2, 0.0)), mean)


def _errors(shaft: xr.Dataset, revs_per_frame: float) -> tuple[float, float]:
    """Standard error [rev] of the angle, and of its mean over one revolution; 0 where nothing tells."""
    if "n_pulses" not in shaft.attrs or "standard_error" not in shaft:
        return 0.0, 0.0
    reference = reference_of(shaft, revs_per_frame=revs_per_frame)
    error = reference.error_rev
    if not np.isfinite(error):
        return 0.0, 0.0
    if not reference.teeth_per_rev > 0.0:
        return error, error
    return error, reference.pulse_error_rev / float(np.sqrt(reference.teeth_per_rev))


class Swings(NamedTuple):
    """Swings of the angle, those of each recording: ``of`` by its name; ``shared`` where all have one mark."""

    of: dict[str, tuple[Swing, ...]]
    shared: bool


def swings_of_test(frames: Sequence[xr.Dataset], *, settings: OrderSettings) -> Swings:
    """Swings of the angle of every recording in ``frames`` (OrderFrames) that has lines of an encoder to show them.

    Recordings with one mark of the crank are told together: an encoder errs at the same place in all of them, unless
    its teeth say that it is another. ``settings``: of orders, for what is taken of encoders.
    """
    used = [item for item in frames if float(item.attrs.get(LINES, 0.0)) > 0.0]
    shared = bool(used) and one_phase_reference(used) and same_teeth(used)
    of: dict[str, tuple[Swing, ...]] = {}
    for group in [used] if shared else [[item] for item in used]:
        rows = rows_of(group)
        if rows is None:
            continue
        lines = min(float(item.attrs[LINES]) for item in group)
        expected = Expected(settings, max(float(item.attrs.get(TOOTH_LEVEL, 0.0)) for item in group))
        own, shown = (swing_shown(items)[:, (0, *(2 * k for k in HARMONICS))] for items in (group, used))
        if not shared and len(own):  # each has a mark of its own: sizes alone are compared
            shown[:, 1:] = np.abs(shown[:, 1:]) * np.exp(1j * np.angle(own[:, 1:].mean(axis=0)))
        alike = alike_at_all_speeds(shown, slack=settings.sideband_slack)
        may = {k: part for k, part in alike.items() if lines >= LINES_PER_HARMONIC * k}
        swings = swings_of(rows, expected, may)
        of |= {str(item.attrs["recording"]): swings for item in group}
    return Swings(unless_lines_lack(of) if of else {}, shared)


def frames_in_true_angle(frames: Sequence[xr.Dataset], swings: Swings) -> list[xr.Dataset]:
    """``frames`` (OrderFrames) without the sidebands of the swings that are proved; the first carries the flags."""
    made = []
    for item in frames:
        own = swings.of.get(str(item.attrs["recording"]), ())
        taken = _taken(own)
        if taken:
            spectrum = item["spectrum"]
            per_order = int(item.attrs["revs_per_frame"])
            values = in_true_angle(spectrum.values, bins_per_order=per_order, swings=taken)
            item = item.assign(spectrum=(spectrum.dims, values.astype(spectrum.dtype), spectrum.attrs))
        made.append(item.assign_attrs(_stated(own)) if own else item)
    flags = swing_flags(swings)
    if flags and made:
        made[0] = with_flags(made[0].copy(), flags)
    return made


def tracks_in_true_angle(followed: Sequence[xr.Dataset], swings: Swings) -> list[xr.Dataset]:
    """``followed`` (RecordingTracks) in the true angle, without what orders give to one another by the swings proved.

    An order that stood out as no more than a sideband of others stands out no more.
    """
    made = []
    for item in followed:
        own = swings.of.get(str(item.attrs.get("recording", "")), ())
        if not own or "amplitude" not in item:
            made.append(item)
            continue
        amplitude, taken = item["amplitude"], _taken(own)
        order = item["order"].values.astype(np.float64)
        values = _brought_back(item, taken)
        given = _given(np.abs(values), order, {one.harmonic: one.left_rev for one in own})
        words = {"units": "see unit", "long_name": "largest amplitude that the rest of the angle's swing gives"}
        true = {"amplitude": (amplitude.dims, values, amplitude.attrs), GIVEN: (amplitude.dims, given, words)}
        angles = {name: item[name].copy(data=true_angle(item[name].values, taken)) for name in ANGLES if name in item}
        item = item.assign(true | {name: angle.variable for name, angle in angles.items()}).assign_attrs(_stated(own))
        if taken:
            by_chance = np.sqrt(2.0 * np.log(values.size / (0.05 * len(order))))  # errors of the largest of all rows
            over = np.abs(values) > given + by_chance * item["standard_error"].values
            lines = order[over.any(axis=(0, 2))]
            out = np.atleast_1d(item.attrs.get("standing_out", ())).astype(np.float64)
            item.attrs["standing_out"] = [float(one) for one in out if np.abs(lines - one).min(initial=np.inf) < ALIKE]
        made.append(item)
    return made


def left_of(frames: Sequence[xr.Dataset]) -> dict[int, float]:
    """Largest amplitude [rev], by harmonic, of the swing that may be left in ``frames`` (channel, frame, order)."""
    stated = [np.atleast_1d(item.attrs[LEFT]) for item in frames if LEFT in item.attrs]
    return {} if not stated else dict(zip(HARMONICS, np.max(stated, axis=0).tolist(), strict=True))


def given_to(amplitude: Floats, frames: Sequence[xr.Dataset]) -> Floats:
    """Largest amplitude (…, orders) that the rest of the swing in OrderFrames ``frames`` adds to each order.

    ``amplitude`` (…, orders) is that of the orders on the axis of ``frames``.
    """
    left = left_of(frames)
    if not any(left.values()):
        return np.zeros(amplitude.shape)
    return given_by_neighbours(amplitude, bins_per_order=int(frames[0].attrs["revs_per_frame"]), left_rev=left)


def swing_flags(swings: Swings) -> list[QualityFlag]:
    """Quality flags on the encoder from ``swings``: once for a test whose recordings have one mark, else for each."""
    of = list(swings.of.items())[: 1 if swings.shared else None]
    return [_flag("all" if swings.shared else name, swing) for name, own in of for swing in own if swing.proved]


def _flag(recording: str, swing: Swing) -> QualityFlag:
    size, half = 360.0 * abs(swing.size), 360.0 * 1.959964 * swing.error_rev
    name = NAMES.get(swing.harmonic, f"uneven lines ({swing.harmonic} per turn)")
    carriers = ", ".join(f"{order:g}" for order in swing.carriers[:6])
    # the angle shown less the true one as a sine, as makers of encoders state it
    phase = (np.degrees(np.angle(swing.size)) + 90.0 + 180.0) % 360.0 - 180.0
    detail = (
        f"{name} of the encoder {size:.3g}° (95 % interval {max(0.0, size - half):.3g} to "
        f"{size + half:.3g}°) at {phase:.0f}°: orders {carriers} have sidebands {swing.harmonic} beside them that are "
        f"their order times one and the same error of the angle (chance {swing.chance:.1g}); pulses show it alike at "
        f"all speeds. They are no machine part and are taken out of orders and tracks; intervals hold what may be left"
    )
    return remark(recording, f"encoder_{NAMES.get(swing.harmonic, 'uneven_lines')}", detail)


def _taken(own: Sequence[Swing]) -> dict[int, complex]:
    return {swing.harmonic: swing.size for swing in own if swing.proved}


def _stated(own: Sequence[Swing]) -> dict[str, list[float]]:
    """Attributes that state what was taken of the swings ``own``, and what may be left."""
    taken = [abs(swing.size) if swing.proved else 0.0 for swing in own]
    return {LEFT: [swing.left_rev for swing in own], TAKEN: taken}


def _brought_back(item: xr.Dataset, taken: dict[int, complex]) -> Complexes:
    """Amplitudes (channel, order, frame) of ``item`` in the true angle, as if what is not followed were no line.

    What lines of the true angle show is solved for them: sidebands that nobody follows are missed by no line.
    """
    values, order = item["amplitude"].values, item["order"].values.astype(np.float64)
    if not taken:
        return np.asarray(values)
    both = np.concatenate([order, -order])
    on = ALIKE * np.round(both / ALIKE)
    shown = np.zeros((len(both), len(both)), dtype=np.complex128)
    for q, gain in zip(*modulation(true_angle(TURN, taken) - TURN, both), strict=True):
        shown += np.where(np.abs(on[:, None] - on - q) < 0.5 * ALIKE, gain, 0.0)
    turned = np.exp(2j * np.pi * ((both - on)[:, None] * item["crank_angle"].values % 1.0))
    known = np.nan_to_num(values)
    true = turned.conj() * np.linalg.solve(shown, turned * np.concatenate([known, known.conj()], axis=1))
    return np.where(np.isfinite(values.real), true[:, : len(order)], np.nan)


def _given(amplitude: Floats, order: Floats, left: dict[int, float]) -> Floats:
    """Largest amplitude (channel, order, frame) that swings of up to ``left`` give to each, by its neighbours."""
    square = np.zeros(amplitude.shape)
    for harmonic, size in left.items():
        apart = np.abs(np.subtract.outer(order, np.concatenate([order, -order])))
        beside = np.abs(apart - harmonic) < ALIKE
        share = np.pi * size * order * (beside[:, : len(order)] | beside[:, len(order) :])
        square += np.square(np.einsum("os,csf->cof", share, np.nan_to_num(amplitude)))
    return np.asarray(np.sqrt(square))
