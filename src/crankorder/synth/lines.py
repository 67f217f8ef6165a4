"""The order lines of a scene, forces at multiples of a shaft's angle, and the strikes of damaged rolling bearings."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.signal import lfilter

from crankorder.engine.forces import crankcase_forces, crankcase_moments, gas_torque_by_order, two_masses
from crankorder.engine.machine_parts import bearing_orders
from crankorder.engine.slider_crank import piston_velocity, rod_angle, sine_cosine
from crankorder.engine.torsional_fluctuation import Lag, lag_from_torque, lag_of_speed
from crankorder.errors import RequestError
from crankorder.quantities import Complexes, Floats, Ints
from crankorder.synth.driven import ForceLines, lines_in_angle, lines_in_time
from crankorder.synth.motion import Motion, wander_wobbles
from crankorder.synth.noise import seed_stream
from crankorder.synth.parts import AXES, Axis, OtherShaft, SpeedOrder, TimeSampling
from crankorder.synth.poles import POLES_APART, AnalogueFilter, accelerance
from crankorder.synth.scene import Run, Scene

LEAST_STEP, MOST_STEPS = 0.01, 10_000
"""Finest step that the orders of a speed may share, and how many: a line of a force becomes one at every step."""


def lag_by_order(parts: Sequence[SpeedOrder]) -> Lag:
    """Lag of a shaft whose speed is Ω · (1 + Σ percent/100 · cos(2π order crank_angle + phase)), at any mean speed.

    Ω is the mean of the speed over the crank angle; the mean over time is a little lower, and the mean speed of the
    motion is this one. An analysis of the speed by crank angle finds these orders and no others: the lag has their
    multiples and combinations too, down to round-off.

    ``parts``: order, percent and phase of each, at least one. Raises RequestError for orders that no cycle of up to
    100 revolutions holds or above 10 000 cycles, and where the speed falls below a tenth of its mean.
    """
    zero = np.zeros(len(parts), dtype=np.complex128)
    order = np.array([part.order for part in parts])
    step = Lag(order=np.unique(order), inertia=zero[: np.unique(order).size], gas=zero[: np.unique(order).size]).step
    if step < LEAST_STEP or order.max() > MOST_STEPS * step:
        allowed = f"up to {MOST_STEPS} multiples of one step of at least {LEAST_STEP:g}"
        raise RequestError("orders of the in-cycle speed have no common cycle", place="by_order", allowed=allowed)
    line = np.rint(order / step).astype(int)
    speed = np.zeros(line.max() + 1, dtype=np.complex128)
    share = np.array([part.percent / 100 for part in parts])
    np.add.at(speed, line, share * np.exp(2j * np.pi * np.array([part.phase_deg for part in parts]) / 360))
    return lag_of_speed(speed, step=step)


def start_angle_rev(scene: Scene, run: Run) -> float:
    """Crank angle of the first sample from firing top dead centre, 0 … 2 revolutions: by chance when sampled in time.

    ``scene``: its seed and sampling. ``run``: the recording. Sampled by crank angle a recording starts at 0.
    """
    if isinstance(scene.sampling, TimeSampling):
        return 2 * float(seed_stream(scene.seed, "start_angle", run.stream).random())
    return 0.0


def crank_motion(scene: Scene, run: Run) -> Motion:
    """Motion of the crank in one recording, with what the scene asks for: profile, wander, in-cycle motion.

    ``scene``: its speeds and effects. ``run``: the recording.
    """
    wobbles: tuple[tuple[float, float, float], ...] = ()
    if scene.speed_wander is not None:
        stream = seed_stream(scene.seed, "speed_wander", run.stream)
        duration_s = scene.n_samples / scene.rate_hz(run.speed_rpm)
        wander = scene.speed_wander
        wobbles = wander_wobbles(wander.std_rpm, wander.corner_hz, stream, duration_s)
    corners = _on_samples(scene, scene.speed_profile.corners) if scene.speed_profile else ((0.0, run.speed_rpm),)
    lag = _lag(scene, run) if scene.in_cycle_speed is not None else None
    return Motion(start_rev=start_angle_rev(scene, run), corners=corners, wobbles=wobbles, lag=lag)


def other_motion(scene: Scene, run: Run, shaft: OtherShaft) -> Motion:
    """Motion of a ``shaft`` with a speed of its own, its angle by chance; ``scene`` and ``run`` as above."""
    assert shaft.rpm is not None  # a shaft at a ratio turns with the crank
    start = float(seed_stream(scene.seed, "other_shafts", shaft.name, run.stream).random())
    corners = tuple(zip(shaft.time_s, shaft.rpm, strict=True)) if shaft.time_s else ((0.0, shaft.rpm[0]),)
    return Motion(start_rev=start, corners=_on_samples(scene, corners))


def _on_samples(scene: Scene, corners: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    rate_hz = scene.rate_hz(scene.speed_range_rpm[1])
    return tuple((round(time_s * rate_hz) / rate_hz, rpm) for time_s, rpm in corners)


def _lag(scene: Scene, run: Run) -> Lag:
    """In-cycle motion, exact at the speed of ``run``: of a profile at the highest, either way."""
    assert scene.in_cycle_speed is not None
    if scene.in_cycle_speed.by_order:
        return lag_by_order(scene.in_cycle_speed.by_order)
    inertia = scene.in_cycle_speed.flywheel_inertia_kg_m2 or scene.engine.flywheel_inertia_kg_m2
    if inertia is None:
        problem = "neither the scene nor its engine says how large the flywheel is"
        allowed = "by_order, or flywheel_inertia_kg_m2 here or in the engine"
        raise RequestError(problem, place="in_cycle_speed", allowed=allowed)
    speed_rpm = run.speed_rpm if scene.speed_profile is None else max(map(abs, scene.speed_range_rpm)) or 1.0
    with_gas = scene.gas_torque is not None and scene.engine.gas is not None
    return lag_from_torque(scene.engine, flywheel_inertia_kg_m2=inertia, speed_rpm=speed_rpm, with_gas=with_gas)


def gain_of_cycle(scene: Scene, run: Run) -> Callable[[Ints], Floats] | None:
    """Factor (cycles,) of the gas torque by the cycle's number, or None where all cycles of ``run`` are alike.

    ``scene``: its scatter and seed. A cycle's factor does not depend on which others are asked for.
    """
    if scene.gas_torque is None or not scene.gas_torque.scatter_percent:
        return None
    scatter = scene.gas_torque.scatter_percent / 100

    def gain(cycle: Ints) -> Floats:
        drawn = np.zeros(cycle.size)
        for way, number in (("after", cycle), ("before", -1 - cycle)):
            if (side := number >= 0).any():
                stream = seed_stream(scene.seed, "gas_torque", run.stream, way)
                drawn[side] = stream.standard_normal(int(number.max()) + 1)[number[side]]
        return np.maximum(1 + scatter * drawn, 0.0)

    return gain


SHORTEST_STEP = 0.05
"""Of the period between strikes, left by jitter at least (4.75 σ at the most jitter): strikes do not swap places."""


HEARD = 1e-16
"""Share of the size of a strike below which its ringing is no more than round-off."""


def slipping_line(order: float, *, slip_percent: float) -> float:
    """Order of a bearing line whose rolling elements slip: order · (1 − slip).

    ``order``: of pure rolling, > 0. ``slip_percent``: how much slower than that, < 100; negative is faster.
    """
    return order * (1 - slip_percent / 100)


def strike_angles(
    order: float,
    *,
    slip_percent: float,
    jitter_percent: float,
    start_rev: float,
    end_rev: float,
    stream: np.random.Generator,
) -> Floats:
    """Crank angles (rev) at which a damaged place strikes, ascending, from ``start_rev`` to ``end_rev``, shape (k,).

    Angles, not times: the same under any motion. The periods between strikes vary independently and so add up to a
    random walk, as rolling elements do that slip; lines in the spectrum widen with their order. An earlier
    ``start_rev`` or a later ``end_rev`` adds strikes and changes none.

    ``order``: strikes per crank revolution in pure rolling, > 0. ``slip_percent``: how much fewer, −100 … 100 both
    excluded. ``jitter_percent``: standard deviation of a period, 0 … 20. ``stream``: of the chance, with children that
    it spawns; the first strike after crank angle 0 comes anywhere within a period.
    Source: Antoni and Randall (2003), Journal of Vibration and Acoustics 125, p. 282: random slips that add up, as
    against jitter about a fixed place.
    """
    period_rev = 1 / slipping_line(order, slip_percent=slip_percent)
    first, start, end = stream.random(), start_rev / period_rev, end_rev / period_rev
    ahead, back = stream.spawn(2)
    later = first + _walk(ahead, jitter_percent, end - first)
    earlier = first - _walk(back, jitter_percent, first - start)[:0:-1]
    place = np.concatenate([earlier, later])
    return period_rev * place[(place >= start) & (place <= end)]


def _walk(stream: np.random.Generator, jitter_percent: float, distance: float) -> Floats:
    """Distances from one strike to those after it, itself first, as far as ``distance``; all in periods."""
    walk, count = np.zeros(1), max(int(distance), 0) + 2
    while True:
        fresh = count - walk.size
        excess = 0.01 * jitter_percent * stream.standard_normal(fresh) if jitter_percent else np.zeros(fresh)
        steps = np.maximum(excess, SHORTEST_STEP - 1)
        # from the last value on, as one sum would: how many are drawn at a time changes no bit
        walk = np.concatenate([walk, np.cumsum(np.concatenate([walk[-1:], steps]))[1:]])
        place: Floats = np.arange(walk.size) + walk
        if place[-1] > distance:
            return place[: max(int(np.searchsorted(place, distance, side="right")), 1)]
        count = walk.size + int(distance - place[-1]) + 2


def modulation(
    line: Literal["BPFO", "BPFI", "BSF", "FTF"],
    strike_rev: Floats,
    *,
    load_zone: float,
    shaft_ratio: float,
    cage_order: float,
    phase_rev: float = 0.0,
) -> Floats:
    """Size of each strike relative to the average one, as the load zone makes it, shape (k,).

    1 + load_zone · cos: over the angle of the shaft where the damage turns with the inner ring (BPFI), over that of the
    cage where it is on a rolling element (BSF). A damaged outer ring or cage is always struck where it is: 1. Over many
    strikes the mean is 1.

    ``line``: what is damaged. ``strike_rev``: crank angles, shape (k,). ``load_zone``: share that comes and goes,
    0 … 1. ``shaft_ratio``: shaft revolutions per crank revolution. ``cage_order``: cage revolutions per crank
    revolution, with its slip. ``phase_rev``: where in the cosine the crank angle 0 is, in its revolutions.
    Source: McFadden and Smith (1984), Journal of Sound and Vibration 96, p. 69, with one harmonic for the load.
    """
    order = {"BPFI": shaft_ratio, "BSF": cage_order}.get(line, 0.0)
    angle_rev = np.mod(order * strike_rev + phase_rev, 1.0)
    share = load_zone if order else 0.0
    return 1 + share * np.cos(2 * np.pi * angle_rev)


def ringing(
    strike_s: Floats,
    size: Floats,
    *,
    resonance_hz: float,
    damping_ratio: float,
    rate_hz: float,
    n_samples: int,
    filter: AnalogueFilter | None = None,
) -> Floats:
    """Sum of the ringings that strikes set off, sampled where it is, also between the samples struck, (n_samples,).

    One ringing is exp(−ζ ωn τ) sin(ωd τ) since its strike, scaled so that its largest value is the strike's size. What
    a sampler sees of it is exact, and so is what folds from above half the rate. A filter changes that largest value.

    ``strike_s``: times from the first sample, in any sequence, shape (k,); strikes before the record (negative) still
    ring in it, see :func:`ringing_s`. ``size``: of each, shape (k,), any unit. ``resonance_hz``: natural frequency
    ωn / 2π, > 0. ``damping_ratio``: ζ, between 0 and 1. ``rate_hz``: samples per second. ``n_samples``: ≥ 0.
    ``filter``: between the sensor and the sampler. Raises RequestError where the resonance is a pole of it.
    """
    signal = np.zeros(n_samples)
    strike_sample = np.asarray(strike_s, dtype=np.float64) * rate_hz
    rings = strike_sample <= n_samples - 1
    strike_sample, struck = strike_sample[rings], np.asarray(size, dtype=np.float64)[rings]
    entry_sample = np.maximum(np.ceil(strike_sample), 0.0)
    pole, weight = _poles(resonance_hz, damping_ratio, filter)
    for decay, by in zip(pole / rate_hz, weight, strict=True):
        entry = by * struck * np.exp(decay * (entry_sample - strike_sample))
        struck_at = np.zeros(n_samples, dtype=np.complex128)
        np.add.at(struck_at, entry_sample.astype(np.int64), entry)
        signal += lfilter([1.0], [1.0, -np.exp(decay)], struck_at).real
    return signal


def ringing_s(resonance_hz: float, damping_ratio: float, *, filter: AnalogueFilter | None = None) -> float:
    """Time (s) after which a strike rings with less than ``HEARD`` of its size: how far back strikes still count.

    ``resonance_hz``, ``damping_ratio``, ``filter``: as for :func:`ringing`.
    """
    pole, weight = _poles(resonance_hz, damping_ratio, filter)
    times = np.log(np.maximum(np.abs(weight) * pole.size / HEARD, 1.0)) / -pole.real
    return float(times.max())


def _poles(resonance_hz: float, damping_ratio: float, filter: AnalogueFilter | None) -> tuple[Complexes, Complexes]:
    """Poles and weights such that Re Σ weight · exp(pole τ) is one ringing of size 1; of a pair of poles the upper.

    By partial fractions: what stands in series adds up. Source: any text on the Laplace transform.
    """
    undamped = math.sqrt((1 - damping_ratio) * (1 + damping_ratio))
    pole = 2 * math.pi * resonance_hz * complex(-damping_ratio, undamped)
    largest = undamped * math.exp(-damping_ratio / undamped * math.acos(damping_ratio))
    if filter is None:
        return np.array([pole]), np.array([-1j / largest])
    behind = filter.pole_per_s
    if np.any(np.abs(behind - pole) < POLES_APART * abs(pole)):
        problem = "the resonance of an impact is a pole of the acquisition's filter"
        remedy = "Shift one of them a little"
        raise RequestError(problem, found=f"{resonance_hz:g} Hz, ζ {damping_ratio:g}", remedy=remedy)
    # times 1 for a real pole, times 2 for the upper of a pair, whose lower one adds the conjugate
    beside = np.where(np.abs(behind.imag) <= 1e-12 * np.abs(behind), 1.0, np.where(behind.imag > 0, 2.0, 0.0))
    through = pole.imag / ((behind - pole) * (behind - pole.conjugate())) / largest
    kept = beside > 0
    weights = np.concatenate([-1j / largest * filter.at(np.array([pole])), (beside * filter.residue * through)[kept]])
    return np.concatenate([np.array([pole]), behind[kept]]), weights


ANGLES = 1 << 14
"""Of a revolution, at which the inertia of the masses about the crank is looked at: as many as for a gas torque."""
SIDEBAND = "in-cycle speed"
"""Cause of a line that no force has: the shaft's uneven turning makes it of those that have one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OrderLines:
    """Lines amplitude · exp(2πi order rev), rev from firing top dead centre.

    ``order`` (line); ``amplitude`` complex peak (channel, line), m/s²; ``cause`` (line): what made each.
    """

    order: Floats
    amplitude: Complexes
    cause: tuple[str, ...]


