"""The truth of a scene: what was put in, in the words of the findings."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from crankorder.engine.forces import crankcase_forces
from crankorder.engine.machine_parts import bearing_orders
from crankorder.engine.slider_crank import acceleration_harmonics
from crankorder.quantities import Truth
from crankorder.records import Json
from crankorder.synth.lines import crank_forces, fixed_lines, order_lines, slipping_line, strikes_per_rev
from crankorder.synth.noise import floor_density
from crankorder.synth.parts import BearingImpacts, BearingLine
from crankorder.synth.scene import Run, Scene

UNIT = "m/s2"
VISIBLE_DB = 14.0
"""A line is said to show where it stands this far above the floor of a spectrum over the whole recording: noise alone
reaches 11.4 dB with a chance of 1e-6, and a line at 14 dB is above that 95 times in a hundred."""
LEAST_SHARE = 1e-9
"""Of the largest line: what is below is in the recordings but not worth a record."""
SWEEP_PARTS = 40
"""A line of a speed profile is said to show if it would in so large a part of the recording at one speed."""
N_SPEEDS = 241
"""Steady speeds at which the lines of a speed profile are told."""
PROMINENT_DB = 6.0
"""A mode is said to show in a channel where it lifts the floor at its natural frequency by this much."""


def truth_of(scene: Scene, repeat: int = 0) -> Truth:
    """Everything that ``scene`` puts into its recordings: order lines, modes, crossings, bearings, balance.

    Amplitudes are peaks, phases count from top dead centre (``phase_ambiguity_deg`` tells by how much a half order's
    phase shifts when the other of the two dead centres is taken). ``floor_density`` is the one-sided amplitude density
    of the noise at the line, unit/√Hz; ``speed_range_rpm`` the speeds at which the line shows (``VISIBLE_DB``). For a
    speed profile the lines are those of steady speeds between its lowest and highest. ``repeat``: which one, from 0.
    What was made faulty is not here yet: ``quality`` is known when the recordings are made.
    """
    runs = scene.runs_of(repeat)
    return Truth(
        {
            "schema_version": 1,
            "test": name_of_test(scene, repeat),
            "scene": {"engine": scene.engine_file, "seed": scene.seed},
            "recordings": [_recording(scene, run) for run in runs],
            "channels": [{"name": name, "unit": UNIT} for name in scene.channel_names],
            "orders": _orders(scene, runs),
            "modes": _modes(scene),
            "crossings": _crossings(scene, runs[0]),
            "bearings": _bearings(scene, repeat),
            "lines": _lines(scene),
            "balance": _balance(scene),
            "acquisition": scene.acquisition.model_dump(exclude_defaults=True),
            "encoder": scene.encoder.model_dump(exclude_defaults=True) if scene.encoder is not None else None,
            "wrong_labels": scene.wrong_labels.model_dump(exclude_defaults=True) if scene.wrong_labels else None,
            "quality": [],
        }
    )


def name_of_test(scene: Scene, repeat: int) -> str:
    """Name of the test of one ``repeat`` of ``scene``."""
    return scene.title if scene.repeats == 1 else f"{scene.title}, run {repeat + 1}"


def _recording(scene: Scene, run: Run) -> dict[str, Json]:
    """Name and speed of a recording; of a profile its corners too."""
    record: dict[str, Json] = {"name": f"{run.name}.h5"}
    if scene.speed_profile is None:
        return record | {"speed_rpm": run.speed_rpm}
    corners = scene.speed_profile.corners
    return record | {"time_s": [time_s for time_s, _ in corners], "speed_rpm": [rpm for _, rpm in corners]}


def _steady_speeds(scene: Scene, runs: tuple[Run, ...]) -> list[tuple[Run, float]]:
    """Every recording with its speed; for a speed profile ``N_SPEEDS`` from its lowest to its highest.

    Of a shaft that turns both ways they are the speeds from 0 up, as if it turned forwards.
    """
    if scene.speed_profile is None:
        return [(run, run.speed_rpm) for run in runs]
    low, high = scene.speed_range_rpm
    if low < 0 < high:
        low, high = 0.0, max(-low, high)
    return [(runs[0], float(speed)) for speed in np.linspace(low, high, N_SPEEDS) if speed != 0]


def _orders(scene: Scene, runs: tuple[Run, ...]) -> list[dict[str, Json]]:
    steady = _steady_speeds(scene, runs)
    if not steady:
        return []
    forces = crank_forces(scene)
    lines = [order_lines(scene, run, speed_rpm, forces=forces) for run, speed_rpm in steady]
    speed = np.array([speed_rpm for _, speed_rpm in steady])
    rate_hz = np.array([scene.rate_hz(rpm) for rpm in speed])
    duration_s = scene.n_samples / rate_hz / (1 if scene.speed_profile is None else SWEEP_PARTS)
    records: list[dict[str, Json]] = []
    least = LEAST_SHARE * max(np.abs(part.amplitude).max(initial=0.0) for part in lines)
    orders = np.unique(np.concatenate([part.order for part in lines]))
    amplitudes = np.zeros((len(lines), orders.size, len(scene.channels)), dtype=np.complex128)
    for at_speed, part in zip(amplitudes, lines, strict=True):
        np.add.at(at_speed, np.searchsorted(orders, part.order), part.amplitude.T)
    at = zip(np.abs(speed) / 60, rate_hz, strict=True)
    floors = np.array([floor_density(scene, orders * turns_hz, scene.structure, rate) for turns_hz, rate in at])
    for order, amplitude, floor in zip(orders, amplitudes.transpose(1, 2, 0), floors.transpose(2, 1, 0), strict=True):
        with np.errstate(divide="ignore", invalid="ignore"):
            above_floor_db = 10 * np.log10(np.abs(amplitude) ** 2 * duration_s / (2 * floor**2))
        for channel, name in enumerate(scene.channel_names):
            size = np.abs(amplitude[channel])
            if order == 0 or size.max() <= least:
                continue
            peak, shows = int(size.argmax()), above_floor_db[channel] >= VISIBLE_DB
            alike = np.flatnonzero(lines[peak].order == order)
            cause = lines[peak].cause[alike[np.abs(lines[peak].amplitude[channel, alike]).argmax()]]
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
                    "explained_by": cause,
                    "speed_rpm": speed.tolist(),
                    "amplitude_by_speed": size.tolist(),
                    "phase_deg_by_speed": np.degrees(np.angle(amplitude[channel])).tolist(),
                    "floor_density_by_speed": floor[channel].tolist(),
                }
            )
    return records


def _modes(scene: Scene) -> list[dict[str, Json]]:
    structure = scene.structure
    records: list[dict[str, Json]] = []
    for j, mode in enumerate(scene.modes):
        rest = np.arange(len(scene.modes)) != j
        by_mode = ("frequency_hz", "damping_ratio", "sensor_per_kg", "drive")
        without = replace(structure, **{name: getattr(structure, name)[rest] for name in by_mode})
        at = np.array([mode.frequency_hz])
        rate_hz = scene.rate_hz(scene.speed_range_rpm[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            alone = floor_density(scene, at, without, rate_hz)
            lift_db = 20 * np.log10(floor_density(scene, at, structure, rate_hz) / alone)[:, 0]
        shows = [name for name, lift in zip(scene.channel_names, lift_db, strict=True) if lift >= PROMINENT_DB]
        about = {"frequency_hz": mode.frequency_hz, "damping_ratio": mode.damping_ratio}
        records.append({**about, "channels": shows, "explained_by": "mode"})
    return records


def _crossings(scene: Scene, run: Run) -> list[dict[str, Json]]:
    """Every meeting of an order with a mode; excited where a force of that order drives the mode."""
    slowest, fastest = scene.speed_range_rpm
    forces, bearing_lines = crank_forces(scene), fixed_lines(scene, run)
    acting = forces.at_speed(max(abs(fastest), 1.0))
    drives = np.abs(scene.structure.drive @ acting)
    driven = drives > LEAST_SHARE * drives.max(initial=0.0)
    orders = {*forces.order[acting.any(axis=0)].tolist(), *bearing_lines.order.tolist()}
    return [
        {
            "order": order,
            "mode_hz": mode.frequency_hz,
            "rpm": 60 * mode.frequency_hz / order,
            "in_range": slowest <= 60 * mode.frequency_hz / order <= fastest,
            "excited": bool(driven[number, forces.order == order].any()),
        }
        for order, (number, mode) in product(sorted(orders), enumerate(scene.modes))
    ]


def _bearings(scene: Scene, repeat: int) -> list[dict[str, Json]]:
    orders = {bearing.name: bearing_orders(bearing) for bearing in scene.engine.bearings}
    records: list[dict[str, Json]] = []
    parts: tuple[BearingLine | BearingImpacts, ...] = (*scene.bearing_lines, *scene.bearing_impacts)
    for line in parts:
        strikes = isinstance(line, BearingImpacts)
        known = orders[line.bearing]
        expected = strikes_per_rev(known, line.line) if strikes else known[line.line]
        by_channel = line.peak_m_s2 if isinstance(line, BearingImpacts) else line.amplitude_m_s2
        grown = {name: value * line.growth**repeat for name, value in by_channel.items()}
        records.append(
            {
                "name": line.bearing,
                "line": line.line,
                "order": slipping_line(expected, slip_percent=line.slip_percent),
                "order_expected": expected,
                "amplitude": max(grown.values(), default=0.0),
                "amplitude_by_channel": grown,
                "unit": UNIT,
                "verdict": "strikes" if strikes else "slips" if line.slip_percent else "locked",
                "resonance_hz": line.resonance_hz if isinstance(line, BearingImpacts) else None,
            }
        )
    return records


def _lines(scene: Scene) -> list[dict[str, Json]]:
    """Lines that follow no crank: tones, and orders of shafts with a speed of their own."""
    records: list[dict[str, Json]] = [
        {
            "channel": name,
            "frequency_hz": number * tone.frequency_hz,
            "explained_by": tone.cause,
            "amplitude": share * amplitude,
        }
        for tone in scene.tones
        for number, share in enumerate(tone.harmonics, start=1)
        for name, amplitude in tone.amplitude_m_s2.items()
        if share * amplitude
    ]
    for shaft in scene.other_shafts:
        orders = [injected.order for injected in scene.injected_orders if injected.shaft == shaft.name]
        if shaft.rpm is not None:
            for order in orders:
                hertz = [order * rpm / 60 for rpm in shaft.rpm]
                records.append({"shaft": shaft.name, "order_of_shaft": order, "frequency_hz": hertz})
    return records


def _balance(scene: Scene) -> dict[str, Json] | None:
    """What shakes at the first order; None where the scene has no engine forces."""
    if scene.engine_forces is None:
        return None
    engine = scene.engine
    omega_squared = (1000 * np.pi / 30) ** 2
    first = crankcase_forces(engine, 1000.0, max_order=1)[:, 1] / omega_squared
    per_kg = engine.crank_radius_m * np.abs(acceleration_harmonics(engine.mechanism, 1)[1])
    rotating = 1j * first[0]  # what turns with the crank makes as much across as along, a quarter turn apart
    reciprocating = first[2] - rotating
    return {
        "residual_reciprocating_g": 1e3 * float(np.abs(reciprocating) / per_kg),
        "residual_rotating_gmm": 1e6 * float(np.abs(rotating)),
        "angle_deg": float(np.degrees(np.angle(rotating))) if rotating else 0.0,
        "crank_radius_m": engine.crank_radius_m,
    }
