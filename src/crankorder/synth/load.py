"""Scenes from TOML files, with everything that is wrong with one, or that it cannot have, listed at once."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from crankorder.engine.definition import load_engine
from crankorder.engine.forces import gas_torque_by_order
from crankorder.engine.machine_parts import bearing_orders
from crankorder.errors import CrankorderError, ManyErrors, RequestError
from crankorder.settings import shipped, toml_table, validation_fault
from crankorder.synth.driven import ENDLESS, MEMORY
from crankorder.synth.lines import crank_motion, other_motion, ringing_s, slipping_line
from crankorder.synth.parts import INDEX, TRACE, CrankAngleSampling, TimeSampling
from crankorder.synth.poles import analogue_filter, poles_of
from crankorder.synth.recording import impossible_faults
from crankorder.synth.scene import Scene

MAX_SAMPLES = 50_000_000
"""Of one channel of one recording: more would not fit into the memory of a small machine."""
MOST_EVENTS = 20_000_000
"""Pulses of an encoder, or strikes of a bearing, in one recording: some ten numbers each."""
MOST_PAST = 200_000_000
"""Samples before a recording from which a shaft that never turned evenly is followed: a minute of work."""
MOST_GROWTH = 9
RINGS_TOO_LONG = "it rings on too long after what came before the recording"
Fault = tuple[str, str, str, str]
"""Problem, place, found, allowed."""


def validation_errors(scene: Scene, source: str) -> list[RequestError]:
    """Every fault of ``scene`` that its parts alone do not show; ``source`` is the file's name for the messages."""
    faults = [*_names(scene), *_forces_without_structure(scene), *_converter(scene)]
    if (scene.speeds is None) == (scene.speed_profile is None):
        found = "neither" if scene.speeds is None else "both"
        faults.append(("how fast does it turn?", "speeds", found, "either speeds or speed_profile"))
    elif isinstance(scene.sampling, CrankAngleSampling) and scene.speed_profile is not None:
        faults += _by_crank_angle(scene)
    else:
        faults += [*_sampling(scene), *_by_crank_angle(scene), *_encoder(scene), *_orders(scene)]
        faults += [*_turning(scene), *_standstill(scene), *_past(scene), *_labels(scene)]
    return [
        RequestError(problem, file=source, place=place, found=found, allowed=allowed)
        for problem, place, found, allowed in faults
    ]


def _names(scene: Scene) -> Iterator[Fault]:
    channels, shafts = scene.channel_names, [shaft.name for shaft in scene.other_shafts]
    for whose, place, values in (
        ("two channels have the same name", "channels", channels),
        ("two channels have the same source", "channels", [channel.source for channel in scene.channels]),
        ("two shafts have the same name", "other_shafts", shafts),
    ):
        yield from ((whose, place, value, "each once") for value, times in Counter(values).items() if times > 1)
    for channel in scene.channels:
        if channel.source in (TRACE, INDEX):
            yield "the encoder's dataset cannot be a channel's", "channels", channel.source, "any other name"
    for place, names in _channel_uses(scene):
        for name in names:
            if name not in channels:
                yield "no such channel", place, name, ", ".join(channels)
    for k, injected in enumerate(scene.injected_orders):
        if injected.shaft is not None and injected.shaft not in shafts:
            yield "no such shaft", f"injected_orders.{k}.shaft", injected.shaft, ", ".join(shafts) or "none"
    recordings = [run.name for run in scene.runs] if scene.speeds or scene.speed_profile else []
    for head in ("encoder_faults", "signal_faults"):
        for k, fault in enumerate(getattr(scene, head)):
            for name in fault.recordings:
                if name not in recordings:
                    yield "no such recording", f"{head}.{k}.recordings", name, ", ".join(recordings[:20])
    yield from _bearing_names(scene)


def _channel_uses(scene: Scene) -> Iterator[tuple[str, Iterable[str]]]:
    yield "rigid_body_per_kg", scene.rigid_body_per_kg
    yield "acquisition.delay_s", scene.acquisition.delay_s
    if scene.sensor_noise:
        yield "sensor_noise.m_s2_per_root_hz", scene.sensor_noise.m_s2_per_root_hz
    if scene.wrong_labels:
        yield "wrong_labels.swapped", scene.wrong_labels.swapped or ()
    by_key = {
        "modes": ("sensor_per_kg", "sensor_phase_deg"),
        "bearing_lines": ("amplitude_m_s2",),
        "bearing_impacts": ("peak_m_s2",),
        "tones": ("amplitude_m_s2",),
        "coloured_noise": ("channels",),
        "signal_faults": ("channels",),
    }
    for head, keys in by_key.items():
        for k, part in enumerate(getattr(scene, head)):
            for key in keys:
                yield f"{head}.{k}.{key}", getattr(part, key)


