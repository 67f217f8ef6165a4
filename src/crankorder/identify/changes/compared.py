"""Two tests, or one test over time, put side by side: one document of what changed, how sure, and what explains it."""

from __future__ import annotations

import cmath
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.special import ndtr

from crankorder.engine.definition import Engine
from crankorder.engine.transfer_paths import AddedMass
from crankorder.findings import Findings, ModeFinding, TrialBalance
from crankorder.identify.balance.trial_mass import trial_mass
from crankorder.identify.changes.confounds import Confound, confounds
from crankorder.identify.changes.mass_change import Unbalance, Weighed, balance_changes, unbalance_change, weighed
from crankorder.identify.changes.order_changes import NUMBERS as ORDER_CHANGES
from crankorder.identify.changes.order_changes import TO_DB, OrderChange, like_speeds, order_changes, orders_to_compare
from crankorder.identify.changes.run_trends import run_trends
from crankorder.identify.intervals import Z95, claimed, error_of, half_width, interval
from crankorder.records import known
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-changes.toml", table="mode_shifts"):
    mode_reach: float
    least_reach: float


NUMBERS = _Numbers.load()

SCHEMA_VERSION = 1
Cause = Literal[
    "nothing changed",
    "unbalance",
    "moving masses",
    "orders",
    "growing line",
    "natural frequencies",
    "not comparable",
]


@dataclass(frozen=True, eq=False)
class Tested:
    """The results of one test: its name, findings, what ``run.json`` states, and its datasets by name."""

    name: str
    findings: Findings
    run: Mapping[str, Any]
    maps: Mapping[str, xr.Dataset]

    @property
    def comparable(self) -> set[str]:
        """What a comparison can take from these results: "orders" of an order map, "modes" where they were sought."""
        return ({"orders"} if "order_map" in self.maps else set()) | ({"modes"} & set(self.findings.looked_for))


@dataclass(frozen=True, eq=False)
class Compared:
    """What a comparison gives: the document of ``data_schema/comparison.json``, and the orders behind it."""

    document: dict[str, Any]
    orders: list[OrderChange]


def compared(tests: Sequence[Tested], *, q: float) -> Compared:
    """Comparison of the last of ``tests`` with the first, and of several the trend over all.

    Parameters
    ----------
    tests : two or more, in time order; orders are compared where the first and the last have an ``order_map``, natural
        frequencies where both looked for them
    q : false-discovery rate of the claims, 0 to 1: over orders, over modes and over trends, each
    """
    base, new = tests[0], tests[-1]
    doubts = confounds(base.run, new.run, base.maps, new.maps)
    refused = {one.channel: one for one in doubts if one.severity == "invalid" and one.part == "channel"}
    channels = tuple(c.name for c in base.findings.channels if c.name not in refused)
    within = max(float(test.run["settings"]["orders"]["speed_bin_rpm"]) for test in (base, new))
    changes, orders = _orders(base, new, channels, within, q, doubts)
    modes = _mode_shifts(base.findings, new.findings, q=q) if "modes" in base.comparable & new.comparable else []
    unbalances = [(one, found) for one in changes if one.order in (1.0, 2.0) and (found := unbalance_change(one))]
    explaining = [found for one, found in unbalances if one.changed and found.explains]
    trial, trial_reason = _known_mass(base, new)
    shared = [c for c in channels if all(_units(test, test).get(c) == _units(tests[0], tests[0])[c] for test in tests)]
    findings, envelopes = [test.findings for test in tests], [test.maps.get("envelope_map") for test in tests]
    trends = run_trends(_order_maps(tests), findings, envelopes, orders, shared, within_rpm=within, q=q)
    why = {name: one.words for name, one in refused.items()}
    parts = ("what", "severity", "part", "channel", "base", "new", "words")
    document: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "base": base.name,
        "new": new.name,
        "runs": [test.name for test in tests],
        "false_discovery_rate": q,
        "speeds": _speeds(base, new, within),
        "channels": [
            {"name": name, "unit": unit, "compared": name in channels, "reason": why.get(name, "")}
            for name, unit in _units(base, new).items()
        ],
        "cause": _cause(changes, unbalances, modes=modes, trends=trends),
        "orders": [_order_record(one, _explained(one, base, new)) for one in changes],
        "modes": modes,
        "unbalance": [_unbalance_record(one, found) for one, found in unbalances],
        "masses": _masses(base, new, unbalances),
        "trial_mass": None if trial is None else trial.as_dict(),
        "trial_mass_reason": trial_reason,
        "balance": balance_changes(base.findings, new.findings, explaining),
        "balance_reason": _why_not_closed(base, new),
        "trend": trends,
        "confounds": [{name: getattr(one, name) for name in parts} for one in doubts],
    }
    return Compared(document, changes)


