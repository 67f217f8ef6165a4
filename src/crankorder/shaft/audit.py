"""What a crank angle can carry: errors that its reference makes, and the bias of each order to expect of them.

An error e of the angle modulates the phase of a line at order k by 2 pi k e. Random error of standard deviation s takes
1 - exp(-(2 pi k s)^2 / 2) of its amplitude; error that swings with amplitude A at some order leaves J0(2 pi k A) of it
and puts J1(2 pi k A) that order away on either side; error that stands still turns its phase (Carson 1922).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import j0, j1

from crankorder.quantities import Floats
from crankorder.settings import ShaftSettings
from crankorder.shaft.angle import knots_of, time_at
from crankorder.shaft.pulses import Remark
from crankorder.shaft.smoother import HIGHEST_CUT_OFF

# Cycles whose common motion is looked at, and points of a revolution that show it.
MOST_CYCLES, MOST_POINTS = 64, 256
# Harmonics of the sawtooth that rounding makes; images of a motion on either side that interpolation leaves.
STEP_HARMONICS, IMAGES = 8, 2
# Motion is told from noise by so many standard deviations of its mean over the cycles.
SURE_DEVIATIONS = 4.0
# Share of the noise of one pulse that motion may have and yet be smoothed away, by the rule that finds the cut-off.
HIDDEN_SHARE = 0.4
# Phase modulation [rad] at which a sideband is at its largest: no deeper one makes it smaller here.
DEEPEST_RAD = 1.8412


class Modulation(NamedTuple):
    """Error of the crank angle from one ``cause``, and its effect on a line.

    ``random_rev`` is the standard deviation [rev] of its random part within a frame, ``tone_rev`` (tones,) are the
    amplitudes [rev] of its swings at ``tone_order`` (tones,), cycles per crank revolution.
    """

    cause: str
    random_rev: float = 0.0
    tone_order: Floats = np.empty(0)
    tone_rev: Floats = np.empty(0)

    def loss(self, order: Floats) -> Floats:
        """Share of its amplitude that a line at each ``order`` (orders,) loses, 0 to 1."""
        turn = 2.0 * np.pi * order
        left = np.exp(-0.5 * (turn * self.random_rev) ** 2) * np.prod(j0(np.outer(turn, self.tone_rev)), axis=1)
        return np.asarray(1.0 - np.abs(left))

    def sideband(self, order: Floats) -> Floats:
        """Largest share of its amplitude that a line at each ``order`` (orders,) gives to an order beside it."""
        depth = np.outer(2.0 * np.pi * order, np.append(self.tone_rev, 0.0))
        return np.asarray(np.max(j1(np.minimum(depth, DEEPEST_RAD)), axis=1))


class Reference(NamedTuple):
    """A shaft angle seen as a sampler of motion.

    ``teeth_per_rev`` and ``revs_per_cycle`` are per crank revolution and per engine cycle, ``cut_off_order`` is that of
    its smoother, ``edge_step_s`` the step [s] to which pulse times are rounded (0: none), ``error_rev`` the standard
    deviation [rev] of the angle.
    """

    teeth_per_rev: float
    cut_off_order: float
    edge_step_s: float
    revs_per_cycle: int
    error_rev: float

    @property
    def pulse_error_rev(self) -> float:
        """Standard deviation [rev] of one pulse: smoothing has divided it by the root of the pulses that it joins."""
        return self.error_rev * math.sqrt(max(1.0, self.teeth_per_rev / (2.1 * self.cut_off_order)))

    def smoothing(self, cycles_per_tooth: Floats) -> Floats:
        """Gain of the smoother, 0 to 1, at each of ``cycles_per_tooth`` (any shape)."""
        cut_off = self.cut_off_order / self.teeth_per_rev
        if cut_off > HIGHEST_CUT_OFF:
            return np.ones_like(cycles_per_tooth)
        return np.asarray(1.0 / (1.0 + (np.sin(np.pi * cycles_per_tooth) / math.sin(math.pi * cut_off)) ** 6))

    def lowest_unseen(self, above: float) -> float:
        """Lowest multiple of the order of the engine cycle beyond the order ``above``."""
        return (math.floor(above * self.revs_per_cycle + 1e-9) + 1) / self.revs_per_cycle

    def error_of_motion(self, order: float, amplitude_rev: float) -> tuple[Floats, Floats]:
        """Orders (tones,) and amplitudes [rev] (tones,) of the error where it swings ``amplitude_rev`` at ``order``.

        Teeth sample the motion, so it shows at order - n teeth_per_rev for every whole n, with the gain that the cubic
        spline through the knots has there (Unser 1999); what the motion lacks and what the others add is error.
        """
        tooth = order / self.teeth_per_rev
        at = np.unique(np.append(tooth - np.round(tooth) - np.arange(-IMAGES, IMAGES + 1), tooth))
        gain = self.smoothing(np.full(1, tooth)) * np.sinc(at) ** 4 / (1.0 - 2.0 / 3.0 * np.sin(np.pi * at) ** 2)
        return np.abs(at) * self.teeth_per_rev, amplitude_rev * np.where(np.abs(at - tooth) < 1e-9, 1.0 - gain, gain)


def lag_rev(order: float, irregularity: float) -> float:
    """Amplitude [rev] of the angle where the speed swings by the share ``irregularity`` of itself at ``order``."""
    return irregularity / (2.0 * math.pi * order)


def reference_of(shaft: xr.Dataset, *, revs_per_frame: float) -> Reference:
    """The Reference that the ShaftAngle ``shaft`` (time) rests on; of an integrated speed, its error within a frame.

    ``revs_per_frame`` is the length of a frame, rev. ``teeth_per_rev`` is 0 where the angle has only two knots.
    """
    attrs, error = shaft.attrs, shaft.variables["standard_error"].values
    n_pulses, revs = int(attrs["n_pulses"]), float(np.ptp(shaft.variables["crank_angle"].values))
    error_rev = float(np.sqrt(np.mean((error[1:-1] if error.size > 2 else error) ** 2)))
    if n_pulses == 0:  # the integral of a speed walks at random
        error_rev *= math.sqrt(min(1.0, revs_per_frame / revs))
    # the outermost knots lie a tooth beyond the pulses
    teeth = float(attrs.get("teeth_per_rev", ((n_pulses or error.size - 2) + 1) / revs))
    cut_off, step_s = float(attrs.get("cut_off_order", np.inf)), float(attrs.get("edge_step_s", 0.0))
    return Reference(teeth if error.size > 2 else 0.0, cut_off, step_s, int(attrs["revs_per_cycle"]), error_rev)


def pulse_noise(reference: Reference, *, revs_per_frame: float) -> Modulation:
    """Random error of the angle of ``reference`` within frames whose length is ``revs_per_frame`` revolutions."""
    left = min(reference.error_rev, reference.pulse_error_rev / math.sqrt(reference.teeth_per_rev * revs_per_frame))
    return Modulation("the noise of the pulses", random_rev=math.sqrt(reference.error_rev**2 - left**2))


def seen_motion(shaft: xr.Dataset, reference: Reference) -> dict[float, float]:
    """Amplitude [rev], by order, of the in-cycle motion that the ShaftAngle ``shaft`` (time) shows for certain.

    It is what the cycles have in common. In each cycle the time is compared with the cubic through its ends and those
    of its neighbours, which removes the effect of a run-up. ``reference`` is that of ``shaft``; motion that rounding
    alone may have made is left out.
    """
    turns, knots = reference.revs_per_cycle, knots_of(shaft)
    first, last = math.ceil(knots["knot_angle_rev"][0]), math.floor(knots["knot_angle_rev"][-1])
    points = min(MOST_POINTS, int(reference.teeth_per_rev + 1e-6)) * turns
    cycles = min(MOST_CYCLES, (last - first) // turns - 2)
    if cycles < 2 or points < 3:
        return {}
    x = np.arange(points) / points
    begin = first + turns * (1 + ((last - first) // turns - 2 - cycles) // 2)
    angle = begin + turns * (np.arange(cycles)[:, None] + x)
    ends = time_at(begin + turns * np.arange(-1.0, cycles + 2.0), **knots)
    weights = np.stack((-x * (x - 1) * (x - 2), 3 * (x + 1) * (x - 1) * (x - 2), -3 * (x + 1) * x * (x - 2)))
    weights = np.vstack((weights, (x + 1) * x * (x - 1))) / 6.0
    smooth = np.lib.stride_tricks.sliding_window_view(ends, 4) @ weights
    late = (time_at(angle.ravel(), **knots).reshape(angle.shape) - smooth) / np.diff(ends)[1:-1, None]
    order = np.arange(1, (points + 1) // 2) / turns
    gain = reference.smoothing(order / reference.teeth_per_rev)
    amplitude = 2.0 * turns * np.abs(np.fft.rfft(late.mean(axis=0)))[1 : order.size + 1] / points / gain
    sure = (amplitude > SURE_DEVIATIONS * reference.error_rev / math.sqrt(cycles)) & (gain > 0.5)
    if reference.edge_step_s > 0.0:
        samples = (ends[-1] - ends[0]) / (turns * (ends.size - 1) * reference.teeth_per_rev) / reference.edge_step_s
        for h in range(1, STEP_HARMONICS + 1):
            beat = abs(h * samples - round(h * samples)) * reference.teeth_per_rev
            small = amplitude * h * samples * reference.teeth_per_rev < 0.5
            sure &= ~(small & (np.abs(order - beat) * turns < 0.5))
    return {float(at): float(size) for at, size in zip(order[sure], amplitude[sure], strict=True)}


def expected_motion(reference: Reference, seen: Mapping[float, float], *, percent: float) -> dict[float, float]:
    """Amplitude [rev] of in-cycle motion by order: that ``seen`` [rev], and that which ``reference`` does not show.

    The strongest motion seen (by speed) is continued with 1 / order^2 to the lowest order that is not seen; without
    any, motion of ``percent`` of the speed at order 1 is.
    """
    motion = dict(seen)
    strongest = max(seen, key=lambda order: order * seen[order], default=0.0)
    level = 2.0 * math.pi * strongest**3 * seen[strongest] if strongest else 0.01 * percent
    between = reference.lowest_unseen(0.5 * reference.teeth_per_rev)
    motion[between] = lag_rev(between, level / max(1.0, between**2))
    hidden = reference.lowest_unseen(reference.cut_off_order) if math.isfinite(reference.cut_off_order) else between
    if hidden < between and hidden not in motion:
        largest = HIDDEN_SHARE * reference.pulse_error_rev
        motion[hidden] = min(lag_rev(hidden, level / max(1.0, hidden**2)), largest)
    return motion


def unseen_motion(reference: Reference, motion: Mapping[float, float]) -> Modulation:
    """Error from in-cycle ``motion`` (amplitude [rev] by order) between and at the pulses of ``reference``."""
    parts = [reference.error_of_motion(at, size) for at, size in sorted(motion.items())]
    order, size = np.concatenate([np.empty((2, 0)), *parts], axis=1)
    matters = (order > 1e-6) & (size > 1e-3 * size.max(initial=0.0))  # at order 0 the angle is off, and swings not
    return Modulation("motion between the pulses", tone_order=order[matters], tone_rev=size[matters])


# Orders among which the highest that is carried is sought, 0.8 % apart.
SOUGHT_ORDERS = np.geomspace(1e-2, 1e5, 2048)


class ReferenceAudit(NamedTuple):
    """Effect of the errors of a crank angle on its orders.

    Up to ``highest_carried_order`` neither loss nor sideband is above the limit; it is NaN where the angle has no error
    of its own. ``causes`` are noise and unseen motion, one by one; ``remarks`` are (flag, severity, detail) of each.
    """

    highest_carried_order: float
    causes: tuple[Modulation, ...]
    remarks: tuple[Remark, ...]


def reference_audit(
    shaft: xr.Dataset, *, orders: Sequence[float] | Floats, revs_per_frame: float, settings: ShaftSettings
) -> ReferenceAudit:
    """Audit of the reference of a crank angle, with remarks where it must be expected to bias one of ``orders``.

    Parameters
    ----------
    shaft : ShaftAngle; of its attributes ``teeth_per_rev`` (without it: from the count of the pulses),
        ``cut_off_order`` of its smoother (none) and ``edge_step_s``, to which edges are rounded (not at all)
    orders : (orders,), cycles per crank revolution, above 0: those that are asked for
    revs_per_frame : revolutions of one frame, over which random error of the angle averages out
    settings : ``reference_bias_limit`` on loss and on sidebands; ``reference_irregularity_percent`` of the speed at
        order 1 is taken for motion that does not show where no motion is seen from which to conclude
    """
    order = np.asarray(orders, dtype=np.float64)
    reference = reference_of(shaft, revs_per_frame=revs_per_frame)
    if not np.isfinite(reference.error_rev) or not reference.teeth_per_rev > 0.0:
        detail = "the crank angle comes without pulses: nothing measured tells how far its orders can be trusted"
        by_angle = shaft.attrs.get("domain") == "crank_angle"
        return ReferenceAudit(math.nan, (), () if by_angle else (("reference_unproven", "info", detail),))
    seen = seen_motion(shaft, reference)
    percent = settings.reference_irregularity_percent
    unseen = unseen_motion(reference, expected_motion(reference, seen, percent=percent))
    causes = (pulse_noise(reference, revs_per_frame=revs_per_frame), unseen)
    limit = settings.reference_bias_limit
    above = np.maximum(_loss(causes, SOUGHT_ORDERS), _sideband(causes, SOUGHT_ORDERS)) > limit
    carried = float(SOUGHT_ORDERS[max(0, int(np.argmax(above)) - 1)]) if above.any() else math.inf
    told = "as the motion seen lets expect" if seen else f"if {percent:g} % of the speed swings at order 1"
    top = order.max(initial=0.0)
    limits = [_limits(causes, top, carried, reference, told, limit)] if top > carried else []
    return ReferenceAudit(highest_carried_order=carried, causes=causes, remarks=tuple(limits))


def _loss(causes: Sequence[Modulation], order: Floats) -> Floats:
    return np.asarray(1.0 - np.prod([1.0 - cause.loss(order) for cause in causes], axis=0))


def _sideband(causes: Sequence[Modulation], order: Floats) -> Floats:
    return np.asarray(np.max([cause.sideband(order) for cause in causes], axis=0))


def _limits(
    causes: Sequence[Modulation], top: float, carried: float, reference: Reference, told: str, limit: float
) -> Remark:
    """Remark that orders up to ``top`` are asked for and those above ``carried`` are not safe."""
    at = np.full(1, top)
    worst = max(causes, key=lambda cause: float(max(cause.loss(at)[0], cause.sideband(at)[0])))
    condition = f", {told}" if worst is causes[1] else ""
    lowest = reference.lowest_unseen(0.5 * reference.teeth_per_rev)
    one_percent = Modulation("1 %", tone_order=np.full(1, lowest), tone_rev=np.full(1, lag_rev(lowest, 0.01)))
    detail = (
        f"above order {carried:.3g} {worst.cause} may bias amplitudes by more than {_percent(limit)}: order {top:g} "
        f"loses {_percent(_loss(causes, at)[0])} and gives {_percent(_sideband(causes, at)[0])} to an order beside it"
        f"{condition}; with pulses at a rate of {reference.teeth_per_rev:.4g} per revolution no motion at order "
        f"{lowest:g} and above shows, 1 % of which would cost order {top:g} {_percent(one_percent.loss(at)[0])}"
    )
    return ("reference_limits_orders", "info", detail)


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"
