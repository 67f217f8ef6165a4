"""Which in-cycle motion an engine model has to fill in: what pulses do not carry, with gas as far as they show it."""

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
from crankorder.shaft.angle import AngleKnots, angle_knots
from crankorder.shaft.fill import filled, gas_share, lag_parts, mean_pulse_times, mean_rate
from crankorder.shaft.pulses import FloatArray, Remark
from crankorder.shaft.repair import IntArray

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