@dataclass(frozen=True)
class _Force:
    """One line of a force: complex peak by axis (6,) at a speed, how it grows with speed, and what it is."""

    order: float
    amplitude: Complexes
    cause: str
    at_speed_rpm: float = 1000.0
    exponent: float = 2.0
    inertia: bool = False
    gas: bool = False
    acceleration: bool = False


def crank_forces(scene: Scene) -> ForceLines:
    """Every force and moment of ``scene`` that follows the crank, those of shafts at a ratio to it included."""
    forces = [*_masses(scene), *_gas(scene)]
    ratios: dict[str | None, float] = {None: 1.0}
    ratios |= {shaft.name: shaft.ratio for shaft in scene.other_shafts if shaft.ratio is not None}
    for name, ratio in ratios.items():
        forces += _injected(scene, name, ratio)
    return _stacked(forces)


def shaft_forces(scene: Scene, shaft: OtherShaft) -> ForceLines:
    """Every force of ``scene`` that follows a ``shaft`` with a speed of its own, by orders of that shaft."""
    return _stacked(_injected(scene, shaft.name, 1.0))


def driven_lines(scene: Scene, forces: ForceLines, speed_rpm: float, lag: Lag | None = None) -> OrderLines:
    """Steady response of the structure to ``forces``, by multiples of the mean rotation at ``speed_rpm``.

    ``scene``: structure and filter. ``lag``: in-cycle motion of the shaft, which gives every line sidebands.
    """
    steady = forces.only(~forces.accelerates) if lag is None else forces
    order, force, cause = steady.order, steady.at_speed(speed_rpm), steady.cause
    if lag is not None and order.size:
        known = _leading_causes(scene, steady, speed_rpm)
        order, force = lines_in_time(forces, lag, speed_rpm=speed_rpm)
        cause = tuple(known.get(value, SIDEBAND) for value in order.tolist())
    response = accelerance(scene.structure, order * speed_rpm / 60)
    if scene.filter is not None:
        response = response * scene.filter.response(order * speed_rpm / 60)
    return OrderLines(order=order, amplitude=np.einsum("cal,al->cl", response, force), cause=cause)