def _units(base: Tested, new: Tested) -> dict[str, str]:
    return {c.name: c.unit for test in (new, base) for c in test.findings.channels}


def _order_maps(tests: Sequence[Tested]) -> list[xr.Dataset]:
    """Order maps of the ``tests``; none where any of them has none."""
    return [test.maps["order_map"] for test in tests] if all("orders" in test.comparable for test in tests) else []


def _speeds(base: Tested, new: Tested, within: float) -> list[dict[str, float]]:
    values = [item["speed"].values for item in _order_maps((base, new))]
    if not values:
        return []
    one, two = like_speeds(*values, within_rpm=within)
    pairs = zip(values[0][one].tolist(), values[1][two].tolist(), strict=True)
    return [{"base_rpm": a, "new_rpm": b} for a, b in pairs]


def _orders(
    base: Tested, new: Tested, channels: Sequence[str], within: float, q: float, doubts: Sequence[Confound]
) -> tuple[list[OrderChange], list[tuple[float, bool]]]:
    """Changes of all orders, and the orders; by amplitude alone where ``doubts`` are of the phases."""
    maps = _order_maps((base, new))
    if not maps:
        return [], []
    highest = min(float(item["order"].values[-1]) for item in maps)
    orders = orders_to_compare(base.findings.orders, new.findings.orders, highest)
    phases = not any(one.part == "phases" and one.severity == "weakens" for one in doubts)
    changes, amplitudes = (
        order_changes(maps[0], maps[1], orders, channels, within_rpm=within, q=q, phases=told)
        for told in (phases, False)
    )
    pairs = zip(changes, amplitudes, strict=True)
    return [replace(one, phase_only=one.changed and not size.changed) for one, size in pairs], orders


