"""Forces by order of a shaft, at any angle, speed and angular acceleration, and orders of an uneven rotation.

At a steady mean speed the crank angle and the mean angle differ by the torsional fluctuation alone, which repeats with
its cycle. A line of one of them is therefore a line with sidebands of the other, as far apart as the fluctuation's
orders: half orders where the engine's cycle has two turns.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from crankorder.engine.compiled_slider_crank import fast_sine_cosine
from crankorder.engine.torsional_fluctuation import Lag
from crankorder.errors import RequestError
from crankorder.quantities import Bools, Complexes, Floats, Ints
from crankorder.synth.motion import Motion

BLOCK = 256
"""Samples at once: the phasors and sums of a block stay in the fastest cache."""
LONGEST_JUMP = 8
"""Multiplications from one multiple of the angle to the next, above which sine and cosine are cheaper."""
RPM_PER_RAD_S = 30 / math.pi
ENDLESS = "a force that falls with speed is endless where the shaft stands still"


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceLines:
    """Forces Re Σ amplitude · scale · exp(2πi order rev), rev the angle of their shaft in revolutions.

    ``order`` (line); ``amplitude`` complex peak (axis, line), N and N·m, at ``at_speed_rpm`` (line); ``exponent``
    (line): scale = |speed / at_speed|^exponent; ``inertia`` (line): forces of masses that the shaft moves, whose scale
    is (ω² − iα/order) / ω_at² with α the angular acceleration, exact for any motion; ``gas`` (line): lines that a
    cycle's own gain multiplies; ``cause`` (line): what made each; ``acceleration`` (line): lines whose scale is
    α / ω_at², nothing at a steady speed; None where there are none.
    Raises RequestError where an inertia line has no order above 0, and where a line is of both kinds.
    """

    order: Floats
    amplitude: Complexes
    at_speed_rpm: Floats
    exponent: Floats
    inertia: Bools
    gas: Bools
    cause: tuple[str, ...]
    acceleration: Bools | None = None

    def __post_init__(self) -> None:
        if np.any(self.order[self.inertia] <= 0):
            raise RequestError("forces of moving masses have orders above 0", found=self.order[self.inertia].tolist())
        if np.any(self.inertia & self.accelerates):
            raise RequestError("a line is one of inertia or one of acceleration", found="both")

    @property
    def accelerates(self) -> Bools:
        """Which lines (line,) go with the angular acceleration alone."""
        return np.zeros(self.order.size, dtype=np.bool_) if self.acceleration is None else self.acceleration

    def only(self, chosen: Bools) -> ForceLines:
        """The ``chosen`` (line,) lines."""
        by_line = ("order", "at_speed_rpm", "exponent", "inertia", "gas")
        columns = {key: getattr(self, key)[chosen] for key in by_line} | {"acceleration": self.accelerates[chosen]}
        cause = tuple(cause for cause, kept in zip(self.cause, chosen.tolist(), strict=True) if kept)
        return ForceLines(**columns, amplitude=self.amplitude[:, chosen], cause=cause)

    def at_speed(self, speed_rpm: float) -> Complexes:
        """Complex peaks (axis, line) at a constant ``speed_rpm``, backwards negative, every gain 1.

        Raises RequestError where a force that falls with speed meets a standstill.
        """
        exponent = np.where(self.inertia | self.accelerates, 2.0, self.exponent)
        if speed_rpm == 0 and np.any(exponent < 0):
            raise RequestError(ENDLESS, allowed="speed ≠ 0")
        scale = np.where(self.accelerates, 0.0, (abs(speed_rpm) / self.at_speed_rpm) ** exponent)
        return self.amplitude * scale

    @cached_property
    def sums(self) -> tuple[Phasors, tuple[_Factor, ...]]:
        """Phasors whose sums the lines are, one for each axis and factor, and the factor that each sum gets in the end.

        Terms are gathered by order, each with the factor and axis it belongs to.
        """
        factors: dict[_Factor, int] = {}
        by_order: dict[float, dict[int, complex]] = {}
        n_axes = self.amplitude.shape[0]
        for number, order in enumerate(self.order.tolist()):
            for factor, share in _factors(self, number):
                row = factors.setdefault(factor, len(factors))
                for axis in np.flatnonzero(self.amplitude[:, number]).tolist():
                    into, goes_to = by_order.setdefault(order, {}), row * n_axes + axis
                    into[goes_to] = into.get(goes_to, 0) + share * complex(self.amplitude[axis, number])
        halves = sorted(order for order in by_order if order > 0 and (2 * order).is_integer())
        orders = [*halves, *(order for order in by_order if order not in set(halves))]
        unit = math.gcd(*(int(2 * value) for value in halves)) if halves else 1
        steps = np.diff(np.array([0.0, *orders])) * 2 / unit
        steps[len(halves) :] = 0
        jump = np.where(steps <= LONGEST_JUMP, steps, 0).astype(np.int64)
        terms = [(goes_to, weight) for value in orders for goes_to, weight in by_order[value].items()]
        weight = np.array([term[1] for term in terms], dtype=np.complex128)
        weights, sums = np.stack([weight.real, weight.imag], axis=1), np.array([term[0] for term in terms], np.int64)
        first_term = np.cumsum([0, *(len(by_order[value]) for value in orders)])
        phasors = unit / 2, jump, np.array(orders, dtype=np.float64), first_term, weights, sums
        return phasors, tuple(factors)


Phasors = tuple[float, Ints, Floats, Ints, Floats, Ints]
"""What the compiled loop takes: unit, jump, order and first term of the phasors, weight and sum of the terms.

