"""Orders of the shaft as all channels, recordings and frames of a test agree on them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from crankorder.cause import alike_speeds
from crankorder.identify.found import UNRESOLVED, AgreedOrder, AgreedOrders, Doubt, OrderLine
from crankorder.identify.lines.line_evidence import LOBE_BINS
from crankorder.identify.lines.line_phasors import LOCK_NUMBERS as ORDER_LOCK
from crankorder.identify.lines.line_phasors import (
    NO_PULSES,
    SURE_FREEDOM,
    Bin,
    Followed,
    Recording,
    any_swept,
    lines_of,
    lock_of,
    longest_rev,
    nearest_multiple,
    parted_lines,
    proves_speed,
    recordings_of,
    revs_to_decide,
    speed_source,
    stands_out,
    sure_half_width,
    zooms,
)
from crankorder.identify.lines.mains import multiples_near
from crankorder.identify.lines.order_lines import NUMBERS as ORDER_LINES
from crankorder.identify.lines.order_lines import SWELLS, longer_frames
from crankorder.identify.lines.order_lines import SWEPT_NUMBERS as SWEPT_ORDERS
from crankorder.identify.lines.zoom import Course, Zoomed
from crankorder.orders.intervals import excess_scatter, half_width
from crankorder.orders.joint_lines import hann_lobe
from crankorder.orders.true_angle import ERROR
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-lines.toml", "agreed_orders")

IN_SWEEP = Doubt(
    "in a sweep",
    "the modes that it crosses may turn its phase as much as a slip would: a recording at one speed would tell",
)
"""Of an undecided order of a sweep: no longer sweep tells, a held speed does."""

UNPARTED = Doubt(
    "close lines", "too short to part a locked line from another beside it, which together would look like this"
)
"""Of a line that would slip, if it is one."""

PARTED_IN_SWEEP = Doubt(
    "close lines", "one of several lines within a quarter order, told apart as they were followed through the sweep"
)

BY_THEIR_BEAT = (Doubt("close lines", "two lines within a quarter order, told apart by their beat"),)


@dataclass(frozen=True)
class _Test:
    """What the orders of a test are told from."""

    recordings: list[Recording]
    order_map: xr.Dataset
    speed_is_sure: bool
    """Whether pulses tell the speed, or the orders themselves prove the one that was stated."""
    by_pulses: bool
    followed: Sequence[xr.Dataset] = ()

    @property
    def resolution(self) -> float:
        axis = self.order_map["order"].values
        return float(axis[1] - axis[0])

    @property
    def revs_per_cycle(self) -> int:
        return int(self.order_map.attrs["revs_per_cycle"])

    @property
    def reach(self) -> float:
        """Distance [orders] within which a line hides another one."""
        return float(min(ORDER_LINES.neighbour_orders, ORDER_LINES.neighbour_bins * self.resolution))

    def bin_near(self, order: float) -> int:
        """Bin nearest to ``order``, of those that there are."""
        return min(max(round(order / self.resolution), 0), self.order_map.sizes["order"] - 1)


@dataclass(frozen=True)
class _Number:
    """An order with its standard error, degrees of freedom, and by what it was told.

    ``swept`` are the courses of its phase, each with its bin, where nothing but run-ups tells it; ``parted_rev`` are
    the revolutions over which it was told from a second line beside it, 0 where there is none.
    """

    order: float
    error: float
    degrees_of_freedom: float
    by_phase: bool
    swept: tuple[tuple[float, Course | None], ...] = ()
    parted_rev: float = 0.0

    def slips_from(self, multiple: float) -> bool:
        """Whether nothing but a slip makes the phase run away from that of ``multiple``."""
        if not self.swept:
            return True
        if abs(self.order - multiple) * self.parted_rev > NUMBERS.most_mode_turns:
            return True
        return any(course is not None and course.slips_from(multiple - at) for at, course in self.swept)


class _Unnamed(NamedTuple):
    """An order before it is said whether it is locked: its number, its lines, and what speaks against it."""

    number: _Number
    lines: list[OrderLine]
    doubts: tuple[Doubt, ...] = ()


def orders_agreed(
    lines: Sequence[OrderLine],
    *,
    frames: Sequence[xr.Dataset],
    order_map: xr.Dataset,
    settings: IdentifySettings,
    followed: Sequence[xr.Dataset] = (),
) -> AgreedOrders:
    """Orders of the test, lowest first, each with the ``lines`` of the channels that show it: they see one shaft.

    The number is told by the phase that a line gains on its bin from frame to frame in each of the recordings
    (``frames``, their OrderFrames, may be empty), then over all that show it, at the speeds of ``order_map`` where it
    is seen: far finer than a bin. Where recordings disagree by more than their errors, as of a bearing whose slip goes
    with the speed, the number is the mean over recordings and its error that of such a mean. A number that is proven
    an exact multiple of the cycle's (``lock`` "locked") is given as that multiple; no other is rounded. Two lines
    within a bin are told apart where they beat within a recording; where a line only swells and fades, the
    doubt says that two may stand there. Close lines of a sweep, which its short frames hold as one, are told
    apart where they were ``followed`` jointly (RecordingTracks, may be empty).

    Without pulses the crank angle itself comes from a stated speed, a speed signal or the vibration: an order is only
    as good as that, 0.2 % is added to its standard error, and nothing is called locked; but where the orders prove a
    speed that was stated or recorded (:func:`proves_speed`) they are as good as with pulses.
    What only shows the skirt of an order beyond the last bin is none. ``settings``: ``order_match``, the distance below
    which two found orders may be one.
    """
    source = speed_source([*frames, order_map])
    test = _Test(recordings_of(frames), order_map, source == "pulses", source == "pulses", followed)
    last = order_map["order"].values[-1] + 0.5 * test.resolution  # of a line beyond only its skirt is seen
    groups = _groups([line for line in lines if line.order < last])
    parted = [unnamed for group in groups for unnamed in _agreed(group, test)]
    orders = [unnamed.number.order for unnamed in parted]
    distinct = [  # close lines, to which another group has led already, count once
        unnamed
        for at, unnamed in enumerate(parted)
        if PARTED_IN_SWEEP not in unnamed.doubts or orders[at] not in orders[:at]
    ]
    if source == "stated":
        by_phase = [unnamed for unnamed in distinct if unnamed.number.by_phase]
        # the mains prove no speed, but with them and without them the others must
        proofs = by_phase, [unnamed for unnamed in by_phase if not _may_be_mains(unnamed, settings)]
        numbers = [[astuple(unnamed.number)[:3] for unnamed in proof] for proof in proofs]
        proven = all(proves_speed(proof, revs_per_cycle=test.revs_per_cycle) for proof in numbers)
        test = replace(test, speed_is_sure=proven)
    agreed = sorted((_named(unnamed, test) for unnamed in distinct), key=lambda named: named.order)
    return tuple(_without_twins(agreed, min(0.5 * test.resolution, settings.order_match)))


def _may_be_mains(unnamed: _Unnamed, settings: IdentifySettings) -> bool:
    """Whether a line stands on a multiple of the mains and speeds too alike tell it from one: it proves no speed.

    A motor's stated speed is often that of the field, whose multiples the mains make however the shaft turns.
    """
    speeds = np.concatenate([line.speed_rpm for line in unnamed.lines])
    hertz = unnamed.number.order * float(speeds.mean()) / 60.0
    return alike_speeds(speeds) and bool(multiples_near(hertz, 0.0, settings=settings))


def _groups(lines: Sequence[OrderLine]) -> list[list[OrderLine]]:
    """Lines of different channels that are one order; a channel has no two such."""
    groups: list[list[OrderLine]] = []
    for line in sorted(lines, key=lambda by_order: by_order.order):
        channels = {other.channel for other in groups[-1]} if groups else set()
        if groups and line.order - groups[-1][0].order < NUMBERS.same_order and line.channel not in channels:
            groups[-1].append(line)
        else:
            groups.append([line])
    return groups


def _without_twins(agreed: list[AgreedOrder], near: float) -> list[AgreedOrder]:
    """``agreed`` without a second line, so ``near`` at most, that another group had found as its own already."""
    kept = agreed[:1]
    for order in agreed[1:]:
        last = kept[-1]
        parted = all(PARTED_IN_SWEEP in each.doubts for each in (order, last))
        reach = min(near, 4.0 * np.hypot(order.line_error, last.line_error))
        if order.order - last.order < reach and not parted:
            kept[-1] = max(last, order, key=lambda twin: len(twin.speed_rpm))
        else:
            kept.append(order)
    return kept


def _agreed(group: list[OrderLine], test: _Test) -> list[_Unnamed]:
    """The orders of ``group`` as a sweep was followed by them, where that parts some; else one or two of frames."""
    weights = np.array([1.0 / line.order_error**2 for line in group])
    mean = float(np.average([line.order for line in group], weights=weights))
    if close := parted_lines(test.followed, near=mean, reach=test.reach):
        return [_followed(group, tracks, test) for tracks in close]
    spread = float(np.sqrt(np.average([(line.order - mean) ** 2 for line in group], weights=weights)))
    # channels share the noise and the skirts of other lines: none makes the others more certain
    by_lobe = _Number(mean, max(float(1.0 / np.sqrt(weights.max())), spread), np.inf, False)
    bin_order = test.resolution * test.bin_near(mean)
    seen = _zooms(group, test, bin_order, mean)
    if any_swept(test.recordings):
        by_lobe = replace(by_lobe, swept=((bin_order, None),))
    if not seen:
        two = _may_be_two(group)
        return [_Unnamed(_unparted(by_lobe, test) if two else by_lobe, group, (SWELLS,) * two)]
    first = _joined([(bin_order + z.offset, z.variance, z.dof) for z in seen.values()])
    if all(z.swept for z in seen.values()):
        first = replace(first, swept=tuple((bin_order, z.course) for z in seen.values()))
    pairs = {k: z.second for k, z in seen.items() if z.second is not None}
    if pairs and 2 * len(pairs) >= len(seen):
        second = _joined([(bin_order + z.offset, z.variance, z.dof) for z in pairs.values()])
        parted = min(z.span_rev for z in pairs.values())
        first = replace(first, parted_rev=parted)
        second = replace(second, swept=first.swept, parted_rev=parted)
        steps = len(test.recordings) > 1 or test.order_map.sizes["speed"] == 1
        wide = _all_channels(group, test) if steps else group
        in_all = _zooms(wide, test, bin_order, mean)
        pairs_in_all = {k: z.second for k, z in in_all.items() if z.second is not None}
        if pairs_in_all:
            seen, pairs = in_all, pairs_in_all
        else:  # the other channels hide the second line: it is that of the channels that show it
            wide = group
        firsts = _rebuilt(wide, test, seen, first) if steps else group
        seconds = _rebuilt(wide, test, pairs, second)
        return [_Unnamed(first, firsts, BY_THEIR_BEAT), _Unnamed(second, seconds, BY_THEIR_BEAT)]
    known = [z.wander for z in seen.values() if np.isfinite(z.wander)]
    swells = bool(known) and float(np.median(known)) > NUMBERS.wander_ratio
    if not known and _may_be_two(group):
        first, swells = _unparted(first, test), True
    return [_Unnamed(first, group, (SWELLS,) * swells)]


def _followed(group: list[OrderLine], tracks: list[Followed], test: _Test) -> _Unnamed:
    """One of several close lines of a sweep by its ``tracks`` in the recordings that part them."""
    read = [track for track in tracks if track.by_phase] or tracks
    joined = _joined([(track.number, track.variance, SURE_FREEDOM) for track in read])
    # the same modes turn the phase in all recordings alike: more of them tell no better
    error = max(joined.error, float(np.sqrt(min(track.variance for track in read))))
    swept, parted_rev = tuple((track.order, track.course) for track in tracks), min(t.span_rev for t in tracks)
    number = replace(joined, error=error, by_phase=read[0].by_phase, swept=swept, parted_rev=parted_rev)
    speeds, channels = test.order_map["speed"].values, _all_channels(group, test)
    lines = lines_of(channels, tracks, speed_rpm=speeds, order=number.order, order_error=number.error)
    return _Unnamed(number, lines or group, (PARTED_IN_SWEEP,))


def _may_be_two(group: list[OrderLine]) -> bool:
    """Whether the lines of ``group`` change as two do that beat, in frames too few to part these."""
    return any(line.remark and line.evidence != "locked to the shaft" for line in group)


def _unparted(number: _Number, test: _Test) -> _Number:
    """``number`` of what may be two lines: either may be the order, at most so far away as a recording leaves open."""
    spans = [float(np.ptp(recording.centre_rev)) for recording in test.recordings if len(recording.centre_rev) > 1]
    wider = NUMBERS.unparted_cycles / max(spans) if spans else 0.5 * test.resolution
    return replace(number, error=float(np.hypot(number.error, wider)))


def _all_channels(group: list[OrderLine], test: _Test) -> list[OrderLine]:
    """``group`` with stand-ins for the channels that did not show the line alone: of two lines that beat each hides
    the other's steadiness."""
    have = {line.channel: line for line in group}
    clearest = max(group, key=lambda line: line.level_over_floor_db)
    names = [str(name) for name in test.order_map["channel"].values]
    return [have.get(name) or replace(clearest, channel=name) for name in names]


