"""Torsional fluctuation within the cycle that few pulses per revolution do not show, filled in from an engine model.

What the model predicts is taken out of the pulse times, the rest is smoothed as usual, and the prediction is put back
at many angles. So the model says what happens between the pulses; where they say otherwise they are followed, and its
gas is scaled as far as they show it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from crankorder.engine.definition import Engine
from crankorder.engine.in_cycle import TORQUE_ORDERS, Lag, lag_from_torque
from crankorder.errors import RequestError
from crankorder.quantities import Severity
from crankorder.settings import ShaftSettings
from crankorder.shaft.angle import KNOT_ERROR_SHARE, AngleKnots, angle_knots, time_at
from crankorder.shaft.pulses import FloatArray, Remark
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


# Orders up to this share of the teeth per revolution are carried by the teeth to some 0.02 %.
CARRIED_SHARE = 0.1
# In-cycle motion above what the teeth carry is filled in from this size on: it turns order 5.5 by 0.2 degrees.
MISSED_REV = 1e-4
# Revolutions from which those of a cycle are told apart, and blocks of them whose scatter is the error.
FEWEST_REVS, BLOCKS = 20, 8
# Share of the model's half orders that counts as none; farthest from all of it that counts as all; largest error of it.
NO_GAS, TOO_FAR, TOO_UNCERTAIN = 0.25, 0.5, 0.1
# Standard errors from which a difference is certain.
CERTAIN = 5.0
# Fourth difference, of which an alternation of 1 makes 16 and slow changes make nothing.
FOURTH = (1.0, -4.0, 6.0, -4.0, 1.0)
# Orders that are named: those with this share of the largest one's part in the speed.
NAMED_SHARE = 0.1


@dataclass(frozen=True)
class InCycleModel:
    """In-cycle motion to fill in, None where nothing is, and what was found on the way.

    ``turns``: 1 where the pulses show that the other of two top dead centres fires: the cycle then starts there.
    ``cycle_known``: whether the firing one is known now.
    """

    lag: Lag | None
    turns: int
    cycle_known: bool
    flags: list[Remark]


def knots_with_model(
    engine: Engine,
    time_s: FloatArray,
    tooth: IntArray,
    *,
    teeth_per_rev: float,
    tdc_rev: float,
    cycle_known: bool,
    noise_s: float | None,
    settings: ShaftSettings,
) -> tuple[AngleKnots, InCycleModel]:
    """Knots of the crank angle, 0 at tooth 0, with the in-cycle motion that :func:`in_cycle_model` has to fill in.

    ``engine``, ``time_s`` (pulses,) [s], ``tooth`` (pulses,), ``teeth_per_rev``, ``tdc_rev`` and ``cycle_known`` are
    those of :func:`in_cycle_model`; ``noise_s`` (s, or None) and ``settings`` those of
    :func:`crankorder.shaft.angle.angle_knots`, which makes the knots where nothing is filled in.
    """
    model = in_cycle_model(engine, time_s, tooth, teeth_per_rev=teeth_per_rev, tdc_rev=tdc_rev, cycle_known=cycle_known)
    if model.lag is not None:
        zero_rev = tdc_rev + model.turns
        even_s = mean_pulse_times(time_s, tooth, model.lag, teeth_per_rev=teeth_per_rev, tdc_rev=zero_rev)
        mean = angle_knots(even_s, tooth, teeth_per_rev=teeth_per_rev, noise_s=noise_s, settings=settings)
        try:
            return filled(mean, model.lag, teeth_per_rev=teeth_per_rev, tdc_rev=zero_rev), model
        except RequestError as error:
            model = _not_filled(InCycleModel(None, 0, cycle_known, []), "suspect", error.problem)
    return angle_knots(time_s, tooth, teeth_per_rev=teeth_per_rev, noise_s=noise_s, settings=settings), model


def in_cycle_model(
    engine: Engine,
    time_s: FloatArray,
    tooth: IntArray,
    *,
    teeth_per_rev: float,
    tdc_rev: float,
    cycle_known: bool,
) -> InCycleModel:
    """In-cycle motion that the pulses of one recording do not carry, from the torques on the crank of ``engine``.

    Only gas makes the two revolutions of a four-stroke cycle differ, so the pulses show whether it works as the model
    says, and which top dead centre fires. Where they do not differ the masses work alone. Where they differ otherwise,
    or where it does not show and the firing one is not known, half orders are left out.

    Parameters
    ----------
    engine : its masses, ``flywheel_inertia_kg_m2`` and gas
    time_s : (pulses,), s, increasing
    tooth : (pulses,), tooth numbers, increasing
    teeth_per_rev : even teeth per crank revolution
    tdc_rev : crank angle of a top dead centre, the firing one if ``cycle_known``, where that of tooth 0 is 0
    cycle_known : whether ``tdc_rev`` fires

    Returns
    -------
    InCycleModel, with a remark where there is something to fill in.
    """
    nothing = InCycleModel(None, 0, cycle_known, [])
    if CARRIED_SHARE * teeth_per_rev >= TORQUE_ORDERS:
        return nothing
    if engine.flywheel_inertia_kg_m2 is None:
        few = CARRIED_SHARE * teeth_per_rev < 1.0
        return _not_filled(nothing, "info", "the engine states no flywheel_inertia_kg_m2") if few else nothing
    rate = mean_rate(time_s, tooth, teeth_per_rev=teeth_per_rev)
    rpm = 60.0 * float(np.median(rate))
    try:
        lag = _lag(engine, engine.flywheel_inertia_kg_m2, rpm)
        lag.check(60.0 * float(rate.min()))
    except RequestError as error:
        return _not_filled(nothing, "suspect", error.problem)
    size = np.abs(lag.by_order(rpm))
    if size[lag.order > CARRIED_SHARE * teeth_per_rev].sum() < MISSED_REV:
        return nothing
    seen = _alternation(time_s, tooth, teeth_per_rev) if engine.revs_per_cycle == 2 else None
    if not lag.has_gas:
        return _by_masses(nothing, lag, seen, rpm)
    half = np.rint(2.0 * lag.order) % 2 == 1
    if size[half].sum() < MISSED_REV:
        return _with(nothing, lag, rpm, "the torque of masses and gas")
    return _by_share(nothing, lag, half, _share_of(seen, lag, half, teeth_per_rev, tdc_rev), rpm)


def _lag(engine: Engine, flywheel_inertia_kg_m2: float, rpm: float) -> Lag:
    return lag_from_torque(
        engine,
        flywheel_inertia_kg_m2=flywheel_inertia_kg_m2,
        speed_rpm=rpm,
        highest_order=TORQUE_ORDERS,
        with_gas=engine.gas is not None,
    )


@dataclass(frozen=True)
class _Alternation:
    """What changes sign from revolution to revolution in when the teeth come: angle [rev] by (revolution, tooth).

    ``tooth``: their numbers. ``rate``: mean speed [rev/s] there.
    """

    angle_rev: FloatArray
    tooth: IntArray
    rate: FloatArray


def _alternation(time_s: FloatArray, tooth: IntArray, teeth_per_rev: float) -> _Alternation | None:
    """How the teeth alternate from revolution to revolution; None where that cannot be told."""
    teeth = round(teeth_per_rev)
    revs = int(tooth[-1] - tooth[0] + 1) // max(teeth, 1)
    if teeth != teeth_per_rev or revs < FEWEST_REVS:
        return None
    number = tooth[0] + np.arange(revs * teeth)
    times = np.interp(number, tooth, time_s).reshape(revs, teeth)
    change = np.zeros((revs - 4, teeth))
    for k, weight in enumerate(FOURTH):
        change += weight / 16.0 * times[k : revs - 4 + k]
    rate = np.interp(number, tooth, mean_rate(time_s, tooth, teeth_per_rev=teeth_per_rev)).reshape(revs, teeth)[2:-2]
    return _Alternation(change * rate, number.reshape(revs, teeth)[2:-2], rate)


def _blocks(rows: FloatArray) -> list[FloatArray]:
    """``rows`` in blocks of an even number of them."""
    length = 2 * (rows.shape[0] // (2 * BLOCKS))
    return [rows[k * length : (k + 1) * length] for k in range(BLOCKS)]


def _share_of(
    seen: _Alternation | None, lag: Lag, half: npt.NDArray[np.bool_], teeth_per_rev: float, tdc_rev: float
) -> tuple[float, float]:
    """Share of the ``half`` orders of ``lag`` that is seen, below 0 where the other revolution fires; its error."""
    if seen is None:
        return 0.0, math.inf
    gas = lag_parts(_part(lag, half), seen.tooth.ravel(), per_rev=teeth_per_rev, zero_rev=tdc_rev)[1]
    model = gas_share(lag, seen.rate) * gas.reshape(seen.tooth.shape)
    power = np.array([float(np.sum(block**2)) for block in _blocks(model)])
    if power.min() <= 0.0:
        return 0.0, math.inf
    share = np.array([float(np.sum(block)) for block in _blocks(model * seen.angle_rev)]) / power
    return float(share.mean()), float(share.std(ddof=1)) / math.sqrt(BLOCKS)


def _by_masses(model: InCycleModel, lag: Lag, seen: _Alternation | None, rpm: float) -> InCycleModel:
    """``lag`` of masses alone, unless the pulses show that gas works too."""
    if seen is not None:
        sign = np.where(np.arange(seen.angle_rev.shape[0]) % 2, -1.0, 1.0)[:, None]
        means = np.array([block.mean(axis=0) for block in _blocks(sign * seen.angle_rev)])
        worst = int(np.argmax(np.abs(means.mean(axis=0))))
        size, error = abs(float(means[:, worst].mean())), float(means[:, worst].std(ddof=1)) / math.sqrt(BLOCKS)
        if size > max(MISSED_REV, CERTAIN * error):
            why = f"pulses of one revolution and the next differ by {720 * size:.2g} degrees, as gas makes them"
            return _not_filled(model, "suspect", f"{why}, and the engine states none")
    return _with(model, lag, rpm, "the torque of the masses")


def _by_share(
    model: InCycleModel, lag: Lag, half: npt.NDArray[np.bool_], seen: tuple[float, float], rpm: float
) -> InCycleModel:
    """``lag`` as far as the share of its half orders that is seen, and the error of that, allow."""
    share, error = seen
    told = f"{100 * abs(share):.0f} ± {100 * error:.0f} % of the half orders of the gas"
    hidden = error > TOO_UNCERTAIN
    if hidden and model.cycle_known:
        return _with(model, lag, rpm, "the torque of masses and gas, unseen by the pulses")
    if not hidden and abs(share) + 2.0 * error < NO_GAS:
        alone = Lag(order=lag.order, inertia=lag.inertia, gas=np.zeros_like(lag.gas))
        return _with(model, alone, rpm, f"the torque of the masses alone: the pulses show {told}")
    if not hidden and abs(abs(share) - 1.0) < TOO_FAR and (share > 0.0 or not model.cycle_known):
        found = replace(model, turns=int(share < 0.0), cycle_known=True)
        if not model.cycle_known:
            detail = f"which top dead centre fires is told by the pulses: they show {told}"
            found = replace(found, flags=[*found.flags, ("cycle_phase_from_model", "info", detail)])
        return _with(found, lag, rpm, f"the torque of masses and gas: the pulses show {told}")
    if hidden:
        why = "the pulses do not show which top dead centre fires"
    elif share < 0.0 and model.cycle_known:
        why = f"the pulses show {told} where the other revolution should fire"
    else:
        why = f"the pulses show {told}, not all of it"
    remark: Remark = ("in_cycle_half_orders", "suspect", f"half orders of the motion are not filled in: {why}")
    return _with(replace(model, flags=[*model.flags, remark]), _part(lag, ~half), rpm, "the torque of masses and gas")


def _part(lag: Lag, kept: npt.NDArray[np.bool_]) -> Lag:
    return replace(lag, order=lag.order[kept], inertia=lag.inertia[kept], gas=lag.gas[kept])


def _with(model: InCycleModel, lag: Lag, rpm: float, cause: str) -> InCycleModel:
    """``model`` that fills in ``lag``, and says so."""
    speed = 2.0 * np.pi * lag.order * np.abs(lag.by_order(rpm))
    named = ", ".join(f"{order:g}" for order in lag.order[speed > NAMED_SHARE * speed.max()])
    _, _, slope, gas_slope = lag_parts(lag, np.arange(512), per_rev=256, zero_rev=0.0)
    turning = 1.0 / (1.0 + slope + gas_share(lag, np.full(1, rpm / 60.0)) * gas_slope)
    percent = 100.0 * float(np.ptp(turning)) / float(turning.mean())
    detail = f"{percent:.2g} % of speed irregularity at {rpm:.0f} rpm, orders {named}, filled in from {cause}"
    return replace(model, lag=lag, flags=[*model.flags, ("in_cycle_from_model", "info", detail)])


def _not_filled(model: InCycleModel, severity: Severity, why: str) -> InCycleModel:
    detail = f"too few pulses per revolution to show the speed within the cycle, and no model of it: {why}"
    return replace(model, flags=[*model.flags, ("in_cycle_not_filled", severity, detail)])