def _bearing_names(scene: Scene) -> Iterator[Fault]:
    bearings = {bearing.name: bearing for bearing in scene.engine.bearings}
    for head in ("bearing_lines", "bearing_impacts"):
        for k, part in enumerate(getattr(scene, head)):
            if part.bearing not in bearings:
                known = ", ".join(bearings) or "none"
                yield "the engine has no such bearing", f"{head}.{k}.bearing", part.bearing, known
            elif part.line not in bearing_orders(bearings[part.bearing]):
                known = ", ".join(bearing_orders(bearings[part.bearing]))
                yield "the bearing's data do not tell this line", f"{head}.{k}.line", part.line, known


def _forces_without_structure(scene: Scene) -> Iterator[Fault]:
    if not (scene.modes or scene.rigid_body_per_kg):
        for place in ("engine_forces", "gas_torque", "injected_orders", "broadband"):
            if getattr(scene, place):
                yield "forces have nothing to act on", place, "no modes, no rigid_body_per_kg", "at least one of them"
    if scene.gas_torque is not None:
        if scene.engine.gas is None:
            yield "the engine has no gas", "gas_torque", scene.engine_file, "an engine with a table [gas]"
        else:
            yield from _told(partial(gas_torque_by_order, scene.engine, 1), "gas_torque")


def _told(attempt: Callable[[], object], place: str) -> Iterator[Fault]:
    """The fault that ``attempt()`` raises, if it does."""
    try:
        attempt()
    except CrankorderError as error:
        yield error.problem, place, error.found, error.allowed or error.remedy


def _converter(scene: Scene) -> Iterator[Fault]:
    yield from _told(partial(analogue_filter, scene.acquisition), "acquisition.ac_coupling_hz")
    if scene.acquisition.stored_as == "int16":
        for k, fault in enumerate(scene.signal_faults):
            if fault.kind == "not_a_number":
                yield "int16 has no NaN", f"signal_faults.{k}", "not_a_number", "stored_as float"


def _sampling(scene: Scene) -> Iterator[Fault]:
    if scene.n_samples > MAX_SAMPLES:
        yield "a recording is too long", "sampling", f"{scene.n_samples} samples", f"at most {MAX_SAMPLES}"
    slowest, fastest = scene.speed_range_rpm
    shortest_s = scene.n_samples / scene.rate_hz(fastest)
    yield from impossible_faults(scene.signal_faults, n_samples=scene.n_samples, duration_s=shortest_s)
    for name, delay_s in scene.acquisition.delay_s.items():
        if abs(delay_s) > shortest_s:
            found, allowed = f"{name} {delay_s:g} s", f"at most {shortest_s:g} s, the shortest recording"
            yield "a channel is later than the recording is long", "acquisition.delay_s", found, allowed
    for head in ("bearing_lines", "bearing_impacts"):
        for k, part in enumerate(getattr(scene, head)):
            if (scene.repeats - 1) * math.log10(part.growth) > MOST_GROWTH:
                allowed = f"1e{MOST_GROWTH} fold in all repeats"
                yield "it grows out of all proportion", f"{head}.{k}.growth", f"{part.growth:g}", allowed
    nyquist_hz = scene.rate_hz(slowest if scene.speeds else fastest) / 2
    below = f"below half the rate, {nyquist_hz:g} Hz"
    for k, mode in enumerate(scene.modes):
        if mode.frequency_hz >= nyquist_hz:
            yield "natural frequency above Nyquist", f"modes.{k}.frequency_hz", f"{mode.frequency_hz:g}", below
    for k, part in enumerate(scene.bearing_impacts):
        if part.resonance_hz >= nyquist_hz and scene.acquisition.low_pass_hz is None:
            place, found = f"bearing_impacts.{k}.resonance_hz", f"{part.resonance_hz:g}"
            yield "resonance above Nyquist", place, found, f"{below}, or a low_pass_hz"
    if scene.speed_wander is not None and scene.speed_wander.corner_hz >= nyquist_hz:
        found = f"{scene.speed_wander.corner_hz:g} Hz"
        yield "speed that changes above Nyquist", "speed_wander.corner_hz", found, below
    for k, tone in enumerate(scene.tones):
        highest = tone.frequency_hz * len(tone.harmonics)
        if highest >= nyquist_hz and not getattr(scene.sampling, "folds", False):
            yield "tone above Nyquist", f"tones.{k}", f"{highest:g} Hz", below


