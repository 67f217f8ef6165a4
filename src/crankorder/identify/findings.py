"""Findings of a test: every line with its number, its 95 % interval and its evidence."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import stdtrit

from crankorder.identify.crossings import crossings
from crankorder.identify.explain import Sources, explain_fixed, explain_order
from crankorder.identify.folds import fold_flags
from crankorder.identify.modes import Mode, find_modes
from crankorder.identify.order_lines import Z95, OrderLine, order_lines, orders_agreed
from crankorder.quantities import QualityFlag, flags_of
from crankorder.settings import Settings

SCHEMA_VERSION = 1

ENDLESS_FREEDOM = 1e6
"""Degrees of freedom from which on Student's t is a normal distribution."""

NO_BALANCE = "the path from force to acceleration is not identified: a run with a known trial mass is needed"


def find(
    order_map: xr.Dataset, campbell: xr.Dataset, *, test: str, sources: Sources, settings: Settings
) -> dict[str, Any]:
    """Findings of a test, in the words of ``data_schema/findings.json``.

    ``order_map`` and ``campbell`` (without speeds where none is known) are the maps of the test named ``test``;
    ``sources`` says what the machine is made of; ``settings`` are those of all stages.
    """
    lines = order_lines(order_map, settings=settings.identify, orders=settings.orders)
    orders = [order for order, _ in orders_agreed(lines)]
    modes = find_modes(campbell, orders, settings=settings.identify) if campbell.sizes["speed"] else []
    quantity = dict(zip(order_map["channel"].values.tolist(), order_map["quantity"].values.tolist(), strict=True))
    unit = dict(zip(order_map["channel"].values.tolist(), order_map["unit"].values.tolist(), strict=True))
    order_records = [_order_record(line, quantity, unit, sources, settings) for line in lines]
    mode_records = [_mode_record(mode, campbell["speed"].values, sources, settings) for mode in modes]
    speed = order_map["speed"].values
    tested = (float(np.nanmin(speed)), float(np.nanmax(speed))) if np.isfinite(speed).any() else (np.nan, np.nan)
    real_modes = [
        mode.frequency for mode, record in zip(modes, mode_records, strict=True) if record["explained_by"] == "mode"
    ]
    return {
        "schema_version": SCHEMA_VERSION,
        "test": test,
        "channels": [{"name": name, "unit": unit[name], "quantity": quantity[name]} for name in unit],
        "speed_range_rpm": list(tested),
        "orders": order_records,
        "modes": mode_records,
        "crossings": crossings(lines, real_modes, tested, settings=settings.identify),
        "bearings": _bearing_records(order_records, sources, settings),
        "lines": _line_records(order_records, modes, mode_records),
        "unexplained_energy_fraction": _unexplained(order_records),
        "balance": None,
        "balance_reason": NO_BALANCE,
        "false_alarm_probability": settings.identify.false_alarm_probability,
        "quality": _flags(order_map, campbell) + fold_flags(order_map, settings=settings),
    }


def _order_record(
    line: OrderLine, quantity: dict[str, str], unit: dict[str, str], sources: Sources, settings: Settings
) -> dict[str, Any]:
    best = line.strongest
    amplitude, error = float(line.amplitude[best]), float(line.amplitude_error[best])
    phase = float(line.phase_deg[best])
    exponent = line.exponent()
    freedom = float(np.clip(line.degrees_of_freedom[best], 1.0, ENDLESS_FREEDOM))
    # the largest of n amplitudes is shown: its interval must hold for all n at once (Bonferroni)
    simultaneous = float(stdtrit(freedom, 1.0 - 0.025 / len(line.seen))) * error
    return {
        "channel": line.channel,
        "order": line.order,
        "order_ci95": _interval(line.order, line.order_error),
        "amplitude": amplitude,
        "amplitude_ci95": [max(0.0, amplitude - simultaneous), amplitude + simultaneous],
        "phase_deg": None if np.isnan(phase) else phase,
        "phase_deg_ci95": None if np.isnan(phase) else _interval(phase, np.degrees(error / amplitude), freedom=freedom),
        "unit": unit[line.channel],
        "speed_rpm_at_max": float(line.speed_rpm[best]),
        "speed_exponent": None if exponent is None else exponent[0],
        "speed_exponent_ci95": None if exponent is None else _interval(*exponent, freedom=len(line.seen) - 2),
        "speed_range_rpm": [float(line.speed_rpm.min()), float(line.speed_rpm.max())],
        "n_speeds": len(line.seen),
        "locked": line.evidence == "locked to the shaft",
        "evidence": f"{line.evidence}; {line.level_over_floor_db:.1f} dB over the local floor",
        "level_over_floor_db": line.level_over_floor_db,
        "explained_by": explain_order(
            line.order, line.order_error, quantity[line.channel], sources, settings=settings.identify
        ),
    }