def _leading_causes(scene: Scene, forces: ForceLines, speed_rpm: float) -> dict[float, str]:
    """What makes most of each order of ``forces``, by its response alone in the channel where that is largest."""
    response = accelerance(scene.structure, forces.order * speed_rpm / 60)
    alone = np.abs(np.einsum("cal,al->cl", response, forces.at_speed(speed_rpm))).max(axis=0, initial=0.0)
    return {float(forces.order[place]): forces.cause[place] for place in np.argsort(alone, kind="stable")}


def fixed_lines(scene: Scene, run: Run) -> OrderLines:
    """Bearing lines of ``scene`` in one ``run``, by multiples of the crank angle."""
    orders = {bearing.name: bearing_orders(bearing) for bearing in scene.engine.bearings}
    lines = scene.bearing_lines
    order = [slipping_line(orders[line.bearing][line.line], slip_percent=line.slip_percent) for line in lines]
    amplitude = np.zeros((len(scene.channels), len(order)), dtype=np.complex128)
    for k, line in enumerate(lines):
        phase_rev = seed_stream(scene.seed, "bearing_lines", str(k), run.stream).random()
        size = scene.by_channel(line.amplitude_m_s2) * line.growth**run.repeat
        amplitude[:, k] = size * np.exp(2j * np.pi * phase_rev)
    causes = tuple(f"bearing {line.line}" for line in lines)
    return OrderLines(order=np.array(order), amplitude=amplitude, cause=causes)


