"""The order lines of a scene: the forces at multiples of a shaft's angle, and what they become in each channel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from crankorder.engine.bearings import bearing_orders
from crankorder.engine.forces import crankcase_forces, crankcase_moments
from crankorder.engine.gas import gas_torque_by_order
from crankorder.engine.in_cycle import Lag
from crankorder.engine.rod import two_masses
from crankorder.engine.slider_crank import piston_velocity, rod_angle, sine_cosine
from crankorder.synth.crank import crank_motion
from crankorder.synth.cycle import lines_in_angle, lines_in_time
from crankorder.synth.impacts import slipping_line
from crankorder.synth.noise import seed_stream
from crankorder.synth.order_forces import ForceLines
from crankorder.synth.parts import AXES, OtherShaft
from crankorder.synth.response import accelerance
from crankorder.synth.scene import Run, Scene

Complex = NDArray[np.complex128]
ANGLES = 1 << 14
"""Of a revolution, at which the inertia of the masses about the crank is looked at: as many as for a gas torque."""
SIDEBAND = "in-cycle speed"
"""Cause of a line that no force has: the shaft's uneven turning makes it of those that have one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OrderLines:
    """Lines amplitude · exp(2πi order rev), rev from firing top dead centre.

    ``order`` (line); ``amplitude`` complex peak (channel, line), m/s²; ``cause`` (line): what made each.
    """

    order: NDArray[np.float64]
    amplitude: Complex
    cause: tuple[str, ...]


@dataclass(frozen=True)
class _Force:
    """One line of a force: complex peak by axis (6,) at a speed, how it grows with speed, and what it is."""

    order: float
    amplitude: Complex
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
    amplitude = np.zeros((len(scene.channels), 0), dtype=np.complex128)
    if order.size:
        response = accelerance(scene.structure, order * speed_rpm / 60)
        if scene.filter is not None:
            response = response * scene.filter.response(order * speed_rpm / 60)
        amplitude = np.einsum("cal,al->cl", response, force)
    return OrderLines(order=order, amplitude=amplitude, cause=cause)


def _leading_causes(scene: Scene, forces: ForceLines, speed_rpm: float) -> dict[float, str]:
    """What makes most of each order of ``forces``, by its response alone in the channel where that is largest."""
    response = accelerance(scene.structure, forces.order * speed_rpm / 60)
    alone = np.abs(np.einsum("cal,al->cl", response, forces.at_speed(speed_rpm))).max(axis=0, initial=0.0)
    by_size = np.argsort(alone, kind="stable")
    return {float(forces.order[place]): forces.cause[place] for place in by_size}


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
        driven = OrderLines(
            order=order, amplitude=amplitude, cause=tuple(known.get(value, SIDEBAND) for value in order.tolist())
        )
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
    cause = "rotating" if scene.engine.reciprocating_mass_kg == 0 else "reciprocating"
    forces = [
        _Force(float(k), acts[:, k], cause, at_speed_rpm=at_rpm, inertia=True)
        for k in range(1, top + 1)
        if acts[:, k].any()
    ]
    if scene.engine_forces.moments and _accelerates(scene):
        rolls = _acceleration_moment(scene, top) * (at_rpm * np.pi / 30) ** 2
        forces += [
            _Force(float(k), rolls[:, k], cause, at_speed_rpm=at_rpm, acceleration=True)
            for k in range(top + 1)
            if rolls[:, k].any()
        ]
    return forces


def _accelerates(scene: Scene) -> bool:
    """Whether the crank ever has an angular acceleration."""
    return any((scene.speed_profile, scene.speed_wobbles, scene.speed_wander, scene.in_cycle_speed))


def _acceleration_moment(scene: Scene, top: int) -> Complex:
    """Rolling moment per angular acceleration (kg·m²) that inertia lines lack, by axis and order 0 … ``top``.

    The masses' torque on the crank is −(½ I′ω² + I α), I(φ) their inertia about it, and rolls the crankcase the other
    way. Inertia lines, right for what moves in proportion to ω, make ½ I α of it, without the mean: this is the rest.
    Source: energy, T = −d/dt (½ I ω²) / ω, as for :func:`crankorder.engine.forces.inertia_torque_by_order`.
    """
    engine, angle_rev = scene.engine, np.arange(ANGLES) / ANGLES
    inertia = engine.reciprocating_mass_kg * piston_velocity(angle_rev, engine.mechanism) ** 2
    inertia += two_masses(engine).missing_inertia_kg_m2 * rod_angle(angle_rev, engine.mechanism)[1] ** 2
    lead_rev = np.array([(cylinder.crank_deg - cylinder.bank_deg) / 360 for cylinder in engine.cylinders])
    sine, cosine = sine_cosine(lead_rev[:, None] * np.arange(top + 1))
    moment = np.zeros((len(AXES), top + 1), dtype=np.complex128)
    # half of the lines' peaks, and the whole of the mean
    moment[AXES.index("RY")] = np.fft.rfft(inertia)[: top + 1] / ANGLES * (cosine + 1j * sine).sum(axis=0)
    return moment


def _gas(scene: Scene) -> list[_Force]:
    """The crankcase's reaction to the gas torque, by half orders in a four-stroke engine."""
    if scene.gas_torque is None:
        return []
    highest = scene.gas_torque.highest_order
    order, torque = gas_torque_by_order(scene.engine, int(np.ceil(highest)))
    forces = []
    for value, size in zip(order, torque, strict=True):
        if 0 < value <= highest:
            acts = np.zeros(len(AXES), dtype=np.complex128)
            acts[AXES.index("RY")] = -size
            forces.append(_Force(float(value), acts, "combustion", exponent=0.0, gas=True))
    return forces


def _injected(scene: Scene, shaft: str | None, ratio: float) -> list[_Force]:
    """Injected orders of one shaft, as orders of the shaft that turns ``ratio`` times slower."""
    forces = []
    for injected in scene.injected_orders:
        if injected.shaft == shaft:
            acts = np.zeros(len(AXES), dtype=np.complex128)
            acts[AXES.index(injected.direction)] = injected.force_n * np.exp(1j * np.radians(injected.phase_deg))
            at_rpm = injected.at_speed_rpm / ratio
            cause, exponent = injected.cause, injected.speed_exponent
            forces.append(_Force(injected.order * ratio, acts, cause, at_speed_rpm=at_rpm, exponent=exponent))
    return forces


def _stacked(forces: list[_Force]) -> ForceLines:
    return ForceLines(
        order=np.array([force.order for force in forces]),
        amplitude=np.array([force.amplitude for force in forces], dtype=np.complex128).reshape(-1, len(AXES)).T,
        at_speed_rpm=np.array([force.at_speed_rpm for force in forces]),
        exponent=np.array([force.exponent for force in forces]),
        inertia=np.array([force.inertia for force in forces], dtype=bool),
        gas=np.array([force.gas for force in forces], dtype=bool),
        acceleration=np.array([force.acceleration for force in forces], dtype=bool),
        cause=tuple(force.cause for force in forces),
    )