def _zooms(group: list[OrderLine], test: _Test, bin_order: float, expected: float) -> dict[int, Zoomed]:
    """The line of ``group`` in each recording that runs at speeds at which it is seen."""
    names, width = test.order_map["channel"].values.tolist(), float(test.order_map.attrs.get("speed_bin_rpm", 25.0))
    channels = [names.index(line.channel) for line in group]
    place = Bin(channels, test.bin_near(bin_order), np.concatenate([line.speed_rpm for line in group]), width)
    # what long frames of a sweep do not part is no pair: modes make short ones look like two
    alone = stands_out(test.followed, near=expected, reach=np.inf) is not None
    return zooms(test.recordings, place, near=expected - bin_order, alone=alone)


def _joined(numbers: list[tuple[float, float, float]]) -> _Number:
    """Mean of orders with their variances and degrees of freedom, one of each recording.

    A scatter between them beyond their own errors (Paule and Mandel 1982) is that of the line: the mean is then over
    recordings that could be made, with one degree of freedom less than there are.
    """
    order, variance, freedom = (np.array(column) for column in zip(*numbers, strict=True))
    if len(order) == 1:
        return _Number(float(order[0]), float(np.sqrt(variance[0])), float(freedom[0]), True)

    def misfit(extra: float) -> float:
        weight = 1.0 / (variance + extra)
        return float(weight @ (order - np.average(order, weights=weight)) ** 2)

    most = float(np.ptp(order)) ** 2 * len(order) + 1e-30
    between = excess_scatter(misfit, len(order) - 1, most=most, within=1e-24)
    weight = 1.0 / (variance + between)
    mean, own = float(np.average(order, weights=weight)), float(1.0 / np.sqrt(weight.sum()))
    if between == 0.0:
        share = weight / weight.sum()
        return _Number(mean, own, float(1.0 / np.sum(share**2 / freedom)), True)  # Welch and Satterthwaite
    error = float(np.sqrt(max(1.0, misfit(between) / (len(order) - 1)))) * own
    return _Number(mean, error, float(len(order) - 1), True)