def _cause(
    changes: Sequence[OrderChange],
    unbalances: Sequence[tuple[OrderChange, Unbalance]],
    *,
    modes: Sequence[Mapping[str, Any]],
    trends: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """What explains the changes best: the cause in one word or two, and the orders that it concerns."""
    orders = sorted({one.order for one in changes if one.changed})
    grown = sorted({float(one["order"]) for one in trends if one["changed"] and one["growth_per_run"] > 0})
    cause: Cause = "orders"
    if not (changes or any(one["only_in"] is None for one in modes)):
        cause = "not comparable"
    elif not orders and grown:
        cause, orders = "growing line", grown
    elif not orders and any(one["changed"] for one in modes):
        cause = "natural frequencies"
    elif not orders:
        cause = "nothing changed"
    elif orders == [1.0] and any(found.explains for one, found in unbalances if one.changed):
        cause = "unbalance"
    elif all(one.phase_only for one in changes if one.changed):  # a mark that moved, rather than masses
        cause = "orders"
    elif set(orders) <= {1.0, 2.0} and any(found.explains for one, found in unbalances if one.changed):
        cause = "moving masses"
    return {"cause": cause, "orders": orders}


def _explained(one: OrderChange, base: Tested, new: Tested) -> str | None:
    """What the findings of the second test, else of the first, say that makes the order; None for neither."""
    for test in (new, base):
        near = [r for r in test.findings.orders if abs(r.order - one.order) < ORDER_CHANGES.same_order]
        near.sort(key=lambda record: (record.channel != one.channel, -record.amplitude))
        if near:
            return near[0].explained_by or None
    return None


def _order_record(one: OrderChange, explained: str | None) -> dict[str, Any]:
    best = int(np.nanargmax(np.abs(one.difference) / np.maximum(one.base.error + one.new.error, 1e-300)))
    return {
        "channel": one.channel,
        "order": one.order,
        "unit": one.unit,
        "locked": one.locked,
        "explained_by": explained,
        "changed": one.changed,
        "phase_only": one.phase_only,
        "p_value": one.p_all,
        "ratio": float(np.exp(one.mean.ratio_db / TO_DB)),
        "ratio_ci95": [float(np.exp(end / TO_DB)) for end in one.mean.ci95_db],
        "ratio_db": one.mean.ratio_db,
        "ratio_db_ci95": list(one.mean.ci95_db),
        "alike_p": one.mean.p_alike,
        "speed_rpm": float(one.base_rpm[best]),
        "base_amplitude": float(one.base.amplitude[best]),
        "new_amplitude": float(one.new.amplitude[best]),
        "difference": float(one.difference[best]),
        "difference_ci95": one.difference_ci95[best].tolist(),
        "n_speeds": len(one.base_rpm),
        "n_changed": 0 if one.changed_at is None else int(np.count_nonzero(one.changed_at)),
    }


def _mode_shifts(base: Findings, new: Findings, *, q: float) -> list[dict[str, Any]]:
    """Records of the natural frequencies of both tests with their shifts, by frequency; those of one test without.

    ``base`` and ``new`` are findings; modes are matched with the nearest within three damping bandwidths or 5 %. Shifts
    are claimed at a false-discovery rate of ``q``. A mode that one test alone shows is no claim: it may be hidden.
    """
    lists = [[m for m in f.modes if m.explained_by == "mode"] for f in (base, new)]
    hz = [np.array([m.frequency_hz for m in modes]) for modes in lists]
    widths = [np.array([_reach(m) for m in modes]) for modes in lists]
    pairs = []
    for one, two in zip(*like_speeds(hz[0], hz[1], within_rpm=np.inf), strict=True):
        if abs(hz[1][two] - hz[0][one]) <= max(widths[0][one], widths[1][two]):
            pairs.append((int(one), int(two)))
    records = [_mode_record(lists[0][one], lists[1][two]) for one, two in pairs]
    for side, modes in zip(("base", "new"), lists, strict=True):
        seen = {pair[0 if side == "base" else 1] for pair in pairs}
        records += [
            {"only_in": side, "frequency_hz": m.frequency_hz, "changed": False, "p_value": None}
            for n, m in enumerate(modes) if n not in seen
        ]  # fmt: skip
    p_values = np.array([np.nan if r["p_value"] is None else r["p_value"] for r in records], dtype=np.float64)
    for record, says in zip(records, claimed(p_values, q=q), strict=True):
        record["changed"] = bool(says)
    return sorted(records, key=lambda record: float(record["frequency_hz"]))


def _error_of(mode: ModeFinding, key: str) -> float:
    """Standard error of the estimate ``key`` of a ``mode``; infinite where its interval is not known."""
    ends = known(getattr(mode, f"{key}_ci95"))
    return np.inf if ends is None else error_of(getattr(mode, key) or 0.0, ends)


def _reach(mode: ModeFinding) -> float:
    frequency, damping = mode.frequency_hz, mode.damping_ratio or 0.0
    error = _error_of(mode, "frequency_hz")
    reach = NUMBERS.mode_reach
    return max(reach * error, reach * frequency * damping, NUMBERS.least_reach * frequency)


def _mode_record(one: ModeFinding, two: ModeFinding) -> dict[str, Any]:
    record: dict[str, Any] = {"only_in": None, "frequency_hz": one.frequency_hz}
    chances = []
    for key, name in (("frequency_hz", "shift_hz"), ("damping_ratio", "damping_change")):
        errors = [_error_of(mode, key) for mode in (one, two)]
        error = float(np.hypot(errors[0], errors[1]))
        shift = float(getattr(two, key) or 0.0) - float(getattr(one, key) or 0.0)
        record |= {name: shift, f"{name}_ci95": interval(shift, error)}
        chances.append(1.0 if shift == 0 else 2 * float(ndtr(-abs(shift) / error)) if error > 0 else 0.0)
    record["new_frequency_hz"] = two.frequency_hz
    return {**record, "p_value": min(1.0, 2 * min(chances)), "changed": False}


def _unbalance_record(one: OrderChange, found: Unbalance) -> dict[str, Any]:
    turned = float(np.degrees(cmath.phase(found.factor)))
    half = found.turned_deg_ci95
    law_half = half_width(found.freedom) * found.square_law_error
    return {
        "channel": found.channel,
        "order": found.order,
        "unit": found.unit,
        "changed": one.changed,
        "explains": one.changed and found.explains,
        "factor": abs(found.factor),
        "factor_ci95": list(found.size_ci95),
        "turned_deg": turned if half < 180.0 else None,
        "turned_deg_ci95": [turned - half, turned + half] if half < 180.0 else None,
        "one_factor_p": found.factor_fits,
        "square_law_amplitude": abs(found.square_law),
        "square_law_amplitude_ci95": [max(abs(found.square_law) - law_half, 0.0), abs(found.square_law) + law_half],
        "square_law_phase_deg": float(np.degrees(cmath.phase(found.square_law))),
        "square_law_p": found.square_law_fits,
        "reference_rpm": found.reference_rpm,
        "n_speeds": len(found.speed_rpm),
    }


def _known_mass(base: Tested, new: Tested) -> tuple[TrialBalance | None, str]:
    """Residual unbalance before and after a known change of mass, or None and why; "" where no mass was changed.

    No engine is needed for masses on the shaft.
    """
    try:
        added = _masses_between(base.run, new.run)
    except ValidationError as error:
        return None, f"the stated masses cannot be read: {error.errors()[0]['msg']}"
    if not added:
        return None, ""
    maps = _order_maps((base, new))
    if not maps:
        return None, "not both tests have an order map"
    return trial_mass(maps[0], maps[1], added=added, engine=_engine(base.run))


def _masses_between(base: Mapping[str, Any], new: Mapping[str, Any]) -> tuple[AddedMass, ...]:
    """Masses put on between two tests, below 0 where taken off, from what ``run.json`` of ``base`` and ``new`` state.

    A mass that both tests have is no difference. Raises pydantic's ValidationError for a mass that no manifest states.
    """
    records = [(run.get("manifest") or {}).get("added_masses") or [] for run in (base, new)]
    stated = [Counter(AddedMass.model_validate_json(json.dumps(one)) for one in masses) for masses in records]
    put_on, taken_off = stated[1] - stated[0], stated[0] - stated[1]
    off = [mass.model_copy(update={"mass_g": -mass.mass_g}) for mass in taken_off.elements()]
    return (*put_on.elements(), *off)


def _engine(run: Mapping[str, Any]) -> Engine | None:
    try:
        return Engine.model_validate_json(json.dumps(run["engine"])) if run.get("engine") else None
    except ValidationError:
        return None


def _added(base: Tested, new: Tested) -> tuple[complex, str] | None:
    """Mass put on between the tests, as the manifests state it: times exp(i angle), with its unit; None for none.

    In grams at their radius where all sit at one, in g·mm where they do not; masses on the crank and on a piston
    together are no one mass.
    """
    stated = [(test.run.get("manifest") or {}).get("added_masses") or [] for test in (base, new)]
    every = [mass for side in stated for mass in side]
    if len({mass.get("on", "crank") for mass in every}) != 1:
        return None
    radii = {mass.get("radius_mm") for mass in every}
    arms = [1.0 if len(radii) == 1 else float(mass["radius_mm"] or 0.0) for mass in every]
    signs = [-1.0] * len(stated[0]) + [1.0] * len(stated[1])
    turned = [cmath.rect(float(mass["mass_g"]), np.radians(float(mass.get("angle_deg") or 0.0))) for mass in every]
    added = sum((sign * arm * mass for sign, arm, mass in zip(signs, arms, turned, strict=True)), 0j)
    return (complex(added), "g" if len(radii) == 1 else "g·mm") if abs(added) > 0 else None


def _masses(base: Tested, new: Tested, unbalances: Sequence[tuple[OrderChange, Unbalance]]) -> list[dict[str, Any]]:
    """Unbalance before and after in grams, where the manifests differ by a stated mass."""
    stated = _added(base, new)
    if stated is None:
        return []
    records = []
    for one, found in unbalances:
        if one.order == 1.0 and (made := weighed(one, found, stated[0])) is not None:
            records.append(_mass_record(one, made, stated[1]))
    return records


def _mass_record(one: OrderChange, made: Weighed, unit: str) -> dict[str, Any]:
    half = half_width(made.freedom) * made.error
    record: dict[str, Any] = {"channel": one.channel, "unit": unit, "response_unit": one.unit, "added": abs(made.added)}
    for name, value in (("before", made.before), ("after", made.after)):
        record |= {name: abs(value), f"{name}_ci95": [max(abs(value) - half, 0.0), abs(value) + half]}
        record[f"{name}_angle_deg"] = float(np.degrees(cmath.phase(value))) if half < abs(value) else None
    spread = Z95 * made.per_unit_error
    record["response_per_unit"] = [
        {
            "speed_rpm": float(rpm),
            "response": abs(value),
            "response_ci95": [max(abs(value) - reach, 0.0), abs(value) + reach],
        }
        for rpm, value, reach in zip(made.speed_rpm, made.per_unit, spread, strict=True)
    ]  # fmt: skip
    return record


def _why_not_closed(base: Tested, new: Tested) -> str:
    """Why neither test closed its balance; empty where one did."""
    sides = (new, base)
    if any(test.findings.balance is not None for test in sides):
        return ""
    return next((reason for test in sides if (reason := test.findings.balance_reason or "")), "")


def change_datasets(made: Compared) -> dict[str, xr.Dataset]:
    """Dataset ``order_change`` of a comparison ``made``, by that name; none where no order was compared."""
    return {"order_change": _order_dataset(made.orders)} if made.orders else {}


def _order_dataset(changes: Sequence[OrderChange]) -> xr.Dataset:
    """Change of each order, rows (line, speed): a line is an order in a channel."""
    dims = ("line", "speed")

    def rows(of: Any, units: str, text: str) -> tuple[Any, ...]:
        values: NDArray[Any] = np.stack([np.asarray(of(one)) for one in changes])
        return dims, values, {"units": units, "long_name": text}

    def column(of: Any, text: str) -> tuple[Any, ...]:
        return "line", np.array([of(one) for one in changes]), {"units": "1", "long_name": text}

    return xr.Dataset(
        {
            "base_amplitude": rows(lambda one: one.base.amplitude, "see unit", "peak amplitude in the first test"),
            "new_amplitude": rows(lambda one: one.new.amplitude, "see unit", "peak amplitude in the second test"),
            "difference": rows(lambda one: one.difference, "see unit", "second less first"),
            "difference_low": rows(lambda one: one.difference_ci95[:, 0], "see unit", "lower end of its 95 % interval"),
            "difference_high": rows(lambda one: one.difference_ci95[:, 1], "see unit", "upper end"),
            "ratio_db": rows(lambda one: one.ratio_db, "dB", "second over first"),
            "ratio_db_low": rows(lambda one: one.ratio_db_ci95[:, 0], "dB", "lower end of its 95 % interval"),
            "ratio_db_high": rows(lambda one: one.ratio_db_ci95[:, 1], "dB", "upper end"),
            "vector_change": rows(lambda one: one.vector_change, "see unit", "phasor, second less first"),
            "p_value": rows(lambda one: one.p_value, "1", "chance of so large a difference where nothing changed"),
            "changed": rows(lambda one: one.changed_at, "1", "1 where a change is claimed"),
            "order": column(lambda one: one.order, "cycles per crank revolution"),
            "channel": column(lambda one: one.channel, "name of the channel"),
            "unit": column(lambda one: one.unit, "unit of the channel"),
            "new_speed": ("speed", changes[0].new_rpm, {"units": "min-1", "long_name": "speed in the second test"}),
        },
        coords={"speed": ("speed", changes[0].base_rpm, {"units": "min-1", "long_name": "speed in the first test"})},
    )
