"""In-cycle motion that few pulses per revolution do not show, filled in from a model of it.

What the model predicts is taken out of the pulse times, the rest is smoothed as usual, and the prediction is put back
at many angles. So the model says what happens between the pulses; where they say otherwise they are followed.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from crankorder.engine.in_cycle import Lag
from crankorder.shaft.angle import KNOT_ERROR_SHARE, AngleKnots, time_at
from crankorder.shaft.pulses import FloatArray
from crankorder.shaft.repair import IntArray

# Standard deviation of the model's in-cycle motion as a share of it: the inertia of a flywheel is known to 10 %.
MODEL_UNCERTAINTY = 0.1
# Cubics between filled knots need not be better than this; knots are no fewer and no more than so many per revolution.
LEAST_ERROR_REV, FEWEST_KNOTS, MOST_KNOTS = 1e-7, 32, 256
# Crank revolutions of the longest engine cycle: the mean speed is taken over one before and one after.
CYCLE_REV = 2


def mean_pulse_times(
    time_s: FloatArray, tooth: IntArray, lag: Lag, *, teeth_per_rev: float, tdc_rev: float
) -> FloatArray:
    """Times (pulses,) [s] at which the mean angle, instead of the crank, has the angles of the teeth.

    Parameters
    ----------
    time_s : (pulses,), s, increasing
    tooth : (pulses,), tooth numbers, increasing
    lag : how far the crank is behind the mean angle
    teeth_per_rev : even teeth per crank revolution
    tdc_rev : crank angle at which the lag's angle is 0, where that of tooth 0 is 0
    """
    rate = mean_rate(time_s, tooth, teeth_per_rev=teeth_per_rev)
    inertia, gas = lag_parts(lag, tooth, per_rev=teeth_per_rev, zero_rev=tdc_rev)[:2]
    return time_s - (inertia + gas_share(lag, rate) * gas) / rate


def filled(
    knots: AngleKnots, lag: Lag, *, teeth_per_rev: float, tdc_rev: float, uncertainty: float = MODEL_UNCERTAINTY
) -> AngleKnots:
    """Knots of the crank angle from those of the mean angle: crank angle + lag(crank angle) = mean angle.

    Parameters
    ----------
    knots : of the mean angle, from the times of :func:`mean_pulse_times`; the angle is 0 at tooth 0
    lag : how far the crank is behind the mean angle
    teeth_per_rev : even teeth per crank revolution
    tdc_rev : crank angle at which the lag's angle is 0, where that of tooth 0 is 0
    uncertainty : standard deviation of the lag as a share of it, 0 or more; it joins the standard error by what the lag
        is off a straight line from tooth to tooth: at a tooth the pulse holds the angle, whatever the model says

    Returns
    -------
    AngleKnots at even steps of the crank angle, so many that cubics err by a tenth of the standard error.

    Raises
    ------
    RequestError where the lag would stop the shaft at the slowest speed of the knots.
    """
    slowest_rpm = float(knots.speed_rpm.min())
    lag.check(slowest_rpm)
    size = np.abs(lag.by_order(slowest_rpm))
    per_rev = _knots_per_rev(knots, lag, size)
    widest = float(size.sum())
    ends = (knots.angle_rev[[0, -1]] - tdc_rev + (-widest, widest)) * per_rev
    step = np.arange(math.ceil(ends[0]), math.floor(ends[1]) + 1)
    crank = step / per_rev + tdc_rev
    behind, gas, slope, gas_slope = lag_parts(lag, step, per_rev=per_rev, zero_rev=0.0)
    if lag.has_gas:
        # the gas acts by the speed where the mean angle is reached
        near = behind + gas_share(lag, _rate_near(crank + behind, knots)) * gas
        share = gas_share(lag, _rate_near(crank + near, knots))
        behind, slope = behind + share * gas, slope + share * gas_slope
    mean = crank + behind
    inside = (mean >= knots.angle_rev[0]) & (mean <= knots.angle_rev[-1])
    crank, mean, slope, behind = crank[inside], mean[inside], slope[inside], behind[inside]
    time_s = time_at(mean, knots.time_s, knots.angle_rev, knots.speed_rpm)
    unheld = uncertainty * (behind - _held_by_teeth(crank, behind, teeth_per_rev))
    error = np.hypot(np.interp(time_s, knots.time_s, knots.standard_error_rev), unheld)
    speed_rpm = _speed_at(time_s, knots) / (1.0 + slope)
    return replace(knots, time_s=time_s, angle_rev=crank, speed_rpm=speed_rpm, standard_error_rev=error)


def mean_rate(time_s: FloatArray, tooth: IntArray, *, teeth_per_rev: float) -> FloatArray:
    """Mean speed (pulses,) [rev/s] over the cycles about each pulse; it runs straight on at either end.

    ``time_s``: (pulses,), s, increasing. ``tooth``: (pulses,), their numbers, increasing. ``teeth_per_rev``: even teeth
    per crank revolution.
    """
    reach = min(CYCLE_REV * teeth_per_rev, 0.5 * float(tooth[-1] - tooth[0]))
    low, high = tooth[0] + reach, tooth[-1] - reach

    def about(centre: FloatArray) -> FloatArray:
        before, after = np.interp(centre - reach, tooth, time_s), np.interp(centre + reach, tooth, time_s)
        rate: FloatArray = 2.0 * reach / (teeth_per_rev * (after - before))
        return rate

    rate = about(np.clip(tooth, low, high))
    if high - low >= reach:
        start, inner, outer, stop = about(np.array([low, low + reach, high - reach, high]))
        rate += np.minimum(tooth - low, 0.0) * (inner - start) / reach
        rate += np.maximum(tooth - high, 0.0) * (stop - outer) / reach
    return rate


def lag_parts(
    lag: Lag, step: IntArray, *, per_rev: float, zero_rev: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Inertia and gas part [rev] of a lag and of its slope [1] at even steps of the crank angle, each (steps,).

    ``lag``: its gas part is that at its reference speed. ``step``: (steps,), their numbers. ``per_rev``: steps per
    crank revolution. ``zero_rev``: where on the scale of step / per_rev the lag's angle is 0.
    """
    rate = 2j * np.pi * lag.order
    parts = np.array([lag.inertia, lag.gas, lag.inertia * rate, lag.gas * rate]) * np.exp(-zero_rev * rate)
    period, lines = CYCLE_REV * per_rev, CYCLE_REV * lag.order
    if not float(period).is_integer() or not np.allclose(lines, np.rint(lines), rtol=0.0, atol=1e-12):
        turned = np.exp((step / per_rev)[:, None] * rate)
        inertia, gas, slope, gas_slope = np.einsum("so,po->ps", turned, parts).real
        return inertia, gas, slope, gas_slope
    # what repeats after a cycle is summed once, by a transform: lines above its highest fold to where they belong
    spectrum = np.zeros((int(period), 4), dtype=np.complex128)
    np.add.at(spectrum, np.rint(lines).astype(int) % int(period), parts.T)
    inertia, gas, slope, gas_slope = (np.fft.ifft(spectrum, axis=0).real * period)[step % int(period)].T
    return inertia, gas, slope, gas_slope


