"""Forces by order of a shaft that turns in any way, and the exact response of poles to them.

At a steady mean speed the crank angle and the mean angle differ by the torsional fluctuation alone, which repeats with
its cycle. A line of one of them is therefore a line with sidebands of the other, as far apart as the fluctuation's
orders: half orders where the engine's cycle has two turns.

Over a step h a pole z with ż = λz + u(t) goes to e^{λh}·z + ∫₀ʰ e^{λ(h−τ)}·u(τ) dτ. With u the polynomial through the
``stencil`` samples about the step the integral is a fixed sum of these samples, so that neither a stiff nor a lightly
damped pole asks for short steps: only the forces do (an exponential integrator; Hochbruck and Ostermann 2010, section
2). Several steps of a grid finer than the output are one sum over more samples.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import lfilter

from crankorder.engine.torsional_fluctuation import Lag
from crankorder.errors import RequestError
from crankorder.quantities import Bools, Complexes, Floats, Ints
from crankorder.synth.motion import Motion
from crankorder.synth.poles import Poles, steady_state

BLOCK = 512
"""Samples at once: the phasors of a block stay in the cache."""
LONGEST_JUMP = 8
"""Multiplications for each phasor that is wanted, above which sine and cosine are cheaper."""
RPM_PER_RAD_S = 30 / math.pi
ENDLESS = "a force that falls with speed is endless where the shaft stands still"


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceLines:
    """Forces Re Σ amplitude · scale · exp(2πi order rev), rev the angle of their shaft in revolutions.

    ``order`` (line); ``amplitude`` complex peak (axis, line), N and N·m, at ``at_speed_rpm`` (line); ``exponent``
    (line): scale = |speed / at_speed|^exponent; ``inertia`` (line): forces of masses that the shaft moves, whose scale
    is (ω² − iα/order) / ω_at² with α the angular acceleration, exact for any motion; ``gas`` (line): lines that a
    cycle's own gain multiplies; ``cause`` (line): what made each; ``acceleration`` (line): lines whose scale is
    α / ω_at², nothing at a steady speed; None where there are none. No line is of both kinds, and inertia lines have
    orders above 0.
    """

    order: Floats
    amplitude: Complexes
    at_speed_rpm: Floats
    exponent: Floats
    inertia: Bools
    gas: Bools
    cause: tuple[str, ...]
    acceleration: Bools | None = None

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


def force_at(
    lines: ForceLines, angle_rev: Floats, speed_rpm: Floats, acceleration_rpm_per_s: Floats, gain: float = 1.0
) -> Floats:
    """Forces and moments of ``lines`` (N, N·m), shape (axis, n), where the shaft moves as stated.

    ``angle_rev``, ``speed_rpm``, ``acceleration_rpm_per_s``: of the shaft, each (n,), backwards negative. ``gain``: of
    the gas lines. Raises RequestError where a force that falls with speed meets a standstill.
    Source: d²/dt² of X·exp(i·order·φ) for the inertia lines, φ̇ = ω, φ̈ = α.
    """
    masses = lines.inertia | lines.accelerates
    exponent = np.where(masses, 2.0, lines.exponent)
    if np.any(exponent < 0) and not np.all(speed_rpm):
        raise RequestError(ENDLESS, allowed="speed ≠ 0")
    acts = np.flatnonzero(lines.amplitude.any(axis=1))
    amplitude = lines.amplitude[acts] / lines.at_speed_rpm**exponent * np.where(lines.gas, gain, 1.0)
    order, row = np.unique(lines.order, return_inverse=True)
    parts: list[tuple[Floats, Floats]] = []
    for power in np.unique(exponent):
        of_power = (exponent == power) & ~lines.accelerates
        parts.append((_by_order(amplitude, of_power, row), np.abs(speed_rpm) ** power))
    if np.any(masses) and np.any(acceleration_rpm_per_s):
        turned = np.where(lines.inertia, -1j / np.where(lines.inertia, lines.order, 1.0), 1.0)
        parts.append((_by_order(RPM_PER_RAD_S * amplitude * turned, masses, row), acceleration_rpm_per_s))
    force = np.zeros((lines.amplitude.shape[0], angle_rev.size))
    for start in range(0, angle_rev.size if order.size else 0, BLOCK):
        some = slice(start, start + BLOCK)
        waves = _waves(order, angle_rev[some])
        for weights, factor in parts:
            force[acts, some] += factor[some] * (weights @ waves)
    return force


def _by_order(amplitude: Complexes, chosen: Bools, row: Ints) -> Floats:
    """Weights (axis, 2 · order) of cosine and sine for the ``chosen`` lines, each of which has the order at ``row``."""
    summed = np.zeros((int(row.max()) + 1, len(amplitude)), dtype=np.complex128)
    np.add.at(summed, row[chosen], amplitude.T[chosen])
    return np.concatenate([summed.real, -summed.imag]).T


def _waves(order: Floats, angle_rev: Floats) -> Floats:
    """Cosines, then sines, of every ``order`` (order,), ascending, at ``angle_rev`` (n,), shape (2 · order, n).

    Half orders are powers of one phasor, unless most of these powers would be of no use.
    """
    halves = (order > 0) & (order % 0.5 == 0)
    top = int(2 * order[halves].max(initial=0.0))
    halves &= top <= LONGEST_JUMP * np.count_nonzero(halves)
    phasor = np.empty((order.size, angle_rev.size), dtype=np.complex128)
    turns = order[~halves, None] * angle_rev
    phasor[~halves] = np.exp(2j * np.pi * (turns - np.rint(turns)))
    if halves.any():
        half_turns = 0.5 * angle_rev
        power = np.ones((top + 1, angle_rev.size), dtype=np.complex128)
        power[1:2] = np.exp(2j * np.pi * (half_turns - np.rint(half_turns)))
        for k in range(2, top + 1):
            np.multiply(power[k // 2], power[k - k // 2], out=power[k])
        phasor[halves] = power[(2 * order[halves]).astype(int)]
    return np.concatenate([phasor.real, phasor.imag])


SMALLEST = 1e-13
"""Of the largest line: what is below is left out."""
SAME = 1e-9
"""Orders closer than this are one line."""
RESOLVED = 1e-14
MOST_ANGLES = 1 << 22


def lines_in_time(lines: ForceLines, lag: Lag, *, speed_rpm: float) -> tuple[Floats, Complexes]:
    """Mean orders (line,), ascending, and complex amplitude (axis, line) of forces of a shaft that turns with a lag.

    The force is Re Σ amplitude · exp(2πi order mean_angle), the mean angle (rev) as of :class:`Motion`: lines
    at multiples of the mean rotation, so of fixed frequency. The forces follow speed and angular acceleration within
    the cycle as :func:`crankorder.synth.driven.force_at` does. Where a line of the shaft's own orders remains,
    its order is that of ``lines`` to the last digit. Left out: lines below 1e-13 of the largest amplitude of all axes.

    ``lines``: forces by order of the crank angle; no gains of single cycles. ``lag``: in-cycle motion. ``speed_rpm``:
    steady mean speed, either way, not 0. Raises RequestError where the shaft would stop within the cycle. The orders
    of the lag have a common step.
    """
    lag.check(speed_rpm)
    even = Lag(order=lag.order, inertia=lag.by_order(speed_rpm), gas=np.zeros(len(lag.order), dtype=np.complex128))
    turning = Motion(start_rev=0.0, corners=((0.0, 60.0),), lag=even)

    def crank(mean_rev: Floats) -> tuple[Floats, ...]:
        crank_rev, rise, bend = turning.at(mean_rev - turning.mean_start_rev)
        return crank_rev, rise / 60, bend / 60

    def scale(line: int, rise: Floats, bend: Floats) -> Complexes | Floats:
        ratio = abs(speed_rpm) / float(lines.at_speed_rpm[line])
        if lines.inertia[line]:
            masses: Complexes = ratio**2 * (rise**2 - 1j / (2 * np.pi * lines.order[line]) * bend)
            return masses
        if lines.accelerates[line]:
            return ratio**2 / (2 * np.pi) * bend
        return (ratio * rise) ** float(lines.exponent[line])

    return _expanded(lines.order, lines.amplitude, lag, crank, scale)


def lines_in_angle(order: Floats, amplitude: Complexes, lag: Lag, *, speed_rpm: float) -> tuple[Floats, Complexes]:
    """Crank orders (k,), ascending, and complex amplitude (axis, k) of a signal of lines of the mean rotation.

    This is what a perfect order analysis, by crank angle, finds of Re Σ amplitude · exp(2πi order mean_angle). Left
    out: lines below 1e-13 of the largest. An order that remains is that of ``order`` to the last digit.

    ``order``: (line,), multiples of the mean rotation, ≥ 0, any. ``amplitude``: complex (axis, line), any number of
    axes or channels. ``lag``: in-cycle motion. ``speed_rpm``: steady mean speed, either way, not 0. Raises RequestError
    where the shaft would stop within the cycle. The orders of the lag have a common step.
    """

    lag.check(speed_rpm)

    def mean(crank_rev: Floats) -> tuple[Floats, ...]:
        return (crank_rev + lag.at(crank_rev, speed_rpm),)

    return _expanded(order, amplitude, lag, mean, lambda _: 1.0)


def _expanded(
    order: Floats,
    amplitude: Complexes,
    lag: Lag,
    other: Callable[[Floats], tuple[Floats, ...]],
    scale: Callable[..., Complexes | Floats | float],
) -> tuple[Floats, Complexes]:
    """Lines over an angle of a signal whose lines are over the angle that ``other`` gives of it.

    The step of the ``lag`` parts the lines. ``other`` returns with the angle what ``scale`` takes after the number of a
    line: the factor of the line at each angle.
    """
    step = lag.step if len(lag.order) else 1.0
    carriers: dict[int, list[int]] = {}
    for line in np.flatnonzero(amplitude.any(axis=0)).tolist():
        carriers.setdefault(round(order[line] % step / SAME) % round(step / SAME), []).append(line)
    orders, spectra = [np.zeros(0)], [np.zeros((len(amplitude), 0), dtype=np.complex128)]
    for number, lines in carriers.items():
        carrier = float(order[lines[0]] % step) if number else 0.0
        n_angles = 1 << max(8, math.ceil(math.log2(8 * (float(order.max()) + 2) / step)))
        while True:
            angle = np.arange(n_angles) / (n_angles * step)
            turned, *rates = other(angle)
            shift = carrier * (turned - angle)
            total = np.zeros((len(amplitude), n_angles), dtype=np.complex128)
            for line in lines:
                # whole multiples of the step: the phase is small, and exact after any number of turns
                phase = step * round((order[line] - carrier) / step) * turned + shift
                total += amplitude[:, line, None] * (scale(line, *rates) * np.exp(2j * np.pi * phase))
            spectrum = np.fft.fft(total, axis=1) / n_angles
            size = np.abs(spectrum).max(axis=0)
            if n_angles >= MOST_ANGLES or not size[3 * n_angles // 8 : 5 * n_angles // 8].max() > RESOLVED * size.max():
                break
            n_angles *= 2
        orders.append(np.asarray(carrier + step * np.fft.fftfreq(n_angles, 1 / n_angles), dtype=np.float64))
        spectra.append(spectrum)
    return _merged(np.concatenate(orders), np.concatenate(spectra, axis=1), order)


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


STENCILS = (2, 4, 6, 8, 10, 12)
MAX_SUBSTEPS = 64


@dataclass(frozen=True)
class Integration:
    """How forces are taken: a polynomial through ``stencil`` samples (even), ``substeps`` samples for one of output.

    Half a stencil of the forces is needed before the first and behind the last step.
    """

    stencil: int
    substeps: int


def interpolation_error(stencil: int, phase_per_sample_rad: float) -> float:
    """Largest error, over its amplitude, of a tone in the middle interval of the polynomial through its samples.

    (θ/2)^s · (s − 1)!!/s!!, for ``stencil`` s (even) and ``phase_per_sample_rad`` θ: a bound that the middle of the
    interval reaches for small θ. Relative to the response it is the error of the tone's own frequency.
    Source: remainder of polynomial interpolation, f^(s)/s! · Π(t − t_j), with the derivative's bound θ^s, which holds
    for complex f by the formula of Hermite and Genocchi (Davis, Interpolation and Approximation, 1963, section 3.1);
    Π is largest in the middle, ((s − 1)!!/2^{s/2})².
    """
    central: float = math.comb(stencil, stencil // 2) / 2**stencil
    return central * (phase_per_sample_rad / 2) ** stencil


def integration_for(highest_force_hz: float, rate_hz: float, tolerance: float) -> Integration:
    """The cheapest integration whose interpolation error stays within a tolerance up to the highest frequency.

    The forces at one more sample cost some ten times what one more sample in the sums costs (measured, see
    benchmarks/modal_integration.py): as few substeps as the widest stencil allows, then the narrowest stencil.

    ``highest_force_hz``: of the forces, ≥ 0; it may lie above half of ``rate_hz``, the rate of the output.
    ``tolerance``: largest error over amplitude, 1e-15 … 1. Raises RequestError where more than 64 samples of the forces
    would be needed for each of the output.
    """
    phase = 2 * math.pi * highest_force_hz / rate_hz
    for substeps in range(1, MAX_SUBSTEPS + 1):
        for stencil in STENCILS:
            if interpolation_error(stencil, phase / substeps) <= tolerance:
                return Integration(stencil, substeps)
    problem = "the forces change too fast for the rate"
    remedy = "Raise the rate or lower the highest order or speed"
    raise RequestError(problem, found=f"{highest_force_hz:g} Hz at {rate_hz:g} samples per second", remedy=remedy)


def step_weights(pole_per_s: Complexes, step_s: float, integration: Integration) -> tuple[Complexes, Complexes]:
    """What a step of the output makes of the state, e^{λΔ} − 1 (pole,), and of the samples of the input (pole, tap).

    ``pole_per_s`` (pole,): λ. ``step_s``: between samples of the forces; Δ is ``substeps`` of them. ``integration``:
    its stencil and substeps. Tap 0 is the sample stencil/2 − 1 before the step. The difference from 1 keeps the damping
    of a lightly damped pole to full precision.
    """
    stencil, substeps = integration.stencil, integration.substeps
    nodes = np.arange(stencil) - (stencil // 2 - 1.0)
    decay = pole_per_s * step_s
    points, shares = unit_quadrature(float(np.max(np.abs(decay), initial=0.0)))
    lagrange = np.array(
        [np.prod([(points - other) / (node - other) for other in nodes if other != node], axis=0) for node in nodes]
    )
    per_sample = step_s * (np.exp(decay[:, None] * (1 - points)) * shares) @ lagrange.T
    taps = np.zeros((pole_per_s.size, stencil + substeps - 1), dtype=np.complex128)
    for part in range(substeps):
        taps[:, part : part + stencil] += np.exp(decay * (substeps - 1 - part))[:, None] * per_sample
    return np.expm1(decay * substeps), taps


def unit_quadrature(decay: float) -> tuple[Floats, Floats]:
    """Points and weights (n,) on 0 … 1 that integrate to round-off what a step integrates.

    ``decay``: largest |λ|·step of the poles. Source: Gauss and Legendre.
    """
    points, shares = np.polynomial.legendre.leggauss(32 + min(int(decay), 400))
    return 0.5 * (1 + points), 0.5 * shares


def advance(
    poles: Poles, force: Floats, *, growth: Complexes, taps: Complexes, integration: Integration, state: Complexes
) -> tuple[Floats, Complexes]:
    """Acceleration (channel, n) at the output samples, and the state (pole,) one output step behind the last.

    ``poles``: of structure and filter. ``force``: samples (axis, margin + n · substeps + margin), a step apart; the one
    after the first margin falls on the first output sample. ``growth`` (pole,), ``taps`` (pole, tap): of
    :func:`step_weights`. ``integration``: its margin, stencil and substeps. ``state`` (pole,): at the first output
    sample.
    """
    margin, substeps = integration.stencil // 2, integration.substeps
    n_out = (force.shape[1] - 2 * margin) // substeps
    weights = np.concatenate([taps.real, taps.imag])
    pushes = np.zeros((taps.shape[0], n_out), dtype=np.complex128)
    windows = sliding_window_view(force, taps.shape[1], axis=1)[:, 1 : 1 + n_out * substeps : substeps]
    for axis, window in enumerate(windows):
        moved = poles.input[:, axis] != 0
        parts = poles.input[moved, axis, None] * (weights[np.tile(moved, 2)] @ window.T).reshape(2, -1, n_out)
        pushes[moved] += parts[0] + 1j * parts[1]
    states = np.empty((taps.shape[0], n_out + 1), dtype=np.complex128)
    states[:, 0] = state
    for course, rise, push in zip(states, growth.tolist(), pushes, strict=True):
        step = 1 + rise
        for lost in (0.0, rise - (step - 1)):  # then with what the sum with 1 rounds off
            moved = push + lost * course[:-1] if lost else push
            course[1:] = lfilter([1.0], [1.0, -step], moved, zi=[step * course[0]])[0]
    signal: Floats = poles.direct @ force[:, margin : margin + n_out * substeps : substeps]
    signal += poles.output.real @ states[:, :-1].real - poles.output.imag @ states[:, :-1].imag
    return signal, states[:, -1]


GainOfCycle = Callable[[Ints], Floats]
BLOCK_STEPS = 16_384
"""Samples of the forces at once: memory does not grow with the record, and a block stays in the second cache."""
MEMORY = 24.0
"""Decay times before the first sample from which the past is integrated: e⁻²⁴ = 4e-11 of a wrong start is left."""
ON_SAMPLE = 1e-6
"""Share of a sample by which a corner may miss it: what that changes is below round-off."""
SPEED_SAMPLES = 4001
ROOM = 1.02
"""Room for peaks of the speed between those that are looked at."""


def driven_signal(
    poles: Poles,
    sources: Sequence[tuple[ForceLines, Motion]],
    *,
    rate_hz: float,
    n_samples: int,
    tolerance: float = 1e-9,
    gain_of_cycle: GainOfCycle | None = None,
    revs_per_cycle: float = 2.0,
    block_steps: int = BLOCK_STEPS,
) -> Floats:
    """Acceleration of every channel under forces that follow shafts, shape (channel, sample); first sample at t = 0.

    ``poles``: structure and filter. ``sources``: forces, and the motion of the shaft they follow. ``rate_hz``: samples
    per second. ``n_samples``: how many. ``tolerance``: largest relative error of the response to a tone, 1e-15 … 1;
    smaller takes more samples of the forces. ``gain_of_cycle``: factors of the gas lines by number of the cycle: cycle
    k is k … k + 1 times ``revs_per_cycle`` of their shaft's angle, before the start numbers may be negative; the gain
    steps at that very angle, between samples. ``block_steps``: samples of the forces at once; it changes no result.

    The past is a constant first speed in its steady state. Where a shaft wobbles, or gains differ from cycle to cycle,
    24 decay times of the slowest pole are integrated before the first sample. Corners of the speed, where the angular
    acceleration jumps, lose no accuracy: each piece of the motion is integrated with its own formula.
    Gas lines with gains follow one shaft only. Raises RequestError where the forces change too fast for the rate, and
    where a force that falls with speed meets a standstill.
    """
    turning = [(lines, motion) for lines, motion in sources if lines.order.size]
    signal = np.zeros((poles.direct.shape[0], n_samples))
    if not turning:
        return signal
    gas = [motion for lines, motion in turning if lines.gas.any()] if gain_of_cycle else []
    poles = poles.driven_on(np.any([lines.amplitude.any(axis=1) for lines, _ in turning], axis=0))
    uneven = bool(gas) or any(motion.wobbles or motion.lag is not None for _, motion in turning)
    # before the first corner of any motion all is steady but for wobbles
    first_corner_s = min((time_s for _, motion in turning for time_s in motion.corner_s), default=0.0)
    first = int(np.floor(min(0.0, first_corner_s) * rate_hz))
    first -= int(np.ceil(MEMORY * poles.decay_s * rate_hz)) if uneven else 0
    start_s, end_s = first / rate_hz, n_samples / rate_hz
    highest_hz = max(_highest_force_hz(*source, start_s, end_s, tolerance) for source in turning)
    integration = integration_for(highest_hz * (ROOM if uneven else 1.0), rate_hz, tolerance)
    margin, substeps = integration.stencil // 2, integration.substeps
    growth, taps = step_weights(poles.pole_per_s, 1 / (rate_hz * substeps), integration)
    laws = _corner_laws([motion for _, motion in turning], start_s)
    if gain_of_cycle is not None and gas:
        laws = _with_gains(laws, gas[0], gain_of_cycle, revs_per_cycle, (start_s, end_s))
    state = _steady_past(poles, turning, start_s)
    for law, following in pairwise([*(law for law in laws if law.from_s < end_s), None]):
        assert law is not None  # only the last one of a pair may be
        last = n_samples if following is None else int(np.ceil(following.from_s * rate_hz - ON_SAMPLE))
        for start in range(first, last, max(1, block_steps // substeps)):
            stop = min(start + max(1, block_steps // substeps), last)
            number = np.arange(start * substeps - margin, stop * substeps + margin)
            force = _forces(turning, number / (rate_hz * substeps), law)
            part, state = advance(poles, force, growth=growth, taps=taps, integration=integration, state=state)
            if stop > 0:
                signal[:, max(start, 0) : stop] = part[:, max(-start, 0) :]
        if following is not None and last - following.from_s * rate_hz > ON_SAMPLE:
            state = state + _late(poles, turning, law, following, last / rate_hz)
        first = last
    return signal


@dataclass(frozen=True)
class _Law:
    """How the forces follow from the time ``from_s`` on: the piece of every motion, and the gain of the gas lines."""

    from_s: float
    pieces: tuple[int, ...]
    gain: float = 1.0


def _corner_laws(motions: Sequence[Motion], start_s: float) -> list[_Law]:
    """The law at ``start_s`` and after each later corner of a motion."""
    laws = [_Law(start_s, tuple(sum(time <= start_s for time in motion.corner_s) for motion in motions))]
    corners = sorted((time, k) for k, motion in enumerate(motions) for time in motion.corner_s if time > start_s)
    for time_s, k in corners:
        pieces = laws[-1].pieces
        laws.append(_Law(time_s, (*pieces[:k], pieces[k] + 1, *pieces[k + 1 :])))
    return laws


def _with_gains(
    laws: list[_Law], motion: Motion, gain_of_cycle: GainOfCycle, revs_per_cycle: float, span_s: tuple[float, float]
) -> list[_Law]:
    """``laws`` that also change where a new cycle of ``motion`` begins, within ``span_s``."""
    start_s, end_s = span_s
    earlier = motion.begun_earlier(-start_s)
    begins = [(start_s, math.floor(float(earlier.at(np.zeros(1))[0][0]) / revs_per_cycle))]
    for stretch in earlier.stretches(end_s - start_s):
        low, high = earlier.at(np.array(stretch))[0] / revs_per_cycle
        border = np.arange(math.ceil(min(low, high)), math.floor(max(low, high)) + 1)[:: 1 if high > low else -1]
        times = earlier.time_at(border * revs_per_cycle, stretch) + start_s
        begins += zip(times.tolist(), (border if high > low else border - 1).tolist(), strict=True)
    gains = gain_of_cycle(np.array([cycle for _, cycle in begins])).tolist()
    starts, gained = [time_s for time_s, _ in begins], []
    for from_s in sorted({*starts, *(law.from_s for law in laws)}):
        pieces = laws[bisect_right(laws, from_s, key=lambda law: law.from_s) - 1].pieces
        gained.append(_Law(from_s, pieces, gains[bisect_right(starts, from_s) - 1]))
    return gained


def _forces(turning: Sequence[tuple[ForceLines, Motion]], time_s: Floats, law: _Law) -> Floats:
    """Forces (axis, n) of all shafts at ``time_s`` (n,) by one ``law``, also beyond the times at which it holds."""
    moves = zip(turning, law.pieces, strict=True)
    parts = [force_at(lines, *motion.at(time_s, piece=piece), law.gain) for (lines, motion), piece in moves]
    return np.asarray(np.sum(parts, axis=0))


def _late(
    poles: Poles, turning: Sequence[tuple[ForceLines, Motion]], law: _Law, following: _Law, to_s: float
) -> Complexes:
    """What the state at ``to_s`` lacks where ``law`` was taken up to there, and the ``following`` one came before."""
    late_s = to_s - following.from_s
    points, shares = unit_quadrature(float(np.max(np.abs(poles.pole_per_s), initial=0.0)) * late_s)
    time_s = following.from_s + late_s * points
    acting = poles.input @ (_forces(turning, time_s, following) - _forces(turning, time_s, law))
    fading = np.exp(np.outer(poles.pole_per_s, late_s * (1 - points)))
    return np.asarray(late_s * (fading * acting) @ shares)


def _steady_past(poles: Poles, turning: Sequence[tuple[ForceLines, Motion]], time_s: float) -> Complexes:
    """State at ``time_s`` after an endless past at the first speed of every motion."""
    state = np.zeros(poles.pole_per_s.size, dtype=np.complex128)
    for lines, motion in turning:
        speed_rpm = motion.corners[0][1]
        angle_rev = motion.at(np.array([time_s]), piece=0)[0]
        force = lines.at_speed(speed_rpm) * np.exp(2j * np.pi * lines.order * angle_rev)
        state += steady_state(poles, force, lines.order * speed_rpm / 60)
    return state


def _highest_force_hz(lines: ForceLines, motion: Motion, start_s: float, end_s: float, tolerance: float) -> float:
    """Highest frequency of a force; what wobble and lag modulate reaches one sideband higher (Carson's rule)."""
    corners = [time_s for time_s in motion.corner_s if start_s < time_s < end_s]
    looked_at = np.union1d(np.linspace(start_s, end_s, SPEED_SAMPLES), corners)
    fastest_rpm = float(np.abs(motion.at(looked_at)[1]).max())
    order = float(np.abs(lines.order).max())
    sidebands_hz = max((frequency for frequency, *_ in motion.wobbles), default=0.0)
    if motion.lag is not None:
        swing = np.abs(motion.lag.by_order(max(fastest_rpm, 1.0)))
        seen = motion.lag.order[2 * np.pi * order * swing > tolerance]
        sidebands_hz += float(np.max(seen, initial=0.0)) * fastest_rpm / 60
    return order * fastest_rpm / 60 + sidebands_hz
