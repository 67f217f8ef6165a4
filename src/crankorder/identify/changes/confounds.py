"""What else than the machine differs between two tests, and what that does to their comparison."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import xarray as xr

from crankorder.quantities import is_cylinder_pressure
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-changes.toml", table="confounds"):
    few_frames_ratio: float
    fired_ratio: float


NUMBERS = _Numbers.load()

Weight = Literal["invalid", "weakens", "harmless"]
"""What a confound does to a comparison: nothing can be compared, claims need care, or none."""

Part = Literal["all", "orders", "phases", "channel"]
"""What of the comparison is concerned."""


@dataclass(frozen=True)
class Confound:
    """One difference of how two tests were made: ``what``, its value in both, how much it matters, and in words."""

    what: str
    severity: Weight
    part: Part
    base: str
    new: str
    words: str
    channel: str = ""


_RULES: tuple[tuple[str, str, Weight, Part, str], ...] = (
    ("sampling domain", "manifest.sampling.domain", "weakens", "all",
     "data by crank angle have no filter in front: fixed frequencies fold into their orders"),
    ("sampling rate", "manifest.sampling.rate_hz", "weakens", "all",
     "other rates have other anti-alias filters: levels near half of the lower rate may differ for that alone"),
    ("samples per revolution", "manifest.sampling.samples_per_rev", "weakens", "all",
     "what folds, and onto which orders, differs"),
    ("first sample's angle", "manifest.sampling.start_deg", "weakens", "phases", "phases count from another angle"),
    ("cycle", "manifest.test.cycle", "weakens", "all", "frames hold another number of revolutions"),
    ("engine", "manifest.test.engine", "harmless", "all", "the engine file says what was built: no scale"),
    ("engine data", "engine", "harmless", "all", "the engine files differ; nothing measured is scaled by them"),
    ("bearings", "manifest.bearings", "harmless", "orders", "bearing lines are named after other data"),
    ("encoder kind", "manifest.encoder.kind", "weakens", "orders",
     "another way to the crank angle has other errors at orders"),
    ("encoder pulses", "manifest.encoder.pulses_per_rev", "weakens", "orders",
     "speed changes within a revolution are seen in one test and not in the other"),
    ("encoder ratio", "manifest.encoder.ratio", "weakens", "orders", "orders count revolutions of another shaft"),
    ("index", "manifest.encoder.index", "weakens", "phases", "phases may count from another mark"),
    ("index to top dead centre", "manifest.encoder.index_to_tdc_deg", "weakens", "phases",
     "phases count from another angle, if the encoder was not turned by as much"),
    ("edge", "manifest.encoder.edge", "weakens", "phases", "the other edge of a pulse lies at another angle"),
    ("revolutions per frame", "settings.orders.revs_per_frame", "weakens", "orders",
     "longer frames let less noise into an order, and lines that slip lose more"),
    ("speed bin", "settings.orders.speed_bin_rpm", "weakens", "all", "speeds were grouped by another width"),
    ("tolerance", "settings.orders.tolerance", "harmless", "orders", "both are below the noise"),
    ("map resolution", "settings.campbell.resolution_hz", "weakens", "all",
     "natural frequencies are fitted to bins of another width"),
    ("map window", "settings.campbell.window", "weakens", "all",
     "another window widens the peaks to which natural frequencies are fitted"),
    ("highest frequency", "settings.campbell.max_frequency_hz", "harmless", "all",
     "natural frequencies above the lower are sought in one test only"),
)  # fmt: skip


def confounds(
    base: Mapping[str, Any],
    new: Mapping[str, Any],
    base_maps: Mapping[str, xr.Dataset],
    new_maps: Mapping[str, xr.Dataset],
) -> list[Confound]:
    """Everything that differs in how two tests were made, the worst first.

    ``base`` and ``new`` are what ``run.json`` states of both, ``base_maps`` and ``new_maps`` the datasets of their
    results by name: ``order_map`` where orders were wanted, and ``shaft`` where it is known.
    """
    found = [
        Confound(what, severity, part, _text(one), _text(two), words)
        for what, path, severity, part, words in _RULES
        if (one := _at(base, path)) != (two := _at(new, path))
    ]
    found += _channels(base, new) + _maps(base_maps, new_maps) + _firing(base, new, base_maps, new_maps)
    found += _repeats(base_maps, new_maps) + _quality(base, new) + _versions(base, new) + _same_inputs(base, new)
    rank = {"invalid": 0, "weakens": 1, "harmless": 2}
    return sorted(found, key=lambda one: rank[one.severity])


def _at(document: Mapping[str, Any], path: str) -> Any:
    value: Any = document
    for key in path.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def _text(value: Any) -> str:
    if isinstance(value, Mapping | list | tuple):
        return str(value.get("title", "its data")) if isinstance(value, Mapping) else f"{len(value)} stated"
    return "not stated" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _channels(base: Mapping[str, Any], new: Mapping[str, Any]) -> list[Confound]:
    """Channels of one test only, and those whose unit, sensor or direction is another."""
    one, two = ({c["name"]: c for c in _at(run, "manifest.channels") or []} for run in (base, new))
    found = []
    for name in dict.fromkeys([*one, *two]):
        if name not in one or name not in two:
            where = "the first test" if name in one else "the second test"
            given = ("measured", "missing") if name in one else ("missing", "measured")
            found.append(
                Confound("channel", "invalid", "channel", given[0], given[1], f"only {where} has this channel", name)
            )
            continue
        for key, severity, words in (
            ("unit", "invalid", "amplitudes in other units cannot be compared"),
            ("quantity", "invalid", "other quantities cannot be compared"),
            ("direction", "weakens", "the sensor looked another way"),
            ("sensitivity", "weakens", "another sensor, or another setting of it: a wrong one scales all orders alike"),
            ("offset", "harmless", "the mean of a signal is no vibration"),
            ("source", "harmless", "the same signal under another name, if it was wired so"),
        ):
            a, b = one[name].get(key), two[name].get(key)
            if a != b:
                found.append(Confound(key, severity, "channel", _text(a), _text(b), words, name))  # type: ignore[arg-type]
    return found


def _maps(base: Mapping[str, xr.Dataset], new: Mapping[str, xr.Dataset]) -> list[Confound]:
    """Highest order, speeds, frames and phase marks as the order maps have them."""
    has = ["order_map" in maps for maps in (base, new)]
    if not all(has):
        texts = ["held" if one else "missing" for one in has]
        words = "orders are compared where the results of both tests hold an order map"
        return [Confound("order map", "invalid", "orders", texts[0], texts[1], words)] if any(has) else []
    found: list[Confound] = []
    maps = base["order_map"], new["order_map"]
    highest = [float(item["order"].values[-1]) for item in maps]
    if highest[0] != highest[1]:
        words = "orders are compared up to the lower"
        found.append(Confound("highest order", "harmless", "orders", f"{highest[0]:g}", f"{highest[1]:g}", words))
    marks = [str(item.attrs.get("phase_reference")) for item in maps]
    if marks[0] != marks[1]:
        words = "phases count from other marks: amplitudes only are compared"
        found.append(Confound("phase reference", "weakens", "phases", marks[0], marks[1], words))
    ranges = [item["speed"].values[np.isfinite(item["speed"].values)] for item in maps]
    if all(len(speed) for speed in ranges):
        texts = [f"{len(speed)} speeds, {speed.min():.0f} to {speed.max():.0f} rpm" for speed in ranges]
        if texts[0] != texts[1]:
            words = "only speeds that both have are compared; nothing is interpolated"
            found.append(Confound("speeds", "weakens", "all", texts[0], texts[1], words))
    counts = [int(item["n_frames"].values.sum()) for item in maps]
    if max(counts) > NUMBERS.few_frames_ratio * max(min(counts), 1):
        words = "the intervals allow for it: small changes may hide in the shorter test"
        found.append(Confound("frames averaged", "harmless", "all", str(counts[0]), str(counts[1]), words))
    return found


def _firing(
    base: Mapping[str, Any],
    new: Mapping[str, Any],
    base_maps: Mapping[str, xr.Dataset],
    new_maps: Mapping[str, xr.Dataset],
) -> list[Confound]:
    """Firing against motoring, or another load: by the names of the tests and by pressure channels."""
    words = "combustion changes half orders and whole ones: differences are not the machine's alone"
    states = []
    for run in (base, new):
        told = f"{run.get('test', '')} {_at(run, 'manifest.test.engine') or ''}".casefold()
        states.append("firing" if "firing" in told or "fired" in told else "motoring" if "motor" in told else "")
    if all(states) and states[0] != states[1]:
        return [Confound("firing or motoring", "weakens", "all", states[0], states[1], words)]
    levels = [_pressure(maps["order_map"]) if "order_map" in maps else 0.0 for maps in (base_maps, new_maps)]
    if all(level > 0 for level in levels) and max(levels) > NUMBERS.fired_ratio * min(levels):
        texts = [f"{level:.3g} (median)" for level in levels]
        return [Confound("pressure of the cycle", "weakens", "all", texts[0], texts[1], words)]
    return []


def _pressure(order_map: xr.Dataset) -> float:
    """Median over speeds of the cylinder pressures' total amplitude; 0 where there is none."""
    told = zip(order_map["quantity"].values.tolist(), order_map["unit"].values.tolist(), strict=True)
    rows = [n for n, (quantity, unit) in enumerate(told) if is_cylinder_pressure(quantity, unit)]
    energy = order_map["amplitude"].values[rows] ** 2
    return float(np.median(np.sqrt(np.nansum(energy, axis=2)))) if rows else 0.0


