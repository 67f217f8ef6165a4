"""What an estimator that knows the model could tell from a test: Cramér-Rao bounds, and what it would decide with them.

The estimator knows how many modes and orders there are, the shaft, the density of the noise, and the law of each
force up to a smooth factor (a complex cubic in speed). It does not know the poles, nor that factor, nor how strongly
each mode and the direct path show (a complex number each) in each channel at each order, nor the shapes and the forces
behind the broadband floor. Orders: complex envelopes in noise of the floor's density. Floor: Whittle's likelihood of
the cross-spectral density, over the length of the whole test. Both share the poles; all other unknowns are eliminated
(Schur complement). Close orders are taken as apart. It decides at 95 %:

* a mode is told from a tone where its damping is 3.92 standard errors or more from zero and its frequency is known to
  0.2 % or better;
* an order is told locked or slipping where 3.92 standard errors of its number are less than its distance to the
  nearest half order (slipping) or than the smallest slip drawn, 0.3 % (locked);
* a speed is free where it lies outside every dangerous range, widened by 1.96 standard errors of the mode's frequency,
  and on no flank of a resonance that still makes an order more than three times larger.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from machines.machine import ComplexArray, FloatArray, Machine, Mode, Profile
from machines.signals import convolved
from machines.truth import Dangerous, on_a_flank

Z95, SMALLEST_SLIP, KNOWN_FREQUENCY = 1.96, 0.003, 0.002
LARGEST_TURN_RAD = 3.0
"""Of a force between two samples of the coarse grid of a sweep."""
MOST_ROWS = 3000
CLEAR = 8.0
"""Amplitude over its standard error at which an order stands clear of the noise."""
FORCE_POWERS = 3
"""Powers of speed in the unknown smooth factor of each force."""
ROUNDING = 1e-12
"""Share of the largest singular value below which a direction is none."""
POLE = ("frequency_hz", "damping_ratio")
STEP = 1e-3
"""Relative step of the numerical derivatives, in shares of the damping."""


@dataclass(frozen=True)
class Bound:
    """Standard errors at the bound: of each mode's frequency, Hz, and damping ratio, and of each order's number."""

    frequency_hz: FloatArray
    damping_ratio: FloatArray
    order: FloatArray
    seen: tuple[bool, ...]
    """By order: whether it stands clear of the noise (amplitude over standard error 8 or more) somewhere."""


def bound_of(machine: Machine) -> Bound:
    """The bounds that the test of ``machine`` sets, known noise and model; a swing within the cycle left out."""
    machine = replace(machine, profiles=tuple(replace(profile, swing=None) for profile in machine.profiles))
    n_modes = len(machine.modes)
    # a prior of 100 % on frequency and 10 on damping keeps what is not seen at all finite
    information = np.diag([*(1.0 / mode.frequency_hz**2 for mode in machine.modes), *([1e-2] * n_modes)])
    order_error, seen = [], []
    for number in range(len(machine.orders)):
        order_information, error, clear = _from_order(machine, number)
        information = information + order_information
        order_error.append(error)
        seen.append(clear)
    if machine.force_density:
        information = information + _from_floor(machine)
    spread = standard_errors(information)
    return Bound(spread[:n_modes], spread[n_modes:], np.asarray(order_error), tuple(seen))


def standard_errors(information: FloatArray) -> FloatArray:
    """Standard errors (P,) of parameters at the bound, from their positive definite ``information`` (P, P).

    In units of what each tells alone: a pole that is seen a million times worse than another is not known at all, where
    a cut by the largest singular value would call it exact.
    """
    scale = 1.0 / np.sqrt(np.diag(information))
    return np.asarray(scale * np.sqrt(np.diag(np.linalg.inv(information * scale[:, None] * scale))))


def told_from_a_tone(machine: Machine, bound: Bound) -> list[bool]:
    """By mode of ``machine``: whether the knowing estimator could call it a mode with the errors of ``bound``."""
    return [
        bool(error <= KNOWN_FREQUENCY * mode.frequency_hz and mode.damping_ratio >= 2.0 * Z95 * spread)
        for mode, error, spread in zip(machine.modes, bound.frequency_hz, bound.damping_ratio, strict=True)
    ]


def lock_told(machine: Machine, bound: Bound) -> list[bool]:
    """By order of ``machine``: whether the knowing estimator could tell locked from slipping with ``bound``."""
    told = []
    for order, error in zip(machine.orders, bound.order, strict=True):
        distance = abs(order.order - round(2.0 * order.order) / 2.0)
        told.append(bool(2.0 * Z95 * error <= (distance or SMALLEST_SLIP * order.order)))
    return told


def free_for_the_oracle(
    machine: Machine, bound: Bound, rpm: FloatArray, dangerous: tuple[Dangerous, ...]
) -> FloatArray:
    """1 where the knowing estimator could call ``rpm`` (speed,) of ``machine`` free, else 0.

    ``bound``: its errors. ``dangerous``: the dangerous speeds that there are.
    """
    free = np.ones(rpm.size)
    for item in dangerous:
        spread = Z95 * bound.frequency_hz[item.mode] / item.mode_hz
        free[(rpm >= item.low_rpm * (1.0 - spread)) & (rpm <= item.high_rpm * (1.0 + spread))] = 0.0
    for number in range(len(machine.orders)):
        for mode in range(len(machine.modes)):
            free[on_a_flank(machine, number, mode, rpm)] = 0.0
    return free


def _moved(mode: Mode, key: str, by: float) -> Mode:
    return replace(mode, **{key: getattr(mode, key) + by})


def _step(mode: Mode, key: str) -> float:
    return STEP * mode.damping_ratio * (mode.frequency_hz if key == "frequency_hz" else 1.0)


def _slope(of: Callable[[Mode], Any], mode: Mode, key: str) -> Any:
    """Central difference of ``of`` by the parameter ``key`` of ``mode``."""
    step = _step(mode, key)
    return (of(_moved(mode, key, step)) - of(_moved(mode, key, -step))) / (2.0 * step)


@dataclass(frozen=True)
class _Rows:
    """A recording as an order sees it, by row: seconds that it stands for, frequency, force, angle, unit responses."""

    weight_s: FloatArray
    frequency_hz: FloatArray
    force: ComplexArray
    angle: FloatArray
    responses: list[tuple[ComplexArray, ...]]
    """By mode: response for unit shape, its derivatives by frequency and damping, (row,)."""


def _from_order(machine: Machine, number: int) -> tuple[FloatArray, float, bool]:
    """Information on all poles from order ``number``; error of its order; whether it stands clear of the noise."""
    parts = [_rows(machine, profile, number) for profile in machine.profiles]
    weight = np.concatenate([part.weight_s for part in parts])
    hertz = np.concatenate([part.frequency_hz for part in parts])
    inverse = np.linalg.inv(machine.floor_psd(hertz))
    columns, total = _columns(machine, number, parts)
    root = np.linalg.cholesky(inverse).conj()
    whitened = np.einsum("rdc,pdr->pcr", root, columns, optimize=True) * np.sqrt(weight)
    rows = whitened.reshape(len(whitened), -1).T
    density = np.einsum("cr,rcd,dr->r", np.conj(total), inverse, total, optimize=True).real * weight
    turning, strongest, at = 0.0, 0.0, 0
    for part in parts:  # each recording has a phase of its own, for a slipping order keeps none between them
        own = density[at : at + part.weight_s.size]
        at += part.weight_s.size
        centre = float((own * part.angle).sum() / max(own.sum(), 1e-300))
        turning += float((own * (2.0 * np.pi * (part.angle - centre)) ** 2).sum())
        strongest = max(strongest, float(own.sum()))
    error = 1.0 / np.sqrt(max(turning, 1e-300))
    told = _left_of(np.concatenate([rows.real, rows.imag]), 2 * len(machine.modes))
    return told, error, strongest >= CLEAR**2


def _columns(machine: Machine, number: int, parts: list[_Rows]) -> tuple[ComplexArray, ComplexArray]:
    """Derivatives of the envelopes by every parameter, (parameter, channel, row), and the envelopes, (channel, row).

    First the poles: frequencies, then damping ratios; then how strongly each mode and the direct path show, by channel;
    then the smooth factor of the force.
    """
    order, n_channels = machine.orders[number], len(machine.channels)
    force = np.concatenate([part.force for part in parts])
    columns: list[ComplexArray] = []
    joined = [
        [np.concatenate([part.responses[place][kind] for part in parts]) for place in range(len(machine.modes))]
        for kind in range(3)
    ]
    strength = [mode.drive[number] * np.asarray(mode.shape)[:, None] for mode in machine.modes]
    for kind in (1, 2):
        columns += [np.asarray(strong * slope) for strong, slope in zip(strength, joined[kind], strict=True)]
    total = np.asarray(order.direct)[:, None] * force
    for strong, response in zip(strength, joined[0], strict=True):
        total = total + strong * response
    for channel in range(n_channels):
        for response in (*joined[0], force):
            column = np.zeros((n_channels, force.size), dtype=complex)
            column[channel] = response
            columns += [column, 1j * column]
    hertz = np.concatenate([part.frequency_hz for part in parts])
    middle, half = 0.5 * (hertz.max() + hertz.min()), max(0.5 * float(np.ptp(hertz)), 1e-3 * float(hertz.max()))
    for power in range(1, FORCE_POWERS + 1):
        bent = total * ((hertz - middle) / half) ** power
        columns += [bent, 1j * bent]
    return np.stack(columns), np.asarray(total)


def _left_of(rows: FloatArray, wanted: int) -> FloatArray:
    """Information on the first ``wanted`` parameters from whitened slopes (row, parameter), the others unknown.

    Orthogonal throughout: with strong orders a Gram matrix would take what its rounding loses for knowledge.
    """
    rows = np.asarray(np.linalg.qr(rows, mode="r"))
    nuisance = rows[:, wanted:] / np.maximum(np.linalg.norm(rows[:, wanted:], axis=0), 1e-300)
    basis, values, _ = np.linalg.svd(nuisance, full_matrices=False)
    basis = basis[:, values > ROUNDING * values[0]]
    kept = rows[:, :wanted]
    for _ in range(2):
        kept = kept - basis @ (basis.T @ kept)
    return np.asarray(kept.T @ kept)


def _without_nuisance(gram: FloatArray, wanted: int) -> FloatArray:
    """Information on the first ``wanted`` parameters where the others are unknown."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    even = gram * scale[:, None] * scale
    cross = even[:wanted, wanted:]
    kept = (
        even[:wanted, :wanted] - cross @ np.linalg.pinv(even[wanted:, wanted:], rcond=1e-10, hermitian=True) @ cross.T
    )
    values, vectors = np.linalg.eigh(0.5 * (kept + kept.T))
    kept = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(kept / scale[:wanted, None] / scale[:wanted])


