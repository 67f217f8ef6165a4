"""Comparison of two tests, or of one test over time: what changed, how sure, what explains it, what else differs."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from operator import attrgetter
from typing import Any, Literal, NamedTuple, TypeVar, get_args

import numpy as np
import xarray as xr
from pydantic import ValidationError
from scipy.special import ndtr

from crankorder.comparison import (
    FIRING,
    PROGRAM,
    REPEATS,
    SCHEMA_VERSION,
    Cause,
    ChannelCompared,
    Comparison,
    Confound,
    Explanation,
    ModeShift,
    OrderChangeRecord,
    Part,
    Severity,
    Trend,
)
from crankorder.engine.definition import Engine
from crankorder.engine.machine_parts import AddedMass
from crankorder.findings import Findings, ModeFinding, TrialBalance
from crankorder.identify.mass_change import NUMBERS as MASS_CHANGE
from crankorder.identify.mass_change import balance_changes, trial_mass, unbalance_change
from crankorder.identify.order_changes import NUMBERS as ORDER_CHANGES
from crankorder.identify.order_changes import (
    TO_DB,
    Line,
    OrderChange,
    Tested,
    like_speeds,
    order_changes,
    order_maps,
    run_trends,
)
from crankorder.orders.fixed_lines import lines_of_findings
from crankorder.orders.intervals import claimed, error_of, interval
from crankorder.orders.track_rows import REACH_BINS
from crankorder.quantities import is_cylinder_pressure
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
    refused = {doubt.channel: doubt.words for doubt in doubts if (doubt.severity, doubt.part) == ("invalid", "channel")}
    channels = [channel.name for channel in base.findings.channels if channel.name not in refused]
    within = max(float(test.run["settings"]["orders"]["speed_bin_rpm"]) for test in (base, new))
    phases = not any((doubt.severity, doubt.part) == ("weakens", "phases") for doubt in doubts)
    speeds, orders, changes = order_changes(base, new, channels, within_rpm=within, q=q, phases=phases)
    modes = _mode_shifts(base.findings, new.findings) if "modes" in base.comparable & new.comparable else []
    modes = _with_claims(modes, q=q)
    moved, by_modes = _by_modes(changes, modes, q=q)
    gains = _gains(changes)
    units = [{channel.name: channel.unit for channel in test.findings.channels} for test in tests]
    shared = [name for name in channels if all(of_test.get(name) == units[0][name] for of_test in units)]
    unbalances = [found for c in changes if c.order in (1.0, 2.0) and (found := unbalance_change(c))]
    explaining = [factor for record, factor in unbalances if record.explains]
    trial, trial_reason = _trial_mass(base, new)
    compared_channels = (
        ChannelCompared(
            name=name, unit=unit, compared=name in channels, reason=refused.get(name, ""), **gains.get(name, {})
        )
        for name, unit in {**units[-1], **units[0]}.items()
    )
    closed = base.findings.balance or new.findings.balance
    why_not = "" if closed else new.findings.balance_reason or base.findings.balance_reason or ""
    document = Comparison(
        schema_version=SCHEMA_VERSION, base=base.name, new=new.name, runs=tuple(test.name for test in tests),
        false_discovery_rate=q, headline=(), cause=Explanation(cause="not comparable", orders=()), speeds=speeds,
        channels=tuple(compared_channels),
        orders=tuple(
            replace(_order_record(change, base, new), by_modes_hz=moved if of_modes else ())
            for change, of_modes in zip(changes, by_modes, strict=True)
        ),
        modes=tuple(sorted(modes, key=lambda mode: mode.frequency_hz)),
        unbalance=tuple(record for record, _ in unbalances), trial_mass=trial, trial_mass_reason=trial_reason,
        balance=balance_changes(base.findings, new.findings, explaining), balance_reason=why_not,
        trend=tuple(_with_claims(run_trends(tests, orders, shared, within_rpm=within), q=q)), confounds=tuple(doubts),
    )  # fmt: skip
    datasets = {"order_change": _order_dataset(changes)} if changes else {}
    return Compared(replace(document, cause=_explanation(document)), datasets)


def _with_claims(records: Sequence[R], *, q: float) -> list[R]:
    """The ``records`` with what is claimed of them at a false-discovery rate of ``q``."""
    claims = claimed(np.array([record.p_value for record in records], dtype=np.float64), q=q)
    return [replace(record, changed=bool(claim)) for record, claim in zip(records, claims, strict=True)]


def _beyond_shifts(change: OrderChange, shifts_hz: Sequence[tuple[float, float]]) -> OrderChange:
    """What of ``change`` is left beyond what modes that moved, each from and to ``shifts_hz``, may make of an order.

    As f0 becomes f1, the response of a mode at f changes by |f1² - f0²| / |f1² - f²| of it where its stiffness changed,
    by (f / f0)² times that where its mass did. Other modes dilute that, but near zeros of the whole response.
    """
    hertz, base = change.order * change.base_rpm / 60.0, change.base
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = [
            np.maximum(1.0, np.square(hertz / was)) * abs(to**2 - was**2) / np.abs(to**2 - hertz**2)
            for was, to in shifts_hz
        ]
        most = np.nan_to_num(np.sum(moved, axis=0), nan=np.inf) * base.amplitude
        part = np.fmin(1.0, most / np.abs(change.vector_change))
    amplitude = base.amplitude + np.clip(change.difference, -most, most)
    return replace(change, base=replace(base, amplitude=amplitude, vector=base.vector + part * change.vector_change))


def _by_modes(
    changes: Sequence[OrderChange], modes: Sequence[ModeShift], *, q: float
) -> tuple[tuple[float, ...], Sequence[bool]]:
    """Natural frequencies that moved, and which of the ``changes`` that are claimed these may explain whole."""
    moved = [(mode, ends) for mode in modes if mode.moved and (ends := known(mode.shift_hz_ci95))]
    shifts = [(mode.frequency_hz, mode.frequency_hz + max(ends, key=abs)) for mode, ends in moved]
    if not (shifts and changes):
        return (), [False] * len(changes)
    left = claimed(np.array([_beyond_shifts(change, shifts).p_all for change in changes]), q=q)
    of_modes = [bool(change.changed and not more) for change, more in zip(changes, left, strict=True)]
    return tuple(mode.frequency_hz for mode, _ in moved), of_modes


def _together(changes: Sequence[OrderChange]) -> OrderChange:
    """The ``changes`` as one over all their orders and speeds, whose mean ratio is one factor of all."""

    def joined(lines: Sequence[Line]) -> Line:
        values = ([np.broadcast_to(getattr(line, field.name), line.error.shape) for line in lines]
                  for field in fields(Line))  # fmt: skip
        return Line(*map(np.concatenate, values))

    rpm = np.concatenate([change.base_rpm for change in changes])
    return OrderChange(rpm, rpm, joined([change.base for change in changes]), joined([c.new for c in changes]))


def _gains(changes: Sequence[OrderChange]) -> dict[str, Any]:
    """Keys of ChannelCompared of the one channel whose orders all changed by one factor, by its name; else none."""
    channels = list(dict.fromkeys(change.channel for change in changes))
    means = {name: _together([change for change in changes if change.channel == name]).mean for name in channels}
    lone = [name for name, mean in means.items() if not mean.p_value >= MASS_CHANGE.fit_chance]
    if len(lone) != 1 or len(channels) < 2 or any(change.phase_only for change in changes):
        return {}
    orders = [change for change in changes if change.changed and change.channel == lone[0]]
    # NaN, of one value alone, tells no common factor
    if len(orders) < 2 or not all(mean.p_alike >= MASS_CHANGE.fit_chance for mean in means.values()):
        return {}
    mean = means[lone[0]]
    gain, low, high = (float(np.exp(decibels / TO_DB)) for decibels in (mean.ratio_db, *mean.ci95_db))
    return {lone[0]: {"gain": gain, "gain_ci95": (low, high)}}


def _explanation(comparison: Comparison) -> Explanation:
    """What explains the changes best: the cause in one word or two, and the orders that it concerns."""
    changed = [record for record in comparison.orders if record.changed and not record.by_modes_hz]
    orders = tuple(sorted({record.order for record in changed}))
    grown = tuple(sorted({trend.order for trend in comparison.trend if trend.grows}))
    compared_modes = [mode for mode in comparison.modes if mode.only_in is None]
    moved = any(mode.changed for mode in compared_modes)
    explained = any(unbalance.explains and unbalance.order in orders for unbalance in comparison.unbalance)
    moved_mark = all(record.phase_only for record in changed)  # rather than masses
    causes: tuple[tuple[Cause, bool], ...] = (
        ("not comparable", not (comparison.orders or compared_modes)),
        ("gain", any(channel.gain for channel in comparison.channels)),
        ("growing line", not orders and bool(grown) and not any(record.by_modes_hz for record in comparison.orders)),
        ("natural frequencies", moved),
        ("nothing changed", not orders),
        ("unbalance", explained and orders == (1.0,)),
        ("moving masses", explained and not moved_mark and set(orders) <= {1.0, 2.0}),
        ("orders", True),
    )
    cause, *further = [cause for cause, holds in causes if holds]
    besides = further[0] if cause == "natural frequencies" and orders else None
    return Explanation(cause=cause, orders=grown if cause == "growing line" else orders, besides=besides)


def _explained(change: OrderChange, base: Tested, new: Tested) -> str | None:
    """What the findings of the second test, else of the first, say that makes the order; None for neither."""
    for test in (new, base):
        near = [line for line in test.findings.orders if abs(line.order - change.order) < ORDER_CHANGES.same_order]
        if near:
            best = min(near, key=lambda line: (line.channel != change.channel, -line.amplitude))
            return best.explained_by or None
    return None


def _order_record(change: OrderChange, base: Tested, new: Tested) -> OrderChangeRecord:
    best = int(np.nanargmax(np.abs(change.difference) / np.maximum(change.base.error + change.new.error, 1e-300)))
    ratio_db, low_db, high_db = (finite(decibels) for decibels in (change.mean.ratio_db, *change.mean.ci95_db))
    ratio, low, high = (finite(np.exp(decibels / TO_DB)) for decibels in (change.mean.ratio_db, *change.mean.ci95_db))
    return OrderChangeRecord(
        channel=change.channel, order=change.order, unit=change.unit, locked=change.locked,
        explained_by=_explained(change, base, new),
        changed=change.changed, phase_only=change.phase_only, p_value=change.p_all,
        ratio=ratio, ratio_ci95=(low, high), ratio_db=ratio_db, ratio_db_ci95=(low_db, high_db),
        alike_p=finite(change.mean.p_alike),
        speed_rpm=finite(change.base_rpm[best]), base_amplitude=float(change.base.amplitude[best]),
        new_amplitude=float(change.new.amplitude[best]), difference=float(change.difference[best]),
        difference_ci95=(float(change.difference_ci95[best, 0]), float(change.difference_ci95[best, 1])),
        n_speeds=len(change.base_rpm), n_changed=int(np.count_nonzero(change.changed_at)),
        undecided_rpm=tuple(change.base_rpm[change.undecided_at].tolist()), hidden_by=_hidden_by(change, base, new),
    )  # fmt: skip


def _hidden_by(change: OrderChange, base: Tested, new: Tested) -> str | None:
    """Names of the lines of one frequency that the order of ``change`` meets where it is undecided; None for none."""
    places = change.base_rpm[change.undecided_at] / 60.0
    reach = REACH_BINS * float(np.diff(base.maps["order_map"]["order"].values[:2])[0])
    lines = [line for test in (base, new) for line in lines_of_findings(test.findings)]
    met = (line.name for line in lines if np.any(np.abs(line.frequency_hz / places - change.order) <= reach))
    return " and ".join(dict.fromkeys(met)) or None


def _mode_shifts(base: Findings, new: Findings) -> list[ModeShift]:
    """Shifts of the natural frequencies of both tests, and those of one test without; no claim made yet.

    ``base`` and ``new`` are findings; modes are matched with the nearest within three damping bandwidths or standard
    errors, and at least 5 %. A mode that one test alone shows is no claim: it may be hidden.
    """
    lists = [[mode for mode in findings.modes if mode.explained_by == "mode"] for findings in (base, new)]
    hz = [np.array([mode.frequency_hz for mode in modes]) for modes in lists]
    pairs = [
        (int(at), int(to))
        for at, to in zip(*like_speeds(*hz, within_rpm=np.inf), strict=True)
        if abs(hz[1][to] - hz[0][at]) <= max(_reach(lists[0][at]), _reach(lists[1][to]))
    ]
    shifts = [_mode_shift(lists[0][at], lists[1][to]) for at, to in pairs]
    sides: tuple[Literal["base", "new"], ...] = ("base", "new")
    for side, name in enumerate(sides):
        alone = [mode for at, mode in enumerate(lists[side]) if all(pair[side] != at for pair in pairs)]
        shifts += [ModeShift(only_in=name, frequency_hz=mode.frequency_hz, p_value=None) for mode in alone]
    return shifts


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
    for key, same in (("frequency_hz", NUMBERS.same_share * base.frequency_hz), ("damping_ratio", 0.0)):
        error = float(np.hypot(_error_of(base, key), _error_of(new, key)))
        shift = float(getattr(new, key) or 0.0) - float(getattr(base, key) or 0.0)
        shifts.append((shift, interval(shift, error)))
        # of so large a shift where it is ``same`` at most
        tails = ndtr(np.array([same - abs(shift), -same - abs(shift)]) / error) if error > 0 else abs(shift) <= same
        chances.append(min(1.0, float(np.sum(tails))))
    (shift, shift_ends), (damping, damping_ends) = shifts
    return ModeShift(
        only_in=None, frequency_hz=base.frequency_hz, new_frequency_hz=new.frequency_hz,
        shift_hz=shift, shift_hz_ci95=shift_ends, damping_change=damping, damping_change_ci95=damping_ends,
        p_value=min(1.0, 2 * min(chances)),
    )  # fmt: skip


def _trial_mass(base: Tested, new: Tested) -> tuple[TrialBalance | None, str]:
    """Residual unbalance before and after a change of mass that the manifests state, or None and why; "" without one.

    A mass that both tests have is no difference; one that was taken off is below 0. No engine is needed for masses on
    the shaft.
    """
    lists = [(test.run.get("manifest") or {}).get("added_masses") or [] for test in (base, new)]
    try:
        stated = [Counter(AddedMass.model_validate_json(json.dumps(mass)) for mass in masses) for masses in lists]
    except ValidationError as error:
        return None, f"the stated masses cannot be read: {error.errors()[0]['msg']}"
    put_on, taken_off = stated[1] - stated[0], stated[0] - stated[1]
    off = [mass.model_copy(update={"mass_g": -mass.mass_g}) for mass in taken_off.elements()]
    maps, engine, added = order_maps((base, new)), None, (*put_on.elements(), *off)
    if not added or not maps:
        return None, "not both tests have an order map" if added else ""
    with suppress(ValidationError):  # of a test without an engine, too
        engine = Engine.model_validate_json(json.dumps(base.run.get("engine")))
    return trial_mass(*maps, added=added, engine=engine)


def _order_dataset(changes: Sequence[OrderChange]) -> xr.Dataset:
    """Change of each order, rows (line, speed): a line is an order in a channel."""
    variables: dict[str, Any] = {}

    def add(dims: tuple[str, ...], name: str, rows: Any, units: str, text: str) -> None:
        variables[name] = (dims, np.array(rows), {"units": units, "long_name": text})

    for name, path, units, text in (
        ("base_amplitude", "base.amplitude", "see unit", "peak amplitude in the first test"),
        ("new_amplitude", "new.amplitude", "see unit", "peak amplitude in the second test"),
        ("difference", "difference", "see unit", "second less first"),
        ("ratio_db", "ratio_db", "dB", "second over first"),
        ("vector_change", "vector_change", "see unit", "phasor, second less first"),
        ("p_value", "p_value", "1", "chance of so large a difference where nothing changed"),
        ("changed", "changed_at", "1", "1 where a change is claimed"),
    ):
        add(("line", "speed"), name, list(map(attrgetter(path), changes)), units, text)
        if path in ("difference", "ratio_db"):
            low, high = np.moveaxis(np.array(list(map(attrgetter(f"{path}_ci95"), changes))), -1, 0)
            add(("line", "speed"), f"{name}_low", low, units, "lower end of its 95 % interval")
            add(("line", "speed"), f"{name}_high", high, units, "upper end")
    add(("line",), "order", [change.order for change in changes], "1", "cycles per crank revolution")
    add(("line",), "channel", [change.channel for change in changes], "1", "name of the channel")
    add(("line",), "unit", [change.unit for change in changes], "1", "unit of the channel")
    add(("speed",), "new_speed", changes[0].new_rpm, "min-1", "speed in the second test")
    in_first = {"units": "min-1", "long_name": "speed in the first test"}
    return xr.Dataset(variables, coords={"speed": ("speed", changes[0].base_rpm, in_first)})


CONFOUND_NUMBERS = MethodNumbers("5-identify-changes.toml", "confounds")


def _speeds_text(order_map: xr.Dataset) -> str:
    rpm = order_map["speed"].values[np.isfinite(order_map["speed"].values)]
    return f"{len(rpm)} speeds, {rpm.min():.0f} to {rpm.max():.0f} rpm" if len(rpm) else "not known"


_RULES: tuple[tuple[str, str | Callable[[xr.Dataset], Any], Severity, Part, str], ...] = (
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
    ("highest order", lambda order_map: float(order_map["order"].values[-1]), "harmless", "orders",
     "orders are compared up to the lower"),
    ("phase reference", lambda order_map: str(order_map.attrs.get("phase_reference")), "weakens", "phases",
     "phases count from other marks: amplitudes only are compared"),
    ("speeds", _speeds_text, "weakens", "all", "only speeds that both have are compared; nothing is interpolated"),
)  # fmt: skip
"""What differs, its path in run.json or how an order map tells it, what it does, to which part, and why."""


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
    tests, maps = (base, new), order_maps((base, new))
    differences: list[Confound] = []
    for what, source, severity, part, words in _RULES:
        values = [_at(test, source) for test in tests] if isinstance(source, str) else list(map(source, maps))
        if values[:1] != values[1:]:
            differences.append(_confound(what, severity, part, values, words))
    for concerns in (_channels, _maps, _firing, _repeats, _quality, _versions, _same_inputs):
        differences += concerns(tests)
    return sorted(differences, key=lambda confound: get_args(Severity).index(confound.severity))


Tests = tuple[Tested, Tested]


def _confound(what: str, severity: Severity, part: Part, values: list[Any], words: str, channel: str = "") -> Confound:
    base, new = map(_text, values)
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


def _channels(tests: Tests) -> Iterator[Confound]:
    """Channels of one test only, and those whose unit, sensor or direction is another."""
    base, new = ({channel["name"]: channel for channel in _at(test, "manifest.channels") or []} for test in tests)
    for name in {**base, **new}:
        if name in base and name in new:
            for key, severity, words in _CHANNEL_RULES:
                values = [channels[name].get(key) for channels in (base, new)]
                if values[0] != values[1]:
                    yield _confound(key, severity, "channel", values, words, name)
        else:
            where, there = ("first", ["measured", "missing"]) if name in base else ("second", ["missing", "measured"])
            yield _confound("channel", "invalid", "channel", there, f"only the {where} test has this channel", name)


def _maps(tests: Tests) -> Iterator[Confound]:
    """Whether one test alone has an order map, and frames in number."""
    held = ["held" if "order_map" in test.maps else "missing" for test in tests]
    counts = [int(order_map["n_frames"].values.sum()) for order_map in order_maps(tests)]
    if held[0] != held[1]:
        words = "orders are compared where the results of both tests hold an order map"
        yield _confound("order map", "invalid", "orders", held, words)
    if counts and max(counts) > CONFOUND_NUMBERS.few_frames_ratio * max(min(counts), 1):
        words = "the intervals allow for it: small changes may hide in the shorter test"
        yield _confound("frames averaged", "harmless", "all", counts, words)


def _firing(tests: Tests) -> Iterator[Confound]:
    """Firing against motoring, or another load: by the names of the tests and by pressure channels."""
    words = "combustion changes half orders and whole ones: differences are not the machine's alone"
    names = [f"{_at(test, 'test') or ''} {_at(test, 'manifest.test.engine') or ''}".casefold() for test in tests]
    kinds = {"firing": "firing", "fired": "firing", "motor": "motoring"}
    states = [next((state for word, state in kinds.items() if word in name), "") for name in names]
    levels = [_pressure(order_map) for order_map in order_maps(tests)] or [0.0]
    if all(states) and states[0] != states[1]:
        yield _confound(FIRING, "weakens", "all", states, words)
    elif min(levels) > 0 and max(levels) > CONFOUND_NUMBERS.fired_ratio * min(levels):
        yield _confound("pressure of the cycle", "weakens", "all", [f"{level:.3g} (median)" for level in levels], words)


def _pressure(order_map: xr.Dataset) -> float:
    """Median over speeds of the cylinder pressures' total amplitude; 0 where there is none."""
    rows = list(map(is_cylinder_pressure, order_map["quantity"].values.tolist(), order_map["unit"].values.tolist()))
    energy = order_map["amplitude"].values[np.array(rows, dtype=bool)] ** 2
    return float(np.median(np.sqrt(np.nansum(energy, axis=2)))) if any(rows) else 0.0


