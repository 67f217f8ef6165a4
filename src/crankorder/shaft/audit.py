"""What a crank angle can carry: the bias of each order to expect of its reference, before any is computed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from crankorder.settings import ShaftSettings
from crankorder.shaft.pulses import FloatArray, Remark
from crankorder.shaft.reference_errors import (
    Modulation,
    Reference,
    lag_rev,
    pulse_noise,
    reference_of,
    rounding_in_step,
    seen_motion,
    unseen_motion,
)

# Orders among which the highest that is carried is sought, 0.8 % apart.
SOUGHT_ORDERS = np.geomspace(1e-2, 1e5, 2048)


@dataclass(frozen=True)
class ReferenceAudit:
    """What the reference of a crank angle does to a line at each ``order`` (orders,).

    ``loss``: share of its amplitude that it loses; ``sideband``: largest share that it gives to an order beside it;
    ``phase_deg``: standard deviation of the phase of one frame. Up to ``highest_carried_order`` neither loss nor
    sideband is above the limit. In-cycle motion at ``lowest_unseen_order`` and above does not show in the angle; one
    percent of speed there costs ``loss_per_percent`` (orders,). ``causes``: noise, unseen motion and rounding, apart.
    ``remarks``: (flag, severity, detail) of each. Numbers are NaN where the angle has no error of its own.
    """

    order: FloatArray
    loss: FloatArray
    sideband: FloatArray
    phase_deg: FloatArray
    highest_carried_order: float
    lowest_unseen_order: float
    loss_per_percent: FloatArray
    causes: tuple[Modulation, ...]
    remarks: tuple[Remark, ...]


def reference_audit(
    shaft: xr.Dataset,
    *,
    orders: Sequence[float] | FloatArray,
    revs_per_frame: float,
    settings: ShaftSettings,
    irregularity: Mapping[float, float] | None = None,
) -> ReferenceAudit:
    """Bias of amplitude and phase at each of ``orders`` that the reference of a crank angle must be expected to cause.

    Parameters
    ----------
    shaft : ShaftAngle; of its attributes ``teeth_per_rev`` (without it: from the count of the pulses),
        ``cut_off_order`` of its smoother (none) and ``edge_step_s``, to which edges are rounded (not at all)
    orders : (orders,), cycles per crank revolution, above 0: those that are asked for
    revs_per_frame : revolutions of one frame, over which random error of the angle averages out
    settings : ``reference_bias_limit`` on loss and on sidebands; ``reference_irregularity_percent`` of the speed at
        order 1 is taken for motion that does not show where no motion is seen from which to conclude
    irregularity : amplitude of the in-cycle speed over the mean speed, by order, from an engine model; it takes the
        place of what is seen and of what is assumed
    """
    order = np.asarray(orders, dtype=np.float64)
    reference = reference_of(shaft, revs_per_frame=revs_per_frame)
    if not np.isfinite(reference.error_rev) or not reference.teeth_per_rev > 0.0:
        return _unproven(order, by_angle=shaft.attrs.get("domain") == "crank_angle")
    seen = seen_motion(shaft, reference)
    percent = settings.reference_irregularity_percent
    causes = (
        pulse_noise(reference, revs_per_frame=revs_per_frame),
        unseen_motion(reference, seen, percent=percent, irregularity=irregularity),
        rounding_in_step(shaft, reference, seen, revs_per_frame=revs_per_frame),
    )
    lowest = reference.lowest_unseen(0.5 * reference.teeth_per_rev)
    one_percent = Modulation("1 %", tone_order=np.full(1, lowest), tone_rev=np.full(1, lag_rev(lowest, 0.01)))
    carried = _carried(causes, settings.reference_bias_limit)
    told = "as the engine model has it" if irregularity is not None else ""
    if irregularity is None:
        told = "as the motion seen lets expect" if seen else f"if {percent:g} % of the speed swings at order 1"
    remarks: list[Remark] = []
    if order.size and order.max() > carried:
        remarks.append(_limits(causes, order.max(), carried, reference, one_percent, told, settings))
    if order.size and (causes[2].tone_rev.size or causes[2].still_rev > 0.0):
        remarks.append(_steps(causes[2], order.max(), settings.reference_bias_limit))
    return ReferenceAudit(
        order=order,
        loss=_loss(causes, order),
        sideband=_sideband(causes, order),
        phase_deg=np.sqrt(np.sum([cause.phase_deg(order) ** 2 for cause in causes], axis=0)),
        highest_carried_order=carried,
        lowest_unseen_order=lowest,
        loss_per_percent=one_percent.loss(order),
        causes=causes,
        remarks=tuple(remarks),
    )


def _unproven(order: FloatArray, *, by_angle: bool) -> ReferenceAudit:
    """The audit of an angle that comes without any error of its own; ``by_angle``: the recording was sampled by it."""
    unknown = np.full(order.size, np.nan)
    detail = "the crank angle comes without pulses: nothing measured tells how far its orders can be trusted"
    remarks: tuple[Remark, ...] = () if by_angle else (("reference_unproven", "info", detail),)
    return ReferenceAudit(order, unknown, unknown, unknown, math.nan, math.nan, unknown, (), remarks)


def _loss(causes: Sequence[Modulation], order: FloatArray) -> FloatArray:
    return np.asarray(1.0 - np.prod([1.0 - cause.loss(order) for cause in causes], axis=0))


def _sideband(causes: Sequence[Modulation], order: FloatArray) -> FloatArray:
    return np.asarray(np.max([cause.sideband(order) for cause in causes], axis=0))


def _carried(causes: Sequence[Modulation], limit: float) -> float:
    """Highest order up to which neither loss nor any sideband is above ``limit``; infinite where none is."""
    above = np.maximum(_loss(causes, SOUGHT_ORDERS), _sideband(causes, SOUGHT_ORDERS)) > limit
    return float(SOUGHT_ORDERS[max(0, int(np.argmax(above)) - 1)]) if above.any() else math.inf


def _limits(
    causes: Sequence[Modulation],
    top: float,
    carried: float,
    reference: Reference,
    one_percent: Modulation,
    told: str,
    settings: ShaftSettings,
) -> Remark:
    """Remark that orders up to ``top`` are asked for and those above ``carried`` are not safe."""
    at = np.full(1, top)
    worst = max(causes, key=lambda cause: float(max(cause.loss(at)[0], cause.sideband(at)[0])))
    condition = f", {told}" if worst is causes[1] else ""
    detail = (
        f"above order {carried:.3g} {worst.cause} may bias amplitudes by more than "
        f"{_percent(settings.reference_bias_limit)}: order {top:g} loses {_percent(_loss(causes, at)[0])} and gives "
        f"{_percent(_sideband(causes, at)[0])} to an order beside it{condition}; with pulses at a rate of "
        f"{reference.teeth_per_rev:.4g} per revolution no motion at order "
        f"{one_percent.tone_order[0]:g} and above shows, 1 % of which would cost "
        f"order {top:g} {_percent(one_percent.loss(at)[0])}"
    )
    return ("reference_limits_orders", "suspect", detail)


def _steps(step: Modulation, top: float, limit: float) -> Remark:
    """Remark that the sampling is in step with the pulses, with what that does to order ``top``."""
    at = np.full(1, top)
    if not step.tone_rev.size:
        detail = (
            f"sampling and pulses are in step: every edge is off alike, by up to {360.0 * step.still_rev:.2g}°, which "
            f"turns the phase of order {top:g} by up to {360.0 * top * step.still_rev:.2g}°"
        )
        return ("reference_in_step", "info", detail)
    first = int(np.argmax(step.tone_rev))
    from_order = _carried([step], limit)
    reach = f"more than {_percent(limit)} from order {from_order:.3g}" if from_order < math.inf else "nowhere much"
    detail = (
        f"sampling and pulses are nearly in step: edges are off by a pattern of {360.0 * step.tone_rev[first]:.2g}° "
        f"that comes back at order {step.tone_order[first]:.3g}; so far beside a line at order {top:g} stands "
        f"{_percent(step.sideband(at)[0])} of it, {reach}"
    )
    return ("reference_in_step", "info", detail)


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"
