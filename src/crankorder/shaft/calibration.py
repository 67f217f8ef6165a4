"""Errors of an encoder's lines, told from the motion within the cycle by recordings at several speeds.

What line n deviates by (order by order of the encoder) is E + A + G / speed²: E the error of the line, A the motion
from the masses, whose torque and whose flywheel's energy both grow with speed², G that from the gas. G is the part that
changes with speed. A is not told from E by any speed: it is taken from the shape that the engine model gives it, or
the orders at which masses may work are left alone, and said to be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from crankorder.engine.definition import Engine
from crankorder.engine.in_cycle import TORQUE_ORDERS, Lag, lag_from_torque
from crankorder.shaft.line_pattern import LinePattern, first_order
from crankorder.shaft.pulses import FloatArray, Remark

ComplexArray = npt.NDArray[np.complex128]
BoolArray = npt.NDArray[np.bool_]

# Highest crank order at which masses turn the shaft noticeably, of any engine: order 6 has 1/10 000 of order 2.
HIGHEST_MASS_ORDER = 6
# Lag [rev] that counts as none.
NO_LAG_REV = 1e-8
# Least standard error [rev] of an amplitude by order: what is left out of the model is no smaller.
LEAST_ERROR_REV = 1e-8
# A misfit beyond its expected value by so many standard deviations is one, and widens the intervals.
MISFIT_DEVIATIONS = 5.0
# Squared amplitude over its variance above which an order stands for itself: by chance one order in 400 does.
STANDS_OUT = 6.0
# Share of the squared deviation, at the orders of the masses, that the engine's shape may leave unexplained.
LEFT_SHARE = 0.005
# An error beyond this share of the deviation itself says nothing of the encoder.
USELESS_SHARE = 0.5
# Inertia, in masses that go to and fro at the crank radius, with which the irregularity is small.
STIFF_INERTIA = 1000.0
NORMAL_95 = 1.959964


@dataclass(frozen=True, eq=False)
class Calibration:
    """Errors of an encoder's lines as far as they can be told from motion; 0 where they cannot, so always safe to use.

    ``line_error_rev`` (line,) is the true place of each line less where it should be, in encoder revolutions, and
    ``standard_error_rev`` (line,) its standard error. The angle that the encoder shows, less the true one, goes as
    eccentricity_deg · sin(2π turn + eccentricity_phase_deg), turn counted from the line at the index; the 95 %
    intervals hold each of both, NaN where it cannot be told. ``line_error_deg``: rms of the rest. ``unknown_orders``:
    crank orders left alone because masses may make them. ``lag_scale``: of the engine's lag as found, NaN if not.
    ``separated``: whether speeds told error from motion at all.
    """

    line_error_rev: FloatArray
    standard_error_rev: FloatArray
    eccentricity_deg: float
    eccentricity_ci95_deg: tuple[float, float]
    eccentricity_phase_deg: float
    eccentricity_phase_ci95_deg: tuple[float, float]
    line_error_deg: float
    unknown_orders: tuple[int, ...]
    lag_scale: float
    separated: bool
    remarks: list[Remark]


class _Parts(NamedTuple):
    """Complex amplitudes (order,) [rev] of what is fixed in angle, their error variances, and whether they misfit."""

    fixed: ComplexArray
    variance: FloatArray
    misfit: BoolArray


class _Masses(NamedTuple):
    """Motion of the masses (order,) [rev], its variance, the orders it has, those unknown and why, its scale."""

    motion: ComplexArray
    variance: FloatArray
    works: BoolArray
    unknown: BoolArray
    reason: str = ""
    scale: float = math.nan


def calibrate(
    patterns: list[LinePattern],
    *,
    ratio: float = 1.0,
    engine_lag: Lag | None = None,
    index_to_tdc_deg: float | None = None,
    lag_scale_error: float = math.inf,
    least_speed_ratio: float = 1.2,
) -> Calibration:
    """Line errors of one encoder from its patterns at several speeds, with what could not be told and why.

    Parameters
    ----------
    patterns : one per recording, of the same encoder; those without revolutions are left out
    ratio : encoder revolutions per crank revolution
    engine_lag : in-cycle motion whose ``inertia`` part has the shape of the masses' motion, at any scale; without
        orders: there are no masses that go to and fro; None: not known, then orders that masses may make stay alone
    index_to_tdc_deg : crank angle from the index to top dead centre, where ``engine_lag`` is at 0; None where unknown
    lag_scale_error : standard deviation of the scale of ``engine_lag`` about 1; infinite where its flywheel is a guess
    least_speed_ratio : above 1; highest over lowest speed below which nothing is told apart

    Returns
    -------
    Calibration with remarks: ``encoder_calibrated``, ``encoder_calibration_partial``, ``encoder_calibration_misfit`` or
    ``encoder_calibration_not_possible`` with the reason.
    """
    usable = [pattern for pattern in patterns if pattern.n_revs]
    usable = [pattern for pattern in usable if pattern.deviation_rev.size == usable[0].deviation_rev.size]
    reason = _refusal(patterns, usable, least_speed_ratio)
    if reason:
        return _not_possible(reason, patterns[0].deviation_rev.size if patterns else 1)
    parts = _fixed_part([first_order(pattern, np.zeros(pattern.deviation_rev.size)) for pattern in usable])
    largest = max(abs(pattern.harmonic_rev[1]) for pattern in usable)
    seen = any(abs(p.harmonic_rev[1]) ** 2 > STANDS_OUT * p.harmonic_variance[1] for p in usable)
    if seen and math.sqrt(parts.variance[1]) > USELESS_SHARE * largest:
        told = f"{_speeds(usable)} leave {360.0 * math.sqrt(parts.variance[1]):.2g}° of doubt in what is seen"
        return _not_possible(f"{told}, {360.0 * largest:.2g}°: take speeds further apart", usable[0].deviation_rev.size)
    masses = _masses_part(parts, usable[0], ratio, engine_lag, index_to_tdc_deg, lag_scale_error)
    first = _result(usable, parts, masses, ratio)
    parts = _fixed_part([first_order(pattern, first.line_error_rev) for pattern in usable])
    masses = _masses_part(parts, usable[0], ratio, engine_lag, index_to_tdc_deg, lag_scale_error)
    return _result(usable, parts, masses, ratio)


def mass_lag(engine: Engine, *, flywheel_inertia_kg_m2: float | None = None) -> Lag:
    """In-cycle motion from the masses of ``engine`` alone, as of small irregularity, for :func:`calibrate`.

    ``engine``: lengths, masses and cylinders; without masses that go to and fro there are no orders.
    ``flywheel_inertia_kg_m2``: of all that turns with the crank; where None that of the engine, and where it has none a
    large one, for only the shape is known then.
    """
    inertia = flywheel_inertia_kg_m2 or engine.flywheel_inertia_kg_m2
    stiff = STIFF_INERTIA * max(1e-12, engine.largest_piston_kg * engine.crank_radius_m**2)
    shape = lag_from_torque(
        engine, flywheel_inertia_kg_m2=stiff, speed_rpm=1000.0, highest_order=TORQUE_ORDERS, with_gas=False
    )
    scale = 1.0 if inertia is None else stiff / inertia
    return Lag(order=shape.order, inertia=scale * shape.inertia, gas=0.0 * shape.inertia)


def _speeds(patterns: list[LinePattern]) -> str:
    speeds = [pattern.speed_rpm for pattern in patterns]
    return f"{len(speeds)} recordings at {min(speeds):.0f} to {max(speeds):.0f} rpm"


def _refusal(patterns: list[LinePattern], usable: list[LinePattern], least_speed_ratio: float) -> str:
    """Why error and motion cannot be told apart; empty where they can, as far as the speeds go."""
    if not usable:
        reasons = sorted({pattern.reason for pattern in patterns})
        return "no recording shows a pattern of lines" + (f": {'; '.join(reasons)}" if reasons else "")
    speeds = [pattern.speed_rpm for pattern in usable]
    if len(usable) == 1:
        return f"only one recording, at {speeds[0]:.0f} rpm: an error of the lines and motion look the same in it"
    if max(speeds) < least_speed_ratio * min(speeds):
        told = f"{_speeds(usable)}: an error of the lines and motion look the same there"
        return f"{told}; the highest speed must be {least_speed_ratio:g} times the lowest"
    return ""


def _not_possible(reason: str, lines: int) -> Calibration:
    nothing, none = np.zeros(lines), (math.nan, math.nan)
    remark: Remark = ("encoder_calibration_not_possible", "suspect", reason)
    return Calibration(
        nothing, nothing, math.nan, none, math.nan, none, math.nan, (), math.nan, separated=False, remarks=[remark]
    )


def _fixed_part(patterns: list[LinePattern]) -> _Parts:
    """What does not change with speed, order by order, by weighted least squares beside a part that goes as 1/speed².

    Where recordings differ by more than their errors the variance grows by as much.
    """
    value = np.array([pattern.harmonic_rev for pattern in patterns])
    variance = np.array([pattern.harmonic_variance for pattern in patterns]) + LEAST_ERROR_REV**2
    slow = min(pattern.speed_rpm for pattern in patterns)
    gas = np.array([(slow / pattern.speed_rpm) ** 2 for pattern in patterns])[:, None]
    weight = 1.0 / variance
    total, first, second = weight.sum(0), (weight * gas).sum(0), (weight * gas**2).sum(0)
    level, slope = (weight * value).sum(0), (weight * gas * value).sum(0)
    determinant = total * second - first**2
    fixed = (second * level - first * slope) / determinant
    changing = (total * slope - first * level) / determinant
    fixed_variance = second / determinant
    freedom = 2 * (len(patterns) - 2)
    misfit = np.ones(fixed.size)
    if freedom:
        misfit = 2.0 * np.sum(weight * np.abs(value - fixed - gas * changing) ** 2, axis=0) / freedom
    bad = misfit > 1.0 + MISFIT_DEVIATIONS * math.sqrt(2.0 / max(freedom, 1))
    return _Parts(fixed, np.where(bad, misfit, 1.0) * fixed_variance, bad)


def _masses_part(
    parts: _Parts,
    pattern: LinePattern,
    ratio: float,
    engine_lag: Lag | None,
    index_to_tdc_deg: float | None,
    scale_error: float,
) -> _Masses:
    """Motion of the masses: the engine's, its scale fitted at orders above the first, where lines err at random."""
    order = np.arange(parts.fixed.size)
    nothing = np.zeros(order.size, dtype=np.complex128)
    whole = (np.abs(order * ratio - np.rint(order * ratio)) < 1e-9) & (order > 0)
    low = whole & (order * ratio < HIGHEST_MASS_ORDER + 0.5)
    if engine_lag is None:
        return _Masses(nothing, nothing.real, low, low, "the engine is not known")
    shape, works = _lag_pattern(engine_lag, pattern, ratio, index_to_tdc_deg or 0.0)
    if not works.any():
        return _Masses(nothing, nothing.real, works, works & False)
    if index_to_tdc_deg is None:
        return _Masses(nothing, nothing.real, works, works, "top dead centre is not known")
    fitted, random = works & (order > 1), ~works & (order > 1)
    weight = np.where(fitted, 1.0 / (parts.variance + _line_variance(parts, random)[0]), 0.0)
    # the scale counts as one more observation where it is known
    prior = 0.0 if math.isinf(scale_error) else 0.5 / scale_error**2
    strength = float(np.sum(weight * np.abs(shape) ** 2)) + prior
    if strength == 0.0:
        return _Masses(nothing, nothing.real, works, works, "the engine's motion is at one order only")
    scale = (float(np.sum(weight * (shape.conj() * parts.fixed).real)) + prior) / strength
    rest = np.abs(parts.fixed - scale * shape) ** 2
    freedom = 2 * int(fitted.sum()) - (prior == 0.0)
    misfit = 2.0 * (float(np.sum(weight * rest)) + prior * (scale - 1.0) ** 2) / freedom
    grown = misfit if misfit > 1.0 + MISFIT_DEVIATIONS * math.sqrt(2.0 / freedom) else 1.0
    scale_variance = 0.5 * grown / strength
    left_out = float(np.sum(rest[fitted])) > LEFT_SHARE * float(np.sum(np.abs(parts.fixed[fitted]) ** 2))
    if (grown > 1.0 and left_out) or scale < -3.0 * math.sqrt(scale_variance):
        return _Masses(nothing, nothing.real, works, works | low, "what is seen has not the engine's shape")
    return _Masses(scale * shape, np.abs(shape) ** 2 * scale_variance, works, works & False, scale=scale)


