"""The order lines of a scene: what each deterministic effect adds to each channel at one speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.engine.bearings import bearing_orders
from crankorder.engine.forces import DIRECTIONS, crankcase_forces
from crankorder.synth.noise import seed_stream
from crankorder.synth.response import accelerance
from crankorder.synth.scene import Run, Scene


@dataclass(frozen=True, kw_only=True, eq=False)
class OrderLines:
    """Lines amplitude · exp(2πi order rev), rev from firing top dead centre.

    ``order`` (line); ``amplitude`` complex peak (channel, line), m/s²; ``cause`` (line): what made each.
    """

    order: NDArray[np.float64]
    amplitude: NDArray[np.complex128]
    cause: tuple[str, ...]


def order_lines(scene: Scene, run: Run) -> OrderLines:
    """All order lines of one recording: exact steady states of the structure under the forces, and bearing lines.

    ``scene``: engine, structure and effects. ``run``: the recording, for its speed and its seed streams. A line that
    two effects make is there twice; the lines add up.
    """
    forces: list[tuple[float, NDArray[np.complex128], str]] = []
    if scene.engine_forces is not None:
        by_order = crankcase_forces(scene.engine, run.speed_rpm, max_order=scene.highest_engine_order)
        cause = "rotating" if scene.engine.reciprocating_mass_kg == 0 else "reciprocating"
        forces += [(float(k), by_order[:, k], cause) for k in range(1, by_order.shape[1]) if by_order[:, k].any()]
    for injected in scene.injected_orders:
        size = injected.force_n * (run.speed_rpm / injected.at_speed_rpm) ** injected.speed_exponent
        force = np.zeros(3, dtype=np.complex128)
        force[DIRECTIONS.index(injected.direction)] = size * np.exp(1j * np.radians(injected.phase_deg))
        forces.append((injected.order, force, injected.cause))

    order = np.array([line[0] for line in forces])
    amplitude = np.zeros((len(scene.channels), 0), dtype=np.complex128)
    if forces:
        response = accelerance(scene.structure, order * run.speed_rpm / 60)
        amplitude = np.einsum("cdl,ld->cl", response, np.array([line[1] for line in forces]))
    bearing_order, bearing_amplitude, bearing_cause = _bearing_lines(scene, run)
    return OrderLines(
        order=np.concatenate([order, bearing_order]),
        amplitude=np.concatenate([amplitude, bearing_amplitude], axis=1),
        cause=(*(line[2] for line in forces), *bearing_cause),
    )


def _bearing_lines(scene: Scene, run: Run) -> tuple[NDArray[np.float64], NDArray[np.complex128], tuple[str, ...]]:
    orders = {bearing.name: bearing_orders(bearing) for bearing in scene.engine.bearings}
    order = np.array([orders[line.bearing][line.line] for line in scene.bearing_lines])
    amplitude = np.zeros((len(scene.channels), order.size), dtype=np.complex128)
    for k, line in enumerate(scene.bearing_lines):
        phase_rev = seed_stream(scene.seed, "bearing_lines", str(k), run.name).random()
        amplitude[:, k] = scene.by_channel(line.amplitude_m_s2) * np.exp(2j * np.pi * phase_rev)
    return order, amplitude, tuple(f"bearing {line.line}" for line in scene.bearing_lines)
