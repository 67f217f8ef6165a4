"""What an uneven but periodic rotation makes of lines: of orders of the crank those of the mean rotation, and back.

At a steady mean speed the crank angle and the mean angle differ by the lag alone, which repeats with its cycle. A line
of one of them is therefore a line with sidebands of the other, as far apart as the lag's orders: half orders where the
engine's cycle has two turns.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from crankorder.engine.in_cycle import Lag
from crankorder.errors import RequestError
from crankorder.synth.motion import Motion
from crankorder.synth.order_forces import ForceLines

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

SMALLEST = 1e-13
"""Of the largest line: what is below is left out."""
SAME = 1e-9
"""Orders closer than this are one line."""
RESOLVED = 1e-14
MOST_ANGLES = 1 << 22


def lines_in_time(lines: ForceLines, lag: Lag, *, speed_rpm: float) -> tuple[Floats, Complex]:
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

    def scale(line: int, rise: Floats, bend: Floats) -> Complex | Floats:
        ratio = abs(speed_rpm) / float(at_speed_rpm[line])
        if lines.inertia[line]:
            masses: Complex = ratio**2 * (rise**2 - 1j / (2 * np.pi * lines.order[line]) * bend)
            return masses
        if lines.accelerates[line]:
            return ratio**2 / (2 * np.pi) * bend
        powers: Floats = (ratio * rise) ** float(exponent[line])
        return powers

    return _expanded(lines.order, lines.amplitude, step, crank, scale)


def lines_in_angle(order: Floats, amplitude: Complex, lag: Lag, *, speed_rpm: float) -> tuple[Floats, Complex]:
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
    amplitude: Complex,
    step: float,
    other: Callable[[Floats], tuple[Floats, ...]],
    scale: Callable[..., Complex | Floats | float],
) -> tuple[Floats, Complex]:
    """Lines over an angle of a signal whose lines are over the angle that ``other`` gives of it.

    ``other`` returns with it what ``scale`` takes after the number of a line: the factor of the line at each angle.
    """
    order, amplitude = np.asarray(order, dtype=np.float64), np.asarray(amplitude, dtype=np.complex128)
    beside = np.mod(order, step)
    beside[step - beside < SAME] = 0.0
    found_order: list[Floats] = [np.zeros(0)]
    found: list[Complex] = [np.zeros((len(amplitude), 0), dtype=np.complex128)]
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
    amplitude: Complex,
    grid: tuple[float, float, int],
    other: Callable[[Floats], tuple[Floats, ...]],
    scale: Callable[..., Complex | Floats | float],
) -> Complex:
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


def _is_resolved(spectrum: Complex) -> bool:
    size, n = np.abs(spectrum).max(axis=0), spectrum.shape[1]
    return bool(size[3 * n // 8 : 5 * n // 8].max() <= RESOLVED * size.max())


def _merged(order: Floats, amplitude: Complex, known: Floats) -> tuple[Floats, Complex]:
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