def _by_crank_angle(scene: Scene) -> Iterator[Fault]:
    """What samples by crank angle are not made of: they need a speed that is steady but for in-cycle motion."""
    if not isinstance(scene.sampling, CrankAngleSampling):
        return
    allowed = 'only with domain = "time"'
    if scene.encoder is not None:
        yield "samples by crank angle need no encoder", "encoder", "[encoder]", allowed
    for place in ("speed_profile", "speed_wander"):
        if getattr(scene, place):
            yield "samples by crank angle need a steady mean speed", place, f"[{place}]", allowed
    if any(shaft.time_s for shaft in scene.other_shafts):
        yield "samples by crank angle need shafts of steady speed", "other_shafts", "time_s", allowed
    if scene.gas_torque is not None and scene.gas_torque.scatter_percent:
        yield "samples by crank angle carry no cycle-to-cycle scatter", "gas_torque.scatter_percent", "> 0", allowed
    if scene.bearing_impacts and scene.in_cycle_speed:
        yield "strikes by crank angle need an even speed", "in_cycle_speed", "with bearing_impacts", allowed


def _encoder(scene: Scene) -> Iterator[Fault]:
    encoder = scene.encoder
    if encoder is None or not isinstance(scene.sampling, TimeSampling):
        if scene.encoder_faults:
            yield "there is no encoder to be at fault", "encoder_faults", "no [encoder]", "an [encoder]"
        return
    reached = scene.speeds.rpm if scene.speeds else tuple(abs(rpm) for rpm in scene.speed_range_rpm)
    fastest = 30 * scene.sampling.rate_hz / (encoder.pulses_per_rev * encoder.ratio)
    too_fast = [f"{speed:g}" for speed in reached if speed + _swing_rpm(scene) > fastest]
    if too_fast:
        allowed = f"at most {fastest:g} rpm with {encoder.pulses_per_rev} pulses per revolution at this rate"
        yield "speeds that the rate cannot carry", "speeds", f"{', '.join(too_fast)} rpm", allowed
    duration_s = scene.n_samples / scene.rate_hz(max(reached))
    n_pulses = (max(reached) + _swing_rpm(scene)) / 60 * encoder.ratio * encoder.pulses_per_rev * duration_s
    if n_pulses > MOST_EVENTS and scene.n_samples <= MAX_SAMPLES:
        yield "too many pulses for one recording", "encoder.pulses_per_rev", f"{n_pulses:g}", f"at most {MOST_EVENTS}"
    n_lines = encoder.pulses_per_rev - encoder.missing_teeth
    for k, fault in enumerate(scene.encoder_faults):
        for line in fault.lines if fault.kind == "damaged_line" else ():
            if line >= n_lines:
                yield "the wheel has no such line", f"encoder_faults.{k}.lines", str(line), f"0 to {n_lines - 1}"


def _swing_rpm(scene: Scene) -> float:
    """How much the wander adds to a speed at most: five of its standard deviations."""
    return 5 * scene.speed_wander.std_rpm if scene.speed_wander is not None else 0.0


def _orders(scene: Scene) -> Iterator[Fault]:
    if getattr(scene.sampling, "folds", False):
        return
    mean_rpm = max(abs(speed) for speed in scene.speed_range_rpm)
    fastest = mean_rpm + _swing_rpm(scene)
    if fastest == 0:
        return
    nyquist_order = scene.rate_hz(mean_rpm) / 2 * 60 / fastest
    beside_rpm = fastest if isinstance(scene.sampling, TimeSampling) else min(scene.speed_range_rpm)
    bearings = {bearing.name: bearing_orders(bearing) for bearing in scene.engine.bearings}
    ratio = {shaft.name: shaft.ratio or max(shaft.rpm or (0.0,)) / beside_rpm for shaft in scene.other_shafts}
    asked = [("engine_forces", float(scene.highest_engine_order))]
    asked += [("gas_torque", scene.gas_torque.highest_order)] if scene.gas_torque else []
    for k, injected in enumerate(scene.injected_orders):
        asked.append((f"injected_orders.{k}.order", injected.order * ratio.get(injected.shaft or "", 1.0)))
    for k, line in enumerate(scene.bearing_lines):
        order = bearings.get(line.bearing, {}).get(line.line, 0.0)
        asked.append((f"bearing_lines.{k}", slipping_line(order, slip_percent=line.slip_percent)))
    for place, order in asked:
        if order >= nyquist_order:
            yield "order above Nyquist", place, f"{order:g}", f"below {nyquist_order:g} at {fastest:g} rpm"


