"""Response of poles to the forces of shafts that turn in any way: exact for the poles.

Over a step h a pole z with ż = λz + u(t) goes to e^{λh}·z + ∫₀ʰ e^{λ(h−τ)}·u(τ) dτ. With u the polynomial through the
``stencil`` samples about the step the integral is a fixed sum of these samples, so that neither a stiff nor a lightly
damped pole asks for short steps: only the forces do (an exponential integrator; Hochbruck and Ostermann 2010, section
2). Several steps of a grid finer than the output are one sum over more samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from crankorder.errors import RequestError
from crankorder.quantities import Bools, Complexes, Floats, Ints
from crankorder.synth.order_forces import ForceLines, force_at
from crankorder.synth.poles import Poles, steady_state

if TYPE_CHECKING:
    from crankorder.synth.motion import Motion


STENCILS = (2, 4, 6, 8, 10, 12)
MAX_SUBSTEPS = 64
BLOCK = 512
"""Output samples at once: what a pole needs of a block stays in the fastest cache."""


@dataclass(frozen=True)
class Integration:
    """How forces are taken: a polynomial through ``stencil`` samples (even), ``substeps`` samples for one of output."""

    stencil: int
    substeps: int

    @property
    def margin(self) -> int:
        """Samples of the forces that are needed before the first and behind the last step."""
        return self.stencil // 2


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
    ``tolerance``: largest error over amplitude, 1e-15 … 1. Raises RequestError outside of these ranges, and where more
    than 64 samples of the forces would be needed for each of the output.
    """
    if not (highest_force_hz >= 0 and rate_hz > 0 and 1e-15 <= tolerance <= 1):
        found = f"highest force {highest_force_hz:g} Hz, rate {rate_hz:g} Hz, tolerance {tolerance:g}"
        allowed = "highest force ≥ 0, rate > 0, tolerance 1e-15 … 1"
        raise RequestError("no integration for this", found=found, allowed=allowed)
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

    ``pole_per_s``: λ. ``step_s``: between samples of the forces; Δ is ``substeps`` of them. ``integration``: its
    stencil and substeps. Tap 0 is the sample stencil/2 − 1 before the step. The difference from 1 keeps the damping of
    a lightly damped pole to full precision.
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
    """Points and weights on 0 … 1 that integrate to round-off what a step integrates.

    ``decay``: largest |λ|·step of the poles. Source: Gauss and Legendre.
    """
    points, shares = np.polynomial.legendre.leggauss(32 + min(int(decay), 400))
    return 0.5 * (1 + points), 0.5 * shares