def _interval(value: float, error: float, *, freedom: float | None = None) -> list[float]:
    """95 % interval of an estimate, by Student's t where the error itself comes from ``freedom`` residuals."""
    half = error * (Z95 if freedom is None else float(stdtrit(freedom, 0.975)))
    return [value - half, value + half]


def _mode_record(mode: Mode, speed_rpm: NDArray[np.float64], sources: Sources, settings: Settings) -> dict[str, Any]:
    frequency, frequency_error = mode.frequency
    damping, damping_error = mode.damping
    strongest = mode.strongest
    explained = explain_fixed(
        frequency,
        0.0 if all(line.is_tone for line in mode.lines) else 2.0 * damping * frequency,
        speed_rpm=speed_rpm,
        revs_per_cycle=sources.revs_per_cycle,
        settings=settings.identify,
    )
    return {
        "frequency_hz": frequency,
        "frequency_hz_ci95": _interval(frequency, frequency_error),
        "damping_ratio": damping,
        "damping_ratio_ci95": [max(0.0, damping - Z95 * damping_error), damping + Z95 * damping_error],
        "channels": [line.channel for line in mode.lines],
        "evidence": f"stays at its frequency at all speeds; {strongest.prominence_db:.1f} dB above the valleys "
        f"beside it in {strongest.channel} after removal of the order lines",
        "prominence_db": strongest.prominence_db,
        "explained_by": explained,
    }


def _bearing_records(orders: list[dict[str, Any]], sources: Sources, settings: Settings) -> list[dict[str, Any]]:
    """One record per bearing line that was found, in the channel where it is strongest."""
    records = []
    for (name, line), expected in sources.known_bearing_orders.items():
        near = [r for r in orders if abs(r["order"] - expected) < settings.identify.order_match]
        if not near:
            continue
        best = max(near, key=lambda record: record["amplitude"])
        locked = all(record["locked"] for record in near)
        exact = abs(best["order"] - expected) <= max(settings.identify.order_match / 4, 2 * _half_width(best))
        verdict = "watch: re-run the same test; a growing amplitude means a failing bearing"
        elements = _elements(sources, name)
        if locked and exact and line == "N*fs" and elements is not None:
            verdict += (
                f". Exactly locked to the shaft: an {elements}-fold or other toothed part of that shaft is as likely"
            )
        records.append(
            {
                "name": name,
                "line": line,
                "order": best["order"],
                "order_ci95": best["order_ci95"],
                "order_expected": expected,
                "amplitude": best["amplitude"],
                "amplitude_ci95": best["amplitude_ci95"],
                "channel": best["channel"],
                "verdict": verdict,
            }
        )
    return records


def _half_width(record: dict[str, Any]) -> float:
    return float(record["order_ci95"][1] - record["order_ci95"][0]) / 2.0


def _elements(sources: Sources, name: str) -> int | None:
    return next(bearing.rolling_elements for bearing in sources.bearings if bearing.name == name)


def _line_records(
    orders: list[dict[str, Any]], modes: list[Mode], mode_records: list[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Every line above the false-alarm level: orders first, then lines of fixed frequency."""
    records: list[dict[str, Any]] = [
        {key: record[key] for key in ("channel", "order", "explained_by", "amplitude")} for record in orders
    ]
    for mode, record in zip(modes, mode_records, strict=True):
        for line in mode.lines:
            width_hz = max(line.damping_ratio * line.frequency_hz, 1e-9)
            rms = np.sqrt(line.psd * np.pi * width_hz)
            records.append(
                {
                    "channel": line.channel,
                    "frequency_hz": line.frequency_hz,
                    "explained_by": record["explained_by"],
                    "amplitude": float(np.sqrt(2.0) * rms),
                }
            )
    return records


def _unexplained(orders: list[dict[str, Any]]) -> float:
    """Share of the order lines' energy (each at its strongest, all channels alike) that nothing explains."""
    total: dict[str, float] = {}
    unknown: dict[str, float] = {}
    for record in orders:
        energy = record["amplitude"] ** 2
        total[record["channel"]] = total.get(record["channel"], 0.0) + energy
        if record["explained_by"] == "unexplained":
            unknown[record["channel"]] = unknown.get(record["channel"], 0.0) + energy
    if not total:
        return 0.0
    return float(np.mean([unknown.get(channel, 0.0) / energy for channel, energy in total.items()]))


def _flags(order_map: xr.Dataset, campbell: xr.Dataset) -> list[QualityFlag]:
    """Flags of both maps, each once, in the order in which they were raised."""
    seen: list[QualityFlag] = []
    for dataset in (order_map, campbell):
        for flag in flags_of(dataset):
            if flag not in seen:
                seen.append(flag)
    return seen