def _turning(scene: Scene) -> Iterator[Fault]:
    """What the shafts cannot do: stop within a cycle, or have two speeds at one sample."""
    place = "speed_profile" if scene.in_cycle_speed is None else "in_cycle_speed"
    by_speed = sorted(scene.runs, key=lambda run: run.speed_rpm)
    for run in by_speed[:1] if by_speed[0].speed_rpm == by_speed[-1].speed_rpm else (by_speed[0], by_speed[-1]):
        yield from _told(partial(crank_motion, scene, run), place)
    for k, shaft in enumerate(scene.other_shafts):
        if shaft.rpm is not None:
            yield from _told(partial(other_motion, scene, scene.runs[0], shaft), f"other_shafts.{k}.time_s")


def _standstill(scene: Scene) -> Iterator[Fault]:
    """Forces that fall with speed, where the shaft may come to a standstill."""
    slowest, fastest = scene.speed_range_rpm
    if min(abs(slowest), abs(fastest)) > _swing_rpm(scene) and slowest * fastest > 0:
        return
    ratios = [shaft.name for shaft in scene.other_shafts if shaft.ratio is not None]
    for k, injected in enumerate(scene.injected_orders):
        if injected.speed_exponent < 0 and injected.shaft in (None, *ratios):
            yield ENDLESS, f"injected_orders.{k}.speed_exponent", f"{injected.speed_exponent:g}", "0 or more"


def _past(scene: Scene) -> Iterator[Fault]:
    """What remembers more of the time before a recording than can be worked out."""
    if scene.n_samples > MAX_SAMPLES or list(_told(lambda: scene.filter, "acquisition")):
        return  # told already
    rate_hz = scene.rate_hz(max(abs(speed) for speed in scene.speed_range_rpm) or 1.0)
    forces = scene.engine_forces or scene.gas_torque or scene.injected_orders
    scatters = scene.gas_torque is not None and scene.gas_torque.scatter_percent > 0
    uneven = scene.speed_wander or (scene.in_cycle_speed and scene.speed_profile) or scatters
    if forces and (uneven or scene.speed_profile or any(shaft.time_s for shaft in scene.other_shafts)):
        yield from _told(partial(poles_of, scene.structure, scene.filter), "acquisition.low_pass_hz")
    if forces and uneven:
        longest_s = MOST_PAST / rate_hz / MEMORY
        for k, mode in enumerate(scene.modes):
            decay_s = 1 / (2 * math.pi * mode.frequency_hz * mode.damping_ratio)
            if decay_s > longest_s:
                yield RINGS_TOO_LONG, f"modes.{k}.damping_ratio", f"{decay_s:g} s to 1/e", f"at most {longest_s:g} s"
        decay_s = float(np.max(-1 / scene.filter.pole_per_s.real)) if scene.filter is not None else 0.0
        if decay_s > longest_s:
            yield RINGS_TOO_LONG, "acquisition.ac_coupling_hz", f"{decay_s:g} s to 1/e", f"at most {longest_s:g} s"
    for k, part in enumerate(scene.bearing_impacts):
        rings_s = partial(ringing_s, part.resonance_hz, part.damping_ratio, filter=scene.filter)
        wrong = list(_told(rings_s, f"bearing_impacts.{k}.resonance_hz"))
        yield from wrong
        bearing = next((bearing for bearing in scene.engine.bearings if bearing.name == part.bearing), None)
        if wrong or bearing is None or part.line not in bearing_orders(bearing):
            continue
        per_s = 2 * bearing_orders(bearing)[part.line] * max(abs(speed) for speed in scene.speed_range_rpm) / 60
        strikes = per_s * (scene.n_samples / rate_hz + 2 * rings_s())
        if strikes > MOST_EVENTS:
            yield RINGS_TOO_LONG, f"bearing_impacts.{k}", f"{strikes:g} strikes", f"at most {MOST_EVENTS}"


def _labels(scene: Scene) -> Iterator[Fault]:
    """Wrong labels of what is not labelled."""
    labels = scene.wrong_labels
    if labels is None:
        return
    if labels.pulses_per_rev is not None and scene.encoder is None:
        yield "there is no encoder to be labelled", "wrong_labels.pulses_per_rev", "no [encoder]", "an [encoder]"
    if labels.swapped is not None and labels.swapped[0] == labels.swapped[1]:
        yield "a channel cannot be swapped with itself", "wrong_labels.swapped", labels.swapped[0], "two channels"