def strikes_per_rev(orders: dict[str, float], line: str) -> float:
    """Strikes per crank revolution of a damage of ``line``; ``orders``: of the bearing. A roller strikes both races."""
    return 2 * orders[line] if line == "BSF" else orders[line]


def order_lines(
    scene: Scene, run: Run, speed_rpm: float | None = None, *, forces: ForceLines | None = None
) -> OrderLines:
    """What a perfect order analysis of ``run`` finds at a steady ``speed_rpm`` (the run's own unless stated).

    ``scene``: engine, structure, effects and what stands behind the sensors, a channel's delay included (for bearing
    lines that of the mean rotation). ``forces``: of :func:`crank_forces`, where they are at hand, for
    they are the same at all speeds. A line that two effects make is there twice; the lines add up.
    """
    speed = run.speed_rpm if speed_rpm is None else speed_rpm
    lag = crank_motion(scene, run).lag if scene.in_cycle_speed is not None else None
    driven = _late(scene, driven_lines(scene, forces or crank_forces(scene), speed, lag), speed)
    fixed = _late(scene, fixed_lines(scene, run), speed)
    if lag is not None and driven.order.size:
        known = dict(zip(driven.order.tolist(), driven.cause, strict=True))
        order, amplitude = lines_in_angle(driven.order, driven.amplitude, lag, speed_rpm=speed)
        cause = tuple(known.get(value, SIDEBAND) for value in order.tolist())
        driven = OrderLines(order=order, amplitude=amplitude, cause=cause)
    return OrderLines(
        order=np.concatenate([driven.order, fixed.order]),
        amplitude=np.concatenate([driven.amplitude, fixed.amplitude], axis=1),
        cause=(*driven.cause, *fixed.cause),
    )


