"""Two tests, or one test over time, put side by side: one document of what changed, how sure, and what explains it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
import xarray as xr
from pydantic import ValidationError
from scipy.special import ndtr

from crankorder.comparison import (
    SCHEMA_VERSION,
    Cause,
    ChannelCompared,
    Comparison,
    Confound,
    Explanation,
    ModeShift,
    OrderChangeRecord,
    SpeedPair,
    Trend,
    UnbalanceRecord,
)
from crankorder.engine.definition import Engine
from crankorder.engine.machine_parts import AddedMass
from crankorder.findings import Findings, ModeFinding, TrialBalance
from crankorder.identify.balance.trial_mass import trial_mass
from crankorder.identify.changes.confounds import confounds
from crankorder.identify.changes.mass_change import (
    balance_changes,
    mass_record,
    unbalance_change,
    unbalance_record,
)
from crankorder.identify.changes.order_changes import NUMBERS as ORDER_CHANGES
from crankorder.identify.changes.order_changes import (
    TO_DB,
    OrderChange,
    Tested,
    like_speeds,
    order_changes,
    order_maps,
    orders_to_compare,
)
from crankorder.identify.changes.run_trends import run_trends
from crankorder.identify.intervals import claimed, error_of, interval
from crankorder.records import finite, known
from crankorder.settings import MethodNumbers

R = TypeVar("R", ModeShift, Trend)


NUMBERS = MethodNumbers("5-identify-changes.toml", "mode_shifts")


class Compared(NamedTuple):
    """What a comparison gives: the ``document`` without its sentences, and the ``datasets`` behind it by name."""

    document: Comparison
    datasets: dict[str, xr.Dataset]


def compared(tests: Sequence[Tested], *, q: float) -> Compared:
    """Comparison of the last of ``tests`` with the first, and of several the trend over all.

    Parameters
    ----------
    tests : two or more, in time order; orders are compared where the first and the last have an ``order_map``, natural
        frequencies where both looked for them
    q : false-discovery rate of the claims, 0 to 1: over orders, over modes and over trends, each
    """
    base, new = tests[0], tests[-1]
    doubts = confounds(base, new)
    refused = {
        doubt.channel: doubt.words for doubt in doubts if doubt.severity == "invalid" and doubt.part == "channel"
    }
    channels = [channel.name for channel in base.findings.channels if channel.name not in refused]
    within = max(float(test.run["settings"]["orders"]["speed_bin_rpm"]) for test in (base, new))
    speeds, orders, changes = _orders(base, new, channels, doubts, within=within, q=q)
    modes = _mode_shifts(base.findings, new.findings) if "modes" in base.comparable & new.comparable else []
    units = [{channel.name: channel.unit for channel in test.findings.channels} for test in tests]
    shared = [name for name in channels if all(of_test.get(name) == units[0][name] for of_test in units)]
    unbalances = [(c, u) for c in changes if c.order in (1.0, 2.0) and (u := unbalance_change(c))]
    records = tuple(unbalance_record(unbalance, changed=change.changed) for change, unbalance in unbalances)
    explaining = [unbalance for change, unbalance in unbalances if change.changed and unbalance.explains]
    added, unreadable = _masses_between(base, new)
    masses = [mass_record(change, unbalance, added) for change, unbalance in unbalances if change.order == 1.0]
    trial, trial_reason = _trial_mass(base, new, added)
    order_records = tuple(_order_record(change, _explained(change, base, new)) for change in changes)
    mode_records = tuple(sorted(_with_claims(modes, q=q), key=lambda mode: mode.frequency_hz))
    trends = tuple(_with_claims(run_trends(tests, orders, shared, within_rpm=within), q=q))
    compared_channels = (
        ChannelCompared(name=name, unit=unit, compared=name in channels, reason=refused.get(name, ""))
        for name, unit in {**units[-1], **units[0]}.items()
    )
    closed = base.findings.balance or new.findings.balance
    why_not = "" if closed else new.findings.balance_reason or base.findings.balance_reason or ""
    document = Comparison(
        schema_version=SCHEMA_VERSION, base=base.name, new=new.name, runs=tuple(test.name for test in tests),
        false_discovery_rate=q, headline=(), cause=_explanation(order_records, mode_records, records, trends),
        speeds=speeds, channels=tuple(compared_channels), orders=order_records,
        modes=mode_records, unbalance=records, masses=tuple(mass for mass in masses if mass),
        trial_mass=trial, trial_mass_reason=unreadable or trial_reason,
        balance=balance_changes(base.findings, new.findings, explaining), balance_reason=why_not,
        trend=trends, confounds=tuple(doubts),
    )  # fmt: skip
    return Compared(document, {"order_change": _order_dataset(changes)} if changes else {})


def _with_claims(records: Sequence[R], *, q: float) -> list[R]:
    """The ``records`` with what is claimed of them at a false-discovery rate of ``q``."""
    claims = claimed(np.array([record.p_value for record in records], dtype=np.float64), q=q)
    return [replace(record, changed=bool(claim)) for record, claim in zip(records, claims, strict=True)]


def _orders(
    base: Tested, new: Tested, channels: Sequence[str], doubts: Sequence[Confound], *, within: float, q: float
) -> tuple[tuple[SpeedPair, ...], list[tuple[float, bool]], list[OrderChange]]:
    """Speeds and orders that are compared, and the changes; by amplitude alone where ``doubts`` are of the phases."""
    maps = order_maps((base, new))
    if not maps:
        return (), [], []
    rpm = [order_map["speed"].values for order_map in maps]
    pairs = zip(*like_speeds(*rpm, within_rpm=within), strict=True)
    speeds = tuple(SpeedPair(base_rpm=finite(rpm[0][at]), new_rpm=finite(rpm[1][to])) for at, to in pairs)
    highest = min(float(order_map["order"].values[-1]) for order_map in maps)
    orders = orders_to_compare(base.findings.orders, new.findings.orders, highest)
    with_phases = not any(doubt.part == "phases" and doubt.severity == "weakens" for doubt in doubts)
    changes, of_amplitude = (
        order_changes(maps[0], maps[1], orders, channels, within_rpm=within, q=q, phases=phases)
        for phases in (with_phases, False)
    )
    both = zip(changes, of_amplitude, strict=True)
    return speeds, orders, [replace(change, phase_only=change.changed and not size.changed) for change, size in both]


def _explanation(
    records: Sequence[OrderChangeRecord],
    modes: Sequence[ModeShift],
    unbalances: Sequence[UnbalanceRecord],
    trends: Sequence[Trend],
) -> Explanation:
    """What explains the changes best: the cause in one word or two, and the orders that it concerns."""
    changed = [record for record in records if record.changed]
    orders = tuple(sorted({record.order for record in changed}))
    grown = tuple(sorted({trend.order for trend in trends if trend.grows}))
    explained = any(unbalance.explains for unbalance in unbalances)
    cause: Cause = "orders"
    if not (records or any(mode.only_in is None for mode in modes)):
        cause = "not comparable"
    elif not orders and grown:
        cause, orders = "growing line", grown
    elif not orders and any(mode.changed for mode in modes):
        cause = "natural frequencies"
    elif not orders:
        cause = "nothing changed"
    elif orders == (1.0,) and explained:
        cause = "unbalance"
    elif all(record.phase_only for record in changed):  # a mark that moved, rather than masses
        cause = "orders"
    elif set(orders) <= {1.0, 2.0} and explained:
        cause = "moving masses"
    return Explanation(cause=cause, orders=orders)


def _explained(change: OrderChange, base: Tested, new: Tested) -> str | None:
    """What the findings of the second test, else of the first, say that makes the order; None for neither."""
    for test in (new, base):
        near = [line for line in test.findings.orders if abs(line.order - change.order) < ORDER_CHANGES.same_order]
        if near:
            best = min(near, key=lambda line: (line.channel != change.channel, -line.amplitude))
            return best.explained_by or None
    return None


def _order_record(change: OrderChange, explained: str | None) -> OrderChangeRecord:
    best = int(np.nanargmax(np.abs(change.difference) / np.maximum(change.base.error + change.new.error, 1e-300)))
    ratio_db, low_db, high_db = (finite(decibels) for decibels in (change.mean.ratio_db, *change.mean.ci95_db))
    ratio, low, high = (finite(np.exp(decibels / TO_DB)) for decibels in (change.mean.ratio_db, *change.mean.ci95_db))
    return OrderChangeRecord(
        channel=change.channel, order=change.order, unit=change.unit, locked=change.locked, explained_by=explained,
        changed=change.changed, phase_only=change.phase_only, p_value=change.p_all,
        ratio=ratio, ratio_ci95=(low, high), ratio_db=ratio_db, ratio_db_ci95=(low_db, high_db),
        alike_p=finite(change.mean.p_alike),
        speed_rpm=finite(change.base_rpm[best]), base_amplitude=float(change.base.amplitude[best]),
        new_amplitude=float(change.new.amplitude[best]), difference=float(change.difference[best]),
        difference_ci95=(float(change.difference_ci95[best, 0]), float(change.difference_ci95[best, 1])),
        n_speeds=len(change.base_rpm), n_changed=int(np.count_nonzero(change.changed_at)),
    )  # fmt: skip


def _mode_shifts(base: Findings, new: Findings) -> list[ModeShift]:
    """Shifts of the natural frequencies of both tests, and those of one test without; no claim made yet.

    ``base`` and ``new`` are findings; modes are matched with the nearest within three damping bandwidths or 5 %. A mode
    that one test alone shows is no claim: it may be hidden.
    """
    lists = [[mode for mode in findings.modes if mode.explained_by == "mode"] for findings in (base, new)]
    hz = [np.array([mode.frequency_hz for mode in modes]) for modes in lists]
    pairs = [
        (int(at), int(to))
        for at, to in zip(*like_speeds(*hz, within_rpm=np.inf), strict=True)
        if abs(hz[1][to] - hz[0][at]) <= max(_reach(lists[0][at]), _reach(lists[1][to]))
    ]
    shifts = [_mode_shift(lists[0][at], lists[1][to]) for at, to in pairs]
    alone = (
        ModeShift(only_in="new" if side else "base", frequency_hz=mode.frequency_hz, p_value=None)
        for side, modes in enumerate(lists)
        for number, mode in enumerate(modes)
        if all(pair[side] != number for pair in pairs)
    )
    return [*shifts, *alone]


def _error_of(mode: ModeFinding, key: str) -> float:
    """Standard error of the estimate ``key`` of a ``mode``; infinite where its interval is not known."""
    ends = known(getattr(mode, f"{key}_ci95"))
    return np.inf if ends is None else error_of(getattr(mode, key) or 0.0, ends)


def _reach(mode: ModeFinding) -> float:
    frequency, damping = mode.frequency_hz, mode.damping_ratio or 0.0
    width = NUMBERS.mode_reach * max(_error_of(mode, "frequency_hz"), frequency * damping)
    return float(max(width, NUMBERS.least_reach * frequency))


def _mode_shift(base: ModeFinding, new: ModeFinding) -> ModeShift:
    shifts, chances = [], []
    for key in ("frequency_hz", "damping_ratio"):
        error = float(np.hypot(_error_of(base, key), _error_of(new, key)))
        shift = float(getattr(new, key) or 0.0) - float(getattr(base, key) or 0.0)
        shifts.append((shift, interval(shift, error)))
        chances.append(1.0 if shift == 0 else 2 * float(ndtr(-abs(shift) / error)) if error > 0 else 0.0)
    (shift, shift_ends), (damping, damping_ends) = shifts
    return ModeShift(
        only_in=None, frequency_hz=base.frequency_hz, new_frequency_hz=new.frequency_hz,
        shift_hz=shift, shift_hz_ci95=shift_ends, damping_change=damping, damping_change_ci95=damping_ends,
        p_value=min(1.0, 2 * min(chances)),
    )  # fmt: skip


def _masses_between(base: Tested, new: Tested) -> tuple[tuple[AddedMass, ...], str]:
    """Masses put on between two tests, below 0 where taken off, as the manifests state; and why they cannot be read.

    A mass that both tests have is no difference.
    """
    lists = [(test.run.get("manifest") or {}).get("added_masses") or [] for test in (base, new)]
    try:
        stated = [Counter(AddedMass.model_validate_json(json.dumps(mass)) for mass in masses) for masses in lists]
    except ValidationError as error:
        return (), f"the stated masses cannot be read: {error.errors()[0]['msg']}"
    put_on, taken_off = stated[1] - stated[0], stated[0] - stated[1]
    off = [mass.model_copy(update={"mass_g": -mass.mass_g}) for mass in taken_off.elements()]
    return (*put_on.elements(), *off), ""


def _trial_mass(base: Tested, new: Tested, added: tuple[AddedMass, ...]) -> tuple[TrialBalance | None, str]:
    """Residual unbalance before and after a known change of mass, or None and why; "" where no mass was changed.

    No engine is needed for masses on the shaft.
    """
    maps, engine = order_maps((base, new)), None
    if not added or not maps:
        return None, "not both tests have an order map" if added else ""
    if base.run.get("engine"):
        with suppress(ValidationError):
            engine = Engine.model_validate_json(json.dumps(base.run["engine"]))
    return trial_mass(*maps, added=added, engine=engine)


def _order_dataset(changes: Sequence[OrderChange]) -> xr.Dataset:
    """Change of each order, rows (line, speed): a line is an order in a channel."""
    by_speed = (
        ("base_amplitude", [c.base.amplitude for c in changes], "see unit", "peak amplitude in the first test"),
        ("new_amplitude", [c.new.amplitude for c in changes], "see unit", "peak amplitude in the second test"),
        ("difference", [c.difference for c in changes], "see unit", "second less first"),
        ("difference_low", [c.difference_ci95[:, 0] for c in changes], "see unit", "lower end of its 95 % interval"),
        ("difference_high", [c.difference_ci95[:, 1] for c in changes], "see unit", "upper end"),
        ("ratio_db", [c.ratio_db for c in changes], "dB", "second over first"),
        ("ratio_db_low", [c.ratio_db_ci95[:, 0] for c in changes], "dB", "lower end of its 95 % interval"),
        ("ratio_db_high", [c.ratio_db_ci95[:, 1] for c in changes], "dB", "upper end"),
        ("vector_change", [c.vector_change for c in changes], "see unit", "phasor, second less first"),
        ("p_value", [c.p_value for c in changes], "1", "chance of so large a difference where nothing changed"),
        ("changed", [c.changed_at for c in changes], "1", "1 where a change is claimed"),
    )
    by_line = (
        ("order", [c.order for c in changes], "cycles per crank revolution"),
        ("channel", [c.channel for c in changes], "name of the channel"),
        ("unit", [c.unit for c in changes], "unit of the channel"),
    )
    in_new = ("speed", changes[0].new_rpm, {"units": "min-1", "long_name": "speed in the second test"})
    return xr.Dataset(
        {
            **{name: (("line", "speed"), np.stack(rows), {"units": unit, "long_name": text})
               for name, rows, unit, text in by_speed},
            **{name: ("line", np.array(values), {"units": "1", "long_name": text}) for name, values, text in by_line},
            "new_speed": in_new,
        },
        coords={"speed": ("speed", changes[0].base_rpm, {"units": "min-1", "long_name": "speed in the first test"})},
    )  # fmt: skip