def gas_share(lag: Lag, rate: FloatArray) -> FloatArray:
    """Factor (any shape) of the gas part of ``lag`` at the mean speeds ``rate`` (any shape) [rev/s]."""
    share: FloatArray = (lag.reference_rpm / (60.0 * rate)) ** 2
    return share


def _knots_per_rev(knots: AngleKnots, lag: Lag, size: FloatArray) -> int:
    """Knots per revolution at which cubics through the lag, and through the mean angle, err by little enough."""
    bend = float(np.sum(size * (2.0 * np.pi * lag.order) ** 4))
    allowed = max(LEAST_ERROR_REV, KNOT_ERROR_SHARE * float(np.median(knots.standard_error_rev)))
    closest = float(np.diff(knots.angle_rev).min())
    wanted: float = max(FEWEST_KNOTS, 4.0 / closest, (bend / (384.0 * allowed)) ** 0.25)
    return math.ceil(min(MOST_KNOTS, wanted))


def _rate_near(mean_rev: FloatArray, knots: AngleKnots) -> FloatArray:
    return np.interp(mean_rev, knots.angle_rev, knots.speed_rpm) / 60.0


def _speed_at(time_s: FloatArray, knots: AngleKnots) -> FloatArray:
    """Speed [rpm] of the cubics of ``knots`` at times within them."""
    k = np.clip(np.searchsorted(knots.time_s, time_s, side="right") - 1, 0, knots.time_s.size - 2)
    step = np.diff(knots.time_s)
    rise = 60.0 * np.diff(knots.angle_rev) / step
    first, second = knots.speed_rpm[:-1], knots.speed_rpm[1:]
    c2, c3 = 3.0 * rise - 2.0 * first - second, first + second - 2.0 * rise
    x = (time_s - knots.time_s[k]) / step[k]
    speed: FloatArray = first[k] + x * (2.0 * c2[k] + 3.0 * x * c3[k])
    return speed


def _held_by_teeth(crank_rev: FloatArray, behind: FloatArray, teeth_per_rev: float) -> FloatArray:
    """The lag ``behind`` straight from tooth to tooth."""
    first, last = math.ceil(crank_rev[0] * teeth_per_rev), math.floor(crank_rev[-1] * teeth_per_rev)
    teeth = np.arange(first, last + 1) / teeth_per_rev
    return np.interp(crank_rev, teeth, np.interp(teeth, crank_rev, behind))