def _named(unnamed: _Unnamed, test: _Test) -> AgreedOrder:
    number, lines = unnamed.number, unnamed.lines
    order, error = number.order, number.error
    doubts = [*unnamed.doubts]
    if not test.speed_is_sure:
        error = float(np.hypot(error, ORDER_LOCK.stated_speed_error * order))
        doubts.append(NO_PULSES)
    elif not test.by_pulses:
        error = float(np.hypot(error, ORDER_LOCK.proven_speed_error * order))
    by_phase = number.by_phase and test.speed_is_sure
    lock = lock_of(order, error, number.degrees_of_freedom, revs_per_cycle=test.revs_per_cycle, by_phase=by_phase)
    needed = None
    multiple = nearest_multiple(order, revs_per_cycle=test.revs_per_cycle)
    hidden = bool(number.swept) and stands_out(test.followed, near=order, reach=test.resolution) is False
    if lock == "slips":
        lock = "undecided"
        if hidden or not number.slips_from(multiple):
            error = max(error, abs(order - multiple) / half_width(number.degrees_of_freedom))
            doubts.append(IN_SWEEP)
        elif _may_be_a_pair(unnamed, abs(order - multiple), test):
            doubts.append(UNPARTED)
        elif not any(UNRESOLVED in line.doubts for line in lines):  # a resonance that passes slips from no order
            lock = "slips"
    if lock == "locked":
        order = multiple
        # the interval holds the multiple, as the proof of the lock says
        within = sure_half_width(1.0, number.degrees_of_freedom) / half_width(number.degrees_of_freedom)
        error = max(error, abs(number.order - order) / within)
    elif lock == "undecided":
        needed = _needed_revs(order, lines, test)
        if needed is None and any_swept(test.recordings) and IN_SWEEP not in doubts:
            doubts.append(IN_SWEEP)
    of_lines = sorted({line.doubts for line in lines}, key=lambda of_line: [doubt.words for doubt in of_line])
    doubts += dict.fromkeys(doubt for of_line in of_lines for doubt in of_line)
    own = None if test.by_pulses else number.error
    return AgreedOrder(order, error, number.degrees_of_freedom, lock, needed, tuple(lines), tuple(doubts), own)


