"""Two tests, or one test over time, put side by side: one document of what changed, how sure, and what explains it."""

from __future__ import annotations

import cmath
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import xarray as xr

from crankorder.findings import Findings
from crankorder.identify.changes.balance_change import balance_changes
from crankorder.identify.changes.confounds import Confound, confounds
from crankorder.identify.changes.known_mass import known_mass
from crankorder.identify.changes.map_difference import MapDifference, cell_records, map_difference
from crankorder.identify.changes.mark_turn import mark_turn
from crankorder.identify.changes.mass_change import Unbalance, Weighed, unbalance_change, weighed
from crankorder.identify.changes.mode_shifts import mode_shifts
from crankorder.identify.changes.order_changes import NUMBERS as ORDER_CHANGES
from crankorder.identify.changes.order_changes import TO_DB, OrderChange, like_speeds, order_changes, orders_to_compare
from crankorder.identify.changes.run_trends import run_trends
from crankorder.identify.intervals import Z95, half_width

SCHEMA_VERSION = 1
Cause = Literal[
    "nothing changed",
    "unbalance",
    "moving masses",
    "orders",
    "growing line",
    "natural frequencies",
    "map only",
    "not comparable",
]


@dataclass(frozen=True, eq=False)
class Tested:
    """The results of one test: its name, findings, what ``run.json`` states, and its datasets by name."""

    name: str
    findings: Findings
    run: Mapping[str, Any]
    maps: Mapping[str, xr.Dataset]


@dataclass(frozen=True, eq=False)
class Compared:
    """What a comparison gives: the document of ``data_schema/comparison.json``, the orders and the map behind it."""

    document: dict[str, Any]
    orders: list[OrderChange]
    cells: MapDifference | None


def compared(tests: Sequence[Tested], *, q: float, correlated: bool = False) -> Compared:
    """Comparison of the last of ``tests`` with the first, and of several the trend over all.

    Parameters
    ----------
    tests : two or more, in time order
    q : false-discovery rate of the claims, 0 to 1: over map cells, over orders, over modes and over trends, each
    correlated : True claims fewer cells, for any dependence between them
    """
    base, new = tests[0], tests[-1]
    doubts = confounds(base.run, new.run, base.maps, new.maps)
    refused = {one.channel: one for one in doubts if one.severity == "invalid" and one.part == "channel"}
    channels = tuple(c.name for c in base.findings.channels if c.name not in refused)
    within = max(_speed_bin(test) for test in (base, new))
    changes, orders = _orders(base, new, channels, within, q, doubts)
    cells = None
    if not any(d.part == "maps" and d.severity == "invalid" for d in doubts):
        cells = _cells(base, new, channels, within, q, correlated, orders)
    modes = mode_shifts(base.findings, new.findings, q=q)
    unbalances = [(one, found) for one in changes if one.order in (1.0, 2.0) and (found := unbalance_change(one))]
    explaining = [found for one, found in unbalances if one.changed and found.explains]
    trial, trial_reason = known_mass(base.run, new.run, base.maps.get("order_map"), new.maps.get("order_map"))
    trends = _trends(tests, orders, channels, within, q)
    document: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "base": base.name,
        "new": new.name,
        "runs": [test.name for test in tests],
        "false_discovery_rate": q,
        "speeds": _speeds(base, new, within),
        "channels": _channel_records(base, new, channels, refused),
        "cause": _cause(changes, cells, unbalances, channels, modes=modes, trends=trends),
        "orders": [_order_record(one, _explained(one, base, new)) for one in changes],
        "modes": modes,
        "cells": [] if cells is None else cell_records(cells),
        "unbalance": [_unbalance_record(one, found) for one, found in unbalances],
        "masses": _masses(base, new, unbalances),
        "trial_mass": None if trial is None else trial.as_dict(),
        "trial_mass_reason": trial_reason,
        "balance": balance_changes(base.findings, new.findings, explaining),
        "balance_reason": _why_not_closed(base, new),
        "trend": trends,
        "confounds": [_confound_record(one) for one in doubts],
    }
    return Compared(document, changes, cells)


def _channel_records(
    base: Tested, new: Tested, channels: Sequence[str], refused: Mapping[str, Confound]
) -> list[dict[str, Any]]:
    why = {name: one.words for name, one in refused.items()}
    return [
        {"name": name, "unit": unit, "compared": name in channels, "reason": why.get(name, "")}
        for name, unit in _units(base, new).items()
    ]


def _speed_bin(test: Tested) -> float:
    return float(test.run["settings"]["orders"]["speed_bin_rpm"])


def _units(base: Tested, new: Tested) -> dict[str, str]:
    return {c.name: c.unit for test in (new, base) for c in test.findings.channels}