def _repeats(base: Mapping[str, xr.Dataset], new: Mapping[str, xr.Dataset]) -> list[Confound]:
    """Whether recordings were repeated at a speed: only then is known by how much a test differs from itself."""
    said = []
    for maps in (base, new):
        if not {"shaft", "order_map"} <= set(maps):
            return []
        recordings, speeds = maps["shaft"].sizes["recording"], maps["order_map"].sizes["speed"]
        said.append((recordings > speeds, f"{recordings} recordings at {speeds} speeds"))
    if all(repeated for repeated, _ in said):
        return []
    words = "intervals hold for the recordings: by how much a test differs when it is set up again, they do not know"
    return [Confound("repeats", "weakens", "all", said[0][1], said[1][1], words)]


def _quality(base: Mapping[str, Any], new: Mapping[str, Any]) -> list[Confound]:
    """Remarks on the recordings that only one of the tests has."""
    counts = [Counter((flag["flag"], flag["severity"]) for flag in run.get("quality") or []) for run in (base, new)]
    found = []
    for flag, severity in sorted({*counts[0], *counts[1]}):
        one, two = (count[flag, severity] for count in counts)
        if (one == 0) != (two == 0):
            weight: Weight = "harmless" if severity == "info" else "weakens"
            words = f"recordings of one test only have this remark ({severity})"
            name = str(flag).replace("_", " ")
            found.append(Confound(f"quality: {name}", weight, "all", f"{one} recordings", f"{two} recordings", words))
    return found


def _versions(base: Mapping[str, Any], new: Mapping[str, Any]) -> list[Confound]:
    if base.get("code_sha256") != new.get("code_sha256"):
        texts = [f"{_at(run, 'versions.crankorder')} ({str(run.get('code_sha256'))[:8]})" for run in (base, new)]
        words = "analysed by other versions of the program: run both again with one"
        return [Confound("program", "weakens", "all", texts[0], texts[1], words)]
    return [
        Confound(f"library {name}", "harmless", "all", _text(one), _text(_at(new, f"versions.{name}")), "")
        for name, one in (base.get("versions") or {}).items()
        if one != _at(new, f"versions.{name}")
    ]


def _same_inputs(base: Mapping[str, Any], new: Mapping[str, Any]) -> list[Confound]:
    one, two = ({item["sha256"] for item in run.get("inputs") or []} - {None} for run in (base, new))
    if not one & two:
        return []
    texts = [f"{len(one & two)} of {len(inputs)} recordings" for inputs in (one, two)]
    words = "the same bytes in both tests: they cannot differ"
    return [Confound("shared recordings", "harmless" if one == two else "weakens", "all", texts[0], texts[1], words)]