def _may_be_a_pair(unnamed: _Unnamed, off: float, test: _Test) -> bool:
    """Whether a locked line, ``off`` orders away, and another one beyond would be read as the one that was ``unnamed``.

    In a sweep where no frame in which close lines are looked for parts them; at held speeds where what was found swells
    and fades and the longest recording holds less than some beats of the two.
    """
    if unnamed.number.parted_rev > 0.0 or not test.recordings:
        return False
    span = longest_rev(test.recordings)
    if unnamed.number.swept:
        return bool(off * longer_frames(float(test.recordings[0].revs), span)[-1] < SWEPT_ORDERS.nearest_bins)
    return SWELLS in unnamed.doubts and off * span < NUMBERS.beats_of_a_pair


def unless_sidebands(
    orders: Sequence[AgreedOrder], order_map: xr.Dataset, frames: Sequence[xr.Dataset]
) -> Iterator[AgreedOrder]:
    """``orders``, undecided and of no number of their own where errors of the crank angle (in ``frames``) may have made
    them. A line of the shaft that most speeds of ``order_map`` show is none of these, whose orders move with the speed.
    """
    for order in orders:
        few = 2 * len({at for line in order.lines for at in line.seen.tolist()}) <= order_map.sizes["speed"]
        carrier = sideband_of(order.lines, order_map, frames) if few or order.lock != "locked" else None
        if carrier is not None:
            doubt = Doubt("angle in error", f"no larger than what errors of the crank angle make of order {carrier:g}")
            order = replace(order, lock="undecided", doubts=(*order.doubts, doubt), of_angle=True)
        yield order


