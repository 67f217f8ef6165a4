"""What else than the machine differs between two tests, and what that does to their comparison."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from crankorder.comparison import FIRING, PROGRAM, REPEATS, Confound, Part, Severity
from crankorder.identify.changes.order_changes import Tested, order_maps
from crankorder.quantities import is_cylinder_pressure
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-changes.toml", "confounds")

_RULES: tuple[tuple[str, str, Severity, Part, str], ...] = (
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


_CHANNEL_RULES: tuple[tuple[str, Severity, str], ...] = (
    ("unit", "invalid", "amplitudes in other units cannot be compared"),
    ("quantity", "invalid", "other quantities cannot be compared"),
    ("direction", "weakens", "the sensor looked another way"),
    ("sensitivity", "weakens", "another sensor, or another setting of it: a wrong one scales all orders alike"),
    ("offset", "harmless", "the mean of a signal is no vibration"),
    ("source", "harmless", "the same signal under another name, if it was wired so"),
)


def confounds(base: Tested, new: Tested) -> list[Confound]:
    """Everything that differs in how the tests ``base`` and ``new`` were made, the worst first."""
    tests = (base, new)
    differences = [
        _confound(what, severity, part, [_text(value) for value in values], words)
        for what, path, severity, part, words in _RULES
        if (values := [_at(test, path) for test in tests]) and values[0] != values[1]
    ]
    for concerns in (_channels, _maps, _firing, _repeats, _quality, _versions, _same_inputs):
        differences += concerns(tests)
    rank = {"invalid": 0, "weakens": 1, "harmless": 2}
    return sorted(differences, key=lambda confound: rank[confound.severity])


Tests = tuple[Tested, Tested]
Values = tuple[str, str] | list[str]


def _confound(what: str, severity: Severity, part: Part, values: Values, words: str, channel: str = "") -> Confound:
    base, new = values
    return Confound(what=what, severity=severity, part=part, channel=channel, base=base, new=new, words=words)


def _at(test: Tested, path: str) -> Any:
    value: Any = test.run
    for key in path.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def _text(value: Any) -> str:
    if isinstance(value, Mapping | list | tuple):
        return str(value.get("title", "its data")) if isinstance(value, Mapping) else f"{len(value)} stated"
    return "not stated" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _channels(tests: Tests) -> list[Confound]:
    """Channels of one test only, and those whose unit, sensor or direction is another."""
    base, new = ({channel["name"]: channel for channel in _at(test, "manifest.channels") or []} for test in tests)
    differences = []
    for name in {**base, **new}:
        of_channel = partial(_confound, part="channel", channel=name)
        if name in base and name in new:
            pairs = ((rule, (base[name].get(rule[0]), new[name].get(rule[0]))) for rule in _CHANNEL_RULES)
            differences += [
                of_channel(key, severity, values=[_text(value) for value in values], words=words)
                for (key, severity, words), values in pairs if values[0] != values[1]
            ]  # fmt: skip
        else:
            where, values = ("first", ["measured", "missing"]) if name in base else ("second", ["missing", "measured"])
            words = f"only the {where} test has this channel"
            differences.append(of_channel("channel", "invalid", values=values, words=words))
    return differences


def _maps(tests: Tests) -> list[Confound]:
    """Highest order, speeds, frames and phase marks as the order maps have them."""
    maps = order_maps(tests)
    if not maps:
        values = ["held" if "order_map" in test.maps else "missing" for test in tests]
        words = "orders are compared where the results of both tests hold an order map"
        return [_confound("order map", "invalid", "orders", values, words)] if "held" in values else []
    speeds = [order_map["speed"].values[np.isfinite(order_map["speed"].values)] for order_map in maps]
    ranges = [f"{len(rpm)} speeds, {rpm.min():.0f} to {rpm.max():.0f} rpm" if len(rpm) else "" for rpm in speeds]
    rules: tuple[tuple[str, Severity, Part, list[str], str], ...] = (
        ("highest order", "harmless", "orders", [f"{float(order_map['order'].values[-1]):g}" for order_map in maps],
         "orders are compared up to the lower"),
        ("phase reference", "weakens", "phases", [str(order_map.attrs.get("phase_reference")) for order_map in maps],
         "phases count from other marks: amplitudes only are compared"),
        ("speeds", "weakens", "all", ranges, "only speeds that both have are compared; nothing is interpolated"),
    )  # fmt: skip
    differences = [_confound(*rule) for rule in rules if all(rule[3]) and rule[3][0] != rule[3][1]]
    counts = [int(order_map["n_frames"].values.sum()) for order_map in maps]
    if max(counts) > NUMBERS.few_frames_ratio * max(min(counts), 1):
        words = "the intervals allow for it: small changes may hide in the shorter test"
        differences.append(_confound("frames averaged", "harmless", "all", [str(n) for n in counts], words))
    return differences


def _firing(tests: Tests) -> list[Confound]:
    """Firing against motoring, or another load: by the names of the tests and by pressure channels."""
    words = "combustion changes half orders and whole ones: differences are not the machine's alone"
    states = []
    for test in tests:
        names = f"{_at(test, 'test') or ''} {_at(test, 'manifest.test.engine') or ''}".casefold()
        states.append("firing" if "firing" in names or "fired" in names else "motoring" if "motor" in names else "")
    if all(states) and states[0] != states[1]:
        return [_confound(FIRING, "weakens", "all", states, words)]
    levels = [_pressure(test.maps["order_map"]) if "order_map" in test.maps else 0.0 for test in tests]
    if min(levels) > 0 and max(levels) > NUMBERS.fired_ratio * min(levels):
        values = [f"{level:.3g} (median)" for level in levels]
        return [_confound("pressure of the cycle", "weakens", "all", values, words)]
    return []


def _pressure(order_map: xr.Dataset) -> float:
    """Median over speeds of the cylinder pressures' total amplitude; 0 where there is none."""
    channels = zip(order_map["quantity"].values.tolist(), order_map["unit"].values.tolist(), strict=True)
    rows = [n for n, (quantity, unit) in enumerate(channels) if is_cylinder_pressure(quantity, unit)]
    energy = order_map["amplitude"].values[rows] ** 2
    return float(np.median(np.sqrt(np.nansum(energy, axis=2)))) if rows else 0.0


