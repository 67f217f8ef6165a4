"""What a scene asks for and cannot have: names that do not exist, speeds and orders that the sampling cannot carry."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

from crankorder.engine.bearings import bearing_orders
from crankorder.errors import RequestError
from crankorder.synth.effects import TimeSampling
from crankorder.synth.scene import Scene

MAX_SAMPLES = 50_000_000
"""Of one channel of one recording: more would not fit into the memory of a small machine."""

Fault = tuple[str, str, str, str]
"""Problem, place, found, allowed."""


def unmet_demands(scene: Scene, source: str, kept: dict[str, list[int]]) -> list[RequestError]:
    """Every fault of ``scene`` that its parts alone do not show.

    ``source``: the file's name for the messages. ``kept``: for a list of effects that lost faulty items, the places in
    the file of those that stayed.
    """
    return [
        RequestError(problem, file=source, place=_place_in_file(place, kept), found=found, allowed=allowed)
        for problem, place, found, allowed in (
            *_names(scene),
            *_forces_without_structure(scene),
            *_sampling(scene),
            *_orders(scene),
        )
    ]


def _place_in_file(place: str, kept: dict[str, list[int]]) -> str:
    head, _, rest = place.partition(".")
    item, _, key = rest.partition(".")
    return f"{head}.{kept[head][int(item)]}.{key}".rstrip(".") if head in kept and item else place


def _names(scene: Scene) -> Iterator[Fault]:
    channels = scene.channel_names
    for what, values in (("name", channels), ("source", [channel.source for channel in scene.channels])):
        for value, times in Counter(values).items():
            if times > 1:
                yield f"two channels have the same {what}", "channels", value, "each once"
    for channel in scene.channels:
        if channel.source in ("encoder", "index"):
            yield "the encoder's dataset cannot be a channel's", "channels", channel.source, "any other name"
    uses: list[tuple[str, Iterable[str]]] = [("rigid_body_per_kg", scene.rigid_body_per_kg)]
    uses += [(f"modes.{k}.sensor_per_kg", mode.sensor_per_kg) for k, mode in enumerate(scene.modes)]
    uses += [(f"bearing_lines.{k}.amplitude_m_s2", line.amplitude_m_s2) for k, line in enumerate(scene.bearing_lines)]
    uses += [("sensor_noise.m_s2_per_root_hz", scene.sensor_noise.m_s2_per_root_hz)] if scene.sensor_noise else []
    for place, names in uses:
        for name in names:
            if name not in channels:
                yield "no such channel", place, name, ", ".join(channels)
    bearings = {bearing.name: bearing for bearing in scene.engine.bearings}
    for k, line in enumerate(scene.bearing_lines):
        if line.bearing not in bearings:
            yield (
                "the engine has no such bearing",
                f"bearing_lines.{k}.bearing",
                line.bearing,
                ", ".join(bearings) or "none",
            )
        elif line.line not in bearing_orders(bearings[line.bearing]):
            known = ", ".join(bearing_orders(bearings[line.bearing]))
            yield "the bearing's data do not tell this line", f"bearing_lines.{k}.line", line.line, known


def _forces_without_structure(scene: Scene) -> Iterator[Fault]:
    if scene.modes or scene.rigid_body_per_kg:
        return
    for place in ("engine_forces", "injected_orders", "broadband"):
        if getattr(scene, place):
            yield "forces have nothing to act on", place, "no modes, no rigid_body_per_kg", "at least one of them"


def _sampling(scene: Scene) -> Iterator[Fault]:
    if scene.n_samples > MAX_SAMPLES:
        yield "a recording is too long", "sampling", f"{scene.n_samples} samples", f"at most {MAX_SAMPLES}"
    if scene.encoder is not None and not isinstance(scene.sampling, TimeSampling):
        yield "samples by crank angle need no encoder", "encoder", "[encoder]", 'only with domain = "time"'
    if scene.encoder is not None and isinstance(scene.sampling, TimeSampling):
        fastest = 30 * scene.sampling.rate_hz / scene.encoder.pulses_per_rev
        too_fast = [f"{speed:g}" for speed in scene.speeds.rpm if speed > fastest]
        if too_fast:
            allowed = f"at most {fastest:g} rpm with {scene.encoder.pulses_per_rev} pulses per revolution at this rate"
            yield "speeds that the rate cannot carry", "speeds", f"{', '.join(too_fast)} rpm", allowed
    lowest_rate = min(scene.rate_hz(speed) for speed in scene.speeds.rpm)
    for k, mode in enumerate(scene.modes):
        if mode.frequency_hz >= lowest_rate / 2:
            allowed = f"below half the rate, {lowest_rate / 2:g} Hz"
            yield "natural frequency above Nyquist", f"modes.{k}.frequency_hz", f"{mode.frequency_hz:g}", allowed


def _orders(scene: Scene) -> Iterator[Fault]:
    fastest = max(scene.speeds.rpm)
    nyquist_order = scene.rate_hz(fastest) / 2 * 60 / fastest
    bearings = {bearing.name: bearing_orders(bearing) for bearing in scene.engine.bearings}
    asked = [("engine_forces", float(scene.highest_engine_order))]
    asked += [(f"injected_orders.{k}.order", injected.order) for k, injected in enumerate(scene.injected_orders)]
    asked += [
        (f"bearing_lines.{k}", bearings.get(line.bearing, {}).get(line.line, 0.0))
        for k, line in enumerate(scene.bearing_lines)
    ]
    for place, order in asked:
        if order >= nyquist_order:
            yield "order above Nyquist", place, f"{order:g}", f"below {nyquist_order:g} at {fastest:g} rpm"