def _needed_revs(order: float, lines: list[OrderLine], test: _Test) -> float | None:
    """Revolutions of one recording after which it is told, from the clearest line at its clearest speed.

    None where more of them would not tell: without pulses, in a sweep, and where so many were recorded already.
    """
    # no length of a recording mends a speed that is not known, nor what modes that a sweep crosses turn
    if not test.speed_is_sure or any_swept(test.recordings):
        return None
    frames = test.order_map["n_frames"].values
    revs = float(test.order_map.attrs["revs_per_frame"])
    hop = revs * (1.0 - float(test.order_map.attrs["overlap"]))
    error, amplitude, seen = (
        np.concatenate([getattr(line, key) for line in lines]) for key in ("amplitude_error", "amplitude", "seen")
    )
    known = (amplitude > 0.0) & np.isfinite(error)
    if not known.any():
        return None
    relative_error, clearest = min(zip((error[known] / amplitude[known]).tolist(), seen[known].tolist(), strict=True))
    span = revs + (float(frames[clearest]) - 1.0) * hop
    needed = revs_to_decide(order, relative_error=relative_error, span_rev=span, revs_per_frame=revs)
    return needed if needed > longest_rev(test.recordings) else None


def _rebuilt(group: list[OrderLine], test: _Test, zoomed: dict[int, Zoomed], number: _Number) -> list[OrderLine]:
    """Lines of the channels of ``group`` with amplitudes of the one component ``zoomed`` in the recordings alone."""
    speed, seen = test.order_map["speed"].values, dict[int, tuple[float, Zoomed]]()
    means = [(float(np.mean(test.recordings[k].speed_rpm)), k) for k in reversed(zoomed)]
    for own_rpm, k in sorted(means, key=lambda mean: -mean[0]):  # of several recordings at a speed the slowest
        distance = np.abs(speed - own_rpm)
        seen[int(np.nanargmin(distance)) if np.isfinite(distance).any() else 0] = own_rpm, zoomed[k]
    rows, lines = np.array(sorted(seen)), []
    of_rows = [seen[at] for at in rows.tolist()]
    rpm, freedom, offset = np.array([(own_rpm, z.dof, z.offset) for own_rpm, z in of_rows]).T
    loss = hann_lobe(offset / test.resolution)
    for channel, line in enumerate(group):
        amplitude = np.array([abs(z.amplitude[channel]) for _, z in of_rows]) / loss
        error = np.array([z.error[channel] for _, z in of_rows]) / loss
        clear = amplitude > 3.0 * error
        if clear.any():
            size = amplitude[clear], error[clear], freedom[clear]
            lines.append(line.read_again((number.order, number.error), rows[clear], rpm[clear], *size))
    return lines or group