def _repeats(tests: Tests) -> list[Confound]:
    """Whether recordings were repeated at a speed: only then is known by how much a test differs from itself."""
    if not all({"shaft", "order_map"} <= set(test.maps) for test in tests):
        return []
    counts = [(test.maps["shaft"].sizes["recording"], test.maps["order_map"].sizes["speed"]) for test in tests]
    if all(recordings > speeds for recordings, speeds in counts):
        return []
    values = [f"{recordings} recordings at {speeds} speeds" for recordings, speeds in counts]
    words = "intervals hold for the recordings: by how much a test differs when it is set up again, they do not know"
    return [_confound(REPEATS, "weakens", "all", values, words)]


def _quality(tests: Tests) -> list[Confound]:
    """Remarks on the recordings that only one of the tests has."""
    remarks = [Counter((flag["flag"], flag["severity"]) for flag in _at(test, "quality") or []) for test in tests]
    return [
        _confound(
            f"quality: {str(flag).replace('_', ' ')}",
            "harmless" if severity == "info" else "weakens",
            "all",
            [f"{count[flag, severity]} recordings" for count in remarks],
            f"recordings of one test only have this remark ({severity})",
        )
        for flag, severity in sorted(set(remarks[0]) ^ set(remarks[1]))
    ]


def _versions(tests: Tests) -> list[Confound]:
    codes = [_at(test, "code_sha256") for test in tests]
    base, new = (_at(test, "versions") or {} for test in tests)
    if codes[0] != codes[1]:
        programs = zip((base.get("crankorder"), new.get("crankorder")), codes, strict=True)
        values = [f"{version} ({str(code)[:8]})" for version, code in programs]
        words = "analysed by other versions of the program: run both again with one"
        return [_confound(PROGRAM, "weakens", "all", values, words)]
    return [
        _confound(f"library {name}", "harmless", "all", (_text(version), _text(new.get(name))), "")
        for name, version in base.items()
        if version != new.get(name)
    ]


def _same_inputs(tests: Tests) -> list[Confound]:
    base, new = ({recording["sha256"] for recording in _at(test, "inputs") or []} - {None} for test in tests)
    if not base & new:
        return []
    values = [f"{len(base & new)} of {len(inputs)} recordings" for inputs in (base, new)]
    words = "the same bytes in both tests: they cannot differ"
    return [_confound("shared recordings", "harmless" if base == new else "weakens", "all", values, words)]