def advance(
    poles: Poles, force: Floats, *, growth: Complexes, taps: Complexes, integration: Integration, state: Complexes
) -> tuple[Floats, Complexes]:
    """Acceleration (channel, n) at the output samples, and the state (pole,) one output step behind the last.

    ``poles``: of structure and filter. ``force``: samples (axis, margin + n · substeps + margin), a step apart; the one
    after the first margin falls on the first output sample. ``growth``, ``taps``: of :func:`step_weights`.
    ``integration``: its margin, stencil and substeps. ``state`` (pole,): at the first output sample.
    """
    margin, substeps = integration.margin, integration.substeps
    n_out = (force.shape[1] - 2 * margin) // substeps
    signal = np.zeros((poles.output.shape[0], n_out))
    after = state.astype(np.complex128)
    even_taps = np.pad(taps, ((0, 0), (0, taps.shape[1] % 2)))  # the loop takes them two by two
    force, inputs, direct = (np.ascontiguousarray(part, np.float64) for part in (force, poles.input, poles.direct))
    output = np.ascontiguousarray(poles.output, dtype=np.complex128)
    fill_response(force, (inputs, output, direct), growth, even_taps, margin, substeps, after, signal)
    return signal, after


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def fill_response(force, poles, growth, taps, margin, substeps, state, signal):  # type: ignore[no-untyped-def]
    """Response to ``force`` added to ``signal`` (channel, n), ``state`` (pole,) moved on by n output samples.

    ``poles``: their input (pole, axis), output (channel, pole) and direct (channel, axis). ``growth`` (pole,) and
    ``taps`` (pole, tap): of ``step_weights``, an even number of taps. ``margin`` and ``substeps``: of an
    ``Integration``.
    """
    inputs, output, direct = poles
    n_channels, n_out = signal.shape
    behind = taps.shape[1] // substeps + 1
    acting = np.zeros((substeps, BLOCK + behind))
    re, im = np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, n_out, BLOCK):
        n = min(BLOCK, n_out - start)
        first = margin + start * substeps
        for channel in range(n_channels):
            for axis in range(force.shape[0]):
                gain = direct[channel, axis]
                if gain != 0.0:
                    for i in range(n):
                        signal[channel, start + i] += gain * force[axis, first + i * substeps]
        for p in range(inputs.shape[0]):
            _fill_acting(force, inputs[p], start * substeps + 1, n + behind, acting)
            _fill_pushes(acting, taps[p], n, re, im)
            z_re, z_im, g_re, g_im = state[p].real, state[p].imag, growth[p].real, growth[p].imag
            for i in range(n):
                push_re, push_im = re[i], im[i]
                re[i], im[i] = z_re, z_im
                z_re, z_im = (
                    (push_re + z_re) + (g_re * z_re - g_im * z_im),
                    (push_im + z_im) + (g_re * z_im + g_im * z_re),
                )
            state[p] = complex(z_re, z_im)
            for channel in range(n_channels):
                o_re, o_im = output[channel, p].real, output[channel, p].imag
                for i in range(n):
                    signal[channel, start + i] += o_re * re[i] - o_im * im[i]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _fill_acting(force, share, first, n, acting):  # type: ignore[no-untyped-def]
    """The force on one pole from sample ``first`` on; row r of ``acting`` gets every substeps-th sample from r on."""
    substeps = acting.shape[0]
    for r in range(substeps):
        for i in range(acting.shape[1]):
            acting[r, i] = 0.0
        begin = first + r
        there = min(n, (force.shape[1] - begin + substeps - 1) // substeps)
        for axis in range(force.shape[0]):
            if share[axis] != 0.0:
                gain = share[axis]
                for i in range(there):
                    acting[r, i] += gain * force[axis, begin + i * substeps]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _fill_pushes(acting, taps, n, re, im):  # type: ignore[no-untyped-def]
    """What every output step adds to one pole: the sum of ``taps`` over the samples of its force, two at a time."""
    substeps = acting.shape[0]
    for i in range(n):
        re[i], im[i] = 0.0, 0.0
    for tap in range(0, taps.size, 2):
        one = acting[tap % substeps, tap // substeps :]
        other = acting[(tap + 1) % substeps, (tap + 1) // substeps :]
        a_re, a_im, b_re, b_im = taps[tap].real, taps[tap].imag, taps[tap + 1].real, taps[tap + 1].imag
        for i in range(n):
            re[i] += a_re * one[i] + b_re * other[i]
            im[i] += a_im * one[i] + b_im * other[i]


Pieces = tuple[int, ...]
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
    Raises RequestError where the forces change too fast for the rate, where a force that falls with speed meets a
    standstill, and where gas lines with gains follow more than one shaft.
    """
    shafts = _Shafts(sources, gain_of_cycle, revs_per_cycle)
    signal = np.zeros((poles.direct.shape[0], n_samples))
    if not shafts.sources:
        return signal
    poles = poles.driven_on(shafts.axes(poles.direct.shape[1]))
    # before the first corner of any motion all is steady but for wobbles
    first_corner_s = min((time_s for _, motion in shafts.sources for time_s in motion.corner_s), default=0.0)
    first = int(np.floor(min(0.0, first_corner_s) * rate_hz))
    first -= int(np.ceil(MEMORY * poles.decay_s * rate_hz)) if shafts.remember else 0
    highest_hz = shafts.highest_force_hz(first / rate_hz, n_samples / rate_hz, tolerance)
    stepping = _Stepping(poles, shafts, integration_for(highest_hz, rate_hz, tolerance), rate_hz)
    state = shafts.steady(poles, first / rate_hz)
    per_block = max(1, block_steps // stepping.integration.substeps)
    for stretch in shafts.stretches(rate_hz, first, n_samples):
        for start in range(stretch.first, stretch.last, per_block):
            stop = min(start + per_block, stretch.last)
            part, state = stepping.block(start, stop, stretch.pieces, state)
            if stop > 0:
                signal[:, max(start, 0) : stop] = part[:, max(-start, 0) :]
        state = state + stepping.after_corner(stretch)
    return signal


@dataclass(frozen=True)
class _Stretch:
    """Output steps ``first`` … ``last`` in which every motion keeps to one piece, and what follows from a corner on."""

    first: int
    last: int
    pieces: Pieces
    corner_s: float
    next_pieces: Pieces


class _Shafts:
    """All forces and motions: the gas lines that a cycle's gain multiplies apart from the rest."""

    def __init__(
        self, sources: Sequence[tuple[ForceLines, Motion]], gain_of_cycle: GainOfCycle | None, revs_per_cycle: float
    ) -> None:
        self.sources = [(lines, motion) for lines, motion in sources if lines.order.size]
        self.gain_of_cycle, self.revs_per_cycle = gain_of_cycle, revs_per_cycle
        with_gas = [k for k, (lines, _) in enumerate(self.sources) if lines.gas.any()] if gain_of_cycle else []
        if len(with_gas) > 1:
            raise RequestError("gas forces that differ from cycle to cycle follow one shaft only", found=len(with_gas))
        self.gas_shaft = with_gas[0] if with_gas else None
        self.rest = [lines for lines, _ in self.sources]
        if self.gas_shaft is not None:
            lines = self.rest[self.gas_shaft]
            self.gas, self.rest[self.gas_shaft] = lines.only(lines.gas), lines.only(~lines.gas)

    @property
    def remember(self) -> bool:
        """Whether the past is more than a steady state."""
        uneven = any(motion.wobbles or motion.lag is not None for _, motion in self.sources)
        return uneven or self.gas_shaft is not None

    def axes(self, n_axes: int) -> Bools:
        """Axes (axis,) along which anything acts."""
        acts = np.zeros(n_axes, dtype=np.bool_)
        for lines, _ in self.sources:
            acts |= lines.amplitude.any(axis=1)
        return acts

    def steady(self, poles: Poles, time_s: float) -> Complexes:
        """State at ``time_s`` after an endless past at the first speed of every motion."""
        state = np.zeros(poles.pole_per_s.size, dtype=np.complex128)
        for lines, motion in self.sources:
            speed_rpm = motion.corners[0][1]
            angle_rev = motion.at(np.array([time_s]), piece=0)[0]
            force = lines.at_speed(speed_rpm) * np.exp(2j * np.pi * lines.order * angle_rev)
            state += steady_state(poles, force, lines.order * speed_rpm / 60)
        return state

    def highest_force_hz(self, start_s: float, end_s: float, tolerance: float) -> float:
        """Highest frequency of any force; what wobble and lag modulate reaches one sideband higher (Carson's rule)."""
        highest = 0.0
        for lines, motion in self.sources:
            corners = [time_s for time_s in motion.corner_s if start_s < time_s < end_s]
            looked_at = np.union1d(np.linspace(start_s, end_s, SPEED_SAMPLES), corners)
            fastest_rpm = float(np.abs(motion.at(looked_at)[1]).max())
            order = float(np.abs(lines.order).max())
            sidebands_hz = max((frequency for frequency, *_ in motion.wobbles), default=0.0)
            if motion.lag is not None:
                swing = np.abs(motion.lag.by_order(max(fastest_rpm, 1.0)))
                seen = motion.lag.order[2 * np.pi * order * swing > tolerance]
                sidebands_hz += float(np.max(seen, initial=0.0)) * fastest_rpm / 60
            room = ROOM if self.remember else 1.0
            highest = max(highest, room * order * fastest_rpm / 60 + sidebands_hz)
        return highest

    def stretches(self, rate_hz: float, first: int, n_samples: int) -> Iterator[_Stretch]:
        """Every stretch between corners from step ``first`` to ``n_samples``; a corner between samples ends late."""
        start_s = first / rate_hz
        pieces = tuple(sum(time <= start_s for time in motion.corner_s) for _, motion in self.sources)
        corners = sorted(
            (time, k) for k, (_, motion) in enumerate(self.sources) for time in motion.corner_s if time > start_s
        )
        for time_s, k in corners:
            last = int(np.ceil(time_s * rate_hz - ON_SAMPLE))
            if last >= n_samples:
                break
            following = (*pieces[:k], pieces[k] + 1, *pieces[k + 1 :])
            yield _Stretch(first, last, pieces, time_s, following)
            first, pieces = last, following
        yield _Stretch(first, n_samples, pieces, n_samples / rate_hz, pieces)

    def at(self, time_s: Floats, pieces: Pieces) -> tuple[Floats, Floats | None, Floats | None]:
        """Forces (axis, n) without those that gains multiply, these with a gain of 1, and the angle of their shaft."""
        total = np.zeros((self.sources[0][0].amplitude.shape[0], time_s.size))
        gas = gas_angle_rev = None
        for k, (_, motion) in enumerate(self.sources):
            moves = motion.at(time_s, piece=pieces[k])
            total += force_at(self.rest[k], *moves)
            if k == self.gas_shaft:
                gas, gas_angle_rev = force_at(self.gas, *moves), moves[0]
        return total, gas, gas_angle_rev


class _Stepping:
    """The integration of one record: from block to block, and over what happens between samples."""

    def __init__(self, poles: Poles, shafts: _Shafts, integration: Integration, rate_hz: float) -> None:
        self.poles, self.shafts, self.integration, self.rate_hz = poles, shafts, integration, rate_hz
        self.growth, self.taps = step_weights(poles.pole_per_s, 1 / (rate_hz * integration.substeps), integration)
        self.points, self.shares = unit_quadrature(float(np.max(np.abs(poles.pole_per_s), initial=0.0)) / rate_hz)

    def block(self, start: int, stop: int, pieces: Pieces, state: Complexes) -> tuple[Floats, Complexes]:
        """Signal (channel, n) at output steps ``start`` … ``stop``, and the state at ``stop``."""
        margin, substeps = self.integration.margin, self.integration.substeps
        number = np.arange(start * substeps - margin, stop * substeps + margin)
        force, gas, angle_rev = self.shafts.at(number / (self.rate_hz * substeps), pieces)
        if gas is None or angle_rev is None or self.shafts.gain_of_cycle is None:
            return self._advance(force, state)
        at_steps = angle_rev[margin : margin + (stop - start) * substeps + 1 : substeps]
        cycle = np.floor(at_steps / self.shafts.revs_per_cycle).astype(np.int64)
        gain = np.asarray(self.shafts.gain_of_cycle(cycle), dtype=np.float64)
        changes = np.flatnonzero(np.diff(cycle))
        borders_s = self._borders(changes + start, cycle[changes], cycle[changes + 1], pieces)
        parts, done = [], 0
        for change, border_s in zip([*changes.tolist(), None], [*borders_s.tolist(), 0.0], strict=True):
            end = stop - start if change is None else change + 1
            some = slice(done * substeps, end * substeps + 2 * margin)
            part, state = self._advance(force[:, some] + gain[done] * gas[:, some], state)
            parts.append(part)
            if change is not None:
                more = gain[change + 1] - gain[change]
                state = state + more * self._late(border_s, start + end, lambda time: self._gas(time, pieces))
            done = end
        return np.concatenate(parts, axis=1), state

    def after_corner(self, stretch: _Stretch) -> Complexes:
        """What the state at the end of ``stretch`` lacks because the corner came before that sample."""
        if stretch.last - stretch.corner_s * self.rate_hz <= ON_SAMPLE:
            return np.zeros_like(self.poles.pole_per_s)
        return self._late(
            stretch.corner_s,
            stretch.last,
            lambda time: self._all(time, stretch.next_pieces) - self._all(time, stretch.pieces),
        )

    def _advance(self, force: Floats, state: Complexes) -> tuple[Floats, Complexes]:
        return advance(self.poles, force, growth=self.growth, taps=self.taps, integration=self.integration, state=state)

    def _late(self, from_s: float, step: int, force: Callable[[Floats], Floats]) -> Complexes:
        """State at output ``step`` that a ``force`` of time leaves which acts from ``from_s`` on."""
        to_s = step / self.rate_hz
        acting = self.poles.input @ force(from_s + (to_s - from_s) * self.points)
        fading = np.exp(np.outer(self.poles.pole_per_s, (to_s - from_s) * (1 - self.points)))
        late: Complexes = (to_s - from_s) * (fading * acting) @ self.shares
        return late

    def _all(self, time_s: Floats, pieces: Pieces) -> Floats:
        force, gas, angle_rev = self.shafts.at(time_s, pieces)
        if gas is None or angle_rev is None or self.shafts.gain_of_cycle is None:
            return force
        cycle = np.floor(angle_rev / self.shafts.revs_per_cycle).astype(np.int64)
        return force + gas * self.shafts.gain_of_cycle(cycle)

    def _gas(self, time_s: Floats, pieces: Pieces) -> Floats:
        gas = self.shafts.at(time_s, pieces)[1]
        assert gas is not None  # only called where there are gas lines with gains
        return gas

    def _borders(self, step: Ints, old: Ints, new: Ints, pieces: Pieces) -> Floats:
        """Times within output steps ``step`` at which one cycle becomes the other: Newton's method from the middle."""
        assert self.shafts.gas_shaft is not None  # only called where there are gas lines with gains
        motion, piece = self.shafts.sources[self.shafts.gas_shaft][1], pieces[self.shafts.gas_shaft]
        target_rev = np.maximum(old, new) * self.shafts.revs_per_cycle
        begin = step / self.rate_hz
        end = (step + 1) / self.rate_hz
        time_s = 0.5 * (begin + end)
        for _ in range(6 if step.size else 0):
            angle_rev, speed_rpm, _ = motion.at(time_s, piece=piece)
            turns_per_s = np.where(speed_rpm == 0, np.inf, speed_rpm / 60)
            time_s = np.clip(time_s - (angle_rev - target_rev) / turns_per_s, begin, end)
        return time_s