A phasor is ``jump`` multiplications by the base phasor exp(2πi unit rev) away from the one before, or, where jump
is 0, the sine and cosine of order · rev. Its terms are ``first_term[i]`` … ``first_term[i + 1]``: weight real and
imaginary, and the sum it goes to, factor · axes + axis.
"""


@dataclass(frozen=True)
class _Factor:
    """speed² or acceleration (rpm/s) of inertia lines, else |speed / at|^exponent; times the cycle's gain for gas."""

    of: str
    exponent: float
    at_speed_rpm: float
    gas: bool

    def at(self, speed_rpm: Floats, acceleration_rpm_per_s: Floats, gain: Floats | float) -> Floats:
        if self.of == "acceleration":
            factor = acceleration_rpm_per_s
        elif self.exponent == 0:
            factor = np.ones_like(speed_rpm)
        else:
            factor = np.abs(speed_rpm / self.at_speed_rpm) ** self.exponent
        return factor * gain if self.gas else factor


def force_at(
    lines: ForceLines, angle_rev: Floats, speed_rpm: Floats, acceleration_rpm_per_s: Floats, gain: Floats | float = 1.0
) -> Floats:
    """Forces and moments of ``lines`` (N, N·m), shape (axis, n), where the shaft moves as stated.

    ``angle_rev``, ``speed_rpm``, ``acceleration_rpm_per_s``: of the shaft, each (n,), backwards negative. ``gain``: of
    the gas lines, (n,) or one for all. Raises RequestError where a force that falls with speed meets a standstill.
    Source: d²/dt² of X·exp(i·order·φ) for the inertia lines, φ̇ = ω, φ̈ = α.
    """
    force = np.zeros((lines.amplitude.shape[0], angle_rev.size))
    if np.any(lines.exponent[~(lines.inertia | lines.accelerates)] < 0) and not np.all(speed_rpm):
        raise RequestError(ENDLESS, allowed="speed ≠ 0")
    phasors, factors = lines.sums
    rows = np.empty((len(factors), angle_rev.size))
    live = np.ones(len(factors), dtype=np.bool_)
    for number, (row, factor) in enumerate(zip(rows, factors, strict=True)):
        row[:] = factor.at(speed_rpm, acceleration_rpm_per_s, gain)
        live[number] = factor.of != "acceleration" or row.any()
    if angle_rev.size and phasors[1].size:
        fill_forces(np.ascontiguousarray(angle_rev, dtype=np.float64), phasors, rows, live, force)
    return force