def _lag_pattern(
    lag: Lag, pattern: LinePattern, ratio: float, index_to_tdc_deg: float
) -> tuple[ComplexArray, BoolArray]:
    """Amplitudes by order of the masses' motion as the lines of ``pattern`` would show it, and the orders it has."""
    lines = pattern.deviation_rev.size
    crank_rev = np.arange(lines) / (lines * ratio) - index_to_tdc_deg / 360.0
    value, works = np.zeros(lines), np.zeros(lines // 2 + 1, dtype=np.bool_)
    for order, inertia in zip(lag.order, lag.inertia, strict=True):
        turn_order = round(order / ratio)
        # other orders differ from turn to turn of the encoder and are none of the pattern
        if abs(order / ratio - turn_order) < 1e-9 and turn_order < works.size and abs(inertia) > NO_LAG_REV:
            value += ratio * (inertia * np.exp(2j * np.pi * order * crank_rev)).real
            works[turn_order] = True
    known = pattern.has_line
    if not known.all():
        value = np.interp(np.arange(lines), np.flatnonzero(known), value[known], period=lines)
    spectrum: ComplexArray = np.fft.rfft(value) * (2.0 / lines)
    return spectrum, works


def _line_variance(parts: _Parts, random: BoolArray) -> tuple[float, float]:
    """Mean squared amplitude [rev²] of an order from random errors of the lines, by the median; the largest likely."""
    if not random.any():
        return 0.0, 0.0
    own = float(np.median(parts.variance[random]))
    squared = float(np.median(np.abs(parts.fixed[random]) ** 2)) / math.log(2.0)
    # a median of n values of an exponential distribution is off by its mean over the root of n
    doubt = NORMAL_95 * squared / (math.log(2.0) * math.sqrt(float(random.sum())))
    return max(0.0, squared - own), max(0.0, squared - own + doubt)


def _result(patterns: list[LinePattern], parts: _Parts, masses: _Masses, ratio: float) -> Calibration:
    """Errors of the lines, each order drawn towards 0 as far as its error asks for, and the remarks."""
    lines = patterns[0].deviation_rev.size
    order = np.arange(parts.fixed.size)
    error, variance = parts.fixed - masses.motion, parts.variance + masses.variance
    random = (order > 1) & ~masses.unknown & ~masses.works
    usual, most = _line_variance(parts, random)
    own = np.abs(error) ** 2
    expected = np.where(own > STANDS_OUT * variance, own - variance, usual)
    likely = np.maximum(expected, most)
    expected[masses.unknown | (order == 0)], likely[masses.unknown | (order == 0)] = 0.0, 0.0
    kept = error * expected / (expected + variance)
    line_error = _lines_of(kept, lines)
    mean_square = np.full(order.size, 0.5)
    mean_square[-1] = 0.25 if lines % 2 == 0 else 0.5
    standard_error = math.sqrt(float(np.sum(mean_square * variance * likely / (likely + variance))))
    size, phase, size_ci, phase_ci = _eccentricity(error[1], variance[1], known=not masses.unknown[1])
    unknown = tuple(round(k * ratio) for k in np.flatnonzero(masses.unknown))
    rms = 360.0 * math.sqrt(float(np.sum((mean_square * np.abs(kept) ** 2)[2:])))
    remarks = _remarks(patterns, parts, masses, unknown, (size, *size_ci, phase, rms))
    spread = np.full(lines, standard_error)
    return Calibration(
        line_error, spread, size, size_ci, phase, phase_ci, rms, unknown, masses.scale, separated=True, remarks=remarks
    )


def _lines_of(harmonic: ComplexArray, lines: int) -> FloatArray:
    """Values (line,) whose complex amplitudes by order are ``harmonic``."""
    values: FloatArray = np.fft.irfft(harmonic * (lines / 2.0), lines)
    return values


def _eccentricity(
    first: complex, variance: float, *, known: bool
) -> tuple[float, float, tuple[float, float], tuple[float, float]]:
    """Size and phase [deg] of what the encoder shows less the true angle, once per turn, with 95 % intervals."""
    if not known:
        return math.nan, math.nan, (math.nan, math.nan), (math.nan, math.nan)
    size, reach = 360.0 * abs(first), 360.0 * NORMAL_95 * math.sqrt(0.5 * variance)
    # true less shown is a cosine of phase arg(first): shown less true a sine that is a quarter turn behind
    phase = math.remainder(math.degrees(np.angle(first)) - 90.0, 360.0)
    around = math.degrees(math.asin(reach / size)) if reach < size else 180.0
    return size, phase, (max(0.0, size - reach), size + reach), (phase - around, phase + around)


def _remarks(
    patterns: list[LinePattern],
    parts: _Parts,
    masses: _Masses,
    unknown: tuple[int, ...],
    found: tuple[float, float, float, float, float],
) -> list[Remark]:
    """What was found, what could not be told, and where recordings disagree."""
    size, low, high, phase, rms = found
    remarks: list[Remark] = []
    size_told = "" if math.isnan(size) else f"eccentricity {size:.4f}° ({low:.4f} to {high:.4f}°) at {phase:.0f}°, "
    remarks.append(("encoder_calibrated", "info", f"{size_told}lines {rms:.4f}° rms, from {_speeds(patterns)}"))
    if unknown:
        listed = ", ".join(f"{order}" for order in unknown)
        most = 360.0 * float(np.abs(parts.fixed[masses.unknown]).max())
        detail = f"{masses.reason}: at crank orders {listed} masses may move the shaft as an error of the lines would, "
        detail += f"alike at all speeds; up to {most:.2g}° there is left as it is"
        remarks.append(("encoder_calibration_partial", "suspect", detail))
    bad = np.flatnonzero(parts.misfit[: HIGHEST_MASS_ORDER + 1])
    if bad.size:
        listed = ", ".join(f"{order}" for order in bad)
        detail = f"recordings disagree at encoder orders {listed}: the gas torque is not the same in all of them"
        remarks.append(("encoder_calibration_misfit", "suspect", detail))
    if len(patterns) == 2:
        detail = "two recordings: whether the gas torque is the same in both cannot be checked"
        remarks.append(("encoder_calibration_unchecked", "info", detail))
    return remarks
