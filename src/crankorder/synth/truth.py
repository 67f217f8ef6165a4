"""The truth of a scene: what was put in, in the words of the findings."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crankorder.engine.bearings import bearing_orders
from crankorder.engine.forces import DIRECTIONS
from crankorder.quantities import Truth
from crankorder.synth.lines import OrderLines, order_lines
from crankorder.synth.recording import broadband_roll_off
from crankorder.synth.response import Structure, accelerance
from crankorder.synth.scene import Scene

UNIT = "m/s2"
VISIBLE_DB = 14.0
"""A line is said to show where it stands this far above the floor of a spectrum over the whole recording: noise alone
reaches 11.4 dB with a chance of 1e-6, and a line at 14 dB is above that 95 times in a hundred."""
PROMINENT_DB = 6.0
"""A mode is said to show in a channel where it lifts the floor at its natural frequency by this much."""


def truth_of(scene: Scene) -> Truth:
    """Everything that ``scene`` puts into its recordings: order lines, modes, crossings, bearings, balance.

    Amplitudes are peaks, phases count from top dead centre (``phase_ambiguity_deg`` tells by how much a half order's
    phase shifts when the other of the two dead centres is taken). ``floor_density`` is the one-sided amplitude density
    of the noise at the line, unit/√Hz; ``speed_range_rpm`` the speeds at which the line shows (``VISIBLE_DB``).
    """
    lines = [order_lines(scene, run) for run in scene.runs]
    return Truth(
        {
            "schema_version": 1,
            "test": scene.title,
            "scene": {"engine": scene.engine_file, "seed": scene.seed},
            "recordings": [{"name": f"{run.name}.h5", "speed_rpm": run.speed_rpm} for run in scene.runs],
            "channels": [{"name": name, "unit": UNIT} for name in scene.channel_names],
            "orders": _orders(scene, lines),
            "modes": _modes(scene),
            "crossings": _crossings(scene, lines),
            "bearings": _bearings(scene),
            "balance": _balance(scene),
            "quality": [],
        }
    )


def floor_density(scene: Scene, frequency_hz: NDArray[np.float64], structure: Structure) -> NDArray[np.float64]:
    """One-sided amplitude density (m/s²/√Hz) of all noise of ``scene``, shape (channel, frequency).

    ``frequency_hz``: shape (frequency,). ``structure``: the scene's own, or one that lacks a mode.
    """
    sensor = scene.sensor_noise.m_s2_per_root_hz if scene.sensor_noise else {}
    force = scene.broadband.force_n_per_root_hz if scene.broadband else {}
    driven = np.array([force.get(axis, 0.0) for axis in DIRECTIONS])
    power = np.einsum("cdf,d->cf", np.abs(accelerance(structure, frequency_hz)) ** 2, driven**2)
    power = power * broadband_roll_off(scene, frequency_hz) ** 2 + scene.by_channel(sensor)[:, None] ** 2
    density: NDArray[np.float64] = np.sqrt(power)
    return density


def _orders(scene: Scene, lines: list[OrderLines]) -> list[dict[str, Any]]:
    speed = np.array([run.speed_rpm for run in scene.runs])
    duration_s = scene.n_samples / np.array([scene.rate_hz(rpm) for rpm in speed])
    records = []
    for order in np.unique(np.concatenate([part.order for part in lines])):
        amplitude = np.array([part.amplitude[:, part.order == order].sum(axis=1) for part in lines]).T
        floor = floor_density(scene, order * speed / 60, scene.structure)
        with np.errstate(divide="ignore"):
            above_floor_db = 10 * np.log10(np.abs(amplitude) ** 2 * duration_s / (2 * floor**2))
        for channel, name in enumerate(scene.channel_names):
            size = np.abs(amplitude[channel])
            if not size.any():
                continue
            peak, shows = int(size.argmax()), above_floor_db[channel] >= VISIBLE_DB
            records.append(
                {
                    "channel": name,
                    "order": float(order),
                    "amplitude": float(size[peak]),
                    "phase_deg": float(np.degrees(np.angle(amplitude[channel, peak]))),
                    "phase_ambiguity_deg": float(360 * order % 360),
                    "unit": UNIT,
                    "speed_rpm_at_max": float(speed[peak]),
                    "speed_range_rpm": [float(speed[shows].min()), float(speed[shows].max())] if shows.any() else None,
                    "explained_by": _strongest_cause(lines[peak], order, channel),
                    "speed_rpm": speed.tolist(),
                    "amplitude_by_speed": size.tolist(),
                    "phase_deg_by_speed": np.degrees(np.angle(amplitude[channel])).tolist(),
                    "floor_density_by_speed": floor[channel].tolist(),
                }
            )
    return records


def _strongest_cause(lines: OrderLines, order: float, channel: int) -> str:
    made_here = np.flatnonzero(lines.order == order)
    strongest = int(np.abs(lines.amplitude[channel, made_here]).argmax())
    return lines.cause[int(made_here[strongest])]


def _modes(scene: Scene) -> list[dict[str, Any]]:
    structure = scene.structure
    records = []
    for j, mode in enumerate(scene.modes):
        rest = np.arange(len(scene.modes)) != j
        without = Structure(
            frequency_hz=structure.frequency_hz[rest],
            damping_ratio=structure.damping_ratio[rest],
            sensor_per_kg=structure.sensor_per_kg[rest],
            drive=structure.drive[rest],
            rigid_body_per_kg=structure.rigid_body_per_kg,
        )
        at = np.array([mode.frequency_hz])
        with np.errstate(divide="ignore", invalid="ignore"):
            lift_db = 20 * np.log10(floor_density(scene, at, structure) / floor_density(scene, at, without))[:, 0]
        shows = [name for name, lift in zip(scene.channel_names, lift_db, strict=True) if lift >= PROMINENT_DB]
        records.append(
            {
                "frequency_hz": mode.frequency_hz,
                "damping_ratio": mode.damping_ratio,
                "channels": shows,
                "explained_by": "mode",
            }
        )
    return records


def _crossings(scene: Scene, lines: list[OrderLines]) -> list[dict[str, Any]]:
    """Every meeting of an order with a mode; excited where a force of that order drives the mode."""
    slowest, fastest = min(scene.speeds.rpm), max(scene.speeds.rpm)
    forced = {
        float(order)
        for part in lines[:1]
        for order, cause in zip(part.order, part.cause, strict=True)
        if not cause.startswith("bearing")
    }
    orders = sorted({float(order) for part in lines[:1] for order in part.order})
    return [
        {
            "order": order,
            "mode_hz": mode.frequency_hz,
            "rpm": 60 * mode.frequency_hz / order,
            "in_range": slowest <= 60 * mode.frequency_hz / order <= fastest,
            "excited": order in forced,
        }
        for order, mode in product(orders, scene.modes)
    ]


def _bearings(scene: Scene) -> list[dict[str, Any]]:
    orders = {bearing.name: bearing_orders(bearing) for bearing in scene.engine.bearings}
    return [
        {
            "name": line.bearing,
            "line": line.line,
            "order": orders[line.bearing][line.line],
            "amplitude": max(line.amplitude_m_s2.values(), default=0.0),
            "amplitude_by_channel": line.amplitude_m_s2,
            "unit": UNIT,
            "verdict": "locked",
        }
        for line in scene.bearing_lines
    ]


def _balance(scene: Scene) -> dict[str, Any] | None:
    """What shakes at the first order; None where the scene has no engine forces."""
    if scene.engine_forces is None:
        return None
    engine = scene.engine
    mass_kg = engine.shafts.unbalanced_mass_kg if 1 in engine.shafts.orders else engine.reciprocating_mass_kg
    return {
        "residual_reciprocating_g": 1e3 * mass_kg,
        "residual_rotating_gmm": 1e6 * engine.rotating_unbalance_kg_m,
        "angle_deg": engine.rotating_unbalance_deg,
        "crank_radius_m": engine.crank_radius_m,
    }
