"""How the crank and the other shafts of a scene turn in one recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from crankorder.engine.torsional_fluctuation import Lag, lag_from_torque, lag_of_speed
from crankorder.errors import RequestError
from crankorder.quantities import Floats, Ints
from crankorder.synth.motion import Motion, wander_wobbles
from crankorder.synth.noise import seed_stream
from crankorder.synth.parts import OtherShaft, SpeedOrder, TimeSampling
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


def begun_earlier(motion: Motion, seconds: float) -> Motion:
    """The same ``motion`` on a clock that starts ``seconds`` before the first sample, or after it where negative."""
    if seconds == 0:
        return motion
    corners = tuple((time_s + seconds, rpm) for time_s, rpm in motion.corners)
    wobbles = tuple((hz, rpm, phase - 360 * hz * seconds) for hz, rpm, phase in motion.wobbles)
    return replace(motion, start_rev=float(motion.at(np.array([-seconds]))[0][0]), corners=corners, wobbles=wobbles)


def gain_of_cycle(scene: Scene, run: Run) -> Callable[[Ints], Floats] | None:
    """Factor of the gas torque in every cycle, by the cycle's number, or None where all cycles of ``run`` are alike.

    ``scene``: its scatter and seed. A cycle's factor does not depend on which others are asked for.
    """
    if scene.gas_torque is None or not scene.gas_torque.scatter_percent:
        return None
    scatter = scene.gas_torque.scatter_percent / 100

    def gain(cycle: Ints) -> Floats:
        drawn = np.zeros(cycle.size)
        for way, side in (("after", cycle >= 0), ("before", cycle < 0)):
            if side.any():
                number = np.where(cycle[side] >= 0, cycle[side], -1 - cycle[side])
                stream = seed_stream(scene.seed, "gas_torque", run.stream, way)
                drawn[side] = stream.standard_normal(int(number.max()) + 1)[number]
        return np.maximum(1 + scatter * drawn, 0.0)

    return gain