def _repeats(tests: Tests) -> Iterator[Confound]:
    """Whether recordings were repeated at a speed: only then is known by how much a test differs from itself."""
    held = [test.maps for test in tests if {"shaft", "order_map"} <= set(test.maps)]
    counts = [(maps["shaft"].sizes["recording"], maps["order_map"].sizes["speed"]) for maps in held]
    values = [f"{recordings} recordings at {speeds} speeds" for recordings, speeds in counts]
    words = "intervals hold for the recordings: by how much a test differs when it is set up again, they do not know"
    if len(held) == len(tests) and any(recordings <= speeds for recordings, speeds in counts):
        yield _confound(REPEATS, "weakens", "all", values, words)


def _quality(tests: Tests) -> Iterator[Confound]:
    """Remarks on the recordings that only one of the tests has."""
    remarks = [Counter((flag["flag"], flag["severity"]) for flag in _at(test, "quality") or []) for test in tests]
    for flag, severity in sorted(set(remarks[0]) ^ set(remarks[1])):
        values = [f"{count[flag, severity]} recordings" for count in remarks]
        weight: Severity = "harmless" if severity == "info" else "weakens"
        words = f"recordings of one test only have this remark ({severity})"
        yield _confound(f"quality: {str(flag).replace('_', ' ')}", weight, "all", values, words)


def _versions(tests: Tests) -> Iterator[Confound]:
    """Versions of the program, or of libraries where the program is the same."""
    codes = [_at(test, "code_sha256") for test in tests]
    base, new = (_at(test, "versions") or {} for test in tests)
    if codes[0] != codes[1]:
        values = [f"{of.get('crankorder')} ({str(code)[:8]})" for of, code in zip((base, new), codes, strict=True)]
        words = "analysed by other versions of the program: run both again with one"
        yield _confound(PROGRAM, "weakens", "all", values, words)
        return
    for name, version in base.items():
        if version != new.get(name):
            yield _confound(f"library {name}", "harmless", "all", [version, new.get(name)], "")


def _same_inputs(tests: Tests) -> Iterator[Confound]:
    base, new = ({recording["sha256"] for recording in _at(test, "inputs") or []} - {None} for test in tests)
    if base & new:
        values = [f"{len(base & new)} of {len(inputs)} recordings" for inputs in (base, new)]
        words = "the same bytes in both tests: they cannot differ"
        yield _confound("shared recordings", "harmless" if base == new else "weakens", "all", values, words)