def _late(scene: Scene, lines: OrderLines, speed_rpm: float) -> OrderLines:
    """``lines`` of the mean rotation at ``speed_rpm`` as channels with a delay have them."""
    delay_rev = scene.by_channel(scene.acquisition.delay_s) * speed_rpm / 60
    return replace(lines, amplitude=lines.amplitude * np.exp(-2j * np.pi * np.outer(delay_rev, lines.order)))


def _masses(scene: Scene) -> list[_Force]:
    """Inertia forces of the engine's masses, with their moments where the scene asks for these."""
    if scene.engine_forces is None:
        return []
    top, at_rpm = scene.highest_engine_order, 1000.0
    acts = np.zeros((len(AXES), top + 1), dtype=np.complex128)
    acts[:3] = crankcase_forces(scene.engine, at_rpm, max_order=top)
    if scene.engine_forces.moments:
        acts[3:] = crankcase_moments(scene.engine, at_rpm, max_order=top)
    cause = "rotating" if scene.engine.largest_piston_kg == 0 else "reciprocating"
    about: dict[str, Any] = {"cause": cause, "at_speed_rpm": at_rpm}
    forces = [_Force(float(k), acts[:, k], **about, inertia=True) for k in range(1, top + 1) if acts[:, k].any()]
    accelerates = any((scene.speed_profile, scene.speed_wander, scene.in_cycle_speed))
    if scene.engine_forces.moments and accelerates:
        rolls = _acceleration_moment(scene, top) * (at_rpm * np.pi / 30) ** 2
        rolling = [k for k in range(top + 1) if rolls[:, k].any()]
        forces += [_Force(float(k), rolls[:, k], **about, acceleration=True) for k in rolling]
    return forces