def _factors(lines: ForceLines, number: int) -> list[tuple[_Factor, complex]]:
    """Factors of one line, and the share of its amplitude that each multiplies."""
    at, gas = float(lines.at_speed_rpm[number]), bool(lines.gas[number])
    if lines.accelerates[number]:
        return [(_Factor("acceleration", 1.0, 1.0, gas), RPM_PER_RAD_S / at**2)]
    if lines.inertia[number]:
        per_acceleration = -1j * RPM_PER_RAD_S / (float(lines.order[number]) * at**2)
        return [(_Factor("speed", 2.0, at, gas), 1.0), (_Factor("acceleration", 1.0, 1.0, gas), per_acceleration)]
    exponent = float(lines.exponent[number])
    return [(_Factor("speed", exponent, at if exponent else 1.0, gas), 1.0)]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def fill_forces(angle_rev, phasors, rows, live, force):  # type: ignore[no-untyped-def]
    """Sums of phasors added to ``force`` (axis, n), block by block.

    ``angle_rev`` (n,), ``rows`` (factor, n) and ``live`` (factor,): the motion and what it makes of the factors; which
    of them are not all 0. ``phasors``: see ``Phasors``.
    """
    unit, jump, order, first_term, weight, goes_to = phasors
    n_axes = force.shape[0]
    base_re, base_im = np.zeros(BLOCK), np.zeros(BLOCK)
    re, im = np.zeros(BLOCK), np.zeros(BLOCK)
    summed = np.empty((rows.shape[0] * n_axes, BLOCK))
    used = np.zeros(summed.shape[0], dtype=np.bool_)
    for term in range(goes_to.size):
        used[goes_to[term]] = live[goes_to[term] // n_axes]
    for start in range(0, angle_rev.size, BLOCK):
        n = min(BLOCK, angle_rev.size - start)
        for s in range(summed.shape[0]):
            for i in range(n):
                summed[s, i] = 0.0
        for k in range(-1, jump.size):  # the base phasor first; one place for sine and cosine halves the compilation
            if k < 0 or jump[k] == 0:
                times = unit if k < 0 else order[k]
                for i in range(n):
                    im[i], re[i] = fast_sine_cosine(times * angle_rev[start + i])
            if k < 0:
                for i in range(n):
                    base_re[i], base_im[i] = re[i], im[i]
                    re[i], im[i] = 1.0, 0.0
                continue
            for _ in range(jump[k]):
                for i in range(n):
                    turned = re[i] * base_re[i] - im[i] * base_im[i]
                    im[i] = re[i] * base_im[i] + im[i] * base_re[i]
                    re[i] = turned
            for term in range(first_term[k], first_term[k + 1]):
                if used[goes_to[term]]:
                    row, w_re, w_im = summed[goes_to[term]], weight[term, 0], weight[term, 1]
                    for i in range(n):
                        row[i] += w_re * re[i] - w_im * im[i]
        for s in range(summed.shape[0]):
            if used[s]:
                out, factor = force[s % n_axes], rows[s // n_axes]
                for i in range(n):
                    out[start + i] += factor[start + i] * summed[s, i]


SMALLEST = 1e-13
"""Of the largest line: what is below is left out."""
SAME = 1e-9
"""Orders closer than this are one line."""
RESOLVED = 1e-14
MOST_ANGLES = 1 << 22


def lines_in_time(lines: ForceLines, lag: Lag, *, speed_rpm: float) -> tuple[Floats, Complexes]:
    """Mean orders (line,), ascending, and complex amplitude (axis, line) of forces of a shaft that turns with a lag.

    The force is Re Σ amplitude · exp(2πi order mean_angle), the mean angle (rev) as of :meth:`Motion.mean_rev`: lines
    at multiples of the mean rotation, so of fixed frequency. The forces follow speed and angular acceleration within
    the cycle as :func:`crankorder.synth.order_forces.force_at` does. Where a line of the shaft's own orders remains,
    its order is that of ``lines`` to the last digit. Left out: lines below 1e-13 of the largest amplitude of all axes.

    ``lines``: forces by order of the crank angle; no gains of single cycles. ``lag``: in-cycle motion. ``speed_rpm``:
    steady mean speed, either way, not 0. Raises RequestError where the shaft would stop within the cycle, and for
    a lag without a common step of its orders.
    """
    step = _step(lag, speed_rpm)
    at_speed_rpm, exponent = np.asarray(lines.at_speed_rpm), np.asarray(lines.exponent)
    even = Lag(order=lag.order, inertia=lag.by_order(speed_rpm), gas=np.zeros(len(lag.order), dtype=np.complex128))
    turning = Motion(start_rev=0.0, corners=((0.0, 60.0),), lag=even)
    start_rev = turning.mean_rev(0.0)

    def crank(mean_rev: Floats) -> tuple[Floats, ...]:
        crank_rev, rise, bend = turning.at(mean_rev - start_rev)
        return crank_rev, rise / 60, bend / 60

    def scale(line: int, rise: Floats, bend: Floats) -> Complexes | Floats:
        ratio = abs(speed_rpm) / float(at_speed_rpm[line])
        if lines.inertia[line]:
            masses: Complexes = ratio**2 * (rise**2 - 1j / (2 * np.pi * lines.order[line]) * bend)
            return masses
        if lines.accelerates[line]:
            return ratio**2 / (2 * np.pi) * bend
        return (ratio * rise) ** float(exponent[line])

    return _expanded(lines.order, lines.amplitude, step, crank, scale)


def lines_in_angle(order: Floats, amplitude: Complexes, lag: Lag, *, speed_rpm: float) -> tuple[Floats, Complexes]:
    """Crank orders (k,), ascending, and complex amplitude (axis, k) of a signal of lines of the mean rotation.

    This is what a perfect order analysis, by crank angle, finds of Re Σ amplitude · exp(2πi order mean_angle). Left
    out: lines below 1e-13 of the largest. An order that remains is that of ``order`` to the last digit.

    ``order``: (line,), multiples of the mean rotation, ≥ 0, any. ``amplitude``: complex (axis, line), any number of
    axes or channels. ``lag``: in-cycle motion. ``speed_rpm``: steady mean speed, either way, not 0. Raises RequestError
    where the shaft would stop within the cycle, and for a lag without a common step of its orders.
    """

    def mean(crank_rev: Floats) -> tuple[Floats, ...]:
        return (crank_rev + lag.at(crank_rev, speed_rpm),)

    return _expanded(order, amplitude, _step(lag, speed_rpm), mean, lambda _: 1.0)


def _step(lag: Lag, speed_rpm: float) -> float:
    lag.check(speed_rpm)
    step = lag.step if len(lag.order) else 1.0
    if not step:
        raise RequestError("the orders of the lag have no common cycle", place="in-cycle speed")
    return step


def _expanded(
    order: Floats,
    amplitude: Complexes,
    step: float,
    other: Callable[[Floats], tuple[Floats, ...]],
    scale: Callable[..., Complexes | Floats | float],
) -> tuple[Floats, Complexes]:
    """Lines over an angle of a signal whose lines are over the angle that ``other`` gives of it.

    ``other`` returns with it what ``scale`` takes after the number of a line: the factor of the line at each angle.
    """
    order, amplitude = np.asarray(order, dtype=np.float64), np.asarray(amplitude, dtype=np.complex128)
    beside = np.mod(order, step)
    beside[step - beside < SAME] = 0.0
    found_order: list[Floats] = [np.zeros(0)]
    found: list[Complexes] = [np.zeros((len(amplitude), 0), dtype=np.complex128)]
    left = np.flatnonzero(amplitude.any(axis=0))
    while left.size:
        here = np.abs(beside[left] - beside[left[0]]) < SAME
        carrier = float(beside[left[0]]) if beside[left[0]] >= SAME else 0.0
        n_angles = 1 << max(8, math.ceil(math.log2(8 * (float(order.max()) + 2) / step)))
        while True:
            spectrum = _spectrum(left[here], order, amplitude, (carrier, step, n_angles), other, scale)
            if _is_resolved(spectrum) or n_angles >= MOST_ANGLES:
                break
            n_angles *= 2
        found_order.append(np.asarray(carrier + step * np.fft.fftfreq(n_angles, 1 / n_angles), dtype=np.float64))
        found.append(spectrum)
        left = left[~here]
    return _merged(np.concatenate(found_order), np.concatenate(found, axis=1), order)


def _spectrum(
    lines: NDArray[np.intp],
    order: Floats,
    amplitude: Complexes,
    grid: tuple[float, float, int],
    other: Callable[[Floats], tuple[Floats, ...]],
    scale: Callable[..., Complexes | Floats | float],
) -> Complexes:
    """Complex lines at carrier + m · step, shape (axis, n_angles), of ``lines`` that share a carrier."""
    carrier, step, n_angles = grid
    angle = np.arange(n_angles) / (n_angles * step)
    turned, *rates = other(angle)
    shift = carrier * (turned - angle)
    total = np.zeros((len(amplitude), n_angles), dtype=np.complex128)
    for line in lines.tolist():
        # whole multiples of the step: the phase is small, and exact after any number of turns
        multiple = step * round((order[line] - carrier) / step)
        total += amplitude[:, line, None] * (scale(line, *rates) * np.exp(2j * np.pi * (multiple * turned + shift)))
    return np.fft.fft(total, axis=1) / n_angles


def _is_resolved(spectrum: Complexes) -> bool:
    size, n = np.abs(spectrum).max(axis=0), spectrum.shape[1]
    return bool(size[3 * n // 8 : 5 * n // 8].max() <= RESOLVED * size.max())


def _merged(order: Floats, amplitude: Complexes, known: Floats) -> tuple[Floats, Complexes]:
    """Lines of ascending orders ≥ 0, those of one order added up, and none below ``SMALLEST`` of the largest."""
    kept = np.abs(amplitude).max(axis=0, initial=0.0) > 0
    order, amplitude = order[kept], amplitude[:, kept]
    amplitude = np.where(order < 0, amplitude.conj(), amplitude)
    sequence = np.argsort(np.abs(order), kind="stable")
    order, amplitude = np.abs(order)[sequence], amplitude[:, sequence]
    if not order.size:
        return order, amplitude
    first = np.flatnonzero(np.diff(order, prepend=-1.0) > SAME)
    order, amplitude = order[first], np.add.reduceat(amplitude, first, axis=1)
    size = np.abs(amplitude).max(axis=0)
    kept = size > SMALLEST * size.max()
    order, amplitude = order[kept], amplitude[:, kept]
    if order.size and order[0] < SAME:  # there sine parts are nothing
        order[0], amplitude[:, 0] = 0.0, amplitude[:, 0].real
    nearest = known[np.abs(order[:, None] - known).argmin(axis=1)]
    return np.where(np.abs(order - nearest) < SAME, nearest, order), amplitude