OF_ROUNDING = float(np.sqrt(12.0))
"""Sideband over carrier, per order and standard error [rev] of the angle: the first harmonic of a rounding error."""


def sideband_of(lines: Sequence[OrderLine], order_map: xr.Dataset, frames: Sequence[xr.Dataset]) -> float | None:
    """Order whose sidebands all ``lines`` (one order, by channel) may be, at every speed at which they are seen.

    An edge that is rounded to the samples of a recording errs by up to half of one, in a pattern that beats with the
    samples: it turns the phase of order n by n times the error of the angle, and leaves lines at orders that are none.
    ``order_map`` (OrderMap) says how large the others are, ``frames`` (OrderFrames) how well the angle is known. None
    where one of the lines is larger than that.
    """
    rpm, width_rpm = order_map["speed"].values, float(order_map.attrs.get("speed_bin_rpm", 25.0))
    error = np.zeros(len(rpm))  # [rev] of the crank angle, the largest of the recordings that ran at each speed
    for recording in frames:
        speed = recording["speed"].values
        if len(speed) and np.isfinite(speed).any():
            ran = (rpm >= np.nanmin(speed) - width_rpm) & (rpm <= np.nanmax(speed) + width_rpm)
            own = float(recording.attrs.get(ERROR, 0.0))
            error = np.where(ran | ~np.isfinite(rpm), np.maximum(error, own), error)
    axis, names = order_map["order"].values, order_map["channel"].values.tolist()
    carrier = 0.0
    for line in lines:
        size = np.nan_to_num(order_map["amplitude"].values[names.index(line.channel)])
        # no line is a sideband of itself
        turned = size[line.seen] * axis * (np.abs(axis - line.order) > (LOBE_BINS + 0.5) * (axis[1] - axis[0]))
        if not (line.amplitude <= OF_ROUNDING * error[line.seen] * turned.max(axis=1)).all():
            return None
        carrier = float(axis[int(turned[line.strongest].argmax())])
    return carrier if lines else None