def _speeds(base: Tested, new: Tested, within: float) -> list[dict[str, float]]:
    if "order_map" not in base.maps or "order_map" not in new.maps:
        return []
    values = [test.maps["order_map"]["speed"].values for test in (base, new)]
    one, two = like_speeds(*values, within_rpm=within)
    pairs = zip(values[0][one].tolist(), values[1][two].tolist(), strict=True)
    return [{"base_rpm": a, "new_rpm": b} for a, b in pairs]


def _orders(
    base: Tested, new: Tested, channels: Sequence[str], within: float, q: float, doubts: list[Confound]
) -> tuple[list[OrderChange], list[tuple[float, bool]]]:
    """Changes of all orders, and the orders; where the mark was turned, its turn is taken out and joins ``doubts``."""
    if "order_map" not in base.maps or "order_map" not in new.maps:
        return [], []
    maps = base.maps["order_map"], new.maps["order_map"]
    highest = min(float(item["order"].values[-1]) for item in maps)
    orders = orders_to_compare(base.findings.orders, new.findings.orders, highest)
    phases = not any(one.what == "phase reference" for one in doubts)
    changes = order_changes(*maps, orders, channels, within_rpm=within, q=q, phases=phases)
    found = mark_turn(changes)
    if found is not None:
        words = "the phases of all orders turned in proportion, as those of a mark that was moved do: taken out"
        half = 360.0 * Z95 * found.error_rev
        angle = f"{360.0 * found.turn_rev:.3g}° later, ± {half:.2g}°"
        doubts.append(Confound("angle of the mark", "weakens", "phases", "0°", angle, words))
        changes = order_changes(*maps, orders, channels, within_rpm=within, q=q, turn_rev=found.turn_rev)
    elif any(one.part == "phases" and one.severity == "weakens" for one in doubts):
        changes = order_changes(*maps, orders, channels, within_rpm=within, q=q, phases=False)
    return changes, orders


def _cells(
    base: Tested,
    new: Tested,
    channels: tuple[str, ...],
    within: float,
    q: float,
    correlated: bool,
    orders: Sequence[tuple[float, bool]],
) -> MapDifference | None:
    maps = [test.maps.get("campbell_map") for test in (base, new)]
    if maps[0] is None or maps[1] is None or not channels:
        return None
    locked = [order for order, is_locked in orders if is_locked]
    overlap = [float(test.run["settings"]["campbell"]["overlap"]) for test in (base, new)]
    made = map_difference(
        maps[0],
        maps[1],
        channels,
        within_rpm=within,
        overlap=(overlap[0], overlap[1]),
        q=q,
        correlated=correlated,
        locked_orders=locked,
    )
    return made if len(made.base_rpm) else None


def _cause(
    changes: Sequence[OrderChange],
    cells: MapDifference | None,
    unbalances: Sequence[tuple[OrderChange, Unbalance]],
    channels: Sequence[str],
    *,
    modes: Sequence[Mapping[str, Any]],
    trends: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """What explains the changes best: the cause in one word or two, and the orders that it concerns."""
    orders = sorted({one.order for one in changes if one.changed})
    grown = sorted({float(one["order"]) for one in trends if one["changed"] and one["growth_per_run"] > 0})
    cause: Cause = "orders"
    if not channels or (not changes and cells is None):
        cause = "not comparable"
    elif not orders and grown:
        cause, orders = "growing line", grown
    elif not orders and any(one["changed"] for one in modes):
        cause = "natural frequencies"
    elif not orders:
        cause = "map only" if cells is not None and cells.changed.any() else "nothing changed"
    elif orders == [1.0] and any(found.explains for one, found in unbalances if one.changed):
        cause = "unbalance"
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


def _trends(
    tests: Sequence[Tested], orders: Sequence[tuple[float, bool]], channels: Sequence[str], within: float, q: float
) -> list[dict[str, Any]]:
    maps = [test.maps.get("order_map") for test in tests]
    known = [one for one in maps if one is not None]
    if len(known) < len(tests):
        return []
    shared = [c for c in channels if all(_units(test, test).get(c) == _units(tests[0], tests[0])[c] for test in tests)]
    findings, envelopes = [test.findings for test in tests], [test.maps.get("envelope_map") for test in tests]
    return run_trends(known, findings, envelopes, orders, shared, within_rpm=within, q=q)


def _confound_record(one: Confound) -> dict[str, str]:
    return {
        "what": one.what, "severity": one.severity, "part": one.part, "channel": one.channel,
        "base": one.base, "new": one.new, "words": one.words,
    }  # fmt: skip