OF_QUICK = {"sampling", "speeds", "speed_profile", "repeats"}
"""Keys of a scene of which a table [quick] states less."""
MAX_DEPTH = 4
"""Scenes that may be based on one another in a row."""


def load_scene(name: str, beside: Path | None = None) -> Scene:
    """Scene from a shipped file of ``pipeline/scenes`` or a user's TOML file, its engine loaded and everything checked.

    A scene may name another with ``based_on``: it then has all of that scene's keys but those that it states itself and
    those that it lists as ``without``. Scenes and engines that a file names are tried beside that file first.

    ``name``: a shipped file's stem or the path of a TOML file. ``beside``: folder in which paths are tried first.
    Raises RequestError where there is no such file, ManyErrors with every fault of the tables: unknown effects and
    keys, values out of range; where these are sound, with all that does not go together: names that do not exist,
    speeds and orders that the sampling cannot carry.
    """
    faults: list[CrankorderError] = []
    table, source = _whole_table(name, beside, faults)
    if "engine_file" in table:
        faults.append(RequestError("unknown key", file=source, place="engine_file", remedy="Name the engine as engine"))
    table["engine_file"] = table.get("engine", "")
    if "engine" not in table:
        known = f"{', '.join(shipped('engines'))}, or a path of a .toml file"
        faults.append(RequestError("the scene names no engine", file=source, place="engine", allowed=known))
    try:
        table["engine"] = "engine" in table and load_engine(str(table["engine_file"]), _folder_of(name, beside))
    except ManyErrors as errors:
        faults += errors.faults
    except RequestError as error:
        faults.append(error)
    try:
        scene = Scene.model_validate(table)
    except ValidationError as error:
        faults += [_fault_of_form(fault, source) for fault in error.errors() if fault["loc"][:1] != ("engine",)]
        raise ManyErrors(faults) from None
    faults += validation_errors(scene, source)
    told = {(fault.problem, fault.place) for fault in faults}
    quick = validation_errors(scene.first_look(), source)
    if faults := [*faults, *(fault for fault in quick if (fault.problem, fault.place) not in told)]:
        raise ManyErrors(faults)
    return scene


def _fault_of_form(fault: Any, source: str) -> RequestError:
    """A fault that the model of a scene finds, in the words of the program."""
    text = validation_fault(fault, source)
    if text.problem != "unknown key" or len(fault["loc"]) > 1:
        return text
    effects = ", ".join(key for key, field in Scene.model_fields.items() if not field.is_required())
    return RequestError("unknown effect", file=source, place=text.place, allowed=effects)


def _folder_of(name: str, beside: Path | None) -> Path | None:
    """Folder of the scene ``name``, in which what it names is tried first; ``beside`` where it is a shipped one."""
    return (beside or Path()).joinpath(name).parent if name.endswith(".toml") else beside


def _whole_table(
    name: str, beside: Path | None, faults: list[CrankorderError], derived: tuple[str, ...] = ()
) -> tuple[dict[str, object], str]:
    """Table of a scene with what it takes from the scene that it is based on, and the file's name."""
    table, source = toml_table(name, "scenes", beside=beside)
    based_on, without = table.pop("based_on", None), table.pop("without", [])
    if based_on is None:
        if without:
            faults.append(RequestError("without goes with based_on", file=source, place="without", found=without))
        return table, source
    if not isinstance(based_on, str) or based_on in (*derived, name) or len(derived) >= MAX_DEPTH:
        allowed = f"the name of another scene, no circle, at most {MAX_DEPTH} deep"
        raise RequestError("no scene to be based on", file=source, place="based_on", found=based_on, allowed=allowed)
    base, _ = _whole_table(based_on, _folder_of(name, beside), faults, (*derived, name))
    left_out = [str(key) for key in without] if isinstance(without, list) else [str(without)]
    for key in left_out:
        if key not in base:
            known = ", ".join(key for key in base if key in Scene.model_fields)
            faults.append(RequestError("nothing to leave out", file=source, place="without", found=key, allowed=known))
    if table.keys() & OF_QUICK:
        left_out = [*left_out, "quick"]  # its differences are from what this scene no longer has
    return {key: value for key, value in base.items() if key not in left_out} | table, source