def _acceleration_moment(scene: Scene, top: int) -> Complexes:
    """Rolling moment per angular acceleration (kg·m²) that inertia lines lack, by axis and order 0 … ``top``.

    The masses' torque on the crank is −(½ I′ω² + I α), I(φ) their inertia about it, and rolls the crankcase the other
    way. Inertia lines, right for what moves in proportion to ω, make ½ I α of it, without the mean: this is the rest.
    Source: energy, T = −d/dt (½ I ω²) / ω, as for :func:`crankorder.engine.forces.inertia_torque_by_order`.
    """
    engine, angle_rev = scene.engine, np.arange(ANGLES) / ANGLES
    moment = np.zeros((len(AXES), top + 1), dtype=np.complex128)
    for single in engine.each:
        inertia = single.reciprocating_mass_kg * piston_velocity(angle_rev, single.mechanism) ** 2
        inertia += two_masses(single).missing_inertia_kg_m2 * rod_angle(angle_rev, single.mechanism)[1] ** 2
        lead_rev = (single.cylinders[0].crank_deg - single.cylinders[0].bank_deg) / 360
        sine, cosine = sine_cosine(lead_rev * np.arange(top + 1))
        # half of the lines' peaks, and the whole of the mean
        moment[AXES.index("RY")] += np.fft.rfft(inertia)[: top + 1] / ANGLES * (cosine + 1j * sine)
    return moment


def _gas(scene: Scene) -> list[_Force]:
    """The crankcase's reaction to the gas torque, by half orders in a four-stroke engine."""
    if scene.gas_torque is None:
        return []
    highest = scene.gas_torque.highest_order
    order, torque = gas_torque_by_order(scene.engine, int(np.ceil(highest)))
    lines = [(float(value), _along("RY", -size)) for value, size in zip(order, torque, strict=True)]
    return [_Force(*line, "combustion", exponent=0.0, gas=True) for line in lines if 0 < line[0] <= highest]


def _injected(scene: Scene, shaft: str | None, ratio: float) -> list[_Force]:
    """Injected orders of one shaft, as orders of the shaft that turns ``ratio`` times slower."""
    forces = []
    for injected in scene.injected_orders:
        if injected.shaft == shaft:
            acts = _along(injected.direction, injected.force_n * np.exp(1j * np.radians(injected.phase_deg)))
            at_rpm = injected.at_speed_rpm / ratio
            cause, exponent = injected.cause, injected.speed_exponent
            forces.append(_Force(injected.order * ratio, acts, cause, at_speed_rpm=at_rpm, exponent=exponent))
    return forces


def _along(axis: Axis, size: complex) -> Complexes:
    acts = np.zeros(len(AXES), dtype=np.complex128)
    acts[AXES.index(axis)] = size
    return acts


def _stacked(forces: list[_Force]) -> ForceLines:
    """The lines of all ``forces`` as one set of arrays."""
    numbers, marks = ("order", "at_speed_rpm", "exponent"), ("inertia", "gas", "acceleration")
    kinds = dict.fromkeys(numbers, float) | dict.fromkeys(marks, bool)
    columns = {key: np.array([getattr(force, key) for force in forces], dtype=kind) for key, kind in kinds.items()}
    amplitude = np.array([force.amplitude for force in forces], dtype=np.complex128).reshape(-1, len(AXES)).T
    return ForceLines(**columns, amplitude=amplitude, cause=tuple(force.cause for force in forces))