def _rows(machine: Machine, profile: Profile, number: int) -> _Rows:
    return _steady_rows(machine, profile, number) if machine.steady else _swept_rows(machine, profile, number)


def _steady_rows(machine: Machine, profile: Profile, number: int) -> _Rows:
    """A recording at one speed: a few rows that differ in angle only."""
    order, rpm = machine.orders[number], float(np.mean(profile.rpm))
    frequency = np.array([order.order * rpm / 60.0])
    ones, steady = np.ones(16), np.ones(16, dtype=np.complex128)
    angle = rpm / 60.0 * profile.duration_s * (np.arange(16) + 0.5) / 16
    force = complex(order.force(rpm))

    def unit(mode: Mode) -> complex:
        return force * complex(replace(mode, shape=(1.0 + 0j,)).acceleration_per_force(frequency)[0, 0])

    responses = []
    for mode in machine.modes:
        values = (unit(mode), *(_slope(unit, mode, key) for key in POLE))
        responses.append(tuple(np.asarray(value * steady) for value in values))
    return _Rows(profile.duration_s / 16 * ones, frequency[0] * ones, np.asarray(force * steady), angle, responses)


def _swept_rows(machine: Machine, profile: Profile, number: int) -> _Rows:
    """A sweep on a grid as coarse as the convolution allows, thinned where it has more rows than are needed."""
    order = machine.orders[number]
    fastest = 2.0 * np.pi * order.order * max(profile.rpm) / 60.0
    count = int(np.ceil(profile.duration_s * fastest / LARGEST_TURN_RAD)) + 64
    time_s = np.linspace(0.0, profile.duration_s, count)
    step_s = float(time_s[1])
    node = np.polynomial.legendre.leggauss(5)[0]
    between = time_s[:-1] + 0.5 * step_s * (1.0 + node[:, None])
    speed = np.maximum(profile.speed(time_s), 0.0)
    angle, envelope = profile.angle(time_s), order.force(speed)
    carrier = np.exp(2j * np.pi * order.order * angle)
    force = order.force(np.maximum(profile.speed(between), 0.0))
    force = force * np.exp(2j * np.pi * order.order * profile.angle(between))
    first, jw = envelope[0] * carrier[0], 2j * np.pi * order.order * speed[0] / 60.0
    thin = slice(None, None, max(1, count // MOST_ROWS))

    def unit(mode: Mode) -> ComplexArray:
        s = mode.pole
        up = convolved(s, force, first / (jw - s), step_s)[thin]
        down = convolved(np.conj(s), force, first / (jw - np.conj(s)), step_s)[thin]
        swing = (s**2 * up - np.conj(s**2) * down) / (2j * s.imag)
        return np.asarray(swing * np.conj(carrier[thin]) + envelope[thin])

    responses: list[tuple[ComplexArray, ...]] = []
    for mode in machine.modes:
        middle, steps = unit(mode), ((key, _step(mode, key)) for key in POLE)
        responses.append((middle, *((unit(_moved(mode, key, step)) - middle) / step for key, step in steps)))
    kept = time_s[thin]
    weight = np.full(kept.size, profile.duration_s / kept.size)
    hz = np.maximum(order.order * speed[thin] / 60.0, 0.1)
    return _Rows(weight, hz, envelope[thin], angle[thin], responses)


def _from_floor(machine: Machine) -> FloatArray:
    """Information on all poles from the broadband floor."""
    near = [np.linspace(5.0, 0.45 * machine.rate_hz, 400)]
    near += [
        mode.frequency_hz * (1.0 + mode.damping_ratio * np.sinh(np.linspace(-4.0, 4.0, 161))) for mode in machine.modes
    ]
    frequency = np.unique(np.concatenate(near))
    frequency = frequency[(frequency > 5.0) & (frequency < 0.45 * machine.rate_hz)]
    width = np.gradient(frequency) * sum(profile.duration_s for profile in machine.profiles)
    inverse = np.linalg.inv(machine.floor_psd(frequency))
    slopes = np.stack([inverse @ slope for slope in _floor_slopes(machine, frequency)])
    gram = np.einsum("pfab,qfba,f->pq", slopes, slopes, width, optimize=True).real
    return _without_nuisance(gram, 2 * len(machine.modes))


def _floor_slopes(machine: Machine, frequency: FloatArray) -> list[ComplexArray]:
    """Derivatives of the floor's density by frequency and damping of every mode, then by its shape, then by its noise.

    The shape and the gains of the forces multiply: those of the shape alone say all where there is one source.
    """

    def floor(place: int, mode: Mode) -> ComplexArray:
        modes = (*machine.modes[:place], mode, *machine.modes[place + 1 :])
        return replace(machine, modes=modes).floor_psd(frequency)

    slopes = [_slope(partial(floor, place), mode, key) for key in POLE for place, mode in enumerate(machine.modes)]
    base = machine.floor_psd(frequency)
    for place, mode in enumerate(machine.modes):
        for channel in range(len(machine.channels)):
            for turn in (1.0, 1j):
                shape = list(mode.shape)
                shape[channel] += 1e-4 * turn * abs(shape[channel])
                slopes.append((floor(place, replace(mode, shape=tuple(shape))) - base) / 1e-4)
        for source in range(len(machine.force_density) if len(machine.force_density) > 1 else 0):
            gains = list(mode.broadband)
            gains[source] *= 1.0 + 1e-4
            slopes.append((floor(place, replace(mode, broadband=tuple(gains))) - base) / 1e-4)
    for channel in range(len(machine.channels)):
        slope = np.zeros_like(base)
        slope[:, channel, channel] = machine.noise_density[channel] ** 2
        slopes.append(slope)
    return slopes
